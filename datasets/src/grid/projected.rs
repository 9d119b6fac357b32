//! A grid of eastings and northings, and its resampling to latitude and longitude.

use std::path::Path;

use stages::numerics::geodesy::{meridian_radius_m, transverse_radius_m};

use super::{Axis, Crs, Height, Map, check_values, interpolate};
use crate::ReadError;

/// A regular grid in a projected coordinate system.
pub(crate) struct Projected {
    /// Eastings, in metres or whatever the system counts in.
    pub(crate) easting: Axis,
    /// Northings.
    pub(crate) northing: Axis,
    /// nT, by rows from south to north, NaN where unknown.
    pub(crate) anomaly_nt: Vec<f64>,
    /// The system of the coordinates.
    pub(crate) crs: Crs,
    /// The height of the map above the ellipsoid.
    pub(crate) alt_m: f64,
    /// What was done so far.
    pub(crate) notes: Vec<String>,
}

/// The least grid that can be interpolated.
const LEAST_NODES: usize = 4;

impl Projected {
    /// The same map on a regular grid of latitude and longitude that covers it, with a spacing no wider
    /// than the projected one. Cells outside the projected grid, or within two nodes of an unknown one,
    /// are NaN.
    pub(crate) fn to_geographic(&self, path: &Path) -> Result<Map, ReadError> {
        if self.easting.len < LEAST_NODES || self.northing.len < LEAST_NODES {
            let what = format!("a projected map needs {LEAST_NODES} x {LEAST_NODES} nodes to be resampled");
            return Err(ReadError::data(path, what));
        }
        check_values(path, &self.anomaly_nt, self.easting.len * self.northing.len)?;
        let (lat, lon) = self.axes(path)?;
        let mut values = Vec::with_capacity(lat.len * lon.len);
        for lat_deg in lat.coordinates() {
            values.extend(lon.coordinates().iter().map(|lon_deg| self.value_at(lat_deg, *lon_deg)));
        }
        let mut notes = self.notes.clone();
        notes.push(format!(
            "resampled from {} x {} nodes in EPSG:{} to latitude and longitude by polynomials of ninth degree (fifth \
             or third near edges and unknown nodes)",
            self.northing.len,
            self.easting.len,
            self.crs.code()
        ));
        Map::new(path, &lat.coordinates(), &lon.coordinates(), Height::Level(self.alt_m), values, notes)
    }

    /// The anomaly at a place, NaN where unknown.
    pub(super) fn value_at(&self, lat_deg: f64, lon_deg: f64) -> f64 {
        let place = self.crs.project(lat_deg, lon_deg);
        let nodes = place.and_then(|(e, n)| Some((self.easting.node(e)?, self.northing.node(n)?)));
        nodes.map_or(f64::NAN, |(column, row)| {
            interpolate::at(&self.anomaly_nt, &self.easting, &self.northing, column, row)
        })
    }

    /// The axes of latitude and longitude.
    fn axes(&self, path: &Path) -> Result<(Axis, Axis), ReadError> {
        let (mut lat, mut lon) = ((f64::INFINITY, f64::NEG_INFINITY), (f64::INFINITY, f64::NEG_INFINITY));
        for (easting, northing) in self.outline() {
            let place = self.crs.unproject(easting, northing).ok_or_else(|| {
                let what = format!("({easting}, {northing}) is no place in EPSG:{}", self.crs.code());
                ReadError::data(path, what).help("check the EPSG code")
            })?;
            lat = (lat.0.min(place.0), lat.1.max(place.0));
            lon = (lon.0.min(place.1), lon.1.max(place.1));
        }
        if lon.1 - lon.0 > 180.0 {
            return Err(ReadError::data(path, "the map crosses the date line; cut it there").in_column("lon"));
        }
        // Where a degree is longest the spacing is the projected one; elsewhere it is narrower.
        let longest = lat.0.abs().max(lat.1.abs()).to_radians();
        let widest = if lat.0 <= 0.0 && lat.1 >= 0.0 { 0.0 } else { lat.0.abs().min(lat.1.abs()).to_radians() };
        let scale = self.metres_per_unit();
        let lat_step = (self.northing.step * scale / meridian_radius_m(longest)).to_degrees();
        let lon_step = (self.easting.step * scale / (transverse_radius_m(widest) * widest.cos())).to_degrees();
        Ok((covering(lat, lat_step), covering(lon, lon_step)))
    }

    /// The border's nodes.
    fn outline(&self) -> Vec<(f64, f64)> {
        let (e, n) = (self.easting.coordinates(), self.northing.coordinates());
        let ends =
            |axis: &[f64]| [axis.first().copied(), axis.last().copied()].into_iter().flatten().collect::<Vec<_>>();
        let along = e.iter().flat_map(|e| ends(&n).into_iter().map(|n| (*e, n)));
        let across = n.iter().flat_map(|n| ends(&e).into_iter().map(|e| (e, *n)));
        along.chain(across).collect()
    }

    /// Metres on the ground to a unit of northing, in the middle of the map.
    fn metres_per_unit(&self) -> f64 {
        let (e, n) = (self.easting.at(self.easting.len as f64 / 2.0), self.northing.at(self.northing.len as f64 / 2.0));
        let (a, b) = (self.crs.unproject(e, n), self.crs.unproject(e, n + self.northing.step));
        let (Some(a), Some(b)) = (a, b) else { return 1.0 };
        let lat = a.0.to_radians();
        let north_m = (b.0 - a.0).to_radians() * meridian_radius_m(lat);
        let east_m = (b.1 - a.1).to_radians() * transverse_radius_m(lat) * lat.cos();
        north_m.hypot(east_m) / self.northing.step
    }
}

/// An axis from end to end whose step is at most `step`.
fn covering(ends: (f64, f64), step: f64) -> Axis {
    let steps = ((ends.1 - ends.0) / step).ceil().max(1.0);
    Axis { first: ends.0, step: (ends.1 - ends.0) / steps, len: steps as usize + 1 }
}
