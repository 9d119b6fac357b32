//! The iterated extended Kalman filter.

use numerics::navigation::{
    aided::{AidedParameters, Linearisation},
    iekf::{self, IekfParameters},
    line::NavigationLine,
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::aiding::Aiding;
use super::filter::{FilterFlight, FilterInput, FilterTrack, NavigationFilter, filter, state_arrays, state_columns};
use super::further::AuxiliaryMeasurements;
use crate::columns::data;

filter! {
    /// The 18-state iterated extended Kalman filter. At each sample, the filter repeats the linearisation of the map at
    /// each new estimate until it finds the most probable state. If the position error is not small compared with the
    /// wavelengths of the map, the single linearisation of `ekf` is inaccurate, and `ekf` is overconfident. `iekf`
    /// tolerates position errors several times as large as `ekf` does, and takes little more time.
    ///
    /// A step that would make the state less probable is halved. With `iterations = 1`, the filter equals `ekf`.
    ///
    /// Source: Jazwinski 1970, chapter 8; Bell & Cathey 1993, with a line search added.
    Iekf = "iekf", version 2, groups [aiding: Aiding, further: AuxiliaryMeasurements], example "iterations = 5";
    /// Maximum number of linearisations of the map per sample.
    iterations: usize, unit "1", default 5usize, rule Rule::Between(1.0, 1000.0);
    /// The iteration ends when the position changes by less than this distance.
    tolerance_m: f64, unit "m", default 0.1, rule Rule::Positive;
    /// Appends the state `x` and its covariance `p` (row-major).
    save_state: bool, unit "", default false;
    /// Largest accepted NIS (squared innovation divided by its variance) of a measurement.
    gate_nis: Option<f64>, unit "1",
        absent "no gate; with `tuning = \"auto\"`, outliers are rejected before filtering", rule Rule::Positive;
    /// Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of first order as in
    /// MagNav.jl, and `van_loan` exact.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
}

impl NavigationFilter for Iekf {
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

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let idle = key == "tolerance_m" && self.iterations == 1;
        idle.then(|| Fault::new("`tolerance_m` has no effect with `iterations = 1`").of_param("tolerance_m"))
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line_with(self.discretisation)? };
        if self.further.applies_to(flown) {
            let (iterations, tolerance_m) = (self.iterations, self.tolerance_m);
            let parameters = AidedParameters {
                linearisation: Linearisation::Iterated { iterations, tolerance_m },
                gate_nis: self.gate_nis,
                keep_states: self.save_state,
                keep_covariance: self.save_state,
                ..AidedParameters::default()
            };
            let out = self.further.filter(flown, &line, &parameters)?;
            return self.further.track(flown, out, false, self.save_state);
        }
        let parameters = IekfParameters {
            iterations: self.iterations,
            tolerance_m: self.tolerance_m,
            gate_nis: self.gate_nis,
            keep_states: self.save_state,
            keep_covariance: self.save_state,
        };
        let mut output = iekf::run(&line, &parameters).map_err(data)?.line;
        let mut more = if self.save_state { state_arrays(&mut output)? } else { vec![] };
        more.extend(flown.constant_arrays(Default::default()));
        Ok(FilterTrack { more, ..FilterTrack::from_output(flown, output, self.gate_nis)? })
    }
}

#[cfg(test)]
mod tests {
    use crate::navigate::testing::*;

    #[test]
    fn law_one_iteration_equals_the_ekf() {
        let (one, ekf) = (run("iekf", "iterations = 1\nmag = 'mag_2_c'"), run("ekf", "mag = 'mag_2_c'"));
        for (column, unit) in [("lat", 1e-5), ("lon", 1e-5), ("sd_n", 1.0), ("residual", 1.0), ("nis", 1.0)] {
            for (row, (a, b)) in one.numbers(column).iter().zip(ekf.numbers(column)).enumerate() {
                assert!((a - b).abs() < 1e-8 * unit || (a.is_nan() && b.is_nan()), "{column} {row}: {a} {b}");
            }
        }
        assert_eq!(one.words("update"), ekf.words("update"));
        assert_eq!(one.updates("missing"), 30);
    }

    #[test]
    fn unit_it_corrects_the_ins_and_returns_its_state() {
        let found = run("iekf", "save_state = true\nmag = 'mag_1_c'");
        assert!(found.error_m(ROWS - 1) < 30.0, "{}", found.error_m(ROWS - 1));
        assert_eq!((found.numbers("x").len(), found.numbers("p").len()), (18 * ROWS, 324 * ROWS));
        let gated = run("iekf", "gate_nis = 0.5\nmag = 'mag_1_c'");
        assert!(gated.updates("gated") > 10 && gated.updates("used") > 10);
    }

    #[test]
    fn unit_keys_without_effect_are_reported() {
        assert_refused("iekf", "iterations = 1\ntolerance_m = 1.0", "no effect with `iterations = 1`");
        assert_refused("iekf", "iterations = 0", "iterations");
        assert_refused("iekf", "gnss_sigma_m = 1.0", "no effect without `gnss_lost_s`");
    }
}
