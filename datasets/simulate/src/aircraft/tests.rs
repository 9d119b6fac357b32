#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{fs, path::PathBuf};

use arrow_array::{RecordBatch, cast::AsArray, types::Float64Type};
use datasets::samples;
use tempfile::TempDir;

use super::{
    super::{COMPONENTS, Simulation, Spec, random::Random},
    currents::switched,
    *,
};

mod eddy;
mod real;

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
        "seed = 3\nyear = 2020\ndoy = 185\ngusts_deg = [1.5, 0.5, 0.7]\n{top}\n[map]\npath = '{}'\n{aircraft}\n{flights}",
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

/// Sensors with everything that they can have.
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
        // The map takes its time, and no other part depends on it.
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
        // What is drawn for one component does not depend on another.
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
        // Rounding of 5e4 nT over a millisecond, 1e-8 nT/s, of which 2 % are felt; the fourth power of the step.
        assert!((at("flux_b", i) - expected).norm() < 1e-7, "{i}: {}", at("flux_b", i) - expected);
    }
}

/// A signal current of which one flight has a walk: two flights of two lines.
#[test]
fn law_landing_shifts_each_flight_and_the_walk_goes_on_through_it() {
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
    // 300 draws: standard error 4 %; four of them.
    assert!((sd(&shifts) / 10.0 - 1.0).abs() < 0.16, "{}", sd(&shifts));
    assert!((sd(&walks) / 8.0 - 1.0).abs() < 0.16, "{}", sd(&walks));
}

#[test]
fn law_wires_and_flex_act_where_they_are() {
    let sensors = "[[currents]]\nname = 'cur_x'\nkind = 'steady'\non_a = 3.0\n[[wires]]\ncurrent = 'cur_x'\n\
                   path = [[-2000.0, 0.0, 0.0], [2000.0, 0.0, 0.0]]\n[[vector_magnetometers]]\nname = 'flux_a'\n\
                   position_m = [0.0, 4.0, 0.0]\n[[vector_magnetometers]]\nname = 'flux_b'\nflex = [0.0, 2.0, 0.0]\n\
                   flex_limit_mps2 = 0.05\n";
    let line = &lines_of("component_columns = true", sensors, SURVEY)[0];
    // 3 A, 4 m: 200 nT m/A over 4 m times 3 A, downwards on the right of a current that goes forward.
    assert!(column(line, "part_currents_flux_a_z").iter().all(|b| (b - 150.0).abs() < 1e-3));
    assert!(column(line, "part_currents_flux_b_z").iter().all(|b| *b == 0.0), "without a place no wire is felt");
    let flex = column(line, "part_flex_flux_b_y");
    assert!(flex.iter().all(|b| b.abs() <= 0.1 + 1e-12) && flex.contains(&0.1) && sd(flex) > 0.0);
}

