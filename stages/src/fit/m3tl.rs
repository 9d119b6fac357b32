//! Tolles-Lawson in vector form, trained without a network.

use learning::network::NetworkForm;
use schemas::Fault;

use super::{
    model::{FitModel, model},
    network::{LinearPart, NetworkKeys, NetworkModel, VectorModelKeys},
};

model! {
    /// Tolles-Lawson in vector form, without a network. B is the field at the vector magnetometer and dB its difference
    /// per sample. The aircraft field is the vector v = p + M B/s + E dB/s. Here p is the permanent field, M the
    /// symmetric matrix of the induced field, E the matrix of the eddy currents, and s = `bt_scale_nt`. The
    /// off-diagonal elements of M are half of the coefficients xy, xz and yz. The prediction is a constant plus the
    /// scalar f(v) that `coupling` selects:
    ///
    /// | `coupling` | f(v) | gradient with respect to v |
    /// |---|---|---|
    /// | `magnitude` | \|B\| - \|B - v\| | (B - v) / \|B - v\| |
    /// | `projection` | v . B / \|B\| | B / \|B\| |
    ///
    /// The projection equals the linear Tolles-Lawson model. It exceeds the magnitude by about u^2 / (2 \|B\|), where u
    /// is the component of v perpendicular to B. For u = 2,000 nT in a field of 50,000 nT, the difference is 40 nT. The
    /// magnitude is exact if the vector magnetometer measures the same aircraft field as the scalar magnetometer. B and
    /// dB are computed from the Tolles-Lawson terms, which must include all permanent and induced terms, and all eddy
    /// terms or none. Other terms are ignored. The keys of a network (`hidden`, `activation`, `inputs`, `weight_decay`,
    /// `dropout`, `group_lasso`, `group_share`) are rejected.
    ///
    /// Training starts from the ridge fit of the terms. During training, terms are centred and scaled, and decorrelated
    /// if `whiten` is set. The target should be the aircraft field including its constant part, such as `target` with
    /// `kind = "d"` or `"c"`. If `epochs` is 0 and `lbfgs_epochs` is large, the projection gives the least-squares
    /// solution.
    ///
    /// MagNav.jl uses the projection for its targets c and d. For a and b it compares \|B - v\| with the earth's field,
    /// so errors of the vector magnetometer enter directly. magline always subtracts the prediction from the reading of
    /// the scalar magnetometer. MagNav.jl's model has no constant. MagNav.jl trains coefficients in nT, so a step of
    /// Adam changes them by 0.001 nT. magline divides the trained coefficients by the scale of the target.
    ///
    /// Source: MagNav.jl 1.3.3, `nn_comp_3_fwd` and `TL_vec2mat`, model `m3tl`.
    M3tl = "m3tl", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [whiten],
    groups [network: NetworkKeys, part: LinearPart, vector: VectorModelKeys], example "epochs = 10";
}

/// Keys of a network that this model does not have.
const OF_NETWORK: [&str; 7] =
    ["hidden", "activation", "inputs", "weight_decay", "dropout", "group_lasso", "group_share"];

impl FitModel for M3tl {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel::vector(&self.network, NetworkForm::VectorOnly, &self.part, &self.vector))
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        if OF_NETWORK.contains(&key) {
            return Some(Fault::new(format!("`{key}` has no effect, because `m3tl` has no network")));
        }
        self.network()?.unused_key(key)
    }
}
