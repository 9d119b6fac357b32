//! Navigation without a map.

use std::sync::Arc;

use arrow_array::StringArray;
use numerics::navigation::ins_error::InsErrorModel;
use numerics::navigation::{
    slam::{
        AnomalyKernel, CovarianceFunction, ExpectedMeasurement, HyperparameterSource, IMPLAUSIBLE, SlamLine,
        SlamParameters, SlamReport, SlamSmootherParameters, SlamSmootherReport, run, smoother::CONTRADICTED,
    },
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::aiding::Aiding;
use super::filter::{FilterFlight, FilterInput, FilterTrack, NavigationFilter, UpdateOutcome, filter};
use crate::columns::{array, data};

filter! {
    /// Navigation without a map. The map of a particle consists of the measurements along the particle's own path.
    /// Where the particle crosses or follows its earlier path, its weight is multiplied by the likelihood of the
    /// present measurement given the earlier ones. The filter bounds the drift of an INS on flights with revisits:
    /// loiters, or surveys with tie lines.
    ///
    /// A revisit observes only the position relative to the earlier path. The INS error before the first revisit
    /// therefore remains. Without a revisit the track equals the INS track. The `map` of the stage is ignored.
    /// `offset_window_s` is also ignored, because a constant in the measurement is part of the unknown map. `unused` in
    /// the column `update` means that no particle has an earlier position nearby.
    ///
    /// The same `seed` gives bit-identical results on any number of threads.
    ///
    /// With `gnss_lost_s`, GNSS positions aid the filter. If the line begins with GNSS, the absolute position of the
    /// map is known. A later GNSS position weights particles by their whole path, so it also corrects the map. GNSS at
    /// the start does not reduce the required number of particles. In tests with 400 particles, all ten surveys
    /// succeeded. In tests with 150 particles, two of six surveys diverged, with covariances far too small.
    ///
    /// With `smooth`, for post-processing, the result is the most probable track of the whole flight given all
    /// measurements. The smoother starts from the track of the particles and reduces errors from tens of metres to a
    /// few metres. It represents the INS error by a few smooth functions of time. Every crossing constrains these
    /// functions, so few particles are enough. `residual`, `nis`, `revisiting` and `effective` still describe the
    /// particles.
    ///
    /// `smoothing` is `converged`, or `stopped` if path or hyper-parameters still changed at the last iteration. It is
    /// `none` if there are fewer than two measurements or the covariance is singular; the track is then the track of
    /// the particles. `smoothing_misfit` is the mean squared residual of the model divided by its variance. A value far
    /// above 1 means that the assumed noise is too small. `smoothing_agreement` is the information that revisits give
    /// about each other, divided by its expected value for the assumed noise. It is about 1 on a correct track, and
    /// near 0 on a track with errors of hundreds of metres. A line with a value below 0.5 is rejected. The value is NaN
    /// for a line with almost no revisits. The smoother takes about 20 s on one core and 70 MB for 1000 measurements.
    /// Twice as many measurements take eight times the time and four times the memory.
    ///
    /// Source: Lee 2019, chapters III and V and appendix A, with these changes. Every prediction includes the last
    /// measurements, so that the product of the weights is the likelihood of the flight [Vecchia 1988]. The covariance
    /// includes the temporal variation. Particles share their earlier paths in a tree, so that the time per step does
    /// not increase during the flight. Particles are resampled from a kernel density (Musso, Oudjane & Le Gland 2001).
    /// The covariance includes the variance that resampling removes from the particles. The smoother maximises the
    /// likelihood of a Gaussian process at uncertain positions (Lawrence 2003). The covariance of the error model is
    /// the prior for these positions, and Laplace's approximation gives their posterior covariance.
    Slam = "slam", version 2, groups [aiding: Aiding], example "particles = 1000";
    /// Number of particles. They must cover the drift between revisits densely, so a less accurate INS requires more
    /// particles.
    particles: usize, unit "1", default 1000usize, rule Rule::Between(2.0, 1e6);
    /// Seed of all random draws.
    seed: usize, unit "", default 0usize;
    /// Minimum time between two updates of the particles. Measurements within this time are averaged. 0 uses every
    /// sample.
    update_interval_s: f64, unit "s", default 1.0, rule Rule::NotNegative;
    /// Prediction of a measurement from earlier ones: from the nearest and the most recent (`"nearest_neighbour"`), by
    /// the regression of Lee 2019 (`"regression"`), or by inverse distance (`"inverse_distance"`).
    expected_measurement: ExpectedMeasurement, unit "", default ExpectedMeasurement::NearestNeighbour;
    /// Source of the hyper-parameters `sigma_se_nt`, `length_m` and `sigma_n_nt`: a maximum-likelihood fit to the first
    /// part of the flight (`fitted`), or the spec (`fixed`).
    hyperparameters: HyperparameterSource, unit "", default HyperparameterSource::Fitted;
    /// Covariance function of the anomaly over distance.
    covariance: CovarianceFunction, unit "", default CovarianceFunction::Matern52;
    /// Standard deviation of the anomaly.
    sigma_se_nt: Option<f64>, unit "nT",
        absent "50 nT, the value of the Louisa flight in Lee 2019", rule Rule::Positive;
    /// Correlation length of the anomaly.
    length_m: Option<f64>, unit "m", absent "150 m, the value of the Louisa flight in Lee 2019", rule Rule::Positive;
    /// Standard deviation of the white part of the anomaly, in addition to the measurement noise.
    sigma_n_nt: Option<f64>, unit "nT",
        absent "1 nT, the value of the Louisa flight in Lee 2019", rule Rule::NotNegative;
    /// Length of the part at the start of the flight to which the hyper-parameters are fitted.
    fit_window_s: f64, unit "s", default 600.0, rule Rule::Positive;
    /// Maximum number of earlier samples in a prediction.
    neighbours: usize, unit "1", default 12usize, rule Rule::Between(1.0, 20.0);
    /// Minimum time between the present sample and an earlier sample that is compared with it.
    ignore_s: f64, unit "s", default 30.0, rule Rule::NotNegative;
    /// Radius of the test for a revisit. A sample is a revisit if more than `trigger_points` earlier samples lie within
    /// this radius.
    trigger_radius_m: Option<f64>, unit "m",
        absent "the larger of 18 m and 1.6 times the distance between samples", rule Rule::Positive;
    /// A sample is a revisit if more than this number of earlier samples lie within `trigger_radius_m`.
    trigger_points: usize, unit "1", default 2usize;
    /// Radius within which earlier samples are used for a prediction.
    interpolation_radius_m: Option<f64>, unit "m",
        absent "half the correlation length, at most 0.4 of the distance flown in `ignore_s`", rule Rule::Positive;
    /// Maximum height difference between a sample and the earlier samples that predict it. Within this limit, the
    /// assumed variance of an earlier sample increases with the height difference.
    max_height_difference_m: f64, unit "m", default 100.0, rule Rule::NotNegative;
    /// Standard deviation of an inverse-distance-weighted prediction.
    interpolant_sigma_nt: f64, unit "nT", default 10.0, rule Rule::Positive;
    /// The particles are resampled when their effective number falls below this fraction of their number.
    resample_below: f64, unit "1", default 0.5, rule Rule::Between(0.0, 1.0);
    /// Largest accepted NIS (squared innovation divided by its variance) of a measurement.
    gate_nis: Option<f64>, unit "1",
        absent "no gate; with `tuning = \"auto\"`, outliers are rejected before filtering", rule Rule::Positive;
    /// Replaces the track of the particles by the most probable track of the whole flight.
    smooth: bool, unit "", default false;
    /// Maximum number of measurements in the smoother. A longer flight is divided into this number of groups of
    /// samples. Samples near the middle of each group are averaged, and the other samples are omitted. Computing time
    /// is proportional to the third power of this number.
    smooth_measurements: usize, unit "1", default 1000usize, rule Rule::Between(2.0, 5000.0);
    /// Standard deviation of the white noise of a measurement in the smoother. A small number of particles requires a
    /// larger assumed noise; the smoother does not.
    smooth_sigma_nt: Option<f64>, unit "nT", absent "the assumed noise of the particles", rule Rule::Positive;
    /// Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of first order as in
    /// MagNav.jl, and `van_loan` exact.
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

    fn columns(&self, _: &FilterFlight) -> Vec<Column> {
        let mut columns = vec![
            Column::float("revisiting", "1", "number of particles that revisit their earlier path; 0 between updates"),
            Column::float("effective", "1", "effective number of particles after weighting"),
        ];
        if self.smooth {
            let misfit = "mean of the squared normalised residuals of the smoother, about 1 if the assumed noise is \
                          correct; NaN without smoothing";
            columns.push(Column::text("smoothing", "outcome of the smoother: converged, stopped or none"));
            columns.push(Column::float("smoothing_misfit", "1", misfit));
            let agreement = "agreement of the measurements at revisits: information in one visit about another, \
                             divided by its expected value; NaN without revisits";
            columns.push(Column::float("smoothing_agreement", "1", agreement));
        }
        columns
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let by_radius = self.expected_measurement != ExpectedMeasurement::NearestNeighbour;
        let belongs = |what: &str| {
            let help = "remove the key".to_owned();
            Some(Fault::new(format!("`{key}` has no effect without {what}")).help(help))
        };
        match key {
            "trigger_radius_m" | "trigger_points" if !by_radius => {
                belongs("`expected_measurement = \"regression\"` or `\"inverse_distance\"`")
            }
            "interpolant_sigma_nt" if self.expected_measurement != ExpectedMeasurement::InverseDistance => {
                belongs("`expected_measurement = \"inverse_distance\"`")
            }
            "smooth_measurements" | "smooth_sigma_nt" if !self.smooth => belongs("`smooth = true`"),
            "fit_window_s" if self.hyperparameters == HyperparameterSource::Fixed => {
                belongs("`hyperparameters = \"fitted\"`")
            }
            // `length_m` and `sigma_n_nt` are the initial values of the search.
            "sigma_se_nt" if self.hyperparameters == HyperparameterSource::Fitted => {
                belongs("`hyperparameters = \"fixed\"`")
            }
            _ => None,
        }
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
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
                "the corrections exceed the possible error of the INS: the squared corrections are {:.0} times the \
                 variance of this error",
                output.report.largest_correction
            );
            let help = "increase `particles` to cover the drift between revisits, or check `ins_grade`";
            return Err(Fault::data(what).help(help));
        }
        if output.report.smoother.is_some_and(|smoother| smoother.agreement < CONTRADICTED) {
            let what = "the smoother found no track on which the measurements of revisits agree";
            let help = "increase `particles` or `smooth_measurements`, or increase `measurement_sigma_nt`";
            return Err(Fault::data(what).help(help));
        }
        let mut track = FilterTrack::with_any(flown, output.navigation, self.gate_nis);
        // Without a map, no position is off the map.
        track
            .update
            .iter_mut()
            .filter(|update| **update == UpdateOutcome::OffMap)
            .for_each(|update| *update = UpdateOutcome::Unused);
        track.more.push(array(output.revisiting.iter().map(|count| f64::from(*count)).collect()));
        track.more.push(array(output.effective));
        if self.smooth {
            let words: StringArray = std::iter::repeat_n(Some(smoothing(&output.report)), flown.ins.len()).collect();
            let of = |value: fn(&SlamSmootherReport) -> f64| output.report.smoother.as_ref().map_or(f64::NAN, value);
            track.more.push(Arc::new(words));
            track.more.push(array(vec![of(|smoother| smoother.misfit); flown.ins.len()]));
            track.more.push(array(vec![of(|smoother| smoother.agreement); flown.ins.len()]));
        }
        Ok(track)
    }
}

