//! Gradient-boosted regression trees on histograms: a common baseline.
//!
//! Each tree is fitted to the residuals of the trees before it and added with a factor, the learning rate [Friedman
//! 2001, "Greedy function approximation: a gradient boosting machine"]. For a squared loss with residuals r, the value
//! of a leaf of n rows and the gain of a split are [Chen and Guestrin 2016, "XGBoost", (5) and (7)]
//!
//! ```text
//! value = rate Σr/(n + l2)        gain = (Σr)²/(n + l2) of the left + the same of the right - the same of both
//! ```
//!
//! Columns are divided once into at most 256 bins by their quantiles. A leaf is split at the bin edge with the largest
//! gain, which follows from the sums of each bin. The leaf with the largest gain is split first, up to a number of
//! leaves [Ke et al. 2017, "LightGBM"]. The sums of the larger of two leaves are the parent's sums minus the sums of
//! the smaller leaf. scikit-learn's `HistGradientBoostingRegressor` uses the same method for a squared error; with up
//! to 256 distinct values per column the trees are identical.
//!
//! A row goes left if its value is at most the threshold. Trees are constant beyond the range of the training values,
//! so they do not follow a drift out of that range.
//!
//! Sums are computed column by column in row order, so the same seed gives bit-identical results on any number of
//! threads.

mod bins;
mod grow;
mod state;
#[cfg(test)]
mod tests;

use std::ops::ControlFlow;

use numerics::random::{SplitMix64, seed_of};
use rayon::prelude::*;

use crate::{
    draws,
    rows::{RowsError, entries, finite_rows, setting, sum_of},
};
use bins::ColumnBins;
use grow::TreeGrower;
pub use state::{trees_from_bytes, trees_to_bytes};

/// Rows per prediction task.
const BLOCK: usize = 512;

/// Settings of a boosted forest.
#[derive(Debug, Clone, PartialEq)]
pub struct BoostingSettings {
    /// The maximum number of trees.
    pub trees: usize,
    /// The factor of each tree, above 0.
    pub learning_rate: f64,
    /// The maximum number of leaves of a tree, at least 2.
    pub leaves: usize,
    /// Maximum depth of a leaf, in splits; `None` for no limit.
    pub depth: Option<usize>,
    /// Minimum number of rows of a leaf.
    pub least_rows: usize,
    /// Constant added to the number of rows of a leaf. It shrinks the values of small leaves.
    pub l2: f64,
    /// Fraction of the rows that each tree uses, above 0 and at most 1, drawn anew for each tree.
    pub subsample: f64,
    /// The seed of the draws.
    pub seed: u64,
    /// Training stops after this many trees without an improvement in the validation loss.
    pub patience: Option<usize>,
}

impl Default for BoostingSettings {
    /// 200 trees of up to 31 leaves of at least 20 rows, learning rate 0.1, all rows, no depth limit, no early
    /// stopping.
    fn default() -> Self {
        Self {
            trees: 200,
            learning_rate: 0.1,
            leaves: 31,
            depth: None,
            least_rows: 20,
            l2: 0.0,
            subsample: 1.0,
            seed: 0,
            patience: None,
        }
    }
}

impl BoostingSettings {
    fn check(&self, rows: usize, validated: bool) -> Result<(), BoostingError> {
        setting("the number of trees", self.trees as f64, "at least 1", self.trees > 0)?;
        let rate = self.learning_rate;
        setting("the learning rate", rate, "above 0 and finite", rate > 0.0 && rate.is_finite())?;
        setting("the number of leaves", self.leaves as f64, "at least 2", self.leaves > 1)?;
        setting("the depth", 0.0, "at least 1", self.depth != Some(0))?;
        setting("the minimum number of rows of a leaf", 0.0, "at least 1", self.least_rows > 0)?;
        setting("l2", self.l2, "at least 0 and finite", self.l2 >= 0.0 && self.l2.is_finite())?;
        let part = self.subsample;
        setting("the fraction of rows per tree", part, "above 0 and at most 1", part > 0.0 && part <= 1.0)?;
        setting("the patience", 0.0, "at least 1", self.patience != Some(0))?;
        setting("the number of rows", rows as f64, "below 2^32", u32::try_from(rows).is_ok())?;
        if self.patience.is_some() && !validated {
            return Err(BoostingError::NoValidation);
        }
        let seen = self.seen(rows);
        let needed = self.least_rows.saturating_mul(2);
        if seen < needed { Err(BoostingError::TooFewRows { rows: seen, needed }) } else { Ok(()) }
    }

