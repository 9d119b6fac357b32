//! The inputs of the tables, stored together with the tables.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use buckets::cache;
use plan::{
    IN_SAMPLE, Plan, PlanGraph, StageInstance, TableNode, TableRef,
    spec::{Spec, publish::ColumnRestriction},
};
use schemas::{ColumnType, Fault, keys::HashKey, paths};
use serde::{Deserialize, Serialize};
use store::{Store, note, pipeline_name};

use crate::{points::SnapshotPoints, pooled};

/// A pipeline at its last run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Snapshot {
    /// Name.
    pub pipeline: String,
    /// The path of the spec, as the user gave it.
    pub spec: String,
    /// The full path of the spec, and the hash of its text: see [`made_by_another`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub made_by: Option<(String, String)>,
    /// The seed.
    pub seed: u64,
    /// Sources.
    pub sources: Vec<SnapshotSource>,
    /// Tables.
    pub tables: Vec<SnapshotTable>,
}

/// A table that was read from files.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SnapshotSource {
    /// Name.
    pub name: String,
    /// `flights`, `map` or `model`.
    pub kind: String,
    /// Path and hash of each file.
    pub files: Vec<(String, String)>,
    /// The key of each line (`flight/line`), or of the map.
    pub lines: BTreeMap<String, String>,
    /// The columns that were restricted; `*` means all columns.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub restricted: Vec<String>,
}

/// A table that a stage made.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SnapshotTable {
    /// Name.
    pub name: String,
    /// The stage.
    pub stage: String,
    /// The stage's version.
    pub version: u32,
    /// Whether the table is one small file.
    pub tidy: bool,
    /// The axes that the table depends on.
    pub axes: Vec<String>,
    /// Input tables.
    pub inputs: Vec<String>,
    /// Restriction of rows.
    pub predicate: Option<String>,
    /// The points, each with its axis values and its parameters.
    pub points: SnapshotPoints,
    /// Columns.
    pub columns: Vec<SnapshotColumn>,
    /// The lines that the table contains.
    pub lines: usize,
    /// Number of units computed in the last measured run, and the duration of their computation, in seconds.
    pub cost: Option<(usize, f64)>,
}

/// A column and its inputs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SnapshotColumn {
    /// Name.
    pub name: String,
    /// Type in a word.
    pub kind: String,
    /// Unit.
    pub unit: String,
    /// Description.
    pub doc: String,
    /// Table and name of each column from which this column was computed. For a column that passed through, this is the
    /// column of the same name.
    pub from: Vec<(String, String)>,
}

/// Stores the inputs of a run's tables. The tables in `left` keep their description from the previous run.
///
/// # Errors
/// Fails if the store cannot be written.
pub fn record(graph: &PlanGraph, store: &Store, costs: &[(usize, f64)], left: &[usize]) -> Result<Snapshot, Fault> {
    let plan = graph.plan;
    let before = snapshots(store.root()).into_iter().find(|s| s.pipeline == plan.spec.name);
    let flights = plan.flights.iter().enumerate().map(|(i, f)| SnapshotSource {
        name: f.name.clone(),
        kind: "flights".to_owned(),
        files: files(graph, i),
        lines: graph.records[i].values().map(|l| (format!("{}/{}", l.flight, l.line), l.object.to_string())).collect(),
        restricted: restricted(&plan.spec, &f.name),
    });
    let maps = plan.maps.iter().enumerate().map(|(i, m)| SnapshotSource {
        name: m.name.clone(),
        kind: m.word().to_owned(),
        files: files(graph, plan.flights.len() + i),
        lines: [("map".to_owned(), graph.maps[i].to_string())].into(),
        restricted: restricted(&plan.spec, &m.name),
    });
    let sources = flights.chain(maps).collect();
    let tables = plan.tables.iter().enumerate().filter_map(|(t, node)| {
        let cost = costs.get(t).copied().filter(|(units, _)| *units > 0);
        let old = before.as_ref().and_then(|b| b.tables.iter().find(|x| x.name == node.name));
        if left.contains(&t) {
            return old.cloned();
        }
        Some(table(graph.plan, t, node, cost.or(old.and_then(|x| x.cost)), graph.all_lines_of(t).len()))
    });
    let tables: Vec<SnapshotTable> = tables.chain(pooled_scores(plan)).collect();
    let (pipeline, spec) = (plan.spec.name.clone(), plan.spec.file.clone());
    let made_by = made_by(&plan.spec);
    let snapshot = Snapshot { pipeline, spec, made_by, seed: plan.spec.seed, sources, tables };
    let text = note::sealed(&snapshot)?;
    let file = store.root().join("plans").join(format!("{}.json", plan.spec.name));
    if paths::read_regular(&file).ok().as_ref() != Some(&text) {
        store.write(&file, &text)?;
    }
    Ok(snapshot)
}

