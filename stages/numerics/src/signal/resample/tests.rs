#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::*;
use crate::reference_csv::columns;

const METHODS: [SampleInterpolation; 3] =
    [SampleInterpolation::Linear, SampleInterpolation::Nearest, SampleInterpolation::Cubic];

fn times(rows: usize, first: f64, step: f64) -> Vec<f64> {
    (0..rows).map(|k| first + step * k as f64).collect()
}

#[test]
fn unit_a_series_on_the_grid_is_returned_bit_by_bit() {
    // Times computed by addition, multiplication and division differ in the last bits.
    let mut added = vec![50_000.7];
    (1..500).for_each(|k| added.push(added[k - 1] + 0.1));
    let divided: Vec<f64> = (0..500).map(|k| f64::from(500_007 + k) / 10.0).collect();
    for tt in [added, times(500, 50_000.7, 0.1), divided.clone()] {
        let x: Vec<f64> = (0..500).map(|k| (f64::from(k) * 0.37).sin() * 1e5).collect();
        let plan = ResamplePlan::new(&tt, 10.0, 1.0).unwrap();
        assert_eq!(plan.grid(), divided);
        for method in METHODS {
            assert_eq!(plan.column(&x, method).unwrap(), x, "{method:?}");
        }
        assert!(plan.nearest_rows().into_iter().eq((0..500).map(Some)));
    }
}

#[test]
fn unit_the_grid_begins_and_ends_inside_the_samples() {
    let tt = [0.05, 0.26, 0.41, 0.79];
    let plan = ResamplePlan::new(&tt, 10.0, 1.0).unwrap();
    assert_eq!(plan.grid(), [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]);
    let earlier = ResamplePlan::new(&[-0.25, 0.0], 10.0, 1.0).unwrap();
    assert_eq!(earlier.grid(), [-0.2, -0.1, 0.0]);
    assert_eq!(ResamplePlan::new(&[0.3], 10.0, 1.0).unwrap().grid(), [0.3]);
    assert!(ResamplePlan::new(&[0.31], 10.0, 1.0).unwrap().grid().is_empty());
    assert!(ResamplePlan::new(&[], 10.0, 1.0).unwrap().grid().is_empty());
}

#[test]
fn law_a_straight_line_is_preserved() {
    let tt: Vec<f64> = (0..400).map(|k| 0.07 * f64::from(k) + 0.02 * (f64::from(k)).sin()).collect();
    let x: Vec<f64> = tt.iter().map(|tt| 5.0 - 3.0 * tt).collect();
    let plan = ResamplePlan::new(&tt, 20.0, 1.0).unwrap();
    for method in [SampleInterpolation::Linear, SampleInterpolation::Cubic] {
        for (tt, x) in plan.grid().iter().zip(plan.column(&x, method).unwrap()) {
            // Values of up to 80, rounded several times.
            assert!((x - (5.0 - 3.0 * tt)).abs() < 1e-13, "{method:?} at {tt}");
        }
    }
}

#[test]
fn val_linear_and_akima_equal_scipy() {
    let samples = columns(include_str!("../../../reference/signal/resample_samples.csv"));
    let grid = columns(include_str!("../../../reference/signal/resample_grid.csv"));
    let plan = ResamplePlan::new(&samples["tt"], 10.0, 1.0).unwrap();
    assert_eq!(plan.grid(), grid["tt"]);
    for (method, name) in [(SampleInterpolation::Linear, "linear"), (SampleInterpolation::Cubic, "akima")] {
        let ours = plan.column(&samples["x"], method).unwrap();
        for (row, (ours, scipy)) in ours.iter().zip(&grid[name]).enumerate() {
            // The reference is the same cubic in another form. The results differ by a few units in the last place, for
            // values up to 30.
            assert!((ours - scipy).abs() < 1e-12, "{name}, row {row}: {ours} against {scipy}");
        }
    }
}

