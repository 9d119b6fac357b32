//! The adjustment of lines by their crossovers.
//!
//! A difference at a crossover is the level error of both lines, plus noise that grows with the gradient
//! ([`CrossoverNoise`]). The corrections are the most likely values, given the crossovers of a survey. The corrections
//! of the lines, and the corrections of the ties about a common shift, are modelled as draws from a distribution. The
//! width of the distribution is estimated from the scatter of the corrections beyond their own standard errors (the
//! method of moments of DerSimonian and Laird 1986). Without such scatter the width is zero and the group is not
//! corrected, so that the noise at the crossovers of a level survey does not become stripes. A line that is
//! individually out of level is corrected independently of the others.

use super::noise::CrossoverNoise;
use super::{Crossover, LevellingGauge, LevellingOptions};
use crate::{maps::gridding::SurveyPoints, regression::statistics::median};
use std::collections::BTreeMap;

/// Number of rounds in the estimation of noise and widths.
const ROUNDS: usize = 16;
/// Number of reweightings in each round.
const REWEIGHTED: usize = 4;
/// Probability that, in a survey without level errors, any line is reported as individually out of level.
const BY_CHANCE: f64 = 0.05;
/// Number of standard deviations by which the scatter of a group must exceed the scatter expected from its errors.
const BEYOND: f64 = 1.645;
/// The iteration starts with unconstrained corrections if there are at least this number of crossovers per coefficient.
const ENOUGH: usize = 2;
/// Minimum number of crossovers of a line that is individually out of level. With fewer crossovers, the line may only
/// seem out of level because crossovers are wrong.
const LEAST_CROSSOVERS: usize = 3;

/// Sparse least-squares equations of the line corrections, one per crossover.
pub(super) struct CrossoverAdjustment<'a> {
    points: SurveyPoints<'a>,
    crossovers: &'a [Crossover],
    /// First and last point of each line, and its index among the lines.
    lines: BTreeMap<usize, (usize, usize, usize)>,
    terms: usize,
    /// Index and factor of each coefficient in an equation. The coefficients are those of the lines, line by line, then
    /// the shift of all ties.
    rows: Vec<Vec<(usize, f64)>>,
    right: Vec<f64>,
    is_tie: Vec<bool>,
    options: &'a LevellingOptions,
}

/// Estimated line corrections and their distribution.
#[derive(Clone, Debug)]
pub(super) struct AdjustmentSolution {
    /// Coefficients by line, in nT; the constants of the ties include their common shift.
    pub coefficients: Vec<f64>,
    /// Statistics of the crossovers.
    pub noise: CrossoverNoise,
    /// Widths of the corrections of lines and of ties, by order, in nT.
    pub spread_nt: [Vec<f64>; 2],
    /// Lines that are individually out of level.
    pub alone: Vec<bool>,
    /// Standard deviations of the differences, in nT.
    sd_nt: Vec<f64>,
}

/// Coefficients of one line from its crossovers, with the other lines fixed.
struct LineLevelEstimate {
    value_nt: Vec<f64>,
    /// Standard errors.
    error_nt: Vec<f64>,
    /// Ratio of the variance of the line's differences to the expected variance, at least 1.
    excess: f64,
    crossovers: usize,
}

impl<'a> CrossoverAdjustment<'a> {
    pub fn new(
        points: SurveyPoints<'a>,
        lines: &[usize],
        crossovers: &'a [Crossover],
        ties: &[usize],
        options: &'a LevellingOptions,
    ) -> Self {
        let terms = options.order + 1;
        let mut ends: BTreeMap<usize, (usize, usize, usize)> =
            lines.iter().enumerate().map(|(k, &line)| (line, (usize::MAX, 0, k))).collect();
        for run in points.runs() {
            if let Some(end) = ends.get_mut(&points.line[run.start]) {
                (end.0, end.1) = (end.0.min(run.start), end.1.max(run.end - 1));
            }
        }
        let is_tie = lines.iter().map(|line| ties.contains(line)).collect();
        let (rows, right) = (Vec::new(), crossovers.iter().map(Crossover::difference_nt).collect());
        let mut made = Self { points, crossovers, lines: ends, terms, rows, right, is_tie, options };
        made.rows = crossovers.iter().map(|c| made.row(c)).collect();
        made
    }

