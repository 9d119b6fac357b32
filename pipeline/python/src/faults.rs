//! Faults as exceptions of the Python module `magline.errors`.

use pipeline::plan::spec::SpecFaults;
use pyo3::{exceptions::PyValueError, prelude::*};
use schemas::{Fault, render};
use serde_json::{Value, json};

/// The exception for a fault.
pub fn exception(py: Python<'_>, fault: &Fault) -> PyErr {
    exceptions(py, std::slice::from_ref(fault))
}

/// The exception for several faults.
pub fn exceptions(py: Python<'_>, faults: &[Fault]) -> PyErr {
    let text: Vec<String> = faults.iter().map(|fault| render(fault, "", "")).collect();
    let records: Vec<Value> = faults.iter().map(|fault| record(fault, None)).collect();
    raised(py, &text.join("\n"), &records)
}

/// The exception for the faults of a spec.
pub fn spec_exception(py: Python<'_>, faults: &SpecFaults) -> PyErr {
    let line = |fault: &Fault| {
        let before = faults.text.get(..fault.at.as_ref()?.start)?;
        Some(before.matches('\n').count() + 1)
    };
    let records: Vec<Value> = faults.faults.iter().map(|fault| record(fault, line(fault))).collect();
    raised(py, &faults.to_string(), &records)
}

/// `ValueError` for an error of a numerical routine.
pub fn value_error(e: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(e.to_string())
}

/// A fault as an object, with its line in the spec from 1.
pub fn record(fault: &Fault, spec_line: Option<usize>) -> Value {
    let place = &fault.place;
    json!({
        "what": fault.what,
        "help": fault.help,
        "owner": fault.owner,
        "file": place.file,
        "flight": place.flight,
        "line": place.line,
        "column": place.column,
        "row": place.row,
        "spec_line": spec_line,
    })
}

fn raised(py: Python<'_>, text: &str, records: &[Value]) -> PyErr {
    let made = || -> PyResult<PyErr> {
        let records = Value::from(records.to_vec()).to_string();
        let value = py.import("magline.errors")?.call_method1("_from_json", (text, records))?;
        Ok(PyErr::from_value(value))
    };
    made().unwrap_or_else(|e| e)
}
