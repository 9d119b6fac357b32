//! The extended Kalman filter that estimates the noise from the innovations.

use arrow_array::ArrayRef;
use numerics::navigation::{
    adaptive::{
        AdaptiveForm, AdaptiveMagnetometer, AdaptiveNoise, AdaptiveParameters, MagnetometerNoise, run, run_aided,
    },
    aided::AidedOutput,
    line::NavigationLine,
    output::NavigationOutput,
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::aiding::Aiding;
use super::filter::{
    FilterFlight, FilterInput, FilterTrack, NavigationFilter, enough, filter, state_arrays, state_columns,
};
use super::further::{AuxiliaryMeasurements, updates};
use crate::columns::{array, data};

/// Default bounds of the estimated noise, as factors of the assumed noise.
const LEAST: f64 = 1.0 / 20.0;
/// Default lower bound if the noise of the line has already been estimated, as a factor of that estimate. An estimate
/// below this bound is due to chance in the window of innovations, or to a position error that makes the measurement
/// fit the map too closely.
const LEAST_TUNED: f64 = 0.5;
const LARGEST: f64 = 20.0;

filter! {
    /// The filter `ekf`, with measurement noise estimated from the innovations. Use it for a measurement whose noise is
    /// unknown or changes. With an assumed noise ten times too small or too large, a filter loses more than half of its
    /// accuracy; an adaptive filter loses a few percent. If the noise is known, `ekf` is simpler and as accurate. The
    /// filter cannot separate noise from map errors, so `sigma_min_nt` and `sigma_max_nt` bound its estimate.
    ///
    /// `sigma_adapted` is the assumed measurement noise of the sample. It starts at `measurement_sigma_nt` and is then
    /// estimated from the innovations in the window before the sample. With several magnetometers, each has its column
    /// `sigma_adapted_<mag>`, and a magnetometer has less weight when its noise increases.
    ///
    /// `noise_column` holds the noise that a network or an ensemble predicts for each sample. With this key, the filter
    /// estimates one scale factor on this noise and keeps the predicted variation over time. After an inaccurate start
    /// or a noisy period, the position error dominates the innovations, which then contain little information on the
    /// noise. In this case, the default `form` changes the noise little, and the other forms move it to one of the
    /// bounds.
    ///
    /// Source: Gnadt 2022, (5.46)-(5.49) and section 5.9.3; Mehra 1972; Mohamed & Schwarz 1999.
    EkfAdaptive = "ekf_adaptive", version 3, groups [aiding: Aiding, further: AuxiliaryMeasurements],
    example "window = 50";
    /// Noise that is estimated: measurement noise (`"r"`), process noise (`"q"`), or both.
    adapt: AdaptiveNoise, unit "", default AdaptiveNoise::R;
    /// Number of past innovations in the estimate. With 50 innovations, the noise is accurate to 10 %; with 10, as in
    /// MagNav.jl, to 20 %. With 10 innovations, the forms `"matched"` and `"compatible"` occasionally estimate a noise
    /// near 0. The filter is then strongly overconfident unless `sigma_min_nt` is near the true noise.
    window: usize, unit "1", default 50usize, rule Rule::Between(2.0, 1e6);
    /// Lower bound of the estimated noise.
    sigma_min_nt: Option<f64>, unit "nT",
        absent "half of the noise that `tuning = \"auto\"` estimates, else a twentieth of `measurement_sigma_nt`; with \
                `noise_column` the smallest assumed noise", rule Rule::Positive;
    /// Upper bound of the estimated noise.
    sigma_max_nt: Option<f64>, unit "nT",
        absent "20 times `measurement_sigma_nt`, or with `noise_column` 20 times the largest assumed noise",
        rule Rule::Positive;
    /// Estimator of the noise. `"residual"` uses the a posteriori residual of each measurement. `"matched"`, the
    /// default of version 1, subtracts from each squared innovation the variance predicted for the same sample.
    /// `"compatible"`, as in MagNav.jl, starts at the mean of the bounds and subtracts the variance predicted for the
    /// present sample from all squared innovations.
    form: AdaptiveForm, unit "", default AdaptiveForm::Residual;
    /// Largest accepted NIS (squared innovation divided by its variance) of a measurement. Rejected measurements are
    /// used only to estimate the noise.
    gate_nis: Option<f64>, unit "1",
        absent "no gate; with `tuning = \"auto\"`, outliers are rejected before filtering", rule Rule::Positive;
    /// Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of first order as in
    /// MagNav.jl, and `van_loan` exact.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
    /// Appends the state `x` and its covariance `p` (row-major).
    save_state: bool, unit "", default false;
}

impl NavigationFilter for EkfAdaptive {
    fn gates(&self) -> bool {
        self.gate_nis.is_some()
    }

    fn reads(&self, _: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        self.further.needs_scalar("its noise")
    }

    fn each_magnetometer(&self) -> bool {
        true
    }

    fn columns(&self, flight: &FilterFlight) -> Vec<Column> {
        let what = "assumed noise of the measurement; NaN without a measurement";
        let names = flight.mags.iter().map(|mag| match flight.mags {
            [_] => "sigma_adapted".to_owned(),
            _ => format!("sigma_adapted_{mag}"),
        });
        let mut columns: Vec<Column> = names.map(|name| Column::float(name, "nT", what)).collect();
        columns.push(Column::float(
            "given_back",
            "1",
            "fraction of the measurement update that is returned as process noise",
        ));
        if self.save_state {
            columns.extend(state_columns());
        }
        columns
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let bounds_r = ["sigma_min_nt", "sigma_max_nt", "form"].contains(&key);
        (bounds_r && self.adapt == AdaptiveNoise::Q)
            .then(|| Fault::new(format!("`{key}` has no effect with `adapt = \"q\"`")))
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line_with(self.discretisation)? };
        let parameters = AdaptiveParameters {
            adapt: self.adapt,
            form: self.form,
            window: self.window,
            relative: flown.sample_sigma_nt.is_some(),
            gate_nis: self.gate_nis,
            keep_states: self.save_state,
            keep_covariance: self.save_state,
        };
        let sigma_nt = flown.measurement_sigma_nt;
        let sigmas = flown.sigma_of_each_nt();
        let known = || sigmas.iter().copied().filter(|sigma| *sigma > 0.0 && sigma.is_finite());
        let (usual_least, usual_largest) = match &flown.sample_sigma_nt {
            Some(_) => (known().reduce(f64::min).unwrap_or(sigma_nt), LARGEST * known().fold(sigma_nt, f64::max)),
            None if flown.is_tuned() => (LEAST_TUNED * sigma_nt, LARGEST * sigma_nt),
            None => (LEAST * sigma_nt, LARGEST * sigma_nt),
        };
        let least = self.sigma_min_nt.unwrap_or(usual_least);
        let largest = self.sigma_max_nt.unwrap_or(usual_largest);
        let magnetometers: Vec<AdaptiveMagnetometer> = flown
            .magnetometers
            .iter()
            .map(|mag| AdaptiveMagnetometer {
                measurement_nt: &mag.measured_nt,
                sigma_nt: &sigmas,
                sigma_min_nt: least,
                sigma_max_nt: largest,
            })
            .collect();
        if self.further.is_any() {
            let measured = self.further.measured(flown)?;
            let aids = self.further.aids(flown, &measured)?;
            let out = run_aided(&parameters, &line, &magnetometers, &aids).map_err(data)?;
            let AidedOutput { mut navigation, usage, aids, slope_nt_per_m, .. } = out.line;
            enough(flown, &navigation.report)?;
            let mut more = self.more(out.magnetometers, out.given_back, &mut navigation)?;
            more.extend(self.further.arrays(aids, slope_nt_per_m));
            return Ok(FilterTrack { more, update: updates(&usage), ..FilterTrack::without_updates(navigation) });
        }
        let mut out = run(&parameters, &line, &magnetometers).map_err(data)?;
        let more = self.more(out.magnetometers, out.given_back, &mut out.navigation)?;
        Ok(FilterTrack { more, ..FilterTrack::from_output(flown, out.navigation, self.gate_nis)? })
    }
}

