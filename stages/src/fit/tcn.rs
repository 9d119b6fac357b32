//! Causal convolutions over a window, before a network.

use learning::network::{Form, Memory};
use schemas::Fault;

use super::{
    model::{FitModel, Learnt, model},
    network::{Beside, Network, WindowKeys, learn},
    samples::{PointWork, Samples},
    settings::Settings,
};

model! {
    /// Causal convolutions make features of a window of samples, the predicted one and those before it, and a network of
    /// these features predicts the target. It represents what lags and what depends on the way there.
    ///
    /// Source: Bai, Kolter and Koltun 2018, "An empirical evaluation of generic convolutional and recurrent networks for
    /// sequence modeling".
    Tcn = "tcn", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [],
    groups [network: Network, window: WindowKeys], example "epochs = 2\nwindow = 4";
}

impl FitModel for Tcn {
    fn learn(&self, samples: &Samples, settings: &Settings, work: &PointWork) -> Result<Learnt, Fault> {
        let window = Some(self.window.with(Memory::Tcn));
        let beside =
            Beside { form: Form::Plain, hidden: &[8], linear: None, all_features: false, physics: 0.0, window };
        learn(&self.network, &beside, samples, settings, work)
    }

    fn effort(&self) -> f64 {
        self.network.effort() * self.window.effort()
    }

    fn faults(&self, _: &Settings) -> Vec<Fault> {
        let mut faults = self.network.faults();
        faults.extend(self.window.faults(Memory::Tcn));
        faults
    }

    fn network(&self) -> Option<&Network> {
        Some(&self.network)
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::testing::{delayed, fitted_to, number, whole};

    #[test]
    fn law_it_explains_what_came_before() {
        let keys = [number("learning_rate", 0.01), whole("epochs", 150), whole("batch", 64)];
        let alone = fitted_to(&delayed(), "m1", &keys).residual_std;
        let found = fitted_to(&delayed(), "tcn", &[&keys[..], &[whole("window", 8)]].concat()).residual_std;
        assert!(found < 0.5 * alone, "{found} {alone}");
    }
}
