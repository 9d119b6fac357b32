//! Observation of a run from its start to its end.

use std::{
    collections::BTreeSet,
    fs,
    path::PathBuf,
    sync::{Mutex, MutexGuard, PoisonError},
    time::Instant,
};

use plan::Plan;
use report::openlineage::{self, LineageRun, ParentRun, TableLineage};
use run::{Event, Listener, OutcomeCounts, RunSummary};
use serde_json::Value;
use store::{ForeignLock, clock};
use uuid::Uuid;

use super::{LOCKED, OUT_OF_TIME, ScheduleArgs, file, lineage::LineageSink, metrics, summary};
use crate::cli::{
    ExitReason, SpecArgs, interrupt,
    say::{self, err},
};

/// Final status of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunStatus {
    /// Everything was computed.
    Done,
    /// Something failed.
    Failed,
    /// The spec, an argument or an input is wrong.
    Wrong,
    /// Another run has the lock.
    Locked,
    /// The time limit expired.
    OutOfTime,
    /// Interrupted.
    Interrupted,
}

impl RunStatus {
    /// The status as text.
    pub fn as_str(self) -> &'static str {
        match self {
            RunStatus::Done => "done",
            RunStatus::Failed => "failed",
            RunStatus::Wrong => "wrong",
            RunStatus::Locked => "locked",
            RunStatus::OutOfTime => "out_of_time",
            RunStatus::Interrupted => "interrupted",
        }
    }

    /// The exit status.
    pub fn exit(self) -> u8 {
        match self {
            RunStatus::Done => 0,
            RunStatus::Failed => 1,
            RunStatus::Wrong => 2,
            RunStatus::Locked => LOCKED,
            RunStatus::OutOfTime => OUT_OF_TIME,
            RunStatus::Interrupted => interrupt::STATUS,
        }
    }
}

/// The end of a run.
pub struct RunEnd<'a> {
    /// Final status.
    pub status: RunStatus,
    /// Message for the user.
    pub error: Option<String>,
    /// Summary of the run; `None` if the run ended without a summary.
    pub summary: Option<&'a RunSummary>,
}

/// State of a run.
pub struct RunWatchState {
    /// Unique identifier of the run.
    pub id: Uuid,
    /// Start time, UTC.
    pub started: String,
    /// Start time, for durations.
    pub begun: Instant,
    /// The path of the spec, as the user gave it.
    pub spec: String,
    /// BLAKE3 of the bytes of the spec.
    pub spec_hash: Option<String>,
    /// The assignments of `--set`.
    pub sets: Vec<String>,
    /// The pipeline.
    pub pipeline: Option<String>,
    /// The folder of the store.
    pub root: Option<PathBuf>,
    /// Absolute path of the store, for messages.
    pub store: Option<String>,
    /// Hash of the computation and its data.
    pub run: Option<String>,
    /// The outcome of each finished table, and its duration, in seconds.
    pub tables: Vec<(String, OutcomeCounts, f64)>,
    /// Holder of the lock, if another run holds it.
    pub held: Option<ForeignLock>,
    of: Option<LineageRun>,
    lineage: Vec<TableLineage>,
    begun_tables: BTreeSet<String>,
    ended_tables: BTreeSet<String>,
    first_error: Option<String>,
    is_over: bool,
}

/// Listener of a run, which writes summary, metrics and lineage at its end.
pub struct RunWatch {
    files: [Option<PathBuf>; 2],
    sink: Option<LineageSink>,
    state: Mutex<RunWatchState>,
}

impl RunWatch {
    /// Creates the listener for a run of a spec.
    ///
    /// # Errors
    /// Fails for a file or an address that cannot be written to.
    pub fn new(args: &ScheduleArgs, spec: &SpecArgs) -> Result<RunWatch, ExitReason> {
        for (flag, path) in [("--summary", &args.summary), ("--metrics", &args.metrics)] {
            path.as_ref().map_or(Ok(()), |path| file::check(flag, path))?;
        }
        let sink = args.openlineage.as_deref().map(LineageSink::open).transpose()?;
        let state = RunWatchState {
            id: Uuid::new_v4(),
            started: clock::now_ms(),
            begun: Instant::now(),
            spec: spec.spec.display().to_string(),
            spec_hash: fs::read(&spec.spec).ok().map(|bytes| blake3::hash(&bytes).to_hex().to_string()),
            sets: spec.sets.clone(),
            pipeline: None,
            root: None,
            store: None,
            run: None,
            tables: vec![],
            held: None,
            of: None,
            lineage: vec![],
            begun_tables: BTreeSet::new(),
            ended_tables: BTreeSet::new(),
            first_error: None,
            is_over: false,
        };
        Ok(RunWatch { files: [args.summary.clone(), args.metrics.clone()], sink, state: Mutex::new(state) })
    }

