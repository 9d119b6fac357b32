//! History of runs: the time and result of each run, and the changes between two runs.

use std::{
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use schemas::{Fault, keys::HashKey, paths};
use serde::{Deserialize, Serialize};
use store::{Store, own_file, pipeline_name};

use super::{record::Snapshot, run_changes::changes, text};

/// One run of a pipeline.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// Number, from 1.
    pub number: u64,
    /// End time, UTC.
    pub time: String,
    /// The hash of the computation and of its data.
    pub run: String,
    /// The program's version.
    pub version: String,
    /// Version of the tables that the run published.
    pub tables: u64,
    /// Numbers of units that were computed, reused, failed and skipped.
    pub units: [usize; 4],
    /// Duration, in seconds.
    pub seconds: f64,
    /// The file in `runs/` with the inputs of the tables.
    pub snapshot: String,
    /// Checksum of the other fields.
    #[serde(default)]
    pub sum: String,
}

/// The last key of a line, which is a JSON object.
const LAST: &str = "\"sum\":\"";

/// Checksum of the text of a line, because parsed numbers may differ from the written numbers in the last bit.
fn sum_of(line: &str) -> Option<String> {
    let (others, _) = line.rsplit_once(LAST)?;
    Some(HashKey::from_parts([format!("{others}{LAST}\"}}").into_bytes()]).to_string())
}

/// A record as a line with its checksum.
fn line_of(past: &RunRecord) -> Result<String, Fault> {
    let text = |past: &RunRecord| serde_json::to_string(past).map_err(|e| Fault::machine(e.to_string()));
    let sum = sum_of(&text(past)?).ok_or_else(|| Fault::bug("a record has no checksum"))?;
    text(&RunRecord { sum, ..past.clone() })
}

/// The record of a line, if the line is intact.
fn record_of(line: &[u8]) -> Option<RunRecord> {
    let text = std::str::from_utf8(line).ok()?;
    serde_json::from_str::<RunRecord>(text).ok().filter(|past| sum_of(text).as_ref() == Some(&past.sum))
}

fn file(root: &Path, pipeline: &str) -> PathBuf {
    root.join("runs").join(format!("{pipeline}.jsonl"))
}

/// The runs of a pipeline, oldest first. Damaged lines are skipped.
pub fn past(root: &Path, pipeline: &str) -> Vec<RunRecord> {
    if pipeline_name(pipeline).is_err() {
        return vec![];
    }
    let text = paths::read_regular(&file(root, pipeline)).unwrap_or_default();
    text.split(|b| *b == b'\n').filter_map(record_of).collect()
}

/// Whether all lines of a history are intact, except for a line that a power loss truncated.
pub fn is_whole(bytes: &[u8]) -> bool {
    /// Number of bytes from the value of the last key to the end of the line.
    const ENDS: usize = 34;
    let fine = |line: &[u8]| {
        let whole = record_of(line).is_some();
        let text = String::from_utf8_lossy(line);
        let cut = text.rfind(LAST).is_none_or(|at| text.len() < at + LAST.len() + ENDS);
        whole || cut && text.starts_with('{') && !text.ends_with("\"}")
    };
    bytes.split(|b| *b == b'\n').all(|line| line.is_empty() || fine(line))
}

/// Adds a run, which gets the next number.
///
/// # Errors
/// Fails if the store cannot be written.
pub fn add(store: &Store, pipeline: &str, mut past_run: RunRecord, snapshot: &Snapshot) -> Result<(), Fault> {
    let root = store.root();
    // Only the inputs are hashed, because the costs change from run to run.
    let mut plain = snapshot.clone();
    plain.tables.iter_mut().for_each(|t| t.cost = None);
    let text = serde_json::to_vec(&plain).map_err(|e| Fault::machine(e.to_string()))?;
    let name = format!("{}.json", HashKey::from_parts([&text]));
    let kept = root.join("runs").join(&name);
    if paths::read_regular(&kept).ok().as_ref() != Some(&text) {
        store.write(&kept, &text)?;
    }
    past_run.number = past(root, pipeline).last().map_or(1, |p| p.number + 1);
    past_run.snapshot = name;
    // The line break ends a line that a power loss truncated.
    let line = format!("\n{}", line_of(&past_run)?).into_bytes();
    let path = file(root, pipeline);
    let refused = |e: io::Error| Fault::machine(format!("cannot write {}: {e}", path.display()));
    let options = fs::File::options().create(true).append(true).clone();
    if fs::symlink_metadata(&path).is_ok() {
        // If the path is a link, its target is neither written nor copied.
        own_file(root, &path, &options).map_err(refused)?;
    } else {
        // The folder entry of a new file must also be synced to the disk.
        store.write(&path, &[])?;
    }
    repair(store, pipeline, &path)?;
    if store.is_copy() {
        // An object store has no append: the whole object is written again.
        let before =
            paths::read_regular(&path).map_err(|e| Fault::machine(format!("cannot read {}: {e}", path.display())))?;
        return store.write(&path, &[before, line].concat());
    }
    let written = own_file(root, &path, &options).and_then(|mut f| {
        f.write_all(&line)?;
        f.sync_all()
    });
    written.map_err(refused)
}

