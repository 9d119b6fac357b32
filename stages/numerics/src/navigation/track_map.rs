//! Map of a track: reduced-rank Gaussian-process regression on the measurements along a track with position errors.
//!
//! | Module | Contents |
//! |:--|:--|
//! | [`basis`] | basis functions of the anomaly |
//! | [`normal`] | the normal equations of their weights |
//! | [`hyper`] | the kernel's hyper-parameters by maximum likelihood |
//!
//! # Equations
//!
//! A measurement z at position x and time t, on line l of a flight, is
//!
//! ```text
//! z = m(x) + μ + S(t) + c_l + e
//! m ~ GP(0, k),    S ~ GP(0, σ_S² exp(−|t − t'|/τ)),    c_l ~ N(0, σ_c²),    e ~ N(0, v)
//! ```
//!
//! with the kernel k of [`slam`](crate::navigation::slam). The map is m + μ. The covariances of all pairs of
//! measurements are not used. Instead, m is a sum of M eigenfunctions of the Laplacian on a rectangle
//! ([`basis::LaplacianBasis`]). Their weights are independent, so the equations have M unknowns for any length of the
//! flight [Solin & Särkkä 2020]. Each measurement is added to sums of 4 M entries ([`normal::TrackMapSums`]); a single
//! matrix of order M is then factorised. S is linear between knots that are a quarter of τ apart, and has the
//! covariance of the process at the knots.
//!
//! The position of the track has an error with the covariance P. To first order, the position error contributes gᵀP g
//! to the variance of the measurement, where g is the slope of the map [McHutchon & Rasmussen 2011]. The slope comes
//! from a first solution without this contribution. Position errors persist for minutes. Therefore,
//!
//! - the inverse weights are v = σ_n² + gᵀP g n, because the n samples within a length of the kernel share their
//!   position error;
//! - the standard deviation of the map at a node is √(V + gᵀP g), where V is the variance of the regression and P is
//!   the position covariance of the nearest measurement. An error common to the whole track shifts the map as a whole
//!   and is not observable from any number of measurements.
//!
//! Heights that differ from the mean add the variance
//! [`AnomalyKernel::height_nt2`](crate::navigation::slam::AnomalyKernel). Waves shorter than the waves of the basis are
//! treated as white noise of the measurements and add to the variance of the map.

pub mod basis;
pub mod hyper;
pub mod normal;

use rayon::prelude::*;

use crate::inner_product::dot;
use crate::maps::gridding::PointCellIndex;
use crate::maps::plane_grid::EvenAxis;
use crate::navigation::ins_error::ParameterError;
use crate::navigation::slam::{AnomalyKernel, HyperparameterSource};
use basis::{LaplacianBasis, waves};
use hyper::TrackPieces;
use normal::{FieldVariance, TrackMapRow, TrackMapSolution, TrackMapSums};

/// Largest fraction of the variance that the basis may omit; above this fraction the area is too large.
const MOST_LACKING: f64 = 0.02;
/// Number of knots of the temporal variation per time constant.
const KNOTS: f64 = 4.0;
/// Maximum number of knots of all flights together; if a flight would need more, the spacing of its knots is larger.
const MOST_KNOTS: usize = 500;

/// Measurement of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackSample {
    /// Position east and north on the plane of the map, in metres.
    pub at_m: [f64; 2],
    /// Height, in metres.
    pub alt_m: f64,
    /// Time, in seconds.
    pub tt_s: f64,
    /// Anomaly, in nT.
    pub value_nt: f64,
    /// Variance of the white noise of the measurement, in addition to the noise of the kernel, in nT².
    pub variance_nt2: f64,
    /// Variances of the position east and north, and the covariance of both, in m².
    pub position_m2: [f64; 3],
    /// Index of the flight of the measurement, from 0.
    pub flight: usize,
    /// Index of the line of the measurement among the lines of all flights, from 0.
    pub line: usize,
}

/// Parameters of the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackMapParameters {
    /// Gaussian process of the anomaly; if the kernel is fitted, the start of the search.
    pub kernel: AnomalyKernel,
    /// Whether the kernel is fitted.
    pub hyperparameters: HyperparameterSource,
    /// Standard deviation (nT) and time constant (s) of the temporal variation; a standard deviation of 0 means no
    /// temporal variation.
    pub temporal: (f64, f64),
    /// Standard deviation of the constant of each line, in nT; 0 means no constant. If there is only one line, it has
    /// no constant.
    pub line_sigma_nt: f64,
    /// Maximum number of functions of the basis. Computing time grows with the third power of this number.
    pub most_functions: usize,
}

