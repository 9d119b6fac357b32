//! Manoeuvring flights over the Osborne map with an aircraft field, and a plain online filter for comparison.

use crate::compensation::tolles_lawson::{self, TermSelection};
use crate::earth::attitude::body_to_ned;
use crate::earth::core_field::CoreField;
use crate::earth::geodesy::EarthModel;
use crate::maps::{FieldMap, MapInterpolation, MapSurface};
use crate::navigation::osborne::{Line, core_field, grid};
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateVector};
use crate::navigation::{InsErrorModel, NavigationLine, simulate_ins_error};
use crate::random::NormalGenerator;
use crate::signal::gauss_markov::GaussMarkov;
use nalgebra::{DMatrix, DVector};
use std::sync::{Arc, OnceLock};

use super::super::{
    AircraftCoefficients, FixedLagMagnetometer, FixedLagOptions, FixedLagOutput, FixedLagParameters, run,
};

/// Map and core field.
pub struct Scene {
    pub surface: MapSurface,
    pub map: FieldMap,
    pub core: Arc<CoreField>,
}

pub fn scene() -> &'static Scene {
    static SCENE: OnceLock<Scene> = OnceLock::new();
    SCENE.get_or_init(|| {
        let surface = MapSurface::new(&grid().unwrap(), MapInterpolation::Cubic);
        Scene { map: FieldMap::Flat(surface.clone()), surface, core: Arc::new(core_field().unwrap()) }
    })
}

/// Residual that the linear model of the aircraft leaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Left {
    /// White noise alone.
    White,
    /// A drift of 30 nT with a time constant of 300 s.
    Drift,
    /// The drift, and currents that switch about every 200 s and step the field by 30 nT.
    Steps,
}

pub struct Flight {
    pub ins: Line,
    pub errors: Vec<StateVector>,
    /// One column per magnetometer.
    pub measured: Vec<Vec<f64>>,
    pub sigma: Vec<f64>,
    pub regressors: Vec<f64>,
    pub terms: usize,
    pub truth: Vec<Vec<f64>>,
    pub prior: Vec<f64>,
    pub left: GaussMarkov,
}

/// Standard deviations of the coefficients in nT: permanent, induced, eddy (of a difference per sample), bias.
pub fn prior_sigmas(dt_s: f64) -> Vec<f64> {
    [vec![2000.0; 3], vec![500.0; 6], vec![1000.0 / dt_s; 9], vec![500.0]].concat()
}

/// Flight of `samples` every `dt_s` with an aircraft field.
pub fn fly(seed: u64, samples: u32, dt_s: f64, magnetometers: usize, left: Left) -> Flight {
    let scene = scene();
    let truth = manoeuvred(samples, dt_s, 0.1 * seed as f64);
    let model = InsErrorModel::default();
    let mut normals = NormalGenerator::new(seed);
    let errors = simulate_ins_error(&truth.series(), &model, || normals.draw()).unwrap();
    let ins = truth.with_errors(&errors);
    let (regressors, terms) = regressors(&truth, &scene.core);
    let prior = prior_sigmas(dt_s);
    let mut flight = Flight {
        ins,
        errors,
        measured: vec![],
        sigma: vec![3.0; samples as usize],
        regressors,
        terms,
        truth: vec![],
        prior,
        left: GaussMarkov { sigma: if left == Left::White { 0.0 } else { 30.0 }, tau_s: 300.0 },
    };
    for _ in 0..magnetometers {
        let beta: Vec<f64> = flight.prior.iter().map(|sigma| sigma * normals.draw()).collect();
        let tt = &truth.columns[0];
        let mut nuisance =
            if left == Left::White { vec![0.0; tt.len()] } else { flight.left.realisation(tt, || normals.draw()) };
        if left == Left::Steps {
            let mut on = 0.0;
            for value in &mut nuisance {
                if normals.draw() > 2.6 {
                    on = if on == 0.0 { 30.0 } else { 0.0 };
                }
                *value += on;
            }
        }
        let rows = 0..samples as usize;
        let measured = rows.map(|row| {
            let [lat, lon, alt] = [1, 2, 3].map(|column: usize| truth.columns[column][row]);
            let field = scene.surface.at(lat, lon).unwrap().value_nt + scene.core.magnitude_nt(lat, lon, alt);
            let aircraft: f64 = flight.regressors[row * terms..].iter().zip(&beta).map(|(a, b)| a * b).sum();
            field + flight.errors[row][S] + aircraft + nuisance[row] + 3.0 * normals.draw()
        });
        flight.measured.push(measured.collect());
        flight.truth.push(beta);
    }
    flight
}

/// Flight with roll, pitch and yaw manoeuvres.
pub fn manoeuvred(samples: u32, dt_s: f64, phase_rad: f64) -> Line {
    let mut line = Line::flown(samples, dt_s, phase_rad).unwrap();
    for row in 0..samples as usize {
        let t = line.columns[0][row];
        line.columns[10][row] += 8.0 * (t / 1.9).sin() * (t / 60.0).sin();
        line.columns[11][row] += 4.0 * (t / 1.3).sin() * (t / 47.0).cos();
        line.columns[12][row] += 5.0 * (t / 2.3).sin() * (t / 71.0).sin();
    }
    line
}

