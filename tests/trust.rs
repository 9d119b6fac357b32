//! Robustness: queries that try to write, names outside the store, and extreme inputs.

use std::{
    collections::BTreeMap,
    fs,
    io::Read,
    path::Path,
    process::{Command, Output, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use crate::support::{Bench, SPEC, read, stderr, stdout, without};

fn ran() -> Bench {
    let bench = Bench::new();
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    bench
}

/// Files below `folder` with their bytes, and links with their targets.
fn everything(folder: &Path) -> BTreeMap<String, Vec<u8>> {
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
fn user_a_query_writes_nothing() {
    let bench = ran();
    let before = everything(bench.folder.path());
    for (query, kind) in [
        ("COPY (SELECT 1) TO 'out.parquet'", "COPY"),
        ("COPY small.scores TO 'store/tables/small/scores/more.parquet'", "COPY"),
        ("INSERT INTO small.scores SELECT * FROM small.scores", "INSERT"),
        ("INSERT INTO small.scores VALUES (1)", "INSERT"),
        ("INSERT OVERWRITE small.scores SELECT * FROM small.scores", "INSERT"),
        ("EXPLAIN ANALYZE INSERT INTO small.scores SELECT * FROM small.scores", "INSERT"),
        ("EXPLAIN COPY (SELECT 1) TO 'out.csv'", "COPY"),
        ("EXPLAIN ANALYZE COPY (SELECT 1) TO 'out.csv'", "COPY"),
        ("CREATE EXTERNAL TABLE t STORED AS PARQUET LOCATION 'map.parquet'", "CREATE EXTERNAL"),
        ("CREATE TABLE t AS SELECT 1", "CREATE TABLE"),
        ("CREATE VIEW v AS SELECT 1", "CREATE VIEW"),
        ("CREATE SCHEMA s", "CREATE SCHEMA"),
        ("CREATE FUNCTION f(DOUBLE) RETURNS DOUBLE RETURN $1", "CREATE FUNCTION"),
        ("DROP TABLE small.scores", "DROP TABLE"),
        ("DELETE FROM small.scores", "DELETE"),
        ("DELETE FROM small.scores WHERE value > 0", "DELETE"),
        ("UPDATE small.scores SET value = 0", "UPDATE"),
        ("TRUNCATE TABLE small.scores", "TRUNCATE"),
        ("MERGE INTO small.scores USING small.clean ON true WHEN MATCHED THEN DELETE", "MERGE"),
        ("ALTER TABLE small.scores ADD COLUMN x INT", "ALTER TABLE"),
        ("SET datafusion.catalog.information_schema = false", "SET"),
        ("RESET datafusion.catalog.information_schema", "RESET"),
        ("PREPARE p AS SELECT 1", "PREPARE"),
        ("EXECUTE p", "EXECUTE"),
        ("DEALLOCATE p", "DEALLOCATE"),
        ("BEGIN", "BEGIN"),
        ("COMMIT", "COMMIT"),
    ] {
        let output = bench.magline(&["sql", query]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{query}: {message}");
        assert!(message.contains(&format!("`{kind}` is rejected")), "{query}: {message}");
        assert!(output.stdout.is_empty(), "{query}");
    }
    for query in
        ["SELECT 1; DROP TABLE small.scores", "WITH x AS (INSERT INTO small.scores VALUES (1)) SELECT * FROM x"]
    {
        assert_eq!(bench.magline(&["sql", query]).status.code(), Some(2), "{query}");
    }
    let over = bench.magline(&["sql", "SELECT 1", "--format", "csv", "-o", "store/tables/small/scores/part-0.parquet"]);
    assert_eq!(over.status.code(), Some(2), "{}", stderr(&over));
    assert!(stderr(&over).contains("is in the store"), "{}", stderr(&over));
    assert!(before == everything(bench.folder.path()), "something was written");
    // Read-only statements are answered.
    for query in [
        "EXPLAIN ANALYZE SELECT count(*) FROM small.scores",
        "EXPLAIN SELECT 1",
        "SHOW TABLES",
        "DESCRIBE small.scores",
        "SELECT table_name FROM information_schema.tables",
        "WITH a AS (SELECT * FROM small.scores) SELECT count(*) FROM a JOIN a AS b ON a.line = b.line",
        "(SELECT 1) UNION ALL (SELECT 2)",
        "VALUES (1), (2)",
    ] {
        let output = bench.magline(&["sql", query]);
        assert!(output.status.success(), "{query}: {}", stderr(&output));
    }
    assert!(before == everything(bench.folder.path()), "something was written");
}

#[test]
fn user_a_query_reads_only_the_store() {
    let bench = ran();
    fs::write(bench.path("secret.csv"), "a,b\nsecret,2\n").unwrap();
    let map = bench.path("map.parquet").display().to_string();
    for query in [
        "SELECT * FROM '/etc/passwd'".to_owned(),
        "SELECT * FROM 'secret.csv'".to_owned(),
        format!("SELECT * FROM '{map}'"),
        format!("SELECT * FROM \"file://{map}\""),
        format!("SELECT * FROM read_parquet('{map}')"),
        "SELECT * FROM read_csv('secret.csv')".to_owned(),
        "SELECT * FROM parquet_metadata('map.parquet')".to_owned(),
        "SELECT * FROM \"../../map.parquet\"".to_owned(),
        "SELECT * FROM small.\"../../../map.parquet\"".to_owned(),
    ] {
        let output = bench.magline(&["sql", &query]);
        assert_eq!(output.status.code(), Some(2), "{query}: {}{}", stdout(&output), stderr(&output));
        assert!(!stdout(&output).contains("secret"), "{query}");
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::symlink;
        fs::create_dir(bench.path("elsewhere")).unwrap();
        fs::copy(bench.path("map.parquet"), bench.path("elsewhere/part-0.parquet")).unwrap();
        symlink(bench.path("elsewhere"), bench.path("store/tables/small/linked")).unwrap();
        fs::create_dir(bench.path("store/tables/small/half")).unwrap();
        symlink(bench.path("map.parquet"), bench.path("store/tables/small/half/part-0.parquet")).unwrap();
        for table in ["linked", "half"] {
            let output = bench.magline(&["sql", &format!("SELECT count(*) FROM small.{table}")]);
            assert_eq!(output.status.code(), Some(2), "{}", stdout(&output));
            assert!(stderr(&output).contains("is a link to a place outside the store"), "{}", stderr(&output));
        }
        assert!(bench.magline(&["sql", "SELECT count(*) FROM small.scores"]).status.success());
    }
}

#[test]
fn user_a_query_error_suggests_the_nearest_table_and_column() {
    let bench = ran();
    for (query, expected_text) in [
        ("SELECT * FROM small.score", "did you mean `small.scores`?"),
        ("SELECT * FROM scores", "did you mean `small.scores`?"),
        ("SELECT * FROM smal.scores", "did you mean `small.scores`?"),
        ("SELECT valu FROM small.scores", "did you mean `value`?"),
        ("SELECT s.metrik FROM small.scores s", "did you mean `metric`?"),
    ] {
        let output = bench.magline(&["sql", query]);
        assert_eq!(output.status.code(), Some(2), "{query}");
        assert!(stderr(&output).contains(expected_text), "{query}: {}", stderr(&output));
    }
}

/// Peak resident memory of a query, MB, and the output of the query.
#[cfg(target_os = "linux")]
fn peak_mb(bench: &Bench, args: &[&str]) -> (u64, Output) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_magline"))
        .args(args)
        .current_dir(bench.folder.path())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut peak = 0;
    while child.try_wait().unwrap().is_none() {
        let text = fs::read_to_string(&status).unwrap_or_default();
        let high = text.lines().find_map(|l| l.strip_prefix("VmHWM:")?.trim().trim_end_matches(" kB").parse().ok());
        peak = peak.max(high.unwrap_or(0));
        sleep(Duration::from_millis(5));
    }
    (peak / 1000, child.wait_with_output().unwrap())
}

#[test]
#[cfg(target_os = "linux")]
fn user_a_query_respects_its_memory_limit() {
    let bench = ran();
    // 19,200 rows squared with all columns: terabytes.
    let cross = "SELECT * FROM small.clean a CROSS JOIN small.clean b";
    let (peak, output) = peak_mb(&bench, &["sql", cross, "--memory-limit", "200MB"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("exceeds its memory limit of 200 MB"), "{}", stderr(&output));
    assert!(stderr(&output).contains("`--memory-limit`"), "{}", stderr(&output));
    assert!(peak < 700, "{peak} MB");
    // 4,800,000 rows of 32 bytes exceed the memory limit and are sorted on disk.
    let sort = "SELECT a.tt, b.tt AS other, a.mag_4_uc, b.mag_5_uc FROM small.even a CROSS JOIN (SELECT * FROM small.even LIMIT 2000) b ORDER BY a.tt * 7 % 11, b.tt * 5 % 13";
    let (peak, output) =
        peak_mb(&bench, &["sql", sort, "--format", "csv", "-o", "sorted.csv", "--memory-limit", "64MB"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let rows = fs::read(bench.path("sorted.csv")).unwrap().iter().filter(|b| **b == b'\n').count();
    assert_eq!(rows, 2400 * 2000 + 1);
    assert!(peak < 300, "{peak} MB");
    let wrong = bench.magline(&["sql", "SELECT 1", "--memory-limit", "lots"]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(stderr(&wrong).contains("4GB"), "{}", stderr(&wrong));
}

#[test]
#[cfg(unix)]
fn user_a_query_can_be_interrupted() {
    let bench = ran();
    let counting = "SELECT count(*) FROM small.clean a, small.clean b, small.clean c WHERE a.tt + b.tt > c.tt";
    let printing = "SELECT a.tt, b.tt AS other FROM small.clean a CROSS JOIN small.clean b";
    for (query, format) in [(counting, "table"), (printing, "csv")] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_magline"))
            .args(["sql", query, "--format", format])
            .current_dir(bench.folder.path())
            .env("TMPDIR", bench.folder.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // The answer is not read, so the second query blocks on its output.
        sleep(Duration::from_millis(1500));
        assert!(child.try_wait().unwrap().is_none(), "{query} was over at once");
        let asked = Instant::now();
        Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
        while child.try_wait().unwrap().is_none() && asked.elapsed() < Duration::from_secs(10) {
            sleep(Duration::from_millis(5));
        }
        let took = asked.elapsed();
        let status = child.wait().unwrap();
        let mut message = String::new();
        child.stderr.take().unwrap().read_to_string(&mut message).unwrap();
        assert_eq!(status.code(), Some(130), "{message}");
        assert!(took < Duration::from_secs(1), "{took:?}");
        assert_eq!(message, "interrupted\n");
    }
    let left: Vec<String> = everything(bench.folder.path()).into_keys().filter(|n| n.contains("magline-sql")).collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn user_deeply_nested_queries_are_answered_or_rejected() {
    let bench = ran();
    let sum = |n: usize| format!("SELECT {}1 AS x", "1 + ".repeat(n));
    let output = bench.magline(&["sql", &sum(900), "--format", "csv"]);
    assert_eq!(stdout(&output), "x\n901\n", "{}", stderr(&output));
    let ors = |n: usize| vec!["line = '1.01'"; n].join(" or ");
    let many = format!("SELECT count(*) AS n FROM small.scores WHERE {}", ors(900));
    let output = bench.magline(&["sql", &many, "--format", "csv"]);
    assert!(output.status.success() && stdout(&output).starts_with("n\n"), "{}", stderr(&output));
    let columns = format!("SELECT count(*) AS n FROM small.scores WHERE value > {}value", "value + ".repeat(300));
    let output = bench.magline(&["sql", &columns, "--format", "csv"]);
    assert!(output.status.success() && stdout(&output).starts_with("n\n"), "{}", stderr(&output));
    for (query, expected_text) in [
        (sum(20_000), "nested too deep"),
        (format!("SELECT {}1{}", "(".repeat(20_000), ")".repeat(20_000)), "nested too deep"),
        (format!("SELECT {}true", "not ".repeat(20_000)), "cannot run the query"),
        (format!("SELECT 1{}", " UNION ALL SELECT 1".repeat(5_000)), "more than 1000 tables and queries"),
        (format!("SELECT 1 FROM small.scores{}", ", small.scores".repeat(5_000)), "more than 1000 tables and queries"),
    ] {
        let output = bench.magline(&["sql", &query]);
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        assert!(stderr(&output).contains(expected_text), "{}", stderr(&output));
    }
    let unions = format!("SELECT count(*) AS n FROM (SELECT 1{})", " UNION ALL SELECT 1".repeat(900));
    let output = bench.magline(&["sql", &unions, "--format", "csv"]);
    assert_eq!(stdout(&output), "n\n901\n", "{}", stderr(&output));
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
        (format!("name={long}"), "a name of 300 characters is too long".to_owned()),
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
    let expected = "error: `../../p` cannot be a name\n --> the command line\n  | --set name=../../p\n  |            ^^^^^^^ a name begins with a letter and holds letters, digits, `_` and `-`\n";
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
            assert!(stderr(&output).contains(&format!("this machine has {cores} cores")), "{}", stderr(&output));
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
