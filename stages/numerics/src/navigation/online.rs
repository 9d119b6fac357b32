//! In-flight estimation of the aircraft field: online Tolles-Lawson.
//!
//! The 18 states of the extended Kalman filter are followed by the coefficients βₘ of each magnetometer and, if
//! requested, the bias b of the vector magnetometer that supplies their terms. The scalar magnetometers are
//! uncompensated. [Gnadt 2022, section 5.5, (5.38)-(5.41); Canciani 2022]
//!
//! ```text
//! zₘ = map(INS + x) + core(INS + x) + S + Aₘ(b) βₘ + white noise
//! H  = [∂h/∂lat, ∂h/∂lon, ∂h/∂alt, 0 … 0, 1, … Aₘ …, ∂(Aₘ βₘ)/∂b]
//! β ← β,   P_cc ← P_cc + q Δt,      b ← exp(−Δt/τ) b,      P_nc ← Φ P_nc
//! ```
//!
//! Any terms are accepted: Tolles-Lawson terms, terms of an extended model, or the heading error of a scalar sensor.
//! They must be known at each sample and contain no scalar magnetometer ([`check_sources`]). The states beyond the 18
//! have a diagonal transition, so a step of 18 + 18 + 3 states takes about 6 µs.
//!
//! Differences from the source: Gnadt 2022 (5.39) replaces three states by the vector's reading, with an infinite decay
//! rate. Here, the error of the reading is the state, which may vary slowly. The derivatives are those of the complete
//! term A(b) β. MagNav.jl's derivatives omit the altitude, keep |B| constant and divide by B_x.
//!
//! # Observability
//!
//! The attitude distinguishes the aircraft field from the earth's field. On a straight line at constant attitude each
//! column is constant, and only the sum of all columns, S and the map value is measured. The covariance of the
//! coefficients given that sum then stays at its prior value, and the remaining information determines the position. A
//! constant in the terms (`bias`, and `xx` + `yy` + `zz`, whose sum is |B|/s) absorbs the constant that a map leaves
//! undetermined.
//!
//! The random walk should not exceed the expected changes. Permanent terms with a random walk of 20 nT in a second
//! absorb the whole signal of the map between the manoeuvres. With a random walk of 1 to 4 nT, a jump of 100 nT is
//! estimated within minutes.
//!
//! # Irregularities
//!
//! - a measurement or a term that is NaN or infinite, or a sigma that is not above 0: that magnetometer is skipped at
//!   the sample; the others are used;
//! - a predicted position off the map or in an unknown cell: no magnetometer is used;
//! - a zero vector: its terms are NaN;
//! - a prior whose field is 3e6 times the noise or more: rejected, because the update would have no significant digits;
//! - an INS value that is not finite, time that does not ascend, a variance that is negative or not finite: an error
//!   with the row.

pub(crate) mod augmented;
mod fluxgate;
mod prior;
mod streamed;

use crate::navigation::aids::{AidInnovations, SampleUsage};
use crate::navigation::ins_error::ParameterError;
use crate::navigation::output::{NavigationError, NavigationOutput};

use augmented::{AircraftFieldModel, AugmentedOutput, ExtraStates, MagnetometerColumns, refused};
pub use augmented::{LineModel, MagnetometerReport, MagnetometerTrack, OnlineParameters};
pub use fluxgate::Fluxgate;
use fluxgate::FluxgateTerms;
pub use prior::{CoefficientPrior, ColdStart, prior_from_calibrations, walk_density};
pub use streamed::StreamMagnetometer;
pub(crate) use streamed::StreamedOnline;

/// Scalar magnetometer with the terms of its aircraft field.
#[derive(Clone, Copy, Debug)]
pub struct OnlineMagnetometer<'a> {
    /// Uncompensated field at each sample, in nT; NaN if missing. The measurement contains the core field if, and only
    /// if, the line's `core` is given.
    pub measurement_nt: &'a [f64],
    /// Standard deviation of the white noise of each measurement, in nT, independent of the other magnetometers. A
    /// measurement whose standard deviation is not above 0 counts as missing.
    pub sigma_nt: &'a [f64],
    /// Terms, row-major, one row per sample and one column per coefficient.
    pub terms: &'a [f64],
    /// Prior of the coefficients.
    pub prior: &'a CoefficientPrior,
    /// Spectral density of each coefficient's random walk, in its unit squared per s; 0 for a constant.
    pub walk_density: &'a [f64],
}

