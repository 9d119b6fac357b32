//! Runs of a whole spec over an object store.

#![allow(clippy::unwrap_used)]

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use plan::{Plan, read_spec};
use schemas::keys::HashKey;
use stages::catalogue;
use store::{Store, attach, current, parts, scrub::scrub};

use super::{RECORD_CHECKS, RunOptions, SilentListener, run};
use lab::Lab;

#[path = "../../store/src/remote/tests/lab.rs"]
mod lab;

/// Mark of the cache of a store in an object store.
const MARK: &str = "REMOTE";

/// Files of a store that are equal in all locations, because they contain no times.
fn lasting(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap().map(Result::unwrap) {
            let path = entry.path();
            let name = path.strip_prefix(root).unwrap().display().to_string();
            let timed =
                ["locks", "tmp", "costs", "plans", "runs", "index", "STORE", MARK].iter().any(|n| name.starts_with(n));
            if timed || name.ends_with(".seen") || name.ends_with("version.json") {
                continue;
            }
            if entry.file_type().unwrap().is_dir() {
                folders.push(path);
            } else if entry.file_type().unwrap().is_file() {
                found.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    found
}

#[test]
fn unit_run_writes_identical_bytes_to_an_object_store() {
    let lab = Lab::new();
    let (folder, here, there) = (tempfile::tempdir().unwrap(), lab.host(), lab.host());
    let plan = |root: &Path| {
        let sets = [format!("store={}", root.display())];
        Plan::new(read_spec(Path::new("../../datasets/examples/tolles_lawson.toml"), &sets).unwrap(), &catalogue())
            .unwrap()
    };
    let ran = |root: &Path| {
        let store = Store::open(root).unwrap();
        let summary = run(&plan(root), &store, RunOptions::default(), &SilentListener).unwrap();
        assert!(
            summary.failures.is_empty(),
            "{:?}",
            summary.failures.iter().map(|f| f.fault.to_string()).collect::<Vec<_>>()
        );
        summary.total()
    };
    let local = ran(folder.path());
    let remote = ran(here.path());
    assert_eq!((remote.computed, remote.reused), (local.computed, local.reused));
    let expected = lasting(folder.path());
    assert!(expected.len() > 10);
    assert_eq!(lasting(here.path()), expected, "the cache is a store as any other");
    // Each pack was written once, and bucket and folder have the same contents.
    let written = lab.server.writes("lab/store/objects/");
    assert_eq!(written.iter().collect::<BTreeSet<_>>().len(), written.len(), "{written:?}");
    for (name, bytes) in expected.iter().filter(|(name, _)| !name.starts_with("versions")) {
        assert_eq!(lab.bucket.get(name).unwrap().as_ref(), Some(bytes), "{name}");
    }
    // Another host finds all units computed, copies the packs it needs, and has the same tables.
    let again = ran(there.path());
    assert_eq!((again.computed, again.reused), (0, local.computed + local.reused));
    assert_eq!(lab.server.writes("lab/store/objects/").len(), written.len());
    let of = |root: &Path| -> Vec<Vec<u8>> {
        let mut files = vec![];
        for table in &current(root, "tolles_lawson").unwrap().manifest.tables {
            let parts = parts(&root.join("tables/tolles_lawson").join(&table.name)).unwrap();
            files.extend(parts.iter().map(|p| fs::read(p).unwrap()));
        }
        files
    };
    assert_eq!(of(there.path()), of(folder.path()));
    // This is the state after a run was killed; the next run computes the other packs.
    let packs = lab.bucket.list("objects").unwrap();
    for gone in packs.iter().step_by(2) {
        lab.bucket.remove(&gone.key).unwrap();
    }
    let third = lab.host();
    let mended = ran(third.path());
    assert!(mended.computed > 0 && mended.computed + mended.reused == local.computed + local.reused);
    for (name, bytes) in expected.iter().filter(|(name, _)| name.starts_with("objects")) {
        assert_eq!(lab.bucket.get(name).unwrap().as_ref(), Some(bytes), "{name}");
    }
}

#[test]
fn unit_verify_reports_each_damaged_object() {
    let lab = Lab::new();
    let host = lab.host();
    let sets = [format!("store={}", host.path().display())];
    let spec = read_spec(Path::new("../../datasets/examples/tolles_lawson.toml"), &sets).unwrap();
    let plan = Plan::new(spec, &catalogue()).unwrap();
    run(&plan, &Store::open(host.path()).unwrap(), RunOptions::default(), &SilentListener).unwrap();
    Store::open(host.path()).unwrap().set_checkpoint(HashKey::from_parts(["unit"]), b"half of it").unwrap();
    let damaged = || {
        let fresh = lab.host();
        let store = Store::open(fresh.path()).unwrap();
        let found = scrub(&store, RECORD_CHECKS, &|_, _| ()).unwrap().damaged;
        found.into_keys().map(|path| path.display().to_string()).collect::<Vec<_>>()
    };
    assert_eq!(damaged(), Vec::<String>::new());
    let all: Vec<String> = lab.bucket.list("").unwrap().into_iter().map(|o| o.key).collect();
    // A damaged version is an error when the store is opened.
    for part in ["index", "objects", "sources", "quality", "plans", "runs", "costs", "checkpoints", "locks"] {
        let mut own = all.iter().filter(|name| name.split('/').next() == Some(part)).peekable();
        assert!(own.peek().is_some(), "{part}");
        for (i, name) in own.enumerate() {
            let whole = lab.bucket.get(name).unwrap().unwrap();
            lab.put(name, |bytes| {
                let at = (i * 7919 + 13) % bytes.len();
                bytes[at] ^= 1 << (i % 7);
            });
            let found = damaged();
            assert!(found.iter().any(|path| path.ends_with(&**name)), "{name}: {found:?}");
            lab.bucket.list("damaged").unwrap().iter().for_each(|o| lab.bucket.remove(&o.key).unwrap());
            lab.bucket.put(name, whole).unwrap();
        }
    }
    assert_eq!(damaged(), Vec::<String>::new());
}
