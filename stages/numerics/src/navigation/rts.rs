//! Fixed-interval smoother of a whole line, iterated to the most probable trajectory.
//!
//! States, measurements and steps are the same as in `ekf`. The most probable trajectory x₀ … x_n minimises
//!
//! ```text
//! J = x₀ᵀ P₀⁻¹ x₀/2 + Σ wₖᵀ Qₖ⁻¹ wₖ/2 + Σ ρ(rₖ),      wₖ = xₖ - Φₖ xₖ₋₁,      rₖ = (zₖ - h(xₖ))/σₖ
//! ```
//!
//! where ρ(r) is r²/2 or a [robust loss](TrajectoryLoss). The Gauss-Newton iteration linearises the map along the whole
//! last trajectory x̄. A forward and a backward pass of the Kalman filter then solve the linear problem exactly. This
//! is the iterated extended Kalman smoother [Bell 1994; Särkkä & Svensson 2023, chapter 13]. The first pass linearises
//! the map as in `iekf`, at the most probable state after each measurement. A robust loss is solved as a least-squares
//! problem with variances σ²/w(r). The weights w(r) = ρ'(r)/r come from the last trajectory (iteratively reweighted
//! least squares [Holland & Welsch 1977]). In the first pass, r is the innovation over its standard deviation. If J of
//! the first trajectory exceeds 1 per measurement, three alternatives are computed: without weights, with one
//! linearisation, and with ten times the noise. The iteration continues from the trajectory with the lowest J. If a
//! step from x̄ to the solution x̂ would raise J, it is halved until J does not rise.
//!
//! # The backward pass
//!
//! Each pass is the modified Bryson-Frazier smoother [Bierman 1973]. A measurement has the innovation ν, the variance s
//! of the innovation, and the gain K. The adjoint state λ and its matrix Λ propagate backwards from 0 after the last
//! sample:
//!
//! ```text
//! u = ν/s + Kᵀ λ,     λ ← λ - Hᵀ u,     Λ ← (I - K H)ᵀ Λ (I - K H) + Hᵀ H/s       through a measurement
//! λ ← Φᵀ λ,           Λ ← Φᵀ Λ Φ                                                  through a step
//! x̂ = x - P λ,        P̂ = P - P Λ P                                               from the filtered x and P
//! ```
//!
//! Neither Q nor a predicted covariance is inverted. States without process noise or initial uncertainty, and units of
//! 1e-17 rad² together with 1 m², are therefore admissible. The pass also yields J. The first two terms of J are half a
//! quadratic form of the trajectory. The process noise of the trajectory is -Qₖ λₖ with the λ before the measurement of
//! k, and x₀ = -P₀ λ₀. The products of the solution with itself and with any trajectory are therefore sums over the
//! measurements, ⟨x̂, x̂⟩ = Σ uₖ Hₖ x̂ₖ and ⟨x̄, x̂⟩ = Σ uₖ Hₖ x̄ₖ, which require only the recursion of λ. Evaluating J
//! along a step requires one map value per sample.
//!
//! # Memory
//!
//! The forward pass stores its state every 64 samples, and the backward pass recomputes the 64 samples in between. A
//! sample takes about 0.8 kB, and a line of 100,000 samples 80 MB; storing all covariances would take 260 MB.
//!
//! # Irregularities
//!
//! - a measurement that is NaN or infinite, or whose sigma is not above 0: not used, `residual` and `nis` are NaN;
//! - a linearisation point off the map or in an unknown cell: the measurement counts as missing in that pass. J of two
//!   trajectories is compared over the measurements that have a map value on both;
//! - a flat map: without a core field, only S is estimated; with one, the slope of the core field also corrects the
//!   position;
//! - an INS value that is not finite, time that does not ascend, a state or variance that is not finite, or a negative
//!   variance: an error with the row;
//! - an iteration that ends before the step is below the tolerance: the trajectory of the lowest J is returned, and
//!   [`RtsReport::converged`] is false.

