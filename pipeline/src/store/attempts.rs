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
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use schemas::Fault;

use super::{Store, remote::Remote, tend::is_old, trouble, unfinished::kernel};
use crate::{clock, keys::Key};

/// The folder of a store that holds them.
pub const FOLDER: &str = "attempts";

/// Where an attempt is written down.
#[derive(Clone)]
enum Marker {
    File(PathBuf),
    /// The name of an object.
    Object(Arc<Remote>, String),
}

impl Marker {
    fn is(&self, other: &Marker) -> bool {
        match (self, other) {
            (Marker::File(a), Marker::File(b)) => a == b,
            (Marker::Object(_, a), Marker::Object(_, b)) => a == b,
            (Marker::File(_), Marker::Object(..)) | (Marker::Object(..), Marker::File(_)) => false,
        }
    }

    fn remove(&self) {
        // What cannot be removed counts as an attempt that was lost, which costs one of those that the unit has.
        match self {
            Marker::File(file) => {
                let _ = fs::remove_file(file);
                let _ = file.parent().map(fs::remove_dir);
            }
            Marker::Object(remote, key) => drop(remote.bucket().remove(key)),
        }
    }

    /// Adds a line, after what it says already.
    fn add(&self, before: &str, line: &str) {
        // Without it the worker counts as lost.
        match self {
            Marker::File(file) => {
                drop(OpenOptions::new().append(true).open(file).and_then(|mut file| file.write_all(line.as_bytes())));
            }
            Marker::Object(remote, key) => drop(remote.bucket().put(key, format!("{before}{line}").into_bytes())),
        }
    }
}

/// Those of this process.
static UNDER_WAY: Mutex<Vec<Marker>> = Mutex::new(vec![]);

fn under_way() -> MutexGuard<'static, Vec<Marker>> {
    UNDER_WAY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Takes back the attempts that this process has begun: it was told to stop, which is not the fault of a unit.
pub fn withdraw() {
    let all = std::mem::take(&mut *under_way());
    all.iter().for_each(Marker::remove);
}

/// The beginning of the line of a file that says why the unit has no answer.
const WHY: &str = "failed: ";

/// An attempt to compute a unit.
#[must_use]
pub struct Attempt {
    marker: Marker,
    who: String,
}

impl Attempt {
    /// The unit has its answer, or the worker stops.
    pub fn end(self) {
        self.leave();
        self.marker.remove();
    }

    /// The worker lives, and the unit has no answer.
    pub fn fail(self, why: &Fault) {
        self.leave();
        let line = format!("{WHY}{}\n", why.to_string().replace('\n', " "));
        self.marker.add(&self.who, &line);
    }

    fn leave(&self) {
        under_way().retain(|marker| !marker.is(&self.marker));
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
        let text = |n: u64| fs::read_to_string(folder.join(n.to_string())).unwrap_or_default();
        Tries::of_texts(numbers(folder).into_iter().map(text))
    }

    fn of_texts(texts: impl Iterator<Item = String>) -> Tries {
        let mut found = Tries::default();
        for text in texts {
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

/// What an attempt in an object store says.
fn said(remote: &Remote, name: &str) -> String {
    let bytes = remote.bucket().get(name).ok().flatten().unwrap_or_default();
    String::from_utf8_lossy(&bytes).into_owned()
}

impl Store {
    fn attempts_at(&self, key: Key) -> PathBuf {
        self.root().join(FOLDER).join(key.to_string())
    }

    /// The attempts at the unit `key`.
    pub fn attempts_of(&self, key: Key) -> Tries {
        if let Some(remote) = self.remote() {
            let found = remote.attempts_at(key).unwrap_or_default();
            return Tries::of_texts(found.iter().map(|(_, name)| said(remote, name)));
        }
        Tries::of(&self.attempts_at(key))
    }

    /// The attempts at all units that have any.
    pub fn attempts(&self) -> HashMap<Key, Tries> {
        if let Some(remote) = self.remote() {
            let all = remote.bucket().list(FOLDER).unwrap_or_default();
            let mut texts: HashMap<Key, Vec<String>> = HashMap::new();
            for object in all {
                if let Some(key) = object.key.split('/').nth(1).and_then(Key::parse) {
                    texts.entry(key).or_default().push(said(remote, &object.key));
                }
            }
            return texts.into_iter().map(|(key, texts)| (key, Tries::of_texts(texts.into_iter()))).collect();
        }
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
        let who = format!("{} process {} {}\n", kernel(), std::process::id(), clock::now());
        if let Some(remote) = self.remote() {
            // Each process and thread creates another text.
            let who = format!("{} {}\n", who.trim_end(), uuid::Uuid::new_v4());
            let first = remote.attempts_at(key)?.into_iter().map(|(n, _)| n).max().unwrap_or(0) + 1;
            for n in first..first + TRIALS {
                let name = format!("{FOLDER}/{key}/{n}");
                if remote.bucket().create(&name, who.as_bytes())? {
                    let marker = Marker::Object(remote.clone(), name);
                    under_way().push(marker.clone());
                    return Ok(Attempt { marker, who });
                }
            }
            return Err(Fault::machine(format!("cannot find a free name for an attempt at {key}")));
        }
        let folder = self.attempts_at(key);
        let fail = |e: io::Error| trouble("write", &folder, &e);
        let first = numbers(&folder).into_iter().max().unwrap_or(0) + 1;
        for n in first..first + TRIALS {
            fs::create_dir_all(&folder).map_err(fail)?;
            let file = folder.join(n.to_string());
            match OpenOptions::new().write(true).create_new(true).open(&file) {
                Ok(mut opened) => {
                    let marker = Marker::File(file);
                    under_way().push(marker.clone());
                    opened.write_all(who.as_bytes()).map_err(fail)?;
                    return Ok(Attempt { marker, who });
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
        if let Some(remote) = self.remote() {
            let gone = |name: &str, age: Duration| {
                Key::parse(name).is_some_and(&done) || older_than.is_some_and(|than| age >= than)
            };
            // What stays is removed another time.
            let _ = remote.drop_objects(FOLDER, &gone);
            return;
        }
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
        assert!(!first.marker.is(&second.marker), "each has a file of its own");
        assert_eq!((count(one), count(two)), (2, 0));
        first.end();
        assert_eq!(store.attempts(), HashMap::from([(one, Tries { lost: 1, ..Tries::default() })]));
        // The number of one that ended may be taken again, that of one at work may not.
        let third = store.attempt(one).unwrap();
        let Marker::File(file) = &third.marker else { unreachable!("a store in a folder") };
        assert_eq!((count(one), file.file_name().unwrap().to_str()), (2, Some("3")));
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
