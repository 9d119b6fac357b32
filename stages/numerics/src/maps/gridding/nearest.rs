//! Nearest points on the plane, found in square cells.

/// Index of points by square cells, for nearest-neighbour queries. Coordinates are metres.
pub struct PointCellIndex {
    first: [f64; 2],
    cell_m: f64,
    cells: [i64; 2],
    starts: Vec<usize>,
    order: Vec<usize>,
    at: Vec<[f64; 2]>,
}

/// Neighbouring point: squared distance in m² and index.
pub type PointNeighbour = (f64, usize);

impl PointCellIndex {
    /// Sorts points, all finite, into cells of about three points each.
    pub fn new(east_m: &[f64], north_m: &[f64]) -> Self {
        let (e, n) = (range(east_m), range(north_m));
        let span = [(e[1] - e[0]).max(1.0), (n[1] - n[0]).max(1.0)];
        let count = east_m.len().max(1) as f64;
        let cell_m = (3.0 * span[0] * span[1] / count).sqrt().max(span[0].max(span[1]) / 8192.0);
        let cells = span.map(|s| (s / cell_m).floor() as i64 + 1);
        let first = [e[0], n[0]];
        let cell_of = |i: usize| {
            let [c, r] = cell(first, cell_m, [east_m[i], north_m[i]]);
            (r.clamp(0, cells[1] - 1) * cells[0] + c.clamp(0, cells[0] - 1)) as usize
        };
        let mut starts = vec![0; (cells[0] * cells[1]) as usize + 1];
        (0..east_m.len()).for_each(|i| starts[cell_of(i) + 1] += 1);
        (1..starts.len()).for_each(|c| starts[c] += starts[c - 1]);
        let mut next = starts.clone();
        let mut order = vec![0; east_m.len()];
        for i in 0..east_m.len() {
            let slot = &mut next[cell_of(i)];
            order[*slot] = i;
            *slot += 1;
        }
        let at = order.iter().map(|&i| [east_m[i], north_m[i]]).collect();
        Self { first, cell_m, cells, starts, order, at }
    }

    /// The `k` nearest points for which `accept` is true and that are at most `limit_m` away, nearest first. At equal
    /// distance, the lower index comes first.
    pub fn nearest(&self, at: [f64; 2], k: usize, limit_m: f64, accept: impl Fn(usize) -> bool) -> Vec<PointNeighbour> {
        let mut found: Vec<PointNeighbour> = Vec::with_capacity(k + 1);
        if k == 0 || self.order.is_empty() || !(at[0] + at[1]).is_finite() {
            return found;
        }
        let centre = cell(self.first, self.cell_m, at);
        let (nearest_ring, last_ring) = self.rings(centre);
        for ring in nearest_ring..=last_ring {
            let beyond = (ring - 1).max(0) as f64 * self.cell_m;
            let full = found.len() == k && found[k - 1].0 <= beyond * beyond;
            if full || beyond > limit_m {
                break;
            }
            self.visit_ring(centre, ring, |slot| {
                let d2 = (self.at[slot][0] - at[0]).powi(2) + (self.at[slot][1] - at[1]).powi(2);
                let index = self.order[slot];
                let better = found.len() < k || (d2, index) < found[k - 1];
                if d2 <= limit_m * limit_m && better && accept(index) {
                    let place = found.partition_point(|f| *f < (d2, index));
                    found.insert(place, (d2, index));
                    found.truncate(k);
                }
            });
        }
        found
    }

    /// Distance in metres to the nearest point; infinite if none is within `limit_m`.
    pub fn distance(&self, at: [f64; 2], limit_m: f64) -> f64 {
        self.nearest(at, 1, limit_m, |_| true).first().map_or(f64::INFINITY, |f| f.0.sqrt())
    }

    /// The first and the last ring around a cell that intersect the sorted cells.
    fn rings(&self, centre: [i64; 2]) -> (i64, i64) {
        let gap = |c: i64, n: i64| (-c).max(c - (n - 1)).max(0);
        let far = |c: i64, n: i64| c.abs().max((n - 1 - c).abs());
        let both = |f: &dyn Fn(i64, i64) -> i64| f(centre[0], self.cells[0]).max(f(centre[1], self.cells[1]));
        (both(&gap), both(&far))
    }

    fn visit_ring(&self, centre: [i64; 2], ring: i64, mut visit: impl FnMut(usize)) {
        let rows = (centre[1] - ring).max(0)..=(centre[1] + ring).min(self.cells[1] - 1);
        for row in rows {
            let whole = (row - centre[1]).abs() == ring;
            let step = if whole { 1 } else { (2 * ring).max(1) };
            let mut column = centre[0] - ring;
            if whole {
                column = column.max(0);
            }
            while column <= (centre[0] + ring).min(self.cells[0] - 1) {
                if column >= 0 {
                    let c = (row * self.cells[0] + column) as usize;
                    (self.starts[c]..self.starts[c + 1]).for_each(&mut visit);
                }
                column += step;
            }
        }
    }
}

fn cell(first: [f64; 2], cell_m: f64, at: [f64; 2]) -> [i64; 2] {
    [0, 1].map(|a| ((at[a] - first[a]) / cell_m).floor() as i64)
}

/// Smallest and largest value; zeros if there are no values.
pub fn range(values: &[f64]) -> [f64; 2] {
    let ends = values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], &v| [a.min(v), b.max(v)]);
    if ends[0] <= ends[1] { ends } else { [0.0, 0.0] }
}
