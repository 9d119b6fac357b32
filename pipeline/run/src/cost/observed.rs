//! Measurements: a record of each table that a run computed, kept in the store, and the built-in records.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use schemas::{keys::HashKey, paths};
use serde::{Deserialize, Serialize};
use store::{COSTS, Store};

use super::fit::{CostSample, UnitPrices};

/// Number of newest records kept per pipeline.
const KEPT: usize = 200;
/// Weight of a built-in record relative to a record of this store.
const BUILT_IN: f64 = 0.3;

/// The records of the examples, on the machine whose speed is 1: `pipeline/benches/costs.py` measures them.
const MEASURED: &str = include_str!("measured.json");

/// Work of the units of one kind: a stage, and its named choice such as the filter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WorkAmounts {
    /// Units.
    pub units: f64,
    /// Rows of the lines of each unit, times the effort per row of the stage with these parameters.
    pub samples: f64,
    /// Numbers read. A column that several points of a sweep read is counted once.
    pub values: f64,
    /// Rows times the squared number of values per row, for survey stages. Points that read the same columns are
    /// counted once.
    pub squares: f64,
}

/// The work of a table.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TableWork {
    /// Stage.
    pub stage: String,
    /// Amounts by kind of unit.
    pub parts: BTreeMap<String, WorkAmounts>,
    /// Units.
    pub units: f64,
    /// Number of input rows of these units.
    pub rows_in: f64,
    /// Numbers per input row, summed over the units.
    pub reads: f64,
    /// Number of files written.
    pub packs: f64,
    /// Numbers per written row.
    pub width: f64,
    /// Bytes in memory at once, if each thread holds one of the largest files.
    pub held: f64,
}

/// Measured cost of one computed table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CostObservation {
    /// Work.
    pub work: TableWork,
    /// Number of rows made.
    pub rows: f64,
    /// Bytes of its files; `None` unless all files are new.
    pub bytes: Option<f64>,
    /// Processor time on a machine of speed 1, in seconds.
    pub seconds: f64,
    /// Peak memory of the process during the computation, in bytes; `None` if the system does not report it.
    pub memory: Option<f64>,
}

/// Name under which the work of a run outside its tables is recorded.
pub const RUN: &str = "(run)";

impl TableWork {
    /// Predictors of the processor time, for `rows` written rows.
    pub fn time(&self, rows: f64) -> Vec<(String, f64)> {
        let mut found = vec![];
        for (kind, part) in &self.parts {
            let of = [("unit", part.units), ("sample", part.samples), ("value", part.values), ("square", part.squares)];
            found.extend(of.map(|(what, amount)| (format!("{kind}/{what}"), amount)));
        }
        found.push(("write/pack".to_owned(), self.packs));
        found.push(("write/number".to_owned(), rows * self.width));
        found
    }

    /// Predictors of the number of rows.
    pub fn rows(&self) -> Vec<(String, f64)> {
        let of = [("unit", self.units), ("read", self.reads), ("row", self.rows_in)];
        of.map(|(what, amount)| (format!("{}/{what}", self.stage), amount)).to_vec()
    }

    /// Predictors of the bytes of the table's files.
    pub fn bytes(&self, rows: f64) -> Vec<(String, f64)> {
        let of = [("pack", self.packs), ("unit", self.units), ("number", rows * self.width)];
        of.map(|(what, amount)| (format!("{}/{what}", self.stage), amount)).to_vec()
    }

    /// Predictors of the memory.
    pub fn memory(&self) -> Vec<(String, f64)> {
        let mut found = vec![("program".to_owned(), 1.0), ("held".to_owned(), self.held)];
        let gathered = |part: &&WorkAmounts| part.squares > 0.0;
        let kinds = self.parts.iter().filter(|(_, part)| gathered(part));
        found.extend(kinds.map(|(kind, part)| (format!("{kind}/gathered"), part.values)));
        found
    }
}

fn last(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or_default()
}

/// Default price in processor time, in seconds.
pub fn usual_seconds(name: &str) -> f64 {
    match last(name) {
        "unit" => 1e-4,
        "pack" => 1e-3,
        "sample" => 3e-7,
        "value" => 2e-8,
        "number" => 5e-8,
        "square" => 1e-9,
        _ => 1e-4,
    }
}

