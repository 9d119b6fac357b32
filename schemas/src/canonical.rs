//! Conversion of a file's columns to canonical types, units and roles, once, on ingest.

use std::sync::Arc;

use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch, StringArray, cast::AsArray};
use arrow_cast::cast;
use arrow_schema::{DataType, Field, Schema, SchemaRef};

use crate::{ColumnDescription, Fault, Role, convert, describe_field, field, flight};

/// Conversion of each column of a file to a column of the flight table.
#[derive(Clone, Debug)]
pub struct FlightConversion {
    schema: SchemaRef,
    steps: Vec<(usize, ColumnConversion)>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum ColumnConversion {
    Text,
    Number(f64),
    /// A scalar magnetometer: the earth's field is never 0 nT, so a reading of exactly 0 is a dropout.
    Scalar(f64),
    Cast,
    Keep,
}

/// The fault of a table without the key `key`.
fn missing_key(key: &str, names: &[&str]) -> Fault {
    let mut fault = Fault::data(format!("a flight table requires a column `{key}`")).nearest(key, names).in_column(key);
    if let Some(help) = fault.help.as_mut().filter(|help| !help.ends_with('?')) {
        help.push_str("; `magline init FILE` finds the columns of a file and writes a mapping and a spec");
    }
    fault
}

impl FlightConversion {
    /// The conversion from `source` to the flight table.
    /// `flight` and `line` are text or numbers in the file, and become text. Every column with a canonical unit becomes
    /// Float64 in that unit; other floats become Float64, other whole numbers Int64, and other types are unchanged.
    /// Columns keep the file's order after `flight`, `line`, `tt`. Null numbers become NaN. A reading of exactly 0 nT
    /// of an uncompensated scalar magnetometer is a dropout and becomes NaN.
    ///
    /// # Errors
    /// Fails with a fault for every missing key, wrong unit and wrong type. Each fault names its column.
    pub fn new(source: &Schema) -> Result<FlightConversion, Vec<Fault>> {
        let names: Vec<&str> = source.fields().iter().map(|f| f.name().as_str()).collect();
        let mut faults: Vec<Fault> =
            flight::KEYS.iter().filter(|k| !names.contains(k)).map(|k| missing_key(k, &names)).collect();
        for (i, name) in names.iter().enumerate() {
            if names[..i].contains(name) {
                faults.push(Fault::data("duplicate column").in_column(name));
            }
        }
        let keys = flight::KEYS.iter().filter_map(|k| names.iter().position(|n| n == k));
        let others = (0..names.len()).filter(|i| !flight::KEYS.contains(&names[*i]));
        let (mut fields, mut steps) = (vec![], vec![]);
        for i in keys.chain(others) {
            match step(source.field(i)) {
                Ok((step, field)) => {
                    steps.push((i, step));
                    fields.push(field);
                }
                Err(fault) => faults.push(fault),
            }
        }
        if faults.is_empty() {
            Ok(FlightConversion { schema: Arc::new(Schema::new(fields)), steps })
        } else {
            Err(faults)
        }
    }

    /// The schema of the flight table.
    pub fn schema(&self) -> &SchemaRef {
        &self.schema
    }

    /// One batch of the file as rows of the flight table.
    ///
    /// # Errors
    /// Fails for a value that does not fit the type of its column.
    pub fn apply(&self, batch: &RecordBatch) -> Result<RecordBatch, Fault> {
        self.cells(batch, false)
    }

    /// Same as [`FlightConversion::apply`], but keeps zeros of scalar magnetometers, for callers that count them.
    ///
    /// # Errors
    /// Fails for a value that does not fit the type of its column.
    pub fn apply_with_zeros(&self, batch: &RecordBatch) -> Result<RecordBatch, Fault> {
        self.cells(batch, true)
    }

