//! `magline bench`: the benchmark magline-bench.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::{ExitReason, counted, progress::ProgressDisplay, say};
use crate::bench;

#[derive(Subcommand)]
pub enum BenchCommand {
    /// Score the predictions of any program on the test flight.
    Score(ScoreArgs),
    /// Write the flights of the benchmark: the training flights, and the test flight without its truth.
    Data {
        /// The output folder; it must be new or empty.
        #[arg(long)]
        to: PathBuf,
        /// The spec of the simulated flights.
        #[arg(long, default_value = bench::SPEC)]
        flights: PathBuf,
    },
}

#[derive(Args)]
pub struct ScoreArgs {
    /// The predictions: Parquet or CSV with `flight`, `line`, `tt` and the columns of the tasks.
    predictions: PathBuf,
    /// The tasks to score: compensate, navigate, navigate_cold, map_free. Default: all tasks with columns in the file.
    #[arg(long, value_delimiter = ',')]
    tasks: Vec<String>,
    /// The spec of the simulated flights with the truth. A spec with another seed gives an unpublished test.
    #[arg(long, default_value = bench::SPEC)]
    flights: PathBuf,
    /// Also write the results to this file, .md or .parquet.
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// Write one JSON object per line to standard output.
    #[arg(long)]
    json: bool,
}

pub fn run(command: &BenchCommand) -> Result<(), ExitReason> {
    match command {
        BenchCommand::Score(args) => score(args),
        BenchCommand::Data { to, flights } => {
            let written = bench::data(&simulated(flights)?, to)?;
            say(written.iter().map(|p| format!("{p}\n")).collect())
        }
    }
}

fn simulated(flights: &std::path::Path) -> Result<Vec<bench::BenchLine>, ExitReason> {
    let progress = ProgressDisplay::new(false);
    progress.stage("simulating flights");
    Ok(bench::open(flights)?)
}

fn score(args: &ScoreArgs) -> Result<(), ExitReason> {
    // Invalid predictions are rejected before the simulation.
    let predictions = bench::Predictions::open(&args.predictions)?;
    let flights = simulated(&args.flights)?;
    let scores = bench::score(&flights, &predictions, &args.tasks)?;
    if let Some(path) = &args.output {
        bench::write(path, &scores)?;
    }
    say(if args.json { bench::as_json(&scores) } else { bench::as_text(&scores) })?;
    let failed: Vec<String> = scores
        .iter()
        .filter(|s| s.value.is_none())
        .filter_map(|s| {
            let line = s.line.as_ref()?;
            Some(format!(
                "{}, {}, line {line}: {} of {} without a prediction",
                s.task,
                s.column,
                counted(s.missing, "sample"),
                s.samples
            ))
        })
        .collect();
    if failed.is_empty() {
        Ok(())
    } else {
        Err(ExitReason::Failed(format!("{} failed:\n  {}", failed.len(), failed.join("\n  "))))
    }
}
