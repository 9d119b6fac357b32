//! `--summary`: outcome of a run as JSON. `datasets/examples/schedule/run_summary.schema.json` describes it.

use run::{OutcomeCounts, TableComparison};
use serde_json::{Value, json};
use store::{ForeignLock, current};

use super::watch::{RunEnd, RunWatchState};
use crate::cli::events::{counts, failure, merged, warning};

/// The summary of a run.
pub fn json(state: &RunWatchState, end: &RunEnd) -> Value {
    let published = state.published(end);
    let tables = state.tables.iter().map(|(name, count, seconds)| {
        let table = published.as_ref().and_then(|v| v.manifest.tables.iter().find(|t| t.name == *name));
        let files = table.map(|t| t.files.len());
        let bytes = table.map(|t| t.files.iter().map(|f| f.size).sum::<u64>());
        let about = json!({ "seconds": seconds, "files": files, "bytes": bytes });
        merged(merged(json!({ "name": name }), counts(count)), about)
    });
    let tables: Vec<Value> = tables.collect();
    let total = state.tables.iter().fold(OutcomeCounts::default(), |sum, (_, count, _)| sum + *count);
    let run = end.summary;
    json!({
        "schema": "urn:magline:run-summary:1",
        "magline": env!("CARGO_PKG_VERSION"),
        "id": state.id.to_string(),
        "status": end.status.as_str(),
        "exit": end.status.exit(),
        "error": end.error,
        "pipeline": state.pipeline,
        "spec": state.spec,
        "spec_hash": state.spec_hash,
        "sets": state.sets,
        "store": state.store,
        "run": state.run,
        "version": published.as_ref().map(|v| v.number),
        "host": store::host(),
        "pid": std::process::id(),
        "started": state.started,
        "ended": store::clock::now_ms(),
        "seconds": state.begun.elapsed().as_secs_f64(),
        "units": counts(&total),
        "tables": tables,
        "left": run.map(|s| s.left.clone()).unwrap_or_default(),
        "compared": run.map(|s| s.compared.iter().map(compared).collect::<Vec<_>>()).unwrap_or_default(),
        "failures": run.map(|s| s.failures.iter().map(failure).collect::<Vec<_>>()).unwrap_or_default(),
        "warnings": run.map(|s| s.warnings.iter().map(warning).collect::<Vec<_>>()).unwrap_or_default(),
        "notes": run.map(|s| s.notes.clone()).unwrap_or_default(),
        "holder": state.held.as_ref().and_then(holder),
    })
}

/// Outcome of the recomputation of a table.
pub fn compared(one: &TableComparison) -> Value {
    json!({ "table": one.table, "units": one.units, "differ": one.differ.len() })
}

fn holder(held: &ForeignLock) -> Option<Value> {
    let holder = held.holder.as_ref()?;
    let silent = held.silent.map(|s| s.as_secs_f64());
    Some(json!({ "host": holder.host, "pid": holder.pid, "since": holder.since, "silent": silent }))
}

impl RunWatchState {
    /// Version of the tables that the run published, if any.
    pub fn published(&self, end: &RunEnd) -> Option<store::Version> {
        end.summary.filter(|s| !s.interrupted)?;
        current(self.root.as_ref()?, self.pipeline.as_ref()?)
    }
}
