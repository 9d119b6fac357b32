//! Units: the few conversions that a reader makes, once.

/// The factor that turns a value in `from` into one in `to`, where both measure the same thing.
///
/// Spellings are compared without case; an unknown unit gives `None`.
pub fn convert(from: &str, to: &str) -> Option<f64> {
    let (a, b) = (measure(from)?, measure(to)?);
    (a.0 == b.0).then(|| if a.1 == b.1 { 1.0 } else { a.1 / b.1 })
}

/// What a unit measures, and how many base units it is.
fn measure(unit: &str) -> Option<(&'static str, f64)> {
    let known = match unit.trim().to_ascii_lowercase().as_str() {
        "nt" | "gamma" => ("field", 1.0),
        "ut" | "µt" | "μt" => ("field", 1e3),
        "mgauss" | "mg" => ("field", 1e2),
        "g" | "gauss" => ("field", 1e5),
        "mt" => ("field", 1e6),
        "t" => ("field", 1e9),
        "deg" | "degree" | "degrees" | "°" => ("angle", 1.0),
        "rad" | "radian" | "radians" => ("angle", 180.0 / std::f64::consts::PI),
        "deg/s" | "degps" | "°/s" => ("angular rate", 1.0),
        "rad/s" | "radps" => ("angular rate", 180.0 / std::f64::consts::PI),
        "m" | "metre" | "meter" | "metres" | "meters" => ("length", 1.0),
        "km" => ("length", 1e3),
        "ft" | "feet" | "foot" => ("length", 0.3048),
        "s" | "sec" | "second" | "seconds" => ("time", 1.0),
        "ms" => ("time", 1e-3),
        "us" | "µs" => ("time", 1e-6),
        "ns" => ("time", 1e-9),
        "m/s" | "mps" | "m s-1" => ("speed", 1.0),
        "km/h" => ("speed", 1.0 / 3.6),
        "kn" | "kt" | "knot" | "knots" => ("speed", 1852.0 / 3600.0),
        "m/s2" | "m/s^2" | "m/s²" => ("acceleration", 1.0),
        "a" | "ampere" => ("current", 1.0),
        "ma" => ("current", 1e-3),
        "v" | "volt" => ("voltage", 1.0),
        "mv" => ("voltage", 1e-3),
        _ => return None,
    };
    Some(known)
}

#[cfg(test)]
mod tests {
    use super::convert;

    #[test]
    fn law_conversion_there_and_back_is_one() {
        for (a, b) in [("rad", "deg"), ("ft", "m"), ("uT", "nT"), ("kn", "m/s"), ("gauss", "nT"), ("rad/s", "deg/s")] {
            let (there, back) = (convert(a, b).unwrap_or(0.0), convert(b, a).unwrap_or(0.0));
            // One rounding in each division.
            assert!((there * back - 1.0).abs() < 1e-15, "{a} {b}");
        }
        assert_eq!(convert("uT", "nT"), Some(1000.0));
        assert_eq!(convert("nT", "deg"), None);
        assert_eq!(convert("furlong", "m"), None);
    }
}
