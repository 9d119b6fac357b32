//! Gated recurrent units and long short-term memory: forward pass and backpropagation over a window.
//!
//! With x the inputs of a step, h the units after the previous step, σ the sigmoid and ∘ the element-wise product:
//!
//! ```text
//! gru:  r = σ(Wᵣx + bᵣ + Uᵣh + cᵣ)     z = σ(W_z x + b_z + U_z h + c_z)     n = tanh(Wₙx + bₙ + r∘(Uₙh + cₙ))
//!       h ← (1 − z)∘n + z∘h                                                   [Cho et al. 2014]
//! lstm: i, f, o = σ(Wx + b + Uh + c)    g = tanh(W_g x + b_g + U_g h + c_g)
//!       s ← f∘s + i∘g                   h ← o∘tanh s                          [Hochreiter & Schmidhuber 1997]
//! ```

use super::activation::{sigmoid, tanh};
use super::kernels::{WeightPanels, add_outer, affine, padded};
use super::passes::BLOCK;
use super::windowed::FeatureExtractor;

/// Type of the recurrent cell.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum RecurrentCell {
    Gru,
    Lstm,
}

impl RecurrentCell {
    /// Number of sums per unit.
    pub const fn gates(self) -> usize {
        match self {
            Self::Gru => 3,
            Self::Lstm => 4,
        }
    }
}

/// Values per unit and step that backpropagation needs: r, z, n and Uₙh + cₙ, or i, f, g and o.
const KEPT: usize = 4;

/// The recurrent part of a network, for a block of rows.
///
/// Parameters: W, row-major (gate and unit, input), U (gate and unit, unit), b and c. Gates are in the order above; for
/// an LSTM i, f, g, o. [PyTorch's order]
pub(super) struct RecurrentLayer {
    cell: RecurrentCell,
    inputs: usize,
    units: usize,
    window: usize,
    of_inputs: WeightPanels,
    of_units: WeightPanels,
    of_units_back: WeightPanels,
    gradient_of_inputs: WeightPanels,
    gradient_of_units: WeightPanels,
    /// The units after each step, and before the first step; rows padded to whole panels.
    h: Vec<Vec<f64>>,
    /// The cell state of an LSTM after each step, and before the first step; not padded.
    s: Vec<Vec<f64>>,
    kept: Vec<Vec<f64>>,
    sums_x: Vec<f64>,
    sums_h: Vec<f64>,
    d_h: Vec<f64>,
    d_h_before: Vec<f64>,
    d_s: Vec<f64>,
}

impl RecurrentLayer {
    pub fn new(cell: RecurrentCell, inputs: usize, units: usize, window: usize) -> Self {
        let sums = cell.gates() * units;
        let rows = |width: usize| vec![0.0; BLOCK * width];
        Self {
            cell,
            inputs,
            units,
            window,
            of_inputs: WeightPanels::new(inputs, sums),
            of_units: WeightPanels::new(units, sums),
            of_units_back: WeightPanels::new(sums, units),
            gradient_of_inputs: WeightPanels::new(inputs, sums),
            gradient_of_units: WeightPanels::new(units, sums),
            h: vec![rows(padded(units)); window + 1],
            s: vec![rows(if cell == RecurrentCell::Lstm { units } else { 0 }); window + 1],
            kept: vec![rows(KEPT * units); window],
            sums_x: rows(padded(sums)),
            sums_h: rows(padded(sums)),
            d_h: rows(padded(units)),
            d_h_before: rows(padded(units)),
            d_s: rows(units),
        }
    }

    /// The number of parameters.
    pub const fn parameters(cell: RecurrentCell, inputs: usize, units: usize) -> usize {
        cell.gates() * units * (inputs + units + 2)
    }
}

/// The parts of a vector of parameters, or of the gradient with respect to the parameters: W, U, b, c.
fn split(sums: usize, inputs: usize, units: usize, parameters: &mut [f64]) -> [&mut [f64]; 4] {
    let (w, rest) = parameters.split_at_mut(sums * inputs);
    let (u, rest) = rest.split_at_mut(sums * units);
    let (b, c) = rest.split_at_mut(sums);
    [w, u, b, c]
}

impl FeatureExtractor for RecurrentLayer {
    fn set(&mut self, parameters: &[f64]) {
        let sums = self.cell.gates() * self.units;
        let (w, rest) = parameters.split_at(sums * self.inputs);
        let (u, rest) = rest.split_at(sums * self.units);
        let (b, c) = rest.split_at(sums);
        self.of_inputs.set_layer(w, b);
        self.of_units.set_layer(u, c);
        self.of_units_back.set_transposed(u);
    }

