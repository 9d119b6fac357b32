//! The list of all filters.

use super::{ekf::Ekf, filter::Filter, ins_only::InsOnly};

/// Every filter, in the order of the reference.
pub const FILTERS: &[&Filter] = &[&Ekf::FILTER, &InsOnly::FILTER];
