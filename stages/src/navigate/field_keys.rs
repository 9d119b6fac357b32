//! Keys of the measured field and its map, common to `navigate` and `noise_network`.

use numerics::maps::map_surface::MapInterpolation;
use schemas::{Rule, params};

use super::Tuning;

params! {
    /// Measured field, its prediction from the map, and the source of unset parameters.
    pub struct FieldKeys;
    /// Source of unset parameters. `auto` estimates the noise of each line from the likelihood of its innovations,
    /// rejects outliers, and continues a map of known height to the flight heights. `magnav` uses the defaults of
    /// MagNav.jl, no gate, and the map at its own height. A key in the spec overrides either.
    tuning: Tuning, unit "", default Tuning::Auto;
    /// Measured field of one or several magnetometers. A filter that cannot process magnetometers separately uses their
    /// mean at each sample, with the noise of a mean of independent readings. Each magnetometer has its own offset.
    mag: Vec<String>, unit "nT", default vec!["mag_c".to_owned()];
    /// Predicts the core field as part of the measurement. `false`: the measurement is an anomaly.
    core_field: bool, unit "", default true;
    /// Subtracts the column `diurnal` from the measurement, so that the filter need not estimate the temporal
    /// variation. A sample with a NaN in `diurnal` has no measurement.
    remove_diurnal: Option<bool>, unit "",
        absent "true if the flight has a column `diurnal` that has not yet been subtracted from the measurement";
    /// Date of the core field as a decimal year. Replaces the flight's date.
    decimal_year: Option<f64>, unit "a", absent "the flight's own date", rule Rule::Between(1900.0, 2030.0);
    /// Interpolation of the map. The field above its sources is smooth, so a spline is closer to it than a bilinear
    /// map.
    map_interpolation: Option<MapInterpolation>, unit "",
        absent "`cubic` with `tuning = \"auto\"`, else `linear`";
    /// Heights above the ellipsoid, ascending, to which the map is continued. Between them the map is interpolated
    /// linearly.
    map_levels_m: Option<Vec<f64>>, unit "m",
        absent "with `tuning = \"auto\"` the map is continued to the flight heights, otherwise it is used at its own \
            height";
    /// Correlation length of the map error, for a map with the column `error` (`map_grid`, `track_map`); typically the
    /// spacing of its survey lines. The equivalent white noise is added to the measurement noise of each sample. An
    /// extended Kalman filter predicts the position at which the map error is looked up.
    map_error_length_m: Option<f64>, unit "m",
        absent "the map is assumed to be exact; `tuning = \"auto\"` estimates a factor on the column `error`, or on \
            the interpolation error that the map implies", rule Rule::Positive;
    /// Length of the window from the start of a line over which the mean of measurement minus prediction is computed.
    /// This offset is subtracted from the measurements before filtering, because compensation leaves a constant
    /// undetermined. 0 subtracts nothing.
    offset_window_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
}
