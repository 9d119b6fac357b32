//! Lines levelled by their differences at crossovers.
//!
//! The correction of a line is a polynomial of low order along the line that minimises the differences at the
//! crossovers. The least-squares weights decrease with the gradient of the field and with the size of the difference,
//! so that a crossover in a steep field or with a wrong position does not dominate. [Luyendyk 1997, "Processing of
//! airborne magnetic data"] Corrections that the crossovers do not support are omitted, see
//! [`LevellingOptions::tested`]. The normal equations are kept sparse and solved by conjugate gradients.

mod adjustment;
mod crossovers;
mod noise;
#[cfg(test)]
mod tests;

pub use crossovers::{Crossover, CrossoverOptions, find_crossovers};
pub use noise::CrossoverNoise;

use crate::{maps::gridding::SurveyPoints, regression::statistics::median};
use adjustment::CrossoverAdjustment;
use std::collections::BTreeMap;

/// Constraint on the common level, which crossovers do not determine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LevellingGauge {
    /// The group (ties or other lines) whose corrections have the smaller scatter keeps its median correction at zero.
    /// If the lines are out of level, this is the group of ties; if the ties are out of level, it is the group of
    /// lines. If both scatters are equal, it is the group of lines.
    Steadiest,
    /// The mean of the tie lines' corrections is zero; without ties, the mean of all corrections.
    TiesMean,
    /// Tie lines are not corrected.
    TiesHeld,
}

/// Settings of levelling.
#[derive(Clone, Debug, PartialEq)]
pub struct LevellingOptions {
    /// Order of the corrections along a line: 0 a constant, 1 linear, ...
    pub order: usize,
    /// Whether corrections are tested for significance. If true, a group (ties or other lines) is corrected only as far
    /// as its corrections scatter beyond their standard errors, and single lines that are out of level are corrected
    /// individually. If false, every line is corrected fully by its crossovers.
    pub tested: bool,
    /// Penalty on corrections, as a fraction of the weight of one crossover. The penalty must be above zero. A line
    /// with fewer crossovers than coefficients is then corrected as little as possible.
    pub ridge: f64,
    /// Limit, in standard deviations, above which differences are down-weighted (Huber); with infinity, only the
    /// gradient determines the weights.
    pub huber_sigmas: f64,
    /// Constraint on the common level.
    pub gauge: LevellingGauge,
    /// Tie lines; `None` selects the lines more than 45 degrees off the main heading.
    pub ties: Option<Vec<usize>>,
    /// Number of folds for cross-validation of the crossovers; below two it is disabled.
    pub folds: usize,
}

impl Default for LevellingOptions {
    /// Constants with a significance test, a ridge of 0.001 of the weight of a crossover, a Huber limit of 1.345
    /// standard deviations, the level of the group with the smaller scatter, and five folds.
    fn default() -> Self {
        Self {
            order: 0,
            tested: true,
            ridge: 1e-3,
            huber_sigmas: 1.345,
            gauge: LevellingGauge::Steadiest,
            ties: None,
            folds: 5,
        }
    }
}

/// Statistics of the differences at crossovers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CrossoverMerit {
    /// Root mean square of the differences, in nT: the crossing error.
    pub figure_of_merit_crossings: f64,
    /// The median absolute difference, in nT.
    pub median_nt: f64,
    /// The number of crossovers.
    pub n: usize,
}

impl CrossoverMerit {
    /// Statistics of differences; NaN if there are no crossovers.
    pub fn from_differences(differences_nt: &[f64]) -> Self {
        let n = differences_nt.len();
        let squares: f64 = differences_nt.iter().map(|d| d * d).sum();
        let mut sizes: Vec<f64> = differences_nt.iter().map(|d| d.abs()).collect();
        Self { figure_of_merit_crossings: (squares / n as f64).sqrt(), median_nt: median(&mut sizes), n }
    }
}

/// The correction of a line.
#[derive(Clone, Debug, PartialEq)]
pub struct LineCorrection {
    /// The line.
    pub line: usize,
    /// Whether the line is a tie.
    pub tie: bool,
    /// The number of its crossovers.
    pub crossovers: usize,
    /// Coefficients, in nT, of Legendre's polynomials. Their argument is -1 at the line's first point and 1 at its
    /// last.
    pub coefficients_nt: Vec<f64>,
    /// Whether the line is individually out of level.
    pub alone: bool,
}

