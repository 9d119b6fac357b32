//! State of a run: available units, units to compute, and failures.

use std::{cell::OnceCell, collections::HashMap};

use plan::{LineId, PlanGraph, PlanUnit, TableRef};
use schemas::{Fault, InputKind, keys::HashKey};
use store::{Store, attempts::UnitAttempts};

use super::{
    Event, Failure, Listener, RunOptions, TaskEngine, UnitOutcome, remote,
    states::{UnitState, UnitStates},
    work::UnitWorker,
};
use crate::cost::UnitTimeModel;

/// Run over the tables of a plan, with the states and failures of its units.
pub(super) struct PlanRunner<'a> {
    /// Plan with its data.
    pub(super) graph: &'a PlanGraph<'a>,
    /// The store.
    pub(super) store: &'a Store,
    /// Receives each outcome.
    pub(super) listener: &'a dyn Listener,
    /// Options of the run.
    pub(super) options: RunOptions<'a>,
    /// The engine.
    pub(super) engine: &'a dyn TaskEngine,
    /// Worker in this process.
    pub(super) worker: &'a UnitWorker<'a>,
    /// Hash of the plan in the store, if the engine needs a plan there.
    pub(super) recorded: Option<HashKey>,
    /// Whether other processes compute units.
    pub(super) is_remote: bool,
    /// Earlier attempts at units that still have no answer.
    pub(super) attempts: HashMap<HashKey, UnitAttempts>,
    /// Expected times of units, loaded on first use.
    pub(super) rates: OnceCell<UnitTimeModel>,
    /// State of each unit.
    pub(super) states: UnitStates<'a>,
    /// Failures, each with its unit.
    pub(super) failures: Vec<(Option<PlanUnit>, Failure)>,
    /// Number of computed units of each table, and the duration, in seconds.
    pub(super) seconds: Vec<(usize, f64)>,
}

