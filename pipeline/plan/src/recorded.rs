//! Record of a plan with its lines and keys, for a worker that does not read the inputs.
//!
//! The text of the spec and the recorded facts of its sources reproduce the plan and its keys.

use arrow_ipc::convert::{IpcSchemaEncoder, fb_to_schema};
use arrow_schema::{Schema, SchemaRef};
use learning::search::TrialValue;
use numerics::arithmetic::processor;
use schemas::{Fault, StageEntry, keys::HashKey};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, path::Path};
use store::{Store, arithmetic::ARITHMETIC};

use super::{Plan, PlanGraph, build};
use crate::{
    sources::{LineRecord, MapSource},
    spec::{SearchTrial, Spec, SpecFaults},
};

/// Version of the record's format.
const FORM: u32 = 2;

/// Record of all facts that determine a plan and its keys.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedPlan {
    form: u32,
    magline: String,
    /// Description of the machine's arithmetic, for messages and comparison.
    arithmetic: String,
    arithmetic_key: HashKey,
    /// Name of the spec's file, from which a pipeline without a name gets its name.
    file: String,
    text: String,
    sets: Vec<String>,
    /// Trials of the plan's search.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    trials: Vec<RecordedTrial>,
    flights: Vec<RecordedFlights>,
    maps: Vec<RecordedMap>,
}

/// A trial of a search at one of its rungs.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RecordedTrial {
    trial: usize,
    generation: usize,
    rung: usize,
    values: Vec<RecordedValue>,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum RecordedValue {
    /// A number in the shortest spelling that parses to the same value.
    Real(String),
    Whole(i64),
    Choice(usize),
}

/// A table of flights.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RecordedFlights {
    name: String,
    /// The columns: an Arrow schema, in hexadecimal digits.
    schema: String,
    lines: Vec<RecordedLine>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RecordedLine {
    flight: String,
    line: String,
    rows: usize,
    object: HashKey,
    columns: BTreeMap<String, HashKey>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    fault: Option<Fault>,
}

/// A map, or a model of files.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RecordedMap {
    name: String,
    key: HashKey,
    /// Columns of a model, in the same form as the columns of flights; `None` for a map.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    schema: Option<String>,
}

fn hexadecimal(schema: &Schema) -> String {
    let message = IpcSchemaEncoder::new().schema_to_fb(schema);
    message.finished_data().iter().map(|b| format!("{b:02x}")).collect()
}

fn schema_of(hex: &str) -> Option<Schema> {
    let byte = |i: usize| hex.get(2 * i..2 * i + 2).and_then(|h| u8::from_str_radix(h, 16).ok());
    let message: Vec<u8> = (0..hex.len() / 2).map(byte).collect::<Option<_>>()?;
    arrow_ipc::root_as_schema(&message).ok().map(fb_to_schema)
}

impl RecordedTrial {
    fn from_row(row: &SearchTrial) -> RecordedTrial {
        let value = |value: &TrialValue| match value {
            TrialValue::Real(x) => RecordedValue::Real(format!("{x:?}")),
            TrialValue::Whole(n) => RecordedValue::Whole(*n),
            TrialValue::Choice(i) => RecordedValue::Choice(*i),
        };
        let SearchTrial { trial, generation, rung, ref values } = *row;
        RecordedTrial { trial, generation, rung, values: values.iter().map(value).collect() }
    }

    fn row(&self) -> Option<SearchTrial> {
        let value = |value: &RecordedValue| {
            Some(match value {
                RecordedValue::Real(text) => TrialValue::Real(text.parse().ok()?),
                RecordedValue::Whole(n) => TrialValue::Whole(*n),
                RecordedValue::Choice(i) => TrialValue::Choice(*i),
            })
        };
        let RecordedTrial { trial, generation, rung, ref values } = *self;
        Some(SearchTrial { trial, generation, rung, values: values.iter().map(value).collect::<Option<_>>()? })
    }
}

impl RecordedPlan {
    /// Writes the record of `graph` into `store`, and returns its name.
    ///
    /// # Errors
    /// Fails if the store cannot be written.
    pub fn keep(graph: &PlanGraph, store: &Store) -> Result<HashKey, Fault> {
        let plan = graph.plan;
        let spec = &plan.spec;
        let file = Path::new(&spec.file).file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let line = |l: &LineRecord| RecordedLine {
            flight: l.flight.clone(),
            line: l.line.clone(),
            rows: l.rows,
            object: l.object,
            columns: l.columns.clone(),
            fault: l.fault.clone(),
        };
        let flights = plan.flights.iter().zip(&graph.records).map(|(flights, records)| RecordedFlights {
            name: flights.name.clone(),
            schema: hexadecimal(&flights.schema),
            lines: records.values().map(line).collect(),
        });
        let maps = plan.maps.iter().zip(&graph.maps);
        let whole = |(map, key): (&MapSource, &HashKey)| RecordedMap {
            name: map.name.clone(),
            key: *key,
            schema: map.schema().map(|schema| hexadecimal(schema)),
        };
        let recorded = RecordedPlan {
            form: FORM,
            magline: env!("CARGO_PKG_VERSION").to_owned(),
            arithmetic: processor(),
            arithmetic_key: *ARITHMETIC,
            file,
            text: spec.text.clone(),
            sets: spec.sets.clone(),
            trials: spec.trials.iter().map(RecordedTrial::from_row).collect(),
            flights: flights.collect(),
            maps: maps.map(whole).collect(),
        };
        let bytes = serde_json::to_vec(&recorded).map_err(|e| Fault::machine(e.to_string()))?;
        store.keep_plan(&bytes)
    }

