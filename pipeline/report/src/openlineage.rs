//! Events of the OpenLineage specification 2-0-2 for a run: one run for the pipeline, and one child run for each table
//! of a stage. Datasets are files, named by `file://<host>` and the path; tables are files in the store.
//!
//! The spec and its inputs determine everything except the identifiers of runs and the times of events.

use std::path::{Component, Path, PathBuf};

use buckets::{ObjectAddress, StorageLocation, place};
use plan::{Plan, PlanGraph, TableRef};
use results::record::{self, SnapshotColumn};
use schemas::{Column, keys::HashKey};
use serde_json::{Map, Value, json};
use store::{clock, host};
use uuid::Uuid;

/// Producer of the events.
pub const PRODUCER: &str = concat!("urn:magline:", env!("CARGO_PKG_VERSION"));
/// The schema of an event of a run.
pub const EVENT: &str = "https://openlineage.io/spec/2-0-2/OpenLineage.json#/$defs/RunEvent";

/// Type of an OpenLineage run event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineageEventType {
    /// The run starts.
    Start,
    /// Everything was computed.
    Complete,
    /// A part failed.
    Fail,
    /// The run was interrupted.
    Abort,
}

impl LineageEventType {
    fn as_str(self) -> &'static str {
        match self {
            LineageEventType::Start => "START",
            LineageEventType::Complete => "COMPLETE",
            LineageEventType::Fail => "FAIL",
            LineageEventType::Abort => "ABORT",
        }
    }
}

/// A facet of the specification: `body` is its content, `version` and `name` identify its schema.
pub fn facet(version: &str, name: &str, body: Value) -> Value {
    let url = format!("https://openlineage.io/spec/facets/{version}/{name}.json#/$defs/{name}");
    let mut whole = json!({ "_producer": PRODUCER, "_schemaURL": url });
    if let (Some(whole), Value::Object(body)) = (whole.as_object_mut(), body) {
        whole.extend(body);
    }
    whole
}

/// Scheduler's run that started this run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParentRun {
    namespace: String,
    job: String,
    run: Uuid,
}

impl ParentRun {
    /// Parses `<namespace>/<job>/<run>`, which schedulers pass in `OPENLINEAGE_PARENT_ID`.
    pub fn parse(text: &str) -> Option<ParentRun> {
        let (rest, run) = text.rsplit_once('/')?;
        let (namespace, job) = rest.rsplit_once('/')?;
        let run = Uuid::parse_str(run).ok()?;
        let whole = !namespace.is_empty() && !job.is_empty();
        whole.then(|| ParentRun { namespace: namespace.to_owned(), job: job.to_owned(), run })
    }

    fn json(&self) -> Value {
        json!({ "run": { "runId": self.run.to_string() }, "job": { "namespace": self.namespace, "name": self.job } })
    }
}

/// A run of a pipeline.
#[derive(Clone, Debug)]
pub struct LineageRun {
    /// Identifier.
    pub id: Uuid,
    /// The namespace of its jobs.
    pub namespace: String,
    /// The scheduler's run that started this run.
    pub parent: Option<ParentRun>,
    pipeline: String,
    spec: String,
}

impl LineageRun {
    /// A run of `plan`.
    pub fn new(plan: &Plan, id: Uuid, namespace: String, parent: Option<ParentRun>) -> LineageRun {
        let mut spec = plan.spec.text.clone();
        for set in &plan.spec.sets {
            spec.push_str(&format!("\n# --set {set}"));
        }
        LineageRun { id, namespace, parent, pipeline: plan.spec.name.clone(), spec }
    }

    /// An event of the run.
    pub fn event(&self, state: LineageEventType, error: Option<&str>) -> Value {
        let job = json!({
            "jobType": job_type("PIPELINE"),
            "sourceCode": facet("1-0-1", "SourceCodeJobFacet", json!({ "language": "toml", "sourceCode": self.spec })),
        });
        let mut facets = run_facets(error);
        if let Some(parent) = &self.parent {
            let mut of = parent.json();
            of["root"] = parent.json();
            facets.insert("parent".to_owned(), facet("1-2-0", "ParentRunFacet", of));
        }
        self.whole(state, self.id, facets, &self.pipeline, job)
    }

    /// An event of the run of a table.
    pub fn of_table(&self, table: &TableLineage, state: LineageEventType, error: Option<&str>) -> Value {
        let this = json!({
            "run": { "runId": self.id.to_string() }, "job": { "namespace": self.namespace, "name": self.pipeline },
        });
        let mut of = this.clone();
        of["root"] = self.parent.as_ref().map_or(this, ParentRun::json);
        let mut facets = run_facets(error);
        facets.insert("parent".to_owned(), facet("1-2-0", "ParentRunFacet", of));
        let job = json!({
            "jobType": job_type("STAGE"),
            "documentation": facet("1-1-0", "DocumentationJobFacet", json!({ "description": table.about })),
        });
        let name = format!("{}.{}", self.pipeline, table.name);
        let mut event = self.whole(state, self.table_run_id(&table.name), facets, &name, job);
        event["inputs"] = table.inputs.clone();
        event["outputs"] = json!([table.output]);
        event
    }

