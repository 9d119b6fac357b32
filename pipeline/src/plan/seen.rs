//! The lines that the models, noises, maps and choices behind a score saw.

use std::{
    collections::{BTreeSet, HashMap},
    sync::Arc,
};

use schemas::{Fault, Grain, TableKind};

use super::{Graph, LineId, Ref, TableNode};

/// The column of a published table of scores that holds whether the line was seen.
pub const IN_SAMPLE: &str = "in_sample";

/// The meaning of that column.
pub const IN_SAMPLE_MEANING: &str =
    "whether a model, noise or map behind the score was made from this line, or a search chose by it";

impl TableNode {
    /// Whether its published table has the column [`IN_SAMPLE`]: scores of lines.
    pub fn has_in_sample(&self) -> bool {
        let of_lines = self.entry.yields == TableKind::Scores && self.entry.grain == Grain::Line;
        of_lines && self.variants.iter().all(|v| v.makes(IN_SAMPLE).is_none())
    }
}

/// The lines that each point of one table saw, sorted.
pub struct Seen(Vec<Arc<BTreeSet<LineId>>>);

impl Seen {
    /// For the table `t`: the lines of every stage of a whole survey above a point, such as fits and noises, at any
    /// distance; and of a table that depends on a search the lines of its goal.
    ///
    /// # Errors
    /// Fails when the goal of the search selects no line.
    pub fn new(graph: &Graph, t: usize) -> Result<Seen, Fault> {
        let node = &graph.plan.tables[t];
        let searched = node.axes.iter().any(|axis| graph.plan.spec.searched.contains(axis));
        let goal = graph.plan.goal()?.filter(|_| searched);
        let chosen: BTreeSet<LineId> = match goal {
            Some(goal) => {
                let lines = graph.all_lines_of(goal.table);
                match &goal.lines {
                    None => lines.into_iter().collect(),
                    Some(predicate) => {
                        let selected = predicate.lines(&graph.lines)?;
                        lines.into_iter().filter(|line| selected.get(*line).copied().unwrap_or(false)).collect()
                    }
                }
            }
            None => BTreeSet::new(),
        };
        let mut above = Above { graph, known: HashMap::new(), sets: HashMap::new() };
        let one = |i| {
            let seen = above.of(Ref::Stage(t, i));
            if chosen.is_subset(&seen) { seen } else { above.shared(seen.union(&chosen).copied().collect()) }
        };
        Ok(Seen((0..node.len()).map(one).collect()))
    }

    /// Whether the point `i` saw a line.
    pub fn has(&self, i: usize, line: LineId) -> bool {
        self.0.get(i).is_some_and(|lines| lines.contains(&line))
    }
}

/// The lines that stages saw; equal sets are stored once.
struct Above<'a> {
    graph: &'a Graph<'a>,
    known: HashMap<Ref, Arc<BTreeSet<LineId>>>,
    sets: HashMap<BTreeSet<LineId>, Arc<BTreeSet<LineId>>>,
}

impl Above<'_> {
    fn shared(&mut self, set: BTreeSet<LineId>) -> Arc<BTreeSet<LineId>> {
        self.sets.entry(set).or_insert_with_key(|set| Arc::new(set.clone())).clone()
    }

    fn of(&mut self, r: Ref) -> Arc<BTreeSet<LineId>> {
        if let Some(known) = self.known.get(&r) {
            return known.clone();
        }
        let Ref::Stage(t, i) = r else { return self.shared(BTreeSet::new()) };
        let gathers = self.graph.plan.tables[t].entry.grain == Grain::Survey;
        let own: BTreeSet<LineId> =
            if gathers { self.graph.lines_of(t, i).iter().copied().collect() } else { BTreeSet::new() };
        let mut all = self.shared(own);
        for input in self.graph.plan.instance(t, i).inputs() {
            let more = self.of(input);
            if !more.is_subset(&all) {
                all = if all.is_empty() { more } else { self.shared(all.union(&more).copied().collect()) };
            }
        }
        self.known.insert(r, all.clone());
        all
    }
}
