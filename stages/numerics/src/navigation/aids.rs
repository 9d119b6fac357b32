//! Measurements besides the scalar field, as every filter takes them: the difference of two magnetometers, the field's
//! vector, a height; and what is known of the map, its error that lasts along the track and where it is too flat.
//!
//! The 18 states of [`pinson`](crate::navigation::pinson) are followed by Gauss-Markov ones: what lasts of each further
//! measurement's error. With the position p = INS + x, the temporal variation S, the tilt ψ, the INS' rotation C from
//! body to north-east-down, the baseline r from the second magnetometer to the first (body axes) and the core field's
//! direction û
//!
//! ```text
//! scalar       z = map(p - v τ) + core(p - v τ) + S + e + white noise
//! difference   d = f(p + a/2) − f(p − a/2) + |a_h| g_h + a_u g_u + b_d + white noise,   f = map + core,   a = C_true r
//! vector       m = C_trueᵀ (core vector(p) + û (map(p) + S) + a_c) + b_v + white noise,   C_trueᵀ = Cᵀ (I + [ψ×])
//! height       h = altitude of p + b_h + white noise
//! ```
//!
//! with the delay τ of the scalar magnetometer's time stamps at the velocity v, the map's error e that lasts for a
//! length of the track, the biases b, and the part a_c of the crustal field's vector that a scalar map does not tell. f
//! holds the core field where the scalar measurement does.
//!
//! Rows of H, predictions and variances of a sample are made in one place, for the state of any filter; filters differ
//! in where they linearise and in what they do with a row.
//!
//! **The difference** is free of S and of all that the two have in common, so that it navigates through a magnetic
//! storm. It measures the map's slope along the baseline, and its row of H is the difference of the map's slopes at
//! both ends: the map needs a continuous slope ([`Interpolation::Cubic`](crate::maps::Interpolation::Cubic)), as a
//! bilinear one bends at the edges of its cells only. Over a short baseline r the position error that one sample tells
//! is σ_d/(r |∂²f|). The tilt turns the baseline: ∂d/∂ψ = g × C r with the mean g of the slopes at both ends, half a
//! degree of heading along 15 m where the slope across is 0.1 nT/m being 0.013 nT. So a difference tells the heading
//! too, where the map is steep.
//!
//! The map's slope has errors, and the difference has them times the baseline: g_h along its horizontal part a_h, and
//! g_u along its upward part a_u ([`SlopeError`]). Both are states that last for a length of the track. A map of one
//! height has no slope upwards, so that g_u is all of it: with 2.5 degrees of pitch, 15 m of baseline have 0.65 m of
//! height, at 0.1 nT/m more than such a difference's noise.
//!
//! **The vector** tells the attitude about the field to (σ_v, b_v)/|B|: 50 nT of 50,000 are 0.06 degrees. Its other
//! part is the scalar field once more. The scalar map does not tell the crustal field across the core field, which is
//! as large as the anomaly and is the state a_c (north, east, down, each of one standard deviation, lasting for a
//! length).
//!
//! **A flat map** ([`Aids::flat_over_m`]): where standard deviation of the measurement's white noise is more than that
//! many metres of the horizontal slope, σ > |∇f| · `flat_over_m`, the sample carries no position, and its slope is
//! rather the map's error than the map. A filter then corrects S, e and the aircraft's field alone: the consider update
//! [Schmidt 1966], whose covariance stays right. A smoother leaves the sample out, as there is no such update among its
//! least squares.

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

pub(crate) use rows::{Aid, Linear, Rows, SampleInnovations, rotation};
pub use slope::{MapSlope, SlopeError};
pub(crate) use states::AidStates;

/// The difference of two scalar magnetometers, first minus second.
#[derive(Clone, Copy, Debug)]
pub struct Difference<'a> {
    /// It at each sample, in nT; NaN where there is none.
    pub difference_nt: &'a [f64],
    /// The standard deviation of its white noise, in nT.
    pub sigma_nt: f64,
    /// From the second magnetometer to the first along nose, right and down, in m. Their middle is where the INS is.
    pub baseline_m: [f64; 3],
    /// The error of the map's slope.
    pub slope: SlopeError<'a>,
    /// Slow error, in nT.
    pub bias: GaussMarkov,
}

/// A vector magnetometer.
#[derive(Clone, Copy, Debug)]
pub struct Vector<'a> {
    /// The field along nose, right and down at each sample, in nT; NaN where there is none.
    pub field_nt: [&'a [f64]; 3],
    /// The standard deviation of the white noise of each component, in nT.
    pub sigma_nt: f64,
    /// Slow error of each component, in nT.
    pub bias: GaussMarkov,
    /// Standard deviation, in nT, of each component (north, east, down) of the crustal field that a scalar map does not
    /// determine.
    pub crustal_sigma_nt: f64,
    /// The distance over which that lasts, in m.
    pub crustal_length_m: f64,
    /// The core field.
    pub core: &'a Arc<CoreField>,
}

