//! Objects below an address, with blocking calls.

use std::{
    fs::File,
    future::Future,
    io::{Read, Write},
    ops::Range,
    path::Path,
    sync::{
        Arc, Mutex, OnceLock, PoisonError,
        atomic::{AtomicUsize, Ordering},
        mpsc,
    },
    thread,
    time::{Duration, Instant, SystemTime},
};

use futures::TryStreamExt;
use object_store::{
    Error, GetOptions, GetRange, ObjectMeta, ObjectStore, ObjectStoreExt, PutMode, PutOptions, PutPayload,
    UpdateVersion, path::Path as Name,
};
use schemas::Fault;
use tokio::runtime::Runtime;

use super::{
    address::ObjectAddress,
    errors::{is_cut, is_forbidden, is_missing, is_missing_bucket, is_unanswered},
    redact::redacted,
};

/// Size of a part, in bytes: longer objects are read and written in parts.
const PART: u64 = 16 << 20;
/// Maximum number of concurrent requests.
const AT_ONCE: usize = 16;
/// Maximum number of attempts at a request that gets no complete answer.
const TRIALS: u32 = 4;
/// A request is not retried if more than this time has passed since its first attempt.
pub(super) const RETRY_TIMEOUT: Duration = Duration::from_secs(120);
/// Number of threads that wait for answers.
const THREADS: usize = 2;

/// Version of an object, as assigned by the server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ObjectVersion(UpdateVersion);

/// Object in the listing of a bucket.
#[derive(Clone, Debug)]
pub struct ObjectEntry {
    /// Name below the address.
    pub key: String,
    /// Size, in bytes.
    pub size: u64,
    /// Version, if the server reports a version.
    pub tag: Option<String>,
    /// Time of writing, by the server's clock.
    pub modified: SystemTime,
}

/// Objects below an address.
#[derive(Clone)]
pub struct Bucket {
    objects: Arc<dyn ObjectStore>,
    address: ObjectAddress,
}

/// Runs requests on separate threads and waits for the result. The caller's thread may belong to another runtime, which
/// these futures must not block.
fn wait<T: Send + 'static>(work: impl Future<Output = T> + Send + 'static) -> Result<T, Fault> {
    static RUNTIME: OnceLock<Option<Runtime>> = OnceLock::new();
    let build = || tokio::runtime::Builder::new_multi_thread().worker_threads(THREADS).enable_all().build().ok();
    let runtime = RUNTIME.get_or_init(build).as_ref();
    let runtime = runtime.ok_or_else(|| Fault::machine("cannot start threads for requests to an object store"))?;
    let (send, receive) = mpsc::channel();
    runtime.spawn(async move {
        // The receiver below waits for the answer, so sending does not fail.
        let _ = send.send(work.await);
    });
    receive.recv().map_err(|_| Fault::bug("a request to an object store ended without a response"))
}

/// Calls `work` on every item, several at a time. The results are in the order of the items; the first fault ends the
/// work.
///
/// # Errors
/// Fails if `work` fails.
pub fn each<T: Sync, A: Send>(items: &[T], work: impl Fn(&T) -> Result<A, Fault> + Sync) -> Result<Vec<A>, Fault> {
    let next = AtomicUsize::new(0);
    let answers: Vec<Mutex<Option<Result<A, Fault>>>> = items.iter().map(|_| Mutex::new(None)).collect();
    thread::scope(|scope| {
        for _ in 0..AT_ONCE.min(items.len()) {
            scope.spawn(|| {
                while let Some((i, item)) =
                    Some(next.fetch_add(1, Ordering::Relaxed)).and_then(|i| Some((i, items.get(i)?)))
                {
                    let answer = work(item);
                    if answer.is_err() {
                        next.fetch_add(items.len(), Ordering::Relaxed);
                    }
                    if let Some(place) = answers.get(i) {
                        *place.lock().unwrap_or_else(PoisonError::into_inner) = Some(answer);
                    }
                }
            });
        }
    });
    let mut found = vec![];
    let mut fault = None;
    for answer in answers {
        match answer.into_inner().unwrap_or_else(PoisonError::into_inner) {
            Some(Ok(answer)) => found.push(answer),
            Some(Err(wrong)) => fault = fault.or(Some(wrong)),
            None => {}
        }
    }
    fault.map_or(Ok(found), Err)
}

fn listed(about: &ObjectMeta, prefix: &str) -> Option<ObjectEntry> {
    let key = about.location.as_ref().strip_prefix(prefix)?.trim_start_matches('/').to_owned();
    let modified = SystemTime::from(about.last_modified);
    Some(ObjectEntry { key, size: about.size, tag: about.e_tag.clone(), modified })
}

