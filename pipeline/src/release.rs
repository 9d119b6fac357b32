//! `magline publish` and `magline verify DIR`: results as a data set for citation, verification and recomputation.
//!
//! ```text
//! README.md  LICENSE  CITATION.cff                description for readers
//! DICTIONARY.md  dictionary.json  schemas/        columns with units, roles and values
//! croissant.json  datapackage.json  ro-crate-metadata.json
//! data/<table>/flight_id=flight-<flight>/line_id=line-<line>/part-0.parquet, or data/<table>/part-0.parquet
//! pipeline/<spec>  pipeline/lock.json             provenance: spec, versions, keys, hashes of the inputs
//! SHA256SUMS                                      checksums of all other files
//! ```
//!
//! The same run gives the same bytes, because the set does not depend on the time, the host or the paths of the
//! machine.

mod aggregate;
mod citation;
mod croissant;
mod datapackage;
mod dictionary;
mod documents;
mod folder;
mod inputs;
mod licence;
mod parquet;
mod protect;
mod readme;
mod ro_crate;
mod set;
mod tables;
mod upload;
mod verify;
mod words;

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use arrow_array::{Array, RecordBatch, cast::AsArray};
use plan::{
    Plan, PlanGraph,
    spec::{
        Spec, SpecFaults,
        publish::{EXAMPLE, PublishFacts},
    },
};
use report::html;
use results::{described, lifted, pooled};
use run::run_id;
use schemas::{Fault, TableKind, keys::HashKey};
use store::{Store, Version, arithmetic::arithmetic_in_words, checksums, current, published};

use folder::FolderDraft;
use set::{
    DataDictionary, FORMAT, Person, ReleaseFailure, ReleaseLockfile, ReleaseMetadata, ReleaseSet, ReleaseStage,
    ReleaseTable,
};
pub use upload::upload;
pub use verify::{ReleaseVerification, verify};
pub(crate) use words::counted;

/// Request for a published set.
pub struct ReleaseRequest<'a> {
    /// Names of the tables in the spec.
    pub tables: &'a [String],
    /// Folder of the set.
    pub to: &'a Path,
    /// Whether an existing set is replaced.
    pub replace: bool,
    /// Whether restricted columns may be published.
    pub include_restricted: bool,
}

/// Contents of a published set.
#[derive(Debug)]
pub struct ReleaseSummary {
    /// Name, rows and files of each table.
    pub tables: Vec<(String, u64, usize)>,
    /// Number of files.
    pub files: usize,
    /// Whether anything was written; `false` if the same set already existed.
    pub written: bool,
    /// Number of units that are missing from the tables because they could not be computed.
    pub failures: usize,
    /// Restricted columns that were published, each with its origin.
    pub restricted: Vec<String>,
    /// Rule that permitted the publication of each table.
    pub rules: Vec<(String, String)>,
    /// Columns that an earlier run has recorded as restricted, and that the spec no longer restricts.
    pub lifted: Vec<String>,
    /// Identifier of the run.
    pub run: String,
}

/// Requested table.
#[derive(Clone, Copy)]
enum TableSelection {
    Stage(usize),
    Flights(usize),
    Map(usize),
    /// Pooled scores.
    Pooled,
}

/// Facts of the spec.
///
/// # Errors
/// Fails if the spec has no `[publish]` or an invalid one; without `[publish]`, the fault contains an example.
pub fn facts(spec: &Spec) -> Result<&PublishFacts, SpecFaults> {
    let none = || Fault::new(format!("{} has no `[publish]`", spec.file)).help(EXAMPLE);
    match &spec.publish {
        Some(Ok(facts)) => Ok(facts),
        Some(Err(faults)) => Err(spec.faults(faults.clone())),
        None => Err(spec.faults(vec![none()])),
    }
}

