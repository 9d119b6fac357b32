//! A grid under relaxation, with two rows and columns beyond each edge.
//!
//! The update of a node depends on neighbours up to two rows away, so rows three apart can be updated in parallel. The
//! rows are divided into three colours, and the result does not depend on the number of threads.

use rayon::prelude::*;

/// Settings of the relaxation of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelaxationOptions {
    /// Tension: 0 is minimum curvature, 1 is Laplace's equation.
    pub tension: f64,
    /// Convergence limit of a grid, in nT: the maximum expected change of a node in all further passes together.
    pub tolerance_nt: f64,
    /// The maximum number of passes over a grid.
    pub passes: usize,
}

/// Convergence of the relaxation of the finest grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelaxationReport {
    /// Number of passes over the grid.
    pub passes: usize,
    /// Expected change of a node in all further passes, in nT, from the convergence rate. The change exceeds the
    /// tolerance if the maximum number of passes was reached.
    pub left_nt: f64,
}

/// Number of rows and columns beyond an edge.
const EDGE: usize = 2;

/// The over-relaxation factor.
const OVER: f64 = 1.6;

/// Number of passes between two convergence checks.
const STRETCH: usize = 16;

/// A datum fixes its node if its offset from the node is below this number of spacings along both axes.
const ON_NODE: f64 = 0.05;

/// A datum, with the nearest node and the offset from this node, in nodes.
#[derive(Clone, Copy, Debug)]
pub(super) struct GridDatum {
    column: usize,
    row: usize,
    offset: [f64; 2],
    value: f64,
}

impl GridDatum {
    /// Datum from a fractional column and row of the grid, and a value.
    pub fn from_point([column, row, value]: [f64; 3]) -> Self {
        let near = [column, row].map(|x| (x + 0.5).floor().max(0.0));
        Self { column: near[0] as usize, row: near[1] as usize, offset: [column - near[0], row - near[1]], value }
    }
}

/// Update rule of a node.
#[derive(Clone, Copy, Debug)]
enum NodeUpdate {
    Free,
    Held,
    /// Value `fixed` + Σ weight · neighbour - `bend` · (the remaining curvature of the neighbours).
    Drawn {
        corner: [i64; 2],
        weights: [f64; 4],
        fixed: f64,
        bend: f64,
    },
}

/// Grid of nodes and their update rules, for relaxation.
pub(super) struct RelaxationGrid {
    columns: usize,
    rows: usize,
    colours: [Vec<Vec<f64>>; 3],
    rules: Vec<Vec<NodeUpdate>>,
}

impl RelaxationGrid {
    /// A constant grid.
    pub fn flat(columns: usize, rows: usize) -> Self {
        let width = columns + 2 * EDGE;
        let colours = [0, 1, 2].map(|c| vec![vec![0.0; width]; (rows + 2 * EDGE - c).div_ceil(3)]);
        Self { columns, rows, colours, rules: Vec::new() }
    }

    fn row(&self, row: usize) -> &[f64] {
        &self.colours[row % 3][row / 3]
    }

    fn get(&self, column: usize, row: usize) -> f64 {
        self.row(row)[column]
    }

    fn set(&mut self, column: usize, row: usize, value: f64) {
        self.colours[row % 3][row / 3][column] = value;
    }

    /// The nodes' values by rows.
    pub fn values(&self) -> Vec<f64> {
        let row = |r: usize| self.row(r + EDGE)[EDGE..EDGE + self.columns].iter().copied();
        (0..self.rows).flat_map(row).collect()
    }

    /// The same surface with twice the density of nodes, interpolated bilinearly.
    pub fn refined(&self, columns: usize, rows: usize) -> Self {
        let mut fine = Self::flat(columns, rows);
        let last = |n: usize| n - 1 + EDGE;
        for r in 0..rows {
            for c in 0..columns {
                let ends = |k: usize, n: usize| [(k / 2 + EDGE).min(last(n)), (k.div_ceil(2) + EDGE).min(last(n))];
                let (ec, er) = (ends(c, self.columns), ends(r, self.rows));
                let sum = er.map(|r| ec.map(|c| self.get(c, r)).iter().sum::<f64>()).iter().sum::<f64>();
                fine.set(c + EDGE, r + EDGE, 0.25 * sum);
            }
        }
        fine
    }

