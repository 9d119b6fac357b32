//! Hyper-parameters of the kernel by maximum likelihood, from pieces of the track.

use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;

use super::TrackSample;
use crate::navigation::slam::AnomalyKernel;
use crate::navigation::slam::fit::{FEWEST, LONGEST, minimum, standard_deviation};

/// Maximum number of samples of a piece: computing time grows with the third power of this number.
const MOST: usize = 100;
/// Maximum number of pieces of each kind (neighbouring samples, or every fourth sample).
const PIECES: usize = 5;
/// Step between the used samples in the longer pieces.
const COARSE: usize = 4;

/// Pieces of a track, whose likelihoods are multiplied.
///
/// A piece belongs to a single line, so a slow position error or a constant of the line is common to the piece and is
/// not attributed to noise. Half of the pieces consist of neighbouring samples; the others use every fourth sample and
/// determine the longer lengths. [Stein, Chi & Welty 2004: the likelihood of blocks]
pub struct TrackPieces<'a> {
    pieces: Vec<Vec<&'a TrackSample>>,
    /// Mean distance of neighbouring samples, in metres.
    spacing_m: f64,
}

impl<'a> TrackPieces<'a> {
    /// Pieces of lines. The samples of each line are in time order.
    pub fn new(lines: &[&'a [TrackSample]], spacing_m: f64) -> Self {
        let mut pieces: Vec<Vec<&TrackSample>> = vec![];
        for stride in [1, COARSE] {
            let parts = || lines.iter().flat_map(|line| line.chunks(stride * MOST));
            let long: Vec<&[TrackSample]> = parts().filter(|part| part.len() >= stride * FEWEST).collect();
            let count = long.len().min(PIECES);
            pieces.extend((0..count).map(|i| long[i * long.len() / count].iter().step_by(stride).collect()));
        }
        Self { pieces, spacing_m }
    }

    /// Logarithm of the likelihood of a kernel, with the most likely mean of each piece.
    fn log_likelihood(&self, kernel: &AnomalyKernel, temporal: (f64, f64)) -> f64 {
        let each: Vec<f64> = self.pieces.par_iter().map(|piece| of_piece(piece, kernel, temporal)).collect();
        each.iter().sum()
    }

    /// Kernel of maximum likelihood, searched from `start`; `None` if no piece is long enough, or if all pieces are
    /// constant.
    pub fn fitted(&self, start: &AnomalyKernel, temporal: (f64, f64)) -> Option<AnomalyKernel> {
        let spread = |piece: &Vec<&TrackSample>| {
            standard_deviation(&piece.iter().map(|sample| sample.value_nt).collect::<Vec<f64>>())
        };
        let spread_nt = self.pieces.iter().map(spread).fold(0.0, f64::max);
        let extent_m = self.pieces.iter().map(|piece| extent(piece)).fold(0.0, f64::max);
        // The comparison is also false for NaN.
        let varied = spread_nt > 0.0 && extent_m > 0.0 && self.spacing_m > 0.0;
        if !varied {
            return None;
        }
        let (shortest_m, longest_m) = (self.spacing_m, (LONGEST * extent_m).max(self.spacing_m));
        let kernel_of = |logs: [f64; 3]| {
            let [sigma_se_nt, length_m, sigma_n_nt] = logs.map(f64::exp);
            let length_m = length_m.clamp(shortest_m, longest_m);
            AnomalyKernel { covariance: start.covariance, sigma_se_nt, length_m, sigma_n_nt }
        };
        let cost = |logs: [f64; 3]| {
            // Without the penalty, the likelihood would be constant beyond the limits of the length.
            let outside = (logs[1] - kernel_of(logs).length_m.ln()).abs();
            -self.log_likelihood(&kernel_of(logs), temporal) + 10.0 * outside
        };
        let noise = start.sigma_n_nt.max(1e-3).ln();
        let starts = [start.length_m, 8.0 * self.spacing_m]
            .map(|length_m| [spread_nt.ln(), length_m.clamp(shortest_m, longest_m).ln(), noise]);
        let found = starts.into_iter().map(|start| minimum(start, cost)).min_by(|a, b| a.0.total_cmp(&b.0))?;
        found.0.is_finite().then(|| kernel_of(found.1))
    }
}

/// Larger side of the bounding rectangle of a piece, in metres.
fn extent(piece: &[&TrackSample]) -> f64 {
    let side = |axis: usize| {
        let all = || piece.iter().map(|sample| sample.at_m[axis]);
        all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min)
    };
    side(0).max(side(1))
}

fn of_piece(piece: &[&TrackSample], kernel: &AnomalyKernel, (sigma_nt, tau_s): (f64, f64)) -> f64 {
    let n = piece.len();
    let covariance = |row: usize, column: usize| {
        let (a, b) = (piece[row], piece[column]);
        let apart2_m2 = (a.at_m[0] - b.at_m[0]).powi(2) + (a.at_m[1] - b.at_m[1]).powi(2);
        let white = if row == column { a.variance_nt2 + kernel.sigma_n_nt.powi(2) } else { 0.0 };
        let lasting = sigma_nt * sigma_nt * (-(a.tt_s - b.tt_s).abs() / tau_s).exp();
        kernel.anomaly_nt2(apart2_m2) + lasting + white
    };
    let Some(factor) = Cholesky::new(DMatrix::from_fn(n, n, covariance)) else { return f64::NEG_INFINITY };
    let ones = factor.solve(&DVector::from_element(n, 1.0));
    let values = DVector::from_iterator(n, piece.iter().map(|sample| sample.value_nt));
    let apart = values.add_scalar(-ones.dot(&values) / ones.sum());
    let determinant: f64 = (0..n).map(|row| factor.l_dirty()[(row, row)].ln()).sum();
    let log = -0.5 * apart.dot(&factor.solve(&apart)) - determinant;
    if log.is_finite() { log } else { f64::NEG_INFINITY }
}
