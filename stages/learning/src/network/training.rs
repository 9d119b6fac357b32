//! Samples and settings of a training.

use rayon::prelude::*;

use super::curriculum::CURRICULUM_EPOCHS;
use super::error::TrainingError;
use super::loss::NetworkLoss;
use super::shape::{NetworkForm, NetworkShape};
use super::state::TrainingState;
use super::terms::TermScaling;
use super::windowed::NetworkArchitecture;

/// Rows for training or validation, in the scale of the network.
#[derive(Debug, Clone, Copy)]
pub struct NetworkSamples<'a> {
    /// The inputs, row-major.
    pub x: &'a [f64],
    /// The linear terms, row-major; empty if there are none. The vector forms require the rows of
    /// [`VectorFrame::rows`](super::VectorFrame::rows) instead.
    pub a: &'a [f64],
    /// The target.
    pub y: &'a [f64],
}

impl NetworkSamples<'_> {
    /// The number of linear terms of a row.
    pub(super) fn terms(&self, shape: &NetworkShape) -> usize {
        if self.a.is_empty() { 0 } else { shape.row_of_terms() }
    }

    pub(super) fn check(
        &self,
        model: NetworkArchitecture<'_>,
        what: &'static str,
        needs_terms: bool,
    ) -> Result<(), TrainingError> {
        let (inputs, linear) = (model.inputs(), model.head.row_of_terms());
        let rows = self.y.len();
        if rows == 0 {
            return Err(TrainingError::NoSamples { what });
        }
        if u32::try_from(rows).is_err() {
            return Err(TrainingError::Setting {
                what: "the number of samples",
                wanted: "below 2^32",
                given: rows as f64,
            });
        }
        let expect = |of, given: usize, expected: usize| {
            let error = TrainingError::Length { what, of, given, expected, rows };
            if given == expected { Ok(()) } else { Err(error) }
        };
        expect("inputs", self.x.len(), rows * inputs)?;
        if needs_terms || !self.a.is_empty() {
            expect("linear terms", self.a.len(), rows * linear)?;
        }
        let finite = |of, values: &[f64], width: usize| match values.par_iter().position_first(|x| !x.is_finite()) {
            None => Ok(()),
            Some(place) => {
                Err(TrainingError::NotFinite { what, of, row: place / width.max(1), column: place % width.max(1) })
            }
        };
        finite("input", self.x, inputs)?;
        finite("linear term", self.a, linear)?;
        finite("target", self.y, 1)
    }
}

/// Adam [Kingma & Ba 2015], followed by L-BFGS.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NetworkOptimiser {
    /// Decay rate of the mean of the gradient.
    pub beta_1: f64,
    /// Decay rate of the mean of the squared gradient.
    pub beta_2: f64,
    /// Constant added to the root of the mean square.
    pub epsilon: f64,
    /// Number of L-BFGS steps over all samples after the epochs of Adam; each counts as an epoch. These epochs use
    /// neither dropout nor weight decay.
    pub lbfgs_epochs: usize,
    /// Number of steps that L-BFGS stores.
    pub lbfgs_memory: usize,
}

impl Default for NetworkOptimiser {
    fn default() -> Self {
        Self { beta_1: 0.9, beta_2: 0.999, epsilon: 1e-8, lbfgs_epochs: 0, lbfgs_memory: 10 }
    }
}

/// Learning-rate schedule of Adam.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum LearningRateSchedule {
    /// Constant.
    #[default]
    Constant,
    /// The rate is multiplied by `factor` after every `every` epochs.
    Steps {
        /// Number of epochs between two changes of the rate.
        every: usize,
        /// The factor.
        factor: f64,
    },
    /// Half a period of a cosine, from the learning rate down to a fraction of it after the last epoch of Adam.
    /// [Loshchilov & Hutter 2017]
    Cosine {
        /// The final fraction.
        last: f64,
    },
    /// The rate is multiplied by `factor` after `patience` epochs without a new minimum of the validation loss.
    Plateau {
        /// Number of epochs.
        patience: usize,
        /// The factor.
        factor: f64,
    },
}

/// The sparse group lasso of the weights of the first layer, λ Σⱼ (1 − α) ‖wⱼ‖₁ + α ‖wⱼ‖₂ over the inputs j. The
/// penalty is added to the objective. Weights of an irrelevant input become small, not 0. [Gnadt 2022, (4.10)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SparseGroupLasso {
    /// λ, in the scale of the loss.
    pub strength: f64,
    /// α: 0 is the lasso, 1 the group lasso.
    pub alpha: f64,
}

