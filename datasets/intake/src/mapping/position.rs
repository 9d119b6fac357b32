//! Positions in eastings and northings, converted to latitude and longitude.

use std::path::Path;

use arrow_schema::DataType;
use datasets::{Crs, coordinate_factor};
use schemas::{Fault, field, flight};

use super::{
    columns::{ColumnRecipe, MappingColumns},
    declare::ProjectedPositionKeys,
    document::SpannedValue,
    make::{ColumnRecipes, is_key},
};

/// Largest error of a conversion to degrees and back, in metres. The conversion of some old datums has 0.25 m.
const ROUND_TRIP_M: f64 = 1.0;
/// Largest difference between the longitude of a position and the central meridian of its UTM zone, in degrees. The
/// widest zone, 32V, extends 6 degrees to one side.
const UTM_REACH_DEG: f64 = 6.5;

/// Conversion of eastings and northings to WGS-84 degrees.
#[derive(Clone, Debug)]
pub struct ProjectedPosition {
    crs: Crs,
    /// Units of the coordinate system per unit of the file.
    factor: f64,
}

impl ProjectedPosition {
    /// Latitudes and longitudes in degrees. NaN where a coordinate is missing, or where both are 0, which receivers
    /// without a fix report.
    ///
    /// # Errors
    /// Fails for coordinates that are not a position in the coordinate system.
    pub fn degrees(&self, eastings: &[f64], northings: &[f64]) -> Result<[Vec<f64>; 2], Fault> {
        let mut places = [Vec::with_capacity(eastings.len()), Vec::with_capacity(eastings.len())];
        for (easting, northing) in eastings.iter().zip(northings) {
            let missing = !(easting.is_finite() && northing.is_finite()) || (*easting == 0.0 && *northing == 0.0);
            let (lat, lon) = if missing { (f64::NAN, f64::NAN) } else { self.one(*easting, *northing)? };
            places[0].push(lat);
            places[1].push(lon);
        }
        Ok(places)
    }

    fn one(&self, easting: f64, northing: f64) -> Result<(f64, f64), Fault> {
        let (x, y) = (easting * self.factor, northing * self.factor);
        let back = |(lat, lon): &(f64, f64)| {
            self.crs
                .project(*lat, *lon)
                .is_some_and(|(x2, y2)| (x2 - x).hypot(y2 - y) * self.crs.unit_m() < ROUND_TRIP_M)
        };
        let near = |(_, lon): &(f64, f64)| {
            let apart = |meridian: f64| ((lon - meridian + 180.0).rem_euclid(360.0) - 180.0).abs();
            utm_meridian_deg(&self.crs).is_none_or(|meridian| apart(meridian) < UTM_REACH_DEG)
        };
        let place = self.crs.unproject(x, y).filter(|place| place.0.abs() <= 90.0 && near(place) && back(place));
        place.ok_or_else(|| {
            let what = format!("easting {easting} and northing {northing} are not a position in {}", self.crs);
            Fault::data(what).help("check `easting`, `northing`, `epsg` and `unit` of `projected` in the mapping")
        })
    }
}

/// Central meridian of a UTM zone, from the definition of the system.
fn utm_meridian_deg(crs: &Crs) -> Option<f64> {
    let mut words = crs.definition().split_whitespace();
    let zone: f64 = words.find_map(|word| word.strip_prefix("+zone="))?.parse().ok()?;
    Some(zone * 6.0 - 183.0)
}

