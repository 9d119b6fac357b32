//! A run on a cluster gives the same bytes and computes each unit once, for any failure of its processes.

use std::{
    collections::BTreeMap,
    convert::Infallible,
    future::{Ready, ready},
    io::{BufRead, BufReader, Read},
    net::TcpListener,
    process::{Child, Command, Output, Stdio},
    sync::mpsc::channel,
    task::{Context, Poll},
    thread::spawn,
    time::Duration,
};

use serde_json::Value;
use tonic::{
    body::Body,
    codegen::{Service, http},
    transport::{Server, server::TcpIncoming},
};

use crate::{
    cluster_support::{Cluster, KEY_FILE, until},
    support::{Bench, stderr, stdout},
    tasks::same,
};

const MAGLINE: &str = env!("CARGO_BIN_EXE_magline");

/// Flights whose run takes several seconds, and the number of units of a local run.
fn scene() -> (Bench, u64) {
    let bench = Bench::of_many_lines();
    let local = bench.run(&["--set", "store=whole"]);
    assert_eq!(local.code, 0, "{}", local.stderr);
    (bench, local.total("computed"))
}

/// Starts a run on the cluster.
fn begun(bench: &Bench, cluster: &Cluster, more: &[&str]) -> Child {
    Command::new(MAGLINE)
        .args(["run", "spec.toml", "--json", "--engine", &cluster.engine(), "--key-file", KEY_FILE])
        .args(more)
        .current_dir(bench.folder.path())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Exit status and last event of a run.
fn ended(output: &Output) -> (i32, Value) {
    let last = stdout(output).lines().last().map(|l| serde_json::from_str(l).unwrap()).unwrap_or(Value::Null);
    (output.status.code().unwrap(), last)
}

fn total(last: &Value, what: &str) -> u64 {
    last[what].as_u64().unwrap_or_else(|| panic!("no {what} in {last}"))
}

/// Number of computations of each unit according to the workers' receipts.
fn computed(cluster: &Cluster) -> BTreeMap<String, usize> {
    let mut found = BTreeMap::new();
    for line in cluster.receipts() {
        // The last line of a killed worker may be truncated.
        let Ok(receipt) = serde_json::from_str::<Value>(&line) else { continue };
        for unit in receipt["units"].as_array().unwrap().iter().filter(|u| u["outcome"] == "computed") {
            *found.entry(unit["key"].as_str().unwrap().to_owned()).or_default() += 1;
        }
    }
    found
}

fn assert_once(cluster: &Cluster) {
    let computed = computed(cluster);
    let twice: Vec<_> = computed.iter().filter(|(_, n)| **n != 1).collect();
    assert!(twice.is_empty(), "{twice:?}");
}

/// Waits until the first receipts arrive, while other tasks are still running.
fn under_way(cluster: &Cluster) {
    until("some tasks are answered", || cluster.receipts().len() >= 8);
}

fn send(signal: &str, child: &Child) {
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
}

#[test]
fn user_a_cluster_gives_the_bytes_of_a_local_run_and_each_unit_once() {
    let (bench, units) = scene();
    let cluster = Cluster::new(MAGLINE, bench.folder.path(), 2);
    let output = begun(&bench, &cluster, &[]).wait_with_output().unwrap();
    let (code, last) = ended(&output);
    assert_eq!(code, 0, "{} {}", stderr(&output), cluster.worker_stderr());
    assert_eq!((total(&last, "computed"), total(&last, "failed")), (units, 0));
    same(&bench, "whole", "store");
    let counted = computed(&cluster);
    assert_eq!(counted.len() as u64, units);
    assert_once(&cluster);
    for worker in &cluster.workers {
        assert!(std::fs::metadata(&worker.1).unwrap().len() > 0, "each worker had its part");
    }
    // Each unit is reported once, independent of the worker that computed it.
    let text = stdout(&output);
    let unit_events =
        text.lines().filter(|l| l.starts_with(r#"{"event":"unit""#) && l.contains(r#""status":"computed""#));
    assert_eq!(unit_events.count() as u64, units);
    assert!(!bench.path("store/attempts").read_dir().unwrap().any(|_| true));
    // Another run reuses all results. `gc` works once the store is unused.
    let again = bench.run(&["--engine", &cluster.engine(), "--key-file", KEY_FILE]);
    assert_eq!((again.code, again.total("computed"), again.total("reused")), (0, 0, units));
    until("the processes of the workers have ended", || {
        let gc = bench.magline(&["gc", "--yes"]);
        assert!(gc.status.success());
        !stdout(&gc).contains("a run is using the store")
    });
    same(&bench, "whole", "store");
}

#[test]
fn user_a_killed_worker_costs_only_its_unfinished_tasks() {
    let (bench, units) = scene();
    let mut cluster = Cluster::new(MAGLINE, bench.folder.path(), 2);
    let run = begun(&bench, &cluster, &[]);
    under_way(&cluster);
    cluster.kill(0);
    let output = run.wait_with_output().unwrap();
    let (code, last) = ended(&output);
    assert_eq!(code, 0, "{} {}", stderr(&output), cluster.worker_stderr());
    // Results that the worker finished without a receipt are reused.
    assert_eq!(total(&last, "computed") + total(&last, "reused"), units);
    same(&bench, "whole", "store");
    assert_once(&cluster);
}

#[test]
fn user_a_restarted_scheduler_keeps_finished_results() {
    let (bench, units) = scene();
    let mut cluster = Cluster::new(MAGLINE, bench.folder.path(), 2);
    let run = begun(&bench, &cluster, &["--patience", "200s"]);
    under_way(&cluster);
    // Long enough for the workers to lose the scheduler and register again.
    cluster.another_scheduler(Duration::from_secs(8));
    let output = run.wait_with_output().unwrap();
    let (code, last) = ended(&output);
    assert_eq!(code, 0, "{} {}", stderr(&output), cluster.worker_stderr());
    assert_eq!(total(&last, "computed") + total(&last, "reused"), units);
    same(&bench, "whole", "store");
    assert_once(&cluster);
}

#[test]
fn bug_a_run_waits_for_a_scheduler_that_starts_after_it() {
    let bench = Bench::new();
    let units = bench.run(&["--set", "store=whole"]).total("computed");
    let mut cluster = Cluster::new(MAGLINE, bench.folder.path(), 1);
    // The worker, which may not have been registered, waits as well.
    cluster.kill_scheduler();
    let mut run = begun(&bench, &cluster, &["--patience", "200s"]);
    let mut messages = BufReader::new(run.stderr.take().unwrap());
    let mut first = String::new();
    messages.read_line(&mut first).unwrap();
    assert!(first.contains("waiting up to 200 s"), "{first}");
    cluster.start_scheduler();
    let output = run.wait_with_output().unwrap();
    let (code, last) = ended(&output);
    let mut rest = String::new();
    messages.read_to_string(&mut rest).unwrap();
    assert_eq!((code, total(&last, "computed")), (0, units), "{rest} {}", cluster.worker_stderr());
}

#[test]
fn user_a_run_without_workers_fails_with_a_message_and_the_next_run_resumes() {
    let (bench, units) = scene();
    let mut cluster = Cluster::new(MAGLINE, bench.folder.path(), 2);
    let run = begun(&bench, &cluster, &["--patience", "8s"]);
    under_way(&cluster);
    cluster.kill(0);
    cluster.kill(1);
    let output = run.wait_with_output().unwrap();
    let (code, last) = ended(&output);
    assert_eq!(code, 1, "{}", stderr(&output));
    let messages = last["failures"].to_string();
    assert!(
        messages.contains("no worker has been registered with the scheduler") && messages.contains("for 8 s"),
        "{messages}"
    );
    let finished = total(&last, "computed");
    assert!(finished > 0 && finished < units, "{finished} of {units}");
    // The run waited for workers before it ended.
    assert!(stdout(&output).contains(r#"{"event":"waiting","for":"a worker of "#), "{}", stdout(&output));
    cluster.add("store");
    let again = begun(&bench, &cluster, &[]).wait_with_output().unwrap();
    let (code, last) = ended(&again);
    assert_eq!(code, 0, "{} {}", stderr(&again), cluster.worker_stderr());
    assert!(total(&last, "reused") >= finished && total(&last, "computed") > 0);
    // Results published without the others are in separate files.
    assert!(bench.magline(&["compact", "spec.toml"]).status.success());
    same(&bench, "whole", "store");
    assert_once(&cluster);
}

#[test]
fn user_two_runs_at_once_share_a_cluster() {
    let (bench, units) = scene();
    let cluster = Cluster::new(MAGLINE, bench.folder.path(), 2);
    // Another pipeline with other units of the same flights.
    let other = crate::support::SPEC.replace("\"small\"", "\"other\"").replace("0.025", "0.25");
    std::fs::write(bench.path("other.toml"), other).unwrap();
    let other = ["run", "other.toml", "--json", "--set"];
    let local = bench.magline(&[other.as_slice(), &["store=whole"]].concat());
    assert!(local.status.success(), "{}", stderr(&local));
    let first = begun(&bench, &cluster, &[]);
    let second = Command::new(MAGLINE)
        .args(other)
        .args(["store=store", "--engine", &cluster.engine(), "--key-file", KEY_FILE])
        .current_dir(bench.folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    for run in [first, second] {
        let output = run.wait_with_output().unwrap();
        let (code, last) = ended(&output);
        assert_eq!(code, 0, "{} {}", stderr(&output), cluster.worker_stderr());
        // A shared unit is computed by one run, or by both at the same time.
        assert_eq!(total(&last, "computed") + total(&last, "reused"), units);
    }
    let (expected, found) = (bench.tables("whole"), bench.tables("store"));
    assert_eq!(expected.keys().collect::<Vec<_>>(), found.keys().collect::<Vec<_>>());
    assert!(expected == found, "the tables differ");
}

#[test]
fn user_an_interrupted_run_cancels_its_tasks_and_resumes() {
    let (bench, units) = scene();
    let cluster = Cluster::new(MAGLINE, bench.folder.path(), 2);
    let run = begun(&bench, &cluster, &[]);
    under_way(&cluster);
    send("-INT", &run);
    let output = run.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
    let before = computed(&cluster).len() as u64;
    assert!(before < units, "it was over too soon");
    let again = begun(&bench, &cluster, &[]).wait_with_output().unwrap();
    assert_eq!(ended(&again).0, 0, "{} {}", stderr(&again), cluster.worker_stderr());
    same(&bench, "whole", "store");
    // A cancelled unit does not count as an attempt.
    assert!(!bench.path("store/attempts").read_dir().unwrap().any(|_| true));
}

#[test]
fn user_a_stopping_worker_returns_its_waiting_tasks() {
    let (bench, units) = scene();
    let mut cluster = Cluster::new(MAGLINE, bench.folder.path(), 2);
    let run = begun(&bench, &cluster, &[]);
    under_way(&cluster);
    send("-TERM", &cluster.workers[0].0);
    assert_eq!(cluster.workers[0].0.wait().unwrap().code(), Some(0), "{}", cluster.worker_stderr());
    let output = run.wait_with_output().unwrap();
    let (code, last) = ended(&output);
    assert_eq!(code, 0, "{} {}", stderr(&output), cluster.worker_stderr());
    assert_eq!(total(&last, "computed") + total(&last, "reused"), units);
    same(&bench, "whole", "store");
    assert_once(&cluster);
}

#[test]
fn user_a_worker_with_another_store_exits_with_a_message_and_the_others_compute() {
    let (bench, units) = scene();
    let mut cluster = Cluster::new(MAGLINE, bench.folder.path(), 0);
    cluster.add("elsewhere");
    let alone = begun(&bench, &cluster, &["--patience", "4s"]).wait_with_output().unwrap();
    let (code, last) = ended(&alone);
    let messages = last["failures"].to_string();
    assert_eq!(code, 1, "{}", stderr(&alone));
    assert!(
        messages.contains("the last worker rejected its task") && messages.contains("there is no store elsewhere"),
        "{messages}"
    );
    assert_eq!(cluster.workers[0].0.wait().unwrap().code(), Some(1));
    assert!(cluster.worker_stderr().contains("there is no store elsewhere"), "{}", cluster.worker_stderr());
    assert!(!bench.path("elsewhere").exists());
    // A store of other runs.
    let other = bench.run(&["--set", "store=elsewhere", "--set", "axes.lambda=[0.5]"]);
    assert_eq!(other.code, 0);
    cluster.add("elsewhere");
    cluster.add("store");
    let output = begun(&bench, &cluster, &[]).wait_with_output().unwrap();
    let (code, last) = ended(&output);
    assert_eq!(code, 0, "{} {}", stderr(&output), cluster.worker_stderr());
    assert_eq!(total(&last, "computed"), units);
    same(&bench, "whole", "store");
    // The worker may have received no task.
    let left = cluster.workers[1].0.try_wait().unwrap();
    let messages = cluster.worker_stderr();
    assert!(
        left.is_none_or(|left| left.code() == Some(1) && messages.contains("does not contain the plan")),
        "{messages}"
    );
}

/// Server that answers every request with the same text.
#[derive(Clone)]
struct FixedAnswer(&'static str);

impl Service<http::Request<Body>> for FixedAnswer {
    type Response = http::Response<Body>;
    type Error = Infallible;
    type Future = Ready<Result<Self::Response, Infallible>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, _: http::Request<Body>) -> Self::Future {
        ready(Ok(http::Response::new(Body::new(self.0.to_owned()))))
    }
}

/// Server that answers as a scheduler of another version, without a key.
fn stranger(state: &'static str) -> String {
    let (sender, receiver) = channel();
    spawn(move || {
        tokio::runtime::Runtime::new().unwrap().block_on(async {
            let incoming = TcpIncoming::bind("127.0.0.1:0".parse().unwrap()).unwrap();
            sender.send(incoming.local_addr().unwrap().to_string()).unwrap();
            Server::builder().serve_with_incoming(FixedAnswer(state), incoming).await
        })
    });
    receiver.recv().unwrap()
}

#[test]
fn user_foreign_servers_and_schedulers_of_another_version_are_rejected() {
    let bench = Bench::new();
    let open = "--insecure-loopback";
    let run = |at: &str| {
        let engine = format!("ballista://{at}");
        bench.magline(&["run", "spec.toml", "--engine", &engine, "--patience", "1s", open])
    };
    let worker = |at: &str| bench.magline(&["worker", "--scheduler", at, "--cores", "1", open]);
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
    let silent = run(&free);
    let messages = stderr(&silent);
    assert!(
        silent.status.code() == Some(1) && messages.contains(&format!("cannot connect to the scheduler at {free}")),
        "{messages}"
    );
    assert!(messages.contains("waiting up to 1 s"), "{messages}");
    assert!(messages.contains("magline scheduler --bind"), "{messages}");
    for (state, is) in [
        (r#"{"scheduler_id":"magline-9.9.9-4711"}"#, "is magline 9.9.9; this is magline"),
        (r#"{"scheduler_id":"5c1e"}"#, "is not a scheduler of magline"),
        ("<html>", "is not a Ballista scheduler"),
    ] {
        let at = stranger(state);
        let output = run(&at);
        let status = if state.starts_with('{') { 2 } else { 1 };
        assert!(output.status.code() == Some(status) && stderr(&output).contains(is), "{}", stderr(&output));
        if status == 2 {
            let output = worker(&at);
            assert!(output.status.code() == Some(2) && stderr(&output).contains(is), "{}", stderr(&output));
        }
    }
    let far = bench.magline(&["worker", "--scheduler", "node-7.cluster:50050", open]);
    assert!(far.status.code() == Some(2) && stderr(&far).contains("--bind"), "{}", stderr(&far));
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let output = bench.magline(&["scheduler", "--bind", &taken.local_addr().unwrap().to_string(), open]);
    assert!(output.status.code() == Some(1) && stderr(&output).contains("cannot listen on"), "{}", stderr(&output));
    assert!(!bench.path("store/tables").exists(), "nothing was run");
}
