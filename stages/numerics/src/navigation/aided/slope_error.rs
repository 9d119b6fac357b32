//! Error of the map's slope, estimated from the difference along a line.

use super::{AidedOutput, AidedParameters, Aids, MapSlope, run};
use crate::navigation::likelihood::deviance;
use crate::navigation::line::NavigationLine;

/// Fractions of the map's slope that are tried first. The best fraction, multiplied and divided by `FINER`, is tried
/// next.
const PARTS: [f64; 6] = [0.0, 1.0 / 64.0, 1.0 / 16.0, 0.25, 1.0, 4.0];
const FINER: f64 = 2.0;
/// Smallest ratio between the numbers of samples that two compared runs use. A run with fewer used samples has diverged
/// and left the map.
const LEAST_PART: f64 = 0.9;

/// Likelihood of the innovations of a run.
struct SlopeErrorLikelihood {
    samples: usize,
    /// Mean of ln p + ½ ln 2π over the differences.
    mean: f64,
}

/// Maximum-likelihood estimate of the standard deviation of the map's slope error along the baseline, in nT/m. The
/// likelihood is computed from the innovations of the difference on a line. Returns 0 without a difference, or if no
/// run determines the estimate.
///
/// Each value is tried with and without the scalar field, because the scalar field may contain the aircraft field, or
/// disturbances that cancel in the difference. Costs up to 16 runs of an extended Kalman filter.
pub fn likely_slope_error(line: &NavigationLine<'_>, aids: &Aids<'_>, slope: &MapSlope) -> f64 {
    let Some(difference) = aids.difference else { return 0.0 };
    let none = vec![f64::NAN; line.ins.len()];
    let alone = NavigationLine { measurement_nt: &none, offset_window_s: 0.0, ..*line };
    let mut tried: Vec<(f64, SlopeErrorLikelihood)> = vec![];
    let attempt = |part: f64, tried: &mut Vec<(f64, SlopeErrorLikelihood)>| {
        let slope = slope.error(part * slope.rms_nt_per_m);
        let aids = Aids { difference: Some(super::DifferenceAid { slope, ..difference }), ..*aids };
        for line in [line, &alone] {
            let found = run(line, &aids, &AidedParameters::default()).ok().map(|output| likelihood(&output));
            tried.extend(found.filter(|found| found.samples > 0).map(|found| (part, found)));
        }
    };
    PARTS.into_iter().for_each(|part| attempt(part, &mut tried));
    let Some(best) = most_likely(&tried).filter(|best| *best > 0.0) else { return 0.0 };
    [best / FINER, best * FINER].into_iter().for_each(|part| attempt(part, &mut tried));
    most_likely(&tried).unwrap_or(best) * slope.rms_nt_per_m
}

fn most_likely(tried: &[(f64, SlopeErrorLikelihood)]) -> Option<f64> {
    let most = tried.iter().map(|(_, of)| of.samples).max()?;
    let enough = tried.iter().filter(|(_, of)| of.samples as f64 >= LEAST_PART * most as f64);
    enough.max_by(|(_, one), (_, other)| one.mean.total_cmp(&other.mean)).map(|(part, _)| *part)
}

fn likelihood(output: &AidedOutput) -> SlopeErrorLikelihood {
    let innovations = &output.aids.difference;
    let (mut sum, mut samples) = (0.0, 0);
    for (residual, nis) in innovations.residual.iter().zip(&innovations.nis) {
        if let Some(deviance) = deviance(*residual, *nis, f64::INFINITY) {
            sum -= 0.5 * deviance;
            samples += 1;
        }
    }
    SlopeErrorLikelihood { samples, mean: sum / samples.max(1) as f64 }
}
