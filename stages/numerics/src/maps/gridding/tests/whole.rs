use super::*;

#[test]
fn unit_a_survey_becomes_a_grid_with_its_expected_error() {
    let points = survey();
    let mut options = GriddingOptions::new(GriddingMethod::equivalent_sources());
    options.folds = Some(LineFolds::all(4));
    let seen = std::sync::Mutex::new(Vec::new());
    let made = grid(points.borrow(), &options, &|what, _, _| seen.lock().unwrap().push(what.to_owned())).unwrap();
    let report = &made.report;
    assert_eq!((report.line_spacing_m.round(), report.block_m.round(), report.masked), (200.0, 50.0, 0));
    assert_eq!((made.grid.rows(), made.grid.columns()), (41, 41));
    assert_eq!(report.level_m, Some(points.height_m.iter().copied().fold(0.0, f64::max)));
    for step in ["cleaning", "equivalent sources", "grid", "cross-validation"] {
        assert!(seen.lock().unwrap().iter().any(|s| s == step), "{step}");
    }
    let exact = |k: usize| field([100.0 * (k % 41) as f64, 100.0 * (k / 41) as f64, report.level_m.unwrap()])[0];
    let inner = (0..41 * 41).filter(|k| (5..36).contains(&(k % 41)) && (5..36).contains(&(k / 41)));
    let (wrong, signal) = (rms(inner.clone().map(|k| made.grid.values[k] - exact(k))), rms(inner.map(exact)));
    assert!(wrong < 0.03 * signal, "{wrong} of {signal}");
    let crossed = report.cross_validation.unwrap();
    assert_eq!(crossed.n, points.line.len());
    assert!(crossed.median_nt < crossed.rms_nt && crossed.median_nt < crossed.p95_nt);
    // If a line is omitted, the gap there is twice as wide. The map with all lines is therefore more accurate.
    let error = made.error.unwrap();
    assert!(error.unknown() == 0 && rms(error.values.iter().copied()) > wrong);
}

#[test]
fn unit_expected_error_is_large_near_badly_predicted_lines() {
    let points = survey();
    let differences: Vec<f64> =
        points.easting_m.iter().map(|e| if *e > 502_000.0 { 20.0 } else { f64::from((*e as i32) % 3 - 1) }).collect();
    let east_m = EvenAxis { first: 500_000.0, step: 500.0, len: 9 };
    let north_m = EvenAxis { first: 7_000_000.0, step: 500.0, len: 9 };
    let error = expected_error(points.borrow(), &differences, [east_m, north_m], 50.0);
    for r in 0..9 {
        assert!(error.get(r, 0) < 1.0 && (error.get(r, 8) - 20.0).abs() < 1e-9);
    }
}

#[test]
fn unit_nodes_far_from_data_are_unknown() {
    let east_m = EvenAxis { first: 0.0, step: 10.0, len: 11 };
    let mut grid = PlaneGrid { east_m, north_m: EvenAxis { len: 1, ..east_m }, values: vec![1.0; 11] };
    assert_eq!(mask(&mut grid, &[30.0, 35.0], &[0.0, 10.0], 20.0), 6);
    let known: Vec<usize> = (0..11).filter(|k| !grid.values[*k].is_nan()).collect();
    assert_eq!(known, [1, 2, 3, 4, 5]);
    assert_eq!(mask(&mut grid, &[30.0], &[0.0], f64::INFINITY), 0);
}

#[test]
fn unit_a_block_that_contradicts_the_field_is_excluded() {
    let mut points = survey();
    points.value_nt[850..853].iter_mut().for_each(|v| *v += 400.0);
    let clean = CleaningOptions { sigmas: 0.0, ..CleaningOptions::default() };
    let options =
        GriddingOptions { misfit_sigmas: 12.0, clean, ..GriddingOptions::new(GriddingMethod::equivalent_sources()) };
    let report = grid(points.borrow(), &options, QUIET).unwrap().report;
    assert!(!report.misfits.is_empty());
    let near = |m: &[f64; 2]| (m[0] - points.easting_m[851]).hypot(m[1] - points.northing_m[851]) < 300.0;
    assert!(report.misfits.iter().all(near), "{:?}", report.misfits);
}

#[test]
fn unit_invalid_settings_are_rejected() {
    let points = survey();
    let refused = |change: &dyn Fn(&mut GriddingOptions)| {
        let mut options = GriddingOptions::new(GriddingMethod::minimum_curvature());
        change(&mut options);
        grid(points.borrow(), &options, QUIET).err().map(|e| e.to_string()).unwrap_or_default()
    };
    assert!(refused(&|o| o.spacing_m = Some(0.0)).contains("`spacing_m` is 0, but must be above zero"));
    assert!(refused(&|o| o.spacing_m = Some(1e-4)).contains("nodes, more than"));
    assert!(refused(&|o| o.block_m = Some(f64::NAN)).contains("`block_m`"));
    let taut = RelaxationOptions { tension: 1.5, tolerance_nt: 0.1, passes: 1 };
    assert!(refused(&|o| o.method = GriddingMethod::MinimumCurvature(taut)).contains("`tension` is 1.5"));
    let undamped = GriddingMethod::EquivalentSources { layers: None, damping: 0.0, level_m: None };
    assert!(refused(&|o| o.method = undamped.clone()).contains("`damping`"));
    let low = GriddingMethod::EquivalentSources { layers: None, damping: 1.0, level_m: Some(100.0) };
    assert!(refused(&|o| o.method = low.clone()).contains("it is defined above the equivalent sources"));
    let none = OwnedSurveyPoints::default();
    assert_eq!(
        grid(none.borrow(), &GriddingOptions::new(GriddingMethod::minimum_curvature()), QUIET).err(),
        Some(GriddingError::NoPoints)
    );
}
