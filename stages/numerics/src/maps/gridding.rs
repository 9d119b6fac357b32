//! From survey points to a grid: cleaning, blocks, minimum curvature or equivalent sources, masking and
//! cross-validation.
//!
//! Positions are eastings and northings on one plane, and heights, all in metres. Values are magnetic anomalies in nT,
//! without the core field and the diurnal variation. Results are bit-identical for any number of threads.

mod automatic;
mod block;
mod clusters;
mod cross_validation;
mod equivalent;
mod far;
mod far_field;
mod kernel;
mod layer;
mod minimum_curvature;
mod nearest;
mod normal;
mod plane;
mod sheet;
mod surface;
mod survey;
mod windows;

#[cfg(test)]
mod tests;

pub use automatic::{block_m, layers, line_spacing_m};
pub use block::{BlockReduction, SurveyBlocks, reduce_blocks};
pub use cross_validation::{CrossValidation, DifferenceStatistics, LineFolds, cross_validate, expected_error};
pub use equivalent::{EquivalentSources, FieldGradients};
pub use far::far_points;
pub use layer::{SourceFitOptions, SourceLayer, SourceLayerReport};
pub use minimum_curvature::minimum_curvature;
pub use nearest::PointCellIndex;
pub use sheet::{RelaxationOptions, RelaxationReport};
pub use surface::{FittedSurface, SurveySurface, fit};
pub use survey::{CleaningOptions, CleaningOutcome, OwnedSurveyPoints, SurveyPoints, clean};

use crate::maps::plane_grid::{EvenAxis, PlaneGrid};
use rayon::prelude::*;

/// Progress callback, which receives the name of the current step, the number of units done, and their total.
pub type GriddingProgress<'a> = &'a (dyn Fn(&str, usize, usize) + Sync);

/// Error of gridding points.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GriddingError {
    /// There is no finite point to grid.
    #[error("there are no finite points to grid")]
    NoPoints,
    /// Columns of points have different lengths.
    #[error("the columns of points have different lengths: {lengths:?}")]
    Lengths {
        /// Lengths of the columns.
        lengths: Vec<usize>,
    },
    /// A position or a value is not a finite number.
    #[error("point {index} is not finite")]
    NotFinite {
        /// Index of the value.
        index: usize,
    },
    /// An option is out of its valid range.
    #[error("`{name}` is {value}, but must be {must}")]
    Option {
        /// The option.
        name: &'static str,
        /// Value of the option.
        value: f64,
        /// Valid range of the option.
        must: &'static str,
    },
    /// The grid would have too many nodes.
    #[error("the grid would have {nodes} nodes, more than {most}; widen its spacing or narrow its region")]
    TooLarge {
        /// The requested number of nodes.
        nodes: f64,
        /// The limit.
        most: usize,
    },
    /// A position lies below the equivalent sources or too close above them.
    #[error(
        "the field at easting {:.0} m, northing {:.0} m, {height_m} m high is not available: it is defined above the \
         equivalent sources beneath the points, from {lowest_m:.1} m up for all requested positions", at_m[0], at_m[1]
    )]
    BelowSources {
        /// The position's height, in metres.
        height_m: f64,
        /// The position's easting and northing, in metres.
        at_m: [f64; 2],
        /// The lowest height that is valid at all positions, in metres.
        lowest_m: f64,
    },
}

/// The maximum number of nodes of a grid: 2 GB of values.
const MOST_NODES: usize = 1 << 28;

/// Method of gridding: model of the surface between the points.
#[derive(Clone, Debug, PartialEq)]
pub enum GriddingMethod {
    /// Surface of minimum curvature at the flight heights.
    MinimumCurvature(RelaxationOptions),
    /// Equivalent sources.
    EquivalentSources {
        /// Layers of sources; `None` derives them from the spacing of the points, see `layers`.
        layers: Option<Vec<SourceLayer>>,
        /// The damping, see `SourceFitOptions`.
        damping: f64,
        /// Height of the grid, in metres. `None` is the height of the highest point, the lowest level above all
        /// measurements.
        level_m: Option<f64>,
    },
}

impl GriddingMethod {
    /// Minimum curvature with a tension of 0.25, the usual value for potential fields, and a tolerance of 0.1 nT.
    pub fn minimum_curvature() -> Self {
        Self::MinimumCurvature(RelaxationOptions { tension: 0.25, tolerance_nt: 0.1, passes: 5000 })
    }

    /// Equivalent sources with layers and level from the data and a damping of 1.
    pub fn equivalent_sources() -> Self {
        Self::EquivalentSources { layers: None, damping: 1.0, level_m: None }
    }
}

