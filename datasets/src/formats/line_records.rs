//! The line records of Geosoft's XYZ files: `Line 10`, `TIE T5`, or `L10:2` alone, before the rows of each line.

use std::{
    borrow::Borrow,
    collections::{BTreeMap, BTreeSet},
};

use grids::LineType;

use super::missing;

/// A line record.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct GeosoftLineRecord {
    pub(super) kind: LineType,
    /// The name in the file.
    pub(super) name: String,
}

/// Result of checking whether a text line is a line record.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum LineRecordMatch {
    /// A line record.
    Record(GeosoftLineRecord),
    /// Text that resembles a line record but has an unknown type or too many words.
    Unknown,
    /// Anything else.
    No,
}

/// Classifies the words of a text line. `width` is the number of values in a row of the table, if known.
pub(super) fn read<S: Borrow<str>>(words: &[S], width: Option<usize>) -> LineRecordMatch {
    let digit = |name: &str| name.chars().any(|c| c.is_ascii_digit());
    let other = width.is_some_and(|width| width != words.len());
    let record = |kind, name: &str| LineRecordMatch::Record(GeosoftLineRecord { kind, name: name.to_owned() });
    match words {
        [name] => {
            let name: &str = name.borrow();
            let mut letters = name.chars();
            let kind = letters.next().and_then(LineType::of_letter);
            let number = letters.next().is_some_and(|c| c.is_ascii_digit());
            let usual = matches!(kind, Some(LineType::Line | LineType::Tie | LineType::Base));
            match kind.filter(|_| number && (usual || width != Some(1))) {
                Some(kind) => record(kind, name),
                None if other && name.starts_with(char::is_alphabetic) && digit(name) => LineRecordMatch::Unknown,
                None => LineRecordMatch::No,
            }
        }
        [word, name, more @ ..] => {
            let (word, name): (&str, &str) = (word.borrow(), name.borrow());
            match LineType::of_word(word) {
                Some(kind) if more.is_empty() && (digit(name) || other) => record(kind, name),
                Some(_) if other && digit(name) => LineRecordMatch::Unknown,
                None if other && more.is_empty() && is_word(word) && digit(name) => LineRecordMatch::Unknown,
                _ => LineRecordMatch::No,
            }
        }
        [] => LineRecordMatch::No,
    }
}

fn is_word(text: &str) -> bool {
    text.chars().count() > 1 && text.chars().all(char::is_alphabetic) && !missing::is_usual_word(text)
}

/// The message about an unknown line record.
pub(super) fn unknown<S: Borrow<str>>(words: &[S]) -> String {
    let known: Vec<&str> = LineType::ALL.iter().map(|kind| kind.word()).collect();
    format!(
        "`{}` is not a line record; a line record consists of one of {} and a name",
        words.join(" "),
        known.join(", ")
    )
}

/// The names of the lines of a file. If lines of different types have the same number, the letter of the type precedes
/// the name, except for the type `Line`. In a file with `Line 10`, for example, `Tie 10` is named T10.
#[derive(Debug, Default)]
pub(super) struct GeosoftLineNames {
    types: BTreeMap<String, BTreeSet<LineType>>,
}

impl GeosoftLineNames {
    /// Whether the file has no records.
    pub(super) fn is_empty(&self) -> bool {
        self.types.is_empty()
    }

    /// Adds a record of the file.
    pub(super) fn add(&mut self, record: &GeosoftLineRecord) {
        self.types.entry(record.name.clone()).or_default().insert(record.kind);
    }

    /// The name of the line that a record begins. All records of the file must have been added before.
    pub(super) fn name(&self, record: &GeosoftLineRecord) -> String {
        let shared = self.types.get(&record.name).is_some_and(|types| types.len() > 1);
        let mut name = record.name.clone();
        if shared && record.kind != LineType::Line {
            while self.types.contains_key(&name) {
                name.insert(0, record.kind.letter());
            }
        }
        name
    }

