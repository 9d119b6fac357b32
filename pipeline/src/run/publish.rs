//! The tables as anyone can read them: plain Parquet data sets with the axes as ordinary columns.

use std::{
    collections::BTreeSet,
    fs,
    path::{Component, Path, PathBuf},
    sync::Arc,
};

use arrow_array::{ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, StringArray, new_null_array};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use arrow_select::concat::concat_batches;
use rayon::prelude::*;
use schemas::{Column, Fault, Literal, Role, field};

use super::Failure;
use crate::{
    keys::Key,
    plan::{Graph, LineId, Plan, Point, Ref, TableNode, Unit},
    store::{Piece, RowGroup, Store, splice, write_parquet},
    views::warnings::Warning,
};

/// Writes the table `t` as far as `done` says that its units are there; one with `publish = false` is removed.
///
/// # Errors
/// When the store cannot be read or written.
pub fn table(graph: &Graph, store: &Store, t: usize, done: &(dyn Fn(Unit) -> bool + Sync)) -> Result<(), Fault> {
    let node = &graph.plan.tables[t];
    let folder = inside(store, &graph.plan.spec.name, &node.name)?;
    let wanted = graph.plan.spec.stages.iter().all(|s| s.name != node.name || s.publish);
    let written = if !wanted {
        vec![]
    } else if node.is_tidy() {
        tidy(graph, store, t, done)?
    } else {
        let mut lines: BTreeSet<LineId> = BTreeSet::new();
        lines.extend(graph.all_lines_of(t));
        let lines: Vec<LineId> = lines.into_iter().collect();
        let files = lines.into_par_iter().with_max_len(1).map(|line| one_line(graph, store, t, line, done));
        files.collect::<Result<Vec<_>, Fault>>()?.into_iter().flatten().collect()
    };
    only(&folder, &written)
}

/// The folder of a published table, which must lie in the store: files are removed from it.
fn inside(store: &Store, pipeline: &str, table: &str) -> Result<PathBuf, Fault> {
    let folder = store.table(pipeline, table);
    let one = |name: &str| {
        let parts: Vec<Component> = Path::new(name).components().collect();
        matches!(parts.as_slice(), [Component::Normal(part)] if *part == name)
    };
    let tables = store.root().join("tables").canonicalize();
    // What is not there yet is made below the last folder that is.
    let there = folder.ancestors().find(|f| f.symlink_metadata().is_ok()).map(Path::canonicalize);
    match (tables, there) {
        (Ok(tables), Some(Ok(there))) if one(pipeline) && one(table) && there.starts_with(&tables) => Ok(folder),
        _ => {
            let what = format!("the folder of the table, {}, leads out of the store", folder.display());
            Err(Fault::machine(what).help("remove the link; the table is written again"))
        }
    }
}

/// Removes what an earlier run left and this one did not write.
fn only(folder: &Path, written: &[PathBuf]) -> Result<(), Fault> {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let ours = entry.path().extension().is_some_and(|e| e == "parquet");
        if ours && !written.contains(&entry.path()) {
            fs::remove_file(entry.path())
                .map_err(|e| Fault::machine(format!("cannot remove {}: {e}", entry.path().display())))?;
        }
    }
    Ok(())
}

/// The schema of a published table: axes first.
fn schema(graph: &Graph, node: &TableNode) -> SchemaRef {
    let spec = &graph.plan.spec;
    let axes = node.axes.iter().filter_map(|i| spec.axes.get(*i));
    let axes = axes.map(|a| field(&a.name, axis_type(&a.values[0]), "", Role::Key, "axis of the sweep"));
    let taken: Vec<Field> = axes.collect();
    let columns = node.columns();
    let others = columns.iter().filter(|c| !taken.iter().any(|f| f.name() == &c.name)).map(Column::field);
    Arc::new(Schema::new(taken.iter().cloned().chain(others).collect::<Vec<_>>()))
}

/// The Arrow type of an axis column.
pub fn axis_type(value: &Literal) -> DataType {
    match value {
        Literal::Bool(_) => DataType::Boolean,
        Literal::Int(_) => DataType::Int64,
        Literal::Float(_) => DataType::Float64,
        Literal::Text(_) | Literal::List(_) => DataType::Utf8,
    }
}

/// An axis value, once for each row.
fn axis_values(value: &Literal, rows: usize) -> ArrayRef {
    match value {
        Literal::Bool(x) => Arc::new(BooleanArray::from(vec![*x; rows])),
        Literal::Int(x) => Arc::new(Int64Array::from(vec![*x; rows])),
        Literal::Float(x) => Arc::new(Float64Array::from(vec![*x; rows])),
        text => {
            let text = text.to_string();
            Arc::new(StringArray::from(vec![text.as_str(); rows]))
        }
    }
}

