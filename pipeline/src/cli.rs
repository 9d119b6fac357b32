//! The command line: arguments in, text and exit status out. Results go to standard output, all other text to standard
//! error.

mod answer;
mod bench;
mod check;
mod choose;
#[cfg(feature = "cluster")]
mod cluster;
mod completions;
mod doctor;
mod engine;
mod events;
mod explain;
mod export;
mod guard;
mod ingest;
mod init;
mod interrupt;
mod invocation;
mod lines;
mod man;
mod map;
mod new;
mod onnx;
mod progress;
mod publish;
mod report;
mod run;
mod say;
mod schedule;
mod schema;
mod serve;
mod sql;
mod stages;
mod synth;
mod task;
mod temporary;
mod tend;
mod threads;
mod view;

use std::{
    collections::BTreeSet,
    ffi::OsString,
    path::{Path, PathBuf},
    process::ExitCode,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

pub use events::finished as run_summary;
pub use progress::{ProgressDisplay, ProgressSnapshot};

use clap::{Args, Parser, Subcommand};
use invocation::Invocation;
use nix::sys::signal::{SigSet, Signal};
use plan::{
    Plan, read_spec,
    spec::{Spec, SpecFaults},
};
use say::err;
use schemas::{Fault, StageEntry, render};
use store::{Store, pulled};

use crate::release::counted;

/// Batch pipeline for aeromagnetic compensation and magnetic navigation. A TOML spec declares tables and stages. A run
/// computes the results that are missing from the store. Each result is a Parquet data set.
#[derive(Parser)]
#[command(name = "magline", version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run a spec: compute the results that are missing from the store.
    #[command(after_long_help = run::JSON_HELP)]
    Run(run::RunArgs),
    /// Merge the files of a sweep that was extended by several runs. Missing results are computed. The files are then
    /// the same as after a single run.
    Compact(run::RunArgs),
    /// Print the next tasks for `magline task`. No output means that everything is computed. The command reads the
    /// sources.
    Tasks(task::TasksArgs),
    /// Compute tasks and print a receipt of each, for Slurm, Dask, Argo or xargs.
    #[command(after_long_help = task::STATUS_HELP)]
    Task(task::TaskArgs),
    /// Serve as the scheduler of a cluster, for `magline run --engine ballista://HOST:PORT`.
    #[cfg(feature = "cluster")]
    Scheduler(cluster::SchedulerArgs),
    /// Compute the tasks that the scheduler of a cluster dispatches.
    #[cfg(feature = "cluster")]
    #[command(after_long_help = cluster::WORKER_HELP)]
    Worker(cluster::WorkerArgs),
    #[cfg(not(feature = "cluster"))]
    #[command(name = "scheduler", alias = "worker", hide = true)]
    Cluster {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
        _given: Vec<String>,
    },
    /// Check a spec without running it.
    Check(SpecArgs),
    /// Print the plan: tables, axes, stored results and the cost of each stage.
    Explain(explain::ExplainArgs),
    /// Explain why a table would run again: the changes since it was last computed.
    Why {
        #[command(flatten)]
        spec: SpecArgs,
        /// The table.
        table: String,
    },
    /// Query the tables of a store in SQL, by the names PIPELINE.TABLE.
    Sql(sql::SqlArgs),
    /// Export a table of a store as CSV, Geosoft XYZ, MATLAB or Parquet.
    Export(export::ExportArgs),
    /// Serve the tables of a store over Arrow Flight SQL, read-only. Requires a build with the feature `serve`.
    Serve(serve::ServeArgs),
    /// Explore a store, or the runs of a spec, in a browser on this machine. Requires a build with the feature `serve`.
    View(view::ViewArgs),
    /// Answer one query of `serve` in a separate process.
    #[cfg(feature = "serve")]
    #[command(name = crate::serve::COMMAND, hide = true)]
    AnswerQuery,
    /// List the tables of a store.
    Ls {
        /// Only this pipeline.
        pipeline: Option<String>,
        #[command(flatten)]
        store: tend::StoreArgs,
    },
    /// Remove the tables of a pipeline, or one table. Computed results stay in the store until `magline gc --yes`.
    Rm {
        /// The pipeline, or the table as PIPELINE.TABLE.
        name: String,
        #[command(flatten)]
        store: tend::StoreArgs,
    },
    /// List the runs, or show what changed between two runs of a pipeline.
    Runs {
        /// Only the runs of this pipeline.
        pipeline: Option<String>,
        /// The number of the earlier run.
        #[arg(requires = "to")]
        from: Option<u64>,
        /// The number of the later run.
        to: Option<u64>,
        #[command(flatten)]
        store: tend::StoreArgs,
    },
    /// List the unreferenced results of a store; `--yes` removes them.
    Gc(tend::GcArgs),
    /// Verify every byte of a store and quarantine damaged files; or verify a published set.
    Verify {
        /// The folder of a published set or of a store, or the address of a store.
        #[arg(value_parser = located)]
        folder: Option<PathBuf>,
        #[command(flatten)]
        store: tend::StoreArgs,
    },
    /// Trace a table to its input bytes.
    Lineage {
        /// The table, as PIPELINE.TABLE.
        table: String,
        /// The store's folder, or its address such as s3://BUCKET/PREFIX.
        #[arg(long, default_value = "store", value_parser = located)]
        store: PathBuf,
        /// The output format.
        #[arg(long, value_enum, default_value_t)]
        format: ::report::LineageFormat,
    },
    /// List the stages, or describe one.
    Stages {
        /// The stage; or `synth`, `mapping` or `search` for the keys of a simulation, a mapping or a search.
        name: Option<String>,
        /// Print the reference page of all stages in Markdown.
        #[arg(long)]
        markdown: bool,
    },
    /// Write a report of a run: one HTML page of tables and plots, or the tracks for Google Earth and QGIS.
    Report(report::ReportArgs),
    /// Publish tables of a run as a set that others can cite, verify and recompute.
    Publish(publish::PublishArgs),
    /// The benchmark magline-bench: write its flights, or score the predictions of any program.
    Bench {
        #[command(subcommand)]
        command: bench::BenchCommand,
    },
    /// Export a trained network of a `fit` as an ONNX file for other programs.
    Onnx(onnx::OnnxArgs),
    /// Process anomaly maps.
    Map {
        /// Suppress progress and notes; print only errors.
        #[arg(short, long, global = true)]
        quiet: bool,
        #[command(subcommand)]
        command: map::MapCommand,
    },
    /// Import logs as flight Parquet, with a summary of their quality.
    Ingest(ingest::IngestArgs),
    /// Write a spec for your own log: the columns, units, times and sensors that were found, with the reasons.
    Init(init::InitArgs),
    /// Copy a worked example with its data to a new folder, or list the examples.
    New(new::NewArgs),
    /// Check this installation: memory, temporary files, limits, the store, and optionally a spec.
    Doctor(doctor::DoctorArgs),
    /// Print the JSON Schema of a spec, with which editors complete and check its keys.
    #[command(after_help = schema::HELP)]
    Schema,
    /// Print a script that completes commands and options in a shell.
    #[command(after_help = completions::HELP)]
    Completions(completions::CompletionsArgs),
    /// Print a manual page, or write all of them.
    Man(man::ManArgs),
    /// Simulate flights with known truth.
    Synth {
        /// The simulation's spec.
        spec: PathBuf,
        /// The output folder of the flights.
        #[arg(long)]
        to: PathBuf,
        /// Suppress progress; print only errors.
        #[arg(short, long)]
        quiet: bool,
    },
}

