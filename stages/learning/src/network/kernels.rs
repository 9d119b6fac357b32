//! The two matrix products of a layer, for a block of rows: the sums of the units, and the gradient with respect to the
//! weights.
//!
//! The lanes of a SIMD vector hold different units, in panels of eight or four, so that no sum is across lanes. Each
//! sum is over inputs or rows in order, by fused multiply-add. The results are bit-identical for any vector width.

use pulp::{Simd, WithSimd};

/// Number of units of a panel. If at most half as many units remain, a small panel is used.
const PANEL: usize = 8;
/// Number of units of a small panel.
const SMALL: usize = 4;
/// Number of rows (or inputs) that are processed together.
const TILE: usize = 6;

/// The number of units of the next panel.
const fn panel(left: usize) -> usize {
    if left <= SMALL { SMALL } else { PANEL }
}

/// Length of a row of units, padded to whole panels.
pub(super) const fn padded(units: usize) -> usize {
    units / PANEL * PANEL + if units.is_multiple_of(PANEL) { 0 } else { panel(units % PANEL) }
}

/// The weights of a layer, or the gradient with respect to the weights, in panels of units: a row of biases, then a row
/// for each input.
#[derive(Clone, Debug, Default)]
pub(super) struct WeightPanels {
    inputs: usize,
    units: usize,
    values: Vec<f64>,
}

impl WeightPanels {
    /// Zeros for a layer.
    pub fn new(inputs: usize, units: usize) -> Self {
        Self { inputs, units, values: vec![0.0; padded(units) * (inputs + 1)] }
    }

    /// Sets all values to zero.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// Calls `visit(row, unit, value)` for each value. Row 0 holds the biases, and row 1 + `input` the weights of an
    /// input.
    fn each(&mut self, mut visit: impl FnMut(usize, usize, &mut f64)) {
        let (mut start, mut rest) = (0, self.values.as_mut_slice());
        while start < self.units {
            let lanes = panel(self.units - start);
            let (values, behind) = rest.split_at_mut(lanes * (self.inputs + 1));
            for (row, values) in values.chunks_exact_mut(lanes).enumerate() {
                values.iter_mut().take(self.units - start).enumerate().for_each(|(k, x)| visit(row, start + k, x));
            }
            (start, rest) = (start + lanes, behind);
        }
    }

    /// Sets the weights (unit, input) and biases of a layer.
    pub fn set_layer(&mut self, weights: &[f64], biases: &[f64]) {
        let inputs = self.inputs;
        self.each(|row, unit, x| *x = if row == 0 { biases[unit] } else { weights[unit * inputs + row - 1] });
    }

    /// Sets rows of sums to the biases, for a layer without inputs. Such a layer has at most one panel.
    fn fill_biases(&self, out: &mut [f64]) {
        let stride = padded(self.units);
        out.chunks_exact_mut(stride.max(1)).for_each(|out| out.copy_from_slice(&self.values[..stride]));
    }

    /// Sets the transposed weights of a layer, with its inputs as units, for backpropagation; without biases.
    pub fn set_transposed(&mut self, weights: &[f64]) {
        let units = self.units;
        self.each(|row, unit, x| *x = if row == 0 { 0.0 } else { weights[(row - 1) * units + unit] });
    }

    /// Writes weights (unit, input) and biases.
    pub fn write(&mut self, weights: &mut [f64], biases: &mut [f64]) {
        let inputs = self.inputs;
        self.each(|row, unit, x| match row {
            0 => biases[unit] = *x,
            row => weights[unit * inputs + row - 1] = *x,
        });
    }
}

/// out = x Wᵀ + b for rows of `x`, `stride` apart; rows of `out` are padded to whole panels.
pub(super) fn affine(x: &[f64], stride: usize, layer: &WeightPanels, out: &mut [f64]) {
    if stride == 0 {
        return layer.fill_biases(out);
    }
    pulp::Arch::new().dispatch(AffineKernel { x, stride, layer, out });
}

/// Adds Σ d xᵀ over the rows to the gradient of the weights, and Σ d to the gradient of the biases. Rows of `x` are
/// `stride` apart; rows of `d` are padded to whole panels.
pub(super) fn add_outer(x: &[f64], stride: usize, d: &[f64], gradient: &mut WeightPanels) {
    pulp::Arch::new().dispatch(OuterProductKernel { x, stride, d, gradient });
}

