//! The version gate: when a stage's answer moves, its version has to.
//!
//! Each stage has, on the small flights of these tests, a fingerprint of what its example gives, rounded to seven
//! significant digits, so that another processor's rounding does not count as a change.

use std::fmt::Write;

use arrow_array::{Array, FixedSizeListArray, Float64Array, RecordBatch};

use crate::support::{Bench, SPEC, read, stdout};

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

/// The tables of the small flights, without axes and stages.
fn head() -> &'static str {
    SPEC.split("[axes]").next().unwrap()
}

/// A table for each model of `fit`, with the stage's version.
fn models(fit: &schemas::Entry) -> Vec<(String, String)> {
    let parameter = (fit.params)().into_iter().find(|p| p.name == "model").unwrap();
    let words = parameter.rule.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>();
    assert!(words.len() > 5, "{}", parameter.rule);
    words.iter().map(|model| (format!("fit_{model}"), format!("v{}", fit.version))).collect()
}

#[test]
fn gold_an_answer_that_moves_needs_a_new_version() {
    let bench = Bench::new();
    let catalogue = stages::catalogue();
    let examples: String = catalogue.iter().map(|e| e.example).collect();
    let fit = catalogue.iter().find(|e| e.name == "fit").unwrap();
    let of_model = |(name, _): &(String, String)| {
        let own =
            fit.example.replace("name   = \"fit\"", &format!("name   = \"{name}\"")).replace("lambda = 0.025\n", "");
        let own = own.replace("\"tolles_lawson\"", &format!("\"{}\"", name.trim_start_matches("fit_")));
        // All of them together are least squares.
        own + if ["fit_pls", "fit_truncated_svd"].contains(&name.as_str()) { "components = 6\n" } else { "" }
    };
    let models = models(fit);
    let each: String = models.iter().map(of_model).collect();
    bench.spec(&(head().to_owned() + &examples + &each));
    let checked = bench.magline(&["check", "spec.toml"]);
    assert!(checked.status.success(), "{}{}", stdout(&checked), crate::support::stderr(&checked));
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let mut now = String::new();
    let stages = catalogue.iter().map(|e| (e.name.to_owned(), format!("v{}", e.version)));
    for (table, version) in stages.chain(models) {
        let batches = read(&bench.path("store/tables/small").join(&table));
        assert!(batches.iter().any(|b| b.num_rows() > 0), "the example of `{table}` gives no rows");
        writeln!(now, "{table} {version} {}", fingerprint(&batches)).unwrap();
    }
    let kept = include_str!("versions.txt");
    assert!(now == kept, "an answer moved: raise the stage's version and write into tests/versions.txt\n{now}");
}

#[test]
fn every_stage_says_what_happens_without_a_parameter() {
    for entry in stages::catalogue() {
        for parameter in (entry.params)() {
            let silent = parameter.default.is_none() && parameter.absent == Some("");
            assert!(
                !silent,
                "`{}` of `{}` may be left out, and does not say what happens then",
                parameter.name, entry.name
            );
        }
    }
}
