//! Smoother that follows the filter: the most probable track of the whole flight, given all measurements of the flight.
//!
//! | Module | Contents |
//! |:--|:--|
//! | [`motion`] | the error of the INS over the line in a basis of few functions of time |
//! | [`thin`] | selection of the measurements |
//! | [`likelihood`] | their likelihood given the path, and its derivatives |
//! | [`search`] | the most probable path, and the kernel of maximum likelihood |
//! | [`evidence`](mod@evidence) | the test whether the measurements of two visits agree |
//!
//! # Equations
//!
//! The position error over the line is Gaussian, with the covariance of all steps, x ← Φ x + w. The position error is
//! written as δ = B u with u ~ N(0, I) ([`motion::PositionErrorBasis`]). The map is not a state: given the path p =
//! p_ins + B u, the measurements are jointly Gaussian [Lawrence 2003],
//!
//! ```text
//! z ~ N(μ, C(p)),    C = K(p, p) + σ_S² exp(−|t − t'|/τ) + R
//! ```
//!
//! with the kernel K of the anomaly. The smoother minimises
//!
//! ```text
//! J(u) = (z − μ)ᵀ C⁻¹ (z − μ)/2 + log |C|/2 + uᵀu/2
//! ```
//!
//! Since the map is integrated out, J depends only on the relative positions of the parts of the flight. Errors that no
//! revisit observes therefore have the covariance of the INS. In contrast, a map linearised about an estimate, f + g·δ,
//! would fix a common shift of all positions. Gradient and matrix of second derivatives are exact. The step is a Newton
//! step without the negative curvatures of the likelihood, halved until J does not rise. The covariance of u is the
//! inverse of the matrix of second derivatives at the optimum (Laplace approximation). It is computed with the slopes
//! of the estimated field instead of the slopes expected from the kernel. If the hyper-parameters are fitted, each pass
//! begins with a Fisher-scoring step for them by the same likelihood.
//!
//! Aiding positions are measurements of δ, which add a quadratic form in u. With a gate, the measurements that the
//! filter rejected are skipped; outliers of the leave-one-out residuals are also removed, once.
//!
//! J may have several optima. Three searches with half of the measurements are made, and the search with the lowest J
//! is selected. The first starts from the path of the filter (the mean of the particles' histories). The second starts
//! from the same path with a large white part of the kernel, which widens the valleys of J and is reduced during the
//! fit. The third starts from the INS, which is initially exact, and adds the flight part by part, so that each part is
//! predicted from the earlier parts. If the measurements of revisits contradict each other on the best track
//! ([`evidence`](mod@evidence)), four more searches are made with smaller parts or wider valleys. The best search is
//! continued with all measurements. The result is used only if it is more probable than the path of the filter.
//!
//! # Cost
//!
//! With n measurements a pass takes about 15 n³ multiplications on all threads and 70 n² bytes of memory. Each step
//! takes 5 kB for the states and 16 bytes per function. About ten passes are needed; each pass of the first searches
//! takes an eighth of that time. 1000 measurements take about 20 s on one core.

pub mod evidence;
pub mod likelihood;
pub mod motion;
mod normal;
pub mod search;
pub mod thin;

use faer::{Mat, MatRef, Side};

use super::kernel::AnomalyKernel;
use super::output::{PathSample, SlamOutput};
use super::samples::{LocalFrame, SlamLine, SlamSample};
use crate::navigation::ins_error::{ParameterError, require};
use crate::navigation::output::Innovation;
use crate::navigation::pinson::{LAT, LON, STATES};
use crate::navigation::{NavigationError, NavigationOutput};
use evidence::evidence;
use likelihood::{SlamMeasurement, SlamProblem};
use motion::{InsErrorTransitions, PositionErrorBasis};
use normal::{near, prior_of, problem_of, solved};
use params::Rule;
use search::{SlamSearch, SlamSearchParameters, SlamWeightPrior};
use thin::thinned;

/// Standard deviation of the position error that the basis of the motion may omit, in metres.
const LACKING_M: f64 = 0.05;
/// Standard deviation of the initial deviation from the path of the filter, in metres.
const START_M: f64 = 5.0;
/// White part of the kernel, in standard deviations of the anomaly, for a start with a wide valley.
const WIDE: f64 = 0.3;
/// Number of parts of the flight for a start that adds the parts one by one.
const PARTS: usize = 10;
/// Number of starts for every flight; further starts are used only if these give a poor result.
const USUAL_STARTS: usize = 3;
/// Value of [`SlamSmootherReport::agreement`] below which a track is implausible.
pub const CONTRADICTED: f64 = 0.5;
/// Agreement below which more starts are tried.
const DOUBTFUL: f64 = 0.9;
/// Minimum number of measurements for comparing starts.
const FEWEST: usize = 100;
/// Maximum length of a fitted kernel, as a fraction of the path.
const LONGEST: f64 = 0.5;

