//! Power spectral density of a map, averaged over rings of equal wavenumber.
//!
//! For a map x of n nodes with the spacings d_e and d_n, its mean removed, the taper w and the discrete Fourier
//! transform F of w x, the density at the wavenumbers (k_e, k_n) is S = d_e d_n |F|² / Σ w². Without a taper, the sum
//! of S times the spacings 1/(n_e d_e) and 1/(n_n d_n) of the wavenumbers is the variance of the map (Parseval).

use super::{
    continuation::{ContinuationError, MapSpectrum, Padding},
    plane_grid::PlaneGrid,
};
use params::choice;

choice! {
    /// Taper of a map before its Fourier transform.
    #[derive(Default)]
    pub enum MapTaper {
        /// Product of cosine bells of both axes: little leakage from the edges, half of the resolution.
        #[default]
        Hann = "hann",
        /// No taper: exact for a periodic map.
        None = "none",
    }
}

impl MapTaper {
    /// Weights of the nodes of an axis.
    fn weights(self, n: usize) -> Vec<f64> {
        let bell = |i: usize| 0.5 - 0.5 * (std::f64::consts::TAU * (i as f64 + 0.5) / n as f64).cos();
        match self {
            MapTaper::Hann => (0..n).map(bell).collect(),
            MapTaper::None => vec![1.0; n],
        }
    }
}

/// Error of the spectrum of a map.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MapSpectrumError {
    /// The map has unknown nodes.
    #[error("{unknown} nodes of the map are unknown; fill them first")]
    Unknown {
        /// The number of unknown nodes.
        unknown: usize,
    },
    /// The map is too small.
    #[error("a spectrum requires at least 4 x 4 nodes, but the map has {columns} x {rows}")]
    Small {
        /// The number of columns.
        columns: usize,
        /// The number of rows.
        rows: usize,
    },
    /// The map cannot be transformed.
    #[error(transparent)]
    Transform(#[from] ContinuationError),
}

/// Waves of similar wavenumber.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpectrumRing {
    /// Mean wavenumber, in cycles per metre: the inverse of the wavelength.
    pub wavenumber_per_m: f64,
    /// Mean power density, in the squared unit of the map times m².
    pub density: f64,
    /// Number of waves; two waves of opposite direction count as two.
    pub waves: usize,
}

/// Radially averaged power spectral density of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct MapPowerSpectrum {
    /// The rings that contain a wave, in ascending order of wavenumber. The wave of wavenumber 0, the mean, is not
    /// included.
    pub rings: Vec<SpectrumRing>,
    /// Area of one wave in the plane of wavenumbers, 1/m².
    pub area_per_m2: f64,
}

impl MapPowerSpectrum {
    /// Spectrum of a map without unknown nodes. The width of a ring is the larger of the wavenumber spacings of the two
    /// axes. Waves in the corners beyond the two-node wave are included.
    ///
    /// # Errors
    /// Fails for unknown nodes, and for a map of fewer than four nodes along an axis. Returns the errors of
    /// [`MapSpectrum::new`].
    pub fn new(map: &PlaneGrid, taper: MapTaper) -> Result<Self, MapSpectrumError> {
        let (rows, columns) = (map.rows(), map.columns());
        let unknown = map.values.iter().filter(|x| !x.is_finite()).count();
        if unknown > 0 {
            return Err(MapSpectrumError::Unknown { unknown });
        }
        if rows.min(columns) < 4 {
            return Err(MapSpectrumError::Small { columns, rows });
        }
        let (across, along) = (taper.weights(rows), taper.weights(columns));
        let weight = |node: usize| across[node / columns] * along[node % columns];
        let weights: f64 = across.iter().sum::<f64>() * along.iter().sum::<f64>();
        let mean = map.values.iter().enumerate().map(|(node, x)| weight(node) * x).sum::<f64>() / weights;
        let square = |of: &[f64]| of.iter().map(|w| w * w).sum::<f64>();
        let tapered = map.values.iter().enumerate().map(|(node, x)| weight(node) * (x - mean)).collect();
        let spectrum = MapSpectrum::new(&map.with(tapered), 0.0, &Padding::none())?;
        let scale = map.east_m.step * map.north_m.step / (square(&across) * square(&along));
        let [east, north] = [1.0 / (columns as f64 * map.east_m.step), 1.0 / (rows as f64 * map.north_m.step)];
        let width = east.max(north);
        let mut sums: Vec<SpectrumRing> = vec![];
        for (k_rad, power, waves) in spectrum.each_wave().skip(1) {
            let (k, count) = (k_rad / std::f64::consts::TAU, waves as f64);
            // A wave between two rings belongs to the upper one, regardless of rounding.
            let at = (k / width + 1e-9).round() as usize;
            if sums.len() <= at {
                sums.resize(at + 1, SpectrumRing { wavenumber_per_m: 0.0, density: 0.0, waves: 0 });
            }
            let ring = &mut sums[at];
            ring.wavenumber_per_m += count * k;
            ring.density += count * scale * power;
            ring.waves += waves;
        }
        let mean = |ring: SpectrumRing| SpectrumRing {
            wavenumber_per_m: ring.wavenumber_per_m / ring.waves as f64,
            density: ring.density / ring.waves as f64,
            waves: ring.waves,
        };
        let rings = sums.into_iter().filter(|ring| ring.waves > 0).map(mean).collect();
        Ok(Self { rings, area_per_m2: east * north })
    }

