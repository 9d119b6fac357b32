//! Measurements in addition to the scalar field, common to all filters: the difference of two magnetometers, the field
//! vector, and a height. The module also contains the map error along the track, and the test for samples where the map
//! is too flat.
//!
//! The 18 states of [`pinson`](crate::navigation::pinson) are followed by Gauss-Markov states: the slow error of each
//! further measurement. Let p = INS + x be the position, S the temporal variation, ψ the tilt, C the rotation of the
//! INS from body to north-east-down, r the baseline from the second magnetometer to the first (body frame), and û the
//! direction of the core field. The measurements are
//!
//! ```text
//! scalar       z = (map + core)(p - v τ + b_m) + S + e + ûᵀ C q + c + white noise
//! difference   d = f(p + a/2) − f(p − a/2) + |a_h| g_h + a_u g_u + b_d + white noise,   f = map + core,   a = C_true r
//! vector       m = C_trueᵀ (core vector(p) + û (map(p) + S) + a_c) + b_v + white noise,   C_trueᵀ = Cᵀ (I + [ψ×])
//! height       h = altitude of p + b_h + white noise
//! ```
//!
//! Here τ is the lag of the scalar magnetometer at the velocity v, and b_m is the bias between the height of the
//! position p and the height on the map. The map error e has a correlation length along the track. The vector q is the
//! change of the aircraft's permanent field since its calibration (body frame), c is a constant offset, and b are the
//! biases. The vector a_c is the part of the crustal field vector that a scalar map does not determine. f contains the
//! core field if the scalar measurement does.
//!
//! Rows of H, predictions and variances of a sample are computed in one place, for the state of any filter. Filters
//! differ in their linearisation points and in their use of a row.
//!
//! **The difference** is free of S and of all other common errors, so it supports navigation during a magnetic storm.
//! The difference measures the map's slope along the baseline, and its row of H is the difference of the map's slopes
//! at both ends. The map therefore requires a continuous slope
//! ([`MapInterpolation::Cubic`](crate::maps::MapInterpolation::Cubic)); the slope of a bilinear map changes only at the
//! edges of its cells. Over a short baseline r the position error for one sample is σ_d/(r |∂²f|). The tilt turns the
//! baseline: ∂d/∂ψ = g × C r with the mean g of the slopes at both ends. With a baseline of 15 m and a slope of 0.1
//! nT/m across the baseline, half a degree of yaw changes the difference by 0.013 nT. A difference therefore also
//! measures the yaw where the map is steep.
//!
//! An error of the map's slope adds the error times the baseline to the difference: the horizontal error g_h times the
//! baseline's horizontal part a_h, and the upward error g_u times its upward part a_u ([`SlopeError`]). Both are states
//! with a correlation length along the track. A level map has no vertical slope, so g_u is the whole vertical slope.
//! With 2.5 degrees of pitch, one end of a 15 m baseline is 0.65 m higher than the other. With a vertical slope of 0.1
//! nT/m, the effect exceeds the noise of such a difference.
//!
//! **The vector** measures the attitude, except for the rotation about the field, with an error of (σ_v, b_v)/|B|. An
//! error of 50 nT in a field of 50,000 nT corresponds to 0.06 degrees. The component along the field repeats the scalar
//! measurement. The scalar map does not determine the part of the crustal field across the core field, although this
//! part is as large as the anomaly. This part is the state a_c (north, east, down, with equal standard deviations and a
//! correlation length).
//!
//! **A flat map** ([`Aids::flat_over_m`]): where the standard deviation of the measurement's white noise exceeds this
//! number of metres times the horizontal slope, σ > |∇f| · `flat_over_m`, the sample does not observe the position, and
//! the map error dominates the slope. A filter then corrects only S, e and the aircraft field: the consider update
//! [Schmidt 1966], whose covariance remains correct. A smoother skips the sample, because least squares has no such
//! update.

mod rows;
mod slope;
mod states;

use std::sync::Arc;

use params::{Rule, obeys};

use crate::earth::core_field::CoreField;
use crate::navigation::ins_error::ParameterError;
use crate::navigation::ins_series::SeriesError;
use crate::navigation::output::{Innovation, NavigationError, NavigationReport};
use crate::signal::gauss_markov::GaussMarkov;

pub use rows::field_direction;
pub(crate) use rows::{Aid, AidMeasurements, JacobianBlock, LinearisedAid, SampleInnovations, rotation};
pub use slope::{MapSlope, SlopeError};
pub(crate) use states::AidStates;

