//! Grid: evenly spaced, ascending axes and the node values.

use super::holes::GridShape;
use crate::earth::geodesy::EarthModel;
use crate::maps::plane_grid::{EvenAxis, PlaneGrid};
use thiserror::Error;

/// Largest deviation of a node from its evenly spaced position, as a fraction of the step. Coordinates stored in single
/// precision deviate by 0.8 % of a step of 0.001° at 140°.
const EVENNESS: f64 = 0.01;

/// Error of a table or columns that do not form a map.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum MapGridError {
    /// An axis has fewer than two nodes.
    #[error("the map has {count} {axis}(s); at least two are required")]
    TooSmall {
        /// `latitude` or `longitude`.
        axis: &'static str,
        /// The number of distinct nodes.
        count: usize,
    },
    /// A coordinate is missing or infinite.
    #[error("{axis} {node} of the map is {value_deg}, not a finite number")]
    NotFinite {
        /// `latitude` or `longitude`.
        axis: &'static str,
        /// Position along the axis, from 0.
        node: usize,
        /// The coordinate.
        value_deg: f64,
    },
    /// An axis does not ascend.
    #[error("the map's {axis}s must ascend, but {axis} {node} is {value_deg} after {before_deg}")]
    NotAscending {
        /// `latitude` or `longitude`.
        axis: &'static str,
        /// Position along the axis, from 0.
        node: usize,
        /// The previous coordinate.
        before_deg: f64,
        /// The coordinate.
        value_deg: f64,
    },
    /// An axis has uneven steps.
    #[error(
        "the map's {axis}s must have even steps: {axis} {node} is {value_deg}, \
         {off_by_steps:.3} of a step away from its evenly spaced position {even_deg}"
    )]
    Uneven {
        /// `latitude` or `longitude`.
        axis: &'static str,
        /// Position along the axis, from 0.
        node: usize,
        /// The coordinate.
        value_deg: f64,
        /// Coordinate that the node would have with even steps.
        even_deg: f64,
        /// The difference, in steps.
        off_by_steps: f64,
    },
    /// A latitude is beyond a pole, or the longitudes span more than a full turn.
    #[error("the map's {axis}s run from {first_deg} to {last_deg} degrees, outside the valid range")]
    Range {
        /// `latitude` or `longitude`.
        axis: &'static str,
        /// The first coordinate.
        first_deg: f64,
        /// The last coordinate.
        last_deg: f64,
    },
    /// The number of values differs from the number of nodes.
    #[error("the map has {values} values for {latitudes} latitudes x {longitudes} longitudes")]
    Size {
        /// The number of values.
        values: usize,
        /// The number of latitudes.
        latitudes: usize,
        /// The number of longitudes.
        longitudes: usize,
    },
    /// The columns of a table of nodes have different lengths.
    #[error("the map's columns have {lat} latitudes, {lon} longitudes and {anomaly} anomalies")]
    Columns {
        /// Number of rows in the latitude column.
        lat: usize,
        /// Number of rows in the longitude column.
        lon: usize,
        /// Number of rows in the anomaly column.
        anomaly: usize,
    },
    /// A row of a table of nodes is not at its position in a complete grid.
    #[error(
        "row {row} of the map is at latitude {lat_deg}, longitude {lon_deg}, but must be at \
         latitude {expected_lat_deg}, longitude {expected_lon_deg} in a complete grid sorted by latitude, then \
         longitude"
    )]
    Row {
        /// The row, from 0.
        row: usize,
        /// Latitude.
        lat_deg: f64,
        /// Longitude.
        lon_deg: f64,
        /// The latitude of that row in a complete grid.
        expected_lat_deg: f64,
        /// The longitude of that row in a complete grid.
        expected_lon_deg: f64,
    },
    /// A value is infinite.
    #[error("the anomaly in row {row} of the map is infinite; use NaN for an unknown value")]
    Infinite {
        /// The number of the row, from 0. The rows are sorted by latitude, then longitude.
        row: usize,
    },
    /// Every value is unknown.
    #[error("every value of the map is NaN")]
    Empty,
    /// The companion of a map (its vertical derivative or its heights) does not match its nodes.
    #[error("the map has {nodes} nodes, but its {companion} has {values} values")]
    CompanionSize {
        /// Kind of the companion: `vertical derivative` or `height`.
        companion: &'static str,
        /// Nodes of the map.
        nodes: usize,
        /// Values of the companion.
        values: usize,
    },
    /// The companion of a map is not a finite number at a known node.
    #[error("the {companion} in row {row} of the map is {value}, but the anomaly there is known")]
    CompanionValue {
        /// Kind of the companion: `vertical derivative` or `height`.
        companion: &'static str,
        /// The number of the row, from 0. The rows are sorted by latitude, then longitude.
        row: usize,
        /// The value.
        value: f64,
    },
    /// The height of a map is not a finite number.
    #[error("the map's height is {alt_m}, not a finite number")]
    Height {
        /// The height.
        alt_m: f64,
    },
    /// The columns of a batch of positions have different lengths.
    #[error("the positions have {lat} latitudes, {lon} longitudes and {alt} heights")]
    Places {
        /// Number of latitudes.
        lat: usize,
        /// Number of longitudes.
        lon: usize,
        /// Number of heights; equal to the number of latitudes if heights are not used.
        alt: usize,
    },
}

