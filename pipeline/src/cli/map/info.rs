//! `magline map info`: extent, spacing, height, gaps and statistics of a map.

use std::path::{Path, PathBuf};

use clap::Args;
use datasets::SummaryValue;
use schemas::Fault;
use serde_json::{Map as Object, Value, json};

use super::{ExitReason, InputArgs, print_to_stderr, say};

#[derive(Args)]
pub struct InfoArgs {
    /// The maps.
    #[arg(required = true)]
    maps: Vec<PathBuf>,
    #[command(flatten)]
    input: InputArgs,
    /// Write one JSON object per line, one for each map.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &InfoArgs) -> Result<(), ExitReason> {
    let mut last = Ok(());
    for path in &args.maps {
        // If a map cannot be read, the other maps are still reported.
        match args.input.read(path) {
            Ok(map) => {
                let summary = map.summary().map_err(Fault::from)?;
                say(match args.json {
                    true => {
                        let mut object = Object::new();
                        object.insert("file".to_owned(), json!(path.display().to_string()));
                        for (name, value, unit) in summary.figures() {
                            let key = if unit.is_empty() { name } else { format!("{name} [{unit}]") };
                            object.insert(
                                key,
                                match value {
                                    SummaryValue::Number(number) => json!(number),
                                    SummaryValue::Text(text) => json!(text),
                                },
                            );
                        }
                        format!("{}\n", Value::Object(object))
                    }
                    false => table(path, &summary.figures()),
                })?;
            }
            Err(stop) => {
                // The last error is reported on exit.
                let before = std::mem::replace(&mut last, Err(stop));
                if let Err(ExitReason::Wrong(text) | ExitReason::Failed(text)) = before {
                    print_to_stderr(&text);
                }
            }
        }
    }
    last
}

/// Formats one line per figure: name, value, unit.
fn table(path: &Path, figures: &[(String, SummaryValue, &'static str)]) -> String {
    let widest = figures.iter().map(|(name, _, _)| name.chars().count()).max().unwrap_or(0);
    let mut text = format!("{}\n", path.display());
    for (name, value, unit) in figures {
        let value = match value {
            // Six decimals: 1 µm for coordinates and 1e-6 nT for anomalies.
            SummaryValue::Number(number) => format!("{}", (number * 1e6).round() / 1e6),
            SummaryValue::Text(text) => text.clone(),
        };
        text += format!("  {name:<widest$}  {value} {unit}").trim_end();
        text.push('\n');
    }
    text
}
