//! `magline map info`: what is in a map.

use std::path::PathBuf;

use clap::Args;
use datasets::grid::Figure;
use schemas::Fault;
use serde_json::{Map as Object, Value, json};

use super::{InputArgs, Stop, say};

#[derive(Args)]
pub struct InfoArgs {
    /// The maps.
    #[arg(required = true)]
    maps: Vec<PathBuf>,
    #[command(flatten)]
    input: InputArgs,
    /// One JSON object a map and line.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &InfoArgs) -> Result<(), Stop> {
    let mut last = Ok(());
    for path in &args.maps {
        // The other maps are still told about.
        match args.input.read(path) {
            Ok(map) => {
                let summary = map.summary().map_err(Fault::from)?;
                say(match args.json {
                    true => {
                        let mut object = Object::new();
                        object.insert("file".to_owned(), json!(path.display().to_string()));
                        for (name, value, unit) in summary.figures() {
                            let key = if unit.is_empty() { name } else { format!("{name} [{unit}]") };
                            object.insert(key, match value {
                                Figure::Number(number) => json!(number),
                                Figure::Text(text) => json!(text),
                            });
                        }
                        format!("{}\n", Value::Object(object))
                    }
                    false => format!("{}\n{summary}\n", path.display()),
                })?;
            }
            Err(stop) => {
                if args.maps.len() > 1 {
                    if let Stop::Wrong(text) | Stop::Failed(text) = &stop {
                        eprintln!("{text}");
                    }
                }
                last = Err(stop);
            }
        }
    }
    last
}
