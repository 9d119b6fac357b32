//! Prior of the next calibration from repeated calibrations.

use super::*;
use nalgebra::DMatrix;

fn draws(count: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut normals = NormalGenerator::new(seed);
    let one = |_| {
        let [a, b, c, d] = [0; 4].map(|_| normals.draw());
        vec![100.0 + 10.0 * a, 0.1 * b, 50.0 + 10.0 * a + 5.0 * c, 3.0 * d]
    };
    (0..count).map(one).collect()
}

fn prior(calibrations: &[Vec<f64>]) -> CoefficientPrior {
    let tables: Vec<&[f64]> = calibrations.iter().map(Vec::as_slice).collect();
    prior_from_calibrations(&tables, None).unwrap()
}

#[test]
fn law_the_prior_is_consistent_with_the_next_calibration() {
    for count in [6_usize, 10, 40] {
        let (mut squares, trials) = ([0.0; 4], 4000_u64);
        for trial in 0..trials {
            let mut all = draws(count + 1, 100 * trial + count as u64);
            let next = all.pop().unwrap();
            let prior = prior(&all);
            for (c, square) in squares.iter_mut().enumerate() {
                *square += (next[c] - prior.mean[c]).powi(2) / prior.covariance[5 * c] / trials as f64;
            }
        }
        // With 6 calibrations, the squared ratio has the variance of a squared Student's t of 5 degrees, 9 − 1. One
        // standard deviation is sqrt(8/4000), 4.5 %; the limit is three standard deviations.
        assert!(squares.iter().all(|square| (square - 1.0).abs() < 0.14), "{count} {squares:?}");
    }
}

#[test]
fn law_fewer_calibrations_than_terms_give_a_positive_matrix() {
    for count in [2, 3, 4] {
        let prior = prior(&draws(count, 7 + count as u64));
        let sigma = prior.sigma();
        let correlation = DMatrix::from_fn(4, 4, |i, j| prior.covariance[4 * i + j] / (sigma[i] * sigma[j]));
        let least = correlation.clone().symmetric_eigenvalues().min();
        // At least 1/m of the diagonal.
        assert!(least >= 1.0 / count as f64 - 1e-9, "{count} {least}");
        assert_eq!(count < 4, correlation[(0, 2)] == 0.0);
    }
}

#[test]
fn law_many_calibrations_are_not_shrunk() {
    let prior = prior(&draws(2000, 1));
    let expected: [[f64; 4]; 4] =
        [[100.0, 0.0, 100.0, 0.0], [0.0, 0.01, 0.0, 0.0], [100.0, 0.0, 125.0, 0.0], [0.0, 0.0, 0.0, 9.0]];
    for i in 0..4 {
        for j in 0..4 {
            let size = (expected[i][i] * expected[j][j]).sqrt();
            // The relative standard deviation of a standard deviation is 1/sqrt(2000) = 2.2 %, and sqrt(2) times 2.2 %
            // for a variance. The limit is four standard deviations.
            assert!((prior.covariance[4 * i + j] - expected[i][j]).abs() < 0.13 * size, "{i} {j}");
        }
    }
}

#[test]
fn unit_one_calibration_requires_its_covariance() {
    let own = [4.0, 1.0, 1.0, 9.0];
    let prior = prior_from_calibrations(&[&[1.0, 2.0]], Some(&own)).unwrap();
    assert_eq!((prior.mean.as_slice(), prior.covariance.as_slice()), ([1.0, 2.0].as_slice(), own.as_slice()));
    let words = |tables: &[&[f64]], own: Option<&[f64]>| prior_from_calibrations(tables, own).unwrap_err().to_string();
    assert!(words(&[&[1.0, 2.0]], None).starts_with("the scatter of a single calibration is unknown"));
    assert_eq!(words(&[], None), "no calibration is given");
    assert!(words(&[&[1.0, 2.0], &[1.0]], None).starts_with("calibration 1 must have 2 coefficients"));
    assert!(words(&[&[1.0, 2.0], &[1.0, f64::NAN]], None).starts_with("calibration 1"));
    assert!(words(&[&[1.0, 2.0]], Some(&[1.0, 2.0, 2.0, 1.0])).contains("a correlation is outside -1 to 1"));
}

#[test]
fn law_the_walk_density_is_estimated_from_calibrations() {
    let mut normals = NormalGenerator::new(2);
    let (mut at, mut tt_s) = ([0.0, 0.0], 0.0);
    let (mut all, mut times) = (vec![], vec![]);
    for k in 0..4000 {
        let dt_s = 100.0 + f64::from(k % 5) * 100.0;
        tt_s += dt_s;
        at = [at[0] + (0.04_f64 * dt_s).sqrt() * normals.draw(), at[1] + (9.0 * dt_s).sqrt() * normals.draw()];
        all.push(at.to_vec());
        times.push(tt_s);
    }
    let tables: Vec<&[f64]> = all.iter().map(Vec::as_slice).collect();
    let density = walk_density(&tables, &times).unwrap();
    // The standard deviation is sqrt(2/4000) = 2.2 %, and 2.7 % with uneven steps. The limit is four standard
    // deviations.
    assert!((density[0] / 0.04 - 1.0).abs() < 0.11 && (density[1] / 9.0 - 1.0).abs() < 0.11, "{density:?}");
    assert!(walk_density(&tables[..1], &times[..1]).is_err());
    assert!(walk_density(&tables[..2], &[1.0, 1.0]).is_err());
    assert!(walk_density(&[&[1.0], &[f64::NAN]], &[1.0, 2.0]).is_err());
}

#[test]
fn unit_a_cold_start_has_a_sigma_for_every_term() {
    let terms = TermSelection::new(&["bias", "permanent", "induced5", "eddy3", "derivative"]).unwrap();
    let start = ColdStart { permanent_nt: 1.0, induced_nt: 2.0, eddy_nt_s: 3.0, derivative_s: 4.0, bias_nt: 5.0 };
    let prior = start.prior(&terms, 0.1).unwrap();
    let expected = [[1.0; 3].as_slice(), &[2.0; 5], &[30.0; 3], &[40.0; 3], &[5.0]].concat();
    assert!(prior.sigma().iter().zip(&expected).all(|(one, other)| (one - other).abs() < 1e-12));
    assert!(prior.mean.iter().all(|mean| *mean == 0.0) && prior.mean.len() == terms.len());
    assert!(start.prior(&terms, 0.0).is_err());
    assert!(ColdStart { bias_nt: -1.0, ..start }.prior(&terms, 0.1).is_err());
    assert!(ColdStart { bias_nt: -1.0, ..start }.prior(&TermSelection::default(), 0.1).is_ok());
}
