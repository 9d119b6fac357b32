//! Network of van der Meer 2025 combined with the Tolles-Lawson model.

use learning::network::NetworkForm;

use super::{
    model::{FitModel, model},
    network::{LinearPart, NetworkKeys, NetworkModel},
};

model! {
    /// A network predicts the residual of the Tolles-Lawson model, as in `m2b`. By default the network has one hidden
    /// layer of 11 units, the result of the hyper-parameter search in van der Meer 2025.
    ///
    /// Source: van der Meer 2025, section 4.4.1 and Table 4.6.
    TollesLawsonNetwork = "tlnn", version 1, scaling Standardise, intercept true, made of Samples, choose [Given],
    takes [whiten],
    groups [network: NetworkKeys, part: LinearPart], example "epochs = 5";
}

impl FitModel for TollesLawsonNetwork {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel {
            hidden: &[11],
            linear: Some(&self.part),
            ..NetworkModel::new(&self.network, NetworkForm::FixedLinear)
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{bent, fitted_to, whole, words, worked};
    use schemas::NullMonitor;

    #[test]
    fn unit_tlnn_equals_m2b_with_eleven_units() {
        let keys = [words("linear", &["a", "b"]), whole("epochs", 3)];
        let eleven = ("hidden".to_owned(), schemas::Literal::List(vec![schemas::Literal::Int(11)]));
        let one = fitted_to(&bent(), "tlnn", &keys);
        let other = fitted_to(&bent(), "m2b", &[&keys[..], &[eleven]].concat());
        assert_eq!((one.value, one.term), (other.value, other.term));
    }

    #[test]
    fn unit_missing_tolles_lawson_terms_are_requested() {
        let fault = worked(&bent(), "tlnn", &[], &NullMonitor).err().unwrap();
        assert_eq!(fault.param.as_deref(), Some("linear"), "{fault}");
    }
}
