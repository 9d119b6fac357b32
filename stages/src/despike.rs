//! Removes spikes from columns.

use std::sync::Arc;

use arrow_array::{ArrayRef, Int64Array};
use numerics::signal::{
    segments::{RowMask, STEP_TOLERANCE, check_increasing, sample_rate},
    spikes::{fourth_difference, hampel},
};
use schemas::{Column, Fault, LineInput, LineOutput, LineStage, Rule, Stage, StageSchema, Table, choice, stage};

use crate::columns::{array, data, floats, made_of_each, not_numbers_among, role_of, shape};

stage! {
    /// Detects spikes in `columns` and appends two columns for each: `<column>_ds` without the spikes, and
    /// `<column>_spike`, which is 1 for a removed sample and 0 elsewhere.
    ///
    /// `hampel` removes a sample that differs from the median of `window` samples by more than `threshold` standard
    /// deviations of the noise. It detects several adjacent spikes, up to half of the window. It does not require
    /// evenly spaced samples. Use it before `resample`, which would spread a spike to neighbouring samples.
    ///
    /// `fourth_difference` removes a sample whose fourth difference, divided by the square root of 70, exceeds
    /// `threshold` standard deviations of the noise. The divisor is the factor by which a fourth difference amplifies
    /// white noise. The method detects small spikes on steep signals, but not two adjacent spikes. It requires evenly
    /// spaced samples.
    ///
    /// The standard deviation of the noise is estimated as 1.4826 times the median absolute deviation, but at least one
    /// quantisation step. If more than half of the samples in a run hold repeated or interpolated values, the noise is
    /// estimated from the remaining samples. Steps and corners are then not flagged as spikes. Spikes in an otherwise
    /// constant run are kept.
    ///
    /// A spike becomes NaN, or is interpolated linearly in time between its neighbours. At the end of a run it always
    /// becomes NaN. A missing value or a gap in time ends a run. A column in which more than a tenth of the samples are
    /// spikes is rejected: the threshold is too low, or the signal is not smooth. Angles are not unwrapped.
    ///
    /// Source: Hampel 1974, J. Am. Stat. Assoc. 69; Pearson 2002, IEEE Trans. Control Systems Technology 10(1).
    Despike = "despike", version 3, grain Line, inputs [input: Lines],
    example r#"
[[stages]]
name    = "despike"
stage   = "despike"
input   = "flights"
columns = ["mag_4_uc"]
"#;
    /// Columns to despike.
    columns: Vec<String>, unit "";
    /// Method of detection.
    method: SpikeDetection, unit "", default SpikeDetection::Hampel;
    /// Threshold, in standard deviations of the noise.
    threshold: f64, unit "1", default 6.0, rule Rule::Positive;
    /// For `hampel`: odd number of samples in a window.
    window: Option<usize>, unit "", absent "11", rule Rule::Between(3.0, 10001.0);
    /// Replacement of a spike.
    replace: SpikeReplacement, unit "", default SpikeReplacement::Nan;
}

choice! {
    /// Method of detection.
    pub enum SpikeDetection {
        /// Running median.
        Hampel = "hampel",
        /// Fourth difference.
        FourthDifference = "fourth_difference",
    }
}

choice! {
    /// Replacement of a spike.
    pub enum SpikeReplacement {
        /// Missing value.
        Nan = "nan",
        /// Linear interpolation between the neighbours.
        Linear = "linear",
    }
}

/// Largest fraction of spikes in a column.
const MOST_SPIKES: f64 = 0.1;

impl Despike {
    fn window(&self) -> usize {
        self.window.unwrap_or(11)
    }

    fn found(&self, run: &[f64]) -> Vec<bool> {
        match self.method {
            SpikeDetection::Hampel => hampel(run, self.window() / 2, self.threshold),
            SpikeDetection::FourthDifference => fourth_difference(run, self.threshold),
        }
    }

    /// Sample rate from the median step, in Hz. The fourth difference requires even steps.
    fn rate_hz(&self, tt: &[f64]) -> Result<f64, Fault> {
        let tolerance = match self.method {
            SpikeDetection::Hampel => f64::INFINITY,
            SpikeDetection::FourthDifference => STEP_TOLERANCE,
        };
        check_increasing(tt).and_then(|()| sample_rate(tt, tolerance)).map_err(|e| data(e).in_column("tt"))
    }

