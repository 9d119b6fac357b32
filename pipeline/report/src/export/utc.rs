//! Time stamps in UTC, from the date and the seconds past midnight of the flight table.

use std::sync::Arc;

use arrow_array::{
    Array, ArrayRef, Float64Array, RecordBatch, RecordBatchOptions, StringArray, TimestampMicrosecondArray,
    cast::AsArray, types::Float64Type,
};
use arrow_cast::cast;
use arrow_schema::{DataType, Schema};
use numerics::earth::dates::day_number;
use schemas::{Fault, Role, field};

/// Name of the column.
pub(super) const UTC: &str = "utc";
/// Day number of 1970-01-01.
const UNIX_DAY: i64 = 719_163;
const DAY_S: f64 = 86_400.0;

/// Adds a column `utc` to the rows of a table, batch by batch.
///
/// The time of a line counts from one midnight, which follows from the first row with a date. The time continues past
/// 86,400 s on the next day.
#[derive(Default)]
pub(super) struct UtcColumn {
    last: Option<LastRow>,
}

/// The row before the current row, possibly in the previous batch.
struct LastRow {
    /// Flight and line.
    keys: [String; 2],
    /// Time, in seconds.
    tt: f64,
    /// Midnight from which the time counts, in seconds since 1970; NaN if unknown.
    midnight: f64,
}

impl UtcColumn {
    /// The batch with the column `utc` after `tt`. The batch is unchanged if it lacks `tt`, `year` or `doy`, or already
    /// has a column `utc`.
    ///
    /// # Errors
    /// Fails for a day that its year does not have.
    pub(super) fn add(&mut self, batch: &RecordBatch) -> Result<RecordBatch, Fault> {
        let schema = batch.schema();
        let numbers = ["tt", "year", "doy"].map(|name| numbers(batch, name));
        let ([Some(tt), Some(year), Some(doy)], Err(_)) = (numbers, schema.index_of(UTC)) else {
            return Ok(batch.clone());
        };
        let keys = ["flight", "line"].map(|name| texts(batch, name));
        let mut times = Vec::with_capacity(tt.len());
        for row in 0..tt.len() {
            let [flight, line] = keys.each_ref().map(|key| key.as_ref().map_or("", |key| key.value(row)));
            let midnight = self.midnight([flight, line], (tt.value(row), year.value(row), doy.value(row)))?;
            let utc = tt.value(row) + midnight;
            times.push(utc.is_finite().then(|| (tt.value(row) * 1e6).round() as i64 + (midnight as i64) * 1_000_000));
        }
        let at = schema.index_of("tt").map_or(0, |at| at + 1);
        let times: ArrayRef = Arc::new(TimestampMicrosecondArray::from(times).with_timezone("UTC"));
        let about = "time of the sample, UTC, from `year`, `doy` and `tt`";
        let named = field(UTC, times.data_type().clone(), "", Role::Time, about);
        let (mut fields, mut columns) = (schema.fields().to_vec(), batch.columns().to_vec());
        fields.insert(at, Arc::new(named));
        columns.insert(at, times);
        let options = RecordBatchOptions::new().with_row_count(Some(batch.num_rows()));
        let schema = Arc::new(Schema::new(fields));
        RecordBatch::try_new_with_options(schema, columns, &options).map_err(|e| Fault::bug(e.to_string()))
    }

    /// Midnight from which the time of a row counts, in seconds since 1970; NaN if unknown.
    fn midnight(&mut self, keys: [&str; 2], (tt, year, doy): (f64, f64, f64)) -> Result<f64, Fault> {
        let same = self.last.as_ref().filter(|last| last.keys == keys && tt >= last.tt);
        let known = same.map(|last| last.midnight).filter(|midnight| midnight.is_finite());
        let midnight = match known {
            Some(midnight) => midnight,
            None if [tt, year, doy].iter().all(|x| x.is_finite()) => {
                let day = day_number(year as i32, doy.max(0.0) as u32);
                let day = day.map_err(|e| Fault::data(e.to_string()).in_column("doy"))?;
                (day - UNIX_DAY) as f64 * DAY_S - (tt / DAY_S).floor() * DAY_S
            }
            None => f64::NAN,
        };
        let tt = if tt.is_finite() { tt } else { same.map_or(f64::NEG_INFINITY, |last| last.tt) };
        self.last = Some(LastRow { keys: keys.map(str::to_owned), tt, midnight });
        Ok(midnight)
    }
}

