//! The names of documents, and words that several of them have.

/// The file with the tables and facts.
pub const DICTIONARY: &str = "dictionary.json";
/// The file that says how the set was made.
pub const LOCK: &str = "pipeline/lock.json";
/// The file with the licence.
pub const LICENCE: &str = "LICENSE";

/// A path in the set as a relative address: other bytes than those that stand for themselves are spelt by `%`.
pub fn address(path: &str) -> String {
    let plain = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'.' | b'-' | b'_' | b'~' | b'/' | b'=' | b'+');
    path.bytes().map(|b| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}

/// A text as a cell of a table of Markdown.
pub fn cell(text: &str) -> String {
    text.replace('\\', "\\\\").replace('|', "\\|").split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A count with its noun.
pub fn counted(n: u64, thing: &str) -> String {
    format!("{n} {thing}{}", if n == 1 { "" } else { "s" })
}
