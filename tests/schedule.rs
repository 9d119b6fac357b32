//! Runs started by a scheduler: locks, limits, and files with the outcome of runs.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread::sleep,
    time::{Duration, Instant, SystemTime},
};

use arrow_array::{Array, Float64Array, RecordBatch};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use serde_json::Value;

use crate::{
    json_schema::Schemas,
    support::{Bench, SPEC, changed, line_of, read, repository, stderr, texts, write},
};

pub const TABLES: [&str; 6] = ["even", "terms", "coefficients", "clean", "track", "scores"];

fn start(bench: &Bench, args: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_magline"));
    command.args(["run", "spec.toml"]).args(args).current_dir(bench.folder.path());
    command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

fn signal(child: &Child, name: &str) {
    assert!(Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success());
}

fn leases(bench: &Bench) -> Vec<PathBuf> {
    let files = fs::read_dir(bench.path("store/locks")).into_iter().flatten().flatten().map(|e| e.path());
    files.filter(|p| p.to_string_lossy().contains("small.lease-")).collect()
}

/// Starts a run and waits until it holds the lock.
fn holder(bench: &Bench) -> Child {
    let child = start(bench, &["-q"]);
    let begun = Instant::now();
    let held = || leases(bench).iter().any(|p| fs::read_to_string(p).is_ok_and(|t| t.contains("\"free\":false")));
    while !held() {
        assert!(begun.elapsed() < Duration::from_secs(60), "no run takes the lock");
        sleep(Duration::from_millis(1));
    }
    child
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// Summary of a run, validated against its schema.
pub fn summary(bench: &Bench) -> Value {
    let found = json(&bench.path("summary.json"));
    let schemas = Schemas::read(&repository().join("datasets/examples/schedule"));
    assert_eq!(schemas.faults("urn:magline:run-summary:1", &found), [""; 0]);
    found
}

fn bytes_of(bench: &Bench, table: &str) -> BTreeMap<String, Vec<u8>> {
    let all = bench.tables("store").into_iter();
    all.filter(|(name, _)| name.starts_with(&format!("/small/{table}/"))).collect()
}

#[test]
fn user_a_second_run_of_a_pipeline_is_rejected_or_waits_and_recomputes_nothing() {
    let bench = Bench::new();
    let mut first = holder(&bench);
    signal(&first, "-STOP");
    let refused = start(&bench, &["-q", "--summary", "summary.json"]).wait_with_output().unwrap();
    assert_eq!(refused.status.code(), Some(3), "{}", stderr(&refused));
    let message = stderr(&refused);
    for word in ["another run of `small` holds the lock", &format!("process {} on ", first.id()), "since 20", "--wait"]
    {
        assert!(message.contains(word), "{word} is not in {message}");
    }
    let summary_file = summary(&bench);
    assert_eq!((&summary_file["status"], &summary_file["exit"]), (&"locked".into(), &3.into()));
    assert_eq!(summary_file["holder"]["pid"], first.id());
    let tired = start(&bench, &["-q", "--wait=1s"]).wait_with_output().unwrap();
    assert_eq!(tired.status.code(), Some(3));
    assert!(stderr(&tired).contains("the waiting time of 1 s has expired"), "{}", stderr(&tired));
    // Another pipeline of the same store is not blocked.
    fs::write(bench.path("other.toml"), SPEC.replace("\"small\"", "\"other\"")).unwrap();
    assert!(bench.magline(&["run", "other.toml", "-q", "--until", "even"]).status.success());
    let mut waits = start(&bench, &["--wait", "--summary", "summary.json"]);
    sleep(Duration::from_millis(300));
    assert!(waits.try_wait().unwrap().is_none(), "it did not wait");
    signal(&first, "-CONT");
    assert!(first.wait().unwrap().success());
    let waited = waits.wait_with_output().unwrap();
    assert!(waited.status.success() && stderr(&waited).contains("waiting for that run"), "{}", stderr(&waited));
    let summary_file = summary(&bench);
    assert_eq!((&summary_file["units"]["computed"], &summary_file["units"]["reused"]), (&0.into(), &116.into()));
    assert!(summary_file["holder"].is_null());
}

#[test]
fn user_a_killed_or_expired_holder_does_not_lock() {
    let bench = Bench::new();
    let mut first = holder(&bench);
    first.kill().unwrap();
    first.wait().unwrap();
    assert!(fs::read_to_string(&leases(&bench)[0]).unwrap().contains("\"free\":false"), "it released its lease");
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    // Lease of a process on another machine, whose lock is invisible here. The lease is valid while it is renewed.
    let lease = leases(&bench).pop().unwrap();
    let number: u64 = lease.to_string_lossy().rsplit('-').next().unwrap().parse().unwrap();
    let other = bench.path(&format!("store/locks/small.lease-{}", number + 1));
    let text = fs::read_to_string(&lease).unwrap().replace("\"free\":true", "\"free\":false");
    let mut holder: Value = serde_json::from_str(&text).unwrap();
    (holder["host"], holder["boot"]) = ("elsewhere".into(), "another".into());
    fs::write(&other, holder.to_string()).unwrap();
    let done = bench.run(&[]);
    assert_eq!(done.code, 3);
    assert!(
        done.stderr.contains("on elsewhere, since") && done.stderr.contains("lease last renewed"),
        "{}",
        done.stderr
    );
    let old = SystemTime::now() - Duration::from_secs(600);
    File::options().write(true).open(&other).unwrap().set_modified(old).unwrap();
    let done = bench.run(&[]);
    assert_eq!((done.code, done.total("reused")), (0, 116), "{}", done.stderr);
    assert!(!other.exists() && leases(&bench).len() == 1);
}

#[test]
fn user_until_computes_one_table_and_keeps_downstream_tables() {
    let bench = Bench::new();
    let done = bench.run(&["--until", "terms", "--summary", "summary.json"]);
    assert_eq!((done.code, done.computed("even"), done.computed("terms")), (0, 4, 8), "{}", done.stderr);
    assert!(done.last["tables"].get("clean").is_none());
    assert_eq!(summary(&bench)["left"], serde_json::json!(["coefficients", "clean", "track", "scores"]));
    assert!(bench.path("store/tables/small/terms").is_dir() && !bench.path("store/tables/small/clean").exists());
    let done = bench.run(&[]);
    assert_eq!(TABLES.map(|t| done.computed(t)), [0, 0, 8, 32, 32, 32]);
    assert_eq!(done.last["left"], serde_json::json!([]));
    // Up-to-date results are published as always, and are not listed as skipped.
    let before = bench.tables("store");
    let done = bench.run(&["--until", "even"]);
    assert_eq!((done.total("computed"), &done.last["left"]), (0, &serde_json::json!([])));
    assert_eq!(bench.tables("store"), before);
    // With another rate `even` and `terms` change; the other tables remain as in the last complete run.
    let slow = SPEC.replace("rate_hz = 10.0", "rate_hz = 5.0");
    bench.spec(&slow);
    let (even, clean) = (bytes_of(&bench, "even"), bytes_of(&bench, "clean"));
    let done = bench.run(&["--until", "terms"]);
    assert_eq!((done.code, done.computed("terms")), (0, 8));
    assert_eq!(done.last["left"], serde_json::json!(["coefficients", "clean", "track", "scores"]));
    let note = done.last["notes"].to_string();
    assert!(note.contains("coefficients, clean, track, scores"), "{note}");
    assert_ne!(bytes_of(&bench, "even"), even);
    assert!(!clean.is_empty() && bytes_of(&bench, "clean") == clean);
    assert!(done.last["scores"].as_array().unwrap().is_empty(), "scores of other inputs are shown");
    // `gc` must keep these tables.
    assert!(bench.magline(&["gc", "--store", "store", "--yes"]).status.success());
    assert!(bytes_of(&bench, "clean") == clean);
    assert!(bench.magline(&["verify", "--store", "store"]).status.success());
    // The lineage of a skipped table still refers to the run that computed the table.
    let lineage: Value =
        serde_json::from_slice(&bench.magline(&["lineage", "small.clean", "--format", "json"]).stdout).unwrap();
    assert_eq!(lineage["table"], "clean");
    bench.run(&[]);
    let grown = bench.tables("store");
    bench.run(&["--set", "store=fresh"]);
    assert!(grown == bench.tables("fresh"), "the way to the tables shows in their bytes");
    let wrong = bench.magline(&["run", "spec.toml", "--until", "claen"]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(stderr(&wrong).contains("did you mean `clean`?"), "{}", stderr(&wrong));
}

/// Changes one value of a published column in its file, as if another machine computed another result.
fn tamper(bench: &Bench, table: &str, column: &str) {
    let folder = bench.path("store/tables/small").canonicalize().unwrap().join(table);
    let part = fs::read_dir(folder).unwrap().flatten().map(|e| e.path()).next().unwrap();
    let opened = ParquetRecordBatchReaderBuilder::try_new(File::open(&part).unwrap()).unwrap();
    let about = opened.metadata().file_metadata().key_value_metadata().unwrap().clone();
    let batches: Vec<RecordBatch> = opened.build().unwrap().map(Result::unwrap).collect();
    let whole = arrow_select::concat::concat_batches(&batches[0].schema(), &batches).unwrap();
    let at = whole.schema().index_of(column).unwrap();
    let values = whole.column(at).as_any().downcast_ref::<Float64Array>().unwrap();
    let first = values.value(0);
    let whole = changed(&whole, column, |i, x| if i == 0 { first + first.abs() * 1e-15 + 1e-300 } else { x });
    assert_ne!(whole.column(at).to_data(), batches[0].column(at).to_data());
    let packs = fs::read_dir(bench.path("store/objects")).unwrap().flatten().map(|e| e.path());
    let packs: Vec<PathBuf> = packs.flat_map(|p| fs::read_dir(p).unwrap().flatten().map(|e| e.path())).collect();
    let bytes = fs::read(&part).unwrap();
    let pack = packs.into_iter().find(|p| fs::read(p).unwrap() == bytes).unwrap();
    let about: Vec<(String, String)> = about
        .into_iter()
        .filter(|kv| kv.key.starts_with("magline") && kv.key != "magline.crc")
        .map(|kv| (kv.key, kv.value.unwrap_or_default()))
        .collect();
    // The pack is replaced, because the published version shares the hard link.
    fs::remove_file(&pack).unwrap();
    let store = pipeline::store::Store::open(&bench.path("elsewhere")).unwrap();
    store.write_table(&pack, &whole, &about).unwrap();
}

#[test]
fn user_force_recomputes_and_reports_changed_bytes() {
    let bench = Bench::new();
    bench.run(&[]);
    let before = bench.tables("store");
    let done = bench.run(&["--force", "--summary", "summary.json"]);
    assert_eq!((done.code, done.total("computed")), (0, 0), "{}", done.stderr);
    let units = |name: &str| {
        let found = done.last["compared"].as_array().unwrap().iter().find(|c| c["table"] == name).unwrap().clone();
        assert_eq!(found["differ"], 0);
        found["units"].as_u64().unwrap()
    };
    assert_eq!(TABLES.map(units), [4, 8, 8, 32, 32, 32]);
    assert_eq!(summary(&bench)["compared"], done.last["compared"]);
    assert!(done.last["notes"].to_string().contains("`clean` was recomputed: 32 units, the same bytes"));
    assert!(bench.tables("store") == before);
    assert!(fs::read_dir(bench.path("store/tmp")).unwrap().next().is_none(), "the copy is left");
    // A stored result that differs from the computed one.
    tamper(&bench, "coefficients", "value");
    let done = bench.run(&["--force=coefficients", "--summary", "summary.json"]);
    assert_eq!((done.code, done.total("computed")), (1, 0), "{}", done.stderr);
    assert_eq!(done.last["compared"], serde_json::json!([{ "table": "coefficients", "units": 8, "differ": 1 }]));
    let message = done.last["failures"].to_string();
    assert!(message.contains("column `value`, row 0: ") && message.contains(" now"), "{message}");
    assert_eq!(summary(&bench)["status"], "failed");
    // The table `even` does not depend on this result.
    assert_eq!(bench.run(&["--force=even"]).code, 0);
    let wrong = bench.run(&["--force=evne"]);
    assert!(wrong.code == 2 && wrong.stderr.contains("did you mean `even`?"), "{}", wrong.stderr);
}

#[test]
fn user_every_end_of_a_run_has_its_status_and_its_summary() {
    let bench = Bench::new();
    let run = |more: &[&str]| {
        let _ = fs::remove_file(bench.path("summary.json"));
        let done = bench.run(&[&["--summary", "summary.json"], more].concat());
        let summary_file = summary(&bench);
        assert_eq!(summary_file["exit"], done.code, "{}", done.stderr);
        (done, summary_file)
    };
    let (done, summary_file) = run(&["--max-time", "0s"]);
    assert_eq!((done.code, &summary_file["status"]), (4, &"out_of_time".into()), "{}", done.stderr);
    assert!(done.stderr.contains("again to resume"), "{}", done.stderr);
    let (done, summary_file) = run(&[]);
    assert_eq!(
        (&summary_file["status"], &summary_file["version"], &summary_file["run"]),
        (&"done".into(), &1.into(), &done.last["run"])
    );
    assert_eq!(summary_file["spec_hash"], blake3::hash(SPEC.as_bytes()).to_hex().to_string());
    for (table, of) in TABLES.iter().zip(summary_file["tables"].as_array().unwrap()) {
        assert_eq!((&of["name"], &of["computed"]), (&(*table).into(), &done.computed(table).into()));
        let files = bytes_of(&bench, table);
        let bytes: usize = files.values().map(Vec::len).sum();
        assert_eq!((of["files"].as_u64(), of["bytes"].as_u64()), (Some(files.len() as u64), Some(bytes as u64)));
    }
    // With an impossible line all other results are complete.
    write(&bench.path("flights/3.parquet"), &[changed(&line_of("3", "3.01", 500), "lat", |_, _| 95.0)]);
    let (done, summary_file) = run(&[]);
    assert_eq!((done.code, &summary_file["status"], &summary_file["error"]), (1, &"failed".into(), &Value::Null));
    assert!(summary_file["failures"][0]["error"].as_str().unwrap().contains("lat"));
    fs::remove_file(bench.path("flights/3.parquet")).unwrap();
    let (done, summary_file) = run(&["--set", "even.rate=3"]);
    assert_eq!((done.code, &summary_file["status"], &summary_file["pipeline"]), (2, &"wrong".into(), &Value::Null));
    assert!(summary_file["error"].as_str().unwrap().contains("rate_hz"), "{summary_file}");
    let refused = bench.magline(&["run", "spec.toml", "--summary", "no/such/folder.json"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("there is no folder no/such"), "{}", stderr(&refused));
    // A search requires all its tables.
    let search = repository().join("datasets/examples/search.toml").display().to_string();
    let store = format!("store={}", bench.path("searched").display());
    let refused = bench.magline(&["run", &search, "--set", &store, "--until", "scores"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("`--until` cannot be combined with a `[search]`"), "{}", stderr(&refused));
}

#[test]
fn user_a_run_past_its_time_limit_resumes_in_the_next_run() {
    // Number of points that this machine cannot compute in one second.
    let out_of_time = |points: &u32| {
        let bench = Bench::new();
        let lambdas: Vec<String> = (0..*points).map(|i| format!("{}", f64::from(i) * 1e-4)).collect();
        let sweep = format!("axes.lambda=[{}]", lambdas.join(","));
        let args = ["--set", &sweep, "--threads", "1", "--summary", "summary.json", "--max-time=1s"];
        (bench.run(&args).code == 4).then_some((bench, sweep, *points))
    };
    let (bench, sweep, points) = [50, 400, 3200].iter().find_map(out_of_time).unwrap();
    let args = ["--set", &sweep, "--threads", "1", "--summary", "summary.json"];
    let summary_file = summary(&bench);
    assert_eq!(summary_file["status"], "out_of_time");
    assert!(!bench.path("store/tables/small").exists(), "half a run is published");
    let whole = bench.run(&args);
    assert_eq!(whole.code, 0, "{}", whole.stderr);
    assert_eq!(whole.total("computed") + whole.total("reused"), u64::from(12 + points * (4 + 3 * 16)));
}

/// Samples by name and labels. Asserts that the lines `HELP` and `TYPE` of each metric precede the samples of the
/// metric.
fn metrics(path: &Path) -> BTreeMap<String, f64> {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.ends_with('\n'));
    let mut known = vec![];
    let mut samples = BTreeMap::new();
    for line in text.lines() {
        if let Some(rest) = line.strip_prefix("# TYPE ") {
            let (name, kind) = rest.split_once(' ').unwrap();
            assert_eq!(kind, "gauge");
            assert!(!known.contains(&name.to_owned()), "{name} twice");
            known.push(name.to_owned());
        } else if !line.starts_with("# HELP ") {
            let (sample, value) = line.rsplit_once(' ').unwrap();
            let (name, labels) = sample.split_once('{').unwrap();
            assert_eq!(known.last().unwrap(), name);
            assert!(labels.ends_with('}'));
            assert!(samples.insert(sample.to_owned(), value.parse().unwrap()).is_none(), "{sample} twice");
        }
    }
    samples
}

#[test]
fn user_metrics_describe_the_run_and_keep_the_last_success() {
    let bench = Bench::new();
    let done = bench.run(&["--metrics", "magline.prom"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let found = metrics(&bench.path("magline.prom"));
    for table in TABLES {
        let of = |outcome: &str| {
            found[&format!("magline_run_units{{pipeline=\"small\",table=\"{table}\",outcome=\"{outcome}\"}}")]
        };
        assert_eq!((of("computed"), of("reused"), of("failed")), (done.computed(table) as f64, 0.0, 0.0));
        let bytes: usize = bytes_of(&bench, table).values().map(Vec::len).sum();
        assert_eq!(found[&format!("magline_table_bytes{{pipeline=\"small\",table=\"{table}\"}}")], bytes as f64);
    }
    let of = |found: &BTreeMap<String, f64>, name: &str| found[&format!("{name}{{pipeline=\"small\"}}")];
    let success = of(&found, "magline_last_success_timestamp_seconds");
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs_f64();
    assert!((now - success).abs() < 600.0);
    write(&bench.path("flights/3.parquet"), &[changed(&line_of("3", "3.01", 500), "lat", |_, _| 95.0)]);
    assert_eq!(bench.run(&["--metrics", "magline.prom"]).code, 1);
    let failed = metrics(&bench.path("magline.prom"));
    assert_eq!(of(&failed, "magline_last_success_timestamp_seconds"), success);
    assert!(of(&failed, "magline_run_end_timestamp_seconds") > success);
    assert_eq!(of(&failed, "magline_run_exit_status"), 1.0);
    assert_eq!(failed["magline_run_units{pipeline=\"small\",table=\"even\",outcome=\"skipped\"}"], 1.0);
}

#[test]
fn user_a_watched_folder_uses_complete_files_and_reports_incomplete_ones() {
    let bench = Bench::new();
    let old = |name: &str| {
        let file = File::options().write(true).open(bench.path(name)).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(7200)).unwrap();
    };
    ["flights/1.parquet", "flights/2.parquet"].iter().for_each(|name| old(name));
    assert_eq!(bench.run(&["--settle", "1h"]).code, 0);
    // Names of unfinished files are ignored.
    let whole = bench.path("3.parquet");
    write(&whole, &[line_of("3", "3.02", 500)]);
    let bytes = fs::read(&whole).unwrap();
    let half = &bytes[..bytes.len() / 2];
    for name in [".3.parquet.Xy12", "_3.parquet", "3.parquet.part", "3.parquet.tmp", "3.parquet.filepart"] {
        fs::write(bench.path("flights").join(name), half).unwrap();
    }
    assert_eq!(bench.run(&[]).total("computed"), 0);
    // A truncated file has its final name: the run reports it, and the tables stay unchanged.
    let before = bench.tables("store");
    fs::write(bench.path("flights/3.parquet"), half).unwrap();
    let refused = bench.run(&[]);
    assert_eq!(refused.code, 2);
    assert!(
        refused.stderr.contains("flights/3.parquet: the file is not a complete Parquet file"),
        "{}",
        refused.stderr
    );
    assert!(bench.tables("store") == before);
    // With `--settle` the file is skipped and reported.
    let done = bench.run(&["--settle", "1h"]);
    assert_eq!((done.code, done.total("computed")), (0, 0), "{}", done.stderr);
    let notes = done.last["notes"].to_string();
    assert!(notes.contains("skipped by `--settle`") && notes.contains("flights/3.parquet"), "{notes}");
    // When the file is complete, the next run reads it and computes only the units of this file.
    fs::write(bench.path("flights/3.parquet"), &bytes).unwrap();
    old("flights/3.parquet");
    let done = bench.run(&["--settle", "1h"]);
    assert_eq!(TABLES.map(|t| done.computed(t)), [1, 2, 0, 8, 8, 8], "{}", done.stderr);
    let lines = texts(&read(&bench.path("store/tables/small/even")), "line");
    assert!(lines.contains(&"3.02".to_owned()));
    let none = bench.run(&["--settle", "1d"]);
    assert!(
        none.code == 2 && none.stderr.contains("was modified within the time given by `--settle`"),
        "{}",
        none.stderr
    );
}
