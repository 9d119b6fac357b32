//! Flights over the Osborne map, with the output of INS and magnetometer.

use std::sync::OnceLock;

use crate::maps::map_surface::{MapInterpolation, MapSurface};
use crate::navigation::ins_error::{InsErrorModel, InsGrade, simulate_ins_error};
use crate::navigation::osborne::{Line, grid};
use crate::navigation::pinson::{S, STATES};
use crate::navigation::strapdown::{level_attitude_deg, specific_force_ned_mps2, velocity_ned_mps};
use crate::random::NormalGenerator;

use super::super::SlamOutput;

/// Middle of a 9 km by 8 km part of the map with a gradient of 0.25 nT/m everywhere, as for the flights of the thesis.
pub const ROUGH_DEG: (f64, f64) = (-21.846, 140.581);
/// Middle of the map, where the gradient is 0.03 nT/m.
pub const SMOOTH_DEG: (f64, f64) = (-21.958, 140.6675);
pub const M_PER_DEG: (f64, f64) = (110_720.0, 103_300.0);

pub fn map() -> &'static MapSurface {
    static MAP: OnceLock<MapSurface> = OnceLock::new();
    MAP.get_or_init(|| MapSurface::new(&grid().unwrap(), MapInterpolation::Cubic))
}

/// Straight distance in m, then a turn to the right in degrees.
pub type Leg = (f64, f64);

const SPEED_MPS: f64 = 65.0;
/// Number of positions per second of the paths before sampling.
const FINE: f64 = 20.0;

/// Path of straight legs and turns with a radius of 700 m, with 20 positions per second, north and east in metres.
fn flown(legs: impl Iterator<Item = Leg>, from_m: [f64; 2], count: usize) -> Vec<[f64; 2]> {
    const RADIUS: f64 = 700.0;
    let (mut at, mut heading, ds) = (from_m, 0.0_f64, SPEED_MPS / FINE);
    let mut out = vec![at];
    for (straight, turn_deg) in legs {
        let turns = (turn_deg.to_radians().abs() * RADIUS / ds) as usize;
        let bends =
            std::iter::repeat_n(0.0, (straight / ds) as usize).chain(std::iter::repeat_n(turn_deg.signum(), turns));
        for bend in bends {
            heading += bend * ds / RADIUS;
            at = [at[0] + ds * heading.cos(), at[1] + ds * heading.sin()];
            out.push(at);
            if out.len() >= count {
                return out;
            }
        }
    }
    out
}

/// Curve at constant speed, 20 positions per second.
fn along(curve: impl Fn(f64) -> [f64; 2], count: usize) -> Vec<[f64; 2]> {
    let mut u = 0.0;
    let mut out = vec![];
    for _ in 0..count {
        out.push(curve(u));
        for _ in 0..4 {
            let (a, b) = (curve(u - 1e-5), curve(u + 1e-5));
            u += 0.25 * SPEED_MPS / FINE * 2e-5 / (a[0] - b[0]).hypot(a[1] - b[1]);
        }
    }
    out
}

/// Columns of a path, smoothed over 2 s to remove jumps of the curvature.
fn line(fine: &[[f64; 2]], middle_deg: (f64, f64), dt_s: f64, samples: usize) -> Line {
    let (half, stride) = (FINE as usize, (FINE * dt_s).round() as usize);
    let smooth = |k: usize, axis: usize| {
        let window = &fine[k - half..=k + half];
        window.iter().map(|at| at[axis]).sum::<f64>() / window.len() as f64
    };
    let count = samples.min((fine.len() - 2 * half) / stride);
    let of = |f: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..count).map(|k| f(half + k * stride)).collect() };
    let tt: Vec<f64> = (0..count).map(|k| k as f64 * dt_s).collect();
    let lat = of(&|k| middle_deg.0 + smooth(k, 0) / M_PER_DEG.0);
    let lon = of(&|k| middle_deg.1 + smooth(k, 1) / M_PER_DEG.1);
    let alt = vec![500.0; count];
    let [vn, ve, vd] = velocity_ned_mps(&tt, &lat, &lon, &alt).unwrap();
    let [force_n, force_e, force_d] = specific_force_ned_mps2(&tt, [&lat, &alt], [&vn, &ve, &vd]).unwrap();
    let [roll, pitch, yaw] = level_attitude_deg(&vn, &ve).unwrap();
    Line { columns: [tt, lat, lon, alt, vn, ve, vd, force_n, force_e, force_d, roll, pitch, yaw] }
}

fn fine_count(samples: usize, dt_s: f64) -> usize {
    ((samples as f64 * dt_s + 4.0) * FINE) as usize
}

/// Figures of eight of 3.6 km by 2.2 km, with about 130 s per lap, rotated by 25 degrees from lap to lap.
pub fn loiter(middle_deg: (f64, f64), samples: usize, dt_s: f64) -> Line {
    let curve = |u: f64| {
        let (a, b) = (1800.0 * u.sin(), 1100.0 * (2.0 * u).sin());
        let (sin, cos) = (u / std::f64::consts::TAU * 25_f64.to_radians()).sin_cos();
        [a * cos - b * sin, a * sin + b * cos]
    };
    line(&along(curve, fine_count(samples, dt_s)), middle_deg, dt_s, samples)
}

