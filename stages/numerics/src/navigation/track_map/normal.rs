//! Normal equations of the weights, and the variance of the field from the inverse of the normal matrix.

use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, Side};
use rayon::prelude::*;

use super::basis::{LaplacianBasis, waves};

/// Number of samples whose sines and cosines are in memory at the same time.
const CHUNK: usize = 2048;

/// Row of the normal equations for one sample.
#[derive(Clone, Debug)]
pub struct TrackMapRow {
    /// Position east and north, in metres.
    pub at_m: [f64; 2],
    /// Value, in nT.
    pub value_nt: f64,
    /// Inverse variance of the noise of the sample, in nT⁻².
    pub weight: f64,
    /// Entries in the additional columns: column and factor.
    pub beside: Vec<(usize, f64)>,
}

/// Sums over the samples that determine the equations; their size is independent of the number of samples.
///
/// A product of two sines is a difference of two cosines. The number of different entries in ΦᵀWΦ is therefore the
/// number of sums and differences of half waves: four per function, instead of one per pair. [Viset, Kullberg, Wesel &
/// Solin 2024]
#[derive(Clone, Debug)]
pub struct TrackMapSums {
    /// Σ w cos(p θ₁) cos(q θ₂), ordered by p, then q; p and q are up to twice the maximum number of half waves.
    cosines: Vec<f64>,
    /// Σ w h sin(j₁ θ₁) sin(j₂ θ₂) for each additional column and, last, for the values; ordered by j₁, column, j₂.
    sines: Vec<f64>,
    /// Σ w h hᵀ of the additional columns and of the values.
    beside: Vec<f64>,
    columns: usize,
}

impl TrackMapSums {
    /// Sums over all rows. `columns` is the number of additional columns. Results are bit-identical for any number of
    /// threads.
    pub fn new(basis: &LaplacianBasis, rows: &[TrackMapRow], columns: usize) -> Self {
        let [p, q] = basis.most.map(|most| 2 * most + 1);
        let [m1, m2] = basis.most;
        let all = columns + 1;
        let mut sums =
            Self { cosines: vec![0.0; p * q], sines: vec![0.0; m1 * all * m2], beside: vec![0.0; all * all], columns };
        for chunk in rows.chunks(CHUNK) {
            let table = |axis: usize| -> (Vec<f64>, Vec<f64>) {
                let (c, s) = (2 * basis.most[axis] + 1, basis.most[axis]);
                let (mut cosines, mut sines) = (vec![0.0; c * chunk.len()], vec![0.0; s * chunk.len()]);
                let each = cosines.par_chunks_mut(c).zip(sines.par_chunks_mut(s)).zip(chunk);
                each.for_each(|((cosines, sines), row)| waves(basis.angle(row.at_m[axis], axis), cosines, sines));
                (cosines, sines)
            };
            let ((east_c, east_s), (north_c, north_s)) = (table(0), table(1));
            sums.cosines.par_chunks_mut(q).enumerate().for_each(|(i, line)| {
                for (row, (east, north)) in chunk.iter().zip(east_c.chunks_exact(p).zip(north_c.chunks_exact(q))) {
                    add(line, row.weight * east[i], north);
                }
            });
            sums.sines.par_chunks_mut(all * m2).enumerate().for_each(|(i, lines)| {
                for (row, (east, north)) in chunk.iter().zip(east_s.chunks_exact(m1).zip(north_s.chunks_exact(m2))) {
                    let factor = row.weight * east[i];
                    for (column, h) in row.entries(columns) {
                        add(&mut lines[column * m2..(column + 1) * m2], factor * h, north);
                    }
                }
            });
            for row in chunk {
                for (a, h) in row.entries(columns) {
                    for (b, g) in row.entries(columns) {
                        sums.beside[a * all + b] += row.weight * h * g;
                    }
                }
            }
        }
        sums
    }

    /// (ΦᵀWΦ)ⱼₖ, without the scales of the functions.
    fn pair(&self, basis: &LaplacianBasis, j: usize, k: usize) -> f64 {
        let q = 2 * basis.most[1] + 1;
        let ([j1, j2], [k1, k2]) = (basis.functions[j], basis.functions[k]);
        let at = |east: usize, north: usize| self.cosines[east * q + north];
        let (d1, d2, s1, s2) = (j1.abs_diff(k1), j2.abs_diff(k2), j1 + k1, j2 + k2);
        0.25 * (at(d1, d2) - at(d1, s2) - at(s1, d2) + at(s1, s2))
    }