#[test]
fn law_magnetometers_measure_the_field_where_they_are() {
    // 60 m/s northward without gusts: 60 m ahead is where the INS is a second later.
    let north = "
[[flights]]
name = 'A'
start_tt_s = 36000.0
[[flights.lines]]
name = 'A.1'
alt_m = 700.0
speed_mps = 60.0
duration_s = 120.0
waypoints = [[-22.1, 140.65], [-21.9, 140.65]]
";
    let mags = "[[magnetometers]]\nname = 'mag_2_uc'\n[[magnetometers]]\nname = 'mag_3_uc'\narm_m = [60.0, 0.0, 0.0]\n\
                [[magnetometers]]\nname = 'mag_4_uc'\narm_m = [0.0, 0.0, -100.0]\n\
                [[magnetometers]]\nname = 'mag_5_uc'\narm_m = [0.0, 50.0, 0.0]\n";
    let still = |text: &str| text.replace("gusts_deg = [1.5, 0.5, 0.7]", "gusts_deg = [0.0, 0.0, 0.0]");
    let fly = |line: &str| {
        let folder = TempDir::new().unwrap();
        let path = spec(&folder, "rate_hz = 1.0", mags, line);
        fs::write(&path, still(&fs::read_to_string(&path).unwrap())).unwrap();
        let simulation = Simulation::open(&path).unwrap();
        simulation.into_lines(1).next().unwrap().unwrap().into_batch(&path).unwrap()
    };
    let flight = fly(north);
    let (here, ahead) = (column(&flight, "mag_2_uc"), column(&flight, "mag_3_uc"));
    let off = |k: usize| ahead[k] - here[k + 1];
    let moved: Vec<f64> = (10..100).map(|k| here[k + 1] - here[k]).collect();
    let missed: Vec<f64> = (10..100).map(off).collect();
    // Level flight has an angle of attack, by which 60 m ahead are some metres up.
    assert!(sd(&missed) < 0.1 * sd(&moved), "{} {}", sd(&missed), sd(&moved));
    let (up, right) = (column(&flight, "mag_4_uc"), column(&flight, "mag_5_uc"));
    let higher = fly(&north.replace("alt_m = 700.0", "alt_m = 800.0"));
    let over = column(&higher, "mag_2_uc");
    let missed: Vec<f64> = (10..100).map(|k| up[k] - over[k]).collect();
    let lifted: Vec<f64> = (10..100).map(|k| up[k] - here[k]).collect();
    assert!(sd(&missed) < 0.1 * sd(&lifted), "{} {}", sd(&missed), sd(&lifted));
    let east = fly(&north.replace("140.65", "140.650484"));
    let beside = column(&east, "mag_2_uc");
    let missed: Vec<f64> = (10..100).map(|k| right[k] - beside[k]).collect();
    let across: Vec<f64> = (10..100).map(|k| right[k] - here[k]).collect();
    assert!(sd(&missed) < 0.1 * sd(&across), "{} {}", sd(&missed), sd(&across));
}

#[test]
fn law_a_scalar_loses_its_signal_in_dead_zones_and_dropouts() {
    let sensor = |more: &str| format!("[[magnetometers]]\nname = 'mag_2_uc'\naxis = [0.0, 0.0, 1.0]\n{more}\n");
    let dead = |more: &str| lines_of("", &sensor(more), SURVEY)[0].clone();
    // At Osborne the field is 53 degrees from the level, 37 from the vertical; the aircraft rolls and pitches.
    let all = |line: &RecordBatch| column(line, "mag_2_uc").iter().filter(|x| x.is_nan()).count();
    assert_eq!(all(&dead("dead_polar_deg = 10.0\ndead_equatorial_deg = 10.0")), 0);
    assert_eq!(all(&dead("dead_polar_deg = 60.0")), 1201);
    assert_eq!(all(&dead("dead_equatorial_deg = 80.0")), 1201);
    let line = dead("dead_polar_deg = 39.0\n[[vector_magnetometers]]\nname = 'flux_a'");
    let flux = ["flux_a_x", "flux_a_y", "flux_a_z"].map(|n| column(&line, n));
    for (i, b) in column(&line, "mag_2_uc").iter().enumerate() {
        let level = flux[0][i].hypot(flux[1][i]);
        let from_axis_deg = level.atan2(flux[2][i].abs()).to_degrees();
        assert_eq!(b.is_nan(), from_axis_deg < 39.0, "{i}: {from_axis_deg}");
    }
    assert!((100..1100).contains(&all(&line)), "{}", all(&line));
    let zero = dead("dead_polar_deg = 60.0\nlost = 'zero'");
    assert!(column(&zero, "mag_2_uc").iter().all(|x| *x == 0.0));
    let long = SURVEY.replace("duration_s = 120.0", "duration_s = 3000.0");
    let dropped = &lines_of("rate_hz = 2.0", &sensor("dropouts = { mean_s = 20.0, for_s = 5.0 }"), &long)[0];
    let share = all(dropped) as f64 / dropped.num_rows() as f64;
    // 120 bursts: the share of a fifth has a standard error of 0.025; four of them.
    assert!((share - 0.2).abs() < 0.1, "{share}");
}

