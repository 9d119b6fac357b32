//! Robustness: extreme inputs, foreign files, and streams that end early.

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    process::{Command, Output},
    time::{Duration, Instant},
};

use crate::{
    queries::ran,
    support::{Bench, SPEC, read, stderr, stdout, without},
};

/// Files below `folder` with their bytes, and links with their targets.
pub fn everything(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap().flatten() {
            if entry.file_type().unwrap().is_dir() {
                folders.push(entry.path());
            } else {
                found.insert(entry.path().display().to_string(), fs::read(entry.path()).unwrap_or_default());
            }
        }
    }
    found
}

/// Runs a shell command with redirections; `magline` is the binary.
fn shell(bench: &Bench, line: &str) -> Output {
    let line = format!("magline() {{ \"{}\" \"$@\"; }}\n{line}", env!("CARGO_BIN_EXE_magline"));
    Command::new("bash").args(["-c", &line]).current_dir(bench.folder.path()).output().unwrap()
}

#[test]
fn user_where_depends_only_on_the_row() {
    let with = |predicate: &str| SPEC.replace("\"line like '%.01'\"", &format!("\"{predicate}\""));
    for (predicate, expected_text) in [
        ("tt > 36000 + 30 * random()", "`random()` gives a different value each time"),
        ("uuid() > 'a'", "`uuid()` gives a different value each time"),
        ("avg(tt) > 3", "`avg` requires several rows"),
        ("rank() over (order by tt) < 100", "`rank` requires several rows"),
        ("tt > (select 1)", "`where` cannot contain a query"),
        ("line in (select '1.01')", "`where` cannot contain a query"),
    ] {
        let bench = Bench::new();
        bench.spec(&with(predicate));
        let output = bench.magline(&["check", "spec.toml"]);
        assert_eq!(output.status.code(), Some(2), "{predicate}: {}", stdout(&output));
        assert!(stderr(&output).contains(expected_text), "{predicate}: {}", stderr(&output));
        assert!(stderr(&output).contains("--> spec.toml:33:10"), "{}", stderr(&output));
    }
    for function in ["now()", "current_date", "current_time", "current_timestamp", "today()"] {
        let bench = Bench::new();
        bench.spec(&with(&format!("cast({function} as text) > 'a'")));
        assert_eq!(bench.magline(&["check", "spec.toml"]).status.code(), Some(2), "{function}");
    }
}