impl<'a> PlanRunner<'a> {
    /// Creates a runner for the tables of the worker's plan.
    pub(super) fn new(
        worker: &'a UnitWorker<'a>,
        listener: &'a dyn Listener,
        options: RunOptions<'a>,
        recorded: Option<HashKey>,
    ) -> PlanRunner<'a> {
        let (graph, store) = (worker.graph(), worker.store());
        PlanRunner {
            graph,
            store,
            listener,
            options,
            engine: options.engine,
            worker,
            recorded,
            is_remote: !options.engine.is_local(),
            attempts: store.attempts(),
            rates: OnceCell::new(),
            states: UnitStates::new(graph),
            failures: vec![],
            seconds: vec![],
        }
    }

    /// Records the unusable lines.
    pub(super) fn sources(&mut self) {
        for (flights, records) in self.graph.plan.flights.iter().zip(&self.graph.records) {
            for record in records.values() {
                for fault in record.fault.iter().chain(&record.more_faults) {
                    let line = Some((record.flight.clone(), record.line.clone()));
                    let (table, fault) = (flights.name.clone(), fault.clone());
                    self.failures.push((None, Failure { table, point: Default::default(), line, fault }));
                }
            }
        }
    }

    /// Records and reports the outcome of a unit.
    pub(super) fn note(&mut self, unit: PlanUnit, state: UnitState, outcome: UnitOutcome, fault: Option<&Fault>) {
        self.states.set(unit, state);
        emit_outcome(self.listener, self.graph, unit, outcome, fault);
    }

    /// Reports a failure and records it.
    pub(super) fn fail(&mut self, unit: PlanUnit, fault: Fault) {
        emit_outcome(self.listener, self.graph, unit, UnitOutcome::Failed, Some(&fault));
        self.record(unit, fault);
    }

    /// Adds to the failures the lines that a survey stage skipped.
    pub(super) fn left_out(&mut self, unit: PlanUnit, faults: Vec<Fault>) {
        let node = &self.graph.plan.tables[unit.table];
        let point = self.graph.plan.instance(unit.table, unit.instance).point();
        self.failures.extend(faults.into_iter().map(|fault| {
            let line = fault.place.flight.clone().zip(fault.place.line.clone());
            (Some(unit), Failure { table: node.name.clone(), point: point.clone(), line, fault })
        }));
    }

    /// Adds to the failures the lines that were skipped when a reused result was computed.
    pub(super) fn report_skipped_lines(&mut self, unit: PlanUnit, key: HashKey) {
        if unit.line.is_some() {
            return;
        }
        match self.store.remarks(key) {
            Ok(remarks) => self.left_out(unit, remarks.left_out),
            Err(fault) => self.record(unit, fault),
        }
    }

    /// Records a failure.
    pub(super) fn record(&mut self, unit: PlanUnit, fault: Fault) {
        let state = if fault.owner.is_lasting() { UnitState::Failed } else { UnitState::Missing };
        self.states.set(unit, state);
        let node = &self.graph.plan.tables[unit.table];
        let line = unit.line.map(|l| self.graph.lines[l].clone());
        let point = self.graph.plan.instance(unit.table, unit.instance).point();
        self.failures.push((Some(unit), Failure { table: node.name.clone(), point, line, fault }));
    }

    /// Whether a unit has failed too often to be retried. If units are computed in this process, only the attempts that
    /// ended with the loss of a worker count.
    pub(super) fn is_given_up(&self, tries: &UnitAttempts) -> bool {
        let counted = if self.is_remote { tries.all() } else { tries.lost };
        counted > self.options.retries
    }

    /// First missing input of a unit.
    pub(super) fn missing_input(&self, unit: PlanUnit) -> Option<TableRef> {
        let plan = self.graph.plan;
        let it = plan.instance(unit.table, unit.instance);
        let missing = |(kind, r): &(InputKind, TableRef)| {
            let there = match (kind.is_by_line(), unit.line) {
                _ if kind.is_record() => self.record_state(*r),
                // A survey stage such as a fit checks its lines one by one and skips failed lines.
                (true, None) => self.survey_state(unit),
                (true, line) => self.state(*r, line),
                (false, _) => self.state(*r, None),
            };
            there != UnitState::Done
        };
        it.kinds().into_iter().zip(it.inputs()).find(missing).map(|(_, r)| r)
    }

    /// A record is available when it has at least one line and all its lines are available.
    fn record_state(&self, r: TableRef) -> UnitState {
        let lines = self.graph.lines_in(r);
        let states: Vec<UnitState> = lines.iter().map(|line| self.root_state(r, *line)).collect();
        if states.is_empty() {
            return UnitState::Failed;
        }
        *states.iter().find(|state| **state != UnitState::Done).unwrap_or(&UnitState::Done)
    }

    /// Determines whether a unit is available, must be computed, or cannot be computed.
    pub(super) fn look(&self, unit: PlanUnit) -> UnitLookup {
        if let Some(r) = self.missing_input(unit) {
            return UnitLookup::Skip(r);
        }
        match self.graph.key(unit) {
            Ok(key) => match self.store.find(key).map(|place| place.rows) {
                Some(Some(_)) => UnitLookup::Have(key),
                Some(None) => match self.store.failed(key) {
                    Ok(Some(fault)) => UnitLookup::Failed(key, fault),
                    Ok(None) => UnitLookup::Need(key),
                    Err(fault) => UnitLookup::Fault(fault),
                },
                None => match self.attempts.get(&key).filter(|tries| self.is_given_up(tries)) {
                    Some(tries) => UnitLookup::Fault(remote::given_up(tries)),
                    None => UnitLookup::Need(key),
                },
            },
            Err(fault) => UnitLookup::Fault(fault),
        }
    }

    /// A survey stage waits for lines that failed because of the machine, and needs at least one available line.
    fn survey_state(&self, unit: PlanUnit) -> UnitState {
        let lines = self.graph.lines_of(unit.table, unit.instance);
        let states: Vec<UnitState> = lines.iter().map(|l| self.line_is_there(*l, unit)).collect();
        if states.contains(&UnitState::Missing) {
            return UnitState::Missing;
        }
        if states.contains(&UnitState::Done) { UnitState::Done } else { UnitState::Missing }
    }

    /// State of `line` in all line inputs of `unit`.
    pub(super) fn line_is_there(&self, line: LineId, unit: PlanUnit) -> UnitState {
        let it = self.graph.plan.instance(unit.table, unit.instance);
        let inputs = self.graph.line_inputs(&it);
        let states: Vec<UnitState> = inputs.iter().map(|(_, r)| self.root_state(*r, line)).collect();
        *states.iter().find(|s| **s != UnitState::Done).unwrap_or(&UnitState::Done)
    }

    /// State of a line; if the line failed in an ancestor, it counts as failed, not as missing.
    fn root_state(&self, r: TableRef, line: LineId) -> UnitState {
        let own = self.state(r, Some(line));
        if own != UnitState::Missing {
            return own;
        }
        let TableRef::Stage(t, i) = r else { return own };
        let it = self.graph.plan.instance(t, i);
        let up: Vec<UnitState> = self.graph.line_inputs(&it).iter().map(|(_, r)| self.root_state(*r, line)).collect();
        if up.contains(&UnitState::Failed) && !up.contains(&UnitState::Missing) {
            UnitState::Failed
        } else {
            UnitState::Missing
        }
    }

    fn state(&self, r: TableRef, line: Option<LineId>) -> UnitState {
        match r {
            TableRef::Map(_) => UnitState::Done,
            TableRef::Flights(i) => match line.and_then(|l| self.graph.records[i].get(&l)) {
                Some(record) if record.fault.is_none() => UnitState::Done,
                _ => UnitState::Failed,
            },
            TableRef::Stage(table, instance) => self.states.get(PlanUnit { table, instance, line }),
        }
    }
}

/// Outcome of the lookup of a unit.
pub(super) enum UnitLookup {
    /// The unit is in the store.
    Have(HashKey),
    /// The unit failed earlier, because of the data.
    Failed(HashKey, Fault),
    /// The unit must be computed.
    Need(HashKey),
    /// An input of the unit is missing.
    Skip(TableRef),
    /// The machine failed.
    Fault(Fault),
}

/// Reports the outcome of a unit.
pub(super) fn emit_outcome(
    listener: &dyn Listener,
    graph: &PlanGraph,
    unit: PlanUnit,
    outcome: UnitOutcome,
    fault: Option<&Fault>,
) {
    let node = &graph.plan.tables[unit.table];
    let line = unit.line.map(|l| &graph.lines[l]);
    let point = &graph.plan.instance(unit.table, unit.instance).point();
    listener.on_event(&Event::Unit { table: &node.name, point, line, outcome, fault });
}
