//! Errors of scalar and vector magnetometers.

use super::*;

#[test]
fn law_magnetometers_measure_the_field_at_their_position() {
    // At 60 m/s northward without gusts, a sensor 60 m ahead is at the INS position of one second later.
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
    // Level flight has an angle of attack, so a sensor 60 m ahead is some metres higher.
    assert!(sd(&missed) < 0.1 * sd(&moved), "{} {}", sd(&missed), sd(&moved));
    let (up, right) = (column(&flight, "mag_4_uc"), column(&flight, "mag_5_uc"));
    let higher = fly(&north.replace("alt_m = 700.0", "alt_m = 800.0"));
    let over = column(&higher, "mag_2_uc");
    let missed: Vec<f64> = (10..100).map(|k| up[k] - over[k]).collect();
    let lifted: Vec<f64> = (10..100).map(|k| up[k] - here[k]).collect();
    assert!(sd(&missed) < 0.1 * sd(&lifted), "{} {}", sd(&missed), sd(&lifted));
    let east = fly(&north.replace("140.65", "140.650484"));
    let shifted_east = column(&east, "mag_2_uc");
    let missed: Vec<f64> = (10..100).map(|k| right[k] - shifted_east[k]).collect();
    let across: Vec<f64> = (10..100).map(|k| right[k] - here[k]).collect();
    assert!(sd(&missed) < 0.1 * sd(&across), "{} {}", sd(&missed), sd(&across));
}

#[test]
fn law_a_scalar_loses_its_signal_in_dead_zones_and_dropouts() {
    let sensor = |more: &str| format!("[[magnetometers]]\nname = 'mag_2_uc'\naxis = [0.0, 0.0, 1.0]\n{more}\n");
    let dead = |more: &str| lines_of("", &sensor(more), SURVEY)[0].clone();
    // At Osborne the field is 53 degrees from the horizontal and 37 degrees from the vertical; the aircraft rolls and
    // pitches.
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
    // There are 120 dropouts. The tolerance of the share of a fifth is four standard errors of 0.025.
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
    // The expected value is 30; the tolerance is four standard errors.
    assert!((8..=52).contains(&spikes), "{spikes}");
}

#[test]
fn law_a_vector_magnetometer_has_misalignment_skew_and_temperature_drift() {
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
    // A rotation preserves the length; non-orthogonal axes change it.
    assert!(worst < 1e-9 && skewed > 10.0, "{worst} {skewed}");
}
