//! The network of van der Meer 2025 added to the extended model of Tolles and Lawson.

use learning::network::Form;

use super::{
    model::{FitModel, model},
    network::{LinearPart, Network, NetworkModel},
};

model! {
    /// The same as `tlnn`, for the residual of the extended model. Without `linear`, all features are linear terms.
    ///
    /// Source: thesis 004, section 4.4.2 and Table 4.7.
    ExtendedTollesLawsonNetwork = "etlnn", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [whiten],
    groups [network: Network, part: LinearPart], example "epochs = 5";
}

impl FitModel for ExtendedTollesLawsonNetwork {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel {
            hidden: &[11],
            linear: Some(&self.part),
            all_features: true,
            ..NetworkModel::of(&self.network, Form::FixedLinear)
        })
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