    fn forward(&mut self, x: &[f64], rows: usize, features: &mut [f64]) {
        let (units, stride) = (self.units, padded(self.units));
        let sums_stride = padded(self.cell.gates() * units);
        for (step, x) in x.chunks_exact(rows * self.inputs).take(self.window).enumerate() {
            let (sums_x, sums_h) = (&mut self.sums_x[..rows * sums_stride], &mut self.sums_h[..rows * sums_stride]);
            let (before, after) = self.h.split_at_mut(step + 1);
            let (s_before, s_after) = self.s.split_at_mut(step + 1);
            let (Some(h), Some(next)) = (before.last(), after.first_mut()) else { return };
            let (Some(s), Some(s_next)) = (s_before.last(), s_after.first_mut()) else { return };
            affine(x, self.inputs, &self.of_inputs, sums_x);
            affine(&h[..rows * stride], stride, &self.of_units, sums_h);
            pulp::Arch::new().dispatch(RecurrentStep {
                cell: self.cell,
                units,
                rows,
                sums: [sums_x, sums_h],
                h,
                next,
                s,
                s_next,
                kept: &mut self.kept[step],
            });
        }
        let Some(last) = self.h.last() else { return };
        for (feature, h) in features.chunks_exact_mut(units).zip(last.chunks_exact(stride)) {
            feature.copy_from_slice(&h[..units]);
        }
    }

    fn backward(&mut self, x: &[f64], rows: usize, d_features: &[f64], gradient: &mut [f64]) {
        let (units, stride) = (self.units, padded(self.units));
        let sums = self.cell.gates() * units;
        let sums_stride = padded(sums);
        self.gradient_of_inputs.clear();
        self.gradient_of_units.clear();
        self.d_h.fill(0.0);
        self.d_s.fill(0.0);
        for (d_h, d) in self.d_h.chunks_exact_mut(stride).zip(d_features.chunks_exact(units)) {
            d_h[..units].copy_from_slice(d);
        }
        let steps: Vec<&[f64]> = x.chunks_exact(rows * self.inputs).take(self.window).collect();
        for (step, x) in steps.into_iter().enumerate().rev() {
            let (d_x, d_u) = (&mut self.sums_x[..rows * sums_stride], &mut self.sums_h[..rows * sums_stride]);
            let back = RecurrentStepGradient {
                units,
                rows,
                kept: &self.kept[step],
                h: &self.h[step],
                s: &self.s[step],
                d_h: &mut self.d_h,
                d_s: &mut self.d_s,
                d_x,
                d_u,
            };
            match self.cell {
                RecurrentCell::Gru => back.gru(),
                RecurrentCell::Lstm => back.lstm(),
            }
            add_outer(x, self.inputs, &self.sums_x[..rows * sums_stride], &mut self.gradient_of_inputs);
            let d_u = &self.sums_h[..rows * sums_stride];
            add_outer(&self.h[step][..rows * stride], stride, d_u, &mut self.gradient_of_units);
            let before = &mut self.d_h_before[..rows * stride];
            affine(d_u, sums_stride, &self.of_units_back, before);
            // `d_h` holds the gradient that passes through a GRU's step unchanged.
            self.d_h.iter_mut().zip(before).for_each(|(d_h, before)| *d_h += *before);
        }
        let [w, u, b, c] = split(sums, self.inputs, units, gradient);
        self.gradient_of_inputs.write(w, b);
        self.gradient_of_units.write(u, c);
    }
}

/// Forward step of a recurrent cell for all rows of a block.
struct RecurrentStep<'a> {
    cell: RecurrentCell,
    units: usize,
    rows: usize,
    sums: [&'a [f64]; 2],
    h: &'a [f64],
    next: &'a mut [f64],
    s: &'a [f64],
    s_next: &'a mut [f64],
    kept: &'a mut [f64],
}

