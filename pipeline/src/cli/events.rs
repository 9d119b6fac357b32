//! `--json`: one event per line on standard output.

use std::time::Instant;

use plan::{
    SweepPoint,
    spec::{SearchSpec, SearchTrialScore},
};
use results::{
    scores::{InSampleScores, Scores},
    warnings::Warning,
};
use run::{Event, Failure, Listener, OutcomeCounts, RunSummary};
use serde_json::{Map, Value, json};
use store::clock;

use super::{say::out, schedule::compared};

/// JSON events on standard output.
pub struct JsonEvents {
    begun: Instant,
}

impl JsonEvents {
    /// Creates the listener and starts its clock.
    pub fn new() -> JsonEvents {
        JsonEvents { begun: Instant::now() }
    }
}

impl Listener for JsonEvents {
    fn on_event(&self, event: &Event) {
        // A closed reader does not stop the run; a full disk sets its exit status.
        match event {
            // One object per trial.
            Event::Trials { search, scored, best } => {
                scored.iter().for_each(|one| out!("{}\n", trial(search, one, *best)));
            }
            _ => out!("{}\n", self.as_json(event)),
        }
    }
}

impl JsonEvents {
    fn as_json(&self, event: &Event) -> Value {
        match event {
            Event::Reading { table, step } => json!({
                "event": "reading",
                "table": table,
                "file": step.file.display().to_string(),
                "simulated": step.simulated,
                "lines": step.lines,
                "of_lines": step.of_lines,
                "done": step.done,
                "all": step.all,
            }),
            Event::Started { pipeline, units, run, notes, .. } => json!({
                "event": "started",
                "pipeline": pipeline,
                "version": env!("CARGO_PKG_VERSION"),
                "run": run,
                "time": clock::now(),
                "units": units,
                "notes": notes,
            }),
            Event::Computing { table, units } => json!({ "event": "computing", "table": table, "units": units }),
            Event::Working { table, point, progress } => json!({
                "event": "working",
                "table": table,
                "axes": point_json(point),
                "progress": progress,
            }),
            Event::Waiting { what } => json!({ "event": "waiting", "for": what }),
            Event::Searching { rows, trials, best } => json!({
                "event": "searching",
                "generation": rows.first().map(|r| r.generation),
                "rung": rows.first().map(|r| r.rung),
                "trials": rows.iter().map(|r| r.trial).collect::<Vec<_>>(),
                "of": trials,
                "best": best_json(*best),
            }),
            Event::Trials { search, scored, best } => {
                scored.iter().map(|one| trial(search, one, *best)).collect::<Vec<_>>().into()
            }
            Event::Trying { table, remedy } => json!({ "event": "trying", "table": table, "remedy": remedy }),
            Event::Publishing { table } => json!({ "event": "publishing", "table": table }),
            Event::Unit { table, point, line, outcome, fault } => json!({
                "event": "unit",
                "table": table,
                "axes": point_json(point),
                "flight": line.map(|l| &l.0),
                "line": line.map(|l| &l.1),
                "status": outcome.as_str(),
                "error": fault.map(ToString::to_string),
            }),
            Event::Table { table, count, seconds } => {
                merged(json!({ "event": "table", "table": table, "seconds": seconds }), counts(count))
            }
            Event::Finished { summary } => {
                // The keys `event` and `computed` come first, because scripts search the text for them.
                let head = merged(json!({ "event": "finished" }), counts(&summary.total()));
                merged(head, finished(summary, self.begun.elapsed().as_secs_f64()))
            }
        }
    }
}

/// Summary of a run that took `seconds`, as an object with the keys of the event `finished`, except the totals.
pub fn finished(summary: &RunSummary, seconds: f64) -> Value {
    let tables = summary.tables.iter().zip(&summary.seconds);
    let tables: Map<_, _> = tables
        .map(|((name, count), seconds)| (name.clone(), merged(counts(count), json!({ "seconds": seconds }))))
        .collect();
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "run": summary.run,
        "time": clock::now(),
        "seconds": seconds,
        "folder": summary.folder.display().to_string(),
        "tables": tables,
        "failures": summary.failures.iter().map(failure).collect::<Vec<_>>(),
        "notes": summary.notes,
        "warnings": summary.warnings.iter().map(warning).collect::<Vec<_>>(),
        "scores": summary.scores.iter().flat_map(|(name, s)| scores(name, s)).collect::<Vec<_>>(),
        "quality": summary.quality,
        "left": summary.left,
        "compared": summary.compared.iter().map(compared).collect::<Vec<_>>(),
        "unused_bytes": summary.unused,
        "interrupted": summary.interrupted,
    })
}

