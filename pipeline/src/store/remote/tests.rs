#![allow(clippy::unwrap_used)]

use std::{
    collections::HashMap,
    fmt,
    path::Path,
    sync::atomic::{AtomicBool, AtomicUsize},
};

use arrow_array::{ArrayRef, Float64Array, RecordBatch};
use arrow_schema::{DataType, Schema};
use async_trait::async_trait;
use bytes::Bytes;
use futures::{StreamExt, stream::BoxStream};
use object_store::{
    CopyOptions, GetOptions, GetResult, GetResultPayload, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    PutMultipartOptions, PutOptions, PutPayload, PutResult, memory::InMemory, path::Path as Name,
};
use schemas::{Role, field};
use tempfile::TempDir;

use super::{
    super::{
        Beside, Lock, Store, TableFiles, current, generation, published,
        scrub::scrub,
        tend::{Collect, collect},
    },
    *,
};
use crate::{catalogue, plan::Plan, read_spec, remote::Address, run};

/// A server in memory that counts, cuts answers and refuses.
#[derive(Debug, Default)]
struct Server {
    objects: InMemory,
    /// Answers to cut from now on.
    cut: AtomicUsize,
    down: AtomicBool,
    written: Mutex<Vec<String>>,
    read: Mutex<Vec<String>>,
}

impl fmt::Display for Server {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "a server in memory")
    }
}

impl Server {
    fn up(&self) -> object_store::Result<()> {
        match self.down.load(Ordering::SeqCst) {
            true => Err(object_store::Error::Generic { store: "S3", source: "500 Internal Server Error".into() }),
            false => Ok(()),
        }
    }

    /// The objects written so far whose names begin so.
    fn writes(&self, start: &str) -> Vec<String> {
        locked(&self.written).iter().filter(|name| name.starts_with(start)).cloned().collect()
    }
}

#[async_trait]
impl ObjectStore for Server {
    async fn put_opts(&self, at: &Name, payload: PutPayload, how: PutOptions) -> object_store::Result<PutResult> {
        self.up()?;
        let done = self.objects.put_opts(at, payload, how).await?;
        locked(&self.written).push(at.to_string());
        Ok(done)
    }

    async fn put_multipart_opts(
        &self,
        at: &Name,
        how: PutMultipartOptions,
    ) -> object_store::Result<Box<dyn MultipartUpload>> {
        self.up()?;
        self.objects.put_multipart_opts(at, how).await
    }

    async fn get_opts(&self, at: &Name, how: GetOptions) -> object_store::Result<GetResult> {
        self.up()?;
        let whole = !how.head;
        let found = self.objects.get_opts(at, how).await?;
        if whole {
            locked(&self.read).push(at.to_string());
        }
        let cut = |n: usize| n.checked_sub(1);
        if !whole || self.cut.fetch_update(Ordering::SeqCst, Ordering::SeqCst, cut).is_err() {
            return Ok(found);
        }
        let (meta, range, attributes) = (found.meta.clone(), found.range.clone(), found.attributes.clone());
        let bytes = found.bytes().await?;
        let short: Bytes = bytes.slice(..bytes.len() / 2);
        let payload = GetResultPayload::Stream(futures::stream::once(async move { Ok(short) }).boxed());
        Ok(GetResult { payload, meta, range, attributes })
    }

    fn delete_stream(
        &self,
        all: BoxStream<'static, object_store::Result<Name>>,
    ) -> BoxStream<'static, object_store::Result<Name>> {
        self.objects.delete_stream(all)
    }

    fn list(&self, prefix: Option<&Name>) -> BoxStream<'static, object_store::Result<ObjectMeta>> {
        match self.up() {
            Ok(()) => self.objects.list(prefix),
            Err(e) => futures::stream::once(async move { Err(e) }).boxed(),
        }
    }

    async fn list_with_delimiter(&self, prefix: Option<&Name>) -> object_store::Result<ListResult> {
        self.up()?;
        self.objects.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Name, to: &Name, how: CopyOptions) -> object_store::Result<()> {
        self.objects.copy_opts(from, to, how).await
    }
}

