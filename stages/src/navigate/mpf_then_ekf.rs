//! Particle filter until a single position remains, then the extended Kalman filter.

use numerics::navigation::{
    line::NavigationLine,
    mpf::{HandOver, MpfParameters, run_then_ekf},
};
use schemas::{Column, Fault, Rule};

use super::aiding::{Aiding, both};
use super::filter::{FilterFlight, FilterInput, FilterTrack, NavigationFilter, filter};
use super::further::{AuxiliaryMeasurements, updates};
use super::mpf::{LEAST_PARTICLES, effective_column, number_of, particles_column, reject_lost};
use crate::columns::{array, data};

filter! {
    /// The marginalised particle filter `mpf` until a single position remains, then the extended Kalman filter `ekf`.
    /// Use it if the initial position is known only to kilometres. In this case, `ekf` may diverge unnoticed, and `mpf`
    /// takes far longer because it uses particles along the whole line.
    ///
    /// The hand-over to the Kalman filter occurs when two conditions have held for 60 s. First, the weight of one mode
    /// of the particles must be at least `hand_over_weight`. Second, the map's linearisation error over the spread of
    /// this mode (median over the next minute of the path) must be smaller than the white noise. The mean and
    /// covariance of the mode become the initial state and covariance of the Kalman filter. From then on `particles` is
    /// 0 and `n_eff` is NaN. If the conditions are never met on a line, all samples come from `mpf`.
    ///
    /// With `tuning = "auto"` and a large initial position error, the noise is estimated in three steps. First,
    /// particles with an assumed slow error of 30 nT locate the aircraft. Second, the INS is corrected with this
    /// position and velocity. Third, the likelihood of the innovations along the corrected INS track gives the noise
    /// and the outliers. In the first step, a spike is rejected only if it contradicts every particle. Therefore remove
    /// spikes in the first minutes of the line with `despike`.
    ///
    /// `flat_over_m` is rejected, as for `mpf`.
    ///
    /// Source: Schön, Gustafsson & Nordlund 2005 for the particles; Fox 2003 for their number.
    MpfThenEkf = "mpf_then_ekf", version 2, groups [aiding: Aiding, further: AuxiliaryMeasurements],
    example "particles = 2000";
    /// Number of particles.
    particles: Option<usize>, unit "1",
        absent "3000 to 50,000, by KLD-sampling (Fox 2003) over squares of side `smooth_over_m`",
        rule Rule::Between(1.0, 1000000.0);
    /// Seed of all random draws. The same seed gives bit-identical results on any number of threads.
    seed: usize, unit "", default 0usize;
    /// Distance over which the map is nearly linear; typically the height of the map above the sources. A wider cloud
    /// of particles is divided into parts with one kernel each.
    smooth_over_m: f64, unit "m", default 200.0, rule Rule::Positive;
    /// Minimum weight of the most probable mode at the hand-over.
    hand_over_weight: f64, unit "1", default 0.99, rule Rule::Between(0.5, 1.0);
    /// Largest accepted NIS of a measurement. Before the hand-over, the NIS is computed from the mean and variance of
    /// the whole cloud of particles.
    gate_nis: Option<f64>, unit "1",
        absent "no gate; with `tuning = \"auto\"`, outliers are rejected before filtering", rule Rule::Positive;
}

impl NavigationFilter for MpfThenEkf {
    fn takes_wide_start(&self) -> bool {
        true
    }

    fn gates(&self) -> bool {
        self.gate_nis.is_some()
    }

    fn effort(&self) -> f64 {
        self.particles.unwrap_or(LEAST_PARTICLES) as f64
    }

    fn columns(&self, _: &FilterFlight) -> Vec<Column> {
        vec![effective_column(), particles_column()]
    }

    fn reads(&self, _: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        both(self.further.no_scalar_states(), self.further.no_flat())
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        let parameters = MpfParameters {
            particles: self.particles.unwrap_or(LEAST_PARTICLES),
            adapt: self.particles.is_none(),
            seed: self.seed as u64,
            smooth_over_m: self.smooth_over_m,
            gate_nis: self.gate_nis,
            ..MpfParameters::default()
        };
        flown.reject_wide_offset()?;
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line()? };
        let measured = self.further.measured(flown)?;
        let conditions = HandOver { weight: self.hand_over_weight };
        let aids = self.further.aids(flown, &measured)?;
        let out = run_then_ekf(&parameters, &line, &aids, &conditions).map_err(data)?.all;
        reject_lost(&out)?;
        self.further.enough(flown, &out.track.report)?;
        let mut more = vec![array(out.effective), number_of(&out.particles)];
        more.extend(self.further.arrays(out.aids, vec![]));
        Ok(FilterTrack { update: updates(&out.usage), more, ..FilterTrack::without_updates(out.track) })
    }
}

#[cfg(test)]
mod tests {
    use crate::navigate::testing::*;