/// Strings of a key column.
fn texts(batch: &RecordBatch, name: &str) -> Option<StringArray> {
    let texts = cast(batch.column_by_name(name)?, &DataType::Utf8).ok()?;
    texts.as_string_opt::<i32>().cloned()
}

/// Values of a column of numbers; a missing value is NaN.
fn numbers(batch: &RecordBatch, name: &str) -> Option<Float64Array> {
    let column = batch.column_by_name(name).filter(|column| column.data_type().is_numeric())?;
    let numbers = cast(column, &DataType::Float64).ok()?;
    Some(numbers.as_primitive::<Float64Type>().iter().map(|x| Some(x.unwrap_or(f64::NAN))).collect())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use arrow_array::{Int64Array, types::TimestampMicrosecondType};

    use super::*;

    fn times(rows: &[(&str, f64, i64, i64)]) -> Vec<Option<i64>> {
        let texts: StringArray = rows.iter().map(|row| Some(row.0)).collect();
        let tt: Float64Array = rows.iter().map(|row| Some(row.1)).collect();
        let [year, doy] = [|r: &(&str, f64, i64, i64)| r.2, |r: &(&str, f64, i64, i64)| r.3]
            .map(|of| Int64Array::from_iter_values(rows.iter().map(of)));
        let columns: [(&str, ArrayRef); 4] =
            [("line", Arc::new(texts)), ("tt", Arc::new(tt)), ("year", Arc::new(year)), ("doy", Arc::new(doy))];
        let whole = RecordBatch::try_from_iter(columns).unwrap();
        // The state of a line continues in the next batch.
        let mut utc = UtcColumn::default();
        let half = rows.len() / 2;
        let parts = [whole.slice(0, half), whole.slice(half, rows.len() - half)];
        let made: Vec<RecordBatch> = parts.iter().map(|part| utc.add(part).unwrap()).collect();
        assert_eq!(made[0].schema().field(2).name(), UTC);
        let of = |batch: &RecordBatch| batch.column(2).as_primitive::<TimestampMicrosecondType>().iter().collect();
        made.iter().flat_map(|batch| -> Vec<Option<i64>> { of(batch) }).collect()
    }

    #[test]
    fn ref_time_stamps_are_those_of_the_calendar() {
        // `date -u -d '2024-02-29 12:00:00.25' +%s%N`, and the next day.
        let second = 1_000_000;
        assert_eq!(
            times(&[("1", 43_200.25, 2024, 60), ("1", 43_200.5, 2024, 60)])[0],
            Some(1_709_208_000 * second + 250_000)
        );
        assert_eq!(times(&[("1", 0.0, 1970, 1), ("1", 1.0, 1970, 1)]), [Some(0), Some(second)]);
        let midnight =
            [("1", 86_399.0, 2024, 366), ("1", 86_401.0, 2025, 1), ("2", 1.0, 2025, 1), ("2", f64::NAN, 2025, 1)];
        let [a, b, c, d] = times(&midnight).try_into().unwrap();
        assert_eq!((b, c, d), (a.map(|a| a + 2 * second), b, None));
        // Case: the date does not advance at midnight.
        let constant = times(&[("1", 86_399.0, 2024, 366), ("1", 86_401.0, 2024, 366)]);
        assert_eq!(constant[1], constant[0].map(|a| a + 2 * second));
    }
}
