//! A surface fitted to a survey, by equivalent sources or minimum curvature.

use super::automatic::{block_m, layers, line_spacing_m};
use super::block::{BlockReduction, SurveyBlocks, reduce_blocks};
use super::cross_validation::DifferenceStatistics;
use super::equivalent::EquivalentSources;
use super::layer::{SourceFitOptions, SourceLayerReport};
use super::minimum_curvature::minimum_curvature;
use super::nearest::{PointCellIndex, range};
use super::sheet::RelaxationReport;
use super::survey::{CleaningOutcome, SurveyPoints};
use super::{
    GridRegion, GriddingError, GriddingMethod, GriddingOptions, GriddingProgress, GriddingReport, axes, check,
    check_columns,
};
use crate::maps::plane_grid::{EvenAxis, PlaneGrid};
use crate::regression::statistics::median;
use rayon::prelude::*;

/// Number of surrounding blocks that determine the typical misfit.
const AROUND: usize = 32;

/// Fitted surface: equivalent sources or a grid of minimum curvature.
pub enum SurveySurface {
    /// Equivalent sources, and the requested level.
    Sources(EquivalentSources, f64),
    /// A grid of minimum curvature.
    Grid(PlaneGrid),
}

/// A fitted surface and its data.
pub struct FittedSurface {
    /// The surface.
    pub surface: SurveySurface,
    /// The axes of its grid, east and north.
    pub axes: [EvenAxis; 2],
    /// The median distance between lines, in metres.
    pub line_spacing_m: f64,
    /// The side of the blocks, in metres.
    pub block_m: f64,
    /// The blocks.
    pub blocks: SurveyBlocks,
    layers: Vec<SourceLayerReport>,
    relaxed: Option<RelaxationReport>,
    misfits: Vec<[f64; 2]>,
    misfit: DifferenceStatistics,
}

/// Fits a surface to the points of a survey, all of them finite: see `clean`.
///
/// # Errors
/// Fails without points, or for columns of different lengths or values that are not finite. Also returns the errors of
/// [`check`]. Also fails with [`GriddingError::TooLarge`] for a grid without nodes or with too many, or with
/// [`GriddingError::BelowSources`] if the level or a block is not above the equivalent sources near it.
pub fn fit(
    points: SurveyPoints,
    options: &GriddingOptions,
    progress: GriddingProgress,
) -> Result<FittedSurface, GriddingError> {
    if points.is_empty() {
        return Err(GriddingError::NoPoints);
    }
    check(options)?;
    check_columns(&[points.easting_m, points.northing_m, points.height_m, points.value_nt])?;
    let spacing = line_spacing_m(points);
    let block = options.block_m.unwrap_or_else(|| block_m(spacing));
    let n = points.len();
    let columns = [points.easting_m, points.northing_m, points.height_m, points.value_nt].map(|c| &c[..n]);
    let node_m = options.spacing_m.unwrap_or(0.5 * spacing);
    let [east_m, north_m] = [0, 1].map(|a| {
        let [low, high] = range(columns[a]);
        [(low / node_m).floor() * node_m, (high / node_m).ceil() * node_m]
    });
    let axes = axes(options.region.unwrap_or(GridRegion { east_m, north_m }), node_m)?;
    let mut fitted = FittedSurface {
        surface: SurveySurface::Grid(PlaneGrid { east_m: axes[0], north_m: axes[1], values: Vec::new() }),
        axes,
        line_spacing_m: spacing,
        block_m: block,
        blocks: reduce_blocks(columns, block, BlockReduction::Median),
        layers: Vec::new(),
        relaxed: None,
        misfits: Vec::new(),
        misfit: DifferenceStatistics::from_differences(&[]),
    };
    let mut rest = fitted.again(options, progress)?;
    let out = misfits(&fitted.blocks, &rest, options);
    if !out.is_empty() {
        fitted.leave_out(&out);
        rest = fitted.again(options, progress)?;
    }
    fitted.misfit = DifferenceStatistics::from_differences(&rest);
    Ok(fitted)
}

