#![allow(clippy::unwrap_used)]

use std::{collections::HashMap, path::Path};

use arrow_array::{ArrayRef, Float64Array, RecordBatch};
use arrow_schema::{DataType, Schema};
use schemas::{Role, field};

use super::{
    super::{
        ExtraTable, LockOutcome, Store, TableFiles, current, generation, published,
        scrub::{RecordChecks, scrub},
        tend::{GcOptions, collect},
    },
    *,
};
use lab::Lab;

mod lab;
mod locks;

fn batch(rows: usize, from: f64) -> RecordBatch {
    let numbers: ArrayRef = Arc::new((0..rows).map(|i| Some(from + i as f64)).collect::<Float64Array>());
    let fields = vec![field("x", DataType::Float64, "nT", Role::Derived, "x")];
    RecordBatch::try_new(Arc::new(Schema::new(fields)), vec![numbers]).unwrap()
}

fn key(name: &str) -> HashKey {
    HashKey::from_parts([name])
}

/// Pack of a unit.
fn pack_of(store: &Store, unit: HashKey) -> HashKey {
    let catalogue = store.catalogue();
    catalogue.pack(catalogue.find(unit).unwrap().pack).unwrap().id
}

#[test]
fn unit_hosts_read_identical_bytes() {
    let lab = Lab::new();
    let (here, there, later) = (lab.host(), lab.host(), lab.host());
    let first = Store::open(here.path()).unwrap();
    first.put(key("a"), &batch(5, 1.0)).unwrap();
    first.put(key("b"), &batch(300_000, 2.0)).unwrap();
    // Without an index, only the footers are read.
    locked(&lab.server.read).clear();
    let second = Store::open(there.path()).unwrap();
    assert!(second.has(key("a")) && second.has(key("b")));
    let file = |store: &Store, name: &str| store.file(pack_of(store, key(name)));
    assert!(!file(&second, "a").exists() && !file(&second, "b").exists());
    assert_eq!(second.whole(key("a")).unwrap(), batch(5, 1.0));
    assert_eq!(fs::read(file(&second, "a")).unwrap(), fs::read(file(&first, "a")).unwrap());
    assert!(!file(&second, "b").exists(), "only what is read is copied");
    // With an index, no footer is read.
    first.write_index().unwrap();
    locked(&lab.server.read).clear();
    let third = Store::join(later.path()).unwrap();
    assert!(third.has(key("b")));
    assert!(!locked(&lab.server.read).iter().any(|name| name.contains("objects")));
    // Later packs are found by name, or by listing.
    first.put(key("c"), &batch(1, 3.0)).unwrap();
    assert!(!third.has(key("c")) && third.adopt(pack_of(&first, key("c"))) && third.has(key("c")));
    second.refresh();
    assert!(second.has(key("c")) && !second.adopt(key("nothing")));
    // Plans and states are shared by all hosts.
    let plan = first.keep_plan(b"a plan").unwrap();
    assert_eq!(second.plan(plan).unwrap(), b"a plan");
    first.set_checkpoint(key("d"), b"half").unwrap();
    assert_eq!(second.checkpoint(key("d")).unwrap(), b"half");
    second.set_checkpoint(key("d"), b"more").unwrap();
    assert_eq!(first.checkpoint(key("d")).unwrap(), b"more");
    second.drop_checkpoints(|name| name == key("d").to_string(), None);
    assert_eq!(first.checkpoint(key("d")), None);
}