/// Estimated aircraft field at one magnetometer.
#[derive(Clone, Debug, Default)]
pub struct AircraftEstimate {
    /// Coefficients after the last sample.
    pub coefficients: Vec<f64>,
    /// Covariance of the coefficients, row-major.
    pub covariance: Vec<f64>,
    /// Coefficients after each sample, row-major; empty unless `keep_coefficients` is set.
    pub coefficients_by_row: Vec<f64>,
    /// Standard deviations of the coefficients after each sample.
    pub sigma_by_row: Vec<f64>,
    /// Residuals, the aircraft field, and the use of the samples.
    pub track: MagnetometerTrack,
}

impl AircraftEstimate {
    /// Standard deviations of the coefficients after the last sample.
    pub fn sigma(&self) -> Vec<f64> {
        let terms = self.coefficients.len();
        (0..terms).map(|term| self.covariance[term * (terms + 1)].sqrt()).collect()
    }
}

/// Bias of the vector magnetometer after the last sample, in nT.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FluxgateEstimate {
    /// Components along nose, right and down.
    pub bias_nt: [f64; 3],
    /// Standard deviations of the components.
    pub sigma_nt: [f64; 3],
}

/// Output of the filter on a line.
#[derive(Clone, Debug, Default)]
pub struct OnlineOutput {
    /// Estimated track. `residual_nt` is the residual of the first magnetometer that is used at a sample. `nis` is the
    /// mean NIS of the magnetometers that were used or gated. The sum of these NIS is the joint squared innovation over
    /// its covariance. A sample counts as an update if any magnetometer is used; the offset is the offset of the first
    /// magnetometer.
    pub navigation: NavigationOutput,
    /// Estimates of the magnetometers, in the order of the magnetometers.
    pub magnetometers: Vec<AircraftEstimate>,
    /// Bias of the vector magnetometer, if the bias is estimated.
    pub fluxgate: Option<FluxgateEstimate>,
    /// Outcome of each sample, if there are further measurements.
    pub usage: Vec<SampleUsage>,
    /// Innovations of the further measurements.
    pub aids: AidInnovations,
    /// Horizontal slope of the predicted field at each sample, in nT/m; NaN off the map and without
    /// [`Aids::flat_over_m`](crate::navigation::aids::Aids::flat_over_m).
    pub slope_nt_per_m: Vec<f64>,
}

/// Rejects terms that contain a scalar magnetometer, because the filter would subtract its own measurement. `sources`
/// are the columns of the terms, or the names of terms.
///
/// # Errors
/// Fails for the first name that starts with `mag_`.
pub fn check_sources<S: AsRef<str>>(sources: &[S]) -> Result<(), ParameterError> {
    match sources.iter().map(AsRef::as_ref).find(|source| source.starts_with("mag_")) {
        None => Ok(()),
        Some(source) => {
            let what = format!(
                "the terms contain `{source}`, a scalar magnetometer: the filter would subtract its own measurement"
            );
            Err(refused("terms", what))
        }
    }
}

