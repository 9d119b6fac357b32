//! Network with one hidden layer.

use params::choice;

use crate::navigation::ins_error::ParameterError;
use crate::random::NormalGenerator;

use super::super::online::augmented::refused;

choice! {
    /// Activation function.
    #[derive(Default)]
    pub enum OnlineActivation {
        /// z/(1 + e⁻ᶻ): swish, or SiLU.
        #[default]
        Swish = "swish",
        /// tanh z.
        Tanh = "tanh",
    }
}

impl OnlineActivation {
    /// Activation, and the derivative of the activation.
    #[inline(always)]
    fn at(self, z: f64) -> (f64, f64) {
        match self {
            Self::Swish => {
                let part = 1.0 / (1.0 + (-z).exp());
                (z * part, part + z * part * (1.0 - part))
            }
            Self::Tanh => {
                let t = z.tanh();
                (t, 1.0 - t * t)
            }
        }
    }
}

/// Aircraft field as a function of features. Here, f denotes the features minus their mean, divided by their standard
/// deviation:
///
/// ```text
/// m = s (b₂ + Σⱼ vⱼ a(bⱼ + Σᵢ Wⱼᵢ fᵢ))
/// ```
///
/// The weights are one vector: W by hidden units, b, v, b₂.
#[derive(Clone, Debug, PartialEq)]
pub struct OnlineNetwork {
    inputs: usize,
    hidden: usize,
    activation: OnlineActivation,
    output_nt: f64,
    mean: Vec<f64>,
    deviation: Vec<f64>,
}

impl OnlineNetwork {
    /// Network for the features of a calibration, row-major with `inputs` columns. Finite rows determine means and
    /// standard deviations. `output_nt` is the scale s, about the standard deviation of the aircraft field.
    ///
    /// # Errors
    /// Fails without inputs or hidden units, for an `output_nt` that is not above 0, or for a feature that is constant
    /// in the calibration, whose effect is unobservable.
    pub fn new(
        features: &[f64],
        inputs: usize,
        hidden: usize,
        activation: OnlineActivation,
        output_nt: f64,
    ) -> Result<Self, ParameterError> {
        if inputs == 0 || hidden == 0 || !features.len().is_multiple_of(inputs.max(1)) {
            let what = format!(
                "{} values are not whole rows of {inputs} features, with {hidden} hidden units",
                features.len()
            );
            return Err(refused("hidden", what));
        }
        if !(output_nt > 0.0 && output_nt.is_finite()) {
            return Err(refused("output_nt", format!("the scale of the output must be above 0 nT, not {output_nt}")));
        }
        let (mut mean, mut deviation) = (vec![], vec![]);
        for input in 0..inputs {
            let finite = |row: &&[f64]| row.iter().all(|x| x.is_finite());
            let column: Vec<f64> = features.chunks_exact(inputs).filter(finite).map(|row| row[input]).collect();
            let count = column.len() as f64;
            let middle = column.iter().sum::<f64>() / count;
            let spread = (column.iter().map(|x| (x - middle).powi(2)).sum::<f64>() / count).sqrt();
            // The computed variance of a constant column is the rounding error of the mean.
            if !(spread > 1e-9 * middle.abs() && spread.is_finite()) {
                let what = format!("feature {input} is constant in the calibration, so its effect cannot be estimated");
                return Err(refused("features", what));
            }
            mean.push(middle);
            deviation.push(spread);
        }
        Ok(Self { inputs, hidden, activation, output_nt, mean, deviation })
    }

