//! Reduction of the points in each block to one point, so that densely and sparsely sampled lines have equal weight.

use super::nearest::range;
use crate::regression::statistics::median;
use rayon::prelude::*;

/// Method that reduces the values of a block to one value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockReduction {
    /// The median, which is robust to outliers.
    Median,
    /// The mean.
    Mean,
}

/// Points that represent blocks of a survey, by column.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurveyBlocks {
    /// Easting, in metres.
    pub easting_m: Vec<f64>,
    /// Northing, in metres.
    pub northing_m: Vec<f64>,
    /// Height, in metres.
    pub height_m: Vec<f64>,
    /// Value, in nT.
    pub value_nt: Vec<f64>,
    /// The number of points in each block.
    pub points: Vec<usize>,
}

/// Reduces the points in each square block of `block_m` to the median or mean of position, height and value. Blocks
/// start at the south-west corner of the points. Blocks are ordered from south to north and from west to east.
///
/// All coordinates are metres and, like the values, finite; if `block_m` is zero, each point is a separate block.
pub fn reduce_blocks(points: [&[f64]; 4], block_m: f64, how: BlockReduction) -> SurveyBlocks {
    let [easting_m, northing_m, ..] = points;
    let first = [range(easting_m)[0], range(northing_m)[0]];
    let mut keyed: Vec<((i64, i64), usize)> = (0..easting_m.len())
        .map(|i| {
            let cell = |x: f64, from: f64| if block_m > 0.0 { ((x - from) / block_m).floor() as i64 } else { i as i64 };
            ((cell(northing_m[i], first[1]), cell(easting_m[i], first[0])), i)
        })
        .collect();
    keyed.par_sort_unstable();
    let runs: Vec<&[((i64, i64), usize)]> = keyed.chunk_by(|a, b| a.0 == b.0).collect();
    let rows: Vec<([f64; 4], usize)> = runs
        .par_iter()
        .map(|run| (points.map(|column| one(run.iter().map(|r| column[r.1]).collect(), how)), run.len()))
        .collect();
    let column = |k: usize| rows.iter().map(|row| row.0[k]).collect();
    SurveyBlocks {
        easting_m: column(0),
        northing_m: column(1),
        height_m: column(2),
        value_nt: column(3),
        points: rows.iter().map(|row| row.1).collect(),
    }
}

fn one(mut values: Vec<f64>, how: BlockReduction) -> f64 {
    match how {
        BlockReduction::Median => median(&mut values),
        BlockReduction::Mean => values.iter().sum::<f64>() / values.len() as f64,
    }
}
