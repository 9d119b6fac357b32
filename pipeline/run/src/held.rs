//! Cache of line columns, read once for all points that need them.

use std::{collections::HashMap, sync::Arc};

use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch, RecordBatchOptions, new_null_array};
use arrow_schema::{DataType, Field, Schema};
use plan::{LineId, PlanGraph, PlanUnit, TableRef};
use schemas::{Fault, TableShape, casting::cast, keys::HashKey};

use super::work::UnitWorker;

/// Maximum size of the cached columns of a group, in bytes.
const HELD_BYTES: usize = 256 << 20;

/// Cache of columns that the points of a line share.
pub struct LineColumnCache<'a> {
    worker: &'a UnitWorker<'a>,
    graph: &'a PlanGraph<'a>,
    columns: HashMap<(HashKey, String), ArrayRef>,
    bytes: usize,
}

impl<'a> LineColumnCache<'a> {
    /// Empty cache.
    pub fn new(worker: &'a UnitWorker<'a>) -> LineColumnCache<'a> {
        LineColumnCache { worker, graph: worker.graph(), columns: HashMap::new(), bytes: 0 }
    }

    /// Reads the columns `names` of one line of the table `r`, each from the object that holds the column. Skips
    /// columns that the line lacks.
    ///
    /// # Errors
    /// Fails if the store cannot be read.
    pub fn batch(&mut self, r: TableRef, line: LineId, names: &[String]) -> Result<RecordBatch, Fault> {
        let mut wanted: Vec<ColumnRequest> = vec![];
        for name in names {
            let origin = self.graph.origin(r, name);
            if let TableRef::Flights(i) = origin.made_by
                && self.graph.records[i].get(&line).is_some_and(|l| !l.columns.contains_key(&origin.column))
            {
                continue;
            }
            let object = self.graph.object(origin.made_by, line)?;
            wanted.push(ColumnRequest { made_by: origin.made_by, object, column: origin.column });
        }
        self.fetch(&wanted, line)?;
        let (mut fields, mut arrays) = (vec![], vec![]);
        let plan = self.graph.plan;
        let described = |name: &str| match r {
            TableRef::Flights(i) => plan.flights[i].shape.get(name),
            TableRef::Stage(t, i) => plan.instance(t, i).variant.table.shape().get(name),
            TableRef::Map(_) => None,
        };
        for ColumnRequest { object, column: name, .. } in wanted {
            let Some(array) = self.columns.get(&(object, name.clone())) else { continue };
            let field = described(&name).map(schemas::Column::field);
            let field = field.unwrap_or_else(|| Field::new(&name, array.data_type().clone(), true));
            // If the length of the lists differs between the points of a sweep, the file stores lists of variable
            // length.
            arrays.push(match (array.data_type(), field.data_type()) {
                (DataType::List(_), fixed @ DataType::FixedSizeList(..)) => {
                    cast(array, fixed).map_err(|f| f.in_column(&name))?
                }
                _ => array.clone(),
            });
            fields.push(field);
        }
        let rows = arrays.first().map_or(0, |a| a.len());
        let options = RecordBatchOptions::new().with_row_count(Some(rows));
        RecordBatch::try_new_with_options(Arc::new(Schema::new(fields)), arrays, &options)
            .map_err(|e| Fault::machine(e.to_string()))
    }

    /// Columns of `r`; `None` for a map.
    pub fn shape(&self, r: TableRef) -> Option<TableShape> {
        match r {
            TableRef::Flights(i) => Some(self.graph.plan.flights[i].shape.clone()),
            TableRef::Stage(t, i) => Some(self.graph.plan.instance(t, i).table.shape().clone()),
            TableRef::Map(_) => None,
        }
    }

    /// Reads the columns that are not cached yet, each object once. Results that are not kept are recomputed.
    fn fetch(&mut self, wanted: &[ColumnRequest], line: LineId) -> Result<(), Fault> {
        if self.bytes > HELD_BYTES {
            self.columns.clear();
            self.bytes = 0;
        }
        let mut objects: Vec<(HashKey, TableRef, Vec<String>)> = vec![];
        for ColumnRequest { made_by, object, column } in wanted {
            if self.columns.contains_key(&(*object, column.clone())) {
                continue;
            }
            match objects.iter_mut().find(|(o, ..)| o == object) {
                Some((.., columns)) if columns.contains(column) => {}
                Some((.., columns)) => columns.push(column.clone()),
                None => objects.push((*object, *made_by, vec![column.clone()])),
            }
        }
        for (object, made_by, columns) in objects {
            let batch = match made_by {
                TableRef::Stage(table, instance) if !self.graph.plan.tables[table].keep => {
                    let worker = self.worker;
                    let node = &self.graph.plan.tables[table].name;
                    let unit = PlanUnit { table, instance, line: Some(line) };
                    let named = |f: Fault| Fault { what: format!("`{node}`: {}", f.what), ..f };
                    worker.alone(unit, line, self).map_err(named)?
                }
                _ => self.worker.store().get(object, &columns)?,
            };
            for (field, array) in batch.schema().fields().iter().zip(batch.columns()) {
                self.bytes += array.get_array_memory_size();
                self.columns.insert((object, field.name().clone()), array.clone());
            }
        }
        Ok(())
    }
}

/// Request for a column.
struct ColumnRequest {
    made_by: TableRef,
    object: HashKey,
    column: String,
}

/// Adds each of `columns` that the batch lacks, filled with NaN or null; the result is in the order of `columns`.
///
/// # Errors
/// Fails if Arrow rejects the columns.
pub fn filled(batch: RecordBatch, columns: &[String], shape: Option<TableShape>) -> Result<RecordBatch, Fault> {
    let rows = batch.num_rows();
    let (mut fields, mut arrays) = (vec![], vec![]);
    for name in columns {
        let there = batch.schema().field_with_name(name).ok().cloned().zip(batch.column_by_name(name).cloned());
        let described = || shape.as_ref().and_then(|s| s.get(name)).map(schemas::Column::field);
        let (field, array) = match (there, described()) {
            (Some(both), _) => both,
            (None, Some(field)) if field.data_type() == &DataType::Float64 => {
                (field, Arc::new(Float64Array::from(vec![f64::NAN; rows])) as ArrayRef)
            }
            (None, Some(field)) => {
                let nothing = new_null_array(field.data_type(), rows);
                (field, nothing)
            }
            (None, None) => continue,
        };
        fields.push(field);
        arrays.push(array);
    }
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).map_err(|e| Fault::machine(e.to_string()))
}
