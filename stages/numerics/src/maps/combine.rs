//! Several overlapping maps on one grid: resampled, freed of their offsets to each other, joined with feathered edges.
//!
//! The maps are of one plane and one height (continue them first), each with its own spacing and extent. What is
//! reported of the overlaps before and after is the evidence that they are of one field.

mod bias;
mod distance;
mod resample;

use crate::maps::plane_grid::{EvenAxis, PlaneGrid};
pub use bias::{Bias, BiasModel};
use bias::{Pair, estimate, pairs};
use distance::distance_to_unknown;
use rayon::prelude::*;
use resample::resampled;
use thiserror::Error;

/// A map to be combined.
#[derive(Clone, Copy, Debug)]
pub struct Piece<'a> {
    /// The map.
    pub grid: &'a PlaneGrid,
    /// What its values weigh in [`Blend::Average`], above zero: the inverse square of its error, say.
    pub weight: f64,
}

/// How values of several maps at one place become one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Blend {
    /// The first map that knows the place, faded into the next towards its edge.
    #[default]
    Priority,
    /// The mean by weight, each map fading out towards its edge.
    Average,
}

/// How maps are combined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CombineOptions {
    /// How values become one.
    pub blend: Blend,
    /// Over this distance from the edge of what it knows, in metres, a map fades in from nothing to its whole weight,
    /// by half a period of a cosine. Zero: no fading, and so a step at each edge.
    pub feather_m: f64,
    /// What is taken off each map before.
    pub bias: BiasModel,
}

impl Default for CombineOptions {
    /// By priority, faded over 1 km, with nothing taken off.
    fn default() -> Self {
        Self { blend: Blend::Priority, feather_m: 1000.0, bias: BiasModel::Nothing }
    }
}

/// The difference of two maps where both are known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Differences {
    /// At how many nodes of the combined grid.
    pub count: usize,
    /// The median of the first map less the second.
    pub median: f64,
    /// The root mean square.
    pub rms: f64,
}

/// The overlap of two maps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overlap {
    /// The first map, from 0 in the order given.
    pub first: usize,
    /// The second.
    pub second: usize,
    /// How they differ as they are.
    pub before: Differences,
    /// How they differ when freed of their biases.
    pub after: Differences,
}

/// The combined map and what was found on the way.
#[derive(Clone, Debug, PartialEq)]
pub struct Combined {
    /// The combined map, NaN where no map is known.
    pub grid: PlaneGrid,
    /// What was taken off each map, in the order given.
    pub biases: Vec<Bias>,
    /// Every pair of maps that overlap.
    pub overlaps: Vec<Overlap>,
}

/// Why maps cannot be combined.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CombineError {
    /// There is no map.
    #[error("there is no map to combine")]
    Nothing,
    /// A map's values are not as many as its nodes, or it is too small to be interpolated, or a step is not above zero.
    #[error(
        "map {piece}: {values} values for {rows} rows x {columns} columns; it takes two of each, and steps above zero"
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
    #[error("map {piece}: the value in row {row}, column {column} is infinite; an unknown value is NaN")]
    Infinite {
        /// The map, from 0.
        piece: usize,
        /// The row, from 0 in the south.
        row: usize,
        /// The column, from 0 in the west.
        column: usize,
    },
    /// The grid to combine on has no nodes, or a step that is not above zero.
    #[error("the grid to combine on has {rows} rows x {columns} columns with steps of {north_m} m and {east_m} m")]
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
    /// A parameter is out of its range.
    #[error("{name} is {value}; it must be a finite number above zero")]
    Parameter {
        /// The parameter.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}

/// Combines maps on the grid of the given axes; the first map keeps its level, and the biases of the others are to it.
///
/// Each map is resampled by the natural bicubic spline; a node that lies on a map's node takes its value as it is. A
/// map much finer than the grid is sampled, not averaged. The same bits on any number of threads.
///
/// # Errors
/// Where there is no map, one is not well formed, or a parameter is out of its range.
pub fn combine(
    pieces: &[Piece<'_>],
    east_m: EvenAxis,
    north_m: EvenAxis,
    options: &CombineOptions,
) -> Result<Combined, CombineError> {
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
    let overlaps = pairs.iter().zip(before.into_iter().zip(after)).map(|(pair, (before, after))| Overlap {
        first: pair.first,
        second: pair.second,
        before,
        after,
    });
    let overlaps = overlaps.collect();
    let values = blended(pieces, &maps, &target, options);
    Ok(Combined { grid: target.with(values), biases, overlaps })
}

fn check(
    pieces: &[Piece<'_>],
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
    for (piece, Piece { grid, weight }) in pieces.iter().enumerate() {
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

fn differences(maps: &[Vec<f64>], pairs: &[Pair]) -> Vec<Differences> {
    let of = |pair: &Pair| {
        let mut all = pair.differences(maps);
        let squares: f64 = all.iter().map(|d| d * d).sum();
        let rms = (squares / all.len() as f64).sqrt();
        Differences { count: all.len(), median: bias::median(&mut all), rms }
    };
    pairs.par_iter().map(of).collect()
}

/// The share of a map at a distance from the edge of what it knows: the cosine ramp.
fn faded(distance_m: f64, feather_m: f64) -> f64 {
    if distance_m >= feather_m {
        return 1.0;
    }
    0.5 - 0.5 * (std::f64::consts::PI * distance_m / feather_m).cos()
}

fn blended(pieces: &[Piece<'_>], maps: &[Vec<f64>], target: &PlaneGrid, options: &CombineOptions) -> Vec<f64> {
    let nodes = target.rows() * target.columns();
    // What is left for the maps that follow, the sum of values by share, and the sum of shares.
    let mut sums = vec![[1.0, 0.0, 0.0]; nodes];
    for (piece, map) in pieces.iter().zip(maps) {
        let edge_m = distance_to_unknown(map, target);
        sums.par_iter_mut().zip(map.par_iter().zip(&edge_m)).for_each(|([left, sum, shares], (value, edge_m))| {
            if value.is_nan() {
                return;
            }
            let fade = faded(*edge_m, options.feather_m);
            let share = match options.blend {
                Blend::Priority => fade * *left,
                Blend::Average => fade * piece.weight,
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
