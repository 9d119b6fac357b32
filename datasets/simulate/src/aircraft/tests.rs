#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{fs, path::PathBuf};

use arrow_array::{RecordBatch, cast::AsArray, types::Float64Type};
use datasets::samples;
use tempfile::TempDir;

use super::{
    super::{COMPONENTS, Simulation, SynthSpec},
    *,
};

mod eddy;
mod electric;
mod real;
mod sensors;

/// A flight over Osborne of two lines: a box, and a survey with turns. `aircraft` are the aircraft's tables.
fn lines_of(top: &str, aircraft: &str, flights: &str) -> Vec<RecordBatch> {
    let folder = TempDir::new().unwrap();
    let path = spec(&folder, top, aircraft, flights);
    let simulation = Simulation::open(&path).unwrap();
    let schema = simulation.schema();
    let lines: Vec<_> = simulation.into_lines(1).map(|l| l.unwrap().into_batch(&path).unwrap()).collect();
    assert!(lines.iter().all(|l| l.schema() == schema), "the schema is known before a line is flown");
    lines
}

fn spec(folder: &TempDir, top: &str, aircraft: &str, flights: &str) -> PathBuf {
    let map = samples::path("osborne/osborne_anomaly_100m_at_500m.tif");
    let text = format!(
        "seed = 3\nyear = 2020\ndoy = 185\ngusts_deg = [1.5, 0.5, 0.7]\n{top}\n[map]\npath = '{}'\n{aircraft}\n\
         {flights}",
        map.display()
    );
    let path = folder.path().join("a.synth.toml");
    fs::write(&path, text).unwrap();
    path
}

const SURVEY: &str = "
[[flights]]
name = 'A'
start_tt_s = 36000.0
[[flights.lines]]
name = 'A.1'
alt_m = 500.0
duration_s = 120.0
weave_deg = 10.0
weave_period_s = 30.0
waypoints = [[-22.05, 140.6], [-21.9, 140.65]]
";

fn column<'a>(line: &'a RecordBatch, name: &str) -> &'a [f64] {
    line.column_by_name(name).unwrap_or_else(|| panic!("no {name}")).as_primitive::<Float64Type>().values()
}

fn sd(x: &[f64]) -> f64 {
    let mean = x.iter().sum::<f64>() / x.len() as f64;
    (x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / x.len() as f64).sqrt()
}

/// Sensors with every optional key.
const EVERYTHING: &str = "
[diurnal]
sigma_nt = 5.0
[temperature]
settled_degc = 5.0
tau_s = 60.0
[[currents]]
name = 'cur_x'
on_a = 4.0
noise_a = 0.1
resolution_a = 0.01
delay_s = 0.3
response_s = 0.2
limit = 3.0
eddy_share = 0.4
eddy_tau_s = 0.5
[[currents]]
name = 'cur_y'
kind = 'servo'
on_a = 2.0
remanence = 0.1
stuck_at = 1.0
[[currents]]
name = 'cur_z'
kind = 'periodic'
every_s = 2.0
for_s = 0.5
on_a = 3.0
measured = false
[[wires]]
current = 'cur_y'
path = [[0.0, 0.0, 0.0], [-3.0, 0.5, 0.0], [-3.0, 0.5, 1.0]]
closed = true
turns = 20
onset_a = 1.0
[[voltages]]
name = 'vol_x'
volts = 28.0
ohm = { cur_x = 0.1 }
noise_v = 0.01
resolution_v = 0.1
[[inputs]]
name = 'rcou_c1'
kind = 'aileron'
offset = 1500.0
gain = 20.0
resolution = 1.0
[[magnetometers]]
name = 'mag_2_uc'
position_m = [-1.0, 0.4, 0.3]
permanent_nt = 400.0
induced_nt = 100.0
eddy_s = 0.001
permanent_shift_nt = 30.0
permanent_walk_nt_per_sqrt_h = 20.0
flex_nt_per_mps2 = 3.0
hysteresis_nt = 10.0
currents = { cur_x = 2.0, cur_z = 1.0 }
noise_nt = 0.1
heading_nt = 0.5
dead_polar_deg = 12.0
dead_equatorial_deg = 10.0
dropouts = { mean_s = 30.0, for_s = 2.0 }
spikes = { mean_s = 10.0, sigma_nt = 50.0 }
drift = { sigma_nt = 1.0 }
resolution_nt = 0.01
rate_hz = 4.0
lag_s = 0.3
[[vector_magnetometers]]
name = 'flux_a'
permanent = [100.0, -50.0, 20.0]
induced = [[0.002, 0.001, 0.0], [-0.001, 0.003, 0.0], [0.0, 0.0, 0.001]]
eddy = [[0.001, 0.0, 0.0], [0.0, 0.002, 0.0], [0.001, 0.0, 0.001]]
permanent_shift_nt = 10.0
permanent_walk_nt_per_sqrt_h = 5.0
flex = [1.0, 0.5, 2.0]
hysteresis = [[5.0, 1.0, 0.0], [2.0, 4.0, 0.0], [0.0, 1.0, 3.0]]
currents = { cur_x = [1.0, 2.0, 3.0], cur_z = 2.0 }
linearity_ppm = 150.0
core_hysteresis_nt = 2.0
temperature_scale_ppm_per_degc = 70.0
thermal_tau_s = 30.0
crosstalk = { cur_x = 0.5, cur_y = [0.1, 0.2, 0.3] }
bandwidth_hz = 4.0
axis_lag_s = [0.01, 0.02, 0.03]
offset_nt = 50.0
scale = 0.002
non_orthogonal_deg = 0.3
misaligned_deg = 0.5
temperature_nt_per_degc = 1.0
drift = { sigma_nt = 2.0 }
noise_nt = 1.0
resolution_nt = 0.5
lag_s = 0.15
rate_hz = 7.0
hold = true
";