    /// Position along the line, from -1 to 1, of the point at the fraction `part` of the way from `point` to the next
    /// point; and the index of the line.
    fn place(&self, point: usize, part: f64) -> (f64, usize) {
        let (first, last, line) =
            self.points.line.get(point).and_then(|line| self.lines.get(line)).copied().unwrap_or((0, 0, 0));
        let whole = last.saturating_sub(first).max(1) as f64;
        (2.0 * (point.saturating_sub(first) as f64 + part) / whole - 1.0, line)
    }

    /// The index of the common shift of the ties.
    fn shift(&self) -> usize {
        self.is_tie.len() * self.terms
    }

    fn row(&self, crossover: &Crossover) -> Vec<(usize, f64)> {
        let side = |k: usize| {
            let (along, line) = self.place(crossover.points[k], crossover.parts[k]);
            let sign = if k == 0 { 1.0 } else { -1.0 };
            let own = legendre(along, self.terms).into_iter().enumerate();
            let shift = self.is_tie[line].then_some((self.shift(), sign));
            own.map(move |(j, p)| (line * self.terms + j, sign * p)).chain(shift)
        };
        side(0).chain(side(1)).collect()
    }

    /// Correction, in nT, at the fraction `part` of the way from a point to the next point.
    pub fn correction(&self, solution: &AdjustmentSolution, point: usize, part: f64) -> f64 {
        let (along, line) = self.place(point, part);
        legendre(along, self.terms).iter().zip(self.of_place(solution, line)).map(|(p, c)| p * c).sum()
    }

    /// A line's coefficients and whether it is individually out of level.
    pub fn of_line(&self, solution: &AdjustmentSolution, line: usize) -> (Vec<f64>, bool) {
        let place = self.lines.get(&line).map_or(0, |l| l.2);
        (self.of_place(solution, place).to_vec(), solution.alone[place])
    }

