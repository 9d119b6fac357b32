//! The types of survey lines in Geosoft databases.

/// The type of a survey line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum LineType {
    /// A survey line.
    Line,
    /// A base line, or a base station.
    Base,
    /// A tie line, across the survey lines.
    Tie,
    /// A test line.
    Test,
    /// A line along a trend.
    Trend,
    /// A line of any other kind.
    Special,
    /// Points in any order.
    Random,
}

impl LineType {
    /// All types.
    pub const ALL: [LineType; 7] = [
        LineType::Line,
        LineType::Base,
        LineType::Tie,
        LineType::Test,
        LineType::Trend,
        LineType::Special,
        LineType::Random,
    ];

    /// The word of a line record.
    pub const fn word(self) -> &'static str {
        match self {
            LineType::Line => "Line",
            LineType::Base => "Base",
            LineType::Tie => "Tie",
            LineType::Test => "Test",
            LineType::Trend => "Trend",
            LineType::Special => "Special",
            LineType::Random => "Random",
        }
    }

    /// The letter in front of a line's number.
    pub const fn letter(self) -> char {
        match self {
            LineType::Line => 'L',
            LineType::Base => 'B',
            LineType::Tie => 'T',
            LineType::Test => 'S',
            LineType::Trend => 'R',
            LineType::Special => 'P',
            LineType::Random => 'D',
        }
    }

    /// The type for a word of a line record, in upper or lower case.
    pub fn of_word(word: &str) -> Option<LineType> {
        LineType::ALL.into_iter().find(|kind| kind.word().eq_ignore_ascii_case(word))
    }

    /// The type for a letter in front of a line's number, in upper or lower case.
    pub fn of_letter(letter: char) -> Option<LineType> {
        LineType::ALL.into_iter().find(|kind| kind.letter().eq_ignore_ascii_case(&letter))
    }
}
