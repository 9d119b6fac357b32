//! One point of a sweep of fits: the model with its keys, and the columns that it is fitted to.

use std::sync::Arc;

use schemas::Fault;

use super::{
    model::{FitModel, FitModelDecl},
    question::{DesignMatrixKey, TargetColumns},
    settings::{FitSettings, ModelSelection},
};

/// A model with its keys, its settings including defaults, and its columns.
pub struct FitPoint {
    /// Declaration of the model.
    pub kind: &'static FitModelDecl,
    /// Keys of the model.
    pub model: Arc<dyn FitModel>,
    /// Settings that most models have.
    pub settings: FitSettings,
    /// Target column.
    pub target: String,
    /// Entries of the features to use. `None` selects all.
    pub entries: Option<Vec<String>>,
    /// Matrix, which other points may share.
    pub matrix: DesignMatrixKey,
}

impl FitPoint {
    /// Positions of the chosen entries among all terms. `None` if all are used in order.
    ///
    /// # Errors
    /// Fails if an entry is missing or chosen twice, or no entry is chosen.
    pub fn places(&self, terms: &[String]) -> Result<Option<Vec<usize>>, Fault> {
        self.entries.as_ref().map(|entries| places(entries, terms)).transpose()
    }

    /// The target, and the columns that are fitted together with it.
    pub fn targets(&self) -> TargetColumns {
        std::iter::once(&self.target).chain(self.model.with_targets()).cloned().collect()
    }

    /// Ridge parameter, if the keys give it and `choose` does not select it.
    pub fn given_ridge(&self) -> Option<f64> {
        let given = self.model.is_ridge() && self.settings.choose == ModelSelection::Given;
        self.model.lambda().filter(|_| given)
    }
}

/// Positions of the entries among all terms. Each entry is a name, or a prefix of several names before a `_`.
///
/// # Errors
/// Fails if an entry is missing or chosen twice, or no entry is chosen.
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
    if places.is_empty() {
        Err(Fault::new("the list of entries is empty; name at least one entry"))
    } else {
        Ok(places)
    }
}
