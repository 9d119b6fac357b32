//! Subset of JSON Schema 2020-12 that the schemas in this repository use. An unknown keyword is a fault, so that no
//! constraint is ignored.

use std::{collections::BTreeMap, fs, path::Path};

use serde_json::Value;

/// Schemas by their `$id`.
pub struct Schemas(BTreeMap<String, Value>);

/// Keywords without effect on validity.
const SILENT: [&str; 9] =
    ["$schema", "$id", "$defs", "description", "title", "example", "examples", "deprecated", "$comment"];

impl Schemas {
    /// All files `*.json` of a folder.
    pub fn read(folder: &Path) -> Schemas {
        let files = fs::read_dir(folder).unwrap().flatten().map(|e| e.path());
        let json = files.filter(|p| p.extension().is_some_and(|e| e == "json"));
        let one = |path: std::path::PathBuf| {
            let schema: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
            (schema["$id"].as_str().unwrap().to_owned(), schema)
        };
        Schemas(json.map(one).collect())
    }

    /// Faults of `value` by the schema at `url`: an `$id`, with a pointer after `#`.
    pub fn faults(&self, url: &str, value: &Value) -> Vec<String> {
        let mut wrong = vec![];
        self.reference("", url, value, "", &mut wrong);
        wrong
    }

    fn reference(&self, base: &str, url: &str, value: &Value, at: &str, wrong: &mut Vec<String>) {
        let (id, pointer) = url.split_once('#').unwrap_or((url, ""));
        let id = if id.is_empty() { base } else { id };
        match self.0.get(id).and_then(|schema| schema.pointer(pointer)) {
            Some(schema) => self.check(id, schema, value, at, wrong),
            None => wrong.push(format!("{at}: there is no schema {id}#{pointer}")),
        }
    }

    fn check(&self, base: &str, schema: &Value, value: &Value, at: &str, wrong: &mut Vec<String>) {
        let Some(keys) = schema.as_object() else {
            assert!(schema.as_bool().is_some(), "{at}: not a schema: {schema}");
            if schema == false {
                wrong.push(format!("{at}: nothing may stand here"));
            }
            return;
        };
        let fine = |schema: &Value| {
            let mut inner = vec![];
            self.check(base, schema, value, at, &mut inner);
            inner.is_empty()
        };
        for (key, rule) in keys {
            let list = || rule.as_array().unwrap().iter();
            let mut need = |holds: bool| {
                if !holds {
                    wrong.push(format!("{at}: {key} {rule} does not hold for {value}"));
                }
            };
            match key.as_str() {
                "$ref" => self.reference(base, rule.as_str().unwrap(), value, at, wrong),
                "allOf" => list().for_each(|s| self.check(base, s, value, at, wrong)),
                "anyOf" => need(list().any(fine)),
                "oneOf" => need(list().filter(|s| fine(s)).count() == 1),
                "not" => need(!fine(rule)),
                "enum" => need(list().any(|x| x == value)),
                "const" => need(rule == value),
                "type" => need(match rule {
                    Value::Array(kinds) => kinds.iter().any(|k| is(value, k.as_str().unwrap())),
                    one => is(value, one.as_str().unwrap()),
                }),
                "required" => {
                    let missing = |k: &&Value| value.is_object() && value.get(k.as_str().unwrap()).is_none();
                    need(!list().any(|k| missing(&k)));
                }
                "minimum" => need(value.as_f64().is_none_or(|x| x >= rule.as_f64().unwrap())),
                "maximum" => need(value.as_f64().is_none_or(|x| x <= rule.as_f64().unwrap())),
                "format" => need(value.as_str().is_none_or(|text| is_formatted(text, rule.as_str().unwrap()))),
                "properties" => {
                    for (name, schema) in rule.as_object().unwrap() {
                        if let Some(inner) = value.get(name) {
                            self.check(base, schema, inner, &format!("{at}/{name}"), wrong);
                        }
                    }
                }
                "additionalProperties" => {
                    let known = |name: &str| schema["properties"].get(name).is_some();
                    for (name, inner) in value.as_object().into_iter().flatten().filter(|(name, _)| !known(name)) {
                        self.check(base, rule, inner, &format!("{at}/{name}"), wrong);
                    }
                }
                "items" => {
                    for (i, inner) in value.as_array().into_iter().flatten().enumerate() {
                        self.check(base, rule, inner, &format!("{at}/{i}"), wrong);
                    }
                }
                silent => assert!(SILENT.contains(&silent), "{at}: the keyword {silent} is not known"),
            }
        }
    }
}

fn is(value: &Value, kind: &str) -> bool {
    match kind {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "null" => value.is_null(),
        "number" => value.is_number(),
        "integer" => value.is_i64() || value.is_u64(),
        other => panic!("the type {other} is not known"),
    }
}

fn is_formatted(text: &str, format: &str) -> bool {
    let shape = |pattern: &str| {
        let same = |(c, p): (char, char)| match p {
            'x' => c.is_ascii_hexdigit(),
            '9' => c.is_ascii_digit(),
            p => c == p,
        };
        text.len() == pattern.len() && text.chars().zip(pattern.chars()).all(same)
    };
    match format {
        "uuid" => shape("xxxxxxxx-xxxx-xxxx-xxxx-xxxxxxxxxxxx"),
        "date-time" => shape("9999-99-99T99:99:99Z") || shape("9999-99-99T99:99:99.999Z"),
        "uri" => {
            let scheme = text.split_once(':').map(|(scheme, rest)| (scheme, !rest.is_empty()));
            let plain = |s: &str| s.chars().all(|c| c.is_ascii_alphanumeric() || "+.-".contains(c));
            scheme.is_some_and(|(s, rest)| s.starts_with(|c: char| c.is_ascii_alphabetic()) && plain(s) && rest)
                && !text.contains(char::is_whitespace)
        }
        other => panic!("the format {other} is not known"),
    }
}

#[test]
fn unit_a_schema_rejects_invalid_values() {
    let schema: Value = serde_json::json!({
        "$id": "urn:test",
        "$defs": { "n": { "type": ["integer", "null"], "minimum": 1 } },
        "type": "object",
        "properties": { "n": { "$ref": "#/$defs/n" }, "id": { "type": "string", "format": "uuid" } },
        "required": ["n"],
        "additionalProperties": false,
    });
    let schemas = Schemas([("urn:test".to_owned(), schema)].into());
    let wrong = |value: Value| schemas.faults("urn:test", &value);
    assert_eq!(wrong(serde_json::json!({ "n": 1, "id": "00000000-0000-4000-8000-000000000000" })), [""; 0]);
    for bad in [
        serde_json::json!({}),
        serde_json::json!({ "n": 0 }),
        serde_json::json!({ "n": 1.5 }),
        serde_json::json!({ "n": 1, "id": "x" }),
        serde_json::json!({ "n": 1, "more": 2 }),
        serde_json::json!([]),
    ] {
        assert!(!wrong(bad.clone()).is_empty(), "{bad}");
    }
}
