//! Networks that predict the target at the last sample of a window.

use params::choice;
use rayon::prelude::*;

use numerics::random::SplitMix64;

use super::attention::{EncoderPart, EncoderSizes, TransformerEncoder};
use super::convolution::ConvolutionLayers;
use super::error::TrainingError;
use super::passes::{BLOCK, BlockWorkspace, NetworkLinearTerms, PackedNetwork};
use super::recurrent::{RecurrentCell, RecurrentLayer};
use super::shape::{DenseLayer, NetworkRandomStream, NetworkShape, derived_seed, unit_uniform};
use super::state::TrainingState;
use super::training::NetworkSamples;

/// Largest absolute value of a transformer's initial position parameters.
const MOST_POSITION: f64 = 0.02;

choice! {
    /// Layers that compute features of a window.
    #[derive(Default)]
    pub enum MemoryLayers {
        /// Gated recurrent units, sample by sample.
        #[default]
        Gru = "gru",
        /// Long short-term memory, sample by sample.
        Lstm = "lstm",
        /// All inputs of the window are the features, in time order. There are no parameters.
        Window = "window",
        /// A transformer encoder with one layer of multi-head self-attention.
        Transformer = "transformer",
        /// Causal convolutions of two samples 1, 2, 4, … samples apart, layer by layer.
        Tcn = "tcn",
    }
}

/// A network over a window that ends at the predicted sample, without future samples. If a run is shorter than the
/// window, its first sample replaces the missing earlier samples. The features of the window are the inputs of a dense
/// network.
///
/// Its parameters are one vector: the parameters of the layers before the dense network, then the parameters of the
/// dense network. For `gru` and `lstm`, the recurrent layer holds the input weights, row-major (gate and unit, input),
/// the recurrent weights, row-major (gate and unit, unit), and the input and recurrent biases. Gates are r, z, n and i,
/// f, g, o, as in PyTorch. For `tcn`, the parameters are, layer by layer, the weights, row-major (unit, sample, input)
/// with the earlier sample first, then the biases. For `transformer`, they are the weights and biases of the embedding,
/// the positions (sample, unit), the matrices of queries, keys, values and results, the factors and offsets of the
/// first normalisation, the dense layer, and the second normalisation. `window` has no parameters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WindowedNetworkShape {
    /// Layers that compute features of the window.
    pub memory: MemoryLayers,
    /// The number of inputs of a sample.
    pub inputs: usize,
    /// The number of samples of the window; a power of two of at least 2 for `tcn`.
    pub window: usize,
    /// Number of heads of `transformer`, a divisor of the number of units; 1 for other layers.
    pub heads: usize,
    /// Number of units of the memory, equal to the number of features. For `window`, the number of inputs of the
    /// window. For `transformer`, the number of units of a sample; the features are the units of all samples.
    pub units: usize,
    /// The dense network; its inputs are the features.
    pub head: NetworkShape,
}

/// Samples in runs without gaps, such as lines.
#[derive(Debug, Clone, Copy)]
pub struct SampleRuns<'a> {
    /// The samples, run by run in time order.
    pub samples: NetworkSamples<'a>,
    /// The number of samples of each run.
    pub lengths: &'a [usize],
}

impl SampleRuns<'_> {
    /// For each row, the first row of its run.
    pub(super) fn first_rows(&self) -> Result<Vec<u32>, TrainingError> {
        first_rows(self.lengths, self.samples.y.len()).ok_or(TrainingError::Length {
            what: "as runs",
            of: "the lengths of runs",
            given: self.lengths.iter().fold(0, |sum: usize, length| sum.saturating_add(*length)),
            expected: self.samples.y.len(),
            rows: self.samples.y.len(),
        })
    }
}

fn first_rows(lengths: &[usize], rows: usize) -> Option<Vec<u32>> {
    let mut first = Vec::with_capacity(rows);
    for length in lengths {
        let start = u32::try_from(first.len()).ok()?;
        let end = first.len().checked_add(*length).filter(|end| *end <= rows)?;
        first.resize(end, start);
    }
    (first.len() == rows).then_some(first)
}

/// Layers that compute features of windows, for a block of rows.
pub(super) trait FeatureExtractor: Send {
    /// Sets the parameters of these layers.
    fn set(&mut self, parameters: &[f64]);

    /// The features of each row, row-major.
    fn forward(&mut self, x: &[f64], rows: usize, features: &mut [f64]);

    /// The gradient with respect to the parameters of these layers, from the derivatives with respect to the features.
    /// Requires [`forward`](Self::forward).
    fn backward(&mut self, x: &[f64], rows: usize, d_features: &[f64], gradient: &mut [f64]);
}

