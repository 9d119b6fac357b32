//! Record of the corrections applied to a magnetic reading, so that none is applied twice.

use std::{
    collections::{BTreeSet, HashMap},
    fmt,
};

/// The metadata key that lists corrections, such as `core,diurnal`.
const REMOVED: &str = "removed";
/// Metadata key of a column that can be subtracted from a reading: the correction that the subtraction applies.
const CORRECTION: &str = "correction";

/// A correction of a magnetic reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum MagneticCorrection {
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

impl MagneticCorrection {
    const ALL: [MagneticCorrection; 5] = [
        MagneticCorrection::Core,
        MagneticCorrection::Diurnal,
        MagneticCorrection::Lag,
        MagneticCorrection::Heading,
        MagneticCorrection::Levelling,
    ];

    /// The word in the field metadata.
    pub fn word(self) -> &'static str {
        match self {
            MagneticCorrection::Core => "core",
            MagneticCorrection::Diurnal => "diurnal",
            MagneticCorrection::Lag => "lag",
            MagneticCorrection::Heading => "heading",
            MagneticCorrection::Levelling => "levelling",
        }
    }

    fn parse(word: &str) -> Option<MagneticCorrection> {
        Self::ALL.into_iter().find(|c| c.word() == word)
    }

    /// Correction that is applied by subtracting a column of this name: for `igrf` the core field, for `diurnal` the
    /// temporal variation.
    pub fn by_column(name: &str) -> Option<MagneticCorrection> {
        match name {
            "igrf" => Some(MagneticCorrection::Core),
            "diurnal" => Some(MagneticCorrection::Diurnal),
            _ => None,
        }
    }
}

impl fmt::Display for MagneticCorrection {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            MagneticCorrection::Core => "the core field",
            MagneticCorrection::Diurnal => "the diurnal variation",
            MagneticCorrection::Lag => "the lag",
            MagneticCorrection::Heading => "the heading error",
            MagneticCorrection::Levelling => "the levelling",
        })
    }
}

/// The corrections applied to a column.
pub type CorrectionSet = BTreeSet<MagneticCorrection>;

/// Writes to the metadata of a field: the corrections applied to the column `name`, and the correction that subtracting
/// this column applies.
pub(crate) fn write(
    name: &str,
    removed: &CorrectionSet,
    correction: Option<MagneticCorrection>,
    metadata: &mut HashMap<String, String>,
) {
    if let Some(correction) = correction.filter(|own| MagneticCorrection::by_column(name) != Some(*own)) {
        metadata.insert(CORRECTION.to_owned(), correction.word().to_owned());
    }
    if !removed.is_empty() {
        let words: Vec<&str> = removed.iter().map(|c| c.word()).collect();
        metadata.insert(REMOVED.to_owned(), words.join(","));
    }
}

/// Correction that is applied by subtracting the column `name`.
pub(crate) fn correction(name: &str, metadata: &HashMap<String, String>) -> Option<MagneticCorrection> {
    metadata
        .get(CORRECTION)
        .and_then(|word| MagneticCorrection::parse(word))
        .or_else(|| MagneticCorrection::by_column(name))
}

/// The corrections in the metadata of a field; without metadata, those defined for a column of this name.
pub(crate) fn read(name: &str, metadata: &HashMap<String, String>) -> CorrectionSet {
    match metadata.get(REMOVED) {
        Some(words) => words.split(',').filter_map(MagneticCorrection::parse).collect(),
        None => by_name(name),
    }
}

/// Corrections of the contract's columns, whose names are those of the SGL data sets.
fn by_name(name: &str) -> CorrectionSet {
    match name {
        "mag_1_lag" => CorrectionSet::from([MagneticCorrection::Lag]),
        "mag_1_dc" => CorrectionSet::from([MagneticCorrection::Lag, MagneticCorrection::Diurnal]),
        "mag_1_igrf" => {
            CorrectionSet::from([MagneticCorrection::Lag, MagneticCorrection::Diurnal, MagneticCorrection::Core])
        }
        _ => CorrectionSet::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Column, describe_field};

    #[test]
    fn unit_corrections_are_read_from_metadata_or_column_names() {
        let mut column = Column::float("target", "nT", "");
        assert!(!column.field().metadata().contains_key("removed"));
        column.removed = MagneticCorrection::ALL.into();
        assert_eq!(column.field().metadata()["removed"], "core,diurnal,lag,heading,levelling");
        assert_eq!(describe_field(&column.field()).removed, column.removed);
        let base = Column { correction: Some(MagneticCorrection::Diurnal), ..Column::float("base", "nT", "") };
        assert_eq!(describe_field(&base.field()).correction, Some(MagneticCorrection::Diurnal));
        assert_eq!(Column::float("igrf", "nT", "").correction, Some(MagneticCorrection::Core));
        let of = |name: &str| describe_field(&Column::float(name, "nT", "").field()).removed;
        assert_eq!(of("mag_1_c"), CorrectionSet::new());
        assert_eq!(
            of("mag_1_igrf"),
            CorrectionSet::from([MagneticCorrection::Core, MagneticCorrection::Diurnal, MagneticCorrection::Lag])
        );
    }
}
