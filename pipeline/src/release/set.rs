//! Self-description of a published set, as data: all documents are made from it, and verified against it.

use std::{collections::BTreeMap, fmt};

use serde::{Deserialize, Serialize};

/// Format of a published set and of its documents; increased when either changes.
pub const FORMAT: &str = "magline published set 1";

/// Published set.
#[derive(Clone, Debug, PartialEq)]
pub struct ReleaseSet {
    /// Tables and facts: the file `dictionary.json`.
    pub dictionary: DataDictionary,
    /// Provenance: the file `pipeline/lock.json`.
    pub lock: ReleaseLockfile,
}

/// Facts and tables of a set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DataDictionary {
    /// Always [`FORMAT`].
    pub format: String,
    /// The facts that only its authors know.
    pub about: ReleaseMetadata,
    /// Tables, in the requested order.
    pub tables: Vec<ReleaseTable>,
    /// Restricted columns in the set.
    pub restricted: Vec<RestrictedReleaseColumn>,
    /// Failures in the tables and in their inputs.
    pub failures: Vec<ReleaseFailure>,
}

/// The facts that only the authors of a set know.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReleaseMetadata {
    /// The title.
    pub title: String,
    /// Content and purpose.
    pub description: String,
    /// The authors.
    pub authors: Vec<Person>,
    /// The licence.
    pub licence: Licence,
    /// The date of publication, `YYYY-MM-DD`.
    pub date: String,
    /// An address for questions.
    pub contact: String,
    /// The version of the data set.
    pub version: String,
    /// DOI, without an address prefix.
    pub doi: Option<String>,
    /// Address of its page.
    pub url: Option<String>,
    /// Keywords for searches.
    pub keywords: Vec<String>,
    /// Reason for recording the data.
    pub motivation: Option<String>,
    /// Method of recording.
    pub collection: Option<String>,
    /// Possible uses.
    pub uses: Option<String>,
    /// Known faults and limits.
    pub limits: Option<String>,
}

impl ReleaseMetadata {
    /// Address that identifies the set: its DOI, or its page.
    pub fn address(&self) -> Option<String> {
        self.doi.as_ref().map(|doi| format!("https://doi.org/{doi}")).or(self.url.clone())
    }
}

/// An author.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Person {
    /// The name in full.
    pub name: String,
    /// The given names of a person.
    pub given: Option<String>,
    /// The family name of a person.
    pub family: Option<String>,
    /// The address of the ORCID.
    pub orcid: Option<String>,
    /// The institute.
    pub affiliation: Option<String>,
}

/// A licence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Licence {
    /// SPDX identifier, or another name.
    pub name: String,
    /// Full title.
    pub title: String,
    /// The address of the licence's text.
    pub url: String,
    /// Whether the name is an SPDX identifier.
    pub spdx: bool,
    /// Whether the file `LICENSE` holds the text of the licence, and not only its name and address.
    pub text: bool,
}

/// A table of a set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReleaseTable {
    /// Name.
    pub name: String,
    /// `flight lines`, `scores`, `model` or `map`.
    pub kind: String,
    /// Stage that made the table; `None` for a table from files.
    pub stage: Option<String>,
    /// Description of the stage.
    pub description: String,
    /// Axes of the sweep, which are columns of the table.
    pub axes: Vec<String>,
    /// Columns by which the rows of each file ascend.
    pub sorted_by: Vec<String>,
    /// Keys in the names of the folders. Readers of hive partitions add these keys as columns.
    pub partitions: Vec<String>,
    /// Number of rows.
    pub rows: u64,
    /// Columns.
    pub columns: Vec<ReleaseColumn>,
    /// Files, in order.
    pub files: Vec<DataFile>,
}

/// The type of a column's values.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub enum ColumnKind {
    /// Float64.
    Number,
    /// Int64.
    Integer,
    /// UTF-8.
    Text,
    /// True or false.
    Boolean,
    /// A list of Float64.
    Numbers,
    /// Any other type, in Arrow's notation.
    Other(String),
}

impl From<String> for ColumnKind {
    fn from(word: String) -> Self {
        let named = [Self::Number, Self::Integer, Self::Text, Self::Boolean, Self::Numbers];
        named.into_iter().find(|kind| kind.to_string() == word).unwrap_or(Self::Other(word))
    }
}

