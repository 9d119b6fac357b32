//! Pools scores over lines, with confidence intervals.

use std::sync::Arc;

use arrow_array::{
    Array, ArrayRef, BooleanArray, Int64Array, StringArray,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use arrow_schema::DataType;
use numerics::regression::bootstrap::{BootstrapResamples, PercentileInterval};
use schemas::{
    CheckpointMonitor, ChoiceRegistry, ChoiceSubset, Column, ColumnType, Fault, LineInput, PassThroughColumns, Role,
    Rule, Stage, StageEntry, StageOutput, StageSchema, SurveyAggregator, SurveyPoint, SurveyStage, Table,
    metric::{Metric, MetricDisplay, MetricPreference, PoolingRule, WeightedScore},
    stage,
};

use crate::{
    columns::{array, shape},
    score::{self, IN_SAMPLE, POOLED_IN_SAMPLE, Scorer, is_pooled_in_sample},
};

stage! {
    /// Pools the scores of lines, with a confidence interval for each pooled value.
    ///
    /// Errors are pooled as root mean squares; ratios and biases are pooled as means. Both are weighted by the number
    /// of samples. `cep` and `r95` are computed from the samples of all lines. Sample counts are added. The bounds of
    /// the interval are percentiles over `draws` resamples of the lines, drawn with replacement. Whole lines are
    /// resampled because the errors within a line are correlated. A single line has no interval (null).
    ///
    /// Each metric is pooled over the lines that are not in sample. If none of these lines has a value, the metric is
    /// pooled over the in-sample lines, and `in_sample` is true. A line is in sample if its scores depend on
    /// a model, a noise estimate or a map that was made from this line, or on a parameter that a search chose with it.
    /// The table `scores_pooled` also pools the in-sample lines if other lines exist.
    ///
    /// `train` lists the lines to which the model was fitted, and adds the metric `overfitting_ratio`. This ratio is
    /// the pooled `std_error` of all other lines, in sample or not, divided by the pooled `std_error` of the training
    /// lines. Without `std_error`, the ratio is computed from `map_std_error`. The ratio is 1 for a model that is as
    /// accurate on new lines as on its training lines, and larger for one that overfits. For its interval, training
    /// lines and other lines are resampled separately.
    ///
    /// Source: van der Meer 2025, (4.9); Efron & Tibshirani 1993, chapter 13.
    Summary = "summary", version 4, grain Survey, role PoolsScores, inputs [input: Scores],
    example r#"
[[stages]]
name  = "summary"
stage = "summary"
input = "score"
"#;
    /// Metrics to pool.
    metrics: ChoiceSubset<Scorer>, unit "", absent "all scored metrics";
    /// Lines to which the model was fitted, for `overfitting_ratio`.
    train: Vec<String>, unit "", default Vec::<String>::new();
    /// Confidence level of the interval.
    level: f64, unit "1", default 0.95, rule Rule::Between(0.5, 0.999);
    /// Number of resamples.
    draws: usize, unit "", default 1000usize, rule Rule::Between(10.0, 100000.0);
    /// Seed for the resamples.
    seed: usize, unit "", default 0usize;
}

/// Catalogue entry of the stage, with `scorers` to pool.
pub fn entry(scorers: Vec<&'static Scorer>) -> StageEntry {
    StageEntry { metrics: METRICS.to_vec(), ..Summary::entry_with(ChoiceRegistry::default().with(scorers)) }
}

const READS: [&str; 4] = ["metric", "value", "n", score::SPREAD];
/// Metrics from which the overfitting ratio is computed; the first available metric is used.
const OVERFITTING: [&Metric; 2] = [&score::STD_ERROR.metric, &score::MAP_STD_ERROR.metric];
/// Metrics that exist only for all lines together, not for a single line.
const METRICS: [Metric; 1] = [OVERFITTING_RATIO];
const OVERFITTING_RATIO: Metric = Metric {
    name: "overfitting_ratio",
    unit: "1",
    meaning: "pooled error of all other lines divided by the pooled error of the training lines",
    pool: PoolingRule::Mean,
    better: MetricPreference::Lower,
    shown: MetricDisplay::NOWHERE,
    baseline: None,
    limit: None,
};

impl Stage for Summary {
    fn yields(&self, inputs: &[&Table]) -> Result<StageSchema, Vec<Fault>> {
        let shape = shape(inputs, 0)?;
        if READS.iter().any(|name| shape.get(name).is_none()) {
            return Err(vec![Fault::new("`input` is not a score table").of_param("input")]);
        }
        let made = |c: Column| c.from(0, &READS);
        let columns = vec![
            made(Column::text("metric", "name of the metric").role(Role::Key)),
            made(Column::float("value", "", "pooled value; null without samples")),
            made(Column::float("low", "", "lower end of the confidence interval; null with fewer than two lines")),
            made(Column::float("high", "", "upper end of the confidence interval")),
            made(Column::text("unit", "unit of the value")),
            made(Column::integer("lines", "", "number of lines")),
            made(Column::integer("n", "", "number of samples or pairs")),
            made(Column {
                column_type: ColumnType::Other(DataType::Boolean),
                ..Column::float(IN_SAMPLE, "", POOLED_IN_SAMPLE).role(Role::Key)
            }),
        ];
        let mut yields = StageSchema::append(columns, &READS);
        yields.reads.iter_mut().for_each(|reads| reads.push(IN_SAMPLE.to_owned()));
        yields.passes = PassThroughColumns::None;
        Ok(yields)
    }
}

impl SurveyStage for Summary {
    type Gather = SummaryAggregator;

    fn gather(points: Vec<SurveyPoint<Self>>) -> SummaryAggregator {
        SummaryAggregator { points: points.into_iter().map(|point| point.stage.clone()).collect() }
    }
}

/// One score of one line.
#[derive(Clone, Debug)]
struct SummaryScore {
    metric: &'static Metric,
    value: f64,
    n: i64,
    spread: Vec<f64>,
    in_sample: bool,
}

impl SummaryScore {
    /// A score of a held-out line.
    fn new(known: &[&'static Scorer], metric: &str, value: f64, n: i64, spread: Vec<f64>) -> Result<Self, Fault> {
        let declared = known.iter().map(|scorer| &scorer.metric).find(|m| m.name == metric);
        let undeclared = || Fault::data(format!("`{metric}` is not a metric of `score`")).in_column("metric");
        Ok(Self { metric: declared.ok_or_else(undeclared)?, value, n, spread, in_sample: false })
    }

    /// Value and its weight.
    fn weighed(&self) -> WeightedScore<'_> {
        WeightedScore { value: self.value, n: self.n as f64, spread: &self.spread }
    }
}

/// Contribution of one line.
pub struct SummaryLine {
    line: String,
    scores: Vec<SummaryScore>,
}

/// Points of a sweep over the scores of the same lines.
pub struct SummaryAggregator {
    points: Vec<Summary>,
}

impl SurveyAggregator for SummaryAggregator {
    type Part = SummaryLine;

    fn map(&self, line: &LineInput) -> Result<SummaryLine, Fault> {
        let batch = &line.inputs[0];
        let text = |name: &str| batch.column_by_name(name).and_then(|a| a.as_string_opt::<i32>());
        let value = batch.column_by_name("value").and_then(|a| a.as_primitive_opt::<Float64Type>());
        let n = batch.column_by_name("n").and_then(|a| a.as_primitive_opt::<Int64Type>());
        let (Some(metric), Some(value), Some(n)) = (text("metric"), value, n) else {
            return Err(Fault::data("the scores of the line lack the column `metric`, `value` or `n`"));
        };
        // All points use the same list.
        let known = self.points.first().map(|point| point.metrics.all()).unwrap_or_default();
        let spreads = batch.column_by_name(score::SPREAD).and_then(|a| a.as_list_opt::<i32>());
        let seen = batch.column_by_name(IN_SAMPLE).and_then(|a| a.as_boolean_opt());
        let in_sample = |i: usize| seen.is_some_and(|a| a.is_valid(i) && a.value(i));
        let scores = metric.iter().zip(value.iter().zip(n.iter())).enumerate();
        let scores = scores.filter_map(|(i, (metric, (value, n)))| {
            let score = SummaryScore::new(known, metric?, value?, n?, score::spread_at(spreads, i));
            Some(score.map(|score| SummaryScore { in_sample: in_sample(i), ..score }))
        });
        Ok(SummaryLine { line: line.line.clone(), scores: scores.collect::<Result<_, _>>()? })
    }

    fn finish(&self, parts: Vec<SummaryLine>, _: &dyn CheckpointMonitor) -> Vec<Result<StageOutput, Fault>> {
        let parts: Vec<&SummaryLine> = parts.iter().collect();
        self.points.iter().map(|point| point.table(&parts).map(StageOutput::from)).collect()
    }
}

/// A pooled value.
struct SummaryFigure {
    metric: &'static Metric,
    value: f64,
    interval: Option<PercentileInterval>,
    lines: usize,
    n: i64,
    in_sample: bool,
}

impl Summary {
    fn table(&self, parts: &[&SummaryLine]) -> Result<Vec<ArrayRef>, Fault> {
        for name in &self.train {
            if !parts.iter().any(|p| p.line == *name) {
                let what = format!("`train` names the line `{name}`, which was not scored");
                return Err(Fault::data(what).help("name lines that the table of scores contains"));
            }
        }
        let mut rows: Vec<SummaryFigure> =
            self.metrics_of(parts).into_iter().map(|metric| self.pooled(metric, parts)).collect();
        if !self.train.is_empty() {
            rows.extend(self.overfitting(parts));
        }
        let ends = |end: fn(&PercentileInterval) -> f64| -> ArrayRef {
            Arc::new(rows.iter().map(|r| r.interval.as_ref().map(end)).collect::<arrow_array::Float64Array>())
        };
        let text = |of: fn(&SummaryFigure) -> &str| -> ArrayRef {
            Arc::new(rows.iter().map(|r| Some(of(r))).collect::<StringArray>())
        };
        Ok(vec![
            text(|r| r.metric.name),
            array(rows.iter().map(|r| r.value).collect()),
            ends(|i| i.low),
            ends(|i| i.high),
            text(|r| r.metric.unit),
            Arc::new(rows.iter().map(|r| Some(r.lines as i64)).collect::<Int64Array>()),
            Arc::new(rows.iter().map(|r| Some(r.n)).collect::<Int64Array>()),
            Arc::new(rows.iter().map(|r| Some(r.in_sample)).collect::<BooleanArray>()),
        ])
    }

    /// The metrics to pool, in the order in which they first appear.
    fn metrics_of(&self, parts: &[&SummaryLine]) -> Vec<&'static Metric> {
        let mut found: Vec<&'static Metric> = vec![];
        for SummaryScore { metric, .. } in parts.iter().flat_map(|p| &p.scores) {
            let wanted = self.metrics.wanted().any(|scorer| scorer.metric.name == metric.name);
            if wanted && !found.iter().any(|m| m.name == metric.name) {
                found.push(metric);
            }
        }
        found
    }

    fn pooled(&self, metric: &'static Metric, parts: &[&SummaryLine]) -> SummaryFigure {
        let mut scores = scores_of(metric, parts);
        let seen = scores.iter().filter(|s| s.in_sample).count();
        let in_sample = is_pooled_in_sample(scores.len() - seen, seen);
        scores.retain(|s| s.in_sample == in_sample);
        let draws = BootstrapResamples::new(scores.len(), self.draws, self.seed as u64);
        let drawn = draws.values(|chosen| metric.pool.value(chosen.map(|i| scores[i].weighed())));
        SummaryFigure {
            metric,
            value: metric.pool.value(scores.iter().map(|s| s.weighed())),
            interval: of_several(scores.len(), drawn, self.level),
            lines: scores.len(),
            n: scores.iter().map(|s| s.n).sum(),
            in_sample,
        }
    }

    /// Error of the other lines divided by the error of the training lines.
    fn overfitting(&self, parts: &[&SummaryLine]) -> Option<SummaryFigure> {
        let (train, test): (Vec<&SummaryLine>, Vec<&SummaryLine>) =
            parts.iter().partition(|p| self.train.contains(&p.line));
        let metric = OVERFITTING.into_iter().find(|m| !scores_of(m, &train).is_empty())?;
        let (train, test) = (scores_of(metric, &train), scores_of(metric, &test));
        let drawn = |scores: &[&SummaryScore], seed: u64| {
            let draws = BootstrapResamples::new(scores.len(), self.draws, seed);
            draws.values(|chosen| metric.pool.value(chosen.map(|i| scores[i].weighed())))
        };
        let all = |scores: &[&SummaryScore]| metric.pool.value(scores.iter().map(|s| s.weighed()));
        // Numerator and denominator use independent random streams. The second starts at a seed that users cannot set.
        let (new, own) = (drawn(&test, self.seed as u64), drawn(&train, !(self.seed as u64)));
        let ratios = new.iter().zip(&own).map(|(new, own)| new / own).collect();
        Some(SummaryFigure {
            metric: &OVERFITTING_RATIO,
            value: all(&test) / all(&train),
            interval: of_several(test.len(), ratios, self.level),
            lines: train.len() + test.len(),
            n: train.iter().chain(&test).map(|s| s.n).sum(),
            in_sample: test.iter().any(|s| s.in_sample),
        })
    }
}

