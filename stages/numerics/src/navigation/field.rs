//! Predicted field at a position: the anomaly map, plus the core field if the measurement contains it.

use std::sync::Arc;

use crate::earth::core_field::{CoreField, LinearisedCoreField};
use crate::earth::field_value::FieldValue;
use crate::maps::map_stack::FieldMap;
use crate::navigation::ins_series::InsSeries;

/// Interval of divided differences, in standard deviations; the square of the interval, 3, is the kurtosis of a normal
/// distribution.
const INTERVAL: f64 = 1.732_050_807_568_877_2;

/// Map of a line, or a map that a filter shares.
#[derive(Clone, Debug)]
enum MapSource<'a> {
    Borrowed(&'a FieldMap),
    Shared(Arc<FieldMap>),
}

impl MapSource<'_> {
    #[inline(always)]
    fn map(&self) -> &FieldMap {
        match self {
            Self::Borrowed(map) => map,
            Self::Shared(map) => map,
        }
    }
}

/// Map, and core field at one date. The core field is linearised about a point near the last evaluated position, so
/// each thread needs a copy. The order in which positions are evaluated changes results by less than 1e-3 nT.
#[derive(Clone, Debug)]
pub struct PredictedField<'a> {
    map: MapSource<'a>,
    core: Option<LinearisedCoreField>,
    second_order: bool,
}

impl<'a> PredictedField<'a> {
    /// Field of a map, and optionally of a core field.
    pub fn new(map: &'a FieldMap, core: Option<&Arc<CoreField>>) -> Self {
        Self::of(MapSource::Borrowed(map), core)
    }

    fn of(map: MapSource<'a>, core: Option<&Arc<CoreField>>) -> Self {
        Self { map, core: core.map(|core| LinearisedCoreField::new(core.clone())), second_order: false }
    }

    /// Field of a shared map, for a filter that outlives the caller's borrow.
    pub(crate) fn shared(map: Arc<FieldMap>, core: Option<&Arc<CoreField>>) -> PredictedField<'static> {
        PredictedField::of(MapSource::Shared(map), core)
    }

    /// Expansion point of the core field; `None` without a core field.
    pub(crate) fn expansion_point(&self) -> Option<[f64; 3]> {
        self.core.as_ref().and_then(LinearisedCoreField::expansion_point)
    }

    /// Expands the core field about a point, or discards the expansion.
    pub(crate) fn expand_at(&mut self, point: Option<[f64; 3]>) {
        if let Some(core) = &mut self.core {
            core.expand_at(point);
        }
    }

    /// Enables or disables [`PredictedField::curvature_nt2`].
    #[must_use]
    pub fn with_second_order(self, second_order: bool) -> Self {
        Self { second_order, ..self }
    }

    /// Field, in nT, and its gradient (nT/rad, nT/rad, nT/m) at a geodetic position in degrees and metres above the
    /// ellipsoid; `None` off the map and in unknown cells.
    pub fn at(&mut self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> Option<FieldValue> {
        let anomaly = self.map.map().at(lat_deg, lon_deg, alt_m)?;
        Some(match &mut self.core {
            Some(core) => anomaly + core.magnitude_and_gradient(lat_deg, lon_deg, alt_m),
            None => anomaly,
        })
    }

    /// Same as [`PredictedField::at`], at the INS position of a row plus an error in latitude and longitude (rad) and
    /// height (m).
    pub fn at_error(&mut self, ins: &InsSeries<'_>, row: usize, error: [f64; 3]) -> Option<FieldValue> {
        let lat_deg = ins.lat_deg[row] + error[0].to_degrees();
        let lon_deg = ins.lon_deg[row] + error[1].to_degrees();
        self.at(lat_deg, lon_deg, ins.alt_m[row] + error[2])
    }

    /// Variance, in nT², of the nonlinear part of the field within the uncertainty of a position. 0 without
    /// [`PredictedField::with_second_order`].
    #[inline]
    pub fn curvature_nt2(
        &mut self,
        ins: &InsSeries<'_>,
        row: usize,
        [lat, lon, alt]: [f64; 3],
        centre_nt: f64,
        covariance: [f64; 3],
    ) -> f64 {
        if !self.second_order {
            return 0.0;
        }
        remainder_nt2(covariance, centre_nt, |north, east| self.at_error(ins, row, [lat + north, lon + east, alt]))
    }

    /// Mean of measurement minus prediction at the INS position over the first `window_s` seconds, in nT, and the
    /// number of averaged samples; no samples for a window of 0.
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

/// Variance, in nT², of the nonlinear part of a field within the uncertainty of a position. The result uses
/// second-order divided differences along the columns of the Cholesky factor of the covariance [Nørgaard, Poulsen and
/// Ravn 2000, DD2]. `covariance` has the variance of latitude, the covariance with longitude, and the variance of
/// longitude, in rad²; `field_at` takes an error of latitude and longitude. A column with a point off the map
/// contributes 0.
#[inline]
pub(crate) fn remainder_nt2(
    [lat, both, lon]: [f64; 3],
    centre_nt: f64,
    mut field_at: impl FnMut(f64, f64) -> Option<FieldValue>,
) -> f64 {
    let first = lat.max(0.0).sqrt();
    let both = if first > 0.0 { both / first } else { 0.0 };
    let second = (lon - both * both).max(0.0).sqrt();
    let mut variance_nt2 = 0.0;
    for [north, east] in [[first, both], [0.0, second]] {
        let mut at = |by: f64| field_at(by * north, by * east);
        if let (Some(ahead), Some(behind)) = (at(INTERVAL), at(-INTERVAL)) {
            let second_nt = ahead.value_nt + behind.value_nt - 2.0 * centre_nt;
            variance_nt2 += second_nt * second_nt * (INTERVAL * INTERVAL - 1.0) / (4.0 * INTERVAL.powi(4));
        }
    }
    variance_nt2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn law_the_nonlinear_variance_of_a_quadratic_field_is_exact() {
        // Var[a x²/2 + b y²/2] = a² p² / 2 + b² q² / 2 for independent normal x and y with variances p and q.
        let (a, b, p, q) = (3.0, -5.0, 0.04, 0.09);
        let field = |x: f64, y: f64| {
            let value_nt = 7.0 + 2.0 * x - y + 0.5 * (a * x * x + b * y * y);
            Some(FieldValue { value_nt, d_lat_nt_per_rad: 2.0, d_lon_nt_per_rad: -1.0, d_alt_nt_per_m: 0.0 })
        };
        let expected = 0.5 * (a * a * p * p + b * b * q * q);
        assert!((remainder_nt2([p, 0.0, q], 7.0, field) - expected).abs() < 1e-12);
        assert_eq!(remainder_nt2([0.0, 0.0, 0.0], 7.0, field), 0.0);
        assert_eq!(remainder_nt2([p, 0.0, q], 7.0, |_, _| None), 0.0);
    }
}
