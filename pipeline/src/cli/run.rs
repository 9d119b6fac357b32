//! `magline run` and `magline compact`.

use std::{io::IsTerminal, sync::atomic::Ordering};

use clap::Args;
use plan::{Plan, read_spec, spec::SpecFaults};
use results::{score_table, scores, warnings};
use schemas::{Fault, StageEntry};

use super::{
    ExitReason, QUIET, SpecArgs, counted, engine, events, interrupt, note, print_to_stderr, progress::ProgressDisplay,
    say, schedule, tend, threads,
};
use crate::shell::shell_word;
pub use run::{Event, Listener, RunOptions, RunSummary, TaskEngine, again, deduplicated, search};

/// Subject and options of a run.
#[derive(Args)]
pub struct RunArgs {
    #[command(flatten)]
    spec: SpecArgs,
    /// The number of threads; all cores by default. Results do not depend on this number.
    #[arg(long, value_parser = threads::count)]
    threads: Option<usize>,
    #[command(flatten)]
    engine: engine::EngineArgs,
    /// Read the bytes of every input, even if its size and modification time are unchanged.
    #[arg(long)]
    verify_inputs: bool,
    /// Replace the tables of another spec in a store outside the spec's folder.
    #[arg(long)]
    take_over: bool,
    #[command(flatten)]
    schedule: schedule::ScheduleArgs,
    /// Write one JSON event per line to standard output; `magline run --help` lists the fields.
    #[arg(long)]
    json: bool,
    /// Suppress progress, notes and tables. Print only errors, and one line if results are flagged.
    #[arg(short, long)]
    quiet: bool,
}

/// Description of output and exit status in `magline run --help`.
pub const JSON_HELP: &str = "\
A score is flagged in five cases:
  worse_than_ins       the filter is worse than the INS alone
  nees_low, nees_high  the NEES of the position is outside 0.2 to 20; its expected value is 2
  nis_low, nis_high    the NIS is outside 0.25 to 4; its expected value is 1
  not_white            the innovations are correlated more than the assumed noise allows: `whiteness` is below 0.8 and \
`correlated_nis` is above 1.5; their expected values are 0.95 and 1
  gated                the filter rejects more than 10 % of the measurements

The table <name>.warnings has one row for each flag, with the likely cause. For the worst line of each kind, `run` \
repeats the navigation with changed keys. The cause then contains the first change that improves this line, and its \
result. The table also has rows of these kinds:
  wide_start   the initial position is too uncertain for a filter that linearises the map
  late         the time stamps of the magnetometer are late
  height_bias  the height relative to the map has a constant error
  gnss         GNSS positions are rejected
  off_map      the line is mostly off the map
  flat         the map is flat
  map_height   the map is at a different height from the flight
  retention    the anomaly retention is low
  fit          the fit has a warning
  map          the map has a warning
  metric       a metric cannot be computed

Warnings do not change the exit status.

Events of --json, one object per line, each with the key `event`:
  reading     table, file, simulated, lines, of_lines, done, all: a file is opened or closed, or one more line is read
  started     pipeline, version, run, time, units, notes
  computing   table, units: the number of units to compute (a unit is a line or a fit at one point)
  unit        table, axes, flight, line, status (computed, reused, failed, skipped), error
  trying      table, remedy: a line with a warning is navigated again with changed keys
  waiting     for: the missing resource, such as a worker of a cluster; null when the run resumes
  searching   generation, rung, trials (their numbers), of, best (trial, goal): the trials to compute next
  trial       trial, generation, rung, axes, goal, state (done, promoted, pruned, failed), error, best
  publishing  table
  table       table, seconds, computed, reused, failed, skipped
  finished    computed, reused, failed, skipped; version, run, time, seconds, folder; tables (the same counts and the \
seconds of each); failures; notes; warnings (stage, axes, flight, line, kind, value, limit, unit, text, cause); scores \
(stage, axes, lines, marked, metrics: pooled over the lines, null without a value); left (tables that --until did not \
change), compared (of --force: table, units, differ); unused_bytes (unreferenced results, which gc removes); interrupted

Exit status:
  0    everything is computed
  1    something failed; the rest is computed and stored
  2    the spec, an argument or an input is wrong; nothing was run
  3    another run of the pipeline holds the lock
  4    stopped by --max-time
  130  interrupted

