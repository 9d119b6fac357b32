//! A pass over a plan: computes its tables, finds warnings about the results, and publishes and records the tables.

use std::{sync::atomic::Ordering, time::Instant};

use plan::{
    Plan, PlanGraph, PlanUnit, RecordedPlan,
    sources::ReadProgress,
    spec::{SearchTrial, SearchTrialScore, SpecFaults},
};
use results::{
    history::{self, RunRecord},
    pooled::{self, PooledMetric},
    scores,
    warnings::{self, Warning},
};
use schemas::{Fault, keys::HashKey};
use store::{PipelineLock, Store, clock, current, tend};

use super::{
    Event, Failure, INTERRUPTED, Listener, OutcomeCounts, RunOptions, RunSummary, STARTED, failure, publish, quality,
    remedies, run_id,
    runner::PlanRunner,
    search,
    states::{UnitState, UnitStates},
    trials,
    until::TargetTables,
    work::UnitWorker,
};
use crate::cost::CostMeter;

/// Maximum number of restarts of a run after it finds damage in the store.
const MAX_REPAIRS: usize = 5;

/// Purpose of a pass over a plan.
pub(super) struct PlanPass<'a> {
    /// Whether the tables of this pass are published.
    pub(super) last: bool,
    /// Trials of the plan.
    pub(super) rows: &'a [SearchTrial],
    /// Goals of the trials, if already known.
    pub(super) known: Option<&'a [SearchTrialScore]>,
    /// Events of the previous passes.
    pub(super) relay: Option<&'a search::EventRelay<'a>>,
}

/// Pass over the plan, repeated while the pass finds damaged parts of the store.
pub(super) fn run_with_repair(
    plan: &Plan,
    store: &Store,
    options: RunOptions<'_>,
    publisher: &PipelineLock,
    listener: &dyn Listener,
    pass: &PlanPass,
) -> Result<RunSummary, SpecFaults> {
    let mut passes = 0;
    let mut summary = loop {
        let before = store.damaged().len();
        let summary = run_pass(plan, store, options, publisher, listener, pass)?;
        passes += 1;
        if summary.interrupted || store.damaged().len() == before || passes > MAX_REPAIRS {
            break summary;
        }
    };
    let recomputed =
        |what| format!("{what}; it was moved to {} and recomputed", store.root().join("damaged").display());
    summary.notes.extend(store.damaged().into_iter().map(recomputed));
    if let Err(fault) = store.write_index() {
        summary.failures.push(unpublished(fault));
    }
    if pass.last {
        summary.unused = tend::unused(store);
    }
    Ok(summary)
}

pub(super) fn unpublished(fault: Fault) -> Failure {
    Failure { table: "publish".into(), point: Default::default(), line: None, fault }
}

/// Single pass over an intact store.
fn run_pass(
    plan: &Plan,
    store: &Store,
    options: RunOptions<'_>,
    publisher: &PipelineLock,
    listener: &dyn Listener,
    pass: &PlanPass,
) -> Result<RunSummary, SpecFaults> {
    let (damaged, begun) = (store.damaged().len(), Instant::now());
    let tick = |table: &str, step: &ReadProgress| listener.on_event(&Event::Reading { table, step });
    let graph = PlanGraph::new(plan, store, &tick)?;
    trials::check(&graph).map_err(|f| plan.spec.faults(vec![f]))?;
    STARTED.store(true, Ordering::SeqCst);
    let targets = TargetTables::new(plan, options.until);
    let units: usize = (0..plan.tables.len()).filter(|t| targets.is(*t)).map(|t| graph.unit_count(t)).sum();
    let run = run_id(&graph);
    let pipeline = &plan.spec.name;
    listener.on_event(&Event::Started { pipeline, units, run: &run, notes: &plan.notes, graph: &graph });
    let worker = UnitWorker::new(&graph, store, listener);
    let this = GraphPass { graph: &graph, store, options, listener, pass, run: &run, damaged, begun };
    let mut watch = CostMeter::new(&graph, store);
    let mut computed = this.compute(&worker, targets, &mut watch)?;
    let trials = this.trials(&mut computed);
    let mut judged = Judgement::default();
    if pass.last && !computed.interrupted && !this.is_damaged() {
        let judging = this.judge(&mut computed, &mut judged);
        let published = judging.and_then(|()| match this.is_damaged() {
            true => Ok(()),
            false => this.publish(publisher, &computed, &judged, &trials).and_then(|()| this.record(&computed)),
        });
        computed.failures.extend(published.err().map(unpublished));
    }
    watch.keep(pass.last && !computed.interrupted);
    Ok(this.summary(computed, judged, trials))
}

