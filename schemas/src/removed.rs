//! Corrections applied to a magnetic reading, so that none is applied twice.

use std::{
    collections::{BTreeSet, HashMap},
    fmt,
};

/// The metadata key that lists corrections, such as `core,diurnal`.
const REMOVED: &str = "removed";
/// The metadata key of the correction that the subtraction of a column makes.
const CORRECTION: &str = "correction";

/// A correction of a magnetic reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Correction {
    /// The core field was subtracted.
    Core,
    /// The temporal variation was subtracted.
    Diurnal,
    /// The sensor's lag was removed.
    Lag,
    /// The heading error was subtracted.
    Heading,
    /// The line was levelled.
    Levelling,
}

impl Correction {
    const ALL: [Correction; 5] =
        [Correction::Core, Correction::Diurnal, Correction::Lag, Correction::Heading, Correction::Levelling];

    /// The word in the field metadata.
    pub fn word(self) -> &'static str {
        match self {
            Correction::Core => "core",
            Correction::Diurnal => "diurnal",
            Correction::Lag => "lag",
            Correction::Heading => "heading",
            Correction::Levelling => "levelling",
        }
    }

    fn parse(word: &str) -> Option<Correction> {
        Self::ALL.into_iter().find(|c| c.word() == word)
    }

    /// The correction that the subtraction of a column of this name makes: `igrf` is the core field, `diurnal` the
    /// temporal variation.
    pub fn by_column(name: &str) -> Option<Correction> {
        match name {
            "igrf" => Some(Correction::Core),
            "diurnal" => Some(Correction::Diurnal),
            _ => None,
        }
    }
}

impl fmt::Display for Correction {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Correction::Core => "the core field",
            Correction::Diurnal => "the diurnal variation",
            Correction::Lag => "the lag",
            Correction::Heading => "the heading error",
            Correction::Levelling => "the levelling",
        })
    }
}

/// The corrections applied to a column.
pub type Removed = BTreeSet<Correction>;

/// Writes the corrections applied to the column `name`, and the one that its subtraction makes, to its field's
/// metadata.
pub(crate) fn write(
    name: &str,
    removed: &Removed,
    correction: Option<Correction>,
    metadata: &mut HashMap<String, String>,
) {
    if let Some(correction) = correction.filter(|own| Correction::by_column(name) != Some(*own)) {
        metadata.insert(CORRECTION.to_owned(), correction.word().to_owned());
    }
    if !removed.is_empty() {
        let words: Vec<&str> = removed.iter().map(|c| c.word()).collect();
        metadata.insert(REMOVED.to_owned(), words.join(","));
    }
}

/// The correction that the subtraction of the column `name` makes.
pub(crate) fn correction(name: &str, metadata: &HashMap<String, String>) -> Option<Correction> {
    metadata.get(CORRECTION).and_then(|word| Correction::parse(word)).or_else(|| Correction::by_column(name))
}

/// The corrections in the metadata of a field; without metadata, those defined for a column of this name.
pub(crate) fn read(name: &str, metadata: &HashMap<String, String>) -> Removed {
    match metadata.get(REMOVED) {
        Some(words) => words.split(',').filter_map(Correction::parse).collect(),
        None => by_name(name),
    }
}

/// The corrections of the columns of the contract: those of the SGL data sets.
fn by_name(name: &str) -> Removed {
    match name {
        "mag_1_lag" => Removed::from([Correction::Lag]),
        "mag_1_dc" => Removed::from([Correction::Lag, Correction::Diurnal]),
        "mag_1_igrf" => Removed::from([Correction::Lag, Correction::Diurnal, Correction::Core]),
        _ => Removed::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Column, describe_field};

    #[test]
    fn law_metadata_hold_what_was_removed_and_names_of_the_contract_imply_it() {
        let mut column = Column::float("target", "nT", "");
        assert!(!column.field().metadata().contains_key("removed"));
        column.removed = Correction::ALL.into();
        assert_eq!(column.field().metadata()["removed"], "core,diurnal,lag,heading,levelling");
        assert_eq!(describe_field(&column.field()).removed, column.removed);
        let base = Column { correction: Some(Correction::Diurnal), ..Column::float("base", "nT", "") };
        assert_eq!(describe_field(&base.field()).correction, Some(Correction::Diurnal));
        assert_eq!(Column::float("igrf", "nT", "").correction, Some(Correction::Core));
        let of = |name: &str| describe_field(&Column::float(name, "nT", "").field()).removed;
        assert_eq!(of("mag_1_c"), Removed::new());
        assert_eq!(of("mag_1_igrf"), Removed::from([Correction::Core, Correction::Diurnal, Correction::Lag]));
    }
}
