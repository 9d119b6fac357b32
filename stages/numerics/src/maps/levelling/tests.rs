#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use super::*;
use crate::maps::gridding::OwnedSurveyPoints;

/// East-west lines 200 m apart and three ties over a smooth field, each with a different error along the line.
fn survey(error: impl Fn(usize, f64) -> f64) -> OwnedSurveyPoints {
    let mut points = OwnedSurveyPoints::default();
    let mut push = |line: usize, e: f64, n: f64, along: f64| {
        points.easting_m.push(e);
        points.northing_m.push(n);
        points.height_m.push(300.0);
        points.value_nt.push(0.002 * e - 0.001 * n + error(line, along));
        points.line.push(line);
    };
    for line in 0..10usize {
        for k in 0..101 {
            let forth = if line % 2 == 0 { k } else { 100 - k };
            push(line, 40.0 * f64::from(forth) + 3.0, 200.0 * line as f64, 0.02 * f64::from(k) - 1.0);
        }
    }
    for tie in 0..4usize {
        for k in 0..60 {
            push(100 + tie, 500.0 + 1000.0 * tie as f64, 35.0 * f64::from(k) - 111.0, f64::from(k) / 29.5 - 1.0);
        }
    }
    points
}

/// Errors of the lines; the ties have no errors.
fn offset(line: usize) -> f64 {
    if line < 100 { 7.0 * ((3 * line + 1) as f64).sin() } else { 0.0 }
}

#[test]
fn law_crossings_have_interpolated_positions_and_values() {
    let points = survey(|line, _| offset(line));
    let found = find_crossovers(points.borrow(), &CrossoverOptions::default());
    assert_eq!(found.len(), 40);
    for c in &found {
        let line = c.lines[0].min(c.lines[1]);
        let tie = c.lines[0].max(c.lines[1]) - 100;
        assert!(
            (c.at_m[0] - (500.0 + 1000.0 * tie as f64)).abs() < 1e-9 && (c.at_m[1] - 200.0 * line as f64).abs() < 1e-9
        );
        // The field is linear, so interpolation is exact and the difference equals the difference of the line errors.
        assert!((c.difference_nt() - (offset(c.lines[0]) - offset(c.lines[1]))).abs() < 1e-9);
    }
    assert_eq!(tie_lines(points.borrow()), [100, 101, 102, 103]);
}

#[test]
fn law_known_offsets_are_recovered() {
    let points = survey(|line, _| offset(line));
    let found = find_crossovers(points.borrow(), &CrossoverOptions::default());
    let options = LevellingOptions { gauge: LevellingGauge::TiesHeld, ridge: 1e-9, ..LevellingOptions::default() };
    let levelled = level_lines(points.borrow(), &found, &options);
    for line in &levelled.lines {
        // The prior of the scatter of lines shifts this by (0.01 nT / 5 nT)² divided by 4 crossovers.
        assert!((line.coefficients_nt[0] - offset(line.line)).abs() < 1e-4, "{line:?}");
        assert_eq!((line.tie, line.crossovers), (line.line >= 100, if line.line < 100 { 4 } else { 10 }));
    }
    assert!(levelled.before.figure_of_merit_crossings > 3.0 && levelled.after.figure_of_merit_crossings < 1e-4);
    assert!(levelled.left_out.unwrap().figure_of_merit_crossings < 1e-4);
    assert!((levelled.correction_nt[150] - offset(1)).abs() < 1e-4);
    // The reference is the zero mean of the ties, or the group with the smaller scatter. The ties have the smaller
    // scatter, so both give the same result.
    for gauge in [LevellingGauge::TiesMean, LevellingGauge::Steadiest] {
        let mean = level_lines(
            points.borrow(),
            &found,
            &LevellingOptions { gauge, ridge: 1e-9, ..LevellingOptions::default() },
        );
        assert!(mean.lines.iter().all(|l| (l.coefficients_nt[0] - offset(l.line)).abs() < 1e-4), "{:?}", mean.lines);
        assert!(mean.spread_nt[0] > 3.0 && mean.spread_nt[1] == 0.0, "{:?}", mean.spread_nt);
    }
}

