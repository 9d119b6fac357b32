//! The list of all tables of a store, with their axes and columns.

use arrow_schema::{DataType, Field};
use schemas::keys::HashKey;
use serde_json::{Value, json};
use store::ManifestTable;

use super::{PublishedPipeline, StoreView, lines::derived, notes::NotedTable, table::ViewTable};
use crate::series::{DerivedColumnText, is_series};

impl StoreView {
    /// All pipelines with their tables. A table that cannot be opened is listed with its error.
    pub fn catalogue(&self) -> Value {
        let pipelines: Vec<Value> =
            self.pipelines().iter().filter_map(|name| self.pipeline(name).ok()).map(|p| pipeline(&p)).collect();
        json!({ "magline": env!("CARGO_PKG_VERSION"), "pipelines": pipelines, "changed": self.changed() })
    }
}

fn pipeline(pipeline: &PublishedPipeline) -> Value {
    let (version, notes) = (&pipeline.version, &pipeline.notes);
    let name = &version.manifest.pipeline;
    let tables: Vec<Value> = pipeline.tables().iter().map(|table| described(pipeline, table)).collect();
    let mut axes: Vec<(&String, &Vec<String>)> = vec![];
    for (axis, values) in
        notes.tables.iter().flat_map(|t| t.axes.iter().filter_map(|a| t.points.values.get_key_value(a)))
    {
        match axes.iter_mut().find(|(known, _)| *known == axis) {
            Some((_, known)) if known.len() < values.len() => *known = values,
            Some(_) => {}
            None => axes.push((axis, values)),
        }
    }
    let axis = |(name, values): (&String, &Vec<String>)| {
        let numeric = values.iter().all(|v| v.parse::<f64>().is_ok_and(f64::is_finite));
        json!({ "name": name, "numeric": numeric, "values": values })
    };
    let sources = notes.sources.iter().map(|source| {
        json!({
            "table": format!("{name}.{}", source.name), "name": source.name, "kind": source.kind,
            "files": source.files.len(), "lines": source.lines.len(),
        })
    });
    json!({
        "name": name, "version": version.number, "spec": notes.spec,
        "axes": axes.into_iter().map(axis).collect::<Vec<_>>(),
        "tables": tables, "sources": sources.collect::<Vec<_>>(),
    })
}

fn described(pipeline: &PublishedPipeline, name: &str) -> Value {
    let full = format!("{}.{name}", pipeline.version.manifest.pipeline);
    let noted = pipeline.notes.table(name);
    let table = match pipeline.table(name) {
        Ok(table) => table,
        Err(fault) => {
            return json!({ "table": full, "name": name, "kind": "other", "columns": [], "error": fault.to_string() });
        }
    };
    let listed = pipeline.version.manifest.tables.iter().find(|t| t.name == name);
    json!({
        "table": full, "name": name, "stage": noted.map(|t| t.stage.as_str()), "kind": kind(&table, noted, name),
        "axes": table.axes, "points": noted.map(|t| t.points.count), "lines": noted.map(|t| t.lines),
        "units": table.provider.units().map(|units| units.num_rows()),
        "rows": listed.and_then(|listed| rows(pipeline, listed)),
        "inputs": noted.map(|t| t.inputs.as_slice()).unwrap_or_default(),
        "columns": columns(pipeline, &table),
    })
}

/// Kind of a table, which determines how the table is drawn.
fn kind(table: &ViewTable, noted: Option<&NotedTable>, name: &str) -> &'static str {
    let has = |column: &str| table.provider.columns().field_with_name(column).is_ok();
    match noted {
        _ if table.is_by_sample() => "samples",
        Some(noted) if noted.is_scores() => "scores",
        _ if name == results::pooled::TABLE => "scores_pooled",
        Some(noted) if noted.is_model() => "model",
        Some(_) if has("anomaly") && has("epsg") => "map",
        _ => "other",
    }
}

/// Number of rows, from the list of packs.
fn rows(pipeline: &PublishedPipeline, listed: &ManifestTable) -> Option<usize> {
    let catalogue = pipeline.objects().catalogue();
    let of = |id: &String| -> Option<usize> {
        let pack = catalogue.by_id(HashKey::parse(id)?)?;
        Some(pack.units.iter().filter_map(|unit| unit.count()).sum())
    };
    listed.files.iter().map(|file| of(file.pack.as_ref()?)).sum()
}

fn columns(pipeline: &PublishedPipeline, table: &ViewTable) -> Vec<Value> {
    let own = table.provider.columns().fields().iter().map(|field| column(table, field));
    let made = derived(pipeline, table).into_iter().map(|column| {
        let DerivedColumnText { name, unit, role, description } = column.about();
        json!({
            "name": name, "unit": unit, "role": role.as_str(), "type": "Float64", "description": description,
            "series": true, "computed": true,
        })
    });
    own.chain(made).collect()
}

fn column(table: &ViewTable, field: &Field) -> Value {
    let about = |key: &str| field.metadata().get(key).map_or("", String::as_str);
    let (kind, length) = match field.data_type() {
        DataType::FixedSizeList(item, length) => (item.data_type().to_string(), Some(*length)),
        other => (other.to_string(), None),
    };
    let drawn = table.is_by_sample() && is_series(field.data_type()) && !matches!(about("role"), "time");
    let mut made = json!({
        "name": field.name(), "unit": about("unit"), "role": about("role"), "type": kind,
        "description": about("description"), "series": drawn,
    });
    if let Some(length) = length {
        made["length"] = json!(length);
        let terms: Vec<&str> = about("terms").split(',').filter(|term| !term.is_empty()).collect();
        if usize::try_from(length) == Ok(terms.len()) {
            made["terms"] = json!(terms);
        }
    }
    made
}
