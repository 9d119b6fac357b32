//! The course of a search: the next trials from the scores of earlier ones.

use learning::search::{TrialOutcome, TrialValue, kept, propose};
use schemas::Literal;

use super::{SearchSpec, SweepAxis};

/// Trial at a rung of successive halving.
#[derive(Clone, Debug, PartialEq)]
pub struct SearchTrial {
    /// The trial, from 1.
    pub trial: usize,
    /// The generation in which the trial was proposed, counted from 1.
    pub generation: usize,
    /// The rung, from 1.
    pub rung: usize,
    /// The values of the searched axes.
    pub values: Vec<TrialValue>,
}

impl SearchTrial {
    /// The values of the trial's columns, in the order of [`SearchSpec::columns`].
    pub fn literals(&self, search: &SearchSpec) -> Vec<Literal> {
        let trial = Literal::Int(i64::try_from(self.trial).unwrap_or(i64::MAX));
        let rung = search.halving.iter().filter_map(|h| h.values.get(self.rung - 1).cloned());
        let values = search.axes.iter().zip(&self.values).filter_map(|(axis, v)| axis.literal(*v));
        std::iter::once(trial).chain(rung).chain(values).collect()
    }
}

/// Result of a computed trial.
#[derive(Clone, Debug, PartialEq)]
pub struct SearchTrialScore {
    /// The row.
    pub row: SearchTrial,
    /// The goal; `None` if the goal has no value.
    pub goal: Option<f64>,
    /// The goal as a cost; smaller is better.
    pub cost: Option<f64>,
    /// Number of lines over which the goal is pooled.
    pub lines: usize,
    /// Reason for a missing goal.
    pub error: Option<String>,
    /// Whether successive halving promoted the trial to the next rung.
    pub promoted: bool,
}

/// Outcome of a trial at a rung.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RungOutcome {
    /// The trial has a goal, and there is no further rung.
    Done,
    /// Promoted to the next rung.
    Promoted,
    /// The trial has a goal, but other trials were better.
    Pruned,
    /// The trial has no goal.
    Failed,
}

impl RungOutcome {
    /// The outcome as text.
    pub fn as_str(self) -> &'static str {
        match self {
            RungOutcome::Done => "done",
            RungOutcome::Promoted => "promoted",
            RungOutcome::Pruned => "pruned",
            RungOutcome::Failed => "failed",
        }
    }
}

impl SearchTrialScore {
    /// Outcome of the trial in `search`.
    pub fn rung_outcome(&self, search: &SearchSpec) -> RungOutcome {
        match self.cost {
            None => RungOutcome::Failed,
            Some(_) if self.promoted => RungOutcome::Promoted,
            Some(_) if self.row.rung < search.rungs() => RungOutcome::Pruned,
            Some(_) => RungOutcome::Done,
        }
    }
}

/// The state of a search.
#[derive(Clone, Debug)]
pub struct SearchState<'a> {
    search: &'a SearchSpec,
    /// Computed trials, in the order of computation.
    done: Vec<SearchTrialScore>,
    /// The next rows of the table of trials.
    next: Vec<SearchTrial>,
    /// The number of trials proposed so far.
    proposed: usize,
}

