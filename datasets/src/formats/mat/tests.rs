#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;

use super::super::{
    log_tests::{log, notes, numbers, read, reference, topic},
    open_flight, topics,
};
use crate::FlightOptions;

#[test]
fn user_a_labelled_matrix_becomes_a_flight() {
    let path = log("TestLog2_cut.mat");
    let renamed = [("TimeMS", "tt"), ("MagX", "flux_a_x")];
    let options = FlightOptions {
        rename: renamed.map(|(a, b)| (a.to_owned(), b.to_owned())).into(),
        units: [("TimeMS", "ms"), ("MagX", "mgauss")].map(|(a, b)| (a.to_owned(), b.to_owned())).into(),
        flight: Some("2".into()),
        line: Some("1".into()),
        ..topic("MAG")
    };
    let mut reader = open_flight(&path, &options).unwrap();
    let canonical = schemas::canonical::FlightConversion::new(reader.schema()).unwrap();
    let flight = canonical.apply(&reader.next().unwrap().unwrap()).unwrap();
    let (raw, nt) = (numbers(&read(&path, &topic("MAG")).unwrap(), "MagX"), numbers(&flight, "flux_a_x"));
    assert_eq!((raw.len(), raw[0], nt[0]), (6129, -195.0, -19_500.0));
    assert_eq!(numbers(&flight, "tt")[0], 13.244);
}

#[test]
fn unit_vectors_of_another_length_are_a_separate_topic() {
    let listed = |path: std::path::PathBuf| {
        let all = topics(&path, &FlightOptions::default()).unwrap();
        all.into_iter().map(|t| (t.name, t.rows, t.columns.len())).collect::<Vec<_>>()
    };
    let of = |all: &[(&str, u64, usize)]| all.iter().map(|(n, r, c)| ((*n).to_owned(), *r, *c)).collect::<Vec<_>>();
    let thor = of(&[("flight_data", 1500, 13), ("flight_data:64", 64, 3), ("flight_info", 1, 4)]);
    assert_eq!(listed(log("thor_flight75_cut.mat")), thor);
    let made = of(&[("log", 1300, 6), ("log:1", 1, 1), ("log:20", 20, 1), (".", 1300, 3), (".:1", 1, 1)]);
    assert_eq!(listed(reference("made.mat")), made);
}

#[test]
fn unit_skipped_variables_are_noted() {
    let reported = notes(&reference("made.mat"), &topic("log"));
    assert!(
        reported[0].ends_with("ignored: `complex` (complex numbers), `log.cells` (a cell array)")
            && reported.len() == 1,
        "{reported:?}"
    );
    for name in [
        "test3dmatrix_7.1_GLNX86",
        "testcell_7.1_GLNX86",
        "testfunc_7.4_GLNX86",
        "testobject_7.4_GLNX86",
        "testsparse_7.4_GLNX86",
    ] {
        let path = log(&format!("matlab/{name}.mat"));
        assert!(
            open_flight(&path, &FlightOptions::default()).unwrap_err().to_string().contains("holds no table"),
            "{name}"
        );
    }
}

#[test]
fn ref_damaged_files_of_scipy() {
    // SciPy: `Error -3 while decompressing data: incorrect data check`, for the first of three variables.
    let path = log("matlab/corrupted_zlib_checksum.mat");
    let reported = notes(&path, &FlightOptions::default());
    assert!(
        reported[0].contains("the variable at byte 128 is damaged and is skipped") && reported.len() == 1,
        "{reported:?}"
    );
    assert_eq!(numbers(&read(&path, &FlightOptions::default()).unwrap(), "datagrid"), [f64::from(0.035f32)]);
    // SciPy reads the shapes of this file, and fails at the numbers of `datagrid`.
    let reported = read(&log("matlab/corrupted_zlib_data.mat"), &FlightOptions::default()).unwrap_err().to_string();
    assert!(reported.contains("is damaged and is skipped"), "{reported}");
    assert!(read(&log("matlab/malformed1.mat"), &FlightOptions::default()).is_err());
}

#[test]
fn unit_a_truncated_file_keeps_its_complete_variables() {
    let folder = tempfile::TempDir::new().unwrap();
    let (path, bytes) = (folder.path().join("a.mat"), fs::read(log("TestLog2_cut.mat")).unwrap());
    fs::write(&path, &bytes[..bytes.len() - 200]).unwrap();
    let reported = notes(&path, &topic("MAG"));
    assert!(reported.iter().any(|n| n.contains("is damaged and is skipped: it is truncated: it has ")), "{reported:?}");
    assert_eq!(read(&path, &topic("MAG")).unwrap(), read(&log("TestLog2_cut.mat"), &topic("MAG")).unwrap());
    let header = &bytes[..100];
    fs::write(&path, header).unwrap();
    assert!(topics(&path, &FlightOptions::default()).is_err());
}
