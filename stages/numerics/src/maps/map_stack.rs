//! Anomalies in three dimensions: a stack of maps with the same nodes at ascending heights, a draped map, and an enum
//! over all kinds of map.
//!
//! Between two levels, the value is a cubic or linear function of height. Within a level, it follows the interpolation
//! of the maps. Both are evaluated exactly, so the gradient is the derivative of the value in all three directions.

mod drape;
mod levels;
mod projected;

use crate::earth::field_value::FieldValue;
use crate::maps::map_surface::{
    CellPosition, FieldColumns, FieldLookup, GeographicGrid, GridAxes, GridInterpolant, LookupPositions, MapGridError,
    MapInterpolation, MapSurface, SurfaceGradient, look_up_many,
};
pub use drape::DrapeMap;
use levels::{natural_slopes, union_of_unknown};
pub use projected::ProjectedMap;
use thiserror::Error;

/// Interpolation between two levels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LevelInterpolation {
    /// Cubic interpolation. For maps alone, the natural spline through all levels: value, slope and curvature are
    /// continuous, with zero curvature at the ends. For maps with vertical derivatives, the Hermite cubic.
    #[default]
    Cubic,
    /// Linear interpolation between the two levels; the slope jumps at the levels.
    Linear,
}

/// Value at a position below the lowest or above the highest level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LevelExtrapolation {
    /// Linear extrapolation (value and slope of the end level) up to half of the nearest step between levels; no value
    /// farther away. A filter slightly beyond the ends still has a correct Jacobian; farther away there is no value.
    #[default]
    HalfStep,
    /// No value.
    Nothing,
    /// Value of the end level at any distance, constant with height, as in MagNav.jl. The error is the full decay of
    /// the field over that distance.
    Clamp,
}

/// Settings of the interpolation of a stack.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StackOptions {
    /// Interpolation within a level.
    pub interpolation: MapInterpolation,
    /// Interpolation from level to level.
    pub between: LevelInterpolation,
    /// Values beyond the end levels.
    pub outside: LevelExtrapolation,
}

/// Error of maps that do not form a stack.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum StackError {
    /// There are fewer than two levels.
    #[error("a stack requires at least two levels, not {0}; for one level use a map with its vertical derivative")]
    TooFew(usize),
    /// The numbers of heights and of maps differ.
    #[error("the stack has {heights} heights, but {maps} maps")]
    Count {
        /// Number of heights.
        heights: usize,
        /// Number of maps (or of vertical derivatives).
        maps: usize,
    },
    /// The heights do not ascend or are not finite.
    #[error(
        "the heights of the stack must be finite and ascending, but level {level} is at {alt_m} m and the level \
         before it at {before_m} m"
    )]
    Heights {
        /// The level, from 0.
        level: usize,
        /// Height of the previous level, in metres.
        before_m: f64,
        /// Height of this level, in metres.
        alt_m: f64,
    },
    /// The nodes of a map differ from those of the first map.
    #[error("the latitudes or longitudes of level {level} differ from those of level 0")]
    Nodes {
        /// The level, from 0.
        level: usize,
    },
    /// No node is known at every level.
    #[error("the stack has no node whose value is known at all levels")]
    Empty,
    /// A vertical derivative does not match its map's nodes.
    #[error("level {level}: {source}")]
    Derivative {
        /// The level, from 0.
        level: usize,
        /// The error.
        source: MapGridError,
    },
}

/// Maps of the same nodes at ascending heights.
///
/// A position has a value if the four nodes of its cell are known at all levels.
#[derive(Clone, Debug)]
pub struct MapStack {
    axes: GridAxes,
    heights_m: Vec<f64>,
    /// Value and slope per metre of height, one surface per level.
    levels: Vec<GridInterpolant<2>>,
    options: StackOptions,
}

impl MapStack {
    /// Stack of maps whose slopes with height are derived from the maps by `options.between`. `heights_m` are the
    /// heights of `maps`, in metres, evenly spaced or not.
    ///
    /// # Errors
    /// Fails for fewer than two levels, for heights that are not finite or do not ascend, or for maps whose nodes
    /// differ from the nodes of the first map. Also fails if the numbers of maps and heights differ, or if no node is
    /// known at every level.
    pub fn new(heights_m: &[f64], maps: &[GeographicGrid], options: StackOptions) -> Result<Self, StackError> {
        let known = known_values(heights_m, maps)?;
        let slopes = natural_slopes(heights_m, &known);
        Ok(Self::from_slopes(heights_m, maps, &known, &slopes, options))
    }