/// Reason why a map cannot be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrackMapError {
    /// There is no measurement.
    #[error("no measurement has a position")]
    Nothing,
    /// The kernel is invalid.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The basis would omit too much of the variance.
    #[error(
        "the area of {east_m:.0} by {north_m:.0} m is too large for a correlation length of {length_m:.0} m: \
         {functions} basis functions omit {lacking:.3} of the variance"
    )]
    TooLarge {
        /// Extent from west to east, in metres.
        east_m: f64,
        /// Extent from south to north, in metres.
        north_m: f64,
        /// Length of the kernel, in metres.
        length_m: f64,
        /// Maximum number of functions.
        functions: usize,
        /// Fraction of the variance that the basis functions omit.
        lacking: f64,
    },
    /// The normal equations are numerically singular.
    #[error("the equations of the map cannot be solved: the noise is too small compared with the anomaly")]
    Singular,
}

/// Report on the computation of the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackMapReport {
    /// Kernel of the map.
    pub kernel: AnomalyKernel,
    /// Whether the kernel was fitted. If this is false although a fit was requested, the track is too short or its
    /// measurements are constant. The given kernel was then used.
    pub fitted: bool,
    /// Number of measurements.
    pub samples: usize,
    /// Number of functions of the basis.
    pub functions: usize,
    /// Fraction of the variance that the basis omits.
    pub lacking: f64,
    /// Mean height of the measurements, in metres.
    pub alt_m: f64,
    /// Root mean square of the residuals, each divided by its assumed standard deviation; at most about 1 if the
    /// assumed noise is correct.
    pub misfit: f64,
}

/// Map of a track.
pub struct TrackMap {
    basis: LaplacianBasis,
    weights_nt: Vec<f64>,
    level_nt: f64,
    variance: FieldVariance,
    nearest: PointCellIndex,
    position_m2: Vec<[f64; 3]>,
    /// Report.
    pub report: TrackMapReport,
}

/// Node of the map: the anomaly and its standard deviation, both in nT; NaN outside the rectangle of the basis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackMapNode {
    /// Anomaly.
    pub value_nt: f64,
    /// Standard deviation.
    pub sd_nt: f64,
}

impl TrackMap {
    /// Computes a map from finite measurements. The samples of a line are contiguous and in time order. Results are
    /// bit-identical for any number of threads.
    ///
    /// # Errors
    /// Fails in the cases that [`TrackMapError`] lists.
    pub fn new(parameters: &TrackMapParameters, samples: &[TrackSample]) -> Result<Self, TrackMapError> {
        Self::with_kernel(parameters, kernel_of(parameters, samples)?, samples)
    }

