//! GeoPackage: a SQLite database with the rows as points and the lines as tracks. [OGC 12-128r19, GeoPackage 1.4]
//!
//! Positions are the columns `lat` and `lon`, or `ins_lat` and `ins_lon`, in degrees on WGS 84. A point without a
//! position has no geometry. `gpkg_data_columns` holds the names, units and descriptions of the columns.

mod geometry;
mod tables;

use std::path::Path;

use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch, cast::AsArray, types::Float64Type};
use arrow_cast::{cast, display::ArrayFormatter};
use arrow_schema::{DataType, Schema};
use rusqlite::{Connection, types::Value};
use schemas::Fault;

use super::TableWriter;
use geometry::{Extent, point, track};
use tables::{FeatureColumn, FeatureTable};

/// Names of the columns of a position, the preferred one first.
const PLACES: [[&str; 2]; 2] = [["lat", "lon"], ["ins_lat", "ins_lon"]];

/// Writer of a table as a GeoPackage.
pub struct GeoPackageWriter {
    database: Connection,
    table: String,
    rows: Option<FeatureTable>,
    /// Positions of the columns of latitude and longitude.
    place: [usize; 2],
    extent: Extent,
    lines: FeatureTable,
    line: Option<Track>,
}

/// Track of a line; in a sweep, the track of a line at one point.
struct Track {
    /// Values of the key columns.
    keys: Vec<Value>,
    /// Longitude and latitude.
    places: Vec<[f64; 2]>,
    rows: i64,
}

fn failed(e: &rusqlite::Error) -> Fault {
    Fault::machine(format!("cannot write the GeoPackage: {e}"))
}

impl GeoPackageWriter {
    /// Creates the file `path` for the table `table`.
    ///
    /// # Errors
    /// Fails if the file cannot be created.
    pub fn create(path: &Path, table: &str) -> Result<GeoPackageWriter, Fault> {
        let exists = std::fs::remove_file(path);
        if let Err(e) = exists
            && e.kind() != std::io::ErrorKind::NotFound
        {
            return Err(super::write_failed(&e));
        }
        let database = Connection::open(path).map_err(|e| failed(&e))?;
        tables::begin(&database).map_err(|e| failed(&e))?;
        let lines = FeatureTable::new(&format!("{table}_lines"), "LINESTRING", vec![]);
        let (table, rows, place, line) = (table.to_owned(), None, [0, 0], None);
        Ok(GeoPackageWriter { database, table, rows, place, extent: Extent::default(), lines, line })
    }

    fn start(&mut self, schema: &Schema) -> Result<(), Fault> {
        let index = |name: &&str| schema.index_of(name).ok().filter(|i| schema.field(*i).data_type().is_numeric());
        let found = PLACES.iter().find_map(|[lat, lon]| Some([index(lat)?, index(lon)?]));
        let Some(place) = found else {
            let fault = Fault::new("the table has no columns `lat` and `lon`, so it cannot be written as GeoPackage");
            return Err(fault.help("add `carry = [\"lat\", \"lon\"]` to the stage, or use the extension .csv"));
        };
        for column in place.map(|i| schema.field(i)) {
            let unit = column.metadata().get("unit").map_or("", String::as_str);
            if !unit.is_empty() && unit != "deg" {
                let what = format!("column `{}` is in {unit}, but a GeoPackage needs degrees", column.name());
                return Err(Fault::new(what).help("use the extension .csv"));
            }
        }
        self.place = place;
        let columns: Vec<FeatureColumn> = schema.fields().iter().map(|f| FeatureColumn::new(f)).collect();
        let keys = columns.iter().filter(|column| column.is_key).cloned();
        let count = FeatureColumn::count("rows", "number of rows of the line");
        let lines = FeatureTable::new(&format!("{}_lines", self.table), "LINESTRING", keys.chain([count]).collect());
        let rows = FeatureTable::new(&self.table, "POINT", columns);
        rows.create(&self.database).map_err(|e| failed(&e))?;
        lines.create(&self.database).map_err(|e| failed(&e))?;
        (self.rows, self.lines) = (Some(rows), lines);
        Ok(())
    }

