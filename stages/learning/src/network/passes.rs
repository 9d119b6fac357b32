//! Forward pass and backpropagation through a network, for a block of rows.

use rayon::prelude::*;

use numerics::random::SplitMix64;

use super::kernels::{WeightPanels, add_outer, affine, padded};
use super::shape::{NetworkForm, NetworkShape, unit_uniform};
use super::vector::{ROW, VectorCoefficients, VectorGradient};

/// Rows per block. Sums within a block are over rows in order, and sums over blocks are in order, so that results do
/// not depend on the number of threads.
pub(super) const BLOCK: usize = 256;

/// Network with its weights laid out for the matrix products.
pub(super) struct PackedNetwork<'a> {
    shape: &'a NetworkShape,
    forward: Vec<WeightPanels>,
    /// The transposed weights; for the first layer only if derivatives with respect to the inputs are needed.
    backward: Vec<WeightPanels>,
    /// The coefficients of the linear terms and the constant, if the form has them.
    b: Vec<f64>,
    /// The coefficients as matrices, for the vector forms.
    vector: VectorCoefficients,
}

impl<'a> PackedNetwork<'a> {
    pub fn new(shape: &'a NetworkShape) -> Self {
        let layers = shape.layers();
        Self {
            forward: layers.iter().map(|layer| WeightPanels::new(layer.inputs, layer.units)).collect(),
            backward: layers.iter().map(|layer| WeightPanels::new(layer.units, layer.inputs)).collect(),
            b: vec![0.0; shape.parameters() - shape.linear_start()],
            vector: VectorCoefficients::default(),
            shape,
        }
    }

    /// Sets the parameters.
    pub fn set(&mut self, parameters: &[f64]) {
        for (number, layer) in self.shape.layers().iter().enumerate() {
            let weights = layer.weights(parameters);
            self.forward[number].set_layer(weights, layer.biases(parameters));
            self.backward[number].set_transposed(weights);
        }
        self.b.copy_from_slice(&parameters[self.shape.linear_start()..]);
        if self.shape.form.is_vector() {
            self.vector = VectorCoefficients::new(&self.b[..self.shape.linear]);
        }
    }
}

/// Workspace of a block of rows.
pub(super) struct BlockWorkspace {
    /// Sums of each layer, which are replaced by its activations; rows padded to whole panels.
    layers: Vec<Vec<f64>>,
    /// The derivatives of the activations of each hidden layer.
    slopes: Vec<Vec<f64>>,
    delta: Vec<f64>,
    delta_before: Vec<f64>,
    /// The prediction of each row.
    pub predicted: Vec<f64>,
    gradient: Vec<WeightPanels>,
    gradient_b: Vec<f64>,
    /// For the vector forms: the gradient of each prediction with respect to the vector field.
    directions: Vec<[f64; 3]>,
}

/// Linear terms of a block of rows.
#[derive(Clone, Copy)]
pub(super) enum NetworkLinearTerms<'a> {
    /// Unchanged terms, row-major.
    Rows(&'a [f64]),
    /// Sums of terms times their coefficients, for [`NetworkForm::FixedLinear`], whose coefficients are constant.
    Products(&'a [f64]),
}

impl<'a> NetworkLinearTerms<'a> {
    fn rows(self) -> &'a [f64] {
        match self {
            NetworkLinearTerms::Rows(rows) => rows,
            NetworkLinearTerms::Products(_) => &[],
        }
    }
}

/// Dropout of hidden units in a pass: probability and seed.
#[derive(Clone, Copy)]
pub(super) struct Dropout {
    pub probability: f64,
    pub seed: u64,
}

impl BlockWorkspace {
    pub fn new(shape: &NetworkShape) -> Self {
        let layers = shape.layers();
        let widest = layers.iter().map(|layer| padded(layer.units)).max().unwrap_or(0).max(padded(shape.inputs));
        let of = |units: usize| vec![0.0; BLOCK * padded(units)];
        Self {
            layers: layers.iter().map(|layer| of(layer.units)).collect(),
            slopes: shape.hidden.iter().map(|units| of(*units)).collect(),
            delta: vec![0.0; BLOCK * widest],
            delta_before: vec![0.0; BLOCK * widest],
            predicted: Vec::with_capacity(BLOCK),
            gradient: layers.iter().map(|layer| WeightPanels::new(layer.inputs, layer.units)).collect(),
            gradient_b: vec![0.0; shape.linear],
            directions: vec![],
        }
    }

