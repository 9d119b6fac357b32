//! Lists of fixed size as one column for each entry.

use std::{collections::HashSet, sync::Arc};

use arrow_array::{
    Array, ArrayRef, FixedSizeListArray, ListArray, RecordBatch, RecordBatchOptions, StringArray, UInt64Array,
    cast::AsArray,
};
use arrow_cast::display::{ArrayFormatter, FormatOptions};
use arrow_schema::{DataType, Field, Schema};
use arrow_select::take::take;
use schemas::Fault;

/// The batch with the list `name` replaced by `name_1`, `name_2` and so on. The description of each column names its
/// entry. A list of varying length becomes a string.
///
/// # Errors
/// Fails for a structure, for nested lists, or for a name that is used twice.
pub(super) fn spread(batch: &RecordBatch) -> Result<RecordBatch, Fault> {
    let (mut fields, mut columns) = (vec![], vec![]);
    for (field, column) in batch.schema().fields().iter().zip(batch.columns()) {
        match field.data_type() {
            DataType::FixedSizeList(item, size) if !item.data_type().is_nested() => {
                let list = column.as_fixed_size_list();
                for entry in 0..usize::try_from(*size).unwrap_or(0) {
                    fields.push(Arc::new(entry_field(field, item.data_type(), entry)));
                    columns.push(entry_values(list, entry)?);
                }
            }
            DataType::List(item) if !item.data_type().is_nested() => {
                let text = Field::new(field.name(), DataType::Utf8, true).with_metadata(field.metadata().clone());
                fields.push(Arc::new(text));
                columns.push(Arc::new(joined(column.as_list())?));
            }
            nested if nested.is_nested() => {
                let fault = Fault::new(format!("column `{}` of type {nested} cannot be exported", field.name()));
                return Err(fault.help("select other columns: `magline sql QUERY --format parquet -o FILE`"));
            }
            _ => {
                fields.push(field.clone());
                columns.push(column.clone());
            }
        }
    }
    let mut names = HashSet::new();
    if let Some(twice) = fields.iter().find(|field| !names.insert(field.name().clone())) {
        let fault = Fault::new(format!("the exported table would have two columns named `{}`", twice.name()));
        return Err(fault.help("rename one of the columns in a query: `magline sql QUERY --format parquet -o FILE`"));
    }
    let options = RecordBatchOptions::new().with_row_count(Some(batch.num_rows()));
    let schema = Arc::new(Schema::new(fields));
    RecordBatch::try_new_with_options(schema, columns, &options).map_err(|e| Fault::bug(e.to_string()))
}

/// Lists of different lengths as strings: the values, separated by semicolons.
fn joined(list: &ListArray) -> Result<StringArray, Fault> {
    let options = FormatOptions::new();
    let text = |row: usize| -> Result<Option<String>, Fault> {
        if list.is_null(row) {
            return Ok(None);
        }
        let values = list.value(row);
        let words = ArrayFormatter::try_new(&values, &options).map_err(|e| Fault::bug(e.to_string()))?;
        Ok(Some((0..values.len()).map(|i| words.value(i).to_string()).collect::<Vec<_>>().join(";")))
    };
    (0..list.len()).map(text).collect::<Result<Vec<_>, _>>().map(StringArray::from)
}

/// The field of the entry at position `entry` of a list.
fn entry_field(list: &Field, item: &DataType, entry: usize) -> Field {
    let mut metadata = list.metadata().clone();
    let terms = metadata.remove("terms").unwrap_or_default();
    if let Some(term) = terms.split(',').nth(entry).filter(|term| !term.is_empty()) {
        let all = metadata.entry("description".to_owned()).or_default();
        *all = if all.is_empty() { term.to_owned() } else { format!("{all}: {term}") };
    }
    Field::new(format!("{}_{}", list.name(), entry + 1), item.clone(), true).with_metadata(metadata)
}

fn entry_values(list: &FixedSizeListArray, entry: usize) -> Result<ArrayRef, Fault> {
    let at = |row: usize| {
        let start = u64::try_from(list.value_offset(row)).ok()?;
        list.is_valid(row).then_some(start + entry as u64)
    };
    let rows: UInt64Array = (0..list.len()).map(at).collect();
    take(list.values(), &rows, None).map_err(|e| Fault::bug(e.to_string()))
}