/// Difference of two scalar magnetometers, first minus second.
#[derive(Clone, Copy, Debug)]
pub struct DifferenceAid<'a> {
    /// Difference at each sample, in nT; NaN if missing.
    pub difference_nt: &'a [f64],
    /// Standard deviation of the white noise of the difference, in nT.
    pub sigma_nt: f64,
    /// Vector from the second magnetometer to the first along nose, right and down, in metres. The middle of this
    /// baseline is at the INS.
    pub baseline_m: [f64; 3],
    /// Error of the map's slope.
    pub slope: SlopeError<'a>,
    /// Slow error, in nT.
    pub bias: GaussMarkov,
}

/// A vector magnetometer.
#[derive(Clone, Copy, Debug)]
pub struct VectorAid<'a> {
    /// Field along nose, right and down at each sample, in nT; NaN if missing.
    pub field_nt: [&'a [f64]; 3],
    /// Standard deviation of the white noise of each component, in nT.
    pub sigma_nt: f64,
    /// Slow error of each component, in nT.
    pub bias: GaussMarkov,
    /// Standard deviation, in nT, of each component (north, east, down) of the crustal field that a scalar map does not
    /// determine.
    pub crustal_sigma_nt: f64,
    /// Correlation length of this field along the track, in metres.
    pub crustal_length_m: f64,
    /// Core field.
    pub core: &'a Arc<CoreField>,
}

/// Independent heights, for example of a barometer that does not already aid the INS.
#[derive(Clone, Copy, Debug)]
pub struct HeightAid<'a> {
    /// Height above the ellipsoid at each sample, in metres; NaN if missing.
    pub alt_m: &'a [f64],
    /// Standard deviation of the white noise, in metres.
    pub sigma_m: f64,
    /// Slow error, in metres.
    pub bias: GaussMarkov,
}

/// Change of the aircraft's permanent field since its calibration: three states along nose, right and down. Only the
/// component of the change along the field affects the scalar measurement. A constant offset of the measurement is a
/// fourth state, so that S follows only the variation in time.
#[derive(Clone, Copy, Debug)]
pub struct PermanentChange<'a> {
    /// Unit vector of the core field along nose, right and down at each sample; see [`field_direction`].
    pub direction: &'a [[f64; 3]],
    /// Standard deviation of each component, in nT, and time constant of the change.
    pub process: GaussMarkov,
}

/// Error of the map as a Gauss-Markov process along the track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapErrorProcess {
    /// Standard deviation, in nT.
    pub sigma_nt: f64,
    /// Correlation length along the track, in metres.
    pub length_m: f64,
}

/// Measurements of a filter in addition to the scalar field.
#[derive(Clone, Copy, Debug, Default)]
pub struct Aids<'a> {
    /// Difference of two magnetometers.
    pub difference: Option<DifferenceAid<'a>>,
    /// Vector of the field.
    pub vector: Option<VectorAid<'a>>,
    /// Height.
    pub height: Option<HeightAid<'a>>,
    /// Map error as a state.
    pub map_error: Option<MapErrorProcess>,
    /// Change of the aircraft's permanent field as states.
    pub permanent: Option<PermanentChange<'a>>,
    /// Standard deviation of the lag of the scalar magnetometer before the line, in seconds. The lag is a constant
    /// state: a sample with time stamp `t` was measured at `t` minus the lag.
    pub latency_sigma_s: Option<f64>,
    /// Prior standard deviation, in metres, of the bias between the height of the aircraft and its assumed height on
    /// the map. This height bias is a constant state. It is the error of the INS's barometer, or the error of the map's
    /// height with the opposite sign. It requires a map that changes with height.
    pub map_height_sigma_m: Option<f64>,
    /// Limit, in metres, of a measurement's standard deviation divided by the map's slope. Beyond it, the map is too
    /// flat to observe the position.
    pub flat_over_m: Option<f64>,
}

/// Outcome of the field measurements of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleUsage {
    /// One or more measurements were used and observed the position.
    Used,
    /// The scalar field was used, but the map is too flat to observe the position; no other measurement was used.
    Flat,
    /// There was no measurement.
    Missing,
    /// The predicted position is off the map or in an unknown cell.
    OffMap,
    /// The innovation gate rejected all measurements.
    Gated,
}

impl NavigationReport {
    /// Counts a sample.
    pub(crate) fn count(&mut self, usage: SampleUsage) {
        *match usage {
            SampleUsage::Used | SampleUsage::Flat => &mut self.updates,
            SampleUsage::Missing => &mut self.missing_measurements,
            SampleUsage::OffMap => &mut self.off_map,
            SampleUsage::Gated => &mut self.gated,
        } += 1;
    }
}

/// Innovations of a further measurement, one value per sample; NaN if missing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Innovations {
    /// Measurement minus prediction, in the unit of the measurement; for a vector, its length.
    pub residual: Vec<f64>,
    /// NIS; for a vector, the mean over components. The expected value is 1.
    pub nis: Vec<f64>,
}

