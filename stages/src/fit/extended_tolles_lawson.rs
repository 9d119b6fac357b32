//! The extended model of Tolles and Lawson: the ridge, of the terms of currents and voltages as well.

use numerics::regression::least_squares::Prepared;
use schemas::Fault;

use super::{
    model::{Answer, FitModel, Settings, model},
    problem::Problem,
    ridge::{Penalty, lambdas_faults},
};

model! {
    /// The ridge of standardised columns, by the name that thesis 004 gives it with the terms of currents and voltages
    /// among its features, which `features` makes.
    ///
    /// Source: thesis 004, sections 2.2 to 2.4 and 4.2.1.
    ExtendedTollesLawson = "extended_tolles_lawson", scaling Standardise, intercept true, made of Moments,
    choose [Given, Gcv, LCurve, LeaveOneLineOut, LeaveOneFlightOut], takes [one_standard_error, whiten];
    lambda: f64,
    lambdas: Option<Vec<f64>>,
}

impl FitModel for ExtendedTollesLawson {
    fn fit(&self, problem: &Problem, settings: &Settings, prepared: &Prepared) -> Result<Answer, Fault> {
        Penalty { lambda: self.lambda, among: self.lambdas.as_deref() }.fit(problem, settings, prepared)
    }

    fn faults(&self, _: &Settings) -> Vec<Fault> {
        lambdas_faults(self.lambdas.as_deref())
    }

    fn lambda(&self) -> Option<f64> {
        Some(self.lambda)
    }

    fn is_ridge(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{fitted, number};

    #[test]
    fn law_it_is_the_ridge() {
        let [one, other] = ["extended_tolles_lawson", "ridge"].map(|model| fitted(model, &[number("lambda", 0.3)]));
        assert_eq!(one.value, other.value);
    }
}
