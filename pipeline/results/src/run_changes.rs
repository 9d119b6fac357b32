//! Changes of the program, the inputs and the parameters between two runs of a pipeline.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
};

use serde::Serialize;

use super::record::{Snapshot, SnapshotSource, SnapshotTable};

/// Maximum number of listed lines or columns of one table.
const MOST: usize = 50;
/// Maximum number of characters of a value.
const LONGEST: usize = 200;
/// Number of characters that are shown of a data key.
const KEY: usize = 8;

/// Kind of a change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ChangeKind {
    /// Version of a stage.
    Version,
    /// Data of a table of files.
    Input,
    /// Table, its inputs, axes, points or columns.
    Table,
    /// Parameter, seed or restriction of rows.
    Parameter,
}

/// Change between two runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RunChange {
    /// Kind.
    pub kind: ChangeKind,
    /// Table; empty for the whole pipeline.
    pub table: String,
    /// Name of the changed part; empty for the table itself.
    pub what: String,
    /// Value in the first run; `None` if absent.
    pub before: Option<String>,
    /// Value in the second run; `None` if absent.
    pub after: Option<String>,
    /// Number of points with this change; 0 for a change of the whole table.
    pub points: usize,
}

impl fmt::Display for RunChange {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let RunChange { table, what, before, after, points, .. } = self;
        match (what.is_empty(), before, after) {
            (true, None, _) => return write!(f, "table `{table}` was added"),
            (true, _, None) => return write!(f, "table `{table}` was removed"),
            _ => {}
        }
        if !table.is_empty() {
            write!(f, "{table}: ")?;
        }
        let word = |value: &Option<String>| value.clone().unwrap_or_else(|| "(absent)".to_owned());
        write!(f, "{what}: {} -> {}", word(before), word(after))?;
        match points {
            0 => Ok(()),
            1 => write!(f, " at 1 point"),
            n => write!(f, " at {n} points"),
        }
    }
}

/// All changes from the run `one` to the run `other`: of the pipeline, then of its sources, then of its tables.
pub fn changes(one: &Snapshot, other: &Snapshot) -> Vec<RunChange> {
    let mut found = ChangeList(vec![]);
    found.add(ChangeKind::Parameter, "", "seed", Some(one.seed.to_string()), Some(other.seed.to_string()));
    for (name, pair) in paired(&one.sources, &other.sources, |s| &s.name) {
        match pair {
            (Some(a), Some(b)) => found.source(a, b),
            (a, b) => found.table(ChangeKind::Input, name, a.map(|s| &s.kind), b.map(|s| &s.kind)),
        }
    }
    for (name, pair) in paired(&one.tables, &other.tables, |t| &t.name) {
        match pair {
            (Some(a), Some(b)) => found.stage(a, b),
            (a, b) => found.table(ChangeKind::Table, name, a.map(|t| &t.stage), b.map(|t| &t.stage)),
        }
    }
    found.0
}

/// Lines whose data differ between two runs, as `flight/line`.
pub fn changed_lines(one: &Snapshot, other: &Snapshot) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for (_, pair) in paired(&one.sources, &other.sources, |s| &s.name) {
        let (Some(a), Some(b)) = pair else { continue };
        if a.kind == "flights" {
            let differs = |(line, key): &(&String, &String)| b.lines.get(*line).is_some_and(|other| other != *key);
            found.extend(a.lines.iter().filter(differs).map(|(line, _)| line.clone()));
        }
    }
    found
}

/// Entry of the first run and entry of the second run; at least one of them exists.
type EntryPair<'a, T> = (Option<&'a T>, Option<&'a T>);

/// Entries of equal names, in the order of `one`, then the entries that only `other` has.
fn paired<'a, T>(one: &'a [T], other: &'a [T], name: fn(&T) -> &String) -> Vec<(&'a str, EntryPair<'a, T>)> {
    let find = |all: &'a [T], wanted: &str| all.iter().find(|x| name(x) == wanted);
    let first = one.iter().map(|a| (name(a).as_str(), (Some(a), find(other, name(a)))));
    let rest = other.iter().filter(|b| find(one, name(b)).is_none()).map(|b| (name(b).as_str(), (None, Some(b))));
    first.chain(rest).collect()
}

