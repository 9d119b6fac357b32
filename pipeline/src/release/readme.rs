//! `README.md` of a set: contents, reading, verification, recomputation, and a datasheet. [Gebru et al. 2021,
//! Datasheets for Datasets]

use std::fmt::Write;

use super::{
    checksums, citation, protect,
    set::{ReleaseSet, ReleaseTable},
    words::{cell, counted},
};
use crate::shell::shell_quoted;

/// Text of `README.md`.
pub fn write(set: &ReleaseSet) -> String {
    let about = &set.dictionary.about;
    let mut text = format!("# {}\n\n{}\n\n", cell(&about.title), about.description.trim());
    // Writing into a String cannot fail.
    let _ = writeln!(
        text,
        "Version {}, {}. Licence: [{}]({}). Questions: {}.",
        about.version, about.date, about.licence.title, about.licence.url, about.contact
    );
    let _ = writeln!(text, "\nCite it as (`CITATION.cff`):\n\n> {}", citation::sentence(about));
    text += &restricted(set);
    text += &tables(set);
    text += &reading(set);
    text += &datasheet(set);
    text += &again(set);
    text
}

/// Notice about the restricted columns in the set.
fn restricted(set: &ReleaseSet) -> String {
    if set.dictionary.restricted.is_empty() {
        return String::new();
    }
    let mut text = "\n## Restricted data\n\nThis data set contains restricted columns. Redistribution requires the \
                    permission of their owners.\n\n"
        .to_owned();
    for held in &set.dictionary.restricted {
        let _ = writeln!(text, "- `{}.{}`: {} ({})", held.table, held.column, protect::why(held), protect::chain(held));
    }
    text
}

fn tables(set: &ReleaseSet) -> String {
    let mut text = "\n## Tables\n\nEvery column with its unit and meaning is in [DICTIONARY.md](DICTIONARY.md).\n\n\
                    | table | kind | made by | rows | columns | files |\n|:--|:--|:--|--:|--:|--:|\n"
        .to_owned();
    for t in &set.dictionary.tables {
        let stage = t.stage.as_ref().map(|s| format!("`{s}`")).unwrap_or_else(|| "files".to_owned());
        let _ = writeln!(
            text,
            "| `{}` | {} | {stage} | {} | {} | {} |",
            t.name,
            t.kind,
            t.rows,
            t.columns.len(),
            t.files.len()
        );
    }
    if !set.dictionary.failures.is_empty() {
        const SHOWN: usize = 20;
        text += "\nThese results could not be computed, so they are not in the tables:\n\n";
        for f in set.dictionary.failures.iter().take(SHOWN) {
            let line =
                f.line.as_ref().map(|l| format!(", flight {}, line {l}", f.flight.as_deref().unwrap_or_default()));
            let _ =
                writeln!(text, "- `{}`{} ({})", f.table, cell(&line.unwrap_or_default()), counted(f.points, "point"));
        }
        if set.dictionary.failures.len() > SHOWN {
            let _ = writeln!(text, "- and {} more, listed in `dictionary.json`", set.dictionary.failures.len() - SHOWN);
        }
    }
    text
}

fn reading(set: &ReleaseSet) -> String {
    let mut text = "\n## Reading\n\nThe tables are Parquet files with zstd compression. The metadata of their fields \
                    have units, roles and meanings. Any Parquet reader accepts the folder of a table:\n\n```python\n"
        .to_owned();
    let glob = |t: &ReleaseTable| if t.partitions.is_empty() { "*.parquet" } else { "*/*/*.parquet" };
    if let Some(t) = set.dictionary.tables.first() {
        let _ = writeln!(text, "pandas.read_parquet(\"data/{}/\")", t.name);
        let _ = writeln!(text, "polars.scan_parquet(\"data/{}/\")", t.name);
        let _ = writeln!(text, "duckdb.sql(\"FROM 'data/{}/{}'\")", t.name, glob(t));
        let _ = writeln!(text, "spark.read.parquet(\"data/{}/\")", t.name);
    }
    text += "```\n";
    if set.dictionary.tables.iter().any(|t| !t.partitions.is_empty()) {
        text += "\nA table of flight lines has one file per line, in folders by flight and line. Readers of hive \
                 partitions add the columns `flight_id` and `line_id` from the names of the folders. The text \
                 columns `flight` and `line` are in the files.\n";
    }
    text
}

