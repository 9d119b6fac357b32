//! Contents of a table's files: the keys (axes, flight, line, tt), the columns of the stage, and the carried columns.
//! Columns that pass through a stage stay in the table that made them.

use std::sync::Arc;

use arrow_array::{ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, StringArray, new_null_array};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use plan::{IN_SAMPLE, InSampleColumn, PlanGraph, PlanUnit, TableRef};
use schemas::{Column, Fault, Literal, Role, StageSchema, TableKind, casting::cast, field, keys::HashKey};
use store::{PackedUnit, row_bytes};

use super::held::LineColumnCache;

/// Identifiers and time, which every table of flight lines has as columns.
const KEYS: [&str; 3] = ["flight", "line", "tt"];

/// Schema and assembly of the files of one table from the results of its units.
pub struct TableAssembler<'a> {
    graph: &'a PlanGraph<'a>,
    table: usize,
    /// Columns of its files.
    pub schema: SchemaRef,
    /// Hash of these columns.
    pub kind: HashKey,
    /// Columns that the stage does not make at every point: `tt` and the carried columns.
    passed: Vec<String>,
    /// The column [`IN_SAMPLE`], in a table of scores or of pooled scores.
    in_sample: Option<InSampleColumn<'a>>,
}

impl<'a> TableAssembler<'a> {
    /// Schema of the table `table`.
    ///
    /// # Errors
    /// Fails if the types of a column at different sweep points do not fit one file.
    pub fn new(graph: &'a PlanGraph<'a>, table: usize) -> Result<TableAssembler<'a>, Fault> {
        let plan = graph.plan;
        let node = &plan.tables[table];
        let axes = node.axes.iter().filter_map(|i| plan.spec.axes.get(*i));
        let mut fields: Vec<Field> =
            axes.map(|a| field(&a.name, axis_type(&a.values[0]), "", Role::Key, "axis of the sweep")).collect();
        let yields: Vec<&StageSchema> = node.variants.iter().map(|v| v.yields.as_ref()).collect();
        let mut passed = vec![];
        for column in node.columns() {
            if fields.iter().any(|f| f.name() == &column.name) {
                continue;
            }
            let makers: Vec<&Column> =
                yields.iter().filter_map(|y| y.columns.iter().find(|c| c.name == column.name)).collect();
            let identifier = KEYS.contains(&column.name.as_str());
            // Results that are recomputed on demand are in no file from which the column could be read.
            let unkept = makers.is_empty()
                && node.examples(&plan.spec).any(|i| {
                    let made_by = graph.origin(TableRef::Stage(table, i), &column.name).made_by;
                    matches!(made_by, TableRef::Stage(t, _) if !plan.tables[t].keep)
                });
            let carried = unkept || node.carry.contains(&column.name);
            if makers.is_empty() && !identifier && !carried {
                continue;
            }
            if makers.len() < yields.len() && column.name != "flight" && column.name != "line" {
                passed.push(column.name.clone());
            }
            // A passthrough column has the types that it has in its source tables.
            let types = if makers.is_empty() { node.columns_named(&column.name) } else { makers };
            fields.push(one_type(&column, &types)?);
        }
        let in_sample = InSampleColumn::new(graph, table)?;
        if let Some(meaning) = node.in_sample_meaning() {
            fields.push(field(IN_SAMPLE, DataType::Boolean, "", Role::Key, meaning));
        }
        let schema: SchemaRef = Arc::new(Schema::new(fields));
        let spelt = schema.fields().iter().flat_map(|f| {
            let mut about: Vec<(&String, &String)> = f.metadata().iter().collect();
            about.sort();
            [f.name().clone(), f.data_type().to_string(), format!("{about:?}")]
        });
        let stage = [node.entry.name.to_owned(), node.entry.version.to_string()];
        let kind = HashKey::from_parts(stage.into_iter().chain(spelt));
        Ok(TableAssembler { graph, table, schema, kind, passed, in_sample })
    }

    /// Estimated memory of a unit before its computation, in bytes.
    pub fn bytes(&self, unit: PlanUnit) -> usize {
        /// Assumed number of rows of a model or of the scores of a line.
        const TIDY_ROWS: usize = 32;
        /// Assumed number of rows of a map, so large that each map gets a separate chunk. The true size depends on the
        /// data.
        const MAP_ROWS: usize = 1 << 20;
        let node = &self.graph.plan.tables[self.table];
        let rows = match unit.line.filter(|_| !node.is_small()) {
            Some(line) => {
                let of = |records: &std::collections::BTreeMap<usize, plan::sources::LineRecord>| {
                    records.get(&line).map_or(0, |l| l.rows)
                };
                self.graph.records.iter().map(of).max().unwrap_or(0)
            }
            None if node.entry.yields == TableKind::Map => MAP_ROWS,
            None => TIDY_ROWS,
        };
        rows * row_bytes(&self.schema)
    }

    /// Whether a unit's rows were computed from an in-sample line; `None` for tables without scores.
    fn in_sample(&self, unit: PlanUnit) -> Option<bool> {
        self.in_sample.as_ref().map(|column| column.lines(unit).0 > 0)
    }

    /// Hash of those columns of a unit that the unit's stage did not make.
    pub fn passthrough_hash(&self, unit: PlanUnit) -> u64 {
        let plan = self.graph.plan;
        let it = plan.instance(unit.table, unit.instance);
        let mut parts: Vec<String> = vec![];
        for (name, value) in plan.tables[unit.table].axis_columns(&it, &plan.spec) {
            parts.extend([name.to_owned(), value.to_string()]);
        }
        if let Some(seen) = self.in_sample(unit) {
            parts.extend([IN_SAMPLE.to_owned(), seen.to_string()]);
        }
        for name in &self.passed {
            if let Some(line) = unit.line.filter(|_| it.makes(name).is_none()) {
                let key = self.graph.column(TableRef::Stage(unit.table, unit.instance), line, name);
                parts.extend([name.clone(), key.map_or_else(|_| "none".to_owned(), |k| k.to_string())]);
            }
        }
        let key = HashKey::from_parts(parts);
        let bytes: [u8; 8] = key.as_ref()[..8].try_into().unwrap_or_default();
        u64::from_le_bytes(bytes)
    }

    /// Rows of a unit as they are written to a file. `made` holds the columns that the unit's stage made.
    ///
    /// # Errors
    /// Fails if the carried columns cannot be read.
    pub fn rows(&self, unit: PlanUnit, made: &RecordBatch, held: &mut LineColumnCache) -> Result<RecordBatch, Fault> {
        let plan = self.graph.plan;
        let it = plan.instance(unit.table, unit.instance);
        let axes = plan.tables[unit.table].axis_columns(&it, &plan.spec);
        let rows = made.num_rows();
        let wanted: Vec<String> = self
            .passed
            .iter()
            .filter(|n| it.makes(n).is_none() && it.table.shape().get(n).is_some())
            .cloned()
            .collect();
        let passed = match unit.line.filter(|_| !wanted.is_empty()) {
            Some(line) => Some(held.batch(TableRef::Stage(unit.table, unit.instance), line, &wanted)?),
            None => None,
        };
        let identifier = |name: &str| {
            let (flight, line) = unit.line.and_then(|l| self.graph.lines.get(l))?;
            match name {
                "flight" => Some(flight),
                "line" => Some(line),
                _ => None,
            }
        };
        let column = |f: &Arc<Field>| -> Result<ArrayRef, Fault> {
            if let Some((_, value)) = axes.iter().find(|(n, _)| *n == f.name()) {
                return Ok(axis_values(value, rows));
            }
            if let Some(seen) = self.in_sample(unit).filter(|_| f.name() == IN_SAMPLE) {
                return Ok(Arc::new(BooleanArray::from(vec![seen; rows])));
            }
            let found = made.column_by_name(f.name()).or_else(|| passed.as_ref()?.column_by_name(f.name()));
            match (found, identifier(f.name())) {
                (Some(array), _) => cast(array, f.data_type()).map_err(|fault| fault.in_column(f.name())),
                (None, Some(text)) => Ok(Arc::new(StringArray::from(vec![text.as_str(); rows]))),
                (None, None) => Ok(new_null_array(f.data_type(), rows)),
            }
        };
        let columns = self.schema.fields().iter().map(column).collect::<Result<Vec<_>, Fault>>()?;
        RecordBatch::try_new(self.schema.clone(), columns).map_err(|e| Fault::machine(e.to_string()))
    }

    /// Name of a pack of these units.
    pub fn id(&self, units: &[PackedUnit]) -> HashKey {
        let spelt = units.iter().flat_map(|u| [u.key.to_string(), format!("{:x}", u.passthrough_hash)]);
        HashKey::from_parts([self.kind.to_string()].into_iter().chain(spelt))
    }

    /// Metadata of a pack of these units, which make the file self-describing: stage, version, keys and columns.
    pub fn about(&self, id: HashKey, units: &[PlanUnit]) -> Vec<(String, String)> {
        let node = &self.graph.plan.tables[self.table];
        let mut questions: Vec<HashKey> = vec![];
        for unit in units {
            let asked = self.graph.plan.instance(unit.table, unit.instance).question();
            if questions.last() != Some(&asked) {
                questions.push(asked);
            }
        }
        let described = |f: &Arc<Field>| {
            let about = |key: &str| f.metadata().get(key).cloned().unwrap_or_default();
            let text = serde_json::json!({
                "unit": about("unit"), "role": about("role"), "description": about("description"),
            });
            (f.name().clone(), text)
        };
        let columns: serde_json::Map<String, serde_json::Value> = self.schema.fields().iter().map(described).collect();
        let pairs = [
            ("magline.stage", node.entry.name.to_owned()),
            ("magline.stage_version", node.entry.version.to_string()),
            ("magline.spec_hash", HashKey::from_parts(questions).to_string()),
            ("magline.key", id.to_string()),
            ("magline.columns", serde_json::Value::Object(columns).to_string()),
        ];
        pairs.into_iter().map(|(k, v)| (k.to_owned(), v)).collect()
    }
}

