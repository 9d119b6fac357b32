//! The size of a network, and the layout of its parameter vector.

use numerics::random::SplitMix64;
use params::choice;

use super::activation::ActivationFunction;
use super::error::TrainingError;
use super::vector::{ROW, TERMS_WITHOUT_EDDY, VECTOR_TERMS};

choice! {
    /// Combination of a network N and linear terms a that predicts the target. [Gnadt 2022, sections 4.2-4.6]
    #[derive(Default)]
    pub enum NetworkForm {
        /// N(x): model 1.
        #[default]
        Plain = "m1",
        /// a·N(x): model 2a, whose network has an output for each linear term.
        Weights = "m2a",
        /// N(x) + a·b with b given and fixed: model 2b.
        FixedLinear = "m2b",
        /// N(x) + a·b with b trained: model 2c.
        TrainedLinear = "m2c",
        /// a·(N(x) + b) with b given and fixed: model 2d.
        WeightsAroundFixed = "m2d",
        /// f(v) + c with the vector field v from trained Tolles-Lawson coefficients, the scalar field f(v), and a
        /// trained constant c: model 3tl. It has no inputs. [`VectorFrame`](super::VectorFrame) defines f.
        VectorOnly = "m3tl",
        /// f(v) + N(x): models 3s, 3sc, 3w and 3tf.
        VectorScalar = "m3s",
        /// f(v + N(x)) + c, whose network has three outputs: models 3v and 3vc.
        VectorNetwork = "m3v",
    }
}

impl NetworkForm {
    /// Whether the network has one output per linear term.
    pub(super) fn weighs(self) -> bool {
        matches!(self, Self::Weights | Self::WeightsAroundFixed)
    }

    /// Whether the vector of parameters ends with the linear coefficients b.
    pub(super) fn holds_linear(self) -> bool {
        matches!(self, Self::FixedLinear | Self::TrainedLinear | Self::WeightsAroundFixed) || self.is_vector()
    }
}

/// A network of dense layers with additional linear terms.
///
/// Its parameters are one vector. Layer by layer, the vector holds the weights, row-major (unit, input), then the
/// biases of the units; the output layer is the last. The coefficients b of the linear terms follow, if the form has
/// them, and the constant of [`NetworkForm::VectorNetwork`]. The constant of [`NetworkForm::VectorOnly`] is the bias of
/// its output.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NetworkShape {
    /// The number of inputs.
    pub inputs: usize,
    /// The number of linear terms. [`NetworkForm::Plain`] ignores them in the prediction. The vector forms have 18, or
    /// 9 without eddy terms.
    pub linear: usize,
    /// The number of units of each hidden layer. Without hidden layers the network is linear.
    pub hidden: Vec<usize>,
    /// Activation function of the hidden units. Outputs have no activation.
    pub activation: ActivationFunction,
    /// Combination of the network and the linear terms.
    pub form: NetworkForm,
}

/// Dense layer and the start of its weights in the parameter vector; its biases follow them.
#[derive(Debug, Clone, Copy)]
pub(super) struct DenseLayer {
    pub inputs: usize,
    pub units: usize,
    pub start: usize,
}

impl DenseLayer {
    pub fn weights<'a>(&self, parameters: &'a [f64]) -> &'a [f64] {
        &parameters[self.start..][..self.inputs * self.units]
    }

    /// Position of the layer's weights.
    pub fn range(&self) -> std::ops::Range<usize> {
        self.start..self.start + self.inputs * self.units
    }

    pub fn biases<'a>(&self, parameters: &'a [f64]) -> &'a [f64] {
        &parameters[self.start + self.inputs * self.units..][..self.units]
    }

    pub fn split_mut<'a>(&self, parameters: &'a mut [f64]) -> (&'a mut [f64], &'a mut [f64]) {
        let (weights, behind) = parameters[self.start..].split_at_mut(self.inputs * self.units);
        (weights, &mut behind[..self.units])
    }
}

impl NetworkShape {
    /// The number of outputs of the network itself.
    pub(super) fn outputs(&self) -> usize {
        match self.form {
            NetworkForm::Weights | NetworkForm::WeightsAroundFixed => self.linear,
            NetworkForm::VectorNetwork => 3,
            NetworkForm::Plain
            | NetworkForm::FixedLinear
            | NetworkForm::TrainedLinear
            | NetworkForm::VectorOnly
            | NetworkForm::VectorScalar => 1,
        }
    }

    /// Number of values of a row of linear terms.
    pub(super) fn row_of_terms(&self) -> usize {
        if self.form.is_vector() { ROW } else { self.linear }
    }

    /// Number of rows of the inputs `x`, or of the terms `a` if the form has no inputs.
    pub(super) fn rows(&self, x: &[f64], a: &[f64]) -> usize {
        if self.form == NetworkForm::VectorOnly { a.len() / ROW } else { x.len() / self.inputs.max(1) }
    }

    pub(super) fn layers(&self) -> Vec<DenseLayer> {
        let mut start = 0;
        let mut inputs = self.inputs;
        let mut layer = |units: usize| {
            let layer = DenseLayer { inputs, units, start };
            start += units * (inputs + 1);
            inputs = units;
            layer
        };
        let mut layers: Vec<DenseLayer> = self.hidden.iter().map(|units| layer(*units)).collect();
        layers.push(layer(self.outputs()));
        layers
    }

