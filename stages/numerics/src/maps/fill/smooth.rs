//! The smooth surface through a gap.

use super::cut::bounding_box;
use super::multigrid::{MultigridCycle, MultigridFrame, MultigridLevel};
use super::{FillError, check};
use crate::maps::plane_grid::PlaneGrid;
use rayon::prelude::*;
use std::ops::Range;

/// Width, in nodes, of the surroundings of the gaps that are kept: the reach of two applications of the Laplace
/// operator.
const RIM: usize = 2;

/// Settings for filling gaps with a smooth surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothFill {
    /// Whether the surface also continues the slope at the edge of the gap.
    ///
    /// If false, the surface is harmonic (Laplace's equation): never above or below the known values around the gap,
    /// with a kink at the edge. If true, the result is the surface of minimum curvature (the biharmonic equation): no
    /// kink, but it can overshoot in a gap wider than the anomalies around it. [Briggs 1974]
    pub keep_slope: bool,
    /// The error at which the iteration stops, as a fraction of the range of the known values. The error is estimated
    /// as the change that one further multigrid cycle would make. For a surface of minimum curvature the remaining
    /// error may be some four times larger.
    pub tolerance: f64,
    /// The maximum number of iterations.
    pub max_iterations: usize,
}

impl Default for SmoothFill {
    /// Harmonic surface, with a tolerance of a millionth of the range.
    fn default() -> Self {
        Self { keep_slope: false, tolerance: 1e-6, max_iterations: 2000 }
    }
}

/// The statistics of filling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothFillReport {
    /// The number of filled nodes.
    pub filled: usize,
    /// The number of iterations.
    pub iterations: usize,
    /// Remaining error estimated by multigrid, as a fraction of the range of the known values.
    pub error: f64,
}

/// Replaces the unknown nodes by a smooth surface through the known nodes, which do not change. The border of the map
/// is free: the surface has zero slope across it.
///
/// The surface is computed by conjugate gradients with a multigrid cycle as preconditioner. A harmonic surface needs
/// some fifteen iterations for any width of the gap. For minimum curvature the number of iterations grows with the
/// width of the gap: some 60 for 80 nodes and 1000 for 600 nodes. The method is therefore suitable for gaps up to about
/// a hundred nodes wide. Memory is some 70 bytes per node of the rectangle around the gaps. Results are bit-identical
/// for any number of threads.
///
/// # Errors
/// Fails if the map is invalid or has no known node, if a parameter is out of its valid range, or if the tolerance is
/// not reached.
pub fn smooth(grid: &PlaneGrid, options: &SmoothFill) -> Result<(PlaneGrid, SmoothFillReport), FillError> {
    check(grid)?;
    let tolerance = options.tolerance;
    if tolerance.is_nan() || tolerance <= 0.0 {
        return Err(FillError::Parameter { name: "the tolerance", value: tolerance });
    }
    let Some(window) = GapWindow::from_grid(grid) else {
        return Ok((grid.clone(), SmoothFillReport { filled: 0, iterations: 0, error: 0.0 }));
    };
    let known = grid.values.iter().filter(|value| !value.is_nan());
    let (least, greatest) = known.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
    let mut problem = GapProblem::new(grid, &window, 0.5 * (least + greatest));
    let scale = if greatest > least { greatest - least } else { 1.0 };
    let mut report = problem.solve(&HarmonicOperator, scale, options)?;
    if options.keep_slope {
        let bending = BiharmonicOperator::new(&problem);
        let more = problem.solve(&bending, scale, options)?;
        report = SmoothFillReport { iterations: report.iterations + more.iterations, ..more };
    }
    let mut values = grid.values.clone();
    let bounds = if options.keep_slope { (f64::NEG_INFINITY, f64::INFINITY) } else { (least, greatest) };
    let filled = problem.write(grid.columns(), &window, bounds, &mut values);
    Ok((grid.with(values), SmoothFillReport { filled, ..report }))
}

