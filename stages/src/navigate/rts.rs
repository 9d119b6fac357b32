//! The fixed-interval smoother.

use std::sync::Arc;

use arrow_array::{ArrayRef, StringArray};
use numerics::navigation::{
    line::NavigationLine,
    loss::TrajectoryLoss,
    output::NavigationOutput,
    rts::{self, RtsParameters, RtsReport},
    transition::NoiseDiscretisation,
};
use schemas::{Column, Fault, Rule};

use super::aiding::Aiding;
use super::filter::{FilterFlight, FilterInput, FilterTrack, NavigationFilter, filter, state_arrays, state_columns};
use super::further::{AuxiliaryMeasurements, updates};
use crate::columns::{array, data};

filter! {
    /// A smoother for post-processing. It computes the most probable track, and the covariance of this track, given all
    /// measurements on the line. Each iteration linearises the map along the track and passes forward and backward over
    /// the line, until the track converges. At the last sample, the smoother is as accurate as a filter. At earlier
    /// samples, its error is a few times smaller.
    ///
    /// The position of a sample uses all measurements. `residual` and `nis` use only earlier measurements, so the
    /// expected value of `nis` is 1, as for a filter. A robust loss limits the influence of outliers. With `huber`, the
    /// influence of an outlier is constant. With `cauchy`, the influence decreases as the residual increases, which
    /// requires a good initial track. `smoothing` is `converged`, or `stopped` if the track did not converge within
    /// `iterations`. `smoothing_step` is the largest position change in the last iteration.
    ///
    /// A line takes five to ten times as long as with `ekf`, and requires 0.8 kB of memory per sample (2.6 kB more with
    /// `save_state`). With additional measurements, such as `gradient`, a line requires 15 kB per sample. The smoother
    /// then tries a single initial track instead of up to four, and a robust loss applies only to the total field.
    ///
    /// Source: Bierman 1973 (modified Bryson-Frazier form, which inverts no covariance); Bell 1994 (iterated Kalman
    /// smoother); Holland and Welsch 1977 (reweighting).
    Rts = "rts", version 1, groups [aiding: Aiding, further: AuxiliaryMeasurements], example "loss = \"huber\"";
    /// Maximum number of passes over the line.
    iterations: usize, unit "1", default 20usize, rule Rule::Between(1.0, 1000.0);
    /// Limit on the position change. The iteration ends when no position on the line changes by more than this limit.
    tolerance_m: f64, unit "m", default 0.1, rule Rule::Positive;
    /// Loss function of a residual: quadratic (`none`), or robust to outliers (`huber`, `cauchy`).
    loss: TrajectoryLoss, unit "", default TrajectoryLoss::None;
    /// Residual above which a robust loss departs from the quadratic loss, in standard deviations of the measurement.
    loss_scale: Option<f64>, unit "1",
        absent "1.345 with `huber`, 2.385 with `cauchy` (95 % efficiency for normal noise)",
        rule Rule::Positive;
    /// Appends the state `x` and its covariance `p` (row-major).
    save_state: bool, unit "", default false;
    /// Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of first order as in
    /// MagNav.jl, and `van_loan` exact.
    discretisation: NoiseDiscretisation, unit "", default NoiseDiscretisation::Trapezoidal;
}

impl NavigationFilter for Rts {
    fn reads(&self, _: &FilterFlight) -> Result<Vec<String>, Vec<Fault>> {
        self.further.no_scalar_states()
    }

    fn columns(&self, _: &FilterFlight) -> Vec<Column> {
        let mut columns = vec![
            Column::text("smoothing", "outcome of the iteration: converged or stopped"),
            Column::float("smoothing_step", "m", "largest position change along the line in the last iteration"),
        ];
        if self.save_state {
            columns.extend(state_columns());
        }
        columns
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let what = match key {
            "loss_scale" if self.loss == TrajectoryLoss::None => "`loss_scale` has no effect with `loss = \"none\"`",
            "tolerance_m" if self.iterations == 1 => "`tolerance_m` has no effect with `iterations = 1`",
            _ => return None,
        };
        Some(Fault::new(what).of_param(key))
    }

    fn navigate(&self, flown: &FilterInput) -> Result<FilterTrack, Fault> {
        let line = NavigationLine { fixes: flown.fixes(), ..flown.line_with(self.discretisation)? };
        let parameters = RtsParameters {
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
            more.extend(self.further.arrays(smoothed.aids, smoothed.slope_nt_per_m));
            return Ok(FilterTrack { more, update: updates(&smoothed.usage), ..FilterTrack::without_updates(output) });
        }
        let smoothed = rts::run(&line, &parameters).map_err(data)?;
        let mut output = smoothed.line;
        let more = self.more(&smoothed.iterations, &mut output)?;
        Ok(FilterTrack { more, ..FilterTrack::from_output(flown, output, None)? })
    }
}

impl Rts {
    /// Outcome of the iteration, and the states if they are requested.
    fn more(&self, report: &RtsReport, output: &mut NavigationOutput) -> Result<Vec<ArrayRef>, Fault> {
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
    fn law_a_smoother_is_more_accurate_than_a_filter_except_at_the_end() {
        let (smoothed, filtered) = (run("rts", "mag = 'mag_1_c'"), run("ekf", "mag = 'mag_1_c'"));
        let sum = |of: &NavigateOutput| (0..ROWS).map(|row| of.error_m(row).powi(2)).sum::<f64>();
        assert!(sum(&smoothed) < 0.5 * sum(&filtered), "{} {}", sum(&smoothed), sum(&filtered));
        let (sd, filter_sd) = (smoothed.numbers("sd_n"), filtered.numbers("sd_n"));
        assert!(sd[100] < filter_sd[100] && (sd[ROWS - 1] / filter_sd[ROWS - 1] - 1.0).abs() < 0.1);
        assert!(smoothed.words("smoothing").iter().all(|word| word == "converged"));
        assert!(smoothed.numbers("smoothing_step")[0] < 0.1);
    }

    #[test]
    fn unit_an_outlier_has_little_effect_with_a_robust_loss() {
        let spiked = with(&flight(), "mag_1_c", |row, nt| if row % 20 == 7 { nt + 80.0 } else { nt });
        let error = |loss: &str| {
            let found = flown("rts", &format!("loss = '{loss}'\nmag = 'mag_1_c'"), &spiked).unwrap();
            (0..ROWS).map(|row| found.error_m(row).powi(2)).sum::<f64>()
        };
        assert!(error("huber") < 0.5 * error("none") && error("cauchy") < 0.5 * error("none"));
    }

    #[test]
    fn unit_keys_without_effect_are_reported() {
        assert_refused("rts", "loss_scale = 2.0", "no effect with `loss = \"none\"`");
        assert_refused("rts", "iterations = 1\ntolerance_m = 1.0", "no effect with `iterations = 1`");
        assert_refused("rts", "loss = 'tukey'", "tukey");
    }
}
