//! Views of a spec and its results: the plan, the changes since the last run, and the report.

use std::path::PathBuf;

use pipeline::{
    plan::{Plan, PlanGraph, spec::SpecFaults},
    report::{explain as explain_plan, html, why as why_table},
    run::settled,
    store::Store,
};
use pyo3::prelude::*;
use schemas::Fault;

use crate::{
    attended::attended,
    faults::spec_exception,
    parts::{catalogue, settle},
    runs::SpecSource,
};

/// The plan of a spec as text: tables, axes, stored results and the cost of each stage.
#[pyfunction]
#[pyo3(signature = (file, folder, text, sets))]
pub fn explain(
    py: Python<'_>,
    file: PathBuf,
    folder: PathBuf,
    text: Option<String>,
    sets: Vec<String>,
) -> PyResult<String> {
    let source = SpecSource { file, folder, text, sets };
    view(py, source, |graph, store| Ok(explain_plan(graph, store)))
}

/// The changes since `table` was last computed, as text.
#[pyfunction]
#[pyo3(signature = (file, folder, text, sets, table))]
pub fn why(
    py: Python<'_>,
    file: PathBuf,
    folder: PathBuf,
    text: Option<String>,
    sets: Vec<String>,
    table: String,
) -> PyResult<String> {
    let source = SpecSource { file, folder, text, sets };
    view(py, source, move |graph, store| why_table(graph, store, &table))
}

/// The report of a run: one HTML page.
#[pyfunction]
#[pyo3(signature = (file, folder, text, sets))]
pub fn report(
    py: Python<'_>,
    file: PathBuf,
    folder: PathBuf,
    text: Option<String>,
    sets: Vec<String>,
) -> PyResult<String> {
    let source = SpecSource { file, folder, text, sets };
    view(py, source, html::report)
}

/// Runs `show` on the graph of a spec. For a search, the graph has the trials that follow from the scores in the store.
fn view(
    py: Python<'_>,
    source: SpecSource,
    show: impl FnOnce(&PlanGraph, &Store) -> Result<String, Fault> + Send + 'static,
) -> PyResult<String> {
    settle(py)?;
    let shown = move || -> Result<String, SpecFaults> {
        let catalogue = catalogue();
        let plan = Plan::new(source.read()?, &catalogue)?;
        let store = Store::open(&plan.spec.store).map_err(|fault| plan.spec.faults(vec![fault]))?;
        let plan = settled(plan, &catalogue, &store, &|_, _| ())?;
        let graph = PlanGraph::new(&plan, &store, &|_, _| ())?;
        show(&graph, &store).map_err(|fault| plan.spec.faults(vec![fault]))
    };
    attended(py, shown, || ())?.map_err(|faults| spec_exception(py, &faults))
}
