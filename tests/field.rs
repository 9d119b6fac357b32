//! Earth's field: the stage, the SQL functions, the map at the samples, and the metrics of the map.

use std::collections::BTreeMap;

use crate::support::{Bench, anomaly, batch, numbers, read, stderr, stdout, texts, with_keys, write};

/// Flight whose measured field is the sum of core field, diurnal variation and map, with year and day.
fn flight() -> Bench {
    let bench = Bench::new();
    let n = 400;
    let each = |f: &dyn Fn(f64) -> f64| (0..n).map(|i| f(f64::from(i))).collect::<Vec<f64>>();
    let (lat, lon) = (each(&|i| 44.93 + 3e-4 * i), each(&|i| 9.95 + 2e-4 * i + 0.01 * (0.02 * i).sin()));
    let line = batch(&[
        ("tt", each(&|i| 36_000.0 + 0.1 * i)),
        ("lat", lat.clone()),
        ("lon", lon.clone()),
        ("alt", each(&|i| 300.0 + i)),
        ("year", vec![2024.0; n as usize]),
        ("doy", vec![60.0; n as usize]),
        ("roll", each(&|i| 20.0 * (0.1 * i).sin())),
        ("pitch", each(&|i| 5.0 * (0.07 * i).cos())),
        ("yaw", each(&|i| 30.0 + 0.2 * i)),
        ("diurnal", each(&|i| 0.01 * i)),
        ("mag_1_c", (0..n as usize).map(|i| anomaly(lat[i], lon[i])).collect()),
    ]);
    std::fs::remove_dir_all(bench.path("flights")).unwrap();
    std::fs::create_dir(bench.path("flights")).unwrap();
    write(&bench.path("flights/1.parquet"), &[with_keys("1", "1.01", &line)]);
    bench.spec(SPEC);
    bench
}

const SPEC: &str = r#"
name  = "field"
seed  = 1
store = "store"

[tables.flights]
path = "flights/"

[tables.anomaly]
path = "map.parquet"

[[stages]]
name  = "core"
stage = "core_field"
input = "flights"

[[stages]]
name              = "map"
stage             = "map_value"
position          = "truth"
input             = "core"
map               = "anomaly"
map_interpolation = "cubic"
carry             = ["lat", "lon", "alt"]

[[stages]]
name  = "scores"
stage = "score"
input = "map"
mag   = "mag_1_c"
truth = "mag_1_c"
"#;

