//! Comparison with the joint distribution of all states of a line, conditioned on all its measurements at once.

use crate::maps::{FieldMap, GeographicGrid, MapInterpolation, MapSurface};
use crate::navigation::pinson::{LAT, LON, S, STATES};
use crate::navigation::{InsErrorModel, InsErrors, InsSeries, NavigationLine};
use crate::random::NormalGenerator;
use crate::signal::gauss_markov::GaussMarkov;
use nalgebra::{DMatrix, DVector};

use super::super::{
    AircraftCoefficients, FixedLagMagnetometer, FixedLagOptions, FixedLagOutput, FixedLagParameters, run,
};
use super::flights::manoeuvred;

const SAMPLES: usize = 40;
const TERMS: usize = 4;
const DIM: usize = STATES + 2 + 2 * TERMS;

/// Plane map, a line with uneven steps, and two magnetometers with random regressors.
struct Linear {
    columns: [Vec<f64>; 13],
    map: FieldMap,
    measured: [Vec<f64>; 2],
    sigma: Vec<f64>,
    regressors: [Vec<f64>; 2],
    mean: Vec<f64>,
    covariance: Vec<f64>,
    walk: Vec<f64>,
    errors: [GaussMarkov; 2],
}

fn linear() -> Linear {
    let mut normals = NormalGenerator::new(5);
    let mut columns = manoeuvred(SAMPLES as u32, 1.0, 0.4).columns;
    // Every fourth step is 1.5 times as long.
    (0..SAMPLES).for_each(|row| columns[0][row] += 0.5 * (row / 4) as f64);
    let axis = |middle: f64| [middle - 0.5, middle, middle + 0.5];
    let (lat, lon) = (axis(columns[1][0]), axis(columns[2][0]));
    let nodes: Vec<f64> =
        lat.iter().flat_map(|lat| lon.map(|lon| 4000.0 * (lat + 21.0) - 2500.0 * (lon - 140.0))).collect();
    let map =
        FieldMap::Flat(MapSurface::new(&GeographicGrid::new(&lat, &lon, &nodes).unwrap(), MapInterpolation::Linear));
    let root = DMatrix::from_fn(TERMS, TERMS, |_, _| 300.0 * normals.draw());
    let covariance = &root * root.transpose();
    let covariance = 0.5 * (&covariance + covariance.transpose());
    let mut random = |count: usize, size: f64| -> Vec<f64> { (0..count).map(|_| size * normals.draw()).collect() };
    Linear {
        map,
        measured: [random(SAMPLES, 300.0), random(SAMPLES, 300.0)],
        sigma: vec![2.0; SAMPLES],
        regressors: [random(SAMPLES * TERMS, 1.0), random(SAMPLES * TERMS, 1.0)],
        mean: random(TERMS, 100.0),
        covariance: covariance.as_slice().to_vec(),
        walk: vec![0.0, 1.0, 0.0, 0.3],
        errors: [GaussMarkov { sigma: 8.0, tau_s: 7.0 }, GaussMarkov { sigma: 3.0, tau_s: 40.0 }],
        columns,
    }
}

impl Linear {
    fn ins(&self) -> InsSeries<'_> {
        InsSeries::from_columns(self.columns.each_ref().map(Vec::as_slice))
    }

    fn line<'a>(&'a self, ins: &'a InsSeries<'a>) -> NavigationLine<'a> {
        let sources = InsErrors { init_position_sigma_m: 50.0, init_velocity_sigma_mps: 1.0, ..InsErrors::default() };
        NavigationLine {
            ins,
            measurement_nt: &self.measured[0],
            sigma_nt: &self.sigma,
            map: &self.map,
            core: None,
            errors: InsErrorModel::from_sources(sources),
            offset_window_s: 0.0,
            fixes: None,
            second_order: false,
        }
    }

    fn magnetometers(&self) -> Vec<FixedLagMagnetometer<'_>> {
        let of = |k: usize| FixedLagMagnetometer {
            measurement_nt: &self.measured[k],
            sigma_nt: &self.sigma,
            coefficients: AircraftCoefficients {
                regressors: &self.regressors[k],
                mean: &self.mean,
                covariance: &self.covariance,
                walk_density: &self.walk,
            },
            error: self.errors[k],
        };
        vec![of(0), of(1)]
    }

    fn smoothed(&self, window_s: f64, overlap: f64, lag_s: f64) -> FixedLagOutput {
        let parameters = FixedLagParameters {
            window_s,
            overlap,
            lag_s,
            measurement_interval_s: 0.0,
            ..FixedLagParameters::default()
        };
        let ins = self.ins();
        let keep = FixedLagOptions { states: true, covariance: true };
        run(&parameters, &self.line(&ins), &self.magnetometers(), keep).unwrap()
    }
}

/// Joint distribution of the states of all samples, and the measurements as rows of a matrix.
struct Joint {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    h: DMatrix<f64>,
    /// Measurement minus the map at the INS, and its variance.
    z: DVector<f64>,
    variance: f64,
}

