//! Inputs of metrics: columns in any of the tables to score.

use schemas::{Role, TableShape};

use super::Score;
use crate::navigate::{DRMS_BOUND, GNSS_UPDATE, MAP_HEIGHT_ERROR, MAP_SLOPE};

/// A column or a group of columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScoreSource {
    /// Signal to score, named by `mag`.
    Signal,
    /// Aircraft field that compensation subtracted.
    Aircraft,
    /// True signal, named by `truth`.
    Truth,
    /// Error of a track's map due to the difference between the heights of map and line.
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
    /// Innovations of the track, in nT, and NIS.
    Innovations,
    /// Horizontal slope of the map along a track.
    Slope,
    /// Outcomes of the GNSS positions along a track.
    Gnss,
    /// A column of this name.
    Column(&'static str),
}

/// Column of the known anomaly of a simulation.
const ANOMALY: &str = "anomaly_truth";

/// Location of a source.
#[derive(Clone, Debug, PartialEq)]
pub struct ScoreSourceColumns {
    /// Index of the input.
    pub table: usize,
    /// Column names.
    pub columns: Vec<String>,
}

impl ScoreSource {
    /// All sources except single columns, in the order in which they are read.
    const ALL: [ScoreSource; 19] = [
        ScoreSource::Signal,
        ScoreSource::Aircraft,
        ScoreSource::Truth,
        ScoreSource::MapHeight,
        ScoreSource::Core,
        ScoreSource::Diurnal,
        ScoreSource::Anomaly,
        ScoreSource::Attitude,
        ScoreSource::Map,
        ScoreSource::Position,
        ScoreSource::Height,
        ScoreSource::Velocity,
        ScoreSource::Ins,
        ScoreSource::Track,
        ScoreSource::TrackVelocity,
        ScoreSource::Bound,
        ScoreSource::Innovations,
        ScoreSource::Slope,
        ScoreSource::Gnss,
    ];

    /// Truth sources, in the order in which their absence is reported.
    pub const TRUTHS: [ScoreSource; 4] =
        [ScoreSource::Truth, ScoreSource::Position, ScoreSource::Height, ScoreSource::Velocity];

    /// Whether the source belongs to the truth.
    pub fn is_truth(self) -> bool {
        Self::TRUTHS.contains(&self)
    }

    /// First table that has all columns of the source.
    fn find(self, stage: &Score, shapes: &[&TableShape]) -> Option<ScoreSourceColumns> {
        let of_role = |names: &[&str], role: Option<Role>| {
            let has = |s: &TableShape, name: &str| s.get(name).is_some_and(|c| role.is_none_or(|r| c.role == r));
            let table = shapes.iter().position(|s| names.iter().all(|n| has(s, n)))?;
            Some(ScoreSourceColumns { table, columns: names.iter().map(ToString::to_string).collect() })
        };
        let of = |names: &[&str]| of_role(names, None);
        match self {
            ScoreSource::Signal => of(&[&stage.mag]),
            ScoreSource::Aircraft => of(&["mag_aircraft"]),
            ScoreSource::Truth => of(&[stage.truth.as_deref()?]),
            ScoreSource::MapHeight => of(&[MAP_HEIGHT_ERROR]),
            ScoreSource::Core => of(&["igrf"]),
            ScoreSource::Diurnal => of(&["diurnal"]),
            ScoreSource::Anomaly => of(&[ANOMALY]),
            ScoreSource::Attitude => {
                of(&["roll", "pitch", "yaw"]).or_else(|| of(&["ins_roll", "ins_pitch", "ins_yaw"]))
            }
            ScoreSource::Map => of(&["map_anomaly", "map_grad_n", "map_grad_e"]),
            ScoreSource::Position => of_role(&["lat", "lon"], Some(Role::Truth)),
            ScoreSource::Height => of_role(&["alt"], Some(Role::Truth)),
            ScoreSource::Velocity => of_role(&["vn", "ve", "vd"], Some(Role::Truth)),
            ScoreSource::TrackVelocity => of_role(&["vn", "ve", "vd"], Some(Role::Derived)),
            ScoreSource::Bound => of(&[DRMS_BOUND]),
            ScoreSource::Ins => of(&["ins_lat", "ins_lon"]),
            ScoreSource::Column(name) => of(&[name]),
            ScoreSource::Track => of(&["lat", "lon", "alt", "sd_n", "sd_e", "cov_ne", "nis", "update"]),
            ScoreSource::Slope => of(&[MAP_SLOPE]),
            ScoreSource::Gnss => of(&[GNSS_UPDATE]),
            ScoreSource::Innovations => of(&["residual", "nis", "update"]),
        }
    }

    /// Description of the source in messages about its absence.
    pub fn words(self, stage: &Score) -> String {
        match self {
            ScoreSource::Signal => format!("a table with `{}`", stage.mag),
            ScoreSource::Aircraft => "`mag_aircraft` of `compensate`".to_owned(),
            ScoreSource::Truth => "`truth`".to_owned(),
            ScoreSource::MapHeight => format!("`{MAP_HEIGHT_ERROR}`"),
            ScoreSource::Core => "the core field `igrf`, from the stage `core_field`".to_owned(),
            ScoreSource::Diurnal => "the diurnal variation `diurnal`".to_owned(),
            ScoreSource::Anomaly => format!("the known anomaly `{ANOMALY}`"),
            ScoreSource::Attitude => "roll, pitch and yaw".to_owned(),
            ScoreSource::Map => "a table made by `map_value`".to_owned(),
            ScoreSource::Position => "true positions `lat` and `lon`".to_owned(),
            ScoreSource::Height => "true heights `alt`".to_owned(),
            ScoreSource::Velocity => "true velocities `vn`, `ve` and `vd`".to_owned(),
            ScoreSource::Bound => "a track of the filter `crlb`".to_owned(),
            ScoreSource::Ins => "`ins_lat` and `ins_lon`".to_owned(),
            ScoreSource::Column(name) => format!("a table with `{name}`"),
            ScoreSource::Gnss => "a track of `navigate` with `gnss_lost_s`".to_owned(),
            ScoreSource::Slope => "a track of `navigate` with `flat_over_m`".to_owned(),
            ScoreSource::Track | ScoreSource::TrackVelocity | ScoreSource::Innovations => {
                "a track of `navigate`".to_owned()
            }
        }
    }
}

/// Locations of the available sources.
#[derive(Clone, Debug)]
pub struct ScoreSourceIndex(Vec<(ScoreSource, ScoreSourceColumns)>);

impl ScoreSourceIndex {
    /// Finds all sources, and the single columns that metrics read.
    pub fn find(stage: &Score, shapes: &[&TableShape]) -> ScoreSourceIndex {
        let mut sources = ScoreSource::ALL.to_vec();
        for source in stage.metrics.all().iter().flat_map(|scorer| scorer.needs.iter().chain(scorer.uses)) {
            if !sources.contains(source) {
                sources.push(*source);
            }
        }
        ScoreSourceIndex(sources.into_iter().filter_map(|s| Some((s, s.find(stage, shapes)?))).collect())
    }

    /// Location of a source.
    pub fn get(&self, source: ScoreSource) -> Option<&ScoreSourceColumns> {
        self.0.iter().find(|(s, _)| *s == source).map(|(_, place)| place)
    }

    /// All available sources, in the order in which they are read.
    pub fn iter(&self) -> impl Iterator<Item = (ScoreSource, &ScoreSourceColumns)> {
        self.0.iter().map(|(source, place)| (*source, place))
    }
}
