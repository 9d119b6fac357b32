//! Tolles-Lawson in vector form, with a vector correction by a network.

use learning::network::NetworkForm;

use super::{
    model::{FitModel, model},
    network::{LinearPart, NetworkKeys, NetworkModel, VectorModelKeys},
};

model! {
    /// The model `m3tl` with a vector correction from a network with three outputs: f(v + N(x)) plus a constant. The
    /// gradient with respect to N equals the gradient with respect to v. The output biases of the network and the
    /// permanent coefficients have the same effect, so the data determine only their sums. In contrast to `m3s`, the
    /// effect of an electric current depends on the attitude even if the attitude is not an input of the network.
    ///
    /// Source: MagNav.jl 1.3.3, `nn_comp_3_fwd`, model `m3v`.
    M3v = "m3v", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [whiten],
    groups [network: NetworkKeys, part: LinearPart, vector: VectorModelKeys], example "epochs = 10";
}

impl FitModel for M3v {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel::vector(&self.network, NetworkForm::VectorNetwork, &self.part, &self.vector))
    }
}
