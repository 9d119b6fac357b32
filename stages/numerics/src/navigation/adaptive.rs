//! Extended Kalman filter that estimates the measurement noise from the innovations, for one or several magnetometers.
//!
//! Covariance matching makes the variance of the innovations equal to their predicted variance [Mehra 1970, 1972;
//! Mohamed & Schwarz 1999; Gnadt 2022, (5.46)-(5.49)]. Let v_j be the innovations of a magnetometer at the N samples
//! before the present one:
//!
//! ```text
//! R̂ = C − H P Hᵀ,     C = (1/N) Σ v_j²,     bounded by sigma_min² and sigma_max²
//! ```
//!
//! [`AdaptiveForm::Matched`] subtracts from the square of every innovation the H P Hᵀ at the time of this innovation,
//! R̂ = (1/N) Σ (v_j² − H_j P_j H_jᵀ), because each innovation was predicted with the covariance at its time. While
//! there are n < N innovations, the assumed variance has the weight 1 − n/N. [`AdaptiveForm::Compatible`] follows
//! MagNav.jl: until there are N innovations, R̂ is the mean of the two bounds (as variances). After that, R̂ follows
//! from the published equation with the covariance of the current sample.
//!
//! Where H P Hᵀ is small compared with R, the mean of 1/R̂ is N/(N − 2) times 1/R. Where it is not small, both forms
//! give a larger mean. With a short window R̂ is occasionally near 0, and the filter then follows its measurements.
//! With MagNav.jl's window of 10 and wide bounds, the matched form gives a mean R/R̂ of 2.4 on the simulated flights of
//! the tests. The squared error is six times as large as the filter predicts. With a window of 50, both ratios are
//! within 10 % of 1. A short window requires tight bounds.
//!
//! # Position less accurate than the measurement
//!
//! H P Hᵀ is then large compared with R, and v² − H P Hᵀ is a small difference of large numbers, of either sign. A few
//! such innovations drive R̂ to one of its bounds; at the lower bound the filter follows its measurements.
//! [`AdaptiveForm::Residual`], the default, instead uses the expected square of the noise given the sample's own
//! measurement [Mohamed & Schwarz 1999; Dempster, Laird & Rubin 1977],
//!
//! ```text
//! R̂ = (1/N) Σ (ε_j² + H_j P_j⁺ H_jᵀ),     ε = z − h(x⁺) = v R/(H P Hᵀ + R),     H P⁺ Hᵀ = H P Hᵀ R/(H P Hᵀ + R)
//! ```
//!
//! which is never near 0. With a window of 10, the mean of R/R̂ on the same flights is 1.27, slightly above N/(N − 2),
//! and the squared error is 7 % larger than the filter predicts. If the filter already uses R̂ = R, the expected value
//! of the estimate is R. An innovation changes the estimate (R/(H P Hᵀ + R))² times as much as in the other forms, so
//! an innovation without information on the noise has no effect. If H P Hᵀ is small compared with R, the result equals
//! that of the matched form.
//!
//! Where the assumed noise σ changes along the line ([`AdaptiveParameters::relative`]), each innovation counts in units
//! of σ, R̂ = σ² (1/N) Σ (v_j² − H_j P_j H_jᵀ)/σ_j². The filter then estimates a common factor on σ and keeps the
//! variation of σ along the line.
//!
//! # Several magnetometers
//!
//! All magnetometers measure the same field and the same S, so their rows of H are equal. Their noises are independent.
//! The update with R = diag(R_1, R_2, …) therefore equals the update with the mean of the measurements, weighted by
//! 1/R_i. The variance of this mean is 1/Σ 1/R_i. If a magnetometer fails, its R̂ grows and its weight falls.
//! (MagNav.jl adds R to every element of H P Hᵀ; for several magnetometers, this matrix is singular.)
//!
//! # Process noise
//!
//! (5.47) of Gnadt 2022, Q̂ = K C Kᵀ, is the steady state of Q̂ = Q + K (C − H P Hᵀ − R) Kᵀ [Mohamed & Schwarz 1999].
//! With the printed Q̂, the covariance keeps its initial value, because K C Kᵀ adds back the decrease that each update
//! causes. Instead, the filter adds the excess to the model's Q, with the mean of v²/(H P Hᵀ + R) of the last N samples
//! in place of C/(H P Hᵀ + R):
//!
//! ```text
//! Q̂ = Q + ε K (H P Hᵀ + R) Kᵀ,     ε = mean of v²/(H P Hᵀ + R), less 1, between 0 and 1
//! ```
//!
//! K (H P Hᵀ + R) Kᵀ is the decrease of the covariance by the measurement update, so at most the whole decrease is
//! added back. The covariance never exceeds the covariance of the unaided INS and cannot diverge. For a correct model,
//! ε is still 0.56/√N on average, by chance. This is a weak remedy: an unmodelled drift appears in the innovations only
//! when it is as large as the noise.
//!
//! # Irregularities
//!
//! A measurement that is not finite, or whose sigma is not above 0, is skipped and does not change the window of its
//! magnetometer. A sample without any measurement counts as missing. If the estimated position is off the map, all
//! magnetometers are skipped. A gated measurement is not used, but enters the window with the size of the largest
//! accepted innovation. Noise that has increased therefore reopens the gate, while a single spike changes R̂ little.
//! Everything else is the same as in [`ekf`](crate::navigation::ekf).

