//! Runs and checks of specs.

use std::{
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError, atomic::Ordering},
    time::Instant,
};

use pipeline::{
    ProgressDisplay,
    plan::{
        Plan, parse_spec, read_spec,
        spec::{Spec, SpecFaults},
    },
    results::{made_by_another, score_table},
    run::{INTERRUPTED, Listener, RunOptions, STARTED, SilentListener, search},
    run_summary,
    store::Store,
};
use pyo3::prelude::*;
use rayon::ThreadPoolBuilder;
use schemas::Fault;
use serde_json::{Value, json};

use crate::{
    attended::{attended, attended_with},
    faults::{record, spec_exception},
    parts::{catalogue, settle},
};

/// Lock that permits only one run at a time in this process, because the flags of an interrupt belong to one run.
static RUN: Mutex<()> = Mutex::new(());

/// Maximum number of rows of a table of scores as text.
const ROWS: usize = 100;

/// A spec in a file, or as text.
pub struct SpecSource {
    /// The file, or the name of the text in messages.
    pub file: PathBuf,
    /// Folder from which relative paths start if the spec is given as text.
    pub folder: PathBuf,
    /// The text; without it, the file is read.
    pub text: Option<String>,
    /// Assignments, as for `--set`.
    pub sets: Vec<String>,
}

impl SpecSource {
    /// Reads the spec.
    pub fn read(&self) -> Result<Spec, SpecFaults> {
        match &self.text {
            Some(text) => {
                let name = self.file.display().to_string();
                parse_spec(&name, self.folder.clone(), text.clone(), &self.sets)
            }
            None => read_spec(&self.file, &self.sets),
        }
    }
}

/// Runs a spec and returns its summary as JSON. Without `text`, the spec is read from `file`. `progress` is called with
/// the current stage, the number of finished parts and the number of all parts, which is 0 while it is unknown.
#[pyfunction]
#[pyo3(signature = (file, folder, text, sets, threads, progress))]
pub fn run(
    py: Python<'_>,
    file: PathBuf,
    folder: PathBuf,
    text: Option<String>,
    sets: Vec<String>,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<String> {
    settle(py)?;
    let source = SpecSource { file, folder, text, sets };
    let interrupt = || INTERRUPTED.store(true, Ordering::SeqCst);
    let done = match progress {
        None => attended(py, move || execute(&source, threads, &SilentListener), interrupt)?,
        Some(show) => {
            let display = Arc::new(ProgressDisplay::unseen());
            let (listener, mut last) = (display.clone(), None);
            let look = || {
                let now = display.snapshot().filter(|now| last.as_ref() != Some(now));
                let Some(now) = now else { return Ok(()) };
                show.call1((&now.what, now.done, now.all))?;
                last = Some(now);
                Ok(())
            };
            attended_with(py, move || execute(&source, threads, &*listener), interrupt, look)?
        }
    };
    done.map(|summary| summary.to_string()).map_err(|faults| spec_exception(py, &faults))
}

/// Checks a spec and returns `{tables, points, notes}` as JSON.
#[pyfunction]
#[pyo3(signature = (file, folder, text, sets))]
pub fn check(
    py: Python<'_>,
    file: PathBuf,
    folder: PathBuf,
    text: Option<String>,
    sets: Vec<String>,
) -> PyResult<String> {
    settle(py)?;
    let source = SpecSource { file, folder, text, sets };
    let checked = move || -> Result<Value, SpecFaults> {
        let plan = Plan::new(source.read()?, &catalogue())?;
        let points: usize = plan.tables.iter().map(|t| plan.most_points(t)).sum();
        let tables: Vec<&str> = plan.tables.iter().map(|t| t.name.as_str()).collect();
        Ok(json!({ "tables": tables, "points": points, "notes": plan.notes }))
    };
    let done = attended(py, checked, || ())?;
    done.map(|found| found.to_string()).map_err(|faults| spec_exception(py, &faults))
}

fn execute(source: &SpecSource, threads: Option<usize>, listener: &dyn Listener) -> Result<Value, SpecFaults> {
    let _one = RUN.lock().unwrap_or_else(PoisonError::into_inner);
    INTERRUPTED.store(false, Ordering::SeqCst);
    STARTED.store(false, Ordering::SeqCst);
    let begun = Instant::now();
    let catalogue = catalogue();
    let spec = source.read()?;
    if let Some(other) = made_by_another(&spec) {
        let what = format!("the pipeline `{}` in this store was made by another spec, {other}", spec.name);
        return Err(spec.faults(vec![Fault::new(what).help("change `store` or `name` in the spec")]));
    }
    let plan = Plan::new(spec, &catalogue)?;
    let store = Store::open(&plan.spec.store).map_err(|f| plan.spec.faults(vec![f]))?;
    let publisher = store.publisher(&plan.spec.name, false).map_err(|f| plan.spec.faults(vec![f]))?;
    let pool = ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).build();
    let pool = pool.map_err(|e| plan.spec.faults(vec![Fault::machine(format!("cannot start threads: {e}"))]))?;
    let ran = || search(plan, &catalogue, &store, &publisher, RunOptions::default(), listener);
    let (plan, summary) = pool.install(ran)?;
    let mut found = run_summary(&summary, begun.elapsed().as_secs_f64());
    if let Some(failures) = found.get_mut("failures").and_then(Value::as_array_mut) {
        for (one, failure) in failures.iter_mut().zip(&summary.failures) {
            one["fault"] = record(&failure.fault, None);
        }
    }
    let shown = |(name, scores): &(String, pipeline::results::scores::Scores)| {
        let text = score_table::render(scores, score_table::WIDTH, ROWS);
        let units: Vec<&str> = scores.metrics.iter().map(|m| m.unit).collect();
        json!({ "stage": name, "over": scores.over(), "text": text, "units": units })
    };
    found["score_tables"] = summary.scores.iter().map(shown).collect();
    found["pipeline"] = json!(plan.spec.name);
    found["store"] = json!(plan.spec.store.display().to_string());
    Ok(found)
}
