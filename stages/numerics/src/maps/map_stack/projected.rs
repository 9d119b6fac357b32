//! Looks up a map at latitudes and longitudes, by interpolation on its native grid of eastings and northings.

use super::MapStack;
use crate::earth::field_value::FieldValue;
use crate::maps::grid_projection::GridProjection;
use crate::maps::map_surface::{FieldColumns, LookupPositions, MapGridError, MapSurface};

/// A map, or a stack of maps, on the grid of a projection
/// ([`GeographicGrid::of_nodes`](super::GeographicGrid::of_nodes)).
///
/// A position is projected and the value interpolated between the nodes. The derivatives of the projection, which
/// include the scale and the meridian convergence, convert the slopes to latitude and longitude.
#[derive(Clone, Debug)]
pub struct ProjectedMap {
    projection: GridProjection,
    nodes: NodeMap,
}

/// A map or stack addressed by row and column instead of latitude and longitude.
#[derive(Clone, Debug)]
enum NodeMap {
    Flat(MapSurface),
    Stack(MapStack),
}

impl ProjectedMap {
    /// A map at a single height.
    pub fn flat(projection: GridProjection, map: MapSurface) -> Self {
        Self { projection, nodes: NodeMap::Flat(map) }
    }

    /// Maps at several heights.
    pub fn stack(projection: GridProjection, stack: MapStack) -> Self {
        Self { projection, nodes: NodeMap::Stack(stack) }
    }

    /// Whether the map changes with height.
    pub(crate) fn has_upward_slope(&self) -> bool {
        match &self.nodes {
            NodeMap::Flat(map) => map.alt_m().is_some(),
            NodeMap::Stack(_) => true,
        }
    }

    /// The anomaly and its gradient at a position in degrees and metres; `None` where the map has no value.
    pub fn at(&self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> Option<FieldValue> {
        let place = self.projection.at(lat_deg, lon_deg)?;
        let on_nodes = match &self.nodes {
            NodeMap::Flat(map) => map.at_height(place.row, place.column, alt_m)?,
            NodeMap::Stack(stack) => stack.at(place.row, place.column, alt_m)?,
        };
        // Rows replace degrees there, so rows per degree are dimensionless here.
        let (per_row, per_column) = (on_nodes.d_lat_nt_per_rad, on_nodes.d_lon_nt_per_rad);
        let along = |d: usize| per_row * place.row_per_deg[d] + per_column * place.column_per_deg[d];
        Some(FieldValue { d_lat_nt_per_rad: along(0), d_lon_nt_per_rad: along(1), ..on_nodes })
    }

    /// Same as [`Self::at`], for many positions; positions without a value are NaN.
    ///
    /// # Errors
    /// Fails with [`MapGridError::Places`] for columns of different lengths.
    pub fn at_many(
        &self,
        lat_deg: &[f64],
        lon_deg: &[f64],
        alt_m: &[f64],
        out: &mut FieldColumns,
    ) -> Result<(), MapGridError> {
        LookupPositions { lat_deg, lon_deg, alt_m }.check(true)?;
        out.resize(lat_deg.len());
        for (i, ((lat, lon), alt)) in lat_deg.iter().zip(lon_deg).zip(alt_m).enumerate() {
            out.set(i, self.at(*lat, *lon, *alt));
        }
        Ok(())
    }
}
