//! Lock of a pipeline: one run of it at a time in a store, on any host.
//!
//! On one host, a lock of the operating system excludes other runs; it ends with the process that holds it. A file
//! system may not show the locks of other hosts. For other hosts, the lease `locks/<pipeline>.lease-<n>` with the
//! highest number names the holder, who writes to it every [`BEAT`]. A lease is over when its holder has released it,
//! or when its holder is on this host and the lock is free. A lease is also over when it was not written for
//! [`GONE_AFTER`], by the clock of the file system. The next holder creates the file of the next number, which only one
//! process can do. A number is not used twice. A process that was paused thus cannot take the lease of another process.

mod holder;

use std::{
    fmt,
    fs::{self, File},
    io::{self, Write},
    os::unix::fs::FileExt,
    path::{Path, PathBuf},
    sync::{
        Arc, Condvar, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{JoinHandle, sleep},
    time::{Duration, SystemTime},
};

use schemas::{Fault, paths};

use super::{
    Store, io_fault, own_file, pipeline_name,
    remote::{RemoteLease, RemoteStore},
    shown,
};
pub use holder::{LockHolder, boot, host};

/// Interval between renewals of a lease.
const BEAT: Duration = Duration::from_secs(10);
/// Upper limit of lease numbers, which increase by one; a file with a higher number is ignored.
const MOST: u64 = 1 << 53;
/// A holder on another host is assumed dead if its last renewal is older than this.
pub const GONE_AFTER: Duration = Duration::from_secs(120);
/// Polling intervals while waiting for a lock on this machine, and for a lock in an object store.
const LOOK_AGAIN: [Duration; 2] = [Duration::from_millis(200), Duration::from_secs(3)];

/// Lock that another process holds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ForeignLock {
    /// Process that holds the lock; `None` if the lease does not name it.
    pub holder: Option<LockHolder>,
    /// Time since the last renewal.
    pub silent: Option<Duration>,
}

impl ForeignLock {
    /// Message for the user.
    pub fn message(&self, pipeline: &str, root: &Path) -> String {
        let by = self.holder.as_ref().map(|h| format!(": {h}")).unwrap_or_default();
        let sign = self.silent.map(|s| format!(" (lease last renewed {} s ago)", s.as_secs())).unwrap_or_default();
        format!("another run of `{pipeline}` holds the lock in {}{by}{sign}", shown(root))
    }
}

/// Outcome of a lock request.
pub enum LockOutcome {
    /// This process holds the lock.
    Mine(PipelineLock),
    /// Another process holds the lock.
    Held(ForeignLock),
}

/// Lock of one pipeline, for computing and publishing its tables; one process holds it at a time.
pub struct PipelineLock {
    pipeline: String,
    folder: PathBuf,
    number: u64,
    text: String,
    heart: LeaseHeartbeat,
    /// Lease in the object store, if the folder is a copy of an object store.
    lease: Option<Box<RemoteLease>>,
    _lock: File,
}

