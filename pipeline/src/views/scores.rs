//! The table of scores as a person reads it: one row a sweep point, one column a metric, lines pooled.

use std::{
    collections::{BTreeSet, HashMap},
    path::Path,
};

use arrow_array::{Array, Float64Array, StringArray, cast::AsArray, types::Float64Type};
use arrow_cast::cast;
use arrow_schema::DataType;
use schemas::{Fault, Literal, metric::Metric};

use super::warnings::Warning;
use crate::{plan::Plan, store::published};

/// Scores of all lines together, by sweep point.
pub struct Scores {
    /// The axes, in the sweep's order.
    pub axes: Vec<String>,
    /// The metric of each column.
    pub metrics: Vec<Metric>,
    /// One row a sweep point: the axis values as text, then a value for each metric.
    pub rows: Vec<(Vec<String>, Vec<Option<f64>>)>,
    /// How many lines went into them.
    pub lines: usize,
    /// How many lines of each row are marked: their filter diverged, or is wrong about itself.
    pub marks: Vec<usize>,
}

impl Scores {
    /// Marks the rows of the table `name` that `warnings` speaks of.
    pub fn mark(&mut self, name: &str, warnings: &[Warning]) {
        self.marks = self.marked_lines(name, warnings).iter().map(BTreeSet::len).collect();
    }

    /// The lines of each row, as flight and line, that `warnings` of the table `name` marks.
    pub fn marked_lines<'w>(&self, name: &str, warnings: &'w [Warning]) -> Vec<BTreeSet<&'w (String, String)>> {
        let spoilt: Vec<&Warning> = warnings.iter().filter(|w| w.stage == name && w.kind.spoils()).collect();
        let mut lines: HashMap<Vec<Word>, BTreeSet<&(String, String)>> = HashMap::new();
        for warning in &spoilt {
            let point = self.axes.iter().map(|a| warning.point.get(a).map(Word::of_value)).collect::<Option<Vec<_>>>();
            if let Some(point) = point {
                lines.entry(point).or_default().extend(&warning.line);
            }
        }
        let number = |axis: &String| {
            matches!(spoilt.first()?.point.get(axis)?, Literal::Int(_) | Literal::Float(_)).then_some(())
        };
        let numbers: Vec<bool> = self.axes.iter().map(|a| number(a).is_some()).collect();
        let word = |(text, number): (&String, &bool)| Word::of(text, *number);
        let marks = self.rows.iter().map(|(key, _)| {
            let point: Vec<Word> = key.iter().zip(&numbers).map(word).collect();
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

    /// The metric that ranks the points: the most telling one that has a value.
    pub fn headline(&self) -> Option<usize> {
        let has = |m: &usize| (0..self.rows.len()).any(|r| self.value(r, *m).is_some());
        let rank = |m: usize| self.metrics[m].shown.rank.map(|rank| (rank, m));
        let ranking = (0..self.metrics.len()).filter(has).filter_map(rank);
        ranking.min().map(|(_, m)| m)
    }

    /// Whether a row is marked.
    pub fn is_marked(&self, row: usize) -> bool {
        self.marks.get(row).is_some_and(|n| *n > 0)
    }

    /// Whether the track of a row is the truth itself, such as that of a Cramér-Rao bound: it has no error, and is no
    /// answer.
    pub fn is_truth(&self, row: usize) -> bool {
        let value = |name: &str| self.metric(name).and_then(|m| self.value(row, m));
        value("drms") == Some(0.0) && value("ins_drms").is_some_and(|ins| ins > 0.0)
    }

    /// The rows by a metric, best first, those with a mark and the truth after all others; those without a value are left
    /// out.
    pub fn ranked(&self, metric: usize) -> Vec<usize> {
        let Some(Metric { better, .. }) = self.metrics.get(metric) else { return vec![] };
        let last = |r: usize| self.is_marked(r) || self.is_truth(r);
        let cost = |r: usize| self.value(r, metric).and_then(|v| better.cost(v)).map(|c| (last(r), c, r));
        let mut all: Vec<(bool, f64, usize)> = (0..self.rows.len()).filter_map(cost).collect();
        all.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
        all.into_iter().map(|(_, _, r)| r).collect()
    }

    /// The best row by a metric; a marked one is never it, nor the truth.
    pub fn best(&self, metric: usize) -> Option<usize> {
        self.ranked(metric).first().copied().filter(|r| !self.is_marked(*r) && !self.is_truth(*r))
    }
}

/// A value of an axis in a form that all its spellings share: `0.0` and `0` are one number.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Word {
    Number(u64),
    Text(String),
}