/// An even, ascending axis in degrees; on a projected grid, node numbers replace the degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeographicAxis {
    first_deg: f64,
    step_deg: f64,
    steps_per_deg: f64,
    len: usize,
    /// The period of the coordinate: a full turn, or infinite on a plane.
    round_deg: f64,
}

impl GeographicAxis {
    fn new(axis: &'static str, nodes_deg: &[f64], range_deg: f64) -> Result<Self, MapGridError> {
        let (Some(first), Some(last)) = (nodes_deg.first(), nodes_deg.last()) else {
            return Err(MapGridError::TooSmall { axis, count: 0 });
        };
        if nodes_deg.len() < 2 {
            return Err(MapGridError::TooSmall { axis, count: nodes_deg.len() });
        }
        check_ascending(axis, nodes_deg)?;
        let step_deg = (last - first) / (nodes_deg.len() - 1) as f64;
        for (node, value) in nodes_deg.iter().enumerate() {
            let even_deg = first + step_deg * node as f64;
            let off_by_steps = (value - even_deg) / step_deg;
            if off_by_steps.abs() > EVENNESS {
                return Err(MapGridError::Uneven { axis, node, value_deg: *value, even_deg, off_by_steps });
            }
        }
        if last - first > range_deg + EVENNESS * step_deg {
            return Err(MapGridError::Range { axis, first_deg: *first, last_deg: *last });
        }
        let steps_per_deg = (nodes_deg.len() - 1) as f64 / (last - first);
        Ok(Self { first_deg: *first, step_deg, steps_per_deg, len: nodes_deg.len(), round_deg: 360.0 })
    }

    /// Longitudes as a full turn, with the first meridian repeated at the end; `None` if the longitudes leave a gap.
    fn closed(&self) -> Option<Self> {
        let nodes = (self.round_deg / self.step_deg).round();
        let span_deg = self.step_deg * nodes;
        if self.len as f64 + 0.5 < nodes || (span_deg - self.round_deg).abs() > EVENNESS * self.step_deg {
            return None;
        }
        // Exactly a full turn, so that rounded coordinates leave no gap at the seam.
        let (step_deg, steps_per_deg) = (self.round_deg / nodes, nodes / self.round_deg);
        Some(Self { step_deg, steps_per_deg, len: nodes as usize + 1, ..*self })
    }

    /// The nodes of a plane, numbered from 0.
    fn of_nodes(axis: &'static str, len: usize) -> Result<Self, MapGridError> {
        if len < 2 {
            return Err(MapGridError::TooSmall { axis, count: len });
        }
        Ok(Self { first_deg: 0.0, step_deg: 1.0, steps_per_deg: 1.0, len, round_deg: f64::INFINITY })
    }

    /// The number of nodes, at least two.
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.len
    }

    /// The first node, in degrees.
    pub fn first_deg(&self) -> f64 {
        self.first_deg
    }

    /// The distance between nodes, in degrees.
    pub fn step_deg(&self) -> f64 {
        self.step_deg
    }

    /// The last node, in degrees.
    pub fn last_deg(&self) -> f64 {
        self.first_deg + self.step_deg * (self.len - 1) as f64
    }

    pub(super) fn steps_per_rad(&self) -> f64 {
        self.steps_per_deg.to_degrees()
    }

    /// Cell and fraction within it; a position that exceeds an end only by rounding is on the end.
    #[inline(always)]
    pub(super) fn locate(&self, deg: f64) -> Option<(usize, f64)> {
        const ROUNDING: f64 = 1e-7;
        let steps = (deg - self.first_deg) * self.steps_per_deg;
        let last = (self.len - 1) as f64;
        if !(steps >= -ROUNDING && steps <= last + ROUNDING) {
            return None;
        }
        let cell = (steps as usize).min(self.len - 2);
        Some((cell, (steps - cell as f64).clamp(0.0, 1.0)))
    }

    /// Calls `locate` with the coordinate, changed by a full turn if necessary.
    #[inline(always)]
    pub(super) fn locate_turning(&self, deg: f64) -> Option<(usize, f64)> {
        let round_deg = self.round_deg;
        self.locate(deg).or_else(|| self.locate(deg - round_deg)).or_else(|| self.locate(deg + round_deg))
    }
}