const SCALAR: &str = "mag_2_uc";
const READINGS: [&str; 4] = [SCALAR, "flux_a_x", "flux_a_y", "flux_a_z"];

fn parts_of<'a>(line: &'a RecordBatch, name: &str) -> Vec<(String, &'a [f64])> {
    let schema = line.schema();
    let names: Vec<String> = schema.fields().iter().map(|f| f.name().clone()).collect();
    let parts = names.into_iter().filter(|n| n.starts_with("part_") && n.ends_with(&format!("_{name}")));
    parts.map(|n| (n.clone(), column(line, &n))).collect()
}

#[test]
fn law_the_parts_sum_to_the_reading() {
    let line = &lines_of("component_columns = true", EVERYTHING, SURVEY)[0];
    for name in READINGS {
        let (reading, parts) = (column(line, name), parts_of(line, name));
        assert_eq!(parts.len(), if name == SCALAR { 17 } else { 24 });
        let mut read = 0;
        for (i, value) in reading.iter().enumerate() {
            if value.is_nan() {
                continue;
            }
            read += 1;
            let sum: f64 = parts.iter().map(|(_, p)| p[i]).sum();
            // Rounding of up to 24 sums of 5e4 nT.
            assert!((sum - value).abs() < 1e-9, "{name} {i}: {sum} {value}");
        }
        assert!(read > 600, "{name}: {read} of {}", reading.len());
        for (part, values) in parts {
            assert!(sd(values) > 0.0 || values[0] != 0.0, "{part} is there");
        }
    }
}

/// The part of a component; dead zones and dropouts remove values.
fn part_of(component: &str) -> Option<&str> {
    match component {
        "gusts" | "ins" | "dead_zones" | "dropouts" => None,
        other => FIELD_PARTS.iter().chain(&SCALAR_PARTS).chain(&VECTOR_PARTS).copied().find(|p| *p == other),
    }
}

#[test]
fn law_a_component_that_is_off_is_exactly_zero() {
    let all = &lines_of("component_columns = true", EVERYTHING, SURVEY)[0];
    for component in COMPONENTS {
        // The anomaly is not simulated, because the map is slow and no other component depends on the anomaly.
        let quiet = if *component == "anomaly" { "" } else { "anomaly = false\n" };
        let off = format!("{EVERYTHING}\n[components]\n{quiet}{component} = false\n");
        let line = &lines_of("component_columns = true", &off, SURVEY)[0];
        let Some(part) = part_of(component) else { continue };
        let columns: Vec<_> = READINGS
            .iter()
            .flat_map(|name| parts_of(line, name))
            .filter(|(n, _)| READINGS.iter().any(|reading| *n == format!("part_{part}_{reading}")))
            .collect();
        assert!(!columns.is_empty(), "{component}");
        for (name, values) in columns {
            assert!(values.iter().all(|x| *x == 0.0), "{name} with {component} off");
        }
        // The random values of one component do not depend on the other components.
        if !["gusts", "noise", "lag"].contains(component) {
            assert!(column(line, "part_noise_flux_a_x") == column(all, "part_noise_flux_a_x"), "{component}");
        }
    }
}

