//! Running a plan: what is not in the store is computed, the rest is reused, and what fails stays apart.

mod events;
mod left_out;
mod publish;
mod quality;
mod work;

use std::{
    collections::HashMap,
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use rayon::prelude::*;
use schemas::{Fault, Grain, Owner};

pub use events::{Count, Event, Listener, Outcome, Quiet};

use crate::{
    keys::Key,
    plan::{Graph, LineId, Plan, Ref, Unit},
    sources::ReadStep,
    spec::Faults,
    store::Store,
    views::{
        self,
        scores::{self, Scores},
        warnings::{self, Warning},
    },
};
use work::{Done, Task, Worker};

/// How a run ended.
pub struct Summary {
    /// What happened to each table, in the plan's order.
    pub tables: Vec<(String, Count)>,
    /// What failed, in a fixed order.
    pub failures: Vec<Failure>,
    /// Findings in the data: rows of the table `quality`.
    pub quality: usize,
    /// Lines that have any.
    pub quality_lines: usize,
    /// What is not to be trusted as it is; none of an interrupted run.
    pub warnings: Vec<Warning>,
    /// The pooled scores of each table of scores.
    pub scores: Vec<(String, Scores)>,
    /// Choices made for the user.
    pub notes: Vec<String>,
    /// How long each table took, s, in the order of `tables`.
    pub seconds: Vec<f64>,
    /// What was asked, and of which data: the same for the same spec and inputs.
    pub run: String,
    /// Whether it was interrupted.
    pub interrupted: bool,
    /// Where the tables are.
    pub folder: std::path::PathBuf,
}

impl Summary {
    /// All tables together.
    pub fn total(&self) -> Count {
        self.tables.iter().fold(Count::default(), |sum, (_, c)| sum + *c)
    }
}

/// Something that could not be computed.
#[derive(Clone, Debug)]
pub struct Failure {
    /// The table, or the source.
    pub table: String,
    /// The sweep point.
    pub point: crate::plan::Point,
    /// The line; none for a survey stage.
    pub line: Option<(String, String)>,
    /// Why.
    pub fault: Fault,
}

/// The failures as they are said: one message for a mistake that several lines of a file have, with the number of lines.
pub fn said_once(failures: &[Failure]) -> Vec<(&Failure, usize)> {
    let shape = |f: &Failure| f.fault.what.chars().filter(|c| !c.is_ascii_digit() && !".,-e".contains(*c)).collect();
    let mistake = |f: &Failure| -> Option<(String, String, String)> {
        // Only what is wrong with a source; a stage fails for reasons of its own.
        let file = f.fault.place.file.clone()?;
        Some((file, f.fault.place.column.clone()?, shape(f)))
    };
    let mut said: Vec<(&Failure, usize)> = vec![];
    let mut at: HashMap<(String, String, String), usize> = HashMap::new();
    for failure in failures {
        let Some(mistake) = mistake(failure) else {
            said.push((failure, 1));
            continue;
        };
        match at.get(&mistake).and_then(|i| said.get_mut(*i)) {
            Some((_, lines)) => *lines += 1,
            None => {
                at.insert(mistake, said.len());
                said.push((failure, 1));
            }
        }
    }
    said
}

/// Set to stop a run after what is under way.
pub static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Whether the sources are read and units are being computed.
pub static STARTED: AtomicBool = AtomicBool::new(false);

/// What became of a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Done,
    /// The data cannot give it; the same on every run.
    Failed,
    /// The machine failed, or it rests on something that is not there.
    Missing,
}

