//! Checks of external names and paths: from a command line, spec, manifest, receipt, plan or published set.

use std::{
    fs::{self, File},
    io,
    path::Path,
};

/// Maximum length of the name of a pipeline, table, axis or stage, in bytes. The name becomes a folder, and a file name
/// with a suffix.
pub const LONGEST_NAME: usize = 100;
/// Maximum length of a file or folder name in common file systems, in bytes.
pub const LONGEST_PART: usize = 255;
/// Maximum length of a path in common operating systems, in bytes.
pub const LONGEST_PATH: usize = 4096;

/// Reserved device names on Windows, with any suffix and in any case.
const DEVICES: [&str; 4] = ["con", "prn", "aux", "nul"];
/// Reserved device names with a digit from 1 to 9.
const NUMBERED: [&str; 2] = ["com", "lpt"];

/// Whether a name is reserved on Windows. A published set or a store may be copied to Windows.
fn is_device(name: &str) -> bool {
    let stem = name.split('.').next().unwrap_or_default().trim_end().to_ascii_lowercase();
    let numbered = |start: &&str| {
        stem.strip_prefix(*start).is_some_and(|n| n.len() == 1 && n.starts_with(|c: char| ('1'..='9').contains(&c)))
    };
    DEVICES.contains(&stem.as_str()) || NUMBERED.iter().any(numbered)
}

/// Checks the name of a pipeline, table, axis or stage. The name becomes a folder and an SQL identifier.
///
/// # Errors
/// Returns the rule that the name violates.
pub fn check_name(name: &str) -> Result<(), String> {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    if !name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') || !name.chars().all(plain) {
        return Err("a name begins with a letter and holds letters, digits, `_` and `-`".to_owned());
    }
    if name.len() > LONGEST_NAME {
        return Err(format!("a name has at most {LONGEST_NAME} characters"));
    }
    if is_device(name) {
        return Err("Windows reserves this name for a device".to_owned());
    }
    Ok(())
}

/// Checks a path below a folder, with `/` between its parts. It must stay in the folder on every operating system.
///
/// # Errors
/// Returns the reason why the path is rejected.
pub fn check_path(path: &str) -> Result<(), String> {
    if path.is_empty() {
        return Err("the path is empty".to_owned());
    }
    if path.len() > LONGEST_PATH {
        return Err(format!("the path is longer than {LONGEST_PATH} bytes"));
    }
    if path.starts_with('/') {
        return Err("the path is absolute".to_owned());
    }
    if path.contains(char::is_control) {
        return Err("the path contains control characters".to_owned());
    }
    if path.contains('\\') {
        return Err("the path contains a backslash".to_owned());
    }
    let drive = path.as_bytes();
    if drive.get(1) == Some(&b':') && drive.first().is_some_and(u8::is_ascii_alphabetic) {
        return Err("the path contains a drive letter".to_owned());
    }
    for part in path.split('/') {
        if part.is_empty() || part == "." || part == ".." {
            return Err("the path leads out of the folder or has an empty part".to_owned());
        }
        if part.len() > LONGEST_PART {
            return Err(format!("a part of the path is longer than {LONGEST_PART} bytes"));
        }
        if is_device(part) {
            return Err(format!("Windows reserves the name `{part}` for a device"));
        }
    }
    Ok(())
}

/// Checks that a path below `root` contains no link, which guarantees that its target is in `root`. Parts of the path
/// that do not exist are accepted.
///
/// # Errors
/// Fails for a path outside `root`, for a link, or on an error of the file system.
pub fn check_no_link(root: &Path, path: &Path) -> io::Result<()> {
    let below = path.strip_prefix(root).map_err(|_| io::Error::other("it is outside the folder"))?;
    let mut at = root.to_owned();
    for part in below.components() {
        at.push(part);
        match fs::symlink_metadata(&at) {
            Ok(about) if about.is_symlink() => {
                return Err(io::Error::other(format!("{} is a symbolic link", at.display())));
            }
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => {}
        }
    }
    Ok(())
}

/// Opens a regular file. Rejects pipes, sockets and devices, because reading them may never end.
///
/// # Errors
/// Fails for anything but a regular file, or on an error of the file system.
pub fn open_regular(path: &Path) -> io::Result<File> {
    let refused = || io::Error::new(io::ErrorKind::InvalidInput, "it is not a regular file");
    // Opening a pipe waits for its other end, so the file type is checked first.
    if !fs::metadata(path)?.is_file() {
        return Err(refused());
    }
    let file = File::open(path)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(refused()) }
}

