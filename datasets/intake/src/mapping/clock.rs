//! Log times as days and seconds of UTC, from Unix time, GPS weeks, times of the day and text.

use std::borrow::Cow;

use chrono::{DateTime, Datelike, NaiveDate, NaiveDateTime, NaiveTime, Timelike};

/// Seconds of a day.
pub const DAY_S: f64 = 86_400.0;

/// An instant of UTC; leap seconds are not counted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UtcInstant {
    /// Days since 1970-01-01.
    pub day: i64,
    /// Seconds past the midnight at the start of the day, 0 to 86400.
    pub s: f64,
}

/// Number of the day 1970-01-01 in `chrono`, which counts 0001-01-01 as day 1.
const UNIX_DAY: i64 = 719_163;
/// 1980-01-06, from which GPS weeks are counted, in days since 1970-01-01.
const GPS_DAY: i64 = 3_657;

/// Values of GPS time minus UTC, in seconds, and the first day of each value, in days since 1970-01-01 (IERS bulletin
/// C).
const LEAP_S: &[(i64, f64)] = &[
    (GPS_DAY, 0.0),
    (4_199, 1.0),   // 1981-07-01
    (4_564, 2.0),   // 1982-07-01
    (4_929, 3.0),   // 1983-07-01
    (5_660, 4.0),   // 1985-07-01
    (6_574, 5.0),   // 1988-01-01
    (7_305, 6.0),   // 1990-01-01
    (7_670, 7.0),   // 1991-01-01
    (8_217, 8.0),   // 1992-07-01
    (8_582, 9.0),   // 1993-07-01
    (8_947, 10.0),  // 1994-07-01
    (9_496, 11.0),  // 1996-01-01
    (10_043, 12.0), // 1997-07-01
    (10_592, 13.0), // 1999-01-01
    (13_149, 14.0), // 2006-01-01
    (14_245, 15.0), // 2009-01-01
    (15_522, 16.0), // 2012-07-01
    (16_617, 17.0), // 2015-07-01
    (17_167, 18.0), // 2017-01-01
];

impl UtcInstant {
    /// The instant `s` seconds after the midnight of `day`; `s` may be outside of the day.
    pub fn new(day: i64, s: f64) -> UtcInstant {
        let days = (s / DAY_S).floor();
        let within = s - days * DAY_S;
        // Rounding may make `within` a whole day.
        if within >= DAY_S {
            UtcInstant { day: day + days as i64 + 1, s: 0.0 }
        } else {
            UtcInstant { day: day + days as i64, s: within.max(0.0) }
        }
    }

    /// The instant of a count of nanoseconds since 1970-01-01.
    pub fn of_unix_ns(ns: i128) -> UtcInstant {
        const DAY_NS: i128 = 86_400_000_000_000;
        UtcInstant { day: ns.div_euclid(DAY_NS) as i64, s: ns.rem_euclid(DAY_NS) as f64 / 1e9 }
    }

    /// The instant of a GPS week and the seconds since its start. `leap_s` is GPS time minus UTC; by default the value
    /// at that date. Returns `None` before 1980.
    pub fn of_gps(week: i64, s: f64, leap_s: Option<f64>) -> Option<UtcInstant> {
        let gps = UtcInstant::new(GPS_DAY.checked_add(week.checked_mul(7)?)?, s);
        if gps.day < GPS_DAY {
            return None;
        }
        let leap = leap_s.or_else(|| {
            // The days of the table are in UTC. UTC is behind GPS time by the difference in the table.
            let begun = |(day, leap): &&(i64, f64)| gps.seconds_since(*day) >= *leap;
            LEAP_S.iter().rev().find(begun).map(|(_, leap)| *leap)
        })?;
        Some(gps.plus(-leap))
    }

    /// Seconds since midnight at the start of the day `day`.
    pub fn seconds_since(self, day: i64) -> f64 {
        (self.day - day) as f64 * DAY_S + self.s
    }

    /// The instant `s` seconds later.
    pub fn plus(self, s: f64) -> UtcInstant {
        UtcInstant::new(self.day, self.s + s)
    }
}

