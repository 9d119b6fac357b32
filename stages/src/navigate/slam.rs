//! Navigation without a map.

use std::sync::Arc;

use arrow_array::StringArray;
use numerics::navigation::ins_error::InsErrorModel;
use numerics::navigation::{
    slam::{
        Covariance, ExpectedMeasurement, HyperparameterSource, IMPLAUSIBLE, Kernel, SlamLine, SlamParameters,
        SlamReport, SmootherParameters, SmootherReport, run, smoother::CONTRADICTED,
    },
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::aiding::Aiding;
use super::filter::{Flight, Flown, NavigationFilter, Track, Update, filter};
use crate::columns::{array, data};

filter! {
    /// Navigation without a map: each particle's own path with the measurements along it is its map, and a particle counts
    /// by how well the earlier measurements predict the present one where it crosses or follows its earlier path. It holds
    /// an INS that drifts on flights that come back to where they were: loiters, surveys with tie lines. Only the position
    /// relative to the earlier path is observed, so that what the INS errs until the first revisit stays; without a revisit
    /// the track is that of the INS. The map of the stage is not looked at, nor is `offset_window_s`: a constant in the
    /// measurement is part of the unknown map. `unused` in the column `update` means that nobody has been near before.
    ///
    /// The same `seed` gives the same bits on any number of threads.
    ///
    /// With `gnss_lost_s` positions by GNSS aid it where there are any. A map that begins under GNSS is where it says; a later
    /// fix counts particles by their whole path, so that it corrects the map too. GNSS at first does not spare particles: of
    /// ten surveys all were held with 400 of them, and two of six were lost with 150, by a covariance far too small.
    ///
    /// With `smooth` the track is the most probable one of the whole flight, given all of its measurements, for after the
    /// flight: a smoother that begins at the track of the particles, and is off by metres where they are off by tens. The
    /// error of the INS over a flight is a few smooth functions of time, of which every crossing tells, while the history of a
    /// particle is what it is; so that few particles are enough. `residual`, `nis`, `revisiting` and `effective` stay those
    /// of the particles. `smoothing` is `converged`, or `stopped` where path and hyper-parameters still moved at the end, or
    /// `none` where the track is that of the particles: fewer than two measurements, or a singular covariance.
    /// `smoothing_misfit` is far above 1 where the noise is told too small for the track. `smoothing_agreement` is
    /// what visits of the same places tell of each other, over what they would tell with the noise told: about 1 on a right track, near
    /// 0 on one that is lost by hundreds of metres. A line below 0.5 is refused; NaN where next to nothing is visited
    /// again. 1000 measurements take about twenty
    /// seconds of a core and 70 MB, twice as many eight times that and four times that.
    ///
    /// Source: thesis 001, chapters III and V and appendix A; with the last measurements in every prediction, which makes the
    /// product of the weights the likelihood of the flight [Vecchia 1988], with the temporal variation in the covariance, with
    /// paths shared in a tree, so that a step costs the same after ten hours, and resampled from a kernel density (Musso,
    /// Oudjane & Le Gland 2001), whose loss of variance stays in the covariance. The smoother: the likelihood of a Gaussian
    /// process at uncertain places (Lawrence 2003), with the covariance of the error model as prior of the places, and
    /// Laplace's approximation of its covariance.
    Slam = "slam", version 2, groups [aiding: Aiding], example "particles = 1000";
    /// The number of particles. The drift between revisits has to be covered densely: more for a poorer INS.
    particles: usize, unit "1", default 1000usize, rule Rule::Between(2.0, 1e6);
    /// The seed of every draw.
    seed: usize, unit "", default 0usize;
    /// Particles are moved and weighted at most this often; measurements in between are averaged. 0 takes every sample.
    update_interval_s: f64, unit "s", default 1.0, rule Rule::NotNegative;
    /// How a measurement is predicted from the earlier ones: from the nearest and the last ones (`"nearest_neighbour"`), by
    /// the regression of the thesis (`"regression"`), or by inverse distance (`"inverse_distance"`).
    expected_measurement: ExpectedMeasurement, unit "", default ExpectedMeasurement::NearestNeighbour;
    /// Whether the three hyper-parameters are fitted to the first part of the flight by maximum likelihood, or are as given.
    hyperparameters: HyperparameterSource, unit "", default HyperparameterSource::Fitted;
    /// How the covariance of the anomaly falls with distance.
    covariance: Covariance, unit "", default Covariance::Matern52;
    /// Standard deviation of the anomaly.
    sigma_se_nt: Option<f64>, unit "nT", absent "50 nT, the value of the flight over Louisa", rule Rule::Positive;
    /// Correlation length of the anomaly.
    length_m: Option<f64>, unit "m", absent "150 m, as above", rule Rule::Positive;
    /// What of the anomaly is white, beside the noise of the measurement.
    sigma_n_nt: Option<f64>, unit "nT", absent "1 nT, as above", rule Rule::NotNegative;
    /// The first part of the flight that the hyper-parameters are fitted to.
    fit_window_s: f64, unit "s", default 600.0, rule Rule::Positive;
    /// The most earlier samples that a prediction is made of.
    neighbours: usize, unit "1", default 12usize, rule Rule::Between(1.0, 20.0);
    /// Samples before the last so many seconds are earlier ones.
    ignore_s: f64, unit "s", default 30.0, rule Rule::NotNegative;
    /// More than `trigger_points` earlier samples within this radius make a revisit.
    trigger_radius_m: Option<f64>, unit "m", absent "18 m, or 1.6 times the distance between samples", rule Rule::Positive;
    /// See `trigger_radius_m`.
    trigger_points: usize, unit "1", default 2usize;
    /// The radius of the earlier samples that a prediction is made of.
    interpolation_radius_m: Option<f64>, unit "m",
        absent "half a length of the covariance, at most 0.4 of what is flown in `ignore_s`", rule Rule::Positive;
    /// Earlier samples whose height differs by more are not used; smaller differences add to their variance.
    max_height_difference_m: f64, unit "m", default 100.0, rule Rule::NotNegative;
    /// Standard deviation of a prediction by inverse distance.
    interpolant_sigma_nt: f64, unit "nT", default 10.0, rule Rule::Positive;
    /// Particles are resampled when their effective number falls below this fraction of all.
    resample_below: f64, unit "1", default 0.5, rule Rule::Between(0.0, 1.0);
    /// A measurement whose squared innovation over its variance is above this is not used.
    gate_nis: Option<f64>, unit "1", absent "outliers are rejected before the filter, or none with `tuning = \"magnav\"`", rule Rule::Positive;
    /// The most probable track of the whole flight in place of the particles' one.
    smooth: bool, unit "", default false;
    /// The most measurements that the smoother looks at; of more, each is the mean of a few neighbours, and others are left
    /// out. The work grows with their third power.
    smooth_measurements: usize, unit "1", default 1000usize, rule Rule::Between(2.0, 5000.0);
    /// White noise of a measurement as the smoother is told it, where the particles are told more for being few.
    smooth_sigma_nt: Option<f64>, unit "nT", absent "that of the particles", rule Rule::Positive;
    /// How the process noise becomes a step's covariance: to second order, to first order as MagNav.jl, or exactly.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
}

impl NavigationFilter for Slam {
    fn gates(&self) -> bool {
        self.gate_nis.is_some()
    }

    fn needs_map(&self) -> bool {
        false
    }

    fn takes_map(&self) -> bool {
        true
    }

    fn columns(&self, _: &Flight) -> Vec<Column> {
        let mut columns = vec![
            Column::float("revisiting", "1", "particles that revisit their earlier path; 0 between steps"),
            Column::float("effective", "1", "effective number of particles after the weighting"),
        ];
        if self.smooth {
            let misfit = "what the model leaves of the measurements, squared over its variance; NaN without smoothing";
            columns.push(Column::text("smoothing", "how the search of the line ended: converged, stopped or none"));
            columns.push(Column::float("smoothing_misfit", "1", misfit));
            let agreement = "what visits of a place tell of each other, over what they should; NaN without a visit";
            columns.push(Column::float("smoothing_agreement", "1", agreement));
        }
        columns
    }

    fn reads(&self, flight: &Flight) -> Result<Vec<String>, Vec<Fault>> {
        self.aiding.reads(flight)
    }

    fn aiding(&self) -> Option<&Aiding> {
        Some(&self.aiding)
    }

    fn idle(&self, key: &str) -> Option<Fault> {
        if let Some(fault) = self.aiding.idle(key) {
            return Some(fault);
        }
        let by_radius = self.expected_measurement != ExpectedMeasurement::NearestNeighbour;
        let belongs = |what: &str| {
            let help = "leave it out".to_owned();
            Some(Fault::new(format!("`{key}` belongs to {what}")).help(help))
        };
        match key {
            "trigger_radius_m" | "trigger_points" if !by_radius => belongs("the methods that look within a radius"),
            "interpolant_sigma_nt" if self.expected_measurement != ExpectedMeasurement::InverseDistance => {
                belongs("the method `inverse_distance`")
            }
            "smooth_measurements" | "smooth_sigma_nt" if !self.smooth => belongs("`smooth = true`"),
            "fit_window_s" if self.hyperparameters == HyperparameterSource::Fixed => {
                belongs("`hyperparameters = \"fitted\"`")
            }
            // `length_m` and `sigma_n_nt` are where the search starts.
            "sigma_se_nt" if self.hyperparameters == HyperparameterSource::Fitted => {
                belongs("`hyperparameters = \"fixed\"`")
            }
            _ => None,
        }
    }

    fn navigate(&self, flown: &Flown) -> Result<Track, Fault> {
        let line = SlamLine {
            ins: &flown.ins,
            measurement_nt: &flown.measured_nt,
            sigma_nt: &flown.sigma_nt,
            core: flown.core.as_ref(),
            fixes: flown.fixes(),
            errors: InsErrorModel { noise: self.discretisation, ..flown.errors },
        };
        let output = run(&self.parameters(flown)?, &line).map_err(data)?;
        if output.report.largest_correction > IMPLAUSIBLE {
            let what = format!(
                "the corrections are larger than the INS can have erred: their square is {:.0} times its variance",
                output.report.largest_correction
            );
            let help =
                "the INS drifts too far between revisits for so many particles; or its grade is not the one given";
            return Err(Fault::data(what).help(help));
        }
        if output.report.smoother.is_some_and(|smoother| smoother.agreement < CONTRADICTED) {
            let what = "no smoothed track was found on which the measurements of two visits of a place agree";
            let help =
                "take more `particles` or `smooth_measurements`; or the measurement errs by more than it is told to";
            return Err(Fault::data(what).help(help));
        }
        let mut track = Track::with_any(flown, output.navigation, self.gate_nis);
        // There is no map to be off.
        track.update.iter_mut().filter(|update| **update == Update::OffMap).for_each(|update| *update = Update::Unused);
        track.more.push(array(output.revisiting.iter().map(|count| f64::from(*count)).collect()));
        track.more.push(array(output.effective));
        if self.smooth {
            let words: StringArray = std::iter::repeat_n(Some(smoothing(&output.report)), flown.ins.len()).collect();
            let of = |value: fn(&SmootherReport) -> f64| output.report.smoother.as_ref().map_or(f64::NAN, value);
            track.more.push(Arc::new(words));
            track.more.push(array(vec![of(|smoother| smoother.misfit); flown.ins.len()]));
            track.more.push(array(vec![of(|smoother| smoother.agreement); flown.ins.len()]));
        }
        Ok(track)
    }
}

/// How the smoother ended.
fn smoothing(report: &SlamReport) -> &'static str {
    match report.smoother {
        Some(smoother) if smoother.converged => "converged",
        Some(_) => "stopped",
        None => "none",
    }
}

