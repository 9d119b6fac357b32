//! The extended Kalman filter with noise that it learns from its own innovations.

use arrow_array::ArrayRef;
use numerics::navigation::{
    adaptive::{Adapt, Adapted, AdaptiveForm, AdaptiveParameters, Magnetometer, run, run_aided},
    aided::AidedOutput,
    line::NavigationLine,
    output::NavigationOutput,
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::aiding::{Aiding, both};
use super::filter::{Flight, Flown, NavigationFilter, Track, enough, filter, state_arrays, state_columns};
use super::further::{Further, updates};
use crate::columns::{array, data};

/// The bounds of the learnt noise where they are not given, as factors of the expected one.
const LEAST: f64 = 1.0 / 20.0;
const LARGEST: f64 = 20.0;

filter! {
    /// The extended Kalman filter of `ekf` that learns the noise of its measurement, so that its innovations are as
    /// large as it says. It is for a measurement whose noise is unknown or changes: a filter told a noise ten times too
    /// small or too large loses more than half of its accuracy, one that learns it a few percent. Where the noise is
    /// known, `ekf` is simpler and no worse. The bounds matter: noise is told from map errors within them only.
    ///
    /// `sigma_adapted` is the noise that the measurement of the sample was taken to have. It starts at
    /// `measurement_sigma_nt` and is of the window before the sample. Of several magnetometers each has its own,
    /// `sigma_adapted_<mag>`, and one whose noise grows loses its weight.
    ///
    /// With `noise_column`, the noise that a network or an ensemble expects of each sample, the factor is learnt that all of it is
    /// wrong by, and its course over time is believed. Where the position is known less well than the measurement, at a wide start
    /// or just after noise has ended, innovations tell little of the noise, and the default form moves it little; the others take it
    /// to one of the bounds.
    ///
    /// Source: thesis 000, (5.46)-(5.49) and section 5.9.3; Mehra 1972; Mohamed & Schwarz 1999.
    EkfAdaptive = "ekf_adaptive", version 2, groups [aiding: Aiding, further: Further], example "window = 50";
    /// Which noise is learnt: of the measurement (`"r"`), of the process (`"q"`), or both.
    adapt: Adapt, unit "", default Adapt::R;
    /// How many innovations are looked back on. With 50 the noise is known to 10 %. With 10, as MagNav.jl, it is known to 20 %, and by
    /// the forms `"matched"` and `"compatible"` near 0 now and then: the filter believes far too much then, unless `sigma_min_nt`
    /// is near the truth.
    window: usize, unit "1", default 50usize, rule Rule::Between(2.0, 1e6);
    /// The least noise that is learnt.
    sigma_min_nt: Option<f64>, unit "nT", absent "a twentieth of `measurement_sigma_nt`, or the smallest expected noise with `noise_column`", rule Rule::Positive;
    /// The largest noise that is learnt.
    sigma_max_nt: Option<f64>, unit "nT", absent "20 times `measurement_sigma_nt`, or 20 times the largest expected noise with `noise_column`", rule Rule::Positive;
    /// How the innovations are matched: by what the correction leaves of each (`"residual"`), each less the covariance of its
    /// own time (`"matched"`, the default of version 1), or as MagNav.jl, which starts at the mean of the bounds and takes the
    /// present covariance off all (`"compatible"`).
    form: AdaptiveForm, unit "", default AdaptiveForm::Residual;
    /// A measurement whose squared innovation over its variance is above this is not used, but learnt from.
    gate_nis: Option<f64>, unit "1", absent "outliers are rejected before the filter, or none with `tuning = \"magnav\"`", rule Rule::Positive;
    /// How the process noise becomes a step's covariance: to second order, to first order as MagNav.jl, or exactly.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
    /// Append the state `x` and its covariance `p` (row-major).
    save_state: bool, unit "", default false;
}

impl NavigationFilter for EkfAdaptive {
    fn gates(&self) -> bool {
        self.gate_nis.is_some()
    }

    fn reads(&self, flight: &Flight) -> Result<Vec<String>, Vec<Fault>> {
        let further = both(self.further.reads(flight), self.further.needs_scalar("its noise"));
        both(self.aiding.reads(flight), further)
    }

    fn takes_direction(&self) -> bool {
        self.further.takes_direction()
    }

    fn each_magnetometer(&self) -> bool {
        true
    }

    fn columns(&self, flight: &Flight) -> Vec<Column> {
        let what = "noise that the measurement was taken to have; NaN without one";
        let names = flight.mags.iter().map(|mag| match flight.mags {
            [_] => "sigma_adapted".to_owned(),
            _ => format!("sigma_adapted_{mag}"),
        });
        let mut columns: Vec<Column> = names.map(|name| Column::float(name, "nT", what)).collect();
        columns.push(Column::float("given_back", "1", "share of the correction that is given back as process noise"));
        if self.save_state {
            columns.extend(state_columns());
        }
        columns.extend(self.further.columns());
        columns
    }

    fn aiding(&self) -> Option<&Aiding> {
        Some(&self.aiding)
    }

    fn idle(&self, key: &str) -> Option<Fault> {
        let bounds_r = ["sigma_min_nt", "sigma_max_nt", "form"].contains(&key);
        let idle = (bounds_r && self.adapt == Adapt::Q)
            .then(|| Fault::new(format!("`{key}` is of the measurement noise, which `adapt = \"q\"` does not learn")));
        idle.or_else(|| self.aiding.idle(key)).or_else(|| self.further.idle(key))
    }

    fn navigate(&self, flown: &Flown) -> Result<Track, Fault> {
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
            None => (LEAST * sigma_nt, LARGEST * sigma_nt),
        };
        let least = self.sigma_min_nt.unwrap_or(usual_least);
        let largest = self.sigma_max_nt.unwrap_or(usual_largest);
        let magnetometers: Vec<Magnetometer> = flown
            .magnetometers
            .iter()
            .map(|mag| Magnetometer {
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
            more.extend(self.further.arrays(aids, Default::default(), slope_nt_per_m));
            return Ok(Track { more, update: updates(&usage), ..Track::without_updates(navigation) });
        }
        let mut out = run(&parameters, &line, &magnetometers).map_err(data)?;
        let more = self.more(out.magnetometers, out.given_back, &mut out.navigation)?;
        Ok(Track { more, ..Track::of(flown, out.navigation, self.gate_nis)? })
    }
}

impl EkfAdaptive {
    /// What was learnt, and the states where they are asked for.
    fn more(
        &self,
        magnetometers: Vec<Adapted>,
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
    fn law_a_wrong_noise_is_learnt() {
        let noisy = with(&flight(), "mag_1_c", |row, nt| nt + 6.0 * (5.7 * row as f64).sin());
        for told in ["0.45", "45.0"] {
            let keys =
                format!("measurement_sigma_nt = {told}\nsigma_min_nt = 0.1\nsigma_max_nt = 50.0\nmag = 'mag_1_c'");
            let found = flown("ekf_adaptive", &keys, &noisy).unwrap();
            let late: Vec<f64> = found.numbers("sigma_adapted")[300..].to_vec();
            let mean = late.iter().sum::<f64>() / late.len() as f64;
            // A wave of 6 nT and one of 1.4 nT: 4.4 nT together, and a learnt variance of 50 samples varies by a fifth.
            assert!((mean / 4.4 - 1.0).abs() < 0.25, "told {told}: {mean}");
        }
    }

    #[test]
    fn law_a_noise_of_each_sample_adds_to_that_of_all() {
        // 1.5 and 2 make 2.5; a sample without one has no measurement.
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
    fn law_each_magnetometer_has_its_own_noise() {
        let noisy = with(&flight(), "mag_2_c", |row, nt| nt + 20.0 * (5.7 * row as f64).sin());
        let found = flown("ekf_adaptive", "mag = ['mag_1_c', 'mag_2_c']", &noisy).unwrap();
        let of = |mag: &str| found.numbers(&format!("sigma_adapted_{mag}"))[500];
        assert!(of("mag_2_c") > 5.0 * of("mag_1_c"), "{} {}", of("mag_1_c"), of("mag_2_c"));
        assert!(found.error_m(ROWS - 1) < 30.0, "{}", found.error_m(ROWS - 1));
    }

    #[test]
    fn unit_bounds_belong_to_the_measurement_noise() {
        assert_refused("ekf_adaptive", "adapt = 'q'\nsigma_min_nt = 1.0", "does not learn");
        let fault = flown("ekf_adaptive", "sigma_min_nt = 5.0\nsigma_max_nt = 1.0\nmag = 'mag_1_c'", &flight());
        assert!(fault.unwrap_err().what.contains("sigma_max_nt"));
    }
}