#[test]
fn unit_damaged_copy_is_replaced_and_damaged_object_is_quarantined() {
    let lab = Lab::new();
    let (here, there) = (lab.host(), lab.host());
    let store = Store::open(here.path()).unwrap();
    for name in ["a", "b", "c", "d"] {
        store.put(key(name), &batch(1000, 1.0)).unwrap();
    }
    let other = Store::open(there.path()).unwrap();
    // A copy with a flipped bit.
    other.whole(key("a")).unwrap();
    let (a, object) = (pack_of(&other, key("a")), |name: &str| RemoteStore::pack_key(pack_of(&store, key(name))));
    let copy = other.file(a);
    drop(other);
    let mut bytes = fs::read(&copy).unwrap();
    bytes[100] ^= 4;
    fs::write(&copy, &bytes).unwrap();
    let other = Store::open(there.path()).unwrap();
    assert_eq!(other.whole(key("a")).unwrap(), batch(1000, 1.0));
    assert_eq!(other.damaged(), Vec::<String>::new());
    assert_eq!(fs::read(&copy).unwrap(), fs::read(store.file(a)).unwrap());
    // Truncated answers are requested again.
    lab.server.cut.store(3, Ordering::SeqCst);
    assert_eq!(other.whole(key("b")).unwrap(), batch(1000, 1.0));
    assert_eq!(other.damaged(), Vec::<String>::new());
    lab.server.cut.store(1000, Ordering::SeqCst);
    let fault = other.whole(key("c")).unwrap_err().to_string();
    assert!(fault.contains("truncated"), "{fault}");
    lab.server.cut.store(0, Ordering::SeqCst);
    assert_eq!(other.whole(key("c")).unwrap(), batch(1000, 1.0), "a server that cuts is no damage");
    // An object with a flipped bit is never read, and is quarantined.
    lab.put(&object("d"), |bytes| bytes[100] ^= 4);
    let fault = other.whole(key("d")).unwrap_err().to_string();
    assert!(fault.contains("checksum"), "{fault}");
    assert!(!other.has(key("d")) && other.damaged().len() == 1);
    assert!(lab.bucket.get(&object("d")).unwrap().is_none());
    assert_eq!(lab.bucket.list("damaged").unwrap().len(), 1);
    // A truncated object is found when the store is opened, and by `verify`.
    lab.put(&object("c"), |bytes| bytes.truncate(2000));
    lab.put(&object("b"), |bytes| bytes[200] ^= 1);
    drop(other);
    let other = Store::open(there.path()).unwrap();
    assert!(!other.has(key("c")) && other.has(key("b")));
    let found = scrub(&other, RecordChecks { runs: |_| true, costs: |_| true }, &|_, _| ()).unwrap();
    assert_eq!(found.damaged.len(), 2, "{:?}", found.damaged);
    assert!(!other.has(key("b")) && other.has(key("a")));
    // A recomputed pack is available again, also on the host that had it earlier.
    other.put(key("b"), &batch(1000, 1.0)).unwrap();
    assert_eq!(Store::open(here.path()).unwrap().whole(key("b")).unwrap(), batch(1000, 1.0));
}

#[test]
fn unit_unreachable_server_is_reported_without_data_loss() {
    let lab = Lab::new();
    let here = lab.host();
    let store = Store::open(here.path()).unwrap();
    lab.server.down.store(true, Ordering::SeqCst);
    let fault = store.put(key("a"), &batch(1, 1.0)).unwrap_err().to_string();
    assert!(fault.contains("s3://bucket/lab/store/objects/") && fault.contains("500"), "{fault}");
    assert!(!store.has(key("a")), "what is not in the store is not there");
    assert!(store.lock("p").is_err() && Store::open(here.path()).is_err());
    lab.server.down.store(false, Ordering::SeqCst);
    store.put(key("a"), &batch(1, 1.0)).unwrap();
    assert!(store.has(key("a")));
}

#[test]
fn unit_foreign_prefix_is_rejected() {
    let lab = Lab::new();
    lab.bucket.put("holidays/one.jpg", vec![1]).unwrap();
    let here = lab.host();
    let fault = Store::open(here.path()).map(drop).unwrap_err().to_string();
    assert!(fault.contains("is not a magline store: it contains holidays/one.jpg"), "{fault}");
    assert!(Store::join(here.path()).is_err());
    lab.bucket.remove("holidays/one.jpg").unwrap();
    lab.bucket.put("STORE", b"magline store 9\n".to_vec()).unwrap();
    let fault = Store::open(here.path()).map(drop).unwrap_err().to_string();
    assert!(fault.contains("another version of magline"), "{fault}");
}

fn mine(lock: LockOutcome) -> super::super::PipelineLock {
    match lock {
        LockOutcome::Mine(publisher) => publisher,
        LockOutcome::Held(held) => unreachable!("held: {held:?}"),
    }
}

/// Publishes a table of one unit, and a small second table.
fn publish(store: &Store, unit: &str, run: &str) -> Result<bool, Fault> {
    let publisher = mine(store.lock("p")?);
    let packs = vec![pack_of(store, key(unit))];
    let tables = [TableFiles { name: "t".to_owned(), packs: packs.clone(), units: None }];
    let file = store.temporary();
    store.write_table(&file, &batch(2, 7.0), &[])?;
    store.publish(&publisher, run, &tables, &[ExtraTable { name: "failures".to_owned(), file }], &packs, &[])
}