fn check_ascending(axis: &'static str, nodes_deg: &[f64]) -> Result<(), MapGridError> {
    if let Some(node) = nodes_deg.iter().position(|value| !value.is_finite()) {
        return Err(MapGridError::NotFinite { axis, node, value_deg: nodes_deg[node] });
    }
    for (before, pair) in nodes_deg.windows(2).enumerate() {
        if pair[1] <= pair[0] {
            let (before_deg, value_deg) = (pair[0], pair[1]);
            return Err(MapGridError::NotAscending { axis, node: before + 1, before_deg, value_deg });
        }
    }
    Ok(())
}

/// A regular grid of anomalies in nT, NaN where unknown; rows run from south to north, columns from west to east.
#[derive(Clone, Debug, PartialEq)]
pub struct GeographicGrid {
    lat: GeographicAxis,
    lon: GeographicAxis,
    values: Vec<f64>,
    /// Whether the last column repeats the first, after a full turn.
    closed: bool,
}

impl GeographicGrid {
    /// Grid from its axes in degrees and its values by rows: all longitudes of the first latitude, then all longitudes
    /// of the next latitude. Longitudes around the whole earth are closed: the first meridian is also the last.
    ///
    /// # Errors
    /// Fails for an axis with fewer than two nodes, for nodes that are not finite, do not ascend or have uneven steps,
    /// for latitudes beyond a pole, or for longitudes over more than a full turn. Also fails if the number of values
    /// differs from the number of nodes, if a value is infinite, or if all are NaN.
    pub fn new(lat_deg: &[f64], lon_deg: &[f64], anomaly_nt: &[f64]) -> Result<Self, MapGridError> {
        let lat = GeographicAxis::new("latitude", lat_deg, 180.0)?;
        let lon = GeographicAxis::new("longitude", lon_deg, 360.0)?;
        let (first_deg, last_deg) = (lat.first_deg, lat.last_deg());
        if first_deg < -90.0 - EVENNESS * lat.step_deg || last_deg > 90.0 + EVENNESS * lat.step_deg {
            return Err(MapGridError::Range { axis: "latitude", first_deg, last_deg });
        }
        let grid = Self::of_axes(lat, lon, anomaly_nt)?;
        let Some(closed) = lon.closed() else { return Ok(grid) };
        Ok(Self { lon: closed, values: grid.closed_values(), closed: true, ..grid })
    }

    /// Values of a closed grid by rows; a repeated first meridian takes the known value of its two columns.
    fn closed_values(&self) -> Vec<f64> {
        let distinct = self.lon.closed().map_or(self.lon.len, |closed| closed.len - 1);
        let row = |row: &[f64]| {
            let (first, again) = (row[0], row.get(distinct).copied().unwrap_or(f64::NAN));
            let seam = if first.is_nan() { again } else { first };
            let inner = row.iter().take(distinct).skip(1).copied();
            std::iter::once(seam).chain(inner).chain([seam]).collect::<Vec<f64>>()
        };
        self.values.chunks(self.lon.len).flat_map(row).collect()
    }

    /// Grid on a plane whose rows and columns are numbered from 0. Rows and columns replace degrees in the grid and in
    /// look-ups of its maps. Its values are by rows, starting with the first row.
    ///
    /// # Errors
    /// Fails for fewer than two rows or columns. Also fails if the number of values differs from the number of nodes,
    /// if a value is infinite, or if all are NaN.
    pub fn of_nodes(rows: usize, columns: usize, anomaly_nt: &[f64]) -> Result<Self, MapGridError> {
        Self::of_axes(GeographicAxis::of_nodes("row", rows)?, GeographicAxis::of_nodes("column", columns)?, anomaly_nt)
    }

    fn of_axes(lat: GeographicAxis, lon: GeographicAxis, anomaly_nt: &[f64]) -> Result<Self, MapGridError> {
        let (latitudes, longitudes) = (lat.len, lon.len);
        if anomaly_nt.len() != latitudes * longitudes {
            return Err(MapGridError::Size { values: anomaly_nt.len(), latitudes, longitudes });
        }
        if let Some(row) = anomaly_nt.iter().position(|value| value.is_infinite()) {
            return Err(MapGridError::Infinite { row });
        }
        if anomaly_nt.iter().all(|value| value.is_nan()) {
            return Err(MapGridError::Empty);
        }
        Ok(Self { lat, lon, values: anomaly_nt.to_vec(), closed: false })
    }

