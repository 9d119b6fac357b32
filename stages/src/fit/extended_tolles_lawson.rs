//! The extended Tolles-Lawson model: a ridge with terms of currents and voltages.

use super::{
    model::model,
    ridge::{RidgeModel, RidgePenalty},
};

model! {
    /// Ridge regression with standardised columns: the model `ridge` under the name in van der Meer 2025. The features
    /// include terms for electric currents and voltages, which the `features` stage computes.
    ///
    /// Source: van der Meer 2025, sections 2.2 to 2.4 and 4.2.1.
    ExtendedTollesLawson = "extended_tolles_lawson", version 1, scaling Standardise, intercept true, made of Moments,
    choose [Given, Gcv, LCurve, LeaveOneLineOut, LeaveOneFlightOut], takes [one_standard_error, whiten],
    groups [penalty: RidgePenalty], example "lambda = 0.025";
}

impl RidgeModel for ExtendedTollesLawson {
    fn penalty(&self) -> &RidgePenalty {
        &self.penalty
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{fitted, number};

    #[test]
    fn unit_the_fit_equals_the_ridge() {
        let [one, other] = ["extended_tolles_lawson", "ridge"].map(|model| fitted(model, &[number("lambda", 0.3)]));
        assert_eq!(one.value, other.value);
    }
}