pub(in crate::navigation) mod adjoint;
mod aided;
mod pass;

pub use aided::{AidedRtsOutput, run_aided};

use crate::earth::field_value::FieldValue;
use crate::navigation::field::PredictedField;
use crate::navigation::ins_error::ParameterError;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{NavigationError, NavigationOutput};
use crate::navigation::pinson::{ALT, LAT, LON, S, StateVector};
use crate::navigation::position_fixes::StateFix;
use params::{Rule, obeys};

use crate::navigation::loss::{RobustLoss, TrajectoryLoss};
use pass::{FirstPass, RtsLinearisation, RtsSolution, SmootherPass};

/// Maximum number of halvings of a step.
const MOST_HALVINGS: u32 = 10;
/// Alternative first passes. Weights from innovations fail if the initial error is too large for the map. A pass
/// without weights fails with outliers. Iterating single measurements finds the nearest minimum; a single linearisation
/// sometimes finds another minimum. With ten times the noise, the whole line determines the start instead of the first
/// measurements.
const STARTS: [FirstPass; 4] = [
    FirstPass { iterations: 5, robust: true, sigma_factor: 1.0 },
    FirstPass { iterations: 5, robust: false, sigma_factor: 1.0 },
    FirstPass { iterations: 1, robust: true, sigma_factor: 1.0 },
    FirstPass { iterations: 5, robust: false, sigma_factor: 10.0 },
];
/// A first trajectory is poor if its J per measurement exceeds this value; normally distributed residuals give 0.5.
const POOR_COST: f64 = 1.0;
/// Decrease of J that is negligible: it changes the probability of the trajectory by 1 %.
const SMALL_FALL: f64 = 0.01;
/// If J no longer decreases, the iteration may end after a step of at most this number of standard deviations.
const SMALL_STEP_SIGMAS: f64 = 0.5;

/// Parameters of the smoother.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RtsParameters {
    /// Maximum number of passes over the line, at least 1. One pass is the extended Kalman smoother.
    pub iterations: usize,
    /// Largest position change, in metres, below which the iteration ends.
    pub tolerance_m: f64,
    /// Loss of a residual.
    pub loss: TrajectoryLoss,
    /// Residual, in standard deviations, above which a robust loss is no longer quadratic; `None` is
    /// [`TrajectoryLoss::usual_scale`].
    pub loss_scale: Option<f64>,
    /// Returns the error states of every sample.
    pub keep_states: bool,
    /// Returns the covariance of every sample (2.6 kB each).
    pub keep_covariance: bool,
}

impl Default for RtsParameters {
    fn default() -> Self {
        Self {
            iterations: 20,
            tolerance_m: 0.1,
            loss: TrajectoryLoss::default(),
            loss_scale: None,
            keep_states: true,
            keep_covariance: false,
        }
    }
}

impl RtsParameters {
    /// Rejects invalid parameters.
    ///
    /// # Errors
    /// Fails for `iterations` of 0, or for a tolerance or scale that is not a finite number above 0.
    pub fn check(&self) -> Result<(), ParameterError> {
        obeys(&self.iterations, "iterations", Rule::Positive).map_err(ParameterError)?;
        obeys(&self.tolerance_m, "tolerance_m", Rule::Positive).map_err(ParameterError)?;
        self.loss_scale.map_or(Ok(()), |scale| obeys(&scale, "loss_scale", Rule::Positive).map_err(ParameterError))
    }
}

