//! The network of thesis 004 beside the model of Tolles and Lawson.

use learning::network::Form;
use schemas::Fault;

use super::{
    model::{FitModel, Learnt, model},
    network::{Beside, LinearPart, Network, learn},
    samples::{PointWork, Samples},
    settings::Settings,
};

model! {
    /// A network of what the model of Tolles and Lawson leaves, as `m2b`, with the one hidden layer of 11 units that thesis
    /// 004 found by search.
    ///
    /// Source: thesis 004, section 4.4.1 and Table 4.6.
    TollesLawsonNetwork = "tlnn", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [whiten],
    groups [network: Network, part: LinearPart], example "epochs = 5";
}

impl FitModel for TollesLawsonNetwork {
    fn learn(&self, samples: &Samples, settings: &Settings, work: &PointWork) -> Result<Learnt, Fault> {
        let part = Some(&self.part);
        let beside = Beside {
            form: Form::FixedLinear,
            hidden: &[11],
            linear: part,
            all_features: false,
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
    use crate::fit::testing::{bent, fitted_to, whole, words, worked};
    use schemas::Unattended;

    #[test]
    fn law_it_is_m2b_with_eleven_units() {
        let keys = [words("linear", &["a", "b"]), whole("epochs", 3)];
        let eleven = ("hidden".to_owned(), schemas::Literal::List(vec![schemas::Literal::Int(11)]));
        let one = fitted_to(&bent(), "tlnn", &keys);
        let other = fitted_to(&bent(), "m2b", &[&keys[..], &[eleven]].concat());
        assert_eq!((one.value, one.term), (other.value, other.term));
    }

    #[test]
    fn unit_without_terms_of_tolles_and_lawson_it_asks_for_them() {
        let fault = worked(&bent(), "tlnn", &[], &Unattended).err().unwrap();
        assert_eq!(fault.param.as_deref(), Some("linear"), "{fault}");
    }
}
