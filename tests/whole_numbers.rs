//! Interpolation of codes, flags and counts of text files.

use std::{collections::BTreeSet, fs};

use crate::support::{Bench, numbers, read};

const SPEC: &str = r#"
name  = "small"
store = "store"

[tables.flights]
path = "flags.csv"

[tables.fast]
path = "fast.csv"

[[stages]]
name    = "even"
stage   = "resample"
input   = "flights"
rate_hz = 4.0

[[stages]]
name    = "joined"
stage   = "join"
input   = "fast"
with    = "flights"
method  = "linear"
columns = ["sats", "valid", "mag_1_uc"]
"#;

#[test]
fn user_codes_and_flags_of_a_csv_are_not_interpolated() {
    let bench = Bench::new();
    let row = |i: usize| {
        let valid = if i % 7 == 3 { String::new() } else { usize::from(!i.is_multiple_of(4)).to_string() };
        let (tt, fix, sats) = (36_000.0 + 0.1 * i as f64, if i < 30 { 3 } else { 6 }, [8, 12][i % 2]);
        // The field is in whole nT.
        format!("F,1,{tt:.1},{},{fix},{sats},{valid},{}\n", 52_000 + i, 1000 + 3 * i)
    };
    let rows: String = (0..60).map(row).collect();
    fs::write(bench.path("flags.csv"), format!("flight,line,tt,mag_1_uc,fix,sats,valid,frame\n{rows}")).unwrap();
    let fast: String =
        (0..100).map(|i| format!("F,1,{:.2},{}\n", 36_000.0 + 0.05 * f64::from(i), 48_000 + i)).collect();
    fs::write(bench.path("fast.csv"), format!("flight,line,tt,mag_2_uc\n{fast}")).unwrap();
    bench.spec(SPEC);
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    for name in ["even", "joined"] {
        let table = read(&bench.path("store/tables/small").join(name));
        let distinct = |column: &str| numbers(&table, column).iter().map(|x| x.to_string()).collect::<BTreeSet<_>>();
        let words = |of: &[&str]| of.iter().map(ToString::to_string).collect::<BTreeSet<_>>();
        assert_eq!((distinct("sats"), distinct("valid")), (words(&["8", "12"]), words(&["0", "1"])), "{name}");
        // Measured columns are interpolated to non-integer values.
        assert!(numbers(&table, "mag_1_uc").iter().any(|nt| nt.fract() != 0.0), "{name}");
    }
    let even = read(&bench.path("store/tables/small/even"));
    assert!(numbers(&even, "fix").iter().all(|fix| [3.0, 6.0].contains(fix)));
    let (tt, frames) = (numbers(&even, "tt"), numbers(&even, "frame"));
    for (tt, frame) in tt.iter().zip(frames) {
        assert!(
            frame.fract() == 0.0 && (frame - (1000.0 + 30.0 * (tt - 36_000.0))).abs() < 0.5 + 1e-6,
            "{tt}: {frame}"
        );
    }
}
