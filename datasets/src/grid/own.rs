//! A map on its own grid, as the input of stages.

use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, RecordBatch};
use arrow_schema::Schema;
use numerics::maps::plane_grid::EvenAxis;
use schemas::map::OwnGrid;

use super::{Crs, GridMap, Height, Map};
use crate::ReadError;

/// How much of its extent an area is wider than its border's nodes: a parallel bulges between them, and a place on the
/// edge must not be lost to rounding.
const MARGIN: f64 = 0.01;

impl GridMap {
    /// The map as stages use it: the map table where its coordinates are degrees of WGS-84 (within a metre),
    /// else its own nodes with their eastings and northings ([`OwnGrid`]). Nothing is interpolated.
    ///
    /// # Errors
    /// Fails for coordinates that are no place in their system, and as [`GridMap::new`].
    pub fn table(&self) -> Result<RecordBatch, ReadError> {
        if self.crs.is_wgs84_at(self.middle().1, self.middle().0) {
            return Ok(Map::of(self)?.batch);
        }
        self.check()?;
        self.check_anomaly()?;
        let [lat_deg, lon_deg] = self.area_deg()?;
        let (x, y) = self.unit_m();
        let (epsg, definition) = (self.crs.code(), self.crs.definition().to_owned());
        let own = OwnGrid { epsg, definition, unit_m: [x, y], lat_deg, lon_deg };
        let width = self.x.len;
        let northing = self.y.coordinates().iter().flat_map(|y| std::iter::repeat_n(*y, width)).collect();
        let easting = self.x.coordinates().repeat(self.y.len);
        let columns = [northing, easting, self.heights(), self.anomaly_nt.clone()];
        let columns = columns.map(|c: Vec<f64>| Arc::new(Float64Array::from(c)) as ArrayRef);
        let batch = RecordBatch::try_new(Arc::new(Schema::new(own.fields())), columns.to_vec());
        batch.map_err(|e| self.fault(e.to_string()))
    }

    /// An area that holds the map, a little wider than its border: parallels and meridians.
    fn area_deg(&self) -> Result<[[f64; 2]; 2], ReadError> {
        let inside = |lat: f64| {
            let found = self.crs.project(lat, 0.0).filter(|_| !self.is_geographic());
            found.is_some_and(|(x, y)| within(&self.x, x) && within(&self.y, y))
        };
        let poles = [-90.0, 90.0].map(inside);
        if poles == [false, false] {
            let ((south, north), (west, east)) = self.bounds_deg()?;
            let (lat, lon) = (MARGIN * (north - south), MARGIN * (east - west));
            // Once round is all there is.
            let lon = lon.min(0.5 * (360.0 - (east - west)).max(0.0));
            return Ok([[(south - lat).max(-90.0), (north + lat).min(90.0)], [west - lon, east + lon]]);
        }
        let latitude = |(x, y): (f64, f64)| match self.crs.unproject(x, y) {
            Some((lat, _)) => Ok(lat),
            None => Err(self.no_place(x, y, &self.crs)),
        };
        let lat = self.outline().into_iter().map(latitude).collect::<Result<Vec<f64>, ReadError>>()?;
        let (south, north) = lat.iter().fold((90.0_f64, -90.0_f64), |ends, lat| (ends.0.min(*lat), ends.1.max(*lat)));
        let margin = MARGIN * (north - south);
        let south = if poles[0] { -90.0 } else { (south - margin).max(-90.0) };
        let north = if poles[1] { 90.0 } else { (north + margin).min(90.0) };
        Ok([[south, north], [-180.0, 180.0]])
    }
}

fn within(axis: &EvenAxis, coordinate: f64) -> bool {
    (axis.first..=axis.last()).contains(&coordinate)
}

