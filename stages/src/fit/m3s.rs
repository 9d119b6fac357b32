//! Tolles-Lawson in vector form, with a scalar correction by a network.

use learning::network::NetworkForm;

use super::{
    model::{FitModel, model},
    network::{LinearPart, NetworkKeys, NetworkModel, VectorModelKeys},
};

model! {
    /// The model `m3tl` plus a scalar correction from a network: f(v) + N(x). The coefficients are trained together
    /// with the network, and start from the ridge fit. With `coupling = "projection"`, the prediction equals the
    /// prediction of `m2c` with the same terms.
    ///
    /// Source: MagNav.jl 1.3.3, `nn_comp_3_fwd`, model `m3s`.
    M3s = "m3s", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [whiten],
    groups [network: NetworkKeys, part: LinearPart, vector: VectorModelKeys], example "epochs = 10";
}

impl FitModel for M3s {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel::vector(&self.network, NetworkForm::VectorScalar, &self.part, &self.vector))
    }
}
