#![allow(clippy::unwrap_used)]
use crate::navigate::testing::*;
use arrow_array::RecordBatch;

const FILTERS: [&str; 3] = ["ekf", "iekf", "ukf"];
const GRADIENT: &str = "map_interpolation = 'cubic'\ngradient = ['mag_1_c', 'mag_2_c']\n\
                        gradient_baseline_m = [15.0, 0.0, 0.0]\ngradient_sigma_nt = 0.03\n\
                        gradient_bias_sigma_nt = 0.1\n";

/// Common error of both magnetometers, in nT.
fn storm_nt(row: usize) -> f64 {
    120.0 * (row as f64 / 30.0).sin()
}

/// A flight in a magnetic storm. The second magnetometer is 15 m behind the first. Their readings differ by 0.05 nT,
/// and the noise is 0.02 nT.
fn in_a_storm() -> RecordBatch {
    let noise = |row: usize, by: f64| 0.02 * (by * row as f64).sin();
    let first = with(&flight(), "mag_1_c", |row, _| ahead_nt(row, 7.5) + storm_nt(row) + 0.05 + noise(row, 2.3));
    with(&first, "mag_2_c", |row, _| ahead_nt(row, -7.5) + storm_nt(row) + noise(row, 1.7))
}

#[test]
fn unit_the_difference_bounds_the_error_in_a_magnetic_storm() {
    let stormy = in_a_storm();
    for filter in FILTERS {
        let found = flown(filter, &format!("{GRADIENT}use_scalar = false"), &stormy).unwrap();
        let lost = flown(filter, "map_interpolation = 'cubic'\nmag = 'mag_1_c'", &stormy).unwrap();
        let (held_m, lost_m) = (found.error_m(ROWS - 1), lost.error_m(ROWS - 1));
        // The INS error is 156 m at that time.
        assert!(held_m < 25.0 && lost_m > 150.0, "{filter}: {held_m} {lost_m}");
        assert_eq!(found.updates("used"), ROWS);
        let (residual, nis) = (found.numbers("gradient_residual"), found.numbers("gradient_nis"));
        assert!(residual.iter().all(|nt| nt.abs() < 1.0) && nis.iter().all(|nis| nis.is_finite()));
        assert_eq!(found.numbers("residual"), residual, "without the field the innovation is the difference's");
    }
}

#[test]
fn unit_the_difference_improves_a_field_with_known_storm_noise() {
    let calm = with(&in_a_storm(), "mag_1_c", |row, nt| nt - storm_nt(row));
    let calm = with(&calm, "mag_2_c", |row, nt| nt - storm_nt(row));
    for filter in FILTERS {
        let keys = "mag = 'mag_1_c'\nmap_interpolation = 'cubic'\n";
        let of = |more: &str| flown(filter, &format!("{keys}{more}"), &calm).unwrap();
        let (alone, both) = (of(""), of(&GRADIENT.replace("map_interpolation = 'cubic'\n", "")));
        let end = |found: &NavigateOutput, name: &str| found.numbers(name)[ROWS - 1];
        let sigma = |found: &NavigateOutput| end(found, "sd_n").hypot(end(found, "sd_e"));
        assert!(sigma(&both) < 0.9 * sigma(&alone), "{filter}: {} {}", sigma(&both), sigma(&alone));
        assert!(both.error_m(ROWS - 1) < 25.0, "{filter}: {}", both.error_m(ROWS - 1));
        assert!(filter != "ukf" || both.numbers("sd_nonlinear").iter().all(|nt| nt.is_finite()));
    }
}

#[test]
fn unit_over_a_flat_map_the_track_equals_the_ins() {
    let run_with = |filter: &str, flat: &str| run(filter, &format!("mag = 'mag_2_c'\nflat_over_m = {flat}"));
    let ins = run("ins_only", "");
    for filter in FILTERS {
        // Slope limit of 1.5 nT/m, which the map does not exceed.
        let flat = run_with(filter, "1.0");
        assert_eq!((flat.updates("flat"), flat.updates("missing")), (ROWS - 30, 30));
        assert_eq!(flat.numbers("lat"), ins.numbers("lat"));
        let steep = run_with(filter, "1e6");
        assert_eq!((steep.updates("flat"), steep.updates("used")), (0, ROWS - 30));
        let some = run_with(filter, "15.0");
        let slopes = some.numbers("map_slope");
        for (row, word) in some.words("update").iter().enumerate().filter(|(_, word)| *word != "missing") {
            assert_eq!(word == "flat", 1.5 > 15.0 * slopes[row], "{filter} {row}: {word} {}", slopes[row]);
        }
        assert!(some.updates("flat") > 10 && some.updates("used") > 10);
    }
}

