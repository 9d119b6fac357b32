//! A transformer encoder over a window: one layer of multi-head self-attention. [Vaswani et al. 2017]
//!
//! The encoder has d units and h heads of d/h units each. Let x be the inputs of T samples, and LN the layer
//! normalisation:
//!
//! ```text
//! e = √d (We x + be) + P            embedding and trained position of each sample
//! A = softmax(Q Kᵀ / √(d/h)) V      for each head, with Q, K, V = Wq e, Wk e, Wv e
//! n = LN₁(e + Wo A)                 heads side by side
//! z = LN₂(n + f(Wf n + bf))         f is the activation; z of all samples are the features
//! ```
//!
//! A window ends at the predicted sample, so attention between its samples is causal in time. The order and the
//! residual connections are those of MagNav.jl 1.3.3 (`m3tf`, `:postlayer`, one entry of `hidden`). MagNav.jl also
//! offers a batch normalisation, which it creates anew in every call and therefore does not train.

use super::activation::ActivationFunction;
use super::kernels::{WeightPanels, add_outer, affine, padded};
use super::passes::BLOCK;
use super::windowed::FeatureExtractor;

/// Constant that is added to the variance of a layer normalisation.
const LEAST_VARIANCE: f64 = 1e-5;

/// Sizes of an encoder, and the layout of its parameters: We (unit, input), be, P (sample, unit), Wq, Wk, Wv and Wo
/// (unit, unit), factors and offsets of LN₁, Wf (unit, unit), bf, factors and offsets of LN₂.
#[derive(Debug, Clone, Copy)]
pub(super) struct EncoderSizes {
    pub inputs: usize,
    pub units: usize,
    pub window: usize,
    pub heads: usize,
}

/// Matrix of parameters: its name, its numbers of rows and columns, and whether it holds weights. A vector has one
/// column.
pub(super) type EncoderPart = (&'static str, usize, usize, bool);

impl EncoderSizes {
    pub fn parts(&self) -> [EncoderPart; 13] {
        let Self { inputs, units, window, .. } = *self;
        [
            ("we", units, inputs, true),
            ("be", units, 1, false),
            ("p", window, units, false),
            ("wq", units, units, true),
            ("wk", units, units, true),
            ("wv", units, units, true),
            ("wo", units, units, true),
            ("g1", units, 1, false),
            ("o1", units, 1, false),
            ("wf", units, units, true),
            ("bf", units, 1, false),
            ("g2", units, 1, false),
            ("o2", units, 1, false),
        ]
    }

    pub fn parameters(&self) -> usize {
        self.parts().iter().map(|(_, rows, columns, _)| rows * columns).sum()
    }
}

/// Parameters by part.
struct EncoderParameters<'a>([&'a [f64]; 13]);

impl<'a> EncoderParameters<'a> {
    fn new(sizes: &EncoderSizes, mut parameters: &'a [f64]) -> Self {
        Self(sizes.parts().map(|(_, rows, columns, _)| {
            let (part, rest) = parameters.split_at(rows * columns);
            parameters = rest;
            part
        }))
    }
}

/// A dense layer with its gradient.
struct EncoderLayer {
    forward: WeightPanels,
    backward: WeightPanels,
    gradient: WeightPanels,
}

impl EncoderLayer {
    fn new(inputs: usize, units: usize) -> Self {
        let panels = |inputs, units| WeightPanels::new(inputs, units);
        Self { forward: panels(inputs, units), backward: panels(units, inputs), gradient: panels(inputs, units) }
    }

    fn set(&mut self, weights: &[f64], biases: &[f64]) {
        self.forward.set_layer(weights, biases);
        self.backward.set_transposed(weights);
    }

    /// Gradient with respect to the weights and biases, for rows of inputs and derivatives.
    fn add(&mut self, x: &[f64], stride: usize, d: &[f64], weights: &mut [f64], biases: &mut [f64]) {
        self.gradient.clear();
        add_outer(x, stride, d, &mut self.gradient);
        self.gradient.write(weights, biases);
    }
}

/// Layer normalisation of rows.
#[derive(Default)]
struct Normalisation {
    factors: Vec<f64>,
    offsets: Vec<f64>,
    /// Normalised rows, and the reciprocal of the standard deviation of each row.
    normal: Vec<f64>,
    per_deviation: Vec<f64>,
}