    fn of_place<'s>(&self, solution: &'s AdjustmentSolution, place: usize) -> &'s [f64] {
        &solution.coefficients[place * self.terms..][..self.terms]
    }

    /// Differences after correction, in nT.
    pub fn differences(&self, coefficients: &[f64]) -> Vec<f64> {
        // In a solution, the constants of the ties include their shift.
        let of = |j: usize| coefficients.get(j).copied().unwrap_or(0.0);
        let left = |(row, d): (&Vec<(usize, f64)>, &f64)| d - row.iter().map(|(j, p)| p * of(*j)).sum::<f64>();
        self.rows.iter().zip(&self.right).map(left).collect()
    }

    /// Corrections from all crossovers.
    pub fn solve(&self) -> AdjustmentSolution {
        let lines = self.is_tie.len();
        let mut found = AdjustmentSolution {
            coefficients: vec![0.0; self.shift() + 1],
            noise: CrossoverNoise::default(),
            spread_nt: [vec![0.0; self.terms], vec![0.0; self.terms]],
            alone: vec![false; lines],
            sd_nt: vec![1.0; self.rows.len()],
        };
        if self.rows.is_empty() {
            found.coefficients.truncate(self.shift());
            return found;
        }
        // The iteration starts with unconstrained corrections if there are enough crossovers to separate them from
        // noise, and otherwise without corrections.
        let free = !self.options.tested || self.rows.len() >= ENOUGH * self.shift();
        let mut spent = 1.0;
        if free {
            found.spread_nt = [vec![f64::INFINITY; self.terms], vec![f64::INFINITY; self.terms]];
            found.noise.sigma_nt = 1.0;
            found.coefficients = self.weighted(&found, |_| true);
            spent = self.shift() as f64;
        }
        for _ in 0..ROUNDS {
            let left = self.differences(&found.coefficients);
            found.noise = CrossoverNoise::fitted(self.crossovers, &left, spent);
            found.sd_nt = self.crossovers.iter().map(|c| found.noise.difference_sigma_nt(c)).collect();
            found.coefficients = self.weighted(&found, |_| true);
            spent = if self.options.tested { self.estimate(&mut found) } else { spent };
        }
        found.coefficients = self.weighted(&found, |_| true);
        self.levelled(found)
    }

    /// Corrections from some of the crossovers, with the noise and widths from all crossovers.
    pub fn solve_with(&self, whole: &AdjustmentSolution, used: impl Fn(usize) -> bool) -> AdjustmentSolution {
        let coefficients = if self.rows.is_empty() { whole.coefficients.clone() } else { self.weighted(whole, used) };
        self.levelled(AdjustmentSolution { coefficients, ..whole.clone() })
    }

    /// Estimates the widths and finds the lines that are individually out of level. Returns the degrees of freedom of
    /// the corrections.
    fn estimate(&self, found: &mut AdjustmentSolution) -> f64 {
        let own: Vec<LineLevelEstimate> = self.own(found);
        let crossed: Vec<usize> = (0..own.len()).filter(|&k| own[k].crossovers > 0 && !self.is_held(k)).collect();
        let limit = (2.0 * (crossed.len().max(1) as f64 / BY_CHANCE).ln()).sqrt();
        let group = |tie: bool| crossed.iter().copied().filter(|&k| self.is_tie[k] == tie).collect::<Vec<usize>>();
        let mut spent = 1.0;
        for (tie, spread) in [false, true].into_iter().zip(&mut found.spread_nt) {
            let members = group(tie);
            let of = |k: &usize, order: usize| (own[*k].value_nt[order], own[*k].error_nt[order]);
            // Lines that are individually out of level must not contribute to the width that is used to test them.
            let usual: Vec<f64> =
                (0..self.terms).map(|order| robust_width(members.iter().map(|k| of(k, order)))).collect();
            for &k in &members {
                let out = |order: usize| {
                    let (value, error) = of(&k, order);
                    value.abs() > limit * (error * error * own[k].excess + usual[order].powi(2)).sqrt()
                };
                found.alone[k] = own[k].crossovers >= LEAST_CROSSOVERS && (0..self.terms).any(out);
                spent += if found.alone[k] { self.terms as f64 } else { 0.0 };
            }
            for (order, width) in spread.iter_mut().enumerate() {
                let rest: Vec<(f64, f64)> =
                    members.iter().filter(|k| !found.alone[**k]).map(|k| of(k, order)).collect();
                *width = beyond_errors(&rest);
                let taken = |(_, error): (f64, f64)| *width * *width / (*width * *width + error * error);
                spent += rest.into_iter().map(taken).filter(|t| t.is_finite()).sum::<f64>();
            }
        }
        spent
    }

    /// Whether the gauge excludes a line from correction.
    fn is_held(&self, line: usize) -> bool {
        self.options.gauge == LevellingGauge::TiesHeld && self.is_tie[line]
    }

    fn own(&self, found: &AdjustmentSolution) -> Vec<LineLevelEstimate> {
        let left = self.differences(&found.coefficients);
        let weights = self.weights(found, &left);
        let mut normal = vec![(vec![0.0; self.terms * self.terms], vec![0.0; self.terms], 0.0, 0); self.is_tie.len()];
        for (k, c) in self.crossovers.iter().enumerate() {
            for side in 0..2 {
                let (along, line) = self.place(c.points[side], c.parts[side]);
                let sign = if side == 0 { 1.0 } else { -1.0 };
                let p: Vec<f64> = legendre(along, self.terms).into_iter().map(|p| sign * p).collect();
                let correction: f64 = p.iter().zip(&found.coefficients[line * self.terms..]).map(|(p, c)| p * c).sum();
                let (a, b, squares, n) = &mut normal[line];
                for i in 0..self.terms {
                    b[i] += weights[k] * p[i] * (left[k] + correction);
                    (0..self.terms).for_each(|j| a[i * self.terms + j] += weights[k] * p[i] * p[j]);
                }
                *squares += weights[k] * left[k] * left[k];
                *n += 1;
            }
        }
        let least = self.ridge(found);
        let one = |(a, b, squares, n): (Vec<f64>, Vec<f64>, f64, usize)| {
            let inverse = inverse(a, self.terms, least);
            let row = |i: usize| &inverse[i * self.terms..][..self.terms];
            let value_nt = (0..self.terms).map(|i| row(i).iter().zip(&b).map(|(x, b)| x * b).sum()).collect();
            let error_nt = (0..self.terms).map(|i| row(i)[i].max(0.0).sqrt()).collect();
            let free = n.saturating_sub(self.terms).max(1) as f64;
            LineLevelEstimate { value_nt, error_nt, excess: (squares / free).max(1.0), crossovers: n }
        };
        normal.into_iter().map(one).collect()
    }

    /// The penalty on corrections, 1/nT².
    fn ridge(&self, found: &AdjustmentSolution) -> f64 {
        self.options.ridge / found.noise.sigma_nt.powi(2)
    }

    /// Inverse variances, down-weighted for large differences.
    fn weights(&self, found: &AdjustmentSolution, left: &[f64]) -> Vec<f64> {
        let weigh = |(d, sd): (&f64, &f64)| (self.options.huber_sigmas * sd / d.abs()).min(1.0) / (sd * sd);
        left.iter().zip(&found.sd_nt).map(weigh).collect()
    }

    /// The penalty on each coefficient, 1/nT²; infinity fixes it at zero.
    fn costs(&self, found: &AdjustmentSolution) -> Vec<f64> {
        let ridge = self.ridge(found);
        let of = |line: usize, order: usize| match self.is_held(line) {
            true => f64::INFINITY,
            false if found.alone[line] => ridge,
            false => ridge + found.spread_nt[usize::from(self.is_tie[line])][order].powi(-2),
        };
        let lines = (0..self.is_tie.len()).flat_map(|line| (0..self.terms).map(move |order| (line, order)));
        let shift = if self.options.gauge == LevellingGauge::TiesHeld { f64::INFINITY } else { ridge };
        lines.map(|(line, order)| of(line, order)).chain([shift]).collect()
    }

    /// The most likely coefficients, with reweighting.
    fn weighted(&self, found: &AdjustmentSolution, used: impl Fn(usize) -> bool) -> Vec<f64> {
        let costs = self.costs(found);
        let mut x = found.coefficients.clone();
        x.resize(self.shift() + 1, 0.0);
        for _ in 0..REWEIGHTED {
            let mut weights = self.weights(found, &self.differences(&x));
            weights.iter_mut().enumerate().filter(|(k, _)| !used(*k)).for_each(|(_, w)| *w = 0.0);
            x = self.least_squares(&weights, &costs, x);
        }
        x
    }

    fn least_squares(&self, weights: &[f64], costs: &[f64], mut start: Vec<f64>) -> Vec<f64> {
        let free = |j: usize| costs[j].is_finite();
        let normal = |x: &[f64]| {
            let mut out: Vec<f64> = x.iter().zip(costs).map(|(v, c)| if c.is_finite() { c * v } else { *v }).collect();
            for (row, w) in self.rows.iter().zip(weights) {
                let along = w * row.iter().filter(|(j, _)| free(*j)).map(|(j, p)| p * x[*j]).sum::<f64>();
                row.iter().filter(|(j, _)| free(*j)).for_each(|(j, p)| out[*j] += along * p);
            }
            out
        };
        let mut right = vec![0.0; start.len()];
        let mut diagonal: Vec<f64> = costs.iter().map(|c| if c.is_finite() { *c } else { 1.0 }).collect();
        for ((row, w), d) in self.rows.iter().zip(weights).zip(&self.right) {
            for (j, p) in row.iter().filter(|(j, _)| free(*j)) {
                right[*j] += w * d * p;
                diagonal[*j] += w * p * p;
            }
        }
        start.iter_mut().enumerate().filter(|(j, _)| !free(*j)).for_each(|(_, x)| *x = 0.0);
        conjugate_gradients(normal, &right, &diagonal, start)
    }

    /// Adds the shift of the ties to their constants and applies the gauge.
    fn levelled(&self, mut found: AdjustmentSolution) -> AdjustmentSolution {
        let x = &mut found.coefficients;
        let shift = x.get(self.shift()).copied().unwrap_or(0.0);
        x.truncate(self.shift());
        let constants = |tie: bool| (0..self.is_tie.len()).filter(move |&k| self.is_tie[k] == tie);
        constants(true).for_each(|k| x[k * self.terms] += shift);
        let some_ties = self.is_tie.contains(&true);
        let level = match self.options.gauge {
            LevellingGauge::TiesHeld if some_ties => 0.0,
            LevellingGauge::TiesHeld | LevellingGauge::TiesMean => {
                let of: Vec<f64> = constants(some_ties).map(|k| x[k * self.terms]).collect();
                if of.is_empty() { 0.0 } else { of.iter().sum::<f64>() / of.len() as f64 }
            }
            LevellingGauge::Steadiest => {
                let [lines, ties] = found.spread_nt.each_ref().map(|s| s[0]);
                let mut of: Vec<f64> = constants(some_ties && ties < lines).map(|k| x[k * self.terms]).collect();
                if of.is_empty() { 0.0 } else { median(&mut of) }
            }
        };
        x.iter_mut().step_by(self.terms).for_each(|c| *c -= level);
        found
    }
}