/// Settings of the training of a network.
#[derive(Debug, Clone, PartialEq)]
pub struct NetworkTraining {
    /// The optimiser.
    pub optimiser: NetworkOptimiser,
    /// Number of epochs of Adam: passes over all samples.
    pub epochs: usize,
    /// Maximum number of samples per step. Each epoch uses the smallest possible number of batches, whose sizes differ
    /// by at most one.
    pub batch: usize,
    /// Adam's learning rate.
    pub learning_rate: f64,
    /// Learning-rate schedule.
    pub schedule: LearningRateSchedule,
    /// Loss function.
    pub loss: NetworkLoss,
    /// Decoupled weight decay: each step of Adam reduces the weights by this fraction times the learning rate. Biases
    /// and linear coefficients do not decay. [Loshchilov & Hutter 2019]
    pub weight_decay: f64,
    /// Dropout probability of a hidden unit for a sample and a step. The other units are multiplied by 1/(1 − p).
    /// [Srivastava et al. 2014]
    pub dropout: f64,
    /// Penalty on the weights of the first layer.
    pub sparse_group_lasso: Option<SparseGroupLasso>,
    /// The weight of the mean squared difference between the predictions and the Tolles-Lawson values a·b, with b from
    /// [`TrainingState::tolles_lawson`].
    pub physics: f64,
    /// For a vector form, the scaling in which the coefficients are trained.
    pub conditioning: Option<TermScaling>,
    /// For a vector form with a network, trains in the phases of a curriculum. The number is the largest deviation, in
    /// standard deviations, of the samples that the first phases use.
    pub curriculum: Option<f64>,
    /// Training ends after this number of consecutive epochs without a new minimum of the validation loss.
    pub patience: Option<usize>,
    /// Seed of the order of the samples and of dropout.
    pub seed: u64,
}

impl Default for NetworkTraining {
    fn default() -> Self {
        Self {
            optimiser: NetworkOptimiser::default(),
            epochs: 500,
            batch: 2048,
            learning_rate: 1e-3,
            schedule: LearningRateSchedule::Constant,
            loss: NetworkLoss::Squared,
            weight_decay: 0.0,
            dropout: 0.0,
            sparse_group_lasso: None,
            physics: 0.0,
            conditioning: None,
            curriculum: None,
            patience: None,
            seed: 0,
        }
    }
}

/// A row of the training curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrainingEpoch {
    /// Mean loss of the errors over the samples, with dropout and without penalties. For Adam, the loss of a sample is
    /// evaluated before the step that uses it; for L-BFGS, after the step.
    pub train_loss: f64,
    /// Mean loss of the errors over the validation samples after the epoch; NaN without validation.
    pub validation_loss: f64,
    /// Adam's learning rate in the epoch; NaN for L-BFGS, which searches for the length of each step.
    pub learning_rate: f64,
}

/// A trained network.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingResult {
    /// Parameters with the smallest validation loss; without validation, the last parameters.
    pub parameters: Vec<f64>,
    /// The training curve.
    pub epochs: Vec<TrainingEpoch>,
    /// The epoch of these parameters, from 1; 0 for the start.
    pub best: usize,
}

