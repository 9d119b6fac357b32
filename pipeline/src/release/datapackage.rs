//! `datapackage.json`: the set as a Frictionless Data Package, one resource per file. [Data Package 1.0; Table Schema
//! 1.0]

use serde_json::{Map, Value, json};

use super::set::{ColumnKind, DataFile, ReleaseColumn, ReleaseSet, ReleaseTable};

/// Name of a resource or package: lower case, digits and `-_.`.
fn slug(text: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_');
    let spelt: String = text.to_lowercase().chars().map(|c| if plain(c) { c } else { '-' }).collect();
    let words: Vec<&str> = spelt.split('-').filter(|w| !w.is_empty()).collect();
    words.join("-")
}

/// File with the schema of a table.
pub fn schema_path(table: &str) -> String {
    format!("schemas/{table}.json")
}

/// Contents of `datapackage.json`.
pub fn write(set: &ReleaseSet) -> Value {
    let about = &set.dictionary.about;
    let contributor = |a: &super::set::Person| {
        let mut out = json!({ "title": a.name, "role": "author" });
        if let Some(orcid) = &a.orcid {
            out["path"] = json!(orcid);
        }
        if let Some(affiliation) = &a.affiliation {
            out["organization"] = json!(affiliation);
        }
        out
    };
    let licence = &about.licence;
    let mut out = json!({
        "name": slug(&set.lock.pipeline),
        "title": about.title,
        "description": about.description,
        "version": about.version,
        "licenses": [{ "name": slug_of_licence(&licence.name), "path": licence.url, "title": licence.title }],
        "contributors": about.authors.iter().map(contributor).collect::<Vec<_>>(),
    });
    if !about.keywords.is_empty() {
        out["keywords"] = json!(about.keywords);
    }
    if let Some(address) = about.address() {
        out["id"] = json!(address);
        out["homepage"] = json!(address);
    }
    out["resources"] = set.dictionary.tables.iter().flat_map(|t| t.files.iter().map(move |f| resource(t, f))).collect();
    out
}

/// Name of a licence with only the permitted characters; unlike other names, it keeps its case.
fn slug_of_licence(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-') { c } else { '-' }).collect()
}

fn resource(table: &ReleaseTable, file: &DataFile) -> Value {
    let mut words = vec![table.name.clone()];
    // The spelling in the path is used, because two identifiers may have the same slug.
    let middle = file.path.strip_prefix("data/").and_then(|p| p.strip_suffix("/part-0.parquet"));
    words.extend(middle.into_iter().flat_map(|p| p.split('/').skip(1)).map(|p| {
        let value = p.split_once('=').map_or(p, |(_, value)| value);
        value
            .bytes()
            .map(|b| if b.is_ascii_uppercase() || b == b'%' { format!("_{b:02x}") } else { char::from(b).to_string() })
            .collect()
    }));
    json!({
        "name": slug(&words.join("-")),
        "path": file.path,
        "format": "parquet",
        "mediatype": "application/vnd.apache.parquet",
        "hash": format!("sha256:{}", file.sha256),
        "rows": file.rows,
        "schema": schema_path(&table.name),
    })
}

/// Schema of a table.
pub fn schema(table: &ReleaseTable) -> Value {
    json!({ "fields": table.columns.iter().map(field).collect::<Vec<_>>(), "missingValues": ["", "NaN"] })
}

fn field(c: &ReleaseColumn) -> Value {
    let kind = match c.kind {
        ColumnKind::Number => "number",
        ColumnKind::Integer => "integer",
        ColumnKind::Boolean => "boolean",
        ColumnKind::Text => "string",
        ColumnKind::Numbers => "array",
        ColumnKind::Other(_) => "any",
    };
    let mut out = Map::new();
    out.insert("name".into(), json!(c.name));
    out.insert("type".into(), json!(kind));
    if !c.description.is_empty() {
        out.insert("description".into(), json!(c.description));
    }
    if !c.unit.is_empty() {
        out.insert("unit".into(), json!(c.unit));
    }
    out.insert("role".into(), json!(c.role));
    if !c.terms.is_empty() {
        out.insert("terms".into(), json!(c.terms));
    }
    Value::Object(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_resource_names_are_slugs_and_unique_per_file() {
        let table = |paths: &[&str]| -> Vec<String> {
            let file = |p: &&str| DataFile {
                path: (*p).to_owned(),
                flight: None,
                line: None,
                rows: 0,
                bytes: 0,
                sha256: String::new(),
            };
            let table = ReleaseTable {
                name: "Clean".into(),
                kind: String::new(),
                stage: None,
                description: String::new(),
                axes: vec![],
                sorted_by: vec![],
                partitions: vec![],
                rows: 0,
                columns: vec![],
                files: vec![],
            };
            let name = |p: &&str| resource(&table, &file(p))["name"].as_str().unwrap_or_default().to_owned();
            paths.iter().map(name).collect()
        };
        let path = |f: &str, l: &str| format!("data/Clean/flight_id=flight-{f}/line_id=line-{l}/part-0.parquet");
        let names = table(&[
            &path("1", "1.10"),
            &path("a", "1"),
            &path("A", "1"),
            &path("a%20", "1"),
            "data/Clean/part-0.parquet",
        ]);
        assert_eq!(names[0], "clean-flight-1-line-1.10");
        assert_eq!(names[4], "clean");
        let fine = |n: &String| n.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || "-._".contains(c));
        assert!(names.iter().all(fine), "{names:?}");
        let different: std::collections::BTreeSet<&String> = names.iter().collect();
        assert_eq!(different.len(), names.len(), "{names:?}");
    }
}
