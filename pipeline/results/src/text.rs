//! Numbers and tables as text.

use plan::SweepPoint;
use schemas::one_line;

/// A number with four significant digits.
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
pub fn point_words(point: &SweepPoint) -> String {
    point.iter().map(|(name, value)| format!("{name} = {value}")).collect::<Vec<_>>().join(", ")
}

/// Rows of words in columns: the first `left` columns flush left, the other columns flush right.
pub fn columns(table: &[Vec<String>], left: usize) -> String {
    let table: Vec<Vec<String>> =
        table.iter().map(|row| row.iter().map(|word| one_line(word).into_owned()).collect()).collect();
    let count = table.iter().map(Vec::len).max().unwrap_or(0);
    let wide = |c: usize| table.iter().filter_map(|r| r.get(c)).map(|w| w.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..count).map(wide).collect();
    let cell = |(c, word): (usize, &String)| {
        // The width of a format is at most 65,535, and a name may be longer.
        let blanks = " ".repeat(widths[c].saturating_sub(word.chars().count()));
        if c < left { format!("{word}{blanks}") } else { blanks + word }
    };
    let line = |row: &Vec<String>| {
        row.iter().enumerate().map(cell).collect::<Vec<_>>().join("  ").trim_end().to_owned() + "\n"
    };
    table.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bug_a_word_longer_than_a_format_is_wide() {
        let long = "L".repeat(70_000);
        let table = [["line", "rows"].map(str::to_owned).to_vec(), vec![long.clone(), "4".to_owned()]];
        let text = columns(&table, 1);
        assert!(text.starts_with("line ") && text.ends_with(&format!("{long}     4\n")));
    }
}