    /// A stack of maps and their vertical derivatives, in nT/m. Between levels the stack uses the Hermite cubic with
    /// these slopes and ignores `options.between`. This interpolation is twice as accurate as a spline with estimated
    /// slopes.
    ///
    /// # Errors
    /// Returns the errors of [`Self::new`]. Also fails with [`StackError::Count`] if the numbers of derivatives and
    /// maps differ, or with [`StackError::Derivative`] for a derivative that is not finite at a known node or has a
    /// different number of nodes than its map.
    pub fn with_vertical(
        heights_m: &[f64],
        maps: &[GeographicGrid],
        d_alt_nt_per_m: &[Vec<f64>],
        options: StackOptions,
    ) -> Result<Self, StackError> {
        let known = known_values(heights_m, maps)?;
        if d_alt_nt_per_m.len() != maps.len() {
            return Err(StackError::Count { heights: heights_m.len(), maps: d_alt_nt_per_m.len() });
        }
        for (level, (map, slopes)) in maps.iter().zip(d_alt_nt_per_m).enumerate() {
            let checked = map.check_companion("vertical derivative", slopes);
            checked.map_err(|source| StackError::Derivative { level, source })?;
        }
        let options = StackOptions { between: LevelInterpolation::Cubic, ..options };
        Ok(Self::from_slopes(heights_m, maps, &known, d_alt_nt_per_m, options))
    }

    fn from_slopes(
        heights_m: &[f64],
        maps: &[GeographicGrid],
        known: &[Vec<f64>],
        slopes: &[Vec<f64>],
        options: StackOptions,
    ) -> Self {
        let prepared = maps.iter().zip(known.iter().zip(slopes));
        let levels = prepared.map(|(map, (values, slopes))| {
            GridInterpolant::new(map.shape(), [values.as_slice(), slopes.as_slice()], options.interpolation)
        });
        let axes = GridAxes::from_grid(&maps[0]);
        Self { axes, heights_m: heights_m.to_vec(), levels: levels.collect(), options }
    }

    /// The heights of the levels, in metres.
    pub fn heights_m(&self) -> &[f64] {
        &self.heights_m
    }

    /// Interpolation of the stack. After [`Self::with_vertical`], the interpolation in height is the Hermite cubic.
    pub fn options(&self) -> StackOptions {
        self.options
    }

