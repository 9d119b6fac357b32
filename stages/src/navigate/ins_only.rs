//! The INS without magnetic measurements.

use numerics::navigation::{ins_only, output::NavigationOutput};
use schemas::Fault;

use super::aiding::Aiding;
use super::filter::{FilterInput, FilterTrack, NavigationFilter, UpdateOutcome, filter};
use crate::columns::data;

filter! {
    /// The INS without magnetic measurements: the baseline for the other filters. The covariance follows from the error
    /// sources of the INS. The filter uses neither `mag` nor a map, so `residual` and `nis` are NaN and `update` is
    /// `unused`. With `gnss_lost_s`, GNSS aids the INS before the loss and after the recovery.
    InsOnly = "ins_only", version 1, groups [aiding: Aiding], example "";
}

impl NavigationFilter for InsOnly {
    fn takes_field(&self) -> bool {
        false
    }

    fn needs_map(&self) -> bool {
        false
    }

    fn takes_map(&self) -> bool {
        true
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        let out: NavigationOutput = ins_only::run(&flown.ins, &flown.errors, flown.fixes()).map_err(data)?;
        let update = vec![UpdateOutcome::Unused; flown.ins.len()];
        Ok(FilterTrack { update, ..FilterTrack::without_updates(out) })
    }
}

#[cfg(test)]
mod tests {
    use crate::navigate::testing::*;

    #[test]
    fn unit_the_track_equals_the_ins_and_the_covariance_grows() {
        let found = run("ins_only", "");
        assert!(planned("ins_only", "mag = 'nowhere'").is_ok() && planned("ekf", "mag = 'nowhere'").is_err());
        // INS errors of 10 m and 0.15 m/s north and 0.2 m/s east, after 599 s.
        let expected = (10.0 + 0.15 * 599.0_f64).hypot(0.2 * 599.0);
        assert!((found.error_m(ROWS - 1) - expected).abs() < 0.5, "{}", found.error_m(ROWS - 1));
        assert_eq!(found.updates("unused"), ROWS);
        assert!(found.numbers("residual").iter().chain(&found.numbers("nis")).all(|x| x.is_nan()));
        let sd = found.numbers("sd_n");
        assert!((sd[0] - 20.0).abs() < 1e-6 && sd[ROWS - 1] > 100.0);
    }

    #[test]
    fn unit_gnss_bounds_the_error_until_its_loss() {
        let found = run("ins_only", "mag = 'mag_1_c'\ngnss_lost_s = [400.0, 1e6]\ngnss_sigma_m = 3.0");
        assert!(found.error_m(399) < 3.0, "{}", found.error_m(399));
        // When GNSS is lost, the drift is known to a few mm/s.
        assert!(found.error_m(ROWS - 1) < 20.0, "{}", found.error_m(ROWS - 1));
        assert!(found.numbers("sd_n")[ROWS - 1] > found.numbers("sd_n")[399]);
        assert_refused("ins_only", "gnss_lost_s = [400.0, 300.0]", "recovered earlier");
        assert_refused("ins_only", "gnss_lost_s = [0.0, 300.0]\ngnss = ['lat', 'lon', 'height']", "height");
    }
}
