use super::*;
use crate::navigation::flights::OsborneFlight;
use crate::navigation::ins_error::InsErrors;
use crate::random::NormalGenerator;

const ROWS: u32 = 900;

/// Flight of 15 min with fixes of 2 m (height 5 m) every second, shifted north, east and up by `fault`, a function of
/// the time in seconds.
fn tested(
    seed: u64,
    noise: f64,
    model: InsErrorModel,
    fault: impl Fn(f64) -> [f64; 3],
) -> (FixTestResult, OsborneFlight) {
    let flight = OsborneFlight::flown(seed, ROWS, 1.0, model);
    let mut normals = NormalGenerator::new(1000 + seed);
    let truth = &flight.truth.columns;
    let mut fixes = PositionFixes {
        lat_deg: vec![],
        lon_deg: vec![],
        alt_m: vec![],
        horizontal_sigma_m: 2.0,
        vertical_sigma_m: 5.0,
    };
    for row in 0..ROWS as usize {
        let (north_m, east_m) = model.earth.north_east_m_per_rad(truth[1][row].to_radians(), truth[3][row]);
        let [north, east, up] = fault(truth[0][row] - truth[0][0]);
        fixes.lat_deg.push(truth[1][row] + ((north + 2.0 * noise * normals.draw()) / north_m).to_degrees());
        fixes.lon_deg.push(truth[2][row] + ((east + 2.0 * noise * normals.draw()) / east_m).to_degrees());
        fixes.alt_m.push(truth[3][row] + up + 5.0 * noise * normals.draw());
    }
    (run(&flight.ins.series(), &model, &fixes).unwrap(), flight)
}

fn model() -> InsErrorModel {
    InsErrorModel::from_sources(InsErrors { init_altitude_sigma_m: 5.0, ha_sigma_m: 1.0, ..InsErrors::default() })
}

/// Rows where `values` is true.
fn rows(values: &[bool]) -> Vec<usize> {
    values.iter().enumerate().filter(|(_, so)| **so).map(|(row, _)| row).collect()
}

#[test]
fn law_healthy_fixes_pass() {
    let mut rejected = 0;
    for seed in 0..20 {
        let (found, _) = tested(seed, 1.0, model(), |_| [0.0; 3]);
        assert_eq!(found.alarms, [0; 0], "seed {seed}");
        rejected += rows(&found.rejected).len();
    }
    // Among 18,000 pairs and heights, the probability that one exceeds the limit of 1e-6 is 1 %.
    assert!(rejected <= 2, "{rejected}");
}

#[test]
fn law_a_drift_is_detected_within_seconds_and_rejected_from_its_start() {
    for (speed_mps, within_s) in [(1.0, 15), (0.5, 25), (3.0, 8)] {
        for (north, east) in [(1.0, 0.0), (-0.6, 0.8), (-0.707, -0.707)] {
            let drift = |t: f64| (t - 600.0).max(0.0) * speed_mps;
            let (found, _) = tested(3, 1.0, model(), |t| [north * drift(t), east * drift(t), 0.0]);
            let alarm = found.alarms[0];
            assert!((601..=600 + within_s).contains(&alarm), "{speed_mps} m/s: {alarm}");
            let first = rows(&found.rejected)[0];
            assert!((600..alarm).contains(&first) && (first - 600) as f64 * speed_mps < 8.0, "{speed_mps} {first}");
            assert!(found.rejected[alarm..].iter().all(|rejected| *rejected), "a drift continues");
            let held = |row: usize| found.accepted.alt_m[row].is_finite() && found.accepted.lat_deg[row].is_nan();
            assert!((alarm..ROWS as usize).all(held), "the height is right");
        }
    }
}

#[test]
fn law_a_jump_is_rejected_and_later_fixes_are_used_again() {
    let jump = |t: f64| if (500.0..560.0).contains(&t) { 80.0 } else { 0.0 };
    let (found, _) = tested(5, 1.0, model(), |t| [jump(t), 0.0, 0.0]);
    let rejected = rows(&found.rejected);
    assert_eq!((rejected[0], *rejected.last().unwrap()), (500, 559 + RECOVERY), "{rejected:?}");
    let (wild, _) = tested(5, 1.0, model(), |t| if t == 500.0 { [0.0, 300.0, 0.0] } else { [0.0; 3] });
    assert_eq!((rows(&wild.rejected), wild.alarms), (vec![500], vec![]), "one wild fix is no alarm");
    let (height, _) = tested(5, 1.0, model(), |t| [0.0, 0.0, (t - 500.0).clamp(0.0, 200.0)]);
    assert!(!height.alarms.is_empty() && height.accepted.lat_deg.iter().all(|lat| lat.is_finite()));
}

#[test]
fn law_excess_noise_a_wrong_start_and_a_gap_raise_no_alarm() {
    for seed in 0..5 {
        let (noisy, _) = tested(seed, 2.5, model(), |_| [0.0; 3]);
        assert!(rows(&noisy.rejected).len() < 30, "seed {seed}: {:?} {:?}", noisy.alarms, rows(&noisy.rejected).len());
        // The assumed initial errors of 3 m and 0.01 m/s are too small.
        let flown = InsErrorModel::from_sources(InsErrors {
            init_position_sigma_m: 100.0,
            init_velocity_sigma_mps: 0.5,
            init_attitude_sigma_deg: 0.03,
            ..model().sources
        });
        let flight = OsborneFlight::flown(seed, ROWS, 1.0, flown);
        let truth = &flight.truth.columns;
        let mut fixes = PositionFixes {
            lat_deg: truth[1].clone(),
            lon_deg: truth[2].clone(),
            alt_m: truth[3].clone(),
            horizontal_sigma_m: 2.0,
            vertical_sigma_m: 5.0,
        };
        let found = run(&flight.ins.series(), &model(), &fixes).unwrap();
        assert_eq!(rows(&found.rejected), [0; 0], "seed {seed}");
        fixes.lat_deg[200..700].fill(f64::NAN);
        let found = run(&flight.ins.series(), &model(), &fixes).unwrap();
        assert_eq!(rows(&found.rejected), [0; 0], "seed {seed}");
    }
}
