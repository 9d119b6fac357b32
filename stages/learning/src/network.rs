//! Small dense networks beside linear terms: the models m1 to m2d of thesis 000, chapter 4, and the networks of thesis 004.
//!
//! A [`Shape`] says what is computed from one vector of parameters; [`train`] finds the parameters. Inputs, linear terms and
//! target are scaled by the caller, inputs by [`Inputs`](crate::inputs::Inputs).
//!
//! ```
//! use learning::network::{Activation, Form, Samples, Shape, State, Training, train};
//! use std::ops::ControlFlow;
//!
//! let x: Vec<f64> = (0..200).map(|i| f64::from(i) / 100.0 - 1.0).collect();
//! let y: Vec<f64> = x.iter().map(|x| x * x).collect();
//! let shape = Shape { inputs: 1, linear: 0, hidden: vec![4], activation: Activation::Swish, form: Form::Plain };
//! let training = Training { epochs: 300, batch: 50, learning_rate: 0.03, ..Training::default() };
//! let samples = Samples { x: &x, a: &[], y: &y };
//! let start = State::new(&shape, shape.initial(1, &[]));
//! let trained = train(&shape, start, &training, &samples, None, &mut |_, _| ControlFlow::Continue(()))?;
//! let at_half = shape.predict(&trained.parameters, &[0.5], &[])[0];
//! assert!((at_half - 0.25).abs() < 0.05);
//! # Ok::<(), learning::network::TrainingError>(())
//! ```

mod activation;
mod convolution;
mod ensemble;
mod kernels;
mod lbfgs;
mod loss;
mod objective;
mod onnx;
mod passes;
mod recurrent;
mod shape;
mod state;
mod training;
mod windowed;

pub use activation::Activation;
pub use ensemble::Ensemble;
pub use lbfgs::Lbfgs;
pub use loss::Loss;
pub use onnx::{OnnxError, Scales};
pub use shape::{Form, Shape};
pub use state::{State, StateError};
pub use training::{
    Epoch, Optimiser, Samples, Schedule, SparseGroupLasso, Trained, Training, TrainingError, train, train_windowed,
};
pub use windowed::{Memory, Runs, Windowed};

#[cfg(test)]
mod onnx_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod windowed_tests;
