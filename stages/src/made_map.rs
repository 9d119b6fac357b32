//! Conversion of maps between tables and grids, for the stages that process maps.

use arrow_array::RecordBatch;
use grids::AnomalyGrid;
use numerics::maps::{
    fill::{FillError, SmoothFill, smooth},
    plane_grid::PlaneGrid,
};
use schemas::{Fault, StageOutput};

/// Columns that a stage reads from a map.
pub fn whole_map() -> Vec<String> {
    schemas::map::COLUMNS.iter().map(|(name, _)| (*name).to_owned()).collect()
}

/// Maps of a stage's inputs, each on its native grid.
///
/// # Errors
/// Fails if a table is not a map.
pub fn grids(maps: &[RecordBatch]) -> Result<Vec<AnomalyGrid>, Fault> {
    maps.iter().map(|table| AnomalyGrid::of_table(table).map_err(Fault::from)).collect()
}

/// Output of a stage: a map and the warnings about it.
///
/// # Errors
/// Fails if the map has no known value.
pub fn made(map: &AnomalyGrid, warnings: Vec<String>) -> Result<StageOutput, Fault> {
    Ok(StageOutput { columns: map.made()?, warnings })
}

/// Map with its unknown nodes filled by minimum curvature, for transforms of the whole map.
///
/// # Errors
/// Fails if the map has too few known nodes.
pub fn without_gaps(map: &PlaneGrid) -> Result<PlaneGrid, FillError> {
    if map.unknown() == 0 { Ok(map.clone()) } else { smooth(map, &SmoothFill::default()).map(|(full, _)| full) }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
pub mod testing {
    //! A small map for the tests of the stages that process maps.

    use std::path::Path;

    use grids::{Crs, GridHeight};
    use numerics::maps::plane_grid::EvenAxis;

    use super::*;

    /// Nodes along each side.
    pub const NODES: usize = 48;
    /// Distance between nodes, in metres.
    pub const STEP_M: f64 = 100.0;
    /// The height of the map, in metres.
    pub const LEVEL_M: f64 = 300.0;
    /// Wavenumbers of the waves eastward and northward, in 1/m.
    pub const K: [f64; 2] = [2.0 * std::f64::consts::PI / 1600.0, 2.0 * std::f64::consts::PI / 1200.0];

    /// A harmonic field with whole periods over the map, at the height `up_m` above the map, in nT.
    pub fn field_nt(east_m: f64, north_m: f64, up_m: f64) -> f64 {
        100.0 * (K[0] * east_m).sin() * (K[1] * north_m).cos() * (-K[0].hypot(K[1]) * up_m).exp()
    }

    /// The field on a grid of UTM zone 32.
    pub fn map() -> AnomalyGrid {
        let axis = |first: f64| EvenAxis { first, step: STEP_M, len: NODES };
        let values = (0..NODES * NODES)
            .map(|i| field_nt(STEP_M * (i % NODES) as f64, STEP_M * (i / NODES) as f64, 0.0))
            .collect();
        let crs = Crs::from_epsg(Path::new(""), 32632).unwrap();
        AnomalyGrid::new(axis(500_000.0), axis(5_000_000.0), crs, values, GridHeight::Level(LEVEL_M)).unwrap()
    }

    /// Values of the nodes in the middle third of a map, each after the node's distances from the south-west corner.
    pub fn middle(map: &AnomalyGrid) -> Vec<(f64, f64, f64)> {
        let inside = NODES / 3..2 * NODES / 3;
        let nodes = inside.clone().flat_map(|j| inside.clone().map(move |i| (i, j)));
        nodes.map(|(i, j)| (STEP_M * i as f64, STEP_M * j as f64, map.anomaly_nt[j * NODES + i])).collect()
    }
}
