//! One point of a sweep of fits: the model with its keys, and which columns it is fitted to.

use std::sync::Arc;

use schemas::Fault;

use super::{
    model::{FitModel, Model},
    question::{Matrix, Targets},
    settings::{Choose, Settings},
};

/// A model with its keys, the settings with the model's defaults put in, and what it is fitted to.
pub struct Point {
    /// Declaration of the model.
    pub kind: &'static Model,
    /// The model.
    pub model: Arc<dyn FitModel>,
    /// Common settings of most models.
    pub settings: Settings,
    /// The column that is explained.
    pub target: String,
    /// The entries of the features that are used; all of them without.
    pub entries: Option<Vec<String>>,
    /// The matrix, which other points may share.
    pub matrix: Matrix,
}

impl Point {
    /// Where the chosen entries lie among all terms; `None` where all are used as they are.
    ///
    /// # Errors
    /// When an entry is not there or chosen twice, or none is chosen.
    pub fn places(&self, terms: &[String]) -> Result<Option<Vec<usize>>, Fault> {
        self.entries.as_ref().map(|entries| places(entries, terms)).transpose()
    }

    /// The target, and what is explained together with it.
    pub fn targets(&self) -> Targets {
        std::iter::once(&self.target).chain(self.model.with_targets()).cloned().collect()
    }

    /// The strength of a ridge that is given, and not chosen.
    pub fn given_ridge(&self) -> Option<f64> {
        let given = self.model.is_ridge() && self.settings.choose == Choose::Given;
        self.model.lambda().filter(|_| given)
    }
}

/// Where the entries lie among all terms: their names, or what several names have before a `_`.
///
/// # Errors
/// When an entry is not there or chosen twice, or none is chosen.
pub fn places(entries: &[String], terms: &[String]) -> Result<Vec<usize>, Fault> {
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
    if places.is_empty() { Err(Fault::new("there is nothing to fit with")) } else { Ok(places) }
}
