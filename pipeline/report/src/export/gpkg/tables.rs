//! Tables of a GeoPackage: the required tables, and the tables of the features.

use std::collections::HashSet;

use arrow_array::{Array, ArrayRef, cast::AsArray, types::TimestampMillisecondType};
use arrow_cast::{
    cast,
    display::{ArrayFormatter, FormatOptions},
};
use arrow_schema::{DataType, Field, TimeUnit};
use rusqlite::{Connection, params, params_from_iter, types::Value};
use schemas::Fault;

use super::geometry::{Extent, WGS84};

/// The required tables and rows. [OGC 12-128r19, annex C; extension `gpkg_schema`]
const REQUIRED: &str = r#"
PRAGMA page_size = 4096;
PRAGMA application_id = 1196444487;
PRAGMA user_version = 10400;
PRAGMA journal_mode = OFF;
PRAGMA synchronous = OFF;
BEGIN;
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER NOT NULL PRIMARY KEY,
  organization TEXT NOT NULL, organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT);
INSERT INTO gpkg_spatial_ref_sys VALUES
  ('Undefined Cartesian SRS', -1, 'NONE', -1, 'undefined', 'undefined Cartesian coordinate reference system'),
  ('Undefined geographic SRS', 0, 'NONE', 0, 'undefined', 'undefined geographic coordinate reference system'),
  ('WGS 84 geodetic', 4326, 'EPSG', 4326, 'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,'
   || 'AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],'
   || 'UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],AXIS["Latitude",NORTH],AXIS["Longitude",EAST],'
   || 'AUTHORITY["EPSG","4326"]]', 'longitude/latitude coordinates in decimal degrees on the WGS 84 spheroid');
CREATE TABLE gpkg_contents (table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL, identifier TEXT UNIQUE,
  description TEXT DEFAULT '', last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
  min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE, srs_id INTEGER,
  CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (table_name TEXT NOT NULL, column_name TEXT NOT NULL,
  geometry_type_name TEXT NOT NULL, srs_id INTEGER NOT NULL, z TINYINT NOT NULL, m TINYINT NOT NULL,
  CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name),
  CONSTRAINT uk_gc_table_name UNIQUE (table_name),
  CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES gpkg_contents(table_name),
  CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys (srs_id));
CREATE TABLE gpkg_extensions (table_name TEXT, column_name TEXT, extension_name TEXT NOT NULL, definition TEXT NOT NULL,
  scope TEXT NOT NULL, CONSTRAINT ge_tce UNIQUE (table_name, column_name, extension_name));
CREATE TABLE gpkg_data_columns (table_name TEXT NOT NULL, column_name TEXT NOT NULL, name TEXT, title TEXT,
  description TEXT, mime_type TEXT, constraint_name TEXT,
  CONSTRAINT pk_gdc PRIMARY KEY (table_name, column_name), CONSTRAINT gdc_tn UNIQUE (table_name, name));
CREATE TABLE gpkg_data_column_constraints (constraint_name TEXT NOT NULL, constraint_type TEXT NOT NULL, value TEXT,
  min NUMERIC, min_is_inclusive BOOLEAN, max NUMERIC, max_is_inclusive BOOLEAN, description TEXT,
  CONSTRAINT gdcc_ntv UNIQUE (constraint_name, constraint_type, value));
INSERT INTO gpkg_extensions VALUES
  ('gpkg_data_columns', NULL, 'gpkg_schema', 'http://www.geopackage.org/spec121/#extension_schema', 'read-write'),
  ('gpkg_data_column_constraints', NULL, 'gpkg_schema', 'http://www.geopackage.org/spec121/#extension_schema',
   'read-write');
"#;

/// Value of `last_change`. It is constant, because files of the same data must be equal.
const UNCHANGED: &str = "1970-01-01T00:00:00.000Z";

/// Creates the required tables. A failed export removes the file, so that no journal is needed.
pub fn begin(database: &Connection) -> rusqlite::Result<()> {
    database.execute_batch(REQUIRED)
}

/// Ends the file.
pub fn end(database: &Connection) -> rusqlite::Result<()> {
    database.execute_batch("COMMIT;")
}

/// A column of a table of features.
#[derive(Clone)]
pub struct FeatureColumn {
    name: String,
    sql_type: &'static str,
    /// Whether the column is a key, such as the line.
    pub is_key: bool,
    unit: String,
    description: String,
}

impl FeatureColumn {
    /// The column of a field.
    pub fn new(field: &Field) -> FeatureColumn {
        let of = |key: &str| field.metadata().get(key).cloned().unwrap_or_default();
        let sql_type = match field.data_type() {
            DataType::Boolean => "BOOLEAN",
            DataType::Timestamp(..) => "DATETIME",
            kind if kind.is_floating() => "DOUBLE",
            kind if kind.is_integer() => "INTEGER",
            _ => "TEXT",
        };
        let name = field.name().clone();
        FeatureColumn { name, sql_type, is_key: of("role") == "key", unit: of("unit"), description: of("description") }
    }

