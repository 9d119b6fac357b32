use super::likelihood::PathCovarianceFactor;
use super::*;
use crate::navigation::ins_error::{InsGrade, simulate_ins_error};
use crate::navigation::ins_only;
use crate::navigation::pinson::{VE, VN};
use crate::navigation::position_fixes::PositionFixes;
use crate::navigation::slam::samples::step_ends;
use crate::navigation::slam::tests::flights::{Flight, M_PER_DEG, ROUGH_DEG, loiter, straight, waves};
use crate::navigation::slam::{CovarianceFunction, HyperparameterSource, SlamParameters, run};
use crate::random::NormalGenerator;

/// Random path of `n` measurements, and random functions along the path.
fn problem(n: usize, count: usize, seed: u64) -> (SlamProblem, Vec<f64>) {
    let mut normals = NormalGenerator::new(seed);
    let mut at_m = [0.0; 2];
    let mut measured = vec![];
    for place in 0..n {
        at_m = at_m.map(|x| x + 60.0 * normals.draw());
        measured.push(SlamMeasurement {
            tt_s: place as f64,
            at_m,
            value_nt: 30.0 * normals.draw(),
            variance_nt2: 1.0 + 0.1 * normals.draw().abs(),
            core_nt_per_m: [0.02 * normals.draw(), 0.02 * normals.draw()],
        });
    }
    let functions = Mat::from_fn(2 * n, count, |_, _| 30.0 * normals.draw());
    let weights = (0..count).map(|_| 0.3 * normals.draw()).collect();
    (SlamProblem { measured, functions, temporal: (2.0, 100.0), mean_nt2: 1e4, centre_nt: 3.0 }, weights)
}

fn with(weights: &[f64], place: usize, more: f64) -> Vec<f64> {
    let mut weights = weights.to_vec();
    weights[place] += more;
    weights
}

const STEP: f64 = 1e-5;

#[test]
fn law_derivatives_equal_finite_differences() {
    let (problem, weights) = problem(90, 5, 4);
    for covariance in
        [CovarianceFunction::SquaredExponential, CovarianceFunction::Matern52, CovarianceFunction::Matern32]
    {
        let kernel = AnomalyKernel { covariance, sigma_se_nt: 50.0, length_m: 200.0, sigma_n_nt: 2.0 };
        let at = |weights: &[f64]| -> PathCovarianceFactor { problem.factored(&kernel, weights).unwrap() };
        let found = at(&weights).derivatives(&problem, &kernel);
        for i in 0..weights.len() {
            let (above, below) = (at(&with(&weights, i, STEP)), at(&with(&weights, i, -STEP)));
            let expected = (above.cost - below.cost) / (2.0 * STEP);
            assert!((found.gradient[i] - expected).abs() < 1e-5 * expected.abs().max(10.0), "{covariance:?} {i}");
            let (above, below) = (above.derivatives(&problem, &kernel), below.derivatives(&problem, &kernel));
            for j in 0..weights.len() {
                let expected = (above.gradient[j] - below.gradient[j]) / (2.0 * STEP);
                let (found, scale) = (found.hessian[(j, i)], found.hessian[(i, i)].abs());
                assert!((found - expected).abs() < 1e-4 * scale, "{covariance:?} {i} {j} {found} {expected}");
            }
        }
        let by = at(&weights).by_kernel(&kernel);
        let moved = |which: usize, more: f64| {
            let factor = |place: usize| if place == which { more.exp() } else { 1.0 };
            AnomalyKernel {
                covariance,
                sigma_se_nt: kernel.sigma_se_nt * factor(0),
                length_m: kernel.length_m * factor(1),
                sigma_n_nt: kernel.sigma_n_nt * factor(2),
            }
        };
        for (which, found) in by.gradient.iter().enumerate() {
            let cost = |more: f64| problem.factored(&moved(which, more), &weights).unwrap().cost;
            let expected = (cost(STEP) - cost(-STEP)) / (2.0 * STEP);
            assert!((found - expected).abs() < 1e-5 * expected.abs().max(10.0), "{which} {found} {expected}");
        }
    }
}

