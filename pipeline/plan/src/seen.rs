//! In-sample lines: lines that were used to choose parameters, or to fit the models, noises and maps on which a score
//! depends.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap, btree_map::Entry},
    sync::Arc,
};

use schemas::{Fault, Grain, InputKind, TableKind};
pub use stages::score::IN_SAMPLE;
use stages::score::POOLED_IN_SAMPLE;

use super::{LineId, PlanGraph, PlanUnit, TableNode, TableRef};

impl TableNode {
    /// Meaning of the column [`IN_SAMPLE`] of a published table; `None` for a table without this column. Tables of line
    /// scores and tables that pool line scores have this column.
    pub fn in_sample_meaning(&self) -> Option<&'static str> {
        let meaning = match self.entry.grain {
            Grain::Line if self.entry.yields == TableKind::Scores => {
                "true if the line was used to make a model, noise estimate or map that the score depends on, or to \
                 choose a parameter"
            }
            Grain::Survey if self.slots.iter().any(|slot| slot.kind == InputKind::Scores) => POOLED_IN_SAMPLE,
            Grain::Line | Grain::Survey | Grain::Map => return None,
        };
        self.variants.iter().all(|v| v.makes(IN_SAMPLE).is_none()).then_some(meaning)
    }
}

impl PlanGraph<'_> {
    /// The lines that each point of the table of scores `t` used, computed once.
    ///
    /// # Errors
    /// Fails if the goal of the search selects no line.
    pub fn seen(&self, t: usize) -> Result<&InSampleLines, Fault> {
        let seen = self.seen.get(t).ok_or_else(|| Fault::bug("a table is not in the plan"))?;
        seen.get_or_init(|| InSampleLines::new(self, t)).as_ref().map_err(Clone::clone)
    }

    /// Whether `line` is in sample for the scores `r`, for a stage that reads the column [`IN_SAMPLE`] of the scores;
    /// `None` for a table that lacks this column or makes the column in its own stage.
    ///
    /// # Errors
    /// Fails if the goal of the search selects no line.
    pub fn in_sample(&self, r: TableRef, line: LineId) -> Result<Option<bool>, Fault> {
        let TableRef::Stage(t, i) = r else { return Ok(None) };
        if self.plan.tables[t].in_sample_meaning().is_none() {
            return Ok(None);
        }
        Ok(Some(self.seen(t)?.has(i, line)))
    }
}

/// The column [`IN_SAMPLE`] of one table.
pub struct InSampleColumn<'a> {
    graph: &'a PlanGraph<'a>,
    /// Lines that the points of each table of scores used.
    seen: BTreeMap<usize, &'a InSampleLines>,
}

impl<'a> InSampleColumn<'a> {
    /// Creates the in-sample test of the table `t`; `None` if the table has no such column.
    ///
    /// # Errors
    /// Fails if the goal of the search selects no line.
    pub fn new(graph: &'a PlanGraph<'a>, t: usize) -> Result<Option<InSampleColumn<'a>>, Fault> {
        let node = &graph.plan.tables[t];
        if node.in_sample_meaning().is_none() {
            return Ok(None);
        }
        let mut seen = BTreeMap::new();
        for scores in (0..node.len()).filter_map(|i| scores_of(graph, t, i)).map(|(scores, _)| scores) {
            if let Entry::Vacant(new) = seen.entry(scores) {
                new.insert(graph.seen(scores)?);
            }
        }
        Ok(Some(InSampleColumn { graph, seen }))
    }

    /// Number of in-sample lines, and total number of lines, from which the rows of a unit were computed.
    pub fn lines(&self, unit: PlanUnit) -> (usize, usize) {
        let Some((scores, point)) = scores_of(self.graph, unit.table, unit.instance) else { return (0, 0) };
        let all: &[LineId] = match &unit.line {
            Some(line) => std::slice::from_ref(line),
            None => self.graph.lines_of(unit.table, unit.instance),
        };
        let seen = self.seen.get(&scores);
        (all.iter().filter(|line| seen.is_some_and(|s| s.has(point, **line))).count(), all.len())
    }
}

/// The table of scores of a point (the table itself, or the input of a pooling stage), and the point of that table.
fn scores_of(graph: &PlanGraph, t: usize, i: usize) -> Option<(usize, usize)> {
    let node = &graph.plan.tables[t];
    if node.entry.grain == Grain::Line {
        return Some((t, i));
    }
    node.inputs(i).find_map(|(kind, r)| match r {
        TableRef::Stage(t, i) if kind == InputKind::Scores => Some((t, i)),
        _ => None,
    })
}

/// In-sample lines of each point of one table, sorted.
pub struct InSampleLines(Vec<Arc<BTreeSet<LineId>>>);

impl InSampleLines {
    /// Collects the lines of every survey stage upstream of each point of the table `t`, such as fits and noises. If
    /// the table depends on a search, the list includes the lines of the goal.
    ///
    /// # Errors
    /// Fails if the goal of the search selects no line.
    fn new(graph: &PlanGraph, t: usize) -> Result<InSampleLines, Fault> {
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
        let mut above = UpstreamLines { graph, known: HashMap::new(), sets: HashMap::new() };
        let one = |i| {
            let seen = above.upstream_lines(TableRef::Stage(t, i));
            if chosen.is_subset(&seen) { seen } else { above.shared(seen.union(&chosen).copied().collect()) }
        };
        Ok(InSampleLines((0..node.len()).map(one).collect()))
    }

    /// Whether the point `i` used a line.
    pub fn has(&self, i: usize, line: LineId) -> bool {
        self.0.get(i).is_some_and(|lines| lines.contains(&line))
    }
}

/// Lines used upstream of each stage; equal sets are stored once.
struct UpstreamLines<'a> {
    graph: &'a PlanGraph<'a>,
    known: HashMap<TableRef, Arc<BTreeSet<LineId>>>,
    sets: HashMap<BTreeSet<LineId>, Arc<BTreeSet<LineId>>>,
}

impl UpstreamLines<'_> {
    fn shared(&mut self, set: BTreeSet<LineId>) -> Arc<BTreeSet<LineId>> {
        self.sets.entry(set).or_insert_with_key(|set| Arc::new(set.clone())).clone()
    }

    fn upstream_lines(&mut self, r: TableRef) -> Arc<BTreeSet<LineId>> {
        if let Some(known) = self.known.get(&r) {
            return known.clone();
        }
        let TableRef::Stage(t, i) = r else { return self.shared(BTreeSet::new()) };
        let gathers = self.graph.plan.tables[t].entry.grain == Grain::Survey;
        let own: BTreeSet<LineId> =
            if gathers { self.graph.lines_of(t, i).iter().copied().collect() } else { BTreeSet::new() };
        let mut all = self.shared(own);
        for input in self.graph.plan.instance(t, i).inputs() {
            let more = self.upstream_lines(input);
            if !more.is_subset(&all) {
                all = if all.is_empty() { more } else { self.shared(all.union(&more).copied().collect()) };
            }
        }
        self.known.insert(r, all.clone());
        all
    }
}
