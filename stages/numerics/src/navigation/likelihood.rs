//! Maximum-likelihood estimate of the measurement noise of a line from the innovations.
//!
//! With the correct noise, an extended Kalman filter has white innovations of the predicted variance, and the
//! likelihood of the measurements is at its maximum [Schweppe 1965; Harvey 1989, section 3.4]:
//!
//! ln L = -1/2 sum of (ln S_k + r_k² / S_k),
//!
//! with the innovation r_k and the predicted variance S_k of the innovation. The estimate requires only measurements,
//! no truth.
//!
//! The white noise, and the standard deviation and time constant of the first-order Gauss-Markov process, are searched
//! in logarithms: on a coarse grid, then with shrinking steps around the best point of the grid. A constant offset of
//! the measurement appears as a Gauss-Markov process with a long time constant. The measurements are thinned, so that
//! errors with correlation times below the interval count as white. An innovation beyond the gate is limited to the
//! gate, so that spikes have little influence.
//!
//! The permanent field of an aircraft changes after its calibration, by landings, temperature, or parts that are
//! magnetised. In turns, the effect of this change on the field is not a Gauss-Markov process in time. If three states
//! for it increase the likelihood by more than a threshold, they are used, with the most likely standard deviation and
//! time constant.
//!
//! A magnetometer with late time stamps measures the field of earlier positions. Its lag becomes a state if that
//! increases the likelihood by more than a threshold. Likewise, a constant error of the height on the map becomes a
//! state if the map changes with height.
//!
//! For an uncompensated magnetometer, the coefficients of the aircraft field are states of the filter, with their
//! prior.

mod aircraft;
mod constant;
mod estimate;
mod interval;
mod outliers;
mod permanent;
mod thinned;

use rayon::prelude::*;

use crate::navigation::aided::{self, AidedParameters, Aids, PermanentChange};
use crate::navigation::ekf::{EkfInput, EkfParameters, run_together};
use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{NavigationError, NavigationOutput};
use crate::regression::consistency::{normalised_innovations, statistical_inefficiency};

pub use aircraft::{AircraftFieldAlong, AircraftStates};
pub use constant::height_gain;
pub use estimate::{IntervalEstimate, LineNoise};
pub use interval::denser;
pub use outliers::{GATE_NIS, outliers};
use thinned::ThinnedLine;
pub use thinned::rows_at;

/// Line, and settings of the search for the noise of the line.
#[derive(Clone, Copy, Debug)]
pub struct NoiseSearch<'a> {
    /// Line; its `sigma_nt` and the noise in its `errors` are ignored.
    pub line: &'a NavigationLine<'a>,
    /// Rows whose measurements are used, ascending.
    pub rows: &'a [usize],
    /// Factor on the white noise at each sample, for example below 1 for the mean of several sensors.
    pub scale: &'a [f64],
    /// Additional known standard deviation of each sample, in nT.
    pub known_nt: Option<&'a [f64]>,
    /// Standard deviation of the map's own error at each sample, in nT.
    pub map_nt: Option<&'a [f64]>,
    /// Direction of the field at each of `rows`; see [`PermanentChange`]. Without it the permanent field is constant.
    pub direction: Option<&'a [[f64; 3]]>,
    /// Aircraft field of an uncompensated magnetometer. It cannot be combined with `direction`.
    pub aircraft: Option<AircraftStates<'a>>,
    /// Prior standard deviation of the lag of the magnetometer, in seconds; 0 for no lag, `None` to search for a lag.
    /// An `aircraft` field has no lag.
    pub latency_sigma_s: Option<f64>,
    /// Prior standard deviation of the bias between the height of the INS and the height on the map, in metres. 0 for
    /// no bias; `None` to search for a bias, which requires a map that changes with height. An `aircraft` field has no
    /// such bias.
    pub map_height_sigma_m: Option<f64>,
    /// Given parameters: white noise in nT, standard deviation of the process in nT, its time constant in s, standard
    /// deviation of the change of the permanent field in nT (0 for none), and its time constant in seconds.
    pub given: NoiseParameters,
}

/// Given parameters of a [`NoiseSearch`]; a parameter that is `None` is searched.
pub type NoiseParameters = [Option<f64>; PARAMETERS];

/// Number of parameters.
pub const PARAMETERS: usize = 5;

