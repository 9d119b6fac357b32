//! The files of a path.

use std::{
    fs,
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};

use buckets::{ObjectAddress, StorageLocation, place};
use datasets::FlightOptions;
use intake::flight_formats;
use schemas::Fault;

/// The files of `path`: a file, a folder (all files in it, sorted, without hidden ones) or a glob.
///
/// # Errors
/// Fails if there are no files.
pub fn find(path: &str, folder: &Path, any_name: bool) -> Result<Vec<PathBuf>, Fault> {
    let path = match place(path)? {
        StorageLocation::Object(address) => return objects(&address, any_name),
        StorageLocation::Path(path) => path.to_string_lossy().into_owned(),
    };
    let path = path.as_str();
    let full = folder.join(path);
    let mut found = vec![];
    // A name with brackets is first tried literally.
    if full.is_file() {
        found.push(full.clone());
    } else if full.exists() && !full.is_dir() {
        let fault = Fault::new(format!("{} is a pipe, socket or device, not a regular file", full.display()));
        return Err(fault.help("write its output to a file, and use that file"));
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
        return Err(none(&full.display()));
    }
    Ok(found)
}

fn none(place: &dyn std::fmt::Display) -> Fault {
    let known: Vec<&str> = flight_formats().iter().flat_map(|f| f.extensions).copied().collect();
    let fault = Fault::new(format!("there are no flight files in {place}"));
    fault.help(format!("supported extensions: {}", known.join(", ")))
}

/// The local copies of the objects at `address`.
fn objects(address: &ObjectAddress, any_name: bool) -> Result<Vec<PathBuf>, Fault> {
    let found = buckets::find(address, &|name| any_name || is_flight(Path::new(name)))?;
    if found.is_empty() { Err(none(address)) } else { Ok(found) }
}

/// The file that a spec names: a file in `folder`, or the copy of an object.
///
/// # Errors
/// Fails for an unknown address, a missing object, or a server that cannot be reached or rejects the request.
pub fn file(path: &str, folder: &Path) -> Result<PathBuf, Fault> {
    match place(path)? {
        StorageLocation::Path(path) => Ok(folder.join(path)),
        StorageLocation::Object(address) => buckets::fixed(&address),
    }
}

/// Removes the files that were modified less than `settle` ago or in the future, and returns a note with their names.
pub fn settled(found: &mut Vec<PathBuf>, settle: Duration) -> Option<String> {
    const SHOWN: usize = 5;
    let now = SystemTime::now();
    let young = |p: &Path| {
        let written = fs::metadata(p).and_then(|m| m.modified());
        written.is_ok_and(|t| now.duration_since(t).map_or(true, |age| age < settle))
    };
    let (left, whole): (Vec<PathBuf>, Vec<PathBuf>) = std::mem::take(found).into_iter().partition(|p| young(p));
    *found = whole;
    let names: Vec<String> = left.iter().take(SHOWN).map(|p| p.display().to_string()).collect();
    let more = if left.len() > SHOWN { format!(" and {} more", left.len() - SHOWN) } else { String::new() };
    (!left.is_empty()).then(|| {
        let seconds = settle.as_secs();
        format!(
            "skipped by `--settle`, because they were modified in the last {seconds} s: {}{more}; the next run reads \
             them",
            names.join(", ")
        )
    })
}

/// Pattern for the files of `path` in `folder`. Special characters in the name of `folder` are escaped.
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
    flight_formats().iter().flat_map(|f| f.extensions).any(ends)
}

/// Adds the files in a folder and its subfolders, in the order of their names.
///
/// # Errors
/// Fails if a folder cannot be read.
pub fn walk(folder: &Path, found: &mut Vec<PathBuf>) -> std::io::Result<()> {
    let mut entries = fs::read_dir(folder)?.collect::<Result<Vec<_>, _>>()?;
    entries.sort_by_key(fs::DirEntry::file_name);
    for entry in entries {
        if entry.file_name().to_string_lossy().starts_with(['.', '_']) {
            continue;
        }
        // A link without a target is kept, because opening it reports the fault. A pipe or a device is not a data file.
        match fs::metadata(entry.path()) {
            Ok(about) if about.is_dir() => walk(&entry.path(), found)?,
            Ok(about) if !about.is_file() => {}
            Ok(_) | Err(_) => found.push(entry.path()),
        }
    }
    Ok(())
}

/// The options for one file: `flight=...` and `line=...` in the names of its folders replace columns.
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
