//! Numbers and tables as text.

use schemas::one_line;

use crate::plan::Point;

/// A number as it is read: four significant digits.
pub fn number(x: Option<f64>) -> String {
    match x {
        None => "-".to_owned(),
        Some(0.0) => "0".to_owned(),
        Some(x) => {
            let digits = (3 - x.abs().log10().floor() as i64).clamp(0, 6);
            format!("{x:.*}", usize::try_from(digits).unwrap_or(0))
        }
    }
}

/// The values of the axes at a point, separated by commas; empty without axes.
pub fn point_words(point: &Point) -> String {
    point.iter().map(|(name, value)| format!("{name} = {value}")).collect::<Vec<_>>().join(", ")
}

/// Rows of words in columns: the first `left` flush left, the others flush right.
pub fn columns(table: &[Vec<String>], left: usize) -> String {
    let table: Vec<Vec<String>> =
        table.iter().map(|row| row.iter().map(|word| one_line(word).into_owned()).collect()).collect();
    let count = table.iter().map(Vec::len).max().unwrap_or(0);
    let wide = |c: usize| table.iter().filter_map(|r| r.get(c)).map(|w| w.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..count).map(wide).collect();
    let cell = |(c, word): (usize, &String)| {
        if c < left { format!("{word:<w$}", w = widths[c]) } else { format!("{word:>w$}", w = widths[c]) }
    };
    let line = |row: &Vec<String>| {
        row.iter().enumerate().map(cell).collect::<Vec<_>>().join("  ").trim_end().to_owned() + "\n"
    };
    table.iter().map(line).collect()
}
