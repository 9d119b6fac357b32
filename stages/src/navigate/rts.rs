//! The fixed-interval smoother.

use std::sync::Arc;

use arrow_array::{ArrayRef, StringArray};
use numerics::navigation::{
    line::NavigationLine,
    loss::Loss,
    output::NavigationOutput,
    rts::{self, SmootherParameters, SmootherReport},
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::aiding::{Aiding, both};
use super::filter::{Flight, Flown, NavigationFilter, Track, filter, state_arrays, state_columns};
use super::further::{Further, updates};
use crate::columns::{array, data};

filter! {
    /// The most probable trajectory of the whole line, given all its measurements: a smoother, for after the flight. It
    /// linearises the map along the trajectory until that no longer moves, forward and backward over the line each time,
    /// and says how sure it is. At the last sample it knows what a filter knows; before, a few times as much.
    ///
    /// The position of a sample is of all measurements, `residual` and `nis` are of those before it, so that the mean
    /// of `nis` is 1 as a filter's. With a robust loss an outlier draws little: `huber` with a constant force, `cauchy` the
    /// less the farther it is off, which needs a fair start. `smoothing` is `converged`, or `stopped` where the iteration
    /// ended before the trajectory stood still; `smoothing_step` then tells by how much it still moves.
    ///
    /// A line takes five to ten times as long as with `ekf`, and 0.8 kB a sample (2.6 kB more with `save_state`). With further
    /// measurements it is 15 kB a sample, the iteration has one start, and a loss is of the scalar field alone.
    ///
    /// Source: Bierman 1973 (modified Bryson-Frazier form, which inverts no covariance); Bell 1994 (iterated Kalman
    /// smoother); Holland and Welsch 1977 (reweighting).
    Rts = "rts", version 1, groups [aiding: Aiding, further: Further], example "loss = \"huber\"";
    /// The most passes over the line.
    iterations: usize, unit "1", default 20usize, rule Rule::Between(1.0, 1000.0);
    /// The iteration ends where a step moves no position of the line by as much as this.
    tolerance_m: f64, unit "m", default 0.1, rule Rule::Positive;
    /// The loss of a residual: the square, Huber's, or Cauchy's.
    loss: Loss, unit "", default Loss::None;
    /// Where a robust loss leaves the square, in standard deviations of the measurement.
    loss_scale: Option<f64>, unit "1", absent "1.345 with `huber`, 2.385 with `cauchy`: 95 % efficient at normal noise",
        rule Rule::Positive;
    /// Append the state `x` and its covariance `p` (row-major).
    save_state: bool, unit "", default false;
    /// How the process noise becomes a step's covariance: to second order, to first order as MagNav.jl, or exactly.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
}

impl NavigationFilter for Rts {
    fn reads(&self, flight: &Flight) -> Result<Vec<String>, Vec<Fault>> {
        both(self.aiding.reads(flight), both(self.further.reads(flight), self.further.no_latency()))
    }

    fn takes_field(&self) -> bool {
        self.further.use_scalar
    }

    fn takes_direction(&self) -> bool {
        self.further.takes_direction()
    }

    fn columns(&self, _: &Flight) -> Vec<Column> {
        let mut columns = vec![
            Column::text("smoothing", "how the iteration of the line ended: converged or stopped"),
            Column::float("smoothing_step", "m", "how far its last step moves a position of the line at the most"),
        ];
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
        let what = match key {
            "loss_scale" if self.loss == Loss::None => "`loss_scale` has no say with `loss = \"none\"`",
            "tolerance_m" if self.iterations == 1 => "`tolerance_m` has no say with `iterations = 1`",
            _ => return self.aiding.idle(key).or_else(|| self.further.idle(key)),
        };
        Some(Fault::new(what).of_param(key))
    }

    fn navigate(&self, flown: &Flown) -> Result<Track, Fault> {
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line_with(self.discretisation)? };
        let parameters = SmootherParameters {
            iterations: self.iterations,
            tolerance_m: self.tolerance_m,
            loss: self.loss,
            loss_scale: self.loss_scale,
            keep_states: self.save_state,
            keep_covariance: self.save_state,
        };
        if self.further.is_any() {
            let measured = self.further.measured(flown)?;
            let smoothed = rts::run_aided(&line, &parameters, &self.further.aids(flown, &measured)?).map_err(data)?;
            self.further.enough(flown, &smoothed.line.report)?;
            let mut output = smoothed.line;
            let mut more = self.more(&smoothed.iterations, &mut output)?;
            more.extend(self.further.arrays(smoothed.aids, Default::default(), smoothed.slope_nt_per_m));
            return Ok(Track { more, update: updates(&smoothed.usage), ..Track::without_updates(output) });
        }
        let smoothed = rts::run(&line, &parameters).map_err(data)?;
        let mut output = smoothed.line;
        let more = self.more(&smoothed.iterations, &mut output)?;
        Ok(Track { more, ..Track::of(flown, output, None)? })
    }
}

impl Rts {
    /// How the iteration ended, and the states where they are asked for.
    fn more(&self, report: &SmootherReport, output: &mut NavigationOutput) -> Result<Vec<ArrayRef>, Fault> {
        let (word, rows) = (if report.converged { "converged" } else { "stopped" }, output.lat_deg.len());
        let words: StringArray = std::iter::repeat_n(Some(word), rows).collect();
        let mut more: Vec<ArrayRef> = vec![Arc::new(words), array(vec![report.last_step_m; rows])];
        if self.save_state {
            more.extend(state_arrays(output)?);
        }
        Ok(more)
    }
}

#[cfg(test)]
mod tests {
    use crate::navigate::testing::*;

    #[test]
    fn law_a_smoother_knows_more_than_a_filter_but_at_the_end() {
        let (smoothed, filtered) = (run("rts", "mag = 'mag_1_c'"), run("ekf", "mag = 'mag_1_c'"));
        let sum = |of: &Answer| (0..ROWS).map(|row| of.error_m(row).powi(2)).sum::<f64>();
        assert!(sum(&smoothed) < 0.5 * sum(&filtered), "{} {}", sum(&smoothed), sum(&filtered));
        let (sd, filter_sd) = (smoothed.numbers("sd_n"), filtered.numbers("sd_n"));
        assert!(sd[100] < filter_sd[100] && (sd[ROWS - 1] / filter_sd[ROWS - 1] - 1.0).abs() < 0.1);
        assert!(smoothed.words("smoothing").iter().all(|word| word == "converged"));
        assert!(smoothed.numbers("smoothing_step")[0] < 0.1);
    }

    #[test]
    fn law_an_outlier_draws_little_with_a_robust_loss() {
        let spiked = with(&flight(), "mag_1_c", |row, nt| if row % 20 == 7 { nt + 80.0 } else { nt });
        let error = |loss: &str| {
            let found = flown("rts", &format!("loss = '{loss}'\nmag = 'mag_1_c'"), &spiked).unwrap();
            (0..ROWS).map(|row| found.error_m(row).powi(2)).sum::<f64>()
        };
        assert!(error("huber") < 0.5 * error("none") && error("cauchy") < 0.5 * error("none"));
    }

    #[test]
    fn unit_keys_without_a_say_are_told() {
        assert_refused("rts", "loss_scale = 2.0", "no say with `loss = \"none\"`");
        assert_refused("rts", "iterations = 1\ntolerance_m = 1.0", "no say with `iterations = 1`");
        assert_refused("rts", "loss = 'tukey'", "tukey");
    }
}
