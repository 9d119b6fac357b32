//! A map on its native grid, as in its file.

use std::path::PathBuf;

use numerics::{
    earth::geodesy::{meridian_radius_m, transverse_radius_m},
    maps::plane_grid::{EvenAxis, PlaneGrid},
};

use super::Crs;
use crate::ReadError;
use schemas::map::ERROR;

/// The height of a map above the ellipsoid, in metres.
#[derive(Clone, Debug, PartialEq)]
pub enum GridHeight {
    /// One height for all nodes; NaN if unknown.
    Level(f64),
    /// One height per node, as for a draped map, in the order of the values.
    Cells(Vec<f64>),
}

/// The meaning of the coordinates in a file. In an [`AnomalyGrid`], coordinates always refer to the nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Registration {
    /// Grid-registered: the outermost nodes lie on the edge of the map.
    Node,
    /// Pixel-registered: the outermost nodes lie half a spacing within the edge of the map.
    Pixel,
}

/// An anomaly map on an even grid in any coordinate system.
#[derive(Clone, Debug, PartialEq)]
pub struct AnomalyGrid {
    /// Eastings of the columns in the system's unit, or longitudes in degrees.
    pub x: EvenAxis,
    /// Northings of the rows in the system's unit, or latitudes in degrees.
    pub y: EvenAxis,
    /// The system of the coordinates.
    pub crs: Crs,
    /// The anomaly in nT by rows, the southernmost first, each from west to east; NaN where unknown.
    pub anomaly_nt: Vec<f64>,
    /// Standard deviation of the error of each node in nT, if the source of the map gives it; NaN where unknown.
    pub error_nt: Option<Vec<f64>>,
    /// The unit of the values: `nT`, or for derivatives of the anomaly `nT/m` or `nT/m2`.
    pub value_unit: &'static str,
    /// The height above the WGS-84 ellipsoid.
    pub height: GridHeight,
    /// The meaning of the file's coordinates.
    pub registration: Registration,
    /// Name of the file's format; empty for a computed map.
    pub format: &'static str,
    /// Path of the file, for messages; empty for a computed map.
    pub source: PathBuf,
    /// Notes on the processing of the file's values.
    pub notes: Vec<String>,
}

/// The unit of an anomaly.
pub const NANOTESLA: &str = "nT";
/// The units of the anomaly's derivatives.
pub const DERIVATIVES: [&str; 2] = ["nT/m", "nT/m2"];

/// Distances are corrected if the projection's scale deviates from 1 by more than this.
const WORST_SCALE: f64 = 0.005;

impl AnomalyGrid {
    /// A map from its axes and values, row by row from the south.
    ///
    /// # Errors
    /// Fails for axes that have fewer than two nodes or do not ascend, degrees out of range, infinite values or
    /// heights, more or fewer values or heights than nodes, or a map without a known value.
    pub fn new(
        x: EvenAxis,
        y: EvenAxis,
        crs: Crs,
        anomaly_nt: Vec<f64>,
        height: GridHeight,
    ) -> Result<AnomalyGrid, ReadError> {
        let (registration, source) = (Registration::Node, PathBuf::new());
        let value_unit = NANOTESLA;
        let map = AnomalyGrid {
            x,
            y,
            crs,
            anomaly_nt,
            error_nt: None,
            value_unit,
            height,
            registration,
            format: "",
            source,
            notes: vec![],
        };
        map.check()?;
        Ok(map)
    }

    /// Makes the checks of [`AnomalyGrid::new`].
    ///
    /// # Errors
    /// Fails for axes of fewer than two nodes or with non-finite numbers, more or fewer values or heights than nodes,
    /// infinite values, or a grid without a known value.
    pub fn check(&self) -> Result<(), ReadError> {
        let names = if self.crs.is_geographic() { ["lon", "lat"] } else { ["easting", "northing"] };
        for (axis, name) in [&self.x, &self.y].into_iter().zip(names) {
            if axis.len < 2 {
                let what = format!("a map requires at least two nodes along each axis, not {}", axis.len);
                return Err(self.fault(what).in_column(name));
            }
            let ends = axis.first.is_finite() && axis.last().is_finite();
            if !(ends && axis.step > 0.0) {
                let what = format!("the axis must ascend, but it runs from {} to {}", axis.first, axis.last());
                return Err(self.fault(what).in_column(name));
            }
        }
        if self.crs.is_geographic() {
            self.check_range("lat", &self.y, 90.0)?;
            // Longitudes exceed 180 for a map across the date line, and the file may use 0 to 360.
            self.check_range("lon", &self.x, 540.0)?;
        }
        super::check_values(&self.source, &self.anomaly_nt, self.nodes())?;
        if let Some(error_nt) = &self.error_nt {
            self.check_error(error_nt)?;
        }
        match &self.height {
            GridHeight::Level(alt_m) if alt_m.is_infinite() => {}
            GridHeight::Cells(cells) if cells.len() != self.nodes() || cells.iter().any(|a| a.is_infinite()) => {}
            _ => return Ok(()),
        }
        Err(self.fault("each node must have a height that is finite, or NaN if unknown").in_column("alt"))
    }

