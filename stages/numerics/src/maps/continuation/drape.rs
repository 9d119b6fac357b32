//! Continuation between a level and a drape: a surface with a different height at each node.

use rayon::prelude::*;

use crate::maps::plane_grid::PlaneGrid;

use super::extension::Padding;
use super::spectrum::MapSpectrum;
use super::{ContinuationError, MAGNAV_ALPHA_M2, finite_height, upward, usable_alpha};

/// Maximum number of levels, which are computed one by one; a larger number indicates a mistake in the heights or the
/// step.
const MOST_LEVELS: usize = 2000;

/// Interpolation of the field between two levels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeightInterpolation {
    /// Linear interpolation, as in MagNav.jl.
    Linear,
    /// Cubic through the four surrounding levels.
    Cubic,
}

/// Settings of the continuation between a level and a drape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrapeOptions {
    /// Step between levels in metres; unset: half of the smaller spacing of the map.
    pub step_m: Option<f64>,
    /// Maximum distance in metres by which a field is continued below its data; deeper nodes are unknown (NaN).
    pub down_max_m: f64,
    /// Damping of downward continuation, in m².
    pub alpha_m2: f64,
    /// Interpolation of the field between two levels.
    pub interpolation: HeightInterpolation,
    /// Number of times that [`drape_to_level`] continues its result back to the drape and adds the difference from the
    /// map; 0 is the plain chessboard method.
    pub refinements: usize,
    /// Extension of the map beyond its edges.
    pub padding: Padding,
}

impl Default for DrapeOptions {
    fn default() -> Self {
        Self {
            step_m: None,
            down_max_m: 150.0,
            alpha_m2: MAGNAV_ALPHA_M2,
            interpolation: HeightInterpolation::Cubic,
            refinements: 1,
            padding: Padding::default(),
        }
    }
}

/// Map on a drape, computed from the map on a level.
///
/// `drape_m` are the heights of the nodes above the same reference as `level_m`, in the order of the map's values. The
/// map is continued from the level to evenly spaced heights by one transform, and each node is interpolated between
/// these heights [Cordell 1985; Gnadt 2022, section 2.3]. A node more than `down_max_m` below the level is NaN.
///
/// # Errors
/// Returns the errors of [`MapSpectrum::new`]. Also fails with [`ContinuationError::DrapeHeights`],
/// [`ContinuationError::TooManyLevels`], [`ContinuationError::Height`] for a level, a step or a limit out of range, or
/// [`ContinuationError::Alpha`].
pub fn level_to_drape(
    grid: &PlaneGrid,
    level_m: f64,
    drape_m: &[f64],
    drape: &DrapeOptions,
) -> Result<PlaneGrid, ContinuationError> {
    drape.check(grid, level_m, drape_m)?;
    let above: Vec<f64> = drape_m.iter().map(|height| height - level_m).collect();
    let map = drape.at_heights(grid, &above)?;
    Ok(drape.without_deep(map, &above))
}

/// Map on a level, computed from the map on a drape.
///
/// The chessboard method treats the draped map as level and continues it to evenly spaced heights. It then interpolates
/// between these heights: each node gets the value at the level's height above the node [Cordell 1985; MagNav.jl's
/// `map_chessboard`]. This is inexact where the drape slopes. With `refinements`, the result on a level below all
/// heights is therefore continued back up to the drape, where the field is known. The difference at the nodes is added
/// by the same method. A node whose height is more than `down_max_m` above the level is NaN.
///
/// # Errors
/// Returns the errors of [`level_to_drape`].
pub fn drape_to_level(
    grid: &PlaneGrid,
    drape_m: &[f64],
    level_m: f64,
    drape: &DrapeOptions,
) -> Result<PlaneGrid, ContinuationError> {
    drape.check(grid, level_m, drape_m)?;
    let above: Vec<f64> = drape_m.iter().map(|height| level_m - height).collect();
    let map = match drape.refinements {
        0 => drape.at_heights(grid, &above)?,
        refinements => drape.refined(grid, drape_m, level_m, refinements)?,
    };
    Ok(drape.without_deep(map, &above))
}

impl DrapeOptions {
    /// MagNav.jl's chessboard method with levels `step_m` apart.
    pub fn magnav(step_m: f64, padding: Padding) -> Self {
        let interpolation = HeightInterpolation::Linear;
        Self { step_m: Some(step_m), interpolation, refinements: 0, padding, ..Self::default() }
    }

    fn check(&self, grid: &PlaneGrid, level_m: f64, drape_m: &[f64]) -> Result<(), ContinuationError> {
        super::check(grid)?;
        finite_height("the level", level_m)?;
        usable_alpha(self.alpha_m2)?;
        let range = "a finite number above 0";
        let step = self.step_of(grid);
        if !(step > 0.0 && step.is_finite()) {
            return Err(ContinuationError::Height { what: "the step between levels", range, value: step });
        }
        if self.down_max_m.is_nan() || self.down_max_m < 0.0 {
            let range = "at least 0";
            return Err(ContinuationError::Height { what: "the limit downward", range, value: self.down_max_m });
        }
        let (nodes, given) = (grid.values.len(), drape_m.len());
        let finite = drape_m.iter().filter(|height| height.is_finite()).count();
        if nodes == given && nodes == finite {
            Ok(())
        } else {
            Err(ContinuationError::DrapeHeights { nodes, given, finite })
        }
    }

