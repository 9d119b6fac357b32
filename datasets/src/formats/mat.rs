//! MATLAB files of version 5 to 7 (either byte order, deflated or not) and 7.3 (HDF5). Each matrix or structure is a
//! topic. The vectors at the root form the topic `.`. The columns of a matrix `X` take their names from a cell array
//! `X_label`; without it they are `X[0]`, `X[1]` and so on. The columns of nested structures are named `a.b`. Vectors
//! of an uncommon length are a separate topic named with the length: `log:1531`.
//!
//! Only the variables of one topic are in memory at a time. The file has no units.

use std::{collections::BTreeSet, path::Path};

use self::tree::{MatContents, MatTable, tables};
use super::{
    FileHead, FlightBatch, FlightFormat, FlightOptions, LogTopic, RawFlight, ReadHints, TopicColumn, topics::chosen,
};
use crate::{ReadError, table::ColumnTable};

pub(super) mod map;
mod tree;
mod v5;
mod v73;

pub(super) const FORMAT: FlightFormat = FlightFormat {
    name: "mat",
    about: "MATLAB 5 to 7.3; `topic` is a matrix, a structure, or `.` for the vectors at the root",
    extensions: &["mat"],
    recognise: |head: &FileHead| head.starts_with(V5) || is_v73(head),
    open,
    topics: Some(topics),
    made_from: None,
};

const V5: &[u8] = b"MATLAB 5.0 MAT-file";

/// The headers of the first files of version 7.3 contain the version 7.0.
fn is_v73(head: &FileHead) -> bool {
    head.starts_with(b"MATLAB 7.") && head.has_at(512, super::hdf5::MAGIC)
}

/// Rows of a batch.
const ROWS: usize = 65_536;

fn read(path: &Path, keep: &dyn Fn(&str) -> bool) -> Result<MatContents, ReadError> {
    let head = FileHead::read(path)?;
    if is_v73(&head) {
        return v73::read(path, keep);
    }
    if head.starts_with(V5) {
        return v5::read(path, keep);
    }
    let what =
        "the file is not a MATLAB file of version 5 to 7.3: its header must start with `MATLAB 5.0` or `MATLAB 7.3`";
    Err(ReadError::data(path, what).help("load an older file in MATLAB and save it with `save(name, '-v7')`"))
}

fn topics(path: &Path, _: &FlightOptions) -> Result<Vec<LogTopic>, ReadError> {
    let column = |c: tree::MatColumn| TopicColumn { name: c.name, unit: String::new(), description: String::new() };
    let topic = |MatTable { name, rows, columns }: MatTable| {
        let columns = columns.into_iter().map(column).collect();
        LogTopic { name, rows, columns, note: String::new() }
    };
    Ok(tables(read(path, &|_| false)?.nodes).into_iter().map(topic).collect())
}

fn open(path: &Path, options: &FlightOptions, _: &ReadHints) -> Result<RawFlight, ReadError> {
    let MatContents { nodes, notes: damage } = read(path, &|_| false)?;
    let skipped = tree::skipped(&nodes);
    let mut drafts = tables(nodes);
    let names: Vec<(String, u64)> = drafts.iter().map(|d| (d.name.clone(), d.rows)).collect();
    let found = chosen(path, options.topic.as_deref(), &names);
    let number = found.map_err(|e| match damage.first() {
        Some(damage) => ReadError::data(path, format!("{damage}; {}", e.fault().what)),
        None => e,
    })?;
    let MatTable { name, columns, .. } = drafts.swap_remove(number);
    let variables: BTreeSet<String> = columns.into_iter().map(|c| c.variable).collect();
    let MatContents { nodes, notes } = read(path, &|name| variables.contains(name))?;
    let now = tree::skipped(&nodes);
    let draft = tables(nodes).into_iter().find(|d| d.name == name);
    let Some(MatTable { columns, .. }) = draft else {
        let what = notes.first().map_or("cannot be read", String::as_str);
        return Err(ReadError::data(path, format!("the topic `{name}`: {what}")));
    };
    let mut table = ColumnTable::default();
    for column in columns {
        if let Some(values) = column.values {
            table.push(&column.name, "", values);
        }
    }
    let file = path.display();
    let mut notes: Vec<String> = notes.into_iter().map(|note| format!("{file}: {note}")).collect();
    let skipped: BTreeSet<String> = skipped.into_iter().chain(now).collect();
    if !skipped.is_empty() {
        notes.push(format!("{file}: ignored: {}", Vec::from_iter(skipped).join(", ")));
    }
    let (schema, batch) = (table.schema(), table.into_batch(path)?);
    let starts = (0..batch.num_rows()).step_by(ROWS);
    let parts: Vec<_> =
        starts.map(|at| Ok(FlightBatch::whole(batch.slice(at, ROWS.min(batch.num_rows() - at))))).collect();
    Ok(RawFlight { fillers: true, notes, ..RawFlight::new(schema, Box::new(parts.into_iter())) })
}

#[cfg(test)]
mod tests;
