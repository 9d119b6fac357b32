//! Adaptive filter with further measurements in addition to the scalar field.

use crate::navigation::aided::filter::{AidedFilter, MeasurementOutcome};
use crate::navigation::aided::{AidedOutput, AidedParameters};
use crate::navigation::aids::Aids;
use crate::navigation::gaussian::AugmentedSensitivity;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError};
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES};

use super::noise::{InnovationFusion, NoiseEstimator};
use super::window::SlidingSum;
use super::{AdaptiveMagnetometer, AdaptiveNoise, AdaptiveParameters, MagnetometerNoise, excess_share};

/// Output of the filter on a line with further measurements.
#[derive(Clone, Debug, Default)]
pub struct AidedAdaptiveOutput {
    /// Estimate of the line. Innovations of the scalar field are as in [`AdaptiveOutput`](super::AdaptiveOutput).
    pub line: AidedOutput,
    /// Estimated noise of each magnetometer, in the order of the magnetometers.
    pub magnetometers: Vec<MagnetometerNoise>,
    /// Share ε of the covariance decrease that is added back as process noise after each sample; only the decrease by
    /// the scalar field counts.
    pub given_back: Vec<f64>,
}

/// Same as [`run`](super::run), with further measurements, whose noise is fixed. Only the noise of the magnetometers is
/// estimated.
///
/// H P Hᵀ of an innovation includes the map error if the map error is a state, so the map error is not attributed to
/// the white noise. A sample where the map is too flat contributes to the noise estimate, and corrects only the
/// temporal variation and the map error.
///
/// # Errors
/// Returns the errors of [`run`](super::run) and [`Aids::check`].
pub fn run_aided(
    parameters: &AdaptiveParameters,
    line: &NavigationLine<'_>,
    magnetometers: &[AdaptiveMagnetometer<'_>],
    aids: &Aids<'_>,
) -> Result<AidedAdaptiveOutput, NavigationError> {
    parameters.check()?;
    line.check()?;
    let rows = line.ins.len();
    magnetometers.iter().try_for_each(|magnetometer| magnetometer.check(rows))?;
    aids.check(rows)?;
    let AdaptiveParameters { gate_nis, keep_states, keep_covariance, .. } = *parameters;
    let of_core = AidedParameters { gate_nis, keep_states, keep_covariance, ..AidedParameters::default() };
    let mut core = AidedFilter::new(line, aids, &of_core);
    let learners: Vec<NoiseEstimator> =
        magnetometers.iter().map(|magnetometer| NoiseEstimator::of_line(parameters, line, magnetometer)).collect();
    let offset = learners.first().map_or((0.0, 0), |first| (first.adapted.offset_nt, first.adapted.offset_samples));
    let report = &mut core.output.navigation.report;
    (report.offset_nt, report.offset_samples) = offset;
    let excess = SlidingSum::new(parameters.window);
    let mut adaptive = AidedAdaptiveFilter { parameters, magnetometers, core, learners, excess, pending: None };
    let mut given_back = Vec::with_capacity(rows);
    for row in 0..rows {
        adaptive.give_back();
        adaptive.core.advance(row);
        let scalar = adaptive.fuse(row);
        given_back.push(adaptive.pending.as_ref().map_or(0.0, |pending| pending.share));
        adaptive.core.finish(row, scalar)?;
    }
    let magnetometers = adaptive.learners.into_iter().map(|learner| learner.adapted).collect();
    Ok(AidedAdaptiveOutput { line: adaptive.core.output, magnetometers, given_back })
}

/// Share of a covariance decrease that is added as process noise.
struct AidedNoiseIncrement {
    /// P Hᵀ.
    ph: Vec<f64>,
    /// H P Hᵀ + R.
    variance_nt2: f64,
    share: f64,
}

struct AidedAdaptiveFilter<'a> {
    parameters: &'a AdaptiveParameters,
    magnetometers: &'a [AdaptiveMagnetometer<'a>],
    core: AidedFilter<'a>,
    learners: Vec<NoiseEstimator>,
    /// Last values of NIS minus 1.
    excess: SlidingSum,
    pending: Option<AidedNoiseIncrement>,
}

impl AidedAdaptiveFilter<'_> {
    fn give_back(&mut self) {
        let Some(AidedNoiseIncrement { ph, variance_nt2, share }) = self.pending.take() else { return };
        let factor = share / variance_nt2;
        for (row, of_row) in self.core.now.p.rows_mut().zip(&ph) {
            // Multiplies the two entries first, so that the matrix stays exactly symmetric.
            row.iter_mut().zip(&ph).for_each(|(entry, of_column)| *entry += factor * (of_row * of_column));
        }
    }

    /// Corrects with the magnetometers of a row.
    fn fuse(&mut self, row: usize) -> MeasurementOutcome {
        let centre = self.core.look(row);
        let readings = self.magnetometers.iter().map(|magnetometer| magnetometer.measurements().reading(row));
        let measured = self.learners.iter().zip(readings.clone()).any(|(of, reading)| of.measured(reading).is_some());
        let Some((field, slope)) = centre.filter(|_| measured) else {
            self.learners.iter_mut().for_each(NoiseEstimator::skip);
            return if measured { MeasurementOutcome::OffMap } else { MeasurementOutcome::Missing };
        };
        let mut of_ins = [0.0; STATES];
        (of_ins[LAT], of_ins[LON], of_ins[ALT]) =
            (field.d_lat_nt_per_rad, field.d_lon_nt_per_rad, field.d_alt_nt_per_m);
        of_ins[S] = 1.0;
        let of_map = self.core.states.of_map();
        let h = AugmentedSensitivity { common: of_map, ..AugmentedSensitivity::of_ins(&of_ins) };
        let AidedFilter { now, gain, spare, aids, .. } = &mut self.core;
        let predicted_nt2 = now.predict(&h, 0.0, gain);
        let expected_nt = field.value_nt + now.x[S] + of_map.1 * now.x[of_map.0];
        let mut fusion = InnovationFusion::default();
        for (learner, reading) in self.learners.iter_mut().zip(readings) {
            learner.innovate(reading, expected_nt, predicted_nt2, &mut fusion);
        }
        self.learners.iter_mut().for_each(|learner| learner.settle(predicted_nt2, &fusion));
        let (residual_nt, noise_nt2) = fusion.mean();
        let variance_nt2 = predicted_nt2 + noise_nt2;
        let innovation = Innovation { residual_nt, nis: residual_nt * residual_nt / variance_nt2 };
        if !fusion.is_used() {
            return MeasurementOutcome::Gated(innovation);
        }
        if self.parameters.adapt != AdaptiveNoise::R {
            let share = excess_share(&mut self.excess, innovation.nis);
            self.pending = (share > 0.0).then(|| AidedNoiseIncrement { ph: gain.clone(), variance_nt2, share });
        }
        if aids.is_flat(noise_nt2, slope) {
            let corrects = |state: usize| state == S || state == of_map.0;
            now.consider(residual_nt, variance_nt2, gain, spare, corrects);
            return MeasurementOutcome::Flat(innovation);
        }
        now.update(residual_nt, variance_nt2, gain, spare);
        MeasurementOutcome::Used(innovation)
    }
}
