//! `magline publish` and `magline verify DIR`: complete, consistent and reproducible sets without restricted data.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
    process::Output,
};

use arrow_array::RecordBatch;
use parquet::{
    basic::Compression,
    file::{reader::FileReader, serialized_reader::SerializedFileReader},
};
use serde_json::Value;

use crate::support::{Bench, SPEC, numbers, read, stderr, stdout, texts};

const FACTS: &str = r#"
[publish]
title       = "Small flights"
description = "Two simulated flights."
licence     = "CC-BY-4.0"
date        = "2026-11-23"
contact     = "data@example.org"
keywords    = ["aeromagnetic"]
[[publish.authors]]
given  = "Ada"
family = "Lovelace"
"#;

/// Spec with metadata with parts of the text replaced.
pub fn spec(changes: &[(&str, &str)]) -> String {
    let text = SPEC.to_owned() + FACTS;
    changes.iter().fold(text, |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    })
}

/// Bench after a run of [`spec`].
pub fn ran(changes: &[(&str, &str)]) -> Bench {
    let bench = Bench::new();
    bench.spec(&spec(changes));
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{} {}", done.stderr, done.last);
    bench
}

pub fn publish(bench: &Bench, tables: &[&str], more: &[&str]) -> Output {
    let args: Vec<&str> = ["publish", "spec.toml"].iter().chain(tables).chain(more).copied().collect();
    bench.magline(&args)
}

pub fn published(bench: &Bench, tables: &[&str], to: &str, more: &[&str]) -> String {
    let more: Vec<&str> = ["--to", to].iter().chain(more).copied().collect();
    let output = publish(bench, tables, &more);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    stdout(&output)
}

pub fn refused(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(2), "{}{}", stdout(output), stderr(output));
    stderr(output)
}

/// Files of a folder with their bytes.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    fn walk(folder: &Path, prefix: &str, found: &mut BTreeMap<String, Vec<u8>>) {
        for entry in fs::read_dir(folder).unwrap().flatten() {
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            if entry.path().is_dir() {
                walk(&entry.path(), &format!("{name}/"), found);
            } else {
                found.insert(name, fs::read(entry.path()).unwrap());
            }
        }
    }
    let mut found = BTreeMap::new();
    walk(folder, "", &mut found);
    found
}

pub fn verify(bench: &Bench, folder: &str) -> (Option<i32>, String) {
    let output = bench.magline(&["verify", folder]);
    (output.status.code(), stdout(&output) + &stderr(&output))
}

pub fn json(bench: &Bench, file: &str) -> Value {
    serde_json::from_slice(&fs::read(bench.path(file)).unwrap()).unwrap()
}

const LINES: [(&str, &str); 4] = [("1", "1.01"), ("1", "1.02"), ("2", "2.01"), ("2", "2.02")];

pub fn line_folder(set: &str, table: &str, flight: &str, line: &str) -> String {
    format!("{set}/data/{table}/flight_id=flight-{flight}/line_id=line-{line}")
}

