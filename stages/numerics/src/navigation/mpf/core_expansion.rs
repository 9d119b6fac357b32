//! Core field over the whole cloud of particles: an expansion to second order.

use std::sync::Arc;

use crate::earth::core_field::CoreField;
use crate::earth::field_value::FieldValue;
use crate::earth::geodesy::EarthModel;

/// Magnitude of the core field, expanded about a point near the middle of the cloud. A cloud may be tens of kilometres
/// wide, which exceeds the range of a linear expansion. The second-order expansion is exact to 0.001 nT within 10 km,
/// and to 0.1 nT within 30 km.
#[derive(Clone, Debug)]
pub(super) struct CoreExpansion {
    field: Arc<CoreField>,
    place: Option<CoreExpansionPoint>,
}

#[derive(Clone, Copy, Debug)]
struct CoreExpansionPoint {
    lat_deg: f64,
    lon_deg: f64,
    alt_m: f64,
    at_place: FieldValue,
    /// Second derivatives with respect to latitude, to latitude and longitude, and to longitude, in nT/rad².
    second: [f64; 3],
    /// Derivatives of the vertical slope with respect to latitude and longitude, in nT/(m rad).
    slope_d_lat: f64,
    slope_d_lon: f64,
}

/// Largest distance between the expansion point and the middle of the cloud. Beyond it, the expansion point is moved.
const REACH_M: f64 = 2000.0;
const REACH_UP_M: f64 = 100.0;
/// Step of the central differences of the exact gradient: about 3 km.
const DIFFERENCE_RAD: f64 = 5e-4;

impl CoreExpansion {
    pub(super) fn new(field: Arc<CoreField>) -> Self {
        Self { field, place: None }
    }

    /// Moves the expansion point if the middle of the cloud is too far from this point.
    pub(super) fn follow(&mut self, lat_deg: f64, lon_deg: f64, alt_m: f64) {
        let near = |place: &CoreExpansionPoint| {
            let (north, east) =
                EarthModel::Wgs84.offset_ne_m((place.lat_deg, place.lon_deg), (lat_deg, lon_deg), alt_m);
            north.hypot(east) <= REACH_M && (alt_m - place.alt_m).abs() <= REACH_UP_M
        };
        if !self.place.as_ref().is_some_and(near) {
            self.place = Some(CoreExpansionPoint::new(&self.field, lat_deg, lon_deg, alt_m));
        }
    }

    /// Value, in nT, and its change with height, in nT/m; 0 before the first [`Self::follow`].
    #[inline(always)]
    pub(super) fn at(&self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> (f64, f64) {
        self.place.as_ref().map_or((0.0, 0.0), |place| place.extrapolate(lat_deg, lon_deg, alt_m))
    }

    /// Horizontal gradient at the expansion point, in nT/rad; 0 before the first [`Self::follow`].
    pub(super) fn gradient(&self) -> [f64; 2] {
        self.place.as_ref().map_or([0.0; 2], |CoreExpansionPoint { at_place, .. }| {
            [at_place.d_lat_nt_per_rad, at_place.d_lon_nt_per_rad]
        })
    }
}

impl CoreExpansionPoint {
    fn new(field: &CoreField, lat_deg: f64, lon_deg: f64, alt_m: f64) -> Self {
        let step_deg = DIFFERENCE_RAD.to_degrees();
        let at = |lat: f64, lon: f64| field.magnitude_and_gradient(lat_deg + lat, lon_deg + lon, alt_m);
        let half = 0.5 / DIFFERENCE_RAD;
        let (north, south) = (at(step_deg, 0.0), at(-step_deg, 0.0));
        let (east, west) = (at(0.0, step_deg), at(0.0, -step_deg));
        Self {
            lat_deg,
            lon_deg,
            alt_m,
            at_place: at(0.0, 0.0),
            second: [
                (north.d_lat_nt_per_rad - south.d_lat_nt_per_rad) * half,
                (east.d_lat_nt_per_rad - west.d_lat_nt_per_rad) * half,
                (east.d_lon_nt_per_rad - west.d_lon_nt_per_rad) * half,
            ],
            slope_d_lat: (north.d_alt_nt_per_m - south.d_alt_nt_per_m) * half,
            slope_d_lon: (east.d_alt_nt_per_m - west.d_alt_nt_per_m) * half,
        }
    }

    #[inline(always)]
    fn extrapolate(&self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> (f64, f64) {
        let (north, east) = ((lat_deg - self.lat_deg).to_radians(), (lon_deg - self.lon_deg).to_radians());
        let [twice_lat, mixed, twice_lon] = self.second;
        let d_lat = self.at_place.d_lat_nt_per_rad + 0.5 * (twice_lat * north + mixed * east);
        let d_lon = self.at_place.d_lon_nt_per_rad + 0.5 * (mixed * north + twice_lon * east);
        let d_alt = self.at_place.d_alt_nt_per_m + (self.slope_d_lat * north + self.slope_d_lon * east);
        (self.at_place.value_nt + d_lat * north + d_lon * east + d_alt * (alt_m - self.alt_m), d_alt)
    }
}
