#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;

use arrow_array::{Array, cast::AsArray, types::Int64Type};

use super::super::{log_tests::numbers, open_flight, open_raw};
use super::*;

/// The format as described in the help of Oasis montaj.
const EXPORT: &str = "/ ------------------------------------------------------------------------------\n\
    / XYZ EXPORT [06/29/2020]\n/ DATABASE   [.\\survey.gdb]\n\
    / ------------------------------------------------------------------------------\n\
    /\n/      X            Y       UTC_time    MAG_nT   Note\n/========= ============ ========== ========= ======\n\
    //Flight 7\n//Date 2020/06/29\n\
    Line  L1030:2\n   450110.2  4975100.1   43200.00  54321.12      a\n   450111.2  4975101.1   43200.10         \
    *      b\n\
    Tie   T9010\n   450112.2  4975102.1   43300.00  -99999     *\n\
    //Flight 8\n//Date 2020/06/30\nLine  L1040\n   450113.2  4975103.1   10.00  54000.5      a\n";

#[test]
fn ref_an_export_of_oasis_montaj() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("a.xyz");
    fs::write(&path, EXPORT).unwrap();
    let renamed = [("UTC_time", "tt"), ("MAG_nT", "mag_1_uc")].map(|(a, b)| (a.to_owned(), b.to_owned()));
    let options = FlightOptions { rename: renamed.into(), ..FlightOptions::default() };
    let mut reader = open_flight(&path, &options).unwrap();
    assert_eq!(reader.format(), "geosoft_xyz");
    let flight = reader.next().unwrap().unwrap();
    let texts = |name: &str| {
        let column = flight.column_by_name(name).unwrap().as_string::<i32>();
        (0..column.len()).map(|i| column.value(i).to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(texts("line"), ["L1030:2", "L1030:2", "T9010", "L1040"]);
    assert_eq!(texts("flight"), ["7", "7", "7", "8"]);
    assert_eq!(texts("Note"), ["a", "b", "*", "a"]);
    assert_eq!(flight.column_by_name("doy").unwrap().as_primitive::<Int64Type>().values(), &[181, 181, 181, 182]);
    assert_eq!(numbers(&flight, "tt"), [43_200.0, 43_200.1, 43_300.0, 10.0]);
    let mag = numbers(&flight, "mag_1_uc");
    assert!(mag[0] == 54_321.12 && mag[1].is_nan() && mag[2].is_nan() && mag[3] == 54_000.5, "{mag:?}");
}

/// The lines with their numbers of rows, the faults with the lines of their rows, and the notes.
type Lines = (Vec<(String, usize)>, Vec<(String, String)>, Vec<String>);

fn lines_of(text: &str) -> Lines {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("a.xyz");
    fs::write(&path, text).unwrap();
    let mut reader = open_raw(&path, &FlightOptions::default(), &ReadHints::default()).unwrap();
    let part = reader.next_part().unwrap().unwrap();
    let line = part.batch.column_by_name("line").unwrap().as_string::<i32>();
    let mut lines: Vec<(String, usize)> = vec![];
    for name in line.iter().flatten() {
        match lines.last_mut().filter(|(last, _)| last == name) {
            Some((_, n)) => *n += 1,
            None => lines.push((name.to_owned(), 1)),
        }
    }
    let faults = part.faults.iter().map(|f| (line.value(f.row).to_owned(), f.fault.to_string())).collect();
    (lines, faults, reader.notes().to_vec())
}

#[test]
fn ref_a_record_of_every_line_type_begins_a_line() {
    let words = ["Line", "BASE", "tie", "Test", "Trend", "special", "Random"];
    let text: String = words.iter().zip(10..).map(|(word, i)| format!("{word} {i}\n1 2 3\n4 5 *\n")).collect();
    let (lines, faults, notes) = lines_of(&format!("/ x y z\n{text}\x1a"));
    let expected: Vec<(String, usize)> = (10..17).map(|i| (i.to_string(), 2)).collect();
    assert_eq!((lines, faults.len(), notes.len()), (expected, 0, 0), "{faults:?} {notes:?}");
    let (lines, _, notes) = lines_of("/ x y z\nLine 10\n1 2 3\nTie 10\n4 5 6\nLine 20\n7 8 9\n");
    assert_eq!(lines, ["10", "T10", "20"].map(|name| (name.to_owned(), 1)));
    assert!(notes.len() == 1 && notes[0].contains("`Tie 10` is named T10"), "{notes:?}");
}

#[test]
fn unit_an_unknown_record_does_not_damage_the_line_before_it() {
    for first in ["Line 10\n1 2 3\n4 5 6\n", ""] {
        let (lines, faults, notes) = lines_of(&format!("/ x y z\n{first}Foo 1\n1 2 3\n4 5 6\nLine 20\n7 8 9\n"));
        let expected = [("10", 2), ("Foo 1", 2), ("20", 1)].map(|(name, n)| (name.to_owned(), n));
        assert_eq!(lines, expected[usize::from(first.is_empty())..]);
        assert!(faults.len() == 1 && faults[0].0 == "Foo 1", "{faults:?}");
        assert!(faults[0].1.contains("`Foo 1` is not a line record"), "{faults:?}");
        assert!(notes.iter().any(|note| note.contains("`Foo 1` is not a line record")), "{notes:?}");
    }
    // A row with too few values, in a table whose rows begin with words.
    let (lines, faults, _) = lines_of("/ name y z\nLine 10\nab 1 2\ncd 3\nef 4 5\n");
    assert_eq!((lines, faults.len()), (vec![("10".to_owned(), 3)], 1));
    // A word and a number in every row are two columns.
    let (lines, faults, _) = lines_of("/ name z\nLine 10\nab 1\ncd 2\n");
    assert_eq!((lines, faults.len()), (vec![("10".to_owned(), 2)], 0));
}

#[test]
fn unit_faults_are_reported_with_their_line() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("a.xyz");
    fs::write(&path, "//Date 29 June\nLine 10\n1,2,3\n1,2\nL20\n4,5,6").unwrap();
    let mut reader = open_raw(&path, &FlightOptions::default(), &ReadHints::default()).unwrap();
    let reported = reader.notes().join("\n");
    for words in ["column_1, column_2", "the date `29 June` cannot be read", "does not end with a newline"] {
        assert!(reported.contains(words), "{reported}");
    }
    let part = reader.next_part().unwrap().unwrap();
    assert_eq!(numbers(&part.batch, "column_3")[2], 6.0);
    let fault = part.faults[0].fault.to_string();
    assert!(fault.ends_with("row 1: the row has 2 values, but the others have 3 (line 4 of the file)"), "{fault}");
    fs::write(&path, "/ x y\nLine 10\n\x1a").unwrap();
    assert!(open_raw(&path, &FlightOptions::default(), &ReadHints::default()).is_err());
}

#[test]
fn unit_a_text_in_quotes_is_one_word() {
    for (text, expected) in [
        (r#"1.0 "tactical grade" 2"#, vec!["1.0", "tactical grade", "2"]),
        (r#"1.0 "a, b" 2"#, vec!["1.0", "a, b", "2"]),
        (r#"1.0,"a, b",,2"#, vec!["1.0", "a, b", "", "2"]),
        (r#"1.0 "" 2"#, vec!["1.0", "", "2"]),
        (r#"1.0 "x" 2"#, vec!["1.0", "x", "2"]),
        (r#"1.0 5" 2"#, vec!["1.0", "5", "2"]),
    ] {
        assert_eq!(words(text), expected, "{text}");
    }
}
