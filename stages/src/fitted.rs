//! A fitted model, read from its table and applied to a line.

use std::{cell::OnceCell, ops::Range};

use arrow_array::{RecordBatch, cast::AsArray};
use numerics::signal::segments::RowMask;
use schemas::{ColumnType, Fault, RateDependence};

use crate::{
    columns::{even_rate_hz, floats, matrix, rate_factor, sampling},
    model_columns::{INTERCEPT, RATE},
    trained::{FieldPrediction, LearnedModel, PredictionParts},
};

/// Kind of a model.
pub enum FittedModelForm {
    /// Coefficients and terms of a linear model.
    Linear { terms: Vec<String>, values: Vec<f64> },
    /// Nonlinear model.
    Learned(Box<LearnedModel>),
}

/// Model read from the table of a `fit`.
pub struct FittedModel {
    /// Kind of the model.
    pub body: FittedModelForm,
    /// Sample rate of the model's terms that are differences per sample, in Hz. `None` if the table does not contain
    /// the rate.
    pub rate_hz: Option<f64>,
}

impl FittedModel {
    /// Reads the model of a table, omitting the terms `without`.
    ///
    /// # Errors
    /// Fails if the table is incomplete, or a term to omit is missing.
    pub fn read(table: &RecordBatch, without: &[String]) -> Result<Self, Fault> {
        let values = floats(table, "value")?;
        let terms = table.column_by_name("term").and_then(|t| t.as_string_opt::<i32>());
        let terms = terms.ok_or_else(|| Fault::data("the model table has no column `term`"))?;
        let terms: Vec<String> = terms.iter().map(|t| t.unwrap_or_default().to_owned()).collect();
        let rate_hz = rate_of(table);
        if let Some(learned) = LearnedModel::read(&terms, values)? {
            if !without.is_empty() {
                let what = "the model is nonlinear, so `without` cannot omit terms";
                return Err(Fault::data(what).of_param("without"));
            }
            return Ok(Self { body: FittedModelForm::Learned(Box::new(learned)), rate_hz });
        }
        if let Some(name) = without.iter().find(|w| !terms.contains(w)) {
            return Err(
                Fault::data(format!("the model has no term `{name}`, which `without` names")).of_param("without")
            );
        }
        let kept = terms.into_iter().zip(values.iter().copied()).filter(|(t, _)| !without.contains(t));
        let (terms, values) = kept.unzip();
        Ok(Self { body: FittedModelForm::Linear { terms, values }, rate_hz })
    }

    /// Prediction for a line with `rows` rows. NaN where a required column is NaN. Entries that are differences per
    /// sample are converted to the rate of the model.
    ///
    /// # Errors
    /// Fails if the line lacks a column, or an entry cannot be converted.
    pub fn predict(&self, line: &RecordBatch, rows: usize) -> Result<FieldPrediction, Fault> {
        predict(&ModelInputColumns::new(line, self.rate_hz)?, &self.body, rows)
    }

    /// Parts of the prediction `field_nt` for a line, in nT. NaN where a required column is NaN. A linear model has
    /// only the linear part.
    ///
    /// # Errors
    /// Fails in the cases of [`FittedModel::predict`].
    pub fn parts(&self, line: &RecordBatch, field_nt: &[f64]) -> Result<PredictionParts, Fault> {
        let FittedModelForm::Learned(learned) = &self.body else {
            return Ok(PredictionParts { linear_nt: field_nt.to_vec(), vectors_nt: vec![] });
        };
        let rows = field_nt.len();
        let inputs = CompleteRows::new(&ModelInputColumns::new(line, self.rate_hz)?, learned, rows)?;
        let parts = learned.prediction_parts(&inputs.x);
        let vectors_nt =
            if parts.vectors_nt.is_empty() { vec![] } else { inputs.spread(parts.vectors_nt, rows, [f64::NAN; 12]) };
        Ok(PredictionParts { linear_nt: inputs.spread(parts.linear_nt, rows, f64::NAN), vectors_nt })
    }

