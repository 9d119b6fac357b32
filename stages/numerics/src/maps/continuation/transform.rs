//! The padded two-dimensional transform: real to complex along the rows, complex along the columns.
//!
//! Only the rows of the map itself are transformed. The padding of the columns is a linear function of their nodes. It
//! is therefore computed from the spectra of the rows, column by column, while a group of columns is in the cache. One
//! buffer of real numbers, with at most two additional numbers per row, holds half the spectrum; the other half is its
//! conjugate.

use std::sync::Arc;

use pulp::bytemuck;
use rayon::prelude::*;
use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};

use crate::maps::plane_grid::PlaneGrid;

use super::extension::{AxisExtension, PaddedLayout, Padding};
use super::trend::TrendPlane;

type Complex64 = Complex<f64>;

/// Number of columns that are transformed between a gather and a scatter: a kilobyte of each row.
const GROUP: usize = 64;
/// Number of columns that one task gathers at a time: two cache lines.
const PANEL: usize = 8;
/// Number of rows that one task scatters at a time.
const BAND: usize = 16;

/// A factor for each wavenumber in rad/m.
#[derive(Clone, Copy)]
pub(super) enum WavenumberFactor<'a> {
    /// Function of the magnitude of the wavenumber.
    Radial(&'a (dyn Fn(f64) -> f64 + Sync)),
    /// Function of the wavenumbers along easting and northing.
    General(&'a (dyn Fn(f64, f64) -> Complex64 + Sync)),
}

/// Fourier transforms and padding for maps of one layout.
pub(super) struct MapTransform {
    pub(super) layout: PaddedLayout,
    /// The spacing along easting and northing, in metres.
    steps_m: [f64; 2],
    along: AxisExtension,
    across: AxisExtension,
    row_forward: Arc<dyn RealToComplex<f64>>,
    row_inverse: Arc<dyn ComplexToReal<f64>>,
    column_forward: Arc<dyn Fft<f64>>,
    column_inverse: Arc<dyn Fft<f64>>,
}

impl MapTransform {
    pub(super) fn new(grid: &PlaneGrid, layout: PaddedLayout, padding: &Padding) -> Self {
        let (mut real, mut complex) = (RealFftPlanner::new(), FftPlanner::new());
        Self {
            layout,
            steps_m: [grid.east_m.step, grid.north_m.step],
            along: AxisExtension::new(layout.columns, padding.edge),
            across: AxisExtension::new(layout.rows, padding.edge),
            row_forward: real.plan_fft_forward(layout.columns.padded),
            row_inverse: real.plan_fft_inverse(layout.columns.padded),
            column_forward: complex.plan_fft_forward(layout.rows.padded),
            column_inverse: complex.plan_fft_inverse(layout.rows.padded),
        }
    }

    /// The spacing along easting and northing, in metres.
    pub(super) fn steps_m(&self) -> [f64; 2] {
        self.steps_m
    }

    /// Complex numbers in a row of half a spectrum.
    pub(super) fn half(&self) -> usize {
        self.layout.columns.padded / 2 + 1
    }

    /// Spectra of the map's rows after the trend is subtracted, in a buffer for `rows` rows.
    fn rows_forward(&self, grid: &PlaneGrid, trend: &TrendPlane, rows: usize) -> Vec<f64> {
        let columns = self.layout.columns;
        let mut buffer = vec![0.0; 2 * self.half() * rows];
        let lines = buffer.par_chunks_mut(2 * self.half()).zip(grid.values.par_chunks(columns.len)).enumerate();
        let scratch = || (vec![0.0; columns.padded], self.row_forward.make_scratch_vec());
        lines.for_each_init(scratch, |(line, scratch), (row, (spectrum, values))| {
            for (column, (to, from)) in line[columns.before..].iter_mut().zip(values).enumerate() {
                *to = from - trend.at(row, column);
            }
            self.along.fill(line);
            let spectrum = bytemuck::cast_slice_mut(spectrum);
            // The transform fails only for wrong lengths, and all lengths come from the plan.
            let _ = self.row_forward.process_with_scratch(line, spectrum, scratch);
        });
        buffer
    }

    /// The map from the spectra of its rows, with the trend restored.
    fn rows_inverse(&self, mut buffer: Vec<f64>, trend: &TrendPlane) -> Vec<f64> {
        let columns = self.layout.columns;
        let scale = 1.0 / self.layout.nodes() as f64;
        let mut values = vec![0.0; self.layout.rows.len * columns.len];
        let lines = values.par_chunks_mut(columns.len).zip(buffer.par_chunks_mut(2 * self.half())).enumerate();
        let scratch = || (vec![0.0; columns.padded], self.row_inverse.make_scratch_vec());
        lines.for_each_init(scratch, |(line, scratch), (row, (values, spectrum))| {
            let spectrum: &mut [Complex64] = bytemuck::cast_slice_mut(spectrum);
            self.make_ends_real(spectrum);
            let _ = self.row_inverse.process_with_scratch(spectrum, line, scratch);
            for (column, (to, from)) in values.iter_mut().zip(&line[columns.before..]).enumerate() {
                *to = from * scale + trend.at(row, column);
            }
        });
        values
    }

    /// In the spectrum of a real line, the mean and the shortest wave are real; rounding adds an imaginary part of
    /// about 1e-16.
    fn make_ends_real(&self, spectrum: &mut [Complex64]) {
        if let Some(first) = spectrum.first_mut() {
            first.im = 0.0;
        }
        if self.layout.columns.padded.is_multiple_of(2)
            && let Some(last) = spectrum.last_mut()
        {
            last.im = 0.0;
        }
    }

    /// The whole spectrum of a map.
    pub(super) fn spectrum(&self, grid: &PlaneGrid, trend: &TrendPlane) -> Vec<f64> {
        let mut buffer = self.rows_forward(grid, trend, self.layout.rows.padded);
        let mut group = ColumnBlock::new(self);
        while group.next() {
            group.gather(&buffer, self.layout.rows.before, self.layout.rows.len);
            group.work(|_, column, scratch| {
                self.across.fill(column);
                self.column_forward.process_with_scratch(column, scratch);
            });
            group.scatter(&mut buffer, 0);
        }
        buffer
    }

    /// The map whose spectrum is the given spectrum times a factor.
    pub(super) fn filtered(&self, spectrum: &[f64], factor: WavenumberFactor, trend: &TrendPlane) -> Vec<f64> {
        let mut buffer = vec![0.0; 2 * self.half() * self.layout.rows.len];
        let mut group = ColumnBlock::new(self);
        while group.next() {
            group.gather(spectrum, 0, self.layout.rows.padded);
            group.work(|index, column, scratch| {
                self.multiply(column, index, factor);
                self.column_inverse.process_with_scratch(column, scratch);
            });
            group.scatter(&mut buffer, self.layout.rows.before);
        }
        self.rows_inverse(buffer, trend)
    }

    /// Combines [`Self::spectrum`] and [`Self::filtered`] in one pass over the columns, for one factor.
    pub(super) fn filtered_once(
        &self,
        grid: &PlaneGrid,
        factor: WavenumberFactor,
        trends: [&TrendPlane; 2],
    ) -> Vec<f64> {
        let mut buffer = self.rows_forward(grid, trends[0], self.layout.rows.len);
        let mut group = ColumnBlock::new(self);
        while group.next() {
            group.gather(&buffer, self.layout.rows.before, self.layout.rows.len);
            group.work(|index, column, scratch| {
                self.across.fill(column);
                self.column_forward.process_with_scratch(column, scratch);
                self.multiply(column, index, factor);
                self.column_inverse.process_with_scratch(column, scratch);
            });
            group.scatter(&mut buffer, self.layout.rows.before);
        }
        self.rows_inverse(buffer, trends[1])
    }

    /// Multiplies a column of the spectrum by a factor; the result has the symmetry of a real map's spectrum.
    fn multiply(&self, column: &mut [Complex64], index: usize, factor: WavenumberFactor) {
        let k_east = self.k_east(index);
        let rows = column.len();
        match factor {
            WavenumberFactor::Radial(f) => {
                let square = k_east * k_east;
                for row in 0..=rows / 2 {
                    let k_north = self.k_north(row);
                    let value = f((square + k_north * k_north).sqrt());
                    column[row] *= value;
                    if row != 0 && 2 * row != rows {
                        column[rows - row] *= value;
                    }
                }
            }
            WavenumberFactor::General(f) => {
                for (row, value) in column.iter_mut().enumerate() {
                    let signed = if 2 * row > rows { -self.k_north(rows - row) } else { self.k_north(row) };
                    *value *= self.at_fold(index, row, f, [k_east, signed]);
                }
            }
        }
    }

    /// A wave of two nodes has two opposite directions: its factor is the mean of the factors of both.
    fn at_fold(
        &self,
        index: usize,
        row: usize,
        f: &dyn Fn(f64, f64) -> Complex64,
        [east, north]: [f64; 2],
    ) -> Complex64 {
        let folds = [2 * index == self.layout.columns.padded, 2 * row == self.layout.rows.padded];
        match folds {
            [false, false] => f(east, north),
            [true, false] => 0.5 * (f(east, north) + f(-east, north)),
            [false, true] => 0.5 * (f(east, north) + f(east, -north)),
            [true, true] => 0.25 * (f(east, north) + f(-east, north) + f(east, -north) + f(-east, -north)),
        }
    }

    /// The wavenumber of a column of half the spectrum, in rad/m.
    pub(super) fn k_east(&self, index: usize) -> f64 {
        std::f64::consts::TAU * index as f64 / (self.layout.columns.padded as f64 * self.steps_m[0])
    }

    /// The wavenumber of a row, in rad/m, for the rows up to the middle row.
    pub(super) fn k_north(&self, row: usize) -> f64 {
        std::f64::consts::TAU * row as f64 / (self.layout.rows.padded as f64 * self.steps_m[1])
    }
}

/// A block of neighbouring columns, each contiguous in memory.
struct ColumnBlock<'a> {
    transform: &'a MapTransform,
    first: usize,
    width: usize,
    columns: Vec<f64>,
    stride: usize,
}