impl Normalisation {
    /// Normalises rows of `units` values, `stride` apart. Rows of `out` are `out_stride` apart.
    fn forward(&mut self, x: &[f64], stride: usize, out: &mut [f64], out_stride: usize) {
        let units = self.factors.len();
        let rows = x.len() / stride;
        self.normal.resize(rows * units, 0.0);
        self.per_deviation.clear();
        let each =
            x.chunks_exact(stride).zip(self.normal.chunks_exact_mut(units)).zip(out.chunks_exact_mut(out_stride));
        for ((x, normal), out) in each {
            let x = &x[..units];
            let mean = x.iter().sum::<f64>() / units as f64;
            let variance = x.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / units as f64;
            let per_deviation = 1.0 / (variance + LEAST_VARIANCE).sqrt();
            self.per_deviation.push(per_deviation);
            for k in 0..units {
                normal[k] = (x[k] - mean) * per_deviation;
                out[k] = self.factors[k] * normal[k] + self.offsets[k];
            }
        }
    }

    /// Derivatives with respect to the rows before the normalisation, from the derivatives after it.
    fn backward(
        &self,
        (after, stride): (&[f64], usize),
        (before, before_stride): (&mut [f64], usize),
        (factors, offsets): (&mut [f64], &mut [f64]),
    ) {
        let units = self.factors.len();
        factors.fill(0.0);
        offsets.fill(0.0);
        let rows = after.chunks_exact(stride).zip(before.chunks_exact_mut(before_stride));
        for ((d, before), (normal, per_deviation)) in rows.zip(self.normal.chunks_exact(units).zip(&self.per_deviation))
        {
            let (mut mean, mut along) = (0.0, 0.0);
            for k in 0..units {
                factors[k] += d[k] * normal[k];
                offsets[k] += d[k];
                let d = d[k] * self.factors[k];
                mean += d;
                along += d * normal[k];
            }
            (mean, along) = (mean / units as f64, along / units as f64);
            for k in 0..units {
                before[k] = per_deviation * (d[k] * self.factors[k] - mean - normal[k] * along);
            }
        }
    }
}

/// The encoder, for a block of rows.
pub(super) struct TransformerEncoder {
    sizes: EncoderSizes,
    activation: ActivationFunction,
    embed: EncoderLayer,
    attend: EncoderLayer,
    merge: EncoderLayer,
    dense: EncoderLayer,
    positions: Vec<f64>,
    norms: [Normalisation; 2],
    /// Embedded samples, their queries, keys and values, and the attention weights and results.
    embedded: Vec<f64>,
    queries: Vec<f64>,
    weights: Vec<f64>,
    merged: Vec<f64>,
    /// Inputs and outputs of the first normalisation, then the outputs and the slopes of the dense layer.
    sums: Vec<f64>,
    middle: Vec<f64>,
    out: Vec<f64>,
    slopes: Vec<f64>,
    d_sums: Vec<f64>,
    d_more: Vec<f64>,
    d_queries: Vec<f64>,
}

impl TransformerEncoder {
    pub fn new(activation: ActivationFunction, sizes: EncoderSizes) -> Self {
        let EncoderSizes { inputs, units, window, heads } = sizes;
        let of = |width: usize| vec![0.0; BLOCK * window * padded(width)];
        Self {
            sizes,
            activation,
            embed: EncoderLayer::new(inputs, units),
            attend: EncoderLayer::new(units, 3 * units),
            merge: EncoderLayer::new(units, units),
            dense: EncoderLayer::new(units, units),
            positions: vec![],
            norms: Default::default(),
            embedded: of(units),
            queries: of(3 * units),
            weights: vec![0.0; BLOCK * heads * window * window],
            merged: of(units),
            sums: of(units),
            middle: of(units),
            out: of(units),
            slopes: of(units),
            d_sums: of(units),
            d_more: of(units),
            d_queries: of(3 * units),
        }
    }

