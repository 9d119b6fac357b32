//! What the spec says of the INS.

use stages::numerics::ins_error::InsErrorModel;

use super::super::spec::section::{Need, Section};

/// The INS; its temporal variation is the spec's own `diurnal`.
pub(in super::super) fn ins(root: &Section) -> InsErrorModel {
    let mut m = InsErrorModel { fogm_sigma_nt: 0.0, ..InsErrorModel::default() };
    let Some(s) = root.section("ins") else { return m };
    let sigmas: [(&'static str, &mut f64); 11] = [
        ("init_position_sigma_m", &mut m.init_position_sigma_m),
        ("init_altitude_sigma_m", &mut m.init_altitude_sigma_m),
        ("init_velocity_sigma_mps", &mut m.init_velocity_sigma_mps),
        ("init_attitude_sigma_deg", &mut m.init_attitude_sigma_deg),
        ("vrw_sigma", &mut m.vrw_sigma),
        ("arw_sigma", &mut m.arw_sigma),
        ("baro_sigma_m", &mut m.baro_sigma_m),
        ("ha_sigma_m", &mut m.ha_sigma_m),
        ("a_hat_sigma_mps2", &mut m.a_hat_sigma_mps2),
        ("acc_sigma_mps2", &mut m.acc_sigma_mps2),
        ("gyro_sigma_radps", &mut m.gyro_sigma_radps),
    ];
    for (key, value) in sigmas {
        *value = s.number(key, *value, Need::NotNegative);
    }
    for (key, value) in
        [("baro_tau_s", &mut m.baro_tau_s), ("acc_tau_s", &mut m.acc_tau_s), ("gyro_tau_s", &mut m.gyro_tau_s)]
    {
        *value = s.number(key, *value, Need::Positive);
    }
    s.finish();
    m
}
