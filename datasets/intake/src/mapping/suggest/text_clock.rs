//! Recognises times that are logged as text. A date such as 03/06/2025 can be read in two ways. If the rows make one of
//! them impossible, the other is used. Otherwise the day is assumed to come first, and a question is added.

use schemas::one_line;

use super::sample::ColumnSample;
use crate::mapping::clock::{TimeText, TimeTextFormat, date_text};

/// Formats of dates, in `strftime` letters.
const DATES: [&str; 16] = [
    "%Y/%m/%d", "%Y.%m.%d", "%Y%m%d", "%d.%m.%Y", "%d-%b-%Y", "%d %b %Y", "%d/%m/%Y", "%m/%d/%Y", "%d-%m-%Y",
    "%m-%d-%Y", "%d.%m.%y", "%d/%m/%y", "%m/%d/%y", "%j/%Y", "%y/%m/%d", "%y.%m.%d",
];
/// Formats of times of day.
const TIMES: [&str; 4] = ["%H:%M:%S%.f", "%I:%M:%S%.f %p", "%H:%M", "%H%M%S%.f"];
/// Days since 1970 of the dates that a log can have: 1950 to 2100.
const DAYS: std::ops::Range<i64> = -7_305..47_482;

/// Format of times in text.
pub(super) struct TextClock {
    /// Format in `strftime` letters; `None` for ISO 8601.
    pub(super) format: Option<String>,
    /// Whether the text has a date.
    pub(super) dated: bool,
    /// Times, in seconds.
    pub(super) times_s: Vec<f64>,
    /// Question about a date that can be read in two ways.
    pub(super) question: Option<String>,
}

/// The format of times in text, if at least 99 % of the rows have this format.
pub(super) fn text_clock(column: &ColumnSample, texts: &[String]) -> Option<TextClock> {
    if let Some(found) = fitting(None, texts) {
        return Some(found);
    }
    let dated = DATES
        .iter()
        .flat_map(|date| TIMES.iter().flat_map(move |time| [format!("{date} {time}"), format!("{date}T{time}")]));
    let mut found = dated.chain(TIMES.map(str::to_owned)).filter_map(|format| fitting(Some(format), texts));
    let mut first = found.next()?;
    let day = |clock: &TextClock| day_of(clock.format.as_deref(), texts.first()?);
    let other = found.find(|other| other.dated == first.dated && day(other) != day(&first));
    if let (Some(other), Some(text)) = (other, texts.first())
        && let (Some(one), Some(two), Some(format)) = (day(&first), day(&other), other.format)
    {
        first.question = Some(format!(
            "is `{}`, such as {text}, {} or {}? It is read as {}. For the other date, set `format = \"{format}\"` in \
             `time`",
            one_line(&column.name),
            date_text(one),
            date_text(two),
            date_text(one)
        ));
    }
    Some(first)
}

/// Day of a text, in days since 1970.
fn day_of(format: Option<&str>, text: &str) -> Option<i64> {
    match TimeTextFormat::new(format)?.read(text)? {
        TimeText::At { instant, .. } => Some(instant.day),
        TimeText::OfDay(_) => None,
    }
}

fn fitting(format: Option<String>, texts: &[String]) -> Option<TextClock> {
    let reader = TimeTextFormat::new(format.as_deref())?;
    let (mut times_s, mut damaged) = (Vec::with_capacity(texts.len()), 0);
    for text in texts {
        let at = match reader.read(text) {
            Some(TimeText::At { instant, .. }) if DAYS.contains(&instant.day) => instant.seconds_since(0),
            Some(TimeText::OfDay(s)) => s,
            Some(TimeText::At { .. }) | None => {
                damaged += 1;
                if damaged * 100 > texts.len() {
                    return None;
                }
                continue;
            }
        };
        times_s.push(at);
    }
    (!times_s.is_empty()).then(|| TextClock { dated: reader.is_dated(), format, times_s, question: None })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn clock(texts: &[&str]) -> Option<TextClock> {
        let texts: Vec<String> = texts.iter().map(|text| (*text).to_owned()).collect();
        let column = ColumnSample { name: "Zeit".to_owned(), ..ColumnSample::default() };
        text_clock(&column, &texts)
    }

    #[test]
    fn unit_formats_of_times_are_recognised() {
        for (texts, format) in [
            (["2025-06-03T09:30:00Z", "2025-06-03T09:30:00.1Z"], None),
            (["03.06.2025 09:30:00.000", "03.06.2025 09:30:00.050"], Some("%d.%m.%Y %H:%M:%S%.f")),
            (["2025/06/03 09:30:00", "2025/06/03 09:30:01"], Some("%Y/%m/%d %H:%M:%S%.f")),
            (["20250603 093000.5", "20250603 093001.0"], Some("%Y%m%d %H%M%S%.f")),
            (["3-Jun-2025 09:30:00", "3-Jun-2025 09:30:01"], Some("%d-%b-%Y %H:%M:%S%.f")),
            (["13/06/2025 09:30:00", "13/06/2025 09:30:01"], Some("%d/%m/%Y %H:%M:%S%.f")),
            (["06/13/2025 9:30:00 AM", "06/13/2025 9:30:01 AM"], Some("%m/%d/%Y %I:%M:%S%.f %p")),
            (["23:59:59.95", "00:00:00.00"], Some("%H:%M:%S%.f")),
        ] {
            let found = clock(&texts).unwrap();
            assert_eq!(found.format.as_deref(), format, "{texts:?}");
            assert!(found.question.is_none(), "{texts:?}: {:?}", found.question);
        }
        for texts in [["Line 1", "Line 2"], ["45", "46"], ["2025-06-03", "2025-06-03"], ["09:30:00", "cal"]] {
            assert!(clock(&texts).is_none(), "{texts:?}");
        }
    }

    #[test]
    fn unit_a_date_with_two_readings_is_a_question() {
        let found = clock(&["03/06/2025 09:30:00", "03/06/2025 09:30:00"]).unwrap();
        assert_eq!(found.format.as_deref(), Some("%d/%m/%Y %H:%M:%S%.f"));
        let question = found.question.unwrap();
        assert!(question.contains("2025-06-03 or 2025-03-06") && question.contains("%m/%d/%Y"), "{question}");
        assert_eq!(found.times_s[0], found.times_s[1]);
        let question = clock(&["13/06/25 09:30:00", "13/06/25 09:30:01"]).unwrap().question.unwrap();
        assert!(question.contains("2025-06-13 or 2013-06-25"), "{question}");
        // Equal day and month.
        assert!(clock(&["06/06/2025 09:30:00", "06/06/2025 09:30:01"]).unwrap().question.is_none());
    }
}
