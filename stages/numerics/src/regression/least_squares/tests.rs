#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
use super::*;
use crate::reference_csv::columns;

const NAMES: [&str; 5] = ["a0", "a1", "a2", "a3", "a4"];

fn samples() -> (Vec<f64>, Vec<Vec<f64>>) {
    let table = columns(include_str!("../../../reference/signal/ridge_samples.csv"));
    let a = (0..120).flat_map(|i| NAMES.map(|name| table[name][i])).collect();
    (a, vec![table["y0"].clone(), table["y1"].clone()])
}

/// Pseudo-random numbers from -0.5 to 0.5.
fn noise(count: usize, seed: u64) -> Vec<f64> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    (0..count).map(|_| next()).collect()
}

fn targets(y: &[Vec<f64>]) -> Vec<&[f64]> {
    y.iter().map(Vec::as_slice).collect()
}

#[test]
fn val_coefficients_and_residuals_equal_scikit_learn() {
    let (a, y) = samples();
    let factor = QrAccumulator::from_matrix(&a, 5, &targets(&y)).unwrap();
    let table = columns(include_str!("../../../reference/signal/ridge.csv"));
    let lambdas = [0.0, 0.025, 2.5, 100.0];
    assert_eq!(table["lambda"].len(), 16);
    for (row, centred) in table["centred"].iter().enumerate() {
        let centred = *centred == 1.0;
        let path = if centred {
            factor.solve_centred(&lambdas, &NAMES).unwrap()
        } else {
            factor.solve(&lambdas, &NAMES).unwrap()
        };
        let lambda = lambdas.iter().position(|l| *l == table["lambda"][row]).unwrap();
        let (solution, target) = (&path.solutions[lambda], table["target"][row] as usize);
        for (j, ours) in solution.coefficients[target].iter().enumerate() {
            let theirs = table[format!("b{j}").as_str()][row];
            // The condition number of these terms is 1e5, so rounding is 1e-11.
            assert!((ours - theirs).abs() <= 1e-9 * theirs.abs(), "row {row}, term {j}: {ours} {theirs}");
        }
        let near = |ours: f64, theirs: f64| (ours - theirs).abs() <= 1e-10 * (1.0 + theirs.abs());
        assert!(near(solution.intercepts[target], table["intercept"][row]), "row {row}");
        assert!(near(solution.residual_squares[target], table["squares"][row]), "row {row}");
    }
}

#[test]
fn law_coefficients_are_recovered_from_data_without_noise() {
    let (rows, p) = (5000, 18);
    let beta: Vec<f64> = (0..p).map(|j| 10f64.powi(j % 5) * (f64::from(j) + 0.5).cos()).collect();
    let scale = |k: usize| 10f64.powi(-((k % p as usize) as i32 % 4));
    let a: Vec<f64> = noise(rows * p as usize, 3).iter().enumerate().map(|(k, x)| x * scale(k)).collect();
    let y: Vec<f64> = a.chunks(p as usize).map(|row| row.iter().zip(&beta).map(|(a, b)| a * b).sum()).collect();
    let names: Vec<String> = (0..p).map(|j| j.to_string()).collect();
    let path = QrAccumulator::from_matrix(&a, p as usize, &[&y]).unwrap().solve(&[0.0], &names).unwrap();
    for (ours, truth) in path.solutions[0].coefficients[0].iter().zip(&beta) {
        assert!((ours / truth - 1.0).abs() < 1e-6, "{ours} {truth}");
    }
    let mean_square = path.solutions[0].residual_variances[0];
    assert!(mean_square < 1e-18, "{mean_square:e}");
    assert_eq!((path.rank, path.rows), (18, 5000));
}

#[test]
fn unit_the_factor_does_not_depend_on_the_blocks_of_rows() {
    let (a, y) = samples();
    let mut at_once = QrAccumulator::new(5, 2);
    at_once.push(&a, &targets(&y)).unwrap();
    let mut pieces = QrAccumulator::new(5, 2);
    for (start, end) in [(0, 1), (1, 50), (50, 50), (50, 120)] {
        let y: Vec<&[f64]> = y.iter().map(|y| &y[start..end]).collect();
        pieces.push(&a[5 * start..5 * end], &y).unwrap();
    }
    let lambdas = [0.0, 1.0];
    let path = at_once.solve(&lambdas, &NAMES).unwrap();
    assert_eq!(path, pieces.solve(&lambdas, &NAMES).unwrap());
}

#[test]
fn unit_merged_factors_equal_one_on_any_number_of_threads() {
    let (rows, p) = (40_000, 7);
    let (a, y) = (noise(rows * p, 5), noise(rows, 6));
    let names: Vec<String> = (0..p).map(|j| j.to_string()).collect();
    let mut one = QrAccumulator::new(p, 1);
    one.push(&a, &[&y]).unwrap();
    let one = one.solve(&[0.0, 3.0], &names).unwrap();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| QrAccumulator::from_matrix(&a, p, &[&y]).unwrap().solve(&[0.0, 3.0], &names).unwrap())
    };
    let merged = on(1);
    assert_eq!(merged, on(3));
    assert_eq!(merged.rows, rows);
    for (one, merged) in one.solutions.iter().zip(&merged.solutions) {
        for (one, merged) in one.coefficients[0].iter().zip(&merged.coefficients[0]) {
            assert!((one - merged).abs() < 1e-14, "{one} {merged}");
        }
    }
}

