//! The extended Kalman filter that estimates the Tolles-Lawson coefficients in flight.

use numerics::navigation::{
    online::{LineModel, Magnetometer, OnlineParameters, run},
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::aircraft::{AircraftModel, one_with_models, step_s};
use super::filter::{Flight, Flown, NavigationFilter, Track, filter, state_arrays, state_columns};
use crate::columns::{array, data};

filter! {
    /// The 18-state extended Kalman filter with the Tolles-Lawson coefficients of each magnetometer as further
    /// states: `mag` is not compensated beforehand, and the coefficients follow an aircraft whose field changes.
    ///
    /// Take it where the calibration is old, of another aircraft, or none at all, and the line has manoeuvres: along
    /// a straight line at constant attitude the aircraft's field is a constant, which is told from the map's only as
    /// far as the prior does. A constant among the terms (`bias`) takes what map and compensation leave undetermined,
    /// so that no `offset_window_s` is needed.
    ///
    /// The prior is that of the calibrations under `model`, one or several tables of `fit`, or cold. A scalar
    /// magnetometer among the terms is refused: the filter would subtract what it navigates by. `aircraft` is the field
    /// of the aircraft by the coefficients of the sample; of several magnetometers each has its own, `aircraft_<mag>`.
    /// `residual` is that of the first magnetometer used at a sample, `nis` the mean of those used.
    ///
    /// Source: thesis 000, section 5.5, with its (5.39) left out.
    EkfOnlineTl = "ekf_online_tl", version 1, groups [aircraft: AircraftModel], example "walk_per_hour = 0.1";
    /// The random walk of a coefficient: its one sigma after an hour, over that before the line. With 0 the coefficients
    /// are constants.
    walk_per_hour: f64, unit "1", default 0.1, rule Rule::NotNegative;
    /// A measurement whose squared innovation over its variance is above this is not used.
    gate_nis: Option<f64>, unit "1", absent "all measurements are used", rule Rule::Positive;
    /// How the process noise becomes a step's covariance: to second order, to first order as MagNav.jl, or exactly.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
    /// Append the state `x` and its covariance `p` (row-major), of the 18 states of `ekf`.
    save_state: bool, unit "", default false;
}

/// The columns of the aircraft's field, one a magnetometer.
pub(super) fn aircraft_columns(flight: &Flight) -> Vec<Column> {
    let what = "field of the aircraft by the coefficients of the sample";
    let name = |mag: &String| if flight.mags.len() == 1 { "aircraft".to_owned() } else { format!("aircraft_{mag}") };
    flight.mags.iter().map(|mag| Column::float(name(mag), "nT", what)).collect()
}

impl NavigationFilter for EkfOnlineTl {
    fn reads(&self, flight: &Flight) -> Result<Vec<String>, Vec<Fault>> {
        self.aircraft.reads(flight)
    }

    fn each_magnetometer(&self) -> bool {
        true
    }

    fn takes_models(&self) -> bool {
        true
    }

    fn columns(&self, flight: &Flight) -> Vec<Column> {
        let mut columns = aircraft_columns(flight);
        if self.save_state {
            columns.extend(state_columns());
        }
        columns
    }

    fn navigate(&self, flown: &Flown) -> Result<Track, Fault> {
        one_with_models(flown)?;
        let line = flown.line_with(self.discretisation)?;
        let terms = self.aircraft.terms(flown)?;
        let prior = self.aircraft.prior(&terms.names, step_s(flown), flown.models)?;
        let walk_density: Vec<f64> =
            prior.sigma().iter().map(|sigma| (self.walk_per_hour * sigma).powi(2) / 3600.0).collect();
        let sigma_nt = vec![flown.measurement_sigma_nt; line.ins.len()];
        let magnetometers: Vec<Magnetometer> = flown
            .magnetometers
            .iter()
            .map(|mag| Magnetometer {
                measurement_nt: &mag.measured_nt,
                sigma_nt: &sigma_nt,
                terms: terms.values,
                prior: &prior,
                walk_density: &walk_density,
            })
            .collect();
        let parameters = OnlineParameters {
            gate_nis: self.gate_nis,
            keep_states: self.save_state,
            keep_covariance: self.save_state,
            keep_coefficients: false,
        };
        let mut out = run(&LineModel::of(&line), &magnetometers, None, &parameters).map_err(data)?;
        let states = if self.save_state { state_arrays(&mut out.navigation)? } else { vec![] };
        let mut track = Track::of(flown, out.navigation, self.gate_nis)?;
        track.more.extend(out.magnetometers.into_iter().map(|mag| array(mag.track.aircraft_nt)));
        track.more.extend(states);
        Ok(track)
    }
}
