#![allow(clippy::unwrap_used)]
//! Compares the filters to filters without further measurements, to a dense filter, and to flights with known truth.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector, Vector3};

use super::*;
use crate::earth::attitude::{body_to_ned, tilted};
use crate::earth::core_field::CoreField;
use crate::earth::geodesy::EarthModel;
use crate::maps::MapInterpolation;
use crate::maps::map_stack::FieldMap;
use crate::maps::map_surface::{GeographicGrid, MapSurface, VerticalDerivative};
use crate::navigation::ekf::{self, EkfInput, EkfParameters};
use crate::navigation::iekf::{self, IekfParameters};
use crate::navigation::ins_series::InsSeries;
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, TILT_N};
use crate::navigation::scenes::{AnalyticScene, LAT_DEG, LON_DEG, hills, positions, uneven};
use crate::navigation::ukf;
use crate::signal::gauss_markov::GaussMarkov;

mod exact;
mod flights;
mod latency;
mod map_height;
mod others;
mod particles;

const ROWS: usize = 60;

fn scene(field_nt: fn(f64, f64) -> f64) -> AnalyticScene {
    let mut scene = AnalyticScene::new(&uneven(ROWS), MapInterpolation::Cubic, field_nt);
    scene.measurement_nt[20..30].fill(f64::NAN);
    scene.fixes = Some(positions(&scene.columns));
    scene
}

fn keep(linearisation: Linearisation) -> AidedParameters {
    AidedParameters { linearisation, keep_states: true, keep_covariance: true, ..AidedParameters::default() }
}

/// Largest difference of states, covariances and innovations, in standard deviations.
fn difference(one: &NavigationOutput, other: &NavigationOutput) -> f64 {
    let mut largest = 0.0_f64;
    for row in 0..one.x.len() {
        let sigma = |state: usize| other.p[row][state][state].sqrt();
        for a in 0..STATES {
            largest = largest.max((one.x[row][a] - other.x[row][a]).abs() / sigma(a));
            for b in 0..STATES {
                let off = (one.p[row][a][b] - other.p[row][a][b]).abs();
                largest = largest.max(off / (sigma(a) * sigma(b)));
            }
        }
        assert_eq!(one.nis[row].is_nan(), other.nis[row].is_nan(), "{row}");
        if !one.nis[row].is_nan() {
            largest = largest.max((one.nis[row].sqrt() - other.nis[row].sqrt()).abs());
        }
    }
    largest
}

#[test]
fn law_without_further_measurements_it_equals_each_filter() {
    scene(hills).with(|line| {
        let by = |linearisation| run(line, &Aids::default(), &keep(linearisation)).unwrap().navigation;
        let of_ekf =
            EkfParameters { errors: line.errors, keep_states: true, keep_covariance: true, ..EkfParameters::default() };
        let point = EkfInput {
            parameters: &of_ekf,
            measurement_nt: line.measurement_nt,
            sigma_nt: Some(line.sigma_nt),
            fixes: line.fixes,
            map: line.map,
            core: line.core,
        };
        let ekf = ekf::run_together(line.ins, &[point]).pop().unwrap().unwrap();
        // The only difference is rounding, because the dense covariance uses another order of sums.
        let off = difference(&by(Linearisation::Once), &ekf);
        assert!(off < 1e-7, "ekf: {off:e}");
        let of_iekf = IekfParameters { keep_covariance: true, ..IekfParameters::default() };
        let iekf = iekf::run(line, &of_iekf).unwrap().line;
        let off = difference(&by(Linearisation::Iterated { iterations: 5, tolerance_m: 0.1 }), &iekf);
        assert!(off < 1e-7, "iekf: {off:e}");
        let of_ukf = UkfParameters { keep_covariance: true, ..UkfParameters::default() };
        let ukf = ukf::run(&of_ukf, line).unwrap().navigation;
        let off = difference(&by(Linearisation::Unscented(of_ukf)), &ukf);
        assert!(off < 1e-7, "ukf: {off:e}");
        assert!(difference(&by(Linearisation::Once), &iekf) > 1e-3, "the filters are not the same");
    });
}

