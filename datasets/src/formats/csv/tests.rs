//! Comparison of the reader with a slow and simple reader, for files with every irregularity and blocks of any size.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;

use arrow_array::{Array, cast::AsArray, types::Float64Type, types::Int64Type};
use arrow_select::concat::concat_batches;
use tempfile::TempDir;

use super::*;

/// Result of reading a file: the notes, one text for each cell, the faults of single rows, and the end.
#[derive(Debug, PartialEq, Default)]
struct CsvReadResult {
    notes: Vec<String>,
    rows: Vec<Vec<String>>,
    faults: Vec<(usize, String)>,
    error: Option<String>,
}

fn bits(x: f64) -> String {
    // A NaN of any bits is a missing value.
    if x.is_nan() { "missing".to_owned() } else { format!("{:x}", x.to_bits()) }
}

fn read_result(path: &Path, options: &FlightOptions, block: usize, threads: usize) -> CsvReadResult {
    let reading = ReadHints { found: None, threads };
    let raw = match open_in(path, options, &reading, block) {
        Ok(raw) => raw,
        Err(error) => return CsvReadResult { error: Some(error.to_string()), ..CsvReadResult::default() },
    };
    let again = ReadHints { found: raw.found.clone(), threads: 1 };
    let again = open_in(path, options, &again, block).unwrap();
    assert_eq!((&again.notes, &again.schema, &again.found), (&raw.notes, &raw.schema, &raw.found), "what was found");
    let mut result = CsvReadResult { notes: raw.notes, ..CsvReadResult::default() };
    let mut batches = vec![];
    for part in raw.parts {
        match part {
            Ok(part) => {
                let before = result.rows.len();
                result.faults.extend(part.faults.iter().map(|f| (before + f.row, f.fault.to_string())));
                result.rows.resize(before + part.batch.num_rows(), vec![]);
                batches.push(part.batch);
            }
            Err(error) => {
                result.error = Some(error.to_string());
                // The number of rows before the error depends on the blocks.
                (result.rows, result.faults) = (vec![], vec![]);
                return result;
            }
        }
    }
    let all = concat_batches(&raw.schema, &batches).unwrap();
    for (row, cells) in result.rows.iter_mut().enumerate() {
        for column in all.columns() {
            cells.push(match column.data_type() {
                arrow_schema::DataType::Float64 => bits(column.as_primitive::<Float64Type>().value(row)),
                arrow_schema::DataType::Int64 if column.is_null(row) => "missing".to_owned(),
                arrow_schema::DataType::Int64 => column.as_primitive::<Int64Type>().value(row).to_string(),
                _ => column.as_string::<i32>().value(row).to_owned(),
            });
        }
    }
    result
}

