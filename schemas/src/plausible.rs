//! Physically possible values of the columns of a flight: limits in the canonical unit, and the probable cause of a
//! value outside them.

use crate::{choice, convert, flight};

choice! {
    /// Plausibility checks that a table of flights can disable.
    pub enum PlausibilityCheck {
        /// Accepts values outside the limits of their column, and columns that contradict each other.
        Range = "range",
    }
}

/// Quantity that a column measures, which determines its limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PhysicalQuantity {
    /// Seconds past midnight.
    Time,
    /// Geodetic latitude.
    Latitude,
    /// Longitude, to the east.
    Longitude,
    /// Height of an aircraft, above any reference.
    Height,
    /// Height of the ground, or height above the ground.
    Ground,
    /// Component of a velocity.
    Speed,
    /// Roll, pitch or yaw.
    Angle,
    /// Component of an angular rate.
    Rate,
    /// Component of a specific force.
    SpecificForce,
    /// Total field, as a scalar magnetometer reads it.
    TotalField,
    /// Magnitude of a vector magnetometer, which may have offsets and scale errors.
    VectorField,
    /// Component of a vector magnetometer.
    FieldComponent,
    /// Anomaly: a reading minus the core field.
    Anomaly,
    /// Temporal variation of the field.
    Variation,
    /// Calendar year.
    Year,
    /// Day of the year.
    Day,
}

/// Treatment if a few values are outside the limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutlierTreatment {
    /// Rejects the line: occasional errors of a position, an attitude or a date have a systematic cause.
    Fault,
    /// Treats them as missing values: sensors have spikes and dropouts.
    Missing,
}

/// Plausible values of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlausibleRange {
    /// Quantity that the column measures.
    pub kind: PhysicalQuantity,
    /// Minimum, in the canonical unit.
    pub low: f64,
    /// Maximum, in the canonical unit.
    pub high: f64,
    /// Treatment if a few values are outside the range.
    pub outlier: OutlierTreatment,
}

impl PlausibleRange {
    /// Whether a finite value is within the limits, with a tolerance for rounding (a yaw of π in single precision is
    /// 180.000005 degrees).
    pub fn holds(&self, x: f64) -> bool {
        let room = 1e-6 * (self.high - self.low);
        (self.low - room..=self.high + room).contains(&x)
    }
}

impl PhysicalQuantity {
    /// Name of the quantity with its article, for a sentence such as '95 deg is not a latitude'.
    pub fn noun(self) -> &'static str {
        match self {
            PhysicalQuantity::Time => "a time of day",
            PhysicalQuantity::Latitude => "a latitude",
            PhysicalQuantity::Longitude => "a longitude",
            PhysicalQuantity::Height => "a plausible aircraft height",
            PhysicalQuantity::Ground => "a plausible ground height or height above ground",
            PhysicalQuantity::Speed => "a plausible aircraft velocity",
            PhysicalQuantity::Angle => "an attitude angle",
            PhysicalQuantity::Rate => "a plausible angular rate of an aircraft",
            PhysicalQuantity::SpecificForce => "a plausible specific force on an aircraft",
            PhysicalQuantity::TotalField => "a total field of the earth",
            PhysicalQuantity::VectorField => "a plausible magnitude of a vector measurement of the earth's field",
            PhysicalQuantity::FieldComponent => "a component of the earth's field",
            PhysicalQuantity::Anomaly => "a magnetic anomaly",
            PhysicalQuantity::Variation => "a temporal variation of the field",
            PhysicalQuantity::Year => "a year of a flight",
            PhysicalQuantity::Day => "a day of the year",
        }
    }

    /// Units in which the quantity is commonly given, the canonical unit first.
    fn units(self) -> &'static [&'static str] {
        match self {
            PhysicalQuantity::Time => &["s", "ms", "us", "ns"],
            // Positioning receivers log whole multiples of 1e-7 degrees.
            PhysicalQuantity::Latitude | PhysicalQuantity::Longitude => &["deg", "rad", "degE7"],
            PhysicalQuantity::Angle => &["deg", "rad"],
            PhysicalQuantity::Height | PhysicalQuantity::Ground => &["m", "ft", "km"],
            PhysicalQuantity::Speed => &["m/s", "km/h", "kn"],
            PhysicalQuantity::Rate => &["deg/s", "rad/s"],
            PhysicalQuantity::TotalField | PhysicalQuantity::VectorField => &["nT", "uT", "mgauss", "gauss", "mT", "T"],
            // These quantities can be arbitrarily small, so a value would be plausible in too many units.
            PhysicalQuantity::SpecificForce
            | PhysicalQuantity::FieldComponent
            | PhysicalQuantity::Anomaly
            | PhysicalQuantity::Variation
            | PhysicalQuantity::Year
            | PhysicalQuantity::Day => &[],
        }
    }
}