struct ChangeList(Vec<RunChange>);

impl ChangeList {
    fn push(&mut self, change: RunChange) {
        let cut = |text: String| match text.char_indices().nth(LONGEST) {
            Some((at, _)) => format!("{}…", &text[..at]),
            None => text,
        };
        self.0.push(RunChange { before: change.before.map(cut), after: change.after.map(cut), ..change });
    }

    /// Adds a change if the values differ.
    fn add(&mut self, kind: ChangeKind, table: &str, what: &str, before: Option<String>, after: Option<String>) {
        if before != after {
            let (table, what) = (table.to_owned(), what.to_owned());
            self.push(RunChange { kind, table, what, before, after, points: 0 });
        }
    }

    /// Adds a table that only one run has.
    fn table(&mut self, kind: ChangeKind, name: &str, before: Option<&String>, after: Option<&String>) {
        self.add(kind, name, "", before.cloned(), after.cloned());
    }

    /// Adds the differences of named values, at most [`MOST`].
    fn named(
        &mut self,
        (kind, table, word): (ChangeKind, &str, &str),
        one: &BTreeMap<String, String>,
        other: &BTreeMap<String, String>,
    ) {
        let names: BTreeSet<&String> = one.keys().chain(other.keys()).collect();
        let differing: Vec<&String> = names.into_iter().filter(|name| one.get(*name) != other.get(*name)).collect();
        for name in differing.iter().take(MOST) {
            let what = format!("{word} `{name}`");
            self.add(kind, table, &what, one.get(*name).cloned(), other.get(*name).cloned());
        }
        if differing.len() > MOST {
            let rest = format!("{} more", differing.len() - MOST);
            self.add(kind, table, word, None, Some(rest));
        }
    }

    fn source(&mut self, one: &SnapshotSource, other: &SnapshotSource) {
        let short = |(line, key): (&String, &String)| (line.clone(), key.chars().take(KEY).collect());
        let lines = |s: &SnapshotSource| -> BTreeMap<String, String> { s.lines.iter().map(short).collect() };
        let word = if one.kind == "flights" { "data of line" } else { "data of" };
        self.named((ChangeKind::Input, &one.name, word), &lines(one), &lines(other));
    }

    fn stage(&mut self, one: &SnapshotTable, other: &SnapshotTable) {
        let (name, versions) = (&one.name, |t: &SnapshotTable| Some(format!("{} v{}", t.stage, t.version)));
        if one.stage == other.stage {
            self.add(ChangeKind::Version, name, "stage", versions(one), versions(other));
        } else {
            self.add(ChangeKind::Table, name, "stage", versions(one), versions(other));
        }
        self.add(ChangeKind::Parameter, name, "where", one.predicate.clone(), other.predicate.clone());
        let list = |all: &[String]| Some(all.join(", "));
        self.add(ChangeKind::Table, name, "inputs", list(&one.inputs), list(&other.inputs));
        self.add(ChangeKind::Table, name, "axes", list(&one.axes), list(&other.axes));
        let count = |n: usize| Some(n.to_string());
        self.add(ChangeKind::Input, name, "number of lines", count(one.lines), count(other.lines));
        self.add(ChangeKind::Table, name, "number of points", count(one.points.len()), count(other.points.len()));
        self.parameters(one, other);
        let columns = |t: &SnapshotTable| -> BTreeMap<String, String> {
            let about =
                |unit: &str, kind: &str| if unit.is_empty() { kind.to_owned() } else { format!("{kind}, {unit}") };
            t.columns.iter().map(|c| (c.name.clone(), about(&c.unit, &c.kind))).collect()
        };
        self.named((ChangeKind::Table, name, "column"), &columns(one), &columns(other));
    }

