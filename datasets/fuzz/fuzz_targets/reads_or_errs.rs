//! Common part of all targets: reads the bytes as a file of one format, with all of its topics.

use std::{cell::OnceCell, fs};

use datasets::{FlightOptions, ReadHints, open_raw, topics};
use tempfile::TempDir;

thread_local! {
    static FOLDER: OnceCell<TempDir> = const { OnceCell::new() };
}

/// Reads the topics of a file. A panic, a hang or unbounded memory use is a failure.
pub fn reads_or_errs(format: &str, bytes: &[u8]) {
    FOLDER.with(|folder| {
        let folder = folder.get_or_init(|| TempDir::new().expect("a folder for the file"));
        let path = folder.path().join("log");
        fs::write(&path, bytes).expect("the file is written");
        let of = |topic| FlightOptions { format: Some(format.to_owned()), topic, ..FlightOptions::default() };
        let Ok(listed) = topics(&path, &of(None)) else { return };
        for topic in listed.into_iter().take(8) {
            if let Ok(reader) = open_raw(&path, &of(Some(topic.name)), &ReadHints::default()) {
                reader.for_each(drop);
            }
        }
    });
}
