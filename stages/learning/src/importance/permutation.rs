//! Permutation importance, by blocks of time.

use numerics::random::{SplitMix64, seed_of};
use rayon::prelude::*;

use super::{ImportanceError, PredictionFunction, TOGETHER, answers, check_groups};
use crate::{
    draws,
    rows::{entries, finite_rows, setting, sum_of},
};

/// Block length, number of repeats and seed of a permutation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PermutationBlocks {
    /// Rows per block. A block must be longer than the correlation time. Otherwise, the permuted values resemble the
    /// original values.
    pub rows: usize,
    /// Number of permutations.
    pub repeats: usize,
    /// Seed of the permutations.
    pub seed: u64,
}

/// Mean square error of a model, and the increase of this error when each group of columns is permuted.
#[derive(Debug, Clone, PartialEq)]
pub struct PermutationImportance {
    /// Mean square error of the unchanged rows, in the square of the target's unit.
    pub base: f64,
    /// Increase of the mean square error for each group and repeat when the group's columns are permuted.
    pub increases: Vec<Vec<f64>>,
}

/// Increase of the mean square error of the targets `y` when the columns of a group come from other rows [Breiman 2001,
/// "Random forests", section 10]. Rows, of `width` columns each, are in time order. The rows are cut into blocks, and
/// the last block may be shorter. The blocks are permuted by a random single cycle, so that no block keeps its
/// position. Single samples are not permuted, because a slow series would become noise.
///
/// In each repeat all groups are permuted in the same way, so that they are comparable. Groups may share columns.
///
/// # Errors
/// Fails for values that are not finite, invalid groups or settings, or fewer than two blocks. Also fails if the model
/// fails or returns anything but one finite number per row.
pub fn permutation<E: Send>(
    model: &PredictionFunction<'_, E>,
    x: &[f64],
    width: usize,
    y: &[f64],
    groups: &[Vec<usize>],
    blocks: &PermutationBlocks,
) -> Result<PermutationImportance, ImportanceError<E>> {
    let rows = finite_rows("the matrix", x, width)?;
    entries("the target", y.len(), rows)?;
    finite_rows("the target", y, 1)?;
    check_groups(width, groups)?;
    setting("the number of rows of a block", 0.0, "at least 1", blocks.rows > 0)?;
    setting("the number of repeats", 0.0, "at least 1", blocks.repeats > 0)?;
    if rows <= blocks.rows {
        return Err(ImportanceError::OneBlock { rows, block: blocks.rows });
    }
    let sources: Vec<Vec<u32>> = (0..blocks.repeats).map(|repeat| source_rows(blocks, repeat, rows)).collect();
    let base = mean_square(&answers(model, x, width, 1)?, y);
    let tasks: Vec<(&Vec<usize>, &Vec<u32>)> =
        groups.iter().flat_map(|g| sources.iter().map(move |s| (g, s))).collect();
    let one = |(group, source): &(&Vec<usize>, &Vec<u32>)| exchanged(model, x, width, y, group, source);
    let made: Vec<Result<f64, ImportanceError<E>>> = tasks.par_iter().map(one).collect();
    let made: Vec<f64> = made.into_iter().collect::<Result<_, _>>()?;
    let of_group = |errors: &[f64]| errors.iter().map(|error| error - base).collect();
    Ok(PermutationImportance { base, increases: made.chunks(blocks.repeats).map(of_group).collect() })
}

/// For each row, the row from which the permuted columns are taken.
fn source_rows(blocks: &PermutationBlocks, repeat: usize, rows: usize) -> Vec<u32> {
    let mut bits = SplitMix64::new(seed_of(blocks.seed, &["permutation", &repeat.to_string()]));
    let order = draws::cycle(&mut bits, rows.div_ceil(blocks.rows));
    let block = |k: usize| k * blocks.rows..rows.min((k + 1) * blocks.rows);
    order.into_iter().flat_map(block).map(|row| row as u32).collect()
}

/// Mean square error when the columns of `group` are taken from the rows `source`.
fn exchanged<E>(
    model: &PredictionFunction<'_, E>,
    x: &[f64],
    width: usize,
    y: &[f64],
    group: &[usize],
    source: &[u32],
) -> Result<f64, ImportanceError<E>> {
    let mut found = Vec::with_capacity(y.len());
    for (rows, source) in x.chunks(TOGETHER * width).zip(source.chunks(TOGETHER)) {
        let mut rows = rows.to_vec();
        for (row, from) in rows.chunks_exact_mut(width).zip(source) {
            let from = &x[*from as usize * width..][..width];
            group.iter().for_each(|&j| row[j] = from[j]);
        }
        found.extend(answers(model, &rows, width, 1)?);
    }
    Ok(mean_square(&found, y))
}

fn mean_square(found: &[f64], y: &[f64]) -> f64 {
    sum_of(y.len(), |i| (found[i] - y[i]).powi(2)) / y.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_a_permutation_keeps_blocks_whole_and_moves_each() {
        let rows = source_rows(&PermutationBlocks { rows: 500, repeats: 1, seed: 1 }, 0, 5200);
        let mut sorted = rows.clone();
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq(0..5200));
        assert!(rows.windows(2).filter(|pair| pair[1] != pair[0] + 1).count() <= 10);
        assert!(rows.chunks(500).enumerate().all(|(k, block)| block[0] as usize != 500 * k));
        assert_ne!(rows, source_rows(&PermutationBlocks { rows: 500, repeats: 1, seed: 1 }, 1, 5200));
    }
}
