#![allow(clippy::unwrap_used)]

use super::*;
use crate::random::NormalGenerator;

fn rows(n: usize, phase: f64) -> Vec<f64> {
    (0..n).flat_map(|k| [(0.3 * k as f64 + phase).sin() + 2.0, (0.07 * k as f64).cos(), k as f64]).collect()
}

#[test]
fn law_the_bands_add_up_to_the_products_of_the_rows() {
    for n in [1, 2, 101, 300] {
        let (mut found, x) = (CrossSpectra::new(3, ResidualDrift::Wandering), rows(n, 0.4));
        found.push(&x, 10.0);
        let freedom: f64 = found.bands.values().map(|b| b.freedom).sum();
        assert_eq!(freedom, n as f64);
        for (i, j) in [(0, 0), (0, 2), (1, 2)] {
            let all: f64 = found.bands.values().map(|b| b.products[place(3, i, j)]).sum();
            let expected: f64 = x.chunks(3).map(|row| row[i] * row[j]).sum();
            assert!((all - expected).abs() < 1e-9 * (1.0 + expected.abs()), "{n}: {all} {expected}");
        }
    }
}

#[test]
fn law_merging_and_selecting_equals_the_spectra_of_selected_rows() {
    let (mut one, mut other, mut cut) = (
        CrossSpectra::new(3, ResidualDrift::Wandering),
        CrossSpectra::new(3, ResidualDrift::Wandering),
        CrossSpectra::new(2, ResidualDrift::Wandering),
    );
    for (spectra, n, phase) in [(&mut one, 200, 0.0), (&mut other, 150, 1.0)] {
        spectra.push(&rows(n, phase), 10.0);
        let part: Vec<f64> = rows(n, phase).chunks(3).flat_map(|row| [row[2], 3.0 * row[0]]).collect();
        cut.push(&part, 10.0);
    }
    one.merge(&other);
    let found = one.select(&[(2, 1.0), (0, 3.0), (9, 1.0)]);
    for (a, b) in found.bands.values().zip(cut.bands.values()) {
        assert!(a.products.iter().zip(&b.products).all(|(x, y)| (x - y).abs() < 1e-9 * (1.0 + y.abs())));
    }
    assert_eq!(found.bands.len(), cut.bands.len());
}

/// Root mean square ratio of the scatter of the coefficient to its reported standard deviation, for one sinusoidal
/// term; `of` returns the noise of each run.
fn scatter(of: impl Fn(&mut NormalGenerator) -> Vec<f64>, f: f64) -> f64 {
    let (runs, n) = (300, 1000);
    let term: Vec<f64> = (0..n).map(|k| (f * k as f64).sin()).collect();
    let gain = 1.0 / term.iter().map(|x| x * x).sum::<f64>();
    let one = |run: u64| {
        let y = of(&mut NormalGenerator::new(run));
        let b = gain * term.iter().zip(&y).map(|(a, y)| a * y).sum::<f64>();
        let mut spectra = CrossSpectra::new(2, ResidualDrift::Wandering);
        spectra.push(&term.iter().zip(&y).flat_map(|(a, y)| [*a, *y]).collect::<Vec<f64>>(), 10.0);
        (b, spectra.covariance(&[b], &[gain], false).unwrap()[0])
    };
    let found: Vec<(f64, f64)> = (0..runs).map(one).collect();
    (found.iter().map(|(b, _)| b * b).sum::<f64>() / found.iter().map(|(_, v)| v).sum::<f64>()).sqrt()
}

#[test]
fn law_the_scatter_equals_the_reported_deviation_for_white_and_coloured_noise() {
    let white = |normals: &mut NormalGenerator| (0..1000).map(|_| normals.draw()).collect();
    let coloured = |normals: &mut NormalGenerator| {
        let mut x = 0.0;
        (0..1000)
            .map(|_| {
                x = 0.9 * x + normals.draw();
                x
            })
            .collect()
    };
    for f in [0.02, 0.2] {
        for found in [scatter(white, f), scatter(coloured, f)] {
            // 300 draws determine a standard deviation to 4 %.
            assert!((0.88..1.12).contains(&found), "{f}: {found}");
        }
    }
}

#[test]
fn law_slow_terms_with_a_drifting_residual_scatter_as_reported() {
    // Terms: the four headings of a box in turn, and a fast term.
    let n = 3000;
    let heading = |k: usize| (k / 750) as f64 * std::f64::consts::FRAC_PI_2;
    let terms: Vec<[f64; 4]> =
        (0..n).map(|k| [heading(k).cos(), heading(k).sin(), (0.09 * k as f64).sin(), 1.0]).collect();
    let a = nalgebra::DMatrix::from_fn(n, 4, |row, column| terms[row][column]);
    let gain = (a.transpose() * &a).try_inverse().unwrap();
    let walk = |normals: &mut NormalGenerator| {
        let mut x = 0.0;
        (0..n)
            .map(|_| {
                x += 0.1 * normals.draw();
                x + normals.draw()
            })
            .collect::<Vec<f64>>()
    };
    let white = |normals: &mut NormalGenerator| (0..n).map(|_| normals.draw()).collect::<Vec<f64>>();
    let ratios = |of: &dyn Fn(&mut NormalGenerator) -> Vec<f64>, ends: ResidualDrift| -> [f64; 3] {
        let (mut found, mut claimed) = ([0.0; 3], [0.0; 3]);
        for run in 0..200 {
            let y = of(&mut NormalGenerator::new(run));
            let b = &gain * a.transpose() * nalgebra::DVector::from_column_slice(&y);
            let mut spectra = CrossSpectra::new(5, ends);
            let rows: Vec<f64> = terms.iter().zip(&y).flat_map(|(row, y)| row.iter().copied().chain([*y])).collect();
            spectra.push(&rows, 10.0);
            let covariance = spectra.covariance(b.as_slice(), gain.as_slice(), false).unwrap();
            for term in 0..3 {
                found[term] += b[term] * b[term];
                claimed[term] += covariance[term * 5];
            }
        }
        std::array::from_fn(|term| f64::sqrt(found[term] / claimed[term]))
    };
    let known = ratios(&walk, ResidualDrift::Wandering);
    let plain = ratios(&walk, ResidualDrift::Bound);
    println!("scatter over claimed: {known:.2?}, {plain:.2?} without the ramp");
    // 200 draws determine a standard deviation to 5 %; the walk's increments have 8 degrees of freedom per run.
    assert!(known.iter().all(|ratio| (0.75..1.3).contains(ratio)), "{known:?}");
    assert!(plain[0] > 2.5 && plain[1] > 2.5, "{plain:?}");
    let steady = ratios(&white, ResidualDrift::Wandering);
    assert!(steady.iter().all(|ratio| (0.85..1.15).contains(ratio)), "{steady:?}");
}

#[test]
fn law_white_noise_has_the_covariance_of_independent_rows() {
    let mut normals = NormalGenerator::new(7);
    let x: Vec<f64> = (0..4000).flat_map(|_| [normals.draw(), normals.draw() + 5.0]).collect();
    let mut spectra = CrossSpectra::new(2, ResidualDrift::Wandering);
    spectra.push(&x, 10.0);
    let gain = 1.0 / 4000.0;
    let found = spectra.covariance(&[0.0], &[gain], true).unwrap()[0];
    assert!((found / gain - 1.0).abs() < 0.15, "{found}");
    assert!(spectra.covariance(&[0.0], &[gain], false).unwrap()[0] > found, "the mean of 5 counts without a constant");
    assert_eq!(spectra.covariance(&[], &[gain], true), None);
}
