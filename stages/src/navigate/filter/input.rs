//! Inputs of a filter: one flight line, and the flight table on which the filter is planned.

use std::sync::Arc;

use arrow_array::RecordBatch;
use numerics::{
    earth::core_field::CoreField,
    maps::{map_stack::FieldMap, map_surface::MapInterpolation},
    navigation::{
        aided::PermanentChange, ins_error::InsErrorModel, ins_series::InsSeries, line::NavigationLine,
        linearity::LinearRange, position_fixes::PositionFixes, transition::NoiseDiscretisation,
    },
    signal::gauss_markov::GaussMarkov,
};
use schemas::{Fault, TableShape};

use super::{
    super::{CalibrationPrior, aiding::GnssPositions, line_noise::LineNoiseEstimate},
    UpdateOutcome,
};

/// One flight line as input of a filter.
#[derive(Clone)]
pub struct FilterInput<'a> {
    /// INS, one value per sample. Columns that the flight lacks are derived.
    pub ins: InsSeries<'a>,
    /// Measured field in nT at each sample, minus the diurnal variation if `remove_diurnal` is set; NaN if missing. It
    /// contains the core field if and only if `core` is given. With several magnetometers, the value is their mean.
    pub measured_nt: Vec<f64>,
    /// Standard deviation of the white noise of each element of `measured_nt`, in nT.
    pub sigma_nt: Vec<f64>,
    /// Each magnetometer, for a filter that processes them separately ([`NavigationFilter::each_magnetometer`]); else
    /// empty.
    pub magnetometers: Vec<FilterMagnetometer<'a>>,
    /// The anomaly map, for a filter that requires it ([`NavigationFilter::needs_map`]).
    pub map: Option<&'a FieldMap>,
    /// The core field at the date of the line.
    pub core: Option<Arc<CoreField>>,
    /// Error sources of the INS, and the slow error of the measurement.
    pub errors: InsErrorModel,
    /// Standard deviation of the white noise of one magnetometer, per sample, in nT.
    pub measurement_sigma_nt: f64,
    /// Length in s, from the first sample, of the window whose mean of measurement minus prediction is subtracted; 0
    /// subtracts nothing.
    pub offset_window_s: f64,
    /// Columns that [`NavigationFilter::reads`] returns, and the INS columns.
    pub columns: &'a RecordBatch,
    /// The calibrations in `model`.
    pub models: &'a [CalibrationPrior],
    /// The vector magnetometer `vector`, nT along nose, right and down.
    pub field_nt: Option<[&'a [f64]; 3]>,
    /// Cosine of the angle between the axis of the scalar sensor and the field; NaN if unknown.
    pub cosines: Option<Vec<f64>>,
    /// Factor by which the attitude increases the standard deviation of each measurement; NaN makes the measurement
    /// missing.
    pub noise_factors: Option<Vec<f64>>,
    /// Standard deviation of the additional error of each measurement, in nT; NaN makes the measurement missing.
    pub sample_sigma_nt: Option<Vec<f64>>,
    /// Standard deviation of the map error at each sample, as white noise, in nT.
    pub map_sigma_nt: Option<Vec<f64>>,
    /// GNSS positions after the test, for a filter that uses them ([`NavigationFilter::aiding`]).
    pub gnss: Option<GnssPositions>,
    /// Change of the aircraft's permanent field, for a filter that estimates it
    /// ([`NavigationFilter::takes_scalar_states`]).
    pub permanent: Option<PermanentStates>,
    /// Prior standard deviation of the lag of the magnetometer, in seconds, for a filter that estimates the lag. `None`
    /// without a state for the lag.
    pub latency_sigma_s: Option<f64>,
    /// Prior standard deviation of the bias between the height of the INS and the height on the map, in metres, for a
    /// filter that estimates the bias. `None` without a state for the bias.
    pub map_height_sigma_m: Option<f64>,
    /// Whether the track has the columns of the lag, and whether it has the columns of the height bias.
    pub(in crate::navigate) has_constants: [bool; 2],
    /// Whether the curvature of the map over the position's uncertainty counts as measurement noise.
    pub second_order: bool,
    /// Uncertainty of the initial position, and the largest uncertainty over which the map is linear within the assumed
    /// noise. `None` without a map or a measured field.
    pub start_range: Option<LinearRange>,
    /// Number of magnetometers in each element of `measured_nt`.
    pub(in crate::navigate) counts: Vec<f64>,
    /// Outcome of measurements that are withheld from the filter; empty if there are none.
    pub(in crate::navigate) left_out: Vec<Option<UpdateOutcome>>,
    /// Estimated noise.
    pub(in crate::navigate) tuned: Option<LineNoiseEstimate>,
}

