//! What metrics read: columns, in whichever of the tables to score they are.

use schemas::{Role, Shape};

use super::Score;
use crate::navigate::{DRMS_BOUND, GNSS_UPDATE, MAP_HEIGHT_ERROR, MAP_SLOPE};

/// A column, or several that belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The signal to score, which `mag` names.
    Signal,
    /// What compensation took off it.
    Aircraft,
    /// The true signal, which `truth` names.
    Truth,
    /// The error of a track's map for its height.
    MapHeight,
    /// The core field.
    Core,
    /// The diurnal variation.
    Diurnal,
    /// The known anomaly of a simulation.
    Anomaly,
    /// Roll, pitch and yaw, true or of the INS.
    Attitude,
    /// The map's value at the samples and its slopes north and east.
    Map,
    /// True latitude and longitude.
    Position,
    /// True height.
    Height,
    /// True velocity north, east and down.
    Velocity,
    /// The latitude and longitude of the INS.
    Ins,
    /// The track of a filter.
    Track,
    /// Its velocity north, east and down.
    TrackVelocity,
    /// The bound of its horizontal error, which has no estimate.
    Bound,
    /// Its innovations: in nT, and squared over their variance.
    Innovations,
    /// The slope of the map along a track.
    Slope,
    /// The outcome for the positions by GNSS along a track.
    Gnss,
    /// A column of this name.
    Column(&'static str),
}

/// The known anomaly of a simulation.
const ANOMALY: &str = "anomaly_truth";

/// Where a source is.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// The input.
    pub table: usize,
    /// The columns.
    pub columns: Vec<String>,
}

impl Source {
    /// All but single columns, in the order in which they are read.
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

    /// What is true, in the order in which its absence is reported.
    pub const TRUTHS: [Source; 4] = [Source::Truth, Source::Position, Source::Height, Source::Velocity];

    /// Whether it is a truth.
    pub fn is_truth(self) -> bool {
        Self::TRUTHS.contains(&self)
    }

    /// The first table that has all its columns.
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

    /// What to give so that it is there.
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

/// Where each source is, of those that there are.
#[derive(Clone, Debug)]
pub struct Places(Vec<(Source, Place)>);

impl Places {
    /// Looks for all of them, and for the single columns that metrics read.
    pub fn find(stage: &Score, shapes: &[&Shape]) -> Places {
        let mut sources = Source::ALL.to_vec();
        for source in stage.metrics.all().iter().flat_map(|scorer| scorer.needs.iter().chain(scorer.uses)) {
            if !sources.contains(source) {
                sources.push(*source);
            }
        }
        Places(sources.into_iter().filter_map(|s| Some((s, s.find(stage, shapes)?))).collect())
    }

    /// Where one is.
    pub fn get(&self, source: Source) -> Option<&Place> {
        self.0.iter().find(|(s, _)| *s == source).map(|(_, place)| place)
    }

    /// All that there are, in the order in which they are read.
    pub fn iter(&self) -> impl Iterator<Item = (Source, &Place)> {
        self.0.iter().map(|(source, place)| (*source, place))
    }
}