    /// Map with the kernel `fitted`, which [`kernel_of`] computed, for example from more measurements. `None` uses
    /// `parameters.kernel`.
    ///
    /// # Errors
    /// Fails in the cases that [`TrackMapError`] lists.
    pub fn with_kernel(
        parameters: &TrackMapParameters,
        fitted: Option<AnomalyKernel>,
        samples: &[TrackSample],
    ) -> Result<Self, TrackMapError> {
        parameters.kernel.check()?;
        if samples.is_empty() {
            return Err(TrackMapError::Nothing);
        }
        let spacing_m = spacing(&lines_of(samples));
        let kernel = fitted.unwrap_or(parameters.kernel);
        let end = |axis: usize, pick: fn(f64, f64) -> f64| {
            samples.iter().map(|sample| sample.at_m[axis]).reduce(pick).unwrap_or_default()
        };
        let (low_m, high_m) = ([end(0, f64::min), end(1, f64::min)], [end(0, f64::max), end(1, f64::max)]);
        let basis = LaplacianBasis::new(&kernel, low_m, high_m, parameters.most_functions);
        let lacking = basis.lacking_nt2 / kernel.sigma_se_nt.powi(2);
        if lacking > MOST_LACKING {
            return Err(TrackMapError::TooLarge {
                east_m: high_m[0] - low_m[0],
                north_m: high_m[1] - low_m[1],
                length_m: kernel.length_m,
                functions: parameters.most_functions,
                lacking,
            });
        }
        let alt_m = samples.iter().map(|sample| sample.alt_m).sum::<f64>() / samples.len() as f64;
        let (mut rows, centre_nt) = rows(&basis, &kernel, samples, alt_m);
        let beside = NuisanceParameters::new(parameters, &kernel, samples);
        beside.enter(samples, &mut rows);
        let solve = |rows: &[TrackMapRow]| {
            let sums = TrackMapSums::new(&basis, rows, beside.columns);
            TrackMapSolution::solve(&basis, &sums, &beside.prior()).ok_or(TrackMapError::Singular)
        };
        let mut solution = solve(&rows)?;
        if samples.iter().any(|sample| sample.position_m2 != [0.0; 3]) {
            let together = (kernel.length_m / spacing_m).max(1.0);
            let slopes: Vec<[f64; 2]> =
                samples.par_iter().map(|sample| slope(&basis, &solution.weights_nt, sample.at_m)).collect();
            for ((row, sample), slope) in rows.iter_mut().zip(samples).zip(slopes) {
                row.weight = 1.0 / (1.0 / row.weight + together * moved(slope, sample.position_m2));
            }
            solution = solve(&rows)?;
        }
        let report = TrackMapReport {
            kernel,
            fitted: fitted.is_some(),
            samples: samples.len(),
            functions: basis.functions.len(),
            lacking,
            alt_m,
            misfit: misfit(&basis, &solution, &rows),
        };
        let of = |axis: usize| samples.iter().map(|sample| sample.at_m[axis]).collect::<Vec<f64>>();
        Ok(Self {
            variance: solution.variance(&basis),
            level_nt: centre_nt + solution.beside.first().copied().unwrap_or_default(),
            weights_nt: solution.weights_nt,
            nearest: PointCellIndex::new(&of(0), &of(1)),
            position_m2: samples.iter().map(|sample| sample.position_m2).collect(),
            basis,
            report,
        })
    }

    /// Nodes of a grid, by rows from the south, each row from west to east.
    pub fn on(&self, east_m: EvenAxis, north_m: EvenAxis) -> Vec<TrackMapNode> {
        let basis = &self.basis;
        let table = |axis: usize, at: EvenAxis| -> Vec<BasisWaves> {
            at.coordinates().iter().map(|x| BasisWaves::new(basis, axis, *x)).collect()
        };
        let (east, north) = (table(0, east_m), table(1, north_m));
        let [m1, m2] = basis.most;
        let dense = |of: &[f64]| {
            let mut all = vec![0.0; m1 * m2];
            for ([a, b], x) in basis.functions.iter().zip(of) {
                all[(a - 1) * m2 + b - 1] = *x;
            }
            all
        };
        let (weights, with_level) = (dense(&self.weights_nt), dense(&self.variance.with_level));
        let row = |n: &BasisWaves| -> Vec<TrackMapNode> {
            let value = along(&weights, &n.sines);
            let d_north = along(&weights, &n.slopes);
            let level = along(&with_level, &n.sines);
            let variance = along(&self.variance.cosines, &n.cosines);
            let node = |e: &BasisWaves| {
                let at_m = [e.at_m, n.at_m];
                if !basis.holds(at_m) {
                    return TrackMapNode { value_nt: f64::NAN, sd_nt: f64::NAN };
                }
                let regression = dot(&variance, &e.cosines) + dot(&level, &e.sines) + self.variance.level_nt2;
                let nearest = self.nearest.nearest(at_m, 1, f64::INFINITY, |_| true);
                let position_m2 = nearest.first().map_or([0.0; 3], |(_, i)| self.position_m2[*i]);
                let slope = [dot(&value, &e.slopes), dot(&d_north, &e.sines)];
                let shorter = basis.lacking_nt2;
                // Rounding may make the variance at a measurement without noise negative.
                let variance = regression.max(0.0) + shorter + moved(slope, position_m2);
                TrackMapNode { value_nt: self.level_nt + dot(&value, &e.sines), sd_nt: variance.sqrt() }
            };
            east.iter().map(node).collect()
        };
        north.par_iter().map(row).collect::<Vec<_>>().concat()
    }
}

