//! The unit of coordinates in a file, and its conversion to the unit of the coordinate system.

use std::path::Path;

use schemas::convert;

use crate::ReadError;
use grids::Crs;

/// The unit of coordinates.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum AxisUnit {
    /// An angle: degrees per unit.
    Angle(f64),
    /// A length: its name in the file, and metres per unit.
    Length(String, f64),
}

/// Source of the coordinate system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CrsSource {
    /// The options, which override the file.
    Given,
    /// The file, which also gives the unit.
    File,
}

const US_FOOT: f64 = 1200.0 / 3937.0;

/// Spellings of lengths in addition to those of `schemas`, with blanks for `_` and `-`, and metres per unit.
const LENGTHS: [(&[&str], f64); 9] = [
    (&["kilometre", "kilometer", "kilometres", "kilometers", "kms"], 1000.0),
    (
        &[
            "us survey foot",
            "us survey feet",
            "us survey ft",
            "survey foot",
            "survey feet",
            "foot us",
            "feet us",
            "us foot",
            "us feet",
            "us ft",
            "usft",
            "ftus",
            "ft us",
            "sft",
        ],
        US_FOOT,
    ),
    (&["international foot", "international feet", "foot intl", "ft intl"], 0.3048),
    (&["clarke's foot", "foot clarke"], 0.304_797_265_4),
    (&["yard", "yards", "yd"], 0.9144),
    (&["mile", "miles", "mi", "statute mile"], 1609.344),
    (&["nautical mile", "nautical miles", "nm"], 1852.0),
    (&["chain", "chains", "ch"], 20.1168),
    (&["fathom", "fathoms"], 1.8288),
];

/// Strings without a unit.
const NOTHING: [&str; 12] =
    ["", "1", "none", "unknown", "user x unit", "user y unit", "x", "y", "x units", "y units", "natural", "raw"];

/// Two units of length count as equal if their relative difference is smaller, as for the survey foot and the
/// international foot.
const SAME: f64 = 1e-5;

impl AxisUnit {
    /// The unit of a string; `Ok(None)` for a string without a unit.
    ///
    /// # Errors
    /// Fails for an unknown unit.
    pub(crate) fn read(path: &Path, column: &str, text: &str) -> Result<Option<AxisUnit>, ReadError> {
        if NOTHING.contains(&plain(text).as_str()) {
            return Ok(None);
        }
        AxisUnit::from_text(text).map(Some).ok_or_else(|| {
            ReadError::data(path, format!("the unit `{}` of the coordinates is unknown", text.trim()))
                .in_column(column)
                .help("convert the coordinates to m, km, ft, US survey feet or degrees, and name that unit in the file")
        })
    }

    /// The common unit of two coordinates.
    ///
    /// # Errors
    /// Fails for different units.
    pub(crate) fn of_both(
        path: &Path,
        x: Option<AxisUnit>,
        y: Option<AxisUnit>,
    ) -> Result<Option<AxisUnit>, ReadError> {
        let size = |unit: &AxisUnit| match unit {
            AxisUnit::Angle(deg) => (true, *deg),
            AxisUnit::Length(_, m) => (false, *m),
        };
        match (x, y) {
            (Some(x), Some(y)) if size(&x) != size(&y) => {
                let what = format!("the coordinates are in two units, {} and {}", x.name(), y.name());
                Err(ReadError::data(path, what).help("convert both to one unit"))
            }
            (x, y) => Ok(x.or(y)),
        }
    }

    fn name(&self) -> &str {
        match self {
            AxisUnit::Angle(_) => "degrees",
            AxisUnit::Length(name, _) => name,
        }
    }

