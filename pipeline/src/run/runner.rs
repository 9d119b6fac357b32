//! The state of a run: which units are there, which must be computed, and what failed.

use std::{cell::OnceCell, collections::HashMap};

use schemas::{Fault, InputKind};

use super::{
    Engine, Event, Failure, Listener, Options, Outcome, remote,
    states::{State, States},
    work::Worker,
};
use crate::{
    cost::Rates,
    keys::Key,
    plan::{Graph, LineId, Ref, Unit},
    store::{Store, attempts::Tries},
};

/// A run over the tables of a plan: looks up each unit, and keeps states and failures.
pub(super) struct Runner<'a> {
    /// The plan with its data.
    pub(super) graph: &'a Graph<'a>,
    /// The store.
    pub(super) store: &'a Store,
    /// Hears of each outcome.
    pub(super) listener: &'a dyn Listener,
    /// The options of the run.
    pub(super) options: Options<'a>,
    /// The engine.
    pub(super) engine: &'a dyn Engine,
    /// Computes in this process.
    pub(super) worker: &'a Worker<'a>,
    /// The plan in the store, where the engine needs one.
    pub(super) recorded: Option<Key>,
    /// Whether units are computed by other processes.
    pub(super) abroad: bool,
    /// The attempts at units that have no answer.
    pub(super) attempts: HashMap<Key, Tries>,
    /// Expected times of units, loaded on first use.
    pub(super) rates: OnceCell<Rates>,
    /// The state of each unit.
    pub(super) states: States<'a>,
    /// The failures, each with its unit.
    pub(super) failures: Vec<(Option<Unit>, Failure)>,
    /// The number of computed units of each table, and the duration, s.
    pub(super) seconds: Vec<(usize, f64)>,
}