/// The year and the day of the year, for a day counted from 1970-01-01; `None` outside of the years -262143 to 262142.
pub fn year_and_day(day: i64) -> Option<(i64, i64)> {
    let date = NaiveDate::from_num_days_from_ce_opt(i32::try_from(day.checked_add(UNIX_DAY)?).ok()?)?;
    Some((i64::from(date.year()), i64::from(date.ordinal())))
}

/// The date in the form `2012-10-10`, for a day counted from 1970-01-01.
pub fn date_text(day: i64) -> String {
    let date = i32::try_from(day + UNIX_DAY).ok().and_then(NaiveDate::from_num_days_from_ce_opt);
    date.map_or_else(|| format!("day {day}"), |d| d.format("%Y-%m-%d").to_string())
}

/// The day, counted from 1970-01-01, for a date such as `2012-10-10`.
pub fn read_date(text: &str) -> Option<i64> {
    let date = NaiveDate::parse_from_str(text.trim(), "%Y-%m-%d").ok()?;
    Some(i64::from(date.num_days_from_ce()) - UNIX_DAY)
}

/// The instant of a date, or of a date and time of ISO 8601; a time without an offset is UTC.
pub fn read_instant(text: &str) -> Option<UtcInstant> {
    read_date(text).map(|day| UtcInstant { day, s: 0.0 }).or_else(|| iso(text))
}

/// An offset such as `+10:00`, `-03:30`, `+02` or `Z` in seconds, positive east of Greenwich.
pub fn read_zone(text: &str) -> Option<f64> {
    let text = text.trim();
    if ["Z", "z", "UTC", "utc"].contains(&text) {
        return Some(0.0);
    }
    let (sign, digits) = match text.split_at_checked(1)? {
        ("+", rest) => (1.0, rest),
        ("-", rest) => (-1.0, rest),
        _ => return None,
    };
    let (hours, minutes) = match digits.split_once(':') {
        Some((h, m)) => (h, m),
        None if digits.len() == 4 => digits.split_at_checked(2)?,
        None => (digits, "0"),
    };
    let plain = |word: &str| (!word.is_empty() && word.len() <= 2).then(|| word.parse::<u8>().ok()).flatten();
    let (hours, minutes) = (plain(hours)?, plain(minutes)?);
    // The range of offsets is from Baker Island to the Line Islands.
    (hours <= 14 && minutes < 60).then(|| sign * (f64::from(hours) * 3600.0 + f64::from(minutes) * 60.0))
}

/// A time stamp in text, with or without a date.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TimeText {
    /// An instant; UTC if the text has an offset.
    At {
        /// The instant.
        instant: UtcInstant,
        /// Whether the text has an offset from UTC, which was subtracted.
        zoned: bool,
    },
    /// Seconds past midnight.
    OfDay(f64),
}

/// The form of time stamps in text.
#[derive(Clone, Debug, PartialEq)]
pub enum TimeTextFormat {
    /// ISO 8601.
    Iso,
    /// A format of `strftime`, with a date.
    Dated(String, bool),
    /// A format of `strftime`, without a date.
    OfDay(String),
}

impl TimeTextFormat {
    /// Parses a format; `None` if `strftime` does not support it, or the format has no time.
    pub fn new(format: Option<&str>) -> Option<TimeTextFormat> {
        use chrono::format::{Fixed, Item, Numeric, StrftimeItems};
        let Some(format) = format else { return Some(TimeTextFormat::Iso) };
        let items: Vec<Item> = StrftimeItems::new(format).collect();
        if items.iter().any(|i| matches!(i, Item::Error)) {
            return None;
        }
        let has = |wanted: &[Numeric]| items.iter().any(|i| matches!(i, Item::Numeric(n, _) if wanted.contains(n)));
        let whole = has(&[Numeric::Timestamp])
            || items.iter().any(|i| matches!(i, Item::Fixed(Fixed::RFC2822 | Fixed::RFC3339)));
        let zoned = items.iter().any(|i| {
            use Fixed::{RFC2822, RFC3339, TimezoneOffset, TimezoneOffsetColon, TimezoneOffsetColonZ, TimezoneOffsetZ};
            matches!(
                i,
                Item::Fixed(
                    RFC2822 | RFC3339 | TimezoneOffset | TimezoneOffsetColon | TimezoneOffsetColonZ | TimezoneOffsetZ
                )
            )
        });
        let year = has(&[Numeric::Year, Numeric::YearMod100]);
        let timed = has(&[Numeric::Hour, Numeric::Hour12]);
        match (whole || year, whole || timed) {
            (true, true) => Some(TimeTextFormat::Dated(format.to_owned(), zoned)),
            (false, true) => Some(TimeTextFormat::OfDay(format.to_owned())),
            (_, false) => None,
        }
    }

