//! Table of a run: existing results are found, missing results are dispatched as tasks, and all results are laid out in
//! packs.

use std::{
    collections::{HashMap, HashSet},
    ops::Range,
};

use plan::{LineId, PlanUnit};
use schemas::{Fault, Grain, keys::HashKey};
use store::{FAILED, PackedUnit};

use super::{
    UnitOutcome,
    cut::TableAssembler,
    engine::{LocalEngine, TaskEngine, TaskWave},
    layout::{PackCover, TableLayout, cover, scattered},
    pass::unpublished,
    runner::{PlanRunner, UnitLookup, emit_outcome},
    states::UnitState,
    task::{Task, TaskUnit},
};
use crate::{Event, OutcomeCounts, cost::UnitTimeModel};

/// Unit of a table and its state.
#[derive(Clone, Copy)]
enum LayoutUnit {
    /// The unit has no rows, because an input is missing or the unit cannot be computed.
    Nothing,
    /// Stored unit.
    There(PackedUnit),
    /// Unit to compute.
    Pending(HashKey),
}

/// Table in progress: its layout and the state of each unit.
pub struct TableProgress<'a> {
    table: usize,
    cut: &'a TableAssembler<'a>,
    layout: TableLayout,
    /// State of each unit of the layout.
    known: Vec<LayoutUnit>,
}

/// Task, and the positions of its units in the layout.
pub struct LayoutTask {
    /// Units to compute or write.
    pub task: Task,
    at: Vec<usize>,
}

impl TableProgress<'_> {
    fn wanted(&self) -> Vec<Option<PackedUnit>> {
        let packed = |k: &LayoutUnit| match k {
            LayoutUnit::There(packed) => Some(*packed),
            LayoutUnit::Nothing | LayoutUnit::Pending(_) => None,
        };
        self.known.iter().map(packed).collect()
    }

    pub(super) fn pending(&self) -> usize {
        self.known.iter().filter(|k| matches!(k, LayoutUnit::Pending(_))).count()
    }

    /// Whether a stored result is in none of the packs of `cover`.
    fn lacks(&self, cover: &PackCover) -> bool {
        cover.covered.iter().zip(&self.known).any(|(covered, k)| !covered && matches!(k, LayoutUnit::There(_)))
    }

    /// Whether each chunk must be a single pack. A table of one chunk is always one pack.
    fn whole(&self, compact: bool) -> bool {
        self.layout.chunks.len() <= 1 || compact
    }

    /// Whether the stored result of the unit `i` must be written again. With `whole`, all stored results are written
    /// again together with their chunk; otherwise, only those that no pack of `cover` contains.
    fn is_stale(&self, i: usize, cover: &PackCover, whole: bool) -> bool {
        matches!(self.known[i], LayoutUnit::There(_)) && (whole || !cover.covered[i])
    }
}

impl<'a> PlanRunner<'a> {
    /// Computes the missing units of the table `t`, and returns the packs that contain it.
    pub(super) fn table(&mut self, t: usize) -> (OutcomeCounts, Vec<HashKey>) {
        let (mut count, first) = (OutcomeCounts::default(), self.failures.len());
        let Some(mut sheet) = self.sheet(t, &mut count) else { return (count, vec![]) };
        let packs = self.work(&mut sheet, &mut count);
        self.sort(&sheet, first);
        (count, packs)
    }

    /// Computes the missing units of a table, lays it out, and returns the packs that contain the table.
    fn work(&mut self, sheet: &mut TableProgress<'a>, count: &mut OutcomeCounts) -> Vec<HashKey> {
        let t = sheet.table;
        let mut before = self.cover(sheet);
        let table = &self.graph.plan.tables[t].name;
        self.listener.on_event(&Event::Computing { table, units: sheet.pending() });
        if sheet.pending() == 0 && !sheet.lacks(&before) {
            return before.packs;
        }
        let engine = self.engine;
        if !engine.is_local() && sheet.pending() > 0 {
            if let Err(fault) = self.store.write_index() {
                self.failures.push((None, unpublished(fault)));
            }
            let unit_s = self.unit_s(sheet);
            let most = engine.pace().units(sheet.pending(), unit_s);
            let tasks = self.tasks_for_workers(sheet, &before, most, self.recorded);
            self.wave(engine, sheet, tasks, unit_s, count);
            before = self.cover(sheet);
        }
        let tasks = self.tasks_here(sheet, &before, engine.is_local());
        self.wave(&LocalEngine, sheet, tasks, 0.0, count);
        let strict = self.covering(sheet, true);
        let after = if sheet.lacks(&strict) { self.covering(sheet, false) } else { strict };
        self.worker.forget(t);
        after.packs
    }

