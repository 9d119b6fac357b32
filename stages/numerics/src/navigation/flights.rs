//! Simulated flights over the Osborne map with known truth, and error statistics for the tests of the filters.
#![allow(clippy::unwrap_used)]

use std::sync::{Arc, OnceLock};

use crate::earth::core_field::CoreField;
use crate::earth::geodesy::EarthModel;
use crate::maps::continuation::{MAGNAV_ALPHA_M2, MapDerivative, MapSpectrum, Padding};
use crate::maps::map_stack::{FieldMap, MapStack, StackOptions};
use crate::maps::map_surface::{GeographicGrid, MapInterpolation, MapSurface};
use crate::navigation::crlb::{self, TruePath};
use crate::navigation::ekf::{self, EkfParameters};
use crate::navigation::ins_error::{InsErrorModel, simulate_ins_error};
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::NavigationLine;
use crate::navigation::osborne::{Line, core_field, grid, temporal_nt};
use crate::navigation::output::{NavigationError, NavigationOutput};
use crate::navigation::pinson::{MAGNAV_POSITION, STATES, StateVector};
use crate::navigation::ukf::{self, UkfOutput, UkfParameters};
use crate::random::NormalGenerator;
use nalgebra::{Matrix2, Vector2};

/// Osborne map, and core field of the flights over this map.
pub(crate) struct OsborneWorld {
    pub(crate) map: FieldMap,
    pub(crate) core: Arc<CoreField>,
}

pub(crate) fn world() -> &'static OsborneWorld {
    static WORLD: OnceLock<OsborneWorld> = OnceLock::new();
    WORLD.get_or_init(|| OsborneWorld {
        map: FieldMap::Flat(MapSurface::new(&grid().unwrap(), MapInterpolation::Cubic)),
        core: Arc::new(core_field().unwrap()),
    })
}

/// Osborne map at heights from 400 to 700 m, continued upward from the lowest.
pub(crate) fn levels() -> &'static FieldMap {
    static LEVELS: OnceLock<FieldMap> = OnceLock::new();
    LEVELS.get_or_init(|| {
        let grid = grid().unwrap();
        let plane = grid.plane();
        let spectrum = MapSpectrum::new(&plane, 300.0, &Padding::default()).unwrap();
        let (mut heights_m, mut maps, mut slopes) = (vec![], vec![], vec![]);
        for up_m in (0..=6).map(|level| 50.0 * f64::from(level)) {
            heights_m.push(400.0 + up_m);
            maps.push(grid.with_values(spectrum.at_height(up_m, MAGNAV_ALPHA_M2).unwrap().values).unwrap());
            slopes.push(spectrum.derivative(MapDerivative::Up, up_m, MAGNAV_ALPHA_M2).unwrap().values);
        }
        let options = StackOptions { interpolation: MapInterpolation::Cubic, ..StackOptions::default() };
        FieldMap::Stack(MapStack::with_vertical(&heights_m, &maps, &slopes, options).unwrap())
    })
}

/// Flight with its truth, its INS, the INS errors and the noise-free field in nT.
pub(crate) struct OsborneFlight {
    pub(crate) truth: Line,
    pub(crate) ins: Line,
    pub(crate) errors: Vec<StateVector>,
    pub(crate) field_nt: Vec<f64>,
    /// Error model of the filter.
    pub(crate) model: InsErrorModel,
}

impl OsborneFlight {
    /// Flight of a seed, with `samples` every `dt_s`.
    pub(crate) fn flown(seed: u64, samples: u32, dt_s: f64, model: InsErrorModel) -> Self {
        let truth = Line::flown(samples, dt_s, 0.1 * seed as f64).unwrap();
        let mut normals = NormalGenerator::new(seed);
        let errors = simulate_ins_error(&truth.series(), &model, || normals.draw()).unwrap();
        let OsborneWorld { map, core } = world();
        let field = |(row, error): (usize, &StateVector)| {
            let [lat, lon, alt] = [1, 2, 3].map(|column: usize| truth.columns[column][row]);
            map.at(lat, lon, alt).unwrap().value_nt + core.magnitude_nt(lat, lon, alt) + temporal_nt(error)
        };
        let field_nt = errors.iter().enumerate().map(field).collect();
        let ins = truth.with_errors(&errors);
        Self { truth, ins, errors, field_nt, model }
    }

