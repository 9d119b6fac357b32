//! The model `m3v`, trained with a curriculum.

use learning::network::NetworkForm;

use super::{
    model::{FitModel, model},
    network::{CurriculumKeys, LinearPart, NetworkKeys, NetworkModel, VectorModelKeys},
};

model! {
    /// The model `m3v`, trained in the five phases of `m3sc`: Tolles-Lawson first, then the network, then both.
    ///
    /// Source: MagNav.jl 1.3.3, `nn_comp_3_train` and `get_curriculum_ind`, model `m3vc`.
    M3vc = "m3vc", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [whiten],
    groups [network: NetworkKeys, part: LinearPart, vector: VectorModelKeys, curriculum: CurriculumKeys],
    example "epochs = 10";
}

impl FitModel for M3vc {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel {
            curriculum: Some(self.curriculum.curriculum_sigma),
            ..NetworkModel::vector(&self.network, NetworkForm::VectorNetwork, &self.part, &self.vector)
        })
    }
}
