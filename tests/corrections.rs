//! Each correction of a reading is applied once, in any upstream stage.

use crate::support::{Bench, SPEC, numbers, read};

/// Spec that derives a reading by `expression`, compensates it, and navigates with the keys `more`.
fn spec(expression: &str, more: &str) -> String {
    let head = SPEC.split("[axes]").next().unwrap();
    format!(
        r#"{head}
[[stages]]
name    = "even"
stage   = "resample"
input   = "flights"
rate_hz = 10.0

[[stages]]
name    = "varied"
stage   = "derive"
input   = "even"
columns = {{ diurnal = "4.0 * sin(tt / 20.0)" }}
units   = {{ diurnal = "nT" }}

[[stages]]
name    = "reduced"
stage   = "derive"
input   = "varied"
columns = {{ mag_r = "{expression}" }}

[[stages]]
name   = "terms"
stage  = "a_matrix"
input  = "reduced"
vector = "flux_a"

[[stages]]
name   = "model"
stage  = "fit"
input  = "terms"
where  = "line like '%.01'"
model  = "tolles_lawson"
target = "mag_r"

[[stages]]
name  = "clean"
stage = "compensate"
input = "terms"
model = "model"
mag   = "mag_r"

[[stages]]
name            = "track"
stage           = "navigate"
tuning          = "magnav"
input           = "clean"
map             = "anomaly"
offset_window_s = 1.0
core_field      = false
{more}
"#
    )
}

fn latitudes(bench: &Bench, spec: &str) -> (Vec<f64>, String) {
    bench.spec(spec);
    let done = bench.run(&[]);
    assert_eq!(done.code, 0, "{}", done.stderr);
    let explained = bench.magline(&["explain", "spec.toml"]);
    (numbers(&read(&bench.path("store/tables/small/track")), "lat"), String::from_utf8_lossy(&explained.stdout).into())
}

#[test]
fn law_the_diurnal_variation_is_removed_once() {
    let bench = Bench::new();
    let reduced = "mag_4_uc - diurnal";
    let (by_default, explained) = latitudes(&bench, &spec(reduced, ""));
    let (left_in, _) = latitudes(&bench, &spec(reduced, "remove_diurnal = false"));
    assert_eq!(by_default, left_in, "`navigate` removed it again");
    assert!(explained.contains("the diurnal variation has already been removed from `mag_c`"), "{explained}");
    let (removed, _) = latitudes(&bench, &spec("mag_4_uc + 0.0", ""));
    let (not_removed, _) = latitudes(&bench, &spec("mag_4_uc + 0.0", "remove_diurnal = false"));
    assert_ne!(removed, not_removed, "a reading that holds it has it removed by default");
}

#[test]
fn user_a_double_correction_is_an_error_before_the_run() {
    let bench = Bench::new();
    let refused = |spec: &str, what: &[&str]| {
        bench.spec(spec);
        let done = bench.run(&[]);
        assert_eq!(done.code, 2, "{}", done.stderr);
        assert!(what.iter().all(|what| done.stderr.contains(what)), "{}", done.stderr);
        assert!(!bench.path("store/tables").exists());
    };
    let reduced = "mag_4_uc - diurnal";
    let twice = ["the diurnal variation has already been removed from `mag_c`", "remove_diurnal = false"];
    refused(&spec(reduced, "remove_diurnal = true"), &twice);
    let core = spec("mag_4_uc - igrf", "")
        .replace("diurnal = \"4.0 * sin(tt / 20.0)\"", "igrf = \"48000.0 + 0.0 * tt\"")
        .replace("units   = { diurnal", "units   = { igrf")
        .replace("core_field      = false", "core_field      = true\ndecimal_year    = 2020.5");
    refused(&core, &["the core field has already been removed from `mag_c`", "core_field = false"]);
    let target = "\n[[stages]]\nname = \"wanted\"\nstage = \"target\"\ninput = \"reduced\"\nkind = \"e\"\n\
                  mag = \"mag_r\"\n\
                  remove_core = false\nremove_diurnal = true\n";
    let twice = ["the diurnal variation has already been removed from `mag_r`", "remove_diurnal = false"];
    refused(&format!("{}{target}", spec(reduced, "")), &twice);
}
