//! The L-curve of downward continuation, from the power of the spectrum.

use rayon::prelude::*;

use super::gain::gain;
use super::spectrum::MapSpectrum;
use super::transform::MapTransform;
use crate::regression::l_curve::log_curvature;

/// Number of rings of wavenumbers, narrow enough that the continuation factor is nearly constant within a ring.
const RINGS: usize = 4096;
/// Number of blocks of rows that are summed separately; it does not depend on the number of threads.
const PARTS: usize = 16;
/// Points of the curve.
const POINTS: usize = 241;

/// A point of the curve, for one value of α.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LCurvePoint {
    /// α, in m².
    pub alpha_m2: f64,
    /// The rms of the misfit in nT: the downward-continued map, continued upward again, minus the original map.
    pub misfit_nt: f64,
    /// The rms of the gradient of the downward-continued map, in nT/m.
    pub roughness_nt_per_m: f64,
    /// Curvature of the L-curve in log misfit and log roughness; positive at the corner.
    pub curvature: f64,
}

/// Misfit as a function of roughness for many α, and the corner of the curve.
#[derive(Clone, Debug, PartialEq)]
pub struct LCurve {
    /// Points in ascending order of α, evenly spaced in its logarithm, from no effect to complete suppression.
    pub points: Vec<LCurvePoint>,
    /// The index of the point at the corner.
    pub corner: usize,
}

/// Power of the waves in a narrow ring of wavenumbers.
#[derive(Clone, Copy, Debug, Default)]
struct WavenumberRing {
    power: f64,
    /// The power times the wavenumber in rad/m.
    moment: f64,
}

impl LCurve {
    pub(super) fn new(spectrum: &MapSpectrum, down_m: f64) -> Self {
        let transform = &spectrum.transform;
        let widest = highest_wavenumber(transform);
        let nodes = transform.layout.nodes() as f64;
        let map_nodes = (transform.layout.rows.len * transform.layout.columns.len) as f64;
        let waves: Vec<(f64, f64)> = rings(transform, &spectrum.values, widest)
            .iter()
            .filter(|ring| ring.power > 0.0)
            .map(|ring| (ring.moment / ring.power, ring.power / nodes / map_nodes))
            .collect();
        let points: Vec<LCurvePoint> =
            alphas(transform, widest, down_m).into_iter().map(|alpha| point(&waves, alpha, down_m)).collect();
        Self::with_corner(points)
    }

    fn with_corner(mut points: Vec<LCurvePoint>) -> Self {
        let curvatures: Vec<f64> = points.windows(3).map(curvature).collect();
        for (point, curvature) in points.iter_mut().skip(1).zip(curvatures) {
            point.curvature = curvature;
        }
        let corner =
            (0..points.len()).fold(0, |best, i| if points[i].curvature > points[best].curvature { i } else { best });
        Self { points, corner }
    }

    /// α at the corner, in m².
    pub fn corner_alpha_m2(&self) -> f64 {
        self.points.get(self.corner).map_or(0.0, |point| point.alpha_m2)
    }
}

fn highest_wavenumber(transform: &MapTransform) -> f64 {
    let layout = transform.layout;
    transform.k_east(layout.columns.padded / 2).hypot(transform.k_north(layout.rows.padded / 2))
}

/// Values of α, from one that changes the waves of the highest wavenumber by a tenth to one that halves the waves of
/// the lowest wavenumber.
fn alphas(transform: &MapTransform, widest: f64, down_m: f64) -> Vec<f64> {
    let lowest = transform.k_east(1).max(transform.k_north(1));
    let balance = |k: f64| -(k * down_m) - 2.0 * k.ln();
    let (first, last) = (balance(widest) + 0.1_f64.ln(), balance(lowest));
    (0..POINTS).map(|i| (first + (last - first) * i as f64 / (POINTS - 1) as f64).exp()).collect()
}

fn point(waves: &[(f64, f64)], alpha_m2: f64, down_m: f64) -> LCurvePoint {
    let (misfit, roughness) = waves.iter().fold((0.0, 0.0), |(misfit, roughness), &(k, power)| {
        let lower = gain(k, -down_m, alpha_m2);
        // 1 − e^(−k h) g with the gain g, computed without cancellation.
        let lost = alpha_m2 * k * k * lower;
        (misfit + power * lost * lost, roughness + power * (k * lower) * (k * lower))
    });
    LCurvePoint { alpha_m2, misfit_nt: misfit.sqrt(), roughness_nt_per_m: roughness.sqrt(), curvature: 0.0 }
}

/// Curvature at the middle of three points that are evenly spaced in the logarithm of α.
fn curvature(points: &[LCurvePoint]) -> f64 {
    let of = |value: fn(&LCurvePoint) -> f64| [0, 1, 2].map(|i| points.get(i).map_or(f64::NAN, value));
    log_curvature(of(|p| p.misfit_nt), of(|p| p.roughness_nt_per_m))
}

/// Power by wavenumber; a wave whose conjugate the half spectrum omits counts twice.
fn rings(transform: &MapTransform, spectrum: &[f64], widest: f64) -> Vec<WavenumberRing> {
    let rows = transform.layout.rows.padded;
    let rows_a_part = rows.div_ceil(PARTS);
    let parts: Vec<Vec<WavenumberRing>> = spectrum
        .par_chunks(rows_a_part * 2 * transform.half())
        .enumerate()
        .map(|(part, values)| rings_of(transform, values, part * rows_a_part, widest))
        .collect();
    let mut sum = vec![WavenumberRing::default(); RINGS];
    for (ring, part) in parts.iter().flat_map(|part| part.iter().enumerate()) {
        sum[ring].power += part.power;
        sum[ring].moment += part.moment;
    }
    sum
}

fn rings_of(transform: &MapTransform, values: &[f64], first_row: usize, widest: f64) -> Vec<WavenumberRing> {
    let (rows, columns) = (transform.layout.rows.padded, transform.layout.columns.padded);
    let mut rings = vec![WavenumberRing::default(); RINGS];
    for (row, line) in values.chunks_exact(2 * transform.half()).enumerate() {
        let row = first_row + row;
        let k_north = transform.k_north(row.min(rows - row));
        for (column, value) in line.chunks_exact(2).enumerate() {
            let k = transform.k_east(column).hypot(k_north);
            let both = if column == 0 || 2 * column == columns { 1.0 } else { 2.0 };
            let power = both * (value[0] * value[0] + value[1] * value[1]);
            let ring = &mut rings[((k / widest * RINGS as f64) as usize).min(RINGS - 1)];
            ring.power += power;
            ring.moment += power * k;
        }
    }
    rings
}