    /// Start of the coefficients of the linear terms, equal to the number of weights and biases.
    pub(super) fn linear_start(&self) -> usize {
        self.layers().iter().map(|layer| layer.units * (layer.inputs + 1)).sum()
    }

    /// Position of the parameter that is added to the prediction: the bias of the last output, or the constant.
    pub(super) fn last_bias(&self) -> usize {
        if self.has_constant() { self.parameters() - 1 } else { self.linear_start() - 1 }
    }

    fn has_constant(&self) -> bool {
        self.form == NetworkForm::VectorNetwork
    }

    /// The number of parameters.
    pub fn parameters(&self) -> usize {
        let linear = if self.form.holds_linear() { self.linear } else { 0 };
        self.linear_start() + linear + usize::from(self.has_constant())
    }

    /// The name of each parameter, with indices that count from 1. `w1[3,17]` is the weight of unit 3 of the first
    /// layer for its input 17, `b1[3]` its bias, `linear[4]` the coefficient of a linear term.
    pub fn names(&self) -> Vec<String> {
        let mut names = Vec::with_capacity(self.parameters());
        for (number, layer) in (1..).zip(self.layers()) {
            let weights = |unit| (1..=layer.inputs).map(move |input| format!("w{number}[{unit},{input}]"));
            names.extend((1..=layer.units).flat_map(weights));
            names.extend((1..=layer.units).map(|unit| format!("b{number}[{unit}]")));
        }
        if self.form.holds_linear() {
            names.extend((1..=self.linear).map(|term| format!("linear[{term}]")));
        }
        if self.has_constant() {
            names.push("constant".to_owned());
        }
        names
    }

    /// Coefficients b of the linear terms, in the scale of the target; empty for a form without them. `parameters` may
    /// begin with the parameters of memory layers.
    pub fn linear_coefficients<'a>(&self, parameters: &'a [f64]) -> &'a [f64] {
        let count = if self.form.holds_linear() { self.linear } else { 0 };
        let end = parameters.len().saturating_sub(usize::from(self.has_constant()));
        parameters.get(end.saturating_sub(count)..end).unwrap_or_default()
    }

    /// Initial parameters: weights uniform between ±√(6/(inputs + units)) from a seed [Glorot & Bengio 2010], biases 0,
    /// and the given coefficients of the linear terms, in the scale of the target. A missing coefficient is NaN, which
    /// training rejects.
    pub fn initial(&self, seed: u64, linear: &[f64]) -> Vec<f64> {
        let mut bits = SplitMix64::new(derived_seed(seed, &[NetworkRandomStream::Weights as u64]));
        let mut parameters = vec![0.0; self.parameters()];
        for layer in self.layers() {
            let most = (6.0 / (layer.inputs + layer.units) as f64).sqrt();
            let draw = |weight: &mut f64| *weight = most * (2.0 * unit_uniform(bits.draw()) - 1.0);
            layer.split_mut(&mut parameters).0.iter_mut().for_each(draw);
        }
        if self.form.holds_linear() {
            let given = linear.iter().copied().chain(std::iter::repeat(f64::NAN));
            let b = &mut parameters[self.linear_start()..][..self.linear];
            b.iter_mut().zip(given).for_each(|(b, given)| *b = given);
        }
        parameters
    }

    /// Checks that the network can be trained.
    ///
    /// # Errors
    /// Fails without inputs, for a layer without units, or without linear terms if the form requires them.
    pub fn check(&self) -> Result<(), TrainingError> {
        let setting = |what, given: f64| Err(TrainingError::Setting { what, wanted: "at least 1", given });
        let without_network = self.form == NetworkForm::VectorOnly;
        if without_network && (self.inputs > 0 || !self.hidden.is_empty()) {
            let what = "the number of inputs and hidden layers of `m3tl`";
            return Err(TrainingError::Setting { what, wanted: "0", given: (self.inputs + self.hidden.len()) as f64 });
        }
        if self.inputs == 0 && !without_network {
            return setting("the number of inputs", 0.0);
        }
        if self.hidden.contains(&0) {
            return setting("the number of units of every hidden layer", 0.0);
        }
        if self.linear == 0 && self.form != NetworkForm::Plain {
            return setting("the number of linear terms of this form of network", 0.0);
        }
        if self.form.is_vector() && ![TERMS_WITHOUT_EDDY, VECTOR_TERMS.len()].contains(&self.linear) {
            let what = "the number of linear terms of the model 3 family";
            return Err(TrainingError::Setting { what, wanted: "9 or 18", given: self.linear as f64 });
        }
        Ok(())
    }
}

/// Purpose of random numbers; each purpose has a separate stream.
#[derive(Clone, Copy)]
pub(super) enum NetworkRandomStream {
    Weights = 1,
    Order = 2,
    Dropout = 3,
    Memory = 4,
}

/// Seed derived from these numbers.
pub(super) fn derived_seed(seed: u64, numbers: &[u64]) -> u64 {
    let start = SplitMix64::new(seed ^ 0x6a09_e667_f3bc_c909).draw();
    numbers
        .iter()
        .fold(start, |state, number| SplitMix64::new(state ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15)).draw())
}

/// Converts 64 bits to a number in [0, 1).
#[inline(always)]
pub(super) fn unit_uniform(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}