    /// The unit of a string; `None` for an unknown unit.
    pub(crate) fn from_text(text: &str) -> Option<AxisUnit> {
        let (_, inside) = bracketed(text).unwrap_or(("", ""));
        if let Some(unit) = Some(inside).filter(|t| !t.is_empty()).and_then(AxisUnit::from_text) {
            // Unit in the form of GMT: `longitude [degrees_east]`.
            return Some(unit);
        }
        let name = plain(text);
        if let Some((count, unit)) = name.split_once(' ').and_then(|(n, u)| Some((n.parse::<f64>().ok()?, u))) {
            // Foot in the form of NetCDF: `0.3048 m`.
            let scaled = |unit: AxisUnit| match unit {
                AxisUnit::Angle(deg) => AxisUnit::Angle(count * deg),
                AxisUnit::Length(_, m) => AxisUnit::Length(text.trim().to_owned(), count * m),
            };
            return AxisUnit::from_text(unit).map(scaled).filter(|_| count.is_finite() && count > 0.0);
        }
        let angle = ["degree", "degrees", "deg"]
            .iter()
            .any(|d| name.strip_prefix(d).is_some_and(|rest| ["", " east", " north", " e", " n"].contains(&rest)));
        if angle {
            return Some(AxisUnit::Angle(1.0));
        }
        let length = |metres: f64| AxisUnit::Length(text.trim().to_owned(), metres);
        let known = LENGTHS.iter().find(|(names, _)| names.contains(&name.as_str())).map(|(_, m)| length(*m));
        let known = known.or_else(|| convert(&name, "m").map(length));
        known.or_else(|| convert(&name, "deg").map(AxisUnit::Angle))
    }

    /// The factor that converts coordinates to the unit of a system.
    ///
    /// # Errors
    /// Fails for lengths in a system of degrees and for degrees in a projected system. Also fails for feet in a system
    /// of metres, or the reverse, if the file gives both the unit and the system.
    pub(crate) fn to_system(
        &self,
        path: &Path,
        crs: &Crs,
        origin: CrsSource,
        notes: &mut Vec<String>,
    ) -> Result<f64, ReadError> {
        let contradiction = |declared: &str, help: String| {
            let what = format!("the coordinates are in {declared}, but {crs} is in {}", unit_of(crs));
            Err(ReadError::data(path, what).help(help))
        };
        match self {
            AxisUnit::Angle(deg) if crs.is_geographic() => Ok(*deg),
            AxisUnit::Angle(_) => {
                contradiction("degrees", "set `epsg` to a coordinate system in degrees, such as 4326".to_owned())
            }
            AxisUnit::Length(name, _) if crs.is_geographic() => {
                contradiction(name, "set `epsg` to the coordinate system of the eastings and northings".to_owned())
            }
            AxisUnit::Length(name, metres) => {
                let factor = metres / crs.unit_m();
                if (factor - 1.0).abs() < SAME {
                    return Ok(1.0);
                }
                // A decimal multiple of the metre fits any system in metres; a foot contradicts such a system.
                let decimal = metres.log10().fract().abs() < 1e-12 && crs.unit_m() == 1.0;
                if origin == CrsSource::File && !decimal {
                    let help = format!(
                        "set `epsg` = {} to confirm the system; the coordinates are then converted",
                        crs.code()
                    );
                    return contradiction(name, help);
                }
                let unit = unit_of(crs);
                let name = if name.starts_with(|c: char| c.is_ascii_digit()) { "that unit" } else { name.as_str() };
                notes.push(format!("coordinates in {name} are multiplied by {factor} to give {unit}"));
                Ok(factor)
            }
        }
    }
}

/// The factor that converts coordinates from the unit `unit` to the unit of a system; 1 if `unit` is empty. A
/// conversion is recorded in `notes`.
///
/// # Errors
/// Fails for an unknown unit, degrees in a projected system, or a length in a system of degrees.
pub fn coordinate_factor(path: &Path, unit: &str, crs: &Crs, notes: &mut Vec<String>) -> Result<f64, ReadError> {
    let unit = AxisUnit::read(path, "unit", unit)?;
    unit.map_or(Ok(1.0), |unit| unit.to_system(path, crs, CrsSource::Given, notes))
}

fn unit_of(crs: &Crs) -> String {
    match crs.unit_m() {
        _ if crs.is_geographic() => "degrees".to_owned(),
        1.0 => "m".to_owned(),
        unit => format!("units of {unit} m"),
    }
}