/// Fits the kernel to measurements; `None` if no fit is requested, or if the measurements are too few or constant.
///
/// # Errors
/// Fails for an invalid start kernel.
pub fn kernel_of(
    parameters: &TrackMapParameters,
    samples: &[TrackSample],
) -> Result<Option<AnomalyKernel>, TrackMapError> {
    parameters.kernel.check()?;
    let lines = lines_of(samples);
    Ok(match parameters.hyperparameters {
        HyperparameterSource::Fixed => None,
        HyperparameterSource::Fitted => {
            TrackPieces::new(&lines, spacing(&lines)).fitted(&parameters.kernel, parameters.temporal)
        }
    })
}

fn lines_of(samples: &[TrackSample]) -> Vec<&[TrackSample]> {
    samples.chunk_by(|a, b| a.line == b.line).collect()
}

/// Sines and cosines of the basis functions at a coordinate.
struct BasisWaves {
    at_m: f64,
    cosines: Vec<f64>,
    sines: Vec<f64>,
    /// Derivatives of the sines, per m.
    slopes: Vec<f64>,
}

impl BasisWaves {
    fn new(basis: &LaplacianBasis, axis: usize, at_m: f64) -> Self {
        let most = basis.most[axis];
        let (mut cosines, mut sines) = (vec![0.0; 2 * most + 1], vec![0.0; most]);
        waves(basis.angle(at_m, axis), &mut cosines, &mut sines);
        let per_m = basis.angle_per_m(axis);
        let slopes = (1..=most).map(|j| j as f64 * per_m * cosines[j]).collect();
        Self { at_m, cosines, sines, slopes }
    }
}

/// Product of a matrix, by rows, with a vector.
fn along(matrix: &[f64], vector: &[f64]) -> Vec<f64> {
    matrix.chunks_exact(vector.len()).map(|row| dot(row, vector)).collect()
}

/// Variance due to a position error on a slope of the field, in nT².
fn moved([east, north]: [f64; 2], [ee, nn, en]: [f64; 3]) -> f64 {
    (east * east * ee + north * north * nn + 2.0 * east * north * en).max(0.0)
}

/// Mean distance between neighbouring samples of a line, in metres; 0 if no line has two samples.
fn spacing(lines: &[&[TrackSample]]) -> f64 {
    let step = |pair: &[TrackSample]| (pair[1].at_m[0] - pair[0].at_m[0]).hypot(pair[1].at_m[1] - pair[0].at_m[1]);
    let path_m: f64 = lines.iter().flat_map(|line| line.windows(2)).map(step).sum();
    let steps: usize = lines.iter().map(|line| line.len() - 1).sum();
    path_m / steps.max(1) as f64
}

/// Rows of the normal equations, and the mean that is subtracted from the values.
fn rows(
    basis: &LaplacianBasis,
    kernel: &AnomalyKernel,
    samples: &[TrackSample],
    alt_m: f64,
) -> (Vec<TrackMapRow>, f64) {
    let weight = |sample: &TrackSample| {
        let white = sample.variance_nt2 + kernel.sigma_n_nt.powi(2) + basis.lacking_nt2;
        1.0 / (white + kernel.height_nt2(sample.alt_m - alt_m))
    };
    let weights: f64 = samples.iter().map(weight).sum();
    let centre_nt = samples.iter().map(|sample| weight(sample) * sample.value_nt).sum::<f64>() / weights;
    let row = |sample: &TrackSample| TrackMapRow {
        at_m: sample.at_m,
        value_nt: sample.value_nt - centre_nt,
        weight: weight(sample),
        beside: vec![],
    };
    (samples.iter().map(row).collect(), centre_nt)
}

/// Slope of the field at a position, in nT/m.
fn slope(basis: &LaplacianBasis, weights_nt: &[f64], at_m: [f64; 2]) -> [f64; 2] {
    let [e, n] = [0, 1].map(|axis: usize| BasisWaves::new(basis, axis, at_m[axis]));
    let mut slope = [0.0; 2];
    for ([a, b], weight) in basis.functions.iter().zip(weights_nt) {
        slope[0] += weight * e.slopes[a - 1] * n.sines[b - 1];
        slope[1] += weight * e.sines[a - 1] * n.slopes[b - 1];
    }
    slope
}