    /// The number of rows that a tree uses.
    fn seen(&self, rows: usize) -> usize {
        if self.subsample >= 1.0 { rows } else { (self.subsample * rows as f64).floor() as usize }
    }
}

/// Sum of a constant and of regression trees.
#[derive(Debug, Clone, PartialEq)]
pub struct Forest {
    /// The mean of the target.
    pub base: f64,
    /// The trees; their values include the learning rate.
    pub trees: Vec<RegressionTree>,
}

/// Regression tree. The root of the tree is node 0.
#[derive(Debug, Clone, PartialEq)]
pub struct RegressionTree {
    /// The nodes; children come after their parent.
    pub nodes: Vec<RegressionTreeNode>,
}

/// A node of a tree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RegressionTreeNode {
    /// Rows with `feature` at most `threshold` continue at node `left`, all others at node `right`.
    Split {
        /// The column, from 0.
        feature: usize,
        /// The threshold, in the unit of the column.
        threshold: f64,
        /// Index of a child node, larger than the index of this node.
        left: usize,
        /// Index of a child node, larger than the index of this node.
        right: usize,
    },
    /// A leaf, where the path of a row ends.
    Leaf {
        /// Value that the tree adds, in the unit of the target.
        value: f64,
    },
}

/// Boosted forest and the losses of its training.
#[derive(Debug, Clone, PartialEq)]
pub struct BoostingResult {
    /// The first `best` trees.
    pub forest: Forest,
    /// Mean square errors of the training rows and of the validation rows (NaN if there are none) after each tree.
    pub losses: Vec<(f64, f64)>,
    /// Number of trees at which the validation loss is smallest. Of several equal losses, the smallest number is used.
    /// Without validation, all trees are used.
    pub best: usize,
}

/// Error of the training of a boosted forest.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BoostingError {
    /// Rows or settings are invalid.
    #[error(transparent)]
    Rows(#[from] RowsError),
    /// There are too few rows for two leaves.
    #[error("each tree uses {rows} rows, but two leaves require {needed}")]
    TooFewRows {
        /// The number of rows that a tree uses.
        rows: usize,
        /// Twice the minimum number of rows of a leaf.
        needed: usize,
    },
    /// Early stopping requires validation rows.
    #[error("training cannot end early without validation rows")]
    NoValidation,
    /// The first tree is a single leaf.
    #[error(
        "no split reduces the loss: the target or all columns are constant, or the minimum number of rows of a leaf is \
         too large"
    )]
    NoSplit,
    /// The loss is not finite.
    #[error(
        "the loss after tree {tree} is not finite: set the learning rate below 1; if it is below 1, scale the target \
         down, because its squares overflow"
    )]
    Diverged {
        /// The number of trees; 0 for the mean alone.
        tree: usize,
    },
    /// A forest from another source is malformed.
    #[error("node {node} of tree {tree} {what}")]
    Malformed {
        /// The tree, from 0.
        tree: usize,
        /// The node, from 0.
        node: usize,
        /// Description of the error.
        what: &'static str,
    },
}

impl RegressionTree {
    /// Value that the tree adds for a row; NaN if a node refers to a missing column or node.
    pub fn value(&self, row: &[f64]) -> f64 {
        let mut at = 0;
        loop {
            let (feature, threshold, left, right) = match self.nodes.get(at) {
                Some(RegressionTreeNode::Leaf { value }) => return *value,
                Some(RegressionTreeNode::Split { feature, threshold, left, right }) => {
                    (*feature, *threshold, *left, *right)
                }
                None => return f64::NAN,
            };
            let Some(x) = row.get(feature) else { return f64::NAN };
            let next = if *x <= threshold { left } else { right };
            if next <= at {
                return f64::NAN;
            }
            at = next;
        }
    }

    /// Subtracts the predictions of this tree from the residuals of all rows.
    fn take_off(&self, x: &[f64], width: usize, residuals: &mut [f64]) {
        let rows = x.par_chunks_exact(width);
        residuals.par_iter_mut().zip(rows).with_min_len(BLOCK).for_each(|(r, row)| *r -= self.value(row));
    }

