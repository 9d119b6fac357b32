//! Neural covariance: an extended Kalman filter in which a recurrent network sets the noise at each sample.
//!
//! The filter is [`ekf`](crate::navigation::ekf). A long short-term memory layer sets a factor r on the assumed
//! measurement variance σ², and optionally a factor q on the noise that drives the temporal variation [Gnadt 2022,
//! section 5.9.3; MagNav.jl 1.3.3, `nekf`]:
//!
//! ```text
//! s = H P Hᵀ + r σ²,      P ← Φ P Φᵀ + Q with q Q_SS,      ln r, ln q = network(inputs up to this sample)
//! ```
//!
//! MagNav.jl scales R by 1 + m, with a swish output that may make R negative; here the output is the logarithm of the
//! factor, within ±2 ln `limit`. The inputs ([`FILTER_INPUTS`]) include the innovation of the sample before, never that
//! of the sample itself. s is then known before the measurement, so the product of the densities N(v; 0, s) is the
//! likelihood of the line. A network that uses the present innovation could increase this product without bound. If the
//! output is 0, the filter is bit-identical to `ekf`.
//!
//! # Training
//!
//! [`train`] minimises a negative log-likelihood ([`NoiseLoss`]): either that of the innovations, which requires no
//! truth, or that of the true position. Derivatives are propagated back through the layer and through the filter, by
//! the adjoint of its recursion. Let x̄ and P̄ be the derivatives with respect to state and covariance after an update,
//! b = P Hᵀ, and L the loss of the sample. The recursion is
//!
//! ```text
//! s̄ = (bᵀ P̄ b − v bᵀ x̄)/s² + ∂L/∂s       v̄ = bᵀ x̄/s + ∂L/∂v       b̄ = −2 P̄ b/s + x̄ v/s + Hᵀ s̄
//! P̄ ← P̄ + ½ (b̄ H + Hᵀ b̄ᵀ)               x̄ ← x̄ − Hᵀ v̄            ∂/∂ln r = r σ² s̄
//! step: ∂/∂ln q = q Q_SS P̄_SS,            x̄ ← Φᵀ x̄                P̄ ← Φᵀ P̄ Φ
//! ```
//!
//! Four dependencies are neglected: the dependence of the network's inputs, of H and of the map's curvature on the
//! estimate, and all dependence on samples before the window. On a map of constant slope and with fixed inputs the
//! derivatives are exact.
//!
//! # Irregularities
//!
//! Irregularities are treated as in [`ekf`](crate::navigation::ekf). A further input that is not finite causes an error
//! that names the row. The map slope in an unknown cell is replaced by the mean slope.

mod course;
mod inputs;
mod network;
mod training;

pub use inputs::FILTER_INPUTS;
pub use network::{NetworkNoise, NoiseNetwork};
pub use training::{NoiseLoss, NoiseTraining, TrainedNoise, TrainingLine, train};

use crate::navigation::ekf::{EkfInput, EkfParameters, NoiseFactors, NoiseSource, run_stepped};
use crate::navigation::ins_error::ParameterError;
use crate::navigation::ins_series::InsSeries;
use crate::navigation::line::NavigationLine;
use crate::navigation::online::augmented::refused;
use crate::navigation::output::{Innovation, NavigationError, NavigationOutput};
use inputs::{InputSource, SampleBefore};
use network::CellState;

/// Parameters of the filter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NekfParameters {
    /// Largest NIS of a measurement that is used; `None` uses every measurement.
    pub gate_nis: Option<f64>,
    /// Returns the error states of every sample.
    pub keep_states: bool,
    /// Returns the covariance of every sample.
    pub keep_covariance: bool,
}

/// Output of the filter on a line.
#[derive(Clone, Debug, Default)]
pub struct NekfOutput {
    /// Estimated track.
    pub navigation: NavigationOutput,
    /// Factor on the assumed standard deviation of the measurement at each sample.
    pub measurement_factor: Vec<f64>,
    /// Factor on the standard deviation of the noise that drives the temporal variation, for the step to each sample.
    pub fogm_factor: Vec<f64>,
    /// Inputs of the network before standardisation, row-major.
    pub inputs: Vec<f64>,
}

