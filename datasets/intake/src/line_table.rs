//! Lines defined by a table of times: `flight`, `line`, `t_start` and `t_end` in seconds past midnight UTC, as in the
//! flight lines of the SGL surveys and the data frames of MagNav.jl.

use std::{collections::BTreeMap, path::Path, sync::Arc};

use arrow_array::{Array, ArrayRef, BooleanArray, RecordBatch, StringArray, cast::AsArray, types::Float64Type};
use arrow_cast::cast;
use arrow_schema::DataType;
use arrow_select::filter::filter_record_batch;
use datasets::{FlightOptions, ReadError, ReadHints, RowFault, open_raw};
use schemas::{Fault, canonical::identifiers, keys::HashKey};

use super::{find_lines, midnight::MidnightUnwrapper};

/// The columns of the table.
const COLUMNS: [&str; 4] = ["flight", "line", "t_start", "t_end"];
/// Maximum number of lines listed by name.
const NAMED: usize = 5;

/// A line and its times; both the first and the last time belong to the line.
#[derive(Clone, Debug, PartialEq)]
struct LineTimes {
    line: String,
    start_s: f64,
    end_s: f64,
}

/// Division of flights into lines, used instead of the lines in the files.
#[derive(Clone, Debug)]
pub enum FlightDivision {
    /// A table of times.
    Table(LineTable),
    /// Detection of lines in each flight.
    Found,
}

impl FlightDivision {
    /// Hash of the division, part of the keys of results that depend on the division.
    pub fn key(&self) -> HashKey {
        match self {
            FlightDivision::Table(table) => table.key(),
            FlightDivision::Found => HashKey::from_parts([find_lines::VERSION]),
        }
    }

    /// The table, if any.
    pub fn table(&self) -> Option<&LineTable> {
        match self {
            FlightDivision::Table(table) => Some(table),
            FlightDivision::Found => None,
        }
    }
}

/// Table of lines: their flights and times.
#[derive(Clone, Debug)]
pub struct LineTable {
    /// The file, for messages.
    pub label: String,
    /// The lines of each flight, in the order of their times.
    spans: BTreeMap<String, Vec<LineTimes>>,
}

impl LineTable {
    /// Reads the table from a file in any flight format.
    ///
    /// # Errors
    /// Fails for a file that cannot be read or lacks one of the four columns, missing or decreasing times, duplicate
    /// lines, or lines of a flight whose times overlap.
    pub fn read(path: &Path) -> Result<LineTable, Fault> {
        let label = path.display().to_string();
        let wrong = |e: ReadError| Fault::from(e);
        let reader = open_raw(path, &FlightOptions::default(), &ReadHints::default()).map_err(wrong)?;
        let mut spans: BTreeMap<String, Vec<LineTimes>> = BTreeMap::new();
        let mut row = 0_u64;
        for batch in reader {
            let batch = batch.map_err(wrong)?;
            let [flight, line] = [0, 1].map(|at| texts(&batch, COLUMNS[at]));
            let [start, end] = [2, 3].map(|at| cast_to(&batch, COLUMNS[at], &DataType::Float64));
            let (flight, line, start, end) = (flight?, line?, start?, end?);
            let (start, end) = (start.as_primitive::<Float64Type>(), end.as_primitive::<Float64Type>());
            for at in 0..batch.num_rows() {
                row += 1;
                let time = |x: &arrow_array::Float64Array| if x.is_null(at) { f64::NAN } else { x.value(at) };
                let span = LineTimes { line: line.value(at).to_owned(), start_s: time(start), end_s: time(end) };
                // Also false if a time is missing.
                let ascends = span.start_s < span.end_s;
                if flight.is_null(at) || line.is_null(at) || !ascends {
                    let what = "a line requires a flight, a name, and a `t_end` after its `t_start`";
                    return Err(Fault::data(what).in_file(&label).in_row(row));
                }
                spans.entry(plain(flight.value(at)).to_owned()).or_default().push(span);
            }
        }
        for (flight, spans) in &mut spans {
            spans.sort_by(|a, b| a.start_s.total_cmp(&b.start_s));
            for pair in spans.windows(2) {
                if pair[1].start_s < pair[0].end_s {
                    let what = format!("the times of lines {} and {} overlap", pair[0].line, pair[1].line);
                    return Err(Fault::data(what).in_file(&label).in_line(flight, &pair[1].line));
                }
            }
            let mut names: Vec<&str> = spans.iter().map(|span| span.line.as_str()).collect();
            names.sort_unstable();
            if let Some(twice) = names.windows(2).find(|pair| pair[0] == pair[1]) {
                return Err(Fault::data("duplicate line").in_file(&label).in_line(flight, twice[0]));
            }
        }
        if spans.is_empty() {
            return Err(Fault::data("contains no lines").in_file(&label));
        }
        Ok(LineTable { label, spans })
    }

