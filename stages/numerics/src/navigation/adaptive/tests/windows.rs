//! Lengths of the window over which the noise is estimated.

use super::*;

/// Mean of R/R̂ and quality of the filter, for windows of 10 and 50 with wide bounds.
fn by_windows(form: AdaptiveForm) -> ([f64; 2], [Tally; 2]) {
    let windows = [10, 50];
    let (mut weights, mut tallies) = ([0.0; 2], [Tally::default(); 2]);
    let flights = 8;
    for seed in 0..flights {
        let flight = OsborneFlight::flown(40 + seed, SAMPLES, 1.0, InsErrorModel::default());
        let (measured, sigma) = (flight.measured(seed, 5.0), vec![5.0; SAMPLES as usize]);
        let ins = flight.ins.series();
        let line = flight.line(&ins, &measured, &sigma);
        for (place, window) in windows.into_iter().enumerate() {
            let parameters = AdaptiveParameters { window, form, ..AdaptiveParameters::default() };
            let output = run(&parameters, &line, &[AdaptiveMagnetometer::from_line(&line, 0.05, 500.0)]).unwrap();
            let sigmas = &output.magnetometers[0].sigma_nt[100..];
            let information = sigmas.iter().map(|sigma| 25.0 / sigma.powi(2)).sum::<f64>() / sigmas.len() as f64;
            weights[place] += information / flights as f64;
            tallies[place].add(&flight, &output.navigation);
        }
    }
    for place in 0..2 {
        let (window, weight, tally) = (windows[place], weights[place], tallies[place]);
        println!(
            "{form:?}, window {window}: R/R\u{302} {weight:.3}, DRMS {:.1} m, NEES {:.2}",
            tally.drms_m(),
            tally.mean_nees()
        );
    }
    (weights, tallies)
}

#[test]
fn law_short_windows_without_bounds_are_overconfident_except_in_the_residual_form() {
    let (weights, tallies) = by_windows(AdaptiveForm::Matched);
    // For a window of 50 the mean of 1/χ² is 50/48; H P Hᵀ of a few nT² increases the estimate. The 8 flights have 370
    // independent windows, and the variance of the estimate in each window is 4 %. For a window of 10 the mean is 10/8
    // before this increase.
    assert!((1.0..1.12).contains(&weights[1]) && weights[0] > 1.25, "{weights:?}");
    assert!(tallies[0].mean_nees() > 2.0 * tallies[1].mean_nees());
    // The residual form subtracts nothing, so 10/8 is the whole effect.
    let (weights, tallies) = by_windows(AdaptiveForm::Residual);
    assert!((1.0..1.12).contains(&weights[1]) && (1.2..1.3).contains(&weights[0]), "{weights:?}");
    assert!(tallies[0].mean_nees() < 1.3 * tallies[1].mean_nees());
}
