//! The workers that are computing a unit, or were lost while they did.
//!
//! Each is a file `attempts/<key>/<n>` that is created exclusively, and says where and when. It is removed when the unit has
//! its answer, and when the worker is told to stop; so what is left over is of workers that were killed, by the unit or by
//! others. Where the worker lives and the unit has no answer all the same, as after a panic, the file stays and says why.
//! The files are not synced to the disk: a loss of power is not the fault of a unit.

use std::{
    collections::HashMap,
    fs::{self, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use schemas::Fault;

use super::{Store, tend::is_old, trouble, unfinished::kernel};
use crate::{clock, keys::Key};

/// The folder of a store that holds them.
pub const FOLDER: &str = "attempts";

/// The files of this process.
static UNDER_WAY: Mutex<Vec<PathBuf>> = Mutex::new(vec![]);

fn under_way() -> MutexGuard<'static, Vec<PathBuf>> {
    UNDER_WAY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Takes back the attempts that this process has begun: it was told to stop, which is not the fault of a unit.
pub fn withdraw() {
    for file in std::mem::take(&mut *under_way()) {
        remove(&file);
    }
}

fn remove(file: &Path) {
    // What cannot be removed counts as an attempt that was lost, which costs one of those that the unit has.
    let _ = fs::remove_file(file);
    let _ = file.parent().map(fs::remove_dir);
}

/// The beginning of the line of a file that says why the unit has no answer.
const WHY: &str = "failed: ";

/// An attempt to compute a unit.
#[must_use]
pub struct Attempt(PathBuf);

impl Attempt {
    /// The unit has its answer, or the worker stops.
    pub fn end(self) {
        self.leave();
        remove(&self.0);
    }

    /// The worker lives, and the unit has no answer.
    pub fn fail(self, why: &Fault) {
        self.leave();
        let line = format!("{WHY}{}\n", why.to_string().replace('\n', " "));
        // Without it the worker counts as lost.
        let _ = OpenOptions::new().append(true).open(&self.0).and_then(|mut file| file.write_all(line.as_bytes()));
    }

    fn leave(&self) {
        under_way().retain(|file| *file != self.0);
    }
}

/// The attempts at a unit that ended without an answer, or are under way.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tries {
    /// Workers that were lost, or are at work.
    pub lost: usize,
    /// Workers that lived.
    pub failed: usize,
    /// What one of those said.
    pub why: Option<String>,
}

impl Tries {
    fn of(folder: &Path) -> Tries {
        let mut found = Tries::default();
        for n in numbers(folder) {
            let text = fs::read_to_string(folder.join(n.to_string())).unwrap_or_default();
            match text.lines().find_map(|line| line.strip_prefix(WHY)) {
                Some(why) => {
                    found.failed += 1;
                    found.why = Some(why.to_owned());
                }
                None => found.lost += 1,
            }
        }
        found
    }

    /// All of them.
    pub fn all(&self) -> usize {
        self.lost + self.failed
    }
}

fn numbers(folder: &Path) -> Vec<u64> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter_map(|e| e.file_name().to_str()?.parse().ok()).collect()
}

impl Store {
    fn attempts_at(&self, key: Key) -> PathBuf {
        self.root().join(FOLDER).join(key.to_string())
    }

    /// The attempts at the unit `key`.
    pub fn attempts_of(&self, key: Key) -> Tries {
        Tries::of(&self.attempts_at(key))
    }

    /// The attempts at all units that have any.
    pub fn attempts(&self) -> HashMap<Key, Tries> {
        let folders = fs::read_dir(self.root().join(FOLDER)).into_iter().flatten().flatten();
        let one = |e: fs::DirEntry| Some((Key::parse(e.file_name().to_str()?)?, Tries::of(&e.path())));
        folders.filter_map(one).filter(|(_, tries)| tries.all() > 0).collect()
    }

    /// Begins an attempt at the unit `key`.
    ///
    /// # Errors
    /// Fails when the file system refuses.
    pub fn attempt(&self, key: Key) -> Result<Attempt, Fault> {
        const TRIALS: u64 = 1000;
        let folder = self.attempts_at(key);
        let fail = |e: io::Error| trouble("write", &folder, &e);
        let first = numbers(&folder).into_iter().max().unwrap_or(0) + 1;
        for n in first..first + TRIALS {
            fs::create_dir_all(&folder).map_err(fail)?;
            let file = folder.join(n.to_string());
            match OpenOptions::new().write(true).create_new(true).open(&file) {
                Ok(mut opened) => {
                    under_way().push(file.clone());
                    let who = format!("{} process {} {}\n", kernel(), std::process::id(), clock::now());
                    opened.write_all(who.as_bytes()).map_err(fail)?;
                    return Ok(Attempt(file));
                }
                // Another worker began one, or ended the last one and removed the folder.
                Err(e) if matches!(e.kind(), io::ErrorKind::AlreadyExists | io::ErrorKind::NotFound) => {}
                Err(e) => return Err(fail(e)),
            }
        }
        Err(Fault::machine(format!("cannot find a free name in {}", folder.display())))
    }

    /// Removes the attempts at units that are `done`, and those as old as `older_than`.
    pub fn drop_attempts(&self, done: impl Fn(Key) -> bool, older_than: Option<Duration>) {
        for folder in fs::read_dir(self.root().join(FOLDER)).into_iter().flatten().flatten() {
            let old = || older_than.is_some_and(|than| is_old(&folder.path(), than));
            if folder.file_name().to_str().and_then(Key::parse).is_some_and(&done) || old() {
                // What stays is removed another time.
                let _ = fs::remove_dir_all(folder.path());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_attempts_count_until_they_end() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let (one, two) = (Key::of(["one"]), Key::of(["two"]));
        let count = |key| store.attempts_of(key).all();
        assert_eq!((count(one), store.attempts().len()), (0, 0));
        let (first, second) = (store.attempt(one).unwrap(), store.attempt(one).unwrap());
        assert_ne!(first.0, second.0, "each has a file of its own");
        assert_eq!((count(one), count(two)), (2, 0));
        first.end();
        assert_eq!(store.attempts(), HashMap::from([(one, Tries { lost: 1, ..Tries::default() })]));
        // The number of one that ended may be taken again, that of one at work may not.
        let third = store.attempt(one).unwrap();
        assert_eq!((count(one), third.0.file_name().unwrap().to_str()), (2, Some("3")));
        third.fail(&Fault::bug("a\npanic"));
        let tries = store.attempts_of(one);
        assert_eq!((tries.lost, tries.failed), (1, 1));
        assert!(tries.why.unwrap().starts_with("a panic: an error"));
        second.end();
        store.drop_attempts(|key| key == one, None);
        assert!(!store.attempts_at(one).exists());
        withdraw();
        std::mem::forget(store.attempt(two).unwrap());
        assert_eq!(count(two), 1);
        withdraw();
        assert_eq!(store.attempts().len(), 0);
    }
}