    /// Readings of a magnetometer with white noise of this standard deviation.
    pub(crate) fn measured(&self, seed: u64, sigma_nt: f64) -> Vec<f64> {
        let mut normals = NormalGenerator::new(seed);
        self.field_nt.iter().map(|field| field + sigma_nt * normals.draw()).collect()
    }

    /// Readings of a magnetometer with white noise of this standard deviation. Each sample was measured `delay_s`
    /// before its time stamp.
    pub(crate) fn late_nt(&self, delay_s: f64, seed: u64, sigma_nt: f64) -> Vec<f64> {
        let (OsborneWorld { map, core }, columns) = (world(), &self.truth.columns);
        let mut normals = NormalGenerator::new(seed);
        let of = |row: usize| {
            let [lat, lon, alt] = [1, 2, 3].map(|column: usize| columns[column][row]);
            let (north_m, east_m) = EarthModel::Wgs84.north_east_m_per_rad(lat.to_radians(), alt);
            let before = |speed_mps: f64, m_per_rad: f64| (delay_s * speed_mps / m_per_rad).to_degrees();
            let (lat, lon) = (lat - before(columns[4][row], north_m), lon - before(columns[5][row], east_m));
            map.at(lat, lon, alt).unwrap().value_nt + core.magnitude_nt(lat, lon, alt) + temporal_nt(&self.errors[row])
        };
        (0..columns[0].len()).map(|row| of(row) + sigma_nt * normals.draw()).collect()
    }

    /// The flight with an INS whose height is `below_m` too low. The readings are from the map of [`levels`], with
    /// white noise of this standard deviation.
    pub(crate) fn below(mut self, below_m: f64, seed: u64, sigma_nt: f64) -> (Self, Vec<f64>) {
        self.ins.columns[3].iter_mut().for_each(|alt_m| *alt_m -= below_m);
        let mut normals = NormalGenerator::new(seed);
        let of = |(row, error): (usize, &StateVector)| {
            let [lat, lon, alt] = [1, 2, 3].map(|column: usize| self.truth.columns[column][row]);
            levels().at(lat, lon, alt).unwrap().value_nt + world().core.magnitude_nt(lat, lon, alt) + temporal_nt(error)
        };
        let field_nt: Vec<f64> = self.errors.iter().enumerate().map(of).collect();
        let measured_nt = field_nt.iter().map(|field| field + sigma_nt * normals.draw()).collect();
        (self, measured_nt)
    }

    /// Line for the filters.
    pub(crate) fn line<'a>(
        &self,
        ins: &'a InsSeries<'a>,
        measurement_nt: &'a [f64],
        sigma_nt: &'a [f64],
    ) -> NavigationLine<'a> {
        let OsborneWorld { map, core } = world();
        let (errors, core) = (self.model, Some(core));
        NavigationLine {
            ins,
            measurement_nt,
            sigma_nt,
            map,
            core,
            errors,
            offset_window_s: 0.0,
            fixes: None,
            second_order: false,
        }
    }

    /// True path.
    pub(crate) fn path(&self) -> TruePath<'_> {
        let [_, lat_deg, lon_deg, alt_m, vn, ve, vd, ..] = self.truth.columns.each_ref().map(Vec::as_slice);
        TruePath { lat_deg, lon_deg, alt_m, velocity_ned_mps: Some([vn, ve, vd]) }
    }

    /// Error of a filter's position, north and east, in metres.
    pub(crate) fn error_m(&self, output: &NavigationOutput, row: usize) -> [f64; 2] {
        let (lat_deg, alt_m) = (self.truth.columns[1][row], self.truth.columns[3][row]);
        let (north, east) = EarthModel::Wgs84.north_east_m_per_rad(lat_deg.to_radians(), alt_m);
        let missed = |truth: f64, found: f64| (truth - found).to_radians();
        [north * missed(lat_deg, output.lat_deg[row]), east * missed(self.truth.columns[2][row], output.lon_deg[row])]
    }

    /// NEES of the position: chi-square with 2 degrees of freedom.
    pub(crate) fn nees(&self, output: &NavigationOutput, row: usize) -> f64 {
        let error = Vector2::from(self.error_m(output, row));
        let (north, east, both) = (output.sd_n_m[row], output.sd_e_m[row], output.cov_ne_m2[row]);
        let covariance = Matrix2::new(north * north, both, both, east * east);
        error.dot(&covariance.lu().solve(&error).unwrap())
    }

    /// Mean square of the horizontal error from a row on, in m².
    pub(crate) fn square_m2(&self, output: &NavigationOutput, from: usize) -> f64 {
        let rows = self.errors.len();
        let square = |row: usize| self.error_m(output, row).iter().map(|part| part * part).sum::<f64>();
        (from..rows).map(square).sum::<f64>() / (rows - from) as f64
    }
}

