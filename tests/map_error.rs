//! The node error of a map is part of a filter's assumed noise, for maps from a stage and from a file.

use arrow_array::RecordBatch;

use crate::support::{Bench, anomaly, batch, changed, map, numbers, read, repository, stderr, texts, with_keys, write};

const FILES: &str = r#"
name  = "known"
store = "store"

[tables.flights]
path = "flights/"

[tables.points]
path = "points.parquet"

[tables.file]
path = "errors.parquet"

[tables.plain]
path = "map.parquet"
"#;

const GRIDDED: &str = r#"
[[stages]]
name           = "gridded"
stage          = "map_grid"
input          = "points"
spacing_m      = 400.0
level_m        = 300.0
cross_validate = 4
"#;

/// Map of the flights with the standard deviation of its node error: 40 nT west of the longitude of 10 degrees, and 1
/// nT east of it.
fn with_errors() -> RecordBatch {
    let map = map();
    let column = |name: &str| numbers(std::slice::from_ref(&map), name);
    let error = column("lon").iter().map(|lon| if *lon < 10.0 { 40.0 } else { 1.0 }).collect();
    let [lat, lon, alt, anomaly] = ["lat", "lon", "alt", "anomaly"].map(column);
    batch(&[("lat", lat), ("lon", lon), ("alt", alt), ("anomaly", anomaly), ("error", error)])
}

/// Twenty-one lines northward over the map.
fn survey() -> Vec<RecordBatch> {
    let line = |k: usize| {
        let lon = 9.92 + 0.008 * k as f64;
        let lat: Vec<f64> = (0..120).map(|i| 44.92 + 0.0013 * f64::from(i)).collect();
        let columns = batch(&[
            ("tt", (0..120).map(|i| 1000.0 * k as f64 + f64::from(i)).collect()),
            ("lon", vec![lon; 120]),
            ("alt", vec![300.0; 120]),
            ("anomaly", lat.iter().map(|lat| anomaly(*lat, lon)).collect()),
            ("lat", lat),
        ]);
        with_keys("9", &format!("9.{k:02}"), &columns)
    };
    (0..21).map(line).collect()
}

fn bench() -> Bench {
    let bench = Bench::new();
    write(&bench.path("points.parquet"), &survey());
    write(&bench.path("errors.parquet"), &[with_errors()]);
    bench
}

fn navigate(name: &str, map: &str, keys: &str) -> String {
    format!(
        "[[stages]]\nname = \"{name}\"\nstage = \"navigate\"\ntuning = \"magnav\"\ninput = \"flights\"\n\
         map = \"{map}\"\nmag = \"mag_1_c\"\n\
         core_field = false\nmeasurement_sigma_nt = 2.0\ninit_position_sigma_m = 50.0\n{keys}\n"
    )
}

#[test]
fn user_the_node_error_of_a_map_increases_the_position_uncertainty() {
    let bench = bench();
    let key = "map_error_length_m = 500.0";
    let stages = [
        navigate("by_stage", "gridded", key),
        navigate("by_stage_exact", "gridded", ""),
        navigate("by_file", "file", key),
        navigate("by_file_exact", "file", ""),
    ];
    bench.spec(&format!("{FILES}{GRIDDED}{}", stages.concat()));
    let run = bench.run(&[]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let sd = |table: &str| {
        let sd = numbers(&read(&bench.path(&format!("store/tables/known/{table}"))), "sd_n");
        sd.iter().sum::<f64>() / sd.len() as f64
    };
    assert!(sd("by_stage") > 1.02 * sd("by_stage_exact"), "{} {}", sd("by_stage"), sd("by_stage_exact"));
    assert!(sd("by_file") > 1.5 * sd("by_file_exact"), "{} {}", sd("by_file"), sd("by_file_exact"));
}

#[test]
fn user_a_map_without_node_errors_is_rejected_before_the_run() {
    let bench = bench();
    for (map, more) in [("plain", ""), ("bare", GRIDDED)] {
        let more = more.replace("gridded", "bare").replace("cross_validate = 4\n", "");
        let spec = navigate("track", map, "map_error_length_m = 500.0");
        bench.spec(&format!("{FILES}{more}{spec}"));
        let output = bench.magline(&["check", "spec.toml"]);
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        let message = stderr(&output);
        assert!(message.contains("map_error_length_m") && message.contains("`error`"), "{message}");
    }
    // With invalid standard deviations in this column the map is readable, but the key is rejected.
    write(&bench.path("errors.parquet"), &[changed(&with_errors(), "error", |_, error| -error)]);
    bench.spec(&format!("{FILES}{}", navigate("track", "file", "map_error_length_m = 500.0")));
    assert_ne!(bench.run(&[]).code, 0);
    bench.spec(&format!("{FILES}{}", navigate("track", "file", "")));
    assert_eq!(bench.run(&[]).code, 0);
}

#[test]
fn law_the_error_between_the_nodes_of_a_coarse_map_is_part_of_the_noise() {
    let map = repository().join("datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif").display().to_string();
    let bench = Bench::new();
    let flight = format!(
        "preset = \"cessna\"\nseed = 1\nrate_hz = 1.0\n[map]\npath = \"{map}\"\nalt_m = 500.0\n[ins]\n\
         grade = \"navigation\"\n[[flights]]\nname = \"plan\"\n[[flights.lines]]\nname = \"L1\"\nkind = \"survey\"\n\
         alt_m = 500.0\nduration_s = 1800.0\nwaypoints = [[-22.10, 140.58], [-21.84, 140.58], [-21.84, 140.78], \
         [-22.10, 140.78]]\n"
    );
    std::fs::write(bench.path("plan.synth.toml"), flight).unwrap();
    bench.spec(&format!(
        "name = \"coarse\"\nstore = \"store\"\n[tables.flights]\npath = \"plan.synth.toml\"\n[tables.fine]\n\
         path = \"{map}\"\n\
         alt_m = 500.0\n[axes]\nspacing = [100.0, 400.0, 800.0]\n[[stages]]\nname = \"anomaly\"\n\
         stage = \"map_convert\"\n\
         map = \"fine\"\nspacing = \"$spacing\"\n[[stages]]\nname = \"track\"\nstage = \"navigate\"\n\
         input = \"flights\"\n\
         map = \"anomaly\"\nmag = \"mag_1_c\"\n[[stages]]\nname = \"scores\"\nstage = \"score\"\n\
         input = [\"flights\", \"track\"]\nmetrics = [\"drms\", \"nees\"]\n"
    ));
    let done = bench.magline(&["run", "spec.toml"]);
    assert_eq!(done.status.code(), Some(0), "{}", stderr(&done));
    let scores = read(&bench.path("store/tables/coarse/scores"));
    let (metric, value, spacing) = (texts(&scores, "metric"), numbers(&scores, "value"), numbers(&scores, "spacing"));
    let of = |name: &str, cell_m: f64| {
        (0..value.len()).find(|at| metric[*at] == name && spacing[*at] == cell_m).map(|at| value[at]).unwrap()
    };
    // Without this noise: 40 m and NEES 67 with nodes 400 m apart, 238 m and 51 with nodes 800 m apart.
    assert!(of("drms", 400.0) < 25.0 && of("drms", 800.0) < 120.0, "{value:?}");
    assert!((0.3..8.0).contains(&of("nees", 400.0)) && (0.3..8.0).contains(&of("nees", 800.0)), "{value:?}");
    assert!(of("drms", 100.0) < 5.0, "{value:?}");
}
