//! A network added to a linear model, trained together.

use learning::network::NetworkForm;
use schemas::Rule;

use super::{
    model::{FitModel, model},
    network::{LinearPart, NetworkKeys, NetworkModel},
};

model! {
    /// The model `m2b`, a . b + N(x), with coefficients b that are trained together with the network. Training starts
    /// from the coefficients of the ridge fit. During training the terms are centred and scaled, and decorrelated if
    /// `whiten` is set. The table holds the coefficients of the original terms.
    ///
    /// Source: Gnadt 2022, section 4.5; Gnadt, Wollaber & Nielsen 2022.
    M2c = "m2c", version 2, scaling Standardise, intercept true, made of Samples, choose [Given], takes [whiten],
    groups [network: NetworkKeys, part: LinearPart], example "epochs = 5";
    /// Weight of an additional term of the loss function: the squared difference between the prediction and the ridge
    /// fit of the linear terms. This difference is divided by the scale of the target.
    physics: f64, unit "1", default 0.0, rule Rule::NotNegative;
}

impl FitModel for M2c {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel {
            linear: Some(&self.part),
            physics: self.physics,
            ..NetworkModel::new(&self.network, NetworkForm::TrainedLinear)
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::sync::Arc;

    use arrow_array::{Float64Array, RecordBatch, cast::AsArray, types::Float64Type};

    use crate::fit::testing::{COEFFICIENTS, INTERCEPT_NT, bent, fitted_to, number, plain, whole, words};

    #[test]
    fn unit_m2c_fits_a_nonlinear_target() {
        let keys = [
            words("linear", &["a", "b", "c"]),
            number("learning_rate", 0.01),
            whole("epochs", 300),
            whole("batch", 64),
        ];
        let straight = fitted_to(&bent(), "ridge", &[number("lambda", 0.0)]).residual_std;
        let found = fitted_to(&bent(), "m2c", &keys).residual_std;
        assert!(found < 0.1 * straight, "{found} {straight}");
    }

    #[test]
    fn unit_the_unit_of_a_linear_term_does_not_matter() {
        let scaled_by = |factor: f64| {
            let mut lines = bent();
            for line in &mut lines {
                let of = |x: f64| factor * (x + 3.0);
                let scaled: Float64Array = line.column(2).as_primitive::<Float64Type>().unary(of);
                let mut columns = line.columns().to_vec();
                columns[2] = Arc::new(scaled);
                *line = RecordBatch::try_new(line.schema(), columns).unwrap();
            }
            let keys = [words("linear", &["a", "b", "c"]), whole("epochs", 20), whole("batch", 64)];
            fitted_to(&lines, "m2c", &keys).residual_std
        };
        let (usual, other) = (scaled_by(1.0), scaled_by(1e4));
        assert!((usual / other - 1.0).abs() < 1e-6, "{usual} {other}");
    }

    #[test]
    fn unit_coefficients_of_a_linear_target_are_kept() {
        let keys = [words("linear", &["a", "b", "c"]), number("lambda", 0.0), whole("epochs", 20)];
        let unfiltered = [number("linear_low_hz", 0.0), number("linear_high_hz", 0.0)];
        let found = fitted_to(&plain(INTERCEPT_NT), "m2c", &[&keys[..], &unfiltered].concat());
        let scale = found.value[found.term.iter().position(|t| t == "target_scale").unwrap()];
        for (i, truth) in COEFFICIENTS.into_iter().enumerate() {
            let at = found.term.iter().position(|t| *t == format!("linear[{}]", i + 1)).unwrap();
            assert!((found.value[at] * scale - truth).abs() < 1e-3, "{} {truth}", found.value[at] * scale);
        }
    }
}
