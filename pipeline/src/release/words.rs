//! Names of documents, and phrases that several of them share.

use std::{fmt::Display, path::Path};

use schemas::Fault;

/// File with the tables and facts.
pub const DICTIONARY: &str = "dictionary.json";
/// File with the provenance of the set.
pub const LOCK: &str = "pipeline/lock.json";
/// File with the licence.
pub const LICENCE: &str = "LICENSE";

/// Path in the set as a relative URL, with special bytes escaped by `%`.
pub fn address(path: &str) -> String {
    let plain = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'-' | b'_' | b'~' | b'/' | b'=' | b'+');
    path.bytes().map(|b| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}

/// Text as a cell of a Markdown table.
pub fn cell(text: &str) -> String {
    text.replace('\\', "\\\\").replace('|', "\\|").split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Count with its noun.
pub fn counted<N: Display + PartialEq + From<u8>>(n: N, thing: &str) -> String {
    format!("{n} {thing}{}", if n == N::from(1) { "" } else { "s" })
}

/// Fault of the file system at `path`.
pub fn cannot(doing: &str, path: &Path, e: &dyn Display) -> Fault {
    Fault::machine(format!("cannot {doing} {}: {e}", path.display()))
}
