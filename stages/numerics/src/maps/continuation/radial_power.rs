//! The mean square of a map by wavenumber, and the error of a map at another height.

use crate::maps::plane_grid::PlaneGrid;

use super::spectrum::MapSpectrum;
use super::{ContinuationError, MAGNAV_ALPHA_M2, Padding};

/// Number of logarithmically spaced bins between the longest and the shortest wave of a padded map.
const BINS: usize = 96;
/// Largest side of a map, in nodes; a larger map is represented by its central part of this size.
const MOST_NODES: usize = 2048;

/// Mean square of a map minus its mean and trend, as a function of the wavenumber.
#[derive(Clone, Debug)]
pub struct RadialPower {
    /// The bins that contain a wave, in ascending order of wavenumber.
    pub(super) bins: Vec<WavenumberBin>,
    /// Wavenumber of a wave of two nodes along the axis of wider spacing, in rad/m; above this wavenumber, the map does
    /// not contain waves in all directions.
    pub(super) round_k: f64,
}

/// A bin of waves of similar wavenumber.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WavenumberBin {
    /// Mean wavenumber, in rad/m.
    pub(super) k: f64,
    /// Mean square, in nT².
    pub(super) square: f64,
    /// Fraction of the map's waves that the bin contains.
    pub(super) part: f64,
}

impl RadialPower {
    /// Spectrum of a map. Unknown nodes (NaN) are replaced by the mean of the known nodes, and the total power is
    /// scaled to the power of the known nodes.
    ///
    /// # Errors
    /// Returns the errors of [`MapSpectrum::new`].
    pub fn from_map(map: &PlaneGrid) -> Result<Self, ContinuationError> {
        let mut map = middle(map);
        let known: Vec<f64> = map.values.iter().copied().filter(|x| x.is_finite()).collect();
        let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
        map.values.iter_mut().filter(|x| !x.is_finite()).for_each(|x| *x = mean);
        let spectrum = MapSpectrum::new(&map, 0.0, &Padding::default())?;
        let mut bins = vec![(0.0, 0.0, 0.0); BINS];
        let longest = spectrum.each_wave().map(|(k, ..)| k).filter(|k| *k > 0.0).fold(f64::INFINITY, f64::min);
        let shortest = spectrum.each_wave().map(|(k, ..)| k).fold(0.0, f64::max);
        let per_bin = (shortest / longest).ln() / BINS as f64;
        for (k, square, number) in spectrum.each_wave().filter(|(k, ..)| *k > 0.0) {
            let square = number as f64 * square;
            let at = (((k / longest).ln() / per_bin) as usize).min(BINS - 1);
            bins[at].0 += k * square;
            bins[at].1 += square;
            bins[at].2 += 1.0;
        }
        // The padding contains part of the power, so the total is scaled to the power of the known nodes.
        let trend = spectrum.trend;
        let columns = map.columns();
        let flat = |(i, x): (usize, &f64)| x - trend.at(i / columns, i % columns);
        let flat: Vec<f64> = map.values.iter().enumerate().map(flat).collect();
        let middle = flat.iter().sum::<f64>() / flat.len() as f64;
        let whole = flat.iter().map(|x| (x - middle).powi(2)).sum::<f64>() / known.len().max(1) as f64;
        let sum: f64 = bins.iter().map(|b| b.1).sum();
        let scale = if sum > 0.0 { whole / sum } else { 0.0 };
        let waves: f64 = bins.iter().map(|b| b.2).sum();
        let kept = bins.into_iter().filter(|b| b.1 > 0.0);
        let bin = |(k, square, count)| WavenumberBin { k: k / square, square: square * scale, part: count / waves };
        let round_k = std::f64::consts::PI / map.east_m.step.max(map.north_m.step);
        Ok(Self { bins: kept.map(bin).collect(), round_k })
    }

    /// Root mean square, in nT, of the difference between the map and the same field `up_m` metres above it. Negative
    /// distances are below the map and use the damping of downward continuation.
    pub fn height_error_nt(&self, up_m: f64) -> f64 {
        let factor = |k: f64| {
            let grown = (-k * up_m).exp();
            if up_m >= 0.0 { grown } else { grown / (1.0 + MAGNAV_ALPHA_M2 * k * k * grown) }
        };
        self.bins.iter().map(|bin| bin.square * (1.0 - factor(bin.k)).powi(2)).sum::<f64>().sqrt()
    }
}

/// The map, or the middle part of a large map.
fn middle(map: &PlaneGrid) -> PlaneGrid {
    let (rows, columns) = (map.rows(), map.columns());
    if rows.max(columns) <= MOST_NODES {
        return map.clone();
    }
    let cut = |n: usize| (n.saturating_sub(MOST_NODES) / 2, n.min(MOST_NODES));
    let ((row, high), (column, wide)) = (cut(rows), cut(columns));
    let values = (row..row + high)
        .flat_map(|r| map.values[r * columns + column..r * columns + column + wide].to_vec())
        .collect();
    let (mut east_m, mut north_m) = (map.east_m, map.north_m);
    (east_m.first, east_m.len) = (east_m.at(column as f64), wide);
    (north_m.first, north_m.len) = (north_m.at(row as f64), high);
    PlaneGrid { east_m, north_m, values }
}
