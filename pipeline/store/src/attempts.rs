//! Records of the units whose computation has begun, including the units of lost workers.
//!
//! An attempt is one execution of some units by one worker, recorded in a file `attempts/<name>`. The file lists host
//! and time, then the keys of the units, one per line. The worker removes the file when all units have answers, and on
//! a stop signal. A file that remains thus shows that the worker was killed, by one of its units or by another cause.
//! If the worker survives and a unit has no answer, for example after a panic, the file keeps only this unit and the
//! reason. The files are not synced to the disk, because a power loss is not the fault of a unit.
//!
//! In an object store, an attempt has one object `attempts/<name>-<marks>` per 24 units. The marks are the first digits
//! of the keys. A worker thus finds the objects that may concern its units through one listing, and reads only these
//! objects.

use std::{
    collections::{HashMap, HashSet},
    fs,
    path::PathBuf,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use buckets::each;
use schemas::{Fault, keys::HashKey, paths};

use super::{
    Store, io_fault,
    remote::{RemoteStore, is_object_old},
    tend::is_old,
    unfinished::kernel,
};
use crate::clock;

/// Folder of the attempts in a store.
pub const FOLDER: &str = "attempts";
/// Number of leading digits of a key in a mark, number of digits of a unique name, and maximum number of units per
/// object. These numbers are limited because some servers store objects as files, whose names have at most 255 bytes.
const MARK: usize = 4;
const NAME: usize = 16;
const MOST: usize = 24;

/// Location of the record of an attempt.
#[derive(Clone)]
enum AttemptMarker {
    File(PathBuf),
    /// Name of an object.
    Object(Arc<RemoteStore>, String),
}

impl AttemptMarker {
    fn is(&self, other: &AttemptMarker) -> bool {
        match (self, other) {
            (AttemptMarker::File(a), AttemptMarker::File(b)) => a == b,
            (AttemptMarker::Object(_, a), AttemptMarker::Object(_, b)) => a == b,
            (AttemptMarker::File(_), AttemptMarker::Object(..))
            | (AttemptMarker::Object(..), AttemptMarker::File(_)) => false,
        }
    }

    fn remove(&self) {
        // If the record cannot be removed, the attempt counts as lost.
        match self {
            AttemptMarker::File(file) => drop(fs::remove_file(file)),
            AttemptMarker::Object(remote, key) => drop(remote.bucket().remove(key)),
        }
    }

    /// Replaces the text of the record.
    fn rewrite(&self, text: String, store: &Store) {
        // If the write fails, the worker counts as lost.
        match self {
            AttemptMarker::File(file) => {
                let new = store.temporary();
                drop(fs::write(&new, text).and_then(|()| fs::rename(&new, file)));
            }
            AttemptMarker::Object(remote, key) => drop(remote.bucket().put(key, text.into_bytes())),
        }
    }
}

/// Attempts of this process that are in progress.
static UNDER_WAY: Mutex<Vec<AttemptMarker>> = Mutex::new(vec![]);

fn under_way() -> MutexGuard<'static, Vec<AttemptMarker>> {
    UNDER_WAY.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes the running attempts of this process after a stop signal, because no unit has caused the signal.
pub fn withdraw() {
    let all = std::mem::take(&mut *under_way());
    all.iter().for_each(AttemptMarker::remove);
}

/// Prefix of the reason for a missing answer.
const WHY: &str = "failed: ";

/// Attempt to compute some units.
#[must_use]
pub struct Attempt {
    /// Records of the attempt, each with its units.
    markers: Vec<(AttemptMarker, Vec<HashKey>)>,
    who: String,
}

impl Attempt {
    /// Ends the attempt when the units have answers or the worker stops. Units in `failed` keep their record.
    pub fn end(self, store: &Store, failed: &HashMap<HashKey, &Fault>) {
        for (marker, keys) in &self.markers {
            under_way().retain(|other| !other.is(marker));
            let left = keys.iter().filter_map(|key| {
                let why = failed.get(key)?.to_string().replace('\n', " ");
                Some(format!("{key} {WHY}{why}\n"))
            });
            let left: String = left.collect();
            if left.is_empty() {
                marker.remove();
            } else {
                marker.rewrite(format!("{}{left}", self.who), store);
            }
        }
    }
}

/// Numbers of attempts that have given no answer for a unit, with a reason.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct UnitAttempts {
    /// Attempts whose worker was lost or is still running.
    pub lost: usize,
    /// Attempts whose worker survived.
    pub failed: usize,
    /// Reason of one of the failed attempts.
    pub why: Option<String>,
}

impl UnitAttempts {
    /// Counts one attempt, given the text recorded for the unit.
    fn add(&mut self, message: &str) {
        match message.strip_prefix(WHY) {
            Some(why) => {
                self.failed += 1;
                self.why = Some(why.to_owned());
            }
            None => self.lost += 1,
        }
    }

