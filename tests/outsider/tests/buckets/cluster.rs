//! A run on a cluster with its store in a bucket: scheduler, run and workers share only the bucket.

use std::{
    collections::BTreeMap,
    path::Path,
    sync::mpsc::{Receiver, channel},
};

use serde_json::Value;

use crate::{
    cluster_support::{Cluster, KEY_FILE, until},
    lab::{Done, Lab, SPEC, address, assert_same, ended, tables},
    server::{Fault, USERS},
};

/// Flights whose run takes several seconds, and the number of units.
fn scene() -> (Lab, u64) {
    let lab = Lab::of(6, 3000, &SPEC.replace("1.5]", "1.1, 1.3, 1.5, 1.7, 1.9, 2.1, 2.3, 2.5]"));
    let (_, units) = lab.local();
    (lab, units)
}

/// Two workers of one core, each with a separate cache and separate credentials.
fn cluster(lab: &Lab) -> Cluster {
    let mut cluster = Cluster::new(env!("CARGO_BIN_EXE_outsider"), lab.folder.path(), 0);
    for user in &USERS[1..] {
        cluster.add_with(&address("one"), &lab.env(user, &lab.cache()));
    }
    cluster
}

fn ran(lab: &Lab, cluster: &Cluster, cache: &Path) -> Done {
    lab.run(&address("one"), cache, &["--engine", &cluster.engine(), "--key-file", KEY_FILE])
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

fn assert_no_secret(cluster: &Cluster) {
    let printed = cluster.worker_stderr() + &cluster.receipts().concat();
    assert!(!printed.contains("geheim") && !printed.contains("AKIA"), "{printed}");
}

#[test]
fn user_a_cluster_with_its_store_in_a_bucket_gives_the_bytes_of_a_local_run() {
    let (lab, units) = scene();
    let cluster = cluster(&lab);
    let run = ran(&lab, &cluster, &lab.cache());
    assert_eq!(run.counts(), (0, units, 0), "{} {}", run.err, cluster.worker_stderr());
    let counted = computed(&cluster);
    assert!(counted.len() as u64 == units && counted.values().all(|n| *n == 1), "{counted:?}");
    assert_same(&tables(&lab.path("whole")), &tables(&lab.server.path("one")), "a cluster");
    assert!(lab.packs_written().values().all(|n| *n == 1));
    // Workers write the results that they compute.
    let mut writers: Vec<String> = lab.server.asked().into_iter().filter(|a| a.writes_pack()).map(|a| a.user).collect();
    writers.sort();
    writers.dedup();
    assert!(writers.contains(&USERS[1].to_owned()) && writers.contains(&USERS[2].to_owned()), "{writers:?}");
    let again = ran(&lab, &cluster, &lab.cache());
    assert_eq!(again.counts(), (0, 0, units), "{}", again.err);
    assert_no_secret(&cluster);
}

#[test]
fn user_a_worker_killed_at_a_write_to_the_bucket_costs_only_its_unfinished_tasks() {
    let (lab, units) = scene();
    let mut cluster = cluster(&lab);
    // The third pack written by a worker does not arrive.
    let (sender, lost_jobs) = channel();
    let mut seen = 0;
    lab.server.faults(move |asked| {
        seen += usize::from(asked.writes_pack() && asked.user != USERS[0]);
        if asked.writes_pack() && seen == 3 {
            seen += 1;
            sender.send(asked.user.clone()).unwrap();
            return Fault::Silent;
        }
        Fault::None
    });
    let cache = lab.cache();
    let run = lab.begun(&address("one"), USERS[0], &cache, &["--engine", &cluster.engine(), "--key-file", KEY_FILE]);
    let lost = received(&lost_jobs);
    cluster.kill(usize::from(lost == USERS[2]));
    let run = ended(run);
    assert_eq!(run.code, 0, "{} {}", run.err, cluster.worker_stderr());
    assert_eq!(run.total("computed") + run.total("reused"), units);
    let counted = computed(&cluster);
    assert!(counted.values().all(|n| *n == 1), "{counted:?}");
    assert_same(&tables(&lab.path("whole")), &tables(&lab.server.path("one")), "a worker was killed");
    let again = ran(&lab, &cluster, &lab.cache());
    assert_eq!(again.counts(), (0, 0, units), "{}", again.err);
    assert_no_secret(&cluster);
}

fn received(lost_jobs: &Receiver<String>) -> String {
    let mut lost = None;
    until("a worker writes its third pack", || {
        lost = lost_jobs.try_recv().ok();
        lost.is_some()
    });
    lost.unwrap()
}
