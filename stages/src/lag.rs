//! Lags of columns against a reference.

use std::sync::Arc;

use arrow_array::{ArrayRef, Int64Array, RecordBatch, StringArray};
use numerics::signal::{
    lag::{SignalLag, lag_of},
    segments::{RowMask, filter_column},
};
use schemas::{
    CheckpointMonitor, Column, Fault, LineInput, PassThroughColumns, Role, Rule, Stage, StageOutput, StageSchema,
    SurveyAggregator, SurveyPoint, SurveyStage, Table, stage,
};

use crate::{
    bandpass::design,
    columns::{array, band, data, even_rate_hz, floats, not_numbers_among, shape},
};

stage! {
    /// Estimates the lag of each of `columns` relative to `reference` on each line that `where` selects. The lag is at
    /// the peak of the cross-correlation. Each line and column gives a row with `lag_s`. The parameter `lag_s` of
    /// `resample` removes this lag.
    ///
    /// A lag of 0.06 s means column(t) = reference(t - 0.06 s), up to a factor and a constant. Both columns must
    /// measure the same quantity. Examples of such pairs are two magnetometers in a manoeuvre; a scalar magnetometer
    /// and the magnitude of a vector magnetometer; and the turn rate and the derivative of a heading. Slow variations
    /// flatten the correlation peak, so remove them with `low_hz` or with a `derivative` stage before this one. Samples
    /// must be evenly spaced. If the sensors have different rates, first resample them to the same times, at their
    /// highest rate or above.
    ///
    /// `sd_s` is the standard error of the lag if the difference between the two signals is white noise. For correlated
    /// noise, `sd_s` is too small. `correlation` is the correlation coefficient at the peak. `next_peak` is the height
    /// of the second highest peak divided by the height of the highest. If it is near 1, the lag is ambiguous, as for
    /// periodic signals. `n` is the number of sample pairs. The lag is NaN, and a warning is reported, if a line has no
    /// peak within `most_s`, a column is constant, or a line is too short. Missing samples are omitted.
    ///
    /// Source: Carter 1987, Coherence and time delay estimation, Proc. IEEE 75(2).
    LagStage = "lag", version 1, grain Survey, inputs [input: Lines],
    example r#"
[[stages]]
name      = "lag"
stage     = "lag"
input     = "resample"
columns   = ["mag_5_uc"]
reference = "mag_4_uc"
low_hz    = 0.05
"#;
    /// Columns whose lags are estimated.
    columns: Vec<String>, unit "";
    /// Column relative to which the lags are measured.
    reference: String, unit "";
    /// Largest lag of the search, in either direction.
    most_s: f64, unit "s", default 2.0, rule Rule::Positive;
    /// Also accepts a negative correlation, for columns with opposite signs.
    either_sign: bool, unit "", default false;
    /// Lower corner frequency of a band-pass filter for both signals. With 0 the filter has no lower corner.
    low_hz: f64, unit "Hz", default 0.0, rule Rule::NotNegative;
    /// Upper corner frequency of the band-pass filter. With 0 the filter has no upper corner.
    high_hz: f64, unit "Hz", default 0.0, rule Rule::NotNegative;
    /// Order of the Butterworth prototype of the band-pass filter.
    order: usize, unit "", default 4usize, rule Rule::Between(1.0, 12.0);
}

/// Lag of a column, or the reason why it has none.
type LagResult = Result<SignalLag, String>;

impl LagStage {
    /// Values of a column for the correlation; NaN where they are missing or not selected.
    fn signal(
        &self,
        batch: &RecordBatch,
        name: &str,
        rate_hz: f64,
        keep: Option<&Vec<bool>>,
    ) -> Result<Vec<f64>, Fault> {
        let (tt, x) = (floats(batch, "tt")?, floats(batch, name)?);
        let filtered = match design(self.low_hz, self.high_hz, self.order, rate_hz)? {
            None => x.to_vec(),
            Some(filter) => {
                let runs = RowMask::all(x.len()).and_finite(x).runs_in_time(tt, rate_hz);
                filter_column(&filter, x, &runs).map_err(|e| data(e).in_column(name))?.0
            }
        };
        let kept = |row: usize| keep.is_none_or(|keep| keep.get(row).copied().unwrap_or(false));
        Ok(filtered.into_iter().enumerate().map(|(row, x)| if kept(row) { x } else { f64::NAN }).collect())
    }

    /// Lag of each column.
    fn lags(&self, line: &LineInput) -> Result<Vec<LagResult>, Fault> {
        let batch = line.inputs.first().ok_or_else(|| Fault::bug("a stage has no input"))?;
        let tt = floats(batch, "tt")?;
        let rate_hz = even_rate_hz(tt)?;
        // Lags are shifts by whole rows, so a line with a gap in time is rejected.
        let whole = RowMask::all(tt.len()).runs_in_time(tt, rate_hz).len();
        if whole > 1 {
            let fault = Fault::data(format!("the line has {} gaps in time", whole - 1)).in_column("tt");
            return Err(fault.help("`resample` keeps the times inside a gap; select rows with `where` of this stage"));
        }
        let of = |name: &str| self.signal(batch, name, rate_hz, line.keep.as_ref());
        let reference = of(&self.reference)?;
        let one = |name: &String| {
            let found = lag_of(&reference, &of(name)?, rate_hz, self.most_s, self.either_sign);
            Ok(found.map_err(|e| e.to_string()))
        };
        self.columns.iter().map(one).collect()
    }
}