/// The magnitude of a vector magnetometer. The limits allow for the biases and scale errors of raw fluxgates, but
/// detect a factor of ten: the earth's field is 22,000 to 67,000 nT.
pub const VECTOR: PlausibleRange = PlausibleRange {
    kind: PhysicalQuantity::VectorField,
    low: 7_500.0,
    high: 150_000.0,
    outlier: OutlierTreatment::Missing,
};

/// The total field that a scalar magnetometer reads.
const TOTAL: PlausibleRange = PlausibleRange {
    kind: PhysicalQuantity::TotalField,
    low: 15_000.0,
    high: 80_000.0,
    outlier: OutlierTreatment::Missing,
};

/// A reading without the core field, such as the aircraft field alone.
const RESIDUAL: PlausibleRange = PlausibleRange {
    kind: PhysicalQuantity::Anomaly,
    low: -50_000.0,
    high: 50_000.0,
    outlier: OutlierTreatment::Missing,
};

/// The anomaly of a map or a survey. Rocks cause a few thousand nT at flying height, and more than these limits only at
/// the ground above iron ore. The weakest total field of the earth is 22,000 nT (IGRF-14, South Atlantic), above the
/// limit.
const CRUST: PlausibleRange = PlausibleRange {
    kind: PhysicalQuantity::Anomaly,
    low: -20_000.0,
    high: 20_000.0,
    outlier: OutlierTreatment::Fault,
};

/// Limits of the values of a map or a survey, in nT: the limits of a total field if most values are total fields,
/// otherwise the limits of an anomaly.
pub fn survey(values: impl Iterator<Item = f64>) -> PlausibleRange {
    let (mut known, mut total) = (0_usize, 0_usize);
    for x in values.filter(|x| !x.is_nan()) {
        known += 1;
        total += usize::from(!CRUST.holds(x) && TOTAL.holds(x));
    }
    if 2 * total > known { PlausibleRange { outlier: OutlierTreatment::Fault, ..TOTAL } } else { CRUST }
}

/// Minimum interquartile range of a residual field as a fraction of its median, for lines of fewer samples than
/// [`LONG_LINE`] and for longer ones. For a total field the fraction is far smaller in every unit: 1 % corresponds to
/// 500 nT.
const RESIDUAL_SPREAD: (f64, f64) = (0.03, 0.1);
const LONG_LINE: usize = 1_000;

/// Limits of a residual field; `None` unless the `values` of a total-field column are a residual field. The values are
/// a residual field if few of them are plausible total fields, and if they are negative or vary more than a total field
/// in another unit would.
pub fn residual(limits: &PlausibleRange, values: &[f64]) -> Option<PlausibleRange> {
    if limits.kind != PhysicalQuantity::TotalField {
        return None;
    }
    let known = || values.iter().copied().filter(|x| x.is_finite() && *x != 0.0);
    let (all, total) = (known().count(), known().filter(|x| limits.holds(*x)).count());
    if 10 * total >= all {
        return None;
    }
    let mut sorted: Vec<f64> = known().collect();
    sorted.sort_by(f64::total_cmp);
    let at = |part: usize| sorted.get(part * all / 4).copied().unwrap_or(f64::NAN);
    let (low, middle, high) = (at(1), at(2), at(3));
    let least = if all < LONG_LINE { RESIDUAL_SPREAD.0 } else { RESIDUAL_SPREAD.1 };
    (RESIDUAL.holds(middle) && (middle < 0.0 || high - low > least * middle)).then_some(RESIDUAL)
}

