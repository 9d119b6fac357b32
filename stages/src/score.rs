//! Scores a compensated signal and a track against the truth.
//!
//! A metric is one item in the file of its subject and one line in the list of `metrics.rs`.

mod line;
pub mod map;
mod metric;
pub mod metrics;
pub mod signal;
mod source;
#[cfg(test)]
mod testing;
pub mod track;

use std::sync::Arc;

use arrow_array::{
    Array, ArrayRef, Float64Array, Int64Array, ListArray, StringArray,
    builder::{Float64Builder, ListBuilder},
    cast::AsArray,
    types::Float64Type,
};
use arrow_schema::{DataType, Field};
pub use numerics::regression::statistics::SampleStatistic;
use schemas::{
    ChoiceRegistry, ChoiceSubset, Column, ColumnType, Fault, LineInput, LineOutput, LineStage, PassThroughColumns,
    Role, Rule, Stage, StageEntry, StageSchema, Table, TableShape,
    metric::{Metric, spread},
    stage,
};

pub use self::{
    line::{CompensationSignals, HorizontalErrors, ScoreLine},
    map::MAP_STD_ERROR,
    metric::{QuantileSamplesFn, ScoreFn, Scorer, metric},
    signal::STD_ERROR,
    source::ScoreSource,
};
use self::{
    signal::{ANOMALY_RETENTION, ANOMALY_RETENTION_SE},
    source::ScoreSourceIndex,
};
use crate::columns::{faults_of, floats, shape};

/// Column with the reason for a missing value.
pub const NOTE: &str = "note";
/// Column with the quantiles of the samples, from which radii are pooled over lines.
pub const SPREAD: &str = "spread";
/// Column in a published table of scores, which states whether the line is in sample.
pub const IN_SAMPLE: &str = "in_sample";

/// Meaning of the column `in_sample` in a table of pooled scores.
pub const POOLED_IN_SAMPLE: &str =
    "true if a line behind the value is in sample: used for a model, noise estimate or map, or to choose a parameter";

/// Whether a pooled score counts as in sample: true if no held-out line has a value. `held_out` and `in_sample` are the
/// numbers of lines with a value.
pub fn is_pooled_in_sample(held_out: usize, in_sample: usize) -> bool {
    held_out == 0 && in_sample > 0
}

stage! {
    /// Scores each line: a compensated signal against the truth, and a track against the true positions.
    ///
    /// `input` names one or several tables with the same samples, for example the table of the compensated signal and
    /// the table of the track. If `metrics` is unset, the stage scores all built-in metrics that can be computed from
    /// these tables. Each metric is a row with `metric`, `value`, `unit` and `n`, the number of samples (for crossings:
    /// number of pairs). Samples with a NaN are excluded from a metric and from its `n`. A metric without samples has a
    /// null value. A metric that cannot be computed for a line, for example because `high_hz` exceeds half the sample
    /// rate, has a null value and the reason in `note`. The other metrics are kept. The run reports a warning; if
    /// `metrics` lists the metric, the run fails.
    ///
    /// The published table also has `in_sample`. It is true if the line was used to fit the model, estimate the noise
    /// or make the map on which the score depends, or to choose a parameter in a search. Such a score measures the
    /// error of the fit, not of a prediction, and is never selected as the best of a sweep. The noise that `navigate`
    /// estimates on the navigated line does not put the line in sample, because the estimate uses no truth data. Models
    /// read from files are assumed to be fitted to other lines.
    ///
    /// The table `scores_pooled` of the pipeline has one row per point and metric. Its `value` pools the lines that are
    /// not in sample (all lines if every line is in sample), and `value_in_sample` pools the others. For a radius
    /// (`cep`, `r95`), `spread` holds quantiles of the samples' errors, from which the pooled radius is computed.
    ///
    /// With `truth`, errors are relative to the truth. Without `truth`, `std_uncompensated` and the improvement ratios
    /// are computed from the signals alone and include the anomaly. The run then lists the metrics that require
    /// `truth`.
    ///
    /// An input table computed by `map_value` adds metrics of the map: the agreement of the signal with the map, the
    /// slope of the map along the track, and the expected accuracy of navigation. `igrf` and, if available, `diurnal`
    /// are first subtracted from the signal. `map_position_bound` is the Cramér-Rao bound on a constant horizontal
    /// position offset when the measurement also contains an unknown constant. It assumes independent sample errors of
    /// `map_sigma_nt`. Correlated errors, such as errors of the map and the temporal variation, make the actual
    /// position error larger than the bound.
    ///
    /// A track is also tested against its own covariance: `nees_consistent` and `nis_consistent` are tests with a 95 %
    /// band. `whiteness` is a fraction of lags; `error_within_3sigma` and `divergence` are fractions of samples. The
    /// expected values of these metrics for a consistent filter are known. The innovations before and after a sample
    /// without a measurement do not count as consecutive. `correlated_nis` is the NIS of averages of many innovations,
    /// which shows whether correlated innovations make the covariance too small.
    ///
    /// Source: Gnadt 2022, (3.45), (3.46); Lee 2019, (66); van der Meer 2025, (2.39) to (2.41); Bar-Shalom, Li &
    /// Kirubarajan 2001, section 5.4; Mehra 1970.
    Score = "score", version 7, grain Line, yields Scores, role Scores, inputs [input: ManyLines],
    example r#"
[[stages]]
name  = "score"
stage = "score"
input = ["compensate", "navigate"]
truth = "mag_1_c"
"#;
    /// Column of the true signal, such as `mag_1_c`.
    truth: Option<String>, unit "nT", absent "metrics that require the truth are not scored";
    /// Metrics to score.
    metrics: ChoiceSubset<Scorer>, unit "", absent "all built-in metrics that can be computed from the inputs";
    /// Column of the compensated signal.
    mag: String, unit "nT", default "mag_c";
    /// Lower corner frequency for `improvement_ratio_band` and `figure_of_merit`.
    low_hz: f64, unit "Hz", default 0.1, rule Rule::NotNegative;
    /// Upper corner frequency for `improvement_ratio_band` and `figure_of_merit`.
    high_hz: f64, unit "Hz", default 0.9, rule Rule::NotNegative;
    /// Order of the band-pass filter for `improvement_ratio_band` and `figure_of_merit`.
    order: usize, unit "", default 4usize, rule Rule::Between(1.0, 12.0);
    /// Standard deviation of the error of a sample, for `map_position_bound`.
    map_sigma_nt: f64, unit "nT", default 5.0, rule Rule::Positive;
}

