//! Unscented Kalman filter of magnetic navigation, on the 18 states of [`ekf`](crate::navigation::ekf).
//!
//! The error dynamics are linear, so the step to the next sample is exact, x ← Φ x, P ← Φ P Φᵀ + Q. The measurement z =
//! g(y) + S + v is nonlinear in the position y = (latitude, longitude, height) alone. The unscented transform is
//! therefore applied to these n = 3 states. With the Cholesky factor L Lᵀ = P_yy and c² = α² (n + κ), the field is
//! looked up at the seven points y and y ± c L_i. The expected values of the other states, given y, are linear in y. A
//! full transform of the 18 states, with y as the first states of the Cholesky factor, moves y in the same six
//! directions only. With the same c, α and β, it therefore gives the same mean, gain and covariance. [Briers, Maskell &
//! Wright 2003; Morelande & Ristic 2006]
//!
//! With the halves of the first differences d_i = (g_i⁺ − g_i⁻)/(2c) and of the second differences e_i = (g_i⁺ +
//! g_i⁻)/2 − g₀, the weighted sums over the points [Julier & Uhlmann 2004; Wan & van der Merwe 2000] become
//!
//! ```text
//! mean       ḡ = g₀ + m,            m = Σ e_i/c²
//! slope      a = L⁻ᵀ d,             Cov(x, g) = P [a, 0 … 0]ᵀ
//! remainder  ω = Σ e_i²/c² + (β − α²) m²,      Var(g) = aᵀ P_yy a + ω
//! ```
//!
//! which is the statistical linear regression of the field over the position's own uncertainty [Lefebvre, Bruyninckx &
//! De Schutter 2002]: a measurement of H = [a, 0 … 0, 1] whose noise is σ² + ω. The correction is therefore that of the
//! EKF, in Joseph's form. The covariance stays positive for every ω ≥ 0, and ω ≥ 0 holds for β ≥ −α² κ/3. The form with
//! differences also loses no digits for a small α.
//!
//! Irregularities along the line are counted:
//!
//! - a measurement that is NaN or infinite, or whose sigma is not above 0: no update, `residual` and `nis` are NaN;
//! - an estimated position off the map or in an unknown cell: likewise no update, counted as off the map;
//! - an estimated position on the map with one or more of the six other points off the map: the map is linearised at
//!   the estimated position as in the EKF, and the nonlinear part is NaN;
//! - a position that is exactly known in some direction: no points in that direction;
//! - an INS value that is not finite, time that does not ascend, or states or a variance that are not finite: an error
//!   with the row.
//!
//! The core field is nearly linear over the points, so it is linearised at the estimated position: its curvature
//! contributes 0.001 nT at 200 m, and 0.6 nT at 5 km.

use crate::earth::core_field::LinearisedCoreField;
use crate::earth::field_value::FieldValue;
use crate::maps::map_stack::FieldMap;
use crate::navigation::gaussian::linearise::{FieldRegression, NONLINEAR, SigmaPoints};
use crate::navigation::gaussian::recursion::{self, FilterRecursion};
use crate::navigation::gaussian::{Sensitivity, StateEstimate};
use crate::navigation::ins_error::ParameterError;
use crate::navigation::line::NavigationLine;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use params::{Fault, Rule, obeys};