#[test]
fn law_drifts_along_lines_need_the_first_order() {
    let points = survey(|line, along| offset(line) * (1.0 + 0.5 * along));
    let found = find_crossovers(points.borrow(), &CrossoverOptions::default());
    let after = |order: usize| {
        let options =
            LevellingOptions { order, gauge: LevellingGauge::TiesHeld, ridge: 1e-9, ..LevellingOptions::default() };
        let levelled = level_lines(points.borrow(), &found, &options);
        (levelled.after.figure_of_merit_crossings, levelled.lines[4].coefficients_nt.clone())
    };
    assert!(after(0).0 > 0.5);
    let (left, coefficients) = after(1);
    // The prior of the scatter of lines shifts these slightly, as above.
    assert!(left < 1e-3);
    assert!((coefficients[0] - offset(4)).abs() < 1e-3 && (coefficients[1] - 0.5 * offset(4)).abs() < 1e-3);
}

#[test]
fn law_a_wrong_crossover_has_little_effect() {
    let points = survey(|line, _| offset(line));
    let mut found = find_crossovers(points.borrow(), &CrossoverOptions::default());
    found[5].value_nt[0] += 500.0;
    let worst = |huber_sigmas: f64| {
        let tested = huber_sigmas.is_finite();
        let options = LevellingOptions {
            tested,
            gauge: LevellingGauge::TiesHeld,
            huber_sigmas,
            ridge: 1e-9,
            ..LevellingOptions::default()
        };
        let levelled = level_lines(points.borrow(), &found, &options);
        levelled.lines.iter().fold(0.0f64, |m, l| m.max((l.coefficients_nt[0] - offset(l.line)).abs()))
    };
    assert!(worst(f64::INFINITY) > 100.0);
    // The outlier, one error of 500 nT among forty crossovers, also increases the estimated noise.
    assert!(worst(1.345) < 0.5, "{}", worst(1.345));
}

#[test]
fn unit_height_differences_are_corrected_or_excluded() {
    let mut points = survey(|_, _| 0.0);
    let lines = points.line.clone();
    for ((h, v), line) in points.height_m.iter_mut().zip(&mut points.value_nt).zip(lines) {
        if line >= 100 {
            *h += 40.0;
            *v -= 40.0 * 0.02;
        }
    }
    let differences = |options: CrossoverOptions| {
        find_crossovers(points.borrow(), &options).iter().map(|c| c.difference_nt().abs()).collect::<Vec<f64>>()
    };
    let plain = CrossoverOptions::default();
    assert!(differences(plain).iter().all(|d| (d - 0.8).abs() < 1e-9));
    let corrected = differences(CrossoverOptions { vertical_gradient_nt_per_m: -0.02, ..plain });
    assert!(corrected.len() == 40 && corrected.iter().all(|d| *d < 1e-9));
    assert!(differences(CrossoverOptions { most_height_m: 30.0, ..plain }).is_empty());
}

#[test]
fn unit_gaps_shallow_angles_and_nan_make_no_crossing() {
    let mut points = survey(|_, _| 0.0);
    let count =
        |points: &OwnedSurveyPoints, options: CrossoverOptions| find_crossovers(points.borrow(), &options).len();
    let plain = CrossoverOptions::default();
    assert_eq!(count(&points, CrossoverOptions { gap_m: Some(30.0), ..plain }), 0);
    assert_eq!(count(&points, CrossoverOptions { least_angle_deg: 91.0, ..plain }), 40);
    points.value_nt[..101].fill(f64::NAN);
    assert_eq!(count(&points, plain), 36);
    let none = OwnedSurveyPoints::default();
    assert!(find_crossovers(none.borrow(), &plain).is_empty());
    let levelled = level_lines(none.borrow(), &[], &LevellingOptions::default());
    assert!(levelled.correction_nt.is_empty() && levelled.before.n == 0);
}

