//! Curriculum of the models m3sc and m3vc of MagNav.jl: Tolles-Lawson first, then the network, then both.
//!
//! | phase | fraction of the epochs of Adam | trained | network | samples |
//! |---|---|---|---|---|
//! | 1 | 0 to 0.1 | permanent coefficients | off | near the mean |
//! | 2 | 0.1 to 0.2 | permanent and induced | off | near the mean |
//! | 3 | 0.2 to 0.3 | all coefficients | off | near the mean |
//! | 4 | 0.3 to 0.6 | the network | on | all |
//! | 5 | 0.6 to 1 | all parameters | on | all |
//!
//! The constant of the prediction is trained in every phase. A sample is near the mean if the error of the initial
//! coefficients at the sample differs from the mean error by at most a given number of standard deviations. Adam starts
//! again in each phase. The best epoch is selected, and the patience is counted, from phase 4 on.
//!
//! MagNav.jl 1.3.3 compares the losses of all phases with each other. If the smallest loss is in phases 1 to 3, the
//! selected model contains the untrained network, although these losses exclude the network. With MagNav.jl's default
//! of five epochs, phases 2 and 3 are empty.

use std::borrow::Cow;
use std::ops::Range;

use super::error::TrainingError;
use super::shape::{NetworkForm, NetworkShape};
use super::terms::TermScaling;
use super::training::{NetworkSamples, NetworkTraining};
use super::vector::{TERMS_WITHOUT_EDDY, tolles_lawson_fields};
use super::windowed::NetworkArchitecture;

/// Ends of all phases except the last, in tenths of the epochs.
const ENDS: [usize; 4] = [1, 2, 3, 6];
/// Smallest number of epochs that gives each phase at least one epoch.
pub const CURRICULUM_EPOCHS: usize = 10;
/// Number of permanent terms.
const PERMANENT: usize = 3;

/// A phase that does not train all parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TrainingPhase {
    /// Trains this number of coefficients, without the network.
    Coefficients(usize),
    /// Trains the network.
    Network,
}

impl TrainingPhase {
    /// Whether the network is a part of the prediction.
    pub fn has_network(phase: Option<Self>) -> bool {
        !matches!(phase, Some(Self::Coefficients(_)))
    }
}

impl NetworkTraining {
    /// Phase of an epoch, counted from 0. `None` if all parameters are trained.
    pub(super) fn phase(&self, epoch: usize) -> Option<TrainingPhase> {
        self.curriculum?;
        let within = |end: &usize| 10 * epoch < end * self.epochs;
        match ENDS.iter().position(within)? {
            0 => Some(TrainingPhase::Coefficients(PERMANENT)),
            1 => Some(TrainingPhase::Coefficients(TERMS_WITHOUT_EDDY)),
            2 => Some(TrainingPhase::Coefficients(usize::MAX)),
            _ => Some(TrainingPhase::Network),
        }
    }

    /// Number of epochs before the network is trained.
    pub(super) fn epochs_without_network(&self) -> usize {
        (0..self.epochs).find(|epoch| TrainingPhase::has_network(self.phase(*epoch))).unwrap_or(0)
    }

    /// Parameters of the prediction in a phase, computed from the trained parameters. The coefficients belong to the
    /// unscaled terms, and the output layer is zero in the phases without the network.
    pub(super) fn plain<'p>(
        &self,
        model: NetworkArchitecture<'_>,
        phase: Option<TrainingPhase>,
        parameters: &'p [f64],
    ) -> Cow<'p, [f64]> {
        if self.conditioning.is_none() && phase.is_none() {
            return Cow::Borrowed(parameters);
        }
        let (of_body, of_head) = parameters.split_at(model.head_start());
        let of_head = self
            .conditioning
            .as_ref()
            .map_or_else(|| of_head.to_vec(), |c: &TermScaling| c.original(model.head, of_head));
        let mut out = [of_body, &of_head].concat();
        if !TrainingPhase::has_network(phase)
            && let Some(layer) = model.layers().last()
        {
            out[layer.range()].fill(0.0);
            if model.head.form == NetworkForm::VectorNetwork {
                out[layer.range().end..][..layer.units].fill(0.0);
            }
        }
        Cow::Owned(out)
    }

    /// Converts a gradient with respect to the parameters of the prediction to a gradient with respect to the trained
    /// parameters.
    pub(super) fn pull_back(&self, model: NetworkArchitecture<'_>, gradient: &mut [f64]) {
        if let Some(conditioning) = &self.conditioning {
            conditioning.pull_back(model.head, &mut gradient[model.head_start()..]);
        }
    }

    /// Ranges of the parameters that a phase trains. The second range may be empty.
    pub(super) fn trained(&self, model: NetworkArchitecture<'_>, phase: Option<TrainingPhase>) -> [Range<usize>; 2] {
        let head: &NetworkShape = model.head;
        let (first, end) = (model.head_start() + head.linear_start(), model.parameters());
        let constant = model.head_start() + head.last_bias();
        match phase {
            None => [0..end, end..end],
            Some(TrainingPhase::Coefficients(count)) => [first..first + count.min(head.linear), constant..constant + 1],
            Some(TrainingPhase::Network) if constant < first => [0..first, first..first],
            Some(TrainingPhase::Network) => [0..first, constant..constant + 1],
        }
    }

    /// Whether each row is near the mean and used in the first phases; `None` without a curriculum.
    ///
    /// # Errors
    /// Fails if no row is near the mean.
    pub(super) fn near_the_mean(
        &self,
        samples: &NetworkSamples<'_>,
        tolles_lawson: &[f64],
    ) -> Result<Option<Vec<bool>>, TrainingError> {
        let Some(deviations) = self.curriculum else { return Ok(None) };
        let fields = tolles_lawson_fields(samples.a, tolles_lawson);
        let errors: Vec<f64> = samples.y.iter().zip(fields).map(|(y, field)| y - field).collect();
        let count = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / count;
        let variance = errors.iter().map(|e| (e - mean) * (e - mean)).sum::<f64>() / (count - 1.0).max(1.0);
        let most = deviations * variance.sqrt();
        let near: Vec<bool> = errors.iter().map(|e| (e - mean).abs() <= most).collect();
        if near.contains(&true) {
            return Ok(Some(near));
        }
        let what = "the threshold of the curriculum, in standard deviations,";
        Err(TrainingError::Setting { what, wanted: "large enough to select a sample", given: deviations })
    }
}
