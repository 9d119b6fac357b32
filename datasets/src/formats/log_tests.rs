//! Comparison of binary logs with the results of other readers (`reference/logs.py`), and tests of damaged logs.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use arrow_array::{
    Array, ArrayRef, RecordBatch,
    cast::AsArray,
    types::{Float64Type, Int64Type},
};
use arrow_schema::DataType;
use arrow_select::concat::concat_batches;

use super::{FlightOptions, ReadHints, open_raw, topics};
use crate::{ReadError, samples};

pub(super) fn reference(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("reference/logs").join(name)
}

pub(super) fn log(name: &str) -> PathBuf {
    samples::path("logs").join(name)
}

pub(super) fn topic(name: &str) -> FlightOptions {
    FlightOptions { topic: Some(name.to_owned()), ..FlightOptions::default() }
}

/// All rows of a topic.
pub(super) fn read(path: &Path, options: &FlightOptions) -> Result<RecordBatch, ReadError> {
    let reader = open_raw(path, options, &ReadHints::default())?;
    let schema = reader.schema().clone();
    let batches = reader.collect::<Result<Vec<_>, _>>()?;
    assert!(batches.iter().all(|b| b.schema() == schema), "every batch has the reader's schema");
    Ok(concat_batches(&schema, &batches).unwrap())
}

pub(super) fn notes(path: &Path, options: &FlightOptions) -> Vec<String> {
    open_raw(path, options, &ReadHints::default()).unwrap().notes().to_vec()
}

pub(super) fn numbers(batch: &RecordBatch, name: &str) -> Vec<f64> {
    batch
        .column_by_name(name)
        .unwrap_or_else(|| panic!("no column {name}"))
        .as_primitive::<Float64Type>()
        .values()
        .to_vec()
}

fn unquoted(text: &str) -> String {
    let bytes = text.as_bytes();
    let (mut out, mut at) = (vec![], 0);
    while at < bytes.len() {
        if bytes[at] == b'%' {
            out.push(u8::from_str_radix(&text[at + 1..at + 3], 16).unwrap());
            at += 3;
        } else {
            out.push(bytes[at]);
            at += 1;
        }
    }
    String::from_utf8(out).unwrap()
}

/// Whether a value equals the printed one.
fn is(column: &ArrayRef, row: usize, printed: &str) -> bool {
    match (column.data_type(), printed.strip_prefix('"')) {
        (DataType::Utf8, Some(text)) => column.as_string::<i32>().value(row) == unquoted(text),
        (DataType::Int64, Some(text)) => column.as_primitive::<Int64Type>().value(row).to_string() == text,
        (DataType::Float64, None) => {
            let (ours, theirs) = (column.as_primitive::<Float64Type>().value(row), printed.parse::<f64>().unwrap());
            // The values are printed with all digits, so they must be equal bit by bit.
            ours.to_bits() == theirs.to_bits() || (ours.is_nan() && theirs.is_nan())
        }
        _ => false,
    }
}

/// Compares a file with its reference: the same topics, columns and rows, the same values of every 500th row and the
/// last, and the same sum.
fn agrees(path: &Path) {
    let name = path.file_name().unwrap().to_str().unwrap();
    let text = fs::read_to_string(reference(&format!("{name}.tsv"))).unwrap();
    let listed = topics(path, &FlightOptions::default()).unwrap();
    let mut wanted: BTreeMap<String, Vec<Vec<String>>> = BTreeMap::new();
    for line in text.lines().filter(|l| !l.starts_with("unit\t")) {
        let words: Vec<String> = line.split('\t').map(str::to_owned).collect();
        let topic = unquoted(&words[0]);
        let long = format!("{topic}:{}", words[1]);
        let topic = if listed.iter().any(|t| t.name == long) { long } else { topic };
        wanted.entry(topic).or_default().push(words);
    }
    let known: BTreeSet<&str> = listed.iter().map(|t| t.name.as_str()).collect();
    assert_eq!(known, wanted.keys().map(String::as_str).collect(), "{name}");
    for found in &listed {
        let batch = read(path, &topic(&found.name)).unwrap();
        let columns: BTreeSet<&str> = found.columns.iter().map(|c| c.name.as_str()).collect();
        let of = &wanted[&found.name];
        let names: Vec<String> = of.iter().map(|w| unquoted(&w[2])).collect();
        assert_eq!(columns, names.iter().map(String::as_str).collect(), "{name} {}", found.name);
        for (words, column) in of.iter().zip(&names) {
            let at = format!("{name} {} {column}", found.name);
            let rows: usize = words[1].parse().unwrap();
            assert_eq!((batch.num_rows(), found.rows), (rows, rows as u64), "{at}");
            let values = batch.column_by_name(column).unwrap();
            let mut picked: BTreeSet<usize> = (0..rows).step_by(500).collect();
            picked.insert(rows - 1);
            assert_eq!(picked.len(), words.len() - 4, "{at}");
            for (row, printed) in picked.into_iter().zip(&words[4..]) {
                assert!(is(values, row, printed), "{at} row {row}: {printed}");
            }
            if values.data_type() == &DataType::Float64 {
                // In the order of the rows, like the sum of the other reader.
                let sum = values
                    .as_primitive::<Float64Type>()
                    .values()
                    .iter()
                    .filter(|x| x.is_finite())
                    .fold(0.0, |a, b| a + b);
                assert_eq!(sum.to_bits(), words[3].parse::<f64>().unwrap().to_bits(), "{at} sum");
            }
        }
    }
}

#[test]
fn ref_pyulog_reads_the_same() {
    for path in [log("sample_log_small.ulg"), log("sample_cut.ulg"), reference("made.ulg")] {
        agrees(&path);
    }
}