/// Change of the aircraft's permanent field as states of a filter.
#[derive(Clone)]
pub struct PermanentStates {
    /// Unit vector of the core field along nose, right and down at each sample.
    pub direction: Vec<[f64; 3]>,
    /// Standard deviation of each component, in nT, and time constant.
    pub process: GaussMarkov,
}

impl PermanentStates {
    /// Model of the change, as input of the filters in `numerics`.
    pub(in crate::navigate) fn model(&self) -> PermanentChange<'_> {
        PermanentChange { direction: &self.direction, process: self.process }
    }
}

/// A magnetometer of a line.
#[derive(Clone)]
pub struct FilterMagnetometer<'a> {
    /// Column name.
    pub name: &'a str,
    /// See [`FilterInput::measured_nt`].
    pub measured_nt: Vec<f64>,
}

/// The flight table that a filter is planned on.
#[derive(Clone, Copy)]
pub struct FilterFlight<'a> {
    /// Columns of the measurement.
    pub shape: &'a TableShape,
    /// The magnetometers in `mag`.
    pub mags: &'a [String],
    /// Whether a vector magnetometer gives the direction of the field ([`FilterInput::field_nt`]).
    pub has_direction: bool,
    /// Whether the measurement contains the core field.
    pub core_field: bool,
    /// Interpolation of the map.
    pub interpolation: MapInterpolation,
}

impl FilterInput<'_> {
    /// Line as input of the filters in `numerics`.
    ///
    /// # Errors
    /// Fails without a map.
    pub fn line(&self) -> Result<NavigationLine<'_>, Fault> {
        Ok(NavigationLine {
            ins: &self.ins,
            measurement_nt: &self.measured_nt,
            sigma_nt: &self.sigma_nt,
            map: self.needed_map()?,
            core: self.core.as_ref(),
            errors: self.errors,
            offset_window_s: self.offset_window_s,
            fixes: None,
            second_order: self.second_order,
        })
    }

    /// Same as [`FilterInput::line`], with a given discretisation of the process noise.
    ///
    /// # Errors
    /// Fails without a map.
    pub fn line_with(&self, noise: NoiseDiscretisation) -> Result<NavigationLine<'_>, Fault> {
        Ok(NavigationLine { errors: InsErrorModel { noise, ..self.errors }, ..self.line()? })
    }

    /// Standard deviation of the white noise of one magnetometer at each sample, in nT, for a filter that uses each of
    /// [`FilterInput::magnetometers`]. The map error is common to all magnetometers, so its variance is multiplied by
    /// the number of magnetometers.
    pub fn sigma_of_each_nt(&self) -> Vec<f64> {
        let count = self.magnetometers.len() as f64;
        (0..self.ins.len()).map(|row| self.own_sigma_nt(row).hypot(count.sqrt() * self.map_sigma_at(row))).collect()
    }

    /// Noise of the sensor.
    pub(in crate::navigate) fn own_sigma_nt(&self, row: usize) -> f64 {
        let sensor_nt = self.measurement_sigma_nt * self.noise_factors.as_ref().map_or(1.0, |factors| factors[row]);
        self.sample_sigma_nt.as_ref().map_or(sensor_nt, |sigma_nt| sensor_nt.hypot(sigma_nt[row]))
    }

    /// Noise of the map.
    pub(in crate::navigate) fn map_sigma_at(&self, row: usize) -> f64 {
        self.map_sigma_nt.as_ref().map_or(0.0, |sigma_nt| sigma_nt[row])
    }

    /// Whether the noise was estimated from the measurements of the line.
    pub fn is_tuned(&self) -> bool {
        self.tuned.as_ref().is_some_and(LineNoiseEstimate::has_noise)
    }

    /// GNSS positions that passed the test.
    pub fn fixes(&self) -> Option<&PositionFixes> {
        self.gnss.as_ref().map(|gnss| &gnss.accepted)
    }

    /// The map.
    ///
    /// # Errors
    /// Fails if the input has no map.
    pub fn needed_map(&self) -> Result<&FieldMap, Fault> {
        self.map.ok_or_else(|| Fault::bug("the filter needs a map, but its input has none"))
    }
}
