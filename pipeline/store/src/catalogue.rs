//! Catalogue of the packs of a store and their units.
//!
//! The footer of a pack lists its contents; the file `index` only avoids reading all footers again. The whole index is
//! verified, and each entry is compared with the size and time of its pack. An entry that differs is read from its pack
//! instead.

use std::{
    collections::{HashMap, HashSet},
    fs,
    path::{Path, PathBuf},
    time::UNIX_EPOCH,
};

use buckets::each;
use schemas::{Fault, keys::HashKey, paths};

use super::{
    remote::RemoteStore,
    sealed::{SealedFile, StoreFileFault, verify},
};

/// First bytes of the index.
const MARK: &[u8; 16] = b"magline index 2\n";

/// Metadata key of the list of units in a pack's footer: the kind of the pack, then one line per unit with key, hash
/// and number of rows.
pub const UNITS: &str = "magline.units";

/// Row count of a unit that could not be computed.
pub const FAILED: u32 = u32::MAX;

/// A unit in a pack.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PackedUnit {
    /// Key of the result.
    pub key: HashKey,
    /// Hash of the unit's other columns in the pack: axis values, identifiers, passed-through columns.
    pub passthrough_hash: u64,
    /// Number of rows, or [`FAILED`].
    pub rows: u32,
}

/// Pack: file of the store with the rows of some units, one after another.
#[derive(Clone, Debug, PartialEq)]
pub struct StorePack {
    /// Name of the pack.
    pub id: HashKey,
    /// Size, in bytes.
    pub size: u64,
    /// Time of writing, ns since 1970. Packs are immutable.
    pub modified_ns: u64,
    /// Hash of the columns of the pack.
    pub kind: HashKey,
    /// Units, in the order of their rows.
    pub units: Vec<PackedUnit>,
}

/// Location of the rows of a unit.
#[derive(Clone, Copy, Debug)]
pub struct RowLocation {
    /// Position of the pack in the catalogue.
    pub pack: usize,
    /// Position of the unit in the pack.
    pub unit: usize,
    /// First row of the unit in the pack.
    pub first: usize,
    /// Number of rows; `None` if the unit could not be computed.
    pub rows: Option<usize>,
}

/// Catalogue of all packs of a store.
#[derive(Default)]
pub struct PackCatalogue {
    packs: Vec<Option<StorePack>>,
    by_id: HashMap<HashKey, usize>,
    units: HashMap<HashKey, RowLocation>,
    /// Whether the catalogue differs from the index on the disk.
    changed: bool,
}

/// Path of the pack `id` below the store's folder.
pub fn path(root: &Path, id: HashKey) -> PathBuf {
    let name = id.to_string();
    root.join("objects").join(&name[..2]).join(format!("{name}.parquet"))
}

/// Size in bytes and modification time in ns since 1970, as in the catalogue.
pub fn stamp(about: &fs::Metadata) -> (u64, u64) {
    let since = about.modified().ok().and_then(|t| t.duration_since(UNIX_EPOCH).ok());
    (about.len(), since.and_then(|d| u64::try_from(d.as_nanos()).ok()).unwrap_or(0))
}

impl PackCatalogue {
    /// Opens the packs in the store at `root`. Also returns the damaged packs.
    ///
    /// # Errors
    /// Fails if the folder cannot be read.
    pub fn open(root: &Path) -> std::io::Result<(PackCatalogue, Vec<(HashKey, String)>)> {
        let mut known: HashMap<HashKey, StorePack> =
            load(root).unwrap_or_default().into_iter().map(|p| (p.id, p)).collect();
        let indexed = known.len();
        let (mut all, mut damaged, mut fresh) = (PackCatalogue::default(), vec![], 0);
        let mut found = vec![];
        for folder in fs::read_dir(root.join("objects")).into_iter().flatten() {
            let folder = folder?;
            if folder.file_type()?.is_dir() {
                for file in fs::read_dir(folder.path())? {
                    let file = file?;
                    let name = file.file_name();
                    let id = name.to_str().and_then(|n| n.strip_suffix(".parquet")).and_then(HashKey::parse);
                    let own = |id: &HashKey| file.path() == path(root, *id);
                    // A link may lead out of the store, and reading a pipe may block forever.
                    if let Some(id) = id.filter(own).filter(|_| file.file_type().is_ok_and(|kind| kind.is_file())) {
                        found.push((id, stamp(&file.metadata()?)));
                    }
                }
            }
        }
        found.sort_unstable();
        for (id, (size, modified_ns)) in found {
            match known.remove(&id).filter(|p| (p.size, p.modified_ns) == (size, modified_ns)) {
                Some(pack) => all.insert(pack),
                None => {
                    // A pack that was added or modified after the index was written is verified completely.
                    fresh += 1;
                    match read(root, id, (size, modified_ns)) {
                        Ok(pack) => all.insert(pack),
                        Err(StoreFileFault::Damaged(why)) => damaged.push((id, why)),
                        Err(StoreFileFault::Machine(why)) => return Err(std::io::Error::other(why)),
                        Err(StoreFileFault::Gone) => {}
                    }
                }
            }
        }
        all.changed = fresh > 0 || !known.is_empty() || (indexed == 0 && !all.packs.is_empty());
        Ok((all, damaged))
    }