/// Publishes tables of the last run of a plan.
///
/// # Errors
/// Fails if the facts are invalid, a table does not exist or was not computed, or restricted data would be published.
/// Fails if the folder holds other files or if the file system reports an error. The target then stays unchanged.
pub fn release(graph: &PlanGraph, store: &Store, request: &ReleaseRequest) -> Result<ReleaseSummary, Fault> {
    let plan = graph.plan;
    let spec = &plan.spec;
    let facts = facts(spec).map_err(|faults| Fault::new(faults.to_string()))?;
    let about = about(facts)?;
    let chosen = chosen(plan, request.tables)?;
    let version = computed(graph, store)?;
    let lineage = protect::Lineage::new(graph, store)?;
    if !request.include_restricted {
        let wanted = columns(graph, &chosen);
        let held = protect::find(&lineage, &wanted);
        if !held.is_empty() {
            return Err(protect::refused(&held));
        }
        protect::together(&lineage, &wanted)?;
    }
    let draft = FolderDraft::begin(request.to, request.replace)?;
    let root = draft.path();
    let mut tables = vec![];
    for one in &chosen {
        tables.push(match *one {
            TableSelection::Stage(t) => {
                let table = tables::of_stage(graph, &version, t, root)?;
                let node = plan.tables.get(t).ok_or_else(|| Fault::bug("a table is not in the plan"))?;
                ReleaseTable { stage: Some(node.entry.name.to_owned()), description: first(&node.entry.doc), ..table }
            }
            TableSelection::Flights(i) => tables::of_flights(graph, store, i, root)?,
            TableSelection::Map(i) => tables::of_map(graph, store, i, root)?,
            TableSelection::Pooled => tables::of_pooled(graph, &version, root)?,
        });
    }
    protect::describe(&lineage, &mut tables);
    // The columns of the written files are checked again, so that no restricted column is published because it is
    // missing from the plan.
    let names = |t: &ReleaseTable| (t.name.clone(), t.columns.iter().map(|c| c.name.clone()).collect());
    let named: Vec<(String, Vec<String>)> = tables.iter().map(names).collect();
    let restricted = protect::find(&lineage, &named);
    if !request.include_restricted && !restricted.is_empty() {
        return Err(protect::refused(&restricted));
    }
    let rules = protect::rules(&lineage, &named, &restricted);
    let inputs = inputs::gather(graph, root, facts.include_inputs, request.include_restricted)?;
    let failures = failures(graph, store, &chosen)?;
    let dictionary = DataDictionary { format: FORMAT.to_owned(), about, tables, restricted, failures };
    let set = ReleaseSet { dictionary, lock: lock(graph, inputs)? };
    if let Some(file) = &facts.licence_file {
        let text = licence::text(file, &spec.folder)?;
        write(root, words::LICENCE, text.as_bytes())?;
    }
    for (path, text) in documents::all(&set)? {
        write(root, &path, text.as_bytes())?;
    }
    let files = folder::files(root).map_err(|e| Fault::machine(format!("cannot read {}: {e}", root.display())))?;
    let mut sums = BTreeMap::new();
    for path in &files {
        let sum = checksums::of_file(&root.join(path), |_| {});
        let (_, sum) = sum.map_err(|e| Fault::machine(format!("cannot read {path}: {e}")))?;
        sums.insert(path.clone(), sum);
    }
    write(root, checksums::NAME, checksums::write(&sums).as_bytes())?;
    let written = draft.settle()?;
    let ReleaseSet { dictionary, lock } = set;
    Ok(ReleaseSummary {
        tables: dictionary.tables.iter().map(|t| (t.name.clone(), t.rows, t.files.len())).collect(),
        files: sums.len() + 1,
        written,
        failures: dictionary.failures.len(),
        restricted: dictionary.restricted.iter().map(protect::chain).collect(),
        rules,
        lifted: lifted(graph, store),
        run: lock.run,
    })
}

fn write(root: &Path, path: &str, bytes: &[u8]) -> Result<(), Fault> {
    let full = root.join(path);
    let made = full.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::write(&full, bytes));
    made.and_then(|()| fs::File::open(&full)?.sync_all())
        .map_err(|e| Fault::machine(format!("cannot write {}: {e}", full.display())))
}

/// First paragraph of a documentation text.
fn first(doc: &str) -> String {
    doc.split("\n\n").next().unwrap_or_default().trim().to_owned()
}

fn about(facts: &PublishFacts) -> Result<ReleaseMetadata, Fault> {
    const ORCID: &str = "https://orcid.org/";
    let person = |a: &plan::spec::publish::Author| Person {
        name: a.full_name(),
        given: a.given.clone(),
        family: a.family.clone(),
        orcid: a.orcid.as_ref().map(|o| format!("{ORCID}{}", o.strip_prefix(ORCID).unwrap_or(o))),
        affiliation: a.affiliation.clone(),
    };
    Ok(ReleaseMetadata {
        title: facts.title.trim().to_owned(),
        description: facts.description.trim().to_owned(),
        authors: facts.authors.0.iter().map(person).collect(),
        licence: licence::from_facts(facts)?,
        date: facts.date.clone(),
        contact: facts.contact.clone(),
        version: facts.version.clone(),
        doi: facts.doi.clone(),
        url: facts.url.clone(),
        keywords: facts.keywords.clone(),
        motivation: facts.motivation.clone(),
        collection: facts.collection.clone(),
        uses: facts.uses.clone(),
        limits: facts.limits.clone(),
    })
}

