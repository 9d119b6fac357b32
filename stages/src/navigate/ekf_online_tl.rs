//! The extended Kalman filter that estimates the Tolles-Lawson coefficients in flight.

use std::ops::Range;

use numerics::compensation::tolles_lawson::{BodyFieldColumns, TermSelection};
use numerics::navigation::{
    line::NavigationLine,
    online::{Fluxgate, LineModel, OnlineMagnetometer, OnlineParameters, run},
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::aiding::{Aiding, both};
use super::aircraft::{AircraftCoefficientStates, AircraftModelKeys, one_with_models};
use super::filter::{FilterFlight, FilterInput, FilterTrack, NavigationFilter, filter, state_arrays, state_columns};
use super::further::{AuxiliaryMeasurements, updates};
use crate::a_matrix::runs_of;
use crate::columns::{array, data};

filter! {
    /// The 18-state extended Kalman filter with the Tolles-Lawson coefficients of each magnetometer as additional
    /// states. `mag` is uncompensated, and the coefficients follow changes of the aircraft field.
    ///
    /// Use it if the line has manoeuvres, and the calibration is old, comes from another aircraft, or is missing. On a
    /// straight line at constant attitude the aircraft field is a constant, and only the prior separates it from the
    /// map. A constant among the terms (`bias`) absorbs the constant that map and compensation leave undetermined, so
    /// `offset_window_s` is not needed.
    ///
    /// The prior comes from the calibrations in `model` (one or several tables of `fit`), converted to the sample rate
    /// of the line. Without `model`, the filter starts cold: the prior mean of all coefficients is 0. A scalar
    /// magnetometer among the terms is rejected, because the filter would subtract its own measurement. `aircraft` is
    /// the aircraft field computed with the coefficients estimated at the sample. With several magnetometers, each has
    /// its column `aircraft_<mag>`. `residual` is the innovation of the first magnetometer used at a sample. `nis` is
    /// the mean over all magnetometers used at the sample.
    ///
    /// Source: Gnadt 2022, section 5.5, without (5.39).
    EkfOnlineTl = "ekf_online_tl", version 2,
    groups [aiding: Aiding, aircraft: AircraftModelKeys, further: AuxiliaryMeasurements], example "walk_per_hour = 0.1";
    /// Random walk of a coefficient: standard deviation of the change in one hour, divided by the prior standard
    /// deviation. With 0 the coefficients are constants. In a cold start the default is 0, because the wide prior does
    /// not describe changes in flight.
    walk_per_hour: Option<f64>, unit "1", absent "0.1 with `model`, else 0.0", rule Rule::NotNegative;
    /// Standard deviation of the bias of each axis of `vector`, the magnetometer of the terms. If set, the filter
    /// estimates these biases.
    flux_bias_sigma_nt: Option<f64>, unit "nT", absent "`vector` is assumed to be exact", rule Rule::Positive;
    /// Time constant of the biases of `vector`.
    flux_bias_tau_s: Option<f64>, unit "s", absent "the biases are constant", rule Rule::Positive;
    /// Field scale of the terms: `bt_scale_nt` of the `a_matrix` stage that computes the terms.
    bt_scale_nt: f64, unit "nT", default 50_000.0, rule Rule::Positive;
    /// Largest accepted NIS (squared innovation divided by its variance) of a measurement.
    gate_nis: Option<f64>, unit "1",
        absent "no gate; with `tuning = \"auto\"`, outliers are rejected before filtering", rule Rule::Positive;
    /// Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of first order as in
    /// MagNav.jl, and `van_loan` exact.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
    /// Appends the state `x` and its covariance `p` (row-major), of the 18 states of `ekf`.
    save_state: bool, unit "", default false;
}

/// Columns of the aircraft field, one per magnetometer.
pub(super) fn aircraft_columns(flight: &FilterFlight) -> Vec<Column> {
    let what = "aircraft field computed with the coefficients estimated at the sample";
    let name = |mag: &String| if flight.mags.len() == 1 { "aircraft".to_owned() } else { format!("aircraft_{mag}") };
    flight.mags.iter().map(|mag| Column::float(name(mag), "nT", what)).collect()
}

impl NavigationFilter for EkfOnlineTl {
    fn gates(&self) -> bool {
        self.gate_nis.is_some()
    }

    fn reads(&self, flight: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        let mut faults = vec![];
        if self.flux_bias_sigma_nt.is_some() && !flight.has_direction {
            let what = "`flux_bias_sigma_nt` requires `vector`, the vector magnetometer of the terms";
            faults.push(Fault::new(what).of_param("flux_bias_sigma_nt"));
        }
        let bias = if faults.is_empty() { Ok(vec![]) } else { Err(faults) };
        both(both(self.aircraft.reads(flight), bias), self.further.needs_scalar("the aircraft's field"))
    }

    fn each_magnetometer(&self) -> bool {
        true
    }

    fn takes_models(&self) -> bool {
        true
    }

    fn aircraft(&self) -> Option<(&AircraftModelKeys, Option<f64>)> {
        Some((&self.aircraft, self.walk_per_hour))
    }

    fn takes_direction(&self) -> bool {
        let of_aircraft = self.aircraft.heading_error_sigma_nt.is_some() || self.flux_bias_sigma_nt.is_some();
        of_aircraft || self.further.takes_direction()
    }

    fn columns(&self, flight: &FilterFlight) -> Vec<Column> {
        let mut columns = aircraft_columns(flight);
        if self.save_state {
            columns.extend(state_columns());
        }
        columns
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let of_bias = ["flux_bias_tau_s", "bt_scale_nt"].contains(&key) && self.flux_bias_sigma_nt.is_none();
        of_bias.then(|| Fault::new(format!("`{key}` has no effect without `flux_bias_sigma_nt`")).of_param(key))
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        one_with_models(flown)?;
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line_with(self.discretisation)? };
        let AircraftCoefficientStates { terms, prior, walk_density } =
            self.aircraft.states(flown, self.walk_per_hour)?;
        let sigma_nt = flown.sigma_of_each_nt();
        let magnetometers: Vec<OnlineMagnetometer> = flown
            .magnetometers
            .iter()
            .map(|mag| OnlineMagnetometer {
                measurement_nt: &mag.measured_nt,
                sigma_nt: &sigma_nt,
                terms: &terms.values,
                prior: &prior,
                walk_density: &walk_density,
            })
            .collect();
        let parameters = OnlineParameters {
            gate_nis: self.gate_nis,
            recover_after: None,
            keep_states: self.save_state,
            keep_covariance: self.save_state,
            keep_coefficients: false,
        };
        let bias = self.bias(flown, &terms.names)?;
        let fluxgate = bias.as_ref().map(|bias| bias.fluxgate());
        let measured = self.further.measured(flown)?;
        let model = LineModel { aids: self.further.aids(flown, &measured)?, ..LineModel::from_line(&line) };
        let mut out = run(&model, &magnetometers, fluxgate.as_ref(), &parameters).map_err(data)?;
        let mut states = if self.save_state { state_arrays(&mut out.navigation)? } else { vec![] };
        states.extend(self.further.arrays(out.aids, out.slope_nt_per_m));
        let mut track = FilterTrack::from_output(flown, out.navigation, self.gate_nis)?;
        if self.further.is_any() {
            track.update = updates(&out.usage);
        }
        track.more.extend(out.magnetometers.into_iter().map(|mag| array(mag.track.aircraft_nt)));
        track.more.extend(states);
        Ok(track)
    }
}