/// The rows and columns that contain all gaps and the known nodes around them.
struct GapWindow {
    rows: Range<usize>,
    columns: Range<usize>,
}

impl GapWindow {
    fn from_grid(grid: &PlaneGrid) -> Option<Self> {
        let (rows, columns) = bounding_box(grid, |value| value.is_nan())?;
        let wider = |range: Range<usize>, len: usize| range.start.saturating_sub(RIM)..(range.end + RIM).min(len);
        Some(Self { rows: wider(rows, grid.rows()), columns: wider(columns, grid.columns()) })
    }

    fn frame(&self) -> MultigridFrame {
        MultigridFrame { rows: self.rows.len(), columns: self.columns.len() }
    }
}

/// Symmetric positive operator on the unknown nodes, and its approximate inverse.
trait SurfaceOperator {
    /// `out = A x`, for the unknown nodes only.
    fn apply(&self, problem: &GapProblem, x: &[f64], out: &mut [f64]);
    /// Computes `out`, an approximate solution of `A out = b`.
    fn precondition(&self, problem: &mut GapProblem, b: &[f64], out: &mut [f64]);
    /// The residual of `0 = A u` for the current values u of known and unknown nodes.
    fn residual(&self, problem: &GapProblem) -> Vec<f64>;
}

/// Linear system of a window of the map, whose values are relative to the middle of their range.
struct GapProblem {
    unknown: Vec<bool>,
    level: MultigridLevel,
    cycle: Option<MultigridCycle>,
    values: Vec<f64>,
    middle: f64,
    joints: (f64, f64),
}

impl GapProblem {
    fn new(grid: &PlaneGrid, window: &GapWindow, middle: f64) -> Self {
        let frame = window.frame();
        let (mut unknown, mut values) = (vec![false; frame.nodes()], vec![0.0; frame.nodes()]);
        for (to_row, row) in window.rows.clone().enumerate() {
            let from = &grid.values[row * grid.columns()..][window.columns.clone()];
            for (column, value) in from.iter().enumerate() {
                let at = frame.index(to_row, column);
                unknown[at] = value.is_nan();
                values[at] = if value.is_nan() { 0.0 } else { value - middle };
            }
        }
        let joints = (grid.north_m.step / grid.east_m.step, grid.east_m.step / grid.north_m.step);
        let level = MultigridLevel::new(frame, &unknown, joints.0, joints.1);
        let cycle = Some(MultigridCycle::new(&level));
        Self { unknown, level, cycle, values, middle, joints }
    }

    /// Level with all nodes coupled, known or not.
    fn open_level(&self) -> MultigridLevel {
        MultigridLevel::new(self.level.frame, &vec![true; self.unknown.len()], self.joints.0, self.joints.1)
    }

    /// One multigrid cycle.
    fn cycle(&mut self, b: &[f64], out: &mut [f64]) {
        if let Some(mut cycle) = self.cycle.take() {
            cycle.solve(&self.level, b, out);
            self.cycle = Some(cycle);
        }
    }

    fn dot(&self, a: &[f64], b: &[f64]) -> f64 {
        let width = self.level.frame.width();
        let row = |(a, b): (&[f64], &[f64])| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let rows: Vec<f64> = a.par_chunks_exact(width).zip(b.par_chunks_exact(width)).map(row).collect();
        rows.iter().sum()
    }

    fn keep_unknown(&self, x: &mut [f64]) {
        x.par_iter_mut().zip(&self.unknown).for_each(|(x, unknown)| *x = if *unknown { *x } else { 0.0 });
    }