/// A bowl, whose slope is linear in the position.
fn bowl(north: f64, east: f64) -> f64 {
    0.03 * north + 2e-5 * north * north - 1.5e-5 * east * east + 1e-5 * north * east
}

/// The bowl on a map of 520 m with a vertical slope that changes from place to place.
fn bowl_in_height() -> FieldMap {
    let (north, east) = crate::navigation::scenes::m_per_deg();
    let axis = |middle: f64, m_per_deg: f64| -> Vec<f64> {
        (-70..=70).map(|k| middle + 100.0 * f64::from(k) / m_per_deg).collect()
    };
    let at = |lat: f64, lon: f64| [(lat - LAT_DEG) * north, (lon - LON_DEG) * east];
    let (lat, lon) = (axis(LAT_DEG, north), axis(LON_DEG, east));
    let places: Vec<[f64; 2]> = lat.iter().flat_map(|lat| lon.iter().map(|lon| at(*lat, *lon))).collect();
    let nodes: Vec<f64> = places.iter().map(|[north, east]| bowl(*north, *east)).collect();
    let d_alt_nt_per_m: Vec<f64> = places.iter().map(|[north, east]| -0.4 + 3e-4 * north - 2e-4 * east).collect();
    let vertical = VerticalDerivative { d_alt_nt_per_m: &d_alt_nt_per_m, alt_m: 520.0 };
    let grid = GeographicGrid::new(&lat, &lon, &nodes).unwrap();
    FieldMap::Flat(MapSurface::with_vertical(&grid, vertical, MapInterpolation::Cubic).unwrap())
}

/// Readings of the further measurements.
struct Read {
    difference_nt: Vec<f64>,
    field_nt: [Vec<f64>; 3],
    alt_m: Vec<f64>,
    core: Arc<CoreField>,
}

const BASELINE_M: [f64; 3] = [9.0, 4.0, -1.0];

fn read(scene: &AnalyticScene) -> Read {
    let wave = |row: usize, by: f64| (by * row as f64).sin();
    let of = |f: &dyn Fn(usize) -> f64| (0..ROWS).map(f).collect::<Vec<f64>>();
    let core = Arc::new(CoreField::at(2024.5).unwrap());
    let columns = &scene.columns;
    let body = |row: usize| {
        let [roll, pitch, yaw] = [10, 11, 12].map(|column: usize| columns[column][row].to_radians());
        let ned = Vector3::from(core.field_ned_nt(columns[1][row], columns[2][row], columns[3][row]));
        tilted(&body_to_ned(roll, pitch, yaw), &Vector3::new(1e-4, -2e-4, 1.5e-4)).transpose() * ned
    };
    Read {
        difference_nt: of(&|row| if row % 9 == 4 { f64::NAN } else { 0.4 + 0.2 * wave(row, 2.1) }),
        field_nt: [0, 1, 2].map(|axis| {
            of(&|row| if row % 11 == 5 { f64::NAN } else { body(row)[axis] + 20.0 * wave(row, 1.3 + axis as f64) })
        }),
        alt_m: of(&|row| if row % 5 == 3 { f64::NAN } else { columns[3][row] + 4.0 + wave(row, 0.7) }),
        core,
    }
}

