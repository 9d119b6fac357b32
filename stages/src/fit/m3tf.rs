//! Tolles-Lawson in vector form, with a scalar correction by a transformer over a window.

use learning::network::{MemoryLayers, NetworkForm};
use schemas::Rule;

use super::{
    model::{FitModel, model},
    network::{LinearPart, NetworkKeys, NetworkModel, VectorModelKeys, WindowLayers},
};

model! {
    /// The model `m3s` with a transformer over a window that ends at the predicted sample: f(v) + N(x of the window). A
    /// sample with inputs x is embedded as e = sqrt(d) (W x + b) + P. Here d is `units`, and P is a trained vector for
    /// each position in the window. Each attention head computes softmax(Q K' / sqrt(d / `heads`)) V, where Q, K and V
    /// are its parts of the queries, keys and values of e. A is the concatenated output of all heads, and LN is layer
    /// normalisation. The transformer layer computes n = LN(e + Wo A) and z = LN(n + activation(Wf n + bf)). The
    /// vectors z of all samples enter the dense layers of `hidden` (none by default) and a linear output.
    ///
    /// The window has no samples after the predicted sample, so the model is causal. `dropout` applies to z. By
    /// default, MagNav.jl also applies a batch normalisation, which is untrained because every call creates a new one.
    /// magline omits this normalisation and the option `:prelayer`.
    ///
    /// Source: Vaswani et al. 2017; MagNav.jl 1.3.3, `get_nn_m`, model `m3tf`.
    M3tf = "m3tf", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [],
    groups [network: NetworkKeys, part: LinearPart, vector: VectorModelKeys], example "epochs = 2\nwindow = 4";
    /// Number of samples in the window.
    window: usize, unit "samples", default 5usize, rule Rule::Between(2.0, 4096.0);
    /// Number of units that represent a sample in the transformer.
    units: usize, unit "1", default 8usize, rule Rule::Between(1.0, 1000.0);
    /// Number of attention heads, a divisor of `units`.
    heads: usize, unit "1", default 8usize, rule Rule::Between(1.0, 1000.0);
}

impl FitModel for M3tf {
    fn network(&self) -> Option<NetworkModel<'_>> {
        let (memory, window, units, heads) = (MemoryLayers::Transformer, self.window, self.units, self.heads);
        Some(NetworkModel {
            hidden: &[],
            window: Some(WindowLayers { memory, window, units, heads }),
            ..NetworkModel::vector(&self.network, NetworkForm::VectorScalar, &self.part, &self.vector)
        })
    }
}
