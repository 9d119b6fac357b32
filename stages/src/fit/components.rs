//! Principal components that replace the features of a fit.

use numerics::regression::{
    least_squares::{ColumnScaling, LinearFit, RegressionMoments},
    principal_components::{ComponentCount, PrincipalComponents},
};
use schemas::Fault;

use crate::columns::data;

/// Components used by a fit, and the features that they are computed from.
#[derive(Clone)]
pub struct FitComponents {
    found: PrincipalComponents,
    features: Vec<String>,
}

impl FitComponents {
    /// Whitened principal components of standardised features, from the moments and names of the features. `keep` is
    /// the number of components; a value below 1 is the fraction of the variance that they explain.
    ///
    /// # Errors
    /// Fails in the cases of [`PrincipalComponents::from_moments`].
    pub fn whitened(features: &RegressionMoments, names: Vec<String>, keep: f64) -> Result<Self, Fault> {
        let kept = if keep < 1.0 { ComponentCount::Variance(keep) } else { ComponentCount::Count(keep as usize) };
        let found =
            PrincipalComponents::from_moments(features, ColumnScaling::Standardise, kept, true).map_err(data)?;
        Ok(FitComponents { found, features: names })
    }

    /// Names of the components.
    pub fn names(&self) -> Vec<String> {
        (1..=self.found.len()).map(|k| format!("component {k}")).collect()
    }

    /// Moments of the components, computed from the moments of the features.
    ///
    /// # Errors
    /// Fails if the components were computed from a different number of features.
    pub fn component_moments(&self, features: &RegressionMoments) -> Result<RegressionMoments, Fault> {
        let (weights, offsets) = self.found.as_sums();
        features.combined(&weights, &offsets).map_err(data)
    }

    /// Model of the features that is equivalent to a model of the components. The errors of its coefficients are
    /// unknown (NaN).
    pub fn original(&self, fit: &LinearFit) -> (LinearFit, Vec<f64>, Vec<String>) {
        (self.found.original(fit), vec![f64::NAN; self.features.len()], self.features.clone())
    }
}