impl EkfAdaptive {
    /// Estimated noise, and the states if they are requested.
    fn more(
        &self,
        magnetometers: Vec<MagnetometerNoise>,
        given_back: Vec<f64>,
        navigation: &mut NavigationOutput,
    ) -> Result<Vec<ArrayRef>, Fault> {
        let mut more: Vec<ArrayRef> = magnetometers.into_iter().map(|of| array(of.sigma_nt)).collect();
        more.push(array(given_back));
        if self.save_state {
            more.extend(state_arrays(navigation)?);
        }
        Ok(more)
    }
}

#[cfg(test)]
mod tests {
    use crate::navigate::testing::*;

    #[test]
    fn unit_a_wrong_noise_is_corrected() {
        let noisy = with(&flight(), "mag_1_c", |row, nt| nt + 6.0 * (5.7 * row as f64).sin());
        for told in ["0.45", "45.0"] {
            let keys =
                format!("measurement_sigma_nt = {told}\nsigma_min_nt = 0.1\nsigma_max_nt = 50.0\nmag = 'mag_1_c'");
            let found = flown("ekf_adaptive", &keys, &noisy).unwrap();
            let late: Vec<f64> = found.numbers("sigma_adapted")[300..].to_vec();
            let mean = late.iter().sum::<f64>() / late.len() as f64;
            // Amplitudes of 6 nT and 1.4 nT give 4.4 nT rms. A variance estimated from 50 samples has a standard error
            // of a fifth.
            assert!((mean / 4.4 - 1.0).abs() < 0.25, "told {told}: {mean}");
        }
    }