/// Requested tables, each once.
fn chosen(plan: &Plan, names: &[String]) -> Result<Vec<TableSelection>, Fault> {
    let mut seen = BTreeSet::new();
    let mut found = vec![];
    for name in names.iter().filter(|n| seen.insert(n.as_str())) {
        let stage = plan.tables.iter().position(|t| t.name == *name);
        if let Some(t) = stage {
            if plan.decl(t).is_some_and(|d| !d.publish) {
                let fault =
                    Fault::new(format!("the table `{name}` is not published, because it has `publish = false`"));
                return Err(fault.help("remove `publish = false`, and run the spec again"));
            }
            found.push(TableSelection::Stage(t));
        } else if let Some(i) = plan.flights.iter().position(|f| f.name == *name) {
            found.push(TableSelection::Flights(i));
        } else if let Some(i) = plan.maps.iter().position(|m| m.name == *name) {
            found.push(TableSelection::Map(i));
        } else if name == pooled::TABLE && pooled::tables(plan).next().is_some() {
            found.push(TableSelection::Pooled);
        } else {
            let stages = plan.tables.iter().map(|t| t.name.as_str()).chain([pooled::TABLE]);
            let sources = plan.flights.iter().map(|f| f.name.as_str()).chain(plan.maps.iter().map(|m| m.name.as_str()));
            let known: Vec<&str> = stages.chain(sources).collect();
            return Err(Fault::new(format!("there is no table `{name}`")).nearest(name, &known));
        }
    }
    if found.is_empty() {
        return Err(Fault::new("no table to publish was given").help("give one or several tables of the spec"));
    }
    Ok(found)
}

/// Columns that the requested tables have in the plan; the files of the tables contain a subset of these columns.
fn columns(graph: &PlanGraph, chosen: &[TableSelection]) -> Vec<(String, Vec<String>)> {
    let plan = graph.plan;
    let one = |chosen: &TableSelection| match *chosen {
        TableSelection::Stage(t) => {
            let node = plan.tables.get(t)?;
            // Columns that pass through are not in the files of a table of lines, unless they are carried.
            let makes = |name: &str| node.variants.iter().any(|v| v.makes(name).is_some());
            let whole = node.entry.yields != TableKind::Lines;
            let names = node.columns().into_iter().map(|c| c.name);
            let in_file = |n: &String| whole || makes(n) || n == "tt" || node.carry.contains(n);
            Some((node.name.clone(), names.filter(in_file).collect()))
        }
        TableSelection::Flights(i) => {
            let flights = plan.flights.get(i)?;
            Some((flights.name.clone(), flights.shape.columns.iter().map(|c| c.name.clone()).collect()))
        }
        TableSelection::Map(i) => plan.maps.get(i).map(|m| (m.name.clone(), m.columns())),
        TableSelection::Pooled => None,
    };
    // Pooled scores are made from all tables of scores.
    let scores = chosen.iter().filter(|c| matches!(c, TableSelection::Pooled)).flat_map(|_| pooled::tables(plan));
    chosen.iter().copied().chain(scores.map(TableSelection::Stage)).filter_map(|chosen| one(&chosen)).collect()
}

/// Tables of the last run, which must match this spec and data exactly.
fn computed(graph: &PlanGraph, store: &Store) -> Result<Version, Fault> {
    let spec = &graph.plan.spec;
    let sets: String = spec.sets.iter().map(|s| format!(" --set '{s}'")).collect();
    let run = || format!("run the spec first: `magline run {}{sets}`", spec.file);
    let version = current(store.root(), &spec.name).filter(|_| html::is_current(graph, store));
    version.ok_or_else(|| Fault::new(format!("the store has no current results of {}", spec.file)).help(run()))
}