#[test]
fn unit_states_of_zero_sigma_leave_the_filter_unchanged() {
    for filter in FILTERS {
        let usual = run(filter, "mag = 'mag_1_c'");
        let with = run(filter, "mag = 'mag_1_c'\nmap_sigma_nt = 0.0");
        for row in 0..ROWS {
            let off_deg = (usual.numbers("lat")[row] - with.numbers("lat")[row]).abs();
            assert!(off_deg < 1e-10, "{filter} {row}: {off_deg}");
        }
        assert_eq!(usual.words("update"), with.words("update"));
        assert!(
            run(filter, "mag = 'mag_1_c'\nmap_sigma_nt = 20.0").numbers("sd_n")[ROWS - 1]
                > usual.numbers("sd_n")[ROWS - 1]
        );
    }
}

#[test]
fn unit_a_height_measurement_bounds_the_height() {
    // The measured height is the true height; the height of the INS drifts.
    let off = with(&flight(), "ins_alt", |row, alt| alt + 0.1 * row as f64);
    let off = with(&off, "alt", |row, alt| alt + 4.0 + 2.0 * (1.9 * row as f64).sin());
    let keys = "mag = 'mag_1_c'\nbaro_sigma_m = 50.0\nha_sigma_m = 50.0\ninit_altitude_sigma_m = 10.0\n";
    for filter in FILTERS {
        let height = "height = 'alt'\nheight_sigma_m = 2.0\nheight_bias_sigma_m = 5.0";
        let found = flown(filter, &format!("{keys}{height}"), &off).unwrap();
        let without = flown(filter, keys, &off).unwrap().numbers("alt")[ROWS - 1];
        let alt = found.numbers("alt")[ROWS - 1];
        assert!((alt - 300.0).abs() < 10.0 && (without - 300.0).abs() > 30.0, "{filter}: {alt} {without}");
        assert!(found.numbers("height_nis").iter().all(|nis| nis.is_finite()));
    }
}

#[test]
fn unit_impossible_measurements_are_rejected_before_the_run() {
    let refused = |keys: &str, words: &str| assert_refused("ekf", &format!("mag = 'mag_1_c'\n{keys}"), words);
    let cubic = "map_interpolation = 'cubic'\ngradient_baseline_m = [9.0, 0.0, 0.0]\n";
    refused("gradient = ['mag_1_c', 'mag_2_c']\ngradient_baseline_m = [9.0, 0.0, 0.0]", "steps in a bilinear map");
    refused("map_interpolation = 'cubic'\ngradient = ['mag_1_c', 'mag_2_c']", "`gradient_baseline_m`");
    refused(&format!("{cubic}gradient = ['mag_1_c', 'mag_7_c']"), "mag_7_c");
    refused(&format!("{cubic}gradient = ['mag_1_c', 'mag_1_c']"), "duplicate");
    refused(&format!("{cubic}gradient = ['mag_1_c', 'ins_alt']"), "ins_alt");
    let flat = cubic.replace("9.0", "0.0");
    refused(&format!("{flat}gradient = ['mag_1_c', 'mag_2_c']"), "length 0");
    refused("use_scalar = false", "no measurement depends on the map");
    refused("gradient_sigma_nt = 0.2", "no effect without `gradient`");
    refused("height_sigma_m = 2.0", "no effect without `height`");
    refused("map_sigma_length_m = 2.0", "no effect without `map_sigma_nt`");
    refused("vector_bias_tau_s = 2.0", "no effect without `vector_sigma_nt`");
    refused("vector_sigma_nt = 5.0", "`vector`");
    refused("vector = 'flux_d'\nvector_sigma_nt = 5.0", "requires `core_field = true`");
    refused("height = 'mag_1_c'", "mag_1_c");
    refused("flat_over_m = 0.0", "flat_over_m");
    refused("permanent_change_sigma_nt = 5.0", "requires `core_field = true`");
    refused("permanent_change_sigma_nt = 0.0\npermanent_change_tau_s = 9.0", "no effect without");
    refused("permanent_change_sigma_nt = -1.0", "permanent_change_sigma_nt");
    refused("map_height_sigma_m = -1.0", "map_height_sigma_m");
    for filter in ["rts", "mpf", "crlb", "ekf_adaptive", "fixed_lag"] {
        assert_refused(filter, "permanent_change_sigma_nt = 5.0", "available only in `ekf`, `iekf` and `ukf`");
        assert_refused(filter, "map_height_sigma_m = 5.0", "available only in `ekf`, `iekf` and `ukf`");
    }
    assert_refused("slam", "flat_over_m = 10.0", "belongs to");
    assert_refused("mpf", "flat_over_m = 10.0", "not available");
    assert_refused("crlb", "flat_over_m = 10.0", "no effect on the bound");
    for (filter, ..) in OTHERS.iter().filter(|(filter, ..)| !["rts", "crlb", "mpf"].contains(filter)) {
        let keys = format!("{GRADIENT}use_scalar = false");
        assert_refused(filter, &keys, "cannot be estimated");
    }
}

