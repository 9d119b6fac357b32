//! What a run shows while it goes on: a bar on a terminal, or one JSON event per line.

use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use pipeline::run::{Count, Event, Listener};
use serde_json::{Value, json};

use super::say::out;

/// A bar on standard error.
pub struct Bar(ProgressBar);

impl Bar {
    /// Shown only where somebody can see it.
    pub fn new(visible: bool) -> Bar {
        let bar = ProgressBar::with_draw_target(
            Some(0),
            if visible { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() },
        );
        let style = ProgressStyle::with_template("{elapsed_precise} {wide_bar} {pos}/{len} {msg} (about {eta} left)");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        bar.enable_steady_tick(Duration::from_millis(200));
        Bar(bar)
    }
}

impl Listener for Bar {
    fn hear(&self, event: &Event) {
        match event {
            Event::Reading { table, done, all } => self.0.set_message(format!("reading {table} {done}/{all}")),
            Event::Started { units, .. } => self.0.set_length(*units as u64),
            Event::Unit { table, .. } => {
                self.0.set_message((*table).to_owned());
                self.0.inc(1);
            }
            Event::Table { .. } => {}
            Event::Finished { .. } => self.0.finish_and_clear(),
        }
    }
}

/// The reading of sources, where nothing is run.
pub struct Reading(ProgressBar);

impl Reading {
    /// On standard error, where that is a terminal.
    pub fn new() -> Reading {
        let bar = ProgressBar::new_spinner();
        bar.enable_steady_tick(Duration::from_millis(200));
        Reading(bar)
    }

    /// One more file is read.
    pub fn show(&self, name: &str, done: usize, all: usize) {
        self.0.set_message(format!("reading {name} {done}/{all}"));
    }

    /// All are read.
    pub fn clear(&self) {
        self.0.finish_and_clear();
    }
}

/// JSON events on standard output.
pub struct Json;

impl Listener for Json {
    fn hear(&self, event: &Event) {
        let value = as_json(event);
        // A reader that has gone away does not stop the run; a full disk shows in its exit status.
        out!("{value}\n");
    }
}

fn counts(c: &Count) -> Value {
    json!({ "computed": c.computed, "reused": c.reused, "failed": c.failed, "skipped": c.skipped })
}

fn merged(mut base: Value, more: Value) -> Value {
    if let (Some(base), Value::Object(more)) = (base.as_object_mut(), more) {
        base.extend(more);
    }
    base
}

fn point_json(point: &pipeline::plan::Point) -> Value {
    point.iter().map(|(k, v)| (k.clone(), literal(v))).collect::<serde_json::Map<_, _>>().into()
}

fn literal(value: &schemas::Literal) -> Value {
    use schemas::Literal as L;
    match value {
        L::Bool(x) => json!(x),
        L::Int(x) => json!(x),
        L::Float(x) => json!(x),
        L::Text(x) => json!(x),
        L::List(xs) => xs.iter().map(literal).collect(),
    }
}

fn as_json(event: &Event) -> Value {
    match event {
        Event::Reading { table, done, all } => json!({ "event": "reading", "table": table, "done": done, "all": all }),
        Event::Started { pipeline, units } => json!({ "event": "started", "pipeline": pipeline, "units": units }),
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
            let tables: serde_json::Map<_, _> = summary.tables.iter().map(|(n, c)| (n.clone(), counts(c))).collect();
            let failures: Vec<Value> = summary.failures.iter().map(failure).collect();
            let more = json!({ "tables": tables, "failures": failures, "quality": summary.quality, "interrupted": summary.interrupted });
            merged(merged(json!({ "event": "finished" }), counts(&summary.total())), more)
        }
    }
}

fn failure(f: &pipeline::run::Failure) -> Value {
    json!({
        "stage": f.table,
        "axes": point_json(&f.point),
        "flight": f.line.as_ref().map(|l| &l.0),
        "line": f.line.as_ref().map(|l| &l.1),
        "error": f.fault.to_string(),
    })
}

/// The simulation of lines.
pub struct Lines(ProgressBar);

impl Lines {
    /// Shown only where somebody can see it.
    pub fn new(visible: bool) -> Lines {
        let target = if visible { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(Some(0), target);
        let style = ProgressStyle::with_template("{elapsed_precise} {wide_bar} {pos}/{len} lines (about {eta} left)");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        Lines(bar)
    }

    /// `done` of `all` lines are simulated.
    pub fn set(&self, done: usize, all: usize) {
        self.0.set_length(all as u64);
        self.0.set_position(done as u64);
    }
}

impl Drop for Lines {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