/// Parameters of the filter.
///
/// The defaults α = 1 and κ = 0 put the points √3 standard deviations from the estimate. The mean of the field and the
/// gain are then correct to the fourth moment of every direction. The computed variance of the field's second-order
/// part is (5 + 4 β)/8 of the true variance on average over fields whose curvature has no preferred direction. β = 3/4
/// gives the true variance. The usual β = 2 overestimates this variance. This has no effect where the map is linear,
/// and fewer filters diverge from a very uncertain start. With κ = −1 and β = 1 the variance of a quadratic field
/// without mixed second derivatives (along the directions of the points) is exact instead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UkfParameters {
    /// α of the scaled unscented transform, a factor on the distance of the points; above 0.
    pub alpha: f64,
    /// β of the scaled unscented transform: additional weight of the centre in the variance, compared with the mean; at
    /// least −α² κ/3.
    pub beta: f64,
    /// κ of the unscented transform: the points are at α √(3 + κ) standard deviations; above −3.
    pub kappa: f64,
    /// Largest NIS of a measurement; measurements with larger NIS are rejected and counted. `None` uses every
    /// measurement. 10.83 rejects one valid measurement in a thousand.
    pub gate_nis: Option<f64>,
    /// Returns the error states of every sample (144 bytes each).
    pub keep_states: bool,
    /// Returns the covariance of every sample (2.6 kB each).
    pub keep_covariance: bool,
}

impl Default for UkfParameters {
    fn default() -> Self {
        Self { alpha: 1.0, beta: 2.0, kappa: 0.0, gate_nis: None, keep_states: true, keep_covariance: false }
    }
}

impl UkfParameters {
    /// Distance and weights of the sigma points.
    pub(crate) fn sigma_points(&self) -> SigmaPoints {
        SigmaPoints::new(self.alpha, self.beta, self.kappa)
    }

    /// Rejects invalid parameters.
    ///
    /// # Errors
    /// Fails for an α or a gate that is not a finite number above 0, a κ that is not a finite number above −3, or a β
    /// below −α² κ/3.
    pub fn check(&self) -> Result<(), ParameterError> {
        obeys(&self.alpha, "alpha", Rule::Positive).map_err(ParameterError)?;
        obeys(&self.kappa, "kappa", Rule::Finite).map_err(ParameterError)?;
        obeys(&self.beta, "beta", Rule::Finite).map_err(ParameterError)?;
        if self.kappa <= -(NONLINEAR as f64) {
            return Err(refused("kappa", format!("must be above -{NONLINEAR}, not {}", self.kappa)));
        }
        let least = -self.alpha * self.alpha * self.kappa / NONLINEAR as f64;
        if self.beta < least {
            let what = format!("must be at least -alpha² kappa/{NONLINEAR} = {least}, not {}", self.beta);
            return Err(refused("beta", what));
        }
        match self.gate_nis {
            Some(gate) => obeys(&gate, "gate_nis", Rule::Positive).map_err(ParameterError),
            None => Ok(()),
        }
    }
}

fn refused(name: &str, what: String) -> ParameterError {
    ParameterError(Fault::new(format!("`{name}` {what}")).of_param(name))
}

/// Output of the filter on a line.
#[derive(Clone, Debug, Default)]
pub struct UkfOutput {
    /// Estimate.
    pub navigation: NavigationOutput,
    /// Standard deviation √ω, in nT, of the nonlinear part of the field within the uncertainty of the position, one
    /// value per sample. NaN without a prediction and where the map was linearised at the estimated position.
    pub nonlinear_sd_nt: Vec<f64>,
    /// Number of samples at which the map was linearised because an outer point was off the map.
    pub linearised: usize,
}

/// Filters one line. Uses seven look-ups of the map per sample. Costs about 4 µs per sample over a map of splines and
/// allocates little except the output.
///
/// # Errors
/// Returns the errors of [`UkfParameters::check`] and [`NavigationLine::check`]. Also fails with
/// [`NavigationError::Diverged`] if a state or variance is not finite or a variance is negative.
pub fn run(parameters: &UkfParameters, line: &NavigationLine<'_>) -> Result<UkfOutput, NavigationError> {
    parameters.check()?;
    line.check()?;
    let rows = line.ins.len();
    let mut output = UkfOutput {
        navigation: NavigationOutput::with_capacity(rows, parameters.keep_states, parameters.keep_covariance),
        nonlinear_sd_nt: Vec::with_capacity(rows),
        linearised: 0,
    };
    let (offset_nt, samples) = line.predicted().offset(line.ins, line.measurement_nt, line.offset_window_s);
    output.navigation.report.offset_nt = offset_nt;
    output.navigation.report.offset_samples = samples;
    let filter = UnscentedFilter {
        line,
        spread: parameters.sigma_points(),
        gate_nis: parameters.gate_nis,
        core: line.core.map(|core| LinearisedCoreField::new(core.clone())),
        offset_nt,
        output,
    };
    Ok(recursion::run(filter, line)?.output)
}

