//! Maintenance of a store in an object store.

use std::{
    collections::{BTreeSet, HashSet},
    fs,
    time::{Duration, SystemTime},
};

use buckets::{ObjectEntry, each};
use schemas::{Fault, keys::HashKey};

use super::{
    super::{
        Store, attempts, catalogue,
        scrub::{RecordChecks, SMALL, ScrubReport, is_whole},
        sealed::{StoreFileFault, verify},
        tend::{GcOptions, GcReport, packs_unknown},
    },
    RemoteStore,
    lease::is_lease_whole,
};

/// Results newer than this are kept, because workers on other machines may be about to reference them.
const YOUNG: Duration = Duration::from_secs(3600);

/// Whether an object is at least `than` old, at the server time `now`.
pub fn is_object_old(about: &ObjectEntry, than: Duration, now: SystemTime) -> bool {
    than.is_zero() || now.duration_since(about.modified).is_ok_and(|age| age >= than)
}

impl RemoteStore {
    /// Pipelines that have versions.
    fn pipelines(&self) -> Result<BTreeSet<String>, Fault> {
        let all = self.bucket.list("versions")?;
        Ok(all.iter().filter_map(|o| o.key.split('/').nth(1)).map(str::to_owned).collect())
    }

    /// Drops the versions that [`GcOptions`] does not keep, and packs that no version references. Also drops their
    /// copies in the cache.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error, or if the newest version's manifest is damaged.
    pub fn collect(&self, store: &Store, what: GcOptions) -> Result<GcReport, Fault> {
        let (alone, time) = (store.alone()?, self.time()?);
        let is_old = |about: &ObjectEntry, than: Duration| is_object_old(about, than, time);
        let tried = self.bucket.list(attempts::FOLDER)?;
        let busy = alone.is_none() || self.is_busy()? || tried.iter().any(|o| !is_old(o, YOUNG));
        let mut done = GcReport { busy, ..GcReport::default() };
        let mut live: HashSet<String> = HashSet::new();
        for name in self.pipelines()? {
            let now = self.newest(&name)?;
            let kept = if now.is_some() { what.keep.max(1) } else { 0 };
            let all = self.numbers(&name)?;
            let spare = all.len().saturating_sub(kept);
            for (i, number) in all.into_iter().enumerate() {
                let list = self.bucket.about(&format!("versions/{name}/{number}/version.json"))?;
                let old = list.is_none_or(|o| is_old(&o, what.older_than));
                // A version with a higher number than the newest is being written, or was never published.
                let unfinished = busy && now.is_none_or(|now| number > now);
                if i < spare && now != Some(number) && old && !unfinished {
                    done.versions.push(format!("{name}/{number}"));
                    if !what.dry {
                        self.drop_version(&name, number)?;
                    }
                } else {
                    match self.manifest(&name, number)? {
                        Some(manifest) => live.extend(manifest.packs),
                        None if now == Some(number) => {
                            let list = format!("{}/versions/{name}/{number}/version.json", self.bucket.address());
                            let remedy = format!("remove the object tables/{name}, and run the spec again");
                            return Err(packs_unknown(&list, &remedy));
                        }
                        // This version was never published.
                        None => {}
                    }
                }
            }
        }
        for file in self.bucket.list("damaged")?.iter().filter(|o| is_old(o, what.older_than)) {
            done.damaged += 1;
            if !what.dry {
                self.bucket.remove(&file.key)?;
            }
        }
        if busy {
            return Ok(done);
        }
        if !what.dry {
            store.drop_checkpoints(|_| false, Some(what.older_than));
            store.drop_attempts(|_| false, Some(what.older_than));
            store.drop_plans(what.older_than);
        }
        let id = |o: &ObjectEntry| o.key.rsplit('/').next()?.strip_suffix(".parquet").and_then(HashKey::parse);
        let packs = self.bucket.list("objects")?;
        let dead: Vec<&ObjectEntry> = packs
            .iter()
            .filter(|o| id(o).is_some_and(|id| !live.contains(&id.to_string())) && is_old(o, what.older_than))
            .collect();
        done.packs = dead.len();
        done.bytes = dead.iter().map(|o| o.size).sum();
        if what.dry {
            return Ok(done);
        }
        each(&dead, |o| self.bucket.remove(&o.key))?;
        for id in dead.iter().filter_map(|o| id(o)) {
            // A copy that cannot be removed only costs space.
            let _ = fs::remove_file(catalogue::path(&self.root, id));
            store.catalogue_mut().remove(id);
        }
        store.write_index()?;
        Ok(done)
    }

