//! Results can be queried in SQL, and traced to their bytes.

use arrow_schema::DataType;
use serde_json::Value;

use crate::support::{Bench, numbers, read, stderr, stdout, texts};

/// A workspace whose spec has run.
pub fn ran() -> Bench {
    let bench = Bench::new();
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    bench
}

#[test]
fn user_sql_gives_the_least_error_of_each_combination() {
    let bench = ran();
    let query = "SELECT mag, vector, min(value) AS best FROM small.scores WHERE metric = 'std_error' GROUP BY mag, \
                 vector ORDER BY mag, vector";
    let output = bench.magline(&["sql", query, "--store", "store", "--format", "json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let rows: Vec<Value> = stdout(&output).lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    let scores = read(&bench.path("store/tables/small/scores"));
    let (mags, vectors, metrics, values) =
        (texts(&scores, "mag"), texts(&scores, "vector"), texts(&scores, "metric"), numbers(&scores, "value"));
    assert_eq!(rows.len(), 4);
    for row in rows {
        let mine = (0..values.len()).filter(|i| {
            metrics[*i] == "std_error" && row["mag"] == mags[*i].as_str() && row["vector"] == vectors[*i].as_str()
        });
        let best = mine.map(|i| values[i]).fold(f64::INFINITY, f64::min);
        assert_eq!(row["best"].as_f64().unwrap(), best);
    }
    let csv = bench.magline(&["sql", "SELECT count(*) AS n FROM small.clean", "--format", "csv"]);
    // Two lines of 700 samples and two lines of 500 samples, at 8 points.
    assert_eq!(stdout(&csv), "n\n19200\n");
}

#[test]
fn gold_sql_lists_the_tables() {
    let bench = ran();
    let output = bench.magline(&["sql", "SELECT * FROM small.score", "--store", "store"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("small.scores"), "{}", stderr(&output));
    let output = bench.magline(&["sql", "SELECT * FROM small.scores", "--store", "nowhere"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("run a spec first"), "{}", stderr(&output));
}

#[test]
fn user_published_tables_hold_the_axes_and_the_columns_of_the_stage() {
    let bench = ran();
    let clean = read(&bench.path("store/tables/small/clean"));
    assert_eq!(clean.iter().map(|b| b.num_rows()).sum::<usize>(), 19_200);
    let schema = clean[0].schema();
    let names: Vec<&str> = schema.fields().iter().map(|f| f.name().as_str()).collect();
    assert_eq!(names[..6], ["mag", "vector", "lambda", "flight", "line", "tt"]);
    // Passthrough columns stay in the tables of their stages.
    assert_eq!(
        names[6..],
        ["mag_c", "mag_aircraft", "mag_sigma", "mag_fogm_sigma", "mag_fogm_tau", "mag_aircraft_sigma"]
    );
    for table in ["even", "terms", "coefficients", "track", "scores"] {
        assert!(read(&bench.path("store/tables/small").join(table)).iter().any(|b| b.num_rows() > 0), "{table}");
    }
}

#[test]
fn user_axis_columns_have_their_types_and_fields_their_metadata() {
    let bench = ran();
    let clean = read(&bench.path("store/tables/small/clean"));
    let schema = clean[0].schema();
    assert_eq!(schema.field_with_name("lambda").unwrap().data_type(), &DataType::Float64);
    assert_eq!(schema.field_with_name("mag").unwrap().data_type(), &DataType::Utf8);
    assert_eq!(schema.field_with_name("mag_c").unwrap().metadata()["unit"], "nT");
    let terms = read(&bench.path("store/tables/small/terms"));
    let even = read(&bench.path("store/tables/small/even"));
    assert_eq!(even[0].schema().field_with_name("mag_1_c").unwrap().metadata()["role"], "truth");
    let terms = terms[0].schema();
    let terms = &terms.field_with_name("tl").unwrap().metadata()["terms"];
    assert_eq!(terms, "x,y,z,xx,xy,xz,yy,yz,zz,xx_dot,xy_dot,xz_dot,yx_dot,yy_dot,yz_dot,zx_dot,zy_dot,zz_dot");
}

#[test]
fn user_compensation_removes_an_exact_tolles_lawson_field() {
    let bench = ran();
    let scores = read(&bench.path("store/tables/small/scores"));
    let (metrics, values, lambdas) = (texts(&scores, "metric"), numbers(&scores, "value"), numbers(&scores, "lambda"));
    let vectors = texts(&scores, "vector");
    // The aircraft field is exactly Tolles-Lawson in flux_a. The residual is a tone of 0.05 nT and the map within the
    // band.
    let of = |metric: &str| -> Vec<f64> {
        (0..values.len())
            .filter(|i| metrics[*i] == metric && lambdas[*i] == 0.025 && vectors[*i] == "flux_a")
            .map(|i| values[i])
            .collect()
    };
    let (before, after) = (of("std_uncompensated"), of("std_error"));
    assert_eq!(before.len(), 8);
    for (before, after) in before.iter().zip(&after) {
        assert!(*after < 0.25 * before, "{after} of {before}");
    }
    let (drms, ins) = (of("drms"), of("ins_drms"));
    assert!(drms.iter().all(|d| d.is_finite()) && ins.iter().all(|d| *d > 1.0));
}

#[test]
fn user_lineage_ends_at_the_files() {
    let bench = ran();
    let tree = stdout(&bench.magline(&["lineage", "small.scores", "--store", "store"]));
    for word in [
        "scores  score",
        "track  navigate",
        "coefficients  fit",
        "where line like '%.01'",
        "flights/1.parquet",
        "map.parquet",
        "tl <- even.tt",
    ] {
        assert!(tree.contains(word), "{word} is not in\n{tree}");
    }
    let json: Value = serde_json::from_str(&stdout(&bench.magline(&["lineage", "clean", "--format", "json"]))).unwrap();
    assert_eq!(json["table"], "clean");
    let event: Value =
        serde_json::from_str(&stdout(&bench.magline(&["lineage", "clean", "--format", "openlineage"]))).unwrap();
    assert_eq!(event["eventType"], "COMPLETE");
    assert!(
        event["outputs"][0]["facets"]["columnLineage"]["fields"]["mag_c"]["inputFields"].as_array().unwrap().len() > 1
    );
    let wrong = bench.magline(&["lineage", "small.scroes"]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(stderr(&wrong).contains("did you mean `small.scores`?"), "{}", stderr(&wrong));
}

#[test]
fn gold_explain_lists_stored_and_missing_results() {
    let bench = Bench::new();
    let before = stdout(&bench.magline(&["explain", "spec.toml"]));
    assert!(before.contains("clean  compensate v4 <- terms, coefficients"), "{before}");
    assert!(before.contains("at 8 points: mag (2) x vector (2) x lambda (2); 4 lines"), "{before}");
    assert!(before.contains("0 of 32 stored, 32 to compute"), "{before}");
    bench.run(&[]);
    let after = stdout(&bench.magline(&["explain", "spec.toml"]));
    assert!(after.contains("32 of 32 stored, 0 to compute"), "{after}");
    assert!(after.contains("s each in the last run"), "{after}");
    assert!(after.contains("lambda=(varies)"), "{after}");
}
