//! SHA-256, and the file `SHA256SUMS` in the format of `sha256sum`.

use std::{
    collections::BTreeMap,
    io::{self, Read},
    path::Path,
};

use schemas::paths;
use sha2::{Digest, Sha256};

/// Name of the file.
pub const NAME: &str = "SHA256SUMS";

/// SHA-256 of a string or bytes.
pub fn of_bytes(bytes: &[u8]) -> String {
    spelt(Sha256::digest(bytes).as_slice())
}

/// Returns the size of a file and its SHA-256. `each` receives its bytes.
///
/// # Errors
/// Fails if it cannot be read.
pub fn of_file(path: &Path, mut each: impl FnMut(&[u8])) -> io::Result<(u64, String)> {
    let (mut file, mut hasher, mut buffer, mut size) = (paths::open_regular(path)?, Sha256::new(), vec![0; 1 << 16], 0);
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok((size, spelt(hasher.finalize().as_slice()))),
            n => {
                let (read, _) = buffer.split_at(n);
                hasher.update(read);
                each(read);
                size += n as u64;
            }
        }
    }
}

fn spelt(digest: &[u8]) -> String {
    digest.iter().map(|b| format!("{b:02x}")).collect()
}

/// Text of the file: the checksum of each path.
pub fn write(sums: &BTreeMap<String, String>) -> String {
    sums.iter().map(|(path, sum)| format!("{sum}  {path}\n")).collect()
}

/// Checksum of each path, or the fault of a line.
///
/// # Errors
/// Fails for a line without a checksum and a path inside the folder, or for a duplicate path.
pub fn read(text: &str) -> Result<BTreeMap<String, String>, String> {
    let mut sums = BTreeMap::new();
    for (number, line) in text.lines().enumerate() {
        let wrong = |what: &str| format!("line {}: {what}", number + 1);
        let (sum, path) = line.split_once("  ").ok_or_else(|| wrong("a line does not have a checksum and a path"))?;
        let hex = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
        if sum.len() != 64 || !sum.bytes().all(hex) {
            return Err(wrong("a checksum is not 64 hexadecimal digits"));
        }
        if !is_inside(path) {
            return Err(wrong("a path leads outside the folder"));
        }
        if sums.insert(path.to_owned(), sum.to_owned()).is_some() {
            return Err(wrong("a path is listed twice"));
        }
    }
    if text.is_empty() || !text.ends_with('\n') {
        return Err("it is truncated".to_owned());
    }
    Ok(sums)
}

/// Whether the path of a document stays in the set.
pub fn is_inside(path: &str) -> bool {
    paths::check_path(path).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ref_sums_of_the_standard() {
        // FIPS 180-4, the examples of NIST: "abc", and the empty message.
        assert_eq!(of_bytes(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert_eq!(of_bytes(b""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    }

    #[test]
    fn unit_checksum_file_round_trips_and_other_text_is_rejected() {
        let sums: BTreeMap<String, String> =
            [("a/b c.txt", of_bytes(b"x")), ("z", of_bytes(b"y"))].map(|(p, s)| (p.to_owned(), s)).into();
        let text = write(&sums);
        assert_eq!(read(&text).unwrap(), sums);
        let sum = of_bytes(b"x");
        for wrong in [
            text.trim_end().to_owned(),
            String::new(),
            format!("{sum} a\n"),
            format!("{sum}  ../a\n"),
            format!("{sum}  /a\n"),
            format!("{sum}  a\n{sum}  a\n"),
            format!("{}  a\n", sum.to_uppercase()),
        ] {
            assert!(read(&wrong).is_err(), "{wrong}");
        }
    }
}
