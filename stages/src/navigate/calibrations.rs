//! The tables of `fit` that a filter starts from.

use arrow_array::{Array, RecordBatch, cast::AsArray};
use schemas::Fault;

use super::{STD, TERM, VALUE};
use crate::{columns::floats, fitted::rate_of};

/// The coefficients of one fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// The names of the terms.
    pub terms: Vec<String>,
    /// Their coefficients, in nT.
    pub values_nt: Vec<f64>,
    /// One sigma of each, from the residual of the fit, in nT.
    pub sigmas_nt: Vec<f64>,
    /// The rate at which terms are differences per sample, Hz; `None` of a table that does not say.
    pub rate_hz: Option<f64>,
}

impl Calibration {
    /// Of a model table.
    ///
    /// # Errors
    /// When it names no terms, or has no values.
    pub fn of(table: &RecordBatch) -> Result<Self, Fault> {
        let values_nt = floats(table, VALUE)?.to_vec();
        let terms = table.column_by_name(TERM).and_then(|t| t.as_string_opt::<i32>());
        let terms = terms.ok_or_else(|| Fault::data("the model names no terms"))?;
        let terms: Vec<String> = (0..terms.len()).map(|row| terms.value(row).to_owned()).collect();
        Ok(Self { terms, values_nt, sigmas_nt: floats(table, STD)?.to_vec(), rate_hz: rate_of(table) })
    }

    /// The coefficient of a term and its one sigma; `None` where the fit has no such term.
    pub fn term(&self, name: &str) -> Option<(f64, f64)> {
        let at = self.terms.iter().position(|known| known == name)?;
        Some((self.values_nt[at], self.sigmas_nt[at]))
    }
}