use crate::navigation::field::PredictedField;
use crate::navigation::gaussian::recursion::{self, FilterRecursion};
use crate::navigation::gaussian::{LinearisedMeasurement, Sensitivity, StateEstimate};
use crate::navigation::ins_error::ParameterError;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::NavigationLine;
use crate::navigation::measurement::{Measurements, Reading};
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use params::{Fault, Rule, choice, obeys};

mod aided;
mod noise;
mod streamed;
mod window;

pub use aided::{AidedAdaptiveOutput, run_aided};
use noise::{InnovationFusion, NoiseEstimator};
pub(crate) use streamed::StreamedAdaptive;
use window::SlidingSum;

choice! {
    /// Noise to estimate.
    #[derive(Default)]
    pub enum AdaptiveNoise {
        /// The measurement noise R of every magnetometer.
        #[default]
        R = "r",
        /// The process noise Q.
        Q = "q",
        /// R within its bounds, and Q from the remaining excess.
        Both = "both",
    }
}

choice! {
    /// Estimator of R from the innovations.
    #[derive(Default)]
    pub enum AdaptiveForm {
        /// Uses the a posteriori residual of every measurement, and starts from the assumed noise. This form also works
        /// where the position is less accurate than the measurement.
        #[default]
        Residual = "residual",
        /// Subtracts from each squared innovation the H P Hᵀ of its time, and starts from the assumed noise.
        Matched = "matched",
        /// Form of MagNav.jl, for comparison with that program. Uses the mean of the bounds until the window is full,
        /// and then subtracts the H P Hᵀ of the present sample from the mean squared innovation.
        Compatible = "compatible",
    }
}

/// Parameters of the filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdaptiveParameters {
    /// Noise to estimate.
    pub adapt: AdaptiveNoise,
    /// Estimator of R from the innovations.
    pub form: AdaptiveForm,
    /// Number N of past innovations in the estimate, at least 2.
    pub window: usize,
    /// Estimates a factor on the assumed variance instead of the variance. Use this if the assumed noise changes from
    /// sample to sample.
    pub relative: bool,
    /// Largest NIS of a measurement; measurements with larger NIS are rejected. `None` uses every measurement.
    pub gate_nis: Option<f64>,
    /// Returns the error states of every sample (144 bytes each).
    pub keep_states: bool,
    /// Returns the covariance of every sample (2.6 kB each).
    pub keep_covariance: bool,
}