#[test]
fn user_a_published_set_holds_the_rows_of_the_run_and_verifies() {
    let bench = ran(&[]);
    published(&bench, &["scores", "clean", "coefficients", "flights", "anomaly"], "set", &[]);
    let (code, message) = verify(&bench, "set");
    assert_eq!(code, Some(0), "{message}");
    assert!(message.contains("all verified"), "{message}");
    // The rows are those of the store, in the order of axes and time.
    let sums = |batches: &[RecordBatch], column: &str| numbers(batches, column).iter().sum::<f64>();
    let stored = read(&bench.path("store/tables/small/clean"));
    let parts: Vec<RecordBatch> =
        LINES.iter().flat_map(|(f, l)| read(&bench.path(&line_folder("set", "clean", f, l)))).collect();
    assert_eq!(numbers(&parts, "tt").len(), numbers(&stored, "tt").len());
    for column in ["mag_c", "mag_aircraft", "lambda", "tt"] {
        let (a, b) = (sums(&parts, column), sums(&stored, column));
        assert!((a - b).abs() <= 1e-9 * b.abs(), "{column}: {a} {b}");
    }
    for (flight, line) in LINES {
        let rows = read(&bench.path(&line_folder("set", "clean", flight, line)));
        assert_eq!(texts(&rows, "line").into_iter().collect::<BTreeSet<_>>(), [line.to_owned()].into());
        let keys: Vec<(String, String, f64, f64)> = texts(&rows, "mag")
            .into_iter()
            .zip(texts(&rows, "vector"))
            .zip(numbers(&rows, "lambda").into_iter().zip(numbers(&rows, "tt")))
            .map(|((mag, vector), (lambda, tt))| (mag, vector, lambda, tt))
            .collect();
        assert!(keys.is_sorted_by(|a, b| a < b), "{line}: keys ascend, and none is there twice");
    }
    // A table of files is published unchanged.
    let clean = read(&bench.path(&line_folder("set", "flights", "1", "1.02")));
    assert_eq!(numbers(&clean, "mag_4_uc").len(), 500);
    // Compressed by zstd, with statistics.
    let file = fs::File::open(bench.path("set/data/scores/part-0.parquet")).unwrap();
    let metadata = SerializedFileReader::new(file).unwrap().metadata().clone();
    let chunk = metadata.row_group(0).column(0);
    assert!(matches!(chunk.compression(), Compression::ZSTD(_)) && chunk.statistics().is_some());
}

#[test]
fn user_the_same_run_gives_the_same_bytes_on_any_number_of_threads() {
    let bench = ran(&[]);
    let tables = ["scores", "clean", "flights", "anomaly"];
    published(&bench, &tables, "one", &["--threads", "1"]);
    // Recomputed in another store, with another number of threads, point by point.
    for lambda in ["[0.025]", "[0.0, 0.025]"] {
        let set = format!("axes.lambda={lambda}");
        let done = bench.run(&["--set", &set, "--set", "store=other", "--threads", "2"]);
        assert_eq!(done.code, 0, "{}", done.stderr);
    }
    published(&bench, &tables, "two", &["--threads", "2", "--set", "store=other"]);
    let (one, two) = (files(&bench.path("one")), files(&bench.path("two")));
    assert_eq!(one.keys().collect::<Vec<_>>(), two.keys().collect::<Vec<_>>());
    one.iter().for_each(|(name, bytes)| assert!(two.get(name) == Some(bytes), "{name} differs"));
    let folder = bench.folder.path().display().to_string();
    for (name, bytes) in &one {
        assert!(!String::from_utf8_lossy(bytes).contains(&folder), "{name} names a path of the machine");
    }
}

#[test]
fn user_simultaneous_publications_of_the_same_set_all_succeed() {
    let bench = ran(&[]);
    for round in 0..3 {
        let to = format!("set{round}");
        let outputs: Vec<Output> = std::thread::scope(|scope| {
            let all: Vec<_> = (0..3).map(|_| scope.spawn(|| publish(&bench, &["scores"], &["--to", &to]))).collect();
            all.into_iter().map(|one| one.join().unwrap()).collect()
        });
        for output in &outputs {
            assert_eq!(output.status.code(), Some(0), "{}", stderr(output));
        }
        assert_eq!(verify(&bench, &to).0, Some(0));
    }
    // The later programs leave no files.
    let names: Vec<String> = fs::read_dir(bench.folder.path())
        .unwrap()
        .flatten()
        .map(|e| e.file_name().to_string_lossy().into_owned())
        .collect();
    assert!(names.iter().all(|name| !name.ends_with(".new") && !name.ends_with(".old")), "{names:?}");
}

