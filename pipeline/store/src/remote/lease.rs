//! Lock of a pipeline in an object store: the lease of `lock.rs`, as objects that only one process can create.

use std::{
    sync::{
        Arc, Condvar, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, SystemTime},
};

use buckets::ObjectEntry;
use schemas::{Fault, keys::HashKey};
use serde::{Deserialize, Serialize};
use uuid::Uuid;

use super::{
    super::lock::{ForeignLock, GONE_AFTER, LockHolder},
    RemoteStore,
};

/// Interval between renewals of a lease.
const BEAT: Duration = Duration::from_secs(15);

/// Content of a lease.
#[derive(Clone, Serialize, Deserialize)]
struct LeaseContent {
    holder: LockHolder,
    /// Cache of the holder. Processes of one boot with the same cache see each other's locks of the operating system.
    cache: String,
    /// Identifier of this lease.
    once: String,
    /// Checksum of the fields that do not change while the lease is held.
    #[serde(default)]
    sum: String,
}

impl LeaseContent {
    fn new(cache: String) -> LeaseContent {
        let (holder, once) = (LockHolder::this(), Uuid::new_v4().to_string());
        let content = LeaseContent { holder, cache, once, sum: String::new() };
        LeaseContent { sum: content.sum_of(), ..content }
    }

    fn sum_of(&self) -> String {
        HashKey::from_parts([self.holder.sum(), self.cache.as_str(), self.once.as_str()]).to_string()
    }
}

/// Whether the object of a lease is intact.
pub(super) fn is_lease_whole(bytes: &[u8]) -> bool {
    let whole = |content: LeaseContent| content.holder.is_whole() && content.sum == content.sum_of();
    serde_json::from_slice(bytes).is_ok_and(whole)
}

/// Lease in the store.
struct LeaseObject {
    number: u64,
    key: String,
    written: SystemTime,
}

/// Lease of this process.
pub struct RemoteLease {
    remote: Arc<RemoteStore>,
    pipeline: String,
    number: u64,
    content: LeaseContent,
    shared: Arc<RemoteHeartbeatState>,
    heart: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct RemoteHeartbeatState {
    over: Mutex<bool>,
    wake: Condvar,
    lost: AtomicBool,
}

fn start(pipeline: &str) -> String {
    format!("locks/{pipeline}.lease-")
}

fn text(content: &LeaseContent) -> Result<Vec<u8>, Fault> {
    serde_json::to_vec(content).map_err(|e| Fault::machine(e.to_string()))
}

impl RemoteStore {
    /// Leases of a pipeline, sorted.
    fn leases(&self, pipeline: &str) -> Result<Vec<LeaseObject>, Fault> {
        let start = start(pipeline);
        let one = |o: ObjectEntry| {
            Some(LeaseObject { number: o.key.strip_prefix(&start)?.parse().ok()?, written: o.modified, key: o.key })
        };
        let mut found: Vec<LeaseObject> = self.bucket.list_flat("locks")?.into_iter().filter_map(one).collect();
        found.sort_by_key(|lease| lease.number);
        Ok(found)
    }

    fn read_lease(&self, lease: &LeaseObject) -> Result<Option<LeaseContent>, Fault> {
        Ok(self.bucket.get(&lease.key)?.and_then(|bytes| serde_json::from_slice(&bytes).ok()))
    }

    /// Time by the server's clock.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn time(&self) -> Result<SystemTime, Fault> {
        let probe = format!("tmp/{}", Uuid::new_v4());
        self.bucket.put(&probe, b"\n".to_vec())?;
        let about = self.bucket.about(&probe);
        self.bucket.remove(&probe)?;
        about?.map(|o| o.modified).ok_or_else(|| Fault::machine("an object that was just written does not exist"))
    }