    /// Column without its spikes, and their locations.
    fn column(&self, tt: &[f64], x: &[f64], rate_hz: f64) -> Result<[ArrayRef; 2], Fault> {
        let (mut made, mut spikes) = (x.to_vec(), vec![false; x.len()]);
        let runs = RowMask::all(x.len()).and_finite(x).runs_in_time(tt, rate_hz);
        for run in &runs {
            let (Some(from), Some(to)) = (x.get(run.clone()), spikes.get_mut(run.clone())) else { continue };
            to.copy_from_slice(&self.found(from));
        }
        let (count, rows) = (spikes.iter().filter(|s| **s).count(), x.iter().filter(|x| x.is_finite()).count());
        if count as f64 > MOST_SPIKES * rows as f64 {
            let what = format!("{count} of {rows} samples are detected as spikes, more than a tenth");
            return Err(Fault::data(what).help("raise `threshold`, or plot the column; it may not be a smooth signal"));
        }
        for run in runs {
            let good: Vec<usize> = run.clone().filter(|i| !spikes[*i]).collect();
            for i in run.filter(|i| spikes[*i]) {
                let after = good.partition_point(|g| *g < i);
                made[i] = match (self.replace, after.checked_sub(1).and_then(|b| good.get(b)), good.get(after)) {
                    (SpikeReplacement::Linear, Some(&a), Some(&b)) => {
                        x[a] + (x[b] - x[a]) * (tt[i] - tt[a]) / (tt[b] - tt[a])
                    }
                    (SpikeReplacement::Linear | SpikeReplacement::Nan, _, _) => f64::NAN,
                };
            }
        }
        let flags = Int64Array::from_iter_values(spikes.into_iter().map(i64::from));
        Ok([array(made), Arc::new(flags)])
    }
}

impl Stage for Despike {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults = not_numbers_among(shape, &self.columns, "columns");
        if self.window().is_multiple_of(2) {
            let what = format!("a window of {} samples has no middle sample", self.window());
            faults.push(Fault::new(what).help("set `window` to an odd number").of_param("window"));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let clean = made_of_each(shape, &self.columns, "_ds", "without spikes", str::to_owned);
        let flag = |name: &String| {
            let column = Column::integer(format!("{name}_spike"), "", format!("1 where {name} had a spike"));
            column.role(role_of(shape, &[name])).from(0, &["tt", name])
        };
        let made = clean.into_iter().zip(&self.columns).flat_map(|(clean, name)| [clean, flag(name)]).collect();
        let reads: Vec<&str> = std::iter::once("tt").chain(self.columns.iter().map(String::as_str)).collect();
        Ok(StageSchema::append(made, &reads))
    }

    fn unused_key(&self, key: &str) -> Option<Fault> {
        let is_unused = key == "window" && self.method == SpikeDetection::FourthDifference;
        is_unused.then(|| Fault::new("`window` has no effect with the method `fourth_difference`"))
    }
}

impl LineStage for Despike {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        let batch = &line.inputs[0];
        let tt = floats(batch, "tt")?;
        let rate_hz = self.rate_hz(tt)?;
        let mut made = vec![];
        for name in &self.columns {
            made.extend(self.column(tt, floats(batch, name)?, rate_hz).map_err(|e| e.in_column(name))?);
        }
        Ok(made)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use arrow_array::{
        cast::AsArray,
        types::{Float64Type, Int64Type},
    };
    use schemas::Role;

    use super::*;
    use crate::testing::{batch, fault_texts, line, sampled, table};

    fn despike(method: SpikeDetection, replace: SpikeReplacement) -> Despike {
        Despike { columns: vec!["x".into()], method, threshold: 6.0, window: None, replace }
    }

    fn run(stage: &Despike, tt: &[f64], x: Vec<f64>) -> Result<(Vec<f64>, Vec<usize>), Fault> {
        let made = stage.run(&line(vec![batch(vec![("tt", "s", tt.to_vec()), ("x", "nT", x)])]), &())?;
        let flags = made[1].as_primitive::<Int64Type>().values().iter().enumerate();
        let spikes = flags.filter(|(_, flag)| **flag == 1).map(|(i, _)| i).collect();
        Ok((made[0].as_primitive::<Float64Type>().values().to_vec(), spikes))
    }

    fn field(rows: usize) -> Vec<f64> {
        let mut normals = numerics::random::NormalGenerator::new(8);
        let smooth = sampled(0.0, 10.0, rows, |t| 50_000.0 + 8.0 * (0.3 * t).sin());
        smooth.into_iter().map(|x| x + 0.1 * normals.draw()).collect()
    }