#[test]
fn law_means_and_centred_fits_are_those_of_centred_data() {
    let (a, y) = samples();
    let factor = QrAccumulator::from_matrix(&a, 5, &targets(&y)).unwrap();
    let path = factor.solve_centred(&[0.5], &NAMES).unwrap();
    let mean = |x: &mut dyn Iterator<Item = f64>| x.sum::<f64>() / 120.0;
    let means: Vec<f64> = (0..5).map(|j| mean(&mut a.iter().skip(j).step_by(5).copied())).collect();
    for (ours, mean) in path.term_means.iter().zip(&means) {
        assert!((ours - mean).abs() < 1e-13 * (1.0 + mean.abs()));
    }
    let target_mean = mean(&mut y[0].iter().copied());
    assert!((path.target_means[0] - target_mean).abs() < 1e-13 * target_mean.abs());
    let centred: Vec<f64> = a.iter().zip(means.iter().cycle()).map(|(a, m)| a - m).collect();
    let shifted: Vec<f64> = y[0].iter().map(|y| y - target_mean).collect();
    let plain = QrAccumulator::from_matrix(&centred, 5, &[&shifted]).unwrap().solve(&[0.5], &NAMES).unwrap();
    let pairs = path.solutions[0].coefficients[0].iter().zip(&plain.solutions[0].coefficients[0]);
    for (one, other) in pairs {
        assert!((one - other).abs() < 1e-9 * other.abs(), "{one} {other}");
    }
}

#[test]
fn law_covariance_is_that_of_repeated_fits() {
    // The same terms are fitted to 400 realisations of noise. For a target that is only noise, the ridge has no bias.
    // The scatter of the coefficients equals the covariance within the uncertainty √(2/400) = 7 %.
    let (rows, draws, lambda) = (300, 400, 10.0);
    let a = noise(rows * 2, 8).chunks(2).flat_map(|x| [x[0], x[0] + 0.5 * x[1]]).collect::<Vec<_>>();
    let y: Vec<Vec<f64>> = noise(rows * draws, 9).chunks(rows).map(<[f64]>::to_vec).collect();
    let path = QrAccumulator::from_matrix(&a, 2, &targets(&y)).unwrap().solve(&[0.0, lambda], &["a", "b"]).unwrap();
    for (k, solution) in path.solutions.iter().enumerate() {
        let of = |j: usize| solution.coefficients.iter().map(move |b| b[j]);
        let mean = |j: usize| of(j).sum::<f64>() / draws as f64;
        let scatter = |i: usize, j: usize| {
            let products = of(i).zip(of(j)).map(|(x, y)| (x - mean(i)) * (y - mean(j)));
            products.sum::<f64>() / draws as f64
        };
        let told: Vec<Vec<f64>> = (0..draws).map(|t| path.covariance(k, t).unwrap()).collect();
        for ij in 0..4 {
            let told = told.iter().map(|c| c[ij]).sum::<f64>() / draws as f64;
            assert!((scatter(ij / 2, ij % 2) / told - 1.0).abs() < 0.2, "{k} {ij}");
        }
        // Uniform noise from −½ to ½ has the variance 1/12.
        let variances = solution.residual_variances.iter().sum::<f64>() / draws as f64;
        assert!((variances * 12.0 - 1.0).abs() < 0.01, "{variances}");
    }
    assert_eq!(path.covariance(2, 0), None);
    assert_eq!(path.covariance(0, draws), None);
}

#[test]
fn unit_dependent_and_unexcited_terms_are_listed_and_solved_with_a_ridge() {
    let x = noise(600, 11);
    let row = |k: usize| {
        let (a, b, c) = (x[3 * k], x[3 * k + 1], x[3 * k + 2]);
        [a, b, 2.0 * a - 1e-4 * b, c, 0.0]
    };
    let a: Vec<f64> = (0..200).flat_map(row).collect();
    let y: Vec<f64> = (0..200).map(|k| row(k)[0] + row(k)[3]).collect();
    let factor = QrAccumulator::from_matrix(&a, 5, &[&y]).unwrap();
    let error = factor.solve(&[1.0, 0.0], &NAMES).unwrap_err();
    let LeastSquaresError::RankDeficient { rank, unexcited, dependent, .. } = &error else {
        panic!("{error}");
    };
    assert_eq!((*rank, unexcited.as_slice()), (3, ["a4".to_owned()].as_slice()));
    // The dependence a2 = 2 a0 - 1e-4 a1 contains 5e-5 of a1, too little to be listed.
    assert_eq!(dependent.as_slice(), ["a0".to_owned(), "a2".to_owned()]);
    let message = error.to_string();
    assert!(message.contains("`a0`, `a2` are linearly dependent"), "{message}");
    assert!(message.contains("200 rows contain only 3 independent combinations of 5 terms"), "{message}");
    let path = factor.solve(&[1e-3], &NAMES).unwrap();
    assert_eq!((path.rank, path.condition > 1e12), (3, true));
    assert_eq!(path.dependent, ["a0", "a2"]);
    let fitted = &path.solutions[0];
    assert!(fitted.coefficients[0][4] == 0.0 && fitted.residual_squares[0] < 1e-6);
}

