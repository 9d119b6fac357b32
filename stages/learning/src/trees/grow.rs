//! Grows one tree: computes the sums of each bin and the best split of each leaf, and splits the best leaf first.

use std::ops::Range;

use rayon::prelude::*;

use super::{
    BoostingSettings, RegressionTree, RegressionTreeNode,
    bins::{BINS, ColumnBins, TOGETHER},
};

/// Minimum ratio of a gain to the larger of the two scores whose difference is the gain. Smaller gains are rounding
/// errors.
const ROUNDING: f64 = 1e-12;

/// Sum of the residuals and number of rows of each bin.
type BinHistogram = Vec<[f64; 2]>;

/// Number of bins of four columns.
const CHUNK: usize = BINS * TOGETHER;

/// Growth of regression trees from binned columns.
pub(super) struct TreeGrower<'a> {
    bins: &'a ColumnBins,
    how: &'a BoostingSettings,
    /// The rows that the tree uses, grouped by leaf in ascending order.
    rows: Vec<u32>,
    /// Scratch memory for the split of a leaf.
    scratch: Vec<u32>,
    /// The residuals of the rows of a leaf.
    ordered: Vec<f64>,
    /// Histograms that are not in use.
    pool: Vec<BinHistogram>,
    /// The leaves of the last tree.
    leaves: Vec<GrowingLeaf>,
    /// Whether the tree uses a subset of the rows.
    partial: bool,
}

/// Leaf of a growing tree.
struct GrowingLeaf {
    node: usize,
    range: Range<usize>,
    depth: usize,
    sum: f64,
    histogram: BinHistogram,
    split: Option<LeafSplit>,
}

/// Division of a leaf at a bin of a column.
#[derive(Debug, Clone, Copy, PartialEq)]
struct LeafSplit {
    gain: f64,
    column: usize,
    /// The last bin of the left leaf.
    bin: usize,
    left_sum: f64,
    left_rows: usize,
}

impl<'a> TreeGrower<'a> {
    pub fn new(bins: &'a ColumnBins, how: &'a BoostingSettings) -> Self {
        let (rows, scratch, ordered) = (vec![], vec![], vec![]);
        Self { bins, how, rows, scratch, ordered, pool: vec![], leaves: vec![], partial: false }
    }

    /// Selects the rows of the next tree. `some` receives the number of rows and returns the selected rows, or `None`
    /// for all rows.
    pub fn draw(&mut self, some: impl Fn(usize) -> Option<Vec<u32>>) {
        let drawn = some(self.bins.rows);
        self.partial = drawn.is_some();
        self.rows = drawn.unwrap_or_else(|| (0..self.bins.rows as u32).collect());
    }

    /// Grows a tree on these residuals.
    pub fn tree(&mut self, residuals: &[f64]) -> RegressionTree {
        for leaf in std::mem::take(&mut self.leaves) {
            self.release(leaf.histogram);
        }
        let mut nodes = vec![RegressionTreeNode::Leaf { value: 0.0 }];
        let root = self.root(residuals);
        self.leaves.push(root);
        while self.leaves.len() < self.how.leaves {
            let Some((at, split)) = self.best() else { break };
            let parent = self.leaves.swap_remove(at);
            let below = nodes.len();
            if let Some(node) = nodes.get_mut(parent.node) {
                let threshold = self.bins.threshold(split.column, split.bin);
                *node = RegressionTreeNode::Split { feature: split.column, threshold, left: below, right: below + 1 };
            }
            nodes.extend([RegressionTreeNode::Leaf { value: 0.0 }; 2]);
            // The leaves of the last split are not split further, so they need no histograms.
            let last = self.leaves.len() + 2 >= self.how.leaves;
            let two = self.divide(parent, split, below, residuals, last);
            self.leaves.extend(two);
        }
        for leaf in &self.leaves {
            let value = self.how.learning_rate * leaf.sum / (leaf.range.len() as f64 + self.how.l2);
            if let Some(node) = nodes.get_mut(leaf.node) {
                *node = RegressionTreeNode::Leaf { value };
            }
        }
        RegressionTree { nodes }
    }

