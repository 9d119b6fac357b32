//! Estimated noise of one magnetometer, and the mean over magnetometers.

use crate::navigation::line::NavigationLine;
use crate::navigation::measurement::{Reading, usable};
use crate::navigation::stream::StateVisitor;

use super::window::SlidingSum;
use super::{AdaptiveForm, AdaptiveMagnetometer, AdaptiveNoise, AdaptiveParameters, MagnetometerNoise};

/// Estimator of the noise of one magnetometer.
#[derive(Clone)]
pub(super) struct NoiseEstimator {
    /// Bounds of the estimated standard deviation, in nT.
    bounds_nt: [f64; 2],
    form: AdaptiveForm,
    /// Whether R is estimated.
    learns: bool,
    /// Whether the estimate is a factor on the assumed variance.
    relative: bool,
    /// First assumed variance, in nT², used as the reference of relative variances.
    first_nt2: Option<f64>,
    gate_nis: Option<f64>,
    /// Last squared innovations, in nT². With `relative`, each is divided by the ratio of the assumed variance at its
    /// time to the first assumed variance. In the matched form, H P Hᵀ is subtracted from each. In the residual form,
    /// each is the expected squared noise a posteriori.
    window: SlidingSum,
    /// Innovation of this sample before its update.
    open: Option<PendingInnovation>,
    pub(super) adapted: MagnetometerNoise,
}

/// Innovation that enters the noise estimate after the update.
#[derive(Clone, Copy, Debug)]
struct PendingInnovation {
    /// Innovation, limited to the largest one that the gate accepts, in nT.
    residual_nt: f64,
    noise_nt2: f64,
    unit: f64,
    used: bool,
}

/// Weighted means of the innovations of a sample: of all innovations and of the used innovations.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct InnovationFusion {
    all: InnovationSums,
    used: InnovationSums,
}

/// Sums over innovations.
#[derive(Clone, Copy, Debug, Default)]
struct InnovationSums {
    /// Sum of 1/R, in 1/nT².
    weight: f64,
    /// Sum of the innovations times 1/R, in 1/nT.
    residual: f64,
}

impl InnovationSums {
    fn add(&mut self, residual_nt: f64, noise_nt2: f64) {
        self.weight += 1.0 / noise_nt2;
        self.residual += residual_nt / noise_nt2;
    }
}

impl InnovationFusion {
    /// Whether an innovation is used.
    pub(super) fn is_used(&self) -> bool {
        self.used.weight > 0.0
    }

    /// Mean innovation, in nT, and the variance of its noise, in nT², over the used innovations, or over all
    /// innovations if none is used.
    pub(super) fn mean(&self) -> (f64, f64) {
        let InnovationSums { weight, residual } = if self.is_used() { self.used } else { self.all };
        (residual / weight, 1.0 / weight)
    }
}

impl NoiseEstimator {
    /// Estimator for a magnetometer of a line.
    pub(super) fn of_line(
        parameters: &AdaptiveParameters,
        line: &NavigationLine<'_>,
        magnetometer: &AdaptiveMagnetometer<'_>,
    ) -> Self {
        let AdaptiveMagnetometer { measurement_nt, sigma_min_nt, sigma_max_nt, .. } = *magnetometer;
        let mut estimator = Self::new(parameters, [sigma_min_nt, sigma_max_nt], line.ins.len());
        let adapted = &mut estimator.adapted;
        (adapted.offset_nt, adapted.offset_samples) =
            line.predicted().offset(line.ins, measurement_nt, line.offset_window_s);
        estimator
    }

    /// Estimator with bounds of the standard deviation, and capacity for the output of `rows`.
    pub(super) fn new(parameters: &AdaptiveParameters, bounds_nt: [f64; 2], rows: usize) -> Self {
        Self {
            bounds_nt,
            form: parameters.form,
            learns: parameters.adapt != AdaptiveNoise::Q,
            relative: parameters.relative,
            first_nt2: None,
            gate_nis: parameters.gate_nis,
            window: SlidingSum::new(parameters.window),
            open: None,
            adapted: MagnetometerNoise { sigma_nt: Vec::with_capacity(rows), ..MagnetometerNoise::default() },
        }
    }

