//! Keys of a network and of its training.

use learning::network::{self, ActivationFunction, NetworkOptimiser, NetworkTraining, SparseGroupLasso};
use schemas::{Fault, Rule, choice, params};

choice! {
    /// Loss function of the residual, relative to the scale of the target.
    pub enum TrainingLoss {
        /// Mean squared residual.
        Squared = "squared",
        /// Mean absolute residual.
        Absolute = "absolute",
        /// Huber loss: quadratic up to `huber_threshold`, linear beyond.
        Huber = "huber",
    }
}

choice! {
    /// Learning-rate schedule.
    pub enum LearningSchedule {
        /// Constant rate.
        Constant = "constant",
        /// Half a period of a cosine, from the initial rate to a hundredth of the initial rate.
        Cosine = "cosine",
        /// Halved after ten epochs without a smaller validation loss.
        Plateau = "plateau",
    }
}

params! {
    /// A network and its training.
    pub struct NetworkKeys;
    /// Number of units in each hidden layer; at most three layers.
    hidden: Option<Vec<usize>>, unit "1",
        absent "`[8]`; for `tlnn` and `etlnn`, `[11]` as in van der Meer 2025; for `m3tf`, no hidden layers; with \
                `warm_start`, the layers of the earlier network", rule Rule::Between(1.0, 1000.0);
    /// Activation function of the hidden units.
    activation: ActivationFunction, unit "", default ActivationFunction::Swish;
    /// Entries of `features` that are inputs of the network. A name selects one entry; a prefix such as `TL_A_flux_a`
    /// selects all entries whose names begin with `TL_A_flux_a_`.
    inputs: Option<Vec<String>>, unit "", absent "all features";
    /// Number of training epochs with Adam.
    epochs: usize, unit "1", default 200usize, rule Rule::Between(0.0, 100_000.0);
    /// Number of L-BFGS iterations after training with Adam. Each iteration uses all samples.
    lbfgs_epochs: usize, unit "1", default 0usize, rule Rule::Between(0.0, 10_000.0);
    /// Number of samples in each step of Adam.
    batch: usize, unit "samples", default 2048usize, rule Rule::Between(1.0, 1e7);
    /// Learning rate of Adam.
    learning_rate: f64, unit "1", default 0.001, rule Rule::Positive;
    /// Learning-rate schedule. With `cosine`, the rate falls to 1 % of `learning_rate`. With `plateau`, the rate is
    /// halved after ten epochs without a smaller validation loss.
    schedule: LearningSchedule, unit "", default LearningSchedule::Constant;
    /// Loss function: mean squared residual, mean absolute residual, or Huber loss.
    training_loss: TrainingLoss, unit "", default TrainingLoss::Squared;
    /// Residual at which the Huber loss changes from quadratic to linear, divided by the scale of the target (the term
    /// `target_scale` in the table of the fit).
    huber_threshold: f64, unit "1", default 1.0, rule Rule::Positive;
    /// Weight decay, as in AdamW: each step of Adam multiplies the weights by (1 - `weight_decay` × learning rate).
    weight_decay: f64, unit "1", default 0.0, rule Rule::NotNegative;
    /// Fraction of the hidden units that each training step omits at random.
    dropout: f64, unit "1", default 0.0, rule Rule::Between(0.0, 0.9);
    /// Strength of the sparse group lasso, a penalty that reduces the weights of irrelevant inputs in the first layer.
    group_lasso: f64, unit "1", default 0.0, rule Rule::NotNegative;
    /// Fraction of `group_lasso` that penalises the weights of each input as a group. The remaining fraction penalises
    /// each weight separately.
    group_share: f64, unit "1", default 1.0, rule Rule::Between(0.0, 1.0);
    /// Lines or flights that are used for validation instead of training. A line is given as `1003.08`, or with its
    /// flight as `1003/1003.08`. The result has the weights of the epoch with the smallest validation loss.
    validation: Vec<String>, unit "", default Vec::<String>::new();
    /// Training stops after this number of consecutive epochs without a smaller validation loss.
    patience: Option<usize>, unit "1", absent "training runs for all epochs", rule Rule::Positive;
    /// Number of networks in the ensemble. The networks start from different weights, and their predictions are
    /// averaged. The spread of the predictions gives `mag_aircraft_sigma` of `compensate`.
    members: usize, unit "1", default 1usize, rule Rule::Between(1.0, 100.0);
    /// Seed for the initial weights, the order of the batches, and dropout.
    seed: usize, unit "", default 0usize;
}

