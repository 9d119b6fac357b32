//! Results of a survey stage with single unusable lines.

use arrow_array::RecordBatch;

use crate::support::{Bench, changed, line_of, read, texts, write};

/// Fit of unresampled columns, so that an uneven line reaches it.
const FIT: &str = r#"
name  = "whole"
store = "store"

[tables.flights]
path = "flights/"

[[stages]]
name     = "coefficients"
stage    = "fit"
input    = "flights"
model    = "ridge"
target   = "mag_4_uc"
features = ["flux_a_x", "flux_a_y", "flux_a_z"]
"#;

/// Alternates time steps of 0.08 and 0.12 s.
fn uneven(line: &RecordBatch) -> RecordBatch {
    changed(line, "tt", |i, tt| if i % 2 == 1 { tt + 0.02 } else { tt })
}

fn bench(second: RecordBatch) -> Bench {
    let bench = Bench::new();
    write(&bench.path("flights/1.parquet"), &[line_of("1", "1.01", 700), second]);
    bench.spec(FIT);
    bench
}

/// Fitted lines of the coefficients, and line, stage and message of each failure.
fn outcome(bench: &Bench) -> (Vec<String>, Vec<[String; 3]>) {
    let mut lines = texts(&read(&bench.path("store/tables/whole/coefficients")), "lines");
    lines.dedup();
    let failures = read(&bench.path("store/tables/whole/failures"));
    let [line, stage, error] = ["line", "stage", "error"].map(|name| texts(&failures, name));
    let failures = line.into_iter().zip(stage).zip(error).map(|((l, s), e)| [l, s, e]);
    (lines, failures.collect())
}

#[test]
fn user_a_fit_skips_and_reports_an_unusable_line() {
    let bench = bench(uneven(&line_of("1", "1.02", 500)));
    let first = bench.run(&[]);
    assert_eq!(first.code, 1, "a line failed: {}", first.stderr);
    let (lines, failures) = outcome(&bench);
    assert_eq!(lines, ["1/1.01, 2/2.01, 2/2.02"]);
    assert_eq!(failures.len(), 1, "{failures:?}");
    assert_eq!((failures[0][0].as_str(), failures[0][1].as_str()), ("1.02", "coefficients"));
    assert!(failures[0][2].contains("flight 1, line 1.02, column `tt`"), "{failures:?}");
    assert_eq!(first.last["failures"].as_array().map(Vec::len), Some(1), "{}", first.last);
    // A reused result also omits the line and reports it.
    let again = bench.run(&[]);
    assert_eq!((again.code, again.last["tables"]["coefficients"]["reused"].as_u64()), (1, Some(1)), "{}", again.last);
    assert_eq!(outcome(&bench), (lines, failures));
}

#[test]
fn user_a_fit_without_usable_lines_reports_the_reason() {
    let bench = bench(uneven(&line_of("1", "1.02", 500)));
    bench.spec(&FIT.replace("model    =", "where    = \"line = '1.02'\"\nmodel    ="));
    let run = bench.run(&[]);
    assert_eq!(run.code, 1);
    let failures = texts(&read(&bench.path("store/tables/whole/failures")), "error");
    assert!(failures.iter().any(|e| e.contains("flight 1, line 1.02, column `tt`")), "{failures:?}");
    assert!(failures.iter().any(|e| e.contains("none of the 1 selected lines can be used")), "{failures:?}");
}

#[test]
fn user_a_fit_reports_a_too_short_line() {
    // A fourth-order Butterworth filter and a trim of 20 samples at each end require more samples.
    let short = bench(line_of("1", "1.02", 40));
    short.spec(&FIT.replace("model    =", "where    = \"line = '1.02'\"\nmodel    ="));
    let run = short.run(&[]);
    assert_eq!(run.code, 1);
    let errors = texts(&read(&short.path("store/tables/whole/failures")), "error").join("\n");
    assert!(errors.contains("flight 1, line 1.02 has 40 samples in its longest run and requires "), "{errors}");
    // Together with longer lines it is skipped, and the fit reports it.
    short.spec(FIT);
    assert_eq!(short.run(&[]).code, 0);
    let rows = read(&short.path("store/tables/whole/coefficients"));
    assert!(texts(&rows, "lines").iter().all(|l| l == "1/1.01, 2/2.01, 2/2.02"), "{:?}", texts(&rows, "lines"));
    let warning = &texts(&rows, "warning")[0];
    assert!(
        warning.contains("not used because too short for filter and trim: flight 1, line 1.02 has 40"),
        "{warning}"
    );
}

