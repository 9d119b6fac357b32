//! Navigation filters on arrays: the stage `navigate` on one line in memory.

use std::sync::Arc;

use arrow_array::{
    Array, ArrayRef, FixedSizeListArray, Float64Array, RecordBatch, StringArray, cast::AsArray, types::Float64Type,
};
use arrow_schema::{DataType, Field, Schema};
use numpy::{PyArray1, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pipeline::results::warnings::{LineMetrics, NavigationSettings, NavigationSide, Warning, of_navigation};
use pyo3::{
    prelude::*,
    types::{PyBool, PyFloat, PyInt, PyList},
};
use schemas::{
    AnyStage, Column, Fault, LineInput, Literal, SpecEntries, SpecEntry, StageEntry, StageSchema, Table, TableShape,
    describe_field, field, flight,
};
use serde_json::{Value, json};

use crate::{
    attended::attended,
    faults::{exceptions, value_error},
    maps::MapArrays,
    parts::{catalogue, settle},
};

/// Name, unit and values of a column.
type TrackColumn<'py> = (String, String, Bound<'py, PyAny>);

/// Coefficients of a calibration: terms, values, standard deviations, and the sample rate of the fit, in Hz.
type Calibration = (Vec<String>, Vec<f64>, Vec<f64>, Option<f64>);

/// Filters a line with the stage `navigate`. `keys` are the parameters of the stage. `line` has the columns of the
/// flight: numbers, text, or a matrix with the names of its entries. `rate_hz` is the sample rate at which the
/// differences in a matrix were computed. Returns the columns of the stage, its notes, and the warnings of the track as
/// JSON.
#[pyfunction]
#[pyo3(signature = (keys, line, rate_hz, map, models))]
pub fn navigate<'py>(
    py: Python<'py>,
    keys: Vec<(String, Bound<'py, PyAny>)>,
    line: Vec<(String, Bound<'py, PyAny>)>,
    rate_hz: Option<f64>,
    map: Option<MapArrays<'py>>,
    models: Vec<Calibration>,
) -> PyResult<(Vec<TrackColumn<'py>>, Vec<String>, String)> {
    settle(py)?;
    let mut args = SpecEntries::new();
    for (key, value) in keys {
        args.insert(key, SpecEntry { value: literal(&value)?, key_at: 0..0, at: 0..0 });
    }
    let columns = line.iter().map(|(name, value)| column(name, value, rate_hz));
    let line = batch(columns.collect::<PyResult<_>>()?).map_err(value_error)?;
    let map = map.map(|map| map.table(py)).transpose()?;
    let models = models.into_iter().map(model).collect::<Result<_, _>>().map_err(value_error)?;
    let work = move || ArrayNavigation { line, map, models }.run(&args);
    let Navigated { track, notes, warnings } = attended(py, work, || ())?.map_err(|faults| exceptions(py, &faults))?;
    let mut made = vec![];
    for (field, array) in track.schema_ref().fields().iter().zip(track.columns()) {
        let unit = describe_field(field).unit;
        made.push((field.name().clone(), unit, values(py, array)?));
    }
    let warnings: Vec<Value> = warnings.iter().map(warning).collect();
    Ok((made, notes, Value::from(warnings).to_string()))
}

/// Value of a key.
fn literal(value: &Bound<'_, PyAny>) -> PyResult<Literal> {
    Ok(if value.is_instance_of::<PyBool>() {
        Literal::Bool(value.extract()?)
    } else if value.is_instance_of::<PyInt>() {
        Literal::Int(value.extract()?)
    } else if value.is_instance_of::<PyFloat>() {
        Literal::Float(value.extract()?)
    } else if let Ok(items) = value.cast::<PyList>() {
        Literal::List(items.iter().map(|item| literal(&item)).collect::<PyResult<_>>()?)
    } else {
        Literal::Text(value.extract()?)
    })
}

/// Column of a flight, with the unit and role that follow from its name.
fn column(name: &str, value: &Bound<'_, PyAny>, rate_hz: Option<f64>) -> PyResult<(Field, ArrayRef)> {
    let known = flight::describe(name);
    let of_type = |data_type| field(name, data_type, known.unit, known.role, known.description);
    if let Ok(numbers) = value.extract::<PyReadonlyArray1<'_, f64>>() {
        let array: ArrayRef = Arc::new(Float64Array::from(numbers.as_slice()?.to_vec()));
        return Ok((of_type(DataType::Float64), array));
    }
    if let Ok(texts) = value.extract::<Vec<String>>() {
        return Ok((of_type(DataType::Utf8), Arc::new(StringArray::from(texts))));
    }
    let (matrix, names): (PyReadonlyArray2<'_, f64>, Vec<String>) = value.extract()?;
    let width = i32::try_from(names.len()).map_err(value_error)?;
    let mut column = Column::list(name, known.unit, known.description, names).role(known.role);
    column.sampling.rate_hz = rate_hz.filter(|_| !column.sampling.entries.is_empty());
    let item = Arc::new(Field::new("item", DataType::Float64, false));
    let numbers = Arc::new(Float64Array::from(matrix.as_slice()?.to_vec()));
    let list = FixedSizeListArray::try_new(item, width, numbers, None).map_err(value_error)?;
    Ok((column.field(), Arc::new(list)))
}

fn batch(columns: Vec<(Field, ArrayRef)>) -> Result<RecordBatch, arrow_schema::ArrowError> {
    let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) = columns.into_iter().unzip();
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays)
}