/// Outcome of the smoother.
fn smoothing(report: &SlamReport) -> &'static str {
    match report.smoother {
        Some(smoother) if smoother.converged => "converged",
        Some(_) => "stopped",
        None => "none",
    }
}

impl Slam {
    /// # Errors
    /// Fails if `smooth_sigma_nt` is set and the filter assumes no white noise.
    fn parameters(&self, flown: &FilterInput) -> Result<SlamParameters, Fault> {
        let noise_factor = match self.smooth_sigma_nt {
            Some(sigma_nt) if flown.measurement_sigma_nt > 0.0 => sigma_nt / flown.measurement_sigma_nt,
            Some(_) => return Err(Fault::data("`smooth_sigma_nt` requires a `measurement_sigma_nt` above 0")),
            None => 1.0,
        };
        let smoother = SlamSmootherParameters {
            measurements: self.smooth_measurements,
            noise_factor,
            ..SlamSmootherParameters::default()
        };
        let kernel = AnomalyKernel::default();
        Ok(SlamParameters {
            smoother: self.smooth.then_some(smoother),
            particles: self.particles,
            seed: self.seed as u64,
            update_interval_s: self.update_interval_s,
            expected: self.expected_measurement,
            hyperparameters: self.hyperparameters,
            kernel: AnomalyKernel {
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
    fn unit_without_a_revisit_the_track_equals_the_ins() {
        let (found, ins) = (run("slam", "mag = 'mag_1_c'\nparticles = 20"), run("ins_only", "mag = 'mag_1_c'"));
        // The mean of the particles' paths is within a few standard errors of the INS path.
        let apart = (found.error_m(ROWS - 1) - ins.error_m(ROWS - 1)).abs();
        assert!(apart < 5.0 * ins.numbers("sd_n")[ROWS - 1] / 20_f64.sqrt(), "{apart}");
        assert_eq!(found.updates("used"), 0);
        assert!(found.numbers("revisiting").iter().all(|n| *n == 0.0));
    }

    #[test]
    fn unit_gnss_bounds_the_error_until_its_loss() {
        let keys = "mag = 'mag_1_c'\nparticles = 300\ngnss_lost_s = [400.0, 1e6]\ngnss_sigma_m = 3.0";
        let (found, aided) = (run("slam", keys), run("ins_only", &keys.replace("particles = 300\n", "")));
        assert!(found.error_m(399) < 3.0, "{}", found.error_m(399));
        // Without revisits the filter equals the Kalman filter of INS and GNSS.
        let (ours, exact) = (found.numbers("sd_n"), aided.numbers("sd_n"));
        for row in [100, 399, 500, ROWS - 1] {
            assert!((ours[row] / exact[row] - 1.0).abs() < 1e-6, "{row} {} {}", ours[row], exact[row]);
            assert!((found.error_m(row) - aided.error_m(row)).abs() < 1e-3, "{row}");
        }
        assert_refused("slam", "gnss_sigma_m = 1.0", "no effect without `gnss_lost_s`");
        assert_refused("slam", "gnss_lost_s = [400.0, 300.0]", "recovered earlier");
    }

    #[test]
    fn unit_smoothed_and_without_a_revisit_the_track_equals_the_aided_ins() {
        let keys = "mag = 'mag_1_c'\nparticles = 20\nsmooth = true\nsmooth_measurements = 60\n\
                    measurement_sigma_nt = 1e5\n\
                    hyperparameters = 'fixed'\ngnss_lost_s = [300.0, 1e6]\ngnss_sigma_m = 3.0";
        let found = run("slam", keys);
        let aided = run("ins_only", "mag = 'mag_1_c'\ngnss_lost_s = [300.0, 1e6]\ngnss_sigma_m = 3.0");
        assert!(found.words("smoothing").iter().all(|word| word == "converged"));
        // At the last sample, smoother and filter use the same information.
        let (ours, exact) = (found.numbers("sd_n")[ROWS - 1], aided.numbers("sd_n")[ROWS - 1]);
        assert!((ours / exact - 1.0).abs() < 0.02, "{ours} {exact}");
        assert!((found.error_m(ROWS - 1) - aided.error_m(ROWS - 1)).abs() < 0.3);
        assert!(found.numbers("sd_n")[100] < aided.numbers("sd_n")[100]);
    }

    #[test]
    fn unit_keys_without_effect_are_reported() {
        assert_refused("slam", "smooth_measurements = 300", "smooth = true");
        assert_refused("slam", "smooth_sigma_nt = 1.0", "smooth = true");
        assert_refused("slam", "trigger_points = 3", "regression");
        assert_refused("slam", "interpolant_sigma_nt = 3.0", "inverse_distance");
        assert_refused("slam", "hyperparameters = 'fixed'\nfit_window_s = 30.0", "fitted");
        assert_refused("slam", "sigma_se_nt = 30.0", "fixed");
    }
}
