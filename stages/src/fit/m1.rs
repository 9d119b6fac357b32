//! A network without a linear model.

use learning::network::NetworkForm;

use super::{
    model::{FitModel, model},
    network::{NetworkKeys, NetworkModel},
};

model! {
    /// A network N predicts the target from standardised inputs x. The model requires hours of data to outperform
    /// linear models. It does not generalise to attitudes and electric currents outside its training data.
    ///
    /// Source: Gnadt 2022, section 4.2, model 1; Gnadt, Wollaber & Nielsen 2022.
    M1 = "m1", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [whiten],
    groups [network: NetworkKeys], example "epochs = 5";
}

impl FitModel for M1 {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel::new(&self.network, NetworkForm::Plain))
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{bent, fitted_to, number, whole};

    #[test]
    fn unit_m1_fits_a_nonlinear_target() {
        let keys = [number("learning_rate", 0.01), whole("epochs", 100), whole("lbfgs_epochs", 400)];
        let straight = fitted_to(&bent(), "ridge", &[number("lambda", 0.0)]).residual_std;
        let found = fitted_to(&bent(), "m1", &keys).residual_std;
        assert!(found < 0.1 * straight, "{found} {straight}");
    }
}