    /// Sets the update rule of each node.
    pub fn constrain(&mut self, data: Vec<GridDatum>, tension: f64) {
        self.rules = vec![vec![NodeUpdate::Free; self.columns]; self.rows];
        for datum in data {
            let rule = rule(&datum, tension);
            if matches!(rule, NodeUpdate::Held) {
                self.set(datum.column + EDGE, datum.row + EDGE, datum.value);
            }
            self.rules[datum.row][datum.column] = rule;
        }
    }

    /// Relaxes the grid until the expected remaining change is within the tolerance or the maximum number of passes is
    /// reached.
    ///
    /// Slow modes of the surface change little per pass over very many passes, so the change of one pass is not a
    /// criterion of convergence. The remaining change is the sum of the geometric series that starts with the changes
    /// of the last passes.
    pub fn relax(&mut self, relaxation: &RelaxationOptions) -> RelaxationReport {
        let mut relaxed = RelaxationReport { passes: 0, left_nt: f64::INFINITY };
        let mut before = f64::INFINITY;
        while relaxed.passes < relaxation.passes && relaxed.left_nt > relaxation.tolerance_nt {
            let mut moved: f64 = 0.0;
            for colour in 0..3 {
                self.extend();
                moved = self.pass(colour, relaxation.tension).max(moved);
            }
            relaxed.passes += 1;
            if relaxed.passes.is_multiple_of(STRETCH) || moved == 0.0 {
                let rate = (moved / before).min(1.0).powf(1.0 / STRETCH as f64);
                relaxed.left_nt = match () {
                    () if moved == 0.0 => 0.0,
                    () if before.is_infinite() => f64::INFINITY,
                    () => moved * rate / (1.0 - rate),
                };
                before = moved;
            }
        }
        relaxed
    }

    fn pass(&mut self, colour: usize, tension: f64) -> f64 {
        let mut own = std::mem::take(&mut self.colours[colour]);
        let sheet = &*self;
        let inner = EDGE..self.rows + EDGE;
        let moved = own
            .par_iter_mut()
            .with_min_len(16)
            .enumerate()
            .map(|(k, row)| (3 * k + colour, row))
            .filter(|(r, _)| inner.contains(r))
            .map(|(r, row)| {
                let others = [r - 2, r - 1, r + 1, r + 2].map(|other| sheet.row(other));
                move_row(row, others, &sheet.rules[r - EDGE], tension)
            })
            .reduce(|| 0.0, f64::max);
        self.colours[colour] = own;
        moved
    }

    /// Sets the nodes beyond the edges for zero curvature across an edge, zero twist at a corner, and zero shear.
    /// [Briggs 1974, (11)-(16)]
    fn extend(&mut self) {
        let (west, east, south, north) = (EDGE, EDGE + self.columns - 1, EDGE, EDGE + self.rows - 1);
        for r in south..=north {
            self.set(west - 1, r, 2.0 * self.get(west, r) - self.get(west + 1, r));
            self.set(east + 1, r, 2.0 * self.get(east, r) - self.get(east - 1, r));
        }
        for c in west..=east {
            self.set(c, south - 1, 2.0 * self.get(c, south) - self.get(c, south + 1));
            self.set(c, north + 1, 2.0 * self.get(c, north) - self.get(c, north - 1));
        }
        for (c, dc) in [(west, 1i64), (east, -1)] {
            for (r, dr) in [(south, 1i64), (north, -1)] {
                let get = |sc: i64, sr: i64| self.get(step(c, sc * dc), step(r, sr * dr));
                let corner = get(-1, 1) + get(1, -1) - get(1, 1);
                self.set(step(c, -dc), step(r, -dr), corner);
            }
        }
        for r in south..=north {
            for (c, d) in [(west, 1i64), (east, -1)] {
                let value = self.no_shear(|along, across| (step(c, along * d), step(r, across)));
                self.set(step(c, -2 * d), r, value);
            }
        }
        for c in west..=east {
            for (r, d) in [(south, 1i64), (north, -1)] {
                let value = self.no_shear(|along, across| (step(c, across), step(r, along * d)));
                self.set(c, step(r, -2 * d), value);
            }
        }
    }