    /// Creates the table from the lines of flights: name, first and last time (s past midnight UTC), in the order of
    /// their times.
    pub fn new(label: &str, flights: impl IntoIterator<Item = (String, Vec<(String, f64, f64)>)>) -> LineTable {
        let span = |(line, start_s, end_s): (String, f64, f64)| LineTimes { line, start_s, end_s };
        let spans = flights.into_iter().map(|(flight, lines)| {
            let lines = lines.into_iter().map(span).collect();
            (plain(&flight).to_owned(), lines)
        });
        LineTable { label: label.to_owned(), spans: spans.collect() }
    }

    /// Hash of the table, part of the keys of results that depend on the table.
    pub fn key(&self) -> HashKey {
        let spelt = self.spans.iter().flat_map(|(flight, spans)| {
            spans.iter().map(move |s| format!("{flight}\0{}\0{:?}\0{:?}", s.line, s.start_s, s.end_s))
        });
        HashKey::from_parts(std::iter::once("lines 1".to_owned()).chain(spelt))
    }

    /// Name, first and last time of the lines of a flight.
    pub fn lines_of(&self, flight: &str) -> Vec<(String, f64, f64)> {
        let spans = self.spans.get(plain(flight)).into_iter().flatten();
        spans.map(|span| (span.line.clone(), span.start_s, span.end_s)).collect()
    }

    /// The line at a time.
    fn at(&self, flight: &str, tt_s: f64) -> Option<&str> {
        let spans = self.spans.get(plain(flight))?;
        let after = spans.partition_point(|span| span.end_s < tt_s);
        spans.get(after).filter(|span| span.start_s <= tt_s).map(|span| span.line.as_str())
    }

    /// Creates a divider for the batches of a file, in their order.
    pub fn divider(&self) -> LineDivider<'_> {
        LineDivider { table: self, flight: String::new(), rise: MidnightUnwrapper::default() }
    }

    /// Checks that every line of the table has a sample, for flights with samples.
    ///
    /// # Errors
    /// Fails for lines without a sample.
    pub fn check<'a>(&self, found: impl Iterator<Item = (&'a str, &'a str)>) -> Result<(), Fault> {
        let mut known: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        found.for_each(|(flight, line)| known.entry(plain(flight)).or_default().push(line));
        let mut empty: Vec<String> = vec![];
        for (flight, spans) in &self.spans {
            let Some(lines) = known.get(flight.as_str()) else { continue };
            let without = spans.iter().filter(|span| !lines.contains(&span.line.as_str()));
            empty.extend(without.map(|span| format!("{flight}/{}", span.line)));
        }
        if empty.is_empty() {
            return Ok(());
        }
        let more = if empty.len() > NAMED { format!(" and {} more", empty.len() - NAMED) } else { String::new() };
        let named = empty.iter().take(NAMED).cloned().collect::<Vec<_>>().join(", ");
        let fault = Fault::data(format!("no sample is within the times of {named}{more}")).in_file(&self.label);
        Err(fault.help("the times must be in seconds past midnight UTC, like `tt` of the flights"))
    }

    /// Fault for a file without a sample in any line.
    pub fn none_of(&self, path: &Path) -> Fault {
        let what = format!("no sample is within a line of {}", self.label);
        Fault::data(what).in_file(&path.display().to_string()).help("check the flights and times in the table")
    }
}