/// Failures in the chosen tables and in their inputs.
fn failures(graph: &PlanGraph, store: &Store, chosen: &[TableSelection]) -> Result<Vec<ReleaseFailure>, Fault> {
    let plan = graph.plan;
    let mut names: BTreeSet<&str> = BTreeSet::new();
    let scores = chosen.iter().filter(|c| matches!(c, TableSelection::Pooled)).flat_map(|_| pooled::tables(plan));
    for one in chosen.iter().copied().chain(scores.map(TableSelection::Stage)) {
        match one {
            TableSelection::Stage(t) => {
                let all = plan.rests_on(t);
                names.extend(all.iter().filter_map(|t| plan.tables.get(*t)).flat_map(|node| {
                    let inputs = node.sources().into_iter().map(|r| plan.name_of(r));
                    inputs.chain([node.name.as_str()])
                }));
            }
            TableSelection::Flights(i) => names.extend(plan.flights.get(i).map(|f| f.name.as_str())),
            TableSelection::Map(_) | TableSelection::Pooled => {}
        }
    }
    let folder = store.table(&plan.spec.name, "failures");
    let Some(rows) = published(&folder, &["stage", "flight", "line"])? else { return Ok(vec![]) };
    let cell = |rows: &RecordBatch, name: &str, row: usize| {
        let array = rows.column_by_name(name)?.as_string_opt::<i32>()?;
        array.is_valid(row).then(|| array.value(row).to_owned())
    };
    let mut counted: BTreeMap<(String, Option<String>, Option<String>), u64> = BTreeMap::new();
    for row in 0..rows.num_rows() {
        let table = cell(&rows, "stage", row).unwrap_or_default();
        if names.contains(table.as_str()) {
            *counted.entry((table, cell(&rows, "flight", row), cell(&rows, "line", row))).or_default() += 1;
        }
    }
    Ok(counted
        .into_iter()
        .map(|((table, flight, line), points)| ReleaseFailure { table, flight, line, points })
        .collect())
}

/// Provenance of the tables.
fn lock(graph: &PlanGraph, inputs: inputs::ReleaseInputs) -> Result<ReleaseLockfile, Fault> {
    /// Maximum number of points whose parameters are listed.
    const POINTS: usize = 1000;
    let plan = graph.plan;
    let spec = &plan.spec;
    let mut stages = vec![];
    for (t, (node, about)) in plan.tables.iter().zip(described_briefly(graph)).enumerate() {
        let mut parameters: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for i in node.parameter_points(POINTS) {
            for (key, value) in plan.instance(t, i).params() {
                let values = parameters.entry(key.to_owned()).or_default();
                if !values.contains(&value) {
                    values.push(value);
                }
            }
        }
        let key = |unit| graph.key(unit).map_or_else(|_| "none".to_owned(), |key| key.to_string());
        stages.push(ReleaseStage {
            table: node.name.clone(),
            stage: node.entry.name.to_owned(),
            version: node.entry.version,
            inputs: about,
            predicate: plan.decl(t).and_then(|d| d.predicate.clone()).map(|(text, _)| text),
            axes: node.axes.iter().filter_map(|i| spec.axes.get(*i)).map(|a| a.name.clone()).collect(),
            points: node.len(),
            parameters,
            key: HashKey::from_parts(graph.units(t).map(key)).to_string(),
        });
    }
    Ok(ReleaseLockfile {
        format: FORMAT.to_owned(),
        magline: env!("CARGO_PKG_VERSION").to_owned(),
        arithmetic: arithmetic_in_words(),
        pipeline: spec.name.clone(),
        spec: inputs.spec,
        spec_sha256: checksums::of_bytes(spec.text.as_bytes()),
        set: spec.sets.iter().filter(|s| is_of_the_answer(s)).cloned().collect(),
        seed: spec.seed,
        run: run_id(graph),
        inputs: inputs.files,
        stages,
    })
}

/// Inputs of each table.
fn described_briefly(graph: &PlanGraph) -> Vec<Vec<String>> {
    described(graph).into_iter().map(|t| t.inputs).collect()
}

/// Whether an assignment of `--set` affects the results. Locations of the store and the inputs, and the description of
/// the data set, do not.
fn is_of_the_answer(set: &str) -> bool {
    let key = set.split('=').next().unwrap_or_default().trim();
    let path: Vec<&str> = key.split('.').map(str::trim).collect();
    !matches!(path.as_slice(), ["store"] | ["publish", ..] | ["tables", _, "path"])
}

#[cfg(test)]
mod tests {
    use super::is_of_the_answer;

    #[test]
    fn unit_storage_locations_do_not_affect_results() {
        let kept = ["seed=7", "axes.lambda=[0.5]", "clean.detrend=true", "tables.flights.format=csv", "name=a"];
        assert!(kept.iter().all(|s| is_of_the_answer(s)));
        let left = ["store=/tmp/x", "tables.flights.path = logs", "publish.doi=10.1/x"];
        assert!(left.iter().all(|s| !is_of_the_answer(s)));
    }
}
