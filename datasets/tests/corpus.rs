//! The corpus of the fuzz targets, by the function that the targets call: each file reads or errs.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{fs, path::Path};

#[path = "../fuzz/fuzz_targets/reads_or_errs.rs"]
mod reads_or_errs;

#[test]
fn law_the_corpus_of_the_fuzz_targets_reads_or_errs() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    let mut files = 0;
    for format in ["ulog", "dataflash", "mat"] {
        for file in fs::read_dir(corpus.join(format)).unwrap() {
            reads_or_errs::reads_or_errs(format, &fs::read(file.unwrap().path()).unwrap());
            files += 1;
        }
    }
    assert!(files >= 10, "{files}");
}