    fn state(&self) -> MutexGuard<'_, RunWatchState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn send(&self, events: impl IntoIterator<Item = Value>) {
        if let Some(sink) = &self.sink {
            events.into_iter().for_each(|event| sink.send(event));
        }
    }

    /// Records the plan of the run.
    pub fn planned(&self, plan: &Plan) {
        let mut state = self.state();
        state.pipeline = Some(plan.spec.name.clone());
        state.root = Some(plan.spec.store.clone());
        let store = std::path::absolute(&plan.spec.store).unwrap_or_else(|_| plan.spec.store.clone());
        state.store = Some(store.display().to_string());
    }

    /// Records that another run holds the lock.
    pub fn refused(&self, held: ForeignLock) {
        self.state().held = Some(held);
    }

    /// Records the start of the run after it has taken the lock.
    pub fn begin(&self, plan: &Plan) {
        if self.sink.is_none() {
            return;
        }
        let named = |name: &str| std::env::var(name).ok().filter(|v| !v.is_empty());
        let namespace = named("OPENLINEAGE_NAMESPACE").unwrap_or_else(|| "magline".to_owned());
        let parent_id = named("OPENLINEAGE_PARENT_ID");
        let parent = parent_id.as_deref().and_then(ParentRun::parse);
        if let Some(text) = parent_id.filter(|_| parent.is_none()) {
            err!("warning: OPENLINEAGE_PARENT_ID is not <namespace>/<job>/<run>: `{text}`");
        }
        let mut state = self.state();
        let run = LineageRun::new(plan, state.id, namespace, parent);
        self.send([run.event(openlineage::LineageEventType::Start, None)]);
        state.of = Some(run);
    }

    /// Records the end of the run, and writes its outcome once.
    pub fn end(&self, done: &Result<(), ExitReason>, summary: Option<&RunSummary>) {
        let (status, error) = match done {
            Ok(()) => match say::lost() {
                Some(why) => (RunStatus::Failed, Some(format!("cannot write to standard output: {why}"))),
                None => (RunStatus::Done, None),
            },
            Err(ExitReason::Failed(text)) => (RunStatus::Failed, Some(text.clone()).filter(|t| !t.is_empty())),
            Err(ExitReason::Wrong(text)) => (RunStatus::Wrong, Some(text.clone())),
            Err(ExitReason::Locked(text)) => (RunStatus::Locked, Some(text.clone())),
            Err(ExitReason::OutOfTime) => (RunStatus::OutOfTime, Some(super::STOPPED.to_owned())),
            Err(ExitReason::Printed(_)) => (RunStatus::Failed, None),
            Err(ExitReason::Interrupted) => (RunStatus::Interrupted, Some(interrupt::MESSAGE.to_owned())),
        };
        self.over(&RunEnd { status, error, summary });
    }

    /// Records that the process ends with `status` before the end of the run.
    pub fn cut(&self, status: u8) {
        let (status, error) = if status == OUT_OF_TIME {
            (RunStatus::OutOfTime, super::STOPPED)
        } else {
            (RunStatus::Interrupted, interrupt::MESSAGE)
        };
        self.over(&RunEnd { status, error: Some(error.to_owned()), summary: None });
    }

    fn over(&self, end: &RunEnd) {
        let mut state = self.state();
        if std::mem::replace(&mut state.is_over, true) {
            return;
        }
        let [summary, metrics] = &self.files;
        let saved = |path: &PathBuf, text: &str| {
            if let Err(e) = file::write(path, text) {
                err!("warning: cannot write {}: {e}", path.display());
            }
        };
        if let Some(path) = summary {
            let text = serde_json::to_string_pretty(&summary::json(&state, end)).unwrap_or_default() + "\n";
            saved(path, &text);
        }
        // If another run holds the lock, no metrics are written: the other run writes its own.
        if let Some(path) = metrics.as_ref().filter(|_| end.status != RunStatus::Locked) {
            saved(path, &metrics::text(&state, end, path));
        }
        self.last(&state, end);
        if let Some(sink) = &self.sink {
            sink.flush();
        }
    }

    /// Sends the last events: for unfinished tables and for the run.
    fn last(&self, state: &RunWatchState, end: &RunEnd) {
        use openlineage::LineageEventType as EventType;
        let Some(run) = &state.of else { return };
        let event_type = match end.status {
            RunStatus::Done => EventType::Complete,
            RunStatus::Failed | RunStatus::Wrong | RunStatus::Locked => EventType::Fail,
            RunStatus::OutOfTime | RunStatus::Interrupted => EventType::Abort,
        };
        let stopped = if event_type == EventType::Abort { EventType::Abort } else { EventType::Fail };
        let open = state.begun_tables.difference(&state.ended_tables);
        let tables = open.filter_map(|name| state.lineage.iter().find(|t| t.name == *name));
        self.send(tables.map(|t| run.of_table(t, stopped, end.error.as_deref())));
        let failed = end.summary.and_then(|s| s.failures.first()).map(|f| f.fault.to_string());
        let error = end.error.clone().or(failed).or_else(|| state.first_error.clone());
        self.send([run.event(event_type, error.as_deref().filter(|_| event_type != EventType::Complete))]);
    }

    fn begun_table(&self, state: &mut RunWatchState, name: &str) {
        let known = state.lineage.iter().any(|t| t.name == name);
        if !known || !state.begun_tables.insert(name.to_owned()) {
            return;
        }
        let of = state.of.as_ref().zip(state.lineage.iter().find(|t| t.name == name));
        self.send(of.map(|(run, table)| run.of_table(table, openlineage::LineageEventType::Start, None)));
    }

    fn ended_table(&self, state: &mut RunWatchState, name: &str, count: &OutcomeCounts) {
        self.begun_table(state, name);
        if !state.ended_tables.insert(name.to_owned()) {
            return;
        }
        // Units that an interrupt skips are in none of the counts.
        let aborted = run::INTERRUPTED.load(std::sync::atomic::Ordering::Relaxed);
        let bad = count.failed + count.skipped;
        let all = bad + count.computed + count.reused;
        let why = state.first_error.as_ref().map(|e| format!(": {e}")).unwrap_or_default();
        let error = (bad > 0).then(|| format!("{bad} of {all} units failed or were skipped{why}"));
        let event_type = match (aborted, bad) {
            (true, _) => openlineage::LineageEventType::Abort,
            (false, 0) => openlineage::LineageEventType::Complete,
            (false, _) => openlineage::LineageEventType::Fail,
        };
        let of = state.of.as_ref().zip(state.lineage.iter().find(|t| t.name == name));
        self.send(of.map(|(run, table)| run.of_table(table, event_type, error.as_deref())));
    }
}

impl Listener for RunWatch {
    fn on_event(&self, event: &Event) {
        match event {
            Event::Started { run, graph, .. } => {
                let mut state = self.state();
                state.run = Some((*run).to_owned());
                if state.of.is_some() {
                    state.lineage = openlineage::lineage(graph);
                }
            }
            Event::Computing { table, .. } => self.begun_table(&mut self.state(), table),
            Event::Unit { fault: Some(fault), outcome: run::UnitOutcome::Failed, .. } => {
                let mut state = self.state();
                if state.first_error.is_none() {
                    state.first_error = Some(fault.to_string());
                }
            }
            Event::Table { table, count, seconds } => {
                let mut state = self.state();
                state.tables.retain(|(name, ..)| name != table);
                state.tables.push(((*table).to_owned(), *count, *seconds));
                self.ended_table(&mut state, table, count);
            }
            Event::Reading { .. }
            | Event::Unit { .. }
            | Event::Working { .. }
            | Event::Waiting { .. }
            | Event::Searching { .. }
            | Event::Trials { .. }
            | Event::Trying { .. }
            | Event::Publishing { .. }
            | Event::Finished { .. } => {}
        }
    }
}