fn regressors(line: &Line, core: &CoreField) -> (Vec<f64>, usize) {
    let rows = line.columns[0].len();
    let mut body = [vec![], vec![], vec![]];
    for row in 0..rows {
        let [lat, lon, alt, roll, pitch, yaw] = [1, 2, 3, 10, 11, 12].map(|column: usize| line.columns[column][row]);
        let ned = nalgebra::Vector3::from(core.field_ned_nt(lat, lon, alt));
        let b = body_to_ned(roll.to_radians(), pitch.to_radians(), yaw.to_radians()).transpose() * ned;
        (0..3).for_each(|axis| body[axis].push(b[axis]));
    }
    let terms = TermSelection::new(&["permanent", "induced", "eddy", "bias"]).unwrap();
    let [x, y, z] = &body;
    let field = tolles_lawson::BodyFieldColumns { x, y, z, bt: None };
    (tolles_lawson::matrix(&field, &terms, 50_000.0).unwrap(), terms.len())
}

impl Flight {
    pub fn line<'a>(&'a self, ins: &'a crate::navigation::InsSeries<'a>) -> NavigationLine<'a> {
        NavigationLine {
            ins,
            measurement_nt: &self.measured[0],
            sigma_nt: &self.sigma,
            map: &scene().map,
            core: Some(&scene().core),
            errors: InsErrorModel::default(),
            offset_window_s: 0.0,
            fixes: None,
            second_order: false,
        }
    }

    pub fn covariance(&self) -> Vec<f64> {
        let mut p = vec![0.0; self.terms * self.terms];
        self.prior.iter().enumerate().for_each(|(k, sigma)| p[k * (self.terms + 1)] = sigma * sigma);
        p
    }

    pub fn smoothed(&self, parameters: &FixedLagParameters, error: GaussMarkov) -> FixedLagOutput {
        let ins = self.ins.series();
        let line = self.line(&ins);
        let (covariance, zeros) = (self.covariance(), vec![0.0; self.terms]);
        let coefficients = AircraftCoefficients {
            regressors: &self.regressors,
            mean: &zeros,
            covariance: &covariance,
            walk_density: &zeros,
        };
        let mut magnetometers = vec![];
        for measured in &self.measured {
            magnetometers.push(FixedLagMagnetometer {
                measurement_nt: measured,
                sigma_nt: &self.sigma,
                coefficients,
                error,
            });
        }
        run(parameters, &line, &magnetometers, FixedLagOptions { states: true, covariance: true }).unwrap()
    }

    /// DRMS of estimated states, in metres.
    pub fn drms_m(&self, x: &[StateVector]) -> f64 {
        let earth = EarthModel::Wgs84;
        let square = |(row, (error, x)): (usize, (&StateVector, &StateVector))| {
            let lat = self.ins.columns[1][row].to_radians();
            let north = earth.lat_rad_to_north_m(error[LAT] - x[LAT], lat, 500.0);
            let east = earth.lon_rad_to_east_m(error[LON] - x[LON], lat, 500.0);
            north * north + east * east
        };
        let sum: f64 = self.errors.iter().zip(x).enumerate().map(square).sum();
        (sum / x.len() as f64).sqrt()
    }

    /// NEES of the position: chi-square with 2 degrees of freedom.
    pub fn nees(&self, output: &FixedLagOutput, row: usize) -> f64 {
        let (x, p) = (&output.navigation.x[row], &output.navigation.p[row]);
        let e = [self.errors[row][LAT] - x[LAT], self.errors[row][LON] - x[LON]];
        let (a, b, c) = (p[LAT][LAT], p[LAT][LON], p[LON][LON]);
        (c * e[0] * e[0] - 2.0 * b * e[0] * e[1] + a * e[1] * e[1]) / (a * c - b * b)
    }

    /// Plain online filter: 18 states and the coefficients of one magnetometer, the map linearised at the prediction,
    /// only white noise.
    pub fn online(&self) -> Vec<StateVector> {
        let ins = self.ins.series();
        let line = self.line(&ins);
        let mut field = line.predicted();
        let dim = STATES + self.terms;
        let mut x = DVector::<f64>::zeros(dim);
        let mut p = DMatrix::<f64>::zeros(dim, dim);
        let first = line.errors.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]);
        (0..STATES).for_each(|k| p[(k, k)] = first[k][k]);
        (0..self.terms).for_each(|k| p[(STATES + k, STATES + k)] = self.prior[k].powi(2));
        let mut out = vec![];
        for row in 0..ins.len() {
            if row > 0 {
                let step = line.step(row);
                let phi = DMatrix::from_fn(dim, dim, |i, j| match (i < STATES, j < STATES) {
                    (true, true) => step.phi[i][j],
                    _ => f64::from(u8::from(i == j)),
                });
                x = &phi * x;
                p = &phi * p * phi.transpose();
                (0..STATES).for_each(|i| (0..STATES).for_each(|j| p[(i, j)] += step.noise[i][j]));
            }
            if let Some(value) = field.at_error(&ins, row, [x[LAT], x[LON], x[ALT]]) {
                let a = &self.regressors[row * self.terms..(row + 1) * self.terms];
                let mut h = DVector::<f64>::zeros(dim);
                h[LAT] = value.d_lat_nt_per_rad;
                h[LON] = value.d_lon_nt_per_rad;
                h[ALT] = value.d_alt_nt_per_m;
                h[S] = 1.0;
                a.iter().enumerate().for_each(|(k, a)| h[STATES + k] = *a);
                let aircraft: f64 = a.iter().enumerate().map(|(k, a)| a * x[STATES + k]).sum();
                let residual = self.measured[0][row] - value.value_nt - x[S] - aircraft;
                let ph = &p * &h;
                let s = h.dot(&ph) + self.sigma[row].powi(2);
                let gain = &ph / s;
                x += &gain * residual;
                p -= &gain * ph.transpose();
                p = 0.5 * (&p + p.transpose());
            }
            out.push(std::array::from_fn(|k| x[k]));
        }
        out
    }
}
