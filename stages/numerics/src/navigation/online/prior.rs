//! Prior of the coefficients of a line.

use crate::compensation::tolles_lawson::{TermFamily, TermSelection};
use crate::navigation::ins_error::ParameterError;

use super::augmented::{check_covariance, refused};

/// Normal distribution of coefficients.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CoefficientPrior {
    /// Mean.
    pub mean: Vec<f64>,
    /// Covariance, row-major.
    pub covariance: Vec<f64>,
}

impl CoefficientPrior {
    /// Prior of independent coefficients.
    pub fn independent(mean: &[f64], sigma: &[f64]) -> Self {
        let terms = mean.len();
        let mut covariance = vec![0.0; terms * terms];
        for (term, sigma) in sigma.iter().enumerate().take(terms) {
            covariance[term * (terms + 1)] = sigma * sigma;
        }
        Self { mean: mean.to_vec(), covariance }
    }

    /// Standard deviations.
    pub fn sigma(&self) -> Vec<f64> {
        let terms = self.mean.len();
        (0..terms).map(|term| self.covariance[term * (terms + 1)].sqrt()).collect()
    }
}

/// Prior from repeated calibrations with the same terms, one vector of coefficients each.
///
/// For two or more calibrations, the coefficients of the next flight are assumed to be a further draw from the same
/// distribution. The mean of the prior is the mean of the calibrations. The covariance of the prior is the scatter S of
/// the calibrations, shrunk and widened:
///
/// ```text
/// P = f (1 + 1/m) ((1 − λ) S + λ diag S)
/// ```
///
/// - λ is the shrinkage intensity of Schäfer & Strimmer 2005 (the method of Ledoit and Wolf, applied to correlations
///   with a diagonal target), at least 1/m. The matrix is therefore positive even with fewer calibrations than terms.
///   For two or three calibrations, whose correlations are due to chance, λ is 1;
/// - 1 + 1/m accounts for the error of the mean, and f = ν/(ν − 2) with ν = m − 1 for the error of the variances. The
///   next coefficient divided by its standard deviation then has a variance of 1, with Student's t distribution. For
///   two to four calibrations f = 3.
///
/// For a single calibration, the covariance is the `covariance` of the fit, (AᵀA)⁻¹ σ², row-major. The covariance
/// represents the accuracy of the calibration and excludes changes until the next flight.
///
/// # Errors
/// Fails without calibrations, for vectors of different lengths or with values that are not finite, for a single
/// calibration without a covariance, or for an invalid covariance.
pub fn prior_from_calibrations(
    calibrations: &[&[f64]],
    covariance: Option<&[f64]>,
) -> Result<CoefficientPrior, ParameterError> {
    let count = calibrations.len();
    let Some(terms) = calibrations.first().map(|first| first.len()) else {
        return Err(refused("prior", "no calibration is given"));
    };
    for (place, calibration) in calibrations.iter().enumerate() {
        if calibration.len() != terms || calibration.iter().any(|c| !c.is_finite()) {
            let what =
                format!("calibration {place} must have {terms} coefficients, like the first, and all must be finite");
            return Err(refused("prior", what));
        }
    }
    if let ([only], covariance) = (calibrations, covariance) {
        let Some(covariance) = covariance else {
            let what = "the scatter of a single calibration is unknown: give its covariance";
            return Err(refused("prior", what));
        };
        check_covariance(covariance, terms)?;
        return Ok(CoefficientPrior { mean: only.to_vec(), covariance: covariance.to_vec() });
    }
    let mean: Vec<f64> =
        (0..terms).map(|term| calibrations.iter().map(|c| c[term]).sum::<f64>() / count as f64).collect();
    let deviations: Vec<Vec<f64>> =
        calibrations.iter().map(|c| c.iter().zip(&mean).map(|(c, mean)| c - mean).collect()).collect();
    let shrunk = shrunk_covariance(&deviations, terms);
    let freedom = count as f64 - 1.0;
    let for_variances = if freedom > 3.0 { freedom / (freedom - 2.0) } else { 3.0 };
    let factor = for_variances * (1.0 + 1.0 / count as f64);
    Ok(CoefficientPrior { mean, covariance: shrunk.into_iter().map(|entry| factor * entry).collect() })
}

/// (1 − λ) S + λ diag S, with the covariance S of the deviations from the mean.
fn shrunk_covariance(deviations: &[Vec<f64>], terms: usize) -> Vec<f64> {
    let count = deviations.len() as f64;
    let scatter = |i: usize, j: usize| deviations.iter().map(|d| d[i] * d[j]).sum::<f64>() / (count - 1.0);
    let sigma: Vec<f64> = (0..terms).map(|term| scatter(term, term).sqrt()).collect();
    let (mut of_chance, mut of_all) = (0.0, 0.0);
    for i in 0..terms {
        for j in (0..i).filter(|j| sigma[i] * sigma[*j] > 0.0) {
            let product = |d: &Vec<f64>| d[i] * d[j] / (sigma[i] * sigma[j]);
            let mean = deviations.iter().map(product).sum::<f64>() / count;
            let spread: f64 = deviations.iter().map(|d| (product(d) - mean).powi(2)).sum();
            of_chance += spread * count / (count - 1.0).powi(3);
            of_all += (mean * count / (count - 1.0)).powi(2);
        }
    }
    let estimated = if of_all > 0.0 { of_chance / of_all } else { 1.0 };
    let lambda = if count < 4.0 { 1.0 } else { estimated.clamp(1.0 / count, 1.0) };
    let entry = |i: usize, j: usize| scatter(i, j) * if i == j { 1.0 } else { 1.0 - lambda };
    (0..terms * terms).map(|at| entry(at / terms, at % terms)).collect()
}

