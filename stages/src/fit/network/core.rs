//! Network of a fit, of single samples or over a window.

use learning::network::{
    EpochCallback, NetworkShape, NetworkTraining, SampleRuns, TermScaling, TrainingError, TrainingJob, TrainingState,
    WindowedNetworkShape,
};

/// Scaled rows of some lines.
pub struct ScaledRows<'a> {
    /// Inputs, row-major.
    pub x: &'a [f64],
    /// Linear terms, row-major.
    pub a: Vec<f64>,
    /// Target of each row.
    pub y: Vec<f64>,
    /// Lengths of runs of consecutive samples.
    pub runs: Vec<usize>,
}

impl ScaledRows<'_> {
    fn samples(&self) -> learning::network::NetworkSamples<'_> {
        learning::network::NetworkSamples { x: self.x, a: &self.a, y: &self.y }
    }

    fn runs(&self) -> SampleRuns<'_> {
        SampleRuns { samples: self.samples(), lengths: &self.runs }
    }
}

/// Network to train.
pub enum NetworkCore {
    /// Network of single samples.
    Dense(NetworkShape),
    /// Network over a window of samples.
    Windowed(WindowedNetworkShape),
}

impl NetworkCore {
    /// Random initial parameters.
    pub fn initial(&self, seed: u64, linear: &[f64]) -> Vec<f64> {
        match self {
            NetworkCore::Dense(shape) => shape.initial(seed, linear),
            NetworkCore::Windowed(windowed) => windowed.initial(seed, linear),
        }
    }

    /// Initial state of a training that starts from these parameters.
    pub fn start(&self, parameters: Vec<f64>) -> TrainingState {
        match self {
            NetworkCore::Dense(shape) => TrainingState::new(shape, parameters),
            NetworkCore::Windowed(windowed) => windowed.start(parameters),
        }
    }

    /// Prediction for some rows, in the scale of the target.
    pub fn predict(&self, parameters: &[f64], rows: &ScaledRows<'_>) -> Vec<f64> {
        match self {
            NetworkCore::Dense(shape) => shape.predict(parameters, rows.x, &rows.a),
            NetworkCore::Windowed(windowed) => windowed.predict(parameters, rows.x, &rows.a, &rows.runs),
        }
    }

    /// Parameters for a network with scaled terms, converted from those for unscaled terms.
    pub fn scaled(&self, terms: &TermScaling, parameters: &[f64]) -> Vec<f64> {
        let (before, head) = parameters.split_at(self.head_start());
        [before, &terms.scaled(self.head(), head)].concat()
    }

    /// Parameters for a network with unscaled terms, converted from those for scaled terms.
    pub fn original(&self, terms: &TermScaling, parameters: &[f64]) -> Vec<f64> {
        let (before, head) = parameters.split_at(self.head_start());
        [before, &terms.original(self.head(), head)].concat()
    }

    /// Dense layers, with the linear terms.
    pub fn head(&self) -> &NetworkShape {
        match self {
            NetworkCore::Dense(shape) => shape,
            NetworkCore::Windowed(windowed) => &windowed.head,
        }
    }

    /// Number of parameters that precede the parameters of the dense layers.
    fn head_start(&self) -> usize {
        match self {
            NetworkCore::Dense(_) => 0,
            NetworkCore::Windowed(windowed) => windowed.parameters() - windowed.head.parameters(),
        }
    }

    /// Training job of the network.
    ///
    /// # Errors
    /// Fails in the cases of [`TrainingJob::new`] and [`TrainingJob::windowed`].
    pub fn job<'a>(
        &'a self,
        start: TrainingState,
        training: &'a NetworkTraining,
        rows: &'a ScaledRows<'_>,
        validation: Option<&'a ScaledRows<'_>>,
        each: Box<EpochCallback<'a>>,
    ) -> Result<TrainingJob<'a>, TrainingError> {
        match self {
            NetworkCore::Dense(shape) => {
                TrainingJob::new(shape, start, training, rows.samples(), validation.map(ScaledRows::samples), each)
            }
            NetworkCore::Windowed(windowed) => {
                let validation = validation.map(ScaledRows::runs);
                TrainingJob::windowed(windowed, start, training, &rows.runs(), validation.as_ref(), each)
            }
        }
    }
}