#[test]
fn user_the_published_spec_gives_the_same_bytes_again() {
    let bench = ran(&[("date ", "include_inputs = true\ndate ")]);
    let tables = ["scores", "clean", "flights"];
    published(&bench, &tables, "set", &["--set", "publish.version=2.0.0"]);
    let lock = json(&bench, "set/pipeline/lock.json");
    let path = format!("set/{}", lock["spec"].as_str().unwrap());
    fs::remove_dir_all(bench.path("store")).unwrap();
    fs::remove_dir_all(bench.path("flights")).unwrap();
    let done = bench.magline(&["run", &path, "--set", "store=../../again"]);
    assert_eq!(done.status.code(), Some(0), "{}", stderr(&done));
    let more = ["--to", "copy", "--set", "store=../../again", "--set", "publish.version=2.0.0"];
    let args: Vec<&str> = ["publish", &path].into_iter().chain(tables).chain(more).collect();
    let output = bench.magline(&args);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let (one, two) = (files(&bench.path("set")), files(&bench.path("copy")));
    assert_eq!(one.keys().collect::<Vec<_>>(), two.keys().collect::<Vec<_>>());
    one.iter().for_each(|(name, bytes)| assert!(two.get(name) == Some(bytes), "{name} differs"));
}

#[test]
fn user_inputs_that_are_not_included_are_listed_by_their_hashes() {
    let bench = ran(&[]);
    published(&bench, &["scores"], "set", &[]);
    let lock = json(&bench, "set/pipeline/lock.json");
    let inputs = lock["inputs"].as_array().unwrap();
    let flight = inputs.iter().find(|i| i["file"] == "flights/1.parquet").unwrap();
    let blake3 = blake3_of(&bench.path("flights/1.parquet"));
    assert_eq!((flight["included"].clone(), flight["blake3"].clone()), (Value::Null, Value::String(blake3)));
    assert_eq!(lock["stages"].as_array().unwrap().len(), 6);
    assert!(lock["stages"].as_array().unwrap().iter().all(|s| s["version"].is_u64() && s["key"].is_string()));
}

/// BLAKE3 hash of a file, as in the lineage of the store.
fn blake3_of(path: &Path) -> String {
    let folder = path.parent().unwrap().parent().unwrap();
    let output = crate::support::magline(folder, &["lineage", "small.even"]);
    let text = stdout(&output);
    let line = text.lines().find(|l| l.contains(&*path.file_name().unwrap().to_string_lossy())).unwrap();
    line.rsplit(' ').next().unwrap().to_owned()
}