/// Parameters of the smoother.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlamSmootherParameters {
    /// Maximum number of measurements. Computing time grows with the third power of this number.
    pub measurements: usize,
    /// Factor on the standard deviations of the measurements.
    pub noise_factor: f64,
    /// Maximum number of linearisations.
    pub passes: usize,
    /// Position change of a measurement, in metres, below which the search ends.
    pub tolerance_m: f64,
}

impl Default for SlamSmootherParameters {
    fn default() -> Self {
        Self { measurements: 1000, noise_factor: 1.0, passes: 40, tolerance_m: 0.1 }
    }
}

impl SlamSmootherParameters {
    /// Rejects invalid parameters.
    ///
    /// # Errors
    /// Fails for a number of measurements that is not between 2 and 5000, for zero passes, or for a factor or tolerance
    /// that is not above 0.
    pub fn check(&self) -> Result<(), ParameterError> {
        require("measurements", self.measurements as f64, Rule::Between(2.0, 5000.0))?;
        require("noise_factor", self.noise_factor, Rule::Positive)?;
        require("passes", self.passes as f64, Rule::Between(1.0, 1000.0))?;
        require("tolerance_m", self.tolerance_m, Rule::Positive)
    }
}

/// Report on the smoother.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlamSmootherReport {
    /// Number of measurements used.
    pub measurements: usize,
    /// Number of functions of the motion.
    pub functions: usize,
    /// Number of linearisations.
    pub passes: usize,
    /// Whether path and kernel have converged.
    pub converged: bool,
    /// Largest change of the position of a measurement in the last step, in metres.
    pub last_step_m: f64,
    /// Final kernel.
    pub kernel: AnomalyKernel,
    /// (z − μ)ᵀ C⁻¹ (z − μ) over the number of measurements: 1 if the assumed noise is correct.
    pub misfit: f64,
    /// See [`evidence::RevisitEvidence::agreement`]; below [`CONTRADICTED`] the track is lost.
    pub agreement: f64,
    /// Final J, up to a constant of the flight.
    pub cost: f64,
    /// Decrease of J relative to the path of the filter.
    pub fall: f64,
}

/// Results of the filter that the smoother uses.
pub(super) struct SlamFilterResult<'a> {
    pub(super) line: &'a SlamLine<'a>,
    /// Last rows of the steps.
    pub(super) ends: &'a [usize],
    pub(super) frame: LocalFrame,
    pub(super) kernel: AnomalyKernel,
    /// Whether the filter fitted the kernel; if so, the smoother continues the fit.
    pub(super) fits: bool,
    /// Largest squared leave-one-out residual of a measurement over its variance; measurements with larger values are
    /// rejected.
    pub(super) gate_nis: Option<f64>,
    /// Samples, each with a flag that is true if the sample is used.
    pub(super) samples: &'a [(SlamSample, bool)],
}

/// Most probable track of a line.
struct SlamTrack {
    motion: InsErrorTransitions,
    functions: PositionErrorBasis,
    weights: Vec<f64>,
    /// Factor of the weights' covariance.
    root: Mat<f64>,
    report: SlamSmootherReport,
}

/// Replaces track and path of a filter's output by the smoothed track and path; the innovations of the filter remain.
/// Returns false without changes if there is no smoothed track: fewer than two measurements, or a covariance that is
/// numerically not positive.
///
/// # Errors
/// Fails with [`NavigationError::Diverged`] if the covariance of the INS is not finite.
pub(super) fn smooth(
    parameters: &SlamSmootherParameters,
    of: &SlamFilterResult<'_>,
    out: &mut SlamOutput,
) -> Result<bool, NavigationError> {
    let Some(smoothed) = SlamTrack::solve(parameters, of, &out.path)? else { return Ok(false) };
    smoothed.replace(of, out);
    Ok(true)
}

