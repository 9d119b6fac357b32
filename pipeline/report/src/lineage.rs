//! `magline lineage`: the origin of a table's rows.

use std::{fmt::Write, fs, path::Path};

use results::{Snapshot, SnapshotTable, snapshots};
use schemas::Fault;
use serde_json::{Value, json};

use super::openlineage::{EVENT, PRODUCER, facet};

/// Output format of lineage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum LineageFormat {
    /// Indented text.
    #[default]
    Tree,
    /// JSON, with every column.
    Json,
    /// An OpenLineage run event.
    Openlineage,
}

/// The lineage of `table` (`<pipeline>.<table>`, or the table's name if it is unique) in the store at `root`.
///
/// # Errors
/// Fails if there is no such table.
pub fn lineage(root: &Path, table: &str, format: LineageFormat) -> Result<String, Fault> {
    let all = snapshots(root);
    let (snapshot, found) = find(&all, table)?;
    Ok(match format {
        LineageFormat::Tree => {
            let mut out = String::new();
            tree(snapshot, &found.name, 0, &mut out);
            out
        }
        LineageFormat::Json => pretty(&graph(snapshot, found)),
        LineageFormat::Openlineage => pretty(&openlineage(root, snapshot, found)),
    })
}

fn pretty(value: &Value) -> String {
    serde_json::to_string_pretty(value).unwrap_or_default() + "\n"
}

/// The table of `name`.
pub fn find<'a>(all: &'a [Snapshot], name: &str) -> Result<(&'a Snapshot, &'a SnapshotTable), Fault> {
    let (pipeline, table) = name.split_once('.').map_or((None, name), |(p, t)| (Some(p), t));
    let fits = |s: &&Snapshot| pipeline.is_none_or(|p| p == s.pipeline);
    let found: Vec<_> = all
        .iter()
        .filter(fits)
        .flat_map(|s| s.tables.iter().filter(|t| t.name == table).map(move |t| (s, t)))
        .collect();
    let known: Vec<String> =
        all.iter().flat_map(|s| s.tables.iter().map(|t| format!("{}.{}", s.pipeline, t.name))).collect();
    match found.as_slice() {
        [one] => Ok(*one),
        [] => Err(Fault::new(format!("the store has no table `{name}`")).nearest(name, &known)),
        _ => {
            Err(Fault::new(format!("several pipelines have a table `{table}`"))
                .help("write it as `<pipeline>.<table>`"))
        }
    }
}

fn tree(snapshot: &Snapshot, name: &str, depth: usize, out: &mut String) {
    let pad = "   ".repeat(depth);
    // Writing into a String cannot fail.
    if let Some(source) = snapshot.sources.iter().find(|s| s.name == name) {
        let _ =
            writeln!(out, "{pad}{name}  {} of {} lines, {} files", source.kind, source.lines.len(), source.files.len());
        for (path, hash) in &source.files {
            let _ = writeln!(out, "{pad}   {path}  blake3 {hash}");
        }
        return;
    }
    let Some(table) = snapshot.tables.iter().find(|t| t.name == name) else { return };
    let axes = if table.axes.is_empty() { String::new() } else { format!("  over {}", table.axes.join(" x ")) };
    let _ = writeln!(out, "{pad}{name}  {} v{}{axes}", table.stage, table.version);
    if let Some(p) = &table.predicate {
        let _ = writeln!(out, "{pad}   where {p}");
    }
    for column in table.columns.iter().filter(|c| c.from.iter().any(|(_, f)| *f != c.name) || c.from.len() > 1) {
        let from: Vec<String> = column.from.iter().map(|(t, c)| format!("{t}.{c}")).collect();
        let _ = writeln!(out, "{pad}   {} <- {}", column.name, from.join(", "));
    }
    for input in &table.inputs {
        tree(snapshot, input, depth + 1, out);
    }
}

/// The name of `table`, followed by the names of all tables that it depends on.
fn upstream<'a>(snapshot: &'a Snapshot, table: &'a SnapshotTable) -> Vec<&'a str> {
    let mut names = vec![table.name.as_str()];
    let mut i = 0;
    while i < names.len() {
        let inputs = snapshot.tables.iter().find(|t| t.name == names[i]).map(|t| t.inputs.as_slice()).unwrap_or(&[]);
        for input in inputs {
            if !names.contains(&input.as_str()) {
                names.push(input);
            }
        }
        i += 1;
    }
    names
}