fn aids(read: &Read) -> Aids<'_> {
    Aids {
        difference: Some(DifferenceAid {
            difference_nt: &read.difference_nt,
            sigma_nt: 0.1,
            baseline_m: BASELINE_M,
            slope: SlopeError::default(),
            bias: GaussMarkov { sigma: 0.5, tau_s: 300.0 },
        }),
        vector: Some(VectorAid {
            field_nt: read.field_nt.each_ref().map(Vec::as_slice),
            sigma_nt: 15.0,
            bias: GaussMarkov { sigma: 40.0, tau_s: 1000.0 },
            crustal_sigma_nt: 30.0,
            crustal_length_m: 2000.0,
            core: &read.core,
        }),
        height: Some(HeightAid { alt_m: &read.alt_m, sigma_m: 2.0, bias: GaussMarkov { sigma: 5.0, tau_s: 600.0 } }),
        map_error: Some(MapErrorProcess { sigma_nt: 4.0, length_m: 300.0 }),
        permanent: None,
        latency_sigma_s: None,
        map_height_sigma_m: None,
        flat_over_m: None,
    }
}

/// Kalman filter of all states in dense matrices, whose rows of H are numerical derivatives of the functions below.
struct Dense<'a> {
    line: &'a NavigationLine<'a>,
    read: &'a Read,
    x: DVector<f64>,
    p: DMatrix<f64>,
}

/// Further states: magnetometer difference, height, map error, height bias on the map, three biases of the vector, and
/// three components of the crustal field.
const FURTHER: usize = 10;
const DIM: usize = STATES + FURTHER;

impl Dense<'_> {
    fn place(&self, row: usize, x: &DVector<f64>) -> (f64, f64, f64) {
        let ins = self.line.ins;
        let (lat, lon) = (ins.lat_deg[row] + x[LAT].to_degrees(), ins.lon_deg[row] + x[LON].to_degrees());
        (lat, lon, ins.alt_m[row] + x[ALT])
    }

    fn map_nt(&self, (lat, lon, alt): (f64, f64, f64)) -> f64 {
        self.line.map.at(lat, lon, alt).unwrap().value_nt
    }

    fn rotation(&self, row: usize, x: &DVector<f64>) -> nalgebra::Matrix3<f64> {
        let [roll, pitch, yaw] = self.line.ins.point(row).euler_rad;
        tilted(&body_to_ned(roll, pitch, yaw), &Vector3::new(x[TILT_N], x[TILT_N + 1], x[TILT_N + 2]))
    }

    fn scalar(&self, row: usize, x: &DVector<f64>) -> f64 {
        let (lat, lon, alt) = self.place(row, x);
        self.map_nt((lat, lon, alt + x[STATES + 3])) + x[S] + x[STATES + 2]
    }

    fn difference(&self, row: usize, x: &DVector<f64>) -> f64 {
        let (lat, lon, alt) = self.place(row, x);
        let arm = self.rotation(row, x) * Vector3::from(BASELINE_M) / 2.0;
        let ins = self.line.ins;
        let (north, east) = EarthModel::Wgs84.north_east_m_per_rad(ins.lat_deg[row].to_radians(), ins.alt_m[row]);
        let (dlat, dlon) = ((arm.x / north).to_degrees(), (arm.y / east).to_degrees());
        self.map_nt((lat + dlat, lon + dlon, alt - arm.z)) - self.map_nt((lat - dlat, lon - dlon, alt + arm.z))
            + x[STATES]
    }

    fn vector(&self, row: usize, axis: usize, x: &DVector<f64>) -> f64 {
        let (lat, lon, alt) = self.place(row, x);
        let core = Vector3::from(self.read.core.field_ned_nt(lat, lon, alt));
        let crustal = Vector3::new(x[STATES + 7], x[STATES + 8], x[STATES + 9]);
        let ned = core + core.normalize() * (self.map_nt((lat, lon, alt)) + x[S]) + crustal;
        (self.rotation(row, x).transpose() * ned)[axis] + x[STATES + 4 + axis]
    }

    /// Corrects with measurements whose predictions are functions of the state, all at once.
    fn correct(
        &mut self,
        row: usize,
        measured: &[f64],
        sigma: f64,
        predict: impl Fn(&Self, usize, &DVector<f64>) -> f64,
    ) {
        if measured.iter().any(|value| value.is_nan()) {
            return;
        }
        let _ = row;
        let n = measured.len();
        let steps: Vec<f64> = (0..DIM).map(|k| 1e-2 * self.p[(k, k)].sqrt()).collect();
        let mut h = DMatrix::zeros(n, DIM);
        let mut residual = DVector::zeros(n);
        for one in 0..n {
            residual[one] = measured[one] - predict(self, one, &self.x);
            for k in (0..DIM).filter(|k| steps[*k] > 0.0) {
                let (mut ahead, mut behind) = (self.x.clone(), self.x.clone());
                ahead[k] += steps[k];
                behind[k] -= steps[k];
                h[(one, k)] = (predict(self, one, &ahead) - predict(self, one, &behind)) / (2.0 * steps[k]);
            }
        }
        let s = &h * &self.p * h.transpose() + DMatrix::identity(n, n) * sigma * sigma;
        let gain = &self.p * h.transpose() * s.try_inverse().unwrap();
        self.x += &gain * residual;
        let rest = DMatrix::identity(DIM, DIM) - &gain * h;
        self.p = &rest * &self.p * rest.transpose() + &gain * gain.transpose() * sigma * sigma;
    }

    fn propagate(&mut self, row: usize, lasting: &[(f64, f64)]) {
        let (phi, q) = transition(self.line, row, lasting);
        self.x = &phi * &self.x;
        self.p = &phi * &self.p * phi.transpose() + q;
    }
}