    #[test]
    fn law_sample_noise_adds_to_the_common_noise() {
        // 1.5 nT and 2 nT combine to 2.5 nT. A sample without a noise value has no measurement.
        let two = with(&flight(), "mag_2_c", |_, _| 2.0);
        for filter in ["ekf", "iekf", "ukf", "ekf_adaptive", "rts", "crlb"] {
            let one = flown(filter, "noise_column = 'mag_2_c'\nmag = 'mag_1_c'", &two).unwrap();
            let keys = "measurement_sigma_nt = 2.5\nmag = 'mag_1_c'";
            let bounds = if filter == "ekf_adaptive" { "\nsigma_min_nt = 2.5\nsigma_max_nt = 50.0" } else { "" };
            let same = flown(filter, &format!("{keys}{bounds}"), &two).unwrap();
            assert_eq!(one.numbers("lat"), same.numbers("lat"), "{filter}");
            assert_eq!(one.numbers("sd_e"), same.numbers("sd_e"), "{filter}");
            let gap = with(&two, "mag_2_c", |row, nt| if row == 300 { f64::NAN } else { nt });
            let gap = flown(filter, "noise_column = 'mag_2_c'\nmag = 'mag_1_c'", &gap).unwrap();
            assert!(gap.numbers("nis")[300].is_nan() && gap.numbers("lat")[301].is_finite(), "{filter}");
        }
    }

    #[test]
    fn unit_each_magnetometer_has_its_own_noise() {
        let noisy = with(&flight(), "mag_2_c", |row, nt| nt + 20.0 * (5.7 * row as f64).sin());
        let found = flown("ekf_adaptive", "mag = ['mag_1_c', 'mag_2_c']", &noisy).unwrap();
        let of = |mag: &str| found.numbers(&format!("sigma_adapted_{mag}"))[500];
        assert!(of("mag_2_c") > 5.0 * of("mag_1_c"), "{} {}", of("mag_1_c"), of("mag_2_c"));
        assert!(found.error_m(ROWS - 1) < 30.0, "{}", found.error_m(ROWS - 1));
    }

    #[test]
    fn unit_bounds_are_relative_to_the_measurement_noise() {
        assert_refused("ekf_adaptive", "adapt = 'q'\nsigma_min_nt = 1.0", "no effect with");
        let fault = flown("ekf_adaptive", "sigma_min_nt = 5.0\nsigma_max_nt = 1.0\nmag = 'mag_1_c'", &flight());
        assert!(fault.unwrap_err().what.contains("sigma_max_nt"));
    }
}
