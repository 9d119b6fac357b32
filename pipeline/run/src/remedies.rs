//! Trials of remedies: the worst line of each kind of warning is navigated and scored again with changed keys. A remedy
//! that improves the line becomes part of the cause. Nothing is written to the store.

use std::{
    collections::{BTreeSet, HashMap},
    sync::atomic::Ordering,
};

use plan::{
    LineId, Plan, PlanGraph, PlanUnit, SweepPoint,
    spec::{Spec, StageDecl},
};
use results::warnings::{self, Improvement, LineFacts, LineMetrics, Remedy, Warning};
use schemas::{Fault, Grain, SpecEntry, StageEntry, StageRole};
use store::Store;

use super::{Event, INTERRUPTED, Listener, SilentListener, held::LineColumnCache, work::UnitWorker};

/// Tries the remedies of the worst warning of each kind. The first remedy that improves the warning's line is added to
/// the warning's cause.
/// A warning that equals a warning of the last run keeps its cause without a trial.
///
/// # Errors
/// Fails if the store cannot be read. A remedy that cannot be computed is skipped.
pub(super) fn try_remedies(
    graph: &PlanGraph,
    store: &Store,
    listener: &dyn Listener,
    found: &mut [Warning],
) -> Result<(), Fault> {
    if found.is_empty() {
        return Ok(());
    }
    // If the table of the last run is damaged, no causes are kept; this run writes the table again.
    let written = warnings::written(graph.plan, store).ok().flatten().unwrap_or_default();
    let mut tried = TriedRemedies { graph, store, results: HashMap::new() };
    for i in warnings::worst(found) {
        let warning = &found[i];
        if INTERRUPTED.load(Ordering::Relaxed) {
            return Ok(());
        }
        let known = written.iter().find(|old| Warning { cause: warning.cause.clone(), ..(*old).clone() } == *warning);
        let cause = match known {
            Some(old) => old.cause.clone(),
            None => match FlaggedLine::find(graph, store, warning)? {
                Some(line) => {
                    let tried = tried.improvement(&line, warning, listener)?;
                    let causes: Vec<String> = warning.cause.clone().into_iter().chain(tried).collect();
                    (!causes.is_empty()).then(|| causes.join("; "))
                }
                None => continue,
            },
        };
        found[i].cause = cause;
    }
    Ok(())
}

/// Line of a warning with its navigation.
struct FlaggedLine {
    /// Unit of the scores.
    unit: PlanUnit,
    line: LineId,
    /// Metrics of the line.
    row: LineMetrics,
    /// Table of the navigation.
    navigation: usize,
}

impl FlaggedLine {
    /// Line of `warning`; `None` without a line or a navigation.
    fn find(graph: &PlanGraph, store: &Store, warning: &Warning) -> Result<Option<FlaggedLine>, Fault> {
        let plan = graph.plan;
        let line = warning.line.as_ref().and_then(|line| graph.lines.binary_search(line).ok());
        let (Some(line), Ok(table)) = (line, plan.table(&warning.stage)) else { return Ok(None) };
        if plan.tables[table].entry.role != Some(StageRole::Scores) {
            return Ok(None);
        }
        let Some(it) = plan.instances(table).find(|it| it.point() == warning.point) else { return Ok(None) };
        let Some((navigation, _)) = warnings::navigation(plan, &it.inputs()) else { return Ok(None) };
        let unit = PlanUnit { table, instance: it.index, line: Some(line) };
        let row = LineMetrics::read(&store.get(graph.key(unit)?, &LineMetrics::COLUMNS)?);
        Ok(Some(FlaggedLine { unit, line, row, navigation }))
    }
}

/// Metrics of each tried remedy; `None` for a remedy that cannot be computed.
struct TriedRemedies<'a> {
    graph: &'a PlanGraph<'a>,
    store: &'a Store,
    results: HashMap<(PlanUnit, String), Option<LineMetrics>>,
}

