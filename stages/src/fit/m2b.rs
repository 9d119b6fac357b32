//! A network added to a fixed linear model.

use learning::network::NetworkForm;

use super::{
    model::{FitModel, model},
    network::{LinearPart, NetworkKeys, NetworkModel},
};

model! {
    /// A network N predicts the residual of the linear model `a . b`, so the prediction is `a . b + N(x)`. Here `a` is
    /// the vector of Tolles-Lawson terms, and `x` is the vector of inputs of the network. The coefficients b are from a
    /// ridge fit to band-passed terms and are not trained.
    ///
    /// Source: Gnadt 2022, section 4.4.
    M2b = "m2b", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [whiten],
    groups [network: NetworkKeys, part: LinearPart], example "epochs = 5";
}

impl FitModel for M2b {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel { linear: Some(&self.part), ..NetworkModel::new(&self.network, NetworkForm::FixedLinear) })
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{bent, fitted_to, number, whole, words};

    #[test]
    fn unit_m2b_fits_a_nonlinear_target() {
        let keys = [
            words("linear", &["a", "b", "c"]),
            number("learning_rate", 0.01),
            whole("epochs", 300),
            whole("batch", 64),
        ];
        let straight = fitted_to(&bent(), "ridge", &[number("lambda", 0.0)]).residual_std;
        let found = fitted_to(&bent(), "m2b", &keys).residual_std;
        assert!(found < 0.1 * straight, "{found} {straight}");
    }
}
