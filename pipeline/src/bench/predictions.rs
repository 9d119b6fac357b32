//! Predictions of any program: a Parquet or CSV file with `flight`, `line`, `tt` and the columns of tasks.

use std::{
    collections::{BTreeMap, HashMap},
    fs::File,
    path::Path,
    sync::Arc,
};

use arrow_array::{Array, ArrayRef, RecordBatch, StringArray, cast::AsArray, types::Float64Type};
use arrow_csv::ReaderBuilder;
use arrow_schema::{DataType, Field, Schema};
use arrow_select::concat::concat_batches;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use schemas::Fault;

use super::{BenchLine, BenchMetric, BenchTask, TASKS, shown};

/// Resolution of time stamps: one millisecond.
const TICKS_PER_S: f64 = 1000.0;

/// Samples of a line by their times, in ticks.
type TickIndex = HashMap<i64, usize>;

/// Predictions, one row per sample.
#[derive(Debug)]
pub struct Predictions {
    /// Name of the file.
    pub file: String,
    flight: Vec<String>,
    line: Vec<String>,
    tt_s: Vec<f64>,
    columns: BTreeMap<String, Vec<f64>>,
}

impl Predictions {
    /// Reads a file: CSV by its extension, otherwise Parquet.
    ///
    /// # Errors
    /// Fails if it cannot be read, lacks a key, has a column that belongs to no task, or has a missing or impossible
    /// value.
    pub fn open(path: &Path) -> Result<Predictions, Fault> {
        let is_csv = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv"));
        let file = shown(path);
        let batch = if is_csv { csv(path) } else { whole(path) }.map_err(|f| f.in_file(&file))?;
        Predictions::from_batch(&file, &batch).map_err(|f| f.in_file(&file))
    }

    fn from_batch(file: &str, batch: &RecordBatch) -> Result<Predictions, Fault> {
        let known: Vec<&str> =
            ["flight", "line", "tt"].into_iter().chain(TASKS.iter().flat_map(|t| t.columns).copied()).collect();
        let schema = batch.schema();
        let unknown = schema.fields().iter().map(|f| f.name().as_str()).find(|n| !known.contains(n));
        if let Some(name) = unknown {
            return Err(Fault::data(format!("no task has a column `{name}`")).nearest(name, &known));
        }
        let of = |name: &str| {
            let missing = || {
                Fault::data(format!("there is no column `{name}`"))
                    .help("predictions require `flight`, `line` and `tt` for each sample")
            };
            batch.column_by_name(name).ok_or_else(missing)
        };
        let (flight, line) = (identifiers(of("flight")?, "flight")?, identifiers(of("line")?, "line")?);
        let tt_s = numbers(of("tt")?, "tt")?;
        let mut columns = BTreeMap::new();
        for name in known.iter().skip(3) {
            if let Some(array) = batch.column_by_name(name) {
                let values = numbers(array, name)?;
                possible(name, &values)?;
                columns.insert((*name).to_owned(), values);
            }
        }
        Ok(Predictions { file: file.to_owned(), flight, line, tt_s, columns })
    }

    /// Whether a column exists.
    pub fn has(&self, column: &str) -> bool {
        self.columns.contains_key(column)
    }

    /// Columns of a task.
    ///
    /// # Errors
    /// Fails if one of these columns is missing.
    pub fn columns(&self, task: &BenchTask) -> Result<Vec<&[f64]>, Fault> {
        let of = |name: &&str| {
            let missing = || {
                let what = format!("the task `{}` requires the columns `{}`", task.name, task.columns.join("` and `"));
                Fault::data(what).in_file(&self.file)
            };
            self.columns.get(*name).map(Vec::as_slice).ok_or_else(missing)
        };
        task.columns.iter().map(of).collect()
    }

    /// Row of the prediction of each sample of each line; `None` for a sample without a prediction.
    ///
    /// # Errors
    /// Fails for rows of a line that is not scored, rows at an unknown time, or duplicate rows.
    pub fn places(&self, lines: &[&BenchLine]) -> Result<Vec<Vec<Option<usize>>>, Fault> {
        let tick = |tt_s: f64| (tt_s * TICKS_PER_S).round() as i64;
        // For each flight and line, the position of the line, and the line's samples by time.
        let mut at: HashMap<(&str, &str), (usize, TickIndex)> = HashMap::new();
        let mut places = vec![];
        for (i, line) in lines.iter().enumerate() {
            let times = line.column("tt")?;
            let samples = times.iter().enumerate().map(|(sample, tt)| (tick(*tt), sample)).collect();
            at.insert((line.flight.as_str(), line.line.as_str()), (i, samples));
            places.push(vec![None; times.len()]);
        }
        for (row, ((flight, line), tt)) in self.flight.iter().zip(&self.line).zip(&self.tt_s).enumerate() {
            let fault = |what: String| Fault::data(what).in_file(&self.file).in_row(row as u64);
            let Some((i, samples)) = at.get(&(flight.as_str(), line.as_str())) else {
                let known: Vec<String> =
                    lines.iter().map(|l| format!("flight {}, line {}", l.flight, l.line)).collect();
                let what = format!("flight {flight}, line {line} is not scored");
                return Err(fault(what).help(format!("predict {}", known.join(" and "))));
            };
            let Some(sample) = samples.get(&tick(*tt)) else {
                let what = format!("flight {flight}, line {line} has no sample at tt = {tt} s");
                return Err(fault(what).help("use the `tt` of the flight's samples, in seconds past midnight UTC"));
            };
            let place = places
                .get_mut(*i)
                .and_then(|p| p.get_mut(*sample))
                .ok_or_else(|| Fault::bug("the sample of a prediction does not exist"))?;
            if let Some(before) = place.replace(row) {
                let what = format!("flight {flight}, line {line}, tt = {tt} s is a duplicate of row {before}");
                return Err(fault(what).help("give one prediction per sample"));
            }
        }
        Ok(places)
    }
}