/// Innovations of all further measurements.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AidInnovations {
    /// Innovations of the difference.
    pub difference: Innovations,
    /// Innovations of the vector.
    pub vector: Innovations,
    /// Innovations of the height.
    pub height: Innovations,
}

impl Innovations {
    pub(crate) fn push(&mut self, innovation: Innovation) {
        self.residual.push(innovation.residual_nt);
        self.nis.push(innovation.nis);
    }

    fn append(&mut self, other: Self) {
        self.residual.extend(other.residual);
        self.nis.extend(other.nis);
    }
}

impl AidInnovations {
    /// Appends the innovations of later samples.
    pub(crate) fn append(&mut self, other: Self) {
        self.difference.append(other.difference);
        self.vector.append(other.vector);
        self.height.append(other.height);
    }
}

impl Aids<'_> {
    /// Whether there is any further measurement.
    pub fn is_any(&self) -> bool {
        let Self { difference, vector, height, map_error, permanent, .. } = self;
        let numbers = [self.latency_sigma_s, self.map_height_sigma_m, self.flat_over_m];
        let measured = difference.is_some() || vector.is_some() || height.is_some();
        measured || permanent.is_some() || map_error.is_some() || numbers.iter().any(Option::is_some)
    }

    /// Whether the map is too flat for a measurement of this variance and a horizontal slope in nT/m.
    pub(crate) fn is_flat(&self, variance_nt2: f64, slope_nt_per_m: f64) -> bool {
        self.flat_over_m.is_some_and(|flat_m| variance_nt2.sqrt() > slope_nt_per_m * flat_m)
    }

    /// Rejects measurements that no filter can use.
    ///
    /// # Errors
    /// Fails for standard deviations of white noise that are not above 0, standard deviations of slow errors below 0,
    /// lengths and correlation times that are not above 0, a baseline without length, or columns whose length differs
    /// from that of the line.
    pub fn check(&self, rows: usize) -> Result<(), NavigationError> {
        let require = |name: &str, value: f64, rule: Rule| obeys(&value, name, rule).map_err(ParameterError);
        let length = |column: &'static str, found: usize| match found == rows {
            true => Ok(()),
            false => Err(SeriesError::Length { column, rows: found, expected: rows }),
        };
        let lasting = |name: &str, of: GaussMarkov| -> Result<(), ParameterError> {
            require(&format!("{name}_sigma"), of.sigma, Rule::NotNegative)?;
            require(&format!("{name}_tau_s"), of.tau_s, Rule::Positive)
        };
        if let Some(DifferenceAid { difference_nt, sigma_nt, baseline_m, slope, bias }) = &self.difference {
            length("difference", difference_nt.len())?;
            slope.check(rows)?;
            require("gradient_sigma_nt", *sigma_nt, Rule::Positive)?;
            lasting("gradient_bias", *bias)?;
            for part in baseline_m {
                require("gradient_baseline_m", *part, Rule::Finite)?;
            }
            require("gradient_baseline_m", baseline_m.iter().map(|part| part * part).sum(), Rule::Positive)?;
        }
        if let Some(vector) = &self.vector {
            for field_nt in vector.field_nt {
                length("vector", field_nt.len())?;
            }
            require("vector_sigma_nt", vector.sigma_nt, Rule::Positive)?;
            lasting("vector_bias", vector.bias)?;
            require("vector_crustal_sigma_nt", vector.crustal_sigma_nt, Rule::NotNegative)?;
            require("vector_crustal_length_m", vector.crustal_length_m, Rule::Positive)?;
        }
        if let Some(HeightAid { alt_m, sigma_m, bias }) = &self.height {
            length("height", alt_m.len())?;
            require("height_sigma_m", *sigma_m, Rule::Positive)?;
            lasting("height_bias", *bias)?;
        }
        if let Some(MapErrorProcess { sigma_nt, length_m }) = &self.map_error {
            require("map_sigma_nt", *sigma_nt, Rule::NotNegative)?;
            require("map_sigma_length_m", *length_m, Rule::Positive)?;
        }
        if let Some(PermanentChange { direction, process }) = &self.permanent {
            length("direction of the field", direction.len())?;
            lasting("permanent_change", *process)?;
        }
        if let Some(sigma_s) = self.latency_sigma_s {
            require("mag_latency_sigma_s", sigma_s, Rule::Positive)?;
        }
        if let Some(sigma_m) = self.map_height_sigma_m {
            require("map_height_sigma_m", sigma_m, Rule::Positive)?;
        }
        Ok(self.flat_over_m.map_or(Ok(()), |flat_m| require("flat_over_m", flat_m, Rule::Positive))?)
    }
}