/// Φ and Q of a step with Gauss-Markov states of these standard deviations and times.
fn transition(line: &NavigationLine<'_>, row: usize, lasting: &[(f64, f64)]) -> (DMatrix<f64>, DMatrix<f64>) {
    let step = line.step(row);
    let (mut phi, mut q) = (DMatrix::zeros(DIM, DIM), DMatrix::zeros(DIM, DIM));
    for i in 0..STATES {
        for j in 0..STATES {
            (phi[(i, j)], q[(i, j)]) = (step.phi[i][j], step.noise[i][j]);
        }
    }
    for (k, (sigma, tau_s)) in lasting.iter().enumerate() {
        let decay = (-step.dt_s / tau_s).exp();
        phi[(STATES + k, STATES + k)] = decay;
        q[(STATES + k, STATES + k)] = sigma * sigma * (1.0 - decay * decay);
    }
    (phi, q)
}

#[test]
fn law_all_measurements_together_equal_a_dense_filter_with_numerical_derivatives() {
    let scene = AnalyticScene { fixes: None, map: bowl_in_height(), ..scene(bowl) };
    let read = read(&scene);
    scene.with(|line| {
        let all = Aids { map_height_sigma_m: Some(30.0), ..aids(&read) };
        let found = run(line, &all, &keep(Linearisation::Once)).unwrap();
        // At 60 m/s north and 30 m/s east.
        let speed = 60_f64.hypot(30.0);
        let along = |sigma: f64, length_m: f64| (sigma, length_m / speed);
        let bias = (40.0, 1000.0);
        let crustal = along(30.0, 2000.0);
        let height = (30.0, f64::INFINITY);
        let of_vector = [bias, bias, bias, crustal, crustal, crustal];
        let scalars = [(0.5, 300.0), (5.0, 600.0), along(4.0, 300.0), height];
        let lasting = [&scalars[..], &of_vector].concat();
        let mut p = DMatrix::zeros(DIM, DIM);
        let first = line.errors.initial_covariance(line.ins.lat_deg[0].to_radians(), line.ins.alt_m[0]);
        (0..STATES).for_each(|k| p[(k, k)] = first[k][k]);
        lasting.iter().enumerate().for_each(|(k, (sigma, _))| p[(STATES + k, STATES + k)] = sigma * sigma);
        let mut dense = Dense { line, read: &read, x: DVector::zeros(DIM), p };
        for row in 0..ROWS {
            if row > 0 {
                dense.propagate(row, &lasting);
            }
            dense.correct(row, &[line.measurement_nt[row]], 5.0, |of, _, x| of.scalar(row, x));
            dense.correct(row, &[read.difference_nt[row]], 0.1, |of, _, x| of.difference(row, x));
            let field = read.field_nt.each_ref().map(|column| column[row]);
            dense.correct(row, &field, 15.0, |of, axis, x| of.vector(row, axis, x));
            let error_m = read.alt_m[row] - line.ins.alt_m[row];
            dense.correct(row, &[error_m], 2.0, |_, _, x| x[ALT] + x[STATES + 1]);
            let (x, p) = (&found.navigation.x[row], &found.navigation.p[row]);
            for a in 0..STATES {
                let sigma = dense.p[(a, a)].sqrt();
                let off = (x[a] - dense.x[a]).abs() / sigma;
                // The first-order tilt has an error of 1e-3 nT of 50,000.
                assert!(off < 1e-3, "{row}, state {a}: {off:e}");
                for (b, entries) in p.iter().enumerate() {
                    let off = (entries[a] - dense.p[(a, b)]).abs() / (sigma * dense.p[(b, b)].sqrt());
                    assert!(off < 1e-3, "{row}, covariance {a} {b}: {off:e}");
                }
            }
            let ([bias_m, sigma_m], state) = (found.map_height_m.each_ref().map(|of| of[row]), STATES + 3);
            let expected_m = dense.p[(state, state)].sqrt();
            assert!((bias_m - dense.x[state]).abs() / expected_m < 1e-3, "{row}: {bias_m}");
            assert!((sigma_m / expected_m - 1.0).abs() < 1e-3, "{row}: {sigma_m}");
        }
        assert!(found.map_height_m[1][ROWS - 1] < 25.0, "the height bias is observed");
        let without = Aids { difference: None, ..all };
        let without = run(line, &without, &keep(Linearisation::Once)).unwrap().navigation;
        let area = |of: &NavigationOutput| of.sd_n_m[ROWS - 1] * of.sd_e_m[ROWS - 1];
        assert!(area(&found.navigation) < area(&without));
        let alone = run(line, &Aids::default(), &keep(Linearisation::Once)).unwrap().navigation;
        let heading = |of: &NavigationOutput| of.p[ROWS - 1][TILT_N + 2][TILT_N + 2].sqrt();
        assert!(heading(&found.navigation) < heading(&alone));
    });
}

