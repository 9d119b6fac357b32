//! Causal convolutions over a window, followed by a network.

use learning::network::{MemoryLayers, NetworkForm};

use super::{
    model::{FitModel, model},
    network::{NetworkKeys, NetworkModel, WindowKeys},
};

model! {
    /// Causal convolutions compute features from a window of samples, and a network predicts the target from these
    /// features. The window ends at the predicted sample. The model can represent delays and hysteresis.
    ///
    /// Source: Bai, Kolter and Koltun 2018, "An empirical evaluation of generic convolutional and recurrent networks
    /// for sequence modeling".
    Tcn = "tcn", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [],
    groups [network: NetworkKeys, window: WindowKeys], example "epochs = 2\nwindow = 4";
}

impl FitModel for Tcn {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel {
            window: Some(self.window.with(MemoryLayers::Tcn)),
            ..NetworkModel::new(&self.network, NetworkForm::Plain)
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{delayed, fitted_to, number, whole};

    #[test]
    fn unit_a_tcn_fits_a_delayed_target() {
        let keys = [number("learning_rate", 0.01), whole("epochs", 150), whole("batch", 64)];
        let alone = fitted_to(&delayed(), "m1", &keys).residual_std;
        let found = fitted_to(&delayed(), "tcn", &[&keys[..], &[whole("window", 8)]].concat()).residual_std;
        assert!(found < 0.5 * alone, "{found} {alone}");
    }
}