    /// Conjugate gradients until the error estimated by the multigrid cycle is within the tolerance.
    fn solve(
        &mut self,
        surface: &impl SurfaceOperator,
        scale: f64,
        options: &SmoothFill,
    ) -> Result<SmoothFillReport, FillError> {
        let nodes = self.values.len();
        let mut left = surface.residual(self);
        let (mut guess, mut way, mut image) = (vec![0.0; nodes], vec![0.0; nodes], vec![0.0; nodes]);
        let (mut before, mut error) = (0.0, f64::INFINITY);
        for iterations in 0..=options.max_iterations {
            surface.precondition(self, &left, &mut guess);
            error = guess.par_iter().map(|x| x.abs()).reduce(|| 0.0, f64::max) / scale;
            if error <= options.tolerance {
                return Ok(SmoothFillReport { filled: 0, iterations, error });
            }
            let now = self.dot(&left, &guess);
            let keep = if iterations > 0 { now / before } else { 0.0 };
            way.par_iter_mut().zip(&guess).for_each(|(way, guess)| *way = guess + keep * *way);
            surface.apply(self, &way, &mut image);
            let far = now / self.dot(&way, &image);
            self.values.par_iter_mut().zip(&way).for_each(|(x, way)| *x += far * way);
            left.par_iter_mut().zip(&image).for_each(|(left, image)| *left -= far * image);
            before = now;
        }
        let (tolerance, iterations) = (options.tolerance, options.max_iterations);
        Err(FillError::NotReached { tolerance, reached: error, iterations })
    }

    /// Writes the unknown nodes into the map's values, and returns their number.
    fn write(&self, width: usize, window: &GapWindow, bounds: (f64, f64), values: &mut [f64]) -> usize {
        let frame = self.level.frame;
        let mut filled = 0;
        for (from_row, row) in window.rows.clone().enumerate() {
            let to = &mut values[row * width..][window.columns.clone()];
            for (column, value) in to.iter_mut().enumerate().filter(|(_, value)| value.is_nan()) {
                *value = (self.values[frame.index(from_row, column)] + self.middle).clamp(bounds.0, bounds.1);
                filled += 1;
            }
        }
        filled
    }
}

/// The Laplace operator over the gap, for a harmonic surface.
struct HarmonicOperator;

impl SurfaceOperator for HarmonicOperator {
    fn apply(&self, problem: &GapProblem, x: &[f64], out: &mut [f64]) {
        problem.level.apply(x, out);
    }

    fn precondition(&self, problem: &mut GapProblem, b: &[f64], out: &mut [f64]) {
        problem.cycle(b, out);
    }

    fn residual(&self, problem: &GapProblem) -> Vec<f64> {
        let mut left = vec![0.0; problem.values.len()];
        problem.open_level().apply(&problem.values, &mut left);
        left.par_iter_mut().for_each(|left| *left = -*left);
        problem.keep_unknown(&mut left);
        left
    }
}

/// The biharmonic operator over the gap and its edge, for a surface of minimum curvature.
struct BiharmonicOperator {
    open: MultigridLevel,
}

impl BiharmonicOperator {
    fn new(problem: &GapProblem) -> Self {
        Self { open: problem.open_level() }
    }

    fn twice(&self, problem: &GapProblem, x: &[f64], out: &mut [f64]) {
        let mut once = vec![0.0; x.len()];
        self.open.apply(x, &mut once);
        self.open.apply(&once, out);
        problem.keep_unknown(out);
    }
}

impl SurfaceOperator for BiharmonicOperator {
    fn apply(&self, problem: &GapProblem, x: &[f64], out: &mut [f64]) {
        self.twice(problem, x, out);
    }

    fn precondition(&self, problem: &mut GapProblem, b: &[f64], out: &mut [f64]) {
        let mut once = vec![0.0; b.len()];
        problem.cycle(b, &mut once);
        problem.cycle(&once, out);
    }

    fn residual(&self, problem: &GapProblem) -> Vec<f64> {
        let mut left = vec![0.0; problem.values.len()];
        self.twice(problem, &problem.values, &mut left);
        left.par_iter_mut().for_each(|left| *left = -*left);
        left
    }
}