/// Survey of 6 km by 6 km: five lines, five tie lines, and the same lines again 400 m to the west; each line takes 20
/// minutes.
pub fn survey(samples: usize, dt_s: f64) -> Line {
    const LEGS: [Leg; 11] = [
        (6000.0, 180.0),
        (6000.0, -180.0),
        (6000.0, 180.0),
        (6000.0, -180.0),
        (6000.0, -90.0),
        (6000.0, -180.0),
        (6000.0, 180.0),
        (6000.0, -180.0),
        (6000.0, 180.0),
        (6000.0, -90.0),
        (400.0, -180.0),
    ];
    let fine = flown((0..).flat_map(|_| LEGS), [-3300.0, -1400.0], fine_count(samples, dt_s));
    line(&fine, ROUGH_DEG, dt_s, samples)
}

/// Chords of a star with eleven points, 9 km across, with about 25 minutes per round, rotated by 7 degrees from round
/// to round.
pub fn star(samples: usize, dt_s: f64) -> Line {
    let curve = |u: f64| {
        let turn = u / std::f64::consts::TAU * 7_f64.to_radians();
        let at = |rate: f64| (rate * u + turn).sin_cos();
        let ((s, c), (t, d)) = (at(5.0), at(-6.0));
        [4500.0 * (0.6 * c + 0.4 * d), 4500.0 * (0.6 * s + 0.4 * t)]
    };
    line(&along(curve, fine_count(samples, dt_s)), (-21.899, 140.63), dt_s, samples)
}

/// Northward flight from 20 km south of the middle to 20 km north of the middle.
pub fn straight(samples: usize, dt_s: f64) -> Line {
    line(&flown(std::iter::once((1e6, 0.0)), [-20000.0, 0.0], fine_count(samples, dt_s)), SMOOTH_DEG, dt_s, samples)
}

pub struct Flight {
    pub truth: Line,
    pub ins: Line,
    pub errors: Vec<[f64; STATES]>,
    pub measured_nt: Vec<f64>,
    pub sigma_nt: Vec<f64>,
    pub model: InsErrorModel,
}

pub const SIGMA_NT: f64 = 1.0;

impl Flight {
    pub fn new(truth: Line, model: InsErrorModel, seed: u64) -> Self {
        Self::over(truth, model, seed, &|lat, lon| map().at(lat, lon).map_or(f64::NAN, |field| field.value_nt))
    }

    pub fn over(truth: Line, model: InsErrorModel, seed: u64, field: &dyn Fn(f64, f64) -> f64) -> Self {
        let mut normals = NormalGenerator::new(seed);
        let errors = simulate_ins_error(&truth.series(), &model, || normals.draw()).unwrap();
        let mut measured_nt = vec![];
        for (row, error) in errors.iter().enumerate() {
            let anomaly_nt = field(truth.columns[1][row], truth.columns[2][row]);
            measured_nt.push(anomaly_nt + error[S] + SIGMA_NT * normals.draw());
        }
        let ins = truth.with_errors(&errors);
        let sigma_nt = vec![SIGMA_NT; errors.len()];
        Self { truth, ins, errors, measured_nt, sigma_nt, model }
    }

    pub fn tactical(truth: Line, seed: u64) -> Self {
        Self::new(truth, InsGrade::Tactical.model(), seed)
    }

    /// Error north and east, in metres, of the estimate (of the INS if there is no estimate) at a row.
    pub fn error_m(&self, output: Option<&SlamOutput>, row: usize) -> [f64; 2] {
        let truth = &self.truth.columns;
        let (lat, lon) = match output {
            Some(output) => (output.navigation.lat_deg[row], output.navigation.lon_deg[row]),
            None => (self.ins.columns[1][row], self.ins.columns[2][row]),
        };
        [(lat - truth[1][row]) * M_PER_DEG.0, (lon - truth[2][row]) * M_PER_DEG.1]
    }

    /// NEES of the position per degree of freedom: mean and maximum over the rows after the first 100.
    pub fn nees(&self, output: &SlamOutput) -> (f64, f64) {
        let out = &output.navigation;
        let of = |row: usize| {
            let [n, e] = self.error_m(Some(output), row);
            let (a, b, c) = (out.sd_n_m[row].powi(2), out.cov_ne_m2[row], out.sd_e_m[row].powi(2));
            0.5 * (c * n * n - 2.0 * b * n * e + a * e * e) / (a * c - b * b)
        };
        let all: Vec<f64> = (100..self.errors.len()).map(of).collect();
        (all.iter().sum::<f64>() / all.len() as f64, all.iter().copied().fold(0.0, f64::max))
    }

    pub fn drms_m(&self, output: Option<&SlamOutput>) -> f64 {
        let rows = self.errors.len();
        let square = |row: usize| self.error_m(output, row).iter().map(|error| error * error).sum::<f64>();
        ((0..rows).map(square).sum::<f64>() / rows as f64).sqrt()
    }
}

/// Realisation of a Gaussian process with squared-exponential covariance (nT, m), as a sum of 2000 waves.
pub fn waves(sigma_nt: f64, length_m: f64, seed: u64) -> impl Fn(f64, f64) -> f64 {
    let mut normals = NormalGenerator::new(seed);
    let waves: Vec<[f64; 4]> = (0..2000).map(|_| [0; 4].map(|_| normals.draw())).collect();
    let share = sigma_nt / 2000_f64.sqrt();
    move |lat_deg, lon_deg| {
        let north = (lat_deg - ROUGH_DEG.0) * M_PER_DEG.0 / length_m;
        let east = (lon_deg - ROUGH_DEG.1) * M_PER_DEG.1 / length_m;
        let wave = |[kn, ke, a, b]: &[f64; 4]| {
            let (sin, cos) = (kn * north + ke * east).sin_cos();
            a * sin + b * cos
        };
        share * waves.iter().map(wave).sum::<f64>()
    }
}