fn graph(snapshot: &Snapshot, table: &SnapshotTable) -> Value {
    let names = upstream(snapshot, table);
    let listed = |t: &SnapshotTable| {
        let mut listed = json!(t);
        listed["points"] = json!(t.points.iter().collect::<Vec<_>>());
        listed
    };
    let tables: Vec<_> = snapshot.tables.iter().filter(|t| names.contains(&t.name.as_str())).map(listed).collect();
    let sources: Vec<_> = snapshot.sources.iter().filter(|s| names.contains(&s.name.as_str())).collect();
    json!({
        "pipeline": snapshot.pipeline, "spec": snapshot.spec, "seed": snapshot.seed, "table": table.name,
        "tables": tables, "sources": sources,
    })
}

/// One run event of the OpenLineage specification 2-0-2, with schema and column-lineage facets.
fn openlineage(root: &Path, snapshot: &Snapshot, table: &SnapshotTable) -> Value {
    let with = |mut base: Value, key: &str, value: Value| {
        base[key] = value;
        base
    };
    let dataset = |name: &str| json!({ "namespace": format!("magline://{}", snapshot.pipeline), "name": name });
    let fields: Vec<Value> =
        table.columns.iter().map(|c| json!({ "name": c.name, "type": c.kind, "description": c.doc })).collect();
    let columns: serde_json::Map<String, Value> = table
        .columns
        .iter()
        .map(|c| {
            let from: Vec<Value> = c.from.iter().map(|(t, f)| with(dataset(t), "field", json!(f))).collect();
            (c.name.clone(), json!({ "inputFields": from }))
        })
        .collect();
    let facets = json!({
        "schema": facet("1-2-0", "SchemaDatasetFacet", json!({ "fields": fields })),
        "columnLineage": facet("1-2-0", "ColumnLineageDatasetFacet", json!({ "fields": columns })),
    });
    let run = schemas::keys::HashKey::from_parts([
        snapshot.pipeline.as_bytes(),
        table.name.as_bytes(),
        format!("{:?}", table.points.iter().collect::<Vec<_>>()).as_bytes(),
    ])
    .to_string();
    // The identifier has the form of a UUID, as the specification requires; the same tables give the same identifier.
    let id = format!("{}-{}-{}-{}-{}", &run[..8], &run[8..12], &run[12..16], &run[16..20], &run[20..32]);
    json!({
        "eventType": "COMPLETE",
        "eventTime": written(&root.join("plans").join(format!("{}.json", snapshot.pipeline))),
        "producer": PRODUCER,
        "schemaURL": EVENT,
        "run": { "runId": id },
        "job": { "namespace": "magline", "name": format!("{}.{}", snapshot.pipeline, table.name) },
        "inputs": table.inputs.iter().map(|i| dataset(i)).collect::<Vec<_>>(),
        "outputs": [with(dataset(&table.name), "facets", facets)],
    })
}

/// Time at which a file was last written, UTC.
fn written(path: &Path) -> String {
    let since =
        fs::metadata(path).and_then(|m| m.modified()).ok().and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok());
    let seconds = since.map_or(0, |d| d.as_secs());
    let (days, rest) = (seconds / 86_400, seconds % 86_400);
    let (year, month, day) = civil(days);
    format!("{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}Z", rest / 3600, rest / 60 % 60, rest % 60)
}

/// Year, month and day of a number of days since 1970-01-01 (proleptic Gregorian calendar).
fn civil(days: u64) -> (u64, u64, u64) {
    let leap = |y: u64| (y.is_multiple_of(4) && !y.is_multiple_of(100)) || y.is_multiple_of(400);
    let (mut year, mut left) = (1970, days);
    while left >= 365 + u64::from(leap(year)) {
        left -= 365 + u64::from(leap(year));
        year += 1;
    }
    let lengths = [31, 28 + u64::from(leap(year)), 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let mut month = 0;
    while left >= lengths[month] {
        left -= lengths[month];
        month += 1;
    }
    (year, month as u64 + 1, left + 1)
}

#[cfg(test)]
mod tests {
    use super::civil;

    #[test]
    fn unit_the_calendar_includes_leap_days() {
        assert_eq!(civil(0), (1970, 1, 1));
        assert_eq!(civil(11_016), (2000, 2, 29));
        assert_eq!(civil(20_778), (2026, 11, 21));
    }
}