impl Slam {
    /// # Errors
    /// With `smooth_sigma_nt` and no white noise of the filter that it could be in place of.
    fn parameters(&self, flown: &Flown) -> Result<SlamParameters, Fault> {
        let noise_factor = match self.smooth_sigma_nt {
            Some(sigma_nt) if flown.measurement_sigma_nt > 0.0 => sigma_nt / flown.measurement_sigma_nt,
            Some(_) => return Err(Fault::data("`smooth_sigma_nt` is in place of a `measurement_sigma_nt` above 0")),
            None => 1.0,
        };
        let smoother = SmootherParameters {
            measurements: self.smooth_measurements,
            noise_factor,
            ..SmootherParameters::default()
        };
        let kernel = Kernel::default();
        Ok(SlamParameters {
            smoother: self.smooth.then_some(smoother),
            particles: self.particles,
            seed: self.seed as u64,
            update_interval_s: self.update_interval_s,
            expected: self.expected_measurement,
            hyperparameters: self.hyperparameters,
            kernel: Kernel {
                covariance: self.covariance,
                sigma_se_nt: self.sigma_se_nt.unwrap_or(kernel.sigma_se_nt),
                length_m: self.length_m.unwrap_or(kernel.length_m),
                sigma_n_nt: self.sigma_n_nt.unwrap_or(kernel.sigma_n_nt),
            },
            fit_window_s: self.fit_window_s,
            neighbours: self.neighbours,
            ignore_s: self.ignore_s,
            trigger_radius_m: self.trigger_radius_m,
            trigger_points: self.trigger_points,
            interpolation_radius_m: self.interpolation_radius_m,
            max_height_difference_m: self.max_height_difference_m,
            interpolant_sigma_nt: self.interpolant_sigma_nt,
            resample_below: self.resample_below,
            gate_nis: self.gate_nis,
            ..SlamParameters::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::navigate::testing::*;

    #[test]
    fn law_without_a_revisit_the_track_is_the_ins() {
        let (found, ins) = (run("slam", "mag = 'mag_1_c'\nparticles = 20"), run("ins_only", "mag = 'mag_1_c'"));
        // The mean of the particles' paths: a few of the standard deviations of their mean.
        let apart = (found.error_m(ROWS - 1) - ins.error_m(ROWS - 1)).abs();
        assert!(apart < 5.0 * ins.numbers("sd_n")[ROWS - 1] / 20_f64.sqrt(), "{apart}");
        assert_eq!(found.updates("used"), 0);
        assert!(found.numbers("revisiting").iter().all(|n| *n == 0.0));
    }

    #[test]
    fn law_gnss_holds_it_until_it_is_lost() {
        let keys = "mag = 'mag_1_c'\nparticles = 300\ngnss_lost_s = [400.0, 1e6]\ngnss_sigma_m = 3.0";
        let (found, aided) = (run("slam", keys), run("ins_only", &keys.replace("particles = 300\n", "")));
        assert!(found.error_m(399) < 3.0, "{}", found.error_m(399));
        // Nothing revisits, so that it is the Kalman filter of the INS and GNSS.
        let (ours, exact) = (found.numbers("sd_n"), aided.numbers("sd_n"));
        for row in [100, 399, 500, ROWS - 1] {
            assert!((ours[row] / exact[row] - 1.0).abs() < 1e-6, "{row} {} {}", ours[row], exact[row]);
            assert!((found.error_m(row) - aided.error_m(row)).abs() < 1e-3, "{row}");
        }
        assert_refused("slam", "gnss_sigma_m = 1.0", "no say without `gnss_lost_s`");
        assert_refused("slam", "gnss_lost_s = [400.0, 300.0]", "after it is found");
    }

    #[test]
    fn law_smoothed_and_without_a_revisit_the_track_is_the_ins_with_gnss() {
        let keys = "mag = 'mag_1_c'\nparticles = 20\nsmooth = true\nsmooth_measurements = 60\nmeasurement_sigma_nt = 1e5\n\
                    hyperparameters = 'fixed'\ngnss_lost_s = [300.0, 1e6]\ngnss_sigma_m = 3.0";
        let found = run("slam", keys);
        let aided = run("ins_only", "mag = 'mag_1_c'\ngnss_lost_s = [300.0, 1e6]\ngnss_sigma_m = 3.0");
        assert!(found.words("smoothing").iter().all(|word| word == "converged"));
        // The last sample, where a smoother knows what a filter does.
        let (ours, exact) = (found.numbers("sd_n")[ROWS - 1], aided.numbers("sd_n")[ROWS - 1]);
        assert!((ours / exact - 1.0).abs() < 0.02, "{ours} {exact}");
        assert!((found.error_m(ROWS - 1) - aided.error_m(ROWS - 1)).abs() < 0.3);
        assert!(found.numbers("sd_n")[100] < aided.numbers("sd_n")[100]);
    }

    #[test]
    fn unit_keys_without_a_say_are_told() {
        assert_refused("slam", "smooth_measurements = 300", "smooth = true");
        assert_refused("slam", "smooth_sigma_nt = 1.0", "smooth = true");
        assert_refused("slam", "trigger_points = 3", "within a radius");
        assert_refused("slam", "interpolant_sigma_nt = 3.0", "inverse_distance");
        assert_refused("slam", "hyperparameters = 'fixed'\nfit_window_s = 30.0", "fitted");
        assert_refused("slam", "sigma_se_nt = 30.0", "fixed");
    }
}
