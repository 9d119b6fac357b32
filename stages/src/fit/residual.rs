//! Residual noise of a fit on its own lines, over all frequencies.
//!
//! The `residual_std` of a fit to band-passed data covers only the band, but navigation errors come mostly from lower
//! frequencies. Each line therefore keeps means of its unfiltered rows over about a second, and some differences
//! between neighbouring samples (steps). The residual of any model is computed from these means and steps.

use numerics::signal::noise::{BlockMeans, LineNoiseModel, noise};

use super::{
    point::FitPoint,
    problem::factor,
    rows::FitLineSummary,
    solve::{FitSolution, ResidualSource},
};
use crate::model_columns::RESIDUAL;

/// Residual noise of a model on its calibration lines, in the order of [`RESIDUAL`]. NaN if the lines are too short.
pub fn residual_noise(parts: &[&FitLineSummary], point: &FitPoint, solved: &FitSolution) -> [f64; RESIDUAL.len()] {
    let (fit, names) = match &solved.left {
        ResidualSource::By(fit, names) => (fit, names),
        ResidualSource::Series(lines) => return noise_columns(lines),
    };
    let at = (point.matrix.clone(), point.targets());
    let one = |part: &&FitLineSummary| {
        let (terms, rates) = (part.terms.get(&at.0)?, part.rates.get(&at.0)?);
        // Coefficient converted to the rate of this line, which may differ from the rate of the model.
        let own = |(name, value): (&String, &f64)| {
            let rate = terms.iter().position(|term| term == name).and_then(|i| rates.get(i).copied().flatten());
            Some(value * factor(rate, name, solved.rate_hz).ok()?)
        };
        let values = names.iter().zip(&fit.coefficients).map(own).collect::<Option<Vec<f64>>>()?;
        part.wide.iter().find(|w| w.asked.contains(&at)).and_then(|w| {
            let coefficients = names.iter().zip(&values);
            w.wide.residual(&point.target, &point.matrix.features, terms, coefficients)
        })
    };
    noise_columns(&parts.iter().filter_map(one).collect::<Vec<_>>())
}

fn noise_columns(lines: &[BlockMeans]) -> [f64; RESIDUAL.len()] {
    match noise(lines) {
        Ok(LineNoiseModel { white_nt, lasting }) => [white_nt, lasting.sigma, lasting.tau_s],
        Err(_) => [f64::NAN; RESIDUAL.len()],
    }
}
