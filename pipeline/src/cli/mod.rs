//! The command line: arguments in, text and exit status out. Results go to standard output, all else to standard error.

mod answer;
mod events;
mod map;
mod progress;

use std::{
    io::Write,
    path::PathBuf,
    process::ExitCode,
    sync::atomic::{AtomicBool, Ordering},
};

use clap::{Args, Parser, Subcommand};
use pipeline::{
    catalogue,
    plan::{Graph, Plan},
    read_spec,
    run::{self, Event, INTERRUPTED, Listener, Summary},
    spec::{Faults, Spec},
    store::Store,
    views::{self, score_table, scores, warnings},
};
use progress::Progress;
use schemas::{Fault, Owner, render};

/// Compensates aeromagnetic flights and navigates by the magnetic anomaly: a TOML file names tables and stages, a run
/// computes what is not yet in its store, and every result is Parquet.
#[derive(Parser)]
#[command(name = "magline", version, about, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run what is not yet in the store.
    #[command(after_long_help = JSON_HELP)]
    Run(RunArgs),
    /// Check a spec; nothing is run.
    Check(SpecArgs),
    /// Print the plan: tables, axes, what is in the store, what each stage costs.
    Explain(SpecArgs),
    /// Say what changed since a table was last computed.
    Why {
        #[command(flatten)]
        spec: SpecArgs,
        /// The table.
        table: String,
    },
    /// Ask the tables of a store, named PIPELINE.TABLE, in SQL.
    Sql {
        /// The query.
        query: String,
        /// The store's folder.
        #[arg(long, default_value = "store")]
        store: PathBuf,
        /// How the answer is written.
        #[arg(long, value_enum, default_value_t)]
        format: answer::Format,
        /// The file it is written to.
        #[arg(short, long)]
        output: Option<PathBuf>,
    },
    /// Say where a table's rows come from.
    Lineage {
        /// The table, as PIPELINE.TABLE.
        table: String,
        /// The store's folder.
        #[arg(long, default_value = "store")]
        store: PathBuf,
        /// How it is written.
        #[arg(long, value_enum, default_value_t)]
        format: views::Format,
    },
    /// Say what stages there are, or all about one.
    Stages {
        /// The stage.
        name: Option<String>,
        /// The reference page of all stages.
        #[arg(long)]
        markdown: bool,
    },
    /// Write what a run found as one page of tables and plots.
    Report {
        #[command(flatten)]
        spec: SpecArgs,
        /// The HTML file it is written to.
        #[arg(short, long)]
        output: PathBuf,
    },
    /// Work on anomaly maps.
    Map {
        /// Nothing on standard error but errors: no progress, no notes.
        #[arg(short, long, global = true)]
        quiet: bool,
        #[command(subcommand)]
        command: map::MapCommand,
    },
    /// Simulate flights with known truth.
    Synth {
        /// The simulation's spec.
        spec: PathBuf,
        /// The folder the flights are written to.
        #[arg(long)]
        to: PathBuf,
        /// Nothing on standard error but errors.
        #[arg(short, long)]
        quiet: bool,
    },
}

#[derive(Args)]
struct SpecArgs {
    /// The spec: a TOML file.
    spec: PathBuf,
    /// Change a value of the spec: seed, store, axes.NAME, tables.NAME.KEY or STAGE.PARAMETER.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
}

#[derive(Args)]
struct RunArgs {
    #[command(flatten)]
    spec: SpecArgs,
    /// How many threads; all cores when left out. The answers do not depend on it.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..))]
    threads: Option<u16>,
    /// Where it runs.
    #[arg(long, default_value = "local")]
    engine: String,
    /// One JSON event per line on standard output; `magline run --help` says what they hold.
    #[arg(long)]
    json: bool,
    /// No progress, no notes and no tables: only errors, and one line where results are marked.
    #[arg(short, long)]
    quiet: bool,
}

const JSON_HELP: &str = "\
Scores are marked where a filter is worse than its INS alone (worse_than_ins), where its NEES is outside of 0.2 to 20 (its \
law is 2) or its NIS outside of 0.25 to 4 (its law is 1). These, maps at another height than the flight (map_height), \
lines that are mostly off the map (off_map) and what fits say against themselves (fit) are rows of the table \
<name>.warnings, with the likely cause. They do not change the exit status.

Events of --json, one object per line, each with the key `event`:
  reading     table, file, simulated, lines, of_lines, done, all: a file is begun or done, or has one more line
  started     pipeline, version, run, time, units, notes
  computing   table, units: how many of its units (a line at a sweep point, or a fit) are computed now
  unit        table, axes, flight, line, status (computed, reused, failed, skipped), error
  publishing  table
  table       table, seconds, computed, reused, failed, skipped
  finished    computed, reused, failed, skipped; version, run, time, seconds, folder; tables (the same counts and the \
seconds of each); failures; notes; warnings (stage, axes, flight, line, kind, value, limit, unit, text, cause); scores \
(stage, axes, lines, marked, metrics: pooled over the lines, null where there is none); interrupted

