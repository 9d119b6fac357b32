//! Recognises positions in eastings and northings.

use std::path::Path;

use datasets::{AnomalyGrid, Crs, ReadError};
use schemas::{convert, one_line};

use super::{
    TopicSample,
    columns::{declared_unit, has},
    quoted,
    sample::ColumnSample,
};

/// Words of eastings and northings, also in German, French and Spanish.
const EASTING: [&str; 9] = ["easting", "eastings", "utme", "utmx", "east", "rechtswert", "ostwert", "est", "este"];
const NORTHING: [&str; 9] = ["northing", "northings", "utmn", "utmy", "north", "hochwert", "nordwert", "nord", "norte"];
/// Eastings and northings in metres: larger than offsets from a local origin, smaller than the earth.
const LARGE_M: std::ops::Range<f64> = 1e4..2e7;
/// Magnitude of earth-centred coordinates at flight heights, in metres.
const EARTH_CENTRED_M: std::ops::Range<f64> = 6.3e6..6.5e6;

/// Columns of eastings and northings.
#[derive(Clone, Debug)]
pub struct ProjectedColumns {
    /// Column of eastings.
    pub easting: String,
    /// Column of northings.
    pub northing: String,
    /// Unit that the file gives.
    unit: Option<String>,
    /// Median easting and northing, in metres.
    median_m: (f64, f64),
}

impl ProjectedColumns {
    /// Columns of eastings and northings of a table, recognised by their names and the size of their values.
    pub fn find(topic: &TopicSample) -> Option<ProjectedColumns> {
        let named = |words: &[&str], letters: [&str; 2]| {
            let by_word = topic.columns.iter().find(|c| has(&c.words(), words) && is_large(c));
            by_word.or_else(|| topic.columns.iter().find(|c| is_letter(c, letters) && is_large(c)))
        };
        let (easting, northing) = (named(&EASTING, ["x", "e"])?, named(&NORTHING, ["y", "n"])?);
        if is_earth_centred(topic, easting, northing) {
            return None;
        }
        let unit = declared_unit(easting, "m").filter(|unit| declared_unit(northing, "m").as_ref() == Some(unit));
        Some(ProjectedColumns {
            easting: easting.name.clone(),
            northing: northing.name.clone(),
            unit,
            median_m: (metres(easting)?, metres(northing)?),
        })
    }

    /// The line of a mapping, with a known EPSG code.
    pub fn toml(&self, epsg: u16) -> String {
        let unit = self.unit.as_ref().map_or(String::new(), |unit| format!(", unit = {}", quoted(unit)));
        let (easting, northing) = (quoted(&self.easting), quoted(&self.northing));
        format!("projected = {{ easting = {easting}, northing = {northing}, epsg = {epsg}{unit} }}")
    }

    /// The coordinate system and the reason: the given system, or a system of the map in which the median position is
    /// on the map.
    pub fn system(&self, known: &KnownSystem) -> Option<(u16, String)> {
        match known {
            KnownSystem::Unknown => None,
            KnownSystem::Given(crs) => Some((crs.code(), crs.name().to_owned())),
            KnownSystem::OfMap(map) => {
                let (lat, lon) = map.bounds_deg().ok()?;
                let middle = (0.5 * (lat.0 + lat.1), 0.5 * (lon.0 + lon.1));
                let own = (!map.crs.is_geographic()).then(|| map.crs.clone());
                let zone = Crs::utm_zone_of(middle.0, middle.1).ok();
                let crs = own.into_iter().chain(zone).find(|crs| {
                    let (x, y) = (self.median_m.0 / crs.unit_m(), self.median_m.1 / crs.unit_m());
                    let on = |(low, high): (f64, f64), value: f64| (low..=high).contains(&value);
                    crs.unproject(x, y).is_some_and(|place| on(lat, place.0) && on(lon, place.1))
                })?;
                Some((crs.code(), format!("guess: in {}, the positions are on the map", crs.name())))
            }
        }
    }

    /// Question about the coordinate system.
    pub fn question(&self) -> String {
        format!(
            "which coordinate system do the eastings `{}` and the northings `{}` have? Give its EPSG code with \
             `--epsg`, such as 32754 for UTM zone 54 south, or set `projected`",
            one_line(&self.easting),
            one_line(&self.northing)
        )
    }
}

/// Knowledge about the coordinate system of eastings and northings.
pub enum KnownSystem<'a> {
    /// None.
    Unknown,
    /// The system that the user gave.
    Given(Crs),
    /// The map of the same area.
    OfMap(&'a AnomalyGrid),
}

impl<'a> KnownSystem<'a> {
    /// The system of an EPSG code, otherwise of a map.
    ///
    /// # Errors
    /// Fails for an unknown code or a system in degrees.
    pub fn new(path: &Path, epsg: Option<u16>, map: Option<&'a AnomalyGrid>) -> Result<KnownSystem<'a>, ReadError> {
        let crs = epsg.map(|code| Crs::from_epsg(path, code)).transpose()?;
        match crs {
            Some(crs) if crs.is_geographic() => {
                let what = format!("{crs} is in degrees, not in eastings and northings");
                Err(ReadError::options(path, what).help("give the code of a projected system with `--epsg`"))
            }
            Some(crs) => Ok(KnownSystem::Given(crs)),
            None => Ok(map.map_or(KnownSystem::Unknown, KnownSystem::OfMap)),
        }
    }
}

/// Whether the name of a column is one of two letters, such as `X` or `UTM_X`.
fn is_letter(column: &ColumnSample, letters: [&str; 2]) -> bool {
    const SYSTEM: [&str; 6] = ["utm", "coord", "coordinate", "pos", "mga", "m"];
    let words = column.words();
    let rest: Vec<&String> = words.iter().filter(|word| !letters.contains(&word.as_str())).collect();
    rest.len() + 1 == words.len() && rest.iter().all(|word| SYSTEM.contains(&word.as_str()))
}

fn metres(column: &ColumnSample) -> Option<f64> {
    let factor = declared_unit(column, "m").and_then(|unit| convert(&unit, "m")).unwrap_or(1.0);
    Some(column.median()? * factor)
}

fn is_large(column: &ColumnSample) -> bool {
    metres(column).is_some_and(|m| LARGE_M.contains(&m.abs()))
}

/// Whether the columns have a third component, with which they are earth-centred coordinates.
fn is_earth_centred(topic: &TopicSample, x: &ColumnSample, y: &ColumnSample) -> bool {
    let third = topic.columns.iter().filter(|c| c.name != x.name && c.name != y.name && is_letter(c, ["z", "z"]));
    third.filter_map(metres).any(|z| {
        let size = |x: f64, y: f64| (x * x + y * y + z * z).sqrt();
        metres(x).zip(metres(y)).is_some_and(|(x, y)| EARTH_CENTRED_M.contains(&size(x, y)))
    })
}
