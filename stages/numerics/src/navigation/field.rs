//! The field that a filter predicts at a position: the anomaly map, and the core field where the measurement holds it.

use std::sync::Arc;

use crate::earth::core_field::{CoreField, LinearisedCoreField};
use crate::earth::field_value::FieldValue;
use crate::maps::map_stack::FieldMap;
use crate::navigation::ins_series::InsSeries;

/// The map and the core field of one date. The core field is linearised about a point near the last position asked for,
/// so a copy a thread is needed, and its answers do not depend on the order of the positions beyond 1e-3 nT.
#[derive(Clone, Debug)]
pub struct PredictedField<'a> {
    map: &'a FieldMap,
    core: Option<LinearisedCoreField>,
}

impl<'a> PredictedField<'a> {
    /// The field of a map, and of a core field where there is one.
    pub fn new(map: &'a FieldMap, core: Option<&Arc<CoreField>>) -> Self {
        Self { map, core: core.map(|core| LinearisedCoreField::new(core.clone())) }
    }

    /// The field in nT and its gradient (nT/rad, nT/rad, nT/m) at a geodetic position in degrees and metres above the
    /// ellipsoid; `None` off the map and in unknown cells.
    pub fn at(&mut self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> Option<FieldValue> {
        let anomaly = self.map.at(lat_deg, lon_deg, alt_m)?;
        Some(match &mut self.core {
            Some(core) => anomaly + core.magnitude_and_gradient(lat_deg, lon_deg, alt_m),
            None => anomaly,
        })
    }

    /// [`PredictedField::at`] at an error in latitude and longitude (rad) and height (m) from the INS of a row.
    pub fn at_error(&mut self, ins: &InsSeries<'_>, row: usize, error: [f64; 3]) -> Option<FieldValue> {
        let lat_deg = ins.lat_deg[row] + error[0].to_degrees();
        let lon_deg = ins.lon_deg[row] + error[1].to_degrees();
        self.at(lat_deg, lon_deg, ins.alt_m[row] + error[2])
    }

    /// The mean of measurement minus prediction at the INS position over the first `window_s` seconds, in nT, and the
    /// number of samples it is the mean of; no samples for a window of 0.
    pub fn offset(&mut self, ins: &InsSeries<'_>, measurement_nt: &[f64], window_s: f64) -> (f64, usize) {
        if window_s <= 0.0 {
            return (0.0, 0);
        }
        let (mut sum_nt, mut samples) = (0.0, 0_usize);
        for (row, measured_nt) in measurement_nt.iter().enumerate() {
            if ins.tt_s[row] - ins.tt_s[0] > window_s {
                break;
            }
            if let Some(field) = self.at_error(ins, row, [0.0; 3])
                && measured_nt.is_finite()
            {
                sum_nt += measured_nt - field.value_nt;
                samples += 1;
            }
        }
        if samples == 0 { (0.0, 0) } else { (sum_nt / samples as f64, samples) }
    }
}
