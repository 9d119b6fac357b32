//! Low-pass filters columns.

use numerics::signal::{
    filter::{FilterBand, ZeroPhaseFilter},
    resample::{ANTI_ALIAS_FRACTION, ANTI_ALIAS_ORDER},
};
use schemas::{Fault, LineInput, LineOutput, LineStage, Rule, Stage, StageSchema, Table, stage};

use crate::{
    columns::{band, data, made_of_each, not_numbers_among, shape},
    filtered::{AngleTreatment, filtered},
};

stage! {
    /// Removes frequencies above a corner frequency, without lag, and appends `<column>_lp`.
    ///
    /// The filter equals `bandpass` without a lower corner. With `for_rate_hz` instead of `corner_hz` it is an
    /// anti-alias filter for a later `resample` to that rate. It then has order 8 and a corner at 0.8 of the new
    /// Nyquist frequency. Its attenuation at the new Nyquist frequency is 31 dB.
    ///
    /// Angles (unit deg) are filtered along the shorter arc. A sloping signal is distorted within about 1/`corner_hz`
    /// seconds of the ends of a run. Gaps, short runs and uneven samples are treated as in `bandpass`.
    ///
    /// Source: F. Gustafsson, Determining the initial states in forward-backward filtering, 1996.
    Lowpass = "lowpass", version 2, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name      = "lowpass"
stage     = "lowpass"
input     = "resample"
columns   = ["mag_4_uc"]
corner_hz = 1.0
"#;
    /// Columns to filter.
    columns: Vec<String>, unit "";
    /// Corner frequency. The two passes together halve the amplitude at this frequency.
    corner_hz: Option<f64>, unit "Hz", absent "set by `for_rate_hz`", rule Rule::Positive;
    /// Lower sample rate to which the columns will be resampled.
    for_rate_hz: Option<f64>, unit "Hz", absent "set by `corner_hz`", rule Rule::Positive;
    /// Order of the Butterworth filter.
    order: Option<usize>, unit "", absent "4, or 8 with `for_rate_hz`", rule Rule::Between(1.0, 12.0);
}

impl Lowpass {
    /// Corner frequency, in Hz. `None` if the corner is set twice or not at all.
    fn corner(&self) -> Option<f64> {
        match (self.corner_hz, self.for_rate_hz) {
            (Some(corner_hz), None) => Some(corner_hz),
            (None, Some(rate_hz)) => Some(ANTI_ALIAS_FRACTION * 0.5 * rate_hz),
            (Some(_), Some(_)) | (None, None) => None,
        }
    }

    fn order(&self) -> usize {
        self.order.unwrap_or(if self.for_rate_hz.is_some() { ANTI_ALIAS_ORDER } else { 4 })
    }
}

impl Stage for Lowpass {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults = not_numbers_among(shape, &self.columns, "columns");
        let param = if self.for_rate_hz.is_some() { "for_rate_hz" } else { "corner_hz" };
        match self.corner() {
            Some(corner_hz) => {
                faults.extend(
                    band(0.0, corner_hz, shape.rate_hz).into_iter().map(|f| Fault { param: None, ..f }.of_param(param)),
                );
            }
            None => {
                let what = "set exactly one of `corner_hz` and `for_rate_hz`";
                faults.push(Fault::new(what).of_param(param));
            }
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let made = made_of_each(shape, &self.columns, "_lp", "low-passed", str::to_owned);
        let reads: Vec<&str> = std::iter::once("tt").chain(self.columns.iter().map(String::as_str)).collect();
        Ok(StageSchema::append(made, &reads))
    }
}

impl LineStage for Lowpass {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let high_hz = self.corner().ok_or_else(|| Fault::new("the filter has no corner frequency"))?;
        filtered(&line.inputs[0], &self.columns, AngleTreatment::Unwrapped, |rate_hz| {
            ZeroPhaseFilter::new(FilterBand::Low { high_hz }, rate_hz, self.order()).map_err(data)
        })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::f64::consts::TAU;

    use numerics::signal::resample::anti_alias;
    use schemas::Role;

    use super::*;
    use crate::testing::{batch, fault_texts, line, numbers, sampled, table};

