//! Errors of real sensors, currents and recorders: absent by default and when switched off, otherwise as declared.

use super::*;

/// The first line, without the map's anomaly, which is slow. `aircraft` holds the aircraft's tables, the last of which
/// is `[components]`.
fn line_of(top: &str, aircraft: &str) -> RecordBatch {
    let switch = if aircraft.contains("[components]") { "" } else { "\n[components]" };
    lines_of(top, &format!("{aircraft}{switch}\nanomaly = false\n"), SURVEY)[0].clone()
}

/// The components of the field that are zero unless a spec sets their magnitude.
const CAUSES: [&str; 18] = [
    "hysteresis",
    "current_lag",
    "current_iron",
    "return_path",
    "unreported",
    "linearity",
    "core_hysteresis",
    "temperature_scale",
    "thermal_lag",
    "crosstalk",
    "bandwidth",
    "axis_lag",
    "channel_scale",
    "channel_delay",
    "channel_response",
    "channel_limit",
    "channel_resolution",
    "channel_stuck",
];

/// Tables of an aircraft without any of these keys.
const PLAIN: &str = "
[temperature]
settled_degc = 5.0
tau_s = 60.0
[[currents]]
name = 'cur_x'
on_a = 4.0
noise_a = 0.1
[[wires]]
current = 'cur_x'
path = [[0.0, 0.0, 0.0], [-3.0, 0.5, 0.0], [-3.0, 0.5, 1.0]]
closed = true
[[magnetometers]]
name = 'mag_2_uc'
position_m = [-1.0, 0.4, 0.3]
permanent_nt = 400.0
noise_nt = 0.1
[[vector_magnetometers]]
name = 'flux_a'
position_m = [-2.0, 0.4, 0.3]
scale = 0.001
temperature_nt_per_degc = 1.0
noise_nt = 1.0
lag_s = 0.15
";

/// Tables of the aircraft, with all of these keys.
fn with_everything() -> String {
    let on_current = "noise_a = 0.1\nscale = 1.2\ndelay_s = 0.3\nresponse_s = 0.4\nlimit = 3.0\nresolution_a = 0.5\n\
                      stuck_at = 2.0\neddy_share = 0.4\neddy_tau_s = 0.5\nremanence = 0.1";
    let on_flux = "lag_s = 0.15\nhysteresis_nt = 5.0\nlinearity_ppm = 150.0\ncore_hysteresis_nt = 2.0\n\
                   temperature_scale_ppm_per_degc = 70.0\nthermal_tau_s = 30.0\ncrosstalk = { cur_x = 0.5 }\n\
                   bandwidth_hz = 1.0\naxis_lag_s = [0.1, 0.2, 0.3]";
    let hidden = "[[currents]]\nname = 'cur_z'\non_a = 7.0\nmeasured = false\n[[wires]]\ncurrent = 'cur_z'\n\
                  path = [[0.0, 0.0, 0.0], [-3.0, 0.6, 0.0]]\n[[wires]]\ncurrent = 'cur_x'\nonset_a = 2.0\n\
                  path = [[0.0, 0.0, 0.0], [-3.0, 0.0, 0.0]]\n[[wires]]";
    PLAIN
        .replace("noise_a = 0.1", on_current)
        .replace("permanent_nt = 400.0", "permanent_nt = 400.0\nhysteresis_nt = 20.0")
        .replace("lag_s = 0.15", on_flux)
        .replacen("[[wires]]", hidden, 1)
}

const COLUMNS: [&str; 5] = ["mag_2_uc", "flux_a_x", "flux_a_y", "flux_a_z", "cur_x"];

#[test]
fn unit_components_that_are_off_leave_the_bytes_unchanged() {
    let plain = line_of("", PLAIN);
    let off: String = CAUSES.iter().map(|cause| format!("{cause} = false\n")).collect();
    let all_off = line_of("", &format!("{}\n[components]\n{off}", with_everything()));
    let all_on = line_of("", &with_everything());
    for name in COLUMNS {
        let bits = |line: &RecordBatch| column(line, name).iter().map(|x| x.to_bits()).collect::<Vec<u64>>();
        assert!(bits(&plain) == bits(&all_off), "{name}");
        assert!(bits(&plain) != bits(&all_on), "{name}");
    }
}

#[test]
fn unit_the_real_cessna_without_these_components_equals_the_cessna() {
    let off: String = CAUSES.iter().map(|cause| format!("{cause} = false\n")).collect();
    let fluxgates = ["flux_a", "flux_b", "flux_c", "flux_d"].map(|name| {
        format!(
            "[[vector_magnetometers]]\nname = '{name}'\npermanent_shift_nt = 0.0\npermanent_walk_nt_per_sqrt_h = 0.0\n\
             flex_nt_per_mps2 = 0.0\n"
        )
    });
    let back = format!("[temperature]\nswing_degc = 0.5\n{}[components]\n{off}", fluxgates.join(""));
    let (plain, real) = (line_of("preset = 'cessna'", ""), line_of("preset = 'cessna_real'", &back));
    assert!(plain == real);
    assert!(plain != line_of("preset = 'cessna_real'", ""));
}

