//! The relative levels of maps, from their overlaps.

use crate::maps::plane_grid::PlaneGrid;
use crate::regression::statistics::median;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// The bias that is subtracted from each map before they are combined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BiasModel {
    /// No bias.
    #[default]
    Nothing,
    /// A constant: the median of the differences in each overlap, adjusted over all overlaps by least squares weighted
    /// with the number of nodes.
    Constant,
    /// A plane, fitted to all overlaps together by robust least squares. [Huber 1964]
    Plane,
}

/// Bias of a map relative to the first map of its group of overlapping maps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OverlapBias {
    /// Bias at the middle of the combined grid, in the unit of the maps.
    pub constant: f64,
    /// Slope per metre eastward.
    pub per_m_east: f64,
    /// Slope per metre northward.
    pub per_m_north: f64,
}

impl OverlapBias {
    /// Subtracts the bias from a map on the nodes of `target`.
    pub(super) fn take_off(&self, target: &PlaneGrid, map: &mut [f64]) {
        if *self == Self::default() {
            return;
        }
        map.par_iter_mut().enumerate().for_each(|(node, value)| {
            let [_, east_m, north_m] = terms(target, node);
            *value -= self.constant + self.per_m_east * east_m + self.per_m_north * north_m;
        });
    }
}

/// The terms of the bias: 1, and the distances in metres east and north from the middle of the grid.
fn terms(target: &PlaneGrid, node: usize) -> [f64; 3] {
    let (row, column) = (node / target.columns(), node % target.columns());
    let from_middle = |at: usize, len: usize| at as f64 - 0.5 * (len - 1) as f64;
    [
        1.0,
        target.east_m.step * from_middle(column, target.columns()),
        target.north_m.step * from_middle(row, target.rows()),
    ]
}

/// Two maps that overlap.
pub(super) struct OverlapPair {
    pub(super) first: usize,
    pub(super) second: usize,
    /// The nodes where both maps are known.
    nodes: Vec<u32>,
}

impl OverlapPair {
    /// First map minus second, at the nodes of the overlap.
    pub(super) fn differences(&self, maps: &[Vec<f64>]) -> Vec<f64> {
        let (first, second) = (&maps[self.first], &maps[self.second]);
        self.nodes.par_iter().map(|node| first[*node as usize] - second[*node as usize]).collect()
    }
}

/// All pairs of maps that overlap.
pub(super) fn pairs(maps: &[Vec<f64>]) -> Vec<OverlapPair> {
    let all = (0..maps.len()).flat_map(|first| (first + 1..maps.len()).map(move |second| (first, second)));
    let pair = |(first, second): (usize, usize)| {
        let both = maps[first].par_iter().zip(&maps[second]).enumerate();
        let known = both.filter(|(_, (one, other))| !one.is_nan() && !other.is_nan());
        OverlapPair { first, second, nodes: known.map(|(node, _)| node as u32).collect() }
    };
    all.map(pair).filter(|pair| !pair.nodes.is_empty()).collect()
}

/// The bias of each map.
pub(super) fn estimate(
    maps: &[Vec<f64>],
    pairs: &[OverlapPair],
    target: &PlaneGrid,
    model: BiasModel,
) -> Vec<OverlapBias> {
    match model {
        BiasModel::Nothing => vec![OverlapBias::default(); maps.len()],
        BiasModel::Constant => constants(maps, pairs),
        BiasModel::Plane => planes(maps, pairs, target),
    }
}

fn constants(maps: &[Vec<f64>], pairs: &[OverlapPair]) -> Vec<OverlapBias> {
    let mut network = BiasEquations::<1>::new(maps.len());
    for pair in pairs {
        let level = median(&mut pair.differences(maps));
        let count = pair.nodes.len() as f64;
        network.add(pair, &OverlapSums { squares: [[count]], products: [count * level] });
    }
    network.solve(pairs).into_iter().map(|[constant]| OverlapBias { constant, ..OverlapBias::default() }).collect()
}

fn planes(maps: &[Vec<f64>], pairs: &[OverlapPair], target: &PlaneGrid) -> Vec<OverlapBias> {
    const ROUNDS: usize = 12;
    // Distances are in units of half the grid, so that all terms have the same magnitude.
    let half =
        [1.0, half_extent(target.east_m.step, target.columns()), half_extent(target.north_m.step, target.rows())];
    let scaled = |node: u32| {
        let terms = terms(target, node as usize);
        [0, 1, 2].map(|k| terms[k] / half[k])
    };
    let mut biases = vec![[0.0; 3]; maps.len()];
    for _ in 0..ROUNDS {
        let mut network = BiasEquations::<3>::new(maps.len());
        for pair in pairs {
            let [first, second] = [biases[pair.first], biases[pair.second]];
            let differences = pair.differences(maps);
            let left = |node: u32, difference: f64| {
                let terms = scaled(node);
                difference - (0..3).map(|k| (first[k] - second[k]) * terms[k]).sum::<f64>()
            };
            let far = huber_threshold(pair.nodes.iter().zip(&differences).map(|(node, d)| left(*node, *d)).collect());
            network.add(
                pair,
                &OverlapSums::from_differences(&pair.nodes, &differences, scaled, |node, d| huber(left(node, d), far)),
            );
        }
        biases = network.solve(pairs);
    }
    let bias = |b: [f64; 3]| OverlapBias { constant: b[0], per_m_east: b[1] / half[1], per_m_north: b[2] / half[2] };
    biases.into_iter().map(bias).collect()
}

