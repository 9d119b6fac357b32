//! The 18-state extended Kalman filter of magnetic navigation.
//!
//! The states are errors of the INS (truth - INS; see `pinson`) and the temporal variation S; the
//! measurement is the compensated scalar field, h(x) = map(position) + core(position) + S at the
//! position INS + x. At each sample the filter updates, hands out the state, and then propagates to
//! the next with the INS of this one. [thesis 000, section 5.3, with the corrections of H and Q]
//!
//! What is not as it should be along the line is documented and counted, never hidden:
//!
//! - a measurement that is NaN or infinite: no update, `residual` and `nis` are NaN;
//! - a predicted position off the map or in an unknown cell: the same;
//! - a flat map: without a core field the update only moves S, with one its slope corrects the position too;
//! - an INS value that is not finite, time that does not ascend, a covariance that is no longer
//!   finite and non-negative: an error that names the row.

mod measurement;
mod output;
mod parameters;

use super::core_field::{CoreField, LinearisedCoreField};
use super::field_value::FieldValue;
use super::ins_series::{InsSeries, SeriesError};
use super::map_stack::FieldMap;
use super::pinson::{ALT, LAT, LON, S, STATES, StateMatrix, StateVector, pinson_matrix};
use super::transition::{propagate_state, step_covariance, transition_matrix};
use measurement::Sensitivity;
pub use output::{EkfOutput, EkfReport};
pub use parameters::{EkfError, EkfParameters};

/// Filters one line.
///
/// `measurement_nt` is the compensated field at each sample of `ins`; it holds the core field if,
/// and only if, `core` is given. Costs about 3 microseconds a sample and allocates the output only.
pub fn run(
    parameters: &EkfParameters,
    ins: &InsSeries<'_>,
    measurement_nt: &[f64],
    map: &FieldMap,
    core: Option<&CoreField>,
) -> Result<EkfOutput, EkfError> {
    parameters.check()?;
    ins.check()?;
    if measurement_nt.len() != ins.len() {
        let (column, rows, expected) = ("measurement", measurement_nt.len(), ins.len());
        return Err(SeriesError::Length { column, rows, expected }.into());
    }
    let mut filter = Filter::new(parameters, ins, map, core);
    let (offset_nt, offset_samples) = filter.offset(measurement_nt);
    let mut output = EkfOutput::with_capacity(ins.len(), parameters.keep_covariance);
    output.report.offset_nt = offset_nt;
    output.report.offset_samples = offset_samples;
    let line = Line { filter, measurement_nt, offset_nt, output };
    pulp::Arch::new().dispatch(line)
}

/// A line to be filtered, as the work that is dispatched to the machine's vector unit.
struct Line<'a> {
    filter: Filter<'a>,
    measurement_nt: &'a [f64],
    offset_nt: f64,
    output: EkfOutput,
}

impl pulp::NullaryFnOnce for Line<'_> {
    type Output = Result<EkfOutput, EkfError>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        let Self { mut filter, measurement_nt, offset_nt, mut output } = self;
        let (ins, earth) = (filter.ins, filter.parameters.errors.earth);
        for (row, measured_nt) in measurement_nt.iter().enumerate() {
            if row > 0 {
                filter.propagate(row);
            }
            let innovation = filter.update(row, measured_nt - offset_nt, &mut output.report);
            filter.check(row)?;
            output.push(ins, row, &filter.x, &filter.p, innovation, earth);
        }
        Ok(output)
    }
}

/// The residual and its squared size over its variance; NaN where there was no update.
#[derive(Clone, Copy, Debug)]
struct Innovation {
    residual_nt: f64,
    nis: f64,
}

impl Innovation {
    const NONE: Self = Self { residual_nt: f64::NAN, nis: f64::NAN };
}

struct Filter<'a> {
    parameters: &'a EkfParameters,
    ins: &'a InsSeries<'a>,
    map: &'a FieldMap,
    core: Option<LinearisedCoreField>,
    noise_density: StateVector,
    x: StateVector,
    p: StateMatrix,
}