    /// Reads every byte of the store, not of the cache. Quarantines packs whose verification fails.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn scrub(
        &self,
        store: &Store,
        checks: RecordChecks,
        tick: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<ScrubReport, Fault> {
        let mut found = ScrubReport::default();
        for text in store.damaged() {
            let (path, why) = text.split_once(": ").unwrap_or((&text, ""));
            found.damaged.insert(path.into(), why.to_owned());
        }
        let named = |key: &str| format!("{}/{key}", self.bucket.address());
        self.scrub_small(checks, &mut found)?;
        let mut own = vec![];
        for name in self.pipelines()? {
            let newest = self.newest(&name)?;
            for number in self.numbers(&name)? {
                let published = newest == Some(number);
                match self.manifest(&name, number)? {
                    None => {
                        let key = format!("versions/{name}/{number}/version.json");
                        found.damaged.insert(named(&key).into(), "its checksum is wrong".to_owned());
                    }
                    Some(manifest) => {
                        let files = manifest.tables.into_iter().flat_map(|t| t.files.into_iter().chain(t.units));
                        let plain = files.filter(|f| f.pack.is_none());
                        own.extend(plain.map(|f| (format!("versions/{name}/{number}/{}", f.name), f.hash, published)));
                    }
                }
            }
        }
        // The sealed files are the packs and the tables in `quality`.
        let packs: Vec<HashKey> = store.catalogue().packs().map(|p| p.id).collect();
        let mut sealed: Vec<(String, Option<HashKey>)> =
            packs.into_iter().map(|id| (RemoteStore::pack_key(id), Some(id))).collect();
        sealed.extend(self.bucket.list("quality")?.into_iter().map(|o| (o.key, None)));
        let all = sealed.len() + own.len();
        for (i, (key, pack)) in sealed.into_iter().enumerate() {
            tick(i, all);
            let tmp = self.temporary()?;
            if !self.bucket.fetch(&key, &tmp, None)? {
                found.damaged.insert(named(&key).into(), "it does not exist".to_owned());
                if let Some(id) = pack {
                    store.catalogue_mut().remove(id);
                }
                continue;
            }
            found.files += 1;
            found.bytes += fs::metadata(&tmp).map_or(0, |m| m.len());
            match verify(&tmp) {
                Ok(()) | Err(StoreFileFault::Gone) => {}
                Err(StoreFileFault::Machine(why)) => {
                    return Err(Fault::machine(format!("cannot read {}: {why}", named(&key))));
                }
                Err(StoreFileFault::Damaged(why)) => {
                    if let Some(id) = pack {
                        store.set_aside(id, &why);
                    }
                    found.damaged.insert(named(&key).into(), why);
                }
            }
            let _ = fs::remove_file(&tmp);
        }
        let before = all - own.len();
        for (i, (key, hash, published)) in own.into_iter().enumerate() {
            tick(before + i, all);
            let wrong = match self.bucket.get(&key)? {
                None if published => Some("it does not exist"),
                // If a run was killed before it published, its manifest may list files that were not written.
                None => None,
                Some(bytes) => {
                    found.files += 1;
                    found.bytes += bytes.len() as u64;
                    (Some(HashKey::from_parts([&bytes]).to_string()) != hash).then_some("its content has changed")
                }
            };
            if let Some(why) = wrong {
                found.damaged.insert(named(&key).into(), why.to_owned());
            }
        }
        store.write_index()?;
        Ok(found)
    }

    /// Checks the index, and the small objects that can be verified without other objects.
    fn scrub_small(&self, checks: RecordChecks, found: &mut ScrubReport) -> Result<(), Fault> {
        let mut check = |key: &str, is_whole: &dyn Fn(&str, &[u8]) -> bool| -> Result<(), Fault> {
            let Some(bytes) = self.bucket.get(key)? else { return Ok(()) };
            found.files += 1;
            found.bytes += bytes.len() as u64;
            if !is_whole(key.rsplit('/').next().unwrap_or_default(), &bytes) {
                let name = format!("{}/{key}", self.bucket.address());
                found.damaged.insert(name.into(), "its checksum is wrong".to_owned());
            }
            Ok(())
        };
        check("index", &|_, bytes| catalogue::parse(bytes).is_some())?;
        for folder in SMALL {
            for object in self.bucket.list(folder)? {
                check(&object.key, &|name, bytes| is_whole(folder, name, bytes, checks))?;
            }
        }
        for lease in self.bucket.list_flat("locks")? {
            check(&lease.key, &|_, bytes| is_lease_whole(bytes))?;
        }
        Ok(())
    }
}
