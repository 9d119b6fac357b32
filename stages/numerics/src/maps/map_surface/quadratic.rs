//! Interpolating quadratic B-spline with even steps and pieces centred on the nodes (MagNav.jl's `quad`).
//!
//! Within half a step of node `i` the spline is `c[i-1] w₀(t) + c[i] w₁(t) + c[i+1] w₂(t)`, with t counted from the
//! node. The spline passes through the nodes if `c[i-1] + 6 c[i] + c[i+1] = 8 f[i]`. Beyond both ends the spline is
//! linear, with `c[i] = f[i]` there.

/// Converts every column of a row-major table from node values to spline coefficients.
pub(super) fn solve_along_rows(table: &mut [f64], columns: usize) {
    let rows = table.len().checked_div(columns).unwrap_or(0);
    if rows < 3 {
        return;
    }
    let mut pivots = vec![0.0; rows];
    for row in 1..rows - 1 {
        pivots[row] = 1.0 / (6.0 - pivots[row - 1]);
        let (above, here) = table.split_at_mut(row * columns);
        let previous = &above[(row - 1) * columns..];
        for (value, before) in here[..columns].iter_mut().zip(previous) {
            *value = (8.0 * *value - before) * pivots[row];
        }
    }
    for row in (1..rows - 1).rev() {
        let (here, below) = table[row * columns..].split_at_mut(columns);
        for (value, after) in here.iter_mut().zip(below) {
            *value -= pivots[row] * *after;
        }
    }
}

/// Weights of the nodes -1, 0, 1 and 2 for a position at a fraction `t` (0 to 1) past node 0; the farthest node has
/// zero weight.
#[inline(always)]
pub(super) fn weights(t: f64) -> [f64; 4] {
    piece(t, |u| [0.5 * (0.5 - u) * (0.5 - u), 0.75 - u * u, 0.5 * (0.5 + u) * (0.5 + u)])
}

/// The derivatives of [`weights`] with respect to `t`.
#[inline(always)]
pub(super) fn slope_weights(t: f64) -> [f64; 4] {
    piece(t, |u| [u - 0.5, -2.0 * u, u + 0.5])
}

/// Second derivatives of [`weights`] with respect to `t`, for the piece that contains `t`.
pub(super) fn curvature_weights(t: f64) -> [f64; 4] {
    piece(t, |_| [1.0, -2.0, 1.0])
}

/// The three weights of the piece centred on the nearer node, placed among the four nodes.
#[inline(always)]
fn piece(t: f64, of: impl Fn(f64) -> [f64; 3]) -> [f64; 4] {
    let upper = t >= 0.5;
    let [before, at, after] = of(if upper { t - 1.0 } else { t });
    if upper { [0.0, before, at, after] } else { [before, at, after, 0.0] }
}
