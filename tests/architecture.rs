//! Structure of the source: sizes of crates, cycles of files that use each other, widths of lines, forms of modules.
//!
//! The tests print the rows of the table in `STRUCTURE.md`.
//!
//! A file uses another file if it names an item of that file by a path from `crate`, `self` or `super`. Test modules do
//! not count, and the root of a crate is excluded, because it re-exports items.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Display,
    fs,
    path::{Path, PathBuf},
};

use crate::{support::repository, words::files};

/// Maximum number of files that use each other in a circle.
const LARGEST_CIRCLE: usize = 7;
/// Maximum number of lines of a crate below `pipeline`, without tests.
const LARGEST_CRATE: usize = 13_000;
/// Maximum width of a line, in columns.
const WIDEST_LINE: usize = 120;
/// Languages whose lines are measured.
const MEASURED: [&str; 5] = [".rs", ".py", ".js", ".css", ".sh"];

/// Prints a row of the table in `STRUCTURE.md`.
pub fn print_row(measure: &str, found: impl Display, limit: impl Display) {
    println!("| {measure} | {found} | {limit} |");
}

/// Path of a module from the root of its crate.
type ModulePath = Vec<String>;

/// Modules of a crate with their sources.
struct CrateSource {
    name: String,
    modules: BTreeMap<ModulePath, String>,
}

/// The `src` folders of the workspace, without fuzz targets and separate workspaces.
fn crates() -> Vec<CrateSource> {
    let text = fs::read_to_string(repository().join("Cargo.toml")).unwrap();
    let table: toml::Table = text.parse().unwrap();
    let members = table["workspace"]["members"].as_array().unwrap();
    let one = |member: &toml::Value| {
        let name = member.as_str().unwrap().to_owned();
        let root = repository().join(&name).join("src");
        let mut modules = BTreeMap::new();
        read_modules(&root, &root, &mut modules);
        CrateSource { name, modules }
    };
    members.iter().map(one).collect()
}

fn read_modules(root: &Path, folder: &Path, modules: &mut BTreeMap<ModulePath, String>) {
    let mut entries: Vec<PathBuf> = fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            read_modules(root, &path, modules);
        } else if path.extension().is_some_and(|e| e == "rs") && !path.to_string_lossy().contains("tests") {
            let relative = path.strip_prefix(root).unwrap().with_extension("");
            let mut module: ModulePath =
                relative.components().map(|c| c.as_os_str().to_string_lossy().into_owned()).collect();
            if module.last().is_some_and(|last| ["mod", "lib", "main"].contains(&last.as_str())) {
                module.pop();
            }
            let text = fs::read_to_string(&path).unwrap();
            let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
            let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
            modules.insert(module, code.collect::<Vec<_>>().join("\n"));
        }
    }
}

/// Paths that begin with `crate`, `self` or `super` in `code`; a `use` of several items gives one path for each item.
fn paths(code: &str) -> Vec<String> {
    let mut found = vec![];
    for start in ["crate::", "super::", "self::"] {
        for (at, _) in code.match_indices(start) {
            let before = code[..at].chars().next_back();
            if before.is_some_and(|c| c.is_alphanumeric() || "_:$".contains(c)) {
                continue;
            }
            expand("", &code[at..], &mut found);
        }
    }
    found
}

/// Adds the paths of a use tree at the start of `text` to `found`, each after `prefix`; returns the unread text.
fn expand<'a>(prefix: &str, text: &'a str, found: &mut Vec<String>) -> &'a str {
    let text = text.trim_start();
    let end = text.find(|c: char| !(c.is_alphanumeric() || "_:".contains(c))).unwrap_or(text.len());
    let path = format!("{prefix}{}", &text[..end]);
    let rest = &text[end..];
    if !path.ends_with("::") || !rest.starts_with('{') {
        found.push(path);
        return rest;
    }
    let mut rest = &rest[1..];
    loop {
        rest = rest.trim_start();
        if let Some(after) = rest.strip_prefix('}') {
            return after;
        }
        let before = rest.len();
        rest = expand(&path, rest, found);
        // The rest of an item: `as NAME`, a comma.
        rest = rest.find([',', '}']).map_or("", |at| &rest[at..]);
        rest = rest.strip_prefix(',').unwrap_or(rest);
        if rest.len() == before || rest.is_empty() {
            return rest;
        }
    }
}

