//! `magline report`.

use std::path::{Path, PathBuf};

use clap::Args;
use plan::read_spec;
use report::html::{self, TrackSelection};
use schemas::{Fault, StageEntry};

use super::{ExitReason, SpecArgs, with_graph};

#[derive(Args)]
pub struct ReportArgs {
    #[command(flatten)]
    spec: SpecArgs,
    /// The output file: .html for a page, .kml or .kmz for the tracks of `navigate`.
    #[arg(short, long)]
    output: PathBuf,
    /// With .kml and .kmz: write only the tracks of these tables.
    #[arg(long, value_delimiter = ',')]
    table: Vec<String>,
    /// With .kml and .kmz: write these lines instead of the lines of the page.
    #[arg(long, value_delimiter = ',')]
    line: Vec<String>,
}

/// File format of a report.
enum ReportFormat {
    Page,
    Kml,
    Kmz,
}

pub fn run(catalogue: &[StageEntry], args: &ReportArgs) -> Result<(), ExitReason> {
    // Checked before anything is opened: a report does not create a store.
    html::was_run(&read_spec(&args.spec.spec, &args.spec.sets)?)?;
    let ending = args.output.extension().map(|e| e.to_string_lossy().to_lowercase());
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
    let stem = args.output.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let choice = TrackSelection { tables: &args.table, lines: &args.line };
    with_graph(catalogue, &args.spec, |graph, store| {
        let mut written = vec![];
        let mut write = |path: &Path, bytes: &[u8]| {
            written.push(format!("{}\n", path.display()));
            html::write(path, bytes)
        };
        match form {
            ReportFormat::Page => write(&args.output, html::report(graph, store)?.as_bytes())?,
            ReportFormat::Kmz => write(&args.output, &html::kml(graph, store, &choice, &stem)?.kmz()?)?,
            ReportFormat::Kml => {
                let made = html::kml(graph, store, &choice, &stem)?;
                for (name, bytes) in &made.files {
                    write(&args.output.with_file_name(name), bytes)?;
                }
                write(&args.output, made.document.as_bytes())?;
            }
        }
        Ok(written.concat())
    })
}
