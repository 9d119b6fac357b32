//! Velocity and specific force of a track, for files with positions only and for the simulator.

use numerics::angle::unwrapped_deg;
use numerics::earth::geodesy::EarthModel;
use numerics::navigation::strapdown::{slopes, specific_force_mps2};

/// A track: time in seconds, geodetic latitude and longitude in degrees, height above WGS-84 in metres.
#[derive(Clone, Copy)]
pub struct GeodeticTrack<'a> {
    /// Seconds.
    pub tt: &'a [f64],
    /// Geodetic latitude.
    pub lat_deg: &'a [f64],
    /// Longitude.
    pub lon_deg: &'a [f64],
    /// Height above WGS-84.
    pub alt_m: &'a [f64],
}

/// North, east and down, each a column.
pub type NedColumns = [Vec<f64>; 3];

impl GeodeticTrack<'_> {
    /// Velocity in m/s, north-east-down, by differences of the positions on the ellipsoid.
    ///
    /// It uses true north, both radii of curvature and the height. Differences of grid coordinates would use grid north
    /// and the projection's scale instead.
    pub fn velocity_mps(&self) -> NedColumns {
        let (dlat, dlon) = (slopes(self.tt, self.lat_deg), slopes(self.tt, &unwrapped_deg(self.lon_deg)));
        let earth = EarthModel::Wgs84;
        let at = |i: usize| (self.lat_deg[i].to_radians(), self.alt_m[i]);
        let rows = 0..self.tt.len();
        let north = |i: usize| dlat[i].to_radians() * earth.north_m_per_rad(at(i).0, at(i).1);
        let east = |i: usize| dlon[i].to_radians() * earth.east_m_per_rad(at(i).0, at(i).1);
        let down = slopes(self.tt, self.alt_m).iter().map(|x| -x).collect();
        [rows.clone().map(north).collect(), rows.map(east).collect(), down]
    }

    /// Specific force in m/s², north-east-down, of a body that moves with `velocity_mps` along the track.
    pub fn specific_force_mps2(&self, velocity_mps: &NedColumns) -> NedColumns {
        let rates = velocity_mps.each_ref().map(|v| slopes(self.tt, v));
        let rows = 0..self.tt.len();
        let forces = rows.map(|i| {
            let take = |columns: &NedColumns| [columns[0][i], columns[1][i], columns[2][i]];
            specific_force_mps2(self.lat_deg[i].to_radians(), self.alt_m[i], take(velocity_mps), take(&rates))
        });
        let mut out: NedColumns = [vec![], vec![], vec![]];
        for force in forces {
            for (column, value) in out.iter_mut().zip(force) {
                column.push(value);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use numerics::angle::wrap_deg;
    use numerics::earth::geodesy::{meridian_radius_m, transverse_radius_m};

    use super::*;

    #[test]
    fn law_velocity_of_a_meridian_and_a_parallel() {
        let tt: Vec<f64> = (0..50).map(f64::from).collect();
        let (lat0, alt) = (45.0_f64, vec![1000.0; 50]);
        let step = 1e-3_f64;
        let lat: Vec<f64> = (0..50).map(|i| lat0 + step * f64::from(i - 25)).collect();
        let lon = vec![179.99; 50];
        let [vn, ve, vd] = GeodeticTrack { tt: &tt, lat_deg: &lat, lon_deg: &lon, alt_m: &alt }.velocity_mps();
        let expected = step.to_radians() * (meridian_radius_m(lat[25].to_radians()) + 1000.0);
        // Central differences of a linear latitude are exact up to rounding of degrees (1e-14 x 1e7 m).
        assert!((vn[25] - expected).abs() < 1e-6 && ve[25] == 0.0 && vd[25] == 0.0);
        let lat = vec![lat0; 50];
        let lon: Vec<f64> = (0..50).map(|i| wrap_deg(179.99 + step * f64::from(i))).collect();
        let [_, ve, _] = GeodeticTrack { tt: &tt, lat_deg: &lat, lon_deg: &lon, alt_m: &alt }.velocity_mps();
        let expected = step.to_radians() * (transverse_radius_m(lat0.to_radians()) + 1000.0) * lat0.to_radians().cos();
        // The same across the date line.
        assert!(ve.iter().all(|v| (v - expected).abs() < 1e-6));
    }
}