impl<'a> ColumnBlock<'a> {
    fn new(transform: &'a MapTransform) -> Self {
        // Slightly longer than a column, so that columns do not map to the same cache lines.
        let stride = 2 * transform.layout.rows.padded + 8;
        Self { transform, first: 0, width: 0, columns: vec![0.0; GROUP * stride], stride }
    }

    /// Advances to the next columns; false at the end.
    fn next(&mut self) -> bool {
        self.first += self.width;
        self.width = GROUP.min(self.transform.half() - self.first);
        self.width > 0
    }

    /// Copies the first `rows` rows of the buffer to the rows of the block from row `at` on.
    fn gather(&mut self, buffer: &[f64], at: usize, rows: usize) {
        let (half, stride, used) = (2 * self.transform.half(), self.stride, self.width * self.stride);
        let first = self.first;
        self.columns[..used].par_chunks_mut(PANEL * stride).enumerate().for_each(|(panel, columns)| {
            let start = 2 * (first + panel * PANEL);
            let width = columns.len() / stride;
            for (row, line) in buffer.chunks_exact(half).take(rows).enumerate() {
                let line = &line[start..start + 2 * width];
                for (column, value) in line.chunks_exact(2).enumerate() {
                    columns[column * stride + 2 * (at + row)..][..2].copy_from_slice(value);
                }
            }
        });
    }