/// Catalogue entry of the stage, with the metrics `scorers`.
pub fn entry(scorers: Vec<&'static Scorer>) -> StageEntry {
    let metrics = scorers.iter().map(|scorer| scorer.metric).collect();
    StageEntry { metrics, ..Score::entry_with(ChoiceRegistry::default().with(scorers)) }
}

impl Score {
    /// Description of the source that a metric lacks.
    fn lacks(&self, places: &ScoreSourceIndex, scorer: &Scorer) -> Option<String> {
        scorer.needs.iter().find(|s| places.get(**s).is_none()).map(|s| s.words(self))
    }

    /// Notes on the metrics for which nothing but the truth is missing.
    fn not_scored(&self, places: &ScoreSourceIndex) -> Vec<String> {
        let is_missing = |source: &&ScoreSource| places.get(**source).is_none();
        let lacks_truth_alone = |scorer: &&&Scorer| scorer.needs.iter().filter(is_missing).all(|s| s.is_truth());
        let mut notes = vec![];
        for truth in ScoreSource::TRUTHS.iter().filter(is_missing) {
            let lacks_it_first = |scorer: &&&Scorer| scorer.needs.iter().find(is_missing) == Some(truth);
            let found = self.metrics.wanted().collect::<Vec<_>>();
            let found = found.iter().filter(lacks_it_first).filter(lacks_truth_alone);
            let names: Vec<String> = found.map(|scorer| format!("`{}`", scorer.metric.name)).collect();
            if !names.is_empty() {
                notes.push(format!("not scored without {}: {}", truth.words(self), names.join(", ")));
            }
        }
        notes
    }

    /// Requested metrics that can be computed.
    fn chosen(&self, places: &ScoreSourceIndex) -> Vec<&'static Scorer> {
        let mut chosen: Vec<_> = self.metrics.wanted().filter(|s| self.lacks(places, s).is_none()).collect();
        // `anomaly_retention` is always scored with its standard error.
        let at = |chosen: &[&Scorer], scorer: &Scorer| chosen.iter().position(|s| s.metric.name == scorer.metric.name);
        if let (Some(place), None) = (at(&chosen, &ANOMALY_RETENTION), at(&chosen, &ANOMALY_RETENTION_SE)) {
            chosen.insert(place + 1, &ANOMALY_RETENTION_SE);
        }
        chosen
    }

    /// Faults of the requested metrics on these tables.
    fn faults(&self, shapes: &[&TableShape], places: &ScoreSourceIndex) -> Vec<Fault> {
        let mut faults = vec![];
        if let Some(truth) = &self.truth {
            let all: TableShape = TableShape {
                columns: shapes.iter().flat_map(|s| s.columns.shared()).cloned().collect(),
                rate_hz: None,
            };
            faults.extend(faults_of([all.number(truth, "nT")], "truth"));
        }
        for scorer in self.metrics.named() {
            if let Some(lack) = self.lacks(places, scorer) {
                faults.push(Fault::new(format!("`{}` requires {lack}", scorer.metric.name)).of_param("metrics"));
            }
        }
        if faults.is_empty() && self.chosen(places).is_empty() {
            let help = format!("add a table with `{}`, or a track, to `input`", self.mag);
            faults.push(Fault::new("no metric can be scored from these tables").help(help).of_param("input"));
        }
        faults
    }

    /// Columns that the chosen metrics read from each of the `inputs` tables.
    fn reads(&self, places: &ScoreSourceIndex, inputs: usize) -> Vec<Vec<String>> {
        let chosen = self.chosen(places);
        let mut reads = vec![vec!["tt".to_owned()]; inputs];
        for (_, place) in places.iter().filter(|(source, _)| chosen.iter().any(|s| s.reads(*source))) {
            for name in &place.columns {
                if !reads[place.table].contains(name) {
                    reads[place.table].push(name.clone());
                }
            }
        }
        reads
    }
}

