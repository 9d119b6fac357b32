//! Drawing of the crates and their dependencies in `STRUCTURE.md`, derived from the manifests.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
};

use crate::support::repository;

/// Folders of the crates that a crate depends on, by its folder.
type CrateUses = BTreeMap<String, BTreeSet<String>>;

fn manifest(folder: &str) -> toml::Table {
    fs::read_to_string(repository().join(folder).join("Cargo.toml")).unwrap().parse().unwrap()
}

/// Dependencies between the crates of the workspace, without those of their tests.
fn dependencies() -> CrateUses {
    let root = manifest("");
    let known = root["workspace"]["dependencies"].as_table().unwrap();
    let mut found = CrateUses::new();
    for member in root["workspace"]["members"].as_array().unwrap() {
        let folder = member.as_str().unwrap();
        let manifest = manifest(folder);
        let names = manifest.get("dependencies").and_then(toml::Value::as_table).into_iter().flat_map(|t| t.keys());
        let folders = names.filter_map(|name| known.get(name)?.get("path")?.as_str());
        found.insert(folder.to_owned(), folders.map(str::to_owned).collect());
    }
    found
}

/// Crates that a crate depends on, directly or not.
fn reached(uses: &CrateUses, from: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut open = vec![from];
    while let Some(next) = open.pop() {
        open.extend(uses[next].iter().filter(|used| found.insert((*used).clone())).map(String::as_str));
    }
    found
}

/// Mermaid text of a graph. An arrow that follows from two others is omitted.
fn drawing(uses: &CrateUses) -> String {
    let id = |folder: &str| folder.replace('/', "_");
    let mut text = "```mermaid\ngraph TD\n".to_owned();
    for folder in uses.keys() {
        text += &format!("    {}[\"{folder}\"]\n", id(folder));
    }
    for (from, used) in uses {
        let implied: BTreeSet<String> = used.iter().flat_map(|via| reached(uses, via)).collect();
        for to in used.difference(&implied) {
            text += &format!("    {} --> {}\n", id(from), id(to));
        }
    }
    text + "```\n"
}

#[test]
fn gold_the_drawing_of_the_crates_is_current() {
    let drawing = drawing(&dependencies());
    let kept = include_str!("STRUCTURE.md");
    assert!(kept.contains(&drawing), "the dependencies have changed: write into tests/STRUCTURE.md\n{drawing}");
}

#[test]
fn unit_implied_arrows_are_omitted() {
    let crates = [("a", &["b", "c/d"][..]), ("b", &["c/d"]), ("c/d", &[])];
    let set = |used: &[&str]| used.iter().map(|name| (*name).to_owned()).collect();
    let uses: CrateUses = crates.iter().map(|(name, used)| ((*name).to_owned(), set(used))).collect();
    let expected =
        "```mermaid\ngraph TD\n    a[\"a\"]\n    b[\"b\"]\n    c_d[\"c/d\"]\n    a --> b\n    b --> c_d\n```\n";
    assert_eq!(drawing(&uses), expected);
}