// These are structs, because closures of this size would not be inlined and compiled for wide vectors.
struct AffineKernel<'a> {
    x: &'a [f64],
    stride: usize,
    layer: &'a WeightPanels,
    out: &'a mut [f64],
}

impl WithSimd for AffineKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { x, stride, layer, out } = self;
        let out_stride = padded(layer.units);
        let (mut start, mut rest) = (0, layer.values.as_slice());
        while start < layer.units {
            let lanes = panel(layer.units - start);
            let (values, behind) = rest.split_at(lanes * (layer.inputs + 1));
            if lanes == PANEL {
                affine_panel::<S, PANEL>(simd, x, stride, values, out, out_stride, start);
            } else {
                affine_panel::<S, SMALL>(simd, x, stride, values, out, out_stride, start);
            }
            (start, rest) = (start + lanes, behind);
        }
    }
}

struct OuterProductKernel<'a> {
    x: &'a [f64],
    stride: usize,
    d: &'a [f64],
    gradient: &'a mut WeightPanels,
}

impl pulp::NullaryFnOnce for OuterProductKernel<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { x, stride, d, gradient } = self;
        let d_stride = padded(gradient.units);
        let (mut start, mut rest) = (0, gradient.values.as_mut_slice());
        while start < gradient.units {
            let lanes = panel(gradient.units - start);
            let (values, behind) = rest.split_at_mut(lanes * (gradient.inputs + 1));
            if lanes == PANEL {
                outer_panel::<PANEL>(x, stride, d, d_stride, start, values);
            } else {
                outer_panel::<SMALL>(x, stride, d, d_stride, start, values);
            }
            (start, rest) = (start + lanes, behind);
        }
    }
}

#[inline(always)]
fn affine_panel<S: Simd, const K: usize>(
    simd: S,
    x: &[f64],
    stride: usize,
    values: &[f64],
    out: &mut [f64],
    out_stride: usize,
    start: usize,
) {
    let Some((bias, weights)) = values.as_chunks::<K>().0.split_first() else { return };
    let (many, few) = x.split_at(x.len() / stride / TILE * TILE * stride);
    let (many_out, few_out) = out.split_at_mut(many.len() / stride * out_stride);
    for (x, out) in many.chunks_exact(TILE * stride).zip(many_out.chunks_exact_mut(TILE * out_stride)) {
        affine_tile::<S, TILE, K>(simd, x, stride, bias, weights, out, out_stride, start);
    }
    for (x, out) in few.chunks_exact(stride).zip(few_out.chunks_exact_mut(out_stride)) {
        affine_tile::<S, 1, K>(simd, x, stride, bias, weights, out, out_stride, start);
    }
}

/// Explicitly vectorised, because the compiler does not vectorise the sums of several rows.
#[inline(always)]
#[expect(clippy::too_many_arguments)]
fn affine_tile<S: Simd, const R: usize, const K: usize>(
    simd: S,
    x: &[f64],
    stride: usize,
    bias: &[f64; K],
    weights: &[[f64; K]],
    out: &mut [f64],
    out_stride: usize,
    start: usize,
) {
    let mut rows: [&[f64]; R] = [&[]; R];
    for (row, x) in rows.iter_mut().zip(x.chunks_exact(stride)) {
        *row = &x[..weights.len()];
    }
    // Only the vectors that the K numbers fill are used.
    let mut sums = [[simd.splat_f64s(0.0); K]; R];
    for sum in &mut sums {
        for (sum, bias) in sum.iter_mut().zip(S::as_simd_f64s(bias).0) {
            *sum = *bias;
        }
    }
    for (input, weights) in weights.iter().enumerate() {
        let weights = S::as_simd_f64s(weights).0;
        for (sum, row) in sums.iter_mut().zip(&rows) {
            let x = simd.splat_f64s(row[input]);
            for (sum, weight) in sum.iter_mut().zip(weights) {
                *sum = simd.mul_add_f64s(x, *weight, *sum);
            }
        }
    }
    for (sum, out) in sums.iter().zip(out.chunks_exact_mut(out_stride)) {
        for (out, sum) in S::as_mut_simd_f64s(&mut out[start..start + K]).0.iter_mut().zip(sum) {
            *out = *sum;
        }
    }
}