/// Permitted range of each parameter.
const RANGES: [[f64; 2]; PARAMETERS] = [[0.5, 300.0], [0.1, 3000.0], [10.0, 3e5], [0.5, 1000.0], [300.0, 1e6]];
/// Coarse grid of the white noise and the process.
const GRID: [&[f64]; 3] = [
    &[0.5, 1.0, 3.0, 10.0, 30.0],
    &[1.0, 4.0, 16.0, 64.0, 256.0, 1000.0],
    &[30.0, 150.0, 800.0, 4000.0, 20_000.0, 100_000.0],
];
/// Factors on the map's own variance.
const MAP_FACTORS: [f64; 4] = [0.25, 1.0, 4.0, 16.0];
/// Weak prior that keeps the estimates for short lines away from the ends of the ranges: centres, and standard
/// deviations of the logarithms.
const PRIOR: [(f64, f64); PARAMETERS] = [(3.0, 2.0), (5.0, 2.5), (600.0, 2.5), (10.0, 2.0), (2e4, 2.5)];
/// First and last step of the search around the best point, as factors.
const STEPS: [f64; 2] = [2.0, 1.12];
/// Number of points of the grid that are refined.
const STARTS: usize = 3;
/// Maximum number of concurrent filters, which limits the memory.
const TOGETHER: usize = 64;
/// The likelihoods of two filters are compared if the ratio of their numbers of predicted measurements is at least
/// this. A filter that has left the map predicts few measurements.
pub const LEAST_USED: f64 = 0.98;
/// Smallest number of measurements for a search.
pub const FEWEST: usize = 60;
/// Normal deviate of a 95 % interval.
const TWO_SIDED_95: f64 = 1.96;

type NoisePoint = [f64; PARAMETERS];

/// Indices of the parameters of the permanent field.
const PERMANENT: [usize; 2] = [3, 4];
/// Indices of time constants. These parameters have the smallest influence, so their steps are wider.
const TIMES: [usize; 2] = [2, 4];

/// Maximum-likelihood noise of a line; `None` if fewer than [`FEWEST`] measurements are usable.
///
/// # Errors
/// Returns the errors of [`NavigationLine::check`].
pub fn search(search: &NoiseSearch<'_>) -> Result<Option<LineNoise>, NavigationError> {
    search.line.check()?;
    let thinned = ThinnedLine::new(search.line, search.rows);
    let terms = search.aircraft.map(|aircraft| aircraft.at(search.rows)).unwrap_or_default();
    let [latency_sigma_s, map_height_sigma_m] =
        [search.latency_sigma_s, search.map_height_sigma_m].map(|sigma| sigma.filter(|sigma| *sigma > 0.0));
    let (thinned, terms, map_factor) = (&thinned, &terms, 0.0);
    let mut likelihood = NoiseLikelihood { search, thinned, terms, map_factor, latency_sigma_s, map_height_sigma_m };
    let grid = search.grid();
    let scored = likelihood.scores(&grid);
    let most_used = scored.iter().map(|score| score.used).max().unwrap_or(0);
    if most_used < FEWEST {
        return Ok(None);
    }
    let least_used = (LEAST_USED * most_used as f64) as usize;
    let mut order: Vec<usize> = (0..grid.len()).collect();
    order.sort_by(|a, b| scored[*b].log_likelihood(least_used).total_cmp(&scored[*a].log_likelihood(least_used)));
    let mut best = likelihood.best_of(order.iter().take(STARTS).map(|at| grid[*at]), least_used);
    best = likelihood.with_permanent(best, least_used);
    (best, likelihood) = likelihood.with_latency(best, least_used);
    (best, likelihood) = likelihood.with_map_height(best, least_used);
    if search.map_nt.is_some() {
        for map_factor in MAP_FACTORS {
            let other = NoiseLikelihood { map_factor, ..likelihood };
            let found = other.best_of([best.0].into_iter(), least_used);
            if found.1 > best.1 {
                (best, likelihood) = (found, other);
            }
        }
    }
    let output = likelihood.outputs(&[best.0]).pop().and_then(Result::ok).unwrap_or_default();
    let factor = if search.given[0].is_some() { 1.0 } else { correlation_factor(&output) };
    let inflation = factor.sqrt();
    let has_permanent = has_permanent(&best.0);
    let log_likelihood = best.1;
    let [sigma, fogm_sigma, fogm_tau, permanent @ ..] = likelihood.intervals(best, least_used);
    let used = InnovationLikelihood::used(&output);
    let map_factor = likelihood.map_factor;
    Ok(Some(LineNoise {
        sigma_nt: sigma.scaled(inflation),
        fogm_sigma_nt: fogm_sigma,
        fogm_tau_s: fogm_tau,
        permanent: has_permanent.then(|| {
            let [permanent_nt, tau_s] = permanent;
            let is_given = search.given[PERMANENT[1]].is_some();
            [permanent_nt, tau_s.scaled(if is_given { 1.0 } else { 1.0 / factor })]
        }),
        latency_sigma_s: likelihood.latency_sigma_s,
        map_height_sigma_m: likelihood.map_height_sigma_m,
        map_factor: factor * map_factor,
        inflation,
        log_likelihood,
        used,
    }))
}

