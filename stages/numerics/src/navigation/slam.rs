//! Magnetic navigation without a map: simultaneous localisation and mapping (SLAM) by a marginalised particle filter.
//!
//! | Module | Contents |
//! |:--|:--|
//! | [`parameters`] | parameters of the filter |
//! | [`samples`] | the measurements of a line, one per step, in a local frame |
//! | [`particles`] | time update, weights, resampling |
//! | [`fixes`] | aiding positions, such as GNSS |
//! | [`resolution`] | the kernel of a resampling, and the variance that resampling loses |
//! | [`history`] | the paths of all particles, which share their past |
//! | [`index`] | spatial index of earlier samples |
//! | [`kernel`] | the Gaussian process and its prediction from a few samples |
//! | [`expected`] | expected measurement of each particle |
//! | [`fit`] | hyper-parameters by maximum likelihood |
//! | [`output`] | output of the filter on a line |
//! | [`smoother`] | the most probable track of the whole flight, starting from the filter's track |
//! | [`chart`] | the map estimated from a flight |
//!
//! # Equations
//!
//! Each particle represents the errors of latitude and longitude. The other 16 states of
//! [`pinson`](crate::navigation::pinson) are linear and Gaussian given the path of a particle, with one covariance P
//! for all particles. They are not measured directly but are updated by the displacements of the particle. Let F be the
//! first two columns of the Cholesky factor of C = Φ P Φᵀ + Q. A step draws w ~ N(0, I) for each particle [Lee 2019,
//! (27)-(29)]
//!
//! ```text
//! x ← Φ x + F w,      P ← C − F Fᵀ
//! ```
//!
//! Without error sources of the biases, of the barometer and of S, these are the nine states of Lee 2019 (30). Without
//! error sources of the barometer and of S, they are the fifteen states of its (67). (The barometer aiding, K1 to K3,
//! remains, because the height would diverge without it.)
//!
//! The map of a particle consists of its path and the measurements, which all particles share. At each step the weight
//! is the likelihood of the measurement z given the earlier ones,
//!
//! ```text
//! z(x, t) = μ + m(x) + S(t) + e,      m ~ GP(0, k(|x − x'|)),      S ~ GP(0, σ_S² exp(−|t − t'|/τ))
//! log q ← log q − ((z − ẑ)²/V + log V)/2
//! ```
//!
//! with the covariance k of [`CovarianceFunction`]. The mean ẑ and the variance V are conditioned on the 12 nearest
//! earlier samples of the particle's path and on the 4 most recent samples. The product of these weights is Vecchia's
//! approximation of the likelihood of the path, p(z₁…z_n | path). Compared with independent weights at crossings [Lee
//! 2019, (76)], it has three advantages. Map errors that two neighbouring measurements share are counted once, because
//! of the conditioning on the most recent measurements. The temporal variation between two visits is part of the
//! covariance. A particle without a revisit also has a likelihood, that of unvisited ground, so no list of active
//! particles is needed.
//!
//! # Cost
//!
//! The prediction of a particle requires the elimination of a matrix of 17 rows, regardless of the length of the
//! flight. Candidates come from an index whose cells are full after a few visits. No path is copied: particles share
//! their past in a tree, which takes 8 bytes per particle and sample until the first resampling and much less after it
//! ([`history`]). In contrast, a reduced-rank map for each particle (a basis of the region) would have to be copied
//! with the particle, and its size would be proportional to the region.
//!
//! # Limits
//!
//! Only the position relative to the earlier path is observed. The error of the first lap therefore remains, unless
//! aiding positions ([`fixes`]) locate that lap. On straight lines without a revisit the track equals the track of the
//! INS. Particles must be dense enough for some of them to coincide with a revisit. With 1000 particles, a drift of
//! some hundreds of metres between visits is permissible. After kilometres of drift no particle is near the truth, the
//! standard deviations are too small, and false revisits shift the track. The innovations do not indicate this, but a
//! value of [`SlamReport::largest_correction`] above [`IMPLAUSIBLE`] does. It is the largest squared correction over
//! the covariance of the INS alone (chi-square of 2 degrees of freedom). If the error of the INS is unbounded, a small
//! value is no evidence of a correct track.
//!
//! Particles that survive many resamplings share their early path and its error, which their spread does not represent
//! [Bailey, Nieto & Nebot 2006]. Two measures prevent a covariance of 0. A resampling draws from a kernel density of
//! the particles ([`SlamParticles::regularise`]), so they never become copies. The covariance that a resampling removes
//! is added to the returned covariance ([`resolution::LostVariance`]). Neither measure helps if the particles follow a
//! false revisit.
//!
//! The field must distinguish places. Along a track, the position error is about the noise (sensor, temporal variation,
//! residual of the kernel) over the gradient. With 0.25 nT/m the error of a tactical INS is limited to some tens of
//! metres, and with 0.03 nT/m to one or two hundred metres. Where the field is not stationary and the white part of the
//! kernel is too small, the filter is overconfident. The fit uses neighbours at some distance from each other, so it
//! attributes roughness to white noise.