/// The other filters with their keys, and the measurement that each uses: with or without the aircraft field.
const OTHERS: [(&str, &str, &str); 6] = [
    ("ekf_adaptive", "", "mag_1_c"),
    ("rts", "", "mag_1_c"),
    ("crlb", "", "mag_1_c"),
    ("mpf", "particles = 2000", "mag_1_c"),
    ("ekf_online_tl", "walk_per_hour = 0.0", "mag_1_uc"),
    ("fixed_lag", "aircraft_sigma_nt = 0.0", "mag_1_uc"),
];

#[test]
fn unit_the_difference_improves_the_other_filters() {
    let calm = with(&in_a_storm(), "mag_1_c", |row, nt| nt - storm_nt(row));
    let calm = with(&calm, "mag_2_c", |row, nt| nt - storm_nt(row));
    for (filter, own, mag) in OTHERS {
        let keys = format!("mag = '{mag}'\nmap_interpolation = 'cubic'\n{own}\n");
        let of = |more: &str| flown(filter, &format!("{keys}{more}"), &calm).unwrap();
        let (alone, both) = (of(""), of(&GRADIENT.replace("map_interpolation = 'cubic'\n", "")));
        let sigma = |found: &NavigateOutput| found.numbers("sd_n")[300].hypot(found.numbers("sd_e")[300]);
        // The scalar field is already more accurate with its estimated noise than with the assumed noise.
        assert!(sigma(&both) < 0.99 * sigma(&alone), "{filter}: {} {}", sigma(&both), sigma(&alone));
        assert!(both.error_m(ROWS - 1) < 25.0, "{filter}: {}", both.error_m(ROWS - 1));
        assert_eq!(both.updates("used"), ROWS, "{filter}");
        let nis = both.numbers("gradient_nis");
        assert!(nis.iter().all(|nis| nis.is_finite()) && nis.iter().sum::<f64>() < 3.0 * ROWS as f64, "{filter}");
    }
}

#[test]
fn unit_a_smoother_navigates_with_the_difference_only() {
    let found = flown("rts", &format!("{GRADIENT}use_scalar = false"), &in_a_storm()).unwrap();
    assert!((50..ROWS).all(|row| found.error_m(row) < 25.0), "{}", found.error_m(ROWS - 1));
    assert_eq!((found.updates("used"), found.words("smoothing")[0].as_str()), (ROWS, "converged"));
}

#[test]
fn unit_particles_navigate_with_the_difference_only() {
    let found = flown("mpf", &format!("{GRADIENT}use_scalar = false\nparticles = 2000"), &in_a_storm()).unwrap();
    assert!((50..ROWS).all(|row| found.error_m(row) < 25.0), "{}", found.error_m(ROWS - 1));
    assert_eq!(found.updates("used"), ROWS);
    assert_eq!(found.numbers("residual"), found.numbers("gradient_residual"));
    assert!(found.numbers("n_eff").iter().all(|n| *n > 1.0));
}

