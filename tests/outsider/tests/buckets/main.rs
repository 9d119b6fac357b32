//! Stores, inputs and published sets in buckets of a server that rejects, truncates and delays. The stored bytes are
//! the same as for a store in a folder.
#![allow(clippy::unwrap_used, clippy::panic)]

#[cfg(feature = "cluster")]
mod cluster;
#[allow(dead_code)]
#[path = "../../../cluster_support.rs"]
mod cluster_support;
mod google;
mod google_tests;
mod lab;
mod server;

use std::{
    collections::HashSet,
    fs,
    net::TcpListener,
    path::Path,
    process::Child,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::channel,
    },
    thread::scope,
    time::{Duration, Instant},
};

use cluster_support::until;
use hyper::Method;
use lab::{Files, Lab, SPEC, address, assert_same, ended, files, flight, store_of, tables};
use server::{Asked, BUCKET, Fault, Server, USERS};

/// The rows of a table, sorted.
fn rows(lab: &Lab, table: &str, store: &str) -> Vec<String> {
    let query = format!("SELECT * FROM {table}");
    let done = lab.magline(&["sql", &query, "--store", store, "--format", "json"]);
    assert_eq!(done.code, 0, "{}", done.err);
    let mut rows: Vec<String> = done.out.lines().map(str::to_owned).collect();
    rows.sort();
    rows
}

#[test]
fn user_a_store_in_a_bucket_has_the_bytes_of_one_in_a_folder() {
    let lab = Lab::new();
    let (expected, units) = lab.local();
    let cache = lab.cache();
    let run = lab.run(&address("one"), &cache, &[]);
    assert_eq!(run.counts(), (0, units, 0), "{}", run.err);
    assert_same(&expected, &files(&store_of(&cache)), "the cache");
    lab.assert_bucket("one", &expected, "the bucket");
    let written = lab.packs_written();
    assert!(!written.is_empty() && written.values().all(|n| *n == 1), "{written:?}");
    for cache in [cache, lab.cache()] {
        let again = lab.run(&address("one"), &cache, &[]);
        assert_eq!(again.counts(), (0, 0, units), "{}", again.err);
    }
    assert_eq!(lab.packs_written(), written);
    assert_eq!(rows(&lab, "small.smooth", &address("one")), rows(&lab, "small.smooth", "whole"));
    let verified = lab.magline(&["verify", "--store", &address("one")]);
    assert_eq!(verified.code, 0, "{}", verified.err);
    // Workers have the address of the store and no input.
    let run = lab.run(&address("two"), &lab.cache(), &["--engine", "processes", "--threads", "2"]);
    assert_eq!(run.counts(), (0, units, 0), "{}", run.err);
    assert_same(&tables(&lab.path("whole")), &tables(&lab.server.path("two")), "by processes");
    // A flipped bit is detected and reported, and its unit is recomputed. Only the largest pack holds the filtered
    // lines.
    let packs = expected.iter().filter(|(name, _)| name.starts_with("objects/"));
    let pack = packs.max_by_key(|(_, bytes)| bytes.len()).unwrap().0;
    let object = lab.server.path(&format!("one/{pack}"));
    let mut bytes = fs::read(&object).unwrap();
    bytes[100] ^= 4;
    fs::write(&object, bytes).unwrap();
    let verified = lab.magline(&["verify", "--store", &address("one")]);
    assert!(
        verified.code == 1 && format!("{}{}", verified.out, verified.err).contains(pack),
        "{}{}",
        verified.out,
        verified.err
    );
    let mended = lab.run(&address("one"), &lab.cache(), &[]);
    assert_eq!(mended.counts(), (0, 24, 8), "{}", mended.err);
    lab.assert_packs("one", &expected);
}

type Decide = Box<dyn FnMut(&Asked) -> Fault + Send>;

