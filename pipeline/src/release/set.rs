//! Self-description of a published set, as data: all its documents are made of this, and checked against it.

use std::{collections::BTreeMap, fmt};

use serde::{Deserialize, Serialize};

/// The layout of a published set and of its documents; raised when either changes.
pub const FORMAT: &str = "magline published set 1";

/// A published set.
#[derive(Clone, Debug, PartialEq)]
pub struct ReleaseSet {
    /// Its tables and facts: the file `dictionary.json`.
    pub dictionary: DataDictionary,
    /// How it was made: the file `pipeline/lock.json`.
    pub lock: ReleaseLockfile,
}

/// The facts and tables of a set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DataDictionary {
    /// [`FORMAT`].
    pub format: String,
    /// The facts that only its authors know.
    pub about: ReleaseMetadata,
    /// Its tables, in the order in which they were asked for.
    pub tables: Vec<ReleaseTable>,
    /// Restricted columns in the set.
    pub restricted: Vec<RestrictedReleaseColumn>,
    /// Failures in the tables and in those that they are made from.
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
    /// The DOI, without an address before it.
    pub doi: Option<String>,
    /// The address of its page.
    pub url: Option<String>,
    /// Words to find it by.
    pub keywords: Vec<String>,
    /// Why the data were recorded.
    pub motivation: Option<String>,
    /// How they were recorded.
    pub collection: Option<String>,
    /// Possible uses.
    pub uses: Option<String>,
    /// Known faults and limits.
    pub limits: Option<String>,
}

impl ReleaseMetadata {
    /// The address that the set is known by: that of its DOI, or of its page.
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
    /// Its SPDX identifier, or another name.
    pub name: String,
    /// Full title.
    pub title: String,
    /// The address of its text.
    pub url: String,
    /// Whether the name is an SPDX identifier.
    pub spdx: bool,
    /// Whether the file `LICENSE` holds its text, and not only its name and address.
    pub text: bool,
}

/// A table of a set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReleaseTable {
    /// Its name.
    pub name: String,
    /// `flight lines`, `scores`, `model` or `map`.
    pub kind: String,
    /// The stage that made it; `None` for what was read from files.
    pub stage: Option<String>,
    /// Description of that stage.
    pub description: String,
    /// The axes of the sweep, which are columns.
    pub axes: Vec<String>,
    /// The columns by which the rows of each file ascend.
    pub sorted_by: Vec<String>,
    /// The names of the folders' keys: columns that readers add which know hive partitions.
    pub partitions: Vec<String>,
    /// Its rows.
    pub rows: u64,
    /// Its columns.
    pub columns: Vec<ReleaseColumn>,
    /// Its files, in order.
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
    /// Any other type, as Arrow spells it.
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
    /// Its name.
    pub name: String,
    /// The type of its values.
    #[serde(rename = "type")]
    pub kind: ColumnKind,
    /// Its unit; empty for none.
    pub unit: String,
    /// `key`, `time`, `truth`, `sensor`, `aux` or `derived`.
    pub role: String,
    /// Meaning of the column.
    pub description: String,
    /// The names of a list's entries.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub terms: Vec<String>,
    /// The columns it was made from, as `table.column`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub from: Vec<String>,
    /// Values of the column.
    #[serde(flatten)]
    pub values: ColumnValueStatistics,
}

/// Statistics of the values of a column.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ColumnValueStatistics {
    /// Rows without a value: null or NaN.
    pub missing: u64,
    /// The least finite number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// The greatest finite number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
}

/// A file of a table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DataFile {
    /// Its path in the set.
    pub path: String,
    /// The flight, where it holds one line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flight: Option<String>,
    /// The line, where it holds one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line: Option<String>,
    /// Its rows.
    pub rows: u64,
    /// Its bytes.
    pub bytes: u64,
    /// Its SHA-256.
    pub sha256: String,
}

/// A restricted column that is included in a set.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RestrictedReleaseColumn {
    /// The table of the set.
    pub table: String,
    /// Its column.
    pub column: String,
    /// From this column to the restricted one, as `table.column`.
    pub through: Vec<String>,
    /// The rule by which a table among them is no aggregate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rule: Option<String>,
    /// Why that is restricted.
    pub reason: Option<String>,
    /// Until when.
    pub embargo: Option<String>,
}

/// A result that could not be computed.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ReleaseFailure {
    /// The table.
    pub table: String,
    /// The flight, for a line.
    pub flight: Option<String>,
    /// The line.
    pub line: Option<String>,
    /// At how many points of the sweep.
    pub points: u64,
}

/// Provenance of a set: version, spec, inputs and stages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReleaseLockfile {
    /// [`FORMAT`].
    pub format: String,
    /// The version of magline.
    pub magline: String,
    /// The processor and what its last bits are known by; empty in sets of versions that did not note it.
    #[serde(default)]
    pub arithmetic: String,
    /// The pipeline.
    pub pipeline: String,
    /// The path of its spec in the set.
    pub spec: String,
    /// The spec's SHA-256.
    pub spec_sha256: String,
    /// The assignments of `--set` that it was run with.
    pub set: Vec<String>,
    /// The seed.
    pub seed: u64,
    /// The hash of what was computed and of its data.
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
    /// The file: from the spec's folder, or its name alone where it is given by an absolute path.
    pub file: String,
    /// Its bytes.
    pub bytes: u64,
    /// Its SHA-256.
    pub sha256: String,
    /// The first 128 bits of its BLAKE3, by which magline knows it.
    pub blake3: String,
    /// Its path in the set, where it is included.
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
    /// The rows it is restricted to.
    #[serde(rename = "where", default, skip_serializing_if = "Option::is_none")]
    pub predicate: Option<String>,
    /// The axes it depends on.
    pub axes: Vec<String>,
    /// The number of its points of the sweep.
    pub points: usize,
    /// Its parameters in one spelling, each with the values it has at the points of the sweep.
    pub parameters: BTreeMap<String, Vec<String>>,
    /// The hash of the keys of all that it made.
    pub key: String,
}