/// Confidence interval of a value pooled over several lines. `None` for a single line.
fn of_several(lines: usize, drawn: Vec<f64>, level: f64) -> Option<PercentileInterval> {
    if lines < 2 { None } else { PercentileInterval::central(drawn, level) }
}

fn scores_of<'a>(metric: &Metric, parts: &[&'a SummaryLine]) -> Vec<&'a SummaryScore> {
    let scores = parts.iter().flat_map(|p| &p.scores);
    scores.filter(|s| s.metric.name == metric.name && s.value.is_finite() && s.n > 0).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use schemas::ChoiceList;

    use super::*;
    use crate::score::metrics::SCORERS;

    fn summary(train: &[&str]) -> Summary {
        Summary {
            metrics: ChoiceSubset::new(Arc::new(ChoiceList::new(SCORERS.to_vec())), None),
            train: train.iter().map(ToString::to_string).collect(),
            level: 0.9,
            draws: 500,
            seed: 1,
        }
    }

    fn part(line: &str, std_nt: f64, n: i64) -> SummaryLine {
        let scores = [("std_error", std_nt), ("nees", 2.0), ("samples_used", 10.0)];
        let scores =
            scores.map(|(metric, value)| SummaryScore::new(SCORERS, metric, value, n, vec![]).unwrap()).to_vec();
        SummaryLine { line: line.into(), scores }
    }

    fn column(table: &[ArrayRef], i: usize) -> Vec<f64> {
        table[i].as_primitive::<Float64Type>().iter().map(|v| v.unwrap_or(f64::NAN)).collect()
    }

    #[test]
    fn unit_errors_are_pooled_by_squares_and_ratios_by_means() {
        let parts = [part("1", 3.0, 100), part("2", 4.0, 300)];
        let table = summary(&[]).table(&parts.iter().collect::<Vec<_>>()).unwrap();
        assert_eq!(column(&table, 1), [((9.0 * 100.0 + 16.0 * 300.0) / 400.0f64).sqrt(), 2.0, 20.0]);
        let (low, high) = (column(&table, 2), column(&table, 3));
        assert_eq!((low[0], high[0]), (3.0, 4.0));
        assert_eq!((low[1], high[1]), (2.0, 2.0));
    }

    #[test]
    fn unit_undeclared_metrics_are_not_pooled() {
        assert!(SummaryScore::new(SCORERS, "std_eror", 1.0, 1, vec![]).unwrap_err().to_string().contains("`std_eror`"));
    }

    #[test]
    fn unit_a_single_line_has_no_interval() {
        let parts = [part("1", 3.0, 100)];
        let table = summary(&[]).table(&parts.iter().collect::<Vec<_>>()).unwrap();
        assert_eq!(column(&table, 1)[0], 3.0);
        assert!(column(&table, 2)[0].is_nan() && column(&table, 3)[0].is_nan());
    }

    #[test]
    fn unit_lines_in_sample_are_pooled_only_without_held_out_lines() {
        let seen = |part: SummaryLine| {
            let scores = part.scores.into_iter().map(|score| SummaryScore { in_sample: true, ..score }).collect();
            SummaryLine { scores, ..part }
        };
        let (mut held_out, others) = (part("1", 3.0, 100), [seen(part("2", 4.0, 300)), seen(part("3", 1.0, 100))]);
        // The held-out line has no value of `nees`, so the values of the other lines are used.
        held_out.scores[1].value = f64::NAN;
        let parts: Vec<&SummaryLine> = std::iter::once(&held_out).chain(&others).collect();
        let table = summary(&[]).table(&parts).unwrap();
        assert_eq!(column(&table, 1), [3.0, 2.0, 10.0]);
        let lines = table[5].as_primitive::<Int64Type>().values();
        assert_eq!(lines, &[1, 2, 1]);
        let marks: Vec<bool> = table[7].as_boolean().iter().flatten().collect();
        assert_eq!(marks, [false, true, false]);
    }

    #[test]
    fn unit_overfitting_is_new_error_divided_by_training_error() {
        let parts = [part("1", 2.0, 100), part("2", 6.0, 100), part("3", 6.0, 100)];
        let table = summary(&["1"]).table(&parts.iter().collect::<Vec<_>>()).unwrap();
        assert_eq!(column(&table, 1)[3], 3.0);
        let refused = summary(&["9"]).table(&parts.iter().collect::<Vec<_>>()).unwrap_err();
        assert!(refused.to_string().contains("`9`"), "{refused}");
    }
}
