#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use numerics::angle::wrap_deg;
use std::fs;

use numerics::{
    earth::geodesy::EarthModel,
    navigation::ins_error::{InsErrorModel, InsErrors, InsGrade},
    regression::statistics,
};
use tempfile::TempDir;

use super::{
    super::{scene::SynthLineContext, spec::SynthSpec, trajectory::TrueTrajectory},
    spec::{InsAlignment, InsErrorPropagation, SynthIns},
    *,
};

/// Two lines of 90 s, separated by a minute.
const FLIGHT: &str = "
[map]
path = 'none.tif'
[[flights]]
name = 'A'
[[flights.lines]]
name = 'A.1'
alt_m = 500.0
duration_s = 90.0
waypoints = [[-22.05, 140.6], [-21.9, 140.65]]
[[flights.lines]]
name = 'A.2'
alt_m = 800.0
duration_s = 90.0
waypoints = [[-21.9, 140.6], [-22.0, 140.65]]
";

/// A spec with `before` before its tables and `ins` in the table `ins`.
fn read(before: &str, ins: &str) -> Result<SynthSpec, ReadError> {
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("s.synth.toml");
    fs::write(&path, format!("seed = 3\nyear = 2020\ndoy = 185\n{before}\n[ins]\n{ins}\n{FLIGHT}")).unwrap();
    SynthSpec::read(&path)
}

/// The truth and the INS along the lines of the flight.
struct SimulatedLine {
    truth: TrueTrajectory,
    ins: [Vec<f64>; 13],
}

fn simulate_ins(spec: &SynthSpec) -> Result<Vec<SimulatedLine>, ReadError> {
    let (path, flight) = (Path::new("s.synth.toml"), &spec.flights[0]);
    let mut run = FlightIns::new(path, spec, flight)?;
    let one = |line| {
        let scene = SynthLineContext { path, spec, flight, line };
        let truth = scene.fly();
        run.line(&scene, &truth).map(|ins| SimulatedLine { truth, ins })
    };
    flight.lines.iter().map(one).collect()
}

fn of(ins: &str) -> Vec<SimulatedLine> {
    simulate_ins(&read("", ins).unwrap()).unwrap()
}

impl SimulatedLine {
    /// INS minus truth, north and east, in metres.
    fn off_m(&self, row: usize) -> (f64, f64) {
        let truth = (self.truth.lat_deg[row], self.truth.lon_deg[row]);
        EarthModel::Wgs84.offset_ne_m(truth, (self.ins[0][row], self.ins[1][row]), self.truth.alt_m[row])
    }

    fn last(&self) -> usize {
        self.truth.tt_s.len() - 1
    }
}

fn drms_m(lines: &[SimulatedLine]) -> f64 {
    let rows = |line: &SimulatedLine| (0..=line.last()).map(|row| line.off_m(row)).collect::<Vec<_>>();
    let (north, east): (Vec<f64>, Vec<f64>) = lines.iter().flat_map(rows).unzip();
    statistics::drms(&north, &east).value
}

#[test]
fn unit_an_ins_that_is_off_is_bit_identical_to_the_truth() {
    let spec = read("gusts_deg = [1.0, 1.0, 1.0]\n[components]\nins = false", "grade = 'commercial'").unwrap();
    for SimulatedLine { truth, ins } in simulate_ins(&spec).unwrap() {
        let exact = [&truth.lat_deg, &truth.lon_deg, &truth.alt_m].into_iter().chain(&truth.velocity_mps);
        for (column, exact) in ins.iter().zip(exact.chain(&truth.attitude_deg).chain(&truth.force_mps2)) {
            assert_eq!(column, exact);
        }
    }
}

#[test]
fn unit_the_grade_sets_the_keys_that_are_unset() {
    let spec = read("", "grade = 'tactical'\ngyro_sigma_radps = 1e-7\nbaro_tau_s = 100.0").unwrap();
    let expected = InsErrorModel {
        sources: InsErrors { gyro_sigma_radps: 1e-7, baro_tau_s: 100.0, ..InsGrade::Tactical.model().sources },
        fogm_sigma_nt: 0.0,
        ..InsGrade::Tactical.model()
    };
    assert_eq!(spec.ins.model, expected);
    assert_eq!(read("", "").unwrap().ins, SynthIns::default());
    assert_eq!(read("", "grade = 'magnav'").unwrap().ins, SynthIns::default());
    let thesis = read("", "ensemble = 100\nalign = 'line'\nmethod = 'mechanisation'").unwrap().ins;
    assert_eq!(
        (thesis.take, thesis.align, thesis.method),
        (10, InsAlignment::Line, InsErrorPropagation::Mechanisation)
    );
}