#[test]
fn law_with_everything_off_the_reading_is_the_core_field() {
    let off: Vec<String> = COMPONENTS.iter().map(|c| format!("{c} = false")).collect();
    let text = format!("{EVERYTHING}\n[components]\n{}\n", off.join("\n"));
    let line = &lines_of("", &text, SURVEY)[0];
    let (mag, core) = (column(line, SCALAR), column(line, "igrf"));
    let flux = ["flux_a_x", "flux_a_y", "flux_a_z"].map(|n| column(line, n));
    for i in 0..line.num_rows() {
        // Rounding of 5e4 nT in a rotation.
        assert!((mag[i] - core[i]).abs() < 1e-10, "{i}");
        let norm = Vector3::new(flux[0][i], flux[1][i], flux[2][i]).norm();
        assert!((norm - core[i]).abs() < 1e-10, "{i}");
    }
}

#[test]
fn law_exact_sources_give_the_field_of_tolles_and_lawson() {
    let only = "[[magnetometers]]\nname = 'mag_1_c'\n[[vector_magnetometers]]\nname = 'flux_a'\n\
                [[vector_magnetometers]]\nname = 'flux_b'\npermanent = [100.0, -50.0, 20.0]\n\
                induced = [[0.002, 0.001, 0.0], [-0.004, 0.003, 0.0], [0.0, 0.0, 0.001]]\n\
                eddy = [[0.01, 0.0, 0.0], [0.0, 0.0, 0.02], [0.0, 0.0, 0.0]]\n";
    let line = &lines_of("rate_hz = 1000.0", only, &SURVEY.replace("120.0", "20.0"))[0];
    let at = |name: &str, i: usize| Vector3::from(["x", "y", "z"].map(|a| column(line, &format!("{name}_{a}"))[i]));
    // The jerk jumps at the nodes, every 50 samples.
    for i in (2..line.num_rows() - 2).step_by(7).filter(|i| (2..=48).contains(&(i % 50))) {
        let change = |by: usize| at("flux_a", i + by) - at("flux_a", i - by);
        let (b, rate) = (at("flux_a", i), (8.0 * change(1) - change(2)) / 0.012);
        let induced = Vector3::new(0.002 * b.x + 0.001 * b.y, -0.004 * b.x + 0.003 * b.y, 0.001 * b.z);
        let eddy = Vector3::new(0.01 * rate.x, 0.02 * rate.z, 0.0);
        let expected = b + Vector3::new(100.0, -50.0, 20.0) + induced + eddy;
        // Rounding of 5e4 nT over a millisecond is 1e-8 nT/s, of which 2 % enter the field; the error of the
        // differences is of fourth order in the step.
        assert!((at("flux_b", i) - expected).norm() < 1e-7, "{i}: {}", at("flux_b", i) - expected);
    }
}

/// Shifts and walks of 100 vector magnetometers on two flights; the first flight has two lines.
#[test]
fn law_landing_shifts_are_constant_in_a_flight_and_the_walk_grows_with_time() {
    let flight = |name: &str| SURVEY.replace("'A'", &format!("'{name}'")).replace("A.1", &format!("{name}.1"));
    let second = "[[flights.lines]]\nname = 'A.2'\nalt_m = 500.0\nduration_s = 60.0\nstart_tt_s = 39600.0\n\
                  waypoints = [[-22.05, 140.6], [-21.9, 140.65]]\n";
    let walking: Vec<String> = (0..100)
        .map(|k| {
            format!(
                "[[vector_magnetometers]]\nname = 'flux_w{k}'\npermanent_shift_nt = 10.0\n\
                 permanent_walk_nt_per_sqrt_h = 8.0\n"
            )
        })
        .collect();
    let flights = format!("{}{second}{}", SURVEY, flight("B"));
    let lines = lines_of("component_columns = true\nrate_hz = 1.0", &walking.join(""), &flights);
    let (mut shifts, mut walks, mut apart) = (vec![], vec![], 0);
    for k in 0..100 {
        for axis in AXES {
            let landing = |l: usize| column(&lines[l], &format!("part_landing_flux_w{k}_{axis}"));
            let walk = |l: usize| column(&lines[l], &format!("part_walk_flux_w{k}_{axis}"));
            assert!(landing(0).iter().chain(landing(1)).all(|x| *x == landing(0)[0]), "one flight, one shift");
            apart += usize::from(landing(0)[0] != landing(2)[0]);
            shifts.push(landing(0)[0]);
            assert_eq!(walk(0)[0], 0.0);
            // An hour after the start.
            walks.push(walk(1)[0]);
        }
    }
    assert_eq!(apart, 300);
    // The tolerance is four standard errors; the standard error of 300 draws is 4 %.
    assert!((sd(&shifts) / 10.0 - 1.0).abs() < 0.16, "{}", sd(&shifts));
    assert!((sd(&walks) / 8.0 - 1.0).abs() < 0.16, "{}", sd(&walks));
}