/// Whether a point has states for the permanent field.
fn has_permanent(point: &NoisePoint) -> bool {
    point[PERMANENT[0]] > 0.0
}

impl NoiseSearch<'_> {
    /// Coarse grid, with one value for given parameters, and no permanent field unless it is given.
    fn grid(&self) -> Vec<NoisePoint> {
        let own = self.given.map(|given| given.map(|value| vec![value]));
        let [permanent_nt, permanent_tau_s] = self.permanent();
        let axes: Vec<&[f64]> = own.iter().zip(GRID).map(|(own, grid)| own.as_deref().unwrap_or(grid)).collect();
        let mut points = vec![];
        for sigma in axes[0] {
            for fogm in axes[1] {
                points.extend(axes[2].iter().map(|tau| [*sigma, *fogm, *tau, permanent_nt, permanent_tau_s]));
            }
        }
        points
    }

    /// Standard deviation and time constant of the permanent field before the search for them.
    fn permanent(&self) -> [f64; 2] {
        let [sigma_nt, tau_s] = PERMANENT.map(|at| self.given[at]);
        [self.direction.and(sigma_nt).unwrap_or(0.0), tau_s.unwrap_or(permanent::USUAL_TAU_S)]
    }

    /// Indices of the free parameters at a point.
    fn free(&self, point: &NoisePoint) -> Vec<usize> {
        let varies = |at: &usize| !PERMANENT.contains(at) || has_permanent(point);
        (0..PARAMETERS).filter(|at| self.given[*at].is_none() && varies(at)).collect()
    }
}

/// Likelihood of a line's innovations as a function of the noise.
#[derive(Clone, Copy)]
struct NoiseLikelihood<'a> {
    search: &'a NoiseSearch<'a>,
    thinned: &'a ThinnedLine,
    /// Terms of the aircraft field at the thinned samples.
    terms: &'a [f64],
    map_factor: f64,
    /// Prior standard deviation of the lag, in seconds; `None` without a state for it.
    latency_sigma_s: Option<f64>,
    /// Prior standard deviation of the height bias, in metres; `None` without a state for it.
    map_height_sigma_m: Option<f64>,
}

/// Logarithm of the likelihood, with the prior, and the number of predicted measurements.
#[derive(Clone, Copy, Debug)]
struct InnovationLikelihood {
    log: f64,
    used: usize,
}

impl InnovationLikelihood {
    /// Number of measurements that a filter predicted.
    fn used(output: &NavigationOutput) -> usize {
        output.report.updates + output.report.gated
    }

    /// Logarithm of the likelihood; -infinity if fewer than `least_used` measurements were used.
    fn log_likelihood(&self, least_used: usize) -> f64 {
        if self.used >= least_used && self.log.is_finite() { self.log } else { f64::NEG_INFINITY }
    }
}

impl<'a> NoiseLikelihood<'a> {
    /// Likelihood with the constant states and the map error of `noise`, which was estimated before.
    fn with_noise(search: &'a NoiseSearch<'a>, thinned: &'a ThinnedLine, terms: &'a [f64], noise: &LineNoise) -> Self {
        let LineNoise { latency_sigma_s, map_height_sigma_m, .. } = *noise;
        Self { search, thinned, terms, map_factor: noise.own_map_factor(), latency_sigma_s, map_height_sigma_m }
    }
}

