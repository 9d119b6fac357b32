//! Tables of `fit`, from which the prior of a filter is computed.

use arrow_array::{Array, RecordBatch, cast::AsArray};
use schemas::Fault;

use super::{STD, TERM, VALUE};
use crate::{columns::floats, fitted::rate_of};

/// Coefficients of one fit.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationPrior {
    /// Names of the terms.
    pub terms: Vec<String>,
    /// Coefficients, in nT.
    pub values_nt: Vec<f64>,
    /// Standard deviation of each coefficient, in nT, from the residual of the fit.
    pub sigmas_nt: Vec<f64>,
    /// Sample rate of terms that are differences per sample, in Hz; `None` if the table lacks it.
    pub rate_hz: Option<f64>,
}

impl CalibrationPrior {
    /// Calibration of a model table.
    ///
    /// # Errors
    /// Fails if the table has no terms or no values.
    pub fn from_table(table: &RecordBatch) -> Result<Self, Fault> {
        let values_nt = floats(table, VALUE)?.to_vec();
        let terms = table.column_by_name(TERM).and_then(|t| t.as_string_opt::<i32>());
        let terms = terms.ok_or_else(|| Fault::data("the model has no terms"))?;
        let terms: Vec<String> = (0..terms.len()).map(|row| terms.value(row).to_owned()).collect();
        Ok(Self { terms, values_nt, sigmas_nt: floats(table, STD)?.to_vec(), rate_hz: rate_of(table) })
    }

    /// Coefficient of a term and its standard deviation; `None` if the fit lacks the term.
    pub fn term(&self, name: &str) -> Option<(f64, f64)> {
        let at = self.terms.iter().position(|known| known == name)?;
        Some((self.values_nt[at], self.sigmas_nt[at]))
    }
}
