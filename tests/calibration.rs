//! Warnings of a fit, and cross-validation by line and by flight.

use std::fs;

use crate::support::{Bench, SPEC, changed, line_of, numbers, read, stderr, texts, write};

/// The small flights, with a fit of magnetometer 4 alone that has the keys `more`.
fn fitted(name: &str, predicate: &str, more: &str) -> String {
    format!(
        "\n[[stages]]\nname = \"{name}\"\nstage = \"fit\"\ninput = \"terms\"\nwhere = \"{predicate}\"\n\
         target = \"mag_4_uc\"\n{more}\n"
    )
}

fn head() -> String {
    let at = SPEC.find("[[stages]]\nname    = \"coefficients\"").or(SPEC.find("[[stages]]\nname   = \"coefficients\""));
    SPEC[..at.unwrap()].replace("[\"flux_a\", \"flux_d\"]", "[\"flux_a\"]")
}

#[test]
fn law_leave_one_flight_out_omits_whole_flights() {
    let bench = Bench::new();
    let models = [("by_line", "line"), ("by_flight", "flight")];
    let mut spec = head();
    for (name, what) in models {
        // With one line per flight, leave-one-line-out equals leave-one-flight-out.
        let choose = format!("model = \"ridge\"\nchoose = \"leave_one_{what}_out\"");
        spec += &fitted(name, "line like '%.01'", &choose);
        spec += &fitted(&format!("{name}_all"), "line like '%'", &choose);
    }
    bench.spec(&spec);
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let of = |table: &str, column: &str| numbers(&read(&bench.path("store/tables/small").join(table)), column);
    assert_eq!(of("by_line", "chosen"), of("by_flight", "chosen"));
    assert_eq!(of("by_line", "value"), of("by_flight", "value"));
    assert!(of("by_flight_all", "chosen").iter().all(|l| *l > 0.0));
    // With two lines of one flight, only leave-one-line-out is possible.
    for (name, what) in models {
        let choose = format!("model = \"ridge\"\nchoose = \"leave_one_{what}_out\"");
        bench.spec(&(head() + &fitted(name, "flight = '1'", &choose)));
        let done = bench.run(&[]);
        assert_eq!(done.code == 0, what == "line", "{}", done.stderr);
        assert_eq!(done.total("failed"), u64::from(what == "flight"));
    }
}

#[test]
fn law_the_trivial_solution_is_reported_with_its_error_bound() {
    let bench = Bench::new();
    // The small flights' magnetometers lack 48,000 nT of core field.
    for flight in ["1", "2"] {
        let lines = [("01", 700), ("02", 500)].map(|(line, rows)| {
            changed(&line_of(flight, &format!("{flight}.{line}"), rows), "mag_4_uc", |_, x| x + 48_000.0)
        });
        write(&bench.path(&format!("flights/{flight}.parquet")), &lines);
    }
    let spec = head().replace("lambda = [0.0, 0.025]", "lambda = [0.0, 1e-20, 1e-19, 1e-18, 1e-17, 1e-16, 2.5e4]");
    fs::write(
        bench.path("spec.toml"),
        spec + &fitted("model", "line like '%'", "model = \"tolles_lawson\"\nlambda = \"$lambda\""),
    )
    .unwrap();
    let output = bench.magline(&["run", "spec.toml"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let message = stderr(&output);
    // Six of seven fits are trivial. The message shows the first fault and the number of all faults.
    let first = "warning: model: the fit has a warning at 6 places, first (lambda = 0, vector = flux_a): ";
    assert!(message.contains(first) && message.contains("trivial solution"), "{message}");
    assert!(message.contains("warning: 6 warnings; the table `small.warnings` lists all"), "{message}");
    let table = read(&bench.path("store/tables/small/model"));
    let (lambda, bound, share) =
        (numbers(&table, "lambda"), numbers(&table, "approximation_bound"), numbers(&table, "trivial_share"));
    let warning = texts(&table, "warning");
    for i in 0..lambda.len() {
        if lambda[i] == 0.0 {
            // The aircraft field is exactly Tolles-Lawson. The fit without a ridge parameter therefore equals the
            // aircraft plus the unit matrix: p of 72.28 nT, induced terms of 16.42/50,000 (largest eigenvalue), and 1.
            // The field varies by 200 nT and the coefficients by the 0.05 nT of the waves: 0.5 %.
            let field_nt = 48_000.0;
            let aircraft = 72.28 + (1.0 + 16.42 / 50_000.0) * field_nt;
            let expected = aircraft * aircraft / (2.0 * field_nt);
            assert!((bound[i] / expected - 1.0).abs() < 0.03, "{} {expected}", bound[i]);
            assert!((share[i] - 1.0).abs() < 0.03, "{}", share[i]);
        }
        assert_eq!(warning[i].is_empty(), lambda[i] > 1.0);
        if lambda[i] > 1.0 {
            assert!(bound[i] < 1.0, "{}", bound[i]);
        }
    }
}