pub mod chart;
pub mod expected;
pub mod fit;
pub mod fixes;
pub mod history;
pub mod index;
pub mod kernel;
mod likelihood;
pub mod output;
pub mod parameters;
pub mod particles;
pub mod resolution;
pub mod samples;
pub mod smoother;

use crate::navigation::output::Innovation;
use crate::navigation::pinson::{LAT, LON, STATES, StateMatrix, VE, VN};
use crate::navigation::position_fixes::{NO_FIX, PositionFixes};
use crate::navigation::transition::{propagate_state, step_covariance};
use crate::navigation::{NavigationError, NavigationOutput, pinson_matrix, transition_matrix};

pub use chart::{SlamMap, SlamMapGrid};
use expected::{ParticleMap, PredictionRules};
use fit::TrackMeasurements;
pub use kernel::{AnomalyKernel, CovarianceFunction};
use likelihood::{innovation, log_likelihoods};
pub use output::{PathSample, SlamOutput, SlamReport};
pub use parameters::{ExpectedMeasurement, HyperparameterSource, SlamParameters};
use particles::{SlamMoments, SlamParticles};
use resolution::{LostVariance, bandwidth, excess, product};
pub use samples::SlamLine;
use samples::{LocalFrame, SlamSample, SlamSampler, step_ends};
pub use smoother::{SlamSmootherParameters, SlamSmootherReport};

/// Filters one line.
///
/// With [`SlamParameters::smoother`], track and path are those of the smoother if it has a solution, that is, if
/// [`SlamReport::smoother`] is not `None`. The innovations are always those of the filter.
///
/// Results are bit-identical for any number of threads. A step with a revisit takes about 6 µs of one core per
/// particle.
///
/// # Errors
/// Returns the errors of [`SlamParameters::check`] and [`SlamLine::check`]. Also fails with
/// [`NavigationError::Diverged`] if a state or variance is not finite or a variance is negative.
pub fn run(parameters: &SlamParameters, line: &SlamLine<'_>) -> Result<SlamOutput, NavigationError> {
    parameters.check(&line.errors)?;
    line.check()?;
    let mut filter = SlamFilter::new(parameters, line);
    for step in 0..filter.ends.len() {
        filter.advance(step)?;
    }
    filter.finish()
}

/// Value of [`SlamReport::largest_correction`] above which a track is implausible; the probability for a consistent
/// filter is 1e-6.
pub const IMPLAUSIBLE: f64 = 27.6;

/// All particles are weighted if the revisiting particles have at least this total weight. With a smaller total, any
/// unexpected measurement would shift the weight to a single stray particle.
const FEWEST_REVISITING: f64 = 0.01;

/// Offset above all step numbers. Added to the row number, it identifies a resampling by aiding positions.
const AIDED: u64 = 1 << 40;

/// Particle filter without a map, with its state along a line.
struct SlamFilter<'a> {
    parameters: &'a SlamParameters,
    line: &'a SlamLine<'a>,
    frame: LocalFrame,
    ends: Vec<usize>,
    samples: Vec<Option<SlamSample>>,
    particles: SlamParticles,
    map: ParticleMap,
    /// Variance that resampling has removed from the covariance.
    lost: LostVariance,
    /// Displacement of each particle at the mean time of the step's measurements, in metres.
    now_m: Vec<[f64; 2]>,
    moments: SlamMoments,
    /// Moments of a parallel Kalman filter, for lines with aiding positions: kept from the start, and again from each
    /// aiding position, until the field weights the particles. These moments have no sampling error from a finite
    /// number of draws.
    exact: Option<SlamMoments>,
    /// Covariance of the INS alone.
    alone: StateMatrix,
    /// For each sample of the map, whether the gate rejected it.
    gated: Vec<bool>,
    out: SlamOutput,
}