/// Runs `plan` in `store`, on rayon's current thread pool.
///
/// # Errors
/// When a source cannot be read or the store cannot be written; nothing has been run then.
pub fn run(plan: &Plan, store: &Store, listener: &dyn Listener) -> Result<Summary, Faults> {
    let tick = |table: &str, step: &ReadStep| listener.hear(&Event::Reading { table, step });
    let graph = Graph::new(plan, store, &tick)?;
    STARTED.store(true, Ordering::SeqCst);
    let units: usize = (0..plan.tables.len()).map(|t| graph.unit_count(t)).sum();
    let run = run_id(&graph);
    listener.hear(&Event::Started { pipeline: &plan.spec.name, units, run: &run, notes: &plan.notes });
    let mut runner =
        Runner { graph: &graph, store, listener, states: HashMap::new(), failures: vec![], seconds: vec![] };
    runner.sources();
    let mut tables = vec![];
    let mut trouble = vec![];
    for (t, node) in plan.tables.iter().enumerate() {
        if INTERRUPTED.load(Ordering::Relaxed) {
            break;
        }
        let started = Instant::now();
        let count = runner.table(t);
        runner.seconds.push((count.computed, started.elapsed().as_secs_f64()));
        listener.hear(&Event::Publishing { table: &node.name });
        if !INTERRUPTED.load(Ordering::Relaxed)
            && let Err(fault) = publish::table(&graph, store, t, &|u| runner.states.get(&u) == Some(&State::Done))
        {
            trouble.push(fault);
        }
        listener.hear(&Event::Table { table: &node.name, count, seconds: started.elapsed().as_secs_f64() });
        tables.push((node.name.clone(), count));
    }
    let interrupted = INTERRUPTED.load(Ordering::Relaxed);
    let Runner { mut failures, seconds, states, .. } = runner;
    failures.extend(trouble.into_iter().map(|fault| Failure {
        table: "publish".into(),
        point: Default::default(),
        line: None,
        fault,
    }));
    let mut warnings = vec![];
    if !interrupted {
        let there = |unit: Unit| states.get(&unit) == Some(&State::Done);
        let last = warnings::find(&graph, store, &there).and_then(|found| {
            publish::warnings(plan, store, &found)?;
            warnings = found;
            publish::failures(plan, store, &failures)?;
            quality::publish(&graph, store)?;
            views::record(&graph, store, &seconds)
        });
        if let Err(fault) = last {
            failures.push(Failure { table: "publish".into(), point: Default::default(), line: None, fault });
        }
    }
    let (quality, quality_lines) = quality::count(&graph);
    let folder = store.root().join("tables").join(&plan.spec.name);
    let scores = if interrupted { vec![] } else { scores::all(plan, &folder, &warnings) };
    let seconds = seconds.into_iter().map(|(_, s)| s).collect();
    let notes = plan.notes.clone();
    let summary = Summary {
        tables,
        failures,
        quality,
        quality_lines,
        warnings,
        scores,
        notes,
        seconds,
        run,
        interrupted,
        folder,
    };
    listener.hear(&Event::Finished { summary: &summary });
    Ok(summary)
}

/// What is asked of which data, in 16 hexadecimal digits: pipeline, seed, and the key of every unit of every table. A
/// comment in the spec, the number of threads and what the store already holds do not change it.
fn run_id(graph: &Graph) -> String {
    let spec = &graph.plan.spec;
    let mut parts = vec!["run".to_owned(), spec.name.clone(), spec.seed.to_string()];
    for (t, node) in graph.plan.tables.iter().enumerate() {
        parts.push(node.name.clone());
        let key = |unit: Unit| graph.key(unit).map_or_else(|_| "none".to_owned(), |key| key.to_string());
        parts.extend(graph.units(t).map(key));
    }
    Key::of(parts).to_string().chars().take(16).collect()
}

struct Runner<'a> {
    graph: &'a Graph<'a>,
    store: &'a Store,
    listener: &'a dyn Listener,
    states: HashMap<Unit, State>,
    failures: Vec<Failure>,
    seconds: Vec<(usize, f64)>,
}

