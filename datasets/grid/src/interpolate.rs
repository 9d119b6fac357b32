//! Interpolation between the nodes of a projected grid. The interpolation is local, so unknown nodes affect only their
//! neighbourhood.

use numerics::maps::plane_grid::EvenAxis;

/// The value at a position in fractional node indices, or NaN.
///
/// A polynomial of ninth degree through the 10 x 10 nodes around the position gives the value. If one of these nodes is
/// unknown or beyond the edge, the polynomial has fifth or third degree and passes through 6 x 6 or 4 x 4 nodes. The
/// value is NaN if one of the 4 x 4 nodes is unknown. Between the outermost nodes, the 4 x 4 nodes nearest to the
/// position are used.
pub fn at(values: &[f64], x: &EvenAxis, y: &EvenAxis, column: f64, row: f64) -> f64 {
    let centred = |n: usize| {
        let fits = |place: f64, len: usize| {
            place.floor() + 1.0 >= (n / 2) as f64 && place.floor() + 1.0 + (n / 2) as f64 <= len as f64
        };
        fits(column, x.len) && fits(row, y.len)
    };
    let ten = || centred(10).then(|| through::<10>(values, x.len, y.len, column, row))?;
    let six = || centred(6).then(|| through::<6>(values, x.len, y.len, column, row))?;
    let four = || through::<4>(values, x.len, y.len, column, row);
    ten().or_else(six).or_else(four).unwrap_or(f64::NAN)
}

/// The value of the polynomial through N x N nodes; `None` where a node is unknown.
pub fn through<const N: usize>(values: &[f64], width: usize, height: usize, column: f64, row: f64) -> Option<f64> {
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

/// The index of the first of the N nodes around `place`, and the Lagrange weights of these nodes.
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

    fn axis(len: usize) -> EvenAxis {
        EvenAxis { first: 0.0, step: 1.0, len }
    }

    #[test]
    fn law_polynomials_of_degree_nine_five_and_three_are_exact() {
        let powers = |degree: i32| {
            move |x: f64, y: f64| {
                1.0 + (x / 10.0).powi(degree) - 2.0 * (y / 10.0).powi(degree) + (x * y / 100.0).powi(degree)
            }
        };
        for (degree, places) in [
            (9, vec![(4.0, 4.0), (7.3, 8.1), (14.9, 15.5)]),
            (5, vec![(2.0, 9.5), (2.2, 17.4), (16.4, 2.0)]),
            (3, vec![(0.0, 0.0), (0.3, 0.7), (19.0, 20.0), (18.7, 5.5)]),
        ] {
            let f = powers(degree);
            let values: Vec<f64> = (0..21).flat_map(|j| (0..20).map(move |i| f(f64::from(i), f64::from(j)))).collect();
            for (x, y) in places {
                // Rounding of a sum of a hundred products, with values up to 2^9 + 2^18.
                let error = at(&values, &axis(20), &axis(21), x, y) - f(x, y);
                assert!(error.abs() < 1e-8, "{degree} {x} {y}: {error}");
            }
        }
    }

    #[test]
    fn law_an_unknown_node_affects_positions_within_two_nodes() {
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
    fn law_a_grid_too_small_for_a_cubic_is_not_interpolated() {
        assert!(at(&[1.0; 9], &axis(3), &axis(3), 1.0, 1.0).is_nan());
    }
}