    /// Whether texts of this form hold a date.
    pub fn is_dated(&self) -> bool {
        !matches!(self, TimeTextFormat::OfDay(_))
    }

    /// Whether texts of this form always hold an offset from UTC; in ISO 8601 the offset is optional.
    pub fn is_zoned(&self) -> bool {
        matches!(self, TimeTextFormat::Dated(_, true))
    }

    /// Parses the time in a string. ISO 8601 permits a comma before the fraction of a second; so do all formats here.
    pub fn read(&self, text: &str) -> Option<TimeText> {
        let text = &*with_point(text.trim());
        match self {
            TimeTextFormat::Iso => {
                let zoned = DateTime::parse_from_rfc3339(text).is_ok() || text.ends_with(['Z', 'z']);
                iso(text).map(|instant| TimeText::At { instant, zoned })
            }
            TimeTextFormat::Dated(format, true) => {
                let at = DateTime::parse_from_str(text, format).ok()?.naive_utc();
                Some(TimeText::At { instant: instant(at), zoned: true })
            }
            TimeTextFormat::Dated(format, false) => {
                let at = NaiveDateTime::parse_from_str(text, format).ok()?;
                Some(TimeText::At { instant: instant(at), zoned: false })
            }
            TimeTextFormat::OfDay(format) => {
                NaiveTime::parse_from_str(text, format).ok().map(|t| TimeText::OfDay(of_day(t)))
            }
        }
    }
}

/// Number of digits before the decimal point if a number has this format: 6 for `%H%M%S%.f`. `None` if the format
/// contains anything but digits, optionally followed by a fraction.
pub fn digits_of(format: &str) -> Option<usize> {
    use chrono::format::{Fixed, Item, Numeric, StrftimeItems};
    let (mut digits, mut fraction) = (0, false);
    for item in StrftimeItems::new(format) {
        digits += match item {
            _ if fraction => return None,
            Item::Numeric(Numeric::Year, _) => 4,
            Item::Numeric(Numeric::Ordinal, _) => 3,
            Item::Numeric(
                Numeric::YearMod100 | Numeric::Month | Numeric::Day | Numeric::Hour | Numeric::Minute | Numeric::Second,
                _,
            ) => 2,
            Item::Fixed(Fixed::Nanosecond | Fixed::Nanosecond3 | Fixed::Nanosecond6 | Fixed::Nanosecond9) => {
                fraction = true;
                0
            }
            _ => return None,
        };
    }
    Some(digits)
}

/// A number padded with zeros to this many digits before the decimal point: 641.5 becomes `000641.5`.
pub fn padded(x: f64, digits: usize) -> String {
    let text = schemas::canonical::identifier(x);
    let whole = text.split_once('.').map_or(text.len(), |(whole, _)| whole.len());
    if x < 0.0 { text } else { "0".repeat(digits.saturating_sub(whole)) + &text }
}

/// A text with a point instead of a comma between the seconds and their fraction.
fn with_point(text: &str) -> Cow<'_, str> {
    let bytes = text.as_bytes();
    let digit = |at: usize| bytes.get(at).is_some_and(u8::is_ascii_digit);
    let ends_seconds = |at: &usize| {
        *at >= 3 && bytes[*at] == b',' && bytes[*at - 3] == b':' && digit(*at - 2) && digit(*at - 1) && digit(*at + 1)
    };
    match (0..bytes.len()).find(ends_seconds) {
        Some(at) => Cow::Owned([&text[..at], ".", &text[at + 1..]].concat()),
        None => Cow::Borrowed(text),
    }
}

