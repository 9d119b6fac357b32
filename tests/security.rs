//! Limits of what strangers can do by files, specs, stores, sets and queries. `SECURITY.md` names each test.

use std::{
    fs,
    os::unix::fs::{FileTypeExt, PermissionsExt, symlink},
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    thread::sleep,
    time::{Duration, Instant, SystemTime},
};

use crate::support::{Bench, SPEC, line_of, stderr, stdout, write};

const FACTS: &str = r#"
[publish]
title       = "Small flights"
description = "Two simulated flights."
licence     = "CC-BY-4.0"
date        = "2026-11-23"
contact     = "data@example.org"
[[publish.authors]]
name = "A"
"#;

/// A spec over the flights of a bench, of which `mag_1_c` is restricted, with these stages.
fn restricted(more: &str, axes: &str, stages: &str) -> String {
    format!(
        "name = \"small\"\nseed = 1\nstore = \"store\"\n[tables.flights]\npath = \"flights/\"\nrestricted = [\"mag_1_c\"]\n\
         reason = \"the agreement\"\n{more}\n[axes]\n{axes}\n{stages}\n{FACTS}"
    )
}

fn publish(bench: &Bench, tables: &[&str], to: &str) -> Output {
    let args = [&["publish", "spec.toml"], tables, &["--to", to]].concat();
    bench.magline(&args)
}

/// The output of publishing the table of a spec, and whether it was refused.
fn asked(spec: &str, tables: &[&str]) -> (bool, String) {
    let bench = Bench::new();
    bench.spec(spec);
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let output = publish(&bench, tables, "set");
    let said = stdout(&output) + &stderr(&output);
    let refused = output.status.code() == Some(2);
    assert!(refused || output.status.success(), "{said}");
    assert_eq!(refused, !bench.path("set").exists());
    (refused, said)
}

fn refused(spec: &str, tables: &[&str], why: &str) {
    let (refused, said) = asked(spec, tables);
    assert!(refused && said.contains(why) && said.contains("the agreement"), "{why}: {said}");
}

const SCORE: &str = "[[stages]]\nname=\"z\"\nstage=\"derive\"\ninput=\"pick\"\ncolumns={ zero = \"0.0 * mag_4_uc\" }\n\
    [[stages]]\nname=\"sc\"\nstage=\"score\"\ninput=\"z\"\nmag=\"zero\"\ntruth=\"mag_1_c\"\nmetrics=[\"bias_error\"]\n";

fn resampled(rate_hz: f64) -> String {
    format!(
        "[[stages]]\nname=\"pick\"\nstage=\"resample\"\ninput=\"flights\"\nrate_hz={rate_hz}\nmax_gap_s=100.0\n{SCORE}"
    )
}

#[test]
fn user_a_score_of_few_samples_is_no_aggregate() {
    // 60 s of samples: 600 at 10 Hz, 6 at 0.1 Hz.
    let (held, said) = asked(&restricted("", "", &resampled(10.0)), &["sc"]);
    assert!(!held && said.contains("sc: ") && said.contains("samples or more behind each value"), "{said}");
    refused(&restricted("", "", &resampled(0.1)), &["sc"], "`least_samples` is 100");
    refused(&restricted("least_samples = 1000", "", &resampled(10.0)), &["sc"], "`least_samples` is 1000");
    refused(&restricted("least_ratio = 1000", "", &resampled(10.0)), &["sc"], "`least_ratio` is 1000");
    // 60 coefficients of 600 samples, and of 60.
    let fit = |rate: f64| {
        let pick = format!("[[stages]]\nname=\"pick\"\nstage=\"resample\"\ninput=\"flights\"\nrate_hz={rate}\n");
        pick + "[[stages]]\nname=\"tl\"\nstage=\"a_matrix\"\ninput=\"pick\"\nvector=\"flux_d\"\n\
            [[stages]]\nname=\"model\"\nstage=\"fit\"\ninput=\"tl\"\nwhere=\"line='1.01'\"\nmodel=\"tolles_lawson\"\n\
            target=\"mag_1_c\"\nlow_hz=0.01\nhigh_hz=0.4\ntrim=1\n"
    };
    refused(&restricted("", "", &fit(2.0)), &["model"], "`least_ratio` is 10");
    assert!(!asked(&restricted("", "", &fit(10.0)), &["model"]).0);
}

