//! Coastlines of a region.

use schemas::Fault;
use serde_json::{Value, json};

use super::{StoreView, ViewFault};
use crate::coast::{GeographicRegion, flat_coastlines};

impl StoreView {
    /// Coastlines in a region as JSON: lists of alternating longitudes and latitudes, in degrees.
    ///
    /// # Errors
    /// Fails for a region without extent, or wider than two full turns (720 degrees).
    pub fn coast(&self, region: GeographicRegion) -> Result<Value, ViewFault> {
        let GeographicRegion { west, east, south, north } = region;
        let is_region = west < east && east - west <= 720.0 && west.abs() <= 720.0 && south < north;
        if !is_region {
            let fault =
                Fault::new(format!("the region from {west} to {east} and from {south} to {north} deg is invalid"));
            return Err(ViewFault::Wrong(fault.help("give `west` below `east` and `south` below `north`, in degrees")));
        }
        Ok(json!({ "lines": flat_coastlines(region) }))
    }
}