    /// The record `key` of `store`.
    ///
    /// # Errors
    /// Fails if the record is missing, damaged, or of another version.
    pub fn find(store: &Store, key: HashKey) -> Result<RecordedPlan, Fault> {
        let recorded: RecordedPlan = serde_json::from_slice(&store.plan(key)?)
            .map_err(|e| Fault::new(format!("the plan {key} was made by another version of magline: {e}")))?;
        if recorded.form != FORM || recorded.magline != env!("CARGO_PKG_VERSION") {
            let what = format!(
                "the plan {key} was made by magline {} (format {}), but this is magline {} (format {FORM})",
                recorded.magline,
                recorded.form,
                env!("CARGO_PKG_VERSION")
            );
            return Err(Fault::new(what).help("use the same version for tasks and workers"));
        }
        if recorded.arithmetic_key != *ARITHMETIC {
            let what = format!(
                "results of this machine ({}) and results of the machine that made the plan {key} ({}) differ in \
                 their last bits",
                processor(),
                recorded.arithmetic
            );
            let help = "use workers with the same processor type and C library as the planning machine, or plan on \
                        this machine";
            return Err(Fault::new(what).help(help));
        }
        Ok(recorded)
    }

    /// The plan, with the stages of `catalogue`.
    ///
    /// # Errors
    /// Fails if `catalogue` differs from the stages of the record.
    pub fn plan(&self, catalogue: &[StageEntry]) -> Result<Plan, SpecFaults> {
        let spec = Spec::parse(&self.file, ".".into(), self.text.clone(), &self.sets)?;
        let rows: Option<Vec<SearchTrial>> = self.trials.iter().map(RecordedTrial::row).collect();
        let rows = rows.ok_or_else(|| spec.faults(vec![Fault::new("a trial of the plan is unreadable")]))?;
        let spec = if spec.search.is_some() { spec.with_trials(&rows) } else { spec };
        build::build(spec, catalogue, Some(self))
    }

    /// The graph of `plan`, which must be the plan of this record.
    ///
    /// # Errors
    /// Fails if the record does not belong to the plan.
    pub fn graph<'a>(&self, plan: &'a Plan) -> Result<PlanGraph<'a>, SpecFaults> {
        let unknown = |name: &str| plan.spec.faults(vec![lacking(name)]);
        let record = |l: &RecordedLine| LineRecord {
            flight: l.flight.clone(),
            line: l.line.clone(),
            rows: l.rows,
            object: l.object,
            columns: l.columns.clone(),
            fault: l.fault.clone(),
            more_faults: vec![],
            findings: vec![],
            file: 0,
        };
        let (mut lines, mut maps) = (vec![], vec![]);
        for flights in &plan.flights {
            let found = self.flights.iter().find(|f| f.name == flights.name).ok_or_else(|| unknown(&flights.name))?;
            lines.push(found.lines.iter().map(record).collect());
        }
        for map in &plan.maps {
            let same = |m: &&RecordedMap| m.name == map.name && m.schema.is_some() == map.schema().is_some();
            maps.push(self.maps.iter().find(same).ok_or_else(|| unknown(&map.name))?.key);
        }
        PlanGraph::from_records(plan, lines, vec![], maps)
    }

    /// The columns of the table of flights `name`.
    ///
    /// # Errors
    /// Fails if the record has no such table.
    pub(super) fn columns(&self, name: &str) -> Result<SchemaRef, Fault> {
        let found = self.flights.iter().find(|f| f.name == name).and_then(|f| schema_of(&f.schema));
        found.map(SchemaRef::new).ok_or_else(|| lacking(name))
    }

    /// Checks that the record has the map `name`.
    ///
    /// # Errors
    /// Fails if the record contains no such map.
    pub(super) fn has_map(&self, name: &str) -> Result<(), Fault> {
        self.maps.iter().any(|m| m.name == name && m.schema.is_none()).then_some(()).ok_or_else(|| lacking(name))
    }

    /// The columns of the model `name`.
    ///
    /// # Errors
    /// Fails if the record has no such model.
    pub(super) fn model(&self, name: &str) -> Result<SchemaRef, Fault> {
        let found = self.maps.iter().filter(|m| m.name == name).find_map(|m| schema_of(m.schema.as_deref()?));
        found.map(SchemaRef::new).ok_or_else(|| lacking(name))
    }
}

fn lacking(name: &str) -> Fault {
    Fault::new(format!("the record of the plan lacks the table `{name}`"))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn unit_the_plan_of_a_machine_with_other_arithmetic_is_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let of = |arithmetic_key| {
            let recorded = RecordedPlan {
                form: FORM,
                magline: env!("CARGO_PKG_VERSION").to_owned(),
                arithmetic: "a processor".to_owned(),
                arithmetic_key,
                file: "spec.toml".to_owned(),
                text: String::new(),
                sets: vec![],
                trials: vec![],
                flights: vec![],
                maps: vec![],
            };
            RecordedPlan::find(&store, store.keep_plan(&serde_json::to_vec(&recorded).unwrap()).unwrap())
        };
        assert!(of(*ARITHMETIC).is_ok());
        let fault = of(HashKey::from_parts(["other"])).err().unwrap().to_string();
        assert!(fault.contains("(a processor) differ in their last bits") && fault.contains(&processor()), "{fault}");
    }
}