#[inline(always)]
fn outer_panel<const K: usize>(x: &[f64], stride: usize, d: &[f64], d_stride: usize, start: usize, values: &mut [f64]) {
    let Some((bias, weights)) = values.as_chunks_mut::<K>().0.split_first_mut() else { return };
    let d = PanelDeltas { d, stride: d_stride, start };
    for row in d.d.chunks_exact(d_stride) {
        for (bias, d) in bias.iter_mut().zip(&row[start..]) {
            *bias += d;
        }
    }
    let mut first = 0;
    let mut tiles = weights.chunks_exact_mut(TILE);
    for weights in &mut tiles {
        outer_tile::<TILE, K>(x, stride, first, d, weights);
        first += TILE;
    }
    let weights = tiles.into_remainder();
    match weights.len() {
        1 => outer_tile::<1, K>(x, stride, first, d, weights),
        2 => outer_tile::<2, K>(x, stride, first, d, weights),
        3 => outer_tile::<3, K>(x, stride, first, d, weights),
        4 => outer_tile::<4, K>(x, stride, first, d, weights),
        5 => outer_tile::<5, K>(x, stride, first, d, weights),
        _ => {}
    }
}

#[derive(Clone, Copy)]
struct PanelDeltas<'a> {
    d: &'a [f64],
    stride: usize,
    start: usize,
}

/// The sums of `R` inputs, beginning at `first`.
#[inline(always)]
fn outer_tile<const R: usize, const K: usize>(
    x: &[f64],
    stride: usize,
    first: usize,
    deltas: PanelDeltas<'_>,
    weights: &mut [[f64; K]],
) {
    let Some(weights) = weights.first_chunk_mut::<R>() else { return };
    let mut sums = *weights;
    for (x, d) in x.chunks_exact(stride).zip(deltas.d.chunks_exact(deltas.stride)) {
        let (Some(x), Some(d)) = (x[first..].first_chunk::<R>(), d[deltas.start..].first_chunk::<K>()) else { return };
        for (sum, x) in sums.iter_mut().zip(x) {
            for (sum, d) in sum.iter_mut().zip(d) {
                *sum = x.mul_add(*d, *sum);
            }
        }
    }
    *weights = sums;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(count: usize, seed: f64) -> Vec<f64> {
        (0..count).map(|i| ((i as f64 + 1.0) * seed).sin()).collect()
    }

    #[test]
    fn law_products_agree_with_the_definition_for_every_remainder() {
        for units in 1..=18 {
            for (inputs, rows) in [(1, 1), (5, 7), (6, 12), (13, 4), (14, 13)] {
                let (x, weights) = (numbers(rows * inputs, 0.7), numbers(units * inputs, 1.3));
                let biases = numbers(units, 2.1);
                let mut layer = WeightPanels::new(inputs, units);
                layer.set_layer(&weights, &biases);
                let stride = padded(units);
                let mut out = vec![f64::NAN; rows * stride];
                affine(&x, inputs, &layer, &mut out);
                let mut gradient = WeightPanels::new(inputs, units);
                add_outer(&x, inputs, &out, &mut gradient);
                let (mut d_weights, mut d_biases) = (vec![0.0; weights.len()], vec![0.0; units]);
                gradient.write(&mut d_weights, &mut d_biases);
                let mut back = WeightPanels::new(units, inputs);
                back.set_transposed(&weights);
                let mut d_x = vec![f64::NAN; rows * padded(inputs)];
                affine(&out, stride, &back, &mut d_x);
                for unit in 0..units {
                    let sum = |row: usize| {
                        let row = &x[row * inputs..][..inputs];
                        biases[unit] + row.iter().zip(&weights[unit * inputs..]).map(|(x, w)| x * w).sum::<f64>()
                    };
                    assert!((0..rows).all(|row| (out[row * stride + unit] - sum(row)).abs() < 1e-13));
                    assert!((d_biases[unit] - (0..rows).map(sum).sum::<f64>()).abs() < 1e-12);
                    for input in 0..inputs {
                        let expected: f64 = (0..rows).map(|row| sum(row) * x[row * inputs + input]).sum();
                        assert!((d_weights[unit * inputs + input] - expected).abs() < 1e-12);
                    }
                }
                for row in 0..rows {
                    for input in 0..inputs {
                        let of = |unit: usize| out[row * stride + unit] * weights[unit * inputs + input];
                        let expected: f64 = (0..units).map(of).sum();
                        assert!((d_x[row * padded(inputs) + input] - expected).abs() < 1e-12);
                    }
                }
            }
        }
    }
}