fn datasheet(set: &ReleaseSet) -> String {
    let about = &set.dictionary.about;
    let mut text = "\n## Datasheet\n".to_owned();
    let mut part = |title: &str, body: &str| {
        let _ = write!(text, "\n### {title}\n\n{}\n", body.trim());
    };
    let unsaid = "Not provided by the authors.";
    part("Motivation", about.motivation.as_deref().unwrap_or(unsaid));
    let mut composition = String::new();
    for t in &set.dictionary.tables {
        let missing: u64 = t.columns.iter().map(|c| c.values.missing).sum();
        let lines =
            if t.partitions.is_empty() { String::new() } else { format!("{} of ", counted(t.files.len(), "line")) };
        let sweep = if t.axes.is_empty() { String::new() } else { format!(", over {}", t.axes.join(" x ")) };
        let _ = writeln!(
            composition,
            "- `{}`: {lines}{}{sweep}; {missing} missing values (null or NaN)",
            t.name,
            counted(t.rows, "row")
        );
    }
    part("Composition", &composition);
    part("Collection", about.collection.as_deref().unwrap_or(unsaid));
    let mut steps = String::new();
    for s in &set.lock.stages {
        let rows = s.predicate.as_ref().map(|p| format!(" where {}", cell(p))).unwrap_or_default();
        let sweep = if s.axes.is_empty() {
            String::new()
        } else {
            format!(", {} over {}", counted(s.points, "point"), s.axes.join(" x "))
        };
        let _ = writeln!(
            steps,
            "- `{}`: stage `{}`, version {}, from {}{rows}{sweep}",
            s.table,
            s.stage,
            s.version,
            s.inputs.join(", ")
        );
    }
    part("Processing", &steps);
    part("Uses", about.uses.as_deref().unwrap_or(unsaid));
    part("Limits", about.limits.as_deref().unwrap_or(unsaid));
    let mut distribution = format!("Licence {}; version {} of {}.", about.licence.name, about.version, about.date);
    if let Some(address) = about.address() {
        let _ = write!(distribution, " {address}");
    }
    part("Distribution", &distribution);
    part("Maintenance", &format!("Questions and corrections: {}.", about.contact));
    text
}

fn again(set: &ReleaseSet) -> String {
    let lock = &set.lock;
    let sets: String = lock.set.iter().map(|s| format!(" --set {}", shell_quoted(s))).collect();
    let tables: Vec<&str> = set.dictionary.tables.iter().map(|t| t.name.as_str()).collect();
    let restricted_flag = if set.dictionary.restricted.is_empty() { "" } else { " --include-restricted" };
    let mut text = format!(
        "\n## Verification and recomputation\n\n```sh\nsha256sum -c {}                # or, including all documents \
         and every column:\nmagline verify .\n```\n\n",
        checksums::NAME
    );
    let _ = writeln!(
        text,
        "magline {} made this data set from `{}` (seed {}, run {}). The inputs and their SHA-256; paths are relative \
         to the folder of the spec:\n",
        lock.magline, lock.spec, lock.seed, lock.run
    );
    text += "| table | file | bytes | SHA-256 | included |\n|:--|:--|--:|:--|:--|\n";
    for i in &lock.inputs {
        let _ = writeln!(
            text,
            "| `{}` | `{}` | {} | `{}` | {} |",
            i.table,
            cell(&i.file),
            i.bytes,
            i.sha256,
            if i.included.is_some() { "yes" } else { "no" }
        );
    }
    let _ = writeln!(
        text,
        "\nWith these inputs, the following commands give the same bytes:\n\n```sh\nmagline run '{0}' --set \
         store=/tmp/store{sets}\nmagline publish '{0}' {1} --to /tmp/again --set \
         store=/tmp/store{sets}{restricted_flag}\n```",
        lock.spec,
        tables.join(" ")
    );
    text
}
