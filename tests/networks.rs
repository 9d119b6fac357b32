//! Training and application of networks.

use std::{
    process::{Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use crate::support::{Bench, SPEC, numbers, read, stderr, stdout, texts};

/// Spec of the small flights with a fit of networks to the true aircraft field. `keys` are additional keys of the fit.
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
fn user_every_network_compensates_and_its_training_can_be_queried() {
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
fn user_killed_training_resumes_to_the_same_bytes_on_other_threads() {
    killed("model = \"m2c\"\nhidden = [64, 64]\nepochs = 150\nbatch = 16\nseed = 5");
}

#[test]
fn user_killed_fits_of_trees_resume_to_the_same_bytes_on_other_threads() {
    killed("model = \"boosted_trees\"\ntrees = 4000\nleaf_samples = 2\nsubsample = 0.8\nseed = 5");
}

/// Kills a fit after a state is stored, and runs the fit again.
fn killed(keys: &str) {
    let bench = Bench::new();
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
fn user_invalid_keys_of_networks_are_rejected() {
    let bench = Bench::new();
    let check_fault = |keys: &str| {
        bench.spec(&spec("x = [1]", keys).replace("[axes]\nx = [1]\n", ""));
        let checked = bench.magline(&["check", "spec.toml"]);
        assert_eq!(checked.status.code(), Some(2), "{keys}: {}", stdout(&checked));
        stderr(&checked)
    };
    let filtered = check_fault("model = \"m1\"\nlow_hz = 0.1");
    assert!(
        filtered.contains("`low_hz` applies to linear models only; `m1` is fitted to unfiltered samples"),
        "{filtered}"
    );
    let foreign = check_fault("model = \"m1\"\nlambda = 0.1");
    assert!(foreign.contains("`lambda` belongs to"), "{foreign}");
    let threshold = check_fault("model = \"m2c\"\nhuber_threshold = 2.0");
    assert!(threshold.contains("has no effect without `training_loss = \"huber\"`"), "{threshold}");
    let deep = check_fault("model = \"m1\"\nhidden = [8, 8, 8, 8]");
    assert!(deep.contains("a network has at most three hidden layers"), "{deep}");
    let unvalidated = check_fault("model = \"m1\"\npatience = 10");
    assert!(unvalidated.contains("name lines or flights in `validation`"), "{unvalidated}");
    let untrained = check_fault("model = \"m1\"\nepochs = 0");
    assert!(untrained.contains("nothing is trained"), "{untrained}");
}

#[test]
fn user_the_report_shows_trainings_and_input_importance() {
    let bench = Bench::new();
    let keys = "model = \"$model\"\nepochs = 6\nvalidation = [\"2.02\"]\nseed = \"$start\"\nsubsample = 0.9";
    let importance = "\n[[stages]]\nname = \"matters\"\nstage = \"importance\"\ninput = \"wanted\"\n\
                      model = \"network\"\n\
                      target = \"target\"\nblock_s = 1.0\n\n[[stages]]\nname = \"parts\"\nstage = \"importance\"\n\
                      input = \"wanted\"\nmodel = \"network\"\ntarget = \"target\"\nmethod = \"shapley\"\n\
                      samples = 30\n\
                      background = 5\ngroups = [\"x\"]\n";
    bench.spec(&(spec("model = [\"m1\", \"boosted_trees\"]\nstart = [1, 2, 3]", keys) + importance));
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let report = bench.magline(&["report", "spec.toml", "-o", "report.html"]);
    assert!(report.status.success(), "{}", stderr(&report));
    let page = std::fs::read_to_string(bench.path("report.html")).unwrap();
    for part in ["id=\"training\"", "network: model = m1", "id=\"importance\"", "matters: model = boosted_trees"] {
        assert!(page.contains(part), "{part}");
    }
    // One picture for each model with all lines and seeds, and a beeswarm plot coloured by input values.
    assert_eq!(page.matches("<strong>matters: model = m1").count(), 1, "seeds are no models of their own");
    assert_eq!(page.matches("<strong>parts: model = m1").count(), 2, "bars and a beeswarm");
    assert!(
        page.contains("#ff0051") && page.contains("#008bfb") && page.contains("contribution to the prediction, nT")
    );
}

/// Flight of the survey aircraft with realistic sensors. `seed` and `magnetometer` give another aircraft of the type:
/// other random currents and another aircraft field at a cabin magnetometer.
fn aircraft(flight: &str, seed: u32, lines: &[(&str, f64, f64)], magnetometer: &str) -> String {
    let map = crate::support::repository().join("datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif");
    let line = |(name, start_s, duration_s): &(&str, f64, f64)| {
        format!(
            "[[flights.lines]]\nname = \"{name}\"\nkind = \"survey\"\nstart_tt_s = {start_s}\nalt_m = 560.0\n\
             duration_s = {duration_s}\nweave_deg = 8.0\n\
             waypoints = [[-22.11, 140.57], [-21.83, 140.60], [-21.83, 140.70], [-22.11, 140.74]]\n"
        )
    };
    format!(
        "preset = \"cessna_real\"\nseed = {seed}\nyear = 2020\ndoy = 185\nrate_hz = 5.0\n{magnetometer}\n\
         [map]\npath = \"{}\"\nalt_m = 500.0\n[[flights]]\nname = \"{flight}\"\n{}",
        map.display(),
        lines.iter().map(line).collect::<String>()
    )
}

/// Spec with a network of the first aircraft and two networks trained on one minute of the second aircraft: cold start
/// and warm start.
fn transfer(first_epochs: u32) -> String {
    let mut spec = "name = \"transfer\"\nstore = \"store\"\n".to_owned();
    for one in ["first", "second"] {
        spec.push_str(&format!(
            r#"
[tables.{one}]
path = "{one}.synth.toml"
"#
        ));
    }
    for one in ["first", "second"] {
        spec.push_str(&format!(
            r#"
[[stages]]
name     = "terms_{one}"
stage    = "features"
input    = "{one}"
features = ["dcm", "cur_com_1", "cur_ac_hi", "cur_ac_lo", "cur_flap", "cur_strb", "vol_bat_1", "TL_A_flux_d"]
terms    = ["permanent", "induced"]
[[stages]]
name  = "wanted_{one}"
stage = "target"
input = "terms_{one}"
kind  = "d"
mag   = "mag_4_uc"
"#
        ));
    }
    for (name, input, lines, keys) in [
        ("taught", "first", "1.01", format!("epochs = {first_epochs}")),
        ("cold", "second", "2.01", "epochs = 5".to_owned()),
        ("warm", "second", "2.01", "epochs = 5\nwarm_start = \"taught\"".to_owned()),
    ] {
        spec.push_str(&format!(
            r#"
[[stages]]
name          = "{name}"
stage         = "fit"
input         = "wanted_{input}"
where         = "line = '{lines}'"
model         = "m1"
target        = "target"
features      = ["features"]
learning_rate = 0.003
batch         = 100
seed          = 3
{keys}
"#
        ));
    }
    for name in ["cold", "warm"] {
        spec.push_str(&format!(
            r#"
[[stages]]
name  = "clean_{name}"
stage = "compensate"
input = "terms_second"
where = "line = '2.02'"
model = "{name}"
mag   = "mag_4_uc"
[[stages]]
name    = "scores_{name}"
stage   = "score"
input   = "clean_{name}"
truth   = "mag_1_c"
metrics = ["std_error", "std_uncompensated"]
"#
        ));
    }
    spec
}

#[test]
fn user_training_can_start_from_the_network_of_another_aircraft() {
    let bench = Bench::new();
    let other = "[[magnetometers]]\nname = \"mag_4_uc\"\npermanent = [380.0, 225.0, -185.0]\n\
                 induced = [[2.4e-3, 3e-4, 0.0], [3e-4, -8e-4, 2e-4], [0.0, 2e-4, 1.3e-3]]";
    let first = aircraft("1", 5, &[("1.01", 40_000.0, 1500.0)], "");
    let second = aircraft("2", 6, &[("2.01", 50_000.0, 90.0), ("2.02", 50_500.0, 600.0)], other);
    std::fs::write(bench.path("first.synth.toml"), first).unwrap();
    std::fs::write(bench.path("second.synth.toml"), second).unwrap();
    bench.spec(&transfer(200));
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{} {}", done.last, done.stderr);
    let score = |name: &str| -> f64 {
        let scores = read(&bench.path("store/tables/transfer").join(format!("scores_{name}")));
        let at = texts(&scores, "metric").iter().position(|m| m == "std_error").unwrap();
        numbers(&scores, "value")[at]
    };
    let (cold, warm) = (score("cold"), score("warm"));
    println!("std error of the second aircraft: cold {cold:.1} nT, from the first {warm:.1} nT");
    assert!(warm < 0.5 * cold, "{warm} {cold}");
    // The lineage lists the inputs of the table. A changed input recomputes only the results that depend on it.
    let lineage = bench.magline(&["lineage", "transfer.warm", "--store", "store"]);
    assert!(
        stdout(&lineage).contains("value <- ") && stdout(&lineage).contains("taught.value"),
        "{}",
        stdout(&lineage)
    );
    assert_eq!(bench.run(&[]).total("computed"), 0);
    bench.spec(&transfer(190));
    let again = bench.run(&[]);
    let computed = ["taught", "warm", "cold", "clean_warm", "clean_cold"].map(|table| again.computed(table));
    assert_eq!((again.code, computed), (0, [1, 1, 0, 1, 0]), "{}", again.stderr);
    let whole = bench.tables("store");
    assert_eq!(bench.run(&["--threads", "1", "--set", "store=other"]).code, 0);
    assert!(whole == bench.tables("other"), "the bytes differ");
    // The published table of the first network replaces its stage in another spec with another store.
    let spec = transfer(190);
    let (head, rest) = spec.split_once("[[stages]]").unwrap();
    let pretrained =
        "[tables.pretrained]\npath = \"store/tables/transfer/taught\"\nfeatures = [\"features\"]\n\n[[stages]]";
    let spec = format!("{head}{pretrained}{rest}").replace("\"taught\"", "\"pretrained\"");
    let spec = spec.replacen("name          = \"pretrained\"", "name          = \"unused\"", 1);
    bench.spec(&spec.replace("store = \"store\"", "store = \"elsewhere\""));
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let values = |store: &str| numbers(&read(&bench.path(store).join("tables/transfer/warm")), "value");
    assert_eq!(values("store"), values("elsewhere"));
    // Worker processes read the network from the store only.
    let workers = bench.run(&["--engine", "processes", "--set", "store=workers"]);
    assert_eq!(workers.code, 0, "{}", workers.stderr);
    assert!(bench.tables("elsewhere") == bench.tables("workers"), "the bytes differ");
    let explained = bench.magline(&["explain", "spec.toml"]);
    assert!(stdout(&explained).contains("pretrained  model"), "{}", stdout(&explained));
    let lineage = bench.magline(&["lineage", "transfer.warm", "--store", "elsewhere"]);
    assert!(stdout(&lineage).contains("pretrained  model of 1 lines, 1 files"), "{}", stdout(&lineage));
    // Changed bytes count as a changed model.
    let model = std::fs::read_dir(bench.path("store/tables/transfer/taught")).unwrap().flatten();
    let file = model.map(|f| f.path()).find(|f| f.extension().is_some_and(|e| e == "parquet")).unwrap();
    let table = read(&bench.path("store/tables/transfer/taught"));
    let changed: Vec<_> =
        table.iter().map(|b| crate::support::changed(b, "value", |i, x| if i == 30 { 2.0 * x } else { x })).collect();
    std::fs::remove_file(&file).unwrap();
    crate::support::write(&file, &changed);
    let why = bench.magline(&["why", "spec.toml", "warm"]);
    assert!(stdout(&why).contains("pretrained: the model has changed"), "{}{}", stdout(&why), stderr(&why));
    assert_eq!(bench.run(&[]).computed("warm"), 1);
}

#[test]
fn user_unsuitable_initial_models_are_rejected() {
    let bench = Bench::new();
    let first = "model = \"m1\"\nepochs = 1\n\n[[stages]]\nname = \"line\"\nstage = \"fit\"\ninput = \"wanted\"\n\
                 target = \"target\"\nmodel = \"ridge\"\n\n[[stages]]\nname = \"second\"\nstage = \"fit\"\n\
                 input = \"wanted\"\ntarget = \"target\"\n";
    let with = |keys: &str| bench.spec(&spec("x = [1]", &format!("{first}{keys}")).replace("[axes]\nx = [1]\n", ""));
    let check_fault = |keys: &str| {
        with(keys);
        let checked = bench.magline(&["check", "spec.toml"]);
        assert_eq!(checked.status.code(), Some(2), "{keys}: {}", stdout(&checked));
        stderr(&checked)
    };
    let linear = check_fault("model = \"ridge\"\nwarm_start = \"network\"");
    assert!(linear.contains("`ridge` has no weights") && linear.contains("warm_start = "), "{linear}");
    let lines = check_fault("model = \"m1\"\nwarm_start = \"terms\"");
    assert!(lines.contains("`warm_start` requires a model table, but `terms` is a table of flight lines"), "{lines}");
    let unknown = check_fault("model = \"m1\"\nwarm_start = \"netwrok\"");
    assert!(unknown.contains("did you mean `network`?"), "{unknown}");
    let missing = check_fault("model = \"m1\"\nwarm_start = \"flights\"");
    assert!(missing.contains("flights") && missing.contains("term"), "{missing}");
    // The content of a table is checked once the table exists.
    for (keys, what) in [
        ("model = \"m1\"\nepochs = 1\nwarm_start = \"line\"", "is linear and has no weights"),
        (
            "model = \"m1\"\nepochs = 1\nhidden = [4]\nwarm_start = \"network\"",
            "has `hidden` [8], but this fit has [4]",
        ),
        ("model = \"m2c\"\nepochs = 1\nwarm_start = \"network\"", "has `model` m1, but this fit has m2c"),
    ] {
        with(keys);
        let done = bench.run(&[]);
        assert_eq!(done.code, 1, "{keys}: {}", done.stderr);
        assert!(done.last["failures"].to_string().contains(what), "{keys}: {}", done.last);
    }
}
