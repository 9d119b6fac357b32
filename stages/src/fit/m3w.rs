//! Tolles-Lawson in vector form, with a scalar correction by a network over a window.

use learning::network::{MemoryLayers, NetworkForm};
use schemas::Rule;

use super::{
    model::{FitModel, model},
    network::{LinearPart, NetworkKeys, NetworkModel, VectorModelKeys, WindowLayers},
};

model! {
    /// The model `m3s` with a network that reads the inputs x of all samples of a window: f(v) + N(x of the window).
    /// The window ends at the predicted sample. At the beginning of a run, the first sample replaces the missing
    /// earlier samples. MagNav.jl also joins consecutive lines with similar inputs into one run. In magline, runs end
    /// at gaps and at the end of the line.
    ///
    /// Source: MagNav.jl 1.3.3, `get_temporal_data` and `nn_comp_3_fwd`, model `m3w`.
    M3w = "m3w", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [],
    groups [network: NetworkKeys, part: LinearPart, vector: VectorModelKeys], example "epochs = 2\nwindow = 4";
    /// Number of samples in the window.
    window: usize, unit "samples", default 5usize, rule Rule::Between(2.0, 4096.0);
}

impl FitModel for M3w {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel {
            window: Some(WindowLayers { memory: MemoryLayers::Window, window: self.window, units: 1, heads: 1 }),
            ..NetworkModel::vector(&self.network, NetworkForm::VectorScalar, &self.part, &self.vector)
        })
    }
}
