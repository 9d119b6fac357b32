//! Fixed-lag smoother with the coefficients of the aircraft field.

use numerics::{
    navigation::{
        fixed_lag::{
            self, AircraftCoefficients, FixedLagMagnetometer, FixedLagOptions, FixedLagOutput, FixedLagParameters,
            FixedLagUsage,
        },
        line::NavigationLine,
        loss::TrajectoryLoss,
        transition::NoiseDiscretisation,
    },
    signal::gauss_markov::GaussMarkov,
};
use schemas::{Column, Fault, Rule};

use super::aiding::{Aiding, both};
use super::aircraft::{AircraftCoefficientStates, AircraftModelKeys, one_with_models};
use super::ekf_online_tl::aircraft_columns;
use super::filter::{FilterFlight, FilterInput, FilterTrack, NavigationFilter, UpdateOutcome, filter};
use super::further::AuxiliaryMeasurements;
use crate::columns::{array, data};

filter! {
    /// A smoother over sliding windows that also estimates the aircraft field. Its states are the 18 states of `ekf`,
    /// the coefficients for the line's A-matrix, and a first-order Gauss-Markov error of the magnetometer. The smoother
    /// can start with an uncompensated magnetometer and without a calibration. At the start of the line, while the INS
    /// is accurate to metres, the map determines the coefficients.
    ///
    /// Each window is solved by Gauss-Newton iterations, each with a new linearisation of the map. Each window passes
    /// the filtered covariance of INS states and coefficients to the next window. Between the end of one window and the
    /// end of the next, a filter continues the track. The innovations of this filter give one `residual` and one `nis`
    /// per `measurement_interval_s`. With `lag_s = 0.0`, the track corresponds to real-time navigation.
    ///
    /// `fogm_sigma_nt` describes the temporal variation common to all magnetometers. `aircraft_sigma_nt` describes the
    /// residual of the linear aircraft model. Without an assumed noise for this residual, a filter with magnetometers
    /// in the cabin is overconfident.
    ///
    /// Source: fixed-lag factor-graph smoothing for the windows and their prior. Each window is an iterated smoother
    /// [Bell 1994] in Bryson-Frazier form [Bierman 1973].
    FixedLag = "fixed_lag", version 2,
    groups [aircraft: AircraftModelKeys, aiding: Aiding, further: AuxiliaryMeasurements], example "lag_s = 0.0";
    /// Length of a window.
    window_s: f64, unit "s", default 300.0, rule Rule::Positive;
    /// Fraction of a window that overlaps with the next window. A window ends every `window_s` × (1 - `overlap`)
    /// seconds.
    overlap: f64, unit "1", default 0.95, rule Rule::Between(0.0, 0.999);
    /// Delay of the estimate, which uses measurements up to this time after the sample. 0 gives real-time navigation.
    lag_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
    /// Interval over which measurements are averaged into one. 0 uses every sample.
    measurement_interval_s: f64, unit "s", default 1.0, rule Rule::NotNegative;
    /// Loss function of a residual: quadratic (`none`), or robust to outliers (`huber`, `cauchy`).
    loss: TrajectoryLoss, unit "", default TrajectoryLoss::None;
    /// Residual above which a robust `loss` departs from the quadratic loss, in standard deviations of the measurement.
    loss_scale: f64, unit "1", default 2.5, rule Rule::Positive;
    /// Maximum number of iterations per window.
    iterations: usize, unit "", default 15usize;
    /// Standard deviation of the slowly varying aircraft field that the coefficients do not explain. 0 assumes no such
    /// field.
    aircraft_sigma_nt: Option<f64>, unit "nT",
        absent "30.0; 0 if `tuning = \"auto\"` estimates the noise of the line, because the estimated noise \
                includes this field",
        rule Rule::NotNegative;
    /// Time constant of the slowly varying aircraft field that the coefficients do not explain.
    aircraft_tau_s: f64, unit "s", default 300.0, rule Rule::Positive;
    /// Random walk of a coefficient: standard deviation of the change in one hour, divided by the prior standard
    /// deviation. With 0 the coefficients are constants.
    walk_per_hour: f64, unit "1", default 0.0, rule Rule::NotNegative;
    /// Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of first order as in
    /// MagNav.jl, and `van_loan` exact.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
}

impl NavigationFilter for FixedLag {
    fn reads(&self, flight: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        both(self.aircraft.reads(flight), self.further.needs_scalar("the aircraft's field"))
    }

    fn each_magnetometer(&self) -> bool {
        true
    }

    fn takes_models(&self) -> bool {
        true
    }

    fn aircraft(&self) -> Option<(&AircraftModelKeys, Option<f64>)> {
        Some((&self.aircraft, Some(self.walk_per_hour)))
    }

    fn takes_direction(&self) -> bool {
        self.aircraft.heading_error_sigma_nt.is_some() || self.further.takes_direction()
    }