impl Bucket {
    /// Bucket of `objects` below `address`.
    #[cfg_attr(not(any(feature = "object-stores", test)), allow(dead_code))]
    pub fn new(objects: Arc<dyn ObjectStore>, address: ObjectAddress) -> Bucket {
        Bucket { objects, address }
    }

    /// Address of the bucket.
    pub fn address(&self) -> &ObjectAddress {
        &self.address
    }

    fn name(&self, key: &str) -> Result<Name, Fault> {
        let whole = self.address.below(key);
        Name::parse(&whole.key).map_err(|e| Fault::new(format!("{whole} is not a valid object name: {e}")))
    }

    fn fault(&self, doing: &str, key: &str, error: &Error) -> Fault {
        let (address, text) = (self.address.below(key), redacted(&error.to_string()));
        let what = format!("cannot {doing} {address}: {text}");
        if is_missing_bucket(error) {
            let ObjectAddress { scheme, bucket, .. } = &self.address;
            return Fault::machine(format!("there is no bucket {}://{bucket}", scheme.as_str()))
                .help("create the bucket with the tools of its provider, or use another bucket");
        }
        match error {
            Error::Precondition { .. } => {
                Fault::machine(format!("cannot {doing} {address}: another process replaced the object"))
                    .help("run again")
            }
            _ if text.contains("169.254.169.254") || text.contains("metadata.google") => {
                Fault::machine(format!("cannot {doing} {address}: there are no credentials"))
                    .help("set credentials in the environment or a profile; see pipeline/OBJECTS.md")
            }
            _ if is_forbidden(error, &text) => Fault::machine(what).help(
                "the credentials in the environment or the profile do not permit this request; see pipeline/OBJECTS.md",
            ),
            Error::NotImplemented { .. } | Error::NotSupported { .. } => Fault::machine(what)
                .help("the server lacks an operation that a store requires, such as conditional writes"),
            _ if text.contains("status code: 30") => {
                Fault::machine(what).help("the server redirects to another server; set that server as the endpoint")
            }
            _ if text.contains("error sending request") => {
                Fault::machine(what).help("the server did not respond in time; check the network and the endpoint")
            }
            _ => Fault::machine(what),
        }
    }

