//! An anomaly map on a regular grid of latitude and longitude: value and exact gradient.
//!
//! Missing nodes are NaN. For all interpolations, a position has a value if the four nodes of its cell are known;
//! otherwise, and off the map, a position has no value.
//!
//! A map with a vertical derivative also returns the change of the field with height, and the field slightly above or
//! below it.

mod batch;
mod grid;
mod holes;
mod quadratic;
mod surface;

use crate::earth::field_value::FieldValue;
pub use batch::FieldColumns;
pub(crate) use batch::{FieldLookup, LookupPositions, look_up_many};
use grid::GeographicAxis;
pub use grid::{GeographicGrid, MapGridError};
pub(crate) use holes::GridShape;
use params::choice;
pub(crate) use surface::{CellPosition, GridInterpolant, SurfaceGradient};

choice! {
    /// Interpolation between the nodes.
    #[derive(Default)]
    pub enum MapInterpolation {
        /// Bilinear: continuous, but the gradient jumps from cell to cell.
        #[default]
        Linear = "linear",
        /// The quadratic B-spline through the nodes, with pieces centred on the nodes (MagNav.jl's `quad`): value and
        /// gradient are continuous. Gaps are treated as with `Cubic`.
        Quadratic = "quadratic",
        /// The natural cubic spline in both directions (MagNav.jl's `cubic`): value, gradient and curvature are
        /// continuous. The gaps of a map are filled from their edges before the spline is solved. The effect of a hole
        /// on nearby cells decreases by a factor of 4 per cell.
        Cubic = "cubic",
    }
}

/// Vertical derivative of a map at its nodes.
#[derive(Clone, Copy, Debug)]
pub struct VerticalDerivative<'a> {
    /// Change of the anomaly per metre upward, in nT/m, in the order of the map's values; finite at all known nodes.
    pub d_alt_nt_per_m: &'a [f64],
    /// Height of the map, in metres.
    pub alt_m: f64,
}

/// The second derivatives of a map along latitude and longitude, in nT/rad².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapCurvature {
    /// Twice along latitude.
    pub d2_lat_nt_per_rad2: f64,
    /// Along latitude and longitude.
    pub d2_lat_lon_nt_per_rad2: f64,
    /// Twice along longitude.
    pub d2_lon_nt_per_rad2: f64,
}

/// Latitude and longitude axes of a grid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GridAxes {
    lat: GeographicAxis,
    lon: GeographicAxis,
}

impl GridAxes {
    pub(crate) fn from_grid(grid: &GeographicGrid) -> Self {
        Self { lat: *grid.lat(), lon: *grid.lon() }
    }

    /// Cell of a position in degrees; `None` off the map or for NaN.
    #[inline(always)]
    pub(crate) fn cell(&self, lat_deg: f64, lon_deg: f64) -> Option<CellPosition> {
        let (row, up) = self.lat.locate(lat_deg)?;
        let (column, right) = self.lon.locate_turning(lon_deg)?;
        Some(CellPosition { row, column, up, right })
    }

    /// Field from a value, its slopes per step and its slope per metre.
    #[inline(always)]
    pub(crate) fn field(&self, value_nt: f64, per_row: f64, per_column: f64, d_alt: f64) -> FieldValue {
        FieldValue {
            value_nt,
            d_lat_nt_per_rad: per_row * self.lat.steps_per_rad(),
            d_lon_nt_per_rad: per_column * self.lon.steps_per_rad(),
            d_alt_nt_per_m: d_alt,
        }
    }
}

/// Values of a map at its nodes.
#[derive(Clone, Debug)]
enum SurfaceNodes {
    Anomaly(GridInterpolant<1>),
    /// Anomaly and vertical derivative, with the height of the map in metres.
    WithVertical(GridInterpolant<2>, f64),
}

/// An anomaly map, prepared for fast interpolation.
#[derive(Clone, Debug)]
pub struct MapSurface {
    axes: GridAxes,
    nodes: SurfaceNodes,
}

impl MapSurface {
    /// Prepares a grid for look-ups; the map is constant with height.
    pub fn new(grid: &GeographicGrid, interpolation: MapInterpolation) -> Self {
        let surface = GridInterpolant::new(grid.shape(), [grid.values()], interpolation);
        Self { axes: GridAxes::from_grid(grid), nodes: SurfaceNodes::Anomaly(surface) }
    }