    fn fault(&self, width: usize) -> Option<(usize, &'static str)> {
        let wrong = |(at, node): (usize, &RegressionTreeNode)| match *node {
            RegressionTreeNode::Leaf { value } if !value.is_finite() => Some((at, "has a value that is not finite")),
            RegressionTreeNode::Leaf { .. } => None,
            RegressionTreeNode::Split { feature, .. } if feature >= width => {
                Some((at, "divides a column that does not exist"))
            }
            RegressionTreeNode::Split { threshold, .. } if threshold.is_nan() => Some((at, "has no threshold")),
            RegressionTreeNode::Split { left, right, .. }
                if left.min(right) <= at || left.max(right) >= self.nodes.len() =>
            {
                Some((at, "has a child that does not come after it"))
            }
            RegressionTreeNode::Split { .. } => None,
        };
        if self.nodes.is_empty() { Some((0, "is missing")) } else { self.nodes.iter().enumerate().find_map(wrong) }
    }
}

impl Forest {
    /// Predictions of rows of `width` columns each, in the unit of the target. NaN for a row that contains NaN, because
    /// neither side of a split applies.
    pub fn predict(&self, x: &[f64], width: usize) -> Vec<f64> {
        let rows = x.par_chunks_exact(width.max(1));
        let mut out = vec![0.0; rows.len()];
        out.par_chunks_mut(BLOCK).zip(x.par_chunks(BLOCK * width.max(1))).for_each(|(out, x)| {
            let rows = x.chunks_exact(width.max(1));
            out.iter_mut().zip(rows.clone()).for_each(|(out, row)| *out = self.start(row));
            for tree in &self.trees {
                out.iter_mut().zip(rows.clone()).for_each(|(out, row)| *out += tree.value(row));
            }
        });
        out
    }

    fn start(&self, row: &[f64]) -> f64 {
        if row.iter().any(|x| x.is_nan()) { f64::NAN } else { self.base }
    }

    /// Checks a forest from another source: columns below `width`, children after their parents, and finite numbers.
    ///
    /// # Errors
    /// Fails with [`BoostingError::Malformed`] for the first invalid node.
    pub fn check(&self, width: usize) -> Result<(), BoostingError> {
        let of = |(tree, t): (usize, &RegressionTree)| t.fault(width).map(|(node, what)| (tree, node, what));
        match self.trees.iter().enumerate().find_map(of) {
            Some((tree, node, what)) => Err(BoostingError::Malformed { tree, node, what }),
            None if self.base.is_finite() => Ok(()),
            None => Err(RowsError::NotFinite { what: "the base", row: 0, column: 0 }.into()),
        }
    }
}

/// Trains a forest on rows `x` of `width` columns each and their targets `y`, in any units: monotonic functions of a
/// column do not change the trees. `validation` has rows and targets of other lines or flights. `each` receives the
/// number of trees so far (from 1) and the mean square errors of the training rows and of the validation rows (NaN
/// without validation rows). If it returns `Break`, training ends and the trees so far are returned.
///
/// A constant column is never split. Training ends early if no split has a gain.
///
/// # Errors
/// Fails for values that are not finite, settings out of range, patience without validation, too few rows for two
/// leaves, a first tree without a split, or a loss that overflows.
pub fn boost(
    x: &[f64],
    width: usize,
    y: &[f64],
    how: &BoostingSettings,
    validation: Option<(&[f64], &[f64])>,
    each: &mut dyn FnMut(usize, f64, f64) -> ControlFlow<()>,
) -> Result<BoostingResult, BoostingError> {
    boost_on(vec![], x, width, y, how, validation, &mut |trees, train, ahead| each(trees.len(), train, ahead))
}

/// Callback after each tree with all trees so far, the training loss and the validation loss.
pub type TreeCallback<'a> = dyn FnMut(&[RegressionTree], f64, f64) -> ControlFlow<()> + 'a;

