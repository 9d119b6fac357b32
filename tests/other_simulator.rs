//! Navigation with default settings on flights of a simulator that shares no code with magline: a non-linear strapdown
//! INS, and the exact field of dipoles. `tests/cases/foreign/README.md` describes the flights.

use crate::support::{Bench, numbers, read, repository, stderr, texts};

/// A spec without any key of the filter. The INS is aligned at the start of each line; the flights do not say so.
fn spec(flights: &str) -> String {
    let folder = repository().join("tests/cases/foreign");
    let path = |name: &str| folder.join(name).display().to_string();
    format!(
        "name = \"foreign\"\nstore = \"store\"\n[tables.flights]\npath = \"{}\"\n[tables.anomaly]\npath = \"{}\"\n\
         [[stages]]\nname = \"track\"\nstage = \"navigate\"\ninput = \"flights\"\nmap = \"anomaly\"\nmag = \"mag_1_uc\"\n\
         remove_diurnal = false\n[[stages]]\nname = \"scores\"\nstage = \"score\"\ninput = [\"flights\", \"track\"]\n\
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
        bench.spec(&spec(flights));
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
