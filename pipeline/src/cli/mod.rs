//! The command line: arguments in, text and exit status out. Results go to standard output, all else to standard error.

mod answer;
mod interrupt;
mod map;
mod progress;

use std::{
    io::{IsTerminal, Write},
    path::PathBuf,
    process::ExitCode,
};

use clap::{Args, Parser, Subcommand};
use pipeline::{
    catalogue,
    plan::{Graph, Plan},
    read_spec,
    run::{self, Summary},
    spec::{Faults, Spec},
    store::Store,
    views::{self, scores},
};
use schemas::{Fault, Owner, render};

/// Declarative dataflow pipelines for aeromagnetic compensation and magnetic navigation.
#[derive(Parser)]
#[command(name = "magline", version, about, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run what is not yet in the store.
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
    /// One JSON event per line on standard output.
    #[arg(long)]
    json: bool,
}

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
        Command::Map { command } => map::run(&command),
        Command::Synth { spec, to } => synth(&spec, &to),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(Stop::Failed(text)) => {
            eprintln!("{text}");
            ExitCode::from(1)
        }
        Err(Stop::Wrong(text)) => {
            eprintln!("{text}");
            ExitCode::from(2)
        }
        Err(Stop::Interrupted) => {
            eprintln!("{}", interrupt::SAID);
            ExitCode::from(interrupt::STATUS)
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

fn plan(args: &SpecArgs) -> Result<Plan, Faults> {
    Plan::new(read_spec(&args.spec, &args.sets)?, &catalogue())
}

fn open(spec: &Spec) -> Result<Store, Faults> {
    Store::open(&spec.store).map_err(|f| spec.faults(vec![f]))
}

fn check(args: &SpecArgs) -> Result<(), Stop> {
    let plan = plan(args)?;
    let points: usize = plan.tables.iter().map(|t| t.instances.len()).sum();
    for note in &plan.notes {
        eprintln!("note: {note}");
    }
    say(format!("{} is fine: {} tables, {points} points\n", plan.spec.file, plan.tables.len()))
}

fn with_graph(args: &SpecArgs, view: impl Fn(&Graph, &Store) -> Result<String, Stop>) -> Result<(), Stop> {
    let plan = plan(args)?;
    let store = open(&plan.spec)?;
    let bar = progress::Reading::new();
    let graph = Graph::new(&plan, &store, &|name, done, all| bar.show(name, done, all))?;
    bar.clear();
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

fn synth(spec: &std::path::Path, to: &std::path::Path) -> Result<(), Stop> {
    let bar = progress::Lines::new(std::io::stderr().is_terminal());
    let written = datasets::synthesise_with(spec, to, &|done, all| bar.set(done, all)).map_err(Fault::from)?;
    drop(bar);
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
    interrupt::listen();
    let plan = plan(&args.spec)?;
    let store = open(&plan.spec)?;
    let threads = args.threads.map_or(0, usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|e| Stop::Failed(format!("error: cannot start threads: {e}")))?;
    let summary = if args.json {
        pool.install(|| run::run(&plan, &store, &progress::Json))?
    } else {
        let bar = progress::Bar::new(std::io::stderr().is_terminal());
        pool.install(|| run::run(&plan, &store, &bar))?
    };
    if !args.json {
        for note in &plan.notes {
            eprintln!("note: {note}");
        }
        say(table_of(&summary))?;
        say(scores_of(&plan, &summary))?;
        for warning in views::warnings::warnings(&plan, &summary.folder)? {
            eprintln!("note: {warning}");
        }
    }
    ending(&summary, args.json)
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

/// The pooled scores of each score table.
fn scores_of(plan: &Plan, summary: &Summary) -> String {
    let mut out = String::new();
    for node in plan.tables.iter().filter(|t| t.entry.name == "score") {
        let axes: Vec<String> = node.axes.iter().map(|i| plan.spec.axes[*i].name.clone()).collect();
        if let Ok(found) = scores::scores(&summary.folder.join(&node.name), &axes)
            && !found.rows.is_empty()
        {
            out.push_str(&format!(
                "\n{}, pooled over {} lines\n{}",
                node.name,
                found.lines,
                scores::render(&found, 100)
            ));
        }
    }
    out
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