/// The result of a simple reader: all records by the `csv` crate, all numbers by `str::parse`.
fn plainly(path: &Path, options: &FlightOptions) -> CsvReadResult {
    let bytes = fs::read(path).unwrap();
    let names = header(path).unwrap();
    let missing = MissingMarkers::from_options(options);
    let mut records = vec![];
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).flexible(true).from_reader(bytes.as_slice());
    for record in reader.byte_records() {
        let record = record.unwrap();
        // The position is the end of the record before; empty lines and the rest of a line end may follow it.
        let at = record.position().unwrap().byte() as usize;
        let blank = bytes[at..].iter().take_while(|b| matches!(b, b'\n' | b'\r')).count();
        let line = 1 + bytes[..at + blank].iter().filter(|b| **b == b'\n').count();
        records.push((record, line));
    }
    let last_at = records.last().and_then(|(r, _)| r.position()).map(csv::Position::byte);
    let header_again =
        |r: &csv::ByteRecord| r.len() == names.len() && r.iter().zip(&names).all(|(c, n)| c == n.as_bytes());
    let mut result = CsvReadResult::default();
    let repeated: Vec<usize> = records.iter().filter(|(r, _)| header_again(r)).map(|(_, line)| *line).collect();
    let ends = matches!(bytes.last(), Some(b'\n' | b'\r'));
    let last = records.last().filter(|(r, _)| !ends && !header_again(r)).cloned();
    records.retain(|(r, _)| !header_again(r));
    let text = |cell: &[u8]| std::str::from_utf8(cell).ok().map(str::to_owned);
    let number = |cell: &[u8]| text(cell).and_then(|t| missing.number(&t));
    let whole: Vec<&csv::ByteRecord> = records.iter().map(|r| &r.0).filter(|r| r.len() == names.len()).collect();
    let kinds: Vec<CsvColumnKind> = (0..names.len())
        .map(|i| {
            let words = whole.iter().any(|r| number(&r[i]).is_none());
            settled_kind(&names[i], options).unwrap_or(if words { CsvColumnKind::Text } else { CsvColumnKind::Number })
        })
        .collect();
    if !repeated.is_empty() {
        let n = repeated.len();
        let rows = if n == 1 { "a row repeats".to_owned() } else { format!("{n} rows repeat") };
        let note =
            format!("{}: {rows} the header (first in line {} of the file); skipped", path.display(), repeated[0]);
        result.notes.push(note);
    }
    if let Some((cut, line)) = last.filter(|(r, _)| r.len() == names.len()) {
        let value = String::from_utf8_lossy(&cut[names.len() - 1]).into_owned();
        let others = &whole[..whole.len() - 1];
        let numeric = matches!(kinds.last().unwrap(), CsvColumnKind::Number | CsvColumnKind::Whole);
        let short = numeric
            && !others.is_empty()
            && others.iter().all(|r| r[names.len() - 1].len() > cut[names.len() - 1].len());
        let start = format!("{}: the file does not end with a newline, so it may be cut short", path.display());
        let column = names.last().unwrap();
        if short {
            records.pop();
            result.notes.push(format!(
                "{start}; the last value `{value}` of `{column}` (line {line} of the file) is shorter than all others \
                 of its column, and its row is skipped"
            ));
        } else {
            result
                .notes
                .push(format!("{start} inside the last value `{value}` of `{column}` (line {line} of the file)"));
        }
    }
    let mut keys = vec![String::new(); names.len()];
    for (row, (record, line)) in records.iter().enumerate() {
        let mut cells = vec![];
        let mut wrong = None;
        for (i, kind) in kinds.iter().enumerate() {
            let cell = (record.len() == names.len()).then(|| &record[i]);
            let (value, right) = match kind {
                CsvColumnKind::Number => {
                    let number = cell.and_then(number);
                    (bits(number.unwrap_or(f64::NAN)), number.is_some())
                }
                CsvColumnKind::Whole => {
                    let whole = cell.and_then(text).and_then(|t| missing.whole(&t));
                    (whole.flatten().map_or("missing".to_owned(), |x| x.to_string()), whole.is_some())
                }
                CsvColumnKind::Key if cell.is_none() => (keys[i].clone(), true),
                CsvColumnKind::Text | CsvColumnKind::Key => {
                    let text = cell.and_then(text);
                    (text.clone().unwrap_or_default(), text.is_some())
                }
            };
            if *kind == CsvColumnKind::Key {
                keys[i].clone_from(&value);
            }
            if !right && wrong.is_none() {
                wrong = Some(i);
            }
            cells.push(value);
        }
        result.rows.push(cells);
        let fault_text = |what: String| format!("{}, row {row}: {what}", path.display());
        if record.len() != names.len() {
            let cut = if !ends && record.position().map(csv::Position::byte) == last_at {
                " is cut short: the file ends there without a newline"
            } else {
                ""
            };
            let counts = format!("the row has {} values, but the header has {}", record.len(), names.len());
            result.faults.push((row, fault_text(format!("{counts} (line {line} of the file{cut})"))));
            continue;
        }
        let Some(column) = wrong else { continue };
        let numeric = |i: &usize| matches!(kinds[*i], CsvColumnKind::Number | CsvColumnKind::Whole);
        let word =
            |i: &usize| text(&record[*i]).is_some_and(|t| !missing::is_usual_word(&t) && missing.number(&t).is_none());
        let (numbers, words) = ((0..names.len()).filter(numeric), (0..names.len()).filter(numeric).filter(word));
        if words.clone().count() > 1 && words.count() == numbers.count() {
            let what = "the row looks like another header: the file contains several tables, one after another";
            let error = fault_text(format!("{what} (line {line} of the file; put each table into a separate file)"));
            return CsvReadResult { notes: result.notes, error: Some(error), ..CsvReadResult::default() };
        }
        let place = format!("{}, column `{}`, row {row}", path.display(), names[column]);
        let at = format!("line {line} of the file");
        result.faults.push((
            row,
            match text(&record[column]) {
                Some(t) if kinds[column] == CsvColumnKind::Whole && missing.number(&t).is_some() => {
                    format!("{place}: `{t}` is not a whole number ({at})")
                }
                Some(t) => {
                    format!(
                        "{place}: `{t}` is not a number ({at}; if the text marks a missing value, add it to `missing`)"
                    )
                }
                None => {
                    format!("{place}: is not UTF-8 text: {} ({at})", std::str::from_utf8(&record[column]).unwrap_err())
                }
            },
        ));
    }
    result
}

