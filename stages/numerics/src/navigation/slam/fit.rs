//! Hyper-parameters by maximum likelihood.

use nalgebra::{Cholesky, DMatrix, DVector};

use super::kernel::AnomalyKernel;
use super::samples::SlamSample;

/// Maximum number of samples in the likelihood. Computing time grows with the third power of this number.
const MOST: usize = 200;
/// Smallest number of samples for a fit of three hyper-parameters.
pub(in crate::navigation) const FEWEST: usize = 20;
/// Maximum number of evaluations of the likelihood.
const EVALUATIONS: usize = 400;
/// Maximum of a fitted length, as a fraction of the path used; a longer length cannot be distinguished from a slope.
pub(in crate::navigation) const LONGEST: f64 = 0.5;

/// Measurements along a path, in time order.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackMeasurements {
    /// Distance along the path, in metres.
    pub distance_m: Vec<f64>,
    /// Time, in seconds.
    pub tt_s: Vec<f64>,
    /// Measurement, in nT.
    pub value_nt: Vec<f64>,
    /// Variance of the white noise of the measurement, in nT².
    pub variance_nt2: Vec<f64>,
}

impl TrackMeasurements {
    /// Samples of the first `window_s` seconds. If there are more than 200, only every second, third, … is used,
    /// because a run of 200 neighbours would cover too little of the path.
    pub fn from_samples(samples: &[SlamSample], window_s: f64) -> Self {
        let first_s = samples.first().map_or(0.0, |sample| sample.tt_s);
        let count = samples.partition_point(|sample| sample.tt_s - first_s <= window_s);
        let mut out = Self { distance_m: vec![], tt_s: vec![], value_nt: vec![], variance_nt2: vec![] };
        let stride = count.div_ceil(MOST).max(1);
        let (mut along_m, mut before) = (0.0, None::<[f64; 2]>);
        for (place, sample) in samples.iter().take(count).enumerate() {
            let from = before.replace(sample.at_m).unwrap_or(sample.at_m);
            along_m += (sample.at_m[0] - from[0]).hypot(sample.at_m[1] - from[1]);
            if place % stride == 0 {
                out.distance_m.push(along_m);
                out.tt_s.push(sample.tt_s);
                out.value_nt.push(sample.value_nt);
                out.variance_nt2.push(sample.variance_nt2);
            }
        }
        out
    }

    /// Logarithm of the likelihood of a kernel, with the most likely mean. `temporal` is the standard deviation (nT)
    /// and correlation time (s) of the temporal variation. Minus infinity if the covariance is not positive. [Lee 2019,
    /// (53)]
    pub fn log_likelihood(&self, kernel: &AnomalyKernel, temporal: (f64, f64)) -> f64 {
        let n = self.value_nt.len();
        let (sigma_nt, tau_s) = temporal;
        let covariance = |row: usize, column: usize| {
            let apart_m = self.distance_m[row] - self.distance_m[column];
            let apart_s = (self.tt_s[row] - self.tt_s[column]).abs();
            let white = if row == column { self.variance_nt2[row] + kernel.sigma_n_nt.powi(2) } else { 0.0 };
            kernel.anomaly_nt2(apart_m * apart_m) + sigma_nt * sigma_nt * (-apart_s / tau_s).exp() + white
        };
        let Some(factor) = Cholesky::new(DMatrix::from_fn(n, n, covariance)) else { return f64::NEG_INFINITY };
        let ones = factor.solve(&DVector::from_element(n, 1.0));
        let values = DVector::from_column_slice(&self.value_nt);
        let mean_nt = ones.dot(&values) / ones.sum();
        let apart = values.add_scalar(-mean_nt);
        let determinant: f64 = (0..n).map(|row| factor.l_dirty()[(row, row)].ln()).sum();
        let log = -0.5 * apart.dot(&factor.solve(&apart)) - determinant - 0.5 * n as f64 * std::f64::consts::TAU.ln();
        if log.is_finite() { log } else { f64::NEG_INFINITY }
    }

    /// Kernel of maximum likelihood, searched from `start`; `None` for fewer than 20 measurements, for a path of length
    /// 0, or for constant measurements.
    ///
    /// The length is between the mean distance of the measurements and half of the path.
    pub fn fitted(&self, start: &AnomalyKernel, temporal: (f64, f64)) -> Option<AnomalyKernel> {
        let n = self.value_nt.len();
        let path_m = *self.distance_m.last()?;
        let spread = standard_deviation(&self.value_nt);
        // The comparison is also false for NaN.
        let varied = n >= FEWEST && path_m > 0.0 && spread > 0.0;
        if !varied {
            return None;
        }
        let spacing_m = path_m / (n - 1) as f64;
        let kernel_of = |logs: [f64; 3]| {
            let [sigma_se_nt, length_m, sigma_n_nt] = logs.map(f64::exp);
            AnomalyKernel {
                covariance: start.covariance,
                sigma_se_nt,
                length_m: length_m.clamp(spacing_m, LONGEST * path_m),
                sigma_n_nt,
            }
        };
        let cost = |logs: [f64; 3]| {
            // Without the penalty, the likelihood would be constant beyond the limits of the length.
            let beyond = (logs[1] - kernel_of(logs).length_m.ln()).abs();
            -self.log_likelihood(&kernel_of(logs), temporal) + 10.0 * beyond
        };
        let noise = start.sigma_n_nt.max(1e-3);
        let starts = [start.length_m, 4.0 * spacing_m, 10.0 * spacing_m]
            .map(|length| [spread.ln(), length.clamp(spacing_m, LONGEST * path_m).ln(), noise.ln()]);
        let found = starts.into_iter().map(|start| minimum(start, cost)).min_by(|a, b| a.0.total_cmp(&b.0))?;
        found.0.is_finite().then(|| kernel_of(found.1))
    }
}

pub(in crate::navigation) fn standard_deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

/// Minimum of a function and the position of the minimum, by the simplex of Nelder & Mead (1965).
pub(in crate::navigation) fn minimum(start: [f64; 3], cost: impl Fn([f64; 3]) -> f64) -> (f64, [f64; 3]) {
    let between = |a: [f64; 3], b: [f64; 3], t: f64| [0, 1, 2].map(|i: usize| a[i] + t * (b[i] - a[i]));
    let mut simplex = vec![(cost(start), start)];
    for axis in 0..3 {
        let mut corner = start;
        corner[axis] += 0.7;
        simplex.push((cost(corner), corner));
    }
    let mut evaluations = 4;
    while evaluations < EVALUATIONS {
        simplex.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (best, worst) = (simplex[0], simplex[3]);
        if worst.0 - best.0 < 1e-5 {
            break;
        }
        let middle = [0, 1, 2].map(|i: usize| simplex[..3].iter().map(|corner| corner.1[i]).sum::<f64>() / 3.0);
        let at = |t: f64| (cost(between(middle, worst.1, t)), between(middle, worst.1, t));
        let reflected = at(-1.0);
        evaluations += 2;
        let replacement = if reflected.0 < best.0 {
            let expanded = at(-2.0);
            if expanded.0 < reflected.0 { expanded } else { reflected }
        } else if reflected.0 < simplex[2].0 {
            reflected
        } else {
            at(if reflected.0 < worst.0 { -0.5 } else { 0.5 })
        };
        if replacement.0 < worst.0 {
            simplex[3] = replacement;
        } else {
            for corner in &mut simplex[1..] {
                let moved = between(best.1, corner.1, 0.5);
                *corner = (cost(moved), moved);
            }
            evaluations += 3;
        }
    }
    simplex.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, start))
}