    /// Prepares a grid and its vertical derivative; both are interpolated in the same way.
    ///
    /// # Errors
    /// Fails if the number of derivatives differs from the number of nodes, if a derivative is not finite at a known
    /// node, or if the height is not finite.
    pub fn with_vertical(
        grid: &GeographicGrid,
        vertical: VerticalDerivative<'_>,
        interpolation: MapInterpolation,
    ) -> Result<Self, MapGridError> {
        let VerticalDerivative { d_alt_nt_per_m, alt_m } = vertical;
        if !alt_m.is_finite() {
            return Err(MapGridError::Height { alt_m });
        }
        grid.check_companion("vertical derivative", d_alt_nt_per_m)?;
        let surface = GridInterpolant::new(grid.shape(), [grid.values(), d_alt_nt_per_m], interpolation);
        Ok(Self { axes: GridAxes::from_grid(grid), nodes: SurfaceNodes::WithVertical(surface, alt_m) })
    }

    /// Interpolation method.
    pub fn interpolation(&self) -> MapInterpolation {
        match &self.nodes {
            SurfaceNodes::Anomaly(surface) => surface.interpolation(),
            SurfaceNodes::WithVertical(surface, _) => surface.interpolation(),
        }
    }

    /// Height of the map, in metres, if it was given with a vertical derivative.
    pub fn alt_m(&self) -> Option<f64> {
        match self.nodes {
            SurfaceNodes::Anomaly(_) => None,
            SurfaceNodes::WithVertical(_, alt_m) => Some(alt_m),
        }
    }

    /// Anomaly and its gradient on the map, at a position in degrees. `None` off the map, in a cell with an unknown
    /// node, or for NaN. A longitude may differ from the map's by a full turn. Without a vertical derivative the change
    /// with height is zero.
    #[inline(always)]
    pub fn at(&self, lat_deg: f64, lon_deg: f64) -> Option<FieldValue> {
        self.on_map(self.axes.cell(lat_deg, lon_deg)?)
    }

    #[inline(always)]
    fn on_map(&self, cell: CellPosition) -> Option<FieldValue> {
        match &self.nodes {
            SurfaceNodes::Anomaly(surface) => {
                let jet = surface.at(cell)?;
                Some(self.axes.field(jet.value[0], jet.per_row[0], jet.per_column[0], 0.0))
            }
            SurfaceNodes::WithVertical(surface, _) => {
                let jet = surface.at(cell)?;
                Some(self.axes.field(jet.value[0], jet.per_row[0], jet.per_column[0], jet.value[1]))
            }
        }
    }

    #[inline(always)]
    fn touch(&self, cell: CellPosition) -> f64 {
        match &self.nodes {
            SurfaceNodes::Anomaly(surface) => surface.touch(cell),
            SurfaceNodes::WithVertical(surface, _) => surface.touch(cell),
        }
    }

    /// Anomaly at a height in metres, to first order: the map's value plus its vertical derivative times the distance
    /// from the map's height. The gradient is the exact derivative of this value. The caller must limit the distance:
    /// the error increases with the square of the distance divided by the depth of the sources. A map without a
    /// vertical derivative is constant with height.
    #[inline(always)]
    pub fn at_height(&self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> Option<FieldValue> {
        self.off_map(self.axes.cell(lat_deg, lon_deg)?, alt_m)
    }

    #[inline(always)]
    fn off_map(&self, cell: CellPosition, alt_m: f64) -> Option<FieldValue> {
        let SurfaceNodes::WithVertical(surface, map_alt_m) = &self.nodes else {
            return self.on_map(cell);
        };
        let up_m = alt_m - map_alt_m;
        let jet = surface.at(cell)?;
        let first_order = |quantity: [f64; 2]| quantity[0] + up_m * quantity[1];
        let field = self.axes.field(
            first_order(jet.value),
            first_order(jet.per_row),
            first_order(jet.per_column),
            jet.value[1],
        );
        up_m.is_finite().then_some(field)
    }

    /// Second derivatives of the map at a position in degrees, from the interpolation formula. A bilinear map has only
    /// the mixed derivative; the derivatives of a quadratic map jump midway between nodes. `None` where [`Self::at`]
    /// returns `None`.
    pub fn curvature(&self, lat_deg: f64, lon_deg: f64) -> Option<MapCurvature> {
        let cell = self.axes.cell(lat_deg, lon_deg)?;
        let bend = match &self.nodes {
            SurfaceNodes::Anomaly(surface) => surface.bend(cell)?,
            SurfaceNodes::WithVertical(surface, _) => surface.bend(cell)?,
        };
        let (lat, lon) = (self.axes.lat.steps_per_rad(), self.axes.lon.steps_per_rad());
        Some(MapCurvature {
            d2_lat_nt_per_rad2: bend.rows * lat * lat,
            d2_lat_lon_nt_per_rad2: bend.cross * lat * lon,
            d2_lon_nt_per_rad2: bend.columns * lon * lon,
        })
    }
}

#[cfg(test)]
mod globe_tests;
#[cfg(test)]
pub(crate) mod tests;
#[cfg(test)]
mod vertical_tests;