#[test]
fn user_all_damage_to_a_set_is_found_and_reported() {
    let bench = ran(&[]);
    published(&bench, &["scores", "clean"], "set", &[]);
    let original = files(&bench.path("set"));
    let data = format!("{}/part-0.parquet", line_folder("set", "clean", "1", "1.02"));
    let restore = || {
        fs::remove_dir_all(bench.path("set")).unwrap();
        for (name, bytes) in &original {
            let path = bench.path("set").join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, bytes).unwrap();
        }
    };
    let found = |what: &str, wanted: &[&str]| {
        let (code, message) = verify(&bench, "set");
        assert_eq!(code, Some(1), "{what}: {message}");
        wanted.iter().for_each(|w| assert!(message.contains(w), "{what}: {w}: {message}"));
        restore();
    };
    // A flipped bit, a truncated file, a missing file and an extra file, for each file.
    for name in original.keys() {
        let path = bench.path("set").join(name);
        let mut bytes = original[name].clone();
        let at = bytes.len() / 2;
        bytes[at] ^= 1;
        fs::write(&path, &bytes).unwrap();
        // An altered checksum is reported with the name of the file.
        let named: &[&str] = if name == "SHA256SUMS" { &[] } else { &[name] };
        found(&format!("a flipped bit in {name}"), named);
        fs::write(&path, &original[name][..at]).unwrap();
        found(&format!("{name} cut"), &[name]);
        fs::remove_file(&path).unwrap();
        let (_, message) = verify(&bench, "set");
        let named = message.lines().filter(|line| line.trim_start().starts_with(&format!("{name}: ")));
        assert_eq!(named.count(), 1, "{message}");
        found(&format!("{name} missing"), &[name]);
    }
    fs::write(bench.path("set/data/clean/more.parquet"), "x").unwrap();
    found("an extra file", &["data/clean/more.parquet: it is not part of the published set"]);
    fs::write(bench.path("set/.hidden"), "x").unwrap();
    found("a hidden file", &[".hidden"]);
    // Changes with recomputed checksums: the documents must agree with the data.
    let resum = || {
        let all = files(&bench.path("set"));
        let sum = |name: &String| {
            let output = std::process::Command::new("sha256sum").arg(bench.path("set").join(name)).output().unwrap();
            format!("{}  {name}\n", &String::from_utf8(output.stdout).unwrap()[..64])
        };
        let text: String = all.keys().filter(|n| *n != "SHA256SUMS").map(sum).collect();
        fs::write(bench.path("set/SHA256SUMS"), text).unwrap();
    };
    let edit = |name: &str, from: &str, to: &str| {
        let path = bench.path("set").join(name);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{name}: {from}");
        fs::write(path, text.replacen(from, to, 1)).unwrap();
        resum();
    };
    for (name, from, to) in [
        ("dictionary.json", "\"unit\": \"nT\"", "\"unit\": \"pT\""),
        ("dictionary.json", "\"rows\": ", "\"rows\": 1"),
        ("dictionary.json", "\"missing\": 0", "\"missing\": 1"),
        ("dictionary.json", "\"role\": \"derived\"", "\"role\": \"sensor\""),
        ("croissant.json", "Two simulated flights.", "Three simulated flights."),
        ("datapackage.json", "CC-BY-4.0", "CC0-1.0"),
        ("ro-crate-metadata.json", "2026-11-23", "2026-11-24"),
        ("CITATION.cff", "Lovelace", "Byron"),
        ("DICTIONARY.md", "nT", "pT"),
        ("schemas/clean.json", "number", "integer"),
        ("pipeline/lock.json", "\"spec_sha256\": \"", "\"spec_sha256\": \"0"),
        ("pipeline/spec.toml", "seed  = 1", "seed  = 2"),
        ("README.md", "Small", "Large"),
    ] {
        edit(name, from, to);
        found(&format!("{name}: {from} -> {to}"), &[name]);
    }
    // A line is replaced by another line, and the checksum is adapted.
    let other = format!("{}/part-0.parquet", line_folder("set", "clean", "2", "2.02"));
    fs::copy(bench.path(&other), bench.path(&data)).unwrap();
    resum();
    found("another line's rows", &[data.strip_prefix("set/").unwrap()]);
    let (code, message) = verify(&bench, "set");
    assert_eq!(code, Some(0), "{message}");
    // A folder that is not a published set, and a store.
    assert_eq!(verify(&bench, "flights").0, Some(2));
    assert_eq!(verify(&bench, "store").0, Some(0));
}

