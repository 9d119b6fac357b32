//! Units and their conversions, which readers apply once.

use std::f64::consts::PI;

/// Dimension of a unit. Units of one dimension convert into each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PhysicalDimension {
    Field,
    Angle,
    AngularRate,
    Length,
    Time,
    Speed,
    Acceleration,
    Current,
    Voltage,
    Pressure,
    Frequency,
    // The scales of temperature have different zeros, so no factor converts between them.
    Kelvin,
    Celsius,
    Fahrenheit,
}

use PhysicalDimension as D;

/// The US survey foot, in metres. [NIST Special Publication 811, appendix B.6]
const US_FOOT: f64 = 1200.0 / 3937.0;

/// All units, each with its spellings, its dimension and its size in base units. The usual spelling is first. Spellings
/// have blanks instead of `_` and `-`.
const UNITS: &[(&[&str], PhysicalDimension, f64)] = &[
    (&["nT", "gamma", "gammas", "nanotesla"], D::Field, 1.0),
    (&["pT", "picotesla"], D::Field, 1e-3),
    (&["uT", "µt", "μt", "microtesla"], D::Field, 1e3),
    (&["mT", "millitesla"], D::Field, 1e6),
    (&["T", "tesla"], D::Field, 1e9),
    (&["mgauss", "mg", "milligauss"], D::Field, 1e2),
    (&["gauss", "g"], D::Field, 1e5),
    (&["deg", "degs", "degree", "degrees", "°"], D::Angle, 1.0),
    (&["rad", "rads", "radian", "radians"], D::Angle, 180.0 / PI),
    (&["mrad"], D::Angle, 0.18 / PI),
    (&["gon", "gons", "grads"], D::Angle, 0.9),
    (&["arcmin"], D::Angle, 1.0 / 60.0),
    (&["arcsec"], D::Angle, 1.0 / 3600.0),
    (&["degE7"], D::Angle, 1e-7),
    (&["deg/s", "degps", "deg/sec", "°/s", "dps"], D::AngularRate, 1.0),
    (&["rad/s", "radps", "rad/sec"], D::AngularRate, 180.0 / PI),
    (&["mrad/s"], D::AngularRate, 0.18 / PI),
    (&["deg/h", "deg/hr", "°/h"], D::AngularRate, 1.0 / 3600.0),
    (&["m", "metre", "meter", "metres", "meters"], D::Length, 1.0),
    (&["km"], D::Length, 1e3),
    (&["cm"], D::Length, 1e-2),
    (&["mm"], D::Length, 1e-3),
    (&["ft", "feet", "foot", "international foot", "ft intl"], D::Length, 0.3048),
    (
        &[
            "ftUS",
            "ft us",
            "foot us",
            "feet us",
            "us ft",
            "us foot",
            "us feet",
            "usft",
            "ussft",
            "sft",
            "survey ft",
            "survey foot",
            "survey feet",
            "us survey ft",
            "us survey foot",
            "us survey feet",
        ],
        D::Length,
        US_FOOT,
    ),
    (&["yd", "yard", "yards"], D::Length, 0.9144),
    (&["mi", "mile", "miles", "statute mile", "statute miles"], D::Length, 1609.344),
    (&["nmi", "nautical mile", "nautical miles"], D::Length, 1852.0),
    (&["s", "sec", "secs", "second", "seconds"], D::Time, 1.0),
    (&["ms", "msec"], D::Time, 1e-3),
    (&["us", "µs", "μs", "usec"], D::Time, 1e-6),
    (&["ns", "nsec"], D::Time, 1e-9),
    (&["min", "mins", "minutes"], D::Time, 60.0),
    (&["h", "hr", "hrs", "hour", "hours"], D::Time, 3600.0),
    (&["m/s", "mps", "m s 1", "m/sec"], D::Speed, 1.0),
    (&["cm/s"], D::Speed, 1e-2),
    (&["km/h", "kmh", "kph", "kmph", "km/hr"], D::Speed, 1.0 / 3.6),
    (&["kn", "kt", "kts", "knot", "knots"], D::Speed, 1852.0 / 3600.0),
    (&["mph", "mi/h"], D::Speed, 0.44704),
    (&["km/s"], D::Speed, 1e3),
    (&["mm/s"], D::Speed, 1e-3),
    (&["m/min"], D::Speed, 1.0 / 60.0),
    (&["ft/s", "fps", "ftps", "ft/sec", "feet/s"], D::Speed, 0.3048),
    (&["ft/min", "fpm"], D::Speed, 0.3048 / 60.0),
    (&["m/s2", "m/s^2", "m/s²", "m/s/s", "mps2", "m s 2"], D::Acceleration, 1.0),
    // `g` alone is gauss or standard gravity, depending on the dimension required.
    (&["standard gravity", "g0", "gn", "g"], D::Acceleration, 9.80665),
    (&["mGal"], D::Acceleration, 1e-5),
    (&["A", "amp", "amps", "ampere", "amperes"], D::Current, 1.0),
    (&["mA"], D::Current, 1e-3),
    (&["V", "volt", "volts"], D::Voltage, 1.0),
    (&["mV"], D::Voltage, 1e-3),
    (&["Pa"], D::Pressure, 1.0),
    (&["hPa", "mbar", "millibar", "millibars"], D::Pressure, 1e2),
    (&["kPa"], D::Pressure, 1e3),
    (&["bar"], D::Pressure, 1e5),
    (&["psi"], D::Pressure, 6_894.757_293_168),
    (&["inHg"], D::Pressure, 3_386.389),
    (&["mmHg"], D::Pressure, 133.322_4),
    (&["Hz"], D::Frequency, 1.0),
    (&["kHz"], D::Frequency, 1e3),
    (&["K", "kelvin"], D::Kelvin, 1.0),
    (&["degC", "°c", "c", "celsius"], D::Celsius, 1.0),
    (&["degF", "°f", "fahrenheit"], D::Fahrenheit, 1.0),
];

