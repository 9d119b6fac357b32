//! Noise of an uncompensated magnetometer: the coefficients of the aircraft field are states of the filter.

use crate::navigation::line::NavigationLine;
use crate::navigation::online::{CoefficientPrior, LineModel, OnlineMagnetometer, OnlineParameters, run};
use crate::navigation::output::{NavigationError, NavigationOutput};

use super::{GATE_NIS, NoiseLikelihood, NoisePoint, outliers::RECOVERED_AFTER};

/// Linear model of the aircraft field along a line, with the prior of its coefficients.
#[derive(Clone, Copy, Debug)]
pub struct AircraftStates<'a> {
    /// Terms, row-major, one row per sample of the line and one column per coefficient.
    pub terms: &'a [f64],
    /// Prior of the coefficients.
    pub prior: &'a CoefficientPrior,
    /// Spectral density of each coefficient's random walk, in its unit squared per s; 0 for a constant.
    pub walk_density: &'a [f64],
}

/// Aircraft field along a line, and the rejected measurements.
#[derive(Clone, Debug, PartialEq)]
pub struct AircraftFieldAlong {
    /// Aircraft field, computed with the coefficients estimated at each sample, in nT; NaN where a term is not finite.
    pub aircraft_nt: Vec<f64>,
    /// Whether each measurement is an outlier.
    pub rejected: Vec<bool>,
}

impl AircraftStates<'_> {
    /// Terms at some rows.
    pub(super) fn at(&self, rows: &[usize]) -> Vec<f64> {
        let count = self.prior.mean.len();
        rows.iter().filter_map(|row| self.terms.get(row * count..(row + 1) * count)).flatten().copied().collect()
    }

    fn magnetometer<'b>(&'b self, line: &NavigationLine<'b>, terms: &'b [f64]) -> OnlineMagnetometer<'b> {
        let Self { prior, walk_density, .. } = *self;
        let NavigationLine { measurement_nt, sigma_nt, .. } = *line;
        OnlineMagnetometer { measurement_nt, sigma_nt, terms, prior, walk_density }
    }

    /// Filters a line with the aircraft field as states. A measurement whose NIS exceeds [`GATE_NIS`] is an outlier.
    /// After 20 rejections in a row the next measurement is used, regardless of its innovation.
    ///
    /// # Errors
    /// Returns the errors of [`run`].
    pub fn along(&self, line: &NavigationLine<'_>) -> Result<AircraftFieldAlong, NavigationError> {
        let parameters = OnlineParameters {
            gate_nis: Some(GATE_NIS),
            recover_after: Some(RECOVERED_AFTER),
            ..OnlineParameters::default()
        };
        let magnetometer = self.magnetometer(line, self.terms);
        let mut output = run(&LineModel::from_line(line), &[magnetometer], None, &parameters)?;
        let track = output.magnetometers.pop().map(|magnetometer| magnetometer.track).unwrap_or_default();
        Ok(AircraftFieldAlong { aircraft_nt: track.aircraft_nt, rejected: track.gated })
    }
}

impl NoiseLikelihood<'_> {
    /// Output of the filter at a point with the aircraft field as states.
    pub(super) fn output_with_aircraft(
        &self,
        aircraft: &AircraftStates<'_>,
        point: &NoisePoint,
    ) -> Result<NavigationOutput, NavigationError> {
        let (ins, sigma_nt) = (self.thinned.ins(), self.sigma_nt(point));
        let line = self.line_at(point, &ins, &sigma_nt);
        let magnetometer = aircraft.magnetometer(&line, self.terms);
        let parameters = OnlineParameters { gate_nis: Some(GATE_NIS), ..OnlineParameters::default() };
        run(&LineModel::from_line(&line), &[magnetometer], None, &parameters).map(|output| output.navigation)
    }
}
