//! Reads the small reference tables of the tests.

use std::collections::BTreeMap;

/// The columns of a numeric table, by column name. Lines that begin with `#` give the source of the table.
pub(crate) fn columns(text: &str) -> BTreeMap<String, Vec<f64>> {
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|x| x.parse().unwrap_or(f64::NAN)).collect()).collect();
    let column = |j: usize| rows.iter().map(|row| row[j]).collect();
    names.iter().enumerate().map(|(j, name)| ((*name).to_owned(), column(j))).collect()
}

/// Column names of the terms in the samples on which linear models are tested.
pub(crate) const TERMS: [&str; 8] = ["a0", "a1", "a2", "a3", "a4", "a5", "a6", "a7"];

/// A line of these samples: the terms, row-major, and both targets.
pub(crate) struct ModelLine {
    pub a: Vec<f64>,
    pub y0: Vec<f64>,
    pub y1: Vec<f64>,
}

/// The four lines of the samples in `reference/models/samples.csv`.
pub(crate) fn model_lines() -> Vec<ModelLine> {
    let table = columns(include_str!("../reference/models/samples.csv"));
    let of = |line: f64| {
        let rows: Vec<usize> = (0..table["line"].len()).filter(|&i| table["line"][i] == line).collect();
        let y = |name: &str| rows.iter().map(|&i| table[name][i]).collect();
        let a = rows.iter().flat_map(|&i| TERMS.map(|name| table[name][i])).collect();
        ModelLine { a, y0: y("y0"), y1: y("y1") }
    };
    [0.0, 1.0, 2.0, 3.0].map(of).into()
}
