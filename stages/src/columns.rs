//! Functions that several stages share: access to columns, and checks of columns and parameters.

use arrow_array::{Array, ArrayRef, FixedSizeListArray, Float64Array, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_schema::{DataType, Field};
use numerics::signal::segments::{STEP_TOLERANCE, sample_rate};
use schemas::{Column, ColumnType, Fault, RateDependence, Role, Table, TableShape};
use std::sync::Arc;

/// Values of a numeric column, borrowed.
///
/// # Errors
/// Fails if the column is missing or does not hold numbers.
pub fn floats<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a [f64], Fault> {
    let array = batch.column_by_name(name).ok_or_else(|| absent(name))?;
    let array = array.as_primitive_opt::<Float64Type>().ok_or_else(|| not_numbers(name))?;
    Ok(array.values())
}

/// List column, borrowed as a row-major matrix, with the names of its entries.
///
/// # Errors
/// Fails if the column is missing or is not a list of numbers.
pub fn matrix<'a>(batch: &'a RecordBatch, name: &str) -> Result<(&'a [f64], Vec<String>), Fault> {
    let schema = batch.schema();
    let field = schema.field_with_name(name).map_err(|_| absent(name))?;
    let ColumnType::List(terms) = schemas::describe_field(field).column_type else { return Err(not_numbers(name)) };
    let list = batch.column_by_name(name).and_then(|a| a.as_fixed_size_list_opt()).ok_or_else(|| not_numbers(name))?;
    let values = list.values().as_primitive_opt::<Float64Type>().ok_or_else(|| not_numbers(name))?;
    let width = usize::try_from(list.value_length()).unwrap_or(0);
    let from = list.offset() * width;
    let values = values.values().get(from..from + list.len() * width).ok_or_else(|| not_numbers(name))?;
    Ok((values, terms))
}

fn absent(name: &str) -> Fault {
    Fault::data(format!("the line has no column `{name}`")).in_column(name)
}

fn not_numbers(name: &str) -> Fault {
    Fault::data("does not hold numbers").in_column(name)
}

/// Sample rate of evenly spaced times (s), in Hz.
///
/// # Errors
/// Returns the errors of [`sample_rate`], for the column `tt`.
pub fn even_rate_hz(tt_s: &[f64]) -> Result<f64, Fault> {
    sample_rate(tt_s, STEP_TOLERANCE)
        .map_err(|e| data(e).in_column("tt").help("add a `resample` stage before this one"))
}

/// Sample rate of the differences in a list column, in Hz. It is `rate_hz` of the column's metadata, or otherwise the
/// sample rate of the line.
///
/// # Errors
/// Fails if the metadata have no `rate_hz` and the samples are not evenly spaced.
pub fn list_rate_hz(batch: &RecordBatch, sampling: &RateDependence) -> Result<f64, Fault> {
    match sampling.rate_hz {
        Some(rate_hz) => Ok(rate_hz),
        None => even_rate_hz(floats(batch, "tt")?),
    }
}

/// Rate dependence of the entries of a list column. If an entry depends on the rate, the rate in Hz is included.
///
/// # Errors
/// Fails if the column is missing, or if its rate is needed but unknown.
pub fn sampling(batch: &RecordBatch, name: &str) -> Result<RateDependence, Fault> {
    let schema = batch.schema();
    let field = schema.field_with_name(name).map_err(|_| absent(name))?;
    let mut sampling = schemas::describe_field(field).sampling;
    if !sampling.entries.is_empty() {
        sampling.rate_hz = Some(list_rate_hz(batch, &sampling)?);
    }
    Ok(sampling)
}

/// Factor that converts an entry made at `from_hz` for a model fitted at `to_hz`. It is 1 if the entry does not depend
/// on the rate.
///
/// # Errors
/// Fails for an entry that depends on the rate, if the model's rate is unknown or the entry has no equivalent at that
/// rate.
pub fn rate_factor(sampling: &RateDependence, entry: &str, to_hz: Option<f64>) -> Result<f64, Fault> {
    let (Some(law), Some(from_hz)) = (sampling.law(entry), sampling.rate_hz) else { return Ok(1.0) };
    let Some(to_hz) = to_hz else {
        let what = format!("`{entry}` is a difference per sample, but the model table has no `rate_hz`");
        return Err(Fault::data(what).help("fit the model again; `fit` writes `rate_hz` to its table"));
    };
    law.factor(from_hz, to_hz).ok_or_else(|| {
        let what = format!(
            "`{entry}` is the value of an earlier sample, but the line is sampled at {from_hz} Hz and the model was \
             fitted at {to_hz} Hz"
        );
        Fault::data(what).help(format!("add a `resample` stage at {to_hz} Hz before `features`"))
    })
}

/// Numbers as an array.
pub fn array(values: Vec<f64>) -> ArrayRef {
    Arc::new(Float64Array::from(values))
}

