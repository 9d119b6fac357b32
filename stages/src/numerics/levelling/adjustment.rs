//! The least-squares adjustment of lines by their crossovers.

use super::super::gridding::{SurveyPoints, median};
use super::{Crossover, Gauge, LevelOptions};
use std::collections::BTreeMap;

/// Rounds of reweighting: a wrong crossover's pull falls to about a third in each.
const ROUNDS: usize = 20;

/// Differences are not told apart more finely than this, nT: weights stay well above the ridge.
const RESOLUTION_NT: f64 = 0.01;

/// The equations: one a crossover, few coefficients each.
pub(super) struct Adjustment<'a> {
    points: SurveyPoints<'a>,
    /// The first point and the last of each line, and the place of its coefficients.
    lines: BTreeMap<usize, (usize, usize, usize)>,
    terms: usize,
    rows: Vec<Vec<(usize, f64)>>,
    right: Vec<f64>,
    held: Vec<bool>,
    gauge: Vec<usize>,
    options: &'a LevelOptions,
}

impl<'a> Adjustment<'a> {
    pub fn of(
        points: SurveyPoints<'a>,
        lines: &[usize],
        crossovers: &[Crossover],
        ties: &[usize],
        options: &'a LevelOptions,
    ) -> Self {
        let terms = options.order + 1;
        let mut ends: BTreeMap<usize, (usize, usize, usize)> =
            lines.iter().enumerate().map(|(k, &line)| (line, (usize::MAX, 0, k * terms))).collect();
        for run in points.runs() {
            if let Some(end) = ends.get_mut(&points.line[run.start]) {
                (end.0, end.1) = (end.0.min(run.start), end.1.max(run.end - 1));
            }
        }
        let is_tie = |line: &usize| ties.contains(line);
        let held = lines.iter().flat_map(|l| vec![options.gauge == Gauge::TiesHeld && is_tie(l); terms]).collect();
        let tied: Vec<usize> = (0..lines.len()).filter(|&k| is_tie(&lines[k])).collect();
        let gauge = if tied.is_empty() { (0..lines.len()).collect() } else { tied };
        let mut made = Self { points, lines: ends, terms, rows: Vec::new(), right: Vec::new(), held, gauge, options };
        made.rows = crossovers.iter().map(|c| made.row(c)).collect();
        made.right = crossovers.iter().map(Crossover::difference_nt).collect();
        made
    }

    /// Where a point lies along its line, -1 to 1, `part` of the way to the next, and its line's coefficients.
    fn place(&self, point: usize, part: f64) -> (f64, usize) {
        let (first, last, at) =
            self.points.line.get(point).and_then(|line| self.lines.get(line)).copied().unwrap_or((0, 0, 0));
        let whole = last.saturating_sub(first).max(1) as f64;
        (2.0 * (point.saturating_sub(first) as f64 + part) / whole - 1.0, at)
    }

    fn row(&self, crossover: &Crossover) -> Vec<(usize, f64)> {
        let side = |k: usize| {
            let (along, at) = self.place(crossover.points[k], crossover.parts[k]);
            let sign = if k == 0 { 1.0 } else { -1.0 };
            legendre(along, self.terms).into_iter().enumerate().map(move |(j, p)| (at + j, sign * p))
        };
        side(0).chain(side(1)).filter(|(j, _)| !self.held[*j]).collect()
    }

    /// The correction at a point, `part` of the way to the next, nT.
    pub fn correction(&self, coefficients: &[f64], point: usize, part: f64) -> f64 {
        let (along, at) = self.place(point, part);
        legendre(along, self.terms).iter().zip(&coefficients[at..]).map(|(p, c)| p * c).sum()
    }

    pub fn of_line(&self, coefficients: &[f64], line: usize) -> Vec<f64> {
        let at = self.lines.get(&line).map_or(0, |l| l.2);
        coefficients[at..at + self.terms].to_vec()
    }

    /// The differences that corrections leave, nT.
    pub fn differences(&self, coefficients: &[f64]) -> Vec<f64> {
        let left =
            |(row, d): (&Vec<(usize, f64)>, &f64)| d - row.iter().map(|(j, p)| p * coefficients[*j]).sum::<f64>();
        self.rows.iter().zip(&self.right).map(left).collect()
    }

    /// The coefficients from the crossovers that `used` takes.
    pub fn solve(&self, used: impl Fn(usize) -> bool) -> Vec<f64> {
        let mut weights: Vec<f64> = (0..self.rows.len()).map(|k| f64::from(u8::from(used(k)))).collect();
        let mut coefficients = vec![0.0; self.held.len()];
        for _ in 0..ROUNDS {
            coefficients = self.weighted(&weights, coefficients);
            if !self.options.huber_sigmas.is_finite() {
                break;
            }
            let left = self.differences(&coefficients);
            let mut sizes: Vec<f64> = (0..left.len()).filter(|&k| used(k)).map(|k| left[k].abs()).collect();
            let limit = self.options.huber_sigmas * (1.4826 * median(&mut sizes)).max(RESOLUTION_NT);
            let weigh = |(k, d): (usize, &f64)| if used(k) { (limit / d.abs()).min(1.0) } else { 0.0 };
            weights = left.iter().enumerate().map(weigh).collect();
        }
        self.centred(coefficients)
    }

    /// Takes the gauge lines' mean off all constants; where ties are held there is nothing to take off.
    fn centred(&self, mut coefficients: Vec<f64>) -> Vec<f64> {
        if self.held.contains(&true) || self.gauge.is_empty() {
            return coefficients;
        }
        let mean = self.gauge.iter().map(|k| coefficients[k * self.terms]).sum::<f64>() / self.gauge.len() as f64;
        coefficients.iter_mut().step_by(self.terms).for_each(|c| *c -= mean);
        coefficients
    }

    /// Weighted least squares with the ridge, by conjugate gradients from a start.
    fn weighted(&self, weights: &[f64], start: Vec<f64>) -> Vec<f64> {
        let normal = |x: &[f64]| {
            let mut out: Vec<f64> = x.iter().map(|v| self.options.ridge * v).collect();
            for (row, w) in self.rows.iter().zip(weights) {
                let along = w * row.iter().map(|(j, p)| p * x[*j]).sum::<f64>();
                row.iter().for_each(|(j, p)| out[*j] += along * p);
            }
            out
        };
        let mut right = vec![0.0; start.len()];
        for ((row, w), d) in self.rows.iter().zip(weights).zip(&self.right) {
            row.iter().for_each(|(j, p)| right[*j] += w * d * p);
        }
        conjugate_gradients(normal, &right, start)
    }
}

fn conjugate_gradients(apply: impl Fn(&[f64]) -> Vec<f64>, right: &[f64], mut x: Vec<f64>) -> Vec<f64> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let mut rest: Vec<f64> = right.iter().zip(apply(&x)).map(|(b, a)| b - a).collect();
    let mut direction = rest.clone();
    let mut size = dot(&rest, &rest);
    let enough = 1e-24 * dot(right, right);
    for _ in 0..20 * x.len().max(10) {
        if size <= enough {
            break;
        }
        let moved = apply(&direction);
        let step = size / dot(&direction, &moved);
        x.iter_mut().zip(&direction).for_each(|(x, d)| *x += step * d);
        rest.iter_mut().zip(&moved).for_each(|(r, m)| *r -= step * m);
        let next = dot(&rest, &rest);
        direction.iter_mut().zip(&rest).for_each(|(d, r)| *d = r + next / size * *d);
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
