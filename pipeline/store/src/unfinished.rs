//! Folders for temporary files, one per process.
//!
//! The name of a folder consists of its kernel (host and boot), its process and a number. The folder contains a lock
//! that the process keeps. All processes of one kernel see the locks on any file system; hosts that share a folder
//! often do not see each other's locks. A free lock thus shows that a process of this kernel has ended, and gives no
//! information about other kernels.

use std::{
    fs::{self, File, TryLockError},
    io,
    path::{Path, PathBuf},
    sync::{
        OnceLock,
        atomic::{AtomicU32, Ordering},
    },
    time::Duration,
};

use super::{
    lock::{boot, host},
    tend::{folders_of, is_old},
};

/// Age at which the folder of another kernel is assumed to be abandoned.
const ABANDONED: Duration = Duration::from_secs(30 * 86_400);
/// Maximum number of characters of a host's name.
const LONGEST: usize = 40;

/// Kernel of this process: the host's name, and a part of the identifier of its boot if available.
pub fn kernel() -> &'static str {
    static KERNEL: OnceLock<String> = OnceLock::new();
    KERNEL.get_or_init(|| {
        let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
        let part = |text: String, most: usize| text.chars().take(most).map(plain).collect::<String>();
        [part(host(), LONGEST), part(boot(), 8)].join("-")
    })
}

/// Takes a lock that this process keeps; ignores a file system without locks.
///
/// # Errors
/// Fails if the file system reports an error.
pub fn keep_lock(lock: &File, shared: bool) -> io::Result<()> {
    match if shared { lock.lock_shared() } else { lock.lock() } {
        Err(e) if e.kind() == io::ErrorKind::Unsupported => Ok(()),
        done => done,
    }
}

/// Creates a folder for the temporary files of this process, with a lock.
///
/// # Errors
/// Fails if the file system reports an error.
pub fn own_folder(tmp: &Path) -> io::Result<(PathBuf, File)> {
    // No name is used twice, because a process that removes the previous folder would also remove a new folder of the
    // same name.
    static NEXT: AtomicU32 = AtomicU32::new(0);
    for _ in 0..1000 {
        let n = NEXT.fetch_add(1, Ordering::Relaxed);
        let folder = tmp.join(format!("{}-{}-{n}", kernel(), std::process::id()));
        match fs::create_dir(&folder) {
            Ok(()) => {
                // Another process may remove the folder until the lock is held; then the next name is tried.
                let Ok(lock) = File::create(folder.join("lock")) else { continue };
                keep_lock(&lock, false)?;
                if folder.join("lock").exists() {
                    return Ok((folder, lock));
                }
            }
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(e),
        }
    }
    Err(io::Error::other("no unused folder name"))
}

/// Removes the folders of killed processes of this kernel, whose locks are free, and abandoned folders of other
/// kernels.
pub fn sweep(tmp: &Path) {
    for folder in folders_of(tmp) {
        let path = folder.path();
        let own = folder.file_name().to_str().is_some_and(|name| is_of(name, kernel()));
        let lock = File::open(path.join("lock"));
        let ended = match lock.as_ref().map(File::try_lock) {
            Ok(Ok(())) => own,
            Ok(Err(TryLockError::WouldBlock)) => continue,
            Ok(Err(TryLockError::Error(_))) => false,
            // The process was killed before it created the lock; the folder is removed only if empty.
            Err(_) if own => {
                let _ = fs::remove_dir(&path);
                continue;
            }
            Err(_) => false,
        };
        if ended || is_old(&path, ABANDONED) {
            remove(&path);
        }
        // The lock is held until here: a process that has just created this folder must not obtain the lock before the
        // folder is removed.
        drop(lock);
    }
}

/// Removes a folder of temporary files, the lock last. The owner of a partly removed folder is thus still known.
pub fn remove(folder: &Path) {
    let lock = folder.join("lock");
    for file in
        fs::read_dir(folder).into_iter().flatten().flatten().map(|file| file.path()).filter(|path| *path != lock)
    {
        let _ = if file.is_dir() { fs::remove_dir_all(&file) } else { fs::remove_file(&file) };
    }
    let _ = fs::remove_file(&lock);
    let _ = fs::remove_dir(folder);
}

/// Whether a folder belongs to a process of `kernel`.
fn is_of(name: &str, kernel: &str) -> bool {
    let rest = name.strip_prefix(kernel).and_then(|rest| rest.strip_prefix('-'));
    let is_number = |text: &str| !text.is_empty() && text.chars().all(|c| c.is_ascii_digit());
    rest.and_then(|rest| rest.split_once('-')).is_some_and(|(process, n)| is_number(process) && is_number(n))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::{sync::atomic::AtomicBool, thread, time::SystemTime};

    use super::*;

    #[test]
    fn unit_folder_in_use_is_never_removed() {
        let tmp = tempfile::tempdir().unwrap();
        let ended = AtomicBool::new(false);
        thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| {
                    while !ended.load(Ordering::Relaxed) {
                        sweep(tmp.path());
                    }
                });
            }
            for _ in 0..400 {
                let (folder, lock) = own_folder(tmp.path()).unwrap();
                thread::yield_now();
                let kept = fs::write(folder.join("0"), "half a file").is_ok();
                if !kept {
                    ended.store(true, Ordering::Relaxed);
                }
                assert!(kept, "it was swept away");
                drop(lock);
                remove(&folder);
            }
            ended.store(true, Ordering::Relaxed);
        });
    }

    #[test]
    fn unit_sweep_removes_only_folders_of_ended_processes_and_abandoned_ones() {
        let tmp = tempfile::tempdir().unwrap();
        let (alive, _lock) = own_folder(tmp.path()).unwrap();
        assert!(is_of(alive.file_name().unwrap().to_str().unwrap(), kernel()));
        let folder = |name: &str| {
            let folder = tmp.path().join(name);
            fs::create_dir(&folder).unwrap();
            fs::write(folder.join("lock"), "").unwrap();
            fs::write(folder.join("0"), "half a file").unwrap();
            folder
        };
        let killed = folder(&format!("{}-4000000-0", kernel()));
        let (remote, older) = (folder("node7-0123abcd-4711-0"), folder("4711-0"));
        sweep(tmp.path());
        assert!(alive.exists() && !killed.exists(), "of this kernel the lock decides");
        assert!(remote.join("0").exists() && older.exists(), "a free lock says nothing of another kernel");
        let long_ago = SystemTime::now() - ABANDONED - Duration::from_secs(60);
        File::open(&remote).unwrap().set_modified(long_ago).unwrap();
        sweep(tmp.path());
        assert!(alive.exists() && !remote.exists() && older.exists());
    }
}
