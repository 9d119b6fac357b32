//! The Laplace operator on the unknown nodes of a grid, and its approximate inverse by multigrid.
//!
//! Five-point differences: a node is coupled to its neighbours east, west, north and south. Known neighbours are fixed
//! values, and the border of the map has zero flux. Each coarser level merges blocks of two by two nodes into one node.
//! Its operator is half the Galerkin product with piecewise constants, which is the five-point operator of the doubled
//! step. [Braess 1995, Computing 55]

use rayon::prelude::*;

/// Damping factor of the point-wise corrections: the four corrections of a cycle damp all components that the next
/// level cannot represent.
const DAMPING: f64 = 0.8;
/// A level of at most this number of nodes is not coarsened further.
const COARSEST: usize = 64;
const COARSEST_SWEEPS: usize = 24;

/// Rows and columns of a level, surrounded by one known node on every side.
#[derive(Clone, Copy, Debug)]
pub(super) struct MultigridFrame {
    pub(super) rows: usize,
    pub(super) columns: usize,
}

impl MultigridFrame {
    pub(super) fn width(self) -> usize {
        self.columns + 2
    }

    pub(super) fn nodes(self) -> usize {
        (self.rows + 2) * self.width()
    }

    /// The index of a node in a vector of this frame.
    pub(super) fn index(self, row: usize, column: usize) -> usize {
        (row + 1) * self.width() + column + 1
    }

    /// Sets every inner row of `out`, except the first and last node of the row, in parallel; rows are counted as in
    /// [`Self::index`].
    pub(super) fn each_row(self, out: &mut [f64], set: impl Fn(usize, &mut [f64]) + Sync) {
        let inner = self.width()..self.width() * (self.rows + 1);
        out[inner].par_chunks_exact_mut(self.width()).enumerate().for_each(|(row, out)| {
            set(row, &mut out[1..=self.columns]);
        });
    }

    /// The inner part of a row of `x`, shifted by `north` rows and `east` columns (-1, 0 or 1).
    pub(super) fn part<T>(self, x: &[T], row: usize, north: isize, east: isize) -> &[T] {
        let start = self.index(row, 0).wrapping_add_signed(north * self.width() as isize + east);
        &x[start..start + self.columns]
    }
}

/// Couplings between the nodes of a multigrid level. Known nodes have no couplings.
pub(super) struct MultigridLevel {
    pub(super) frame: MultigridFrame,
    /// The coupling of each node with its eastern neighbour.
    east: Vec<f32>,
    /// The coupling of each node with its northern neighbour.
    north: Vec<f32>,
    /// The sum of the couplings of an unknown node to its known neighbours.
    fixed: Vec<f32>,
}

impl MultigridLevel {
    /// Couplings between nodes in `unknown`, with the strengths `east` and `north`.
    pub(super) fn new(frame: MultigridFrame, unknown: &[bool], east: f64, north: f64) -> Self {
        let (east, north) = (east as f32, north as f32);
        let zeros = || vec![0.0; frame.nodes()];
        let mut level = Self { frame, east: zeros(), north: zeros(), fixed: zeros() };
        for (row, column) in (0..frame.rows).flat_map(|row| (0..frame.columns).map(move |column| (row, column))) {
            let at = frame.index(row, column);
            if !unknown[at] {
                continue;
            }
            let joints = [
                (column + 1 < frame.columns, at + 1, east),
                (column > 0, at - 1, east),
                (row + 1 < frame.rows, at + frame.width(), north),
                (row > 0, at - frame.width(), north),
            ];
            let known = joints.iter().filter(|(inside, other, _)| *inside && !unknown[*other]);
            level.fixed[at] = known.map(|(_, _, strength)| strength).sum();
            level.east[at] = if joints[0].0 && unknown[at + 1] { east } else { 0.0 };
            level.north[at] = if joints[2].0 && unknown[at + frame.width()] { north } else { 0.0 };
        }
        level
    }

    /// Weighted sum over the neighbours of each node of a row.
    #[inline(always)]
    fn pull<'a>(&'a self, x: &'a [f64], row: usize) -> impl Fn(usize) -> f64 + 'a {
        let frame = self.frame;
        let (xe, xw) = (frame.part(x, row, 0, 1), frame.part(x, row, 0, -1));
        let (xn, xs) = (frame.part(x, row, 1, 0), frame.part(x, row, -1, 0));
        let (east, west) = (frame.part(&self.east, row, 0, 0), frame.part(&self.east, row, 0, -1));
        let (north, south) = (frame.part(&self.north, row, 0, 0), frame.part(&self.north, row, -1, 0));
        move |i| {
            let [we, ww, wn, ws] = [east[i], west[i], north[i], south[i]].map(f64::from);
            (we * xe[i] + ww * xw[i]) + (wn * xn[i] + ws * xs[i])
        }
    }

