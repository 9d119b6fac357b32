//! Simple flights of MagNav.jl in CSV: the plain CSV reader's columns, with what is derived added.

use std::path::Path;

use arrow_array::{Array, RecordBatch, cast::AsArray, types::Float64Type, types::Int64Type};
use arrow_schema::DataType;
use arrow_select::concat::concat_batches;

use super::{FlightFormat, FlightOptions, Head, Raw, csv, magnav};
use crate::{
    ReadError,
    table::{Table, Values},
};

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "magnav_csv",
    about: "simple flight of MagNav.jl (XYZ0, XYZ1) in CSV",
    extensions: &[],
    recognise: |head: &Head| {
        let header = head.first_line().unwrap_or_default();
        let names: Vec<&str> = header.split(',').map(str::trim).collect();
        let has = |n: &str| names.contains(&n);
        magnav::NEEDED.iter().all(|n| has(n)) && has("ins_lat") && !has("flight") && !has("line") && !has("ins_vn")
    },
    open,
};

fn open(path: &Path, options: &FlightOptions) -> Result<Raw, ReadError> {
    let plain = (csv::FORMAT.open)(path, options)?;
    let batches = plain.batches.collect::<Result<Vec<_>, _>>()?;
    let whole = concat_batches(&plain.schema, &batches).map_err(|e| ReadError::data(path, e.to_string()))?;
    if whole.num_rows() == 0 {
        return Err(ReadError::data(path, "holds a header and no rows"));
    }
    let table = magnav::finish(path, table(&whole), options)?;
    let (schema, batch) = (table.schema(), table.into_batch(path)?);
    Ok(Raw { schema, batches: Box::new(std::iter::once(Ok(batch))) })
}

fn table(batch: &RecordBatch) -> Table {
    let mut table = Table::default();
    for (field, column) in batch.schema().fields().iter().zip(batch.columns()) {
        let values = match column.data_type() {
            DataType::Float64 => Values::Number(column.as_primitive::<Float64Type>().values().to_vec()),
            DataType::Int64 => Values::Whole(column.as_primitive::<Int64Type>().iter().collect()),
            _ => Values::Text(column.as_string::<i32>().iter().map(|x| x.unwrap_or_default().to_owned()).collect()),
        };
        let unit = if field.name() == "ins_tt" { "s" } else { "" };
        table.push(field.name(), unit, values);
    }
    table
}