impl Runner<'_> {
    /// Lines that cannot be used at all.
    fn sources(&mut self) {
        for (flights, records) in self.graph.plan.flights.iter().zip(&self.graph.records) {
            for record in records.values() {
                for fault in record.fault.iter().chain(&record.more_faults) {
                    let line = Some((record.flight.clone(), record.line.clone()));
                    self.failures.push(Failure {
                        table: flights.name.clone(),
                        point: Default::default(),
                        line,
                        fault: fault.clone(),
                    });
                }
            }
        }
    }

    /// Computes what is missing of one table.
    fn table(&mut self, t: usize) -> Count {
        let mut count = Count::default();
        let mut pending: Vec<(Unit, Key)> = vec![];
        for unit in self.graph.units(t) {
            match self.look(unit) {
                Looked::Skip => {
                    count.skipped += 1;
                    self.note(unit, State::Missing, Outcome::Skipped, None);
                }
                Looked::Have(key) => {
                    count.reused += 1;
                    self.note(unit, State::Done, Outcome::Reused, None);
                    self.went_on_without(unit, key);
                }
                Looked::Fault(fault) => {
                    count.failed += 1;
                    self.fail(unit, fault);
                }
                Looked::Need(key) => pending.push((unit, key)),
            }
        }
        let table = &self.graph.plan.tables[t].name;
        self.listener.hear(&Event::Computing { table, units: pending.len() });
        let worker = Worker::new(self.graph, self.store, t);
        let tasks = match self.graph.plan.tables[t].entry.grain {
            Grain::Line => worker.by_line(pending),
            Grain::Survey => worker.by_lines_seen(pending),
        };
        let usable = |line: LineId, unit: Unit| self.line_is_there(line, unit) != State::Failed;
        let listener = self.listener;
        let work = |task: &Task| {
            if INTERRUPTED.load(Ordering::Relaxed) {
                return vec![];
            }
            let done = worker.run(task, &usable);
            for Done { unit, fault, .. } in &done {
                let outcome = if fault.is_none() { Outcome::Computed } else { Outcome::Failed };
                tell(listener, self.graph, *unit, outcome, fault.as_ref());
            }
            done
        };
        let results: Vec<Vec<Done>> = tasks.par_iter().with_max_len(1).map(work).collect();
        for Done { unit, fault, left_out } in results.into_iter().flatten() {
            self.left_out(unit, left_out);
            match fault {
                None => {
                    count.computed += 1;
                    self.states.insert(unit, State::Done);
                }
                Some(fault) => {
                    count.failed += 1;
                    self.record(unit, fault);
                }
            }
        }
        count
    }

    fn note(&mut self, unit: Unit, state: State, outcome: Outcome, fault: Option<&Fault>) {
        self.states.insert(unit, state);
        tell(self.listener, self.graph, unit, outcome, fault);
    }

    fn fail(&mut self, unit: Unit, fault: Fault) {
        tell(self.listener, self.graph, unit, Outcome::Failed, Some(&fault));
        self.record(unit, fault);
    }

    /// Lists the lines that a survey stage went on without.
    fn left_out(&mut self, unit: Unit, faults: Vec<Fault>) {
        let node = &self.graph.plan.tables[unit.table];
        let point = self.graph.plan.instance(unit.table, unit.instance).point();
        self.failures.extend(faults.into_iter().map(|fault| {
            let line = fault.place.flight.clone().zip(fault.place.line.clone());
            Failure { table: node.name.clone(), point: point.clone(), line, fault }
        }));
    }

    /// The same of an answer that is reused.
    fn went_on_without(&mut self, unit: Unit, key: Key) {
        if unit.line.is_some() {
            return;
        }
        match left_out::kept(self.store, key) {
            Ok(faults) => self.left_out(unit, faults),
            Err(fault) => self.record(unit, fault),
        }
    }

    fn record(&mut self, unit: Unit, fault: Fault) {
        let state = if fault.owner == Owner::Machine { State::Missing } else { State::Failed };
        self.states.insert(unit, state);
        let node = &self.graph.plan.tables[unit.table];
        let line = unit.line.map(|l| self.graph.lines[l].clone());
        let point = self.graph.plan.instance(unit.table, unit.instance).point();
        self.failures.push(Failure { table: node.name.clone(), point, line, fault });
    }

    /// Whether a unit is to be computed, is there, or cannot be.
    fn look(&self, unit: Unit) -> Looked {
        let plan = self.graph.plan;
        let it = plan.instance(unit.table, unit.instance);
        let of_lines: Vec<usize> = self.graph.line_inputs(&it).into_iter().map(|(i, _)| i).collect();
        for (i, r) in it.inputs().iter().enumerate() {
            let line = if of_lines.contains(&i) { unit.line } else { None };
            let there = match (of_lines.contains(&i), unit.line) {
                // A fit looks at its lines one by one and goes on without those that failed.
                (true, None) => self.survey_state(unit),
                _ => self.state(*r, line),
            };
            if there != State::Done {
                return Looked::Skip;
            }
        }
        match self.graph.key(unit) {
            Ok(key) if self.store.has(key) => Looked::Have(key),
            Ok(key) => Looked::Need(key),
            Err(fault) => Looked::Fault(fault),
        }
    }

    /// A survey stage waits for lines that the machine failed on, and needs at least one that is there.
    fn survey_state(&self, unit: Unit) -> State {
        let lines = self.graph.lines_of(unit.table, unit.instance);
        let states: Vec<State> = lines.iter().map(|l| self.line_is_there(*l, unit)).collect();
        if states.contains(&State::Missing) {
            return State::Missing;
        }
        if states.contains(&State::Done) { State::Done } else { State::Missing }
    }

    /// What became of `line` in all line inputs of `unit`.
    fn line_is_there(&self, line: LineId, unit: Unit) -> State {
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
            Ref::Stage(table, instance) => {
                self.states.get(&Unit { table, instance, line }).copied().unwrap_or(State::Missing)
            }
        }
    }
}

enum Looked {
    Have(Key),
    Need(Key),
    Skip,
    Fault(Fault),
}

fn tell(listener: &dyn Listener, graph: &Graph, unit: Unit, outcome: Outcome, fault: Option<&Fault>) {
    let node = &graph.plan.tables[unit.table];
    let line = unit.line.map(|l| &graph.lines[l]);
    let point = &graph.plan.instance(unit.table, unit.instance).point();
    listener.hear(&Event::Unit { table: &node.name, point, line, outcome, fault });
}
