//! Sigma points of a position and the regression of a field over them.

use crate::earth::field_value::FieldValue;
use crate::navigation::pinson::StateMatrix;

use super::{NONLINEAR, UkfParameters};

/// Regression of a field over the uncertainty of a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FieldRegression {
    /// Mean of the field, in nT.
    pub(crate) mean_nt: f64,
    /// Change with latitude, longitude (nT/rad) and height (nT/m).
    pub(crate) slope: [f64; NONLINEAR],
    /// Variance of its nonlinear part, in nT².
    pub(crate) remainder_nt2: f64,
}

impl FieldRegression {
    /// First order of a field at its position.
    #[inline(always)]
    pub(crate) fn at(field: &FieldValue) -> Self {
        let slope = [field.d_lat_nt_per_rad, field.d_lon_nt_per_rad, field.d_alt_nt_per_m];
        Self { mean_nt: field.value_nt, slope, remainder_nt2: 0.0 }
    }
}

/// Distance and weights of the sigma points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SigmaPoints {
    /// Distance c of the points, in standard deviations.
    pub(crate) sigmas: f64,
    /// β − α².
    pub(crate) beyond: f64,
}

/// Variance of a direction given the previous directions, as a share of its variance, below which the direction is
/// exact, because the share is only rounding.
const ROUNDING: f64 = 1e-13;

impl SigmaPoints {
    pub(crate) fn from_parameters(parameters: &UkfParameters) -> Self {
        let UkfParameters { alpha, beta, kappa, .. } = *parameters;
        Self { sigmas: alpha * (NONLINEAR as f64 + kappa).sqrt(), beyond: beta - alpha * alpha }
    }

    /// Regression of a field with the value `centre_nt` at the position, and `value_at` at an offset from it (rad, rad,
    /// m); `None` if that returns `None`. `p` is a covariance whose first states are the position.
    #[inline(always)]
    pub(crate) fn regression(
        &self,
        p: &StateMatrix,
        centre_nt: f64,
        mut value_at: impl FnMut([f64; NONLINEAR]) -> Option<f64>,
    ) -> Option<FieldRegression> {
        let root = cholesky(p);
        let (mut first, mut sum, mut squares) = ([0.0; NONLINEAR], 0.0, 0.0);
        for (direction, first) in first.iter_mut().enumerate() {
            if root[direction][direction] > 0.0 {
                let away = root.map(|row| self.sigmas * row[direction]);
                let (ahead, behind) = (value_at(away)?, value_at(away.map(|part| -part))?);
                let second = 0.5 * ((ahead - centre_nt) + (behind - centre_nt));
                *first = (ahead - behind) / (2.0 * self.sigmas);
                sum += second;
                squares += second * second;
            }
        }
        let square = self.sigmas * self.sigmas;
        let shift_nt = sum / square;
        // At least 0 except for rounding.
        let remainder_nt2 = (squares / square + self.beyond * shift_nt * shift_nt).max(0.0);
        Some(FieldRegression { mean_nt: centre_nt + shift_nt, slope: solve_transposed(&root, first), remainder_nt2 })
    }
}

/// Lower Cholesky factor of the position's covariance; the column of an exactly known direction is 0.
#[inline(always)]
pub(crate) fn cholesky(p: &StateMatrix) -> [[f64; NONLINEAR]; NONLINEAR] {
    let mut root = [[0.0; NONLINEAR]; NONLINEAR];
    for column in 0..NONLINEAR {
        let known: f64 = root[column][..column].iter().map(|entry| entry * entry).sum();
        let left = p[column][column] - known;
        if left > ROUNDING * p[column][column] {
            let pivot = left.sqrt();
            root[column][column] = pivot;
            for row in column + 1..NONLINEAR {
                let shared: f64 = (0..column).map(|before| root[row][before] * root[column][before]).sum();
                root[row][column] = (p[row][column] - shared) / pivot;
            }
        }
    }
    root
}

/// Solution a of Lᵀ a = d; 0 in the directions whose column of L is 0.
#[inline(always)]
fn solve_transposed(root: &[[f64; NONLINEAR]; NONLINEAR], d: [f64; NONLINEAR]) -> [f64; NONLINEAR] {
    let mut a = [0.0; NONLINEAR];
    for row in (0..NONLINEAR).rev() {
        if root[row][row] > 0.0 {
            let later: f64 = (row + 1..NONLINEAR).map(|column| root[column][row] * a[column]).sum();
            a[row] = (d[row] - later) / root[row][row];
        }
    }
    a
}