#[test]
fn unit_over_a_flat_map_the_other_tracks_equal_the_ins() {
    let ins = run("ins_only", "");
    for (filter, own, _) in OTHERS.iter().filter(|(filter, ..)| *filter != "crlb" && *filter != "mpf") {
        // The flatness limit depends on the noise, which `ekf_adaptive` estimates.
        let own = if *filter == "ekf_adaptive" { "sigma_min_nt = 1.5\nsigma_max_nt = 1.5" } else { own };
        let run_with = |flat: &str| run(filter, &format!("mag = 'mag_2_c'\nflat_over_m = {flat}\n{own}"));
        let flat = run_with("1.0");
        assert_eq!((flat.updates("flat"), flat.updates("missing")), (ROWS - 30, 30), "{filter}");
        assert_eq!(flat.numbers("lat"), ins.numbers("lat"), "{filter}");
        let steep = run_with("1e6");
        assert_eq!((steep.updates("flat"), steep.updates("used")), (0, ROWS - 30), "{filter}");
        assert!(steep.numbers("map_slope").iter().all(|slope| *slope > 0.0), "{filter}");
    }
}

#[test]
fn unit_a_map_error_of_zero_leaves_the_other_filters_unchanged() {
    for (filter, own, mag) in OTHERS {
        let keys = format!("mag = '{mag}'\n{own}\n");
        let (usual, with) = (run(filter, &keys), run(filter, &format!("{keys}map_sigma_nt = 0.0")));
        // A smoother stops at steps below 0.1 m, and the slope of a bilinear map has discontinuities.
        let within_deg = if filter == "rts" { 1e-5 } else { 1e-8 };
        for (row, (one, other)) in usual.numbers("lat").iter().zip(with.numbers("lat")).enumerate() {
            assert!((one - other).abs() < within_deg, "{filter} {row}: {one} {other}");
        }
        let lasting = run(filter, &format!("{keys}map_sigma_nt = 20.0"));
        assert!(lasting.numbers("sd_n")[300] > usual.numbers("sd_n")[300], "{filter}");
    }
}

#[test]
fn unit_a_height_measurement_bounds_the_height_of_the_other_filters() {
    let off = with(&flight(), "ins_alt", |row, alt| alt + 0.1 * row as f64);
    let off = with(&off, "alt", |row, alt| alt + 4.0 + 2.0 * (1.9 * row as f64).sin());
    for (filter, own, mag) in OTHERS.iter().filter(|(filter, ..)| *filter != "crlb") {
        let keys =
            format!("mag = '{mag}'\nbaro_sigma_m = 50.0\nha_sigma_m = 50.0\ninit_altitude_sigma_m = 10.0\n{own}\n");
        let height = "height = 'alt'\nheight_sigma_m = 2.0\nheight_bias_sigma_m = 5.0";
        let found = flown(filter, &format!("{keys}{height}"), &off).unwrap();
        let without = flown(filter, &keys, &off).unwrap().numbers("alt")[ROWS - 1];
        let alt = found.numbers("alt")[ROWS - 1];
        assert!((alt - 300.0).abs() < 10.0 && (without - 300.0).abs() > 30.0, "{filter}: {alt} {without}");
        assert!(found.numbers("height_nis").iter().all(|nis| nis.is_finite()), "{filter}");
    }
}

#[test]
fn law_a_height_bias_is_found_without_levels_of_the_map() {
    const KEYS: &str =
        "core_field = false\nmag = 'mag_1_c'\ninit_position_sigma_m = 20.0\ninit_velocity_sigma_mps = 0.3";
    for filter in FILTERS {
        for up_m in [60.0, -60.0] {
            let found = flown_on(filter, KEYS, &higher(up_m)).unwrap();
            let end = |name: &str| found.numbers(name)[ROWS - 1];
            let (bias_m, sigma_m) = (end("map_height_bias"), end("map_height_bias_sigma"));
            assert!((bias_m - up_m).abs() < 3.0 * sigma_m && sigma_m < 15.0, "{filter} {up_m}: {bias_m} {sigma_m}");
            assert!(found.error_m(ROWS - 1) < 25.0, "{filter} {up_m}: {}", found.error_m(ROWS - 1));
        }
        let exact = flown_on(filter, KEYS, &flight()).unwrap();
        assert!(exact.numbers("map_height_bias_sigma").iter().all(|sigma_m| sigma_m.is_nan()), "{filter}");
    }
}