fn read(root: &Path, table: &str) -> RecordBatch {
    published(&root.join("tables").join("p").join(table), &["x"]).unwrap().unwrap()
}

#[test]
fn unit_readers_see_one_version_or_the_next() {
    let lab = Lab::new();
    let (here, there) = (lab.host(), lab.host());
    let one = Store::open(here.path()).unwrap();
    one.put(key("a"), &batch(5, 1.0)).unwrap();
    one.put(key("b"), &batch(6, 2.0)).unwrap();
    assert!(publish(&one, "a", "first").unwrap());
    assert!(!publish(&one, "a", "first").unwrap(), "nothing new");
    super::super::pulled(there.path()).unwrap();
    let version = current(there.path(), "p").unwrap();
    assert_eq!((version.number, version.manifest.run.as_str()), (1, "first"));
    assert_eq!((read(there.path(), "t"), read(there.path(), "failures")), (batch(5, 1.0), batch(2, 7.0)));
    // Both hosts have the same files under the same names.
    let files = |root: &Path| {
        let parts = super::super::parts(&root.join("tables").join("p").join("t")).unwrap();
        parts.iter().map(|p| (p.file_name().unwrap().to_owned(), fs::read(p).unwrap())).collect::<Vec<_>>()
    };
    assert_eq!(files(here.path()), files(there.path()));
    // The other host publishes; a reader of the previous version still reads it.
    let two = Store::open(there.path()).unwrap();
    assert!(publish(&two, "b", "second").unwrap());
    assert_eq!(read(here.path(), "t"), batch(5, 1.0));
    super::super::pulled(here.path()).unwrap();
    assert_eq!((read(here.path(), "t"), current(here.path(), "p").unwrap().number), (batch(6, 2.0), 2));
    // Another process has published since the pointer was read.
    let version = current(here.path(), "p").unwrap();
    let meanwhile = || lab.bucket.put("tables/p", b"../versions/p/9/tables\nx\n".to_vec());
    let remote = RemoteStore::from_cache(here.path()).unwrap().unwrap();
    assert_eq!(read(here.path(), "failures"), batch(2, 7.0));
    let fault = remote.publish("p", &version.folder, &version.manifest, &meanwhile).unwrap_err().to_string();
    assert!(fault.contains("another run published `p`"), "{fault}");
    assert_eq!(current(here.path(), "p").unwrap().number, 2);
}

#[test]
fn unit_gc_drops_only_unreferenced_objects() {
    let lab = Lab::new();
    let (here, there) = (lab.host(), lab.host());
    let one = Store::open(here.path()).unwrap();
    for (name, from) in [("a", 1.0), ("b", 2.0), ("c", 3.0)] {
        one.put(key(name), &batch(5, from)).unwrap();
    }
    publish(&one, "a", "first").unwrap();
    publish(&one, "b", "second").unwrap();
    let what = GcOptions { keep: 1, older_than: Duration::ZERO, dry: true };
    let seen = collect(&one, what).unwrap();
    assert_eq!((seen.packs, seen.versions.as_slice(), seen.busy), (2, ["p/1".to_owned()].as_slice(), false));
    assert_eq!(lab.bucket.list("objects").unwrap().len(), 3, "nothing was removed");
    // A run of another host holds a lock: packs are kept.
    let two = Store::open(there.path()).unwrap();
    let lock = mine(two.lock("q").unwrap());
    assert!(collect(&one, GcOptions { dry: false, ..what }).unwrap().busy);
    assert_eq!(lab.bucket.list("objects").unwrap().len(), 3);
    drop(lock);
    let worker = two.attempt(&[key("z")]).unwrap();
    assert!(collect(&one, GcOptions { dry: false, ..what }).unwrap().busy);
    worker.end(&two, &HashMap::new());
    assert_eq!(collect(&one, GcOptions { dry: false, ..what }).unwrap().packs, 2);
    assert_eq!(lab.bucket.list("objects").unwrap().len(), 1);
    super::super::pulled(there.path()).unwrap();
    assert_eq!(read(there.path(), "t"), batch(5, 2.0));
    let fresh = Store::open(there.path()).unwrap();
    assert!(!fresh.has(key("a")) && fresh.has(key("b")));
}