impl TriedRemedies<'_> {
    /// The first remedy that removes all flags of the warning's line or, if none does, the first that improves the
    /// line. The figures of its trial are part of the text.
    fn improvement(
        &mut self,
        flagged: &FlaggedLine,
        warning: &Warning,
        listener: &dyn Listener,
    ) -> Result<Option<String>, Fault> {
        let plan = self.graph.plan;
        let inputs = plan.instance(flagged.unit.table, flagged.unit.instance).inputs();
        let facts = LineFacts::gather(self.graph, self.store, &inputs, flagged.line, &flagged.row)?;
        let is_set = |key: &str| plan.decl(flagged.navigation).is_some_and(|decl| decl.args.contains_key(key));
        let mut better = None;
        for remedy in warnings::remedies(warning.kind, &facts, &is_set) {
            let text = remedy.text();
            let store = self.store;
            let result = self.results.entry((flagged.unit, text.clone())).or_insert_with(|| {
                listener.on_event(&Event::Trying { table: &warning.stage, remedy: &text });
                let changed = changed(plan, flagged, &warning.point, &remedy)?;
                scored(&changed, store, &warning.stage, warning.line.as_ref()?)
            });
            let improvement = result.as_ref().and_then(|row| warnings::improvement(warning.kind, &flagged.row, row));
            let Some(Improvement { figures, is_flagged }) = improvement else { continue };
            let found = format!("{}: {text}, this line has {figures}", remedy.subject);
            if !is_flagged {
                return Ok(Some(found));
            }
            better.get_or_insert_with(|| format!("{found}; the line is still flagged"));
        }
        Ok(better)
    }
}

/// Plan of the scores of a flagged line at one point with a remedy; `None` if the plan is not valid.
fn changed(plan: &Plan, flagged: &FlaggedLine, point: &SweepPoint, remedy: &Remedy) -> Option<Plan> {
    let tables = plan.rests_on(flagged.unit.table);
    let reads_track = |t: usize| plan.rests_on(t).contains(&flagged.navigation);
    let mut stages: Vec<StageDecl> = vec![];
    for t in &tables {
        let mut decl = plan.decl(*t)?.clone();
        if *t == flagged.navigation {
            apply(remedy, &mut decl);
        }
        // Results with a changed input are computed on demand.
        if reads_track(*t) && plan.tables[*t].entry.grain == Grain::Line && *t != flagged.unit.table {
            (decl.publish, decl.keep.0) = (false, false);
            decl.carry.clear();
        }
        stages.push(decl);
    }
    let mut spec = Spec { stages, search: None, trials: vec![], publish: None, ..plan.spec.clone() };
    let used: BTreeSet<&str> =
        tables.iter().flat_map(|t| &plan.tables[*t].axes).map(|axis| plan.spec.axes[*axis].name.as_str()).collect();
    spec.axes.retain(|axis| used.contains(axis.name.as_str()));
    for axis in &mut spec.axes {
        axis.values = vec![point.get(&axis.name).or(axis.values.first())?.clone()];
    }
    spec.searched = spec.axes.len()..spec.axes.len();
    let entries: Vec<StageEntry> = tables.iter().map(|t| plan.tables[*t].entry.clone()).collect();
    Plan::new(spec, &entries).ok()
}

fn apply(remedy: &Remedy, decl: &mut StageDecl) {
    for (key, value) in &remedy.changes {
        match (value, decl.args.get_mut(*key)) {
            (Some(value), Some(entry)) => entry.value = value.clone(),
            (Some(value), None) => {
                let at = decl.at.clone();
                decl.args.insert((*key).to_owned(), SpecEntry { value: value.clone(), key_at: at.clone(), at });
            }
            (None, _) => drop(decl.args.remove(*key)),
        }
    }
}

/// Metrics of a line of `plan`, computed without writing to the store; `None` if they cannot be computed.
fn scored(plan: &Plan, store: &Store, scores: &str, line: &(String, String)) -> Option<LineMetrics> {
    let graph = PlanGraph::new(plan, store, &|_, _| {}).ok()?;
    let line = graph.lines.binary_search(line).ok()?;
    let unit = PlanUnit { table: plan.table(scores).ok()?, instance: 0, line: Some(line) };
    let worker = UnitWorker::new(&graph, store, &SilentListener);
    let rows = worker.alone(unit, line, &mut LineColumnCache::new(&worker)).ok()?;
    Some(LineMetrics::read(&rows))
}
