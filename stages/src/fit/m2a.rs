//! A network of coefficients.

use learning::network::Form;
use schemas::{Fault, Rule};

use super::{
    model::{FitModel, Learnt, model},
    network::{Beside, LinearPart, Network, learn},
    samples::{PointWork, Samples},
    settings::Settings,
};

model! {
    /// The network predicts the coefficients of the linear terms, which change with the inputs: a . N(x), a being the
    /// terms as they are. The ridge of them is only what `physics` holds on to.
    ///
    /// Source: thesis 000, section 4.2, model 2a.
    M2a = "m2a", version 3, scaling Standardise, intercept true, made of Samples, choose [Given], takes [whiten],
    groups [network: Network, part: LinearPart], example "epochs = 5";
    /// The weight of the distance of the prediction from the linear model, squared and over the target's scale, in the
    /// loss.
    physics: f64, unit "1", default 0.0, rule Rule::NotNegative;
}

impl FitModel for M2a {
    fn learn(&self, samples: &Samples, settings: &Settings, work: &PointWork) -> Result<Learnt, Fault> {
        let part = Some(&self.part);
        let beside = Beside {
            form: Form::Weights,
            hidden: &[8],
            linear: part,
            all_features: false,
            physics: self.physics,
            window: None,
        };
        learn(&self.network, &beside, samples, settings, work)
    }

    fn network(&self) -> Option<&Network> {
        Some(&self.network)
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{bent, fitted_to, number, whole, words};

    #[test]
    fn law_it_explains_a_target_that_bends() {
        let keys = [
            words("linear", &["a", "b", "c"]),
            number("learning_rate", 0.01),
            whole("epochs", 100),
            whole("lbfgs_epochs", 400),
        ];
        let straight = fitted_to(&bent(), "ridge", &[number("lambda", 0.0)]).residual_std;
        let found = fitted_to(&bent(), "m2a", &keys).residual_std;
        assert!(found < 0.2 * straight, "{found} {straight}");
    }
}