    /// Object and its version; `None` if missing.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn get_tagged(&self, key: &str) -> Result<Option<(Vec<u8>, ObjectVersion)>, Fault> {
        let (objects, name) = (self.objects.clone(), self.name(key)?);
        let read = move || async move {
            let found = objects.get_opts(&name, GetOptions::default()).await?;
            let tag =
                ObjectVersion(UpdateVersion { e_tag: found.meta.e_tag.clone(), version: found.meta.version.clone() });
            let size = found.meta.size;
            Ok::<_, Error>((found.bytes().await?, size, tag))
        };
        for trial in 0..TRIALS {
            pause(trial);
            match wait(read.clone()())? {
                Ok((bytes, size, tag)) if bytes.len() as u64 == size => return Ok(Some((bytes.to_vec(), tag))),
                Ok(_) => {}
                Err(e) if is_cut(&e) => {}
                Err(e) if is_missing(&e) => return Ok(None),
                Err(e) => return Err(self.fault("read", key, &e)),
            }
        }
        Err(self.cut(key))
    }

    fn cut(&self, key: &str) -> Fault {
        let what = format!("cannot read {}: the response was truncated {TRIALS} times", self.address.below(key));
        Fault::machine(what).help("run again; if the error persists, check the proxies of your network")
    }

    /// Object; `None` if missing.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn get(&self, key: &str) -> Result<Option<Vec<u8>>, Fault> {
        Ok(self.get_tagged(key)?.map(|(bytes, _)| bytes))
    }

    /// Size, version and time of an object; `None` if missing.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn about(&self, key: &str) -> Result<Option<ObjectEntry>, Fault> {
        let (objects, name) = (self.objects.clone(), self.name(key)?);
        match wait(async move { objects.head(&name).await })? {
            Ok(about) => Ok(listed(&about, &self.address.key)),
            Err(e) if is_missing(&e) => Ok(None),
            Err(e) => Err(self.fault("read", key, &e)),
        }
    }

    /// Bytes of an object in a range; `None` if the object is missing.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error, or if the object is shorter.
    pub fn range(&self, key: &str, range: Range<u64>, tag: Option<&str>) -> Result<Option<Vec<u8>>, Fault> {
        let (objects, name) = (self.objects.clone(), self.name(key)?);
        let want = range.end.saturating_sub(range.start);
        let options = GetOptions {
            range: Some(GetRange::Bounded(range)),
            if_match: tag.map(str::to_owned),
            ..GetOptions::default()
        };
        let read = move || async move { objects.get_opts(&name, options).await?.bytes().await };
        for trial in 0..TRIALS {
            pause(trial);
            match wait(read.clone()())? {
                Ok(bytes) if bytes.len() as u64 == want => return Ok(Some(bytes.to_vec())),
                Ok(_) => {}
                Err(e) if is_cut(&e) => {}
                Err(e) if is_missing(&e) => return Ok(None),
                Err(e) => return Err(self.fault("read", key, &e)),
            }
        }
        Err(self.cut(key))
    }

    /// Writes an object to the file `to` and syncs the file to the disk. Returns whether the object exists.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error, the object does not have the given `size`, or the
    /// file cannot be written.
    pub fn fetch(&self, key: &str, to: &Path, size: Option<u64>) -> Result<bool, Fault> {
        let (objects, name) = (self.objects.clone(), self.name(key)?);
        let first = move || async move {
            let found = objects.get_opts(&name, GetOptions::default()).await?;
            let about = found.meta.clone();
            // A large object is read in parts, each within the time limit of a request.
            let bytes = if about.size > PART { None } else { Some(found.bytes().await?) };
            Ok::<_, Error>((about, bytes))
        };
        let fail = |e: std::io::Error| Fault::machine(format!("cannot write {}: {e}", to.display()));
        for trial in 0..TRIALS {
            pause(trial);
            let (about, bytes) = match wait(first.clone()())? {
                Ok(found) => found,
                Err(e) if is_cut(&e) => continue,
                Err(e) if is_missing(&e) => return Ok(false),
                Err(e) => return Err(self.fault("read", key, &e)),
            };
            if size.is_some_and(|size| size != about.size) {
                continue;
            }
            let mut file = File::create(to).map_err(fail)?;
            let whole = match bytes {
                Some(bytes) => {
                    file.write_all(&bytes).map_err(fail)?;
                    bytes.len() as u64 == about.size
                }
                None => {
                    let mut at = 0;
                    while at < about.size {
                        let end = (at + PART).min(about.size);
                        let Some(part) = self.range(key, at..end, about.e_tag.as_deref())? else { break };
                        file.write_all(&part).map_err(fail)?;
                        at = end;
                    }
                    at == about.size
                }
            };
            if whole {
                file.set_modified(SystemTime::from(about.last_modified)).map_err(fail)?;
                file.sync_all().map_err(fail)?;
                return Ok(true);
            }
        }
        Err(self.cut(key))
    }

    fn put_as(&self, key: &str, bytes: Vec<u8>, mode: PutMode) -> Result<Result<ObjectVersion, Error>, Fault> {
        let (objects, name) = (self.objects.clone(), self.name(key)?);
        let options = PutOptions { mode, ..PutOptions::default() };
        let done = wait(async move { objects.put_opts(&name, PutPayload::from(bytes), options).await })?;
        Ok(done.map(|put| ObjectVersion(put.into())))
    }

    /// Writes an object, replacing an existing one.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn put(&self, key: &str, bytes: Vec<u8>) -> Result<(), Fault> {
        self.put_as(key, bytes, PutMode::Overwrite)?.map(drop).map_err(|e| self.fault("write", key, &e))
    }

    /// Creates an object. Returns `false` if the object exists.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn create(&self, key: &str, bytes: &[u8]) -> Result<bool, Fault> {
        self.on_condition(key, bytes, PutMode::Create)
    }

    /// Writes an object if its version is still `tag`, or if it does not exist and `tag` is `None`. Returns whether it
    /// was written.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn replace(&self, key: &str, bytes: &[u8], tag: Option<ObjectVersion>) -> Result<bool, Fault> {
        self.on_condition(key, bytes, tag.map_or(PutMode::Create, |tag| PutMode::Update(tag.0)))
    }

    fn on_condition(&self, key: &str, bytes: &[u8], mode: PutMode) -> Result<bool, Fault> {
        let (begun, mut trial) = (Instant::now(), 0);
        loop {
            trial += 1;
            let last = trial >= TRIALS || begun.elapsed() > RETRY_TIMEOUT;
            match self.put_as(key, bytes.to_vec(), mode.clone())? {
                Ok(_) => return Ok(true),
                Err(e @ (Error::AlreadyExists { .. } | Error::Precondition { .. })) => match (self.get(key)?, &mode) {
                    // The answer to an earlier attempt may have been lost, and this writer may have written the
                    // existing object.
                    (Some(there), _) => return Ok(there == bytes),
                    // Another request was in progress (status 409), or the object has since been removed.
                    (None, PutMode::Create) if last => return Err(self.fault("write", key, &e)),
                    (None, PutMode::Create) => {}
                    (None, PutMode::Overwrite | PutMode::Update(_)) => return Ok(false),
                },
                // The HTTP client does not retry a request without an answer, because it cannot compare the existing
                // object with the bytes; this loop can.
                Err(e) if last || !is_unanswered(&e) => return Err(self.fault("write", key, &e)),
                Err(_) => {}
            }
            pause(trial);
        }
    }

    /// Writes the file `from` as an object. The object becomes visible only when it is complete.
    ///
    /// # Errors
    /// Fails if the file cannot be read, or the server cannot be reached or reports an error.
    pub fn put_file(&self, key: &str, from: &Path) -> Result<(), Fault> {
        let fail = |e: std::io::Error| Fault::machine(format!("cannot read {}: {e}", from.display()));
        let mut file = File::open(from).map_err(fail)?;
        let size = file.metadata().map_err(fail)?.len();
        if size <= PART {
            let mut bytes = vec![];
            file.read_to_end(&mut bytes).map_err(fail)?;
            return self.put(key, bytes);
        }
        let (objects, name) = (self.objects.clone(), self.name(key)?);
        let written = wait(async move {
            let mut upload = objects.put_multipart(&name).await?;
            let mut left = size;
            while left > 0 {
                let mut part = vec![0; usize::try_from(left.min(PART)).unwrap_or(usize::MAX)];
                let sent = match file.read_exact(&mut part) {
                    Ok(()) => upload.put_part(PutPayload::from(part)).await,
                    Err(e) => Err(Error::Generic { store: "local file", source: Box::new(e) }),
                };
                if let Err(e) = sent {
                    // Uploaded parts are invisible. If the abort fails, a lifecycle rule of the bucket can remove them.
                    let _ = upload.abort().await;
                    return Err(e);
                }
                left = left.saturating_sub(PART);
            }
            upload.complete().await.map(drop)
        })?;
        written.map_err(|e| self.fault("write", key, &e))
    }

    /// All objects whose names begin with the folder `folder`; all objects if `folder` is empty.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn list(&self, folder: &str) -> Result<Vec<ObjectEntry>, Fault> {
        let (objects, name) = (self.objects.clone(), self.name(folder)?);
        let list = move || async move { objects.list(Some(&name)).try_collect::<Vec<_>>().await };
        self.of_listing(folder, list)
    }

    /// Objects directly in the folder `folder`.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn list_flat(&self, folder: &str) -> Result<Vec<ObjectEntry>, Fault> {
        let (objects, name) = (self.objects.clone(), self.name(folder)?);
        let list = move || async move { objects.list_with_delimiter(Some(&name)).await.map(|list| list.objects) };
        self.of_listing(folder, list)
    }

    fn of_listing<F>(&self, folder: &str, list: impl FnOnce() -> F + Clone) -> Result<Vec<ObjectEntry>, Fault>
    where
        F: Future<Output = Result<Vec<ObjectMeta>, Error>> + Send + 'static,
    {
        for trial in 0..TRIALS {
            pause(trial);
            match wait(list.clone()())? {
                Ok(found) => {
                    let mut all: Vec<ObjectEntry> =
                        found.iter().filter_map(|about| listed(about, &self.address.key)).collect();
                    all.sort_by(|a, b| a.key.cmp(&b.key));
                    return Ok(all);
                }
                Err(e) if is_cut(&e) => {}
                Err(e) if is_missing(&e) => return Ok(vec![]),
                Err(e) => return Err(self.fault("list", folder, &e)),
            }
        }
        Err(self.cut(folder))
    }

    /// Removes an object; succeeds if it is missing.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn remove(&self, key: &str) -> Result<(), Fault> {
        let (objects, name) = (self.objects.clone(), self.name(key)?);
        let delete = move || async move { objects.delete(&name).await };
        let (begun, mut trial) = (Instant::now(), 0);
        loop {
            trial += 1;
            match wait(delete.clone()())? {
                Ok(()) => return Ok(()),
                Err(e) if is_missing(&e) => return Ok(()),
                Err(e) if trial >= TRIALS || begun.elapsed() > RETRY_TIMEOUT || !is_unanswered(&e) => {
                    return Err(self.fault("remove", key, &e));
                }
                Err(_) => pause(trial),
            }
        }
    }

    /// Renames an object.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn rename(&self, from: &str, to: &str) -> Result<(), Fault> {
        let (objects, old, new) = (self.objects.clone(), self.name(from)?, self.name(to)?);
        let done = wait(async move {
            objects.copy(&old, &new).await?;
            objects.delete(&old).await
        })?;
        match done {
            Ok(()) => Ok(()),
            Err(e) if is_missing(&e) => Ok(()),
            Err(e) => Err(self.fault("rename", from, &e)),
        }
    }
}

/// Waits before each attempt except the first.
fn pause(trial: u32) {
    if trial > 0 {
        thread::sleep(Duration::from_millis(100 << trial));
    }
}