impl Stage for Score {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shapes: Vec<&TableShape> = (0..inputs.len()).map(|i| shape(inputs, i)).collect::<Result<_, _>>()?;
        let places = ScoreSourceIndex::find(self, &shapes);
        let faults = self.faults(&shapes, &places);
        if !faults.is_empty() {
            return Err(faults);
        }
        let reads = self.reads(&places, inputs.len());
        let spread = "quantiles of the samples behind a radius, at equal steps of probability; null for other metrics";
        let columns = vec![
            Column::text("flight", "flight identifier").role(Role::Key),
            Column::text("line", "line identifier").role(Role::Key),
            Column::text("metric", "name of the metric").role(Role::Key),
            Column::float("value", "", "score; null without samples"),
            Column::text("unit", "unit of the value"),
            Column::integer("n", "", "number of samples or pairs"),
            Column::text(NOTE, "reason for a missing value; null otherwise"),
            Column { column_type: ColumnType::Other(spread_type()), ..Column::float(SPREAD, "", spread) },
        ];
        let columns = columns.into_iter().map(|c| reads.iter().enumerate().fold(c, |c, (i, names)| c.from(i, names)));
        Ok(StageSchema {
            columns: columns.collect(),
            passes: PassThroughColumns::None,
            reads,
            rate_hz: None,
            features: vec![],
            lenient: false,
            notes: self.not_scored(&places),
        })
    }
}

impl LineStage for Score {
    type Prepared = ();

    fn run(&self, line: &LineInput, (): &()) -> LineOutput {
        same_samples(line)?;
        let shapes: Vec<TableShape> =
            line.inputs.iter().map(|batch| TableShape::from_schema(&batch.schema())).collect();
        let places = ScoreSourceIndex::find(self, &shapes.iter().collect::<Vec<_>>());
        let columns = ScoreLine::new(self, line, &places);
        let rows: Vec<LineMetricRow> =
            self.chosen(&places).into_iter().map(|scorer| LineMetricRow::new(scorer, &columns)).collect();
        let same = |text: &str| -> ArrayRef { Arc::new(StringArray::from(vec![text; rows.len()])) };
        let value = |row: &LineMetricRow| Some(row.figure.value).filter(|v| v.is_finite());
        let mut spreads = ListBuilder::new(Float64Builder::new());
        for row in &rows {
            spreads.append_option(row.spread.as_ref().map(|values| values.iter().copied().map(Some)));
        }
        Ok(vec![
            same(&line.flight),
            same(&line.line),
            Arc::new(rows.iter().map(|r| Some(r.metric.name)).collect::<StringArray>()),
            Arc::new(rows.iter().map(value).collect::<Float64Array>()),
            Arc::new(rows.iter().map(|r| Some(r.metric.unit)).collect::<StringArray>()),
            Arc::new(rows.iter().map(|r| Some(r.figure.n as i64)).collect::<Int64Array>()),
            Arc::new(rows.iter().map(|r| r.note.clone()).collect::<StringArray>()),
            Arc::new(spreads.finish()),
        ])
    }
}

/// Value of one metric on one line.
struct LineMetricRow {
    metric: &'static Metric,
    figure: SampleStatistic,
    spread: Option<Vec<f64>>,
    /// Reason for a missing value.
    note: Option<String>,
}

impl LineMetricRow {
    fn new(scorer: &'static Scorer, line: &ScoreLine) -> LineMetricRow {
        let spread = || scorer.spread.map(|samples| samples(line).map(spread)).transpose();
        let metric = &scorer.metric;
        match (scorer.score)(line).and_then(|figure| Ok((figure, spread()?))) {
            Ok((figure, spread)) => LineMetricRow { metric, figure, spread, note: None },
            Err(fault) => {
                let note = Some(fault.to_string());
                LineMetricRow { metric, figure: SampleStatistic { value: f64::NAN, n: 0 }, spread: None, note }
            }
        }
    }
}

/// The type of the column `spread`.
fn spread_type() -> DataType {
    DataType::List(Field::new_list_field(DataType::Float64, true).into())
}

/// The values of a row of the column `spread`; empty if null.
pub fn spread_at(spreads: Option<&ListArray>, row: usize) -> Vec<f64> {
    let given = spreads.filter(|list| list.is_valid(row)).map(|list| list.value(row));
    let values = given.as_ref().and_then(|values| values.as_primitive_opt::<Float64Type>());
    values.map(|values| values.values().to_vec()).unwrap_or_default()
}

/// Checks that the tables have the same samples.
fn same_samples(line: &LineInput) -> Result<(), Fault> {
    let first = floats(&line.inputs[0], "tt")?;
    for batch in &line.inputs[1..] {
        if floats(batch, "tt")? != first {
            return Err(Fault::data("the tables to score have different samples")
                .in_column("tt")
                .help("set `input` to tables that were made from the same `resample`"));
        }
    }
    Ok(())
}