impl SlamTrack {
    fn solve(
        parameters: &SlamSmootherParameters,
        of: &SlamFilterResult<'_>,
        path: &[PathSample],
    ) -> Result<Option<Self>, NavigationError> {
        let motion = InsErrorTransitions::along(of.line, of.ends, &of.frame)?;
        let functions = motion.functions(LACKING_M);
        let used: Vec<(SlamSample, [f64; 2])> = of
            .samples
            .iter()
            .zip(path)
            .filter(|((_, used), _)| *used)
            .map(|((sample, _), path)| {
                let variance_nt2 = sample.variance_nt2 * parameters.noise_factor.powi(2);
                let moved = [0, 1].map(|axis: usize| path.at_m[axis] - sample.at_m[axis]);
                (SlamSample { variance_nt2, ..*sample }, moved)
            })
            .collect();
        let prior = prior_of(&motion, &functions, of.line);
        let known = SlamSmootherContext { motion: &motion, functions: &functions, prior: &prior, of, parameters };
        let thin = thinned(&used, &of.kernel, parameters.measurements);
        let Some(start) = known.best_start(&used, &thin) else { return Ok(None) };
        let Some((weights, root, report)) = known.searched(thin, start) else { return Ok(None) };
        Ok(Some(Self { weights, motion, functions, root, report }))
    }

    /// Factors of the position covariance at a step, north and east: the basis functions times the factor of the
    /// weights' covariance.
    fn factors(&self, step: usize) -> [Vec<f64>; 2] {
        [0, 1].map(|axis| {
            let b = self.functions.at(step, axis);
            let of = self.root.transpose() * MatRef::from_column_major_slice(b, b.len(), 1);
            (0..b.len()).map(|k| of[(k, 0)]).collect()
        })
    }

    fn replace(self, of: &SlamFilterResult<'_>, out: &mut SlamOutput) {
        let (ins, earth, per) = (of.line.ins, of.line.errors.earth, of.frame.m_per_rad);
        let states = self.motion.states(&self.functions, &self.weights);
        let factors: Vec<[Vec<f64>; 2]> = (0..self.motion.steps()).map(|step| self.factors(step)).collect();
        let at = |tt_s: f64| {
            let between = self.motion.between(tt_s);
            let next = if between.part > 0.0 { between.step + 1 } else { between.step };
            let mix = |a: f64, b: f64| a + between.part * (b - a);
            let x: [f64; STATES] = std::array::from_fn(|state| mix(states[between.step][state], states[next][state]));
            let (here, there) = (&factors[between.step], &factors[next]);
            let mut p_m2 = [0.0; 3];
            for ((hn, tn), (he, te)) in here[0].iter().zip(&there[0]).zip(here[1].iter().zip(&there[1])) {
                let (north, east) = (mix(*hn, *tn), mix(*he, *te));
                p_m2[0] += north * north;
                p_m2[1] += east * east;
                p_m2[2] += north * east;
            }
            for (p, lacking) in p_m2.iter_mut().zip(self.functions.lacking_m2[between.step]) {
                *p += lacking;
            }
            (x, p_m2)
        };
        let before = std::mem::take(&mut out.navigation);
        let mut navigation = NavigationOutput::with_capacity(ins.len(), !before.x.is_empty(), false);
        for (row, (residual_nt, nis)) in before.residual_nt.iter().zip(&before.nis).enumerate() {
            let (x, p_m2) = at(ins.tt_s[row]);
            let p = |row: usize, column: usize| match (row, column) {
                (LAT, LAT) => p_m2[0] / (per[0] * per[0]),
                (LON, LON) => p_m2[1] / (per[1] * per[1]),
                _ => p_m2[2] / (per[0] * per[1]),
            };
            let innovation = Innovation { residual_nt: *residual_nt, nis: *nis };
            navigation.push(ins, row, |state| x[state], p, innovation, earth);
        }
        navigation.report = before.report;
        out.navigation = navigation;
        for (path, (sample, _)) in out.path.iter_mut().zip(of.samples) {
            let (x, p_m2) = at(path.tt_s);
            let moved = [x[LAT] * per[0], x[LON] * per[1]];
            path.at_m = [0, 1].map(|axis: usize| sample.at_m[axis] + moved[axis]);
            (path.lat_deg, path.lon_deg) = of.frame.lat_lon_deg(path.at_m);
            path.spread_m = (p_m2[0] + p_m2[1]).sqrt();
            let core_nt: f64 = sample.core_nt_per_m.iter().zip(moved).map(|(slope, moved)| slope * moved).sum();
            path.value_nt = sample.value_nt - core_nt;
        }
        let square = |step: usize| {
            let ([a, c, b], x) = (self.motion.alone_m2(step), &states[step]);
            // The position of an INS may be exact at the start.
            let [a, c] = [a, c].map(|variance| variance + LACKING_M * LACKING_M);
            let (north, east) = (x[LAT] * per[0], x[LON] * per[1]);
            (c * north * north - 2.0 * b * north * east + a * east * east) / (a * c - b * b)
        };
        out.report.largest_correction = (0..self.motion.steps()).map(square).fold(0.0, f64::max);
        out.report.kernel = self.report.kernel;
        out.report.smoother = Some(self.report);
    }
}

