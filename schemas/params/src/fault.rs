//! Fault, its place, and the remedy.

use std::{fmt, ops::Range};

use serde::{Deserialize, Serialize};

use crate::one_line;

/// Party that must correct a fault.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FaultOwner {
    /// The spec or an argument: the user corrects it.
    #[default]
    Spec,
    /// The data: a file, flight, line, column or row.
    Data,
    /// The machine: a disk, a permission, memory. A retry may help, so the fault is not cached.
    Machine,
    /// magline or a stage: its author corrects it. The fault may be absent in another version, so it is not cached.
    Bug,
}

impl FaultOwner {
    /// Whether the same computation has the same fault on every machine and in every version.
    pub fn is_lasting(self) -> bool {
        match self {
            FaultOwner::Spec | FaultOwner::Data => true,
            FaultOwner::Machine | FaultOwner::Bug => false,
        }
    }
}

/// Location of a fault in the data. Every part is optional.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DataLocation {
    /// Path of the file, as the user gave it.
    pub file: Option<String>,
    /// The flight identifier.
    pub flight: Option<String>,
    /// The line identifier.
    pub line: Option<String>,
    /// The column.
    pub column: Option<String>,
    /// The row within the line (or within the file if the line is unknown), from 0.
    pub row: Option<u64>,
}

/// Error with its location and remedy.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "FaultRecord", into = "FaultRecord")]
pub struct Fault {
    /// Description of the fault: one sentence, lower case.
    pub what: String,
    /// Remedy.
    pub help: Option<String>,
    /// Byte range of the fault in the spec.
    pub at: Option<Range<usize>>,
    /// The parameter of the stage that contains the fault. The planner converts it to a byte range in the spec.
    pub param: Option<String>,
    /// Location in the data.
    pub place: DataLocation,
    /// Party that has to act. A serialised fault without `owner` is a fault of the data.
    pub owner: FaultOwner,
}

/// Serialised form of a fault: an object with the keys that have a value. The position in the spec is omitted.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FaultRecord {
    what: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    help: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    file: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    flight: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    line: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    column: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    row: Option<u64>,
    #[serde(default = "data", skip_serializing_if = "is_data")]
    owner: FaultOwner,
}

fn data() -> FaultOwner {
    FaultOwner::Data
}

fn is_data(owner: &FaultOwner) -> bool {
    *owner == FaultOwner::Data
}

impl From<Fault> for FaultRecord {
    fn from(Fault { what, help, place, owner, .. }: Fault) -> FaultRecord {
        let DataLocation { file, flight, line, column, row } = place;
        FaultRecord { what, help, file, flight, line, column, row, owner }
    }
}

impl From<FaultRecord> for Fault {
    fn from(record: FaultRecord) -> Fault {
        let FaultRecord { what, help, file, flight, line, column, row, owner } = record;
        let place = DataLocation { file, flight, line, column, row };
        Fault { what, help, place, owner, ..Fault::default() }
    }
}

impl Fault {
    /// A fault of the spec.
    pub fn new(what: impl Into<String>) -> Self {
        Self { what: what.into(), ..Self::default() }
    }

    /// A fault of the data.
    pub fn data(what: impl Into<String>) -> Self {
        Self { what: what.into(), owner: FaultOwner::Data, ..Self::default() }
    }

    /// A fault of the machine, such as a full disk.
    pub fn machine(what: impl Into<String>) -> Self {
        Self { what: what.into(), owner: FaultOwner::Machine, ..Self::default() }
    }

    /// An error in the program: a state that correct code cannot reach.
    pub fn bug(what: impl Into<String>) -> Self {
        let what = format!("{}: an error in magline", what.into());
        Self { what, owner: FaultOwner::Bug, ..Self::default() }.help("please report this error, with the spec")
    }

    /// Sets the remedy.
    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }

    /// Sets the byte range in the spec, unless it is already set.
    pub fn at(mut self, at: Range<usize>) -> Self {
        self.at.get_or_insert(at);
        self
    }

    /// Sets the parameter of the stage.
    pub fn of_param(mut self, param: &str) -> Self {
        self.param.get_or_insert_with(|| param.to_owned());
        self
    }

    /// Sets the column.
    pub fn in_column(mut self, column: &str) -> Self {
        self.place.column.get_or_insert_with(|| column.to_owned());
        self
    }

    /// Sets the row, from 0.
    pub fn in_row(mut self, row: u64) -> Self {
        self.place.row.get_or_insert(row);
        self
    }

    /// Sets the flight and line.
    pub fn in_line(mut self, flight: &str, line: &str) -> Self {
        self.place.flight.get_or_insert_with(|| flight.to_owned());
        self.place.line.get_or_insert_with(|| line.to_owned());
        self
    }

    /// Sets the file.
    pub fn in_file(mut self, file: &str) -> Self {
        self.place.file.get_or_insert_with(|| file.to_owned());
        self
    }

    /// Suggests the element of `known` that is nearest to `given`, or lists all of `known`.
    pub fn nearest<S: AsRef<str>>(mut self, given: &str, known: &[S]) -> Self {
        self.help = Some(match nearest(given, known) {
            Some(name) => format!("did you mean `{name}`?"),
            None if known.is_empty() => "there are none".to_owned(),
            None => format!("known here: {}", listed(known)),
        });
        self
    }
}

