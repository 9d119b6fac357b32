//! The pooled scores of one table, and which of their points is best.

use std::{
    collections::{BTreeMap, HashMap},
    ops::Range,
};

use schemas::{Fault, Literal};

use super::source::Source;
use crate::{
    spec::{Axis, Spec},
    store::parts,
    views::{
        scores::{self, Scores, Values},
        warnings::Warning,
    },
};

/// The pooled scores of one score table.
pub struct Board {
    /// The table, as a position in the plan.
    pub table: usize,
    /// Its scores.
    pub scores: Scores,
    /// The instance behind each row.
    pub instances: Vec<usize>,
}

impl Board {
    /// The boards of all score tables that were published.
    ///
    /// # Errors
    /// Fails when one cannot be read.
    pub fn all(source: &Source, warnings: &[Warning]) -> Result<Vec<Board>, Fault> {
        let plan = source.graph.plan;
        let mut found = vec![];
        for (table, node) in plan.tables.iter().enumerate().filter(|(_, t)| t.entry.name == "score") {
            let folder = source.store.table(&plan.spec.name, &node.name);
            if parts(&folder)?.is_empty() {
                continue;
            }
            let axes: Vec<String> =
                node.axes.iter().filter_map(|i| plan.spec.axes.get(*i)).map(|a| a.name.clone()).collect();
            let mut board = Board::new(source, table, scores::scores(&folder, &axes, &node.entry.metrics)?);
            board.scores.mark(&node.name, warnings);
            if !board.scores.rows.is_empty() {
                found.push(board);
            }
        }
        Ok(found)
    }

    /// Keeps the rows whose point this spec still has, spelt as the spec does, in the order of the sweep.
    fn new(source: &Source, table: usize, mut scores: Scores) -> Board {
        let plan = source.graph.plan;
        let grid = plan.tables[table].grid();
        let axes: Vec<&[Literal]> = grid.axes().map(|a| plan.spec.axes[a].values.as_slice()).collect();
        let known: Vec<Side> = grid.sides().map(|side| Side::new(&plan.spec, side)).collect();
        let mut kept: BTreeMap<usize, Vec<Option<f64>>> = BTreeMap::new();
        for (key, values) in scores.rows {
            let mut words = key.as_slice();
            let place: Option<Vec<usize>> = known.iter().map(|side| side.position(&mut words)).collect();
            if let Some(i) = place.filter(|_| words.is_empty()).and_then(|p| grid.number(&p)) {
                kept.entry(i).or_insert(values);
            }
        }
        let spelt = |i: usize| grid.place(i).zip(&axes).map(|((_, at), values)| values[at].to_string()).collect();
        let instances = kept.keys().copied().collect();
        scores.rows = kept.into_iter().map(|(i, values)| (spelt(i), values)).collect();
        Board { table, scores, instances }
    }

    /// The metric that ranks the points: the most significant one that has a value.
    pub fn headline(&self) -> Option<usize> {
        self.scores.headline()
    }

    /// The rows by a metric, best first, those with a mark after all others; without those that have no value.
    pub fn ranked(&self, metric: usize) -> Vec<usize> {
        self.scores.ranked(metric)
    }

    /// The number of marked lines of a row.
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

/// The values of an axis, or of axes that are searched together.
struct Side {
    axes: Vec<Values>,
    /// Of several axes: the position of each combination of positions.
    together: HashMap<Vec<usize>, usize>,
}

impl Side {
    fn new(spec: &Spec, axes: Range<usize>) -> Side {
        let axes = spec.axes.get(axes).unwrap_or_default();
        let known: Vec<Values> = axes.iter().map(|a| Values::new(&a.values)).collect();
        let mut together = HashMap::new();
        if axes.len() > 1 {
            for i in 0..axes.iter().map(|a| a.values.len()).min().unwrap_or(0) {
                let place = |(axis, known): (&Axis, &Values)| known.position(&axis.values[i].to_string());
                together.extend(axes.iter().zip(&known).map(place).collect::<Option<Vec<usize>>>().map(|p| (p, i)));
            }
        }
        Side { axes: known, together }
    }

    /// The position of the values that `words` begin with; these are taken off.
    fn position(&self, words: &mut &[String]) -> Option<usize> {
        let (own, rest) = words.split_at_checked(self.axes.len())?;
        *words = rest;
        let places: Vec<usize> =
            own.iter().zip(&self.axes).map(|(word, axis)| axis.position(word)).collect::<Option<_>>()?;
        if let [one] = places.as_slice() { Some(*one) } else { self.together.get(&places).copied() }
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// A board of two axes, for tests.
    pub fn example() -> Board {
        let row = |a: &str, b: &str, v: [f64; 3]| {
            (vec![a.to_owned(), b.to_owned()], v.map(|x| x.is_finite().then_some(x)).to_vec())
        };
        let metrics = scores::declared(["std_error", "drms", "nees"]).to_vec();
        let rows = vec![
            row("mag_2_uc", "0", [5.0, 90.0, 9.0]),
            row("mag_2_uc", "0.025", [4.0, 12.0, 2.5]),
            row("mag_3_uc", "0", [3.0, f64::NAN, f64::NAN]),
            row("mag_3_uc", "0.025", [7.0, 30.0, 0.2]),
        ];
        let axes = vec!["mag".to_owned(), "lambda".to_owned()];
        let marks = vec![0; rows.len()];
        Board { table: 0, scores: Scores { axes, metrics, rows, lines: 6, marks }, instances: vec![0, 1, 2, 3] }
    }

    #[test]
    fn unit_the_best_point_has_the_least_cost() {
        let board = example();
        assert_eq!(board.headline(), Some(1));
        assert_eq!(board.ranked(1), [1, 3, 0]);
        assert_eq!(board.ranked(0), [2, 1, 0, 3]);
        // 2.5 is nearer to 2 than 9 and 0.2 are.
        assert_eq!(board.ranked(2), [1, 0, 3]);
        assert_eq!(board.point(1), "mag = mag_2_uc, lambda = 0.025");
    }

    #[test]
    fn r10_a_marked_point_is_never_the_best() {
        let mut board = example();
        board.scores.marks[1] = 1;
        assert_eq!(board.ranked(1), [3, 0, 1]);
        assert_eq!(board.scores.best(1), Some(3));
        board.scores.marks = vec![1; 4];
        assert_eq!(board.scores.best(1), None);
    }

    #[test]
    fn unit_the_truth_is_never_the_best_answer() {
        let mut board = example();
        let metrics = scores::declared(["drms", "ins_drms"]).to_vec();
        let row = |name: &str, drms: f64| (vec![name.to_owned(), "0".to_owned()], vec![Some(drms), Some(900.0)]);
        board.scores.metrics = metrics;
        board.scores.rows = vec![row("crlb", 0.0), row("ekf", 25.0), row("rts", 7.0), row("lost", 950.0)];
        assert_eq!(board.ranked(0), [2, 1, 3, 0]);
        assert_eq!(board.scores.best(0), Some(2));
        board.scores.rows.truncate(1);
        assert_eq!(board.scores.best(0), None);
    }
}