/// Reproducible pseudo-random numbers with a standard deviation of about 1.
fn noise(k: usize) -> f64 {
    let uniform = |k: usize| ((12_345 + 7919 * k) as f64).sin() * 43_758.547 % 1.0;
    (0..6).map(|j| uniform(6 * k + j)).sum::<f64>() / 1.414
}

/// Differences at crossings that increase with the gradient, as caused by position errors. The ties of the survey are
/// `ties_nt` above the lines, and the level errors of the lines are `out` times the offsets of the lines.
fn uncertain(ties_nt: f64, out: f64) -> (OwnedSurveyPoints, Vec<Crossover>) {
    let points = survey(|line, _| if line < 100 { out * offset(line) } else { ties_nt });
    let mut found = find_crossovers(points.borrow(), &CrossoverOptions::default());
    for (k, c) in found.iter_mut().enumerate() {
        c.gradient_nt_per_m = [0.01, 0.1, 0.5, 2.0][k % 4];
        c.value_nt[0] += 1.0 * noise(2 * k) + 30.0 * c.gradient_nt_per_m * noise(2 * k + 1);
    }
    (points, found)
}

#[test]
fn unit_level_lines_stay_level_and_only_the_ties_are_shifted() {
    let (points, found) = uncertain(25.0, 0.0);
    let levelled = level_lines(points.borrow(), &found, &LevellingOptions::default());
    for line in &levelled.lines {
        let expected = if line.tie { 25.0 } else { 0.0 };
        // Forty crossovers, ten of which each determine the shift to 1 nT.
        assert!((line.coefficients_nt[0] - expected).abs() < 1.5, "{line:?}");
        assert!(line.tie || line.coefficients_nt[0] == 0.0, "no stripes: {line:?}");
    }
    assert_eq!(levelled.spread_nt, [0.0, 0.0]);
    let CrossoverNoise { sigma_nt, position_m } = levelled.noise;
    assert!((0.5..2.0).contains(&sigma_nt) && (15.0..60.0).contains(&position_m), "{:?}", levelled.noise);
    // Without the test each line follows the noise at its crossovers.
    let all = level_lines(points.borrow(), &found, &LevellingOptions { tested: false, ..LevellingOptions::default() });
    let most =
        |l: &LevellingResult| l.lines.iter().filter(|l| !l.tie).fold(0.0_f64, |m, l| m.max(l.coefficients_nt[0].abs()));
    assert!(most(&all) > 0.5 && most(&levelled) == 0.0, "{}", most(&all));
}

#[test]
fn unit_lines_out_of_level_are_corrected_despite_uncertain_crossovers() {
    let (points, found) = uncertain(0.0, 2.0);
    let levelled = level_lines(points.borrow(), &found, &LevellingOptions::default());
    let left: Vec<f64> =
        levelled.lines.iter().filter(|l| !l.tie).map(|l| l.coefficients_nt[0] - 2.0 * offset(l.line)).collect();
    let rms = (left.iter().map(|d| d * d).sum::<f64>() / left.len() as f64).sqrt();
    // The offsets are 10 nT rms. Each line has four crossovers; one crossover is in a flat field and has an error of 1
    // nT.
    assert!(rms < 2.0, "{rms} {left:?}");
}

#[test]
fn unit_one_line_out_of_level_is_corrected_alone() {
    let (points, mut found) = uncertain(0.0, 0.0);
    let of = |c: &Crossover, line: usize| c.lines.iter().position(|l| *l == line);
    for c in &mut found {
        if let Some(side) = of(c, 4) {
            c.value_nt[side] += 60.0;
        }
    }
    let levelled = level_lines(points.borrow(), &found, &LevellingOptions::default());
    for line in &levelled.lines {
        assert_eq!(line.alone, line.line == 4, "{line:?}");
        let expected = if line.line == 4 { 60.0 } else { 0.0 };
        assert!((line.coefficients_nt[0] - expected).abs() < if line.alone { 4.0 } else { 2.0 }, "{line:?}");
    }
}
