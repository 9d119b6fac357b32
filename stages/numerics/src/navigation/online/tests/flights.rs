//! Turning flight with terms of the aircraft field, and the maps of the flight.

use std::f64::consts::TAU;

use crate::compensation::tolles_lawson::{BodyFieldColumns, DEFAULT_SCALE_NT, TermSelection, matrix};
use crate::earth::attitude::body_to_ned;
use crate::maps::{FieldMap, GeographicGrid, MapInterpolation, MapSurface};
use crate::navigation::aids::Aids;
use crate::navigation::{InsErrorModel, InsSeries};
use crate::random::NormalGenerator;
use nalgebra::Vector3;

use super::super::{CoefficientPrior, LineModel, OnlineMagnetometer, OnlineOutput};

pub(crate) const ROWS: usize = 230;

/// Map for a flight of 230 samples, from -74.91° to `east_deg`.
fn map_of(east_deg: f64, value: impl Fn(f64, f64) -> f64) -> FieldMap {
    let columns = ((east_deg + 74.91) / 0.001).round();
    let lat: Vec<f64> = (0..30).map(|k| 40.09 + 0.001 * f64::from(k)).collect();
    let lon: Vec<f64> = (0..columns as i32).map(|k| -74.91 + 0.001 * f64::from(k)).collect();
    let values: Vec<f64> = lat.iter().flat_map(|lat| lon.iter().map(|lon| value(*lat, *lon))).collect();
    FieldMap::Flat(MapSurface::new(&GeographicGrid::new(&lat, &lon, &values).unwrap(), MapInterpolation::Linear))
}

pub(crate) fn wavy(east_deg: f64) -> FieldMap {
    map_of(east_deg, |lat, lon| 80.0 * (700.0 * lat).sin() + 60.0 * (500.0 * lon).cos())
}

/// Plane with a slope of about 0.05 nT/m.
pub(crate) fn sloping() -> FieldMap {
    map_of(-74.85, |lat, lon| 5000.0 * (lat - 40.1) - 3000.0 * (lon + 74.9))
}

/// 23 s of a turning flight with two gaps in the times. The magnetometers measure the field of the map and of the
/// aircraft; there is no temporal variation.
#[derive(Clone)]
pub(crate) struct Flight {
    pub(crate) columns: [Vec<f64>; 13],
    pub(crate) errors: InsErrorModel,
    pub(crate) vector_nt: [Vec<f64>; 3],
    /// Number of terms.
    pub(crate) width: usize,
    /// Terms by magnetometer.
    pub(crate) terms: Vec<Vec<f64>>,
    pub(crate) coefficients: Vec<Vec<f64>>,
    pub(crate) measurement_nt: Vec<Vec<f64>>,
    pub(crate) sigma_nt: Vec<Vec<f64>>,
}

fn columns() -> [Vec<f64>; 13] {
    let of = |f: &dyn Fn(f64) -> f64| (0..ROWS).map(|k| f(k as f64)).collect::<Vec<f64>>();
    let late = |k: f64| if k > 150.0 { 3.0 } else { 0.0 } + if k > 90.0 { 0.4 } else { 0.0 };
    [
        of(&|k| 0.1 * k + late(k)),
        of(&|k| 40.1 + 6e-5 * k),
        of(&|k| -74.9 + 7e-5 * k),
        of(&|k| 400.0 + (0.05 * k).sin()),
        of(&|k| 63.0 + 0.1 * k),
        of(&|k| 57.0 - 0.05 * k),
        of(&|k| (0.1 * k).cos()),
        of(&|k| 0.01 * k),
        of(&|k| -0.02 * k),
        of(&|_| -9.80665),
        of(&|k| 20.0 * (TAU * k / 47.0).sin()),
        of(&|k| 12.0 * (TAU * k / 31.0).sin()),
        of(&|k| 40.0 + 1.4 * k),
    ]
}

