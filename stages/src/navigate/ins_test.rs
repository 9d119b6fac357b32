//! Test of a track against the error model of the INS.

use numerics::navigation::{
    ins_error::InsErrorModel, ins_only, output::NavigationOutput, position_fixes::PositionFixes,
};
use schemas::{Column, Fault};

use super::{
    Navigate,
    filter::{FilterInput, FilterTrack},
};
use crate::columns::data;

/// Column with the mean squared correction of the INS, divided by the covariance of the INS error.
pub const INS_CORRECTION: &str = "ins_correction";

/// The INS of a line with the covariance of its error, for each error model and each set of GNSS positions.
#[derive(Default)]
pub(super) struct InsTracks(Vec<(InsErrorModel, Option<PositionFixes>, NavigationOutput)>);

impl InsTracks {
    /// Mean over the line of δᵀ P⁻¹ δ, with the horizontal difference δ of a track from the INS and the covariance P of
    /// the INS error without the magnetometer. Its expected value is at most 2.
    ///
    /// # Errors
    /// Fails as [`ins_only::run`].
    pub(super) fn correction(&mut self, flown: &FilterInput, track: &FilterTrack) -> Result<f64, Fault> {
        // The temporal variation does not affect the INS.
        let errors = InsErrorModel { fogm_sigma_nt: 0.0, fogm_tau_s: 1.0, ..flown.errors };
        let place =
            match self.0.iter().position(|(known, fixes, _)| *known == errors && fixes.as_ref() == flown.fixes()) {
                Some(place) => place,
                None => {
                    let alone = ins_only::run(&flown.ins, &errors, flown.fixes()).map_err(data)?;
                    self.0.push((errors, flown.fixes().cloned(), alone));
                    self.0.len() - 1
                }
            };
        let alone = &self.0[place].2;
        let (mut sum, mut count) = (0.0, 0.0);
        for row in 0..flown.ins.len() {
            let (north_m, east_m) =
                errors.earth.north_east_m_per_rad(alone.lat_deg[row].to_radians(), alone.alt_m[row]);
            let north = (track.lat_deg[row] - alone.lat_deg[row]).to_radians() * north_m;
            let east = (track.lon_deg[row] - alone.lon_deg[row]).to_radians() * east_m;
            let (north2, east2, both) = (alone.sd_n_m[row].powi(2), alone.sd_e_m[row].powi(2), alone.cov_ne_m2[row]);
            let determinant = north2 * east2 - both * both;
            let square = (north * north * east2 + east * east * north2 - 2.0 * north * east * both) / determinant;
            if square.is_finite() {
                (sum, count) = (sum + square, count + 1.0);
            }
        }
        Ok(sum / count)
    }
}

impl Navigate {
    /// Whether tracks are tested against the error model of the INS.
    pub(super) fn tests_ins(&self) -> bool {
        self.is_auto() && self.tests_start()
    }

    /// Column of the test.
    pub(super) fn ins_test_column(&self) -> Option<Column> {
        let what = "mean over the line of the squared horizontal correction of the INS, divided by the covariance of the INS \
                    error without the magnetometer; expected value at most 2";
        self.tests_ins().then(|| Column::float(INS_CORRECTION, "1", what))
    }
}

#[cfg(test)]
mod tests {
    use crate::navigate::testing::*;

    #[test]
    fn law_a_start_with_too_small_sigmas_is_contradicted_by_the_corrections() {
        // INS errors of 10 m and 0.15 m/s north and 0.2 m/s east.
        let of = |position_m: f64, velocity_mps: f64| {
            let keys = format!(
                "mag = 'mag_1_c'\ntuning = 'auto'\nstart = 'given'\ninit_position_sigma_m = {position_m:?}\n\
                 init_velocity_sigma_mps = {velocity_mps:?}\nmeasurement_sigma_nt = 5.0"
            );
            run("ekf", &keys).numbers("ins_correction")[0]
        };
        let (right, wrong) = (of(20.0, 0.2), of(0.5, 0.005));
        assert!(right < 4.0 && wrong > 20.0, "{right} {wrong}");
    }
}
