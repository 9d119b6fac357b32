//! The spec: one TOML file, with the position of everything in it.

mod axis;
mod course;
mod faults;
pub mod licences;
mod parser;
pub mod publish;
mod search;
mod set;
mod several;

use std::{ops::Range, path::PathBuf, time::Duration};

use buckets::ObjectAddress;
use schemas::{Fault, Literal, SpecEntries};
use toml::{Spanned, de::DeValue};

pub use course::{RungOutcome, SearchState, SearchTrial, SearchTrialScore, best};
pub use faults::SpecFaults;
use parser::SpecParser;
use publish::{ProtectionKeys, PublishFacts};
pub use search::{
    GoalDirection, SearchAxis, SearchDocs, SearchSpec, SuccessiveHalving, TRIAL, docs as search_docs,
    reference as search_reference,
};

/// Range of bytes in the spec; the bytes of the `--set` assignments follow the bytes of the file.
pub type SpecSpan = Range<usize>;

/// A parsed spec, not yet checked against the catalogue or the data.
#[derive(Clone, Debug)]
pub struct Spec {
    /// The file, as the user named it.
    pub file: String,
    /// The folder that relative paths start from.
    pub folder: PathBuf,
    /// The text, for messages.
    pub text: String,
    /// The assignments of `--set` that were applied, for messages.
    pub sets: Vec<String>,
    /// The pipeline's name.
    pub name: String,
    /// The seed of every random draw.
    pub seed: u64,
    /// The store's folder.
    pub store: PathBuf,
    /// Address of a store in an object store, and the place of the address in the spec. The folder is then a copy of
    /// that store.
    pub store_at: Option<(ObjectAddress, SpecSpan)>,
    /// Tables read from files.
    pub tables: Vec<SourceDecl>,
    /// The axes of the sweep; searched axes are last.
    pub axes: Vec<SweepAxis>,
    /// Positions of the searched axes. The i-th values of all searched axes form one trial.
    pub searched: Range<usize>,
    /// Search of the spec.
    pub search: Option<SearchSpec>,
    /// The trials that give the values of the searched axes.
    pub trials: Vec<SearchTrial>,
    /// The stages.
    pub stages: Vec<StageDecl>,
    /// Metadata of a published set, or the faults in them, which only `magline publish` reports.
    pub publish: Option<Result<PublishFacts, Vec<Fault>>>,
    /// Whether the bytes of every input are read, even if it appears unchanged. This setting is not part of the spec
    /// file.
    pub verify_inputs: bool,
    /// Minimum age of a flight file; newer files are skipped. This setting is not part of the spec file.
    pub settle: Option<Duration>,
}

/// A table read from files.
#[derive(Clone, Debug)]
pub struct SourceDecl {
    /// Name in the spec.
    pub name: String,
    /// Position of its declaration.
    pub at: SpecSpan,
    /// Path, with position.
    pub path: (String, SpecSpan),
    /// Restrictions on publishing.
    pub protection: ProtectionKeys,
    /// Other keys.
    pub options: SpecEntries,
}

/// One axis: a key column and its values.
#[derive(Clone, Debug)]
pub struct SweepAxis {
    /// The column's name.
    pub name: String,
    /// Position of its declaration.
    pub at: SpecSpan,
    /// The values, all of one type, in the order of the spec. The key column of a list holds its entries joined by `+`.
    pub values: Vec<Literal>,
}

/// One stage of the spec.
#[derive(Clone, Debug)]
pub struct StageDecl {
    /// The name of the table that the stage yields.
    pub name: String,
    /// Position of the name.
    pub at: SpecSpan,
    /// The kind of stage, with position.
    pub stage: (String, SpecSpan),
    /// The `where` of the stage, if set.
    pub predicate: Option<(String, SpecSpan)>,
    /// Whether the stage's table is published; later stages can read the table in any case.
    pub publish: bool,
    /// Columns that pass through the stage and are also written to its published table, each with its position.
    pub carry: Vec<(String, SpecSpan)>,
    /// Whether the stage's results are stored, with the position of the key; otherwise the results are recomputed on
    /// demand.
    pub keep: (bool, SpecSpan),
    /// Inputs and parameters, before axes are substituted.
    pub args: SpecEntries,
}