/// Resumes [`boost`] from the first trees of an interrupted training with the same rows and settings. The result is
/// bit-identical to the result of an uninterrupted training. `each` receives all trees so far.
///
/// # Errors
/// Returns the errors of [`boost`], and [`BoostingError::Malformed`] for a tree that does not match these columns.
pub fn boost_on(
    begun: Vec<RegressionTree>,
    x: &[f64],
    width: usize,
    y: &[f64],
    how: &BoostingSettings,
    validation: Option<(&[f64], &[f64])>,
    each: &mut TreeCallback<'_>,
) -> Result<BoostingResult, BoostingError> {
    let begun = Forest { base: 0.0, trees: begun };
    begun.check(width)?;
    let mut begun = begun.trees.into_iter();
    let rows = finite_rows("the matrix", x, width)?;
    entries("the target", y.len(), rows)?;
    finite_rows("the target", y, 1)?;
    how.check(rows, validation.is_some())?;
    let base = mean(y);
    let mut residuals: Vec<f64> = y.iter().map(|y| y - base).collect();
    let mut ahead = validation.map(|(x, y)| ValidationResiduals::new(x, width, y, base)).transpose()?;
    if !mean_square(&residuals).is_finite() {
        return Err(BoostingError::Diverged { tree: 0 });
    }
    let bins = ColumnBins::from_rows(x, width);
    let mut grower = TreeGrower::new(&bins, how);
    let mut boosted = BoostingResult { forest: Forest { base, trees: vec![] }, losses: vec![], best: 0 };
    let mut least = f64::INFINITY;
    for number in 1..=how.trees {
        let tree = match begun.next() {
            Some(tree) => {
                tree.take_off(x, width, &mut residuals);
                tree
            }
            None => {
                grower.draw(|all| drawn(how, number, all));
                let tree = grower.tree(&residuals);
                if tree.nodes.len() == 1 {
                    if number == 1 {
                        return Err(BoostingError::NoSplit);
                    }
                    // With another draw of rows, a split may exist; with the same rows, no split exists.
                    if how.subsample >= 1.0 {
                        break;
                    }
                }
                grower.take_off(&tree, x, &mut residuals);
                tree
            }
        };
        let loss = mean_square(&residuals);
        let validated = ahead.as_mut().map_or(f64::NAN, |ahead| ahead.add(&tree));
        if !loss.is_finite() || (ahead.is_some() && !validated.is_finite()) {
            return Err(BoostingError::Diverged { tree: number });
        }
        boosted.forest.trees.push(tree);
        boosted.losses.push((loss, validated));
        if ahead.is_none() || validated < least {
            (least, boosted.best) = (validated, number);
        }
        let patient = how.patience.is_none_or(|patience| number - boosted.best < patience);
        if each(&boosted.forest.trees, loss, validated).is_break() || !patient {
            break;
        }
    }
    boosted.forest.trees.truncate(boosted.best);
    Ok(boosted)
}

/// The rows that tree `number` uses, ascending; `None` selects all rows.
fn drawn(how: &BoostingSettings, number: usize, rows: usize) -> Option<Vec<u32>> {
    let seen = how.seen(rows);
    let bits = || SplitMix64::new(seed_of(how.seed, &["tree", &number.to_string()]));
    (seen < rows).then(|| draws::chosen(&mut bits(), rows, seen))
}

/// Validation rows, and the residuals of the targets in these rows.
struct ValidationResiduals<'a> {
    x: &'a [f64],
    width: usize,
    residuals: Vec<f64>,
}

impl<'a> ValidationResiduals<'a> {
    fn new(x: &'a [f64], width: usize, y: &[f64], base: f64) -> Result<Self, BoostingError> {
        let rows = finite_rows("the validation matrix", x, width)?;
        entries("the validation target", y.len(), rows)?;
        finite_rows("the validation target", y, 1)?;
        Ok(Self { x, width, residuals: y.iter().map(|y| y - base).collect() })
    }

    /// Adds a tree and returns the mean square error.
    fn add(&mut self, tree: &RegressionTree) -> f64 {
        let rows = self.x.par_chunks(BLOCK * self.width);
        self.residuals.par_chunks_mut(BLOCK).zip(rows).for_each(|(residuals, x)| {
            let rows = x.chunks_exact(self.width);
            residuals.iter_mut().zip(rows).for_each(|(residual, row)| *residual -= tree.value(row));
        });
        mean_square(&self.residuals)
    }
}

fn mean_square(x: &[f64]) -> f64 {
    sum_of(x.len(), |i| x[i] * x[i]) / x.len() as f64
}

/// Mean; a second pass corrects the rounding of the first pass.
pub(crate) fn mean(x: &[f64]) -> f64 {
    let rough = sum_of(x.len(), |i| x[i]) / x.len() as f64;
    rough + sum_of(x.len(), |i| x[i] - rough) / x.len() as f64
}
