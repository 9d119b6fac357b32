//! The store: readable by every reader, complete at every moment, and without overhead.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use parquet::{
    basic::{Compression, Encoding},
    file::{metadata::ParquetMetaData, reader::FileReader, serialized_reader::SerializedFileReader},
};
use serde_json::Value;

use crate::support::{Bench, SPEC, line_of, numbers, read, stderr, stdout, texts, write};

fn ran() -> Bench {
    let bench = Bench::new();
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    bench
}

/// Files below `folder`.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = vec![];
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap().flatten() {
            if entry.path().is_dir() { folders.push(entry.path()) } else { found.push(entry.path()) }
        }
    }
    found.sort();
    found
}

fn query(bench: &Bench, store: &str, query: &str) -> Vec<Value> {
    let output = bench.magline(&["sql", query, "--store", store, "--format", "json"]);
    assert!(output.status.success(), "{query}: {}", stderr(&output));
    stdout(&output).lines().map(|l| serde_json::from_str(l).unwrap()).collect()
}

fn metadata(file: &Path) -> ParquetMetaData {
    SerializedFileReader::new(fs::File::open(file).unwrap()).unwrap().metadata().clone()
}

/// Number of rows that parquet-mr reads from a file in splits of `split` bytes. The reader assigns a row group to the
/// split that contains the middle of the row group's bytes. The middle is computed from the offset of the first chunk
/// and the sizes of all chunks.
fn rows_in_splits(file: &Path, split: i64) -> i64 {
    let metadata = metadata(file);
    let size = fs::metadata(file).unwrap().len() as i64;
    let mut rows = 0;
    for start in (0..size).step_by(split as usize) {
        for group in metadata.row_groups() {
            let first = group.column(0);
            let from =
                first.dictionary_page_offset().map_or(first.data_page_offset(), |d| d.min(first.data_page_offset()));
            let middle = from + group.compressed_size() / 2;
            if (start..start + split).contains(&middle) {
                rows += group.num_rows();
            }
        }
    }
    rows
}

#[test]
fn user_every_published_file_is_readable_by_the_strictest_reader() {
    let bench = ran();
    let mut seen = 0;
    for file in files(&bench.path("store/tables/small")) {
        let metadata = metadata(&file);
        let rows = metadata.file_metadata().num_rows();
        for split in [1 << 10, 100_000, 128 << 20] {
            assert_eq!(rows_in_splits(&file, split), rows, "{} in splits of {split}", file.display());
        }
        // Chunks do not overlap, and the chunks of a row group are contiguous.
        let mut end = 4;
        for group in metadata.row_groups() {
            for chunk in group.columns() {
                let (start, length) = chunk.byte_range();
                assert_eq!(start, end, "{}", file.display());
                end = start + length;
                let plain = |e| matches!(e, Encoding::PLAIN | Encoding::RLE | Encoding::RLE_DICTIONARY);
                assert!(chunk.encodings().all(plain), "{:?}", chunk.encodings().collect::<Vec<_>>());
                assert_eq!(chunk.compression(), Compression::SNAPPY);
            }
        }
        let metadata_of_file: BTreeMap<&str, &str> = metadata
            .file_metadata()
            .key_value_metadata()
            .unwrap()
            .iter()
            .filter_map(|kv| Some((kv.key.as_str(), kv.value.as_deref()?)))
            .collect();
        let reserved = ["failures", "warnings", "quality", "scores_pooled"]
            .iter()
            .any(|t| file.to_string_lossy().contains(&format!("/{t}/")));
        if !reserved {
            for key in ["stage", "stage_version", "spec_hash", "key", "units", "columns"] {
                assert!(metadata_of_file.contains_key(format!("magline.{key}").as_str()), "{key} {}", file.display());
            }
            let columns: Value = serde_json::from_str(metadata_of_file["magline.columns"]).unwrap();
            assert!(columns.as_object().unwrap().values().all(|c| c["role"].is_string() && c["unit"].is_string()));
        }
        seen += 1;
    }
    assert_eq!(seen, 10);
}

