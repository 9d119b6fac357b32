//! Shapley values of forests.

use rayon::prelude::*;

use super::{Attributions, ImportanceError, attributions, both_rows, group_of};
use crate::trees::{BoostingError, Forest, RegressionTreeNode};

/// The exact Shapley values of a forest's prediction of each row against background rows: the limit of
/// [`shapley_sampled`](super::shapley_sampled) for many samples [Lundberg et al. 2020, "From local explanations to
/// global understanding with explainable AI for trees", algorithm 3].
///
/// A row and a background row traverse each tree together. At a split that separates them, the path branches: the
/// node's group takes its values from one of the two rows, and deeper splits by that group use the same row. Consider a
/// leaf that requires the row's columns of n groups and the background's columns of m groups. It adds (n − 1)! m!/(n +
/// m)! of its value to each of the n groups and subtracts n! (m − 1)!/(n + m)! from each of the m groups.
///
/// # Errors
/// Fails for values that are not finite, a column that is not in exactly one group, or a malformed forest.
pub fn shapley_trees(
    forest: &Forest,
    rows: &[f64],
    background: &[f64],
    width: usize,
    groups: &[Vec<usize>],
) -> Result<Attributions, ImportanceError<BoostingError>> {
    let (explained, count) = both_rows(rows, background, width)?;
    let group_of = group_of(width, groups)?;
    forest.check(width).map_err(ImportanceError::Model)?;
    let base = forest.predict(background, width).iter().sum::<f64>() / count as f64;
    let one = |row: usize| {
        let x = &rows[row * width..(row + 1) * width];
        let mut values = vec![0.0; groups.len()];
        for b in background.chunks_exact(width) {
            let mut walk =
                ShapleyTreeTraversal { group_of: &group_of, x, b, own: vec![], other: vec![], values: &mut values };
            forest.trees.iter().for_each(|tree| walk.down(&tree.nodes, 0));
        }
        values.iter_mut().for_each(|v| *v /= count as f64);
        Ok((values, vec![0.0; groups.len()]))
    };
    attributions(base, (0..explained).into_par_iter().map(one).collect())
}

/// State of a traversal of a tree by an explained row and a background row.
struct ShapleyTreeTraversal<'a> {
    group_of: &'a [usize],
    x: &'a [f64],
    b: &'a [f64],
    /// Groups whose columns must have the values of the explained row on this path.
    own: Vec<usize>,
    /// Groups whose columns must have the values of the background row on this path.
    other: Vec<usize>,
    values: &'a mut [f64],
}

impl ShapleyTreeTraversal<'_> {
    fn down(&mut self, nodes: &[RegressionTreeNode], at: usize) {
        let (feature, threshold, left, right) = match nodes[at] {
            RegressionTreeNode::Leaf { value } => return self.leaf(value),
            RegressionTreeNode::Split { feature, threshold, left, right } => (feature, threshold, left, right),
        };
        let next = |row: &[f64]| if row[feature] <= threshold { left } else { right };
        let (own, other) = (next(self.x), next(self.b));
        let group = self.group_of[feature];
        if own == other || self.own.contains(&group) {
            self.down(nodes, own);
        } else if self.other.contains(&group) {
            self.down(nodes, other);
        } else {
            self.own.push(group);
            self.down(nodes, own);
            self.own.pop();
            self.other.push(group);
            self.down(nodes, other);
            self.other.pop();
        }
    }

    fn leaf(&mut self, value: f64) {
        let (n, m) = (self.own.len(), self.other.len());
        // (n + m)!/(n! m!); n and m are at most the depth of the tree.
        let ways = (1..=n).fold(1.0, |ways, k| ways * (m + k) as f64 / k as f64);
        self.own.iter().for_each(|&group| self.values[group] += value / (n as f64 * ways));
        self.other.iter().for_each(|&group| self.values[group] -= value / (m as f64 * ways));
    }
}