#[test]
fn unit_badly_scaled_terms_are_not_reported_as_dependent() {
    let a: Vec<f64> = noise(400, 12).chunks(2).flat_map(|x| [x[0], 1e-9 * x[1]]).collect();
    let y: Vec<f64> = a.chunks(2).map(|x| x[0] + 1e9 * x[1]).collect();
    let path = QrAccumulator::from_matrix(&a, 2, &[&y]).unwrap().solve(&[0.0], &["a", "b"]).unwrap();
    assert_eq!(path.rank, 2);
    assert!((path.solutions[0].coefficients[0][1] / 1e9 - 1.0).abs() < 1e-6);
    // The smallest scale at which the rank still includes a term. The singular value of the unscaled term is below the
    // tolerance, so the columns are first scaled to one length.
    let faint: Vec<f64> = a.chunks(2).flat_map(|x| [x[0], 3e-4 * x[1]]).collect();
    let factor = QrAccumulator::from_matrix(&faint, 2, &[&y]).unwrap();
    assert_eq!(factor.solve(&[0.0], &["a", "b"]).unwrap().rank, 2);
    // A constant is excited only if means are not subtracted.
    let with_bias: Vec<f64> = a.chunks(2).flat_map(|x| [x[0], 50_000.1]).collect();
    let factor = QrAccumulator::from_matrix(&with_bias, 2, &[&y]).unwrap();
    assert_eq!(factor.solve(&[0.0], &["a", "bias"]).unwrap().rank, 2);
    let error = factor.solve_centred(&[0.0], &["a", "bias"]).unwrap_err();
    assert!(error.to_string().contains("`bias` are constant"), "{error}");
}

#[test]
fn law_degrees_of_freedom_fall_from_all_terms_to_none() {
    let (a, y) = samples();
    let factor = QrAccumulator::from_matrix(&a, 5, &targets(&y)).unwrap();
    let path = factor.solve(&[0.0, 1.0, 1e12], &NAMES).unwrap();
    let degrees: Vec<f64> = path.solutions.iter().map(|s| s.degrees_of_freedom).collect();
    assert!((degrees[0] - 5.0).abs() < 1e-12 && degrees[1] < 5.0 && degrees[2] < 1e-6, "{degrees:?}");
    assert!(path.singular_values.windows(2).all(|s| s[0] >= s[1]));
    let few = QrAccumulator::from_matrix(&a[..15], 5, &[&y[0][..3]]).unwrap();
    assert!(few.solve(&[0.0], &NAMES).is_err());
    assert!(few.solve(&[1.0], &NAMES).unwrap().solutions[0].coefficients[0][0].is_finite());
}

#[test]
fn unit_invalid_input_is_rejected() {
    let mut factor = QrAccumulator::new(2, 1);
    let message = |result: Result<(), LeastSquaresError>| result.unwrap_err().to_string();
    factor.push(&[1.0, 2.0], &[&[1.0]]).unwrap();
    let nan = message(factor.push(&[1.0, 2.0, 3.0, f64::NAN], &[&[1.0, 2.0]]));
    assert!(nan.contains("row 2 of term 1"), "{nan}");
    let inf = message(factor.push(&[1.0, 2.0, 3.0, 4.0], &[&[f64::INFINITY, 2.0]]));
    assert!(inf.contains("row 1 of target 0"), "{inf}");
    assert_eq!(factor.rows(), 1);
    assert!(message(factor.push(&[1.0], &[&[1.0]])).contains("has 1 entries, but 2 are required"));
    assert!(message(factor.push(&[1.0, 1.0], &[])).contains("list of targets"));
    assert!(message(factor.merge(QrAccumulator::new(1, 2))).contains("targets"));
    assert!(message(factor.merge(QrAccumulator::new(1, 1))).contains("terms"));
    assert!(factor.solve(&[-1.0], &["a", "b"]).unwrap_err().to_string().contains("but is -1"));
    assert!(factor.solve(&[f64::NAN], &["a", "b"]).is_err());
    assert!(factor.solve(&[1.0], &["a"]).is_err());
    let none = QrAccumulator::new(2, 1).solve(&[1.0], &["a", "b"]);
    assert_eq!(none, Err(LeastSquaresError::NoRows));
    let far = noise(60_000, 1);
    let mut y = far[..30_000].to_vec();
    y[20_000] = f64::NAN;
    let error = QrAccumulator::from_matrix(&far, 2, &[&y]).unwrap_err().to_string();
    assert!(error.contains("row 20000 of target 0"), "{error}");
}
