//! Inertial quantities of a flight without an inertial navigation record, derived from its positions: velocity from
//! positions, specific force from velocity, attitude from the course.
//!
//! These quantities are inputs to the coefficients of the error model, which require an accuracy of only a few per
//! cent.

use crate::angle::unwrapped_deg;
use crate::{
    earth::geodesy::{EARTH_RATE_RADPS, EarthModel, meridian_radius_m, transverse_radius_m},
    navigation::{
        ins_series::{SeriesError, check_column, check_latitudes, check_time},
        mechanisation::normal_gravity_mps2,
    },
};

/// Three columns: north, east, down; or roll, pitch, yaw.
pub type StrapdownColumns = [Vec<f64>; 3];

/// Derivative of evenly or unevenly sampled values: [`slopes`] of checked values and times.
///
/// # Errors
/// Fails for columns of different lengths, fewer than two samples, or times that do not increase.
pub fn derivative(tt_s: &[f64], values: &[f64]) -> Result<Vec<f64>, SeriesError> {
    check_length("value", values, tt_s)?;
    if tt_s.len() < 2 {
        return Err(SeriesError::TooShort { rows: tt_s.len(), needed: 2 });
    }
    check_time(tt_s)?;
    Ok(slopes(tt_s, values))
}

/// Slope at each sample: the slope of the parabola through the sample and its neighbours. If the sample itself is
/// missing, the result is the slope of the chord between the neighbours; at the ends, the result is the slope between
/// the first or last two samples. NaN if a neighbour is missing or time does not increase.
pub fn slopes(tt_s: &[f64], values: &[f64]) -> Vec<f64> {
    let n = tt_s.len().min(values.len());
    let slope = |from: usize, to: usize| {
        let step_s = tt_s[to] - tt_s[from];
        if step_s > 0.0 { (values[to] - values[from]) / step_s } else { f64::NAN }
    };
    let one = |i: usize| {
        let (before, after) = (i.saturating_sub(1), (i + 1).min(n - 1));
        if before == i || after == i || values[i].is_nan() {
            return slope(before, after);
        }
        let (before_s, after_s) = (tt_s[i] - tt_s[before], tt_s[after] - tt_s[i]);
        (slope(before, i) * after_s + slope(i, after) * before_s) / (before_s + after_s)
    };
    (0..n).map(one).collect()
}

/// Velocity north, east and down, in m/s, from geodetic positions (degrees, degrees, m above the ellipsoid), with the
/// ellipsoid's radii at each sample. A longitude may cross ±180°.
///
/// # Errors
/// Returns the errors of [`derivative`]. Also fails for positions that are not finite, or for latitudes at or beyond a
/// pole.
pub fn velocity_ned_mps(
    tt_s: &[f64],
    lat_deg: &[f64],
    lon_deg: &[f64],
    alt_m: &[f64],
) -> Result<StrapdownColumns, SeriesError> {
    for (column, values) in [("lat", lat_deg), ("lon", lon_deg), ("alt", alt_m)] {
        check_column(column, values, tt_s.len())?;
    }
    check_latitudes("lat", lat_deg)?;
    let lat_rate = derivative(tt_s, lat_deg)?;
    let lon_rate = derivative(tt_s, &unwrapped_deg(lon_deg))?;
    let alt_rate = derivative(tt_s, alt_m)?;
    let earth = EarthModel::Wgs84;
    let places = || lat_deg.iter().map(|lat| lat.to_radians()).zip(alt_m);
    let north =
        lat_rate.iter().zip(places()).map(|(rate, (lat, alt))| earth.lat_rad_to_north_m(rate.to_radians(), lat, *alt));
    let east =
        lon_rate.iter().zip(places()).map(|(rate, (lat, alt))| earth.lon_rad_to_east_m(rate.to_radians(), lat, *alt));
    Ok([north.collect(), east.collect(), alt_rate.iter().map(|rate| -rate).collect()])
}