#[test]
fn user_expressions_that_choose_samples_make_no_aggregate() {
    let rows = "[[stages]]\nname=\"pick\"\nstage=\"select\"\ninput=\"flights\"\nrows=\"$rows\"\n";
    let axis = "rows = [\"tt > 0\", \"tt > 0.15\"]";
    refused(&restricted("", axis, &format!("{rows}{SCORE}")), &["sc"], "an expression of `pick`");
    let weighed = "[[stages]]\nname=\"pick\"\nstage=\"derive\"\ninput=\"flights\"\n\
        columns={ one = \"case when tt < 0.05 then mag_1_c else 0.0 end\" }\nunits={ one = \"nT\" }\n\
        [[stages]]\nname=\"sc\"\nstage=\"score\"\ninput=\"pick\"\nmag=\"one\"\ntruth=\"mag_4_uc\"\nmetrics=[\"bias_error\"]\n";
    refused(&restricted("", "", weighed), &["sc"], "an expression of `pick`");
    let fitted = "[[stages]]\nname=\"model\"\nstage=\"fit\"\ninput=\"flights\"\nwhere=\"line='1.01' and tt > 1\"\nmodel=\"ridge\"\n\
        target=\"mag_1_c\"\nfeatures=[\"mag_4_uc\"]\n";
    refused(&restricted("", "", fitted), &["model"], "`where` of `model`");
    // Sums with constant factors neither choose nor weigh.
    let sums = "[[stages]]\nname=\"pick\"\nstage=\"derive\"\ninput=\"flights\"\ncolumns={ d = \"0.5 * (mag_4_uc - mag_1_c)\" }\n\
        [[stages]]\nname=\"sc\"\nstage=\"score\"\ninput=\"pick\"\nmag=\"mag_4_uc\"\ntruth=\"mag_1_c\"\nmetrics=[\"std_error\"]\n";
    assert!(!asked(&restricted("", "", sums), &["sc"]).0);
}

#[test]
fn user_a_model_that_memorises_is_no_aggregate() {
    let fit = |model: &str| {
        format!(
            "[[stages]]\nname=\"net\"\nstage=\"fit\"\ninput=\"flights\"\nwhere=\"line='1.01'\"\nmodel=\"{model}\"\ntarget=\"mag_1_c\"\n\
             features=[\"tt\"]\n[[stages]]\nname=\"cl\"\nstage=\"compensate\"\ninput=\"flights\"\nmodel=\"net\"\nmag=\"mag_4_uc\"\n"
        )
    };
    for model in ["random_features", "boosted_trees"] {
        let spec = restricted("", "", &fit(model));
        refused(&spec, &["net"], "can hold single samples");
        refused(&spec, &["cl"], "can hold single samples");
    }
}

#[test]
fn user_aggregates_that_differ_by_few_samples_are_refused() {
    let fit = "[[stages]]\nname=\"model\"\nstage=\"fit\"\ninput=\"flights\"\nwhere=\"line='1.01'\"\nmodel=\"ridge\"\ntarget=\"mag_1_c\"\n\
        features=[\"mag_4_uc\"]\ntrim=\"$trim\"\n";
    refused(&restricted("", "trim = [20, 21]", fit), &["model"], "differ by fewer than 100");
    assert!(!asked(&restricted("", "trim = [20, 80]", fit), &["model"]).0, "120 samples");
}

