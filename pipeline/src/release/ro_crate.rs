//! `ro-crate-metadata.json`: the set as an RO-Crate 1.1, with its provenance: inputs, stages, results. [RO-Crate
//! Metadata Specification 1.1]

use serde_json::{Value, json};

use super::{
    croissant::conditions,
    inputs, protect,
    set::{Person, ReleaseInput, ReleaseSet, ReleaseStage, ReleaseTable},
    words::{DICTIONARY, LICENCE, LOCK, address},
};

/// Documents that the crate lists, with their descriptions and types.
const DOCUMENTS: [(&str, &str, &str); 7] = [
    ("README.md", "content and use of the data set", "text/markdown"),
    ("DICTIONARY.md", "every column with unit, role and meaning", "text/markdown"),
    (DICTIONARY, "the data dictionary for programs", "application/json"),
    ("CITATION.cff", "how to cite the data set", "application/yaml"),
    ("croissant.json", "the data set as Croissant 1.0", "application/ld+json"),
    ("datapackage.json", "the data set as a Frictionless Data Package", "application/json"),
    (LICENCE, "the licence", "text/plain"),
];

/// Contents of `ro-crate-metadata.json`.
pub fn write(set: &ReleaseSet) -> Value {
    let about = &set.dictionary.about;
    let authors: Vec<String> = about.authors.iter().enumerate().map(|(i, a)| author_id(i, a)).collect();
    let (mut parts, mut graph) = (vec![], vec![]);
    let mut part = |id: String, entity: Value| {
        parts.push(id);
        graph.push(entity);
    };
    for (path, what, kind) in DOCUMENTS {
        part(
            path.to_owned(),
            json!({ "@id": path, "@type": "File", "name": path, "description": what, "encodingFormat": kind }),
        );
    }
    let lock = &set.lock;
    let spec = address(&lock.spec);
    part(
        spec.clone(),
        json!({
            "@id": spec, "@type": ["File", "SoftwareSourceCode"], "name": lock.pipeline, "sha256": lock.spec_sha256,
            "description": "the spec of the pipeline, from which `magline run` computes the data",
            "encodingFormat": "application/toml", "programmingLanguage": { "@id": "#magline" },
        }),
    );
    part(
        LOCK.to_owned(),
        json!({
            "@id": LOCK, "@type": "File", "name": LOCK, "encodingFormat": "application/json",
            "description": "versions, seed, hashes of the inputs, parameters and keys",
        }),
    );
    for table in &set.dictionary.tables {
        let id = table_id(table);
        let files: Vec<String> = table.files.iter().map(|f| address(&f.path)).collect();
        part(
            id.clone(),
            json!({
                "@id": id, "@type": "Dataset", "name": table.name, "hasPart": refer(&files),
                "description": if table.description.is_empty() { &table.kind } else { &table.description },
            }),
        );
        part(
            datapackage_schema(&table.name),
            json!({
                "@id": datapackage_schema(&table.name), "@type": "File", "name": format!("schema of {}", table.name),
                "description": "the columns of the table as a Table Schema", "encodingFormat": "application/json",
            }),
        );
        for (file, id) in table.files.iter().zip(&files) {
            part(
                id.clone(),
                json!({
                    "@id": id, "@type": "File", "name": file.path, "encodingFormat": "application/vnd.apache.parquet",
                    "contentSize": file.bytes.to_string(), "sha256": file.sha256,
                }),
            );
        }
    }
    for input in lock.inputs.iter().filter(|i| i.included.is_some()) {
        let id = input_id(input);
        if !parts.contains(&id) {
            parts.push(id);
            graph.push(described_input(input));
        }
    }
    let mut known: Vec<String> = vec![];
    for input in lock.inputs.iter().filter(|i| i.included.is_none()) {
        if !known.contains(&input_id(input)) {
            known.push(input_id(input));
            graph.push(described_input(input));
        }
    }
    graph.extend(provenance(set));
    graph.extend(people(&about.authors, &authors));
    let licence = &about.licence;
    graph.push(
        json!({ "@id": licence.url, "@type": "CreativeWork", "name": licence.title, "identifier": licence.name }),
    );
    graph.push(json!({
        "@id": "#contact", "@type": "ContactPoint", "contactType": "questions about the data set",
        contact_key(&about.contact): about.contact,
    }));
    let stages: Vec<String> = set.lock.stages.iter().map(action_id).collect();
    let mut root = json!({
        "@id": "./", "@type": "Dataset", "name": about.title, "description": about.description,
        "datePublished": about.date, "version": about.version, "license": { "@id": licence.url },
        "author": refer(&authors), "publisher": refer(&publishers(&about.authors, &authors)),
        "contactPoint": { "@id": "#contact" }, "hasPart": refer(&parts), "mentions": refer(&stages),
    });
    if !about.keywords.is_empty() {
        root["keywords"] = json!(about.keywords.join(", "));
    }
    if let Some(doi) = &about.doi {
        root["identifier"] = json!(format!("https://doi.org/{doi}"));
    }
    if let Some(url) = &about.url {
        root["url"] = json!(url);
    }
    if !set.dictionary.restricted.is_empty() {
        root["conditionsOfAccess"] = json!(conditions(set));
    }
    let descriptor = json!({
        "@id": "ro-crate-metadata.json", "@type": "CreativeWork",
        "conformsTo": { "@id": "https://w3id.org/ro/crate/1.1" }, "about": { "@id": "./" },
    });
    let all: Vec<Value> = [descriptor, root].into_iter().chain(graph).collect();
    // The context of RO-Crate 1.1 lacks schema.org's term for checksums, which is newer.
    let context = json!(["https://w3id.org/ro/crate/1.1/context", { "sha256": "https://schema.org/sha256" }]);
    json!({ "@context": context, "@graph": all })
}

