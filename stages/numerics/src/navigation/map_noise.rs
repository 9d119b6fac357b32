//! Errors of a map's nodes, converted to measurement noise along a line.
//!
//! The relevant error is the error of the map at the position of the aircraft, which is unknown. Between survey lines
//! the map error changes within some hundred metres, while the error of an INS is kilometres after an hour. The map
//! error is therefore evaluated at the position that an extended Kalman filter predicts for each sample. That filter
//! uses the scalar field, with the map error as part of its measurement noise.

use crate::maps::map_stack::FieldMap;
use crate::navigation::field::PredictedField;
use crate::navigation::gaussian::recursion::{self, FilterRecursion};
use crate::navigation::gaussian::{Sensitivity, StateEstimate};
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};

/// Standard deviation of the map error at each sample of a line, in nT, times `factor`. NaN where the map has a value
/// but the error is unknown; 0 off the map. `error_nt` holds the standard deviation of each node. The noise of the
/// line's own measurements is added in the filter.
///
/// # Errors
/// Returns the errors of [`NavigationLine::check`]. Also fails with [`NavigationError::Diverged`] if a state or
/// variance is not finite or a variance is negative.
pub fn along(line: &NavigationLine<'_>, error_nt: &FieldMap, factor: f64) -> Result<Vec<f64>, NavigationError> {
    line.check()?;
    let mut field = line.predicted();
    let (offset_nt, _) = field.offset(line.ins, line.measurement_nt, line.offset_window_s);
    let output = NavigationOutput::with_capacity(line.ins.len(), false, false);
    let sigma_nt = Vec::with_capacity(line.ins.len());
    let filter = MapNoiseEkf { line, error_nt, factor, field, offset_nt, sigma_nt, output };
    Ok(recursion::run(filter, line)?.sigma_nt)
}

struct MapNoiseEkf<'a> {
    line: &'a NavigationLine<'a>,
    error_nt: &'a FieldMap,
    factor: f64,
    field: PredictedField<'a>,
    offset_nt: f64,
    sigma_nt: Vec<f64>,
    output: NavigationOutput,
}

impl MapNoiseEkf<'_> {
    /// Standard deviation of the map error, in nT, at the INS position of a row plus an INS error.
    fn sigma_nt_at(&self, row: usize, [lat_rad, lon_rad, alt_m]: [f64; 3]) -> f64 {
        let ins = self.line.ins;
        let (lat_deg, lon_deg) = (ins.lat_deg[row] + lat_rad.to_degrees(), ins.lon_deg[row] + lon_rad.to_degrees());
        let error = self.error_nt.at(lat_deg, lon_deg, ins.alt_m[row] + alt_m);
        // A cubic surface may fall below 0 between nodes.
        error.map_or(f64::NAN, |error| self.factor * error.value_nt.max(0.0))
    }
}

impl FilterRecursion for MapNoiseEkf<'_> {
    fn output(&mut self) -> &mut NavigationOutput {
        &mut self.output
    }

    #[inline(always)]
    fn measure(&mut self, estimate: &mut StateEstimate, row: usize) -> Innovation {
        let [lat, lon, alt, temporal_nt] = estimate.measured();
        let Some(field) = self.field.at_error(self.line.ins, row, [lat, lon, alt]) else {
            self.sigma_nt.push(0.0);
            return Innovation::NONE;
        };
        let sigma_nt = self.sigma_nt_at(row, [lat, lon, alt]);
        self.sigma_nt.push(sigma_nt);
        let Some((value_nt, variance_nt2)) = self.line.measured(row, self.offset_nt).filter(|_| sigma_nt.is_finite())
        else {
            return Innovation::NONE;
        };
        let residual_nt = value_nt - (field.value_nt + temporal_nt);
        let covariance = estimate.horizontal();
        let variance_nt2 =
            variance_nt2 + self.field.curvature_nt2(self.line.ins, row, [lat, lon, alt], field.value_nt, covariance);
        let at = estimate.linearised(Sensitivity::from_field(&field));
        estimate.correct(&at, residual_nt, variance_nt2 + sigma_nt * sigma_nt);
        Innovation::NONE
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::maps::map_surface::{GeographicGrid, MapInterpolation, MapSurface};
    use crate::navigation::scenes::{AnalyticScene, LAT_DEG, LON_DEG, hills, m_per_deg, uneven};

    /// Map of errors as a function of metres east of the middle of the scene.
    fn errors(of_east: impl Fn(f64) -> f64) -> FieldMap {
        let (north, east) = m_per_deg();
        let axis = |middle: f64, m_per_deg: f64| -> Vec<f64> {
            (-70..=70).map(|k| middle + 100.0 * f64::from(k) / m_per_deg).collect()
        };
        let (lat, lon) = (axis(LAT_DEG, north), axis(LON_DEG, east));
        let nodes: Vec<f64> = lat.iter().flat_map(|_| lon.iter().map(|lon| of_east((lon - LON_DEG) * east))).collect();
        FieldMap::Flat(MapSurface::new(&GeographicGrid::new(&lat, &lon, &nodes).unwrap(), MapInterpolation::Linear))
    }

    #[test]
    fn law_the_error_is_evaluated_at_the_aircraft_instead_of_the_ins() {
        let mut scene = AnalyticScene::new(&uneven(80), MapInterpolation::Cubic, hills);
        // INS with a standard deviation of 300 m, 60 m too far east. The map error rises by 0.001 nT per metre
        // eastward.
        scene.errors.sources.init_position_sigma_m = 300.0;
        let (_, east) = m_per_deg();
        let found = scene.with(|line| along(line, &errors(|east_m| 8.0 + 0.001 * east_m), 2.0)).unwrap();
        let of = |row: usize, shift_m: f64| 2.0 * (8.0 + 0.001 * ((scene.columns[2][row] - LON_DEG) * east + shift_m));
        assert!((found[0] - of(0, 0.0)).abs() < 1e-6, "nothing is known before the first measurement: {}", found[0]);
        let off = |shift_m: f64| (40..80).map(|row| (found[row] - of(row, shift_m)).abs()).sum::<f64>() / 40.0;
        assert!(off(-60.0) < 0.4 * off(0.0), "{} {}", off(-60.0), off(0.0));
    }

    #[test]
    fn unit_an_unknown_error_differs_from_zero() {
        let scene = AnalyticScene::new(&uneven(10), MapInterpolation::Linear, hills);
        let far = errors(|east_m| if east_m < 4000.0 { f64::NAN } else { 5.0 });
        assert!(scene.with(|line| along(line, &far, 1.0)).unwrap().iter().all(|sigma| sigma.is_nan()));
    }
}
