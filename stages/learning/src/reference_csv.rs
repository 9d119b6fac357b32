//! Reads the small reference tables of the tests.

use std::collections::BTreeMap;

/// The columns of a table of numbers by name; lines that begin with `#` give its source.
pub(crate) fn columns(text: &str) -> BTreeMap<String, Vec<f64>> {
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|x| x.parse().unwrap_or(f64::NAN)).collect()).collect();
    let column = |j: usize| rows.iter().map(|row| row[j]).collect();
    names.iter().enumerate().map(|(j, name)| ((*name).to_owned(), column(j))).collect()
}

/// The named columns side by side, row-major.
pub(crate) fn matrix(table: &BTreeMap<String, Vec<f64>>, names: &[&str]) -> Vec<f64> {
    let rows = names.first().map_or(0, |name| table[*name].len());
    (0..rows).flat_map(|i| names.iter().map(move |name| table[*name][i])).collect()
}