    fn cells(&self, batch: &RecordBatch, zeros: bool) -> Result<RecordBatch, Fault> {
        let columns = self.steps.iter().zip(self.schema.fields()).map(|((i, step), field)| {
            let wrong = |e: arrow_schema::ArrowError| Fault::data(e.to_string()).in_column(field.name());
            let array = batch.column(*i);
            match step {
                ColumnConversion::Keep => Ok(array.clone()),
                ColumnConversion::Cast => cast(array, field.data_type()).map_err(wrong),
                ColumnConversion::Text => identifiers(array).map_err(wrong),
                ColumnConversion::Number(factor) => {
                    cast(array, &DataType::Float64).map(|a| numbers(&a, *factor)).map_err(wrong)
                }
                ColumnConversion::Scalar(factor) if zeros => {
                    cast(array, &DataType::Float64).map(|a| numbers(&a, *factor)).map_err(wrong)
                }
                ColumnConversion::Scalar(factor) => {
                    cast(array, &DataType::Float64).map(|a| without_zeros(&numbers(&a, *factor))).map_err(wrong)
                }
            }
        });
        let columns = columns.collect::<Result<Vec<ArrayRef>, Fault>>()?;
        RecordBatch::try_new(self.schema.clone(), columns).map_err(|e| Fault::data(e.to_string()))
    }
}

/// The conversion of one column, and the resulting field.
fn step(source: &Field) -> Result<(ColumnConversion, Field), Fault> {
    let name = source.name();
    let known = flight::describe(name);
    let kind = flattened(source.data_type());
    // The role in the metadata applies to columns without a fixed name.
    let source_role = describe_field(source).role;
    let own_role = matches!(source_role, Role::Truth | Role::Sensor)
        .then_some(source_role)
        .filter(|_| known.description.is_empty());
    let as_field = |t: DataType, unit: &str, role: Role| {
        let role = own_role.unwrap_or(role);
        let own = source.metadata().get("description").map(String::as_str);
        field(name, t, unit, role, own.filter(|d| !d.is_empty()).unwrap_or(known.description))
    };
    if name == "flight" || name == "line" {
        let fine = is_text(&kind) || kind.is_numeric();
        let wrong = || Fault::data(format!("must be text, not {kind}")).in_column(name);
        return if fine { Ok((ColumnConversion::Text, as_field(DataType::Utf8, "", Role::Key))) } else { Err(wrong()) };
    }
    let given = source.metadata().get("unit").map_or("", String::as_str);
    if !known.unit.is_empty() {
        let factor = unit_factor(name, given, &known)?;
        if !kind.is_numeric() && kind != DataType::Null {
            let what = format!("must be numbers in {}, not {kind}", known.unit);
            return Err(Fault::data(what).in_column(name).help("convert the column, or rename it with `rename`"));
        }
        let step = if flight::is_scalar_reading(name) {
            ColumnConversion::Scalar(factor)
        } else {
            ColumnConversion::Number(factor)
        };
        return Ok((step, as_field(DataType::Float64, known.unit, known.role)));
    }
    let (step, to) = match &kind {
        DataType::Float64 | DataType::Float32 | DataType::Float16 => (ColumnConversion::Number(1.0), DataType::Float64),
        t if t.is_integer() => (ColumnConversion::Cast, DataType::Int64),
        t if is_text(t) => (ColumnConversion::Cast, DataType::Utf8),
        DataType::Boolean => (ColumnConversion::Cast, DataType::Boolean),
        _ => (ColumnConversion::Keep, source.data_type().clone()),
    };
    Ok((step, as_field(to, given, known.role)))
}

fn unit_factor(name: &str, given: &str, known: &ColumnDescription) -> Result<f64, Fault> {
    if given.is_empty() {
        return Ok(1.0);
    }
    convert(given, known.unit).ok_or_else(|| {
        let what = format!("has the unit `{given}`, which does not convert to {}", known.unit);
        Fault::data(what).in_column(name).help("set the true unit of the column in the table's `units`")
    })
}

fn flattened(t: &DataType) -> DataType {
    match t {
        DataType::Dictionary(_, value) => flattened(value),
        DataType::RunEndEncoded(_, value) => flattened(value.data_type()),
        other => other.clone(),
    }
}

fn is_text(t: &DataType) -> bool {
    matches!(t, DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View)
}

/// Identifiers as text: whole numbers without a fraction, others in the form of [`identifier`].
///
/// # Errors
/// Fails for values that cannot be written as text.
pub fn identifiers(array: &ArrayRef) -> Result<ArrayRef, arrow_schema::ArrowError> {
    if !flattened(array.data_type()).is_floating() {
        return cast(array, &DataType::Utf8);
    }
    let numbers = cast(array, &DataType::Float64)?;
    let numbers = numbers.as_primitive::<arrow_array::types::Float64Type>();
    Ok(Arc::new(numbers.iter().map(|x| x.map(identifier)).collect::<StringArray>()))
}

/// Text of a numeric identifier: the shortest text that reads back as the same number. For a number that is exact in
/// single precision, this is the shortest text in single precision: line 1006.04, once stored in single precision, is
/// 1006.0399780273438 in double precision.
pub fn identifier(x: f64) -> String {
    as_written(x).to_string()
}

/// The original value of an identifier that was rounded to single precision.
pub fn as_written(x: f64) -> f64 {
    let single = x as f32;
    // A whole number is already exact.
    if x.fract() == 0.0 || f64::from(single) != x {
        return x;
    }
    single.to_string().parse().unwrap_or(x)
}

/// Numbers in the canonical unit, with NaN for missing ones.
fn numbers(array: &ArrayRef, factor: f64) -> ArrayRef {
    let array = array.as_primitive::<arrow_array::types::Float64Type>();
    if array.null_count() == 0 && factor == 1.0 {
        return Arc::new(array.clone());
    }
    Arc::new(
        array
            .iter()
            .map(|x| x.map_or(f64::NAN, |x| x * factor))
            .collect::<Vec<f64>>()
            .into_iter()
            .collect::<Float64Array>(),
    )
}

/// Readings, with NaN instead of exactly 0.
fn without_zeros(array: &ArrayRef) -> ArrayRef {
    let array = array.as_primitive::<arrow_array::types::Float64Type>();
    let kept: Float64Array = array.values().iter().map(|x| if *x == 0.0 { f64::NAN } else { *x }).collect();
    Arc::new(kept)
}

/// Checks that time increases strictly along a line.
///
/// # Errors
/// Fails for the first row whose time is missing, or not later than the time of the previous row.
pub fn check_time(tt: &[f64]) -> Result<(), Fault> {
    let row = |i: usize, what: String| Err(Fault::data(what).in_column("tt").in_row(i as u64));
    for (i, t) in tt.iter().enumerate() {
        if !t.is_finite() {
            return row(i, "the time is missing".to_owned());
        }
        if i > 0 && *t == tt[i - 1] {
            return row(i, format!("duplicate time {t} s"));
        }
        if i > 0 && *t < tt[i - 1] {
            return row(i, format!("time decreases from {} s to {t} s", tt[i - 1]));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::panic)]

    use std::collections::HashMap;

    use arrow_array::{Float32Array, Int32Array};

    use super::*;

    fn with_unit(name: &str, t: DataType, unit: &str) -> Field {
        Field::new(name, t, true).with_metadata(HashMap::from([("unit".to_owned(), unit.to_owned())]))
    }

    #[test]
    fn unit_safe_casts_and_units() {
        let schema = Schema::new(vec![
            with_unit("ins_lat", DataType::Float64, "rad"),
            Field::new("tt", DataType::Float32, true),
            Field::new("line", DataType::Float64, true),
            Field::new("flight", DataType::Int32, true),
            Field::new("counter", DataType::Int32, true),
        ]);
        let columns: Vec<ArrayRef> = vec![
            Arc::new(Float64Array::from(vec![Some(std::f64::consts::PI), None])),
            Arc::new(Float32Array::from(vec![0.5, 1.0])),
            Arc::new(Float64Array::from(vec![1003.02, 1004.0])),
            Arc::new(Int32Array::from(vec![1003, 1004])),
            Arc::new(Int32Array::from(vec![1, 2])),
        ];
        let batch = RecordBatch::try_new(Arc::new(schema.clone()), columns).unwrap();
        let out = FlightConversion::new(&schema).unwrap().apply(&batch).unwrap();
        let names: Vec<_> = out.schema().fields().iter().map(|f| f.name().clone()).collect();
        assert_eq!(names, ["flight", "line", "tt", "ins_lat", "counter"]);
        assert_eq!(out.column(1).as_string::<i32>().value(0), "1003.02");
        assert_eq!(out.column(1).as_string::<i32>().value(1), "1004");
        let lat = out.column(3).as_primitive::<arrow_array::types::Float64Type>();
        assert!((lat.value(0) - 180.0).abs() < 1e-12);
        assert!(lat.value(1).is_nan());
        assert_eq!(out.column(4).data_type(), &DataType::Int64);
        assert_eq!(out.schema().field(3).metadata()["unit"], "deg");
    }

    #[test]
    fn unit_identifiers_of_single_precision_have_its_shortest_text() {
        for (x, text) in [
            (f64::from(1006.04_f32), "1006.04"),
            (f64::from(1003.1_f32), "1003.1"),
            (1006.04, "1006.04"),
            (1010.25, "1010.25"),
            (2f64.powi(40), "1099511627776"),
            (f64::from(-7.3_f32), "-7.3"),
        ] {
            assert_eq!(identifier(x), text);
        }
        let array: ArrayRef = Arc::new(Float32Array::from(vec![Some(1006.04), Some(1010.0), None]));
        let found = identifiers(&array).unwrap();
        let texts: Vec<Option<&str>> = found.as_string::<i32>().iter().collect();
        assert_eq!(texts, [Some("1006.04"), Some("1010"), None]);
    }

    #[test]
    fn unit_only_unknown_columns_keep_their_declared_role() {
        let fields = ["flight", "line", "tt", "reference", "lat", "other"]
            .map(|n| crate::field(n, DataType::Float64, "", if n == "other" { Role::Key } else { Role::Truth }, ""));
        let out = FlightConversion::new(&Schema::new(fields.to_vec())).unwrap();
        let roles: Vec<&str> = out.schema().fields().iter().map(|f| f.metadata()["role"].as_str()).collect();
        assert_eq!(roles, ["key", "key", "time", "truth", "truth", "aux"]);
    }

    #[test]
    fn gold_all_faults_of_a_schema_are_reported() {
        let schema = Schema::new(vec![
            Field::new("flight", DataType::Utf8, true),
            Field::new("lines", DataType::Utf8, true),
            Field::new("lat", DataType::Utf8, true),
            with_unit("mag_2_uc", DataType::Float64, "V"),
        ]);
        let faults = FlightConversion::new(&schema).unwrap_err();
        let messages: Vec<String> = faults.iter().map(Fault::to_string).collect();
        assert_eq!(
            messages,
            [
                "column `line`: a flight table requires a column `line` (did you mean `lines`?)",
                "column `tt`: a flight table requires a column `tt` (known here: flight, lines, lat, mag_2_uc; \
                 `magline init FILE` finds the columns of a file and writes a mapping and a spec)",
                "column `lat`: must be numbers in deg, not Utf8 (convert the column, or rename it with `rename`)",
                "column `mag_2_uc`: has the unit `V`, which does not convert to nT \
                 (set the true unit of the column in the table's `units`)",
            ]
        );
    }

    #[test]
    fn unit_a_dropout_of_a_scalar_magnetometer_is_missing() {
        let schema = Schema::new(
            ["flight", "line", "tt", "mag_4_uc", "mag_1_c"].map(|n| Field::new(n, DataType::Float64, true)).to_vec(),
        );
        let columns = (0..5).map(|_| Arc::new(Float64Array::from(vec![0.0, 50_000.0])) as ArrayRef).collect();
        let batch = RecordBatch::try_new(Arc::new(schema.clone()), columns).unwrap();
        let out = FlightConversion::new(&schema).unwrap().apply(&batch).unwrap();
        let numbers = |i: usize| out.column(i).as_primitive::<arrow_array::types::Float64Type>().values().to_vec();
        assert!(numbers(3)[0].is_nan() && numbers(3)[1] == 50_000.0);
        // An anomaly may be zero.
        assert_eq!(numbers(4), [0.0, 50_000.0]);
    }

    #[test]
    fn unit_time_must_run_forward() {
        assert!(check_time(&[0.0, 0.1, 0.3]).is_ok());
        for (tt, row) in [([0.0, 0.0, 1.0], 1), ([0.0, 2.0, 1.0], 2), ([0.0, f64::NAN, 1.0], 1)] {
            assert_eq!(check_time(&tt).unwrap_err().place.row, Some(row));
        }
    }
}
