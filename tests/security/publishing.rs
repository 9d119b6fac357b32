//! Restricted data and permitted contents of a published set.

use super::*;

/// Spec over the flights of a bench with the restricted column `mag_1_c` and these stages.
fn restricted(more: &str, axes: &str, stages: &str) -> String {
    format!(
        "name = \"small\"\nseed = 1\nstore = \"store\"\n[tables.flights]\npath = \"flights/\"\n\
         restricted = [\"mag_1_c\"]\n\
         reason = \"the agreement\"\n{more}\n[axes]\n{axes}\n{stages}\n{FACTS}"
    )
}

/// Publishes tables of a spec; returns true if this is rejected, and the message.
fn asked(spec: &str, tables: &[&str]) -> (bool, String) {
    let bench = Bench::new();
    bench.spec(spec);
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let output = publish(&bench, tables, "set");
    let printed = stdout(&output) + &stderr(&output);
    let refused = output.status.code() == Some(2);
    assert!(refused || output.status.success(), "{printed}");
    assert_eq!(refused, !bench.path("set").exists());
    (refused, printed)
}

fn refused(spec: &str, tables: &[&str], why: &str) {
    let (refused, printed) = asked(spec, tables);
    assert!(refused && printed.contains(why) && printed.contains("the agreement"), "{why}: {printed}");
}

const SCORE: &str = "[[stages]]\nname=\"z\"\nstage=\"derive\"\ninput=\"pick\"\ncolumns={ zero = \"0.0 * mag_4_uc\" }\n\
    [[stages]]\nname=\"sc\"\nstage=\"score\"\ninput=\"z\"\nmag=\"zero\"\ntruth=\"mag_1_c\"\nmetrics=[\"bias_error\"]\n";

fn resampled(rate_hz: f64) -> String {
    format!(
        "[[stages]]\nname=\"pick\"\nstage=\"resample\"\ninput=\"flights\"\nrate_hz={rate_hz}\nmax_gap_s=100.0\n{SCORE}"
    )
}

#[test]
fn user_a_score_of_few_samples_is_no_aggregate() {
    // 60 s of samples: 600 at 10 Hz, 6 at 0.1 Hz.
    let (held, printed) = asked(&restricted("", "", &resampled(10.0)), &["sc"]);
    assert!(!held && printed.contains("sc: ") && printed.contains("samples per value"), "{printed}");
    refused(&restricted("", "", &resampled(0.1)), &["sc"], "`least_samples` is 100");
    refused(&restricted("least_samples = 1000", "", &resampled(10.0)), &["sc"], "`least_samples` is 1000");
    refused(&restricted("least_ratio = 1000", "", &resampled(10.0)), &["sc"], "`least_ratio` is 1000");
    // 60 coefficients from 600 samples, and from 60 samples.
    let fit = |rate: f64| {
        let pick = format!("[[stages]]\nname=\"pick\"\nstage=\"resample\"\ninput=\"flights\"\nrate_hz={rate}\n");
        pick + "[[stages]]\nname=\"tl\"\nstage=\"a_matrix\"\ninput=\"pick\"\nvector=\"flux_d\"\n\
            [[stages]]\nname=\"model\"\nstage=\"fit\"\ninput=\"tl\"\nwhere=\"line='1.01'\"\nmodel=\"tolles_lawson\"\n\
            target=\"mag_1_c\"\nlow_hz=0.01\nhigh_hz=0.4\ntrim=1\n"
    };
    refused(&restricted("", "", &fit(2.0)), &["model"], "`least_ratio` is 10");
    assert!(!asked(&restricted("", "", &fit(10.0)), &["model"]).0);
}

#[test]
fn user_expressions_that_choose_samples_make_no_aggregate() {
    let rows = "[[stages]]\nname=\"pick\"\nstage=\"select\"\ninput=\"flights\"\nrows=\"$rows\"\n";
    let axis = "rows = [\"tt > 0\", \"tt > 0.15\"]";
    refused(&restricted("", axis, &format!("{rows}{SCORE}")), &["sc"], "an expression of `pick`");
    let weighed = "[[stages]]\nname=\"pick\"\nstage=\"derive\"\ninput=\"flights\"\n\
        columns={ one = \"case when tt < 0.05 then mag_1_c else 0.0 end\" }\nunits={ one = \"nT\" }\n\
        [[stages]]\nname=\"sc\"\nstage=\"score\"\ninput=\"pick\"\nmag=\"one\"\ntruth=\"mag_4_uc\"\n\
        metrics=[\"bias_error\"]\n";
    refused(&restricted("", "", weighed), &["sc"], "an expression of `pick`");
    let fitted = "[[stages]]\nname=\"model\"\nstage=\"fit\"\ninput=\"flights\"\nwhere=\"line='1.01' and tt > 1\"\n\
                  model=\"ridge\"\n\
        target=\"mag_1_c\"\nfeatures=[\"mag_4_uc\"]\n";
    refused(&restricted("", "", fitted), &["model"], "`where` of `model`");
    // Sums with constant factors neither select nor weight samples.
    let sums = "[[stages]]\nname=\"pick\"\nstage=\"derive\"\ninput=\"flights\"\n\
                columns={ d = \"0.5 * (mag_4_uc - mag_1_c)\" }\n\
        [[stages]]\nname=\"sc\"\nstage=\"score\"\ninput=\"pick\"\nmag=\"mag_4_uc\"\ntruth=\"mag_1_c\"\n\
        metrics=[\"std_error\"]\n";
    assert!(!asked(&restricted("", "", sums), &["sc"]).0);
}

