//! Maps: a regular grid of latitude and longitude, and the way there from a projected one.

use std::{path::Path, sync::Arc};

use arrow_array::{ArrayRef, Float64Array, RecordBatch};
use arrow_schema::Schema;
use schemas::map::shape;

use crate::ReadError;

mod crs;
mod interpolate;
mod projected;

pub use crs::Crs;
pub(crate) use projected::Projected;

/// An anomaly map on a regular grid, the contract's map table.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// One row a cell, by latitude then longitude, both ascending: `lat`, `lon` (deg), `alt` (m above
    /// the WGS-84 ellipsoid), `anomaly` (nT, NaN where unknown).
    pub batch: RecordBatch,
    /// How many latitudes there are.
    pub n_lat: usize,
    /// How many longitudes there are.
    pub n_lon: usize,
    /// What was done to the file's values on the way, in words.
    pub notes: Vec<String>,
}

/// The height of a map above the ellipsoid, in metres.
pub(crate) enum Height {
    /// One for all cells.
    Level(f64),
    /// One a cell, such as of a drape.
    Cells(Vec<f64>),
}

/// Largest departure of a coordinate from its even place, as a fraction of the step. Single-precision
/// degrees depart by 0.8 % of a step of 0.001° at 140°.
const EVENNESS: f64 = 0.01;

impl Map {
    /// A map of its axes in degrees and its values by rows: all longitudes of the first latitude, then
    /// of the next.
    ///
    /// # Errors
    /// An axis that is not even and ascending or leaves the earth, values of another number than the
    /// cells, values that are infinite or all unknown, a height that is not finite.
    pub(crate) fn new(
        path: &Path,
        lat_deg: &[f64],
        lon_deg: &[f64],
        height: Height,
        anomaly_nt: Vec<f64>,
        notes: Vec<String>,
    ) -> Result<Map, ReadError> {
        Axis::of(path, "lat", lat_deg)?;
        Axis::of(path, "lon", lon_deg)?;
        check_range(path, "lat", lat_deg, 90.0)?;
        check_range(path, "lon", lon_deg, 360.0)?;
        let (n_lat, n_lon) = (lat_deg.len(), lon_deg.len());
        check_values(path, &anomaly_nt, n_lat * n_lon)?;
        let alt = match height {
            Height::Level(alt_m) => vec![alt_m; n_lat * n_lon],
            Height::Cells(cells) => cells,
        };
        if alt.len() != n_lat * n_lon || alt.iter().any(|a| a.is_infinite()) {
            return Err(ReadError::data(path, "the map has a height that is no number").in_column("alt"));
        }
        let lat: Vec<f64> = lat_deg.iter().flat_map(|lat| std::iter::repeat_n(*lat, n_lon)).collect();
        let lon: Vec<f64> = std::iter::repeat_n(lon_deg, n_lat).flatten().copied().collect();
        let columns = [lat, lon, alt, anomaly_nt].map(|c| Arc::new(Float64Array::from(c)) as ArrayRef);
        let fields: Vec<_> = shape().columns.iter().map(schemas::Column::field).collect();
        let batch = RecordBatch::try_new(Arc::new(Schema::new(fields)), columns.to_vec());
        let batch = batch.map_err(|e| ReadError::data(path, e.to_string()))?;
        Ok(Map { batch, n_lat, n_lon, notes })
    }

    /// The values of a column, one a cell; empty for a name that is none of the four.
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

/// An even, ascending axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Axis {
    pub(crate) first: f64,
    pub(crate) step: f64,
    pub(crate) len: usize,
}

impl Axis {
    /// The axis that the coordinates make.
    pub(crate) fn of(path: &Path, name: &str, coordinates: &[f64]) -> Result<Axis, ReadError> {
        let wrong = |what: String| Err(ReadError::data(path, what).in_column(name));
        let (Some(first), Some(last), true) = (coordinates.first(), coordinates.last(), coordinates.len() > 1) else {
            return wrong(format!("a map needs two or more values along the axis, not {}", coordinates.len()));
        };
        let step = (last - first) / (coordinates.len() - 1) as f64;
        if !(step.is_finite() && step > 0.0) {
            return wrong(format!("the axis does not ascend from {first} to {last}"));
        }
        for (i, x) in coordinates.iter().enumerate() {
            let even = first + step * i as f64;
            // NaN is not even either.
            if x.is_nan() || (x - even).abs() > EVENNESS * step {
                return wrong(format!("the axis is not even: {x} stands where {even} is expected"));
            }
        }
        Ok(Axis { first: *first, step, len: coordinates.len() })
    }

