//! The marginalised particle filter.

use numerics::navigation::{
    line::NavigationLine,
    mpf::{Mode, MpfOutput, MpfParameters, run},
};
use schemas::{Column, Fault, Rule};

use super::aiding::{Aiding, both};
use super::filter::{Flight, Flown, NavigationFilter, Track, filter};
use super::further::{Further, updates};
use crate::columns::{array, data, list};

/// Modes in the columns of `modes`; a mode has at least a hundredth of the weight, and more than three are a cloud.
const MODES: usize = 3;
/// Numbers of a mode.
const MODE_NAMES: [&str; 6] = ["weight", "lat", "lon", "sd_n", "sd_e", "cov_ne"];

filter! {
    /// The marginalised particle filter: particles for the position, a Kalman filter given the position for the other
    /// 16 states. Use it for an INS lost by kilometres (`init_position_sigma_m`, with 10000 particles) or over a map
    /// that is alike in several places: with `save_modes` it hands out the probability of each. A nominal INS is as
    /// well served by `ekf`, seventy times as fast.
    ///
    /// The estimate is the mean over all particles. A particle off the map keeps its weight relative to the others
    /// together; a sample with less than a tenth of the weight on the map is `off_map`. A measurement that no particle
    /// explains to six sigma is `gated`, whatever `gate_nis`: many in a row mean that the particles have lost the
    /// aircraft, and the line is refused when most of its measurements are.
    ///
    /// Of further measurements each particle holds the biases, and the map's error, as it does the linear states. The
    /// particles weigh by the map's values and not by its slope, so that `flat_over_m` is refused: `map_sigma_nt` says what
    /// the map errs by.
    ///
    /// Source: Schön, Gustafsson & Nordlund (2005), resampled from a kernel density (Musso, Oudjane & Le Gland 2001)
    /// whose part in the linear states is marginalised too. Seeded; the same bits on any number of threads.
    Mpf = "mpf", version 1, groups [aiding: Aiding, further: Further], example "particles = 2000";
    /// The number of particles: 1000 for an INS known to hundreds of metres, 10000 for one lost by kilometres, and with a
    /// measurement as sharp as `gradient`.
    particles: usize, unit "1", default 1000usize, rule Rule::Between(1.0, 1000000.0);
    /// Where the draws begin; the same seed gives the same bits on any number of threads.
    seed: usize, unit "", default 0usize;
    /// Resample when the effective number of particles falls below this part of their number. 0.5 is usual; more often
    /// (MagNav.jl: 0.8) only adds noise.
    resample_threshold: f64, unit "1", default 0.5, rule Rule::Between(0.0, 1.0);
    /// Resample from a kernel density. Without it a good INS, whose position error is driven by next to no noise,
    /// leaves copies of a few particles and a covariance far too small.
    regularise: bool, unit "", default true;
    /// A distance over which the map is nearly linear, about its height above the sources: a wider cloud has a kernel
    /// for each of its parts. The slope that `gradient` measures is so over a third of that.
    smooth_over_m: f64, unit "m", default 200.0, rule Rule::Positive;
    /// Noise for the position of each resampled particle, by axis, in ranges of the particles over the root of their
    /// number; Gordon, Salmond & Smith (1993) use 0.2.
    roughening: f64, unit "1", default 0.0, rule Rule::NotNegative;
    /// A measurement whose squared innovation over its variance, both of the whole cloud, is above this is not used.
    gate_nis: Option<f64>, unit "1", absent "outliers are rejected before the filter, or none with `tuning = \"magnav\"`", rule Rule::Positive;
    /// Append the three heaviest modes of the position to each sample. Takes half as long again.
    save_modes: bool, unit "", default false;
}

impl NavigationFilter for Mpf {
    fn gates(&self) -> bool {
        self.gate_nis.is_some()
    }

    fn effort(&self) -> f64 {
        self.particles as f64
    }

    fn columns(&self, _: &Flight) -> Vec<Column> {
        let mut columns = vec![Column::float("n_eff", "1", "effective number of particles, before resampling")];
        if self.save_modes {
            let names = (1..=MODES).flat_map(|k| MODE_NAMES.iter().map(move |name| format!("{name}_{k}"))).collect();
            let what = "probability, position (deg), one sigma north and east (m) and their covariance (m2) of the \
                        modes of the position, the most probable first; NaN where there are fewer";
            columns.push(Column::list("modes", "", what, names));
        }
        columns.extend(self.further.columns());
        columns
    }

    fn reads(&self, flight: &Flight) -> Result<Vec<String>, Vec<Fault>> {
        let flat = self.further.flat_over_m.map(|_| {
            let what = "particles weigh by the map's values, not by its slope: none is too flat";
            Fault::new(what).of_param("flat_over_m").help("say what the map errs by, `map_sigma_nt`")
        });
        let flat = flat.map_or(Ok(vec![]), |fault| Err(vec![fault]));
        both(both(self.aiding.reads(flight), both(self.further.reads(flight), self.further.no_latency())), flat)
    }

    fn takes_field(&self) -> bool {
        self.further.use_scalar
    }

    fn takes_direction(&self) -> bool {
        self.further.takes_direction()
    }

    fn aiding(&self) -> Option<&Aiding> {
        Some(&self.aiding)
    }

    fn idle(&self, key: &str) -> Option<Fault> {
        (key == "smooth_over_m" && !self.regularise)
            .then(|| Fault::new("`smooth_over_m` has no say without `regularise`"))
            .or_else(|| self.aiding.idle(key))
            .or_else(|| self.further.idle(key))
    }

    fn navigate(&self, flown: &Flown) -> Result<Track, Fault> {
        let parameters = MpfParameters {
            particles: self.particles,
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
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line()? };
        let measured = self.further.measured(flown)?;
        let out = run(&parameters, &line, &self.further.aids(flown, &measured)?).map_err(data)?;
        let MpfOutput { track, effective, usage, aids, modes, report } = out;
        let usable = track.report.updates + track.report.gated;
        if 2 * report.unexplained > usable {
            let unexplained = report.unexplained;
            let what = format!("no particle explains {unexplained} of {usable} measurements: the aircraft is lost");
            let help = "more `particles`, a wider `init_position_sigma_m`, or an `offset_window_s`";
            return Err(Fault::data(what).help(help));
        }
        self.further.enough(flown, &track.report)?;
        let mut more = vec![array(effective)];
        if self.save_modes {
            let numbers = modes.iter().flat_map(|at| columns_of(&at.modes)).collect();
            more.push(list(numbers, MODES * MODE_NAMES.len())?);
        }
        more.extend(self.further.arrays(aids, Default::default(), vec![]));
        Ok(Track { update: updates(&usage), more, ..Track::without_updates(track) })
    }
}

/// The numbers of the first modes.
fn columns_of(modes: &[Mode]) -> Vec<f64> {
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
    fn law_it_corrects_the_ins_and_tells_its_modes() {
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
    fn law_a_lost_aircraft_is_an_error() {
        let elsewhere = with(&flight(), "mag_1_c", |row, nt| nt + 400.0 * (row as f64 / 9.0).sin());
        let fault = flown("mpf", "mag = 'mag_1_c'\nparticles = 200", &elsewhere).unwrap_err();
        assert!(fault.what.contains("the aircraft is lost") && fault.help.is_some(), "{fault:?}");
        assert_refused("mpf", "regularise = false\nsmooth_over_m = 50.0", "no say without `regularise`");
        assert_refused("mpf", "particles = 0", "particles");
    }
}
