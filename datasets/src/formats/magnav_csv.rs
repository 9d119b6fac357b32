//! Simple flights of MagNav.jl in CSV: the columns of the plain CSV reader, and the derived columns.

use std::path::Path;

use arrow_array::{Array, RecordBatch, cast::AsArray, types::Float64Type, types::Int64Type};
use arrow_schema::{DataType, SchemaRef};
use arrow_select::concat::concat_batches;

use super::{
    FileHead, FlightBatch, FlightBatches, FlightFormat, FlightOptions, RawFlight, ReadHints, RowFault,
    adopt::{in_counted_unit, named},
    csv, magnav,
};
use crate::{
    ReadError,
    table::{ColumnTable, ColumnValues},
};

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "magnav_csv",
    about: "simple flight of MagNav.jl (XYZ0, XYZ1) in CSV",
    extensions: &[],
    recognise: |head: &FileHead| {
        let header = head.first_line().unwrap_or_default();
        let names: Vec<&str> = header.split(',').map(|n| head.renamed(n.trim())).collect();
        let has = |n: &str| names.contains(&n);
        magnav::NEEDED.iter().all(|n| has(n)) && has("ins_lat") && !has("flight") && !has("line") && !has("ins_vn")
    },
    open,
    topics: None,
    made_from: None,
};

fn open(path: &Path, options: &FlightOptions, reading: &ReadHints) -> Result<RawFlight, ReadError> {
    let plain = (csv::FORMAT.open)(path, options, reading)?;
    let own = plain.schema.fields().iter().map(|f| f.name().clone()).collect();
    let none = RecordBatch::new_empty(plain.schema.clone());
    let schema = magnav::finish(path, table(path, &none, options)?, options)?.0.schema();
    let RawFlight { schema: in_file, parts, notes, found, .. } = plain;
    let (path, options) = (path.to_path_buf(), options.clone());
    let mut parts = Some((in_file, parts));
    let whole = std::iter::from_fn(move || parts.take().map(|(schema, parts)| flight(&path, &schema, parts, &options)));
    Ok(RawFlight { own: Some(own), notes, found, ..RawFlight::new(schema, Box::new(whole)) })
}

/// The whole flight, because derived columns depend on all rows.
fn flight(
    path: &Path,
    schema: &SchemaRef,
    parts: FlightBatches,
    options: &FlightOptions,
) -> Result<FlightBatch, ReadError> {
    let (mut batches, mut faults, mut rows) = (vec![], vec![], 0);
    for part in parts {
        let part = part?;
        faults.extend(part.faults.into_iter().map(|f| RowFault { row: rows + f.row, ..f }));
        rows += part.batch.num_rows();
        batches.push(part.batch);
    }
    let whole = concat_batches(schema, &batches).map_err(|e| ReadError::data(path, e.to_string()))?;
    if whole.num_rows() == 0 {
        return Err(ReadError::data(path, "has a header and no rows"));
    }
    let (table, more) = magnav::finish(path, table(path, &whole, options)?, options)?;
    faults.extend(more);
    faults.sort_by_key(|f| f.row);
    Ok(FlightBatch { batch: table.into_batch(path)?, faults })
}

fn table(path: &Path, batch: &RecordBatch, options: &FlightOptions) -> Result<ColumnTable, ReadError> {
    let mut table = ColumnTable::default();
    for (field, column) in batch.schema().fields().iter().zip(batch.columns()) {
        let own = field.name();
        let named = named(path, &[own], None, options)?;
        if table.has(&named.name) {
            return Err(ReadError::options(path, "two columns would have this name").in_column(&named.name));
        }
        let counted = if named.name == "ins_tt" { "s" } else { "" };
        let (unit, values) = match column.data_type() {
            DataType::Float64 => {
                let numbers = column.as_primitive::<Float64Type>().values().to_vec();
                let (unit, numbers) = in_counted_unit(path, own, &named, counted, numbers)?;
                (unit, ColumnValues::Number(numbers))
            }
            DataType::Int64 => (named.unit, ColumnValues::Whole(column.as_primitive::<Int64Type>().iter().collect())),
            _ => {
                let texts = column.as_string::<i32>().iter().map(|x| x.unwrap_or_default().to_owned());
                (named.unit, ColumnValues::Text(texts.collect()))
            }
        };
        table.push(&named.name, &unit, values);
    }
    Ok(table)
}