    /// Number of the last lease of `pipeline`, 0 before the first; `None` while it is held.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn generation(&self, pipeline: &str) -> Result<Option<u64>, Fault> {
        let Some(last) = self.leases(pipeline)?.pop() else { return Ok(Some(0)) };
        Ok(self.read_lease(&last)?.filter(|content| content.holder.is_free()).map(|_| last.number))
    }

    /// Whether a run of any pipeline holds a lease.
    pub(super) fn is_busy(&self) -> Result<bool, Fault> {
        let now = self.time()?;
        for lease in self.bucket.list_flat("locks")?.into_iter().filter(|o| o.key.contains(".lease-")) {
            let lease = LeaseObject { number: 0, written: lease.modified, key: lease.key };
            let free = self.read_lease(&lease)?.is_some_and(|content| self.is_over(&content));
            if !free && !is_silent(now, lease.written) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Whether the holder has released its lease or has ended. A running holder on this boot with this cache would hold
    /// the lock of the cache, but this process holds it.
    fn is_over(&self, content: &LeaseContent) -> bool {
        let boot = LockHolder::this().boot;
        content.holder.is_free() || (content.cache == self.cache && !boot.is_empty() && content.holder.boot == boot)
    }

    /// Takes the lease of `pipeline` for a process that has the lock of the cache, or returns the holder.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn lease(self: &Arc<RemoteStore>, pipeline: &str) -> Result<Result<RemoteLease, ForeignLock>, Fault> {
        let last = self.leases(pipeline)?.pop();
        let number = last.as_ref().map_or(1, |lease| lease.number.saturating_add(1));
        if let Some(lease) = last {
            let content = self.read_lease(&lease)?;
            if !content.as_ref().is_some_and(|content| self.is_over(content)) {
                let now = self.time()?;
                if !is_silent(now, lease.written) {
                    let silent = now.duration_since(lease.written).ok();
                    return Ok(Err(ForeignLock { holder: content.map(|s| s.holder), silent }));
                }
            }
        }
        let content = LeaseContent::new(self.cache.clone());
        let key = format!("{}{number}", start(pipeline));
        let made = self.bucket.create(&key, &text(&content)?)?;
        let known = self.leases(pipeline)?;
        if !made || known.last().is_none_or(|lease| lease.number != number) {
            if made {
                self.bucket.remove(&key)?;
            }
            let holder =
                known.last().map(|lease| self.read_lease(lease)).transpose()?.flatten().map(|content| content.holder);
            return Ok(Err(ForeignLock { holder, silent: None }));
        }
        for older in known.iter().filter(|lease| lease.number < number) {
            // The highest number counts; the next holder removes the other leases.
            let _ = self.bucket.remove(&older.key);
        }
        Ok(Ok(RemoteLease::start(self.clone(), pipeline, number, content)?))
    }
}

fn is_silent(now: SystemTime, written: SystemTime) -> bool {
    now.duration_since(written).is_ok_and(|silent| silent >= GONE_AFTER)
}

impl RemoteLease {
    fn start(
        remote: Arc<RemoteStore>,
        pipeline: &str,
        number: u64,
        content: LeaseContent,
    ) -> Result<RemoteLease, Fault> {
        let shared = Arc::new(RemoteHeartbeatState::default());
        let (of_thread, store, name, bytes) = (shared.clone(), remote.clone(), pipeline.to_owned(), text(&content)?);
        let beat = move || {
            let mut over = of_thread.over.lock().unwrap_or_else(PoisonError::into_inner);
            while !*over {
                let waited = of_thread.wake.wait_timeout(over, BEAT).unwrap_or_else(PoisonError::into_inner);
                over = waited.0;
                if *over || !waited.1.timed_out() {
                    continue;
                }
                // The time of the object follows the server's clock. A failed write is repeated at the next interval.
                match store.leases(&name).map(|all| all.last().map(|lease| lease.number)) {
                    Ok(last) if last != Some(number) => {
                        of_thread.lost.store(true, Ordering::SeqCst);
                        return;
                    }
                    Ok(_) => drop(store.bucket.put(&format!("{}{number}", start(&name)), bytes.clone())),
                    Err(_) => {}
                }
            }
        };
        let thread = std::thread::Builder::new().name("lease".to_owned()).spawn(beat);
        let thread = thread.map_err(|e| Fault::machine(format!("cannot start a thread: {e}")))?;
        Ok(RemoteLease { remote, pipeline: pipeline.to_owned(), number, content, shared, heart: Some(thread) })
    }

    /// Number of the lease.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// Current holder of the lease; `None` if this process still holds the lease.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn taken_by(&self) -> Result<Option<String>, Fault> {
        let last = self.remote.leases(&self.pipeline)?.pop();
        let own = last.as_ref().is_some_and(|lease| lease.number == self.number);
        if own && !self.shared.lost.load(Ordering::SeqCst) {
            return Ok(None);
        }
        let content = last.map(|lease| self.remote.read_lease(&lease)).transpose()?.flatten();
        Ok(Some(content.map_or_else(|| "another process".to_owned(), |content| content.holder.to_string())))
    }
}

impl Drop for RemoteLease {
    fn drop(&mut self) {
        *self.shared.over.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.shared.wake.notify_all();
        self.heart.take().into_iter().for_each(|t| drop(t.join()));
        if self.shared.lost.load(Ordering::SeqCst) {
            return;
        }
        self.content.holder.release();
        // If the write fails, the lease remains until it expires.
        if let Ok(bytes) = text(&self.content) {
            let _ = self.remote.bucket.put(&format!("{}{}", start(&self.pipeline), self.number), bytes);
        }
    }
}