    #[test]
    fn unit_added_spikes_are_removed_and_other_samples_are_unchanged() {
        let tt = sampled(0.0, 10.0, 1000, |t| t);
        let clean = field(1000);
        let mut x = clean.clone();
        let at = [200, 431, 700];
        at.iter().for_each(|i| x[*i] -= 120.0);
        for method in [SpikeDetection::Hampel, SpikeDetection::FourthDifference] {
            let (y, spikes) = run(&despike(method, SpikeReplacement::Nan), &tt, x.clone()).unwrap();
            assert_eq!(spikes, at);
            assert!((0..1000).all(|i| if at.contains(&i) { y[i].is_nan() } else { y[i] == clean[i] }));
            let (y, _) = run(&despike(method, SpikeReplacement::Linear), &tt, x.clone()).unwrap();
            assert!(at.iter().all(|i| (y[*i] - 0.5 * (clean[i - 1] + clean[i + 1])).abs() < 1e-9));
        }
    }

    #[test]
    fn unit_corners_of_an_interpolated_variation_are_no_spikes() {
        // A diurnal variation with one value per minute, rounded to 0.1 nT and interpolated to 10 Hz.
        let minute = |k: usize| ((30.0 * (0.01 * k as f64).sin() + 4.0 * (0.7 * k as f64).cos()) * 10.0).round() / 10.0;
        let value = |i: usize| minute(i / 600) + (minute(i / 600 + 1) - minute(i / 600)) * (i % 600) as f64 / 600.0;
        let tt = sampled(0.0, 10.0, 36_000, |t| t);
        let mut x: Vec<f64> = (0..36_000).map(value).collect();
        for method in [SpikeDetection::Hampel, SpikeDetection::FourthDifference] {
            assert!(
                run(&despike(method, SpikeReplacement::Nan), &tt, x.clone()).unwrap().1.is_empty(),
                "{}",
                method.word()
            );
        }
        x[9000] += 50.0;
        for method in [SpikeDetection::Hampel, SpikeDetection::FourthDifference] {
            assert_eq!(
                run(&despike(method, SpikeReplacement::Nan), &tt, x.clone()).unwrap().1,
                [9000],
                "{}",
                method.word()
            );
        }
    }

    #[test]
    fn unit_spikes_are_removed_near_gaps_ends_and_at_uneven_times() {
        let mut tt = sampled(0.0, 10.0, 1000, |t| t);
        // A jitter of 2 ms, and a gap of 5 s.
        tt.iter_mut()
            .enumerate()
            .for_each(|(k, t)| *t += if k % 2 == 0 { 0.002 } else { 0.0 } + if k >= 500 { 5.0 } else { 0.0 });
        let mut x = field(1000);
        x[0] += 90.0;
        x[300..303].iter_mut().for_each(|x| *x += 70.0);
        x[800] = f64::NAN;
        let (y, spikes) = run(&despike(SpikeDetection::Hampel, SpikeReplacement::Linear), &tt, x.clone()).unwrap();
        assert_eq!(spikes, [0, 300, 301, 302]);
        assert!(y[0].is_nan() && y[800].is_nan(), "no straight line beyond the end");
        let on = |i: usize| y[299] + (y[303] - y[299]) * (tt[i] - tt[299]) / (tt[303] - tt[299]);
        assert!((300..303).all(|i| (y[i] - on(i)).abs() < 1e-9));
        let uneven = run(&despike(SpikeDetection::FourthDifference, SpikeReplacement::Nan), &tt, x).unwrap_err();
        assert!(uneven.what.contains("not evenly spaced"), "{uneven}");
    }

    #[test]
    fn unit_too_many_spikes_and_even_windows_are_rejected() {
        let tt = sampled(0.0, 10.0, 1000, |t| t);
        let many = Despike { threshold: 0.1, ..despike(SpikeDetection::Hampel, SpikeReplacement::Nan) };
        assert!(run(&many, &tt, field(1000)).unwrap_err().what.contains("of 1000 samples are detected as spikes"));
        let lines = table(&[("tt", "s"), ("mag_1_c", "nT")], None);
        let even = Despike {
            columns: vec!["mag_1_c".into()],
            window: Some(10),
            ..despike(SpikeDetection::Hampel, SpikeReplacement::Nan)
        };
        assert!(fault_texts(even.yields(&[&lines]).unwrap_err()).ends_with("[window]"));
        let made = Despike { window: None, ..even }.yields(&[&lines]).unwrap().columns;
        let made: Vec<_> = made.iter().map(|c| (c.name.as_str(), c.unit.as_str(), c.role)).collect();
        assert_eq!(made, [("mag_1_c_ds", "nT", Role::Truth), ("mag_1_c_spike", "", Role::Truth)]);
    }
}
