//! Separate tests of kriging, likelihood, history, time update and resampling.

use crate::navigation::ins_error::InsGrade;
use crate::random::{NormalGenerator, SplitMix64};
use nalgebra::{DMatrix, DVector};

use super::super::fit::TrackMeasurements;
use super::super::history::ParticleHistory;
use super::super::index::SlamSampleIndex;
use super::super::kernel::{AnomalyKernel, BorderedCovariance, CovarianceFunction};
use super::super::particles::SlamParticles;
use super::super::samples::step_ends;
use super::flights::{ROUGH_DEG, loiter};
use crate::navigation::pinson::{ACC, GYRO, LAT, LON, S, STATES, TILT_N, VN};
use crate::navigation::transition::step_covariance;
use crate::navigation::{pinson_matrix, transition_matrix};

const COVARIANCES: [CovarianceFunction; 3] =
    [CovarianceFunction::Matern52, CovarianceFunction::Matern32, CovarianceFunction::SquaredExponential];

fn kernel(covariance: CovarianceFunction) -> AnomalyKernel {
    AnomalyKernel { covariance, ..AnomalyKernel::default() }
}

#[test]
fn law_kriging_is_the_conditional_mean_and_variance() {
    let mut normals = NormalGenerator::new(1);
    for (n, covariance) in [
        (1, CovarianceFunction::Matern52),
        (7, CovarianceFunction::Matern32),
        (24, CovarianceFunction::SquaredExponential),
    ] {
        let kernel = kernel(covariance);
        let at: Vec<[f64; 2]> = (0..=n).map(|_| [200.0 * normals.draw(), 200.0 * normals.draw()]).collect();
        let values: Vec<f64> = (0..n).map(|_| 50.0 * normals.draw()).collect();
        let of = |row: usize, column: usize| {
            let apart = (at[row][0] - at[column][0]).powi(2) + (at[row][1] - at[column][1]).powi(2);
            kernel.anomaly_nt2(apart) + if row == column && row < n { 4.0 } else { 0.0 }
        };
        let mut system = BorderedCovariance::new(n);
        system.fill(of, |place| values[place]);
        let found = system.solve().unwrap();
        let (k, cross) = (DMatrix::from_fn(n, n, of), DVector::from_fn(n, |row, _| of(row, n)));
        let weights = k.lu().solve(&cross).unwrap();
        let (mean, variance) = (weights.dot(&DVector::from_vec(values)), of(n, n) - weights.dot(&cross));
        // Two eliminations of a system with condition number 24·2500/4 keep eleven digits.
        assert!((found.value_nt - mean).abs() < 1e-8 && (found.variance_nt2 - variance).abs() < 1e-8);
    }
}

#[test]
fn law_one_sample_is_shrunk_as_in_the_closed_form() {
    let kernel = kernel(CovarianceFunction::SquaredExponential);
    let mut system = BorderedCovariance::new(1);
    let of = |row: usize, column: usize| kernel.anomaly_nt2(if row == column { 0.0 } else { 150.0_f64.powi(2) });
    system.fill(|row, column| of(row, column) + if row + column == 0 { 100.0 } else { 0.0 }, |_| 10.0);
    let found = system.solve().unwrap();
    // At a distance of one correlation length, the correlation is e^(-1/2).
    let share = 2500.0 * (-0.5_f64).exp() / 2600.0;
    assert!((found.value_nt - 10.0 * share).abs() < 1e-12);
    assert!((found.variance_nt2 - (2500.0 - share * 2500.0 * (-0.5_f64).exp())).abs() < 1e-9);
}

#[test]
fn unit_a_covariance_that_is_not_positive_has_no_prediction() {
    let mut system = BorderedCovariance::new(2);
    system.fill(|_, _| 1.0, |_| 0.0);
    assert!(system.solve().is_none());
    let mut system = BorderedCovariance::new(2);
    system.fill(|row, column| if row == column { f64::NAN } else { 0.0 }, |_| 0.0);
    assert!(system.solve().is_none());
}