/// Server faults by name.
fn faults() -> Vec<(&'static str, Decide)> {
    let every =
        |n: usize, fault: Fault| move |asked: &Asked| if asked.number.is_multiple_of(n) { fault } else { Fault::None };
    let of = |is: fn(&Asked) -> bool, n: usize, fault: Fault| {
        let mut seen = 0;
        move |asked: &Asked| {
            seen += usize::from(is(asked));
            if is(asked) && seen % n == 0 { fault } else { Fault::None }
        }
    };
    let mut met = HashSet::new();
    let conflict = move |asked: &Asked| {
        let first = asked.on_condition && met.insert(asked.key.clone());
        if first { Fault::Status(409) } else { Fault::None }
    };
    vec![
        ("every fifth request is refused with 500", Box::new(every(5, Fault::Status(500)))),
        ("every seventh request is too much", Box::new(every(7, Fault::Status(503)))),
        ("every fourth answer is cut", Box::new(of(|a| a.method == Method::GET, 4, Fault::Cut))),
        (
            "every second pack is cut, and its length agrees",
            Box::new(of(|a| a.method == Method::GET && a.key.contains("/objects/"), 2, Fault::Short)),
        ),
        ("some requests are never answered", Box::new(every(30, Fault::Silent))),
        ("some are done and never answered", Box::new(of(|a| a.method != Method::GET, 15, Fault::Late))),
        ("conditional writes are done and never answered", Box::new(of(|a| a.on_condition, 2, Fault::Late))),
        ("conditional writes are done and refused", Box::new(of(|a| a.on_condition, 2, Fault::Lost(500)))),
        ("conditional writes meet others", Box::new(conflict)),
    ]
}

#[test]
fn user_faults_of_the_server_change_no_byte() {
    scope(|scope| {
        for (what, decide) in faults() {
            scope.spawn(move || {
                let lab = Lab::new();
                let (expected, units) = lab.local();
                let count = lab.faults(decide);
                let cache = lab.cache();
                let run = lab.run(&address("one"), &cache, &[]);
                assert_eq!(run.counts(), (0, units, 0), "{what}: {}", run.err);
                // Another machine reads all results.
                let again = lab.run(&address("one"), &lab.cache(), &[]);
                assert_eq!(again.counts(), (0, 0, units), "{what}: {}", again.err);
                assert_eq!(rows(&lab, "small.smooth", &address("one")).len(), 4 * 2 * 300 * 3, "{what}");
                let met = count.load(Ordering::Relaxed);
                assert!(met > 1, "{what}: {met} faults");
                lab.server.faults(|_| Fault::None);
                assert_same(&expected, &files(&store_of(&cache)), what);
                lab.assert_bucket("one", &expected, what);
            });
        }
    });
}

#[test]
fn user_a_killed_run_resumes() {
    let lab = Lab::new();
    let (expected, units) = lab.local();
    let (cache, mut killed) = (lab.cache(), 0);
    let listed = Arc::new(AtomicBool::new(false));
    // Each repetition kills the run at a later write, before or after the write is executed. In one case, a version has
    // a manifest but lacks files.
    loop {
        let (sender, answered) = channel();
        let (mut left, fault) = (1 + 2 * killed, if killed % 2 == 0 { Fault::Late } else { Fault::Silent });
        let listed = listed.clone();
        lab.server.faults(move |asked| {
            if asked.method != Method::PUT || left == 0 {
                return Fault::None;
            }
            left -= 1;
            if asked.key.contains("/tables/failures/") && !listed.swap(true, Ordering::SeqCst) {
                left = 0;
                sender.send(()).unwrap();
                return Fault::Silent;
            }
            if left == 0 {
                sender.send(()).unwrap();
                return fault;
            }
            Fault::None
        });
        let mut child: Child = lab.begun(&address("one"), USERS[0], &cache, &[]);
        let mut over = false;
        until("the run is to be killed, or is over", || {
            over = child.try_wait().unwrap().is_some();
            over || answered.try_recv().is_ok()
        });
        if over {
            let run = ended(child);
            assert_eq!((run.code, run.total("computed") + run.total("reused")), (0, units), "{}", run.err);
            break;
        }
        child.kill().unwrap();
        child.wait().unwrap();
        killed += 1;
    }
    assert!(killed >= 5 && listed.load(Ordering::SeqCst), "killed {killed} times");
    lab.assert_bucket("one", &expected, "killed");
    assert!(lab.packs_written().values().all(|n| *n == 1), "what was written is found: {:?}", lab.packs_written());
    let cold = lab.run(&address("one"), &lab.cache(), &[]);
    assert_eq!(cold.counts(), (0, 0, units), "{}", cold.err);
    // Manifests of unpublished versions do not count as damage.
    let verified = lab.magline(&["verify", "--store", &address("one")]);
    assert_eq!(verified.code, 0, "{}{}", verified.out, verified.err);
}