impl<'a> SlamFilter<'a> {
    fn new(parameters: &'a SlamParameters, line: &'a SlamLine<'a>) -> Self {
        let (ins, errors) = (line.ins, &line.errors);
        let frame = LocalFrame::new(ins, errors);
        let ends = step_ends(ins.tt_s, parameters.update_interval_s);
        let mut sampler = SlamSampler::new(*line, frame);
        let first_of = |step: usize| step.checked_sub(1).map_or(0, |before: usize| ends[before] + 1);
        let samples: Vec<_> = (0..ends.len()).map(|step| sampler.sample(first_of(step)..=ends[step])).collect();
        let temporal = (errors.fogm_sigma_nt, errors.fogm_tau_s);
        let (kernel, fitted, [spacing_m, speed_mps]) = kernel_of(parameters, &samples, temporal);
        let initial = errors.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]);
        let particles = SlamParticles::new(parameters.particles, parameters.seed, &initial);
        let rules = PredictionRules::new(parameters, kernel, temporal, spacing_m, speed_mps);
        let rows = ins.len();
        let out = SlamOutput {
            navigation: NavigationOutput::with_capacity(rows, parameters.keep_states, parameters.keep_covariance),
            revisiting: Vec::with_capacity(rows),
            effective: Vec::with_capacity(rows),
            path: vec![],
            frame,
            report: SlamReport {
                kernel,
                fitted,
                revisits: 0,
                resamplings: 0,
                generations: 0,
                largest_correction: 0.0,
                smoother: None,
            },
        };
        let moments = particles.moments();
        let (map, now_m) = (ParticleMap::new(rules, parameters.particles), vec![[0.0; 2]; parameters.particles]);
        let lost = LostVariance::new(frame.m_per_rad);
        let exact = line.fixes.map(|_| SlamMoments { x: [0.0; STATES], p: initial });
        let alone = initial;
        Self {
            parameters,
            line,
            frame,
            ends,
            samples,
            particles,
            map,
            lost,
            now_m,
            moments,
            exact,
            alone,
            gated: vec![],
            out,
        }
    }

    /// Processes one step: propagates to the last row of the step and weights the particles.
    fn advance(&mut self, step: usize) -> Result<(), NavigationError> {
        let last = self.ends[step];
        if step > 0 {
            self.propagate(self.ends[step - 1], last, step as u64)?;
        } else {
            self.aid(last);
            self.particles.draw(0);
        }
        let (innovation, revisiting, gated) = match self.samples[step] {
            Some(sample) => self.weigh(&sample),
            None => (Innovation::NONE, 0, false),
        };
        self.moments = self.all_moments();
        self.push(last, innovation, revisiting, gated)?;
        let correction = correction(&self.moments, &self.alone);
        self.out.report.largest_correction = self.out.report.largest_correction.max(correction);
        if self.is_thin() {
            self.resample(step as u64);
        }
        self.out.report.generations = self.out.report.generations.max(self.map.history.size().0);
        Ok(())
    }

    /// Mean and covariance, including the lost variance.
    fn all_moments(&self) -> SlamMoments {
        if let Some(exact) = self.exact {
            return exact;
        }
        let mut moments = self.particles.moments();
        let spread = spread(&moments.p, &self.particles);
        let more = excess(&self.particles.weights);
        let entries = moments.p.as_flattened_mut().iter_mut().zip(spread.as_flattened());
        for ((p, spread), lost) in entries.zip(self.lost.now.as_flattened()) {
            *p += more * spread + lost;
        }
        moments
    }

    /// Whether the particles must be resampled.
    fn is_thin(&self) -> bool {
        self.particles.effective() < self.parameters.resample_below * self.particles.x.len() as f64
    }

    /// Resamples the particles and draws them from a kernel density; `step` is unique for each call.
    fn resample(&mut self, step: u64) {
        let effective = self.particles.effective();
        let SlamMoments { x: mean, p } = self.particles.moments();
        let spread = spread(&p, &self.particles);
        self.thin_out(&spread, step);
        self.particles.regularise(&spread, &mean, bandwidth(effective), step);
    }

    /// Resamples the particles and their paths; `spread` is the covariance of the particles' states.
    fn thin_out(&mut self, spread: &StateMatrix, step: u64) {
        self.lost.bank(&self.particles.weights, spread, &self.map.history);
        let active = self.particles.active.clone();
        // Without a list of active particles, all particles are resampled, because an aiding position weights all
        // particles.
        let all = self.parameters.expected == ExpectedMeasurement::NearestNeighbour || self.line.fixes.is_some();
        let parents = self.particles.resample(|particle| all || active[particle], step);
        self.map.history.resample(&parents);
        self.out.report.resamplings += 1;
    }

    /// Uses the aiding positions of a row, before the positions of a step are drawn; see [`fixes`].
    fn aid(&mut self, row: usize) {
        let at = |fixes: &PositionFixes| fixes.at(self.line.ins, row, self.line.errors.earth);
        let fixes = self.line.fixes.map_or(NO_FIX, at);
        if fixes == NO_FIX {
            return;
        }
        let SlamMoments { mut x, mut p } = self.all_moments();
        for fix in fixes.iter().flatten() {
            self.particles.foresee(fix);
            fixes::update(&mut x, &mut p, fix);
        }
        self.particles.join(&x, &p);
        self.lost.found();
        if self.is_thin() {
            self.thin_out(&[[0.0; STATES]; STATES], row as u64 + AIDED);
        }
        self.moments = SlamMoments { x, p };
        self.exact = Some(self.moments);
    }

    /// Time update over the rows of a step. Intermediate rows only propagate mean and covariance.
    fn propagate(&mut self, first: usize, last: usize, step: u64) -> Result<(), NavigationError> {
        let (ins, errors) = (self.line.ins, &self.line.errors);
        let (times, density) = (errors.time_constants(), errors.noise_density());
        let (mut all, mut c) = (None::<StateMatrix>, self.particles.linear);
        for row in first + 1..=last {
            let dt_s = ins.tt_s[row] - ins.tt_s[row - 1];
            let f = pinson_matrix(&ins.point(row - 1), &times, errors.pinson);
            let phi = transition_matrix(&f, dt_s);
            c = step_covariance(&c, &f, &phi, &density, dt_s, errors.noise);
            self.alone = step_covariance(&self.alone, &f, &phi, &density, dt_s, errors.noise);
            let moved = all.map_or(phi, |before| product(&phi, &before));
            all = Some(moved);
            if let Some(SlamMoments { x, p }) = &mut self.exact {
                *x = propagate_state(&phi, x);
                *p = step_covariance(p, &f, &phi, &density, dt_s, errors.noise);
            }
            if self.is_fixed(row) {
                self.particles.shift(&moved, &c);
                self.lost.shift(&moved);
                self.aid(row);
                c = self.particles.linear;
                all = None;
            } else if row < last {
                self.moments.x = propagate_state(&phi, &self.moments.x);
                self.moments.p = step_covariance(&self.moments.p, &f, &phi, &density, dt_s, errors.noise);
            }
            if row < last {
                self.push(row, Innovation::NONE, 0, false)?;
            }
        }
        match all {
            Some(all) => {
                self.particles.advance(&all, &c, step);
                self.lost.shift(&all);
            }
            None => self.particles.draw(step),
        }
        Ok(())
    }

    /// Whether a row has an aiding position.
    fn is_fixed(&self, row: usize) -> bool {
        self.line.fixes.is_some_and(|fixes| fixes.is_there(row))
    }

    /// Variance of the particles' positions, in m².
    fn variance_m2(&self) -> f64 {
        let mut sums = [0.0; 4];
        for (now_m, weight) in self.now_m.iter().zip(&self.particles.weights) {
            let [n, e] = *now_m;
            for (sum, of) in sums.iter_mut().zip([n, e, n * n, e * e]) {
                *sum += weight * of;
            }
        }
        let [n, e, nn, ee] = sums;
        nn - n * n + ee - e * e
    }

    /// Measurement update. Returns the innovation of the mean, the number of revisiting particles, and whether the gate
    /// rejected the measurement.
    fn weigh(&mut self, sample: &SlamSample) -> (Innovation, u32, bool) {
        let lag_s = self.line.ins.tt_s[sample.row] - sample.tt_s;
        for (now_m, x) in self.now_m.iter_mut().zip(&self.particles.x) {
            let [per_north, per_east] = self.frame.m_per_rad;
            *now_m = [x[LAT] * per_north - lag_s * x[VN], x[LON] * per_east - lag_s * x[VE]];
        }
        let predictions = self.map.predict(sample, &self.now_m);
        self.map.push(*sample, &self.now_m);
        self.lost.push(self.map.samples.len() - 1);
        self.gated.push(false);
        let Some(predictions) = predictions else { return (Innovation::NONE, 0, false) };
        let revisiting = predictions.iter().filter(|prediction| prediction.revisits).count() as u32;
        let seen = predictions.iter().zip(&self.particles.weights).filter(|(prediction, _)| prediction.revisits);
        if seen.map(|(_, weight)| weight).sum::<f64>() < FEWEST_REVISITING {
            return (Innovation::NONE, revisiting, false);
        }
        let innovation = innovation(&predictions, &self.particles.weights);
        if self.parameters.gate_nis.is_some_and(|gate| innovation.nis > gate) {
            if let Some(gated) = self.gated.last_mut() {
                *gated = true;
            }
            return (innovation, revisiting, true);
        }
        let logs = log_likelihoods(&predictions, self.parameters.expected);
        let before = self.variance_m2();
        if !self.particles.weigh(&logs) {
            return (Innovation::NONE, 0, false);
        }
        self.exact = None;
        let gain = if before > 0.0 { 1.0 - self.variance_m2() / before } else { 1.0 };
        self.lost.revisit(self.map.found(), gain);
        for (active, prediction) in self.particles.active.iter_mut().zip(&predictions) {
            *active |= prediction.revisits;
        }
        self.out.report.revisits += 1;
        (innovation, revisiting, false)
    }

    /// Appends a row of the output.
    fn push(
        &mut self,
        row: usize,
        innovation: Innovation,
        revisiting: u32,
        gated: bool,
    ) -> Result<(), NavigationError> {
        if !self.moments.are_sound() {
            return Err(NavigationError::Diverged { row, tt_s: self.line.ins.tt_s[row] });
        }
        let SlamMoments { x, p } = &self.moments;
        let earth = self.line.errors.earth;
        let (state, covariance) = (|state: usize| x[state], |row: usize, column: usize| p[row][column]);
        self.out.navigation.push(self.line.ins, row, state, covariance, innovation, earth);
        let report = &mut self.out.navigation.report;
        match innovation.residual_nt.is_finite() {
            true if gated => report.gated += 1,
            true => report.updates += 1,
            false if self.line.is_measured(row) => report.off_map += 1,
            false => report.missing_measurements += 1,
        }
        self.out.revisiting.push(revisiting);
        self.out.effective.push(self.particles.effective());
        Ok(())
    }

    fn finish(mut self) -> Result<SlamOutput, NavigationError> {
        self.out.path = output::path_of(&self.map, &self.particles, &self.frame);
        if let Some(smoother) = &self.parameters.smoother {
            let used = self.gated.iter().map(|gated| !gated);
            let samples: Vec<(SlamSample, bool)> = self.map.samples.iter().copied().zip(used).collect();
            let filtered = smoother::SlamFilterResult {
                line: self.line,
                ends: &self.ends,
                frame: self.frame,
                kernel: self.out.report.kernel,
                fits: self.out.report.fitted,
                gate_nis: self.parameters.gate_nis,
                samples: &samples,
            };
            smoother::smooth(smoother, &filtered, &mut self.out)?;
        }
        Ok(self.out)
    }
}