    /// Sum of all couplings of each node of a row: the node's diagonal element of the operator; 0 for known nodes.
    #[inline(always)]
    fn own(&self, row: usize) -> impl Fn(usize) -> f64 + '_ {
        let frame = self.frame;
        let (east, west) = (frame.part(&self.east, row, 0, 0), frame.part(&self.east, row, 0, -1));
        let (north, south) = (frame.part(&self.north, row, 0, 0), frame.part(&self.north, row, -1, 0));
        let fixed = frame.part(&self.fixed, row, 0, 0);
        move |i| {
            let [east, west, north, south, fixed] = [east[i], west[i], north[i], south[i], fixed[i]].map(f64::from);
            ((east + west) + (north + south)) + fixed
        }
    }

    /// `out = A x`.
    pub(super) fn apply(&self, x: &[f64], out: &mut [f64]) {
        self.frame.each_row(out, |row, out| {
            let (own, pull, here) = (self.own(row), self.pull(x, row), self.frame.part(x, row, 0, 0));
            out.iter_mut().enumerate().for_each(|(i, out)| *out = own(i) * here[i] - pull(i));
        });
    }

    /// `out = x + damping (b - A x) / diagonal element` on unknown nodes.
    fn correct(&self, b: &[f64], x: &[f64], out: &mut [f64]) {
        self.frame.each_row(out, |row, out| {
            let (own, pull) = (self.own(row), self.pull(x, row));
            let (b, here) = (self.frame.part(b, row, 0, 0), self.frame.part(x, row, 0, 0));
            for (i, out) in out.iter_mut().enumerate() {
                let own = own(i);
                *out = if own > 0.0 { here[i] + DAMPING * ((b[i] + pull(i)) / own - here[i]) } else { 0.0 };
            }
        });
    }

    /// The coarser level, which merges two by two nodes: couplings between its nodes are summed, couplings inside a
    /// node are dropped.
    fn coarser(&self) -> Self {
        let fine = self.frame;
        let frame = MultigridFrame { rows: fine.rows.div_ceil(2), columns: fine.columns.div_ceil(2) };
        let zeros = || vec![0.0; frame.nodes()];
        let mut coarse = Self { frame, east: zeros(), north: zeros(), fixed: zeros() };
        for (row, column) in (0..fine.rows).flat_map(|row| (0..fine.columns).map(move |column| (row, column))) {
            let (from, to) = (fine.index(row, column), frame.index(row / 2, column / 2));
            coarse.fixed[to] += 0.5 * self.fixed[from];
            coarse.east[to] += if column % 2 == 1 { 0.5 * self.east[from] } else { 0.0 };
            coarse.north[to] += if row % 2 == 1 { 0.5 * self.north[from] } else { 0.0 };
        }
        coarse
    }

    /// Sums the residual of `b` over two by two nodes, row by row of the coarser level.
    fn restrict(&self, b: &[f64], x: &[f64], coarse: MultigridFrame, out: &mut [f64]) {
        let fine = self.frame;
        coarse.each_row(out, |row, out| {
            out.fill(0.0);
            for row in (2 * row..2 * row + 2).take_while(|row| *row < fine.rows) {
                let (own, pull) = (self.own(row), self.pull(x, row));
                let (b, here) = (fine.part(b, row, 0, 0), fine.part(x, row, 0, 0));
                for i in 0..fine.columns {
                    let own = own(i);
                    out[i / 2] += if own > 0.0 { b[i] - own * here[i] + pull(i) } else { 0.0 };
                }
            }
        });
    }

    /// Adds the value of each node of the coarser level to the unknown nodes that this node merges.
    fn prolong(&self, coarse: MultigridFrame, from: &[f64], x: &mut [f64]) {
        self.frame.each_row(x, |row, x| {
            let (from, own) = (coarse.part(from, row / 2, 0, 0), self.own(row));
            for (i, x) in x.iter_mut().enumerate() {
                *x += if own(i) > 0.0 { from[i / 2] } else { 0.0 };
            }
        });
    }
}

