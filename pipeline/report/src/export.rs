//! Export of a table of a store: lists spread over columns, time stamps in UTC, rows in the order of the table.

mod gpkg;
mod mat;
mod spread;
mod utc;
mod xyz;

use std::{fs::File, io, io::BufWriter, path::Path, sync::Arc};

use arrow_array::{RecordBatch, RecordBatchOptions};
use arrow_schema::{Field, Schema, SchemaRef};
use schemas::Fault;

use crate::sql::{BatchSink, StoreQuery, sql_in_order};
use gpkg::GeoPackageWriter;
use mat::MatWriter;
use spread::spread;
use utc::UtcColumn;
use xyz::GeosoftWriter;

/// Makes the writer of a file for a table of this name.
pub type CreateWriterFn = fn(&Path, &str) -> Result<Box<dyn TableWriter>, Fault>;

/// File format with its own writer.
#[derive(Clone, Copy)]
pub struct TableFormat {
    /// Extension of its files.
    pub extension: &'static str,
    /// Creates a file for a table of this name.
    pub create: CreateWriterFn,
}

/// The file formats with their own writers.
pub const TABLE_FORMATS: &[TableFormat] = &[
    TableFormat { extension: "xyz", create: |path, _| Ok(Box::new(GeosoftWriter::new(file(path)?))) },
    TableFormat { extension: "gpkg", create: |path, table| Ok(Box::new(GeoPackageWriter::create(path, table)?)) },
    TableFormat { extension: "mat", create: |path, _| Ok(Box::new(MatWriter::new(file(path)?))) },
];

fn file(path: &Path) -> Result<BufWriter<File>, Fault> {
    let file = File::create(path).map_err(|e| write_failed(&e))?;
    Ok(BufWriter::with_capacity(1 << 16, file))
}

/// Writer of a table in a file format.
pub trait TableWriter: Send {
    /// Writes rows.
    ///
    /// # Errors
    /// Fails for values that the format cannot store, or on errors of writing.
    fn write(&mut self, batch: &RecordBatch) -> Result<(), Fault>;

    /// Completes the file; `schema` gives the columns of a table without rows.
    ///
    /// # Errors
    /// Fails on errors of writing.
    fn finish(self: Box<Self>, schema: &Schema) -> Result<(), Fault>;
}

fn write_failed(e: &io::Error) -> Fault {
    Fault::machine(format!("cannot write the export: {e}"))
}

/// The query of the rows of `table`, a name PIPELINE.TABLE, that `lines` and the SQL condition `condition` select.
///
/// # Errors
/// Fails if the name has another form.
pub fn query(table: &str, lines: &[String], condition: Option<&str>) -> Result<String, Fault> {
    let name = |part: &str| format!("\"{}\"", part.trim_matches('"').replace('"', "\"\""));
    let Some((pipeline, own)) = table.split_once('.').filter(|(a, b)| !a.is_empty() && !b.is_empty()) else {
        let fault = Fault::new(format!("`{table}` is not the full name of a table"));
        return Err(fault.help("write PIPELINE.TABLE; `magline ls` lists the tables"));
    };
    let mut conditions = vec![];
    if !lines.is_empty() {
        let texts: Vec<String> = lines.iter().map(|line| format!("'{}'", line.replace('\'', "''"))).collect();
        conditions.push(format!("\"line\" IN ({})", texts.join(", ")));
    }
    // The line break ends a comment that the condition may contain.
    conditions.extend(condition.map(|text| format!("({text}\n)")));
    let conditions = if conditions.is_empty() { String::new() } else { format!(" WHERE {}", conditions.join(" AND ")) };
    Ok(format!("SELECT * FROM {}.{}{conditions}", name(pipeline), name(own)))
}

/// Sends the rows of a query to `sink`, batch by batch, in the order of the table, with lists spread over columns. A
/// table with a date also has the column `utc`. With `units`, the name of each column ends with its unit: `mag_c [nT]`.
///
/// # Errors
/// Fails if the query fails. Also fails for a list that cannot be spread over columns.
pub fn export(question: &StoreQuery, sink: &mut dyn BatchSink, units: bool) -> Result<(), Fault> {
    sql_in_order(question, &mut SpreadSink { sink, units, utc: UtcColumn::default() })
}

/// Receiver that spreads lists over columns for another receiver.
struct SpreadSink<'a> {
    sink: &'a mut dyn BatchSink,
    units: bool,
    utc: UtcColumn,
}

impl SpreadSink<'_> {
    fn spread(&mut self, batch: &RecordBatch) -> Result<RecordBatch, Fault> {
        let spread = self.utc.add(&spread(batch)?)?;
        if !self.units {
            return Ok(spread);
        }
        let named = |field: &Arc<Field>| match field.metadata().get("unit").filter(|unit| !unit.is_empty()) {
            Some(unit) => Arc::new(field.as_ref().clone().with_name(format!("{} [{unit}]", field.name()))),
            None => field.clone(),
        };
        let schema = Arc::new(Schema::new(spread.schema().fields().iter().map(named).collect::<Vec<_>>()));
        let options = RecordBatchOptions::new().with_row_count(Some(spread.num_rows()));
        let columns = spread.columns().to_vec();
        RecordBatch::try_new_with_options(schema, columns, &options).map_err(|e| Fault::bug(e.to_string()))
    }
}

impl BatchSink for SpreadSink<'_> {
    fn take(&mut self, batch: RecordBatch) -> Result<bool, Fault> {
        let spread = self.spread(&batch)?;
        self.sink.take(spread)
    }

    fn keeps(&self, batch: &RecordBatch) -> usize {
        self.sink.keeps(batch)
    }

    fn finish(&mut self, schema: &SchemaRef) -> Result<(), Fault> {
        let spread = self.spread(&RecordBatch::new_empty(schema.clone()))?;
        self.sink.finish(&spread.schema())
    }
}
