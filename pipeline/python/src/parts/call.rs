//! Calls of Python functions by a run, and their exceptions as faults.

use pyo3::prelude::*;
use schemas::{Fault, FaultOwner};

/// Runs `call` with the GIL. An exception becomes a fault of the part `name`, with its traceback.
///
/// # Errors
/// Fails if Python raises an exception. The fault is not cached, because it may depend on more than the inputs.
pub fn in_python<T>(name: &str, call: impl FnOnce(Python<'_>) -> PyResult<T>) -> Result<T, Fault> {
    Python::attach(|py| call(py).map_err(|e| fault(py, name, &e)))
}

/// The fault of an exception: its text, and the traceback from the first frame of the part.
fn fault(py: Python<'_>, name: &str, e: &PyErr) -> Fault {
    let of = (e.value(py), e.traceback(py));
    let described = || py.import("magline._calls")?.call_method1("describe", of)?.extract::<String>();
    let text = described().unwrap_or_else(|_| e.to_string());
    Fault { what: format!("`{name}`, written in Python, raised {text}"), owner: FaultOwner::Bug, ..Fault::default() }
}

/// Fault of a part that returns something other than what it declares.
pub fn broken(name: &str, what: &str) -> Fault {
    Fault { what: format!("`{name}`, written in Python, {what}"), owner: FaultOwner::Bug, ..Fault::default() }
}