/// Rewrites a history without its damaged lines, which are never read. The damaged file is set aside.
fn repair(store: &Store, pipeline: &str, path: &Path) -> Result<(), Fault> {
    let before = paths::read_regular(path).unwrap_or_default();
    if is_whole(&before) {
        return Ok(());
    }
    store.write(&store.root().join("damaged").join(format!("{pipeline}.jsonl")), &before)?;
    let intact = before.split(|b| *b == b'\n').filter(|line| record_of(line).is_some());
    let whole: Vec<u8> = intact.flat_map(|line| [b"\n".as_slice(), line].concat()).collect();
    store.write(path, &whole)
}

fn names(root: &Path) -> Vec<String> {
    let entries = fs::read_dir(root.join("runs")).into_iter().flatten().flatten();
    let named = entries.filter_map(|e| Some(e.file_name().to_str()?.strip_suffix(".jsonl")?.to_owned()));
    let mut found: Vec<String> = named.filter(|name| pipeline_name(name).is_ok()).collect();
    found.sort();
    found
}

/// The runs of one pipeline, or of all pipelines.
///
/// # Errors
/// Fails if there is no such pipeline.
pub fn table(root: &Path, pipeline: Option<&str>) -> Result<String, Fault> {
    let all = names(root);
    if let Some(name) = pipeline.filter(|p| !all.iter().any(|n| n == p)) {
        return Err(Fault::new(format!("the store has no run of `{name}`")).nearest(name, &all));
    }
    let head = ["run", "time", "id", "tables", "computed", "reused", "failed", "skipped", "seconds", "magline"];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    for name in all.iter().filter(|n| pipeline.is_none_or(|p| p == *n)) {
        for p in past(root, name) {
            let mut row = vec![format!("{name} {}", p.number), p.time, p.run, p.tables.to_string()];
            row.extend(p.units.iter().map(usize::to_string));
            row.extend([format!("{:.1}", p.seconds), p.version]);
            rows.push(row);
        }
    }
    Ok(text::columns(&rows, 3))
}

/// The run of a pipeline with the number `run` or, if `run` is not a number, the newest run with the id `run`.
///
/// # Errors
/// Fails if there is no such run.
pub fn find(root: &Path, pipeline: &str, run: &str) -> Result<RunRecord, Fault> {
    let all = past(root, pipeline);
    let known = all.iter().map(|p| p.number.to_string()).collect::<Vec<_>>();
    let found = match run.parse::<u64>() {
        Ok(number) => all.into_iter().find(|p| p.number == number),
        Err(_) => all.into_iter().rev().find(|p| p.run == run),
    };
    found.ok_or_else(|| Fault::new(format!("the store has no run {run} of `{pipeline}`")).nearest(run, &known))
}

/// The inputs of the tables of a run.
///
/// # Errors
/// Fails if they are no longer stored, or damaged.
pub fn snapshot(root: &Path, pipeline: &str, past: &RunRecord) -> Result<Snapshot, Fault> {
    let bytes = paths::read_regular(&root.join("runs").join(&past.snapshot));
    let snapshot = bytes.ok().filter(|b| format!("{}.json", HashKey::from_parts([b])) == past.snapshot);
    let missing =
        || Fault::machine(format!("the record of the inputs of run {} of `{pipeline}` is missing", past.number));
    snapshot.and_then(|b| serde_json::from_slice(&b).ok()).ok_or_else(missing)
}

/// Differences between two runs of a pipeline.
///
/// # Errors
/// Fails if a run does not exist, or its inputs are no longer stored.
pub fn between(root: &Path, pipeline: &str, a: u64, b: u64) -> Result<String, Fault> {
    let open = |number: u64| snapshot(root, pipeline, &find(root, pipeline, &number.to_string())?);
    let found = changes(&open(a)?, &open(b)?);
    if found.is_empty() {
        return Ok(format!("runs {a} and {b} of `{pipeline}` have the same spec and the same inputs\n"));
    }
    Ok(found.iter().map(|change| format!("{change}\n")).collect())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn bug_a_run_of_any_duration_stays_in_the_history() {
        for k in 1..5_000 {
            let past = RunRecord { number: k, seconds: 1.0 + (k as f64).sqrt() / 3.0, ..RunRecord::default() };
            let line = line_of(&past).unwrap();
            let read = record_of(line.as_bytes()).unwrap();
            assert_eq!((read.number, read.seconds as f32), (k, past.seconds as f32), "{line}");
            assert!(is_whole(line.as_bytes()));
            // A changed number does not match the checksum.
            let other = line.replacen("\"number\":", "\"number\":9", 1);
            assert!(record_of(other.as_bytes()).is_none() && !is_whole(other.as_bytes()), "{other}");
        }
    }
}