/// Parses ISO 8601 with a `T` or a space. A time without an offset is not shifted.
fn iso(text: &str) -> Option<UtcInstant> {
    let text = text.trim();
    if let Ok(at) = DateTime::parse_from_rfc3339(text) {
        return Some(instant(at.naive_utc()));
    }
    let bare = text.strip_suffix(['Z', 'z']).unwrap_or(text);
    let forms = ["%Y-%m-%dT%H:%M:%S%.f", "%Y-%m-%d %H:%M:%S%.f", "%Y-%m-%dT%H:%M", "%Y-%m-%d %H:%M"];
    forms.iter().find_map(|f| NaiveDateTime::parse_from_str(bare, f).ok()).map(instant)
}

fn instant(at: NaiveDateTime) -> UtcInstant {
    UtcInstant { day: i64::from(at.date().num_days_from_ce()) - UNIX_DAY, s: of_day(at.time()) }
}

fn of_day(time: NaiveTime) -> f64 {
    f64::from(time.num_seconds_from_midnight()) + f64::from(time.nanosecond()) / 1e9
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn ref_gps_weeks_have_the_dates_of_receivers() {
        // Logs in this repository: log171.bin of ArduPilot (21 Nov 2015, 23:44 UTC) and the Skywalker (29 Nov 2013).
        let at = UtcInstant::of_gps(1871, 603_882.4, None).unwrap();
        assert_eq!(date_text(at.day), "2015-11-21");
        assert!((at.s - (23.0 * 3600.0 + 44.0 * 60.0 + 25.4)).abs() < 1e-6, "{at:?}");
        let at = UtcInstant::of_gps(1768, 511_214.5, None).unwrap();
        assert_eq!((date_text(at.day).as_str(), at.s), ("2013-11-29", 79_198.5));
        // The leap second at the end of 2016, in GPS week 1930: GPS time is 17 s ahead of UTC before it, and 18 s after
        // it.
        let before = UtcInstant::of_gps(1930, 16.0, None).unwrap();
        assert_eq!((date_text(before.day).as_str(), before.s), ("2016-12-31", 86_399.0));
        let after = UtcInstant::of_gps(1930, 18.0, None).unwrap();
        assert_eq!((date_text(after.day).as_str(), after.s), ("2017-01-01", 0.0));
        assert_eq!(UtcInstant::of_gps(0, 0.0, None).unwrap(), UtcInstant { day: GPS_DAY, s: 0.0 });
        assert_eq!(UtcInstant::of_gps(1871, 0.0, Some(0.0)).unwrap().s, 0.0);
        assert!(UtcInstant::of_gps(-1, 0.0, None).is_none() && UtcInstant::of_gps(i64::MAX, 0.0, None).is_none());
    }

    #[test]
    fn ref_every_leap_second_is_at_its_date() {
        let dates = [
            "1981-07-01",
            "1982-07-01",
            "1983-07-01",
            "1985-07-01",
            "1988-01-01",
            "1990-01-01",
            "1991-01-01",
            "1992-07-01",
            "1993-07-01",
            "1994-07-01",
            "1996-01-01",
            "1997-07-01",
            "1999-01-01",
            "2006-01-01",
            "2009-01-01",
            "2012-07-01",
            "2015-07-01",
            "2017-01-01",
        ];
        for (i, date) in dates.iter().enumerate() {
            let (day, leap) = LEAP_S[i + 1];
            assert_eq!((date_text(day).as_str(), leap), (*date, (i + 1) as f64));
        }
    }

    #[test]
    fn law_unix_time_is_exact_to_the_nanosecond_of_a_double() {
        // 2021-04-21T12:00:00.000001Z
        let at = UtcInstant::of_unix_ns(1_619_006_400_000_001_000);
        assert_eq!((date_text(at.day).as_str(), at.s), ("2021-04-21", 43_200.000_001));
        assert_eq!(UtcInstant::of_unix_ns(-1), UtcInstant { day: -1, s: 86_399.999_999_999 });
        assert_eq!(UtcInstant::new(5, -1.0), UtcInstant { day: 4, s: 86_399.0 });
        assert_eq!(UtcInstant::new(5, -1e-20), UtcInstant { day: 5, s: 0.0 });
        assert_eq!(UtcInstant::new(5, 2.0 * DAY_S), UtcInstant { day: 7, s: 0.0 });
    }

    #[test]
    fn ref_zones_and_dates() {
        assert_eq!(read_zone("+10:00"), Some(36_000.0));
        assert_eq!(read_zone("-03:30"), Some(-12_600.0));
        assert_eq!((read_zone("+0545"), read_zone("-5"), read_zone("Z")), (Some(20_700.0), Some(-18_000.0), Some(0.0)));
        for wrong in ["10:00", "+25:00", "+10:75", "", "+", "+a", "+1:2:3", "ü"] {
            assert_eq!(read_zone(wrong), None, "{wrong}");
        }
        assert_eq!(read_date("1970-01-01"), Some(0));
        assert_eq!(year_and_day(read_date("2012-12-31").unwrap()), Some((2012, 366)));
        assert_eq!(read_date("2013-02-29"), None);
    }

    #[test]
    fn ref_text_of_many_forms() {
        let read = |format: Option<&str>, text: &str| TimeTextFormat::new(format).unwrap().read(text);
        let noon = UtcInstant { day: read_date("2021-04-21").unwrap(), s: 43_200.25 };
        for (format, text) in [
            (None, "2021-04-21T12:00:00.25"),
            (None, "2021-04-21 12:00:00.25"),
            (None, "2021-04-21T12:00:00,25"),
            (Some("%d/%m/%Y %H:%M:%S%.f"), "21/04/2021 12:00:00,25"),
            (Some("%d/%m/%Y %H:%M:%S%.f"), "21/04/2021 12:00:00.25"),
            (Some("%y%j %I:%M:%S%.f %p"), "21111 12:00:00.25 PM"),
        ] {
            assert_eq!(read(format, text), Some(TimeText::At { instant: noon, zoned: false }), "{text}");
        }
        assert_eq!(read(None, "2021-04-21T14:00:00.25+02:00"), Some(TimeText::At { instant: noon, zoned: true }));
        assert_eq!(
            read(Some("%Y-%m-%d %H:%M:%S%.f %z"), "2021-04-21 14:00:00.25 +0200"),
            read(None, "2021-04-21T12:00:00.25Z")
        );
        assert_eq!(read(Some("%H:%M:%S%.f"), "00:01:02.5"), Some(TimeText::OfDay(62.5)));
        assert_eq!(read(Some("%H:%M:%S%.f"), "25:01:02.5"), None);
        for (format, x, s) in [
            ("%H%M%S%.f", 641.5, 401.5),
            ("%H%M%S%.f", f64::from(100_059.9_f32), 36_059.9),
            ("%H%M%S", 100_059.0, 36_059.0),
            ("%H%M", 5.0, 300.0),
        ] {
            let text = padded(x, digits_of(format).unwrap());
            assert_eq!(read(Some(format), &text), Some(TimeText::OfDay(s)), "{text}");
        }
        let text = format!("{} {}", padded(50_319.0, 6), padded(101.25, 6));
        let day = read_date("2019-03-05").unwrap();
        let expected = TimeText::At { instant: UtcInstant { day, s: 61.25 }, zoned: false };
        assert_eq!(read(Some("%d%m%y %H%M%S%.f"), &text), Some(expected));
        assert_eq!(
            (digits_of("%Y%m%d"), digits_of("%y%j"), digits_of("%H:%M"), digits_of("%s")),
            (Some(8), Some(5), None, None)
        );
        assert!(TimeTextFormat::new(Some("%Q")).is_none() && TimeTextFormat::new(Some("%Y-%m-%d")).is_none());
    }
}