/// Thread that renews a lease.
struct LeaseHeartbeat {
    shared: Arc<LeaseHeartbeatState>,
    file: File,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct LeaseHeartbeatState {
    over: Mutex<bool>,
    wake: Condvar,
    lost: AtomicBool,
}

/// Lease in the folder of locks.
struct LeaseFile {
    number: u64,
    holder: Option<LockHolder>,
    written: SystemTime,
}

fn prefix(pipeline: &str) -> String {
    format!("{pipeline}.lease-")
}

/// Whether a file in the folder of locks is intact: a lease names its holder, and a lock file is empty.
pub(super) fn is_whole(name: &str, bytes: &[u8]) -> bool {
    if name.contains(".lease-") { LockHolder::read(bytes).is_some_and(|h| h.is_whole()) } else { bytes.is_empty() }
}

/// Numbers of the leases of a pipeline, sorted.
fn numbers(folder: &Path, pipeline: &str) -> io::Result<Vec<u64>> {
    let start = prefix(pipeline);
    let number = |e: fs::DirEntry| e.file_name().to_str()?.strip_prefix(&start)?.parse().ok().filter(|n| *n < MOST);
    let mut found: Vec<u64> = fs::read_dir(folder)?.flatten().filter_map(number).collect();
    found.sort_unstable();
    Ok(found)
}

/// Number of the last lease of `pipeline` in the store at `root`, 0 before the first; `None` while it is held.
pub fn generation(root: &Path, pipeline: &str) -> Option<u64> {
    match RemoteStore::from_cache(root) {
        Ok(Some(remote)) => return remote.generation(pipeline).ok().flatten(),
        Ok(None) => {}
        Err(_) => return None,
    }
    match LeaseFile::newest(&root.join("locks"), pipeline) {
        Ok(Some(lease)) => lease.holder.filter(|h| h.free).map(|_| lease.number),
        Ok(None) => Some(0),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Some(0),
        Err(_) => None,
    }
}

impl LeaseFile {
    fn newest(folder: &Path, pipeline: &str) -> io::Result<Option<LeaseFile>> {
        let Some(number) = numbers(folder, pipeline)?.last().copied() else { return Ok(None) };
        let path = folder.join(format!("{}{number}", prefix(pipeline)));
        let written = fs::metadata(&path)?.modified()?;
        Ok(Some(LeaseFile { number, holder: LockHolder::read(&paths::read_regular(&path)?), written }))
    }

    /// Whether the holder is dead, as seen by a process that has the lock of the operating system.
    fn is_over(&self, boot: &str, now: SystemTime) -> bool {
        match &self.holder {
            Some(holder) if holder.free => true,
            // A running holder would hold the lock of the operating system.
            Some(holder) if !boot.is_empty() && holder.boot == boot => true,
            // Renewals carry the time of the file system, so a time in the future is not a renewal.
            Some(_) | None => match now.duration_since(self.written) {
                Ok(silent) => silent >= GONE_AFTER,
                Err(ahead) => ahead.duration() >= GONE_AFTER,
            },
        }
    }

    fn held(self, now: Option<SystemTime>) -> ForeignLock {
        let silent = now.and_then(|now| now.duration_since(self.written).ok());
        // A released lease does not show who holds the lock of the operating system now.
        match self.holder {
            Some(holder) if holder.free => ForeignLock::default(),
            holder => ForeignLock { holder, silent },
        }
    }
}

impl LeaseHeartbeat {
    fn start(folder: &Path, pipeline: &str, number: u64, end: u64, file: File) -> io::Result<LeaseHeartbeat> {
        let shared = Arc::new(LeaseHeartbeatState::default());
        let (of_thread, folder, pipeline) = (shared.clone(), folder.to_owned(), pipeline.to_owned());
        let writer = file.try_clone()?;
        let beat = move || {
            let mut over = of_thread.over.lock().unwrap_or_else(PoisonError::into_inner);
            while !*over {
                let waited = of_thread.wake.wait_timeout(over, BEAT).unwrap_or_else(PoisonError::into_inner);
                over = waited.0;
                if !*over && waited.1.timed_out() {
                    if numbers(&folder, &pipeline).is_ok_and(|n| n.last() != Some(&number)) {
                        of_thread.lost.store(true, Ordering::SeqCst);
                        return;
                    }
                    // The file system sets the time of the file by its own clock. If the write fails, other processes
                    // do not see this renewal.
                    let _ = writer.write_all_at(b"\n", end);
                }
            }
        };
        let thread = std::thread::Builder::new().name("lock".to_owned()).spawn(beat)?;
        Ok(LeaseHeartbeat { shared, file, thread: Some(thread) })
    }
}

impl PipelineLock {
    /// Name of the pipeline.
    pub fn pipeline(&self) -> &str {
        &self.pipeline
    }