    /// Entries of the features that the model requires.
    pub fn columns(&self) -> Vec<String> {
        match &self.body {
            FittedModelForm::Linear { terms, .. } => terms.iter().filter(|t| *t != INTERCEPT).cloned().collect(),
            FittedModelForm::Learned(learned) => learned.columns().to_vec(),
        }
    }

    /// Values of [`FittedModel::columns`] in each row of a line, converted to the rate of the model, column by column.
    ///
    /// # Errors
    /// Fails in the cases of [`FittedModel::predict`].
    pub fn inputs(&self, line: &RecordBatch) -> Result<Vec<Vec<f64>>, Fault> {
        let sources = ModelInputColumns::new(line, self.rate_hz)?;
        self.columns().iter().map(|name| Ok(sources.find(name)?.values().collect())).collect()
    }

    /// Coefficients of a linear model, in the order of [`FittedModel::columns`], and the constant of the model. `None`
    /// for a nonlinear model.
    pub fn coefficients(&self) -> Option<(Vec<f64>, f64)> {
        let FittedModelForm::Linear { terms, values } = &self.body else { return None };
        let of = |constant: bool| terms.iter().zip(values).filter(move |(t, _)| (*t == INTERCEPT) == constant);
        Some((of(false).map(|(_, v)| *v).collect(), of(true).map(|(_, v)| v).sum()))
    }

    /// Predicted field for rows of [`FittedModel::columns`], in nT. Rows are row-major and finite.
    ///
    /// # Errors
    /// Fails if a model written in Python fails.
    pub fn field_nt(&self, x: &[f64]) -> Result<Vec<f64>, Fault> {
        Ok(match (&self.body, self.coefficients()) {
            (FittedModelForm::Learned(learned), _) => {
                learned.predict(x, &vec![1; x.len() / learned.columns().len().max(1)])?.field_nt
            }
            (FittedModelForm::Linear { .. }, Some((b, constant))) => {
                let rows = x.chunks_exact(b.len().max(1));
                rows.map(|row| constant + row.iter().zip(&b).map(|(a, b)| a * b).sum::<f64>()).collect()
            }
            (FittedModelForm::Linear { .. }, None) => vec![],
        })
    }
}

/// Source of the values of a term: an entry of a list column, or a column.
enum TermSource<'a> {
    Entry { rows: &'a [f64], width: usize, at: usize, factor: f64 },
    Column(&'a [f64]),
}

impl TermSource<'_> {
    fn values(&self) -> impl Iterator<Item = f64> + '_ {
        let (rows, at, width, factor) = match self {
            TermSource::Entry { rows, width, at, factor } => (*rows, *at, *width, *factor),
            TermSource::Column(x) => (*x, 0, 1, 1.0),
        };
        rows.iter().skip(at).step_by(width.max(1)).map(move |x| factor * x)
    }
}

/// Columns of a line, and entries of its list columns.
struct ModelInputColumns<'a> {
    batch: &'a RecordBatch,
    lists: Vec<ListColumn<'a>>,
    /// Rate of the model, in Hz.
    rate_hz: Option<f64>,
}

struct ListColumn<'a> {
    column: String,
    rows: &'a [f64],
    names: Vec<String>,
    sampling: OnceCell<Result<RateDependence, Fault>>,
}

impl<'a> ModelInputColumns<'a> {
    fn new(batch: &'a RecordBatch, rate_hz: Option<f64>) -> Result<Self, Fault> {
        let mut lists = vec![];
        for field in batch.schema_ref().fields() {
            if matches!(schemas::describe_field(field).column_type, ColumnType::List(_)) {
                let (rows, names) = matrix(batch, field.name())?;
                lists.push(ListColumn { column: field.name().clone(), rows, names, sampling: OnceCell::new() });
            }
        }
        Ok(Self { batch, lists, rate_hz })
    }

