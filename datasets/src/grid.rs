//! Conversion of the numbers of a file to a map on a grid.

mod axis;
mod axis_unit;
mod draft;
mod markers;
mod nodes;
mod plausible;

pub(crate) use axis::FileAxis;
pub use axis_unit::coordinate_factor;
pub(crate) use axis_unit::{AxisUnit, CrsSource, split_unit};
pub(crate) use draft::{FileCrs, MapDraft, PLAIN};
pub(crate) use markers::{is_dummy, is_marker, without_markers};
pub(crate) use nodes::from_nodes;
pub(crate) use plausible::{ValueUnit, accepted, check as check_values};

#[cfg(test)]
mod map_tests;
#[cfg(test)]
mod own_tests;
#[cfg(test)]
mod tests;
