//! Several overlapping maps on one grid: resampled, levelled to each other, and blended at feathered edges.
//!
//! The maps must share one plane and one height (continue them first); spacing and extent may differ. The reported
//! differences in the overlaps, before and after levelling, show whether the maps represent the same field.

mod bias;
mod distance;
mod resample;

use crate::maps::plane_grid::{EvenAxis, PlaneGrid};
use crate::regression::statistics;
pub use bias::{BiasModel, OverlapBias};
use bias::{OverlapPair, estimate, pairs};
use distance::distance_to_unknown;
use rayon::prelude::*;
use resample::resampled;
use thiserror::Error;

/// An input map and its weight.
#[derive(Clone, Copy, Debug)]
pub struct WeightedMap<'a> {
    /// The map.
    pub grid: &'a PlaneGrid,
    /// Weight of the map's values in [`BlendMethod::Average`], above zero; for example the inverse square of the map's
    /// error.
    pub weight: f64,
}

/// Rule for merging the values of several maps at one node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BlendMethod {
    /// The first map with a value at the node; towards its edge it is blended into the next map.
    #[default]
    Priority,
    /// Weighted mean; the weight of each map decreases towards its edge.
    Average,
}

/// Settings for combining maps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CombineOptions {
    /// Method that merges values.
    pub blend: BlendMethod,
    /// Distance from the edge of the known nodes of a map, in metres, over which the weight of the map rises from zero
    /// to its full value, as half a period of a cosine. Zero disables the ramp, which leaves a step at each edge.
    pub feather_m: f64,
    /// Model of the bias that is subtracted from each map first.
    pub bias: BiasModel,
}

impl Default for CombineOptions {
    /// Priority blending with ramps of 1 km, and no bias correction.
    fn default() -> Self {
        Self { blend: BlendMethod::Priority, feather_m: 1000.0, bias: BiasModel::Nothing }
    }
}

/// Statistics of the difference of two maps where both are known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapDifference {
    /// The number of nodes of the combined grid where both maps are known.
    pub count: usize,
    /// Median of the first map minus the second.
    pub median: f64,
    /// Root mean square of the difference.
    pub rms: f64,
}

/// The overlap of two maps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapOverlap {
    /// Index of the first map, from 0 in the given order.
    pub first: usize,
    /// Index of the second map.
    pub second: usize,
    /// Difference of the maps before bias correction.
    pub before: MapDifference,
    /// Difference of the maps after bias correction.
    pub after: MapDifference,
}

/// The combined map and its statistics.
#[derive(Clone, Debug, PartialEq)]
pub struct CombinedMap {
    /// The combined map, NaN where no map is known.
    pub grid: PlaneGrid,
    /// The bias that was subtracted from each map, in the given order.
    pub biases: Vec<OverlapBias>,
    /// Every pair of maps that overlap.
    pub overlaps: Vec<MapOverlap>,
}

/// Error of combining maps.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CombineError {
    /// There is no map.
    #[error("there is no map to combine")]
    Nothing,
    /// The number of values of a map differs from its number of nodes, the map is too small to be interpolated, or a
    /// step is not above zero.
    #[error(
        "map {piece} has {values} values for {rows} rows x {columns} columns; a map requires at least two rows, two \
         columns and steps above zero"
    )]
    Size {
        /// The map, from 0.
        piece: usize,
        /// The number of values.
        values: usize,
        /// The number of rows.
        rows: usize,
        /// The number of columns.
        columns: usize,
    },
    /// A value is infinite.
    #[error("map {piece}: the value in row {row}, column {column} is infinite; use NaN for an unknown value")]
    Infinite {
        /// The map, from 0.
        piece: usize,
        /// The row, from 0 in the south.
        row: usize,
        /// The column, from 0 in the west.
        column: usize,
    },
    /// The target grid has no nodes, or a step that is not above zero.
    #[error(
        "the target grid requires rows, columns and steps above zero, but has {rows} rows x {columns} columns with \
         steps of {north_m} m and {east_m} m"
    )]
    Target {
        /// The number of rows.
        rows: usize,
        /// The number of columns.
        columns: usize,
        /// The step northward.
        north_m: f64,
        /// The step eastward.
        east_m: f64,
    },
    /// A parameter is out of its valid range.
    #[error("{name} is {value}; it must be a finite number above zero")]
    Parameter {
        /// The parameter.
        name: &'static str,
        /// Value of the parameter.
        value: f64,
    },
}