/// The expected value of (∂J/∂θᵢ)(∂J/∂θⱼ) over measurements drawn from the model is the Fisher information.
#[test]
fn law_the_information_of_the_kernel_is_the_covariance_of_its_gradient() {
    let (mut problem, weights) = problem(40, 3, 8);
    let kernel =
        AnomalyKernel { covariance: CovarianceFunction::Matern52, sigma_se_nt: 50.0, length_m: 200.0, sigma_n_nt: 5.0 };
    problem.mean_nt2 = 0.0;
    problem.centre_nt = 0.0;
    for measured in &mut problem.measured {
        measured.core_nt_per_m = [0.0; 2];
    }
    let moved = problem.displacements_m(&weights);
    let n = problem.measured.len();
    let covariance = Mat::from_fn(n, n, |i, j| {
        let (a, b) = (&problem.measured[i], &problem.measured[j]);
        let apart = [0, 1].map(|axis: usize| a.at_m[axis] + moved[i][axis] - b.at_m[axis] - moved[j][axis]);
        let white = if i == j { a.variance_nt2 + 25.0 } else { 0.0 };
        kernel.anomaly_nt2(apart[0].powi(2) + apart[1].powi(2)) + 4.0 * (-(a.tt_s - b.tt_s).abs() / 100.0).exp() + white
    });
    let root = covariance.llt(Side::Lower).unwrap().L().to_owned();
    let mut normals = NormalGenerator::new(5);
    let mut sums = [[0.0; 3]; 3];
    const RUNS: usize = 1500;
    let mut information = [[0.0; 3]; 3];
    for _ in 0..RUNS {
        let draws = Mat::from_fn(n, 1, |_, _| normals.draw());
        let values = &root * draws;
        for (place, measured) in problem.measured.iter_mut().enumerate() {
            measured.value_nt = values[(place, 0)];
        }
        let by = problem.factored(&kernel, &weights).unwrap().by_kernel(&kernel);
        for (sums, a) in sums.iter_mut().zip(&by.gradient) {
            for (sum, b) in sums.iter_mut().zip(&by.gradient) {
                *sum += a * b / RUNS as f64;
            }
        }
        information = by.information;
    }
    for i in 0..3 {
        for j in 0..3 {
            let scale = (information[i][i] * information[j][j]).sqrt();
            // The mean of 1500 products has a standard deviation of 0.04 of the scale; the products have long tails.
            assert!((sums[i][j] - information[i][j]).abs() < 0.2 * scale, "{i} {j} {sums:?} {information:?}");
        }
    }
}

/// Flight as input of the filter.
fn line_of<'a>(ins: &'a crate::navigation::InsSeries<'a>, flight: &'a Flight) -> SlamLine<'a> {
    let (measurement_nt, sigma_nt) = (flight.measured_nt.as_slice(), flight.sigma_nt.as_slice());
    SlamLine { ins, measurement_nt, sigma_nt, core: None, fixes: None, errors: flight.model }
}

