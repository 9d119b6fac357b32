//! Dates of samples from the columns `year`, `doy` and `tt`.

use arrow_array::{RecordBatch, cast::AsArray, types::Int64Type};
use numerics::earth::dates::{day_number, decimal_year};
use schemas::{Fault, TableShape};

use crate::columns::{data, floats};

/// Returns whether the flight has the columns of a date.
pub fn dated_by_flight(shape: &TableShape) -> bool {
    ["year", "doy"].iter().all(|c| shape.get(c).is_some())
}

/// Decimal year of every sample. NaN for a sample without a date.
///
/// # Errors
/// Fails if the year has no such day. The fault names the row.
pub fn years(batch: &RecordBatch) -> Result<Vec<f64>, Fault> {
    let (year, day, tt) = (whole_numbers(batch, "year")?, whole_numbers(batch, "doy")?, floats(batch, "tt")?);
    let all = year.iter().zip(&day).zip(tt).enumerate();
    all.map(|(row, ((year, day), tt))| match [year, day, tt].iter().all(|x| x.is_finite()) {
        true => one(*year, *day, *tt).map_err(|fault| fault.in_row(row as u64)),
        false => Ok(f64::NAN),
    })
    .collect()
}

/// Decimal year of the line's first sample with both a year and a day.
///
/// # Errors
/// Fails if no sample has both, or the year has no such day. The fault names the row.
pub fn first_year(batch: &RecordBatch) -> Result<f64, Fault> {
    let known = |name: &str| match batch.column_by_name(name) {
        Some(_) => whole_numbers(batch, name).map(Some),
        None => Ok(None),
    };
    let (Some(year), Some(day)) = (known("year")?, known("doy")?) else {
        return Err(no_date("has no `year` and `doy`"));
    };
    let tt = floats(batch, "tt")?;
    let dated = |row: &usize| year[*row].is_finite() && day[*row].is_finite() && tt[*row].is_finite();
    let row = (0..tt.len()).find(dated).ok_or_else(|| no_date("has no sample with both `year` and `doy`"))?;
    one(year[row], day[row], tt[row]).map_err(|fault| fault.in_row(row as u64))
}

/// Remedy for a missing date of a line.
pub const WAYS_OUT_OF_NO_DAY: &str = "add the columns `year` and `doy`, for example with `derive`: \
                                      `columns = { year = \"2020\", doy = \"183\" }`";

/// Seconds of a day.
pub const DAY_S: f64 = 86_400.0;

/// Day number of the midnight from which the line's `tt` counts. It follows from the first sample with a year, a day
/// and a time. `None` without such a sample.
///
/// # Errors
/// Fails if the year has no such day. The fault names the row.
pub fn first_midnight(batch: &RecordBatch) -> Result<Option<i64>, Fault> {
    if batch.column_by_name("year").is_none() || batch.column_by_name("doy").is_none() {
        return Ok(None);
    }
    let (year, doy, tt) = (whole_numbers(batch, "year")?, whole_numbers(batch, "doy")?, floats(batch, "tt")?);
    let row = (0..tt.len()).find(|row| [year[*row], doy[*row], tt[*row]].iter().all(|x| x.is_finite()));
    let Some(row) = row else { return Ok(None) };
    let day = day_number(year[row] as i32, if doy[row] >= 1.0 { doy[row] as u32 } else { 0 });
    let day = day.map_err(|e| data(e).in_column("doy").in_row(row as u64))?;
    // After midnight the date advances and `tt` continues to increase.
    Ok(Some(day - (tt[row] / DAY_S).floor() as i64))
}

/// Offset, in seconds, that converts times of `other` to seconds past the midnight of `first`. 0 if either table has no
/// date.
///
/// # Errors
/// Returns the errors of [`first_midnight`].
pub fn offset_s(first: &RecordBatch, other: &RecordBatch) -> Result<f64, Fault> {
    Ok(match (first_midnight(first)?, first_midnight(other)?) {
        (Some(first), Some(other)) => DAY_S * (other - first) as f64,
        (None, _) | (_, None) => 0.0,
    })
}

/// Date columns that a table has.
pub fn date_columns(shape: &TableShape) -> &'static [&'static str] {
    if dated_by_flight(shape) { &["year", "doy"] } else { &[] }
}

fn no_date(what: &str) -> Fault {
    Fault::data(format!("the core field needs a date, but the line {what}")).help(WAYS_OUT)
}

/// Remedy for a missing date when the core field is needed.
pub const WAYS_OUT: &str = "set `decimal_year`, such as 2020.5; or add the columns `year` and `doy`; or set \
                            `core_field = false` if the measurement is an anomaly";

fn one(year: f64, day: f64, tt: f64) -> Result<f64, Fault> {
    // A missing number becomes day 0, which is invalid.
    let (year, day) = (year as i32, if day >= 1.0 { day as u32 } else { 0 });
    // After midnight the date advances and `tt` continues to increase, so only the time of day is added.
    decimal_year(year, day, tt.rem_euclid(86_400.0)).map_err(|e| data(e).in_column("doy"))
}

/// Whole numbers, stored as integers or floats. NaN for missing ones.
///
/// # Errors
/// Fails if the column is missing or does not hold numbers.
pub fn whole_numbers(batch: &RecordBatch, name: &str) -> Result<Vec<f64>, Fault> {
    let array = batch.column_by_name(name).ok_or_else(|| Fault::data("is missing").in_column(name))?;
    match array.as_primitive_opt::<Int64Type>() {
        Some(whole) => Ok(whole.iter().map(|x| x.map_or(f64::NAN, |x| x as f64)).collect()),
        None => Ok(floats(batch, name)?.to_vec()),
    }
}