    /// Attention of all rows: fills `weights` and `merged`.
    fn attend(&mut self, rows: usize) {
        let EncoderSizes { units, window, heads, .. } = self.sizes;
        let (stride, wide, size) = (padded(units), padded(3 * units), units / heads);
        let scale = 1.0 / (size as f64).sqrt();
        let tokens = self.queries.chunks_exact(window * wide).zip(self.merged.chunks_exact_mut(window * stride));
        let blocks = tokens.zip(self.weights.chunks_exact_mut(heads * window * window)).take(rows);
        for ((queries, merged), weights) in blocks {
            for head in 0..heads {
                let first = head * size;
                for i in 0..window {
                    let query = &queries[i * wide + first..][..size];
                    let weights = &mut weights[(head * window + i) * window..][..window];
                    for (j, weight) in weights.iter_mut().enumerate() {
                        *weight = scale * dot(query, &queries[j * wide + units + first..][..size]);
                    }
                    softmax(weights);
                    let merged = &mut merged[i * stride + first..][..size];
                    merged.fill(0.0);
                    for (j, weight) in weights.iter().enumerate() {
                        let values = &queries[j * wide + 2 * units + first..][..size];
                        merged.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
                    }
                }
            }
        }
    }

    /// Derivatives with respect to queries, keys and values, from the derivatives `d_more` with respect to `merged`.
    fn attend_back(&mut self, rows: usize) {
        let EncoderSizes { units, window, heads, .. } = self.sizes;
        let (stride, wide, size) = (padded(units), padded(3 * units), units / heads);
        let scale = 1.0 / (size as f64).sqrt();
        self.d_queries[..rows * window * wide].fill(0.0);
        let mut slopes = vec![0.0; window];
        for row in 0..rows {
            let queries = &self.queries[row * window * wide..][..window * wide];
            let d_queries = &mut self.d_queries[row * window * wide..][..window * wide];
            for (head, i) in (0..heads).flat_map(|head| (0..window).map(move |i| (head, i))) {
                let first = head * size;
                let weights = &self.weights[((row * heads + head) * window + i) * window..][..window];
                let d_merged = &self.d_more[(row * window + i) * stride + first..][..size];
                let mut mean = 0.0;
                for (j, slope) in slopes.iter_mut().enumerate() {
                    let at = j * wide + 2 * units + first;
                    *slope = dot(d_merged, &queries[at..][..size]);
                    mean += weights[j] * *slope;
                    let d_values = &mut d_queries[at..][..size];
                    d_values.iter_mut().zip(d_merged).for_each(|(sum, d)| *sum += weights[j] * d);
                }
                for (j, slope) in slopes.iter().enumerate() {
                    let slope = scale * weights[j] * (slope - mean);
                    let (query, key) = (i * wide + first, j * wide + units + first);
                    for k in 0..size {
                        d_queries[query + k] += slope * queries[key + k];
                        d_queries[key + k] += slope * queries[query + k];
                    }
                }
            }
        }
    }
}

impl FeatureExtractor for TransformerEncoder {
    fn set(&mut self, parameters: &[f64]) {
        let EncoderParameters([we, be, p, wq, wk, wv, wo, g1, o1, wf, bf, g2, o2]) =
            EncoderParameters::new(&self.sizes, parameters);
        let none = vec![0.0; 3 * self.sizes.units];
        self.embed.set(we, be);
        self.attend.set(&[wq, wk, wv].concat(), &none);
        self.merge.set(wo, &none[..self.sizes.units]);
        self.dense.set(wf, bf);
        self.positions = p.to_vec();
        for (norm, (factors, offsets)) in self.norms.iter_mut().zip([(g1, o1), (g2, o2)]) {
            (norm.factors, norm.offsets) = (factors.to_vec(), offsets.to_vec());
        }
    }