impl From<ColumnKind> for String {
    fn from(kind: ColumnKind) -> Self {
        kind.to_string()
    }
}

impl fmt::Display for ColumnKind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::Number => "number",
            Self::Integer => "integer",
            Self::Text => "text",
            Self::Boolean => "boolean",
            Self::Numbers => "list of numbers",
            Self::Other(word) => word,
        })
    }
}

/// A column of a table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReleaseColumn {
    /// Name.
    pub name: String,
    /// The type of its values.
    #[serde(rename = "type")]
    pub kind: ColumnKind,
    /// Unit; empty for none.
    pub unit: String,
    /// `key`, `time`, `truth`, `sensor`, `aux` or `derived`.
    pub role: String,
    /// Meaning of the column.
    pub description: String,
    /// The names of a list's entries.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub terms: Vec<String>,
    /// Columns from which the column was made, as `table.column`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub from: Vec<String>,
    /// Values of the column.
    #[serde(flatten)]
    pub values: ColumnValueStatistics,
}

/// Statistics of the values of a column.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ColumnValueStatistics {
    /// Number of rows without a value: null or NaN.
    pub missing: u64,
    /// Smallest finite number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Largest finite number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
}

/// A file of a table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DataFile {
    /// Path in the set.
    pub path: String,
    /// Flight, if the file holds one line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flight: Option<String>,
    /// Line, if the file holds one line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line: Option<String>,
    /// Number of rows.
    pub rows: u64,
    /// Size, in bytes.
    pub bytes: u64,
    /// SHA-256.
    pub sha256: String,
}

/// A restricted column that is included in a set.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RestrictedReleaseColumn {
    /// The table of the set.
    pub table: String,
    /// Column.
    pub column: String,
    /// Columns on the way from this column to the restricted column, as `table.column`.
    pub through: Vec<String>,
    /// Rule because of which a table on the way does not count as an aggregate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rule: Option<String>,
    /// Reason of the restriction.
    pub reason: Option<String>,
    /// End date of the restriction.
    pub embargo: Option<String>,
}

/// Result that could not be computed.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ReleaseFailure {
    /// The table.
    pub table: String,
    /// The flight, for a line.
    pub flight: Option<String>,
    /// The line.
    pub line: Option<String>,
    /// Number of points of the sweep.
    pub points: u64,
}

/// Provenance of a set: version, spec, inputs and stages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReleaseLockfile {
    /// Always [`FORMAT`].
    pub format: String,
    /// The version of magline.
    pub magline: String,
    /// Processor, and identifier of its floating-point results; empty in sets made by versions that did not record
    /// them.
    #[serde(default)]
    pub arithmetic: String,
    /// The pipeline.
    pub pipeline: String,
    /// The path of the spec in the set.
    pub spec: String,
    /// The spec's SHA-256.
    pub spec_sha256: String,
    /// Assignments of `--set` in the run.
    pub set: Vec<String>,
    /// The seed.
    pub seed: u64,
    /// Hash of the computation and its data.
    pub run: String,
    /// Files that were read.
    pub inputs: Vec<ReleaseInput>,
    /// The tables of the stages, in the order of the plan.
    pub stages: Vec<ReleaseStage>,
}

/// A file that was read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReleaseInput {
    /// The table of the spec.
    pub table: String,
    /// Path from the spec's folder, or the file name of an absolute path.
    pub file: String,
    /// Size, in bytes.
    pub bytes: u64,
    /// SHA-256.
    pub sha256: String,
    /// First 128 bits of the file's BLAKE3 hash, which identify the file in magline.
    pub blake3: String,
    /// Path in the set, if the file is included.
    pub included: Option<String>,
}

/// A table that a stage made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReleaseStage {
    /// The table.
    pub table: String,
    /// The stage.
    pub stage: String,
    /// The stage's version.
    pub version: u32,
    /// The tables it reads.
    pub inputs: Vec<String>,
    /// Predicate that selects the rows of the table.
    #[serde(rename = "where", default, skip_serializing_if = "Option::is_none")]
    pub predicate: Option<String>,
    /// The axes on which the table depends.
    pub axes: Vec<String>,
    /// Number of the table's sweep points.
    pub points: usize,
    /// Parameters in canonical spelling, each with its values at the points of the sweep.
    pub parameters: BTreeMap<String, Vec<String>>,
    /// Hash of the keys of all results of the table.
    pub key: String,
}
