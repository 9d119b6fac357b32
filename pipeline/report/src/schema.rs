//! JSON Schema of a spec, made from the declarations of the stages; editors use it to complete and check specs.
//!
//! The schema accepts every valid spec. It rejects most specs that have a misspelt key, a value of the wrong type or a
//! number outside its limits. Only `magline check` checks relations between tables.

use std::collections::BTreeMap;

use datasets::{FlightOptions, MapOptions};
use plan::{
    sources::{MappingOptions, ModelOptions},
    spec::{STAGE_KEYS, publish, search_docs},
};
use schemas::{ChoiceDoc, ChoiceRegistry, InputDecl, InputKind, ParamDoc, Params, StageEntry, TableKind};
use serde_json::{Map, Value, json};

/// Reference to an axis instead of a value.
const AXIS: &str = "#/definitions/axis";

/// JSON Schema (draft 7) of a spec with the stages of a catalogue.
pub fn schema(catalogue: &[StageEntry]) -> Value {
    let lists = ChoiceRegistry::default();
    let search = search_docs();
    let values = json!({ "anyOf": [
        { "type": ["string", "number", "boolean"] },
        { "type": "array", "minItems": 1 },
        table(
            [("subsets_of", json!({ "type": "array", "minItems": 1 })), ("at_least", whole()), ("up_to", whole())],
            &["subsets_of"],
        ),
    ]});
    let range = group(&search.axis);
    let mut searched = group(&search.search);
    let halving = group(&search.halving);
    put(
        &mut searched,
        "axes",
        json!({ "type": "object", "minProperties": 1, "additionalProperties": { "anyOf": [range, values] } }),
    );
    put(&mut searched, "where", text("An SQL predicate on `flight` and `line` that selects the lines of the goal."));
    put(&mut searched, "halving", {
        let mut halving = halving;
        put(&mut halving, "values", json!({ "type": "array", "minItems": 1 }));
        halving
    });
    let sources = [
        FlightOptions::docs(&lists),
        MappingOptions::docs(&lists),
        MapOptions::docs(&lists),
        ModelOptions::docs(&lists),
        publish::ProtectionKeys::docs(&lists),
    ];
    // The kind of a table is known only from its file, so the keys of all kinds are accepted.
    let mut source = group(&sources.concat());
    put(&mut source, "path", text("The file, folder or pattern, relative to the folder of the spec."));
    put(&mut source, "where", text("For a model: an SQL condition that selects one of several models."));
    source["required"] = json!(["path"]);
    let stages: Vec<Value> = catalogue.iter().flat_map(variants).collect();
    json!({
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "magline spec",
        "type": "object",
        "definitions": {
            "axis": { "type": "string", "pattern": "^\\$", "description": "The value of an axis: `$NAME`." },
            "source": source,
            "values": values,
            "stage": { "oneOf": stages },
        },
        "properties": {
            "name": text("The name of the pipeline; default: the name of the file."),
            "seed": { "type": "integer", "minimum": 0, "default": 0, "description": "The seed of all random draws." },
            "store": text("The folder or address of the results, relative to the spec; default: `store`."),
            "tables": { "type": "object", "additionalProperties": { "$ref": "#/definitions/source" } },
            "axes": { "type": "object", "additionalProperties": { "$ref": "#/definitions/values" } },
            "search": searched,
            "stages": { "type": "array", "minItems": 1, "items": { "$ref": "#/definitions/stage" } },
            "publish": group(&publish::PublishFacts::docs(&lists)),
        },
        "required": ["stages"],
        "additionalProperties": false,
    })
}

/// The schemas of a stage: one for each choice, such as each model of `fit`, and one in which the choice is the value
/// of an axis.
fn variants(entry: &StageEntry) -> Vec<Value> {
    let mut by_key: BTreeMap<&str, Vec<&ChoiceDoc>> = BTreeMap::new();
    for kind in &entry.kinds {
        by_key.entry(kind.key).or_default().push(kind);
    }
    let Some((key, kinds)) = by_key.into_iter().next() else { return vec![stage(entry, &[], None)] };
    let defaults: Vec<&ParamDoc> = entry.params.iter().filter(|p| p.name == key).collect();
    let is_default =
        |kind: &ChoiceDoc| defaults.iter().any(|p| p.default.as_deref().is_some_and(|d| named(d, kind.name)));
    let mut forms: Vec<Value> = kinds
        .iter()
        .map(|kind| {
            let chosen = json!({ "const": kind.name, "description": first_sentence(&kind.doc) });
            stage(entry, &[kind], Some((key, chosen, !is_default(kind))))
        })
        .collect();
    forms.push(stage(entry, &kinds, Some((key, json!({ "$ref": AXIS }), true))));
    forms
}

/// Whether a default in canonical spelling equals `name`.
fn named(default: &str, name: &str) -> bool {
    default.trim_matches('"') == name
}