/// The limits of the column `name` in its canonical unit; `None` without limits.
pub fn limits(name: &str) -> Option<PlausibleRange> {
    let fault = |kind, low, high| Some(PlausibleRange { kind, low, high, outlier: OutlierTreatment::Fault });
    let missing = |kind, low, high| Some(PlausibleRange { kind, low, high, outlier: OutlierTreatment::Missing });
    match name {
        // A flight may begin before one midnight and end after the next.
        "tt" => fault(PhysicalQuantity::Time, -86_400.0, 259_200.0),
        "lat" | "ins_lat" => fault(PhysicalQuantity::Latitude, -90.0, 90.0),
        "lon" | "ins_lon" => fault(PhysicalQuantity::Longitude, -180.0, 360.0),
        "alt" | "ins_alt" => fault(PhysicalQuantity::Height, -1_000.0, 100_000.0),
        "msl" | "baro" => missing(PhysicalQuantity::Height, -1_000.0, 100_000.0),
        "radar" | "topo" | "dem" | "drape" => missing(PhysicalQuantity::Ground, -12_000.0, 100_000.0),
        "vn" | "ve" | "vd" | "ins_vn" | "ins_ve" | "ins_vd" => fault(PhysicalQuantity::Speed, -1_000.0, 1_000.0),
        "roll" | "ins_roll" => fault(PhysicalQuantity::Angle, -180.0, 180.0),
        "pitch" | "ins_pitch" => fault(PhysicalQuantity::Angle, -90.0, 90.0),
        "yaw" | "ins_yaw" => fault(PhysicalQuantity::Angle, -180.0, 360.0),
        "roll_rate" | "pitch_rate" | "yaw_rate" => missing(PhysicalQuantity::Rate, -2_000.0, 2_000.0),
        "ins_fn" | "ins_fe" | "ins_fd" => missing(PhysicalQuantity::SpecificForce, -500.0, 500.0),
        "diurnal" => missing(PhysicalQuantity::Variation, -5_000.0, 5_000.0),
        "mag_1_igrf" | "anomaly_truth" => missing(PhysicalQuantity::Anomaly, -50_000.0, 50_000.0),
        "igrf" | "mag_1_lag" | "mag_1_dc" => Some(TOTAL),
        "year" => fault(PhysicalQuantity::Year, 1900.0, 2100.0),
        "doy" => fault(PhysicalQuantity::Day, 1.0, 366.0),
        _ if flight::is_scalar_reading(name) || flight::is_compensated(name) => Some(TOTAL),
        _ => match flight::vector_part(name)? {
            (_, 't') => Some(VECTOR),
            _ => missing(PhysicalQuantity::FieldComponent, -150_000.0, 150_000.0),
        },
    }
}

