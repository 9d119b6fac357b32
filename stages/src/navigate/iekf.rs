//! The iterated extended Kalman filter.

use numerics::navigation::{
    iekf::{self, IekfParameters},
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::filter::{Flight, Flown, NavigationFilter, Track, filter, state_arrays, state_columns};
use crate::columns::data;

filter! {
    /// The 18-state extended Kalman filter that linearises the map again at each estimate of a sample, until the most
    /// probable state is found. Where the position error is not small against the wavelengths of the map, the single
    /// linearisation of `ekf` is wrong and too sure of itself; this one holds on to errors several times as large, at
    /// little more cost.
    ///
    /// A step that would make the state less probable is halved. With `iterations = 1` it is `ekf`.
    ///
    /// Source: Jazwinski 1970, chapter 8; Bell and Cathey 1993, with the line search that they leave out.
    Iekf = "iekf", version 1, example "iterations = 5";
    /// The most linearisations of the map at a sample.
    iterations: usize, unit "1", default 5usize, rule Rule::Between(1.0, 1000.0);
    /// A step that moves the position by less than this is the last.
    tolerance_m: f64, unit "m", default 0.1, rule Rule::Positive;
    /// Append the state `x` and its covariance `p` (row-major).
    save_state: bool, unit "", default false;
    /// A measurement whose squared innovation over its variance is above this is not used.
    gate_nis: Option<f64>, unit "1", absent "all measurements are used", rule Rule::Positive;
    /// How the process noise becomes a step's covariance: to second order, to first order as MagNav.jl, or exactly.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
}

impl NavigationFilter for Iekf {
    fn columns(&self, _: &Flight) -> Vec<Column> {
        if self.save_state { state_columns() } else { vec![] }
    }

    fn idle(&self, key: &str) -> Option<Fault> {
        let idle = key == "tolerance_m" && self.iterations == 1;
        idle.then(|| Fault::new("`tolerance_m` has no say with `iterations = 1`").of_param("tolerance_m"))
    }

    fn navigate(&self, flown: &Flown) -> Result<Track, Fault> {
        let line = flown.line_with(self.discretisation)?;
        let parameters = IekfParameters {
            iterations: self.iterations,
            tolerance_m: self.tolerance_m,
            gate_nis: self.gate_nis,
            keep_states: self.save_state,
            keep_covariance: self.save_state,
        };
        let mut output = iekf::run(&line, &parameters).map_err(data)?.line;
        let more = if self.save_state { state_arrays(&mut output)? } else { vec![] };
        Ok(Track { more, ..Track::of(flown, output, self.gate_nis)? })
    }
}