/// Filters one line.
///
/// # Errors
/// Returns the errors of [`NavigationLine::check`](crate::navigation::NavigationLine::check) for the line with each
/// magnetometer. Fails with [`NavigationError::Parameter`] for terms, priors and densities whose sizes differ or whose
/// values are out of range. Also fails for terms that differ from those of the `fluxgate`. Fails with
/// [`NavigationError::Diverged`] if a state or variance is not finite or a variance is negative.
pub fn run(
    line: &LineModel<'_>,
    magnetometers: &[OnlineMagnetometer<'_>],
    fluxgate: Option<&Fluxgate<'_>>,
    parameters: &OnlineParameters,
) -> Result<OnlineOutput, NavigationError> {
    let terms = fluxgate.map(FluxgateTerms::new).transpose()?;
    let model = TollesLawson::new(magnetometers, terms, line.ins.len())?;
    let states = extra_states(magnetometers, fluxgate)?;
    let readings: Vec<MagnetometerColumns<'_>> = magnetometers.iter().map(|m| (m.measurement_nt, m.sigma_nt)).collect();
    let output = augmented::run(line, &readings, model, &states, parameters)?;
    Ok(estimates(output, magnetometers, fluxgate.is_some()))
}

/// Joint prior of all coefficients and of the bias.
fn extra_states(
    magnetometers: &[OnlineMagnetometer<'_>],
    fluxgate: Option<&Fluxgate<'_>>,
) -> Result<ExtraStates, ParameterError> {
    let of_bias = if fluxgate.is_some() { 3 } else { 0 };
    let count = magnetometers.iter().map(|m| m.prior.mean.len()).sum::<usize>() + of_bias;
    let mut states = ExtraStates { covariance: vec![0.0; count * count], ..ExtraStates::default() };
    for (place, magnetometer) in magnetometers.iter().enumerate() {
        let (first, terms) = (states.mean.len(), magnetometer.prior.mean.len());
        let CoefficientPrior { mean, covariance } = magnetometer.prior;
        if covariance.len() != terms * terms || magnetometer.walk_density.len() != terms {
            let what = format!(
                "magnetometer {place} has {terms} coefficients, a covariance of {} entries and {} densities",
                covariance.len(),
                magnetometer.walk_density.len()
            );
            return Err(refused("prior", what));
        }
        for (row, from) in covariance.chunks_exact(terms.max(1)).enumerate() {
            states.covariance[(first + row) * count + first..][..terms].copy_from_slice(from);
        }
        states.mean.extend(mean);
        states.density.extend(magnetometer.walk_density);
    }
    states.tau_s = vec![f64::INFINITY; states.mean.len()];
    if let Some(Fluxgate { sigma_nt, tau_s, .. }) = fluxgate {
        let variance = sigma_nt * sigma_nt;
        for axis in 0..3 {
            states.covariance[(states.mean.len() + axis) * (count + 1)] = variance;
        }
        states.mean.extend([0.0; 3]);
        states.density.extend([2.0 * variance / tau_s; 3]);
        states.tau_s.extend([*tau_s; 3]);
    }
    Ok(states)
}

fn estimates(output: AugmentedOutput, magnetometers: &[OnlineMagnetometer<'_>], with_bias: bool) -> OnlineOutput {
    let AugmentedOutput { navigation, magnetometers: tracks, c, c_covariance, c_by_row, c_sigma_by_row, .. } = output;
    let (usage, aids, slope_nt_per_m) = (output.usage, output.aids, output.slope_nt_per_m);
    let count = c.len();
    let part = |rows: &[f64], first: usize, terms: usize| -> Vec<f64> {
        rows.chunks_exact(count.max(1)).flat_map(|row| row[first..first + terms].to_vec()).collect()
    };
    let (mut estimates, mut first) = (vec![], 0);
    for (magnetometer, track) in magnetometers.iter().zip(tracks) {
        let terms = magnetometer.prior.mean.len();
        let rows = &c_covariance[first * count..(first + terms) * count];
        estimates.push(AircraftEstimate {
            coefficients: c[first..first + terms].to_vec(),
            covariance: part(rows, first, terms),
            coefficients_by_row: part(&c_by_row, first, terms),
            sigma_by_row: part(&c_sigma_by_row, first, terms),
            track,
        });
        first += terms;
    }
    let fluxgate = with_bias.then(|| FluxgateEstimate {
        bias_nt: std::array::from_fn(|axis| c[first + axis]),
        sigma_nt: std::array::from_fn(|axis| c_covariance[(first + axis) * (count + 1)].sqrt()),
    });
    OnlineOutput { navigation, magnetometers: estimates, fluxgate, usage, aids, slope_nt_per_m }
}

/// Aircraft field A(b) β.
struct TollesLawson<'a> {
    magnetometers: &'a [OnlineMagnetometer<'a>],
    /// Index of the first coefficient of each magnetometer among the further states.
    first: Vec<usize>,
    fluxgate: Option<FluxgateTerms<'a>>,
    /// Index of the first state of the bias.
    bias: usize,
    own: Vec<f64>,
}

impl<'a> TollesLawson<'a> {
    fn new(
        magnetometers: &'a [OnlineMagnetometer<'a>],
        fluxgate: Option<FluxgateTerms<'a>>,
        rows: usize,
    ) -> Result<Self, ParameterError> {
        let (mut first, mut bias) = (vec![], 0);
        for (place, OnlineMagnetometer { terms, prior, .. }) in magnetometers.iter().enumerate() {
            first.push(bias);
            bias += prior.mean.len();
            if terms.len() != rows * prior.mean.len() {
                let (given, terms) = (terms.len(), prior.mean.len());
                let what = format!("magnetometer {place} has {given} values, not {terms} terms in each of {rows} rows");
                return Err(refused("terms", what));
            }
        }
        let own = vec![0.0; fluxgate.as_ref().map_or(0, FluxgateTerms::len)];
        let mut model = Self { magnetometers, first, fluxgate, bias, own };
        model.check_fluxgate(rows)?;
        Ok(model)
    }

    /// Rejects magnetometer terms that differ from those of the vector magnetometer.
    fn check_fluxgate(&mut self, rows: usize) -> Result<(), ParameterError> {
        let Some(fluxgate) = &self.fluxgate else { return Ok(()) };
        let own = &mut self.own;
        if fluxgate.rows() != rows {
            let what = format!("the vector magnetometer has {} rows, but the line has {rows}", fluxgate.rows());
            return Err(refused("terms", what));
        }
        for (place, OnlineMagnetometer { terms, prior, .. }) in self.magnetometers.iter().enumerate() {
            let width = prior.mean.len();
            if width < own.len() {
                let what =
                    format!("magnetometer {place} has {width} terms, but the vector magnetometer has {}", own.len());
                return Err(refused("terms", what));
            }
            for row in 0..rows {
                fluxgate.row(row, [0.0; 3], own);
                let given = &terms[row * width..][..own.len()];
                let same = |(one, other): (&f64, &f64)| match one.is_nan() || other.is_nan() {
                    true => one.is_nan() && other.is_nan(),
                    false => (one - other).abs() <= 1e-9 * (1.0 + other.abs()),
                };
                if !given.iter().zip(&*own).all(same) {
                    let what = format!(
                        "the terms of magnetometer {place} differ in row {row} from those of the vector magnetometer"
                    );
                    return Err(refused("terms", what));
                }
            }
        }
        Ok(())
    }

    /// Aircraft field at a magnetometer, in nT, from the states `c`. Writes the terms of the sample to `terms`.
    #[inline(always)]
    fn field(&mut self, magnetometer: usize, row: usize, c: &[f64], terms: &mut [f64]) -> f64 {
        let OnlineMagnetometer { terms: given, prior, .. } = &self.magnetometers[magnetometer];
        let (width, first) = (prior.mean.len(), self.first[magnetometer]);
        terms.copy_from_slice(&given[row * width..][..width]);
        if let Some(fluxgate) = &self.fluxgate {
            fluxgate.row(row, bias_of(c, self.bias), &mut terms[..fluxgate.len()]);
        }
        aircraft_nt(terms, &c[first..])
    }
}