/// A rectangle on the plane, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridRegion {
    /// Least and greatest easting.
    pub east_m: [f64; 2],
    /// Least and greatest northing.
    pub north_m: [f64; 2],
}

/// Settings of gridding.
#[derive(Clone, Debug, PartialEq)]
pub struct GriddingOptions {
    /// Method of gridding.
    pub method: GriddingMethod,
    /// The distance between nodes, in metres; `None` is half the distance between lines.
    pub spacing_m: Option<f64>,
    /// Rectangle of the grid; `None` is the bounding rectangle of the points, widened to whole spacings.
    pub region: Option<GridRegion>,
    /// Side of the blocks to which points are reduced, in metres. `None` is a quarter of the distance between lines, at
    /// most 200 m; zero keeps every point.
    pub block_m: Option<f64>,
    /// Limit in metres: nodes that are farther than this from every point are unknown. `None` is twice the distance
    /// between lines; infinity keeps all nodes.
    pub mask_m: Option<f64>,
    /// Cleaning criteria.
    pub clean: CleaningOptions,
    /// Limit of a block's residual, in robust standard deviations of the residuals of the blocks around it. Blocks with
    /// larger residuals are excluded and the surface is fitted again; zero keeps all.
    pub misfit_sigmas: f64,
    /// Folds of lines for the map of the expected error; `None` computes no such map.
    pub folds: Option<LineFolds>,
}

impl GriddingOptions {
    /// Options for a method. All other options are derived from the data, and there is no cross-validation.
    pub fn new(method: GriddingMethod) -> Self {
        Self {
            method,
            spacing_m: None,
            region: None,
            block_m: None,
            mask_m: None,
            clean: CleaningOptions::default(),
            misfit_sigmas: 0.0,
            folds: None,
        }
    }
}

/// Statistics of a gridding run.
#[derive(Clone, Debug, PartialEq)]
pub struct GriddingReport {
    /// The counts of cleaning.
    pub cleaned: CleaningOutcome,
    /// The median distance between lines, in metres.
    pub line_spacing_m: f64,
    /// The side of the blocks, in metres.
    pub block_m: f64,
    /// The number of blocks.
    pub blocks: usize,
    /// Eastings and northings, in metres, of the blocks that were excluded because of their residuals.
    pub misfits: Vec<[f64; 2]>,
    /// Statistics of the blocks' residuals from the surface.
    pub misfit: DifferenceStatistics,
    /// The layers of equivalent sources; empty for minimum curvature.
    pub layers: Vec<SourceLayerReport>,
    /// The relaxation of minimum curvature.
    pub relaxed: Option<RelaxationReport>,
    /// Level of the grid, in metres; `None` for minimum curvature, whose values are at the flight heights.
    pub level_m: Option<f64>,
    /// Largest error of the far-field summation at a hundred nodes, in nT; `None` for minimum curvature.
    pub summation_error_nt: Option<f64>,
    /// Number of masked nodes.
    pub masked: usize,
    /// Statistics of the differences at omitted lines.
    pub cross_validation: Option<DifferenceStatistics>,
}

/// A grid, the expected error at each node, and the report.
#[derive(Clone, Debug, PartialEq)]
pub struct GriddingResult {
    /// Values, in nT.
    pub grid: PlaneGrid,
    /// Expected error, in nT.
    pub error: Option<PlaneGrid>,
    /// The report.
    pub report: GriddingReport,
}

/// Cleans and grids the points of a survey.
///
/// # Errors
/// Returns the errors of [`check`], of [`fit`] for the points that cleaning keeps, of [`FittedSurface::grid`] and, if
/// there are folds, of [`cross_validate`].
pub fn grid(
    points: SurveyPoints,
    options: &GriddingOptions,
    progress: GriddingProgress,
) -> Result<GriddingResult, GriddingError> {
    check(options)?;
    progress("cleaning", 0, 1);
    let cleaned = clean(points, &options.clean);
    let kept = points.pick(&cleaned.kept);
    let fitted = fit(kept.borrow(), options, progress)?;
    let axes = fitted.axes;
    progress("grid", 0, 1);
    let (mut map, level) = fitted.grid()?;
    let mask_m = options.mask_m.unwrap_or(2.0 * fitted.line_spacing_m);
    let masked = mask(&mut map, &kept.easting_m, &kept.northing_m, mask_m);
    progress("grid", 1, 1);
    let crossed = match &options.folds {
        Some(folds) => Some(cross_validate(kept.borrow(), options, folds, progress)?),
        None => None,
    };
    let error = crossed.as_ref().map(|crossed| {
        let mut error = expected_error(kept.borrow(), &crossed.difference_nt, axes, fitted.block_m);
        mask(&mut error, &kept.easting_m, &kept.northing_m, mask_m);
        error
    });
    let cross_validation = crossed.map(|crossed| crossed.spread);
    let report = fitted.report(cleaned, masked, level, cross_validation);
    Ok(GriddingResult { grid: map, error, report })
}

