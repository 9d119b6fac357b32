//! The Tolles-Lawson matrix: dependence of the aircraft field on the attitude in the earth's field.
//!
//! B denotes the reading of the vector magnetometer in the body frame (nT), and Bt its magnitude. In the modified
//! model, Bt is the reading of a scalar magnetometer. Ḃ is the central difference of B per sample, and s a scale. The
//! terms are: permanent B_i/Bt, induced B_i B_j/(Bt s), eddy B_i Ḃ_j/(Bt s), derivative Ḃ_i, bias 1. [Tolles and Lawson
//! 1950; Gnadt 2022 eqs. 3.15-3.20, with the scale that eq. 3.20 omits and eddy currents driven by the change of the
//! vector, as MagNav.jl computes them]

mod terms;

use std::ops::Range;

pub use terms::{TermFamily, TermGroup, TermSelection};

use terms::{COLUMNS, DERIVATIVE, EDDY, INDUCED};

/// The scale of induced and eddy terms of the published tables, in nT.
pub const DEFAULT_SCALE_NT: f64 = 50_000.0;

/// Error of a request for an A-matrix.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AMatrixError {
    /// No group has this name.
    #[error("unknown group of terms `{name}`; the available groups are {}", terms::names_of_groups())]
    Unknown {
        /// The given name.
        name: String,
    },
    /// Two groups of the same family, whose columns would be linearly dependent.
    #[error("`{one}` and `{other}` contain the same terms, which a fit cannot separate; remove one")]
    SameFamily {
        /// The group named first.
        one: &'static str,
        /// The group named later.
        other: &'static str,
    },
    /// The list of groups is empty.
    #[error("the list of groups of terms is empty; the available groups are {}", terms::names_of_groups())]
    Empty,
    /// Columns of different lengths.
    #[error("the columns have different lengths: {lengths:?}")]
    Lengths {
        /// The lengths of x, y, z and, if given, the scalar.
        lengths: Vec<usize>,
    },
    /// The scale is not a positive number.
    #[error("the scale of the induced and eddy terms must be above 0 nT, but is {scale_nt} nT")]
    Scale {
        /// The given scale, in nT.
        scale_nt: f64,
    },
}

/// Components of a vector magnetometer in the body frame, in nT, and the scalar that divides them.
#[derive(Debug, Clone, Copy)]
pub struct BodyFieldColumns<'a> {
    /// Component along the nose, in nT.
    pub x: &'a [f64],
    /// Component to the right.
    pub y: &'a [f64],
    /// Component down.
    pub z: &'a [f64],
    /// Scalar magnetometer of the modified model, in nT; `None` uses the vector's magnitude.
    pub bt: Option<&'a [f64]>,
}

impl BodyFieldColumns<'_> {
    fn rows(&self) -> Result<usize, AMatrixError> {
        let rows = self.x.len();
        let bt = self.bt.map_or(rows, <[f64]>::len);
        if [self.y.len(), self.z.len(), bt].iter().all(|len| *len == rows) {
            return Ok(rows);
        }
        let vector = [self.x, self.y, self.z];
        Err(AMatrixError::Lengths { lengths: vector.into_iter().chain(self.bt).map(<[f64]>::len).collect() })
    }

    fn finite(&self, row: usize) -> bool {
        (self.x[row] + self.y[row] + self.z[row]).is_finite()
    }
}

/// The Tolles-Lawson matrix, row-major, one row per sample and one column per term in the order of
/// [`TermSelection::names`].
///
/// Differences are taken within each run of samples with a finite vector. The differences are one-sided at the ends of
/// a run and never cross a gap. In a run of a single sample the differences are NaN. A sample whose vector is not
/// finite has NaN in all terms except the bias. A sample whose scalar is zero or not finite has NaN in the terms
/// divided by it.
///
/// # Errors
/// Fails with [`AMatrixError::Lengths`] for columns of different lengths, or with [`AMatrixError::Scale`] for a scale
/// that is not a finite number above 0.
pub fn matrix(field: &BodyFieldColumns<'_>, terms: &TermSelection, scale_nt: f64) -> Result<Vec<f64>, AMatrixError> {
    let rows = field.rows()?;
    let whole = 0..rows;
    matrix_in_runs(field, terms, scale_nt, std::slice::from_ref(&whole))
}