    fn columns(&self, flight: &FilterFlight) -> Vec<Column> {
        aircraft_columns(flight).into_iter().collect()
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        match key {
            "loss_scale" if self.loss == TrajectoryLoss::None => {
                let fault = Fault::new("`loss_scale` has no effect with `loss = \"none\"`");
                Some(fault.help("remove `loss_scale`, or set `loss` to `huber` or `cauchy`"))
            }
            "aircraft_tau_s" if self.aircraft_sigma_nt == Some(0.0) => Some(
                Fault::new("`aircraft_tau_s` has no effect with `aircraft_sigma_nt = 0.0`")
                    .help("remove `aircraft_tau_s`, or set `aircraft_sigma_nt` above 0"),
            ),
            _ => None,
        }
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        one_with_models(flown)?;
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line_with(self.discretisation)? };
        let AircraftCoefficientStates { terms, prior, walk_density } =
            self.aircraft.states(flown, Some(self.walk_per_hour))?;
        let coefficients = AircraftCoefficients {
            regressors: &terms.values,
            mean: &prior.mean,
            covariance: &prior.covariance,
            walk_density: &walk_density,
        };
        let sigma_nt = flown.sigma_of_each_nt();
        let error = GaussMarkov {
            sigma: self.aircraft_sigma_nt.unwrap_or(if flown.is_tuned() { 0.0 } else { 30.0 }),
            tau_s: self.aircraft_tau_s,
        };
        let magnetometers: Vec<FixedLagMagnetometer> = flown
            .magnetometers
            .iter()
            .map(|mag| FixedLagMagnetometer {
                measurement_nt: &mag.measured_nt,
                sigma_nt: &sigma_nt,
                coefficients,
                error,
            })
            .collect();
        let measured = self.further.measured(flown)?;
        let aids = self.further.aids(flown, &measured)?;
        let output = fixed_lag::run_aided(&self.parameters(), &line, &magnetometers, &aids, FixedLagOptions::default());
        let output = output.map_err(data)?;
        self.track(flown, output, magnetometers.len())
    }
}

impl FixedLag {
    fn parameters(&self) -> FixedLagParameters {
        FixedLagParameters {
            window_s: self.window_s,
            overlap: self.overlap,
            lag_s: self.lag_s,
            measurement_interval_s: self.measurement_interval_s,
            loss: self.loss,
            loss_scale: self.loss_scale,
            iterations: self.iterations,
            ..FixedLagParameters::default()
        }
    }

    fn track(&self, flown: &FilterInput, output: FixedLagOutput, magnetometers: usize) -> Result<FilterTrack, Fault> {
        let update = output.usage.iter().map(|usage| match usage {
            FixedLagUsage::Used => UpdateOutcome::Used,
            FixedLagUsage::Missing => UpdateOutcome::Missing,
            FixedLagUsage::OffMap => UpdateOutcome::OffMap,
            FixedLagUsage::Flat => UpdateOutcome::Flat,
        });
        let update: Vec<UpdateOutcome> = update.collect();
        let mut track = FilterTrack::from_output(flown, output.navigation, None)?;
        // The residual is at the first sample of an interval; the other samples are also used.
        track.update = update;
        let of = |mag: usize| output.aircraft_nt.iter().skip(mag).step_by(magnetometers).copied().collect();
        track.more = (0..magnetometers).map(|mag| array(of(mag))).collect();
        track.more.extend(self.further.arrays(output.aids, output.slope_nt_per_m));
        Ok(track)
    }
}

#[cfg(test)]
mod tests {
    use crate::navigate::testing::*;

    #[test]
    fn unit_the_aircraft_field_is_found_without_a_calibration() {
        let keys = "mag = 'mag_1_uc'\naircraft_sigma_nt = 0.0\nwindow_s = 200.0";
        let (now, later) = (run("fixed_lag", keys), run("fixed_lag", &format!("{keys}\nlag_s = 60.0")));
        for found in [&now, &later] {
            assert!(found.error_m(ROWS - 1) < 30.0, "{}", found.error_m(ROWS - 1));
            assert_eq!(found.updates("used"), ROWS);
        }
        let sum = |of: &NavigateOutput| (100..500).map(|row| of.error_m(row).powi(2)).sum::<f64>();
        assert!(sum(&later) < sum(&now), "what comes later helps: {} {}", sum(&later), sum(&now));
    }

    #[test]
    fn unit_the_heading_error_of_the_sensor_is_found() {
        // 30 nT times the cosine of the angle between the field and the nose, in addition to the aircraft field.
        let turned = with(&flight(), "mag_1_uc", |row, nt| nt + 30.0 * (0.2 + 0.25 * (row as f64 / 2.3).cos()));
        let keys = "mag = 'mag_1_uc'\naircraft_sigma_nt = 0.0\nwindow_s = 200.0\nvector = 'flux_d'\n\
                    heading_error_sigma_nt = 50.0";
        let found = flown("fixed_lag", keys, &turned).unwrap();
        assert!(found.error_m(ROWS - 1) < 40.0, "{}", found.error_m(ROWS - 1));
    }

    #[test]
    fn unit_keys_without_effect_are_reported() {
        assert_refused("fixed_lag", "loss_scale = 2.0", "no effect with `loss");
        assert_refused("fixed_lag", "aircraft_sigma_nt = 0.0\naircraft_tau_s = 9.0", "no effect");
        assert_refused("fixed_lag", "overlap = 1.0", "overlap");
    }
}