    /// Subtracts the values of the last tree from the residuals of all rows, `x`.
    pub fn take_off(&self, tree: &RegressionTree, x: &[f64], residuals: &mut [f64]) {
        if self.partial {
            return tree.take_off(x, self.bins.width, residuals);
        }
        for leaf in &self.leaves {
            let Some(RegressionTreeNode::Leaf { value }) = tree.nodes.get(leaf.node) else { continue };
            self.rows[leaf.range.clone()].iter().for_each(|&i| residuals[i as usize] -= value);
        }
    }

    /// Leaf with the largest gain. Of several equal gains, the first node is chosen.
    fn best(&self) -> Option<(usize, LeafSplit)> {
        let candidates = self.leaves.iter().enumerate().filter_map(|(at, leaf)| Some((at, leaf.node, leaf.split?)));
        let better = |a: &(usize, usize, LeafSplit), b: &(usize, usize, LeafSplit)| {
            b.2.gain > a.2.gain || (b.2.gain == a.2.gain && b.1 < a.1)
        };
        candidates.reduce(|a, b| if better(&a, &b) { b } else { a }).map(|(at, _, split)| (at, split))
    }

    fn histogram(&mut self) -> BinHistogram {
        let size = self.bins.width.div_ceil(TOGETHER) * CHUNK;
        self.pool.pop().unwrap_or_else(|| vec![[0.0; 2]; size])
    }

    fn release(&mut self, histogram: BinHistogram) {
        if !histogram.is_empty() {
            self.pool.push(histogram);
        }
    }

    fn root(&mut self, residuals: &[f64]) -> GrowingLeaf {
        let all = 0..self.rows.len();
        self.gather(all.clone(), residuals);
        let sum = self.ordered.iter().sum();
        let mut histogram = self.histogram();
        let (bins, how, rows, ordered) = (self.bins, self.how, &self.rows, &self.ordered);
        let found: Vec<Option<LeafSplit>> = histogram
            .par_chunks_mut(CHUNK)
            .enumerate()
            .map(|(k, part)| {
                fill(part, bins.packed(k), rows, ordered);
                best_of_four(part, k, bins, sum, rows.len(), how)
            })
            .collect();
        GrowingLeaf { node: 0, range: all, depth: 0, sum, histogram, split: first_best(found) }
    }

    fn gather(&mut self, range: Range<usize>, residuals: &[f64]) {
        self.ordered.clear();
        self.ordered.extend(self.rows[range].iter().map(|&i| residuals[i as usize]));
    }

    fn divide(
        &mut self,
        parent: GrowingLeaf,
        split: LeafSplit,
        below: usize,
        residuals: &[f64],
        last: bool,
    ) -> [GrowingLeaf; 2] {
        self.partition(parent.range.clone(), split);
        let (start, end, depth) = (parent.range.start, parent.range.end, parent.depth + 1);
        let middle = start + split.left_rows;
        let leaf =
            |node, range: Range<usize>, sum| GrowingLeaf { node, range, depth, sum, histogram: vec![], split: None };
        let mut left = leaf(below, start..middle, split.left_sum);
        let mut right = leaf(below + 1, middle..end, parent.sum - split.left_sum);
        let large = left.range.len().max(right.range.len());
        let deep = self.how.depth.is_some_and(|most| depth >= most);
        if last || deep || large < self.how.least_rows.saturating_mul(2) {
            self.release(parent.histogram);
            return [left, right];
        }
        let (small, large) =
            if left.range.len() <= right.range.len() { (&mut left, &mut right) } else { (&mut right, &mut left) };
        self.gather(small.range.clone(), residuals);
        (small.histogram, large.histogram) = (self.histogram(), parent.histogram);
        let (bins, how, ordered) = (self.bins, self.how, &self.ordered);
        let rows = &self.rows[small.range.clone()];
        let (small_sum, large_sum, small_rows, large_rows) =
            (small.sum, large.sum, small.range.len(), large.range.len());
        let found: Vec<(Option<LeafSplit>, Option<LeafSplit>)> = small
            .histogram
            .par_chunks_mut(CHUNK)
            .zip(large.histogram.par_chunks_mut(CHUNK))
            .enumerate()
            .map(|(k, (few, many))| {
                fill(few, bins.packed(k), rows, ordered);
                many.iter_mut().zip(&*few).for_each(|(many, few)| *many = [many[0] - few[0], many[1] - few[1]]);
                let few = best_of_four(few, k, bins, small_sum, small_rows, how);
                (few, best_of_four(many, k, bins, large_sum, large_rows, how))
            })
            .collect();
        let (few, many): (Vec<_>, Vec<_>) = found.into_iter().unzip();
        (small.split, large.split) = (first_best(few), first_best(many));
        [left, right]
    }