/// Combines maps on the grid of the given axes; the first map keeps its level, and the biases of the others are
/// relative to it.
///
/// Each map is resampled by the natural bicubic spline; at a node of the map itself, the value is unchanged. A map that
/// is much finer than the grid is sampled, not averaged. Results are bit-identical for any number of threads.
///
/// # Errors
/// Fails if there is no map, a map is invalid, or a parameter is out of its range.
pub fn combine(
    pieces: &[WeightedMap<'_>],
    east_m: EvenAxis,
    north_m: EvenAxis,
    options: &CombineOptions,
) -> Result<CombinedMap, CombineError> {
    check(pieces, &east_m, &north_m, options)?;
    let target = PlaneGrid { east_m, north_m, values: Vec::new() };
    let mut maps: Vec<Vec<f64>> = pieces.iter().map(|piece| resampled(piece.grid, &target)).collect();
    let pairs = pairs(&maps);
    let before = differences(&maps, &pairs);
    let biases = estimate(&maps, &pairs, &target, options.bias);
    for (map, bias) in maps.iter_mut().zip(&biases) {
        bias.take_off(&target, map);
    }
    let after = differences(&maps, &pairs);
    let overlaps = pairs.iter().zip(before.into_iter().zip(after)).map(|(pair, (before, after))| MapOverlap {
        first: pair.first,
        second: pair.second,
        before,
        after,
    });
    let overlaps = overlaps.collect();
    let values = blended(pieces, &maps, &target, options);
    Ok(CombinedMap { grid: target.with(values), biases, overlaps })
}

fn check(
    pieces: &[WeightedMap<'_>],
    east_m: &EvenAxis,
    north_m: &EvenAxis,
    options: &CombineOptions,
) -> Result<(), CombineError> {
    let good = |axis: &EvenAxis, least: usize| axis.len >= least && axis.step > 0.0 && axis.step.is_finite();
    if pieces.is_empty() {
        return Err(CombineError::Nothing);
    }
    if !(good(east_m, 1) && good(north_m, 1)) {
        let (rows, columns) = (north_m.len, east_m.len);
        return Err(CombineError::Target { rows, columns, north_m: north_m.step, east_m: east_m.step });
    }
    for (piece, WeightedMap { grid, weight }) in pieces.iter().enumerate() {
        let (rows, columns, values) = (grid.rows(), grid.columns(), grid.values.len());
        let complete = rows.checked_mul(columns) == Some(values);
        if !(complete && good(&grid.east_m, 2) && good(&grid.north_m, 2)) {
            return Err(CombineError::Size { piece, values, rows, columns });
        }
        if let Some(node) = grid.values.iter().position(|value| value.is_infinite()) {
            return Err(CombineError::Infinite { piece, row: node / columns, column: node % columns });
        }
        if !(*weight > 0.0 && weight.is_finite()) {
            return Err(CombineError::Parameter { name: "the weight of a map", value: *weight });
        }
    }
    if !(options.feather_m >= 0.0 && options.feather_m.is_finite()) {
        return Err(CombineError::Parameter { name: "the feather width", value: options.feather_m });
    }
    Ok(())
}

fn differences(maps: &[Vec<f64>], pairs: &[OverlapPair]) -> Vec<MapDifference> {
    let of = |pair: &OverlapPair| {
        let mut all = pair.differences(maps);
        let squares: f64 = all.iter().map(|d| d * d).sum();
        let rms = (squares / all.len() as f64).sqrt();
        MapDifference { count: all.len(), median: statistics::median(&mut all), rms }
    };
    pairs.par_iter().map(of).collect()
}

/// The weight of a map at a distance from the edge of its known nodes: a cosine ramp.
fn faded(distance_m: f64, feather_m: f64) -> f64 {
    if distance_m >= feather_m {
        return 1.0;
    }
    0.5 - 0.5 * (std::f64::consts::PI * distance_m / feather_m).cos()
}

fn blended(pieces: &[WeightedMap<'_>], maps: &[Vec<f64>], target: &PlaneGrid, options: &CombineOptions) -> Vec<f64> {
    let nodes = target.rows() * target.columns();
    // Remaining weight for the following maps, weighted sum of values, and sum of weights.
    let mut sums = vec![[1.0, 0.0, 0.0]; nodes];
    for (piece, map) in pieces.iter().zip(maps) {
        let edge_m = distance_to_unknown(map, target);
        sums.par_iter_mut().zip(map.par_iter().zip(&edge_m)).for_each(|([left, sum, shares], (value, edge_m))| {
            if value.is_nan() {
                return;
            }
            let fade = faded(*edge_m, options.feather_m);
            let share = match options.blend {
                BlendMethod::Priority => fade * *left,
                BlendMethod::Average => fade * piece.weight,
            };
            *sum += share * value;
            *shares += share;
            *left *= 1.0 - fade;
        });
    }
    sums.par_iter().map(|[_, sum, shares]| if *shares > 0.0 { sum / shares } else { f64::NAN }).collect()
}

#[cfg(test)]
mod tests;
