//! The earth's core field: IGRF-14 and WMM, as vector and magnitude, at one date or along a track.
//!
//! The potential is a sum of solid harmonics in earth-centred Cartesian coordinates (Cunningham's recursion;
//! Montenbruck & Gill, *Satellite Orbits*, 3.2.4 and 3.2.5). The sum has no singularity at the poles. A derivative of
//! such a sum is also a sum of this form, one degree higher. The coefficients of the three field components and of the
//! gradient tensor are therefore computed once per date. An evaluation consists of one recursion and a few dot
//! products, without allocation.
//!
//! Coefficients are linear in time between epochs; see [`CoreFieldModel`].

mod coefficients;
mod track;

use std::sync::Arc;

use crate::earth::field_value::FieldValue;
use crate::earth::geodesy::{EarthModel, ecef_m};
pub use coefficients::{CoreFieldError, CoreFieldModel, GeodeticCoordinate};
use coefficients::{REFERENCE_RADIUS_M, TERMS, derivative, index};
pub use track::{CoreFieldTrack, NedField};

/// Highest degree of the evaluated harmonics: derivatives exceed the model by two degrees.
const HIGHEST_DEGREE: usize = coefficients::DEGREE + 2;

/// The core field at one date.
#[derive(Clone, Debug)]
pub struct CoreField {
    decimal_year: f64,
    /// Coefficients of the earth-centred field components, in nT.
    components: [Box<[f64; TERMS]>; 3],
    /// Coefficients of the field's gradient tensor xx, xy, xz, yy, yz, zz, in nT/m.
    tensor: [Box<[f64; TERMS]>; 6],
    recursion: Box<HarmonicRecursion>,
}

/// Factors of the recursion over degrees, by term index.
#[derive(Clone, Debug)]
struct HarmonicRecursion {
    one_back: [f64; TERMS / 2],
    two_back: [f64; TERMS / 2],
}

/// The local north, east and up directions in earth-centred components.
struct LocalDirections {
    north: [f64; 3],
    east: [f64; 3],
    up: [f64; 3],
}

impl CoreField {
    /// IGRF-14 at `decimal_year`, from 1900 to 2030. One date is enough for a whole flight: the field changes by at
    /// most 0.3 nT a day.
    ///
    /// # Errors
    /// Returns the errors of [`Self::new`].
    pub fn at(decimal_year: f64) -> Result<Self, CoreFieldError> {
        Self::new(CoreFieldModel::Igrf14, decimal_year)
    }

