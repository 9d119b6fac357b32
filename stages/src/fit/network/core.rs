//! Network of a fit, of single samples or over a window.

use learning::network::{Each, Job, Runs, Shape, State, TermScaling, Training, TrainingError, Windowed};

/// Scaled rows of some lines.
pub struct Scaled<'a> {
    /// Inputs, row-major.
    pub x: &'a [f64],
    /// Linear terms, row-major.
    pub a: Vec<f64>,
    /// Target of each row.
    pub y: Vec<f64>,
    /// Lengths of runs of consecutive samples.
    pub runs: Vec<usize>,
}

impl Scaled<'_> {
    fn samples(&self) -> learning::network::Samples<'_> {
        learning::network::Samples { x: self.x, a: &self.a, y: &self.y }
    }

    fn runs(&self) -> Runs<'_> {
        Runs { samples: self.samples(), lengths: &self.runs }
    }
}

/// Network to train.
pub enum Core {
    /// Network of single samples.
    Dense(Shape),
    /// Network over a window of samples.
    Windowed(Windowed),
}

impl Core {
    /// Random initial parameters.
    pub fn initial(&self, seed: u64, linear: &[f64]) -> Vec<f64> {
        match self {
            Core::Dense(shape) => shape.initial(seed, linear),
            Core::Windowed(windowed) => windowed.initial(seed, linear),
        }
    }

    /// State of a training that starts from these parameters.
    pub fn start(&self, parameters: Vec<f64>) -> State {
        match self {
            Core::Dense(shape) => State::new(shape, parameters),
            Core::Windowed(windowed) => windowed.start(parameters),
        }
    }

    /// Prediction for some rows, in the scale of the target.
    pub fn predict(&self, parameters: &[f64], rows: &Scaled<'_>) -> Vec<f64> {
        match self {
            Core::Dense(shape) => shape.predict(parameters, rows.x, &rows.a),
            Core::Windowed(windowed) => windowed.predict(parameters, rows.x, &rows.a, &rows.runs),
        }
    }

    /// Parameters of a network of scaled terms. Networks over a window have none.
    pub fn scaled(&self, terms: &TermScaling, parameters: &[f64]) -> Vec<f64> {
        match self {
            Core::Dense(shape) => terms.scaled(shape, parameters),
            Core::Windowed(_) => parameters.to_vec(),
        }
    }

    /// Parameters of a network of unscaled terms.
    pub fn original(&self, terms: &TermScaling, parameters: &[f64]) -> Vec<f64> {
        match self {
            Core::Dense(shape) => terms.original(shape, parameters),
            Core::Windowed(_) => parameters.to_vec(),
        }
    }

    /// Training job of the network.
    ///
    /// # Errors
    /// The same as [`Job::new`] and [`Job::windowed`].
    pub fn job<'a>(
        &'a self,
        start: State,
        training: &'a Training,
        rows: &'a Scaled<'_>,
        validation: Option<&'a Scaled<'_>>,
        each: Box<Each<'a>>,
    ) -> Result<Job<'a>, TrainingError> {
        match self {
            Core::Dense(shape) => {
                Job::new(shape, start, training, rows.samples(), validation.map(Scaled::samples), each)
            }
            Core::Windowed(windowed) => {
                let validation = validation.map(Scaled::runs);
                Job::windowed(windowed, start, training, &rows.runs(), validation.as_ref(), each)
            }
        }
    }
}