#[derive(Args)]
struct SpecArgs {
    /// The spec: a TOML file.
    spec: PathBuf,
    /// Override a value of the spec. KEY is seed, store, axes.NAME, search.KEY, tables.NAME.KEY, publish.KEY or
    /// STAGE.PARAMETER.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
}

/// Folder of the store at a path or address.
fn located(text: &str) -> Result<PathBuf, String> {
    store::located(text).map_err(|fault| fault.to_string())
}

/// Reason for the end of a command, which determines the exit status.
enum ExitReason {
    /// The spec, an argument or an input is wrong; nothing was run.
    Wrong(String),
    /// Something failed while running.
    Failed(String),
    /// Another run holds the lock of the pipeline; nothing was run.
    Locked(String),
    /// The time limit expired.
    OutOfTime,
    /// Interrupted.
    Interrupted,
    /// Ended with this exit status; the message is already printed.
    Printed(u8),
}

impl From<SpecFaults> for ExitReason {
    fn from(faults: SpecFaults) -> ExitReason {
        let passing = faults.faults.iter().any(|f| !f.owner.is_lasting());
        if passing { ExitReason::Failed(faults.to_string()) } else { ExitReason::Wrong(faults.to_string()) }
    }
}

impl From<Fault> for ExitReason {
    fn from(fault: Fault) -> ExitReason {
        let text = render(&fault, "", "");
        if fault.owner.is_lasting() { ExitReason::Wrong(text) } else { ExitReason::Failed(text) }
    }
}

