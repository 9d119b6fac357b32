//! Atomic writes of files that other programs read meanwhile.

use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
};

use schemas::Fault;

/// The folder that contains a file.
fn folder(path: &Path) -> PathBuf {
    path.parent().filter(|p| !p.as_os_str().is_empty()).map_or_else(|| PathBuf::from("."), Path::to_owned)
}

/// Checks before the run that a file can be written to `path`.
///
/// # Errors
/// Fails if the folder of `path` does not exist, or `path` is a folder.
pub fn check(flag: &str, path: &Path) -> Result<(), Fault> {
    if path.is_dir() {
        return Err(Fault::new(format!("`{flag}` requires a file, but {} is a folder", path.display()))
            .help("give a file in this folder"));
    }
    if path.file_name().is_none() || !folder(path).is_dir() {
        let what = format!("`{flag}`: there is no folder {}", folder(path).display());
        return Err(Fault::new(what).help("create the folder, or give another file"));
    }
    Ok(())
}

/// Writes a file in one step: readers see either the old or the new content. Other kinds of files, such as pipes, are
/// written directly.
///
/// # Errors
/// Fails on errors of the file system; the old content is then kept.
pub fn write(path: &Path, text: &str) -> io::Result<()> {
    if fs::metadata(path).is_ok_and(|about| !about.is_file()) {
        return File::options().write(true).open(path)?.write_all(text.as_bytes());
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let tmp = path.with_file_name(format!(".{name}.{}", std::process::id()));
    let written = File::create(&tmp).and_then(|mut f| f.write_all(text.as_bytes()).and_then(|()| f.sync_all()));
    let written = written.and_then(|()| fs::rename(&tmp, path));
    if written.is_err() {
        // The file may be missing, so an error is ignored.
        let _ = fs::remove_file(&tmp);
    }
    written
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_a_write_is_atomic_and_leaves_no_temporary_file() {
        let made = tempfile::tempdir().unwrap();
        let path = made.path().join("a.prom");
        write(&path, "one\n").unwrap();
        write(&path, "two\n").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "two\n");
        assert_eq!(fs::read_dir(made.path()).unwrap().count(), 1);
        write(Path::new("/dev/null"), "x").unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
        assert!(check("--metrics", &path).is_ok() && check("--metrics", Path::new("plain.prom")).is_ok());
        assert!(check("--metrics", made.path()).is_err() && check("--metrics", &made.path().join("no/x")).is_err());
        assert!(write(&made.path().join("no/x"), "x").is_err());
    }
}