/// The number of units by outcome.
pub(super) fn counts(c: &OutcomeCounts) -> Value {
    json!({ "computed": c.computed, "reused": c.reused, "failed": c.failed, "skipped": c.skipped })
}

/// Merges two objects.
pub(super) fn merged(mut base: Value, more: Value) -> Value {
    if let (Some(base), Value::Object(more)) = (base.as_object_mut(), more) {
        base.extend(more);
    }
    base
}

fn point_json(point: &SweepPoint) -> Value {
    point.iter().map(|(k, v)| (k.clone(), literal(v))).collect::<Map<_, _>>().into()
}

fn literal(value: &schemas::Literal) -> Value {
    use schemas::Literal as L;
    match value {
        L::Bool(x) => json!(x),
        L::Int(x) => json!(x),
        L::Float(x) => json!(x),
        L::Text(x) => json!(x),
        L::List(xs) => xs.iter().map(literal).collect(),
        L::Section(section) => {
            section.keys.iter().map(|(k, g)| (k.clone(), literal(&g.value))).collect::<Map<_, _>>().into()
        }
    }
}

/// One trial of a search at one rung.
fn trial(search: &SearchSpec, one: &SearchTrialScore, best: Option<&SearchTrialScore>) -> Value {
    let names = search.columns().into_iter().map(|(name, _)| name.to_owned());
    let axes: Map<_, _> = names.zip(one.row.literals(search)).skip(1).map(|(name, v)| (name, literal(&v))).collect();
    json!({
        "event": "trial",
        "trial": one.row.trial,
        "generation": one.row.generation,
        "rung": one.row.rung,
        "axes": axes,
        "goal": one.goal,
        "state": one.rung_outcome(search).as_str(),
        "error": one.error,
        "best": best_json(best),
    })
}

fn best_json(best: Option<&SearchTrialScore>) -> Value {
    best.map_or(Value::Null, |b| json!({ "trial": b.row.trial, "goal": b.goal }))
}

/// A failure as JSON, for events and summaries.
pub(super) fn failure(f: &Failure) -> Value {
    json!({
        "stage": f.table,
        "axes": point_json(&f.point),
        "flight": f.line.as_ref().map(|l| &l.0),
        "line": f.line.as_ref().map(|l| &l.1),
        "error": f.fault.to_string(),
    })
}

/// A warning as JSON, for events and summaries.
pub(super) fn warning(w: &Warning) -> Value {
    json!({
        "stage": w.stage,
        "axes": point_json(&w.point),
        "flight": w.line.as_ref().map(|l| &l.0),
        "line": w.line.as_ref().map(|l| &l.1),
        "kind": w.kind.as_str(),
        "value": w.value,
        "limit": w.limit,
        "unit": w.unit,
        "text": w.text,
        "cause": w.cause,
    })
}

/// One object per sweep point: axes as text, pooled value of each metric, number of flagged lines and number of
/// in-sample lines. `in_sample` is true if all lines are in sample. `metrics_in_sample` has the values over the
/// in-sample lines.
fn scores(table: &str, scores: &Scores) -> Vec<Value> {
    let named = |values: &[Option<f64>]| -> Map<String, Value> {
        scores.metrics.iter().zip(values).map(|(metric, value)| (metric.name.to_owned(), json!(value))).collect()
    };
    let best = scores.headline().filter(|_| scores.rows.len() > 1).and_then(|m| scores.best(m));
    let one = |(row, (key, values)): (usize, &(Vec<String>, Vec<Option<f64>>))| {
        let axes: Map<_, _> = scores.axes.iter().cloned().zip(key.iter().map(|k| json!(k))).collect();
        let none = InSampleScores { held_out: scores.lines, ..InSampleScores::default() };
        let apart = scores.in_sample.get(row).unwrap_or(&none);
        let only: Vec<&str> = (0..scores.metrics.len())
            .filter(|m| scores.is_in_sample(row, *m))
            .filter_map(|m| scores.metrics.get(m).map(|m| m.name))
            .collect();
        json!({
            "stage": table,
            "axes": axes,
            "lines": scores.lines,
            "marked": scores.marks.get(row),
            "cautious": scores.is_cautious(row),
            "best": best == Some(row),
            "in_sample": scores.is_all_in_sample(row),
            "lines_held_out": apart.held_out,
            "lines_in_sample": apart.lines,
            "metrics": named(values),
            "only_in_sample": only,
            "metrics_in_sample": named(&apart.values),
        })
    };
    scores.rows.iter().enumerate().map(one).collect()
}