/// Runs the command of this process with the stages of `catalogue`.
pub fn main(catalogue: &[StageEntry]) -> ExitCode {
    ExitCode::from(execute(catalogue, std::env::args_os()))
}

/// Runs a command with the stages of `catalogue` in a process of another program, such as a Python interpreter. The
/// child processes of the command run `program`, which must run the same command as this function. Returns the exit
/// status.
pub fn command(catalogue: &[StageEntry], program: &Path, arguments: Vec<OsString>) -> u8 {
    let name = OsString::from("magline");
    let given: Vec<OsString> = std::iter::once(name).chain(arguments.iter().cloned()).collect();
    Invocation { program: program.to_owned(), arguments }.set();
    execute(catalogue, given)
}

/// Runs the command `arguments`, whose first element is the name of the program. Returns the exit status.
fn execute(catalogue: &[StageEntry], arguments: impl IntoIterator<Item = OsString>) -> u8 {
    // With this signal blocked, a file that exceeds a size limit of the system causes a write error instead of a silent
    // end.
    let _ = SigSet::from(Signal::SIGXFSZ).thread_block();
    let mut names: Vec<&str> = catalogue.iter().map(|e| e.name).collect();
    names.sort_unstable();
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        err!("error: the catalogue has two stages `{}`\n  help: rename one of the two stages", pair[0]);
        return ended(2);
    }
    let command = match Cli::try_parse_from(arguments) {
        Ok(cli) => cli.command,
        Err(e) => {
            if e.use_stderr() {
                // The message repeats arguments, so its control characters are made visible.
                err!("{}", e.render().to_string().trim_end());
            } else {
                say::note(e.print());
            }
            return ended(u8::try_from(e.exit_code()).unwrap_or(2));
        }
    };
    let done = match command {
        Command::Run(args) => run::run(catalogue, &args, false),
        Command::Compact(args) => run::run(catalogue, &args, true),
        Command::Tasks(args) => task::tasks(catalogue, &args),
        Command::Task(args) => task::task(catalogue, &args),
        #[cfg(feature = "cluster")]
        Command::Scheduler(args) => cluster::scheduler(&args),
        #[cfg(feature = "cluster")]
        Command::Worker(args) => cluster::worker(&args),
        #[cfg(not(feature = "cluster"))]
        Command::Cluster { .. } => Err(engine::without_cluster()),
        Command::Check(args) => check::run(catalogue, &args),
        Command::Explain(args) => explain::run(catalogue, &args),
        Command::Why { spec, table } => {
            explain::with_graph(catalogue, &spec, |graph, store| Ok(::report::why(graph, store, &table)?))
        }
        Command::Sql(args) => sql::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Serve(args) => serve::run(&args),
        Command::View(args) => view::run(catalogue, &args),
        #[cfg(feature = "serve")]
        Command::AnswerQuery => crate::serve::answer().map_err(ExitReason::from),
        Command::Ls { pipeline, store } => tend::ls(&store, pipeline.as_deref()),
        Command::Rm { name, store } => tend::rm(&store, &name),
        Command::Runs { pipeline, from, to, store } => tend::runs(&store, pipeline.as_deref(), from.zip(to)),
        Command::Gc(args) => tend::gc(&args),
        Command::Verify { folder, store } => verify(folder, &store),
        Command::Lineage { table, store, format } => {
            let found = pulled(&store).and_then(|()| ::report::lineage(&store, &table, format));
            found.map_err(ExitReason::from).and_then(say)
        }
        Command::Stages { name, markdown } => stages::run(catalogue, name.as_deref(), markdown),
        Command::Report(args) => report::run(catalogue, &args),
        Command::Ingest(args) => ingest::run(&args),
        Command::Init(args) => init::run(catalogue, &args),
        Command::New(args) => new::run(&args),
        Command::Doctor(args) => doctor::run(catalogue, &args),
        Command::Schema => schema::run(catalogue),
        Command::Completions(args) => completions::run(&args),
        Command::Man(args) => man::run(&args),
        Command::Publish(args) => publish::run(catalogue, &args),
        Command::Bench { command } => bench::run(&command),
        Command::Onnx(args) => onnx::run(&args),
        Command::Map { quiet, command } => map::run(&command, quiet),
        Command::Synth { spec, to, quiet } => synth::run(&spec, &to, quiet),
    };
    match done {
        Ok(()) => ended(0),
        Err(ExitReason::Failed(text)) => {
            print_to_stderr(&text);
            ended(1)
        }
        Err(ExitReason::Wrong(text)) => {
            err!("{text}");
            ended(2)
        }
        Err(ExitReason::Locked(text)) => {
            err!("{text}");
            ended(schedule::LOCKED)
        }
        Err(ExitReason::OutOfTime) => {
            err!("{}", schedule::STOPPED);
            ended(schedule::OUT_OF_TIME)
        }
        Err(ExitReason::Printed(status)) => ended(status),
        Err(ExitReason::Interrupted) => {
            err!("{}", interrupt::MESSAGE);
            ended(interrupt::STATUS)
        }
    }
}