    /// Calls the closure for each column, with its index and a scratch buffer for transforms.
    fn work(&mut self, run: impl Fn(usize, &mut [Complex64], &mut [Complex64]) + Sync) {
        let transform = self.transform;
        let lengths = [&transform.column_forward, &transform.column_inverse].map(|fft| fft.get_inplace_scratch_len());
        let scratch = || vec![Complex64::default(); lengths[0].max(lengths[1])];
        let (stride, used, first) = (self.stride, self.width * self.stride, self.first);
        self.columns[..used].par_chunks_mut(stride).enumerate().for_each_init(scratch, |scratch, (column, values)| {
            let values = &mut values[..2 * transform.layout.rows.padded];
            run(first + column, bytemuck::cast_slice_mut(values), scratch);
        });
    }

    /// Copies the block to the rows of the buffer from row `at`.
    fn scatter(&self, buffer: &mut [f64], at: usize) {
        let half = 2 * self.transform.half();
        let columns = &self.columns[..self.width * self.stride];
        buffer.par_chunks_mut(BAND * half).enumerate().for_each(|(band, lines)| {
            for (column, values) in columns.chunks_exact(self.stride).enumerate() {
                let start = 2 * (self.first + column);
                let values = &values[2 * (at + band * BAND)..];
                for (line, value) in lines.chunks_exact_mut(half).zip(values.chunks_exact(2)) {
                    line[start..start + 2].copy_from_slice(value);
                }
            }
        });
    }
}
