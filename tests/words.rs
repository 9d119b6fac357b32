//! Wording of pages, messages and comments: phrases that readers have to read twice.
//!
//! The list is a minimum; a string without these phrases may still be unclear.

use std::{collections::BTreeMap, process::Command};

use crate::{architecture::print_row, support::repository};

/// Rejected phrases. A leading or trailing blank matches a word boundary.
const PHRASES: [&str; 20] = [
    "so many ",
    "is told",
    "are told",
    "told by",
    "what stands",
    "stands for",
    "goes on",
    "went with",
    "comes to nothing",
    "is at work",
    "without a word",
    "whatever",
    "no more than that",
    "cannot be had",
    "the former",
    "left out: ",
    "its law is",
    "rests on",
    "taken for ",
    "taken over",
];

/// Permitted occurrences: a part of the path, a part of the line, and the reason.
const ALLOWED: [(&str, &str, &str); 2] =
    [("tests/words.rs", "", "the list"), ("datasets/samples/", "", "licences and notices are quoted")];

/// Words that must not begin a doc comment.
const BEGINNINGS: [&str; 7] = ["What ", "Of ", "As ", "Whose ", "How often ", "So ", "So, "];
/// Maximum number of doc comments with such a beginning per thousand lines of comments.
const MOST_BEGINNINGS: f64 = 3.0;

/// Files of the repository with one of these extensions, and their strings.
pub fn files(endings: &[&str]) -> Vec<(String, String)> {
    let output = Command::new("git").args(["ls-files", "-z"]).current_dir(repository()).output().unwrap();
    let names = String::from_utf8(output.stdout).unwrap();
    let wanted = names.split('\0').filter(|name| endings.iter().any(|ending| name.ends_with(ending)));
    let read = |name: &str| Some((name.to_owned(), std::fs::read_to_string(repository().join(name)).ok()?));
    wanted.filter_map(read).collect()
}

/// Text visible to readers: a line of a page, a comment, or the string literals of a line of code.
fn seen(path: &str, line: &str) -> String {
    if !path.ends_with(".rs") {
        return line.to_owned();
    }
    match line.trim_start().strip_prefix("//") {
        Some(comment) => comment.to_owned(),
        None => line.split('"').skip(1).step_by(2).collect::<Vec<_>>().join("\n"),
    }
}

#[test]
fn user_pages_and_messages_avoid_unclear_phrases() {
    let mut found = vec![];
    for (path, text) in files(&[".md", ".rs"]) {
        for (at, line) in text.lines().enumerate() {
            let seen = seen(&path, line).to_lowercase();
            let phrase = PHRASES.iter().find(|phrase| seen.contains(*phrase));
            let allowed = ALLOWED.iter().any(|(file, part, _)| path.contains(file) && line.contains(part));
            if let Some(phrase) = phrase.filter(|_| !allowed) {
                found.push(format!("{path}:{}: {phrase}: {}", at + 1, line.trim()));
            }
        }
    }
    assert!(found.is_empty(), "{} lines:\n{}", found.len(), found.join("\n"));
}

#[test]
fn user_doc_comments_begin_with_a_noun_or_a_verb() {
    let (mut comments, mut found) = (0, vec![]);
    for (path, text) in files(&[".rs"]) {
        let mut before = false;
        for (at, line) in text.lines().enumerate() {
            let line = line.trim_start();
            comments += usize::from(line.starts_with("//"));
            let doc = ["/// ", "//! "].into_iter().find_map(|mark| line.strip_prefix(mark));
            let begins = doc.filter(|_| !before).is_some_and(|doc| BEGINNINGS.iter().any(|word| doc.starts_with(word)));
            if begins {
                found.push(format!("{path}:{}: {line}", at + 1));
            }
            before = doc.is_some();
        }
    }
    let rate = 1000.0 * found.len() as f64 / comments as f64;
    print_row("unclear beginnings of doc comments, per 1,000 comment lines", format!("{rate:.1}"), MOST_BEGINNINGS);
    assert!(rate < MOST_BEGINNINGS, "{rate:.1} in a thousand lines of comments:\n{}", found.join("\n"));
}

/// Maximum share of type names used by several types. Currently no name needs to be shared.
const MOST_SHARED: f64 = 0.01;

/// Name of the type that a line of code defines.
fn defined(line: &str) -> Option<&str> {
    let words = line.trim_start();
    let words = match words.strip_prefix("pub").map(str::trim_start) {
        Some(rest) => rest.strip_prefix('(').and_then(|rest| rest.split_once(") ")).map_or(rest, |(_, rest)| rest),
        None => words,
    };
    let (keyword, rest) = words.split_once(' ')?;
    // An indented alias is the associated type of a trait.
    let defines =
        matches!(keyword, "struct" | "enum" | "trait" | "union") || keyword == "type" && !line.starts_with(' ');
    let name = rest.split(|c: char| !c.is_alphanumeric() && c != '_').next()?;
    (defines && name.starts_with(char::is_uppercase)).then_some(name)
}

#[test]
fn user_a_type_name_means_one_type() {
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (path, text) in files(&[".rs"]) {
        let parts: Vec<&str> = path.split('/').collect();
        let tests = |part: &&str| matches!(*part, "tests" | "benches" | "fuzz" | "examples" | "tests.rs");
        if parts.iter().any(tests) || path.ends_with("_tests.rs") {
            continue;
        }
        let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
        for name in code.lines().filter_map(defined) {
            places.entry(name.to_owned()).or_default().push(path.clone());
        }
    }
    let all: usize = places.values().map(Vec::len).sum();
    places.retain(|_, files| files.len() > 1);
    let shared: usize = places.values().map(Vec::len).sum();
    let share = 100.0 * shared as f64 / all as f64;
    print_row("shared type names, %", format!("{share:.1}"), 100.0 * MOST_SHARED);
    assert!(all > 1500, "{all} types");
    assert!(shared as f64 <= MOST_SHARED * all as f64, "{shared} of {all}: {places:#?}");
}