#[test]
fn law_heading_error_follows_the_angle_to_the_optical_axis() {
    let sensors = "[[magnetometers]]\nname = 'mag_2_uc'\nheading_nt = 30.0\naxis = [2.0, 0.0, 0.0]\n\
                   [[magnetometers]]\nname = 'mag_1_c'\n[[vector_magnetometers]]\nname = 'flux_a'\n";
    let line = &lines_of("component_columns = true", sensors, SURVEY)[0];
    let (error, x, total) = (column(line, "part_heading_mag_2_uc"), column(line, "flux_a_x"), column(line, "mag_1_c"));
    for i in 0..line.num_rows() {
        assert!((error[i] - 30.0 * x[i] / total[i]).abs() < 1e-9, "{i}");
    }
    assert!(sd(error) > 0.1);
}

#[test]
fn law_readings_are_multiples_of_the_resolution_and_spikes_are_rare() {
    let sensors =
        "[[magnetometers]]\nname = 'mag_2_uc'\nresolution_nt = 0.25\nspikes = { mean_s = 4.0, sigma_nt = 500.0 }\n";
    let line = &lines_of("component_columns = true", sensors, SURVEY)[0];
    assert!(column(line, "mag_2_uc").iter().all(|x| (x * 4.0).fract() == 0.0));
    let rounding = column(line, "part_quantisation_mag_2_uc");
    // A uniform error of a step: step / sqrt(12), within 5 % for 1200 samples.
    assert!((sd(rounding) - 0.25 / 12f64.sqrt()).abs() < 0.004, "{}", sd(rounding));
    let spikes = column(line, "part_spikes_mag_2_uc").iter().filter(|x| **x != 0.0).count();
    // 30 expected; four standard errors.
    assert!((8..=52).contains(&spikes), "{spikes}");
}

#[test]
fn law_a_vector_magnetometer_is_turned_scaled_and_warmed() {
    let sensors = "[temperature]\nstart_degc = 30.0\nsettled_degc = 10.0\ntau_s = 40.0\n\
                   [[vector_magnetometers]]\nname = 'flux_a'\nmisaligned_deg = 2.0\nnon_orthogonal_deg = 1.0\n\
                   [[vector_magnetometers]]\nname = 'flux_b'\nmisaligned_deg = 2.0\n\
                   [[vector_magnetometers]]\nname = 'flux_c'\ntemperature_nt_per_degc = 3.0\n\
                   [[vector_magnetometers]]\nname = 'flux_d'\n[[inputs]]\nname = 'temp'\nkind = 'temperature'\n";
    let line = &lines_of("component_columns = true", sensors, SURVEY)[0];
    let at = |name: &str, i: usize| Vector3::from(["x", "y", "z"].map(|a| column(line, &format!("{name}_{a}"))[i]));
    let (mut skewed, mut worst) = (0.0_f64, 0.0_f64);
    for i in 0..line.num_rows() {
        let truth = at("flux_d", i);
        skewed = skewed.max((at("flux_a", i).norm() - truth.norm()).abs());
        worst = worst.max((at("flux_b", i).norm() - truth.norm()).abs());
        assert!((at("flux_b", i) - truth).norm() > 10.0, "it is turned");
        let warm = at("flux_c", i) - truth;
        let first = at("flux_c", 0) - at("flux_d", 0);
        let degc = column(line, "temp")[i] - 20.0;
        assert!((warm - first * (degc / 10.0)).norm() < 1e-6, "as the temperature beyond the reference of 20");
    }
    // A rotation keeps the length; axes that are not square do not.
    assert!(worst < 1e-9 && skewed > 10.0, "{worst} {skewed}");
}

