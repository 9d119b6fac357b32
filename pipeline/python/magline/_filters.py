"""Filters of the stage `navigate` as functions on arrays.

Made from the declarations by `generate.py filters`; do not edit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from numpy.typing import ArrayLike

from magline._track import ListLike, Magnetometers, Track, navigate_line
from magline.maps import Map

__all__ = ["crlb", "ekf", "ekf_adaptive", "ekf_online_tl", "fixed_lag", "iekf", "mpf",
    "mpf_then_ekf", "rts", "ukf"]


def ekf(
    tt_s: ArrayLike,
    ins_lat_deg: ArrayLike,
    ins_lon_deg: ArrayLike,
    ins_alt_m: ArrayLike,
    mag_nt: Magnetometers,
    map: Map,
    *,
    ins_velocity_ned_mps: ArrayLike | None = None,
    ins_force_ned_mps2: ArrayLike | None = None,
    ins_attitude_deg: ArrayLike | None = None,
    columns: Mapping[str, Any] | None = None,
    tuning: Literal["auto", "magnav"] | None = None,
    core_field: bool | None = None,
    remove_diurnal: bool | None = None,
    decimal_year: float | None = None,
    map_interpolation: Literal["linear", "quadratic", "cubic"] | None = None,
    map_levels_m: ListLike | None = None,
    map_error_length_m: float | None = None,
    offset_window_s: float | None = None,
    measurement_sigma_nt: float | Literal["auto"] | None = None,
    fogm_sigma_nt: float | Literal["auto"] | None = None,
    fogm_tau_s: float | Literal["auto"] | None = None,
    noise_column: str | None = None,
    start: Literal["auto", "fix", "alignment", "given"] | None = None,
    fix: ListLike | None = None,
    fix_velocity: ListLike | None = None,
    fix_sigma_m: float | None = None,
    fix_alt_sigma_m: float | None = None,
    fix_velocity_sigma_mps: float | None = None,
    vector: str | None = None,
    sensor_axis: ListLike | None = None,
    dead_zones: Literal["none", "polar", "polar_and_equatorial"] | None = None,
    ins_grade: Literal["magnav", "navigation", "tactical", "commercial"] | None = None,
    init_position_sigma_m: float | None = None,
    init_altitude_sigma_m: float | None = None,
    init_velocity_sigma_mps: float | None = None,
    init_attitude_sigma_deg: float | None = None,
    init_heading_sigma_deg: float | None = None,
    vrw_sigma: float | None = None,
    arw_sigma: float | None = None,
    baro_sigma_m: float | None = None,
    ha_sigma_m: float | None = None,
    a_hat_sigma_mps2: float | None = None,
    acc_sigma_mps2: float | None = None,
    gyro_sigma_radps: float | None = None,
    baro_tau_s: float | None = None,
    acc_tau_s: float | None = None,
    gyro_tau_s: float | None = None,
    save_state: bool | None = None,
    gate_nis: float | None = None,
    discretisation: Literal["trapezoidal", "rectangular", "van_loan"] | None = None,
    gnss_lost_s: ListLike | None = None,
    gnss: ListLike | None = None,
    gnss_interval_s: float | None = None,
    gnss_sigma_m: float | None = None,
    gnss_alt_sigma_m: float | None = None,
    gnss_noise: bool | None = None,
    gnss_test: bool | None = None,
    gradient: ListLike | None = None,
    gradient_baseline_m: ListLike | None = None,
    gradient_sigma_nt: float | None = None,
    gradient_bias_sigma_nt: float | None = None,
    gradient_bias_tau_s: float | None = None,
    gradient_slope_sigma: float | Literal["auto"] | None = None,
    use_scalar: bool | None = None,
    vector_sigma_nt: float | None = None,
    vector_bias_sigma_nt: float | None = None,
    vector_bias_tau_s: float | None = None,
    vector_crustal_sigma_nt: float | None = None,
    vector_crustal_length_m: float | None = None,
    height: str | None = None,
    height_sigma_m: float | None = None,
    height_bias_sigma_m: float | None = None,
    height_bias_tau_s: float | None = None,
    map_sigma_nt: float | None = None,
    map_sigma_length_m: float | None = None,
    mag_latency_sigma_s: float | None = None,
    map_height_sigma_m: float | None = None,
    permanent_change_sigma_nt: float | None = None,
    permanent_change_tau_s: float | None = None,
    flat_over_m: float | None = None,
) -> Track:
    """The extended Kalman filter with 18 states: position, velocity, tilt, accelerometer and
    gyro biases, barometer loop, and temporal variation.

    The map is linearised at the estimated position of each sample.

    With `tuning = "auto"` the innovation variance includes the effect of the map's curvature
    within the position uncertainty. This effect is computed from second-order divided
    differences [Nørgaard, Poulsen & Ravn 2000]. Without this term, the first updates after an
    inaccurate start reduce the covariance too far.

    Parameters
    ----------
    tt_s : array_like
        Times of the samples, s, ascending, of shape (samples,).
    ins_lat_deg : array_like
        Latitude of the INS, degrees, of shape (samples,).
    ins_lon_deg : array_like
        Longitude of the INS, degrees, of shape (samples,).
    ins_alt_m : array_like
        Height of the INS above the WGS-84 ellipsoid, m, of shape (samples,).
    mag_nt : Magnetometers
        Measured field, nT, of shape (samples,); NaN where there is no measurement. A mapping
        holds several magnetometers under the names of their columns, such as `mag_1_c`
        (compensated) or `mag_1_uc`.
    map : Map
        Anomaly map, such as the result of `magline.maps.open`.
    ins_velocity_ned_mps : array_like, optional
        Velocity of the INS north, east and down, m/s, of shape (samples, 3). Default: derived
        from its positions.
    ins_force_ned_mps2 : array_like, optional
        Specific force of the INS north, east and down, m/s^2, of shape (samples, 3). Default:
        derived from its velocities.
    ins_attitude_deg : array_like, optional
        Roll, pitch and yaw of the INS, degrees, of shape (samples, 3). Default: level, along
        the course.
    columns : Mapping[str, Any], optional
        Further columns of the flight table under their names, in its units: those that keys
        name, and those that the stage uses if they are there, such as `diurnal` (nT), `year`,
        `doy`, `gnss_lat` (deg), `ins_aligned` (s), and the truth `lat` and `lon` (deg) and
        `alt` (m). A value is an array of shape (samples,), one number or text for all samples,
        or a pair of a matrix with one row per sample and the names of its columns.
    tuning : {"auto", "magnav"}, optional
        Source of unset parameters. `auto` estimates the noise of each line from the likelihood
        of its innovations, rejects outliers, and continues a map of known height to the flight
        heights. `magnav` uses the defaults of MagNav.jl, no gate, and the map at its own
        height. A key in the spec takes precedence over both. Default: `"auto"`.
    core_field : bool, optional
        Adds the core field to the predicted measurement. `false` means that the measurement is
        an anomaly. Default: `true`.
    remove_diurnal : bool, optional
        Subtracts the column `diurnal` from the measurement, so that the filter need not
        estimate the temporal variation. A sample with a NaN in `diurnal` has no measurement.
        Unset: true if the flight has a column `diurnal` that has not yet been subtracted from
        the measurement.
    decimal_year : float, optional
        Date of the core field as a decimal year. It replaces the flight's date. Unit: a.
        Allowed: 1900 to 2030. Unset: the flight's own date.
    map_interpolation : {"linear", "quadratic", "cubic"}, optional
        Interpolation of the map. The field above its sources is smooth, so spline interpolation
        is more accurate than bilinear interpolation. Unset: `cubic` with `tuning = "auto"`,
        else `linear`.
    map_levels_m : ListLike, optional
        Heights above the ellipsoid, ascending, to which the map is continued. Between these
        heights the map is interpolated linearly. Unit: m. Unset: with `tuning = "auto"` the map
        is continued to the flight heights, otherwise it is used at its own height.
    map_error_length_m : float, optional
        Correlation length of the map error, for a map with the column `error` (`map_grid`,
        `track_map`); typically the spacing of its survey lines. The correlated map error is
        converted to equivalent white noise, which is added to the measurement noise of each
        sample. The map error is interpolated at the position that an extended Kalman filter
        predicts. Unit: m. Allowed: above 0. Unset: the map is assumed to be exact; `tuning =
        "auto"` instead uses the map's column `error`, or the error of the map's interpolation,
        times an estimated factor.
    offset_window_s : float, optional
        Length of the window at the start of a line in which an offset is computed: the mean of
        measurement minus prediction. The offset is subtracted from all measurements of the line
        before filtering, because compensation leaves a constant undetermined. 0 subtracts
        nothing. Unit: s. Allowed: 0 or above. Default: `0.0`.
    measurement_sigma_nt : float | {"auto"}, optional
        Standard deviation of the white noise of a measurement. It includes the noise of the
        sensor, the map and the compensation. `"auto"` uses the noise of the calibration
        residual, from the column `mag_sigma`. Unit: nT. Allowed: above 0. Unset: the
        maximum-likelihood estimate with `tuning = "auto"`, otherwise 5.0.
    fogm_sigma_nt : float | {"auto"}, optional
        Standard deviation of the first-order Gauss-Markov process for the temporal variation
        and all other slow errors. `"auto"` uses the column `mag_fogm_sigma`. Unit: nT. Allowed:
        0 or above. Unset: the maximum-likelihood estimate with `tuning = "auto"`, otherwise
        3.0.
    fogm_tau_s : float | {"auto"}, optional
        Time constant of the temporal variation. `"auto"` uses the column `mag_fogm_tau`. Unit:
        s. Allowed: above 0. Unset: the maximum-likelihood estimate with `tuning = "auto"`,
        otherwise 600.0.
    noise_column : str, optional
        Column with the standard deviation of an additional error of each sample:
        `mag_aircraft_sigma` of an ensemble, or the predicted error of a network. The square of
        this standard deviation is added to the square of `measurement_sigma_nt`. A sample
        without a value in this column has no measurement. Requires a single magnetometer. Unit:
        nT. Unset: equal noise at all samples.
    start : {"auto", "fix", "alignment", "given"}, optional
        Source of the initial estimate. `fix` corrects the INS with a position fix. `alignment`
        propagates the `init_*` standard deviations from the alignment to the start of the line.
        `given` applies the `init_*` standard deviations at the start of the line; the defaults
        are valid only within minutes of the alignment, because an INS drifts. `auto` selects
        one of the three from the keys and columns. Default: `"auto"`.
    fix : ListLike, optional
        Columns with the latitude (deg), longitude (deg) and height (m) of the fix. The first
        values within 2 s of the line's start are used. If the columns have the role truth,
        white noise with the fix's standard deviations is added. The added noise of a line is
        the same in every run. Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has
        them, else `lat`, `lon` and `alt`.
    fix_velocity : ListLike, optional
        Columns of the fix's velocity components: north, east and down. Unit: m/s. Unset:
        `gnss_vn`, `gnss_ve` and `gnss_vd` for a fix from `gnss_*` columns, otherwise `vn`, `ve`
        and `vd`; without these columns, the velocity of the INS.
    fix_sigma_m : float, optional
        Standard deviation of the fix's position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `3.0`.
    fix_alt_sigma_m : float, optional
        Standard deviation of the fix's height. Unit: m. Allowed: above 0. Default: `5.0`.
    fix_velocity_sigma_mps : float, optional
        Standard deviation of each component of the fix's velocity. Unit: m/s. Allowed: above 0.
        Default: `0.1`.
    vector : str, optional
        Vector magnetometer that gives the direction of the field, such as `flux_a`. The noise
        of this magnetometer, and the aircraft field at its position, are neglected. Unset:
        equal noise in all attitudes.
    sensor_axis : ListLike, optional
        Axis of the scalar sensor in the frame of the vector magnetometer: nose, right, down.
        Allowed: finite. Default: `[1.0,0.0,0.0]`.
    dead_zones : {"none", "polar", "polar_and_equatorial"}, optional
        Dead zones of the scalar sensor: along its axis (`polar`), or also across its axis
        (`polar_and_equatorial`). The assumed noise is inversely proportional to the amplitude
        of the sensor's signal. At the largest amplitude, the noise is `measurement_sigma_nt`. A
        sample whose amplitude is below a tenth of the largest gives no measurement. Default:
        `"none"`.
    ins_grade : {"magnav", "navigation", "tactical", "commercial"}, optional
        Grade of the INS. The grade sets the INS keys (`init_*`, `*_sigma*` and `*_tau_s`) that
        are unset in the spec. `magnav` sets the defaults shown for these keys. `navigation` is
        a Honeywell HG9900, `tactical` a Honeywell HG1700, and `commercial` has micro-mechanical
        sensors [Lee 2019, Tables 9 and 10]. For these three grades, the position at alignment
        is exact (`init_position_sigma_m = 0`). Unset: in `navigate`, the flight's column
        `ins_grade` if present; otherwise `magnav`.
    init_position_sigma_m : float, optional
        Standard deviation of the initial horizontal position error along each axis. Unit: m.
        Allowed: 0 or above. Default: `3.0`.
    init_altitude_sigma_m : float, optional
        Standard deviation of the initial height error. Unit: m. Allowed: 0 or above. Default:
        `0.001`.
    init_velocity_sigma_mps : float, optional
        Standard deviation of the initial velocity error along each axis. Unit: m/s. Allowed: 0
        or above. Default: `0.01`.
    init_attitude_sigma_deg : float, optional
        Standard deviation of the initial tilt error about each axis. Unit: deg. Allowed: 0 or
        above. Default: `0.01`.
    init_heading_sigma_deg : float, optional
        Standard deviation of the initial yaw error, the tilt about the down axis. In practice,
        the yaw error exceeds the other tilt errors, because the INS finds north from the
        earth's rotation, a much weaker signal than gravity. Unit: deg. Allowed: 0 or above.
        Unset: the initial tilt error.
    vrw_sigma : float, optional
        Velocity random walk: square root of the spectral density of the accelerometer noise.
        Unit: m/s^1.5. Allowed: 0 or above. Default: `0.000238`.
    arw_sigma : float, optional
        Angular random walk: square root of the spectral density of the gyro noise. Unit:
        rad/s^0.5. Allowed: 0 or above. Default: `5.81e-7`.
    baro_sigma_m : float, optional
        Standard deviation of the barometer error. Unit: m. Allowed: 0 or above. Default: `1.0`.
    ha_sigma_m : float, optional
        Standard deviation of the initial error of the altitude in the barometer loop, which
        aids the INS height. Unit: m. Allowed: 0 or above. Default: `0.001`.
    a_hat_sigma_mps2 : float, optional
        Standard deviation of the initial error of the vertical acceleration in the barometer
        loop, which aids the INS height. Unit: m/s2. Allowed: 0 or above. Default: `0.01`.
    acc_sigma_mps2 : float, optional
        Standard deviation of the accelerometer bias. Unit: m/s2. Allowed: 0 or above. Default:
        `0.000245`.
    gyro_sigma_radps : float, optional
        Standard deviation of the gyro bias. Unit: rad/s. Allowed: 0 or above. Default:
        `7.27e-9`.
    baro_tau_s : float, optional
        Time constant of the barometer error. Unit: s. Allowed: above 0. Default: `3600.0`.
    acc_tau_s : float, optional
        Time constant of the accelerometer bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    gyro_tau_s : float, optional
        Time constant of the gyro bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    save_state : bool, optional
        Appends the state `x` and its covariance `p` (row-major). Default: `false`.
    gate_nis : float, optional
        Largest accepted NIS (squared innovation divided by its variance) of a measurement.
        Allowed: above 0. Unset: no gate; with `tuning = "auto"`, outliers are rejected before
        filtering.
    discretisation : {"trapezoidal", "rectangular", "van_loan"}, optional
        Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of
        first order as in MagNav.jl, and `van_loan` exact. Default: `"trapezoidal"`.
    gnss_lost_s : ListLike, optional
        Times at which GNSS is lost and recovered, in seconds from the first sample of the line.
        Before the loss and after the recovery, the GNSS position (columns `gnss`) aids the
        filter. With `[0.0, 600.0]`, GNSS is missing for the first ten minutes of the line. If
        the recovery time is after the end of the line, GNSS is never recovered. Unit: s.
        Allowed: 0 or above. Unset: GNSS is not used.
    gnss : ListLike, optional
        Columns with the GNSS latitude (deg), longitude (deg) and height above the ellipsoid
        (m). Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has them, else `lat`,
        `lon` and `alt`.
    gnss_interval_s : float, optional
        Time between successive GNSS positions. Unit: s. Allowed: above 0. Default: `1.0`.
    gnss_sigma_m : float, optional
        Standard deviation of the GNSS position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `2.0`.
    gnss_alt_sigma_m : float, optional
        Standard deviation of the GNSS height. Unit: m. Allowed: above 0. Default: `5.0`.
    gnss_noise : bool, optional
        Adds white noise to the GNSS positions, with the standard deviations `gnss_sigma_m` and
        `gnss_alt_sigma_m`. The added noise of a line is the same in every run. True positions
        have no error: without added noise, the filter appears more accurate than with real
        GNSS. Unset: true if the columns of `gnss` have the role `truth`.
    gnss_test : bool, optional
        Tests each GNSS position against the INS position and does not use rejected positions. A
        chi-square test of each position detects a jump at once. A cumulative sum over earlier
        positions detects a drift of 1 m/s after about 10 s. The test then also rejects the
        positions since the start of the drift. Positions are accepted again after ten
        consecutive positions agree with the INS. The column `gnss_update` (`used`, `rejected`
        or `none`) is appended even if this key is false. Default: `true`.
    gradient : ListLike, optional
        Two compensated scalar magnetometers. The difference between their readings, first minus
        second, measures the slope of the map along the baseline between them. The temporal
        variation and all other common errors cancel in this difference. This key cannot be
        combined with `map_interpolation = "linear"`, because the slope of a bilinear map has
        steps. Unit: nT. Unset: the difference is not used.
    gradient_baseline_m : ListLike, optional
        Vector from the second magnetometer of `gradient` to the first, in the body frame (nose,
        right, down). The INS attitude rotates this vector to the navigation frame. The
        measurement model includes the estimated error of the INS attitude. Unit: m. Allowed:
        finite. Unset: required with `gradient`.
    gradient_sigma_nt : float, optional
        Standard deviation of the white noise in the difference between the two magnetometers'
        readings. Unit: nT. Allowed: above 0. Default: `0.1`.
    gradient_bias_sigma_nt : float, optional
        Standard deviation of the slowly varying error in the difference between the two
        magnetometers' readings. Such an error is likely, because each calibration leaves a
        constant undetermined. Unit: nT. Allowed: 0 or above. Default: `1.0`.
    gradient_bias_tau_s : float, optional
        Time constant of the slowly varying error in the difference between the two
        magnetometers' readings. Unit: s. Allowed: above 0. Default: `3600.0`.
    gradient_slope_sigma : float | {"auto"}, optional
        Standard deviation of the error in the map's slope along the baseline. The error of the
        predicted difference is this error times the length of the baseline. The error is
        correlated along the track, over the same length as the map's anomalies. `"auto"` uses
        the maximum-likelihood value from the innovations of the difference. A large value can
        reveal a map made from widely spaced lines. A map at one height without `map_levels_m`
        has no vertical slope. The prediction then has an additional error: the height
        difference between the magnetometers times the rms slope. Unit: nT/m. Allowed: 0 or
        above. Default: `auto`.
    use_scalar : bool, optional
        Uses the scalar measurement `mag` in the measurement update. `false` ignores `mag`, for
        example in a magnetic storm, and requires the difference (`gradient`) or the vector
        (`vector_sigma_nt`). Default: `true`.
    vector_sigma_nt : float, optional
        Standard deviation of the white noise of each component of `vector`. If set, the
        components are used as measurements. They depend on the total field and on the attitude,
        but not on a rotation about the field direction. This key requires `core_field = true`
        and a calibrated vector magnetometer. Unit: nT. Allowed: above 0. Unset: the vector is
        not used as a measurement.
    vector_bias_sigma_nt : float, optional
        Standard deviation of the bias of each component of `vector`. In a field of 50,000 nT, a
        bias of 50 nT corresponds to an attitude error of 0.06°. Unit: nT. Allowed: 0 or above.
        Default: `50.0`.
    vector_bias_tau_s : float, optional
        Time constant of the bias of each component of `vector`. Unit: s. Allowed: above 0.
        Default: `3600.0`.
    vector_crustal_sigma_nt : float, optional
        Standard deviation, per component, of the crustal field that a map of the scalar anomaly
        leaves undetermined. A typical value is the standard deviation of the anomaly. Unit: nT.
        Allowed: 0 or above. Default: `50.0`.
    vector_crustal_length_m : float, optional
        Correlation length of the crustal field that `vector_crustal_sigma_nt` describes. A
        typical value is the height above the sources. Unit: m. Allowed: above 0. Default:
        `1000.0`.
    height : str, optional
        Column of measured heights above the ellipsoid, such as `baro`, from a barometer that
        does not already aid the INS. Unit: m. Unset: the height of the INS, aided by its
        barometer, is used.
    height_sigma_m : float, optional
        Standard deviation of the white noise of the measured height. Unit: m. Allowed: above 0.
        Default: `3.0`.
    height_bias_sigma_m : float, optional
        Standard deviation of the slowly varying error of the measured height, caused by the
        weather and the geoid. Unit: m. Allowed: 0 or above. Default: `30.0`.
    height_bias_tau_s : float, optional
        Time constant of the slowly varying error of the measured height. Unit: s. Allowed:
        above 0. Default: `3600.0`.
    map_sigma_nt : float, optional
        Standard deviation of the map error. If set, the filter estimates the map error as a
        state that is correlated along the track. Unit: nT. Allowed: 0 or above. Unset: the map
        error is not estimated.
    map_sigma_length_m : float, optional
        Distance over which the autocorrelation of the map error falls to 1/e. Unit: m. Allowed:
        above 0. Default: `500.0`.
    mag_latency_sigma_s : float, optional
        Prior standard deviation of the lag of the magnetometer's time stamps. If set, the
        filter estimates the lag as a state that is constant along the line. A sample with time
        stamp `t` was measured at `t` minus the lag. The lag may be negative. 0 omits this
        state. The columns `mag_latency` and `mag_latency_sigma` are appended. This key is
        available in `ekf`, `iekf` and `ukf`. Unit: s. Allowed: 0 or above. Unset: 1.0 with
        `tuning = "auto"` if a state for the lag clearly increases the likelihood, otherwise 0
        (exact time stamps).
    map_height_sigma_m : float, optional
        Prior standard deviation of a height bias: the true height of the aircraft minus its
        assumed height on the map. Possible causes are a constant error of the barometer, a
        missing geoid height, and a wrong map height. If set, the filter estimates the bias as a
        state that is constant along the line. The bias changes only the predicted total field,
        not `alt`. The heights to which the map is continued must include the true height of the
        aircraft. With `tuning = "auto"`, the map is continued to twice this standard deviation
        below and above the line. Otherwise, set `map_levels_m`. 0 omits this state. The columns
        `map_height_bias` and `map_height_bias_sigma` are appended. This key is available in
        `ekf`, `iekf` and `ukf`. Unit: m. Allowed: 0 or above. Unset: 50 with `tuning = "auto"`
        if a bias clearly increases the likelihood, otherwise 0 (exact height). To find a bias,
        `auto` continues the map up to 200 m below and above the line, unless `map_levels_m` is
        set.
    permanent_change_sigma_nt : float, optional
        Standard deviation of the change in the aircraft's permanent field since calibration,
        per component (nose, right, down). The filter estimates the three components as
        additional states. The attitude and the core field determine the effect of these
        components on the total field. A fourth state is a constant offset with a standard
        deviation of 100 nT. 0 omits these states. This key requires `core_field = true`, and is
        available in `ekf`, `iekf` and `ukf`. Unit: nT. Allowed: 0 or above. Unset: the
        maximum-likelihood estimate with `tuning = "auto"` if these states clearly increase the
        likelihood, otherwise 0.
    permanent_change_tau_s : float, optional
        Time constant of the change in the permanent field. Unit: s. Allowed: above 0. Unset:
        the maximum-likelihood estimate with `tuning = "auto"`, otherwise infinite, so that the
        change is constant along the line.
    flat_over_m : float, optional
        A sample corrects the position only if the ratio of its measurement noise (standard
        deviation) to the map's horizontal slope is at most this value. At a larger ratio, the
        map is too flat to observe the position. The sample is then `flat`: it corrects only the
        temporal variation and the map error. The column `map_slope` is appended. Unit: m.
        Allowed: above 0. Unset: all samples correct the position.

    Returns
    -------
    Track
        Estimate at each sample, innovations, warnings and notes.

    Raises
    ------
    SpecError
        If a key is unknown, has an invalid value, or has no effect.
    DataError
        If the line cannot be filtered, such as an INS with a NaN or a line off the map.
    ValueError
        If the shapes of the arrays differ.

    References
    ----------
    Gnadt 2022, section 5.3, with discretised process noise. The Jacobians F and H are verified
    by finite differences.

    Examples
    --------
    >>> import numpy as np
    >>> from magline import filters, maps
    >>> lat, lon = np.linspace(45.0, 45.2, 201), np.linspace(-76.1, -75.9, 201)
    >>> hills = 60.0 * np.sin(400.0 * lat[:, None]) + 50.0 * np.cos(500.0 * (lat[:, None] + lon))
    >>> field = maps.Map(lon, lat, hills, np.full(hills.shape, 300.0), 4326, "deg")
    >>> t = np.arange(100.0)  # northward over the nodes of a column; the INS is 11 m too far north
    >>> ins = t, lat[50:150] + 1e-4, np.full(100, lon[100]), np.full(100, 300.0)
    >>> start = {"start": "given", "init_position_sigma_m": 20.0}
    >>> track = filters.ekf(*ins, hills[50:150, 100], field, core_field=False, **start)
    >>> bool(abs(track.lat_deg[-1] - lat[149]) < 5e-5)
    True
    """
    return navigate_line("ekf", locals())


def iekf(
    tt_s: ArrayLike,
    ins_lat_deg: ArrayLike,
    ins_lon_deg: ArrayLike,
    ins_alt_m: ArrayLike,
    mag_nt: Magnetometers,
    map: Map,
    *,
    ins_velocity_ned_mps: ArrayLike | None = None,
    ins_force_ned_mps2: ArrayLike | None = None,
    ins_attitude_deg: ArrayLike | None = None,
    columns: Mapping[str, Any] | None = None,
    tuning: Literal["auto", "magnav"] | None = None,
    core_field: bool | None = None,
    remove_diurnal: bool | None = None,
    decimal_year: float | None = None,
    map_interpolation: Literal["linear", "quadratic", "cubic"] | None = None,
    map_levels_m: ListLike | None = None,
    map_error_length_m: float | None = None,
    offset_window_s: float | None = None,
    measurement_sigma_nt: float | Literal["auto"] | None = None,
    fogm_sigma_nt: float | Literal["auto"] | None = None,
    fogm_tau_s: float | Literal["auto"] | None = None,
    noise_column: str | None = None,
    start: Literal["auto", "fix", "alignment", "given"] | None = None,
    fix: ListLike | None = None,
    fix_velocity: ListLike | None = None,
    fix_sigma_m: float | None = None,
    fix_alt_sigma_m: float | None = None,
    fix_velocity_sigma_mps: float | None = None,
    vector: str | None = None,
    sensor_axis: ListLike | None = None,
    dead_zones: Literal["none", "polar", "polar_and_equatorial"] | None = None,
    ins_grade: Literal["magnav", "navigation", "tactical", "commercial"] | None = None,
    init_position_sigma_m: float | None = None,
    init_altitude_sigma_m: float | None = None,
    init_velocity_sigma_mps: float | None = None,
    init_attitude_sigma_deg: float | None = None,
    init_heading_sigma_deg: float | None = None,
    vrw_sigma: float | None = None,
    arw_sigma: float | None = None,
    baro_sigma_m: float | None = None,
    ha_sigma_m: float | None = None,
    a_hat_sigma_mps2: float | None = None,
    acc_sigma_mps2: float | None = None,
    gyro_sigma_radps: float | None = None,
    baro_tau_s: float | None = None,
    acc_tau_s: float | None = None,
    gyro_tau_s: float | None = None,
    iterations: int | None = None,
    tolerance_m: float | None = None,
    save_state: bool | None = None,
    gate_nis: float | None = None,
    discretisation: Literal["trapezoidal", "rectangular", "van_loan"] | None = None,
    gnss_lost_s: ListLike | None = None,
    gnss: ListLike | None = None,
    gnss_interval_s: float | None = None,
    gnss_sigma_m: float | None = None,
    gnss_alt_sigma_m: float | None = None,
    gnss_noise: bool | None = None,
    gnss_test: bool | None = None,
    gradient: ListLike | None = None,
    gradient_baseline_m: ListLike | None = None,
    gradient_sigma_nt: float | None = None,
    gradient_bias_sigma_nt: float | None = None,
    gradient_bias_tau_s: float | None = None,
    gradient_slope_sigma: float | Literal["auto"] | None = None,
    use_scalar: bool | None = None,
    vector_sigma_nt: float | None = None,
    vector_bias_sigma_nt: float | None = None,
    vector_bias_tau_s: float | None = None,
    vector_crustal_sigma_nt: float | None = None,
    vector_crustal_length_m: float | None = None,
    height: str | None = None,
    height_sigma_m: float | None = None,
    height_bias_sigma_m: float | None = None,
    height_bias_tau_s: float | None = None,
    map_sigma_nt: float | None = None,
    map_sigma_length_m: float | None = None,
    mag_latency_sigma_s: float | None = None,
    map_height_sigma_m: float | None = None,
    permanent_change_sigma_nt: float | None = None,
    permanent_change_tau_s: float | None = None,
    flat_over_m: float | None = None,
) -> Track:
    """The 18-state iterated extended Kalman filter.

    At each sample, the filter repeats the linearisation of the map at each new estimate until
    it finds the most probable state. If the position error is not small compared with the
    wavelengths of the map, the single linearisation of `ekf` is inaccurate, and `ekf` is
    overconfident. `iekf` tolerates position errors several times as large as `ekf` does, and
    takes little more time.

    A step that would make the state less probable is halved. With `iterations = 1`, the filter
    equals `ekf`.

    Parameters
    ----------
    tt_s : array_like
        Times of the samples, s, ascending, of shape (samples,).
    ins_lat_deg : array_like
        Latitude of the INS, degrees, of shape (samples,).
    ins_lon_deg : array_like
        Longitude of the INS, degrees, of shape (samples,).
    ins_alt_m : array_like
        Height of the INS above the WGS-84 ellipsoid, m, of shape (samples,).
    mag_nt : Magnetometers
        Measured field, nT, of shape (samples,); NaN where there is no measurement. A mapping
        holds several magnetometers under the names of their columns, such as `mag_1_c`
        (compensated) or `mag_1_uc`.
    map : Map
        Anomaly map, such as the result of `magline.maps.open`.
    ins_velocity_ned_mps : array_like, optional
        Velocity of the INS north, east and down, m/s, of shape (samples, 3). Default: derived
        from its positions.
    ins_force_ned_mps2 : array_like, optional
        Specific force of the INS north, east and down, m/s^2, of shape (samples, 3). Default:
        derived from its velocities.
    ins_attitude_deg : array_like, optional
        Roll, pitch and yaw of the INS, degrees, of shape (samples, 3). Default: level, along
        the course.
    columns : Mapping[str, Any], optional
        Further columns of the flight table under their names, in its units: those that keys
        name, and those that the stage uses if they are there, such as `diurnal` (nT), `year`,
        `doy`, `gnss_lat` (deg), `ins_aligned` (s), and the truth `lat` and `lon` (deg) and
        `alt` (m). A value is an array of shape (samples,), one number or text for all samples,
        or a pair of a matrix with one row per sample and the names of its columns.
    tuning : {"auto", "magnav"}, optional
        Source of unset parameters. `auto` estimates the noise of each line from the likelihood
        of its innovations, rejects outliers, and continues a map of known height to the flight
        heights. `magnav` uses the defaults of MagNav.jl, no gate, and the map at its own
        height. A key in the spec takes precedence over both. Default: `"auto"`.
    core_field : bool, optional
        Adds the core field to the predicted measurement. `false` means that the measurement is
        an anomaly. Default: `true`.
    remove_diurnal : bool, optional
        Subtracts the column `diurnal` from the measurement, so that the filter need not
        estimate the temporal variation. A sample with a NaN in `diurnal` has no measurement.
        Unset: true if the flight has a column `diurnal` that has not yet been subtracted from
        the measurement.
    decimal_year : float, optional
        Date of the core field as a decimal year. It replaces the flight's date. Unit: a.
        Allowed: 1900 to 2030. Unset: the flight's own date.
    map_interpolation : {"linear", "quadratic", "cubic"}, optional
        Interpolation of the map. The field above its sources is smooth, so spline interpolation
        is more accurate than bilinear interpolation. Unset: `cubic` with `tuning = "auto"`,
        else `linear`.
    map_levels_m : ListLike, optional
        Heights above the ellipsoid, ascending, to which the map is continued. Between these
        heights the map is interpolated linearly. Unit: m. Unset: with `tuning = "auto"` the map
        is continued to the flight heights, otherwise it is used at its own height.
    map_error_length_m : float, optional
        Correlation length of the map error, for a map with the column `error` (`map_grid`,
        `track_map`); typically the spacing of its survey lines. The correlated map error is
        converted to equivalent white noise, which is added to the measurement noise of each
        sample. The map error is interpolated at the position that an extended Kalman filter
        predicts. Unit: m. Allowed: above 0. Unset: the map is assumed to be exact; `tuning =
        "auto"` instead uses the map's column `error`, or the error of the map's interpolation,
        times an estimated factor.
    offset_window_s : float, optional
        Length of the window at the start of a line in which an offset is computed: the mean of
        measurement minus prediction. The offset is subtracted from all measurements of the line
        before filtering, because compensation leaves a constant undetermined. 0 subtracts
        nothing. Unit: s. Allowed: 0 or above. Default: `0.0`.
    measurement_sigma_nt : float | {"auto"}, optional
        Standard deviation of the white noise of a measurement. It includes the noise of the
        sensor, the map and the compensation. `"auto"` uses the noise of the calibration
        residual, from the column `mag_sigma`. Unit: nT. Allowed: above 0. Unset: the
        maximum-likelihood estimate with `tuning = "auto"`, otherwise 5.0.
    fogm_sigma_nt : float | {"auto"}, optional
        Standard deviation of the first-order Gauss-Markov process for the temporal variation
        and all other slow errors. `"auto"` uses the column `mag_fogm_sigma`. Unit: nT. Allowed:
        0 or above. Unset: the maximum-likelihood estimate with `tuning = "auto"`, otherwise
        3.0.
    fogm_tau_s : float | {"auto"}, optional
        Time constant of the temporal variation. `"auto"` uses the column `mag_fogm_tau`. Unit:
        s. Allowed: above 0. Unset: the maximum-likelihood estimate with `tuning = "auto"`,
        otherwise 600.0.
    noise_column : str, optional
        Column with the standard deviation of an additional error of each sample:
        `mag_aircraft_sigma` of an ensemble, or the predicted error of a network. The square of
        this standard deviation is added to the square of `measurement_sigma_nt`. A sample
        without a value in this column has no measurement. Requires a single magnetometer. Unit:
        nT. Unset: equal noise at all samples.
    start : {"auto", "fix", "alignment", "given"}, optional
        Source of the initial estimate. `fix` corrects the INS with a position fix. `alignment`
        propagates the `init_*` standard deviations from the alignment to the start of the line.
        `given` applies the `init_*` standard deviations at the start of the line; the defaults
        are valid only within minutes of the alignment, because an INS drifts. `auto` selects
        one of the three from the keys and columns. Default: `"auto"`.
    fix : ListLike, optional
        Columns with the latitude (deg), longitude (deg) and height (m) of the fix. The first
        values within 2 s of the line's start are used. If the columns have the role truth,
        white noise with the fix's standard deviations is added. The added noise of a line is
        the same in every run. Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has
        them, else `lat`, `lon` and `alt`.
    fix_velocity : ListLike, optional
        Columns of the fix's velocity components: north, east and down. Unit: m/s. Unset:
        `gnss_vn`, `gnss_ve` and `gnss_vd` for a fix from `gnss_*` columns, otherwise `vn`, `ve`
        and `vd`; without these columns, the velocity of the INS.
    fix_sigma_m : float, optional
        Standard deviation of the fix's position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `3.0`.
    fix_alt_sigma_m : float, optional
        Standard deviation of the fix's height. Unit: m. Allowed: above 0. Default: `5.0`.
    fix_velocity_sigma_mps : float, optional
        Standard deviation of each component of the fix's velocity. Unit: m/s. Allowed: above 0.
        Default: `0.1`.
    vector : str, optional
        Vector magnetometer that gives the direction of the field, such as `flux_a`. The noise
        of this magnetometer, and the aircraft field at its position, are neglected. Unset:
        equal noise in all attitudes.
    sensor_axis : ListLike, optional
        Axis of the scalar sensor in the frame of the vector magnetometer: nose, right, down.
        Allowed: finite. Default: `[1.0,0.0,0.0]`.
    dead_zones : {"none", "polar", "polar_and_equatorial"}, optional
        Dead zones of the scalar sensor: along its axis (`polar`), or also across its axis
        (`polar_and_equatorial`). The assumed noise is inversely proportional to the amplitude
        of the sensor's signal. At the largest amplitude, the noise is `measurement_sigma_nt`. A
        sample whose amplitude is below a tenth of the largest gives no measurement. Default:
        `"none"`.
    ins_grade : {"magnav", "navigation", "tactical", "commercial"}, optional
        Grade of the INS. The grade sets the INS keys (`init_*`, `*_sigma*` and `*_tau_s`) that
        are unset in the spec. `magnav` sets the defaults shown for these keys. `navigation` is
        a Honeywell HG9900, `tactical` a Honeywell HG1700, and `commercial` has micro-mechanical
        sensors [Lee 2019, Tables 9 and 10]. For these three grades, the position at alignment
        is exact (`init_position_sigma_m = 0`). Unset: in `navigate`, the flight's column
        `ins_grade` if present; otherwise `magnav`.
    init_position_sigma_m : float, optional
        Standard deviation of the initial horizontal position error along each axis. Unit: m.
        Allowed: 0 or above. Default: `3.0`.
    init_altitude_sigma_m : float, optional
        Standard deviation of the initial height error. Unit: m. Allowed: 0 or above. Default:
        `0.001`.
    init_velocity_sigma_mps : float, optional
        Standard deviation of the initial velocity error along each axis. Unit: m/s. Allowed: 0
        or above. Default: `0.01`.
    init_attitude_sigma_deg : float, optional
        Standard deviation of the initial tilt error about each axis. Unit: deg. Allowed: 0 or
        above. Default: `0.01`.
    init_heading_sigma_deg : float, optional
        Standard deviation of the initial yaw error, the tilt about the down axis. In practice,
        the yaw error exceeds the other tilt errors, because the INS finds north from the
        earth's rotation, a much weaker signal than gravity. Unit: deg. Allowed: 0 or above.
        Unset: the initial tilt error.
    vrw_sigma : float, optional
        Velocity random walk: square root of the spectral density of the accelerometer noise.
        Unit: m/s^1.5. Allowed: 0 or above. Default: `0.000238`.
    arw_sigma : float, optional
        Angular random walk: square root of the spectral density of the gyro noise. Unit:
        rad/s^0.5. Allowed: 0 or above. Default: `5.81e-7`.
    baro_sigma_m : float, optional
        Standard deviation of the barometer error. Unit: m. Allowed: 0 or above. Default: `1.0`.
    ha_sigma_m : float, optional
        Standard deviation of the initial error of the altitude in the barometer loop, which
        aids the INS height. Unit: m. Allowed: 0 or above. Default: `0.001`.
    a_hat_sigma_mps2 : float, optional
        Standard deviation of the initial error of the vertical acceleration in the barometer
        loop, which aids the INS height. Unit: m/s2. Allowed: 0 or above. Default: `0.01`.
    acc_sigma_mps2 : float, optional
        Standard deviation of the accelerometer bias. Unit: m/s2. Allowed: 0 or above. Default:
        `0.000245`.
    gyro_sigma_radps : float, optional
        Standard deviation of the gyro bias. Unit: rad/s. Allowed: 0 or above. Default:
        `7.27e-9`.
    baro_tau_s : float, optional
        Time constant of the barometer error. Unit: s. Allowed: above 0. Default: `3600.0`.
    acc_tau_s : float, optional
        Time constant of the accelerometer bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    gyro_tau_s : float, optional
        Time constant of the gyro bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    iterations : int, optional
        Maximum number of linearisations of the map per sample. Allowed: 1 to 1000. Default:
        `5`.
    tolerance_m : float, optional
        The iteration ends when the position changes by less than this distance. Unit: m.
        Allowed: above 0. Default: `0.1`.
    save_state : bool, optional
        Appends the state `x` and its covariance `p` (row-major). Default: `false`.
    gate_nis : float, optional
        Largest accepted NIS (squared innovation divided by its variance) of a measurement.
        Allowed: above 0. Unset: no gate; with `tuning = "auto"`, outliers are rejected before
        filtering.
    discretisation : {"trapezoidal", "rectangular", "van_loan"}, optional
        Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of
        first order as in MagNav.jl, and `van_loan` exact. Default: `"trapezoidal"`.
    gnss_lost_s : ListLike, optional
        Times at which GNSS is lost and recovered, in seconds from the first sample of the line.
        Before the loss and after the recovery, the GNSS position (columns `gnss`) aids the
        filter. With `[0.0, 600.0]`, GNSS is missing for the first ten minutes of the line. If
        the recovery time is after the end of the line, GNSS is never recovered. Unit: s.
        Allowed: 0 or above. Unset: GNSS is not used.
    gnss : ListLike, optional
        Columns with the GNSS latitude (deg), longitude (deg) and height above the ellipsoid
        (m). Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has them, else `lat`,
        `lon` and `alt`.
    gnss_interval_s : float, optional
        Time between successive GNSS positions. Unit: s. Allowed: above 0. Default: `1.0`.
    gnss_sigma_m : float, optional
        Standard deviation of the GNSS position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `2.0`.
    gnss_alt_sigma_m : float, optional
        Standard deviation of the GNSS height. Unit: m. Allowed: above 0. Default: `5.0`.
    gnss_noise : bool, optional
        Adds white noise to the GNSS positions, with the standard deviations `gnss_sigma_m` and
        `gnss_alt_sigma_m`. The added noise of a line is the same in every run. True positions
        have no error: without added noise, the filter appears more accurate than with real
        GNSS. Unset: true if the columns of `gnss` have the role `truth`.
    gnss_test : bool, optional
        Tests each GNSS position against the INS position and does not use rejected positions. A
        chi-square test of each position detects a jump at once. A cumulative sum over earlier
        positions detects a drift of 1 m/s after about 10 s. The test then also rejects the
        positions since the start of the drift. Positions are accepted again after ten
        consecutive positions agree with the INS. The column `gnss_update` (`used`, `rejected`
        or `none`) is appended even if this key is false. Default: `true`.
    gradient : ListLike, optional
        Two compensated scalar magnetometers. The difference between their readings, first minus
        second, measures the slope of the map along the baseline between them. The temporal
        variation and all other common errors cancel in this difference. This key cannot be
        combined with `map_interpolation = "linear"`, because the slope of a bilinear map has
        steps. Unit: nT. Unset: the difference is not used.
    gradient_baseline_m : ListLike, optional
        Vector from the second magnetometer of `gradient` to the first, in the body frame (nose,
        right, down). The INS attitude rotates this vector to the navigation frame. The
        measurement model includes the estimated error of the INS attitude. Unit: m. Allowed:
        finite. Unset: required with `gradient`.
    gradient_sigma_nt : float, optional
        Standard deviation of the white noise in the difference between the two magnetometers'
        readings. Unit: nT. Allowed: above 0. Default: `0.1`.
    gradient_bias_sigma_nt : float, optional
        Standard deviation of the slowly varying error in the difference between the two
        magnetometers' readings. Such an error is likely, because each calibration leaves a
        constant undetermined. Unit: nT. Allowed: 0 or above. Default: `1.0`.
    gradient_bias_tau_s : float, optional
        Time constant of the slowly varying error in the difference between the two
        magnetometers' readings. Unit: s. Allowed: above 0. Default: `3600.0`.
    gradient_slope_sigma : float | {"auto"}, optional
        Standard deviation of the error in the map's slope along the baseline. The error of the
        predicted difference is this error times the length of the baseline. The error is
        correlated along the track, over the same length as the map's anomalies. `"auto"` uses
        the maximum-likelihood value from the innovations of the difference. A large value can
        reveal a map made from widely spaced lines. A map at one height without `map_levels_m`
        has no vertical slope. The prediction then has an additional error: the height
        difference between the magnetometers times the rms slope. Unit: nT/m. Allowed: 0 or
        above. Default: `auto`.
    use_scalar : bool, optional
        Uses the scalar measurement `mag` in the measurement update. `false` ignores `mag`, for
        example in a magnetic storm, and requires the difference (`gradient`) or the vector
        (`vector_sigma_nt`). Default: `true`.
    vector_sigma_nt : float, optional
        Standard deviation of the white noise of each component of `vector`. If set, the
        components are used as measurements. They depend on the total field and on the attitude,
        but not on a rotation about the field direction. This key requires `core_field = true`
        and a calibrated vector magnetometer. Unit: nT. Allowed: above 0. Unset: the vector is
        not used as a measurement.
    vector_bias_sigma_nt : float, optional
        Standard deviation of the bias of each component of `vector`. In a field of 50,000 nT, a
        bias of 50 nT corresponds to an attitude error of 0.06°. Unit: nT. Allowed: 0 or above.
        Default: `50.0`.
    vector_bias_tau_s : float, optional
        Time constant of the bias of each component of `vector`. Unit: s. Allowed: above 0.
        Default: `3600.0`.
    vector_crustal_sigma_nt : float, optional
        Standard deviation, per component, of the crustal field that a map of the scalar anomaly
        leaves undetermined. A typical value is the standard deviation of the anomaly. Unit: nT.
        Allowed: 0 or above. Default: `50.0`.
    vector_crustal_length_m : float, optional
        Correlation length of the crustal field that `vector_crustal_sigma_nt` describes. A
        typical value is the height above the sources. Unit: m. Allowed: above 0. Default:
        `1000.0`.
    height : str, optional
        Column of measured heights above the ellipsoid, such as `baro`, from a barometer that
        does not already aid the INS. Unit: m. Unset: the height of the INS, aided by its
        barometer, is used.
    height_sigma_m : float, optional
        Standard deviation of the white noise of the measured height. Unit: m. Allowed: above 0.
        Default: `3.0`.
    height_bias_sigma_m : float, optional
        Standard deviation of the slowly varying error of the measured height, caused by the
        weather and the geoid. Unit: m. Allowed: 0 or above. Default: `30.0`.
    height_bias_tau_s : float, optional
        Time constant of the slowly varying error of the measured height. Unit: s. Allowed:
        above 0. Default: `3600.0`.
    map_sigma_nt : float, optional
        Standard deviation of the map error. If set, the filter estimates the map error as a
        state that is correlated along the track. Unit: nT. Allowed: 0 or above. Unset: the map
        error is not estimated.
    map_sigma_length_m : float, optional
        Distance over which the autocorrelation of the map error falls to 1/e. Unit: m. Allowed:
        above 0. Default: `500.0`.
    mag_latency_sigma_s : float, optional
        Prior standard deviation of the lag of the magnetometer's time stamps. If set, the
        filter estimates the lag as a state that is constant along the line. A sample with time
        stamp `t` was measured at `t` minus the lag. The lag may be negative. 0 omits this
        state. The columns `mag_latency` and `mag_latency_sigma` are appended. This key is
        available in `ekf`, `iekf` and `ukf`. Unit: s. Allowed: 0 or above. Unset: 1.0 with
        `tuning = "auto"` if a state for the lag clearly increases the likelihood, otherwise 0
        (exact time stamps).
    map_height_sigma_m : float, optional
        Prior standard deviation of a height bias: the true height of the aircraft minus its
        assumed height on the map. Possible causes are a constant error of the barometer, a
        missing geoid height, and a wrong map height. If set, the filter estimates the bias as a
        state that is constant along the line. The bias changes only the predicted total field,
        not `alt`. The heights to which the map is continued must include the true height of the
        aircraft. With `tuning = "auto"`, the map is continued to twice this standard deviation
        below and above the line. Otherwise, set `map_levels_m`. 0 omits this state. The columns
        `map_height_bias` and `map_height_bias_sigma` are appended. This key is available in
        `ekf`, `iekf` and `ukf`. Unit: m. Allowed: 0 or above. Unset: 50 with `tuning = "auto"`
        if a bias clearly increases the likelihood, otherwise 0 (exact height). To find a bias,
        `auto` continues the map up to 200 m below and above the line, unless `map_levels_m` is
        set.
    permanent_change_sigma_nt : float, optional
        Standard deviation of the change in the aircraft's permanent field since calibration,
        per component (nose, right, down). The filter estimates the three components as
        additional states. The attitude and the core field determine the effect of these
        components on the total field. A fourth state is a constant offset with a standard
        deviation of 100 nT. 0 omits these states. This key requires `core_field = true`, and is
        available in `ekf`, `iekf` and `ukf`. Unit: nT. Allowed: 0 or above. Unset: the
        maximum-likelihood estimate with `tuning = "auto"` if these states clearly increase the
        likelihood, otherwise 0.
    permanent_change_tau_s : float, optional
        Time constant of the change in the permanent field. Unit: s. Allowed: above 0. Unset:
        the maximum-likelihood estimate with `tuning = "auto"`, otherwise infinite, so that the
        change is constant along the line.
    flat_over_m : float, optional
        A sample corrects the position only if the ratio of its measurement noise (standard
        deviation) to the map's horizontal slope is at most this value. At a larger ratio, the
        map is too flat to observe the position. The sample is then `flat`: it corrects only the
        temporal variation and the map error. The column `map_slope` is appended. Unit: m.
        Allowed: above 0. Unset: all samples correct the position.

    Returns
    -------
    Track
        Estimate at each sample, innovations, warnings and notes.

    Raises
    ------
    SpecError
        If a key is unknown, has an invalid value, or has no effect.
    DataError
        If the line cannot be filtered, such as an INS with a NaN or a line off the map.
    ValueError
        If the shapes of the arrays differ.

    References
    ----------
    Jazwinski 1970, chapter 8; Bell & Cathey 1993, with a line search added.

    Examples
    --------
    >>> import numpy as np
    >>> from magline import filters, maps
    >>> lat, lon = np.linspace(45.0, 45.2, 201), np.linspace(-76.1, -75.9, 201)
    >>> hills = 60.0 * np.sin(400.0 * lat[:, None]) + 50.0 * np.cos(500.0 * (lat[:, None] + lon))
    >>> field = maps.Map(lon, lat, hills, np.full(hills.shape, 300.0), 4326, "deg")
    >>> t = np.arange(100.0)  # northward over the nodes of a column; the INS is 11 m too far north
    >>> ins = t, lat[50:150] + 1e-4, np.full(100, lon[100]), np.full(100, 300.0)
    >>> start = {"start": "given", "init_position_sigma_m": 20.0}
    >>> track = filters.iekf(*ins, hills[50:150, 100], field, core_field=False, **start)
    >>> bool(abs(track.lat_deg[-1] - lat[149]) < 5e-5)
    True
    """
    return navigate_line("iekf", locals())


def ukf(
    tt_s: ArrayLike,
    ins_lat_deg: ArrayLike,
    ins_lon_deg: ArrayLike,
    ins_alt_m: ArrayLike,
    mag_nt: Magnetometers,
    map: Map,
    *,
    ins_velocity_ned_mps: ArrayLike | None = None,
    ins_force_ned_mps2: ArrayLike | None = None,
    ins_attitude_deg: ArrayLike | None = None,
    columns: Mapping[str, Any] | None = None,
    tuning: Literal["auto", "magnav"] | None = None,
    core_field: bool | None = None,
    remove_diurnal: bool | None = None,
    decimal_year: float | None = None,
    map_interpolation: Literal["linear", "quadratic", "cubic"] | None = None,
    map_levels_m: ListLike | None = None,
    map_error_length_m: float | None = None,
    offset_window_s: float | None = None,
    measurement_sigma_nt: float | Literal["auto"] | None = None,
    fogm_sigma_nt: float | Literal["auto"] | None = None,
    fogm_tau_s: float | Literal["auto"] | None = None,
    noise_column: str | None = None,
    start: Literal["auto", "fix", "alignment", "given"] | None = None,
    fix: ListLike | None = None,
    fix_velocity: ListLike | None = None,
    fix_sigma_m: float | None = None,
    fix_alt_sigma_m: float | None = None,
    fix_velocity_sigma_mps: float | None = None,
    vector: str | None = None,
    sensor_axis: ListLike | None = None,
    dead_zones: Literal["none", "polar", "polar_and_equatorial"] | None = None,
    ins_grade: Literal["magnav", "navigation", "tactical", "commercial"] | None = None,
    init_position_sigma_m: float | None = None,
    init_altitude_sigma_m: float | None = None,
    init_velocity_sigma_mps: float | None = None,
    init_attitude_sigma_deg: float | None = None,
    init_heading_sigma_deg: float | None = None,
    vrw_sigma: float | None = None,
    arw_sigma: float | None = None,
    baro_sigma_m: float | None = None,
    ha_sigma_m: float | None = None,
    a_hat_sigma_mps2: float | None = None,
    acc_sigma_mps2: float | None = None,
    gyro_sigma_radps: float | None = None,
    baro_tau_s: float | None = None,
    acc_tau_s: float | None = None,
    gyro_tau_s: float | None = None,
    alpha: float | None = None,
    beta: float | None = None,
    kappa: float | None = None,
    gate_nis: float | None = None,
    discretisation: Literal["trapezoidal", "rectangular", "van_loan"] | None = None,
    save_state: bool | None = None,
    gnss_lost_s: ListLike | None = None,
    gnss: ListLike | None = None,
    gnss_interval_s: float | None = None,
    gnss_sigma_m: float | None = None,
    gnss_alt_sigma_m: float | None = None,
    gnss_noise: bool | None = None,
    gnss_test: bool | None = None,
    gradient: ListLike | None = None,
    gradient_baseline_m: ListLike | None = None,
    gradient_sigma_nt: float | None = None,
    gradient_bias_sigma_nt: float | None = None,
    gradient_bias_tau_s: float | None = None,
    gradient_slope_sigma: float | Literal["auto"] | None = None,
    use_scalar: bool | None = None,
    vector_sigma_nt: float | None = None,
    vector_bias_sigma_nt: float | None = None,
    vector_bias_tau_s: float | None = None,
    vector_crustal_sigma_nt: float | None = None,
    vector_crustal_length_m: float | None = None,
    height: str | None = None,
    height_sigma_m: float | None = None,
    height_bias_sigma_m: float | None = None,
    height_bias_tau_s: float | None = None,
    map_sigma_nt: float | None = None,
    map_sigma_length_m: float | None = None,
    mag_latency_sigma_s: float | None = None,
    map_height_sigma_m: float | None = None,
    permanent_change_sigma_nt: float | None = None,
    permanent_change_tau_s: float | None = None,
    flat_over_m: float | None = None,
) -> Track:
    """The unscented Kalman filter with the states of `ekf`.

    Instead of linearising the map at the estimated position, the filter fits a linear function
    to the map over the position uncertainty. The fit uses the map values at seven sigma points:
    a central one and six outer ones. If the map is linear over the position uncertainty, the
    filter equals `ekf`. Otherwise it treats the nonlinearity of the map as noise. Use `ukf` if
    the position uncertainty exceeds the node spacing of the map.

    If an outer sigma point is off the map, the map is linearised at the estimated position.
    `sd_nonlinear` is the part of the innovation's standard deviation due to the nonlinearity of
    the map; it is NaN where it is not computed.

    Parameters
    ----------
    tt_s : array_like
        Times of the samples, s, ascending, of shape (samples,).
    ins_lat_deg : array_like
        Latitude of the INS, degrees, of shape (samples,).
    ins_lon_deg : array_like
        Longitude of the INS, degrees, of shape (samples,).
    ins_alt_m : array_like
        Height of the INS above the WGS-84 ellipsoid, m, of shape (samples,).
    mag_nt : Magnetometers
        Measured field, nT, of shape (samples,); NaN where there is no measurement. A mapping
        holds several magnetometers under the names of their columns, such as `mag_1_c`
        (compensated) or `mag_1_uc`.
    map : Map
        Anomaly map, such as the result of `magline.maps.open`.
    ins_velocity_ned_mps : array_like, optional
        Velocity of the INS north, east and down, m/s, of shape (samples, 3). Default: derived
        from its positions.
    ins_force_ned_mps2 : array_like, optional
        Specific force of the INS north, east and down, m/s^2, of shape (samples, 3). Default:
        derived from its velocities.
    ins_attitude_deg : array_like, optional
        Roll, pitch and yaw of the INS, degrees, of shape (samples, 3). Default: level, along
        the course.
    columns : Mapping[str, Any], optional
        Further columns of the flight table under their names, in its units: those that keys
        name, and those that the stage uses if they are there, such as `diurnal` (nT), `year`,
        `doy`, `gnss_lat` (deg), `ins_aligned` (s), and the truth `lat` and `lon` (deg) and
        `alt` (m). A value is an array of shape (samples,), one number or text for all samples,
        or a pair of a matrix with one row per sample and the names of its columns.
    tuning : {"auto", "magnav"}, optional
        Source of unset parameters. `auto` estimates the noise of each line from the likelihood
        of its innovations, rejects outliers, and continues a map of known height to the flight
        heights. `magnav` uses the defaults of MagNav.jl, no gate, and the map at its own
        height. A key in the spec takes precedence over both. Default: `"auto"`.
    core_field : bool, optional
        Adds the core field to the predicted measurement. `false` means that the measurement is
        an anomaly. Default: `true`.
    remove_diurnal : bool, optional
        Subtracts the column `diurnal` from the measurement, so that the filter need not
        estimate the temporal variation. A sample with a NaN in `diurnal` has no measurement.
        Unset: true if the flight has a column `diurnal` that has not yet been subtracted from
        the measurement.
    decimal_year : float, optional
        Date of the core field as a decimal year. It replaces the flight's date. Unit: a.
        Allowed: 1900 to 2030. Unset: the flight's own date.
    map_interpolation : {"linear", "quadratic", "cubic"}, optional
        Interpolation of the map. The field above its sources is smooth, so spline interpolation
        is more accurate than bilinear interpolation. Unset: `cubic` with `tuning = "auto"`,
        else `linear`.
    map_levels_m : ListLike, optional
        Heights above the ellipsoid, ascending, to which the map is continued. Between these
        heights the map is interpolated linearly. Unit: m. Unset: with `tuning = "auto"` the map
        is continued to the flight heights, otherwise it is used at its own height.
    map_error_length_m : float, optional
        Correlation length of the map error, for a map with the column `error` (`map_grid`,
        `track_map`); typically the spacing of its survey lines. The correlated map error is
        converted to equivalent white noise, which is added to the measurement noise of each
        sample. The map error is interpolated at the position that an extended Kalman filter
        predicts. Unit: m. Allowed: above 0. Unset: the map is assumed to be exact; `tuning =
        "auto"` instead uses the map's column `error`, or the error of the map's interpolation,
        times an estimated factor.
    offset_window_s : float, optional
        Length of the window at the start of a line in which an offset is computed: the mean of
        measurement minus prediction. The offset is subtracted from all measurements of the line
        before filtering, because compensation leaves a constant undetermined. 0 subtracts
        nothing. Unit: s. Allowed: 0 or above. Default: `0.0`.
    measurement_sigma_nt : float | {"auto"}, optional
        Standard deviation of the white noise of a measurement. It includes the noise of the
        sensor, the map and the compensation. `"auto"` uses the noise of the calibration
        residual, from the column `mag_sigma`. Unit: nT. Allowed: above 0. Unset: the
        maximum-likelihood estimate with `tuning = "auto"`, otherwise 5.0.
    fogm_sigma_nt : float | {"auto"}, optional
        Standard deviation of the first-order Gauss-Markov process for the temporal variation
        and all other slow errors. `"auto"` uses the column `mag_fogm_sigma`. Unit: nT. Allowed:
        0 or above. Unset: the maximum-likelihood estimate with `tuning = "auto"`, otherwise
        3.0.
    fogm_tau_s : float | {"auto"}, optional
        Time constant of the temporal variation. `"auto"` uses the column `mag_fogm_tau`. Unit:
        s. Allowed: above 0. Unset: the maximum-likelihood estimate with `tuning = "auto"`,
        otherwise 600.0.
    noise_column : str, optional
        Column with the standard deviation of an additional error of each sample:
        `mag_aircraft_sigma` of an ensemble, or the predicted error of a network. The square of
        this standard deviation is added to the square of `measurement_sigma_nt`. A sample
        without a value in this column has no measurement. Requires a single magnetometer. Unit:
        nT. Unset: equal noise at all samples.
    start : {"auto", "fix", "alignment", "given"}, optional
        Source of the initial estimate. `fix` corrects the INS with a position fix. `alignment`
        propagates the `init_*` standard deviations from the alignment to the start of the line.
        `given` applies the `init_*` standard deviations at the start of the line; the defaults
        are valid only within minutes of the alignment, because an INS drifts. `auto` selects
        one of the three from the keys and columns. Default: `"auto"`.
    fix : ListLike, optional
        Columns with the latitude (deg), longitude (deg) and height (m) of the fix. The first
        values within 2 s of the line's start are used. If the columns have the role truth,
        white noise with the fix's standard deviations is added. The added noise of a line is
        the same in every run. Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has
        them, else `lat`, `lon` and `alt`.
    fix_velocity : ListLike, optional
        Columns of the fix's velocity components: north, east and down. Unit: m/s. Unset:
        `gnss_vn`, `gnss_ve` and `gnss_vd` for a fix from `gnss_*` columns, otherwise `vn`, `ve`
        and `vd`; without these columns, the velocity of the INS.
    fix_sigma_m : float, optional
        Standard deviation of the fix's position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `3.0`.
    fix_alt_sigma_m : float, optional
        Standard deviation of the fix's height. Unit: m. Allowed: above 0. Default: `5.0`.
    fix_velocity_sigma_mps : float, optional
        Standard deviation of each component of the fix's velocity. Unit: m/s. Allowed: above 0.
        Default: `0.1`.
    vector : str, optional
        Vector magnetometer that gives the direction of the field, such as `flux_a`. The noise
        of this magnetometer, and the aircraft field at its position, are neglected. Unset:
        equal noise in all attitudes.
    sensor_axis : ListLike, optional
        Axis of the scalar sensor in the frame of the vector magnetometer: nose, right, down.
        Allowed: finite. Default: `[1.0,0.0,0.0]`.
    dead_zones : {"none", "polar", "polar_and_equatorial"}, optional
        Dead zones of the scalar sensor: along its axis (`polar`), or also across its axis
        (`polar_and_equatorial`). The assumed noise is inversely proportional to the amplitude
        of the sensor's signal. At the largest amplitude, the noise is `measurement_sigma_nt`. A
        sample whose amplitude is below a tenth of the largest gives no measurement. Default:
        `"none"`.
    ins_grade : {"magnav", "navigation", "tactical", "commercial"}, optional
        Grade of the INS. The grade sets the INS keys (`init_*`, `*_sigma*` and `*_tau_s`) that
        are unset in the spec. `magnav` sets the defaults shown for these keys. `navigation` is
        a Honeywell HG9900, `tactical` a Honeywell HG1700, and `commercial` has micro-mechanical
        sensors [Lee 2019, Tables 9 and 10]. For these three grades, the position at alignment
        is exact (`init_position_sigma_m = 0`). Unset: in `navigate`, the flight's column
        `ins_grade` if present; otherwise `magnav`.
    init_position_sigma_m : float, optional
        Standard deviation of the initial horizontal position error along each axis. Unit: m.
        Allowed: 0 or above. Default: `3.0`.
    init_altitude_sigma_m : float, optional
        Standard deviation of the initial height error. Unit: m. Allowed: 0 or above. Default:
        `0.001`.
    init_velocity_sigma_mps : float, optional
        Standard deviation of the initial velocity error along each axis. Unit: m/s. Allowed: 0
        or above. Default: `0.01`.
    init_attitude_sigma_deg : float, optional
        Standard deviation of the initial tilt error about each axis. Unit: deg. Allowed: 0 or
        above. Default: `0.01`.
    init_heading_sigma_deg : float, optional
        Standard deviation of the initial yaw error, the tilt about the down axis. In practice,
        the yaw error exceeds the other tilt errors, because the INS finds north from the
        earth's rotation, a much weaker signal than gravity. Unit: deg. Allowed: 0 or above.
        Unset: the initial tilt error.
    vrw_sigma : float, optional
        Velocity random walk: square root of the spectral density of the accelerometer noise.
        Unit: m/s^1.5. Allowed: 0 or above. Default: `0.000238`.
    arw_sigma : float, optional
        Angular random walk: square root of the spectral density of the gyro noise. Unit:
        rad/s^0.5. Allowed: 0 or above. Default: `5.81e-7`.
    baro_sigma_m : float, optional
        Standard deviation of the barometer error. Unit: m. Allowed: 0 or above. Default: `1.0`.
    ha_sigma_m : float, optional
        Standard deviation of the initial error of the altitude in the barometer loop, which
        aids the INS height. Unit: m. Allowed: 0 or above. Default: `0.001`.
    a_hat_sigma_mps2 : float, optional
        Standard deviation of the initial error of the vertical acceleration in the barometer
        loop, which aids the INS height. Unit: m/s2. Allowed: 0 or above. Default: `0.01`.
    acc_sigma_mps2 : float, optional
        Standard deviation of the accelerometer bias. Unit: m/s2. Allowed: 0 or above. Default:
        `0.000245`.
    gyro_sigma_radps : float, optional
        Standard deviation of the gyro bias. Unit: rad/s. Allowed: 0 or above. Default:
        `7.27e-9`.
    baro_tau_s : float, optional
        Time constant of the barometer error. Unit: s. Allowed: above 0. Default: `3600.0`.
    acc_tau_s : float, optional
        Time constant of the accelerometer bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    gyro_tau_s : float, optional
        Time constant of the gyro bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    alpha : float, optional
        Scale factor on the distance of the outer sigma points from the central one. Allowed:
        above 0. Default: `1.0`.
    beta : float, optional
        Parameter in the weight of the central sigma point: the weight in the covariance exceeds
        the weight in the mean by 1 - alpha² + beta. The minimum of beta is -alpha² kappa/3. The
        filter computes the variance due to the nonlinearity of the field. Averaged over
        directions, the computed variance is (5 + 4 beta)/8 of the true variance. With a beta of
        2, the filter is therefore cautious. Allowed: finite. Default: `2.0`.
    kappa : float, optional
        Parameter in the distance of the outer sigma points from the central one, which is alpha
        sqrt(3 + kappa) standard deviations. `kappa` must be above -3. With 0, the gain is exact
        to the fourth moment of a normal distribution. Allowed: finite. Default: `0.0`.
    gate_nis : float, optional
        Largest accepted NIS (squared innovation divided by its variance) of a measurement.
        Allowed: above 0. Unset: no gate; with `tuning = "auto"`, outliers are rejected before
        filtering.
    discretisation : {"trapezoidal", "rectangular", "van_loan"}, optional
        Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of
        first order as in MagNav.jl, and `van_loan` exact. Default: `"trapezoidal"`.
    save_state : bool, optional
        Appends the state `x` and its covariance `p` (row-major). Default: `false`.
    gnss_lost_s : ListLike, optional
        Times at which GNSS is lost and recovered, in seconds from the first sample of the line.
        Before the loss and after the recovery, the GNSS position (columns `gnss`) aids the
        filter. With `[0.0, 600.0]`, GNSS is missing for the first ten minutes of the line. If
        the recovery time is after the end of the line, GNSS is never recovered. Unit: s.
        Allowed: 0 or above. Unset: GNSS is not used.
    gnss : ListLike, optional
        Columns with the GNSS latitude (deg), longitude (deg) and height above the ellipsoid
        (m). Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has them, else `lat`,
        `lon` and `alt`.
    gnss_interval_s : float, optional
        Time between successive GNSS positions. Unit: s. Allowed: above 0. Default: `1.0`.
    gnss_sigma_m : float, optional
        Standard deviation of the GNSS position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `2.0`.
    gnss_alt_sigma_m : float, optional
        Standard deviation of the GNSS height. Unit: m. Allowed: above 0. Default: `5.0`.
    gnss_noise : bool, optional
        Adds white noise to the GNSS positions, with the standard deviations `gnss_sigma_m` and
        `gnss_alt_sigma_m`. The added noise of a line is the same in every run. True positions
        have no error: without added noise, the filter appears more accurate than with real
        GNSS. Unset: true if the columns of `gnss` have the role `truth`.
    gnss_test : bool, optional
        Tests each GNSS position against the INS position and does not use rejected positions. A
        chi-square test of each position detects a jump at once. A cumulative sum over earlier
        positions detects a drift of 1 m/s after about 10 s. The test then also rejects the
        positions since the start of the drift. Positions are accepted again after ten
        consecutive positions agree with the INS. The column `gnss_update` (`used`, `rejected`
        or `none`) is appended even if this key is false. Default: `true`.
    gradient : ListLike, optional
        Two compensated scalar magnetometers. The difference between their readings, first minus
        second, measures the slope of the map along the baseline between them. The temporal
        variation and all other common errors cancel in this difference. This key cannot be
        combined with `map_interpolation = "linear"`, because the slope of a bilinear map has
        steps. Unit: nT. Unset: the difference is not used.
    gradient_baseline_m : ListLike, optional
        Vector from the second magnetometer of `gradient` to the first, in the body frame (nose,
        right, down). The INS attitude rotates this vector to the navigation frame. The
        measurement model includes the estimated error of the INS attitude. Unit: m. Allowed:
        finite. Unset: required with `gradient`.
    gradient_sigma_nt : float, optional
        Standard deviation of the white noise in the difference between the two magnetometers'
        readings. Unit: nT. Allowed: above 0. Default: `0.1`.
    gradient_bias_sigma_nt : float, optional
        Standard deviation of the slowly varying error in the difference between the two
        magnetometers' readings. Such an error is likely, because each calibration leaves a
        constant undetermined. Unit: nT. Allowed: 0 or above. Default: `1.0`.
    gradient_bias_tau_s : float, optional
        Time constant of the slowly varying error in the difference between the two
        magnetometers' readings. Unit: s. Allowed: above 0. Default: `3600.0`.
    gradient_slope_sigma : float | {"auto"}, optional
        Standard deviation of the error in the map's slope along the baseline. The error of the
        predicted difference is this error times the length of the baseline. The error is
        correlated along the track, over the same length as the map's anomalies. `"auto"` uses
        the maximum-likelihood value from the innovations of the difference. A large value can
        reveal a map made from widely spaced lines. A map at one height without `map_levels_m`
        has no vertical slope. The prediction then has an additional error: the height
        difference between the magnetometers times the rms slope. Unit: nT/m. Allowed: 0 or
        above. Default: `auto`.
    use_scalar : bool, optional
        Uses the scalar measurement `mag` in the measurement update. `false` ignores `mag`, for
        example in a magnetic storm, and requires the difference (`gradient`) or the vector
        (`vector_sigma_nt`). Default: `true`.
    vector_sigma_nt : float, optional
        Standard deviation of the white noise of each component of `vector`. If set, the
        components are used as measurements. They depend on the total field and on the attitude,
        but not on a rotation about the field direction. This key requires `core_field = true`
        and a calibrated vector magnetometer. Unit: nT. Allowed: above 0. Unset: the vector is
        not used as a measurement.
    vector_bias_sigma_nt : float, optional
        Standard deviation of the bias of each component of `vector`. In a field of 50,000 nT, a
        bias of 50 nT corresponds to an attitude error of 0.06°. Unit: nT. Allowed: 0 or above.
        Default: `50.0`.
    vector_bias_tau_s : float, optional
        Time constant of the bias of each component of `vector`. Unit: s. Allowed: above 0.
        Default: `3600.0`.
    vector_crustal_sigma_nt : float, optional
        Standard deviation, per component, of the crustal field that a map of the scalar anomaly
        leaves undetermined. A typical value is the standard deviation of the anomaly. Unit: nT.
        Allowed: 0 or above. Default: `50.0`.
    vector_crustal_length_m : float, optional
        Correlation length of the crustal field that `vector_crustal_sigma_nt` describes. A
        typical value is the height above the sources. Unit: m. Allowed: above 0. Default:
        `1000.0`.
    height : str, optional
        Column of measured heights above the ellipsoid, such as `baro`, from a barometer that
        does not already aid the INS. Unit: m. Unset: the height of the INS, aided by its
        barometer, is used.
    height_sigma_m : float, optional
        Standard deviation of the white noise of the measured height. Unit: m. Allowed: above 0.
        Default: `3.0`.
    height_bias_sigma_m : float, optional
        Standard deviation of the slowly varying error of the measured height, caused by the
        weather and the geoid. Unit: m. Allowed: 0 or above. Default: `30.0`.
    height_bias_tau_s : float, optional
        Time constant of the slowly varying error of the measured height. Unit: s. Allowed:
        above 0. Default: `3600.0`.
    map_sigma_nt : float, optional
        Standard deviation of the map error. If set, the filter estimates the map error as a
        state that is correlated along the track. Unit: nT. Allowed: 0 or above. Unset: the map
        error is not estimated.
    map_sigma_length_m : float, optional
        Distance over which the autocorrelation of the map error falls to 1/e. Unit: m. Allowed:
        above 0. Default: `500.0`.
    mag_latency_sigma_s : float, optional
        Prior standard deviation of the lag of the magnetometer's time stamps. If set, the
        filter estimates the lag as a state that is constant along the line. A sample with time
        stamp `t` was measured at `t` minus the lag. The lag may be negative. 0 omits this
        state. The columns `mag_latency` and `mag_latency_sigma` are appended. This key is
        available in `ekf`, `iekf` and `ukf`. Unit: s. Allowed: 0 or above. Unset: 1.0 with
        `tuning = "auto"` if a state for the lag clearly increases the likelihood, otherwise 0
        (exact time stamps).
    map_height_sigma_m : float, optional
        Prior standard deviation of a height bias: the true height of the aircraft minus its
        assumed height on the map. Possible causes are a constant error of the barometer, a
        missing geoid height, and a wrong map height. If set, the filter estimates the bias as a
        state that is constant along the line. The bias changes only the predicted total field,
        not `alt`. The heights to which the map is continued must include the true height of the
        aircraft. With `tuning = "auto"`, the map is continued to twice this standard deviation
        below and above the line. Otherwise, set `map_levels_m`. 0 omits this state. The columns
        `map_height_bias` and `map_height_bias_sigma` are appended. This key is available in
        `ekf`, `iekf` and `ukf`. Unit: m. Allowed: 0 or above. Unset: 50 with `tuning = "auto"`
        if a bias clearly increases the likelihood, otherwise 0 (exact height). To find a bias,
        `auto` continues the map up to 200 m below and above the line, unless `map_levels_m` is
        set.
    permanent_change_sigma_nt : float, optional
        Standard deviation of the change in the aircraft's permanent field since calibration,
        per component (nose, right, down). The filter estimates the three components as
        additional states. The attitude and the core field determine the effect of these
        components on the total field. A fourth state is a constant offset with a standard
        deviation of 100 nT. 0 omits these states. This key requires `core_field = true`, and is
        available in `ekf`, `iekf` and `ukf`. Unit: nT. Allowed: 0 or above. Unset: the
        maximum-likelihood estimate with `tuning = "auto"` if these states clearly increase the
        likelihood, otherwise 0.
    permanent_change_tau_s : float, optional
        Time constant of the change in the permanent field. Unit: s. Allowed: above 0. Unset:
        the maximum-likelihood estimate with `tuning = "auto"`, otherwise infinite, so that the
        change is constant along the line.
    flat_over_m : float, optional
        A sample corrects the position only if the ratio of its measurement noise (standard
        deviation) to the map's horizontal slope is at most this value. At a larger ratio, the
        map is too flat to observe the position. The sample is then `flat`: it corrects only the
        temporal variation and the map error. The column `map_slope` is appended. Unit: m.
        Allowed: above 0. Unset: all samples correct the position.

    Returns
    -------
    Track
        Estimate at each sample, innovations, warnings and notes.

    Raises
    ------
    SpecError
        If a key is unknown, has an invalid value, or has no effect.
    DataError
        If the line cannot be filtered, such as an INS with a NaN or a line off the map.
    ValueError
        If the shapes of the arrays differ.

    References
    ----------
    Julier & Uhlmann 2004; Morelande & Ristic 2006, for a measurement that is nonlinear in the
    position only.

    Examples
    --------
    >>> import numpy as np
    >>> from magline import filters, maps
    >>> lat, lon = np.linspace(45.0, 45.2, 201), np.linspace(-76.1, -75.9, 201)
    >>> hills = 60.0 * np.sin(400.0 * lat[:, None]) + 50.0 * np.cos(500.0 * (lat[:, None] + lon))
    >>> field = maps.Map(lon, lat, hills, np.full(hills.shape, 300.0), 4326, "deg")
    >>> t = np.arange(100.0)  # northward over the nodes of a column; the INS is 11 m too far north
    >>> ins = t, lat[50:150] + 1e-4, np.full(100, lon[100]), np.full(100, 300.0)
    >>> start = {"start": "given", "init_position_sigma_m": 20.0}
    >>> track = filters.ukf(*ins, hills[50:150, 100], field, core_field=False, **start)
    >>> bool(abs(track.lat_deg[-1] - lat[149]) < 5e-5)
    True
    """
    return navigate_line("ukf", locals())


def ekf_adaptive(
    tt_s: ArrayLike,
    ins_lat_deg: ArrayLike,
    ins_lon_deg: ArrayLike,
    ins_alt_m: ArrayLike,
    mag_nt: Magnetometers,
    map: Map,
    *,
    ins_velocity_ned_mps: ArrayLike | None = None,
    ins_force_ned_mps2: ArrayLike | None = None,
    ins_attitude_deg: ArrayLike | None = None,
    columns: Mapping[str, Any] | None = None,
    tuning: Literal["auto", "magnav"] | None = None,
    core_field: bool | None = None,
    remove_diurnal: bool | None = None,
    decimal_year: float | None = None,
    map_interpolation: Literal["linear", "quadratic", "cubic"] | None = None,
    map_levels_m: ListLike | None = None,
    map_error_length_m: float | None = None,
    offset_window_s: float | None = None,
    measurement_sigma_nt: float | Literal["auto"] | None = None,
    fogm_sigma_nt: float | Literal["auto"] | None = None,
    fogm_tau_s: float | Literal["auto"] | None = None,
    noise_column: str | None = None,
    start: Literal["auto", "fix", "alignment", "given"] | None = None,
    fix: ListLike | None = None,
    fix_velocity: ListLike | None = None,
    fix_sigma_m: float | None = None,
    fix_alt_sigma_m: float | None = None,
    fix_velocity_sigma_mps: float | None = None,
    vector: str | None = None,
    sensor_axis: ListLike | None = None,
    dead_zones: Literal["none", "polar", "polar_and_equatorial"] | None = None,
    ins_grade: Literal["magnav", "navigation", "tactical", "commercial"] | None = None,
    init_position_sigma_m: float | None = None,
    init_altitude_sigma_m: float | None = None,
    init_velocity_sigma_mps: float | None = None,
    init_attitude_sigma_deg: float | None = None,
    init_heading_sigma_deg: float | None = None,
    vrw_sigma: float | None = None,
    arw_sigma: float | None = None,
    baro_sigma_m: float | None = None,
    ha_sigma_m: float | None = None,
    a_hat_sigma_mps2: float | None = None,
    acc_sigma_mps2: float | None = None,
    gyro_sigma_radps: float | None = None,
    baro_tau_s: float | None = None,
    acc_tau_s: float | None = None,
    gyro_tau_s: float | None = None,
    adapt: Literal["r", "q", "both"] | None = None,
    window: int | None = None,
    sigma_min_nt: float | None = None,
    sigma_max_nt: float | None = None,
    form: Literal["residual", "matched", "compatible"] | None = None,
    gate_nis: float | None = None,
    discretisation: Literal["trapezoidal", "rectangular", "van_loan"] | None = None,
    save_state: bool | None = None,
    gnss_lost_s: ListLike | None = None,
    gnss: ListLike | None = None,
    gnss_interval_s: float | None = None,
    gnss_sigma_m: float | None = None,
    gnss_alt_sigma_m: float | None = None,
    gnss_noise: bool | None = None,
    gnss_test: bool | None = None,
    gradient: ListLike | None = None,
    gradient_baseline_m: ListLike | None = None,
    gradient_sigma_nt: float | None = None,
    gradient_bias_sigma_nt: float | None = None,
    gradient_bias_tau_s: float | None = None,
    gradient_slope_sigma: float | Literal["auto"] | None = None,
    use_scalar: bool | None = None,
    vector_sigma_nt: float | None = None,
    vector_bias_sigma_nt: float | None = None,
    vector_bias_tau_s: float | None = None,
    vector_crustal_sigma_nt: float | None = None,
    vector_crustal_length_m: float | None = None,
    height: str | None = None,
    height_sigma_m: float | None = None,
    height_bias_sigma_m: float | None = None,
    height_bias_tau_s: float | None = None,
    map_sigma_nt: float | None = None,
    map_sigma_length_m: float | None = None,
    mag_latency_sigma_s: float | None = None,
    map_height_sigma_m: float | None = None,
    permanent_change_sigma_nt: float | None = None,
    permanent_change_tau_s: float | None = None,
    flat_over_m: float | None = None,
) -> Track:
    """The filter `ekf`, with measurement noise estimated from the innovations.

    Use it for a measurement whose noise is unknown or changes. With an assumed noise ten times
    too small or too large, a filter loses more than half of its accuracy; an adaptive filter
    loses a few percent. If the noise is known, `ekf` is simpler and as accurate. The filter
    cannot separate noise from map errors, so `sigma_min_nt` and `sigma_max_nt` bound its
    estimate.

    `sigma_adapted` is the assumed measurement noise of the sample. It starts at
    `measurement_sigma_nt` and is then estimated from the innovations in the window before the
    sample. With several magnetometers, each has its column `sigma_adapted_<mag>`, and a
    magnetometer has less weight when its noise increases.

    `noise_column` holds the noise that a network or an ensemble predicts for each sample. With
    this key, the filter estimates one scale factor on this noise and keeps the predicted
    variation over time. After an inaccurate start or a noisy period, the position error
    dominates the innovations, which then contain little information on the noise. In this case,
    the default `form` changes the noise little, and the other forms move it to one of the
    bounds.

    Parameters
    ----------
    tt_s : array_like
        Times of the samples, s, ascending, of shape (samples,).
    ins_lat_deg : array_like
        Latitude of the INS, degrees, of shape (samples,).
    ins_lon_deg : array_like
        Longitude of the INS, degrees, of shape (samples,).
    ins_alt_m : array_like
        Height of the INS above the WGS-84 ellipsoid, m, of shape (samples,).
    mag_nt : Magnetometers
        Measured field, nT, of shape (samples,); NaN where there is no measurement. A mapping
        holds several magnetometers under the names of their columns, such as `mag_1_c`
        (compensated) or `mag_1_uc`.
    map : Map
        Anomaly map, such as the result of `magline.maps.open`.
    ins_velocity_ned_mps : array_like, optional
        Velocity of the INS north, east and down, m/s, of shape (samples, 3). Default: derived
        from its positions.
    ins_force_ned_mps2 : array_like, optional
        Specific force of the INS north, east and down, m/s^2, of shape (samples, 3). Default:
        derived from its velocities.
    ins_attitude_deg : array_like, optional
        Roll, pitch and yaw of the INS, degrees, of shape (samples, 3). Default: level, along
        the course.
    columns : Mapping[str, Any], optional
        Further columns of the flight table under their names, in its units: those that keys
        name, and those that the stage uses if they are there, such as `diurnal` (nT), `year`,
        `doy`, `gnss_lat` (deg), `ins_aligned` (s), and the truth `lat` and `lon` (deg) and
        `alt` (m). A value is an array of shape (samples,), one number or text for all samples,
        or a pair of a matrix with one row per sample and the names of its columns.
    tuning : {"auto", "magnav"}, optional
        Source of unset parameters. `auto` estimates the noise of each line from the likelihood
        of its innovations, rejects outliers, and continues a map of known height to the flight
        heights. `magnav` uses the defaults of MagNav.jl, no gate, and the map at its own
        height. A key in the spec takes precedence over both. Default: `"auto"`.
    core_field : bool, optional
        Adds the core field to the predicted measurement. `false` means that the measurement is
        an anomaly. Default: `true`.
    remove_diurnal : bool, optional
        Subtracts the column `diurnal` from the measurement, so that the filter need not
        estimate the temporal variation. A sample with a NaN in `diurnal` has no measurement.
        Unset: true if the flight has a column `diurnal` that has not yet been subtracted from
        the measurement.
    decimal_year : float, optional
        Date of the core field as a decimal year. It replaces the flight's date. Unit: a.
        Allowed: 1900 to 2030. Unset: the flight's own date.
    map_interpolation : {"linear", "quadratic", "cubic"}, optional
        Interpolation of the map. The field above its sources is smooth, so spline interpolation
        is more accurate than bilinear interpolation. Unset: `cubic` with `tuning = "auto"`,
        else `linear`.
    map_levels_m : ListLike, optional
        Heights above the ellipsoid, ascending, to which the map is continued. Between these
        heights the map is interpolated linearly. Unit: m. Unset: with `tuning = "auto"` the map
        is continued to the flight heights, otherwise it is used at its own height.
    map_error_length_m : float, optional
        Correlation length of the map error, for a map with the column `error` (`map_grid`,
        `track_map`); typically the spacing of its survey lines. The correlated map error is
        converted to equivalent white noise, which is added to the measurement noise of each
        sample. The map error is interpolated at the position that an extended Kalman filter
        predicts. Unit: m. Allowed: above 0. Unset: the map is assumed to be exact; `tuning =
        "auto"` instead uses the map's column `error`, or the error of the map's interpolation,
        times an estimated factor.
    offset_window_s : float, optional
        Length of the window at the start of a line in which an offset is computed: the mean of
        measurement minus prediction. The offset is subtracted from all measurements of the line
        before filtering, because compensation leaves a constant undetermined. 0 subtracts
        nothing. Unit: s. Allowed: 0 or above. Default: `0.0`.
    measurement_sigma_nt : float | {"auto"}, optional
        Standard deviation of the white noise of a measurement. It includes the noise of the
        sensor, the map and the compensation. `"auto"` uses the noise of the calibration
        residual, from the column `mag_sigma`. Unit: nT. Allowed: above 0. Unset: the
        maximum-likelihood estimate with `tuning = "auto"`, otherwise 5.0.
    fogm_sigma_nt : float | {"auto"}, optional
        Standard deviation of the first-order Gauss-Markov process for the temporal variation
        and all other slow errors. `"auto"` uses the column `mag_fogm_sigma`. Unit: nT. Allowed:
        0 or above. Unset: the maximum-likelihood estimate with `tuning = "auto"`, otherwise
        3.0.
    fogm_tau_s : float | {"auto"}, optional
        Time constant of the temporal variation. `"auto"` uses the column `mag_fogm_tau`. Unit:
        s. Allowed: above 0. Unset: the maximum-likelihood estimate with `tuning = "auto"`,
        otherwise 600.0.
    noise_column : str, optional
        Column with the standard deviation of an additional error of each sample:
        `mag_aircraft_sigma` of an ensemble, or the predicted error of a network. The square of
        this standard deviation is added to the square of `measurement_sigma_nt`. A sample
        without a value in this column has no measurement. Requires a single magnetometer. Unit:
        nT. Unset: equal noise at all samples.
    start : {"auto", "fix", "alignment", "given"}, optional
        Source of the initial estimate. `fix` corrects the INS with a position fix. `alignment`
        propagates the `init_*` standard deviations from the alignment to the start of the line.
        `given` applies the `init_*` standard deviations at the start of the line; the defaults
        are valid only within minutes of the alignment, because an INS drifts. `auto` selects
        one of the three from the keys and columns. Default: `"auto"`.
    fix : ListLike, optional
        Columns with the latitude (deg), longitude (deg) and height (m) of the fix. The first
        values within 2 s of the line's start are used. If the columns have the role truth,
        white noise with the fix's standard deviations is added. The added noise of a line is
        the same in every run. Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has
        them, else `lat`, `lon` and `alt`.
    fix_velocity : ListLike, optional
        Columns of the fix's velocity components: north, east and down. Unit: m/s. Unset:
        `gnss_vn`, `gnss_ve` and `gnss_vd` for a fix from `gnss_*` columns, otherwise `vn`, `ve`
        and `vd`; without these columns, the velocity of the INS.
    fix_sigma_m : float, optional
        Standard deviation of the fix's position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `3.0`.
    fix_alt_sigma_m : float, optional
        Standard deviation of the fix's height. Unit: m. Allowed: above 0. Default: `5.0`.
    fix_velocity_sigma_mps : float, optional
        Standard deviation of each component of the fix's velocity. Unit: m/s. Allowed: above 0.
        Default: `0.1`.
    vector : str, optional
        Vector magnetometer that gives the direction of the field, such as `flux_a`. The noise
        of this magnetometer, and the aircraft field at its position, are neglected. Unset:
        equal noise in all attitudes.
    sensor_axis : ListLike, optional
        Axis of the scalar sensor in the frame of the vector magnetometer: nose, right, down.
        Allowed: finite. Default: `[1.0,0.0,0.0]`.
    dead_zones : {"none", "polar", "polar_and_equatorial"}, optional
        Dead zones of the scalar sensor: along its axis (`polar`), or also across its axis
        (`polar_and_equatorial`). The assumed noise is inversely proportional to the amplitude
        of the sensor's signal. At the largest amplitude, the noise is `measurement_sigma_nt`. A
        sample whose amplitude is below a tenth of the largest gives no measurement. Default:
        `"none"`.
    ins_grade : {"magnav", "navigation", "tactical", "commercial"}, optional
        Grade of the INS. The grade sets the INS keys (`init_*`, `*_sigma*` and `*_tau_s`) that
        are unset in the spec. `magnav` sets the defaults shown for these keys. `navigation` is
        a Honeywell HG9900, `tactical` a Honeywell HG1700, and `commercial` has micro-mechanical
        sensors [Lee 2019, Tables 9 and 10]. For these three grades, the position at alignment
        is exact (`init_position_sigma_m = 0`). Unset: in `navigate`, the flight's column
        `ins_grade` if present; otherwise `magnav`.
    init_position_sigma_m : float, optional
        Standard deviation of the initial horizontal position error along each axis. Unit: m.
        Allowed: 0 or above. Default: `3.0`.
    init_altitude_sigma_m : float, optional
        Standard deviation of the initial height error. Unit: m. Allowed: 0 or above. Default:
        `0.001`.
    init_velocity_sigma_mps : float, optional
        Standard deviation of the initial velocity error along each axis. Unit: m/s. Allowed: 0
        or above. Default: `0.01`.
    init_attitude_sigma_deg : float, optional
        Standard deviation of the initial tilt error about each axis. Unit: deg. Allowed: 0 or
        above. Default: `0.01`.
    init_heading_sigma_deg : float, optional
        Standard deviation of the initial yaw error, the tilt about the down axis. In practice,
        the yaw error exceeds the other tilt errors, because the INS finds north from the
        earth's rotation, a much weaker signal than gravity. Unit: deg. Allowed: 0 or above.
        Unset: the initial tilt error.
    vrw_sigma : float, optional
        Velocity random walk: square root of the spectral density of the accelerometer noise.
        Unit: m/s^1.5. Allowed: 0 or above. Default: `0.000238`.
    arw_sigma : float, optional
        Angular random walk: square root of the spectral density of the gyro noise. Unit:
        rad/s^0.5. Allowed: 0 or above. Default: `5.81e-7`.
    baro_sigma_m : float, optional
        Standard deviation of the barometer error. Unit: m. Allowed: 0 or above. Default: `1.0`.
    ha_sigma_m : float, optional
        Standard deviation of the initial error of the altitude in the barometer loop, which
        aids the INS height. Unit: m. Allowed: 0 or above. Default: `0.001`.
    a_hat_sigma_mps2 : float, optional
        Standard deviation of the initial error of the vertical acceleration in the barometer
        loop, which aids the INS height. Unit: m/s2. Allowed: 0 or above. Default: `0.01`.
    acc_sigma_mps2 : float, optional
        Standard deviation of the accelerometer bias. Unit: m/s2. Allowed: 0 or above. Default:
        `0.000245`.
    gyro_sigma_radps : float, optional
        Standard deviation of the gyro bias. Unit: rad/s. Allowed: 0 or above. Default:
        `7.27e-9`.
    baro_tau_s : float, optional
        Time constant of the barometer error. Unit: s. Allowed: above 0. Default: `3600.0`.
    acc_tau_s : float, optional
        Time constant of the accelerometer bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    gyro_tau_s : float, optional
        Time constant of the gyro bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    adapt : {"r", "q", "both"}, optional
        Noise that is estimated: measurement noise (`"r"`), process noise (`"q"`), or both.
        Default: `"r"`.
    window : int, optional
        Number of past innovations in the estimate. With 50 innovations, the noise is accurate
        to 10 %; with 10, as in MagNav.jl, to 20 %. With 10 innovations, the forms `"matched"`
        and `"compatible"` occasionally estimate a noise near 0. The filter is then strongly
        overconfident unless `sigma_min_nt` is near the true noise. Allowed: 2 to 1000000.
        Default: `50`.
    sigma_min_nt : float, optional
        Lower bound of the estimated noise. Unit: nT. Allowed: above 0. Unset: half of the noise
        that `tuning = "auto"` estimates, else a twentieth of `measurement_sigma_nt`; with
        `noise_column` the smallest assumed noise.
    sigma_max_nt : float, optional
        Upper bound of the estimated noise. Unit: nT. Allowed: above 0. Unset: 20 times
        `measurement_sigma_nt`, or with `noise_column` 20 times the largest assumed noise.
    form : {"residual", "matched", "compatible"}, optional
        Estimator of the noise. `"residual"` uses the a posteriori residual of each measurement.
        `"matched"`, the default of version 1, subtracts from each squared innovation the
        variance predicted for the same sample. `"compatible"`, as in MagNav.jl, starts at the
        mean of the bounds and subtracts the variance predicted for the present sample from all
        squared innovations. Default: `"residual"`.
    gate_nis : float, optional
        Largest accepted NIS (squared innovation divided by its variance) of a measurement.
        Rejected measurements are used only to estimate the noise. Allowed: above 0. Unset: no
        gate; with `tuning = "auto"`, outliers are rejected before filtering.
    discretisation : {"trapezoidal", "rectangular", "van_loan"}, optional
        Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of
        first order as in MagNav.jl, and `van_loan` exact. Default: `"trapezoidal"`.
    save_state : bool, optional
        Appends the state `x` and its covariance `p` (row-major). Default: `false`.
    gnss_lost_s : ListLike, optional
        Times at which GNSS is lost and recovered, in seconds from the first sample of the line.
        Before the loss and after the recovery, the GNSS position (columns `gnss`) aids the
        filter. With `[0.0, 600.0]`, GNSS is missing for the first ten minutes of the line. If
        the recovery time is after the end of the line, GNSS is never recovered. Unit: s.
        Allowed: 0 or above. Unset: GNSS is not used.
    gnss : ListLike, optional
        Columns with the GNSS latitude (deg), longitude (deg) and height above the ellipsoid
        (m). Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has them, else `lat`,
        `lon` and `alt`.
    gnss_interval_s : float, optional
        Time between successive GNSS positions. Unit: s. Allowed: above 0. Default: `1.0`.
    gnss_sigma_m : float, optional
        Standard deviation of the GNSS position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `2.0`.
    gnss_alt_sigma_m : float, optional
        Standard deviation of the GNSS height. Unit: m. Allowed: above 0. Default: `5.0`.
    gnss_noise : bool, optional
        Adds white noise to the GNSS positions, with the standard deviations `gnss_sigma_m` and
        `gnss_alt_sigma_m`. The added noise of a line is the same in every run. True positions
        have no error: without added noise, the filter appears more accurate than with real
        GNSS. Unset: true if the columns of `gnss` have the role `truth`.
    gnss_test : bool, optional
        Tests each GNSS position against the INS position and does not use rejected positions. A
        chi-square test of each position detects a jump at once. A cumulative sum over earlier
        positions detects a drift of 1 m/s after about 10 s. The test then also rejects the
        positions since the start of the drift. Positions are accepted again after ten
        consecutive positions agree with the INS. The column `gnss_update` (`used`, `rejected`
        or `none`) is appended even if this key is false. Default: `true`.
    gradient : ListLike, optional
        Two compensated scalar magnetometers. The difference between their readings, first minus
        second, measures the slope of the map along the baseline between them. The temporal
        variation and all other common errors cancel in this difference. This key cannot be
        combined with `map_interpolation = "linear"`, because the slope of a bilinear map has
        steps. Unit: nT. Unset: the difference is not used.
    gradient_baseline_m : ListLike, optional
        Vector from the second magnetometer of `gradient` to the first, in the body frame (nose,
        right, down). The INS attitude rotates this vector to the navigation frame. The
        measurement model includes the estimated error of the INS attitude. Unit: m. Allowed:
        finite. Unset: required with `gradient`.
    gradient_sigma_nt : float, optional
        Standard deviation of the white noise in the difference between the two magnetometers'
        readings. Unit: nT. Allowed: above 0. Default: `0.1`.
    gradient_bias_sigma_nt : float, optional
        Standard deviation of the slowly varying error in the difference between the two
        magnetometers' readings. Such an error is likely, because each calibration leaves a
        constant undetermined. Unit: nT. Allowed: 0 or above. Default: `1.0`.
    gradient_bias_tau_s : float, optional
        Time constant of the slowly varying error in the difference between the two
        magnetometers' readings. Unit: s. Allowed: above 0. Default: `3600.0`.
    gradient_slope_sigma : float | {"auto"}, optional
        Standard deviation of the error in the map's slope along the baseline. The error of the
        predicted difference is this error times the length of the baseline. The error is
        correlated along the track, over the same length as the map's anomalies. `"auto"` uses
        the maximum-likelihood value from the innovations of the difference. A large value can
        reveal a map made from widely spaced lines. A map at one height without `map_levels_m`
        has no vertical slope. The prediction then has an additional error: the height
        difference between the magnetometers times the rms slope. Unit: nT/m. Allowed: 0 or
        above. Default: `auto`.
    use_scalar : bool, optional
        Uses the scalar measurement `mag` in the measurement update. `false` ignores `mag`, for
        example in a magnetic storm, and requires the difference (`gradient`) or the vector
        (`vector_sigma_nt`). Default: `true`.
    vector_sigma_nt : float, optional
        Standard deviation of the white noise of each component of `vector`. If set, the
        components are used as measurements. They depend on the total field and on the attitude,
        but not on a rotation about the field direction. This key requires `core_field = true`
        and a calibrated vector magnetometer. Unit: nT. Allowed: above 0. Unset: the vector is
        not used as a measurement.
    vector_bias_sigma_nt : float, optional
        Standard deviation of the bias of each component of `vector`. In a field of 50,000 nT, a
        bias of 50 nT corresponds to an attitude error of 0.06°. Unit: nT. Allowed: 0 or above.
        Default: `50.0`.
    vector_bias_tau_s : float, optional
        Time constant of the bias of each component of `vector`. Unit: s. Allowed: above 0.
        Default: `3600.0`.
    vector_crustal_sigma_nt : float, optional
        Standard deviation, per component, of the crustal field that a map of the scalar anomaly
        leaves undetermined. A typical value is the standard deviation of the anomaly. Unit: nT.
        Allowed: 0 or above. Default: `50.0`.
    vector_crustal_length_m : float, optional
        Correlation length of the crustal field that `vector_crustal_sigma_nt` describes. A
        typical value is the height above the sources. Unit: m. Allowed: above 0. Default:
        `1000.0`.
    height : str, optional
        Column of measured heights above the ellipsoid, such as `baro`, from a barometer that
        does not already aid the INS. Unit: m. Unset: the height of the INS, aided by its
        barometer, is used.
    height_sigma_m : float, optional
        Standard deviation of the white noise of the measured height. Unit: m. Allowed: above 0.
        Default: `3.0`.
    height_bias_sigma_m : float, optional
        Standard deviation of the slowly varying error of the measured height, caused by the
        weather and the geoid. Unit: m. Allowed: 0 or above. Default: `30.0`.
    height_bias_tau_s : float, optional
        Time constant of the slowly varying error of the measured height. Unit: s. Allowed:
        above 0. Default: `3600.0`.
    map_sigma_nt : float, optional
        Standard deviation of the map error. If set, the filter estimates the map error as a
        state that is correlated along the track. Unit: nT. Allowed: 0 or above. Unset: the map
        error is not estimated.
    map_sigma_length_m : float, optional
        Distance over which the autocorrelation of the map error falls to 1/e. Unit: m. Allowed:
        above 0. Default: `500.0`.
    mag_latency_sigma_s : float, optional
        Prior standard deviation of the lag of the magnetometer's time stamps. If set, the
        filter estimates the lag as a state that is constant along the line. A sample with time
        stamp `t` was measured at `t` minus the lag. The lag may be negative. 0 omits this
        state. The columns `mag_latency` and `mag_latency_sigma` are appended. This key is
        available in `ekf`, `iekf` and `ukf`. Unit: s. Allowed: 0 or above. Unset: 1.0 with
        `tuning = "auto"` if a state for the lag clearly increases the likelihood, otherwise 0
        (exact time stamps).
    map_height_sigma_m : float, optional
        Prior standard deviation of a height bias: the true height of the aircraft minus its
        assumed height on the map. Possible causes are a constant error of the barometer, a
        missing geoid height, and a wrong map height. If set, the filter estimates the bias as a
        state that is constant along the line. The bias changes only the predicted total field,
        not `alt`. The heights to which the map is continued must include the true height of the
        aircraft. With `tuning = "auto"`, the map is continued to twice this standard deviation
        below and above the line. Otherwise, set `map_levels_m`. 0 omits this state. The columns
        `map_height_bias` and `map_height_bias_sigma` are appended. This key is available in
        `ekf`, `iekf` and `ukf`. Unit: m. Allowed: 0 or above. Unset: 50 with `tuning = "auto"`
        if a bias clearly increases the likelihood, otherwise 0 (exact height). To find a bias,
        `auto` continues the map up to 200 m below and above the line, unless `map_levels_m` is
        set.
    permanent_change_sigma_nt : float, optional
        Standard deviation of the change in the aircraft's permanent field since calibration,
        per component (nose, right, down). The filter estimates the three components as
        additional states. The attitude and the core field determine the effect of these
        components on the total field. A fourth state is a constant offset with a standard
        deviation of 100 nT. 0 omits these states. This key requires `core_field = true`, and is
        available in `ekf`, `iekf` and `ukf`. Unit: nT. Allowed: 0 or above. Unset: the
        maximum-likelihood estimate with `tuning = "auto"` if these states clearly increase the
        likelihood, otherwise 0.
    permanent_change_tau_s : float, optional
        Time constant of the change in the permanent field. Unit: s. Allowed: above 0. Unset:
        the maximum-likelihood estimate with `tuning = "auto"`, otherwise infinite, so that the
        change is constant along the line.
    flat_over_m : float, optional
        A sample corrects the position only if the ratio of its measurement noise (standard
        deviation) to the map's horizontal slope is at most this value. At a larger ratio, the
        map is too flat to observe the position. The sample is then `flat`: it corrects only the
        temporal variation and the map error. The column `map_slope` is appended. Unit: m.
        Allowed: above 0. Unset: all samples correct the position.

    Returns
    -------
    Track
        Estimate at each sample, innovations, warnings and notes.

    Raises
    ------
    SpecError
        If a key is unknown, has an invalid value, or has no effect.
    DataError
        If the line cannot be filtered, such as an INS with a NaN or a line off the map.
    ValueError
        If the shapes of the arrays differ.

    References
    ----------
    Gnadt 2022, (5.46)-(5.49) and section 5.9.3; Mehra 1972; Mohamed & Schwarz 1999.

    Examples
    --------
    >>> import numpy as np
    >>> from magline import filters, maps
    >>> lat, lon = np.linspace(45.0, 45.2, 201), np.linspace(-76.1, -75.9, 201)
    >>> hills = 60.0 * np.sin(400.0 * lat[:, None]) + 50.0 * np.cos(500.0 * (lat[:, None] + lon))
    >>> field = maps.Map(lon, lat, hills, np.full(hills.shape, 300.0), 4326, "deg")
    >>> t = np.arange(100.0)  # northward over the nodes of a column; the INS is 11 m too far north
    >>> ins = t, lat[50:150] + 1e-4, np.full(100, lon[100]), np.full(100, 300.0)
    >>> start = {"start": "given", "init_position_sigma_m": 20.0}
    >>> track = filters.ekf_adaptive(*ins, hills[50:150, 100], field, core_field=False, **start)
    >>> bool(abs(track.lat_deg[-1] - lat[149]) < 5e-5)
    True
    """
    return navigate_line("ekf_adaptive", locals())


def ekf_online_tl(
    tt_s: ArrayLike,
    ins_lat_deg: ArrayLike,
    ins_lon_deg: ArrayLike,
    ins_alt_m: ArrayLike,
    mag_nt: Magnetometers,
    map: Map,
    *,
    ins_velocity_ned_mps: ArrayLike | None = None,
    ins_force_ned_mps2: ArrayLike | None = None,
    ins_attitude_deg: ArrayLike | None = None,
    columns: Mapping[str, Any] | None = None,
    models: Sequence[Any] | None = None,
    rate_hz: float | None = None,
    tuning: Literal["auto", "magnav"] | None = None,
    core_field: bool | None = None,
    remove_diurnal: bool | None = None,
    decimal_year: float | None = None,
    map_interpolation: Literal["linear", "quadratic", "cubic"] | None = None,
    map_levels_m: ListLike | None = None,
    map_error_length_m: float | None = None,
    offset_window_s: float | None = None,
    measurement_sigma_nt: float | Literal["auto"] | None = None,
    fogm_sigma_nt: float | Literal["auto"] | None = None,
    fogm_tau_s: float | Literal["auto"] | None = None,
    noise_column: str | None = None,
    start: Literal["auto", "fix", "alignment", "given"] | None = None,
    fix: ListLike | None = None,
    fix_velocity: ListLike | None = None,
    fix_sigma_m: float | None = None,
    fix_alt_sigma_m: float | None = None,
    fix_velocity_sigma_mps: float | None = None,
    vector: str | None = None,
    sensor_axis: ListLike | None = None,
    dead_zones: Literal["none", "polar", "polar_and_equatorial"] | None = None,
    ins_grade: Literal["magnav", "navigation", "tactical", "commercial"] | None = None,
    init_position_sigma_m: float | None = None,
    init_altitude_sigma_m: float | None = None,
    init_velocity_sigma_mps: float | None = None,
    init_attitude_sigma_deg: float | None = None,
    init_heading_sigma_deg: float | None = None,
    vrw_sigma: float | None = None,
    arw_sigma: float | None = None,
    baro_sigma_m: float | None = None,
    ha_sigma_m: float | None = None,
    a_hat_sigma_mps2: float | None = None,
    acc_sigma_mps2: float | None = None,
    gyro_sigma_radps: float | None = None,
    baro_tau_s: float | None = None,
    acc_tau_s: float | None = None,
    gyro_tau_s: float | None = None,
    walk_per_hour: float | None = None,
    flux_bias_sigma_nt: float | None = None,
    flux_bias_tau_s: float | None = None,
    bt_scale_nt: float | None = None,
    gate_nis: float | None = None,
    discretisation: Literal["trapezoidal", "rectangular", "van_loan"] | None = None,
    save_state: bool | None = None,
    gnss_lost_s: ListLike | None = None,
    gnss: ListLike | None = None,
    gnss_interval_s: float | None = None,
    gnss_sigma_m: float | None = None,
    gnss_alt_sigma_m: float | None = None,
    gnss_noise: bool | None = None,
    gnss_test: bool | None = None,
    terms: str | None = None,
    permanent_sigma_nt: float | None = None,
    induced_sigma_nt: float | None = None,
    eddy_sigma_nt_s: float | None = None,
    bias_sigma_nt: float | None = None,
    input_sigma_nt: float | None = None,
    heading_error_sigma_nt: float | None = None,
    prior_factor: float | None = None,
    gradient: ListLike | None = None,
    gradient_baseline_m: ListLike | None = None,
    gradient_sigma_nt: float | None = None,
    gradient_bias_sigma_nt: float | None = None,
    gradient_bias_tau_s: float | None = None,
    gradient_slope_sigma: float | Literal["auto"] | None = None,
    use_scalar: bool | None = None,
    vector_sigma_nt: float | None = None,
    vector_bias_sigma_nt: float | None = None,
    vector_bias_tau_s: float | None = None,
    vector_crustal_sigma_nt: float | None = None,
    vector_crustal_length_m: float | None = None,
    height: str | None = None,
    height_sigma_m: float | None = None,
    height_bias_sigma_m: float | None = None,
    height_bias_tau_s: float | None = None,
    map_sigma_nt: float | None = None,
    map_sigma_length_m: float | None = None,
    mag_latency_sigma_s: float | None = None,
    map_height_sigma_m: float | None = None,
    permanent_change_sigma_nt: float | None = None,
    permanent_change_tau_s: float | None = None,
    flat_over_m: float | None = None,
) -> Track:
    """The 18-state extended Kalman filter with the Tolles-Lawson coefficients of each
    magnetometer as additional states.

    `mag` is uncompensated, and the coefficients follow changes of the aircraft field.

    Use it if the line has manoeuvres, and the calibration is old, comes from another aircraft,
    or is missing. On a straight line at constant attitude the aircraft field is a constant, and
    only the prior separates it from the map. A constant among the terms (`bias`) absorbs the
    constant that map and compensation leave undetermined, so `offset_window_s` is not needed.

    The prior comes from the calibrations in `model` (one or several tables of `fit`), converted
    to the sample rate of the line. Without `model`, the filter starts cold: the prior mean of
    all coefficients is 0. A scalar magnetometer among the terms is rejected, because the filter
    would subtract its own measurement. `aircraft` is the aircraft field computed with the
    coefficients estimated at the sample. With several magnetometers, each has its column
    `aircraft_<mag>`. `residual` is the innovation of the first magnetometer used at a sample.
    `nis` is the mean over all magnetometers used at the sample.

    Parameters
    ----------
    tt_s : array_like
        Times of the samples, s, ascending, of shape (samples,).
    ins_lat_deg : array_like
        Latitude of the INS, degrees, of shape (samples,).
    ins_lon_deg : array_like
        Longitude of the INS, degrees, of shape (samples,).
    ins_alt_m : array_like
        Height of the INS above the WGS-84 ellipsoid, m, of shape (samples,).
    mag_nt : Magnetometers
        Measured field, nT, of shape (samples,); NaN where there is no measurement. A mapping
        holds several magnetometers under the names of their columns, such as `mag_1_c`
        (compensated) or `mag_1_uc`.
    map : Map
        Anomaly map, such as the result of `magline.maps.open`.
    ins_velocity_ned_mps : array_like, optional
        Velocity of the INS north, east and down, m/s, of shape (samples, 3). Default: derived
        from its positions.
    ins_force_ned_mps2 : array_like, optional
        Specific force of the INS north, east and down, m/s^2, of shape (samples, 3). Default:
        derived from its velocities.
    ins_attitude_deg : array_like, optional
        Roll, pitch and yaw of the INS, degrees, of shape (samples, 3). Default: level, along
        the course.
    columns : Mapping[str, Any], optional
        Further columns of the flight table under their names, in its units: those that keys
        name, and those that the stage uses if they are there, such as `diurnal` (nT), `year`,
        `doy`, `gnss_lat` (deg), `ins_aligned` (s), and the truth `lat` and `lon` (deg) and
        `alt` (m). A value is an array of shape (samples,), one number or text for all samples,
        or a pair of a matrix with one row per sample and the names of its columns.
    models : Sequence[Any], optional
        Calibrations that give the prior of the coefficients: tables of `fit` as mappings or
        data frames with the columns `term`, `value`, `std` (nT) and, if known, `rate_hz` (Hz).
        Default: a cold start.
    rate_hz : float, optional
        Sample rate of the terms that are differences per sample, Hz. Default: the rate of
        `tt_s`.
    tuning : {"auto", "magnav"}, optional
        Source of unset parameters. `auto` estimates the noise of each line from the likelihood
        of its innovations, rejects outliers, and continues a map of known height to the flight
        heights. `magnav` uses the defaults of MagNav.jl, no gate, and the map at its own
        height. A key in the spec takes precedence over both. Default: `"auto"`.
    core_field : bool, optional
        Adds the core field to the predicted measurement. `false` means that the measurement is
        an anomaly. Default: `true`.
    remove_diurnal : bool, optional
        Subtracts the column `diurnal` from the measurement, so that the filter need not
        estimate the temporal variation. A sample with a NaN in `diurnal` has no measurement.
        Unset: true if the flight has a column `diurnal` that has not yet been subtracted from
        the measurement.
    decimal_year : float, optional
        Date of the core field as a decimal year. It replaces the flight's date. Unit: a.
        Allowed: 1900 to 2030. Unset: the flight's own date.
    map_interpolation : {"linear", "quadratic", "cubic"}, optional
        Interpolation of the map. The field above its sources is smooth, so spline interpolation
        is more accurate than bilinear interpolation. Unset: `cubic` with `tuning = "auto"`,
        else `linear`.
    map_levels_m : ListLike, optional
        Heights above the ellipsoid, ascending, to which the map is continued. Between these
        heights the map is interpolated linearly. Unit: m. Unset: with `tuning = "auto"` the map
        is continued to the flight heights, otherwise it is used at its own height.
    map_error_length_m : float, optional
        Correlation length of the map error, for a map with the column `error` (`map_grid`,
        `track_map`); typically the spacing of its survey lines. The correlated map error is
        converted to equivalent white noise, which is added to the measurement noise of each
        sample. The map error is interpolated at the position that an extended Kalman filter
        predicts. Unit: m. Allowed: above 0. Unset: the map is assumed to be exact; `tuning =
        "auto"` instead uses the map's column `error`, or the error of the map's interpolation,
        times an estimated factor.
    offset_window_s : float, optional
        Length of the window at the start of a line in which an offset is computed: the mean of
        measurement minus prediction. The offset is subtracted from all measurements of the line
        before filtering, because compensation leaves a constant undetermined. 0 subtracts
        nothing. Unit: s. Allowed: 0 or above. Default: `0.0`.
    measurement_sigma_nt : float | {"auto"}, optional
        Standard deviation of the white noise of a measurement. It includes the noise of the
        sensor, the map and the compensation. `"auto"` uses the noise of the calibration
        residual, from the column `mag_sigma`. Unit: nT. Allowed: above 0. Unset: the
        maximum-likelihood estimate with `tuning = "auto"`, otherwise 5.0.
    fogm_sigma_nt : float | {"auto"}, optional
        Standard deviation of the first-order Gauss-Markov process for the temporal variation
        and all other slow errors. `"auto"` uses the column `mag_fogm_sigma`. Unit: nT. Allowed:
        0 or above. Unset: the maximum-likelihood estimate with `tuning = "auto"`, otherwise
        3.0.
    fogm_tau_s : float | {"auto"}, optional
        Time constant of the temporal variation. `"auto"` uses the column `mag_fogm_tau`. Unit:
        s. Allowed: above 0. Unset: the maximum-likelihood estimate with `tuning = "auto"`,
        otherwise 600.0.
    noise_column : str, optional
        Column with the standard deviation of an additional error of each sample:
        `mag_aircraft_sigma` of an ensemble, or the predicted error of a network. The square of
        this standard deviation is added to the square of `measurement_sigma_nt`. A sample
        without a value in this column has no measurement. Requires a single magnetometer. Unit:
        nT. Unset: equal noise at all samples.
    start : {"auto", "fix", "alignment", "given"}, optional
        Source of the initial estimate. `fix` corrects the INS with a position fix. `alignment`
        propagates the `init_*` standard deviations from the alignment to the start of the line.
        `given` applies the `init_*` standard deviations at the start of the line; the defaults
        are valid only within minutes of the alignment, because an INS drifts. `auto` selects
        one of the three from the keys and columns. Default: `"auto"`.
    fix : ListLike, optional
        Columns with the latitude (deg), longitude (deg) and height (m) of the fix. The first
        values within 2 s of the line's start are used. If the columns have the role truth,
        white noise with the fix's standard deviations is added. The added noise of a line is
        the same in every run. Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has
        them, else `lat`, `lon` and `alt`.
    fix_velocity : ListLike, optional
        Columns of the fix's velocity components: north, east and down. Unit: m/s. Unset:
        `gnss_vn`, `gnss_ve` and `gnss_vd` for a fix from `gnss_*` columns, otherwise `vn`, `ve`
        and `vd`; without these columns, the velocity of the INS.
    fix_sigma_m : float, optional
        Standard deviation of the fix's position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `3.0`.
    fix_alt_sigma_m : float, optional
        Standard deviation of the fix's height. Unit: m. Allowed: above 0. Default: `5.0`.
    fix_velocity_sigma_mps : float, optional
        Standard deviation of each component of the fix's velocity. Unit: m/s. Allowed: above 0.
        Default: `0.1`.
    vector : str, optional
        Vector magnetometer that gives the direction of the field, such as `flux_a`. The noise
        of this magnetometer, and the aircraft field at its position, are neglected. Unset:
        equal noise in all attitudes.
    sensor_axis : ListLike, optional
        Axis of the scalar sensor in the frame of the vector magnetometer: nose, right, down.
        Allowed: finite. Default: `[1.0,0.0,0.0]`.
    dead_zones : {"none", "polar", "polar_and_equatorial"}, optional
        Dead zones of the scalar sensor: along its axis (`polar`), or also across its axis
        (`polar_and_equatorial`). The assumed noise is inversely proportional to the amplitude
        of the sensor's signal. At the largest amplitude, the noise is `measurement_sigma_nt`. A
        sample whose amplitude is below a tenth of the largest gives no measurement. Default:
        `"none"`.
    ins_grade : {"magnav", "navigation", "tactical", "commercial"}, optional
        Grade of the INS. The grade sets the INS keys (`init_*`, `*_sigma*` and `*_tau_s`) that
        are unset in the spec. `magnav` sets the defaults shown for these keys. `navigation` is
        a Honeywell HG9900, `tactical` a Honeywell HG1700, and `commercial` has micro-mechanical
        sensors [Lee 2019, Tables 9 and 10]. For these three grades, the position at alignment
        is exact (`init_position_sigma_m = 0`). Unset: in `navigate`, the flight's column
        `ins_grade` if present; otherwise `magnav`.
    init_position_sigma_m : float, optional
        Standard deviation of the initial horizontal position error along each axis. Unit: m.
        Allowed: 0 or above. Default: `3.0`.
    init_altitude_sigma_m : float, optional
        Standard deviation of the initial height error. Unit: m. Allowed: 0 or above. Default:
        `0.001`.
    init_velocity_sigma_mps : float, optional
        Standard deviation of the initial velocity error along each axis. Unit: m/s. Allowed: 0
        or above. Default: `0.01`.
    init_attitude_sigma_deg : float, optional
        Standard deviation of the initial tilt error about each axis. Unit: deg. Allowed: 0 or
        above. Default: `0.01`.
    init_heading_sigma_deg : float, optional
        Standard deviation of the initial yaw error, the tilt about the down axis. In practice,
        the yaw error exceeds the other tilt errors, because the INS finds north from the
        earth's rotation, a much weaker signal than gravity. Unit: deg. Allowed: 0 or above.
        Unset: the initial tilt error.
    vrw_sigma : float, optional
        Velocity random walk: square root of the spectral density of the accelerometer noise.
        Unit: m/s^1.5. Allowed: 0 or above. Default: `0.000238`.
    arw_sigma : float, optional
        Angular random walk: square root of the spectral density of the gyro noise. Unit:
        rad/s^0.5. Allowed: 0 or above. Default: `5.81e-7`.
    baro_sigma_m : float, optional
        Standard deviation of the barometer error. Unit: m. Allowed: 0 or above. Default: `1.0`.
    ha_sigma_m : float, optional
        Standard deviation of the initial error of the altitude in the barometer loop, which
        aids the INS height. Unit: m. Allowed: 0 or above. Default: `0.001`.
    a_hat_sigma_mps2 : float, optional
        Standard deviation of the initial error of the vertical acceleration in the barometer
        loop, which aids the INS height. Unit: m/s2. Allowed: 0 or above. Default: `0.01`.
    acc_sigma_mps2 : float, optional
        Standard deviation of the accelerometer bias. Unit: m/s2. Allowed: 0 or above. Default:
        `0.000245`.
    gyro_sigma_radps : float, optional
        Standard deviation of the gyro bias. Unit: rad/s. Allowed: 0 or above. Default:
        `7.27e-9`.
    baro_tau_s : float, optional
        Time constant of the barometer error. Unit: s. Allowed: above 0. Default: `3600.0`.
    acc_tau_s : float, optional
        Time constant of the accelerometer bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    gyro_tau_s : float, optional
        Time constant of the gyro bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    walk_per_hour : float, optional
        Random walk of a coefficient: standard deviation of the change in one hour, divided by
        the prior standard deviation. With 0 the coefficients are constants. In a cold start the
        default is 0, because the wide prior does not describe changes in flight. Allowed: 0 or
        above. Unset: 0.1 with `model`, else 0.0.
    flux_bias_sigma_nt : float, optional
        Standard deviation of the bias of each axis of `vector`, the magnetometer of the terms.
        If set, the filter estimates these biases. Unit: nT. Allowed: above 0. Unset: `vector`
        is assumed to be exact.
    flux_bias_tau_s : float, optional
        Time constant of the biases of `vector`. Unit: s. Allowed: above 0. Unset: the biases
        are constant.
    bt_scale_nt : float, optional
        Field scale of the terms: `bt_scale_nt` of the `a_matrix` stage that computes the terms.
        Unit: nT. Allowed: above 0. Default: `50000.0`.
    gate_nis : float, optional
        Largest accepted NIS (squared innovation divided by its variance) of a measurement.
        Allowed: above 0. Unset: no gate; with `tuning = "auto"`, outliers are rejected before
        filtering.
    discretisation : {"trapezoidal", "rectangular", "van_loan"}, optional
        Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of
        first order as in MagNav.jl, and `van_loan` exact. Default: `"trapezoidal"`.
    save_state : bool, optional
        Appends the state `x` and its covariance `p` (row-major), of the 18 states of `ekf`.
        Default: `false`.
    gnss_lost_s : ListLike, optional
        Times at which GNSS is lost and recovered, in seconds from the first sample of the line.
        Before the loss and after the recovery, the GNSS position (columns `gnss`) aids the
        filter. With `[0.0, 600.0]`, GNSS is missing for the first ten minutes of the line. If
        the recovery time is after the end of the line, GNSS is never recovered. Unit: s.
        Allowed: 0 or above. Unset: GNSS is not used.
    gnss : ListLike, optional
        Columns with the GNSS latitude (deg), longitude (deg) and height above the ellipsoid
        (m). Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has them, else `lat`,
        `lon` and `alt`.
    gnss_interval_s : float, optional
        Time between successive GNSS positions. Unit: s. Allowed: above 0. Default: `1.0`.
    gnss_sigma_m : float, optional
        Standard deviation of the GNSS position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `2.0`.
    gnss_alt_sigma_m : float, optional
        Standard deviation of the GNSS height. Unit: m. Allowed: above 0. Default: `5.0`.
    gnss_noise : bool, optional
        Adds white noise to the GNSS positions, with the standard deviations `gnss_sigma_m` and
        `gnss_alt_sigma_m`. The added noise of a line is the same in every run. True positions
        have no error: without added noise, the filter appears more accurate than with real
        GNSS. Unset: true if the columns of `gnss` have the role `truth`.
    gnss_test : bool, optional
        Tests each GNSS position against the INS position and does not use rejected positions. A
        chi-square test of each position detects a jump at once. A cumulative sum over earlier
        positions detects a drift of 1 m/s after about 10 s. The test then also rejects the
        positions since the start of the drift. Positions are accepted again after ten
        consecutive positions agree with the INS. The column `gnss_update` (`used`, `rejected`
        or `none`) is appended even if this key is false. Default: `true`.
    terms : str, optional
        List column of the terms, as made by `a_matrix`. Default: `"tl"`.
    permanent_sigma_nt : float, optional
        Standard deviation of the zero-mean prior of a permanent coefficient, unless `model`
        supplies a prior. Unit: nT. Allowed: above 0. Default: `2000.0`.
    induced_sigma_nt : float, optional
        Standard deviation of the zero-mean prior of an induced coefficient, unless `model`
        supplies a prior. Unit: nT. Allowed: above 0. Default: `1000.0`.
    eddy_sigma_nt_s : float, optional
        Prior standard deviation of an eddy coefficient at one sample per second. An eddy term
        contains the change of the field from one sample to the next, so this value is
        multiplied by the sample rate of the line. Unit: nT s. Allowed: above 0. Default:
        `500.0`.
    bias_sigma_nt : float, optional
        Prior standard deviation of the constant `bias`. Unit: nT. Allowed: above 0. Default:
        `500.0`.
    input_sigma_nt : float, optional
        Prior standard deviation of the coefficient of any other term, such as an electric
        current, in nT per unit of the term. A current loop in the cabin causes a few nT per
        ampere. Unit: nT. Allowed: above 0. Default: `20.0`.
    heading_error_sigma_nt : float, optional
        Prior standard deviation of each harmonic of the magnetometer's heading error. The terms
        `heading_1`, `heading_2` and `heading_4` are the first, second and fourth harmonics of
        the angle between the sensor axis and the field. This key requires `vector`. Unit: nT.
        Allowed: above 0. Unset: the heading error is not estimated.
    prior_factor : float, optional
        Factor on the prior standard deviations from `model`. A single calibration supplies the
        standard deviations of its fit. Several calibrations supply the scatter between them.
        Some terms, such as eddy terms, are differences between samples. The coefficients of
        these terms are converted from the sample rate of the fit to the sample rate of the
        line. At rates below about 5 Hz, the differences are inaccurate in manoeuvres: they
        underestimate a change at frequency f by the fraction (2 pi f / rate)^2 / 6. Allowed:
        above 0. Default: `1.0`.
    gradient : ListLike, optional
        Two compensated scalar magnetometers. The difference between their readings, first minus
        second, measures the slope of the map along the baseline between them. The temporal
        variation and all other common errors cancel in this difference. This key cannot be
        combined with `map_interpolation = "linear"`, because the slope of a bilinear map has
        steps. Unit: nT. Unset: the difference is not used.
    gradient_baseline_m : ListLike, optional
        Vector from the second magnetometer of `gradient` to the first, in the body frame (nose,
        right, down). The INS attitude rotates this vector to the navigation frame. The
        measurement model includes the estimated error of the INS attitude. Unit: m. Allowed:
        finite. Unset: required with `gradient`.
    gradient_sigma_nt : float, optional
        Standard deviation of the white noise in the difference between the two magnetometers'
        readings. Unit: nT. Allowed: above 0. Default: `0.1`.
    gradient_bias_sigma_nt : float, optional
        Standard deviation of the slowly varying error in the difference between the two
        magnetometers' readings. Such an error is likely, because each calibration leaves a
        constant undetermined. Unit: nT. Allowed: 0 or above. Default: `1.0`.
    gradient_bias_tau_s : float, optional
        Time constant of the slowly varying error in the difference between the two
        magnetometers' readings. Unit: s. Allowed: above 0. Default: `3600.0`.
    gradient_slope_sigma : float | {"auto"}, optional
        Standard deviation of the error in the map's slope along the baseline. The error of the
        predicted difference is this error times the length of the baseline. The error is
        correlated along the track, over the same length as the map's anomalies. `"auto"` uses
        the maximum-likelihood value from the innovations of the difference. A large value can
        reveal a map made from widely spaced lines. A map at one height without `map_levels_m`
        has no vertical slope. The prediction then has an additional error: the height
        difference between the magnetometers times the rms slope. Unit: nT/m. Allowed: 0 or
        above. Default: `auto`.
    use_scalar : bool, optional
        Uses the scalar measurement `mag` in the measurement update. `false` ignores `mag`, for
        example in a magnetic storm, and requires the difference (`gradient`) or the vector
        (`vector_sigma_nt`). Default: `true`.
    vector_sigma_nt : float, optional
        Standard deviation of the white noise of each component of `vector`. If set, the
        components are used as measurements. They depend on the total field and on the attitude,
        but not on a rotation about the field direction. This key requires `core_field = true`
        and a calibrated vector magnetometer. Unit: nT. Allowed: above 0. Unset: the vector is
        not used as a measurement.
    vector_bias_sigma_nt : float, optional
        Standard deviation of the bias of each component of `vector`. In a field of 50,000 nT, a
        bias of 50 nT corresponds to an attitude error of 0.06°. Unit: nT. Allowed: 0 or above.
        Default: `50.0`.
    vector_bias_tau_s : float, optional
        Time constant of the bias of each component of `vector`. Unit: s. Allowed: above 0.
        Default: `3600.0`.
    vector_crustal_sigma_nt : float, optional
        Standard deviation, per component, of the crustal field that a map of the scalar anomaly
        leaves undetermined. A typical value is the standard deviation of the anomaly. Unit: nT.
        Allowed: 0 or above. Default: `50.0`.
    vector_crustal_length_m : float, optional
        Correlation length of the crustal field that `vector_crustal_sigma_nt` describes. A
        typical value is the height above the sources. Unit: m. Allowed: above 0. Default:
        `1000.0`.
    height : str, optional
        Column of measured heights above the ellipsoid, such as `baro`, from a barometer that
        does not already aid the INS. Unit: m. Unset: the height of the INS, aided by its
        barometer, is used.
    height_sigma_m : float, optional
        Standard deviation of the white noise of the measured height. Unit: m. Allowed: above 0.
        Default: `3.0`.
    height_bias_sigma_m : float, optional
        Standard deviation of the slowly varying error of the measured height, caused by the
        weather and the geoid. Unit: m. Allowed: 0 or above. Default: `30.0`.
    height_bias_tau_s : float, optional
        Time constant of the slowly varying error of the measured height. Unit: s. Allowed:
        above 0. Default: `3600.0`.
    map_sigma_nt : float, optional
        Standard deviation of the map error. If set, the filter estimates the map error as a
        state that is correlated along the track. Unit: nT. Allowed: 0 or above. Unset: the map
        error is not estimated.
    map_sigma_length_m : float, optional
        Distance over which the autocorrelation of the map error falls to 1/e. Unit: m. Allowed:
        above 0. Default: `500.0`.
    mag_latency_sigma_s : float, optional
        Prior standard deviation of the lag of the magnetometer's time stamps. If set, the
        filter estimates the lag as a state that is constant along the line. A sample with time
        stamp `t` was measured at `t` minus the lag. The lag may be negative. 0 omits this
        state. The columns `mag_latency` and `mag_latency_sigma` are appended. This key is
        available in `ekf`, `iekf` and `ukf`. Unit: s. Allowed: 0 or above. Unset: 1.0 with
        `tuning = "auto"` if a state for the lag clearly increases the likelihood, otherwise 0
        (exact time stamps).
    map_height_sigma_m : float, optional
        Prior standard deviation of a height bias: the true height of the aircraft minus its
        assumed height on the map. Possible causes are a constant error of the barometer, a
        missing geoid height, and a wrong map height. If set, the filter estimates the bias as a
        state that is constant along the line. The bias changes only the predicted total field,
        not `alt`. The heights to which the map is continued must include the true height of the
        aircraft. With `tuning = "auto"`, the map is continued to twice this standard deviation
        below and above the line. Otherwise, set `map_levels_m`. 0 omits this state. The columns
        `map_height_bias` and `map_height_bias_sigma` are appended. This key is available in
        `ekf`, `iekf` and `ukf`. Unit: m. Allowed: 0 or above. Unset: 50 with `tuning = "auto"`
        if a bias clearly increases the likelihood, otherwise 0 (exact height). To find a bias,
        `auto` continues the map up to 200 m below and above the line, unless `map_levels_m` is
        set.
    permanent_change_sigma_nt : float, optional
        Standard deviation of the change in the aircraft's permanent field since calibration,
        per component (nose, right, down). The filter estimates the three components as
        additional states. The attitude and the core field determine the effect of these
        components on the total field. A fourth state is a constant offset with a standard
        deviation of 100 nT. 0 omits these states. This key requires `core_field = true`, and is
        available in `ekf`, `iekf` and `ukf`. Unit: nT. Allowed: 0 or above. Unset: the
        maximum-likelihood estimate with `tuning = "auto"` if these states clearly increase the
        likelihood, otherwise 0.
    permanent_change_tau_s : float, optional
        Time constant of the change in the permanent field. Unit: s. Allowed: above 0. Unset:
        the maximum-likelihood estimate with `tuning = "auto"`, otherwise infinite, so that the
        change is constant along the line.
    flat_over_m : float, optional
        A sample corrects the position only if the ratio of its measurement noise (standard
        deviation) to the map's horizontal slope is at most this value. At a larger ratio, the
        map is too flat to observe the position. The sample is then `flat`: it corrects only the
        temporal variation and the map error. The column `map_slope` is appended. Unit: m.
        Allowed: above 0. Unset: all samples correct the position.

    Returns
    -------
    Track
        Estimate at each sample, innovations, warnings and notes.

    Raises
    ------
    SpecError
        If a key is unknown, has an invalid value, or has no effect.
    DataError
        If the line cannot be filtered, such as an INS with a NaN or a line off the map.
    ValueError
        If the shapes of the arrays differ.

    References
    ----------
    Gnadt 2022, section 5.5, without (5.39).

    Examples
    --------
    >>> import numpy as np
    >>> from magline import filters, maps
    >>> lat, lon = np.linspace(45.0, 45.2, 201), np.linspace(-76.1, -75.9, 201)
    >>> hills = 60.0 * np.sin(400.0 * lat[:, None]) + 50.0 * np.cos(500.0 * (lat[:, None] + lon))
    >>> field = maps.Map(lon, lat, hills, np.full(hills.shape, 300.0), 4326, "deg")
    >>> t = np.arange(100.0)  # northward over the nodes of a column; the INS is 11 m too far north
    >>> ins = t, lat[50:150] + 1e-4, np.full(100, lon[100]), np.full(100, 300.0)
    >>> start = {"start": "given", "init_position_sigma_m": 20.0}
    >>> columns = {"tl": (np.sin(t)[:, None], ["x"])}  # one term of the aircraft field
    >>> track = filters.ekf_online_tl(*ins, hills[50:150, 100], field, columns=columns, core_field=False, **start)
    >>> bool(abs(track.lat_deg[-1] - lat[149]) < 5e-5)
    True
    """
    return navigate_line("ekf_online_tl", locals())


def fixed_lag(
    tt_s: ArrayLike,
    ins_lat_deg: ArrayLike,
    ins_lon_deg: ArrayLike,
    ins_alt_m: ArrayLike,
    mag_nt: Magnetometers,
    map: Map,
    *,
    ins_velocity_ned_mps: ArrayLike | None = None,
    ins_force_ned_mps2: ArrayLike | None = None,
    ins_attitude_deg: ArrayLike | None = None,
    columns: Mapping[str, Any] | None = None,
    models: Sequence[Any] | None = None,
    rate_hz: float | None = None,
    tuning: Literal["auto", "magnav"] | None = None,
    core_field: bool | None = None,
    remove_diurnal: bool | None = None,
    decimal_year: float | None = None,
    map_interpolation: Literal["linear", "quadratic", "cubic"] | None = None,
    map_levels_m: ListLike | None = None,
    map_error_length_m: float | None = None,
    offset_window_s: float | None = None,
    measurement_sigma_nt: float | Literal["auto"] | None = None,
    fogm_sigma_nt: float | Literal["auto"] | None = None,
    fogm_tau_s: float | Literal["auto"] | None = None,
    noise_column: str | None = None,
    start: Literal["auto", "fix", "alignment", "given"] | None = None,
    fix: ListLike | None = None,
    fix_velocity: ListLike | None = None,
    fix_sigma_m: float | None = None,
    fix_alt_sigma_m: float | None = None,
    fix_velocity_sigma_mps: float | None = None,
    vector: str | None = None,
    sensor_axis: ListLike | None = None,
    dead_zones: Literal["none", "polar", "polar_and_equatorial"] | None = None,
    ins_grade: Literal["magnav", "navigation", "tactical", "commercial"] | None = None,
    init_position_sigma_m: float | None = None,
    init_altitude_sigma_m: float | None = None,
    init_velocity_sigma_mps: float | None = None,
    init_attitude_sigma_deg: float | None = None,
    init_heading_sigma_deg: float | None = None,
    vrw_sigma: float | None = None,
    arw_sigma: float | None = None,
    baro_sigma_m: float | None = None,
    ha_sigma_m: float | None = None,
    a_hat_sigma_mps2: float | None = None,
    acc_sigma_mps2: float | None = None,
    gyro_sigma_radps: float | None = None,
    baro_tau_s: float | None = None,
    acc_tau_s: float | None = None,
    gyro_tau_s: float | None = None,
    window_s: float | None = None,
    overlap: float | None = None,
    lag_s: float | None = None,
    measurement_interval_s: float | None = None,
    loss: Literal["none", "huber", "cauchy"] | None = None,
    loss_scale: float | None = None,
    iterations: int | None = None,
    aircraft_sigma_nt: float | None = None,
    aircraft_tau_s: float | None = None,
    walk_per_hour: float | None = None,
    discretisation: Literal["trapezoidal", "rectangular", "van_loan"] | None = None,
    terms: str | None = None,
    permanent_sigma_nt: float | None = None,
    induced_sigma_nt: float | None = None,
    eddy_sigma_nt_s: float | None = None,
    bias_sigma_nt: float | None = None,
    input_sigma_nt: float | None = None,
    heading_error_sigma_nt: float | None = None,
    prior_factor: float | None = None,
    gnss_lost_s: ListLike | None = None,
    gnss: ListLike | None = None,
    gnss_interval_s: float | None = None,
    gnss_sigma_m: float | None = None,
    gnss_alt_sigma_m: float | None = None,
    gnss_noise: bool | None = None,
    gnss_test: bool | None = None,
    gradient: ListLike | None = None,
    gradient_baseline_m: ListLike | None = None,
    gradient_sigma_nt: float | None = None,
    gradient_bias_sigma_nt: float | None = None,
    gradient_bias_tau_s: float | None = None,
    gradient_slope_sigma: float | Literal["auto"] | None = None,
    use_scalar: bool | None = None,
    vector_sigma_nt: float | None = None,
    vector_bias_sigma_nt: float | None = None,
    vector_bias_tau_s: float | None = None,
    vector_crustal_sigma_nt: float | None = None,
    vector_crustal_length_m: float | None = None,
    height: str | None = None,
    height_sigma_m: float | None = None,
    height_bias_sigma_m: float | None = None,
    height_bias_tau_s: float | None = None,
    map_sigma_nt: float | None = None,
    map_sigma_length_m: float | None = None,
    mag_latency_sigma_s: float | None = None,
    map_height_sigma_m: float | None = None,
    permanent_change_sigma_nt: float | None = None,
    permanent_change_tau_s: float | None = None,
    flat_over_m: float | None = None,
) -> Track:
    """A smoother over sliding windows that also estimates the aircraft field.

    Its states are the 18 states of `ekf`, the coefficients for the line's A-matrix, and a
    first-order Gauss-Markov error of the magnetometer. The smoother can start with an
    uncompensated magnetometer and without a calibration. At the start of the line, while the
    INS is accurate to metres, the map determines the coefficients.

    Each window is solved by Gauss-Newton iterations, each with a new linearisation of the map.
    Each window passes the filtered covariance of INS states and coefficients to the next
    window. Between the end of one window and the end of the next, a filter continues the track.
    The innovations of this filter give one `residual` and one `nis` per
    `measurement_interval_s`. With `lag_s = 0.0`, the track corresponds to real-time navigation.

    `fogm_sigma_nt` describes the temporal variation common to all magnetometers.
    `aircraft_sigma_nt` describes the residual of the linear aircraft model. Without an assumed
    noise for this residual, a filter with magnetometers in the cabin is overconfident.

    Parameters
    ----------
    tt_s : array_like
        Times of the samples, s, ascending, of shape (samples,).
    ins_lat_deg : array_like
        Latitude of the INS, degrees, of shape (samples,).
    ins_lon_deg : array_like
        Longitude of the INS, degrees, of shape (samples,).
    ins_alt_m : array_like
        Height of the INS above the WGS-84 ellipsoid, m, of shape (samples,).
    mag_nt : Magnetometers
        Measured field, nT, of shape (samples,); NaN where there is no measurement. A mapping
        holds several magnetometers under the names of their columns, such as `mag_1_c`
        (compensated) or `mag_1_uc`.
    map : Map
        Anomaly map, such as the result of `magline.maps.open`.
    ins_velocity_ned_mps : array_like, optional
        Velocity of the INS north, east and down, m/s, of shape (samples, 3). Default: derived
        from its positions.
    ins_force_ned_mps2 : array_like, optional
        Specific force of the INS north, east and down, m/s^2, of shape (samples, 3). Default:
        derived from its velocities.
    ins_attitude_deg : array_like, optional
        Roll, pitch and yaw of the INS, degrees, of shape (samples, 3). Default: level, along
        the course.
    columns : Mapping[str, Any], optional
        Further columns of the flight table under their names, in its units: those that keys
        name, and those that the stage uses if they are there, such as `diurnal` (nT), `year`,
        `doy`, `gnss_lat` (deg), `ins_aligned` (s), and the truth `lat` and `lon` (deg) and
        `alt` (m). A value is an array of shape (samples,), one number or text for all samples,
        or a pair of a matrix with one row per sample and the names of its columns.
    models : Sequence[Any], optional
        Calibrations that give the prior of the coefficients: tables of `fit` as mappings or
        data frames with the columns `term`, `value`, `std` (nT) and, if known, `rate_hz` (Hz).
        Default: a cold start.
    rate_hz : float, optional
        Sample rate of the terms that are differences per sample, Hz. Default: the rate of
        `tt_s`.
    tuning : {"auto", "magnav"}, optional
        Source of unset parameters. `auto` estimates the noise of each line from the likelihood
        of its innovations, rejects outliers, and continues a map of known height to the flight
        heights. `magnav` uses the defaults of MagNav.jl, no gate, and the map at its own
        height. A key in the spec takes precedence over both. Default: `"auto"`.
    core_field : bool, optional
        Adds the core field to the predicted measurement. `false` means that the measurement is
        an anomaly. Default: `true`.
    remove_diurnal : bool, optional
        Subtracts the column `diurnal` from the measurement, so that the filter need not
        estimate the temporal variation. A sample with a NaN in `diurnal` has no measurement.
        Unset: true if the flight has a column `diurnal` that has not yet been subtracted from
        the measurement.
    decimal_year : float, optional
        Date of the core field as a decimal year. It replaces the flight's date. Unit: a.
        Allowed: 1900 to 2030. Unset: the flight's own date.
    map_interpolation : {"linear", "quadratic", "cubic"}, optional
        Interpolation of the map. The field above its sources is smooth, so spline interpolation
        is more accurate than bilinear interpolation. Unset: `cubic` with `tuning = "auto"`,
        else `linear`.
    map_levels_m : ListLike, optional
        Heights above the ellipsoid, ascending, to which the map is continued. Between these
        heights the map is interpolated linearly. Unit: m. Unset: with `tuning = "auto"` the map
        is continued to the flight heights, otherwise it is used at its own height.
    map_error_length_m : float, optional
        Correlation length of the map error, for a map with the column `error` (`map_grid`,
        `track_map`); typically the spacing of its survey lines. The correlated map error is
        converted to equivalent white noise, which is added to the measurement noise of each
        sample. The map error is interpolated at the position that an extended Kalman filter
        predicts. Unit: m. Allowed: above 0. Unset: the map is assumed to be exact; `tuning =
        "auto"` instead uses the map's column `error`, or the error of the map's interpolation,
        times an estimated factor.
    offset_window_s : float, optional
        Length of the window at the start of a line in which an offset is computed: the mean of
        measurement minus prediction. The offset is subtracted from all measurements of the line
        before filtering, because compensation leaves a constant undetermined. 0 subtracts
        nothing. Unit: s. Allowed: 0 or above. Default: `0.0`.
    measurement_sigma_nt : float | {"auto"}, optional
        Standard deviation of the white noise of a measurement. It includes the noise of the
        sensor, the map and the compensation. `"auto"` uses the noise of the calibration
        residual, from the column `mag_sigma`. Unit: nT. Allowed: above 0. Unset: the
        maximum-likelihood estimate with `tuning = "auto"`, otherwise 5.0.
    fogm_sigma_nt : float | {"auto"}, optional
        Standard deviation of the first-order Gauss-Markov process for the temporal variation
        and all other slow errors. `"auto"` uses the column `mag_fogm_sigma`. Unit: nT. Allowed:
        0 or above. Unset: the maximum-likelihood estimate with `tuning = "auto"`, otherwise
        3.0.
    fogm_tau_s : float | {"auto"}, optional
        Time constant of the temporal variation. `"auto"` uses the column `mag_fogm_tau`. Unit:
        s. Allowed: above 0. Unset: the maximum-likelihood estimate with `tuning = "auto"`,
        otherwise 600.0.
    noise_column : str, optional
        Column with the standard deviation of an additional error of each sample:
        `mag_aircraft_sigma` of an ensemble, or the predicted error of a network. The square of
        this standard deviation is added to the square of `measurement_sigma_nt`. A sample
        without a value in this column has no measurement. Requires a single magnetometer. Unit:
        nT. Unset: equal noise at all samples.
    start : {"auto", "fix", "alignment", "given"}, optional
        Source of the initial estimate. `fix` corrects the INS with a position fix. `alignment`
        propagates the `init_*` standard deviations from the alignment to the start of the line.
        `given` applies the `init_*` standard deviations at the start of the line; the defaults
        are valid only within minutes of the alignment, because an INS drifts. `auto` selects
        one of the three from the keys and columns. Default: `"auto"`.
    fix : ListLike, optional
        Columns with the latitude (deg), longitude (deg) and height (m) of the fix. The first
        values within 2 s of the line's start are used. If the columns have the role truth,
        white noise with the fix's standard deviations is added. The added noise of a line is
        the same in every run. Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has
        them, else `lat`, `lon` and `alt`.
    fix_velocity : ListLike, optional
        Columns of the fix's velocity components: north, east and down. Unit: m/s. Unset:
        `gnss_vn`, `gnss_ve` and `gnss_vd` for a fix from `gnss_*` columns, otherwise `vn`, `ve`
        and `vd`; without these columns, the velocity of the INS.
    fix_sigma_m : float, optional
        Standard deviation of the fix's position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `3.0`.
    fix_alt_sigma_m : float, optional
        Standard deviation of the fix's height. Unit: m. Allowed: above 0. Default: `5.0`.
    fix_velocity_sigma_mps : float, optional
        Standard deviation of each component of the fix's velocity. Unit: m/s. Allowed: above 0.
        Default: `0.1`.
    vector : str, optional
        Vector magnetometer that gives the direction of the field, such as `flux_a`. The noise
        of this magnetometer, and the aircraft field at its position, are neglected. Unset:
        equal noise in all attitudes.
    sensor_axis : ListLike, optional
        Axis of the scalar sensor in the frame of the vector magnetometer: nose, right, down.
        Allowed: finite. Default: `[1.0,0.0,0.0]`.
    dead_zones : {"none", "polar", "polar_and_equatorial"}, optional
        Dead zones of the scalar sensor: along its axis (`polar`), or also across its axis
        (`polar_and_equatorial`). The assumed noise is inversely proportional to the amplitude
        of the sensor's signal. At the largest amplitude, the noise is `measurement_sigma_nt`. A
        sample whose amplitude is below a tenth of the largest gives no measurement. Default:
        `"none"`.
    ins_grade : {"magnav", "navigation", "tactical", "commercial"}, optional
        Grade of the INS. The grade sets the INS keys (`init_*`, `*_sigma*` and `*_tau_s`) that
        are unset in the spec. `magnav` sets the defaults shown for these keys. `navigation` is
        a Honeywell HG9900, `tactical` a Honeywell HG1700, and `commercial` has micro-mechanical
        sensors [Lee 2019, Tables 9 and 10]. For these three grades, the position at alignment
        is exact (`init_position_sigma_m = 0`). Unset: in `navigate`, the flight's column
        `ins_grade` if present; otherwise `magnav`.
    init_position_sigma_m : float, optional
        Standard deviation of the initial horizontal position error along each axis. Unit: m.
        Allowed: 0 or above. Default: `3.0`.
    init_altitude_sigma_m : float, optional
        Standard deviation of the initial height error. Unit: m. Allowed: 0 or above. Default:
        `0.001`.
    init_velocity_sigma_mps : float, optional
        Standard deviation of the initial velocity error along each axis. Unit: m/s. Allowed: 0
        or above. Default: `0.01`.
    init_attitude_sigma_deg : float, optional
        Standard deviation of the initial tilt error about each axis. Unit: deg. Allowed: 0 or
        above. Default: `0.01`.
    init_heading_sigma_deg : float, optional
        Standard deviation of the initial yaw error, the tilt about the down axis. In practice,
        the yaw error exceeds the other tilt errors, because the INS finds north from the
        earth's rotation, a much weaker signal than gravity. Unit: deg. Allowed: 0 or above.
        Unset: the initial tilt error.
    vrw_sigma : float, optional
        Velocity random walk: square root of the spectral density of the accelerometer noise.
        Unit: m/s^1.5. Allowed: 0 or above. Default: `0.000238`.
    arw_sigma : float, optional
        Angular random walk: square root of the spectral density of the gyro noise. Unit:
        rad/s^0.5. Allowed: 0 or above. Default: `5.81e-7`.
    baro_sigma_m : float, optional
        Standard deviation of the barometer error. Unit: m. Allowed: 0 or above. Default: `1.0`.
    ha_sigma_m : float, optional
        Standard deviation of the initial error of the altitude in the barometer loop, which
        aids the INS height. Unit: m. Allowed: 0 or above. Default: `0.001`.
    a_hat_sigma_mps2 : float, optional
        Standard deviation of the initial error of the vertical acceleration in the barometer
        loop, which aids the INS height. Unit: m/s2. Allowed: 0 or above. Default: `0.01`.
    acc_sigma_mps2 : float, optional
        Standard deviation of the accelerometer bias. Unit: m/s2. Allowed: 0 or above. Default:
        `0.000245`.
    gyro_sigma_radps : float, optional
        Standard deviation of the gyro bias. Unit: rad/s. Allowed: 0 or above. Default:
        `7.27e-9`.
    baro_tau_s : float, optional
        Time constant of the barometer error. Unit: s. Allowed: above 0. Default: `3600.0`.
    acc_tau_s : float, optional
        Time constant of the accelerometer bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    gyro_tau_s : float, optional
        Time constant of the gyro bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    window_s : float, optional
        Length of a window. Unit: s. Allowed: above 0. Default: `300.0`.
    overlap : float, optional
        Fraction of a window that overlaps with the next window. A window ends every `window_s`
        × (1 - `overlap`) seconds. Allowed: 0 to 0.999. Default: `0.95`.
    lag_s : float, optional
        Delay of the estimate, which uses measurements up to this time after the sample. 0 gives
        real-time navigation. Unit: s. Allowed: 0 or above. Default: `0.0`.
    measurement_interval_s : float, optional
        Interval over which measurements are averaged into one. 0 uses every sample. Unit: s.
        Allowed: 0 or above. Default: `1.0`.
    loss : {"none", "huber", "cauchy"}, optional
        Loss function of a residual: quadratic (`none`), or robust to outliers (`huber`,
        `cauchy`). Default: `"none"`.
    loss_scale : float, optional
        Residual above which a robust `loss` departs from the quadratic loss, in standard
        deviations of the measurement. Allowed: above 0. Default: `2.5`.
    iterations : int, optional
        Maximum number of iterations per window. Default: `15`.
    aircraft_sigma_nt : float, optional
        Standard deviation of the slowly varying aircraft field that the coefficients do not
        explain. 0 assumes no such field. Unit: nT. Allowed: 0 or above. Unset: 30.0; 0 if
        `tuning = "auto"` estimates the noise of the line, because the estimated noise includes
        this field.
    aircraft_tau_s : float, optional
        Time constant of the slowly varying aircraft field that the coefficients do not explain.
        Unit: s. Allowed: above 0. Default: `300.0`.
    walk_per_hour : float, optional
        Random walk of a coefficient: standard deviation of the change in one hour, divided by
        the prior standard deviation. With 0 the coefficients are constants. Allowed: 0 or
        above. Default: `0.0`.
    discretisation : {"trapezoidal", "rectangular", "van_loan"}, optional
        Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of
        first order as in MagNav.jl, and `van_loan` exact. Default: `"trapezoidal"`.
    terms : str, optional
        List column of the terms, as made by `a_matrix`. Default: `"tl"`.
    permanent_sigma_nt : float, optional
        Standard deviation of the zero-mean prior of a permanent coefficient, unless `model`
        supplies a prior. Unit: nT. Allowed: above 0. Default: `2000.0`.
    induced_sigma_nt : float, optional
        Standard deviation of the zero-mean prior of an induced coefficient, unless `model`
        supplies a prior. Unit: nT. Allowed: above 0. Default: `1000.0`.
    eddy_sigma_nt_s : float, optional
        Prior standard deviation of an eddy coefficient at one sample per second. An eddy term
        contains the change of the field from one sample to the next, so this value is
        multiplied by the sample rate of the line. Unit: nT s. Allowed: above 0. Default:
        `500.0`.
    bias_sigma_nt : float, optional
        Prior standard deviation of the constant `bias`. Unit: nT. Allowed: above 0. Default:
        `500.0`.
    input_sigma_nt : float, optional
        Prior standard deviation of the coefficient of any other term, such as an electric
        current, in nT per unit of the term. A current loop in the cabin causes a few nT per
        ampere. Unit: nT. Allowed: above 0. Default: `20.0`.
    heading_error_sigma_nt : float, optional
        Prior standard deviation of each harmonic of the magnetometer's heading error. The terms
        `heading_1`, `heading_2` and `heading_4` are the first, second and fourth harmonics of
        the angle between the sensor axis and the field. This key requires `vector`. Unit: nT.
        Allowed: above 0. Unset: the heading error is not estimated.
    prior_factor : float, optional
        Factor on the prior standard deviations from `model`. A single calibration supplies the
        standard deviations of its fit. Several calibrations supply the scatter between them.
        Some terms, such as eddy terms, are differences between samples. The coefficients of
        these terms are converted from the sample rate of the fit to the sample rate of the
        line. At rates below about 5 Hz, the differences are inaccurate in manoeuvres: they
        underestimate a change at frequency f by the fraction (2 pi f / rate)^2 / 6. Allowed:
        above 0. Default: `1.0`.
    gnss_lost_s : ListLike, optional
        Times at which GNSS is lost and recovered, in seconds from the first sample of the line.
        Before the loss and after the recovery, the GNSS position (columns `gnss`) aids the
        filter. With `[0.0, 600.0]`, GNSS is missing for the first ten minutes of the line. If
        the recovery time is after the end of the line, GNSS is never recovered. Unit: s.
        Allowed: 0 or above. Unset: GNSS is not used.
    gnss : ListLike, optional
        Columns with the GNSS latitude (deg), longitude (deg) and height above the ellipsoid
        (m). Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has them, else `lat`,
        `lon` and `alt`.
    gnss_interval_s : float, optional
        Time between successive GNSS positions. Unit: s. Allowed: above 0. Default: `1.0`.
    gnss_sigma_m : float, optional
        Standard deviation of the GNSS position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `2.0`.
    gnss_alt_sigma_m : float, optional
        Standard deviation of the GNSS height. Unit: m. Allowed: above 0. Default: `5.0`.
    gnss_noise : bool, optional
        Adds white noise to the GNSS positions, with the standard deviations `gnss_sigma_m` and
        `gnss_alt_sigma_m`. The added noise of a line is the same in every run. True positions
        have no error: without added noise, the filter appears more accurate than with real
        GNSS. Unset: true if the columns of `gnss` have the role `truth`.
    gnss_test : bool, optional
        Tests each GNSS position against the INS position and does not use rejected positions. A
        chi-square test of each position detects a jump at once. A cumulative sum over earlier
        positions detects a drift of 1 m/s after about 10 s. The test then also rejects the
        positions since the start of the drift. Positions are accepted again after ten
        consecutive positions agree with the INS. The column `gnss_update` (`used`, `rejected`
        or `none`) is appended even if this key is false. Default: `true`.
    gradient : ListLike, optional
        Two compensated scalar magnetometers. The difference between their readings, first minus
        second, measures the slope of the map along the baseline between them. The temporal
        variation and all other common errors cancel in this difference. This key cannot be
        combined with `map_interpolation = "linear"`, because the slope of a bilinear map has
        steps. Unit: nT. Unset: the difference is not used.
    gradient_baseline_m : ListLike, optional
        Vector from the second magnetometer of `gradient` to the first, in the body frame (nose,
        right, down). The INS attitude rotates this vector to the navigation frame. The
        measurement model includes the estimated error of the INS attitude. Unit: m. Allowed:
        finite. Unset: required with `gradient`.
    gradient_sigma_nt : float, optional
        Standard deviation of the white noise in the difference between the two magnetometers'
        readings. Unit: nT. Allowed: above 0. Default: `0.1`.
    gradient_bias_sigma_nt : float, optional
        Standard deviation of the slowly varying error in the difference between the two
        magnetometers' readings. Such an error is likely, because each calibration leaves a
        constant undetermined. Unit: nT. Allowed: 0 or above. Default: `1.0`.
    gradient_bias_tau_s : float, optional
        Time constant of the slowly varying error in the difference between the two
        magnetometers' readings. Unit: s. Allowed: above 0. Default: `3600.0`.
    gradient_slope_sigma : float | {"auto"}, optional
        Standard deviation of the error in the map's slope along the baseline. The error of the
        predicted difference is this error times the length of the baseline. The error is
        correlated along the track, over the same length as the map's anomalies. `"auto"` uses
        the maximum-likelihood value from the innovations of the difference. A large value can
        reveal a map made from widely spaced lines. A map at one height without `map_levels_m`
        has no vertical slope. The prediction then has an additional error: the height
        difference between the magnetometers times the rms slope. Unit: nT/m. Allowed: 0 or
        above. Default: `auto`.
    use_scalar : bool, optional
        Uses the scalar measurement `mag` in the measurement update. `false` ignores `mag`, for
        example in a magnetic storm, and requires the difference (`gradient`) or the vector
        (`vector_sigma_nt`). Default: `true`.
    vector_sigma_nt : float, optional
        Standard deviation of the white noise of each component of `vector`. If set, the
        components are used as measurements. They depend on the total field and on the attitude,
        but not on a rotation about the field direction. This key requires `core_field = true`
        and a calibrated vector magnetometer. Unit: nT. Allowed: above 0. Unset: the vector is
        not used as a measurement.
    vector_bias_sigma_nt : float, optional
        Standard deviation of the bias of each component of `vector`. In a field of 50,000 nT, a
        bias of 50 nT corresponds to an attitude error of 0.06°. Unit: nT. Allowed: 0 or above.
        Default: `50.0`.
    vector_bias_tau_s : float, optional
        Time constant of the bias of each component of `vector`. Unit: s. Allowed: above 0.
        Default: `3600.0`.
    vector_crustal_sigma_nt : float, optional
        Standard deviation, per component, of the crustal field that a map of the scalar anomaly
        leaves undetermined. A typical value is the standard deviation of the anomaly. Unit: nT.
        Allowed: 0 or above. Default: `50.0`.
    vector_crustal_length_m : float, optional
        Correlation length of the crustal field that `vector_crustal_sigma_nt` describes. A
        typical value is the height above the sources. Unit: m. Allowed: above 0. Default:
        `1000.0`.
    height : str, optional
        Column of measured heights above the ellipsoid, such as `baro`, from a barometer that
        does not already aid the INS. Unit: m. Unset: the height of the INS, aided by its
        barometer, is used.
    height_sigma_m : float, optional
        Standard deviation of the white noise of the measured height. Unit: m. Allowed: above 0.
        Default: `3.0`.
    height_bias_sigma_m : float, optional
        Standard deviation of the slowly varying error of the measured height, caused by the
        weather and the geoid. Unit: m. Allowed: 0 or above. Default: `30.0`.
    height_bias_tau_s : float, optional
        Time constant of the slowly varying error of the measured height. Unit: s. Allowed:
        above 0. Default: `3600.0`.
    map_sigma_nt : float, optional
        Standard deviation of the map error. If set, the filter estimates the map error as a
        state that is correlated along the track. Unit: nT. Allowed: 0 or above. Unset: the map
        error is not estimated.
    map_sigma_length_m : float, optional
        Distance over which the autocorrelation of the map error falls to 1/e. Unit: m. Allowed:
        above 0. Default: `500.0`.
    mag_latency_sigma_s : float, optional
        Prior standard deviation of the lag of the magnetometer's time stamps. If set, the
        filter estimates the lag as a state that is constant along the line. A sample with time
        stamp `t` was measured at `t` minus the lag. The lag may be negative. 0 omits this
        state. The columns `mag_latency` and `mag_latency_sigma` are appended. This key is
        available in `ekf`, `iekf` and `ukf`. Unit: s. Allowed: 0 or above. Unset: 1.0 with
        `tuning = "auto"` if a state for the lag clearly increases the likelihood, otherwise 0
        (exact time stamps).
    map_height_sigma_m : float, optional
        Prior standard deviation of a height bias: the true height of the aircraft minus its
        assumed height on the map. Possible causes are a constant error of the barometer, a
        missing geoid height, and a wrong map height. If set, the filter estimates the bias as a
        state that is constant along the line. The bias changes only the predicted total field,
        not `alt`. The heights to which the map is continued must include the true height of the
        aircraft. With `tuning = "auto"`, the map is continued to twice this standard deviation
        below and above the line. Otherwise, set `map_levels_m`. 0 omits this state. The columns
        `map_height_bias` and `map_height_bias_sigma` are appended. This key is available in
        `ekf`, `iekf` and `ukf`. Unit: m. Allowed: 0 or above. Unset: 50 with `tuning = "auto"`
        if a bias clearly increases the likelihood, otherwise 0 (exact height). To find a bias,
        `auto` continues the map up to 200 m below and above the line, unless `map_levels_m` is
        set.
    permanent_change_sigma_nt : float, optional
        Standard deviation of the change in the aircraft's permanent field since calibration,
        per component (nose, right, down). The filter estimates the three components as
        additional states. The attitude and the core field determine the effect of these
        components on the total field. A fourth state is a constant offset with a standard
        deviation of 100 nT. 0 omits these states. This key requires `core_field = true`, and is
        available in `ekf`, `iekf` and `ukf`. Unit: nT. Allowed: 0 or above. Unset: the
        maximum-likelihood estimate with `tuning = "auto"` if these states clearly increase the
        likelihood, otherwise 0.
    permanent_change_tau_s : float, optional
        Time constant of the change in the permanent field. Unit: s. Allowed: above 0. Unset:
        the maximum-likelihood estimate with `tuning = "auto"`, otherwise infinite, so that the
        change is constant along the line.
    flat_over_m : float, optional
        A sample corrects the position only if the ratio of its measurement noise (standard
        deviation) to the map's horizontal slope is at most this value. At a larger ratio, the
        map is too flat to observe the position. The sample is then `flat`: it corrects only the
        temporal variation and the map error. The column `map_slope` is appended. Unit: m.
        Allowed: above 0. Unset: all samples correct the position.

    Returns
    -------
    Track
        Estimate at each sample, innovations, warnings and notes.

    Raises
    ------
    SpecError
        If a key is unknown, has an invalid value, or has no effect.
    DataError
        If the line cannot be filtered, such as an INS with a NaN or a line off the map.
    ValueError
        If the shapes of the arrays differ.

    References
    ----------
    fixed-lag factor-graph smoothing for the windows and their prior. Each window is an iterated
    smoother [Bell 1994] in Bryson-Frazier form [Bierman 1973].

    Examples
    --------
    >>> import numpy as np
    >>> from magline import filters, maps
    >>> lat, lon = np.linspace(45.0, 45.2, 201), np.linspace(-76.1, -75.9, 201)
    >>> hills = 60.0 * np.sin(400.0 * lat[:, None]) + 50.0 * np.cos(500.0 * (lat[:, None] + lon))
    >>> field = maps.Map(lon, lat, hills, np.full(hills.shape, 300.0), 4326, "deg")
    >>> t = np.arange(100.0)  # northward over the nodes of a column; the INS is 11 m too far north
    >>> ins = t, lat[50:150] + 1e-4, np.full(100, lon[100]), np.full(100, 300.0)
    >>> start = {"start": "given", "init_position_sigma_m": 20.0}
    >>> columns = {"tl": (np.sin(t)[:, None], ["x"])}  # one term of the aircraft field
    >>> track = filters.fixed_lag(*ins, hills[50:150, 100], field, columns=columns, core_field=False, **start)
    >>> bool(abs(track.lat_deg[-1] - lat[149]) < 5e-5)
    True
    """
    return navigate_line("fixed_lag", locals())


def rts(
    tt_s: ArrayLike,
    ins_lat_deg: ArrayLike,
    ins_lon_deg: ArrayLike,
    ins_alt_m: ArrayLike,
    mag_nt: Magnetometers,
    map: Map,
    *,
    ins_velocity_ned_mps: ArrayLike | None = None,
    ins_force_ned_mps2: ArrayLike | None = None,
    ins_attitude_deg: ArrayLike | None = None,
    columns: Mapping[str, Any] | None = None,
    tuning: Literal["auto", "magnav"] | None = None,
    core_field: bool | None = None,
    remove_diurnal: bool | None = None,
    decimal_year: float | None = None,
    map_interpolation: Literal["linear", "quadratic", "cubic"] | None = None,
    map_levels_m: ListLike | None = None,
    map_error_length_m: float | None = None,
    offset_window_s: float | None = None,
    measurement_sigma_nt: float | Literal["auto"] | None = None,
    fogm_sigma_nt: float | Literal["auto"] | None = None,
    fogm_tau_s: float | Literal["auto"] | None = None,
    noise_column: str | None = None,
    start: Literal["auto", "fix", "alignment", "given"] | None = None,
    fix: ListLike | None = None,
    fix_velocity: ListLike | None = None,
    fix_sigma_m: float | None = None,
    fix_alt_sigma_m: float | None = None,
    fix_velocity_sigma_mps: float | None = None,
    vector: str | None = None,
    sensor_axis: ListLike | None = None,
    dead_zones: Literal["none", "polar", "polar_and_equatorial"] | None = None,
    ins_grade: Literal["magnav", "navigation", "tactical", "commercial"] | None = None,
    init_position_sigma_m: float | None = None,
    init_altitude_sigma_m: float | None = None,
    init_velocity_sigma_mps: float | None = None,
    init_attitude_sigma_deg: float | None = None,
    init_heading_sigma_deg: float | None = None,
    vrw_sigma: float | None = None,
    arw_sigma: float | None = None,
    baro_sigma_m: float | None = None,
    ha_sigma_m: float | None = None,
    a_hat_sigma_mps2: float | None = None,
    acc_sigma_mps2: float | None = None,
    gyro_sigma_radps: float | None = None,
    baro_tau_s: float | None = None,
    acc_tau_s: float | None = None,
    gyro_tau_s: float | None = None,
    iterations: int | None = None,
    tolerance_m: float | None = None,
    loss: Literal["none", "huber", "cauchy"] | None = None,
    loss_scale: float | None = None,
    save_state: bool | None = None,
    discretisation: Literal["trapezoidal", "rectangular", "van_loan"] | None = None,
    gnss_lost_s: ListLike | None = None,
    gnss: ListLike | None = None,
    gnss_interval_s: float | None = None,
    gnss_sigma_m: float | None = None,
    gnss_alt_sigma_m: float | None = None,
    gnss_noise: bool | None = None,
    gnss_test: bool | None = None,
    gradient: ListLike | None = None,
    gradient_baseline_m: ListLike | None = None,
    gradient_sigma_nt: float | None = None,
    gradient_bias_sigma_nt: float | None = None,
    gradient_bias_tau_s: float | None = None,
    gradient_slope_sigma: float | Literal["auto"] | None = None,
    use_scalar: bool | None = None,
    vector_sigma_nt: float | None = None,
    vector_bias_sigma_nt: float | None = None,
    vector_bias_tau_s: float | None = None,
    vector_crustal_sigma_nt: float | None = None,
    vector_crustal_length_m: float | None = None,
    height: str | None = None,
    height_sigma_m: float | None = None,
    height_bias_sigma_m: float | None = None,
    height_bias_tau_s: float | None = None,
    map_sigma_nt: float | None = None,
    map_sigma_length_m: float | None = None,
    mag_latency_sigma_s: float | None = None,
    map_height_sigma_m: float | None = None,
    permanent_change_sigma_nt: float | None = None,
    permanent_change_tau_s: float | None = None,
    flat_over_m: float | None = None,
) -> Track:
    """A smoother for post-processing.

    It computes the most probable track, and the covariance of this track, given all
    measurements on the line. Each iteration linearises the map along the track and passes
    forward and backward over the line, until the track converges. At the last sample, the
    smoother is as accurate as a filter. At earlier samples, its error is a few times smaller.

    The position of a sample uses all measurements. `residual` and `nis` use only earlier
    measurements, so the expected value of `nis` is 1, as for a filter. A robust loss limits the
    influence of outliers. With `huber`, the influence of an outlier is constant. With `cauchy`,
    the influence decreases as the residual increases, which requires a good initial track.
    `smoothing` is `converged`, or `stopped` if the track did not converge within `iterations`.
    `smoothing_step` is the largest position change in the last iteration.

    A line takes five to ten times as long as with `ekf`, and requires 0.8 kB of memory per
    sample (2.6 kB more with `save_state`). With additional measurements, such as `gradient`, a
    line requires 15 kB per sample. The smoother then tries a single initial track instead of up
    to four, and a robust loss applies only to the total field.

    Parameters
    ----------
    tt_s : array_like
        Times of the samples, s, ascending, of shape (samples,).
    ins_lat_deg : array_like
        Latitude of the INS, degrees, of shape (samples,).
    ins_lon_deg : array_like
        Longitude of the INS, degrees, of shape (samples,).
    ins_alt_m : array_like
        Height of the INS above the WGS-84 ellipsoid, m, of shape (samples,).
    mag_nt : Magnetometers
        Measured field, nT, of shape (samples,); NaN where there is no measurement. A mapping
        holds several magnetometers under the names of their columns, such as `mag_1_c`
        (compensated) or `mag_1_uc`.
    map : Map
        Anomaly map, such as the result of `magline.maps.open`.
    ins_velocity_ned_mps : array_like, optional
        Velocity of the INS north, east and down, m/s, of shape (samples, 3). Default: derived
        from its positions.
    ins_force_ned_mps2 : array_like, optional
        Specific force of the INS north, east and down, m/s^2, of shape (samples, 3). Default:
        derived from its velocities.
    ins_attitude_deg : array_like, optional
        Roll, pitch and yaw of the INS, degrees, of shape (samples, 3). Default: level, along
        the course.
    columns : Mapping[str, Any], optional
        Further columns of the flight table under their names, in its units: those that keys
        name, and those that the stage uses if they are there, such as `diurnal` (nT), `year`,
        `doy`, `gnss_lat` (deg), `ins_aligned` (s), and the truth `lat` and `lon` (deg) and
        `alt` (m). A value is an array of shape (samples,), one number or text for all samples,
        or a pair of a matrix with one row per sample and the names of its columns.
    tuning : {"auto", "magnav"}, optional
        Source of unset parameters. `auto` estimates the noise of each line from the likelihood
        of its innovations, rejects outliers, and continues a map of known height to the flight
        heights. `magnav` uses the defaults of MagNav.jl, no gate, and the map at its own
        height. A key in the spec takes precedence over both. Default: `"auto"`.
    core_field : bool, optional
        Adds the core field to the predicted measurement. `false` means that the measurement is
        an anomaly. Default: `true`.
    remove_diurnal : bool, optional
        Subtracts the column `diurnal` from the measurement, so that the filter need not
        estimate the temporal variation. A sample with a NaN in `diurnal` has no measurement.
        Unset: true if the flight has a column `diurnal` that has not yet been subtracted from
        the measurement.
    decimal_year : float, optional
        Date of the core field as a decimal year. It replaces the flight's date. Unit: a.
        Allowed: 1900 to 2030. Unset: the flight's own date.
    map_interpolation : {"linear", "quadratic", "cubic"}, optional
        Interpolation of the map. The field above its sources is smooth, so spline interpolation
        is more accurate than bilinear interpolation. Unset: `cubic` with `tuning = "auto"`,
        else `linear`.
    map_levels_m : ListLike, optional
        Heights above the ellipsoid, ascending, to which the map is continued. Between these
        heights the map is interpolated linearly. Unit: m. Unset: with `tuning = "auto"` the map
        is continued to the flight heights, otherwise it is used at its own height.
    map_error_length_m : float, optional
        Correlation length of the map error, for a map with the column `error` (`map_grid`,
        `track_map`); typically the spacing of its survey lines. The correlated map error is
        converted to equivalent white noise, which is added to the measurement noise of each
        sample. The map error is interpolated at the position that an extended Kalman filter
        predicts. Unit: m. Allowed: above 0. Unset: the map is assumed to be exact; `tuning =
        "auto"` instead uses the map's column `error`, or the error of the map's interpolation,
        times an estimated factor.
    offset_window_s : float, optional
        Length of the window at the start of a line in which an offset is computed: the mean of
        measurement minus prediction. The offset is subtracted from all measurements of the line
        before filtering, because compensation leaves a constant undetermined. 0 subtracts
        nothing. Unit: s. Allowed: 0 or above. Default: `0.0`.
    measurement_sigma_nt : float | {"auto"}, optional
        Standard deviation of the white noise of a measurement. It includes the noise of the
        sensor, the map and the compensation. `"auto"` uses the noise of the calibration
        residual, from the column `mag_sigma`. Unit: nT. Allowed: above 0. Unset: the
        maximum-likelihood estimate with `tuning = "auto"`, otherwise 5.0.
    fogm_sigma_nt : float | {"auto"}, optional
        Standard deviation of the first-order Gauss-Markov process for the temporal variation
        and all other slow errors. `"auto"` uses the column `mag_fogm_sigma`. Unit: nT. Allowed:
        0 or above. Unset: the maximum-likelihood estimate with `tuning = "auto"`, otherwise
        3.0.
    fogm_tau_s : float | {"auto"}, optional
        Time constant of the temporal variation. `"auto"` uses the column `mag_fogm_tau`. Unit:
        s. Allowed: above 0. Unset: the maximum-likelihood estimate with `tuning = "auto"`,
        otherwise 600.0.
    noise_column : str, optional
        Column with the standard deviation of an additional error of each sample:
        `mag_aircraft_sigma` of an ensemble, or the predicted error of a network. The square of
        this standard deviation is added to the square of `measurement_sigma_nt`. A sample
        without a value in this column has no measurement. Requires a single magnetometer. Unit:
        nT. Unset: equal noise at all samples.
    start : {"auto", "fix", "alignment", "given"}, optional
        Source of the initial estimate. `fix` corrects the INS with a position fix. `alignment`
        propagates the `init_*` standard deviations from the alignment to the start of the line.
        `given` applies the `init_*` standard deviations at the start of the line; the defaults
        are valid only within minutes of the alignment, because an INS drifts. `auto` selects
        one of the three from the keys and columns. Default: `"auto"`.
    fix : ListLike, optional
        Columns with the latitude (deg), longitude (deg) and height (m) of the fix. The first
        values within 2 s of the line's start are used. If the columns have the role truth,
        white noise with the fix's standard deviations is added. The added noise of a line is
        the same in every run. Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has
        them, else `lat`, `lon` and `alt`.
    fix_velocity : ListLike, optional
        Columns of the fix's velocity components: north, east and down. Unit: m/s. Unset:
        `gnss_vn`, `gnss_ve` and `gnss_vd` for a fix from `gnss_*` columns, otherwise `vn`, `ve`
        and `vd`; without these columns, the velocity of the INS.
    fix_sigma_m : float, optional
        Standard deviation of the fix's position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `3.0`.
    fix_alt_sigma_m : float, optional
        Standard deviation of the fix's height. Unit: m. Allowed: above 0. Default: `5.0`.
    fix_velocity_sigma_mps : float, optional
        Standard deviation of each component of the fix's velocity. Unit: m/s. Allowed: above 0.
        Default: `0.1`.
    vector : str, optional
        Vector magnetometer that gives the direction of the field, such as `flux_a`. The noise
        of this magnetometer, and the aircraft field at its position, are neglected. Unset:
        equal noise in all attitudes.
    sensor_axis : ListLike, optional
        Axis of the scalar sensor in the frame of the vector magnetometer: nose, right, down.
        Allowed: finite. Default: `[1.0,0.0,0.0]`.
    dead_zones : {"none", "polar", "polar_and_equatorial"}, optional
        Dead zones of the scalar sensor: along its axis (`polar`), or also across its axis
        (`polar_and_equatorial`). The assumed noise is inversely proportional to the amplitude
        of the sensor's signal. At the largest amplitude, the noise is `measurement_sigma_nt`. A
        sample whose amplitude is below a tenth of the largest gives no measurement. Default:
        `"none"`.
    ins_grade : {"magnav", "navigation", "tactical", "commercial"}, optional
        Grade of the INS. The grade sets the INS keys (`init_*`, `*_sigma*` and `*_tau_s`) that
        are unset in the spec. `magnav` sets the defaults shown for these keys. `navigation` is
        a Honeywell HG9900, `tactical` a Honeywell HG1700, and `commercial` has micro-mechanical
        sensors [Lee 2019, Tables 9 and 10]. For these three grades, the position at alignment
        is exact (`init_position_sigma_m = 0`). Unset: in `navigate`, the flight's column
        `ins_grade` if present; otherwise `magnav`.
    init_position_sigma_m : float, optional
        Standard deviation of the initial horizontal position error along each axis. Unit: m.
        Allowed: 0 or above. Default: `3.0`.
    init_altitude_sigma_m : float, optional
        Standard deviation of the initial height error. Unit: m. Allowed: 0 or above. Default:
        `0.001`.
    init_velocity_sigma_mps : float, optional
        Standard deviation of the initial velocity error along each axis. Unit: m/s. Allowed: 0
        or above. Default: `0.01`.
    init_attitude_sigma_deg : float, optional
        Standard deviation of the initial tilt error about each axis. Unit: deg. Allowed: 0 or
        above. Default: `0.01`.
    init_heading_sigma_deg : float, optional
        Standard deviation of the initial yaw error, the tilt about the down axis. In practice,
        the yaw error exceeds the other tilt errors, because the INS finds north from the
        earth's rotation, a much weaker signal than gravity. Unit: deg. Allowed: 0 or above.
        Unset: the initial tilt error.
    vrw_sigma : float, optional
        Velocity random walk: square root of the spectral density of the accelerometer noise.
        Unit: m/s^1.5. Allowed: 0 or above. Default: `0.000238`.
    arw_sigma : float, optional
        Angular random walk: square root of the spectral density of the gyro noise. Unit:
        rad/s^0.5. Allowed: 0 or above. Default: `5.81e-7`.
    baro_sigma_m : float, optional
        Standard deviation of the barometer error. Unit: m. Allowed: 0 or above. Default: `1.0`.
    ha_sigma_m : float, optional
        Standard deviation of the initial error of the altitude in the barometer loop, which
        aids the INS height. Unit: m. Allowed: 0 or above. Default: `0.001`.
    a_hat_sigma_mps2 : float, optional
        Standard deviation of the initial error of the vertical acceleration in the barometer
        loop, which aids the INS height. Unit: m/s2. Allowed: 0 or above. Default: `0.01`.
    acc_sigma_mps2 : float, optional
        Standard deviation of the accelerometer bias. Unit: m/s2. Allowed: 0 or above. Default:
        `0.000245`.
    gyro_sigma_radps : float, optional
        Standard deviation of the gyro bias. Unit: rad/s. Allowed: 0 or above. Default:
        `7.27e-9`.
    baro_tau_s : float, optional
        Time constant of the barometer error. Unit: s. Allowed: above 0. Default: `3600.0`.
    acc_tau_s : float, optional
        Time constant of the accelerometer bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    gyro_tau_s : float, optional
        Time constant of the gyro bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    iterations : int, optional
        Maximum number of passes over the line. Allowed: 1 to 1000. Default: `20`.
    tolerance_m : float, optional
        Limit on the position change. The iteration ends when no position on the line changes by
        more than this limit. Unit: m. Allowed: above 0. Default: `0.1`.
    loss : {"none", "huber", "cauchy"}, optional
        Loss function of a residual: quadratic (`none`), or robust to outliers (`huber`,
        `cauchy`). Default: `"none"`.
    loss_scale : float, optional
        Residual above which a robust loss departs from the quadratic loss, in standard
        deviations of the measurement. Allowed: above 0. Unset: 1.345 with `huber`, 2.385 with
        `cauchy` (95 % efficiency for normal noise).
    save_state : bool, optional
        Appends the state `x` and its covariance `p` (row-major). Default: `false`.
    discretisation : {"trapezoidal", "rectangular", "van_loan"}, optional
        Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of
        first order as in MagNav.jl, and `van_loan` exact. Default: `"trapezoidal"`.
    gnss_lost_s : ListLike, optional
        Times at which GNSS is lost and recovered, in seconds from the first sample of the line.
        Before the loss and after the recovery, the GNSS position (columns `gnss`) aids the
        filter. With `[0.0, 600.0]`, GNSS is missing for the first ten minutes of the line. If
        the recovery time is after the end of the line, GNSS is never recovered. Unit: s.
        Allowed: 0 or above. Unset: GNSS is not used.
    gnss : ListLike, optional
        Columns with the GNSS latitude (deg), longitude (deg) and height above the ellipsoid
        (m). Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has them, else `lat`,
        `lon` and `alt`.
    gnss_interval_s : float, optional
        Time between successive GNSS positions. Unit: s. Allowed: above 0. Default: `1.0`.
    gnss_sigma_m : float, optional
        Standard deviation of the GNSS position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `2.0`.
    gnss_alt_sigma_m : float, optional
        Standard deviation of the GNSS height. Unit: m. Allowed: above 0. Default: `5.0`.
    gnss_noise : bool, optional
        Adds white noise to the GNSS positions, with the standard deviations `gnss_sigma_m` and
        `gnss_alt_sigma_m`. The added noise of a line is the same in every run. True positions
        have no error: without added noise, the filter appears more accurate than with real
        GNSS. Unset: true if the columns of `gnss` have the role `truth`.
    gnss_test : bool, optional
        Tests each GNSS position against the INS position and does not use rejected positions. A
        chi-square test of each position detects a jump at once. A cumulative sum over earlier
        positions detects a drift of 1 m/s after about 10 s. The test then also rejects the
        positions since the start of the drift. Positions are accepted again after ten
        consecutive positions agree with the INS. The column `gnss_update` (`used`, `rejected`
        or `none`) is appended even if this key is false. Default: `true`.
    gradient : ListLike, optional
        Two compensated scalar magnetometers. The difference between their readings, first minus
        second, measures the slope of the map along the baseline between them. The temporal
        variation and all other common errors cancel in this difference. This key cannot be
        combined with `map_interpolation = "linear"`, because the slope of a bilinear map has
        steps. Unit: nT. Unset: the difference is not used.
    gradient_baseline_m : ListLike, optional
        Vector from the second magnetometer of `gradient` to the first, in the body frame (nose,
        right, down). The INS attitude rotates this vector to the navigation frame. The
        measurement model includes the estimated error of the INS attitude. Unit: m. Allowed:
        finite. Unset: required with `gradient`.
    gradient_sigma_nt : float, optional
        Standard deviation of the white noise in the difference between the two magnetometers'
        readings. Unit: nT. Allowed: above 0. Default: `0.1`.
    gradient_bias_sigma_nt : float, optional
        Standard deviation of the slowly varying error in the difference between the two
        magnetometers' readings. Such an error is likely, because each calibration leaves a
        constant undetermined. Unit: nT. Allowed: 0 or above. Default: `1.0`.
    gradient_bias_tau_s : float, optional
        Time constant of the slowly varying error in the difference between the two
        magnetometers' readings. Unit: s. Allowed: above 0. Default: `3600.0`.
    gradient_slope_sigma : float | {"auto"}, optional
        Standard deviation of the error in the map's slope along the baseline. The error of the
        predicted difference is this error times the length of the baseline. The error is
        correlated along the track, over the same length as the map's anomalies. `"auto"` uses
        the maximum-likelihood value from the innovations of the difference. A large value can
        reveal a map made from widely spaced lines. A map at one height without `map_levels_m`
        has no vertical slope. The prediction then has an additional error: the height
        difference between the magnetometers times the rms slope. Unit: nT/m. Allowed: 0 or
        above. Default: `auto`.
    use_scalar : bool, optional
        Uses the scalar measurement `mag` in the measurement update. `false` ignores `mag`, for
        example in a magnetic storm, and requires the difference (`gradient`) or the vector
        (`vector_sigma_nt`). Default: `true`.
    vector_sigma_nt : float, optional
        Standard deviation of the white noise of each component of `vector`. If set, the
        components are used as measurements. They depend on the total field and on the attitude,
        but not on a rotation about the field direction. This key requires `core_field = true`
        and a calibrated vector magnetometer. Unit: nT. Allowed: above 0. Unset: the vector is
        not used as a measurement.
    vector_bias_sigma_nt : float, optional
        Standard deviation of the bias of each component of `vector`. In a field of 50,000 nT, a
        bias of 50 nT corresponds to an attitude error of 0.06°. Unit: nT. Allowed: 0 or above.
        Default: `50.0`.
    vector_bias_tau_s : float, optional
        Time constant of the bias of each component of `vector`. Unit: s. Allowed: above 0.
        Default: `3600.0`.
    vector_crustal_sigma_nt : float, optional
        Standard deviation, per component, of the crustal field that a map of the scalar anomaly
        leaves undetermined. A typical value is the standard deviation of the anomaly. Unit: nT.
        Allowed: 0 or above. Default: `50.0`.
    vector_crustal_length_m : float, optional
        Correlation length of the crustal field that `vector_crustal_sigma_nt` describes. A
        typical value is the height above the sources. Unit: m. Allowed: above 0. Default:
        `1000.0`.
    height : str, optional
        Column of measured heights above the ellipsoid, such as `baro`, from a barometer that
        does not already aid the INS. Unit: m. Unset: the height of the INS, aided by its
        barometer, is used.
    height_sigma_m : float, optional
        Standard deviation of the white noise of the measured height. Unit: m. Allowed: above 0.
        Default: `3.0`.
    height_bias_sigma_m : float, optional
        Standard deviation of the slowly varying error of the measured height, caused by the
        weather and the geoid. Unit: m. Allowed: 0 or above. Default: `30.0`.
    height_bias_tau_s : float, optional
        Time constant of the slowly varying error of the measured height. Unit: s. Allowed:
        above 0. Default: `3600.0`.
    map_sigma_nt : float, optional
        Standard deviation of the map error. If set, the filter estimates the map error as a
        state that is correlated along the track. Unit: nT. Allowed: 0 or above. Unset: the map
        error is not estimated.
    map_sigma_length_m : float, optional
        Distance over which the autocorrelation of the map error falls to 1/e. Unit: m. Allowed:
        above 0. Default: `500.0`.
    mag_latency_sigma_s : float, optional
        Prior standard deviation of the lag of the magnetometer's time stamps. If set, the
        filter estimates the lag as a state that is constant along the line. A sample with time
        stamp `t` was measured at `t` minus the lag. The lag may be negative. 0 omits this
        state. The columns `mag_latency` and `mag_latency_sigma` are appended. This key is
        available in `ekf`, `iekf` and `ukf`. Unit: s. Allowed: 0 or above. Unset: 1.0 with
        `tuning = "auto"` if a state for the lag clearly increases the likelihood, otherwise 0
        (exact time stamps).
    map_height_sigma_m : float, optional
        Prior standard deviation of a height bias: the true height of the aircraft minus its
        assumed height on the map. Possible causes are a constant error of the barometer, a
        missing geoid height, and a wrong map height. If set, the filter estimates the bias as a
        state that is constant along the line. The bias changes only the predicted total field,
        not `alt`. The heights to which the map is continued must include the true height of the
        aircraft. With `tuning = "auto"`, the map is continued to twice this standard deviation
        below and above the line. Otherwise, set `map_levels_m`. 0 omits this state. The columns
        `map_height_bias` and `map_height_bias_sigma` are appended. This key is available in
        `ekf`, `iekf` and `ukf`. Unit: m. Allowed: 0 or above. Unset: 50 with `tuning = "auto"`
        if a bias clearly increases the likelihood, otherwise 0 (exact height). To find a bias,
        `auto` continues the map up to 200 m below and above the line, unless `map_levels_m` is
        set.
    permanent_change_sigma_nt : float, optional
        Standard deviation of the change in the aircraft's permanent field since calibration,
        per component (nose, right, down). The filter estimates the three components as
        additional states. The attitude and the core field determine the effect of these
        components on the total field. A fourth state is a constant offset with a standard
        deviation of 100 nT. 0 omits these states. This key requires `core_field = true`, and is
        available in `ekf`, `iekf` and `ukf`. Unit: nT. Allowed: 0 or above. Unset: the
        maximum-likelihood estimate with `tuning = "auto"` if these states clearly increase the
        likelihood, otherwise 0.
    permanent_change_tau_s : float, optional
        Time constant of the change in the permanent field. Unit: s. Allowed: above 0. Unset:
        the maximum-likelihood estimate with `tuning = "auto"`, otherwise infinite, so that the
        change is constant along the line.
    flat_over_m : float, optional
        A sample corrects the position only if the ratio of its measurement noise (standard
        deviation) to the map's horizontal slope is at most this value. At a larger ratio, the
        map is too flat to observe the position. The sample is then `flat`: it corrects only the
        temporal variation and the map error. The column `map_slope` is appended. Unit: m.
        Allowed: above 0. Unset: all samples correct the position.

    Returns
    -------
    Track
        Estimate at each sample, innovations, warnings and notes.

    Raises
    ------
    SpecError
        If a key is unknown, has an invalid value, or has no effect.
    DataError
        If the line cannot be filtered, such as an INS with a NaN or a line off the map.
    ValueError
        If the shapes of the arrays differ.

    References
    ----------
    Bierman 1973 (modified Bryson-Frazier form, which inverts no covariance); Bell 1994
    (iterated Kalman smoother); Holland and Welsch 1977 (reweighting).

    Examples
    --------
    >>> import numpy as np
    >>> from magline import filters, maps
    >>> lat, lon = np.linspace(45.0, 45.2, 201), np.linspace(-76.1, -75.9, 201)
    >>> hills = 60.0 * np.sin(400.0 * lat[:, None]) + 50.0 * np.cos(500.0 * (lat[:, None] + lon))
    >>> field = maps.Map(lon, lat, hills, np.full(hills.shape, 300.0), 4326, "deg")
    >>> t = np.arange(100.0)  # northward over the nodes of a column; the INS is 11 m too far north
    >>> ins = t, lat[50:150] + 1e-4, np.full(100, lon[100]), np.full(100, 300.0)
    >>> start = {"start": "given", "init_position_sigma_m": 20.0}
    >>> track = filters.rts(*ins, hills[50:150, 100], field, core_field=False, **start)
    >>> bool(abs(track.lat_deg[-1] - lat[149]) < 5e-5)
    True
    """
    return navigate_line("rts", locals())


def mpf(
    tt_s: ArrayLike,
    ins_lat_deg: ArrayLike,
    ins_lon_deg: ArrayLike,
    ins_alt_m: ArrayLike,
    mag_nt: Magnetometers,
    map: Map,
    *,
    ins_velocity_ned_mps: ArrayLike | None = None,
    ins_force_ned_mps2: ArrayLike | None = None,
    ins_attitude_deg: ArrayLike | None = None,
    columns: Mapping[str, Any] | None = None,
    tuning: Literal["auto", "magnav"] | None = None,
    core_field: bool | None = None,
    remove_diurnal: bool | None = None,
    decimal_year: float | None = None,
    map_interpolation: Literal["linear", "quadratic", "cubic"] | None = None,
    map_levels_m: ListLike | None = None,
    map_error_length_m: float | None = None,
    offset_window_s: float | None = None,
    measurement_sigma_nt: float | Literal["auto"] | None = None,
    fogm_sigma_nt: float | Literal["auto"] | None = None,
    fogm_tau_s: float | Literal["auto"] | None = None,
    noise_column: str | None = None,
    start: Literal["auto", "fix", "alignment", "given"] | None = None,
    fix: ListLike | None = None,
    fix_velocity: ListLike | None = None,
    fix_sigma_m: float | None = None,
    fix_alt_sigma_m: float | None = None,
    fix_velocity_sigma_mps: float | None = None,
    vector: str | None = None,
    sensor_axis: ListLike | None = None,
    dead_zones: Literal["none", "polar", "polar_and_equatorial"] | None = None,
    ins_grade: Literal["magnav", "navigation", "tactical", "commercial"] | None = None,
    init_position_sigma_m: float | None = None,
    init_altitude_sigma_m: float | None = None,
    init_velocity_sigma_mps: float | None = None,
    init_attitude_sigma_deg: float | None = None,
    init_heading_sigma_deg: float | None = None,
    vrw_sigma: float | None = None,
    arw_sigma: float | None = None,
    baro_sigma_m: float | None = None,
    ha_sigma_m: float | None = None,
    a_hat_sigma_mps2: float | None = None,
    acc_sigma_mps2: float | None = None,
    gyro_sigma_radps: float | None = None,
    baro_tau_s: float | None = None,
    acc_tau_s: float | None = None,
    gyro_tau_s: float | None = None,
    particles: int | None = None,
    seed: int | None = None,
    resample_threshold: float | None = None,
    regularise: bool | None = None,
    smooth_over_m: float | None = None,
    roughening: float | None = None,
    gate_nis: float | None = None,
    save_modes: bool | None = None,
    gnss_lost_s: ListLike | None = None,
    gnss: ListLike | None = None,
    gnss_interval_s: float | None = None,
    gnss_sigma_m: float | None = None,
    gnss_alt_sigma_m: float | None = None,
    gnss_noise: bool | None = None,
    gnss_test: bool | None = None,
    gradient: ListLike | None = None,
    gradient_baseline_m: ListLike | None = None,
    gradient_sigma_nt: float | None = None,
    gradient_bias_sigma_nt: float | None = None,
    gradient_bias_tau_s: float | None = None,
    gradient_slope_sigma: float | Literal["auto"] | None = None,
    use_scalar: bool | None = None,
    vector_sigma_nt: float | None = None,
    vector_bias_sigma_nt: float | None = None,
    vector_bias_tau_s: float | None = None,
    vector_crustal_sigma_nt: float | None = None,
    vector_crustal_length_m: float | None = None,
    height: str | None = None,
    height_sigma_m: float | None = None,
    height_bias_sigma_m: float | None = None,
    height_bias_tau_s: float | None = None,
    map_sigma_nt: float | None = None,
    map_sigma_length_m: float | None = None,
    mag_latency_sigma_s: float | None = None,
    map_height_sigma_m: float | None = None,
    permanent_change_sigma_nt: float | None = None,
    permanent_change_tau_s: float | None = None,
    flat_over_m: float | None = None,
) -> Track:
    """The marginalised particle filter: particles for the horizontal position, and one Kalman
    filter for the other 16 states given the position.

    Use it on a map with several similar places; `save_modes` returns the probability of each
    place. For a navigation-grade INS, `ekf` is as accurate, and seventy times as fast as `mpf`
    with 1000 particles. For an INS position error of kilometres, `mpf_then_ekf` is faster.

    The estimate is the mean over all particles. A measurement does not change the share of the
    total weight that belongs to particles off the map. A sample is `off_map` if particles on
    the map have less than a tenth of the total weight. A measurement outside six standard
    deviations of every particle is `gated`, regardless of `gate_nis`. Many such measurements in
    a row mean that the particles have lost the aircraft. The line is rejected when most of its
    measurements are gated in this way.

    The biases of additional measurements and the map error are linear states of each particle.
    The weights depend on the values of the map, not on its slope, so `flat_over_m` is rejected;
    use `map_sigma_nt` for the map error.

    Parameters
    ----------
    tt_s : array_like
        Times of the samples, s, ascending, of shape (samples,).
    ins_lat_deg : array_like
        Latitude of the INS, degrees, of shape (samples,).
    ins_lon_deg : array_like
        Longitude of the INS, degrees, of shape (samples,).
    ins_alt_m : array_like
        Height of the INS above the WGS-84 ellipsoid, m, of shape (samples,).
    mag_nt : Magnetometers
        Measured field, nT, of shape (samples,); NaN where there is no measurement. A mapping
        holds several magnetometers under the names of their columns, such as `mag_1_c`
        (compensated) or `mag_1_uc`.
    map : Map
        Anomaly map, such as the result of `magline.maps.open`.
    ins_velocity_ned_mps : array_like, optional
        Velocity of the INS north, east and down, m/s, of shape (samples, 3). Default: derived
        from its positions.
    ins_force_ned_mps2 : array_like, optional
        Specific force of the INS north, east and down, m/s^2, of shape (samples, 3). Default:
        derived from its velocities.
    ins_attitude_deg : array_like, optional
        Roll, pitch and yaw of the INS, degrees, of shape (samples, 3). Default: level, along
        the course.
    columns : Mapping[str, Any], optional
        Further columns of the flight table under their names, in its units: those that keys
        name, and those that the stage uses if they are there, such as `diurnal` (nT), `year`,
        `doy`, `gnss_lat` (deg), `ins_aligned` (s), and the truth `lat` and `lon` (deg) and
        `alt` (m). A value is an array of shape (samples,), one number or text for all samples,
        or a pair of a matrix with one row per sample and the names of its columns.
    tuning : {"auto", "magnav"}, optional
        Source of unset parameters. `auto` estimates the noise of each line from the likelihood
        of its innovations, rejects outliers, and continues a map of known height to the flight
        heights. `magnav` uses the defaults of MagNav.jl, no gate, and the map at its own
        height. A key in the spec takes precedence over both. Default: `"auto"`.
    core_field : bool, optional
        Adds the core field to the predicted measurement. `false` means that the measurement is
        an anomaly. Default: `true`.
    remove_diurnal : bool, optional
        Subtracts the column `diurnal` from the measurement, so that the filter need not
        estimate the temporal variation. A sample with a NaN in `diurnal` has no measurement.
        Unset: true if the flight has a column `diurnal` that has not yet been subtracted from
        the measurement.
    decimal_year : float, optional
        Date of the core field as a decimal year. It replaces the flight's date. Unit: a.
        Allowed: 1900 to 2030. Unset: the flight's own date.
    map_interpolation : {"linear", "quadratic", "cubic"}, optional
        Interpolation of the map. The field above its sources is smooth, so spline interpolation
        is more accurate than bilinear interpolation. Unset: `cubic` with `tuning = "auto"`,
        else `linear`.
    map_levels_m : ListLike, optional
        Heights above the ellipsoid, ascending, to which the map is continued. Between these
        heights the map is interpolated linearly. Unit: m. Unset: with `tuning = "auto"` the map
        is continued to the flight heights, otherwise it is used at its own height.
    map_error_length_m : float, optional
        Correlation length of the map error, for a map with the column `error` (`map_grid`,
        `track_map`); typically the spacing of its survey lines. The correlated map error is
        converted to equivalent white noise, which is added to the measurement noise of each
        sample. The map error is interpolated at the position that an extended Kalman filter
        predicts. Unit: m. Allowed: above 0. Unset: the map is assumed to be exact; `tuning =
        "auto"` instead uses the map's column `error`, or the error of the map's interpolation,
        times an estimated factor.
    offset_window_s : float, optional
        Length of the window at the start of a line in which an offset is computed: the mean of
        measurement minus prediction. The offset is subtracted from all measurements of the line
        before filtering, because compensation leaves a constant undetermined. 0 subtracts
        nothing. Unit: s. Allowed: 0 or above. Default: `0.0`.
    measurement_sigma_nt : float | {"auto"}, optional
        Standard deviation of the white noise of a measurement. It includes the noise of the
        sensor, the map and the compensation. `"auto"` uses the noise of the calibration
        residual, from the column `mag_sigma`. Unit: nT. Allowed: above 0. Unset: the
        maximum-likelihood estimate with `tuning = "auto"`, otherwise 5.0.
    fogm_sigma_nt : float | {"auto"}, optional
        Standard deviation of the first-order Gauss-Markov process for the temporal variation
        and all other slow errors. `"auto"` uses the column `mag_fogm_sigma`. Unit: nT. Allowed:
        0 or above. Unset: the maximum-likelihood estimate with `tuning = "auto"`, otherwise
        3.0.
    fogm_tau_s : float | {"auto"}, optional
        Time constant of the temporal variation. `"auto"` uses the column `mag_fogm_tau`. Unit:
        s. Allowed: above 0. Unset: the maximum-likelihood estimate with `tuning = "auto"`,
        otherwise 600.0.
    noise_column : str, optional
        Column with the standard deviation of an additional error of each sample:
        `mag_aircraft_sigma` of an ensemble, or the predicted error of a network. The square of
        this standard deviation is added to the square of `measurement_sigma_nt`. A sample
        without a value in this column has no measurement. Requires a single magnetometer. Unit:
        nT. Unset: equal noise at all samples.
    start : {"auto", "fix", "alignment", "given"}, optional
        Source of the initial estimate. `fix` corrects the INS with a position fix. `alignment`
        propagates the `init_*` standard deviations from the alignment to the start of the line.
        `given` applies the `init_*` standard deviations at the start of the line; the defaults
        are valid only within minutes of the alignment, because an INS drifts. `auto` selects
        one of the three from the keys and columns. Default: `"auto"`.
    fix : ListLike, optional
        Columns with the latitude (deg), longitude (deg) and height (m) of the fix. The first
        values within 2 s of the line's start are used. If the columns have the role truth,
        white noise with the fix's standard deviations is added. The added noise of a line is
        the same in every run. Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has
        them, else `lat`, `lon` and `alt`.
    fix_velocity : ListLike, optional
        Columns of the fix's velocity components: north, east and down. Unit: m/s. Unset:
        `gnss_vn`, `gnss_ve` and `gnss_vd` for a fix from `gnss_*` columns, otherwise `vn`, `ve`
        and `vd`; without these columns, the velocity of the INS.
    fix_sigma_m : float, optional
        Standard deviation of the fix's position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `3.0`.
    fix_alt_sigma_m : float, optional
        Standard deviation of the fix's height. Unit: m. Allowed: above 0. Default: `5.0`.
    fix_velocity_sigma_mps : float, optional
        Standard deviation of each component of the fix's velocity. Unit: m/s. Allowed: above 0.
        Default: `0.1`.
    vector : str, optional
        Vector magnetometer that gives the direction of the field, such as `flux_a`. The noise
        of this magnetometer, and the aircraft field at its position, are neglected. Unset:
        equal noise in all attitudes.
    sensor_axis : ListLike, optional
        Axis of the scalar sensor in the frame of the vector magnetometer: nose, right, down.
        Allowed: finite. Default: `[1.0,0.0,0.0]`.
    dead_zones : {"none", "polar", "polar_and_equatorial"}, optional
        Dead zones of the scalar sensor: along its axis (`polar`), or also across its axis
        (`polar_and_equatorial`). The assumed noise is inversely proportional to the amplitude
        of the sensor's signal. At the largest amplitude, the noise is `measurement_sigma_nt`. A
        sample whose amplitude is below a tenth of the largest gives no measurement. Default:
        `"none"`.
    ins_grade : {"magnav", "navigation", "tactical", "commercial"}, optional
        Grade of the INS. The grade sets the INS keys (`init_*`, `*_sigma*` and `*_tau_s`) that
        are unset in the spec. `magnav` sets the defaults shown for these keys. `navigation` is
        a Honeywell HG9900, `tactical` a Honeywell HG1700, and `commercial` has micro-mechanical
        sensors [Lee 2019, Tables 9 and 10]. For these three grades, the position at alignment
        is exact (`init_position_sigma_m = 0`). Unset: in `navigate`, the flight's column
        `ins_grade` if present; otherwise `magnav`.
    init_position_sigma_m : float, optional
        Standard deviation of the initial horizontal position error along each axis. Unit: m.
        Allowed: 0 or above. Default: `3.0`.
    init_altitude_sigma_m : float, optional
        Standard deviation of the initial height error. Unit: m. Allowed: 0 or above. Default:
        `0.001`.
    init_velocity_sigma_mps : float, optional
        Standard deviation of the initial velocity error along each axis. Unit: m/s. Allowed: 0
        or above. Default: `0.01`.
    init_attitude_sigma_deg : float, optional
        Standard deviation of the initial tilt error about each axis. Unit: deg. Allowed: 0 or
        above. Default: `0.01`.
    init_heading_sigma_deg : float, optional
        Standard deviation of the initial yaw error, the tilt about the down axis. In practice,
        the yaw error exceeds the other tilt errors, because the INS finds north from the
        earth's rotation, a much weaker signal than gravity. Unit: deg. Allowed: 0 or above.
        Unset: the initial tilt error.
    vrw_sigma : float, optional
        Velocity random walk: square root of the spectral density of the accelerometer noise.
        Unit: m/s^1.5. Allowed: 0 or above. Default: `0.000238`.
    arw_sigma : float, optional
        Angular random walk: square root of the spectral density of the gyro noise. Unit:
        rad/s^0.5. Allowed: 0 or above. Default: `5.81e-7`.
    baro_sigma_m : float, optional
        Standard deviation of the barometer error. Unit: m. Allowed: 0 or above. Default: `1.0`.
    ha_sigma_m : float, optional
        Standard deviation of the initial error of the altitude in the barometer loop, which
        aids the INS height. Unit: m. Allowed: 0 or above. Default: `0.001`.
    a_hat_sigma_mps2 : float, optional
        Standard deviation of the initial error of the vertical acceleration in the barometer
        loop, which aids the INS height. Unit: m/s2. Allowed: 0 or above. Default: `0.01`.
    acc_sigma_mps2 : float, optional
        Standard deviation of the accelerometer bias. Unit: m/s2. Allowed: 0 or above. Default:
        `0.000245`.
    gyro_sigma_radps : float, optional
        Standard deviation of the gyro bias. Unit: rad/s. Allowed: 0 or above. Default:
        `7.27e-9`.
    baro_tau_s : float, optional
        Time constant of the barometer error. Unit: s. Allowed: above 0. Default: `3600.0`.
    acc_tau_s : float, optional
        Time constant of the accelerometer bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    gyro_tau_s : float, optional
        Time constant of the gyro bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    particles : int, optional
        Number of particles. Use 3000 if the INS position is known to within hundreds of metres.
        Use 10,000 if the INS position is uncertain by kilometres, or with a measurement as
        precise as `gradient`. Allowed: 1 to 1000000. Unset: 3000 to 50,000, by KLD-sampling
        (Fox 2003) over squares of side `smooth_over_m`; the column `particles` is then
        appended.
    seed : int, optional
        Seed of all random draws. The same seed gives bit-identical results on any number of
        threads. Default: `0`.
    resample_threshold : float, optional
        The particles are resampled when their effective number falls below this fraction of
        their number. 0.5 is usual; a larger value (0.8 in MagNav.jl) resamples more often and
        only adds noise. Allowed: 0 to 1. Default: `0.5`.
    regularise : bool, optional
        Resamples from a kernel density. The position error of a good INS has almost no process
        noise, so without the kernel density only copies of a few particles remain. The
        covariance is then far too small. Default: `true`.
    smooth_over_m : float, optional
        Distance over which the map is nearly linear; typically the height of the map above the
        sources. A wider cloud of particles is divided into parts with one kernel each. With
        `gradient`, set a third of this distance, over which the slope of the map is nearly
        linear. Unit: m. Allowed: above 0. Default: `200.0`.
    roughening : float, optional
        Standard deviation, per axis, of position noise that is added to each resampled
        particle. The unit is the range of the particles divided by the square root of their
        number. Gordon, Salmond & Smith 1993 use 0.2. Allowed: 0 or above. Default: `0.0`.
    gate_nis : float, optional
        Largest accepted NIS of a measurement. The NIS is computed from the mean and variance of
        the whole cloud of particles. Allowed: above 0. Unset: no gate; with `tuning = "auto"`,
        outliers are rejected before filtering.
    save_modes : bool, optional
        Appends the three most probable modes of the position to each sample. The run time of
        the filter then increases by 50 %. Default: `false`.
    gnss_lost_s : ListLike, optional
        Times at which GNSS is lost and recovered, in seconds from the first sample of the line.
        Before the loss and after the recovery, the GNSS position (columns `gnss`) aids the
        filter. With `[0.0, 600.0]`, GNSS is missing for the first ten minutes of the line. If
        the recovery time is after the end of the line, GNSS is never recovered. Unit: s.
        Allowed: 0 or above. Unset: GNSS is not used.
    gnss : ListLike, optional
        Columns with the GNSS latitude (deg), longitude (deg) and height above the ellipsoid
        (m). Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has them, else `lat`,
        `lon` and `alt`.
    gnss_interval_s : float, optional
        Time between successive GNSS positions. Unit: s. Allowed: above 0. Default: `1.0`.
    gnss_sigma_m : float, optional
        Standard deviation of the GNSS position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `2.0`.
    gnss_alt_sigma_m : float, optional
        Standard deviation of the GNSS height. Unit: m. Allowed: above 0. Default: `5.0`.
    gnss_noise : bool, optional
        Adds white noise to the GNSS positions, with the standard deviations `gnss_sigma_m` and
        `gnss_alt_sigma_m`. The added noise of a line is the same in every run. True positions
        have no error: without added noise, the filter appears more accurate than with real
        GNSS. Unset: true if the columns of `gnss` have the role `truth`.
    gnss_test : bool, optional
        Tests each GNSS position against the INS position and does not use rejected positions. A
        chi-square test of each position detects a jump at once. A cumulative sum over earlier
        positions detects a drift of 1 m/s after about 10 s. The test then also rejects the
        positions since the start of the drift. Positions are accepted again after ten
        consecutive positions agree with the INS. The column `gnss_update` (`used`, `rejected`
        or `none`) is appended even if this key is false. Default: `true`.
    gradient : ListLike, optional
        Two compensated scalar magnetometers. The difference between their readings, first minus
        second, measures the slope of the map along the baseline between them. The temporal
        variation and all other common errors cancel in this difference. This key cannot be
        combined with `map_interpolation = "linear"`, because the slope of a bilinear map has
        steps. Unit: nT. Unset: the difference is not used.
    gradient_baseline_m : ListLike, optional
        Vector from the second magnetometer of `gradient` to the first, in the body frame (nose,
        right, down). The INS attitude rotates this vector to the navigation frame. The
        measurement model includes the estimated error of the INS attitude. Unit: m. Allowed:
        finite. Unset: required with `gradient`.
    gradient_sigma_nt : float, optional
        Standard deviation of the white noise in the difference between the two magnetometers'
        readings. Unit: nT. Allowed: above 0. Default: `0.1`.
    gradient_bias_sigma_nt : float, optional
        Standard deviation of the slowly varying error in the difference between the two
        magnetometers' readings. Such an error is likely, because each calibration leaves a
        constant undetermined. Unit: nT. Allowed: 0 or above. Default: `1.0`.
    gradient_bias_tau_s : float, optional
        Time constant of the slowly varying error in the difference between the two
        magnetometers' readings. Unit: s. Allowed: above 0. Default: `3600.0`.
    gradient_slope_sigma : float | {"auto"}, optional
        Standard deviation of the error in the map's slope along the baseline. The error of the
        predicted difference is this error times the length of the baseline. The error is
        correlated along the track, over the same length as the map's anomalies. `"auto"` uses
        the maximum-likelihood value from the innovations of the difference. A large value can
        reveal a map made from widely spaced lines. A map at one height without `map_levels_m`
        has no vertical slope. The prediction then has an additional error: the height
        difference between the magnetometers times the rms slope. Unit: nT/m. Allowed: 0 or
        above. Default: `auto`.
    use_scalar : bool, optional
        Uses the scalar measurement `mag` in the measurement update. `false` ignores `mag`, for
        example in a magnetic storm, and requires the difference (`gradient`) or the vector
        (`vector_sigma_nt`). Default: `true`.
    vector_sigma_nt : float, optional
        Standard deviation of the white noise of each component of `vector`. If set, the
        components are used as measurements. They depend on the total field and on the attitude,
        but not on a rotation about the field direction. This key requires `core_field = true`
        and a calibrated vector magnetometer. Unit: nT. Allowed: above 0. Unset: the vector is
        not used as a measurement.
    vector_bias_sigma_nt : float, optional
        Standard deviation of the bias of each component of `vector`. In a field of 50,000 nT, a
        bias of 50 nT corresponds to an attitude error of 0.06°. Unit: nT. Allowed: 0 or above.
        Default: `50.0`.
    vector_bias_tau_s : float, optional
        Time constant of the bias of each component of `vector`. Unit: s. Allowed: above 0.
        Default: `3600.0`.
    vector_crustal_sigma_nt : float, optional
        Standard deviation, per component, of the crustal field that a map of the scalar anomaly
        leaves undetermined. A typical value is the standard deviation of the anomaly. Unit: nT.
        Allowed: 0 or above. Default: `50.0`.
    vector_crustal_length_m : float, optional
        Correlation length of the crustal field that `vector_crustal_sigma_nt` describes. A
        typical value is the height above the sources. Unit: m. Allowed: above 0. Default:
        `1000.0`.
    height : str, optional
        Column of measured heights above the ellipsoid, such as `baro`, from a barometer that
        does not already aid the INS. Unit: m. Unset: the height of the INS, aided by its
        barometer, is used.
    height_sigma_m : float, optional
        Standard deviation of the white noise of the measured height. Unit: m. Allowed: above 0.
        Default: `3.0`.
    height_bias_sigma_m : float, optional
        Standard deviation of the slowly varying error of the measured height, caused by the
        weather and the geoid. Unit: m. Allowed: 0 or above. Default: `30.0`.
    height_bias_tau_s : float, optional
        Time constant of the slowly varying error of the measured height. Unit: s. Allowed:
        above 0. Default: `3600.0`.
    map_sigma_nt : float, optional
        Standard deviation of the map error. If set, the filter estimates the map error as a
        state that is correlated along the track. Unit: nT. Allowed: 0 or above. Unset: the map
        error is not estimated.
    map_sigma_length_m : float, optional
        Distance over which the autocorrelation of the map error falls to 1/e. Unit: m. Allowed:
        above 0. Default: `500.0`.
    mag_latency_sigma_s : float, optional
        Prior standard deviation of the lag of the magnetometer's time stamps. If set, the
        filter estimates the lag as a state that is constant along the line. A sample with time
        stamp `t` was measured at `t` minus the lag. The lag may be negative. 0 omits this
        state. The columns `mag_latency` and `mag_latency_sigma` are appended. This key is
        available in `ekf`, `iekf` and `ukf`. Unit: s. Allowed: 0 or above. Unset: 1.0 with
        `tuning = "auto"` if a state for the lag clearly increases the likelihood, otherwise 0
        (exact time stamps).
    map_height_sigma_m : float, optional
        Prior standard deviation of a height bias: the true height of the aircraft minus its
        assumed height on the map. Possible causes are a constant error of the barometer, a
        missing geoid height, and a wrong map height. If set, the filter estimates the bias as a
        state that is constant along the line. The bias changes only the predicted total field,
        not `alt`. The heights to which the map is continued must include the true height of the
        aircraft. With `tuning = "auto"`, the map is continued to twice this standard deviation
        below and above the line. Otherwise, set `map_levels_m`. 0 omits this state. The columns
        `map_height_bias` and `map_height_bias_sigma` are appended. This key is available in
        `ekf`, `iekf` and `ukf`. Unit: m. Allowed: 0 or above. Unset: 50 with `tuning = "auto"`
        if a bias clearly increases the likelihood, otherwise 0 (exact height). To find a bias,
        `auto` continues the map up to 200 m below and above the line, unless `map_levels_m` is
        set.
    permanent_change_sigma_nt : float, optional
        Standard deviation of the change in the aircraft's permanent field since calibration,
        per component (nose, right, down). The filter estimates the three components as
        additional states. The attitude and the core field determine the effect of these
        components on the total field. A fourth state is a constant offset with a standard
        deviation of 100 nT. 0 omits these states. This key requires `core_field = true`, and is
        available in `ekf`, `iekf` and `ukf`. Unit: nT. Allowed: 0 or above. Unset: the
        maximum-likelihood estimate with `tuning = "auto"` if these states clearly increase the
        likelihood, otherwise 0.
    permanent_change_tau_s : float, optional
        Time constant of the change in the permanent field. Unit: s. Allowed: above 0. Unset:
        the maximum-likelihood estimate with `tuning = "auto"`, otherwise infinite, so that the
        change is constant along the line.
    flat_over_m : float, optional
        A sample corrects the position only if the ratio of its measurement noise (standard
        deviation) to the map's horizontal slope is at most this value. At a larger ratio, the
        map is too flat to observe the position. The sample is then `flat`: it corrects only the
        temporal variation and the map error. The column `map_slope` is appended. Unit: m.
        Allowed: above 0. Unset: all samples correct the position.

    Returns
    -------
    Track
        Estimate at each sample, innovations, warnings and notes.

    Raises
    ------
    SpecError
        If a key is unknown, has an invalid value, or has no effect.
    DataError
        If the line cannot be filtered, such as an INS with a NaN or a line off the map.
    ValueError
        If the shapes of the arrays differ.

    References
    ----------
    Schön, Gustafsson & Nordlund 2005; resampling from a kernel density (Musso, Oudjane & Le
    Gland 2001) that is also marginalised over the linear states. The same seed gives
    bit-identical results on any number of threads.

    Examples
    --------
    >>> import numpy as np
    >>> from magline import filters, maps
    >>> lat, lon = np.linspace(45.0, 45.2, 201), np.linspace(-76.1, -75.9, 201)
    >>> hills = 60.0 * np.sin(400.0 * lat[:, None]) + 50.0 * np.cos(500.0 * (lat[:, None] + lon))
    >>> field = maps.Map(lon, lat, hills, np.full(hills.shape, 300.0), 4326, "deg")
    >>> t = np.arange(100.0)  # northward over the nodes of a column; the INS is 11 m too far north
    >>> ins = t, lat[50:150] + 1e-4, np.full(100, lon[100]), np.full(100, 300.0)
    >>> start = {"start": "given", "init_position_sigma_m": 20.0}
    >>> track = filters.mpf(*ins, hills[50:150, 100], field, core_field=False, **start)
    >>> bool(abs(track.lat_deg[-1] - lat[149]) < 5e-5)
    True
    """
    return navigate_line("mpf", locals())


def mpf_then_ekf(
    tt_s: ArrayLike,
    ins_lat_deg: ArrayLike,
    ins_lon_deg: ArrayLike,
    ins_alt_m: ArrayLike,
    mag_nt: Magnetometers,
    map: Map,
    *,
    ins_velocity_ned_mps: ArrayLike | None = None,
    ins_force_ned_mps2: ArrayLike | None = None,
    ins_attitude_deg: ArrayLike | None = None,
    columns: Mapping[str, Any] | None = None,
    tuning: Literal["auto", "magnav"] | None = None,
    core_field: bool | None = None,
    remove_diurnal: bool | None = None,
    decimal_year: float | None = None,
    map_interpolation: Literal["linear", "quadratic", "cubic"] | None = None,
    map_levels_m: ListLike | None = None,
    map_error_length_m: float | None = None,
    offset_window_s: float | None = None,
    measurement_sigma_nt: float | Literal["auto"] | None = None,
    fogm_sigma_nt: float | Literal["auto"] | None = None,
    fogm_tau_s: float | Literal["auto"] | None = None,
    noise_column: str | None = None,
    start: Literal["auto", "fix", "alignment", "given"] | None = None,
    fix: ListLike | None = None,
    fix_velocity: ListLike | None = None,
    fix_sigma_m: float | None = None,
    fix_alt_sigma_m: float | None = None,
    fix_velocity_sigma_mps: float | None = None,
    vector: str | None = None,
    sensor_axis: ListLike | None = None,
    dead_zones: Literal["none", "polar", "polar_and_equatorial"] | None = None,
    ins_grade: Literal["magnav", "navigation", "tactical", "commercial"] | None = None,
    init_position_sigma_m: float | None = None,
    init_altitude_sigma_m: float | None = None,
    init_velocity_sigma_mps: float | None = None,
    init_attitude_sigma_deg: float | None = None,
    init_heading_sigma_deg: float | None = None,
    vrw_sigma: float | None = None,
    arw_sigma: float | None = None,
    baro_sigma_m: float | None = None,
    ha_sigma_m: float | None = None,
    a_hat_sigma_mps2: float | None = None,
    acc_sigma_mps2: float | None = None,
    gyro_sigma_radps: float | None = None,
    baro_tau_s: float | None = None,
    acc_tau_s: float | None = None,
    gyro_tau_s: float | None = None,
    particles: int | None = None,
    seed: int | None = None,
    smooth_over_m: float | None = None,
    hand_over_weight: float | None = None,
    gate_nis: float | None = None,
    gnss_lost_s: ListLike | None = None,
    gnss: ListLike | None = None,
    gnss_interval_s: float | None = None,
    gnss_sigma_m: float | None = None,
    gnss_alt_sigma_m: float | None = None,
    gnss_noise: bool | None = None,
    gnss_test: bool | None = None,
    gradient: ListLike | None = None,
    gradient_baseline_m: ListLike | None = None,
    gradient_sigma_nt: float | None = None,
    gradient_bias_sigma_nt: float | None = None,
    gradient_bias_tau_s: float | None = None,
    gradient_slope_sigma: float | Literal["auto"] | None = None,
    use_scalar: bool | None = None,
    vector_sigma_nt: float | None = None,
    vector_bias_sigma_nt: float | None = None,
    vector_bias_tau_s: float | None = None,
    vector_crustal_sigma_nt: float | None = None,
    vector_crustal_length_m: float | None = None,
    height: str | None = None,
    height_sigma_m: float | None = None,
    height_bias_sigma_m: float | None = None,
    height_bias_tau_s: float | None = None,
    map_sigma_nt: float | None = None,
    map_sigma_length_m: float | None = None,
    mag_latency_sigma_s: float | None = None,
    map_height_sigma_m: float | None = None,
    permanent_change_sigma_nt: float | None = None,
    permanent_change_tau_s: float | None = None,
    flat_over_m: float | None = None,
) -> Track:
    """The marginalised particle filter `mpf` until a single position remains, then the extended
    Kalman filter `ekf`.

    Use it if the initial position is known only to kilometres. In this case, `ekf` may diverge
    unnoticed, and `mpf` takes far longer because it uses particles along the whole line.

    The hand-over to the Kalman filter occurs when two conditions have held for 60 s. First, the
    weight of one mode of the particles must be at least `hand_over_weight`. Second, the map's
    linearisation error over the spread of this mode (median over the next minute of the path)
    must be smaller than the white noise. The mean and covariance of the mode become the initial
    state and covariance of the Kalman filter. From then on `particles` is 0 and `n_eff` is NaN.
    If the conditions are never met on a line, all samples come from `mpf`.

    With `tuning = "auto"` and a large initial position error, the noise is estimated in three
    steps. First, particles with an assumed slow error of 30 nT locate the aircraft. Second, the
    INS is corrected with this position and velocity. Third, the likelihood of the innovations
    along the corrected INS track gives the noise and the outliers. In the first step, a spike
    is rejected only if it contradicts every particle. Therefore remove spikes in the first
    minutes of the line with `despike`.

    `flat_over_m` is rejected, as for `mpf`.

    Parameters
    ----------
    tt_s : array_like
        Times of the samples, s, ascending, of shape (samples,).
    ins_lat_deg : array_like
        Latitude of the INS, degrees, of shape (samples,).
    ins_lon_deg : array_like
        Longitude of the INS, degrees, of shape (samples,).
    ins_alt_m : array_like
        Height of the INS above the WGS-84 ellipsoid, m, of shape (samples,).
    mag_nt : Magnetometers
        Measured field, nT, of shape (samples,); NaN where there is no measurement. A mapping
        holds several magnetometers under the names of their columns, such as `mag_1_c`
        (compensated) or `mag_1_uc`.
    map : Map
        Anomaly map, such as the result of `magline.maps.open`.
    ins_velocity_ned_mps : array_like, optional
        Velocity of the INS north, east and down, m/s, of shape (samples, 3). Default: derived
        from its positions.
    ins_force_ned_mps2 : array_like, optional
        Specific force of the INS north, east and down, m/s^2, of shape (samples, 3). Default:
        derived from its velocities.
    ins_attitude_deg : array_like, optional
        Roll, pitch and yaw of the INS, degrees, of shape (samples, 3). Default: level, along
        the course.
    columns : Mapping[str, Any], optional
        Further columns of the flight table under their names, in its units: those that keys
        name, and those that the stage uses if they are there, such as `diurnal` (nT), `year`,
        `doy`, `gnss_lat` (deg), `ins_aligned` (s), and the truth `lat` and `lon` (deg) and
        `alt` (m). A value is an array of shape (samples,), one number or text for all samples,
        or a pair of a matrix with one row per sample and the names of its columns.
    tuning : {"auto", "magnav"}, optional
        Source of unset parameters. `auto` estimates the noise of each line from the likelihood
        of its innovations, rejects outliers, and continues a map of known height to the flight
        heights. `magnav` uses the defaults of MagNav.jl, no gate, and the map at its own
        height. A key in the spec takes precedence over both. Default: `"auto"`.
    core_field : bool, optional
        Adds the core field to the predicted measurement. `false` means that the measurement is
        an anomaly. Default: `true`.
    remove_diurnal : bool, optional
        Subtracts the column `diurnal` from the measurement, so that the filter need not
        estimate the temporal variation. A sample with a NaN in `diurnal` has no measurement.
        Unset: true if the flight has a column `diurnal` that has not yet been subtracted from
        the measurement.
    decimal_year : float, optional
        Date of the core field as a decimal year. It replaces the flight's date. Unit: a.
        Allowed: 1900 to 2030. Unset: the flight's own date.
    map_interpolation : {"linear", "quadratic", "cubic"}, optional
        Interpolation of the map. The field above its sources is smooth, so spline interpolation
        is more accurate than bilinear interpolation. Unset: `cubic` with `tuning = "auto"`,
        else `linear`.
    map_levels_m : ListLike, optional
        Heights above the ellipsoid, ascending, to which the map is continued. Between these
        heights the map is interpolated linearly. Unit: m. Unset: with `tuning = "auto"` the map
        is continued to the flight heights, otherwise it is used at its own height.
    map_error_length_m : float, optional
        Correlation length of the map error, for a map with the column `error` (`map_grid`,
        `track_map`); typically the spacing of its survey lines. The correlated map error is
        converted to equivalent white noise, which is added to the measurement noise of each
        sample. The map error is interpolated at the position that an extended Kalman filter
        predicts. Unit: m. Allowed: above 0. Unset: the map is assumed to be exact; `tuning =
        "auto"` instead uses the map's column `error`, or the error of the map's interpolation,
        times an estimated factor.
    offset_window_s : float, optional
        Length of the window at the start of a line in which an offset is computed: the mean of
        measurement minus prediction. The offset is subtracted from all measurements of the line
        before filtering, because compensation leaves a constant undetermined. 0 subtracts
        nothing. Unit: s. Allowed: 0 or above. Default: `0.0`.
    measurement_sigma_nt : float | {"auto"}, optional
        Standard deviation of the white noise of a measurement. It includes the noise of the
        sensor, the map and the compensation. `"auto"` uses the noise of the calibration
        residual, from the column `mag_sigma`. Unit: nT. Allowed: above 0. Unset: the
        maximum-likelihood estimate with `tuning = "auto"`, otherwise 5.0.
    fogm_sigma_nt : float | {"auto"}, optional
        Standard deviation of the first-order Gauss-Markov process for the temporal variation
        and all other slow errors. `"auto"` uses the column `mag_fogm_sigma`. Unit: nT. Allowed:
        0 or above. Unset: the maximum-likelihood estimate with `tuning = "auto"`, otherwise
        3.0.
    fogm_tau_s : float | {"auto"}, optional
        Time constant of the temporal variation. `"auto"` uses the column `mag_fogm_tau`. Unit:
        s. Allowed: above 0. Unset: the maximum-likelihood estimate with `tuning = "auto"`,
        otherwise 600.0.
    noise_column : str, optional
        Column with the standard deviation of an additional error of each sample:
        `mag_aircraft_sigma` of an ensemble, or the predicted error of a network. The square of
        this standard deviation is added to the square of `measurement_sigma_nt`. A sample
        without a value in this column has no measurement. Requires a single magnetometer. Unit:
        nT. Unset: equal noise at all samples.
    start : {"auto", "fix", "alignment", "given"}, optional
        Source of the initial estimate. `fix` corrects the INS with a position fix. `alignment`
        propagates the `init_*` standard deviations from the alignment to the start of the line.
        `given` applies the `init_*` standard deviations at the start of the line; the defaults
        are valid only within minutes of the alignment, because an INS drifts. `auto` selects
        one of the three from the keys and columns. Default: `"auto"`.
    fix : ListLike, optional
        Columns with the latitude (deg), longitude (deg) and height (m) of the fix. The first
        values within 2 s of the line's start are used. If the columns have the role truth,
        white noise with the fix's standard deviations is added. The added noise of a line is
        the same in every run. Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has
        them, else `lat`, `lon` and `alt`.
    fix_velocity : ListLike, optional
        Columns of the fix's velocity components: north, east and down. Unit: m/s. Unset:
        `gnss_vn`, `gnss_ve` and `gnss_vd` for a fix from `gnss_*` columns, otherwise `vn`, `ve`
        and `vd`; without these columns, the velocity of the INS.
    fix_sigma_m : float, optional
        Standard deviation of the fix's position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `3.0`.
    fix_alt_sigma_m : float, optional
        Standard deviation of the fix's height. Unit: m. Allowed: above 0. Default: `5.0`.
    fix_velocity_sigma_mps : float, optional
        Standard deviation of each component of the fix's velocity. Unit: m/s. Allowed: above 0.
        Default: `0.1`.
    vector : str, optional
        Vector magnetometer that gives the direction of the field, such as `flux_a`. The noise
        of this magnetometer, and the aircraft field at its position, are neglected. Unset:
        equal noise in all attitudes.
    sensor_axis : ListLike, optional
        Axis of the scalar sensor in the frame of the vector magnetometer: nose, right, down.
        Allowed: finite. Default: `[1.0,0.0,0.0]`.
    dead_zones : {"none", "polar", "polar_and_equatorial"}, optional
        Dead zones of the scalar sensor: along its axis (`polar`), or also across its axis
        (`polar_and_equatorial`). The assumed noise is inversely proportional to the amplitude
        of the sensor's signal. At the largest amplitude, the noise is `measurement_sigma_nt`. A
        sample whose amplitude is below a tenth of the largest gives no measurement. Default:
        `"none"`.
    ins_grade : {"magnav", "navigation", "tactical", "commercial"}, optional
        Grade of the INS. The grade sets the INS keys (`init_*`, `*_sigma*` and `*_tau_s`) that
        are unset in the spec. `magnav` sets the defaults shown for these keys. `navigation` is
        a Honeywell HG9900, `tactical` a Honeywell HG1700, and `commercial` has micro-mechanical
        sensors [Lee 2019, Tables 9 and 10]. For these three grades, the position at alignment
        is exact (`init_position_sigma_m = 0`). Unset: in `navigate`, the flight's column
        `ins_grade` if present; otherwise `magnav`.
    init_position_sigma_m : float, optional
        Standard deviation of the initial horizontal position error along each axis. Unit: m.
        Allowed: 0 or above. Default: `3.0`.
    init_altitude_sigma_m : float, optional
        Standard deviation of the initial height error. Unit: m. Allowed: 0 or above. Default:
        `0.001`.
    init_velocity_sigma_mps : float, optional
        Standard deviation of the initial velocity error along each axis. Unit: m/s. Allowed: 0
        or above. Default: `0.01`.
    init_attitude_sigma_deg : float, optional
        Standard deviation of the initial tilt error about each axis. Unit: deg. Allowed: 0 or
        above. Default: `0.01`.
    init_heading_sigma_deg : float, optional
        Standard deviation of the initial yaw error, the tilt about the down axis. In practice,
        the yaw error exceeds the other tilt errors, because the INS finds north from the
        earth's rotation, a much weaker signal than gravity. Unit: deg. Allowed: 0 or above.
        Unset: the initial tilt error.
    vrw_sigma : float, optional
        Velocity random walk: square root of the spectral density of the accelerometer noise.
        Unit: m/s^1.5. Allowed: 0 or above. Default: `0.000238`.
    arw_sigma : float, optional
        Angular random walk: square root of the spectral density of the gyro noise. Unit:
        rad/s^0.5. Allowed: 0 or above. Default: `5.81e-7`.
    baro_sigma_m : float, optional
        Standard deviation of the barometer error. Unit: m. Allowed: 0 or above. Default: `1.0`.
    ha_sigma_m : float, optional
        Standard deviation of the initial error of the altitude in the barometer loop, which
        aids the INS height. Unit: m. Allowed: 0 or above. Default: `0.001`.
    a_hat_sigma_mps2 : float, optional
        Standard deviation of the initial error of the vertical acceleration in the barometer
        loop, which aids the INS height. Unit: m/s2. Allowed: 0 or above. Default: `0.01`.
    acc_sigma_mps2 : float, optional
        Standard deviation of the accelerometer bias. Unit: m/s2. Allowed: 0 or above. Default:
        `0.000245`.
    gyro_sigma_radps : float, optional
        Standard deviation of the gyro bias. Unit: rad/s. Allowed: 0 or above. Default:
        `7.27e-9`.
    baro_tau_s : float, optional
        Time constant of the barometer error. Unit: s. Allowed: above 0. Default: `3600.0`.
    acc_tau_s : float, optional
        Time constant of the accelerometer bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    gyro_tau_s : float, optional
        Time constant of the gyro bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    particles : int, optional
        Number of particles. Allowed: 1 to 1000000. Unset: 3000 to 50,000, by KLD-sampling (Fox
        2003) over squares of side `smooth_over_m`.
    seed : int, optional
        Seed of all random draws. The same seed gives bit-identical results on any number of
        threads. Default: `0`.
    smooth_over_m : float, optional
        Distance over which the map is nearly linear; typically the height of the map above the
        sources. A wider cloud of particles is divided into parts with one kernel each. Unit: m.
        Allowed: above 0. Default: `200.0`.
    hand_over_weight : float, optional
        Minimum weight of the most probable mode at the hand-over. Allowed: 0.5 to 1. Default:
        `0.99`.
    gate_nis : float, optional
        Largest accepted NIS of a measurement. Before the hand-over, the NIS is computed from
        the mean and variance of the whole cloud of particles. Allowed: above 0. Unset: no gate;
        with `tuning = "auto"`, outliers are rejected before filtering.
    gnss_lost_s : ListLike, optional
        Times at which GNSS is lost and recovered, in seconds from the first sample of the line.
        Before the loss and after the recovery, the GNSS position (columns `gnss`) aids the
        filter. With `[0.0, 600.0]`, GNSS is missing for the first ten minutes of the line. If
        the recovery time is after the end of the line, GNSS is never recovered. Unit: s.
        Allowed: 0 or above. Unset: GNSS is not used.
    gnss : ListLike, optional
        Columns with the GNSS latitude (deg), longitude (deg) and height above the ellipsoid
        (m). Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has them, else `lat`,
        `lon` and `alt`.
    gnss_interval_s : float, optional
        Time between successive GNSS positions. Unit: s. Allowed: above 0. Default: `1.0`.
    gnss_sigma_m : float, optional
        Standard deviation of the GNSS position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `2.0`.
    gnss_alt_sigma_m : float, optional
        Standard deviation of the GNSS height. Unit: m. Allowed: above 0. Default: `5.0`.
    gnss_noise : bool, optional
        Adds white noise to the GNSS positions, with the standard deviations `gnss_sigma_m` and
        `gnss_alt_sigma_m`. The added noise of a line is the same in every run. True positions
        have no error: without added noise, the filter appears more accurate than with real
        GNSS. Unset: true if the columns of `gnss` have the role `truth`.
    gnss_test : bool, optional
        Tests each GNSS position against the INS position and does not use rejected positions. A
        chi-square test of each position detects a jump at once. A cumulative sum over earlier
        positions detects a drift of 1 m/s after about 10 s. The test then also rejects the
        positions since the start of the drift. Positions are accepted again after ten
        consecutive positions agree with the INS. The column `gnss_update` (`used`, `rejected`
        or `none`) is appended even if this key is false. Default: `true`.
    gradient : ListLike, optional
        Two compensated scalar magnetometers. The difference between their readings, first minus
        second, measures the slope of the map along the baseline between them. The temporal
        variation and all other common errors cancel in this difference. This key cannot be
        combined with `map_interpolation = "linear"`, because the slope of a bilinear map has
        steps. Unit: nT. Unset: the difference is not used.
    gradient_baseline_m : ListLike, optional
        Vector from the second magnetometer of `gradient` to the first, in the body frame (nose,
        right, down). The INS attitude rotates this vector to the navigation frame. The
        measurement model includes the estimated error of the INS attitude. Unit: m. Allowed:
        finite. Unset: required with `gradient`.
    gradient_sigma_nt : float, optional
        Standard deviation of the white noise in the difference between the two magnetometers'
        readings. Unit: nT. Allowed: above 0. Default: `0.1`.
    gradient_bias_sigma_nt : float, optional
        Standard deviation of the slowly varying error in the difference between the two
        magnetometers' readings. Such an error is likely, because each calibration leaves a
        constant undetermined. Unit: nT. Allowed: 0 or above. Default: `1.0`.
    gradient_bias_tau_s : float, optional
        Time constant of the slowly varying error in the difference between the two
        magnetometers' readings. Unit: s. Allowed: above 0. Default: `3600.0`.
    gradient_slope_sigma : float | {"auto"}, optional
        Standard deviation of the error in the map's slope along the baseline. The error of the
        predicted difference is this error times the length of the baseline. The error is
        correlated along the track, over the same length as the map's anomalies. `"auto"` uses
        the maximum-likelihood value from the innovations of the difference. A large value can
        reveal a map made from widely spaced lines. A map at one height without `map_levels_m`
        has no vertical slope. The prediction then has an additional error: the height
        difference between the magnetometers times the rms slope. Unit: nT/m. Allowed: 0 or
        above. Default: `auto`.
    use_scalar : bool, optional
        Uses the scalar measurement `mag` in the measurement update. `false` ignores `mag`, for
        example in a magnetic storm, and requires the difference (`gradient`) or the vector
        (`vector_sigma_nt`). Default: `true`.
    vector_sigma_nt : float, optional
        Standard deviation of the white noise of each component of `vector`. If set, the
        components are used as measurements. They depend on the total field and on the attitude,
        but not on a rotation about the field direction. This key requires `core_field = true`
        and a calibrated vector magnetometer. Unit: nT. Allowed: above 0. Unset: the vector is
        not used as a measurement.
    vector_bias_sigma_nt : float, optional
        Standard deviation of the bias of each component of `vector`. In a field of 50,000 nT, a
        bias of 50 nT corresponds to an attitude error of 0.06°. Unit: nT. Allowed: 0 or above.
        Default: `50.0`.
    vector_bias_tau_s : float, optional
        Time constant of the bias of each component of `vector`. Unit: s. Allowed: above 0.
        Default: `3600.0`.
    vector_crustal_sigma_nt : float, optional
        Standard deviation, per component, of the crustal field that a map of the scalar anomaly
        leaves undetermined. A typical value is the standard deviation of the anomaly. Unit: nT.
        Allowed: 0 or above. Default: `50.0`.
    vector_crustal_length_m : float, optional
        Correlation length of the crustal field that `vector_crustal_sigma_nt` describes. A
        typical value is the height above the sources. Unit: m. Allowed: above 0. Default:
        `1000.0`.
    height : str, optional
        Column of measured heights above the ellipsoid, such as `baro`, from a barometer that
        does not already aid the INS. Unit: m. Unset: the height of the INS, aided by its
        barometer, is used.
    height_sigma_m : float, optional
        Standard deviation of the white noise of the measured height. Unit: m. Allowed: above 0.
        Default: `3.0`.
    height_bias_sigma_m : float, optional
        Standard deviation of the slowly varying error of the measured height, caused by the
        weather and the geoid. Unit: m. Allowed: 0 or above. Default: `30.0`.
    height_bias_tau_s : float, optional
        Time constant of the slowly varying error of the measured height. Unit: s. Allowed:
        above 0. Default: `3600.0`.
    map_sigma_nt : float, optional
        Standard deviation of the map error. If set, the filter estimates the map error as a
        state that is correlated along the track. Unit: nT. Allowed: 0 or above. Unset: the map
        error is not estimated.
    map_sigma_length_m : float, optional
        Distance over which the autocorrelation of the map error falls to 1/e. Unit: m. Allowed:
        above 0. Default: `500.0`.
    mag_latency_sigma_s : float, optional
        Prior standard deviation of the lag of the magnetometer's time stamps. If set, the
        filter estimates the lag as a state that is constant along the line. A sample with time
        stamp `t` was measured at `t` minus the lag. The lag may be negative. 0 omits this
        state. The columns `mag_latency` and `mag_latency_sigma` are appended. This key is
        available in `ekf`, `iekf` and `ukf`. Unit: s. Allowed: 0 or above. Unset: 1.0 with
        `tuning = "auto"` if a state for the lag clearly increases the likelihood, otherwise 0
        (exact time stamps).
    map_height_sigma_m : float, optional
        Prior standard deviation of a height bias: the true height of the aircraft minus its
        assumed height on the map. Possible causes are a constant error of the barometer, a
        missing geoid height, and a wrong map height. If set, the filter estimates the bias as a
        state that is constant along the line. The bias changes only the predicted total field,
        not `alt`. The heights to which the map is continued must include the true height of the
        aircraft. With `tuning = "auto"`, the map is continued to twice this standard deviation
        below and above the line. Otherwise, set `map_levels_m`. 0 omits this state. The columns
        `map_height_bias` and `map_height_bias_sigma` are appended. This key is available in
        `ekf`, `iekf` and `ukf`. Unit: m. Allowed: 0 or above. Unset: 50 with `tuning = "auto"`
        if a bias clearly increases the likelihood, otherwise 0 (exact height). To find a bias,
        `auto` continues the map up to 200 m below and above the line, unless `map_levels_m` is
        set.
    permanent_change_sigma_nt : float, optional
        Standard deviation of the change in the aircraft's permanent field since calibration,
        per component (nose, right, down). The filter estimates the three components as
        additional states. The attitude and the core field determine the effect of these
        components on the total field. A fourth state is a constant offset with a standard
        deviation of 100 nT. 0 omits these states. This key requires `core_field = true`, and is
        available in `ekf`, `iekf` and `ukf`. Unit: nT. Allowed: 0 or above. Unset: the
        maximum-likelihood estimate with `tuning = "auto"` if these states clearly increase the
        likelihood, otherwise 0.
    permanent_change_tau_s : float, optional
        Time constant of the change in the permanent field. Unit: s. Allowed: above 0. Unset:
        the maximum-likelihood estimate with `tuning = "auto"`, otherwise infinite, so that the
        change is constant along the line.
    flat_over_m : float, optional
        A sample corrects the position only if the ratio of its measurement noise (standard
        deviation) to the map's horizontal slope is at most this value. At a larger ratio, the
        map is too flat to observe the position. The sample is then `flat`: it corrects only the
        temporal variation and the map error. The column `map_slope` is appended. Unit: m.
        Allowed: above 0. Unset: all samples correct the position.

    Returns
    -------
    Track
        Estimate at each sample, innovations, warnings and notes.

    Raises
    ------
    SpecError
        If a key is unknown, has an invalid value, or has no effect.
    DataError
        If the line cannot be filtered, such as an INS with a NaN or a line off the map.
    ValueError
        If the shapes of the arrays differ.

    References
    ----------
    Schön, Gustafsson & Nordlund 2005 for the particles; Fox 2003 for their number.

    Examples
    --------
    >>> import numpy as np
    >>> from magline import filters, maps
    >>> lat, lon = np.linspace(45.0, 45.2, 201), np.linspace(-76.1, -75.9, 201)
    >>> hills = 60.0 * np.sin(400.0 * lat[:, None]) + 50.0 * np.cos(500.0 * (lat[:, None] + lon))
    >>> field = maps.Map(lon, lat, hills, np.full(hills.shape, 300.0), 4326, "deg")
    >>> t = np.arange(100.0)  # northward over the nodes of a column; the INS is 11 m too far north
    >>> ins = t, lat[50:150] + 1e-4, np.full(100, lon[100]), np.full(100, 300.0)
    >>> start = {"start": "given", "init_position_sigma_m": 20.0}
    >>> track = filters.mpf_then_ekf(*ins, hills[50:150, 100], field, core_field=False, **start)
    >>> bool(abs(track.lat_deg[-1] - lat[149]) < 5e-5)
    True
    """
    return navigate_line("mpf_then_ekf", locals())


def crlb(
    tt_s: ArrayLike,
    ins_lat_deg: ArrayLike,
    ins_lon_deg: ArrayLike,
    ins_alt_m: ArrayLike,
    mag_nt: Magnetometers,
    map: Map,
    *,
    ins_velocity_ned_mps: ArrayLike | None = None,
    ins_force_ned_mps2: ArrayLike | None = None,
    ins_attitude_deg: ArrayLike | None = None,
    columns: Mapping[str, Any] | None = None,
    tuning: Literal["auto", "magnav"] | None = None,
    core_field: bool | None = None,
    remove_diurnal: bool | None = None,
    decimal_year: float | None = None,
    map_interpolation: Literal["linear", "quadratic", "cubic"] | None = None,
    map_levels_m: ListLike | None = None,
    map_error_length_m: float | None = None,
    offset_window_s: float | None = None,
    measurement_sigma_nt: float | Literal["auto"] | None = None,
    fogm_sigma_nt: float | Literal["auto"] | None = None,
    fogm_tau_s: float | Literal["auto"] | None = None,
    noise_column: str | None = None,
    start: Literal["auto", "fix", "alignment", "given"] | None = None,
    fix: ListLike | None = None,
    fix_velocity: ListLike | None = None,
    fix_sigma_m: float | None = None,
    fix_alt_sigma_m: float | None = None,
    fix_velocity_sigma_mps: float | None = None,
    vector: str | None = None,
    sensor_axis: ListLike | None = None,
    dead_zones: Literal["none", "polar", "polar_and_equatorial"] | None = None,
    ins_grade: Literal["magnav", "navigation", "tactical", "commercial"] | None = None,
    init_position_sigma_m: float | None = None,
    init_altitude_sigma_m: float | None = None,
    init_velocity_sigma_mps: float | None = None,
    init_attitude_sigma_deg: float | None = None,
    init_heading_sigma_deg: float | None = None,
    vrw_sigma: float | None = None,
    arw_sigma: float | None = None,
    baro_sigma_m: float | None = None,
    ha_sigma_m: float | None = None,
    a_hat_sigma_mps2: float | None = None,
    acc_sigma_mps2: float | None = None,
    gyro_sigma_radps: float | None = None,
    baro_tau_s: float | None = None,
    acc_tau_s: float | None = None,
    gyro_tau_s: float | None = None,
    discretisation: Literal["trapezoidal", "rectangular", "van_loan"] | None = None,
    save_state: bool | None = None,
    gnss_lost_s: ListLike | None = None,
    gnss: ListLike | None = None,
    gnss_interval_s: float | None = None,
    gnss_sigma_m: float | None = None,
    gnss_alt_sigma_m: float | None = None,
    gnss_noise: bool | None = None,
    gnss_test: bool | None = None,
    gradient: ListLike | None = None,
    gradient_baseline_m: ListLike | None = None,
    gradient_sigma_nt: float | None = None,
    gradient_bias_sigma_nt: float | None = None,
    gradient_bias_tau_s: float | None = None,
    gradient_slope_sigma: float | Literal["auto"] | None = None,
    use_scalar: bool | None = None,
    vector_sigma_nt: float | None = None,
    vector_bias_sigma_nt: float | None = None,
    vector_bias_tau_s: float | None = None,
    vector_crustal_sigma_nt: float | None = None,
    vector_crustal_length_m: float | None = None,
    height: str | None = None,
    height_sigma_m: float | None = None,
    height_bias_sigma_m: float | None = None,
    height_bias_tau_s: float | None = None,
    map_sigma_nt: float | None = None,
    map_sigma_length_m: float | None = None,
    mag_latency_sigma_s: float | None = None,
    map_height_sigma_m: float | None = None,
    permanent_change_sigma_nt: float | None = None,
    permanent_change_tau_s: float | None = None,
    flat_over_m: float | None = None,
) -> Track:
    """The Cramér-Rao bound: the smallest error of any filter with the same models on the same
    flight.

    The filter `crlb` evaluates the covariance along the true positions (`lat`, `lon`, `alt`).
    Compare the bound with the error of another filter's track to see whether this error is due
    to the filter or to the flight.

    `crlb` makes no estimate: its track consists of the true positions, so `score` gives no
    error for it. The columns `sd_n`, `sd_e` and `drms_bound` hold the bound at each sample. The
    metric `drms_bound` is the bound over the line; a search never selects a point by this
    metric. `residual` is the measurement minus the field at the true position. `nis` is the
    square of this residual divided by its variance under the assumed noise. A mean `nis` of 1
    confirms the assumed noise. `vn`, `ve` and `vd` hold the velocity of the INS.

    Parameters
    ----------
    tt_s : array_like
        Times of the samples, s, ascending, of shape (samples,).
    ins_lat_deg : array_like
        Latitude of the INS, degrees, of shape (samples,).
    ins_lon_deg : array_like
        Longitude of the INS, degrees, of shape (samples,).
    ins_alt_m : array_like
        Height of the INS above the WGS-84 ellipsoid, m, of shape (samples,).
    mag_nt : Magnetometers
        Measured field, nT, of shape (samples,); NaN where there is no measurement. A mapping
        holds several magnetometers under the names of their columns, such as `mag_1_c`
        (compensated) or `mag_1_uc`.
    map : Map
        Anomaly map, such as the result of `magline.maps.open`.
    ins_velocity_ned_mps : array_like, optional
        Velocity of the INS north, east and down, m/s, of shape (samples, 3). Default: derived
        from its positions.
    ins_force_ned_mps2 : array_like, optional
        Specific force of the INS north, east and down, m/s^2, of shape (samples, 3). Default:
        derived from its velocities.
    ins_attitude_deg : array_like, optional
        Roll, pitch and yaw of the INS, degrees, of shape (samples, 3). Default: level, along
        the course.
    columns : Mapping[str, Any], optional
        Further columns of the flight table under their names, in its units: those that keys
        name, and those that the stage uses if they are there, such as `diurnal` (nT), `year`,
        `doy`, `gnss_lat` (deg), `ins_aligned` (s), and the truth `lat` and `lon` (deg) and
        `alt` (m). A value is an array of shape (samples,), one number or text for all samples,
        or a pair of a matrix with one row per sample and the names of its columns.
    tuning : {"auto", "magnav"}, optional
        Source of unset parameters. `auto` estimates the noise of each line from the likelihood
        of its innovations, rejects outliers, and continues a map of known height to the flight
        heights. `magnav` uses the defaults of MagNav.jl, no gate, and the map at its own
        height. A key in the spec takes precedence over both. Default: `"auto"`.
    core_field : bool, optional
        Adds the core field to the predicted measurement. `false` means that the measurement is
        an anomaly. Default: `true`.
    remove_diurnal : bool, optional
        Subtracts the column `diurnal` from the measurement, so that the filter need not
        estimate the temporal variation. A sample with a NaN in `diurnal` has no measurement.
        Unset: true if the flight has a column `diurnal` that has not yet been subtracted from
        the measurement.
    decimal_year : float, optional
        Date of the core field as a decimal year. It replaces the flight's date. Unit: a.
        Allowed: 1900 to 2030. Unset: the flight's own date.
    map_interpolation : {"linear", "quadratic", "cubic"}, optional
        Interpolation of the map. The field above its sources is smooth, so spline interpolation
        is more accurate than bilinear interpolation. Unset: `cubic` with `tuning = "auto"`,
        else `linear`.
    map_levels_m : ListLike, optional
        Heights above the ellipsoid, ascending, to which the map is continued. Between these
        heights the map is interpolated linearly. Unit: m. Unset: with `tuning = "auto"` the map
        is continued to the flight heights, otherwise it is used at its own height.
    map_error_length_m : float, optional
        Correlation length of the map error, for a map with the column `error` (`map_grid`,
        `track_map`); typically the spacing of its survey lines. The correlated map error is
        converted to equivalent white noise, which is added to the measurement noise of each
        sample. The map error is interpolated at the position that an extended Kalman filter
        predicts. Unit: m. Allowed: above 0. Unset: the map is assumed to be exact; `tuning =
        "auto"` instead uses the map's column `error`, or the error of the map's interpolation,
        times an estimated factor.
    offset_window_s : float, optional
        Length of the window at the start of a line in which an offset is computed: the mean of
        measurement minus prediction. The offset is subtracted from all measurements of the line
        before filtering, because compensation leaves a constant undetermined. 0 subtracts
        nothing. Unit: s. Allowed: 0 or above. Default: `0.0`.
    measurement_sigma_nt : float | {"auto"}, optional
        Standard deviation of the white noise of a measurement. It includes the noise of the
        sensor, the map and the compensation. `"auto"` uses the noise of the calibration
        residual, from the column `mag_sigma`. Unit: nT. Allowed: above 0. Unset: the
        maximum-likelihood estimate with `tuning = "auto"`, otherwise 5.0.
    fogm_sigma_nt : float | {"auto"}, optional
        Standard deviation of the first-order Gauss-Markov process for the temporal variation
        and all other slow errors. `"auto"` uses the column `mag_fogm_sigma`. Unit: nT. Allowed:
        0 or above. Unset: the maximum-likelihood estimate with `tuning = "auto"`, otherwise
        3.0.
    fogm_tau_s : float | {"auto"}, optional
        Time constant of the temporal variation. `"auto"` uses the column `mag_fogm_tau`. Unit:
        s. Allowed: above 0. Unset: the maximum-likelihood estimate with `tuning = "auto"`,
        otherwise 600.0.
    noise_column : str, optional
        Column with the standard deviation of an additional error of each sample:
        `mag_aircraft_sigma` of an ensemble, or the predicted error of a network. The square of
        this standard deviation is added to the square of `measurement_sigma_nt`. A sample
        without a value in this column has no measurement. Requires a single magnetometer. Unit:
        nT. Unset: equal noise at all samples.
    start : {"auto", "fix", "alignment", "given"}, optional
        Source of the initial estimate. `fix` corrects the INS with a position fix. `alignment`
        propagates the `init_*` standard deviations from the alignment to the start of the line.
        `given` applies the `init_*` standard deviations at the start of the line; the defaults
        are valid only within minutes of the alignment, because an INS drifts. `auto` selects
        one of the three from the keys and columns. Default: `"auto"`.
    fix : ListLike, optional
        Columns with the latitude (deg), longitude (deg) and height (m) of the fix. The first
        values within 2 s of the line's start are used. If the columns have the role truth,
        white noise with the fix's standard deviations is added. The added noise of a line is
        the same in every run. Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has
        them, else `lat`, `lon` and `alt`.
    fix_velocity : ListLike, optional
        Columns of the fix's velocity components: north, east and down. Unit: m/s. Unset:
        `gnss_vn`, `gnss_ve` and `gnss_vd` for a fix from `gnss_*` columns, otherwise `vn`, `ve`
        and `vd`; without these columns, the velocity of the INS.
    fix_sigma_m : float, optional
        Standard deviation of the fix's position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `3.0`.
    fix_alt_sigma_m : float, optional
        Standard deviation of the fix's height. Unit: m. Allowed: above 0. Default: `5.0`.
    fix_velocity_sigma_mps : float, optional
        Standard deviation of each component of the fix's velocity. Unit: m/s. Allowed: above 0.
        Default: `0.1`.
    vector : str, optional
        Vector magnetometer that gives the direction of the field, such as `flux_a`. The noise
        of this magnetometer, and the aircraft field at its position, are neglected. Unset:
        equal noise in all attitudes.
    sensor_axis : ListLike, optional
        Axis of the scalar sensor in the frame of the vector magnetometer: nose, right, down.
        Allowed: finite. Default: `[1.0,0.0,0.0]`.
    dead_zones : {"none", "polar", "polar_and_equatorial"}, optional
        Dead zones of the scalar sensor: along its axis (`polar`), or also across its axis
        (`polar_and_equatorial`). The assumed noise is inversely proportional to the amplitude
        of the sensor's signal. At the largest amplitude, the noise is `measurement_sigma_nt`. A
        sample whose amplitude is below a tenth of the largest gives no measurement. Default:
        `"none"`.
    ins_grade : {"magnav", "navigation", "tactical", "commercial"}, optional
        Grade of the INS. The grade sets the INS keys (`init_*`, `*_sigma*` and `*_tau_s`) that
        are unset in the spec. `magnav` sets the defaults shown for these keys. `navigation` is
        a Honeywell HG9900, `tactical` a Honeywell HG1700, and `commercial` has micro-mechanical
        sensors [Lee 2019, Tables 9 and 10]. For these three grades, the position at alignment
        is exact (`init_position_sigma_m = 0`). Unset: in `navigate`, the flight's column
        `ins_grade` if present; otherwise `magnav`.
    init_position_sigma_m : float, optional
        Standard deviation of the initial horizontal position error along each axis. Unit: m.
        Allowed: 0 or above. Default: `3.0`.
    init_altitude_sigma_m : float, optional
        Standard deviation of the initial height error. Unit: m. Allowed: 0 or above. Default:
        `0.001`.
    init_velocity_sigma_mps : float, optional
        Standard deviation of the initial velocity error along each axis. Unit: m/s. Allowed: 0
        or above. Default: `0.01`.
    init_attitude_sigma_deg : float, optional
        Standard deviation of the initial tilt error about each axis. Unit: deg. Allowed: 0 or
        above. Default: `0.01`.
    init_heading_sigma_deg : float, optional
        Standard deviation of the initial yaw error, the tilt about the down axis. In practice,
        the yaw error exceeds the other tilt errors, because the INS finds north from the
        earth's rotation, a much weaker signal than gravity. Unit: deg. Allowed: 0 or above.
        Unset: the initial tilt error.
    vrw_sigma : float, optional
        Velocity random walk: square root of the spectral density of the accelerometer noise.
        Unit: m/s^1.5. Allowed: 0 or above. Default: `0.000238`.
    arw_sigma : float, optional
        Angular random walk: square root of the spectral density of the gyro noise. Unit:
        rad/s^0.5. Allowed: 0 or above. Default: `5.81e-7`.
    baro_sigma_m : float, optional
        Standard deviation of the barometer error. Unit: m. Allowed: 0 or above. Default: `1.0`.
    ha_sigma_m : float, optional
        Standard deviation of the initial error of the altitude in the barometer loop, which
        aids the INS height. Unit: m. Allowed: 0 or above. Default: `0.001`.
    a_hat_sigma_mps2 : float, optional
        Standard deviation of the initial error of the vertical acceleration in the barometer
        loop, which aids the INS height. Unit: m/s2. Allowed: 0 or above. Default: `0.01`.
    acc_sigma_mps2 : float, optional
        Standard deviation of the accelerometer bias. Unit: m/s2. Allowed: 0 or above. Default:
        `0.000245`.
    gyro_sigma_radps : float, optional
        Standard deviation of the gyro bias. Unit: rad/s. Allowed: 0 or above. Default:
        `7.27e-9`.
    baro_tau_s : float, optional
        Time constant of the barometer error. Unit: s. Allowed: above 0. Default: `3600.0`.
    acc_tau_s : float, optional
        Time constant of the accelerometer bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    gyro_tau_s : float, optional
        Time constant of the gyro bias. Unit: s. Allowed: above 0. Default: `3600.0`.
    discretisation : {"trapezoidal", "rectangular", "van_loan"}, optional
        Discretisation of the process noise: `trapezoidal` is of second order, `rectangular` of
        first order as in MagNav.jl, and `van_loan` exact. Default: `"trapezoidal"`.
    save_state : bool, optional
        Appends the covariance `p` (row-major). Default: `false`.
    gnss_lost_s : ListLike, optional
        Times at which GNSS is lost and recovered, in seconds from the first sample of the line.
        Before the loss and after the recovery, the GNSS position (columns `gnss`) aids the
        filter. With `[0.0, 600.0]`, GNSS is missing for the first ten minutes of the line. If
        the recovery time is after the end of the line, GNSS is never recovered. Unit: s.
        Allowed: 0 or above. Unset: GNSS is not used.
    gnss : ListLike, optional
        Columns with the GNSS latitude (deg), longitude (deg) and height above the ellipsoid
        (m). Unset: `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has them, else `lat`,
        `lon` and `alt`.
    gnss_interval_s : float, optional
        Time between successive GNSS positions. Unit: s. Allowed: above 0. Default: `1.0`.
    gnss_sigma_m : float, optional
        Standard deviation of the GNSS position along each horizontal axis. Unit: m. Allowed:
        above 0. Default: `2.0`.
    gnss_alt_sigma_m : float, optional
        Standard deviation of the GNSS height. Unit: m. Allowed: above 0. Default: `5.0`.
    gnss_noise : bool, optional
        Adds white noise to the GNSS positions, with the standard deviations `gnss_sigma_m` and
        `gnss_alt_sigma_m`. The added noise of a line is the same in every run. True positions
        have no error: without added noise, the filter appears more accurate than with real
        GNSS. Unset: true if the columns of `gnss` have the role `truth`.
    gnss_test : bool, optional
        Tests each GNSS position against the INS position and does not use rejected positions. A
        chi-square test of each position detects a jump at once. A cumulative sum over earlier
        positions detects a drift of 1 m/s after about 10 s. The test then also rejects the
        positions since the start of the drift. Positions are accepted again after ten
        consecutive positions agree with the INS. The column `gnss_update` (`used`, `rejected`
        or `none`) is appended even if this key is false. Default: `true`.
    gradient : ListLike, optional
        Two compensated scalar magnetometers. The difference between their readings, first minus
        second, measures the slope of the map along the baseline between them. The temporal
        variation and all other common errors cancel in this difference. This key cannot be
        combined with `map_interpolation = "linear"`, because the slope of a bilinear map has
        steps. Unit: nT. Unset: the difference is not used.
    gradient_baseline_m : ListLike, optional
        Vector from the second magnetometer of `gradient` to the first, in the body frame (nose,
        right, down). The INS attitude rotates this vector to the navigation frame. The
        measurement model includes the estimated error of the INS attitude. Unit: m. Allowed:
        finite. Unset: required with `gradient`.
    gradient_sigma_nt : float, optional
        Standard deviation of the white noise in the difference between the two magnetometers'
        readings. Unit: nT. Allowed: above 0. Default: `0.1`.
    gradient_bias_sigma_nt : float, optional
        Standard deviation of the slowly varying error in the difference between the two
        magnetometers' readings. Such an error is likely, because each calibration leaves a
        constant undetermined. Unit: nT. Allowed: 0 or above. Default: `1.0`.
    gradient_bias_tau_s : float, optional
        Time constant of the slowly varying error in the difference between the two
        magnetometers' readings. Unit: s. Allowed: above 0. Default: `3600.0`.
    gradient_slope_sigma : float | {"auto"}, optional
        Standard deviation of the error in the map's slope along the baseline. The error of the
        predicted difference is this error times the length of the baseline. The error is
        correlated along the track, over the same length as the map's anomalies. `"auto"` uses
        the maximum-likelihood value from the innovations of the difference. A large value can
        reveal a map made from widely spaced lines. A map at one height without `map_levels_m`
        has no vertical slope. The prediction then has an additional error: the height
        difference between the magnetometers times the rms slope. Unit: nT/m. Allowed: 0 or
        above. Default: `auto`.
    use_scalar : bool, optional
        Uses the scalar measurement `mag` in the measurement update. `false` ignores `mag`, for
        example in a magnetic storm, and requires the difference (`gradient`) or the vector
        (`vector_sigma_nt`). Default: `true`.
    vector_sigma_nt : float, optional
        Standard deviation of the white noise of each component of `vector`. If set, the
        components are used as measurements. They depend on the total field and on the attitude,
        but not on a rotation about the field direction. This key requires `core_field = true`
        and a calibrated vector magnetometer. Unit: nT. Allowed: above 0. Unset: the vector is
        not used as a measurement.
    vector_bias_sigma_nt : float, optional
        Standard deviation of the bias of each component of `vector`. In a field of 50,000 nT, a
        bias of 50 nT corresponds to an attitude error of 0.06°. Unit: nT. Allowed: 0 or above.
        Default: `50.0`.
    vector_bias_tau_s : float, optional
        Time constant of the bias of each component of `vector`. Unit: s. Allowed: above 0.
        Default: `3600.0`.
    vector_crustal_sigma_nt : float, optional
        Standard deviation, per component, of the crustal field that a map of the scalar anomaly
        leaves undetermined. A typical value is the standard deviation of the anomaly. Unit: nT.
        Allowed: 0 or above. Default: `50.0`.
    vector_crustal_length_m : float, optional
        Correlation length of the crustal field that `vector_crustal_sigma_nt` describes. A
        typical value is the height above the sources. Unit: m. Allowed: above 0. Default:
        `1000.0`.
    height : str, optional
        Column of measured heights above the ellipsoid, such as `baro`, from a barometer that
        does not already aid the INS. Unit: m. Unset: the height of the INS, aided by its
        barometer, is used.
    height_sigma_m : float, optional
        Standard deviation of the white noise of the measured height. Unit: m. Allowed: above 0.
        Default: `3.0`.
    height_bias_sigma_m : float, optional
        Standard deviation of the slowly varying error of the measured height, caused by the
        weather and the geoid. Unit: m. Allowed: 0 or above. Default: `30.0`.
    height_bias_tau_s : float, optional
        Time constant of the slowly varying error of the measured height. Unit: s. Allowed:
        above 0. Default: `3600.0`.
    map_sigma_nt : float, optional
        Standard deviation of the map error. If set, the filter estimates the map error as a
        state that is correlated along the track. Unit: nT. Allowed: 0 or above. Unset: the map
        error is not estimated.
    map_sigma_length_m : float, optional
        Distance over which the autocorrelation of the map error falls to 1/e. Unit: m. Allowed:
        above 0. Default: `500.0`.
    mag_latency_sigma_s : float, optional
        Prior standard deviation of the lag of the magnetometer's time stamps. If set, the
        filter estimates the lag as a state that is constant along the line. A sample with time
        stamp `t` was measured at `t` minus the lag. The lag may be negative. 0 omits this
        state. The columns `mag_latency` and `mag_latency_sigma` are appended. This key is
        available in `ekf`, `iekf` and `ukf`. Unit: s. Allowed: 0 or above. Unset: 1.0 with
        `tuning = "auto"` if a state for the lag clearly increases the likelihood, otherwise 0
        (exact time stamps).
    map_height_sigma_m : float, optional
        Prior standard deviation of a height bias: the true height of the aircraft minus its
        assumed height on the map. Possible causes are a constant error of the barometer, a
        missing geoid height, and a wrong map height. If set, the filter estimates the bias as a
        state that is constant along the line. The bias changes only the predicted total field,
        not `alt`. The heights to which the map is continued must include the true height of the
        aircraft. With `tuning = "auto"`, the map is continued to twice this standard deviation
        below and above the line. Otherwise, set `map_levels_m`. 0 omits this state. The columns
        `map_height_bias` and `map_height_bias_sigma` are appended. This key is available in
        `ekf`, `iekf` and `ukf`. Unit: m. Allowed: 0 or above. Unset: 50 with `tuning = "auto"`
        if a bias clearly increases the likelihood, otherwise 0 (exact height). To find a bias,
        `auto` continues the map up to 200 m below and above the line, unless `map_levels_m` is
        set.
    permanent_change_sigma_nt : float, optional
        Standard deviation of the change in the aircraft's permanent field since calibration,
        per component (nose, right, down). The filter estimates the three components as
        additional states. The attitude and the core field determine the effect of these
        components on the total field. A fourth state is a constant offset with a standard
        deviation of 100 nT. 0 omits these states. This key requires `core_field = true`, and is
        available in `ekf`, `iekf` and `ukf`. Unit: nT. Allowed: 0 or above. Unset: the
        maximum-likelihood estimate with `tuning = "auto"` if these states clearly increase the
        likelihood, otherwise 0.
    permanent_change_tau_s : float, optional
        Time constant of the change in the permanent field. Unit: s. Allowed: above 0. Unset:
        the maximum-likelihood estimate with `tuning = "auto"`, otherwise infinite, so that the
        change is constant along the line.
    flat_over_m : float, optional
        A sample corrects the position only if the ratio of its measurement noise (standard
        deviation) to the map's horizontal slope is at most this value. At a larger ratio, the
        map is too flat to observe the position. The sample is then `flat`: it corrects only the
        temporal variation and the map error. The column `map_slope` is appended. Unit: m.
        Allowed: above 0. Unset: all samples correct the position.

    Returns
    -------
    Track
        Estimate at each sample, innovations, warnings and notes.

    Raises
    ------
    SpecError
        If a key is unknown, has an invalid value, or has no effect.
    DataError
        If the line cannot be filtered, such as an INS with a NaN or a line off the map.
    ValueError
        If the shapes of the arrays differ.

    References
    ----------
    Tichavský, Muravchik & Nehorai 1998; MagNav.jl's `crlb`, which agrees to 8 digits.

    Examples
    --------
    >>> import numpy as np
    >>> from magline import filters, maps
    >>> lat, lon = np.linspace(45.0, 45.2, 201), np.linspace(-76.1, -75.9, 201)
    >>> hills = 60.0 * np.sin(400.0 * lat[:, None]) + 50.0 * np.cos(500.0 * (lat[:, None] + lon))
    >>> field = maps.Map(lon, lat, hills, np.full(hills.shape, 300.0), 4326, "deg")
    >>> t = np.arange(100.0)  # northward over the nodes of a column; the INS is 11 m too far north
    >>> ins = t, lat[50:150] + 1e-4, np.full(100, lon[100]), np.full(100, 300.0)
    >>> start = {"start": "given", "init_position_sigma_m": 20.0}
    >>> columns = {"lat": lat[50:150], "lon": ins[2], "alt": ins[3]}  # the true positions
    >>> track = filters.crlb(*ins, hills[50:150, 100], field, columns=columns, core_field=False, **start)
    >>> bool(track.more['drms_bound'][-1] < 20.0)
    True
    """
    return navigate_line("crlb", locals())