    /// Sorts the failures, from the position `first` on, by the order of the table's rows.
    fn sort(&mut self, sheet: &TableProgress, first: usize) {
        let Some(new) = self.failures.get_mut(first..).filter(|new| new.len() > 1) else { return };
        let at: HashMap<PlanUnit, usize> = sheet.layout.units.iter().enumerate().map(|(i, unit)| (*unit, i)).collect();
        new.sort_by_key(|(unit, _)| unit.and_then(|unit| at.get(&unit).copied()));
    }

    /// The table `t` with the state of its units; `None` for a table without files, or if no unit can be computed.
    pub(super) fn sheet(&mut self, t: usize, count: &mut OutcomeCounts) -> Option<TableProgress<'a>> {
        if !self.graph.plan.tables[t].keep {
            self.passed_over(t);
            return None;
        }
        let cut = match self.worker.cut(t) {
            Ok(cut) => cut,
            Err(fault) => {
                let units: Vec<PlanUnit> = self.graph.units(t).collect();
                count.failed = units.len();
                units.into_iter().for_each(|unit| self.fail(unit, fault.clone()));
                return None;
            }
        };
        let layout = TableLayout::new(self.graph, t, cut);
        let known = layout.units.iter().map(|u| self.known(*u, cut, count)).collect();
        Some(TableProgress { table: t, cut, layout, known })
    }

    fn covering(&self, sheet: &TableProgress, strict: bool) -> PackCover {
        cover(&self.store.catalogue(), sheet.cut.kind, &sheet.layout, &sheet.wanted(), strict)
    }

    /// Packs that contain the stored units.
    pub(super) fn cover(&self, sheet: &TableProgress) -> PackCover {
        let found = self.covering(sheet, self.options.compact);
        if scattered(found.packs.len(), sheet.layout.chunks.len()) { self.covering(sheet, true) } else { found }
    }

    /// One task per chunk, with the units to write and, if `compute` is true, the units to compute. If `compute` is
    /// false, a chunk with units that an interrupt skipped stays in parts until another run completes it.
    fn tasks_here(&self, sheet: &TableProgress, cover: &PackCover, compute: bool) -> Vec<LayoutTask> {
        let whole = sheet.whole(self.options.compact);
        let pending = |i: usize| matches!(sheet.known[i], LayoutUnit::Pending(_));
        let of_chunk = |range: &Range<usize>| {
            let unfinished = range.clone().any(pending);
            if unfinished && !compute || !unfinished && !range.clone().any(|i| sheet.is_stale(i, cover, false)) {
                return None;
            }
            let at: Vec<usize> = range.clone().filter(|i| pending(*i) || sheet.is_stale(*i, cover, whole)).collect();
            Some(self.handed(sheet, None, false, at))
        };
        sheet.layout.chunks.iter().filter_map(of_chunk).collect()
    }

    /// Expected time of a unit of the table, in seconds.
    pub(super) fn unit_s(&self, sheet: &TableProgress) -> f64 {
        let rates = self.rates.get_or_init(|| UnitTimeModel::new(self.store));
        rates.unit_s(self.graph, self.store, sheet.table)
    }

    /// Lists the remaining work in tasks of at most `most` units. A chunk that is computed as a whole becomes a file of
    /// the table. Other tasks make parts, which the driver lays out.
    pub(super) fn tasks_for_workers(
        &self,
        sheet: &TableProgress,
        cover: &PackCover,
        most: usize,
        plan: Option<HashKey>,
    ) -> Vec<LayoutTask> {
        let (most, whole) = (most.max(1), sheet.whole(self.options.compact));
        let mut tasks = vec![];
        for range in &sheet.layout.chunks {
            let pending: Vec<usize> =
                range.clone().filter(|i| matches!(sheet.known[*i], LayoutUnit::Pending(_))).collect();
            if pending.is_empty() {
                continue;
            }
            if pending.len() <= most && !range.clone().any(|i| sheet.is_stale(i, cover, whole)) {
                tasks.push(self.handed(sheet, plan, false, pending));
                continue;
            }
            for group in self.together(sheet, &pending) {
                tasks.extend(group.chunks(most).map(|at| self.handed(sheet, plan, true, at.to_vec())));
            }
        }
        tasks
    }

    /// Units of a chunk, one per key, in groups that share work. The survey units of a group use the same lines. Other
    /// units are ordered by line.
    fn together(&self, sheet: &TableProgress, pending: &[usize]) -> Vec<Vec<usize>> {
        let mut seen = HashSet::new();
        let is_first = |i: &usize| matches!(sheet.known[*i], LayoutUnit::Pending(key) if seen.insert(key));
        let mut first: Vec<usize> = pending.iter().copied().filter(is_first).collect();
        match self.worker.grain(sheet.table) {
            Grain::Line => {
                first.sort_by_key(|i| (sheet.layout.units[*i].line, sheet.layout.units[*i].instance));
                vec![first]
            }
            Grain::Map => vec![first],
            Grain::Survey => {
                let mut groups: Vec<Vec<usize>> = vec![];
                let mut at: HashMap<String, usize> = HashMap::new();
                for i in first {
                    let group = *at.entry(self.worker.seen(sheet.layout.units[i])).or_insert_with(|| {
                        groups.push(vec![]);
                        groups.len() - 1
                    });
                    groups[group].push(i);
                }
                groups
            }
        }
    }

    fn handed(&self, sheet: &TableProgress, plan: Option<HashKey>, part: bool, at: Vec<usize>) -> LayoutTask {
        let survey = self.worker.grain(sheet.table) == Grain::Survey;
        let mut known: HashMap<String, Vec<LineId>> = HashMap::new();
        let mut units = Vec::with_capacity(at.len());
        for i in &at {
            let unit = sheet.layout.units[*i];
            let (key, have) = match sheet.known[*i] {
                LayoutUnit::Pending(key) => (key, false),
                LayoutUnit::There(PackedUnit { key, .. }) => (key, true),
                LayoutUnit::Nothing => continue,
            };
            let without = if survey && !have {
                known.entry(self.worker.seen(unit)).or_insert_with(|| self.failed_lines(unit)).clone()
            } else {
                vec![]
            };
            units.push(TaskUnit { point: unit.instance, line: unit.line, key, have, without });
        }
        LayoutTask { task: Task::new(plan, &self.graph.plan.tables[sheet.table].name, part, units), at }
    }

    /// Lines of a survey unit that have failed.
    fn failed_lines(&self, unit: PlanUnit) -> Vec<LineId> {
        let lines = self.graph.lines_of(unit.table, unit.instance).iter().copied();
        lines.filter(|line| self.line_is_there(*line, unit) == UnitState::Failed).collect()
    }

    /// Computes some tasks in an engine, and records the outcomes of their units.
    fn wave(
        &mut self,
        engine: &dyn TaskEngine,
        sheet: &mut TableProgress,
        tasks: Vec<LayoutTask>,
        unit_s: f64,
        count: &mut OutcomeCounts,
    ) {
        if tasks.is_empty() {
            return;
        }
        let (tasks, places): (Vec<Task>, Vec<Vec<usize>>) = tasks.into_iter().map(|h| (h.task, h.at)).unzip();
        let (listener, graph) = (self.listener, self.graph);
        let on_outcome = |unit: PlanUnit, outcome: UnitOutcome, fault: Option<&Fault>| {
            emit_outcome(listener, graph, unit, outcome, fault)
        };
        let wave = TaskWave { worker: self.worker, table: sheet.table, tasks: &tasks, unit_s, on_outcome: &on_outcome };
        let receipts = engine.run(&wave);
        if !engine.is_local() {
            // The results are in packs that other processes wrote.
            self.store.refresh();
        }
        let mut of_key: HashMap<HashKey, (UnitOutcome, Option<Fault>)> = HashMap::new();
        for (receipt, places) in receipts.into_iter().zip(places) {
            let mut answers = receipt.map(|r| r.units).unwrap_or_default().into_iter().peekable();
            for i in places {
                let (LayoutUnit::Pending(key), unit) = (sheet.known[i], sheet.layout.units[i]) else { continue };
                let own = answers.next_if(|a| (a.point, a.line, a.key) == (unit.instance, unit.line, key));
                let Some(answer) = own else { continue };
                if !engine.is_local() {
                    of_key.insert(key, (answer.outcome, answer.fault.clone()));
                }
                self.answered(sheet, i, key, answer.outcome, answer.fault, count);
            }
        }
        let repeats = if of_key.is_empty() { 0 } else { sheet.known.len() };
        for i in 0..repeats {
            let (LayoutUnit::Pending(key), unit) = (sheet.known[i], sheet.layout.units[i]) else { continue };
            let Some((outcome, fault)) = of_key.get(&key).cloned() else { continue };
            let outcome = if outcome == UnitOutcome::Computed { UnitOutcome::Reused } else { outcome };
            on_outcome(unit, outcome, fault.as_ref());
            self.answered(sheet, i, key, outcome, fault, count);
        }
    }

    /// Records the outcome of a unit.
    fn answered(
        &mut self,
        sheet: &mut TableProgress,
        i: usize,
        key: HashKey,
        outcome: UnitOutcome,
        fault: Option<Fault>,
        count: &mut OutcomeCounts,
    ) {
        let unit = sheet.layout.units[i];
        let packed =
            |rows| LayoutUnit::There(PackedUnit { key, passthrough_hash: sheet.cut.passthrough_hash(unit), rows });
        let fault = match (outcome, fault) {
            (UnitOutcome::Computed | UnitOutcome::Reused, None) => None,
            (_, Some(fault)) => Some(fault),
            (UnitOutcome::Failed | UnitOutcome::Skipped, None) => Some(Fault::bug("a unit failed without a reason")),
        };
        let Some(fault) = fault else {
            *(if outcome == UnitOutcome::Computed { &mut count.computed } else { &mut count.reused }) += 1;
            sheet.known[i] = packed(0);
            self.states.set(unit, UnitState::Done);
            return self.report_skipped_lines(unit, key);
        };
        count.failed += 1;
        if fault.owner.is_lasting() {
            sheet.known[i] = packed(FAILED);
            self.report_skipped_lines(unit, key);
        } else {
            sheet.known[i] = LayoutUnit::Nothing;
        }
        self.record(unit, fault);
    }

    /// Sets the states of a table whose results are not kept: each unit is computed on demand if its inputs are
    /// available.
    fn passed_over(&mut self, t: usize) {
        let units: Vec<PlanUnit> = self.graph.units(t).collect();
        for unit in units {
            let state = if self.missing_input(unit).is_none() { UnitState::Done } else { UnitState::Missing };
            self.states.set(unit, state);
        }
    }

    /// Records the state of a unit and reports it as an event.
    fn known(&mut self, unit: PlanUnit, cut: &TableAssembler, count: &mut OutcomeCounts) -> LayoutUnit {
        match self.look(unit) {
            UnitLookup::Skip(r) => {
                count.skipped += 1;
                let name = self.graph.plan.name_of(r);
                let why = Fault::data(format!("its input `{name}` could not be computed"));
                self.note(unit, UnitState::Missing, UnitOutcome::Skipped, Some(&why));
                LayoutUnit::Nothing
            }
            UnitLookup::Have(key) => {
                count.reused += 1;
                self.note(unit, UnitState::Done, UnitOutcome::Reused, None);
                self.report_skipped_lines(unit, key);
                LayoutUnit::There(PackedUnit { key, passthrough_hash: cut.passthrough_hash(unit), rows: 0 })
            }
            UnitLookup::Failed(key, fault) => {
                count.failed += 1;
                self.report_skipped_lines(unit, key);
                self.fail(unit, fault);
                LayoutUnit::There(PackedUnit { key, passthrough_hash: cut.passthrough_hash(unit), rows: FAILED })
            }
            UnitLookup::Fault(fault) => {
                count.failed += 1;
                self.fail(unit, fault);
                LayoutUnit::Nothing
            }
            UnitLookup::Need(key) => LayoutUnit::Pending(key),
        }
    }
}
