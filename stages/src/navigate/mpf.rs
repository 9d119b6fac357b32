//! The marginalised particle filter.

use arrow_array::ArrayRef;
use numerics::navigation::{
    line::NavigationLine,
    mpf::{MpfOutput, MpfParameters, PositionMode, run},
};
use schemas::{Column, Fault, Rule};

use super::aiding::{Aiding, both};
use super::filter::{FilterFlight, FilterInput, FilterTrack, NavigationFilter, filter};
use super::further::{AuxiliaryMeasurements, updates};
use crate::columns::{array, data, list};

/// Number of modes in the column `modes`. A mode has at least 1 % of the weight; more than three modes are a diffuse
/// cloud.
const MODES: usize = 3;
/// Smallest number of particles that KLD-sampling may select.
pub(super) const LEAST_PARTICLES: usize = 3000;
/// Values per mode.
const MODE_NAMES: [&str; 6] = ["weight", "lat", "lon", "sd_n", "sd_e", "cov_ne"];

filter! {
    /// The marginalised particle filter: particles for the horizontal position, and one Kalman filter for the other 16
    /// states given the position. Use it on a map with several similar places; `save_modes` returns the probability of
    /// each place. For a navigation-grade INS, `ekf` is as accurate, and seventy times as fast as `mpf` with
    /// 1000 particles. For an INS position error of kilometres, `mpf_then_ekf` is faster.
    ///
    /// The estimate is the mean over all particles. A measurement does not change the share of the total weight that
    /// belongs to particles off the map. A sample is `off_map` if particles on the map have less than a tenth of the
    /// total weight. A measurement outside six standard deviations of every particle is `gated`, regardless of
    /// `gate_nis`. Many such measurements in a row mean that the particles have lost the aircraft. The line is rejected
    /// when most of its measurements are gated in this way.
    ///
    /// The biases of additional measurements and the map error are linear states of each particle. The weights depend
    /// on the values of the map, not on its slope, so `flat_over_m` is rejected; use `map_sigma_nt` for the map error.
    ///
    /// Source: Schön, Gustafsson & Nordlund 2005; resampling from a kernel density (Musso, Oudjane & Le Gland 2001)
    /// that is also marginalised over the linear states. The same seed gives bit-identical results on any number of
    /// threads.
    Mpf = "mpf", version 3, groups [aiding: Aiding, further: AuxiliaryMeasurements], example "particles = 2000";
    /// Number of particles. Use 3000 if the INS position is known to within hundreds of metres. Use 10,000 if the INS
    /// position is uncertain by kilometres, or with a measurement as precise as `gradient`.
    particles: Option<usize>, unit "1",
        absent "3000 to 50,000, by KLD-sampling (Fox 2003) over squares of side `smooth_over_m`; the \
            column `particles` is then appended",
        rule Rule::Between(1.0, 1000000.0);
    /// Seed of all random draws. The same seed gives bit-identical results on any number of threads.
    seed: usize, unit "", default 0usize;
    /// The particles are resampled when their effective number falls below this fraction of their number. 0.5 is usual;
    /// a larger value (0.8 in MagNav.jl) resamples more often and only adds noise.
    resample_threshold: f64, unit "1", default 0.5, rule Rule::Between(0.0, 1.0);
    /// Resamples from a kernel density. The position error of a good INS has almost no process noise, so without the
    /// kernel density only copies of a few particles remain. The covariance is then far too small.
    regularise: bool, unit "", default true;
    /// Distance over which the map is nearly linear; typically the height of the map above the sources. A wider cloud
    /// of particles is divided into parts with one kernel each. With `gradient`, set a third of this distance, over
    /// which the slope of the map is nearly linear.
    smooth_over_m: f64, unit "m", default 200.0, rule Rule::Positive;
    /// Standard deviation, per axis, of position noise that is added to each resampled particle. The unit is the range
    /// of the particles divided by the square root of their number. Gordon, Salmond & Smith 1993 use 0.2.
    roughening: f64, unit "1", default 0.0, rule Rule::NotNegative;
    /// Largest accepted NIS of a measurement. The NIS is computed from the mean and variance of the whole cloud of
    /// particles.
    gate_nis: Option<f64>, unit "1",
        absent "no gate; with `tuning = \"auto\"`, outliers are rejected before filtering", rule Rule::Positive;
    /// Appends the three most probable modes of the position to each sample. The run time of the filter then increases
    /// by 50 %.
    save_modes: bool, unit "", default false;
}

