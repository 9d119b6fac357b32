//! Backward pass over the states of a layout: the adjoint λ of a path and its matrix Λ. [Bryson & Frazier 1963; Bierman
//! 1973]

use crate::inner_product::dot;
use crate::navigation::line::LineStep;
use crate::navigation::pinson::{STATES, StateMatrix};
use crate::navigation::transition::add_scaled;

use super::{Gaussian, StateLayout, covariance};

/// λ ← Φᵀ λ of all states.
pub(crate) fn propagate_adjoint(layout: &StateLayout, step: &LineStep, adjoint: &mut [f64]) {
    let mut ins = [0.0; STATES];
    for (row, entry) in step.phi.iter().zip(adjoint.iter()) {
        add_scaled(&mut ins, *entry, row);
    }
    adjoint[..STATES].copy_from_slice(&ins);
    for (error, entry) in layout.errors_of(step).zip(&mut adjoint[STATES..]) {
        *entry *= error.decay(step.dt_s);
    }
}

/// Q λ of all states.
pub(crate) fn noise_times(layout: &StateLayout, step: &LineStep, adjoint: &[f64], out: &mut [f64]) {
    for (out, row) in out.iter_mut().zip(&step.noise) {
        *out = row.iter().zip(adjoint).map(|(q, adjoint)| q * adjoint).sum();
    }
    for (k, error) in layout.errors_of(step).enumerate() {
        out[STATES + k] = error.step_variance(step.dt_s) * adjoint[STATES + k];
    }
    for (k, density) in layout.walk.iter().enumerate() {
        let at = layout.coefficients() + k;
        out[at] = density * step.dt_s * adjoint[at];
    }
}

/// Λ ← Φᵀ Λ Φ.
pub(crate) fn propagate_information(
    layout: &StateLayout,
    step: &LineStep,
    information: &mut [f64],
    spare: &mut Vec<f64>,
) {
    let dim = layout.dim();
    for row in information.chunks_exact_mut(dim) {
        propagate_adjoint(layout, step, row);
    }
    spare.clear();
    for row in 0..dim {
        spare.extend((0..dim).map(|column| information[column * dim + row]));
    }
    for row in spare.chunks_exact_mut(dim) {
        propagate_adjoint(layout, step, row);
    }
    // Makes the two triangles of the matrix equal.
    for row in 0..dim {
        for column in 0..dim {
            information[row * dim + column] = 0.5 * (spare[row * dim + column] + spare[column * dim + row]);
        }
    }
}

/// Λ ← (I − K H)ᵀ Λ (I − K H) + Hᵀ H/s, with H, K and the variance s of an innovation. `column` is a buffer.
pub(crate) fn correct_information(information: &mut [f64], h: &[f64], gain: &[f64], s: f64, column: &mut [f64]) {
    let dim = h.len();
    for (entry, row) in column.iter_mut().zip(information.chunks_exact(dim)) {
        *entry = dot(row, gain);
    }
    let half = 0.5 * (dot(column, gain) + 1.0 / s);
    column.iter_mut().zip(h).for_each(|(v, h)| *v -= half * h);
    for (row, (own_h, own_v)) in information.chunks_exact_mut(dim).zip(h.iter().zip(&*column)) {
        for (entry, (h, v)) in row.iter_mut().zip(h.iter().zip(&*column)) {
            *entry -= own_h * v + own_v * h;
        }
    }
}

/// Block of the 18 states of P − P Λ P, symmetric.
pub(crate) fn smoothed(predicted: &Gaussian, information: &[f64]) -> StateMatrix {
    let dim = predicted.dim();
    let mut moved = vec![0.0; STATES * dim];
    for (out, row) in moved.chunks_exact_mut(dim).zip(predicted.p.rows()) {
        for (factor, from) in row.iter().zip(information.chunks_exact(dim)) {
            covariance::add_scaled(out, *factor, from);
        }
    }
    let mut p = predicted.p.ins();
    for row in 0..STATES {
        let moved = &moved[row * dim..(row + 1) * dim];
        for (column, entries) in predicted.p.rows().take(row + 1).enumerate() {
            p[row][column] -= dot(moved, entries);
            p[column][row] = p[row][column];
        }
    }
    p
}