#[test]
fn law_the_functions_have_the_covariance_of_simulated_errors() {
    let flight = Flight::tactical(loiter(ROUGH_DEG, 240, 1.0), 1);
    let ins = flight.ins.series();
    let line = line_of(&ins, &flight);
    let frame = LocalFrame::new(&ins, &flight.model);
    let ends = step_ends(ins.tt_s, 2.0);
    let motion = InsErrorTransitions::along(&line, &ends, &frame).unwrap();
    let functions = motion.functions(LACKING_M);
    let last = motion.steps() - 1;
    let places = [(40, 0), (40, 1), (last, 0), (last, 1)];
    let mut sums = [[0.0; 4]; 4];
    const RUNS: u64 = 600;
    for seed in 0..RUNS {
        let mut normals = NormalGenerator::new(seed);
        let errors = simulate_ins_error(&ins, &flight.model, || normals.draw()).unwrap();
        let of = places.map(|(step, axis)| errors[ends[step]][[LAT, LON][axis]] * frame.m_per_rad[axis]);
        for (sums, a) in sums.iter_mut().zip(&of) {
            for (sum, b) in sums.iter_mut().zip(&of) {
                *sum += a * b / RUNS as f64;
            }
        }
    }
    let covariance = |(a, b): (usize, usize), (c, d): (usize, usize)| -> f64 {
        functions.at(a, b).iter().zip(functions.at(c, d)).map(|(x, y)| x * y).sum()
    };
    for (i, a) in places.iter().enumerate() {
        for (j, b) in places.iter().enumerate() {
            let (found, scale) = (covariance(*a, *b), (covariance(*a, *a) * covariance(*b, *b)).sqrt());
            // A mean of 600 products has a standard deviation of at most √(2/600) of the scale; the limit is four
            // standard deviations.
            assert!((found - sums[i][j]).abs() < 0.23 * scale, "{i} {j} {found} {}", sums[i][j]);
        }
        let whole = motion.alone_m2(a.0)[a.1];
        assert!((covariance(*a, *a) + functions.lacking_m2[a.0][a.1] - whole).abs() < 1e-6 * whole);
        assert!(functions.lacking_m2[a.0][a.1] <= LACKING_M * LACKING_M);
    }
    println!("{} functions for {} steps", functions.count, motion.steps());
    let mut normals = NormalGenerator::new(9);
    let weights: Vec<f64> = (0..functions.count).map(|_| normals.draw()).collect();
    let states = motion.states(&functions, &weights);
    for (step, state) in states.iter().enumerate() {
        for axis in 0..2 {
            let expected: f64 = functions.at(step, axis).iter().zip(&weights).map(|(b, u)| b * u).sum();
            let found = state[[LAT, LON][axis]] * frame.m_per_rad[axis];
            assert!((found - expected).abs() < 1e-6 * expected.abs().max(1.0), "{step} {axis} {found} {expected}");
        }
    }
    // Velocity is the derivative of the position, except for the change by an acceleration of about 0.1 m/s² in 2 s.
    for step in 20..last - 1 {
        for (axis, state) in [(0, VN), (1, VE)] {
            let at = |step: usize| states[step][[LAT, LON][axis]] * frame.m_per_rad[axis];
            let slope = (at(step + 1) - at(step - 1)) / 4.0;
            assert!((slope - states[step][state]).abs() < 0.05 * states[step][state].abs().max(1.0), "{step} {axis}");
        }
    }
}

fn parameters(particles: usize, measurements: usize) -> SlamParameters {
    let smoother = SlamSmootherParameters { measurements, ..SlamSmootherParameters::default() };
    SlamParameters { particles, smoother: Some(smoother), ..SlamParameters::default() }
}

fn smoothed(flight: &Flight, parameters: &SlamParameters) -> SlamOutput {
    let ins = flight.ins.series();
    run(parameters, &line_of(&ins, flight)).unwrap()
}

