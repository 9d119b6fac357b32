//! What the models that are networks have in common: their keys, the linear model beside the network, the training.

mod keys;
mod linear_part;
mod training;
mod warm_start;
mod window;

pub use keys::Network;
pub use linear_part::LinearPart;
pub use training::{Beside, NetworkInputs, learn, scaling};
pub use window::{Window, WindowKeys};