/// Divides the batches of a file, in their order. Times continue past midnight, even if the file's times do not.
pub struct LineDivider<'a> {
    table: &'a LineTable,
    flight: String,
    rise: MidnightUnwrapper,
}

impl LineDivider<'_> {
    /// The rows of a batch (`flight`, `line`, `tt` in s) that are within a line of the table, with that line's name in
    /// `line`, and the faults of these rows.
    ///
    /// # Errors
    /// Fails for a batch without these columns, which is an error in the program.
    pub fn divide(&mut self, batch: &RecordBatch, faults: &[RowFault]) -> Result<(RecordBatch, Vec<RowFault>), Fault> {
        let lost = || Fault::bug("a batch of flights lacks a key column");
        let column = |name: &str| batch.column_by_name(name).ok_or_else(lost);
        let flight = column("flight")?.as_string_opt::<i32>().ok_or_else(lost)?;
        let tt = column("tt")?.as_primitive_opt::<Float64Type>().ok_or_else(lost)?;
        let mut within = |row: usize| -> Option<&str> {
            let flight = if flight.is_null(row) { "" } else { flight.value(row) };
            if flight != self.flight {
                (self.flight, self.rise) = (flight.to_owned(), MidnightUnwrapper::default());
            }
            let tt_s = if tt.is_null(row) { f64::NAN } else { tt.value(row) };
            let risen_s = self.rise.next(tt_s);
            self.table.at(flight, risen_s).or_else(|| self.table.at(flight, tt_s))
        };
        let lines: Vec<Option<&str>> = (0..batch.num_rows()).map(&mut within).collect();
        let keep: BooleanArray = lines.iter().map(|line| Some(line.is_some())).collect();
        let lines: StringArray = lines.into_iter().map(|line| Some(line.unwrap_or_default())).collect();
        let at = batch.schema().index_of("line").map_err(|_| lost())?;
        let mut columns = batch.columns().to_vec();
        if let Some(line) = columns.get_mut(at) {
            *line = Arc::new(lines) as ArrayRef;
        }
        let named = RecordBatch::try_new(batch.schema(), columns).map_err(|e| Fault::bug(e.to_string()))?;
        let kept = filter_record_batch(&named, &keep).map_err(|e| Fault::bug(e.to_string()))?;
        let mut places = vec![None; batch.num_rows()];
        let rows = keep.iter().enumerate().filter(|(_, keep)| *keep == Some(true));
        rows.enumerate().for_each(|(place, (row, _))| places[row] = Some(place));
        let moved = |wrong: &RowFault| {
            let row = places.get(wrong.row).copied().flatten()?;
            Some(RowFault { row, fault: wrong.fault.clone() })
        };
        Ok((kept, faults.iter().filter_map(moved).collect()))
    }
}

/// `Flt1003` is flight 1003.
fn plain(flight: &str) -> &str {
    flight.trim_start_matches(':').strip_prefix("Flt").unwrap_or(flight)
}

fn found<'a>(batch: &'a RecordBatch, name: &str) -> Result<&'a ArrayRef, Fault> {
    batch.column_by_name(name).ok_or_else(|| {
        let have: Vec<String> = batch.schema().fields().iter().map(|f| f.name().clone()).collect();
        Fault::new(format!("a table of lines requires a column `{name}`")).nearest(name, &have)
    })
}

fn cast_to(batch: &RecordBatch, name: &str, kind: &DataType) -> Result<ArrayRef, Fault> {
    cast(found(batch, name)?, kind).map_err(|e| Fault::data(e.to_string()).in_column(name))
}

