//! Keys of the measured field and its map, common to `navigate` and `noise_network`.

use numerics::maps::map_surface::MapInterpolation;
use schemas::{Rule, params};

use super::Tuning;

params! {
    /// Measured field, its prediction from the map, and the source of unset parameters.
    pub struct FieldKeys;
    /// Source of unset parameters. `auto` estimates the noise of each line from the likelihood of its innovations,
    /// rejects outliers, and continues a map of known height to the flight heights. `magnav` uses the defaults of
    /// MagNav.jl, no gate, and the map at its own height. A key in the spec takes precedence over both.
    tuning: Tuning, unit "", default Tuning::Auto;
    /// Columns of the field measured by one or several magnetometers. A filter that cannot process magnetometers
    /// separately uses their mean at each sample, and assumes that their noise is independent. The offset
    /// (`offset_window_s`) is computed for each magnetometer.
    mag: Vec<String>, unit "nT", default vec!["mag_c".to_owned()];
    /// Adds the core field to the predicted measurement. `false` means that the measurement is an anomaly.
    core_field: bool, unit "", default true;
    /// Subtracts the column `diurnal` from the measurement, so that the filter need not estimate the temporal
    /// variation. A sample with a NaN in `diurnal` has no measurement.
    remove_diurnal: Option<bool>, unit "",
        absent "true if the flight has a column `diurnal` that has not yet been subtracted from the measurement";
    /// Date of the core field as a decimal year. It replaces the flight's date.
    decimal_year: Option<f64>, unit "a", absent "the flight's own date", rule Rule::Between(1900.0, 2030.0);
    /// Interpolation of the map. The field above its sources is smooth, so spline interpolation is more accurate than
    /// bilinear interpolation.
    map_interpolation: Option<MapInterpolation>, unit "",
        absent "`cubic` with `tuning = \"auto\"`, else `linear`";
    /// Heights above the ellipsoid, ascending, to which the map is continued. Between these heights the map is
    /// interpolated linearly.
    map_levels_m: Option<Vec<f64>>, unit "m",
        absent "with `tuning = \"auto\"` the map is continued to the flight heights, otherwise it is used at its own \
            height";
    /// Correlation length of the map error, for a map with the column `error` (`map_grid`, `track_map`); typically the
    /// spacing of its survey lines. The correlated map error is converted to equivalent white noise, which is added to
    /// the measurement noise of each sample. The map error is interpolated at the position that an extended Kalman
    /// filter predicts.
    map_error_length_m: Option<f64>, unit "m",
        absent "the map is assumed to be exact; `tuning = \"auto\"` instead uses the map's column `error`, or the \
            error of the map's interpolation, times an estimated factor", rule Rule::Positive;
    /// Length of the window at the start of a line in which an offset is computed: the mean of measurement minus
    /// prediction. The offset is subtracted from all measurements of the line before filtering, because compensation
    /// leaves a constant undetermined. 0 subtracts nothing.
    offset_window_s: f64, unit "s", default 0.0, rule Rule::NotNegative;
}