    fn check_error(&self, error_nt: &[f64]) -> Result<(), ReadError> {
        if error_nt.len() != self.nodes() {
            let what = format!("the grid has {} nodes, but {} standard deviations", self.nodes(), error_nt.len());
            return Err(self.fault(what).in_column(ERROR));
        }
        match error_nt.iter().position(|error| *error < 0.0 || error.is_infinite()) {
            Some(node) => Err(self
                .fault(format!("the standard deviation must be at least 0 nT, not {}", error_nt[node]))
                .in_column(ERROR)
                .in_row(node as u64)),
            None => Ok(()),
        }
    }

    fn check_range(&self, name: &str, axis: &EvenAxis, most: f64) -> Result<(), ReadError> {
        // Rounding may move the edge of a cell at the pole beyond 90 degrees.
        let beyond = [axis.first, axis.last()].into_iter().find(|x| x.abs() > most + 1e-6 * axis.step);
        match beyond {
            Some(x) => Err(self
                .fault(format!("the coordinate {x} degrees is out of range"))
                .help("if the coordinates are eastings and northings, set `epsg`")
                .in_column(name)),
            None => Ok(()),
        }
    }

    /// The number of nodes.
    pub fn nodes(&self) -> usize {
        self.x.len.saturating_mul(self.y.len)
    }

    /// Whether the coordinates are degrees.
    pub fn is_geographic(&self) -> bool {
        self.crs.is_geographic()
    }

    /// The height of a node in metres; NaN where it is unknown.
    pub fn height_at(&self, node: usize) -> f64 {
        match &self.height {
            GridHeight::Level(alt_m) => *alt_m,
            GridHeight::Cells(cells) => cells.get(node).copied().unwrap_or(f64::NAN),
        }
    }

    /// The heights of all nodes, in metres.
    pub fn heights(&self) -> Vec<f64> {
        match &self.height {
            GridHeight::Level(alt_m) => vec![*alt_m; self.nodes()],
            GridHeight::Cells(cells) => cells.clone(),
        }
    }

    /// Rejects a map of any quantity other than the anomaly.
    ///
    /// # Errors
    /// Fails for a map of a derivative.
    pub fn check_anomaly(&self) -> Result<(), ReadError> {
        if self.value_unit == NANOTESLA {
            return Ok(());
        }
        let what = format!("the map holds a derivative in {}, but an anomaly in nT is required", self.value_unit);
        Err(self.fault(what).in_column("anomaly"))
    }

    /// WGS-84 latitude and longitude of the middle of the map, in degrees.
    pub fn middle_deg(&self) -> Option<(f64, f64)> {
        let (x, y) = self.middle();
        self.crs.unproject(x, y)
    }

    /// The coordinates of the middle of the map.
    pub(super) fn middle(&self) -> (f64, f64) {
        (middle(&self.x), middle(&self.y))
    }

    /// Metres per unit of `x` and of `y`, at the middle of the map.
    ///
    /// For eastings and northings, this is the length of the coordinate system's unit, or the length on the ground if
    /// the scale of the projection differs by more than 0.5 % from 1, as for web Mercator. For degrees, the lengths are
    /// arcs of one degree. The radius of the arc along `x` is the transverse radius of curvature times the cosine of
    /// the latitude; the radius of the arc along `y` is the meridian radius [Torge & Müller, Geodesy, 4.1.3].
    pub fn unit_m(&self) -> (f64, f64) {
        if self.is_geographic() {
            let lat = middle(&self.y).to_radians();
            return ((transverse_radius_m(lat) * lat.cos()).to_radians(), meridian_radius_m(lat).to_radians());
        }
        let unit = self.crs.unit_m();
        let scaled = |ground: Option<f64>| match ground {
            Some(ground) if (ground / unit - 1.0).abs() > WORST_SCALE => ground,
            _ => unit,
        };
        let along = |dx: f64, dy: f64| scaled(ground_m(&self.crs, self.middle(), (dx, dy)));
        (along(self.x.step, 0.0), along(0.0, self.y.step))
    }

