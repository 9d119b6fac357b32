//! A row of units below the header.

use schemas::is_unit;

/// Characters of the formats of dates and times, such as `hh:mm:ss.s` and `UTC`.
const CLOCK: &str = "hmsydutc:./- 0";

/// The names of a header with the units of the next row, such as `mag [nT]`.
///
/// `None` if the row is not a row of units: it contains a number, its length differs from that of the header, less than
/// half of its words are units, or a name in the header already has another unit in brackets.
pub(super) fn heads_with_units(names: &[String], row: &[String]) -> Option<Vec<String>> {
    let units: Vec<&str> = row.iter().map(|cell| without_brackets(cell)).collect();
    let words = units.iter().filter(|unit| !is_clock(unit));
    let (count, known) = words.fold((0, 0), |(n, known), unit| (n + 1, known + usize::from(is_unit(unit))));
    let starts_number =
        |unit: &&str| unit.trim_start_matches(['+', '-', '.', ',']).starts_with(|c: char| c.is_ascii_digit());
    let has_number = units.iter().any(starts_number);
    if names.len() < 2 || names.len() != row.len() || has_number || known == 0 || 2 * known < count {
        return None;
    }
    names.iter().zip(units).map(|(name, unit)| head(name, unit)).collect()
}

/// Whether a cell is empty, a dash, or a format of dates or times, which is no unit.
fn is_clock(unit: &str) -> bool {
    !is_unit(unit) && unit.to_lowercase().chars().all(|c| CLOCK.contains(c))
}

/// The name with its unit.
fn head(name: &str, unit: &str) -> Option<String> {
    if is_clock(unit) {
        return Some(name.to_owned());
    }
    match name.trim_end().strip_suffix([')', ']']) {
        None => Some(format!("{name} [{unit}]")),
        Some(own) => own.to_lowercase().ends_with(&unit.to_lowercase()).then(|| name.to_owned()),
    }
}

fn without_brackets(cell: &str) -> &str {
    let cell = cell.trim();
    let inside = |open, close| cell.strip_prefix(open).and_then(|c| c.strip_suffix(close));
    inside('(', ')').or_else(|| inside('[', ']')).unwrap_or(cell).trim()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heads(names: &[&str], row: &[&str]) -> Option<Vec<String>> {
        let [names, row] = [names, row].map(|cells| cells.iter().map(|c| (*c).to_owned()).collect::<Vec<_>>());
        heads_with_units(&names, &row)
    }

    #[test]
    fn unit_units_are_told_from_values() {
        let found = |names, row| heads(names, row).unwrap_or_default();
        assert_eq!(found(&["t", "Mag 1", "n"], &["s", "[nT]", ""]), ["t [s]", "Mag 1 [nT]", "n"]);
        assert_eq!(found(&["t", "mag"], &["UTC", "nT"]), ["t", "mag [nT]"]);
        assert_eq!(found(&["date", "t", "n", "mag"], &["yyyy/mm/dd", "hh:mm:ss", "-", "nT"])[3], "mag [nT]");
        assert_eq!(found(&["alt (ft)", "mag"], &["ft", "nT"]), ["alt (ft)", "mag [nT]"]);
        // An unknown unit remains visible.
        assert_eq!(found(&["a", "b"], &["furlong", "m"]), ["a [furlong]", "b [m]"]);
        for (names, row) in [
            (["alt (ft)", "mag"], ["m", "nT"]),
            (["flight", "line"], ["A", "7"]),
            (["a", "b"], ["x", "y"]),
            (["t", "mag"], ["", ""]),
            (["t", "mag"], ["1.5", "nT"]),
            (["t", "mag"], ["-,5", "nT"]),
            (["t", "note"], ["10:00:00", "m"]),
        ] {
            assert_eq!(heads(&names, &row), None, "{row:?}");
        }
        assert_eq!(heads(&["a"], &["m"]), None);
        assert_eq!(heads(&["a", "b"], &["m"]), None);
    }
}