/// The factor that converts a value in `from` to `to`, if both have the same dimension.
///
/// Spellings are compared without case, and `_` and `-` are blanks; an unknown unit gives `None`.
pub fn convert(from: &str, to: &str) -> Option<f64> {
    let wanted = measures(to);
    measures(from).find_map(|(dimension, a)| {
        let (_, b) = wanted.clone().find(|(d, _)| *d == dimension)?;
        Some(if a == b { 1.0 } else { a / b })
    })
}

/// Whether a unit is known.
pub fn is_unit(unit: &str) -> bool {
    measures(unit).next().is_some()
}

/// The usual spelling of a unit; `None` if it is unknown or ambiguous.
pub fn usual_spelling(unit: &str) -> Option<&'static str> {
    let mut all = found(unit).filter_map(|(spellings, ..)| spellings.first().copied());
    all.next().filter(|_| all.next().is_none())
}

/// The usual spellings of the units that convert to `unit`.
pub fn convertible_to(unit: &str) -> Vec<&'static str> {
    let Some((dimension, _)) = measures(unit).next() else { return vec![] };
    UNITS.iter().filter(|(_, d, _)| *d == dimension).filter_map(|(spellings, ..)| spellings.first().copied()).collect()
}

/// Dimension of a unit and its size in base units. A spelling that two units share gives several results.
fn measures(unit: &str) -> impl Iterator<Item = (PhysicalDimension, f64)> + Clone {
    found(unit).map(|(_, d, f)| (*d, *f))
}

/// The units of a spelling; case does not matter, and `_` and `-` are blanks.
fn found(unit: &str) -> impl Iterator<Item = &'static (&'static [&'static str], PhysicalDimension, f64)> + Clone {
    let unit = unit.trim().to_lowercase().replace(['_', '-'], " ");
    UNITS.iter().filter(move |(spellings, ..)| spellings.iter().any(|s| s.to_lowercase() == unit))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_conversion_there_and_back_is_one() {
        for (a, b) in [("rad", "deg"), ("ft", "m"), ("uT", "nT"), ("kn", "m/s"), ("gauss", "nT"), ("rad/s", "deg/s")] {
            let (there, back) = (convert(a, b).unwrap_or(0.0), convert(b, a).unwrap_or(0.0));
            // Each of the two divisions rounds once.
            assert!((there * back - 1.0).abs() < 1e-15, "{a} {b}");
        }
        assert_eq!(convert("uT", "nT"), Some(1000.0));
        assert_eq!(convert("µT", "nT"), Some(1000.0));
        assert_eq!(convert("T", "nT"), Some(1e9));
        assert_eq!(convert("nT", "deg"), None);
        assert_eq!(convert("furlong", "m"), None);
        assert_eq!(convert("degC", "K"), None);
        assert_eq!((usual_spelling("nt"), usual_spelling("FEET"), usual_spelling("g")), (Some("nT"), Some("ft"), None));
    }

    #[test]
    fn ref_us_survey_feet_and_logger_spellings() {
        let spellings = ["ftUS", "FTUS", "US-ft", "us_ft", "ft_us", "sft", "usft", "US survey foot", "US_survey_feet"];
        for unit in spellings {
            assert_eq!(convert(unit, "m"), Some(1200.0 / 3937.0), "{unit}");
        }
        for (unit, to, factor) in [
            ("fps", "m/s", 0.3048),
            ("kts", "m/s", 1852.0 / 3600.0),
            ("km/hr", "m/s", 1.0 / 3.6),
            ("mi", "m", 1609.344),
            ("m s-1", "m/s", 1.0),
            ("m s-2", "m/s2", 1.0),
            ("gamma", "nT", 1.0),
            ("millibars", "hPa", 1.0),
        ] {
            assert_eq!(convert(unit, to), Some(factor), "{unit}");
        }
        assert_eq!((convert("degF", "degC"), convert("dms", "deg")), (None, None));
    }

    #[test]
    fn ref_g_means_gauss_or_gravity_by_dimension() {
        assert_eq!(convert("G", "nT"), Some(1e5));
        assert_eq!(convert("g", "m/s2"), Some(9.80665));
        assert_eq!(convertible_to("m/s2"), ["m/s2", "standard gravity", "mGal"]);
    }

    #[test]
    fn unit_a_spelling_has_one_unit_per_dimension() {
        for (i, (spellings, dimension, _)) in UNITS.iter().enumerate() {
            for (others, other, _) in UNITS.iter().skip(i + 1) {
                let shared = spellings.iter().any(|s| others.contains(s));
                assert!(!shared || dimension != other, "{spellings:?} {others:?}");
            }
        }
    }
}
