//! Start of a line whose initial position error may exceed the distance over which the map is linear.

use arrow_array::ArrayRef;
use numerics::navigation::{
    ins_error::{InsErrorModel, StartFix, StartFixSigmas},
    likelihood::rows_at,
    line::NavigationLine,
    linearity::{self, LinearRange},
    mpf::{HandOver, MpfParameters, locate},
};
use schemas::{Column, Fault, NumberOrAuto};

use super::{
    Navigate,
    filter::FilterInput,
    flown::NoiseSources,
    ins::InsColumns,
    line_noise::{INTERVAL_S, LineNoiseEstimate, LineNoiseInputs},
};
use crate::columns::{array, data};

/// Columns of a filter that linearises the map from the first sample on, in metres: the initial standard deviation of
/// the position (longer axis), and the largest standard deviation for which the map is linear within the noise.
pub const START_COLUMNS: [&str; 2] = ["start_sigma", "start_sigma_limit"];

/// Standard deviation (nT) and time constant (s) of the slow error that is assumed while particles locate the aircraft,
/// if the keys are unset. A calibration may leave a constant of this size.
const SLOW_ERROR: (f64, f64) = (30.0, 3000.0);

impl Navigate {
    /// Whether the uncertainty of the initial position is compared with the range over which the map is linear.
    fn tests_start(&self) -> bool {
        let filter = &self.filter.keys;
        filter.needs_map() && filter.takes_field() && !filter.takes_wide_start()
    }

    /// The columns [`START_COLUMNS`], if the start is tested.
    pub(super) fn start_columns(&self) -> Vec<Column> {
        let what = [
            "standard deviation of the initial position, along the longer axis of its error ellipse",
            "largest `start_sigma` at which the map is approximately linear: the linearisation error is below the \
             assumed noise, or below a third of the linear change; NaN off the map",
        ];
        let columns = START_COLUMNS.into_iter().zip(what).map(|(name, what)| Column::float(name, "m", what));
        columns.filter(|_| self.tests_start()).collect()
    }

    /// Arrays of the columns [`START_COLUMNS`].
    pub(super) fn start_arrays(&self, flown: &FilterInput) -> Vec<ArrayRef> {
        if !self.tests_start() {
            return vec![];
        }
        let range = flown.start_range.unwrap_or(LinearRange { sigma_m: f64::NAN, limit_m: f64::NAN });
        [range.sigma_m, range.limit_m].map(|m| array(vec![m; flown.ins.len()])).to_vec()
    }

    /// Range over which the map is linear at the start of a line, computed with the noise that is assumed before the
    /// noise is estimated.
    pub(super) fn start_range(&self, flown: &FilterInput) -> Result<Option<LinearRange>, Fault> {
        if flown.map.is_none() || !self.filter.keys.takes_field() {
            return Ok(None);
        }
        Ok(Some(linearity::at_start(&NavigationLine { fixes: flown.fixes(), ..flown.line()? })))
    }
}

impl NoiseSources<'_> {
    /// Same as [`NoiseSources::find`], for a start over which the map is not linear. Particles locate the aircraft. The
    /// INS is corrected with the position and velocity from the particles, and noise and outliers are estimated along
    /// the corrected INS. The assumed noise is kept if the particles do not find a single position.
    pub(super) fn find_from_wide_start(
        &self,
        flown: &mut FilterInput,
        found: &mut Vec<(LineNoiseInputs, LineNoiseEstimate)>,
    ) -> Result<(), Fault> {
        if !self.stage.finds_noise(self.map.is_some()) && self.stage.field.map_error_length_m.is_none() {
            return Ok(());
        }
        let Some((ins, errors)) = self.located(flown)? else { return Ok(()) };
        let mut known = FilterInput { ins: ins.series(), errors, ..flown.clone() };
        self.find(&mut known, None, &[], found)?;
        flown.measured_nt = known.measured_nt;
        flown.sigma_nt = known.sigma_nt;
        flown.measurement_sigma_nt = known.measurement_sigma_nt;
        (flown.errors.fogm_sigma_nt, flown.errors.fogm_tau_s) = (known.errors.fogm_sigma_nt, known.errors.fogm_tau_s);
        flown.map_sigma_nt = known.map_sigma_nt;
        flown.left_out = known.left_out;
        flown.tuned = known.tuned;
        Ok(())
    }

    /// INS corrected by the position and velocity that particles find, and its error model at the first sample.
    fn located(&self, flown: &FilterInput) -> Result<Option<(InsColumns<'_>, InsErrorModel)>, Fault> {
        let noise = &self.stage.noise;
        let mut errors = flown.errors;
        let unset = |value: Option<NumberOrAuto>| value.is_none();
        if unset(noise.fogm_sigma_nt) && unset(noise.fogm_tau_s) {
            (errors.fogm_sigma_nt, errors.fogm_tau_s) = SLOW_ERROR;
        }
        let mut measured_nt = flown.measured_nt.clone();
        if unset(noise.measurement_sigma_nt) {
            // Errors with a shorter correlation time than this interval are then white.
            measured_nt.fill(f64::NAN);
            rows_at(flown.ins.tt_s, INTERVAL_S).into_iter().for_each(|row| measured_nt[row] = flown.measured_nt[row]);
        }
        let line = NavigationLine { errors, measurement_nt: &measured_nt, fixes: flown.fixes(), ..flown.line()? };
        let parameters = MpfParameters { adapt: true, ..MpfParameters::default() };
        let Some(at) = locate(&parameters, &line, &HandOver::default()).map_err(data)? else { return Ok(None) };
        let since_s = flown.ins.tt_s[at.row] - flown.ins.tt_s[0];
        let fix = StartFix {
            lat_lon_deg: [at.lat_deg, at.lon_deg],
            alt_m: at.alt_m,
            vel_ned_mps: Some(at.vel_ned_mps),
            sigmas: StartFixSigmas {
                horizontal_m: at.horizontal_sigma_m.hypot(at.velocity_sigma_mps * since_s),
                vertical_m: at.vertical_sigma_m,
                velocity_mps: at.velocity_sigma_mps,
            },
        };
        let start = Some(fix.covariance(&flown.errors, flown.errors.start.as_ref()));
        Ok(Some((self.ins.clone().corrected(&fix, at.row), InsErrorModel { start, ..flown.errors })))
    }
}

impl FilterInput<'_> {
    /// Rejects an offset that is computed at an INS position whose error may exceed the range over which the map is
    /// linear.
    ///
    /// # Errors
    /// Fails if an offset is requested and the start is wide.
    pub(super) fn reject_wide_offset(&self) -> Result<(), Fault> {
        let Some(range) = self.start_range.filter(|range| range.is_exceeded() && self.offset_window_s > 0.0) else {
            return Ok(());
        };
        let what = format!(
            "`offset_window_s` compares the measurement with the map at the INS position, which is known only to \
             {:.0} m",
            range.sigma_m
        );
        let help = "remove `offset_window_s`, and set `fogm_sigma_nt` to the size of the offset";
        Err(Fault::data(what).help(help))
    }
}