#[test]
fn unit_gaps_longer_than_the_longest_are_nan_and_shorter_ones_bridged() {
    // After 1.0 s there is a gap of one second, the maximum allowed gap; after 3.0 s there is a gap of 1.1 s.
    let tt = [0.8, 0.9, 1.0, 2.0, 2.9, 3.0, 4.1, 4.2];
    let x = [8.0, 9.0, 10.0, 20.0, 29.0, 30.0, 41.0, 42.0];
    let plan = ResamplePlan::new(&tt, 10.0, 1.0).unwrap();
    for method in METHODS {
        let y = plan.column(&x, method).unwrap();
        assert_eq!(y.iter().filter(|y| y.is_nan()).count(), 10);
        for (row, (tt, y)) in plan.grid().iter().zip(&y).enumerate() {
            let in_gap = *tt > 3.05 && *tt < 4.05;
            assert_eq!(y.is_nan(), in_gap, "{method:?} row {row}");
            if method != SampleInterpolation::Nearest && !in_gap {
                assert!((y - 10.0 * tt).abs() < 1e-12, "{method:?} row {row}: {y}");
            }
        }
    }
    let rows = plan.nearest_rows();
    assert_eq!(rows.iter().filter(|row| row.is_none()).count(), 10);
    // 1.5 s is equally far from the samples at 1.0 s and 2.0 s; 1.6 s is nearer to the sample at 2.0 s.
    assert_eq!((rows[7], rows[8]), (Some(2), Some(3)));
}

#[test]
fn unit_missing_samples_of_one_column_affect_that_column_only() {
    let tt = times(41, 0.0, 0.1);
    let x: Vec<f64> = tt.iter().map(|tt| 2.0 * tt).collect();
    let mut holed = x.clone();
    holed[0] = f64::NAN;
    holed[5] = f64::NAN;
    holed[20..32].fill(f64::NAN);
    holed[40] = f64::INFINITY;
    let plan = ResamplePlan::new(&tt, 10.0, 1.0).unwrap();
    let y = plan.column(&holed, SampleInterpolation::Linear).unwrap();
    for (row, (y, x)) in y.iter().zip(&x).enumerate() {
        let missing = row == 0 || row == 40 || (20..32).contains(&row);
        assert_eq!(y.is_nan(), missing, "row {row}");
        assert!(missing || (y - x).abs() < 1e-15, "row {row}");
    }
    assert_eq!(plan.column(&x, SampleInterpolation::Linear).unwrap(), x);
    let none = plan.column(&[f64::NAN; 41], SampleInterpolation::Cubic).unwrap();
    assert!(none.iter().all(|y| y.is_nan()));
}

#[test]
fn law_angles_follow_the_shorter_arc_and_stay_in_their_range() {
    let tt = [0.0, 0.2, 0.4, 0.6];
    let plan = ResamplePlan::new(&tt, 10.0, 1.0).unwrap();
    let heading = plan.angle_deg(&[350.0, 10.0, 350.0, 90.0], SampleInterpolation::Linear).unwrap();
    let expected = [350.0, 0.0, 10.0, 0.0, 350.0, 40.0, 90.0];
    let close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
    assert!(close(&heading, &expected), "{heading:?}");
    let signed = plan.angle_deg(&[170.0, -170.0, 170.0, 175.0], SampleInterpolation::Linear).unwrap();
    let expected = [170.0, 180.0, -170.0, 180.0, 170.0, 172.5, 175.0];
    let same = |a: f64, b: f64| AngleRange::Full.wrap(a - b + 180.0) - 180.0;
    assert!(signed.iter().zip(expected).all(|(a, b)| same(*a, b).abs() < 1e-9), "{signed:?}");
    assert!(signed.iter().all(|a| (-180.0..=180.0).contains(a)));
    let cubic = plan.angle_deg(&[340.0, 350.0, 0.0, 10.0], SampleInterpolation::Cubic).unwrap();
    assert!(close(&cubic, &[340.0, 345.0, 350.0, 355.0, 0.0, 5.0, 10.0]), "{cubic:?}");
}

#[test]
fn law_wrapping_keeps_the_angle_and_the_range() {
    for k in -2000..2000 {
        let angle = 0.9 * f64::from(k);
        let (signed, full) = (AngleRange::Signed.wrap(angle), AngleRange::Full.wrap(angle));
        assert!(signed > -180.0 && signed <= 180.0, "{angle}");
        assert!((0.0..360.0).contains(&full), "{angle}");
        for wrapped in [signed, full] {
            let turns = (angle - wrapped) / 360.0;
            assert!((turns - turns.round()).abs() < 1e-12, "{angle}");
        }
    }
    assert_eq!(AngleRange::Full.wrap(-1e-20), 0.0);
}