impl Stage for LagStage {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        let mut faults = not_numbers_among(shape, &self.columns, "columns");
        faults.extend(not_numbers_among(shape, std::slice::from_ref(&self.reference), "reference"));
        faults.extend(band(self.low_hz, self.high_hz, shape.rate_hz));
        if self.columns.contains(&self.reference) {
            let what = format!(
                "`{}` is the reference and has no lag against itself; remove the column from `columns`",
                self.reference
            );
            faults.push(Fault::new(what).of_param("columns"));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let mut reads = vec!["tt".to_owned(), self.reference.clone()];
        reads.extend(self.columns.iter().cloned());
        let columns = vec![
            Column::text("flight", "flight identifier").role(Role::Key),
            Column::text("line", "line identifier").role(Role::Key),
            Column::text("column", "name of the column").role(Role::Key),
            Column::float("lag_s", "s", "lag of the column relative to the reference, positive if the column is late"),
            Column::float("sd_s", "s", "standard error of the lag for white noise"),
            Column::float("correlation", "1", "correlation coefficient at the peak"),
            Column::float("next_peak", "1", "height of the second highest peak, divided by the height of the highest"),
            Column::integer("n", "", "number of pairs of samples used"),
        ];
        let columns = columns.into_iter().map(|c| c.from(0, &reads)).collect();
        Ok(StageSchema { passes: PassThroughColumns::None, ..StageSchema::append(columns, &reads) })
    }
}

impl SurveyStage for LagStage {
    type Gather = LagAggregator;

    fn gather(points: Vec<SurveyPoint<Self>>) -> LagAggregator {
        LagAggregator { points: points.into_iter().map(|point| point.stage.clone()).collect() }
    }
}

/// Points of a sweep over the same lines.
pub struct LagAggregator {
    points: Vec<LagStage>,
}

/// Lags of one line at each point of a sweep.
pub struct LineLags {
    flight: String,
    line: String,
    lags: Vec<Result<Vec<LagResult>, Fault>>,
}

impl SurveyAggregator for LagAggregator {
    type Part = LineLags;

    fn map(&self, line: &LineInput) -> Result<LineLags, Fault> {
        let lags = self.points.iter().map(|point| point.lags(line)).collect();
        Ok(LineLags { flight: line.flight.clone(), line: line.line.clone(), lags })
    }

    fn refused(&self, part: &LineLags) -> Vec<(usize, Fault)> {
        part.lags.iter().enumerate().filter_map(|(i, lags)| Some((i, lags.as_ref().err()?.clone()))).collect()
    }

    fn finish(&self, parts: Vec<LineLags>, _: &dyn CheckpointMonitor) -> Vec<Result<StageOutput, Fault>> {
        self.points.iter().enumerate().map(|(i, point)| Ok(table(point, i, &parts))).collect()
    }
}