/// Measurement, and the displacement of its position according to the filter, north and east, in metres.
type DisplacedMeasurement = (SlamMeasurement, [f64; 2]);

/// Initial weights and kernel of a search.
type SlamInitialGuess = (Vec<f64>, AnomalyKernel);

/// Starting point of the search with all measurements.
struct SlamSearchStart {
    weights: Vec<f64>,
    kernel: AnomalyKernel,
    /// J of the path of the filter with all used measurements.
    filtered_cost: f64,
}

/// Motion model, prior and filter results that all searches of a line share.
struct SlamSmootherContext<'a> {
    motion: &'a InsErrorTransitions,
    functions: &'a PositionErrorBasis,
    prior: &'a SlamWeightPrior,
    of: &'a SlamFilterResult<'a>,
    parameters: &'a SlamSmootherParameters,
}

impl<'a> SlamSmootherContext<'a> {
    fn rules(&self, problem: &SlamProblem) -> SlamSearchParameters {
        let path_m: f64 = problem.measured.windows(2).map(step_m).sum();
        let spacing_m = path_m / problem.measured.len().saturating_sub(1).max(1) as f64;
        SlamSearchParameters {
            passes: self.parameters.passes,
            tolerance_m: self.parameters.tolerance_m,
            fits: self.of.fits && spacing_m > 0.0,
            lengths_m: (spacing_m, (LONGEST * path_m).max(spacing_m)),
        }
    }

    fn problem(&self, thin: &[DisplacedMeasurement]) -> SlamProblem {
        problem_of(thin, self.motion, self.functions, self.of)
    }

    /// Best of several starts, judged by the optimum with half of the measurements. If visits contradict each other at
    /// that optimum, more starts are tried.
    fn best_start(&self, used: &[(SlamSample, [f64; 2])], thin: &[DisplacedMeasurement]) -> Option<SlamSearchStart> {
        if thin.len() < 2 || self.functions.count == 0 {
            return None;
        }
        let all = self.problem(thin);
        let moved: Vec<[f64; 2]> = thin.iter().map(|(_, moved)| *moved).collect();
        let filtered = near(&all, self.prior, &moved)?;
        let narrow = self.of.kernel;
        let filtered_cost = SlamSearch::from(&all, self.prior, self.rules(&all), filtered.clone(), narrow)?.cost();
        let wide = AnomalyKernel { sigma_n_nt: narrow.sigma_n_nt.max(WIDE * narrow.sigma_se_nt), ..narrow };
        let measured = thinned(used, &narrow, thin.len().div_ceil(2).max(FEWEST));
        let few = self.problem(&measured);
        let grown = |parts: usize, kernel: AnomalyKernel| -> Option<SlamInitialGuess> {
            Some((self.grown(&measured, parts, kernel)?, narrow))
        };
        let starts: [&dyn Fn() -> Option<SlamInitialGuess>; 7] = [
            &|| Some((filtered.clone(), narrow)),
            &|| Some((filtered.clone(), wide)),
            &|| grown(PARTS, narrow),
            &|| grown(2 * PARTS, narrow),
            &|| grown(4 * PARTS, narrow),
            &|| grown(PARTS, wide),
            &|| grown(2 * PARTS, wide),
        ];
        let mut best: Option<(SlamSearch<'_>, f64)> = None;
        for (place, start) in starts.into_iter().enumerate() {
            let doubtful = |(_, agreement): &(SlamSearch<'_>, f64)| *agreement < DOUBTFUL;
            if place >= USUAL_STARTS && !best.as_ref().is_none_or(doubtful) {
                break;
            }
            let Some((weights, kernel)) = start() else { continue };
            let Some(search) = self.settled(&few, weights, kernel) else { continue };
            if best.as_ref().is_none_or(|(best, _)| search.cost() < best.cost()) {
                let agreement = self.agreement(&few, &search).unwrap_or(0.0);
                best = Some((search, agreement));
            }
        }
        let found = best.map(|(best, _)| SlamSearchStart { weights: best.weights, kernel: best.kernel, filtered_cost });
        Some(found.unwrap_or(SlamSearchStart { weights: filtered, kernel: narrow, filtered_cost }))
    }

    /// Search from a start to its optimum. If the kernel is not fitted and `kernel` differs from the given kernel,
    /// `kernel` is used only in a first search, and a second search uses the given kernel.
    fn settled<'p>(
        &'p self,
        problem: &'p SlamProblem,
        weights: Vec<f64>,
        kernel: AnomalyKernel,
    ) -> Option<SlamSearch<'p>> {
        let rules = self.rules(problem);
        let mut search = SlamSearch::from(problem, self.prior, rules, weights, kernel)?;
        if !rules.fits && kernel != self.of.kernel {
            search.run()?;
            search = SlamSearch::from(problem, self.prior, rules, search.weights, self.of.kernel)?;
        }
        search.run()?;
        Some(search)
    }