    /// Variance of the tapered map, in its squared unit: the sum of the density over all waves.
    pub fn variance(&self) -> f64 {
        self.area_per_m2 * self.rings.iter().map(|ring| ring.waves as f64 * ring.density).sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::{maps::plane_grid::EvenAxis, random::NormalGenerator};

    const COLUMNS: usize = 120;
    const ROWS: usize = 96;
    const STEPS_M: [f64; 2] = [50.0, 80.0];

    fn grid(values: Vec<f64>) -> PlaneGrid {
        let axis = |step: f64, len: usize| EvenAxis { first: 7.0, step, len };
        PlaneGrid { east_m: axis(STEPS_M[0], COLUMNS), north_m: axis(STEPS_M[1], ROWS), values }
    }

    /// White noise of 3 nT, convolved periodically with the bell e^(−r²/2s²)/(2 π s²).
    fn random_field(seed: u64, sigma_m: f64) -> PlaneGrid {
        let mut normal = NormalGenerator::new(seed);
        let white: Vec<f64> = (0..COLUMNS * ROWS).map(|_| 3.0 * normal.draw()).collect();
        if sigma_m == 0.0 {
            return grid(white);
        }
        let bell = |offset: i64, step: f64| {
            let r = offset as f64 * step / sigma_m;
            step * (-0.5 * r * r).exp() / (sigma_m * std::f64::consts::TAU.sqrt())
        };
        let around = |at: usize, offset: i64, n: usize| (at as i64 + offset).rem_euclid(n as i64) as usize;
        let reach = |step: f64| (6.0 * sigma_m / step).ceil() as i64;
        let filtered = |values: &[f64], step: f64, place: &dyn Fn(usize, i64) -> usize| -> Vec<f64> {
            let of = |node: usize| (-reach(step)..=reach(step)).map(|o| bell(o, step) * values[place(node, o)]).sum();
            (0..values.len()).map(of).collect()
        };
        let east =
            filtered(&white, STEPS_M[0], &|node, o| node / COLUMNS * COLUMNS + around(node % COLUMNS, o, COLUMNS));
        grid(filtered(&east, STEPS_M[1], &|node, o| around(node / COLUMNS, o, ROWS) * COLUMNS + node % COLUMNS))
    }

    #[test]
    fn law_the_sum_of_the_density_is_the_variance() {
        let map = random_field(1, 0.0);
        let mean = map.values.iter().sum::<f64>() / map.values.len() as f64;
        let variance = map.values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / map.values.len() as f64;
        let found = MapPowerSpectrum::new(&map, MapTaper::None).unwrap();
        assert!((found.variance() / variance - 1.0).abs() < 1e-12, "{} {variance}", found.variance());
        assert_eq!(found.rings.iter().map(|ring| ring.waves).sum::<usize>(), COLUMNS * ROWS - 1);
        let tapered = MapPowerSpectrum::new(&map, MapTaper::Hann).unwrap().variance();
        assert!((tapered / variance - 1.0).abs() < 0.1, "{tapered} {variance}");
    }

    #[test]
    fn law_a_random_field_has_its_analytic_density() {
        for (sigma_m, taper) in [(0.0, MapTaper::None), (150.0, MapTaper::None), (0.0, MapTaper::Hann)] {
            let seeds = 20;
            let spectra: Vec<MapPowerSpectrum> =
                (0..seeds).map(|seed| MapPowerSpectrum::new(&random_field(seed, sigma_m), taper).unwrap()).collect();
            for at in 0..spectra[0].rings.len() {
                let ring = spectra[0].rings[at];
                let density = spectra.iter().map(|s| s.rings[at].density).sum::<f64>() / seeds as f64;
                // The transform of the bell is e^(−2 π² s² f²).
                let decay = (-4.0 * (std::f64::consts::PI * sigma_m * ring.wavenumber_per_m).powi(2)).exp();
                let exact = 9.0 * STEPS_M[0] * STEPS_M[1] * decay;
                // Waves of opposite direction are equal, and a taper correlates neighbours. The density varies within
                // a ring of the width 1/6000 m.
                let independent = (seeds as f64 * ring.waves as f64) / if taper == MapTaper::Hann { 8.0 } else { 2.0 };
                let bound = 5.0 / independent.sqrt() + if sigma_m == 0.0 { 0.0 } else { 0.02 };
                if exact > 1e-3 * STEPS_M[0] * STEPS_M[1] && !(taper == MapTaper::Hann && at < 3) {
                    assert!((density / exact - 1.0).abs() < bound, "{at} {ring:?}: {density} {exact} {bound}");
                }
            }
        }
    }

    #[test]
    fn law_a_wave_is_in_the_ring_of_its_wavenumber() {
        // 12 waves over 6000 m eastward: a wavelength of 500 m.
        let wave = |node: usize| 4.0 * (std::f64::consts::TAU * 12.0 * (node % COLUMNS) as f64 / COLUMNS as f64).sin();
        let found = MapPowerSpectrum::new(&grid((0..COLUMNS * ROWS).map(wave).collect()), MapTaper::None).unwrap();
        let strongest = found.rings.iter().max_by(|a, b| a.density.total_cmp(&b.density)).unwrap();
        assert!((strongest.wavenumber_per_m * 500.0 - 1.0).abs() < 0.02, "{strongest:?}");
        assert!((found.variance() - 8.0).abs() < 1e-10);
    }

    #[test]
    fn gold_maps_without_a_spectrum() {
        let mut map = random_field(1, 0.0);
        map.values[5] = f64::NAN;
        let unknown = MapPowerSpectrum::new(&map, MapTaper::Hann).unwrap_err();
        assert_eq!(unknown.to_string(), "1 nodes of the map are unknown; fill them first");
        let small = PlaneGrid { north_m: EvenAxis { len: 3, ..map.north_m }, values: vec![1.0; 3 * COLUMNS], ..map };
        let small = MapPowerSpectrum::new(&small, MapTaper::Hann).unwrap_err().to_string();
        assert!(small.contains("at least 4 x 4 nodes, but the map has 120 x 3"), "{small}");
    }
}
