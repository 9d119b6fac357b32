//! A network that predicts corrections to coefficients.

use learning::network::NetworkForm;
use schemas::Rule;

use super::{
    model::{FitModel, model},
    network::{LinearPart, NetworkKeys, NetworkModel},
};

model! {
    /// The network predicts corrections to the ridge coefficients b as functions of the inputs x. The prediction is a .
    /// (b + N(x)), where a is the vector of terms.
    ///
    /// Source: Gnadt 2022, section 4.6; Gnadt, Wollaber & Nielsen 2022.
    M2d = "m2d", version 3, scaling Standardise, intercept true, made of Samples, choose [Given], takes [whiten],
    groups [network: NetworkKeys, part: LinearPart], example "epochs = 5";
    /// Weight of an additional term of the loss function: the squared difference between the prediction and the ridge
    /// fit of the linear terms. This difference is divided by the scale of the target.
    physics: f64, unit "1", default 0.0, rule Rule::NotNegative;
}

impl FitModel for M2d {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel {
            linear: Some(&self.part),
            physics: self.physics,
            ..NetworkModel::new(&self.network, NetworkForm::WeightsAroundFixed)
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{bent, fitted_to, number, whole, words};

    #[test]
    fn unit_m2d_fits_a_nonlinear_target() {
        let keys = [
            words("linear", &["a", "b", "c"]),
            number("learning_rate", 0.01),
            whole("epochs", 300),
            whole("batch", 64),
        ];
        let straight = fitted_to(&bent(), "ridge", &[number("lambda", 0.0)]).residual_std;
        let found = fitted_to(&bent(), "m2d", &keys).residual_std;
        assert!(found < 0.2 * straight, "{found} {straight}");
    }
}
