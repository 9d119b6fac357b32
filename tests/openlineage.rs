//! Events of OpenLineage that a run writes to a file or sends to a server.

use std::{
    collections::BTreeMap,
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    path::Path,
    process::Command,
};

use serde_json::Value;

use crate::{
    json_schema::Schemas,
    schedule::{TABLES, summary},
    support::{Bench, SPEC, changed, line_of, repository, stderr, write},
};

/// Events of an OpenLineage file, validated against the schemas of events and facets.
fn events(path: &Path) -> Vec<Value> {
    let schemas = Schemas::read(&repository().join("tests/reference/openlineage"));
    let text = fs::read_to_string(path).unwrap();
    let found: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    for event in &found {
        assert_eq!(schemas.faults(event["schemaURL"].as_str().unwrap(), event), [""; 0], "{event}");
        facets(&schemas, event);
    }
    found
}

fn facets(schemas: &Schemas, value: &Value) {
    if let Some(url) = value.get("_schemaURL") {
        assert_eq!(schemas.faults(url.as_str().unwrap(), value), [""; 0], "{value}");
    }
    let inner: Vec<&Value> = match value {
        Value::Array(all) => all.iter().collect(),
        Value::Object(all) => all.values().collect(),
        _ => vec![],
    };
    inner.into_iter().for_each(|v| facets(schemas, v));
}

fn kinds(events: &[Value]) -> Vec<(String, String)> {
    let one = |e: &Value| (e["job"]["name"].as_str().unwrap().to_owned(), e["eventType"].as_str().unwrap().to_owned());
    events.iter().map(one).collect()
}

