//! The table of scores for display: one row per sweep point, one column per metric, lines pooled.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use plan::Plan;
use schemas::{Literal, metric::Metric};

use super::{
    pooled::{self, PooledMetric},
    warnings::{Warning, WarningKind},
};

/// Scores of all lines together, by sweep point.
pub struct Scores {
    /// The axes, in the sweep's order.
    pub axes: Vec<String>,
    /// The metric of each column.
    pub metrics: Vec<Metric>,
    /// One row per sweep point: the axis values as text, then a value for each metric.
    pub rows: Vec<(Vec<String>, Vec<Option<f64>>)>,
    /// The largest number of lines of a row, counting in-sample lines, too.
    pub lines: usize,
    /// Number of flagged lines of each row: lines on which the filter diverged or the filter's covariance is wrong.
    pub marks: Vec<usize>,
    /// The flagged rows whose filter is only cautious: its errors are smaller than its covariance predicts.
    pub cautious: Vec<usize>,
    /// The scores of each row on its in-sample lines; empty if no row has in-sample lines.
    pub in_sample: Vec<InSampleScores>,
}

/// Scores of a point on its in-sample lines, which its model, noise, map or search used.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InSampleScores {
    /// Number of in-sample lines.
    pub lines: usize,
    /// Number of out-of-sample lines, over which the values of the row are pooled; if there are none, the values are
    /// pooled over the in-sample lines.
    pub held_out: usize,
    /// For each metric, whether its value comes only from in-sample lines.
    pub metrics: Vec<bool>,
    /// The value of each metric over the in-sample lines.
    pub values: Vec<Option<f64>>,
}

impl Scores {
    /// The scores of the table `t` of `plan` among `pooled`, and the point of each row. Columns are the shown metrics
    /// that have a value.
    pub fn new(plan: &Plan, t: usize, pooled: &[PooledMetric]) -> (Scores, Vec<usize>) {
        let node = &plan.tables[t];
        let own: Vec<&PooledMetric> = pooled.iter().filter(|p| p.table == t).collect();
        let has_value = |m: &Metric| own.iter().any(|p| p.metric.name == m.name && p.shown().value.is_some());
        let mut metrics: Vec<Metric> =
            node.entry.metrics.iter().copied().filter(|m| m.shown.column.is_some() && has_value(m)).collect();
        metrics.sort_by_key(|m| m.shown.column);
        let mut points: BTreeMap<usize, Vec<&PooledMetric>> = BTreeMap::new();
        own.iter().for_each(|p| points.entry(p.instance).or_default().push(p));
        let axes = node.axes.iter().filter_map(|i| plan.spec.axes.get(*i)).map(|a| a.name.clone()).collect();
        let (mut rows, mut in_sample, mut instances, mut most) = (vec![], vec![], vec![], 0);
        for (instance, of_point) in points {
            let of = |m: &Metric| of_point.iter().find(|p| p.metric.name == m.name);
            let key = node.axis_columns(&plan.instance(t, instance), &plan.spec);
            let key = key.into_iter().map(|(_, value)| value.to_string()).collect();
            rows.push((key, metrics.iter().map(|m| of(m)?.shown().value).collect()));
            let lines = |of: fn(&PooledMetric) -> usize| of_point.iter().map(|p| of(p)).max().unwrap_or(0);
            most = most.max(lines(|p| p.held_out.lines + p.in_sample.lines));
            in_sample.push(InSampleScores {
                lines: lines(|p| p.in_sample.lines),
                held_out: lines(|p| p.held_out.lines),
                metrics: metrics.iter().map(|m| of(m).is_some_and(|p| p.is_in_sample())).collect(),
                values: metrics.iter().map(|m| of(m)?.in_sample.value).collect(),
            });
            instances.push(instance);
        }
        if in_sample.iter().all(|row| row.lines == 0) {
            in_sample.clear();
        }
        let marks = vec![0; rows.len()];
        (Scores { axes, metrics, rows, lines: most, marks, cautious: vec![], in_sample }, instances)
    }

    /// Flags the rows of the table `name` that have `warnings`.
    pub fn mark(&mut self, name: &str, warnings: &[Warning]) {
        self.marks = self.marked_lines(name, warnings).iter().map(BTreeSet::len).collect();
        let wrong = self.lines_with(name, warnings, |kind| kind.spoils() && !kind.is_cautious());
        self.cautious = (0..self.marks.len()).filter(|r| self.marks[*r] > 0 && wrong[*r].is_empty()).collect();
    }

