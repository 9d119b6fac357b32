//! Results of an examination of data, and the names of columns in a file.

use std::collections::BTreeMap;

use arrow_schema::Schema;
use serde::{Deserialize, Serialize};

/// The kind of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FindingKind {
    /// No value.
    Missing,
    /// An infinity; treated as missing.
    Infinite,
    /// A scalar magnetometer's reading of exactly 0 nT: a dropout; treated as missing.
    ZeroReading,
    /// Outside the limits of the column's role; treated as missing unless the table accepts it.
    Impossible,
    /// A scalar magnetometer whose readings are not a total field but vary like a residual: the core field was already
    /// removed.
    NotTotalField,
    /// Contradicts another column.
    Inconsistent,
    /// A sensor that never changes.
    Constant,
    /// A magnetometer that stays at one value for far longer than usual.
    Stuck,
}

impl FindingKind {
    /// The kind as text.
    pub const fn as_str(self) -> &'static str {
        match self {
            FindingKind::Missing => "missing",
            FindingKind::Infinite => "infinite",
            FindingKind::ZeroReading => "zero_reading",
            FindingKind::Impossible => "impossible",
            FindingKind::NotTotalField => "not_total_field",
            FindingKind::Inconsistent => "inconsistent",
            FindingKind::Constant => "constant",
            FindingKind::Stuck => "stuck",
        }
    }
}

/// One finding in one column of one line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// The column; for the magnitude of a vector magnetometer, the vector.
    pub column: String,
    /// The kind.
    pub check: FindingKind,
    /// The number of samples.
    pub n: u64,
    /// Row of the first affected sample in the line, from 0.
    pub first_row: u64,
    /// The value at that row, in the shortest spelling that parses to the same value; `None` if the value is missing or
    /// infinite.
    value: Option<String>,
    /// Unit of the value.
    pub unit: String,
}

impl Finding {
    pub(super) fn new(column: &str, check: FindingKind, n: usize, first: usize, value: f64, unit: &str) -> Finding {
        let value = value.is_finite().then(|| format!("{value:?}"));
        Finding { column: column.to_owned(), check, n: n as u64, first_row: first as u64, value, unit: unit.to_owned() }
    }

    /// The value of the first affected sample.
    pub fn value(&self) -> Option<f64> {
        self.value.as_ref().and_then(|v| v.parse().ok())
    }
}

/// Column names and units of a file, for messages about the spec.
#[derive(Clone, Debug, Default)]
pub struct FileColumns {
    columns: BTreeMap<String, (String, String)>,
    /// Whether a mapping defines the columns.
    mapping: bool,
}

impl FileColumns {
    /// Creates the names from the reader's schema and the table's `rename`.
    pub fn new(schema: &Schema, rename: &BTreeMap<String, String>) -> FileColumns {
        let theirs = |ours: &str| rename.iter().find(|(_, to)| *to == ours).map_or(ours, |(from, _)| from).to_owned();
        let unit = |f: &arrow_schema::Field| f.metadata().get("unit").cloned().unwrap_or_default();
        let columns = schema.fields().iter().map(|f| (f.name().clone(), (theirs(f.name()), unit(f)))).collect();
        FileColumns { columns, mapping: false }
    }

    /// Sets whether a mapping defines the columns.
    pub fn of_mapping(self, mapping: bool) -> FileColumns {
        FileColumns { mapping, ..self }
    }

    /// The file's name for the column `ours`.
    pub fn name<'a>(&'a self, ours: &'a str) -> &'a str {
        self.columns.get(ours).map_or(ours, |(name, _)| name)
    }

    /// The unit that the file or the spec gives; empty if neither gives a unit.
    pub(super) fn unit(&self, ours: &str) -> &str {
        self.columns.get(ours).map_or("", |(_, unit)| unit)
    }

    /// The text `units = { "name" = "unit" }` for the columns `ours`.
    pub fn units(&self, ours: &[&str], unit: &str) -> String {
        if self.mapping {
            let names: Vec<String> = ours.iter().map(|o| format!("`{o}`")).collect();
            return format!("set `unit = \"{unit}\"` for {} in the mapping", names.join(", "));
        }
        let each: Vec<String> = ours.iter().map(|o| format!("\"{}\" = \"{unit}\"", self.name(o))).collect();
        format!("set `units = {{ {} }}` in the table of the spec", each.join(", "))
    }
}