/// A pass over a plan whose sources have been read.
struct GraphPass<'a> {
    graph: &'a PlanGraph<'a>,
    store: &'a Store,
    options: RunOptions<'a>,
    listener: &'a dyn Listener,
    pass: &'a PlanPass<'a>,
    /// Identifier of the run.
    run: &'a str,
    /// Number of damaged parts of the store at the start.
    damaged: usize,
    begun: Instant,
}

/// Tables after their computation.
struct ComputedTables<'a> {
    tables: Vec<(String, OutcomeCounts)>,
    /// Packs of each table of the plan.
    packs: Vec<Vec<HashKey>>,
    /// Number of computed units of each table of the plan, and the duration, in seconds.
    seconds: Vec<(usize, f64)>,
    states: UnitStates<'a>,
    failures: Vec<Failure>,
    targets: TargetTables,
    interrupted: bool,
}

/// Scores of the results and warnings about them.
#[derive(Default)]
struct Judgement {
    warnings: Vec<Warning>,
    pooled: Vec<PooledMetric>,
}

impl<'a> GraphPass<'a> {
    /// Whether the pass has found damage.
    fn is_damaged(&self) -> bool {
        self.store.damaged().len() != self.damaged
    }

    /// Computes the tables in the order of the plan.
    fn compute(
        &self,
        worker: &'a UnitWorker<'a>,
        mut targets: TargetTables,
        watch: &mut CostMeter,
    ) -> Result<ComputedTables<'a>, SpecFaults> {
        let (graph, store, listener, engine) = (self.graph, self.store, self.listener, self.options.engine);
        let recorded = if engine.is_local() { None } else { Some(recorded(graph, store)?) };
        let mut runner = PlanRunner::new(worker, listener, self.options, recorded);
        runner.sources();
        let (mut tables, mut packs) = (vec![], vec![]);
        for (t, node) in graph.plan.tables.iter().enumerate() {
            if INTERRUPTED.load(Ordering::Relaxed) {
                break;
            }
            if !targets.is(t) && runner.is_left(t, &targets.left) {
                targets.left.push(t);
                packs.push(vec![]);
                runner.seconds.push((0, 0.0));
                continue;
            }
            // Only local computation is measured: this process cannot measure the resources of other processes.
            let before = if engine.is_local() { watch.table(t) } else { None };
            let started = Instant::now();
            let (count, found) = runner.table(t);
            packs.push(found);
            let seconds = started.elapsed().as_secs_f64();
            watch.done(before, count, packs.last().map_or(&[], Vec::as_slice));
            runner.seconds.push((count.computed, seconds));
            listener.on_event(&Event::Table { table: &node.name, count, seconds });
            tables.push((node.name.clone(), count));
        }
        store.drop_attempts(|key| store.find(key).is_some(), None);
        store.drop_checkpoints(|name| HashKey::parse(name).is_some_and(|key| store.has(key)), None);
        let interrupted = INTERRUPTED.load(Ordering::Relaxed);
        let PlanRunner { failures, mut seconds, states, .. } = runner;
        let failures = failures.into_iter().map(|(_, failure)| failure).collect();
        if let Some(relay) = self.pass.relay {
            let sums = relay.sums(tables.iter().map(|(name, _)| name.as_str()));
            tables.iter_mut().zip(&sums).for_each(|((_, count), (sum, _))| *count = *sum);
            seconds = sums.into_iter().map(|(count, seconds)| (count.computed, seconds)).collect();
        }
        Ok(ComputedTables { tables, packs, seconds, states, failures, targets, interrupted })
    }

    /// Goals of the trials of a search.
    fn trials(&self, computed: &mut ComputedTables) -> Vec<SearchTrialScore> {
        let mut trials = vec![];
        if !computed.interrupted {
            let scored = || trials::scored(self.graph, self.store, self.pass.rows, true);
            match self.pass.known.map_or_else(scored, |known| Ok(Some(known.to_vec()))) {
                Ok(found) => trials = found.unwrap_or_default(),
                Err(fault) => computed.failures.push(unpublished(fault)),
            }
        }
        if self.pass.last {
            computed.failures.extend(trials::no_trial_succeeded(self.graph.plan, &trials));
        }
        trials
    }

    /// Finds the warnings and pools the scores.
    fn judge(&self, computed: &mut ComputedTables, judged: &mut Judgement) -> Result<(), Fault> {
        let states = &computed.states;
        let done = |unit: PlanUnit| states.get(unit) == UnitState::Done;
        let found = warnings::find(self.graph, self.store, &done)?;
        let (failed, mut found) = failure::of_metrics(self.graph.plan, found);
        computed.failures.extend(failed);
        remedies::try_remedies(self.graph, self.store, self.listener, &mut found)?;
        judged.warnings = found;
        judged.pooled = pooled::find(self.graph, self.store, &done)?;
        Ok(())
    }

    /// Publishes the tables.
    fn publish(
        &self,
        publisher: &PipelineLock,
        computed: &ComputedTables,
        judged: &Judgement,
        trials: &[SearchTrialScore],
    ) -> Result<(), Fault> {
        let (graph, store, plan) = (self.graph, self.store, self.graph.plan);
        let left = &computed.targets.left;
        // Tables that were not requested stay unchanged, and so do their pooled scores.
        let before = if left.is_empty() { None } else { pooled::written(plan, store)? };
        let unchanged = before.into_iter().flatten().filter(|p| left.contains(&p.table));
        let pooled: Vec<PooledMetric> = judged.pooled.iter().cloned().chain(unchanged).collect();
        plan.tables.iter().for_each(|node| self.listener.on_event(&Event::Publishing { table: &node.name }));
        let there = |unit: PlanUnit| computed.states.get(unit) == UnitState::Done;
        let publication =
            publish::Publication { graph, store, run: self.run, packs: &computed.packs, left, there: &there };
        publication.publish(publisher, &computed.failures, &judged.warnings, &pooled, trials)
    }

    /// Adds the run to the history of the pipeline.
    fn record(&self, computed: &ComputedTables) -> Result<(), Fault> {
        let (store, pipeline) = (self.store, &self.graph.plan.spec.name);
        let snapshot = results::record(self.graph, store, &computed.seconds, &computed.targets.left)?;
        let total = computed.tables.iter().fold(OutcomeCounts::default(), |sum, (_, c)| sum + *c);
        let this_run = RunRecord {
            time: clock::now(),
            run: self.run.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            tables: current(store.root(), pipeline).map_or(0, |v| v.number),
            seconds: self.begun.elapsed().as_secs_f64(),
            units: [total.computed, total.reused, total.failed, total.skipped],
            ..RunRecord::default()
        };
        history::add(store, pipeline, this_run, &snapshot)
    }

    /// Summary of the pass.
    fn summary(&self, computed: ComputedTables, judged: Judgement, trials: Vec<SearchTrialScore>) -> RunSummary {
        let plan = self.graph.plan;
        let ComputedTables { tables, seconds, failures, targets, interrupted, .. } = computed;
        let (quality, quality_lines) = quality::count(self.graph);
        let mut scores = scores::all(plan, &judged.pooled, &judged.warnings);
        let left: Vec<String> = targets.names(plan).map(str::to_owned).collect();
        scores.retain(|(name, _)| !left.contains(name));
        let spent = seconds.into_iter().enumerate().filter(|(t, _)| !targets.left.contains(t));
        let seconds = spent.map(|(_, (_, s))| s).collect();
        let mut notes: Vec<String> =
            plan.notes.iter().cloned().chain(targets.note(plan).filter(|_| !interrupted)).collect();
        if !scores.is_empty() {
            notes.extend(pooled::repeats(self.graph));
            notes.extend(pooled::mixed(self.graph).unwrap_or_default());
        }
        for (name, found) in &scores {
            notes.extend(found.at_edges().into_iter().map(|text| format!("`{name}`: {text}")));
        }
        RunSummary {
            tables,
            failures,
            quality,
            quality_lines,
            warnings: judged.warnings,
            scores,
            trials,
            notes,
            seconds,
            run: self.run.to_owned(),
            interrupted,
            folder: self.store.root().join("tables").join(&plan.spec.name),
            left,
            compared: vec![],
            unused: 0,
        }
    }
}

/// Writes the plan for worker processes, and the index from which they open the store.
pub(super) fn recorded(graph: &PlanGraph, store: &Store) -> Result<HashKey, SpecFaults> {
    let written = RecordedPlan::keep(graph, store).and_then(|key| store.write_index().map(|()| key));
    written.map_err(|fault| graph.plan.spec.faults(vec![fault]))
}
