//! Limited-memory BFGS with a line search for the strong Wolfe conditions. [Nocedal & Wright 2006, algorithms 3.5, 3.6,
//! 7.4 and 7.5]

/// Sufficient decrease, as a fraction of the initial slope (c₁).
const DECREASE: f64 = 1e-4;
/// Maximum slope at the end of a step, as a fraction of the initial slope (c₂).
const CURVATURE: f64 = 0.9;
/// Maximum number of evaluations in a line search.
const EVALUATIONS: usize = 25;
/// The parameters are at the minimum if the largest entry of the gradient is below this value.
const LEAST_GRADIENT: f64 = 1e-10;

/// State of the L-BFGS method.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LbfgsState {
    /// The objective at the parameters.
    pub objective: f64,
    /// The gradient at the parameters; empty before the first step.
    pub gradient: Vec<f64>,
    /// The last steps and the change of the gradient over each step; the oldest step first.
    pub pairs: Vec<(Vec<f64>, Vec<f64>)>,
    /// Whether no step decreases the objective.
    pub ended: bool,
}

/// Function that returns the objective at parameters and writes its gradient.
pub(super) type ObjectiveFunction<'a> = dyn FnMut(&[f64], &mut [f64]) -> f64 + 'a;

/// Point of a line search: step, objective, slope and gradient.
#[derive(Clone)]
struct LineSearchPoint {
    step: f64,
    objective: f64,
    slope: f64,
    gradient: Vec<f64>,
}

impl LbfgsState {
    /// Advances `parameters` by one step.
    pub(super) fn step(&mut self, parameters: &mut [f64], memory: usize, evaluate: &mut ObjectiveFunction<'_>) {
        if self.gradient.len() != parameters.len() {
            self.gradient = vec![0.0; parameters.len()];
            self.objective = evaluate(parameters, &mut self.gradient);
        }
        let mut direction = self.direction();
        let mut slope = dot(&direction, &self.gradient);
        if slope >= 0.0 {
            self.pairs.clear();
            direction = self.direction();
            slope = dot(&direction, &self.gradient);
        }
        let finite = slope.is_finite() && self.objective.is_finite();
        if !finite || largest(&self.gradient) <= LEAST_GRADIENT {
            self.ended = true;
            return;
        }
        let first = if self.pairs.is_empty() {
            (1.0 / self.gradient.iter().map(|g| g.abs()).sum::<f64>()).min(1.0)
        } else {
            1.0
        };
        let start = LineSearchPoint { step: 0.0, objective: self.objective, slope, gradient: self.gradient.clone() };
        let from = parameters.to_vec();
        let mut at = |step: f64| {
            let place: Vec<f64> = from.iter().zip(&direction).map(|(x, d)| x + step * d).collect();
            let mut gradient = vec![0.0; place.len()];
            let objective = evaluate(&place, &mut gradient);
            LineSearchPoint { step, objective, slope: dot(&gradient, &direction), gradient }
        };
        let end = search(&start, first, largest(&direction), &mut at);
        let lower = end.objective < self.objective;
        if !lower {
            self.ended = true;
            return;
        }
        parameters.iter_mut().zip(&direction).for_each(|(x, d)| *x += end.step * d);
        let moved: Vec<f64> = direction.iter().map(|d| end.step * d).collect();
        let change: Vec<f64> = end.gradient.iter().zip(&self.gradient).map(|(after, before)| after - before).collect();
        // A pair without positive curvature could make the next direction an ascent direction.
        if dot(&moved, &change) > 1e-10 * dot(&change, &change) {
            self.pairs.push((moved, change));
            let surplus = self.pairs.len().saturating_sub(memory);
            self.pairs.drain(..surplus);
        }
        (self.objective, self.gradient) = (end.objective, end.gradient);
    }

    /// The direction of the next step: minus the approximate inverse Hessian times the gradient.
    fn direction(&self) -> Vec<f64> {
        let mut q: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        let mut parts = Vec::with_capacity(self.pairs.len());
        for (moved, change) in self.pairs.iter().rev() {
            let part = dot(moved, &q) / dot(moved, change);
            q.iter_mut().zip(change).for_each(|(q, c)| *q -= part * c);
            parts.push(part);
        }
        if let Some((moved, change)) = self.pairs.last() {
            let scale = dot(moved, change) / dot(change, change);
            q.iter_mut().for_each(|q| *q *= scale);
        }
        for ((moved, change), part) in self.pairs.iter().zip(parts.iter().rev()) {
            let back = dot(change, &q) / dot(moved, change);
            q.iter_mut().zip(moved).for_each(|(q, m)| *q += (part - back) * m);
        }
        q
    }
}