impl NoiseLikelihood<'_> {
    /// Outputs of filters with these parameters.
    fn outputs(&self, points: &[NoisePoint]) -> Vec<Result<NavigationOutput, NavigationError>> {
        if let Some(aircraft) = self.search.aircraft {
            return points.par_iter().map(|point| self.output_with_aircraft(&aircraft, point)).collect();
        }
        if self.has_constants() || points.iter().any(has_permanent) {
            return points
                .par_iter()
                .map(|point| self.output_with_states(point).map(|output| output.navigation))
                .collect();
        }
        let line = self.search.line;
        let ins = self.thinned.ins();
        let mut outputs = vec![];
        for some in points.chunks(TOGETHER) {
            let parameters: Vec<EkfParameters> = some.iter().map(|point| parameters(line, *point)).collect();
            let sigma_nt: Vec<Vec<f64>> = some.iter().map(|point| self.sigma_nt(point)).collect();
            let filters: Vec<EkfInput> = parameters
                .iter()
                .zip(&sigma_nt)
                .map(|(parameters, sigma_nt)| EkfInput {
                    parameters,
                    measurement_nt: &self.thinned.measurement_nt,
                    sigma_nt: Some(sigma_nt),
                    fixes: self.thinned.fixes.as_ref(),
                    map: line.map,
                    core: line.core,
                })
                .collect();
            outputs.extend(run_together(&ins, &filters));
        }
        outputs
    }

    /// Standard deviation of each thinned measurement for the parameters of a point, in nT.
    fn sigma_nt(&self, [sigma_nt, ..]: &NoisePoint) -> Vec<f64> {
        let NoiseSearch { scale, known_nt, map_nt, .. } = *self.search;
        let of = |row: &usize| {
            let known = known_nt.map_or(0.0, |known| known[*row]);
            let map = map_nt.map_or(0.0, |map| self.map_factor.sqrt() * map[*row]);
            (sigma_nt * scale[*row]).hypot(known).hypot(if map.is_finite() { map } else { 0.0 })
        };
        self.search.rows.iter().map(of).collect()
    }

    /// Thinned line with the process of a point.
    fn line_at<'b>(&'b self, point: &NoisePoint, ins: &'b InsSeries<'b>, sigma_nt: &'b [f64]) -> NavigationLine<'b> {
        let [_, fogm_sigma_nt, fogm_tau_s, ..] = *point;
        let line = self.search.line;
        NavigationLine {
            ins,
            measurement_nt: &self.thinned.measurement_nt,
            sigma_nt,
            fixes: self.thinned.fixes.as_ref(),
            errors: InsErrorModel { fogm_sigma_nt, fogm_tau_s, ..line.errors },
            ..*line
        }
    }

    /// The point with each parameter within its range. A permanent field of 0 has no states.
    fn within_ranges(&self, point: NoisePoint) -> NoisePoint {
        let limited = |at: usize| {
            let [low, high] = RANGES[at];
            if self.search.given[at].is_some() || point[at] == 0.0 { point[at] } else { point[at].clamp(low, high) }
        };
        std::array::from_fn(limited)
    }

    fn scores(&self, points: &[NoisePoint]) -> Vec<InnovationLikelihood> {
        let outputs = self.outputs(points);
        points.iter().zip(&outputs).map(|(point, output)| self.score(point, output)).collect()
    }

    fn score(&self, point: &NoisePoint, output: &Result<NavigationOutput, NavigationError>) -> InnovationLikelihood {
        let Ok(output) = output else { return InnovationLikelihood { log: f64::NEG_INFINITY, used: 0 } };
        let mut sum = 0.0;
        for (residual_nt, nis) in output.residual_nt.iter().zip(&output.nis) {
            sum += deviance(*residual_nt, *nis, GATE_NIS).unwrap_or(0.0);
        }
        for (at, (centre, sd)) in PRIOR.iter().enumerate() {
            if self.search.given[at].is_none() && (!PERMANENT.contains(&at) || has_permanent(point)) {
                sum += ((point[at] / centre).ln() / sd).powi(2);
            }
        }
        InnovationLikelihood { log: -0.5 * sum, used: InnovationLikelihood::used(output) }
    }

    /// Best point reached from the given starts, and its log-likelihood.
    fn best_of(&self, starts: impl Iterator<Item = NoisePoint>, least_used: usize) -> (NoisePoint, f64) {
        let climbed = starts.map(|start| self.climbed(start, least_used));
        climbed.fold(([f64::NAN; PARAMETERS], f64::NEG_INFINITY), |best, one| {
            if one.1 > best.1 || best.0[0].is_nan() { one } else { best }
        })
    }

    /// Best point, found by steps to the best neighbour. The steps shrink if no neighbour is better.
    fn climbed(&self, start: NoisePoint, least_used: usize) -> (NoisePoint, f64) {
        let mut now = start;
        let mut best = self.scores(&[now])[0].log_likelihood(least_used);
        let mut factor = STEPS[0];
        while factor > STEPS[1] {
            let around = self.around(now, factor);
            let scores = self.scores(&around);
            let found = around.iter().zip(&scores).map(|(point, score)| (*point, score.log_likelihood(least_used)));
            let (point, log) = found.fold((now, best), |best, one| if one.1 > best.1 { one } else { best });
            // Smaller gains are ignored, to avoid many small steps.
            if log > best + 0.05 {
                (now, best) = (point, log);
            } else {
                factor = factor.sqrt();
            }
        }
        (now, best)
    }

    /// Neighbours of a point: each free parameter one step down, unchanged, or one step up. With further states only
    /// one parameter changes at a time, because a filter with these states takes longer.
    fn around(&self, point: NoisePoint, factor: f64) -> Vec<NoisePoint> {
        let free = self.search.free(&point);
        let is_slow = self.has_constants() || has_permanent(&point);
        let together: Vec<&[usize]> = if is_slow { free.chunks(1).collect() } else { vec![&free] };
        together.into_iter().flat_map(|parameters| Self::grid_around(point, factor, parameters)).collect()
    }

    /// All points with each of these parameters one step down, unchanged, or one step up, except the point itself.
    fn grid_around(point: NoisePoint, factor: f64, parameters: &[usize]) -> Vec<NoisePoint> {
        let mut points = vec![point];
        for at in parameters.iter().copied() {
            let factor = if TIMES.contains(&at) { factor * factor } else { factor };
            let [low, high] = RANGES[at];
            let moved = points.iter().flat_map(|point| {
                [1.0 / factor, factor].map(|by| {
                    let mut moved = *point;
                    moved[at] = (moved[at] * by).clamp(low, high);
                    moved
                })
            });
            let moved: Vec<NoisePoint> = moved.collect();
            points.extend(moved);
        }
        points.retain(|other| *other != point);
        points
    }

    /// Parameters with their 95 % intervals, from the curvature of the likelihood along each.
    fn intervals(&self, (point, best): (NoisePoint, f64), least_used: usize) -> [IntervalEstimate; PARAMETERS] {
        const FACTOR: f64 = 1.4;
        let mut estimates = point.map(|value| IntervalEstimate { value, low: value, high: value });
        for at in self.search.free(&point) {
            let [low, high] = RANGES[at];
            let ends = [1.0 / FACTOR, FACTOR].map(|by| {
                let mut moved = point;
                moved[at] *= by;
                moved
            });
            let fall: f64 =
                self.scores(&ends).iter().map(|score| (best - score.log_likelihood(least_used)).max(0.0)).sum();
            let sd = if fall.is_finite() { FACTOR.ln() / fall.max(1e-6).sqrt() } else { FACTOR.ln() };
            let by = (TWO_SIDED_95 * sd).exp();
            estimates[at].low = (point[at] / by).max(low);
            estimates[at].high = (point[at] * by).min(high);
        }
        estimates
    }
}