#[test]
fn user_a_difference_of_magnetometers_can_be_an_entry() {
    let bench = Bench::new();
    let spec = FIT
        .replace("[[stages]]\nname     = \"coefficients\"", MADE)
        .replace("input    = \"flights\"\nmodel", "input    = \"made\"\nmodel")
        .replace(
            "[\"flux_a_x\", \"flux_a_y\", \"flux_a_z\"]",
            "[\"features\"]\nentries  = [\"mag_5_4_uc\", \"flux_a\"]",
        );
    bench.spec(&spec);
    let run = bench.run(&[]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let terms = texts(&read(&bench.path("store/tables/whole/coefficients")), "term");
    assert_eq!(terms, ["mag_5_4_uc", "flux_a_x", "flux_a_y", "flux_a_z", "intercept"]);
}

const MADE: &str = r#"[[stages]]
name     = "made"
stage    = "features"
input    = "flights"
features = ["mag_5_4_uc", "flux_a_x", "flux_a_y", "flux_a_z"]

[[stages]]
name     = "coefficients""#;

#[test]
fn user_columns_with_a_dot_in_their_name_pass_all_stages() {
    let bench = Bench::new();
    let dotted = |line: RecordBatch| {
        let schema = line.schema();
        let name = |n: &str| if n == "flux_a_x" { "flux.a.x".to_owned() } else { n.to_owned() };
        let fields: Vec<_> = schema.fields().iter().map(|f| f.as_ref().clone().with_name(name(f.name()))).collect();
        RecordBatch::try_new(std::sync::Arc::new(arrow_schema::Schema::new(fields)), line.columns().to_vec()).unwrap()
    };
    for flight in ["1", "2"] {
        write(
            &bench.path(&format!("flights/{flight}.parquet")),
            &[dotted(line_of(flight, &format!("{flight}.01"), 700))],
        );
    }
    let spec = FIT
        .replace("[[stages]]\nname     = \"coefficients\"", DOTTED)
        .replace("input    = \"flights\"\nmodel", "input    = \"made\"\nmodel")
        .replace("[\"flux_a_x\", \"flux_a_y\", \"flux_a_z\"]", "[\"features\", \"flux.a.x\", \"flux.a.x_bp\"]");
    let applied = "\n[[stages]]\nname = \"clean\"\nstage = \"compensate\"\ninput = \"made\"\nmodel = \"coefficients\"\n\
                   mag = \"mag_4_uc\"\n";
    bench.spec(&format!("{spec}{applied}"));
    let run = bench.run(&[]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let terms = texts(&read(&bench.path("store/tables/whole/coefficients")), "term");
    assert_eq!(terms, ["flux.a.x_dot", "flux_a_y", "flux.a.x", "flux.a.x_bp", "intercept"]);
    for query in ["select count(mag_c) from whole.clean", "select avg(\"flux.a.x_bp\") from whole.filtered"] {
        let output = bench.magline(&["sql", query, "--store", "store", "--format", "csv"]);
        assert_eq!(output.status.code(), Some(0), "{query}: {}", crate::support::stderr(&output));
    }
}

const DOTTED: &str = r#"[[stages]]
name     = "filtered"
stage    = "bandpass"
input    = "flights"
columns  = ["flux.a.x"]

[[stages]]
name     = "made"
stage    = "features"
input    = "filtered"
features = ["flux.a.x_dot", "flux_a_y"]

[[stages]]
name     = "coefficients""#;