impl Default for AdaptiveParameters {
    fn default() -> Self {
        Self {
            adapt: AdaptiveNoise::R,
            form: AdaptiveForm::Residual,
            window: 50,
            relative: false,
            gate_nis: None,
            keep_states: true,
            keep_covariance: false,
        }
    }
}

impl AdaptiveParameters {
    /// Rejects parameters out of range.
    ///
    /// # Errors
    /// Fails for a window below 2, or for a gate that is not a finite number above 0.
    pub fn check(&self) -> Result<(), ParameterError> {
        if self.window < 2 {
            let what = format!("`window` must be at least 2, not {}", self.window);
            return Err(ParameterError(Fault::new(what).of_param("window")));
        }
        match self.gate_nis {
            Some(gate) => obeys(&gate, "gate_nis", Rule::Positive).map_err(ParameterError),
            None => Ok(()),
        }
    }
}

/// A magnetometer along a line.
#[derive(Clone, Copy, Debug)]
pub struct AdaptiveMagnetometer<'a> {
    /// Measured field at each sample, in nT; NaN if missing. The measurement contains the core field if, and only if,
    /// the line has one.
    pub measurement_nt: &'a [f64],
    /// Assumed standard deviation of the white noise of each measurement, in nT, before adaptation. A value that is not
    /// above 0 makes the measurement missing.
    pub sigma_nt: &'a [f64],
    /// Lower bound of the estimated standard deviation, in nT.
    pub sigma_min_nt: f64,
    /// Upper bound of the estimated standard deviation, in nT.
    pub sigma_max_nt: f64,
}

impl<'a> AdaptiveMagnetometer<'a> {
    /// Magnetometer of a line, with the bounds of the noise estimate.
    pub fn from_line(line: &NavigationLine<'a>, sigma_min_nt: f64, sigma_max_nt: f64) -> Self {
        Self { measurement_nt: line.measurement_nt, sigma_nt: line.sigma_nt, sigma_min_nt, sigma_max_nt }
    }

    fn check(&self, expected: usize) -> Result<(), NavigationError> {
        check_bounds([self.sigma_min_nt, self.sigma_max_nt])?;
        Ok(self.measurements().check(expected)?)
    }

    fn measurements(&self) -> Measurements<'a> {
        Measurements { measurement_nt: self.measurement_nt, sigma_nt: self.sigma_nt }
    }
}

/// Rejects bounds of a standard deviation that are not finite numbers above 0 in ascending order.
pub(crate) fn check_bounds([least, largest]: [f64; 2]) -> Result<(), ParameterError> {
    obeys(&least, "sigma_min_nt", Rule::Positive).map_err(ParameterError)?;
    obeys(&largest, "sigma_max_nt", Rule::Positive).map_err(ParameterError)?;
    if largest < least {
        let what = format!("`sigma_max_nt` must be at least `sigma_min_nt` = {least}, not {largest}");
        return Err(ParameterError(Fault::new(what).of_param("sigma_max_nt")));
    }
    Ok(())
}

/// Estimated noise of a magnetometer, and the number of samples by outcome.
#[derive(Clone, Debug, Default)]
pub struct MagnetometerNoise {
    /// Standard deviation of the noise that the filter assumed for each measurement, in nT; NaN without an innovation.
    pub sigma_nt: Vec<f64>,
    /// Number of measurements used.
    pub updates: usize,
    /// Number of measurements that the innovation gate rejected.
    pub gated: usize,
    /// Offset subtracted from every measurement, in nT.
    pub offset_nt: f64,
    /// Number of samples averaged for the offset.
    pub offset_samples: usize,
}

