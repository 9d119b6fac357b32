//! What the INS of the aircraft says: truth less one realisation of its error.

use nalgebra::Vector3;
use stages::numerics::{
    attitude::{euler_rad, tilted},
    ins_error::{InsErrorFault, InsErrorModel, simulate_ins_error},
    ins_series::InsSeries,
    pinson::{ACC, LAT, TILT_N, VN},
};

use super::{random::Random, trajectory::Trajectory};

pub(super) mod spec;

/// The columns of the INS, in their order.
pub(super) const COLUMNS: [&str; 12] = [
    "ins_lat",
    "ins_lon",
    "ins_alt",
    "ins_vn",
    "ins_ve",
    "ins_vd",
    "ins_roll",
    "ins_pitch",
    "ins_yaw",
    "ins_fn",
    "ins_fe",
    "ins_fd",
];

/// INS = truth - error, aligned anew at the start of the line; one column each of [`COLUMNS`].
///
/// # Errors
/// A trajectory or a parameter that the error model cannot take.
pub(super) fn columns(
    truth: &Trajectory,
    model: &InsErrorModel,
    random: &mut Random,
) -> Result<[Vec<f64>; 12], InsErrorFault> {
    let errors = simulate_ins_error(&series(truth), model, || random.normal())?;
    let mut columns: [Vec<f64>; 12] = Default::default();
    for (i, e) in errors.iter().enumerate() {
        let c = truth.attitude(i);
        let c_ins = tilted(&c, &-Vector3::new(e[TILT_N], e[TILT_N + 1], e[TILT_N + 2]));
        let f = Vector3::from_fn(|k, _| truth.force_mps2[k][i]);
        // The accelerometers' error is truth minus measurement, too.
        let f_ins = c_ins * (c.transpose() * f - Vector3::new(e[ACC], e[ACC + 1], e[ACC + 2]));
        let (roll, pitch, yaw) = euler_rad(&c_ins);
        let row = [
            truth.lat_deg[i] - e[LAT].to_degrees(),
            truth.lon_deg[i] - e[LAT + 1].to_degrees(),
            truth.alt_m[i] - e[LAT + 2],
            truth.velocity_mps[0][i] - e[VN],
            truth.velocity_mps[1][i] - e[VN + 1],
            truth.velocity_mps[2][i] - e[VN + 2],
            roll.to_degrees(),
            pitch.to_degrees(),
            yaw.to_degrees(),
            f_ins.x,
            f_ins.y,
            f_ins.z,
        ];
        columns.iter_mut().zip(row).for_each(|(column, x)| column.push(x));
    }
    Ok(columns)
}

fn series(truth: &Trajectory) -> InsSeries<'_> {
    let ([vn, ve, vd], [f_n, f_e, f_d]) = (&truth.velocity_mps, &truth.force_mps2);
    let [roll, pitch, yaw] = &truth.attitude_deg;
    InsSeries {
        tt_s: &truth.tt_s,
        lat_deg: &truth.lat_deg,
        lon_deg: &truth.lon_deg,
        alt_m: &truth.alt_m,
        vn_mps: vn,
        ve_mps: ve,
        vd_mps: vd,
        fn_mps2: f_n,
        fe_mps2: f_e,
        fd_mps2: f_d,
        roll_deg: roll,
        pitch_deg: pitch,
        yaw_deg: yaw,
    }
}
