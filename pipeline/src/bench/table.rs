//! Results as text, JSON, Markdown or Parquet.

use std::{fs, path::Path, sync::Arc};

use arrow_array::{Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_schema::{DataType, Field, Schema};
use parquet::arrow::ArrowWriter;
use report::html;
use results::text::columns;
use schemas::Fault;
use serde_json::json;

use super::BenchScore;

/// Number with its significant digits.
fn figure(x: Option<f64>) -> String {
    match x {
        None => "failed".to_owned(),
        Some(x) if x.abs() < 10.0 => format!("{x:.3}"),
        Some(x) if x.abs() < 100.0 => format!("{x:.2}"),
        Some(x) => format!("{x:.1}"),
    }
}

const HEAD: [&str; 8] = ["task", "prediction", "line", "measure", "score", "naive", "unit", "missing"];

fn row(s: &BenchScore) -> Vec<String> {
    let line = s.line.clone().unwrap_or_else(|| "all".to_owned());
    let missing = format!("{} of {}", s.missing, s.samples);
    [s.task, &s.column, &line, s.measure.name(), &figure(s.value), &figure(Some(s.naive)), s.measure.unit(), &missing]
        .map(str::to_owned)
        .to_vec()
}

/// Results for a terminal.
pub fn as_text(scores: &[BenchScore]) -> String {
    let rows: Vec<Vec<String>> =
        std::iter::once(HEAD.map(str::to_owned).to_vec()).chain(scores.iter().map(row)).collect();
    columns(&rows, 4)
}

/// Results as JSON, one object per line.
pub fn as_json(scores: &[BenchScore]) -> String {
    let one = |s: &BenchScore| {
        let value = json!({
            "task": s.task, "prediction": s.column, "line": s.line, "measure": s.measure.name(), "score": s.value,
            "naive": s.naive, "unit": s.measure.unit(), "samples": s.samples, "missing": s.missing,
        });
        format!("{value}\n")
    };
    scores.iter().map(one).collect()
}

fn as_markdown(scores: &[BenchScore]) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let head = HEAD.map(str::to_owned);
    line(&head) + "|:--|:--|:--|:--|--:|--:|:--|--:|\n" + &scores.iter().map(|s| line(&row(s))).collect::<String>()
}

/// Writes the results: Parquet if the name has that extension, otherwise Markdown.
///
/// # Errors
/// Fails if the file cannot be written.
pub fn write(path: &Path, scores: &[BenchScore]) -> Result<(), Fault> {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("parquet")) {
        return html::write(path, &parquet(scores)?);
    }
    if fs::metadata(path).is_ok_and(|about| about.is_dir()) {
        return Err(Fault::new(format!("{} is a folder", path.display()))
            .help("give a file with the extension .md or .parquet"));
    }
    html::write(path, as_markdown(scores).as_bytes())
}

fn parquet(scores: &[BenchScore]) -> Result<Vec<u8>, Fault> {
    let fail = |e: &dyn std::fmt::Display| Fault::machine(e.to_string());
    let text = |of: &dyn Fn(&BenchScore) -> Option<String>| Arc::new(scores.iter().map(of).collect::<StringArray>());
    let whole = |of: &dyn Fn(&BenchScore) -> usize| {
        Arc::new(scores.iter().map(|s| i64::try_from(of(s)).ok()).collect::<Int64Array>())
    };
    let kinds = [
        ("task", DataType::Utf8),
        ("prediction", DataType::Utf8),
        ("line", DataType::Utf8),
        ("measure", DataType::Utf8),
        ("score", DataType::Float64),
        ("naive", DataType::Float64),
        ("unit", DataType::Utf8),
        ("samples", DataType::Int64),
        ("missing", DataType::Int64),
    ];
    let schema = Arc::new(Schema::new(kinds.map(|(name, kind)| Field::new(name, kind, true)).to_vec()));
    let batch = RecordBatch::try_new(
        schema.clone(),
        vec![
            text(&|s| Some(s.task.to_owned())),
            text(&|s| Some(s.column.clone())),
            text(&|s| s.line.clone()),
            text(&|s| Some(s.measure.name().to_owned())),
            Arc::new(scores.iter().map(|s| s.value).collect::<Float64Array>()),
            Arc::new(scores.iter().map(|s| Some(s.naive)).collect::<Float64Array>()),
            text(&|s| Some(s.measure.unit().to_owned())),
            whole(&|s| s.samples),
            whole(&|s| s.missing),
        ],
    );
    let mut writer = ArrowWriter::try_new(vec![], schema, None).map_err(|e| fail(&e))?;
    writer.write(&batch.map_err(|e| fail(&e))?).map_err(|e| fail(&e))?;
    writer.into_inner().map_err(|e| fail(&e))
}
