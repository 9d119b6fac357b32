//! Derivatives of a map at any height.

use realfft::num_complex::Complex;

use crate::maps::plane_grid::PlaneGrid;

use super::gain::gain;
use super::spectrum::MapSpectrum;
use super::transform::WavenumberFactor;
use super::trend::TrendPlane;
use super::{ContinuationError, finite_height, usable_alpha};

/// Direction of a derivative.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapDerivative {
    /// Along easting, in nT/m.
    East,
    /// Along northing, in nT/m.
    North,
    /// Upward, in nT/m: negative over a positive anomaly.
    Up,
    /// Upward twice, in nT/m².
    UpTwice,
}

impl MapSpectrum {
    /// Derivative at `up_m` metres above the map. The height may be negative; α in m² then damps the continuation.
    ///
    /// The factors are i k_east, i k_north, −k and k², times the continuation factor for the height. The slope of a
    /// removed trend plane is included.
    ///
    /// # Errors
    /// Fails with [`ContinuationError::Height`] for a height that is not finite, or with [`ContinuationError::Alpha`]
    /// for an α that is not a finite number of at least 0.
    pub fn derivative(&self, which: MapDerivative, up_m: f64, alpha_m2: f64) -> Result<PlaneGrid, ContinuationError> {
        finite_height("a height", up_m)?;
        usable_alpha(alpha_m2)?;
        let height = move |k: f64| gain(k, up_m, alpha_m2);
        let east = move |east: f64, north: f64| Complex::new(0.0, east * height(east.hypot(north)));
        let north = move |east: f64, north: f64| Complex::new(0.0, north * height(east.hypot(north)));
        let [per_column, per_row] = self.trend.slopes();
        let [east_step, north_step] = self.transform.steps_m();
        Ok(match which {
            MapDerivative::East => self.answer(WavenumberFactor::General(&east), &per_column.times(1.0 / east_step)),
            MapDerivative::North => self.answer(WavenumberFactor::General(&north), &per_row.times(1.0 / north_step)),
            MapDerivative::Up => self.answer(WavenumberFactor::Radial(&|k| -k * height(k)), &TrendPlane::default()),
            MapDerivative::UpTwice => {
                self.answer(WavenumberFactor::Radial(&|k| k * k * height(k)), &TrendPlane::default())
            }
        })
    }
}
