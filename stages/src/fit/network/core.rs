//! The network of a fit, of each sample or over a window.

use learning::network::{Each, Job, Runs, Shape, State, TermScaling, Training, TrainingError, Windowed};

/// The rows of some lines, scaled.
pub struct Scaled<'a> {
    /// The inputs, row-major.
    pub x: &'a [f64],
    /// The linear terms, row-major.
    pub a: Vec<f64>,
    /// The target.
    pub y: Vec<f64>,
    /// Rows of each run of samples that follow each other.
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

/// The network that is trained.
pub enum Core {
    /// Network of single samples.
    Dense(Shape),
    /// Network of a window of samples.
    Windowed(Windowed),
}

impl Core {
    /// The parameters to begin with at random.
    pub fn initial(&self, seed: u64, linear: &[f64]) -> Vec<f64> {
        match self {
            Core::Dense(shape) => shape.initial(seed, linear),
            Core::Windowed(windowed) => windowed.initial(seed, linear),
        }
    }

    /// The state of a training that begins with these parameters.
    pub fn start(&self, parameters: Vec<f64>) -> State {
        match self {
            Core::Dense(shape) => State::new(shape, parameters),
            Core::Windowed(windowed) => windowed.start(parameters),
        }
    }

    /// Predictions for some rows, in the scale of the target.
    pub fn predict(&self, parameters: &[f64], rows: &Scaled<'_>) -> Vec<f64> {
        match self {
            Core::Dense(shape) => shape.predict(parameters, rows.x, &rows.a),
            Core::Windowed(windowed) => windowed.predict(parameters, rows.x, &rows.a, &rows.runs),
        }
    }

    /// The parameters of a network of scaled terms. Over a window there are none.
    pub fn scaled(&self, terms: &TermScaling, parameters: &[f64]) -> Vec<f64> {
        match self {
            Core::Dense(shape) => terms.scaled(shape, parameters),
            Core::Windowed(_) => parameters.to_vec(),
        }
    }

    /// Those of a network of the terms as they are.
    pub fn original(&self, terms: &TermScaling, parameters: &[f64]) -> Vec<f64> {
        match self {
            Core::Dense(shape) => terms.original(shape, parameters),
            Core::Windowed(_) => parameters.to_vec(),
        }
    }

    /// Its training.
    ///
    /// # Errors
    /// The same as for [`Job::new`] and [`Job::windowed`].
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
