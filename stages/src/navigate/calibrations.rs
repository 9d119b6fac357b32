//! The tables of `fit` that a filter starts from.

use arrow_array::{Array, RecordBatch, cast::AsArray};
use schemas::Fault;

use super::{TERM, VALUE};
use crate::columns::floats;

/// The coefficients of one fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// The names of the terms.
    pub terms: Vec<String>,
    /// Their coefficients, in nT.
    pub values_nt: Vec<f64>,
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
        Ok(Self { terms, values_nt })
    }

    /// The coefficients of `terms`, in their order.
    ///
    /// # Errors
    /// When one is not among the model's.
    pub fn in_order(&self, terms: &[String]) -> Result<Vec<f64>, Fault> {
        let value = |term: &String| {
            let at = self.terms.iter().position(|known| known == term);
            at.map(|at| self.values_nt[at]).ok_or_else(|| {
                Fault::data(format!("the model has no term `{term}`"))
                    .help("fit it on the same terms")
                    .of_param("model")
            })
        };
        terms.iter().map(value).collect()
    }
}