#[test]
fn law_given_initial_errors_are_ins_minus_truth() {
    let given = "align = 'line'\ninit_position_error_m = [100.0, -50.0]\ninit_altitude_error_m = 7.0\n\
                 init_velocity_error_mps = [0.1, 0.2, -0.3]\ninit_tilt_error_deg = [0.0, 0.0, 0.5]\n\
                 init_acc_bias_mps2 = [0.0, 0.0, 0.25]\ninit_gyro_bias_radps = [0.0, 0.0, 1e-3]\n\
                 init_baro_error_m = 3.0\ngrade = 'navigation'\narw_sigma = 0.0\ngyro_sigma_radps = 0.0";
    for method in ["error_model", "mechanisation"] {
        for line in of(&format!("{given}\nmethod = '{method}'")) {
            let (north, east) = line.off_m(0);
            // The radii at the midpoint and at the position differ: 100 m of 6400 km.
            assert!((north - 100.0).abs() < 1e-2 && (east + 50.0).abs() < 1e-2, "{north} {east}");
            let off = |column: usize, truth: &[f64], row: usize| line.ins[column][row] - truth[row];
            assert!((off(2, &line.truth.alt_m, 0) - 7.0).abs() < 1e-9);
            for (axis, expected) in [0.1, 0.2, -0.3].into_iter().enumerate() {
                assert!((off(3 + axis, &line.truth.velocity_mps[axis], 0) - expected).abs() < 1e-9);
            }
            let yaw_off = |row: usize| wrap_deg(off(8, &line.truth.attitude_deg[2], row));
            assert!((yaw_off(0) - 0.5).abs() < 1e-9, "{}", yaw_off(0));
            // With 2 degrees of pitch and the tilt, the z axis is nearly vertical.
            assert!((off(11, &line.truth.force_mps2[2], 0) - 0.25).abs() < 1e-3);
            // A positive bias of the z gyroscope turns the INS to the right: 1e-3 rad/s for 10 s, decaying by 10/3600.
            let turned = yaw_off(100) - 0.5;
            assert!((turned / 0.01_f64.to_degrees() - 1.0).abs() < 0.02, "{method}: {turned}");
        }
    }
}

#[test]
fn law_errors_continue_over_the_lines_of_a_flight() {
    let given =
        "grade = 'navigation'\ninit_position_error_m = [1000.0, 0.0]\ninit_velocity_error_mps = [0.0, 2.0, 0.0]";
    for method in ["error_model", "mechanisation"] {
        let lines = of(&format!("{given}\nmethod = '{method}'"));
        let ends = [lines[0].off_m(0), lines[0].off_m(lines[0].last()), lines[1].off_m(0)];
        // 2 m/s for 90 s and a pause of a minute; the Schuler oscillation reduces this by (ωs t)²/6, 0.6 % at 150 s.
        for ((north, east), seconds) in ends.into_iter().zip([0.0, 90.0, 150.0]) {
            let expected = 2.0 * seconds;
            // Effects of the grade and of the earth's rate: 2 Ω v t²/2 is 3.3 m; tilts of 1e-8 rad are negligible.
            assert!(
                (north - 1000.0).abs() < 6.0 && (east - expected).abs() < 6.0,
                "{method}: {seconds} {north} {east}"
            );
        }
        let anew = of(&format!("{given}\nalign = 'line'\nmethod = '{method}'"));
        for line in &anew {
            assert!((line.off_m(0).0 - 1000.0).abs() < 0.2 && line.off_m(0).1.abs() < 0.2);
        }
        assert_ne!(anew[0].ins[11], anew[1].ins[11]);
    }
}

#[test]
fn law_both_methods_give_the_same_realisation() {
    for grade in ["magnav", "navigation", "tactical"] {
        let [linear, mechanised] =
            ["error_model", "mechanisation"].map(|method| of(&format!("grade = '{grade}'\nmethod = '{method}'")));
        for (a, b) in linear.iter().zip(&mechanised) {
            let ((north, east), (n, e)) = (a.off_m(a.last()), b.off_m(b.last()));
            let apart = (north - n).hypot(east - e) / north.hypot(east);
            // The spherical error model differs by 0.6 % in radius and 0.2 % in gravity.
            assert!(apart < 0.02, "{grade}: {north} {east}, {n} {e}");
        }
    }
}

#[test]
fn law_the_realisation_does_not_depend_on_the_sample_rate() {
    let [slow, fast] = ["rate_hz = 2.0", "rate_hz = 20.0"].map(|rate| {
        let spec = read(rate, "grade = 'tactical'").unwrap();
        simulate_ins(&spec).unwrap()
    });
    for (slow, fast) in slow.iter().zip(&fast) {
        let ((north, east), (n, e)) = (slow.off_m(slow.last()), fast.off_m(fast.last()));
        // The attitude is held for half a second.
        assert!((north - n).hypot(east - e) < 0.02 * north.hypot(east), "{north} {east}, {n} {e}");
    }
}

#[test]
fn unit_the_chosen_realisation_has_the_requested_rank() {
    for align in ["flight", "line"] {
        let ranks = [1, 2, 5, 10, 19, 20];
        let drms = ranks
            .map(|take| drms_m(&of(&format!("grade = 'tactical'\nalign = '{align}'\nensemble = 20\ntake = {take}"))));
        println!("{align}: {drms:.0?} m");
        assert!(drms.windows(2).all(|pair| pair[0] > pair[1]), "{drms:?}");
    }
    let (one, again) = (of("ensemble = 20"), of("ensemble = 20\ntake = 2"));
    assert_eq!(one[1].ins, again[1].ins, "a tenth of them is the default");
}