    /// The coordinate of a node, which may be a fraction.
    pub(crate) fn at(&self, node: f64) -> f64 {
        self.first + self.step * node
    }

    /// The node, as a fraction, of a coordinate; `None` off the axis.
    pub(crate) fn node(&self, coordinate: f64) -> Option<f64> {
        // Rounding of a projection there and back must not lose the outermost nodes.
        const SLACK: f64 = 1e-6;
        let (node, last) = ((coordinate - self.first) / self.step, (self.len - 1) as f64);
        (-SLACK..=last + SLACK).contains(&node).then(|| node.clamp(0.0, last))
    }

    /// All coordinates.
    pub(crate) fn coordinates(&self) -> Vec<f64> {
        (0..self.len).map(|i| self.at(i as f64)).collect()
    }
}

fn check_range(path: &Path, name: &str, axis: &[f64], most: f64) -> Result<(), ReadError> {
    match axis.iter().find(|x| x.abs() > most) {
        Some(x) => Err(ReadError::data(path, format!("{x} degrees is not on the earth")).in_column(name)),
        None => Ok(()),
    }
}

/// Refuses values of the wrong number, infinite ones, and a map without any.
pub(crate) fn check_values(path: &Path, values: &[f64], cells: usize) -> Result<(), ReadError> {
    let wrong = |what: String| Err(ReadError::data(path, what).in_column("anomaly"));
    if values.len() != cells {
        return wrong(format!("the grid has {cells} cells and {} values", values.len()));
    }
    if let Some(i) = values.iter().position(|v| v.is_infinite()) {
        return wrong("the value is infinite".to_owned()).map_err(|e: ReadError| e.in_row(i as u64));
    }
    if values.iter().all(|v| v.is_nan()) { wrong("no cell has a value".to_owned()) } else { Ok(()) }
}

/// A scattered grid, one row a node in any order, as axes and values by rows (`y` ascending, then `x`). Each coordinate
/// comes with the name that the file has for it. Nodes left out are NaN.
///
/// # Errors
/// Coordinates that make no regular grid, or a node that is there twice.
pub(crate) fn from_nodes(
    path: &Path,
    (x_name, x): (&str, &[f64]),
    (y_name, y): (&str, &[f64]),
    columns: &[&[f64]],
) -> Result<Nodes, ReadError> {
    let axes = [(x_name, x), (y_name, y)].map(|(name, values)| {
        let mut unique = values.to_vec();
        unique.sort_by(f64::total_cmp);
        unique.dedup_by(|a, b| (*a - *b).abs() <= 1e-9 * b.abs().max(1.0));
        Axis::of(path, name, &unique).map(|axis| (axis, unique))
    });
    let [x_axis, y_axis] = axes;
    let ((x_axis, x_nodes), (y_axis, y_nodes)) = (x_axis?, y_axis?);
    let cells = x_axis.len.checked_mul(y_axis.len).filter(|n| *n <= x.len().saturating_mul(64));
    let Some(cells) = cells else {
        return Err(ReadError::data(path, "the coordinates make no regular grid").in_column(x_name));
    };
    let mut filled = vec![false; cells];
    let mut values = vec![vec![f64::NAN; cells]; columns.len()];
    for row in 0..x.len() {
        let node = |axis: &Axis, c: f64| axis.node(c).map(|n| n.round() as usize);
        let (Some(i), Some(j)) = (node(&x_axis, x[row]), node(&y_axis, y[row])) else { continue };
        let cell = j * x_axis.len + i;
        if std::mem::replace(&mut filled[cell], true) {
            return Err(ReadError::data(path, "the node is there twice").in_row(row as u64));
        }
        for (out, column) in values.iter_mut().zip(columns) {
            out[cell] = column[row];
        }
    }
    Ok(Nodes { x: x_nodes, y: y_nodes, x_axis, y_axis, values })
}

/// What [`from_nodes`] found.
pub(crate) struct Nodes {
    pub(crate) x: Vec<f64>,
    pub(crate) y: Vec<f64>,
    pub(crate) x_axis: Axis,
    pub(crate) y_axis: Axis,
    pub(crate) values: Vec<Vec<f64>>,
}

#[cfg(test)]
mod tests;