impl<'a> SearchState<'a> {
    /// Creates the state before the first trial.
    pub fn new(search: &'a SearchSpec) -> SearchState<'a> {
        let mut course = SearchState { search, done: vec![], next: vec![], proposed: 0 };
        course.propose();
        course
    }

    /// The next rows, which can be computed in any order; empty if the search is over.
    pub fn next(&self) -> &[SearchTrial] {
        &self.next
    }

    /// Computed trials so far.
    pub fn done(&self) -> &[SearchTrialScore] {
        &self.done
    }

    /// Whether all rows are known before any is computed.
    pub fn is_known(&self) -> bool {
        self.search.rungs() == 1 && self.proposed == self.search.trials
    }

    /// Whether no trial has a goal so far.
    pub fn has_no_score(&self) -> bool {
        !self.done.is_empty() && self.done.iter().all(|s| s.cost.is_none())
    }

    /// Records the scores of [`SearchState::next`], in the same order.
    pub fn record_scores(&mut self, scored: Vec<SearchTrialScore>) {
        let first = self.done.len();
        let rung = scored.first().map_or(1, |s| s.row.rung);
        self.done.extend(scored);
        self.next.clear();
        if let Some(halving) = self.search.halving.as_ref().filter(|h| rung < h.values.len()) {
            let costs: Vec<Option<f64>> = self.done[first..].iter().map(|s| s.cost).collect();
            for i in kept(&costs, halving.eta) {
                if let Some(one) = self.done.get_mut(first + i) {
                    one.promoted = true;
                    self.next.push(SearchTrial { rung: rung + 1, ..one.row.clone() });
                }
            }
        }
        // If no trial has a goal, no further trials are proposed.
        if self.next.is_empty() && !self.has_no_score() {
            self.propose();
        }
    }

    fn propose(&mut self) {
        let SearchSpec { method, seed, generation, trials, .. } = *self.search;
        let count = generation.min(trials - self.proposed);
        if count == 0 {
            return;
        }
        // A trial is represented by its highest rung.
        let last = self.done.iter().filter(|s| !s.promoted);
        let outcomes: Vec<TrialOutcome> =
            last.map(|s| TrialOutcome { values: s.row.values.clone(), rung: s.row.rung, cost: s.cost }).collect();
        let dimensions: Vec<_> = self.search.axes.iter().map(|a| a.dimension).collect();
        let generation = self.done.iter().map(|s| s.row.generation).max().unwrap_or(0) + 1;
        let values = propose(method, &dimensions, seed, self.proposed, count, &outcomes);
        let row = |(i, values)| SearchTrial { trial: self.proposed + i + 1, generation, rung: 1, values };
        self.next = values.into_iter().enumerate().map(row).collect();
        self.proposed += count;
    }

    /// All known rows, computed or not, by trial and rung.
    pub fn rows(&self) -> Vec<SearchTrial> {
        let mut rows: Vec<SearchTrial> =
            self.done.iter().map(|s| s.row.clone()).chain(self.next.iter().cloned()).collect();
        rows.sort_by_key(|r| (r.trial, r.rung));
        rows
    }

    /// The best computed trial: the trial with the smallest cost among the trials at the highest rung. Of several equal
    /// trials, the first is used.
    pub fn best(&self) -> Option<&SearchTrialScore> {
        best(&self.done)
    }
}

/// See [`SearchState::best`].
pub fn best(done: &[SearchTrialScore]) -> Option<&SearchTrialScore> {
    let better = |a: &&SearchTrialScore, b: &&SearchTrialScore| {
        let cost = |s: &SearchTrialScore| s.cost.unwrap_or(f64::INFINITY);
        b.row.rung.cmp(&a.row.rung).then(cost(a).total_cmp(&cost(b))).then(a.row.trial.cmp(&b.row.trial))
    };
    done.iter().filter(|s| s.cost.is_some()).min_by(better)
}

/// The axes with the values of these rows: the trial, the cost axis of the rungs, and the searched axes.
pub fn axes(search: &SearchSpec, rows: &[SearchTrial]) -> Vec<SweepAxis> {
    let literals: Vec<Vec<Literal>> = rows.iter().map(|r| r.literals(search)).collect();
    let axis = |(k, (name, at)): (usize, (&str, &super::SpecSpan))| SweepAxis {
        name: name.to_owned(),
        at: at.clone(),
        values: literals.iter().filter_map(|row| row.get(k).cloned()).collect(),
    };
    search.columns().into_iter().enumerate().map(axis).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::spec::Spec;

    fn search(keys: &str) -> SearchSpec {
        let text = format!(
            "[search]\ngoal = 'scores.drms'\n{keys}\n[search.axes]\nx = {{ low = 0.0, high = 1.0 }}\n\
             kind = ['a', 'b']\n[[stages]]\nname = 's'\nstage = 'score'\n"
        );
        Spec::parse("a.toml", ".".into(), text, &[]).unwrap().search.unwrap()
    }

    /// Runs the search on a function of the first searched axis.
    fn run<'a>(search: &'a SearchSpec, cost: impl Fn(&SearchTrial) -> Option<f64>) -> (SearchState<'a>, Vec<usize>) {
        let (mut course, mut sizes) = (SearchState::new(search), vec![]);
        while !course.next().is_empty() {
            sizes.push(course.next().len());
            let score = |row: &SearchTrial| {
                let cost = cost(row);
                SearchTrialScore { row: row.clone(), goal: cost, cost, lines: 1, error: None, promoted: false }
            };
            let scored = course.next().iter().map(score).collect();
            course.record_scores(scored);
        }
        (course, sizes)
    }