/// Filters one line. `further` are further inputs of the network, row-major, one row per sample.
///
/// # Errors
/// Returns the errors of [`NavigationLine::check`], [`NoiseNetwork::check`] and
/// [`ekf::run`](crate::navigation::ekf::run). Also fails with [`NavigationError::Parameter`] for further inputs whose
/// number differs from the network's or that are not finite.
pub fn run(
    line: &NavigationLine<'_>,
    network: &NoiseNetwork,
    further: &[f64],
    parameters: &NekfParameters,
) -> Result<NekfOutput, NavigationError> {
    line.check()?;
    network.check()?;
    let Some(width) = network.inputs().checked_sub(FILTER_INPUTS.len()) else {
        return Err(refused("model", format!("the network has {} inputs", network.inputs())).into());
    };
    check_further(further, width, line.ins)?;
    let mut source = NetworkSource {
        line,
        network,
        inputs: InputSource::new(line, further),
        cell: network.start(),
        used_nt2: f64::NAN,
        output: NekfOutput::default(),
    };
    let ekf = EkfParameters {
        errors: line.errors,
        offset_window_s: line.offset_window_s,
        gate_nis: parameters.gate_nis,
        second_order: line.second_order,
        keep_states: parameters.keep_states,
        keep_covariance: parameters.keep_covariance,
        ..EkfParameters::default()
    };
    let point = EkfInput {
        parameters: &ekf,
        measurement_nt: line.measurement_nt,
        sigma_nt: Some(line.sigma_nt),
        fixes: line.fixes,
        map: line.map,
        core: line.core,
    };
    let navigation = run_stepped(line.ins, point, &mut source)?;
    Ok(NekfOutput { navigation, ..source.output })
}

/// Rejects further inputs that are not `width` finite values per sample.
fn check_further(further: &[f64], width: usize, ins: &InsSeries<'_>) -> Result<(), ParameterError> {
    let rows = ins.len();
    if further.len() != rows * width {
        let what = format!("{} further inputs are given, not {rows} rows of {width}", further.len());
        return Err(refused("features", what));
    }
    match further.iter().position(|x| !x.is_finite()) {
        Some(at) => {
            let row = at / width;
            let what =
                format!("further input {} is {} at row {row} (tt = {} s)", at % width, further[at], ins.tt_s[row]);
            Err(refused("features", what))
        }
        None => Ok(()),
    }
}

/// Network along a line.
struct NetworkSource<'a> {
    line: &'a NavigationLine<'a>,
    network: &'a NoiseNetwork,
    inputs: InputSource<'a>,
    cell: CellState,
    /// Variance that the filter used for the measurement of the previous sample, in nT².
    used_nt2: f64,
    output: NekfOutput,
}

impl NetworkSource<'_> {
    /// Quantities of the sample before `row`.
    fn before(&self, row: usize, output: &NavigationOutput) -> SampleBefore {
        let Some(last) = row.checked_sub(1) else { return SampleBefore::NONE };
        let ins = self.line.ins;
        SampleBefore {
            error: [
                (output.lat_deg[last] - ins.lat_deg[last]).to_radians(),
                (output.lon_deg[last] - ins.lon_deg[last]).to_radians(),
                output.alt_m[last] - ins.alt_m[last],
            ],
            innovation: Innovation { residual_nt: output.residual_nt[last], nis: output.nis[last] },
            assumed_nt2: self.line.sigma_nt[last].powi(2),
            used_nt2: self.used_nt2,
        }
    }
}

impl NoiseSource for NetworkSource<'_> {
    fn factors(&mut self, row: usize, output: &NavigationOutput) -> NoiseFactors {
        let before = self.before(row, output);
        let inputs = self.inputs.at(row, &before);
        let tape = self.network.advance(&mut self.cell, &inputs);
        let [measurement, fogm] = self.network.log_scales(&tape).map(|log| (0.5 * log).exp());
        self.used_nt2 = (self.line.sigma_nt[row] * measurement).powi(2);
        self.output.measurement_factor.push(measurement);
        self.output.fogm_factor.push(fogm);
        self.output.inputs.extend(inputs);
        NoiseFactors { measurement, fogm }
    }
}

#[cfg(test)]
mod tests;
