//! Answers to requests of Flight SQL for the keys of tables.

use std::sync::Arc;

use arrow_array::{ArrayRef, Int32Array, RecordBatch, StringArray};
use arrow_schema::{ArrowError, DataType, Field, Schema, SchemaRef};

/// Columns that identify the rows of a table of flight lines: axes, flight, line and time. Other tables have no
/// guaranteed key.
pub fn primary(schema: &Schema) -> Vec<&str> {
    let role = |f: &Field| f.metadata().get("role").cloned().unwrap_or_default();
    let is_key = |f: &&Arc<Field>| role(f) == "key" || f.name() == "tt";
    let keys: Vec<&str> = schema.fields().iter().filter(is_key).map(|f| f.name().as_str()).collect();
    if ["flight", "line", "tt"].iter().all(|k| keys.contains(k)) { keys } else { vec![] }
}

fn text(name: &str, nullable: bool) -> Field {
    Field::new(name, DataType::Utf8, nullable)
}

/// Columns of an answer about primary keys.
pub fn primary_schema() -> SchemaRef {
    Arc::new(Schema::new(vec![
        text("catalog_name", true),
        text("db_schema_name", true),
        text("table_name", false),
        text("column_name", false),
        Field::new("key_sequence", DataType::Int32, false),
        text("key_name", true),
    ]))
}

/// Primary key of one table.
///
/// # Errors
/// Never fails: its columns match the schema.
pub fn primary_batch(catalog: &str, pipeline: &str, table: &str, columns: &[&str]) -> Result<RecordBatch, ArrowError> {
    let n = columns.len();
    let same = |x: &str| -> ArrayRef { Arc::new(StringArray::from(vec![x; n])) };
    let names: ArrayRef = Arc::new(StringArray::from(columns.to_vec()));
    let numbers: ArrayRef = Arc::new((1..).take(n).collect::<Int32Array>());
    let none: ArrayRef = Arc::new(StringArray::from(vec![None::<&str>; n]));
    RecordBatch::try_new(primary_schema(), vec![same(catalog), same(pipeline), same(table), names, numbers, none])
}

/// Columns of an answer about foreign keys, which a store does not have.
pub fn foreign_schema() -> SchemaRef {
    let mut fields = vec![];
    for side in ["pk", "fk"] {
        fields.push(text(&format!("{side}_catalog_name"), true));
        fields.push(text(&format!("{side}_db_schema_name"), true));
        fields.push(text(&format!("{side}_table_name"), false));
        fields.push(text(&format!("{side}_column_name"), false));
    }
    fields.push(Field::new("key_sequence", DataType::Int32, false));
    fields.push(text("fk_key_name", true));
    fields.push(text("pk_key_name", true));
    fields.push(Field::new("update_rule", DataType::UInt8, false));
    fields.push(Field::new("delete_rule", DataType::UInt8, false));
    Arc::new(Schema::new(fields))
}
