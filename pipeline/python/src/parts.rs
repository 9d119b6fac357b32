//! Parts of a pipeline that are written in Python: stages, models, filters and metrics.
//!
//! The module `magline.parts` describes a part and calls [`register_part`]. Parts belong to the process. A run adds
//! them to the built-in catalogue ([`catalogue`]), so plans, keys, lineage and reports treat them as built-in parts.

mod call;
mod filter;
mod line;
mod metric;
mod model;
mod params;
mod stage;

use std::{
    collections::BTreeMap,
    sync::{PoisonError, RwLock, RwLockReadGuard},
};

use pipeline::plan::spec::STAGE_KEYS;
use pyo3::{
    exceptions::{PyRuntimeError, PyValueError},
    prelude::*,
};
use schemas::{ParamDoc, StageEntry};
use serde::Deserialize;

use self::{
    filter::FilterPart,
    metric::MetricPart,
    model::ModelPart,
    params::{PartParam, PartParamDecl, leaked},
    stage::StagePart,
};

pub use filter::Flight;
pub use line::{ColumnView, Line};

/// Properties that all parts have.
#[derive(Debug, Deserialize)]
pub struct PartDecl {
    name: String,
    version: u32,
    /// Hash of the source text of the part and its helpers.
    source: String,
    /// Documentation.
    doc: String,
    /// Module and qualified name of the function or class. Only the same function or class may replace a part.
    origin: String,
    params: Vec<PartParamDecl>,
}

/// Properties of a registered part.
pub struct PartHead {
    name: &'static str,
    version: u32,
    source: &'static str,
    doc: &'static str,
    origin: String,
    params: Vec<PartParam>,
    /// The Python function that runs the part.
    run: Py<PyAny>,
}

impl PartHead {
    fn new(decl: PartDecl, run: Py<PyAny>) -> Result<PartHead, String> {
        let PartDecl { name, version, source, doc, origin, params } = decl;
        let params = params.into_iter().map(PartParam::new).collect::<Result<Vec<_>, String>>()?;
        let (name, source, doc) = (leaked(&name), leaked(&source), leaked(&doc));
        Ok(PartHead { name, version, source, doc, origin, params, run })
    }

    /// Documentation of its parameters.
    fn documents(&self) -> Vec<ParamDoc> {
        self.params.iter().map(PartParam::document).collect()
    }

    /// Rejects a parameter with one of the names `taken`, which have another meaning.
    fn reserve(&self, taken: &[&str]) -> Result<(), String> {
        match self.params.iter().find(|param| taken.contains(&param.name)) {
            Some(param) => {
                Err(format!("the parameter `{}` of `{}` has the same name as another key", param.name, self.name))
            }
            None => Ok(()),
        }
    }
}

/// The parts of this process, by name.
#[derive(Default)]
struct PartRegistry {
    stages: BTreeMap<&'static str, &'static StagePart>,
    models: BTreeMap<&'static str, &'static ModelPart>,
    filters: BTreeMap<&'static str, &'static FilterPart>,
    metrics: BTreeMap<&'static str, &'static MetricPart>,
}

static PARTS: RwLock<PartRegistry> = RwLock::new(PartRegistry {
    stages: BTreeMap::new(),
    models: BTreeMap::new(),
    filters: BTreeMap::new(),
    metrics: BTreeMap::new(),
});

fn parts() -> RwLockReadGuard<'static, PartRegistry> {
    PARTS.read().unwrap_or_else(PoisonError::into_inner)
}

/// The built-in stages, models, filters and metrics, and those written in Python.
pub fn catalogue() -> Vec<StageEntry> {
    let mut catalogue = pipeline::Catalogue::default();
    let parts = parts();
    catalogue.stages.extend(parts.stages.values().map(|part| part.entry()));
    catalogue.models.extend(parts.models.values().map(|part| part.decl));
    catalogue.filters.extend(parts.filters.values().map(|part| part.decl));
    catalogue.metrics.extend(parts.metrics.values().map(|part| part.scorer));
    drop(parts);
    catalogue.entries()
}

/// Computes the hashes of the sources again, because a module may define functions and constants that a part uses after
/// the part.
///
/// # Errors
/// Raises `ValueError` if a source is not available.
pub fn settle(py: Python<'_>) -> PyResult<()> {
    py.import("magline.parts")?.call_method0("_settle").map(|_| ())
}

/// Registers a part, or replaces the part of the same function. `kind` is `stage`, `model`, `filter` or `metric`;
/// `declaration` is JSON.
///
/// # Errors
/// Raises `ValueError` for a name that a built-in part or another function has, or for an invalid declaration.
#[pyfunction]
pub fn register_part(kind: &str, declaration: &str, run: Py<PyAny>) -> PyResult<()> {
    register(kind, declaration, run).map_err(PyValueError::new_err)
}