impl Flight {
    /// Flight with `magnetometers` magnetometers of permanent, induced and eddy terms, with coefficients of tens of nT.
    pub(crate) fn turning(map: &FieldMap, magnetometers: usize) -> Self {
        let columns = columns();
        let earth = Vector3::new(20_000.0, -4000.0, 48_000.0);
        let mut vector_nt: [Vec<f64>; 3] = Default::default();
        for (row, _) in columns[0].iter().enumerate() {
            let [roll, pitch, yaw] = [10, 11, 12].map(|column: usize| columns[column][row].to_radians());
            let body = body_to_ned(roll, pitch, yaw).transpose() * earth;
            (0..3).for_each(|axis| vector_nt[axis].push(body[axis]));
        }
        let [x, y, z] = &vector_nt;
        let terms = TermSelection::new(&["permanent", "induced", "eddy"]).unwrap();
        let a = matrix(&BodyFieldColumns { x, y, z, bt: None }, &terms, DEFAULT_SCALE_NT).unwrap();
        let mut flight = Self {
            columns,
            errors: InsErrorModel::default(),
            vector_nt,
            width: 18,
            terms: vec![],
            coefficients: vec![vec![]; magnetometers],
            measurement_nt: vec![vec![]; magnetometers],
            sigma_nt: (0..magnetometers).map(|k| vec![2.0 + k as f64; ROWS]).collect(),
        };
        flight.replace_terms(map, &a, 18, 30.0);
        flight
    }

    /// Replaces terms and measurements, using coefficients of this standard deviation.
    pub(crate) fn replace_terms(&mut self, map: &FieldMap, terms: &[f64], width: usize, sigma: f64) {
        self.width = width;
        self.terms = vec![terms.to_vec(); self.coefficients.len()];
        let mut normals = NormalGenerator::new(3);
        for magnetometer in 0..self.coefficients.len() {
            self.coefficients[magnetometer] = (0..width).map(|_| sigma * normals.draw()).collect();
            let aircraft_nt = self.aircraft(magnetometer);
            let mut measured_nt = vec![];
            for (row, own_nt) in aircraft_nt.iter().enumerate() {
                let [lat, lon, alt] = [1, 2, 3].map(|column: usize| self.columns[column][row]);
                let field_nt = map.at(lat + 1e-5, lon - 1e-5, alt).map_or(0.0, |field| field.value_nt);
                measured_nt.push(field_nt + own_nt + self.sigma_nt[magnetometer][row] * normals.draw());
            }
            self.measurement_nt[magnetometer] = measured_nt;
        }
    }

    /// Line whose INS has the lifetime of the test.
    pub(crate) fn line<'a>(&self, map: &'a FieldMap) -> LineModel<'a> {
        let columns: &'static [Vec<f64>; 13] = Box::leak(Box::new(self.columns.clone()));
        let ins = Box::leak(Box::new(InsSeries::from_columns(columns.each_ref().map(Vec::as_slice))));
        LineModel {
            ins,
            map,
            core: None,
            errors: self.errors,
            offset_window_s: 0.0,
            fixes: None,
            aids: Aids::default(),
            second_order: false,
        }
    }

    pub(crate) fn magnetometer<'a>(
        &'a self,
        k: usize,
        prior: &'a CoefficientPrior,
        walk_density: &'a [f64],
    ) -> OnlineMagnetometer<'a> {
        let (measurement_nt, sigma_nt, terms) = (&self.measurement_nt[k], &self.sigma_nt[k], &self.terms[k]);
        OnlineMagnetometer { measurement_nt, sigma_nt, terms, prior, walk_density }
    }

    pub(crate) fn prior(&self, k: usize, sigma: f64) -> CoefficientPrior {
        CoefficientPrior::independent(&vec![0.1 * k as f64; self.width], &vec![sigma; self.width])
    }

    pub(crate) fn aircraft(&self, k: usize) -> Vec<f64> {
        let product = |row: &[f64]| row.iter().zip(&self.coefficients[k]).map(|(a, b)| a * b).sum();
        self.terms[k].chunks_exact(self.width).map(product).collect()
    }

    pub(crate) fn compensated(&self, k: usize) -> Vec<f64> {
        self.measurement_nt[k].iter().zip(self.aircraft(k)).map(|(measured, aircraft)| measured - aircraft).collect()
    }
}

/// All numbers of an output, as bits.
pub(crate) fn bits(output: &OnlineOutput) -> Vec<u64> {
    let track = &output.navigation;
    let x = track.x.as_flattened().iter();
    let p = track.p.as_flattened().as_flattened().iter();
    let mut all: Vec<u64> = x.chain(p).chain(&track.nis).chain(&track.residual_nt).map(|v| v.to_bits()).collect();
    for estimate in &output.magnetometers {
        let columns = [&estimate.coefficients_by_row, &estimate.sigma_by_row, &estimate.covariance];
        all.extend(columns.into_iter().flatten().chain(&estimate.track.aircraft_nt).map(|v| v.to_bits()));
    }
    all
}