/// The text in lower case, with single blanks instead of all word separators.
fn plain(text: &str) -> String {
    let words = text.trim().trim_matches('"').to_lowercase().replace(['_', '-', '.'], " ");
    // A decimal point is not a separator.
    let words = if text.trim().starts_with(|c: char| c.is_ascii_digit()) { text.trim().to_lowercase() } else { words };
    words.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A string without the brackets at its end, and the text in the brackets.
fn bracketed(text: &str) -> Option<(&str, &str)> {
    [('(', ')'), ('[', ']'), ('{', '}')].into_iter().find_map(|(open, close)| {
        let (base, inside) = text.trim().strip_suffix(close)?.rsplit_once(open)?;
        Some((base.trim_end_matches([' ', '_']), inside.trim()))
    })
}

/// A name without the unit at its end, and that unit: `X (ft)`, `easting_km`, `Northing [m]`. The unit is empty if the
/// name has none. An unknown word in brackets remains in the name.
pub(crate) fn split_unit(name: &str) -> (&str, &str) {
    let name = name.trim();
    let end = || {
        (1..=3).rev().find_map(|words| {
            let at = name.char_indices().rev().filter(|(_, c)| ['_', ' '].contains(c)).nth(words - 1)?.0;
            let (base, end) = (name.get(..at)?, name.get(at + 1..)?);
            AxisUnit::from_text(end).map(|_| (base.trim_end_matches([' ', '_']), end))
        })
    };
    let found = bracketed(name).filter(|(_, unit)| AxisUnit::from_text(unit).is_some()).or_else(end);
    found.filter(|(base, _)| !base.is_empty()).unwrap_or((name, ""))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn ref_spellings_of_units_of_coordinates() {
        let metres = |text: &str| match AxisUnit::from_text(text) {
            Some(AxisUnit::Length(_, m)) => m,
            other => panic!("{text}: {other:?}"),
        };
        for (text, m) in [
            ("m", 1.0),
            ("Metre", 1.0),
            ("km", 1000.0),
            ("Kilometers", 1000.0),
            ("US_survey_foot", US_FOOT),
            ("US survey foot", US_FOOT),
            ("ftUS", US_FOOT),
            ("us-ft", US_FOOT),
            ("Foot_US", US_FOOT),
            ("ft", 0.3048),
            ("foot", 0.3048),
            ("0.3048 m", 0.3048),
            ("1000 metre", 1000.0),
            ("yd", 0.9144),
        ] {
            assert!((metres(text) - m).abs() < 1e-12, "{text}");
        }
        for text in ["degrees_east", "degree_north", "deg", "degrees"] {
            assert_eq!(AxisUnit::from_text(text), Some(AxisUnit::Angle(1.0)), "{text}");
        }
        assert!(AxisUnit::from_text("furlong").is_none() && AxisUnit::from_text("nT").is_none());
        assert!(AxisUnit::read(Path::new("a"), "x", "user_x_unit").unwrap().is_none());
        let fault = AxisUnit::read(Path::new("a"), "x", "furlong").unwrap_err().to_string();
        assert!(fault.contains("column `x`: the unit `furlong` of the coordinates is unknown"), "{fault}");
    }

    #[test]
    fn unit_names_of_columns_end_in_units() {
        for (name, parts) in [
            ("X (ft)", ("X", "ft")),
            ("easting_km", ("easting", "km")),
            ("Northing [m]", ("Northing", "m")),
            ("UTM_X_US_survey_foot", ("UTM_X", "US_survey_foot")),
            ("east_us_ft", ("east", "us_ft")),
            ("x", ("x", "")),
            ("X (GDA94)", ("X (GDA94)", "")),
            ("utm_e", ("utm_e", "")),
            ("m", ("m", "")),
        ] {
            assert_eq!(split_unit(name), parts, "{name}");
        }
    }

    #[test]
    fn unit_units_that_contradict_the_system_are_rejected() {
        let path = Path::new("a");
        let utm = Crs::from_epsg(path, 32754).unwrap();
        let (feet, km) = (AxisUnit::from_text("US_survey_foot").unwrap(), AxisUnit::from_text("km").unwrap());
        let notes = &mut vec![];
        assert!((feet.to_system(path, &utm, CrsSource::Given, notes).unwrap() - US_FOOT).abs() < 1e-12);
        assert_eq!(km.to_system(path, &utm, CrsSource::File, notes).unwrap(), 1000.0);
        let fault = feet.to_system(path, &utm, CrsSource::File, notes).unwrap_err().to_string();
        assert!(fault.contains("in US_survey_foot, but EPSG:32754") && fault.contains("`epsg` = 32754"), "{fault}");
        assert!(AxisUnit::Angle(1.0).to_system(path, &utm, CrsSource::Given, notes).is_err());
        assert!(km.to_system(path, &Crs::wgs84().unwrap(), CrsSource::Given, notes).is_err());
        let state = Crs::from_epsg(path, 2263).unwrap();
        assert_eq!(feet.to_system(path, &state, CrsSource::File, notes).unwrap(), 1.0);
        assert!(AxisUnit::from_text("m").unwrap().to_system(path, &state, CrsSource::File, notes).is_err());
    }
}