/// The contract's map of a table that [`GridMap::table`] made: unchanged, or resampled to latitude and longitude.
///
/// # Errors
/// Fails for a table that is no map, and as [`GridMap::to_geographic`].
pub fn geographic(table: &RecordBatch) -> Result<Map, ReadError> {
    let wrong = |e: String| ReadError::data(std::path::Path::new("map"), e);
    let own = OwnGrid::of(&table.schema()).map_err(|e| wrong(e.to_string()))?;
    let column = |name: &str| {
        let found = table.column_by_name(name).and_then(|c| c.as_any().downcast_ref::<Float64Array>());
        found.map(|c| c.values().to_vec()).ok_or_else(|| wrong("is not a column of numbers".to_owned()).in_column(name))
    };
    let names = if own.is_some() { ["northing", "easting"] } else { ["lat", "lon"] };
    let (y, x) = (column(names[0])?, column(names[1])?);
    let width = y.iter().take_while(|value| Some(*value) == y.first()).count().max(1);
    let Some(own) = own else {
        return Ok(Map { batch: table.clone(), n_lat: y.len() / width, n_lon: width, notes: vec![] });
    };
    let axis = |first: Option<&f64>, last: Option<&f64>, len: usize| {
        let (first, last) = (first.copied().unwrap_or(f64::NAN), last.copied().unwrap_or(f64::NAN));
        EvenAxis { first, step: (last - first) / (len.max(2) - 1) as f64, len }
    };
    let crs = Crs::from_epsg(std::path::Path::new("map"), own.epsg)?;
    let (x, y) = (axis(x.first(), x.get(width - 1), width), axis(y.first(), y.last(), y.len() / width));
    let alt = column("alt")?;
    let level_m = alt.first().copied().unwrap_or(f64::NAN);
    let level = alt.iter().all(|a| *a == level_m || a.is_nan() && level_m.is_nan());
    let height = if level { Height::Level(level_m) } else { Height::Cells(alt) };
    GridMap::new(x, y, crs, column("anomaly")?, height)?.to_geographic()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::{MapOptions, read_grid, read_map, samples};

    #[test]
    fn law_a_projected_map_goes_to_the_stages_as_it_is() {
        let path = samples::path("osborne/osborne_anomaly_100m_at_500m.tif");
        let grid = read_grid(&path, &MapOptions::default()).unwrap();
        let table = grid.table().unwrap();
        let column = |name: &str| {
            let column = table.column_by_name(name).unwrap().as_any().downcast_ref::<Float64Array>().unwrap();
            column.values().to_vec()
        };
        assert_eq!(column("anomaly").len(), grid.anomaly_nt.len());
        let same = |a: &f64, b: &f64| a == b || a.is_nan() && b.is_nan();
        assert!(column("anomaly").iter().zip(&grid.anomaly_nt).all(|(a, b)| same(a, b)));
        assert!(column("alt").iter().all(|a| *a == 500.0));
        assert_eq!((column("easting")[1], column("northing")[1]), (grid.x.at(1.0), grid.y.first));
        let own = OwnGrid::of(&table.schema()).unwrap().unwrap();
        assert_eq!((own.epsg, own.unit_m), (32754, [1.0, 1.0]));
        for (x, y) in grid.outline() {
            let (lat, lon) = grid.crs.unproject(x, y).unwrap();
            assert!(own.lat_deg[0] < lat && lat < own.lat_deg[1] && own.lon_deg[0] < lon && lon < own.lon_deg[1]);
        }
        // And back to what is drawn, the contract's table.
        assert_eq!(geographic(&table).unwrap().batch, read_map(&path, &MapOptions::default()).unwrap().batch);
    }

    #[test]
    fn law_a_map_in_degrees_stays_the_contracts_table() {
        let path = samples::path("simple_magnav/map.h5");
        let (grid, map) =
            (read_grid(&path, &MapOptions::default()).unwrap(), read_map(&path, &MapOptions::default()).unwrap());
        assert_eq!(grid.table().unwrap(), map.batch);
        assert_eq!(geographic(&map.batch).unwrap().batch, map.batch);
    }

    #[test]
    fn law_a_map_around_a_pole_goes_to_the_stages_too() {
        let crs = Crs::from_epsg(std::path::Path::new("map"), 3413).unwrap();
        let axis = EvenAxis { first: -300_000.0, step: 50_000.0, len: 13 };
        let grid = GridMap::new(axis, axis, crs, vec![1.0; 169], Height::Level(1000.0)).unwrap();
        let own = OwnGrid::of(&grid.table().unwrap().schema()).unwrap().unwrap();
        assert_eq!((own.lat_deg[1], own.lon_deg), (90.0, [-180.0, 180.0]));
        assert!(own.lat_deg[0] < 87.0 && own.lat_deg[0] > 84.0, "{:?}", own.lat_deg);
        assert!(grid.to_geographic().is_err());
    }
}
