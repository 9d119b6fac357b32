//! All filters in one sweep: flights with known truth over the real map of Osborne.

use std::{collections::BTreeMap, fs};

use crate::support::{Bench, numbers, read, repository, stderr, texts};

/// Forty flights of 20 min. The errors of each flight are drawn from the default assumptions of `navigate`.
fn flights(magnetometers: &str) -> String {
    let map = repository().join("datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif");
    format!(
        r#"
seed    = 11
year    = 2024
doy     = 100
rate_hz = 1.0
{magnetometers}
[map]
path  = "{}"
alt_m = 500.0
[ins]
align = "line"
[diurnal]
sigma_nt = 3.0
tau_s    = 600.0
[[flights]]
name   = "mc"
copies = 40
[[flights.lines]]
name       = "1"
kind       = "survey"
alt_m      = 500.0
speed_mps  = 60.0
duration_s = 1200.0
waypoints  = [[-22.12, 140.56], [-21.82, 140.60], [-21.82, 140.70], [-22.12, 140.74]]
"#,
        map.display()
    )
}

fn spec(filters: &str, stage: &str) -> String {
    let map = repository().join("datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif");
    format!(
        r#"
name  = "filters"
store = "store"
[tables.flights]
path = "flights.synth.toml"
[tables.anomaly]
path  = "{}"
alt_m = 500.0
[axes]
filter = [{filters}]
[[stages]]
name              = "track"
stage             = "navigate"
tuning            = "magnav"
input             = "flights"
map               = "anomaly"
mag               = "mag_1_uc"
filter            = "$filter"
map_interpolation = "cubic"
remove_diurnal    = false
{stage}
[[stages]]
name    = "scores"
stage   = "score"
input   = ["flights", "track"]
metrics = ["drms", "ins_drms", "nees", "nis"]
"#,
        map.display()
    )
}

const CLEAN: &str = "[[magnetometers]]\nname = \"mag_1_uc\"\nnoise_nt = 5.0";

fn bench(magnetometers: &str, filters: &str, stage: &str) -> Bench {
    let bench = Bench::new();
    fs::write(bench.path("flights.synth.toml"), flights(magnetometers)).unwrap();
    bench.spec(&spec(filters, stage));
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{} {}", done.last, done.stderr);
    bench
}

/// Mean of a metric over the flights and its standard error, by filter.
fn means(bench: &Bench, metric: &str) -> BTreeMap<String, (f64, f64)> {
    let scores = read(&bench.path("store/tables/filters/scores"));
    let (filters, metrics, values) = (texts(&scores, "filter"), texts(&scores, "metric"), numbers(&scores, "value"));
    let mut of: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for row in (0..values.len()).filter(|row| metrics[*row] == metric) {
        of.entry(filters[row].clone()).or_default().push(values[row]);
    }
    let mean = |(filter, values): (String, Vec<f64>)| {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let square = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
        (filter, (mean, (square / n).sqrt()))
    };
    of.into_iter().map(mean).collect()
}

#[test]
fn law_every_filter_is_consistent_and_near_the_cramer_rao_bound() {
    let filters = r#""ins_only", "ekf", "iekf", "ukf", "ekf_adaptive", "rts", "mpf", "crlb""#;
    let bench = bench(CLEAN, filters, "");
    let (drms, nees, nis) = (means(&bench, "drms"), means(&bench, "nees"), means(&bench, "nis"));
    let ins = drms["ins_only"].0;
    for filter in ["ekf", "iekf", "ukf", "ekf_adaptive", "rts", "mpf"] {
        // The expected value is 2 for two coordinates. The errors of a flight are correlated over minutes, so each
        // flight is one draw. The tolerance is four standard errors.
        let (mean, error) = nees[filter];
        assert!((mean - 2.0).abs() < 4.0 * error && error < 0.5, "{filter}: NEES {mean} ± {error}");
        let (mean, error) = nis[filter];
        // The inverse of a variance estimated from 50 samples is 1 + 2/50 times too large on average.
        let expected = if filter == "ekf_adaptive" { 1.04 } else { 1.0 };
        assert!((mean - expected).abs() < (4.0 * error).max(0.02), "{filter}: NIS {mean} ± {error}");
        assert!(drms[filter].0 < 0.25 * ins, "{filter}: {} m of {ins} m", drms[filter].0);
    }
    let (mean, error) = nees["ins_only"];
    assert!((mean - 2.0).abs() < 4.0 * error, "ins_only: NEES {mean} ± {error}");
    // The track holds the bound as standard deviations. The mean of the variances of the bound is the smallest possible
    // mean squared error.
    let track = read(&bench.path("store/tables/filters/track"));
    let (filters, north, east) = (texts(&track, "filter"), numbers(&track, "sd_n"), numbers(&track, "sd_e"));
    let squares = |of: &str| -> Vec<f64> {
        let rows = (0..filters.len()).filter(|row| filters[*row] == of);
        rows.map(|row| north[row].powi(2) + east[row].powi(2)).collect()
    };
    let rms = |x: &[f64]| (x.iter().sum::<f64>() / x.len() as f64).sqrt();
    let bound = rms(&squares("crlb"));
    // The mean of a root is slightly below the root of the mean. A smoother has a smaller error than any filter.
    assert!(drms["ekf"].0 < 1.2 * bound && drms["ekf"].0 > 0.7 * bound, "{} {bound}", drms["ekf"].0);
    assert!(drms["rts"].0 < 0.9 * drms["ekf"].0, "{} {}", drms["rts"].0, drms["ekf"].0);
}

