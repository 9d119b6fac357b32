//! Published sets without restricted data: restrictions are inherited by derived columns, tables and maps.

use std::{collections::BTreeSet, fs};

use serde_json::Value;

use crate::{
    publish::{json, line_folder, publish, published, ran, refused, spec, verify},
    support::{read, stderr},
};

const RESTRICTED: (&str, &str) =
    ("path = \"flights/\"", "path = \"flights/\"\nrestricted = [\"mag_4_uc\"]\nreason = \"the survey agreement\"");

#[test]
fn user_columns_derived_from_a_restricted_column_are_not_published() {
    let bench = ran(&[RESTRICTED, ("mag    = [\"mag_4_uc\", \"mag_5_uc\"]", "mag    = [\"mag_4_uc\"]")]);
    // A restriction is inherited row by row, through three stages.
    for (table, chain) in [
        ("clean", "clean.mag_c <- terms.mag_4_uc <- even.mag_4_uc <- flights.mag_4_uc"),
        ("track", "clean.mag_c <- terms.mag_4_uc <- even.mag_4_uc <- flights.mag_4_uc"),
        ("flights", "flights.mag_4_uc"),
        ("even", "even.mag_4_uc <- flights.mag_4_uc"),
    ] {
        let message = refused(&publish(&bench, &[table], &["--to", "set"]));
        assert!(message.contains(chain) && message.contains("the survey agreement"), "{table}: {message}");
        assert!(message.contains("--include-restricted"), "{message}");
        assert!(!bench.path("set").exists());
    }
    // Aggregates and independent columns are published without restricted values.
    published(&bench, &["scores", "coefficients", "terms"], "set", &[]);
    assert_eq!(json(&bench, "set/dictionary.json")["restricted"], Value::Array(vec![]));
    let columns = read(&bench.path(&line_folder("set", "terms", "1", "1.01")));
    assert!(columns[0].column_by_name("tl").is_some() && columns[0].column_by_name("mag_4_uc").is_none());
    // With `--include-restricted` the table is published, and all documents state this.
    published(&bench, &["clean"], "told", &["--include-restricted"]);
    let held = json(&bench, "told/dictionary.json")["restricted"].clone();
    let names: BTreeSet<&str> = held.as_array().unwrap().iter().filter_map(|h| h["column"].as_str()).collect();
    assert_eq!(
        names,
        ["mag_c", "mag_aircraft", "mag_aircraft_sigma"]
            .into_iter()
            .filter(|n| names.contains(n))
            .collect::<BTreeSet<_>>()
    );
    assert!(names.contains("mag_c"), "{held}");
    for file in ["README.md", "croissant.json", "ro-crate-metadata.json"] {
        let text = fs::read_to_string(bench.path("told").join(file)).unwrap();
        assert!(text.contains("the survey agreement"), "{file}");
    }
    assert_eq!(verify(&bench, "told").0, Some(0));
}

#[test]
fn user_single_samples_of_a_small_table_are_no_aggregate() {
    let importance = |kept: &str| {
        format!(
            "truth = \"mag_1_c\"\n\n[[stages]]\nname = \"weights\"\nstage = \"importance\"\ninput = \"terms\"\n\
             model = \"coefficients\"\ntarget = \"$mag\"\nmethod = \"shapley\"\n{kept}"
        )
    };
    let one = ("mag    = [\"mag_4_uc\", \"mag_5_uc\"]", "mag    = [\"mag_4_uc\"]");
    let bench = ran(&[RESTRICTED, one, ("truth = \"mag_1_c\"", &importance(""))]);
    let message = refused(&publish(&bench, &["weights"], &["--to", "set"]));
    assert!(message.contains("weights.sample_values <- terms.mag_4_uc"), "{message}");
    bench.spec(&spec(&[RESTRICTED, one, ("truth = \"mag_1_c\"", &importance("kept_samples = 0"))]));
    assert_eq!(bench.run(&[]).code, 0);
    published(&bench, &["weights"], "set", &[]);
}

#[test]
fn user_a_table_derived_from_an_unrestricted_magnetometer_is_published() {
    // Only the other magnetometer is restricted; the compensated column derives from `mag_5_uc`.
    let bench = ran(&[RESTRICTED, ("mag    = [\"mag_4_uc\", \"mag_5_uc\"]", "mag    = [\"mag_5_uc\"]")]);
    published(&bench, &["clean", "track"], "set", &[]);
    assert_eq!(verify(&bench, "set").0, Some(0));
    // A model is an aggregate, even of restricted columns, so `mag_c` does not depend on them row by row.
    bench.spec(&spec(&[
        ("path = \"flights/\"", "path = \"flights/\"\nrestricted = [\"mag_1_c\"]"),
        ("mag    = [\"mag_4_uc\", \"mag_5_uc\"]", "mag    = [\"mag_5_uc\"]"),
    ]));
    assert_eq!(bench.run(&[]).code, 0);
    published(&bench, &["clean", "scores"], "again", &[]);
}

#[test]
fn user_whole_tables_embargoes_and_maps_are_protected() {
    let of = |table: &str, more: &str| spec(&[(table, &format!("{table}\n{more}"))]);
    let bench = ran(&[]);
    let flights = "path = \"flights/\"";
    let code = |text: &str, table: &str, to: &str| {
        bench.spec(text);
        let done = bench.run(&[]);
        assert_eq!(done.code, 0, "{}", done.stderr);
        let output = publish(&bench, &[table], &["--to", to]);
        (output.status.code(), stderr(&output))
    };
    let (status, message) = code(&of(flights, "restricted = true"), "terms", "a");
    assert_eq!(status, Some(2), "{message}");
    assert_eq!(code(&of(flights, "restricted = true"), "scores", "b").0, Some(0));
    let (status, message) = code(&of(flights, "embargo = \"2999-01-01\""), "even", "c");
    assert!(status == Some(2) && message.contains("until 2999-01-01"), "{message}");
    assert_eq!(code(&of(flights, "embargo = \"2020-01-01\""), "even", "d").0, Some(0));
    // Values from a restricted map are restricted.
    let map = "path = \"map.parquet\"";
    let (status, message) = code(&of(map, "restricted = true"), "track", "e");
    assert!(status == Some(2) && message.contains("anomaly.anomaly"), "{message}");
    assert_eq!(code(&of(map, "restricted = true"), "clean", "f").0, Some(0));
    // A misspelt column name would protect no column.
    bench.spec(&of(flights, "restricted = [\"mag_1c\"]"));
    let message = refused(&bench.magline(&["check", "spec.toml"]));
    assert!(message.contains("did you mean `mag_1_c`?"), "{message}");
    // Restricted inputs are not copied.
    bench.spec(&of(flights, "restricted = [\"mag_1_c\"]").replace("date ", "include_inputs = true\ndate "));
    assert_eq!(bench.run(&[]).code, 0);
    let message = refused(&publish(&bench, &["scores"], &["--to", "g"]));
    assert!(message.contains("`flights` is restricted"), "{message}");
}