/// Reads a regular file: see [`open_regular`].
///
/// # Errors
/// Returns the errors of [`open_regular`].
pub fn read_regular(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = vec![];
    io::Read::read_to_end(&mut open_regular(path)?, &mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::path::{Component, PathBuf};

    use super::*;

    #[test]
    fn unit_invalid_names_and_paths_are_rejected() {
        for name in ["clean", "_a", "a-1", "Big-one", "console", "com10", "nulls"] {
            assert_eq!(check_name(name), Ok(()), "{name}");
        }
        for name in
            ["", "1a", "a b", "a/b", "..", ".", "a.b", "/a", "a\0", "a\n", "\u{e9}", "CON", "nul", "Com1", "-a", "a\\b"]
        {
            assert!(check_name(name).is_err(), "{name:?}");
        }
        assert!(check_name(&"a".repeat(101)).is_err());
        for path in
            ["a", "data/t/flight_id=flight-1/part-0.parquet", "a b/\u{e9}.csv", ".hidden", "ab:c", "...", "a..b"]
        {
            assert_eq!(check_path(path), Ok(()), "{path}");
        }
        for path in [
            "", "/a", "../a", "a/../b", "a//b", "a/", "./a", "a/.", "a\\b", "C:a", "c:/a", "a\0b", "a\nb", "aux.txt",
            "a/NUL", "lpt1/x", "\u{9b}a",
        ] {
            assert!(check_path(path).is_err(), "{path:?}");
        }
        assert!(check_path(&"a".repeat(256)).is_err() && check_path(&"a/".repeat(3000)).is_err());
    }

    /// Deterministic generator of hostile strings, composed of parts that file systems interpret.
    fn hostile(seed: u64) -> String {
        const PIECES: [&str; 28] = [
            "..",
            ".",
            "/",
            "//",
            "\\",
            "a",
            "B9",
            "_",
            "-",
            " ",
            "\0",
            "\n",
            "\u{1b}",
            "\u{202e}",
            "C:",
            "con",
            "NUL.txt",
            "~",
            "%2e%2e",
            "\u{ff0e}\u{ff0e}",
            "file:",
            "s3://",
            "$HOME",
            "*",
            "\u{e9}",
            "tables",
            "\u{9b}",
            "com1",
        ];
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state
        };
        let parts = next() % 7;
        let piece = |n: u64| usize::try_from(n % PIECES.len() as u64).ok().and_then(|i| PIECES.get(i)).copied();
        (0..parts).filter_map(|_| piece(next())).collect()
    }

    #[test]
    fn unit_an_accepted_name_stays_in_its_folder() {
        let root = Path::new("/store/versions");
        let (mut names, mut paths) = (0, 0);
        for seed in 0..200_000 {
            let text = hostile(seed);
            let joined = root.join(&text);
            let inside = || {
                let below: PathBuf = joined.strip_prefix(root).unwrap().to_owned();
                below.components().all(|c| matches!(c, Component::Normal(_))) && below.components().count() > 0
            };
            if check_name(&text).is_ok() {
                names += 1;
                assert!(inside() && joined.components().count() == root.components().count() + 1, "{text:?}");
            }
            if check_path(&text).is_ok() {
                paths += 1;
                assert!(inside() && !text.contains(['\0', '\\', '\n']), "{text:?}");
            }
        }
        assert!(names > 100 && paths > 1000, "{names} {paths}: the generator reaches both answers");
    }

    #[cfg(unix)]
    #[test]
    fn unit_only_regular_files_are_opened_and_links_are_rejected() {
        let folder = std::env::temp_dir().join(format!("magline-paths-{}", std::process::id()));
        fs::create_dir_all(folder.join("in")).unwrap();
        fs::write(folder.join("in/a"), "x").unwrap();
        assert_eq!(read_regular(&folder.join("in/a")).unwrap(), b"x");
        assert!(open_regular(&folder).is_err() && open_regular(Path::new("/dev/zero")).is_err());
        std::os::unix::fs::symlink("/dev/zero", folder.join("in/zero")).unwrap();
        assert!(open_regular(&folder.join("in/zero")).is_err());
        assert!(check_no_link(&folder, &folder.join("in/a")).is_ok());
        assert!(check_no_link(&folder, &folder.join("in/not/there")).is_ok());
        assert!(check_no_link(&folder, &folder.join("in/zero")).is_err());
        std::os::unix::fs::symlink("/", folder.join("out")).unwrap();
        assert!(check_no_link(&folder, &folder.join("out/etc/passwd")).is_err());
        assert!(check_no_link(&folder.join("in"), &folder).is_err());
        fs::remove_dir_all(&folder).unwrap();
    }
}
