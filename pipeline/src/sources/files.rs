//! Which files a path means, and what their bytes are known by.

use std::{
    fs,
    io::Read,
    path::{Path, PathBuf},
    time::UNIX_EPOCH,
};

use datasets::FlightOptions;
use schemas::Fault;
use serde::{Deserialize, Serialize};

use crate::{keys::Key, store::Store};

/// A file or folder, and the key of its bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bytes {
    /// As the spec names it.
    pub path: PathBuf,
    /// Of all its bytes.
    pub hash: Key,
}

/// The files that `path` means: a file, a folder (all files in it, sorted, hidden ones left out) or a glob.
///
/// # Errors
/// When there are none.
pub fn find(path: &str, folder: &Path, any_name: bool) -> Result<Vec<PathBuf>, Fault> {
    if path.contains("://") {
        let help = "copy the files into a folder; this version reads files, folders and globs";
        return Err(Fault::new(format!("cannot read from `{path}`")).help(help));
    }
    let full = folder.join(path);
    let mut found = vec![];
    // A name with brackets is first taken as it is written.
    if full.is_file() {
        found.push(full.clone());
    } else if full.exists() && !full.is_dir() {
        let fault = Fault::new(format!("{} is a pipe, socket or device, not a regular file", full.display()));
        return Err(fault.help("write what it yields into a file, and name that"));
    } else if full.is_dir() {
        walk(&full, &mut found).map_err(|e| Fault::machine(format!("cannot read {}: {e}", full.display())))?;
        if !any_name {
            found.retain(|f| is_flight(f));
        }
    } else if path.contains(['*', '?', '[']) {
        let pattern = pattern(path, folder);
        let paths = glob::glob(&pattern).map_err(|e| Fault::new(format!("`{path}` is not a pattern: {e}")))?;
        found = paths.filter_map(Result::ok).filter(|p| p.is_file()).collect();
        found.sort();
    } else {
        return Err(Fault::new(format!("there is no file or folder {}", full.display())));
    }
    if found.is_empty() {
        let known: Vec<&str> = datasets::formats::FLIGHT_FORMATS.iter().flat_map(|f| f.extensions).copied().collect();
        let fault = Fault::new(format!("there are no flight files in {}", full.display()));
        return Err(fault.help(format!("looked for names that end in {}", known.join(", "))));
    }
    Ok(found)
}

/// The pattern for the files that `path` means from `folder`, whose own name is no pattern.
fn pattern(path: &str, folder: &Path) -> String {
    if Path::new(path).is_absolute() {
        return path.to_owned();
    }
    let folder = glob::Pattern::escape(&folder.to_string_lossy());
    Path::new(&folder).join(path).to_string_lossy().into_owned()
}

fn is_flight(path: &Path) -> bool {
    let name = path.to_string_lossy().to_ascii_lowercase();
    let ends = |e: &&str| name.ends_with(&format!(".{e}"));
    datasets::formats::FLIGHT_FORMATS.iter().flat_map(|f| f.extensions).any(ends)
}

fn walk(folder: &Path, found: &mut Vec<PathBuf>) -> std::io::Result<()> {
    let mut entries = fs::read_dir(folder)?.collect::<Result<Vec<_>, _>>()?;
    entries.sort_by_key(fs::DirEntry::file_name);
    for entry in entries {
        if entry.file_name().to_string_lossy().starts_with(['.', '_']) {
            continue;
        }
        // A link that leads nowhere is kept: opening it says so. A pipe or a device is no file of data.
        match fs::metadata(entry.path()) {
            Ok(about) if about.is_dir() => walk(&entry.path(), found)?,
            Ok(about) if !about.is_file() => {}
            Ok(_) | Err(_) => found.push(entry.path()),
        }
    }
    Ok(())
}

/// The options for one file: `flight=...` and `line=...` in its folders stand for columns.
pub fn hive(path: &Path, options: &FlightOptions) -> FlightOptions {
    let mut options = options.clone();
    for part in path.components() {
        let part = part.as_os_str().to_string_lossy();
        match part.split_once('=') {
            Some(("flight", value)) => options.flight = options.flight.or(Some(value.to_owned())),
            Some(("line", value)) => options.line = options.line.or(Some(value.to_owned())),
            _ => {}
        }
    }
    options
}

/// What a file was when its bytes were last read.
#[derive(Serialize, Deserialize, PartialEq)]
struct Seen {
    size: u64,
    modified_ns: u128,
    hash: String,
    /// A checksum of all this.
    #[serde(default)]
    sum: String,
}

impl Seen {
    fn new(size: u64, modified_ns: u128, key: Key) -> Seen {
        let hash = key.to_string();
        let sum = Key::of([&size.to_string(), &modified_ns.to_string(), &hash]).to_string();
        Seen { size, modified_ns, hash, sum }
    }
}

/// The key of all bytes of a file or folder. A file whose size and time of change are those of last time is not read
/// again.
///
/// # Errors
/// When it cannot be read.
pub fn fingerprint(store: &Store, path: &Path) -> Result<Bytes, Fault> {
    let fail = |e: std::io::Error| Fault::machine(format!("cannot read {}: {e}", path.display()));
    let hash = if path.is_dir() {
        let mut files = vec![];
        walk(path, &mut files).map_err(fail)?;
        let mut parts = vec![];
        for file in files {
            parts.push(file.strip_prefix(path).unwrap_or(&file).to_string_lossy().into_owned());
            parts.push(one(store, &file).map_err(fail)?.to_string());
        }
        Key::of(parts)
    } else {
        one(store, path).map_err(fail)?
    };
    Ok(Bytes { path: path.to_owned(), hash })
}

fn one(store: &Store, path: &Path) -> std::io::Result<Key> {
    let about = fs::metadata(path)?;
    let modified_ns = about.modified()?.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos());
    let full = path.canonicalize()?;
    let note = store.root().join("sources").join(format!("{}.seen", Key::of([full.to_string_lossy().as_bytes()])));
    let seen: Option<Seen> = fs::read(&note).ok().and_then(|b| serde_json::from_slice(&b).ok());
    if let Some(seen) = seen
        && let Some(key) = Key::parse(&seen.hash)
        && seen == Seen::new(about.len(), modified_ns, key)
    {
        return Ok(key);
    }
    let key = hash_file(path)?;
    let seen = Seen::new(about.len(), modified_ns, key);
    // Only saves reading the file again, so a failure to write it costs nothing but time.
    let _ = store.write(&note, &serde_json::to_vec(&seen).unwrap_or_default());
    Ok(key)
}

fn hash_file(path: &Path) -> std::io::Result<Key> {
    let mut hasher = blake3::Hasher::new();
    let mut file = fs::File::open(path)?;
    let mut buffer = vec![0; 1 << 20];
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok(Key::finish(&hasher)),
            n => hasher.update(&buffer[..n]),
        };
    }
}
