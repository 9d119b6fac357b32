//! The pooled scores of one table, and its best point.

use std::collections::BTreeMap;

use results::{
    pooled::{self, PooledMetric},
    scores::Scores,
    warnings::Warning,
};
use schemas::{Fault, metric::Metric};
use store::parts;

use super::source::ReportSource;

/// The pooled scores of one score table.
pub struct ScoreBoard {
    /// The table, as a position in the plan.
    pub table: usize,
    /// Scores.
    pub scores: Scores,
    /// Point of the table for each row of the scores.
    pub instances: Vec<usize>,
    /// The metrics that have a value but no column in the table of scores.
    pub more: Vec<MoreScores>,
}

/// A metric without a column in the table of scores.
pub struct MoreScores {
    /// The metric.
    pub metric: Metric,
    /// Value at each row.
    pub values: Vec<Option<f64>>,
    /// For each row, whether its value comes only from in-sample lines.
    pub in_sample: Vec<bool>,
}

/// The metrics of the table `t` among `pooled` that are not in `scores`.
fn more(source: &ReportSource, t: usize, pooled: &[PooledMetric], scores: &Scores, rows: &[usize]) -> Vec<MoreScores> {
    let mut of: BTreeMap<&str, BTreeMap<usize, &PooledMetric>> = BTreeMap::new();
    for one in pooled.iter().filter(|p| p.table == t) {
        of.entry(one.metric.name).or_default().insert(one.instance, one);
    }
    let others = source.graph.plan.tables[t].entry.metrics.iter().filter(|m| scores.metric(m.name).is_none());
    let column = |metric: &Metric| {
        let own = of.get(metric.name)?;
        let values: Vec<Option<f64>> = rows.iter().map(|i| own.get(i).and_then(|p| p.shown().value)).collect();
        let in_sample = rows.iter().map(|i| own.get(i).is_some_and(|p| p.is_in_sample())).collect();
        values.iter().any(Option::is_some).then_some(MoreScores { metric: *metric, values, in_sample })
    };
    others.filter_map(column).collect()
}

impl ScoreBoard {
    /// The boards of all score tables that were published.
    ///
    /// # Errors
    /// Fails if a table of scores cannot be read.
    pub fn all(source: &ReportSource, warnings: &[Warning]) -> Result<Vec<ScoreBoard>, Fault> {
        let (graph, store) = (source.graph, source.store);
        let plan = graph.plan;
        let pooled = pooled::written(plan, store)?.map_or_else(|| pooled::present(graph, store), Ok)?;
        let mut found = vec![];
        for table in pooled::tables(plan) {
            let name = plan.table_name(table);
            if parts(&store.table(&plan.spec.name, name))?.is_empty() {
                continue;
            }
            let (mut scores, instances) = Scores::new(plan, table, &pooled);
            scores.mark(name, warnings);
            if !scores.rows.is_empty() {
                let more = more(source, table, &pooled, &scores, &instances);
                found.push(ScoreBoard { table, scores, instances, more });
            }
        }
        Ok(found)
    }

    /// The metric that ranks the points: the most significant metric that has a value.
    pub fn headline(&self) -> Option<usize> {
        self.scores.headline()
    }

    /// The rows in the order of a metric, best first and flagged rows last. Rows without a value are omitted.
    pub fn ranked(&self, metric: usize) -> Vec<usize> {
        self.scores.ranked(metric)
    }

    /// The point of the table for a row of the scores.
    pub fn instance(&self, row: usize) -> usize {
        self.instances.get(row).copied().unwrap_or(0)
    }

    /// The number of flagged lines of a row.
    pub fn marked(&self, row: usize) -> usize {
        self.scores.marks.get(row).copied().unwrap_or(0)
    }

    /// The value of a metric at a row.
    pub fn value(&self, row: usize, metric: usize) -> Option<f64> {
        self.scores.rows.get(row).and_then(|(_, v)| v.get(metric).copied().flatten())
    }

