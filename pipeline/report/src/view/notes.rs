//! The inputs of the tables of a pipeline, without the parameters of each point.

use std::{
    collections::{BTreeMap, HashSet},
    path::Path,
};

use results::{SnapshotPoints, record::SnapshotColumn};
use schemas::{Fault, paths};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Value, json};

/// Maximum number of values of a parameter that are kept.
const LISTED_VALUES: usize = 5;

/// The tables and sources of a pipeline at its last run.
#[derive(Debug, Default, Deserialize)]
pub struct PipelineNotes {
    /// The name of the pipeline.
    #[serde(default)]
    pub pipeline: String,
    /// The path of the spec, as the user gave it.
    #[serde(default)]
    pub spec: String,
    /// The seed.
    #[serde(default)]
    pub seed: u64,
    /// The sources.
    #[serde(default)]
    pub sources: Vec<NotedSource>,
    /// The tables.
    #[serde(default)]
    pub tables: Vec<NotedTable>,
}

/// A table that was read from files.
#[derive(Debug, Deserialize)]
pub struct NotedSource {
    /// Name.
    pub name: String,
    /// `flights`, `map` or `model`.
    pub kind: String,
    /// Path and hash of each file.
    pub files: Vec<(String, String)>,
    /// The key of each line, or of the map.
    pub lines: BTreeMap<String, String>,
}

/// A table that a stage made.
#[derive(Debug, Deserialize)]
pub struct NotedTable {
    /// Name.
    pub name: String,
    /// The stage.
    pub stage: String,
    /// The version of the stage.
    pub version: u32,
    /// The axes.
    pub axes: Vec<String>,
    /// The inputs.
    pub inputs: Vec<String>,
    /// The points.
    pub points: NotedPoints,
    /// The restriction of rows.
    pub predicate: Option<String>,
    /// The columns, each with its inputs.
    pub columns: Vec<SnapshotColumn>,
    /// Number of lines.
    pub lines: usize,
}

/// The notes of a store contain the names of stages, but not the roles of the stages.
impl NotedTable {
    /// Whether the table holds the scores of lines.
    pub fn is_scores(&self) -> bool {
        self.stage == "score"
    }

    /// Whether the table holds pooled scores with their intervals.
    pub fn is_summary(&self) -> bool {
        self.stage == "summary"
    }

    /// Whether the table holds models.
    pub fn is_model(&self) -> bool {
        self.stage == "fit"
    }
}

/// The points of a table: their number, and the values of each axis.
#[derive(Debug, Default)]
pub struct NotedPoints {
    /// Number of points.
    pub count: usize,
    /// Distinct values of each axis, in the order of the points.
    pub values: BTreeMap<String, Vec<String>>,
    /// The column of the truth at the first point, if this column is a parameter of the table.
    pub truth: Option<String>,
    /// The values of each parameter.
    pub parameters: BTreeMap<String, NotedParameter>,
}

/// The values of a parameter: their number, and the first values.
#[derive(Debug, Serialize)]
pub struct NotedParameter {
    /// Number of distinct values.
    pub count: usize,
    /// The first values, as JSON.
    pub values: Vec<String>,
}

impl PipelineNotes {
    /// The notes of `pipeline` in the store at `root`; empty if there are none.
    pub fn read(root: &Path, pipeline: &str) -> PipelineNotes {
        PipelineNotes::of_file(&root.join("plans").join(format!("{pipeline}.json")))
    }

    /// The notes in a file; empty if it cannot be read.
    pub fn of_file(file: &Path) -> PipelineNotes {
        serde_json::from_slice(&paths::read_regular(file).unwrap_or_default()).unwrap_or_default()
    }

    /// The column of the truth of the first scores downstream of a table.
    pub fn truth(&self, table: &str) -> Option<&str> {
        let mut scores = self.tables.iter().filter(|t| t.is_scores() && self.is_upstream(table, &t.name));
        scores.find_map(|t| t.points.truth.as_deref())
    }