impl FittedSurface {
    /// Fits the surface to the blocks and returns their residuals.
    fn again(&mut self, options: &GriddingOptions, progress: GriddingProgress) -> Result<Vec<f64>, GriddingError> {
        let b = &self.blocks;
        let predicted = match &options.method {
            GriddingMethod::MinimumCurvature(relaxation) => {
                progress("minimum curvature", 0, 1);
                let (grid, relaxed) =
                    minimum_curvature([&b.easting_m, &b.northing_m], &b.value_nt, self.axes, relaxation);
                progress("minimum curvature", 1, 1);
                self.relaxed = Some(relaxed);
                let values = between_nodes(&grid, &b.easting_m, &b.northing_m);
                self.surface = SurveySurface::Grid(grid);
                values
            }
            GriddingMethod::EquivalentSources { layers: given, damping, level_m } => {
                let sides = [&b.easting_m, &b.northing_m].map(|axis| range(axis));
                let extent = sides.map(|[a, b]| b - a).into_iter().fold(0.0, f64::max);
                let layers = given.clone().unwrap_or_else(|| layers(self.block_m, self.line_spacing_m, extent));
                let options = SourceFitOptions { layers, damping: *damping, iterations: 20, tolerance: 0.01 };
                let at = [&b.easting_m[..], &b.northing_m, &b.height_m];
                progress("placing equivalent sources", 0, 1);
                let mut sources = EquivalentSources::place(at, &b.value_nt, &options.layers)?;
                if let Some(level_m) = level_m {
                    // The level is checked before the fit, because the fit is slow.
                    let [east, north] = nodes(self.axes);
                    sources.check_above([&east, &north, &vec![*level_m; east.len()]])?;
                }
                self.layers = sources.solve(at, &b.value_nt, &options, progress)?;
                let values = sources.predict(at)?;
                self.surface = SurveySurface::Sources(sources, level_m.unwrap_or(range(&b.height_m)[1]));
                values
            }
        };
        Ok(b.value_nt.iter().zip(predicted).map(|(v, p)| v - p).collect())
    }

    fn leave_out(&mut self, out: &[usize]) {
        let b = &self.blocks;
        self.misfits = out.iter().map(|&i| [b.easting_m[i], b.northing_m[i]]).collect();
        let kept: Vec<usize> = (0..b.value_nt.len()).filter(|i| out.binary_search(i).is_err()).collect();
        let take = |column: &[f64]| kept.iter().map(|&i| column[i]).collect();
        self.blocks = SurveyBlocks {
            easting_m: take(&b.easting_m),
            northing_m: take(&b.northing_m),
            height_m: take(&b.height_m),
            value_nt: take(&b.value_nt),
            points: kept.iter().map(|&i| b.points[i]).collect(),
        };
    }

    /// Values at the positions of points. With minimum curvature, the values hold at any height and are NaN off the
    /// grid. With equivalent sources, they are NaN at points below the sources of neighbouring points.
    ///
    /// # Errors
    /// With equivalent sources, fails for columns of different lengths and for values that are not finite.
    pub fn at_points(&self, points: SurveyPoints) -> Result<Vec<f64>, GriddingError> {
        match &self.surface {
            SurveySurface::Sources(sources, _) => {
                sources.predict_above([points.easting_m, points.northing_m, points.height_m])
            }
            SurveySurface::Grid(grid) => Ok(between_nodes(grid, points.easting_m, points.northing_m)),
        }
    }