/// The exit status: success only if all output was written.
fn ended(status: u8) -> u8 {
    match say::lost() {
        Some(why) if status == 0 => {
            err!("error: cannot write to standard output: {why}");
            1
        }
        _ => status,
    }
}

/// Prints to standard output. A closed reader ends the command quietly.
fn say(text: String) -> Result<(), ExitReason> {
    say::out_text(text);
    // A failure sets the exit status when the command ends.
    Ok(())
}

/// Whether notes are suppressed.
static QUIET: AtomicBool = AtomicBool::new(false);

/// Whether notes and progress are suppressed.
fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// Writes a note to standard error. Several tables of one file have the same notes, so each note is printed once.
fn note(text: &str) {
    static PRINTED: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    let is_new = PRINTED.lock().unwrap_or_else(PoisonError::into_inner).insert(text.to_owned());
    if is_new && !is_quiet() {
        print_to_stderr(&format!("note: {text}"));
    }
}

/// Writes a line to standard error, unless it is empty.
fn print_to_stderr(text: &str) {
    if !text.is_empty() {
        err!("{text}");
    }
}

fn plan(catalogue: &[StageEntry], args: &SpecArgs) -> Result<Plan, SpecFaults> {
    Plan::new(read_spec(&args.spec, &args.sets)?, catalogue)
}

fn open(spec: &Spec) -> Result<Store, SpecFaults> {
    Store::open(&spec.store).map_err(|f| spec.faults(vec![f]))
}

/// Verifies a folder: as a store if the folder is a store, otherwise as a published set.
fn verify(folder: Option<PathBuf>, store: &tend::StoreArgs) -> Result<(), ExitReason> {
    match folder {
        Some(folder) if !tend::is_store(&folder) => publish::verify(&folder),
        Some(folder) => tend::verify(&tend::StoreArgs::new(folder)),
        None => tend::verify(store),
    }
}