    /// (ΦᵀWH)ⱼ of an additional column.
    fn cross(&self, basis: &LaplacianBasis, j: usize, column: usize) -> f64 {
        let ([j1, j2], m2) = (basis.functions[j], basis.most[1]);
        self.sines[((j1 - 1) * (self.columns + 1) + column) * m2 + j2 - 1]
    }
}

impl TrackMapRow {
    /// Entries of the row, followed by the value.
    fn entries(&self, columns: usize) -> impl Iterator<Item = (usize, f64)> {
        self.beside.iter().copied().chain([(columns, self.value_nt)])
    }
}

fn add(to: &mut [f64], factor: f64, of: &[f64]) {
    for (to, of) in to.iter_mut().zip(of) {
        *to += factor * of;
    }
}

/// Solution of the normal equations, with the factor of their matrix.
pub struct TrackMapSolution {
    factor: faer::linalg::solvers::Llt<f64>,
    /// Weights of the functions, multiplied by their scales, in nT.
    pub weights_nt: Vec<f64>,
    /// Weights of the additional columns.
    pub beside: Vec<f64>,
}

impl TrackMapSolution {
    /// Solves (Λ⁻¹ + AᵀWA) x = AᵀWy. A holds the functions and the additional columns; `prior` is the inverse
    /// covariance of the additional columns, by rows. `None` if the matrix is not positive.
    pub fn solve(basis: &LaplacianBasis, sums: &TrackMapSums, prior: &[f64]) -> Option<Self> {
        let (m, columns) = (basis.functions.len(), sums.columns);
        let (all, scales) = (columns + 1, &basis.scales_nt);
        let mut matrix = Mat::<f64>::zeros(m + columns, m + columns);
        for j in 0..m {
            for i in j..m {
                matrix[(i, j)] = scales[i] * scales[j] * sums.pair(basis, i, j) + if i == j { 1.0 } else { 0.0 };
            }
            for e in 0..columns {
                matrix[(m + e, j)] = scales[j] * sums.cross(basis, j, e);
            }
        }
        for e in 0..columns {
            for f in e..columns {
                matrix[(m + f, m + e)] = prior[f * columns + e] + sums.beside[f * all + e];
            }
        }
        let right = Mat::<f64>::from_fn(m + columns, 1, |i, _| match i.checked_sub(m) {
            None => scales[i] * sums.cross(basis, i, columns),
            Some(e) => sums.beside[e * all + columns],
        });
        let factor = matrix.llt(Side::Lower).ok()?;
        let x = factor.solve(&right);
        let weights_nt: Vec<f64> = (0..m).map(|j| scales[j] * x[(j, 0)]).collect();
        let beside: Vec<f64> = (0..columns).map(|e| x[(m + e, 0)]).collect();
        let finite = weights_nt.iter().chain(&beside).all(|x| x.is_finite());
        finite.then_some(Self { factor, weights_nt, beside })
    }

    /// Variance of the sum of the field and the first additional column, as a sum of cosines and a sum of sines.
    pub fn variance(&self, basis: &LaplacianBasis) -> FieldVariance {
        let (m, [p, q]) = (basis.functions.len(), basis.most.map(|most| 2 * most + 1));
        let inverse = self.factor.inverse();
        let mut cosines = vec![0.0; p * q];
        for k in 0..m {
            let [k1, k2] = basis.functions[k];
            for j in 0..=k {
                let [j1, j2] = basis.functions[j];
                let twice = if j == k { 0.25 } else { 0.5 };
                let entry = twice * basis.scales_nt[j] * basis.scales_nt[k] * inverse[(k, j)];
                let (d1, d2, s1, s2) = (k1.abs_diff(j1), k2.abs_diff(j2), k1 + j1, k2 + j2);
                cosines[d1 * q + d2] += entry;
                cosines[d1 * q + s2] -= entry;
                cosines[s1 * q + d2] -= entry;
                cosines[s1 * q + s2] += entry;
            }
        }
        let level_nt2 = if self.beside.is_empty() { 0.0 } else { inverse[(m, m)] };
        let with_level = (0..m)
            .map(|j| if self.beside.is_empty() { 0.0 } else { 2.0 * basis.scales_nt[j] * inverse[(m, j)] })
            .collect();
        FieldVariance { cosines, with_level, level_nt2 }
    }
}

/// Variance of the field as a function of position.
pub struct FieldVariance {
    /// Factors of cos(p θ₁) cos(q θ₂), in nT².
    pub cosines: Vec<f64>,
    /// Factors of the functions, without their scales.
    pub with_level: Vec<f64>,
    /// Constant part.
    pub level_nt2: f64,
}