#[test]
fn user_a_restriction_cannot_be_dropped_on_the_command_line() {
    let bench = Bench::new();
    bench.spec(&restricted("", "", &resampled(0.1)));
    for set in [
        "tables.flights.restricted=[]",
        "tables.flights.restricted=false",
        "tables.\"flights\".\"restricted\"=[]",
        "tables.flights.embargo=2020-01-01",
        "tables.flights.reason=none",
        "tables.flights.least_samples=2",
        "tables.flights={path=\"flights/\"}",
    ] {
        let output = bench.magline(&["check", "spec.toml", "--set", set]);
        assert_eq!(output.status.code(), Some(2), "{set}: {}", stdout(&output));
        assert!(stderr(&output).contains("`--set` cannot"), "{set}: {}", stderr(&output));
    }
}

#[test]
fn user_a_restriction_that_a_spec_has_dropped_is_noted() {
    let bench = Bench::new();
    let spec = restricted("", "", &resampled(10.0));
    bench.spec(&spec);
    assert_eq!(bench.run(&[]).code, 0);
    // Under another name of the table and of the pipeline, too.
    let dropped = spec.replace("restricted = [\"mag_1_c\"]\nreason = \"the agreement\"", "");
    let dropped = dropped.replace("\"small\"", "\"other\"").replace("tables.flights", "tables.copies");
    bench.spec(&dropped.replace("input=\"flights\"", "input=\"copies\""));
    assert_eq!(bench.run(&[]).code, 0);
    let output = publish(&bench, &["sc"], "set");
    assert!(stderr(&output).contains("recorded copies.mag_1_c as restricted"), "{}", stderr(&output));
}

