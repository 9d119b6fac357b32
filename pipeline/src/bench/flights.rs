//! Flights of the benchmark: simulated from their spec, or read from files.

use std::{fs, path::Path};

use arrow_array::{Array, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_select::concat::concat_batches;
use datasets::{FlightOptions, ReadHints};
use intake::open_flight;
use parquet::{
    arrow::ArrowWriter,
    basic::{Compression, ZstdLevel},
    file::properties::WriterProperties,
};
use schemas::{Fault, Role, describe_field};

use super::{TEST_FLIGHT, shown};

/// One line of a flight, with all its columns.
pub struct BenchLine {
    /// The flight.
    pub flight: String,
    /// The line.
    pub line: String,
    /// Samples, in the order of time.
    pub rows: RecordBatch,
}

impl BenchLine {
    /// Numeric column.
    ///
    /// # Errors
    /// Fails if the column is missing, or lacks a value.
    pub fn column(&self, name: &str) -> Result<&[f64], Fault> {
        let array = self.rows.column_by_name(name).and_then(|a| a.as_primitive_opt::<Float64Type>());
        let array = array.filter(|a| a.null_count() == 0);
        let fault =
            || Fault::data("the benchmark requires this column").in_line(&self.flight, &self.line).in_column(name);
        array.map(|a| a.values().as_ref()).ok_or_else(fault)
    }
}

/// Lines of flights, which are read from a file or simulated from a spec.
///
/// # Errors
/// Fails if they cannot be read.
pub fn open(path: &Path) -> Result<Vec<BenchLine>, Fault> {
    if !path.exists() {
        let fault = Fault::new(format!("there is no file {}", path.display()));
        return Err(
            fault.help("run the command in a clone of magline, or give the spec of the flights with `--flights`")
        );
    }
    let reading = ReadHints { found: None, threads: rayon::current_num_threads() };
    let reader = open_flight(path, &FlightOptions::default(), &reading).map_err(Fault::from)?;
    let mut parts: Vec<(String, String, Vec<RecordBatch>)> = vec![];
    for batch in reader {
        let batch = batch.map_err(Fault::from)?;
        let text = |name: &str| batch.column_by_name(name).and_then(|a| a.as_string_opt::<i32>());
        let (Some(flights), Some(lines)) = (text("flight"), text("line")) else {
            return Err(Fault::data("the flights have no columns `flight` and `line`").in_file(&shown(path)));
        };
        let mut from = 0;
        for row in 1..=batch.num_rows() {
            let ends = row == batch.num_rows()
                || flights.value(row) != flights.value(from)
                || lines.value(row) != lines.value(from);
            if !ends {
                continue;
            }
            let (flight, line, rows) = (flights.value(from), lines.value(from), batch.slice(from, row - from));
            match parts.iter_mut().find(|(f, l, _)| f == flight && l == line) {
                Some((_, _, known)) => known.push(rows),
                None => parts.push((flight.to_owned(), line.to_owned(), vec![rows])),
            }
            from = row;
        }
    }
    let whole = |(flight, line, rows): (String, String, Vec<RecordBatch>)| {
        let first = rows.first().map(RecordBatch::schema).ok_or_else(|| Fault::bug("a line without rows"))?;
        let rows = concat_batches(&first, &rows).map_err(|e| Fault::machine(e.to_string()))?;
        Ok(BenchLine { flight, line, rows })
    };
    parts.into_iter().map(whole).collect()
}

/// Whether a participant may read a column of the test flight.
fn is_open(field: &arrow_schema::Field) -> bool {
    /// Columns that are derived from the truth, but have another role.
    const HIDDEN: [&str; 4] = ["roll_rate", "pitch_rate", "yaw_rate", "igrf"];
    describe_field(field).role != Role::Truth && !HIDDEN.contains(&field.name().as_str())
}

/// Writes the data of the benchmark into the folder `to`: `train/<flight>.parquet` with all columns, and
/// `test/<flight>.parquet` without the truth. Returns the files.
///
/// # Errors
/// Fails if the folder is not empty, or the file system reports an error.
pub fn data(flights: &[BenchLine], to: &Path) -> Result<Vec<String>, Fault> {
    let fail = |e: &dyn std::fmt::Display| Fault::machine(format!("cannot write {}: {e}", to.display()));
    if fs::read_dir(to).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(Fault::new(format!("{} is not empty", to.display())).help("give a new or empty folder"));
    }
    let mut names: Vec<&str> = flights.iter().map(|f| f.flight.as_str()).collect();
    names.dedup();
    let mut written = vec![];
    for name in names {
        let test = name == TEST_FLIGHT;
        let folder = to.join(if test { "test" } else { "train" });
        fs::create_dir_all(&folder).map_err(|e| fail(&e))?;
        let lines: Vec<&BenchLine> = flights.iter().filter(|f| f.flight == name).collect();
        let Some(first) = lines.first() else { continue };
        let schema = first.rows.schema();
        let kept: Vec<usize> =
            schema.fields().iter().enumerate().filter(|(_, f)| !test || is_open(f)).map(|(i, _)| i).collect();
        let path = folder.join(format!("{name}.parquet"));
        let partial = folder.join(format!(".{name}.{}.parquet.partial", std::process::id()));
        let file = fs::File::create(&partial).map_err(|e| fail(&e))?;
        let schema = std::sync::Arc::new(schema.project(&kept).map_err(|e| fail(&e))?);
        let properties = WriterProperties::builder().set_compression(Compression::ZSTD(ZstdLevel::default())).build();
        let mut writer = ArrowWriter::try_new(file, schema, Some(properties)).map_err(|e| fail(&e))?;
        for line in lines {
            let rows = line.rows.project(&kept).map_err(|e| fail(&e))?;
            writer.write(&rows).map_err(|e| fail(&e))?;
        }
        writer.into_inner().map_err(|e| fail(&e))?.sync_all().map_err(|e| fail(&e))?;
        fs::rename(&partial, &path).map_err(|e| fail(&e))?;
        written.push(shown(&path));
    }
    Ok(written)
}