/// Pseudo-random numbers.
struct Draw(u64);

impl Draw {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % n
    }

    fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())]
    }
}

const COLUMNS: [&str; 9] = ["flight", "line", "tt", "mag_1_uc", "year", "event", "extra", "note", "Temp 1"];

const CELLS: [&[u8]; 44] = [
    b"",
    b" ",
    b"0",
    b"-0",
    b"1",
    b"-22.25",
    b"48123.4567",
    b"0.1",
    b"0.30000000000000004",
    b"9007199254740993",
    b"1e22",
    b"1E-23",
    b"5e-324",
    b"1.7976931348623157e308",
    b"1e999",
    b"12345678901234567890.5",
    b"  7.5",
    b"7.5  ",
    b"\t3\t",
    b"+4",
    b".5",
    b"5.",
    b"NaN",
    b"inf",
    b"N/A",
    b"-99999",
    b"-1e32",
    b"*",
    b"dropout",
    b"-7777",
    b"high",
    b"1-2",
    b"1.2.3",
    b"2020",
    b"2020.5",
    b"\"1.5\"",
    b"\"a,b\"",
    b"\"two\nlines\"",
    b"\"say \"\"x\"\"\"",
    b"\"1\"5",
    b"4\"",
    b" \"6\"",
    b"\xff\xfe",
    b"\xc3\x9cbung",
];

/// A random file of some columns and rows, with oddities.
fn drawn(draw: &mut Draw) -> Vec<u8> {
    let ends: &[u8] = draw.of(&[b"\n".as_slice(), b"\n", b"\r\n", b"\r"]);
    let from = draw.below(3);
    let names = &COLUMNS[from..from + 1 + draw.below(COLUMNS.len() - from)];
    let header = names.join(if draw.below(4) == 0 { " , " } else { "," });
    let mut text = if draw.below(4) == 0 { b"\xef\xbb\xbf".to_vec() } else { vec![] };
    (0..draw.below(3) / 2).for_each(|_| text.extend_from_slice(ends));
    text.extend_from_slice(header.as_bytes());
    text.extend_from_slice(ends);
    let odd = draw.below(4) * 6;
    for _ in 0..draw.below(9) {
        match draw.below(100) {
            n if n < odd / 4 => text.extend_from_slice(names.join(",").as_bytes()),
            n if n < odd / 2 => {}
            n if n < odd / 2 + 1 => {
                text.extend_from_slice(names.iter().rev().copied().collect::<Vec<_>>().join(",").as_bytes())
            }
            n => {
                let ragged = n < odd;
                let width = if ragged { 1 + draw.below(names.len() + 2) } else { names.len() };
                for i in 0..width {
                    if i > 0 {
                        text.push(b',');
                    }
                    let plain = draw.below(24) > odd;
                    let cell: &[u8] = if plain { draw.of(&CELLS[2..8]) } else { draw.of(&CELLS) };
                    text.extend_from_slice(cell);
                }
            }
        }
        text.extend_from_slice(ends);
    }
    match draw.below(6) {
        0 => text.truncate(text.len() - ends.len()),
        1 => text.extend_from_slice(b"1.5,\"open"),
        _ => {}
    }
    text
}