    /// Adds the parameters that differ at points of both runs.
    fn parameters(&mut self, one: &SnapshotTable, other: &SnapshotTable) {
        // For 100,000 equal points, this avoids building a list of them.
        if one.points == other.points {
            return;
        }
        let known: BTreeMap<BTreeMap<String, String>, BTreeMap<String, String>> = other.points.iter().collect();
        let mut groups: Vec<(String, Option<String>, Option<String>)> = vec![];
        let mut counts: BTreeMap<(String, Option<String>, Option<String>), usize> = BTreeMap::new();
        for (point, before) in one.points.iter() {
            let Some(after) = known.get(&point) else { continue };
            let keys: BTreeSet<&String> = before.keys().chain(after.keys()).collect();
            for key in keys.into_iter().filter(|key| before.get(*key) != after.get(*key)) {
                let group = (key.clone(), before.get(key).cloned(), after.get(key).cloned());
                let count = counts.entry(group.clone()).or_default();
                if *count == 0 {
                    groups.push(group);
                }
                *count += 1;
            }
        }
        for group in groups {
            let points = counts.get(&group).copied().unwrap_or_default();
            let (what, before, after) = group;
            let table = one.name.clone();
            self.push(RunChange { kind: ChangeKind::Parameter, table, what, before, after, points });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(name: &str, version: u32, points: &[(&str, &str)]) -> SnapshotTable {
        let one = |(key, value): (&str, &str)| BTreeMap::from([(key.to_owned(), value.to_owned())]);
        SnapshotTable {
            name: name.to_owned(),
            stage: "fit".to_owned(),
            version,
            tidy: true,
            axes: vec!["lambda".to_owned()],
            inputs: vec!["terms".to_owned()],
            predicate: None,
            points: points.iter().map(|(point, trim)| (one(("lambda", point)), one(("trim", trim)))).collect(),
            columns: vec![],
            lines: 2,
            cost: Some((1, 2.0)),
        }
    }

    fn snapshot(seed: u64, lines: &[(&str, &str)], tables: Vec<SnapshotTable>) -> Snapshot {
        let source = SnapshotSource {
            name: "flights".to_owned(),
            kind: "flights".to_owned(),
            files: vec![],
            lines: lines.iter().map(|(line, key)| ((*line).to_owned(), (*key).to_owned())).collect(),
            restricted: vec![],
        };
        let (pipeline, spec) = ("p".to_owned(), "p.toml".to_owned());
        Snapshot { pipeline, spec, made_by: None, seed, sources: vec![source], tables }
    }

    #[test]
    fn unit_changes_of_points_are_counted() {
        let lines = [("1/a", "0123456789"), ("1/b", "11111111")];
        let one = snapshot(1, &lines, vec![table("fit", 1, &[("0", "20"), ("1", "20"), ("2", "20")])]);
        assert_eq!(changes(&one, &one), []);
        let mut other = snapshot(2, &[("1/a", "9876543210"), ("1/c", "22222222")], vec![]);
        other.tables = vec![table("fit", 2, &[("0", "30"), ("1", "30"), ("3", "30")]), table("more", 1, &[])];
        let said: Vec<String> = changes(&one, &other).iter().map(ToString::to_string).collect();
        let wanted = [
            "seed: 1 -> 2",
            "flights: data of line `1/a`: 01234567 -> 98765432",
            "flights: data of line `1/b`: 11111111 -> (absent)",
            "flights: data of line `1/c`: (absent) -> 22222222",
            "fit: stage: fit v1 -> fit v2",
            "fit: trim: 20 -> 30 at 2 points",
            "table `more` was added",
        ];
        assert_eq!(said, wanted);
        assert_eq!(changed_lines(&one, &other), BTreeSet::from(["1/a".to_owned()]));
    }

    #[test]
    fn unit_long_lists_and_values_are_cut() {
        let names: Vec<String> = (0..60).map(|i| format!("1/{i:02}")).collect();
        let of = |key: &'static str| names.iter().map(|n| (n.as_str(), key)).collect::<Vec<_>>();
        let (one, mut other) = (snapshot(1, &of("a"), vec![]), snapshot(1, &of("b"), vec![]));
        other.tables = vec![table("t", 1, &[])];
        other.tables[0].stage = "é".repeat(300);
        let found = changes(&one, &other);
        assert_eq!(found.len(), MOST + 2);
        assert_eq!(found[MOST].to_string(), "flights: data of line: (absent) -> 10 more");
        assert_eq!(found[MOST + 1].after.as_ref().map(|text| text.chars().count()), Some(LONGEST + 1));
    }
}