/// Report on the iteration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RtsReport {
    /// Number of passes over the line, each forward and backward.
    pub passes: usize,
    /// Number of halved steps.
    pub halved: usize,
    /// Whether the iteration converged. Convergence has two criteria. The last full step was below the tolerance; or it
    /// was below half a standard deviation of every state, did not lower J, and its halvings changed J by less than
    /// 0.01. The second case is common on a bilinear map: its slope jumps between the nodes, and J has an edge at the
    /// minimum.
    pub converged: bool,
    /// Largest change of a position of the line in the last full step, in metres; infinite after a single pass, which
    /// has no step. Without convergence, it estimates the distance of the trajectory from the most probable trajectory.
    pub last_step_m: f64,
    /// Last full step in standard deviations: no state of the line, and no combination of states, changes by more than
    /// this number of its own standard deviations. It is the square root of twice the decrease of J predicted by the
    /// linear problem (the Newton decrement); infinite after a single pass.
    pub last_step_sigmas: f64,
    /// J of the returned trajectory, over the measurements with a map value on the trajectory.
    pub cost: f64,
}

/// Output of the smoother on a line.
///
/// `residual_nt` and `nis` are the innovations of the last forward pass, whose map is linearised along the smoothed
/// trajectory. The residual is measurement minus the field predicted from the past alone. The variance uses the σ of
/// the measurement, without the weight of a robust loss. The expected value of `nis` therefore remains 1, and outliers
/// stay visible. The covariances belong to the last linearisation.
#[derive(Clone, Debug, Default)]
pub struct RtsOutput {
    /// Track.
    pub line: NavigationOutput,
    /// Report on the iteration.
    pub iterations: RtsReport,
}

/// Smooths one line.
///
/// # Errors
/// Returns the errors of [`RtsParameters::check`] and [`NavigationLine::check`]. Also fails for an `offset_window_s`
/// that is not a finite number of at least 0. Also fails with [`NavigationError::Diverged`] if a state or variance is
/// not finite or a variance is negative.
pub fn run(line: &NavigationLine<'_>, parameters: &RtsParameters) -> Result<RtsOutput, NavigationError> {
    parameters.check()?;
    line.check()?;
    check_window(line)?;
    let mut smoother = RtsSmoother::new(line, parameters);
    smoother.iterate()?;
    Ok(smoother.finish())
}

fn check_window(line: &NavigationLine<'_>) -> Result<(), ParameterError> {
    obeys(&line.offset_window_s, "offset_window_s", Rule::NotNegative).map_err(ParameterError)
}

/// Trajectory for the next linearisation of the map.
#[derive(Default)]
struct RtsTrajectory {
    x: Vec<StateVector>,
    /// Field along the trajectory, where a measurement and a map value exist.
    fields: Vec<Option<FieldValue>>,
    /// Twice the part of J that is due to the initial state and the process noise.
    motion: f64,
}

/// Accepted step, with the resulting decrease of the cost J.
struct RtsDescent {
    halved: bool,
    /// Decrease of J.
    fall: f64,
}

/// Candidate trajectory, with the resulting change of the cost J.
struct RtsCandidate {
    trajectory: RtsTrajectory,
    /// J of the candidate minus J of the previous trajectory, over the measurements with a map value on both
    /// trajectories.
    rise: f64,
}

struct RtsSmoother<'a> {
    line: &'a NavigationLine<'a>,
    parameters: &'a RtsParameters,
    loss: RobustLoss,
    field: PredictedField<'a>,
    pass: SmootherPass<'a>,
    at: RtsTrajectory,
    report: RtsReport,
    offset: (f64, usize),
}

impl RtsSolution {
    /// Size, in standard deviations, of the step to this solution from a trajectory whose motion term of J is
    /// `motion`/2. It follows from the curvature of the linear problem.
    fn step_sigmas(&self, motion: f64) -> f64 {
        let moved = motion - 2.0 * self.motion_with_last + self.motion;
        (moved + self.measured_step).max(0.0).sqrt()
    }
}