impl<'a> Runner<'a> {
    /// For the tables of the worker's plan.
    pub(super) fn new(
        worker: &'a Worker<'a>,
        listener: &'a dyn Listener,
        options: Options<'a>,
        recorded: Option<Key>,
    ) -> Runner<'a> {
        let (graph, store) = (worker.graph(), worker.store());
        Runner {
            graph,
            store,
            listener,
            options,
            engine: options.engine,
            worker,
            recorded,
            abroad: !options.engine.is_local(),
            attempts: store.attempts(),
            rates: OnceCell::new(),
            states: States::new(graph),
            failures: vec![],
            seconds: vec![],
        }
    }

    /// Lines that cannot be used.
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
    pub(super) fn note(&mut self, unit: Unit, state: State, outcome: Outcome, fault: Option<&Fault>) {
        self.states.set(unit, state);
        tell(self.listener, self.graph, unit, outcome, fault);
    }

    /// Reports a failure and records it.
    pub(super) fn fail(&mut self, unit: Unit, fault: Fault) {
        tell(self.listener, self.graph, unit, Outcome::Failed, Some(&fault));
        self.record(unit, fault);
    }

    /// Lists the lines that a survey stage skipped.
    pub(super) fn left_out(&mut self, unit: Unit, faults: Vec<Fault>) {
        let node = &self.graph.plan.tables[unit.table];
        let point = self.graph.plan.instance(unit.table, unit.instance).point();
        self.failures.extend(faults.into_iter().map(|fault| {
            let line = fault.place.flight.clone().zip(fault.place.line.clone());
            (Some(unit), Failure { table: node.name.clone(), point: point.clone(), line, fault })
        }));
    }

    /// The same for a reused result.
    pub(super) fn went_on_without(&mut self, unit: Unit, key: Key) {
        if unit.line.is_some() {
            return;
        }
        match self.store.remarks(key) {
            Ok(remarks) => self.left_out(unit, remarks.left_out),
            Err(fault) => self.record(unit, fault),
        }
    }

    /// Records a failure.
    pub(super) fn record(&mut self, unit: Unit, fault: Fault) {
        let state = if fault.owner.is_lasting() { State::Failed } else { State::Missing };
        self.states.set(unit, state);
        let node = &self.graph.plan.tables[unit.table];
        let line = unit.line.map(|l| self.graph.lines[l].clone());
        let point = self.graph.plan.instance(unit.table, unit.instance).point();
        self.failures.push((Some(unit), Failure { table: node.name.clone(), point, line, fault }));
    }

    /// Whether a unit is not tried again. In this process one is that did not kill its workers.
    pub(super) fn is_given_up(&self, tries: &Tries) -> bool {
        let counted = if self.abroad { tries.all() } else { tries.lost };
        counted > self.options.retries
    }

    /// The first of what a unit is made from that is not there.
    pub(super) fn missing_input(&self, unit: Unit) -> Option<Ref> {
        let plan = self.graph.plan;
        let it = plan.instance(unit.table, unit.instance);
        let missing = |(kind, r): &(InputKind, Ref)| {
            let there = match (kind.is_by_line(), unit.line) {
                _ if kind.is_record() => self.record_state(*r),
                // A fit examines its lines one by one and skips those that failed.
                (true, None) => self.survey_state(unit),
                (true, line) => self.state(*r, line),
                (false, _) => self.state(*r, None),
            };
            there != State::Done
        };
        it.kinds().into_iter().zip(it.inputs()).find(missing).map(|(_, r)| r)
    }

    /// A record is there when all its lines are, and has one at least.
    fn record_state(&self, r: Ref) -> State {
        let lines = self.graph.lines_in(r);
        let states: Vec<State> = lines.iter().map(|line| self.root_state(r, *line)).collect();
        if states.is_empty() {
            return State::Failed;
        }
        *states.iter().find(|state| **state != State::Done).unwrap_or(&State::Done)
    }

    /// Whether a unit must be computed, is available, or cannot be computed.
    pub(super) fn look(&self, unit: Unit) -> Looked {
        if let Some(r) = self.missing_input(unit) {
            return Looked::Skip(r);
        }
        match self.graph.key(unit) {
            Ok(key) => match self.store.find(key).map(|place| place.rows) {
                Some(Some(_)) => Looked::Have(key),
                Some(None) => match self.store.failed(key) {
                    Ok(Some(fault)) => Looked::Failed(key, fault),
                    Ok(None) => Looked::Need(key),
                    Err(fault) => Looked::Fault(fault),
                },
                None => match self.attempts.get(&key).filter(|tries| self.is_given_up(tries)) {
                    Some(tries) => Looked::Fault(remote::given_up(tries)),
                    None => Looked::Need(key),
                },
            },
            Err(fault) => Looked::Fault(fault),
        }
    }

    /// A survey stage waits for lines that the machine failed on, and needs at least one that is available.
    fn survey_state(&self, unit: Unit) -> State {
        let lines = self.graph.lines_of(unit.table, unit.instance);
        let states: Vec<State> = lines.iter().map(|l| self.line_is_there(*l, unit)).collect();
        if states.contains(&State::Missing) {
            return State::Missing;
        }
        if states.contains(&State::Done) { State::Done } else { State::Missing }
    }

    /// The state of `line` in all line inputs of `unit`.
    pub(super) fn line_is_there(&self, line: LineId, unit: Unit) -> State {
        let it = self.graph.plan.instance(unit.table, unit.instance);
        let inputs = self.graph.line_inputs(&it);
        let states: Vec<State> = inputs.iter().map(|(_, r)| self.root_state(*r, line)).collect();
        *states.iter().find(|s| **s != State::Done).unwrap_or(&State::Done)
    }

    /// The state of a line, with a failure further up counted as a failure, not as a gap.
    fn root_state(&self, r: Ref, line: LineId) -> State {
        let own = self.state(r, Some(line));
        if own != State::Missing {
            return own;
        }
        let Ref::Stage(t, i) = r else { return own };
        let it = self.graph.plan.instance(t, i);
        let up: Vec<State> = self.graph.line_inputs(&it).iter().map(|(_, r)| self.root_state(*r, line)).collect();
        if up.contains(&State::Failed) && !up.contains(&State::Missing) { State::Failed } else { State::Missing }
    }

    fn state(&self, r: Ref, line: Option<LineId>) -> State {
        match r {
            Ref::Map(_) => State::Done,
            Ref::Flights(i) => match line.and_then(|l| self.graph.records[i].get(&l)) {
                Some(record) if record.fault.is_none() => State::Done,
                _ => State::Failed,
            },
            Ref::Stage(table, instance) => self.states.get(Unit { table, instance, line }),
        }
    }
}

/// The outcome of looking for a unit.
pub(super) enum Looked {
    /// It is in the store.
    Have(Key),
    /// It failed before, because of the data.
    Failed(Key, Fault),
    /// It must be computed.
    Need(Key),
    /// It is made from something that is not there.
    Skip(Ref),
    /// The machine refused.
    Fault(Fault),
}

/// Reports the outcome of a unit.
pub(super) fn tell(listener: &dyn Listener, graph: &Graph, unit: Unit, outcome: Outcome, fault: Option<&Fault>) {
    let node = &graph.plan.tables[unit.table];
    let line = unit.line.map(|l| &graph.lines[l]);
    let point = &graph.plan.instance(unit.table, unit.instance).point();
    listener.hear(&Event::Unit { table: &node.name, point, line, outcome, fault });
}
