//! Upward and downward continuation, and stacks of levels.

use crate::maps::plane_grid::PlaneGrid;

use super::extension::Padding;
use super::gain::gain;
use super::l_curve::LCurve;
use super::spectrum::{MapSpectrum, filtered_once};
use super::{ContinuationError, finite_height, rms, usable_alpha};

/// The map continued upward by `up_m` metres, which may be negative.
///
/// `alpha_m2` damps downward continuation and has no effect upward; MagNav.jl uses [`super::MAGNAV_ALPHA_M2`].
///
/// # Errors
/// Returns the errors of [`MapSpectrum::new`]. Also fails with [`ContinuationError::Alpha`].
pub fn continued(
    grid: &PlaneGrid,
    up_m: f64,
    alpha_m2: f64,
    padding: &Padding,
) -> Result<PlaneGrid, ContinuationError> {
    usable_alpha(alpha_m2)?;
    filtered_once(grid, up_m, padding, &|k| gain(k, up_m, alpha_m2))
}

/// The map continued upward by `up_m` metres, at least 0.
///
/// # Errors
/// Returns the errors of [`MapSpectrum::new`]. Also fails with [`ContinuationError::Height`] for a distance below 0.
pub fn upward(grid: &PlaneGrid, up_m: f64, padding: &Padding) -> Result<PlaneGrid, ContinuationError> {
    not_negative("the distance upward", up_m)?;
    continued(grid, up_m, 0.0, padding)
}

/// Damping of downward continuation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Regularisation {
    /// α from the corner of the L-curve.
    LCurve,
    /// Given α in m².
    Alpha(f64),
}

/// A map continued downward, with the damping and the expected error.
#[derive(Clone, Debug)]
pub struct DownwardContinuation {
    /// The map below.
    pub map: PlaneGrid,
    /// Damping parameter α, in m².
    pub alpha_m2: f64,
    /// L-curve, computed even if α is given.
    pub curve: LCurve,
    /// Regularisation error in nT: the rms of the lower map, continued upward again, minus the original map.
    pub regularisation_error_nt: f64,
}

/// Map continued downward by `down_m` metres, at least 0.
///
/// The lower map U minimises Σ e^(k h) |e^(−k h) U − F|² + α Σ |k U|²: its misfit to the map F plus α times its
/// roughness. The L-curve plots the rms of the misfit against the rms of the gradient for many α. The corner of the
/// L-curve is the point of maximum curvature: less damping adds noise, and more damping removes signal [Hansen 1992,
/// SIAM Review 34]. MagNav.jl instead places the corner at the largest change between the maps of successive α; this
/// change depends on a single node, and every α requires a map. Here the whole curve is computed from the power of the
/// spectrum.
///
/// # Errors
/// Returns the errors of [`MapSpectrum::new`]. Also fails with [`ContinuationError::Height`] for a distance below 0 or
/// [`ContinuationError::Alpha`].
pub fn downward(
    grid: &PlaneGrid,
    down_m: f64,
    regularisation: Regularisation,
    padding: &Padding,
) -> Result<DownwardContinuation, ContinuationError> {
    not_negative("the distance downward", down_m)?;
    let spectrum = MapSpectrum::new(grid, down_m, padding)?;
    let curve = LCurve::new(&spectrum, down_m);
    let alpha_m2 = match regularisation {
        Regularisation::LCurve => curve.corner_alpha_m2(),
        Regularisation::Alpha(alpha_m2) => alpha_m2,
    };
    let map = spectrum.at_height(-down_m, alpha_m2)?;
    drop(spectrum);
    let back = upward(&map, down_m, padding)?;
    let regularisation_error_nt = rms(back.values.iter().zip(&grid.values).map(|(back, map)| back - map));
    Ok(DownwardContinuation { map, alpha_m2, curve, regularisation_error_nt })
}

/// Maps continued by each of the heights in metres, which may be negative, from a single transform.
///
/// # Errors
/// Returns the errors of [`MapSpectrum::new`]. Also fails with [`ContinuationError::Alpha`].
pub fn stack(
    grid: &PlaneGrid,
    up_m: &[f64],
    alpha_m2: f64,
    padding: &Padding,
) -> Result<Vec<PlaneGrid>, ContinuationError> {
    up_m.iter().try_for_each(|height| finite_height("a height", *height))?;
    let furthest = up_m.iter().fold(0.0_f64, |furthest, height| furthest.max(height.abs()));
    let spectrum = MapSpectrum::new(grid, furthest, padding)?;
    up_m.iter().map(|height| spectrum.at_height(*height, alpha_m2)).collect()
}

impl MapSpectrum {
    /// Map continued upward by `up_m` metres. A negative height continues it downward, damped by α in m².
    ///
    /// # Errors
    /// Fails with [`ContinuationError::Height`] for a height that is not finite, or with [`ContinuationError::Alpha`]
    /// for an α that is not a finite number of at least 0.
    pub fn at_height(&self, up_m: f64, alpha_m2: f64) -> Result<PlaneGrid, ContinuationError> {
        finite_height("a height", up_m)?;
        usable_alpha(alpha_m2)?;
        Ok(self.filtered_radially(|k| gain(k, up_m, alpha_m2)))
    }
}

fn not_negative(what: &'static str, value: f64) -> Result<(), ContinuationError> {
    let range = "a finite number of at least 0";
    if value >= 0.0 && value.is_finite() { Ok(()) } else { Err(ContinuationError::Height { what, range, value }) }
}