    fn x(row: &SearchTrial) -> f64 {
        match row.values[0] {
            TrialValue::Real(x) => x,
            TrialValue::Whole(_) | TrialValue::Choice(_) => f64::NAN,
        }
    }

    #[test]
    fn unit_generations_rungs_and_the_most_rows() {
        let plain = search("trials = 20\ngeneration = 8");
        let (course, sizes) = run(&plain, |row| Some((x(row) - 0.3).abs()));
        assert_eq!((sizes, plain.most_rows()), (vec![8, 8, 4], 20));
        assert_eq!(course.rows().iter().map(|r| r.trial).collect::<Vec<_>>(), (1..=20).collect::<Vec<_>>());
        assert!(
            !SearchState::new(&plain).is_known()
                && SearchState::new(&search("trials = 9\nmethod = 'random'")).is_known()
        );
        let halved = search("trials = 20\ngeneration = 8\nhalving = { axis = 'n', values = [1, 2, 4], eta = 2 }");
        // At the last rung, the ranking of the trials is reversed.
        let (course, sizes) = run(&halved, |row| Some(if row.rung < 3 { x(row) } else { -x(row) }));
        assert_eq!((sizes, halved.most_rows()), (vec![8, 4, 2, 8, 4, 2, 4, 2, 1], 35));
        let best = course.best().unwrap();
        let top = course.done().iter().filter(|s| s.row.rung == 3);
        assert_eq!(best.cost, top.filter_map(|s| s.cost).min_by(f64::total_cmp));
        let count_of = |rung: usize, outcome: RungOutcome| {
            course.done().iter().filter(|s| s.row.rung == rung && s.rung_outcome(&halved) == outcome).count()
        };
        assert_eq!((count_of(1, RungOutcome::Promoted), count_of(1, RungOutcome::Pruned)), (10, 10));
        assert_eq!(
            (count_of(2, RungOutcome::Promoted), count_of(3, RungOutcome::Done), count_of(3, RungOutcome::Pruned)),
            (5, 5, 0)
        );
    }

    #[test]
    fn unit_a_search_without_any_goal_ends_after_its_first_generation() {
        let some = search("trials = 40\ngeneration = 4\nhalving = { axis = 'n', values = [1, 2], eta = 2 }");
        let (course, sizes) = run(&some, |_| None);
        assert!(course.has_no_score() && course.best().is_none() && sizes == [4]);
        // The search continues if at least one trial has a goal.
        let (course, sizes) = run(&some, |row| (row.trial == 3).then_some(1.0));
        assert!(!course.has_no_score() && sizes.len() > 10, "{sizes:?}");
        assert_eq!(course.best().map(|b| (b.row.trial, b.row.rung)), Some((3, 2)));
    }

    #[test]
    fn unit_the_columns_of_a_row() {
        let some =
            search("trials = 4\nmethod = 'sobol'\nscramble = false\nhalving = { axis = 'n', values = ['u', 'v'] }");
        let axes = axes(&some, &SearchState::new(&some).rows());
        let words = |axis: &SweepAxis| axis.values.iter().map(Literal::to_string).collect::<Vec<_>>().join(" ");
        assert_eq!(axes.iter().map(|a| a.name.as_str()).collect::<Vec<_>>(), ["trial", "n", "x", "kind"]);
        assert_eq!(axes.iter().map(words).collect::<Vec<_>>(), ["1 2 3 4", "u u u u", "0 0.5 0.75 0.25", "a b a b"]);
    }
}
