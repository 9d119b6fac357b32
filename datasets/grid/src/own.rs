//! A map on its native grid, as the input of stages.

use std::sync::Arc;

use arrow_array::{Array, ArrayRef, Float64Array, Int64Array, RecordBatch};
use arrow_schema::Schema;
use numerics::maps::plane_grid::EvenAxis;
use rayon::prelude::*;
use schemas::map::NativeGrid;

use super::{AnomalyGrid, Crs, GridHeight, MapTable, WGS84};
use crate::ReadError;

/// Margin by which an area extends beyond its border nodes, as a fraction of the area's extent. Parallels are curved
/// between nodes, and rounding must not move a position on the edge out of the area.
const MARGIN: f64 = 0.01;

impl AnomalyGrid {
    /// The map as stages use it: the map table if its coordinates are WGS-84 degrees (within 1 m), else its native grid
    /// with eastings and northings ([`NativeGrid`]). Nothing is interpolated.
    ///
    /// # Errors
    /// Fails for coordinates that are invalid in their system. Also fails in the cases of [`AnomalyGrid::new`].
    pub fn table(&self) -> Result<RecordBatch, ReadError> {
        if self.crs.is_wgs84_at(self.middle().1, self.middle().0) {
            return Ok(MapTable::from_grid(self)?.batch);
        }
        self.check()?;
        self.check_anomaly()?;
        let [lat_deg, lon_deg] = self.area_deg()?;
        let (x, y) = self.unit_m();
        let (epsg, definition) = (self.crs.code(), self.crs.definition().to_owned());
        let own = NativeGrid { epsg, definition, unit_m: [x, y], lat_deg, lon_deg };
        let width = self.x.len;
        let northing = self.y.coordinates().iter().flat_map(|y| std::iter::repeat_n(*y, width)).collect();
        let easting = self.x.coordinates().repeat(self.y.len);
        let (mut fields, mut columns) =
            (own.fields(), vec![northing, easting, self.heights(), self.anomaly_nt.clone()]);
        if let Some(error_nt) = &self.error_nt {
            columns.push(error_nt.clone());
            fields.push(schemas::map::error_column().field());
        }
        let columns = columns.into_iter().map(|c: Vec<f64>| Arc::new(Float64Array::from(c)) as ArrayRef).collect();
        let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), columns);
        batch.map_err(|e| self.fault(e.to_string()))
    }

    /// An area that contains the map with a small margin, bounded by parallels and meridians.
    fn area_deg(&self) -> Result<[[f64; 2]; 2], ReadError> {
        let inside = |lat: f64| {
            let found = self.crs.project(lat, 0.0).filter(|_| !self.is_geographic());
            found.is_some_and(|(x, y)| within(&self.x, x) && within(&self.y, y))
        };
        let poles = [-90.0, 90.0].map(inside);
        if poles == [false, false] {
            let ((south, north), (west, east)) = self.bounds_deg()?;
            let (lat, lon) = (MARGIN * (north - south), MARGIN * (east - west));
            // At most 360 degrees.
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

/// The map in a table that [`AnomalyGrid::table`] made, in latitude and longitude: unchanged or resampled.
///
/// # Errors
/// Fails for a table that is not a map. Also fails in the cases of [`AnomalyGrid::to_geographic`].
pub fn geographic(table: &RecordBatch) -> Result<MapTable, ReadError> {
    AnomalyGrid::of_table(table)?.to_geographic()
}

impl AnomalyGrid {
    /// The map of a table that [`AnomalyGrid::table`] made.
    ///
    /// # Errors
    /// Fails for a table that is not a map.
    pub fn of_table(table: &RecordBatch) -> Result<AnomalyGrid, ReadError> {
        let own = NativeGrid::from_schema(&table.schema()).map_err(|e| wrong(e.to_string()))?;
        let (names, epsg) = match &own {
            Some(own) => (["easting", "northing"], own.epsg),
            None => (["lon", "lat"], WGS84),
        };
        of_nodes(table, names, epsg)
    }

    /// The map in the rows that [`AnomalyGrid::made`] wrote.
    ///
    /// # Errors
    /// Fails for rows that are not a map.
    pub fn of_made(rows: &RecordBatch) -> Result<AnomalyGrid, ReadError> {
        let codes = rows.column_by_name("epsg").and_then(|c| c.as_any().downcast_ref::<Int64Array>());
        let epsg = codes.filter(|c| !c.is_empty()).and_then(|c| u16::try_from(c.value(0)).ok());
        let epsg = epsg.ok_or_else(|| wrong("must be the EPSG code of a coordinate system").in_column("epsg"))?;
        let own = rows.column_by_name("easting").is_some_and(|c| c.null_count() == 0);
        of_nodes(rows, if own { ["easting", "northing"] } else { ["lon", "lat"] }, epsg)
    }

    /// The columns of a map that a stage makes ([`schemas::map::made_columns`]).
    ///
    /// # Errors
    /// Fails in the cases of [`AnomalyGrid::new`].
    pub fn made(&self) -> Result<Vec<ArrayRef>, ReadError> {
        self.check()?;
        let width = self.x.len;
        let x = self.x.coordinates().repeat(self.y.len);
        let y: Vec<f64> = self.y.coordinates().iter().flat_map(|y| std::iter::repeat_n(*y, width)).collect();
        let in_degrees = self.crs.is_wgs84_at(self.middle().1, self.middle().0);
        let place = |(x, y): (&f64, &f64)| self.crs.unproject(*x, *y).unwrap_or((f64::NAN, f64::NAN));
        let (lat, lon): (Vec<f64>, Vec<f64>) = match in_degrees {
            true => (y.clone(), x.clone()),
            false => x.par_iter().zip(&y).map(place).unzip(),
        };
        let numbers = |values: Vec<f64>| Arc::new(Float64Array::from(values)) as ArrayRef;
        let own = |values: Vec<f64>| {
            if in_degrees { Arc::new(Float64Array::new_null(values.len())) } else { numbers(values) }
        };
        let epsg = i64::from(if in_degrees { WGS84 } else { self.crs.code() });
        let epsg = Arc::new(Int64Array::from(vec![epsg; self.nodes()]));
        let (alt, anomaly) = (self.heights(), self.anomaly_nt.clone());
        Ok(vec![numbers(lat), numbers(lon), numbers(alt), numbers(anomaly), own(x), own(y), epsg])
    }
}

/// The map in a table with one row per node. The columns `x` and `y` hold the nodes' coordinates eastward and
/// northward, in the system `epsg`.
fn of_nodes(table: &RecordBatch, [x, y]: [&str; 2], epsg: u16) -> Result<AnomalyGrid, ReadError> {
    let column = |name: &str| {
        let found = table.column_by_name(name).and_then(|c| c.as_any().downcast_ref::<Float64Array>());
        found.map(|c| c.values().to_vec()).ok_or_else(|| wrong("must be a column of Float64").in_column(name))
    };
    let (x, y) = (column(x)?, column(y)?);
    let width = y.iter().take_while(|value| Some(*value) == y.first()).count().max(1);
    let axis = |first: Option<&f64>, last: Option<&f64>, len: usize| {
        let (first, last) = (first.copied().unwrap_or(f64::NAN), last.copied().unwrap_or(f64::NAN));
        EvenAxis { first, step: (last - first) / (len.max(2) - 1) as f64, len }
    };
    let crs = Crs::from_epsg(std::path::Path::new("map"), epsg)?;
    let (x, y) = (axis(x.first(), x.get(width - 1), width), axis(y.first(), y.last(), y.len() / width));
    let alt = column("alt")?;
    let level_m = alt.first().copied().unwrap_or(f64::NAN);
    let level = alt.iter().all(|a| *a == level_m || a.is_nan() && level_m.is_nan());
    let height = if level { GridHeight::Level(level_m) } else { GridHeight::Cells(alt) };
    let mut map = AnomalyGrid::new(x, y, crs, column("anomaly")?, height)?;
    if table.column_by_name(schemas::map::ERROR).is_some() {
        map.error_nt = Some(column(schemas::map::ERROR)?);
        map.check()?;
    }
    Ok(map)
}

fn wrong(what: impl Into<String>) -> ReadError {
    ReadError::data(std::path::Path::new("map"), what)
}
