//! Tests that files are read into a store once for any number of threads, and again after damage to the store's notes.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{fmt::Write, fs, path::Path, sync::Mutex};

use tempfile::TempDir;

use super::*;

/// A table of the files in `logs`, of a spec in the folder.
fn decl() -> SourceDecl {
    SourceDecl {
        name: "flights".to_owned(),
        at: 0..0,
        protection: Default::default(),
        path: ("logs".to_owned(), 0..0),
        options: schemas::SpecEntries::default(),
    }
}

/// A flight log of some lines; one line has a bad cell.
fn written(folder: &Path, flight: &str, lines: usize) {
    let mut text = "flight,line,tt,lat,lon,note\n".to_owned();
    for line in 0..lines {
        for row in 0..(50 + 37 * line % 90) {
            let (tt, lat) = (1000 * line + row, 45.0 + row as f64 / 1e5);
            let lat = if line == 3 && row == 7 { "oops".to_owned() } else { lat.to_string() };
            writeln!(text, "{flight},{flight}.{line:02},{tt},{lat},-75.{row:03},{}", row % 3).unwrap();
        }
    }
    fs::create_dir_all(folder.join("logs")).unwrap();
    fs::write(folder.join("logs").join(format!("{flight}.csv")), text).unwrap();
}

/// Lines that were ingested, and the progress events of the last file.
fn ingested(folder: &Path, store: &Store, threads: usize) -> (String, Vec<usize>) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let flights = Flights::open_trusting(
            &decl(),
            folder,
            ReusePolicy { store: Some(store.root()), ..ReusePolicy::default() },
        );
        let progress = Mutex::new(vec![]);
        let tick = |step: &ReadProgress| {
            if step.lines > 0 {
                progress.lock().unwrap().push(step.lines);
            }
        };
        let lines = flights.unwrap().lines(store, &tick).unwrap();
        assert!(lines.lines.iter().all(|l| l.fault.is_some() || store.has(l.object)));
        (format!("{:?} {:?}", lines.lines, lines.files), progress.into_inner().unwrap())
    })
}

#[test]
fn unit_the_lines_of_a_file_are_the_same_on_any_number_of_threads() {
    let folder = TempDir::new().unwrap();
    written(folder.path(), "1", 20);
    let of = |threads: usize| {
        let store = Store::open(&folder.path().join(format!("store{threads}"))).unwrap();
        let (lines, progress) = ingested(folder.path(), &store, threads);
        assert_eq!(progress, (1..=20).collect::<Vec<_>>(), "each line is reported once, in order");
        lines
    };
    let one = of(1);
    assert_eq!(one.matches("`oops` is not a number").count(), 1);
    assert!(one == of(2) && one == of(7));
    // The same holds for several files.
    written(folder.path(), "2", 5);
    written(folder.path(), "3", 9);
    let of = |threads: usize| {
        let store = Store::open(&folder.path().join(format!("more{threads}"))).unwrap();
        ingested(folder.path(), &store, threads).0
    };
    let one = of(1);
    assert!(one == of(2) && one == of(7));
}

#[test]
fn unit_damaged_notes_of_files_are_recomputed() {
    let folder = TempDir::new().unwrap();
    written(folder.path(), "1", 5);
    let store = Store::open(&folder.path().join("store")).unwrap();
    let (first, progress) = ingested(folder.path(), &store, 2);
    assert_eq!(progress.len(), 5);
    assert_eq!(ingested(folder.path(), &store, 2), (first.clone(), vec![]), "known, and not read");
    let notes: Vec<_> = fs::read_dir(store.root().join("sources")).unwrap().map(|e| e.unwrap().path()).collect();
    let index = notes.iter().find(|n| n.extension().is_some_and(|e| e == "json")).unwrap();
    for damage in 0..40 {
        let mut bytes = fs::read(index).unwrap();
        let at = damage * 7919 % bytes.len();
        bytes[at] ^= 1 << (damage % 8);
        fs::write(index, &bytes).unwrap();
        let (again, progress) = ingested(folder.path(), &store, 2);
        assert_eq!((&again, progress.len()), (&first, 5), "byte {at}");
    }
    for note in &notes {
        fs::write(note, "{").unwrap();
    }
    assert_eq!(ingested(folder.path(), &store, 2).0, first);
}

#[test]
fn unit_damaged_quality_figures_are_recomputed() {
    let folder = TempDir::new().unwrap();
    written(folder.path(), "1", 5);
    let store = Store::open(&folder.path().join("store")).unwrap();
    let first = ingested(folder.path(), &store, 1).0;
    let folders: Vec<_> = fs::read_dir(store.root().join("quality")).unwrap().flatten().map(|e| e.path()).collect();
    let [kept] = folders.as_slice() else { panic!("{folders:?}") };
    let whole = fs::read(kept.join("part-0.parquet")).unwrap();
    let mut flipped = whole.clone();
    flipped[40] ^= 1;
    for damaged in [&whole[..whole.len() / 2], &flipped[..], &[]] {
        fs::write(kept.join("part-0.parquet"), damaged).unwrap();
        assert_eq!(ingested(folder.path(), &store, 1).0, first);
        assert_eq!(fs::read(kept.join("part-0.parquet")).unwrap(), whole);
    }
    fs::remove_dir_all(kept).unwrap();
    assert_eq!(ingested(folder.path(), &store, 1).0, first);
    assert!(kept.join("part-0.parquet").is_file());
}

#[test]
fn unit_scan_results_are_cached_while_the_file_is_unchanged() {
    let folder = TempDir::new().unwrap();
    written(folder.path(), "1", 2);
    let store = Store::open(&folder.path().join("store")).unwrap();
    ingested(folder.path(), &store, 1);
    let types = |read_all: bool| {
        let trust = ReusePolicy { store: Some(store.root()), read_all, settle: None };
        let flights = Flights::open_trusting(&decl(), folder.path(), trust).unwrap();
        flights.schema.field_with_name("note").unwrap().data_type().clone()
    };
    // A modified note reveals whether the file was scanned.
    for entry in fs::read_dir(store.root().join("sources")).unwrap().flatten() {
        let text = fs::read_to_string(entry.path()).unwrap();
        if let Some(mut seen) =
            store::note::unsealed::<bytes::FileFact>(text.as_bytes()).filter(|s| s.found.starts_with("csv"))
        {
            seen.found = seen.found.replace("kknnnn", "kknnnt");
            fs::write(entry.path(), store::note::sealed(&seen.older()).unwrap()).unwrap();
        }
    }
    let (text, number) = (arrow_schema::DataType::Utf8, arrow_schema::DataType::Float64);
    assert_eq!((types(false), types(true)), (text, number.clone()));
    written(folder.path(), "1", 3);
    assert_eq!(types(false), number, "the file has changed");
}