    /// The identifier of the run of a table: the same for the same run and table.
    fn table_run_id(&self, table: &str) -> Uuid {
        let key = HashKey::from_parts([self.id.as_bytes().as_slice(), table.as_bytes()]);
        let bytes: [u8; 16] = key.as_ref().try_into().unwrap_or_default();
        uuid::Builder::from_custom_bytes(bytes).into_uuid()
    }

    fn whole(&self, state: LineageEventType, run: Uuid, facets: Map<String, Value>, job: &str, about: Value) -> Value {
        json!({
            "eventType": state.as_str(),
            "eventTime": clock::now_ms(),
            "producer": PRODUCER,
            "schemaURL": EVENT,
            "run": { "runId": run.to_string(), "facets": facets },
            "job": { "namespace": self.namespace, "name": job, "facets": about },
            "inputs": [],
            "outputs": [],
        })
    }
}

fn job_type(kind: &str) -> Value {
    let body = json!({ "processingType": "BATCH", "integration": "MAGLINE", "jobType": kind });
    facet("2-0-4", "JobTypeJobFacet", body)
}

fn run_facets(error: Option<&str>) -> Map<String, Value> {
    let version = env!("CARGO_PKG_VERSION");
    let engine = json!({ "version": version, "name": "magline", "openlineageAdapterVersion": version });
    let mut facets = Map::new();
    facets.insert("processing_engine".to_owned(), facet("1-1-1", "ProcessingEngineRunFacet", engine));
    if let Some(message) = error {
        let body = json!({ "message": message, "programmingLanguage": "RUST" });
        facets.insert("errorMessage".to_owned(), facet("1-0-1", "ErrorMessageRunFacet", body));
    }
    facets
}

/// Lineage of one table: the inputs and output of its job.
pub struct TableLineage {
    /// The table.
    pub name: String,
    about: String,
    inputs: Value,
    output: Value,
}

/// A file or folder as a dataset.
struct LineageDataset {
    namespace: String,
    name: String,
    version: String,
    schema: Value,
}

impl LineageDataset {
    fn new(place: &StorageLocation, version: HashKey, columns: impl Iterator<Item = Value>) -> LineageDataset {
        let (namespace, name) = match place {
            StorageLocation::Path(path) => (format!("file://{}", host()), plain(path).display().to_string()),
            StorageLocation::Object(ObjectAddress { scheme, bucket, key }) => {
                (format!("{}://{bucket}", scheme.as_str()), key.clone())
            }
        };
        let fields: Vec<Value> = columns.collect();
        LineageDataset {
            namespace,
            name,
            version: version.to_string(),
            schema: facet("1-2-0", "SchemaDatasetFacet", json!({ "fields": fields })),
        }
    }

    fn json(&self) -> Value {
        let between = if self.name.starts_with('/') { "" } else { "/" };
        let uri = format!("{}{between}{}", self.namespace, self.name);
        let version = json!({ "datasetVersion": self.version });
        json!({
            "namespace": self.namespace,
            "name": self.name,
            "facets": {
                "schema": self.schema,
                "version": facet("1-0-1", "DatasetVersionDatasetFacet", version),
                "dataSource": facet("1-0-1", "DatasourceDatasetFacet", json!({ "name": uri, "uri": uri })),
            },
        })
    }

    /// A column of this data set as the source of another column.
    fn field(&self, column: &str, kind: &str, subtype: &str) -> Value {
        json!({
            "namespace": self.namespace,
            "name": self.name,
            "field": column,
            "transformations": [{ "type": kind, "subtype": subtype, "description": "", "masking": false }],
        })
    }
}

/// The path with `.` and `..` resolved by name alone; links are not followed.
fn plain(path: &Path) -> PathBuf {
    path.components().fold(PathBuf::new(), |mut whole, part| {
        match part {
            Component::ParentDir => {
                whole.pop();
            }
            Component::CurDir => {}
            Component::Prefix(_) | Component::RootDir | Component::Normal(_) => whole.push(part),
        }
        whole
    })
}

/// Absolute path of an existing folder.
fn whole(folder: &Path) -> PathBuf {
    folder.canonicalize().or_else(|_| std::path::absolute(folder)).unwrap_or_else(|_| folder.to_owned())
}

fn described(name: &str, kind: &str, unit: &str, about: &str) -> Value {
    let unit = if unit.is_empty() { String::new() } else { format!(" [{unit}]") };
    json!({ "name": name, "type": kind, "description": format!("{about}{unit}") })
}

fn of_source(c: &Column) -> Value {
    described(&c.name, &c.column_type.data_type().to_string(), &c.unit, &c.doc)
}

fn of_table(c: &SnapshotColumn) -> Value {
    described(&c.name, &c.kind, &c.unit, &c.doc)
}