/// The tables of a plan with their columns, and the inputs of these columns.
pub fn described(graph: &PlanGraph) -> Vec<SnapshotTable> {
    graph
        .plan
        .tables
        .iter()
        .enumerate()
        .map(|(t, node)| table(graph.plan, t, node, None, graph.all_lines_of(t).len()))
        .collect()
}

/// The table of pooled scores, if the plan has scores.
fn pooled_scores(plan: &Plan) -> Option<SnapshotTable> {
    let scores: Vec<&TableNode> = pooled::tables(plan).map(|t| &plan.tables[t]).collect();
    let inputs: Vec<String> = scores.iter().map(|node| node.name.clone()).collect();
    let column = |(name, doc): &(&str, &str)| {
        let (kind, made_of) = pooled::made_of(name);
        let from = inputs.iter().flat_map(|table| made_of.iter().map(|c| (table.clone(), (*c).to_owned())));
        let (name, kind, doc) = ((*name).to_owned(), kind.to_owned(), (*doc).to_owned());
        SnapshotColumn { name, kind, unit: String::new(), doc, from: from.collect() }
    };
    let axes = plan.spec.axes.iter().enumerate();
    let axes = axes.filter(|(i, _)| scores.iter().any(|node| node.axes.contains(i))).map(|(_, a)| a.name.clone());
    (!scores.is_empty()).then(|| SnapshotTable {
        name: pooled::TABLE.to_owned(),
        stage: "pooling of scores".to_owned(),
        version: 1,
        tidy: true,
        axes: axes.collect(),
        columns: pooled::COLUMNS.iter().map(column).collect(),
        inputs: inputs.clone(),
        predicate: None,
        points: SnapshotPoints::default(),
        lines: 0,
        cost: None,
    })
}

fn files(graph: &PlanGraph, i: usize) -> Vec<(String, String)> {
    graph.bytes[i].iter().map(|b| (cache::shown(&b.path), b.hash.to_string())).collect()
}

fn table(plan: &Plan, t: usize, node: &TableNode, cost: Option<(usize, f64)>, lines: usize) -> SnapshotTable {
    let points = plan.instances(t).map(|i| {
        let point = i.point().iter().map(|(k, v)| (k.clone(), v.to_string())).collect();
        (point, i.params().into_iter().map(|(k, v)| (k.to_owned(), v)).collect())
    });
    let inputs: Vec<String> = node.sources().into_iter().map(|r| plan.name_of(r).to_owned()).collect();
    SnapshotTable {
        name: node.name.clone(),
        stage: node.entry.name.to_owned(),
        version: node.entry.version,
        tidy: node.is_small(),
        axes: node.axes.iter().map(|i| plan.spec.axes[*i].name.clone()).collect(),
        inputs,
        predicate: plan.decl(t).and_then(|d| d.predicate.clone()).map(|(text, _)| text),
        points: points.collect(),
        columns: columns(plan, t, node),
        lines,
        cost,
    }
}

/// The columns of a table of a plan, with their inputs.
pub fn columns(plan: &Plan, t: usize, node: &TableNode) -> Vec<SnapshotColumn> {
    let examples: Vec<StageInstance> = node.examples(&plan.spec).map(|i| plan.instance(t, i)).collect();
    let described = node.columns().into_iter().map(|c| {
        let mut from: Vec<(String, String)> = vec![];
        for it in &examples {
            for pair in made_from(plan, it, &c.name) {
                if !from.contains(&pair) {
                    from.push(pair);
                }
            }
        }
        let kind = match &c.column_type {
            ColumnType::List(terms) => format!("list of {}", terms.len()),
            other => other.data_type().to_string(),
        };
        SnapshotColumn { name: c.name, kind, unit: c.unit, doc: c.doc, from }
    });
    let in_sample = node.in_sample_meaning().map(|meaning| SnapshotColumn {
        name: IN_SAMPLE.to_owned(),
        kind: "Boolean".to_owned(),
        unit: String::new(),
        doc: meaning.to_owned(),
        from: vec![],
    });
    described.chain(in_sample).collect()
}