/// Sum of terms times coefficients, in nT.
#[inline(always)]
fn aircraft_nt(terms: &[f64], coefficients: &[f64]) -> f64 {
    terms.iter().zip(coefficients).map(|(term, coefficient)| term * coefficient).sum()
}

#[inline(always)]
fn bias_of(c: &[f64], first: usize) -> [f64; 3] {
    std::array::from_fn(|axis| c[first + axis])
}

impl AircraftFieldModel for TollesLawson<'_> {
    #[inline(always)]
    fn linearised(&mut self, magnetometer: usize, row: usize, c: &[f64], derivatives: &mut [f64]) -> Option<f64> {
        let (first, width) = (self.first[magnetometer], self.magnetometers[magnetometer].prior.mean.len());
        let field_nt = self.field(magnetometer, row, c, &mut derivatives[first..first + width]);
        if let Some(fluxgate) = &self.fluxgate {
            let of_bias = fluxgate.derivatives(row, bias_of(c, self.bias), &c[first..first + width]);
            derivatives[self.bias..self.bias + 3].copy_from_slice(&of_bias);
        }
        field_nt.is_finite().then_some(field_nt)
    }

    #[inline(always)]
    fn value(&mut self, magnetometer: usize, row: usize, c: &[f64]) -> Option<f64> {
        let width = self.magnetometers[magnetometer].prior.mean.len();
        let mut terms = std::mem::take(&mut self.own);
        terms.resize(width, 0.0);
        let field_nt = self.field(magnetometer, row, c, &mut terms);
        self.own = terms;
        field_nt.is_finite().then_some(field_nt)
    }
}

#[cfg(test)]
pub(crate) mod tests;