#[test]
fn law_the_height_variance_is_the_laplacian_of_the_covariance() {
    for covariance in COVARIANCES {
        let kernel = kernel(covariance);
        // Covariance of the vertical derivative of a potential field: minus the Laplacian in the plane, which is twice
        // the second derivative along one axis. For a step of l/1500, the third-order term of the roughest kernel is
        // 1e-3 of it.
        let h = 0.1;
        let second = 2.0 * (kernel.anomaly_nt2(h * h) - kernel.anomaly_nt2(0.0)) / (h * h);
        let ratio = kernel.height_nt2(1.0) / (-2.0 * second);
        assert!((ratio - 1.0).abs() < 2e-3, "{covariance:?} {ratio}");
    }
}

fn track(kernel: &AnomalyKernel, temporal: (f64, f64), n: usize, seed: u64) -> TrackMeasurements {
    let mut normals = NormalGenerator::new(seed);
    let distance_m: Vec<f64> = (0..n).map(|k| 65.0 * k as f64).collect();
    let tt_s: Vec<f64> = (0..n).map(|k| k as f64).collect();
    let covariance = DMatrix::from_fn(n, n, |row, column| {
        let apart = distance_m[row] - distance_m[column];
        let white = if row == column { 1.0 + kernel.sigma_n_nt.powi(2) } else { 0.0 };
        kernel.anomaly_nt2(apart * apart)
            + temporal.0.powi(2) * (-(tt_s[row] - tt_s[column]).abs() / temporal.1).exp()
            + white
    });
    let draws = DVector::from_fn(n, |_, _| normals.draw());
    let value_nt = (covariance.cholesky().unwrap().l() * draws).add_scalar(1234.0).iter().copied().collect();
    TrackMeasurements { distance_m, tt_s, value_nt, variance_nt2: vec![1.0; n] }
}

#[test]
fn law_the_likelihood_equals_that_of_the_normal_distribution() {
    let (kernel, temporal, n) = (kernel(CovarianceFunction::Matern52), (3.0, 600.0), 30);
    let track = track(&kernel, temporal, n, 3);
    // Density as the product of the conditional densities, each from a separate system, at the most likely mean.
    let of = |row: usize, column: usize| {
        let apart = track.distance_m[row] - track.distance_m[column];
        let white = if row == column { 1.0 + kernel.sigma_n_nt.powi(2) } else { 0.0 };
        kernel.anomaly_nt2(apart * apart) + 9.0 * (-(track.tt_s[row] - track.tt_s[column]).abs() / 600.0).exp() + white
    };
    let inverse = DMatrix::from_fn(n, n, of).try_inverse().unwrap();
    let mean =
        (0..n).map(|row| inverse.row(row).iter().sum::<f64>() * track.value_nt[row]).sum::<f64>() / inverse.sum();
    let mut log = 0.0;
    for last in 0..n {
        let k = DMatrix::from_fn(last, last, of);
        let cross = DVector::from_fn(last, |row, _| of(row, last));
        let weights = if last == 0 { cross.clone() } else { k.lu().solve(&cross).unwrap() };
        let before = DVector::from_fn(last, |row, _| track.value_nt[row] - mean);
        let (residual, variance) =
            (track.value_nt[last] - mean - weights.dot(&before), of(last, last) - weights.dot(&cross));
        log -= 0.5 * (residual * residual / variance + variance.ln() + std::f64::consts::TAU.ln());
    }
    // Rounding of 30 systems.
    assert!((track.log_likelihood(&kernel, temporal) - log).abs() < 1e-6, "{log}");
}