/// Fixed positions along the path determine the field as a plane; the remaining problem is a linear regression.
#[test]
fn law_over_a_known_plane_it_equals_least_squares() {
    let mut normals = NormalGenerator::new(3);
    let (slope, sigma) = ([0.05, -0.03], 0.5);
    let plane = |[north, east]: [f64; 2]| slope[0] * north + slope[1] * east;
    let mut measured = vec![];
    for k in 0..441 {
        let at_m = [50.0 * f64::from(k % 21), 50.0 * f64::from(k / 21)];
        measured.push(SlamMeasurement {
            tt_s: 0.0,
            at_m,
            value_nt: plane(at_m),
            variance_nt2: 1e-6,
            core_nt_per_m: [0.0; 2],
        });
    }
    let (count, path) = (4, 60);
    let true_weights: Vec<f64> = (0..count).map(|_| normals.draw()).collect();
    let mut rows = vec![0.0; 2 * measured.len() * count];
    let (mut normal, mut right) = (nalgebra::DMatrix::<f64>::identity(count, count), nalgebra::DVector::zeros(count));
    for k in 0..path {
        let along = f64::from(k) / f64::from(path);
        let of = |phase: f64| [20.0, 30.0 * along, 40.0 * along * along, 20.0 * (6.0 * along + phase).sin()];
        let functions = [of(0.0), of(1.0).map(|x| -x)];
        let at_m = [150.0 + 700.0 * along, 500.0 + 200.0 * (5.0 * along).sin()];
        let moved = functions.map(|f| f.iter().zip(&true_weights).map(|(f, u)| f * u).sum::<f64>());
        let value_nt = plane([at_m[0] + moved[0], at_m[1] + moved[1]]) + sigma * normals.draw();
        let h = nalgebra::DVector::from_fn(count, |i, _| slope[0] * functions[0][i] + slope[1] * functions[1][i]);
        normal += &h * h.transpose() / (sigma * sigma);
        right += h * ((value_nt - plane(at_m)) / (sigma * sigma));
        measured.push(SlamMeasurement {
            tt_s: 0.0,
            at_m,
            value_nt,
            variance_nt2: sigma * sigma,
            core_nt_per_m: [0.0; 2],
        });
        rows.extend(functions[0]);
        rows.extend(functions[1]);
    }
    let functions = MatRef::from_row_major_slice(&rows, 2 * measured.len(), count).to_owned();
    let problem = SlamProblem { measured, functions, temporal: (0.0, 1.0), mean_nt2: 1e4, centre_nt: 0.0 };
    let prior = SlamWeightPrior { information: Mat::identity(count, count), force: vec![0.0; count] };
    let kernel = AnomalyKernel {
        covariance: CovarianceFunction::SquaredExponential,
        sigma_se_nt: 100.0,
        length_m: 2000.0,
        sigma_n_nt: 0.0,
    };
    let rules = SlamSearchParameters { passes: 20, tolerance_m: 1e-7, fits: false, lengths_m: (1.0, 1.0) };
    let mut search = SlamSearch::from(&problem, &prior, rules, vec![0.0; count], kernel).unwrap();
    search.run().unwrap();
    let inverse = normal.clone().try_inverse().unwrap();
    let expected = &inverse * right;
    let covariance = search.covariance().unwrap();
    for i in 0..count {
        let sd = inverse[(i, i)].sqrt();
        println!("{i}: {} {} sd {sd} {}", search.weights[i], expected[i], covariance[(i, i)].sqrt());
        // The regression of the plane gives the field to 1e-5 of the noise.
        assert!((search.weights[i] - expected[i]).abs() < 1e-4 * sd);
        assert!((covariance[(i, i)].sqrt() / sd - 1.0).abs() < 1e-4);
    }
}

#[test]
fn law_without_information_from_the_field_the_end_of_the_track_equals_the_kalman_filter() {
    let mut flight = Flight::tactical(loiter(ROUGH_DEG, 400, 0.5), 3);
    flight.sigma_nt.fill(1e7);
    let (ins, truth) = (flight.ins.series(), &flight.truth.columns);
    let mut normals = NormalGenerator::new(2);
    let mut of = |column: usize, m_per_unit: f64| -> Vec<f64> {
        let mut at = |(row, value): (usize, &f64)| {
            let noise = 5.0 * normals.draw() / m_per_unit;
            if row % 7 == 0 && !(120..240).contains(&row) { value + noise } else { f64::NAN }
        };
        truth[column].iter().enumerate().map(&mut at).collect()
    };
    let fixes = PositionFixes {
        lat_deg: of(1, M_PER_DEG.0),
        lon_deg: of(2, M_PER_DEG.1),
        alt_m: vec![f64::NAN; 400],
        horizontal_sigma_m: 5.0,
        vertical_sigma_m: 5.0,
    };
    let exact = ins_only::run(&ins, &flight.model, Some(&fixes)).unwrap();
    let kernel = AnomalyKernel { sigma_se_nt: 100.0, length_m: 700.0, ..AnomalyKernel::default() };
    let parameters = SlamParameters { kernel, hyperparameters: HyperparameterSource::Fixed, ..parameters(50, 100) };
    let found = run(&parameters, &SlamLine { fixes: Some(&fixes), ..line_of(&ins, &flight) }).unwrap();
    assert!(found.report.smoother.unwrap().converged);
    let out = &found.navigation;
    let row = 399;
    let apart_m = ((out.lat_deg[row] - exact.lat_deg[row]) * M_PER_DEG.0)
        .hypot((out.lon_deg[row] - exact.lon_deg[row]) * M_PER_DEG.1);
    println!("{apart_m} m of {} m", exact.sd_n_m[row]);
    // Error of the basis functions.
    assert!(apart_m < 0.1, "{apart_m}");
    assert!((out.sd_n_m[row] / exact.sd_n_m[row] - 1.0).abs() < 0.01);
    assert!((out.sd_e_m[row] / exact.sd_e_m[row] - 1.0).abs() < 0.01);
    assert!((out.vn_mps[row] - exact.vn_mps[row]).abs() < 0.05 && (out.alt_m[row] - exact.alt_m[row]).abs() < 0.5);
    // The smoother has more information than the filter during the GNSS gap.
    assert!(out.sd_n_m[200] < 0.7 * exact.sd_n_m[200], "{} {}", out.sd_n_m[200], exact.sd_n_m[200]);
}