/// The [`matrix`] with breaks that are not visible in the field itself, such as jumps of time. A difference stays
/// within its run. Rows outside all `runs` are NaN in all terms except the bias.
///
/// # Errors
/// Returns the errors of [`matrix`].
pub fn matrix_in_runs(
    field: &BodyFieldColumns<'_>,
    terms: &TermSelection,
    scale_nt: f64,
    runs: &[Range<usize>],
) -> Result<Vec<f64>, AMatrixError> {
    let rows = field.rows()?;
    if !(scale_nt > 0.0 && scale_nt.is_finite()) {
        return Err(AMatrixError::Scale { scale_nt });
    }
    let mut out = Vec::with_capacity(rows * terms.len());
    for run in runs {
        let (start, end) = (run.start.min(rows), run.end.min(rows));
        fill_missing(&mut out, terms, start);
        fill_run(&mut out, field, terms, scale_nt, start..end);
    }
    fill_missing(&mut out, terms, rows);
    Ok(out)
}

/// Appends rows of NaN until `out` has `rows` rows.
fn fill_missing(out: &mut Vec<f64>, terms: &TermSelection, rows: usize) {
    let missing = missing_row();
    while out.len() < rows * terms.len() {
        out.extend(terms.columns().iter().map(|&column| missing[column]));
    }
}

fn missing_row() -> [f64; COLUMNS] {
    let mut row = [f64::NAN; COLUMNS];
    row[COLUMNS - 1] = 1.0;
    row
}

fn fill_run(out: &mut Vec<f64>, field: &BodyFieldColumns<'_>, terms: &TermSelection, scale_nt: f64, run: Range<usize>) {
    let mut row = run.start;
    while row < run.end {
        if !field.finite(row) {
            row += 1;
            fill_missing(out, terms, row);
            continue;
        }
        let end = (row..run.end).find(|&row| !field.finite(row)).unwrap_or(run.end);
        fill_finite(out, field, terms, scale_nt, row..end);
        row = end;
    }
}

fn fill_finite(
    out: &mut Vec<f64>,
    field: &BodyFieldColumns<'_>,
    terms: &TermSelection,
    scale_nt: f64,
    run: Range<usize>,
) {
    let last = run.end - 1;
    for row in run.clone() {
        let (before, after) = (row.max(run.start + 1) - 1, (row + 1).min(last));
        // Central difference in the middle of a run, one-sided at the ends of the run, undefined in a run of one
        // sample.
        let steps = match after - before {
            0 => f64::NAN,
            steps => steps as f64,
        };
        let slope = |x: &[f64]| (x[after] - x[before]) / steps;
        let b = [field.x[row], field.y[row], field.z[row]];
        let change = [slope(field.x), slope(field.y), slope(field.z)];
        let bt = match field.bt {
            Some(bt) => bt[row],
            None => (b[0] * b[0] + b[1] * b[1] + b[2] * b[2]).sqrt(),
        };
        let all = full_row(b, change, bt, scale_nt);
        out.extend(terms.columns().iter().map(|&column| all[column]));
    }
}

/// All 22 terms of one sample in the order of the table.
#[inline(always)]
fn full_row(b: [f64; 3], change: [f64; 3], bt: f64, scale_nt: f64) -> [f64; COLUMNS] {
    let bt = if bt == 0.0 { f64::NAN } else { bt };
    let cosine = [b[0] / bt, b[1] / bt, b[2] / bt];
    let (scaled_b, scaled_change) = (b.map(|b| b / scale_nt), change.map(|d| d / scale_nt));
    let mut row = missing_row();
    row[..INDUCED].copy_from_slice(&cosine);
    let pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
    for (value, (i, j)) in row[INDUCED..EDDY].iter_mut().zip(pairs) {
        *value = cosine[i] * scaled_b[j];
    }
    for (k, value) in row[EDDY..DERIVATIVE].iter_mut().enumerate() {
        *value = cosine[k / 3] * scaled_change[k % 3];
    }
    row[DERIVATIVE..DERIVATIVE + 3].copy_from_slice(&change);
    row
}

#[cfg(test)]
mod tests;