/// All inputs of a window as features.
struct WholeWindow;

impl FeatureExtractor for WholeWindow {
    fn set(&mut self, _: &[f64]) {}

    fn forward(&mut self, x: &[f64], _: usize, features: &mut [f64]) {
        features.copy_from_slice(x);
    }

    fn backward(&mut self, _: &[f64], _: usize, _: &[f64], _: &mut [f64]) {}
}

impl WindowedNetworkShape {
    fn cell(&self) -> Option<RecurrentCell> {
        match self.memory {
            MemoryLayers::Gru => Some(RecurrentCell::Gru),
            MemoryLayers::Lstm => Some(RecurrentCell::Lstm),
            MemoryLayers::Tcn | MemoryLayers::Window | MemoryLayers::Transformer => None,
        }
    }

    fn encoder(&self) -> EncoderSizes {
        EncoderSizes { inputs: self.inputs, units: self.units, window: self.window, heads: self.heads }
    }

    /// Number of features.
    fn features(&self) -> usize {
        if self.memory == MemoryLayers::Transformer { self.units * self.window } else { self.units }
    }

    pub(super) fn body(&self) -> Box<dyn FeatureExtractor> {
        match (self.cell(), self.memory) {
            (Some(cell), _) => Box::new(RecurrentLayer::new(cell, self.inputs, self.units, self.window)),
            (None, MemoryLayers::Window) => Box::new(WholeWindow),
            (None, MemoryLayers::Transformer) => {
                Box::new(TransformerEncoder::new(self.head.activation, self.encoder()))
            }
            (None, _) => Box::new(ConvolutionLayers::new(self.head.activation, self.inputs, self.units, self.window)),
        }
    }

    /// The weight matrices of the memory as dense layers.
    fn layers(&self) -> Vec<DenseLayer> {
        match self.cell() {
            Some(cell) => {
                let sums = cell.gates() * self.units;
                let units = DenseLayer { inputs: self.units, units: sums, start: sums * self.inputs };
                vec![DenseLayer { inputs: self.inputs, units: sums, start: 0 }, units]
            }
            None if self.memory == MemoryLayers::Window => vec![],
            None if self.memory == MemoryLayers::Transformer => {
                let mut start = 0;
                let layer = |(_, units, inputs, weights): EncoderPart| {
                    let layer = DenseLayer { inputs, units, start };
                    start += inputs * units;
                    weights.then_some(layer)
                };
                self.encoder().parts().into_iter().filter_map(layer).collect()
            }
            None => {
                let mut start = 0;
                let layer = |inputs| {
                    let layer = DenseLayer { inputs: ConvolutionLayers::weights(inputs, 1), units: self.units, start };
                    start += self.units * (layer.inputs + 1);
                    layer
                };
                ConvolutionLayers::inputs_of_layers(self.inputs, self.units, self.window).map(layer).collect()
            }
        }
    }

    /// Position of the first parameter of the dense network.
    pub(super) fn head_start(&self) -> usize {
        match self.cell() {
            Some(cell) => RecurrentLayer::parameters(cell, self.inputs, self.units),
            None if self.memory == MemoryLayers::Transformer => self.encoder().parameters(),
            None => self.layers().iter().map(|layer| layer.units * (layer.inputs + 1)).sum(),
        }
    }

    /// The number of parameters.
    pub fn parameters(&self) -> usize {
        self.head_start() + self.head.parameters()
    }

    /// The name of each parameter. `wx[3,17]`, `wh[3,2]`, `bx[3]`, `bh[3]` belong to gate and unit 3. `c1[3,2,17]` is
    /// the weight of unit 3 of the first convolution for input 17 of its second sample, and `bc1[3]` its bias. The
    /// names of the dense network follow.
    pub fn names(&self) -> Vec<String> {
        let mut names = Vec::with_capacity(self.parameters());
        let matrix = |name: &str, rows: usize, columns: usize| -> Vec<String> {
            (1..=rows)
                .flat_map(|row| (1..=columns).map(move |column| (row, column)))
                .map(|(row, column)| format!("{name}[{row},{column}]"))
                .collect()
        };
        if let Some(cell) = self.cell() {
            let sums = cell.gates() * self.units;
            names.extend(matrix("wx", sums, self.inputs));
            names.extend(matrix("wh", sums, self.units));
            for name in ["bx", "bh"] {
                names.extend((1..=sums).map(|sum| format!("{name}[{sum}]")));
            }
        } else if self.memory == MemoryLayers::Transformer {
            for (name, rows, columns, _) in self.encoder().parts() {
                match columns {
                    1 => names.extend((1..=rows).map(|row| format!("{name}[{row}]"))),
                    _ => names.extend(matrix(name, rows, columns)),
                }
            }
        } else {
            for (number, layer) in (1..).zip(self.layers()) {
                let half = layer.inputs / 2;
                for unit in 1..=self.units {
                    names.extend(
                        (1..=2).flat_map(|sample| {
                            (1..=half).map(move |input| format!("c{number}[{unit},{sample},{input}]"))
                        }),
                    );
                }
                names.extend((1..=self.units).map(|unit| format!("bc{number}[{unit}]")));
            }
        }
        names.extend(self.head.names());
        names
    }