/// References to entities: a list, or an object if there is only one.
fn refer(ids: &[String]) -> Value {
    match ids {
        [one] => json!({ "@id": one }),
        many => many.iter().map(|id| json!({ "@id": id })).collect(),
    }
}

fn datapackage_schema(table: &str) -> String {
    address(&super::datapackage::schema_path(table))
}

fn contact_key(contact: &str) -> &'static str {
    if contact.contains('@') && !contact.contains('/') { "email" } else { "url" }
}

fn table_id(table: &ReleaseTable) -> String {
    format!("data/{}/", address(&table.name))
}

fn author_id(i: usize, author: &Person) -> String {
    author.orcid.clone().unwrap_or_else(|| format!("#author-{}", i + 1))
}

/// Organisations among the authors, or all authors if there is none.
fn publishers(authors: &[Person], ids: &[String]) -> Vec<String> {
    let bodies: Vec<String> =
        authors.iter().zip(ids).filter(|(a, _)| a.family.is_none()).map(|(_, id)| id.clone()).collect();
    if bodies.is_empty() { ids.to_vec() } else { bodies }
}

fn people(authors: &[Person], ids: &[String]) -> Vec<Value> {
    let mut found = vec![];
    let mut institutes: Vec<&String> = vec![];
    for (author, id) in authors.iter().zip(ids) {
        let kind = if author.family.is_some() { "Person" } else { "Organization" };
        let mut out = json!({ "@id": id, "@type": kind, "name": author.name });
        if let (Some(given), Some(family)) = (&author.given, &author.family) {
            out["givenName"] = json!(given);
            out["familyName"] = json!(family);
        }
        if let Some(institute) = &author.affiliation {
            let at = institutes.iter().position(|i| *i == institute).unwrap_or_else(|| {
                institutes.push(institute);
                institutes.len() - 1
            });
            out["affiliation"] = json!({ "@id": format!("#institute-{}", at + 1) });
        }
        found.push(out);
    }
    let institute = |(i, name): (usize, &&String)| {
        let id = format!("#institute-{}", i + 1);
        json!({ "@id": id, "@type": "Organization", "name": name })
    };
    found.extend(institutes.iter().enumerate().map(institute));
    found
}

fn input_id(input: &ReleaseInput) -> String {
    match &input.included {
        Some(path) => address(path),
        None => format!("#input-{}", input.sha256.get(..16).unwrap_or_default()),
    }
}