impl Word {
    /// What another program wrote for a value of an axis; of numbers or not.
    fn of(text: &str, number: bool) -> Word {
        match text.parse::<f64>() {
            // Minus nought is nought.
            Ok(x) if number => Word::Number((x + 0.0).to_bits()),
            _ => Word::Text(text.to_owned()),
        }
    }

    fn of_value(value: &Literal) -> Word {
        Word::of(&value.to_string(), matches!(value, Literal::Int(_) | Literal::Float(_)))
    }
}

/// The values of an axis, to be found by what another program made of them.
pub struct Values {
    number: bool,
    known: HashMap<Word, usize>,
}

impl Values {
    /// For the values of one axis.
    pub fn new(values: &[Literal]) -> Values {
        let number = values.iter().all(|v| matches!(v, Literal::Int(_) | Literal::Float(_)));
        Values { number, known: values.iter().enumerate().map(|(i, v)| (Word::of_value(v), i)).collect() }
    }

    /// The position of the value that `text` means.
    pub fn position(&self, text: &str) -> Option<usize> {
        self.known.get(&Word::of(text, self.number)).copied()
    }
}

/// Reads the score table in `folder`, whose axes are `axes`, and pools its `declared` metrics over the lines.
///
/// # Errors
/// When the table cannot be read.
pub fn scores(folder: &Path, axes: &[String], declared: &[Metric]) -> Result<Scores, Fault> {
    let where_it_is = |fault: Fault| Fault {
        what: format!("cannot read the scores in {}: {}", folder.display(), fault.what),
        ..fault
    };
    pool(folder, axes, declared).map_err(where_it_is)
}

/// The scores of all published tables of scores of `plan`, whose tables are in `folder`, with the rows marked that
/// `warnings` speaks of. A table that is not there or cannot be read is left out, as is one without a row.
pub fn all(plan: &Plan, folder: &Path, warnings: &[Warning]) -> Vec<(String, Scores)> {
    let of_score = plan.tables.iter().filter(|t| t.entry.name == "score");
    let read = of_score.filter_map(|node| {
        let axes: Vec<String> =
            node.axes.iter().filter_map(|i| plan.spec.axes.get(*i)).map(|a| a.name.clone()).collect();
        let mut found =
            scores(&folder.join(&node.name), &axes, &node.entry.metrics).ok().filter(|s| !s.rows.is_empty())?;
        found.mark(&node.name, warnings);
        Some((node.name.clone(), found))
    });
    read.collect()
}

/// The groups of a long table, in the order in which they first appear.
struct Groups {
    /// The text of the columns in each.
    keys: Vec<Vec<String>>,
    /// Its rows.
    rows: Vec<Vec<usize>>,
}

impl Groups {
    /// By the text of `columns`.
    fn by(columns: &[StringArray]) -> Groups {
        let mut groups = Groups { keys: vec![], rows: vec![] };
        let mut places: HashMap<Vec<&str>, usize> = HashMap::new();
        for row in 0..columns.first().map_or(0, Array::len) {
            let key: Vec<&str> = columns.iter().map(|c| if c.is_null(row) { "" } else { c.value(row) }).collect();
            let place = *places.entry(key).or_insert_with_key(|key| {
                groups.keys.push(key.iter().map(|word| (*word).to_owned()).collect());
                groups.rows.push(vec![]);
                groups.rows.len() - 1
            });
            groups.rows[place].push(row);
        }
        groups
    }
}