    /// Moves the rows of the left leaf before the rows of the right leaf; the order within each leaf is kept.
    fn partition(&mut self, range: Range<usize>, split: LeafSplit) {
        let packed = self.bins.packed(split.column / TOGETHER);
        let lane = split.column % TOGETHER;
        self.scratch.clear();
        let rows = &mut self.rows[range];
        let mut kept = 0;
        for at in 0..rows.len() {
            let row = rows[at];
            if usize::from(packed[row as usize][lane]) <= split.bin {
                rows[kept] = row;
                kept += 1;
            } else {
                self.scratch.push(row);
            }
        }
        rows[kept..].copy_from_slice(&self.scratch);
    }
}

/// The sums of four columns over `rows` with the residuals `ordered`.
fn fill(histogram: &mut [[f64; 2]], packed: &[[u8; TOGETHER]], rows: &[u32], ordered: &[f64]) {
    histogram.fill([0.0; 2]);
    let (columns, _) = histogram.as_chunks_mut::<BINS>();
    let [a, b, c, d] = columns else { return };
    // Consecutive samples of a flight fall into the same bins, so each sum waits for its previous addition; the four
    // sums of a row are independent.
    let add = |bin: &mut [f64; 2], residual: f64| *bin = [bin[0] + residual, bin[1] + 1.0];
    for (&row, &residual) in rows.iter().zip(ordered) {
        let bins = packed[row as usize];
        add(&mut a[usize::from(bins[0])], residual);
        add(&mut b[usize::from(bins[1])], residual);
        add(&mut c[usize::from(bins[2])], residual);
        add(&mut d[usize::from(bins[3])], residual);
    }
}

/// The best split of a leaf by columns 4 k to 4 k + 3.
fn best_of_four(
    histogram: &[[f64; 2]],
    k: usize,
    bins: &ColumnBins,
    sum: f64,
    rows: usize,
    how: &BoostingSettings,
) -> Option<LeafSplit> {
    if rows < how.least_rows.saturating_mul(2) {
        return None;
    }
    let one = |(lane, histogram): (usize, &[[f64; 2]])| {
        let column = TOGETHER * k + lane;
        let used = histogram.get(..bins.count(column).min(BINS))?;
        best_of(used, column, sum, rows as f64, how)
    };
    first_best(histogram.chunks_exact(BINS).enumerate().map(one))
}

/// Best split of a leaf by one column. Of several equal gains, the lowest bin is chosen.
fn best_of(histogram: &[[f64; 2]], column: usize, sum: f64, rows: f64, how: &BoostingSettings) -> Option<LeafSplit> {
    let least = how.least_rows as f64;
    let score = |sum: f64, rows: f64| sum * sum / (rows + how.l2);
    let whole = score(sum, rows);
    let mut best: Option<LeafSplit> = None;
    let (mut left_sum, mut left) = (0.0, 0.0);
    for (bin, [bin_sum, bin_rows]) in histogram.iter().enumerate() {
        if *bin_rows == 0.0 {
            continue;
        }
        left_sum += bin_sum;
        left += bin_rows;
        if left < least {
            continue;
        }
        if rows - left < least {
            break;
        }
        let both = score(left_sum, left) + score(sum - left_sum, rows - left);
        let gain = both - whole;
        if gain > ROUNDING * both && best.is_none_or(|best| gain > best.gain) {
            best = Some(LeafSplit { gain, column, bin, left_sum, left_rows: left as usize });
        }
    }
    best
}

/// Split with the largest gain. Of several equal gains, the first split is chosen.
fn first_best(splits: impl IntoIterator<Item = Option<LeafSplit>>) -> Option<LeafSplit> {
    splits.into_iter().flatten().reduce(|a, b| if b.gain > a.gain { b } else { a })
}
