//! Importance of the inputs of a model, by methods that use only its predictions or derivatives.
//!
//! | Item | Result for a group of columns |
//! |:--|:--|
//! | [`permutation()`] | increase of the error when the group's blocks of time are permuted |
//! | [`shapley_sampled`] | contribution to each prediction, by sampled orders of the groups |
//! | [`shapley_linear`] | exact contribution to each prediction of a linear model |
//! | [`shapley_trees()`] | exact contribution to each prediction of a forest |
//! | [`expected_gradients()`] | contribution to each prediction, along straight paths from background rows |
//! | [`pearson()`], [`spearman`] | correlation of a column with the target, for any model |
//! | [`morris()`] | elementary effects over the ranges of the columns |
//! | [`sobol()`] | shares of the variance over the ranges of the columns |
//! | [`iterative_hard_thresholding`] | membership in the few columns of a sparse linear model |
//!
//! A contribution is relative to background rows. When a group is treated as unknown, its columns take the values of
//! each background row in turn; the other groups keep their values. With correlated groups, this gives rows that do not
//! occur in the data, to which the model extrapolates. Therefore compare groups that each hold all columns of one
//! sensor, not single columns.
//!
//! The ranges of [`morris()`] and [`sobol()`] form a box, and the columns vary in it independently. Correlated columns
//! therefore take combinations that do not occur in the data.
//!
//! A model is a function from rows to predictions (or derivatives). The result of the function for a row depends on
//! that row only. The model is called with a few thousand rows at a time, from several threads.

mod correlation;
mod expected_gradients;
mod hard_thresholding;
mod morris;
mod permutation;
mod ranges;
#[cfg(test)]
mod sensitivity_tests;
mod shapley;
mod shapley_trees;
mod sobol;
#[cfg(test)]
mod tests;

pub use correlation::{pearson, spearman};
pub use expected_gradients::expected_gradients;
pub use hard_thresholding::{SparseLinearModel, iterative_hard_thresholding};
pub use morris::{ElementaryEffects, MorrisDesign, elementary_effects, morris};
pub use permutation::{PermutationBlocks, PermutationImportance, permutation};
pub use shapley::{shapley_linear, shapley_sampled};
pub use shapley_trees::shapley_trees;
pub use sobol::{SobolDesign, SobolIndex, SobolIndices, SobolPredictions, sobol, sobol_indices};

use std::convert::Infallible;

use crate::rows::{RowsError, entries};

/// Rows per call of a model.
const TOGETHER: usize = 4096;

/// Function from rows of `width` columns to predictions, or to their derivatives with respect to the columns, row by
/// row.
pub type PredictionFunction<'a, E> = dyn Fn(&[f64]) -> Result<Vec<f64>, E> + Sync + 'a;

/// Sample size and seed of a sampled attribution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AttributionSampling {
    /// For [`shapley_sampled`]: number of orders of the groups per background row, at least 2. Each order is used
    /// forwards and in reverse. For [`expected_gradients()`]: number of points per explained row, at least 2.
    pub samples: usize,
    /// The seed of the draws.
    pub seed: u64,
}

/// Attributions of predictions to groups of columns.
#[derive(Debug, Clone, PartialEq)]
pub struct Attributions {
    /// Mean prediction of the background rows. The prediction of a row is this mean plus the row's values. NaN for
    /// [`expected_gradients()`], which uses no predictions. For [`shapley_linear`], the mean excludes the intercept.
    pub base: f64,
    /// Row-major, one column per group, in the unit of the prediction.
    pub values: Vec<f64>,
    /// Standard error of each value due to sampling; 0 for exact values.
    pub errors: Vec<f64>,
}