#[test]
fn law_anti_aliasing_removes_aliased_frequencies_and_keeps_others() {
    let tt = times(4000, 100.0, 0.01);
    let tone = |hz: f64| -> Vec<f64> { tt.iter().map(|tt| (std::f64::consts::TAU * hz * tt).sin()).collect() };
    // For 10 Hz the corner is at 4 Hz. 1 Hz is attenuated by (1/4)^16, and 7 Hz reduced to (7/4)^-16 = 1.3e-4.
    let inner = |x: &[f64]| x[400..3600].iter().fold(0.0f64, |a, x| a.max(x.abs()));
    let (slow, report) = anti_alias(&tt, &tone(1.0), 10.0).unwrap();
    assert_eq!((report.rows, report.left_out()), (4000, 0));
    let change: Vec<f64> = slow.iter().zip(tone(1.0)).map(|(a, b)| a - b).collect();
    assert!(inner(&change) < 1e-6, "{}", inner(&change));
    let (fast, _) = anti_alias(&tt, &tone(7.0), 10.0).unwrap();
    assert!(inner(&fast) < 1.5e-4, "{}", inner(&fast));
    let (same, report) = anti_alias(&tt, &tone(7.0), 200.0).unwrap();
    assert_eq!((same, report.rows), (tone(7.0), 0));
    let mut uneven = tt.clone();
    uneven[9] += 0.004;
    assert!(anti_alias(&uneven, &tone(1.0), 10.0).is_err());
}

#[test]
fn unit_invalid_times_and_requests_are_rejected() {
    let error = |tt: &[f64], rate_hz, gap| ResamplePlan::new(tt, rate_hz, gap).unwrap_err().to_string();
    assert!(error(&[0.0, 1.0, 1.0], 10.0, 1.0).contains("row 2"));
    assert!(error(&[0.0, 1.0, 0.5], 10.0, 1.0).contains("row 2"));
    assert!(error(&[0.0, f64::NAN], 10.0, 1.0).contains("row 1"));
    assert!(error(&[0.0, 1e9], 10.0, 1.0).contains("10000000001 rows"));
    assert!(error(&[0.0, 1.0], 0.0, 1.0).contains("above 0 Hz"));
    assert!(error(&[0.0, 1.0], 10.0, -1.0).contains("at least 0 s"));
    assert!(error(&[1e15, 1e15 + 1.0], 10.0, 1.0).contains("cannot be distinguished"));
    let plan = ResamplePlan::new(&[0.0, 1.0], 10.0, 1.0).unwrap();
    assert!(plan.column(&[0.0], SampleInterpolation::Linear).is_err());
}

#[test]
fn unit_a_plan_onto_its_own_grid_is_the_plan() {
    let tt: Vec<f64> = (0..200).map(|k| 12.03 + 0.13 * f64::from(k) + 0.02 * f64::from(k % 3)).collect();
    let x: Vec<f64> = tt.iter().map(|t| (3.0 * t).sin()).collect();
    let own = ResamplePlan::new(&tt, 10.0, 1.0).unwrap();
    assert_eq!(own.grid(), even_grid(tt[0], tt[199], 10.0).unwrap());
    let onto = ResamplePlan::onto(&tt, own.grid().to_vec(), 10.0, 1.0).unwrap();
    assert_eq!(onto, own);
    // Grid times beyond the samples have NaN.
    let wide = ResamplePlan::onto(&tt, even_grid(11.0, 40.0, 10.0).unwrap(), 10.0, 1.0).unwrap();
    let made = wide.column(&x, SampleInterpolation::Linear).unwrap();
    let inside = |t: f64| t >= tt[0] && t <= tt[199];
    assert!(wide.grid().iter().zip(&made).all(|(t, y)| inside(*t) == y.is_finite()));
    let shared: Vec<f64> = made.into_iter().filter(|y| y.is_finite()).collect();
    assert_eq!(shared, own.column(&x, SampleInterpolation::Linear).unwrap());
    let empty = ResamplePlan::onto(&[], vec![1.0, 2.0], 10.0, 1.0).unwrap();
    let made = empty.column(&[], SampleInterpolation::Linear).unwrap();
    assert!(made.len() == 2 && made.iter().all(|y| y.is_nan()));
}

#[test]
fn unit_times_that_make_no_grid_are_rejected() {
    assert_eq!(even_grid(5.0, 4.0, 10.0).unwrap(), Vec::<f64>::new());
    assert!(even_grid(f64::NAN, 4.0, 10.0).is_err() && even_grid(0.0, 4.0, 0.0).is_err());
    assert!(matches!(even_grid(0.0, 1e8, 10.0), Err(ResampleError::TooLong { .. })));
    assert!(ResamplePlan::onto(&[1.0, 2.0], vec![2.0, 1.0], 10.0, 1.0).is_err());
}