#[test]
fn law_on_a_flat_map_only_the_temporal_variation_is_corrected() {
    // The slope is 0.05 nT/m north and 0.03 nT/m east: 5 nT correspond to 86 m.
    let scene = AnalyticScene { fixes: None, ..scene(crate::navigation::scenes::plane) };
    scene.with(|line| {
        let over = |flat_m: f64| {
            run(line, &Aids { flat_over_m: Some(flat_m), ..Aids::default() }, &keep(Linearisation::Once)).unwrap()
        };
        let usual = run(line, &Aids::default(), &keep(Linearisation::Once)).unwrap();
        let slope = usual.slope_nt_per_m[10];
        // A degree has a different length there than in the middle of the scene.
        assert!((slope - 0.05_f64.hypot(0.03)).abs() < 1e-5, "{slope}");
        let (steep, flat) = (over(90.0), over(80.0));
        assert_eq!((steep.flat(), flat.flat()), (0, ROWS - 10));
        assert_eq!(steep.navigation.x, usual.navigation.x);
        let free = crate::navigation::ins_only::run(line.ins, &line.errors, None).unwrap();
        for row in 0..ROWS {
            assert!((flat.navigation.sd_n_m[row] / free.sd_n_m[row] - 1.0).abs() < 1e-9, "{row}");
            assert_eq!(flat.navigation.lat_deg[row], free.lat_deg[row]);
        }
        let sigma = |of: &AidedOutput| of.navigation.p[ROWS - 1][S][S].sqrt();
        assert!(sigma(&flat) < line.errors.fogm_sigma_nt && sigma(&flat) > sigma(&usual), "{}", sigma(&flat));
        assert!(flat.usage[25] == SampleUsage::Missing && flat.navigation.nis[5].is_finite());
    });
}