#[test]
fn law_a_tenfold_error_of_the_assumed_noise_is_estimated() {
    let keys = "measurement_sigma_nt = 0.5\nsigma_max_nt = 50.0";
    let adaptive = bench(CLEAN, r#""ekf_adaptive""#, keys);
    let fixed = bench(CLEAN, r#""ekf""#, "measurement_sigma_nt = 0.5");
    let right = bench(CLEAN, r#""ekf""#, "");
    let of = |bench: &Bench, filter: &str| means(bench, "drms")[filter].0;
    let (adaptive, fixed, right) = (of(&adaptive, "ekf_adaptive"), of(&fixed, "ekf"), of(&right, "ekf"));
    assert!(adaptive < 1.2 * right && adaptive < 0.8 * fixed, "{adaptive} {fixed} {right}");
}

#[test]
fn law_varying_noise_from_a_column_gives_a_consistent_filter() {
    let bench = Bench::new();
    let two = "[[magnetometers]]\nname = \"mag_1_uc\"\nnoise_nt = 2.0\n[[magnetometers]]\nname = \"mag_2_uc\"\n\
               noise_nt = 40.0";
    fs::write(bench.path("flights.synth.toml"), flights(two)).unwrap();
    // Five minutes of the quiet sensor alternate with five minutes of the noisy sensor.
    let choice =
        |noisy: &str, quiet: &str| format!("case when sin(tt * 0.0104719755) > 0 then {noisy} else {quiet} end");
    let derive = format!(
        "[[stages]]\nname = \"mixed\"\nstage = \"derive\"\ninput = \"flights\"\n\
         columns = {{ measured = \"{}\", sigma = \"{}\", half = \"{}\" }}\n\
         units = {{ sigma = \"nT\", half = \"nT\" }}\n",
        choice("mag_2_uc", "mag_1_uc"),
        choice("40.0", "2.0"),
        choice("20.0", "1.0")
    );
    let base = spec("\"none\"", "");
    let (head, _) = base.split_once("[axes]").unwrap();
    let ways = [
        ("fixed", "filter = \"ekf\"\nmeasurement_sigma_nt = 2.0"),
        ("mean", "filter = \"ekf\"\nmeasurement_sigma_nt = 28.3"),
        ("known", "filter = \"ekf\"\nmeasurement_sigma_nt = 0.01\nnoise_column = \"sigma\""),
        (
            "learnt",
            "filter = \"ekf_adaptive\"\nmeasurement_sigma_nt = 0.01\nnoise_column = \"half\"\nsigma_min_nt = 2.0",
        ),
        ("blind", "filter = \"ekf_adaptive\"\nmeasurement_sigma_nt = 14.0\nsigma_min_nt = 2.0"),
    ];
    let mut text = format!("{head}{derive}");
    for (name, keys) in ways {
        text.push_str(&format!(
            "[[stages]]\nname = \"track_{name}\"\nstage = \"navigate\"\ntuning = \"magnav\"\ninput = \"mixed\"\n\
             map = \"anomaly\"\nmag = \"measured\"\n\
             map_interpolation = \"cubic\"\nremove_diurnal = false\n{keys}\n\
             [[stages]]\nname = \"scores_{name}\"\nstage = \"score\"\ninput = [\"mixed\", \"track_{name}\"]\n\
             metrics = [\"drms\", \"nees\", \"nis\"]\n"
        ));
    }
    bench.spec(&text);
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{} {}", done.last, done.stderr);
    let of = |name: &str, metric: &str| -> (f64, f64) {
        let scores = read(&bench.path("store/tables/filters").join(format!("scores_{name}")));
        let all = texts(&scores, "metric").into_iter().zip(numbers(&scores, "value"));
        let values: Vec<f64> = all.filter(|(m, _)| m == metric).map(|(_, value)| value).collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        (mean, (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt())
    };
    for (name, _) in ways {
        let ((drms, _), (nees, error), (nis, _)) = (of(name, "drms"), of(name, "nees"), of(name, "nis"));
        println!("{name}: DRMS {drms:.1} m, NEES {nees:.2} ± {error:.2}, NIS {nis:.2}");
    }
    let (nees, error) = of("known", "nees");
    assert!((nees - 2.0).abs() < 4.0 * error && error < 0.5, "NEES {nees} ± {error}");
    let (nis, error) = of("known", "nis");
    assert!((nis - 1.0).abs() < (4.0 * error).max(0.02), "NIS {nis} ± {error}");
    let best = of("known", "drms").0;
    // With half the noise assumed and the factor estimated, the filter is nearly as good. Without the column, the
    // filter is less accurate.
    assert!(of("learnt", "nees").0 < 3.0 && of("learnt", "drms").0 < 1.25 * best);
    assert!(of("blind", "nees").0 > of("learnt", "nees").0 && of("blind", "drms").0 > of("learnt", "drms").0);
    // A constant assumed noise fails in both cases. With the noise of the quiet times the filter diverges. With the
    // mean noise the NIS is right on average, but the information of the quiet times is lost.
    assert!(of("fixed", "nees").0 > 100.0 && of("fixed", "nis").0 > 100.0);
    assert!(of("mean", "drms").0 > 1.5 * best, "{} {best}", of("mean", "drms").0);
}

#[test]
fn law_gnss_is_used_before_and_after_an_outage() {
    let keys = "gnss_lost_s = [300.0, 900.0]\ngnss_sigma_m = 2.0";
    let aided = bench(CLEAN, r#""ins_only", "ekf", "rts""#, keys);
    let free = bench(CLEAN, r#""ins_only", "ekf", "rts""#, "");
    let (aided, free) = (means(&aided, "drms"), means(&free, "drms"));
    for filter in ["ins_only", "ekf", "rts"] {
        assert!(aided[filter].0 < 0.9 * free[filter].0, "{filter}: {} {}", aided[filter].0, free[filter].0);
    }
    assert!(aided["ekf"].0 < aided["ins_only"].0, "the field is worth something while GNSS is lost");
}

/// Spec with two magnetometers 15 m apart along the body axis.
fn two_magnetometers(filters: &str, stage: &str) -> String {
    let keys = r#"gradient = ["mag_2_uc", "mag_3_uc"]
gradient_baseline_m = [15.0, 0.0, 0.0]
gradient_sigma_nt = 0.05
gradient_bias_sigma_nt = 0.0
gradient_slope_sigma = 0.0
map_levels_m = [500.0]"#;
    spec(filters, &format!("{keys}\n{stage}"))
}

/// A storm of 100 nT that changes within a minute.
fn in_a_storm(magnetometers: &str) -> String {
    flights(magnetometers).replace("sigma_nt = 3.0\ntau_s    = 600.0", "sigma_nt = 100.0\ntau_s    = 60.0")
}

#[test]
fn law_a_difference_of_magnetometers_navigates_through_a_storm() {
    let filters = r#""ekf", "iekf", "ukf""#;
    let one = |number: u8, ahead_m: f64, noise: f64| {
        format!("[[magnetometers]]\nname = \"mag_{number}_uc\"\narm_m = [{ahead_m:?}, 0.0, 0.0]\nnoise_nt = {noise}\n")
    };
    let magnetometers = [one(1, 0.0, 5.0), one(2, 7.5, 0.035), one(3, -7.5, 0.035)].concat();
    let run = |spec: &str| {
        let bench = Bench::new();
        fs::write(bench.path("flights.synth.toml"), in_a_storm(&magnetometers)).unwrap();
        bench.spec(spec);
        let done = bench.run(&[]);
        assert_eq!(done.code, 0, "{} {}", done.last, done.stderr);
        bench
    };
    let difference = run(&two_magnetometers(filters, "use_scalar = false"));
    let scalar = run(&spec(filters, ""));
    let (held, lost) = (means(&difference, "drms"), means(&scalar, "drms"));
    let (nees, nis, spoilt) = (means(&difference, "nees"), means(&difference, "nis"), means(&scalar, "nees"));
    let ins = means(&difference, "ins_drms");
    println!("difference {held:?}, scalar {lost:?}, INS {ins:?}, NEES {nees:?}, NIS {nis:?}, scalar NEES {spoilt:?}");
    for filter in ["ekf", "iekf", "ukf"] {
        assert!(held[filter].0 < 0.25 * ins[filter].0, "{filter}: {:?} {:?}", held[filter], ins[filter]);
        assert!(spoilt[filter].0 > 20.0 && lost[filter].0 > 3.0 * held[filter].0, "{filter}: {:?}", spoilt[filter]);
        // The tolerance is four standard errors. The unscented filter treats the curvature of the map as noise and is
        // cautious.
        let (mean, error) = nees[filter];
        let cautious = filter == "ukf" && mean < 2.0;
        assert!(cautious || (mean - 2.0).abs() < 4.0 * error, "{filter}: NEES {mean} ± {error}");
        // The assumed noise omits slope errors between the nodes of the map, which are 100 m apart.
        assert!((nis[filter].0 - 1.0).abs() < 0.3, "{filter}: NIS {:?}", nis[filter]);
    }
}

#[test]
fn user_samples_over_a_flat_map_are_reported() {
    let bench = bench(CLEAN, r#""ekf", "ukf""#, "flat_over_m = 100.0");
    let scores = read(&bench.path("store/tables/filters/scores"));
    assert!(texts(&scores, "metric").iter().any(|metric| metric == "drms"));
    bench.spec(
        &spec(r#""ekf""#, "flat_over_m = 100.0").replace("\"nis\"]", "\"nis\", \"samples_flat\", \"samples_used\"]"),
    );
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{} {}", done.last, done.stderr);
    let (flat, used) = (means(&bench, "samples_flat")["ekf"].0, means(&bench, "samples_used")["ekf"].0);
    assert!(flat > 100.0 && used > 10.0, "{flat} {used}");
    let track = read(&bench.path("store/tables/filters/track"));
    let (words, slopes) = (texts(&track, "update"), numbers(&track, "map_slope"));
    // 5 nT over 100 m are 0.05 nT/m.
    assert!((0..words.len()).all(|row| (words[row] == "flat") == (slopes[row] < 0.05)));
}

#[test]
fn user_keys_of_other_filters_are_rejected_with_the_owning_filter() {
    let bench = Bench::new();
    fs::write(bench.path("flights.synth.toml"), flights(CLEAN)).unwrap();
    for (filter, key, words) in [
        ("ekf", "particles = 10", "belongs to `mpf`, `mpf_then_ekf` and `slam`"),
        ("mpf", "window_s = 10.0", "belongs to `fixed_lag`"),
        ("ekf", "gnss_sigma_m = 1.0", "no effect without `gnss_lost_s`"),
        ("ekf", "gnss_lost_s = [10.0]", "gnss_lost_s"),
        ("ekf", "dead_zones = \"polar\"", "`vector`"),
        ("ekf", "dead_zones = \"everywhere\"", "everywhere"),
        ("ekf", "ins_grade = \"car\"", "car"),
        ("rts", "loss = \"absolute\"", "absolute"),
        ("slam", "gradient = [\"mag_1_uc\", \"mag_1_uc\"]", "belongs to `ekf`"),
        ("mpf", "flat_over_m = 10.0", "not available"),
        ("ekf", "gradient = [\"mag_1_uc\", \"mag_2_uc\"]\ngradient_baseline_m = [9, 0, 0]", "mag_2_uc"),
        ("ekf", "use_scalar = false", "no measurement depends on the map"),
        ("ukf", "vector_sigma_nt = 5.0", "`vector`"),
        ("ekf_online_tl", "", "`tl`"),
        ("ekf_online_nn", "features = \"lat\"", "not a list of features"),
        ("kalman", "", "kalman"),
    ] {
        bench.spec(&spec(&format!("\"{filter}\""), key));
        let checked = bench.magline(&["check", "spec.toml"]);
        let message = stderr(&checked);
        assert_eq!(checked.status.code(), Some(2), "{filter} {key}: {message}");
        assert!(message.contains(words), "{filter} {key}: {message}");
    }
}

#[test]
fn user_tracks_have_the_same_bytes_on_one_thread_and_on_two() {
    let filters = r#""ekf", "iekf", "ukf", "ekf_adaptive", "rts", "mpf", "slam", "crlb", "ins_only""#;
    let few = flights(CLEAN).replace("copies = 40", "copies = 2").replace("duration_s = 1200.0", "duration_s = 300.0");
    let bytes = |threads: &str| {
        let bench = Bench::new();
        fs::write(bench.path("flights.synth.toml"), &few).unwrap();
        bench.spec(&spec(filters, ""));
        let done = bench.run(&["--threads", threads]);
        assert_eq!(done.code, 0, "{} {}", done.last, done.stderr);
        bench.tables("store")
    };
    let (one, two) = (bytes("1"), bytes("2"));
    assert!(one.len() > 2 && one.keys().eq(two.keys()));
    let differs: Vec<&String> =
        one.iter().filter(|(name, bytes)| two[*name] != **bytes).map(|(name, _)| name).collect();
    assert!(differs.iter().all(|name| !name.ends_with(".parquet")), "{differs:?}");
}
