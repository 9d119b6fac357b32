//! Navigation with default settings on flights of a simulator that shares no code with magline: a non-linear strapdown
//! INS, and the exact field of dipoles. `tests/cases/foreign/README.md` describes the flights.

use crate::support::{Bench, numbers, read, repository, stderr, texts};

/// A spec without any key of the filter. The INS is aligned at the start of each line; the flights do not say so.
/// `stages` make the table `input` from the table `flights`.
fn spec(flights: &str, stages: &str, input: &str) -> String {
    let folder = repository().join("tests/cases/foreign");
    let path = |name: &str| folder.join(name).display().to_string();
    format!(
        "name = \"foreign\"\nstore = \"store\"\n[tables.flights]\npath = \"{}\"\n[tables.anomaly]\npath = \"{}\"\n\
         {stages}[[stages]]\nname = \"track\"\nstage = \"navigate\"\ninput = \"{input}\"\nmap = \"anomaly\"\n\
         mag = \"mag_1_uc\"\n\
         remove_diurnal = false\n[[stages]]\nname = \"scores\"\nstage = \"score\"\ninput = [\"{input}\", \"track\"]\n\
         metrics = [\"ins_drms\", \"drms\", \"nees\", \"nis\", \"whiteness\", \"correlated_nis\"]\n",
        path(flights),
        path("map_800.parquet")
    )
}

/// Values of a metric, one for each line.
fn values(bench: &Bench, metric: &str) -> Vec<f64> {
    let scores = read(&bench.path("store/tables/foreign/scores"));
    let named = texts(&scores, "metric").into_iter().zip(numbers(&scores, "value"));
    named.filter(|(name, _)| name == metric).map(|(_, value)| value).collect()
}

#[test]
fn val_default_settings_are_near_the_bound_on_flights_of_another_simulator() {
    // The Cramér-Rao bound of these flights is 22.8 m rms; the INS alone is 2.4 and 2.6 km off.
    for flights in ["plain.parquet", "spikes.parquet"] {
        let bench = Bench::new();
        bench.spec(&spec(flights, "", "flights"));
        let done = bench.magline(&["run", "spec.toml"]);
        assert_eq!(done.status.code(), Some(0), "{}", stderr(&done));
        let rms = |of: &[f64]| (of.iter().map(|x| x * x).sum::<f64>() / of.len() as f64).sqrt();
        let (drms, nees) = (values(&bench, "drms"), values(&bench, "nees"));
        assert_eq!(drms.len(), 4);
        assert!(rms(&drms) < 28.0, "{flights}: {drms:?}");
        let mean = nees.iter().sum::<f64>() / nees.len() as f64;
        assert!((1.0..3.5).contains(&mean), "{flights}: {nees:?}");
    }
}

#[test]
fn val_late_time_stamps_are_found_flagged_and_corrected() {
    // Six samples of 0.1 s. A lag costs information: a filter that knows it to 1 s is 24 m off on flights like these,
    // instead of 22 m. Without a state for the lag, the positions of such flights are 47 m off, with a NEES of 8.
    let stages = "[[stages]]\nname = \"late\"\nstage = \"resample\"\ninput = \"flights\"\nrate_hz = 10.0\n\
                  lag_s = { mag_1_uc = -0.6 }\n";
    let bench = Bench::new();
    bench.spec(&spec("plain.parquet", stages, "late"));
    let done = bench.magline(&["run", "spec.toml"]);
    assert_eq!(done.status.code(), Some(0), "{}", stderr(&done));
    let drms = values(&bench, "drms");
    let rms = (drms.iter().map(|x| x * x).sum::<f64>() / drms.len() as f64).sqrt();
    assert!(rms < 33.0, "{drms:?}");
    let nees = values(&bench, "nees");
    assert!((0.8..3.5).contains(&(nees.iter().sum::<f64>() / nees.len() as f64)), "{nees:?}");
    let track = read(&bench.path("store/tables/foreign/track"));
    let [lag_s, sigma_s] = ["mag_latency", "mag_latency_sigma"].map(|name| numbers(&track, name));
    let (lag_s, sigma_s) = (lag_s[lag_s.len() - 1], sigma_s[sigma_s.len() - 1]);
    assert!((lag_s - 0.6).abs() < 4.0 * sigma_s && sigma_s < 0.1, "{lag_s} {sigma_s}");
    let warnings = read(&bench.path("store/tables/foreign/warnings"));
    let late = texts(&warnings, "kind").iter().filter(|kind| *kind == "late").count();
    assert_eq!(late, 4, "{:?}", texts(&warnings, "text"));
}

#[test]
fn val_a_barometer_that_is_60_m_off_is_found_flagged_and_corrected() {
    // Without a state for the height, the positions of these flights are 59 and 68 m off, with a NEES of 5 and 9.
    // The map is continued to given levels, or by default to the heights of the line.
    for (error_m, bias_m, given) in [(60.0, -60.0, true), (60.0, -60.0, false), (-60.0, 60.0, false), (0.0, 0.0, false)]
    {
        let stages = format!(
            "[[stages]]\nname = \"baro\"\nstage = \"derive\"\ninput = \"flights\"\n\
             columns = {{ ins_alt = \"ins_alt + {error_m:.1}\" }}\n"
        );
        let bench = Bench::new();
        let levels = "map_levels_m = [650.0, 700.0, 750.0, 800.0, 850.0, 900.0, 950.0]\n[[stages]]\nname = \"scores\"";
        let spec = spec("plain.parquet", &stages, "baro");
        bench.spec(&if given { spec.replace("[[stages]]\nname = \"scores\"", levels) } else { spec });
        let done = bench.magline(&["run", "spec.toml"]);
        assert_eq!(done.status.code(), Some(0), "{}", stderr(&done));
        let (drms, nees) = (values(&bench, "drms"), values(&bench, "nees"));
        let rms = (drms.iter().map(|x| x * x).sum::<f64>() / drms.len() as f64).sqrt();
        let mean = nees.iter().sum::<f64>() / nees.len() as f64;
        assert!(rms < 33.0 && (0.8..3.5).contains(&mean), "{error_m} {given}: {drms:?} {nees:?}");
        let track = read(&bench.path("store/tables/foreign/track"));
        let [found_m, sigma_m] = ["map_height_bias", "map_height_bias_sigma"].map(|name| numbers(&track, name));
        let warnings = read(&bench.path("store/tables/foreign/warnings"));
        let flagged = texts(&warnings, "kind").iter().filter(|kind| *kind == "height_bias").count();
        if bias_m == 0.0 {
            assert!(flagged == 0 && sigma_m.iter().all(|sigma_m| sigma_m.is_nan()), "{found_m:?}");
            continue;
        }
        let (found_m, sigma_m) = (found_m[found_m.len() - 1], sigma_m[sigma_m.len() - 1]);
        assert!((found_m - bias_m).abs() < 4.0 * sigma_m && sigma_m < 8.0, "{error_m} {given}: {found_m} {sigma_m}");
        assert_eq!(flagged, 4, "{:?}", texts(&warnings, "text"));
    }
}