#[test]
fn unit_each_component_alone_changes_the_readings() {
    let stuck = with_everything().replace("stuck_at = 2.0\n", "");
    let all = line_of("", &stuck);
    for cause in CAUSES.iter().filter(|cause| **cause != "channel_stuck") {
        let without = line_of("", &format!("{stuck}\n[components]\n{cause} = false\n"));
        assert!(COLUMNS.iter().any(|name| column(&all, name) != column(&without, name)), "{cause}");
    }
}

/// A current that is switched on after 20 s, and a fluxgate at which it adds 10 nT/A downwards.
fn switched_on(more: &str, on_flux: &str) -> RecordBatch {
    let sensors = format!(
        "[[currents]]\nname = 'cur_x'\nkind = 'schedule'\nschedule = [[20.0, 60.0]]\non_a = 4.0\n{more}\n\
         [[vector_magnetometers]]\nname = 'flux_a'\n{on_flux}\n"
    );
    line_of("component_columns = true", &sensors)
}

const COUPLED: &str = "currents = { cur_x = [0.0, 0.0, 10.0] }";

#[test]
fn law_eddy_currents_delay_the_declared_share_with_the_declared_time_constant() {
    let line = switched_on("eddy_share = 0.3\neddy_tau_s = 2.0", COUPLED);
    let (field, reported) = (column(&line, "part_currents_flux_a_z"), column(&line, "cur_x"));
    for i in 0..590 {
        let t = i as f64 / 10.0;
        assert_eq!(reported[i], if t < 20.0 { 0.0 } else { 4.0 }, "the column excludes it");
        // The current rises linearly over one sample, 0.1 s; the expected value is the mean of the exponential over
        // this rise.
        let mean = 2.0 / 0.1 * ((-(t - 20.0) / 2.0).exp() - (-(t - 19.9) / 2.0).exp());
        let expected = if t < 20.0 { 0.0 } else { 40.0 * (1.0 - 0.3 * mean) };
        assert!((field[i] - expected).abs() < 1e-9, "{t} s: {} {expected}", field[i]);
    }
}

#[test]
fn law_iron_keeps_the_declared_remanence_and_the_column_omits_it() {
    let line = switched_on("remanence = 0.1", COUPLED);
    let (field, reported) = (column(&line, "part_currents_flux_a_z"), column(&line, "cur_x"));
    // The remanence is a tenth of 40 nT; at the full current Rayleigh's law adds twice as much.
    for (i, expected) in [(100, 4.0), (300, 48.0), (800, 4.0)] {
        assert!((field[i] - expected).abs() < 0.01, "{i}: {}", field[i]);
    }
    assert_eq!((reported[100], reported[300], reported[800]), (0.0, 4.0, 0.0));
}

#[test]
fn law_an_unmeasured_current_has_a_field() {
    let line = switched_on("measured = false", COUPLED);
    assert!(line.column_by_name("cur_x").is_none());
    assert_eq!(column(&line, "part_currents_flux_a_z")[300], 40.0);
}

#[test]
fn law_crosstalk_affects_one_reading_and_not_the_field() {
    let other = "crosstalk = { cur_x = [0.0, 2.0, -1.0] }\n[[vector_magnetometers]]\nname = 'flux_b'";
    let line = switched_on("", other);
    for i in 0..600 {
        let amperes = if i < 200 { 0.0 } else { 4.0 };
        let at = |axis: &str| column(&line, &format!("flux_a_{axis}"))[i] - column(&line, &format!("flux_b_{axis}"))[i];
        assert!(at("x").abs() < 1e-9 && (at("y") - 2.0 * amperes).abs() < 1e-9 && (at("z") + amperes).abs() < 1e-9);
        assert_eq!(column(&line, "part_currents_flux_a_y")[i], 0.0);
    }
}

