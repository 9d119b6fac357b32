//! The command line.

use std::{ffi::OsString, path::PathBuf};

use pyo3::prelude::*;

use crate::parts::catalogue;

/// Runs the command `magline` with `arguments` and returns its exit status. Child processes run `program`.
#[pyfunction]
pub fn command(py: Python<'_>, program: PathBuf, arguments: Vec<OsString>) -> u8 {
    py.detach(|| pipeline::command(&catalogue(), &program, arguments))
}