`run` is a hash of what is asked and of the data it is asked of: the same for the same spec and inputs. `time` is UTC.";

/// Something that ends the command, with its exit status.
enum Stop {
    /// The spec, an argument or an input is wrong; nothing was run.
    Wrong(String),
    /// Something failed while running.
    Failed(String),
    /// Interrupted.
    Interrupted,
}

impl From<Faults> for Stop {
    fn from(faults: Faults) -> Stop {
        let machine = faults.faults.iter().any(|f| f.owner == Owner::Machine);
        if machine { Stop::Failed(faults.to_string()) } else { Stop::Wrong(faults.to_string()) }
    }
}

impl From<Fault> for Stop {
    fn from(fault: Fault) -> Stop {
        let text = render(&fault, "", "");
        if fault.owner == Owner::Machine { Stop::Failed(text) } else { Stop::Wrong(text) }
    }
}

/// Runs the command.
pub fn main() -> ExitCode {
    let done = match Cli::parse().command {
        Command::Run(args) => run_spec(&args),
        Command::Check(args) => check(&args),
        Command::Explain(args) => with_graph(&args, |graph, store| Ok(views::explain(graph, store))),
        Command::Why { spec, table } => with_graph(&spec, |graph, store| Ok(views::why(graph, store, &table)?)),
        Command::Sql { query, store, format, output } => views::sql::sql(&store, &query)
            .and_then(|a| answer::write(&a.0, &a.1, format, output.as_deref()))
            .map_err(Stop::from),
        Command::Lineage { table, store, format } => {
            views::lineage(&store, &table, format).map_err(Stop::from).and_then(say)
        }
        Command::Stages { name, markdown } => stages(name.as_deref(), markdown),
        Command::Report { spec, output } => report(&spec, &output),
        Command::Map { quiet, command } => map::run(&command, quiet),
        Command::Synth { spec, to, quiet } => synth(&spec, &to, quiet),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(Stop::Failed(text)) => {
            tell(&text);
            ExitCode::from(1)
        }
        Err(Stop::Wrong(text)) => {
            tell(&text);
            ExitCode::from(2)
        }
        Err(Stop::Interrupted) => {
            tell("interrupted; what was finished is kept, and the same command goes on from there");
            ExitCode::from(130)
        }
    }
}

/// Prints to standard output; a reader that has gone away ends the command quietly.
fn say(text: String) -> Result<(), Stop> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(Stop::Failed(format!("error: cannot write: {e}"))),
        _ => Ok(()),
    }
}

/// Whether notes are left unsaid.
static QUIET: AtomicBool = AtomicBool::new(false);

/// Whether notes and progress are left unsaid.
fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// Something worth knowing, on standard error.
fn note(text: &str) {
    if !is_quiet() {
        tell(&format!("note: {text}"));
    }
}

/// Writes a line to standard error. Where nobody reads it any more, or nothing can be written, the work goes on.
fn tell(text: &str) {
    if !text.is_empty() {
        let _ = writeln!(std::io::stderr().lock(), "{text}");
    }
}

fn plan(args: &SpecArgs) -> Result<Plan, Faults> {
    Plan::new(read_spec(&args.spec, &args.sets)?, &catalogue())
}

fn open(spec: &Spec) -> Result<Store, Faults> {
    Store::open(&spec.store).map_err(|f| spec.faults(vec![f]))
}

fn check(args: &SpecArgs) -> Result<(), Stop> {
    let plan = plan(args)?;
    let points: usize = plan.tables.iter().map(|t| t.instances.len()).sum();
    for text in &plan.notes {
        note(text);
    }
    say(format!("{} is fine: {} tables, {points} points\n", plan.spec.file, plan.tables.len()))
}

fn with_graph(args: &SpecArgs, view: impl Fn(&Graph, &Store) -> Result<String, Stop>) -> Result<(), Stop> {
    let plan = plan(args)?;
    let store = open(&plan.spec)?;
    let progress = Progress::new(false);
    let graph = Graph::new(&plan, &store, &|table, step| progress.hear(&Event::Reading { table, step }))?;
    drop(progress);
    say(view(&graph, &store)?)
}

fn report(args: &SpecArgs, output: &std::path::Path) -> Result<(), Stop> {
    // Looked at before anything is opened: a report makes no store.
    views::report::was_run(&read_spec(&args.spec, &args.sets)?)?;
    with_graph(args, |graph, store| {
        views::report::write(output, &views::report::report(graph, store)?)?;
        Ok(format!("{}\n", output.display()))
    })
}