    /// The point of a row as text; empty for a pipeline without axes.
    pub fn point(&self, row: usize) -> String {
        let key = self.scores.rows.get(row).map(|(k, _)| k.as_slice()).unwrap_or_default();
        let words = self.scores.axes.iter().zip(key).map(|(a, v)| format!("{a} = {v}"));
        words.collect::<Vec<_>>().join(", ")
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use results::scores::InSampleScores;

    /// A board of two axes, for tests.
    pub fn example() -> ScoreBoard {
        let row = |a: &str, b: &str, v: [f64; 3]| {
            (vec![a.to_owned(), b.to_owned()], v.map(|x| x.is_finite().then_some(x)).to_vec())
        };
        let metrics = crate::html::tests::declared(["std_error", "drms", "nees"]).to_vec();
        let rows = vec![
            row("mag_2_uc", "0", [5.0, 90.0, 9.0]),
            row("mag_2_uc", "0.025", [4.0, 12.0, 2.5]),
            row("mag_3_uc", "0", [3.0, f64::NAN, f64::NAN]),
            row("mag_3_uc", "0.025", [7.0, 30.0, 0.2]),
        ];
        let axes = vec!["mag".to_owned(), "lambda".to_owned()];
        let marks = vec![0; rows.len()];
        ScoreBoard {
            table: 0,
            scores: Scores { axes, metrics, rows, lines: 6, marks, cautious: vec![], in_sample: vec![] },
            instances: vec![0, 1, 2, 3],
            more: vec![],
        }
    }

    #[test]
    fn unit_the_best_point_has_the_least_cost() {
        let board = example();
        assert_eq!(board.headline(), Some(1));
        assert_eq!(board.ranked(1), [1, 3, 0]);
        assert_eq!(board.ranked(0), [2, 1, 0, 3]);
        // The expected value is 2, which is nearer to 2.5 than to 9 or to 0.2.
        assert_eq!(board.ranked(2), [1, 0, 3]);
        assert_eq!(board.point(1), "mag = mag_2_uc, lambda = 0.025");
    }

    #[test]
    fn unit_a_flagged_point_is_never_the_best() {
        let mut board = example();
        board.scores.marks[1] = 1;
        assert_eq!(board.ranked(1), [3, 0, 1]);
        assert_eq!(board.scores.best(1), Some(3));
        board.scores.marks = vec![1; 4];
        assert_eq!(board.scores.best(1), None);
    }

    #[test]
    fn unit_a_bound_is_never_the_best_answer() {
        let mut board = example();
        let metrics = crate::html::tests::declared(["drms", "ins_drms", "drms_bound"]).to_vec();
        let row = |name: &str, drms: Option<f64>, bound: Option<f64>| {
            (vec![name.to_owned(), "0".to_owned()], vec![drms, Some(900.0), bound])
        };
        board.scores.metrics = metrics;
        board.scores.rows = vec![
            row("crlb", None, Some(5.0)),
            row("ekf", Some(25.0), None),
            row("rts", Some(7.0), None),
            row("another bound", Some(0.0), Some(6.0)),
        ];
        assert_eq!(board.ranked(0), [2, 1, 3]);
        assert_eq!(board.scores.best(0), Some(2));
        board.scores.rows.truncate(1);
        assert_eq!(board.scores.best(0), None);
    }

    #[test]
    fn unit_a_score_in_sample_is_never_the_best() {
        let mut board = example();
        let of = |metrics: [bool; 3]| {
            let held_out = usize::from(metrics != [true; 3]);
            InSampleScores { lines: 1, held_out, metrics: metrics.to_vec(), values: vec![Some(1.0); 3] }
        };
        board.scores.in_sample = vec![of([true; 3]), of([true, true, false]), of([false; 3]), of([false; 3])];
        assert_eq!((board.ranked(1), board.scores.best(1)), (vec![3, 1, 0], Some(3)));
        // The same row is out of sample for another metric.
        assert_eq!(board.scores.best(2), Some(1));
        assert!(board.scores.is_all_in_sample(0) && !board.scores.is_all_in_sample(1));
        assert_eq!(board.scores.over(), "pooled over 0 to 1 held-out lines; 1 in-sample line is pooled separately");
        board.scores.in_sample = vec![of([true; 3]); 4];
        assert_eq!((board.scores.best(0), board.headline()), (None, Some(1)));
        assert_eq!(board.scores.over(), "pooled over 6 lines");
    }

    #[test]
    fn unit_a_best_point_at_the_end_of_an_axis_is_reported() {
        let mut board = example();
        let row =
            |lambda: &str, drms: f64| (vec!["mag_4_uc".to_owned(), lambda.to_owned()], vec![None, Some(drms), None]);
        let mut with = |best: [f64; 4]| {
            board.scores.rows = ["0", "0.025", "0.25", "2.5"].iter().zip(best).map(|(l, d)| row(l, d)).collect();
            board.scores.marks = vec![0; 4];
            board.scores.at_edges()
        };
        let notes = with([9.0, 8.0, 7.0, 6.0]);
        assert_eq!(notes.len(), 1, "{notes:?}");
        assert!(
            notes[0].starts_with("the best drms is at an end of the axis `lambda`: 2.5 in the range 0 to 2.5"),
            "{notes:?}"
        );
        assert_eq!(with([1.0, 8.0, 7.0, 6.0]).len(), 1);
        assert!(with([9.0, 3.0, 7.0, 6.0]).is_empty() && with([5.0; 4]).is_empty());
    }
}