/// Error of the computation of feature importance.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ImportanceError<E = Infallible> {
    /// Rows or settings are invalid.
    #[error(transparent)]
    Rows(#[from] RowsError),
    /// The model fails.
    #[error("{0}")]
    Model(E),
    /// The model returns the wrong number of values for the given rows.
    #[error("the model returns {given} numbers, but {expected} are required")]
    Answer {
        /// Returned number of values.
        given: usize,
        /// Required number of values.
        expected: usize,
    },
    /// The model returns NaN or an infinite number for finite rows.
    #[error("the model returns a number that is not finite")]
    NotFinite,
    /// There are fewer than two blocks, so no blocks can be permuted.
    #[error("{rows} rows are fewer than two blocks of {block} rows; use shorter blocks")]
    OneBlock {
        /// The number of rows.
        rows: usize,
        /// The number of rows of a block.
        block: usize,
    },
    /// All predictions are equal, so there is no variance to divide among the groups.
    #[error("the predictions are equal over the ranges of the inputs, so their variance has no shares")]
    Constant,
    /// A group is invalid.
    #[error("group {group} {what}")]
    Group {
        /// The group, from 0.
        group: usize,
        /// Description of the error.
        what: &'static str,
    },
    /// A column is in no group.
    #[error("column {column} is in no group")]
    Ungrouped {
        /// The column, from 0.
        column: usize,
    },
}

/// Predictions of the model for rows of `width` columns: `each` numbers per row, all finite.
fn answers<E>(
    model: &PredictionFunction<'_, E>,
    rows: &[f64],
    width: usize,
    each: usize,
) -> Result<Vec<f64>, ImportanceError<E>> {
    let mut out = Vec::with_capacity(rows.len() / width * each);
    for rows in rows.chunks(TOGETHER * width) {
        let given = model(rows).map_err(ImportanceError::Model)?;
        let expected = rows.len() / width * each;
        if given.len() != expected {
            return Err(ImportanceError::Answer { given: given.len(), expected });
        }
        out.extend(given);
    }
    if out.iter().all(|y| y.is_finite()) { Ok(out) } else { Err(ImportanceError::NotFinite) }
}

/// Checks the groups. Fails for a group without columns, an unknown column, or a repeated column.
fn check_groups<E>(width: usize, groups: &[Vec<usize>]) -> Result<(), ImportanceError<E>> {
    let wrong = |columns: &Vec<usize>| {
        let mut sorted = columns.clone();
        sorted.sort_unstable();
        if columns.is_empty() {
            Some("has no columns")
        } else if sorted.last().is_some_and(|j| *j >= width) {
            Some("has a column that does not exist")
        } else {
            sorted.windows(2).any(|pair| pair[0] == pair[1]).then_some("has a column twice")
        }
    };
    if groups.is_empty() {
        return Err(RowsError::Empty { what: "the list of groups" }.into());
    }
    match groups.iter().enumerate().find_map(|(group, columns)| Some((group, wrong(columns)?))) {
        Some((group, what)) => Err(ImportanceError::Group { group, what }),
        None => Ok(()),
    }
}

/// The group of each column; each column must be in exactly one group.
fn group_of<E>(width: usize, groups: &[Vec<usize>]) -> Result<Vec<usize>, ImportanceError<E>> {
    check_groups(width, groups)?;
    let mut of = vec![None; width];
    for (group, columns) in groups.iter().enumerate() {
        for &j in columns {
            if of[j].replace(group).is_some() {
                return Err(ImportanceError::Group { group, what: "has a column of an earlier group" });
            }
        }
    }
    of.iter().enumerate().map(|(column, g)| g.ok_or(ImportanceError::Ungrouped { column })).collect()
}

/// The numbers of explained rows and of background rows. Fails for rows that are not finite.
fn both_rows<E>(rows: &[f64], background: &[f64], width: usize) -> Result<(usize, usize), ImportanceError<E>> {
    let explained = crate::rows::finite_rows("the matrix of rows to explain", rows, width)?;
    Ok((explained, crate::rows::finite_rows("the background", background, width)?))
}

/// Attributions of the prediction of one row to the groups, and their standard errors.
type RowAttributions<E> = Result<(Vec<f64>, Vec<f64>), ImportanceError<E>>;

/// Combines the values and errors of the rows.
fn attributions<E>(base: f64, rows: Vec<RowAttributions<E>>) -> Result<Attributions, ImportanceError<E>> {
    let mut all = Attributions { base, values: vec![], errors: vec![] };
    for row in rows {
        let (values, errors) = row?;
        entries("the errors", errors.len(), values.len())?;
        all.values.extend(values);
        all.errors.extend(errors);
    }
    Ok(all)
}
