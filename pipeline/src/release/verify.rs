//! `magline verify DIR`: checks that a published set is unchanged, and that its description is correct.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    io::Read,
    path::Path,
};

use arrow_array::cast::AsArray;
use rayon::prelude::*;
use schemas::{Fault, paths};

use super::{
    checksums, documents, folder, parquet,
    set::{ColumnValueStatistics, DataDictionary, DataFile, FORMAT, ReleaseLockfile, ReleaseSet, ReleaseTable},
    words::{DICTIONARY, LOCK},
};

/// Result of checking a set.
#[derive(Debug, Default)]
pub struct ReleaseVerification {
    /// Number of files read.
    pub files: usize,
    /// Number of rows of all tables.
    pub rows: u64,
    /// Faults: the file, and the reason.
    pub faults: Vec<(String, String)>,
}

impl ReleaseVerification {
    fn push(&mut self, file: &str, why: impl Into<String>) {
        self.faults.push((file.to_owned(), why.into()));
    }

    /// Drops, for each missing file, the faults that come after the fault that the file is missing.
    fn merge(&mut self) {
        let mut missing = BTreeSet::new();
        self.faults.retain(|(file, why)| !missing.contains(file) && (why != MISSING || missing.insert(file.clone())));
    }
}

/// Reason reported for a missing file.
const MISSING: &str = "it is missing";

/// Checks the set in the folder `root`: checksums, files, every value of every table, and whether the documents agree
/// with these data.
///
/// # Errors
/// Fails if there is no published set, or the folder cannot be read.
pub fn verify(root: &Path) -> Result<ReleaseVerification, Fault> {
    let mut found = checked(root)?;
    found.merge();
    Ok(found)
}

fn checked(root: &Path) -> Result<ReleaseVerification, Fault> {
    let read = |name: &str| text(root, name);
    if !root.join(checksums::NAME).exists() && !root.join(DICTIONARY).exists() {
        let fault = Fault::new(format!("{} is not a published set", root.display()));
        return Err(fault.help(format!("it has no file {}; to verify a store, use `--store`", checksums::NAME)));
    }
    let mut found = ReleaseVerification::default();
    let there = folder::files(root).map_err(|e| Fault::machine(format!("cannot read {}: {e}", root.display())))?;
    let dictionary = read(DICTIONARY).and_then(|text| parsed::<DataDictionary>(&text));
    let lock = read(LOCK).and_then(|text| parsed::<ReleaseLockfile>(&text));
    let sizes = sizes(dictionary.as_ref().ok(), lock.as_ref().ok());
    sums(root, &there, &sizes, &mut found);
    let (dictionary, lock) = match (dictionary, lock) {
        (Ok(dictionary), Ok(lock)) => (dictionary, lock),
        (dictionary, lock) => {
            dictionary.err().into_iter().for_each(|e| found.push(DICTIONARY, e));
            lock.err().into_iter().for_each(|e| found.push(LOCK, e));
            return Ok(found);
        }
    };
    for (name, format) in [(DICTIONARY, &dictionary.format), (LOCK, &lock.format)] {
        if format != FORMAT {
            found.push(name, format!("its format is `{format}`, but this version supports only `{FORMAT}`"));
            return Ok(found);
        }
    }
    let mut set = ReleaseSet { dictionary, lock };
    inputs(&set, root, &sizes, &mut found);
    listed(&set, &there, &mut found);
    let tables: Vec<TableVerification> = set.dictionary.tables.par_iter().map(|table| check(root, table)).collect();
    for (table, checked) in set.dictionary.tables.iter_mut().zip(tables) {
        found.faults.extend(checked.faults);
        found.rows += checked.rows;
        table.rows = checked.rows;
        table.columns.iter_mut().zip(checked.values).for_each(|(column, values)| column.values = values);
    }
    agree(&set, root, &mut found)?;
    Ok(found)
}

fn parsed<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_json::from_str(text).map_err(|e| format!("it is unreadable: {e}"))
}

/// Maximum size, in bytes, of a file whose size is not listed in any document.
const DOCUMENT: u64 = 256 << 20;

