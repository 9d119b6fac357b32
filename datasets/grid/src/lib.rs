//! Survey points, and maps on their native grid in any coordinate system or on a grid of latitude and longitude.
//! Formats read and write them, and map stages process them.

use std::{path::Path, sync::Arc};

use arrow_array::{ArrayRef, Float64Array, RecordBatch};
use arrow_schema::Schema;
use schemas::map::shape;

mod anomaly_grid;
mod crs;
mod error;
pub mod interpolate;
mod line_type;
pub mod longitude;
mod own;
mod resample;
mod summary;
mod survey_points;

pub use anomaly_grid::{AnomalyGrid, DERIVATIVES, GridHeight, NANOTESLA, Registration, node_on};
pub use crs::{Crs, WGS84, epsg_of_name, epsg_of_wkt, unit_of_wkt};
pub use error::ReadError;
pub use line_type::LineType;
pub use own::geographic;
pub use summary::{MapSummary, PERCENTILES, SummaryValue};
pub use survey_points::{ReductionColumns, SurveyPointSet, metres, no_metres, plane};

/// An anomaly map on a regular grid, as the canonical map table.
#[derive(Clone, Debug, PartialEq)]
pub struct MapTable {
    /// One row per node, by latitude then longitude, both ascending: `lat`, `lon` (deg), `alt` (m above
    /// the WGS-84 ellipsoid), `anomaly` (nT, NaN where unknown), and `error` (nT) if the map has it.
    pub batch: RecordBatch,
    /// The number of latitudes.
    pub n_lat: usize,
    /// The number of longitudes.
    pub n_lon: usize,
    /// Notes on the processing of the file's values.
    pub notes: Vec<String>,
}

impl MapTable {
    /// Converts a map in WGS-84 degrees to a table.
    pub(crate) fn from_grid(map: &AnomalyGrid) -> Result<MapTable, ReadError> {
        map.check()?;
        map.check_anomaly()?;
        let (n_lat, n_lon) = (map.y.len, map.x.len);
        let alt = map.heights();
        let lat: Vec<f64> = map.y.coordinates().iter().flat_map(|lat| std::iter::repeat_n(*lat, n_lon)).collect();
        let lon = map.x.coordinates().repeat(n_lat);
        let mut columns = vec![lat, lon, alt, map.anomaly_nt.clone()];
        let mut fields: Vec<_> = shape().columns.iter().map(schemas::Column::field).collect();
        if let Some(error_nt) = &map.error_nt {
            columns.push(error_nt.clone());
            fields.push(schemas::map::error_column().field());
        }
        let columns = columns.into_iter().map(|c| Arc::new(Float64Array::from(c)) as ArrayRef).collect();
        let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), columns);
        let batch = batch.map_err(|e| map.fault(e.to_string()))?;
        Ok(MapTable { batch, n_lat, n_lon, notes: map.notes.clone() })
    }

    /// The values of a column, one per node; empty for an unknown name.
    pub fn column(&self, name: &str) -> &[f64] {
        let column = self.batch.column_by_name(name).and_then(|c| c.as_any().downcast_ref::<Float64Array>());
        column.map_or(&[], |c| c.values())
    }

    /// The latitudes of the rows, in degrees.
    pub fn latitudes_deg(&self) -> Vec<f64> {
        self.column("lat").iter().step_by(self.n_lon).copied().collect()
    }

    /// The longitudes of the columns, in degrees.
    pub fn longitudes_deg(&self) -> Vec<f64> {
        self.column("lon").iter().take(self.n_lon).copied().collect()
    }
}

/// Checks that there is one value per node.
///
/// # Errors
/// Fails if there are more or fewer values.
pub fn check_count(path: &Path, values: usize, nodes: usize) -> Result<(), ReadError> {
    if values == nodes {
        return Ok(());
    }
    Err(ReadError::data(path, format!("the grid has {nodes} nodes, but {values} values")).in_column("anomaly"))
}

/// Rejects a wrong number of values, infinite values, and a map without a known value.
///
/// # Errors
/// Fails for each of these.
pub fn check_values(path: &Path, values: &[f64], nodes: usize) -> Result<(), ReadError> {
    check_count(path, values.len(), nodes)?;
    let wrong = |what: &str| ReadError::data(path, what).in_column("anomaly");
    if let Some(i) = values.iter().position(|v| v.is_infinite()) {
        return Err(wrong("the value is infinite").in_row(i as u64));
    }
    if values.iter().all(|v| v.is_nan()) { Err(wrong("the map has no known value")) } else { Ok(()) }
}
