//! Neural covariance: training of the noise network, and the filter with it.

use crate::support::{Bench, SPEC, numbers, read, stderr, texts};

/// Training on the first line of each flight, and both filters on the second.
fn stages(training: &str, filter: &str) -> String {
    let spec = SPEC.replace("[\"mag_4_uc\", \"mag_5_uc\"]", "[\"mag_4_uc\"]");
    let spec = spec.replace("[\"flux_a\", \"flux_d\"]", "[\"flux_a\"]").replace("[0.0, 0.025]", "[0.025]");
    let navigate = "input = \"clean\"\nmap = \"anomaly\"\ncore_field = false\nwhere = \"line like '%.02'\"";
    format!(
        "{spec}\n[[stages]]\nname = \"learnt\"\nstage = \"noise_network\"\ninput = \"clean\"\nmap = \"anomaly\"\n\
         core_field = false\nwhere = \"line like '%.01'\"\nepochs = 3\nhidden = 4\n{training}\n\
         [[stages]]\nname = \"plain\"\nstage = \"navigate\"\nfilter = \"ekf\"\n{navigate}\n\
         [[stages]]\nname = \"neural\"\nstage = \"navigate\"\nfilter = \"nekf\"\n{navigate}\n{filter}\n"
    )
}

fn bench_of(training: &str, filter: &str) -> Bench {
    let bench = Bench::new();
    bench.spec(&stages(training, filter));
    bench
}

fn column(bench: &Bench, table: &str, name: &str) -> Vec<f64> {
    numbers(&read(&bench.path("store/tables/small").join(table)), name)
}

#[test]
fn law_a_network_without_an_output_gives_the_bits_of_the_ekf() {
    // The smallest steps leave the outputs at 0 to the last bit of the factors.
    let bench = bench_of("learning_rate = 1e-300", "model = \"learnt\"");
    let run = bench.run(&[]);
    assert_eq!(run.code, 0, "{} {}", run.last, run.stderr);
    assert!(column(&bench, "neural", "noise_factor").iter().all(|factor| *factor == 1.0));
    for name in ["lat", "lon", "alt", "vn", "sd_n", "sd_e", "cov_ne", "residual", "nis"] {
        let [plain, neural] = ["plain", "neural"]
            .map(|table| column(&bench, table, name).into_iter().map(f64::to_bits).collect::<Vec<u64>>());
        assert!(!plain.is_empty() && plain == neural, "{name}");
    }
}

#[test]
fn user_a_network_is_trained_and_used_with_further_inputs() {
    let keys = "features = [\"ins_lon\"]";
    let bench = bench_of(
        &format!("{keys}\nnetwork_noise = \"both\"\nloss = \"position\"\nwindow_s = 10.0"),
        &format!("{keys}\nmodel = \"learnt\"\nsave_inputs = true"),
    );
    let run = bench.run(&["--threads", "2"]);
    assert_eq!(run.code, 0, "{} {}", run.last, run.stderr);
    let terms = texts(&read(&bench.path("store/tables/small/learnt")), "term");
    assert!(terms.iter().any(|term| term == "mean[9] ins_lon"), "{terms:?}");
    assert_eq!(terms.iter().filter(|term| term.starts_with("weight[")).count(), 4 * 4 * (9 + 4 + 1) + 2 * 5);
    assert_eq!(terms.iter().filter(|term| term.starts_with("epoch_loss[")).count(), 3);
    for name in ["noise_factor", "fogm_factor"] {
        let factors = column(&bench, "neural", name);
        assert!(factors.iter().all(|factor| (0.1..=10.0).contains(factor)) && factors[100] != 1.0, "{name}");
    }
    // One thread gives the same weights and tracks.
    let tables = bench.tables("store");
    let one = bench.run(&["--threads", "1", "--set", "store=one"]);
    assert_eq!(one.code, 0, "{} {}", one.last, one.stderr);
    let other = bench.tables("one");
    for (name, bytes) in &tables {
        assert!(other.get(name).is_some_and(|other| other == bytes), "{name}");
    }
}

#[test]
fn user_a_wrong_network_or_feature_is_an_error_before_the_run() {
    for (training, filter, words) in [
        ("", "", "requires a trained network"),
        ("features = [\"lat\"]", "model = \"learnt\"", "truth column"),
        ("features = [\"ins_lo\"]", "model = \"learnt\"", "ins_lon"),
        ("limit = 0.5", "model = \"learnt\"", "limit"),
    ] {
        let run = bench_of(training, filter).run(&[]);
        assert!(run.code == 2 && run.stderr.contains(words), "{words}: {}", run.stderr);
    }
    for (training, filter, words) in [
        ("features = [\"ins_lon\"]", "model = \"learnt\"", "was trained with `features = [\"ins_lon\"]`"),
        ("", "model = \"coefficients\"", "not a network of the noise"),
    ] {
        let run = bench_of(training, filter).magline(&["run", "spec.toml"]);
        assert!(run.status.code() == Some(1) && stderr(&run).contains(words), "{words}: {}", stderr(&run));
    }
    let check = bench_of("", "model = \"learnt\"").magline(&["check", "spec.toml"]);
    assert!(check.status.success(), "{}", stderr(&check));
}