    /// Opens the packs of an object store with the cache `root`. Also returns the damaged packs. Reads the footers of
    /// packs that are missing from all indexes.
    ///
    /// # Errors
    /// Fails if the server cannot be reached or reports an error.
    pub fn of_remote(root: &Path, remote: &RemoteStore) -> Result<(PackCatalogue, Vec<(HashKey, String)>), Fault> {
        let by_id =
            |packs: Vec<StorePack>| packs.into_iter().map(|p| (p.id, p)).collect::<HashMap<HashKey, StorePack>>();
        let mut found = remote.packs()?;
        found.sort_unstable();
        let own = by_id(load(root).unwrap_or_default());
        let is = |known: &HashMap<HashKey, StorePack>, (id, size): &(HashKey, u64)| {
            known.get(id).is_some_and(|p| p.size == *size)
        };
        let all_known = found.iter().all(|one| is(&own, one));
        let shared = if all_known { HashMap::new() } else { by_id(remote.index()?.unwrap_or_default()) };
        let (mut all, mut damaged) = (PackCatalogue::default(), vec![]);
        let mut unknown = vec![];
        for one in &found {
            let known = [&shared, &own].into_iter().find(|known| is(known, one)).and_then(|known| known.get(&one.0));
            match known {
                Some(pack) => all.insert(StorePack { modified_ns: 0, ..pack.clone() }),
                None => unknown.push(*one),
            }
        }
        let read = each(&unknown, |(id, size)| match remote.pack(*id, Some(*size)) {
            Err(StoreFileFault::Machine(why)) => Err(Fault::machine(why)),
            other => Ok((*id, other)),
        })?;
        for (id, pack) in read {
            match pack {
                Ok(pack) => all.insert(pack),
                Err(StoreFileFault::Damaged(why) | StoreFileFault::Machine(why)) => damaged.push((id, why)),
                Err(StoreFileFault::Gone) => {}
            }
        }
        all.changed = !unknown.is_empty() || (!all_known && shared.len() != found.len());
        Ok((all, damaged))
    }

    /// Catalogue of the given packs.
    pub fn of_packs(packs: Vec<StorePack>) -> PackCatalogue {
        let mut all = PackCatalogue::default();
        packs.into_iter().for_each(|pack| all.insert(StorePack { modified_ns: 0, ..pack }));
        all.changed = false;
        all
    }

    /// Packs in the index of the store at `root`, without a check of the packs; `None` if the index is missing or
    /// damaged.
    pub fn indexed(root: &Path) -> Option<PackCatalogue> {
        let mut all = PackCatalogue::default();
        load(root)?.into_iter().for_each(|pack| all.insert(pack));
        all.changed = false;
        Some(all)
    }

    /// Adds a pack, replacing a pack of the same name.
    pub fn insert(&mut self, pack: StorePack) {
        let at = self.packs.len();
        let mut first = 0;
        for (unit, packed) in pack.units.iter().enumerate() {
            let rows = packed.count();
            self.units.insert(packed.key, RowLocation { pack: at, unit, first, rows });
            first += rows.unwrap_or(0);
        }
        if let Some(old) = self.by_id.insert(pack.id, at) {
            self.packs[old] = None;
        }
        self.packs.push(Some(pack));
        self.changed = true;
    }

    /// Removes a pack from the catalogue; its units are then found in other packs that contain them.
    pub fn remove(&mut self, id: HashKey) {
        let Some(pack) = self.by_id.remove(&id).and_then(|at| self.packs.get_mut(at)).and_then(Option::take) else {
            return;
        };
        self.changed = true;
        let lost: HashSet<HashKey> = pack.units.iter().map(|u| u.key).collect();
        self.units.retain(|key, place| !lost.contains(key) || self.packs.get(place.pack).is_some_and(Option::is_some));
        for (at, pack) in self.packs.iter().enumerate() {
            let mut first = 0;
            for (unit, packed) in pack.iter().flat_map(|p| p.units.iter().enumerate()) {
                let rows = packed.count();
                if lost.contains(&packed.key) {
                    self.units.entry(packed.key).or_insert(RowLocation { pack: at, unit, first, rows });
                }
                first += rows.unwrap_or(0);
            }
        }
    }

    /// Location of a unit.
    pub fn find(&self, key: HashKey) -> Option<RowLocation> {
        self.units.get(&key).copied()
    }

    /// Pack at a position in the catalogue.
    pub fn pack(&self, at: usize) -> Option<&StorePack> {
        self.packs.get(at).and_then(Option::as_ref)
    }

    /// Pack by name.
    pub fn by_id(&self, id: HashKey) -> Option<&StorePack> {
        self.by_id.get(&id).and_then(|at| self.pack(*at))
    }

