//! Principal components in place of the features of a fit.

use numerics::regression::{
    least_squares::{LinearFit, Moments, Scaling},
    principal_components::{Kept, PrincipalComponents},
};
use schemas::Fault;

use super::problem::Problem;
use crate::columns::data;

/// The components that a fit is made of, and the features that they are made of.
pub struct Components {
    found: PrincipalComponents,
    features: Vec<String>,
}

impl Components {
    /// The moments of the components, of those of the features.
    ///
    /// # Errors
    /// When the features are not as many as those of the components.
    pub fn of(&self, features: &Moments) -> Result<Moments, Fault> {
        let (weights, offsets) = self.found.as_sums();
        features.combined(&weights, &offsets).map_err(data)
    }

    /// A model of the components as one of the features; the errors of its coefficients are not known.
    pub fn original(&self, fit: &LinearFit) -> (LinearFit, Vec<f64>, Vec<String>) {
        (self.found.original(fit), vec![f64::NAN; self.features.len()], self.features.clone())
    }
}

impl Problem<'_> {
    /// The same problem with the whitened principal components of standardised features in place of the features: `keep`
    /// of them, or below 1 as many as hold that part of the variance.
    ///
    /// # Errors
    /// As [`PrincipalComponents::of`].
    pub fn whitened(mut self, keep: Option<f64>) -> Result<Self, Fault> {
        let Some(keep) = keep else { return Ok(self) };
        let kept = if keep < 1.0 { Kept::Variance(keep) } else { Kept::Count(keep as usize) };
        let found = PrincipalComponents::of(&self.merged, Scaling::Standardise, kept, true).map_err(data)?;
        let names = (1..=found.len()).map(|k| format!("component {k}")).collect();
        let components = Components { found, features: std::mem::replace(&mut self.terms, names) };
        self.merged = components.of(&self.merged)?;
        // What the unfiltered terms tell is told of the features.
        self.unfiltered = None;
        self.components = Some(components);
        Ok(self)
    }
}
