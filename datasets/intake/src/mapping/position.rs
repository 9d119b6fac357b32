//! Positions in eastings and northings, converted to latitude and longitude.

use std::path::Path;

use datasets::{Crs, ReadError, coordinate_factor};
use schemas::Fault;

use super::{
    columns::{ColumnRecipe, MappingColumns},
    declare::ProjectedPositionKeys,
    document::SpannedValue,
    make::{ColumnRecipes, angle_fields},
};

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
        let place = self.crs.position(x, y).filter(|(_, lon)| self.crs.is_near_zone(*lon));
        place.ok_or_else(|| {
            let what = format!("easting {easting} and northing {northing} are not a position in {}", self.crs);
            Fault::data(what).help("check `easting`, `northing`, `epsg` and `unit` of `projected` in the mapping")
        })
    }
}

/// A fault of a coordinate system or a unit, without the file, because both are in the mapping.
fn without_file(error: ReadError) -> Fault {
    let fault = Fault::from(error);
    Fault { help: fault.help, ..Fault::new(fault.what) }
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
            columns.push(without_file(e).at(given.at("epsg")));
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
            columns.push(without_file(e).at(given.at("unit")));
            return;
        }
    };
    if !angle_fields(&keys.to, given, columns, made) {
        return;
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
        // Its WGS-84 position is 52 deg 39' 28.72" N, 1 deg 42' 57.79" E, reproduced within 3 m, the error of a datum
        // shift with seven parameters.
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