impl NetworkKeys {
    /// Faults of incompatible keys.
    pub fn faults(&self) -> Vec<Fault> {
        let mut faults = vec![];
        let mut wrong = |is: bool, what: &str, key: &'static str| {
            if is {
                faults.push(Fault::new(what).of_param(key));
            }
        };
        wrong(
            self.hidden.as_ref().is_some_and(|h| h.len() > 3),
            "a network has at most three hidden layers; shorten `hidden`",
            "hidden",
        );
        wrong(
            self.epochs + self.lbfgs_epochs == 0,
            "nothing is trained; set `epochs` or `lbfgs_epochs` above 0",
            "epochs",
        );
        let unvalidated = self.validation.is_empty();
        wrong(
            unvalidated && self.patience.is_some(),
            "`patience` requires validation data; name lines or flights in `validation`",
            "patience",
        );
        wrong(
            unvalidated && self.schedule == LearningSchedule::Plateau,
            "`schedule = \"plateau\"` requires validation data; name lines or flights in `validation`",
            "schedule",
        );
        wrong(
            self.lbfgs_epochs > 0 && self.dropout > 0.0,
            "`dropout` cannot be combined with `lbfgs_epochs`, because dropout changes the loss at each step",
            "dropout",
        );
        faults
    }

    /// Reason why a key has no effect.
    pub fn unused_key(&self, key: &str) -> Option<Fault> {
        let needs = |other: &str| Some(Fault::new(format!("`{key}` has no effect without `{other}`")));
        match key {
            "huber_threshold" if self.training_loss != TrainingLoss::Huber => needs("training_loss = \"huber\""),
            "group_share" if self.group_lasso == 0.0 => needs("group_lasso"),
            _ => None,
        }
    }

    /// Cost of a sample: the number of units times the number of epochs times the number of members.
    pub fn effort(&self) -> f64 {
        let units = self.hidden.as_ref().map_or(8, |layers| layers.iter().sum::<usize>());
        ((self.epochs + self.lbfgs_epochs) * self.members * (units + 1)) as f64
    }

    /// Training parameters, with the seed of a member.
    pub fn training(&self, seed: u64) -> NetworkTraining {
        let lasso = SparseGroupLasso { strength: self.group_lasso, alpha: self.group_share };
        NetworkTraining {
            optimiser: NetworkOptimiser { lbfgs_epochs: self.lbfgs_epochs, ..NetworkOptimiser::default() },
            epochs: self.epochs,
            batch: self.batch,
            learning_rate: self.learning_rate,
            schedule: match self.schedule {
                LearningSchedule::Constant => network::LearningRateSchedule::Constant,
                LearningSchedule::Cosine => network::LearningRateSchedule::Cosine { last: 0.01 },
                LearningSchedule::Plateau => network::LearningRateSchedule::Plateau { patience: 10, factor: 0.5 },
            },
            loss: match self.training_loss {
                TrainingLoss::Squared => network::NetworkLoss::Squared,
                TrainingLoss::Absolute => network::NetworkLoss::Absolute,
                TrainingLoss::Huber => network::NetworkLoss::Huber { delta: self.huber_threshold },
            },
            weight_decay: self.weight_decay,
            dropout: self.dropout,
            sparse_group_lasso: (self.group_lasso > 0.0).then_some(lasso),
            patience: self.patience,
            seed,
            ..NetworkTraining::default()
        }
    }
}
