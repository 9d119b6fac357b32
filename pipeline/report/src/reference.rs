//! `magline stages` and the reference page, from the stages' own declarations.

use std::fmt::Write;

use datasets::{FlightOptions, MapOptions};
use plan::{
    sources::{MappingOptions, ModelOptions},
    spec::STAGE_KEYS,
};
use schemas::{
    ChoiceRegistry, Fault, Grain, InputDecl, InputKind, ParamDoc, Params, StageEntry, TableKind, metric::Metric,
};

/// One line per stage.
pub fn overview(catalogue: &[StageEntry]) -> String {
    let wide = catalogue.iter().map(|e| e.name.len()).max().unwrap_or(0);
    let first = |e: &StageEntry| e.doc.split("\n\n").next().unwrap_or_default().to_owned();
    catalogue.iter().map(|e| format!("{:<wide$}  v{}  {}\n", e.name, e.version, first(e))).collect()
}

/// Description of the stage `name`.
///
/// # Errors
/// Fails if there is no such stage.
pub fn one(catalogue: &[StageEntry], name: &str) -> Result<String, Fault> {
    let names: Vec<&str> = catalogue.iter().map(|e| e.name).collect();
    let entry = catalogue.iter().find(|e| e.name == name);
    entry.map(section).ok_or_else(|| Fault::new(format!("there is no stage `{name}`")).nearest(name, &names))
}

/// The reference of all stages, as Markdown.
pub fn page(catalogue: &[StageEntry]) -> String {
    let mut out =
        "# Stages\n\nMade from the stages' declarations by `magline stages --markdown`; do not edit.\n\n".to_owned();
    out.push_str(
        "Besides its inputs and parameters, a stage of a spec has these keys:\n\n| key | meaning |\n|---|---|\n",
    );
    for (key, meaning) in STAGE_KEYS {
        // Writing into a String cannot fail.
        let _ = writeln!(out, "| `{key}` | {meaning} |");
    }
    out.push('\n');
    out.push_str("In addition to `path`, a table of files (`[tables.NAME]`) has these keys:\n\n");
    let lists = ChoiceRegistry::default();
    let of_flights = [FlightOptions::docs(&lists), MappingOptions::docs(&lists)].concat();
    for (what, docs) in [("flights", of_flights), ("a map", MapOptions::docs(&lists))] {
        let _ = write!(out, "For {what}:\n\n{}\n", params(&docs.iter().collect::<Vec<_>>()));
    }
    let of_model = ModelOptions::docs(&lists);
    let _ = write!(
        out,
        "For a model that another pipeline fitted, `path` is the published table of the `fit` stage. The key `where` \
         is an SQL condition on the columns of this table. It selects one model if the table has several. Further \
         keys:\n\n{}\n",
        params(&of_model.iter().collect::<Vec<_>>())
    );
    for entry in catalogue {
        out.push_str(&section(entry));
        out.push('\n');
    }
    out
}

fn section(entry: &StageEntry) -> String {
    let mut out = format!("## `{}` (version {})\n\n{}\n\n", entry.name, entry.version, entry.doc);
    let grain = match entry.grain {
        Grain::Line => "one line at a time",
        Grain::Survey => "all lines that `where` selects",
        Grain::Map => "whole maps",
    };
    let input = |i: &InputDecl| {
        let optional = if i.optional { ", optional" } else { "" };
        format!("`{}` ({}{optional})", i.name, kind(i.kind))
    };
    let inputs: Vec<String> = entry.inputs.iter().map(input).collect();
    // Writing into a String cannot fail.
    let yields = match entry.yields {
        TableKind::Map => " Yields a map.",
        TableKind::Lines | TableKind::Model | TableKind::Scores => "",
    };
    let _ = writeln!(out, "Works on {grain}. Inputs: {}.{yields}\n", inputs.join(", "));
    let common: Vec<&ParamDoc> = entry.params.iter().filter(|p| p.owners.is_empty()).collect();
    out.push_str(&params(&common));
    let _ = write!(out, "\n```toml\n{}```\n", entry.example.trim_start());
    for kind in &entry.kinds {
        let _ = write!(out, "\n### The {} `{}`\n\n{}\n", kind.key, kind.name, kind.doc);
        if !kind.facts.is_empty() {
            let _ = writeln!(out);
        }
        for fact in &kind.facts {
            let _ = writeln!(out, "- {fact}");
        }
        if !kind.params.is_empty() {
            let _ = write!(out, "\n{}", params(&kind.params.iter().collect::<Vec<_>>()));
        }
        if !kind.example.is_empty() {
            let _ = write!(out, "\n```toml\n{} = \"{}\"\n{}\n```\n", kind.key, kind.name, kind.example);
        }
    }
    if !entry.metrics.is_empty() {
        let _ = write!(out, "\n{}", metrics(entry));
    }
    out
}

/// The table of parameters.
fn params(all: &[&ParamDoc]) -> String {
    let rows: String = all.iter().map(|param| param.row("")).collect();
    format!("| parameter | type | unit | default | allowed | meaning |\n|---|---|---|---|---|---|\n{rows}")
}

fn metrics(entry: &StageEntry) -> String {
    let row = |Metric { name, unit, meaning, pool, better, .. }: &Metric| {
        // Metrics of a survey stage are not pooled, because they already cover all lines.
        let pool = if entry.grain == Grain::Line { pool.words() } else { String::new() };
        format!("| `{name}` | {unit} | {pool} | {} | {meaning} |\n", better.words())
    };
    let rows: String = entry.metrics.iter().map(row).collect();
    format!("| metric | unit | lines pooled by | better | meaning |\n|---|---|---|---|---|\n{rows}")
}

fn kind(kind: InputKind) -> &'static str {
    match kind {
        InputKind::Lines => "flight lines",
        InputKind::Scores => "a table of scores",
        InputKind::Record => "a table of flight lines, read as a whole for each line",
        InputKind::ManyRecords => "one or several tables of flight lines, read as a whole for each line",
        InputKind::ManyLines => "one or several tables of flight lines",
        InputKind::Model => "model",
        InputKind::Map => "map",
        InputKind::ManyModels => "one or several model tables",
        InputKind::ManyMaps => "one or several maps",
    }
}