    /// Number of all attempts.
    pub fn all(&self) -> usize {
        self.lost + self.failed
    }
}

/// Units in the text of an attempt, each with its recorded reason.
fn units(text: &str) -> impl Iterator<Item = (HashKey, &str)> {
    text.lines().skip(1).filter_map(unit)
}

/// Unit of a line with its recorded reason; `None` for a truncated line.
fn unit(line: &str) -> Option<(HashKey, &str)> {
    let (key, message) = line.split_once(' ').unwrap_or((line, ""));
    Some((HashKey::parse(key)?, message))
}

/// Attempts by unit, counted in the texts of the records.
fn counted(texts: &[String]) -> HashMap<HashKey, UnitAttempts> {
    let mut found: HashMap<HashKey, UnitAttempts> = HashMap::new();
    for (key, message) in texts.iter().flat_map(|text| units(text)) {
        found.entry(key).or_default().add(message);
    }
    found
}

fn mark(key: HashKey) -> String {
    key.to_string().chars().take(MARK).collect()
}

/// Whether the object `name` may concern a unit with one of these marks.
fn may_be_of(name: &str, marks: &HashSet<String>) -> bool {
    let own = name.rsplit_once('-').map_or("", |(_, own)| own);
    own.as_bytes().chunks(MARK).any(|one| std::str::from_utf8(one).is_ok_and(|one| marks.contains(one)))
}

/// Texts of the attempts in an object store for whose names `wanted` is true.
fn in_objects(remote: &RemoteStore, wanted: impl Fn(&str) -> bool) -> Vec<String> {
    // Readable attempts are counted; unreadable ones are read again when the next units begin.
    let all = remote.bucket().list(FOLDER).unwrap_or_default();
    let names: Vec<String> = all.into_iter().map(|object| object.key).filter(|name| wanted(name)).collect();
    let found = each(&names, |name| Ok(remote.bucket().get(name).ok().flatten())).unwrap_or_default();
    found.into_iter().flatten().map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).collect()
}

/// Text of an attempt without the units that are `done`; empty if the attempt is `old`.
fn left_of(text: &str, old: bool, done: &dyn Fn(HashKey) -> bool) -> String {
    let is_left = |line: &&str| unit(line).is_some_and(|(key, _)| !old && !done(key));
    let left: Vec<&str> = text.lines().skip(1).filter(is_left).collect();
    match (text.lines().next(), left.is_empty()) {
        (Some(who), false) => format!("{who}\n{}\n", left.join("\n")),
        (Some(_) | None, _) => String::new(),
    }
}

impl Store {
    /// Texts of all attempts in the folder, with the paths of the files.
    fn attempts_in_folder(&self) -> impl Iterator<Item = (PathBuf, String)> {
        let files = fs::read_dir(self.root().join(FOLDER)).into_iter().flatten().flatten();
        // An attempt that ends in the meantime is skipped.
        files.filter_map(|file| Some((file.path(), String::from_utf8(paths::read_regular(&file.path()).ok()?).ok()?)))
    }

    /// Attempts at some units, in the order of `keys`.
    pub fn attempts_at(&self, keys: &[HashKey]) -> Vec<UnitAttempts> {
        let all = match self.remote() {
            Some(remote) => {
                let marks: HashSet<String> = keys.iter().map(|key| mark(*key)).collect();
                counted(&in_objects(remote, |name| may_be_of(name, &marks)))
            }
            None => self.attempts(),
        };
        keys.iter().map(|key| all.get(key).cloned().unwrap_or_default()).collect()
    }

    /// Attempts at all units with at least one attempt.
    pub fn attempts(&self) -> HashMap<HashKey, UnitAttempts> {
        match self.remote() {
            Some(remote) => counted(&in_objects(remote, |_| true)),
            None => counted(&self.attempts_in_folder().map(|(_, text)| text).collect::<Vec<_>>()),
        }
    }

    /// Begins an attempt at some units.
    ///
    /// # Errors
    /// Fails if the file system reports an error.
    pub fn attempt(&self, keys: &[HashKey]) -> Result<Attempt, Fault> {
        // The text differs between processes and between threads.
        let (kernel, process, unique) = (kernel(), std::process::id(), uuid::Uuid::new_v4());
        let who = format!("{kernel} process {process} {} {unique}\n", clock::now());
        let mut attempt = Attempt { markers: vec![], who };
        let lines = |keys: &[HashKey]| -> String { keys.iter().map(|key| format!("{key}\n")).collect() };
        if let Some(remote) = self.remote() {
            let own: String = unique.simple().to_string().chars().take(NAME).collect();
            for (i, some) in keys.chunks(MOST).enumerate() {
                let marks: String = some.iter().map(|key| mark(*key)).collect();
                let name = format!("{FOLDER}/{own}{i:03}-{marks}");
                let marker = AttemptMarker::Object(remote.clone(), name.clone());
                under_way().push(marker.clone());
                attempt.markers.push((marker, some.to_vec()));
                if let Err(fault) = remote.bucket().put(&name, format!("{}{}", attempt.who, lines(some)).into_bytes()) {
                    attempt.end(self, &HashMap::new());
                    return Err(fault);
                }
            }
            return Ok(attempt);
        }
        let folder = self.root().join(FOLDER);
        let file = folder.join(unique.simple().to_string());
        let marker = AttemptMarker::File(file.clone());
        under_way().push(marker.clone());
        attempt.markers.push((marker, keys.to_vec()));
        let new = self.temporary();
        match fs::write(&new, format!("{}{}", attempt.who, lines(keys))).and_then(|()| fs::rename(&new, &file)) {
            Ok(()) => Ok(attempt),
            Err(e) => {
                attempt.end(self, &HashMap::new());
                Err(io_fault("write", &file, &e))
            }
        }
    }

