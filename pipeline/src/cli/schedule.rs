//! Support for runs that another program starts: waiting for a lock, limits, and files that report the outcome.

mod file;
mod lineage;
mod metrics;
mod summary;
mod watch;

use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread::sleep,
    time::{Duration, Instant},
};

use clap::Args;
use plan::{Plan, spec::SpecFaults};
use run::{Event, Listener, RunSummary};
use schemas::Fault;
use store::{ForeignLock, LockOutcome, PipelineLock, Store, generation};

use super::{ExitReason, interrupt, note, open, tend};
pub use summary::compared;
pub use watch::RunWatch;

/// Exit status if another run holds the lock.
pub const LOCKED: u8 = 3;
/// The exit status of a run that was stopped by its time limit.
pub const OUT_OF_TIME: u8 = 4;

/// Options of a scheduled run.
#[derive(Args, Clone, Debug, Default)]
pub struct ScheduleArgs {
    /// Wait for another run of the same pipeline in the same store, instead of failing. A duration such as `--wait=10m`
    /// limits the wait.
    #[arg(long, value_name = "LENGTH", num_args = 0..=1, require_equals = true, value_parser = tend::age)]
    wait: Option<Option<Duration>>,
    /// Compute only this table and its inputs. The other tables stay unchanged.
    #[arg(long, value_name = "TABLE")]
    until: Option<String>,
    /// Recompute the stored results of this table, or of all tables, and compare every bit. The store stays unchanged.
    #[arg(long, value_name = "TABLE", num_args = 0..=1, require_equals = true)]
    force: Option<Option<String>>,
    /// Stop after this time, such as 30m or 2h. Units in progress are finished.
    #[arg(long, value_name = "LENGTH", value_parser = tend::age)]
    max_time: Option<Duration>,
    /// Skip flight files that were modified within this time before the run, such as 60s. They may be incomplete.
    #[arg(long, value_name = "LENGTH", value_parser = tend::age)]
    settle: Option<Duration>,
    /// Write a summary of the run to this file as JSON, even if the run fails.
    #[arg(long, value_name = "FILE")]
    summary: Option<PathBuf>,
    /// Write metrics of the run to this file as Prometheus text, for the textfile collector of node_exporter.
    #[arg(long, value_name = "FILE")]
    metrics: Option<PathBuf>,
    /// Append the OpenLineage events of the run to this file, or send them to an address `http://...`.
    #[arg(long, value_name = "FILE|URL")]
    openlineage: Option<String>,
}

/// Tables of `--until` and `--force`, as positions in the plan.
#[derive(Clone, Copy, Debug, Default)]
pub struct ScheduleTables {
    /// Table of `--until`.
    pub until: Option<usize>,
    /// Table of `--force`; `Some(None)` for all tables.
    pub force: Option<Option<usize>>,
}

impl ScheduleArgs {
    /// Minimum age of a flight file; younger files are skipped.
    pub fn settle(&self) -> Option<Duration> {
        self.settle
    }

    /// Positions in `plan` of the tables of `--until` and `--force`.
    ///
    /// # Errors
    /// Fails for an unknown table, for `--until` with a search, or for `--force` of a table that is not kept.
    pub fn named(&self, plan: &Plan) -> Result<ScheduleTables, Fault> {
        if let Some(search) = plan.spec.search.as_ref().filter(|_| self.until.is_some()) {
            let fault = Fault::new("`--until` cannot be combined with a `[search]`");
            return Err(fault.help(format!("the trials depend on the scores in `{}`; remove `--until`", search.table)));
        }
        let until = self.until.as_deref().map(|name| plan.table(name)).transpose()?;
        let force = match &self.force {
            Some(Some(name)) => Some(Some(plan.table(name)?)),
            Some(None) => Some(None),
            None => None,
        };
        let unkept = force.flatten().and_then(|t| plan.tables.get(t)).filter(|node| !node.keep);
        match unkept {
            Some(node) => {
                Err(Fault::new(format!("`{}` has `keep = false`, so the store has no results to compare", node.name)))
            }
            None => Ok(ScheduleTables { until, force }),
        }
    }

    /// Takes the lock of a pipeline, then opens its store. After a wait for the lock, the store thus holds the results
    /// of the other run, and the plan includes new files.
    ///
    /// # Errors
    /// Fails if the spec is wrong, the store cannot be opened, or another run holds the lock.
    pub fn enter(
        &self,
        read: &dyn Fn() -> Result<Plan, SpecFaults>,
        watch: &RunWatch,
    ) -> Result<(Plan, Store, PipelineLock), ExitReason> {
        let begun = Instant::now();
        loop {
            let plan = read()?;
            let (name, root) = (plan.spec.name.clone(), plan.spec.store.clone());
            watch.planned(&plan);
            let seen = generation(&root, &name);
            let store = open(&plan.spec)?;
            let publisher = self.locked(&store, &name, begun, watch)?;
            if publisher.follows(seen) {
                return Ok((plan, store, publisher));
            }
            drop(store);
            let plan = read()?;
            if (&plan.spec.name, &plan.spec.store) == (&name, &root) {
                watch.planned(&plan);
                let store = open(&plan.spec)?;
                return Ok((plan, store, publisher));
            }
        }
    }

