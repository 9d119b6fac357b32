//! Recognises positions in eastings and northings.

use std::path::Path;

use datasets::{AnomalyGrid, Crs, ReadError};
use schemas::{convert, one_line};

use super::{
    TopicSample,
    columns::{declared_unit, has},
    quoted,
    sample::ColumnSample,
    wrapped,
};

/// Words of eastings and northings, also in German, French and Spanish.
const EASTING: [&str; 9] = ["easting", "eastings", "utme", "utmx", "east", "rechtswert", "ostwert", "est", "este"];
const NORTHING: [&str; 9] = ["northing", "northings", "utmn", "utmy", "north", "hochwert", "nordwert", "nord", "norte"];
/// Eastings and northings in metres: larger than offsets from a local origin, smaller than the earth.
const LARGE_M: std::ops::Range<f64> = 1e4..2e7;
/// Magnitude of earth-centred coordinates at flight heights, in metres.
const EARTH_CENTRED_M: std::ops::Range<f64> = 6.3e6..6.5e6;
/// EPSG code in the question about an unknown system.
const EXAMPLE_EPSG: u16 = 32754;

/// Columns of eastings and northings.
#[derive(Clone, Debug)]
pub struct ProjectedColumns {
    easting: String,
    northing: String,
    /// Unit that the file gives.
    unit: Option<String>,
    /// EPSG code and its reason, if the coordinate system is known.
    system: Option<(u16, String)>,
}

impl ProjectedColumns {
    /// Columns of eastings and northings of a table, recognised by their names and the size of their values.
    pub fn find(topic: &TopicSample, known: &KnownSystem) -> Option<ProjectedColumns> {
        let named = |words: &[&str], letters: [&str; 2]| {
            let large = |column| median_m(column).filter(|m| LARGE_M.contains(&m.abs())).map(|m| (column, m));
            let by_word = topic.columns.iter().filter(|c| has(&c.words(), words)).find_map(large);
            by_word.or_else(|| topic.columns.iter().filter(|c| is_letter(c, letters)).find_map(large))
        };
        let ((easting, x_m), (northing, y_m)) = (named(&EASTING, ["x", "e"])?, named(&NORTHING, ["y", "n"])?);
        if is_earth_centred(topic, x_m, y_m) {
            return None;
        }
        let unit = declared_unit(easting, "m").filter(|unit| declared_unit(northing, "m").as_ref() == Some(unit));
        Some(ProjectedColumns {
            easting: easting.name.clone(),
            northing: northing.name.clone(),
            unit,
            system: known.of_position(x_m, y_m),
        })
    }

    /// Lines of a mapping: the key, or the question and the key as a comment.
    pub fn text(&self) -> String {
        match &self.system {
            Some((epsg, why)) => format!("{}   # {why}\n", self.toml(*epsg)),
            None => format!("{}# {}\n", wrapped(&format!("? {}", self.question())), self.toml(EXAMPLE_EPSG)),
        }
    }

    /// Whether a column of the file is the easting or the northing.
    pub fn reads(&self, name: &str) -> bool {
        self.easting == name || self.northing == name
    }

    /// The question about the coordinate system, if it is unknown.
    pub fn open_question(&self) -> Option<String> {
        self.system.is_none().then(|| self.question())
    }

    fn toml(&self, epsg: u16) -> String {
        let unit = self.unit.as_ref().map_or(String::new(), |unit| format!(", unit = {}", quoted(unit)));
        let (easting, northing) = (quoted(&self.easting), quoted(&self.northing));
        format!("projected = {{ easting = {easting}, northing = {northing}, epsg = {epsg}{unit} }}")
    }

    fn question(&self) -> String {
        format!(
            "which coordinate system do the eastings `{}` and the northings `{}` have? Give its EPSG code with \
             `--epsg`, such as {EXAMPLE_EPSG} for UTM zone 54 south, or set `projected`",
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
    /// A map of the same area, from which the system is inferred.
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

    /// EPSG code of the system of a position in metres, and the reason: the given system, or else the map's own system
    /// or UTM zone if the position in it lies on the map.
    fn of_position(&self, x_m: f64, y_m: f64) -> Option<(u16, String)> {
        match self {
            KnownSystem::Unknown => None,
            KnownSystem::Given(crs) => Some((crs.code(), crs.name().to_owned())),
            KnownSystem::OfMap(map) => {
                let (lat, lon) = map.bounds_deg().ok()?;
                let middle = (0.5 * (lat.0 + lat.1), 0.5 * (lon.0 + lon.1));
                let own = (!map.crs.is_geographic()).then(|| map.crs.clone());
                let zone = Crs::utm_zone_of(middle.0, middle.1).ok();
                let on = |(low, high): (f64, f64), value: f64| (low..=high).contains(&value);
                let crs = own.into_iter().chain(zone).find(|crs| {
                    let place = crs.position(x_m / crs.unit_m(), y_m / crs.unit_m());
                    place.is_some_and(|place| on(lat, place.0) && on(lon, place.1))
                })?;
                Some((crs.code(), format!("guess: in {}, the positions are on the map", crs.name())))
            }
        }
    }
}

/// Whether the name of a column is one of `letters`, alone (`X`) or with words for a coordinate system (`UTM_X`).
fn is_letter(column: &ColumnSample, letters: [&str; 2]) -> bool {
    const SYSTEM: [&str; 6] = ["utm", "coord", "coordinate", "pos", "mga", "m"];
    let words = column.words();
    let rest: Vec<&String> = words.iter().filter(|word| !letters.contains(&word.as_str())).collect();
    rest.len() + 1 == words.len() && rest.iter().all(|word| SYSTEM.contains(&word.as_str()))
}

/// Median in metres; values without a unit are in metres.
fn median_m(column: &ColumnSample) -> Option<f64> {
    let factor = declared_unit(column, "m").and_then(|unit| convert(&unit, "m")).unwrap_or(1.0);
    Some(column.median()? * factor)
}

/// Whether a position is earth-centred: with a third component, its magnitude is about the radius of the earth.
fn is_earth_centred(topic: &TopicSample, x_m: f64, y_m: f64) -> bool {
    let third = topic.columns.iter().filter(|c| is_letter(c, ["z", "z"])).filter_map(median_m);
    third.map(|z_m| x_m.hypot(y_m).hypot(z_m)).any(|size_m| EARTH_CENTRED_M.contains(&size_m))
}