#[test]
fn ref_pymavlink_reads_the_same() {
    let by_definition = [reference("ardupilot_4.bin"), reference("ardupilot_3.bin")];
    for path in [log("log171_cut.bin"), reference("made.bin")].into_iter().chain(by_definition) {
        agrees(&path);
    }
}

#[test]
fn ref_scipy_reads_the_same() {
    for path in [log("TestLog2_cut.mat"), log("thor_flight75_cut.mat"), reference("made.mat")] {
        agrees(&path);
    }
    for name in ["big_endian", "testdouble_6.1_SOL2", "testdouble_7.1_GLNX86", "testmatrix_6.1_SOL2"] {
        agrees(&log(&format!("matlab/{name}.mat")));
    }
    for name in ["testmatrix_7.4_GLNX86", "teststructnest_6.1_SOL2", "teststructnest_7.1_GLNX86"] {
        agrees(&log(&format!("matlab/{name}.mat")));
    }
}

#[test]
fn ref_h5py_reads_the_same() {
    agrees(&reference("made_v73.mat"));
    // Written by MATLAB 7.4, in the layout of data of HDF5 before 1.6.3.
    agrees(&log("matlab/testhdf5_7.4_GLNX86.mat"));
}

#[test]
fn ref_pymavlink_gives_the_same_units() {
    let path = reference("made.bin");
    let text = fs::read_to_string(reference("made.bin.tsv")).unwrap();
    let listed = topics(&path, &FlightOptions::default()).unwrap();
    let mut seen = 0;
    for words in text.lines().filter_map(|l| l.strip_prefix("unit\t")) {
        let words: Vec<String> = words.split('\t').map(unquoted).collect();
        let theirs = match words[2].as_str() {
            "µs" => "us",
            "mGauss" => "mgauss",
            "deglatitude" => "deg",
            "instance" => "",
            other => other,
        };
        for topic in listed.iter().filter(|t| t.name.split(':').next() == Some(words[0].as_str())) {
            let column = topic.columns.iter().find(|c| c.name == words[1]).unwrap();
            assert_eq!(column.unit, theirs, "{words:?}");
            seen += 1;
        }
    }
    assert_eq!(seen, 6 + 3 * 6 + 2 * 3);
}

/// Pseudo-random numbers, the same on every machine. [Marsaglia 2003, xorshift64]
struct Random(u64);

impl Random {
    fn next(&mut self, below: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % below.max(1) as u64) as usize
    }
}

/// Bytes that are changed, removed or duplicated, or truncated at the end.
fn damaged(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..=random.next(6) {
        let at = random.next(bytes.len());
        match random.next(6) {
            0 => bytes[at] ^= 1 << random.next(8),
            1 => bytes[at] = [0, 0xff, 0x7f, 0x80, 0xa3, b'D'][random.next(6)],
            2 => {
                bytes.drain(at..(at + random.next(40)).min(bytes.len()));
            }
            3 => {
                let copied = bytes[at..(at + random.next(200)).min(bytes.len())].to_vec();
                let to = random.next(bytes.len());
                bytes.splice(to..to, copied);
            }
            4 => {
                let end = (at + 8).min(bytes.len());
                bytes[at..end].fill(0xff);
            }
            _ => bytes.truncate(at.max(1)),
        }
        if bytes.is_empty() {
            bytes.push(0);
        }
    }
    bytes
}

/// Reads all topics of a damaged file. Each topic is read or causes an error. Returns the number of topics read.
fn survives(path: &Path, format: &str, bytes: &[u8]) -> usize {
    fs::write(path, bytes).unwrap();
    let of =
        |name: Option<String>| FlightOptions { format: Some(format.into()), topic: name, ..FlightOptions::default() };
    let _ = open_raw(path, &of(None), &ReadHints::default()).map(|r| r.take(3).count());
    let Ok(listed) = topics(path, &of(None)) else { return 0 };
    let mut whole = 0;
    for found in listed.iter().take(6) {
        let Ok(mut reader) = open_raw(path, &of(Some(found.name.clone())), &ReadHints::default()) else { continue };
        let mut rows = 0;
        while let Some(Ok(part)) = reader.next_part() {
            rows += part.batch.num_rows() as u64;
        }
        // The row counts of MATLAB topics come from their shapes, others from a scan.
        assert!(format == "mat" || rows == found.rows, "{format} {}: {rows} of {} rows", found.name, found.rows);
        whole += 1;
    }
    whole
}

#[test]
fn unit_damaged_logs_are_read_or_rejected() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("damaged");
    let cut = |path: PathBuf, n: usize| fs::read(path).unwrap().into_iter().take(n).collect::<Vec<u8>>();
    let files = [
        ("ulog", cut(reference("made.ulg"), 3000)),
        ("ulog", cut(log("sample_cut.ulg"), 40_000)),
        ("dataflash", cut(reference("made.bin"), 6000)),
        ("dataflash", cut(log("log171_cut.bin"), 12_000)),
        ("mat", fs::read(log("matlab/big_endian.mat")).unwrap()),
        ("mat", fs::read(log("matlab/teststructnest_7.1_GLNX86.mat")).unwrap()),
        ("mat", fs::read(log("matlab/testdouble_6.1_SOL2.mat")).unwrap()),
        ("mat", fs::read(log("matlab/teststructnest_6.1_SOL2.mat")).unwrap()),
        ("mat", fs::read(reference("made_v73.mat")).unwrap()),
        ("mat", fs::read(log("thor_flight75_cut.mat")).unwrap()),
    ];
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    for (format, bytes) in files {
        assert!(survives(&path, format, &bytes) > 0, "{format}: the undamaged file reads");
        let read: usize = (0..400).map(|_| survives(&path, format, &damaged(&bytes, &mut random))).sum();
        assert!(read > 0, "{format}: some damaged files still read");
    }
}