fn made_from(plan: &Plan, it: &StageInstance, name: &str) -> Vec<(String, String)> {
    let named = |r: &TableRef, c: &str| (plan.name_of(*r).to_owned(), c.to_owned());
    let inputs = it.inputs();
    match it.makes(name) {
        Some(c) => c.from.iter().filter_map(|(i, c)| inputs.get(*i).map(|r| named(r, c))).collect(),
        None if it.table.shape().get(name).is_some() => inputs.first().map(|r| named(r, name)).into_iter().collect(),
        None => vec![],
    }
}

/// Columns of a table of files whose restriction applies today; `*` means all columns.
fn restricted(spec: &Spec, table: &str) -> Vec<String> {
    match spec.tables.iter().find(|t| t.name == table).map(|t| t.protection.now()) {
        None | Some(ColumnRestriction::None) => vec![],
        Some(ColumnRestriction::All) => vec!["*".to_owned()],
        Some(ColumnRestriction::Columns(names)) => names,
    }
}

/// Columns of this plan's files that an earlier run recorded as restricted, and that are no longer restricted.
pub fn lifted(graph: &PlanGraph, store: &Store) -> Vec<String> {
    let plan = graph.plan;
    let names = plan.flights.iter().map(|f| &f.name).chain(plan.maps.iter().map(|m| &m.name));
    let now: Vec<(&String, Vec<(String, String)>)> =
        names.enumerate().map(|(i, name)| (name, files(graph, i))).collect();
    let folders = ["runs", "plans"].map(|folder| store.root().join(folder));
    let notes = folders.iter().flat_map(|folder| fs::read_dir(folder).into_iter().flatten().flatten());
    let notes = notes.map(|e| e.path()).filter(|path| path.extension().is_some_and(|e| e == "json"));
    let read = |path: PathBuf| serde_json::from_slice::<Snapshot>(&paths::read_regular(&path).ok()?).ok();
    let mut found = vec![];
    for before in notes.filter_map(read).flat_map(|snapshot| snapshot.sources).filter(|s| !s.restricted.is_empty()) {
        let same =
            |files: &[(String, String)]| files.iter().any(|(_, hash)| before.files.iter().any(|(_, h)| h == hash));
        for (name, _) in now.iter().filter(|(_, files)| same(files)) {
            let still = restricted(&plan.spec, name);
            let gone = before.restricted.iter().filter(|c| !still.contains(c) && !still.iter().any(|c| c == "*"));
            found.extend(gone.map(|column| format!("{name}.{column}")));
        }
    }
    found.sort();
    found.dedup();
    found
}

/// The full path of a spec, and the hash of its text; `None` if the spec is not a file.
fn made_by(spec: &Spec) -> Option<(String, String)> {
    let path = fs::canonicalize(&spec.file).ok()?;
    Some((path.to_string_lossy().into_owned(), HashKey::from_parts([&spec.text]).to_string()))
}

/// The spec that made the tables of this pipeline in the store, if this is not `spec` and the store is outside the
/// folder of `spec`: `spec` must not replace these tables by accident. `None` if `--set` names the store.
pub fn made_by_another(spec: &Spec) -> Option<String> {
    let named = spec.sets.iter().any(|set| set.trim_start().starts_with("store"));
    let inside = match (fs::canonicalize(&spec.folder), fs::canonicalize(&spec.store)) {
        (Ok(folder), Ok(store)) => store.starts_with(folder),
        // There is no store yet.
        (_, Err(_)) => true,
        (Err(_), Ok(_)) => false,
    };
    if named || inside || spec.store_at.is_some() {
        return None;
    }
    let there = snapshots(&spec.store).into_iter().find(|s| s.pipeline == spec.name)?;
    let (path, hash) = there.made_by?;
    let own = made_by(spec);
    let same = own.is_some_and(|(own_path, own_hash)| own_path == path || own_hash == hash);
    (!same).then_some(path)
}

/// All pipelines that were run in the store at `root`, by name.
pub fn snapshots(root: &Path) -> Vec<Snapshot> {
    let mut found: Vec<Snapshot> = fs::read_dir(root.join("plans"))
        .into_iter()
        .flatten()
        .flatten()
        .map(|e| e.path())
        .filter(|path| path.extension().is_some_and(|e| e == "json"))
        .filter_map(|path| {
            let found: Snapshot = serde_json::from_slice(&paths::read_regular(&path).ok()?).ok()?;
            let own = path.file_stem().and_then(|name| name.to_str()) == Some(found.pipeline.as_str());
            (own && pipeline_name(&found.pipeline).is_ok()).then_some(found)
        })
        .collect();
    found.sort_by(|a, b| a.pipeline.cmp(&b.pipeline));
    found
}
