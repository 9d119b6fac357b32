//! The Tolles-Lawson model: a ridge of unscaled columns.

use super::{
    model::model,
    ridge::{RidgeModel, RidgePenalty},
};

model! {
    /// Minimises \|y - A b\|^2 + `lambda` \|b\|^2 with unscaled columns and without a constant. Here y is the target, A
    /// is the A-matrix and b are the coefficients. The feature is `tl`, which `a_matrix` computes. With `lambda = 0`
    /// the fit is ordinary least squares.
    ///
    /// Source: Tolles and Lawson 1950; Leliak 1961; Gnadt 2022, (3.19) to (3.43).
    TollesLawson = "tolles_lawson", version 1, scaling None, intercept false, made of Moments,
    choose [Given, Gcv, LCurve, LeaveOneLineOut, LeaveOneFlightOut], takes [one_standard_error, whiten],
    groups [penalty: RidgePenalty], example "lambda = 0.025";
}

impl RidgeModel for TollesLawson {
    fn penalty(&self) -> &RidgePenalty {
        &self.penalty
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{COEFFICIENTS, fitted, flag, number, word};

    #[test]
    fn unit_the_truth_is_recovered_with_an_optional_constant() {
        let found = fitted("tolles_lawson", &[number("lambda", 0.0), flag("intercept", true)]).value;
        assert!(found.iter().zip(COEFFICIENTS).all(|(a, b)| (a - b).abs() < 1e-9 * b.abs()), "{found:?}");
        assert_eq!(fitted("tolles_lawson", &[number("lambda", 0.0)]).value.len(), 3);
    }

    #[test]
    fn unit_the_fit_equals_the_ridge_of_unscaled_columns() {
        let one = fitted("tolles_lawson", &[number("lambda", 0.3)]);
        let other = fitted("ridge", &[number("lambda", 0.3), word("scaling", "none"), flag("intercept", false)]);
        assert_eq!(one.value, other.value);
    }
}
