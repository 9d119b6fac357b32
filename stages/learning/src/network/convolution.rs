//! Causal convolutions with a dilation that doubles from layer to layer. [van den Oord et al. 2016; Bai, Kolter &
//! Koltun 2018]
//!
//! Each layer combines two samples that are 1, 2, 4, … samples apart: h(t) = f(W₀ h′(t − d) + W₁ h′(t) + b). The last
//! sample of a window depends only on every second result of the previous layer. With a window of 2ⁿ samples in order,
//! each layer therefore combines adjacent pairs of these results. The convolution is computed as a dense layer whose
//! rows are the pairs.

use super::activation::ActivationFunction;
use super::kernels::{WeightPanels, add_outer, affine, padded};
use super::passes::BLOCK;
use super::windowed::FeatureExtractor;

/// Number of samples that a layer combines.
const TAPS: usize = 2;

/// The convolutions of a network, for a block of rows.
///
/// Parameters, layer by layer: the weights, row-major (unit, sample, input) with the earlier sample first, then the
/// biases.
pub(super) struct ConvolutionLayers {
    activation: ActivationFunction,
    units: usize,
    window: usize,
    layers: Vec<ConvolutionLayer>,
    delta: Vec<f64>,
    delta_before: Vec<f64>,
}

struct ConvolutionLayer {
    inputs: usize,
    /// Number of values per sample in the input rows of this layer; padded from the second layer on.
    stride: usize,
    forward: WeightPanels,
    backward: WeightPanels,
    gradient: WeightPanels,
    /// Weights, or the gradient with respect to the weights, with padded inputs.
    spread: Vec<f64>,
    /// The activations of all rows, and the derivatives of the activations.
    out: Vec<f64>,
    slopes: Vec<f64>,
}

impl ConvolutionLayers {
    /// Convolutions of `units` over a window of 2ⁿ samples.
    pub fn new(activation: ActivationFunction, inputs: usize, units: usize, window: usize) -> Self {
        let mut layers = vec![];
        let mut left = window;
        while left > 1 {
            left /= TAPS;
            let (inputs, stride) = if layers.is_empty() { (inputs, inputs) } else { (units, padded(units)) };
            layers.push(ConvolutionLayer {
                inputs,
                stride,
                forward: WeightPanels::new(TAPS * stride, units),
                backward: WeightPanels::new(units, TAPS * stride),
                gradient: WeightPanels::new(TAPS * stride, units),
                spread: vec![0.0; units * TAPS * stride],
                out: vec![0.0; BLOCK * left * padded(units)],
                slopes: vec![0.0; BLOCK * left * padded(units)],
            });
        }
        let widest = BLOCK * window * padded(units);
        Self { activation, units, window, layers, delta: vec![0.0; widest], delta_before: vec![0.0; widest] }
    }

    /// The number of inputs of a sample, layer by layer.
    pub fn inputs_of_layers(inputs: usize, units: usize, window: usize) -> impl Iterator<Item = usize> {
        (0..window.max(1).ilog2()).map(move |layer| if layer == 0 { inputs } else { units })
    }

    /// Number of weights of a layer with `inputs` inputs per sample.
    pub const fn weights(inputs: usize, units: usize) -> usize {
        units * TAPS * inputs
    }
}

impl FeatureExtractor for ConvolutionLayers {
    fn set(&mut self, parameters: &[f64]) {
        let mut rest = parameters;
        for layer in &mut self.layers {
            let (weights, behind) = rest.split_at(Self::weights(layer.inputs, self.units));
            let (biases, behind) = behind.split_at(self.units);
            layer.spread.fill(0.0);
            let taps = layer.spread.chunks_exact_mut(layer.stride).zip(weights.chunks_exact(layer.inputs));
            taps.for_each(|(spread, weights)| spread[..layer.inputs].copy_from_slice(weights));
            layer.forward.set_layer(&layer.spread, biases);
            layer.backward.set_transposed(&layer.spread);
            rest = behind;
        }
    }

    fn forward(&mut self, x: &[f64], rows: usize, features: &mut [f64]) {
        let stride = padded(self.units);
        let mut samples = rows * self.window;
        for number in 0..self.layers.len() {
            let (before, behind) = self.layers.split_at_mut(number);
            let Some(layer) = behind.first_mut() else { return };
            let x = before.last().map_or(x, |before| &before.out[..samples * stride]);
            samples /= TAPS;
            let out = &mut layer.out[..samples * stride];
            affine(x, TAPS * layer.stride, &layer.forward, out);
            self.activation.apply_with_slopes(out, &mut layer.slopes[..samples * stride]);
        }
        let Some(last) = self.layers.last() else { return };
        for (feature, out) in features.chunks_exact_mut(self.units).zip(last.out.chunks_exact(stride)) {
            feature.copy_from_slice(&out[..self.units]);
        }
    }

    fn backward(&mut self, x: &[f64], rows: usize, d_features: &[f64], gradient: &mut [f64]) {
        let stride = padded(self.units);
        let mut samples = rows;
        self.delta[..rows * stride].fill(0.0);
        for (delta, d) in self.delta.chunks_exact_mut(stride).zip(d_features.chunks_exact(self.units)) {
            delta[..self.units].copy_from_slice(d);
        }
        let mut end = gradient.len();
        for number in (0..self.layers.len()).rev() {
            let (before, behind) = self.layers.split_at_mut(number);
            let Some(layer) = behind.first_mut() else { return };
            let delta = &mut self.delta[..samples * stride];
            delta.iter_mut().zip(&layer.slopes).for_each(|(delta, slope)| *delta *= slope);
            let x = before.last().map_or(x, |before| &before.out[..samples * TAPS * stride]);
            layer.gradient.clear();
            add_outer(x, TAPS * layer.stride, delta, &mut layer.gradient);
            let start = end - Self::weights(layer.inputs, self.units) - self.units;
            let (weights, biases) = gradient[start..end].split_at_mut(end - start - self.units);
            layer.gradient.write(&mut layer.spread, biases);
            let taps = weights.chunks_exact_mut(layer.inputs).zip(layer.spread.chunks_exact(layer.stride));
            taps.for_each(|(weights, spread)| weights.copy_from_slice(&spread[..layer.inputs]));
            end = start;
            if number > 0 {
                let before = &mut self.delta_before[..samples * TAPS * stride];
                affine(delta, stride, &layer.backward, before);
                std::mem::swap(&mut self.delta, &mut self.delta_before);
                samples *= TAPS;
            }
        }
    }
}
