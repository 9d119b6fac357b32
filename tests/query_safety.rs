//! Queries of untrusted users: they write nothing, read only the store, and use a limited amount of memory and time.

use std::{
    fs,
    io::Read,
    process::{Command, Output, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use crate::{
    queries::ran,
    support::{Bench, stderr, stdout},
    trust::everything,
};

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
    let sort = "SELECT a.tt, b.tt AS other, a.mag_4_uc, b.mag_5_uc FROM small.even a CROSS JOIN (SELECT * FROM \
                small.even LIMIT 2000) b ORDER BY a.tt * 7 % 11, b.tt * 5 % 13";
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
