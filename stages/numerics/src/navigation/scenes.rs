//! Short lines over analytic fields, and the dense least-squares solution of each line, for the tests of the filters.
#![allow(clippy::unwrap_used)]

use crate::earth::geodesy::EarthModel;
use crate::maps::map_stack::FieldMap;
use crate::maps::map_surface::{GeographicGrid, MapInterpolation, MapSurface};
use crate::navigation::ins_error::InsErrorModel;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::NavigationError;
use crate::navigation::pinson::{ALT, LAT, LON, S, STATES, StateMatrix, StateVector};
use crate::navigation::position_fixes::PositionFixes;
use nalgebra::{DMatrix, DVector, SMatrix, SVector};

pub(crate) type DenseStateMatrix = SMatrix<f64, STATES, STATES>;
pub(crate) type DenseStateVector = SVector<f64, STATES>;

pub(crate) fn dense(p: &StateMatrix) -> DenseStateMatrix {
    DenseStateMatrix::from_fn(|row, column| p[row][column])
}

/// Short line and its map; owns the data.
#[derive(Clone)]
pub(crate) struct AnalyticScene {
    pub(crate) columns: [Vec<f64>; 13],
    pub(crate) measurement_nt: Vec<f64>,
    pub(crate) sigma_nt: Vec<f64>,
    pub(crate) map: FieldMap,
    pub(crate) errors: InsErrorModel,
    pub(crate) fixes: Option<PositionFixes>,
}

pub(crate) const LAT_DEG: f64 = 45.0;
pub(crate) const LON_DEG: f64 = -76.0;

/// Metres of a degree north and east at the middle of the scene.
pub(crate) fn m_per_deg() -> (f64, f64) {
    let (north, east) = EarthModel::Wgs84.north_east_m_per_rad(LAT_DEG.to_radians(), 500.0);
    (north / 1_f64.to_degrees(), east / 1_f64.to_degrees())
}

impl AnalyticScene {
    /// Flight north-eastward at 67 m/s over a field, in nT, that is given as a function of the metres north and east of
    /// the middle. The map extends 7 km from the middle in each direction, with nodes 100 m apart. The truth is 40 m
    /// north and 60 m west of the INS, and the noise is a wave of 3 nT.
    pub(crate) fn new(tt: &[f64], interpolation: MapInterpolation, field_nt: impl Fn(f64, f64) -> f64) -> Self {
        let (north, east) = m_per_deg();
        let axis = |middle: f64, m_per_deg: f64| -> Vec<f64> {
            (-70..=70).map(|k| middle + 100.0 * f64::from(k) / m_per_deg).collect()
        };
        let (lat, lon) = (axis(LAT_DEG, north), axis(LON_DEG, east));
        let mut nodes = vec![];
        for lat in &lat {
            nodes.extend(lon.iter().map(|lon| field_nt((lat - LAT_DEG) * north, (lon - LON_DEG) * east)));
        }
        let surface = MapSurface::new(&GeographicGrid::new(&lat, &lon, &nodes).unwrap(), interpolation);
        let of = |f: &dyn Fn(f64) -> f64| -> Vec<f64> { tt.iter().map(|t| f(*t)).collect() };
        let middle = tt[tt.len() - 1] / 2.0;
        let columns = [
            tt.to_vec(),
            of(&|t| LAT_DEG + 60.0 * (t - middle) / north),
            of(&|t| LON_DEG + 30.0 * (t - middle) / east),
            of(&|t| 500.0 + 0.1 * t),
            of(&|_| 60.0),
            of(&|_| 30.0),
            of(&|_| -0.1),
            of(&|t| 0.3 + 0.01 * t.sin()),
            of(&|_| -0.2),
            of(&|_| -9.81),
            of(&|t| t.cos()),
            of(&|_| 1.5),
            of(&|_| 26.6),
        ];
        let at = |row: usize| surface.at(columns[1][row] + 40.0 / north, columns[2][row] - 60.0 / east);
        let measurement_nt =
            (0..tt.len()).map(|row| at(row).unwrap().value_nt + 3.0 * (1.7 * row as f64).sin()).collect();
        let mut errors = InsErrorModel::default();
        errors.sources.init_position_sigma_m = 100.0;
        errors.sources.init_velocity_sigma_mps = 0.3;
        Self {
            sigma_nt: vec![5.0; tt.len()],
            columns,
            measurement_nt,
            map: FieldMap::Flat(surface),
            errors,
            fixes: None,
        }
    }

