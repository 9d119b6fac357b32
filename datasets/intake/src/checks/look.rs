//! Limits beyond which a quality figure needs attention.

use schemas::{Role, flight};

use super::{QualityFigure, QualityMeasure};

/// Context for judging a figure.
#[derive(Clone, Copy, Debug, Default)]
pub struct FigureContext {
    /// Number of samples of all lines of the flight.
    pub samples: u64,
    /// The rate of the samples, in Hz.
    pub rate_hz: f64,
    /// Lowest noise of the scalar magnetometers of the flight, in nT; NaN without a scalar magnetometer.
    pub quietest_nt: f64,
    /// The noise of the column; NaN if unknown.
    pub noise: f64,
}

/// Default longest gap that `resample` closes, in seconds.
const GAP_S: f64 = 1.0;
/// Maximum share of missing samples.
const MISSING: f64 = 0.01;
/// Maximum jitter relative to the time step. Above this ratio, the interpolation error exceeds the noise.
const JITTER: f64 = 0.1;
/// Maximum quantisation step in standard deviations of the noise; a larger step dominates the noise.
const COARSE: f64 = 2.0;
/// Maximum ratio of the noise of a magnetometer to the noise of the best magnetometer of the same flight.
const NOISY: f64 = 10.0;

/// Maximum share of all samples near over-represented values.
const PREFERRED: f64 = 0.1;
/// Maximum lag in samples. A larger lag should be removed with `resample`.
const LATE: f64 = 0.5;

/// Whether a figure should be checked before the column is used.
pub fn needs_a_look(measure: &QualityMeasure, around: &FigureContext) -> bool {
    let is_magnetometer = flight::is_scalar_reading(&measure.column) || flight::vector_part(&measure.column).is_some();
    let share = measure.count as f64 / (around.samples.max(1)) as f64;
    match measure.check {
        QualityFigure::Rate | QualityFigure::Midnight => false,
        QualityFigure::Jitter => measure.value * around.rate_hz > JITTER,
        QualityFigure::Gaps => measure.value * around.rate_hz > MISSING * around.samples as f64,
        QualityFigure::LongestGap => measure.value > GAP_S,
        QualityFigure::RepeatedTime | QualityFigure::BackwardTime => true,
        QualityFigure::Dropouts => measure.value > GAP_S || share > MISSING,
        QualityFigure::Stuck | QualityFigure::Saturation => true,
        QualityFigure::Quantisation => {
            is_magnetometer && (around.noise.is_nan() || measure.value > COARSE * around.noise)
        }
        QualityFigure::Noise => {
            flight::is_scalar_reading(&measure.column) && measure.value > NOISY * around.quietest_nt
        }
        // Estimates of position have a step at each fix.
        QualityFigure::Spikes => {
            !measure.column.starts_with("ins_") && flight::describe(&measure.column).role == Role::Sensor
        }
        QualityFigure::Preferred => share > PREFERRED,
        QualityFigure::DeadZone | QualityFigure::PolarDeadZone | QualityFigure::EquatorialDeadZone => true,
        QualityFigure::Lag => measure.value.abs() * around.rate_hz > LATE,
        // Missing values are dropouts.
        QualityFigure::Found(super::FindingKind::Missing) => false,
        QualityFigure::Found(_) => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_a_figure_is_judged_in_its_context() {
        let around = FigureContext { samples: 10_000, rate_hz: 10.0, quietest_nt: 0.01, noise: 0.02 };
        let of = |column: &str, check, value, count| {
            let measure =
                QualityMeasure { column: column.into(), check, value, unit: "".into(), count, first_tt: f64::NAN };
            needs_a_look(&measure, &around)
        };
        assert!(of("mag_1_uc", QualityFigure::Dropouts, 0.3, 200) && of("mag_1_uc", QualityFigure::Dropouts, 2.0, 20));
        assert!(!of("mag_1_uc", QualityFigure::Dropouts, 0.3, 20));
        assert!(of("tt", QualityFigure::Jitter, 0.02, 10_000) && !of("tt", QualityFigure::Jitter, 0.001, 10_000));
        assert!(of("tt", QualityFigure::Gaps, 11.0, 40) && !of("tt", QualityFigure::Gaps, 9.0, 40));
        assert!(of("mag_1_uc", QualityFigure::Noise, 0.2, 1) && !of("mag_1_uc", QualityFigure::Noise, 0.05, 1));
        assert!(!of("cur_1", QualityFigure::Noise, 500.0, 1));
        assert!(
            of("flux_a_x", QualityFigure::Quantisation, 100.0, 1)
                && !of("flux_a_x", QualityFigure::Quantisation, 0.03, 1)
        );
        assert!(of("mag_1_uc", QualityFigure::Spikes, 5.0, 1) && !of("ins_vn", QualityFigure::Spikes, 5.0, 1));
        assert!(!of("tt", QualityFigure::Midnight, 86_400.0, 1));
        assert!(of("mag_1_uc", QualityFigure::Lag, -0.06, 900) && !of("mag_1_uc", QualityFigure::Lag, 0.04, 900));
        assert!(
            of("mag_1_uc", QualityFigure::Preferred, 2.0, 3000) && !of("mag_1_uc", QualityFigure::Preferred, 2.0, 600)
        );
        assert!(of("mag_1_uc", QualityFigure::PolarDeadZone, 35.0, 30));
    }
}