/// The schema of a stage with the keys of `kinds`. `chosen` holds the key that makes the choice, the schema of its
/// value, and whether the key is required.
fn stage(entry: &StageEntry, kinds: &[&ChoiceDoc], chosen: Option<(&str, Value, bool)>) -> Value {
    let mut required = vec!["name".to_owned(), "stage".to_owned()];
    let mut keys = Map::new();
    let of_kinds = kinds.iter().flat_map(|kind| &kind.params);
    let single = kinds.len() <= 1;
    let own = entry.params.iter().filter(|p| p.owners.is_empty());
    let needed = insert(&mut keys, own.chain(of_kinds));
    if single {
        required.extend(needed);
    }
    for decl in entry.inputs {
        keys.insert(decl.name.to_owned(), input(decl));
        if !decl.optional {
            required.push(decl.name.to_owned());
        }
    }
    for (name, doc) in STAGE_KEYS {
        let types = match name {
            "publish" | "keep" => json!({ "type": "boolean" }),
            "carry" => json!({ "type": "array", "items": { "type": "string" } }),
            _ => json!({ "type": "string" }),
        };
        keys.insert(name.to_owned(), described(types, doc));
    }
    keys.insert("stage".to_owned(), json!({ "const": entry.name, "description": first_sentence(&entry.doc) }));
    if let Some((key, values, needed)) = chosen {
        keys.insert(key.to_owned(), values);
        required.retain(|name| name != key);
        if needed {
            required.push(key.to_owned());
        }
    }
    required.sort_unstable();
    required.dedup();
    let yields = match entry.yields {
        TableKind::Map => "map",
        TableKind::Lines => "lines",
        TableKind::Model => "model",
        TableKind::Scores => "scores",
    };
    json!({
        "type": "object", "title": entry.name, "properties": keys, "required": required, "additionalProperties": false,
        "x-version": entry.version, "x-yields": yields,
    })
}

/// The name of an input table, or several.
fn input(decl: &InputDecl) -> Value {
    let one = json!({ "type": "string" });
    let (words, several) = match decl.kind {
        InputKind::Lines => ("A table of flight lines.", false),
        InputKind::Scores => ("A table of scores.", false),
        InputKind::Record => ("A record.", false),
        InputKind::Model => ("A model.", false),
        InputKind::Map => ("A map.", false),
        InputKind::ManyLines => ("Tables of flight lines.", true),
        InputKind::ManyRecords => ("Records.", true),
        InputKind::ManyModels => ("Models.", true),
        InputKind::ManyMaps => ("Maps.", true),
    };
    let types = if several { json!({ "anyOf": [one, { "type": "array", "items": one }] }) } else { one };
    described(types, words)
}

/// A table with the keys of `docs` and no others.
fn group(docs: &[ParamDoc]) -> Value {
    let mut keys = Map::new();
    let required = insert(&mut keys, docs.iter());
    json!({ "type": "object", "properties": keys, "required": required, "additionalProperties": false })
}

/// Inserts the keys of `docs` and returns the names of the required keys. A key of several kinds may have several
/// types.
fn insert<'a>(keys: &mut Map<String, Value>, docs: impl Iterator<Item = &'a ParamDoc>) -> Vec<String> {
    let mut required = vec![];
    for doc in docs {
        let shown = param(doc);
        match keys.get_mut(doc.name) {
            Some(known) if *known != shown => *known = json!({ "anyOf": [known.clone(), shown] }),
            Some(_) => {}
            None => {
                keys.insert(doc.name.to_owned(), shown);
            }
        }
        if doc.default.is_none() && doc.absent.is_none() {
            required.push(doc.name.to_owned());
        }
    }
    required
}

/// The schema of a key: a value of its type, or an axis.
fn param(doc: &ParamDoc) -> Value {
    let own = own_type(doc).unwrap_or(json!({}));
    let unit = if matches!(doc.unit, "" | "1") { String::new() } else { format!(" Unit: {}.", doc.unit) };
    let unset = doc.absent.filter(|text| !text.is_empty()).map_or(String::new(), |text| format!(" Unset: {text}."));
    let mut shown = described(json!({ "anyOf": [own, { "$ref": AXIS }] }), &format!("{}{unit}{unset}", doc.doc));
    if let Some(default) = doc.default.as_deref().and_then(|text| serde_json::from_str::<Value>(text).ok()) {
        shown["default"] = default;
    }
    shown
}