/// Unscented Kalman filter with its state along a line.
struct UnscentedFilter<'a> {
    line: &'a NavigationLine<'a>,
    spread: SigmaPoints,
    gate_nis: Option<f64>,
    core: Option<LinearisedCoreField>,
    offset_nt: f64,
    output: UkfOutput,
}

impl FilterRecursion for UnscentedFilter<'_> {
    fn output(&mut self) -> &mut NavigationOutput {
        &mut self.output.navigation
    }

    #[inline(always)]
    fn measure(&mut self, estimate: &mut StateEstimate, row: usize) -> Innovation {
        let report = &mut self.output.navigation.report;
        let Some((measured_nt, noise_nt2)) = self.line.measured(row, self.offset_nt) else {
            report.missing_measurements += 1;
            self.output.nonlinear_sd_nt.push(f64::NAN);
            return Innovation::NONE;
        };
        let ins = self.line.ins;
        let [lat, lon, alt, temporal_nt] = estimate.measured();
        let place = UkfPosition {
            lat_deg: ins.lat_deg[row] + lat.to_degrees(),
            lon_deg: ins.lon_deg[row] + lon.to_degrees(),
            alt_m: ins.alt_m[row] + alt,
        };
        let Some(centre) = place.field(self.line.map, [0.0; 3]) else {
            report.off_map += 1;
            self.output.nonlinear_sd_nt.push(f64::NAN);
            return Innovation::NONE;
        };
        let regression = self.spread.regression(&estimate.p, centre.value_nt, |away| {
            place.field(self.line.map, away).map(|field| field.value_nt)
        });
        self.output.linearised += usize::from(regression.is_none());
        self.output.nonlinear_sd_nt.push(regression.map_or(f64::NAN, |found| found.remainder_nt2.sqrt()));
        let FieldRegression { mean_nt, mut slope, remainder_nt2 } = regression.unwrap_or(FieldRegression::at(&centre));
        let mut expected_nt = mean_nt + temporal_nt;
        if let Some(core) = &mut self.core {
            let core = core.magnitude_and_gradient(place.lat_deg, place.lon_deg, place.alt_m);
            let [lat, lon, alt] = slope;
            slope = [lat + core.d_lat_nt_per_rad, lon + core.d_lon_nt_per_rad, alt + core.d_alt_nt_per_m];
            expected_nt += core.value_nt;
        }
        let (at, noise_nt2) = (estimate.linearised(Sensitivity::of_slope(slope)), noise_nt2 + remainder_nt2);
        let residual_nt = measured_nt - expected_nt;
        let nis = residual_nt * residual_nt / (at.variance + noise_nt2);
        if self.gate_nis.is_some_and(|gate| nis > gate) {
            report.gated += 1;
        } else {
            report.updates += 1;
            estimate.correct(&at, residual_nt, noise_nt2);
        }
        Innovation { residual_nt, nis }
    }
}

/// Geodetic position.
struct UkfPosition {
    lat_deg: f64,
    lon_deg: f64,
    alt_m: f64,
}

impl UkfPosition {
    /// Map value at an offset in rad, rad and m; `None` off the map or in an unknown cell.
    #[inline(always)]
    fn field(&self, map: &FieldMap, away: [f64; 3]) -> Option<FieldValue> {
        let (lat_deg, lon_deg) = (self.lat_deg + away[0].to_degrees(), self.lon_deg + away[1].to_degrees());
        map.at(lat_deg, lon_deg, self.alt_m + away[2])
    }
}

#[cfg(test)]
mod tests;