    /// Predicts at most a block of rows, into `predicted`. With `slopes`, keeps the values that backpropagation needs.
    pub fn forward(
        &mut self,
        network: &PackedNetwork<'_>,
        x: &[f64],
        a: NetworkLinearTerms<'_>,
        slopes: bool,
        dropout: Option<Dropout>,
    ) {
        let shape = network.shape;
        let rows = shape.rows(x, a.rows());
        let mut bits = dropout.map(|dropout| (dropout, SplitMix64::new(dropout.seed)));
        for (number, layer) in network.forward.iter().enumerate() {
            let (before, behind) = self.layers.split_at_mut(number);
            let Some(sums) = behind.first_mut() else { break };
            let units = shape.hidden.get(number).copied();
            let stride = padded(units.unwrap_or(shape.outputs()));
            let sums = &mut sums[..rows * stride];
            match before.last() {
                None => affine(x, shape.inputs, layer, sums),
                Some(before) => {
                    let stride = before.len() / BLOCK;
                    affine(&before[..rows * stride], stride, layer, sums);
                }
            }
            let Some(units) = units else { continue };
            let kept = &mut self.slopes[number][..rows * stride];
            if slopes {
                shape.activation.apply_with_slopes(sums, kept);
            } else {
                shape.activation.apply(sums);
            }
            if let Some((dropout, bits)) = &mut bits {
                let factor = 1.0 / (1.0 - dropout.probability);
                for (sums, slopes) in sums.chunks_exact_mut(stride).zip(kept.chunks_exact_mut(stride)) {
                    for (sum, slope) in sums.iter_mut().zip(slopes).take(units) {
                        let factor = if unit_uniform(bits.draw()) < dropout.probability { 0.0 } else { factor };
                        (*sum, *slope) = (*sum * factor, *slope * factor);
                    }
                }
            }
        }
        self.combine(network, a, rows);
    }

    /// Combines the outputs of the network and the linear terms into predictions.
    fn combine(&mut self, network: &PackedNetwork<'_>, a: NetworkLinearTerms<'_>, rows: usize) {
        let shape = network.shape;
        let stride = padded(shape.outputs());
        self.predicted.clear();
        let Some(outputs) = self.layers.last() else { return };
        let outputs = outputs[..rows * stride].chunks_exact(stride);
        if let NetworkLinearTerms::Products(products) = a {
            self.predicted.extend(outputs.zip(products).map(|(output, product)| output[0] + product));
            return;
        }
        // Without linear terms there are no products.
        let terms = |row: usize| &a.rows()[row * shape.linear..][..shape.linear];
        if shape.form.is_vector() {
            self.directions.clear();
            for (output, row) in outputs.zip(a.rows().as_chunks::<ROW>().0) {
                let (more, constant) = match shape.form {
                    NetworkForm::VectorNetwork => ([output[0], output[1], output[2]], network.b[shape.linear]),
                    _ => ([0.0; 3], output[0]),
                };
                let (field, direction) = network.vector.field(row, more);
                self.predicted.push(field + constant);
                self.directions.push(direction);
            }
            return;
        }
        match shape.form {
            NetworkForm::Plain | NetworkForm::VectorOnly | NetworkForm::VectorScalar | NetworkForm::VectorNetwork => {
                self.predicted.extend(outputs.map(|output| output[0]))
            }
            NetworkForm::Weights => {
                self.predicted.extend(outputs.enumerate().map(|(row, output)| dot(terms(row), output)));
            }
            NetworkForm::FixedLinear | NetworkForm::TrainedLinear => {
                let of = |(row, output): (usize, &[f64])| output[0] + dot(terms(row), &network.b);
                self.predicted.extend(outputs.enumerate().map(of));
            }
            NetworkForm::WeightsAroundFixed => {
                let of = |(row, output): (usize, &[f64])| dot(terms(row), output) + dot(terms(row), &network.b);
                self.predicted.extend(outputs.enumerate().map(of));
            }
        }
    }

