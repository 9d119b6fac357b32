//! Modes of a cloud of weighted points in the plane: density maxima that are separated by a valley.
//!
//! The density of the whitened points is smoothed on a grid by a Gaussian of the optimal bandwidth. The cells are
//! visited from the highest to the lowest. Each cell is assigned to the hill of its neighbours or starts a new hill.
//! Where two hills meet, the lower hill is merged into the higher hill unless the saddle is below [`VALLEY`] times the
//! lower top [Chazal, Guibas, Oudot & Skraba 2013]. Each hill is then analysed on a finer grid, to separate modes of
//! very different sizes. The algorithm is deterministic.

/// A saddle separates two modes if its ratio to the lower top is below this.
const VALLEY: f64 = 0.4;
/// Smallest weight of a mode. Points of smaller modes are assigned to the nearest mode.
const LEAST_WEIGHT: f64 = 0.01;
/// Number of cells per side.
const SIDE: usize = 32;
/// Half the width of the grid, in standard deviations. Points farther out are assigned to the edge cells.
const HALF_WIDTH: f64 = 4.0;
const CELLS: usize = SIDE * SIDE;
/// Number of refinements of a mode.
const LEVELS: usize = 5;
const NONE: u32 = u32::MAX;

/// Clusters of points.
#[derive(Clone, Debug, Default)]
pub(super) struct ModeClusters {
    /// Mode of each point, from 0.
    pub(super) labels: Vec<u32>,
    /// Number of modes.
    pub(super) count: usize,
    scratch: ModeDensityGrid,
}

#[derive(Clone, Debug, Default)]
struct ModeDensityGrid {
    cells: Vec<u16>,
    density: Vec<f64>,
    smooth: Vec<f64>,
    order: Vec<u16>,
    hill: Vec<u32>,
}

/// Weighted mean of points with their covariance and effective number.
#[derive(Clone, Copy, Debug)]
struct ClusterMoments {
    weight: f64,
    mean: [f64; 2],
    /// Lower Cholesky factor of the covariance, by rows.
    root: [f64; 3],
    effective: f64,
}

impl ModeClusters {
    /// Separates the modes of points; `points` returns the coordinates of a point, in any unit of each axis.
    /// Weights are not negative and sum up to about 1.
    pub(super) fn find(&mut self, weights: &[f64], points: impl Fn(usize) -> [f64; 2] + Copy) {
        self.labels.clear();
        self.labels.resize(weights.len(), 0);
        self.count = 1;
        let mut open = vec![(0_u32, 0_usize)];
        while let Some((label, level)) = open.pop() {
            let (first, more) = (self.count as u32, self.split(label, weights, points));
            if more > 0 && level < LEVELS {
                open.push((label, level + 1));
                open.extend((first..first + more).map(|label| (label, level + 1)));
            }
        }
    }

    /// Splits one mode; its highest hill keeps the label. Returns the number of other hills, whose labels follow the
    /// existing ones.
    fn split(&mut self, label: u32, weights: &[f64], points: impl Fn(usize) -> [f64; 2] + Copy) -> u32 {
        let Some(moments) = ClusterMoments::new(&self.labels, label, weights, points) else { return 0 };
        self.scratch.fill(&moments, &self.labels, label, weights, points);
        // Bandwidth for a plane, in cells. One pass of the kernel 1 2 1 has the variance ½.
        let bandwidth = moments.effective.powf(-1.0 / 6.0) * SIDE as f64 / (2.0 * HALF_WIDTH);
        self.scratch.blur((2.0 * bandwidth * bandwidth).ceil().clamp(2.0, 24.0) as usize);
        let hills = self.scratch.climb();
        if hills < 2 {
            return 0;
        }
        self.relabel(label, weights, hills)
    }

