//! Principal components instead of the features of a fit.

use numerics::regression::{
    least_squares::{LinearFit, Moments, Scaling},
    principal_components::{Kept, PrincipalComponents},
};
use schemas::Fault;

use crate::columns::data;

/// Components used by a fit, and the features that they are computed from.
#[derive(Clone)]
pub struct Components {
    found: PrincipalComponents,
    features: Vec<String>,
}

impl Components {
    /// Whitened principal components of standardised features, from the moments and names of the features. `keep` is
    /// the number of components, or below 1 the fraction of the variance.
    ///
    /// # Errors
    /// The same as [`PrincipalComponents::of`].
    pub fn whitened(features: &Moments, names: Vec<String>, keep: f64) -> Result<Self, Fault> {
        let kept = if keep < 1.0 { Kept::Variance(keep) } else { Kept::Count(keep as usize) };
        let found = PrincipalComponents::of(features, Scaling::Standardise, kept, true).map_err(data)?;
        Ok(Components { found, features: names })
    }

    /// Names of the components.
    pub fn names(&self) -> Vec<String> {
        (1..=self.found.len()).map(|k| format!("component {k}")).collect()
    }

    /// Moments of the components, from those of the features.
    ///
    /// # Errors
    /// If the number of features differs from that of the components.
    pub fn of(&self, features: &Moments) -> Result<Moments, Fault> {
        let (weights, offsets) = self.found.as_sums();
        features.combined(&weights, &offsets).map_err(data)
    }

    /// Model of the features that is equivalent to a model of the components. The errors of its coefficients are
    /// unknown.
    pub fn original(&self, fit: &LinearFit) -> (LinearFit, Vec<f64>, Vec<String>) {
        (self.found.original(fit), vec![f64::NAN; self.features.len()], self.features.clone())
    }
}