#[test]
fn law_loiters_are_accurate_to_metres_and_consistent() {
    let (mut filter, mut smoother, mut nees) = (0.0, 0.0, 0.0);
    const FLIGHTS: u64 = 4;
    for seed in 0..FLIGHTS {
        let flight = Flight::tactical(loiter(ROUGH_DEG, 600, 1.0), seed);
        let both = smoothed(&flight, &parameters(150, 300));
        let alone = smoothed(&flight, &SlamParameters { smoother: None, ..parameters(150, 300) });
        let report = both.report.smoother.unwrap();
        let (before, after, of) = (flight.drms_m(Some(&alone)), flight.drms_m(Some(&both)), flight.nees(&both).0);
        println!("{seed}: {before:.1} m to {after:.2} m, NEES per degree of freedom {of:.2}, {report:?}");
        assert!(report.converged && report.fall > 0.0, "{report:?}");
        filter += before * before;
        smoother += after * after;
        nees += of / FLIGHTS as f64;
    }
    assert!(smoother < 0.1 * filter, "{filter} {smoother}");
    // The expected value is 1. Errors are correlated, so a flight has only a few independent errors.
    assert!((0.2..3.0).contains(&nees), "{nees}");
}

/// A field that changes after half of the flight, so that the visits agree on no path.
#[test]
fn law_contradicting_visits_are_evidence_against_the_track() {
    let flight = |field: u64| {
        Flight::over(loiter(ROUGH_DEG, 600, 1.0), InsGrade::Tactical.model(), 5, &waves(60.0, 400.0, field))
    };
    let (agreeing, other) = (flight(1), flight(2));
    let mut contradicting = flight(1);
    contradicting.measured_nt[300..].copy_from_slice(&other.measured_nt[300..]);
    let report = |flight: &Flight| smoothed(flight, &parameters(100, 300)).report.smoother.unwrap();
    let (right, wrong) = (report(&agreeing), report(&contradicting));
    println!("{right:?}\n{wrong:?}");
    assert!(right.agreement > 0.6 && wrong.agreement < CONTRADICTED, "{} {}", right.agreement, wrong.agreement);
}

#[test]
fn law_a_track_without_a_revisit_keeps_the_covariance_of_the_ins() {
    let flight = Flight::tactical(straight(300, 1.0), 3);
    let both = smoothed(&flight, &parameters(50, 150));
    assert!(both.report.smoother.is_some());
    let ins = flight.ins.series();
    let alone = ins_only::run(&ins, &flight.model, None).unwrap();
    for row in [100, 200, 299] {
        // Across the line, the data contain no information. Along the line, they show that the roughness of the field
        // does not change.
        let ratio = both.navigation.sd_e_m[row] / alone.sd_e_m[row];
        println!("{row}: {ratio} across, {} along", both.navigation.sd_n_m[row] / alone.sd_n_m[row]);
        assert!((0.9..1.02).contains(&ratio), "{row} {ratio}");
    }
}