#[test]
fn law_channels_have_the_declared_errors() {
    let read = |more: &str| column(&switched_on(more, ""), "cur_x")[..600].to_vec();
    let late = read("delay_s = 1.5");
    assert_eq!((late[214], late[215]), (0.0, 4.0));
    let slow = read("response_s = 0.5");
    for i in 205..600 {
        assert!(((4.0 - slow[i]) - (4.0 - slow[i - 1]) * (-0.2_f64).exp()).abs() < 1e-12, "{i}");
    }
    assert!((slow[205] - 4.0).abs() > 1.0 && (slow[599] - 4.0).abs() < 1e-9);
    let cut = read("limit = 3.0");
    assert_eq!((cut[100], cut[300]), (0.0, 3.0));
    let coarse = read("noise_a = 0.3\nresolution_a = 0.25");
    assert!(coarse.iter().all(|a| (a * 4.0).fract() == 0.0) && sd(&coarse[..190]) > 0.2);
    let stuck = read("stuck_at = 1.25\nnoise_a = 0.01");
    assert!(stuck.iter().all(|a| (a - 1.25).abs() < 0.06) && sd(&stuck) > 0.005);
    assert_eq!(read("scale = -0.5")[300], -2.0);
}

#[test]
fn law_fluxgates_have_the_declared_nonlinearity_and_temperature_scale() {
    let sensors: Vec<String> = (0..100)
        .map(|k| {
            format!(
                "[[vector_magnetometers]]\nname = 'flux_w{k}'\nlinearity_ppm = 150.0\n\
                 temperature_scale_ppm_per_degc = 70.0\nthermal_tau_s = 0.0\n"
            )
        })
        .collect();
    let plain = "[temperature]\nstart_degc = 30.0\n[[vector_magnetometers]]\nname = 'flux_a'\n";
    let line = line_of("component_columns = true\nrate_hz = 1.0", &format!("{plain}{}", sensors.join("")));
    let (mut bent, mut warmed) = (vec![], vec![]);
    for k in 0..100 {
        for axis in AXES {
            let truth = column(&line, &format!("flux_a_{axis}"));
            let linearity = column(&line, &format!("part_linearity_flux_w{k}_{axis}"));
            let scale = column(&line, &format!("part_temperature_scale_flux_w{k}_{axis}"));
            // The third Chebyshev polynomial is cos(3 acos u).
            let size = |i: usize| linearity[i] / (3.0 * (truth[i] / 1e5).acos()).cos();
            let per_degc = |i: usize| scale[i] / (truth[i] + linearity[i]) / 10.0;
            for i in 0..truth.len() {
                assert!((size(i) - size(0)).abs() < 1e-6 * size(0).abs().max(1.0), "{k} {axis} {i}");
                assert!((per_degc(i) - per_degc(0)).abs() < 1e-12, "{k} {axis} {i}");
            }
            bent.push(size(0));
            warmed.push(per_degc(0) * 1e6);
        }
    }
    // The error is 150 ppm of 100,000 nT. The tolerance is four standard errors; the standard error of 300 draws is 4
    // %.
    assert!((sd(&bent) / 15.0 - 1.0).abs() < 0.16, "{}", sd(&bent));
    assert!((sd(&warmed) / 70.0 - 1.0).abs() < 0.16, "{}", sd(&warmed));
}

#[test]
fn law_the_hysteresis_of_the_airframe_follows_rayleighs_law() {
    let sensors = "[[vector_magnetometers]]\nname = 'flux_a'\n[[vector_magnetometers]]\nname = 'flux_b'\n\
                   hysteresis = [[10.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 10.0]]\n";
    let line = line_of("component_columns = true", sensors);
    let part = ["x", "y", "z"].map(|axis| column(&line, &format!("part_hysteresis_flux_b_{axis}")));
    let (x, z) = (column(&line, "flux_a_x"), column(&line, "flux_a_z"));
    let level = x.iter().zip(column(&line, "flux_a_y")).map(|(x, y)| x.hypot(*y)).fold(0.0, f64::max) / 5e4;
    assert!(part[1].iter().all(|y| *y == 0.0));
    assert!(sd(part[0]) > 0.05 && sd(part[2]) > 0.05, "{} {}", sd(part[0]), sd(part[2]));
    let mut deepest = 0.0_f64;
    for i in 0..line.num_rows() {
        // After a full turn the field along x has reached plus and minus the level field. The remanence lies within the
        // loop between these.
        let u = x[i] / 5e4;
        let (middle, half) = (20.0 * level * u, 10.0 * (level * level - u * u).max(0.0));
        assert!((part[0][i] - middle).abs() < half + 0.2, "{i}: {} is not in the loop at {u}", part[0][i]);
        // Along z the iron is on the first loading or, past a maximum, between the first loading and the tip of the
        // loop.
        let u = z[i].abs() / 5e4;
        deepest = deepest.max(u);
        let beyond = part[2][i].abs() - 20.0 * u * u;
        let most = 20.0 * (deepest * deepest - u * u);
        assert!(part[2][i] * z[i] > 0.0 && (-0.05..most + 0.05).contains(&beyond), "{i}: {beyond} of {most}");
    }
    assert!(deepest > 0.5);
}
