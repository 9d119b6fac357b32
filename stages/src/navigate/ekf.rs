//! The 18-state extended Kalman filter.

use numerics::navigation::{
    ekf::{EkfParameters, EkfPoint, NavigationOutput, run_together},
    ins_error::InsErrorModel,
    pinson::STATES,
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::filter::{Flown, NavigationFilter, Track, Update, filter};
use crate::columns::{data, list};

/// The states, in the order of thesis 000 (5.14).
const STATE_NAMES: [&str; STATES] = [
    "lat", "lon", "alt", "vn", "ve", "vd", "tilt_n", "tilt_e", "tilt_d", "acc_1", "acc_2", "acc_3", "gyro_1", "gyro_2",
    "gyro_3", "ha", "a_hat", "s",
];

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
    fn columns(&self) -> Vec<Column> {
        if !self.save_state {
            return vec![];
        }
        let states: Vec<String> = STATE_NAMES.map(str::to_owned).to_vec();
        let pairs = STATE_NAMES.iter().flat_map(|a| STATE_NAMES.iter().map(move |b| format!("{a}*{b}"))).collect();
        vec![
            Column::list("x", "", "error state, truth - INS, thesis 000 (5.14); rad, m, s, nT", states),
            Column::list("p", "", "covariance of x, row-major", pairs),
        ]
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
            let Flown { measured_nt, map, core, .. } = flown;
            filters.push(EkfPoint {
                parameters,
                measurement_nt: measured_nt,
                sigma_nt: None,
                map,
                core: core.as_ref(),
            });
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

    fn track(&self, flown: &Flown, out: NavigationOutput) -> Result<Track, Fault> {
        let report = out.report;
        if report.updates == 0 {
            let what = format!(
                "no sample could be used: {} without a measurement, {} off the map",
                report.missing_measurements, report.off_map
            );
            return Err(Fault::data(what).help("does the map cover the flight?"));
        }
        if flown.offset_window_s > 0.0 && report.offset_samples == 0 {
            return Err(Fault::data(
                "no sample within `offset_window_s` has a measurement and a map value, so the offset is unknown",
            ));
        }
        let update = |(residual, (nis, measured)): (&f64, (&f64, &f64))| match self.gate_nis {
            _ if !measured.is_finite() => Update::Missing,
            _ if residual.is_nan() => Update::OffMap,
            Some(gate) if *nis > gate => Update::Gated,
            Some(_) | None => Update::Used,
        };
        let update = out.residual_nt.iter().zip(out.nis.iter().zip(&flown.measured_nt)).map(update).collect();
        let mut more = vec![];
        if self.save_state {
            // The filter's own memory: a long flight's covariances take half a gigabyte.
            more.push(list(out.x.into_flattened(), STATES)?);
            more.push(list(out.p.into_flattened().into_flattened(), STATES * STATES)?);
        }
        Ok(Track {
            lat_deg: out.lat_deg,
            lon_deg: out.lon_deg,
            alt_m: out.alt_m,
            vn_mps: out.vn_mps,
            ve_mps: out.ve_mps,
            vd_mps: out.vd_mps,
            sd_n_m: out.sd_n_m,
            sd_e_m: out.sd_e_m,
            cov_ne_m2: out.cov_ne_m2,
            residual_nt: out.residual_nt,
            nis: out.nis,
            update,
            more,
        })
    }
}
