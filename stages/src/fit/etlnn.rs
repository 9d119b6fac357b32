//! Network of van der Meer 2025 combined with the extended Tolles-Lawson model.

use learning::network::NetworkForm;

use super::{
    model::{FitModel, model},
    network::{LinearPart, NetworkKeys, NetworkModel},
};

model! {
    /// The model `tlnn` with the extended Tolles-Lawson model as its linear model. By default, all features are linear
    /// terms.
    ///
    /// Source: van der Meer 2025, section 4.4.2 and Table 4.7.
    ExtendedTollesLawsonNetwork = "etlnn", version 1, scaling Standardise, intercept true, made of Samples,
    choose [Given], takes [whiten],
    groups [network: NetworkKeys, part: LinearPart], example "epochs = 5";
}

impl FitModel for ExtendedTollesLawsonNetwork {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel {
            hidden: &[11],
            linear: Some(&self.part),
            all_features: true,
            ..NetworkModel::new(&self.network, NetworkForm::FixedLinear)
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{bent, fitted_to, whole, words};

    #[test]
    fn unit_all_features_are_linear_terms() {
        let one = fitted_to(&bent(), "etlnn", &[whole("epochs", 3)]);
        let other = fitted_to(&bent(), "tlnn", &[whole("epochs", 3), words("linear", &["a", "b", "c"])]);
        assert_eq!((one.value, one.term), (other.value, other.term));
    }
}