/// A bucket, and hosts that each have a cache of their own.
struct Lab {
    server: Arc<Server>,
    bucket: Bucket,
}

impl Lab {
    fn new() -> Lab {
        let server = Arc::new(Server::default());
        let Ok(Place::Object(address)) = place("s3://bucket/lab/store") else { unreachable!("an address") };
        Lab { bucket: Bucket::new(server.clone(), address), server }
    }

    /// The cache of one more host.
    fn host(&self) -> TempDir {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().canonicalize().unwrap();
        let address: &Address = self.bucket.address();
        let mark = Mark { address: address.to_string(), cache: Uuid::new_v4().to_string() };
        fs::write(root.join(MARK), serde_json::to_string(&mark).unwrap()).unwrap();
        Remote::over(&root, self.bucket.clone(), mark.cache);
        folder
    }

    fn put(&self, key: &str, change: impl Fn(&mut Vec<u8>)) {
        let mut bytes = self.bucket.get(key).unwrap().unwrap();
        change(&mut bytes);
        self.bucket.put(key, bytes).unwrap();
    }
}

fn batch(rows: usize, from: f64) -> RecordBatch {
    let numbers: ArrayRef = Arc::new((0..rows).map(|i| Some(from + i as f64)).collect::<Float64Array>());
    let fields = vec![field("x", DataType::Float64, "nT", Role::Derived, "x")];
    RecordBatch::try_new(Arc::new(Schema::new(fields)), vec![numbers]).unwrap()
}

fn key(name: &str) -> Key {
    Key::of([name])
}

/// The pack of a unit.
fn pack_of(store: &Store, unit: Key) -> Key {
    let catalogue = store.catalogue();
    catalogue.pack(catalogue.find(unit).unwrap().pack).unwrap().id
}

