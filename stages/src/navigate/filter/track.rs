//! Outputs of a filter: the track, and the outcome of each measurement.

use arrow_array::ArrayRef;
use numerics::navigation::{
    output::{NavigationOutput, NavigationReport},
    pinson::STATES,
};
use schemas::{Column, Fault, choice};

use super::FilterInput;
use crate::columns::list;

choice! {
    /// Outcome of a measurement.
    pub enum UpdateOutcome {
        /// Used by the filter.
        Used = "used",
        /// No measurement.
        Missing = "missing",
        /// Predicted position off the map or in a cell with an unknown node.
        OffMap = "off_map",
        /// Innovation above the gate.
        Gated = "gated",
        /// Map too flat to observe the position; the temporal variation was corrected.
        Flat = "flat",
        /// Not needed by the filter.
        Unused = "unused",
    }
}

/// Estimate of a filter, one value per sample: the state a posteriori.
#[derive(Clone, Debug, Default)]
pub struct FilterTrack {
    /// Latitude, in degrees of WGS-84.
    pub lat_deg: Vec<f64>,
    /// Longitude, in degrees.
    pub lon_deg: Vec<f64>,
    /// Height above the ellipsoid, in metres.
    pub alt_m: Vec<f64>,
    /// Velocity north, in m/s.
    pub vn_mps: Vec<f64>,
    /// Velocity east, in m/s.
    pub ve_mps: Vec<f64>,
    /// Velocity down, in m/s.
    pub vd_mps: Vec<f64>,
    /// Standard deviation of the position north, in metres.
    pub sd_n_m: Vec<f64>,
    /// Standard deviation of the position east, in metres.
    pub sd_e_m: Vec<f64>,
    /// Covariance of the position errors north and east, in m².
    pub cov_ne_m2: Vec<f64>,
    /// Innovation, in nT; NaN if no measurement was used.
    pub residual_nt: Vec<f64>,
    /// Normalised innovation squared; NaN if `residual_nt` is NaN.
    pub nis: Vec<f64>,
    /// Outcome of the measurement.
    pub update: Vec<UpdateOutcome>,
    /// Arrays of [`NavigationFilter::columns`].
    pub more: Vec<ArrayRef>,
}

impl FilterTrack {
    /// Track from a filter's output, without the states, which the filter adds. `gate_nis` is the innovation gate of
    /// the filter.
    ///
    /// # Errors
    /// Fails if no measurement was used, or the offset is unknown.
    pub fn from_output(
        flown: &FilterInput,
        out: NavigationOutput,
        gate_nis: Option<f64>,
    ) -> Result<FilterTrack, Fault> {
        enough(flown, &out.report)?;
        Ok(Self::with_any(flown, out, gate_nis))
    }

    /// Same as [`FilterTrack::from_output`], but also accepts a line without a usable measurement.
    pub fn with_any(flown: &FilterInput, out: NavigationOutput, gate_nis: Option<f64>) -> FilterTrack {
        let update = |(residual, (nis, measured)): (&f64, (&f64, &f64))| match gate_nis {
            _ if !measured.is_finite() => UpdateOutcome::Missing,
            _ if residual.is_nan() => UpdateOutcome::OffMap,
            Some(gate) if *nis > gate => UpdateOutcome::Gated,
            Some(_) | None => UpdateOutcome::Used,
        };
        let update = out.residual_nt.iter().zip(out.nis.iter().zip(&flown.measured_nt)).map(update).collect();
        FilterTrack { update, ..FilterTrack::without_updates(out) }
    }

    /// Track of a filter's output without the outcomes of the measurements.
    pub fn without_updates(out: NavigationOutput) -> FilterTrack {
        FilterTrack {
            lat_deg: out.lat_deg,
            lon_deg: out.lon_deg,
            alt_m: out.alt_m,
            vn_mps: out.vn_mps,
            ve_mps: out.ve_mps,
            vd_mps: out.vd_mps,
            sd_n_m: out.sd_n_m,
            sd_e_m: out.sd_e_m,
            cov_ne_m2: out.cov_ne_m2,
            residual_nt: out.residual_nt,
            nis: out.nis,
            update: vec![],
            more: vec![],
        }
    }
}

/// Rejects a line without a usable measurement.
pub(in crate::navigate) fn enough(flown: &FilterInput, report: &NavigationReport) -> Result<(), Fault> {
    if report.updates == 0 {
        let what = format!(
            "no sample could be used: {} without a measurement, {} off the map",
            report.missing_measurements, report.off_map
        );
        return Err(Fault::data(what).help("check that the map covers the flight"));
    }
    if flown.offset_window_s > 0.0 && report.offset_samples == 0 {
        return Err(Fault::data(
            "no sample within `offset_window_s` has a measurement and a map value, so the offset is unknown",
        ));
    }
    Ok(())
}

/// States, in the order of Gnadt 2022 (5.14).
const STATE_NAMES: [&str; STATES] = [
    "lat", "lon", "alt", "vn", "ve", "vd", "tilt_n", "tilt_e", "tilt_d", "acc_1", "acc_2", "acc_3", "gyro_1", "gyro_2",
    "gyro_3", "ha", "a_hat", "s",
];

/// The columns of `save_state`: the states `x` and their covariance `p`.
pub fn state_columns() -> Vec<Column> {
    let states: Vec<String> = STATE_NAMES.map(str::to_owned).to_vec();
    let pairs = STATE_NAMES.iter().flat_map(|a| STATE_NAMES.iter().map(move |b| format!("{a}*{b}"))).collect();
    vec![
        Column::list("x", "", "error state, truth minus INS, Gnadt 2022 (5.14); rad, m, s, nT", states),
        Column::list("p", "", "covariance of x, row-major", pairs),
    ]
}

/// Arrays of [`state_columns`], taken from a filter's output.
///
/// # Errors
/// Fails if the values do not make a list column.
pub fn state_arrays(out: &mut NavigationOutput) -> Result<Vec<ArrayRef>, Fault> {
    // The values are moved instead of copied, because the covariances of a long flight occupy half a gigabyte.
    let (x, p) = (std::mem::take(&mut out.x), std::mem::take(&mut out.p));
    Ok(vec![list(x.into_flattened(), STATES)?, list(p.into_flattened().into_flattened(), STATES * STATES)?])
}