#[test]
fn user_a_where_of_thousands_of_terms_runs() {
    let bench = Bench::new();
    // The first term selects the same lines as `line like '%.01'`; the other terms select nothing.
    let terms: String = (0..3000).map(|i| format!(" or tt = {i}")).collect();
    let spec = SPEC.replace("lambda = [0.0, 0.025]", "lambda = [0.025]");
    bench.spec(&spec);
    assert_eq!(bench.run(&["--set", "store=plain"]).code, 0);
    bench.spec(&spec.replace("line like '%.01'", &format!("line like '%.01'{terms}")));
    let done = bench.run(&["--threads", "2"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    // A condition on samples may select samples of any line, so all lines count as in sample.
    let table = |store: &str| read(&bench.path(store).join("tables/small/scores"));
    let scores = |store: &str| table(store).iter().map(|b| without(b, "in_sample")).collect::<Vec<_>>();
    assert!(scores("store") == scores("plain"), "the terms that select nothing changed the scores");
    bench.spec(&SPEC.replace("line like '%.01'", &format!("tt > {}1", "1 + ".repeat(20_000))));
    let output = bench.magline(&["check", "spec.toml"]);
    assert_eq!(output.status.code(), Some(2), "{:?}", output.status);
    assert!(stderr(&output).contains("nested too deep") && stderr(&output).contains("spec.toml:33:10"));
}

#[test]
fn user_set_is_checked_like_the_file() {
    let bench = Bench::new();
    fs::create_dir_all(bench.path("thesis/even")).unwrap();
    fs::write(bench.path("thesis/even/chapter.txt"), "years of work").unwrap();
    let long = "a".repeat(300);
    let cases: Vec<(String, String)> = [
        ("name=../../thesis", "`../../thesis` cannot be a name"),
        ("name=../thesis", "cannot be a name"),
        ("name=a/b", "`a/b` cannot be a name"),
        ("name=", "`` cannot be a name"),
        ("name=\"\"", "`` cannot be a name"),
        ("name=a\nb", "cannot be a name"),
        ("name=\"a\\nb\"", "cannot be a name"),
        ("name=.", "cannot be a name"),
        ("name=7", "`7` cannot be a name"),
        ("name=[1]", "`name` must be text"),
        ("store=ftp://host/store", "addresses that begin with `ftp://` are not supported"),
        ("store=", "the store `` is not a folder"),
        ("store=a\nb", "is not a folder"),
        ("store=[1]", "`store` must be text"),
        ("seed=-1", "`seed` must be a whole number"),
        ("seed=x", "`seed` must be a whole number"),
        ("axes.lambda=[]", "the axis `lambda` has no values"),
        ("axes.lambda=[0.1, 0.1]", "has the value `0.1` twice"),
        ("axes.lambda=[0.1, 'a']", "the axis `lambda` mixes"),
        ("axes.lambda=[0.1,", "unclosed array"),
        ("axes.lamda=[1.0]", "did you mean `lambda`?"),
        ("tables.flight.path=x", "did you mean `flights`?"),
        ("tables.flights.path=nowhere/", "nowhere"),
        ("tables.flights.formt=csv", "formt"),
        ("cleen.detrend=true", "did you mean `clean`?"),
        ("clean.detrent=true", "did you mean `detrend`?"),
        ("clean.detrend=1", "must be a boolean"),
        ("even.rate_hz=ten", "must be a number, not a text"),
        ("even.rate_hz=-1", "`rate_hz` must be above 0"),
        ("even.publish=maybe", "`publish` must be true or false"),
        ("even.stage=resampel", "did you mean `resample`?"),
        ("coefficients.where=lin = '1'", "did you mean `line`?"),
        ("nothing=1", "`--set` cannot set `nothing`"),
        ("axes=1", "`--set` cannot set `axes`"),
        ("justakey", "`--set` requires KEY=VALUE"),
        ("=1", "`--set` requires KEY=VALUE"),
    ]
    .map(|(a, b)| (a.to_owned(), b.to_owned()))
    .into_iter()
    .chain([
        (format!("name={long}"), "the name is too long: it has 300 characters".to_owned()),
        (format!("store={long}"), "is not a folder".to_owned()),
    ])
    .collect();
    let before = everything(bench.folder.path());
    for (set, expected_text) in &cases {
        let done = bench.run(&["--set", set]);
        assert_eq!(done.code, 2, "{set:?}: {}", done.stderr);
        assert!(done.stderr.contains(expected_text), "{set:?}: {}", done.stderr);
        assert!(done.stderr.contains(" --> the command line\n  | --set "), "{set:?}: {}", done.stderr);
        assert_eq!(stderr(&bench.magline(&["check", "spec.toml", "--set", set])), done.stderr);
    }
    assert!(before == everything(bench.folder.path()), "something was written or removed");
    let done = bench.run(&["--set", "seed=2", "--set", "name=../../p"]);
    let expected = "error: `../../p` cannot be a name\n --> the command line\n  | --set name=../../p\n  |            \
                    ^^^^^^^ a name begins with a letter and holds letters, digits, `_` and `-`\n";
    assert_eq!(done.stderr, expected);
}

#[test]
fn user_set_accepts_the_same_values_as_the_file() {
    let bench = Bench::new();
    let sets = [
        "name=other",
        "seed=3",
        "store=kept in/here",
        "axes.mag=mag_4_uc",
        "axes.vector=['flux_a']",
        "axes.lambda={ subsets_of = [0.1], at_least = 1 }",
        "tables.flights.path='flights/1.parquet'",
        "coefficients.where=line = '1.02'",
        "stages.clean.detrend=true",
    ];
    // A subset is a list, which is invalid for a ridge parameter. The message is at the parameter.
    let args: Vec<&str> = sets.iter().flat_map(|s| ["--set", *s]).collect();
    let done = bench.run(&args);
    assert_eq!(done.code, 2);
    assert!(done.stderr.contains("--> spec.toml:36:10"), "{}", done.stderr);
    let args: Vec<&str> =
        args.into_iter().map(|s| if s.starts_with("axes.lambda") { "axes.lambda=0.1" } else { s }).collect();
    let done = bench.run(&args);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert_eq!((done.computed("even"), done.computed("clean")), (2, 2));
    assert!(bench.path("kept in/here/tables/other/scores").is_dir() && !bench.path("store").exists());
}

#[test]
#[cfg(unix)]
fn user_publishing_keeps_foreign_files() {
    use std::os::unix::fs::symlink;
    let bench = ran();
    // A table folder linked to a place outside the store is not emptied. A foreign file in a table is kept.
    fs::create_dir(bench.path("thesis")).unwrap();
    fs::write(bench.path("thesis/part-9.parquet"), "years of work").unwrap();
    fs::remove_dir_all(bench.path("store/tables/small/scores")).unwrap();
    symlink(bench.path("thesis"), bench.path("store/tables/small/scores")).unwrap();
    fs::write(bench.path("store/tables/small/clean/notes.txt"), "mine").unwrap();
    let done = bench.run(&[]);
    assert_eq!(done.code, 1, "{}", done.stderr);
    let text = serde_json::to_string(&done.last).unwrap();
    assert!(text.contains("is a link to a place outside the store"), "{text}");
    assert_eq!(fs::read(bench.path("thesis/part-9.parquet")).unwrap(), b"years of work");
    assert_eq!(fs::read_dir(bench.path("thesis")).unwrap().count(), 1);
    assert_eq!(fs::read(bench.path("store/tables/small/clean/notes.txt")).unwrap(), b"mine");
}

#[test]
fn user_threads_are_limited() {
    let bench = Bench::new();
    let cores = std::thread::available_parallelism().unwrap().get();
    for threads in ["65535", "100000000000000000000", "0", "-1", "many", ""] {
        let started = Instant::now();
        let output = bench.magline(&["run", "spec.toml", &format!("--threads={threads}")]);
        assert_eq!(output.status.code(), Some(2), "{threads}");
        assert!(started.elapsed() < Duration::from_secs(5));
        if threads == "65535" {
            assert!(stderr(&output).contains(&format!("this machine has only {cores} cores")), "{}", stderr(&output));
        }
    }
    assert!(!bench.path("store").exists());
    assert_eq!(bench.run(&["--threads", "16"]).code, 0);
}

#[test]
fn user_sweeps_are_counted_before_they_are_expanded() {
    let bench = Bench::new();
    let list = |n: usize| (0..n).map(|i| format!("{i}.5")).collect::<Vec<_>>().join(", ");
    let names: Vec<String> = (0..30).map(|i| format!("'x{i}'")).collect();
    let started = Instant::now();
    let check = |set: &[String]| {
        fs::write(bench.path("wide.toml"), SPEC.replace("lambda = [0.0, 0.025]", &set.join("\n"))).unwrap();
        bench.magline(&["check", "wide.toml"])
    };
    let axis = |rest: &str| format!("lambda = {{ subsets_of = [{}]{rest} }}", names.join(", "));
    for (axis, expected_text) in [
        (axis(""), "the axis `lambda` would have 1073741823 values"),
        (axis(", at_least = 15"), "the axis `lambda` would have"),
    ] {
        let output = check(&[axis]);
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        assert!(stderr(&output).contains(expected_text), "{}", stderr(&output).chars().take(400).collect::<String>());
        assert!(stderr(&output).contains("`up_to`"));
    }
    let spec = SPEC.replace("lambda = [0.0, 0.025]", &format!("lambda = [{}]\nlow = [{}]", list(60_000), list(50)));
    let spec = spec.replace("lambda = \"$lambda\"", "lambda = \"$lambda\"\nlow_hz = \"$low\"");
    fs::write(bench.path("wide.toml"), spec).unwrap();
    let output = bench.magline(&["check", "wide.toml"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    let expected_text =
        "`coefficients` would be run at 12000000 points: mag (2) x vector (2) x lambda (60000) x low (50)";
    assert!(stderr(&output).contains(expected_text), "{}", stderr(&output).chars().take(400).collect::<String>());
    // The product of the axes overflows every integer type.
    let axes: Vec<String> = (0..16).map(|i| format!("a{i} = [{}]", list(100_000 / 100))).collect();
    let spec = SPEC.replace("lambda = [0.0, 0.025]", &format!("lambda = [1.0]\n{}", axes.join("\n")));
    let mention: String = (0..16).map(|i| format!("$a{i}")).collect();
    fs::write(bench.path("wide.toml"), spec.replace("line like '%.01'", &format!("line like '%.01{mention}'")))
        .unwrap();
    let output = bench.magline(&["check", "wide.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        stderr(&output).contains("would be run at more than 10^30 points") && stderr(&output).contains("a15 (1000)"),
        "{}",
        stderr(&output)
    );
    // 20,000 points of each of four tables are planned in seconds.
    let output = check(&[format!("lambda = [{}]", list(5_000))]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stdout(&output).contains("points"), "{}", stdout(&output));
    assert!(started.elapsed() < Duration::from_secs(60), "{:?}", started.elapsed());
}

#[test]
#[cfg(target_os = "linux")]
fn user_closed_full_and_abandoned_streams_cause_no_panic() {
    let bench = ran();
    let code = |line: &str| {
        let output = shell(&bench, line);
        let message = format!("{}{}", stdout(&output), stderr(&output));
        assert!(!message.contains("panicked"), "{line}: {message}");
        (output.status.code().unwrap(), message)
    };
    // An unwritable standard error does not change the exit status.
    for target in ["2>&-", "2>/dev/full"] {
        assert_eq!(code(&format!("magline run spec.toml {target}")).0, 0, "{target}");
        assert_eq!(code(&format!("magline check spec.toml {target}")).0, 0, "{target}");
        assert_eq!(code(&format!("magline check spec.toml --set name=a/b {target}")).0, 2, "{target}");
        assert_eq!(code(&format!("magline run nowhere.toml {target}")).0, 2, "{target}");
        assert_eq!(code(&format!("magline nonsense {target}")).0, 2, "{target}");
        assert_eq!(code(&format!("magline sql 'SELECT nothing' {target}")).0, 2, "{target}");
        assert_eq!(code(&format!("magline map info nowhere.tif {target}")).0, 2, "{target}");
    }
    assert_eq!(code("magline check spec.toml --set name=a/b 2>&1 >/dev/null | true; exit ${PIPESTATUS[0]}").0, 2);
    // Unwritable results are an error with a message.
    for command in [
        "run spec.toml",
        "run spec.toml --json",
        "check spec.toml",
        "explain spec.toml",
        "stages",
        "stages --markdown",
        "map info map.parquet",
        "sql 'SELECT * FROM small.scores'",
        "sql 'SELECT tt, mag_c FROM small.clean' --format csv",
        "sql 'SELECT * FROM small.clean' --format json",
        "--help",
        "--version",
    ] {
        let (status, message) = code(&format!("magline {command} >/dev/full"));
        assert_eq!(status, 1, "{command}: {message}");
        assert!(message.contains("cannot write to standard output: No space left on device"), "{command}: {message}");
        // A reader that stops early causes no error.
        let (status, message) = code(&format!("magline {command} | head -c 1 >/dev/null; exit ${{PIPESTATUS[0]}}"));
        assert!(status == 0 && !message.contains("error:"), "{command}: {status} {message}");
        assert_eq!(code(&format!("magline {command} >&- 2>&-")).0, 0, "{command}");
    }
    let (status, message) = code("magline sql 'SELECT 1 AS one' --format csv -o /dev/full/x");
    assert_eq!(status, 1, "{message}");
}