    /// Whether no other process has held the lock since [`generation`] returned `seen`.
    pub fn follows(&self, seen: Option<u64>) -> bool {
        let number = self.lease.as_ref().map_or(self.number, |lease| lease.number());
        seen.is_some_and(|n| number == n.saturating_add(1))
    }

    /// Checks that this process still holds the lock.
    ///
    /// # Errors
    /// Fails if another process has taken it.
    pub fn check(&self) -> Result<(), Fault> {
        let newest = numbers(&self.folder, &self.pipeline).ok().and_then(|n| n.last().copied());
        let by = if newest == Some(self.number) && !self.heart.shared.lost.load(Ordering::SeqCst) {
            match self.lease.as_ref().map_or(Ok(None), |lease| lease.taken_by())? {
                Some(by) => by,
                None => return Ok(()),
            }
        } else {
            let by = LeaseFile::newest(&self.folder, &self.pipeline).ok().flatten().and_then(|l| l.holder);
            by.map_or_else(|| "another process".to_owned(), |h| h.to_string())
        };
        let seconds = GONE_AFTER.as_secs();
        let what = format!(
            "the lock of `{}` is now held by {by}, because this run did not renew its lease for \
             {seconds} s",
            self.pipeline
        );
        Err(Fault::machine(what).help("nothing was published; finished results are stored; run the spec again"))
    }
}

impl Drop for PipelineLock {
    fn drop(&mut self) {
        // The lease is released first, so the next holder of this cache's lock finds it free.
        self.lease.take();
        *self.heart.shared.over.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.heart.shared.wake.notify_all();
        self.heart.thread.take().into_iter().for_each(|t| drop(t.join()));
        // The new text has the same length, so a single write is enough. If the write fails, the lease ends only when
        // it expires.
        let free = self.text.replace("\"free\":false", "\"free\":true ");
        let _ = self.heart.file.write_all_at(free.as_bytes(), 0).and_then(|()| self.heart.file.sync_all());
    }
}

impl Store {
    /// Time by the clock of the store's file system.
    fn time_there(&self) -> io::Result<SystemTime> {
        let probe = self.temporary();
        let time = File::create(&probe).and_then(|mut f| f.write_all(b"\n").and_then(|()| f.metadata()?.modified()));
        let _ = fs::remove_file(&probe);
        time
    }

    /// Takes the lock of `pipeline`, or returns its holder.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn lock(&self, pipeline: &str) -> Result<LockOutcome, Fault> {
        let mut publisher = match self.lock_here(pipeline)? {
            LockOutcome::Mine(publisher) => publisher,
            held @ LockOutcome::Held(_) => return Ok(held),
        };
        if let Some(remote) = self.remote() {
            match remote.lease(pipeline)? {
                Ok(lease) => publisher.lease = Some(Box::new(lease)),
                Err(held) => return Ok(LockOutcome::Held(held)),
            }
        }
        Ok(LockOutcome::Mine(publisher))
    }

