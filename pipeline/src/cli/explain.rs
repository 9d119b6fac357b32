//! `magline explain`: the plan of a spec, or the cost of its run.

use clap::{Args, ValueEnum};
use plan::{Plan, PlanGraph, sources::ReadProgress, spec::SpecFaults};
use schemas::StageEntry;
use store::Store;

use ::run::{Event, Listener, SourceReadCallback, cost, plan_all_trials, settled};

use super::{ExitReason, SpecArgs, open, plan, progress::ProgressDisplay, say, threads};

#[derive(Args)]
pub struct ExplainArgs {
    #[command(flatten)]
    spec: SpecArgs,
    /// Print the cost of a run instead: rows, bytes in the store, processor time and memory of each table, and the
    /// total time on this machine. The command reads or simulates the sources.
    #[arg(long)]
    cost: bool,
    /// The output format of the cost.
    #[arg(long, value_enum, default_value_t, requires = "cost")]
    format: CostFormat,
    /// The number of threads of the run; all cores by default.
    #[arg(long, value_parser = threads::count, requires = "cost")]
    threads: Option<usize>,
}

/// Output format of a cost.
#[derive(Clone, Copy, Default, ValueEnum)]
pub enum CostFormat {
    /// Aligned columns, with values to two significant digits.
    #[default]
    Table,
    /// One JSON object with the tables and the totals `rows`, `bytes`, `processor_s`, `clock_s` and `memory_bytes`.
    Json,
}

/// Prints the plan or the cost.
pub fn run(catalogue: &[StageEntry], args: &ExplainArgs) -> Result<(), ExitReason> {
    if !args.cost {
        return with_graph(catalogue, &args.spec, |graph, store| Ok(::report::explain(graph, store)));
    }
    with_plan(catalogue, &args.spec, plan_all_trials, |graph, store, assumed| {
        let mut cost = cost::estimate(graph, store, args.threads.unwrap_or_else(threads::cores))?;
        cost.assumed = assumed;
        Ok(match args.format {
            CostFormat::Table => cost::view::table(&cost),
            CostFormat::Json => format!("{}\n", cost::view::json(&cost)),
        })
    })
}

/// Shows the graph of a plan.
pub fn with_graph(
    catalogue: &[StageEntry],
    args: &SpecArgs,
    view: impl Fn(&PlanGraph, &Store) -> Result<String, ExitReason>,
) -> Result<(), ExitReason> {
    let known = |plan: Plan, catalogue: &[StageEntry], store: &Store, tick: &SourceReadCallback| {
        settled(plan, catalogue, store, tick).map(|plan| (plan, ()))
    };
    with_plan(catalogue, args, known, |graph, store, ()| view(graph, store))
}

/// Shows the graph of a plan with the trials of a search from `trials`.
fn with_plan<T>(
    catalogue: &[StageEntry],
    args: &SpecArgs,
    trials: impl Fn(Plan, &[StageEntry], &Store, &SourceReadCallback) -> Result<(Plan, T), SpecFaults>,
    view: impl Fn(&PlanGraph, &Store, T) -> Result<String, ExitReason>,
) -> Result<(), ExitReason> {
    let plan = plan(catalogue, args)?;
    let store = open(&plan.spec)?;
    let progress = ProgressDisplay::new(false);
    let tick = |table: &str, step: &ReadProgress| progress.on_event(&Event::Reading { table, step });
    let (plan, more) = trials(plan, catalogue, &store, &tick)?;
    let graph = PlanGraph::new(&plan, &store, &tick)?;
    drop(progress);
    say(view(&graph, &store, more)?)
}