/// The keys of a stage that are neither inputs nor parameters, and their meanings.
pub const STAGE_KEYS: [(&str, &str); 6] = [
    ("name", "the name of the table that the stage makes; required"),
    ("stage", "the kind of stage, one of the stages below; required"),
    (
        "where",
        "an SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage processes each line \
         separately, the predicate may contain only the columns `flight` and `line`",
    ),
    ("publish", "`false`: the table is not published, but later stages can read it (default: `true`)"),
    (
        "carry",
        "columns that pass through the stage unchanged into its published table, such as \
         `[\"lat\", \"lon\"]`; only for tables of flight lines (default: none)",
    ),
    (
        "keep",
        "`false`: results are not stored, but recomputed when required; only for tables of flight lines with \
         `publish = false` (default: `true`)",
    ),
];

const TOP: [&str; 8] = ["name", "seed", "store", "tables", "axes", "search", "stages", "publish"];

impl Spec {
    /// Reads the spec `text` of `file` with the assignments `sets`. Relative paths start from `folder`. An assignment
    /// is `KEY=VALUE`; KEY is `name`, `seed`, `store`, `axes.NAME`, `search.KEY`, `tables.NAME.KEY`, `publish.KEY` or
    /// `STAGE.PARAMETER` (also `stages.STAGE.PARAMETER`). A VALUE that is not TOML is text.
    ///
    /// # Errors
    /// Fails with all faults of the spec's form, each with its position.
    pub fn parse(file: &str, folder: PathBuf, text: String, sets: &[String]) -> Result<Spec, SpecFaults> {
        let mut read = SpecParser::default();
        let spec = read.document(file, folder, &text, sets);
        match spec {
            Some(spec) if read.faults.is_empty() => Ok(spec),
            _ => Err(SpecFaults { file: file.to_owned(), text, sets: sets.to_vec(), faults: read.faults }),
        }
    }

    /// The faults with this spec's text, for display.
    pub fn faults(&self, faults: Vec<Fault>) -> SpecFaults {
        SpecFaults { file: self.file.clone(), text: self.text.clone(), sets: self.sets.clone(), faults }
    }

    /// A copy with the trials `rows` as the values of the searched axes; unchanged without searched axes.
    pub fn with_trials(&self, rows: &[SearchTrial]) -> Spec {
        let mut spec = self.clone();
        if let Some(search) = &self.search {
            spec.axes.truncate(self.searched.start);
            spec.axes.extend(course::axes(search, rows));
            spec.searched = self.searched.start..spec.axes.len();
            spec.trials = rows.to_vec();
        }
        spec
    }

    /// The axis `name`, if the spec contains it.
    pub fn axis(&self, name: &str) -> Option<usize> {
        self.axes.iter().position(|a| a.name == name)
    }
}

/// String shortened for a message, on one line.
fn plain(text: &str) -> String {
    const SHOWN: usize = 60;
    let line: String = text.chars().take(SHOWN).map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect();
    if text.chars().count() > SHOWN { format!("{line}...") } else { line }
}

/// A TOML value as a literal; a table is rejected.
fn literal(value: &Spanned<DeValue>) -> Result<Literal, Fault> {
    match argument(value)? {
        Literal::Section(_) => Err(no_table(value)),
        other => Ok(other),
    }
}

/// A TOML value as a literal, including a table of values by name; a list of tables is rejected.
fn argument(value: &Spanned<DeValue>) -> Result<Literal, Fault> {
    let first = |faults: Vec<Fault>| faults.into_iter().next().unwrap_or_else(|| Fault::bug("a value is invalid"));
    match schemas::literal(value).map_err(first)? {
        Literal::List(items) if items.iter().any(|item| matches!(item, Literal::Section(_))) => Err(no_table(value)),
        other => Ok(other),
    }
}

fn no_table(value: &Spanned<DeValue>) -> Fault {
    Fault::new("a table is not permitted here").at(value.span())
}