/// Heights from elsewhere, such as a barometer's that does not aid the INS already.
#[derive(Clone, Copy, Debug)]
pub struct Height<'a> {
    /// Above the ellipsoid at each sample, in m; NaN where there is none.
    pub alt_m: &'a [f64],
    /// The standard deviation of the white noise, in m.
    pub sigma_m: f64,
    /// Slow error, in m.
    pub bias: GaussMarkov,
}

/// Error of the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapError {
    /// Its standard deviation, in nT.
    pub sigma_nt: f64,
    /// The distance along the track over which its correlation falls to 1/e, in m.
    pub length_m: f64,
}

/// Measurements of a filter besides the scalar field.
#[derive(Clone, Copy, Debug, Default)]
pub struct Aids<'a> {
    /// The difference of two magnetometers.
    pub difference: Option<Difference<'a>>,
    /// The field's vector.
    pub vector: Option<Vector<'a>>,
    /// A height.
    pub height: Option<Height<'a>>,
    /// The map's error as a state.
    pub map_error: Option<MapError>,
    /// The standard deviation of the delay of the scalar magnetometer before the line, in s, as a constant state: a
    /// sample that is stamped `t` was measured at `t` less the delay.
    pub latency_sigma_s: Option<f64>,
    /// Largest standard deviation of a measurement, divided by the map's slope, in m, for which the map observes the
    /// position.
    pub flat_over_m: Option<f64>,
}

/// Outcome of the field measurements of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Usage {
    /// One or more was used, and carried a position.
    Used,
    /// The scalar field was used, but the map is too flat to observe the position; no other measurement was used.
    Flat,
    /// There was none.
    Missing,
    /// The predicted position is off the map or in an unknown cell.
    OffMap,
    /// The innovation gate rejected all measurements.
    Gated,
}

impl NavigationReport {
    /// Counts a sample.
    pub(crate) fn count(&mut self, usage: Usage) {
        *match usage {
            Usage::Used | Usage::Flat => &mut self.updates,
            Usage::Missing => &mut self.missing_measurements,
            Usage::OffMap => &mut self.off_map,
            Usage::Gated => &mut self.gated,
        } += 1;
    }
}

/// Innovations of a further measurement, a value a sample; NaN where there was none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Innovations {
    /// Measurement minus prediction, in the unit of the measurement; of a vector its length.
    pub residual: Vec<f64>,
    /// The squared innovation over its variance; of a vector the mean over components, of expectation 1.
    pub nis: Vec<f64>,
}

/// The innovations of all further measurements.
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
}

impl Aids<'_> {
    /// Whether there is any.
    pub fn is_any(&self) -> bool {
        let Self { difference, vector, height, map_error, latency_sigma_s, flat_over_m } = self;
        let measured = difference.is_some() || vector.is_some() || height.is_some();
        measured || map_error.is_some() || latency_sigma_s.is_some() || flat_over_m.is_some()
    }

    /// Whether the map is too flat for a measurement of this variance: its horizontal slope, in nT/m.
    pub(crate) fn is_flat(&self, variance_nt2: f64, slope_nt_per_m: f64) -> bool {
        self.flat_over_m.is_some_and(|flat_m| variance_nt2.sqrt() > slope_nt_per_m * flat_m)
    }

    /// Refuses measurements that no filter can use.
    ///
    /// # Errors
    /// Fails for standard deviations of white noise that are not above 0, lasting ones below 0, lengths and correlation
    /// times that are not above 0, a baseline without length, and columns of another length than the line.
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
        if let Some(Difference { difference_nt, sigma_nt, baseline_m, slope, bias }) = &self.difference {
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
        if let Some(Height { alt_m, sigma_m, bias }) = &self.height {
            length("height", alt_m.len())?;
            require("height_sigma_m", *sigma_m, Rule::Positive)?;
            lasting("height_bias", *bias)?;
        }
        if let Some(MapError { sigma_nt, length_m }) = &self.map_error {
            require("map_sigma_nt", *sigma_nt, Rule::NotNegative)?;
            require("map_sigma_length_m", *length_m, Rule::Positive)?;
        }
        if let Some(sigma_s) = self.latency_sigma_s {
            require("mag_latency_sigma_s", sigma_s, Rule::Positive)?;
        }
        Ok(self.flat_over_m.map_or(Ok(()), |flat_m| require("flat_over_m", flat_m, Rule::Positive))?)
    }
}