/// The schema of a key's type and rule; `None` for an unknown type or rule.
fn own_type(doc: &ParamDoc) -> Option<Value> {
    let limits = limits(&doc.rule)?;
    let with = |mut base: Value, more: &Value| {
        if let (Some(base), Some(more)) = (base.as_object_mut(), more.as_object()) {
            base.extend(more.clone());
        }
        base
    };
    Some(match doc.type_name {
        "number" => with(json!({ "type": "number" }), &limits),
        "whole number" => with(json!({ "type": "integer" }), &limits),
        "whole number below 65536" => json!({ "type": "integer", "minimum": 0, "maximum": 65_535 }),
        "boolean" => json!({ "type": "boolean" }),
        "text" => with(json!({ "type": "string" }), &limits),
        "number or `auto`" => json!({ "anyOf": [with(json!({ "type": "number" }), &limits), { "const": "auto" }] }),
        // The types of the elements are checked by `magline check`. A single value is accepted as a list of one
        // element.
        "list" if limits.get("enum").is_some() => {
            let item = json!({ "anyOf": [limits, { "$ref": AXIS }] });
            json!({ "anyOf": [item, { "type": "array", "items": item }] })
        }
        "list" => json!({ "type": ["array", "string", "number", "boolean"] }),
        "table" if doc.keys.is_empty() => json!({ "type": "object" }),
        "table" => group(&doc.keys),
        "list of tables" => json!({ "anyOf": [group(&doc.keys), { "type": "array", "items": group(&doc.keys) }] }),
        "boolean or list of columns" => json!({ "type": ["boolean", "array", "string"] }),
        "number or text" | "text or number" => json!({ "type": ["number", "string"] }),
        "number or list of three" => {
            let number = with(json!({ "type": "number" }), &limits);
            let three = json!({ "type": "array", "items": number, "minItems": 3, "maxItems": 3 });
            json!({ "anyOf": [number, three] })
        }
        _ => return None,
    })
}

/// The limits of a rule, in words; `None` for an unknown rule.
fn limits(rule: &str) -> Option<Value> {
    Some(match rule {
        "" | "finite" => json!({}),
        "above 0" => json!({ "exclusiveMinimum": 0 }),
        "0 or above" => json!({ "minimum": 0 }),
        words if words.starts_with('`') => {
            json!({ "enum": words.split(", ").map(|word| word.trim_matches('`')).collect::<Vec<_>>() })
        }
        range => {
            let (low, high) = range.split_once(" to ")?;
            json!({ "minimum": low.parse::<f64>().ok()?, "maximum": high.parse::<f64>().ok()? })
        }
    })
}

fn table<const N: usize>(keys: [(&str, Value); N], required: &[&str]) -> Value {
    let keys: Map<String, Value> = keys.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
    json!({ "type": "object", "properties": keys, "required": required, "additionalProperties": false })
}

fn whole() -> Value {
    json!({ "type": "integer", "minimum": 0 })
}

fn text(doc: &str) -> Value {
    json!({ "type": "string", "description": doc })
}

fn described(mut types: Value, doc: &str) -> Value {
    types["description"] = json!(doc.replace("\n\n", " "));
    types
}

fn put(table: &mut Value, key: &str, value: Value) {
    table["properties"][key] = value;
}

/// The first sentence of a documentation text.
fn first_sentence(doc: &str) -> &str {
    let paragraph = doc.split("\n\n").next().unwrap_or_default();
    paragraph.find(". ").map_or(paragraph, |end| &paragraph[..=end])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn unit_every_type_and_rule_of_the_declarations_is_known() {
        let lists = ChoiceRegistry::default();
        let search = search_docs();
        let catalogue = stages::catalogue();
        let mut docs: Vec<ParamDoc> = [
            FlightOptions::docs(&lists),
            MappingOptions::docs(&lists),
            MapOptions::docs(&lists),
            ModelOptions::docs(&lists),
            publish::ProtectionKeys::docs(&lists),
            publish::PublishFacts::docs(&lists),
            search.search,
            search.axis,
            search.halving,
        ]
        .concat();
        docs.extend(
            catalogue.iter().flat_map(|e| e.params.iter().chain(e.kinds.iter().flat_map(|k| &k.params))).cloned(),
        );
        while let Some(doc) = docs.pop() {
            assert!(own_type(&doc).is_some(), "{}: {} ({})", doc.name, doc.type_name, doc.rule);
            docs.extend(doc.keys);
        }
    }

    #[test]
    fn unit_each_kind_has_a_form_with_its_own_keys() {
        let all = schema(&stages::catalogue());
        let forms = all["definitions"]["stage"]["oneOf"].as_array().unwrap();
        let of = |stage: &str, key: &str, kind: &str| {
            let is = |f: &&Value| f["properties"]["stage"]["const"] == stage && f["properties"][key]["const"] == kind;
            forms.iter().find(is).unwrap_or_else(|| panic!("no form of {stage} with {key} = {kind}"))
        };
        let ridge = of("fit", "model", "tolles_lawson");
        assert!(ridge["properties"]["lambda"].is_object());
        assert!(ridge["properties"]["epochs"].is_null(), "a key of networks");
        assert!(of("navigate", "filter", "mpf")["properties"]["particles"].is_object());
    }
}