/// A step that satisfies the Wolfe conditions, or the best evaluated step if the number of evaluations does not
/// suffice.
fn search(
    start: &LineSearchPoint,
    first: f64,
    longest: f64,
    at: &mut dyn FnMut(f64) -> LineSearchPoint,
) -> LineSearchPoint {
    let too_high = |place: &LineSearchPoint| {
        !place.objective.is_finite() || place.objective > start.objective + DECREASE * place.step * start.slope
    };
    let flat = |place: &LineSearchPoint| place.slope.abs() <= -CURVATURE * start.slope;
    let mut before = start.clone();
    let mut here = at(first);
    let mut left = EVALUATIONS - 1;
    // Steps grow until they bracket a minimum.
    let (mut low, mut high) = loop {
        if too_high(&here) || (before.step > 0.0 && here.objective >= before.objective) {
            break (before, here);
        }
        if flat(&here) {
            return here;
        }
        if here.slope >= 0.0 {
            break (here, before);
        }
        if left == 0 {
            return here;
        }
        let least = here.step + 0.01 * (here.step - before.step);
        let next = at(cubic_minimum(&before, &here).clamp(least, 10.0 * here.step));
        left -= 1;
        (before, here) = (here, next);
    };
    // The bracket shrinks between `low`, the end with the smaller objective, and `high`.
    let mut stuck = false;
    while left > 0 && (high.step - low.step).abs() * longest > 1e-16 {
        let (least, most) = (low.step.min(high.step), low.step.max(high.step));
        let margin = 0.1 * (most - least);
        let mut step = if high.objective.is_finite() { cubic_minimum(&low, &high) } else { 0.5 * (least + most) };
        if !(step >= least && step <= most) {
            step = 0.5 * (least + most);
        }
        // A second successive step near an end of the bracket would make little progress and is moved away from that
        // end.
        if (most - step).min(step - least) < margin {
            if stuck || step >= most || step <= least {
                step = if most - step < step - least { most - margin } else { least + margin };
                stuck = false;
            } else {
                stuck = true;
            }
        } else {
            stuck = false;
        }
        let here = at(step);
        left -= 1;
        if too_high(&here) || here.objective >= low.objective {
            high = here;
        } else {
            if flat(&here) {
                return here;
            }
            if here.slope * (high.step - low.step) >= 0.0 {
                high = low;
            }
            low = here;
        }
    }
    low
}

/// Minimum of the cubic through the values and slopes of two points; the midpoint if the cubic has no minimum.
fn cubic_minimum(one: &LineSearchPoint, other: &LineSearchPoint) -> f64 {
    let (a, b) = if one.step <= other.step { (one, other) } else { (other, one) };
    let d1 = a.slope + b.slope - 3.0 * (a.objective - b.objective) / (a.step - b.step);
    let square = d1 * d1 - a.slope * b.slope;
    if square < 0.0 {
        return 0.5 * (a.step + b.step);
    }
    let d2 = square.sqrt();
    b.step - (b.step - a.step) * ((b.slope + d2 - d1) / (b.slope - a.slope + 2.0 * d2))
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn largest(x: &[f64]) -> f64 {
    x.iter().fold(0.0, |most, x| x.abs().max(most))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn minimised(
        start: &[f64],
        steps: usize,
        mut evaluate: impl FnMut(&[f64], &mut [f64]) -> f64,
    ) -> (Vec<f64>, LbfgsState) {
        let (mut x, mut state) = (start.to_vec(), LbfgsState::default());
        for _ in 0..steps {
            state.step(&mut x, 10, &mut evaluate);
        }
        (x, state)
    }

    #[test]
    fn ref_the_rosenbrock_function_is_minimised_at_one_and_one() {
        let (x, state) = minimised(&[-1.2, 1.0], 60, |x, gradient| {
            let (a, b) = (1.0 - x[0], x[1] - x[0] * x[0]);
            gradient[0] = -2.0 * a - 400.0 * x[0] * b;
            gradient[1] = 200.0 * b;
            a * a + 100.0 * b * b
        });
        assert!((x[0] - 1.0).abs() < 1e-8 && (x[1] - 1.0).abs() < 1e-8, "{x:?}");
        assert!(state.ended);
    }

    #[test]
    fn unit_unbounded_or_non_finite_objectives_end_without_a_panic() {
        let (x, _) = minimised(&[1.0], 5, |x, gradient| {
            gradient[0] = 1.0;
            x[0]
        });
        assert!(x[0] < -1.0);
        let (x, state) = minimised(&[1.0], 5, |_, gradient| {
            gradient[0] = f64::NAN;
            f64::NAN
        });
        assert!(x == [1.0] && state.ended);
        // The objective is infinite beyond 2, and its minimum is below 2.
        let (x, _) = minimised(&[0.0], 50, |x, gradient| {
            gradient[0] = -1.0 + 1.0 / (2.0 - x[0]).powi(2);
            if x[0] < 2.0 { -x[0] + 1.0 / (2.0 - x[0]) } else { f64::INFINITY }
        });
        assert!((x[0] - 1.0).abs() < 1e-8, "{x:?}");
    }
}
