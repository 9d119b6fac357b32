//! Stores and inputs in a bucket of Google Cloud Storage: the same bytes as in folders, for any server fault.

use std::{
    fs,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use hyper::Method;

use crate::{
    Decide, SPEC, all_files,
    cluster_support::until,
    lab::{Lab, assert_same, ended, files, flight, google_address, store_of, tables},
    rows,
    server::{Asked, Fault, USERS},
};

#[test]
fn user_a_store_in_a_bucket_of_google_has_the_bytes_of_one_in_a_folder() {
    let lab = Lab::google();
    let (expected, units) = lab.local();
    let (cache, at) = (lab.cache(), google_address("one"));
    let run = lab.run(&at, &cache, &[]);
    assert_eq!(run.counts(), (0, units, 0), "{}", run.err);
    assert_same(&expected, &files(&store_of(&cache)), "the cache");
    lab.assert_bucket("one", &expected, "the bucket");
    let written = lab.packs_written();
    assert!(!written.is_empty() && written.values().all(|n| *n == 1), "{written:?}");
    assert!(lab.server.asked().iter().any(|asked| asked.on_condition), "nothing was written on a condition");
    for cache in [cache, lab.cache()] {
        let again = lab.run(&at, &cache, &[]);
        assert_eq!(again.counts(), (0, 0, units), "{}", again.err);
    }
    assert_eq!(rows(&lab, "small.smooth", &at), rows(&lab, "small.smooth", "whole"));
    let verified = lab.magline(&["verify", "--store", &at]);
    assert_eq!(verified.code, 0, "{}", verified.err);
    let run = lab.run(&google_address("two"), &lab.cache(), &["--engine", "processes", "--threads", "2"]);
    assert_eq!(run.counts(), (0, units, 0), "{}", run.err);
    assert_same(&tables(&lab.path("whole")), &tables(&lab.server.path("two")), "by processes");
    // Only unreferenced results are removed.
    let more = lab.run(&at, &lab.cache(), &["--set", "axes.corner=[0.5]"]);
    assert_eq!(more.code, 0, "{}", more.err);
    let dropped = lab.magline(&["gc", "--store", &at, "--keep", "1", "--yes"]);
    assert_eq!(dropped.code, 0, "{}", dropped.err);
    let whole = lab.run(&at, &lab.cache(), &[]);
    assert_eq!((whole.code, whole.total("computed") + whole.total("reused")), (0, units), "{}", whole.err);
    assert_same(&tables(&lab.path("whole")), &tables(&lab.server.path("one")), "after gc");
}

#[test]
fn user_faults_of_google_change_no_byte() {
    let mut met = 0;
    let mut every_second_condition = move |asked: &Asked, fault: Fault| {
        met += usize::from(asked.on_condition);
        if asked.on_condition && met.is_multiple_of(2) { fault } else { Fault::None }
    };
    let mut answers = every_second_condition;
    let cases: [(&str, Decide); 4] = [
        (
            "every fifth request is refused",
            Box::new(|a| if a.number % 5 == 0 { Fault::Status(503) } else { Fault::None }),
        ),
        (
            "every fourth answer is cut",
            Box::new(|a| if a.method == Method::GET && a.number % 4 == 0 { Fault::Cut } else { Fault::None }),
        ),
        ("conditional writes are done and never answered", Box::new(move |a| every_second_condition(a, Fault::Late))),
        ("conditional writes are done and refused", Box::new(move |a| answers(a, Fault::Lost(500)))),
    ];
    std::thread::scope(|scope| {
        for (what, decide) in cases {
            scope.spawn(move || {
                let lab = Lab::google();
                let (expected, units) = lab.local();
                let count = lab.faults(decide);
                let run = lab.run(&google_address("one"), &lab.cache(), &[]);
                assert_eq!(run.counts(), (0, units, 0), "{what}: {}", run.err);
                let again = lab.run(&google_address("one"), &lab.cache(), &[]);
                assert_eq!(again.counts(), (0, 0, units), "{what}: {}", again.err);
                assert!(count.load(Ordering::Relaxed) > 1, "{what}: no faults");
                lab.server.faults(|_| Fault::None);
                lab.assert_bucket("one", &expected, what);
            });
        }
    });
}

#[test]
fn user_two_runs_in_a_bucket_of_google_exclude_each_other_and_the_first_publication_stays() {
    let lab = Lab::google();
    let (expected, units) = lab.local();
    let at = google_address("one");
    let open = Arc::new(AtomicBool::new(false));
    let gate = open.clone();
    lab.server.faults(move |asked| {
        if asked.writes_pack() && !gate.load(Ordering::SeqCst) { Fault::Status(503) } else { Fault::None }
    });
    let first = lab.begun(&at, USERS[0], &lab.cache(), &[]);
    until("the first run writes", || lab.server.asked().iter().any(Asked::writes_pack));
    let second = ended(lab.begun(&at, USERS[1], &lab.cache(), &[]));
    assert_eq!(second.code, 3, "{}", second.err);
    open.store(true, Ordering::SeqCst);
    let first = ended(first);
    assert_eq!(first.counts(), (0, units, 0), "{}", first.err);
    lab.assert_bucket("one", &expected, "two runs");
    // Another writer replaces the name of the newest version just before this run does.
    let (newest, other) = ("one/tables/small", lab.server.other());
    let before = fs::read_to_string(lab.server.path(newest)).unwrap();
    lab.server.faults(move |asked| {
        if asked.on_condition && asked.key == newest {
            other.put(newest, "../versions/small/9/tables\ntheirs\n");
        }
        Fault::None
    });
    let cache = lab.cache();
    let late = lab.run(&at, &cache, &["--set", "axes.corner=[0.4]"]);
    assert_eq!(late.code, 1, "{}", late.err);
    assert!(format!("{}{}", late.out, late.err).contains("another run published `small`"), "{}", late.err);
    assert!(fs::read_to_string(lab.server.path(newest)).unwrap().contains("theirs"));
    lab.server.faults(|_| Fault::None);
    lab.server.other().put(newest, &before);
    let again = lab.run(&at, &cache, &["--set", "axes.corner=[0.4]"]);
    assert_eq!(again.counts(), (0, 0, 16), "{}", again.err);
}

#[test]
fn user_flights_and_data_sets_in_a_bucket_of_google() {
    let lab = Lab::google();
    fs::create_dir(lab.server.path("in")).unwrap();
    for number in 1..=2 {
        fs::write(lab.server.path(&format!("in/{number}.csv")), flight(number, 300)).unwrap();
    }
    fs::write(lab.path("spec.toml"), SPEC.replace("flights/*.csv", &google_address("in/*.csv"))).unwrap();
    let cache = lab.cache();
    let run = || lab.run(&google_address("one"), &cache, &[]);
    assert_eq!(run().counts(), (0, 16, 0));
    fs::write(lab.server.path("in/3.csv"), flight(3, 300)).unwrap();
    assert_eq!(run().counts(), (0, 8, 16));
    let set = format!("store={}", google_address("one"));
    let to = |place: &str| lab.magline_with(&["publish", "spec.toml", "smooth", "--set", &set, "--to", place], &cache);
    let (folder, bucket) = (to("set"), to(&google_address("sets/smooth")));
    assert_eq!((folder.code, bucket.code), (0, 0), "{}{}", folder.err, bucket.err);
    assert_same(&all_files(&lab.path("set")), &all_files(&lab.server.path("sets/smooth")), "the set");
    let none = lab.run("gs://nowhere/one", &lab.cache(), &[]);
    assert!(none.code == 1 && none.err.contains("there is no bucket gs://nowhere"), "{}", none.err);
}
