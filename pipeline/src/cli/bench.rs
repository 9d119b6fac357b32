//! `magline bench`: the benchmark magline-bench.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::{Stop, counted, progress::Progress, say};
use crate::bench;

#[derive(Subcommand)]
pub enum BenchCommand {
    /// Score predictions of any program on the test flight.
    Score(ScoreArgs),
    /// Write the flights of the benchmark: those to train on, and the test flight without its truth.
    Data {
        /// The folder they are written to, which must be new or empty.
        #[arg(long)]
        to: PathBuf,
        /// The flights: the spec of their simulation.
        #[arg(long, default_value = bench::SPEC)]
        flights: PathBuf,
    },
}

#[derive(Args)]
pub struct ScoreArgs {
    /// The predictions: Parquet or CSV with `flight`, `line`, `tt` and the columns of tasks.
    predictions: PathBuf,
    /// Score these tasks: compensate, navigate, navigate_cold, map_free; by default those with columns in the file.
    #[arg(long, value_delimiter = ',')]
    tasks: Vec<String>,
    /// The flights with the truth: a spec with another seed makes a test that nobody has seen.
    #[arg(long, default_value = bench::SPEC)]
    flights: PathBuf,
    /// Write the results to a file too: .md or .parquet.
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// One JSON object per line on standard output.
    #[arg(long)]
    json: bool,
}

pub fn run(command: &BenchCommand) -> Result<(), Stop> {
    match command {
        BenchCommand::Score(args) => score(args),
        BenchCommand::Data { to, flights } => {
            let written = bench::data(&simulated(flights)?, to)?;
            say(written.iter().map(|p| format!("{p}\n")).collect())
        }
    }
}

fn simulated(flights: &std::path::Path) -> Result<Vec<bench::Flight>, Stop> {
    let progress = Progress::new(false);
    progress.stage("simulating flights");
    Ok(bench::open(flights)?)
}

fn score(args: &ScoreArgs) -> Result<(), Stop> {
    // Predictions that are no answer are refused before anything is simulated.
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
        Err(Stop::Failed(format!("{} failed:\n  {}", failed.len(), failed.join("\n  "))))
    }
}