/// Output of the filter on a line.
#[derive(Clone, Debug, Default)]
pub struct AdaptiveOutput {
    /// Estimate. `residual_nt` is the innovation of the weighted mean of the used measurements (of all, if the gate
    /// rejected all); `nis` is the square of this innovation over the variance of the innovation. A sample counts as
    /// gated if all its measurements were gated. The offset is the offset of the first magnetometer.
    pub navigation: NavigationOutput,
    /// Estimated noise of each magnetometer, in the order of the magnetometers.
    pub magnetometers: Vec<MagnetometerNoise>,
    /// Share ε of the covariance decrease that is added back as process noise after each sample; 0 if Q is not
    /// estimated.
    pub given_back: Vec<f64>,
}

/// Filters one line with all of its magnetometers. The line's own measurement and sigma must have the length of the
/// line, but are not read; [`AdaptiveMagnetometer::from_line`] makes a magnetometer from them. Costs about 3 µs per
/// sample.
///
/// # Errors
/// Returns the errors of [`AdaptiveParameters::check`] and [`NavigationLine::check`]. Also fails unless the bounds of
/// each sigma are finite numbers above 0 in ascending order. Also fails with
/// [`SeriesError::Length`](crate::navigation::SeriesError) for columns whose length differs from that of the line, or
/// with [`NavigationError::Diverged`] if a state or variance is not finite or a variance is negative.
pub fn run(
    parameters: &AdaptiveParameters,
    line: &NavigationLine<'_>,
    magnetometers: &[AdaptiveMagnetometer<'_>],
) -> Result<AdaptiveOutput, NavigationError> {
    parameters.check()?;
    line.check()?;
    let rows = line.ins.len();
    magnetometers.iter().try_for_each(|magnetometer| magnetometer.check(rows))?;
    let AdaptiveParameters { keep_states, keep_covariance, .. } = *parameters;
    let mut navigation = NavigationOutput::with_capacity(rows, keep_states, keep_covariance);
    let learners: Vec<NoiseEstimator> =
        magnetometers.iter().map(|magnetometer| NoiseEstimator::of_line(parameters, line, magnetometer)).collect();
    if let Some(first) = learners.first() {
        navigation.report.offset_nt = first.adapted.offset_nt;
        navigation.report.offset_samples = first.adapted.offset_samples;
    }
    let mut state = AdaptiveState::new(parameters, line.predicted(), learners, navigation, rows);
    let readings = |magnetometer: usize, row: usize| magnetometers[magnetometer].measurements().reading(row);
    recursion::run(AdaptiveEkf { state: &mut state, ins: line.ins, readings }, line)?;
    let AdaptiveState { learners, navigation, given_back, .. } = state;
    let magnetometers = learners.into_iter().map(|learner| learner.adapted).collect();
    Ok(AdaptiveOutput { navigation, magnetometers, given_back })
}

/// Output of the filter, and its state between two samples except the estimate.
#[derive(Clone)]
struct AdaptiveState<'a> {
    parameters: AdaptiveParameters,
    field: PredictedField<'a>,
    learners: Vec<NoiseEstimator>,
    /// Last values of NIS minus 1.
    excess: SlidingSum,
    /// Process noise that the next step adds.
    pending: Option<ProcessNoiseIncrement>,
    navigation: NavigationOutput,
    given_back: Vec<f64>,
}

/// Adaptive extended Kalman filter, with the INS of a line and a function that returns the reading of a magnetometer at
/// a row.
struct AdaptiveEkf<'s, 'a, R> {
    state: &'s mut AdaptiveState<'a>,
    ins: &'s InsSeries<'s>,
    readings: R,
}

/// Share ε of a covariance decrease to add back, from the last values of NIS minus 1. Appends a NIS.
#[inline(always)]
fn excess_share(excess: &mut SlidingSum, nis: f64) -> f64 {
    excess.push(nis - 1.0);
    // Missing entries of the window count with their expected value.
    (excess.sum() / excess.capacity() as f64).clamp(0.0, 1.0)
}

/// Share of a covariance decrease that is added as process noise.
#[derive(Clone)]
struct ProcessNoiseIncrement {
    at: LinearisedMeasurement,
    noise_nt2: f64,
    share: f64,
}