impl Fault {
    /// Same as [`Fault::nearest`], for the name of a part that may be written in Python: a stage, model, filter or
    /// metric. Unless a known name is near, the remedy includes the option that loads such parts.
    pub fn nearest_part<S: AsRef<str>>(self, given: &str, known: &[S]) -> Self {
        let mut fault = self.nearest(given, known);
        if let Some(help) = fault.help.as_mut().filter(|_| nearest(given, known).is_none()) {
            help.push_str("; to load parts written in Python, use `magline --parts FILE.py`");
        }
        fault
    }
}

fn listed<S: AsRef<str>>(known: &[S]) -> String {
    const SHOWN: usize = 30;
    let names: Vec<&str> = known.iter().take(SHOWN).map(AsRef::as_ref).collect();
    let more = known.len().saturating_sub(SHOWN);
    if more > 0 { format!("{} and {more} more", names.join(", ")) } else { names.join(", ") }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let p = &self.place;
        let parts = [
            p.file.clone(),
            p.flight.as_ref().map(|x| format!("flight {x}")),
            p.line.as_ref().map(|x| format!("line {x}")),
            p.column.as_ref().map(|x| format!("column `{x}`")),
            p.row.map(|x| format!("row {x}")),
        ];
        let place: Vec<String> = parts.into_iter().flatten().collect();
        if !place.is_empty() {
            write!(f, "{}: ", one_line(&place.join(", ")))?;
        }
        write!(f, "{}", self.what)?;
        if let Some(help) = &self.help {
            write!(f, " ({help})")?;
        }
        Ok(())
    }
}

impl std::error::Error for Fault {}

/// Maximum length of a misspelt name, in bytes. For a longer text, time and memory of the search would be excessive.
const LONGEST_GUESS: usize = 200;

/// The element of `known` that was probably meant by `given`; `None` for a `given` of more than 200 bytes.
pub fn nearest<'a, S: AsRef<str>>(given: &str, known: &'a [S]) -> Option<&'a str> {
    if given.len() > LONGEST_GUESS {
        return None;
    }
    let most = 1 + given.len() / 3;
    // The edit distance is at least the difference between the lengths.
    let near = |k: &&str| k.chars().count().abs_diff(given.chars().count()) <= most;
    let best = known.iter().map(AsRef::as_ref).filter(near).map(|k| (distance(given, k), k)).min()?;
    (best.0 <= most).then_some(best.1)
}

/// Edit distance with transpositions, by characters.
fn distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let mut rows = vec![vec![0; b.len() + 1]; a.len() + 1];
    for i in 0..=a.len() {
        for j in 0..=b.len() {
            rows[i][j] = if i == 0 || j == 0 {
                i + j
            } else {
                let change = usize::from(a[i - 1] != b[j - 1]);
                let mut least = (rows[i - 1][j] + 1).min(rows[i][j - 1] + 1).min(rows[i - 1][j - 1] + change);
                if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                    least = least.min(rows[i - 2][j - 2] + 1);
                }
                least
            };
        }
    }
    rows[a.len()][b.len()]
}

/// The text of a fault for the user, with the line of the spec that contains it.
pub fn render(fault: &Fault, file: &str, text: &str) -> String {
    let bare = Fault { help: None, ..fault.clone() };
    let help = fault.help.as_deref();
    let Some(at) = fault.at.clone().filter(|r| r.start <= text.len() && text.is_char_boundary(r.start)) else {
        let tail = help.map(|h| format!("\n  help: {h}")).unwrap_or_default();
        return format!("error: {bare}{tail}");
    };
    let before = &text[..at.start];
    let number = before.matches('\n').count() + 1;
    let from = before.rfind('\n').map_or(0, |i| i + 1);
    let source = text[from..].lines().next().unwrap_or("");
    let column = text[from..at.start].chars().count();
    let room = source.chars().count().saturating_sub(column).max(1);
    let marks = "^".repeat(at.len().clamp(1, room));
    let gutter = " ".repeat(number.to_string().len());
    let tail = help.map(|h| format!(" {h}")).unwrap_or_default();
    format!(
        "error: {bare}\n{gutter}--> {file}:{number}:{}\n{number} | {source}\n{gutter} | {}{marks}{tail}",
        column + 1,
        " ".repeat(column),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gold_a_fault_shows_the_word_and_a_suggestion() {
        let text = "a = 1\nlamda = 0.025\n";
        let fault = Fault::new("`fit` has no parameter `lamda`").at(6..11).nearest("lamda", &["lambda", "low_hz"]);
        let shown = render(&fault, "cabin.toml", text);
        assert_eq!(
            shown,
            "error: `fit` has no parameter `lamda`\n --> cabin.toml:2:1\n\
             2 | lamda = 0.025\n  | ^^^^^ did you mean `lambda`?"
        );
    }

    #[test]
    fn unit_distance_is_a_metric_with_transpositions() {
        assert_eq!(distance("lambda", "lambda"), 0);
        assert_eq!(distance("lamdba", "lambda"), 1);
        assert_eq!(distance("", "abc"), 3);
        assert_eq!(nearest("navigat", &["navigate", "score"]), Some("navigate"));
        assert_eq!(nearest("zzzzzz", &["navigate", "score"]), None);
    }

    #[test]
    fn bug_a_name_of_a_megabyte_is_compared_with_no_other() {
        let long = "a".repeat(1 << 20);
        assert_eq!(nearest(&long, &["navigate", &long]), None);
        assert_eq!(nearest("navigat", &[&long, "navigate"]), Some("navigate"));
    }

    #[test]
    fn gold_place_in_the_data_reads_as_a_sentence() {
        let fault = Fault::data("time goes back").in_line("1003", "1003.02").in_column("tt").in_row(7);
        assert_eq!(fault.to_string(), "flight 1003, line 1003.02, column `tt`, row 7: time goes back");
    }
}