    fn locked(&self, store: &Store, name: &str, begun: Instant, watch: &RunWatch) -> Result<PipelineLock, ExitReason> {
        let mut reported = false;
        loop {
            let held = match store.lock(name)? {
                LockOutcome::Mine(publisher) => return Ok(publisher),
                LockOutcome::Held(held) => held,
            };
            let what = held.message(name, store.root());
            match self.wait {
                None => {
                    return Err(refused(
                        &what,
                        "wait for that run with `--wait`, or give another `store`",
                        held,
                        watch,
                    ));
                }
                Some(Some(most)) if begun.elapsed() >= most => {
                    let help = format!(
                        "the waiting time of {} s has expired; run again later, or increase `--wait`",
                        most.as_secs()
                    );
                    return Err(refused(&what, &help, held, watch));
                }
                Some(_) => {}
            }
            if !std::mem::replace(&mut reported, true) {
                note(&format!("{what}; waiting for that run"));
            }
            sleep(store.look_again());
        }
    }

    /// Starts the time limit of a run.
    pub fn limit(&self) -> RunTimeLimit {
        let (sender, receiver) = mpsc::channel();
        if let Some(most) = self.max_time {
            std::thread::spawn(move || {
                if receiver.recv_timeout(most) == Err(mpsc::RecvTimeoutError::Timeout) {
                    OVER.store(true, Ordering::SeqCst);
                    interrupt::stop(OUT_OF_TIME, STOPPED);
                }
            });
        }
        RunTimeLimit { _running: sender }
    }
}

/// Whether the time limit has expired.
static OVER: AtomicBool = AtomicBool::new(false);

/// The message of a run that was stopped by its time limit.
pub const STOPPED: &str = "stopped by `--max-time`; finished results are stored; run the same command again to resume";

/// Time limit of a run, which ends when this value is dropped.
pub struct RunTimeLimit {
    _running: mpsc::Sender<()>,
}

/// Whether the time limit interrupted a run.
pub fn is_out_of_time() -> bool {
    OVER.load(Ordering::SeqCst)
}

fn refused(what: &str, help: &str, held: ForeignLock, watch: &RunWatch) -> ExitReason {
    watch.refused(held);
    ExitReason::Locked(format!("error: {what}\n  help: {help}"))
}

/// Pair of listeners: each event goes to both.
pub struct ListenerPair<'a>(pub &'a dyn Listener, pub &'a dyn Listener);

impl Listener for ListenerPair<'_> {
    fn on_event(&self, event: &Event) {
        self.0.on_event(event);
        self.1.on_event(event);
    }
}

/// Listener that passes all events except `Finished`, because the command continues after the run.
pub struct FinishFilter<'a>(pub &'a dyn Listener);

impl Listener for FinishFilter<'_> {
    fn on_event(&self, event: &Event) {
        match event {
            Event::Finished { .. } => {}
            Event::Reading { .. }
            | Event::Started { .. }
            | Event::Computing { .. }
            | Event::Working { .. }
            | Event::Waiting { .. }
            | Event::Unit { .. }
            | Event::Searching { .. }
            | Event::Trials { .. }
            | Event::Trying { .. }
            | Event::Publishing { .. }
            | Event::Table { .. } => self.0.on_event(event),
        }
    }
}

/// Listener for a second run that passes only the progress, because the tables of the second run differ from those of
/// the first.
pub struct ProgressFilter<'a>(pub &'a dyn Listener);

impl Listener for ProgressFilter<'_> {
    fn on_event(&self, event: &Event) {
        if matches!(event, Event::Working { .. } | Event::Computing { .. }) {
            self.0.on_event(event);
        }
    }
}

/// Adds the results of a recomputation to the summary of a run.
pub fn report_comparison(summary: &mut RunSummary, compared: Vec<run::TableComparison>) {
    for one in &compared {
        let units = super::counted(one.units, "unit");
        let what = match one.differ.len() {
            0 => "the same bytes".to_owned(),
            n => format!("{n} differ"),
        };
        summary.notes.push(format!("`{}` was recomputed: {units}, {what}", one.table));
        summary.failures.extend(one.differ.iter().cloned());
    }
    summary.compared = compared;
}

/// Observes a run until it succeeds or fails.
///
/// # Errors
/// Fails for a file or an address that cannot be written to; nothing is run then.
pub fn watch(args: &ScheduleArgs, spec: &super::SpecArgs) -> Result<Arc<RunWatch>, ExitReason> {
    let watch = Arc::new(RunWatch::new(args, spec)?);
    let last = watch.clone();
    interrupt::at_exit(move |status| last.cut(status));
    Ok(watch)
}