    const RATE_HZ: f64 = 50.0;

    fn lowpass(columns: &[&str], corner_hz: Option<f64>, for_rate_hz: Option<f64>) -> Lowpass {
        Lowpass { columns: columns.iter().map(ToString::to_string).collect(), corner_hz, for_rate_hz, order: None }
    }

    fn run(stage: &Lowpass, unit: &str, of: impl Fn(f64) -> f64) -> Vec<f64> {
        let tt = sampled(0.0, RATE_HZ, 3000, |t| t);
        let x = sampled(0.0, RATE_HZ, 3000, of);
        numbers(stage.run(&line(vec![batch(vec![("tt", "s", tt), ("x", unit, x)])]), &())).unwrap().remove(0)
    }

    #[test]
    fn law_slow_signals_pass_and_fast_ones_are_removed() {
        for (hz, gain) in [(0.1, 1.0), (2.0, 0.5), (10.0, 0.0)] {
            let sine = |t: f64| 10.0 * (TAU * hz * t).sin();
            let y = run(&lowpass(&["x"], Some(2.0), None), "nT", |t| 50_000.0 + sine(t));
            let worst =
                (1000..2000).map(|k| (y[k] - 50_000.0 - gain * sine(k as f64 / RATE_HZ)).abs()).fold(0.0, f64::max);
            assert!(worst < 2e-3, "{hz} Hz: {worst} nT");
        }
    }

    #[test]
    fn unit_a_turn_through_north_is_no_step() {
        let heading = |t: f64| (300.0 + 4.0 * t).rem_euclid(360.0);
        let y = run(&lowpass(&["x"], Some(1.0), None), "deg", heading);
        let off = |k: usize| (y[k] - heading(k as f64 / RATE_HZ)).abs();
        // A straight line is unchanged except within a few seconds of the ends.
        let worst = (300..2700).map(|k| off(k).min((off(k) - 360.0).abs())).fold(0.0, f64::max);
        assert!(worst < 1e-6, "{worst}");
        assert!(y.iter().all(|y| (0.0..360.0).contains(y)));
    }

    #[test]
    fn unit_with_an_output_rate_it_equals_the_anti_alias_filter() {
        let of = |t: f64| 50_000.0 + (TAU * 0.7 * t).sin() + 3.0 * (TAU * 9.3 * t).sin();
        let y = run(&lowpass(&["x"], None, Some(10.0)), "nT", of);
        let (tt, x) = (sampled(0.0, RATE_HZ, 3000, |t| t), sampled(0.0, RATE_HZ, 3000, of));
        assert_eq!(y, anti_alias(&tt, &x, 10.0).unwrap().0);
    }

    #[test]
    fn unit_invalid_corners_are_reported_and_truth_stays_truth() {
        let lines = table(&[("tt", "s"), ("mag_4_uc", "nT"), ("mag_1_c", "nT")], Some(10.0));
        let of = |stage: Lowpass| fault_texts(stage.yields(&[&lines]).unwrap_err());
        assert!(of(lowpass(&["mag_4_uc"], Some(6.0), None)).ends_with("[corner_hz]"));
        assert!(of(lowpass(&["mag_4_uc"], None, Some(20.0))).ends_with("[for_rate_hz]"));
        assert!(of(lowpass(&["mag_4_uc"], None, None)).contains("set exactly one"));
        assert!(of(lowpass(&["mag_4_uc"], Some(1.0), Some(1.0))).contains("set exactly one"));
        assert!(of(lowpass(&["mag_5_uc"], Some(1.0), None)).contains("mag_4_uc"));
        assert!(of(lowpass(&[], Some(1.0), None)).contains("the list of columns is empty"));
        let made = lowpass(&["mag_4_uc", "mag_1_c"], Some(1.0), None).yields(&[&lines]).unwrap().columns;
        let made: Vec<_> = made.iter().map(|c| (c.name.as_str(), c.unit.as_str(), c.role)).collect();
        assert_eq!(made, [("mag_4_uc_lp", "nT", Role::Derived), ("mag_1_c_lp", "nT", Role::Truth)]);
    }
}
