//! Subjects of warnings.

/// Subject of a warning.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum WarningKind {
    /// The track's horizontal error is larger than the error of the INS alone.
    WorseThanIns,
    /// The position errors are far larger than the filter's covariance.
    NeesHigh,
    /// The position errors are far smaller than the filter's covariance.
    NeesLow,
    /// The innovations are far larger than the filter predicts.
    NisHigh,
    /// The innovations are far smaller than the filter predicts.
    NisLow,
    /// The innovations are correlated.
    NotWhite,
    /// The initial position is less certain than the distance over which the map is linear.
    WideStart,
    /// The time stamps of the magnetometer are late or early.
    Late,
    /// The height at which the map is read has a constant error.
    HeightBias,
    /// The gate rejects many measurements as outliers.
    Gated,
    /// The test of GNSS positions rejected some of them.
    Gnss,
    /// Most of the line is off the map, where the filter only predicts.
    OffMap,
    /// Most of the line is over ground where the map is too flat for a position.
    Flat,
    /// The map is at a different height from the flight and is not continued to that height.
    MapHeight,
    /// Compensation removed part of the anomaly.
    Retention,
    /// Warning of a fit.
    Fit,
    /// Warning of a stage that makes a map.
    Map,
    /// Warning of another stage that reads several lines, such as `lag`.
    Stage,
    /// A metric that cannot be computed for a line.
    Metric,
}

impl WarningKind {
    /// All kinds.
    pub const ALL: [WarningKind; 19] = [
        WarningKind::WorseThanIns,
        WarningKind::NeesHigh,
        WarningKind::NeesLow,
        WarningKind::NisHigh,
        WarningKind::NisLow,
        WarningKind::NotWhite,
        WarningKind::WideStart,
        WarningKind::Late,
        WarningKind::HeightBias,
        WarningKind::Gated,
        WarningKind::Gnss,
        WarningKind::OffMap,
        WarningKind::Flat,
        WarningKind::MapHeight,
        WarningKind::Retention,
        WarningKind::Fit,
        WarningKind::Map,
        WarningKind::Stage,
        WarningKind::Metric,
    ];

    /// The kind as text.
    pub fn as_str(self) -> &'static str {
        match self {
            WarningKind::WorseThanIns => "worse_than_ins",
            WarningKind::NeesHigh => "nees_high",
            WarningKind::NeesLow => "nees_low",
            WarningKind::NisHigh => "nis_high",
            WarningKind::NisLow => "nis_low",
            WarningKind::NotWhite => "not_white",
            WarningKind::WideStart => "wide_start",
            WarningKind::Late => "late",
            WarningKind::HeightBias => "height_bias",
            WarningKind::Gated => "gated",
            WarningKind::Gnss => "gnss",
            WarningKind::OffMap => "off_map",
            WarningKind::Flat => "flat",
            WarningKind::MapHeight => "map_height",
            WarningKind::Retention => "retention",
            WarningKind::Fit => "fit",
            WarningKind::Map => "map",
            WarningKind::Stage => "stage",
            WarningKind::Metric => "metric",
        }
    }

    /// Whether this warning excludes a score from being the best of a sweep. A filter that diverged or is not
    /// consistent is excluded even if its other metrics are good.
    pub fn spoils(self) -> bool {
        match self {
            WarningKind::WorseThanIns
            | WarningKind::NeesHigh
            | WarningKind::NeesLow
            | WarningKind::NisHigh
            | WarningKind::NisLow
            | WarningKind::NotWhite
            | WarningKind::Gated => true,
            WarningKind::WideStart
            | WarningKind::Late
            | WarningKind::HeightBias
            | WarningKind::Gnss
            | WarningKind::OffMap
            | WarningKind::Flat => false,
            WarningKind::MapHeight
            | WarningKind::Retention
            | WarningKind::Fit
            | WarningKind::Map
            | WarningKind::Stage
            | WarningKind::Metric => false,
        }
    }

    /// Whether the filter is cautious: its estimate is sound, its covariance too large.
    pub fn is_cautious(self) -> bool {
        matches!(self, WarningKind::NeesLow | WarningKind::NisLow)
    }

    /// Text that applies to all warnings of this kind.
    pub fn of_many(self) -> &'static str {
        match self {
            WarningKind::WorseThanIns => "the filter is worse than the INS alone",
            WarningKind::NeesHigh => {
                "the filter is overconfident: its position errors are far larger than its covariance"
            }
            WarningKind::NeesLow => "the filter is cautious: its position errors are far smaller than its covariance",
            WarningKind::NisHigh => "the innovations are far larger than the filter predicts",
            WarningKind::NisLow => "the filter is cautious: the innovations are far smaller than it predicts",
            WarningKind::NotWhite => "the innovations are correlated in time, so the covariance is too small",
            WarningKind::WideStart => "the initial position is too uncertain for a filter that linearises the map",
            WarningKind::Late => "the time stamps of the magnetometer have a constant lag",
            WarningKind::HeightBias => "the height of the aircraft relative to the map has a constant error",
            WarningKind::Gated => "the filter rejects many measurements as outliers, so it may have lost the position",
            WarningKind::Gnss => "GNSS positions contradict the INS and are rejected",
            WarningKind::OffMap => "most measurements are off the map",
            WarningKind::Flat => "the map is too flat to correct the position for most of the measurements",
            WarningKind::MapHeight => "the map is at a different height from the flight",
            WarningKind::Retention => "compensation removed part of the anomaly",
            WarningKind::Fit => "the fit has a warning",
            WarningKind::Map => "the map has a warning",
            WarningKind::Stage => "the stage has a warning",
            WarningKind::Metric => "metrics cannot be computed",
        }
    }
}
