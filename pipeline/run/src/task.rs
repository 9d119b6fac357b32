//! Tasks and receipts: requests to and answers from a worker, as plain data. `pipeline/TASKS.md` describes their form.

use std::collections::BTreeMap;

use plan::{LineId, PlanGraph, PlanUnit};
use schemas::{Fault, Literal, keys::HashKey};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use store::Store;

use super::events::UnitOutcome;

/// Format number of tasks and receipts.
const FORM: u64 = 1;

/// Version of this program.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Units of one table that are computed together and written into one file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Format number of this object.
    task: u64,
    /// Version of the program that made the task.
    pub magline: String,
    /// Plan, a file of the store; `None` for a task within this process.
    pub plan: Option<HashKey>,
    /// Name of the table.
    pub table: String,
    /// Whether the task makes only a part of a file of the table, not a whole file.
    #[serde(default, skip_serializing_if = "is_false")]
    pub part: bool,
    /// Units, in the order of the table's rows.
    pub units: Vec<TaskUnit>,
}

/// Unit of a task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskUnit {
    /// Position of the sweep point.
    pub point: usize,
    /// Position of the line among the lines of the plan; `None` for a survey stage.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line: Option<LineId>,
    /// Key of the result.
    pub key: HashKey,
    /// Whether the result is already in the store, so that it is only copied into the file of the task.
    #[serde(default, skip_serializing_if = "is_false")]
    pub have: bool,
    /// Unusable lines of a survey stage, sorted.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub without: Vec<LineId>,
}

impl TaskUnit {
    /// Unit of the plan, in the table `table`.
    pub fn unit(&self, table: usize) -> PlanUnit {
        PlanUnit { table, instance: self.point, line: self.line }
    }
}

/// Outcome of a task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Receipt {
    /// Format number of this object.
    receipt: u64,
    /// Version of the program that made the receipt.
    pub magline: String,
    /// Plan, as in the task.
    pub plan: Option<HashKey>,
    /// Name of the table.
    pub table: String,
    /// Hash of plan, table and keys.
    pub task: HashKey,
    /// Units with an answer, in the order of the task.
    pub units: Vec<UnitAnswer>,
    /// Reason why the task was rejected.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub refused: Option<String>,
    /// Whether the worker ended after this task, because a unit exceeded its time limit.
    #[serde(default, skip_serializing_if = "is_false")]
    pub ended: bool,
    /// Wall time, in seconds.
    pub seconds: f64,
    /// Host and process of the worker.
    pub worker: String,
}

/// Outcome of a unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnitAnswer {
    /// Position of the sweep point.
    pub point: usize,
    /// Position of the line among the lines of the plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub line: Option<LineId>,
    /// Key of the result.
    pub key: HashKey,
    /// Values of the sweep point, for display.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub axes: BTreeMap<String, String>,
    /// Flight and line, for display.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<(String, String)>,
    /// Outcome of the unit.
    pub outcome: UnitOutcome,
    /// Fault of a failed unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fault: Option<Fault>,
}

// Serde requires this signature.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_false(it: &bool) -> bool {
    !it
}

impl Task {
    /// Task of this version.
    pub fn new(plan: Option<HashKey>, table: &str, part: bool, units: Vec<TaskUnit>) -> Task {
        Task { task: FORM, magline: VERSION.to_owned(), plan, table: table.to_owned(), part, units }
    }

    /// The same task with other units, marked as a part of a file.
    pub fn part_of(&self, units: Vec<TaskUnit>) -> Task {
        Task { part: true, units, ..Task::new(self.plan, &self.table, true, vec![]) }
    }

    /// Parses a task from one line of text.
    ///
    /// # Errors
    /// Fails for a string that is not JSON, is not a task, or has another format number.
    pub fn parse(text: &str) -> Result<Task, Fault> {
        parsed(text, "task")
    }

    /// Hash of plan, table and keys.
    pub fn id(&self) -> HashKey {
        let plan = self.plan.map(|key| key.to_string()).unwrap_or_default();
        let keys = self.units.iter().map(|u| u.key.to_string());
        HashKey::from_parts(["task".to_owned(), plan, self.table.clone()].into_iter().chain(keys))
    }

    /// Receipt of the task.
    pub fn receipt(&self, units: Vec<UnitAnswer>) -> Receipt {
        Receipt {
            receipt: FORM,
            magline: VERSION.to_owned(),
            plan: self.plan,
            table: self.table.clone(),
            task: self.id(),
            units,
            refused: None,
            ended: false,
            seconds: 0.0,
            worker: String::new(),
        }
    }

    /// Units to compute: their results are not in the store.
    pub fn wanted(&self) -> impl Iterator<Item = &TaskUnit> {
        self.units.iter().filter(|unit| !unit.have)
    }

    /// Receipt in which all wanted units failed with the same fault.
    pub fn failure(&self, fault: &Fault) -> Receipt {
        self.receipt(self.wanted().map(|unit| UnitAnswer::failed(unit, fault)).collect())
    }

    /// Receipt of a rejected task, with the reason.
    pub fn refusal(&self, why: &Fault) -> Receipt {
        let help = why.help.as_ref().map(|help| format!("; {help}")).unwrap_or_default();
        Receipt { refused: Some(format!("{why}{help}")), ..self.receipt(vec![]) }
    }
}

