//! Numerics of aeromagnetic compensation and magnetic navigation: slices and matrices in, vectors out.
//!
//! Nothing here depends on tables, plans or files. A routine's documentation gives the shape, unit and
//! frame of what it takes and returns, its errors, and where its formula is printed.

pub mod angle;
pub mod compensation;
pub mod earth;
pub mod maps;
pub mod navigation;
pub mod random;
pub mod regression;
pub mod signal;

#[cfg(test)]
mod reference_csv;
