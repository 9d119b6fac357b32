//! `CITATION.cff`, Citation File Format 1.2.0, and the citation as BibTeX.

use serde_json::Value;

use super::set::ReleaseMetadata;

/// Text as a YAML scalar, for which any JSON string is valid. Control characters that YAML rejects are escaped.
fn scalar(text: &str) -> String {
    let quoted = Value::String(text.to_owned()).to_string();
    let escaped = |c: char| match c {
        '\u{7f}'..='\u{9f}' | '\u{2028}' | '\u{2029}' | '\u{feff}' => format!("\\u{:04x}", u32::from(c)),
        c => c.to_string(),
    };
    quoted.chars().map(escaped).collect()
}

/// Text of `CITATION.cff`.
pub fn write(about: &ReleaseMetadata) -> String {
    let mut text = "cff-version: 1.2.0\ntype: dataset\n".to_owned();
    let mut line = |key: &str, value: &str| text += &format!("{key}: {}\n", scalar(value));
    line("message", "If you use this data set, please cite it as below.");
    line("title", &about.title);
    line("abstract", &about.description);
    line("version", &about.version);
    line("date-released", &about.date);
    if let Some(doi) = &about.doi {
        line("doi", doi);
    }
    if let Some(url) = &about.url {
        line("url", url);
    }
    line(
        if about.licence.spdx { "license" } else { "license-url" },
        if about.licence.spdx { &about.licence.name } else { &about.licence.url },
    );
    text += "authors:\n";
    for author in &about.authors {
        let names = match (&author.given, &author.family) {
            (Some(given), Some(family)) => vec![("given-names", given.as_str()), ("family-names", family.as_str())],
            _ => vec![("name", author.name.as_str())],
        };
        let is_person = names.len() > 1;
        let mut keys = names;
        keys.extend(author.orcid.as_deref().map(|o| ("orcid", o)));
        // An organisation has no affiliation in this format.
        keys.extend(author.affiliation.as_deref().filter(|_| is_person).map(|a| ("affiliation", a)));
        for (i, (key, value)) in keys.iter().enumerate() {
            text += &format!("  {} {key}: {}\n", if i == 0 { "-" } else { " " }, scalar(value));
        }
    }
    if !about.keywords.is_empty() {
        text += "keywords:\n";
        about.keywords.iter().for_each(|k| text += &format!("  - {}\n", scalar(k)));
    }
    text
}

/// Citation in one sentence.
pub fn sentence(about: &ReleaseMetadata) -> String {
    let names: Vec<&str> = about.authors.iter().map(|a| a.name.as_str()).collect();
    let year = about.date.get(..4).unwrap_or_default();
    let address = about.address().map(|a| format!(" {a}")).unwrap_or_default();
    format!("{} ({year}). {}, version {}.{address}", names.join(", "), about.title, about.version)
}

/// Citation as an entry of BibTeX.
pub fn bibtex(about: &ReleaseMetadata) -> String {
    let braced =
        |text: &str| text.chars().map(|c| if matches!(c, '{' | '}' | '\\') { ' ' } else { c }).collect::<String>();
    let names: Vec<String> = about
        .authors
        .iter()
        .map(|a| match (&a.family, &a.given) {
            (Some(family), Some(given)) => format!("{}, {}", braced(family), braced(given)),
            _ => format!("{{{}}}", braced(&a.name)),
        })
        .collect();
    let year = about.date.get(..4).unwrap_or_default();
    let mut keys = vec![("author", names.join(" and ")), ("title", braced(&about.title)), ("year", year.to_owned())];
    keys.push(("version", about.version.clone()));
    keys.extend(about.doi.clone().map(|doi| ("doi", doi)));
    keys.extend(about.url.clone().map(|url| ("url", url)));
    let keys: Vec<String> = keys.iter().map(|(key, value)| format!("{key} = {{{value}}}")).collect();
    format!("@misc{{dataset{year}, {}}}", keys.join(", "))
}