    fn find(&self, term: &str) -> Result<TermSource<'a>, Fault> {
        let place = |list: &'_ ListColumn<'a>| list.names.iter().position(|n| n == term);
        let Some((list, at)) = self.lists.iter().find_map(|list| Some((list, place(list)?))) else {
            return floats(self.batch, term).map(TermSource::Column);
        };
        let own = list.sampling.get_or_init(|| sampling(self.batch, &list.column)).as_ref();
        let factor = own.map_err(Fault::clone).and_then(|own| rate_factor(own, term, self.rate_hz));
        let factor = factor.map_err(|fault| fault.in_column(&list.column))?;
        Ok(TermSource::Entry { rows: list.rows, width: list.names.len(), at, factor })
    }
}

/// Sample rate of the lines of a fit, read from the table of the fit, in Hz. `None` if the table does not contain the
/// rate.
pub fn rate_of(table: &RecordBatch) -> Option<f64> {
    floats(table, RATE).ok()?.first().copied().filter(|rate_hz| *rate_hz > 0.0)
}

/// Predicted field of each sample, in nT.
fn predict(sources: &ModelInputColumns, body: &FittedModelForm, rows: usize) -> Result<FieldPrediction, Fault> {
    match body {
        FittedModelForm::Linear { terms, values } => {
            let mut sum = vec![0.0; rows];
            for (term, value) in terms.iter().zip(values) {
                if term == INTERCEPT {
                    sum.iter_mut().for_each(|s| *s += value);
                } else {
                    sum.iter_mut().zip(sources.find(term)?.values()).for_each(|(s, x)| *s += value * x);
                }
            }
            Ok(FieldPrediction { field_nt: sum, sigma_nt: None })
        }
        FittedModelForm::Learned(learned) => predict_rows(sources, learned, rows),
    }
}

/// Rows of a line in which no required column of a nonlinear model is NaN.
struct CompleteRows {
    /// Required columns of all rows, column by column.
    columns: Vec<Vec<f64>>,
    /// Indices of the complete rows.
    numbers: Vec<usize>,
    /// Values of the complete rows, row-major.
    x: Vec<f64>,
}

impl CompleteRows {
    fn new(sources: &ModelInputColumns, learned: &LearnedModel, rows: usize) -> Result<Self, Fault> {
        let columns = learned.columns().iter().map(|name| sources.find(name)).collect::<Result<Vec<_>, Fault>>()?;
        let columns: Vec<Vec<f64>> = columns.iter().map(|source| source.values().collect()).collect();
        let numbers: Vec<usize> = (0..rows).filter(|&row| columns.iter().all(|x| x[row].is_finite())).collect();
        let x = numbers.iter().flat_map(|&row| columns.iter().map(move |x| x[row])).collect();
        Ok(Self { columns, numbers, x })
    }

    /// Expands the values of the complete rows to all rows; incomplete rows have the value `unknown`.
    fn spread<T: Copy>(&self, values: Vec<T>, rows: usize, unknown: T) -> Vec<T> {
        let mut out = vec![unknown; rows];
        self.numbers.iter().zip(values).for_each(|(&row, value)| out[row] = value);
        out
    }
}

/// Prediction of a nonlinear model. NaN where a required column is NaN.
fn predict_rows(sources: &ModelInputColumns, learned: &LearnedModel, rows: usize) -> Result<FieldPrediction, Fault> {
    let inputs = CompleteRows::new(sources, learned, rows)?;
    let runs = if learned.sees_a_window() {
        let tt = floats(sources.batch, "tt")?;
        let rate_hz = even_rate_hz(tt)?;
        learned.check_rate(rate_hz)?;
        let usable = inputs.columns.iter().fold(RowMask::all(rows), |usable, x| usable.and_finite(x));
        usable.runs_in_time(tt, rate_hz).iter().map(Range::len).collect()
    } else {
        vec![inputs.numbers.len()]
    };
    let made = learned.predict(&inputs.x, &runs)?;
    let spread = |values: Vec<f64>| inputs.spread(values, rows, f64::NAN);
    Ok(FieldPrediction { field_nt: spread(made.field_nt), sigma_nt: made.sigma_nt.map(spread) })
}