/// Mean square of the horizontal error from a row on, in m², as predicted by the filter's covariance.
pub(crate) fn claimed_m2(output: &NavigationOutput, from: usize) -> f64 {
    let variance = |row: usize| output.sd_n_m[row].powi(2) + output.sd_e_m[row].powi(2);
    (from..output.sd_n_m.len()).map(variance).sum::<f64>() / (output.sd_n_m.len() - from) as f64
}

/// Quantile of chi-square with `freedom` degrees at `z` standard normal deviates, by the formula of Wilson and
/// Hilferty; the error is below 0.1 % for at least a hundred degrees of freedom.
pub(crate) fn chi_square(freedom: f64, z: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    freedom * (1.0 - spread + z * spread.sqrt()).powi(3)
}

/// Golden map of MagNav.jl's cases: 100 sin(0.7 j) + 40 cos(0.5 k) + 2 j k with j = 1..9 from latitude 0.70 to 0.7008
/// rad, k = 1..11 from longitude −1.30 to −1.2990 rad.
pub(crate) fn golden_map() -> FieldMap {
    let lat: Vec<f64> = (0..9).map(|j| (0.70 + 1e-4 * f64::from(j)).to_degrees()).collect();
    let lon: Vec<f64> = (0..11).map(|k| (-1.30 + 1e-4 * f64::from(k)).to_degrees()).collect();
    let node = |j: f64, k: f64| 100.0 * (0.7 * j).sin() + 40.0 * (0.5 * k).cos() + 2.0 * j * k;
    let values: Vec<f64> = (1..=9).flat_map(|j| (1..=11).map(move |k| node(f64::from(j), f64::from(k)))).collect();
    FieldMap::Flat(MapSurface::new(&GeographicGrid::new(&lat, &lon, &values).unwrap(), MapInterpolation::Cubic))
}

/// Plane over the golden line, in nT: 3 nT per 1e-6 rad north, −2 nT per 1e-6 rad east.
pub(crate) fn plane() -> FieldMap {
    let (lat, lon) = ([0.70, 0.7008], [-1.30, -1.299]);
    let value = |lat: f64, lon: f64| 3e6 * (lat - 0.70) - 2e6 * (lon + 1.30);
    let values: Vec<f64> = lat.iter().flat_map(|lat| lon.map(|lon| value(*lat, lon))).collect();
    let grid = GeographicGrid::new(&lat.map(f64::to_degrees), &lon.map(f64::to_degrees), &values).unwrap();
    FieldMap::Flat(MapSurface::new(&grid, MapInterpolation::Linear))
}

/// Navigation line that owns the columns.
#[derive(Clone)]
pub(crate) struct OwnedNavigationLine {
    pub(crate) columns: [Vec<f64>; 13],
    pub(crate) measurement_nt: Vec<f64>,
    pub(crate) sigma_nt: Vec<f64>,
}