/// Checks the options before the points are read.
///
/// # Errors
/// Fails with [`GriddingError::Option`] for the first option that is out of its valid range.
pub fn check(options: &GriddingOptions) -> Result<(), GriddingError> {
    let must =
        |good: bool, name, value, must| if good { Ok(()) } else { Err(GriddingError::Option { name, value, must }) };
    let spacing = options.spacing_m.unwrap_or(1.0);
    must(spacing > 0.0 && spacing.is_finite(), "spacing_m", spacing, "above zero")?;
    let block_m = options.block_m.unwrap_or(0.0);
    must(block_m >= 0.0 && block_m.is_finite(), "block_m", block_m, "zero or above")?;
    let mask_m = options.mask_m.unwrap_or(0.0);
    must(mask_m >= 0.0, "mask_m", mask_m, "zero or above")?;
    match &options.method {
        GriddingMethod::MinimumCurvature(r) => {
            must((0.0..=1.0).contains(&r.tension), "tension", r.tension, "from 0 to 1")?;
            must(r.tolerance_nt > 0.0, "tolerance_nt", r.tolerance_nt, "above zero")
        }
        GriddingMethod::EquivalentSources { layers, damping, level_m } => {
            must(*damping > 0.0 && damping.is_finite(), "damping", *damping, "above zero")?;
            let level_m = level_m.unwrap_or(0.0);
            must(level_m.is_finite(), "level_m", level_m, "a finite number")?;
            let of = |f: fn(&SourceLayer) -> f64| layers.iter().flatten().map(f).fold(1.0, f64::min);
            let (depth, spacing) = (of(|l| l.depth_m), of(|l| l.spacing_m));
            must(depth > 0.0, "depth_m", depth, "above zero")?;
            must(spacing > 0.0, "spacing_m", spacing, "above zero")
        }
    }
}

/// Sets the nodes that are farther than `limit_m` from every point to unknown, and returns their number.
pub fn mask(grid: &mut PlaneGrid, easting_m: &[f64], northing_m: &[f64], limit_m: f64) -> usize {
    let near = PointCellIndex::new(easting_m, northing_m);
    let (east, north) = (grid.east_m, grid.north_m);
    let far: Vec<bool> = (0..grid.values.len())
        .into_par_iter()
        .map(|k| {
            let at = [east.at((k % east.len) as f64), north.at((k / east.len) as f64)];
            limit_m.is_finite() && near.nearest(at, 1, limit_m, |_| true).is_empty()
        })
        .collect();
    let masked = far.iter().filter(|f| **f).count();
    grid.values.iter_mut().zip(far).filter(|(_, far)| *far).for_each(|(v, _)| *v = f64::NAN);
    masked
}

/// Rejects columns of different lengths and points that are not finite.
fn check_columns(columns: &[&[f64]]) -> Result<(), GriddingError> {
    let lengths: Vec<usize> = columns.iter().map(|c| c.len()).collect();
    if lengths.windows(2).any(|two| two[0] != two[1]) {
        return Err(GriddingError::Lengths { lengths });
    }
    let first = columns.iter().filter_map(|c| c.iter().position(|v| !v.is_finite())).min();
    first.map_or(Ok(()), |index| Err(GriddingError::NotFinite { index }))
}

/// The axes of a region at a spacing; fails if there would be too many nodes.
fn axes(region: GridRegion, spacing_m: f64) -> Result<[EvenAxis; 2], GriddingError> {
    let sides = [region.east_m, region.north_m];
    let counts = sides.map(|[a, b]| ((b - a) / spacing_m + 1e-9).floor() + 1.0);
    let nodes = counts[0] * counts[1];
    if !(counts.iter().all(|n| *n >= 1.0) && nodes <= MOST_NODES as f64) {
        return Err(GriddingError::TooLarge { nodes, most: MOST_NODES });
    }
    Ok([0, 1].map(|a| EvenAxis { first: sides[a][0], step: spacing_m, len: counts[a] as usize }))
}