    pub(crate) fn series(&self) -> InsSeries<'_> {
        InsSeries::from_columns(self.columns.each_ref().map(Vec::as_slice))
    }

    pub(crate) fn with<T>(&self, of: impl FnOnce(&NavigationLine<'_>) -> T) -> T {
        let ins = self.series();
        of(&NavigationLine {
            ins: &ins,
            measurement_nt: &self.measurement_nt,
            sigma_nt: &self.sigma_nt,
            map: &self.map,
            core: None,
            errors: self.errors,
            offset_window_s: 0.0,
            fixes: self.fixes.as_ref(),
            second_order: false,
        })
    }
}

/// Positions 30 m north and 50 m west of an INS at every seventh sample from the third on. Every second position has no
/// height. Standard deviations are 20 and 30 m.
pub(crate) fn positions(columns: &[Vec<f64>; 13]) -> PositionFixes {
    let (north, east) = m_per_deg();
    let at = |every: usize, values: &[f64], shift: f64| -> Vec<f64> {
        let of = |(row, value): (usize, &f64)| if row % every == 2 { value + shift } else { f64::NAN };
        values.iter().enumerate().map(of).collect()
    };
    PositionFixes {
        lat_deg: at(7, &columns[1], 30.0 / north),
        lon_deg: at(7, &columns[2], -50.0 / east),
        alt_m: at(14, &columns[3], 12.0),
        horizontal_sigma_m: 20.0,
        vertical_sigma_m: 30.0,
    }
}

pub(crate) fn plane(north: f64, east: f64) -> f64 {
    0.05 * north - 0.03 * east
}

pub(crate) fn hills(north: f64, east: f64) -> f64 {
    60.0 * (north / 900.0).sin() + 40.0 * (east / 700.0 + north / 1500.0).cos()
}

/// Times, in seconds, that are not evenly spaced.
pub(crate) fn uneven(rows: usize) -> Vec<f64> {
    (0..rows).map(|row| 0.9 * row as f64 + 0.4 * (row as f64).sin()).collect()
}

/// Joint normal distribution of the states of all samples given all measurements. It is computed by dense least squares
/// in the space of the measurements, x = C Hᵀ (H C Hᵀ + R)⁻¹ z, with the prior covariance C of all states.
pub(crate) struct DenseBatchSmoother {
    /// Φ and the prior covariance of each sample.
    prior: Vec<(DenseStateMatrix, DenseStateMatrix)>,
    pub(crate) x: Vec<DenseStateVector>,
    pub(crate) p: Vec<DenseStateMatrix>,
    /// x₀ᵀ P₀⁻¹ x₀ + Σ wᵀ Q⁻¹ w.
    pub(crate) motion: f64,
}

impl DenseBatchSmoother {
    pub(crate) fn new(line: &NavigationLine<'_>) -> Self {
        let ins = line.ins;
        let first = line.errors.initial_covariance(ins.lat_deg[0].to_radians(), ins.alt_m[0]);
        let mut prior = vec![(DenseStateMatrix::identity(), dense(&first))];
        for row in 1..ins.len() {
            let step = line.step(row);
            let (phi, before) = (dense(&step.phi), prior[row - 1].1);
            prior.push((phi, phi * before * phi.transpose() + dense(&step.noise)));
        }
        let (x, p) = (vec![DenseStateVector::zeros(); ins.len()], vec![]);
        Self { prior, x, p, motion: 0.0 }
    }

    /// Covariances of every state with H x of a row.
    fn with_measurement(&self, row: usize, h: &DenseStateVector) -> Vec<DenseStateVector> {
        let mut all = vec![DenseStateVector::zeros(); self.prior.len()];
        let mut a = *h;
        for k in (0..=row).rev() {
            all[k] = self.prior[k].1 * a;
            a = self.prior[k].0.transpose() * a;
        }
        for k in row + 1..all.len() {
            all[k] = self.prior[k].0 * all[k - 1];
        }
        all
    }