#[test]
fn law_a_gated_outlier_has_no_effect() {
    let mut flight = Flight::tactical(loiter(ROUGH_DEG, 400, 1.0), 2);
    let gated = SlamParameters { gate_nis: Some(100.0), ..parameters(100, 400) };
    let clean = smoothed(&flight, &gated);
    for row in [50, 230, 390] {
        flight.measured_nt[row] += 200.0;
    }
    let (with, without) = (smoothed(&flight, &gated), smoothed(&flight, &parameters(100, 400)));
    let drms = [&clean, &with, &without].map(|out| flight.drms_m(Some(out)));
    println!("{drms:?}");
    assert!(with.report.smoother.unwrap().measurements <= 397);
    assert!(drms[1] < 1.5 * drms[0] && drms[1] < drms[2], "{drms:?}");
}

#[test]
fn unit_results_are_bit_identical_for_any_number_of_threads() {
    let flight = Flight::tactical(loiter(ROUGH_DEG, 300, 1.0), 1);
    let of = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let out = pool.install(|| smoothed(&flight, &parameters(100, 150)));
        assert!(out.report.smoother.is_some());
        let columns = [&out.navigation.lat_deg, &out.navigation.vn_mps, &out.navigation.sd_e_m];
        let bits = columns.into_iter().flatten().map(|x| x.to_bits()).collect::<Vec<_>>();
        (bits, out.path.iter().map(|sample| sample.at_m[1].to_bits()).collect::<Vec<_>>())
    };
    assert_eq!(of(1), of(3));
}

#[test]
fn unit_tracks_that_cannot_be_smoothed_do_not_change() {
    let mut flight = Flight::tactical(loiter(ROUGH_DEG, 60, 1.0), 1);
    flight.measured_nt.fill(f64::NAN);
    let both = smoothed(&flight, &parameters(20, 100));
    let alone = smoothed(&flight, &SlamParameters { smoother: None, ..parameters(20, 100) });
    assert_eq!((both.report.smoother, both.navigation.lat_deg), (None, alone.navigation.lat_deg));
    let wrong = [
        SlamSmootherParameters { measurements: 1, ..SlamSmootherParameters::default() },
        SlamSmootherParameters { passes: 0, ..SlamSmootherParameters::default() },
        SlamSmootherParameters { tolerance_m: f64::NAN, ..SlamSmootherParameters::default() },
    ];
    let ins = flight.ins.series();
    for smoother in wrong {
        let refused = SlamParameters { smoother: Some(smoother), ..parameters(20, 100) };
        assert!(matches!(run(&refused, &line_of(&ins, &flight)), Err(NavigationError::Parameter(_))));
    }
}

#[test]
fn unit_groups_are_averaged_near_their_middle() {
    let sample = |k: usize| SlamSample {
        row: k,
        tt_s: 1e5 + k as f64,
        at_m: [30.0 * k as f64, 0.0],
        alt_m: 100.0,
        value_nt: k as f64,
        variance_nt2: 2.0,
        core_nt_per_m: [0.0; 2],
    };
    let samples: Vec<_> = (0..20).map(|k| (sample(k), [k as f64, 0.0])).collect();
    let kernel = AnomalyKernel { length_m: 700.0, ..AnomalyKernel::default() };
    assert_eq!([20, 21, 19].map(|most| thinned(&samples, &kernel, most).len()), [20, 20, 19]);
    // Groups of 5 samples; in each group, the three samples within 35 m of the middle are used.
    let thin = thinned(&samples, &kernel, 4);
    assert_eq!(thin.len(), 4);
    let (second, moved) = thin[1];
    assert_eq!((second.tt_s, second.value_nt, second.at_m, moved[0]), (1e5 + 7.0, 7.0, [210.0, 0.0], 7.0));
    assert!((second.variance_nt2 - 2.0 / 3.0).abs() < 1e-12);
}