#[test]
fn law_currents_switch_between_their_levels() {
    let intervals = switched((8.0, 4.0), 0.0, 2e4, &mut Random::of(5, &["test"]));
    assert!(intervals.windows(2).all(|w| w[0][1] < w[1][0]));
    let on = intervals.iter().map(|[from, until]| until.min(2e4) - from.max(0.0)).sum::<f64>() / 2e4;
    // 1667 cycles: the share of 1/3 has a standard error of 0.008; four of them.
    assert!((on - 1.0 / 3.0).abs() < 0.032, "{on}");
    let starts_on = |k: &usize| {
        let mut random = Random::of(5, &["start", &k.to_string()]);
        switched((8.0, 4.0), 0.0, 0.0, &mut random).first().is_some_and(|[from, _]| *from < 0.0)
    };
    let first = (0..300).filter(starts_on).count() as f64 / 300.0;
    // Standard error 0.027; four of them.
    assert!((first - 1.0 / 3.0).abs() < 0.11, "{first}");
}

#[test]
fn law_currents_keep_their_schedules() {
    let currents = "[[currents]]\nname = 'cur_s'\nkind = 'schedule'\nschedule = [[10.0, 20.0], [50.0, 60.0]]\n\
                    ramp_s = 4.0\noff_a = 1.0\non_a = 5.0\n\
                    [[currents]]\nname = 'cur_p'\nkind = 'periodic'\nevery_s = 1.5\nfor_s = 0.3\non_a = 2.0\nscale = 1.1\n\
                    [[currents]]\nname = 'cur_h'\nkind = 'heater'\non_a = 7.0\nkeep_degc = 30.0\nwarm_tau_s = 40.0\n\
                    [[currents]]\nname = 'cur_e'\nkind = 'engine'\non_a = 100.0\ncruise = 0.4\nper_load = 0.0\n\
                    [[currents]]\nname = 'cur_n'\nkind = 'steady'\non_a = 1.0\nmeasured = false\n\
                    [[voltages]]\nname = 'vol_b'\nvolts = 24.0\nohm = { cur_e = 0.05, cur_n = 1.0 }\n\
                    discharge_v_per_h = 36.0\n[[inputs]]\nname = 'throttle'\nkind = 'current'\nof = 'cur_e'\ngain = 100.0\n";
    let line = &lines_of("", currents, SURVEY)[0];
    let c = |name: &str| column(line, name);
    for (t, a) in
        [(9.9, 1.0), (10.0, 1.0), (12.0, 3.0), (15.0, 5.0), (22.0, 3.0), (24.0, 1.0), (52.0, 3.0), (90.0, 1.0)]
    {
        assert!((c("cur_s")[(t * 10.0_f64).round() as usize] - a).abs() < 1e-9, "{t} s");
    }
    for (i, a) in c("cur_p").iter().enumerate() {
        assert_eq!(*a, if i % 15 < 3 { 2.2 } else { 0.0 }, "{i}");
    }
    let switches = c("cur_h").windows(2).filter(|w| w[0] != w[1]).count();
    assert!((3..60).contains(&switches), "the heater comes and goes: {switches}");
    // Level flight at the cruising speed; round the earth and into the weave the load is 1e-6 off.
    assert!(c("cur_e").iter().all(|a| (a - 40.0).abs() < 2e-4) && (c("throttle")[7] - 40.0).abs() < 2e-4);
    // 40 A through 0.05 ohm and an unseen ampere through 1 ohm, and 0.01 V/s.
    assert!((c("vol_b")[100] - (24.0 - 2.0 - 1.0 - 0.1)).abs() < 1e-4);
    assert!(line.column_by_name("cur_n").is_none());
}