/// Probable cause of a value outside its limits.
#[derive(Clone, Debug, PartialEq)]
pub enum ProbableCause {
    /// Another unit: the unit, and the value converted to the canonical unit.
    Unit(&'static str, f64),
    /// Degrees and minutes in the form of receivers (NMEA `ddmm.mm`): the value in degrees.
    DegreesMinutes(f64),
    /// Seconds of a GPS week: the day from Sunday as 0, and the second of that day.
    GpsWeek(u32, f64),
    /// Seconds since 1970: the second of the day.
    Unix(f64),
}

/// The probable cause of a `value` outside `limits`, such as a wrong unit. `declared` is the unit in the file or spec;
/// if it is empty, the canonical unit.
pub fn likely(limits: &PlausibleRange, value: f64, declared: &str) -> Option<ProbableCause> {
    let canonical = *limits.kind.units().first()?;
    let declared = if declared.is_empty() { canonical } else { declared };
    let reading = value / convert(declared, canonical)?;
    let in_unit = |unit: &&'static str| {
        let factor = convert(unit, canonical)?;
        let other = convert(declared, canonical) != Some(factor);
        let value = reading * factor;
        // In a sufficiently small unit, any number is a position within 1 km of the origin.
        let origin =
            matches!(limits.kind, PhysicalQuantity::Latitude | PhysicalQuantity::Longitude) && value.abs() < 0.01;
        (other && !origin && limits.holds(value)).then_some((*unit, value))
    };
    let mut fitting = limits.kind.units().iter().filter_map(in_unit);
    let (first, second) = (fitting.next(), fitting.next());
    let unit = first.map(|(unit, value)| ProbableCause::Unit(unit, value));
    match limits.kind {
        // Several small units are possible for a time of day; the largest is the most likely.
        PhysicalQuantity::Time => seconds(reading).or(unit),
        PhysicalQuantity::Latitude | PhysicalQuantity::Longitude => unit.or_else(|| degrees(limits, reading)),
        _ => unit.filter(|_| second.is_none()),
    }
}

fn degrees(limits: &PlausibleRange, x: f64) -> Option<ProbableCause> {
    let (whole, minutes) = ((x.abs() / 100.0).trunc(), x.abs() % 100.0);
    let value = (whole + minutes / 60.0).copysign(x);
    (minutes < 60.0 && limits.holds(value)).then_some(ProbableCause::DegreesMinutes(value))
}

fn seconds(x: f64) -> Option<ProbableCause> {
    const DAY: f64 = 86_400.0;
    if (0.0..7.0 * DAY).contains(&x) {
        return Some(ProbableCause::GpsWeek((x / DAY) as u32, x % DAY));
    }
    // 1980 to 2100.
    (3.1e8..4.1e9).contains(&x).then_some(ProbableCause::Unix(x % DAY))
}