/// Random walk of the coefficients between calibrations: for each coefficient, the sum of the squared changes divided
/// by the total time, in the squared unit of the coefficient per s. The changes include the errors of the calibrations,
/// so the estimate is too large on average. `tt_s` is the time of each calibration. [Gnadt 2022, section 5.5]
///
/// # Errors
/// Fails for fewer than two calibrations, times that do not ascend, or vectors of different lengths or with values that
/// are not finite.
pub fn walk_density(calibrations: &[&[f64]], tt_s: &[f64]) -> Result<Vec<f64>, ParameterError> {
    let terms = calibrations.first().map_or(0, |first| first.len());
    let lasts = tt_s.windows(2).all(|pair| pair[1] > pair[0] && (pair[1] - pair[0]).is_finite());
    if calibrations.len() < 2 || calibrations.len() != tt_s.len() || !lasts {
        let what = format!(
            "a random walk requires at least two calibrations with ascending times, but {} calibrations and {} times \
             are given",
            calibrations.len(),
            tt_s.len()
        );
        return Err(refused("walk_density", what));
    }
    if calibrations.iter().any(|c| c.len() != terms || c.iter().any(|c| !c.is_finite())) {
        return Err(refused("walk_density", format!("every calibration must have {terms} finite coefficients")));
    }
    let all_s = tt_s[tt_s.len() - 1] - tt_s[0];
    let of = |term: usize| calibrations.windows(2).map(|pair| (pair[1][term] - pair[0][term]).powi(2)).sum::<f64>();
    Ok((0..terms).map(|term| of(term) / all_s).collect())
}

/// Prior of an aircraft without a calibration: standard deviations about zero, for a magnetometer in the cabin, where
/// the aircraft field is hundreds to thousands of nT. For a magnetometer on a boom, a tenth of these values is
/// sufficient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColdStart {
    /// Standard deviation of each permanent term, in nT.
    pub permanent_nt: f64,
    /// Standard deviation of each induced term, in nT at a field of the terms' scale (50,000 nT).
    pub induced_nt: f64,
    /// Standard deviation of each eddy term, in nT for a relative change of the field (change divided by the scale) of
    /// 1 per s. At a roll rate of 10 degrees per s the field of one term is about 0.17 times this value.
    pub eddy_nt_s: f64,
    /// Standard deviation of each derivative term, in nT for a change of 1 nT per s. At a roll rate of 10 degrees per
    /// s, the field of one term is about 8,700 times this value.
    pub derivative_s: f64,
    /// Standard deviation of the constant, in nT.
    pub bias_nt: f64,
}

impl Default for ColdStart {
    fn default() -> Self {
        Self { permanent_nt: 1000.0, induced_nt: 1000.0, eddy_nt_s: 100.0, derivative_s: 0.002, bias_nt: 500.0 }
    }
}

impl ColdStart {
    /// Prior of the coefficients of a matrix of terms, for a line sampled every `dt_s`. The terms use changes per
    /// sample, so their coefficients are proportional to the sample rate.
    ///
    /// # Errors
    /// Fails for a standard deviation below 0 or a `dt_s` that is not above 0.
    pub fn prior(&self, terms: &TermSelection, dt_s: f64) -> Result<CoefficientPrior, ParameterError> {
        if !(dt_s > 0.0 && dt_s.is_finite()) {
            return Err(refused("prior", format!("the time step must be above 0 s, but is {dt_s} s")));
        }
        let mut sigma = vec![];
        for group in terms.groups() {
            let of = match group.family {
                TermFamily::Permanent => self.permanent_nt,
                TermFamily::Induced => self.induced_nt,
                TermFamily::Eddy => self.eddy_nt_s / dt_s,
                TermFamily::Derivative => self.derivative_s / dt_s,
                TermFamily::Bias => self.bias_nt,
            };
            if !(of >= 0.0 && of.is_finite()) {
                return Err(refused(
                    "prior",
                    format!("the standard deviation of {} must not be below 0, but is {of}", group.name),
                ));
            }
            let single = TermSelection::new(&[group.name]).map_err(|fault| refused("terms", fault.to_string()))?;
            sigma.extend(std::iter::repeat_n(of, single.len()));
        }
        Ok(CoefficientPrior::independent(&vec![0.0; sigma.len()], &sigma))
    }
}