#[test]
fn unit_each_measurement_can_be_missing_separately() {
    let scene = scene(bowl);
    let read = read(&scene);
    scene.with(|line| {
        let found = run(line, &aids(&read), &keep(Linearisation::Once)).unwrap();
        for row in 0..ROWS {
            assert_eq!(found.aids.difference.nis[row].is_nan(), row % 9 == 4);
            assert_eq!(found.aids.vector.nis[row].is_nan(), row % 11 == 5);
            assert_eq!(found.aids.height.nis[row].is_nan(), row % 5 == 3);
        }
        // Rows without the scalar field use the other measurements.
        assert!(found.usage.iter().all(|usage| *usage == SampleUsage::Used), "{:?}", found.usage);
        assert_eq!(found.navigation.report.updates, ROWS);
        assert_eq!(found.navigation.nis[25], found.aids.difference.nis[25]);
        // The gate rejects only the spike.
        let mut spiked = read.difference_nt.clone();
        spiked[12] += 1e4;
        let mut with_spike = aids(&read);
        with_spike.difference = with_spike.difference.map(|of| DifferenceAid { difference_nt: &spiked, ..of });
        let gate = AidedParameters { gate_nis: Some(50.0), ..keep(Linearisation::Once) };
        let gated = run(line, &with_spike, &gate).unwrap();
        assert!(gated.aids.difference.nis[12] > 50.0 && gated.usage[12] == SampleUsage::Used);
        assert!((gated.navigation.x[ROWS - 1][LAT] - found.navigation.x[ROWS - 1][LAT]).abs() < 1e-6);
    });
}

#[test]
fn unit_invalid_measurements_are_rejected() {
    let scene = scene(bowl);
    let read = read(&scene);
    let refused = |change: &dyn Fn(&mut Aids)| {
        let mut wrong = aids(&read);
        change(&mut wrong);
        scene.with(|line| run(line, &wrong, &keep(Linearisation::Once)).unwrap_err().to_string())
    };
    fn of<'a, 'b>(aids: &'b mut Aids<'a>) -> &'b mut DifferenceAid<'a> {
        aids.difference.as_mut().unwrap()
    }
    assert!(refused(&|aids| of(aids).sigma_nt = 0.0).contains("`gradient_sigma_nt` must be"));
    assert!(refused(&|aids| of(aids).baseline_m = [0.0; 3]).contains("`gradient_baseline_m` must be"));
    assert!(refused(&|aids| of(aids).baseline_m[1] = f64::NAN).contains("`gradient_baseline_m` must be"));
    assert!(refused(&|aids| of(aids).difference_nt = &[]).contains("column `difference` has 0 rows"));
    assert!(refused(&|aids| of(aids).bias.tau_s = 0.0).contains("gradient_bias_tau_s"));
    assert!(refused(&|aids| aids.height.as_mut().unwrap().sigma_m = -1.0).contains("height_sigma_m"));
    assert!(refused(&|aids| aids.vector.as_mut().unwrap().crustal_length_m = 0.0).contains("vector_crustal_length_m"));
    assert!(refused(&|aids| aids.flat_over_m = Some(f64::NAN)).contains("flat_over_m"));
    let iterated = AidedParameters {
        linearisation: Linearisation::Iterated { iterations: 0, tolerance_m: 0.1 },
        ..keep(Linearisation::Once)
    };
    let fault = scene.with(|line| run(line, &Aids::default(), &iterated).unwrap_err().to_string());
    assert!(fault.contains("iterations"), "{fault}");
    crate::navigation::scenes::assert_refusals(|scene| {
        scene.with(|line| run(line, &Aids::default(), &keep(Linearisation::Once)).err())
    });
}
