//! The 18-state extended Kalman filter.

use numerics::navigation::{
    aided::{AidedParameters, Linearisation},
    ekf::{EkfInput, EkfParameters, run_together},
    ins_error::InsErrorModel,
    line::NavigationLine,
    output::NavigationOutput,
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::aiding::Aiding;
use super::filter::{FilterFlight, FilterInput, FilterTrack, NavigationFilter, filter, state_arrays, state_columns};
use super::further::AuxiliaryMeasurements;
use crate::columns::data;

filter! {
    /// The extended Kalman filter with 18 states: position, velocity, tilt, accelerometer and gyro biases, barometer
    /// loop, and temporal variation. The map is linearised at the estimated position of each sample.
    ///
    /// With `tuning = "auto"` the innovation variance includes the effect of the map's curvature within the position
    /// uncertainty. This effect is computed from second-order divided differences [Nørgaard, Poulsen & Ravn 2000].
    /// Without this term, the first updates after an inaccurate start reduce the covariance too far.
    ///
    /// Source: Gnadt 2022, section 5.3, with discretised process noise. The Jacobians F and H are verified by finite
    /// differences.
    Ekf = "ekf", version 3, groups [aiding: Aiding, further: AuxiliaryMeasurements],
    example "discretisation = \"trapezoidal\"";
    /// Appends the state `x` and its covariance `p` (row-major).
    save_state: bool, unit "", default false;
    /// Largest accepted NIS (squared innovation divided by its variance) of a measurement.
    gate_nis: Option<f64>, unit "1",
        absent "no gate; with `tuning = \"auto\"`, outliers are rejected before filtering", rule Rule::Positive;
    /// Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of first order as in
    /// MagNav.jl, and `van_loan` exact.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
}

impl NavigationFilter for Ekf {
    fn gates(&self) -> bool {
        self.gate_nis.is_some()
    }

    fn takes_scalar_states(&self) -> bool {
        true
    }

    fn columns(&self, _: &FilterFlight) -> Vec<Column> {
        let states = if self.save_state { state_columns() } else { vec![] };
        states.into_iter().collect()
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        // One point gives one result.
        Self::navigate_points(&[(self, flown)])
            .pop()
            .unwrap_or_else(|| Err(Fault::bug("the result of a point is missing")))
    }

    fn navigate_points(points: &[(&Self, &FilterInput)]) -> Vec<Result<FilterTrack, Fault>> {
        // A point with further measurements is filtered alone.
        let usual: Vec<(&Self, &FilterInput)> =
            points.iter().filter(|(filter, flown)| !filter.further.applies_to(flown)).copied().collect();
        let mut together = Self::together(&usual).into_iter();
        let answer = |(filter, flown): &(&Self, &FilterInput)| match filter.further.applies_to(flown) {
            true => filter.alone(flown),
            false => together.next().unwrap_or_else(|| Err(Fault::bug("the result of a point is missing"))),
        };
        points.iter().map(answer).collect()
    }
}

impl Ekf {
    /// Filters the points without further measurements together.
    fn together(points: &[(&Self, &FilterInput)]) -> Vec<Result<FilterTrack, Fault>> {
        let Some((_, first)) = points.first() else { return vec![] };
        let parameters: Vec<EkfParameters> = points.iter().map(|(filter, flown)| filter.parameters(flown)).collect();
        let asked: Vec<Result<_, Fault>> = points.iter().map(|(_, flown)| flown.needed_map()).collect();
        let mut filters: Vec<EkfInput> = vec![];
        for (((_, flown), parameters), asked) in points.iter().zip(&parameters).zip(&asked) {
            let Ok(map) = asked else { continue };
            let (measurement_nt, sigma_nt) = (flown.measured_nt.as_slice(), Some(flown.sigma_nt.as_slice()));
            let (fixes, core) = (flown.fixes(), flown.core.as_ref());
            filters.push(EkfInput { parameters, measurement_nt, sigma_nt, fixes, map, core });
        }
        let mut outputs = run_together(&first.ins, &filters).into_iter();
        let answer = |((filter, flown), asked): (&(&Self, &FilterInput), Result<_, Fault>)| {
            asked?;
            let out = outputs.next().ok_or_else(|| Fault::bug("the result of a point is missing"))?;
            filter.track(flown, out.map_err(data)?)
        };
        points.iter().zip(asked).map(answer).collect()
    }

    /// Filters one point with its further measurements.
    fn alone(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line_with(self.discretisation)? };
        let parameters = AidedParameters {
            linearisation: Linearisation::Once,
            gate_nis: self.gate_nis,
            keep_states: self.save_state,
            keep_covariance: self.save_state,
            ..AidedParameters::default()
        };
        let out = self.further.filter(flown, &line, &parameters)?;
        self.further.track(flown, out, false, self.save_state)
    }

    fn parameters(&self, flown: &FilterInput) -> EkfParameters {
        EkfParameters {
            errors: InsErrorModel { noise: self.discretisation, ..flown.errors },
            measurement_sigma_nt: flown.measurement_sigma_nt,
            offset_window_s: flown.offset_window_s,
            gate_nis: self.gate_nis,
            second_order: flown.second_order,
            keep_states: self.save_state,
            keep_covariance: self.save_state,
        }
    }

    fn track(&self, flown: &FilterInput, mut out: NavigationOutput) -> Result<FilterTrack, Fault> {
        let mut more = if self.save_state { state_arrays(&mut out)? } else { vec![] };
        more.extend(flown.constant_arrays(Default::default()));
        Ok(FilterTrack { more, ..FilterTrack::from_output(flown, out, self.gate_nis)? })
    }
}
