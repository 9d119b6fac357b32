//! Export of a table of a store: lists spread over columns, rows in the order of the table.

mod spread;
mod xyz;

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use schemas::Fault;

pub use xyz::GeosoftWriter;

use crate::sql::{BatchSink, StoreQuery, sql_in_order};
use spread::spread;

/// The query of the rows of `table`, a name PIPELINE.TABLE, that `lines` and the SQL condition `condition` select.
///
/// # Errors
/// Fails when the name has another form.
pub fn query(table: &str, lines: &[String], condition: Option<&str>) -> Result<String, Fault> {
    let name = |part: &str| format!("\"{}\"", part.trim_matches('"').replace('"', "\"\""));
    let Some((pipeline, own)) = table.split_once('.').filter(|(a, b)| !a.is_empty() && !b.is_empty()) else {
        let fault = Fault::new(format!("`{table}` is not the name of a table of a store"));
        return Err(fault.help("write PIPELINE.TABLE; `magline ls` lists the tables"));
    };
    let mut conditions = vec![];
    if !lines.is_empty() {
        let texts: Vec<String> = lines.iter().map(|line| format!("'{}'", line.replace('\'', "''"))).collect();
        conditions.push(format!("\"line\" IN ({})", texts.join(", ")));
    }
    // A comment in the condition ends with its line.
    conditions.extend(condition.map(|text| format!("({text}\n)")));
    let conditions = if conditions.is_empty() { String::new() } else { format!(" WHERE {}", conditions.join(" AND ")) };
    Ok(format!("SELECT * FROM {}.{}{conditions}", name(pipeline), name(own)))
}

/// Sends the rows of a query to `sink`, batch by batch, in the order of the table, with lists spread over columns.
///
/// # Errors
/// Fails when the query fails, and for a list that cannot be spread over columns.
pub fn export(question: &StoreQuery, sink: &mut dyn BatchSink) -> Result<(), Fault> {
    sql_in_order(question, &mut SpreadSink(sink))
}

/// Receiver that spreads lists over columns for another receiver.
struct SpreadSink<'a>(&'a mut dyn BatchSink);

impl BatchSink for SpreadSink<'_> {
    fn take(&mut self, batch: RecordBatch) -> Result<bool, Fault> {
        self.0.take(spread(&batch)?)
    }

    fn keeps(&self, batch: &RecordBatch) -> usize {
        self.0.keeps(batch)
    }

    fn finish(&mut self, schema: &SchemaRef) -> Result<(), Fault> {
        self.0.finish(&spread(&RecordBatch::new_empty(schema.clone()))?.schema())
    }
}