impl NetworkTraining {
    pub(super) fn check(
        &self,
        model: NetworkArchitecture<'_>,
        state: &TrainingState,
        validated: bool,
    ) -> Result<(), TrainingError> {
        let NetworkOptimiser { beta_1, beta_2, epsilon, lbfgs_epochs, lbfgs_memory } = self.optimiser;
        let part = |x: f64| (0.0..1.0).contains(&x);
        let at_least_0 = |x: f64| x >= 0.0 && x.is_finite();
        let above_0 = |x: f64| x > 0.0 && x.is_finite();
        let (mut steps, mut factor, mut last) = (1, 1.0, 0.0);
        match self.schedule {
            LearningRateSchedule::Constant => {}
            LearningRateSchedule::Steps { every, factor: by } => (steps, factor) = (every, by),
            LearningRateSchedule::Cosine { last: part } => last = part,
            LearningRateSchedule::Plateau { patience, factor: by } => (steps, factor) = (patience, by),
        }
        let delta = if let NetworkLoss::Huber { delta } = self.loss { delta } else { 1.0 };
        let lasso = self.sparse_group_lasso.unwrap_or(SparseGroupLasso { strength: 0.0, alpha: 0.0 });
        let settings = [
            ("the batch", "at least 1", self.batch as f64, self.batch > 0),
            ("the learning rate", "a number above 0", self.learning_rate, above_0(self.learning_rate)),
            ("beta_1", "at least 0 and below 1", beta_1, part(beta_1)),
            ("beta_2", "at least 0 and below 1", beta_2, part(beta_2)),
            ("epsilon", "a number above 0", epsilon, above_0(epsilon)),
            ("the memory of L-BFGS", "at least 1", lbfgs_memory as f64, lbfgs_memory > 0 || lbfgs_epochs == 0),
            ("the number of epochs between changes of the learning rate", "at least 1", steps as f64, steps > 0),
            ("the factor of the learning rate", "above 0 and at most 1", factor, factor > 0.0 && factor <= 1.0),
            ("the final fraction of the learning rate", "between 0 and 1", last, (0.0..=1.0).contains(&last)),
            ("the delta of the Huber loss", "a number above 0", delta, above_0(delta)),
            ("the weight decay", "a number of at least 0", self.weight_decay, at_least_0(self.weight_decay)),
            ("the dropout probability", "at least 0 and below 1", self.dropout, part(self.dropout)),
            (
                "the strength of the sparse group lasso",
                "a number of at least 0",
                lasso.strength,
                at_least_0(lasso.strength),
            ),
            ("alpha of the sparse group lasso", "between 0 and 1", lasso.alpha, (0.0..=1.0).contains(&lasso.alpha)),
            ("the weight of the physics term", "a number of at least 0", self.physics, at_least_0(self.physics)),
            (
                "the threshold of the curriculum, in standard deviations,",
                "a number above 0",
                self.curriculum.unwrap_or(1.0),
                above_0(self.curriculum.unwrap_or(1.0)),
            ),
            (
                "the number of epochs of a curriculum",
                "at least 10",
                self.epochs as f64,
                self.curriculum.is_none() || self.epochs >= CURRICULUM_EPOCHS,
            ),
        ];
        if let Some((what, wanted, given, _)) = settings.into_iter().find(|(.., good)| !good) {
            return Err(TrainingError::Setting { what, wanted, given });
        }
        if !validated && self.patience.is_some() {
            return Err(TrainingError::NoValidation { what: "the patience" });
        }
        if !validated && matches!(self.schedule, LearningRateSchedule::Plateau { .. }) {
            return Err(TrainingError::NoValidation { what: "a learning rate that is reduced on plateaus" });
        }
        let expect =
            |given, expected| if given == expected { Ok(()) } else { Err(TrainingError::Start { given, expected }) };
        let parameters = model.parameters();
        expect(state.parameters.len(), parameters)?;
        expect(state.parameters.iter().filter(|x| x.is_finite()).count(), parameters)?;
        expect(state.first_moments.len(), parameters)?;
        expect(state.second_moments.len(), parameters)?;
        expect(if state.best.is_empty() { parameters } else { state.best.len() }, parameters)?;
        let pairs = state.lbfgs.pairs.iter().flat_map(|(moved, change)| [moved.len(), change.len()]);
        pairs.into_iter().try_for_each(|given| expect(given, parameters))?;
        let vector = model.head.form.is_vector();
        if vector && self.physics > 0.0 {
            let what = "the weight of the physics term of the model 3 family";
            return Err(TrainingError::Setting { what, wanted: "0", given: self.physics });
        }
        if self.curriculum.is_some() {
            if !vector || model.head.form == NetworkForm::VectorOnly {
                let what = "the curriculum of a network without vector terms";
                return Err(TrainingError::Setting { what, wanted: "unset", given: self.curriculum.unwrap_or(0.0) });
            }
            expect(state.tolles_lawson.iter().filter(|x| x.is_finite()).count(), model.head.linear)?;
        }
        if self.physics > 0.0 {
            if model.head.linear == 0 {
                let what = "the number of linear terms, which the physics term requires,";
                return Err(TrainingError::Setting { what, wanted: "at least 1", given: 0.0 });
            }
            expect(state.tolles_lawson.iter().filter(|x| x.is_finite()).count(), model.head.linear)?;
        }
        Ok(())
    }

    /// Adam's learning rate in the next epoch after a state.
    pub(super) fn rate(&self, state: &TrainingState) -> f64 {
        let factor = match self.schedule {
            LearningRateSchedule::Constant => 1.0,
            LearningRateSchedule::Steps { every, factor } => {
                (0..state.epoch / every).fold(1.0, |product, _| product * factor)
            }
            LearningRateSchedule::Cosine { last } => {
                let passed = state.epoch as f64 / self.epochs as f64;
                last + (1.0 - last) * 0.5 * (1.0 + (std::f64::consts::PI * passed).cos())
            }
            LearningRateSchedule::Plateau { .. } => state.rate_factor,
        };
        self.learning_rate * factor
    }

    pub(super) fn ends(&self, state: &TrainingState) -> bool {
        let since = state.best_epoch.max(self.epochs_without_network());
        let waited = |patience: usize| state.epoch - since.min(state.epoch) >= patience.max(1);
        let given_up = state.epoch > 0 && self.patience.is_some_and(waited);
        let all = state.epoch >= self.epochs.saturating_add(self.optimiser.lbfgs_epochs);
        all || given_up || state.lbfgs.ended
    }
}
