//! Version gate: a changed result of a stage requires a new version.
//!
//! Each stage, model and filter has a fingerprint of its example's results on the small flights of these tests. The
//! results are rounded to seven significant digits, so that another processor's rounding does not count as a change.
//! Metrics have their fingerprints in their own definitions, in `stages/src/score/metric.rs`.

use std::fmt::Write;

use arrow_array::{Array, FixedSizeListArray, Float64Array, RecordBatch};
use schemas::{ChoiceDoc, StageEntry};

use crate::support::{Bench, SPEC, read, repository, stdout};

fn fingerprint(batches: &[RecordBatch]) -> String {
    let mut hasher = blake3::Hasher::new();
    for column in batches.iter().flat_map(RecordBatch::columns) {
        let list = column.as_any().downcast_ref::<FixedSizeListArray>().map(|l| l.values().clone());
        let values = list.as_ref().unwrap_or(column);
        if let Some(numbers) = values.as_any().downcast_ref::<Float64Array>() {
            for x in numbers.values() {
                // A value that is zero up to rounding has no significant digits.
                let x = if x.abs() < 1e-7 { 0.0 } else { *x };
                hasher.update(format!("{x:.6e}").as_bytes());
            }
        }
    }
    hasher.finalize().to_hex()[..16].to_owned()
}

/// Spec with the tables of the small flights and an observatory record, without axes and stages.
fn head() -> String {
    let record = repository().join("datasets/samples/boulder/bou20141104vmin.min");
    let tables = SPEC.split("[axes]").next().unwrap();
    format!("{tables}\n[tables.observatory]\npath = {:?}\n", record.display().to_string())
}

/// Name of the table of a kind.
fn table_of(entry: &StageEntry, kind: &ChoiceDoc) -> String {
    format!("{}_{}", entry.name, kind.name)
}

/// Example of a stage with the kind replaced by `kind`.
fn example_of(entry: &StageEntry, kind: &ChoiceDoc) -> String {
    let is_of_kinds = |key: &str| key == kind.key || entry.params.iter().any(|p| p.name == key && !p.owners.is_empty());
    let key = |line: &str| line.split('=').next().unwrap().trim().to_owned();
    let mut text = String::new();
    for line in entry.example.lines().filter(|line| !is_of_kinds(&key(line))) {
        match key(line).as_str() {
            "name" => writeln!(text, "name = \"{}\"", table_of(entry, kind)).unwrap(),
            _ => writeln!(text, "{line}").unwrap(),
        }
    }
    format!("{text}{} = \"{}\"\n{}\n", kind.key, kind.name, kind.example)
}

#[test]
fn gold_a_changed_result_requires_a_new_version() {
    let bench = Bench::new();
    let catalogue = stages::catalogue();
    let examples: String = catalogue.iter().map(|e| e.example).collect();
    let kinds: Vec<(&StageEntry, &ChoiceDoc)> =
        catalogue.iter().flat_map(|e| e.kinds.iter().map(move |k| (e, k))).collect();
    let each: String = kinds.iter().map(|(entry, kind)| example_of(entry, kind)).collect();
    bench.spec(&(head() + &examples + &each));
    let checked = bench.magline(&["check", "spec.toml"]);
    assert!(checked.status.success(), "{}{}", stdout(&checked), crate::support::stderr(&checked));
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{} {}", done.last, done.stderr);
    let mut now = String::new();
    let tables = catalogue.iter().map(|e| (e.name.to_owned(), e));
    for (name, entry) in tables.chain(kinds.iter().map(|(entry, kind)| (table_of(entry, kind), *entry))) {
        let batches = read(&bench.path("store/tables/small").join(&name));
        assert!(batches.iter().any(|b| b.num_rows() > 0), "the example of `{name}` gives no rows");
        writeln!(now, "{name} v{} {}", entry.version, fingerprint(&batches)).unwrap();
    }
    let kept = include_str!("versions.txt");
    assert!(now == kept, "an answer moved: raise the stage's version and write into tests/versions.txt\n{now}");
}

#[test]
fn unit_every_stage_documents_its_unset_parameters() {
    for entry in stages::catalogue() {
        for parameter in &entry.params {
            let silent = parameter.default.is_none() && parameter.absent == Some("");
            assert!(
                !silent,
                "`{}` of `{}` may be left out, and does not say what happens then",
                parameter.name, entry.name
            );
        }
    }
}