    /// A model's field at `decimal_year`.
    ///
    /// # Errors
    /// Fails with [`CoreFieldError::Date`] for a date that the model does not cover, or with
    /// [`CoreFieldError::Coefficients`] for a damaged file of coefficients.
    pub fn new(model: CoreFieldModel, decimal_year: f64) -> Result<Self, CoreFieldError> {
        let potential = model.span(decimal_year)?.at(decimal_year);
        let field = [0, 1, 2].map(|axis| derivative(&potential, axis, -1.0));
        let second = |component: usize, axis: usize| derivative(&field[component], axis, 1.0 / REFERENCE_RADIUS_M);
        let tensor = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|(component, axis)| second(component, axis));
        Ok(Self { decimal_year, components: field, tensor, recursion: Box::new(HarmonicRecursion::new()) })
    }

    /// The date of this field.
    pub fn decimal_year(&self) -> f64 {
        self.decimal_year
    }

    /// The field (north, east, down) in nT at a geodetic position: degrees, degrees, metres above the WGS-84 ellipsoid.
    /// At a pole, north is the direction of the meridian `lon_deg`.
    pub fn field_ned_nt(&self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> [f64; 3] {
        let (lat, lon) = (lat_deg.to_radians(), lon_deg.to_radians());
        let harmonics = self.recursion.harmonics(ecef_m(lat, lon, alt_m), HIGHEST_DEGREE - 1);
        let field = self.components.each_ref().map(|c| dot_terms(c, &harmonics));
        let local = LocalDirections::at(lat, lon);
        [dot3(&field, &local.north), dot3(&field, &local.east), -dot3(&field, &local.up)]
    }

    /// The magnitude of the field, in nT, at a geodetic position (degrees, degrees, metres).
    pub fn magnitude_nt(&self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> f64 {
        let [north, east, down] = self.field_ned_nt(lat_deg, lon_deg, alt_m);
        (north * north + east * east + down * down).sqrt()
    }

    /// The magnitude of the field and its exact gradient at a geodetic position (degrees, degrees,
    /// metres).
    pub fn magnitude_and_gradient(&self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> FieldValue {
        let (lat, lon) = (lat_deg.to_radians(), lon_deg.to_radians());
        let harmonics = self.recursion.harmonics(ecef_m(lat, lon, alt_m), HIGHEST_DEGREE);
        let field = self.components.each_ref().map(|c| dot_terms(c, &harmonics));
        let [xx, xy, xz, yy, yz, zz] = self.tensor.each_ref().map(|c| dot_terms(c, &harmonics));
        let magnitude = dot3(&field, &field).sqrt();
        let unit = field.map(|component| component / magnitude);
        let gradient = [dot3(&[xx, xy, xz], &unit), dot3(&[xy, yy, yz], &unit), dot3(&[xz, yz, zz], &unit)];
        let local = LocalDirections::at(lat, lon);
        let earth = EarthModel::Wgs84;
        FieldValue {
            value_nt: magnitude,
            d_lat_nt_per_rad: dot3(&gradient, &local.north) * earth.north_m_per_rad(lat, alt_m),
            d_lon_nt_per_rad: dot3(&gradient, &local.east) * earth.east_m_per_rad(lat, alt_m),
            d_alt_nt_per_m: dot3(&gradient, &local.up),
        }
    }
}

/// Magnitude of the core field, expanded to first order about a recent position. A filter evaluates it several hundred
/// thousand times per flight.
///
/// A query more than 141 m (200 m/√2) north, south, east or west of the expansion point, or more than 50 m above or
/// below it, becomes the expansion point. The field's curvature is below 5e-9 nT/m², so the error stays below 0.001 nT.
#[derive(Clone, Debug)]
pub struct LinearisedCoreField {
    field: Arc<CoreField>,
    place: Option<CoreFieldExpansion>,
}

#[derive(Clone, Copy, Debug)]
struct CoreFieldExpansion {
    lat_deg: f64,
    lon_deg: f64,
    alt_m: f64,
    reach_lat_deg: f64,
    reach_lon_deg: f64,
    at_place: FieldValue,
}

const REACH_SIDEWAYS_M: f64 = 200.0;
const REACH_VERTICAL_M: f64 = 50.0;

impl LinearisedCoreField {
    /// Starts without an expansion point. The first query sets the expansion point.
    pub fn new(field: impl Into<Arc<CoreField>>) -> Self {
        Self { field: field.into(), place: None }
    }

    /// Expansion point (degrees, degrees, metres), on which the last bits of the results depend.
    pub(crate) fn expansion_point(&self) -> Option<[f64; 3]> {
        self.place.map(|place| [place.lat_deg, place.lon_deg, place.alt_m])
    }

    /// Expands about a point, or discards the expansion.
    pub(crate) fn expand_at(&mut self, point: Option<[f64; 3]>) {
        self.place = point.map(|[lat_deg, lon_deg, alt_m]| {
            let at_place = self.field.magnitude_and_gradient(lat_deg, lon_deg, alt_m);
            CoreFieldExpansion::new(lat_deg, lon_deg, alt_m, at_place)
        });
    }

    /// Magnitude and gradient near a geodetic position (degrees, degrees, metres). The gradient is evaluated at the
    /// expansion point. The result depends on the order of queries (by up to 0.001 nT): use one instance per line.
    pub fn magnitude_and_gradient(&mut self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> FieldValue {
        match self.place {
            Some(place) if place.reaches(lat_deg, lon_deg, alt_m) => place.extrapolate(lat_deg, lon_deg, alt_m),
            _ => {
                let at_place = self.field.magnitude_and_gradient(lat_deg, lon_deg, alt_m);
                self.place = Some(CoreFieldExpansion::new(lat_deg, lon_deg, alt_m, at_place));
                at_place
            }
        }
    }
}

impl CoreFieldExpansion {
    fn new(lat_deg: f64, lon_deg: f64, alt_m: f64, at_place: FieldValue) -> Self {
        let earth = EarthModel::Wgs84;
        let lat = lat_deg.to_radians();
        // With 1/√2 of the limit in each of two directions, the corner of the box is within the limit.
        let side_m = REACH_SIDEWAYS_M / std::f64::consts::SQRT_2;
        Self {
            lat_deg,
            lon_deg,
            alt_m,
            reach_lat_deg: earth.north_m_to_lat_rad(side_m, lat, alt_m).to_degrees(),
            reach_lon_deg: earth.east_m_to_lon_rad(side_m, lat, alt_m).abs().to_degrees(),
            at_place,
        }
    }

    fn reaches(&self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> bool {
        (lat_deg - self.lat_deg).abs() <= self.reach_lat_deg
            && (lon_deg - self.lon_deg).abs() <= self.reach_lon_deg
            && (alt_m - self.alt_m).abs() <= REACH_VERTICAL_M
    }

    fn extrapolate(&self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> FieldValue {
        let at = &self.at_place;
        let change_nt = at.d_lat_nt_per_rad * (lat_deg - self.lat_deg).to_radians()
            + at.d_lon_nt_per_rad * (lon_deg - self.lon_deg).to_radians()
            + at.d_alt_nt_per_m * (alt_m - self.alt_m);
        FieldValue { value_nt: at.value_nt + change_nt, ..*at }
    }
}

impl LocalDirections {
    fn at(lat_rad: f64, lon_rad: f64) -> Self {
        let (sin_lat, cos_lat) = lat_rad.sin_cos();
        let (sin_lon, cos_lon) = lon_rad.sin_cos();
        Self {
            north: [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
            east: [-sin_lon, cos_lon, 0.0],
            up: [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
        }
    }
}

impl HarmonicRecursion {
    fn new() -> Self {
        let mut factors = Self { one_back: [0.0; TERMS / 2], two_back: [0.0; TERMS / 2] };
        for n in 1..=HIGHEST_DEGREE {
            for m in 0..n {
                let (n_f, m_f) = (n as f64, m as f64);
                factors.one_back[index(n, m)] = (2.0 * n_f - 1.0) / (n_f - m_f);
                factors.two_back[index(n, m)] = (n_f + m_f - 1.0) / (n_f - m_f);
            }
        }
        factors
    }

    /// The solid harmonics (a/r)^(n+1) P_nm cos mλ and ... sin mλ, interleaved, up to `degree` at an earth-centred
    /// position in metres. P_nm is not normalised and has no Condon-Shortley phase.
    fn harmonics(&self, position_m: [f64; 3], degree: usize) -> [f64; TERMS] {
        let radius_squared = dot3(&position_m, &position_m);
        let [x, y, z] = position_m.map(|p| p * REFERENCE_RADIUS_M / radius_squared);
        let ratio_squared = REFERENCE_RADIUS_M * REFERENCE_RADIUS_M / radius_squared;
        let mut terms = [0.0; TERMS];
        terms[0] = ratio_squared.sqrt();
        for n in 1..=degree {
            self.zonal_to_subdiagonal(&mut terms, n, z, ratio_squared);
            let (before, here) = (2 * index(n - 1, n - 1), 2 * index(n, n));
            let factor = 2.0 * n as f64 - 1.0;
            let (v, w) = (terms[before], terms[before + 1]);
            terms[here] = factor * (x * v - y * w);
            terms[here + 1] = factor * (x * w + y * v);
        }
        terms
    }

    /// Computes the harmonics of degree `n` and orders below `n` from the two lower degrees.
    fn zonal_to_subdiagonal(&self, terms: &mut [f64; TERMS], n: usize, z: f64, ratio_sq: f64) {
        for m in 0..n {
            let here = index(n, m);
            let one = 2 * index(n - 1, m);
            let from_one = z * self.one_back[here];
            let (mut v, mut w) = (from_one * terms[one], from_one * terms[one + 1]);
            if m + 2 <= n {
                let two = 2 * index(n - 2, m);
                let from_two = ratio_sq * self.two_back[here];
                v -= from_two * terms[two];
                w -= from_two * terms[two + 1];
            }
            terms[2 * here] = v;
            terms[2 * here + 1] = w;
        }
    }
}

fn dot3(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Sum of products, in eight interleaved partial sums for vectorisation.
fn dot_terms(coefficients: &[f64; TERMS], harmonics: &[f64; TERMS]) -> f64 {
    let mut sums = [0.0; 8];
    for (c, h) in coefficients.chunks_exact(8).zip(harmonics.chunks_exact(8)) {
        for (sum, (c, h)) in sums.iter_mut().zip(c.iter().zip(h)) {
            *sum += c * h;
        }
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests;