/// The lineage of every table of a plan with its data, in the plan's order.
pub fn lineage(graph: &PlanGraph) -> Vec<TableLineage> {
    let plan = graph.plan;
    let columns: Vec<Vec<SnapshotColumn>> =
        plan.tables.iter().enumerate().map(|(t, node)| record::columns(plan, t, node)).collect();
    let folder = |table: &str| match &plan.spec.store_at {
        Some((address, _)) => StorageLocation::Object(address.below(&format!("tables/{}/{table}", plan.spec.name))),
        None => StorageLocation::Path(whole(&plan.spec.store).join("tables").join(&plan.spec.name).join(table)),
    };
    let version = |t: usize| {
        let key = |unit| graph.key(unit).map_or_else(|_| "none".to_owned(), |key| key.to_string());
        HashKey::from_parts(graph.units(t).map(key))
    };
    let tables: Vec<LineageDataset> = plan
        .tables
        .iter()
        .zip(&columns)
        .enumerate()
        .map(|(t, (node, columns))| LineageDataset::new(&folder(&node.name), version(t), columns.iter().map(of_table)))
        .collect();
    let bytes = |i: usize| HashKey::from_parts(graph.bytes.get(i).into_iter().flatten().map(|b| b.hash.to_string()));
    let path = |name: &str| {
        let decl = plan.spec.tables.iter().find(|t| t.name == name);
        match place(decl.map(|d| d.path.0.as_str()).unwrap_or_default()) {
            Ok(StorageLocation::Path(path)) => StorageLocation::Path(whole(&plan.spec.folder).join(path)),
            Ok(object @ StorageLocation::Object(_)) => object,
            Err(_) => StorageLocation::Path(whole(&plan.spec.folder)),
        }
    };
    let flights: Vec<LineageDataset> = (plan.flights.iter().enumerate())
        .map(|(i, f)| LineageDataset::new(&path(&f.name), bytes(i), f.shape.columns.iter().map(of_source)))
        .collect();
    let cells = || schemas::map::COLUMNS.iter().map(|(name, d)| described(name, "Float64", d.unit, d.description));
    let maps: Vec<LineageDataset> = (plan.maps.iter().enumerate())
        .map(|(i, m)| LineageDataset::new(&path(&m.name), bytes(plan.flights.len() + i), cells()))
        .collect();
    let of = |r: TableRef| match r {
        TableRef::Flights(i) => flights.get(i),
        TableRef::Map(i) => maps.get(i),
        TableRef::Stage(t, _) => tables.get(t),
    };
    let one = |t: usize| {
        let (node, own) = (plan.tables.get(t)?, tables.get(t)?);
        let sources = node.sources();
        let named = |name: &str| sources.iter().find(|r| plan.name_of(**r) == name).and_then(|r| of(*r));
        let mut fields = Map::new();
        for c in columns.get(t)? {
            // A stage may recompute a column from its input column of the same name.
            let made = node.variants.iter().any(|v| v.makes(&c.name).is_some());
            let subtype = if made { "TRANSFORMATION" } else { "IDENTITY" };
            let from = c.from.iter().filter_map(|(table, column)| Some(named(table)?.field(column, "DIRECT", subtype)));
            let from: Vec<Value> = from.collect();
            if !from.is_empty() {
                fields.insert(c.name.clone(), json!({ "inputFields": from }));
            }
        }
        let mut filters: Vec<&str> = node
            .variants
            .iter()
            .filter_map(|v| v.predicate.as_ref())
            .flat_map(|p| &p.columns)
            .map(String::as_str)
            .collect();
        filters.sort_unstable();
        filters.dedup();
        let first = sources.first().and_then(|r| of(*r));
        let filters: Vec<Value> =
            filters.into_iter().filter_map(|c| Some(first?.field(c, "INDIRECT", "FILTER"))).collect();
        let mut output = own.json();
        let body = json!({ "fields": fields, "dataset": filters });
        output["facets"]["columnLineage"] = facet("1-2-0", "ColumnLineageDatasetFacet", body);
        let stage = format!("`{}` version {}", node.entry.name, node.entry.version);
        let inputs = sources.iter().filter_map(|r| of(*r)).map(LineageDataset::json).collect();
        Some(TableLineage { name: node.name.clone(), about: stage, inputs, output })
    };
    (0..plan.tables.len()).filter_map(one).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_the_parent_run_has_three_parts() {
        let run = "0190b2a5-2b3c-7def-8a01-23456789abcd";
        let parent = ParentRun::parse(&format!("airflow://host/etl.nightly/{run}")).unwrap();
        assert_eq!((parent.namespace.as_str(), parent.job.as_str()), ("airflow://host", "etl.nightly"));
        assert_eq!(parent.json()["run"]["runId"], run);
        for wrong in ["", "a/b", "a/b/c", &format!("b/{run}"), &format!("/b/{run}")] {
            assert_eq!(ParentRun::parse(wrong), None, "{wrong}");
        }
    }
}