/// Size of each file as listed in the documents, in bytes.
type DocumentedSizes = BTreeMap<String, u64>;

fn sizes(dictionary: Option<&DataDictionary>, lock: Option<&ReleaseLockfile>) -> DocumentedSizes {
    let files = dictionary.into_iter().flat_map(|d| &d.tables).flat_map(|t| &t.files);
    let inputs = lock.into_iter().flat_map(|l| &l.inputs);
    let inputs = inputs.filter_map(|input| Some((input.included.clone()?, input.bytes)));
    files.map(|file| (file.path.clone(), file.bytes)).chain(inputs).collect()
}

/// Text of a document of a set.
fn text(root: &Path, name: &str) -> Result<String, String> {
    let file = paths::open_regular(&root.join(name)).map_err(|e| e.to_string())?;
    let mut text = String::new();
    match file.take(DOCUMENT).read_to_string(&mut text) {
        Ok(n) if n as u64 == DOCUMENT => Err("it is too large for a document".to_owned()),
        Ok(_) => Ok(text),
        Err(e) => Err(e.to_string()),
    }
}

/// Checksum of a file. A file of unexpected size, such as a sparse one, is not read.
fn sum(root: &Path, path: &str, sizes: &DocumentedSizes) -> Result<String, String> {
    let full = root.join(path);
    let there = fs::symlink_metadata(&full).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => MISSING.to_owned(),
        _ => e.to_string(),
    })?;
    if !there.is_file() {
        return Err("it is not a regular file".to_owned());
    }
    match sizes.get(path) {
        Some(size) if there.len() != *size => Err(format!("it has {} bytes, not {size}", there.len())),
        None if there.len() > DOCUMENT => Err(format!("it has {} bytes, too many for a document", there.len())),
        _ => checksums::of_file(&full, |_| {}).map(|(_, sum)| sum).map_err(|e| e.to_string()),
    }
}

/// Checks files against their checksums.
fn sums(root: &Path, there: &[String], sizes: &DocumentedSizes, found: &mut ReleaseVerification) {
    let sums = match text(root, checksums::NAME).and_then(|text| checksums::read(&text)) {
        Ok(sums) => sums,
        Err(why) => {
            found.push(checksums::NAME, why);
            BTreeMap::new()
        }
    };
    let each: Vec<Option<(String, String)>> = sums
        .par_iter()
        .map(|(path, sum)| {
            let why = match self::sum(root, path, sizes) {
                Ok(now) => (now != *sum).then(|| "its checksum is wrong".to_owned()),
                Err(why) => Some(why),
            };
            why.map(|why| (path.clone(), why))
        })
        .collect();
    found.files = sums.len();
    found.faults.extend(each.into_iter().flatten());
    for extra in there.iter().filter(|f| *f != checksums::NAME && !sums.contains_key(*f)) {
        found.push(extra, "it is not part of the published set");
    }
}

/// Checks the included spec and inputs against the lock.
fn inputs(set: &ReleaseSet, root: &Path, sizes: &DocumentedSizes, found: &mut ReleaseVerification) {
    let mut check = |path: &str, sha256: &str| {
        if !checksums::is_inside(path) {
            found.push(LOCK, format!("the path `{path}` leads outside the folder"));
        } else if let Ok(now) = sum(root, path, sizes)
            && now != sha256
        {
            found.push(path, format!("its checksum differs from the one in {LOCK}"));
        }
    };
    check(&set.lock.spec, &set.lock.spec_sha256);
    for input in &set.lock.inputs {
        input.included.iter().for_each(|path| check(path, &input.sha256));
    }
}

/// Checks the files of `data/` against those that the dictionary lists.
fn listed(set: &ReleaseSet, there: &[String], found: &mut ReleaseVerification) {
    let listed: Vec<&String> = set.dictionary.tables.iter().flat_map(|t| t.files.iter().map(|f| &f.path)).collect();
    for path in there.iter().filter(|p| p.starts_with("data/") && !listed.contains(p)) {
        found.push(path, format!("it is not in {DICTIONARY}"));
    }
}

/// Findings about the files of a table, collected during verification.
struct TableVerification {
    faults: Vec<(String, String)>,
    rows: u64,
    values: Vec<ColumnValueStatistics>,
}