/// Specific force north, east and down, in m/s², along a track: [`specific_force_mps2`] of the derivatives. The track
/// has latitudes (degrees), heights above the ellipsoid (m) and velocities (m/s).
///
/// MagNav.jl omits the Coriolis and transport terms and uses 9.80665 m/s² for gravity.
///
/// # Errors
/// Returns the errors of [`velocity_ned_mps`].
pub fn specific_force_ned_mps2(
    tt_s: &[f64],
    [lat_deg, alt_m]: [&[f64]; 2],
    velocity_ned_mps: [&[f64]; 3],
) -> Result<StrapdownColumns, SeriesError> {
    for (column, values) in [("lat", lat_deg), ("alt", alt_m)] {
        check_column(column, values, tt_s.len())?;
    }
    check_latitudes("lat", lat_deg)?;
    let [north, east, down] = velocity_ned_mps.map(|v| derivative(tt_s, v));
    let rates = [north?, east?, down?];
    let mut out = StrapdownColumns::default();
    for row in 0..tt_s.len() {
        let (v, rate) = (velocity_ned_mps.map(|v| v[row]), rates.each_ref().map(|r| r[row]));
        let force = specific_force_mps2(lat_deg[row].to_radians(), alt_m[row], v, rate);
        out.iter_mut().zip(force).for_each(|(column, f)| column.push(f));
    }
    Ok(out)
}

/// Specific force f = dv/dt + (2 ω_ie + ω_en) × v − g, north-east-down, in m/s². Inputs are latitude in rad, height
/// above the ellipsoid in m, velocity in m/s and its rate in m/s²; g is the ellipsoid's normal gravity. [Titterton &
/// Weston 2004, (3.29)]
pub fn specific_force_mps2(lat_rad: f64, alt_m: f64, v: [f64; 3], rate: [f64; 3]) -> [f64; 3] {
    let (sin, cos) = lat_rad.sin_cos();
    let (meridian_m, transverse_m) = (meridian_radius_m(lat_rad) + alt_m, transverse_radius_m(lat_rad) + alt_m);
    let w = [
        2.0 * EARTH_RATE_RADPS * cos + v[1] / transverse_m,
        -v[0] / meridian_m,
        -2.0 * EARTH_RATE_RADPS * sin - v[1] * sin / cos / transverse_m,
    ];
    let cross = [w[1] * v[2] - w[2] * v[1], w[2] * v[0] - w[0] * v[2], w[0] * v[1] - w[1] * v[0]];
    [rate[0] + cross[0], rate[1] + cross[1], rate[2] + cross[2] - normal_gravity_mps2(lat_rad, alt_m)]
}

/// Roll, pitch and yaw, in degrees, of an aircraft in level flight with its nose along its course. A sample at rest
/// keeps the previous yaw; before any motion, yaw is 0.
///
/// # Errors
/// Fails with [`SeriesError::Length`] for columns of different lengths.
pub fn level_attitude_deg(vn_mps: &[f64], ve_mps: &[f64]) -> Result<StrapdownColumns, SeriesError> {
    check_length("ve", ve_mps, vn_mps)?;
    let mut course_deg = 0.0;
    let yaw: Vec<f64> = vn_mps
        .iter()
        .zip(ve_mps)
        .map(|(vn, ve)| {
            if *vn != 0.0 || *ve != 0.0 {
                course_deg = ve.atan2(*vn).to_degrees();
            }
            course_deg
        })
        .collect();
    let level = vec![0.0; yaw.len()];
    Ok([level.clone(), level, yaw])
}

