//! Differences of a series per sample, which replace time derivatives in Tolles-Lawson terms.
//!
//! All schemes are the same as in MagNav.jl's `fdm`. No scheme divides by the time step, so the result has the unit of
//! the series (per sample).

/// Scheme of the difference at a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DifferenceScheme {
    /// (x₊₁ − x₋₁)/2, second order; the ends are one-sided first differences.
    #[default]
    Central,
    /// x − x₋₁; the first row repeats the second row.
    Backward,
    /// x₊₁ − x; the last row repeats the previous row.
    Forward,
    /// (3x − 4x₋₁ + x₋₂)/2, second order; the first two rows are first differences.
    Backward2,
    /// (−x₊₂ + 4x₊₁ − 3x)/2, second order; the last two rows are first differences.
    Forward2,
    /// The fourth difference (x₋₂ − 4x₋₁ + 6x − 4x₊₁ + x₊₂)/16; the first and last two rows are 0.
    Fourth,
}

impl DifferenceScheme {
    /// Minimum number of samples of the scheme.
    pub fn least_rows(self) -> usize {
        match self {
            Self::Central | Self::Backward | Self::Forward => 2,
            Self::Backward2 | Self::Forward2 => 3,
            Self::Fourth => 5,
        }
    }
}

/// The differences of `x` per sample, in the unit of `x`.
///
/// `None` if `x` has fewer samples than [`DifferenceScheme::least_rows`]. In this case, MagNav.jl returns zeros, which
/// look like a quiet signal.
pub fn difference(x: &[f64], scheme: DifferenceScheme) -> Option<Vec<f64>> {
    let n = x.len();
    if n < scheme.least_rows() {
        return None;
    }
    let (first, last) = (x[1] - x[0], x[n - 1] - x[n - 2]);
    let near = |i: usize| match scheme {
        DifferenceScheme::Central => (x[i + 1] - x[i - 1]) / 2.0,
        DifferenceScheme::Backward => x[i] - x[i - 1],
        DifferenceScheme::Forward => x[i + 1] - x[i],
        DifferenceScheme::Backward2 => (3.0 * x[i] - 4.0 * x[i - 1] + x[i - 2]) / 2.0,
        DifferenceScheme::Forward2 => (-x[i + 2] + 4.0 * x[i + 1] - 3.0 * x[i]) / 2.0,
        DifferenceScheme::Fourth => (x[i - 2] - 4.0 * x[i - 1] + 6.0 * x[i] - 4.0 * x[i + 1] + x[i + 2]) / 16.0,
    };
    let (head, tail) = match scheme {
        DifferenceScheme::Central => (vec![first], vec![last]),
        DifferenceScheme::Backward => (vec![first], vec![]),
        DifferenceScheme::Forward => (vec![], vec![last]),
        DifferenceScheme::Backward2 => (vec![first, x[2] - x[1]], vec![]),
        DifferenceScheme::Forward2 => (vec![], vec![x[n - 2] - x[n - 3], last]),
        DifferenceScheme::Fourth => (vec![0.0; 2], vec![0.0; 2]),
    };
    let middle = head.len()..n - tail.len();
    let middle: Vec<f64> = middle.map(near).collect();
    Some([head, middle, tail].concat())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    const ALL: [DifferenceScheme; 6] = [
        DifferenceScheme::Central,
        DifferenceScheme::Backward,
        DifferenceScheme::Forward,
        DifferenceScheme::Backward2,
        DifferenceScheme::Forward2,
        DifferenceScheme::Fourth,
    ];

    /// MagNav.jl 1.3.3 `fdm` of [1,4,9,16,25,36,50]: exact, because all values are short binary fractions.
    #[test]
    fn val_all_schemes_equal_magnav() {
        let x = [1.0, 4.0, 9.0, 16.0, 25.0, 36.0, 50.0];
        let expected = [
            [3.0, 4.0, 6.0, 8.0, 10.0, 12.5, 14.0],
            [3.0, 3.0, 5.0, 7.0, 9.0, 11.0, 14.0],
            [3.0, 5.0, 7.0, 9.0, 11.0, 14.0, 14.0],
            [3.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.5],
            [2.0, 4.0, 6.0, 8.0, 9.5, 11.0, 14.0],
            [0.0, 0.0, 0.0, 0.0, 0.0625, 0.0, 0.0],
        ];
        for (scheme, expected) in ALL.into_iter().zip(expected) {
            assert_eq!(difference(&x, scheme).unwrap(), expected, "{scheme:?}");
        }
    }

    #[test]
    fn law_a_straight_line_has_its_slope_everywhere() {
        let x: Vec<f64> = (0..9).map(|i| 7.0 - 0.25 * f64::from(i)).collect();
        for scheme in ALL {
            let slope = if scheme == DifferenceScheme::Fourth { 0.0 } else { -0.25 };
            assert_eq!(difference(&x, scheme).unwrap(), vec![slope; 9], "{scheme:?}");
        }
    }

    #[test]
    fn unit_the_shortest_series_of_each_scheme_works_and_a_shorter_one_is_rejected() {
        for scheme in ALL {
            let least = scheme.least_rows();
            assert_eq!(difference(&vec![1.0; least], scheme), Some(vec![0.0; least]));
            assert_eq!(difference(&vec![1.0; least - 1], scheme), None, "{scheme:?}");
        }
    }
}
