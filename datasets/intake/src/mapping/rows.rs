//! The rows of a file as rows of the flight table.

use std::{
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
};

use arrow_array::{Array, ArrayRef, BooleanArray, Float64Array, RecordBatch, StringArray};
use arrow_select::filter::filter_record_batch;
use datasets::{FlightBatch, FlightReader, ReadError, RowFault};
use schemas::Fault;

use super::{
    Mapping,
    bind::{MappingBinding, key_texts, whole},
    clock::{UtcInstant, year_and_day},
    time::{RowTimes, TimeParseError},
};

/// Treatment of rows that repeat the time of the previous row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RepeatedRows {
    /// The rows keep this time.
    Keep,
    /// The rows are dropped.
    Drop,
    /// The rows follow the first row of that time at this rate, in Hz.
    AtRate(f64),
}

/// Reader of a file through a table of a mapping.
pub struct MappingReader {
    reader: FlightReader,
    bound: MappingBinding,
    mapping: Arc<Mapping>,
    path: PathBuf,
    repeated_rows: RepeatedRows,
    /// Number of rows of the file before the next batch.
    row: u64,
    /// The current line, and the day of its first sample.
    line: Option<(String, String)>,
    day: i64,
    /// The last time of the line, and the number of rows that repeat it.
    last_tt: (f64, u32),
    /// Faults of dropped rows, reported at the next kept row.
    waiting: Vec<ReadError>,
    /// Number of rows that repeat the time of the previous row and are dropped or moved.
    repeated: Arc<Mutex<u64>>,
    done: bool,
}

impl MappingReader {
    /// Creates a reader at the start of a file.
    pub fn new(
        reader: FlightReader,
        bound: MappingBinding,
        mapping: Arc<Mapping>,
        path: PathBuf,
        repeated_rows: RepeatedRows,
    ) -> MappingReader {
        MappingReader {
            reader,
            bound,
            mapping,
            path,
            repeated_rows,
            row: 0,
            line: None,
            day: 0,
            last_tt: (f64::NAN, 0),
            waiting: vec![],
            repeated: Arc::default(),
            done: false,
        }
    }

    /// Number of rows so far that repeat the time of the previous row, if they are dropped or moved.
    pub fn repeated(&self) -> Arc<Mutex<u64>> {
        self.repeated.clone()
    }

    fn mapped(&mut self, part: FlightBatch) -> Result<Option<FlightBatch>, ReadError> {
        let FlightBatch { batch, faults } = part;
        let first = self.row;
        self.row += batch.num_rows() as u64;
        let in_data = |f: Fault| self.mapping.in_data(&self.path, f);
        let mask = self.bound.kept(&batch).map_err(in_data)?;
        let (batch, rows) = match mask {
            None => (batch, None),
            Some(mask) => {
                let rows: Vec<usize> = mask.iter().enumerate().filter(|(_, k)| **k).map(|(row, _)| row).collect();
                let kept = filter_record_batch(&batch, &BooleanArray::from(mask));
                (kept.map_err(|e| ReadError::data(&self.path, e.to_string()))?, Some(rows))
            }
        };
        let mut faults = self.placed(faults, rows.as_deref(), batch.num_rows());
        if batch.num_rows() == 0 {
            return Ok(None);
        }
        let file_row = |row: usize| first + rows.as_ref().and_then(|r| r.get(row).copied()).unwrap_or(row) as u64;
        let in_data = |f: Fault| self.mapping.in_data(&self.path, f);
        let (times, wrong) = self.bound.time.read(&batch).map_err(in_data)?;
        let no_time = |w: TimeParseError| {
            let fault =
                ReadError::data(&self.path, format!("`{}` is not a time in the format that the mapping gives", w.text));
            RowFault { row: w.row, fault: fault.in_row(file_row(w.row)) }
        };
        faults.extend(wrong.into_iter().map(no_time));
        faults.sort_by_key(|f| f.row);
        let flights = key_texts(&self.bound.keys[0], &batch).map_err(in_data)?;
        let lines = key_texts(&self.bound.keys[1], &batch).map_err(in_data)?;
        let others = self.bound.columns(&batch).map_err(in_data)?;
        let (tt, dates, repeated) = self.times(&times, &flights, &lines);
        let mut columns: Vec<ArrayRef> = vec![Arc::new(flights), Arc::new(lines), Arc::new(Float64Array::from(tt))];
        if let Some((years, days)) = dates {
            columns.extend([whole(years), whole(days)]);
        }
        columns.extend(others);
        let mapped = RecordBatch::try_new(self.bound.schema.clone(), columns);
        let mut mapped = mapped.map_err(|e| ReadError::data(&self.path, e.to_string()))?;
        if repeated.iter().any(|r| *r) {
            let rows: Vec<usize> = repeated.iter().enumerate().filter(|(_, r)| !**r).map(|(row, _)| row).collect();
            let keep: BooleanArray = repeated.iter().map(|r| Some(!r)).collect();
            mapped = filter_record_batch(&mapped, &keep).map_err(|e| ReadError::data(&self.path, e.to_string()))?;
            *self.repeated.lock().unwrap_or_else(PoisonError::into_inner) += (repeated.len() - rows.len()) as u64;
            faults = self.placed(faults, Some(&rows), mapped.num_rows());
        }
        Ok((mapped.num_rows() > 0).then_some(FlightBatch { batch: mapped, faults }))
    }

