//! Small dense networks with linear terms: the models m1 to m2d of Gnadt 2022, chapter 4, and the networks of van der
//! Meer 2025.
//!
//! A [`NetworkShape`] defines a network as a function of one vector of parameters; [`train`] finds the parameters. The
//! caller scales the linear terms, the target and, with [`InputScaling`](crate::inputs::InputScaling), the inputs.
//!
//! ```
//! use learning::network::{
//!     ActivationFunction, NetworkForm, NetworkSamples, NetworkShape, NetworkTraining, TrainingState, train,
//! };
//! use std::ops::ControlFlow;
//!
//! let x: Vec<f64> = (0..200).map(|i| f64::from(i) / 100.0 - 1.0).collect();
//! let y: Vec<f64> = x.iter().map(|x| x * x).collect();
//! let (activation, form) = (ActivationFunction::Swish, NetworkForm::Plain);
//! let shape = NetworkShape { inputs: 1, linear: 0, hidden: vec![4], activation, form };
//! let training = NetworkTraining { epochs: 300, batch: 50, learning_rate: 0.03, ..NetworkTraining::default() };
//! let samples = NetworkSamples { x: &x, a: &[], y: &y };
//! let start = TrainingState::new(&shape, shape.initial(1, &[]));
//! let trained = train(&shape, start, &training, &samples, None, &mut |_, _| ControlFlow::Continue(()))?;
//! let at_half = shape.predict(&trained.parameters, &[0.5], &[])[0];
//! assert!((at_half - 0.25).abs() < 0.05);
//! # Ok::<(), learning::network::TrainingError>(())
//! ```

//! # Implementation
//!
//! Most time is spent in products of 256 rows with the weights of a layer, which are vectorised for AVX2 if available.
//! For 77 inputs and 8 units, forward and backward passes of 400,000 rows take 19 ms on one core. faer's matrix product
//! took 12 ms on the same machine, with vectors twice as wide; the difference is a tenth of the time of an epoch. The
//! kernels sum in one order and by fused multiply-add on every machine, so the bits of a model do not depend on the
//! training processor. For an epoch of `m1` on two cores, PyTorch takes 3.9 times as long as magline, and in single
//! precision 3.5 times. On one core, candle takes 5 times as long as magline, and in single precision 1.2 times
//! (`stages/learning/benches`). Models are in double precision, in which each of these frameworks takes at least twice
//! as long as magline.
//!
//! Batches are cut into blocks of 256 rows, whose gradients are added in order, on any number of threads.
//!
//! # Use of the parameters without magline
//!
//! In numpy, the prediction of a network with `p` inputs and one hidden layer of `h` units with swish is `y`, computed
//! from the parameters `w` in the order of [`NetworkShape::names`]:
//!
//! ```text
//! z = (x - mean) / scale                               # x: rows of columns
//! w1, b1 = w[: h * p].reshape(h, p), w[h * p : h * p + h]
//! w2, b2 = w[h * p + h : h * p + 2 * h], w[h * p + 2 * h]
//! s = z @ w1.T + b1
//! y = (s / (1 + exp(-s))) @ w2 + b2                    # m1; for m2b and m2c: + a @ w[h * p + 2 * h + 1 :]
//! ```

mod activation;
mod attention;
mod convolution;
mod curriculum;
mod error;
mod gathering;
mod kernels;
mod lbfgs;
mod loss;
mod objective;
mod onnx;
mod passes;
mod recurrent;
mod shape;
mod state;
mod terms;
mod together;
mod training;
mod vector;
mod windowed;

pub use activation::ActivationFunction;
pub use curriculum::CURRICULUM_EPOCHS;
pub use error::TrainingError;
pub use lbfgs::LbfgsState;
pub use loss::NetworkLoss;
pub use onnx::{NetworkScales, OnnxError};
pub use shape::{NetworkForm, NetworkShape};
pub use state::{TrainingState, TrainingStateError};
pub use terms::TermScaling;
pub use together::{EpochCallback, TrainingJob, train, train_together};
pub use training::{
    LearningRateSchedule, NetworkOptimiser, NetworkSamples, NetworkTraining, SparseGroupLasso, TrainingEpoch,
    TrainingResult,
};
pub use vector::{FieldCoupling, TERMS_WITHOUT_EDDY, VECTOR_TERMS, VectorFrame};
pub use windowed::{MemoryLayers, SampleRuns, WindowedNetworkShape};

#[cfg(test)]
mod onnx_tests;
#[cfg(test)]
mod shape_tests;
#[cfg(test)]
mod state_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod together_tests;
#[cfg(test)]
mod vector_tests;
#[cfg(test)]
mod windowed_tests;