#[test]
fn user_two_runs_at_once_compute_each_unit_once() {
    let lab = Lab::new();
    let (expected, units) = lab.local();
    let open = Arc::new(AtomicBool::new(false));
    let gate = open.clone();
    // The first run stays active until the second and third runs have met its lock.
    lab.server.faults(move |asked| {
        let held = asked.user == USERS[0] && asked.writes_pack() && !gate.load(Ordering::SeqCst);
        if held { Fault::Status(503) } else { Fault::None }
    });
    let first = lab.begun(&address("one"), USERS[0], &lab.cache(), &[]);
    until("the first run writes", || lab.server.asked().iter().any(Asked::writes_pack));
    let second = lab.begun(&address("one"), USERS[1], &lab.cache(), &["--wait"]);
    let third = ended(lab.begun(&address("one"), USERS[2], &lab.cache(), &[]));
    assert_eq!(third.code, 3, "{}", third.err);
    assert!(
        third.err.contains(&format!("holds the lock in {}: process {}", address("one"), first.id())),
        "{}",
        third.err
    );
    open.store(true, Ordering::SeqCst);
    let [first, second] = [first, second].map(ended);
    assert_eq!((first.counts(), second.counts()), ((0, units, 0), (0, 0, units)), "{} {}", first.err, second.err);
    assert!(lab.packs_written().values().all(|n| *n == 1));
    lab.assert_bucket("one", &expected, "two runs");
}

#[test]
fn user_two_pipelines_at_once_share_a_bucket() {
    let lab = Lab::new();
    lab.local();
    fs::write(lab.path("other.toml"), SPEC.replace("\"small\"", "\"other\"").replace("1.5]", "2.5]")).unwrap();
    let set = format!("store={}", address("one"));
    let other = ["run", "other.toml", "--json", "--set", &set];
    let first = lab.begun(&address("one"), USERS[0], &lab.cache(), &[]);
    let second = lab.start(&other, &lab.env(USERS[1], &lab.cache()));
    for run in [first, second].map(ended) {
        // A shared unit is computed by one run, or by both at the same time.
        assert_eq!((run.code, run.total("computed") + run.total("reused")), (0, 8 + 24), "{}", run.err);
    }
    assert_same(&tables(&lab.path("whole")), &tables(&lab.server.path("one")), "two pipelines");
    let verified = lab.magline(&["verify", "--store", &address("one")]);
    assert_eq!(verified.code, 0, "{}", verified.err);
}

