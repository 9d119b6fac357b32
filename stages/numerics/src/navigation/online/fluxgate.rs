//! Constant errors of the vector magnetometer, and the dependence of the Tolles-Lawson terms on them.

use std::ops::Range;

use crate::compensation::tolles_lawson::{BodyFieldColumns, TermSelection, matrix_in_runs};
use crate::navigation::ins_error::ParameterError;

use super::augmented::refused;

/// Vector magnetometer whose bias is estimated along with the coefficients.
///
/// The bias b is truth minus reading. The terms are computed from the vector B + b; this affects permanent, induced and
/// eddy terms. For the aircraft field F = a + b_ind V/s + c Ḃ/s along u = V/|V| with V = B + b,
///
/// ```text
/// ∂(F·u)/∂b = (F − (F·u) u)/|V| + b_indᵀ u/s
/// ```
///
/// The only singularity is |V| = 0, where the terms are undefined. (MagNav.jl uses the same method, but divides by B_x
/// and keeps |V| constant.)
#[derive(Clone, Copy, Debug)]
pub struct Fluxgate<'a> {
    /// Components of the vector in the body frame, in nT; the scalar reading `bt` must be `None`.
    pub field: BodyFieldColumns<'a>,
    /// Selection of the terms. The first columns of every magnetometer's terms must be identical to these terms.
    pub terms: &'a TermSelection,
    /// Scale of induced and eddy terms, in nT.
    pub scale_nt: f64,
    /// Runs of rows within which the terms are differenced; if empty, the whole line.
    pub runs: &'a [Range<usize>],
    /// Standard deviation of the bias of each axis, in nT.
    pub sigma_nt: f64,
    /// Correlation time of the bias, in seconds; infinite for a constant.
    pub tau_s: f64,
}

/// Column of the matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
enum FluxgateTermKind {
    /// u_i.
    Permanent(usize),
    /// u_i V_j/s.
    Induced(usize, usize),
    /// u_i Ḃ_j/s.
    Eddy(usize, usize),
    /// Ḃ_i.
    Derivative(usize),
    /// 1.
    Bias,
}

impl FluxgateTermKind {
    fn from_name(name: &str) -> Option<Self> {
        let (axes, changes) = match name.strip_suffix("_dot") {
            _ if name == "bias" => return Some(Self::Bias),
            Some(axes) => (axes, true),
            None => (name, false),
        };
        let axes: Vec<usize> = axes.chars().filter_map(|axis| "xyz".find(axis)).collect();
        match (axes.as_slice(), changes) {
            ([i], false) => Some(Self::Permanent(*i)),
            ([i], true) => Some(Self::Derivative(*i)),
            ([i, j], false) => Some(Self::Induced(*i, *j)),
            ([i, j], true) => Some(Self::Eddy(*i, *j)),
            _ => None,
        }
    }
}

/// Terms of a line at any bias.
pub(crate) struct FluxgateTerms<'a> {
    field: BodyFieldColumns<'a>,
    terms: Vec<FluxgateTermKind>,
    scale_nt: f64,
    /// Ḃ, three values per row.
    change: Vec<f64>,
}

/// Vector-magnetometer reading of a row: direction, components and norm in nT, and the change of the reading divided by
/// the scale.
#[derive(Clone, Copy)]
struct FluxgateVector {
    u: [f64; 3],
    v: [f64; 3],
    norm: f64,
    change: [f64; 3],
}