#[test]
fn user_a_table_holds_keys_and_new_columns_and_sql_adds_passthrough_columns() {
    let bench = Bench::new();
    bench.spec(&SPEC.replace("mag   = \"$mag\"\n", "mag   = \"$mag\"\ncarry = [\"lat\", \"mag_1_c\"]\n"));
    assert_eq!(bench.run(&[]).code, 0);
    let names = |table: &str| -> Vec<String> {
        let batch = read(&bench.path("store/tables/small").join(table)).remove(0);
        batch.schema().fields().iter().map(|f| f.name().clone()).collect()
    };
    assert_eq!(names("terms"), ["vector", "flight", "line", "tt", "tl"]);
    let made = ["mag_c", "mag_aircraft", "mag_sigma", "mag_fogm_sigma", "mag_fogm_tau", "mag_aircraft_sigma"];
    let clean: BTreeSet<String> = names("clean").into_iter().collect();
    let expected = ["mag", "vector", "lambda", "flight", "line", "tt", "lat", "mag_1_c"].iter().chain(&made);
    assert_eq!(clean, expected.map(|n| (*n).to_owned()).collect());
    // The logical table has all columns. Passthrough columns equal the columns of the source table.
    let sum = |table: &str, column: &str| {
        query(
            &bench,
            "store",
            &format!(
                "SELECT count(*) AS n, sum({column}) AS s, count({column}) AS c FROM small.{table} WHERE line = '1.01'"
            ),
        )
        .remove(0)
    };
    for column in ["lon", "flux_a_x", "mag_4_uc", "lat"] {
        let (even, clean) = (sum("even", column), sum("clean", column));
        assert_eq!(clean["n"].as_i64().unwrap(), 8 * even["n"].as_i64().unwrap());
        assert_eq!(clean["c"].as_i64().unwrap(), 8 * even["c"].as_i64().unwrap());
        let (one, eight) = (even["s"].as_f64().unwrap(), clean["s"].as_f64().unwrap());
        assert!((eight / (8.0 * one) - 1.0).abs() < 1e-12, "{column}: {one} {eight}");
    }
    let joined = "SELECT count(*) AS n FROM small.clean c JOIN small.even e ON c.flight = e.flight AND c.line = e.line \
                  AND c.tt = e.tt WHERE c.lon = e.lon AND c.lat = e.lat AND c.mag_4_uc = e.mag_4_uc";
    assert_eq!(query(&bench, "store", joined)[0]["n"], 19_200);
    // Units are excluded by their keys, and the answer is unchanged.
    let by_key = "SELECT count(*) AS n, avg(lon) AS lon FROM small.clean WHERE mag = 'mag_5_uc' AND lambda < 0.01 AND \
                  line = '2.02'";
    assert_eq!(query(&bench, "store", by_key)[0]["n"], 2 * 500);
}

/// Files of a store with inode and modification time, which reveal rewriting.
fn stamps(folder: &Path) -> BTreeMap<PathBuf, (u64, i64, i64)> {
    let stamp = |p: PathBuf| {
        let m = fs::metadata(&p).unwrap();
        (p, (m.ino(), m.mtime(), m.mtime_nsec()))
    };
    let parts = ["objects", "versions", "plans", "index"].map(|p| folder.join(p));
    parts.iter().flat_map(|p| if p.is_dir() { files(p) } else { vec![p.clone()] }).map(stamp).collect()
}

#[test]
fn user_an_unchanged_run_writes_only_its_history() {
    let bench = ran();
    let before = stamps(&bench.path("store"));
    let version = fs::read_link(bench.path("store/tables/small")).unwrap();
    let done = bench.run(&[]);
    assert_eq!((done.code, done.total("computed")), (0, 0));
    assert_eq!(fs::read_link(bench.path("store/tables/small")).unwrap(), version);
    assert!(stamps(&bench.path("store")) == before, "something was written again");
    let runs = stdout(&bench.magline(&["runs", "small", "--store", "store"]));
    assert_eq!(runs.lines().count(), 3, "{runs}");
    let same = bench.magline(&["runs", "small", "1", "2", "--store", "store"]);
    assert!(stdout(&same).contains("have the same spec and the same inputs"), "{}", stdout(&same));
}