fn stages(name: Option<&str>, markdown: bool) -> Result<(), Stop> {
    let all = catalogue();
    match name {
        Some(name) => say(views::stage_page(&all, name)?),
        None if markdown => say(views::reference_page(&all)),
        None => say(views::stages_overview(&all)),
    }
}

fn synth(spec: &std::path::Path, to: &std::path::Path, quiet: bool) -> Result<(), Stop> {
    let progress = Progress::new(quiet);
    progress.stage("simulating flights");
    progress.detail("lines", "");
    let simulation = datasets::simulate::Simulation::open(spec).map_err(Fault::from)?;
    progress.set(0, simulation.spec().flights.iter().map(|f| f.lines.len()).sum());
    let written = datasets::synthesise_with(spec, to, &|done, all| progress.set(done, all)).map_err(Fault::from)?;
    drop(progress);
    say(written.iter().map(|p| format!("{}\n", p.display())).collect())
}

fn run_spec(args: &RunArgs) -> Result<(), Stop> {
    if args.engine != "local" {
        let what = format!(
            "error: there is no engine at `{}`\n  help: this version runs on this machine: `--engine local`",
            args.engine
        );
        return Err(Stop::Wrong(what));
    }
    // Where no handler can be set, an interrupt ends the process at once; the store stays whole.
    let _ = ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::Relaxed));
    let plan = plan(&args.spec)?;
    let store = open(&plan.spec)?;
    let threads = args.threads.map_or(0, usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|e| Stop::Failed(format!("error: cannot start threads: {e}")))?;
    let summary = if args.json {
        let events = events::Json::new();
        let summary = pool.install(|| run::run(&plan, &store, &events))?;
        if let Some(e) = events.failure() {
            return Err(Stop::Failed(format!("error: cannot write all events: {e}")));
        }
        summary
    } else {
        let progress = Progress::new(args.quiet);
        pool.install(|| run::run(&plan, &store, &progress))?
    };
    if !args.json {
        conclude(&plan, &summary, args.quiet)?;
    }
    ending(&summary, args.json)
}

/// What a run without `--json` says at its end.
fn conclude(plan: &Plan, summary: &Summary, quiet: bool) -> Result<(), Stop> {
    let table = format!("{}.warnings", plan.spec.name);
    let warned = warnings::told(&summary.warnings, &table);
    if quiet {
        warned.last().into_iter().for_each(|line| tell(&format!("warning: {line}")));
        return Ok(());
    }
    for text in &plan.notes {
        note(text);
    }
    say(table_of(summary))?;
    say(scores_of(summary))?;
    warned.iter().for_each(|line| tell(&format!("warning: {line}")));
    Ok(())
}

/// What happened to each table.
fn table_of(summary: &Summary) -> String {
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
    scores::columns(&rows, 1) + &format!("\ntables are in {}\n", summary.folder.display())
}

/// The pooled scores of each table of scores, as wide as the terminal.
fn scores_of(summary: &Summary) -> String {
    const ROWS: usize = 100;
    let width = console::Term::stdout().size_checked().map_or(score_table::WIDTH, |(_, columns)| usize::from(columns));
    let one = |(name, found): &(String, scores::Scores)| {
        let lines = if found.lines == 1 { "one line".to_owned() } else { format!("pooled over {} lines", found.lines) };
        format!("\n{name}, {lines}\n{}", score_table::render(found, width, ROWS))
    };
    summary.scores.iter().map(one).collect()
}

fn ending(summary: &Summary, json: bool) -> Result<(), Stop> {
    if summary.interrupted {
        return Err(Stop::Interrupted);
    }
    if summary.failures.is_empty() {
        return Ok(());
    }
    const SHOWN: usize = 20;
    let mut text = format!("{} failed:", summary.failures.len());
    for f in summary.failures.iter().take(SHOWN) {
        let point: Vec<String> = f.point.iter().map(|(k, v)| format!("{k}={v}")).collect();
        let line = f
            .line
            .as_ref()
            .filter(|_| f.fault.place.line.is_none())
            .map(|(a, b)| format!(" flight {a}, line {b}"))
            .unwrap_or_default();
        text.push_str(&format!("\n  {}{line} {}: {}", f.table, point.join(" "), f.fault));
    }
    if summary.failures.len() > SHOWN {
        text.push_str(&format!("\n  and {} more", summary.failures.len() - SHOWN));
    }
    text.push_str(&format!("\nall of them are in {}", summary.folder.join("failures").display()));
    Err(Stop::Failed(if json { String::new() } else { text }))
}