/// Table of a calibration.
fn model((terms, values, sigmas, rate_hz): Calibration) -> Result<RecordBatch, arrow_schema::ArrowError> {
    let rows = terms.len();
    let number = |name: &str, values: Vec<f64>| -> (Field, ArrayRef) {
        (Column::float(name, "", "").field(), Arc::new(Float64Array::from(values)))
    };
    let mut columns: Vec<(Field, ArrayRef)> =
        vec![(Column::text("term", "").field(), Arc::new(StringArray::from(terms)))];
    columns.extend([number("value", values), number("std", sigmas)]);
    columns.extend(rate_hz.map(|rate_hz| number("rate_hz", vec![rate_hz; rows])));
    batch(columns)
}

/// Numbers as an array of one or two dimensions, or a list of text.
fn values<'py>(py: Python<'py>, array: &ArrayRef) -> PyResult<Bound<'py, PyAny>> {
    if let Some(texts) = array.as_string_opt::<i32>() {
        return texts.iter().collect::<Vec<Option<&str>>>().into_pyobject(py).map(Bound::into_any);
    }
    let list = array.as_fixed_size_list_opt();
    let numbers = list.map_or(array, |list| list.values());
    let numbers = numbers.as_primitive_opt::<Float64Type>().ok_or_else(|| value_error("a column has no numbers"))?;
    let flat = PyArray1::from_slice(py, numbers.values());
    match list {
        Some(list) => {
            let width = usize::try_from(list.value_length()).map_err(value_error)?;
            Ok(flat.reshape([list.len(), width])?.into_any())
        }
        None => Ok(flat.into_any()),
    }
}

/// Attributes of the Python class `TrackWarning`.
fn warning(one: &Warning) -> Value {
    let Warning { kind, value, limit, unit, text, cause, .. } = one;
    json!({ "kind": kind.as_str(), "value": value, "limit": limit, "unit": unit, "text": text, "cause": cause })
}

/// One line in memory with the other inputs of `navigate`.
struct ArrayNavigation {
    line: RecordBatch,
    map: Option<RecordBatch>,
    models: Vec<RecordBatch>,
}

/// Result of a navigation.
struct Navigated {
    track: RecordBatch,
    notes: Vec<String>,
    warnings: Vec<Warning>,
}

impl ArrayNavigation {
    fn run(&self, args: &SpecEntries) -> Result<Navigated, Vec<Fault>> {
        let entries = catalogue();
        let stage = (entry(&entries, "navigate").map_err(alone)?.build)(args)?;
        let idle: Vec<Fault> = args.keys().filter_map(|key| stage.unused_key(key)).collect();
        if !idle.is_empty() {
            return Err(idle);
        }
        let mut tables = vec![Table::Lines(TableShape::from_schema(&self.line.schema()))];
        tables.extend(self.map.iter().map(|map| match map.column_by_name(schemas::map::ERROR) {
            Some(_) => Table::Map(schemas::map::shape_with_error()),
            None => Table::Map(schemas::map::shape()),
        }));
        let shape = |model: &RecordBatch| TableShape::from_schema(&model.schema());
        tables.extend(self.models.iter().map(|model| Table::Model { shape: shape(model), features: vec![] }));
        let yields = stage.yields(&tables.iter().collect::<Vec<_>>())?;
        let track = self.track(&stage, &yields).map_err(alone)?;
        let warnings = self.warnings(&entries, &stage, &track).map_err(alone)?;
        Ok(Navigated { track, notes: yields.notes, warnings })
    }