    /// Lines of each row (flight and line) that are flagged by `warnings` of the table `name`.
    pub fn marked_lines<'w>(&self, name: &str, warnings: &'w [Warning]) -> Vec<BTreeSet<&'w (String, String)>> {
        self.lines_with(name, warnings, WarningKind::spoils)
    }

    fn lines_with<'w>(
        &self,
        name: &str,
        warnings: &'w [Warning],
        of: fn(WarningKind) -> bool,
    ) -> Vec<BTreeSet<&'w (String, String)>> {
        let spoilt: Vec<&Warning> = warnings.iter().filter(|w| w.stage == name && of(w.kind)).collect();
        let mut lines: HashMap<Vec<AxisWord>, BTreeSet<&(String, String)>> = HashMap::new();
        for warning in &spoilt {
            let point =
                self.axes.iter().map(|a| warning.point.get(a).map(AxisWord::of_value)).collect::<Option<Vec<_>>>();
            if let Some(point) = point {
                lines.entry(point).or_default().extend(&warning.line);
            }
        }
        let number = |axis: &String| {
            matches!(spoilt.first()?.point.get(axis)?, Literal::Int(_) | Literal::Float(_)).then_some(())
        };
        let numbers: Vec<bool> = self.axes.iter().map(|a| number(a).is_some()).collect();
        let word = |(text, number): (&String, &bool)| AxisWord::from_text(text, *number);
        let marks = self.rows.iter().map(|(key, _)| {
            let point: Vec<AxisWord> = key.iter().zip(&numbers).map(word).collect();
            lines.get(&point).cloned().unwrap_or_default()
        });
        marks.collect()
    }

    /// The position of a metric.
    pub fn metric(&self, name: &str) -> Option<usize> {
        self.metrics.iter().position(|m| m.name == name)
    }

    /// The value of a metric at a row.
    pub fn value(&self, row: usize, metric: usize) -> Option<f64> {
        self.rows.get(row).and_then(|(_, values)| values.get(metric).copied().flatten())
    }

    /// The metric that ranks the points: the most significant metric with an out-of-sample value or, if no metric has
    /// such a value, with any value.
    pub fn headline(&self) -> Option<usize> {
        let has = |m: &usize, fit: bool| {
            (0..self.rows.len()).any(|r| self.value(r, *m).is_some() && (fit || !self.is_in_sample(r, *m)))
        };
        let rank = |m: usize| self.metrics[m].shown.rank.map(|rank| (rank, m));
        let ranking = |fit: bool| (0..self.metrics.len()).filter(|m| has(m, fit)).filter_map(rank).min();
        ranking(false).or_else(|| ranking(true)).map(|(_, m)| m)
    }

    /// Whether a row is flagged.
    pub fn is_marked(&self, row: usize) -> bool {
        self.marks.get(row).is_some_and(|n| *n > 0)
    }

    /// Whether a row is flagged only because its filter is cautious.
    pub fn is_cautious(&self, row: usize) -> bool {
        self.cautious.contains(&row)
    }

    /// Whether a row is a Cramér-Rao bound, which is not a result.
    pub fn is_bound(&self, row: usize) -> bool {
        self.metric("drms_bound").is_some_and(|m| self.value(row, m).is_some())
    }

    /// Whether the value of a metric in a row comes only from in-sample lines.
    pub fn is_in_sample(&self, row: usize, metric: usize) -> bool {
        self.in_sample.get(row).is_some_and(|lines| lines.metrics.get(metric) == Some(&true))
    }

    /// Whether all lines of a row are in sample.
    pub fn is_all_in_sample(&self, row: usize) -> bool {
        self.in_sample.get(row).is_some_and(|lines| lines.held_out == 0 && lines.lines > 0)
    }

    /// Whether a row cannot be the best by a metric: it is flagged, a bound, or in sample.
    fn is_excluded(&self, row: usize, metric: usize) -> bool {
        self.is_marked(row) || self.is_bound(row) || self.is_in_sample(row, metric)
    }

    /// The rows by a metric, best first; flagged rows, bounds and in-sample rows last. Rows without a value are
    /// omitted.
    pub fn ranked(&self, metric: usize) -> Vec<usize> {
        let Some(Metric { better, .. }) = self.metrics.get(metric) else { return vec![] };
        let cost = |r: usize| {
            let cost = self.value(r, metric).and_then(|v| better.cost(v))?;
            Some((self.is_excluded(r, metric), cost, r))
        };
        let mut all: Vec<(bool, f64, usize)> = (0..self.rows.len()).filter_map(cost).collect();
        all.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        all.into_iter().map(|(_, _, r)| r).collect()
    }

    /// The best row by a metric; never a flagged row, a bound, or an in-sample row.
    pub fn best(&self, metric: usize) -> Option<usize> {
        self.ranked(metric).first().copied().filter(|r| !self.is_excluded(*r, metric))
    }

    /// Description of the lines over which the rows are pooled.
    pub fn over(&self) -> String {
        let counts = |of: fn(&InSampleScores) -> usize| -> (usize, usize) {
            let all = self.in_sample.iter().map(of);
            (all.clone().min().unwrap_or(0), all.max().unwrap_or(0))
        };
        let mixed = self.in_sample.iter().any(|row| row.lines > 0 && row.held_out > 0);
        if !mixed {
            return if self.lines == 1 { "one line".to_owned() } else { format!("pooled over {} lines", self.lines) };
        }
        let held_out = match counts(|row| row.held_out) {
            (1, 1) => "one held-out line".to_owned(),
            (least, most) if least == most => format!("pooled over {most} held-out lines"),
            (least, most) => format!("pooled over {least} to {most} held-out lines"),
        };
        let in_sample = match counts(|row| row.lines) {
            (1, 1) => "1 in-sample line is".to_owned(),
            (least, most) if least == most => format!("{most} in-sample lines are"),
            (least, most) => format!("{least} to {most} in-sample lines are"),
        };
        format!("{held_out}; {in_sample} pooled separately")
    }

    /// Notes, one for each numeric axis on which the leading metric is best at the first or last value.
    pub fn at_edges(&self) -> Vec<String> {
        let Some((metric, best)) = self.headline().and_then(|m| Some((m, self.best(m)?))) else { return vec![] };
        (0..self.axes.len()).filter_map(|axis| self.at_edge(axis, metric, best)).collect()
    }

    fn at_edge(&self, axis: usize, metric: usize, best: usize) -> Option<String> {
        let (key, _) = self.rows.get(best)?;
        let others = |other: &[String]| (0..key.len()).all(|a| a == axis || other.get(a) == key.get(a));
        let along = (0..self.rows.len()).filter(|r| others(&self.rows[*r].0));
        let points: Vec<(f64, Option<f64>)> = along
            .map(|r| Some((self.rows[r].0.get(axis)?.parse::<f64>().ok()?, self.value(r, metric))))
            .collect::<Option<_>>()?;
        let own: f64 = key.get(axis)?.parse().ok()?;
        let (low, high) = points.iter().fold((own, own), |(low, high), (x, _)| (low.min(*x), high.max(*x)));
        let varies = points.iter().any(|(_, value)| *value != self.value(best, metric));
        let is_edge = points.len() > 2 && low < high && (own == low || own == high) && varies;
        let name = self.metrics.get(metric)?.name;
        let axis = self.axes.get(axis)?;
        is_edge.then(|| {
            format!(
                "the best {name} is at an end of the axis `{axis}`: {own} in the range {low} to {high}; a value \
                 outside the range may be better"
            )
        })
    }
}