#[test]
fn law_servos_follow_the_attitude() {
    let current = "[[currents]]\nname = 'cur_r'\nkind = 'servo'\naxes = [1.0, 0.0, 0.0]\nfull_dps = 30.0\non_a = 6.0\nsigned = true\n";
    let line = &lines_of("", current, SURVEY)[0];
    let angle = |name: &str, i: usize| column(line, name)[i].to_radians();
    let roll = column(line, "roll");
    for i in 1..line.num_rows() - 1 {
        // The rate of roll of the rates about the body's axes. [Titterton & Weston 2004, (3.44)]
        let across = column(line, "pitch_rate")[i] * angle("roll", i).sin();
        let down = column(line, "yaw_rate")[i] * angle("roll", i).cos();
        let rate = column(line, "roll_rate")[i] + (across + down) * angle("pitch", i).tan();
        assert!((column(line, "cur_r")[i] - 6.0 * rate / 30.0).abs() < 1e-9, "{i}");
        let difference = (roll[i + 1] - roll[i - 1]) / 0.2;
        // h²/6 of the third derivative, of 1.5 degrees that sway at up to 3 rad/s: 0.07 deg/s.
        assert!((rate - difference).abs() < 0.2, "{i}: {rate} {difference}");
    }
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
         [[wires]]\ncurrent = 'cur_y'\npath = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]\n[[magnetometers]]\nname = 'mag_4_uc'\n\
         induced = [[1.0, 2.0, 3.0]]\n[[inputs]]\nname = 'lat'\nkind = 'speed'\n",
        SURVEY,
    );
    let said = Simulation::open(&path).unwrap_err().to_string();
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
        assert!(said.contains(what), "{what} is not in\n{said}");
        assert!(said.contains(&format!("a.synth.toml:{place}\n")), "{place} of {what} is not in\n{said}");
    }
    for help in ["did you mean `schedule`?", "did you mean `heading_nt`?"] {
        assert!(said.contains(help), "{help} is not in\n{said}");
    }
}

#[test]
fn ref_the_drone_does_what_its_ground_test_showed() {
    let folder = TempDir::new().unwrap();
    let path = spec(&folder, "preset = 'drone'", "", SURVEY);
    let aircraft = Simulation::open(&path).unwrap().spec().aircraft.clone();
    // Thesis 004, 3.2.3: the lights about 50 nT, steering around 10 nT, the engine around 5 nT.
    for (name, published_nt) in [("cur_led", 50.0), ("cur_srvo_a", 10.0), ("cur_batt", 5.0)] {
        let index = aircraft.currents.iter().position(|c| c.name == name).unwrap();
        let (off_a, on_a) = aircraft.currents[index].off_on_a;
        for sensor in &aircraft.scalars[1..] {
            let at_m = sensor.source.position_m.unwrap();
            let wires = aircraft.wires.iter().filter(|w| w.current == index);
            let field_nt = wires.map(|w| w.nt_per_a(&at_m)).sum::<Vector3<f64>>() * (on_a - off_a);
            assert!((0.7..1.4).contains(&(field_nt.norm() / published_nt)), "{name}: {} nT", field_nt.norm());
        }
    }
}

#[test]
fn law_induced_tensors_have_their_size_and_symmetry() {
    let tensor = |name: &str, symmetric: bool| {
        let folder = TempDir::new().unwrap();
        let sensor =
            format!("[[vector_magnetometers]]\nname = '{name}'\ninduced_nt = 100.0\ninduced_symmetric = {symmetric}\n");
        let simulation = Simulation::open(&spec(&folder, "", &sensor, SURVEY)).unwrap();
        let Spec { seed, aircraft, components, .. } = simulation.spec();
        let feeds = Feeds::of(aircraft, &[], 10.0, components);
        let source = &aircraft.vectors[0].source;
        let field = Field::draw(*seed, ("A", 0.0), (name, source), (aircraft, &feeds), components);
        let along = |axis: usize| {
            let (earth_nt, rate_ntps) = (Vector3::ith(axis, 50_000.0), Vector3::zeros());
            let iron = Vector3::zeros();
            let drive = Drive { earth_nt, rate_ntps, feeds_a: &[], row: 0, since_s: 0.0, lift_mps2: 0.0, iron };
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
    // 900 elements of 100 nT; differences of two that are independent have twice the variance. Standard errors 2.4 %
    // and 6 %; four of each.
    assert!((f64::sqrt(squares) / 100.0 - 1.0).abs() < 0.1, "{squares}");
    assert!((apart / 20_000.0 - 1.0_f64).abs() < 0.25, "{apart}");
}