    /// The derivatives of the predictions with respect to the outputs of the network, times `by_prediction` of each
    /// row. Written to `delta`.
    fn delta_of_outputs(&mut self, shape: &NetworkShape, a: &[f64], by_prediction: &[f64]) {
        let stride = padded(shape.outputs());
        let delta = self.delta[..by_prediction.len() * stride].chunks_exact_mut(stride);
        for (row, (delta, by)) in delta.zip(by_prediction).enumerate() {
            delta.fill(0.0);
            if shape.form.weighs() {
                let terms = &a[row * shape.linear..][..shape.linear];
                delta.iter_mut().zip(terms).for_each(|(delta, term)| *delta = by * term);
            } else if shape.form == NetworkForm::VectorNetwork {
                delta.iter_mut().zip(self.directions[row]).for_each(|(delta, direction)| *delta = by * direction);
            } else {
                delta[0] = *by;
            }
        }
    }

    /// Replaces `delta`, the derivatives with respect to the sums of a layer, by the derivatives with respect to the
    /// sums of the previous layer.
    fn step_back(&mut self, network: &PackedNetwork<'_>, number: usize, rows: usize) {
        let shape = network.shape;
        let stride = padded(shape.hidden.get(number).copied().unwrap_or(shape.outputs()));
        let stride_before = padded(shape.hidden[number - 1]);
        let before = &mut self.delta_before[..rows * stride_before];
        affine(&self.delta[..rows * stride], stride, &network.backward[number], before);
        let slopes = &self.slopes[number - 1][..rows * stride_before];
        before.iter_mut().zip(slopes).for_each(|(delta, slope)| *delta *= slope);
        std::mem::swap(&mut self.delta, &mut self.delta_before);
    }

    /// Gradient of a sum over the rows with respect to the parameters, given the derivatives of the sum with respect to
    /// the predictions. Requires [`forward`](Self::forward) with slopes.
    pub fn backward(
        &mut self,
        network: &PackedNetwork<'_>,
        x: &[f64],
        a: NetworkLinearTerms<'_>,
        by_prediction: &[f64],
        gradient: &mut [f64],
    ) {
        let shape = network.shape;
        let (rows, a) = (by_prediction.len(), a.rows());
        self.delta_of_outputs(shape, a, by_prediction);
        for number in (0..network.forward.len()).rev() {
            let stride = padded(shape.hidden.get(number).copied().unwrap_or(shape.outputs()));
            let panels = &mut self.gradient[number];
            panels.clear();
            let delta = &self.delta[..rows * stride];
            match number.checked_sub(1).and_then(|before| self.layers.get(before)) {
                None => add_outer(x, shape.inputs, delta, panels),
                Some(before) => {
                    let stride = before.len() / BLOCK;
                    add_outer(&before[..rows * stride], stride, delta, panels);
                }
            }
            if number > 0 {
                self.step_back(network, number, rows);
            }
        }
        for (layer, panels) in shape.layers().iter().zip(&mut self.gradient) {
            let (weights, biases) = layer.split_mut(gradient);
            panels.write(weights, biases);
        }
        let b = &mut gradient[shape.linear_start()..];
        b.fill(0.0);
        if shape.form == NetworkForm::TrainedLinear {
            self.gradient_b.fill(0.0);
            for (terms, by) in a.chunks_exact(shape.linear).zip(by_prediction) {
                self.gradient_b.iter_mut().zip(terms).for_each(|(sum, term)| *sum += by * term);
            }
            b.copy_from_slice(&self.gradient_b);
        }
        if shape.form.is_vector() {
            let mut sum = VectorGradient::default();
            let rows = a.as_chunks::<ROW>().0.iter().zip(&self.directions).zip(by_prediction);
            rows.for_each(|((row, direction), by)| sum.add(row, *direction, *by));
            sum.write(&mut b[..shape.linear]);
            if let Some(constant) = b.get_mut(shape.linear) {
                *constant = by_prediction.iter().sum();
            }
        }
    }

    /// The derivatives of each prediction with respect to the inputs of its row. Requires [`forward`](Self::forward)
    /// with slopes.
    fn by_inputs(&mut self, network: &PackedNetwork<'_>, a: &[f64], rows: usize, out: &mut [f64]) {
        self.delta_of_outputs(network.shape, a, &vec![1.0; rows]);
        for number in (1..network.forward.len()).rev() {
            self.step_back(network, number, rows);
        }
        self.step_to_inputs(network, rows, out);
    }