    /// Anomaly and gradient at a position in degrees and metres. `None` off the maps, in a cell with an unknown node at
    /// any level, for NaN positions, and beyond the levels as set by [`LevelExtrapolation`].
    #[inline]
    pub fn at(&self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> Option<FieldValue> {
        self.in_cell(self.axes.cell(lat_deg, lon_deg)?, alt_m)
    }

    /// Same as [`Self::at`], for many positions; positions without a value are NaN. Allocates only if `out` has to
    /// grow.
    ///
    /// # Errors
    /// Fails with [`MapGridError::Places`] for columns of different lengths.
    pub fn at_many(
        &self,
        lat_deg: &[f64],
        lon_deg: &[f64],
        alt_m: &[f64],
        out: &mut FieldColumns,
    ) -> Result<(), MapGridError> {
        look_up_many(self, LookupPositions { lat_deg, lon_deg, alt_m }, true, out)
    }

    #[inline(always)]
    fn in_cell(&self, cell: CellPosition, alt_m: f64) -> Option<FieldValue> {
        let (first, last) = (*self.heights_m.first()?, *self.heights_m.last()?);
        if alt_m < first {
            self.beyond(cell, 0, 1, alt_m)
        } else if alt_m > last {
            self.beyond(cell, self.heights_m.len() - 1, self.heights_m.len() - 2, alt_m)
        } else {
            self.between(cell, alt_m)
        }
    }

    /// Level below a height, but never the highest level; `None` below the lowest level or for NaN.
    #[inline(always)]
    fn level_below(&self, alt_m: f64) -> Option<usize> {
        // Stacks have few levels: a linear search is faster than bisection.
        let below = self.heights_m.iter().filter(|height| **height <= alt_m).count();
        below.min(self.heights_m.len() - 1).checked_sub(1)
    }

    /// Value past the end level `end`, next to the level `inner`.
    fn beyond(&self, cell: CellPosition, end: usize, inner: usize, alt_m: f64) -> Option<FieldValue> {
        let (end_m, inner_m) = (*self.heights_m.get(end)?, *self.heights_m.get(inner)?);
        let jet = self.levels.get(end)?.at(cell)?;
        match self.options.outside {
            LevelExtrapolation::Clamp => Some(self.axes.field(jet.value[0], jet.per_row[0], jet.per_column[0], 0.0)),
            LevelExtrapolation::HalfStep if (alt_m - end_m).abs() <= 0.5 * (end_m - inner_m).abs() => {
                let jet = match self.options.between {
                    LevelInterpolation::Cubic => jet,
                    LevelInterpolation::Linear => with_secant(jet, self.levels.get(inner)?.at(cell)?, inner_m - end_m),
                };
                let along = |q: [f64; 2]| q[0] + (alt_m - end_m) * q[1];
                Some(self.axes.field(along(jet.value), along(jet.per_row), along(jet.per_column), jet.value[1]))
            }
            LevelExtrapolation::HalfStep | LevelExtrapolation::Nothing => None,
        }
    }

    #[inline(always)]
    fn between(&self, cell: CellPosition, alt_m: f64) -> Option<FieldValue> {
        let low = self.level_below(alt_m)?;
        let (low_m, high_m) = (*self.heights_m.get(low)?, *self.heights_m.get(low + 1)?);
        let (below, over) = (self.levels.get(low)?.at(cell)?, self.levels.get(low + 1)?.at(cell)?);
        let step_m = high_m - low_m;
        let weights = match self.options.between {
            LevelInterpolation::Cubic => HeightWeights::cubic((alt_m - low_m) / step_m, step_m),
            LevelInterpolation::Linear => HeightWeights::linear((alt_m - low_m) / step_m, step_m),
        };
        Some(self.axes.field(
            weights.value_of(below.value, over.value),
            weights.value_of(below.per_row, over.per_row),
            weights.value_of(below.per_column, over.per_column),
            weights.slope_of(below.value, over.value),
        ))
    }
}

impl FieldLookup for MapStack {
    #[inline(always)]
    fn cell(&self, lat_deg: f64, lon_deg: f64) -> Option<CellPosition> {
        self.axes.cell(lat_deg, lon_deg)
    }

    #[inline(always)]
    fn touch(&self, cell: CellPosition, alt_m: f64) -> f64 {
        let low = self.level_below(alt_m).unwrap_or(0);
        self.levels.iter().skip(low).take(2).map(|level| level.touch(cell)).sum()
    }

    #[inline(always)]
    fn field(&self, cell: CellPosition, alt_m: f64) -> Option<FieldValue> {
        self.in_cell(cell, alt_m)
    }
}

/// The end level, with the slope of the straight line to the neighbouring level, which is `way_m` higher.
fn with_secant(end: SurfaceGradient<2>, inner: SurfaceGradient<2>, way_m: f64) -> SurfaceGradient<2> {
    let secant = |end: [f64; 2], inner: [f64; 2]| [end[0], (inner[0] - end[0]) / way_m];
    SurfaceGradient {
        value: secant(end.value, inner.value),
        per_row: secant(end.per_row, inner.per_row),
        per_column: secant(end.per_column, inner.per_column),
    }
}

/// Weights of the value and slope at the lower level and at the upper level, for the interpolated value and for its
/// slope.
struct HeightWeights {
    value: [f64; 4],
    slope: [f64; 4],
}

impl HeightWeights {
    /// Hermite cubic at a fraction `t` of a step of `step_m` above the lower level.
    #[inline(always)]
    fn cubic(t: f64, step_m: f64) -> Self {
        let s = 1.0 - t;
        let bump = 6.0 * t * s / step_m;
        Self {
            value: [s * s * (1.0 + 2.0 * t), s * s * t * step_m, t * t * (1.0 + 2.0 * s), -t * t * s * step_m],
            slope: [-bump, s * (s - 2.0 * t), bump, t * (t - 2.0 * s)],
        }
    }

