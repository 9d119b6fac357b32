//! Calendar dates as decimal years, the time scale of core-field models.

use thiserror::Error;

const SECONDS_PER_DAY: f64 = 86_400.0;

/// Error of an invalid date.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum DateError {
    /// The year does not have this day of the year.
    #[error("day {day_of_year} of the year {year} does not exist; the range is 1 to {days}")]
    DayOfYear {
        /// The year.
        year: i32,
        /// The requested day.
        day_of_year: u32,
        /// Number of days of the year.
        days: u32,
    },
    /// The month, or the day in the month, does not exist.
    #[error("{year}-{month:02}-{day:02} is not a date")]
    Calendar {
        /// The year.
        year: i32,
        /// The requested month.
        month: u32,
        /// The requested day of the month.
        day: u32,
    },
    /// The seconds are not a number.
    #[error("the seconds of the day must be a finite number, but are {0}")]
    Seconds(f64),
}

/// True for a leap year of the Gregorian calendar.
pub fn is_leap_year(year: i32) -> bool {
    year % 4 == 0 && (year % 100 != 0 || year % 400 == 0)
}

/// The number of days of a year, 365 or 366.
pub fn days_in_year(year: i32) -> u32 {
    if is_leap_year(year) { 366 } else { 365 }
}

/// Decimal year of the day `day_of_year` (1 is 1 January) and `seconds` past midnight UTC of that day. Noon of 1
/// January 2023 is 2023 + 0.5/365. Seconds may exceed a day, as in a flight over midnight.
///
/// # Errors
/// Fails with [`DateError::DayOfYear`] for a day that the year does not have, or with [`DateError::Seconds`] for
/// seconds that are not finite.
pub fn decimal_year(year: i32, day_of_year: u32, seconds: f64) -> Result<f64, DateError> {
    let days = days_in_year(year);
    if !(1..=days).contains(&day_of_year) {
        return Err(DateError::DayOfYear { year, day_of_year, days });
    }
    if !seconds.is_finite() {
        return Err(DateError::Seconds(seconds));
    }
    let elapsed_days = f64::from(day_of_year - 1) + seconds / SECONDS_PER_DAY;
    Ok(f64::from(year) + elapsed_days / f64::from(days))
}

/// The day of the year, from 1, of a calendar date (month and day from 1).
///
/// # Errors
/// Fails with [`DateError::Calendar`] for a date that does not exist.
pub fn day_of_year(year: i32, month: u32, day: u32) -> Result<u32, DateError> {
    let mut lengths = [31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    lengths[1] += u32::from(is_leap_year(year));
    let before = usize::try_from(month).unwrap_or(0).wrapping_sub(1);
    match lengths.get(before) {
        Some(length) if (1..=*length).contains(&day) => Ok(lengths.iter().take(before).sum::<u32>() + day),
        _ => Err(DateError::Calendar { year, month, day }),
    }
}

/// Continuous day number in the Gregorian calendar: 1 on 1 January of the year 1.
///
/// # Errors
/// Fails with [`DateError::DayOfYear`] for a day that the year does not have.
pub fn day_number(year: i32, day_of_year: u32) -> Result<i64, DateError> {
    let days = days_in_year(year);
    if !(1..=days).contains(&day_of_year) {
        return Err(DateError::DayOfYear { year, day_of_year, days });
    }
    let before = i64::from(year) - 1;
    let leap_days = before.div_euclid(4) - before.div_euclid(100) + before.div_euclid(400);
    Ok(365 * before + leap_days + i64::from(day_of_year))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn law_leap_years_are_gregorian() {
        let leap: Vec<i32> =
            [1900, 1996, 2000, 2020, 2023, 2100, 2400].into_iter().filter(|year| is_leap_year(*year)).collect();
        assert_eq!(leap, [1996, 2000, 2020, 2400]);
    }

    #[test]
    fn law_decimal_years_are_continuous() {
        assert_eq!(decimal_year(2020, 1, 0.0).unwrap(), 2020.0);
        assert_eq!(decimal_year(2020, 184, 0.0).unwrap(), 2020.5);
        let last_second = decimal_year(2023, 365, 86_399.0).unwrap();
        // The difference is one second as a fraction of a year; decimal years of this magnitude have a resolution of
        // 7e-6 s.
        assert!((2024.0 - last_second - 1.0 / (365.0 * 86_400.0)).abs() < 1e-12);
        assert_eq!(decimal_year(2023, 365, 86_400.0).unwrap(), 2024.0);
    }

    #[test]
    fn law_days_are_numbered_without_gaps() {
        assert_eq!(day_number(1, 1).unwrap(), 1);
        for year in -5..2105 {
            assert_eq!(day_number(year + 1, 1).unwrap(), day_number(year, days_in_year(year)).unwrap() + 1, "{year}");
        }
        // Python's `date(1970, 1, 1).toordinal()` and `date(2020, 12, 31).toordinal()`.
        assert_eq!((day_number(1970, 1).unwrap(), day_number(2020, 366).unwrap()), (719_163, 737_790));
        assert!(day_number(2021, 366).is_err() && day_number(2021, 0).is_err());
    }

    #[test]
    fn law_day_of_year_counts_the_leap_day() {
        assert_eq!(day_of_year(2020, 12, 31).unwrap(), 366);
        assert_eq!(day_of_year(2023, 3, 1).unwrap(), 60);
        assert_eq!(day_of_year(2024, 3, 1).unwrap(), 61);
    }

    #[test]
    fn unit_invalid_dates_are_rejected() {
        assert_eq!(
            decimal_year(2023, 366, 0.0).unwrap_err().to_string(),
            "day 366 of the year 2023 does not exist; the range is 1 to 365"
        );
        assert!(decimal_year(2023, 0, 0.0).is_err());
        assert!(decimal_year(2023, 1, f64::NAN).is_err());
        assert_eq!(day_of_year(2023, 2, 29).unwrap_err().to_string(), "2023-02-29 is not a date");
        assert!(day_of_year(2023, 0, 1).is_err() && day_of_year(2023, 13, 1).is_err());
    }
}
