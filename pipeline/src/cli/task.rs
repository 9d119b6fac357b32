//! `tasks` and `task`: runs that are computed by processes of an external scheduler.

use std::{
    io::{self, BufRead, Read},
    path::PathBuf,
    process::exit,
    sync::atomic::Ordering,
    time::Duration,
};

use clap::Args;
use plan::sources::ReadProgress;
use run::{Event, INTERRUPTED, Listener, Receipt, Task, WorkerLimits};
use schemas::{Fault, StageEntry, render};
use store::Store;

use super::{
    ExitReason, SpecArgs, counted, interrupt, is_quiet, located, note, open, plan,
    progress::ProgressDisplay,
    say::{err, out},
    tend::age,
    threads,
};

/// Maximum length of a task on standard input, in bytes.
const LONGEST: u64 = 64 << 20;

/// The arguments of `tasks`.
#[derive(Args)]
pub struct TasksArgs {
    #[command(flatten)]
    spec: SpecArgs,
    /// Only tasks of this table.
    #[arg(long)]
    table: Option<String>,
    /// The maximum number of units of a task. By default the start of a process takes 5 % of the expected time of a
    /// task.
    #[arg(long, value_name = "N", value_parser = units)]
    units: Option<usize>,
    /// Maximum number of retries of a unit whose worker was lost; `--retries 2` permits three attempts.
    #[arg(long, value_name = "N", default_value_t = run::RETRIES)]
    retries: usize,
    /// Read the bytes of every input, even if its size and modification time are unchanged.
    #[arg(long)]
    verify_inputs: bool,
    /// Suppress progress and notes; print only errors.
    #[arg(short, long)]
    quiet: bool,
}

/// The arguments of `task`.
#[derive(Args)]
pub struct TaskArgs {
    /// The store's folder, or its address such as s3://BUCKET/PREFIX.
    #[arg(long, default_value = "store", value_parser = located)]
    store: PathBuf,
    /// The tasks; by default read from standard input, one per line.
    #[arg(value_name = "TASK")]
    tasks: Vec<String>,
    /// For job arrays: compute only every N-th task, starting at task I, counted from 0.
    #[arg(long, value_name = "I/N", value_parser = share)]
    share: Option<(usize, usize)>,
    /// The number of threads; all cores by default. Results do not depend on this number.
    #[arg(long, value_parser = threads::count)]
    threads: Option<usize>,
    /// Time limit of a unit, such as 90s or 2h. After this time, the process ends with exit status 1, and the unit
    /// counts as a unit whose worker was lost.
    #[arg(long, value_name = "TIME", value_parser = age)]
    unit_timeout: Option<Duration>,
    /// Maximum number of retries of a unit whose worker was lost; `--retries 2` permits three attempts.
    #[arg(long, value_name = "N", default_value_t = run::RETRIES)]
    retries: usize,
    /// Suppress notes and the errors of units; receipts contain the errors.
    #[arg(short, long)]
    quiet: bool,
    /// End when the process with this id is no longer the parent.
    #[arg(long, value_name = "PROCESS", hide = true)]
    parent: Option<u32>,
}

/// The text about the exit status in the help of `task`.
pub const STATUS_HELP: &str = "\
Exit status:
  0    every unit has a result, or an error caused by the data; `magline run` reports that error too
  1    a unit has no result, because the machine failed, a stage panicked, or the time limit was exceeded: submit the \
task again
  2    a task was rejected, because it is truncated, of another version, or of a plan that is not in the store: write \
the tasks again with `magline tasks`
  130  interrupted; finished results are stored

pipeline/TASKS.md describes tasks and receipts.";

fn units(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) | Err(_) => Err("the value must be a whole number, 1 or more".to_owned()),
        Ok(n) => Ok(n),
    }
}

fn share(text: &str) -> Result<(usize, usize), String> {
    let wrong = || format!("`{text}` is not of the form I/N with I from 0 to N - 1, such as 0/8 or 7/8");
    let (i, n) = text.split_once('/').ok_or_else(wrong)?;
    let (i, n) = (i.parse().map_err(|_| wrong())?, n.parse().map_err(|_| wrong())?);
    if i < n { Ok((i, n)) } else { Err(wrong()) }
}