    /// Initial parameters from a seed. The parameters of `gru` and `lstm` are uniform between ±1/√units, as in PyTorch.
    /// The parameters of `tcn` are drawn as for dense layers, as are the matrices of `transformer`. The positions of
    /// `transformer` are uniform between ±0.02, as in MagNav.jl, and its normalisations start with offset 0 and
    /// factor 1. The parameters of the dense network are drawn as in [`NetworkShape::initial`].
    pub fn initial(&self, seed: u64, linear: &[f64]) -> Vec<f64> {
        let mut bits = SplitMix64::new(derived_seed(seed, &[NetworkRandomStream::Memory as u64]));
        let mut within = |most: f64| most * (2.0 * unit_uniform(bits.draw()) - 1.0);
        let mut parameters = vec![0.0; self.head_start()];
        if self.cell().is_some() {
            let most = (self.units as f64).sqrt().recip();
            parameters.iter_mut().for_each(|x| *x = within(most));
        } else if self.memory == MemoryLayers::Transformer {
            let mut start = 0;
            for (name, rows, columns, weights) in self.encoder().parts() {
                let part = &mut parameters[start..start + rows * columns];
                start += rows * columns;
                match name {
                    _ if weights => {
                        let most = (6.0 / (rows + columns) as f64).sqrt();
                        part.iter_mut().for_each(|x| *x = within(most));
                    }
                    "p" => part.iter_mut().for_each(|x| *x = within(MOST_POSITION)),
                    "g1" | "g2" => part.fill(1.0),
                    _ => {}
                }
            }
        } else {
            for layer in self.layers() {
                let most = (6.0 / (layer.inputs + layer.units) as f64).sqrt();
                layer.split_mut(&mut parameters).0.iter_mut().for_each(|x| *x = within(most));
            }
        }
        parameters.extend(self.head.initial(seed, linear));
        parameters
    }

    /// The start of a training from parameters, as in [`TrainingState::new`].
    pub fn start(&self, parameters: Vec<f64>) -> TrainingState {
        let linear = self.head_start() + self.head.linear_start();
        TrainingState::beginning(parameters, linear, self.head.linear)
    }

    /// Checks that the network can be trained.
    ///
    /// # Errors
    /// Fails in the cases of [`NetworkShape::check`]. Also fails for a window or units of 0, a window of `tcn` that is
    /// not a power of two, or a dense network whose inputs do not match the features.
    pub fn check(&self) -> Result<(), TrainingError> {
        let heads = self.heads > 0 && self.units.is_multiple_of(self.heads);
        let whole = self.memory != MemoryLayers::Window || self.units == self.inputs * self.window;
        let powers = self.memory != MemoryLayers::Tcn || (self.window >= 2 && self.window.is_power_of_two());
        let settings = [
            ("the number of inputs", "at least 1", self.inputs, self.inputs > 0),
            ("the number of units", "at least 1", self.units, self.units > 0),
            ("the window", "at least 1 sample", self.window, self.window > 0),
            ("the number of heads", "a divisor of the number of units", self.heads, heads),
            ("the number of units of a whole window", "inputs times samples", self.units, whole),
            ("the window of convolutions", "a power of two, at least 2", self.window, powers),
            (
                "the number of inputs of the dense network",
                "the number of features",
                self.head.inputs,
                self.head.inputs == self.features(),
            ),
        ];
        match settings.into_iter().find(|(.., good)| !good) {
            Some((what, wanted, given, _)) => Err(TrainingError::Setting { what, wanted, given: given as f64 }),
            None => self.head.check(),
        }
    }