/// A name for the file of a line, which no other line has.
fn file_name(flight: &str, line: &str) -> String {
    let plain = |s: &str| {
        s.chars().map(|c| if c.is_ascii_alphanumeric() || ".-".contains(c) { c } else { '_' }).collect::<String>()
    };
    let name = format!("{}_{}", plain(flight), plain(line));
    let exact = !flight.contains('_') && !line.contains('_') && plain(flight) == flight && plain(line) == line;
    if exact && name.len() < 100 {
        return format!("{name}.parquet");
    }
    let short: String = name.chars().take(80).collect();
    format!("{short}_{}.parquet", &Key::of([flight, line]).to_string()[..8])
}

/// One line at every point of the sweep: a row group a point, shared columns stored once.
fn one_line(
    graph: &Graph,
    store: &Store,
    t: usize,
    line: LineId,
    done: &(dyn Fn(Unit) -> bool + Sync),
) -> Result<Option<PathBuf>, Fault> {
    let node = &graph.plan.tables[t];
    let schema = schema(graph, node);
    let mut groups = vec![];
    for (i, it) in graph.plan.instances(t).enumerate() {
        if !done(Unit { table: t, instance: i, line: Some(line) }) || !graph.lines_of(t, i).contains(&line) {
            continue;
        }
        let object = graph.object(Ref::Stage(t, i), line)?;
        let rows = rows_of(store, object)?;
        if rows == 0 {
            continue;
        }
        let axes = node.axis_columns(&it, &graph.plan.spec);
        let piece = |f: &Arc<Field>| -> Result<Piece, Fault> {
            if let Some((_, value)) = axes.iter().find(|(n, _)| *n == f.name()) {
                return Ok(Piece::Values(axis_values(value, rows)));
            }
            let nothing = || Piece::Values(new_null_array(f.data_type(), rows));
            if it.table.shape().get(f.name()).is_none() {
                return Ok(nothing());
            }
            let origin = graph.origin(Ref::Stage(t, i), f.name());
            if let Ref::Flights(s) = origin.made_by
                && graph.records[s].get(&line).is_some_and(|l| !l.columns.contains_key(&origin.column))
            {
                return Ok(nothing());
            }
            let object = store.object(graph.object(origin.made_by, line)?);
            Ok(Piece::Chunk { object, column: origin.column })
        };
        let pieces = schema.fields().iter().map(piece).collect::<Result<Vec<_>, Fault>>()?;
        groups.push(RowGroup { rows, pieces });
    }
    if groups.is_empty() {
        return Ok(None);
    }
    let (flight, name) = &graph.lines[line];
    let to = store.table(&graph.plan.spec.name, &node.name).join(file_name(flight, name));
    let tmp = store.temporary();
    splice(&tmp, &schema, &groups)?;
    store.settle(&tmp, &to)?;
    Ok(Some(to))
}

fn rows_of(store: &Store, object: Key) -> Result<usize, Fault> {
    let path = store.object(object);
    let file = fs::File::open(&path).map_err(|e| Fault::machine(format!("cannot read {}: {e}", path.display())))?;
    let metadata = parquet::file::metadata::ParquetMetaDataReader::new().parse_and_finish(&file);
    let metadata = metadata.map_err(|e| {
        Fault::machine(format!("cannot read {}: {e}", path.display())).help("remove the file, and it is computed again")
    })?;
    Ok(usize::try_from(metadata.file_metadata().num_rows()).unwrap_or(0))
}

/// A small table in one file, in the order of the sweep, then of the lines.
fn tidy(graph: &Graph, store: &Store, t: usize, done: &(dyn Fn(Unit) -> bool + Sync)) -> Result<Vec<PathBuf>, Fault> {
    let node = &graph.plan.tables[t];
    let schema = schema(graph, node);
    let mut batches = vec![];
    for unit in graph.units(t).filter(|u| done(*u)) {
        let it = graph.plan.instance(t, unit.instance);
        let names: Vec<&str> = it.yields.columns.iter().map(|c| c.name.as_str()).collect();
        let batch = store.get(graph.key(unit)?, &names)?;
        let axes = node.axis_columns(&it, &graph.plan.spec);
        let column = |f: &Arc<Field>| match axes.iter().find(|(n, _)| *n == f.name()) {
            Some((_, value)) => axis_values(value, batch.num_rows()),
            None => batch
                .column_by_name(f.name())
                .cloned()
                .unwrap_or_else(|| new_null_array(f.data_type(), batch.num_rows())),
        };
        let columns = schema.fields().iter().map(column).collect();
        batches.push(RecordBatch::try_new(schema.clone(), columns).map_err(|e| Fault::machine(e.to_string()))?);
    }
    let whole = concat_batches(&schema, &batches).map_err(|e| Fault::machine(e.to_string()))?;
    let to = store.table(&graph.plan.spec.name, &node.name).join("part-0.parquet");
    let tmp = store.temporary();
    write_parquet(&tmp, &whole)?;
    store.settle(&tmp, &to)?;
    Ok(vec![to])
}