#[test]
fn unit_a_diverging_ins_is_rejected_or_has_valid_positions() {
    let far = |method: &str, limit: &str| {
        let text = format!("grade = 'commercial'\ngyro_sigma_radps = 0.2\nmethod = '{method}'\n{limit}");
        simulate_ins(&read("", &text).unwrap())
    };
    let message = far("error_model", "error_limit_m = 1e4").err().unwrap().to_string();
    assert!(
        message.contains("flight A, line A.1: the INS diverges: ") && message.contains("`error_limit_m`"),
        "{message}"
    );
    for method in ["error_model", "mechanisation"] {
        for line in far(method, "error_limit_m = 1e12").unwrap() {
            assert!(line.ins.iter().flatten().all(|x| x.is_finite()));
            assert!(line.ins[0].iter().all(|lat| lat.abs() <= 90.0), "{method}");
            assert!(line.ins[1].iter().all(|lon| (-180.0..180.0).contains(lon)), "{method}");
        }
    }
    assert_eq!(on_the_globe(91.0, 10.0), (89.0, -170.0));
    assert_eq!(on_the_globe(-100.0, 170.0), (-80.0, -10.0));
    assert_eq!(on_the_globe(359.0, 10.0), (-1.0, 10.0));
    assert_eq!(on_the_globe(12.5, 190.0), (12.5, -170.0));
}

#[test]
fn law_scale_errors_change_the_measured_force() {
    let quiet = "grade = 'navigation'\ninit_altitude_sigma_m = 0.0\nacc_sigma_mps2 = 0.0\nmethod = 'mechanisation'";
    let line = &of(&format!("{quiet}\nacc_scale_ppm = 1000.0"))[0];
    let ratio = line.ins[11][0] / line.truth.force_mps2[2][0] - 1.0;
    // A draw with a standard deviation of 1000 ppm. The scale error is equal for every sample except for the
    // contribution of the x axis.
    assert!(ratio.abs() > 1e-6 && ratio.abs() < 4e-3, "{ratio}");
    let last = line.ins[11][line.last()] / line.truth.force_mps2[2][line.last()] - 1.0;
    assert!((last / ratio - 1.0).abs() < 0.05, "{last} {ratio}");
    let without = of(quiet)[0].ins[11][0] - line.truth.force_mps2[2][0];
    // Tilts of 1e-8 rad.
    assert!(without.abs() < 1e-8, "{without}");
}

#[test]
fn gold_faults_of_the_ins_are_reported_with_their_place() {
    let among = read("", "ensemble = 10\ntake = 11\ngyro_scale_ppm = 5.0").unwrap_err().to_string();
    let message =
        read("", "grade = 'navigatoin'\ninit_tilt_error_deg = [1.0]\nalgin = 'line'").unwrap_err().to_string();
    let message = among + &message;
    for what in [
        "`grade` cannot be `navigatoin`",
        "did you mean `navigation`?",
        "`take` of `ins` must be at most `ensemble` (10)",
        "`gyro_scale_ppm` of `ins` needs `method = \"mechanisation\"`",
        "`init_tilt_error_deg` of `ins` must be a list of 3 numbers",
        "`ins` has no parameter `algin`",
        "did you mean `align`?",
        "s.synth.toml:6:9",
    ] {
        assert!(message.contains(what), "{what} is not in\n{message}");
    }
}

#[test]
fn law_the_pause_is_straight_flight_between_the_lines() {
    let from = PauseEndpoint { tt_s: 100.0, lat_deg: -22.0, lon_deg: 179.99, alt_m: 500.0 };
    let to = PauseEndpoint { tt_s: 160.5, lat_deg: -21.98, lon_deg: -179.99, alt_m: 800.0 };
    let pause = between(&from, &to).unwrap();
    let last = pause.tt_s.len() - 1;
    assert_eq!((pause.tt_s[0], pause.tt_s[last], last), (100.0, 160.5, 61));
    assert_eq!((pause.lat_deg[last], pause.alt_m[last]), (to.lat_deg, to.alt_m));
    assert!((wrap_deg(pause.lon_deg[last] - to.lon_deg)).abs() < 1e-12);
    // 2214 m north, 2066 m east and 300 m up in 60.5 s.
    let v = pause.velocity_mps.each_ref().map(|v| v[30]);
    assert!((v[0] - 36.6).abs() < 0.1 && (v[1] - 34.1).abs() < 0.1 && (v[2] + 4.96).abs() < 0.01, "{v:?}");
    assert!(between(&to, &from).is_none() && between(&to, &to).is_none());
    let leap = between(&from, &PauseEndpoint { lat_deg: 0.0, ..to }).unwrap();
    assert!(leap.velocity_mps[0][0] <= 300.0);
}
