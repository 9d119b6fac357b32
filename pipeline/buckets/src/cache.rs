//! Cache: the folder of this machine with copies of objects.
//!
//! ```text
//! stores/<name>-<hash>/   a store with the layout of a store in a folder; its file REMOTE contains the address
//! files/<place>/<bucket>/ inputs, under their own names, each with its version in the file `.<name>.etag`
//! ```
//! Its path is `MAGLINE_CACHE`, or else `magline` in `XDG_CACHE_HOME` or in `.cache` of the home folder. The
//! cache can be removed while no program uses it.

use std::{
    env,
    path::{Path, PathBuf},
};

use schemas::{Fault, keys::HashKey};

use super::{address::ObjectAddress, connect::endpoint};

/// Folder of the cache.
///
/// # Errors
/// Fails if the environment specifies no folder.
fn folder() -> Result<PathBuf, Fault> {
    let set = |name: &str| env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let own = set("MAGLINE_CACHE");
    let shared = || set("XDG_CACHE_HOME").filter(|p| p.is_absolute()).map(|p| p.join("magline"));
    let home = || set("HOME").map(|p| p.join(".cache").join("magline"));
    let found = own
        .or_else(shared)
        .or_else(home)
        .ok_or_else(|| Fault::machine("there is no cache folder for objects").help("set MAGLINE_CACHE to a folder"))?;
    std::path::absolute(&found).map_err(|e| Fault::machine(format!("cannot use the folder {}: {e}", found.display())))
}

fn hash(parts: &[&str], digits: usize) -> String {
    HashKey::from_parts(parts).to_string().chars().take(digits).collect()
}

/// Folder of the store at `address`.
///
/// # Errors
/// Fails if the environment specifies no folder for the cache.
pub fn of_store(address: &ObjectAddress) -> Result<PathBuf, Fault> {
    let text = address.to_string();
    let name: String = text.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).take(60).collect();
    let hash = hash(&[&text, &endpoint(address.scheme)], 16);
    Ok(folder()?.join("stores").join(format!("{}-{hash}", name.replace("---", "-"))))
}

/// Folder of the objects of the bucket of `address`.
///
/// # Errors
/// Fails if the environment specifies no folder for the cache.
pub fn of_files(address: &ObjectAddress) -> Result<PathBuf, Fault> {
    let scheme = address.scheme.as_str();
    let place = match endpoint(address.scheme) {
        none if none.is_empty() => scheme.to_owned(),
        some => format!("{scheme}-{}", hash(&[&some], 8)),
    };
    Ok(folder()?.join("files").join(place).join(&address.bucket))
}

/// Name of a file for display: the object's address for a file in the cache, otherwise the path.
pub fn shown(path: &Path) -> String {
    let address = || {
        let below = path.strip_prefix(folder().ok()?.join("files")).ok()?;
        let mut parts = below.components().map(|c| c.as_os_str().to_string_lossy());
        let place = parts.next()?;
        let scheme = place.split('-').next()?.to_owned();
        Some(format!("{scheme}://{}", parts.collect::<Vec<_>>().join("/")))
    };
    address().unwrap_or_else(|| path.display().to_string())
}