    fn step_of(&self, grid: &PlaneGrid) -> f64 {
        self.step_m.unwrap_or(0.5 * grid.east_m.step.min(grid.north_m.step))
    }

    /// The map continued at each node by the node's entry in `above_m`, in metres, but at most `down_max_m` downward.
    fn at_heights(&self, grid: &PlaneGrid, above_m: &[f64]) -> Result<PlaneGrid, ContinuationError> {
        let (lowest, highest) = bounds(above_m);
        let levels =
            ContinuationLevels::new(lowest.max(-self.down_max_m), highest, self.step_of(grid), self.interpolation)?;
        let furthest = lowest.max(-self.down_max_m).abs().max(highest.abs());
        let spectrum = MapSpectrum::new(grid, furthest, &self.padding)?;
        let mut values = vec![0.0; grid.values.len()];
        for level in 0..levels.count {
            let map = spectrum.at_height(levels.height_m(level), self.alpha_m2)?;
            let nodes = values.par_iter_mut().zip(&map.values).zip(above_m);
            nodes.for_each(|((sum, value), above)| *sum += levels.weight(level, *above) * value);
        }
        Ok(grid.with(values))
    }

    /// First computes, on a level below all heights, the field that reproduces the map when continued up to the drape;
    /// then computes the field on the requested level.
    fn refined(
        &self,
        grid: &PlaneGrid,
        drape_m: &[f64],
        level_m: f64,
        refinements: usize,
    ) -> Result<PlaneGrid, ContinuationError> {
        let base_m = bounds(drape_m).0.min(level_m);
        let up: Vec<f64> = drape_m.iter().map(|height| height - base_m).collect();
        let down: Vec<f64> = up.iter().map(|height| -height).collect();
        let mut base = self.at_heights(grid, &down)?;
        for _ in 0..refinements {
            let draped = self.at_heights(&base, &up)?;
            let missing = grid.values.iter().zip(&draped.values).map(|(map, draped)| map - draped).collect();
            let correction = self.at_heights(&grid.with(missing), &down)?;
            base.values.iter_mut().zip(&correction.values).for_each(|(base, correction)| *base += correction);
        }
        upward(&base, level_m - base_m, &self.padding)
    }

    fn without_deep(&self, mut map: PlaneGrid, above_m: &[f64]) -> PlaneGrid {
        let deep = map.values.iter_mut().zip(above_m).filter(|(_, above)| **above < -self.down_max_m);
        deep.for_each(|(value, _)| *value = f64::NAN);
        map
    }
}

fn bounds(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)))
}

/// Evenly spaced heights relative to a map, at multiples of the step, that enclose all requested heights.
#[derive(Clone, Copy, Debug)]
struct ContinuationLevels {
    first_m: f64,
    step_m: f64,
    count: usize,
    interpolation: HeightInterpolation,
}

impl ContinuationLevels {
    fn new(
        lowest_m: f64,
        highest_m: f64,
        step_m: f64,
        interpolation: HeightInterpolation,
    ) -> Result<Self, ContinuationError> {
        let (least, around) = if interpolation == HeightInterpolation::Linear { (2, 0.0) } else { (4, 1.0) };
        let steps = |height: f64| (height / step_m).clamp(-1e9, 1e9);
        let wanted = steps(lowest_m).floor() - around;
        // If the field is requested only above the map, no downward continuation is needed.
        let first = if lowest_m < 0.0 { wanted } else { wanted.max(0.0) };
        let count = least.max((steps(highest_m).ceil() + around - first).max(0.0) as usize + 1);
        if count > MOST_LEVELS {
            return Err(ContinuationError::TooManyLevels { levels: count, most: MOST_LEVELS, step_m });
        }
        Ok(Self { first_m: first * step_m, step_m, count, interpolation })
    }

    fn height_m(&self, level: usize) -> f64 {
        self.first_m + self.step_m * level as f64
    }

    /// Weight of a level in the interpolation to a height; a height beyond the levels uses the nearest level alone.
    fn weight(&self, level: usize, above_m: f64) -> f64 {
        let at = ((above_m - self.first_m) / self.step_m).clamp(0.0, (self.count - 1) as f64);
        let (before, points) = match self.interpolation {
            HeightInterpolation::Linear => (at.floor(), 2),
            HeightInterpolation::Cubic => (at.floor() - 1.0, 4),
        };
        let first = before.clamp(0.0, (self.count - points) as f64) as usize;
        if level < first || level >= first + points {
            return 0.0;
        }
        // Lagrange's polynomial of this level.
        (first..first + points)
            .filter(|other| *other != level)
            .map(|other| (at - other as f64) / (level as f64 - other as f64))
            .product()
    }
}