fn check(root: &Path, table: &ReleaseTable) -> TableVerification {
    let mut checked = TableVerification {
        faults: vec![],
        rows: 0,
        values: vec![ColumnValueStatistics::default(); table.columns.len()],
    };
    for file in &table.files {
        let read = if checksums::is_inside(&file.path) {
            check_file(root, table, file, &mut checked.values)
        } else {
            Err("its path leads outside the folder".to_owned())
        };
        match read {
            Ok(rows) => checked.rows += rows,
            Err(why) => checked.faults.push((file.path.clone(), why)),
        }
    }
    checked
}

/// Reads every value of a file and returns its number of rows.
fn check_file(
    root: &Path,
    table: &ReleaseTable,
    file: &DataFile,
    values: &mut [ColumnValueStatistics],
) -> Result<u64, String> {
    let path = root.join(&file.path);
    let size = fs::symlink_metadata(&path).map_err(|e| e.to_string())?;
    if !size.is_file() {
        return Err("it is not a regular file".to_owned());
    }
    let same =
        size.len() == file.bytes && checksums::of_file(&path, |_| {}).map_err(|e| e.to_string())?.1 == file.sha256;
    if !same {
        return Err(format!("its size or checksum differs from {DICTIONARY}"));
    }
    let mut rows = 0;
    let schema = parquet::read(&path, |batch| {
        rows += batch.num_rows() as u64;
        values.iter_mut().zip(batch.columns()).for_each(|(values, array)| parquet::count(values, array));
        for (name, wanted) in [("flight", &file.flight), ("line", &file.line)] {
            let (Some(wanted), Some(array)) = (wanted, batch.column_by_name(name)) else { continue };
            let texts = array.as_string_opt::<i32>().ok_or_else(|| format!("`{name}` is not text"))?;
            if texts.iter().any(|x| x != Some(wanted.as_str())) {
                return Err(format!("it has rows whose {name} is not `{wanted}`"));
            }
        }
        Ok(())
    })?;
    let bare = |c: &super::set::ReleaseColumn| {
        (c.name.clone(), c.kind.clone(), c.unit.clone(), c.role.clone(), c.description.clone())
    };
    let (own, expected) = (parquet::columns(&schema), &table.columns);
    if own.len() != expected.len() {
        return Err(format!("it has {} columns, but {} in {DICTIONARY}", own.len(), expected.len()));
    }
    if let Some((own, expected)) =
        own.iter().zip(expected).find(|(own, expected)| bare(own) != bare(expected) || own.terms != expected.terms)
    {
        let shown = |c: &super::set::ReleaseColumn| format!("`{}`, {} [{}], role {}", c.name, c.kind, c.unit, c.role);
        return Err(format!("it has the column {}, but {DICTIONARY} has {}", shown(own), shown(expected)));
    }
    if rows != file.rows {
        return Err(format!("it has {rows} rows, but {} in {DICTIONARY}", file.rows));
    }
    Ok(rows)
}

/// Compares the documents with documents that are made again from the set and the values of its files.
fn agree(set: &ReleaseSet, root: &Path, found: &mut ReleaseVerification) -> Result<(), Fault> {
    for (path, wanted) in documents::all(set)? {
        // The path is checked, because it contains the name of a table.
        if !checksums::is_inside(&path) {
            found.push(DICTIONARY, format!("the path `{path}` leads outside the folder"));
            continue;
        }
        let Ok(text) = text(root, &path) else {
            if !root.join(&path).exists() {
                found.push(&path, MISSING);
            }
            continue;
        };
        if text == wanted {
            continue;
        }
        let lines = text.lines().zip(wanted.lines()).position(|(a, b)| a != b);
        let at = lines.unwrap_or_else(|| text.lines().count().min(wanted.lines().count()));
        let cut = |text: &str| text.lines().nth(at).unwrap_or("the end").trim().chars().take(100).collect::<String>();
        found.push(
            &path,
            format!("it contradicts the data: line {} is `{}`, but must be `{}`", at + 1, cut(&text), cut(&wanted)),
        );
    }
    Ok(())
}