/// Modules that each module uses.
fn uses(source: &CrateSource) -> BTreeMap<ModulePath, BTreeSet<ModulePath>> {
    let of = |(module, code): (&ModulePath, &String)| {
        let mut used = BTreeSet::new();
        for path in paths(code) {
            let mut at: ModulePath = module.clone();
            let mut names = path.split("::").filter(|name| !name.is_empty()).peekable();
            match names.next() {
                Some("crate") => at.clear(),
                Some("super") => drop(at.pop()),
                _ => {}
            }
            while names.next_if_eq(&"super").is_some() {
                at.pop();
            }
            at.extend(names.filter(|name| *name != "self").map(str::to_owned));
            while !at.is_empty() && !source.modules.contains_key(&at) {
                at.pop();
            }
            if !at.is_empty() && at != *module {
                used.insert(at);
            }
        }
        (module.clone(), used)
    };
    source.modules.iter().map(of).collect()
}

/// Modules that can be reached from `start`.
fn reached<'a>(
    uses: &'a BTreeMap<ModulePath, BTreeSet<ModulePath>>,
    start: &'a ModulePath,
) -> BTreeSet<&'a ModulePath> {
    let mut found = BTreeSet::new();
    let mut open = vec![start];
    while let Some(next) = open.pop() {
        open.extend(uses.get(next).into_iter().flatten().filter(|module| found.insert(*module)));
    }
    found
}

/// The largest set of modules of a crate that all use each other, directly or not.
fn largest_circle(source: &CrateSource) -> Vec<String> {
    let uses = uses(source);
    let all: BTreeMap<&ModulePath, BTreeSet<&ModulePath>> =
        uses.keys().filter(|module| !module.is_empty()).map(|module| (module, reached(&uses, module))).collect();
    let circle = |module: &&ModulePath| -> Vec<String> {
        let members = all[*module].iter().filter(|other| all.get(**other).is_some_and(|back| back.contains(*module)));
        members.map(|path| path.join("::")).collect()
    };
    all.keys().map(circle).max_by_key(Vec::len).unwrap_or_default()
}

#[test]
fn user_no_circle_of_files_is_large() {
    let circles: Vec<(String, Vec<String>)> = crates().iter().map(|c| (c.name.clone(), largest_circle(c))).collect();
    for (name, circle) in &circles {
        println!("{name}: {} files: {}", circle.len(), circle.join(", "));
        assert!(circle.len() <= LARGEST_CIRCLE, "{name}: {}", circle.join(", "));
    }
    let largest = circles.iter().map(|(_, circle)| circle.len()).max();
    print_row("largest circle of files", largest.unwrap(), LARGEST_CIRCLE);
    // A reader of paths that finds nothing would pass.
    assert!(circles.iter().any(|(_, circle)| circle.len() >= 4), "{circles:?}");
}

#[test]
fn user_crates_of_the_pipeline_are_small() {
    let mut largest = 0;
    for source in crates().iter().filter(|c| c.name.starts_with("pipeline") || c.name == "datasets/intake") {
        let lines: usize = source.modules.values().map(|code| code.lines().count()).sum();
        println!("{}: {lines} lines of code in {} files", source.name, source.modules.len());
        assert!(lines <= LARGEST_CRATE, "{} has {lines} lines", source.name);
        largest = largest.max(lines);
    }
    print_row("largest crate of the pipeline, lines", largest, LARGEST_CRATE);
}

#[test]
fn user_lines_are_not_wider_than_the_limit() {
    let (mut all, mut wide) = (0, vec![]);
    for (path, text) in files(&MEASURED).iter().filter(|(path, _)| !path.contains("/vendor/")) {
        for (at, line) in text.lines().enumerate() {
            all += 1;
            if line.chars().count() > WIDEST_LINE {
                wide.push(format!("{path}:{}: {line}", at + 1));
            }
        }
    }
    print_row("lines over 120 columns", wide.len(), 0);
    assert!(all > 200_000, "{all} lines");
    assert!(wide.is_empty(), "{}", wide.join("\n"));
}

/// The shared modules of integration tests and benches are in folders, because a file would be a test of its own.
#[test]
fn user_modules_have_one_form() {
    let paths = files(&[".rs"]).into_iter().map(|(path, _)| path);
    let found: Vec<String> = paths.filter(|path| path.contains("/src/") && path.ends_with("/mod.rs")).collect();
    print_row("files `mod.rs`", found.len(), 0);
    assert!(found.is_empty(), "{}: a module is `x.rs`, its parts are in `x/`", found.join(", "));
}

#[test]
fn unit_paths_of_use_trees_are_expanded() {
    let code = "use crate::{a::B, c::{self, d::E as F}};\nfn f() { super::g::h(); }";
    let mut found = paths(code);
    found.sort();
    assert_eq!(found, ["crate::a::B", "crate::c::d::E", "crate::c::self", "super::g::h"]);
}
