//! The keys of a network and of its training.

use learning::network::{self, Activation, Optimiser, SparseGroupLasso, Training};
use schemas::{Fault, Rule, choice, params};

choice! {
    /// Loss function of the residual divided by the target's scale.
    pub enum TrainingLoss {
        /// The mean of squares.
        Squared = "squared",
        /// The mean of absolute values.
        Absolute = "absolute",
        /// Huber's: squares up to `huber_threshold`, straight lines beyond.
        Huber = "huber",
    }
}

choice! {
    /// Learning-rate schedule.
    pub enum LearningSchedule {
        /// It stays.
        Constant = "constant",
        /// It falls to a hundredth along half a cosine.
        Cosine = "cosine",
        /// It is halved after ten epochs without a smaller validation loss.
        Plateau = "plateau",
    }
}

params! {
    /// A network and how it is trained.
    pub struct Network;
    /// Units of each hidden layer, from none to three layers.
    hidden: Option<Vec<usize>>, unit "1", absent "`[8]`; `[11]` for `tlnn` and `etlnn`, as in thesis 004; with `warm_start` those of its network", rule Rule::Between(1.0, 1000.0);
    /// Activation function of hidden units.
    activation: Activation, unit "", default Activation::Swish;
    /// The inputs of the network: entries of the features, by their names or what several names have before a `_`.
    inputs: Option<Vec<String>>, unit "", absent "all features";
    /// Number of passes of Adam through the samples.
    epochs: usize, unit "1", default 200usize, rule Rule::Between(0.0, 100_000.0);
    /// Iterations of L-BFGS with all samples after that.
    lbfgs_epochs: usize, unit "1", default 0usize, rule Rule::Between(0.0, 10_000.0);
    /// Samples that a step of Adam looks at.
    batch: usize, unit "samples", default 2048usize, rule Rule::Between(1.0, 1e7);
    /// The size of a step of Adam.
    learning_rate: f64, unit "1", default 0.001, rule Rule::Positive;
    /// Learning-rate schedule.
    schedule: LearningSchedule, unit "", default LearningSchedule::Constant;
    /// Loss function that training minimises.
    training_loss: TrainingLoss, unit "", default TrainingLoss::Squared;
    /// Where Huber's loss turns to straight lines, in scales of the target.
    huber_threshold: f64, unit "1", default 1.0, rule Rule::Positive;
    /// The part of each weight that a step of Adam takes off, times the learning rate (AdamW).
    weight_decay: f64, unit "1", default 0.0, rule Rule::NotNegative;
    /// The part of the hidden units that a step leaves out.
    dropout: f64, unit "1", default 0.0, rule Rule::Between(0.0, 0.9);
    /// The strength of the sparse group lasso on the weights of each input.
    group_lasso: f64, unit "1", default 0.0, rule Rule::NotNegative;
    /// The part of it that is on the group; the rest is on each weight.
    group_share: f64, unit "1", default 1.0, rule Rule::Between(0.0, 1.0);
    /// Lines (`1003.08` or `1003/1003.08`) or whole flights that are not trained on: the epoch with the smallest loss on
    /// them is taken.
    validation: Vec<String>, unit "", default Vec::<String>::new();
    /// Epochs without a smaller validation loss after which the training ends.
    patience: Option<usize>, unit "1", absent "all epochs are trained", rule Rule::Positive;
    /// Networks that are trained from different first weights and averaged; their spread is the sigma of the prediction.
    members: usize, unit "1", default 1usize, rule Rule::Between(1.0, 100.0);
    /// The seed of first weights, order of batches and dropout.
    seed: usize, unit "", default 0usize;
}

impl Network {
    /// Contradictions among the keys.
    pub fn faults(&self) -> Vec<Fault> {
        let mut faults = vec![];
        let mut wrong = |is: bool, what: &str, key: &'static str| {
            if is {
                faults.push(Fault::new(what).of_param(key));
            }
        };
        wrong(self.hidden.as_ref().is_some_and(|h| h.len() > 3), "a network has up to three hidden layers", "hidden");
        wrong(self.epochs + self.lbfgs_epochs == 0, "nothing is trained: give `epochs` or `lbfgs_epochs`", "epochs");
        let unvalidated = self.validation.is_empty();
        let needs = "it needs lines or flights to validate with: name them in `validation`";
        wrong(unvalidated && self.patience.is_some(), needs, "patience");
        wrong(unvalidated && self.schedule == LearningSchedule::Plateau, needs, "schedule");
        wrong(
            self.lbfgs_epochs > 0 && self.dropout > 0.0,
            "L-BFGS minimises one loss, which `dropout` changes",
            "dropout",
        );
        faults
    }

    /// Reason why a key has no effect.
    pub fn idle(&self, key: &str) -> Option<Fault> {
        let needs = |other: &str| Some(Fault::new(format!("`{key}` has no effect without `{other}`")));
        match key {
            "huber_threshold" if self.training_loss != TrainingLoss::Huber => needs("training_loss = \"huber\""),
            "group_share" if self.group_lasso == 0.0 => needs("group_lasso"),
            _ => None,
        }
    }

    /// How much work a sample is: a pass over it for each unit of each epoch of each member.
    pub fn effort(&self) -> f64 {
        let units = self.hidden.as_ref().map_or(8, |layers| layers.iter().sum::<usize>());
        ((self.epochs + self.lbfgs_epochs) * self.members * (units + 1)) as f64
    }

    /// Settings of the training, with the seed of a member.
    pub fn training(&self, seed: u64) -> Training {
        let lasso = SparseGroupLasso { strength: self.group_lasso, alpha: self.group_share };
        Training {
            optimiser: Optimiser { lbfgs_epochs: self.lbfgs_epochs, ..Optimiser::default() },
            epochs: self.epochs,
            batch: self.batch,
            learning_rate: self.learning_rate,
            schedule: match self.schedule {
                LearningSchedule::Constant => network::Schedule::Constant,
                LearningSchedule::Cosine => network::Schedule::Cosine { last: 0.01 },
                LearningSchedule::Plateau => network::Schedule::Plateau { patience: 10, factor: 0.5 },
            },
            loss: match self.training_loss {
                TrainingLoss::Squared => network::Loss::Squared,
                TrainingLoss::Absolute => network::Loss::Absolute,
                TrainingLoss::Huber => network::Loss::Huber { delta: self.huber_threshold },
            },
            weight_decay: self.weight_decay,
            dropout: self.dropout,
            sparse_group_lasso: (self.group_lasso > 0.0).then_some(lasso),
            patience: self.patience,
            seed,
            ..Training::default()
        }
    }
}
