//! `magline publish`, and `magline verify` of a published data set.

use std::path::Path;

use buckets::{StorageLocation, place, supported};
use clap::Args;
use plan::read_spec;
use report::html;
use schemas::{StageEntry, one_line};
use serde_json::json;

use super::{ExitReason, SpecArgs, counted, explain::with_graph, note, say, temporary::TemporaryFolder};
use crate::release::{self, ReleaseRequest, ReleaseSummary};

#[derive(Args)]
pub struct PublishArgs {
    #[command(flatten)]
    spec: SpecArgs,
    /// The tables: tables of stages and tables of files.
    #[arg(required = true)]
    tables: Vec<String>,
    /// The folder of the published set, or its address such as s3://BUCKET/NAME. It must be new or empty.
    #[arg(long)]
    to: String,
    /// Replace a published set in this folder.
    #[arg(long)]
    replace: bool,
    /// Publish restricted columns and the results made from them. The published set states the restrictions.
    #[arg(long)]
    include_restricted: bool,
    /// Write one JSON object to standard output.
    #[arg(long)]
    json: bool,
    /// The number of threads; all cores by default. The published set does not depend on it.
    #[arg(long, value_parser = super::threads::count)]
    threads: Option<usize>,
}

pub fn run(catalogue: &[StageEntry], args: &PublishArgs) -> Result<(), ExitReason> {
    // Checked before anything is opened: publishing does not create a store.
    let spec = read_spec(&args.spec.spec, &args.spec.sets)?;
    release::facts(&spec)?;
    html::was_run(&spec)?;
    let mut folder = None;
    let (to, address) = match place(&args.to)? {
        StorageLocation::Path(path) => (path, None),
        StorageLocation::Object(address) => {
            supported()?;
            // The set is first written to a temporary folder, under its final name.
            let name = address.key.rsplit('/').next().filter(|name| !name.is_empty()).unwrap_or("set").to_owned();
            let own = folder.insert(TemporaryFolder::new()?);
            (own.path().join(name), Some(address))
        }
    };
    let request = ReleaseRequest {
        tables: &args.tables,
        to: &to,
        replace: args.replace,
        include_restricted: args.include_restricted,
    };
    let answer = super::threads::pool(args.threads)?.install(|| {
        with_graph(catalogue, &args.spec, |graph, store| {
            let mut done = release::release(graph, store, &request)?;
            if let Some(address) = &address {
                done.written = release::upload(&to, address, args.replace)?;
            }
            Ok(if args.json { as_json(&done, &args.to) } else { as_text(&done, &args.to) })
        })
    });
    drop(folder);
    answer
}

fn as_json(done: &ReleaseSummary, to: &str) -> String {
    let rule = |name: &String| done.rules.iter().find(|(table, _)| table == name).map(|(_, rule)| rule);
    let one = |(name, rows, files): &(String, u64, usize)| {
        let rule = rule(name);
        json!({ "table": name, "rows": rows, "files": files, "rule": rule })
    };
    let tables: Vec<_> = done.tables.iter().map(one).collect();
    let text = json!({
        "to": to, "written": done.written, "files": done.files, "run": done.run, "tables": tables,
        "failures": done.failures, "restricted": done.restricted, "lifted": done.lifted,
    });
    format!("{text}\n")
}

fn as_text(done: &ReleaseSummary, to: &str) -> String {
    let mut text = String::new();
    for (name, rows, files) in &done.tables {
        let (rows, files) = (counted(*rows, "row"), counted(*files, "file"));
        text += &format!("{name}: {rows} in {files}");
        let rule = done.rules.iter().find(|(table, _)| table == name);
        text += &rule.map(|(_, rule)| format!("; {rule}")).unwrap_or_default();
        text += "\n";
    }
    let files = counted(done.files, "file");
    text += &if done.written {
        format!("wrote {to}, {files}\n")
    } else {
        format!("{to} already holds the same published set, {files}\n")
    };
    if done.failures > 0 {
        note(&format!(
            "{} could not be computed and are listed in the README of the published set",
            counted(done.failures, "line or fit")
        ));
    }
    for column in &done.lifted {
        note(&format!("an earlier run recorded {column} as restricted; the spec no longer restricts it"));
    }
    for one in &done.restricted {
        note(&format!("restricted: {one}"));
    }
    text
}

/// Checks a published data set.
pub fn verify(folder: &Path) -> Result<(), ExitReason> {
    let found = release::verify(folder)?;
    let read = format!("{}, {}", counted(found.files, "file"), counted(found.rows, "row"));
    if found.faults.is_empty() {
        return say(format!("{read}: all verified\n"));
    }
    let mut text = format!("{}: {}", folder.display(), counted(found.faults.len(), "fault"));
    for (file, why) in &found.faults {
        text += &format!("\n  {}: {}", one_line(file), one_line(why));
    }
    Err(ExitReason::Failed(text))
}