impl pulp::NullaryFnOnce for RecurrentStep<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { cell, units, rows, sums: [sums_x, sums_h], h, next, s, s_next, kept } = self;
        let (stride, sums_stride) = (padded(units), padded(cell.gates() * units));
        for row in 0..rows {
            let (x, u) = (&sums_x[row * sums_stride..][..sums_stride], &sums_h[row * sums_stride..][..sums_stride]);
            let (h, next) = (&h[row * stride..][..units], &mut next[row * stride..][..units]);
            let (first, rest) = kept[row * KEPT * units..][..KEPT * units].split_at_mut(units);
            let (second, rest) = rest.split_at_mut(units);
            let (third, fourth) = rest.split_at_mut(units);
            match cell {
                RecurrentCell::Gru => {
                    for k in 0..units {
                        first[k] = sigmoid(x[k] + u[k]).0;
                        second[k] = sigmoid(x[units + k] + u[units + k]).0;
                        fourth[k] = u[2 * units + k];
                        third[k] = tanh(x[2 * units + k] + first[k] * fourth[k]).0;
                        next[k] = (1.0 - second[k]) * third[k] + second[k] * h[k];
                    }
                }
                RecurrentCell::Lstm => {
                    let (s, s_next) = (&s[row * units..][..units], &mut s_next[row * units..][..units]);
                    for k in 0..units {
                        first[k] = sigmoid(x[k] + u[k]).0;
                        second[k] = sigmoid(x[units + k] + u[units + k]).0;
                        third[k] = tanh(x[2 * units + k] + u[2 * units + k]).0;
                        fourth[k] = sigmoid(x[3 * units + k] + u[3 * units + k]).0;
                        s_next[k] = second[k] * s[k] + first[k] * third[k];
                        next[k] = fourth[k] * tanh(s_next[k]).0;
                    }
                }
            }
        }
    }
}

/// Backpropagation through a step: derivatives with respect to the sums of the step, from the derivatives with respect
/// to its units. `d_h` and `d_s` become the parts that reach the previous step without passing through U.
struct RecurrentStepGradient<'a> {
    units: usize,
    rows: usize,
    kept: &'a [f64],
    h: &'a [f64],
    s: &'a [f64],
    d_h: &'a mut [f64],
    d_s: &'a mut [f64],
    d_x: &'a mut [f64],
    d_u: &'a mut [f64],
}

impl RecurrentStepGradient<'_> {
    fn gru(self) {
        let Self { units, rows, kept, h, d_h, d_x, d_u, .. } = self;
        let (stride, sums_stride) = (padded(units), padded(3 * units));
        for row in 0..rows {
            let kept = &kept[row * KEPT * units..][..KEPT * units];
            let (h, d_h) = (&h[row * stride..][..units], &mut d_h[row * stride..][..units]);
            let (d_x, d_u) =
                (&mut d_x[row * sums_stride..][..sums_stride], &mut d_u[row * sums_stride..][..sums_stride]);
            for k in 0..units {
                let (r, z, n, of_h) = (kept[k], kept[units + k], kept[2 * units + k], kept[3 * units + k]);
                let d_n = d_h[k] * (1.0 - z) * (1.0 - n * n);
                let d_z = d_h[k] * (h[k] - n) * z * (1.0 - z);
                let d_r = d_n * of_h * r * (1.0 - r);
                (d_x[k], d_x[units + k], d_x[2 * units + k]) = (d_r, d_z, d_n);
                (d_u[k], d_u[units + k], d_u[2 * units + k]) = (d_r, d_z, d_n * r);
                d_h[k] *= z;
            }
        }
    }

    fn lstm(self) {
        let Self { units, rows, kept, s, d_h, d_s, d_x, d_u, .. } = self;
        let (stride, sums_stride) = (padded(units), padded(4 * units));
        for row in 0..rows {
            let kept = &kept[row * KEPT * units..][..KEPT * units];
            let (s, d_s) = (&s[row * units..][..units], &mut d_s[row * units..][..units]);
            let d_h = &mut d_h[row * stride..][..units];
            let (d_x, d_u) =
                (&mut d_x[row * sums_stride..][..sums_stride], &mut d_u[row * sums_stride..][..sums_stride]);
            for k in 0..units {
                let (i, f, g, o) = (kept[k], kept[units + k], kept[2 * units + k], kept[3 * units + k]);
                let t = tanh(f * s[k] + i * g).0;
                let d = d_s[k] + d_h[k] * o * (1.0 - t * t);
                let gates = [
                    d * g * i * (1.0 - i),
                    d * s[k] * f * (1.0 - f),
                    d * i * (1.0 - g * g),
                    d_h[k] * t * o * (1.0 - o),
                ];
                for (gate, d) in gates.into_iter().enumerate() {
                    (d_x[gate * units + k], d_u[gate * units + k]) = (d, d);
                }
                d_s[k] = d * f;
                d_h[k] = 0.0;
            }
        }
    }
}