After 4 and 130, run the same command again to resume.

In the events, `run` is a hash of the spec and its inputs, so it is the same for the same spec and inputs. `time` is \
UTC.";

/// Runs a spec. With `compact`, the files of the tables become the same as after a single run.
///
/// # Errors
/// Fails if part of the run fails, or if the run is stopped.
pub fn run(catalogue: &[StageEntry], args: &RunArgs, compact: bool) -> Result<(), ExitReason> {
    QUIET.store(args.quiet, Ordering::Relaxed);
    let engine = engine::engine(&args.engine, args.threads)?;
    let watch = schedule::watch(&args.schedule, &args.spec)?;
    interrupt::listen();
    let ran = ran(catalogue, args, compact, &*engine, &watch);
    let (done, summary) = match ran {
        Ok((done, summary)) => (done, Some(summary)),
        Err(stop) => (Err(stop), None),
    };
    watch.end(&done, summary.as_ref());
    done
}

/// Minimum size of unreferenced results for a note, in bytes.
const WORTH_A_NOTE: u64 = 1 << 20;

/// The note on results that `gc` would remove.
fn unused(bytes: u64) -> Option<String> {
    let size = tend::bytes(bytes);
    (bytes >= WORTH_A_NOTE)
        .then(|| format!("{size} of stored results are unreferenced; `magline gc --yes` removes them"))
}

/// Executes a run and prints its messages for the user.
fn ran(
    catalogue: &[StageEntry],
    args: &RunArgs,
    compact: bool,
    engine: &dyn TaskEngine,
    watch: &schedule::RunWatch,
) -> Result<(Result<(), ExitReason>, RunSummary), ExitReason> {
    let read = || {
        let mut spec = read_spec(&args.spec.spec, &args.spec.sets)?;
        if let Some(other) = results::made_by_another(&spec).filter(|_| !args.take_over) {
            let store = spec.store.display();
            let what = format!("the pipeline `{}` in the store {store} was made by another spec, {other}", spec.name);
            let help = "change `store` or `name` in the spec, or replace the tables with `--take-over`";
            return Err(spec.faults(vec![Fault::new(what).help(help)]));
        }
        spec.verify_inputs = args.verify_inputs;
        spec.settle = args.schedule.settle();
        Plan::new(spec, catalogue)
    };
    let (plan, store, publisher) = args.schedule.enter(&read, watch)?;
    let named = args.schedule.named(&plan)?;
    let pool = threads::pool(args.threads)?;
    let options = RunOptions { wait: false, compact, retries: args.engine.retries, engine, until: named.until };
    watch.begin(&plan);
    let limit = args.schedule.limit();
    let run = |listener: &dyn Listener| -> Result<(Plan, RunSummary), SpecFaults> {
        let but_the_end = schedule::FinishFilter(listener);
        let shown_listener: &dyn Listener = if named.force.is_some() { &but_the_end } else { listener };
        let (plan, mut summary) =
            search(plan, catalogue, &store, &publisher, options, &schedule::ListenerPair(watch, shown_listener))?;
        if let Some(table) = named.force {
            if !summary.interrupted {
                match again(&plan, &store, table, &schedule::ProgressFilter(listener))? {
                    Some(found) => schedule::report_comparison(&mut summary, found),
                    None => summary.interrupted = true,
                }
            }
            listener.on_event(&Event::Finished { summary: &summary });
        }
        Ok((plan, summary))
    };
    let (plan, summary) = if args.json {
        let json = events::JsonEvents::new();
        pool.install(|| run(&json))?
    } else {
        let progress = ProgressDisplay::new(args.quiet);
        pool.install(|| run(&progress))?
    };
    drop(limit);
    if !args.json {
        conclude(&plan, &summary, args.quiet)?;
    }
    let ended = ending(&summary, args.json);
    if ended.is_ok() && !args.json && !args.quiet && !compact && std::io::stdout().is_terminal() {
        say(next_command(args, &plan, &summary))?;
    }
    Ok((ended, summary))
}