impl OwnedNavigationLine {
    /// MagNav.jl's golden line: 20 samples at 10 Hz over the golden map. The measurement has an error of (1e-6, -2e-6)
    /// rad and 0.5 sin(k) nT.
    pub(crate) fn golden(sigma_nt: f64) -> Self {
        let map = golden_map();
        let of = |f: &dyn Fn(f64) -> f64| (0..20).map(|k| f(f64::from(k))).collect::<Vec<f64>>();
        let (lat, lon) = (|k: f64| 0.7004 + 1e-6 * k, |k: f64| -1.2996 + 2e-6 * k);
        let columns = [
            of(&|k| 0.1 * k),
            of(&|k| lat(k).to_degrees()),
            of(&|k| lon(k).to_degrees()),
            of(&|_| 400.0),
            of(&|_| 63.0),
            of(&|_| 97.0),
            of(&|_| 0.0),
            of(&|k| 0.01 * k),
            of(&|k| -0.02 * k),
            of(&|_| -9.80665),
            of(&|k| (0.02 * k).to_degrees()),
            of(&|_| 0.03_f64.to_degrees()),
            of(&|_| 1.0_f64.to_degrees()),
        ];
        let measurement_nt = of(&|k| {
            let (lat, lon) = ((lat(k) + 1e-6).to_degrees(), (lon(k) - 2e-6).to_degrees());
            map.at(lat, lon, 400.0).unwrap().value_nt + 0.5 * k.sin()
        });
        Self { columns, measurement_nt, sigma_nt: vec![sigma_nt; 20] }
    }

    pub(crate) fn series(&self) -> InsSeries<'_> {
        InsSeries::from_columns(self.columns.each_ref().map(Vec::as_slice))
    }

    pub(crate) fn line<'a>(
        &'a self,
        ins: &'a InsSeries<'a>,
        map: &'a FieldMap,
        errors: InsErrorModel,
    ) -> NavigationLine<'a> {
        let (measurement_nt, sigma_nt) = (&self.measurement_nt, &self.sigma_nt);
        NavigationLine {
            ins,
            measurement_nt,
            sigma_nt,
            map,
            core: None,
            errors,
            offset_window_s: 0.0,
            fixes: None,
            second_order: false,
        }
    }

    /// Rows for which `keeps` is true.
    pub(crate) fn thinned(&self, keeps: impl Fn(usize) -> bool) -> Self {
        let keep = |values: &Vec<f64>| (0..values.len()).filter(|row| keeps(*row)).map(|row| values[row]).collect();
        Self {
            columns: self.columns.each_ref().map(keep),
            measurement_nt: keep(&self.measurement_nt),
            sigma_nt: keep(&self.sigma_nt),
        }
    }
}

/// Converts a vector from MagNav.jl's order of states to magline's.
pub(crate) fn from_magnav(theirs: &StateVector) -> StateVector {
    std::array::from_fn::<f64, STATES, _>(|ours| theirs[MAGNAV_POSITION[ours]])
}

/// Flight of an hour at 1 Hz with 5 nT of white noise, with its filter output and bound.
pub(crate) struct FlightEstimates {
    pub(crate) flight: OsborneFlight,
    pub(crate) ekf: NavigationOutput,
    pub(crate) ukf: UkfOutput,
    pub(crate) bound: NavigationOutput,
}

/// Number of flights of [`ensemble`].
pub(crate) const FLIGHTS: u64 = 60;
/// Number of samples of each flight.
pub(crate) const SAMPLES: u32 = 3600;

/// Flights that several tests share.
pub(crate) fn ensemble() -> &'static [FlightEstimates] {
    static ENSEMBLE: OnceLock<Vec<FlightEstimates>> = OnceLock::new();
    ENSEMBLE.get_or_init(|| (0..FLIGHTS).map(filtered).collect())
}

fn filtered(seed: u64) -> FlightEstimates {
    let flight = OsborneFlight::flown(seed, SAMPLES, 1.0, InsErrorModel::default());
    let (measured, sigma) = (flight.measured(1000 + seed, 5.0), vec![5.0; SAMPLES as usize]);
    let ins = flight.ins.series();
    let line = flight.line(&ins, &measured, &sigma);
    let ekf = known(&line, 5.0).unwrap();
    let ukf = ukf::run(&UkfParameters { keep_states: false, ..UkfParameters::default() }, &line).unwrap();
    let bound = crlb::run(&line, &flight.path(), false).unwrap();
    FlightEstimates { flight, ekf, ukf, bound }
}

/// Filter with known and constant noise.
pub(crate) fn known(line: &NavigationLine<'_>, sigma_nt: f64) -> Result<NavigationOutput, NavigationError> {
    let parameters = EkfParameters {
        errors: line.errors,
        measurement_sigma_nt: sigma_nt,
        keep_covariance: line.ins.len() < 100,
        ..EkfParameters::default()
    };
    ekf::run(&parameters, line.ins, line.measurement_nt, line.map, line.core.map(|core| &**core))
}