    /// The lineage of a table as JSON: the table with all tables and sources upstream of it, as `magline lineage`
    /// prints them, but without the parameters of each point and with a count of the lines of a source.
    ///
    /// # Errors
    /// Fails if no stage made the table.
    pub fn lineage(&self, table: &str) -> Result<Value, Fault> {
        let known: Vec<&str> = self.tables.iter().map(|t| t.name.as_str()).collect();
        let missing = || Fault::new(format!("`{table}` has no lineage: no stage made it")).nearest(table, &known);
        self.table(table).ok_or_else(missing)?;
        let tables = self.tables.iter().filter(|t| self.is_upstream(&t.name, table)).map(|t| {
            json!({
                "name": t.name, "stage": t.stage, "version": t.version, "axes": t.axes, "inputs": t.inputs,
                "predicate": t.predicate, "columns": t.columns, "points": t.points.count, "lines": t.lines,
            })
        });
        let sources = self.sources.iter().filter(|s| self.is_upstream(&s.name, table));
        let sources =
            sources.map(|s| json!({ "name": s.name, "kind": s.kind, "files": s.files, "lines": s.lines.len() }));
        Ok(json!({
            "pipeline": self.pipeline, "spec": self.spec, "seed": self.seed, "table": table,
            "tables": tables.collect::<Vec<_>>(), "sources": sources.collect::<Vec<_>>(),
        }))
    }

    /// The sources and tables with their parameters, as JSON.
    pub fn parameters(&self) -> Value {
        let tables = self.tables.iter().map(|t| {
            json!({
                "name": t.name, "stage": t.stage, "version": t.version, "axes": t.axes, "inputs": t.inputs,
                "predicate": t.predicate, "parameters": t.points.parameters,
            })
        });
        let sources = self.sources.iter().map(|s| json!({ "name": s.name, "kind": s.kind, "files": s.files }));
        json!({
            "pipeline": self.pipeline, "seed": self.seed, "tables": tables.collect::<Vec<_>>(),
            "sources": sources.collect::<Vec<_>>(),
        })
    }

    /// Whether `table` is `of`, or is upstream of `of`.
    fn is_upstream(&self, table: &str, of: &str) -> bool {
        let (mut open, mut seen) = (vec![of], HashSet::new());
        while let Some(name) = open.pop() {
            if name == table {
                return true;
            }
            if seen.insert(name) {
                open.extend(self.table(name).into_iter().flat_map(|t| t.inputs.iter().map(String::as_str)));
            }
        }
        false
    }

    /// The table with this name.
    pub fn table(&self, name: &str) -> Option<&NotedTable> {
        self.tables.iter().find(|t| t.name == name)
    }
}

impl<'de> Deserialize<'de> for NotedPoints {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let points = SnapshotPoints::deserialize(deserializer)?;
        let truth = points.first_parameter("truth").and_then(|text| serde_json::from_str(text).ok());
        let noted = |values: &[String]| NotedParameter {
            count: values.len(),
            values: values.iter().take(LISTED_VALUES).cloned().collect(),
        };
        let parameters = points.parameters().map(|(name, values)| (name.to_owned(), noted(values))).collect();
        Ok(NotedPoints { count: points.len(), values: points.axis_values(), truth, parameters })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_points_are_counted_and_their_values_listed() {
        let text = r#"{"checksum": "x", "pipeline": "p", "spec": "s.toml", "seed": 1, "sources": [], "tables": [
            {"name": "t", "stage": "fit", "version": 1, "tidy": true, "axes": ["mag", "lambda"], "inputs": ["a"],
             "predicate": null, "columns": [], "lines": 3, "cost": null, "points": [
             [{"mag": "a", "lambda": "0"}, {"truth": "\"mag_1_c\""}], [{"mag": "b", "lambda": "0"}, {}],
             [{"mag": "a", "lambda": "1"}, {}]]}]}"#;
        let check = |text: &str| {
            let notes: PipelineNotes = serde_json::from_str(text).unwrap();
            let points = &notes.table("t").unwrap().points;
            assert_eq!(points.truth.as_deref(), Some("mag_1_c"));
            let truth = &points.parameters["truth"];
            assert_eq!((truth.count, truth.values.as_slice()), (1, &["\"mag_1_c\"".to_owned()][..]));
            assert_eq!(
                (points.count, &points.values["mag"], &points.values["lambda"]),
                (3, &vec!["a".to_owned(), "b".to_owned()], &vec!["0".to_owned(), "1".to_owned()])
            );
        };
        check(text);
        // The current format, in which each distinct value is stored once.
        let mut plan: Value = serde_json::from_str(text).unwrap();
        let points: SnapshotPoints = serde_json::from_value(plan["tables"][0]["points"].take()).unwrap();
        plan["tables"][0]["points"] = serde_json::to_value(points).unwrap();
        check(&plan.to_string());
    }
}