/// Prints the tasks of the next wave.
///
/// # Errors
/// Fails if the spec is wrong, or a source or the store cannot be read.
pub fn tasks(catalogue: &[StageEntry], args: &TasksArgs) -> Result<(), ExitReason> {
    interrupt::listen();
    super::QUIET.store(args.quiet, Ordering::Relaxed);
    let plan = plan(catalogue, &args.spec)?;
    let store = open(&plan.spec)?;
    let progress = ProgressDisplay::new(args.quiet);
    let tick = |table: &str, step: &ReadProgress| progress.on_event(&Event::Reading { table, step });
    let mut plan = run::settled(plan, catalogue, &store, &tick)?;
    plan.spec.verify_inputs = args.verify_inputs;
    let options = run::RunOptions { retries: args.retries, ..run::RunOptions::default() };
    let listed = run::list(&plan, &store, options, args.units, args.table.as_deref(), &tick)?;
    drop(progress);
    let mut text = String::new();
    for task in &listed.tasks {
        text.push_str(&serde_json::to_string(task).map_err(|e| Fault::machine(e.to_string()))?);
        text.push('\n');
    }
    out!("{text}");
    if listed.tasks.is_empty() {
        note(&format!("everything is computed; publish the tables with `magline run {}`", args.spec.spec.display()));
    } else {
        let each: Vec<String> = listed.units.iter().map(|(name, n)| format!("{n} of `{name}`")).collect();
        note(&format!("{}; units: {}", counted(listed.tasks.len(), "task"), each.join(", ")));
    }
    if listed.given_up > 0 {
        note(&format!(
            "{} failed after all attempts; `magline run` lists the errors",
            counted(listed.given_up, "unit")
        ));
    }
    Ok(())
}

/// Computes tasks, and prints a receipt of each.
///
/// # Errors
/// Fails if there is no store, a task is rejected, or a unit has no result.
pub fn task(catalogue: &[StageEntry], args: &TaskArgs) -> Result<(), ExitReason> {
    interrupt::withdraw();
    args.parent.into_iter().for_each(interrupt::with_parent);
    super::QUIET.store(args.quiet, Ordering::Relaxed);
    let store = Store::join(&args.store)?;
    let pool = threads::pool(args.threads)?;
    let limits = WorkerLimits { retries: args.retries, unit_timeout: args.unit_timeout };
    let mut wrong = 0;
    let (served, wrong) = pool.install(|| {
        let mut found =
            lines(args).enumerate().filter_map(|(i, line)| match line.and_then(|text| Task::parse(&text)) {
                Ok(task) => args.share.is_none_or(|(own, of)| i % of == own).then_some(task),
                Err(fault) => {
                    wrong += 1;
                    err!("{}", render(&Fault { what: format!("task {}: {}", i + 1, fault.what), ..fault }, "", ""));
                    None
                }
            });
        let served = run::serve(&store, catalogue, &mut found, limits, &print, &|receipt| {
            print(receipt);
            exit(1);
        });
        drop(found);
        (served, wrong)
    });
    if INTERRUPTED.load(Ordering::Relaxed) {
        return Err(ExitReason::Interrupted);
    }
    let mut ends = vec![];
    if served.unanswered > 0 {
        ends.push(format!("{} without a result: submit the tasks again", counted(served.unanswered, "unit")));
    }
    if served.refused + wrong > 0 {
        ends.push(format!("{} rejected", counted(served.refused + wrong, "task")));
        return Err(ExitReason::Wrong(ends.join("; ")));
    }
    match ends.join("; ") {
        text if text.is_empty() => Ok(()),
        _ if args.quiet => Err(ExitReason::Failed(String::new())),
        text => Err(ExitReason::Failed(text)),
    }
}

/// Prints a receipt and its errors.
pub fn print(receipt: &Receipt) {
    match serde_json::to_string(receipt) {
        Ok(text) => out!("{text}\n"),
        Err(e) => err!("error: cannot write a receipt: {e}"),
    }
    if let Some(why) = &receipt.refused {
        err!("error: a task of `{}` is rejected: {why}", receipt.table);
    }
    for answer in receipt.units.iter().filter(|_| !is_quiet()) {
        let Some(fault) = &answer.fault else { continue };
        let place = answer.place.as_ref().filter(|_| fault.place.line.is_none());
        let line = place.map(|(flight, line)| format!(" flight {flight}, line {line}")).unwrap_or_default();
        let point: Vec<String> = answer.axes.iter().map(|(name, value)| format!("{name}={value}")).collect();
        err!("{}{line} {}: {fault}", receipt.table, point.join(" "));
    }
}

/// Tasks as lines of text, from the arguments or from standard input.
fn lines(args: &TaskArgs) -> Box<dyn Iterator<Item = Result<String, Fault>> + Send> {
    if !args.tasks.is_empty() {
        return Box::new(args.tasks.clone().into_iter().map(Ok));
    }
    let next = || {
        let mut bytes = vec![];
        let read = io::stdin().lock().take(LONGEST).read_until(b'\n', &mut bytes);
        match read {
            Ok(0) => None,
            Ok(n) if n as u64 == LONGEST => Some(Err(Fault::new("the line is not a task: it exceeds 64 MB"))),
            Ok(_) => {
                Some(String::from_utf8(bytes).map_err(|_| Fault::new("the line is not a task: it is not UTF-8 text")))
            }
            Err(e) => Some(Err(Fault::machine(format!("cannot read standard input: {e}")))),
        }
    };
    let mut over = false;
    let lines = std::iter::from_fn(move || {
        if over {
            return None;
        }
        let line = next();
        over = line.as_ref().is_none_or(Result::is_err);
        line
    });
    Box::new(lines.filter(|line| line.as_ref().map_or(true, |text| !text.trim().is_empty())))
}