#[test]
fn user_a_folder_that_is_no_published_set_is_never_overwritten() {
    let bench = ran(&[]);
    fs::create_dir(bench.path("mine")).unwrap();
    fs::write(bench.path("mine/thesis.tex"), "years of work").unwrap();
    for more in [&["--to", "mine"][..], &["--to", "mine", "--replace"]] {
        let message = refused(&publish(&bench, &["scores"], more));
        assert!(message.contains("mine is a folder, but not a published set"), "{message}");
    }
    assert_eq!(fs::read_to_string(bench.path("mine/thesis.tex")).unwrap(), "years of work");
    published(&bench, &["scores"], "set", &[]);
    // Publishing the same set again changes nothing. Another set requires `--replace`.
    assert!(published(&bench, &["scores"], "set", &[]).contains("already holds the same published set"));
    let before = files(&bench.path("set"));
    let message = refused(&publish(&bench, &["coefficients"], &["--to", "set"]));
    assert!(message.contains("--replace"), "{message}");
    assert_eq!(files(&bench.path("set")), before);
    // A foreign file in the set is kept.
    fs::write(bench.path("set/notes.txt"), "x").unwrap();
    let message = refused(&publish(&bench, &["coefficients"], &["--to", "set", "--replace"]));
    assert!(message.contains("notes.txt"), "{message}");
    fs::remove_file(bench.path("set/notes.txt")).unwrap();
    published(&bench, &["coefficients"], "set", &["--replace"]);
    assert!(bench.path("set/data/coefficients").exists() && !bench.path("set/data/scores").exists());
    assert_eq!(verify(&bench, "set").0, Some(0));
    // No temporary file remains next to the set.
    let hidden: Vec<String> = fs::read_dir(bench.folder.path())
        .unwrap()
        .flatten()
        .map(|e| e.file_name().to_string_lossy().into_owned())
        .filter(|n| n.starts_with('.'))
        .collect();
    assert!(hidden.is_empty(), "{hidden:?}");
}

#[test]
fn user_missing_metadata_is_reported_with_the_required_key() {
    let bench = Bench::new();
    let message = refused(&publish(&bench, &["scores"], &["--to", "set"]));
    assert!(message.contains("[publish]") && message.contains("title"), "{message}");
    bench.spec(&spec(&[]));
    let message = refused(&publish(&bench, &["scores"], &["--to", "set"]));
    assert!(message.contains("magline run spec.toml"), "{message}");
    assert!(!bench.path("store").exists() && !bench.path("set").exists());
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let message = refused(&publish(&bench, &["score"], &["--to", "set"]));
    assert!(message.contains("did you mean `scores`?"), "{message}");
    // Results of another spec are not published under this spec.
    let message = refused(&publish(&bench, &["scores"], &["--to", "set", "--set", "axes.lambda=[0.5]"]));
    assert!(message.contains("magline run spec.toml --set 'axes.lambda=[0.5]'"), "{message}");
    // `check` reports errors in the metadata with their positions.
    for (from, to, wanted) in [
        ("licence ", "license ", "did you mean `licence`?"),
        ("2026-11-23", "2026-02-30", "is not a date"),
        ("title       = \"Small flights\"\n", "", "`publish` needs `title`"),
        ("given  = \"Ada\"\n", "", "`given` and `family`"),
    ] {
        bench.spec(&spec(&[(from, to)]));
        let message = refused(&bench.magline(&["check", "spec.toml"]));
        assert!(message.contains(wanted) && message.contains("spec.toml:"), "{wanted}: {message}");
    }
    bench.spec(&spec(&[("CC-BY-4.0", "My own")]));
    let message = refused(&publish(&bench, &["scores"], &["--to", "set"]));
    assert!(message.contains("licence_url"), "{message}");
    assert!(!bench.path("set").exists());
}

#[test]
fn user_a_failed_line_is_listed_in_the_set() {
    let bench = Bench::new();
    let broken = crate::support::without(&crate::support::line_of("3", "3.01", 300), "flux_d_x");
    crate::support::write(&bench.path("flights/3.parquet"), &[broken]);
    bench.spec(&spec(&[]));
    let done = bench.run(&[]);
    assert_eq!(done.code, 1, "{}", done.stderr);
    published(&bench, &["clean", "scores"], "set", &[]);
    let failures = json(&bench, "set/dictionary.json")["failures"].clone();
    let lines: Vec<&str> = failures.as_array().unwrap().iter().filter_map(|f| f["line"].as_str()).collect();
    assert!(lines.contains(&"3.01"), "{failures}");
    assert!(fs::read_to_string(bench.path("set/README.md")).unwrap().contains("line 3.01"));
    assert_eq!(verify(&bench, "set").0, Some(0));
}