/// A number for messages: with thousands separators and without superfluous digits.
pub fn shown(x: f64) -> String {
    // Six digits, or four decimals, are enough for a message.
    let six = || format!("{x:.5e}").parse().unwrap_or(x);
    if x != 0.0 && !(1e-3..1e15).contains(&x.abs()) {
        return format!("{:e}", six());
    }
    let rounded = if x.abs() < 1.0 { six() } else { (x * 1e4).round() / 1e4 };
    let text = rounded.abs().to_string();
    let (whole, rest) = text.split_once('.').map_or((text.as_str(), None), |(w, r)| (w, Some(r)));
    let mut out = String::new();
    for (i, digit) in whole.chars().enumerate() {
        if i > 0 && (whole.len() - i) % 3 == 0 && whole.len() > 4 {
            out.push(',');
        }
        out.push(digit);
    }
    let sign = if x < 0.0 { "-" } else { "" };
    rest.map_or_else(|| format!("{sign}{out}"), |r| format!("{sign}{out}.{r}"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_columns_have_the_limits_of_their_quantity() {
        for (name, inside, outside) in [
            ("lat", vec![-90.0, 45.0, 90.0], vec![95.0, -100.0, 2603.0, 1e300]),
            ("lon", vec![-180.0, 359.9], vec![-181.0, 500.0]),
            ("mag_3_uc", vec![22_000.0, 67_000.0], vec![5.4e-5, 54.0, 5.4e7]),
            ("mag_1_c", vec![54_000.0], vec![0.0]),
            ("mag_1_igrf", vec![-3_000.0, 0.0], vec![54_000.0]),
            ("diurnal", vec![-500.0, 30.0], vec![54_000.0]),
            ("flux_a_x", vec![-70_000.0, 0.0], vec![5.4e6]),
            ("flux_a_t", vec![54_000.0], vec![54.0]),
            ("yaw", vec![-180.0, 360.0], vec![400.0]),
            ("ins_pitch", vec![-90.0], vec![91.0]),
            ("alt", vec![-400.0, 20_000.0], vec![200_000.0]),
            ("year", vec![2020.0], vec![20.0]),
            ("tt", vec![0.0, 90_000.0], vec![1.6e9]),
        ] {
            let limits = limits(name).unwrap();
            assert!(inside.iter().all(|x| limits.holds(*x)), "{name}");
            assert!(outside.iter().all(|x| !limits.holds(*x)), "{name}");
        }
        assert_eq!(limits("cur_flap"), None);
        assert_eq!(limits("mag_3_uc_bp"), None);
    }

    #[test]
    fn unit_the_probable_unit_of_an_impossible_value_is_found() {
        let of = |name: &str, value: f64, unit: &str| likely(&limits(name).unwrap(), value, unit);
        assert_eq!(of("mag_3_uc", 5.4e7, "uT"), Some(ProbableCause::Unit("nT", 54_000.0)));
        assert_eq!(of("mag_3_uc", 54.0, ""), Some(ProbableCause::Unit("uT", 54_000.0)));
        assert!(matches!(of("mag_3_uc", 5.4e-5, ""), Some(ProbableCause::Unit("T", x)) if (x - 54_000.0).abs() < 1e-6));
        assert_eq!(of("mag_3_uc", 1e300, ""), None);
        let twice_converted = of("lat", 45.0f64.to_degrees(), "rad");
        assert!(matches!(twice_converted, Some(ProbableCause::Unit("deg", x)) if (x - 45.0).abs() < 1e-9));
        assert!(matches!(of("lat", 2603.0, ""), Some(ProbableCause::DegreesMinutes(x)) if (x - 26.05).abs() < 1e-9));
        assert_eq!(of("lat", 95.0, ""), None);
        assert_eq!(of("tt", 300_000.0, ""), Some(ProbableCause::GpsWeek(3, 40_800.0)));
    }

    #[test]
    fn unit_a_residual_field_is_detected_by_its_variation() {
        let total = limits("mag_4_uc").unwrap();
        let wave = |offset: f64, scale: f64| (0..500).map(|i| offset + scale * f64::from(i).sin()).collect::<Vec<_>>();
        assert!(residual(&total, &wave(0.0, 200.0)).is_some());
        assert!(residual(&total, &wave(150.0, 100.0)).is_some());
        assert!(residual(&total, &wave(-300.0, 2.0)).is_some());
        for other in [wave(54_000.0, 900.0), wave(54.0, 0.9), wave(5.4e-5, 2e-7), wave(5_400.0, 20.0)] {
            assert!(residual(&total, &other).is_none());
        }
        // A total field with some bad samples is still a total field.
        let mut spiked = wave(54_000.0, 200.0);
        spiked.iter_mut().step_by(20).for_each(|x| *x = -5.0);
        assert!(residual(&total, &spiked).is_none());
        assert!(residual(&limits("diurnal").unwrap(), &wave(0.0, 20.0)).is_none());
    }

    #[test]
    fn unit_a_survey_holds_anomalies_or_the_total_field() {
        let holds = |values: &[f64], x: f64| survey(values.iter().copied()).holds(x);
        assert!(holds(&[1.0, -300.0, 99_999.0], -5_000.0) && !holds(&[1.0, -300.0, 99_999.0], 99_999.0));
        assert!(holds(&[54_000.0, 54_100.0, f64::NAN, 0.0], 54_200.0));
        assert!(!holds(&[54_000.0, 54_100.0, 0.0], 0.0) && !holds(&[54_000.0, 54_100.0], 1e308));
        assert!(!holds(&[1.0, 54_100.0, 3.0], 54_100.0), "one total field among anomalies");
    }

    #[test]
    fn gold_numbers_in_messages() {
        let texts = [54_000_000.0, 2603.0, -95.5, 5.4e-5, 1e300, 0.0, 26.05, 12_345.678_91].map(shown);
        assert_eq!(texts, ["54,000,000", "2603", "-95.5", "5.4e-5", "1e300", "0", "26.05", "12,345.6789"]);
    }
}