fn check_length(column: &'static str, values: &[f64], like: &[f64]) -> Result<(), SeriesError> {
    if values.len() == like.len() {
        return Ok(());
    }
    Err(SeriesError::Length { column, rows: values.len(), expected: like.len() })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::angle::wrap_deg;

    #[test]
    fn law_a_parabola_is_differentiated_exactly_on_uneven_steps() {
        let tt = [0.0, 0.1, 0.35, 0.4, 1.0];
        let x: Vec<f64> = tt.iter().map(|t| 3.0 + 2.0 * t - 5.0 * t * t).collect();
        let d = derivative(&tt, &x).unwrap();
        for k in 1..4 {
            assert!((d[k] - (2.0 - 10.0 * tt[k])).abs() < 1e-13);
        }
        assert!((d[0] - (2.0 - 5.0 * 0.1)).abs() < 1e-13, "the first two samples' slope");
        assert!((d[4] - (2.0 - 5.0 * 1.4)).abs() < 1e-13, "the last two samples' slope");
    }

    #[test]
    fn law_velocity_is_exact_for_a_known_path_across_the_date_line() {
        let (lat, alt) = (50.0_f64, 300.0);
        let (speed_n, speed_e) = (40.0, -70.0);
        let earth = EarthModel::Wgs84;
        let tt: Vec<f64> = (0..50).map(|k| 0.2 * f64::from(k)).collect();
        let lats: Vec<f64> = tt
            .iter()
            .map(|t| lat + earth.north_m_to_lat_rad(speed_n * (t - 5.0), lat.to_radians(), alt).to_degrees())
            .collect();
        let lons: Vec<f64> = tt
            .iter()
            .map(|t| {
                let east = earth.east_m_to_lon_rad(speed_e * (t - 5.0), lat.to_radians(), alt);
                wrap_deg(180.0 + east.to_degrees())
            })
            .collect();
        let alts: Vec<f64> = tt.iter().map(|t| alt + 2.0 * t).collect();
        let [vn, ve, vd] = velocity_ned_mps(&tt, &lats, &lons, &alts).unwrap();
        // The radii change by 1e-4 over the 700 m of the path and the 10 m of climb.
        assert!(vn.iter().all(|v| (v - speed_n).abs() < 1e-3));
        assert!(ve.iter().all(|v| (v - speed_e).abs() < 1e-2), "{ve:?}");
        assert!(vd.iter().all(|v| (v + 2.0).abs() < 1e-9));
        let [f_n, f_e, f_d] = specific_force_ned_mps2(&tt, [&lats, &alts], [&vn, &ve, &vd]).unwrap();
        // Coriolis and transport: (2 ω sin φ + ve tan φ/R) rotates the velocity; the vertical component has the Eötvös
        // term.
        let (lat, radius) = (50.0_f64.to_radians(), transverse_radius_m(50.0_f64.to_radians()) + 305.0);
        let turn = 2.0 * EARTH_RATE_RADPS * lat.sin() + speed_e * lat.tan() / radius;
        let eotvos = 2.0 * EARTH_RATE_RADPS * lat.cos() + speed_e / radius;
        // As the latitude changes, the speed changes for a given rate of longitude.
        let [rate_n, rate_e] = [&vn, &ve].map(|v| derivative(&tt, v).unwrap()[25]);
        assert!((f_n[25] - rate_n - turn * speed_e).abs() < 1e-4);
        assert!((f_e[25] - rate_e + turn * speed_n - 2.0 * eotvos).abs() < 1e-4);
        let lift = eotvos * speed_e + speed_n * speed_n / radius;
        assert!((f_d[25] - lift + normal_gravity_mps2(lat, 305.0)).abs() < 1e-4);
    }

    #[test]
    fn law_specific_force_is_minus_gravity_at_rest_and_zero_in_orbit() {
        let f = specific_force_mps2(0.7, 300.0, [0.0; 3], [0.0; 3]);
        assert_eq!(f, [0.0, 0.0, -normal_gravity_mps2(0.7, 300.0)]);
        // At the equator, gravity is attraction minus ω²R; a circle at speed v in the inertial frame requires v²/R.
        let alt = 2000.0;
        let radius = transverse_radius_m(0.0) + alt;
        let attraction = normal_gravity_mps2(0.0, alt) + EARTH_RATE_RADPS.powi(2) * radius;
        let speed = (attraction * radius).sqrt() - EARTH_RATE_RADPS * radius;
        let f = specific_force_mps2(0.0, alt, [0.0, speed, 0.0], [0.0; 3]);
        assert!(f.iter().all(|f| f.abs() < 1e-12), "{f:?}");
    }

    #[test]
    fn law_the_yaw_follows_the_course() {
        let [roll, pitch, yaw] = level_attitude_deg(&[0.0, 1.0, 0.0, 0.0, -1.0], &[0.0, 0.0, 2.0, 0.0, -1.0]).unwrap();
        assert_eq!(yaw, [0.0, 0.0, 90.0, 90.0, -135.0]);
        assert!(roll.iter().chain(&pitch).all(|angle| *angle == 0.0));
    }

    #[test]
    fn unit_invalid_columns_are_rejected() {
        let message = |r: Result<StrapdownColumns, SeriesError>| r.unwrap_err().to_string();
        assert_eq!(
            message(velocity_ned_mps(&[0.0, 1.0], &[1.0, f64::NAN], &[0.0; 2], &[0.0; 2])),
            "column `lat` is NaN in row 1; the filter requires a finite value in every row"
        );
        assert_eq!(
            message(velocity_ned_mps(&[0.0, 0.0], &[1.0; 2], &[0.0; 2], &[0.0; 2])),
            "time does not ascend: `tt` is 0 s in row 1 after 0 s"
        );
        assert!(message(velocity_ned_mps(&[0.0], &[1.0], &[0.0], &[0.0])).contains("at least 2"));
        assert!(message(velocity_ned_mps(&[0.0], &[90.0], &[0.0], &[0.0])).contains("pole"));
        assert!(message(level_attitude_deg(&[0.0], &[])).contains("has 0 rows"));
    }
}
