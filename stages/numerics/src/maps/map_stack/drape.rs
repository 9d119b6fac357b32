//! A map measured or computed at a height that follows the terrain.

use super::MapStack;
use crate::earth::field_value::FieldValue;
use crate::maps::map_surface::{
    CellPosition, FieldColumns, FieldLookup, GeographicGrid, GridAxes, GridInterpolant, LookupPositions, MapGridError,
    MapInterpolation, SurfaceGradient, look_up_many,
};

const ANOMALY: usize = 0;
const D_ALT: usize = 1;
const HEIGHT: usize = 2;

/// Map with a height and a vertical derivative at every node.
#[derive(Clone, Debug)]
pub struct DrapeMap {
    axes: GridAxes,
    /// The anomaly, its vertical derivative and the height.
    surface: GridInterpolant<3>,
}

impl DrapeMap {
    /// Map with the height of each node, in metres, and the vertical derivative of the field there, in nT/m, both by
    /// rows and known at all known nodes. Heights and derivatives are interpolated in the same way as the map.
    ///
    /// # Errors
    /// Fails with [`MapGridError::CompanionSize`] if the number of heights or derivatives differs from the number of
    /// nodes, or with [`MapGridError::CompanionValue`] for a height or derivative that is not finite at a known node.
    pub fn new(
        grid: &GeographicGrid,
        height_m: &[f64],
        d_alt_nt_per_m: &[f64],
        interpolation: MapInterpolation,
    ) -> Result<Self, MapGridError> {
        grid.check_companion("height", height_m)?;
        grid.check_companion("vertical derivative", d_alt_nt_per_m)?;
        let surface = GridInterpolant::new(grid.shape(), [grid.values(), d_alt_nt_per_m, height_m], interpolation);
        Ok(Self { axes: GridAxes::from_grid(grid), surface })
    }

    /// The height of the map at a position in degrees, in metres; `None` where the map has no value.
    pub fn height_m(&self, lat_deg: f64, lon_deg: f64) -> Option<f64> {
        Some(self.surface.at(self.axes.cell(lat_deg, lon_deg)?)?.value[HEIGHT])
    }

    /// Anomaly on the draped surface, and gradient of the field there: the change along the surface minus the part
    /// caused by the slope of the surface.
    pub fn at(&self, lat_deg: f64, lon_deg: f64) -> Option<FieldValue> {
        let jet = self.surface.at(self.axes.cell(lat_deg, lon_deg)?)?;
        Some(self.lifted(jet, 0.0))
    }

    /// Anomaly at a height in metres, to first order from the surface: the map's value plus its vertical derivative
    /// times the height above the surface. The gradient is the exact derivative of this value.
    #[inline]
    pub fn at_height(&self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> Option<FieldValue> {
        self.field(self.axes.cell(lat_deg, lon_deg)?, alt_m)
    }

    /// Anomaly at a height in metres, with a stack of the same field: the map's value plus the change of the stack from
    /// the map's height to `alt_m`. The stack contributes only this change, so its error at the surface cancels. `None`
    /// if the map has no value, or if the stack has no value at one of the two heights.
    pub fn at_height_by(&self, stack: &MapStack, lat_deg: f64, lon_deg: f64, alt_m: f64) -> Option<FieldValue> {
        let jet = self.surface.at(self.axes.cell(lat_deg, lon_deg)?)?;
        let on_map =
            self.axes.field(jet.value[ANOMALY], jet.per_row[ANOMALY], jet.per_column[ANOMALY], jet.value[D_ALT]);
        let (here, there) = (stack.at(lat_deg, lon_deg, jet.value[HEIGHT])?, stack.at(lat_deg, lon_deg, alt_m)?);
        let slope = self.axes.field(0.0, jet.per_row[HEIGHT], jet.per_column[HEIGHT], 0.0);
        let difference = |of: fn(&FieldValue) -> f64| of(&there) - of(&here);
        Some(FieldValue {
            value_nt: on_map.value_nt + difference(|f| f.value_nt),
            d_lat_nt_per_rad: on_map.d_lat_nt_per_rad + difference(|f| f.d_lat_nt_per_rad)
                - here.d_alt_nt_per_m * slope.d_lat_nt_per_rad,
            d_lon_nt_per_rad: on_map.d_lon_nt_per_rad + difference(|f| f.d_lon_nt_per_rad)
                - here.d_alt_nt_per_m * slope.d_lon_nt_per_rad,
            d_alt_nt_per_m: there.d_alt_nt_per_m,
        })
    }

    /// Same as [`Self::at_height`], for many positions; positions without a value are NaN.
    ///
    /// # Errors
    /// Fails with [`MapGridError::Places`] for columns of different lengths.
    pub fn at_heights(
        &self,
        lat_deg: &[f64],
        lon_deg: &[f64],
        alt_m: &[f64],
        out: &mut FieldColumns,
    ) -> Result<(), MapGridError> {
        look_up_many(self, LookupPositions { lat_deg, lon_deg, alt_m }, true, out)
    }

    /// `a + u d`, with the height u above the surface, and its derivatives: `a' + u d' - d h'`.
    #[inline(always)]
    fn lifted(&self, jet: SurfaceGradient<3>, up_m: f64) -> FieldValue {
        let d_alt = jet.value[D_ALT];
        let slope = |change: [f64; 3]| change[ANOMALY] + up_m * change[D_ALT] - d_alt * change[HEIGHT];
        let value = jet.value[ANOMALY] + up_m * d_alt;
        self.axes.field(value, slope(jet.per_row), slope(jet.per_column), d_alt)
    }
}

impl FieldLookup for DrapeMap {
    #[inline(always)]
    fn cell(&self, lat_deg: f64, lon_deg: f64) -> Option<CellPosition> {
        self.axes.cell(lat_deg, lon_deg)
    }

    #[inline(always)]
    fn touch(&self, cell: CellPosition, _: f64) -> f64 {
        self.surface.touch(cell)
    }

    #[inline(always)]
    fn field(&self, cell: CellPosition, alt_m: f64) -> Option<FieldValue> {
        let jet = self.surface.at(cell)?;
        let up_m = alt_m - jet.value[HEIGHT];
        up_m.is_finite().then(|| self.lifted(jet, up_m))
    }
}
