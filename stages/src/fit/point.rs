//! One point of a sweep of fits: the model with its keys, and which columns it is fitted to.

use std::sync::Arc;

use schemas::Fault;

use super::{
    Fit,
    model::{Choose, FitModel, Settings},
};

/// A fit, its model with the keys that are the model's, and the settings with the model's defaults put in.
pub struct Point {
    /// The stage.
    pub fit: Fit,
    /// The model.
    pub model: Arc<dyn FitModel>,
    /// What most models have in common.
    pub settings: Settings,
}

/// What the points of a sweep share: the same matrix, filtered in the same way.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Matrix {
    /// The columns.
    pub features: Vec<String>,
    /// The bits of the lower and the upper corner in Hz, and the order.
    pub filter: (u64, u64, usize),
    /// Samples left out at each end of a run.
    pub trim: usize,
}

/// Columns that are explained together; one but for partial least squares of several.
pub type Targets = Vec<String>;

impl Point {
    /// Of a stage.
    pub fn new(fit: &Fit) -> Point {
        Point { model: fit.model.keys.clone(), settings: fit.settings(), fit: fit.clone() }
    }
}

impl Point {
    /// Where the chosen entries lie among all terms; `None` where all are used as they are.
    ///
    /// # Errors
    /// When an entry is not there or chosen twice, or none is chosen.
    pub fn places(&self, terms: &[String]) -> Result<Option<Vec<usize>>, Fault> {
        let Some(entries) = &self.fit.entries else { return Ok(None) };
        let mut places = vec![];
        for entry in entries {
            let one = terms.iter().position(|t| t == entry);
            let begins = |t: &String| t.strip_prefix(entry.as_str()).is_some_and(|rest| rest.starts_with('_'));
            let found: Vec<usize> = match one {
                Some(at) => vec![at],
                None => terms.iter().enumerate().filter(|(_, t)| begins(t)).map(|(i, _)| i).collect(),
            };
            if found.is_empty() {
                return Err(Fault::new(format!("the features have no entry `{entry}`")).nearest(entry, terms));
            }
            if let Some(twice) = found.iter().find(|i| places.contains(*i)) {
                return Err(Fault::new(format!("duplicate entry `{}`", terms[*twice])));
            }
            places.extend(found);
        }
        if places.is_empty() { Err(Fault::new("there is nothing to fit with")) } else { Ok(Some(places)) }
    }

    /// The target, and what is explained together with it.
    pub fn targets(&self) -> Targets {
        std::iter::once(&self.fit.target).chain(self.model.with_targets()).cloned().collect()
    }

    /// The matrix, which other points may share.
    pub fn matrix(&self) -> Matrix {
        let fit = &self.fit;
        let filter = (fit.low_hz.to_bits(), fit.high_hz.to_bits(), fit.order);
        Matrix { features: fit.features.clone(), filter, trim: fit.trim }
    }

    /// The strength of a ridge that is given, and not chosen.
    pub fn given_ridge(&self) -> Option<f64> {
        let given = self.model.is_ridge() && self.settings.choose == Choose::Given;
        self.model.lambda().filter(|_| given)
    }
}
