//! `croissant.json`: the Croissant 1.0 description of the set, JSON-LD. [MLCommons, Croissant Format Specification 1.0]

use serde_json::{Map, Value, json};

use super::{
    citation, protect,
    set::{ColumnKind, ReleaseColumn, ReleaseMetadata, ReleaseSet, ReleaseTable},
    words::address,
};

/// Media type by which Croissant readers recognise Parquet files.
const PARQUET: &str = "application/x-parquet";

/// Context of the specification.
fn context() -> Value {
    let own = [
        "citeAs",
        "column",
        "equivalentProperty",
        "extract",
        "field",
        "fileProperty",
        "fileObject",
        "fileSet",
        "format",
        "includes",
        "isLiveDataset",
        "jsonPath",
        "key",
        "md5",
        "parentField",
        "path",
        "recordSet",
        "references",
        "regex",
        "repeated",
        "replace",
        "samplingRate",
        "separator",
        "source",
        "subField",
        "transform",
    ];
    let mut terms: Map<String, Value> = own.iter().map(|t| ((*t).to_owned(), json!(format!("cr:{t}")))).collect();
    let more = json!({
        "@language": "en",
        "@vocab": "https://schema.org/",
        "conformsTo": "dct:conformsTo",
        "cr": "http://mlcommons.org/croissant/",
        "rai": "http://mlcommons.org/croissant/RAI/",
        "data": { "@id": "cr:data", "@type": "@json" },
        "dataType": { "@id": "cr:dataType", "@type": "@vocab" },
        "dct": "http://purl.org/dc/terms/",
        "examples": { "@id": "cr:examples", "@type": "@json" },
        "sc": "https://schema.org/",
    });
    if let Value::Object(more) = more {
        terms.extend(more);
    }
    terms.sort_keys();
    Value::Object(terms)
}

/// Contents of `croissant.json`.
pub fn write(set: &ReleaseSet) -> Value {
    let about = &set.dictionary.about;
    let mut out = json!({
        "@context": context(),
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": about.title,
        "description": about.description,
        "license": about.licence.url,
        "url": about.address().unwrap_or_else(|| "./".to_owned()),
        "version": about.version,
        "datePublished": about.date,
        "citeAs": citation::bibtex(about),
        "creator": creators(about),
        "keywords": about.keywords,
        "isLiveDataset": false,
    });
    if !set.dictionary.restricted.is_empty() {
        out["conditionsOfAccess"] = json!(conditions(set));
    }
    let tables = &set.dictionary.tables;
    out["distribution"] = tables.iter().flat_map(distribution).collect();
    out["recordSet"] = tables.iter().map(record_set).collect();
    out
}

fn creators(about: &ReleaseMetadata) -> Value {
    let one = |a: &super::set::Person| {
        let kind = if a.family.is_some() { "sc:Person" } else { "sc:Organization" };
        let mut out = json!({ "@type": kind, "name": a.name });
        if let Some(orcid) = &a.orcid {
            out["url"] = json!(orcid);
        }
        out
    };
    about.authors.iter().map(one).collect()
}

/// Notice about the restricted columns in a set.
pub fn conditions(set: &ReleaseSet) -> String {
    let reasons = set.dictionary.restricted.iter().map(|h| format!("{}.{}: {}", h.table, h.column, protect::why(h)));
    format!("Restricted columns are included. {}.", reasons.collect::<Vec<_>>().join("; "))
}

/// Files of a table and, if there are several, the set of these files.
fn distribution(table: &ReleaseTable) -> Vec<Value> {
    let mut found: Vec<Value> = table
        .files
        .iter()
        .map(|f| {
            json!({
                "@type": "cr:FileObject",
                "@id": address(&f.path),
                "name": f.path,
                "contentUrl": address(&f.path),
                "encodingFormat": PARQUET,
                "contentSize": format!("{} B", f.bytes),
                "sha256": f.sha256,
            })
        })
        .collect();
    if table.files.len() != 1 {
        found.push(json!({
            "@type": "cr:FileSet",
            "@id": files_of(table),
            "name": files_of(table),
            "description": format!("the files of the table {}", table.name),
            "encodingFormat": PARQUET,
            "includes": format!("data/{}/*/*/*.parquet", table.name),
        }));
    }
    found
}

fn files_of(table: &ReleaseTable) -> String {
    format!("{}-files", table.name)
}

fn record_set(table: &ReleaseTable) -> Value {
    let source = match table.files.as_slice() {
        [one] => ("fileObject", address(&one.path)),
        _ => ("fileSet", files_of(table)),
    };
    let field = |c: &ReleaseColumn| {
        let mut out = json!({
            "@type": "cr:Field",
            "@id": format!("{}/{}", table.name, address(&c.name)),
            "name": c.name,
            "description": described(c),
            "dataType": data_type(c),
            "source": { source.0: { "@id": source.1 }, "extract": { "column": c.name } },
        });
        if c.kind == ColumnKind::Numbers {
            out["repeated"] = json!(true);
        }
        out
    };
    json!({
        "@type": "cr:RecordSet",
        "@id": table.name,
        "name": table.name,
        "description": if table.description.is_empty() { table.kind.clone() } else { table.description.clone() },
        "field": table.columns.iter().map(field).collect::<Vec<_>>(),
    })
}

/// Meaning of a column with its unit and role, for which Croissant has no separate fields.
fn described(c: &ReleaseColumn) -> String {
    let unit = if c.unit.is_empty() { String::new() } else { format!(" Unit: {}.", c.unit) };
    let terms = if c.terms.is_empty() { String::new() } else { format!(" Entries: {}.", c.terms.join(", ")) };
    let text = if c.description.is_empty() { &c.name } else { &c.description };
    format!("{text}.{unit} Role: {}.{terms}", if c.role.is_empty() { "aux" } else { &c.role })
}

fn data_type(c: &ReleaseColumn) -> &'static str {
    match c.kind {
        ColumnKind::Number | ColumnKind::Numbers => "sc:Float",
        ColumnKind::Integer => "sc:Integer",
        ColumnKind::Boolean => "sc:Boolean",
        // Values without a matching type are read as text.
        ColumnKind::Text | ColumnKind::Other(_) => "sc:Text",
    }
}