    /// Replaces the label `label` of points by the labels of their hills.
    fn relabel(&mut self, label: u32, weights: &[f64], hills: usize) -> u32 {
        let mut hill_weights = vec![0.0; hills];
        for (point, weight) in weights.iter().enumerate() {
            if let Some(hill) = self.scratch.hill_of(point).filter(|_| self.labels[point] == label) {
                hill_weights[hill] += weight;
            }
        }
        let mut names = vec![NONE; hills];
        let mut more = 0;
        for (name, weight) in names.iter_mut().zip(&hill_weights) {
            if *weight >= LEAST_WEIGHT {
                *name = if more == 0 { label } else { self.count as u32 + more - 1 };
                more += 1;
            }
        }
        if more < 2 {
            return 0;
        }
        self.scratch.give_away(&names);
        for (point, own) in self.labels.iter_mut().enumerate() {
            if let Some(hill) = self.scratch.hill_of(point).filter(|_| *own == label) {
                *own = names[hill];
            }
        }
        self.count += more as usize - 1;
        more - 1
    }
}

impl ClusterMoments {
    fn new(labels: &[u32], label: u32, weights: &[f64], points: impl Fn(usize) -> [f64; 2]) -> Option<Self> {
        let own = || labels.iter().zip(weights).enumerate().filter(|(_, (of, _))| **of == label);
        let (mut weight, mut squares, mut sum) = (0.0, 0.0, [0.0; 2]);
        for (point, (_, w)) in own() {
            let at = points(point);
            weight += w;
            squares += w * w;
            sum = [sum[0] + w * at[0], sum[1] + w * at[1]];
        }
        let mean = sum.map(|sum| sum / weight);
        let (mut a, mut b, mut c) = (0.0, 0.0, 0.0);
        for (point, (_, w)) in own() {
            let at = points(point);
            let (north, east) = (at[0] - mean[0], at[1] - mean[1]);
            a += w * north * north;
            b += w * north * east;
            c += w * east * east;
        }
        let [a, b, c] = [a, b, c].map(|sum| sum / weight);
        let l11 = a.sqrt();
        let l21 = b / l11;
        // Points on a straight line also have one or two hills: the other axis has a very small width.
        let l22 = (c - l21 * l21).max(1e-12 * c).sqrt();
        let fine = weight > 0.0 && l11 > 0.0 && l22 > 0.0 && l21.is_finite();
        fine.then_some(Self { weight, mean, root: [l11, l21, l22], effective: weight * weight / squares })
    }

    fn cell(&self, at: [f64; 2]) -> usize {
        let u = (at[0] - self.mean[0]) / self.root[0];
        let v = (at[1] - self.mean[1] - self.root[1] * u) / self.root[2];
        // The cast clamps values outside the range.
        let place = |x: f64| (((x + HALF_WIDTH) / (2.0 * HALF_WIDTH) * SIDE as f64) as usize).min(SIDE - 1);
        place(u) * SIDE + place(v)
    }
}

impl ModeDensityGrid {
    fn fill(
        &mut self,
        moments: &ClusterMoments,
        labels: &[u32],
        label: u32,
        weights: &[f64],
        points: impl Fn(usize) -> [f64; 2],
    ) {
        self.cells.resize(labels.len(), 0);
        self.density.clear();
        self.density.resize(CELLS, 0.0);
        for (point, weight) in weights.iter().enumerate() {
            if labels[point] == label {
                let cell = moments.cell(points(point));
                self.cells[point] = cell as u16;
                self.density[cell] += weight / moments.weight;
            }
        }
    }

    /// Hill of a point; `None` if the point and its neighbours have no weight.
    fn hill_of(&self, point: usize) -> Option<usize> {
        let hill = self.hill[usize::from(self.cells[point])];
        (hill != NONE).then_some(hill as usize)
    }