impl NavigationFilter for Mpf {
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
        let mut columns = vec![effective_column()];
        columns.extend(self.particles.is_none().then(particles_column));
        if self.save_modes {
            let names = (1..=MODES).flat_map(|k| MODE_NAMES.iter().map(move |name| format!("{name}_{k}"))).collect();
            let what = "probability, position (deg), standard deviations north and east (m) and covariance (m2) of the \
                        modes of the position, the most probable first; NaN for absent modes";
            columns.push(Column::list("modes", "", what, names));
        }
        columns
    }

    fn reads(&self, _: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        both(self.further.no_scalar_states(), self.further.no_flat())
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        (key == "smooth_over_m" && !self.regularise)
            .then(|| Fault::new("`smooth_over_m` has no effect without `regularise`"))
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        let parameters = MpfParameters {
            particles: self.particles.unwrap_or(LEAST_PARTICLES),
            adapt: self.particles.is_none(),
            seed: self.seed as u64,
            resample_threshold: self.resample_threshold,
            regularise: self.regularise,
            smooth_over_m: self.smooth_over_m,
            roughening: self.roughening,
            gate_nis: self.gate_nis,
            modes_every: self.save_modes.then_some(1),
            keep_states: false,
            keep_covariance: false,
        };
        flown.reject_wide_offset()?;
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line()? };
        let measured = self.further.measured(flown)?;
        let out = run(&parameters, &line, &self.further.aids(flown, &measured)?).map_err(data)?;
        reject_lost(&out)?;
        let MpfOutput { track, effective, particles, usage, aids, modes, .. } = out;
        self.further.enough(flown, &track.report)?;
        let mut more = vec![array(effective)];
        more.extend(self.particles.is_none().then(|| number_of(&particles)));
        if self.save_modes {
            let numbers = modes.iter().flat_map(|at| columns_of(&at.modes)).collect();
            more.push(list(numbers, MODES * MODE_NAMES.len())?);
        }
        more.extend(self.further.arrays(aids, vec![]));
        Ok(FilterTrack { update: updates(&usage), more, ..FilterTrack::without_updates(track) })
    }
}

/// Column of the effective number of particles.
pub(super) fn effective_column() -> Column {
    Column::float("n_eff", "1", "effective number of particles before resampling")
}

/// Column of the number of particles.
pub(super) fn particles_column() -> Column {
    Column::float("particles", "1", "number of particles before resampling")
}

/// Array of the number of particles.
pub(super) fn number_of(particles: &[usize]) -> ArrayRef {
    array(particles.iter().map(|count| *count as f64).collect())
}

/// Rejects a line whose measurements mostly contradict every particle.
pub(super) fn reject_lost(out: &MpfOutput) -> Result<(), Fault> {
    let (unexplained, usable) = (out.report.unexplained, out.track.report.updates + out.track.report.gated);
    if 2 * unexplained <= usable {
        return Ok(());
    }
    let what = format!("{unexplained} of {usable} measurements contradict every particle: the aircraft is lost");
    let help = "increase `particles` or `init_position_sigma_m`, or set `offset_window_s`";
    Err(Fault::data(what).help(help))
}

/// Values of the most probable modes; NaN for modes that do not exist.
fn columns_of(modes: &[PositionMode]) -> Vec<f64> {
    let mut numbers = vec![];
    for k in 0..MODES {
        numbers.extend(modes.get(k).map_or([f64::NAN; 6], |mode| {
            [mode.weight, mode.lat_deg, mode.lon_deg, mode.sd_n_m, mode.sd_e_m, mode.cov_ne_m2]
        }));
    }
    numbers
}

#[cfg(test)]
mod tests {
    use crate::navigate::testing::*;

    #[test]
    fn unit_it_corrects_the_ins_and_returns_its_modes() {
        let found = run("mpf", "mag = 'mag_1_c'\nparticles = 500\nsave_modes = true");
        assert!(found.error_m(ROWS - 1) < 40.0, "{}", found.error_m(ROWS - 1));
        let effective = found.numbers("n_eff");
        assert!(effective.iter().all(|n| (1.0 - 1e-9..=500.0 + 1e-6).contains(n)));
        let first_weight: Vec<f64> = found.numbers("modes").chunks(18).map(|modes| modes[0]).collect();
        assert!(first_weight.iter().all(|weight| *weight > 0.3 && *weight < 1.0 + 1e-9));
        assert_eq!(found.numbers("lat"), run("mpf", "mag = 'mag_1_c'\nparticles = 500").numbers("lat"));
        assert_ne!(found.numbers("lat"), run("mpf", "mag = 'mag_1_c'\nparticles = 500\nseed = 3").numbers("lat"));
    }

    #[test]
    fn unit_a_lost_aircraft_is_an_error() {
        let elsewhere = with(&flight(), "mag_1_c", |row, nt| nt + 400.0 * (row as f64 / 9.0).sin());
        let fault = flown("mpf", "mag = 'mag_1_c'\nparticles = 200", &elsewhere).unwrap_err();
        assert!(fault.what.contains("the aircraft is lost") && fault.help.is_some(), "{fault:?}");
        assert_refused("mpf", "regularise = false\nsmooth_over_m = 50.0", "no effect without `regularise`");
        assert_refused("mpf", "particles = 0", "particles");
    }
}