    /// Writes the track of a complete line.
    fn end_line(&mut self) -> Result<(), Fault> {
        let Some(Track { keys, places, rows }) = self.line.take() else { return Ok(()) };
        let geometry = if places.len() < 2 { Value::Null } else { Value::Blob(track(&places)) };
        let values = [geometry].into_iter().chain(keys).chain([Value::Integer(rows)]);
        self.lines.insert(&self.database, [values.collect()].into_iter()).map_err(|e| failed(&e))
    }
}

impl TableWriter for GeoPackageWriter {
    fn write(&mut self, batch: &RecordBatch) -> Result<(), Fault> {
        if self.rows.is_none() {
            self.start(&batch.schema())?;
        }
        let columns: Vec<Vec<Value>> = batch.columns().iter().map(values).collect::<Result<_, _>>()?;
        let [lat, lon] = self.place.map(|i| numbers(batch.column(i)));
        let (lat, lon) = (lat?, lon?);
        let Some(table) = self.rows.take() else { return Err(Fault::bug("a GeoPackage has no table")) };
        let mut rows = Vec::with_capacity(batch.num_rows());
        for row in 0..batch.num_rows() {
            let own = columns.iter().map(|column| column.get(row).cloned().unwrap_or(Value::Null));
            let place = [lon.value(row), lat.value(row)];
            let is_known = place.iter().all(|x| x.is_finite());
            if is_known {
                self.extent.add(place);
            }
            let keys: Vec<Value> =
                own.clone().zip(&table.columns).filter(|(_, column)| column.is_key).map(|(value, _)| value).collect();
            if self.line.as_ref().is_none_or(|line| line.keys != keys) {
                self.end_line()?;
                self.line = Some(Track { keys, places: vec![], rows: 0 });
            }
            if let Some(line) = &mut self.line {
                line.rows += 1;
                line.places.extend(is_known.then_some(place));
            }
            let geometry = if is_known { Value::Blob(point(place)) } else { Value::Null };
            rows.push([geometry].into_iter().chain(own).collect::<Vec<Value>>());
        }
        let written = table.insert(&self.database, rows.into_iter()).map_err(|e| failed(&e));
        self.rows = Some(table);
        written
    }

    fn finish(mut self: Box<Self>, schema: &Schema) -> Result<(), Fault> {
        if self.rows.is_none() {
            self.start(schema)?;
        }
        self.end_line()?;
        let Some(rows) = &self.rows else { return Err(Fault::bug("a GeoPackage has no table")) };
        for table in [rows, &self.lines] {
            table.describe(&self.database, &self.extent).map_err(|e| failed(&e))?;
        }
        tables::end(&self.database).map_err(|e| failed(&e))?;
        self.database.close().map_err(|(_, e)| failed(&e))
    }
}

fn numbers(column: &ArrayRef) -> Result<Float64Array, Fault> {
    let numbers = cast(column, &DataType::Float64).map_err(|e| Fault::bug(e.to_string()))?;
    Ok(numbers.as_primitive::<Float64Type>().iter().map(|x| Some(x.unwrap_or(f64::NAN))).collect())
}

/// Values of a column in SQLite's types. NaN is a missing value.
fn values(column: &ArrayRef) -> Result<Vec<Value>, Fault> {
    let kind = column.data_type();
    if kind.is_floating() {
        let of = |x: f64| if x.is_nan() { Value::Null } else { Value::Real(x) };
        return Ok(numbers(column)?.values().iter().map(|x| of(*x)).collect());
    }
    if kind.is_integer() || matches!(kind, DataType::Boolean) {
        let whole = cast(column, &DataType::Int64).map_err(|e| Fault::bug(e.to_string()))?;
        if whole.null_count() > column.null_count() {
            return Err(Fault::new("a whole number is larger than a GeoPackage can store").help("use .parquet or .csv"));
        }
        let whole = whole.as_primitive::<arrow_array::types::Int64Type>();
        return Ok(whole.iter().map(|x| x.map_or(Value::Null, Value::Integer)).collect());
    }
    if matches!(kind, DataType::Timestamp(..)) {
        return tables::date_times(column);
    }
    let words = ArrayFormatter::try_new(column.as_ref(), &Default::default()).map_err(|e| Fault::bug(e.to_string()))?;
    let of = |row: usize| if column.is_null(row) { Value::Null } else { Value::Text(words.value(row).to_string()) };
    Ok((0..column.len()).map(of).collect())
}