    /// Derivatives with respect to the inputs, computed from the derivatives with respect to the sums of the first
    /// layer. [`backward`](Self::backward) leaves the derivatives with respect to these sums in the workspace.
    pub fn step_to_inputs(&mut self, network: &PackedNetwork<'_>, rows: usize, out: &mut [f64]) {
        let shape = network.shape;
        let stride = padded(shape.hidden.first().copied().unwrap_or(shape.outputs()));
        let padded_inputs = padded(shape.inputs);
        let before = &mut self.delta_before[..rows * padded_inputs];
        affine(&self.delta[..rows * stride], stride, &network.backward[0], before);
        for (out, before) in out.chunks_exact_mut(shape.inputs).zip(before.chunks_exact(padded_inputs)) {
            out.copy_from_slice(&before[..shape.inputs]);
        }
    }
}

#[inline(always)]
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl NetworkShape {
    /// The number of rows, if parameters, inputs and linear terms match.
    fn rows_of(&self, parameters: &[f64], x: &[f64], a: &[f64]) -> Option<usize> {
        let rows = self.rows(x, a);
        let terms = if self.form == NetworkForm::Plain && a.is_empty() { 0 } else { rows * self.row_of_terms() };
        let fits = parameters.len() == self.parameters() && x.len() == rows * self.inputs && a.len() == terms;
        (fits && self.check().is_ok()).then_some(rows)
    }

    /// Predictions for rows of scaled inputs and of linear terms (empty if there are none), in the scale of the target.
    /// The vector forms require rows of [`VectorFrame::rows`](super::VectorFrame::rows) instead of linear terms. All
    /// predictions are NaN if parameters or terms do not match the shape. The prediction of a row with a NaN input is
    /// NaN.
    pub fn predict(&self, parameters: &[f64], x: &[f64], a: &[f64]) -> Vec<f64> {
        self.by_blocks(parameters, x, a, 1, |network, buffers, x, a, out| {
            buffers.forward(network, x, NetworkLinearTerms::Rows(a), false, None);
            out.copy_from_slice(&buffers.predicted);
        })
    }

    /// The derivatives of each prediction with respect to its scaled inputs, row by row; the arguments are those of
    /// [`predict`](Self::predict).
    pub fn gradient_of_inputs(&self, parameters: &[f64], x: &[f64], a: &[f64]) -> Vec<f64> {
        self.by_blocks(parameters, x, a, self.inputs, |network, buffers, x, a, out| {
            buffers.forward(network, x, NetworkLinearTerms::Rows(a), true, None);
            buffers.by_inputs(network, a, network.shape.rows(x, a), out);
        })
    }

    /// Outputs N(x) of the network alone for rows of scaled inputs, row-major, without the linear terms. All outputs
    /// are NaN if the parameters do not match the shape.
    pub fn network_outputs(&self, parameters: &[f64], x: &[f64], a: &[f64]) -> Vec<f64> {
        let outputs = self.outputs();
        self.by_blocks(parameters, x, a, outputs, |network, buffers, x, a, out| {
            buffers.forward(network, x, NetworkLinearTerms::Rows(a), false, None);
            let rows = buffers.layers.last().map_or(&[][..], Vec::as_slice).chunks_exact(padded(outputs));
            out.chunks_exact_mut(outputs).zip(rows).for_each(|(out, row)| out.copy_from_slice(&row[..outputs]));
        })
    }

    fn by_blocks(
        &self,
        parameters: &[f64],
        x: &[f64],
        a: &[f64],
        width: usize,
        work: impl Fn(&PackedNetwork<'_>, &mut BlockWorkspace, &[f64], &[f64], &mut [f64]) + Sync,
    ) -> Vec<f64> {
        let Some(rows) = self.rows_of(parameters, x, a) else {
            return vec![f64::NAN; self.rows(x, a) * width];
        };
        if width == 0 {
            return vec![];
        }
        let mut network = PackedNetwork::new(self);
        network.set(parameters);
        let mut out = vec![0.0; rows * width];
        let linear = if a.is_empty() { 0 } else { self.row_of_terms() };
        out.par_chunks_mut(BLOCK * width).enumerate().for_each_init(
            || BlockWorkspace::new(self),
            |buffers, (block, out)| {
                let (first, count) = (block * BLOCK, out.len() / width);
                let x = &x[first * self.inputs..][..count * self.inputs];
                let a = &a[first * linear..][..count * linear];
                work(&network, buffers, x, a, out);
            },
        );
        out
    }
}
