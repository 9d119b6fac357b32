//! `magline report`.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use clap::Args;
use plan::read_spec;
use report::{
    html::{self, FigureFile, ReportComparison, TrackSelection},
    view::report_against,
};
use schemas::{Fault, StageEntry};

use super::{ExitReason, SpecArgs, counted, explain::with_graph};

#[derive(Args)]
pub struct ReportArgs {
    #[command(flatten)]
    spec: SpecArgs,
    /// The output file: .html for a page, .kml or .kmz for the tracks of `navigate`.
    #[arg(short, long, required_unless_present = "figures")]
    output: Option<PathBuf>,
    /// Write all figures of the page as SVG files to this folder, with their captions in `captions.md`. Figures of an
    /// earlier report in this folder are removed.
    #[arg(long, value_name = "DIR")]
    figures: Option<PathBuf>,
    /// Compare the scores with those of an earlier run: its number or id, as listed by `magline runs`.
    #[arg(long, value_name = "RUN")]
    against: Option<String>,
    /// With .kml and .kmz: write only the tracks of these tables.
    #[arg(long, value_delimiter = ',')]
    table: Vec<String>,
    /// With .kml and .kmz: write these lines instead of the lines of the page.
    #[arg(long, value_delimiter = ',')]
    line: Vec<String>,
}

/// File that lists the figures with their captions.
const CAPTIONS: &str = "captions.md";

/// File format of a report.
#[derive(Clone, Copy)]
enum ReportFormat {
    Page,
    Kml,
    Kmz,
}

pub fn run(catalogue: &[StageEntry], args: &ReportArgs) -> Result<(), ExitReason> {
    // Checked before anything is opened: a report does not create a store.
    html::was_run(&read_spec(&args.spec.spec, &args.spec.sets)?)?;
    let output = args.output.as_deref();
    let ending = output.and_then(Path::extension).map(|e| e.to_string_lossy().to_lowercase());
    let form = match ending.as_deref() {
        Some("kml") => ReportFormat::Kml,
        Some("kmz") => ReportFormat::Kmz,
        Some("html" | "htm") | None => ReportFormat::Page,
        Some(other) => {
            let fault = Fault::new(format!("a report cannot be written as `.{other}`"));
            return Err(fault.help("use the extension .html for a page, or .kml or .kmz for tracks").into());
        }
    };
    if matches!(form, ReportFormat::Page) && !(args.table.is_empty() && args.line.is_empty()) {
        let fault = Fault::new("`--table` and `--line` cannot be combined with an HTML page");
        return Err(fault.help("remove `--table` and `--line`, or use the extension .kml or .kmz").into());
    }
    if args.figures.is_some() && !matches!(form, ReportFormat::Page) {
        let fault = Fault::new("`--figures` cannot be combined with .kml or .kmz");
        return Err(fault.help("use the extension .html, or omit `-o`").into());
    }
    if args.against.is_some() && !matches!(form, ReportFormat::Page) {
        let fault = Fault::new("`--against` cannot be combined with .kml or .kmz");
        return Err(fault.help("use the extension .html, or omit `--against`").into());
    }
    let stem = output.and_then(Path::file_stem).map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let choice = TrackSelection { tables: &args.table, lines: &args.line };
    with_graph(catalogue, &args.spec, |graph, store| {
        let mut written = vec![];
        let mut write = |path: &Path, bytes: &[u8]| {
            written.push(format!("{}\n", path.display()));
            html::write(path, bytes)
        };
        match (form, output) {
            (ReportFormat::Page, _) => {
                let compared = |run: &String| -> Result<ReportComparison, Fault> {
                    Ok(ReportComparison { run: run.clone(), blocks: report_against(graph, store, run)? })
                };
                let against = args.against.as_ref().map(compared).transpose()?;
                let page = html::report_with(graph, store, against.as_ref())?;
                if let Some(output) = output {
                    write(output, page.as_bytes())?;
                }
                if let Some(folder) = &args.figures {
                    let figures = html::figure_files(&page);
                    write_figures(folder, &graph.plan.spec.name, &figures)?;
                    written.push(format!("{}: {}\n", folder.display(), counted(figures.len(), "figure")));
                }
            }
            (_, None) => {}
            (ReportFormat::Kmz, Some(output)) => write(output, &html::kml(graph, store, &choice, &stem)?.kmz()?)?,
            (ReportFormat::Kml, Some(output)) => {
                let made = html::kml(graph, store, &choice, &stem)?;
                for (name, bytes) in &made.files {
                    write(&output.with_file_name(name), bytes)?;
                }
                write(output, made.document.as_bytes())?;
            }
        }
        Ok(written.concat())
    })
}

/// Writes figures and captions to a folder.
fn write_figures(folder: &Path, pipeline: &str, figures: &[FigureFile]) -> Result<(), Fault> {
    let failed = |e: io::Error| Fault::machine(format!("cannot write to {}: {e}", folder.display()));
    fs::create_dir_all(folder).map_err(failed)?;
    // Only files that are listed in the captions of an earlier report are removed.
    let list = folder.join(CAPTIONS);
    let earlier = fs::read_to_string(&list).unwrap_or_default();
    for name in earlier.lines().filter_map(|line| line.strip_prefix("**")?.split("**").next()) {
        let path = folder.join(name);
        if is_figure(name) && path.is_file() {
            fs::remove_file(&path).map_err(failed)?;
        }
    }
    for figure in figures {
        html::write(&folder.join(&figure.name), figure.svg.as_bytes())?;
    }
    html::write(&list, html::figure_list(pipeline, figures).as_bytes())
}

/// Whether a file name has the form of a figure's name: a number of three digits or more, words, and `.svg`.
fn is_figure(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
    let Some((number, words)) = name.strip_suffix(".svg").and_then(|stem| stem.split_once('-')) else { return false };
    number.len() >= 3 && number.chars().all(|c| c.is_ascii_digit()) && words.chars().all(plain)
}
