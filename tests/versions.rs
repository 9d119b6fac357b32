//! The version gate: when a stage's answer moves, its version has to.
//!
//! Each stage has, on the small flights of these tests, a fingerprint of its answer rounded to nine significant digits,
//! so that another processor's rounding does not count as a change.

use std::fmt::Write;

use arrow_array::{Array, FixedSizeListArray, Float64Array, RecordBatch};

use crate::support::{Bench, read, stdout};

fn fingerprint(batches: &[RecordBatch]) -> String {
    let mut hasher = blake3::Hasher::new();
    for column in batches.iter().flat_map(RecordBatch::columns) {
        let list = column.as_any().downcast_ref::<FixedSizeListArray>().map(|l| l.values().clone());
        let values = list.as_ref().unwrap_or(column);
        if let Some(numbers) = values.as_any().downcast_ref::<Float64Array>() {
            for x in numbers.values() {
                // What is zero but for rounding has no digits to compare.
                let x = if x.abs() < 1e-7 { 0.0 } else { *x };
                hasher.update(format!("{x:.6e}").as_bytes());
            }
        }
    }
    hasher.finalize().to_hex()[..16].to_owned()
}

#[test]
fn gold_an_answer_that_moves_needs_a_new_version() {
    let bench = Bench::new();
    let more = "\n[[stages]]\nname = \"slow\"\nstage = \"bandpass\"\ninput = \"even\"\ncolumns = [\"mag_4_uc\"]\n\
                \n[[stages]]\nname = \"core\"\nstage = \"core_field\"\ninput = \"even\"\ndecimal_year = 2020.5\n\
                \n[[stages]]\nname = \"place\"\nstage = \"map_value\"\ninput = \"even\"\nmap = \"anomaly\"\n\
                map_levels_m = [300.0, 400.0]\n";
    bench.spec(&(crate::support::SPEC.to_owned() + more));
    assert_eq!(bench.run(&[]).code, 0);
    let overview = stdout(&bench.magline(&["stages"]));
    let mut now = String::new();
    for (stage, table) in [
        ("resample", "even"),
        ("core_field", "core"),
        ("bandpass", "slow"),
        ("a_matrix", "terms"),
        ("fit", "coefficients"),
        ("compensate", "clean"),
        ("navigate", "track"),
        ("map_value", "place"),
        ("score", "scores"),
    ] {
        let line = overview.lines().find(|l| l.starts_with(stage)).unwrap();
        let version = line.split_whitespace().nth(1).unwrap();
        let batches = read(&bench.path("store/tables/small").join(table));
        writeln!(now, "{stage} {version} {}", fingerprint(&batches)).unwrap();
    }
    let kept = include_str!("versions.txt");
    assert!(now == kept, "an answer moved: raise the stage's version and write into tests/versions.txt\n{now}");
}