#[test]
fn user_the_store_has_a_small_overhead() {
    let bench = ran();
    let mut seen = BTreeSet::new();
    let mut bytes = |part: &str| -> u64 {
        let all = files(&bench.path("store").join(part));
        let fresh = all.iter().map(|f| fs::metadata(f).unwrap()).filter(|m| seen.insert(m.ino()));
        fresh.map(|m| m.len()).sum()
    };
    let objects = bytes("objects");
    let rest: u64 = ["versions", "sources", "plans", "runs"].iter().map(|p| bytes(p)).sum();
    assert!(rest < objects / 2, "{rest} bytes beside {objects}");
    // 4 lines of 9 tables at 8 points: fewer files than units.
    assert!(files(&bench.path("store/objects")).len() < 12);
}

#[test]
fn user_a_thousand_points_require_at_most_256_open_files() {
    let bench = Bench::new();
    let lambdas: Vec<String> = (0..1000).map(|i| format!("{}", f64::from(i) * 1e-4)).collect();
    let spec = SPEC
        .replace("lambda = [0.0, 0.025]", &format!("lambda = [{}]", lambdas.join(", ")))
        .replace("[\"mag_4_uc\", \"mag_5_uc\"]", "[\"mag_4_uc\"]")
        .replace("[\"flux_a\", \"flux_d\"]", "[\"flux_a\"]");
    let (track, scores) = (spec.find("[[stages]]\nname            = \"track\"").unwrap(), "[\"clean\", \"track\"]");
    let end = spec[track..].find("[[stages]]\nname  = \"scores\"").unwrap() + track;
    bench.spec(&(spec[..track].to_owned() + &spec[end..].replace(scores, "[\"clean\"]")));
    let line = format!("ulimit -n 256; '{}' run spec.toml -q --threads 4", env!("CARGO_BIN_EXE_magline"));
    let output = Command::new("sh").args(["-c", &line]).current_dir(bench.folder.path()).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let counted = query(&bench, "store", "SELECT count(*) AS n, count(DISTINCT lambda) AS points FROM small.clean");
    assert_eq!((&counted[0]["n"], &counted[0]["points"]), (&2_400_000.into(), &1000.into()));
    assert!(files(&bench.path("store/objects")).len() < 100, "a file a point");
}

#[test]
fn user_runs_of_a_pipeline_exclude_each_other() {
    let bench = Bench::new();
    let start = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_magline"));
        command.args(["run", "spec.toml", "-q"]).args(args).current_dir(bench.folder.path());
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let held = fs::File::create({
        fs::create_dir_all(bench.path("store/locks")).unwrap();
        bench.path("store/locks/small.lock")
    })
    .unwrap();
    held.lock().unwrap();
    let refused = start(&[]).wait_with_output().unwrap();
    assert_eq!(refused.status.code(), Some(3));
    assert!(
        stderr(&refused).contains("another run of `small` holds the lock") && stderr(&refused).contains("--wait"),
        "{}",
        stderr(&refused)
    );
    let mut waits = start(&["--wait"]);
    sleep(Duration::from_millis(400));
    assert!(waits.try_wait().unwrap().is_none(), "it did not wait");
    held.unlock().unwrap();
    assert!(waits.wait().unwrap().success());
    // Several runs at once: each waits for the previous one, and the tables are those of one run.
    let all: Vec<_> =
        ["0.0", "0.5", "0.9"].iter().map(|l| start(&["--wait", "--set", &format!("axes.lambda=[{l}]")])).collect();
    for child in all {
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
    }
    let one = |table: &str| query(&bench, "store", &format!("SELECT DISTINCT lambda FROM small.{table}"));
    assert_eq!(one("clean").len(), 1);
    assert!(["coefficients", "track", "scores"].iter().all(|t| one(t) == one("clean")));
}