    /// Smooths with the kernel 1 2 1 along both axes `passes` times, without loss at the edges of the grid.
    fn blur(&mut self, passes: usize) {
        self.smooth.resize(CELLS, 0.0);
        for _ in 0..passes {
            for row in 0..SIDE {
                let (before, after) = (row.saturating_sub(1) * SIDE, (row + 1).min(SIDE - 1) * SIDE);
                for column in 0..SIDE {
                    let sides = self.density[before + column] + self.density[after + column];
                    self.smooth[row * SIDE + column] = 0.25 * sides + 0.5 * self.density[row * SIDE + column];
                }
            }
            for (to, from) in self.density.chunks_exact_mut(SIDE).zip(self.smooth.chunks_exact(SIDE)) {
                for column in 0..SIDE {
                    let sides = from[column.saturating_sub(1)] + from[(column + 1).min(SIDE - 1)];
                    to[column] = 0.25 * sides + 0.5 * from[column];
                }
            }
        }
    }

    /// Assigns every cell to a hill; hills are numbered from the highest. Returns the number of hills.
    fn climb(&mut self) -> usize {
        let Self { density, order, hill, .. } = self;
        order.clear();
        order.extend((0..CELLS as u16).filter(|cell| density[usize::from(*cell)] > 0.0));
        order.sort_unstable_by(|a, b| {
            density[usize::from(*b)].total_cmp(&density[usize::from(*a)]).then_with(|| a.cmp(b))
        });
        hill.clear();
        hill.resize(CELLS, NONE);
        // For each hill: the hill into which it is merged, and the height of its top.
        let (mut part_of, mut tops): (Vec<u32>, Vec<f64>) = (vec![], vec![]);
        for cell in order.iter().map(|cell| usize::from(*cell)) {
            let mut own = NONE;
            for near in neighbours(cell) {
                if hill[near] == NONE {
                    continue;
                }
                let other = root_of(&part_of, hill[near]);
                if own == NONE {
                    own = other;
                } else if other != own {
                    // Hills are started from the highest down.
                    let (higher, lower) = (own.min(other), own.max(other));
                    if density[cell] >= VALLEY * tops[lower as usize] {
                        part_of[lower as usize] = higher;
                    }
                    own = higher;
                }
            }
            if own == NONE {
                own = tops.len() as u32;
                part_of.push(own);
                tops.push(density[cell]);
            }
            hill[cell] = own;
        }
        let mut names = vec![NONE; tops.len()];
        let mut count = 0;
        for start in 0..tops.len() {
            if part_of[start] as usize == start {
                names[start] = count;
                count += 1;
            }
        }
        for own in hill.iter_mut().filter(|own| **own != NONE) {
            *own = names[root_of(&part_of, *own) as usize];
        }
        count as usize
    }

    /// Assigns the cells of unlabelled hills to the hill of the nearest labelled cell.
    fn give_away(&mut self, names: &[u32]) {
        let named = |hill: u32| hill != NONE && names[hill as usize] != NONE;
        let kept: Vec<usize> = (0..CELLS).filter(|cell| named(self.hill[*cell])).collect();
        let away: Vec<usize> = (0..CELLS).filter(|cell| self.hill[*cell] != NONE && !named(self.hill[*cell])).collect();
        for cell in away {
            let distance = |other: &usize| {
                let (rows, columns) = ((cell / SIDE).abs_diff(other / SIDE), (cell % SIDE).abs_diff(other % SIDE));
                (rows * rows + columns * columns, *other)
            };
            if let Some(nearest) = kept.iter().copied().min_by_key(|other| distance(other)) {
                self.hill[cell] = self.hill[nearest];
            }
        }
    }
}

fn root_of(part_of: &[u32], mut hill: u32) -> u32 {
    while part_of[hill as usize] != hill {
        hill = part_of[hill as usize];
    }
    hill
}

/// Up to eight neighbours of a cell.
fn neighbours(cell: usize) -> impl Iterator<Item = usize> {
    let (row, column) = (cell / SIDE, cell % SIDE);
    let rows = row.saturating_sub(1)..(row + 2).min(SIDE);
    rows.flat_map(move |r| (column.saturating_sub(1)..(column + 2).min(SIDE)).map(move |c| r * SIDE + c))
        .filter(move |other| *other != cell)
}