impl Joint {
    fn of(linear: &Linear) -> Self {
        let ins = linear.ins();
        let line = linear.line(&ins);
        let mut covariance = DMatrix::zeros(DIM * SAMPLES, DIM * SAMPLES);
        let mut mean = DVector::zeros(DIM * SAMPLES);
        let mut block = DMatrix::zeros(DIM, DIM);
        let first = line.errors.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]);
        (0..STATES).for_each(|k| block[(k, k)] = first[k][k]);
        for of in 0..2 {
            block[(STATES + of, STATES + of)] = linear.errors[of].sigma.powi(2);
            let at = STATES + 2 + of * TERMS;
            let prior = DMatrix::from_row_slice(TERMS, TERMS, &linear.covariance);
            block.view_mut((at, at), (TERMS, TERMS)).copy_from(&prior);
            for row in 0..SAMPLES {
                (0..TERMS).for_each(|k| mean[row * DIM + at + k] = linear.mean[k]);
            }
        }
        covariance.view_mut((0, 0), (DIM, DIM)).copy_from(&block);
        for row in 1..SAMPLES {
            let step = line.step(row);
            let mut phi = DMatrix::identity(DIM, DIM);
            (0..STATES).for_each(|i| (0..STATES).for_each(|j| phi[(i, j)] = step.phi[i][j]));
            let mut q = DMatrix::zeros(DIM, DIM);
            (0..STATES).for_each(|i| (0..STATES).for_each(|j| q[(i, j)] = step.noise[i][j]));
            for of in 0..2 {
                let decay = (-step.dt_s / linear.errors[of].tau_s).exp();
                phi[(STATES + of, STATES + of)] = decay;
                q[(STATES + of, STATES + of)] = linear.errors[of].sigma.powi(2) * (1.0 - decay * decay);
                for k in 0..TERMS {
                    let at = STATES + 2 + of * TERMS + k;
                    q[(at, at)] = linear.walk[k] * step.dt_s;
                }
            }
            let before = covariance.view(((row - 1) * DIM, 0), (DIM, row * DIM)).clone_owned();
            let cross = &phi * before;
            covariance.view_mut((row * DIM, 0), (DIM, row * DIM)).copy_from(&cross);
            covariance.view_mut((0, row * DIM), (row * DIM, DIM)).copy_from(&cross.transpose());
            block = &phi * block * phi.transpose() + q;
            covariance.view_mut((row * DIM, row * DIM), (DIM, DIM)).copy_from(&block);
        }
        let mut h = DMatrix::zeros(2 * SAMPLES, DIM * SAMPLES);
        let mut z = DVector::zeros(2 * SAMPLES);
        for row in 0..SAMPLES {
            let value = linear.map.at(ins.lat_deg[row], ins.lon_deg[row], ins.alt_m[row]).unwrap();
            for of in 0..2 {
                let (at, first) = (2 * row + of, row * DIM);
                h[(at, first + LAT)] = value.d_lat_nt_per_rad;
                h[(at, first + LON)] = value.d_lon_nt_per_rad;
                h[(at, first + S)] = 1.0;
                h[(at, first + STATES + of)] = 1.0;
                let a = &linear.regressors[of][row * TERMS..];
                (0..TERMS).for_each(|k| h[(at, first + STATES + 2 + of * TERMS + k)] = a[k]);
                z[at] = linear.measured[of][row] - value.value_nt;
            }
        }
        Self { mean, covariance, h, z, variance: linear.sigma[0].powi(2) }
    }

    /// States of a sample given the measurements of all samples before `until`.
    fn given(&self, sample: usize, until: usize) -> (DVector<f64>, DMatrix<f64>) {
        let h = self.h.rows(0, 2 * until);
        let innovation = self.z.rows(0, 2 * until) - h * &self.mean;
        let s = h * &self.covariance * h.transpose() + DMatrix::identity(2 * until, 2 * until) * self.variance;
        let cross = self.covariance.rows(sample * DIM, DIM) * h.transpose();
        let factor = s.cholesky().unwrap();
        let x = self.mean.rows(sample * DIM, DIM) + &cross * factor.solve(&innovation);
        let prior = self.covariance.view((sample * DIM, sample * DIM), (DIM, DIM));
        let p = prior - &cross * factor.solve(&cross.transpose());
        (x, p)
    }

    /// Largest difference in the 18 states of a sample and in the covariance of the states, in standard deviations.
    fn difference(&self, output: &FixedLagOutput, sample: usize, until: usize) -> f64 {
        let (x, p) = self.given(sample, until);
        let (found_x, found_p) = (&output.navigation.x[sample], &output.navigation.p[sample]);
        let mut largest: f64 = 0.0;
        for i in 0..STATES {
            largest = largest.max((found_x[i] - x[i]).abs() / p[(i, i)].sqrt());
            for j in 0..STATES {
                largest = largest.max((found_p[i][j] - p[(i, j)]).abs() / (p[(i, i)] * p[(j, j)]).sqrt());
            }
        }
        largest
    }

    /// Largest difference of the final coefficients, in standard deviations.
    fn difference_of_coefficients(&self, output: &FixedLagOutput) -> f64 {
        let (x, p) = self.given(SAMPLES - 1, SAMPLES);
        let (first, count) = (STATES + 2, 2 * TERMS);
        let mut largest: f64 = 0.0;
        for i in 0..count {
            let sigma = p[(first + i, first + i)].sqrt();
            largest = largest.max((output.coefficients[i] - x[first + i]).abs() / sigma);
            for j in 0..count {
                let scale = sigma * p[(first + j, first + j)].sqrt();
                let found = output.coefficient_covariance[i * count + j];
                largest = largest.max((found - p[(first + i, first + j)]).abs() / scale);
            }
        }
        largest
    }
}

