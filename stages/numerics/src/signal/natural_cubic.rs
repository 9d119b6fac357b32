//! Natural cubic spline interpolation in one dimension, as B-spline coefficients.
//!
//! With even steps the interpolating spline is `f(i + t) = Σ c[i-1+k] w_k(t)`, k = 0..3, with the basis of [`weights`].
//! "Natural" means a zero second derivative at both ends; MagNav.jl's cubic map interpolation is the tensor product of
//! two such splines.

/// Converts every column of a row-major table of `rows` x `columns` node values to B-spline coefficients in the
/// direction from row to row. The end coefficients are the end values themselves; inside, `c[i-1] + 4 c[i] + c[i+1] = 6
/// f[i]`.
pub fn solve_along_rows(table: &mut [f64], columns: usize) {
    let rows = table.len().checked_div(columns).unwrap_or(0);
    if rows < 3 {
        return;
    }
    let pivots = pivots(rows);
    for row in 1..rows - 1 {
        let (above, here) = table.split_at_mut(row * columns);
        let previous = &above[(row - 1) * columns..];
        for (value, before) in here[..columns].iter_mut().zip(previous) {
            *value = (6.0 * *value - before) * pivots[row];
        }
    }
    for row in (1..rows - 1).rev() {
        let (here, below) = table[row * columns..].split_at_mut(columns);
        for (value, after) in here.iter_mut().zip(below) {
            *value -= pivots[row] * *after;
        }
    }
}

/// Same as [`solve_along_rows`], for a single series of values.
pub fn solve(values: &mut [f64]) {
    solve_along_rows(values, 1);
}

/// Coefficient at position `k` among `n` coefficients padded by one on each side; `inside` returns the coefficients
/// without padding. A padding coefficient is the linear continuation, which has no curvature at the end.
pub fn past_ends(k: usize, n: usize, inside: impl Fn(usize) -> f64) -> f64 {
    if k == 0 {
        2.0 * inside(0) - inside(1)
    } else if k > n {
        2.0 * inside(n - 1) - inside(n - 2)
    } else {
        inside(k - 1)
    }
}

/// Reciprocal pivots of the tridiagonal system; the first row's coefficient is already known.
fn pivots(rows: usize) -> Vec<f64> {
    let mut pivots = vec![0.0; rows];
    for row in 1..rows - 1 {
        pivots[row] = 1.0 / (4.0 - pivots[row - 1]);
    }
    pivots
}

/// The four basis weights at a fraction `t` (0 to 1) of a step past the second of four nodes.
pub fn weights(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    let (t2, s2) = (t * t, s * s);
    const SIXTH: f64 = 1.0 / 6.0;
    [s2 * s * SIXTH, (4.0 - 6.0 * t2 + 3.0 * t2 * t) * SIXTH, (4.0 - 6.0 * s2 + 3.0 * s2 * s) * SIXTH, t2 * t * SIXTH]
}

/// The derivatives of [`weights`] with respect to `t`.
pub fn slope_weights(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [-0.5 * s * s, t * (1.5 * t - 2.0), s * (2.0 - 1.5 * s), 0.5 * t * t]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evaluate(coefficients: &[f64], at: f64, weights: [f64; 4]) -> f64 {
        let n = coefficients.len();
        let cell = (at as usize).min(n - 2);
        let padded = |k: usize| match (cell + k).checked_sub(1) {
            None => 2.0 * coefficients[0] - coefficients[1],
            Some(i) if i == n => 2.0 * coefficients[n - 1] - coefficients[n - 2],
            Some(i) => coefficients[i],
        };
        (0..4).map(|k| padded(k) * weights[k]).sum()
    }

    #[test]
    fn val_scipy_natural_spline() {
        // scipy 1.17.1: CubicSpline(range(6), [3,-1,4,1,-5,9], bc_type='natural') and derivative,
        // see reference/navigation/make_reference.py.
        let mut c = [3.0, -1.0, 4.0, 1.0, -5.0, 9.0];
        solve(&mut c);
        for (at, value, slope) in SCIPY {
            let t = at - at.floor();
            assert!((evaluate(&c, at, weights(t)) - value).abs() < 1e-13, "{at}");
            assert!((evaluate(&c, at, slope_weights(t)) - slope).abs() < 1e-13, "{at}");
        }
    }

    const SCIPY: [(f64, f64, f64); 4] = include!("../../reference/navigation/natural_cubic.in");

    #[test]
    fn law_passes_through_its_nodes_and_keeps_straight_lines() {
        let values = [2.0, 7.0, -3.0, 0.5, 11.0];
        let mut c = values;
        solve(&mut c);
        for (i, value) in values.iter().enumerate() {
            let (at, t) = if i == 4 { (4.0, 1.0) } else { (i as f64, 0.0) };
            assert!((evaluate(&c, at, weights(t)) - value).abs() < 1e-13);
        }
        let mut line = [1.0, 3.0, 5.0, 7.0];
        solve(&mut line);
        assert!((evaluate(&line, 1.3, weights(0.3)) - 3.6).abs() < 1e-14);
    }

    #[test]
    fn law_weights_are_a_partition_of_one() {
        for t in [0.0, 0.25, 0.7, 1.0] {
            assert!((weights(t).iter().sum::<f64>() - 1.0).abs() < 1e-15);
            assert!(slope_weights(t).iter().sum::<f64>().abs() < 1e-15);
        }
    }

    #[test]
    fn unit_short_columns_are_unchanged() {
        let mut two = [1.0, 2.0];
        solve(&mut two);
        assert_eq!(two, [1.0, 2.0]);
        solve_along_rows(&mut [], 0);
    }
}