fn pool(folder: &Path, axes: &[String], declared: &[Metric]) -> Result<Scores, Fault> {
    let names: Vec<&str> = axes.iter().map(String::as_str).chain(["metric", "flight", "line", "value", "n"]).collect();
    let all = published(folder, &names)?.ok_or_else(|| Fault::machine("the table was not published"))?;
    let column = |name: &str, as_type: &DataType| {
        let lacking = || Fault::machine(format!("there is no column `{name}` of {as_type}"));
        cast(all.column_by_name(name).ok_or_else(lacking)?, as_type).map_err(|_| lacking())
    };
    let text = |name: &str| Ok::<StringArray, Fault>(column(name, &DataType::Utf8)?.as_string::<i32>().clone());
    let number =
        |name: &str| Ok::<Float64Array, Fault>(column(name, &DataType::Float64)?.as_primitive::<Float64Type>().clone());
    let lines = Groups::by(&[text("flight")?, text("line")?]).rows.len();
    let points = names[..=axes.len()].iter().map(|name| text(name)).collect::<Result<Vec<_>, _>>()?;
    let (groups, value, n) = (Groups::by(&points), number("value")?, number("n")?);
    let one = |(key, rows): (&Vec<String>, &Vec<usize>)| {
        let pool = declared.iter().find(|m| key.last().is_some_and(|name| m.name == name))?.pool;
        let given = rows.iter().filter(|i| value.is_valid(**i) && n.is_valid(**i));
        Some(pool.value(given.map(|i| (value.value(*i), n.value(*i))))).filter(|v| !v.is_nan())
    };
    let pooled: Vec<Option<f64>> = groups.keys.iter().zip(&groups.rows).map(one).collect();
    let mut shown: Vec<Metric> = declared.iter().copied().filter(|m| m.shown.column.is_some()).collect();
    shown.sort_by_key(|m| m.shown.column);
    let empty = Scores { axes: axes.to_vec(), metrics: vec![], rows: vec![], lines, marks: vec![] };
    Ok(gather(&groups.keys, &pooled, &shown, empty))
}

/// Long to wide: points in the order in which they first appear, of the metrics to be `shown` those that have a value.
/// The last word of each group is its metric.
fn gather(groups: &[Vec<String>], pooled: &[Option<f64>], shown: &[Metric], mut scores: Scores) -> Scores {
    let found = || groups.iter().filter_map(|key| key.split_last()).zip(pooled);
    let has_value = |m: &Metric| found().any(|((name, _), value)| name == m.name && value.is_some());
    scores.metrics = shown.iter().copied().filter(has_value).collect();
    let mut places: HashMap<Vec<String>, usize> = HashMap::new();
    for ((name, key), value) in found() {
        let Some(at) = scores.metric(name) else { continue };
        let row = *places.entry(key.to_vec()).or_insert_with_key(|key| {
            scores.rows.push((key.clone(), vec![None; scores.metrics.len()]));
            scores.rows.len() - 1
        });
        scores.rows[row].1[at] = *value;
    }
    scores.marks = vec![0; scores.rows.len()];
    scores
}

/// Metrics of the stage `score`, for tests.
#[cfg(test)]
pub fn declared<const N: usize>(names: [&str; N]) -> [Metric; N] {
    let known = crate::catalogue().into_iter().flat_map(|e| e.metrics).collect::<Vec<_>>();
    names.map(|name| known.iter().copied().find(|m| m.name == name).unwrap_or_else(|| panic!("no metric {name}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_a_number_is_known_in_every_spelling() {
        let numbers = Values::new(&[Literal::Float(0.0), Literal::Float(0.001), Literal::Float(0.025)]);
        let found = ["0", "-0.0", "1e-3", "0.0250", "0.02", "none"].map(|text| numbers.position(text));
        assert_eq!(found, [Some(0), Some(0), Some(1), Some(2), None, None]);
        let words = Values::new(&[Literal::Text("1".into()), Literal::Text("x+y".into())]);
        assert_eq!(["1", "1.0", "x+y"].map(|text| words.position(text)), [Some(0), None, Some(1)]);
        let truths = Values::new(&[Literal::Bool(true)]);
        assert_eq!(truths.position("true"), Some(0));
    }
}