/// The command that shows the results of a run: the report where there are scores, otherwise a query.
fn next_command(args: &RunArgs, plan: &Plan, summary: &RunSummary) -> String {
    let name = &plan.spec.name;
    if !summary.scores.is_empty() {
        let spec = shell_word(&args.spec.spec.to_string_lossy());
        let sets: String = args.spec.sets.iter().map(|set| format!(" --set {}", shell_word(set))).collect();
        return format!("\nnext: magline report {spec}{sets} -o {}\n", shell_word(&format!("{name}.html")));
    }
    let Some((table, _)) = summary.tables.last() else { return String::new() };
    let query = shell_word(&format!("SELECT * FROM \"{name}\".\"{table}\""));
    format!("\nnext: magline sql {query} --store {}\n", shell_word(&store::shown(&plan.spec.store).to_string()))
}

/// The summary of a run without `--json`.
fn conclude(plan: &Plan, summary: &RunSummary, quiet: bool) -> Result<(), ExitReason> {
    let table = format!("{}.warnings", plan.spec.name);
    let warned = warnings::summary_lines(&summary.warnings, &table);
    if quiet {
        warned.last().into_iter().for_each(|line| print_to_stderr(&format!("warning: {line}")));
        return Ok(());
    }
    for text in summary.notes.iter().chain(&unused(summary.unused)) {
        note(text);
    }
    say(table_of(summary))?;
    if summary.quality > 0 {
        let (findings, lines) = (counted(summary.quality, "finding"), counted(summary.quality_lines, "line"));
        print_to_stderr(&format!("data quality: {findings} in {lines}; see the table `{}.quality`", plan.spec.name));
    }
    say(scores_of(summary))?;
    say(results::trials(plan, &summary.trials))?;
    warned.iter().for_each(|line| print_to_stderr(&format!("warning: {line}")));
    Ok(())
}

/// The outcome of each table.
fn table_of(summary: &RunSummary) -> String {
    let words = |w: [&str; 5]| w.map(str::to_owned).to_vec();
    let mut rows = vec![words(["table", "computed", "reused", "failed", "skipped"])];
    for (name, c) in &summary.tables {
        rows.push(vec![
            name.clone(),
            c.computed.to_string(),
            c.reused.to_string(),
            c.failed.to_string(),
            c.skipped.to_string(),
        ]);
    }
    results::text::columns(&rows, 1) + &format!("\ntables are in {}\n", store::shown_below(&summary.folder))
}

/// The pooled scores of each table of scores as text, as wide as the terminal.
fn scores_of(summary: &RunSummary) -> String {
    const ROWS: usize = 100;
    let width = console::Term::stdout().size_checked().map_or(score_table::WIDTH, |(_, columns)| usize::from(columns));
    let one = |(name, found): &(String, scores::Scores)| {
        format!("\n{name}, {}\n{}", found.over(), score_table::render(found, width, ROWS))
    };
    summary.scores.iter().map(one).collect()
}

fn ending(summary: &RunSummary, json: bool) -> Result<(), ExitReason> {
    if summary.interrupted {
        return Err(if schedule::is_out_of_time() { ExitReason::OutOfTime } else { ExitReason::Interrupted });
    }
    if summary.failures.is_empty() {
        return Ok(());
    }
    const SHOWN: usize = 20;
    let mut text = format!("{} failed:", summary.failures.len());
    let merged = deduplicated(&summary.failures);
    for (f, lines) in merged.iter().take(SHOWN) {
        let point: Vec<String> = f.point.iter().map(|(k, v)| format!("{k}={v}")).collect();
        let line = f
            .line
            .as_ref()
            .filter(|_| f.fault.place.line.is_none())
            .map(|(a, b)| format!(" flight {a}, line {b}"))
            .unwrap_or_default();
        text.push_str(&format!("\n  {}{line} {}: {}", f.table, point.join(" "), f.fault));
        if *lines > 1 {
            text.push_str(&format!(" (and in {} of the file)", counted(lines - 1, "more line")));
        }
    }
    if merged.len() > SHOWN {
        text.push_str(&format!("\n  and {} more", merged.len() - SHOWN));
    }
    let differ: usize = summary.compared.iter().map(|c| c.differ.len()).sum();
    if differ < summary.failures.len() {
        let which = if differ > 0 { "failures of the run" } else { "all failures" };
        text.push_str(&format!("\n{which} are in {}", summary.folder.join("failures").display()));
    }
    Err(ExitReason::Failed(if json { String::new() } else { text }))
}
