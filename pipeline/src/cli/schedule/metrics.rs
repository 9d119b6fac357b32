//! `--metrics`: the figures of a run as Prometheus text, for the textfile collector of node_exporter.

use std::{fmt::Write, fs, path::Path};

use store::clock;

use super::watch::{RunEnd, RunStatus, RunWatchState};

/// Metric with the time of the last successful run.
const SUCCESS: &str = "magline_last_success_timestamp_seconds";

/// The value of a label, in quotes.
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n"))
}

/// Appends a metric family: its help text and its samples of labels and value.
fn family(out: &mut String, name: &str, help: &str, samples: impl IntoIterator<Item = (String, f64)>) {
    // Writing into a String cannot fail.
    let _ = writeln!(out, "# HELP {name} {help}\n# TYPE {name} gauge");
    for (labels, value) in samples {
        let _ = writeln!(out, "{name}{{{labels}}} {value}");
    }
}

/// Time of the last success of a pipeline, as recorded in the existing file.
fn before(path: &Path, labels: &str) -> Option<f64> {
    let text = fs::read_to_string(path).ok()?;
    let start = format!("{SUCCESS}{{{labels}}} ");
    text.lines().find_map(|line| line.strip_prefix(&start)?.trim().parse().ok())
}

/// Metrics of a run as text. The text is to replace the file at `path`.
pub fn text(state: &RunWatchState, end: &RunEnd, path: &Path) -> String {
    let pipeline = format!("pipeline={}", quoted(state.pipeline.as_deref().unwrap_or_default()));
    let of = |table: &str| format!("{pipeline},table={}", quoted(table));
    let mut out = String::new();
    let units = state.tables.iter().flat_map(|(name, c, _)| {
        let outcomes = [("computed", c.computed), ("reused", c.reused), ("failed", c.failed), ("skipped", c.skipped)];
        outcomes.map(|(word, n)| (format!("{},outcome={}", of(name), quoted(word)), n as f64))
    });
    family(&mut out, "magline_run_units", "Number of units of a table in the last run, by outcome.", units);
    let seconds = state.tables.iter().map(|(name, _, seconds)| (of(name), *seconds));
    family(&mut out, "magline_run_table_seconds", "Time to compute a table in the last run, in seconds.", seconds);
    let published = state.published(end);
    let tables = published.iter().flat_map(|v| &v.manifest.tables);
    let bytes = tables.map(|t| (of(&t.name), t.files.iter().map(|f| f.size).sum::<u64>() as f64));
    family(&mut out, "magline_table_bytes", "Size of the files of a published table, in bytes.", bytes);
    let warnings = end.summary.map(|s| s.warnings.len() as f64).map(|n| (pipeline.clone(), n));
    family(&mut out, "magline_run_warnings", "Number of warnings about results of the last run.", warnings);
    let one = |value: f64| [(pipeline.clone(), value)];
    let took = state.begun.elapsed().as_secs_f64();
    family(&mut out, "magline_run_seconds", "Duration of the last run, in seconds.", one(took));
    family(&mut out, "magline_run_exit_status", "Exit status of the last run.", one(f64::from(end.status.exit())));
    let now = clock::unix();
    family(&mut out, "magline_run_end_timestamp_seconds", "End of the last run, as Unix time in seconds.", one(now));
    let success = if end.status == RunStatus::Done { Some(now) } else { before(path, &pipeline) };
    let success = success.map(|t| (pipeline.clone(), t));
    family(&mut out, SUCCESS, "End of the last successful run, as Unix time in seconds.", success);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_labels_are_quoted_as_the_format_requires() {
        assert_eq!(quoted("a\\b\"c\nd"), "\"a\\\\b\\\"c\\nd\"");
    }
}