#[test]
fn user_only_a_file_in_the_folder_of_the_spec_is_published_as_licence() {
    let bench = Bench::new();
    fs::write(bench.path("secret"), "secret").unwrap();
    fs::create_dir(bench.path("sub")).unwrap();
    symlink(bench.path("secret"), bench.path("sub/linked.txt")).unwrap();
    fs::write(bench.path("sub/LICENCE"), "The text.").unwrap();
    let spec = |file: &str| SPEC.to_owned() + &FACTS.replace("date ", &format!("licence_file = \"{file}\"\ndate "));
    let sub = spec("LICENCE").replace("flights/", "../flights/").replace("map.parquet", "../map.parquet");
    fs::write(bench.path("sub/spec.toml"), &sub).unwrap();
    assert!(bench.magline(&["run", "sub/spec.toml", "-q"]).status.success());
    for file in ["../secret", "linked.txt", "/etc/hostname", "/dev/zero", "./LICENCE"] {
        fs::write(bench.path("sub/spec.toml"), sub.replace("\"LICENCE\"", &format!("\"{file}\""))).unwrap();
        let output = bench.magline(&["publish", "sub/spec.toml", "scores", "--to", "set"]);
        assert_eq!(output.status.code(), Some(2), "{file}: {}", stderr(&output));
        assert!(stderr(&output).contains("`licence_file`") && !bench.path("set").exists(), "{file}");
    }
    fs::write(bench.path("sub/spec.toml"), &sub).unwrap();
    let output = bench.magline(&["publish", "sub/spec.toml", "scores", "--to", "set"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(fs::read_to_string(bench.path("set/LICENSE")).unwrap(), "The text.");
}

fn ran() -> Bench {
    let bench = Bench::new();
    bench.spec(&(SPEC.to_owned() + FACTS));
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    bench
}

#[test]
fn user_names_of_the_command_line_stay_in_the_store() {
    let bench = ran();
    let victim = bench.path("Cargo");
    for suffix in ["lock", "jsonl", "json"] {
        fs::write(victim.with_extension(suffix), "{\"a\":1}").unwrap();
    }
    let outside = victim.display().to_string();
    for name in [outside.as_str(), "../../Cargo", "..", ".", "a/b", "CON", "small\0x", "small/../small", ""] {
        if name.contains('\0') {
            continue;
        }
        for command in
            [&["rm", name][..], &["ls", name], &["runs", name], &["runs", name, "1", "2"], &["lineage", name]]
        {
            let output = bench.magline(command);
            assert_ne!(output.status.code(), Some(0), "{command:?}: {}", stdout(&output));
            assert_ne!(output.status.code(), Some(101), "{command:?}: {}", stderr(&output));
        }
    }
    for suffix in ["lock", "jsonl", "json"] {
        assert_eq!(fs::read_to_string(victim.with_extension(suffix)).unwrap(), "{\"a\":1}", "{suffix}");
    }
    assert!(bench.magline(&["ls", "small"]).status.success());
}

#[test]
fn user_a_spec_from_elsewhere_does_not_replace_tables() {
    let bench = ran();
    let before = bench.tables("store");
    let store = bench.path("store");
    let evil = format!(
        "name = \"small\"\nstore = \"{}\"\n[tables.flights]\npath = \"../flights/\"\n[[stages]]\nname = \"scores\"\nstage = \"derive\"\n\
         input = \"flights\"\ncolumns = {{ x = \"mag_4_uc\" }}\n",
        store.display()
    );
    fs::create_dir(bench.path("from")).unwrap();
    symlink(&store, bench.path("from/linked")).unwrap();
    for text in [
        evil.clone(),
        evil.replace(&store.display().to_string(), "../store"),
        evil.replace(&store.display().to_string(), "linked"),
    ] {
        fs::write(bench.path("from/evil.toml"), text).unwrap();
        let output = bench.magline(&["run", "from/evil.toml", "-q"]);
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        assert!(
            stderr(&output).contains("`--take-over`") && stderr(&output).contains("spec.toml"),
            "{}",
            stderr(&output)
        );
        assert_eq!(bench.tables("store"), before);
    }
    // The spec that made it may run, and another name in the same store.
    assert_eq!(bench.run(&[]).code, 0);
    fs::write(bench.path("from/other.toml"), evil.replace("\"small\"", "\"other\"")).unwrap();
    assert!(bench.magline(&["run", "from/other.toml", "-q"]).status.success());
    let output = bench.magline(&["run", "from/evil.toml", "-q", "--take-over"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_ne!(bench.tables("store"), before);
}

#[test]
fn user_a_lease_from_the_future_holds_nothing() {
    let bench = ran();
    let lease = |number: &str, seconds: u64| {
        let file = bench.path("store/locks").join(format!("small.lease-{number}"));
        let text = "{\"host\":\"other\",\"boot\":\"1\",\"pid\":1,\"since\":\"2026-11-25T13:22:43Z\",\"free\":false}\n";
        fs::write(&file, text).unwrap();
        let time = SystemTime::now() + Duration::from_secs(seconds);
        fs::File::options().append(true).open(&file).unwrap().set_modified(time).unwrap();
        file
    };
    lease("50", 3600);
    assert_eq!(bench.run(&[]).code, 0);
    for number in ["18446744073709551615", "18446744073709551614", "99999999999999999999999"] {
        let file = lease(number, 0);
        assert_eq!(bench.run(&[]).code, 0, "{number}");
        fs::remove_file(file).unwrap();
    }
}

#[test]
fn user_expressions_of_a_spec_cannot_fill_the_memory() {
    let bench = Bench::new();
    for expression in [
        "length(repeat('a', 2000000000)) + mag_4_uc",
        "length(repeat(arrow_cast(mag_4_uc,'Utf8'), 1000000)) + mag_4_uc",
        "array_length(generate_series(0, 3000000000)) + mag_4_uc",
        "length(lpad('a', 2000000000, 'b')) + mag_4_uc",
    ] {
        bench.spec(&format!(
            "name=\"ex\"\nstore=\"store\"\n[tables.flights]\npath=\"flights/\"\n[[stages]]\nname=\"d\"\nstage=\"derive\"\n\
             input=\"flights\"\ncolumns={{ z = \"{expression}\" }}\nunits={{ z = \"nT\" }}\n"
        ));
        let output = bench.magline(&["run", "spec.toml", "-q"]);
        assert_eq!(output.status.code(), Some(2), "{expression}: {}", stderr(&output));
        assert!(stderr(&output).contains("too large for memory"), "{expression}: {}", stderr(&output));
    }
}

/// The children of a process, with itself.
#[cfg(target_os = "linux")]
fn family(process: u32) -> Vec<u32> {
    let children = fs::read_to_string(format!("/proc/{process}/task/{process}/children")).unwrap_or_default();
    std::iter::once(process).chain(children.split_whitespace().filter_map(|n| n.parse().ok())).collect()
}

/// The peak of the memory of a query with its process, MB, and its end.
#[cfg(target_os = "linux")]
fn peak_mb(bench: &Bench, query: &str, limit: &str) -> (u64, Output) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_magline"))
        .args(["sql", query, "--memory-limit", limit, "--format", "csv"])
        .current_dir(bench.folder.path())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut peak = 0;
    while child.try_wait().unwrap().is_none() {
        for process in family(child.id()) {
            let text = fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
            let used =
                text.lines().find_map(|l| l.strip_prefix("RssAnon:")?.trim().trim_end_matches(" kB").parse().ok());
            peak = peak.max(used.unwrap_or(0));
        }
        sleep(Duration::from_millis(2));
    }
    (peak / 1000, child.wait_with_output().unwrap())
}

#[test]
#[cfg(target_os = "linux")]
fn user_queries_keep_to_their_memory_in_all_operators() {
    let bench = ran();
    for query in [
        "SELECT length(repeat('a', 2000000000))",
        "SELECT length(repeat('a', 1000000000000000))",
        "SELECT length(lpad('a', 2000000000, 'bc'))",
        "SELECT sum(value) OVER (ORDER BY value ROWS BETWEEN UNBOUNDED PRECEDING AND UNBOUNDED FOLLOWING) FROM generate_series(1,300000000)",
        "SELECT count(distinct repeat('a', 1000000) || value) FROM generate_series(1,100000)",
        "SELECT array_length(generate_series(1, 1000000000))",
        "SELECT length(string_agg(repeat('a', 100000), '')) FROM generate_series(1,100000)",
    ] {
        let (peak, output) = peak_mb(&bench, query, "64MB");
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{query}: {said}");
        assert!(said.contains("error: "), "{query}: {said}");
        assert!(!said.contains("panicked"), "{query}: {said}");
        assert!(peak < 700, "{query}: {peak} MB");
    }
    let output = bench.magline(&["sql", "SELECT 1 AS x", "--format", "csv"]);
    assert_eq!(stdout(&output), "x\n1\n");
}

#[test]
#[cfg(target_os = "linux")]
fn user_spilled_rows_are_removed_after_a_kill() {
    let bench = ran();
    let temporary = bench.path("temporary");
    fs::create_dir(&temporary).unwrap();
    let query = "SELECT a.tt FROM small.even a CROSS JOIN small.even b CROSS JOIN small.even c ORDER BY a.tt * b.tt";
    let mut child = Command::new(env!("CARGO_BIN_EXE_magline"))
        .args(["sql", query, "--memory-limit", "64MB", "--format", "csv"])
        .current_dir(bench.folder.path())
        .env("TMPDIR", &temporary)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let folders = || -> Vec<PathBuf> {
        let all =
            |folder: &Path| fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).collect::<Vec<_>>();
        all(&temporary).iter().flat_map(|base| all(base)).collect()
    };
    let begun = Instant::now();
    while folders().is_empty() && begun.elapsed() < Duration::from_secs(20) {
        sleep(Duration::from_millis(5));
    }
    let own = family(child.id());
    for folder in fs::read_dir(&temporary).unwrap().flatten() {
        assert_eq!(folder.metadata().unwrap().permissions().mode() & 0o777, 0o700);
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!folders().is_empty(), "a kill leaves its folder");
    let begun = Instant::now();
    let lives = |process: &u32| Path::new(&format!("/proc/{process}")).exists();
    while own.iter().any(lives) && begun.elapsed() < Duration::from_secs(10) {
        sleep(Duration::from_millis(10));
    }
    assert!(!own.iter().any(lives), "the process of the query ends with it");
    let output = Command::new(env!("CARGO_BIN_EXE_magline"))
        .args(["sql", "SELECT 1"])
        .current_dir(bench.folder.path())
        .env("TMPDIR", &temporary)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(folders(), Vec::<PathBuf>::new());
}

#[test]
fn user_no_output_passes_control_characters_of_names_to_the_terminal() {
    let bench = Bench::new();
    fs::remove_dir_all(bench.path("flights")).unwrap();
    fs::create_dir(bench.path("flights")).unwrap();
    let hostile = "1\u{1b}[2J\u{7}\r\u{9b}31m\u{202e}x";
    write(&bench.path("flights/1.parquet"), &[line_of("1", hostile, 600), line_of("1", "1.02", 600)]);
    bench.spec(&(SPEC.replace("line like '%.01'", "line <> 'x'") + FACTS));
    let file = format!("{hostile}.toml");
    fs::write(bench.path(&file), "name = 7\n[x]\n").unwrap();
    let check = |what: &[&str], output: Output| {
        for text in [stdout(&output), stderr(&output)] {
            let bad = |c: char| c.is_control() && c != '\n' && c != '\t' || ('\u{202a}'..='\u{202e}').contains(&c);
            assert!(!text.contains(bad), "{what:?}: {text:?}");
        }
    };
    for command in [
        &["run", "spec.toml"][..],
        &["run", "spec.toml", "--json"],
        &["explain", "spec.toml"],
        &["explain", "spec.toml", "--cost"],
        &["why", "spec.toml", "scores"],
        &["ls"],
        &["ls", hostile],
        &["runs"],
        &["runs", hostile],
        &["lineage", "small.scores"],
        &["lineage", "small.scores", "--format", "json"],
        &["lineage", hostile],
        &["sql", "SELECT * FROM small.scores"],
        &["sql", "SELECT line AS \"a\u{1b}[31mb\" FROM small.scores"],
        &["sql", "SELECT \"\u{1b}[31m\" FROM small.scores"],
        &["publish", "spec.toml", "scores", "--to", hostile],
        &["verify", hostile],
        &["rm", hostile],
        &["gc"],
        &["check", &file],
        &["check", "spec.toml", "--set", "seed=\u{1b}[31m"],
        &["run", hostile],
        &[hostile],
        &["ls", "--\u{1b}[31m"],
        &["ingest", "flights", "--to", "out"],
    ] {
        check(command, bench.magline(command));
    }
    // A file, and a pipe in a form for programs, get the bytes.
    let output = bench.magline(&["sql", "SELECT DISTINCT line FROM small.scores ORDER BY line", "--format", "csv"]);
    assert!(stdout(&output).contains(hostile), "{:?}", stdout(&output));
}

#[test]
fn user_sets_with_special_files_verify_at_once() {
    let bench = ran();
    assert!(publish(&bench, &["scores", "coefficients"], "set").status.success());
    let files = ["data/scores/part-0.parquet", "README.md", "SHA256SUMS", "dictionary.json", "pipeline/lock.json"];
    let pipe = |at: &Path| assert!(Command::new("mkfifo").arg(at).status().unwrap().success());
    let device = |at: &Path| symlink("/dev/zero", at).unwrap();
    let sparse = |at: &Path| fs::File::create(at).unwrap().set_len(1 << 40).unwrap();
    let socket = |at: &Path| drop(std::os::unix::net::UnixListener::bind(at).unwrap());
    type Make = dyn Fn(&Path);
    let kinds: [(&str, &Make); 4] = [("pipe", &pipe), ("device", &device), ("sparse", &sparse), ("socket", &socket)];
    for (kind, make) in kinds {
        for file in files {
            let copy = bench.path("copy");
            let copied = Command::new("cp").args(["-r", "set", "copy"]).current_dir(bench.folder.path()).status();
            assert!(copied.unwrap().success());
            fs::remove_file(copy.join(file)).unwrap();
            // The name of a socket is limited to 108 bytes.
            if kind == "socket" && copy.join(file).as_os_str().len() > 100 {
                fs::remove_dir_all(&copy).unwrap();
                continue;
            }
            make(&copy.join(file));
            let begun = Instant::now();
            let output = Command::new("timeout")
                .args(["20", env!("CARGO_BIN_EXE_magline"), "verify", "copy"])
                .current_dir(bench.folder.path())
                .output()
                .unwrap();
            assert!(begun.elapsed() < Duration::from_secs(10), "{kind} {file}");
            assert_eq!(output.status.code(), Some(1), "{kind} {file}: {}", stderr(&output));
            assert!(stderr(&output).contains(file), "{kind} {file}: {}", stderr(&output));
            fs::remove_dir_all(&copy).unwrap();
        }
    }
}

#[test]
fn user_each_damaged_file_of_a_store_is_named() {
    let bench = ran();
    let verify = || bench.magline(&["verify", "--store", "store"]);
    assert!(verify().status.success(), "{}", stderr(&verify()));
    let mut files = vec![];
    let mut waiting = vec![bench.path("store")];
    while let Some(folder) = waiting.pop() {
        for entry in fs::read_dir(folder).unwrap().flatten() {
            let kind = entry.file_type().unwrap();
            if kind.is_dir() {
                waiting.push(entry.path());
            } else if kind.is_file() && entry.metadata().unwrap().len() > 0 {
                files.push(entry.path());
            }
        }
    }
    for part in ["STORE", "index", "objects", "sources", "quality", "versions", "plans", "runs", "costs", "locks"] {
        assert!(files.iter().any(|f| f.starts_with(bench.path("store").join(part))), "{part}");
    }
    files.sort();
    // Packs have more names: each is damaged by one of them.
    files.retain(|f| !f.starts_with(bench.path("store/versions")) || !f.to_string_lossy().contains("part-"));
    for (i, file) in files.iter().enumerate() {
        let whole = fs::read(file).unwrap();
        let modified = fs::metadata(file).unwrap().modified().unwrap();
        let mut damaged = whole.clone();
        let at = (i * 7919 + 13) % whole.len();
        damaged[at] ^= 1 << (i % 7);
        let put = |bytes: &[u8]| {
            // Packs are linked under several names, so that their bytes are changed in place.
            fs::write(file, bytes).unwrap();
            fs::File::options().append(true).open(file).unwrap().set_modified(modified).unwrap();
        };
        put(&damaged);
        let output = verify();
        assert_eq!(output.status.code(), Some(1), "{} byte {at}: {}", file.display(), stdout(&output));
        // What was set aside or written anew is put back.
        fs::remove_file(file).ok();
        let aside = bench.path("store/damaged").join(file.file_name().unwrap());
        if aside.exists() {
            fs::rename(&aside, file).unwrap();
        }
        put(&whole);
    }
    assert!(verify().status.success(), "{}", stderr(&verify()));
    fs::remove_file(bench.path("store/locks/small.lock")).unwrap();
    assert!(Command::new("mkfifo").arg(bench.path("store/locks/small.lock")).status().unwrap().success());
    assert!(fs::metadata(bench.path("store/locks/small.lock")).unwrap().file_type().is_fifo());
    assert_eq!(verify().status.code(), Some(1));
}

/// The hash of a note, as a store spells it.
fn sum(parts: &[u8]) -> String {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&(parts.len() as u64).to_le_bytes());
    hasher.update(parts);
    hasher.finalize().as_bytes()[..16].iter().map(|b| format!("{b:02x}")).collect()
}

#[test]
fn user_a_manifest_cannot_name_files_elsewhere() {
    let bench = ran();
    let secret = bench.path("secret");
    assert!(
        Command::new("cp").args(["-a", "store", "secret"]).current_dir(bench.folder.path()).status().unwrap().success()
    );
    let file = bench.path("store/versions/small/1/version.json");
    let text = fs::read_to_string(&file).unwrap();
    let signed = |text: &str| {
        let at = text.rfind("\"sum\":\"").unwrap() + 7;
        let bare = format!("{}{}", &text[..at], &text[at + 32..]);
        format!("{}{}{}", &text[..at], sum(bare.as_bytes()), &text[at + 32..])
    };
    assert_eq!(signed(&text), text, "the checksum of this test is that of the store");
    let read = || bench.magline(&["sql", "SELECT count(*) FROM small.scores", "--format", "csv"]);
    assert!(read().status.success());
    let at = text.find("tables/scores/").unwrap();
    let name = &text[at..at + text[at..].find('"').unwrap()];
    let other = fs::read_dir(secret.join("tables/small/coefficients")).unwrap().flatten().next().unwrap().path();
    let elsewhere = other.display().to_string();
    let up = format!("../../../../secret/tables/small/coefficients/{}", other.file_name().unwrap().to_string_lossy());
    for wrong in [
        elsewhere.as_str(),
        up.as_str(),
        "tables/scores/../../../../../../secret/STORE",
        "STORE",
        "tables/scores/a\\\\b",
    ] {
        fs::write(&file, signed(&text.replace(name, wrong))).unwrap();
        assert_ne!(read().status.code(), Some(0), "{wrong}: {}", stdout(&read()));
        assert_eq!(bench.magline(&["verify", "--store", "store"]).status.code(), Some(1), "{wrong}");
    }
    for wrong in ["../../x", "/tmp/x", "CON", "a b"] {
        fs::write(&file, signed(&text.replace("\"name\":\"scores\"", &format!("\"name\":\"{wrong}\"")))).unwrap();
        assert_ne!(read().status.code(), Some(0), "{wrong}: {}", stdout(&read()));
        assert!(bench.magline(&["ls"]).status.code() != Some(101), "{wrong}");
    }
    fs::write(&file, &text).unwrap();
    assert!(read().status.success());
    // Links in place of a file, a table's folder and a version.
    for part in [name, "tables/scores", ""] {
        let at = bench.path("store/versions/small/1").join(part);
        let at = PathBuf::from(at.to_string_lossy().trim_end_matches('/').to_owned());
        let aside = bench.path("aside");
        fs::rename(&at, &aside).unwrap();
        symlink(&aside, &at).unwrap();
        assert_ne!(read().status.code(), Some(0), "{part}: {}", stdout(&read()));
        fs::remove_file(&at).unwrap();
        fs::rename(&aside, &at).unwrap();
    }
    assert!(read().status.success());
}

#[test]
fn user_a_file_size_limit_is_an_error_and_no_silent_end() {
    let bench = Bench::new();
    bench.spec(SPEC);
    let run = format!("ulimit -f 20; exec '{}' run spec.toml -q", env!("CARGO_BIN_EXE_magline"));
    let output = Command::new("sh").args(["-c", &run]).current_dir(bench.folder.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{:?} {}", output.status, stderr(&output));
    assert!(stderr(&output).contains("File too large"), "{}", stderr(&output));
}

#[test]
fn user_a_store_that_cannot_be_written_is_listed_queried_and_verified() {
    let bench = ran();
    // As root, permissions do not count: a folder that is a file cannot be made either.
    fs::remove_dir_all(bench.path("store/tmp")).unwrap();
    fs::write(bench.path("store/tmp"), "").unwrap();
    for command in [
        &["ls"][..],
        &["runs"],
        &["sql", "SELECT count(*) FROM small.scores"],
        &["lineage", "small.scores"],
        &["verify"],
    ] {
        let output = bench.magline(command);
        assert!(output.status.success(), "{command:?}: {}", stderr(&output));
    }
}