    /// Moves faults to kept rows: a fault of a dropped row is reported at the next kept row.
    fn placed(&mut self, faults: Vec<RowFault>, rows: Option<&[usize]>, left: usize) -> Vec<RowFault> {
        let mut placed: Vec<RowFault> = vec![];
        if left > 0 {
            placed.extend(self.waiting.drain(..).map(|fault| RowFault { row: 0, fault }));
        }
        for RowFault { row, fault } in faults {
            let at = rows.map_or(row, |rows| rows.partition_point(|r| *r < row));
            if at < left { placed.push(RowFault { row: at, fault }) } else { self.waiting.push(fault) }
        }
        placed
    }

    /// The time of each sample in seconds past the midnight before the first sample of its line, the date of each
    /// sample, and the rows that are dropped because they repeat the time of the previous row.
    fn times(
        &mut self,
        times: &RowTimes,
        flights: &StringArray,
        lines: &StringArray,
    ) -> (Vec<f64>, DateColumns, Vec<bool>) {
        let text = |keys: &StringArray, row: usize| if keys.is_null(row) { "" } else { keys.value(row) }.to_owned();
        let mut tt = vec![];
        let (mut repeated, mut moved) = (vec![], 0);
        let (mut years, mut days) = (vec![], vec![]);
        // Cached, because consecutive samples share a day.
        let mut date: (i64, Option<(i64, i64)>) = (i64::MIN, None);
        for row in 0..flights.len() {
            let same = self.line.as_ref().is_some_and(|(flight, line)| {
                !flights.is_null(row) && !lines.is_null(row) && flights.value(row) == flight && lines.value(row) == line
            });
            let at: Option<UtcInstant> = match times {
                RowTimes::Undated(_) => None,
                RowTimes::Dated(all) => all.get(row).copied().flatten(),
            };
            if !same {
                self.line = Some((text(flights, row), text(lines, row)));
                self.last_tt = (f64::NAN, 0);
                self.day = at.map_or(i64::MIN, |i| i.day);
            } else if self.day == i64::MIN {
                self.day = at.map_or(i64::MIN, |i| i.day);
            }
            let time = match times {
                RowTimes::Undated(all) => all.get(row).copied().unwrap_or(f64::NAN),
                RowTimes::Dated(_) => at.map_or(f64::NAN, |i| i.seconds_since(self.day)),
            };
            let repeats = time == self.last_tt.0;
            repeated.push(self.repeated_rows == RepeatedRows::Drop && repeats);
            if repeats {
                self.last_tt.1 += 1;
            } else if time.is_finite() {
                self.last_tt = (time, 0);
            }
            match self.repeated_rows {
                RepeatedRows::AtRate(rate_hz) if repeats => {
                    moved += 1;
                    tt.push(time + f64::from(self.last_tt.1) / rate_hz);
                }
                RepeatedRows::AtRate(_) | RepeatedRows::Keep | RepeatedRows::Drop => tt.push(time),
            }
            if let RowTimes::Dated(_) = times {
                if let Some(i) = at.filter(|i| i.day != date.0) {
                    date = (i.day, year_and_day(i.day));
                }
                let known = at.and(date.1);
                years.push(known.map(|d| d.0));
                days.push(known.map(|d| d.1));
            }
        }
        *self.repeated.lock().unwrap_or_else(PoisonError::into_inner) += moved;
        let dates = matches!(times, RowTimes::Dated(_)).then_some((years, days));
        (tt, dates, repeated)
    }
}

/// Years and days of the year.
type DateColumns = Option<(Vec<Option<i64>>, Vec<Option<i64>>)>;

impl Iterator for MappingReader {
    type Item = Result<FlightBatch, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.done {
            let Some(part) = self.reader.next_part() else {
                self.done = true;
                // Faults after the last kept row.
                return self.waiting.drain(..).next().map(Err);
            };
            match part.and_then(|part| self.mapped(part)) {
                Ok(None) => {}
                Ok(Some(part)) => return Some(Ok(part)),
                Err(e) => {
                    self.done = true;
                    return Some(Err(e));
                }
            }
        }
        None
    }
}