/// Corrections of lines, and crossover statistics before and after the corrections.
#[derive(Clone, Debug, PartialEq)]
pub struct LevellingResult {
    /// The correction to subtract from each point's value, in nT.
    pub correction_nt: Vec<f64>,
    /// Correction of each line, in the order of the lines.
    pub lines: Vec<LineCorrection>,
    /// Noise of the differences at crossovers of lines without level errors.
    pub noise: CrossoverNoise,
    /// Scatter beyond the standard errors, in nT: of the lines' constants, and of the ties' constants about their
    /// common constant; zero if the group is not corrected.
    pub spread_nt: [f64; 2],
    /// Crossover statistics before levelling.
    pub before: CrossoverMerit,
    /// Crossover statistics after levelling.
    pub after: CrossoverMerit,
    /// Statistics at crossovers that are omitted in turn (cross-validation).
    pub left_out: Option<CrossoverMerit>,
}

/// Levels the lines of a survey by the crossovers that `find_crossovers` returns for the same points.
pub fn level_lines(points: SurveyPoints, crossovers: &[Crossover], options: &LevellingOptions) -> LevellingResult {
    let lines = points.lines();
    let ties = options.ties.clone().unwrap_or_else(|| tie_lines(points));
    let adjustment = CrossoverAdjustment::new(points, &lines, crossovers, &ties, options);
    let solution = adjustment.solve();
    let before: Vec<f64> = crossovers.iter().map(Crossover::difference_nt).collect();
    let left_out = (options.folds > 1).then(|| {
        let fold = |f: usize| {
            let without = adjustment.solve_with(&solution, |k| k % options.folds != f);
            let left = adjustment.differences(&without.coefficients);
            left.into_iter().enumerate().filter(move |(k, _)| k % options.folds == f)
        };
        CrossoverMerit::from_differences(&(0..options.folds).flat_map(fold).map(|(_, d)| d).collect::<Vec<f64>>())
    });
    let mut count = BTreeMap::<usize, usize>::new();
    crossovers.iter().flat_map(|c| c.lines).for_each(|line| *count.entry(line).or_default() += 1);
    let correction = |&line: &usize| {
        let (coefficients_nt, alone) = adjustment.of_line(&solution, line);
        let crossovers = count.get(&line).copied().unwrap_or(0);
        LineCorrection { line, tie: ties.contains(&line), crossovers, coefficients_nt, alone }
    };
    LevellingResult {
        correction_nt: (0..points.len()).map(|i| adjustment.correction(&solution, i, 0.0)).collect(),
        lines: lines.iter().map(correction).collect(),
        noise: solution.noise,
        spread_nt: solution.spread_nt.each_ref().map(|orders| orders[0]),
        before: CrossoverMerit::from_differences(&before),
        after: CrossoverMerit::from_differences(&adjustment.differences(&solution.coefficients)),
        left_out,
    }
}

/// Lines, ascending, whose heading differs by more than 45 degrees from the main heading and its opposite. The main
/// heading has the greatest flown length.
///
/// The heading of a line is from its first to its last finite point. The main heading is the direction of the sum of
/// all line vectors with doubled angles, so that opposite headings are equal.
pub fn tie_lines(points: SurveyPoints) -> Vec<usize> {
    let mut ways: Vec<(usize, [f64; 2])> = Vec::new();
    for run in points.runs() {
        let finite = |i: &usize| (points.easting_m[*i] + points.northing_m[*i]).is_finite();
        let (Some(a), Some(b)) = (run.clone().find(finite), run.clone().rev().find(finite)) else { continue };
        let (e, n) = (points.easting_m[b] - points.easting_m[a], points.northing_m[b] - points.northing_m[a]);
        // (e + in)² / |e + in|: the doubled angle, weighted by the length.
        let length = e.hypot(n).max(f64::MIN_POSITIVE);
        ways.push((points.line[run.start], [(e * e - n * n) / length, 2.0 * e * n / length]));
    }
    let main = ways.iter().fold([0.0, 0.0], |sum, (_, w)| [sum[0] + w[0], sum[1] + w[1]]);
    let mut ties: Vec<usize> =
        ways.iter().filter(|(_, w)| w[0] * main[0] + w[1] * main[1] < 0.0).map(|(line, _)| *line).collect();
    ties.sort_unstable();
    ties.dedup();
    ties
}
