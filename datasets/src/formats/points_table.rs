//! The table of survey points: Parquet, text or a flight log, as columns with their units.

use std::{collections::BTreeMap, path::Path};

use arrow_array::{Array, ArrayRef, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_cast::cast;
use arrow_schema::{DataType, SchemaRef};
use grids::LineType;
use schemas::{canonical::identifiers, convert};

use super::{
    FLIGHT_FORMATS, FileHead, FlightOptions, adopt, foreign, line_records::GeosoftLineNames, open_flight, parquet,
    text_table, unit_name,
};
use crate::{
    ReadError,
    grid::{AxisUnit, is_dummy, split_unit},
    table::{ColumnValues, array},
};

/// The name of the flight format of survey points.
pub(super) const POINTS: &str = "points";

/// A column of a table of points.
pub(super) struct PointColumn {
    pub(super) name: String,
    /// The unit in the file or at the end of the name; empty for none.
    unit: String,
    chunks: Vec<ArrayRef>,
}

/// A table of points.
pub(super) struct PointTable {
    pub(super) columns: Vec<PointColumn>,
    pub(super) rows: usize,
    /// Line records: the index of the row that follows each record, and the name of the line.
    pub(super) records: Vec<(usize, String)>,
    /// Type of each line, by the name of the line, if the file gives it.
    pub(super) types: BTreeMap<String, LineType>,
    /// Notes on the lines.
    pub(super) notes: Vec<String>,
}

/// Loads a table in the named or detected format.
///
/// # Errors
/// Fails for a format that is unknown, or a file that cannot be read.
pub(super) fn load(path: &Path, format: Option<&str>) -> Result<PointTable, ReadError> {
    let head = FileHead::read(path)?;
    match format {
        Some("parquet") => from_parquet(path),
        Some("text") => from_text(path),
        Some(name) => {
            let names: Vec<&str> =
                FLIGHT_FORMATS.iter().map(|f| f.name).filter(|n| *n != POINTS).chain(["text"]).collect();
            if !names.contains(&name) {
                return Err(
                    ReadError::options(path, format!("there is no point format `{name}`")).nearest(name, &names)
                );
            }
            from_flight(path, Some(name))
        }
        None if head.starts_with(parquet::MAGIC) => from_parquet(path),
        None => {
            if let Some(foreign) = foreign::refused(&head) {
                return Err(foreign);
            }
            let recognised = FLIGHT_FORMATS.iter().find(|f| (f.recognise)(&head)).map(|f| f.name);
            match recognised {
                // Blank-separated text with comments is a flight log of the SGL surveys only if it has the columns of
                // these surveys.
                Some("sgl_xyz") => from_flight(path, None).or_else(|_| from_text(path)),
                None | Some("csv") => from_text(path),
                Some(_) => from_flight(path, None),
            }
        }
    }
}

fn from_parquet(path: &Path) -> Result<PointTable, ReadError> {
    let file = parquet::ParquetSource::new(path)?;
    let schema = file.schema.clone();
    let batches: Vec<RecordBatch> = file.batches(path)?.collect::<Result<_, _>>()?;
    Ok(of_batches(&schema, &batches))
}

fn from_flight(path: &Path, format: Option<&str>) -> Result<PointTable, ReadError> {
    let (flight, line) = (Some("1".to_owned()), Some("1".to_owned()));
    let options = FlightOptions { format: format.map(str::to_owned), flight, line, ..FlightOptions::default() };
    let reader = open_flight(path, &options)?;
    let schema = reader.schema().clone();
    if reader.format() == "sgl_xyz" && !["lat", "lon"].iter().all(|n| schema.field_with_name(n).is_ok()) {
        return Err(ReadError::data(path, "the file is not a flight log"));
    }
    let (types, notes) = (reader.line_types().clone(), reader.notes().to_vec());
    let batches = reader.collect::<Result<Vec<_>, _>>()?;
    let notes = if types.is_empty() { vec![] } else { notes };
    let own = format!("{}: ", path.display());
    let notes = notes.into_iter().map(|note| note.strip_prefix(&own).map(str::to_owned).unwrap_or(note)).collect();
    Ok(PointTable { types, notes, ..of_batches(&schema, &batches) })
}

fn of_batches(schema: &SchemaRef, batches: &[RecordBatch]) -> PointTable {
    let column = |(i, field): (usize, &std::sync::Arc<arrow_schema::Field>)| {
        let declared = field.metadata().get("unit").filter(|u| !u.is_empty()).cloned();
        let unit = declared.or_else(|| adopt::any_unit_of_name(field.name())).unwrap_or_default();
        let chunks = batches.iter().map(|b| b.column(i).clone()).collect();
        PointColumn { name: field.name().clone(), unit, chunks }
    };
    let rows = batches.iter().map(RecordBatch::num_rows).sum();
    PointTable {
        columns: schema.fields().iter().enumerate().map(column).collect(),
        rows,
        records: vec![],
        types: BTreeMap::new(),
        notes: vec![],
    }
}

fn from_text(path: &Path) -> Result<PointTable, ReadError> {
    let text = text_table::read(path)?;
    let mut names = text.names;
    if !text.named && names.len() == 3 {
        names = ["x", "y", "value"].map(str::to_owned).to_vec();
    }
    let rows = text.columns.first().map_or(0, ColumnValues::len);
    let column = |(name, values): (String, ColumnValues)| {
        let unit = adopt::any_unit_of_name(&name).unwrap_or_default();
        PointColumn { name, unit, chunks: vec![array(values)] }
    };
    let columns = names.into_iter().zip(text.columns).map(column).collect();
    let mut lines = GeosoftLineNames::default();
    text.records.iter().for_each(|(_, record)| lines.add(record));
    let records = text.records.iter().map(|(row, record)| (*row, lines.name(record))).collect();
    let notes = text.notes.into_iter().chain(lines.note()).collect();
    Ok(PointTable { columns, rows, records, types: lines.types(), notes })
}

impl PointTable {
    /// The column `name`; case is ignored.
    pub(super) fn column(&self, name: &str) -> Option<&PointColumn> {
        self.columns.iter().find(|c| c.name.eq_ignore_ascii_case(name))
    }

    /// The column with the first of the names `known` that exists; a name followed by a unit in brackets also matches.
    pub(super) fn first(&self, known: &[&str]) -> Option<&PointColumn> {
        let base = |c: &&PointColumn, name: &str| unit_name::without_unit(&c.name).eq_ignore_ascii_case(name);
        let with_unit = |name: &&str| self.columns.iter().find(|c| base(c, name));
        known.iter().find_map(|name| self.column(name)).or_else(|| known.iter().find_map(with_unit))
    }

    /// Same as [`PointTable::named_or`], for a coordinate, whose name may end in a unit.
    ///
    /// # Errors
    /// Fails for a named column that does not exist.
    pub(super) fn axis_or(
        &self,
        path: &Path,
        given: Option<&str>,
        known: &[&str],
        what: &str,
    ) -> Result<Option<&PointColumn>, ReadError> {
        let found = self.named_or(path, given, known, what)?;
        let base = |c: &&PointColumn, name: &str| split_unit(&c.name).0.eq_ignore_ascii_case(name);
        Ok(found.or_else(|| known.iter().find_map(|name| self.columns.iter().find(|c| base(c, name)))))
    }

    /// The column named in the options, else the first of the usual names.
    ///
    /// # Errors
    /// Fails for a named column that does not exist.
    pub(super) fn named_or(
        &self,
        path: &Path,
        given: Option<&str>,
        known: &[&str],
        what: &str,
    ) -> Result<Option<&PointColumn>, ReadError> {
        let Some(given) = given else { return Ok(self.first(known)) };
        let names: Vec<&str> = self.columns.iter().map(|c| c.name.as_str()).collect();
        let exact = self.columns.iter().find(|c| c.name == given).or_else(|| self.column(given));
        match exact {
            Some(column) => Ok(Some(column)),
            None => {
                Err(ReadError::options(path, format!("there is no column `{given}` for `{what}`"))
                    .nearest(given, &names))
            }
        }
    }

    /// An error that lists the columns.
    pub(super) fn lacks(&self, path: &Path, what: &str, option: &str, usual: &[&str]) -> ReadError {
        let names: Vec<&str> = self.columns.iter().map(|c| c.name.as_str()).collect();
        let usual: Vec<&str> = usual.iter().take(4).copied().collect();
        ReadError::options(path, format!("no column has a usual name for {what} ({}, ...)", usual.join(", ")))
            .help(format!("set `{option}` to one of the columns {}", names.join(", ")))
    }

    /// The line of each row, from the line records.
    pub(super) fn recorded_lines(&self) -> Vec<String> {
        let mut names = vec![String::new(); self.rows];
        for (from, name) in &self.records {
            names.iter_mut().skip(*from).for_each(|n| n.clone_from(name));
        }
        names
    }
}

impl PointColumn {
    /// Whether the values of the column are numbers.
    pub(super) fn is_number(&self) -> bool {
        self.chunks.iter().all(|c| c.data_type().is_numeric())
    }

    /// The factor from the unit of the file to `wanted`, and the name of the unit of the file; 1 and `wanted` if the
    /// file gives no unit.
    ///
    /// # Errors
    /// Fails for a unit that does not convert.
    pub(super) fn factor(&self, path: &Path, wanted: &str) -> Result<(f64, String), ReadError> {
        if self.unit.is_empty() {
            return Ok((1.0, wanted.to_owned()));
        }
        let factor = convert(&self.unit, wanted).ok_or_else(|| {
            let what = format!("the unit `{}` does not convert to {wanted}", self.unit);
            ReadError::data(path, what).in_column(&self.name)
        })?;
        Ok((factor, self.unit.clone()))
    }

    /// Whether the unit of the column is an angle.
    pub(super) fn is_angle(&self) -> bool {
        convert(&self.unit, "deg").is_some()
    }

    /// The unit of a coordinate: from the file, else from the name.
    ///
    /// # Errors
    /// Fails for an unknown unit.
    pub(super) fn axis_unit(&self, path: &Path) -> Result<Option<AxisUnit>, ReadError> {
        let declared = if self.unit.is_empty() { split_unit(&self.name).1 } else { &self.unit };
        AxisUnit::read(path, &self.name, declared)
    }

    /// The numbers of the file, in the unit of the file.
    ///
    /// # Errors
    /// Fails for values that are not numbers.
    pub(super) fn numbers(&self, path: &Path) -> Result<Vec<f64>, ReadError> {
        self.in_unit(path, "")
    }

    /// The numbers in the unit `wanted`; unchanged if `wanted` is empty or the file gives no unit.
    ///
    /// # Errors
    /// Fails for values that are not numbers, or a unit that does not convert.
    pub(super) fn in_unit(&self, path: &Path, wanted: &str) -> Result<Vec<f64>, ReadError> {
        let factor = if wanted.is_empty() { 1.0 } else { self.factor(path, wanted)?.0 };
        let mut out = vec![];
        for chunk in &self.chunks {
            if !chunk.data_type().is_numeric() {
                return Err(self.no_number(path, chunk, out.len()));
            }
            let numbers = cast(chunk, &DataType::Float64).map_err(|e| ReadError::data(path, e.to_string()))?;
            let numbers = numbers.as_primitive::<Float64Type>();
            // Geosoft's dummy and similar markers are not a field, height or position.
            let known = |x: f64| if is_dummy(x) { f64::NAN } else { x * factor };
            out.extend(numbers.iter().map(|x| x.map_or(f64::NAN, known)));
        }
        Ok(out)
    }

    fn no_number(&self, path: &Path, chunk: &ArrayRef, before: usize) -> ReadError {
        let words = texts(chunk);
        let bad = words.iter().position(|w| super::csv::number(w).is_none()).unwrap_or(0);
        let word = words.get(bad).map_or("", String::as_str);
        ReadError::data(path, format!("`{word}` is not a number")).in_column(&self.name).in_row((before + bad) as u64)
    }

    /// The values as text; empty if missing.
    pub(super) fn texts(&self) -> Vec<String> {
        self.chunks.iter().flat_map(texts).collect()
    }
}

fn texts(chunk: &ArrayRef) -> Vec<String> {
    // Identifiers are spelt without a fraction: line `10`, not `10.0`.
    let Ok(text) = identifiers(chunk) else { return vec![String::new(); chunk.len()] };
    text.as_string::<i32>().iter().map(|t| t.unwrap_or_default().to_owned()).collect()
}