    /// Value two steps outside an edge. It makes the curvature one step outside equal to the curvature one step inside.
    fn no_shear(&self, at: impl Fn(i64, i64) -> (usize, usize)) -> f64 {
        let get = |along: i64, across: i64| {
            let (c, r) = at(along, across);
            self.get(c, r)
        };
        get(2, 0) + get(1, 1) + get(1, -1) - 4.0 * get(1, 0) - get(-1, 1) - get(-1, -1) + 4.0 * get(-1, 0)
    }
}

fn step(at: usize, by: i64) -> usize {
    at.saturating_add_signed(by as isize)
}

/// Update of a node by its datum; the expansion of the curvature uses the datum and the four neighbours on the opposite
/// side.
fn rule(datum: &GridDatum, tension: f64) -> NodeUpdate {
    let [dx, dy] = datum.offset.map(f64::abs);
    if dx.max(dy) < ON_NODE {
        return NodeUpdate::Held;
    }
    let corner = datum.offset.map(|d| if d < 0.0 { -1 } else { 1 });
    let places = [[-1.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, -1.0], [dx, dy]];
    let powers = nalgebra::Matrix5::from_fn(|i, k| {
        let [x, y]: [f64; 2] = places[k];
        [x, y, 0.5 * x * x, x * y, 0.5 * y * y][i]
    });
    let curvature = nalgebra::Vector5::new(0.0, 0.0, 1.0, 0.0, 1.0);
    let Some(b) = powers.lu().solve(&curvature) else { return NodeUpdate::Held };
    let own = 4.0 - 3.0 * tension;
    let whole = 4.0 * (1.0 - tension) + own * b.sum();
    NodeUpdate::Drawn {
        corner,
        weights: [0, 1, 2, 3].map(|k| own * b[k] / whole),
        fixed: own * b[4] * datum.value / whole,
        bend: (1.0 - tension) / whole,
    }
}

fn move_row(row: &mut [f64], [south2, south, north, north2]: [&[f64]; 4], rules: &[NodeUpdate], tension: f64) -> f64 {
    let mut moved: f64 = 0.0;
    let whole = 20.0 - 16.0 * tension;
    for (k, rule) in rules.iter().enumerate() {
        let c = k + EDGE;
        let cross = row[c - 1] + row[c + 1] + south[c] + north[c];
        let bend = row[c - 2]
            + row[c + 2]
            + south2[c]
            + north2[c]
            + 2.0 * (south[c - 1] + south[c + 1] + north[c - 1] + north[c + 1])
            - 8.0 * cross;
        let rest = match rule {
            NodeUpdate::Held => continue,
            NodeUpdate::Free => (tension * cross - (1.0 - tension) * bend) / whole,
            NodeUpdate::Drawn { corner, weights, fixed, bend: part } => {
                let (west, east) = (step(c, -corner[0]), step(c, corner[0]));
                let (back, front) = if corner[1] > 0 { (south, north) } else { (north, south) };
                let drawn = [front[west], row[west], back[c], back[east]];
                fixed + weights.iter().zip(drawn).map(|(w, v)| w * v).sum::<f64>() - part * (bend + 4.0 * cross)
            }
        };
        let by = OVER * (rest - row[c]);
        row[c] += by;
        moved = moved.max(by.abs());
    }
    moved
}