    /// See [`evidence::RevisitEvidence::agreement`]; `None` if a covariance is not positive.
    fn agreement(&self, problem: &SlamProblem, search: &SlamSearch<'_>) -> Option<f64> {
        Some(evidence(problem, self.prior, self.rules(problem), search)?.agreement())
    }

    /// Weights from a search that starts with the measurements of the first part of the flight and adds the next part
    /// after each convergence. The most probable weights of one part predict the path of the next.
    fn grown(&self, measured: &[DisplacedMeasurement], parts: usize, kernel: AnomalyKernel) -> Option<Vec<f64>> {
        let mut weights = solved(&self.prior.information, &self.prior.force)?;
        for part in 1..=parts {
            let known = (measured.len() * part).div_ceil(parts);
            let problem = self.problem(measured.get(..known)?);
            let rules = SlamSearchParameters { fits: false, ..self.rules(&problem) };
            let mut search = SlamSearch::from(&problem, self.prior, rules, weights, kernel)?;
            search.run()?;
            weights = search.weights;
        }
        Some(weights)
    }

    /// Optimum from a start, with the factor of the covariance; `None` if J stays above the J of the filter's path, or
    /// if a covariance is not positive.
    fn searched(
        &self,
        mut thin: Vec<DisplacedMeasurement>,
        start: SlamSearchStart,
    ) -> Option<(Vec<f64>, Mat<f64>, SlamSmootherReport)> {
        let SlamSearchStart { mut weights, mut kernel, filtered_cost } = start;
        let mut may_gate = self.of.gate_nis;
        let (mut passes, mut fall) = (0, None);
        loop {
            if thin.len() < 2 {
                return None;
            }
            let problem = self.problem(&thin);
            let mut search = SlamSearch::from(&problem, self.prior, self.rules(&problem), weights, kernel)?;
            search.run()?;
            passes += search.passes;
            let fall = *fall.get_or_insert(filtered_cost - search.cost());
            // The comparison is also false for NaN.
            let better = fall >= 0.0;
            if !better {
                return None;
            }
            let gate = may_gate.take();
            if let Some(gate) = gate
                && without_outliers(&mut thin, &search.left_out(), gate)
            {
                (weights, kernel) = (search.weights, search.kernel);
                continue;
            }
            let root = search.covariance()?.llt(Side::Lower).ok()?.L().to_owned();
            let report = SlamSmootherReport {
                measurements: problem.measured.len(),
                functions: self.functions.count,
                passes,
                converged: search.converged,
                last_step_m: search.last_step_m,
                kernel: search.kernel,
                misfit: search.misfit(),
                agreement: self.agreement(&problem, &search)?,
                cost: search.cost(),
                fall,
            };
            return Some((search.weights, root, report));
        }
    }
}

/// Removes measurements whose squared residual exceeds the gate; false if there are no such measurements.
fn without_outliers(thin: &mut Vec<DisplacedMeasurement>, squares: &[f64], gate: f64) -> bool {
    let before = thin.len();
    let mut squares = squares.iter();
    thin.retain(|_| squares.next().is_none_or(|square| *square <= gate));
    thin.len() < before
}

fn step_m(pair: &[SlamMeasurement]) -> f64 {
    (pair[1].at_m[0] - pair[0].at_m[0]).hypot(pair[1].at_m[1] - pair[0].at_m[1])
}

#[cfg(test)]
mod tests;