/// Bias of a vector magnetometer, with the data from which it is estimated: the measured field and the terms.
struct VectorMagnetometerBias<'a> {
    field: BodyFieldColumns<'a>,
    terms: TermSelection,
    runs: Vec<Range<usize>>,
    scale_nt: f64,
    sigma_nt: f64,
    tau_s: f64,
}

impl VectorMagnetometerBias<'_> {
    fn fluxgate(&self) -> Fluxgate<'_> {
        let Self { field, terms, runs, scale_nt, sigma_nt, tau_s } = self;
        Fluxgate { field: *field, terms, scale_nt: *scale_nt, runs, sigma_nt: *sigma_nt, tau_s: *tau_s }
    }
}

impl EkfOnlineTl {
    /// The bias to estimate, if requested.
    fn bias<'a>(&self, flown: &'a FilterInput, names: &[String]) -> Result<Option<VectorMagnetometerBias<'a>>, Fault> {
        let (Some(sigma_nt), Some([x, y, z])) = (self.flux_bias_sigma_nt, flown.field_nt) else { return Ok(None) };
        let terms = TermSelection::leading(names).map_err(|_| {
            let what = format!("`{}` does not hold the terms of a vector magnetometer", self.aircraft.terms);
            Fault::data(what)
                .of_param("flux_bias_sigma_nt")
                .help("make the terms with a stage `a_matrix` that uses the same `vector`")
        })?;
        let runs = runs_of(&terms, flown.ins.tt_s, [x, y, z])?;
        let tau_s = self.flux_bias_tau_s.unwrap_or(f64::INFINITY);
        let field = BodyFieldColumns { x, y, z, bt: None };
        Ok(Some(VectorMagnetometerBias { field, terms, runs, scale_nt: self.bt_scale_nt, sigma_nt, tau_s }))
    }
}