// The variances of positions decrease by 1e3 and the variances of coefficients by 1e5. Of 16 digits, the difference in
// a smoothed covariance retains more than 9, as does the dense solution.
const TOLERANCE: f64 = 1e-6;

#[test]
fn law_one_window_equals_least_squares_of_all_states() {
    let linear = linear();
    let joint = Joint::of(&linear);
    let output = linear.smoothed(1000.0, 0.0, 1000.0);
    assert_eq!(output.windows.len(), 1);
    assert_eq!((output.windows[0].iterations, output.windows[0].converged), (1, true), "{:?}", output.windows[0]);
    for sample in 0..SAMPLES {
        let difference = joint.difference(&output, sample, SAMPLES);
        assert!(difference < TOLERANCE, "{sample} {difference:e}");
    }
    let difference = joint.difference_of_coefficients(&output);
    assert!(difference < TOLERANCE, "{difference:e}");
    // The minimum of the cost is half the sum of the squared innovations, normalised by their covariance.
    let innovation = &joint.z - &joint.h * &joint.mean;
    let s = &joint.h * &joint.covariance * joint.h.transpose()
        + DMatrix::identity(2 * SAMPLES, 2 * SAMPLES) * joint.variance;
    let chi_square = innovation.dot(&s.cholesky().unwrap().solve(&innovation));
    assert!((output.windows[0].chi_square / chi_square - 1.0).abs() < 1e-9, "{:?} {chi_square}", output.windows[0]);
}

#[test]
fn law_overlapping_windows_count_no_measurement_twice() {
    let linear = linear();
    let joint = Joint::of(&linear);
    let tt_s = &linear.columns[0];
    let last_s = tt_s[SAMPLES - 1];
    let until = |end_s: f64| tt_s.iter().filter(|tt_s| **tt_s < end_s - 1e-6).count();
    for (window_s, overlap, lag_s) in [(12.0, 0.5, 0.0), (12.0, 0.5, 8.0), (15.0, 0.8, 3.0), (10.0, 0.0, 4.0)] {
        let output = linear.smoothed(window_s, overlap, lag_s);
        let stride_s = window_s * (1.0 - overlap);
        assert_eq!(output.windows.len(), (last_s / stride_s).floor() as usize + 1);
        for (sample, now_s) in tt_s.iter().enumerate() {
            let seen_s = now_s + lag_s;
            // The estimate from the last window that contains the sample and ends within the lag; otherwise the filter
            // estimate at the sample.
            let ends = (1..=output.windows.len()).rev().map(|k| k as f64 * stride_s);
            let last = ends.into_iter().find(|end_s| end_s.min(last_s) <= seen_s + 1e-6 && *end_s > now_s + 1e-6);
            let seen = last.map_or(sample + 1, until);
            let difference = joint.difference(&output, sample, seen);
            assert!(difference < TOLERANCE, "{window_s} {overlap} {lag_s}: {sample} {seen} {difference:e}");
        }
        let difference = joint.difference_of_coefficients(&output);
        assert!(difference < TOLERANCE, "{window_s} {overlap} {lag_s}: {difference:e}");
    }
}

#[test]
fn law_innovations_equal_those_of_the_filter() {
    let linear = linear();
    let joint = Joint::of(&linear);
    let output = linear.smoothed(12.0, 0.5, 8.0);
    for sample in 1..SAMPLES {
        let (x, p) = joint.given(sample, sample);
        let h = joint.h.view((2 * sample, sample * DIM), (2, DIM));
        let residual = joint.z.rows(2 * sample, 2) - h * x;
        let s = h * p * h.transpose() + DMatrix::identity(2, 2) * joint.variance;
        let nis = residual.dot(&s.cholesky().unwrap().solve(&residual)) / 2.0;
        assert!((output.navigation.residual_nt[sample] - residual[0]).abs() < 1e-6 * residual[0].abs().max(1.0));
        assert!((output.navigation.nis[sample] / nis - 1.0).abs() < 1e-6, "{sample}");
    }
}
