//! The unscented Kalman filter.

use numerics::navigation::{
    aided::{AidedParameters, Linearisation},
    line::NavigationLine,
    transition::NoiseDiscretisation,
    ukf::{UkfParameters, run},
};
use schemas::{Column, Fault, Rule};

use super::aiding::Aiding;
use super::filter::{FilterFlight, FilterInput, FilterTrack, NavigationFilter, filter, state_arrays, state_columns};
use super::further::AuxiliaryMeasurements;
use crate::columns::{array, data};

filter! {
    /// The unscented Kalman filter with the states of `ekf`. Instead of linearising the map at the estimated position,
    /// the filter fits a linear function to the map over the position uncertainty. The fit uses the map values at seven
    /// sigma points: a central one and six outer ones. If the map is linear over the position uncertainty, the filter
    /// equals `ekf`. Otherwise it treats the nonlinearity of the map as noise. Use `ukf` if the position uncertainty
    /// exceeds the node spacing of the map.
    ///
    /// If an outer sigma point is off the map, the map is linearised at the estimated position. `sd_nonlinear` is the
    /// part of the innovation's standard deviation due to the nonlinearity of the map; it is NaN where it is not
    /// computed.
    ///
    /// Source: Julier & Uhlmann 2004; Morelande & Ristic 2006, for a measurement that is nonlinear in the position
    /// only.
    Ukf = "ukf", version 2, groups [aiding: Aiding, further: AuxiliaryMeasurements], example "kappa = 0.0";
    /// Scale factor on the distance of the outer sigma points from the central one.
    alpha: f64, unit "1", default 1.0, rule Rule::Positive;
    /// Parameter in the weight of the central sigma point: the weight in the covariance exceeds the weight in the mean
    /// by 1 - alpha² + beta. The minimum of beta is -alpha² kappa/3. The filter computes the variance due to the
    /// nonlinearity of the field. Averaged over directions, the computed variance is (5 + 4 beta)/8 of the true
    /// variance. With a beta of 2, the filter is therefore cautious.
    beta: f64, unit "1", default 2.0, rule Rule::Finite;
    /// Parameter in the distance of the outer sigma points from the central one, which is alpha sqrt(3 + kappa)
    /// standard deviations. `kappa` must be above -3. With 0, the gain is exact to the fourth moment of a normal
    /// distribution.
    kappa: f64, unit "1", default 0.0, rule Rule::Finite;
    /// Largest accepted NIS (squared innovation divided by its variance) of a measurement.
    gate_nis: Option<f64>, unit "1",
        absent "no gate; with `tuning = \"auto\"`, outliers are rejected before filtering", rule Rule::Positive;
    /// Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of first order as in
    /// MagNav.jl, and `van_loan` exact.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
    /// Appends the state `x` and its covariance `p` (row-major).
    save_state: bool, unit "", default false;
}

impl NavigationFilter for Ukf {
    fn gates(&self) -> bool {
        self.gate_nis.is_some()
    }

    fn takes_scalar_states(&self) -> bool {
        true
    }

    fn columns(&self, _: &FilterFlight) -> Vec<Column> {
        let mut columns = vec![Column::float(
            "sd_nonlinear",
            "nT",
            "standard deviation due to the nonlinearity of the map around the estimate",
        )];
        if self.save_state {
            columns.extend(state_columns());
        }
        columns
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line_with(self.discretisation)? };
        let parameters = UkfParameters {
            alpha: self.alpha,
            beta: self.beta,
            kappa: self.kappa,
            gate_nis: self.gate_nis,
            keep_states: self.save_state,
            keep_covariance: self.save_state,
        };
        if self.further.applies_to(flown) {
            let aided = AidedParameters {
                linearisation: Linearisation::Unscented(parameters),
                gate_nis: self.gate_nis,
                keep_states: self.save_state,
                keep_covariance: self.save_state,
                ..AidedParameters::default()
            };
            let out = self.further.filter(flown, &line, &aided)?;
            return self.further.track(flown, out, true, self.save_state);
        }
        let mut out = run(&parameters, &line).map_err(data)?;
        let states = if self.save_state { state_arrays(&mut out.navigation)? } else { vec![] };
        let mut track = FilterTrack::from_output(flown, out.navigation, self.gate_nis)?;
        track.more.push(array(out.nonlinear_sd_nt));
        track.more.extend(states);
        track.more.extend(flown.constant_arrays(Default::default()));
        Ok(track)
    }
}

#[cfg(test)]
mod tests {
    use crate::navigate::testing::*;

    #[test]
    fn unit_it_corrects_the_ins_and_reports_the_nonlinearity_of_the_map() {
        let found = run("ukf", "mag = 'mag_1_c'\nmap_interpolation = 'cubic'");
        assert!(found.error_m(ROWS - 1) < 30.0, "{}", found.error_m(ROWS - 1));
        let bend = found.numbers("sd_nonlinear");
        // The effect of curvature over a spread σ is proportional to σ².
        let wide = run("ukf", "mag = 'mag_1_c'\nmap_interpolation = 'cubic'\ninit_position_sigma_m = 40.0");
        let wide = wide.numbers("sd_nonlinear")[0];
        assert!((wide / bend[0] - 4.0).abs() < 0.4, "{wide} {}", bend[0]);
        assert!(run("ukf", "mag = 'mag_2_c'").numbers("sd_nonlinear")[110].is_nan(), "no measurement, no bend");
    }

    #[test]
    fn unit_invalid_sigma_points_are_rejected() {
        assert_refused("ukf", "alpha = 0.0", "alpha");
        let fault = flown("ukf", "kappa = -3.0\nmag = 'mag_1_c'", &flight()).unwrap_err();
        assert!(fault.what.contains("kappa"), "{fault:?}");
    }
}
