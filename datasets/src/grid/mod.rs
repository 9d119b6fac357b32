//! How the numbers of a file become a map on a grid.

mod axis;
mod draft;
mod nodes;

pub(crate) use axis::FileAxis;
pub(crate) use draft::{Draft, System};
pub(crate) use nodes::from_nodes;

#[cfg(test)]
mod map_tests;
#[cfg(test)]
mod own_tests;
#[cfg(test)]
mod tests;