    /// Takes the lock of `pipeline` in the store's folder, or returns its holder.
    fn lock_here(&self, pipeline: &str) -> Result<LockOutcome, Fault> {
        pipeline_name(pipeline)?;
        let folder = self.root().join("locks");
        let path = folder.join(format!("{pipeline}.lock"));
        let fail = |e: &dyn fmt::Display| io_fault("lock", &path, e);
        // The file is not truncated, because only the lock matters.
        let options = File::options().write(true).create(true).truncate(false).clone();
        let lock = own_file(self.root(), &path, &options).map_err(|e| fail(&e))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(fs::TryLockError::WouldBlock) => return Ok(LockOutcome::Held(self.held(&folder, pipeline))),
            Err(fs::TryLockError::Error(e)) => return Err(fail(&e)),
        }
        let newest = match LeaseFile::newest(&folder, pipeline) {
            // The lease file no longer exists, because the holder has just taken another number.
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(LockOutcome::Held(ForeignLock::default())),
            newest => newest.map_err(|e| fail(&e))?,
        };
        let this = LockHolder::this();
        let number = newest.as_ref().map_or(1, |l| l.number.saturating_add(1));
        if let Some(lease) = newest {
            let now = self.time_there().map_err(|e| fail(&e))?;
            if !lease.is_over(&this.boot, now) {
                return Ok(LockOutcome::Held(lease.held(Some(now))));
            }
        }
        let text = serde_json::to_string(&this).map_err(|e| fail(&e))? + "\n";
        let to = folder.join(format!("{}{number}", prefix(pipeline)));
        if !self.lease(&to, text.as_bytes()).map_err(|e| fail(&e))? {
            return Ok(LockOutcome::Held(self.held(&folder, pipeline)));
        }
        let known = numbers(&folder, pipeline).map_err(|e| fail(&e))?;
        if known.last() != Some(&number) {
            let _ = fs::remove_file(&to);
            return Ok(LockOutcome::Held(self.held(&folder, pipeline)));
        }
        for older in known.iter().filter(|n| **n < number) {
            // A file that cannot be removed has a lower number, and is removed later.
            let _ = fs::remove_file(folder.join(format!("{}{older}", prefix(pipeline))));
        }
        let heart = File::options()
            .write(true)
            .open(&to)
            .and_then(|file| LeaseHeartbeat::start(&folder, pipeline, number, text.len() as u64, file))
            .map_err(|e| fail(&e))?;
        Ok(LockOutcome::Mine(PipelineLock {
            pipeline: pipeline.to_owned(),
            folder,
            number,
            text,
            heart,
            lease: None,
            _lock: lock,
        }))
    }

    /// Creates the complete file of a lease; `false` if the file exists.
    fn lease(&self, to: &Path, text: &[u8]) -> io::Result<bool> {
        let tmp = self.temporary();
        File::create(&tmp).and_then(|mut f| f.write_all(text).and_then(|()| f.sync_all()))?;
        let made = match fs::hard_link(&tmp, to) {
            Err(e) if e.kind() != io::ErrorKind::AlreadyExists => {
                // Fallback for a file system without links.
                File::options().create_new(true).write(true).open(to).and_then(|mut f| f.write_all(text))
            }
            made => made,
        };
        let _ = fs::remove_file(&tmp);
        match made {
            Ok(()) => Ok(true),
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => Ok(false),
            Err(e) => Err(e),
        }
    }

    fn held(&self, folder: &Path, pipeline: &str) -> ForeignLock {
        let lease = LeaseFile::newest(folder, pipeline).ok().flatten();
        lease.map(|l| l.held(self.time_there().ok())).unwrap_or_default()
    }

    /// Polling interval for a lock.
    pub fn look_again(&self) -> Duration {
        let [here, there] = LOOK_AGAIN;
        if self.is_copy() { there } else { here }
    }

    /// Takes the lock of `pipeline`. If another process holds the lock, waits or fails.
    ///
    /// # Errors
    /// Fails if another process holds it, or the file system reports an error.
    pub fn publisher(&self, pipeline: &str, wait: bool) -> Result<PipelineLock, Fault> {
        loop {
            match self.lock(pipeline)? {
                LockOutcome::Mine(publisher) => return Ok(publisher),
                LockOutcome::Held(_) if wait => sleep(self.look_again()),
                LockOutcome::Held(held) => {
                    let fault = Fault::machine(held.message(pipeline, self.root()));
                    return Err(fault.help("wait for that run with `--wait`, or give another `store`"));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]

    use super::*;

    fn mine(lock: LockOutcome) -> PipelineLock {
        match lock {
            LockOutcome::Mine(publisher) => publisher,
            LockOutcome::Held(held) => panic!("held: {held:?}"),
        }
    }

    fn held(lock: LockOutcome) -> ForeignLock {
        match lock {
            LockOutcome::Held(held) => held,
            LockOutcome::Mine(_) => panic!("it was free"),
        }
    }

    /// Lease of a process on another host, last renewed `silent` ago.
    fn foreign(root: &Path, number: u64, silent: Duration) -> PathBuf {
        let holder =
            LockHolder { host: "elsewhere".to_owned(), boot: "other".to_owned(), ..LockHolder::this() }.signed();
        let path = root.join("locks").join(format!("p.lease-{number}"));
        fs::write(&path, serde_json::to_string(&holder).unwrap()).unwrap();
        File::options().write(true).open(&path).unwrap().set_modified(SystemTime::now() - silent).unwrap();
        path
    }

    #[test]
    fn unit_lock_is_held_reported_and_released() {
        let folder = tempfile::tempdir().unwrap();
        let (one, two) = (Store::open(folder.path()).unwrap(), Store::open(folder.path()).unwrap());
        let before = generation(folder.path(), "p");
        let first = mine(one.lock("p").unwrap());
        assert!(first.follows(before) && first.check().is_ok());
        let seen = held(two.lock("p").unwrap()).holder.unwrap();
        assert_eq!((seen.pid, seen.host), (std::process::id(), host()));
        // The state read while the lock was held can be outdated when the lock is free.
        assert_eq!(generation(folder.path(), "p"), None);
        // Locks of different pipelines are independent.
        mine(two.lock("q").unwrap());
        drop(first);
        let second = mine(two.lock("p").unwrap());
        assert!(!second.follows(before));
        assert_eq!(numbers(&folder.path().join("locks"), "p").unwrap(), [2]);
    }

    #[test]
    fn unit_foreign_holder_expires_when_silent() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        foreign(folder.path(), 7, Duration::from_secs(60));
        let held_lock = held(store.lock("p").unwrap());
        assert_eq!(held_lock.holder.as_ref().unwrap().host, "elsewhere");
        assert!((59..=70).contains(&held_lock.silent.unwrap().as_secs()));
        assert!(held_lock.message("p", folder.path()).contains("on elsewhere, since"));
        foreign(folder.path(), 7, GONE_AFTER + Duration::from_secs(1));
        let taken = mine(store.lock("p").unwrap());
        assert_eq!(taken.number, 8);
        // The apparently dead holder returns and takes the next number, so its replacement must not publish.
        foreign(folder.path(), 9, Duration::ZERO);
        let fault = taken.check().unwrap_err();
        assert!(fault.what.contains("now held by") && fault.what.contains("elsewhere"), "{}", fault.what);
    }

    #[test]
    fn unit_one_of_many_processes_takes_an_expired_lease() {
        let folder = tempfile::tempdir().unwrap();
        let stores: Vec<Store> = (0..8).map(|_| Store::open(folder.path()).unwrap()).collect();
        let to = folder.path().join("locks").join("p.lease-3");
        // Simulates hosts that do not see each other's locks of the operating system.
        let made = |store: &Store| store.lease(&to, store.temporary().display().to_string().as_bytes()).unwrap();
        let won: Vec<bool> = std::thread::scope(|scope| {
            let all: Vec<_> = stores.iter().map(|s| scope.spawn(|| made(s))).collect();
            all.into_iter().map(|t| t.join().unwrap()).collect()
        });
        assert_eq!(won.iter().filter(|w| **w).count(), 1, "{won:?}");
        assert!(!fs::read(&to).unwrap().is_empty());
    }

    #[test]
    fn unit_unreadable_lease_expires_with_age() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let path = foreign(folder.path(), 1, Duration::ZERO);
        fs::write(&path, "").unwrap();
        assert_eq!(held(store.lock("p").unwrap()).holder, None);
        File::options().write(true).open(&path).unwrap().set_modified(SystemTime::now() - 2 * GONE_AFTER).unwrap();
        mine(store.lock("p").unwrap());
    }
}