/// Adds the columns of latitude and longitude.
pub(super) fn one_position(
    given: &SpannedValue<ProjectedPositionKeys>,
    columns: &mut MappingColumns,
    made: &mut ColumnRecipes,
) {
    let keys = &given.value;
    let easting = columns.number(&keys.easting, given.at("easting"));
    let northing = columns.number(&keys.northing, given.at("northing"));
    let [_, _] = keys.to.as_slice() else {
        columns.push(Fault::new("`to` requires the names of two columns: latitude and longitude").at(given.at("to")));
        return;
    };
    let place = Path::new(&columns.place).to_owned();
    let crs = match Crs::from_epsg(&place, keys.epsg) {
        Ok(crs) if crs.is_geographic() => {
            let what = format!("{crs} is in degrees, not in eastings and northings");
            let help = "set `epsg` to the system of the eastings and northings, or map the columns in `columns`";
            columns.push(Fault::new(what).help(help).at(given.at("epsg")));
            return;
        }
        Ok(crs) => crs,
        Err(e) => {
            let fault = Fault::from(e);
            columns.push(Fault { help: fault.help, ..Fault::new(fault.what) }.at(given.at("epsg")));
            return;
        }
    };
    let (Some(easting), Some(northing)) = (easting, northing) else { return };
    let of_file = [easting, northing].map(|at| columns.unit_of_file(at));
    if of_file[0] != of_file[1] && keys.unit.is_none() {
        let what = "the easting and the northing have different units in the file";
        columns.push(Fault::new(what).help("set `unit`").at(given.at("easting")));
        return;
    }
    let unit = keys.unit.as_deref().or(of_file[0]).unwrap_or_default();
    let factor = match coordinate_factor(&place, unit, &crs, &mut made.notes) {
        Ok(factor) => factor,
        Err(e) => {
            let fault = Fault::from(e);
            columns.push(Fault { help: fault.help, ..Fault::new(fault.what) }.at(given.at("unit")));
            return;
        }
    };
    for name in &keys.to {
        if is_key(name, &given.at, columns) {
            return;
        }
        let known = flight::describe(name);
        if !known.unit.is_empty() && known.unit != "deg" {
            let what = format!("`{name}` is in {}, not an angle", known.unit);
            columns.push(Fault::new(what).at(given.at("to")));
        }
        made.fields.push((field(name, DataType::Float64, "deg", known.role, known.description), given.at.clone()));
    }
    made.notes.push(format!("`{}` and `{}` are converted from {crs}", keys.to[0], keys.to[1]));
    let position = Box::new(ProjectedPosition { crs, factor });
    made.outputs.push(ColumnRecipe::Projected { at: [easting, northing], position });
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn position(epsg: u16) -> ProjectedPosition {
        ProjectedPosition { crs: Crs::from_epsg(Path::new("x"), epsg).unwrap(), factor: 1.0 }
    }

    #[test]
    fn ref_positions_agree_with_published_coordinates() {
        // CN Tower: 43 deg 38' 33.24" N, 79 deg 23' 13.7" W is 17T 630084 m E, 4833438 m N (to the metre).
        let [lat, lon] = position(32617).degrees(&[630_084.0], &[4_833_438.0]).unwrap();
        assert!((lat[0] - 43.642_567).abs() < 2e-5 && (lon[0] + 79.387_139).abs() < 2e-5, "{lat:?} {lon:?}");
        // Ordnance Survey's worked example (Caister water tower) in Airy 1830 and OSGB36: E 651409.903, N 313177.270.
        // Its WGS-84 position is 52 deg 39' 28.72" N, 1 deg 42' 57.79" E, within the 3 m of seven parameters.
        let [lat, lon] = position(27700).degrees(&[651_409.903], &[313_177.270]).unwrap();
        assert!((lat[0] - 52.657_978).abs() < 5e-5 && (lon[0] - 1.716_052).abs() < 7e-5, "{lat:?} {lon:?}");
    }

    #[test]
    fn unit_missing_and_impossible_positions() {
        let utm = position(32754);
        let [lat, lon] = utm.degrees(&[f64::NAN, 0.0, 465_000.0], &[7.5e6, 0.0, 7.5e6]).unwrap();
        assert!(lat[0].is_nan() && lon[0].is_nan() && lat[1].is_nan() && lon[1].is_nan());
        assert!((lat[2] + 22.607).abs() < 0.01 && (lon[2] - 140.659).abs() < 0.01, "{lat:?} {lon:?}");
        // The two columns are exchanged.
        let fault = utm.degrees(&[7.5e6], &[465_000.0]).unwrap_err();
        assert!(fault.to_string().contains("not a position in"), "{fault}");
    }
}
