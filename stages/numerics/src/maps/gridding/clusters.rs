//! Points in nested boxes, each with the Chebyshev points that represent its contents.

use super::nearest::range;

/// Numbers of Chebyshev points along the two horizontal axes and along the vertical axis.
pub(super) const ACROSS: usize = 4;
pub(super) const UPWARD: usize = 2;
/// Number of Chebyshev points of a box.
pub(super) const PROXIES: usize = ACROSS * ACROSS * UPWARD;

/// Coordinates of points, one column per axis, in metres.
#[derive(Clone, Debug, Default)]
pub(super) struct PointPositions {
    pub east: Vec<f64>,
    pub north: Vec<f64>,
    pub up: Vec<f64>,
}

impl PointPositions {
    pub fn len(&self) -> usize {
        self.east.len()
    }

    fn axis(&self, axis: usize) -> &[f64] {
        [&self.east, &self.north, &self.up][axis]
    }

    /// A subset of the points.
    pub fn part(&self, part: std::ops::Range<usize>) -> [&[f64]; 3] {
        [&self.east[part.clone()], &self.north[part.clone()], &self.up[part]]
    }

    /// The points of `order`.
    pub fn pick(&self, order: &[usize]) -> Self {
        let take = |values: &[f64]| order.iter().map(|&i| values[i]).collect();
        Self { east: take(&self.east), north: take(&self.north), up: take(&self.up) }
    }
}

/// Box around the points `start..end`; `children` are two smaller boxes, or `None`.
#[derive(Clone, Debug)]
pub(super) struct ClusterBox {
    pub start: usize,
    pub end: usize,
    pub children: Option<[usize; 2]>,
    pub centre: [f64; 3],
    pub half: [f64; 3],
    pub radius: f64,
}

/// Tree of boxes over points; the points of each box are contiguous.
#[derive(Clone, Debug)]
pub(super) struct ClusterTree {
    /// Sorted positions.
    pub points: PointPositions,
    /// The original index of each sorted point.
    pub order: Vec<usize>,
    /// Boxes; each precedes its children.
    pub boxes: Vec<ClusterBox>,
}

impl ClusterTree {
    /// Halves boxes across their longer horizontal side until none contains more than `most` points.
    pub fn new(points: &PointPositions, most: usize) -> Self {
        let mut order: Vec<usize> = (0..points.len()).collect();
        let mut boxes = vec![around(points, &order, 0)];
        let mut at = 0;
        while at < boxes.len() {
            let (start, end, axis, middle) = halved(&boxes[at]);
            if end - start > most.max(1) && boxes[at].half[axis] > 1e-6 {
                let (west, east): (Vec<usize>, Vec<usize>) =
                    order[start..end].iter().partition(|&&i| points.axis(axis)[i] < middle);
                let cut = start + west.len();
                order[start..cut].copy_from_slice(&west);
                order[cut..end].copy_from_slice(&east);
                boxes[at].children = Some([boxes.len(), boxes.len() + 1]);
                boxes.push(around(points, &order[start..cut], start));
                boxes.push(around(points, &order[cut..end], cut));
            }
            at += 1;
        }
        Self { points: points.pick(&order), order, boxes }
    }

    /// The boxes that are not divided further.
    pub fn leaves(&self) -> Vec<&ClusterBox> {
        self.boxes.iter().filter(|b| b.children.is_none()).collect()
    }

    /// Values in the order of the sorted points.
    pub fn sorted(&self, values: &[f64]) -> Vec<f64> {
        self.order.iter().map(|&i| values[i]).collect()
    }

    /// Values of sorted points in the original order of the points.
    pub fn unsorted(&self, sorted: &[f64]) -> Vec<f64> {
        let mut values = vec![0.0; sorted.len()];
        self.order.iter().zip(sorted).for_each(|(&i, &v)| values[i] = v);
        values
    }
}

fn halved(cluster: &ClusterBox) -> (usize, usize, usize, f64) {
    let axis = usize::from(cluster.half[1] > cluster.half[0]);
    (cluster.start, cluster.end, axis, cluster.centre[axis])
}

fn around(points: &PointPositions, order: &[usize], start: usize) -> ClusterBox {
    let ends = [0, 1, 2].map(|axis| {
        let of: Vec<f64> = order.iter().map(|&i| points.axis(axis)[i]).collect();
        range(&of)
    });
    let half = ends.map(|[a, b]| 0.5 * (b - a));
    ClusterBox {
        start,
        end: start + order.len(),
        children: None,
        centre: ends.map(|[a, b]| 0.5 * (a + b)),
        half,
        radius: half.iter().map(|h| h * h).sum::<f64>().sqrt(),
    }
}

impl ClusterBox {
    /// Half a side, never zero, because interpolation requires distinct points.
    fn width(&self, axis: usize) -> f64 {
        self.half[axis].max(1e-2 * self.radius).max(1e-3)
    }

    /// Chebyshev points of the box; the vertical index varies fastest.
    pub fn proxies(&self) -> PointPositions {
        let along = |axis: usize, count: usize| -> Vec<f64> {
            (0..count).map(|k| self.centre[axis] + self.width(axis) * chebyshev(k, count)).collect()
        };
        let (east, north, up) = (along(0, ACROSS), along(1, ACROSS), along(2, UPWARD));
        let mut all = PointPositions::default();
        for e in &east {
            for n in &north {
                for u in &up {
                    all.east.push(*e);
                    all.north.push(*n);
                    all.up.push(*u);
                }
            }
        }
        all
    }

    /// The weight of each Chebyshev point in the interpolation to a position.
    pub fn weights(&self, at: [f64; 3]) -> [f64; PROXIES] {
        let unit = [0, 1, 2].map(|axis| (at[axis] - self.centre[axis]) / self.width(axis));
        let (east, north) = (lagrange::<ACROSS>(unit[0]), lagrange::<ACROSS>(unit[1]));
        let up = lagrange::<UPWARD>(unit[2]);
        let mut all = [0.0; PROXIES];
        for (i, e) in east.iter().enumerate() {
            for (j, n) in north.iter().enumerate() {
                for (k, u) in up.iter().enumerate() {
                    all[(i * ACROSS + j) * UPWARD + k] = e * n * u;
                }
            }
        }
        all
    }
}

fn chebyshev(k: usize, count: usize) -> f64 {
    (std::f64::consts::PI * (k as f64 + 0.5) / count as f64).cos()
}

/// Lagrange's polynomials on N Chebyshev points of -1..1.
fn lagrange<const N: usize>(x: f64) -> [f64; N] {
    let nodes: [f64; N] = std::array::from_fn(|k| chebyshev(k, N));
    std::array::from_fn(|k| (0..N).filter(|&m| m != k).map(|m| (x - nodes[m]) / (nodes[k] - nodes[m])).product())
}