    /// A column of whole numbers.
    pub fn count(name: &str, description: &str) -> FeatureColumn {
        let (name, description) = (name.to_owned(), description.to_owned());
        FeatureColumn { name, sql_type: "INTEGER", is_key: false, unit: String::new(), description }
    }
}

/// A table of features.
pub struct FeatureTable {
    name: String,
    geometry: &'static str,
    /// Columns in addition to `fid` and `geom`.
    pub columns: Vec<FeatureColumn>,
    /// Names of the columns in the file.
    names: Vec<String>,
}

fn quoted(name: &str) -> String {
    format!("\"{}\"", name.replace('"', "\"\""))
}

impl FeatureTable {
    /// A table with geometries of one type. SQLite ignores the case of names, so a number is appended to a column name
    /// that differs from another only in case.
    pub fn new(name: &str, geometry: &'static str, columns: Vec<FeatureColumn>) -> FeatureTable {
        let reserved = ["gpkg_", "sqlite_", "rtree_"].iter().any(|start| name.to_ascii_lowercase().starts_with(start));
        let name = if reserved { format!("table_{name}") } else { name.to_owned() };
        let mut taken: HashSet<String> = ["fid", "geom"].map(str::to_owned).into();
        let free = |column: &FeatureColumn| {
            let mut own = column.name.clone();
            let mut n = 2;
            while !taken.insert(own.to_lowercase()) {
                own = format!("{}_{n}", column.name);
                n += 1;
            }
            own
        };
        let names = columns.iter().map(free).collect();
        FeatureTable { name, geometry, columns, names }
    }

    /// Creates the table.
    pub fn create(&self, database: &Connection) -> rusqlite::Result<()> {
        let columns =
            self.names.iter().zip(&self.columns).map(|(name, c)| format!(", {} {}", quoted(name), c.sql_type));
        let (table, geometry) = (quoted(&self.name), self.geometry);
        let columns: String = columns.collect();
        database.execute_batch(&format!(
            "CREATE TABLE {table} (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom {geometry}{columns});"
        ))
    }

    /// Appends rows: the geometry, then a value for each column.
    pub fn insert(&self, database: &Connection, rows: impl Iterator<Item = Vec<Value>>) -> rusqlite::Result<()> {
        let names: String = self.names.iter().map(|name| format!(", {}", quoted(name))).collect();
        let marks = ", ?".repeat(self.names.len());
        let sql = format!("INSERT INTO {} (geom{names}) VALUES (?{marks})", quoted(&self.name));
        let mut insert = database.prepare(&sql)?;
        for row in rows {
            insert.execute(params_from_iter(row))?;
        }
        Ok(())
    }

    /// Registers the table, its geometries, and the units and descriptions of its columns.
    pub fn describe(&self, database: &Connection, extent: &Extent) -> rusqlite::Result<()> {
        let ends = [extent.low[0], extent.low[1], extent.high[0], extent.high[1]];
        let [west, south, east, north] = ends.map(|x| (!extent.is_empty()).then_some(x));
        database.execute(
            "INSERT INTO gpkg_contents VALUES (?1, 'features', ?1, '', ?2, ?3, ?4, ?5, ?6, ?7)",
            params![self.name, UNCHANGED, west, south, east, north, WGS84],
        )?;
        database.execute(
            "INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, 0, 0)",
            params![self.name, self.geometry, WGS84],
        )?;
        for (own, column) in self.names.iter().zip(&self.columns) {
            let FeatureColumn { name, unit, description, .. } = column;
            let title = if unit.is_empty() { name.clone() } else { format!("{name} [{unit}]") };
            database.execute(
                "INSERT INTO gpkg_data_columns VALUES (?1, ?2, ?2, ?3, ?4, NULL, NULL)",
                params![self.name, own, title, description],
            )?;
        }
        Ok(())
    }
}

/// Times as the format's text, in milliseconds.
pub fn date_times(column: &ArrayRef) -> Result<Vec<Value>, Fault> {
    let wrong = |e: arrow_schema::ArrowError| Fault::bug(e.to_string());
    let times = cast(column, &DataType::Timestamp(TimeUnit::Millisecond, None)).map_err(wrong)?;
    let times = times.as_primitive::<TimestampMillisecondType>();
    let form = FormatOptions::new().with_timestamp_format(Some("%Y-%m-%dT%H:%M:%S%.3fZ"));
    let words = ArrayFormatter::try_new(times, &form).map_err(wrong)?;
    let of = |row: usize| if times.is_null(row) { Value::Null } else { Value::Text(words.value(row).to_string()) };
    Ok((0..times.len()).map(of).collect())
}