/// Default price in rows.
pub fn usual_rows(name: &str) -> f64 {
    match last(name) {
        "row" => 0.1,
        "read" => 0.5,
        _ => 5.0,
    }
}

/// Default price in bytes.
pub fn usual_bytes(name: &str) -> f64 {
    match last(name) {
        "pack" => 5000.0,
        "number" => 8.0,
        _ => 100.0,
    }
}

/// Default price in memory, in bytes.
pub fn usual_memory(name: &str) -> f64 {
    match last(name) {
        "program" => 60e6,
        "held" => 3.0,
        _ => 8.0,
    }
}

/// Cost of work, from all records.
pub struct CostModel {
    /// Processor time on a machine of speed 1, in seconds.
    pub seconds: UnitPrices,
    /// Rows.
    pub rows: UnitPrices,
    /// Bytes.
    pub bytes: UnitPrices,
    /// Memory, in bytes.
    pub memory: UnitPrices,
    /// Number of records of this store.
    pub own: usize,
}

impl CostModel {
    /// Fits the model to the built-in records and to the records of the store at `root`.
    pub fn new(root: &Path) -> CostModel {
        let own = of_store(root);
        let all = || own.iter().map(|o| (o, 1.0)).chain(built_in_ref().map(|o| (o, BUILT_IN)));
        let sample = |amounts, total: f64, floor: f64, counts: f64| CostSample {
            amounts,
            total,
            weight: counts / (total + floor),
        };
        // The weight is the inverse of the square root of the time, so that neither long tables nor many short tables
        // dominate.
        let time = |(o, w): (&CostObservation, f64)| {
            let (amounts, weight) = (o.work.time(o.rows), w / (o.seconds + 0.005).sqrt());
            CostSample { amounts, total: o.seconds, weight }
        };
        let seconds: Vec<CostSample> = all().map(time).collect();
        let rows: Vec<CostSample> = all().map(|(o, w)| sample(o.work.rows(), o.rows, 1.0, w)).collect();
        let bytes = |(o, w): (&CostObservation, f64)| Some(sample(o.work.bytes(o.rows), o.bytes?, 1000.0, w));
        let bytes: Vec<CostSample> = all().filter_map(bytes).collect();
        let memory = |(o, w): (&CostObservation, f64)| Some(sample(o.work.memory(), o.memory?, 1e7, w));
        let memory: Vec<CostSample> = all().filter_map(memory).collect();
        CostModel {
            seconds: UnitPrices::fit(&seconds, usual_seconds),
            rows: UnitPrices::fit(&rows, usual_rows),
            bytes: UnitPrices::fit(&bytes, usual_bytes),
            memory: UnitPrices::fit(&memory, usual_memory),
            own: own.len(),
        }
    }
}

fn built_in_ref() -> impl Iterator<Item = &'static CostObservation> {
    static ALL: std::sync::OnceLock<Vec<CostObservation>> = std::sync::OnceLock::new();
    ALL.get_or_init(built_in).iter()
}

/// The built-in records.
fn built_in() -> Vec<CostObservation> {
    serde_json::from_str::<Vec<CostObservation>>(MEASURED).unwrap_or_default().into_iter().filter(is_sound).collect()
}

fn path(root: &Path, pipeline: &str) -> PathBuf {
    root.join(COSTS).join(format!("{pipeline}.json"))
}

/// The text of a file: a checksum of the second line, then the records.
fn spelt(records: &[CostObservation]) -> Option<String> {
    let text = serde_json::to_string(records).ok()?;
    Some(format!("{}\n{text}\n", HashKey::from_parts([&text])))
}

/// Records in the text of a file; `None` if the text is damaged.
fn whole(text: &str) -> Option<&str> {
    let (sum, records) = text.strip_suffix('\n')?.split_once('\n')?;
    (HashKey::from_parts([records]).to_string() == sum).then_some(records)
}

/// Whether the checksum of a file of records is correct.
pub fn is_whole(bytes: &[u8]) -> bool {
    std::str::from_utf8(bytes).is_ok_and(|text| whole(text).is_some())
}

/// Records in a file; no records if the file is missing or damaged, because the records only guide estimates.
fn read(path: &Path) -> Vec<CostObservation> {
    let text = paths::read_regular(path).ok().and_then(|bytes| String::from_utf8(bytes).ok()).unwrap_or_default();
    let records = whole(&text);
    let records = records.and_then(|r| serde_json::from_str::<Vec<CostObservation>>(r).ok());
    records.unwrap_or_default().into_iter().filter(is_sound).collect()
}