#[test]
fn law_the_fit_is_the_maximum_and_near_the_truth() {
    let truth =
        AnomalyKernel { sigma_se_nt: 40.0, length_m: 400.0, sigma_n_nt: 2.0, covariance: CovarianceFunction::Matern52 };
    let temporal = (3.0, 600.0);
    let track = track(&truth, temporal, 150, 7);
    let start = AnomalyKernel { length_m: 150.0, sigma_n_nt: 1.0, ..truth };
    let found = track.fitted(&start, temporal).unwrap();
    let best = track.log_likelihood(&found, temporal);
    for sigma in [0.3, 0.6, 0.9, 1.1, 1.5, 3.0] {
        for length in [0.3, 0.6, 0.9, 1.0, 1.1, 1.5, 3.0] {
            for noise in [0.2, 0.8, 1.0, 1.2, 2.0] {
                let other = AnomalyKernel {
                    sigma_se_nt: sigma * found.sigma_se_nt,
                    length_m: length * found.length_m,
                    sigma_n_nt: noise * found.sigma_n_nt,
                    ..found
                };
                // The simplex stops at differences of 1e-5.
                assert!(track.log_likelihood(&other, temporal) < best + 1e-4, "{other:?}");
            }
        }
    }
    // The log-likelihood of the truth is below the maximum by half of a chi-square variable with three degrees of
    // freedom; with a probability of 99.9 % this is below 16.3/2.
    let below = best - track.log_likelihood(&truth, temporal);
    assert!((0.0..8.2).contains(&below), "{below}");
}

#[test]
fn unit_too_few_measurements_are_not_fitted() {
    let (kernel, temporal) = (AnomalyKernel::default(), (3.0, 600.0));
    assert_eq!(track(&kernel, temporal, 19, 1).fitted(&kernel, temporal), None);
    let mut flat = track(&kernel, temporal, 40, 1);
    flat.value_nt.fill(3.0);
    assert_eq!(flat.fitted(&kernel, temporal), None);
    let mut hovering = track(&kernel, temporal, 40, 1);
    hovering.distance_m.fill(0.0);
    assert_eq!(hovering.fitted(&kernel, temporal), None);
}

#[test]
fn unit_the_tree_has_the_same_paths_as_copying() {
    const N: usize = 60;
    let (mut history, mut copies, mut bits) = (ParticleHistory::new(N), vec![vec![]; N], SplitMix64::new(5));
    let mut now: Vec<[f32; 2]> = vec![[0.0; 2]; N];
    for step in 0..900 {
        for now in &mut now {
            *now = [now[0] + (bits.draw() >> 50) as f32, now[1] - (bits.draw() >> 50) as f32];
        }
        history.push(now.iter().copied());
        for (copy, now) in copies.iter_mut().zip(&now) {
            copy.push(*now);
        }
        // Sometimes twice in succession, and of all or only some particles.
        for again in 0..2 {
            if bits.draw() % 5 == 0 {
                let parent = |p: usize, draw: u64| {
                    if again == 0 || draw.is_multiple_of(2) { (draw >> 8) as usize % N } else { p }
                };
                let parents: Vec<u32> = (0..N).map(|p| parent(p, bits.draw()) as u32).collect();
                history.resample(&parents);
                copies = parents.iter().map(|parent| copies[*parent as usize].clone()).collect();
                now = parents.iter().map(|parent| now[*parent as usize]).collect();
            }
        }
        if step % 100 == 99 {
            for (particle, copy) in copies.iter().enumerate() {
                for (sample, at) in copy.iter().enumerate() {
                    assert_eq!(history.at(sample).unwrap().displacement(particle), at.map(f64::from));
                }
            }
            // A partition that becomes finer with time has at most N different stages.
            let (generations, stored) = history.size();
            assert!(generations <= N + 1, "{generations}");
            // Each old sample has one displacement.
            assert!(stored < 5 * history.len() + 20 * N, "{stored}");
        }
    }
    assert_eq!(history.len(), 900);
    assert!(history.at(900).is_none());
}

#[test]
fn unit_the_index_finds_the_same_samples_as_an_exhaustive_search() {
    let mut normals = NormalGenerator::new(4);
    let mut index = SlamSampleIndex::new(100.0, usize::MAX);
    let places: Vec<[f64; 2]> = (0..2000).map(|_| [800.0 * normals.draw(), 800.0 * normals.draw()]).collect();
    for (place, at) in places.iter().enumerate() {
        assert!(index.insert(place as u32, *at));
    }
    for radius in [0.0, 30.0, 250.0, 1e5] {
        let at = [50.0, -120.0];
        let mut found = vec![];
        index.within(at, radius, &mut found);
        let near = |p: &[f64; 2]| (p[0] - at[0]).powi(2) + (p[1] - at[1]).powi(2) <= radius * radius;
        let expected: Vec<u32> = (0..2000).filter(|place| near(&places[*place as usize])).collect();
        assert_eq!(found, expected);
    }
    let mut full = SlamSampleIndex::new(100.0, 3);
    assert_eq!([[0.0; 2]; 4].map(|at| full.insert(0, at)), [true, true, true, false]);
}