    /// Columns of the stage.
    fn track(&self, stage: &AnyStage, yields: &StageSchema) -> Result<RecordBatch, Fault> {
        let stage = stage.of_lines()?;
        let empty = RecordBatch::new_empty(Arc::new(Schema::empty()));
        let shared: Vec<RecordBatch> = [&empty].into_iter().chain(&self.map).chain(&self.models).cloned().collect();
        let prepared = stage.prepare(&shared)?;
        let read = selected(&self.line, yields.reads.first().map_or(&[], Vec::as_slice))?;
        let inputs = [read].into_iter().chain(shared.iter().skip(1).map(|_| empty.clone())).collect();
        let arrays = stage.run(&line_input(inputs), &prepared)?;
        let columns = yields.columns.iter().map(Column::field).zip(arrays).collect();
        batch(columns).map_err(|e| Fault::bug(e.to_string()))
    }

    /// Warnings of the track, from its scores.
    fn warnings(&self, entries: &[StageEntry], stage: &AnyStage, track: &RecordBatch) -> Result<Vec<Warning>, Fault> {
        let row = self.scores(entries, track)?;
        let first = |side: NavigationSide, name: &str| {
            let table = match side {
                NavigationSide::Flight => &self.line,
                NavigationSide::Track => track,
            };
            let column = table.column_by_name(name).and_then(|array| array.as_primitive_opt::<Float64Type>());
            Ok(column.and_then(|column| column.values().first()).copied().filter(|value| value.is_finite()))
        };
        let last = |name: &str| {
            let column = track.column_by_name(name).and_then(|array| array.as_primitive_opt::<Float64Type>());
            column.and_then(|column| column.values().last()).copied().filter(|value| value.is_finite())
        };
        let constant = |name: &str| last(name).zip(last(&format!("{name}_sigma")));
        let settings = NavigationSettings {
            gnss_rejected_s: self.gnss_rejected_s(track),
            lag_s: constant("mag_latency"),
            height_bias_m: constant("map_height_bias"),
            ..NavigationSettings::new(&stage.canonical(), first)?
        };
        Ok(of_navigation(&row, settings))
    }

    /// All built-in metrics that can be computed from the line and its track.
    fn scores(&self, entries: &[StageEntry], track: &RecordBatch) -> Result<LineMetrics, Fault> {
        let score = (entry(entries, "score")?.build)(&SpecEntries::new()).map_err(first_of)?;
        let time = selected(&self.line, &["tt".to_owned()])?;
        let mut columns: Vec<(Field, ArrayRef)> = vec![];
        for table in [&time, track] {
            let fields = table.schema_ref().fields().iter().map(|field| field.as_ref().clone());
            columns.extend(fields.zip(table.columns().iter().cloned()));
        }
        let track = batch(columns).map_err(|e| Fault::bug(e.to_string()))?;
        let tables = [&self.line, &track].map(|table| Table::Lines(TableShape::from_schema(&table.schema())));
        let yields = score.yields(&tables.iter().collect::<Vec<_>>()).map_err(first_of)?;
        let read = |(table, names): (&RecordBatch, &Vec<String>)| selected(table, names);
        let inputs = [&self.line, &track].into_iter().zip(&yields.reads).map(read).collect::<Result<_, Fault>>()?;
        let score = score.of_lines()?;
        let prepared = score.prepare(&[])?;
        let arrays = score.run(&line_input(inputs), &prepared)?;
        let columns = yields.columns.iter().map(Column::field).zip(arrays).collect();
        Ok(LineMetrics::read(&batch(columns).map_err(|e| Fault::bug(e.to_string()))?))
    }

    /// Time of the first rejected GNSS position, in seconds from the start of the line.
    fn gnss_rejected_s(&self, track: &RecordBatch) -> Option<f64> {
        let updates = track.column_by_name("gnss_update")?.as_string_opt::<i32>()?;
        let row = updates.iter().position(|update| update == Some("rejected"))?;
        let tt = self.line.column_by_name("tt")?.as_primitive_opt::<Float64Type>()?.values();
        Some(tt.get(row)? - tt.first()?)
    }
}

fn line_input(inputs: Vec<RecordBatch>) -> LineInput {
    LineInput { flight: String::new(), line: String::new(), inputs, keep: None }
}

/// The columns `names` of a table, in this order.
fn selected(table: &RecordBatch, names: &[String]) -> Result<RecordBatch, Fault> {
    let places = names.iter().map(|name| table.schema_ref().index_of(name)).collect::<Result<Vec<_>, _>>();
    places.and_then(|places| table.project(&places)).map_err(|e| Fault::bug(e.to_string()))
}

fn entry<'a>(entries: &'a [StageEntry], name: &str) -> Result<&'a StageEntry, Fault> {
    entries.iter().find(|entry| entry.name == name).ok_or_else(|| Fault::bug(format!("there is no stage `{name}`")))
}

fn alone(fault: Fault) -> Vec<Fault> {
    vec![fault]
}

fn first_of(faults: Vec<Fault>) -> Fault {
    faults.into_iter().next().unwrap_or_else(|| Fault::bug("an error has no message"))
}