    /// Appends the windows that end at the given rows: for recurrent networks, the first samples of all windows, then
    /// the second samples, and so on; for other networks, window by window.
    pub(super) fn gather(
        &self,
        x: &[f64],
        first: &[u32],
        rows: impl Iterator<Item = usize> + Clone,
        out: &mut Vec<f64>,
    ) {
        let sample = |row: usize, back: usize| {
            let row = row.saturating_sub(back).max(first[row] as usize);
            &x[row * self.inputs..][..self.inputs]
        };
        match self.cell() {
            Some(_) => {
                for back in (0..self.window).rev() {
                    rows.clone().for_each(|row| out.extend_from_slice(sample(row, back)));
                }
            }
            None => {
                for row in rows {
                    (0..self.window).rev().for_each(|back| out.extend_from_slice(sample(row, back)));
                }
            }
        }
    }

    /// Predictions for runs of scaled inputs and linear terms (empty if there are none), run by run, in the scale of
    /// the target. All predictions are NaN if parameters, terms or lengths do not match. The prediction of a row is NaN
    /// if an input of its window is NaN.
    pub fn predict(&self, parameters: &[f64], x: &[f64], a: &[f64], lengths: &[usize]) -> Vec<f64> {
        let rows = x.len() / self.inputs.max(1);
        match first_rows(lengths, rows) {
            Some(first) if self.check().is_ok() && x.len() == rows * self.inputs => {
                self.predict_rows(parameters, x, a, &first)
            }
            _ => vec![f64::NAN; rows],
        }
    }

    pub(super) fn predict_rows(&self, parameters: &[f64], x: &[f64], a: &[f64], first: &[u32]) -> Vec<f64> {
        let linear = if a.is_empty() { 0 } else { self.head.row_of_terms() };
        let needed = if self.head.form == super::NetworkForm::Plain { linear } else { self.head.row_of_terms() };
        if parameters.len() != self.parameters() || a.len() != first.len() * needed {
            return vec![f64::NAN; first.len()];
        }
        let (of_body, of_head) = parameters.split_at(self.head_start());
        let mut head = PackedNetwork::new(&self.head);
        head.set(of_head);
        let mut out = vec![0.0; first.len()];
        out.par_chunks_mut(BLOCK).enumerate().for_each_init(
            || {
                let mut body = self.body();
                body.set(of_body);
                (body, BlockWorkspace::new(&self.head), vec![], vec![])
            },
            |(body, buffers, windows, features), (block, out)| {
                let start = block * BLOCK;
                windows.clear();
                features.resize(out.len() * self.features(), 0.0);
                self.gather(x, first, start..start + out.len(), windows);
                body.forward(windows, out.len(), features);
                let terms = NetworkLinearTerms::Rows(&a[start * linear..][..out.len() * linear]);
                buffers.forward(&head, features, terms, false, None);
                out.copy_from_slice(&buffers.predicted);
            },
        );
        out
    }
}

/// Network of dense layers, with or without memory layers before them.
#[derive(Clone, Copy)]
pub(super) struct NetworkArchitecture<'a> {
    pub windowed: Option<&'a WindowedNetworkShape>,
    pub head: &'a NetworkShape,
}

impl<'a> From<&'a NetworkShape> for NetworkArchitecture<'a> {
    fn from(head: &'a NetworkShape) -> Self {
        Self { windowed: None, head }
    }
}

impl<'a> From<&'a WindowedNetworkShape> for NetworkArchitecture<'a> {
    fn from(windowed: &'a WindowedNetworkShape) -> Self {
        Self { windowed: Some(windowed), head: &windowed.head }
    }
}

impl NetworkArchitecture<'_> {
    pub fn check(&self) -> Result<(), TrainingError> {
        self.windowed.map_or_else(|| self.head.check(), WindowedNetworkShape::check)
    }

    /// The number of inputs of a sample.
    pub fn inputs(&self) -> usize {
        self.windowed.map_or(self.head.inputs, |windowed| windowed.inputs)
    }

    pub fn head_start(&self) -> usize {
        self.windowed.map_or(0, WindowedNetworkShape::head_start)
    }

    pub fn parameters(&self) -> usize {
        self.head_start() + self.head.parameters()
    }

    /// The layers with weight decay.
    pub fn layers(&self) -> Vec<DenseLayer> {
        let start = self.head_start();
        let mut layers = self.windowed.map_or_else(Vec::new, WindowedNetworkShape::layers);
        layers.extend(self.head.layers().iter().map(|layer| DenseLayer { start: layer.start + start, ..*layer }));
        layers
    }

    pub fn predict(&self, parameters: &[f64], samples: &NetworkSamples<'_>, first: &[u32]) -> Vec<f64> {
        match self.windowed {
            Some(windowed) => windowed.predict_rows(parameters, samples.x, samples.a, first),
            None => self.head.predict(parameters, samples.x, samples.a),
        }
    }
}
