//! Residual of a fit on its own lines over all frequencies, as the noise of the compensated signal.
//!
//! A fit on band-passed data is judged by `residual_std` in its band alone; what navigation suffers from is mostly below
//! it. So means of the unfiltered rows over about a second are kept, with some steps between neighbouring samples, and
//! the residual of each is the model's, whichever it turns out to be.

use numerics::signal::noise::{Blocks, Noise, noise};

use super::{
    point::Point,
    problem::factor,
    rows::Part,
    solve::{Left, Solved},
};
use crate::model_columns::RESIDUAL;

/// The noise of a model on the lines that it was fitted on, in the order of the model table's columns; NaN where the lines
/// are too short to tell.
pub fn residual_noise(parts: &[&Part], point: &Point, solved: &Solved) -> [f64; RESIDUAL.len()] {
    let (fit, names) = match &solved.left {
        Left::By(fit, names) => (fit, names),
        Left::Series(lines) => return told(lines),
    };
    let at = (point.matrix.clone(), point.targets());
    let one = |part: &&Part| {
        let (terms, rates) = (part.terms.get(&at.0)?, part.rates.get(&at.0)?);
        // The coefficient of this line's term, which may be of another rate than that of the model.
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
    told(&parts.iter().filter_map(one).collect::<Vec<_>>())
}

fn told(lines: &[Blocks]) -> [f64; RESIDUAL.len()] {
    match noise(lines) {
        Ok(Noise { white_nt, lasting }) => [white_nt, lasting.sigma, lasting.tau_s],
        Err(_) => [f64::NAN; RESIDUAL.len()],
    }
}
