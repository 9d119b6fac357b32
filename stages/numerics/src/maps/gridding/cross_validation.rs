//! Prediction error of omitted lines.

use super::nearest::PointCellIndex;
use super::survey::SurveyPoints;
use super::{GriddingError, GriddingOptions, GriddingProgress, fit};
use crate::maps::plane_grid::{EvenAxis, PlaneGrid};
use crate::regression::statistics::median;
use rayon::prelude::*;

/// Number of nearest differences from which the expected error of a node is computed.
const AROUND: usize = 24;

/// Folds of lines for cross-validation: with the lines in ascending order, each fold contains every `count`-th line.
#[derive(Clone, Debug, PartialEq)]
pub struct LineFolds {
    /// The number of folds of lines.
    pub count: usize,
    /// Folds to omit, one at a time; if all folds are omitted in turn, every point has an error.
    pub left_out: Vec<usize>,
}

impl LineFolds {
    /// All of `count` folds.
    pub fn all(count: usize) -> Self {
        Self { count, left_out: (0..count).collect() }
    }
}

/// Statistics of differences in nT.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DifferenceStatistics {
    /// The number of differences.
    pub n: usize,
    /// Median absolute value.
    pub median_nt: f64,
    /// Root mean square.
    pub rms_nt: f64,
    /// The 95th percentile of the absolute value.
    pub p95_nt: f64,
}

impl DifferenceStatistics {
    /// Statistic of the finite differences. NaN if there are no errors.
    pub fn from_differences(differences: &[f64]) -> Self {
        let mut sizes: Vec<f64> = differences.iter().map(|d| d.abs()).filter(|d| d.is_finite()).collect();
        sizes.sort_unstable_by(f64::total_cmp);
        let n = sizes.len();
        let rms_nt = (sizes.iter().map(|d| d * d).sum::<f64>() / n as f64).sqrt();
        let p95_nt = sizes.get((0.95 * n as f64) as usize).or(sizes.last()).copied().unwrap_or(f64::NAN);
        Self { n, median_nt: median(&mut sizes), rms_nt, p95_nt }
    }
}

/// Predictions at the points of omitted lines.
#[derive(Clone, Debug, PartialEq)]
pub struct CrossValidation {
    /// Measured minus predicted at every point, in nT; NaN for points of lines that were not omitted, or without a
    /// prediction.
    pub difference_nt: Vec<f64>,
    /// Statistics of the errors.
    pub spread: DifferenceStatistics,
}

/// Omits folds of lines and predicts their points from the other lines, at flight height for equivalent sources.
///
/// Points are used unchanged: clean them first. Omitting a line doubles the survey's gaps there, so the differences are
/// larger than the errors of the map from all lines.
///
/// # Errors
/// Returns the errors of [`fit`] and [`FittedSurface::at_points`](super::FittedSurface::at_points) for one of the
/// folds.
pub fn cross_validate(
    points: SurveyPoints,
    options: &GriddingOptions,
    folds: &LineFolds,
    progress: GriddingProgress,
) -> Result<CrossValidation, GriddingError> {
    let lines = points.lines();
    let fold = |i: &usize| lines.binary_search(&points.line[*i]).unwrap_or(0) % folds.count.max(1);
    let mut difference_nt = vec![f64::NAN; points.len()];
    for (done, left_out) in folds.left_out.iter().enumerate() {
        progress("cross-validation", done, folds.left_out.len());
        let (test, train): (Vec<usize>, Vec<usize>) = (0..points.len()).partition(|i| fold(i) == *left_out);
        if test.is_empty() || train.is_empty() {
            continue;
        }
        let (train, tested) = (points.pick(&train), points.pick(&test));
        let predicted = fit(train.borrow(), options, &|_, _, _| {})?.at_points(tested.borrow())?;
        test.iter().zip(predicted).for_each(|(&i, p)| difference_nt[i] = points.value_nt[i] - p);
    }
    progress("cross-validation", folds.left_out.len(), folds.left_out.len());
    let spread = DifferenceStatistics::from_differences(&difference_nt);
    Ok(CrossValidation { difference_nt, spread })
}

/// Expected error at each node: the root mean square of the differences nearest to the node, weighted by proximity.
pub fn expected_error(points: SurveyPoints, difference_nt: &[f64], axes: [EvenAxis; 2], block_m: f64) -> PlaneGrid {
    let [east_m, north_m] = axes;
    let known: Vec<usize> =
        (0..points.len().min(difference_nt.len())).filter(|&i| difference_nt[i].is_finite()).collect();
    let squares: Vec<f64> = known.iter().map(|&i| difference_nt[i].powi(2)).collect();
    let at = points.pick(&known);
    let blocks = super::reduce_blocks(
        [&at.easting_m, &at.northing_m, &at.height_m, &squares],
        block_m,
        super::BlockReduction::Mean,
    );
    let near = PointCellIndex::new(&blocks.easting_m, &blocks.northing_m);
    let node = |k: usize| {
        let place = [east_m.at((k % east_m.len) as f64), north_m.at((k / east_m.len) as f64)];
        let found = near.nearest(place, AROUND, f64::INFINITY, |_| true);
        let weights = found.iter().map(|f| 1.0 / (f.0 + (block_m * block_m).max(1.0)));
        let (sum, whole) = found
            .iter()
            .zip(weights)
            .fold((0.0, 0.0), |(s, w), (f, weight)| (s + weight * blocks.value_nt[f.1], w + weight));
        (sum / whole).sqrt()
    };
    let values = (0..east_m.len * north_m.len).into_par_iter().map(node).collect();
    PlaneGrid { east_m, north_m, values }
}