#[test]
fn unit_the_reader_agrees_with_a_simple_one_for_any_block_size() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("f.csv");
    let given = FlightOptions { missing: vec!["dropout".into(), "-7777".into()], ..FlightOptions::default() };
    let mut draw = Draw(1);
    let (mut faults, mut errors, mut notes) = (0, 0, 0);
    for k in 0..1500 {
        let text = drawn(&mut draw);
        // A new file each time: some file systems write an overwritten one to the disk at once.
        let _ = fs::remove_file(&path);
        fs::write(&path, &text).unwrap();
        let options = if k % 2 == 0 { FlightOptions::default() } else { given.clone() };
        let plain = plainly(&path, &options);
        (faults, errors, notes) =
            (faults + plain.faults.len(), errors + usize::from(plain.error.is_some()), notes + plain.notes.len());
        for (block, threads) in [(1, 1), (1, 3), (2, 1), (3, 2), (7, 1), (16, 2), (33, 3), (64, 1), (1 << 20, 2)] {
            let ours = read_result(&path, &options, block, threads);
            assert_eq!(ours, plain, "{k}, block {block}: {:?}", String::from_utf8_lossy(&text));
        }
    }
    assert!(faults > 500 && errors > 5 && notes > 100, "{faults} {errors} {notes}: too tame");
}

#[test]
fn unit_every_number_is_bit_identical_to_the_standard_librarys() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("f.csv");
    let mut draw = Draw(5);
    let mut words = vec![];
    for i in 0..20_000 {
        let x = f64::from_bits((draw.below(1 << 31) as u64) << 33 ^ (draw.below(1 << 31) as u64) << 9);
        let y = (draw.below(1 << 31) as f64 - 1e9) / 10f64.powi(draw.below(12) as i32);
        words.push(match i % 3 {
            0 => format!("{x:e}"),
            1 => format!("{y}"),
            _ => format!("{y:.*}", draw.below(12)),
        });
    }
    fs::write(&path, format!("a,tt\n{}\n", words.iter().map(|w| format!("{w},{w}")).collect::<Vec<_>>().join("\n")))
        .unwrap();
    let ours = read_result(&path, &FlightOptions::default(), 1 << 12, 2);
    assert_eq!((ours.faults.len(), ours.rows.len()), (0, words.len()));
    for (cells, word) in ours.rows.iter().zip(&words) {
        let x = bits(word.parse().unwrap());
        assert_eq!(*cells, [x.clone(), x], "{word}");
    }
}

#[test]
fn unit_a_stored_scan_is_read_back_and_a_damaged_one_is_ignored() {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("f.csv");
    fs::write(&path, "flight,line,tt,a,b\n1,1,0.5,1,x\nflight,line,tt,a,b\n1,1,0.5,1,2").unwrap();
    let options = FlightOptions::default();
    let first = open_in(&path, &options, &ReadHints::default(), BLOCK).unwrap();
    let found = first.found.unwrap();
    assert_eq!(CsvScan::parse(&found, 5).map(|s| s.spelt()), Some(found.clone()));
    assert_eq!(CsvScan::parse(&found, 4), None);
    for cut in 0..found.len() {
        if let Some(scan) = CsvScan::parse(&found[..cut], 5) {
            // The truncation may shorten the last value; the pipeline's records protect it.
            assert!(found.starts_with(&scan.spelt()) && scan.kinds.len() == 5, "{cut}");
        }
    }
    // A damaged or foreign text is ignored.
    for text in ["", "csv 1", "csv 2\nkknnt\n1 3\n", "csv 1\nkkn\n0 0\n", "csv 1\nkkxnt\n0 0\n", "csv 1\nkknnt\nx y\n"]
    {
        let reading = ReadHints { found: Some(text.to_owned()), threads: 1 };
        let again = open_in(&path, &options, &reading, BLOCK).unwrap();
        assert_eq!((again.schema, again.notes), (first.schema.clone(), first.notes.clone()), "{text}");
    }
}
