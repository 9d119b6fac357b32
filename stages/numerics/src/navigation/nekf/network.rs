//! The network: one long short-term memory layer and a bounded output.

use params::choice;

use crate::inner_product::dot;
use crate::navigation::ins_error::ParameterError;
use crate::navigation::online::augmented::refused;
use crate::random::NormalGenerator;

choice! {
    /// Noise that the network sets.
    #[derive(Default)]
    pub enum NetworkNoise {
        /// The measurement noise R.
        #[default]
        R = "r",
        /// The noise Q that drives the temporal variation.
        Q = "q",
        /// R and Q.
        Both = "both",
    }
}

impl NetworkNoise {
    /// Number of outputs of the network.
    pub fn outputs(self) -> usize {
        match self {
            Self::R | Self::Q => 1,
            Self::Both => 2,
        }
    }

    /// Indices of the output that sets R and of the output that sets Q.
    fn places(self) -> [Option<usize>; 2] {
        match self {
            Self::R => [Some(0), None],
            Self::Q => [None, Some(0)],
            Self::Both => [Some(0), Some(1)],
        }
    }
}

/// Limit of the standardised inputs; larger values are clamped.
const LARGEST_INPUT: f64 = 5.0;
/// Number of gates: input, forget, candidate and output.
const GATES: usize = 4;
/// Index of the forget gate.
const FORGET: usize = 1;

/// Network that scales the noise of a filter from sample to sample. Let f be the inputs, standardised and limited to 5
/// standard deviations, and h and c the state of the layer, which is 0 before the first sample [Hochreiter &
/// Schmidhuber 1997; Gers, Schmidhuber & Cummins 2000]:
///
/// ```text
/// i = σ(Wᵢ f + Uᵢ h + bᵢ)    j = σ(Wⱼ f + Uⱼ h + bⱼ)    g = tanh(W_g f + U_g h + b_g)    o = σ(Wₒ f + Uₒ h + bₒ)
/// c ← j c + i g              h ← o tanh c               ln scale = 2 ln(limit) tanh(V h + a)
/// ```
///
/// The scale multiplies a variance. The weights are one vector. For each gate (input i, forget j, candidate g, output
/// o) and each unit, the vector holds a row of W, a row of U and an entry of b. For each output, a row of V and an
/// entry of a follow.
#[derive(Clone, Debug, PartialEq)]
pub struct NoiseNetwork {
    /// Noise that the network sets.
    pub noise: NetworkNoise,
    /// Number of units in the long short-term memory layer of the network.
    pub hidden: usize,
    /// Largest factor by which the network multiplies a standard deviation. The smallest factor is 1/`limit`.
    pub limit: f64,
    /// Mean of each input.
    pub mean: Vec<f64>,
    /// Inverse standard deviation of each input; 0 for an input without effect.
    pub inverse_deviation: Vec<f64>,
    /// Weights.
    pub weights: Vec<f64>,
}

/// State of the layer between two samples.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CellState {
    hidden: Vec<f64>,
    memory: Vec<f64>,
}

/// Values of one sample that the backward pass requires.
#[derive(Clone, Debug)]
pub(super) struct CellTape {
    inputs: Vec<f64>,
    before: CellState,
    after: CellState,
    /// Activations of the gates, gate by gate.
    gates: Vec<f64>,
    /// tanh(V h + a) of each output.
    bounded: Vec<f64>,
}

/// Derivatives of a loss with respect to the state of the layer.
#[derive(Clone, Debug)]
pub(super) struct CellAdjoint {
    hidden: Vec<f64>,
    memory: Vec<f64>,
}

impl CellAdjoint {
    /// Zero derivatives, because the state after the last sample has no effect.
    pub(super) fn end(units: usize) -> Self {
        Self { hidden: vec![0.0; units], memory: vec![0.0; units] }
    }
}

impl NoiseNetwork {
    /// Network without an effect, because its outputs are 0. The inputs are not yet standardised. The weights of the
    /// gates are drawn from a seed with the variance 1/(inputs + units). The biases are 1 for the forget gate and 0 for
    /// the other gates.
    pub fn initial(noise: NetworkNoise, inputs: usize, hidden: usize, limit: f64, seed: u64) -> Self {
        let (mean, inverse_deviation) = (vec![0.0; inputs], vec![0.0; inputs]);
        let (mut normals, sigma) = (NormalGenerator::new(seed), ((inputs + hidden) as f64).sqrt().recip());
        let mut weights = vec![];
        for gate in 0..GATES {
            for _ in 0..hidden {
                weights.extend((0..inputs + hidden).map(|_| sigma * normals.draw()));
                weights.push(if gate == FORGET { 1.0 } else { 0.0 });
            }
        }
        weights.resize(weights.len() + noise.outputs() * (hidden + 1), 0.0);
        Self { noise, hidden, limit, mean, inverse_deviation, weights }
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.mean.len()
    }

    /// Number of weights of a network.
    pub fn weight_count(inputs: usize, hidden: usize, outputs: usize) -> usize {
        GATES * hidden * (inputs + hidden + 1) + outputs * (hidden + 1)
    }