#[test]
fn unit_what_one_host_writes_another_reads_with_the_same_bytes() {
    let lab = Lab::new();
    let (here, there, later) = (lab.host(), lab.host(), lab.host());
    let first = Store::open(here.path()).unwrap();
    first.put(key("a"), &batch(5, 1.0)).unwrap();
    first.put(key("b"), &batch(300_000, 2.0)).unwrap();
    // Without an index the footers say what there is, and no other byte is read.
    locked(&lab.server.read).clear();
    let second = Store::open(there.path()).unwrap();
    assert!(second.has(key("a")) && second.has(key("b")));
    let file = |store: &Store, name: &str| store.file(pack_of(store, key(name)));
    assert!(!file(&second, "a").exists() && !file(&second, "b").exists());
    assert_eq!(second.whole(key("a")).unwrap(), batch(5, 1.0));
    assert_eq!(fs::read(file(&second, "a")).unwrap(), fs::read(file(&first, "a")).unwrap());
    assert!(!file(&second, "b").exists(), "only what is read is copied");
    // With an index they are not read either.
    first.write_index().unwrap();
    locked(&lab.server.read).clear();
    let third = Store::join(later.path()).unwrap();
    assert!(third.has(key("b")));
    assert!(!locked(&lab.server.read).iter().any(|name| name.contains("objects")));
    // What comes after is found by its name, or by looking.
    first.put(key("c"), &batch(1, 3.0)).unwrap();
    assert!(!third.has(key("c")) && third.adopt(pack_of(&first, key("c"))) && third.has(key("c")));
    second.refresh();
    assert!(second.has(key("c")) && !second.adopt(key("nothing")));
    // A plan and a state are those of all hosts.
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
fn unit_damage_in_a_copy_is_mended_and_damage_in_the_store_is_set_aside() {
    let lab = Lab::new();
    let (here, there) = (lab.host(), lab.host());
    let store = Store::open(here.path()).unwrap();
    for name in ["a", "b", "c", "d"] {
        store.put(key(name), &batch(1000, 1.0)).unwrap();
    }
    let other = Store::open(there.path()).unwrap();
    // A copy with a flipped bit.
    other.whole(key("a")).unwrap();
    let (a, object) = (pack_of(&other, key("a")), |name: &str| Remote::pack_key(pack_of(&store, key(name))));
    let copy = other.file(a);
    drop(other);
    let mut bytes = fs::read(&copy).unwrap();
    bytes[100] ^= 4;
    fs::write(&copy, &bytes).unwrap();
    let other = Store::open(there.path()).unwrap();
    assert_eq!(other.whole(key("a")).unwrap(), batch(1000, 1.0));
    assert_eq!(other.damaged(), Vec::<String>::new());
    assert_eq!(fs::read(&copy).unwrap(), fs::read(store.file(a)).unwrap());
    // Answers that are cut on the way are asked for again.
    lab.server.cut.store(3, Ordering::SeqCst);
    assert_eq!(other.whole(key("b")).unwrap(), batch(1000, 1.0));
    assert_eq!(other.damaged(), Vec::<String>::new());
    lab.server.cut.store(1000, Ordering::SeqCst);
    let fault = other.whole(key("c")).unwrap_err().to_string();
    assert!(fault.contains("truncated"), "{fault}");
    lab.server.cut.store(0, Ordering::SeqCst);
    assert_eq!(other.whole(key("c")).unwrap(), batch(1000, 1.0), "a server that cuts is no damage");
    // An object with a flipped bit is never read, and out of the way.
    lab.put(&object("d"), |bytes| bytes[100] ^= 4);
    let fault = other.whole(key("d")).unwrap_err().to_string();
    assert!(fault.contains("checksum"), "{fault}");
    assert!(!other.has(key("d")) && other.damaged().len() == 1);
    assert!(lab.bucket.get(&object("d")).unwrap().is_none());
    assert_eq!(lab.bucket.list("damaged").unwrap().len(), 1);
    // One that is cut is found when the store is opened, and by `verify`.
    lab.put(&object("c"), |bytes| bytes.truncate(2000));
    lab.put(&object("b"), |bytes| bytes[200] ^= 1);
    drop(other);
    let other = Store::open(there.path()).unwrap();
    assert!(!other.has(key("c")) && other.has(key("b")));
    let found = scrub(&other, &|_, _| ()).unwrap();
    assert_eq!(found.damaged.len(), 2, "{:?}", found.damaged);
    assert!(!other.has(key("b")) && other.has(key("a")));
    // What is computed again is there again, also for the host that had it before.
    other.put(key("b"), &batch(1000, 1.0)).unwrap();
    assert_eq!(Store::open(here.path()).unwrap().whole(key("b")).unwrap(), batch(1000, 1.0));
}

#[test]
fn unit_a_server_that_is_down_loses_nothing_and_says_so() {
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
fn unit_a_prefix_that_holds_something_else_is_refused() {
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

fn mine(lock: Lock) -> super::super::Publisher {
    match lock {
        Lock::Mine(publisher) => publisher,
        Lock::Held(held) => unreachable!("held: {held:?}"),
    }
}

#[test]
fn unit_one_host_at_a_time_has_a_pipeline() {
    let lab = Lab::new();
    let (here, there) = (lab.host(), lab.host());
    let (one, two) = (Store::open(here.path()).unwrap(), Store::open(there.path()).unwrap());
    let seen = generation(there.path(), "p");
    assert_eq!(seen, Some(0));
    let first = mine(one.lock("p").unwrap());
    assert!(first.follows(generation(there.path(), "p").or(Some(0))) && first.check().is_ok());
    assert_eq!(generation(there.path(), "p"), None);
    let Lock::Held(held) = two.lock("p").unwrap() else { unreachable!("it is held") };
    // The two have different caches, so that the lock of the operating system says nothing.
    assert_eq!(held.holder.as_ref().unwrap().pid, std::process::id());
    assert!(held.told("p", there.path()).contains("holds the lock in s3://bucket/lab/store: process"));
    mine(two.lock("q").unwrap());
    drop(first);
    let second = mine(two.lock("p").unwrap());
    assert!(!second.follows(seen), "another has had it since");
    // One that was taken for gone must not go on.
    let lease = "locks/p.lease-3";
    lab.bucket.put(lease, b"{}".to_vec()).unwrap();
    let fault = second.check().unwrap_err().to_string();
    assert!(fault.contains("now held by another process"), "{fault}");
    drop(second);
    assert!(matches!(one.lock("p").unwrap(), Lock::Held(_)), "a lease that says nothing counts until it is old");
}

#[test]
fn unit_the_lease_of_a_killed_process_of_the_same_cache_is_over_at_once() {
    let lab = Lab::new();
    let here = lab.host();
    let store = Store::open(here.path()).unwrap();
    // Killed, it leaves its lease; the lock of the operating system is free.
    let lock = mine(store.lock("p").unwrap());
    let left = lab.bucket.get("locks/p.lease-1").unwrap().unwrap();
    drop(lock);
    lab.bucket.put("locks/p.lease-1", left).unwrap();
    assert_eq!(generation(here.path(), "p"), None);
    let again = mine(store.lock("p").unwrap());
    assert!(again.check().is_ok());
    assert_eq!(lab.bucket.list("locks").unwrap().len(), 1);
}

#[test]
fn unit_one_of_many_creates_and_one_of_many_replaces() {
    let lab = Lab::new();
    let texts: Vec<String> = (0..8).map(|i| i.to_string()).collect();
    let won = each(&texts, |text| lab.bucket.create("x", text.as_bytes())).unwrap();
    assert_eq!(won.iter().filter(|w| **w).count(), 1);
    let (_, tag) = lab.bucket.get_tagged("x").unwrap().unwrap();
    let texts: Vec<String> = (10..18).map(|i| i.to_string()).collect();
    let won = each(&texts, |text| lab.bucket.replace("x", text.as_bytes(), Some(tag.clone()))).unwrap();
    assert_eq!(won.iter().filter(|w| **w).count(), 1);
    let there = lab.bucket.get("x").unwrap().unwrap();
    // Whoever wrote what is there is told so again: its first answer may have been lost.
    assert!(lab.bucket.create("x", &there).unwrap());
}

#[test]
fn unit_attempts_are_counted_over_all_hosts() {
    let lab = Lab::new();
    let (here, there) = (lab.host(), lab.host());
    let (one, two) = (Store::open(here.path()).unwrap(), Store::open(there.path()).unwrap());
    let (first, second) = (one.attempt(&[key("a")]).unwrap(), two.attempt(&[key("a")]).unwrap());
    assert_eq!((one.attempts_at(&[key("a")])[0].lost, two.attempts().len()), (2, 1));
    first.end(&one, &HashMap::new());
    second.end(&two, &HashMap::from([(key("a"), &Fault::bug("a panic"))]));
    let tries = one.attempts_at(&[key("a")]).remove(0);
    assert_eq!((tries.lost, tries.failed), (0, 1));
    assert!(tries.why.unwrap().starts_with("a panic"));
    one.drop_attempts(|unit| unit == key("a"), None);
    assert_eq!(two.attempts().len(), 0);
}

#[test]
fn unit_an_attempt_at_many_units_is_few_objects_and_those_of_others_are_not_read() {
    let lab = Lab::new();
    let (here, there) = (lab.host(), lab.host());
    let (one, two) = (Store::open(here.path()).unwrap(), Store::open(there.path()).unwrap());
    let keys: Vec<Key> = (0..100).map(|i| key(&i.to_string())).collect();
    let (mine, others) = keys.split_at(98);
    let attempt = one.attempt(mine).unwrap();
    let all = lab.bucket.list("attempts").unwrap();
    assert_eq!(all.len(), 5);
    assert!(all.iter().all(|o| o.key.rsplit('/').next().unwrap().len() <= 128));
    let lost = |store: &Store, keys: &[Key]| store.attempts_at(keys).iter().map(|t| t.lost).collect::<Vec<_>>();
    assert_eq!((lost(&two, mine), lost(&two, others)), (vec![1; 98], vec![0; 2]));
    // An object without a mark of a unit is not read: one that would say so is passed over.
    lab.bucket.put("attempts/strange-0000", format!("here\n{}\n", others[0]).into_bytes()).unwrap();
    let marked = others[0].to_string().starts_with("0000");
    assert_eq!(lost(&two, others), vec![usize::from(marked), 0]);
    lab.bucket.remove("attempts/strange-0000").unwrap();
    // Two fail while the worker lives; another host has computed the others and one of these.
    let why = Fault::bug("a panic");
    attempt.end(&one, &HashMap::from([(mine[0], &why), (mine[97], &why)]));
    assert_eq!(lab.bucket.list("attempts").unwrap().len(), 2);
    two.drop_attempts(|key| key == mine[0], None);
    assert_eq!(two.attempts().keys().collect::<Vec<_>>(), [&mine[97]]);
    two.drop_attempts(|_| false, Some(Duration::ZERO));
    assert_eq!(lab.bucket.list("attempts").unwrap().len(), 0);
}

/// Publishes a table of one unit, and a small one beside it.
fn publish(store: &Store, unit: &str, run: &str) -> Result<bool, Fault> {
    let publisher = mine(store.lock("p")?);
    let packs = vec![pack_of(store, key(unit))];
    let tables = [TableFiles { name: "t".to_owned(), packs: packs.clone(), units: None }];
    let file = store.temporary();
    store.write_table(&file, &batch(2, 7.0), &[])?;
    store.publish(&publisher, run, &tables, &[Beside { name: "failures".to_owned(), file }], &packs, &[])
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
    // The files of both hosts are the same, under the same names.
    let files = |root: &Path| {
        let parts = super::super::parts(&root.join("tables").join("p").join("t")).unwrap();
        parts.iter().map(|p| (p.file_name().unwrap().to_owned(), fs::read(p).unwrap())).collect::<Vec<_>>()
    };
    assert_eq!(files(here.path()), files(there.path()));
    // The other host publishes; a reader that has opened the version before still reads it.
    let two = Store::open(there.path()).unwrap();
    assert!(publish(&two, "b", "second").unwrap());
    assert_eq!(read(here.path(), "t"), batch(5, 1.0));
    super::super::pulled(here.path()).unwrap();
    assert_eq!((read(here.path(), "t"), current(here.path(), "p").unwrap().number), (batch(6, 2.0), 2));
    // Someone else has published since the pointer was read.
    let version = current(here.path(), "p").unwrap();
    let meanwhile = || lab.bucket.put("tables/p", b"../versions/p/9/tables\nx\n".to_vec());
    let remote = Remote::of(here.path()).unwrap().unwrap();
    assert_eq!(read(here.path(), "failures"), batch(2, 7.0));
    let fault = remote.publish("p", &version.folder, &version.manifest, &meanwhile).unwrap_err().to_string();
    assert!(fault.contains("another run published `p`"), "{fault}");
    assert_eq!(current(here.path(), "p").unwrap().number, 2);
}

#[test]
fn unit_gc_drops_what_nothing_names_and_keeps_the_rest() {
    let lab = Lab::new();
    let (here, there) = (lab.host(), lab.host());
    let one = Store::open(here.path()).unwrap();
    for (name, from) in [("a", 1.0), ("b", 2.0), ("c", 3.0)] {
        one.put(key(name), &batch(5, from)).unwrap();
    }
    publish(&one, "a", "first").unwrap();
    publish(&one, "b", "second").unwrap();
    let what = Collect { keep: 1, older_than: Duration::ZERO, dry: true };
    let seen = collect(&one, what).unwrap();
    assert_eq!((seen.packs, seen.versions.as_slice(), seen.busy), (2, ["p/1".to_owned()].as_slice(), false));
    assert_eq!(lab.bucket.list("objects").unwrap().len(), 3, "nothing was removed");
    // A run of another host is at work: packs are kept.
    let two = Store::open(there.path()).unwrap();
    let lock = mine(two.lock("q").unwrap());
    assert!(collect(&one, Collect { dry: false, ..what }).unwrap().busy);
    assert_eq!(lab.bucket.list("objects").unwrap().len(), 3);
    drop(lock);
    let worker = two.attempt(&[key("z")]).unwrap();
    assert!(collect(&one, Collect { dry: false, ..what }).unwrap().busy);
    worker.end(&two, &HashMap::new());
    assert_eq!(collect(&one, Collect { dry: false, ..what }).unwrap().packs, 2);
    assert_eq!(lab.bucket.list("objects").unwrap().len(), 1);
    super::super::pulled(there.path()).unwrap();
    assert_eq!(read(there.path(), "t"), batch(5, 2.0));
    let fresh = Store::open(there.path()).unwrap();
    assert!(!fresh.has(key("a")) && fresh.has(key("b")));
}

/// The files of a store that are the same wherever it is: not those with times.
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
fn unit_a_run_leaves_the_same_bytes_in_an_object_store() {
    let lab = Lab::new();
    let (folder, here, there) = (tempfile::tempdir().unwrap(), lab.host(), lab.host());
    let plan = |root: &Path| {
        let sets = [format!("store={}", root.display())];
        Plan::new(read_spec(Path::new("../datasets/examples/tolles_lawson.toml"), &sets).unwrap(), &catalogue())
            .unwrap()
    };
    let ran = |root: &Path| {
        let store = Store::open(root).unwrap();
        let summary = run::run(&plan(root), &store, run::Options::default(), &run::Quiet).unwrap();
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
    // Each pack was written once, and what is in the bucket is what is in the folder.
    let written = lab.server.writes("lab/store/objects/");
    assert_eq!(written.iter().collect::<std::collections::BTreeSet<_>>().len(), written.len(), "{written:?}");
    for (name, bytes) in expected.iter().filter(|(name, _)| !name.starts_with("versions")) {
        assert_eq!(lab.bucket.get(name).unwrap().as_ref(), Some(bytes), "{name}");
    }
    // Another host finds all of it done, copies what it needs, and has the same tables.
    let again = ran(there.path());
    assert_eq!((again.computed, again.reused), (0, local.computed + local.reused));
    assert_eq!(lab.server.writes("lab/store/objects/").len(), written.len());
    let of = |root: &Path| -> Vec<Vec<u8>> {
        let mut files = vec![];
        for table in &current(root, "tolles_lawson").unwrap().manifest.tables {
            let parts = super::super::parts(&root.join("tables/tolles_lawson").join(&table.name)).unwrap();
            files.extend(parts.iter().map(|p| fs::read(p).unwrap()));
        }
        files
    };
    assert_eq!(of(there.path()), of(folder.path()));
    // Killed after some packs, as these are: the rest is computed by whoever runs it next.
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
fn unit_verify_names_each_damaged_object_of_a_store() {
    let lab = Lab::new();
    let host = lab.host();
    let sets = [format!("store={}", host.path().display())];
    let spec = read_spec(Path::new("../datasets/examples/tolles_lawson.toml"), &sets).unwrap();
    let plan = Plan::new(spec, &catalogue()).unwrap();
    run::run(&plan, &Store::open(host.path()).unwrap(), run::Options::default(), &run::Quiet).unwrap();
    Store::open(host.path()).unwrap().set_checkpoint(key("unit"), b"half of it").unwrap();
    let damaged = || {
        let fresh = lab.host();
        let store = Store::open(fresh.path()).unwrap();
        let found = scrub(&store, &|_, _| ()).unwrap().damaged;
        found.into_keys().map(|path| path.display().to_string()).collect::<Vec<_>>()
    };
    assert_eq!(damaged(), Vec::<String>::new());
    let all: Vec<String> = lab.bucket.list("").unwrap().into_iter().map(|o| o.key).collect();
    // A damaged version is an error of whoever opens the store.
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