    /// The grid. With equivalent sources, also returns the level of the grid in metres, and the largest error of the
    /// far-field summation at a hundred nodes, in nT.
    ///
    /// # Errors
    /// With equivalent sources, returns the errors of [`EquivalentSources::predict`] at the nodes.
    pub fn grid(&self) -> Result<(PlaneGrid, Option<[f64; 2]>), GriddingError> {
        let [east_m, north_m] = self.axes;
        match &self.surface {
            SurveySurface::Grid(grid) => Ok((grid.clone(), None)),
            SurveySurface::Sources(sources, level_m) => {
                let [east, north] = nodes(self.axes);
                let at = [&east[..], &north, &vec![*level_m; east.len()]];
                let values = sources.predict(at)?;
                let error = sources.summation_error_nt(at, &values, 100);
                Ok((PlaneGrid { east_m, north_m, values }, Some([*level_m, error])))
            }
        }
    }

    pub(super) fn report(
        self,
        cleaned: CleaningOutcome,
        masked: usize,
        level: Option<[f64; 2]>,
        cross_validation: Option<DifferenceStatistics>,
    ) -> GriddingReport {
        GriddingReport {
            cleaned,
            line_spacing_m: self.line_spacing_m,
            block_m: self.block_m,
            blocks: self.blocks.value_nt.len(),
            misfits: self.misfits,
            misfit: self.misfit,
            layers: self.layers,
            relaxed: self.relaxed,
            level_m: level.map(|l| l[0]),
            summation_error_nt: level.map(|l| l[1]),
            masked,
            cross_validation,
        }
    }
}

/// Eastings and northings of a grid's nodes, by rows.
fn nodes([east_m, north_m]: [EvenAxis; 2]) -> [Vec<f64>; 2] {
    let count = east_m.len * north_m.len;
    let east = (0..count).map(|k| east_m.at((k % east_m.len) as f64)).collect();
    let north = (0..count).map(|k| north_m.at((k / east_m.len) as f64)).collect();
    [east, north]
}

/// Indices, ascending, of blocks whose residual is far larger than the residuals of their neighbours.
fn misfits(blocks: &SurveyBlocks, rest: &[f64], options: &GriddingOptions) -> Vec<usize> {
    if options.misfit_sigmas <= 0.0 || options.misfit_sigmas.is_nan() {
        return Vec::new();
    }
    let near = PointCellIndex::new(&blocks.easting_m, &blocks.northing_m);
    let out = |i: &usize| {
        let found = near.nearest([blocks.easting_m[*i], blocks.northing_m[*i]], AROUND, f64::INFINITY, |_| true);
        let mut sizes: Vec<f64> = found.iter().map(|f| rest[f.1].abs()).collect();
        let usual = 1.4826 * median(&mut sizes);
        rest[*i].abs() > (options.misfit_sigmas * usual).max(options.clean.floor_nt)
    };
    (0..rest.len()).into_par_iter().filter(out).collect()
}

/// Bilinear values between nodes; NaN off the grid.
fn between_nodes(grid: &PlaneGrid, easting_m: &[f64], northing_m: &[f64]) -> Vec<f64> {
    let value = |e: f64, n: f64| {
        let at = [grid.east_m.node(e), grid.north_m.node(n)];
        let most = [grid.columns(), grid.rows()].map(|n| n.saturating_sub(1) as f64);
        if !(at[0] >= 0.0 && at[1] >= 0.0 && at[0] <= most[0] && at[1] <= most[1]) {
            return f64::NAN;
        }
        let low = [0, 1].map(|a| at[a].floor().min(most[a] - 1.0).max(0.0));
        let [x, y] = [at[0] - low[0], at[1] - low[1]];
        let get = |c: usize, r: usize| {
            let inside = (low[0] as usize + c).min(most[0] as usize);
            grid.get((low[1] as usize + r).min(most[1] as usize), inside)
        };
        (1.0 - y) * ((1.0 - x) * get(0, 0) + x * get(1, 0)) + y * ((1.0 - x) * get(0, 1) + x * get(1, 1))
    };
    easting_m.iter().zip(northing_m).map(|(e, n)| value(*e, *n)).collect()
}