    /// Removes the attempts at units that are `done`, and attempts that are at least as old as `older_than`.
    pub fn drop_attempts(&self, done: impl Fn(HashKey) -> bool, older_than: Option<Duration>) {
        if let Some(remote) = self.remote() {
            // Objects that cannot be removed now are removed later.
            let _ = drop_objects(remote, &done, older_than);
            return;
        }
        for (file, text) in self.attempts_in_folder() {
            let old = older_than.is_some_and(|than| is_old(&file, than));
            let left = left_of(&text, old, &done);
            let marker = AttemptMarker::File(file);
            if left.is_empty() {
                marker.remove();
            } else if left != text {
                marker.rewrite(left, self);
            }
        }
    }
}

/// Same as [`Store::drop_attempts`], in an object store.
fn drop_objects(
    remote: &RemoteStore,
    done: &dyn Fn(HashKey) -> bool,
    older_than: Option<Duration>,
) -> Result<(), Fault> {
    let all = remote.bucket().list(FOLDER)?;
    if all.is_empty() {
        return Ok(());
    }
    let now = older_than.map(|_| remote.time()).transpose()?;
    let read = each(&all, |object| remote.bucket().get_tagged(&object.key))?;
    for (object, (bytes, tag)) in all.iter().zip(read).filter_map(|(object, read)| Some((object, read?))) {
        let text = String::from_utf8_lossy(&bytes);
        let old = older_than.zip(now).is_some_and(|(than, now)| is_object_old(object, than, now));
        let left = left_of(&text, old, done);
        if left.is_empty() {
            remote.bucket().remove(&object.key)?;
        } else if left != text {
            // If the worker has written a newer text, that text is kept.
            remote.bucket().replace(&object.key, left.as_bytes(), Some(tag))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_attempts_count_until_they_end() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let (one, two) = (HashKey::from_parts(["one"]), HashKey::from_parts(["two"]));
        let count = |key| store.attempts_at(&[key])[0].all();
        let none = HashMap::new();
        assert_eq!((count(one), store.attempts().len()), (0, 0));
        let (first, second) = (store.attempt(&[one]).unwrap(), store.attempt(&[one, two]).unwrap());
        assert_eq!((count(one), count(two)), (2, 1));
        first.end(&store, &none);
        let lost = UnitAttempts { lost: 1, ..UnitAttempts::default() };
        assert_eq!(store.attempts(), HashMap::from([(one, lost.clone()), (two, lost.clone())]));
        // One of two units fails, and the worker survives.
        second.end(&store, &HashMap::from([(one, &Fault::bug("a\npanic"))]));
        let tries = store.attempts_at(&[two, one]);
        assert_eq!((tries[0].all(), tries[1].lost, tries[1].failed), (0, 0, 1));
        assert!(tries[1].why.as_ref().unwrap().starts_with("a panic: an error"), "{:?}", tries[1].why);
        // The worker of this attempt was lost, and another worker has computed one of its units.
        std::mem::forget(store.attempt(&[one, two]).unwrap());
        assert_eq!((count(one), count(two)), (2, 1));
        store.drop_attempts(|key| key == one, None);
        assert_eq!(store.attempts(), HashMap::from([(two, lost)]));
        withdraw();
        assert_eq!(store.attempts().len(), 0);
        std::mem::forget(store.attempt(&[two]).unwrap());
        store.drop_attempts(|_| false, Some(Duration::ZERO));
        assert_eq!(fs::read_dir(store.root().join(FOLDER)).unwrap().count(), 0);
    }

    #[test]
    fn unit_truncated_attempt_text_lists_no_foreign_unit() {
        let (one, two) = (HashKey::from_parts(["one"]), HashKey::from_parts(["two"]));
        let text = format!("here process 1\n{one}\n{two} failed: a panic\n");
        for end in 0..text.len() {
            let found: Vec<HashKey> = units(&text[..end]).map(|(key, _)| key).collect();
            assert!([one, two].starts_with(&found), "{end}: {found:?}");
        }
        assert_eq!(units(&text).collect::<Vec<_>>(), [(one, ""), (two, "failed: a panic")]);
    }
}
