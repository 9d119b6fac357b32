//! Results are never computed twice, and a changed spec computes only new units.

use std::fs;

use crate::support::{Bench, SPEC, changed, line_of, read, stderr, stdout, write};

const TABLES: [&str; 6] = ["even", "terms", "coefficients", "clean", "track", "scores"];

fn computed(bench: &Bench, more: &[&str]) -> [u64; 6] {
    let done = bench.run(more);
    assert_eq!(done.code, 0, "{}", done.stderr);
    assert_eq!(done.total("failed"), 0);
    TABLES.map(|t| done.computed(t))
}

// 4 lines; 2 magnetometers x 2 vectors x 2 lambdas.
const ALL: [u64; 6] = [4, 8, 8, 32, 32, 32];

#[test]
fn user_a_second_run_computes_nothing() {
    let bench = Bench::new();
    assert_eq!(computed(&bench, &[]), ALL);
    assert_eq!(computed(&bench, &[]), [0; 6]);
}

#[test]
fn user_a_new_lambda_computes_its_own_points_only() {
    let bench = Bench::new();
    computed(&bench, &[]);
    assert_eq!(computed(&bench, &["--set", "axes.lambda=[0.0, 0.025, 0.5]"]), [0, 0, 4, 16, 16, 16]);
    assert_eq!(computed(&bench, &["--set", "axes.vector=[\"flux_a\"]"]), [0; 6]);
    assert_eq!(computed(&bench, &["--set", "axes.lambda=[2.5e-2]"]), [0; 6]);
}

#[test]
fn user_a_new_flight_computes_its_lines_and_dependent_fits() {
    let bench = Bench::new();
    computed(&bench, &[]);
    let more = [line_of("3", "3.02", 500)];
    write(&bench.path("flights/3.parquet"), &more);
    // The fit does not select the new line, so the coefficients stay.
    assert_eq!(computed(&bench, &[]), [1, 2, 0, 8, 8, 8]);
    write(&bench.path("flights/4.parquet"), &[line_of("4", "4.01", 600)]);
    // The fit selects this line, so all models and their dependents are new.
    assert_eq!(computed(&bench, &[]), [1, 2, 8, 48, 48, 48]);
}

#[test]
fn user_a_navigate_parameter_recomputes_navigation_and_scores() {
    let bench = Bench::new();
    computed(&bench, &[]);
    assert_eq!(computed(&bench, &["--set", "track.fogm_sigma_nt=4.0"]), [0, 0, 0, 0, 32, 32]);
    // An explicit default value does not change the key.
    assert_eq!(computed(&bench, &["--set", "track.fogm_sigma_nt=4.0", "--set", "track.vrw_sigma=0.000238"]), [0; 6]);
}

/// Tables by `sql`, without the axis.
fn terms(bench: &Bench, store: &str) -> String {
    let query = "SELECT * EXCEPT (vectors) FROM small.terms WHERE vectors = 'TL_A_flux_a' ORDER BY flight, line, tt";
    let answer = bench.magline(&["sql", "--store", store, "--format", "json", query]);
    assert!(answer.status.success(), "{}", stderr(&answer));
    stdout(&answer)
}

#[test]
fn user_lists_keep_their_length_when_a_sweep_shrinks_and_grows() {
    let bench = Bench::new();
    let tables = SPEC.split("[axes]").next().unwrap();
    bench.spec(&format!(
        "{tables}[axes]\nvectors = [[\"TL_A_flux_a\"], [\"TL_A_flux_a\", \"TL_A_flux_d\"]]\n\
         [[stages]]\nname = \"terms\"\nstage = \"features\"\ninput = \"flights\"\nfeatures = [\"$vectors\"]\n"
    ));
    let one = ["--set", "axes.vectors=[[\"TL_A_flux_a\"]]"];
    assert_eq!(bench.run(&[&one[..], &["--set", "store=alone"]].concat()).code, 0);
    let alone = terms(&bench, "alone");
    assert!(alone.lines().count() > 2000);
    for narrow in [false, true, false, true] {
        let done = bench.run(if narrow { &one } else { &[] });
        assert_eq!(done.code, 0, "{}", done.stderr);
        assert!(terms(&bench, "store") == alone, "the terms have changed");
        let tables = |store: &str| read(&bench.path(store).join("tables/small/terms"));
        if narrow {
            assert!(tables("store") == tables("alone"), "the files have changed");
        }
    }
}

#[test]
fn user_renaming_and_reformatting_keep_the_cache() {
    let bench = Bench::new();
    computed(&bench, &[]);
    let spec =
        SPEC.replace("0.025", "2.50e-2").replace("line like '%.01'", "( line   LIKE '%.01' )").replace("  ", " ");
    bench.spec(&spec.replace("\"terms\"", "\"matrix\""));
    let done = bench.run(&[]);
    assert_eq!(done.total("computed"), 0, "{}", done.last);
}

#[test]
fn user_a_changed_column_recomputes_only_its_readers() {
    let bench = Bench::new();
    computed(&bench, &[]);
    let lines = [line_of("1", "1.01", 700), changed(&line_of("1", "1.02", 500), "mag_5_uc", |_, x| x + 1.0)];
    write(&bench.path("flights/1.parquet"), &lines);
    // One line is resampled again. The A-matrices of the line and the results of mag_4_uc do not depend on mag_5_uc.
    assert_eq!(computed(&bench, &[]), [1, 0, 0, 4, 4, 4]);
}

#[test]
fn user_a_renamed_file_recomputes_nothing() {
    let bench = Bench::new();
    computed(&bench, &[]);
    fs::rename(bench.path("flights/1.parquet"), bench.path("flights/renamed.parquet")).unwrap();
    assert_eq!(computed(&bench, &[]), [0; 6]);
}

#[test]
fn gold_why_lists_the_changes() {
    let bench = Bench::new();
    computed(&bench, &[]);
    let why = |more: &[&str]| {
        let args: Vec<&str> = ["why", "spec.toml", "scores"].iter().chain(more).copied().collect();
        crate::support::stdout(&bench.magline(&args))
    };
    assert_eq!(why(&[]), "scores: nothing to compute, all 32 units are in the store\n");
    let moved = "scores: 32 of 32 units to compute\n  track: fogm_sigma_nt none -> 4.0\n";
    assert_eq!(why(&["--set", "track.fogm_sigma_nt=4"]), moved);
    let point = why(&["--set", "axes.lambda=[0.0, 0.025, 1.0]"]);
    assert!(point.starts_with("scores: 16 of 48 units to compute\n") && point.contains("lambda=1 "), "{point}");
}