fn half_extent(step: f64, len: usize) -> f64 {
    0.5 * step * len as f64
}

/// Threshold above which differences are down-weighted: 1.345 standard deviations, estimated from the median.
fn huber_threshold(mut left: Vec<f64>) -> f64 {
    left.iter_mut().for_each(|left| *left = left.abs());
    1.345 * 1.4826 * median(&mut left)
}

fn huber(left: f64, far: f64) -> f64 {
    if left.abs() <= far { 1.0 } else { far / left.abs() }
}

/// The sums of the normal equations of one overlap.
struct OverlapSums<const TERMS: usize> {
    squares: [[f64; TERMS]; TERMS],
    products: [f64; TERMS],
}

impl<const TERMS: usize> OverlapSums<TERMS> {
    const ZERO: Self = Self { squares: [[0.0; TERMS]; TERMS], products: [0.0; TERMS] };

    fn from_differences(
        nodes: &[u32],
        differences: &[f64],
        terms: impl Fn(u32) -> [f64; TERMS] + Sync,
        weight: impl Fn(u32, f64) -> f64 + Sync,
    ) -> Self {
        // Blocks of fixed size are summed in order, so that results are bit-identical for any number of threads.
        const BLOCK: usize = 4096;
        let block = |(nodes, differences): (&[u32], &[f64])| {
            let mut sums = Self::ZERO;
            for (node, difference) in nodes.iter().zip(differences) {
                sums.add(terms(*node), *difference, weight(*node, *difference));
            }
            sums
        };
        let blocks: Vec<Self> = nodes.par_chunks(BLOCK).zip(differences.par_chunks(BLOCK)).map(block).collect();
        blocks.iter().fold(Self::ZERO, |mut all, block| {
            for j in 0..TERMS {
                all.products[j] += block.products[j];
                (0..TERMS).for_each(|k| all.squares[j][k] += block.squares[j][k]);
            }
            all
        })
    }

    fn add(&mut self, terms: [f64; TERMS], difference: f64, weight: f64) {
        for j in 0..TERMS {
            self.products[j] += weight * terms[j] * difference;
            (0..TERMS).for_each(|k| self.squares[j][k] += weight * terms[j] * terms[k]);
        }
    }
}

/// The normal equations of the biases of all maps.
struct BiasEquations<const TERMS: usize> {
    matrix: DMatrix<f64>,
    side: DVector<f64>,
    maps: usize,
}

impl<const TERMS: usize> BiasEquations<TERMS> {
    fn new(maps: usize) -> Self {
        Self { matrix: DMatrix::zeros(maps * TERMS, maps * TERMS), side: DVector::zeros(maps * TERMS), maps }
    }

    fn add(&mut self, pair: &OverlapPair, sums: &OverlapSums<TERMS>) {
        let (first, second) = (pair.first * TERMS, pair.second * TERMS);
        for j in 0..TERMS {
            self.side[first + j] += sums.products[j];
            self.side[second + j] -= sums.products[j];
            for k in 0..TERMS {
                self.matrix[(first + j, first + k)] += sums.squares[j][k];
                self.matrix[(second + j, second + k)] += sums.squares[j][k];
                self.matrix[(first + j, second + k)] -= sums.squares[j][k];
                self.matrix[(second + j, first + k)] -= sums.squares[j][k];
            }
        }
    }

    /// Solves for the biases; the first map of each connected group has zero bias.
    fn solve(mut self, pairs: &[OverlapPair]) -> Vec<[f64; TERMS]> {
        let group = groups(self.maps, pairs);
        for map in (0..self.maps).filter(|map| group[*map] == *map) {
            for row in map * TERMS..(map + 1) * TERMS {
                self.matrix.row_mut(row).fill(0.0);
                self.matrix.column_mut(row).fill(0.0);
                self.matrix[(row, row)] = 1.0;
                self.side[row] = 0.0;
            }
        }
        // An overlap along one line does not determine a slope; undetermined terms stay zero.
        const OPEN: f64 = 1e-9;
        let largest = self.matrix.amax();
        let solved = self.matrix.svd(true, true).solve(&self.side, OPEN * largest).unwrap_or_else(|_| self.side * 0.0);
        (0..self.maps).map(|map| std::array::from_fn(|k| solved[map * TERMS + k])).collect()
    }
}

/// For each map, the first map of its connected group.
fn groups(maps: usize, pairs: &[OverlapPair]) -> Vec<usize> {
    let mut group: Vec<usize> = (0..maps).collect();
    // A chain of overlaps has fewer links than there are maps, so one round per map is enough to reach its end.
    for _ in 0..maps {
        for pair in pairs {
            let least = group[pair.first].min(group[pair.second]);
            (group[pair.first], group[pair.second]) = (least, least);
        }
    }
    group
}