impl<'a> RtsSmoother<'a> {
    fn new(line: &'a NavigationLine<'a>, parameters: &'a RtsParameters) -> Self {
        let loss = RobustLoss::new(parameters.loss, parameters.loss_scale);
        let mut field = line.predicted();
        let offset = field.offset(line.ins, line.measurement_nt, line.offset_window_s);
        let pass = SmootherPass::new(line, parameters, offset.0);
        let report = RtsReport { last_step_m: f64::INFINITY, last_step_sigmas: f64::INFINITY, ..RtsReport::default() };
        Self { line, parameters, loss, field, pass, at: RtsTrajectory::default(), report, offset }
    }

    /// Iterates passes over the line until the step is small.
    fn iterate(&mut self) -> Result<(), NavigationError> {
        self.start()?;
        while self.report.passes < self.parameters.iterations && !self.report.converged {
            let solution = self.pass.run(RtsLinearisation::Along((&self.at.x, &self.at.fields)), &mut self.field)?;
            self.report.passes += 1;
            self.report.last_step_m = self.step_m(&solution.x);
            self.report.last_step_sigmas = solution.step_sigmas(self.at.motion);
            let step = self.descend(&solution);
            let settled = match step {
                Some(RtsDescent { halved: false, .. }) => false,
                Some(RtsDescent { fall, .. }) => fall < SMALL_FALL,
                None => true,
            };
            self.report.converged = self.report.last_step_m < self.parameters.tolerance_m
                || (settled && self.report.last_step_sigmas < SMALL_STEP_SIGMAS);
            if step.is_none() {
                break;
            }
        }
        Ok(())
    }

    /// Computes the first trajectory: the first of the [`STARTS`], or the best of all starts if the first is poor.
    fn start(&mut self) -> Result<(), NavigationError> {
        let most = self.parameters.iterations;
        let first = FirstPass { iterations: STARTS[0].iterations.min(most), ..STARTS[0] };
        let solution = self.pass.run(RtsLinearisation::Filtered(first), &mut self.field)?;
        self.report.passes = 1;
        self.at = self.candidate(&solution, 1.0).trajectory;
        // One of the allowed passes is reserved for the best start.
        for start in STARTS.into_iter().skip(1).take(most.saturating_sub(2)) {
            let used = self.at.fields.iter().flatten().count().max(1) as f64;
            if self.cost() < POOR_COST * used {
                break;
            }
            if self.parameters.loss == TrajectoryLoss::None && start == (FirstPass { robust: false, ..STARTS[0] }) {
                // Without a robust loss, this start equals the first.
                continue;
            }
            self.report.passes += 1;
            // A diverging start is skipped.
            if let Ok(solution) = self.pass.run(RtsLinearisation::Filtered(start), &mut self.field) {
                let candidate = self.candidate(&solution, 1.0);
                if candidate.rise < 0.0 {
                    self.at = candidate.trajectory;
                }
            }
        }
        Ok(())
    }

    /// Takes the step to a solution, halved until J does not rise; `None` if no step is accepted.
    fn descend(&mut self, solution: &RtsSolution) -> Option<RtsDescent> {
        let mut part = 1.0;
        for halvings in 0..=MOST_HALVINGS {
            let candidate = self.candidate(solution, part);
            if candidate.rise <= 0.0 {
                self.at = candidate.trajectory;
                self.report.halved += usize::from(halvings > 0);
                return Some(RtsDescent { halved: halvings > 0, fall: -candidate.rise });
            }
            part *= 0.5;
        }
        None
    }

