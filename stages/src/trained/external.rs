//! Table of a model whose code is outside this program, such as a Python function.
//!
//! The program that has the code sets one reader ([`set_external_reader`]). A program without a reader rejects the
//! table.

use std::{
    fmt,
    sync::{Arc, OnceLock},
};

use schemas::Fault;

use super::{
    FieldPrediction,
    terms::{TermLookup, TermValue},
};

/// A model that other code fits and applies.
pub trait ExternalModel: fmt::Debug + Send + Sync {
    /// Names of the columns of an input row.
    fn columns(&self) -> &[String];

    /// Prediction for rows of [`ExternalModel::columns`], row-major and finite.
    ///
    /// # Errors
    /// Fails if the code of the model fails, or does not return one value per row.
    fn predict(&self, x: &[f64]) -> Result<FieldPrediction, Fault>;

    /// Terms of the model's table.
    fn terms(&self) -> Vec<TermValue>;
}

/// Function that creates an external model from the terms of its table.
pub type ExternalModelReader = fn(&TermLookup) -> Result<Arc<dyn ExternalModel>, Fault>;

static READER: OnceLock<ExternalModelReader> = OnceLock::new();

/// Sets the reader of this process. Only the first call has an effect.
pub fn set_external_reader(reader: ExternalModelReader) {
    READER.get_or_init(|| reader);
}

/// An [`ExternalModel`]. Models with equal terms are equal.
#[derive(Clone, Debug)]
pub struct ForeignModel(pub Arc<dyn ExternalModel>);

impl PartialEq for ForeignModel {
    fn eq(&self, other: &Self) -> bool {
        self.0.terms() == other.0.terms()
    }
}

impl ForeignModel {
    /// See [`ExternalModel::columns`].
    pub fn columns(&self) -> &[String] {
        self.0.columns()
    }

    /// See [`ExternalModel::predict`].
    ///
    /// # Errors
    /// Fails in the cases of [`ExternalModel::predict`]. Also fails if the number of predictions differs from the
    /// number of rows.
    pub fn predict(&self, x: &[f64]) -> Result<FieldPrediction, Fault> {
        let rows = x.len() / self.columns().len().max(1);
        let made = self.0.predict(x)?;
        let given = made.field_nt.len();
        if given != rows || made.sigma_nt.as_ref().is_some_and(|sigma| sigma.len() != rows) {
            return Err(Fault::data(format!("the model returned {given} predictions for {rows} rows")));
        }
        Ok(made)
    }

    /// See [`ExternalModel::terms`].
    pub fn terms(&self) -> Vec<TermValue> {
        self.0.terms()
    }

    /// Reads the model of a table.
    ///
    /// # Errors
    /// Fails if this program has no reader, or the reader rejects the terms.
    pub fn read(reading: &TermLookup) -> Result<ForeignModel, Fault> {
        let Some(reader) = READER.get() else {
            let name = reading.word("model").unwrap_or("unknown");
            let what = format!("the model `{name}` is written in Python, which this program cannot run");
            return Err(
                Fault::data(what).help("use the command `magline` of the Python package, with `--parts FILE.py`")
            );
        };
        Ok(ForeignModel(reader(reading)?))
    }
}

#[cfg(test)]
mod tests {
    use super::super::LearnedModel;

    #[test]
    fn unit_a_program_without_python_rejects_the_table() {
        let names = ["family python", "model forest"].map(str::to_owned);
        let fault = LearnedModel::read(&names, &[1.0, 1.0]).err().map(|fault| fault.what);
        assert_eq!(fault.as_deref(), Some("the model `forest` is written in Python, which this program cannot run"));
    }
}