fn unreadable(e: &dyn std::fmt::Display) -> Fault {
    Fault::data(format!("cannot read the predictions: {e}")).help("predictions must be Parquet, or CSV with a header")
}

/// Reads a CSV file with all cells as text, so that identifiers such as 3.10 stay unchanged.
fn csv(path: &Path) -> Result<RecordBatch, Fault> {
    let open = || File::open(path).map_err(|e| unreadable(&e));
    let format = arrow_csv::reader::Format::default().with_header(true);
    let (found, _) = format.infer_schema(open()?, Some(1)).map_err(|e| unreadable(&e))?;
    let fields = found.fields().iter().map(|f| Field::new(f.name().trim(), DataType::Utf8, true));
    let schema = Arc::new(Schema::new(fields.collect::<Vec<_>>()));
    let reader = ReaderBuilder::new(schema.clone()).with_header(true).build(open()?).map_err(|e| unreadable(&e))?;
    let batches = reader.collect::<Result<Vec<_>, _>>().map_err(|e| unreadable(&e))?;
    concat_batches(&schema, &batches).map_err(|e| unreadable(&e))
}

fn whole(path: &Path) -> Result<RecordBatch, Fault> {
    let file = File::open(path).map_err(|e| unreadable(&e))?;
    let reader = ParquetRecordBatchReaderBuilder::try_new(file).map_err(|e| unreadable(&e))?;
    let schema = reader.schema().clone();
    let batches =
        reader.build().map_err(|e| unreadable(&e))?.collect::<Result<Vec<_>, _>>().map_err(|e| unreadable(&e))?;
    concat_batches(&schema, &batches).map_err(|e| unreadable(&e))
}

/// Flight or line identifiers, which must be text or integers.
fn identifiers(array: &ArrayRef, name: &str) -> Result<Vec<String>, Fault> {
    if array.data_type().is_floating() {
        let what = format!("`{name}` contains decimal numbers, which do not distinguish 3.1 from 3.10");
        return Err(Fault::data(what).help(format!("write `{name}` as text, as it is in the flight data")));
    }
    let texts = arrow_cast::cast(array, &DataType::Utf8).map_err(|e| unreadable(&e))?;
    let texts: &StringArray = texts.as_string_opt::<i32>().ok_or_else(|| Fault::bug("a column has another type"))?;
    let text = |(row, x): (usize, Option<&str>)| {
        let missing = || Fault::data("the value is missing").in_column(name).in_row(row as u64);
        x.map(|x| x.trim().to_owned()).filter(|x| !x.is_empty()).ok_or_else(missing)
    };
    texts.iter().enumerate().map(text).collect()
}

/// Numbers without missing values.
fn numbers(array: &ArrayRef, name: &str) -> Result<Vec<f64>, Fault> {
    let fault = |row: usize, what: String| Fault::data(what).in_column(name).in_row(row as u64);
    let found: Vec<f64> = match array.as_string_opt::<i32>() {
        Some(texts) => {
            let number = |(row, x): (usize, Option<&str>)| match x.map(str::trim) {
                None | Some("") => Ok(f64::NAN),
                Some(x) => x.parse::<f64>().map_err(|_| fault(row, format!("`{x}` is not a number"))),
            };
            texts.iter().enumerate().map(number).collect::<Result<_, Fault>>()?
        }
        None => {
            let cast = arrow_cast::cast(array, &DataType::Float64).map_err(|e| unreadable(&e))?;
            let numbers =
                cast.as_primitive_opt::<Float64Type>().ok_or_else(|| Fault::bug("a column has another type"))?;
            numbers.iter().map(|x| x.unwrap_or(f64::NAN)).collect()
        }
    };
    match found.iter().position(|x| !x.is_finite()) {
        None => Ok(found),
        Some(row) => {
            let help = "predict each sample, or remove the row; the sample then counts as failed";
            Err(fault(row, "the prediction is not a finite number".to_owned()).help(help))
        }
    }
}

/// Rejects values in another unit.
fn possible(name: &str, values: &[f64]) -> Result<(), Fault> {
    let Some(task) = TASKS.iter().find(|t| t.columns.contains(&name)) else { return Ok(()) };
    let (from, to, what) = match task.measure {
        BenchMetric::StdError => (10_000.0, 100_000.0, "a total field in nT"),
        BenchMetric::Drms if task.columns.first() == Some(&name) => (-90.0, 90.0, "a latitude in degrees"),
        BenchMetric::Drms => (-360.0, 360.0, "a longitude in degrees"),
    };
    match values.iter().enumerate().find(|(_, x)| !(from..=to).contains(*x)) {
        None => Ok(()),
        Some((row, x)) => {
            let fault = Fault::data(format!("{x} is not {what}")).in_column(name).in_row(row as u64);
            let scale = |factor: f64| (from..=to).contains(&(x * factor));
            let help = if task.measure == BenchMetric::StdError && scale(1e-3) {
                "the value is probably in pT; convert it to nT".to_owned()
            } else if task.measure == BenchMetric::StdError && scale(1e9) {
                "the value is probably in T; convert it to nT".to_owned()
            } else if task.measure == BenchMetric::StdError && scale(1e3) {
                "the value is probably in uT; convert it to nT".to_owned()
            } else {
                format!("permitted values are {from} to {to}")
            };
            Err(fault.help(help))
        }
    }
}
