//! Models of the aircraft field that are trained on samples, and the importance of their inputs.
//!
//! Functions take slices and return vectors, as in [`numerics`], which this crate uses. Sums over samples are computed
//! block by block in a fixed order. The same seed therefore gives bit-identical results on any number of threads.

pub mod importance;
pub mod inputs;
pub mod network;
pub mod random_features;
pub mod rows;
pub mod search;
pub mod trees;

mod draws;

#[cfg(test)]
mod reference_csv;
