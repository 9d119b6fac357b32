//! Common parts of the models that are networks: keys, linear model, training.

mod core;
mod inputs;
mod keys;
mod linear_part;
mod model;
mod prepared;
mod training;
mod vector_keys;
mod warm_start;
mod window;

pub use inputs::{NetworkInputs, SharedInputs, scaling};
pub use keys::NetworkKeys;
pub use linear_part::LinearPart;
pub use model::NetworkModel;
pub use prepared::TrainingTask;
pub use training::learn_together;
pub use vector_keys::{CurriculumKeys, VectorModelKeys};
pub use window::{WindowKeys, WindowLayers};
