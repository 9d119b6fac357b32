//! Principal components in place of the features of a fit.

use numerics::regression::{
    least_squares::{LinearFit, Moments, Scaling},
    principal_components::{Kept, PrincipalComponents},
};
use schemas::Fault;

use crate::columns::data;

/// The components that a fit is made of, and the features that they are made of.
#[derive(Clone)]
pub struct Components {
    found: PrincipalComponents,
    features: Vec<String>,
}

impl Components {
    /// The whitened principal components of standardised features, of their moments and names: `keep` of them, or below 1
    /// as many as hold that part of the variance.
    ///
    /// # Errors
    /// The same as for [`PrincipalComponents::of`].
    pub fn whitened(features: &Moments, names: Vec<String>, keep: f64) -> Result<Self, Fault> {
        let kept = if keep < 1.0 { Kept::Variance(keep) } else { Kept::Count(keep as usize) };
        let found = PrincipalComponents::of(features, Scaling::Standardise, kept, true).map_err(data)?;
        Ok(Components { found, features: names })
    }

    /// Their names.
    pub fn names(&self) -> Vec<String> {
        (1..=self.found.len()).map(|k| format!("component {k}")).collect()
    }

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
