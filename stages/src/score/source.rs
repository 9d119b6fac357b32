//! Inputs of metrics: columns in any of the tables to score.

use schemas::{Role, Shape};

use super::Score;
use crate::navigate::{DRMS_BOUND, GNSS_UPDATE, MAP_HEIGHT_ERROR, MAP_SLOPE};

/// A column or a group of columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Signal to score, named by `mag`.
    Signal,
    /// Aircraft field that compensation subtracted.
    Aircraft,
    /// True signal, named by `truth`.
    Truth,
    /// Error of a track's map due to its height.
    MapHeight,
    /// The core field.
    Core,
    /// The diurnal variation.
    Diurnal,
    /// Known anomaly of a simulation.
    Anomaly,
    /// Roll, pitch and yaw, true or of the INS.
    Attitude,
    /// Value of the map at the samples and its slopes north and east.
    Map,
    /// True latitude and longitude.
    Position,
    /// True height.
    Height,
    /// True velocity north, east and down.
    Velocity,
    /// Latitude and longitude of the INS.
    Ins,
    /// The track of a filter.
    Track,
    /// Velocity of the track, north, east and down.
    TrackVelocity,
    /// Lower bound of the horizontal error, without an estimate.
    Bound,
    /// Innovations of the track: in nT, and squared over their variance.
    Innovations,
    /// Slope of the map along a track.
    Slope,
    /// Outcomes of the positions by GNSS along a track.
    Gnss,
    /// A column of this name.
    Column(&'static str),
}

/// Column of the known anomaly of a simulation.
const ANOMALY: &str = "anomaly_truth";

/// Location of a source.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Index of the input.
    pub table: usize,
    /// Column names.
    pub columns: Vec<String>,
}

impl Source {
    /// All sources except single columns, in reading order.
    const ALL: [Source; 19] = [
        Source::Signal,
        Source::Aircraft,
        Source::Truth,
        Source::MapHeight,
        Source::Core,
        Source::Diurnal,
        Source::Anomaly,
        Source::Attitude,
        Source::Map,
        Source::Position,
        Source::Height,
        Source::Velocity,
        Source::Ins,
        Source::Track,
        Source::TrackVelocity,
        Source::Bound,
        Source::Innovations,
        Source::Slope,
        Source::Gnss,
    ];

    /// Truths, in the order in which their absence is reported.
    pub const TRUTHS: [Source; 4] = [Source::Truth, Source::Position, Source::Height, Source::Velocity];

    /// Whether it is a truth.
    pub fn is_truth(self) -> bool {
        Self::TRUTHS.contains(&self)
    }

    /// First table that has all columns of the source.
    fn find(self, stage: &Score, shapes: &[&Shape]) -> Option<Place> {
        let of_role = |names: &[&str], role: Option<Role>| {
            let has = |s: &Shape, name: &str| s.get(name).is_some_and(|c| role.is_none_or(|r| c.role == r));
            let table = shapes.iter().position(|s| names.iter().all(|n| has(s, n)))?;
            Some(Place { table, columns: names.iter().map(ToString::to_string).collect() })
        };
        let of = |names: &[&str]| of_role(names, None);
        match self {
            Source::Signal => of(&[&stage.mag]),
            Source::Aircraft => of(&["mag_aircraft"]),
            Source::Truth => of(&[stage.truth.as_deref()?]),
            Source::MapHeight => of(&[MAP_HEIGHT_ERROR]),
            Source::Core => of(&["igrf"]),
            Source::Diurnal => of(&["diurnal"]),
            Source::Anomaly => of(&[ANOMALY]),
            Source::Attitude => of(&["roll", "pitch", "yaw"]).or_else(|| of(&["ins_roll", "ins_pitch", "ins_yaw"])),
            Source::Map => of(&["map_anomaly", "map_grad_n", "map_grad_e"]),
            Source::Position => of_role(&["lat", "lon"], Some(Role::Truth)),
            Source::Height => of_role(&["alt"], Some(Role::Truth)),
            Source::Velocity => of_role(&["vn", "ve", "vd"], Some(Role::Truth)),
            Source::TrackVelocity => of_role(&["vn", "ve", "vd"], Some(Role::Derived)),
            Source::Bound => of(&[DRMS_BOUND]),
            Source::Ins => of(&["ins_lat", "ins_lon"]),
            Source::Column(name) => of(&[name]),
            Source::Track => of(&["lat", "lon", "alt", "sd_n", "sd_e", "cov_ne", "nis", "update"]),
            Source::Slope => of(&[MAP_SLOPE]),
            Source::Gnss => of(&[GNSS_UPDATE]),
            Source::Innovations => of(&["residual", "nis", "update"]),
        }
    }

    /// Description of the source in messages about its absence.
    pub fn words(self, stage: &Score) -> String {
        match self {
            Source::Signal => format!("a table with `{}`", stage.mag),
            Source::Aircraft => "`mag_aircraft` of `compensate`".to_owned(),
            Source::Truth => "`truth`".to_owned(),
            Source::MapHeight => format!("`{MAP_HEIGHT_ERROR}`"),
            Source::Core => "the core field `igrf`, of stage `core_field`".to_owned(),
            Source::Diurnal => "the diurnal variation `diurnal`".to_owned(),
            Source::Anomaly => format!("the known anomaly `{ANOMALY}`"),
            Source::Attitude => "roll, pitch and yaw".to_owned(),
            Source::Map => "a table of `map_value`".to_owned(),
            Source::Position => "true positions `lat` and `lon`".to_owned(),
            Source::Height => "true heights `alt`".to_owned(),
            Source::Velocity => "true velocities `vn`, `ve` and `vd`".to_owned(),
            Source::Bound => "a track of the filter `crlb`".to_owned(),
            Source::Ins => "`ins_lat` and `ins_lon`".to_owned(),
            Source::Column(name) => format!("a table with `{name}`"),
            Source::Gnss => "a track of `navigate` with `gnss_lost_s`".to_owned(),
            Source::Slope => "a track of `navigate` with `flat_over_m`".to_owned(),
            Source::Track | Source::TrackVelocity | Source::Innovations => "a track of `navigate`".to_owned(),
        }
    }
}

/// Locations of the available sources.
#[derive(Clone, Debug)]
pub struct Places(Vec<(Source, Place)>);

impl Places {
    /// Finds all sources, and the single columns that metrics read.
    pub fn find(stage: &Score, shapes: &[&Shape]) -> Places {
        let mut sources = Source::ALL.to_vec();
        for source in stage.metrics.all().iter().flat_map(|scorer| scorer.needs.iter().chain(scorer.uses)) {
            if !sources.contains(source) {
                sources.push(*source);
            }
        }
        Places(sources.into_iter().filter_map(|s| Some((s, s.find(stage, shapes)?))).collect())
    }

    /// Location of a source.
    pub fn get(&self, source: Source) -> Option<&Place> {
        self.0.iter().find(|(s, _)| *s == source).map(|(_, place)| place)
    }

    /// All available sources, in reading order.
    pub fn iter(&self) -> impl Iterator<Item = (Source, &Place)> {
        self.0.iter().map(|(source, place)| (*source, place))
    }
}
