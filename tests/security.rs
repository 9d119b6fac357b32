//! Protection against malicious files, specs, stores, sets and queries. `SECURITY.md` lists each test.

use std::{
    fs,
    os::unix::fs::{FileTypeExt, PermissionsExt, symlink},
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    thread::sleep,
    time::{Duration, Instant, SystemTime},
};

use crate::support::{Bench, SPEC, line_of, repository, stderr, stdout, write};

mod publishing;
mod stores;

/// Publishes tables of a bench's pipeline.
pub fn publish(bench: &Bench, tables: &[&str], to: &str) -> Output {
    let args = [&["publish", "spec.toml"], tables, &["--to", to]].concat();
    bench.magline(&args)
}

pub const FACTS: &str = r#"
[publish]
title       = "Small flights"
description = "Two simulated flights."
licence     = "CC-BY-4.0"
date        = "2026-11-23"
contact     = "data@example.org"
[[publish.authors]]
name = "A"
"#;

pub fn ran() -> Bench {
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
        "name = \"small\"\nstore = \"{}\"\n[tables.flights]\npath = \"../flights/\"\n[[stages]]\nname = \"scores\"\n\
         stage = \"derive\"\n\
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
    // The original spec may run, and a spec with another name may use the same store.
    assert_eq!(bench.run(&[]).code, 0);
    fs::write(bench.path("from/other.toml"), evil.replace("\"small\"", "\"other\"")).unwrap();
    assert!(bench.magline(&["run", "from/other.toml", "-q"]).status.success());
    let output = bench.magline(&["run", "from/evil.toml", "-q", "--take-over"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_ne!(bench.tables("store"), before);
}

#[test]
fn user_a_lease_from_the_future_is_ignored() {
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
            "name=\"ex\"\nstore=\"store\"\n[tables.flights]\npath=\"flights/\"\n[[stages]]\nname=\"d\"\n\
             stage=\"derive\"\n\
             input=\"flights\"\ncolumns={{ z = \"{expression}\" }}\nunits={{ z = \"nT\" }}\n"
        ));
        let output = bench.magline(&["run", "spec.toml", "-q"]);
        assert_eq!(output.status.code(), Some(2), "{expression}: {}", stderr(&output));
        assert!(stderr(&output).contains("may not fit in memory"), "{expression}: {}", stderr(&output));
    }
}

/// A process and its children.
#[cfg(target_os = "linux")]
fn family(process: u32) -> Vec<u32> {
    let children = fs::read_to_string(format!("/proc/{process}/task/{process}/children")).unwrap_or_default();
    std::iter::once(process).chain(children.split_whitespace().filter_map(|n| n.parse().ok())).collect()
}

/// Peak memory of a query with its processes, MB, and the output of the query.
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
fn user_queries_respect_their_memory_limit_in_all_operators() {
    let bench = ran();
    for query in [
        "SELECT length(repeat('a', 2000000000))",
        "SELECT length(repeat('a', 1000000000000000))",
        "SELECT length(lpad('a', 2000000000, 'bc'))",
        "SELECT sum(value) OVER (ORDER BY value ROWS BETWEEN UNBOUNDED PRECEDING AND UNBOUNDED FOLLOWING) FROM \
         generate_series(1,300000000)",
        "SELECT count(distinct repeat('a', 1000000) || value) FROM generate_series(1,100000)",
        "SELECT array_length(generate_series(1, 1000000000))",
        "SELECT length(string_agg(repeat('a', 100000), '')) FROM generate_series(1,100000)",
    ] {
        let (peak, output) = peak_mb(&bench, query, "64MB");
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{query}: {message}");
        assert!(message.contains("error: "), "{query}: {message}");
        assert!(!message.contains("panicked"), "{query}: {message}");
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
    // A file, and a pipe in a machine-readable format, receive the bytes.
    let output = bench.magline(&["sql", "SELECT DISTINCT line FROM small.scores ORDER BY line", "--format", "csv"]);
    assert!(stdout(&output).contains(hostile), "{:?}", stdout(&output));
}

#[test]
fn user_files_that_break_a_decoder_are_reported_without_a_trace() {
    let bench = Bench::new();
    for (name, reason) in [("schema.parquet", "its decoder failed"), ("deflate.tif", "corrupt deflate stream")] {
        let bytes = fs::read(repository().join("tests/cases/damaged").join(name)).unwrap();
        fs::write(bench.path(name), &bytes).unwrap();
        for command in [&["ingest", name, "--to", "out"][..], &["map", "info", name]] {
            let output = bench.magline(command);
            assert_eq!(output.status.code(), Some(2), "{command:?}: {}", stderr(&output));
            assert!(stderr(&output).contains(name), "{command:?}: {}", stderr(&output));
            assert!(!stderr(&output).contains("panicked"), "{command:?}: {}", stderr(&output));
        }
        let shown = stderr(&bench.magline(&["map", "info", name]));
        assert!(shown.contains(reason), "{name}: {shown}");
    }
    assert!(fs::read_dir(bench.path("out")).is_ok_and(|mut all| all.next().is_none()));
}

/// Appends the strings of the Rust files below a folder of the repository.
fn sources(folder: &Path, found: &mut String) {
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let (path, name) = (entry.path(), entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            if name != "target" && !name.to_string_lossy().starts_with('.') {
                sources(&path, found);
            }
        } else if path.extension().is_some_and(|x| x == "rs") {
            found.push_str(&fs::read_to_string(&path).unwrap());
        }
    }
}

#[test]
fn user_each_line_of_security_md_names_tests_that_exist() {
    let text = fs::read_to_string(repository().join("SECURITY.md")).unwrap();
    let mut code = String::new();
    sources(&repository(), &mut code);
    let lines =
        text.lines().filter(|line| line.starts_with('|') && !line.contains("---") && !line.ends_with("| test |"));
    let mut tests = 0;
    for line in lines {
        let last = line.trim_end_matches('|').rsplit('|').next().unwrap().trim();
        let names: Vec<&str> = last.split('`').filter(|word| word.contains('_') && !word.contains('/')).collect();
        assert!(last == "the same" || !names.is_empty(), "no test: {line}");
        for name in names {
            tests += 1;
            let is_there =
                code.contains(&format!("fn {name}(")) || name.ends_with('_') && code.contains(&format!("fn {name}"));
            assert!(is_there, "{name}: {line}");
        }
    }
    assert!(tests > 40, "{tests}");
}