impl<'a> Filter<'a> {
    /// No error, and the initial covariance at the first sample.
    fn new(parameters: &'a EkfParameters, ins: &'a InsSeries<'a>, map: &'a FieldMap, core: Option<&CoreField>) -> Self {
        let (lat_rad, alt_m) = (ins.lat_deg[0].to_radians(), ins.alt_m[0]);
        Self {
            parameters,
            ins,
            map,
            core: core.map(|core| LinearisedCoreField::new(core.clone())),
            noise_density: parameters.errors.noise_density(),
            x: [0.0; STATES],
            p: parameters.errors.initial_covariance(lat_rad, alt_m),
        }
    }

    /// The field and its gradient at an error `x` from the INS; `None` where the map has none.
    fn field(&mut self, row: usize, x: &StateVector) -> Option<FieldValue> {
        let lat_deg = self.ins.lat_deg[row] + x[LAT].to_degrees();
        let lon_deg = self.ins.lon_deg[row] + x[LON].to_degrees();
        let alt_m = self.ins.alt_m[row] + x[ALT];
        let anomaly = self.map.at(lat_deg, lon_deg, alt_m)?;
        Some(match &mut self.core {
            Some(core) => anomaly + core.magnitude_and_gradient(lat_deg, lon_deg, alt_m),
            None => anomaly,
        })
    }

    /// The mean of measurement minus prediction at the INS position over the first seconds, and
    /// from how many samples; nothing for a window of zero.
    fn offset(&mut self, measurement_nt: &[f64]) -> (f64, usize) {
        let window_s = self.parameters.offset_window_s;
        if window_s <= 0.0 {
            return (0.0, 0);
        }
        let (mut sum_nt, mut samples) = (0.0, 0_usize);
        for (row, measured_nt) in measurement_nt.iter().enumerate() {
            if self.ins.tt_s[row] - self.ins.tt_s[0] > window_s {
                break;
            }
            if let Some(field) = self.field(row, &[0.0; STATES])
                && measured_nt.is_finite()
            {
                sum_nt += measured_nt - field.value_nt;
                samples += 1;
            }
        }
        if samples == 0 { (0.0, 0) } else { (sum_nt / samples as f64, samples) }
    }

    /// Brings state and covariance from the sample before `row` to `row`.
    #[inline(always)]
    fn propagate(&mut self, row: usize) {
        let errors = &self.parameters.errors;
        let dt_s = self.ins.tt_s[row] - self.ins.tt_s[row - 1];
        let ins = self.ins.point(row - 1);
        let f = pinson_matrix(&ins, &errors.time_constants(), errors.pinson);
        let phi = transition_matrix(&f, dt_s);
        self.x = propagate_state(&phi, &self.x);
        self.p = step_covariance(&self.p, &f, &phi, &self.noise_density, dt_s, errors.noise);
    }

    /// Corrects state and covariance by the measurement of `row`, if there is one to use.
    #[inline(always)]
    fn update(&mut self, row: usize, measured_nt: f64, report: &mut EkfReport) -> Innovation {
        if !measured_nt.is_finite() {
            report.missing_measurements += 1;
            return Innovation::NONE;
        }
        let x = self.x;
        let Some(field) = self.field(row, &x) else {
            report.off_map += 1;
            return Innovation::NONE;
        };
        let sensitivity = Sensitivity::of(&field);
        let variance = self.parameters.measurement_sigma_nt.powi(2);
        let gain = sensitivity.gain(&self.p, variance);
        let residual_nt = measured_nt - (field.value_nt + x[S]);
        let nis = residual_nt * residual_nt / gain.innovation_variance;
        if self.parameters.gate_nis.is_some_and(|gate| nis > gate) {
            report.gated += 1;
            return Innovation { residual_nt, nis };
        }
        report.updates += 1;
        for (x, gain) in self.x.iter_mut().zip(&gain.gain) {
            *x += gain * residual_nt;
        }
        sensitivity.update_covariance(&mut self.p, &gain, variance);
        Innovation { residual_nt, nis }
    }

    /// Refuses to go on with a state or covariance that means nothing.
    fn check(&self, row: usize) -> Result<(), EkfError> {
        let variances = self.p.iter().enumerate().map(|(state, p)| p[state]);
        let sound =
            self.x.iter().zip(variances).all(|(x, variance)| x.is_finite() && variance.is_finite() && variance >= 0.0);
        if sound { Ok(()) } else { Err(EkfError::Diverged { row, tt_s: self.ins.tt_s[row] }) }
    }
}

#[cfg(test)]
mod tests;