#[test]
fn gold_faults_of_an_aircraft() {
    let folder = TempDir::new().unwrap();
    let path = spec(
        &folder,
        "",
        "[[currents]]\nname = 'cur_x'\nkind = 'schedul'\non_a = 1.0\n[[wires]]\ncurrent = 'cur_x'\n\
         path = [[0.0, 0.0]]\n[[magnetometers]]\nname = 'mag_2_uc'\npermanent = [1.0, 2.0]\nheading_n = 3.0\n\
         [[magnetometers]]\nname = 'mag_3_uc'\npermanent = [1.0, 2.0, 3.0]\npermanent_nt = 4.0\n\
         [[wires]]\ncurrent = 'cur_y'\npath = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]\n[[magnetometers]]\n\
         name = 'mag_4_uc'\n\
         induced = [[1.0, 2.0, 3.0]]\n[[inputs]]\nname = 'lat'\nkind = 'speed'\n",
        SURVEY,
    );
    let message = Simulation::open(&path).unwrap_err().to_string();
    for (place, what) in [
        ("10:8", "`kind` cannot be `schedul`"),
        ("24:11", "there is no current `cur_y`"),
        ("14:8", "`path` of `wires` must be a list of lists of 3 numbers"),
        ("17:13", "`permanent` of `magnetometers` must be a list of 3 numbers"),
        ("18:1", "`magnetometers` has no parameter `heading_n`"),
        ("22:16", "`permanent` cannot be combined with `permanent_nt`; remove one of them"),
        ("28:11", "`induced` of `magnetometers` must be a list of 3 lists of 3 numbers"),
        ("30:8", "`lat` is the name of another column"),
    ] {
        assert!(message.contains(what), "{what} is not in\n{message}");
        assert!(message.contains(&format!("a.synth.toml:{place}\n")), "{place} of {what} is not in\n{message}");
    }
    for help in ["did you mean `schedule`?", "did you mean `heading_nt`?"] {
        assert!(message.contains(help), "{help} is not in\n{message}");
    }
}

#[test]
fn law_induced_tensors_have_their_size_and_symmetry() {
    let tensor = |name: &str, symmetric: bool| {
        let folder = TempDir::new().unwrap();
        let sensor =
            format!("[[vector_magnetometers]]\nname = '{name}'\ninduced_nt = 100.0\ninduced_symmetric = {symmetric}\n");
        let simulation = Simulation::open(&spec(&folder, "", &sensor, SURVEY)).unwrap();
        let SynthSpec { seed, aircraft, components, .. } = simulation.spec();
        let feeds = EffectiveCurrents::from_currents(aircraft, &[], 10.0, components);
        let source = &aircraft.vectors[0].source;
        let field = AircraftField::draw(*seed, ("A", 0.0), (name, source), (aircraft, &feeds), components);
        let along = |axis: usize| {
            let (earth_nt, rate_ntps) = (Vector3::ith(axis, 50_000.0), Vector3::zeros());
            let iron = Vector3::zeros();
            let drive =
                AircraftFieldInput { earth_nt, rate_ntps, feeds_a: &[], row: 0, since_s: 0.0, lift_mps2: 0.0, iron };
            field.parts_nt(&drive)[1]
        };
        nalgebra::Matrix3::from_columns(&[along(0), along(1), along(2)])
    };
    let (mut squares, mut apart) = (0.0, 0.0);
    for k in 0..100 {
        let name = format!("flux_{k}");
        let (symmetric, free) = (tensor(&name, true), tensor(&name, false));
        // Rounding of 100 nT.
        assert!((symmetric - symmetric.transpose()).abs().max() < 1e-9);
        squares += free.norm_squared() / 900.0;
        apart += (free - free.transpose()).norm_squared() / 600.0;
    }
    // There are 900 elements of 100 nT. The difference of two independent elements has twice the variance. The
    // tolerance is four standard errors, which are 2.4 % and 6 %.
    assert!((f64::sqrt(squares) / 100.0 - 1.0).abs() < 0.1, "{squares}");
    assert!((apart / 20_000.0 - 1.0_f64).abs() < 0.25, "{apart}");
}
