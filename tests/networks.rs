//! Networks as a user trains and applies them.

use std::{
    process::{Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use crate::support::{Bench, SPEC, numbers, read, stderr, stdout, texts};

/// The small flights with a fit of networks to their true field of the aircraft; `keys` are further ones of the fit.
fn spec(axes: &str, keys: &str) -> String {
    let tables = SPEC.split("[axes]").next().unwrap();
    format!(
        r#"{tables}
[axes]
{axes}

[[stages]]
name   = "terms"
stage  = "a_matrix"
input  = "flights"
vector = "flux_a"

[[stages]]
name  = "wanted"
stage = "target"
input = "terms"
kind  = "d"
mag   = "mag_4_uc"

[[stages]]
name   = "network"
stage  = "fit"
input  = "wanted"
target = "target"
{keys}

[[stages]]
name  = "clean"
stage = "compensate"
input = "terms"
model = "network"
mag   = "mag_4_uc"

[[stages]]
name    = "scores"
stage   = "score"
input   = ["clean"]
truth   = "mag_1_c"
metrics = ["std_error", "std_uncompensated"]
"#
    )
}

#[test]
fn user_every_network_compensates_and_its_training_is_a_query_away() {
    let bench = Bench::new();
    let models = r#"model = ["m1", "m2a", "m2b", "m2c", "m2d", "tlnn", "etlnn"]"#;
    let keys =
        "model = \"$model\"\nlearning_rate = 0.01\nepochs = 40\nbatch = 100\nvalidation = [\"2.02\"]\nmembers = 2";
    bench.spec(&spec(models, keys));
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let folder = |table: &str| read(&bench.path("store/tables/small").join(table));
    let scores = folder("scores");
    let of = |metric: &str| -> Vec<f64> {
        let names = texts(&scores, "metric");
        numbers(&scores, "value").into_iter().zip(names).filter(|(_, name)| name == metric).map(|(v, _)| v).collect()
    };
    let (after, before) = (of("std_error"), of("std_uncompensated"));
    assert_eq!(after.len(), 7 * 4);
    for (after, before) in after.iter().zip(&before) {
        assert!(*after < 0.5 * before, "{after} {before}");
    }
    let clean = folder("clean");
    let (off, sigma) = (numbers(&clean, "mag_aircraft"), numbers(&clean, "mag_aircraft_sigma"));
    assert!(off.iter().chain(&sigma).all(|x| x.is_finite()));
    assert!(sigma.iter().all(|s| *s >= 0.0) && sigma.iter().any(|s| *s > 0.0));
    let curve = "SELECT value FROM small.network WHERE model = 'm1' AND term LIKE 'epoch_validation%'";
    let answer = bench.magline(&["sql", "--store", "store", "--format", "csv", curve]);
    assert!(answer.status.success(), "{}", stderr(&answer));
    let losses: Vec<f64> = stdout(&answer).lines().skip(1).map(|line| line.parse().unwrap()).collect();
    assert_eq!(losses.len(), 40);
    assert!(losses[39] < losses[0], "{losses:?}");
}

#[test]
fn user_a_network_becomes_an_onnx_file() {
    let bench = Bench::new();
    bench.spec(&spec("model = [\"m1\", \"m2c\", \"random_features\"]", "model = \"$model\"\nepochs = 2"));
    assert_eq!(bench.run(&[]).code, 0);
    let onnx = |more: &[&str]| bench.magline(&[&["onnx", "small.network", "-o", "network.onnx"], more].concat());
    let written = onnx(&["--where", "model = 'm2c'"]);
    assert!(written.status.success(), "{}", stderr(&written));
    assert!(stderr(&written).contains("input `a`: x, y, z, xx, xy"), "{}", stderr(&written));
    let bytes = std::fs::read(bench.path("network.onnx")).unwrap();
    assert!(bytes.windows(6).any(|part| part == b"MatMul") || bytes.windows(4).any(|part| part == b"Gemm"));
    for (more, why) in [
        (&[][..], "has several models"),
        (&["--where", "model = 'random_features'"], "has no dense network"),
        (&["--where", "model = 'm3'"], "has no dense network"),
        (&["--where", "colour = 1"], "colour"),
    ] {
        let refused = onnx(more);
        assert!(!refused.status.success() && stderr(&refused).contains(why), "{}", stderr(&refused));
    }
}

#[test]
fn user_a_training_that_is_killed_goes_on_to_the_same_bytes_on_other_threads() {
    let bench = Bench::new();
    let keys = "model = \"m2c\"\nhidden = [64, 64]\nepochs = 150\nbatch = 16\nseed = 5";
    bench.spec(&spec("x = [1]", keys).replace("[axes]\nx = [1]\n", ""));
    assert_eq!(bench.run(&["--threads", "2", "--set", "store=whole"]).code, 0);
    let mut child = Command::new(env!("CARGO_BIN_EXE_magline"))
        .args(["run", "spec.toml", "--threads", "1", "--set", "store=killed"])
        .current_dir(bench.folder.path())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let states = || std::fs::read_dir(bench.path("killed/checkpoints")).into_iter().flatten().count();
    let begun = Instant::now();
    while states() == 0 && begun.elapsed() < Duration::from_secs(60) {
        sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    assert!(!child.wait().unwrap().success(), "it was done before it was killed");
    assert_eq!(states(), 1);
    let done = bench.run(&["--threads", "1", "--set", "store=killed"]);
    assert_eq!((done.code, done.computed("network")), (0, 1), "{}", done.stderr);
    assert_eq!(states(), 0, "a state outlives its unit");
    assert!(bench.tables("whole") == bench.tables("killed"), "the bytes differ");
}

#[test]
fn user_what_a_network_cannot_use_is_refused() {
    let bench = Bench::new();
    let said = |keys: &str| {
        bench.spec(&spec("x = [1]", keys).replace("[axes]\nx = [1]\n", ""));
        let checked = bench.magline(&["check", "spec.toml"]);
        assert_eq!(checked.status.code(), Some(2), "{keys}: {}", stdout(&checked));
        stderr(&checked)
    };
    let filtered = said("model = \"m1\"\nlow_hz = 0.1");
    assert!(
        filtered.contains("`low_hz` is for linear models: `m1` is fitted to the samples as they are"),
        "{filtered}"
    );
    let foreign = said("model = \"m1\"\nlambda = 0.1");
    assert!(foreign.contains("`lambda` belongs to"), "{foreign}");
    let threshold = said("model = \"m2c\"\nhuber_threshold = 2.0");
    assert!(threshold.contains("has no effect without `training_loss = \"huber\"`"), "{threshold}");
    let deep = said("model = \"m1\"\nhidden = [8, 8, 8, 8]");
    assert!(deep.contains("a network has up to three hidden layers"), "{deep}");
    let unvalidated = said("model = \"m1\"\npatience = 10");
    assert!(unvalidated.contains("name them in `validation`"), "{unvalidated}");
    let untrained = said("model = \"m1\"\nepochs = 0");
    assert!(untrained.contains("nothing is trained"), "{untrained}");
}

#[test]
fn user_the_report_shows_trainings_and_which_inputs_matter() {
    let bench = Bench::new();
    let keys = "model = \"$model\"\nepochs = 6\nvalidation = [\"2.02\"]";
    let importance = "\n[[stages]]\nname = \"matters\"\nstage = \"importance\"\ninput = \"wanted\"\nmodel = \"network\"\n\
                      target = \"target\"\nblock_s = 1.0\n";
    bench.spec(&(spec("model = [\"m1\", \"boosted_trees\"]", keys) + importance));
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let report = bench.magline(&["report", "spec.toml", "-o", "report.html"]);
    assert!(report.status.success(), "{}", stderr(&report));
    let page = std::fs::read_to_string(bench.path("report.html")).unwrap();
    for part in ["id=\"training\"", "network: model = m1", "id=\"importance\"", "matters: model = boosted_trees"] {
        assert!(page.contains(part), "{part}");
    }
}