#[test]
fn user_the_first_published_version_is_not_overwritten() {
    let lab = Lab::new();
    let (expected, units) = lab.local();
    // Another writer takes the version number just before this run requests it.
    let (first, newest) = ("one/versions/small/1/version.json", "one/tables/small");
    let other = lab.server.other();
    lab.server.faults(move |asked| {
        if asked.on_condition && asked.key == first {
            other.put(first, "theirs");
        }
        Fault::None
    });
    let run = lab.run(&address("one"), &lab.cache(), &[]);
    assert_eq!(run.counts(), (0, units, 0), "{}", run.err);
    assert_eq!(fs::read(lab.server.path(first)).unwrap(), b"theirs");
    assert_same(&tables(&lab.path("whole")), &tables(&lab.server.path("one")), "the second number");
    // Another writer has replaced the name of the newest version.
    let before = fs::read_to_string(lab.server.path(newest)).unwrap();
    let other = lab.server.other();
    lab.server.faults(move |asked| {
        if asked.on_condition && asked.key == newest {
            other.put(newest, "../versions/small/9/tables\ntheirs\n");
        }
        Fault::None
    });
    let cache = lab.cache();
    let late = lab.run(&address("one"), &cache, &["--set", "axes.corner=[0.4]"]);
    assert_eq!(late.code, 1, "{}", late.err);
    let printed = format!("{}{}", late.out, late.err);
    assert!(printed.contains("another run published `small`") && printed.contains("run the spec again"), "{printed}");
    assert!(fs::read_to_string(lab.server.path(newest)).unwrap().contains("theirs"));
    // The other writer has ended as well, and the computed results are stored.
    lab.server.faults(|_| Fault::None);
    lab.server.other().put(newest, &before);
    let again = lab.run(&address("one"), &cache, &["--set", "axes.corner=[0.4]"]);
    assert_eq!(again.counts(), (0, 0, 16), "{}", again.err);
    lab.assert_packs("one", &expected);
}

#[test]
fn user_new_flights_below_a_prefix_are_found() {
    let lab = Lab::new();
    let put = |name: &str, text: &str| fs::write(lab.server.path(&format!("in/{name}")), text).unwrap();
    fs::create_dir(lab.server.path("in")).unwrap();
    put("1.csv", &flight(1, 300));
    put("2.csv", &flight(2, 300));
    let spec = |path: &str| SPEC.replace("flights/*.csv", path);
    for path in [address("in/*.csv"), address("in")] {
        fs::write(lab.path("spec.toml"), spec(&path)).unwrap();
        let planned = lab.magline(&["explain", "spec.toml"]);
        assert_eq!(planned.code, 0, "{}", planned.err);
    }
    let cache = lab.cache();
    let run = || lab.run(&address("one"), &cache, &[]);
    let first = run();
    assert_eq!(first.counts(), (0, 16, 0), "{}", first.err);
    // The same bytes are written again.
    put("1.csv", &flight(1, 300));
    assert_eq!(run().counts(), (0, 0, 16));
    put("3.csv", &flight(3, 300));
    assert_eq!(run().counts(), (0, 8, 16));
    // One flight becomes longer, and another flight is deleted.
    put("3.csv", &flight(3, 400));
    fs::remove_file(lab.server.path("in/2.csv")).unwrap();
    assert_eq!(run().counts(), (0, 8, 8));
    // Inputs from files give the same results with the same keys.
    fs::remove_dir_all(lab.path("flights")).unwrap();
    fs::create_dir(lab.path("flights")).unwrap();
    for name in ["1.csv", "3.csv"] {
        fs::copy(lab.server.path(&format!("in/{name}")), lab.path(&format!("flights/{name}"))).unwrap();
    }
    fs::write(lab.path("spec.toml"), spec("flights/*.csv")).unwrap();
    lab.local();
    for table in ["small.even", "small.smooth"] {
        assert_eq!(rows(&lab, table, &address("one")), rows(&lab, table, "whole"));
    }
    let packs = |root: &Path| files(root).into_keys().filter(|n| n.starts_with("objects/")).collect::<HashSet<_>>();
    assert!(packs(&lab.path("whole")).iter().all(|pack| lab.server.path(&format!("one/{pack}")).is_file()));
}