    fn records(&self) -> impl Iterator<Item = GeosoftLineRecord> {
        let of = |(name, types): (&String, &BTreeSet<LineType>)| {
            let record = |kind: &LineType| GeosoftLineRecord { kind: *kind, name: name.clone() };
            types.iter().map(record).collect::<Vec<_>>()
        };
        self.types.iter().flat_map(of)
    }

    /// The type of each line, by its name.
    pub(super) fn types(&self) -> BTreeMap<String, LineType> {
        self.records().map(|record| (self.name(&record), record.kind)).collect()
    }

    /// The note on lines whose names have an added letter.
    pub(super) fn note(&self) -> Option<String> {
        let renamed: Vec<GeosoftLineRecord> =
            self.records().filter(|record| self.name(record) != record.name).collect();
        let first = renamed.first()?;
        let more = if renamed.len() > 1 { format!(", and so on for {} lines", renamed.len()) } else { String::new() };
        Some(format!(
            "lines of different types have the same number, so `{} {}` is named {}{more}",
            first.kind.word(),
            first.name,
            self.name(first)
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(kind: LineType, name: &str) -> GeosoftLineRecord {
        GeosoftLineRecord { kind, name: name.to_owned() }
    }

    #[test]
    fn ref_seven_types_in_any_case_and_names_with_a_letter() {
        for kind in LineType::ALL {
            for word in [kind.word().to_owned(), kind.word().to_uppercase(), kind.word().to_lowercase()] {
                assert_eq!(
                    read(&[word.as_str(), "10"], Some(7)),
                    LineRecordMatch::Record(record(kind, "10")),
                    "{word}"
                );
            }
            let name = format!("{}10:2", kind.letter());
            assert_eq!(read(&[name.as_str()], Some(7)), LineRecordMatch::Record(record(kind, &name)));
        }
        for (words, width, reads) in [
            (&["Line", "A"][..], Some(7), LineRecordMatch::Record(record(LineType::Line, "A"))),
            (&["line", "name"], None, LineRecordMatch::No),
            (&["Foo", "1"], Some(7), LineRecordMatch::Unknown),
            (&["Foo", "1"], Some(2), LineRecordMatch::No),
            (&["Foo", "1"], None, LineRecordMatch::No),
            (&["Z10"], Some(7), LineRecordMatch::Unknown),
            (&["Line", "10", "north"], Some(7), LineRecordMatch::Unknown),
            (&["Line", "10", "north"], Some(3), LineRecordMatch::No),
            (&["nan", "1.5"], Some(7), LineRecordMatch::No),
            (&["1.0", "2.0"], Some(7), LineRecordMatch::No),
            (&["*"], Some(7), LineRecordMatch::No),
        ] {
            assert_eq!(read(words, width), reads, "{words:?}");
        }
    }

    #[test]
    fn unit_lines_of_one_number_and_two_types_have_two_names() {
        let mut names = GeosoftLineNames::default();
        let all = [(LineType::Line, "1"), (LineType::Tie, "1"), (LineType::Tie, "9001"), (LineType::Base, "2")];
        let all = all.map(|(kind, name)| record(kind, name));
        all.iter().for_each(|r| names.add(r));
        assert_eq!(all.each_ref().map(|r| names.name(r)), ["1", "T1", "9001", "2"]);
        let types = [("1", LineType::Line), ("2", LineType::Base), ("9001", LineType::Tie), ("T1", LineType::Tie)];
        assert_eq!(names.types(), types.map(|(name, kind)| (name.to_owned(), kind)).into());
        let note = "lines of different types have the same number, so `Tie 1` is named T1";
        assert_eq!(names.note().as_deref(), Some(note));
        // The name with the letter may already exist.
        names.add(&record(LineType::Line, "T1"));
        assert_eq!(names.name(&all[1]), "TT1");
    }
}
