//! The 18-state extended Kalman filter.

use numerics::navigation::{
    ekf::{EkfParameters, EkfPoint, run_together},
    ins_error::InsErrorModel,
    output::NavigationOutput,
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::filter::{Flight, Flown, NavigationFilter, Track, filter, state_arrays, state_columns};
use crate::columns::data;

filter! {
    /// The 18-state extended Kalman filter: position, velocity, tilt, accelerometer and gyro biases, the barometer loop, and
    /// the temporal variation. The map is linearised at the estimated position of each sample.
    ///
    /// Source: thesis 000, section 5.3, with F and H checked against finite differences and the process noise discretised.
    Ekf = "ekf", version 1, example "discretisation = \"trapezoidal\"";
    /// Append the state `x` and its covariance `p` (row-major).
    save_state: bool, unit "", default false;
    /// A measurement whose squared innovation over its variance is above this is not used.
    gate_nis: Option<f64>, unit "1", absent "all measurements are used", rule Rule::Positive;
    /// How the process noise becomes a step's covariance: to second order, to first order as MagNav.jl, or exactly.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
}

impl NavigationFilter for Ekf {
    fn columns(&self, _: &Flight) -> Vec<Column> {
        if self.save_state { state_columns() } else { vec![] }
    }

    fn navigate(&self, flown: &Flown) -> Result<Track, Fault> {
        // One point has one answer.
        Self::navigate_points(&[(self, flown)]).pop().unwrap_or_else(|| Err(Fault::bug("a point was lost")))
    }

    fn navigate_points(points: &[(&Self, &Flown)]) -> Vec<Result<Track, Fault>> {
        let Some((_, first)) = points.first() else { return vec![] };
        let parameters: Vec<EkfParameters> = points.iter().map(|(filter, flown)| filter.parameters(flown)).collect();
        let mut filters: Vec<EkfPoint> = vec![];
        for ((_, flown), parameters) in points.iter().zip(&parameters) {
            let map = match flown.needed_map() {
                Ok(map) => map,
                Err(fault) => return points.iter().map(|_| Err(fault.clone())).collect(),
            };
            let (measurement_nt, sigma_nt) = (flown.measured_nt.as_slice(), Some(flown.sigma_nt.as_slice()));
            filters.push(EkfPoint { parameters, measurement_nt, sigma_nt, map, core: flown.core.as_ref() });
        }
        let outputs = run_together(&first.ins, &filters);
        points.iter().zip(outputs).map(|((filter, flown), out)| filter.track(flown, out.map_err(data)?)).collect()
    }
}

impl Ekf {
    fn parameters(&self, flown: &Flown) -> EkfParameters {
        EkfParameters {
            errors: InsErrorModel { noise: self.discretisation, ..flown.errors },
            measurement_sigma_nt: flown.measurement_sigma_nt,
            offset_window_s: flown.offset_window_s,
            gate_nis: self.gate_nis,
            keep_states: self.save_state,
            keep_covariance: self.save_state,
        }
    }

    fn track(&self, flown: &Flown, mut out: NavigationOutput) -> Result<Track, Fault> {
        let states = if self.save_state { state_arrays(&mut out)? } else { vec![] };
        Ok(Track { more: states, ..Track::of(flown, out, self.gate_nis)? })
    }
}
