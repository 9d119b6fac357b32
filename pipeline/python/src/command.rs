//! The command line.

use std::{ffi::OsString, path::PathBuf};

use pyo3::prelude::*;

use crate::parts::{catalogue, settle};

/// Runs the command `magline` with `arguments` and returns its exit status. Child processes run `program`.
#[pyfunction]
pub fn command(py: Python<'_>, program: PathBuf, arguments: Vec<OsString>) -> PyResult<u8> {
    settle(py)?;
    Ok(py.detach(|| pipeline::command(&catalogue(), &program, arguments)))
}