/// Coarser levels of a multigrid cycle, with their work arrays.
pub(super) struct MultigridCycle {
    levels: Vec<MultigridLevel>,
    /// Right-hand side and correction of each coarser level, and a second correction array for every level.
    sides: Vec<Vec<f64>>,
    corrections: Vec<Vec<f64>>,
    spare: Vec<Vec<f64>>,
}

impl MultigridCycle {
    pub(super) fn new(finest: &MultigridLevel) -> Self {
        let mut levels: Vec<MultigridLevel> = Vec::new();
        let mut last = finest.frame;
        while last.rows * last.columns > COARSEST {
            let level = levels.last().unwrap_or(finest).coarser();
            last = level.frame;
            levels.push(level);
        }
        let zeros = |level: &MultigridLevel| vec![0.0; level.frame.nodes()];
        let sides: Vec<Vec<f64>> = levels.iter().map(zeros).collect();
        let spare = std::iter::once(finest).chain(&levels).map(zeros).collect();
        Self { corrections: sides.clone(), sides, spare, levels }
    }

    /// Sets `out` to an approximate solution of `A out = b` on the finest level, by one symmetric V-cycle.
    pub(super) fn solve(&mut self, finest: &MultigridLevel, b: &[f64], out: &mut [f64]) {
        descend(finest, &self.levels, b, out, &mut self.sides, &mut self.corrections, &mut self.spare);
    }
}

fn descend(
    level: &MultigridLevel,
    coarser: &[MultigridLevel],
    b: &[f64],
    x: &mut [f64],
    sides: &mut [Vec<f64>],
    corrections: &mut [Vec<f64>],
    spare: &mut [Vec<f64>],
) {
    let Some((spare, spares)) = spare.split_first_mut() else { return };
    let joined = coarser.split_first().zip(sides.split_first_mut()).zip(corrections.split_first_mut());
    let Some((((next, coarser), (side, sides)), (correction, corrections))) = joined else {
        x.fill(0.0);
        for _ in 0..COARSEST_SWEEPS {
            level.correct(b, x, spare);
            level.correct(b, spare, x);
        }
        return;
    };
    spare.fill(0.0);
    level.correct(b, spare, x);
    level.correct(b, x, spare);
    level.restrict(b, spare, next.frame, side);
    descend(next, coarser, side, correction, sides, corrections, spares);
    level.prolong(next.frame, correction, spare);
    level.correct(b, spare, x);
    level.correct(b, x, spare);
    x.copy_from_slice(spare);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_the_cycle_is_symmetric_and_positive_and_close_to_the_inverse() {
        let frame = MultigridFrame { rows: 37, columns: 50 };
        let mut unknown = vec![false; frame.nodes()];
        for (row, column) in (0..37).flat_map(|row| (0..50).map(move |column| (row, column))) {
            unknown[frame.index(row, column)] = (row * 7 + column * column) % 11 != 0 && row + column > 20;
        }
        let level = MultigridLevel::new(frame, &unknown, 1.25, 0.8);
        let mut cycle = MultigridCycle::new(&level);
        let vector = |seed: f64| -> Vec<f64> {
            unknown.iter().enumerate().map(|(i, u)| if *u { (seed * i as f64).sin() } else { 0.0 }).collect()
        };
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (a, b) = (vector(0.37), vector(1.91));
        let (mut ma, mut mb, mut ama) = (a.clone(), b.clone(), a.clone());
        cycle.solve(&level, &a, &mut ma);
        cycle.solve(&level, &b, &mut mb);
        // The limit exceeds the rounding errors of sums of some thousand products of order 1.
        assert!((dot(&a, &mb) - dot(&ma, &b)).abs() < 1e-9 * dot(&a, &ma));
        assert!(dot(&a, &ma) > 0.0 && dot(&b, &mb) > 0.0);
        let mut image = a.clone();
        level.apply(&a, &mut image);
        cycle.solve(&level, &image, &mut ama);
        let off: Vec<f64> = ama.iter().zip(&a).map(|(one, other)| one - other).collect();
        // One multigrid cycle removes more than half of the error, measured in the energy norm of the operator.
        let (mut left, mut before) = (off.clone(), a.clone());
        level.apply(&off, &mut left);
        level.apply(&a, &mut before);
        assert!(dot(&off, &left) < 0.25 * dot(&a, &before), "{} {}", dot(&off, &left), dot(&a, &before));
    }
}