    #[inline(always)]
    fn linear(t: f64, step_m: f64) -> Self {
        Self { value: [1.0 - t, 0.0, t, 0.0], slope: [-1.0 / step_m, 0.0, 1.0 / step_m, 0.0] }
    }

    #[inline(always)]
    fn value_of(&self, below: [f64; 2], over: [f64; 2]) -> f64 {
        weighted(&self.value, below, over)
    }

    #[inline(always)]
    fn slope_of(&self, below: [f64; 2], over: [f64; 2]) -> f64 {
        weighted(&self.slope, below, over)
    }
}

#[inline(always)]
fn weighted(weights: &[f64; 4], below: [f64; 2], over: [f64; 2]) -> f64 {
    (weights[0] * below[0] + weights[1] * below[1]) + (weights[2] * over[0] + weights[3] * over[1])
}

/// Values of all levels; a node that is unknown at one level is unknown at all levels.
fn known_values(heights_m: &[f64], maps: &[GeographicGrid]) -> Result<Vec<Vec<f64>>, StackError> {
    let (heights, count) = (heights_m.len(), maps.len());
    if heights != count {
        return Err(StackError::Count { heights, maps: count });
    }
    if count < 2 {
        return Err(StackError::TooFew(count));
    }
    for (below, pair) in heights_m.windows(2).enumerate() {
        let (before_m, alt_m) = (pair[0], pair[1]);
        if !(before_m.is_finite() && alt_m.is_finite() && alt_m > before_m) {
            return Err(StackError::Heights { level: below + 1, before_m, alt_m });
        }
    }
    let same = |map: &GeographicGrid| map.lat() == maps[0].lat() && map.lon() == maps[0].lon();
    if let Some(level) = maps.iter().position(|map| !same(map)) {
        return Err(StackError::Nodes { level });
    }
    let known = union_of_unknown(maps);
    if known.iter().flatten().all(|value| value.is_nan()) { Err(StackError::Empty) } else { Ok(known) }
}

/// A field over an area: any kind of map.
#[derive(Clone, Debug)]
pub enum FieldMap {
    /// A map at a single height.
    Flat(MapSurface),
    /// Maps at several heights.
    Stack(MapStack),
    /// A map that follows the ground.
    Drape(DrapeMap),
    /// A map on the grid of its native projection.
    Projected(Box<ProjectedMap>),
}

impl FieldMap {
    /// The anomaly and its gradient at a position in degrees and metres; `None` where the map has no value. A flat map
    /// without a vertical derivative is constant with height.
    #[inline]
    pub fn at(&self, lat_deg: f64, lon_deg: f64, alt_m: f64) -> Option<FieldValue> {
        match self {
            Self::Flat(map) => map.at_height(lat_deg, lon_deg, alt_m),
            Self::Stack(stack) => stack.at(lat_deg, lon_deg, alt_m),
            Self::Drape(drape) => drape.at_height(lat_deg, lon_deg, alt_m),
            Self::Projected(map) => map.at(lat_deg, lon_deg, alt_m),
        }
    }

    /// Whether the map changes with height; false for a flat map without a vertical derivative.
    pub fn has_upward_slope(&self) -> bool {
        match self {
            Self::Flat(map) => map.alt_m().is_some(),
            Self::Stack(_) | Self::Drape(_) => true,
            Self::Projected(map) => map.has_upward_slope(),
        }
    }

    /// Same as [`Self::at`], for many positions; positions without a value are NaN.
    ///
    /// # Errors
    /// Fails with [`MapGridError::Places`] for columns of different lengths.
    pub fn at_many(
        &self,
        lat_deg: &[f64],
        lon_deg: &[f64],
        alt_m: &[f64],
        out: &mut FieldColumns,
    ) -> Result<(), MapGridError> {
        match self {
            Self::Flat(map) => map.at_heights(lat_deg, lon_deg, alt_m, out),
            Self::Stack(stack) => stack.at_many(lat_deg, lon_deg, alt_m, out),
            Self::Drape(drape) => drape.at_heights(lat_deg, lon_deg, alt_m, out),
            Self::Projected(map) => map.at_many(lat_deg, lon_deg, alt_m, out),
        }
    }
}

#[cfg(test)]
mod tests;