/// A row-major matrix as a list column, `width` entries a row.
///
/// # Errors
/// Fails if the values are not a whole number of rows, or the width does not fit an `i32`.
pub fn list(values: Vec<f64>, width: usize) -> Result<ArrayRef, Fault> {
    let item = Arc::new(Field::new("item", DataType::Float64, false));
    let width = i32::try_from(width).map_err(|e| Fault::data(e.to_string()))?;
    let list = FixedSizeListArray::try_new(item, width, Arc::new(Float64Array::from(values)), None);
    list.map(|l| Arc::new(l) as ArrayRef).map_err(|e| Fault::data(e.to_string()))
}

/// The shape of a table of flight lines.
///
/// # Errors
/// Fails if the input is missing.
pub fn shape<'a>(inputs: &[&'a Table], i: usize) -> Result<&'a TableShape, Vec<Fault>> {
    inputs.get(i).map(|t| t.shape()).ok_or_else(|| vec![Fault::new("an input is missing")])
}

/// The columns of the vector magnetometer `name`: nose, right, down.
pub fn vector_axes(name: &str) -> [String; 3] {
    ["x", "y", "z"].map(|axis| format!("{name}_{axis}"))
}

/// Rejects a truth column as a feature, unless truth columns are allowed.
///
/// # Errors
/// Fails if the column is a truth column and truth columns are not allowed.
pub fn no_truth(column: &Column, param: &str, allowed: bool) -> Result<(), Fault> {
    if column.role != Role::Truth || allowed {
        return Ok(());
    }
    let what = format!("`{}` is a truth column and cannot be a feature", column.name);
    Err(Fault::new(what).of_param(param).help("set `allow_truth = true` to permit truth columns"))
}

/// Role of a column that is computed from the columns `names`: truth if one of them is truth.
pub fn role_of<S: AsRef<str>>(shape: &TableShape, names: &[S]) -> Role {
    let truth = names.iter().filter_map(|name| shape.get(name.as_ref())).any(|column| column.role == Role::Truth);
    if truth { Role::Truth } else { Role::Derived }
}

/// Faults of `names`, the value of `param`: an empty list, a duplicate, and columns that are missing or do not hold
/// numbers.
pub fn not_numbers_among(shape: &TableShape, names: &[String], param: &str) -> Vec<Fault> {
    let mut faults = faults_of(names.iter().map(|c| shape.need(c).and_then(|x| shape.number(c, &x.unit))), param);
    if names.is_empty() {
        faults.push(Fault::new("the list of columns is empty").of_param(param));
    }
    let twice = names.iter().enumerate().find(|(i, name)| names[..*i].contains(name));
    faults.extend(twice.map(|(_, name)| Fault::new(format!("`{name}` is listed twice")).of_param(param)));
    faults
}

/// Columns `<name><suffix>`, each computed from one of `names` and the time. `unit` returns the unit of the new column
/// for the unit of its source.
pub fn made_of_each(
    shape: &TableShape,
    names: &[String],
    suffix: &str,
    done: &str,
    unit: impl Fn(&str) -> String,
) -> Vec<Column> {
    let one = |name: &String| {
        let unit = shape.get(name).map(|c| unit(&c.unit)).unwrap_or_default();
        let column = Column::float(format!("{name}{suffix}"), unit, format!("{name}, {done}"));
        let column = crate::corrections::like(column, shape, name);
        column.role(role_of(shape, &[name])).from(0, &["tt", name])
    };
    names.iter().map(one).collect()
}

/// Returns whether a column is a key or the time. Stages never replace such a column.
pub fn is_key(name: &str) -> bool {
    schemas::flight::KEYS.contains(&name)
}

/// Returns whether a column holds angles in degrees, which wrap at the ends of their range.
pub fn is_angle(batch: &RecordBatch, name: &str) -> bool {
    let schema = batch.schema();
    schema.field_with_name(name).is_ok_and(|field| schemas::describe_field(field).unit == "deg")
}

/// Rejects a pass band that is impossible at this sample rate. `rate_hz` may be unknown.
pub fn band(low_hz: f64, high_hz: f64, rate_hz: Option<f64>) -> Vec<Fault> {
    let mut faults = vec![];
    if high_hz > 0.0 && low_hz >= high_hz {
        let what = format!("the lower corner of {low_hz} Hz is not below the upper corner of {high_hz} Hz");
        faults.push(Fault::new(what).of_param("low_hz"));
    }
    if let Some(rate_hz) = rate_hz {
        for (name, corner_hz) in [("low_hz", low_hz), ("high_hz", high_hz)] {
            if corner_hz >= 0.5 * rate_hz {
                let what =
                    format!("a corner of {corner_hz} Hz is not below the Nyquist frequency of {} Hz", 0.5 * rate_hz);
                let help = "lower the corner or resample at a higher rate; 0 removes this corner";
                faults.push(Fault::new(what).of_param(name).help(help));
            }
        }
    }
    faults
}

/// Faults of several checks.
pub fn faults_of<T>(checks: impl IntoIterator<Item = Result<T, Fault>>, param: &str) -> Vec<Fault> {
    checks.into_iter().filter_map(Result::err).map(|f| f.of_param(param)).collect()
}

/// Fault of the data whose message is the text of an error.
pub fn data(e: impl std::fmt::Display) -> Fault {
    Fault::data(e.to_string())
}
