//! Limits of figures that are no metrics, or that depend on several figures. A metric declares its own limit
//! (`stages/src/score`).
//!
//! A row of pooled scores is flagged if one of its lines is flagged. If the pooled mean exceeds a limit, at least one
//! line exceeds it, too.

/// Smallest ratio of the initial position's standard deviation to the distance over which the map is linear that is
/// flagged. On flights of another simulator the extended Kalman filter converges at ratios up to 0.8 and loses the
/// aircraft at 1.6; at 1.07 over the Osborne map it converges.
pub const WIDE_START: f64 = 1.5;

/// Number of standard deviations of its estimate that a flagged lag or height bias exceeds.
const CONSTANT_SIGMAS: f64 = 4.0;

/// Limit of the lag of the magnetometer, in seconds, for a standard deviation of its estimate.
pub fn lag_s(sigma_s: f64) -> f64 {
    const LEAST_S: f64 = 0.05;
    LEAST_S.max(CONSTANT_SIGMAS * sigma_s)
}

/// Maximum share of measurements that the gate rejects. On 252 simulated lines of two aircraft with default settings,
/// the share is at most 0.05 on lines where the filter keeps the position, and 0.08 to 0.38 on the four lines where a
/// filter with rejections loses it.
pub const GATED: f64 = 0.1;

/// Limit of the bias between the height of the INS and the height on the map, in metres, for a standard deviation of
/// its estimate. The weather changes the height of a barometer by less than the smallest limit within an hour.
pub fn height_bias_m(sigma_m: f64) -> f64 {
    const LEAST_M: f64 = 10.0;
    LEAST_M.max(CONSTANT_SIGMAS * sigma_m)
}

/// Number of standard errors by which a retention must be below its limit.
pub const RETENTION_ERRORS: f64 = 2.0;

/// Maximum share of a line's samples off the map.
pub const OFF_MAP: f64 = 0.5;

/// Maximum share of a line's samples over which the map is too flat for a position.
pub const FLAT: f64 = 0.5;

/// Minimum share of samples off the map that counts as the cause of an error.
pub const OFF_MAP_CAUSE: f64 = 0.1;

/// Minimum bias of the measurement, in its assumed standard deviations, that counts as a cause. A bias of the
/// measurement biases the position.
pub const BIAS_SIGMAS: f64 = 2.0;

/// Ratio of the compensation residual to the assumed measurement noise, or of the noise to the residual, above which
/// their difference counts as a cause.
pub const RESIDUAL_SIGMAS: f64 = 1.5;

/// Largest NEES of a line whose filter counts as consistent in a cause; twice the expected value.
pub const CONSISTENT_NEES: f64 = 4.0;

/// Maximum difference between two dates of the core field, in years: it changes by up to 100 nT per year.
pub const DATE_A: f64 = 0.25;

/// Error of a map at the wrong height above which it is flagged, in nT. It is half the assumed measurement noise, which
/// makes the total error a tenth larger than the filter assumes. It is at most 5 nT, the error of a good map.
pub fn map_height_nt(sigma_nt: Option<f64>) -> f64 {
    sigma_nt.map_or(5.0, |sigma| (0.5 * sigma).min(5.0))
}