    /// A grid from a table with one row per node (degrees, degrees, nT). The rows are sorted by latitude, then
    /// longitude.
    ///
    /// # Errors
    /// Fails with [`MapGridError::Columns`] for columns of different lengths, or with [`MapGridError::Row`] for a row
    /// that is not at its position in a complete grid. Also returns the errors of [`Self::new`].
    pub fn from_rows(lat_deg: &[f64], lon_deg: &[f64], anomaly_nt: &[f64]) -> Result<Self, MapGridError> {
        if lat_deg.len() != lon_deg.len() || lat_deg.len() != anomaly_nt.len() {
            let (lat, lon, anomaly) = (lat_deg.len(), lon_deg.len(), anomaly_nt.len());
            return Err(MapGridError::Columns { lat, lon, anomaly });
        }
        if let Some(value_deg) = lat_deg.first().filter(|lat| !lat.is_finite()) {
            return Err(MapGridError::NotFinite { axis: "latitude", node: 0, value_deg: *value_deg });
        }
        let width = lat_deg.iter().take_while(|lat| Some(*lat) == lat_deg.first()).count();
        let Some(columns) = lon_deg.get(..width).filter(|columns| !columns.is_empty()) else {
            return Err(MapGridError::TooSmall { axis: "latitude", count: lat_deg.len().min(1) });
        };
        let rows: Vec<f64> = lat_deg.iter().step_by(width).copied().collect();
        for (row, (lat, lon)) in lat_deg.iter().zip(lon_deg).enumerate() {
            let (expected_lat, expected_lon) = (rows[row / width], columns[row % width]);
            if *lat != expected_lat || *lon != expected_lon {
                return Err(MapGridError::Row {
                    row,
                    lat_deg: *lat,
                    lon_deg: *lon,
                    expected_lat_deg: expected_lat,
                    expected_lon_deg: expected_lon,
                });
            }
        }
        Self::new(&rows, columns, anomaly_nt)
    }

    /// The same grid with other values, one per node, by rows.
    ///
    /// # Errors
    /// Fails with [`MapGridError::Size`] if the number of values differs from the number of nodes, or with
    /// [`MapGridError::Infinite`] for an infinite value.
    pub fn with_values(&self, values: Vec<f64>) -> Result<Self, MapGridError> {
        let (latitudes, longitudes) = (self.lat.len, self.lon.len);
        if values.len() != latitudes * longitudes {
            return Err(MapGridError::Size { values: values.len(), latitudes, longitudes });
        }
        if let Some(row) = values.iter().position(|value| value.is_infinite()) {
            return Err(MapGridError::Infinite { row });
        }
        Ok(Self { values, ..*self })
    }

    /// The grid on a plane, in metres from its south-western node. Steps in latitude and longitude are converted at the
    /// middle latitude.
    pub fn plane(&self) -> PlaneGrid {
        let middle = (0.5 * (self.lat.first_deg() + self.lat.last_deg())).to_radians();
        let earth = EarthModel::Wgs84;
        let axis = |axis: &GeographicAxis, m_per_rad: f64| EvenAxis {
            first: 0.0,
            step: axis.step_deg.to_radians() * m_per_rad,
            len: axis.len,
        };
        PlaneGrid {
            east_m: axis(&self.lon, earth.east_m_per_rad(middle, 0.0)),
            north_m: axis(&self.lat, earth.north_m_per_rad(middle, 0.0)),
            values: self.values.clone(),
        }
    }

    /// The latitudes.
    pub fn lat(&self) -> &GeographicAxis {
        &self.lat
    }

    /// The longitudes.
    pub fn lon(&self) -> &GeographicAxis {
        &self.lon
    }

    /// Whether a companion has a finite value at every known node.
    pub(crate) fn check_companion(&self, companion: &'static str, values: &[f64]) -> Result<(), MapGridError> {
        if values.len() != self.values.len() {
            return Err(MapGridError::CompanionSize { companion, nodes: self.values.len(), values: values.len() });
        }
        let bad = |(anomaly, value): (&f64, &f64)| !anomaly.is_nan() && !value.is_finite();
        match self.values.iter().zip(values).position(bad) {
            Some(row) => Err(MapGridError::CompanionValue { companion, row, value: values[row] }),
            None => Ok(()),
        }
    }

    pub(crate) fn shape(&self) -> GridShape {
        GridShape { rows: self.lat.len, columns: self.lon.len, closed: self.closed }
    }

    /// The values in nT, by rows from south to north.
    pub fn values(&self) -> &[f64] {
        &self.values
    }
}