#[test]
fn user_tables_change_together_and_a_reader_keeps_its_snapshot() {
    let bench = ran();
    let folder = bench.path("store/tables/small").canonicalize().unwrap();
    let opened = read(&folder.join("scores"));
    fs::write(bench.path("store/tables/small/clean/notes.txt"), "mine").unwrap();
    fs::write(bench.path("store/tables/small/clean/mine.parquet"), "mine too").unwrap();
    let smaller = SPEC.replace("lambda = [0.0, 0.025]", "lambda = [0.5]");
    let smaller = smaller.replace("name  = \"scores\"", "name  = \"marks\"");
    bench.spec(&smaller);
    assert_eq!(bench.run(&[]).code, 0);
    // The previous version is unchanged. The new version has neither the removed stage nor other points.
    assert_eq!(texts(&read(&folder.join("scores")), "metric"), texts(&opened, "metric"));
    assert!(!bench.path("store/tables/small/scores").exists() && bench.path("store/tables/small/marks").is_dir());
    for file in ["notes.txt", "mine.parquet"] {
        assert!(bench.path("store/tables/small/clean").join(file).is_file(), "{file} is lost");
    }
    assert_eq!(
        query(&bench, "store", "SELECT DISTINCT lambda FROM small.clean"),
        [serde_json::json!({ "lambda": 0.5 })]
    );
    assert!(bench.magline(&["gc", "--store", "store"]).status.success());
    assert!(folder.join("scores").is_dir(), "a dry run removed something");
    let output = bench.magline(&["gc", "--store", "store", "--older-than", "1d", "--yes"]);
    assert!(output.status.success() && folder.join("scores").is_dir());
    let output = bench.magline(&["gc", "--store", "store", "--yes"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(!folder.join("scores").exists());
    // Foreign files stay, also in their original version.
    assert!(
        folder.join("clean/notes.txt").is_file() && stdout(&output).contains("magline did not write"),
        "{}",
        stdout(&output)
    );
    let again = bench.run(&[]);
    assert_eq!((again.code, again.total("computed")), (0, 0));
    bench.spec(SPEC);
    let back = bench.run(&[]);
    assert!(back.code == 0 && back.computed("clean") == 32, "{}", back.last);
}

#[test]
fn user_a_run_reports_the_bytes_that_gc_would_free() {
    let bench = Bench::of_many_lines();
    assert_eq!(bench.run(&[]).last["unused_bytes"], 0);
    let sizes =
        || files(&bench.path("store/objects")).iter().map(|file| fs::metadata(file).unwrap().len()).sum::<u64>();
    let before = sizes();
    // One of two axis values is replaced.
    let changed = ["--set", "axes.lambda=[0.0, 0.5]"];
    let output = bench.magline(&["run", "spec.toml", changed[0], changed[1]]);
    assert!(output.status.success(), "{}", stderr(&output));
    let written = sizes() - before;
    let unused = bench.run(&changed).last["unused_bytes"].as_u64().unwrap();
    assert!(unused > 1 << 20 && unused <= written, "{unused} of {written}");
    let note = format!("note: {:.1} MB of stored results are unreferenced; `magline gc --yes`", unused as f64 / 1e6);
    assert!(stderr(&output).contains(&note), "{note}: {}", stderr(&output));
    let before = sizes();
    assert!(bench.magline(&["gc", "--yes"]).status.success());
    assert_eq!(before - sizes(), unused);
    let output = bench.magline(&["run", "spec.toml", changed[0], changed[1]]);
    assert!(!stderr(&output).contains("results are unreferenced"), "{}", stderr(&output));
    assert_eq!(bench.run(&changed).last["unused_bytes"], 0);
}

#[test]
fn user_tables_are_listed_and_removed() {
    let bench = ran();
    let listed = stdout(&bench.magline(&["ls", "--store", "store"]));
    assert!(listed.lines().any(|l| l.split_whitespace().take(2).eq(["small.clean", "19200"])), "{listed}");
    assert_eq!(bench.magline(&["rm", "small.clearn", "--store", "store"]).status.code(), Some(2));
    assert!(bench.magline(&["rm", "small.clean", "--store", "store"]).status.success());
    assert!(!bench.path("store/tables/small/clean").exists() && bench.path("store/tables/small/scores").is_dir());
    let again = bench.run(&[]);
    assert_eq!((again.code, again.total("computed")), (0, 0));
    assert_eq!(numbers(&read(&bench.path("store/tables/small/clean")), "mag_c").len(), 19_200);
    assert!(bench.magline(&["rm", "small", "--store", "store"]).status.success());
    assert!(!bench.path("store/tables/small").exists());
    assert!(bench.magline(&["gc", "--store", "store", "--yes"]).status.success());
    assert_eq!(files(&bench.path("store/objects")).len(), 0);
    let first = bench.run(&[]);
    assert!(first.code == 0 && first.total("reused") == 0);
}

#[test]
fn user_results_are_kept_if_a_manifest_is_damaged() {
    let bench = ran();
    let list = bench.path("store/tables/small").canonicalize().unwrap().with_file_name("version.json");
    let text = fs::read_to_string(&list).unwrap();
    fs::write(&list, text.replacen("scores", "scorer", 1)).unwrap();
    let packs = files(&bench.path("store/objects")).len();
    let output = bench.magline(&["gc", "--store", "store", "--yes"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("the packs that it lists are unknown"), "{}", stderr(&output));
    assert_eq!(files(&bench.path("store/objects")).len(), packs);
    let again = bench.run(&[]);
    assert_eq!((again.code, again.total("computed")), (0, 0), "{}", again.stderr);
    assert!(bench.magline(&["gc", "--store", "store", "--yes"]).status.success());
    assert_eq!(files(&bench.path("store/objects")).len(), packs);
    let last = bench.run(&[]);
    assert_eq!((last.code, last.total("computed")), (0, 0), "{}", last.stderr);
}

#[test]
fn user_an_added_line_costs_only_its_own_bytes() {
    let bench = Bench::new();
    bench.spec(&SPEC.replace("line like '%.01'", "line = '1.01'"));
    for i in 0..60 {
        let name = format!("9{i:02}");
        write(&bench.path(&format!("flights/{name}.parquet")), &[line_of(&name, &format!("{name}.01"), 3000)]);
    }
    assert_eq!(bench.run(&["--set", "axes.lambda=[0.1]"]).code, 0);
    let before = stamps(&bench.path("store"));
    write(&bench.path("flights/990.parquet"), &[line_of("990", "990.01", 3000)]);
    let done = bench.run(&["--set", "axes.lambda=[0.1]"]);
    assert_eq!((done.code, done.computed("clean")), (0, 4), "{}", done.stderr);
    let packs = |s: &BTreeMap<PathBuf, (u64, i64, i64)>| -> BTreeMap<u64, u64> {
        let of = s.iter().filter(|(p, _)| p.to_string_lossy().contains("/objects/"));
        of.map(|(p, (inode, ..))| (*inode, fs::metadata(p).map_or(0, |m| m.len()))).collect()
    };
    let (old, new) = (packs(&before), packs(&stamps(&bench.path("store"))));
    let added: u64 = new.iter().filter(|(inode, _)| !old.contains_key(inode)).map(|(_, size)| size).sum();
    let all: u64 = old.values().sum();
    // The added line is one sixtieth of the rows; small tables are rewritten completely.
    assert!(added < all / 15, "{added} of {all} bytes");
    // After compaction the files equal those of a single run.
    let compact = bench.magline(&["compact", "spec.toml", "--set", "axes.lambda=[0.1]", "-q"]);
    assert!(compact.status.success(), "{}", stderr(&compact));
    assert_eq!(bench.run(&["--set", "axes.lambda=[0.1]", "--set", "store=\"whole\""]).code, 0);
    assert!(bench.tables("store") == bench.tables("whole"), "compacted tables differ from those of one run");
}

#[test]
fn user_failures_are_stored_and_not_retried() {
    let bench = Bench::new();
    write(&bench.path("flights/8.parquet"), &[line_of("8", "8.01", 8)]);
    let first = bench.run(&[]);
    assert_eq!(first.code, 1);
    let failures = texts(&read(&bench.path("store/tables/small/failures")), "error");
    assert!(!failures.is_empty());
    let version = fs::read_link(bench.path("store/tables/small")).unwrap();
    let again = bench.run(&[]);
    assert_eq!((again.code, again.total("computed"), again.total("failed")), (1, 0, first.total("failed")));
    assert_eq!(texts(&read(&bench.path("store/tables/small/failures")), "error"), failures);
    assert_eq!(fs::read_link(bench.path("store/tables/small")).unwrap(), version);
}

#[test]
fn user_queries_are_read_from_files_and_standard_input_and_end_at_max_rows() {
    let bench = ran();
    fs::write(bench.path("q.sql"), "SELECT count(*) AS n\nFROM small.clean").unwrap();
    let output = bench.magline(&["sql", "-f", "q.sql", "--format", "csv"]);
    assert_eq!(stdout(&output), "n\n19200\n");
    let line = format!("'{}' sql --format csv < q.sql", env!("CARGO_BIN_EXE_magline"));
    let output = Command::new("sh").args(["-c", &line]).current_dir(bench.folder.path()).output().unwrap();
    assert_eq!(stdout(&output), "n\n19200\n", "{}", stderr(&output));
    let output = bench.magline(&["sql", "SELECT tt FROM small.clean", "--format", "csv", "--max-rows", "3"]);
    assert_eq!(stdout(&output).lines().count(), 4);
    assert!(output.status.success() && stderr(&output).contains("more than 3 rows"), "{}", stderr(&output));
    let output = bench.magline(&["sql", "SELECT 1 AS one", "--format", "csv", "--max-rows", "3"]);
    assert_eq!((stdout(&output).as_str(), stderr(&output).as_str()), ("one\n1\n", ""));
}

#[test]
fn user_a_query_opens_only_its_own_tables() {
    let bench = ran();
    let started = Instant::now();
    // All other tables are unreadable, which does not affect the query.
    for table in ["even", "terms", "coefficients", "clean", "track"] {
        for file in files(&bench.path("store/versions/small/1/tables").join(table)) {
            fs::remove_file(&file).unwrap();
            fs::write(file, "no Parquet").unwrap();
        }
    }
    assert_eq!(query(&bench, "store", "SELECT count(DISTINCT mag) AS n FROM small.scores")[0]["n"], 2);
    let broken = bench.magline(&["sql", "SELECT count(mag_c) FROM small.clean"]);
    assert_eq!(broken.status.code(), Some(1));
    assert!(stderr(&broken).contains("run the spec again"), "{}", stderr(&broken));
    assert!(started.elapsed() < Duration::from_secs(20));
    let repaired = bench.run(&[]);
    assert_eq!((repaired.code, repaired.total("computed")), (0, 0));
    assert_eq!(query(&bench, "store", "SELECT count(mag_c) AS n FROM small.clean")[0]["n"], 19_200);
}

#[test]
fn user_unkept_tables_are_recomputed_with_the_same_results() {
    let bench = ran();
    let even = "input   = \"flights\"\nrate_hz = 10.0\n";
    let spec = SPEC.replace(even, &format!("{even}publish = false\nkeep = false\n"));
    bench.spec(&spec.replace(
        "input  = \"even\"\nvector = \"$vector\"\n",
        "input  = \"even\"\nvector = \"$vector\"\npublish = false\nkeep = false\n",
    ));
    let done = bench.run(&["--set", "store=lean"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    for (table, column) in [("clean", "mag_c"), ("track", "lat"), ("scores", "value"), ("coefficients", "value")] {
        let [all, lean] =
            ["store", "lean"].map(|s| numbers(&read(&bench.path(s).join("tables/small").join(table)), column));
        assert_eq!(
            all.iter().map(|x| x.to_bits()).collect::<Vec<_>>(),
            lean.iter().map(|x| x.to_bits()).collect::<Vec<_>>(),
            "{table}"
        );
    }
    assert!(!bench.path("lean/tables/small/even").exists());
    // Passthrough columns of these tables can still be queried.
    let sum = |store: &str| {
        query(&bench, store, "SELECT sum(mag_4_uc) AS s, count(lon) AS n FROM small.clean WHERE flight = '2'")
    };
    let (all, lean) = (sum("store"), sum("lean"));
    assert_eq!(all[0]["n"], lean[0]["n"]);
    assert!((all[0]["s"].as_f64().unwrap() / lean[0]["s"].as_f64().unwrap() - 1.0).abs() < 1e-12, "{all:?} {lean:?}");
    let again = bench.run(&["--set", "store=lean"]);
    assert_eq!((again.code, again.total("computed")), (0, 0));
}