impl<'a> FluxgateTerms<'a> {
    /// Fails if the terms use the reading of a scalar magnetometer (`bt`). Also returns the errors of
    /// [`matrix_in_runs`].
    pub(crate) fn new(fluxgate: &Fluxgate<'a>) -> Result<Self, ParameterError> {
        let Fluxgate { field, terms, scale_nt, runs, sigma_nt, tau_s } = *fluxgate;
        if field.bt.is_some() {
            let what = "the terms are scaled with the reading of a scalar magnetometer, so the correction would \
                        depend on the filter's own measurement";
            return Err(refused("terms", what));
        }
        if !(sigma_nt >= 0.0 && sigma_nt.is_finite()) {
            return Err(refused(
                "flux_bias_sigma_nt",
                format!("the standard deviation of the bias must not be below 0, but is {sigma_nt}"),
            ));
        }
        if tau_s.is_nan() || tau_s <= 0.0 {
            return Err(refused(
                "flux_bias_tau_s",
                format!("the time constant of the bias must be above 0, but is {tau_s}"),
            ));
        }
        let bad = |fault: crate::compensation::AMatrixError| refused("terms", fault.to_string());
        let derivative = TermSelection::new(&["derivative"]).map_err(bad)?;
        let whole = 0..field.x.len();
        let runs = if runs.is_empty() { std::slice::from_ref(&whole) } else { runs };
        let change = matrix_in_runs(&field, &derivative, scale_nt, runs).map_err(bad)?;
        let of = |name: &str| {
            FluxgateTermKind::from_name(name).ok_or_else(|| refused("terms", format!("the term `{name}` is unknown")))
        };
        let terms = terms.names().into_iter().map(of).collect::<Result<_, _>>()?;
        Ok(Self { field, terms, scale_nt, change })
    }

    /// Number of terms.
    pub(crate) fn len(&self) -> usize {
        self.terms.len()
    }

    /// Number of rows.
    pub(crate) fn rows(&self) -> usize {
        self.field.x.len()
    }

    #[inline(always)]
    fn vector(&self, row: usize, bias_nt: [f64; 3]) -> FluxgateVector {
        let [x, y, z] = bias_nt;
        let v = [self.field.x[row] + x, self.field.y[row] + y, self.field.z[row] + z];
        let norm = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
        let norm = if norm == 0.0 { f64::NAN } else { norm };
        let change = std::array::from_fn(|axis| self.change[3 * row + axis]);
        FluxgateVector { u: v.map(|v| v / norm), v, norm, change }
    }

    #[inline(always)]
    fn term(&self, at: &FluxgateVector, term: FluxgateTermKind) -> f64 {
        match term {
            FluxgateTermKind::Permanent(i) => at.u[i],
            FluxgateTermKind::Induced(i, j) => at.u[i] * (at.v[j] / self.scale_nt),
            FluxgateTermKind::Eddy(i, j) => at.u[i] * (at.change[j] / self.scale_nt),
            FluxgateTermKind::Derivative(i) => at.change[i],
            FluxgateTermKind::Bias => 1.0,
        }
    }

    /// Terms of a row at a bias, in nT; NaN if the vector is unknown or zero.
    #[inline(always)]
    pub(crate) fn row(&self, row: usize, bias_nt: [f64; 3], out: &mut [f64]) {
        let at = self.vector(row, bias_nt);
        for (out, term) in out.iter_mut().zip(&self.terms) {
            *out = self.term(&at, *term);
        }
    }

    /// Derivatives of the terms times `coefficients` with respect to the bias, in nT/nT.
    #[inline(always)]
    pub(crate) fn derivatives(&self, row: usize, bias_nt: [f64; 3], coefficients: &[f64]) -> [f64; 3] {
        let at = self.vector(row, bias_nt);
        // F, and b_indᵀ u/s.
        let (mut force, mut direct) = ([0.0; 3], [0.0; 3]);
        for (coefficient, term) in coefficients.iter().zip(&self.terms) {
            match *term {
                FluxgateTermKind::Permanent(i) => force[i] += coefficient,
                FluxgateTermKind::Induced(i, j) => {
                    force[i] += coefficient * (at.v[j] / self.scale_nt);
                    direct[j] += coefficient * (at.u[i] / self.scale_nt);
                }
                FluxgateTermKind::Eddy(i, j) => force[i] += coefficient * (at.change[j] / self.scale_nt),
                FluxgateTermKind::Derivative(_) | FluxgateTermKind::Bias => {}
            }
        }
        let along = force[0] * at.u[0] + force[1] * at.u[1] + force[2] * at.u[2];
        std::array::from_fn(|axis| (force[axis] - along * at.u[axis]) / at.norm + direct[axis])
    }
}