    /// Network with given means and standard deviations of its inputs, for example those of a trained network.
    ///
    /// # Errors
    /// Fails without inputs or hidden units, for means and standard deviations that differ in number or are not finite,
    /// or for a standard deviation or an `output_nt` that is not above 0.
    pub fn scaled(
        mean: Vec<f64>,
        deviation: Vec<f64>,
        hidden: usize,
        activation: OnlineActivation,
        output_nt: f64,
    ) -> Result<Self, ParameterError> {
        let positive = |x: &f64| *x > 0.0 && x.is_finite();
        let inputs = mean.len();
        if inputs == 0 || hidden == 0 || deviation.len() != inputs {
            let what = format!(
                "a network requires hidden units and one standard deviation per mean, not {inputs} means and {}",
                deviation.len()
            );
            return Err(refused("features", what));
        }
        if !(positive(&output_nt) && deviation.iter().all(positive) && mean.iter().all(|m| m.is_finite())) {
            return Err(refused(
                "features",
                "the offsets and scale factors must be finite, and the scale factors above 0".to_owned(),
            ));
        }
        Ok(Self { inputs, hidden, activation, output_nt, mean, deviation })
    }

    /// Number of features.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Number of weights.
    pub fn weights(&self) -> usize {
        self.hidden * (self.inputs + 2) + 1
    }

    /// Standard deviations of unknown weights: the inverse square root of the number of inputs of a unit, so that the
    /// output has the magnitude of the output scale.
    pub fn weight_sigma(&self) -> Vec<f64> {
        let (first, second) = ((self.inputs as f64).sqrt().recip(), (self.hidden as f64).sqrt().recip());
        let mut sigma = vec![first; self.hidden * self.inputs];
        sigma.resize(self.hidden * (self.inputs + 1), 1.0);
        sigma.resize(self.hidden * (self.inputs + 2), second);
        sigma.push(1.0);
        sigma
    }

    /// Weights drawn with these standard deviations from a seed.
    pub fn draw(&self, seed: u64) -> Vec<f64> {
        let mut normals = NormalGenerator::new(seed);
        self.weight_sigma().into_iter().map(|sigma| sigma * normals.draw()).collect()
    }

    /// Inputs of rows of features; NaN for all inputs of a row with a feature that is not finite.
    pub fn standardised(&self, features: &[f64]) -> Vec<f64> {
        let mut inputs = Vec::with_capacity(features.len());
        for row in features.chunks_exact(self.inputs) {
            let known = row.iter().all(|x| x.is_finite());
            let of =
                |(x, (mean, deviation)): (&f64, (&f64, &f64))| if known { (x - mean) / deviation } else { f64::NAN };
            inputs.extend(row.iter().zip(self.mean.iter().zip(&self.deviation)).map(of));
        }
        inputs
    }

    /// Field for a row of inputs, in nT.
    #[inline(always)]
    pub fn value(&self, inputs: &[f64], weights: &[f64]) -> f64 {
        let (w, rest) = weights.split_at(self.hidden * self.inputs);
        let (b, v) = rest.split_at(self.hidden);
        let mut sum = v[self.hidden];
        for (unit, w) in w.chunks_exact(self.inputs).enumerate() {
            sum += v[unit] * self.activation.at(b[unit] + product(w, inputs)).0;
        }
        self.output_nt * sum
    }

    /// Field for a row of inputs, in nT, and its derivatives with respect to the weights, by back-propagation.
    #[inline(always)]
    pub fn value_and_gradient(&self, inputs: &[f64], weights: &[f64], gradient: &mut [f64]) -> f64 {
        let (w, rest) = weights.split_at(self.hidden * self.inputs);
        let (b, v) = rest.split_at(self.hidden);
        let (d_w, rest) = gradient.split_at_mut(self.hidden * self.inputs);
        let (d_b, d_v) = rest.split_at_mut(self.hidden);
        let mut sum = v[self.hidden];
        for (unit, (w, d_w)) in w.chunks_exact(self.inputs).zip(d_w.chunks_exact_mut(self.inputs)).enumerate() {
            let (out, slope) = self.activation.at(b[unit] + product(w, inputs));
            sum += v[unit] * out;
            d_v[unit] = self.output_nt * out;
            d_b[unit] = self.output_nt * v[unit] * slope;
            for (d_w, input) in d_w.iter_mut().zip(inputs) {
                *d_w = d_b[unit] * input;
            }
        }
        d_v[self.hidden] = self.output_nt;
        self.output_nt * sum
    }
}

#[inline(always)]
fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
