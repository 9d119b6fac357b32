//! The model `m3s`, trained with a curriculum.

use learning::network::NetworkForm;

use super::{
    model::{FitModel, model},
    network::{CurriculumKeys, LinearPart, NetworkKeys, NetworkModel, VectorModelKeys},
};

model! {
    /// The model `m3s`, trained in five phases. The first three phases train only the Tolles-Lawson coefficients, on
    /// samples that the ridge fit predicts well.
    ///
    /// | fraction of `epochs` | trained | prediction | samples |
    /// |---|---|---|---|
    /// | 0 to 0.1 | permanent coefficients | f(v) | near the mean |
    /// | 0.1 to 0.2 | permanent and induced coefficients | f(v) | near the mean |
    /// | 0.2 to 0.3 | all coefficients | f(v) | near the mean |
    /// | 0.3 to 0.6 | network | f(v) + N(x) | all |
    /// | 0.6 to 1 | coefficients and network | f(v) + N(x) | all |
    ///
    /// A sample is near the mean if the ridge fit's error at the sample differs from the mean error by at most
    /// `curriculum_sigma` standard deviations of the error. The constant is trained in every phase. Adam restarts in
    /// each phase. `validation` selects an epoch after the first 30 % of the epochs. `whiten` applies to the inputs
    /// only.
    ///
    /// MagNav.jl selects an epoch from all phases. If it selects an epoch of the first three phases, the result
    /// contains the untrained network.
    ///
    /// Source: MagNav.jl 1.3.3, `nn_comp_3_train` and `get_curriculum_ind`, model `m3sc`.
    M3sc = "m3sc", version 1, scaling Standardise, intercept true, made of Samples, choose [Given], takes [whiten],
    groups [network: NetworkKeys, part: LinearPart, vector: VectorModelKeys, curriculum: CurriculumKeys],
    example "epochs = 10";
}

impl FitModel for M3sc {
    fn network(&self) -> Option<NetworkModel<'_>> {
        Some(NetworkModel {
            curriculum: Some(self.curriculum.curriculum_sigma),
            ..NetworkModel::vector(&self.network, NetworkForm::VectorScalar, &self.part, &self.vector)
        })
    }
}