    fn forward(&mut self, x: &[f64], rows: usize, features: &mut [f64]) {
        let EncoderSizes { inputs, units, window, .. } = self.sizes;
        let (samples, stride) = (rows * window, padded(units));
        let embedded = &mut self.embedded[..samples * stride];
        affine(x, inputs, &self.embed.forward, embedded);
        let scale = (units as f64).sqrt();
        for (embedded, position) in embedded.chunks_exact_mut(stride).zip(self.positions.chunks_exact(units).cycle()) {
            embedded.iter_mut().zip(position).for_each(|(e, position)| *e = scale * *e + position);
        }
        affine(embedded, stride, &self.attend.forward, &mut self.queries[..samples * padded(3 * units)]);
        self.attend(rows);
        let sums = &mut self.sums[..samples * stride];
        affine(&self.merged[..samples * stride], stride, &self.merge.forward, sums);
        sums.iter_mut().zip(&self.embedded).for_each(|(sum, e)| *sum += e);
        let middle = &mut self.middle[..samples * stride];
        self.norms[0].forward(sums, stride, middle, stride);
        let out = &mut self.out[..samples * stride];
        affine(middle, stride, &self.dense.forward, out);
        self.activation.apply_with_slopes(out, &mut self.slopes[..samples * stride]);
        out.iter_mut().zip(&*middle).for_each(|(out, middle)| *out += middle);
        self.norms[1].forward(out, stride, features, units);
    }

    fn backward(&mut self, x: &[f64], rows: usize, d_features: &[f64], gradient: &mut [f64]) {
        let EncoderSizes { inputs, units, window, .. } = self.sizes;
        let (samples, stride, wide) = (rows * window, padded(units), padded(3 * units));
        let mut rest = gradient;
        let [we, be, p, wq, wk, wv, wo, g1, o1, wf, bf, g2, o2] = self.sizes.parts().map(|(_, rows, columns, _)| {
            let (part, behind) = std::mem::take(&mut rest).split_at_mut(rows * columns);
            rest = behind;
            part
        });
        let mut none = vec![0.0; 3 * units];
        let (d_sums, d_more) = (&mut self.d_sums[..samples * stride], &mut self.d_more[..samples * stride]);
        // `d_sums` holds the derivatives along the residual connection, and `d_more` the derivatives through the layer
        // that the connection bypasses.
        self.norms[1].backward((d_features, units), (d_sums, stride), (g2, o2));
        d_more.iter_mut().zip(&*d_sums).zip(&self.slopes).for_each(|((more, d), slope)| *more = d * slope);
        self.dense.add(&self.middle[..samples * stride], stride, d_more, wf, bf);
        affine(d_more, stride, &self.dense.backward, &mut self.out[..samples * stride]);
        d_sums.iter_mut().zip(&self.out).for_each(|(sum, d)| *sum += d);
        self.norms[0].backward((d_sums, stride), (d_more, stride), (g1, o1));
        self.merge.add(&self.merged[..samples * stride], stride, d_more, wo, &mut none[..units]);
        d_sums.copy_from_slice(d_more);
        affine(d_sums, stride, &self.merge.backward, d_more);
        self.attend_back(rows);
        let d_queries = &self.d_queries[..samples * wide];
        let mut all = vec![0.0; 3 * units * units];
        self.attend.add(&self.embedded[..samples * stride], stride, d_queries, &mut all, &mut none);
        for (part, all) in [wq, wk, wv].into_iter().zip(all.chunks_exact(units * units)) {
            part.copy_from_slice(all);
        }
        let (d_sums, d_more) = (&mut self.d_sums[..samples * stride], &mut self.d_more[..samples * stride]);
        affine(d_queries, wide, &self.attend.backward, d_more);
        d_sums.iter_mut().zip(&*d_more).for_each(|(sum, d)| *sum += d);
        p.fill(0.0);
        for d_window in d_sums.chunks_exact(window * stride) {
            for (position, d) in p.chunks_exact_mut(units).zip(d_window.chunks_exact(stride)) {
                position.iter_mut().zip(d).for_each(|(sum, d)| *sum += d);
            }
        }
        let scale = (units as f64).sqrt();
        d_sums.iter_mut().for_each(|d| *d *= scale);
        self.embed.add(x, inputs, d_sums, we, be);
    }
}

/// Replaces numbers by their exponentials, divided by the sum of the exponentials.
fn softmax(x: &mut [f64]) {
    let largest = x.iter().fold(f64::NEG_INFINITY, |most, x| x.max(most));
    let mut sum = 0.0;
    for x in x.iter_mut() {
        *x = libm::exp(*x - largest);
        sum += *x;
    }
    x.iter_mut().for_each(|x| *x /= sum);
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