/// Axis value in a form that is the same for all its spellings: `0.0` and `0` are the same number.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum AxisWord {
    Number(u64),
    Text(String),
}

impl AxisWord {
    /// Axis value from its text, as written by any program. `number` is true for a numeric axis.
    fn from_text(text: &str, number: bool) -> AxisWord {
        match text.parse::<f64>() {
            // -0 equals 0.
            Ok(x) if number => AxisWord::Number((x + 0.0).to_bits()),
            _ => AxisWord::Text(text.to_owned()),
        }
    }

    fn of_value(value: &Literal) -> AxisWord {
        AxisWord::from_text(&value.to_string(), matches!(value, Literal::Int(_) | Literal::Float(_)))
    }
}

/// Values of an axis, indexed by the text in which another program writes them.
pub struct AxisValues {
    number: bool,
    known: HashMap<AxisWord, usize>,
}

impl AxisValues {
    /// Creates the index of the values of one axis.
    pub fn new(values: &[Literal]) -> AxisValues {
        let number = values.iter().all(|v| matches!(v, Literal::Int(_) | Literal::Float(_)));
        AxisValues { number, known: values.iter().enumerate().map(|(i, v)| (AxisWord::of_value(v), i)).collect() }
    }

    /// The position of the value with the spelling `text`.
    pub fn position(&self, text: &str) -> Option<usize> {
        self.known.get(&AxisWord::from_text(text, self.number)).copied()
    }
}

/// Scores of every table of scores in `plan` that has a row, with the flags from `warnings`.
pub fn all(plan: &Plan, pooled: &[PooledMetric], warnings: &[Warning]) -> Vec<(String, Scores)> {
    let one = |t: usize| {
        let (mut found, _) = Scores::new(plan, t, pooled);
        let name = plan.table_name(t);
        found.mark(name, warnings);
        (!found.rows.is_empty()).then(|| (name.to_owned(), found))
    };
    pooled::tables(plan).filter_map(one).collect()
}

/// Metrics of the stage `score`, for tests.
#[cfg(test)]
pub fn declared<const N: usize>(names: [&str; N]) -> [Metric; N] {
    names.map(|name| {
        stages::score::metrics::SCORERS
            .iter()
            .find(|s| s.metric.name == name)
            .unwrap_or_else(|| panic!("no metric {name}"))
            .metric
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_a_number_is_recognised_in_every_spelling() {
        let numbers = AxisValues::new(&[Literal::Float(0.0), Literal::Float(0.001), Literal::Float(0.025)]);
        let found = ["0", "-0.0", "1e-3", "0.0250", "0.02", "none"].map(|text| numbers.position(text));
        assert_eq!(found, [Some(0), Some(0), Some(1), Some(2), None, None]);
        let words = AxisValues::new(&[Literal::Text("1".into()), Literal::Text("x+y".into())]);
        assert_eq!(["1", "1.0", "x+y"].map(|text| words.position(text)), [Some(0), None, Some(1)]);
        let truths = AxisValues::new(&[Literal::Bool(true)]);
        assert_eq!(truths.position("true"), Some(0));
    }
}
