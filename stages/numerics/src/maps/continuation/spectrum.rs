//! One transform of a map, from which many results are computed.

use realfft::num_complex::Complex;

use crate::maps::plane_grid::{EvenAxis, PlaneGrid};

use super::ContinuationError;
use super::extension::{PaddedLayout, Padding};
use super::transform::{MapTransform, WavenumberFactor};
use super::trend::TrendPlane;

/// The spectrum of a padded map.
///
/// The spectrum uses the memory of one padded map. Computing a result temporarily uses twice the map's size. Results
/// are bit-identical on any number of threads.
pub struct MapSpectrum {
    pub(super) transform: MapTransform,
    east_m: EvenAxis,
    north_m: EvenAxis,
    pub(super) trend: TrendPlane,
    pub(super) values: Vec<f64>,
}

impl std::fmt::Debug for MapSpectrum {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Spectrum").field("layout", &self.transform.layout).field("trend", &self.trend).finish()
    }
}

impl MapSpectrum {
    /// Transforms a map, with padding for results up to `distance_m` above or below it.
    ///
    /// # Errors
    /// Returns the errors of [`super::check`] and [`Padding::layout`]. Also fails with [`ContinuationError::Height`]
    /// for a distance that is not finite.
    pub fn new(grid: &PlaneGrid, distance_m: f64, padding: &Padding) -> Result<Self, ContinuationError> {
        let (transform, trend) = prepared(grid, distance_m, padding)?;
        let values = transform.spectrum(grid, &trend);
        Ok(Self { transform, east_m: grid.east_m, north_m: grid.north_m, trend, values })
    }

    /// Position of the map in the padded map.
    pub fn layout(&self) -> PaddedLayout {
        self.transform.layout
    }

    /// Map whose spectrum is multiplied by a factor, a function of the wavenumbers along easting and northing in rad/m.
    ///
    /// A wave of wavenumber k is e^(i (k_east east + k_north north)), so the factor of a derivative along easting is i
    /// k_east. The factor must be hermitian, f(−k) = conj f(k), for the result to be real. For a wave of two nodes, the
    /// mean of the factors of both directions is used. The removed trend is multiplied by the real part of f(0).
    pub fn filtered(&self, factor: impl Fn(f64, f64) -> Complex<f64> + Sync) -> PlaneGrid {
        let trend = self.trend.times(factor(0.0, 0.0).re);
        self.answer(WavenumberFactor::General(&factor), &trend)
    }

    /// Same as [`Self::filtered`], but in half the time, for a real factor that depends only on the magnitude of the
    /// wavenumber.
    pub fn filtered_radially(&self, factor: impl Fn(f64) -> f64 + Sync) -> PlaneGrid {
        let trend = self.trend.times(factor(0.0));
        self.answer(WavenumberFactor::Radial(&factor), &trend)
    }

    /// Magnitude of each wave's wavenumber, in rad/m, the squared magnitude of its transform, and its multiplicity: 2
    /// for a wave whose conjugate the half spectrum omits, else 1. The first wave is the mean.
    pub(crate) fn each_wave(&self) -> impl Iterator<Item = (f64, f64, usize)> + '_ {
        let half = self.transform.half();
        let (rows, columns) = (self.transform.layout.rows.padded, self.transform.layout.columns.padded);
        self.values.chunks_exact(2).enumerate().map(move |(i, wave)| {
            let (row, column) = (i / half, i % half);
            let k = self.transform.k_north(row.min(rows - row)).hypot(self.transform.k_east(column));
            let number = if column == 0 || 2 * column == columns { 1 } else { 2 };
            (k, wave[0] * wave[0] + wave[1] * wave[1], number)
        })
    }

    pub(super) fn answer(&self, factor: WavenumberFactor, trend: &TrendPlane) -> PlaneGrid {
        let values = self.transform.filtered(&self.values, factor, trend);
        PlaneGrid { east_m: self.east_m, north_m: self.north_m, values }
    }
}

/// Single result without a stored spectrum; the computation uses twice the memory of the map.
pub(super) fn filtered_once(
    grid: &PlaneGrid,
    distance_m: f64,
    padding: &Padding,
    factor: &(dyn Fn(f64) -> f64 + Sync),
) -> Result<PlaneGrid, ContinuationError> {
    let (transform, trend) = prepared(grid, distance_m, padding)?;
    let after = trend.times(factor(0.0));
    Ok(grid.with(transform.filtered_once(grid, WavenumberFactor::Radial(factor), [&trend, &after])))
}

fn prepared(
    grid: &PlaneGrid,
    distance_m: f64,
    padding: &Padding,
) -> Result<(MapTransform, TrendPlane), ContinuationError> {
    super::check(grid)?;
    super::finite_height("a distance", distance_m)?;
    let layout = padding.layout(grid, distance_m)?;
    Ok((MapTransform::new(grid, layout, padding), TrendPlane::along_edge(grid, padding.trend)))
}