#[cfg(test)]
mod tests {
    use crate::{columns::floats, navigate::testing::*};

    #[test]
    fn unit_the_aircraft_field_is_found_without_a_calibration() {
        let found = run("ekf_online_tl", "mag = 'mag_1_uc'\nwalk_per_hour = 0.0");
        assert!(found.error_m(ROWS - 1) < 30.0, "{}", found.error_m(ROWS - 1));
        let flight = flight();
        let own = |row: usize| {
            let of = |name: &str| floats(&flight, name).unwrap()[row] / 50_000.0;
            40.0 * of("flux_d_x") - 25.0 * of("flux_d_y") + 30.0 * of("flux_d_z")
        };
        let field = found.numbers("aircraft");
        // The comparison ignores a constant, which is not separable from the temporal variation.
        let change = |of: &dyn Fn(usize) -> f64| (400..ROWS).map(of).collect::<Vec<f64>>();
        let (found, truth) = (change(&|row| field[row]), change(&own));
        let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
        let (a, b) = (mean(&found), mean(&truth));
        let worst = found.iter().zip(&truth).map(|(x, y)| ((x - a) - (y - b)).abs()).fold(0.0, f64::max);
        assert!(worst < 3.0, "{worst}");
    }

    #[test]
    fn unit_a_bias_of_the_vector_magnetometer_is_removed() {
        // A bias of 400 nT along the nose turns the direction by half a degree, which changes the aircraft field of 40
        // nT by 0.3 nT.
        let keys = "mag = 'mag_1_uc'\nvector = 'flux_d'\nflux_bias_sigma_nt = 300.0\nwalk_per_hour = 0.0";
        let found = run("ekf_online_tl", keys);
        assert!(found.error_m(ROWS - 1) < 30.0, "{}", found.error_m(ROWS - 1));
        let plain = run("ekf_online_tl", "mag = 'mag_1_uc'\nwalk_per_hour = 0.0");
        let apart =
            found.numbers("lat").iter().zip(plain.numbers("lat")).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        // The vector is exact, so the estimated bias is near zero and hardly changes the position.
        assert!(apart > 0.0 && apart * 111_130.0 < 10.0, "{}", apart * 111_130.0);
        let wrong = flown("ekf_online_tl", &format!("{keys}\nbt_scale_nt = 1000.0"), &flight());
        assert!(wrong.is_ok(), "terms without products have no scale");
    }

    #[test]
    fn unit_missing_inputs_are_reported() {
        assert_refused("ekf_online_tl", "terms = 'tt'", "not a list of terms");
        assert_refused("ekf_online_tl", "flux_bias_sigma_nt = 10.0", "requires `vector`");
        assert_refused("ekf_online_tl", "heading_error_sigma_nt = 10.0", "requires the direction");
        assert_refused("ekf_online_tl", "flux_bias_tau_s = 10.0", "no effect without `flux_bias_sigma_nt`");
        assert_refused("ekf_online_tl", "vector = 'flux_d'", "has no effect");
    }
}
