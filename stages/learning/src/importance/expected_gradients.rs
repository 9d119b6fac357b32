//! Expected gradients.

use numerics::random::{SplitMix64, seed_of};
use rayon::prelude::*;

use super::{
    AttributionSampling, Attributions, ImportanceError, PredictionFunction, answers, attributions, both_rows, group_of,
};
use crate::{draws, rows::setting};

/// Expected gradients: the mean of (x − b) df/dx at b + a (x − b), over background rows b and over a from 0 to 1,
/// summed over the columns of a group [Erion et al. 2021, "Improving performance of deep learning models with axiomatic
/// attribution priors and expected gradients"]. The sum of a row's values is its prediction minus the mean prediction
/// of the background, up to sampling errors. `gradient` returns the derivatives with respect to all columns, row by
/// row.
///
/// Background rows are used in turn, so the numbers of their uses differ by at most one. The interval of the path
/// parameter a is divided into equal parts, one per sample, and one value of a is drawn from each part. The standard
/// errors assume independent draws and are therefore upper estimates.
///
/// # Errors
/// Fails for values that are not finite, a column that is not in exactly one group, or fewer than two samples. Also
/// fails if the model fails or returns anything but one finite number per row and column.
pub fn expected_gradients<E: Send>(
    gradient: &PredictionFunction<'_, E>,
    rows: &[f64],
    background: &[f64],
    width: usize,
    groups: &[Vec<usize>],
    sampling: &AttributionSampling,
) -> Result<Attributions, ImportanceError<E>> {
    let (explained, count) = both_rows(rows, background, width)?;
    let group_of = group_of(width, groups)?;
    setting("the number of samples", sampling.samples as f64, "at least 2", sampling.samples > 1)?;
    let one = |number: usize| {
        let x = &rows[number * width..(number + 1) * width];
        let (points, from) = points(x, background, count, number, sampling);
        let slopes = answers(gradient, &points, width, width)?;
        let part = |(slopes, b): (&[f64], &usize)| {
            let mut parts = vec![0.0; groups.len()];
            let b = &background[b * width..(b + 1) * width];
            slopes.iter().zip(x.iter().zip(b)).zip(&group_of).for_each(|((s, (x, b)), &g)| parts[g] += s * (x - b));
            parts
        };
        let parts: Vec<Vec<f64>> = slopes.chunks_exact(width).zip(&from).map(part).collect();
        let n = parts.len() as f64;
        let mean = |g: usize| parts.iter().map(|p| p[g]).sum::<f64>() / n;
        let values: Vec<f64> = (0..groups.len()).map(mean).collect();
        let variance = |g: usize| parts.iter().map(|p| (p[g] - values[g]).powi(2)).sum::<f64>() / (n - 1.0);
        let errors = (0..groups.len()).map(|g| (variance(g) / n).sqrt()).collect();
        Ok((values, errors))
    };
    attributions(f64::NAN, (0..explained).into_par_iter().map(one).collect())
}

/// The points at which the gradient is evaluated, and the background row of each.
fn points(
    x: &[f64],
    background: &[f64],
    count: usize,
    number: usize,
    sampling: &AttributionSampling,
) -> (Vec<f64>, Vec<usize>) {
    let mut bits = SplitMix64::new(seed_of(sampling.seed, &["expected gradients", &number.to_string()]));
    let mut from: Vec<usize> = vec![];
    while from.len() < sampling.samples {
        from.extend(draws::shuffled(&mut bits, count));
    }
    from.truncate(sampling.samples);
    let intervals = draws::shuffled(&mut bits, sampling.samples);
    let mut points = Vec::with_capacity(sampling.samples * x.len());
    for (b, k) in from.iter().zip(intervals) {
        let a = (k as f64 + draws::uniform(&mut bits)) / sampling.samples as f64;
        let b = &background[b * x.len()..(b + 1) * x.len()];
        points.extend(x.iter().zip(b).map(|(x, b)| b + a * (x - b)));
    }
    (points, from)
}