    /// All packs.
    pub fn packs(&self) -> impl Iterator<Item = &StorePack> {
        self.packs.iter().flatten()
    }

    /// Bytes of the index, if it differs from the index on the disk.
    pub fn to_write(&mut self) -> Option<Vec<u8>> {
        if !std::mem::take(&mut self.changed) {
            return None;
        }
        let mut packs: Vec<&StorePack> = self.packs().collect();
        packs.sort_unstable_by_key(|p| p.id);
        let mut bytes = MARK.to_vec();
        for pack in packs {
            bytes.extend(pack.id.as_ref());
            bytes.extend(pack.size.to_le_bytes());
            bytes.extend(pack.modified_ns.to_le_bytes());
            bytes.extend(pack.kind.as_ref());
            bytes.extend((pack.units.len() as u64).to_le_bytes());
            for unit in &pack.units {
                bytes.extend(unit.key.as_ref());
                bytes.extend(unit.passthrough_hash.to_le_bytes());
                bytes.extend(unit.rows.to_le_bytes());
            }
        }
        let sum = blake3::hash(&bytes);
        bytes.extend(sum.as_bytes());
        Some(bytes)
    }
}

/// Pack `id` from its file; verifies all bytes.
///
/// # Errors
/// Fails if the file is damaged, missing or unreadable.
pub fn read(root: &Path, id: HashKey, (size, modified_ns): (u64, u64)) -> Result<StorePack, StoreFileFault> {
    let file = path(root, id);
    let (kind, units) = verify(&file).and_then(|()| SealedFile::open(&file)).and_then(|s| units_of(s.text(UNITS)))?;
    Ok(StorePack { id, size, modified_ns, kind, units })
}

/// Contents of the index, if it is intact.
fn load(root: &Path) -> Option<Vec<StorePack>> {
    parse(&paths::read_regular(&root.join("index")).ok()?)
}

/// Packs in the bytes of an index, if they are intact.
pub fn parse(bytes: &[u8]) -> Option<Vec<StorePack>> {
    let (body, sum) = bytes.split_at_checked(bytes.len().checked_sub(blake3::OUT_LEN)?)?;
    if blake3::hash(body).as_bytes() != sum {
        return None;
    }
    let mut rest = body.strip_prefix(MARK)?;
    let mut packs = vec![];
    while !rest.is_empty() {
        let id = HashKey::from_bytes(take(&mut rest)?);
        let size = u64::from_le_bytes(take(&mut rest)?);
        let modified_ns = u64::from_le_bytes(take(&mut rest)?);
        let kind = HashKey::from_bytes(take(&mut rest)?);
        let count = u64::from_le_bytes(take(&mut rest)?);
        let units = (0..count).map(|_| {
            let key = HashKey::from_bytes(take(&mut rest)?);
            Some(PackedUnit {
                key,
                passthrough_hash: u64::from_le_bytes(take(&mut rest)?),
                rows: u32::from_le_bytes(take(&mut rest)?),
            })
        });
        packs.push(StorePack { id, size, modified_ns, kind, units: units.collect::<Option<Vec<_>>>()? });
    }
    Some(packs)
}

fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (head, tail) = rest.split_first_chunk::<N>()?;
    *rest = tail;
    Some(*head)
}

/// Kind and units of a file, from the text in its footer.
///
/// # Errors
/// Fails if the text is missing or unreadable.
pub fn units_of(text: Option<&str>) -> Result<(HashKey, Vec<PackedUnit>), StoreFileFault> {
    let text = text.ok_or_else(|| StoreFileFault::Damaged("its list of units is missing".to_owned()))?;
    let read = || {
        let (kind, lines) = text.split_once('\n')?;
        let unit = |line: &str| {
            let (key, rest) = line.split_once(' ')?;
            let (passthrough_hash, rows) = rest.split_once(' ')?;
            let rows = if rows == "failed" { FAILED } else { rows.parse().ok()? };
            Some(PackedUnit {
                key: HashKey::parse(key)?,
                passthrough_hash: u64::from_str_radix(passthrough_hash, 16).ok()?,
                rows,
            })
        };
        Some((HashKey::parse(kind)?, lines.lines().map(unit).collect::<Option<Vec<_>>>()?))
    };
    read().ok_or_else(|| StoreFileFault::Damaged("its list of units is unreadable".to_owned()))
}

/// Text of the units in a pack's footer.
pub fn spell(kind: HashKey, units: &[PackedUnit]) -> String {
    let line = |PackedUnit { key, passthrough_hash, rows }: &PackedUnit| match *rows {
        FAILED => format!("{key} {passthrough_hash:016x} failed\n"),
        rows => format!("{key} {passthrough_hash:016x} {rows}\n"),
    };
    format!("{kind}\n") + &units.iter().map(line).collect::<String>()
}

impl PackedUnit {
    /// Number of rows; `None` if the unit could not be computed.
    pub fn count(&self) -> Option<usize> {
        (self.rows != FAILED).then_some(self.rows as usize)
    }
}