/// Robust estimate of the scatter of values beyond their standard errors.
fn robust_width(values: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (mut sizes, mut errors): (Vec<f64>, Vec<f64>) = values.map(|(value, error)| (value.abs(), error)).unzip();
    if sizes.is_empty() {
        return 0.0;
    }
    ((1.4826 * median(&mut sizes)).powi(2) - median(&mut errors).powi(2)).max(0.0).sqrt()
}

/// Scatter of values about zero beyond their standard errors; zero if chance can explain it.
fn beyond_errors(values: &[(f64, f64)]) -> f64 {
    let n = values.len() as f64;
    let weight = |error: f64| 1.0 / (error * error);
    let squares: f64 = values.iter().map(|(value, error)| value * value * weight(*error)).sum();
    let weights: f64 = values.iter().map(|(_, error)| weight(*error)).sum();
    if values.is_empty() || squares <= n + BEYOND * (2.0 * n).sqrt() { 0.0 } else { ((squares - n) / weights).sqrt() }
}

/// The inverse, by rows, of a symmetric matrix to whose diagonal `least` is added.
fn inverse(mut a: Vec<f64>, n: usize, least: f64) -> Vec<f64> {
    (0..n).for_each(|i| a[i * n + i] += least.max(f64::MIN_POSITIVE));
    let mut out = vec![0.0; n * n];
    (0..n).for_each(|i| out[i * n + i] = 1.0);
    for k in 0..n {
        // Positive definite: no pivoting.
        let pivot = a[k * n + k];
        for j in 0..n {
            a[k * n + j] /= pivot;
            out[k * n + j] /= pivot;
        }
        for i in (0..n).filter(|i| *i != k) {
            let factor = a[i * n + k];
            for j in 0..n {
                a[i * n + j] -= factor * a[k * n + j];
                out[i * n + j] -= factor * out[k * n + j];
            }
        }
    }
    out
}