/// See [`TrackMapReport::misfit`].
fn misfit(basis: &LaplacianBasis, solution: &TrackMapSolution, rows: &[TrackMapRow]) -> f64 {
    let of = |row: &TrackMapRow| {
        let [e, n] = [0, 1].map(|axis: usize| BasisWaves::new(basis, axis, row.at_m[axis]));
        let functions = basis.functions.iter().zip(&solution.weights_nt);
        let field: f64 = functions.map(|([a, b], weight)| weight * e.sines[a - 1] * n.sines[b - 1]).sum();
        let beside: f64 = row.beside.iter().map(|(column, h)| h * solution.beside[*column]).sum();
        row.weight * (row.value_nt - field - beside).powi(2)
    };
    let squares: Vec<f64> = rows.par_iter().map(of).collect();
    (squares.iter().sum::<f64>() / rows.len() as f64).sqrt()
}

/// Unknowns in addition to the basis: the level, the constants of lines and the temporal variation of flights.
struct NuisanceParameters {
    columns: usize,
    level_nt2: f64,
    /// Constants of lines: index of the first column, number of constants, and variance of each; `None` without
    /// constants.
    lines: Option<(usize, usize, f64)>,
    flights: Vec<TemporalKnots>,
    temporal: (f64, f64),
}

/// Knots of the temporal variation of a flight: the first at `from_s`, with a spacing of `step_s`.
struct TemporalKnots {
    first: usize,
    count: usize,
    from_s: f64,
    step_s: f64,
}

impl NuisanceParameters {
    fn new(parameters: &TrackMapParameters, kernel: &AnomalyKernel, samples: &[TrackSample]) -> Self {
        let (sigma_nt, tau_s) = parameters.temporal;
        let mut columns = 1;
        let line_count = samples.iter().map(|sample| sample.line + 1).max().unwrap_or(0);
        let lines = (line_count > 1 && parameters.line_sigma_nt > 0.0).then(|| {
            columns += line_count;
            (1, line_count, parameters.line_sigma_nt.powi(2))
        });
        let flight_count = samples.iter().map(|sample| sample.flight + 1).max().unwrap_or(0);
        let mut flights = vec![];
        for flight in (0..flight_count).filter(|_| sigma_nt > 0.0) {
            let times = || samples.iter().filter(move |sample| sample.flight == flight).map(|sample| sample.tt_s);
            let (from_s, to_s) = (times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max));
            let flown_s = (to_s - from_s).max(0.0);
            let steps = (flown_s * KNOTS / tau_s).ceil().min((MOST_KNOTS / flight_count).max(1) as f64).max(1.0);
            let count = steps as usize + 1;
            let step_s = if flown_s > 0.0 { flown_s / steps } else { tau_s };
            flights.push(TemporalKnots { first: columns, count, from_s, step_s });
            columns += count;
        }
        Self { columns, level_nt2: kernel.mean_nt2(), lines, flights, temporal: parameters.temporal }
    }

    /// Adds the entries of each sample to the row of the sample.
    fn enter(&self, samples: &[TrackSample], rows: &mut [TrackMapRow]) {
        for (row, sample) in rows.iter_mut().zip(samples) {
            row.beside.push((0, 1.0));
            if let Some((first, ..)) = self.lines {
                row.beside.push((first + sample.line, 1.0));
            }
            if let Some(knots) = self.flights.get(sample.flight) {
                let at = ((sample.tt_s - knots.from_s) / knots.step_s).clamp(0.0, (knots.count - 1) as f64);
                let before = (at.floor() as usize).min(knots.count - 2);
                let part = at - before as f64;
                row.beside.push((knots.first + before, 1.0 - part));
                row.beside.push((knots.first + before + 1, part));
            }
        }
    }

    /// Inverse covariance of these parameters, by rows.
    fn prior(&self) -> Vec<f64> {
        let n = self.columns;
        let mut prior = vec![0.0; n * n];
        prior[0] = 1.0 / self.level_nt2;
        if let Some((first, count, variance_nt2)) = self.lines {
            (first..first + count).for_each(|i| prior[i * n + i] = 1.0 / variance_nt2);
        }
        let (sigma_nt, tau_s) = self.temporal;
        for knots in &self.flights {
            let kept = (-knots.step_s / tau_s).exp();
            let scale = 1.0 / (sigma_nt * sigma_nt * (1.0 - kept * kept));
            for i in 0..knots.count {
                let place = knots.first + i;
                let inner = i > 0 && i + 1 < knots.count;
                prior[place * n + place] = scale * if inner { 1.0 + kept * kept } else { 1.0 };
                if i > 0 {
                    prior[place * n + place - 1] = -scale * kept;
                    prior[(place - 1) * n + place] = -scale * kept;
                }
            }
        }
        prior
    }
}

#[cfg(test)]
mod tests;