    /// Metres on the ground per unit of `x` and of `y`, at the middle of the map.
    pub(super) fn ground_unit_m(&self) -> (f64, f64) {
        if self.is_geographic() {
            return self.unit_m();
        }
        let along = |dx: f64, dy: f64| ground_m(&self.crs, self.middle(), (dx, dy)).unwrap_or(f64::NAN);
        (along(self.x.step, 0.0), along(0.0, self.y.step))
    }

    /// The unit of the coordinates; empty if the unit has no common name.
    pub fn unit(&self) -> &'static str {
        match self.crs.unit_m() {
            _ if self.is_geographic() => "deg",
            1.0 => "m",
            0.3048 => "ft",
            unit if (unit - 1200.0 / 3937.0).abs() < 1e-9 => "us-ft",
            _ => "",
        }
    }

    /// The map on a plane, in metres: the input of continuation, filling and gridding. The coordinates are the map's
    /// coordinates times [`AnomalyGrid::unit_m`].
    pub fn plane(&self) -> PlaneGrid {
        let (x, y) = self.unit_m();
        let (east_m, north_m) = (scaled(&self.x, x), scaled(&self.y, y));
        PlaneGrid { east_m, north_m, values: self.anomaly_nt.clone() }
    }

    /// The same map with other values, one per node, row by row from the south. The errors of the nodes are dropped.
    ///
    /// # Errors
    /// Fails for more or fewer values than nodes, infinite values, or a map without a known value.
    pub fn with_plane_values(&self, values: Vec<f64>) -> Result<AnomalyGrid, ReadError> {
        let map = AnomalyGrid { anomaly_nt: values, error_nt: None, ..self.clone() };
        map.check()?;
        Ok(map)
    }

    /// Creates a map with another extent or spacing, such as a trimmed or expanded map. `grid` lies on this map's
    /// plane, in the metres of [`AnomalyGrid::plane`].
    ///
    /// # Errors
    /// Fails in the cases of [`AnomalyGrid::new`].
    pub fn with_plane(&self, grid: PlaneGrid, height: GridHeight) -> Result<AnomalyGrid, ReadError> {
        let (x, y) = self.unit_m();
        let (x, y) = (scaled(&grid.east_m, 1.0 / x), scaled(&grid.north_m, 1.0 / y));
        let map = AnomalyGrid {
            x,
            y,
            crs: self.crs.clone(),
            anomaly_nt: grid.values,
            error_nt: None,
            value_unit: self.value_unit,
            height,
            registration: self.registration,
            format: self.format,
            source: self.source.clone(),
            notes: self.notes.clone(),
        };
        map.check()?;
        Ok(map)
    }

    /// An error about this map.
    pub fn fault(&self, what: impl Into<String>) -> ReadError {
        ReadError::data(&self.source, what)
    }
}

/// Metres on the ground per unit of a projected system, along (dx, dy) from a position in the system.
pub(super) fn ground_m(crs: &Crs, (x, y): (f64, f64), (dx, dy): (f64, f64)) -> Option<f64> {
    let (a, b) = (crs.unproject(x, y)?, crs.unproject(x + dx, y + dy)?);
    let lat = a.0.to_radians();
    let turn = b.1 - a.1;
    let east_deg = turn - 360.0 * (turn / 360.0).round();
    let north_m = (b.0 - a.0).to_radians() * meridian_radius_m(lat);
    let east_m = east_deg.to_radians() * transverse_radius_m(lat) * lat.cos();
    Some(north_m.hypot(east_m) / dx.hypot(dy))
}

/// The coordinate halfway along an axis.
fn middle(axis: &EvenAxis) -> f64 {
    axis.at(0.5 * axis.len.saturating_sub(1) as f64)
}

fn scaled(axis: &EvenAxis, factor: f64) -> EvenAxis {
    EvenAxis { first: axis.first * factor, step: axis.step * factor, len: axis.len }
}

/// Fractional node index of a coordinate; `None` for a position off the axis.
pub fn node_on(axis: &EvenAxis, coordinate: f64) -> Option<f64> {
    // Rounding of a forward and inverse projection must not move an outermost node off the axis.
    const SLACK: f64 = 1e-6;
    let (node, last) = (axis.node(coordinate), axis.len.saturating_sub(1) as f64);
    (-SLACK..=last + SLACK).contains(&node).then(|| node.clamp(0.0, last))
}