/// Whether all numbers are finite and in a plausible range.
fn is_sound(o: &CostObservation) -> bool {
    let TableWork { parts, units, rows_in, reads, packs, width, held, .. } = &o.work;
    let parts = parts.values().flat_map(|p| [p.units, p.samples, p.values, p.squares]);
    let rest = [*units, *rows_in, *reads, *packs, *width, *held, o.rows, o.seconds];
    parts.chain(rest).chain(o.bytes).chain(o.memory).all(|x| x.is_finite() && (0.0..1e18).contains(&x))
}

/// The records of all pipelines of the store at `root`.
pub fn of_store(root: &Path) -> Vec<CostObservation> {
    let entries = fs::read_dir(root.join(COSTS)).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> =
        entries.map(|e| e.path()).filter(|p| p.extension().is_some_and(|x| x == "json")).collect();
    paths.sort();
    paths.iter().flat_map(|p| read(p)).collect()
}

/// Adds the measurements of a run of `pipeline`; the run holds the lock of the pipeline. A record replaces an older
/// record of the same work. A record that cannot be written is dropped: it only guides estimates, and the write of
/// results reports the disk fault.
pub fn keep(store: &Store, pipeline: &str, new: Vec<CostObservation>) {
    if new.is_empty() {
        return;
    }
    let path = path(store.root(), pipeline);
    let mut records = read(&path);
    for one in new.into_iter().filter(is_sound) {
        records.retain(|r| r.work.stage != one.work.stage || r.work.parts != one.work.parts);
        records.push(one);
    }
    let records = records.split_off(records.len().saturating_sub(KEPT));
    if let Some(text) = spelt(&records) {
        let _ = store.write(&path, text.as_bytes());
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn one(stage: &str, units: f64, seconds: f64) -> CostObservation {
        let part = WorkAmounts { units, samples: 100.0 * units, values: 1e3, squares: 0.0 };
        let parts = [(stage.to_owned(), part)].into();
        let work = TableWork { stage: stage.to_owned(), parts, units, packs: 1.0, width: 2.0, ..TableWork::default() };
        CostObservation { work, rows: 100.0 * units, bytes: Some(1e4), seconds, memory: None }
    }

    #[test]
    fn unit_records_are_kept_and_damaged_files_ignored() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        keep(&store, "a", vec![one("x", 1.0, 0.1), one("y", 2.0, 0.2)]);
        keep(&store, "b", vec![one("x", 9.0, 0.9)]);
        keep(&store, "a", vec![one("x", 1.0, 0.3)]);
        assert_eq!(of_store(folder.path()), [one("y", 2.0, 0.2), one("x", 1.0, 0.3), one("x", 9.0, 0.9)]);
        let path = path(folder.path(), "a");
        let text = fs::read_to_string(&path).unwrap();
        fs::write(&path, text.replace("0.3", "0.4")).unwrap();
        assert_eq!(of_store(folder.path()), [one("x", 9.0, 0.9)]);
        fs::write(&path, &text[..text.len() / 2]).unwrap();
        assert_eq!(of_store(folder.path()), [one("x", 9.0, 0.9)]);
        // The next run starts a new file.
        keep(&store, "a", vec![one("x", 5.0, 0.5)]);
        assert_eq!(of_store(folder.path()).len(), 2);
    }

    #[test]
    fn unit_a_pipeline_keeps_its_newest_records() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        keep(&store, "a", (0..300).map(|i| one("x", f64::from(i), 0.1)).collect());
        let kept = of_store(folder.path());
        assert_eq!((kept.len(), kept[0].work.units, kept[199].work.units), (KEPT, 100.0, 299.0));
        keep(&store, "a", vec![one("x", f64::NAN, 0.1), one("x", -1.0, 0.1)]);
        assert_eq!(of_store(folder.path()), kept);
    }

    #[test]
    fn unit_built_in_records_are_readable() {
        let listed: Vec<serde_json::Value> = serde_json::from_str(MEASURED).unwrap();
        assert_eq!(built_in().len(), listed.len());
        assert!(built_in().iter().any(|o| o.work.stage == "navigate"), "measure with pipeline/benches/costs.py");
    }
}
