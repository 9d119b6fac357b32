//! Common parts of the models that are networks: their keys, the linear model and the training.

mod core;
mod inputs;
mod keys;
mod linear_part;
mod model;
mod prepared;
mod training;
mod warm_start;
mod window;

pub use inputs::{NetworkInputs, SharedInputs, scaling};
pub use keys::Network;
pub use linear_part::LinearPart;
pub use model::NetworkModel;
pub use prepared::Task;
pub use training::learn_together;
pub use window::{Window, WindowKeys};
