//! `magline map`: processing of anomaly maps, with one file per command.

mod continuation;
mod convert;
mod fill;
mod flags;
mod grid;
mod info;
mod plot;
mod spectrum;
mod vector;

use std::{
    path::{Path, PathBuf},
    sync::atomic::Ordering,
};

use clap::{Args, Subcommand};
use datasets::{AnomalyGrid, MapOptions, check_output, read_grid, write_grid};
use schemas::{Fault, VerbatimText, map::VectorComponent, plausible::PlausibilityCheck};

use super::{ExitReason, note, print_to_stderr, say, threads};

/// Anomaly maps.
#[derive(Subcommand)]
pub enum MapCommand {
    /// Print the extent, spacing, height, gaps and statistics of a map.
    Info(info::InfoArgs),
    /// Make a map from survey points.
    Grid(Box<grid::GridArgs>),
    /// Fill the gaps of a map, from its surroundings or from other maps.
    Fill(fill::FillArgs),
    /// Continue a map upward or downward to other heights, or differentiate it.
    Continue(continuation::ContinueArgs),
    /// Convert a map to another format or coordinate system; cut or expand it.
    Convert(Box<convert::ConvertArgs>),
    /// Compute the north, east and down components of the anomaly field.
    Vector(vector::VectorArgs),
    /// Print the power spectral density of a map by wavenumber, as CSV.
    Spectrum(spectrum::SpectrumArgs),
    /// Draw a map with tracks.
    Plot(plot::PlotArgs),
}

/// Options for reading a map file.
#[derive(Args, Clone)]
pub struct InputArgs {
    /// The format, if the content and name of the file do not determine it.
    #[arg(long)]
    format: Option<String>,
    /// The EPSG code of the coordinates; overrides the file.
    #[arg(long)]
    epsg: Option<u16>,
    /// The height of the map above the WGS-84 ellipsoid, in metres; overrides the file.
    #[arg(long, allow_negative_numbers = true)]
    alt: Option<f64>,
    /// The unit of the anomaly; overrides the file.
    #[arg(long)]
    unit: Option<String>,
    /// The component of a map of three components.
    #[arg(long, value_name = "COMPONENT", value_parser = vector::component())]
    field_component: Option<VectorComponent>,
    #[command(flatten)]
    doubtful: InvalidValueArgs,
}

/// Options for missing and impossible values.
#[derive(Args, Clone, Default)]
pub struct InvalidValueArgs {
    /// Numbers that represent missing values, in the unit of the file, separated by commas.
    #[arg(long, value_name = "NUMBER", value_delimiter = ',', allow_hyphen_values = true)]
    missing: Vec<String>,
    /// `range` accepts impossible values.
    #[arg(long, value_name = "WHAT", value_parser = ["range"])]
    accept: Option<String>,
}

impl InvalidValueArgs {
    fn missing(&self) -> Vec<VerbatimText> {
        self.missing.iter().map(|text| VerbatimText(text.clone())).collect()
    }

    fn accept(&self) -> Vec<PlausibilityCheck> {
        self.accept.iter().map(|_| PlausibilityCheck::Range).collect()
    }
}

/// Options for the output of a map.
#[derive(Args, Clone)]
pub struct OutputArgs {
    /// The output file; its extension determines the format.
    #[arg(short, long)]
    output: PathBuf,
    /// The output format, if the extension of the file does not determine it.
    #[arg(long)]
    output_format: Option<String>,
}

/// Option for the number of threads.
#[derive(Args, Clone)]
pub struct ThreadArgs {
    /// The number of threads; all cores by default. Results do not depend on this number.
    #[arg(long, value_parser = threads::count)]
    threads: Option<usize>,
}

impl InputArgs {
    fn read(&self, path: &Path) -> Result<AnomalyGrid, ExitReason> {
        let options = MapOptions {
            format: self.format.clone(),
            epsg: self.epsg,
            alt_m: self.alt,
            unit: self.unit.clone(),
            field_component: self.field_component,
            missing: self.doubtful.missing(),
            accept: self.doubtful.accept(),
        };
        let map = read_grid(path, &options).map_err(Fault::from)?;
        map.notes.iter().for_each(|n| note(&format!("{}: {n}", path.display())));
        Ok(map)
    }
}

impl OutputArgs {
    /// Checks before the computation that a map made from `inputs` can be written to the output.
    fn check<'a>(&self, inputs: impl IntoIterator<Item = &'a PathBuf>) -> Result<(), ExitReason> {
        apart(&self.output, inputs)?;
        Ok(check_output(&self.output, self.output_format.as_deref()).map_err(Fault::from)?)
    }

    fn write(&self, map: &AnomalyGrid) -> Result<(), ExitReason> {
        write_to(&self.output, map, self.output_format.as_deref())
    }
}

/// Rejects an output that is also an input, because the written map may contain less data.
fn apart<'a>(output: &Path, inputs: impl IntoIterator<Item = &'a PathBuf>) -> Result<(), ExitReason> {
    let Ok(there) = output.canonicalize() else { return Ok(()) };
    if inputs.into_iter().any(|input| input.canonicalize().is_ok_and(|input| input == there)) {
        let what = format!("the output would overwrite the input {}", output.display());
        return Err(Fault::new(what).help("give another file with `-o`").into());
    }
    Ok(())
}

fn write_to(path: &Path, map: &AnomalyGrid, format: Option<&str>) -> Result<(), ExitReason> {
    write_grid(path, map, format).map_err(Fault::from)?;
    say(format!("{}\n", path.display()))
}

impl ThreadArgs {
    fn run<T: Send>(&self, work: impl FnOnce() -> Result<T, ExitReason> + Send) -> Result<T, ExitReason> {
        threads::pool(self.threads)?.install(work)
    }
}

/// Fault of a map, or of a request for a map.
fn wrong(path: &Path, e: &dyn std::fmt::Display) -> ExitReason {
    ExitReason::from(Fault::new(e.to_string()).in_file(&path.display().to_string()))
}

/// Fault of a stage in the data of an input file.
fn of_file(path: &Path, fault: Fault) -> ExitReason {
    ExitReason::from(fault.in_file(&path.display().to_string()))
}

fn warn(text: &str) {
    print_to_stderr(&format!("warning: {text}"));
}

/// Runs the command. With `quiet`, the command prints only errors and warnings.
pub fn run(command: &MapCommand, quiet: bool) -> Result<(), ExitReason> {
    super::QUIET.store(quiet, Ordering::Relaxed);
    match command {
        MapCommand::Info(args) => info::run(args),
        MapCommand::Grid(args) => grid::run(args),
        MapCommand::Fill(args) => fill::run(args),
        MapCommand::Continue(args) => continuation::run(args),
        MapCommand::Convert(args) => convert::run(args),
        MapCommand::Vector(args) => vector::run(args),
        MapCommand::Spectrum(args) => spectrum::run(args),
        MapCommand::Plot(args) => plot::run(args),
    }
}