    /// Trajectory at a fraction of the way to a solution. The step to the first solution is always a full step.
    fn candidate(&mut self, solution: &RtsSolution, part: f64) -> RtsCandidate {
        let (rest, rows) = (1.0 - part, solution.x.len());
        let motion = rest * rest * self.at.motion
            + 2.0 * part * rest * solution.motion_with_last
            + part * part * solution.motion;
        let mut trajectory = RtsTrajectory { x: Vec::with_capacity(rows), fields: Vec::with_capacity(rows), motion };
        let mut rise = 0.5 * (motion - self.at.motion);
        for (row, to) in solution.x.iter().enumerate() {
            let mut x = *to;
            if let Some(from) = self.at.x.get(row) {
                for (x, from) in x.iter_mut().zip(from) {
                    *x = rest * from + part * *x;
                }
            }
            for fix in self.line.fixes_at(row).into_iter().flatten() {
                let half_square = |x: f64| 0.5 * (fix.error - x).powi(2) / fix.variance;
                rise += half_square(x[fix.state]);
                if let Some(from) = self.at.x.get(row) {
                    rise -= half_square(from[fix.state]);
                }
            }
            let mut field = None;
            if let Some((value_nt, variance_nt2)) = self.line.measured(row, self.offset.0) {
                field = self.field.at_error(self.line.ins, row, [x[LAT], x[LON], x[ALT]]);
                if let (Some(field), Some(Some(before))) = (field, self.at.fields.get(row)) {
                    let r = |field: &FieldValue, s: f64| (value_nt - (field.value_nt + s)) / variance_nt2.sqrt();
                    rise += self.loss.value(r(&field, x[S])) - self.loss.value(r(before, self.at.x[row][S]));
                }
            }
            trajectory.x.push(x);
            trajectory.fields.push(field);
        }
        RtsCandidate { trajectory, rise }
    }

    /// Largest change of a position from the present trajectory to another, in metres.
    fn step_m(&self, to: &[StateVector]) -> f64 {
        let (ins, earth) = (self.line.ins, self.line.errors.earth);
        let mut largest_m2 = 0.0_f64;
        for (row, (to, from)) in to.iter().zip(&self.at.x).enumerate() {
            let (north, east) = earth.north_east_m_per_rad(ins.lat_deg[row].to_radians(), ins.alt_m[row]);
            let step = |state: usize| to[state] - from[state];
            let moved_m2 = (north * step(LAT)).powi(2) + (east * step(LON)).powi(2) + step(ALT).powi(2);
            largest_m2 = largest_m2.max(moved_m2);
        }
        largest_m2.sqrt()
    }

    /// J of the trajectory.
    fn cost(&self) -> f64 {
        let of = |(row, (x, field)): (usize, (&StateVector, &Option<FieldValue>))| {
            let (value_nt, variance_nt2) = self.line.measured(row, self.offset.0)?;
            let residual_nt = value_nt - (field.as_ref()?.value_nt + x[S]);
            Some(self.loss.value(residual_nt / variance_nt2.sqrt()))
        };
        let sum: f64 = self.at.x.iter().zip(&self.at.fields).enumerate().filter_map(of).sum();
        let missed = |(row, x): (usize, &StateVector)| -> f64 {
            let of = |fix: StateFix| (fix.error - x[fix.state]).powi(2) / fix.variance;
            self.line.fixes_at(row).into_iter().flatten().map(of).sum()
        };
        let fixes: f64 = self.at.x.iter().enumerate().map(missed).sum();
        0.5 * (self.at.motion + fixes) + sum
    }

    /// Output of the smoother.
    fn finish(mut self) -> RtsOutput {
        self.report.cost = self.cost();
        let (ins, earth) = (self.line.ins, self.line.errors.earth);
        let mut output = NavigationOutput::with_capacity(ins.len(), self.parameters.keep_states, false);
        for (row, x) in self.at.x.iter().enumerate() {
            let [lat, both, lon] = self.pass.position_covariances[row];
            let p = |row: usize, column: usize| match (row, column) {
                (LAT, LAT) => lat,
                (LON, LON) => lon,
                _ => both,
            };
            let innovation = self.pass.innovations[row];
            output.push(ins, row, |state| x[state], p, innovation, earth);
        }
        output.p = std::mem::take(&mut self.pass.covariances);
        output.report = self.pass.report;
        (output.report.offset_nt, output.report.offset_samples) = self.offset;
        RtsOutput { line: output, iterations: self.report }
    }
}

#[cfg(test)]
mod monte_carlo_tests;
#[cfg(test)]
mod tests;