    /// Measurement minus the offset, in nT, and its assumed variance; `None` if it is missing.
    pub(super) fn measured(&self, reading: Reading) -> Option<(f64, f64)> {
        usable(reading, self.adapted.offset_nt)
    }

    /// Visits the state between two samples.
    pub(super) fn visit(&mut self, state: &mut dyn StateVisitor) {
        state.optional(&mut self.first_nt2);
        self.window.visit(state);
        state.counts(&mut [&mut self.adapted.updates, &mut self.adapted.gated]);
    }

    /// Records a row without an innovation.
    pub(super) fn skip(&mut self) {
        self.adapted.sigma_nt.push(f64::NAN);
    }

    /// Adds the innovation of a reading, if usable, to `fusion` with the noise estimated from earlier readings, and
    /// updates the noise estimate. `predicted_nt2` is H P Hᵀ.
    pub(super) fn innovate(
        &mut self,
        reading: Reading,
        expected_nt: f64,
        predicted_nt2: f64,
        fusion: &mut InnovationFusion,
    ) {
        let Some((measured_nt, assumed_nt2)) = self.measured(reading) else { return self.skip() };
        let first_nt2 = *self.first_nt2.get_or_insert(assumed_nt2);
        let unit = if self.relative { assumed_nt2 / first_nt2 } else { 1.0 };
        let noise_nt2 = if self.learns { self.noise_nt2(assumed_nt2, predicted_nt2, unit) } else { assumed_nt2 };
        self.adapted.sigma_nt.push(noise_nt2.sqrt());
        let residual_nt = measured_nt - expected_nt;
        let square = residual_nt * residual_nt;
        let most = self.gate_nis.map_or(f64::INFINITY, |gate| gate * (predicted_nt2 + noise_nt2));
        fusion.all.add(residual_nt, noise_nt2);
        if square > most {
            self.adapted.gated += 1;
        } else {
            self.adapted.updates += 1;
            fusion.used.add(residual_nt, noise_nt2);
        }
        match self.form {
            AdaptiveForm::Matched => self.window.push((square.min(most) - predicted_nt2) / unit),
            AdaptiveForm::Compatible => self.window.push(square.min(most) / unit),
            AdaptiveForm::Residual => {
                let residual_nt = residual_nt.clamp(-most.sqrt(), most.sqrt());
                self.open = Some(PendingInnovation { residual_nt, noise_nt2, unit, used: square <= most });
            }
        }
    }

    /// Updates the noise estimate of the residual form after the correction of a row, with the expected squared noise
    /// given all measurements of the row. For an unused innovation, this expectation is computed as if it were the only
    /// innovation of its sample.
    pub(super) fn settle(&mut self, predicted_nt2: f64, fusion: &InnovationFusion) {
        let Some(PendingInnovation { residual_nt, noise_nt2, unit, used }) = self.open.take() else { return };
        let (mean_nt, mean_nt2) = if used { fusion.mean() } else { (residual_nt, noise_nt2) };
        let gain = predicted_nt2 / (predicted_nt2 + mean_nt2);
        let left_nt = residual_nt - gain * mean_nt;
        self.window.push((left_nt * left_nt + gain * mean_nt2) / unit);
    }

    /// Variance of the noise from the innovations so far, within its bounds. `unit` is the ratio of the present to the
    /// first assumed variance, or 1 if the variances are not relative.
    fn noise_nt2(&self, assumed_nt2: f64, predicted_nt2: f64, unit: f64) -> f64 {
        let [least, largest] = self.bounds_nt.map(|sigma_nt| sigma_nt.powi(2));
        let (count, full) = (self.window.len() as f64, self.window.capacity() as f64);
        let found = match self.form {
            AdaptiveForm::Matched | AdaptiveForm::Residual => {
                let rest = 1.0 - count / full;
                (self.window.sum() + rest * assumed_nt2 / unit) / (count + rest) * unit
            }
            AdaptiveForm::Compatible if count < full => 0.5 * (least + largest),
            AdaptiveForm::Compatible => self.window.sum() / full * unit - predicted_nt2,
        };
        found.clamp(least, largest)
    }
}