fn register(kind: &str, declaration: &str, run: Py<PyAny>) -> Result<(), String> {
    let wrong = |e: serde_json::Error| e.to_string();
    let built_in = pipeline::Catalogue::default();
    let mut registry = PARTS.write().unwrap_or_else(PoisonError::into_inner);
    match kind {
        "stage" => {
            let part = StagePart::new(serde_json::from_str(declaration).map_err(wrong)?, run)?;
            part.head.reserve(&STAGE_KEYS.map(|(key, _)| key))?;
            part.head.reserve(&["input", "source"])?;
            let names: Vec<&str> = built_in.entries().iter().map(|entry| entry.name).collect();
            add(&mut registry.stages, part, &names, |part| &part.head)
        }
        "model" => {
            let part = ModelPart::new(serde_json::from_str(declaration).map_err(wrong)?, run)?;
            let fit = stages::fit::entry(vec![]);
            let keys: Vec<&str> = fit.params.iter().map(|param| param.name).collect();
            part.head.reserve(&keys)?;
            part.head.reserve(&fit.inputs.iter().map(|input| input.name).collect::<Vec<_>>())?;
            part.head.reserve(&STAGE_KEYS.map(|(key, _)| key))?;
            let names: Vec<&str> = built_in.models.iter().map(|model| model.name).collect();
            add(&mut registry.models, part, &names, |part| part.head)
        }
        "filter" => {
            let part = FilterPart::new(serde_json::from_str(declaration).map_err(wrong)?, run)?;
            let navigate = stages::navigate::entry(vec![]);
            let keys: Vec<&str> = navigate.params.iter().map(|param| param.name).collect();
            part.head.reserve(&keys)?;
            part.head.reserve(&navigate.inputs.iter().map(|input| input.name).collect::<Vec<_>>())?;
            part.head.reserve(&STAGE_KEYS.map(|(key, _)| key))?;
            let names: Vec<&str> = built_in.filters.iter().map(|filter| filter.name).collect();
            add(&mut registry.filters, part, &names, |part| part.head)
        }
        "metric" => {
            let part = MetricPart::new(serde_json::from_str(declaration).map_err(wrong)?, run)?;
            let names: Vec<&str> = built_in.metrics.iter().map(|scorer| scorer.metric.name).collect();
            add(&mut registry.metrics, part, &names, |part| &part.head)
        }
        other => Err(format!("there is no kind of part `{other}`")),
    }
}

/// Adds a part for the rest of the process. A replaced part stays in memory, because a run may use it.
fn add<T>(
    all: &mut BTreeMap<&'static str, &'static T>,
    part: T,
    built_in: &[&str],
    head: impl Fn(&T) -> &PartHead,
) -> Result<(), String> {
    let PartHead { name, origin, .. } = head(&part);
    let name = *name;
    if built_in.contains(&name) {
        return Err(format!("`{name}` is the name of a built-in part; choose another name"));
    }
    if let Some(other) = all.get(name).map(|known| &head(known).origin).filter(|other| *other != origin) {
        return Err(format!("`{name}` is already the name of {other}; choose another name"));
    }
    all.insert(name, Box::leak(Box::new(part)));
    Ok(())
}

/// Adds the functions and types to the module.
///
/// # Errors
/// Fails if Python rejects them.
pub fn register_types(module: &Bound<'_, PyModule>) -> PyResult<()> {
    stages::trained::set_external_reader(model::read);
    module.add_class::<Flight>()?;
    module.add_class::<Line>()?;
    module.add_class::<ColumnView>()?;
    module.add_function(wrap_pyfunction!(register_part, module)?)?;
    module.add_function(wrap_pyfunction!(registered_parts, module)?)
}

/// Kind, name, version and hash of the source of each registered part.
#[pyfunction]
pub fn registered_parts() -> PyResult<Vec<(&'static str, &'static str, u32, &'static str)>> {
    let parts = PARTS.read().map_err(|e| PyRuntimeError::new_err(e.to_string()))?;
    let row = |kind: &'static str, head: &PartHead| (kind, head.name, head.version, head.source);
    let stages = parts.stages.values().map(|part| row("stage", &part.head));
    let models = parts.models.values().map(|part| row("model", part.head));
    let filters = parts.filters.values().map(|part| row("filter", part.head));
    let metrics = parts.metrics.values().map(|part| row("metric", &part.head));
    Ok(stages.chain(models).chain(filters).chain(metrics).collect())
}