/// Media type of a file, by its extension.
fn media_type(file: &str) -> &'static str {
    const KNOWN: [(&str, &str); 9] = [
        (".toml", "application/toml"),
        (".parquet", "application/vnd.apache.parquet"),
        (".csv", "text/csv"),
        (".xyz", "text/plain"),
        (".tif", "image/tiff"),
        (".tiff", "image/tiff"),
        (".h5", "application/x-hdf5"),
        (".nc", "application/x-netcdf"),
        (".json", "application/json"),
    ];
    let name = file.to_lowercase();
    KNOWN.iter().find(|(end, _)| name.ends_with(end)).map_or("application/octet-stream", |(_, kind)| kind)
}

fn described_input(input: &ReleaseInput) -> Value {
    let kind = if input.included.is_some() { "File" } else { "CreativeWork" };
    json!({
        "@id": input_id(input), "@type": kind, "name": input.file, "sha256": input.sha256,
        "contentSize": input.bytes.to_string(), "encodingFormat": media_type(&input.file),
        "description": format!("an input of the pipeline: the table {}", input.table),
    })
}

fn action_id(stage: &ReleaseStage) -> String {
    format!("#made-{}", address(&stage.table))
}

fn program_id(stage: &ReleaseStage) -> String {
    format!("#stage-{}-{}", stage.stage, stage.version)
}

/// One action per table that a stage made, starting from the inputs.
fn provenance(set: &ReleaseSet) -> Vec<Value> {
    let lock = &set.lock;
    let mut found = vec![json!({
        "@id": "#magline", "@type": ["SoftwareApplication", "ComputerLanguage"], "name": "magline",
        "softwareVersion": lock.magline, "version": lock.magline,
        "description": "batch pipeline for aeromagnetic compensation and magnetic navigation",
    })];
    let published = |name: &str| set.dictionary.tables.iter().find(|t| t.name == name);
    let object = |name: &String| -> Vec<String> {
        let files: Vec<String> = lock.inputs.iter().filter(|i| i.table == *name).map(input_id).collect();
        if files.is_empty() { vec![result_id(name, published(name))] } else { files }
    };
    let mut programs: Vec<String> = vec![];
    for stage in &lock.stages {
        let id = program_id(stage);
        if !programs.contains(&id) {
            found.push(json!({
                "@id": id, "@type": "SoftwareApplication", "name": format!("stage {} of magline", stage.stage),
                "softwareVersion": stage.version.to_string(), "isPartOf": { "@id": "#magline" },
            }));
            programs.push(id);
        }
        let result = result_id(&stage.table, published(&stage.table));
        if published(&stage.table).is_none() {
            found.push(json!({
                "@id": result, "@type": "CreativeWork", "name": stage.table,
                "description": "a table of the pipeline that is not part of the data set",
            }));
        }
        let parameters: Vec<String> =
            stage.parameters.iter().map(|(key, values)| format!("{key} = {}", values.join(" | "))).collect();
        let rows = stage.predicate.as_ref().map(|p| format!(" where {p}")).unwrap_or_default();
        found.push(json!({
            "@id": action_id(stage), "@type": "CreateAction",
            "name": format!("{} by {}{rows}", stage.table, stage.stage),
            "description": parameters.join("; "), "identifier": stage.key,
            "instrument": { "@id": program_id(stage) },
            "object": refer(&stage.inputs.iter().flat_map(object).collect::<Vec<_>>()),
            "result": { "@id": result },
            "actionStatus": { "@id": "http://schema.org/CompletedActionStatus" },
        }));
    }
    if !set.dictionary.restricted.is_empty() {
        let text = set.dictionary.restricted.iter().map(protect::chain).collect::<Vec<_>>().join("; ");
        found
            .push(json!({ "@id": "#restricted", "@type": "CreativeWork", "name": "restricted columns", "text": text }));
    }
    debug_assert!(lock.spec.starts_with(inputs::FOLDER));
    found
}

fn result_id(name: &str, table: Option<&ReleaseTable>) -> String {
    table.map_or_else(|| format!("#table-{}", address(name)), table_id)
}
