//! Lines over midnight UTC: time continues past 86,400 s, and the date advances.

use std::sync::Arc;

use arrow_array::{
    ArrayRef, Float64Array, Int64Array, RecordBatch,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use numerics::earth::dates::days_in_year;
use schemas::Fault;

const DAY_S: f64 = 86_400.0;

/// A backward step of the time leads to the next day only if it begins and ends within this distance of midnight, in
/// seconds. Any other backward step of a time stamp is an error of the log.
const NEAR_S: f64 = 3_600.0;

/// Line of the flight table across midnight, with `tt` increasing past 86,400 s. The columns `year` and `doy` hold the
/// day of each sample, even if the log did not advance the date. `None` if the line needs no change.
///
/// # Errors
/// Fails for a date that differs from the date of the first sample plus the number of midnights since then.
pub fn unwrapped(batch: &RecordBatch) -> Result<Option<RecordBatch>, Fault> {
    let Some(raw) = batch.column_by_name("tt").and_then(|c| c.as_primitive_opt::<Float64Type>()) else {
        return Ok(None);
    };
    let tt = risen(raw.values());
    let days = days(&tt);
    if days.iter().all(|d| *d == 0) {
        return Ok(None);
    }
    let mut columns = batch.columns().to_vec();
    let mut put = |name: &str, array: ArrayRef| {
        if let Ok(at) = batch.schema().index_of(name) {
            columns[at] = array;
        }
    };
    put("tt", Arc::new(Float64Array::from(tt)));
    let (year, doy) = (numbers(batch, "year"), numbers(batch, "doy"));
    if let Some(doy) = doy {
        let (years, doys) = moved_on(year.as_deref(), &doy, &days)?;
        put("doy", like(batch, "doy", doys));
        if year.is_some() {
            put("year", like(batch, "year", years));
        }
    }
    RecordBatch::try_new(batch.schema(), columns).map(Some).map_err(|e| Fault::data(e.to_string()))
}

/// The time with a day added at each midnight.
fn risen(tt: &[f64]) -> Vec<f64> {
    let mut rise = MidnightUnwrapper::default();
    tt.iter().map(|t| rise.next(*t)).collect()
}

/// Unwrapper of time at midnight, sample by sample, in seconds.
#[derive(Clone, Copy, Debug)]
pub(super) struct MidnightUnwrapper {
    before: f64,
    add: f64,
}

impl Default for MidnightUnwrapper {
    fn default() -> MidnightUnwrapper {
        MidnightUnwrapper { before: f64::NAN, add: 0.0 }
    }
}

impl MidnightUnwrapper {
    /// The time of the next sample, in seconds past the midnight before the first sample.
    pub(super) fn next(&mut self, t: f64) -> f64 {
        let ends = (DAY_S - NEAR_S..DAY_S + NEAR_S).contains(&self.before);
        if ends && (0.0..NEAR_S).contains(&t) {
            self.add += DAY_S;
        }
        if t.is_finite() {
            self.before = t;
        }
        t + self.add
    }
}

/// Number of midnights since the first sample.
fn days(tt: &[f64]) -> Vec<i64> {
    let day = |t: f64| (t / DAY_S).floor();
    let first = tt.iter().find(|t| t.is_finite()).map_or(0.0, |t| day(*t));
    tt.iter().map(|t| if t.is_finite() { (day(*t) - first) as i64 } else { 0 }).collect()
}

/// Year and day of each sample. A log may advance its date late, early or not at all. A missing date remains missing.
fn moved_on(year: Option<&[f64]>, doy: &[f64], days: &[i64]) -> Result<(Vec<f64>, Vec<f64>), Fault> {
    let year_of = |i: usize| year.and_then(|y| y.get(i)).copied();
    let known = |i: usize| doy[i].is_finite() && year_of(i).is_none_or(f64::is_finite);
    let Some(first) = (0..doy.len()).find(|i| known(*i)) else {
        return Ok((year.map(<[f64]>::to_vec).unwrap_or_default(), doy.to_vec()));
    };
    let start = (year_of(first), doy[first]);
    let (mut years, mut doys) = (vec![], vec![]);
    for i in 0..doy.len() {
        let own = (year_of(i), doy[i]);
        let steps = days[i] - days[first];
        let due = after(start, steps);
        let near = [-1, 0, 1].iter().any(|late| after(start, steps + late) == own);
        if known(i) && !near {
            let what =
                format!("the date is day {}, but counting from the start of the line gives day {}", own.1, due.1);
            return Err(Fault::data(what).in_column("doy").in_row(i as u64));
        }
        let (year, doy) = if known(i) { due } else { own };
        years.extend(year);
        doys.push(doy);
    }
    Ok((years, doys))
}

/// Date `days` later, or earlier if negative. Without a year, the year has 365 days.
fn after((mut year, mut doy): (Option<f64>, f64), days: i64) -> (Option<f64>, f64) {
    let length = |year: Option<f64>| year.map_or(365.0, |y| f64::from(days_in_year(y as i32)));
    doy += days as f64;
    while doy > length(year) && days > 0 {
        doy -= length(year);
        year = year.map(|y| y + 1.0);
    }
    while doy < 1.0 && days < 0 {
        year = year.map(|y| y - 1.0);
        doy += length(year);
    }
    (year, doy)
}

/// Values of a column of any numeric type; a missing value is NaN.
fn numbers(batch: &RecordBatch, name: &str) -> Option<Vec<f64>> {
    let column = batch.column_by_name(name)?;
    if let Some(whole) = column.as_primitive_opt::<Int64Type>() {
        return Some(whole.iter().map(|x| x.map_or(f64::NAN, |x| x as f64)).collect());
    }
    column.as_primitive_opt::<Float64Type>().map(|x| x.iter().map(|x| x.unwrap_or(f64::NAN)).collect())
}

/// The numbers as an array of the type of the column `name`.
fn like(batch: &RecordBatch, name: &str, numbers: Vec<f64>) -> ArrayRef {
    let whole = batch.column_by_name(name).is_some_and(|c| c.as_primitive_opt::<Int64Type>().is_some());
    if whole {
        let one = |x: &f64| x.is_finite().then_some(*x as i64);
        return Arc::new(numbers.iter().map(one).collect::<Int64Array>());
    }
    Arc::new(Float64Array::from(numbers))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

    use arrow_schema::{DataType, Field, Schema};
    use schemas::canonical::check_time;

    use super::*;

    fn line(tt: &[f64], year: &[i64], doy: &[i64]) -> RecordBatch {
        let fields = [("tt", DataType::Float64), ("year", DataType::Int64), ("doy", DataType::Int64)];
        let fields = fields.map(|(name, t)| Field::new(name, t, true)).to_vec();
        let columns: Vec<ArrayRef> = vec![
            Arc::new(Float64Array::from(tt.to_vec())),
            Arc::new(Int64Array::from(year.to_vec())),
            Arc::new(Int64Array::from(doy.to_vec())),
        ];
        RecordBatch::try_new(Arc::new(Schema::new(fields)), columns).unwrap()
    }

    fn time_columns(batch: &RecordBatch) -> [Vec<f64>; 3] {
        ["tt", "year", "doy"].map(|name| numbers(batch, name).unwrap())
    }

    const OVER: [f64; 4] = [86_399.8, 86_399.9, 0.0, 0.1];

    #[test]
    fn unit_midnight_is_unwrapped_and_the_date_advances() {
        // The log keeps its date, or advances it at midnight, late, or early.
        for doy in [[100, 100, 100, 100], [100, 100, 101, 101], [100, 100, 100, 101], [100, 101, 101, 101]] {
            let [tt, year, doy] = time_columns(&unwrapped(&line(&OVER, &[2023; 4], &doy)).unwrap().unwrap());
            assert!(check_time(&tt).is_ok() && (tt[3] - 86_400.1).abs() < 1e-9, "{tt:?}");
            assert_eq!((year, doy), (vec![2023.0; 4], vec![100.0, 100.0, 101.0, 101.0]));
        }
    }

    #[test]
    fn unit_the_year_ends_after_365_or_366_days() {
        for (year, last) in [(2023, 365), (2024, 366)] {
            let moved = [
                line(&OVER, &[year; 4], &[last; 4]),
                line(&OVER, &[year, year, year + 1, year + 1], &[last, last, 1, 1]),
            ];
            for batch in moved {
                let [_, years, doys] = time_columns(&unwrapped(&batch).unwrap().unwrap());
                let year = year as f64;
                assert_eq!(years, [year, year, year + 1.0, year + 1.0]);
                assert_eq!(doys, [last as f64, last as f64, 1.0, 1.0]);
            }
        }
    }

    #[test]
    fn unit_only_midnight_is_unwrapped() {
        for tt in [[10.0, 11.0, 9.0, 12.0], [50_000.0, 50_001.0, 0.0, 1.0], [86_399.0, 86_400.0, 40_000.0, 40_001.0]] {
            assert_eq!(risen(&tt), tt);
        }
        assert!(unwrapped(&line(&[1.0, 2.0, 3.0, 4.0], &[2023; 4], &[7; 4])).unwrap().is_none());
        let odd = unwrapped(&line(&OVER, &[2023; 4], &[100, 100, 150, 150])).unwrap_err();
        assert_eq!(
            odd.to_string(),
            "column `doy`, row 2: the date is day 150, but counting from the start of the line gives day 101"
        );
    }
}