#[test]
fn user_a_set_is_published_to_a_bucket_as_to_a_folder() {
    let lab = Lab::new();
    let cache = lab.cache();
    let run = lab.run(&address("one"), &cache, &[]);
    assert_eq!(run.code, 0, "{}", run.err);
    let set = format!("store={}", address("one"));
    let to = |place: &str| lab.magline_with(&["publish", "spec.toml", "smooth", "--set", &set, "--to", place], &cache);
    let folder = to("set");
    assert_eq!(folder.code, 0, "{}", folder.err);
    lab.server.faults(|asked| if asked.number % 4 == 0 { Fault::Status(500) } else { Fault::None });
    let bucket = to(&address("sets/smooth"));
    assert_eq!(bucket.code, 0, "{}", bucket.err);
    assert!(to(&address("sets/smooth")).out.contains("already holds the same published set"));
    lab.server.faults(|_| Fault::None);
    assert_same(&all_files(&lab.path("set")), &all_files(&lab.server.path("sets/smooth")), "the set");
    let there = lab.server.path("sets/smooth").display().to_string();
    let verified = lab.magline(&["verify", &there]);
    assert_eq!(verified.code, 0, "{}", verified.err);
}

fn all_files(root: &Path) -> Files {
    let mut found = Files::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for path in fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else {
                found.insert(path.strip_prefix(root).unwrap().display().to_string(), fs::read(path).unwrap());
            }
        }
    }
    found
}

/// Store, additional environment, exit status, and expected words of the message.
type Case<'a> = (&'a str, &'a [(&'a str, &'a str)], i32, &'a [&'a str]);

#[test]
fn user_refused_requests_are_reported_without_secrets() {
    let lab = &Lab::new();
    let nobody = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let (down, mute) = (&Server::new(), &Server::new());
    down.faults(|_| Fault::Status(500));
    mute.faults(|_| Fault::Silent);
    let at = address("one");
    let nowhere = "s3://nowhere/one".to_owned();
    let password = format!("s3://id:geheim@{BUCKET}/one");
    let cases: [Case; 9] = [
        (&at, &[("AWS_SECRET_ACCESS_KEY", "geheim-guessed")], 1, &["403", "do not permit this request"]),
        (&at, &[("AWS_ACCESS_KEY_ID", "AKIANOBODY")], 1, &["do not permit this request"]),
        (&nowhere, &[], 1, &["there is no bucket s3://nowhere"]),
        (&at, &[("AWS_ENDPOINT_URL", &format!("http://{nobody}"))], 1, &[&at, "the server did not respond in time"]),
        (&at, &[("AWS_ENDPOINT_URL", &down.endpoint)], 1, &[&at, "500"]),
        (
            &at,
            &[("AWS_ENDPOINT_URL", &mute.endpoint), ("AWS_TIMEOUT", "1 second")],
            1,
            &["the server did not respond \
            in time"],
        ),
        (&at, &[("AWS_ALLOW_HTTP", "false")], 1, &["AWS_ALLOW_HTTP"]),
        (&at, &[("AWS_PROFILE", "lab")], 1, &["no profile `lab`"]),
        (&password, &[], 2, &["into the environment"]),
    ];
    scope(|scope| {
        for (store, more, code, words) in cases {
            let mut env = lab.env(USERS[0], &lab.cache());
            env.extend(more.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())));
            let more: Vec<String> = more.iter().map(|(name, value)| format!("{name}={value}")).collect();
            scope.spawn(move || {
                let begun = Instant::now();
                let done = ended(lab.start(&["run", "spec.toml", "--set", &format!("store={store}")], &env));
                let printed = format!("{store} {more:?}: {} after {:?}: {}", done.code, begun.elapsed(), done.err);
                assert_eq!(done.code, code, "{printed}");
                assert!(words.iter().all(|word| done.err.contains(word)), "{printed}");
                // Eight more attempts within 2 min. `pipeline/OBJECTS.md` states about 10 s.
                assert!(begun.elapsed() < Duration::from_secs(100), "{printed}");
                assert!(done.err.len() < 1500, "{printed}");
            });
        }
    });
    let none = lab.magline(&["ls", "--store", &address("nothing")]);
    assert_eq!(none.code, 2, "{}", none.err);
}