impl Receipt {
    /// Parses a receipt from one line of text.
    ///
    /// # Errors
    /// Returns the errors of [`Task::parse`].
    pub fn parse(text: &str) -> Result<Receipt, Fault> {
        parsed(text, "receipt")
    }

    /// Adds data for display: the values of the sweep points, flights and lines.
    pub fn name(&mut self, graph: &PlanGraph, table: usize) {
        for answer in &mut self.units {
            let point = graph.plan.instance(table, answer.point).point();
            answer.axes = point.into_iter().map(|(name, value): (String, Literal)| (name, value.to_string())).collect();
            answer.place = answer.line.and_then(|line| graph.lines.get(line).cloned());
        }
    }
}

impl UnitAnswer {
    /// Answer for a unit of a task.
    pub fn new(unit: &TaskUnit, outcome: UnitOutcome, fault: Option<Fault>) -> UnitAnswer {
        let TaskUnit { point, line, key, .. } = *unit;
        UnitAnswer { point, line, key, axes: BTreeMap::new(), place: None, outcome, fault }
    }

    /// Answer for a unit that failed.
    pub fn failed(unit: &TaskUnit, fault: &Fault) -> UnitAnswer {
        UnitAnswer::new(unit, UnitOutcome::Failed, Some(fault.clone()))
    }

    /// Answer for a unit whose result or failure is in the store; `None` for any other unit.
    pub fn stored(unit: &TaskUnit, store: &Store) -> Option<UnitAnswer> {
        match store.find(unit.key)?.rows {
            Some(_) => Some(UnitAnswer::new(unit, UnitOutcome::Reused, None)),
            None => store.failed(unit.key).ok()?.map(|fault| UnitAnswer::failed(unit, &fault)),
        }
    }
}

/// Parses a JSON object from one line. The entry `word` of the object must be the current format number.
fn parsed<T: DeserializeOwned>(text: &str, word: &str) -> Result<T, Fault> {
    let help = "`magline tasks` writes one task per line";
    let cut = |e: serde_json::Error| {
        let why = if e.is_eof() { "the line is truncated".to_owned() } else { format!("not JSON: {e}") };
        Fault::new(format!("the line is not a {word}: {why}")).help(help)
    };
    let value: serde_json::Value = serde_json::from_str(text).map_err(cut)?;
    let form = value.get(word).and_then(serde_json::Value::as_u64);
    match form {
        Some(FORM) => {
            serde_json::from_value(value).map_err(|e| Fault::new(format!("the {word} is incomplete: {e}")).help(help))
        }
        Some(other) => {
            let what = format!("the {word} has format {other}, but magline {VERSION} supports only format {FORM}");
            Err(Fault::new(what).help("use the same version for tasks and workers"))
        }
        None => Err(Fault::new(format!("the line is JSON, but not a {word}")).help(help)),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn task() -> Task {
        let unit = |line, without| TaskUnit { point: 3, line, key: HashKey::from_parts(["a"]), have: false, without };
        Task::new(Some(HashKey::from_parts(["plan"])), "fit", true, vec![unit(None, vec![2, 5]), unit(Some(7), vec![])])
    }

    #[test]
    fn unit_tasks_and_receipts_round_trip() {
        let task = task();
        let text = serde_json::to_string(&task).unwrap();
        assert_eq!(Task::parse(&text).unwrap(), task);
        let fault = Fault::machine("no room").help("make some").in_line("1", "1.02").in_row(5);
        let mut receipt = task.receipt(vec![
            UnitAnswer::new(&task.units[0], UnitOutcome::Failed, Some(fault)),
            UnitAnswer::new(&task.units[1], UnitOutcome::Computed, None),
        ]);
        receipt.units[1].place = Some(("1".to_owned(), "1.02".to_owned()));
        receipt.seconds = 0.1 + 0.2;
        let text = serde_json::to_string(&receipt).unwrap();
        let read = Receipt::parse(&text).unwrap();
        assert_eq!((&read.units, read.task), (&receipt.units, task.id()));
        assert!(Task::parse(&text).is_err() && !text.contains('\n'));
    }

    #[test]
    fn unit_truncated_foreign_or_unknown_lines_are_rejected_with_the_reason() {
        let text = serde_json::to_string(&task()).unwrap();
        for at in 1..text.len() {
            let fault = Task::parse(&text[..at]).unwrap_err();
            assert!(fault.what.contains("the line is truncated"), "{at}: {fault}");
        }
        let parse_fault = |text: &str| Task::parse(text).unwrap_err().what;
        assert!(parse_fault(r#"{"event":"started"}"#).contains("is JSON, but not a"));
        assert!(
            parse_fault("[1, 2]").contains("is JSON, but not a") && parse_fault("17").contains("is JSON, but not a")
        );
        assert!(parse_fault("fit 7").contains("not JSON"));
        assert!(parse_fault(&text.replace(r#"{"task":1"#, r#"{"task":2"#)).contains("format 2"));
        assert!(parse_fault(&text.replace(r#""point":3"#, r#""point":-3"#)).contains("incomplete"));
        assert!(parse_fault(&text.replace(r#""point":3"#, r#""punkt":3"#)).contains("punkt"));
        assert!(parse_fault(&text.replace(&HashKey::from_parts(["a"]).to_string(), "xyz")).contains("not a key"));
    }
}