#[test]
fn user_openlineage_events_name_every_hop_from_the_files_to_the_scores() {
    let bench = Bench::new();
    let done = bench.run(&["--openlineage", "events.jsonl", "--summary", "summary.json"]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let found = events(&bench.path("events.jsonl"));
    let pair = |name: String| [(name.clone(), "START".to_owned()), (name, "COMPLETE".to_owned())];
    let tables = TABLES.iter().flat_map(|t| pair(format!("small.{t}")));
    let [first, last] = pair("small".to_owned());
    let expected: Vec<(String, String)> = std::iter::once(first).chain(tables).chain([last]).collect();
    assert_eq!(kinds(&found), expected);
    // One run for the pipeline, with the identifier of the summary, and one child run for each table.
    let id = summary(&bench)["id"].clone();
    let mut runs: BTreeMap<String, Vec<Value>> = BTreeMap::new();
    for event in &found {
        let job = event["job"]["name"].as_str().unwrap();
        runs.entry(job.to_owned()).or_default().push(event["run"]["runId"].clone());
        if job != "small" {
            let parent = &event["run"]["facets"]["parent"];
            assert_eq!((&parent["run"]["runId"], &parent["job"]["name"]), (&id, &"small".into()));
            assert_eq!(parent["root"]["run"]["runId"], id);
        }
    }
    assert!(runs.values().all(|ids| ids.len() == 2 && ids[0] == ids[1]));
    assert_eq!(runs["small"][0], id);
    let distinct: std::collections::BTreeSet<String> = runs.values().map(|ids| ids[0].to_string()).collect();
    assert_eq!(distinct.len(), 7);
    // The spec is a facet. Files are datasets with versions, and each table is the input of downstream tables.
    assert_eq!(found[0]["job"]["facets"]["sourceCode"]["sourceCode"], SPEC);
    let of = |table: &str| found.iter().rfind(|e| e["job"]["name"] == format!("small.{table}")).unwrap();
    let folder = bench.folder.path().canonicalize().unwrap();
    let host = fs::read_to_string("/proc/sys/kernel/hostname").map(|h| h.trim().to_owned());
    let even = of("even");
    assert_eq!(even["inputs"][0]["name"], folder.join("flights").display().to_string());
    if let Ok(host) = host {
        assert_eq!(even["inputs"][0]["namespace"], format!("file://{host}"));
    }
    assert_eq!(even["outputs"][0]["name"], folder.join("store/tables/small/even").display().to_string());
    let version = |d: &Value| d["facets"]["version"]["datasetVersion"].as_str().unwrap().to_owned();
    assert_eq!(of("terms")["inputs"][0]["name"], even["outputs"][0]["name"]);
    assert_eq!(version(&of("terms")["inputs"][0]), version(&even["outputs"][0]));
    let track: Vec<&str> =
        of("track")["inputs"].as_array().unwrap().iter().map(|i| i["name"].as_str().unwrap()).collect();
    assert!(
        track.iter().any(|n| n.ends_with("/map.parquet")) && track.iter().any(|n| n.ends_with("/clean")),
        "{track:?}"
    );
    let scores: Vec<&Value> = of("scores")["inputs"].as_array().unwrap().iter().collect();
    assert_eq!(scores.len(), 2);
    let columns = &of("clean")["outputs"][0]["facets"]["columnLineage"]["fields"];
    let from = |column: &str| {
        let inputs = columns[column]["inputFields"].as_array().unwrap().iter();
        inputs
            .map(|i| (i["field"].as_str().unwrap().to_owned(), i["transformations"][0]["subtype"].clone()))
            .collect::<Vec<_>>()
    };
    assert!(from("mag_c").contains(&("tl".to_owned(), "TRANSFORMATION".into())), "{:?}", from("mag_c"));
    assert_eq!(from("lat"), [("lat".to_owned(), "IDENTITY".into())]);
    let schema = of("clean")["outputs"][0]["facets"]["schema"]["fields"].as_array().unwrap().clone();
    let mag = schema.iter().find(|f| f["name"] == "mag_c").unwrap();
    assert!(mag["description"].as_str().unwrap().ends_with("[nT]"), "{mag}");
    // The lineage of a store is an event of the same schema.
    let view = bench.magline(&["lineage", "small.clean", "--store", "store", "--format", "openlineage"]);
    let view: Value = serde_json::from_slice(&view.stdout).unwrap();
    fs::write(bench.path("view.jsonl"), view.to_string()).unwrap();
    assert_eq!(kinds(&events(&bench.path("view.jsonl"))), [("small.clean".to_owned(), "COMPLETE".to_owned())]);
    // Another store gives the same events except for identifiers and times.
    fs::remove_dir_all(bench.path("store")).unwrap();
    bench.run(&["--openlineage", "again.jsonl", "--threads", "1"]);
    let plain = |events: Vec<Value>| events.into_iter().map(anonymous).collect::<Vec<_>>();
    let again = events(&bench.path("again.jsonl"));
    assert_ne!(again[0]["run"]["runId"], id);
    assert_eq!(plain(again), plain(found.clone()));
    // A changed byte of an input changes the version of the input and the versions of its dependents.
    write(&bench.path("flights/2.parquet"), &[line_of("2", "2.01", 600)]);
    bench.run(&["--openlineage", "third.jsonl"]);
    let third = events(&bench.path("third.jsonl"));
    let changed = third.iter().rfind(|e| e["job"]["name"] == "small.even").unwrap();
    assert_ne!(version(&changed["inputs"][0]), version(&even["inputs"][0]));
    assert_ne!(version(&changed["outputs"][0]), version(&even["outputs"][0]));
}

fn anonymous(mut event: Value) -> Value {
    let keys = ["eventTime", "runId"];
    fn walk(value: &mut Value, keys: &[&str]) {
        match value {
            Value::Object(all) => {
                all.retain(|k, _| !keys.contains(&k.as_str()));
                all.values_mut().for_each(|v| walk(v, keys));
            }
            Value::Array(all) => all.iter_mut().for_each(|v| walk(v, keys)),
            _ => {}
        }
    }
    walk(&mut event, &keys);
    event
}

#[test]
fn user_openlineage_reports_failures_and_the_run_of_the_scheduler() {
    let bench = Bench::new();
    write(&bench.path("flights/3.parquet"), &[changed(&line_of("3", "3.01", 500), "lat", |_, _| 95.0)]);
    let parent = "airflow/nightly.sweep/0190b2a5-2b3c-7def-8a01-23456789abcd";
    let output = Command::new(env!("CARGO_BIN_EXE_magline"))
        .args(["run", "spec.toml", "-q", "--openlineage", "events.jsonl"])
        .env("OPENLINEAGE_PARENT_ID", parent)
        .env("OPENLINEAGE_NAMESPACE", "geo")
        .current_dir(bench.folder.path())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let found = events(&bench.path("events.jsonl"));
    let last = found.last().unwrap();
    assert_eq!((&last["eventType"], &last["job"]["namespace"]), (&"FAIL".into(), &"geo".into()));
    assert!(last["run"]["facets"]["errorMessage"]["message"].as_str().unwrap().contains("lat"), "{last}");
    for event in &found {
        let facet = &event["run"]["facets"]["parent"];
        let above = if event["job"]["name"] == "small" { facet } else { &facet["root"] };
        assert_eq!(above["job"]["name"], "nightly.sweep");
        assert_eq!(above["run"]["runId"], "0190b2a5-2b3c-7def-8a01-23456789abcd");
    }
    let even = found.iter().rfind(|e| e["job"]["name"] == "small.even").unwrap();
    assert_eq!(even["eventType"], "FAIL");
    assert!(even["run"]["facets"]["errorMessage"]["message"].as_str().unwrap().starts_with("1 of 5 units"), "{even}");
    // A stopped run is aborted. An invalid spec gives no run.
    bench.run(&["--openlineage", "stopped.jsonl", "--max-time=0s", "--set", "store=other"]);
    let stopped = kinds(&events(&bench.path("stopped.jsonl")));
    assert_eq!(stopped.first().unwrap().1, "START");
    assert_eq!(stopped.last().unwrap(), &("small".to_owned(), "ABORT".to_owned()));
    bench.run(&["--openlineage", "wrong.jsonl", "--set", "even.rate=3"]);
    assert!(!bench.path("wrong.jsonl").exists());
}

/// Answers each request with `status` and returns the request bodies when the client ends.
fn serve(listener: TcpListener, status: &'static str) -> std::thread::JoinHandle<Vec<(String, Value)>> {
    std::thread::spawn(move || {
        let mut bodies = vec![];
        for stream in listener.incoming() {
            let Ok(stream) = stream else { break };
            if !one_client(stream, status, &mut bodies) {
                break;
            }
        }
        bodies
    })
}

/// Answers one request of a connection.
fn one_client(stream: TcpStream, status: &str, bodies: &mut Vec<(String, Value)>) -> bool {
    let mut reader = BufReader::new(stream.try_clone().unwrap());
    let (mut head, mut length) = (String::new(), 0);
    loop {
        let mut line = String::new();
        if reader.read_line(&mut line).unwrap_or(0) == 0 {
            return true;
        }
        if let Some(n) = line.to_ascii_lowercase().strip_prefix("content-length:") {
            length = n.trim().parse().unwrap();
        }
        let end = line == "\r\n";
        head.push_str(&line);
        if end {
            break;
        }
    }
    if head.starts_with("GET /stop") {
        return false;
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).unwrap();
    bodies.push((head, serde_json::from_slice(&body).unwrap()));
    write!(&stream, "HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n").unwrap();
    true
}

#[test]
fn user_openlineage_is_sent_to_a_server_and_an_unreachable_server_is_no_failure() {
    let bench = Bench::new();
    let sent = |status: &'static str, store: &str| {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let server = serve(listener, status);
        let output = Command::new(env!("CARGO_BIN_EXE_magline"))
            .args(["run", "spec.toml", "-q", "--until", "terms", "--openlineage", &format!("http://{address}")])
            .args(["--set", &format!("store={store}")])
            .env("OPENLINEAGE_API_KEY", "secret")
            .env_remove("http_proxy")
            .env_remove("HTTP_PROXY")
            .env_remove("ALL_PROXY")
            .current_dir(bench.folder.path())
            .output()
            .unwrap();
        write!(TcpStream::connect(address).unwrap(), "GET /stop HTTP/1.1\r\n\r\n").unwrap();
        (output, server.join().unwrap())
    };
    let (output, bodies) = sent("201 Created", "one");
    assert!(output.status.success() && stderr(&output).is_empty(), "{}", stderr(&output));
    assert_eq!(bodies.len(), 2 * 3);
    assert!(bodies.iter().all(|(head, _)| head.starts_with("POST /api/v1/lineage HTTP/1.1")));
    assert!(bodies.iter().all(|(head, _)| head.to_ascii_lowercase().contains("authorization: bearer secret")));
    assert_eq!(bodies[0].1["eventType"], "START");
    assert_eq!(bodies.last().unwrap().1["eventType"], "COMPLETE");
    let (output, bodies) = sent("400 Bad Request", "two");
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("warning: OpenLineage events are lost: 6 events"), "{}", stderr(&output));
    // After a failure the server receives no further requests.
    assert_eq!(bodies.len(), 3);
    let closed = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let output = bench.magline(&["run", "spec.toml", "-q", "--openlineage", &format!("http://{closed}")]);
    assert!(output.status.success() && stderr(&output).contains("events are lost"), "{}", stderr(&output));
    let output = bench.magline(&["run", "spec.toml", "--openlineage", "https://localhost"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("TLS is not supported"), "{}", stderr(&output));
}
