//! Assembles the rows of a file into lines. A faulty row affects only its line.

use arrow_array::{Array, RecordBatch, StringArray, cast::AsArray};
use datasets::{FlightOptions, RowFault};
use schemas::Fault;

/// The identifier that is shown for rows without an identifier.
pub const MISSING: &str = "(missing)";

/// A line with all its rows, or rows that belong to no line. If the rows belong to no line, `parts` is empty.
pub struct LineBatches {
    /// Flight.
    pub flight: String,
    /// Name; [`MISSING`] if the rows have none.
    pub line: String,
    /// Rows, in the order of the file.
    pub parts: Vec<RecordBatch>,
    /// The number of rows.
    pub rows: usize,
    /// First fault; the row is counted within the line.
    pub fault: Option<Fault>,
}

/// Rows without an identifier, whose line is not known yet.
struct IdentifierGap {
    flight: String,
    line: String,
    rows: usize,
    /// Index of the first of these rows in the file, from 0.
    row: u64,
}

/// Lines of one file during assembly.
pub struct LineAssembly<'a> {
    options: &'a FlightOptions,
    open: Option<LineBatches>,
    gap: Option<IdentifierGap>,
    gaps: Vec<IdentifierGap>,
    /// Number of rows of the file so far.
    row: u64,
}

impl<'a> LineAssembly<'a> {
    /// Creates an assembly without lines, for a file that is read with these options.
    pub fn new(options: &'a FlightOptions) -> LineAssembly<'a> {
        LineAssembly { options, open: None, gap: None, gaps: vec![], row: 0 }
    }

    /// Adds rows of the flight table; returns the lines that are now complete.
    pub fn add(&mut self, batch: &RecordBatch, faults: &[RowFault]) -> Vec<LineBatches> {
        let (flights, lines) = (batch.column(0).as_string::<i32>(), batch.column(1).as_string::<i32>());
        let mut done = vec![];
        let mut start = 0;
        for end in 1..=batch.num_rows() {
            let is_continued = end < batch.num_rows()
                && text(flights, end) == text(flights, start)
                && text(lines, end) == text(lines, start);
            if is_continued {
                continue;
            }
            let key = (text(flights, start), text(lines, start));
            if self.options.is_missing(key.0) || self.options.is_missing(key.1) {
                self.add_gap(key, self.row + start as u64, end - start);
            } else {
                let wrong = faults.iter().find(|f| (start..end).contains(&f.row));
                done.extend(self.add_run(key, batch.slice(start, end - start), wrong.map(|f| (f.row - start, f))));
            }
            start = end;
        }
        self.row += batch.num_rows() as u64;
        done
    }

    fn add_gap(&mut self, (flight, line): (&str, &str), row: u64, rows: usize) {
        match &mut self.gap {
            Some(gap) => gap.rows += rows,
            none => *none = Some(IdentifierGap { flight: flight.to_owned(), line: line.to_owned(), rows, row }),
        }
    }

    fn add_run(
        &mut self,
        (flight, line): (&str, &str),
        part: RecordBatch,
        wrong: Option<(usize, &RowFault)>,
    ) -> Option<LineBatches> {
        let gap = self.gap.take();
        let mut done = None;
        let same = self.open.as_ref().is_some_and(|w| w.flight == flight && w.line == line);
        if !same {
            self.gaps.extend(gap);
            let (flight, line) = (flight.to_owned(), line.to_owned());
            done = self.open.replace(LineBatches { flight, line, parts: vec![], rows: 0, fault: None });
        } else if let (Some(open), Some(gap)) = (&mut self.open, gap) {
            // The rows without an identifier lie between rows of this line, so the line is incomplete without them.
            let row = open.rows as u64;
            let fault = gap_fault(self.options, &gap).in_row(row);
            open.fault.get_or_insert(fault);
        }
        if let Some(open) = &mut self.open {
            if let Some((row, wrong)) = wrong {
                let mut fault = Fault::from(wrong.fault.clone());
                fault.place.row = Some((open.rows + row) as u64);
                open.fault.get_or_insert(fault);
            }
            open.rows += part.num_rows();
            open.parts.push(part);
        }
        done
    }

    /// The remaining lines at the end of the file.
    pub fn finish(mut self) -> Vec<LineBatches> {
        let mut done: Vec<LineBatches> = self.open.take().into_iter().collect();
        self.gaps.extend(self.gap.take());
        let mut unnamed: Vec<LineBatches> = vec![];
        for gap in &self.gaps {
            let name = |text: &str| if self.options.is_missing(text) { MISSING } else { text }.to_owned();
            let (flight, line) = (name(&gap.flight), name(&gap.line));
            match unnamed.iter_mut().find(|w| w.flight == flight && w.line == line) {
                Some(known) => known.rows += gap.rows,
                None => {
                    let fault = Some(gap_fault(self.options, gap).in_row(gap.row));
                    unnamed.push(LineBatches { flight, line, parts: vec![], rows: gap.rows, fault });
                }
            }
        }
        for whole in &mut unnamed {
            if let Some(fault) = &mut whole.fault {
                let rows = if whole.rows == 1 { "a row".to_owned() } else { format!("{} rows", whole.rows) };
                fault.what = format!("the identifier is missing in {rows} of the file; this is the first of them");
            }
        }
        done.extend(unnamed);
        done
    }
}

fn gap_fault(options: &FlightOptions, gap: &IdentifierGap) -> Fault {
    let column = if options.is_missing(&gap.flight) { "flight" } else { "line" };
    Fault::data("the identifier is missing")
        .in_column(column)
        .help("set flight and line in every row, or remove rows without these identifiers")
}

fn text(column: &StringArray, row: usize) -> &str {
    if column.is_null(row) { "" } else { column.value(row) }
}