    /// Rejects invalid networks.
    ///
    /// # Errors
    /// Fails without units, for a `limit` that is not a finite number above 1, for values that are not finite, or for
    /// vectors whose lengths differ from the network's.
    pub fn check(&self) -> Result<(), ParameterError> {
        if self.hidden == 0 {
            return Err(refused("hidden", "the network has no units"));
        }
        if !(self.limit > 1.0 && self.limit.is_finite()) {
            return Err(refused("limit", format!("the limit must be finite and above 1, not {}", self.limit)));
        }
        let expected = Self::weight_count(self.inputs(), self.hidden, self.noise.outputs());
        if self.weights.len() != expected || self.inverse_deviation.len() != self.inputs() {
            let what = format!(
                "the network has {} weights and {} scales, not {expected} and {}",
                self.weights.len(),
                self.inverse_deviation.len(),
                self.inputs()
            );
            return Err(refused("model", what));
        }
        let all = self.mean.iter().chain(&self.inverse_deviation).chain(&self.weights);
        match all.copied().find(|value| !value.is_finite()) {
            Some(value) => Err(refused("model", format!("the network contains {value}, which is not a finite number"))),
            None => Ok(()),
        }
    }

    /// State before the first sample.
    pub(super) fn start(&self) -> CellState {
        CellState { hidden: vec![0.0; self.hidden], memory: vec![0.0; self.hidden] }
    }

    /// Standardised inputs. An input that is not finite is replaced by the mean of this input.
    fn standardised(&self, inputs: &[f64]) -> Vec<f64> {
        let of = |(x, (mean, inverse)): (&f64, (&f64, &f64))| {
            let scaled = (x - mean) * inverse;
            if scaled.is_finite() { scaled.clamp(-LARGEST_INPUT, LARGEST_INPUT) } else { 0.0 }
        };
        inputs.iter().zip(self.mean.iter().zip(&self.inverse_deviation)).map(of).collect()
    }

    /// Advances the state by a sample. Returns the values for the backward pass.
    pub(super) fn advance(&self, state: &mut CellState, inputs: &[f64]) -> CellTape {
        let inputs = self.standardised(inputs);
        let before = state.clone();
        let (of_gates, of_outputs) = self.weights.split_at(GATES * self.hidden * self.row());
        let gates = of_gates.chunks_exact(self.row()).enumerate().map(|(at, row)| {
            let (w, rest) = row.split_at(inputs.len());
            let sum = dot(w, &inputs) + dot(rest, &before.hidden) + rest[self.hidden];
            if at / self.hidden == 2 { sum.tanh() } else { logistic(sum) }
        });
        let gates: Vec<f64> = gates.collect();
        let [i, j, g, o] = [0, 1, 2, 3].map(|gate| &gates[gate * self.hidden..][..self.hidden]);
        for unit in 0..self.hidden {
            state.memory[unit] = j[unit] * before.memory[unit] + i[unit] * g[unit];
            state.hidden[unit] = o[unit] * state.memory[unit].tanh();
        }
        let bounded = of_outputs.chunks_exact(self.hidden + 1);
        let bounded = bounded.map(|row| (dot(row, &state.hidden) + row[self.hidden]).tanh()).collect();
        CellTape { inputs, before, after: state.clone(), gates, bounded }
    }

    /// Logarithms of the scales of R and Q; 0 for a noise that the network does not set.
    pub(super) fn log_scales(&self, tape: &CellTape) -> [f64; 2] {
        let bound = 2.0 * self.limit.ln();
        self.noise.places().map(|place| place.map_or(0.0, |place| bound * tape.bounded[place]))
    }

    /// Propagates derivatives back through a sample. `d_logs` are the derivatives with respect to the log scales of the
    /// sample. `adjoint` initially holds the derivatives with respect to the state after the sample, and finally those
    /// with respect to the state before it. Adds the derivatives of the weights to `gradient`.
    pub(super) fn back(&self, tape: &CellTape, d_logs: [f64; 2], adjoint: &mut CellAdjoint, gradient: &mut [f64]) {
        let (units, row) = (self.hidden, self.row());
        let (d_gates, d_outputs) = gradient.split_at_mut(GATES * units * row);
        let (of_gates, of_outputs) = self.weights.split_at(GATES * units * row);
        let bound = 2.0 * self.limit.ln();
        for (place, d_log) in self.noise.places().into_iter().zip(d_logs) {
            let Some(place) = place else { continue };
            let bounded = tape.bounded[place];
            let d = d_log * bound * (1.0 - bounded * bounded);
            let (v, d_v) = (&of_outputs[place * (units + 1)..], &mut d_outputs[place * (units + 1)..]);
            for unit in 0..units {
                d_v[unit] += d * tape.after.hidden[unit];
                adjoint.hidden[unit] += d * v[unit];
            }
            d_v[units] += d;
        }
        let d_hidden = std::mem::replace(&mut adjoint.hidden, vec![0.0; units]);
        for (unit, d_hidden) in d_hidden.into_iter().enumerate() {
            let [i, j, g, o] = [0, 1, 2, 3].map(|gate| tape.gates[gate * units + unit]);
            let bent = tape.after.memory[unit].tanh();
            let d_memory = adjoint.memory[unit] + d_hidden * o * (1.0 - bent * bent);
            adjoint.memory[unit] = d_memory * j;
            let d_sums = [
                d_memory * g * i * (1.0 - i),
                d_memory * tape.before.memory[unit] * j * (1.0 - j),
                d_memory * i * (1.0 - g * g),
                d_hidden * bent * o * (1.0 - o),
            ];
            for (gate, d) in d_sums.into_iter().enumerate() {
                let at = (gate * units + unit) * row;
                let (u, d_row) = (&of_gates[at + tape.inputs.len()..], &mut d_gates[at..at + row]);
                for (d_weight, x) in d_row.iter_mut().zip(tape.inputs.iter().chain(&tape.before.hidden)) {
                    *d_weight += d * x;
                }
                d_row[row - 1] += d;
                adjoint.hidden.iter_mut().zip(u).for_each(|(to, u)| *to += d * u);
            }
        }
    }

    /// Number of weights of a unit in a gate.
    fn row(&self) -> usize {
        self.inputs() + self.hidden + 1
    }
}

fn logistic(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}
