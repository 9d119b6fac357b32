//! `DICTIONARY.md`: every column with its unit, role, meaning and values.

use std::fmt::Write;

use super::{
    set::{ReleaseColumn, ReleaseSet, ReleaseTable},
    words::{cell, counted},
};

/// Text of `DICTIONARY.md`.
pub fn write(set: &ReleaseSet) -> String {
    let mut text = format!("# Data dictionary of {}\n", cell(&set.dictionary.about.title));
    text += "\n`dictionary.json` is the machine-readable form. Roles: `key` identifies a flight, a line or a point \
             of the sweep; `time` is the time of a sample; `truth` is not available in operation; `sensor` is \
             measured; `aux` is auxiliary; `derived` is computed.\n";
    for table in &set.dictionary.tables {
        text += &section(table);
    }
    text
}

fn section(table: &ReleaseTable) -> String {
    let mut text = format!("\n## {}\n\n", table.name);
    // Writing into a String cannot fail.
    let made = table.stage.as_ref().map(|s| format!(" made by the stage `{s}`")).unwrap_or_default();
    let files = counted(table.files.len(), "file");
    let _ = writeln!(text, "A table of kind \"{}\"{made}: {} in {files}.", table.kind, counted(table.rows, "row"));
    if !table.description.is_empty() {
        let _ = writeln!(text, "\n{}", table.description.trim());
    }
    if !table.sorted_by.is_empty() {
        let _ = writeln!(text, "\nThe rows of each file are sorted by {}.", table.sorted_by.join(", "));
    }
    text += "\n| column | type | unit | role | meaning | least | greatest | missing | made from |\n\
             |:--|:--|:--|:--|:--|--:|--:|--:|:--|\n";
    table.columns.iter().for_each(|c| text += &row(c));
    for key in &table.partitions {
        let of = key.strip_suffix("_id").unwrap_or(key);
        let _ = writeln!(
            text,
            "| `{key}` | text | | key | the name of the file's folder: `{of}-` and the identifier; only readers of \
             hive partitions return this column | | | 0 | |"
        );
    }
    for column in table.columns.iter().filter(|c| !c.terms.is_empty()) {
        let _ = writeln!(text, "\nEntries of `{}`: {}.", column.name, column.terms.join(", "));
    }
    text
}

fn row(c: &ReleaseColumn) -> String {
    let number = |x: Option<f64>| x.map(|x| x.to_string()).unwrap_or_default();
    let from: Vec<String> = c.from.iter().map(|f| format!("`{f}`")).collect();
    format!(
        "| `{}` | {} | {} | {} | {} | {} | {} | {} | {} |\n",
        c.name,
        c.kind,
        c.unit,
        c.role,
        cell(&c.description),
        number(c.values.min),
        number(c.values.max),
        c.values.missing,
        from.join(", ")
    )
}