fn conjugate_gradients(
    apply: impl Fn(&[f64]) -> Vec<f64>,
    right: &[f64],
    diagonal: &[f64],
    mut x: Vec<f64>,
) -> Vec<f64> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let scaled = |a: &[f64]| a.iter().zip(diagonal).map(|(a, d)| a / d).collect::<Vec<f64>>();
    let mut rest: Vec<f64> = right.iter().zip(apply(&x)).map(|(b, a)| b - a).collect();
    let mut better = scaled(&rest);
    let mut direction = better.clone();
    let mut size = dot(&rest, &better);
    let enough = 1e-24 * dot(right, &scaled(right));
    for _ in 0..20 * x.len().max(10) {
        if size <= enough {
            break;
        }
        let moved = apply(&direction);
        let step = size / dot(&direction, &moved);
        x.iter_mut().zip(&direction).for_each(|(x, d)| *x += step * d);
        rest.iter_mut().zip(&moved).for_each(|(r, m)| *r -= step * m);
        better = scaled(&rest);
        let next = dot(&rest, &better);
        direction.iter_mut().zip(&better).for_each(|(d, b)| *d = b + next / size * *d);
        size = next;
    }
    x
}

/// Legendre's polynomials of orders 0 to `terms` - 1.
fn legendre(x: f64, terms: usize) -> Vec<f64> {
    let mut p = vec![1.0, x];
    for k in 2..terms {
        let order = k as f64;
        p.push(((2.0 * order - 1.0) * x * p[k - 1] - (order - 1.0) * p[k - 2]) / order);
    }
    p.truncate(terms);
    p
}
