//! Runs computed by other processes give the same bytes and compute each unit once, for any failure of a worker.

use std::{
    collections::BTreeMap,
    fs,
    io::Write,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use serde_json::{Value, json};

use crate::support::{Bench, changed, line_of, read, stderr, stdout, texts, write};

fn tasks(bench: &Bench, store: &str, more: &[&str]) -> Vec<String> {
    let at = format!("store={store}");
    let args: Vec<&str> = ["tasks", "spec.toml", "--set", &at].iter().chain(more).copied().collect();
    let output = bench.magline(&args);
    assert!(output.status.success(), "{}", stderr(&output));
    stdout(&output).lines().map(str::to_owned).collect()
}

/// Runs `magline task` with these lines on standard input.
fn task(bench: &Bench, store: &str, lines: &[u8], more: &[&str]) -> Output {
    let mut child = Command::new(env!("CARGO_BIN_EXE_magline"))
        .args(["task", "--store", store])
        .args(more)
        .current_dir(bench.folder.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // A worker that stops reading has closed its input.
    let _ = child.stdin.take().unwrap().write_all(lines);
    child.wait_with_output().unwrap()
}

fn receipts(output: &Output) -> Vec<Value> {
    stdout(output).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Outcome and key of each unit in the receipts.
fn units(receipts: &[Value]) -> Vec<(String, String)> {
    let text = |unit: &Value, key: &str| unit[key].as_str().unwrap().to_owned();
    let all = receipts.iter().flat_map(|r| r["units"].as_array().unwrap());
    all.map(|u| (text(u, "key"), text(u, "outcome"))).collect()
}

/// Number of times that each unit had the outcome `outcome`.
fn times(receipts: &[Value], outcome: &str) -> BTreeMap<String, usize> {
    let mut found = BTreeMap::new();
    for (key, _) in units(receipts).into_iter().filter(|(_, o)| o == outcome) {
        *found.entry(key).or_default() += 1;
    }
    found
}

/// Packs of a store with their bytes.
fn packs(bench: &Bench, store: &str) -> BTreeMap<PathBuf, Vec<u8>> {
    let root = bench.path(store).join("objects");
    let folders = fs::read_dir(&root).unwrap().flatten().filter(|e| e.path().is_dir());
    let files = folders.flat_map(|folder| fs::read_dir(folder.path()).unwrap().flatten());
    files.map(|f| (f.path().strip_prefix(&root).unwrap().to_owned(), fs::read(f.path()).unwrap())).collect()
}

/// Asserts that tables and packs of `store` equal those of the local run in `whole`.
pub fn same(bench: &Bench, whole: &str, store: &str) {
    let (expected, found) = (bench.tables(whole), bench.tables(store));
    assert_eq!(expected.keys().collect::<Vec<_>>(), found.keys().collect::<Vec<_>>());
    for (name, bytes) in &expected {
        assert!(found[name] == *bytes, "{name} differs");
    }
    let found = packs(bench, store);
    for (name, bytes) in packs(bench, whole) {
        assert!(found.get(&name) == Some(&bytes), "{} differs or is missing", name.display());
    }
}

/// Hides the inputs from the workers, or restores them.
fn inputs(bench: &Bench, there: bool) {
    for name in ["flights", "map.parquet"] {
        let (one, other) = (bench.path(name), bench.path(&format!("{name}.away")));
        if there { fs::rename(other, one).unwrap() } else { fs::rename(one, other).unwrap() }
    }
}

#[test]
fn user_tasks_by_xargs_give_the_bytes_of_a_run_and_each_unit_once() {
    let bench = Bench::new();
    let local = bench.run(&["--set", "store=whole"]);
    assert_eq!(local.code, 0, "{}", local.stderr);
    let (mut all, mut waves, mut parts) = (vec![], 0, 0);
    loop {
        let lines = tasks(&bench, "store", &["--units", "5", "--quiet"]);
        if lines.is_empty() {
            break;
        }
        waves += 1;
        parts += lines.iter().filter(|l| l.contains(r#""part":true"#)).count();
        fs::write(bench.path("tasks.jsonl"), lines.join("\n")).unwrap();
        inputs(&bench, false);
        let output = Command::new("xargs")
            .args(["-a", "tasks.jsonl", "-d", "\\n", "-n", "1", "-P", "2", env!("CARGO_BIN_EXE_magline"), "task"])
            .current_dir(bench.folder.path())
            .output()
            .unwrap();
        inputs(&bench, true);
        assert!(output.status.success(), "{}", stderr(&output));
        assert_eq!(receipts(&output).len(), lines.len());
        all.extend(receipts(&output));
    }
    // Waves: even, terms, coefficients, clean, track, scores. Some packs are complete, others are parts.
    assert!(waves == 6 && parts > 5, "{waves} waves, {parts} parts");
    assert!(all.iter().any(|r| r["worker"] != all[0]["worker"]));
    let computed = times(&all, "computed");
    assert_eq!(computed.len() as u64, local.total("computed"));
    assert!(computed.values().all(|n| *n == 1) && times(&all, "reused").is_empty(), "{computed:?}");
    let last = bench.run(&[]);
    assert_eq!((last.code, last.total("computed"), last.total("reused")), (0, 0, local.total("computed")));
    same(&bench, "whole", "store");
    assert!(!bench.path("store/attempts").read_dir().unwrap().any(|_| true));
    // Unreferenced packs are dropped, and the tables stay unchanged.
    let before = packs(&bench, "store").len();
    assert!(bench.magline(&["gc", "--yes"]).status.success());
    assert!(packs(&bench, "store").len() < before);
    assert!(bench.magline(&["verify"]).status.success());
    same(&bench, "whole", "store");
}

#[test]
fn user_the_engine_of_processes_gives_the_same_bytes_also_for_a_grown_sweep() {
    let bench = Bench::new();
    let small = ["--set", "axes.lambda=[0.025]"];
    for store in ["store=whole", "store=store"] {
        let engine = if store == "store=whole" { "local" } else { "processes" };
        for more in [small.as_slice(), &[]] {
            let args: Vec<&str> = ["--engine", engine, "--set", store].iter().chain(more).copied().collect();
            let done = bench.run(&args);
            assert!(done.code == 0 && done.total("computed") > 0 && done.total("failed") == 0, "{args:?} {done:?}");
        }
    }
    same(&bench, "whole", "store");
    let again = bench.run(&["--engine", "processes"]);
    assert_eq!((again.code, again.total("computed")), (0, 0));
    let refused = bench.run(&["--unit-timeout", "5s"]);
    assert!(refused.code == 2 && refused.stderr.contains("--engine processes"), "{}", refused.stderr);
}

#[test]
fn user_a_search_resumes_with_tasks_and_other_engines() {
    let bench = Bench::new();
    let searched = crate::support::SPEC.replace("lambda = [0.0, 0.025]\n", "").replace("\"$lambda\"", "\"$damping\"");
    let search = "[search]\ngoal = \"scores.std_error\"\ntrials = 6\ngeneration = 3\nstart = 3\n[search.axes]\n\
                  damping = { low = 1e-4, high = 10.0, log = true }\n\n[[stages]]\nname    = \"even\"";
    bench.spec(&searched.replacen("[[stages]]\nname    = \"even\"", search, 1));
    let one = ["--set", "axes.mag=[\"mag_4_uc\"]", "--set", "axes.vector=[\"flux_a\"]"];
    let run = |more: &[&str]| {
        let done = bench.run(&one.iter().chain(more).copied().collect::<Vec<_>>());
        assert_eq!(done.code, 0, "{}", done.stderr);
        done
    };
    let local = run(&["--set", "store=whole"]);
    run(&["--set", "store=processes", "--engine", "processes"]);
    same(&bench, "whole", "processes");
    let mut computed = 0;
    loop {
        let lines = tasks(&bench, "store", &one);
        if lines.is_empty() {
            break;
        }
        let output = task(&bench, "store", lines.join("\n").as_bytes(), &[]);
        assert!(output.status.success(), "{}", stderr(&output));
        computed += times(&receipts(&output), "computed").len() as u64;
    }
    assert_eq!(computed, local.total("computed"));
    assert_eq!(run(&[]).total("computed"), 0);
    same(&bench, "whole", "store");
}

#[test]
fn user_a_killed_worker_costs_only_its_unfinished_units() {
    let bench = Bench::new();
    assert_eq!(bench.run(&["--set", "store=whole"]).code, 0);
    let (mut lost, mut done, mut reused) = (0, 0, 0);
    loop {
        let lines = tasks(&bench, "store", &["--units", "3", "--retries", "100"]);
        if lines.is_empty() {
            break;
        }
        fs::write(bench.path("tasks.jsonl"), lines.join("\n")).unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_magline"))
            .args(["task", "--retries", "100"])
            .stdin(fs::File::open(bench.path("tasks.jsonl")).unwrap())
            .stdout(fs::File::create(bench.path("receipts.jsonl")).unwrap())
            .stderr(Stdio::null())
            .current_dir(bench.folder.path())
            .spawn()
            .unwrap();
        // The worker is killed shortly after the start or end of a unit; the moment differs in each wave.
        let started = Instant::now();
        let begun = || {
            let attempts = fs::read_dir(bench.path("store/attempts")).unwrap().count();
            attempts > 0 || fs::metadata(bench.path("receipts.jsonl")).unwrap().len() > 0
        };
        while !begun() && started.elapsed() < Duration::from_secs(60) {
            sleep(Duration::from_millis(1));
        }
        child.kill().unwrap();
        lost += usize::from(!child.wait().unwrap().success());
        let before = fs::read_to_string(bench.path("receipts.jsonl")).unwrap();
        let whole = before.lines().filter_map(|l| serde_json::from_str::<Value>(l).ok()).collect::<Vec<_>>();
        let before = times(&whole, "computed");
        // The same tasks run again: units with a receipt are reused, and the other units are computed.
        let output = task(&bench, "store", lines.join("\n").as_bytes(), &["--retries", "100"]);
        assert!(output.status.success(), "{}", stderr(&output));
        let again = units(&receipts(&output));
        assert!(again.iter().all(|(key, outcome)| !before.contains_key(key) || outcome == "reused"), "{again:?}");
        done += before.len();
        reused += again.iter().filter(|(_, outcome)| outcome == "reused").count();
    }
    assert!(lost > 2 && reused >= done, "{lost} killed, {done} done before, {reused} reused");
    assert_eq!(bench.run(&[]).total("computed"), 0);
    same(&bench, "whole", "store");
    assert!(fs::read_dir(bench.path("store/tmp")).unwrap().next().is_none(), "unfinished files are swept");
}

#[test]
fn user_a_stopped_worker_loses_no_attempt() {
    let bench = Bench::new();
    write(&bench.path("flights/3.parquet"), &[line_of("3", "3.01", 200_000)]);
    let lines = tasks(&bench, "store", &[]);
    fs::write(bench.path("tasks.jsonl"), lines.join("\n")).unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_magline"))
        .arg("task")
        .stdin(fs::File::open(bench.path("tasks.jsonl")).unwrap())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .current_dir(bench.folder.path())
        .spawn()
        .unwrap();
    let attempts = || fs::read_dir(bench.path("store/attempts")).unwrap().count();
    while attempts() == 0 && child.try_wait().unwrap().is_none() {
        sleep(Duration::from_millis(1));
    }
    Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
    let status = child.wait().unwrap();
    assert!(status.code() == Some(130) || status.success(), "{status:?}");
    assert_eq!(attempts(), 0);
}

#[test]
fn user_invalid_tasks_are_rejected_and_the_others_are_computed() {
    let bench = Bench::new();
    let lines = tasks(&bench, "store", &["--units", "1"]);
    assert_eq!(lines.len(), 4, "{lines:?}");
    let refused = |line: &str, message: &str| {
        let output = task(&bench, "store", line.as_bytes(), &[]);
        let text = stderr(&output);
        assert!(output.status.code() == Some(2) && text.contains(message), "{message}: {text}");
        receipts(&output)
    };
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut task: Value = serde_json::from_str(&lines[0]).unwrap();
        change(&mut task);
        task.to_string()
    };
    // A receipt reports another version.
    let other = refused(&changed(&|t| t["magline"] = json!("9.9.9")), "by magline 9.9.9, but this is magline");
    assert!(other[0]["refused"].as_str().unwrap().contains("9.9.9") && other[0]["units"] == json!([]));
    let nowhere = changed(&|t| t["plan"] = json!("0123456789abcdef0123456789abcdef"));
    refused(&nowhere, "does not contain the plan 0123456789abcdef0123456789abcdef");
    let key = changed(&|t| t["units"][0]["key"] = json!("0123456789abcdef0123456789abcdef"));
    refused(&key, "has the key 0123456789abcdef0123456789abcdef in the task");
    refused(&changed(&|t| t["units"][0]["line"] = json!(77)), "no unit at point 0, line 77");
    refused(&changed(&|t| t["units"][0]["point"] = json!(9)), "no unit at point 9");
    refused(&changed(&|t| t["table"] = json!("evem")), "did you mean `even`");
    refused(&changed(&|t| t["plan"] = Value::Null), "has no plan");
    // A line that is not a task gives no receipt.
    assert!(refused(&lines[0][..lines[0].len() / 2], "the line is truncated").is_empty());
    assert!(refused("{\"event\": \"started\"}", "is JSON, but not a").is_empty());
    assert!(refused("even 1 1.01", "not JSON").is_empty());
    assert!(refused(&changed(&|t| t["task"] = json!(2)), "the task has format 2").is_empty());
    assert!(task(&bench, "store", b"\xff\xfe\n", &[]).status.code() == Some(2));
    assert_eq!(task(&bench, "store", b"", &[]).status.code(), Some(0), "no task is no fault");
    assert_eq!(task(&bench, "nowhere", lines[0].as_bytes(), &[]).status.code(), Some(2));
    assert!(!bench.path("nowhere").exists());
    // The plan is damaged or truncated.
    let plan = fs::read_dir(bench.path("store/plans")).unwrap().next().unwrap().unwrap().path();
    let whole = fs::read(&plan).unwrap();
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 1;
    for bytes in [&flipped[..], &whole[..whole.len() / 2], &[]] {
        fs::write(&plan, bytes).unwrap();
        refused(&lines[0], "is damaged");
    }
    // The next `tasks` repairs the plan. Invalid lines do not affect the others.
    assert_eq!(tasks(&bench, "store", &["--units", "1"]), lines);
    let mixed = [&lines[0], "{\"cut\": ", &nowhere, &lines[1]].join("\n");
    let output = task(&bench, "store", mixed.as_bytes(), &[]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert_eq!(times(&receipts(&output), "computed").len(), 2);
    // Job array: each job has a share of the lines.
    let shares: Vec<Vec<Value>> = ["0/3", "1/3", "2/3"]
        .map(|share| receipts(&task(&bench, "store", lines.join("\n").as_bytes(), &["--share", share])))
        .into();
    assert_eq!(shares.iter().map(Vec::len).collect::<Vec<_>>(), [2, 1, 1]);
    assert_eq!(times(&shares.concat(), "computed").len(), 2, "two were there");
    assert_eq!(task(&bench, "store", b"", &["--share", "3/3"]).status.code(), Some(2));
}

/// Fits of unresampled columns, so that an unevenly sampled line reaches the fits.
const FITS: &str = r#"
name  = "small"
store = "store"

[tables.flights]
path = "flights/"

[axes]
over = ["%", "1.02"]

[[stages]]
name     = "coefficients"
stage    = "fit"
input    = "flights"
where    = "line like '$over'"
model    = "ridge"
target   = "mag_4_uc"
features = ["flux_a_x", "flux_a_y", "flux_a_z"]

[[stages]]
name     = "even"
stage    = "bandpass"
input    = "flights"
columns  = ["mag_4_uc"]
"#;

#[test]
fn user_an_unusable_line_gives_the_same_failure_by_tasks() {
    let bench = Bench::new();
    // Steps alternate between 0.08 and 0.12 s: one fit skips that line, and the other fit has no usable line.
    let uneven = changed(&line_of("1", "1.02", 500), "tt", |i, tt| if i % 2 == 1 { tt + 0.02 } else { tt });
    write(&bench.path("flights/1.parquet"), &[line_of("1", "1.01", 700), uneven]);
    bench.spec(FITS);
    let local = bench.run(&["--set", "store=whole"]);
    assert_eq!(local.code, 1);
    loop {
        let lines = tasks(&bench, "store", &["--units", "2"]);
        if lines.is_empty() {
            break;
        }
        // A failure caused by the data is a result.
        let output = task(&bench, "store", lines.join("\n").as_bytes(), &[]);
        assert!(output.status.success(), "{}", stderr(&output));
        let faults: Vec<Value> =
            receipts(&output).iter().flat_map(|r| r["units"].as_array().unwrap().clone()).collect();
        assert!(
            faults.iter().all(
                |u| u["outcome"] != "failed" || u["fault"]["what"].is_string() && u["fault"].get("owner").is_none()
            ),
            "{faults:?}"
        );
    }
    let last = bench.run(&[]);
    assert_eq!((last.code, last.total("computed"), last.total("failed")), (1, 0, local.total("failed")));
    let failures = texts(&read(&bench.path("store/tables/small/failures")), "error");
    assert!(failures.iter().filter(|e| e.contains("flight 1, line 1.02, column `tt`")).count() >= 2, "{failures:?}");
    assert!(failures.iter().any(|e| e.contains("none of the 1 selected lines can be used")), "{failures:?}");
    same(&bench, "whole", "store");
}

/// Runs a script of `datasets/examples/cluster` on the spec of these tests.
fn cluster(bench: &Bench, script: &str) -> Output {
    let scripts = crate::support::repository().join("datasets/examples/cluster");
    let magline = Path::new(env!("CARGO_BIN_EXE_magline")).parent().unwrap();
    let path = format!("{}:{}:{}", bench.path("bin").display(), magline.display(), std::env::var("PATH").unwrap());
    let mut command = Command::new("bash");
    command.arg(scripts.join(script)).args(["spec.toml", "store"]).current_dir(bench.folder.path());
    command.env("PATH", path).env("WORKERS", "2").output().unwrap()
}

#[test]
fn user_the_example_for_xargs_runs_a_spec_to_its_end() {
    let bench = Bench::new();
    assert_eq!(bench.run(&["--set", "store=whole"]).code, 0);
    let output = cluster(&bench, "xargs.sh");
    assert!(output.status.success(), "{}", stderr(&output));
    same(&bench, "whole", "store");
}

/// Replacement of Slurm's `sbatch`. It runs the tasks of a job array one after another, after the jobs that the array
/// depends on, and prints the number of the job. It checks the options that the scripts use, and implements nothing
/// else of Slurm.
const SBATCH: &str = r#"#!/bin/bash
set -e
array=none parsable=no
while [[ $1 == --* ]]; do
  case $1 in
    --array=*) array=${1#--array=} ;;
    --parsable) parsable=yes ;;
    --dependency=afterany:[0-9]*) ;;
    --job-name=*|--output=*|--requeue|--export=*) ;;
    *) echo "sbatch: unrecognized option $1" >&2; exit 2 ;;
  esac
  shift
done
number=$(( $(cat jobs 2>/dev/null || echo 0) + 1 )); echo $number > jobs
[ $parsable = yes ] && echo $number
script=$1; shift
if [ $array = none ]; then
  SLURM_JOB_ID=$number bash "$script" "$@" >> log 2>&1 < /dev/null
else
  for i in $(seq ${array%-*} ${array#*-}); do
    SLURM_JOB_ID=$number SLURM_ARRAY_TASK_ID=$i SLURM_ARRAY_TASK_COUNT=$(( ${array#*-} + 1 )) \
      bash "$script" "$@" >> log 2>&1 < /dev/null || true
  done
fi
"#;

#[test]
fn user_the_example_for_slurm_submits_itself_to_the_end() {
    use std::os::unix::fs::PermissionsExt;
    let bench = Bench::new();
    assert_eq!(bench.run(&["--set", "store=whole"]).code, 0);
    fs::create_dir(bench.path("bin")).unwrap();
    fs::write(bench.path("bin/sbatch"), SBATCH).unwrap();
    fs::set_permissions(bench.path("bin/sbatch"), fs::Permissions::from_mode(0o755)).unwrap();
    let output = cluster(&bench, "slurm.sh");
    let log = fs::read_to_string(bench.path("log")).unwrap_or_default();
    assert!(output.status.success(), "{} {log}", stderr(&output));
    // One planning job and one work job for each of six waves, and a final job that publishes the tables.
    assert_eq!(fs::read_to_string(bench.path("jobs")).unwrap().trim(), "13", "{log}");
    same(&bench, "whole", "store");
}
