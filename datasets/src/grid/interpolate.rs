//! Interpolation between the nodes of a projected grid, local so that unknown nodes do no harm beyond
//! their neighbourhood.

use super::Axis;

/// The value at a place given in fractions of nodes, or NaN.
///
/// A polynomial of fifth degree through the 6 x 6 nodes around the place; where one of them is unknown,
/// of third degree through 4 x 4; NaN where one of those is unknown too. At the grid's edge the nodes
/// nearest to the place are taken. For a field of wavelength λ on nodes h apart the error is about
/// 0.005 (2πh/λ)^6 of its amplitude.
pub(super) fn at(values: &[f64], x: &Axis, y: &Axis, column: f64, row: f64) -> f64 {
    let six = through::<6>(values, x.len, y.len, column, row);
    six.or_else(|| through::<4>(values, x.len, y.len, column, row)).unwrap_or(f64::NAN)
}

fn through<const N: usize>(values: &[f64], width: usize, height: usize, column: f64, row: f64) -> Option<f64> {
    let (i, wx) = weights::<N>(column, width)?;
    let (j, wy) = weights::<N>(row, height)?;
    let mut sum = 0.0;
    for (dj, wy) in wy.iter().enumerate() {
        let from = (j + dj) * width + i;
        let line: f64 = values.get(from..from + N)?.iter().zip(&wx).map(|(v, w)| v * w).sum();
        sum += wy * line;
    }
    (!sum.is_nan()).then_some(sum)
}

/// The first of N nodes around `place` and Lagrange's weights of all of them.
fn weights<const N: usize>(place: f64, len: usize) -> Option<(usize, [f64; N])> {
    let most = len.checked_sub(N)?;
    let first = (place.floor() as usize).saturating_sub(N / 2 - 1).min(most);
    let t = place - first as f64;
    let mut weights = [1.0; N];
    for (k, weight) in weights.iter_mut().enumerate() {
        for m in (0..N).filter(|m| *m != k) {
            *weight *= (t - m as f64) / (k as f64 - m as f64);
        }
    }
    Some((first, weights))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(len: usize) -> Axis {
        Axis { first: 0.0, step: 1.0, len }
    }

    #[test]
    fn law_a_polynomial_of_fifth_degree_is_exact_also_at_the_edge() {
        let f = |x: f64, y: f64| 1.0 + x - 0.3 * x.powi(3) * y + 0.01 * x.powi(5) - 0.02 * y.powi(5) + x * y * y;
        let values: Vec<f64> = (0..9).flat_map(|j| (0..8).map(move |i| f(f64::from(i), f64::from(j)))).collect();
        for (x, y) in [(0.0, 0.0), (0.3, 0.7), (3.5, 4.5), (7.0, 8.0), (6.9, 7.2)] {
            // Values reach 600; 36 products of them.
            assert!((at(&values, &axis(8), &axis(9), x, y) - f(x, y)).abs() < 1e-10, "{x} {y}");
        }
    }

    #[test]
    fn law_unknown_nodes_are_felt_two_nodes_away_and_no_further() {
        let mut values = vec![7.0; 400];
        values[10 * 20 + 10] = f64::NAN;
        let value = |x: f64, y: f64| at(&values, &axis(20), &axis(20), x, y);
        for near in [(10.0, 10.0), (8.5, 10.0), (11.5, 11.5)] {
            assert!(value(near.0, near.1).is_nan(), "{near:?}");
        }
        for far in [(7.9, 10.0), (12.5, 10.2), (10.5, 13.0)] {
            // Weights sum to 1 within rounding.
            assert!((value(far.0, far.1) - 7.0).abs() < 1e-12, "{far:?}");
        }
    }

    #[test]
    fn law_a_grid_too_small_for_a_cubic_has_no_values_between() {
        assert!(at(&[1.0; 9], &axis(3), &axis(3), 1.0, 1.0).is_nan());
    }
}
