//! Limits of figures that are not metrics, and limits that depend on several figures. A metric declares its own limit
//! (`stages/src/score`).
//!
//! A row of pooled scores is flagged if one of its lines is flagged. If the pooled mean exceeds a limit, at least one
//! line exceeds it, too.

/// An initial position is flagged if its standard deviation, divided by the distance over which the map is linear,
/// exceeds this ratio. On flights of another simulator the extended Kalman filter converges at ratios up to 0.8 and
/// loses the aircraft at 1.6; at 1.07 over the Osborne map it converges.
pub const WIDE_START: f64 = 1.5;

/// A lag or height bias is flagged only if its estimate exceeds this number of standard deviations.
const CONSTANT_SIGMAS: f64 = 4.0;

/// Limit in seconds for the lag of the magnetometer, given the standard deviation of the estimated lag.
pub fn lag_s(sigma_s: f64) -> f64 {
    const LEAST_S: f64 = 0.05;
    LEAST_S.max(CONSTANT_SIGMAS * sigma_s)
}

/// Maximum share of measurements that the gate rejects. On 252 simulated lines of two aircraft with default settings,
/// the share is at most 0.05 on lines where the filter keeps the position, and 0.08 to 0.38 on the four lines where a
/// filter with rejections loses it.
pub const GATED: f64 = 0.1;

/// Limit in metres for the bias between the height of the INS and the height on the map, given the standard deviation
/// of the estimated bias. Within an hour, the weather changes barometric height by less than the smallest limit.
pub fn height_bias_m(sigma_m: f64) -> f64 {
    const LEAST_M: f64 = 10.0;
    LEAST_M.max(CONSTANT_SIGMAS * sigma_m)
}

/// A retention is flagged only if it is below its limit by more than this number of standard errors.
pub const RETENTION_ERRORS: f64 = 2.0;

/// Maximum share of a line's samples off the map.
pub const OFF_MAP: f64 = 0.5;

/// Maximum share of a line's samples over which the map is too flat for a position.
pub const FLAT: f64 = 0.5;

/// An error is attributed to samples off the map if their share is at least this.
pub const OFF_MAP_CAUSE: f64 = 0.1;

/// A bias of the measurement biases the position. An error is attributed to this bias if the bias exceeds this number
/// of assumed standard deviations of the measurement.
pub const BIAS_SIGMAS: f64 = 2.0;

/// An error is attributed to a wrong measurement noise if the assumed noise and the compensation residual differ by
/// more than this factor, in either direction.
pub const RESIDUAL_SIGMAS: f64 = 1.5;

/// NEES up to which a filter counts as consistent when a cause is determined: twice the expected value.
pub const CONSISTENT_NEES: f64 = 4.0;

/// Maximum difference between two dates of the core field, in years. The core field changes by up to 100 nT per year.
pub const DATE_A: f64 = 0.25;

/// Limit in nT: a map at the wrong height is flagged if the resulting error exceeds it. The limit is half the assumed
/// measurement noise; an error of this size makes the total error a tenth larger than the filter assumes. The limit is
/// at most 5 nT, the error of a good map.
pub fn map_height_nt(sigma_nt: Option<f64>) -> f64 {
    sigma_nt.map_or(5.0, |sigma| (0.5 * sigma).min(5.0))
}