#[test]
fn val_the_stage_and_sql_agree_and_the_body_frame_preserves_the_magnitude() {
    let bench = flight();
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let core = read(&bench.path("store/tables/field/core"));
    let column = |name: &str| numbers(&core, name);
    let length = |names: [&str; 3]| -> Vec<f64> {
        let [a, b, c] = names.map(column);
        (0..a.len()).map(|i| (a[i] * a[i] + b[i] * b[i] + c[i] * c[i]).sqrt()).collect()
    };
    let (ned, body) = (length(["igrf_n", "igrf_e", "igrf_d"]), length(["igrf_x", "igrf_y", "igrf_z"]));
    for (i, magnitude) in column("igrf").iter().enumerate() {
        assert!((magnitude - ned[i]).abs() < 1e-9 && (magnitude - body[i]).abs() < 1e-9);
        // Northern Italy in 2024: 47,900 nT.
        assert!((magnitude - 47_900.0).abs() < 300.0, "{magnitude}");
    }
    let query = "SELECT max(abs(igrf - igrf(lat, lon, alt, 2024 + (59 + tt / 86400) / 366))) AS d, \
                 max(abs(igrf_d - igrf_d(lat, lon, alt, 2024 + (59 + tt / 86400) / 366))) AS down, \
                 max(abs(igrf - wmm(lat, lon, alt, 2024.1626))) AS models FROM field.core";
    let output = bench.magline(&["sql", query, "--format", "json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let row: BTreeMap<String, f64> = serde_json::from_str(&stdout(&output)).unwrap();
    // The sums are equal except for the rounding of the year.
    assert!(row["d"] < 1e-6 && row["down"] < 1e-6, "{row:?}");
    // Both core-field models predict from about 2020 and differ by less than 100 nT.
    assert!(row["models"] > 0.1 && row["models"] < 100.0, "{row:?}");
}

#[test]
fn law_map_value_interpolates_the_map() {
    let bench = flight();
    assert_eq!(bench.run(&[]).code, 0);
    let map = read(&bench.path("store/tables/field/map"));
    let (lat, lon) = (numbers(&map, "lat"), numbers(&map, "lon"));
    let (value, north) = (numbers(&map, "map_anomaly"), numbers(&map, "map_grad_n"));
    for i in 0..lat.len() {
        // With nodes every 0.55 rad of the wave, a spline has an error of a few 1e-4 of the amplitude of 210 nT.
        assert!((value[i] - anomaly(lat[i], lon[i])).abs() < 0.6, "{i}: {}", value[i] - anomaly(lat[i], lon[i]));
        let step = 1e-6;
        let slope = (anomaly(lat[i] + step, lon[i]) - anomaly(lat[i] - step, lon[i])) / (2.0 * step) / 111_130.0;
        assert!((north[i] - slope).abs() < 0.01, "{i}: {} {slope}", north[i]);
    }
    let scores = read(&bench.path("store/tables/field/scores"));
    let metric: BTreeMap<String, f64> = texts(&scores, "metric").into_iter().zip(numbers(&scores, "value")).collect();
    for name in ["map_std_error", "map_bias_error", "map_gradient_along_track", "map_position_bound"] {
        assert!(metric[name].is_finite(), "{name}");
    }
    // The signal of this flight has no core field. The bias of the map is therefore minus the core field and the 2 nT
    // of the diurnal variation.
    assert!((metric["map_bias_error"] + 47_900.0).abs() < 300.0, "{metric:?}");
    // 400 samples of 5 nT over slopes of about 0.2 nT/m.
    assert!(metric["map_position_bound"] > 0.3 && metric["map_position_bound"] < 10.0, "{metric:?}");
}

#[test]
fn law_map_levels_follow_the_flight_height() {
    let bench = flight();
    bench.spec(
        &SPEC.replace(
            "input             = \"core\"",
            "input             = \"core\"\nmap_levels_m = [300.0, 500.0, 700.0]",
        ),
    );
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let map = read(&bench.path("store/tables/field/map"));
    let (lat, lon, alt) = (numbers(&map, "lat"), numbers(&map, "lon"), numbers(&map, "alt"));
    let (value, up) = (numbers(&map, "map_anomaly"), numbers(&map, "map_grad_u"));
    let middle: Vec<usize> = (0..lat.len()).filter(|i| (0.03..0.17).contains(&(lat[*i] - 44.9))).collect();
    assert!(middle.len() > 100);
    for i in middle {
        // Each wave of the map decays with height as exp(-k h). The first wave has 220 rad per degree of latitude.
        let h = alt[i] - 300.0;
        let (m_lat, m_lon) = (111_130.0, 78_850.0);
        let (a, b, c) = (220.0 / m_lat, 180.0 / m_lon, 50.0 / m_lat);
        let first = 120.0 * (220.0 * (lat[i] - 45.0)).sin() * (-a * h).exp();
        let k = f64::hypot(b, c);
        let second = 90.0 * (180.0 * (lon[i] - 10.0) + 50.0 * (lat[i] - 45.0)).cos() * (-k * h).exp();
        // The map is 4 wavelengths wide, so the unknown field beyond its edges contributes a few percent of 210 nT.
        assert!((value[i] - first - second).abs() < 8.0, "{i} {h}: {} {}", value[i], first + second);
        assert!((up[i] + a * first + k * second).abs() < 0.05, "{i} {h}: {} {}", up[i], -a * first - k * second);
    }
    let wrong = SPEC.replace("map               = \"anomaly\"", "map = \"anomaly\"\nmap_levels_m = [500.0, 300.0]");
    bench.spec(&wrong);
    let refused = bench.run(&[]);
    assert_eq!(refused.code, 2);
    assert!(refused.stderr.contains("ascend"), "{}", refused.stderr);
}

#[test]
fn gold_a_core_field_without_a_date_is_rejected() {
    let bench = Bench::new();
    bench.spec(SPEC);
    let refused = bench.run(&[]);
    assert_eq!(refused.code, 2);
    assert!(refused.stderr.contains("needs a date"), "{}", refused.stderr);
    assert!(refused.stderr.contains("decimal_year"), "{}", refused.stderr);
    bench.spec(
        &SPEC.replace("stage = \"core_field\"", "stage = \"core_field\"\nmodel = \"wmm\"\ndecimal_year = 2015.0"),
    );
    let failed = bench.run(&[]);
    assert_eq!(failed.code, 1);
    assert!(failed.stderr.contains("2020") || failed.last.to_string().contains("failed"), "{}", failed.stderr);
    let reasons = texts(&read(&bench.path("store/tables/field/failures")), "error");
    assert!(reasons.iter().any(|r| r.contains("WMM covers the years 2020 to 2030")), "{reasons:?}");
}