    /// The flight with an INS whose position is off by `north_m` and `east_m`.
    fn lost(north_m: f64, east_m: f64) -> arrow_array::RecordBatch {
        let flight = with(&flight(), "ins_lat", |_, lat| lat + north_m / 111_130.0);
        with(&flight, "ins_lon", |_, lon| lon + east_m / (111_130.0 * 45_f64.to_radians().cos()))
    }

    const WIDE: &str = "mag = 'mag_1_c'\nmap_interpolation = 'cubic'\ninit_position_sigma_m = 600.0\n";

    #[test]
    fn unit_a_wide_start_is_handed_over_to_the_kalman_filter() {
        let found = flown("mpf_then_ekf", WIDE, &lost(500.0, -400.0)).unwrap();
        let particles = found.numbers("particles");
        let row = particles.iter().position(|count| *count == 0.0).unwrap();
        assert!((60..300).contains(&row) && particles[0] >= 1000.0, "{row} {}", particles[0]);
        assert!(particles[row..].iter().all(|count| *count == 0.0) && found.numbers("n_eff")[row].is_nan());
        assert!(found.error_m(ROWS - 1) < 30.0, "{}", found.error_m(ROWS - 1));
        assert!(found.numbers("sd_n")[0] > 100.0 && found.numbers("sd_n")[ROWS - 1] < 30.0);
        assert_eq!(found.updates("used"), ROWS);
    }

    #[test]
    fn unit_noise_and_outliers_of_a_wide_start_are_those_of_a_known_start() {
        let auto = "tuning = 'auto'\nstart = 'given'\nmeasurement_sigma_nt = 1.5\nfogm_tau_s = 600.0\n\
                    init_velocity_sigma_mps = 0.3\ncore_field = false\n";
        let keys = format!("{WIDE}{auto}");
        // One measurement in fifty is a spike, after the particles have found the position.
        let spikes = |row: usize, nt: f64| if row > 300 && row % 50 == 30 { nt + 80.0 } else { nt };
        let known =
            flown_on("ekf", &format!("{keys}init_position_sigma_m = 20.0"), &with(&flight(), "mag_1_c", spikes));
        let wide = flown_on("mpf_then_ekf", &keys, &with(&lost(500.0, -400.0), "mag_1_c", spikes));
        let (known, wide) = (known.unwrap(), wide.unwrap());
        let fogm = |of: &NavigateOutput| of.numbers("noise_fogm_sigma")[0];
        // One step of the search is a factor of 1.12.
        assert!((fogm(&wide) / fogm(&known)).ln().abs() < 0.5, "{} {}", fogm(&wide), fogm(&known));
        assert_eq!((wide.updates("gated"), known.updates("gated")), (6, 6));
        assert!(wide.error_m(ROWS - 1) < 30.0, "{}", wide.error_m(ROWS - 1));
    }

    #[test]
    fn unit_an_offset_at_an_unknown_position_is_rejected() {
        let fault = flown("mpf_then_ekf", &format!("{WIDE}offset_window_s = 5.0"), &flight()).unwrap_err();
        assert!(fault.what.contains("known only to 600 m") && fault.help.is_some(), "{fault:?}");
        assert!(flown("mpf_then_ekf", "mag = 'mag_1_c'\noffset_window_s = 5.0", &flight()).is_ok());
        assert_refused("mpf_then_ekf", "flat_over_m = 10.0", "not available");
        assert_refused("mpf_then_ekf", "hand_over_weight = 0.3", "hand_over_weight");
    }

    #[test]
    fn unit_a_filter_that_linearises_the_map_reports_a_wide_start() {
        let of = |filter: &str, keys: &str| {
            let found = run(filter, &format!("mag = 'mag_1_c'\nmap_interpolation = 'cubic'\n{keys}"));
            [found.numbers("start_sigma")[0], found.numbers("start_sigma_limit")[0]]
        };
        let [sigma, limit] = of("ekf", "");
        // The map is a sum of waves with lengths of 2.7 and 3.1 km. At a distance of a twentieth of a wavelength, the
        // linearisation error reaches a third of the linear change.
        assert!((sigma - 20.0).abs() < 0.1 && (80.0..300.0).contains(&limit), "{sigma} {limit}");
        for filter in ["iekf", "ukf", "ekf_adaptive", "rts"] {
            let [wide, same] = of(filter, "init_position_sigma_m = 600.0");
            assert!((wide / 600.0 - 1.0).abs() < 0.01 && (same / limit - 1.0).abs() < 0.05, "{filter} {wide} {same}");
        }
        for filter in ["mpf", "mpf_then_ekf", "crlb", "ins_only", "slam"] {
            let columns = planned(filter, "mag = 'mag_1_c'");
            let has = columns.is_ok_and(|columns| columns.iter().any(|column| column.name == "start_sigma"));
            assert!(!has, "{filter}");
        }
    }
}