/// Writes what failed, also when nothing did.
///
/// # Errors
/// When the store cannot be written.
pub fn failures(plan: &Plan, store: &Store, failures: &[Failure]) -> Result<(), Fault> {
    let text = |f: &dyn Fn(&Failure) -> Option<String>| -> ArrayRef {
        Arc::new(failures.iter().map(f).collect::<StringArray>())
    };
    let points: Vec<&Point> = failures.iter().map(|f| &f.point).collect();
    let columns = vec![
        ("flight", text(&|f| f.line.as_ref().map(|l| l.0.clone())), "flight identifier"),
        ("line", text(&|f| f.line.as_ref().map(|l| l.1.clone())), "line identifier"),
        ("stage", text(&|f| Some(f.table.clone())), "the table that could not be computed"),
        ("error", text(&|f| Some(f.fault.to_string())), "why"),
    ];
    beside(plan, store, "failures", &points, columns)
}

/// Writes what is not to be trusted as it is, also when there is nothing of the kind.
///
/// # Errors
/// When the store cannot be written.
pub fn warnings(plan: &Plan, store: &Store, warnings: &[Warning]) -> Result<(), Fault> {
    let text = |f: &dyn Fn(&Warning) -> Option<String>| -> ArrayRef {
        Arc::new(warnings.iter().map(f).collect::<StringArray>())
    };
    let number =
        |f: fn(&Warning) -> Option<f64>| -> ArrayRef { Arc::new(warnings.iter().map(f).collect::<Float64Array>()) };
    let points: Vec<&Point> = warnings.iter().map(|w| &w.point).collect();
    let columns = vec![
        ("flight", text(&|w| w.line.as_ref().map(|l| l.0.clone())), "flight identifier; null for a fit"),
        ("line", text(&|w| w.line.as_ref().map(|l| l.1.clone())), "line identifier; null for a fit"),
        ("stage", text(&|w| Some(w.stage.clone())), "the table of scores or models"),
        ("kind", text(&|w| Some(w.kind.as_str().to_owned())), "what it is about"),
        ("value", number(|w| w.value), "the figure that gave rise to it; null for a fit"),
        ("limit", number(|w| w.limit), "what the figure is held against"),
        ("unit", text(&|w| Some(w.unit.to_owned())), "the unit of both"),
        ("text", text(&|w| Some(w.text.clone())), "what is wrong"),
        ("cause", text(&|w| w.cause.clone()), "what is likely to be behind it; null where that is not known"),
    ];
    beside(plan, store, "warnings", &points, columns)
}

/// A table beside those of the stages: the axes of the whole sweep (null where a row has no value of one), then `columns`
/// of name, values and meaning. An axis has its name before a column.
fn beside(
    plan: &Plan,
    store: &Store,
    name: &str,
    points: &[&Point],
    columns: Vec<(&str, ArrayRef, &str)>,
) -> Result<(), Fault> {
    let mut fields = vec![];
    let mut arrays: Vec<ArrayRef> = vec![];
    for axis in &plan.spec.axes {
        let kind = axis_type(&axis.values[0]);
        let cells: Vec<ArrayRef> = points
            .iter()
            .map(|p| p.get(&axis.name).map_or_else(|| new_null_array(&kind, 1), |v| axis_values(v, 1)))
            .collect();
        let cells: Vec<&dyn arrow_array::Array> = cells.iter().map(AsRef::as_ref).collect();
        let all = if cells.is_empty() {
            new_null_array(&kind, 0)
        } else {
            arrow_select::concat::concat(&cells).map_err(|e| Fault::machine(e.to_string()))?
        };
        fields.push(field(&axis.name, kind, "", Role::Key, "axis of the sweep"));
        arrays.push(all);
    }
    for (name, array, about) in columns {
        if fields.iter().any(|f: &Field| f.name() == name) {
            continue;
        }
        let role = if array.data_type() == &DataType::Float64 { Role::Derived } else { Role::Key };
        fields.push(field(name, array.data_type().clone(), "", role, about));
        arrays.push(array);
    }
    let batch =
        RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).map_err(|e| Fault::machine(e.to_string()))?;
    let to = inside(store, &plan.spec.name, name)?.join("part-0.parquet");
    let tmp = store.temporary();
    write_parquet(&tmp, &batch)?;
    store.settle(&tmp, &to)
}