/// Table of one point.
fn table(point: &LagStage, i: usize, parts: &[LineLags]) -> StageOutput {
    let mut warnings = vec![];
    let mut rows: Vec<([&str; 3], Option<&SignalLag>)> = vec![];
    for part in parts {
        let Some(Ok(lags)) = part.lags.get(i) else { continue };
        for (name, lag) in point.columns.iter().zip(lags) {
            if let Err(why) = lag {
                warnings.push(format!("flight {}, line {}: `{name}` has no lag: {why}", part.flight, part.line));
            }
            rows.push(([part.flight.as_str(), part.line.as_str(), name.as_str()], lag.as_ref().ok()));
        }
    }
    let text =
        |k: usize| -> ArrayRef { Arc::new(rows.iter().map(|(keys, _)| keys.get(k).copied()).collect::<StringArray>()) };
    let figure = |of: fn(&SignalLag) -> f64| array(rows.iter().map(|(_, lag)| lag.map_or(f64::NAN, of)).collect());
    let n = Int64Array::from_iter_values(rows.iter().map(|(_, lag)| lag.map_or(0, |lag| lag.pairs as i64)));
    let columns = vec![
        text(0),
        text(1),
        text(2),
        figure(|lag| lag.lag_s),
        figure(|lag| lag.sd_s),
        figure(|lag| lag.correlation),
        figure(|lag| lag.next_peak),
        Arc::new(n),
    ];
    StageOutput { columns, warnings }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use arrow_array::{
        cast::AsArray,
        types::{Float64Type, Int64Type},
    };

    use super::*;
    use crate::testing::{batch, fault_texts, line, sampled, table as lines_of};

    const RATE_HZ: f64 = 20.0;

    fn lag(columns: &[&str]) -> LagStage {
        LagStage {
            columns: columns.iter().map(ToString::to_string).collect(),
            reference: "mag_1_uc".into(),
            most_s: 1.0,
            either_sign: false,
            low_hz: 0.0,
            high_hz: 0.0,
            order: 4,
        }
    }

    fn waves(t: f64) -> f64 {
        (0.9 * t).sin() + 0.7 * (2.3 * t + 1.0).sin() + 0.5 * (4.1 * t).cos()
    }

    fn delayed_line(late_s: f64, trend: f64) -> LineInput {
        line(vec![batch(vec![
            ("tt", "s", sampled(500.0, RATE_HZ, 2400, |t| t)),
            ("mag_1_uc", "nT", sampled(500.0, RATE_HZ, 2400, |t| 50_000.0 + waves(t))),
            ("mag_2_uc", "nT", sampled(500.0, RATE_HZ, 2400, |t| 48_000.0 + 2.0 * waves(t - late_s) + trend * t)),
            ("dead", "nT", vec![7.0; 2400]),
        ])])
    }

    fn found(stage: &LagStage, lines: &[LineInput]) -> (Vec<f64>, StageOutput) {
        let gather = LagStage::gather(vec![crate::testing::point(stage)]);
        let parts = lines.iter().map(|line| gather.map(line).unwrap()).collect();
        let product = gather.finish(parts, &schemas::NullMonitor).remove(0).unwrap();
        (product.columns[3].as_primitive::<Float64Type>().values().to_vec(), product)
    }

    #[test]
    fn law_the_lag_of_each_line_is_recovered() {
        let (lags, product) = found(&lag(&["mag_2_uc"]), &[delayed_line(0.06, 0.0), delayed_line(-0.215, 0.0)]);
        assert!((lags[0] - 0.06).abs() < 1e-4 && (lags[1] + 0.215).abs() < 1e-4, "{lags:?}");
        assert_eq!(product.columns[2].as_string::<i32>().value(0), "mag_2_uc");
        // Number of overlapping pairs at lags of 1 and 4 samples, the whole numbers nearest to the two lags.
        assert_eq!(product.columns[7].as_primitive::<Int64Type>().values()[..], [2399, 2396]);
        assert!(product.warnings.is_empty());
        // A trend flattens the peak; a band-pass removes the trend.
        let slanted = || delayed_line(0.06, 5.0);
        let band = LagStage { low_hz: 0.1, ..lag(&["mag_2_uc"]) };
        let (with_band, _) = found(&band, &[slanted()]);
        assert!((with_band[0] - 0.06).abs() < 2e-3, "{with_band:?}");
        let without = found(&lag(&["mag_2_uc"]), &[slanted()]).0[0];
        assert!(without.is_nan() || (without - 0.06).abs() >= 2e-3, "{without}");
    }

    #[test]
    fn unit_an_undetermined_lag_is_nan_with_a_warning() {
        let (lags, product) = found(&lag(&["dead", "mag_2_uc"]), &[delayed_line(0.06, 0.0)]);
        assert!(lags[0].is_nan() && (lags[1] - 0.06).abs() < 1e-4);
        assert_eq!(product.warnings.len(), 1);
        assert!(product.warnings[0].contains("line 1.01: `dead` has no lag: one of the signals is constant"));
        let far = LagStage { most_s: 0.2, ..lag(&["mag_2_uc"]) };
        assert!(found(&far, &[delayed_line(0.5, 0.0)]).0[0].is_nan());
    }

    #[test]
    fn unit_lines_with_gaps_and_unselected_rows_are_ignored() {
        let mut gap = delayed_line(0.06, 0.0);
        let (head, tail) = (gap.inputs[0].slice(0, 1000), gap.inputs[0].slice(1200, 1200));
        gap.inputs[0] = arrow_select::concat::concat_batches(&head.schema(), &[head, tail]).unwrap();
        let stage = lag(&["mag_2_uc"]);
        let gather = LagStage::gather(vec![crate::testing::point(&stage)]);
        let part = gather.map(&gap).unwrap();
        assert!(gather.refused(&part)[0].1.what.contains("1 gaps in time"));
        let keep = Some((0..2400).map(|k| k < 1000).collect());
        let (lags, product) = found(&stage, &[LineInput { keep, ..delayed_line(0.06, 0.0) }]);
        assert!((lags[0] - 0.06).abs() < 1e-3);
        assert_eq!(product.columns[7].as_primitive::<Int64Type>().values()[..], [999]);
    }

    #[test]
    fn unit_names_and_corners_are_checked_before_the_run() {
        let lines = lines_of(&[("tt", "s"), ("mag_1_uc", "nT"), ("mag_2_uc", "nT")], Some(RATE_HZ));
        let of = |stage: LagStage| fault_texts(stage.yields(&[&lines]).unwrap_err());
        assert!(of(lag(&["mag_1_uc"])).contains("against itself"));
        assert!(of(lag(&["mag_3_uc"])).ends_with("[columns]"));
        assert!(of(LagStage { reference: "mag".into(), ..lag(&["mag_2_uc"]) }).ends_with("[reference]"));
        assert!(of(LagStage { high_hz: 10.0, ..lag(&["mag_2_uc"]) }).ends_with("[high_hz]"));
        assert_eq!(lag(&["mag_2_uc"]).yields(&[&lines]).unwrap().columns.len(), 8);
    }
}