#[test]
fn user_a_model_that_memorises_is_no_aggregate() {
    let fit = |model: &str| {
        format!(
            "[[stages]]\nname=\"net\"\nstage=\"fit\"\ninput=\"flights\"\nwhere=\"line='1.01'\"\nmodel=\"{model}\"\n\
             target=\"mag_1_c\"\n\
             features=[\"tt\"]\n[[stages]]\nname=\"cl\"\nstage=\"compensate\"\ninput=\"flights\"\nmodel=\"net\"\n\
             mag=\"mag_4_uc\"\n"
        )
    };
    for model in ["random_features", "boosted_trees"] {
        let spec = restricted("", "", &fit(model));
        refused(&spec, &["net"], "can contain single samples");
        refused(&spec, &["cl"], "can contain single samples");
    }
}

#[test]
fn user_aggregates_that_differ_by_few_samples_are_rejected() {
    let fit = "[[stages]]\nname=\"model\"\nstage=\"fit\"\ninput=\"flights\"\nwhere=\"line='1.01'\"\nmodel=\"ridge\"\n\
               target=\"mag_1_c\"\n\
        features=[\"mag_4_uc\"]\ntrim=\"$trim\"\n";
    refused(&restricted("", "trim = [20, 21]", fit), &["model"], "differ by fewer than 100");
    assert!(!asked(&restricted("", "trim = [20, 80]", fit), &["model"]).0, "120 samples");
}

#[test]
fn user_a_restriction_cannot_be_dropped_on_the_command_line() {
    let bench = Bench::new();
    bench.spec(&restricted("", "", &resampled(0.1)));
    for set in [
        "tables.flights.restricted=[]",
        "tables.flights.restricted=false",
        "tables.\"flights\".\"restricted\"=[]",
        "tables.flights.embargo=2020-01-01",
        "tables.flights.reason=none",
        "tables.flights.least_samples=2",
        "tables.flights={path=\"flights/\"}",
    ] {
        let output = bench.magline(&["check", "spec.toml", "--set", set]);
        assert_eq!(output.status.code(), Some(2), "{set}: {}", stdout(&output));
        assert!(stderr(&output).contains("`--set` cannot"), "{set}: {}", stderr(&output));
    }
}

#[test]
fn user_a_restriction_that_a_spec_has_dropped_is_noted() {
    let bench = Bench::new();
    let spec = restricted("", "", &resampled(10.0));
    bench.spec(&spec);
    assert_eq!(bench.run(&[]).code, 0);
    // This also holds under another name of the table and of the pipeline.
    let dropped = spec.replace("restricted = [\"mag_1_c\"]\nreason = \"the agreement\"", "");
    let dropped = dropped.replace("\"small\"", "\"other\"").replace("tables.flights", "tables.copies");
    bench.spec(&dropped.replace("input=\"flights\"", "input=\"copies\""));
    assert_eq!(bench.run(&[]).code, 0);
    let output = publish(&bench, &["sc"], "set");
    assert!(stderr(&output).contains("recorded copies.mag_1_c as restricted"), "{}", stderr(&output));
}

#[test]
fn user_only_a_file_in_the_folder_of_the_spec_is_published_as_licence() {
    let bench = Bench::new();
    fs::write(bench.path("secret"), "secret").unwrap();
    fs::create_dir(bench.path("sub")).unwrap();
    symlink(bench.path("secret"), bench.path("sub/linked.txt")).unwrap();
    fs::write(bench.path("sub/LICENCE"), "The text.").unwrap();
    let spec = |file: &str| SPEC.to_owned() + &FACTS.replace("date ", &format!("licence_file = \"{file}\"\ndate "));
    let sub = spec("LICENCE").replace("flights/", "../flights/").replace("map.parquet", "../map.parquet");
    fs::write(bench.path("sub/spec.toml"), &sub).unwrap();
    assert!(bench.magline(&["run", "sub/spec.toml", "-q"]).status.success());
    for file in ["../secret", "linked.txt", "/etc/hostname", "/dev/zero", "./LICENCE"] {
        fs::write(bench.path("sub/spec.toml"), sub.replace("\"LICENCE\"", &format!("\"{file}\""))).unwrap();
        let output = bench.magline(&["publish", "sub/spec.toml", "scores", "--to", "set"]);
        assert_eq!(output.status.code(), Some(2), "{file}: {}", stderr(&output));
        assert!(stderr(&output).contains("`licence_file`") && !bench.path("set").exists(), "{file}");
    }
    fs::write(bench.path("sub/spec.toml"), &sub).unwrap();
    let output = bench.magline(&["publish", "sub/spec.toml", "scores", "--to", "set"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(fs::read_to_string(bench.path("set/LICENSE")).unwrap(), "The text.");
}