    /// Solves with the map linearised along the last solution, and with weights from the residuals of that solution.
    pub(crate) fn solve(&mut self, line: &NavigationLine<'_>, weight: impl Fn(f64) -> f64) {
        let mut field = line.predicted();
        let (mut rows, mut columns, mut values, mut variances) = (vec![], vec![], vec![], vec![]);
        for row in 0..self.x.len() {
            for fix in line.fixes_at(row).into_iter().flatten() {
                let mut h = DenseStateVector::zeros();
                h[fix.state] = 1.0;
                values.push(fix.error);
                variances.push(fix.variance);
                columns.push(self.with_measurement(row, &h));
                rows.push((row, h));
            }
            let x = self.x[row];
            let Some((measured, variance)) = line.measured(row, 0.0) else { continue };
            let Some(value) = field.at_error(line.ins, row, [x[LAT], x[LON], x[ALT]]) else { continue };
            let mut h = DenseStateVector::zeros();
            (h[LAT], h[LON], h[ALT], h[S]) =
                (value.d_lat_nt_per_rad, value.d_lon_nt_per_rad, value.d_alt_nt_per_m, 1.0);
            let residual = measured - value.value_nt - x[S];
            values.push(residual + h.dot(&x));
            variances.push(variance / weight(residual / variance.sqrt()));
            columns.push(self.with_measurement(row, &h));
            rows.push((row, h));
        }
        // The measurements have different units, so each is divided by its standard deviation.
        let n = rows.len();
        for (place, variance) in variances.iter().enumerate() {
            let weight = 1.0 / variance.sqrt();
            values[place] *= weight;
            rows[place].1 *= weight;
            columns[place].iter_mut().for_each(|column| *column *= weight);
        }
        let covariance = DMatrix::from_fn(n, n, |i, j| rows[i].1.dot(&columns[j][rows[i].0]));
        let sum = &covariance + DMatrix::identity(n, n);
        let inverse = sum.cholesky().unwrap().inverse();
        let dual = &inverse * DVector::from_vec(values);
        self.motion = dual.dot(&(&covariance * &dual));
        self.p.clear();
        for (k, x) in self.x.iter_mut().enumerate() {
            let c = DMatrix::from_fn(STATES, n, |state, j| columns[j][k][state]);
            *x = DenseStateVector::from_iterator((&c * &dual).iter().copied());
            let less = &c * &inverse * c.transpose();
            self.p.push(self.prior[k].1 - DenseStateMatrix::from_fn(|row, column| less[(row, column)]));
        }
    }
}

/// Asserts that two distributions agree within a fraction of the standard deviations of the second.
pub(crate) fn assert_close(
    x: &StateVector,
    p: &StateMatrix,
    with: (&DenseStateVector, &DenseStateMatrix),
    part: f64,
    place: &str,
) {
    let (expected_x, expected_p) = with;
    for row in 0..STATES {
        let sigma = expected_p[(row, row)].sqrt();
        let difference = (x[row] - expected_x[row]).abs() / sigma;
        assert!(difference < part, "{place}, state {row}: {difference:e} sigma");
        for column in 0..STATES {
            let size = sigma * expected_p[(column, column)].sqrt();
            let difference = (p[row][column] - expected_p[(row, column)]).abs() / size;
            assert!(difference < part, "{place}, covariance {row} {column}: {difference:e}");
        }
    }
}

/// Asserts that invalid lines are rejected with their messages.
pub(crate) fn assert_refusals(run: impl Fn(&AnalyticScene) -> Option<NavigationError>) {
    let scene = AnalyticScene::new(&uneven(20), MapInterpolation::Linear, plane);
    assert_eq!(run(&scene), None);
    let message = |spoil: fn(&mut AnalyticScene)| {
        let mut scene = scene.clone();
        spoil(&mut scene);
        run(&scene).unwrap().to_string()
    };
    assert!(message(|scene| scene.columns[5][12] = f64::NAN).starts_with("column `ins_ve` is NaN in row 12"));
    assert!(message(|scene| scene.columns[0][3] = 0.2).starts_with("time does not ascend"));
    assert!(message(|scene| scene.sigma_nt.truncate(3)).starts_with("column `measurement sigma` has 3 rows"));
    assert!(message(|scene| scene.columns[7][11] = 1e200).starts_with("the filter diverged at row 12"));
    assert!(message(|scene| scene.errors.fogm_tau_s = 0.0).starts_with("`fogm_tau_s` must be above 0"));
}