/// Kernel, whether it was fitted, the mean distance between samples (m) and the mean speed (m/s).
fn kernel_of(
    parameters: &SlamParameters,
    samples: &[Option<SlamSample>],
    temporal: (f64, f64),
) -> (AnomalyKernel, bool, [f64; 2]) {
    let measured: Vec<SlamSample> = samples.iter().flatten().copied().collect();
    let step_m = |pair: &[SlamSample]| (pair[1].at_m[0] - pair[0].at_m[0]).hypot(pair[1].at_m[1] - pair[0].at_m[1]);
    let path_m: f64 = measured.windows(2).map(step_m).sum();
    let spacing_m = path_m / measured.len().saturating_sub(1).max(1) as f64;
    let flown_s = measured.last().zip(measured.first()).map_or(0.0, |(last, first)| last.tt_s - first.tt_s);
    let speed_mps = if flown_s > 0.0 { path_m / flown_s } else { 0.0 };
    let fitted = match parameters.hyperparameters {
        HyperparameterSource::Fixed => None,
        HyperparameterSource::Fitted => {
            TrackMeasurements::from_samples(&measured, parameters.fit_window_s).fitted(&parameters.kernel, temporal)
        }
    };
    (fitted.unwrap_or(parameters.kernel), fitted.is_some(), [spacing_m, speed_mps])
}

/// Covariance `p` of all states minus the part common to all particles.
fn spread(p: &StateMatrix, particles: &SlamParticles) -> StateMatrix {
    std::array::from_fn(|row| std::array::from_fn(|column| p[row][column] - particles.linear[row][column]))
}

/// Square of the correction of the position over the covariance of the INS alone: chi-square with 2 degrees of freedom.
fn correction(moments: &SlamMoments, alone: &StateMatrix) -> f64 {
    let ([lat, lon], [a, b, c]) =
        ([moments.x[LAT], moments.x[LON]], [alone[LAT][LAT], alone[LAT][LON], alone[LON][LON]]);
    let determinant = a * c - b * b;
    if determinant > 0.0 { (c * lat * lat - 2.0 * b * lat * lon + a * lon * lon) / determinant } else { 0.0 }
}

#[cfg(test)]
mod tests;