#[test]
fn law_without_measurements_the_particles_have_the_covariance_of_the_ins() {
    const N: usize = 20_000;
    let flight = loiter(ROUGH_DEG, 200, 1.0);
    let (ins, mut model) = (flight.series(), InsGrade::Tactical.model());
    model.sources.init_position_sigma_m = 30.0;
    let mut p = model.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]);
    let mut particles = SlamParticles::new(N, 8, &p);
    particles.draw(0);
    let (times, density) = (model.time_constants(), model.noise_density());
    for row in 1..ins.len() {
        let f = pinson_matrix(&ins.point(row - 1), &times, model.pinson);
        let phi = transition_matrix(&f, 1.0);
        let c = step_covariance(&particles.linear, &f, &phi, &density, 1.0, model.noise);
        particles.advance(&phi, &c, row as u64);
        p = step_covariance(&p, &f, &phi, &density, 1.0, model.noise);
    }
    let moments = particles.moments();
    for a in [LAT, LON, VN, VN + 1, TILT_N, TILT_N + 1, ACC, ACC + 1, GYRO, GYRO + 1, S] {
        for b in [LAT, LON, VN, VN + 1, TILT_N, ACC] {
            // Mean of N products of normals; the limit is 4.5 standard deviations, because 66 entries are compared.
            let scale = (p[a][a] * p[b][b]).sqrt();
            let off = (moments.p[a][b] - p[a][b]).abs() / scale;
            assert!(off < 4.5 * (2.0 / N as f64).sqrt(), "{a} {b} {off}");
        }
        assert!(moments.x[a].abs() < 4.5 * (p[a][a] / N as f64).sqrt(), "{a}");
    }
    // The path determines the velocity except for the noise of the last steps.
    assert!(particles.linear[VN][VN] < 1e-3 * p[VN][VN]);
    assert!((0..STATES).all(|state| particles.linear[LAT][state] == 0.0 && particles.linear[state][LON] == 0.0));
}

#[test]
fn law_resampling_copies_members_by_weight() {
    let initial = InsGrade::Magnav.model().initial_covariance(0.7, 300.0);
    let mut particles = SlamParticles::new(100, 1, &initial);
    particles.draw(0);
    let logs: Vec<f64> = (0..100).map(|k| f64::from(k) * 0.05).collect();
    assert!(particles.weigh(&logs));
    let (before, weights) = (particles.x.clone(), particles.weights.clone());
    let total: f64 = weights.iter().skip(40).sum();
    let parents = particles.resample(|particle| particle >= 40, 3);
    assert!((0..40).all(|particle| parents[particle] as usize == particle));
    for (source, weight) in weights.iter().enumerate().skip(40) {
        let copies = parents.iter().filter(|parent| **parent as usize == source).count() as f64;
        // Systematic resampling: the expected number of copies, rounded up or down.
        assert!((copies - 60.0 * weight / total).abs() < 1.0, "{source}");
    }
    assert!(particles.x.iter().zip(&parents).all(|(x, parent)| *x == before[*parent as usize]));
    assert!((particles.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    assert!((particles.weights[70] - total / 60.0).abs() < 1e-15);
    assert!(!particles.weigh(&[f64::NEG_INFINITY; 100]) && !particles.weigh(&[f64::NAN; 100]));
}

#[test]
fn unit_steps_end_at_the_interval_and_at_the_end() {
    let tt: Vec<f64> = (0..25).map(|k| 0.1 * f64::from(k)).collect();
    assert_eq!(step_ends(&tt, 1.0), [0, 10, 20, 24]);
    assert_eq!(step_ends(&[0.0, 5.0, 5.5, 6.5], 1.0), [0, 1, 3]);
    assert_eq!(step_ends(&[3.0], 1.0), [0]);
    assert_eq!(step_ends(&tt[..3], 0.0), [0, 1, 2]);
}