impl<R: Fn(usize, usize) -> Reading> FilterRecursion for AdaptiveEkf<'_, '_, R> {
    fn output(&mut self) -> &mut NavigationOutput {
        &mut self.state.navigation
    }

    #[inline(always)]
    fn before_step(&mut self, estimate: &mut StateEstimate) {
        if let Some(ProcessNoiseIncrement { at, noise_nt2, share }) = self.state.pending.take() {
            estimate.give_back(&at, noise_nt2, share);
        }
    }

    #[inline(always)]
    fn measure(&mut self, estimate: &mut StateEstimate, row: usize) -> Innovation {
        let readings = |magnetometer: usize| (self.readings)(magnetometer, row);
        let innovation = self.state.fuse(estimate, self.ins, row, readings);
        self.state.given_back.push(self.state.pending.as_ref().map_or(0.0, |pending| pending.share));
        innovation
    }
}

impl<'a> AdaptiveState<'a> {
    fn new(
        parameters: &AdaptiveParameters,
        field: PredictedField<'a>,
        learners: Vec<NoiseEstimator>,
        navigation: NavigationOutput,
        rows: usize,
    ) -> Self {
        let (excess, given_back) = (SlidingSum::new(parameters.window), Vec::with_capacity(rows));
        Self { parameters: *parameters, field, learners, excess, pending: None, navigation, given_back }
    }

    /// Corrects the estimate with the usable measurements of a row and counts them.
    #[inline(always)]
    fn fuse(
        &mut self,
        estimate: &mut StateEstimate,
        ins: &InsSeries<'_>,
        row: usize,
        readings: impl Fn(usize) -> Reading,
    ) -> Innovation {
        let measured = self.learners.iter().enumerate().any(|(of, learner)| learner.measured(readings(of)).is_some());
        let [lat, lon, alt, temporal_nt] = estimate.measured();
        let field = if measured { self.field.at_error(ins, row, [lat, lon, alt]) } else { None };
        let Some(field) = field else {
            let report = &mut self.navigation.report;
            *(if measured { &mut report.off_map } else { &mut report.missing_measurements }) += 1;
            self.learners.iter_mut().for_each(NoiseEstimator::skip);
            return Innovation::NONE;
        };
        let at = estimate.linearised(Sensitivity::from_field(&field));
        let expected_nt = field.value_nt + temporal_nt;
        let curvature_nt2 = self.field.curvature_nt2(ins, row, [lat, lon, alt], field.value_nt, estimate.horizontal());
        let mut fusion = InnovationFusion::default();
        let predicted_nt2 = at.variance + curvature_nt2;
        for (of, learner) in self.learners.iter_mut().enumerate() {
            learner.innovate(readings(of), expected_nt, predicted_nt2, &mut fusion);
        }
        self.learners.iter_mut().for_each(|learner| learner.settle(predicted_nt2, &fusion));
        let (residual_nt, noise_nt2) = fusion.mean();
        let noise_nt2 = noise_nt2 + curvature_nt2;
        let nis = residual_nt * residual_nt / (at.variance + noise_nt2);
        if fusion.is_used() {
            self.navigation.report.updates += 1;
            estimate.correct(&at, residual_nt, noise_nt2);
            self.learn_process_noise(at, noise_nt2, nis);
        } else {
            self.navigation.report.gated += 1;
        }
        Innovation { residual_nt, nis }
    }

    /// Records the NIS and the share of the covariance decrease to add back.
    #[inline(always)]
    fn learn_process_noise(&mut self, at: LinearisedMeasurement, noise_nt2: f64, nis: f64) {
        if self.parameters.adapt == AdaptiveNoise::R {
            return;
        }
        let share = excess_share(&mut self.excess, nis);
        self.pending = (share > 0.0).then_some(ProcessNoiseIncrement { at, noise_nt2, share });
    }
}

#[cfg(test)]
mod tests;
