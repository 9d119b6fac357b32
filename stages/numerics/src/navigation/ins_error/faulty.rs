//! INS output: the truth minus the errors.

use nalgebra::Vector3;

use crate::angle::wrap_deg;
use crate::earth::attitude::{body_to_ned, euler_rad, tilted};
use crate::navigation::ins_series::InsSeries;
use crate::navigation::pinson::{ACC, ALT, LAT, LON, StateVector, TILT_N, VN};

/// Output of an INS with the `errors` (truth minus INS, one per sample) along a true trajectory, as the columns of
/// [`InsSeries`] without its times: latitude, longitude (degrees), height (m), velocity (m/s) and specific force (m/s²)
/// north, east and down, roll, pitch and yaw (degrees).
///
/// The specific force is the true specific force as measured by the accelerometers x, y, z, with their biases and scale
/// errors `acc_scale` (truth minus measurement, relative), rotated by the attitude of the INS. Latitude and longitude
/// are valid and the attitude is a rotation for errors of any size. A position beyond a pole continues on the other
/// side.
///
/// `errors` has one value per sample of a series that passed [`InsSeries::check`]; additional values are ignored.
pub fn faulty_ins(truth: &InsSeries<'_>, errors: &[StateVector], acc_scale: [f64; 3]) -> [Vec<f64>; 12] {
    let mut columns: [Vec<f64>; 12] = Default::default();
    for (row, error) in errors.iter().enumerate().take(truth.len()) {
        let at = truth.point(row);
        let [roll, pitch, yaw] = at.euler_rad;
        let attitude = body_to_ned(roll, pitch, yaw);
        let said = tilted(&attitude, &-Vector3::new(error[TILT_N], error[TILT_N + 1], error[TILT_N + 2]));
        let force = attitude.transpose() * Vector3::from(at.force_ned_mps2);
        let force = said * Vector3::from_fn(|k, _| force[k] * (1.0 - acc_scale[k]) - error[ACC + k]);
        let (roll, pitch, yaw) = euler_rad(&said);
        let (lat_deg, lon_deg) =
            on_the_globe(truth.lat_deg[row] - error[LAT].to_degrees(), truth.lon_deg[row] - error[LON].to_degrees());
        let out = [
            lat_deg,
            lon_deg,
            truth.alt_m[row] - error[ALT],
            truth.vn_mps[row] - error[VN],
            truth.ve_mps[row] - error[VN + 1],
            truth.vd_mps[row] - error[VN + 2],
            force.x,
            force.y,
            force.z,
            roll.to_degrees(),
            pitch.to_degrees(),
            yaw.to_degrees(),
        ];
        columns.iter_mut().zip(out).for_each(|(column, x)| column.push(x));
    }
    columns
}

/// Latitude (-90 to 90) and longitude (-180 to 180) of angles of any size, in degrees.
fn on_the_globe(lat_deg: f64, lon_deg: f64) -> (f64, f64) {
    if lat_deg.abs() <= 90.0 {
        return (lat_deg, wrap_deg(lon_deg));
    }
    let round = (lat_deg + 90.0).rem_euclid(360.0);
    if round <= 180.0 { (round - 90.0, wrap_deg(lon_deg)) } else { (270.0 - round, wrap_deg(lon_deg + 180.0)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::navigation::pinson::STATES;

    /// Two samples: level flight to the north, and banked flight to the east.
    fn truth(columns: &[[f64; 2]; 13]) -> InsSeries<'_> {
        InsSeries::from_columns(columns.each_ref().map(|c| c.as_slice()))
    }

    const COLUMNS: [[f64; 2]; 13] = [
        [0.0, 1.0],
        [45.0, 89.9999],
        [179.9999, 10.0],
        [300.0, 310.0],
        [60.0, 0.0],
        [0.0, 70.0],
        [0.0, -1.0],
        [0.5, 0.0],
        [0.1, 2.0],
        [-9.8, -9.7],
        [0.0, 20.0],
        [0.0, 3.0],
        [0.0, 90.0],
    ];

    #[test]
    fn law_an_ins_without_errors_is_the_truth() {
        let said = faulty_ins(&truth(&COLUMNS), &[[0.0; STATES]; 2], [0.0; 3]);
        for (said, true_one) in said.iter().zip(&COLUMNS[1..]) {
            // Angles are converted to a rotation and back.
            assert!(said.iter().zip(true_one).all(|(a, b)| (a - b).abs() < 1e-12), "{said:?} {true_one:?}");
        }
    }

    #[test]
    fn law_the_output_is_the_truth_minus_the_error() {
        let mut error = [0.0; STATES];
        (error[LAT], error[LON], error[ALT]) = (-2e-4_f64.to_radians(), -3e-4_f64.to_radians(), 5.0);
        error[VN..VN + 3].copy_from_slice(&[1.0, -2.0, 3.0]);
        error[TILT_N + 2] = 1e-3;
        error[ACC] = 0.25;
        let said = faulty_ins(&truth(&COLUMNS), &[error; 2], [0.0; 3]);
        // Across the date line, and across the pole to the other side of the earth.
        assert!((said[0][0] - 45.0002).abs() < 1e-9 && (said[1][0] + 179.9998).abs() < 1e-9, "{said:?}");
        assert!((said[0][1] - 89.9999).abs() < 1e-9 && (said[1][1] + 169.9997).abs() < 1e-9, "{said:?}");
        assert_eq!([said[2][0], said[3][0], said[4][0], said[5][0]], [295.0, 59.0, 2.0, -3.0]);
        // The tilt ψ is truth minus INS, C = exp(−ψ×) C_INS. The attitude and the specific force of the INS are
        // therefore the true ones rotated by exp(ψ×). The reading of the forward accelerometer is reduced by the bias
        // of this accelerometer.
        assert!((said[11][0].to_radians() - 1e-3).abs() < 1e-9, "{}", said[11][0]);
        let (sin, cos) = 1e-3_f64.sin_cos();
        let expected = [(0.5 - 0.25) * cos - 0.1 * sin, (0.5 - 0.25) * sin + 0.1 * cos, -9.8];
        assert!((0..3).all(|k| (said[6 + k][0] - expected[k]).abs() < 1e-12), "{said:?}");
    }
}
