//! Models of an aircraft's field that are trained on samples, and which of their inputs matter.
//!
//! Slices in, vectors out, as in [`numerics`], which this crate uses. Sums over samples are made block by block in one
//! fixed order. The same seed therefore gives the same bits on any number of threads.

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