/// -2 ln p of an innovation, without the constant of p and with the NIS limited to `most_nis`. `None` if the innovation
/// is exactly 0, because its variance is then undetermined.
pub(super) fn deviance(residual: f64, nis: f64, most_nis: f64) -> Option<f64> {
    let variance = residual * residual / nis;
    (nis.is_finite() && variance.is_finite() && variance > 0.0).then(|| variance.ln() + nis.min(most_nis))
}

/// Normalised innovations of a filter; NaN for those beyond the gate.
fn accepted_innovations(output: &NavigationOutput) -> Vec<f64> {
    let all = normalised_innovations(&output.residual_nt, &output.nis);
    all.iter().zip(&output.nis).map(|(own, nis)| if *nis <= GATE_NIS { *own } else { f64::NAN }).collect()
}

/// Statistical inefficiency of the normalised innovations; at least 1, and 1 if the correlation is insignificant.
fn correlation_factor(output: &NavigationOutput) -> f64 {
    const SMALLEST: f64 = 1.3;
    let mut accepted = accepted_innovations(output);
    accepted.retain(|innovation| innovation.is_finite());
    let factor = statistical_inefficiency(&accepted);
    if factor >= SMALLEST { factor } else { 1.0 }
}

fn parameters(line: &NavigationLine<'_>, [sigma_nt, fogm_sigma_nt, fogm_tau_s, ..]: NoisePoint) -> EkfParameters {
    EkfParameters {
        errors: InsErrorModel { fogm_sigma_nt, fogm_tau_s, ..line.errors },
        measurement_sigma_nt: sigma_nt,
        offset_window_s: line.offset_window_s,
        second_order: line.second_order,
        gate_nis: Some(GATE_NIS),
        keep_states: false,
        keep_covariance: false,
    }
}

#[cfg(test)]
mod tests;