fn texts(batch: &RecordBatch, name: &str) -> Result<StringArray, Fault> {
    let texts = identifiers(found(batch, name)?).map_err(|e| Fault::data(e.to_string()).in_column(name))?;
    Ok(texts.as_string::<i32>().clone())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use arrow_array::Float64Array;

    use super::*;

    fn table(text: &str) -> Result<LineTable, Fault> {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("lines.csv");
        std::fs::write(&path, text).unwrap();
        LineTable::read(&path)
    }

    fn batch() -> RecordBatch {
        let text = |values: [&str; 6]| Arc::new(StringArray::from(values.to_vec())) as ArrayRef;
        RecordBatch::try_from_iter([
            ("flight", text(["1003", "1003", "1003", "1003", "1003", "1004"])),
            ("line", text(["0"; 6])),
            ("tt", Arc::new(Float64Array::from(vec![9.0, 10.0, 20.0, 20.5, 30.0, 10.0])) as ArrayRef),
        ])
        .unwrap()
    }

    #[test]
    fn unit_each_sample_is_in_the_line_of_its_time_or_in_none() {
        let table = table("flight,line,t_start,t_end\nFlt1003,1003.10,20.2,30\nFlt1003,1003.02,10,20\n").unwrap();
        let fault = |row: usize| RowFault { row, fault: ReadError::data(Path::new("x"), "bad") };
        let (kept, faults) = table.divider().divide(&batch(), &[fault(0), fault(3)]).unwrap();
        let lines: Vec<&str> = kept.column_by_name("line").unwrap().as_string::<i32>().iter().flatten().collect();
        assert_eq!(lines, ["1003.02", "1003.02", "1003.10", "1003.10"]);
        assert_eq!(faults.iter().map(|f| f.row).collect::<Vec<_>>(), [2]);
        let found = || [("1003", "1003.02"), ("1003", "1003.10")].into_iter();
        assert!(table.check(found()).is_ok());
        assert!(table.check(found().take(1)).unwrap_err().to_string().contains("1003/1003.10"));
        assert!(table.check([("1004", "1")].into_iter()).is_ok(), "a flight that the table does not have");
    }

    #[test]
    fn unit_lines_continue_past_midnight() {
        let table = table("flight,line,t_start,t_end\n1,late,86398,86402\n").unwrap();
        let rows = |tt: Vec<f64>| {
            let text = |value: &str| Arc::new(StringArray::from(vec![value; 3])) as ArrayRef;
            let tt = Arc::new(Float64Array::from(tt)) as ArrayRef;
            RecordBatch::try_from_iter([("flight", text("1")), ("line", text("0")), ("tt", tt)]).unwrap()
        };
        let mut divider = table.divider();
        let mut kept = |tt: Vec<f64>| divider.divide(&rows(tt), &[]).unwrap().0.num_rows();
        assert_eq!((kept(vec![86_397.0, 86_398.0, 86_399.0]), kept(vec![1.0, 2.0, 3.0])), (2, 2));
        let mut other = table.divider();
        let kept = other.divide(&rows(vec![86_399.0, 86_401.0, 86_403.0]), &[]).unwrap().0;
        assert_eq!(kept.num_rows(), 2, "a log that continues by its own clock");
    }

    #[test]
    fn unit_invalid_tables_are_rejected_with_the_reason() {
        let fault_text = |rows: &str| table(&format!("flight,line,t_start,t_end\n{rows}")).unwrap_err().to_string();
        assert!(fault_text("1,1.01,10,20\n1,1.02,19,30\n").contains("overlap"));
        assert!(fault_text("1,1.01,10,20\n1,1.01,29,30\n").contains("duplicate"));
        assert!(fault_text("1,1.01,20,10\n").contains("`t_end` after"));
        assert!(fault_text("1,1.01,,10\n").contains("`t_end` after"));
        assert!(table("flight,line,start,t_end\n1,1.01,10,20\n").unwrap_err().to_string().contains("`t_start`"));
    }
}
