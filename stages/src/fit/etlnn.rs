//! The network of thesis 004 beside the extended model of Tolles and Lawson.

use learning::network::Form;
use schemas::Fault;

use super::{
    model::{FitModel, Learnt, model},
    network::{Beside, LinearPart, Network, learn},
    samples::{PointWork, Samples},
    settings::Settings,
};

model! {
    /// As `tlnn`, of what the extended model leaves: all features are linear terms where `linear` does not name them.
    ///
    /// Source: thesis 004, section 4.4.2 and Table 4.7.
    ExtendedTollesLawsonNetwork = "etlnn", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [whiten],
    groups [network: Network, part: LinearPart], example "epochs = 5";
}

impl FitModel for ExtendedTollesLawsonNetwork {
    fn learn(&self, samples: &Samples, settings: &Settings, work: &PointWork) -> Result<Learnt, Fault> {
        let part = Some(&self.part);
        let beside = Beside {
            form: Form::FixedLinear,
            hidden: &[11],
            linear: part,
            all_features: true,
            physics: 0.0,
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
    use crate::fit::testing::{bent, fitted_to, whole, words};

    #[test]
    fn law_all_features_are_linear_terms() {
        let one = fitted_to(&bent(), "etlnn", &[whole("epochs", 3)]);
        let other = fitted_to(&bent(), "tlnn", &[whole("epochs", 3), words("linear", &["a", "b", "c"])]);
        assert_eq!((one.value, one.term), (other.value, other.term));
    }
}