/// Field of a column whose type may differ between the points of a sweep: lists of different lengths.
///
/// # Errors
/// Fails if the types are of different kinds.
pub fn one_type(column: &Column, makers: &[&Column]) -> Result<Field, Fault> {
    let first = column.field();
    let types: Vec<DataType> = makers.iter().map(|c| c.column_type.data_type()).collect();
    if types.iter().all(|t| t == first.data_type()) {
        return Ok(first);
    }
    let item = |t: &DataType| match t {
        DataType::FixedSizeList(item, _) => Some(item.clone()),
        _ => None,
    };
    match (item(first.data_type()), types.iter().all(|t| item(t).is_some())) {
        (Some(inner), true) => {
            let mut about = first.metadata().clone();
            about.remove("terms");
            Ok(Field::new(first.name(), DataType::List(inner), true).with_metadata(about))
        }
        _ => {
            let what = format!("the type of `{}` differs between points of the sweep", column.name);
            Err(Fault::new(what).help("use two stages, one for the points of each type"))
        }
    }
}

/// Arrow type of an axis column.
pub fn axis_type(value: &Literal) -> DataType {
    match value {
        Literal::Bool(_) => DataType::Boolean,
        Literal::Int(_) => DataType::Int64,
        Literal::Float(_) => DataType::Float64,
        Literal::Text(_) | Literal::List(_) | Literal::Section(_) => DataType::Utf8,
    }
}

/// Axis value, repeated for each row.
pub fn axis_values(value: &Literal, rows: usize) -> ArrayRef {
    match value {
        Literal::Bool(x) => Arc::new(BooleanArray::from(vec![*x; rows])),
        Literal::Int(x) => Arc::new(Int64Array::from(vec![*x; rows])),
        Literal::Float(x) => Arc::new(Float64Array::from(vec![*x; rows])),
        Literal::Text(_) | Literal::List(_) | Literal::Section(_) => {
            let text = value.to_string();
            Arc::new(StringArray::from(vec![text.as_str(); rows]))
        }
    }
}
