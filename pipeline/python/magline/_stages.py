"""Methods of `Spec` for the tables, the search and the stages of a spec.

Made from the declarations by `generate.py`; do not edit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from os import PathLike

    from magline.spec import Axis, ListLike, TableHandle, TableLike


class StageMethods:
    """Methods of `Spec` that are made from the declarations."""

    def _stage(self, kind: str, given: Mapping[str, Any]) -> TableHandle:
        raise NotImplementedError

    def _table(self, given: Mapping[str, Any]) -> TableHandle:
        raise NotImplementedError

    def _search(self, given: Mapping[str, Any]) -> None:
        raise NotImplementedError

    def _search_axis(self, given: Mapping[str, Any]) -> Axis:
        raise NotImplementedError
    def table(
        self,
        name: str,
        path: str | PathLike[str],
        *,
        format: str | None = None,
        topic: str | None = None,
        rename: Mapping[str, Any] | None = None,
        units: Mapping[str, Any] | None = None,
        missing: ListLike | None = None,
        flight: str | None = None,
        line: str | None = None,
        epsg: int | None = None,
        accept: Sequence[Literal["range"]] | None = None,
        mapping: str | None = None,
        table: ListLike | None = None,
        lines: str | None = None,
        alt_m: float | None = None,
        unit: str | None = None,
        field_component: Literal["north", "east", "down"] | None = None,
        features: ListLike | None = None,
        where: str | None = None,
        restricted: bool | Sequence[str] | None = None,
        embargo: str | None = None,
        reason: str | None = None,
        least_samples: int | None = None,
        least_ratio: float | None = None,
    ) -> TableHandle:
        """Declares a table that is read from files: flights, a map or a model.

        Parameters
        ----------
        name : str
            Name of the table.
        path : str | PathLike[str]
            File, folder, glob or address of the files; or a spec of simulated flights.
        format : str, optional
            For tables of flights, maps: Name of the format. Unset: detected from content and
            extension.
        topic : str, optional
            For tables of flights: Message, topic or array to read from a log that holds several,
            such as `MAG` or `sensor_mag:1`. The value `.` selects the vectors at the root of a
            MATLAB file. Unset: the only topic of the file.
        rename : Mapping[str, Any], optional
            For tables of flights: Name of each column in magline, keyed by its name in the file. If
            the name in the file contains a unit (`GPS Lat (rad)`, `Alt ft`, `Mag_mgauss`), the
            column takes this unit. A unit that cannot be converted is rejected. Default: `{}`.
        units : Mapping[str, Any], optional
            For tables of flights: Unit of each column, keyed by its name in the file. It overrides
            units in names and metadata. Default: `{}`.
        missing : ListLike, optional
            For tables of flights: Strings and numbers that mark a missing value, in addition to
            `N/A`, `NA`, `null`, `none`, `NaN`, `-`, `*`, an empty cell, -99999 and Geosoft's -1e32.
            Default: `[]`.
            For maps: Numbers that mark an unknown value, in addition to the file's own markers and
            the usual markers (the largest single-precision number, Surfer's blank, Geosoft's
            -1e32). Default: `[]`.
        flight : str, optional
            For tables of flights: Flight identifier, for files without one. Unset: read from the
            file.
        line : str, optional
            For tables of flights: Line identifier, for files without one. Unset: read from the
            file.
        epsg : int, optional
            For tables of flights: EPSG code of the eastings and northings of survey points (`format
            = "points"`). Unset: read from the file.
            For maps: EPSG code of the coordinates. It overrides the code in the file. It is
            required for eastings and northings in a file without a code. Unset: read from the file.
        accept : Sequence[{"range"}], optional
            For tables of flights: Plausibility checks that are disabled for this file. `range`
            rejects values outside the limits of their column, and columns that contradict each
            other. Default: `[]`.
            For maps: Plausibility checks that are disabled for this map. `range` rejects values
            outside the limits of their column. Default: `[]`.
        mapping : str, optional
            For tables of flights: Mapping of the columns: a TOML file, or the name of a built-in
            mapping such as `px4_ulog`. `auto` selects the built-in mapping that reads the largest
            part of the first log, and reports its name in a note. A mapping replaces `units` and
            `topic`. With a mapping, `rename` applies to the columns of the mapping. Unset: columns
            are identified by their names.
        table : ListLike, optional
            For tables of flights: Table of the mapping to read. A list declares several tables at
            once: in `[tables.log]`, `table = ["mag", "gps"]` declares `log_mag` and `log_gps`.
            Unset: the only table.
        lines : str, optional
            For tables of flights: Table with the columns `flight`, `line`, `t_start` and `t_end`
            (in seconds past midnight UTC). It replaces the lines in the files. A sample belongs to
            the line that contains its time; samples outside all lines are dropped. `auto` finds the
            lines of each flight: straight lines and tie lines, calibration boxes, cloverleafs,
            figures of eight and circles. `magline ingest --lines auto --picture lines.svg` plots
            these lines and writes the table. Unset: the lines of the files.
        alt_m : float, optional
            For maps: Height of the map above the WGS-84 ellipsoid. It overrides the height in the
            file. Unit: m. Unset: read from the file.
        unit : str, optional
            For maps: Unit of the anomaly. It overrides the unit in the file. Unset: read from the
            file, else nT.
        field_component : {"north", "east", "down"}, optional
            For maps: Component to read from a map with three components, such as MagNav.jl's
            `EMM720_World.h5`. Its values are not a total-field anomaly. Unset: the map holds the
            total-field anomaly.
        features : ListLike, optional
            For models: Columns that the model requires in each line: the `features` of its fit.
            Default: `["tl"]`.
        where : str, optional
            For a model: SQL condition on its columns that selects one model of several.
        restricted : bool | Sequence[str], optional
            True for the whole table, or the names of columns. `magline publish` rejects results
            made from them row by row. Default: False.
        embargo : str, optional
            First day of permitted publication, `YYYY-MM-DD`. Unset: the restriction does not end.
        reason : str, optional
            Reason of the restriction, for messages. Unset: no reason.
        least_samples : int, optional
            Minimum number of samples behind each published score or coefficient that is computed
            from restricted columns. Default: 100.
        least_ratio : float, optional
            Minimum number of samples per published number of one aggregate. Default: 10.0.
        """
        return self._table(locals())

    def search(
        self,
        *,
        trials: int,
        goal: str,
        method: Literal["random", "sobol", "tpe"] | None = None,
        direction: Literal["minimise", "maximise"] | None = None,
        seed: int | None = None,
        generation: int | None = None,
        start: int | None = None,
        scramble: bool | None = None,
        where: str | None = None,
        halving: Mapping[str, Any] | None = None,
    ) -> None:
        """Declares a search, which proposes the values of the axes of `search_axis`.

        Parameters
        ----------
        trials : int
            The number of trials. Allowed: 1 to 100000.
        goal : str
            The objective: a table of scores and one of its metrics, such as `scores.std_error`. The
            values of the lines are pooled as in the summary of a run, over all points of the
            remaining axes.
        method : {"random", "sobol", "tpe"}, optional
            The method that proposes trials. Default: `"tpe"`.
        direction : {"minimise", "maximise"}, optional
            The direction of improvement of the goal. Unset: the direction of the metric.
        seed : int, optional
            The seed of all random draws. Unset: the spec's seed.
        generation : int, optional
            For `tpe`: the number of trials that are proposed together, before any of their scores
            is available. Allowed: 1 to 100000. Unset: 8.
        start : int, optional
            For `tpe`: the number of initial trials from a Sobol sequence. Allowed: 1 to 100000.
            Unset: 10.
        scramble : bool, optional
            For `sobol`: whether the seed scrambles the sequence. An unscrambled sequence begins at
            the lower ends of all axes. Unset: true.
        where : str, optional
            SQL predicate on `flight` and `line` that selects the lines of the goal.
        halving : Mapping[str, Any], optional
            Successive halving: `axis`, its `values`, the cheapest first, and `eta`.
        """
        return self._search(locals())

    def search_axis(
        self,
        name: str,
        choices: Sequence[Any] | None = None,
        *,
        low: float | None = None,
        high: float | None = None,
        log: bool | None = None,
        whole: bool | None = None,
    ) -> Axis:
        """Declares an axis whose values a search proposes.

        Parameters
        ----------
        name : str
            Name of the axis.
        choices : Sequence[Any], optional
            Values to choose from. Default: all values from `low` to `high`.
        low : float, optional
            The lower end. Allowed: finite.
        high : float, optional
            The upper end. Allowed: finite.
        log : bool, optional
            Whether the axis is logarithmic. Default: `false`.
        whole : bool, optional
            Whether the values are whole numbers, both ends included. Default: `false`.
        """
        return self._search_axis(locals())

    def resample(
        self,
        *,
        input: TableLike | Sequence[TableLike],
        rate_hz: float | Axis,
        method: Literal["linear", "nearest", "cubic"] | Axis | None = None,
        max_gap_s: ListLike | Axis | None = None,
        span: Literal["all", "first"] | Axis | None = None,
        lag_s: Mapping[str, Any] | Axis | None = None,
        input_lag_s: ListLike | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Resamples every column of a line to evenly spaced times: the whole multiples of
        1/`rate_hz`.

        Numbers are interpolated; angles (unit deg) are interpolated along the shorter arc. Text,
        booleans and columns of integer type take the value of the nearest sample. Other columns of
        whole numbers without a unit stay whole. A column with few distinct values holds codes or
        flags, and takes the value of the nearest sample. A column with many distinct values holds
        counts, which are interpolated and rounded. A column with a unit, or with the role sensor or
        truth, is a measured quantity. It is interpolated even if its values are whole. To have a
        column treated as measured, set its unit in `units` of its table.

        The new times begin at the first multiple at or after the first sample. They end at the last
        multiple at or before the last sample. Sensors that are resampled separately therefore have
        the same times.

        Times within a gap longer than `max_gap_s` are kept, with NaN (or null) in every column
        except `flight`, `line` and `tt`. A missing value counts as a gap in its column. If a line
        lacks a column that other lines have, the column's values are missing on that whole line.
        Repeated or decreasing times are rejected.

        `input` can list several tables of sensors with different sample rates, as in `input =
        ["mag", "imu", "gps"]`. A line combines the rows of the same flight and line in all tables.
        The columns of all tables are resampled to the same times. `span` selects whether these
        times cover the time common to all tables, or the time of the first table. If several tables
        have a date, their times are converted to seconds past the same midnight. A column name that
        occurs in two tables is rejected, except `year` and `doy`, which are read from the first
        table that has them. A line whose tables have no common time is rejected.

        `lag_s` and `input_lag_s` remove the lag of a sensor. With a lag of 0.06 s, a reading
        stamped t was measured at t - 0.06 s. The resampled value at t is therefore the reading
        stamped t + 0.06 s. The `lag` stage estimates lags with this sign.

        Some entries of list columns are differences per sample, such as the eddy terms of `tl`.
        They are converted to the new rate. A list with values of earlier samples is rejected:
        compute it after resampling. The stage also rejects a second removal of the lag of a column.

        The stage does not filter: at a lower rate, frequencies above half the new rate are aliased.
        Apply `lowpass` or `bandpass` first.

        Parameters
        ----------
        input : TableLike | Sequence[TableLike]
            Input: one or several tables of flight lines.
        rate_hz : float
            New sample rate. Unit: Hz. Allowed: above 0.
        method : {"linear", "nearest", "cubic"}, optional
            Interpolation between samples; `cubic` is Akima's. Default: `"linear"`.
        max_gap_s : ListLike, optional
            Longest gap over which values are interpolated: one value for all inputs, or one value
            per input. Unit: s. Allowed: above 0. Default: `[1.0]`.
        span : {"all", "first"}, optional
            For several inputs: time that the line covers after resampling. `all` is the time common
            to all inputs, `first` the time of the first input. Default: `"all"`.
        lag_s : Mapping[str, Any], optional
            Lag of each column, by column name. The name of a vector magnetometer, such as `flux_a`,
            sets the lag of its `x`, `y`, `z` and `t`. `lag_s` overrides `input_lag_s`. Unit: s.
            Allowed: finite. Default: `{}`.
        input_lag_s : ListLike, optional
            Lag of each input's sensors, one value per input. Unit: s. Allowed: finite. Unset: 0 for
            all.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).
        """
        return self._stage("resample", locals())

    def core_field(
        self,
        *,
        input: TableLike,
        model: Literal["igrf", "wmm"] | Axis | None = None,
        column: str | Axis | None = None,
        position: Literal["truth", "ins"] | Axis | None = None,
        attitude: Literal["truth", "ins", "none"] | Axis | None = None,
        decimal_year: float | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Appends the core field at every sample: the magnitude `igrf` and the components `igrf_n`,
        `igrf_e`, `igrf_d` (north, east, down).

        If an attitude is available, the stage also appends `igrf_x`, `igrf_y`, `igrf_z` in the body
        frame (nose, right wing, down). `column` changes these names. An existing column of the same
        name is replaced.

        The date of each sample follows from `year`, `doy` and `tt` of the flight. `decimal_year`
        sets one date for all samples. Heights are above the WGS-84 ellipsoid. The result is NaN for
        a sample without a position. A body component is NaN if it depends on a missing angle.

        A flight without a date is rejected unless `decimal_year` is set. A date outside the model's
        range is rejected. An impossible position is rejected too: latitude beyond 90 degrees,
        longitude outside -180 to 360 degrees, height outside -10 to 2,000 km.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        model : {"igrf", "wmm"}, optional
            Model: `igrf` (IGRF-14, 1900 to 2030) or `wmm` (the World Magnetic Model, 2020 to 2030).
            Default: `"igrf"`.
        column : str, optional
            Name of the column for the magnitude. The components' names are this name plus a suffix.
            Default: `"igrf"`.
        position : {"truth", "ins"}, optional
            Position at which the field is computed: the true position (`lat`, `lon`, `alt`) or the
            INS position. Default: `"truth"`.
        attitude : {"truth", "ins", "none"}, optional
            Attitude that rotates the field into the body frame. With `none`, the body components
            are omitted. Unset: the attitude of the INS if present, otherwise the true attitude if
            present.
        decimal_year : float, optional
            Date of all samples, instead of the flight's date. Unit: a. Allowed: 1900 to 2030.
            Unset: the flight's own date.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        IGRF-14 (IAGA, doi:10.5281/zenodo.14012302); WMM2020 and WMM2025 (NOAA NCEI and BGS).
        """
        return self._stage("core_field", locals())

    def simulate_ins(
        self,
        *,
        input: TableLike,
        method: Literal["error_model", "mechanisation"] | Axis | None = None,
        smooth_s: float | Axis | None = None,
        seed: int | Axis | None = None,
        replace: bool | Axis | None = None,
        ins_grade: Literal["magnav", "navigation", "tactical", "commercial"] | Axis | None = None,
        init_position_sigma_m: float | Axis | None = None,
        init_altitude_sigma_m: float | Axis | None = None,
        init_velocity_sigma_mps: float | Axis | None = None,
        init_attitude_sigma_deg: float | Axis | None = None,
        init_heading_sigma_deg: float | Axis | None = None,
        vrw_sigma: float | Axis | None = None,
        arw_sigma: float | Axis | None = None,
        baro_sigma_m: float | Axis | None = None,
        ha_sigma_m: float | Axis | None = None,
        a_hat_sigma_mps2: float | Axis | None = None,
        acc_sigma_mps2: float | Axis | None = None,
        gyro_sigma_radps: float | Axis | None = None,
        baro_tau_s: float | Axis | None = None,
        acc_tau_s: float | Axis | None = None,
        gyro_tau_s: float | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Simulates an INS of a given grade: the GNSS track plus simulated errors.

        The simulated INS data are added to the flight, or replace its INS data. The stage appends
        `ins_lat`, `ins_lon`, `ins_alt`, `ins_vn`, `ins_ve`, `ins_vd`, `ins_fn`, `ins_fe`, `ins_fd`,
        `ins_roll`, `ins_pitch`, `ins_yaw`, `ins_aligned` and `ins_grade`. `navigate` reads these
        columns like measured columns.

        The true position is `lat`, `lon` and `alt`. The velocity is used if `vn`, `ve` and `vd`
        exist, and the attitude if `roll`, `pitch` and `yaw` exist. Missing velocities are derived
        from the positions, and specific forces from the velocities. If the attitude is missing, the
        aircraft is assumed to be level, with the yaw along the course. Derivatives amplify the
        noise of a GNSS receiver, and the specific force is a second derivative. Positions and
        velocities are therefore first smoothed over `smooth_s`. Apart from the effect of smoothing,
        the INS data then contain only INS errors and no receiver noise.

        Each line begins with a new alignment with random errors, whose standard deviations are the
        `init_*` keys. All simulated errors depend only on `seed` and the names of flight and line.
        Lines with the same seed and names have the same INS errors on every machine. Samples need
        not be evenly spaced. One seed gives one realisation; sweep `seed` for the statistics of a
        grade.

        The stage rejects a NaN in position, velocity or attitude, times that do not increase, a
        line of one sample, and an INS error above 1,000 km. Existing INS data are rejected unless
        `replace = true`.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        method : {"error_model", "mechanisation"}, optional
            Propagation of the errors: the linear error model of `navigate`, or a strapdown
            mechanisation of sensor readings with errors. The mechanisation is accurate for errors
            of any size. Default: `"error_model"`.
        smooth_s : float, optional
            Length of the window in which positions and velocities are smoothed by fitted parabolas.
            The weights fall to 0 at the ends of the window. 0 switches smoothing off. Unit: s.
            Allowed: 0 or above. Default: `5.0`.
        seed : int, optional
            Seed of all random draws. Default: `0`.
        replace : bool, optional
            Replaces existing INS data of the flight. Default: `false`.
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
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Gnadt 2022, (5.15) to (5.35); Titterton & Weston 2004, chapter 12; grades: Lee 2019, Tables
        9 and 10.
        """
        return self._stage("simulate_ins", locals())

    def bandpass(
        self,
        *,
        input: TableLike,
        columns: ListLike | Axis,
        low_hz: float | Axis | None = None,
        high_hz: float | Axis | None = None,
        order: int | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Removes frequencies outside the pass band, without lag, and appends `<column>_bp`.

        A Butterworth filter of second-order sections runs forwards and backwards over each line. It
        uses odd reflection at the ends and steady-state initial conditions. Each of the two passes
        halves the power at a corner frequency.

        A run is a stretch of samples without a missing value (NaN) or a gap in time. The filter
        restarts at each run. Missing values stay NaN and do not spread. A run that is not longer
        than the filter's padding becomes NaN. The padding is 6 samples per second-order section: 24
        samples for the default order. A line is rejected if all its runs are too short. Samples
        must be evenly spaced.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        columns : ListLike
            Columns to filter.
        low_hz : float, optional
            Lower corner frequency. 0 gives a low-pass filter. Unit: Hz. Allowed: 0 or above.
            Default: `0.1`.
        high_hz : float, optional
            Upper corner frequency. 0 gives a high-pass filter. Unit: Hz. Allowed: 0 or above.
            Default: `0.9`.
        order : int, optional
            Order of the Butterworth prototype. A band-pass filter has twice as many poles. Allowed:
            1 to 12. Default: `4`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        F. Gustafsson, Determining the initial states in forward-backward filtering, 1996. The
        defaults are taken from Gnadt 2022, section 3.1.2.
        """
        return self._stage("bandpass", locals())

    def lowpass(
        self,
        *,
        input: TableLike,
        columns: ListLike | Axis,
        corner_hz: float | Axis | None = None,
        for_rate_hz: float | Axis | None = None,
        order: int | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Removes frequencies above a corner frequency, without lag, and appends `<column>_lp`.

        The filter equals `bandpass` without a lower corner. With `for_rate_hz` instead of
        `corner_hz` it is an anti-alias filter for a later `resample` to that rate. It then has
        order 8 and a corner at 0.8 of the new Nyquist frequency. Its attenuation at the new Nyquist
        frequency is 31 dB.

        Angles (unit deg) are filtered along the shorter arc. A sloping signal is distorted within
        about 1/`corner_hz` seconds of the ends of a run. Gaps, short runs and uneven samples are
        treated as in `bandpass`.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        columns : ListLike
            Columns to filter.
        corner_hz : float, optional
            Corner frequency. The two passes together halve the amplitude at this frequency. Unit:
            Hz. Allowed: above 0. Unset: set by `for_rate_hz`.
        for_rate_hz : float, optional
            Lower sample rate to which the columns will be resampled. Unit: Hz. Allowed: above 0.
            Unset: set by `corner_hz`.
        order : int, optional
            Order of the Butterworth filter. Allowed: 1 to 12. Unset: 4, or 8 with `for_rate_hz`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        F. Gustafsson, Determining the initial states in forward-backward filtering, 1996.
        """
        return self._stage("lowpass", locals())

    def notch(
        self,
        *,
        input: TableLike,
        columns: ListLike | Axis,
        mains_hz: float | Axis,
        harmonics: int | Axis | None = None,
        width_hz: float | Axis | None = None,
        sampled_hz: float | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Removes a sinusoid and its harmonics, such as power-line interference, without lag, and
        appends `<column>_nt`.

        A harmonic above the Nyquist frequency is removed at its alias. For example, a harmonic of
        150 Hz that is sampled at 160 Hz is removed at 10 Hz. If the data were resampled without a
        filter, set `sampled_hz` to the sensor's own rate. The harmonic is then aliased twice: at
        the sensor's rate, and again at the rate of the line. Any signal within the notch width is
        also removed. The stage fails if an alias is less than half a notch width from 0 Hz or from
        the Nyquist frequency. Remove such a harmonic before resampling to a lower rate.

        A second-order notch at each frequency runs forwards and backwards. It settles in about
        1/`width_hz` seconds, so part of the sinusoid remains for this time at each end of a run.
        Angles are filtered along the shorter arc. Gaps, short runs and uneven samples are treated
        as in `bandpass`.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        columns : ListLike
            Columns to filter.
        mains_hz : float
            Frequency of the sinusoid: 50 or 60 Hz for most power lines, 16.7 Hz for some railways.
            Unit: Hz. Allowed: above 0.
        harmonics : int, optional
            Number of harmonics to remove, including the fundamental. Allowed: 1 to 50. Default:
            `3`.
        width_hz : float, optional
            Full width of each notch. At half the width from the notch frequency, half of the
            amplitude remains. Unit: Hz. Allowed: above 0. Default: `0.5`.
        sampled_hz : float, optional
            Original sample rate of the sensor. Unit: Hz. Allowed: above 0. Unset: the sample rate
            of the line.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        S. J. Orfanidis, Introduction to signal processing, 1995, section 11.3.
        """
        return self._stage("notch", locals())

    def derivative(
        self,
        *,
        input: TableLike,
        columns: ListLike | Axis,
        method: Literal["central", "savitzky_golay"] | Axis | None = None,
        window: int | Axis | None = None,
        degree: int | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Appends the rate of change per second of each column as `<column>_dot`.

        `central` is the central difference divided by the time between samples. At the ends of a
        run, the difference is one-sided. `savitzky_golay` is the slope of the least-squares
        polynomial over a window. It amplifies noise less than `central`. For white noise with a
        standard deviation of 1, the standard deviation of the slope is 0.32 per sample with the
        default window and degree. With `central` it is 0.71.

        Changes in angle (unit deg) are taken along the shorter arc. A missing value or a gap in
        time ends a run. A run that is too short for the method gives NaN. Samples must be evenly
        spaced. The unit is the column's unit per second.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        columns : ListLike
            Columns to differentiate.
        method : {"central", "savitzky_golay"}, optional
            Method of differentiation. Default: `"central"`.
        window : int, optional
            For `savitzky_golay`: odd number of samples in a window. Allowed: 3 to 10001. Unset: 5.
        degree : int, optional
            For `savitzky_golay`: degree of the polynomial. Allowed: 1 to 8. Unset: 2.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Savitzky & Golay 1964, Analytical Chemistry 36(8).
        """
        return self._stage("derivative", locals())

    def despike(
        self,
        *,
        input: TableLike,
        columns: ListLike | Axis,
        method: Literal["hampel", "fourth_difference"] | Axis | None = None,
        threshold: float | Axis | None = None,
        window: int | Axis | None = None,
        replace: Literal["nan", "linear"] | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Detects spikes in `columns` and appends two columns for each: `<column>_ds` without the
        spikes, and `<column>_spike`, which is 1 for a removed sample and 0 elsewhere.

        `hampel` removes a sample that differs from the median of `window` samples by more than
        `threshold` standard deviations of the noise. It detects several adjacent spikes, up to half
        of the window. It does not require evenly spaced samples. Use it before `resample`, which
        would spread a spike to neighbouring samples.

        `fourth_difference` removes a sample whose fourth difference, divided by the square root of
        70, exceeds `threshold` standard deviations of the noise. The divisor is the factor by which
        a fourth difference amplifies white noise. The method detects small spikes on steep signals,
        but not two adjacent spikes. It requires evenly spaced samples.

        The standard deviation of the noise is estimated as 1.4826 times the median absolute
        deviation, but at least one quantisation step. If more than half of the samples in a run
        hold repeated or interpolated values, the noise is estimated from the remaining samples.
        Steps and corners are then not flagged as spikes. Spikes in an otherwise constant run are
        kept.

        A spike becomes NaN, or is interpolated linearly in time between its neighbours. At the end
        of a run it always becomes NaN. A missing value or a gap in time ends a run. A column in
        which more than a tenth of the samples are spikes is rejected: the threshold is too low, or
        the signal is not smooth. Angles are not unwrapped.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        columns : ListLike
            Columns to despike.
        method : {"hampel", "fourth_difference"}, optional
            Method of detection. Default: `"hampel"`.
        threshold : float, optional
            Threshold, in standard deviations of the noise. Allowed: above 0. Default: `6.0`.
        window : int, optional
            For `hampel`: odd number of samples in a window. Allowed: 3 to 10001. Unset: 11.
        replace : {"nan", "linear"}, optional
            Replacement of a spike. Default: `"nan"`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Hampel 1974, J. Am. Stat. Assoc. 69; Pearson 2002, IEEE Trans. Control Systems Technology
        10(1).
        """
        return self._stage("despike", locals())

    def derive(
        self,
        *,
        input: TableLike,
        columns: Mapping[str, Any] | Axis,
        units: Mapping[str, Any] | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Appends columns defined by SQL expressions over the columns of the same row: differences,
        ratios, clips (`greatest(-5, least(5, x))`), choices (`case when radar < 50 then NULL else
        mag_4_uc end`).

        Expressions may use the DataFusion functions that depend only on the row. Clocks, random
        numbers and other rows are not available. A missing value (NaN) is NULL in an expression.
        Arithmetic with a missing value gives a missing value, and a comparison with a missing value
        is unknown. `coalesce` and `is null` detect missing values. An infinite result, such as 1/0,
        becomes a missing value. A line fails if SQL rejects a value, such as the square root of a
        negative number. Division gives a real number, even for two integers. `greatest` and `least`
        return a missing value if any argument is missing.

        The unit is inferred for sums, differences, clips, choices and multiples of columns of one
        unit, and for ratios of equal units. Otherwise set it in `units`. Sums and comparisons of
        columns with different units are rejected. An expression can use the columns of `input` but
        not the other new columns. An existing column of the same name is replaced. A column
        computed from a truth column has the role truth.

        For a column in nT, the metadata entry `removed` lists the corrections already applied to
        the columns of the expression. It also lists `igrf` or `diurnal` if the expression subtracts
        it. Later stages do not repeat these corrections.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        columns : Mapping[str, Any]
            SQL expression of each new column, by column name.
        units : Mapping[str, Any], optional
            Unit of each new column, by column name. Required if the unit cannot be inferred, or if
            a multiplication converts the unit, as in `alt * 3.28084` for metres to feet. Default:
            `{}`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).
        """
        return self._stage("derive", locals())

    def select(
        self,
        *,
        input: TableLike,
        rows: str | Axis | None = None,
        columns: ListLike | Axis | None = None,
        drop: ListLike | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Keeps the rows of each line for which `rows` is true.

        Keeps the columns listed in `columns`, or all columns except those listed in `drop`.

        `rows` is an SQL predicate over the columns of a row. A row is dropped if the predicate is
        unknown because a value is missing (NaN). A line fails if no row is kept. Rows dropped in
        the middle of a line leave a gap in time, at which filters restart.

        `where` selects lines. The columns `flight`, `line` and `tt` are always kept.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        rows : str, optional
            Predicate that selects the rows to keep, such as `radar > 100 and abs(roll) < 5`. Unset:
            all.
        columns : ListLike, optional
            Columns that are kept. Unset: all columns except those of `drop`.
        drop : ListLike, optional
            Columns that are dropped. Default: `[]`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).
        """
        return self._stage("select", locals())

    def join(
        self,
        *,
        input: TableLike,
        with_: TableLike,
        columns: ListLike | Axis | None = None,
        method: Literal["exact", "nearest", "linear"] | Axis | None = None,
        tolerance_s: float | Axis | None = None,
        suffix: str | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Appends columns of another table (`with`) to each line.

        Rows are matched by flight, line and time.

        `exact` uses the row at the same time, within one microsecond, and fails if there is none.
        Use it for tables with the same times, such as two tables computed from the same `resample`.
        `nearest` uses the nearest row within `tolerance_s`; of two equally near rows, the earlier
        one. `linear` interpolates between the rows before and after, if they are at most
        `tolerance_s` apart. It interpolates angles (unit deg) along the shorter arc. Text, integers
        and booleans take the nearest value, and whole numbers without a unit stay whole, as in
        `resample`. Without a matching row the value is missing (NaN or null). If both tables have a
        date, their times are converted to seconds past the same midnight.

        A line that is absent from `with` is omitted without a message, here and in later stages. A
        column that is also in `input` is rejected, unless `suffix` renames it. Repeated or
        decreasing times are rejected.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        with_ : TableLike
            Input: flight lines.
        columns : ListLike, optional
            Columns to append. Unset: all columns that are not in `input`.
        method : {"exact", "nearest", "linear"}, optional
            Method that matches rows. Default: `"exact"`.
        tolerance_s : float, optional
            Maximum time to the nearest row, or between the two rows of an interpolation. Unit: s.
            Allowed: above 0. Default: `1.0`.
        suffix : str, optional
            Suffix of the name of each appended column. Default: `""`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).
        """
        return self._stage("join", locals())

    def lag(
        self,
        *,
        input: TableLike,
        columns: ListLike | Axis,
        reference: str | Axis,
        most_s: float | Axis | None = None,
        either_sign: bool | Axis | None = None,
        low_hz: float | Axis | None = None,
        high_hz: float | Axis | None = None,
        order: int | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Estimates the lag of each of `columns` relative to `reference` on each line that `where`
        selects.

        The lag is at the peak of the cross-correlation. Each line and column gives a row with
        `lag_s`. The parameter `lag_s` of `resample` removes this lag.

        A lag of 0.06 s means column(t) = reference(t - 0.06 s), up to a factor and a constant. Both
        columns must measure the same quantity. Examples of such pairs are two magnetometers in a
        manoeuvre; a scalar magnetometer and the magnitude of a vector magnetometer; and the turn
        rate and the derivative of a heading. Slow variations flatten the correlation peak, so
        remove them with `low_hz` or with a `derivative` stage before this one. Samples must be
        evenly spaced. If the sensors have different rates, first resample them to the same times,
        at their highest rate or above.

        `sd_s` is the standard error of the lag if the difference between the two signals is white
        noise. For correlated noise, `sd_s` is too small. `correlation` is the correlation
        coefficient at the peak. `next_peak` is the height of the second highest peak divided by the
        height of the highest. If it is near 1, the lag is ambiguous, as for periodic signals. `n`
        is the number of sample pairs. The lag is NaN, and a warning is reported, if a line has no
        peak within `most_s`, a column is constant, or a line is too short. Missing samples are
        omitted.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        columns : ListLike
            Columns whose lags are estimated.
        reference : str
            Column relative to which the lags are measured.
        most_s : float, optional
            Largest lag of the search, in either direction. Unit: s. Allowed: above 0. Default:
            `2.0`.
        either_sign : bool, optional
            Also accepts a negative correlation, for columns with opposite signs. Default: `false`.
        low_hz : float, optional
            Lower corner frequency of a band-pass filter for both signals. With 0 the filter has no
            lower corner. Unit: Hz. Allowed: 0 or above. Default: `0.0`.
        high_hz : float, optional
            Upper corner frequency of the band-pass filter. With 0 the filter has no upper corner.
            Unit: Hz. Allowed: 0 or above. Default: `0.0`.
        order : int, optional
            Order of the Butterworth prototype of the band-pass filter. Allowed: 1 to 12. Default:
            `4`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Carter 1987, Coherence and time delay estimation, Proc. IEEE 75(2).
        """
        return self._stage("lag", locals())

    def diurnal(
        self,
        *,
        input: TableLike,
        record: TableLike | Sequence[TableLike],
        element: str | Axis | None = None,
        column: str | Axis | None = None,
        method: Literal["linear", "nearest", "cubic"] | Axis | None = None,
        max_gap_s: float | Axis | None = None,
        level: Literal["record", "line"] | Axis | None = None,
        level_nt: Mapping[str, Any] | Axis | None = None,
        power: float | Axis | None = None,
        position: Literal["truth", "ins"] | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Appends `diurnal`, the variation of the external field: the record of an observatory or
        base station at the time of each sample, minus the level of the record.

        An existing column of that name is replaced.

        A record is a table of flight lines, with each station stored as a flight and each day as a
        line. The table has the columns `year`, `doy` and `tt`, and the column that `element` names.
        IAGA-2002 and IMF files are read in this form; their total field is the column `field_f`. If
        a record has no scalar magnetometer, compute the magnitude of `field_n`, `field_e` and
        `field_d` with `derive`. Every line can use all days of a record, so a line may cross
        midnight.

        Values are interpolated between samples of the record. They are NaN outside the record and
        in gaps longer than `max_gap_s`. A line is rejected if it has no date, or if the record
        covers none of its samples. Several stations, in one or more tables, are averaged at each
        sample with weights 1/distance^`power`. The result is NaN for a sample at which any station
        has no value.

        The level of each record is subtracted, so that a station contributes only its variation.
        `level` selects the mean of the whole record, or its mean over the duration of the line.
        `level_nt` sets the level explicitly, for example to the level of a quiet night. A variation
        record (IAGA `Data Type variation`) has no absolute level.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        record : TableLike | Sequence[TableLike]
            Input: one or several tables of flight lines, read as a whole for each line.
        element : str, optional
            Column of the record from which the variation is computed. Unit: nT. Default:
            `"field_f"`.
        column : str, optional
            Name of the new column. Unit: nT. Default: `"diurnal"`.
        method : {"linear", "nearest", "cubic"}, optional
            Interpolation between samples of the record. Default: `"linear"`.
        max_gap_s : float, optional
            Longest gap in the record over which values are interpolated. Unit: s. Allowed: above 0.
            Default: `180.0`.
        level : {"record", "line"}, optional
            Level that is subtracted from each record. Default: `"record"`.
        level_nt : Mapping[str, Any], optional
            Level that is subtracted from the record of each station, by station name. Unit: nT.
            Allowed: finite. Unset: set by `level`.
        power : float, optional
            For several stations: power of the distance in the inverse-distance weights. Allowed: 0
            or above. Default: `1.0`.
        position : {"truth", "ins"}, optional
            For several stations: source of the position from which distances are measured. Default:
            `"truth"`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).
        """
        return self._stage("diurnal", locals())

    def segments(
        self,
        *,
        input: TableLike,
        heading: str | Axis | None = None,
        window_s: float | Axis | None = None,
        turn_dps: float | Axis | None = None,
        turn_deg: float | Axis | None = None,
        least_s: float | Axis | None = None,
        attitude: ListLike | Axis | None = None,
        manoeuvre: float | Axis | None = None,
        low_hz: float | Axis | None = None,
        high_hz: float | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Divides each line into straight parts, turns and manoeuvres.

        Appends `segment`, the number of the part from 1, and `segment_kind`: `straight`, `turn`,
        `manoeuvre`, or `none` if the heading is missing.

        In a turn the heading changes faster than `turn_dps` and by at least `turn_deg` in total, so
        the yaw manoeuvres of a calibration are not turns. A part shorter than `least_s` between two
        turns is counted as a turn. Manoeuvres are detected within straight parts. In a manoeuvre,
        the root mean square of the band-passed columns of `attitude` (angles, or components of a
        vector magnetometer) over `window_s` exceeds `manoeuvre`. Examples are the pitch, roll and
        yaw manoeuvres of a calibration box. Boundaries are accurate to within one window length.

        `select` with `rows = "segment_kind = 'straight'"` keeps the straight parts as one line.
        Samples must be evenly spaced. A gap in time or a missing heading ends a segment. A run
        shorter than the window has the kind `none`. The heading may be a course computed with
        `derive`: `degrees(atan2(ve, vn))`.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        heading : str, optional
            Heading or course. Unit: deg. Default: `"yaw"`.
        window_s : float, optional
            Window over which the turn rate is computed and manoeuvres are detected. Unit: s.
            Allowed: above 0. Default: `5.0`.
        turn_dps : float, optional
            Minimum turn rate of a turn. Unit: deg/s. Allowed: above 0. Default: `1.0`.
        turn_deg : float, optional
            Minimum change in heading in a turn. Unit: deg. Allowed: 0 or above. Default: `20.0`.
        least_s : float, optional
            Shortest straight part. Unit: s. Allowed: 0 or above. Default: `20.0`.
        attitude : ListLike, optional
            Columns that show manoeuvres, all in the same unit. Default: `[]`.
        manoeuvre : float, optional
            Threshold of a manoeuvre: square root of the sum of the columns' mean squares over
            `window_s`, in the unit of `attitude`. Allowed: above 0. Default: `2.0`.
        low_hz : float, optional
            Lower corner frequency of the band-pass filter for `attitude`. Unit: Hz. Allowed: 0 or
            above. Default: `0.05`.
        high_hz : float, optional
            Upper corner frequency of the band-pass filter. With 0 the filter has no upper corner.
            Unit: Hz. Allowed: 0 or above. Default: `0.0`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).
        """
        return self._stage("segments", locals())

    def magnitude(
        self,
        *,
        input: TableLike,
        vector: str | Axis,
        allow_truth: bool | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Appends the magnitude of a vector magnetometer, `flux_a_t` for `flux_a`.

        It can then be compensated like a scalar magnetometer.

        An existing column of that name is replaced. The result is NaN for a sample with a missing
        component.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        vector : str
            Vector magnetometer, such as `flux_a` for the columns `flux_a_x`, `flux_a_y` and
            `flux_a_z`.
        allow_truth : bool, optional
            Allows truth columns as inputs. Default: `false`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        van der Meer 2025, section 4.2.2 (its Tables 4.3 and 4.5).
        """
        return self._stage("magnitude", locals())

    def a_matrix(
        self,
        *,
        input: TableLike,
        vector: str | Axis,
        terms: ListLike | Axis | None = None,
        scalar: str | Axis | None = None,
        bt_scale_nt: float | Axis | None = None,
        allow_truth: bool | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Builds the Tolles-Lawson terms of a vector magnetometer and appends them as the list
        column `tl`.

        B is the reading of the vector magnetometer, and dB its central difference per sample. Bt is
        the magnitude of B, or the reading of `scalar` if set. s is `bt_scale_nt`. The terms are
        permanent (B_i/Bt), induced (B_i B_j/(Bt s)), eddy (B_i dB_j/(Bt s)), derivative (dB_i) and
        bias (1).

        The column's metadata list the terms (`terms`) and the terms that are differences
        (`per_sample`). They also hold the sample rate (`rate_hz`) if a `resample` stage set it.
        `fit` writes this rate to its table, and stages that apply a model convert its coefficients
        to the rate of their input.

        Differences are one-sided at the ends of a line and at gaps. They never cross a gap. A
        sample without a vector reading gives a row of NaN. Terms that are differences require
        evenly spaced samples; lines with uneven samples are rejected.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        vector : str
            Vector magnetometer, such as `flux_a` for the columns `flux_a_x`, `flux_a_y` and
            `flux_a_z`.
        terms : ListLike, optional
            Groups of terms: `permanent`, `induced`, `eddy`, `derivative`, `bias`. `induced5` and
            `eddy8` omit zz and zz_dot; `induced3` and `eddy3` contain only the diagonal terms.
            Default: `["permanent","induced","eddy"]`.
        scalar : str, optional
            Scalar magnetometer whose reading replaces Bt. This gives the modified Tolles-Lawson
            model. Unset: the magnitude of `vector`.
        bt_scale_nt : float, optional
            Scale s of the induced and eddy terms. A value near the total field gives all terms
            similar magnitudes. Unit: nT. Allowed: above 0. Default: `50000.0`.
        allow_truth : bool, optional
            Allows truth columns as inputs. Default: `false`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        W. E. Tolles and J. D. Lawson 1950; Gnadt 2022, (3.13) to (3.20) with the scale of its
        Tables 3.1 and 3.2.
        """
        return self._stage("a_matrix", locals())

    def features(
        self,
        *,
        input: TableLike,
        features: ListLike | Axis,
        terms: ListLike | Axis | None = None,
        bt_scale_nt: float | Axis | None = None,
        vector: str | Axis | None = None,
        mag: str | Axis | None = None,
        groups: ListLike | Axis | None = None,
        origin: ListLike | Axis | None = None,
        position: Literal["truth", "ins"] | Axis | None = None,
        allow_truth: bool | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Appends the list column `features`.

        Its entries are computed from other columns, as defined in the theses under 'Source'.

        | feature | definition |
        |---|---|
        | any column | the column itself |
        | `COLUMN_dot`, `COLUMN_dot4` | central and fourth difference of the column per sample |
        | `COLUMN_lag_N` | value of the column N samples earlier |
        | `mag_2_3_uc` | `mag_2_uc` minus `mag_3_uc`, for any two magnetometers |
        | `lpf_COLUMN` | the column after a low-pass filter at 0.2 Hz |
        | `dcm`, `dcm_1` to `dcm_9` | direction cosines of the rotation from north-east-down to body, column by column |
        | `crcy`, ... `srsp` | products of the cosines (c) and sines (s) of roll (r), pitch (p) and yaw (y) |
        | `TL_A_flux_a` | Tolles-Lawson terms of a vector magnetometer |
        | `ETL_COLUMN` | terms `COLUMN_1` to `COLUMN_7` of the extended Tolles-Lawson model, as set by `groups` |
        | `core_flux_a` | 21 terms of the core-field model; requires `igrf_x`, `igrf_y`, `igrf_z` of `core_field` |
        | `slope`, `slope_quadratic` | easting and northing (km); `slope_quadratic` adds their squares and product |

        The core-field model uses the computed core field instead of the measured field in its
        induced and eddy terms (van der Meer 2025). Three names denote sets of features:
        `down_selected` (Gnadt 2022, Table C.1), `small_1` and `small_2` (Gnadt 2022, section 4.9).
        The small sets use the magnetometer `mag` and the vector magnetometer `vector`.

        Differences and lags are per sample. The column's metadata list them (`per_sample`), and
        hold the sample rate (`rate_hz`) if a `resample` stage set it. A stage that applies a model
        at another rate converts the differences to that rate, and fails if the model has lags. A
        column of the table, such as one made by `derivative`, is used unchanged at any rate.

        Differences, lags and filters stay within a run of samples without gaps. A feature is NaN
        where it cannot be computed, and `fit` omits that row. Truth columns and features with
        missing inputs are rejected.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        features : ListLike
            Features, in the order of the list.
        terms : ListLike, optional
            Groups of Tolles-Lawson terms in the features `TL_A_...`. Unset: permanent, induced and
            eddy terms; for the sets `down_selected`, `small_1` and `small_2`: permanent, induced
            and derivative terms.
        bt_scale_nt : float, optional
            Scale of the induced, eddy and core-field terms. Unit: nT. Allowed: above 0. Default:
            `50000.0`.
        vector : str, optional
            Vector magnetometer of the small sets. The inputs of `ETL_...` are projected on the
            direction of the field that it measures. Unset: `ETL_...` and the small sets are
            rejected.
        mag : str, optional
            Scalar magnetometer of the small sets. Unit: nT. Unset: the small sets are rejected.
        groups : ListLike, optional
            Groups of the extended model: 1 for raw inputs, 2 for inputs projected on the direction
            of the field, 3 for projected rates of change. Default: `[1,2,3]`.
        origin : ListLike, optional
            Latitude and longitude, in degrees, of the origin of `slope`. Unit: deg. Unset: the
            line's first sample.
        position : {"truth", "ins"}, optional
            Position used by `slope`. Default: `"ins"`.
        allow_truth : bool, optional
            Allows truth columns as features. Default: `false`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Gnadt 2022, section 4.8 and appendix C; van der Meer 2025, sections 2.2.2 and 2.3; Lee 2019,
        appendix B. Names follow MagNav.jl.
        """
        return self._stage("features", locals())

    def target(
        self,
        *,
        input: TableLike,
        kind: Literal["a", "b", "c", "d", "e"] | Axis | None = None,
        mag: str | Axis | None = None,
        truth: str | Axis | None = None,
        remove_core: bool | Axis | None = None,
        remove_diurnal: bool | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Appends `target`, one of the five targets of Gnadt 2022 to which models are fitted.

        | type | target | a model fitted to it predicts |
        |---|---|---|
        | `a` | truth minus core field and diurnal variation | the anomaly |
        | `b` | value of the map | the anomaly |
        | `c` | magnetometer minus core field, diurnal variation and map | the aircraft field |
        | `d` | magnetometer minus truth | the aircraft field |
        | `e` | magnetometer minus core field and diurnal variation; `fit` band-passes it | the aircraft field |

        Set `target` of `fit` to this column. For all types except `e`, also switch the filter of
        `fit` off with `low_hz = 0` and `high_hz = 0`. To apply a model of the anomaly, set
        `predicts = "anomaly"` in `compensate`. Types `b` and `c` require `map_anomaly`, which
        `map_value` computes.

        The column has the role truth: it may be a target but not a feature. The result is NaN for a
        sample with a missing term. The metadata entry `removed` lists the corrections, so that no
        later stage repeats them.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        kind : {"a", "b", "c", "d", "e"}, optional
            Type of the target. Default: `"d"`.
        mag : str, optional
            Scalar magnetometer to be compensated, for `c`, `d` and `e`. Unit: nT. Unset: the
            targets `c`, `d` and `e` are rejected.
        truth : str, optional
            Column of the true field, for `a` and `d`. Unit: nT. Default: `"mag_1_c"`.
        remove_core : bool, optional
            Subtracts the core field `igrf` from targets `a`, `c` and `e`. Unset: true, unless the
            correction has already been applied.
        remove_diurnal : bool, optional
            Subtracts the diurnal variation `diurnal` from targets `a`, `c` and `e`. Unset: true,
            unless the correction has already been applied.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Gnadt 2022, section 3.7.
        """
        return self._stage("target", locals())

    def fit(
        self,
        *,
        input: TableLike,
        model: Literal["tolles_lawson", "extended_tolles_lawson", "ridge", "elastic_net", "pls",
            "truncated_svd", "robust", "recursive_least_squares", "m1", "m2a", "m2b", "m2c", "m2d",
            "m3tl", "m3s", "m3v", "m3sc", "m3vc", "m3w", "m3tf", "tlnn", "etlnn", "gru", "lstm",
            "tcn", "boosted_trees", "random_features"] | Axis,
        target: str | Axis,
        warm_start: TableLike | None = None,
        features: ListLike | Axis | None = None,
        entries: ListLike | Axis | None = None,
        choose: Literal["given", "gcv", "l_curve", "leave_one_line_out", "leave_one_flight_out"] |
            Axis | None = None,
        one_standard_error: bool | Axis | None = None,
        scaling: Literal["none", "standardise", "max_abs", "min_max"] | Axis | None = None,
        whiten: float | Axis | None = None,
        intercept: bool | Axis | None = None,
        low_hz: float | Axis | None = None,
        high_hz: float | Axis | None = None,
        order: int | Axis | None = None,
        trim: int | Axis | None = None,
        allow_truth: bool | Axis | None = None,
        lambda_: float | Axis | None = None,
        lambdas: ListLike | Axis | None = None,
        l1_ratio: float | Axis | None = None,
        components: int | Axis | None = None,
        with_targets: ListLike | Axis | None = None,
        loss: Literal["huber", "student_t"] | Axis | None = None,
        scale: Literal["mad", "joint"] | Axis | None = None,
        threshold: float | Axis | None = None,
        degrees_of_freedom: float | Axis | None = None,
        forgetting: float | Axis | None = None,
        hidden: ListLike | Axis | None = None,
        activation: Literal["swish", "relu", "tanh", "sigmoid"] | Axis | None = None,
        inputs: ListLike | Axis | None = None,
        epochs: int | Axis | None = None,
        lbfgs_epochs: int | Axis | None = None,
        batch: int | Axis | None = None,
        learning_rate: float | Axis | None = None,
        schedule: Literal["constant", "cosine", "plateau"] | Axis | None = None,
        training_loss: Literal["squared", "absolute", "huber"] | Axis | None = None,
        huber_threshold: float | Axis | None = None,
        weight_decay: float | Axis | None = None,
        dropout: float | Axis | None = None,
        group_lasso: float | Axis | None = None,
        group_share: float | Axis | None = None,
        validation: ListLike | Axis | None = None,
        patience: int | Axis | None = None,
        members: int | Axis | None = None,
        seed: int | Axis | None = None,
        physics: float | Axis | None = None,
        linear: ListLike | Axis | None = None,
        linear_low_hz: float | Axis | None = None,
        linear_high_hz: float | Axis | None = None,
        coupling: Literal["magnitude", "projection"] | Axis | None = None,
        bt_scale_nt: float | Axis | None = None,
        curriculum_sigma: float | Axis | None = None,
        window: int | Axis | None = None,
        units: int | Axis | None = None,
        heads: int | Axis | None = None,
        trees: int | Axis | None = None,
        shrinkage: float | Axis | None = None,
        leaves: int | Axis | None = None,
        depth: int | Axis | None = None,
        leaf_samples: int | Axis | None = None,
        leaf_l2: float | Axis | None = None,
        subsample: float | Axis | None = None,
        random_features: int | Axis | None = None,
        length_scale: float | Axis | None = None,
        linear_weight: float | Axis | None = None,
        noise_ratio: float | Axis | None = None,
        sigma: bool | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Fits a compensation model to all lines that `where` selects, as one data set.

        The same zero-phase filter band-passes terms and target (`low_hz = 0` and `high_hz = 0`
        switch it off). `trim` samples are removed at each end of every run of consecutive samples.
        The model is fitted to the remaining samples. Each model below has its own keys; a key of
        another model is rejected.

        `tolles_lawson` uses the feature `tl`, which `a_matrix` computes. The `features` stage
        computes all other features. The two-step model of van der Meer 2025 consists of two fits
        with a `compensate` stage between them. The target of the second fit is `mag_c`.

        `choose` selects `lambda` or the number of components. It uses generalised cross-validation,
        the corner of the L-curve, or cross-validation that omits one line or one flight at a time.
        If a whole line is omitted, the model was not fitted to neighbours of the predicted samples.
        If a whole flight is omitted, the model also cannot benefit from effects that last for a
        flight, such as a magnetisation or a temperature. The score of an omitted line is the
        variance (with divisor n) of the prediction error. The mean of the prediction error is
        ignored, because compensation does not determine constants. All lines have equal weight. The
        selected value is in the column `chosen`.

        All points of a sweep are solved together. Each line is reduced once to a triangular factor,
        which is used for all values of `lambda`, numbers of components and omitted lines. Normal
        equations are not used, because they square the condition number. Coefficients apply to the
        unscaled columns, even if `scaling` is set. The fitted constant is the term `intercept`.

        `std` is the standard deviation of a coefficient. It is computed from the spectra of the
        residual and of the terms, because the filter and coloured noise correlate the samples. It
        includes the effect of a residual that drifts over a run. The `std` of the intercept is an
        exception: it excludes this effect. `std` is null for models other than ridge models. It is
        also null for fits with 96 or more terms; a note reports this.

        `rate_hz` is the rate of the first line. On lines with other rates, terms that are
        differences per sample, such as `xx_dot`, are converted to this rate. All coefficients are
        therefore valid at this rate. Lagged values cannot be converted, so a line with another rate
        is rejected if a feature is a lagged value. Training that starts from `warm_start` keeps the
        rate of that table.

        A filter removes the mean of the target, so the constant part of the aircraft field is not
        determined.

        Rows with a NaN in a feature or the target, and rows that `where` omits, end a run. Each run
        is filtered separately. A run that is too short for filter and trim is omitted. `left_out`
        counts the omitted rows, `n` the used rows, and `lines` lists the lines of the used rows.

        `condition` is the condition number of the filtered matrix; if it is large, individual
        coefficients are poorly determined. With `lambda = 0`, the stage fails if the flight does
        not excite a term; the message names the term. `trivial_share` is the fraction of the total
        field that the fit attributes to the aircraft. A value of 1 means that a band-passed fit
        found the trivial solution: the whole total field is attributed to the aircraft. `warning`
        describes problems of the fit and is otherwise empty. Lines that failed in an earlier stage,
        or that lack a column, are omitted. Lines that are not evenly sampled, or whose rate is
        unsuitable for the filter, are omitted and listed in the table `failures`.

        `approximation_bound` is an upper bound on the error of the linear model, nT. The linear
        model approximates the change in the magnitude of the field by the projection of the
        aircraft field on the earth's field. Relative to the total field, the error is at most
        b^2/2, where b is the aircraft field divided by the earth's field. The bound is computed
        from the permanent and induced coefficients for the worst attitude. The bound is null if the
        terms do not determine it, or if the target is not a total field.

        `residual_sigma`, `residual_fogm_sigma` and `residual_fogm_tau` describe the noise of the
        unfiltered residual on the lines of the fit. They are the parameters of white noise and of
        first-order Gauss-Markov noise. Together, the two are the smallest noise whose Allan
        variance is nowhere below the Allan variance of the residual. If the target is a total
        field, `igrf` and `diurnal` are first subtracted from the residual if present. Without
        `igrf`, the core field is computed at the INS positions and the line's date. The crustal
        anomaly is unknown here and counts as noise. For a calibration at low height, the noise is
        therefore overestimated. A time constant longer than the lines cannot be resolved. The
        columns are null if the lines are shorter than 16 s.

        `warm_start` names the table of another fit of the same kind of network: a table of this
        pipeline, or a published table. Training starts from the weights in that table instead of
        random weights. The table may, for example, be from an aircraft with more flight data. Both
        fits must have the same inputs, layers, activation, linear terms and members. Inputs and
        target are scaled as in the earlier fit, because the weights depend on these scales. The
        constant is fitted to the new lines. Trained coefficients (`m2c`, `m3tl` to `m3tf`) start
        from the coefficients of the earlier fit. Coefficients that are not trained (`m2b`, `m2d`,
        `tlnn`, `etlnn`) are fitted to the new lines.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        model : {"tolles_lawson", "extended_tolles_lawson", "ridge", "elastic_net", "pls",
        "truncated_svd", "robust", "recursive_least_squares", "m1", "m2a", "m2b", "m2c", "m2d",
        "m3tl", "m3s", "m3v", "m3sc", "m3vc", "m3w", "m3tf", "tlnn", "etlnn", "gru", "lstm", "tcn",
        "boosted_trees", "random_features"}
            Compensation model.
        target : str
            Column to which the model is fitted, such as `mag_4_uc`, or `target`, which the `target`
            stage makes. Unit: nT.
        warm_start : TableLike, optional
            Input: model, optional.
        features : ListLike, optional
            Input columns of the model: lists such as `tl` and `features`, or single columns.
            Default: `["tl"]`.
        entries : ListLike, optional
            Entries of the lists in `features` to use, in this order. A name selects one entry. A
            prefix such as `TL_A_flux_a` selects all entries whose names begin with `TL_A_flux_a_`.
            A row is used only if all entries of the lists are finite, including the unselected
            entries. The matrix of all entries is factored only once, so a sweep over `entries` is
            fast. Unset: all entries.
        choose : {"given", "gcv", "l_curve", "leave_one_line_out", "leave_one_flight_out"}, optional
            Method that selects `lambda` or `components`. The permitted values depend on the model.
            Default: `"given"`.
        one_standard_error : bool, optional
            With cross-validation: selects the simplest model whose error is within one standard
            error of the smallest. Default: `false`.
        scaling : {"none", "standardise", "max_abs", "min_max"}, optional
            Scaling of the columns before the penalty is applied. `standardise` divides by the
            standard deviation with divisor n - 1, as in MagNav.jl. scikit-learn uses this divisor
            in partial least squares and whitened components. Its `StandardScaler` uses the divisor
            n. Ridge regression in scikit-learn then requires the penalty `lambda` n / (n - 1) for
            the same solution. Unset: the default of the model.
        whiten : float, optional
            Fits the model to whitened principal components of the features, instead of the features
            themselves. A value of 1 or more is the number of components. A value below 1 is the
            fraction of the variance that the components explain. The table still holds coefficients
            of the features. Allowed: above 0. Unset: no whitening.
        intercept : bool, optional
            Also fits a constant, without a penalty. Unset: true with `whiten`, otherwise the
            default of the model.
        low_hz : float, optional
            Lower corner frequency of the filter. With 0 the filter has no lower corner. Unit: Hz.
            Allowed: 0 or above. Default: `0.1`.
        high_hz : float, optional
            Upper corner frequency of the filter. With 0 the filter has no upper corner. Unit: Hz.
            Allowed: 0 or above. Default: `0.9`.
        order : int, optional
            Order of the Butterworth prototype. Allowed: 1 to 12. Default: `4`.
        trim : int, optional
            Number of samples removed at each end of a run after filtering. Unit: samples. Default:
            `20`.
        allow_truth : bool, optional
            Allows truth columns as features. Default: `false`.
        lambda_ : float, optional
            For `tolles_lawson`, `extended_tolles_lawson`, `ridge`, `elastic_net`, `robust`: Ridge
            parameter. Allowed: 0 or above. Default: `0.025`.
            For `recursive_least_squares`: Ridge parameter of the initial coefficients. Allowed: 0
            or above. Default: `0.025`.
            For `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`, `m3tf`,
            `tlnn`, `etlnn`: Ridge parameter of the linear model. Allowed: 0 or above. Default:
            `0.025`.
        lambdas : ListLike, optional
            For `tolles_lawson`, `extended_tolles_lawson`, `ridge`, `elastic_net`: Values of
            `lambda` to choose from. Unset: a grid computed from the features.
        l1_ratio : float, optional
            For `elastic_net`: Fraction of the penalty that applies to the absolute values of the
            coefficients. Allowed: 0 to 1. Default: `0.99`.
        components : int, optional
            For `pls`: Number of components. If `choose` selects the number, this is the maximum. If
            the number of components equals the number of terms, the result is ordinary least
            squares, and a warning is reported. Allowed: 1 to 10000. Default: `18`.
            For `truncated_svd`: Number of components. If `choose` selects the number, this is the
            maximum. Allowed: 1 to 10000. Default: `18`.
        with_targets : ListLike, optional
            For `pls`: Further target columns that are fitted with the same components as `target`.
            The table holds only the coefficients of `target`. Unit: nT. Default: `[]`.
        loss : {"huber", "student_t"}, optional
            For `robust`: Loss function of a residual. Default: `"huber"`.
        scale : {"mad", "joint"}, optional
            For `robust`: Estimator of the scale of the residuals: their median absolute deviation
            (`mad`), or an estimate together with the coefficients (`joint`). Default: `"mad"`.
        threshold : float, optional
            For `robust`: Residual at which Huber's loss changes from quadratic to linear, in units
            of the scale. Allowed: above 0. Default: `1.345`.
        degrees_of_freedom : float, optional
            For `robust`: Degrees of freedom of Student's t. Allowed: above 0. Default: `4.0`.
        forgetting : float, optional
            For `recursive_least_squares`: Forgetting factor: weight of a row relative to the next
            row. With 1 nothing is forgotten. Allowed: 0.9 to 1. Default: `1.0`.
        hidden : ListLike, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Number of units in each hidden layer; at
            most three layers. Allowed: 1 to 1000. Unset: `[8]`; for `tlnn` and `etlnn`, `[11]` as
            in van der Meer 2025; for `m3tf`, no hidden layers; with `warm_start`, the layers of the
            earlier network.
        activation : {"swish", "relu", "tanh", "sigmoid"}, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Activation function of the hidden units.
            Default: `"swish"`.
        inputs : ListLike, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Entries of `features` that are inputs of
            the network. A name selects one entry; a prefix such as `TL_A_flux_a` selects all
            entries whose names begin with `TL_A_flux_a_`. Unset: all features.
            For `boosted_trees`: Entries of `features` that are inputs of the trees. A name selects
            one entry; a prefix such as `TL_A_flux_a` selects all entries whose names begin with
            `TL_A_flux_a_`. Unset: all features.
            For `random_features`: Entries of `features` that are inputs of the model. A name
            selects one entry; a prefix such as `TL_A_flux_a` selects all entries whose names begin
            with `TL_A_flux_a_`. Unset: all features.
        epochs : int, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Number of training epochs with Adam.
            Allowed: 0 to 100000. Default: `200`.
        lbfgs_epochs : int, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Number of L-BFGS iterations after
            training with Adam. Each iteration uses all samples. Allowed: 0 to 10000. Default: `0`.
        batch : int, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Number of samples in each step of Adam.
            Unit: samples. Allowed: 1 to 10000000. Default: `2048`.
        learning_rate : float, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Learning rate of Adam. Allowed: above 0.
            Default: `0.001`.
        schedule : {"constant", "cosine", "plateau"}, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Learning-rate schedule. With `cosine`,
            the rate falls to 1 % of `learning_rate`. With `plateau`, the rate is halved after ten
            epochs without a smaller validation loss. Default: `"constant"`.
        training_loss : {"squared", "absolute", "huber"}, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Loss function: mean squared residual,
            mean absolute residual, or Huber loss. Default: `"squared"`.
        huber_threshold : float, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Residual at which the Huber loss changes
            from quadratic to linear, divided by the scale of the target (the term `target_scale` in
            the table of the fit). Allowed: above 0. Default: `1.0`.
        weight_decay : float, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Weight decay, as in AdamW: each step of
            Adam multiplies the weights by (1 - `weight_decay` × learning rate). Allowed: 0 or
            above. Default: `0.0`.
        dropout : float, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Fraction of the hidden units that each
            training step omits at random. Allowed: 0 to 0.9. Default: `0.0`.
        group_lasso : float, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Strength of the sparse group lasso, a
            penalty that reduces the weights of irrelevant inputs in the first layer. Allowed: 0 or
            above. Default: `0.0`.
        group_share : float, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Fraction of `group_lasso` that penalises
            the weights of each input as a group. The remaining fraction penalises each weight
            separately. Allowed: 0 to 1. Default: `1.0`.
        validation : ListLike, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Lines or flights that are used for
            validation instead of training. A line is given as `1003.08`, or with its flight as
            `1003/1003.08`. The result has the weights of the epoch with the smallest validation
            loss. Default: `[]`.
            For `boosted_trees`: Lines or flights that are used for validation instead of training.
            A line is given as `1003.08`, or with its flight as `1003/1003.08`. The result has the
            number of trees with the smallest validation loss. Default: `[]`.
        patience : int, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Training stops after this number of
            consecutive epochs without a smaller validation loss. Allowed: above 0. Unset: training
            runs for all epochs.
            For `boosted_trees`: Training stops after this number of consecutive trees without a
            smaller validation loss. Allowed: above 0. Unset: training builds all trees.
        members : int, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Number of networks in the ensemble. The
            networks start from different weights, and their predictions are averaged. The spread of
            the predictions gives `mag_aircraft_sigma` of `compensate`. Allowed: 1 to 100. Default:
            `1`.
        seed : int, optional
            For `m1`, `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`,
            `m3tf`, `tlnn`, `etlnn`, `gru`, `lstm`, `tcn`: Seed for the initial weights, the order
            of the batches, and dropout. Default: `0`.
            For `boosted_trees`: Seed for the subsample of each tree. Default: `0`.
            For `random_features`: Seed of the random features. Default: `0`.
        physics : float, optional
            For `m2a`, `m2c`, `m2d`: Weight of an additional term of the loss function: the squared
            difference between the prediction and the ridge fit of the linear terms. This difference
            is divided by the scale of the target. Allowed: 0 or above. Default: `0.0`.
        linear : ListLike, optional
            For `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`, `m3tf`,
            `tlnn`, `etlnn`: Entries of `features` that are terms of the linear model. A name
            selects one entry; a prefix such as `TL_A_flux_a` selects all entries whose names begin
            with `TL_A_flux_a_`. Other features can only be inputs of the network. Unset: for
            `etlnn`, all features; for other models, the Tolles-Lawson terms in `features` or, if
            there are none, the terms of the core-field model.
        linear_low_hz : float, optional
            For `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`, `m3tf`,
            `tlnn`, `etlnn`: Lower corner frequency of the filter for the ridge fit. With 0 the
            filter has no lower corner. Unit: Hz. Allowed: 0 or above. Default: `0.1`.
        linear_high_hz : float, optional
            For `m2a`, `m2b`, `m2c`, `m2d`, `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`, `m3tf`,
            `tlnn`, `etlnn`: Upper corner frequency of the filter for the ridge fit. With 0 the
            filter has no upper corner. Unit: Hz. Allowed: 0 or above. Default: `0.9`.
        coupling : {"magnitude", "projection"}, optional
            For `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`, `m3tf`: Function f(v) that computes the
            scalar aircraft field from its vector v; see the table of `m3tl`. Default:
            `"magnitude"`.
        bt_scale_nt : float, optional
            For `m3tl`, `m3s`, `m3v`, `m3sc`, `m3vc`, `m3w`, `m3tf`: For `coupling = "magnitude"`:
            scale of the Tolles-Lawson terms, equal to `bt_scale_nt` of the stage that computes
            them. Unit: nT. Allowed: above 0. Default: `50000.0`.
        curriculum_sigma : float, optional
            For `m3sc`, `m3vc`: Limit for the samples of the first three phases: maximum deviation
            of the ridge fit's error from the mean error, in standard deviations of the error.
            Allowed: above 0. Default: `1.0`.
        window : int, optional
            For `m3w`, `m3tf`: Number of samples in the window. Unit: samples. Allowed: 2 to 4096.
            Default: `5`.
            For `gru`, `lstm`, `tcn`: Number of samples in a window; for `tcn`, a power of two. The
            window ends at the predicted sample, so future samples are not used. Unit: samples.
            Allowed: 2 to 4096. Default: `16`.
        units : int, optional
            For `m3tf`: Number of units that represent a sample in the transformer. Allowed: 1 to
            1000. Default: `8`.
            For `gru`, `lstm`, `tcn`: Number of features computed from the window. Allowed: 1 to
            1000. Default: `8`.
        heads : int, optional
            For `m3tf`: Number of attention heads, a divisor of `units`. Allowed: 1 to 1000.
            Default: `8`.
        trees : int, optional
            For `boosted_trees`: Maximum number of trees. Allowed: 1 to 100000. Default: `200`.
        shrinkage : float, optional
            For `boosted_trees`: Factor applied to each tree, also called the learning rate. Halving
            it requires twice as many trees. Allowed: 0.000001 to 1. Default: `0.1`.
        leaves : int, optional
            For `boosted_trees`: Maximum number of leaves per tree. Allowed: 2 to 65536. Default:
            `31`.
        depth : int, optional
            For `boosted_trees`: Maximum number of splits above a leaf. Allowed: above 0. Unset:
            limited by `leaves` only.
        leaf_samples : int, optional
            For `boosted_trees`: Minimum number of samples per leaf. Unit: samples. Allowed: above
            0. Default: `20`.
        leaf_l2 : float, optional
            For `boosted_trees`: L2 penalty on the values of the leaves. The value of a leaf is the
            sum of its residuals divided by (number of samples + `leaf_l2`). The values of leaves
            with few samples are therefore reduced. Unit: samples. Allowed: 0 or above. Default:
            `0.0`.
        subsample : float, optional
            For `boosted_trees`: Fraction of the samples used for each tree. Allowed: 0.001 to 1.
            Default: `1.0`.
        random_features : int, optional
            For `random_features`: Number of random features. More features approximate the Gaussian
            process better. Computing time is proportional to the square of this number. Allowed: 2
            to 10000. Default: `200`.
        length_scale : float, optional
            For `random_features`: Length scale of the kernel: the distance over which values are
            correlated, in standard deviations of the inputs. Allowed: above 0. Unset: the most
            likely of 1/4, 1/2, 1, 2 and 4 times the median distance between samples.
        linear_weight : float, optional
            For `random_features`: Weight of the linear model: prior standard deviation of its
            coefficients for standardised inputs, divided by the standard deviation of the process.
            0 removes the linear model. Allowed: 0 or above. Default: `1.0`.
        noise_ratio : float, optional
            For `random_features`: Variance of the errors divided by the variance of the process.
            Allowed: above 0. Unset: the most likely value.
        sigma : bool, optional
            For `random_features`: Stores the matrix factor that `compensate` requires for the
            standard deviation of the prediction. For n random features, the factor adds n² rows to
            the table of the fit. Default: `true`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Gnadt 2022, (3.19) to (3.43), Figure 5-6 for `warm_start`; van der Meer 2025, sections 2.2
        to 2.4, 4.1 and 4.2.1.
        """
        return self._stage("fit", locals())

    def compensate(
        self,
        *,
        input: TableLike,
        model: TableLike,
        mag: str | Axis,
        predicts: Literal["aircraft", "anomaly", "field"] | Axis | None = None,
        without: ListLike | Axis | None = None,
        detrend: bool | Axis | None = None,
        parts: bool | Axis | None = None,
        allow_truth: bool | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Subtracts from a scalar magnetometer the aircraft field that a fitted model predicts.

        Appends the compensated field `mag_c` and the predicted aircraft field `mag_aircraft`. Their
        sum is the reading of the magnetometer. Both are NaN if the sample lacks a term of the
        model.

        Terms that are differences per sample are converted to the sample rate of the fit, so a line
        with another sample rate is accepted. A central difference underestimates the rate of change
        at frequency f by the fraction (2 pi f / rate)^2 / 6. For f = 0.2 Hz, this fraction is 0.3 %
        at a rate of 10 Hz and 1 % at 5 Hz. A model without a stored rate, or with a lagged feature,
        is rejected if the rates may differ.

        The metadata of `mag_c` list the corrections already applied to `mag`, such as the removal
        of the diurnal variation.

        A model fitted to band-passed data does not determine the constant part of the aircraft
        field. With `detrend`, as in MagNav.jl's examples, the prediction is subtracted without its
        mean over the line. A nonlinear model predicts the constant part if its target includes that
        part.

        `mag_sigma`, `mag_fogm_sigma` and `mag_fogm_tau` describe the noise of `mag_c`, estimated
        from the residual of the model on its calibration lines. Their values are the same for all
        samples. `navigate` uses them for noise parameters that are set to `"auto"`.

        `mag_aircraft_sigma` is the standard deviation of the prediction. Ensembles of networks and
        `random_features` provide it; for other models it is null.

        `parts` appends the parts of the prediction in nT, before `detrend` and before `igrf` and
        `diurnal` are added. `part_linear` is the prediction of the linear terms alone. It is the
        whole prediction of a linear model, and 0 for `m1`, `m2a`, trees and random features.
        `part_network` is the remaining prediction, from the network and constants. For the models
        `m3tl` to `m3tf`, `part_permanent_x` to `part_eddy_z` are the permanent, induced and
        eddy-current vectors along the axes of the vector magnetometer. `part_network_x` to
        `part_network_z` are the components of the vector that the network predicts. They are 0
        except for `m3v` and `m3vc`. For other models, all vectors are null.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        model : TableLike
            Input: model.
        mag : str
            Scalar magnetometer, such as `mag_4_uc`. Unit: nT.
        predicts : {"aircraft", "anomaly", "field"}, optional
            Quantity that the model was fitted to predict. `aircraft` is the aircraft field.
            `anomaly` is the anomaly, to which `igrf` and `diurnal` are added (targets `a` and `b`).
            `field` is the total field. Default: `"aircraft"`.
        without : ListLike, optional
            Terms of the model that are not part of the aircraft field and are not subtracted, such
            as `easting` and `northing`. Default: `[]`.
        detrend : bool, optional
            Subtracts the predicted aircraft field without its mean over the line. Default: `false`.
        parts : bool, optional
            Appends the parts of the prediction. Default: `false`.
        allow_truth : bool, optional
            Allows truth columns as inputs. Default: `false`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Gnadt 2022, (3.22).
        """
        return self._stage("compensate", locals())

    def importance(
        self,
        *,
        input: TableLike,
        model: TableLike,
        target: str | Axis,
        method: Literal["permutation", "shapley", "expected_gradients", "pearson", "spearman",
            "hard_thresholding", "group_lasso", "morris", "sobol_first", "sobol_total"] | Axis |
            None = None,
        groups: ListLike | Axis | None = None,
        block_s: float | Axis | None = None,
        repeats: int | Axis | None = None,
        samples: int | Axis | None = None,
        background: int | Axis | None = None,
        draws: int | Axis | None = None,
        kept_samples: int | Axis | None = None,
        terms: int | Axis | None = None,
        trajectories: int | Axis | None = None,
        levels: int | Axis | None = None,
        points: int | Axis | None = None,
        tails: float | Axis | None = None,
        seed: int | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Computes the importance of each input of a fitted model on each line.

        Each group of inputs gives one row with `value`. If `value` is a mean, `spread` is the
        standard deviation of the averaged values. `permutation`, `shapley`, `morris` and the Sobol
        indices use predictions only, so they apply to all kinds of models.

        Each entry of the model's features is a separate group, unless `groups` combines it with
        others. Correlated inputs share or mask importance, so put all inputs from one sensor into
        one group.

        | `method` | `value` | `value` is a mean over |
        |---|---|---|
        | `permutation` | increase in the mean square error of the predicted `target`, in nT2 | the repeats |
        | `shapley` | mean absolute contribution to the prediction, in nT | the samples |
        | `expected_gradients` | mean absolute contribution, computed from gradients, in nT | the samples |
        | `pearson`, `spearman` | correlation with `target` | |
        | `hard_thresholding` | coefficient of the standardised entry, in nT; 0 if the entry is not selected | |
        | `group_lasso` | norm of an input's weights times the input's standard deviation on the line | the ensemble |
        | `morris` | mean absolute change in the prediction over the input's range, in nT | the trajectories |
        | `sobol_first` | share of the prediction's variance from the group alone | |
        | `sobol_total` | share of the prediction's variance from the group and all its interactions | |

        `permutation` permutes blocks of length `block_s`, because permuting single samples would
        turn a slow signal into noise. A constant error of the model has no effect. `shapley` and
        `expected_gradients` explain `samples` samples of the line relative to `background` samples
        of the line, both evenly spaced. Shapley values of linear models and of trees are exact. For
        other models, Shapley values are estimated by sampling, and `error` is the mean standard
        error of the estimates. Samples that `where` omits, or that lack an input or the target, are
        ignored. A line that is too short for the method is rejected.

        For `shapley` and `expected_gradients`, up to `kept_samples` samples are stored. The list
        `sample_values` holds the contribution of the group to the prediction for each of these
        samples, and `sample_inputs` holds the value of the input. `sample_inputs` is NaN for a
        group of several inputs. The report plots both lists for all lines together, like the
        beeswarm plot of the SHAP package.

        `morris` and the Sobol indices vary all inputs independently over their ranges. The range of
        an input is from the quantile `tails` to the quantile 1 - `tails` of its values on the line.
        Correlated inputs then take combinations that do not occur in the data. The values therefore
        describe the model over the ranges, not its behaviour on the line. The shares of correlated
        inputs do not add up to the variance of the prediction on the line. An input that is
        constant on the line has an importance of 0. `error` is the standard error; `low` and `high`
        are the bounds of a Sobol index's 95 % bootstrap interval. A first-order index below the
        total index of the same group indicates interactions. With `morris`, a group of several
        inputs has no `spread`.

        To compute the increase in error when an input is dropped and the model is refitted, use a
        sweep. Its axis holds all subsets of `entries` or `inputs` of the fit that lack at most one
        input: `{ subsets_of = [...], at_least = n - 1 }`. A sweep over `seed` of the fit gives the
        spread over seeds.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        model : TableLike
            Input: model.
        target : str
            Target of the fitted model, such as `mag_4_uc`. Unit: nT.
        method : {"permutation", "shapley", "expected_gradients", "pearson", "spearman",
        "hard_thresholding", "group_lasso", "morris", "sobol_first", "sobol_total"}, optional
            Method that computes the importance. Default: `"permutation"`.
        groups : ListLike, optional
            Groups of entries, each given by a name or a prefix. A prefix is the part of a name
            before a `_`, such as `TL_A_flux_a`. It selects all names that begin with this part.
            Default: `[]`.
        block_s : float, optional
            Length of the permuted blocks. The length must exceed the correlation times of the
            target and the inputs. Unit: s. Allowed: above 0. Default: `30.0`.
        repeats : int, optional
            Number of repeats of the permutation. Allowed: 1 to 10000. Default: `10`.
        samples : int, optional
            Number of samples of each line for which contributions are computed. Unit: samples.
            Allowed: 2 to 1000000. Default: `200`.
        background : int, optional
            Number of background samples of each line, relative to which contributions are computed.
            Unit: samples. Allowed: 1 to 100000. Default: `50`.
        draws : int, optional
            Number of random orders in which the groups change from the values of a background
            sample to the values of a sample, for each pair of the two. Each order is also used in
            reverse. With `expected_gradients`: number of gradients per sample, divided by the
            number of background samples. Allowed: 2 to 100000. Default: `2`.
        kept_samples : int, optional
            Number of explained samples whose values are stored, evenly spaced. 0 stores none. Unit:
            samples. Allowed: 0 to 10000. Default: `100`.
        terms : int, optional
            Number of entries in the linear model of `hard_thresholding`. Allowed: 1 to 10000.
            Default: `10`.
        trajectories : int, optional
            Number of trajectories of `morris`. Each trajectory requires (number of groups + 1)
            predictions. Allowed: 2 to 1000000. Default: `200`.
        levels : int, optional
            Number of levels of each input in `morris`, an even number. Allowed: 2 to 1000. Default:
            `4`.
        points : int, optional
            Number of rows in each of the two random matrices for a Sobol index. The model predicts
            (number of groups + 2) times this number of rows. Errors are proportional to the inverse
            square root of `points`. Allowed: 2 to 1000000. Default: `2000`.
        tails : float, optional
            Fraction of an input's values on the line that lie outside its range at each end. 0 uses
            the extremes. Allowed: 0 to 0.49. Default: `0.01`.
        seed : int, optional
            Seed of the random draws. Default: `0`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Breiman 2001; Lundberg & Lee 2017; Lundberg et al. 2020; Erion et al. 2021; Blumensath &
        Davies 2010; Morris 1991; Campolongo, Cariboni & Saltelli 2007; Sobol 2001; Jansen 1999;
        Saltelli et al. 2010; Gnadt 2022, section 4.8 and (4.10).
        """
        return self._stage("importance", locals())

    def residual_noise(
        self,
        *,
        input: TableLike,
        mag: str | Axis | None = None,
        truth: str | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Estimates the noise of a compensated signal on the lines that `where` selects.

        The true field comes from another magnetometer (`truth`) or, if that is unset, from a map,
        the core field and the diurnal variation.

        `fit` estimates the noise from the residual on its calibration lines. This noise therefore
        includes the anomaly and the effect of manoeuvres. `residual_noise` is more realistic: it
        uses lines flown over a map as in navigation, and includes the error of the map.
        `assume_noise` assigns the result to other lines, and `navigate` uses it for noise
        parameters that are `"auto"`. Do not select the lines that are navigated: their scores would
        be in sample.

        The noise has a white part and a first-order Gauss-Markov part. They are the smallest parts
        whose combined Allan variance is nowhere below the Allan variance of the lines. A constant
        error has no effect. A time constant longer than the lines cannot be resolved. Lines without
        16 s of uninterrupted data are rejected.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        mag : str, optional
            Compensated signal. Unit: nT. Default: `"mag_c"`.
        truth : str, optional
            Column of the true field, such as `mag_1_c`. Unit: nT. Unset: the sum of `igrf`,
            `map_anomaly` (computed by `map_value`) and, if present, `diurnal`, without the fields
            already removed from `mag`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Allan 1966; IEEE Std 952-1997, annex C; Brown & Hwang 2012, section 3.8.
        """
        return self._stage("residual_noise", locals())

    def assume_noise(
        self,
        *,
        input: TableLike,
        noise: TableLike,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Appends the noise parameters that `residual_noise`, `fogm_noise` or `fit` estimated:
        `mag_sigma`, `mag_fogm_sigma` and `mag_fogm_tau`, each with the same value at all samples.

        They replace the columns of the same names from `compensate`.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        noise : TableLike
            Input: model.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).
        """
        return self._stage("assume_noise", locals())

    def fogm_noise(
        self,
        *,
        input: TableLike,
        column: str | Axis | None = None,
        truth: str | Axis | None = None,
        method: Literal["autocorrelation", "allan"] | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Fits white noise and first-order Gauss-Markov noise to a residual, on the lines that
        `where` selects.

        The standard deviation and the time constant of the Gauss-Markov noise can be used as
        `fogm_sigma_nt` and `fogm_tau_s` of `navigate`. The white noise can be used as
        `measurement_sigma_nt`. `assume_noise` reads the table.

        The residual is `column`, minus `truth` if that is set. Examples are a compensated signal
        minus the true signal, the variation at a base station, and the `residual` of a track
        without measurement updates. `residual_noise` gives the smallest noise that bounds a signal
        over every time span, for a cautious filter. `fogm_noise` gives the best fit for noise with
        one time scale. Noise with several time scales is represented only in part.

        A run is a stretch of samples without a gap. `autocorrelation` fits the variance minus the
        autocovariance at lags from one sample to a quarter of the longest run. `allan` fits the
        Allan variance. A constant affects neither statistic. If the Gauss-Markov noise is not
        significant, its standard deviation is 0 and the time constant is the sample interval. The
        white noise is at least 0.01 nT.

        These are rejected: records without a run of 64 samples, constant records, and lines with
        different sample rates. A record must also last at least 20 time constants in total, and at
        least 8 in its longest run. A shorter record does not determine the time constant.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        column : str, optional
            Column of the residual, or of the signal from which `truth` is subtracted. Unit: nT.
            Default: `"residual"`.
        truth : str, optional
            Column that is subtracted from `column`, such as `mag_1_c`. Unit: nT. Unset: nothing is
            subtracted.
        method : {"autocorrelation", "allan"}, optional
            Statistic that is fitted. Default: `"autocorrelation"`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Cressie 1993, section 2.6; IEEE Std 952-1997, annex C; Brown & Hwang 2012, section 3.8.
        """
        return self._stage("fogm_noise", locals())

    def noise_network(
        self,
        *,
        input: TableLike,
        map: TableLike,
        network_noise: Literal["r", "q", "both"] | Axis | None = None,
        loss: Literal["likelihood", "position"] | Axis | None = None,
        features: ListLike | Axis | None = None,
        hidden: int | Axis | None = None,
        limit: float | Axis | None = None,
        epochs: int | Axis | None = None,
        window_s: float | Axis | None = None,
        learning_rate: float | Axis | None = None,
        seed: int | Axis | None = None,
        tuning: Literal["auto", "magnav"] | Axis | None = None,
        mag: ListLike | Axis | None = None,
        core_field: bool | Axis | None = None,
        remove_diurnal: bool | Axis | None = None,
        decimal_year: float | Axis | None = None,
        map_interpolation: Literal["linear", "quadratic", "cubic"] | Axis | None = None,
        map_levels_m: ListLike | Axis | None = None,
        map_error_length_m: float | Axis | None = None,
        offset_window_s: float | Axis | None = None,
        measurement_sigma_nt: float | Literal["auto"] | Axis | None = None,
        fogm_sigma_nt: float | Literal["auto"] | Axis | None = None,
        fogm_tau_s: float | Literal["auto"] | Axis | None = None,
        noise_column: str | Axis | None = None,
        start: Literal["auto", "fix", "alignment", "given"] | Axis | None = None,
        fix: ListLike | Axis | None = None,
        fix_velocity: ListLike | Axis | None = None,
        fix_sigma_m: float | Axis | None = None,
        fix_alt_sigma_m: float | Axis | None = None,
        fix_velocity_sigma_mps: float | Axis | None = None,
        vector: str | Axis | None = None,
        sensor_axis: ListLike | Axis | None = None,
        dead_zones: Literal["none", "polar", "polar_and_equatorial"] | Axis | None = None,
        ins_grade: Literal["magnav", "navigation", "tactical", "commercial"] | Axis | None = None,
        init_position_sigma_m: float | Axis | None = None,
        init_altitude_sigma_m: float | Axis | None = None,
        init_velocity_sigma_mps: float | Axis | None = None,
        init_attitude_sigma_deg: float | Axis | None = None,
        init_heading_sigma_deg: float | Axis | None = None,
        vrw_sigma: float | Axis | None = None,
        arw_sigma: float | Axis | None = None,
        baro_sigma_m: float | Axis | None = None,
        ha_sigma_m: float | Axis | None = None,
        a_hat_sigma_mps2: float | Axis | None = None,
        acc_sigma_mps2: float | Axis | None = None,
        gyro_sigma_radps: float | Axis | None = None,
        baro_tau_s: float | Axis | None = None,
        acc_tau_s: float | Axis | None = None,
        gyro_tau_s: float | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Trains, on the lines that `where` selects, the network that sets the noise of the filter
        `nekf`.

        Do not select the lines that are navigated: their scores would be in sample.

        Training minimises the negative log-likelihood of the innovations, which requires no truth.
        With `loss = "position"`, it minimises the negative log-likelihood of the true position,
        `lat` and `lon`. The derivatives of the loss are propagated back through the network and
        through the covariance and state of the filter. Lines are prepared as in `navigate`. Give
        the shared keys the same values in both stages. With `tuning = "auto"` the noise of each
        line is estimated first, and the network learns how the noise changes along the line.

        The table holds the weights, the scaling of the inputs, and the mean loss of each epoch
        (`epoch_loss`; `initial_loss` is the loss of `ekf`). If the loss does not decrease, the
        inputs do not predict the noise, and the filter equals `ekf`. The filter runs over whole
        lines, and rows that `where` does not select have no measurement. Lines with different
        sample rates are rejected.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        map : TableLike
            Input: map.
        network_noise : {"r", "q", "both"}, optional
            Noise that the network sets: measurement noise (`"r"`), noise of the temporal variation
            (`"q"`), or both. Default: `"r"`.
        loss : {"likelihood", "position"}, optional
            Quantity whose negative log-likelihood is the loss: the innovations (`likelihood`) or
            the true position (`position`). Default: `"likelihood"`.
        features : ListLike, optional
            Columns that are additional inputs of the network, such as electric currents. Values
            that are not finite are rejected. Unset: none.
        hidden : int, optional
            Number of units in the long short-term memory layer of the network. Allowed: 1 to 256.
            Default: `8`.
        limit : float, optional
            Largest factor by which the network multiplies a standard deviation. The smallest factor
            is 1/`limit`. Allowed: 1.01 to 10000. Default: `10.0`.
        epochs : int, optional
            Number of passes through the lines. Allowed: 1 to 100000. Default: `30`.
        window_s : float, optional
            Time span over which derivatives are propagated back. Unit: s. Allowed: above 0.
            Default: `200.0`.
        learning_rate : float, optional
            Learning rate of the first step. The rate then falls to 0 along half a period of a
            cosine. Allowed: above 0. Default: `0.01`.
        seed : int, optional
            Seed of the initial weights. Default: `0`.
        tuning : {"auto", "magnav"}, optional
            Source of unset parameters. `auto` estimates the noise of each line from the likelihood
            of its innovations, rejects outliers, and continues a map of known height to the flight
            heights. `magnav` uses the defaults of MagNav.jl, no gate, and the map at its own
            height. A key in the spec takes precedence over both. Default: `"auto"`.
        mag : ListLike, optional
            Columns of the field measured by one or several magnetometers. A filter that cannot
            process magnetometers separately uses their mean at each sample, and assumes that their
            noise is independent. The offset (`offset_window_s`) is computed for each magnetometer.
            Unit: nT. Default: `["mag_c"]`.
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
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Gnadt 2022, section 5.9.3; Kingma & Ba 2015.
        """
        return self._stage("noise_network", locals())

    def navigate(
        self,
        *,
        input: TableLike,
        map: TableLike | None = None,
        model: TableLike | Sequence[TableLike] | None = None,
        filter: Literal["ekf", "iekf", "ukf", "ekf_adaptive", "nekf", "ekf_online_tl",
            "ekf_online_nn", "fixed_lag", "rts", "mpf", "mpf_then_ekf", "slam", "crlb", "ins_only"]
            | Axis | None = None,
        tuning: Literal["auto", "magnav"] | Axis | None = None,
        mag: ListLike | Axis | None = None,
        core_field: bool | Axis | None = None,
        remove_diurnal: bool | Axis | None = None,
        decimal_year: float | Axis | None = None,
        map_interpolation: Literal["linear", "quadratic", "cubic"] | Axis | None = None,
        map_levels_m: ListLike | Axis | None = None,
        map_error_length_m: float | Axis | None = None,
        offset_window_s: float | Axis | None = None,
        measurement_sigma_nt: float | Literal["auto"] | Axis | None = None,
        fogm_sigma_nt: float | Literal["auto"] | Axis | None = None,
        fogm_tau_s: float | Literal["auto"] | Axis | None = None,
        noise_column: str | Axis | None = None,
        start: Literal["auto", "fix", "alignment", "given"] | Axis | None = None,
        fix: ListLike | Axis | None = None,
        fix_velocity: ListLike | Axis | None = None,
        fix_sigma_m: float | Axis | None = None,
        fix_alt_sigma_m: float | Axis | None = None,
        fix_velocity_sigma_mps: float | Axis | None = None,
        vector: str | Axis | None = None,
        sensor_axis: ListLike | Axis | None = None,
        dead_zones: Literal["none", "polar", "polar_and_equatorial"] | Axis | None = None,
        ins_grade: Literal["magnav", "navigation", "tactical", "commercial"] | Axis | None = None,
        init_position_sigma_m: float | Axis | None = None,
        init_altitude_sigma_m: float | Axis | None = None,
        init_velocity_sigma_mps: float | Axis | None = None,
        init_attitude_sigma_deg: float | Axis | None = None,
        init_heading_sigma_deg: float | Axis | None = None,
        vrw_sigma: float | Axis | None = None,
        arw_sigma: float | Axis | None = None,
        baro_sigma_m: float | Axis | None = None,
        ha_sigma_m: float | Axis | None = None,
        a_hat_sigma_mps2: float | Axis | None = None,
        acc_sigma_mps2: float | Axis | None = None,
        gyro_sigma_radps: float | Axis | None = None,
        baro_tau_s: float | Axis | None = None,
        acc_tau_s: float | Axis | None = None,
        gyro_tau_s: float | Axis | None = None,
        save_state: bool | Axis | None = None,
        gate_nis: float | Axis | None = None,
        discretisation: Literal["trapezoidal", "rectangular", "van_loan"] | Axis | None = None,
        gnss_lost_s: ListLike | Axis | None = None,
        gnss: ListLike | Axis | None = None,
        gnss_interval_s: float | Axis | None = None,
        gnss_sigma_m: float | Axis | None = None,
        gnss_alt_sigma_m: float | Axis | None = None,
        gnss_noise: bool | Axis | None = None,
        gnss_test: bool | Axis | None = None,
        gradient: ListLike | Axis | None = None,
        gradient_baseline_m: ListLike | Axis | None = None,
        gradient_sigma_nt: float | Axis | None = None,
        gradient_bias_sigma_nt: float | Axis | None = None,
        gradient_bias_tau_s: float | Axis | None = None,
        gradient_slope_sigma: float | Literal["auto"] | Axis | None = None,
        use_scalar: bool | Axis | None = None,
        vector_sigma_nt: float | Axis | None = None,
        vector_bias_sigma_nt: float | Axis | None = None,
        vector_bias_tau_s: float | Axis | None = None,
        vector_crustal_sigma_nt: float | Axis | None = None,
        vector_crustal_length_m: float | Axis | None = None,
        height: str | Axis | None = None,
        height_sigma_m: float | Axis | None = None,
        height_bias_sigma_m: float | Axis | None = None,
        height_bias_tau_s: float | Axis | None = None,
        map_sigma_nt: float | Axis | None = None,
        map_sigma_length_m: float | Axis | None = None,
        mag_latency_sigma_s: float | Axis | None = None,
        map_height_sigma_m: float | Axis | None = None,
        permanent_change_sigma_nt: float | Axis | None = None,
        permanent_change_tau_s: float | Axis | None = None,
        flat_over_m: float | Axis | None = None,
        iterations: int | Axis | None = None,
        tolerance_m: float | Axis | None = None,
        alpha: float | Axis | None = None,
        beta: float | Axis | None = None,
        kappa: float | Axis | None = None,
        adapt: Literal["r", "q", "both"] | Axis | None = None,
        window: int | Axis | None = None,
        sigma_min_nt: float | Axis | None = None,
        sigma_max_nt: float | Axis | None = None,
        form: Literal["residual", "matched", "compatible"] | Axis | None = None,
        features: ListLike | str | Axis | None = None,
        save_inputs: bool | Axis | None = None,
        walk_per_hour: float | Axis | None = None,
        flux_bias_sigma_nt: float | Axis | None = None,
        flux_bias_tau_s: float | Axis | None = None,
        bt_scale_nt: float | Axis | None = None,
        terms: str | Axis | None = None,
        permanent_sigma_nt: float | Axis | None = None,
        induced_sigma_nt: float | Axis | None = None,
        eddy_sigma_nt_s: float | Axis | None = None,
        bias_sigma_nt: float | Axis | None = None,
        input_sigma_nt: float | Axis | None = None,
        heading_error_sigma_nt: float | Axis | None = None,
        prior_factor: float | Axis | None = None,
        hidden: int | Axis | None = None,
        activation: Literal["swish", "tanh"] | Axis | None = None,
        seed: int | Axis | None = None,
        passes: int | Axis | None = None,
        memory_s: float | Axis | None = None,
        save_weights: bool | Axis | None = None,
        window_s: float | Axis | None = None,
        overlap: float | Axis | None = None,
        lag_s: float | Axis | None = None,
        measurement_interval_s: float | Axis | None = None,
        loss: Literal["none", "huber", "cauchy"] | Axis | None = None,
        loss_scale: float | Axis | None = None,
        aircraft_sigma_nt: float | Axis | None = None,
        aircraft_tau_s: float | Axis | None = None,
        particles: int | Axis | None = None,
        resample_threshold: float | Axis | None = None,
        regularise: bool | Axis | None = None,
        smooth_over_m: float | Axis | None = None,
        roughening: float | Axis | None = None,
        save_modes: bool | Axis | None = None,
        hand_over_weight: float | Axis | None = None,
        update_interval_s: float | Axis | None = None,
        expected_measurement: Literal["nearest_neighbour", "regression", "inverse_distance"] | Axis
            | None = None,
        hyperparameters: Literal["fitted", "fixed"] | Axis | None = None,
        covariance: Literal["matern_5_2", "matern_3_2", "squared_exponential"] | Axis | None = None,
        sigma_se_nt: float | Axis | None = None,
        length_m: float | Axis | None = None,
        sigma_n_nt: float | Axis | None = None,
        fit_window_s: float | Axis | None = None,
        neighbours: int | Axis | None = None,
        ignore_s: float | Axis | None = None,
        trigger_radius_m: float | Axis | None = None,
        trigger_points: int | Axis | None = None,
        interpolation_radius_m: float | Axis | None = None,
        max_height_difference_m: float | Axis | None = None,
        interpolant_sigma_nt: float | Axis | None = None,
        resample_below: float | Axis | None = None,
        smooth: bool | Axis | None = None,
        smooth_measurements: int | Axis | None = None,
        smooth_sigma_nt: float | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Corrects an INS by matching the compensated field to an anomaly map with one of the
        filters below.

        The states are the errors of the INS (truth minus INS) and the temporal variation. The
        estimate is the INS value plus the state. Each row holds the estimate after the measurement
        update of its sample (a posteriori). `update` gives the outcome for the measurement: `used`;
        `missing` (NaN); `off_map` (predicted position off the map or in a cell with an unknown
        node); `gated` (outlier); `flat` (map too flat to observe the position, `flat_over_m`);
        `unused` (not needed by the filter). If the measurement of a sample is not used, the filter
        makes only the time update, and `residual` and `nis` are NaN.

        On a flat map, a measurement corrects only the temporal variation. With `core_field = true`,
        the slope of the core field also corrects the position slightly. A line with a NaN in an INS
        column is rejected, and the error message gives the row. If the INS columns of velocity,
        specific force or attitude are missing, they are derived from the INS positions or
        velocities. Derived roll and pitch angles are 0, and the derived yaw angle is the course.

        The map is used at its own height unless `map_levels_m` or `tuning = "auto"` continues it.
        `map_height_error` is the expected rms error of the map at the mean height of the line,
        computed from the spectrum of the whole map. For a continued map, this is the error of
        downward continuation: amplified noise plus the field that damping removes. The column is
        NaN if the map's height is unknown. A map in eastings and northings is interpolated on its
        native grid.

        Filters that linearise the map require an initial position error smaller than the distance
        over which the map is nearly linear. `start_sigma` is the standard deviation of the initial
        position. `start_sigma_limit` is the largest standard deviation for which the map is nearly
        linear. Up to this limit, the linearisation error is below the white noise, or below a third
        of the change that the linearised map predicts (medians over a minute of flight). A larger
        `start_sigma` is flagged (`wide_start` in the table of warnings), because these filters may
        then diverge unnoticed. In this case, use `filter = "mpf_then_ekf"`.

        The core field (IGRF-14) is computed at one date per line: `decimal_year`, or the flight's
        first sample with both `year` and `doy`. A flight without a date is rejected unless
        `core_field = false`.

        `measurement_sigma_nt`, `fogm_sigma_nt` and `fogm_tau_s` may be `"auto"`. This value selects
        the noise of the calibration residual, from the columns `mag_sigma`, `mag_fogm_sigma` and
        `mag_fogm_tau`. `compensate` estimates these columns from the lines to which its model was
        fitted; `residual_noise` and `assume_noise` estimate them from lines over a known field. If
        `offset_window_s` is set, the offset removes the slowly varying error at the start of the
        line. The remaining error is the change since the start, so the variance and the time
        constant from the columns are doubled. With `measurement_sigma_nt = "auto"` and
        `map_interpolation = "linear"`, the interpolation error is added to the white noise.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        map : TableLike, optional
            Input: map, optional.
        model : TableLike | Sequence[TableLike], optional
            Input: one or several model tables, optional.
        filter : {"ekf", "iekf", "ukf", "ekf_adaptive", "nekf", "ekf_online_tl", "ekf_online_nn",
        "fixed_lag", "rts", "mpf", "mpf_then_ekf", "slam", "crlb", "ins_only"}, optional
            Navigation filter. Default: `"ekf"`.
        tuning : {"auto", "magnav"}, optional
            Source of unset parameters. `auto` estimates the noise of each line from the likelihood
            of its innovations, rejects outliers, and continues a map of known height to the flight
            heights. `magnav` uses the defaults of MagNav.jl, no gate, and the map at its own
            height. A key in the spec takes precedence over both. Default: `"auto"`.
        mag : ListLike, optional
            Columns of the field measured by one or several magnetometers. A filter that cannot
            process magnetometers separately uses their mean at each sample, and assumes that their
            noise is independent. The offset (`offset_window_s`) is computed for each magnetometer.
            Unit: nT. Default: `["mag_c"]`.
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
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `nekf`, `rts`: Appends the state `x` and its
            covariance `p` (row-major). Default: `false`.
            For `ekf_online_tl`: Appends the state `x` and its covariance `p` (row-major), of the 18
            states of `ekf`. Default: `false`.
            For `crlb`: Appends the covariance `p` (row-major). Default: `false`.
        gate_nis : float, optional
            For `ekf`, `iekf`, `ukf`, `nekf`, `ekf_online_tl`, `ekf_online_nn`, `slam`: Largest
            accepted NIS (squared innovation divided by its variance) of a measurement. Allowed:
            above 0. Unset: no gate; with `tuning = "auto"`, outliers are rejected before filtering.
            For `ekf_adaptive`: Largest accepted NIS (squared innovation divided by its variance) of
            a measurement. Rejected measurements are used only to estimate the noise. Allowed: above
            0. Unset: no gate; with `tuning = "auto"`, outliers are rejected before filtering.
            For `mpf`: Largest accepted NIS of a measurement. The NIS is computed from the mean and
            variance of the whole cloud of particles. Allowed: above 0. Unset: no gate; with `tuning
            = "auto"`, outliers are rejected before filtering.
            For `mpf_then_ekf`: Largest accepted NIS of a measurement. Before the hand-over, the NIS
            is computed from the mean and variance of the whole cloud of particles. Allowed: above
            0. Unset: no gate; with `tuning = "auto"`, outliers are rejected before filtering.
        discretisation : {"trapezoidal", "rectangular", "van_loan"}, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `nekf`, `ekf_online_tl`, `ekf_online_nn`,
            `fixed_lag`, `rts`, `slam`, `crlb`: Discretisation of the process noise: `trapezoidal`
            is of second order, `rectangular` of first order as in MagNav.jl, and `van_loan` exact.
            Default: `"trapezoidal"`.
        gnss_lost_s : ListLike, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `nekf`, `ekf_online_tl`, `ekf_online_nn`,
            `fixed_lag`, `rts`, `mpf`, `mpf_then_ekf`, `slam`, `crlb`, `ins_only`: Times at which
            GNSS is lost and recovered, in seconds from the first sample of the line. Before the
            loss and after the recovery, the GNSS position (columns `gnss`) aids the filter. With
            `[0.0, 600.0]`, GNSS is missing for the first ten minutes of the line. If the recovery
            time is after the end of the line, GNSS is never recovered. Unit: s. Allowed: 0 or
            above. Unset: GNSS is not used.
        gnss : ListLike, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `nekf`, `ekf_online_tl`, `ekf_online_nn`,
            `fixed_lag`, `rts`, `mpf`, `mpf_then_ekf`, `slam`, `crlb`, `ins_only`: Columns with the
            GNSS latitude (deg), longitude (deg) and height above the ellipsoid (m). Unset:
            `gnss_lat`, `gnss_lon` and `gnss_alt` if the flight has them, else `lat`, `lon` and
            `alt`.
        gnss_interval_s : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `nekf`, `ekf_online_tl`, `ekf_online_nn`,
            `fixed_lag`, `rts`, `mpf`, `mpf_then_ekf`, `slam`, `crlb`, `ins_only`: Time between
            successive GNSS positions. Unit: s. Allowed: above 0. Default: `1.0`.
        gnss_sigma_m : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `nekf`, `ekf_online_tl`, `ekf_online_nn`,
            `fixed_lag`, `rts`, `mpf`, `mpf_then_ekf`, `slam`, `crlb`, `ins_only`: Standard
            deviation of the GNSS position along each horizontal axis. Unit: m. Allowed: above 0.
            Default: `2.0`.
        gnss_alt_sigma_m : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `nekf`, `ekf_online_tl`, `ekf_online_nn`,
            `fixed_lag`, `rts`, `mpf`, `mpf_then_ekf`, `slam`, `crlb`, `ins_only`: Standard
            deviation of the GNSS height. Unit: m. Allowed: above 0. Default: `5.0`.
        gnss_noise : bool, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `nekf`, `ekf_online_tl`, `ekf_online_nn`,
            `fixed_lag`, `rts`, `mpf`, `mpf_then_ekf`, `slam`, `crlb`, `ins_only`: Adds white noise
            to the GNSS positions, with the standard deviations `gnss_sigma_m` and
            `gnss_alt_sigma_m`. The added noise of a line is the same in every run. True positions
            have no error: without added noise, the filter appears more accurate than with real
            GNSS. Unset: true if the columns of `gnss` have the role `truth`.
        gnss_test : bool, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `nekf`, `ekf_online_tl`, `ekf_online_nn`,
            `fixed_lag`, `rts`, `mpf`, `mpf_then_ekf`, `slam`, `crlb`, `ins_only`: Tests each GNSS
            position against the INS position and does not use rejected positions. A chi-square test
            of each position detects a jump at once. A cumulative sum over earlier positions detects
            a drift of 1 m/s after about 10 s. The test then also rejects the positions since the
            start of the drift. Positions are accepted again after ten consecutive positions agree
            with the INS. The column `gnss_update` (`used`, `rejected` or `none`) is appended even
            if this key is false. Default: `true`.
        gradient : ListLike, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Two compensated scalar magnetometers. The
            difference between their readings, first minus second, measures the slope of the map
            along the baseline between them. The temporal variation and all other common errors
            cancel in this difference. This key cannot be combined with `map_interpolation =
            "linear"`, because the slope of a bilinear map has steps. Unit: nT. Unset: the
            difference is not used.
        gradient_baseline_m : ListLike, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Vector from the second magnetometer of `gradient`
            to the first, in the body frame (nose, right, down). The INS attitude rotates this
            vector to the navigation frame. The measurement model includes the estimated error of
            the INS attitude. Unit: m. Allowed: finite. Unset: required with `gradient`.
        gradient_sigma_nt : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Standard deviation of the white noise in the
            difference between the two magnetometers' readings. Unit: nT. Allowed: above 0. Default:
            `0.1`.
        gradient_bias_sigma_nt : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Standard deviation of the slowly varying error in
            the difference between the two magnetometers' readings. Such an error is likely, because
            each calibration leaves a constant undetermined. Unit: nT. Allowed: 0 or above. Default:
            `1.0`.
        gradient_bias_tau_s : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Time constant of the slowly varying error in the
            difference between the two magnetometers' readings. Unit: s. Allowed: above 0. Default:
            `3600.0`.
        gradient_slope_sigma : float | {"auto"}, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Standard deviation of the error in the map's slope
            along the baseline. The error of the predicted difference is this error times the length
            of the baseline. The error is correlated along the track, over the same length as the
            map's anomalies. `"auto"` uses the maximum-likelihood value from the innovations of the
            difference. A large value can reveal a map made from widely spaced lines. A map at one
            height without `map_levels_m` has no vertical slope. The prediction then has an
            additional error: the height difference between the magnetometers times the rms slope.
            Unit: nT/m. Allowed: 0 or above. Default: `auto`.
        use_scalar : bool, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Uses the scalar measurement `mag` in the
            measurement update. `false` ignores `mag`, for example in a magnetic storm, and requires
            the difference (`gradient`) or the vector (`vector_sigma_nt`). Default: `true`.
        vector_sigma_nt : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Standard deviation of the white noise of each
            component of `vector`. If set, the components are used as measurements. They depend on
            the total field and on the attitude, but not on a rotation about the field direction.
            This key requires `core_field = true` and a calibrated vector magnetometer. Unit: nT.
            Allowed: above 0. Unset: the vector is not used as a measurement.
        vector_bias_sigma_nt : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Standard deviation of the bias of each component
            of `vector`. In a field of 50,000 nT, a bias of 50 nT corresponds to an attitude error
            of 0.06°. Unit: nT. Allowed: 0 or above. Default: `50.0`.
        vector_bias_tau_s : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Time constant of the bias of each component of
            `vector`. Unit: s. Allowed: above 0. Default: `3600.0`.
        vector_crustal_sigma_nt : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Standard deviation, per component, of the crustal
            field that a map of the scalar anomaly leaves undetermined. A typical value is the
            standard deviation of the anomaly. Unit: nT. Allowed: 0 or above. Default: `50.0`.
        vector_crustal_length_m : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Correlation length of the crustal field that
            `vector_crustal_sigma_nt` describes. A typical value is the height above the sources.
            Unit: m. Allowed: above 0. Default: `1000.0`.
        height : str, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Column of measured heights above the ellipsoid,
            such as `baro`, from a barometer that does not already aid the INS. Unit: m. Unset: the
            height of the INS, aided by its barometer, is used.
        height_sigma_m : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Standard deviation of the white noise of the
            measured height. Unit: m. Allowed: above 0. Default: `3.0`.
        height_bias_sigma_m : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Standard deviation of the slowly varying error of
            the measured height, caused by the weather and the geoid. Unit: m. Allowed: 0 or above.
            Default: `30.0`.
        height_bias_tau_s : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Time constant of the slowly varying error of the
            measured height. Unit: s. Allowed: above 0. Default: `3600.0`.
        map_sigma_nt : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Standard deviation of the map error. If set, the
            filter estimates the map error as a state that is correlated along the track. Unit: nT.
            Allowed: 0 or above. Unset: the map error is not estimated.
        map_sigma_length_m : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Distance over which the autocorrelation of the map
            error falls to 1/e. Unit: m. Allowed: above 0. Default: `500.0`.
        mag_latency_sigma_s : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Prior standard deviation of the lag of the
            magnetometer's time stamps. If set, the filter estimates the lag as a state that is
            constant along the line. A sample with time stamp `t` was measured at `t` minus the lag.
            The lag may be negative. 0 omits this state. The columns `mag_latency` and
            `mag_latency_sigma` are appended. This key is available in `ekf`, `iekf` and `ukf`.
            Unit: s. Allowed: 0 or above. Unset: 1.0 with `tuning = "auto"` if a state for the lag
            clearly increases the likelihood, otherwise 0 (exact time stamps).
        map_height_sigma_m : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Prior standard deviation of a height bias: the
            true height of the aircraft minus its assumed height on the map. Possible causes are a
            constant error of the barometer, a missing geoid height, and a wrong map height. If set,
            the filter estimates the bias as a state that is constant along the line. The bias
            changes only the predicted total field, not `alt`. The heights to which the map is
            continued must include the true height of the aircraft. With `tuning = "auto"`, the map
            is continued to twice this standard deviation below and above the line. Otherwise, set
            `map_levels_m`. 0 omits this state. The columns `map_height_bias` and
            `map_height_bias_sigma` are appended. This key is available in `ekf`, `iekf` and `ukf`.
            Unit: m. Allowed: 0 or above. Unset: 50 with `tuning = "auto"` if a bias clearly
            increases the likelihood, otherwise 0 (exact height). To find a bias, `auto` continues
            the map up to 200 m below and above the line, unless `map_levels_m` is set.
        permanent_change_sigma_nt : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Standard deviation of the change in the aircraft's
            permanent field since calibration, per component (nose, right, down). The filter
            estimates the three components as additional states. The attitude and the core field
            determine the effect of these components on the total field. A fourth state is a
            constant offset with a standard deviation of 100 nT. 0 omits these states. This key
            requires `core_field = true`, and is available in `ekf`, `iekf` and `ukf`. Unit: nT.
            Allowed: 0 or above. Unset: the maximum-likelihood estimate with `tuning = "auto"` if
            these states clearly increase the likelihood, otherwise 0.
        permanent_change_tau_s : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: Time constant of the change in the permanent
            field. Unit: s. Allowed: above 0. Unset: the maximum-likelihood estimate with `tuning =
            "auto"`, otherwise infinite, so that the change is constant along the line.
        flat_over_m : float, optional
            For `ekf`, `iekf`, `ukf`, `ekf_adaptive`, `ekf_online_tl`, `ekf_online_nn`, `fixed_lag`,
            `rts`, `mpf`, `mpf_then_ekf`, `crlb`: A sample corrects the position only if the ratio
            of its measurement noise (standard deviation) to the map's horizontal slope is at most
            this value. At a larger ratio, the map is too flat to observe the position. The sample
            is then `flat`: it corrects only the temporal variation and the map error. The column
            `map_slope` is appended. Unit: m. Allowed: above 0. Unset: all samples correct the
            position.
        iterations : int, optional
            For `iekf`: Maximum number of linearisations of the map per sample. Allowed: 1 to 1000.
            Default: `5`.
            For `fixed_lag`: Maximum number of iterations per window. Default: `15`.
            For `rts`: Maximum number of passes over the line. Allowed: 1 to 1000. Default: `20`.
        tolerance_m : float, optional
            For `iekf`: The iteration ends when the position changes by less than this distance.
            Unit: m. Allowed: above 0. Default: `0.1`.
            For `rts`: Limit on the position change. The iteration ends when no position on the line
            changes by more than this limit. Unit: m. Allowed: above 0. Default: `0.1`.
        alpha : float, optional
            For `ukf`: Scale factor on the distance of the outer sigma points from the central one.
            Allowed: above 0. Default: `1.0`.
        beta : float, optional
            For `ukf`: Parameter in the weight of the central sigma point: the weight in the
            covariance exceeds the weight in the mean by 1 - alpha² + beta. The minimum of beta is
            -alpha² kappa/3. The filter computes the variance due to the nonlinearity of the field.
            Averaged over directions, the computed variance is (5 + 4 beta)/8 of the true variance.
            With a beta of 2, the filter is therefore cautious. Allowed: finite. Default: `2.0`.
        kappa : float, optional
            For `ukf`: Parameter in the distance of the outer sigma points from the central one,
            which is alpha sqrt(3 + kappa) standard deviations. `kappa` must be above -3. With 0,
            the gain is exact to the fourth moment of a normal distribution. Allowed: finite.
            Default: `0.0`.
        adapt : {"r", "q", "both"}, optional
            For `ekf_adaptive`: Noise that is estimated: measurement noise (`"r"`), process noise
            (`"q"`), or both. Default: `"r"`.
        window : int, optional
            For `ekf_adaptive`: Number of past innovations in the estimate. With 50 innovations, the
            noise is accurate to 10 %; with 10, as in MagNav.jl, to 20 %. With 10 innovations, the
            forms `"matched"` and `"compatible"` occasionally estimate a noise near 0. The filter is
            then strongly overconfident unless `sigma_min_nt` is near the true noise. Allowed: 2 to
            1000000. Default: `50`.
        sigma_min_nt : float, optional
            For `ekf_adaptive`: Lower bound of the estimated noise. Unit: nT. Allowed: above 0.
            Unset: half of the noise that `tuning = "auto"` estimates, else a twentieth of
            `measurement_sigma_nt`; with `noise_column` the smallest assumed noise.
        sigma_max_nt : float, optional
            For `ekf_adaptive`: Upper bound of the estimated noise. Unit: nT. Allowed: above 0.
            Unset: 20 times `measurement_sigma_nt`, or with `noise_column` 20 times the largest
            assumed noise.
        form : {"residual", "matched", "compatible"}, optional
            For `ekf_adaptive`: Estimator of the noise. `"residual"` uses the a posteriori residual
            of each measurement. `"matched"`, the default of version 1, subtracts from each squared
            innovation the variance predicted for the same sample. `"compatible"`, as in MagNav.jl,
            starts at the mean of the bounds and subtracts the variance predicted for the present
            sample from all squared innovations. Default: `"residual"`.
        features : ListLike | str, optional
            For `nekf`: Columns that are additional inputs of the network, such as electric
            currents. Values that are not finite are rejected. Unset: none.
            For `ekf_online_nn`: List column of the network's inputs, as made by `features` or
            `a_matrix`. Default: `"features"`.
        save_inputs : bool, optional
            For `nekf`: Appends the inputs of the network before standardisation. Default: `false`.
        walk_per_hour : float, optional
            For `ekf_online_tl`: Random walk of a coefficient: standard deviation of the change in
            one hour, divided by the prior standard deviation. With 0 the coefficients are
            constants. In a cold start the default is 0, because the wide prior does not describe
            changes in flight. Allowed: 0 or above. Unset: 0.1 with `model`, else 0.0.
            For `fixed_lag`: Random walk of a coefficient: standard deviation of the change in one
            hour, divided by the prior standard deviation. With 0 the coefficients are constants.
            Allowed: 0 or above. Default: `0.0`.
        flux_bias_sigma_nt : float, optional
            For `ekf_online_tl`: Standard deviation of the bias of each axis of `vector`, the
            magnetometer of the terms. If set, the filter estimates these biases. Unit: nT. Allowed:
            above 0. Unset: `vector` is assumed to be exact.
        flux_bias_tau_s : float, optional
            For `ekf_online_tl`: Time constant of the biases of `vector`. Unit: s. Allowed: above 0.
            Unset: the biases are constant.
        bt_scale_nt : float, optional
            For `ekf_online_tl`: Field scale of the terms: `bt_scale_nt` of the `a_matrix` stage
            that computes the terms. Unit: nT. Allowed: above 0. Default: `50000.0`.
        terms : str, optional
            For `ekf_online_tl`, `fixed_lag`: List column of the terms, as made by `a_matrix`.
            Default: `"tl"`.
        permanent_sigma_nt : float, optional
            For `ekf_online_tl`, `fixed_lag`: Standard deviation of the zero-mean prior of a
            permanent coefficient, unless `model` supplies a prior. Unit: nT. Allowed: above 0.
            Default: `2000.0`.
        induced_sigma_nt : float, optional
            For `ekf_online_tl`, `fixed_lag`: Standard deviation of the zero-mean prior of an
            induced coefficient, unless `model` supplies a prior. Unit: nT. Allowed: above 0.
            Default: `1000.0`.
        eddy_sigma_nt_s : float, optional
            For `ekf_online_tl`, `fixed_lag`: Prior standard deviation of an eddy coefficient at one
            sample per second. An eddy term contains the change of the field from one sample to the
            next, so this value is multiplied by the sample rate of the line. Unit: nT s. Allowed:
            above 0. Default: `500.0`.
        bias_sigma_nt : float, optional
            For `ekf_online_tl`, `fixed_lag`: Prior standard deviation of the constant `bias`. Unit:
            nT. Allowed: above 0. Default: `500.0`.
        input_sigma_nt : float, optional
            For `ekf_online_tl`, `fixed_lag`: Prior standard deviation of the coefficient of any
            other term, such as an electric current, in nT per unit of the term. A current loop in
            the cabin causes a few nT per ampere. Unit: nT. Allowed: above 0. Default: `20.0`.
        heading_error_sigma_nt : float, optional
            For `ekf_online_tl`, `fixed_lag`: Prior standard deviation of each harmonic of the
            magnetometer's heading error. The terms `heading_1`, `heading_2` and `heading_4` are the
            first, second and fourth harmonics of the angle between the sensor axis and the field.
            This key requires `vector`. Unit: nT. Allowed: above 0. Unset: the heading error is not
            estimated.
        prior_factor : float, optional
            For `ekf_online_tl`, `fixed_lag`: Factor on the prior standard deviations from `model`.
            A single calibration supplies the standard deviations of its fit. Several calibrations
            supply the scatter between them. Some terms, such as eddy terms, are differences between
            samples. The coefficients of these terms are converted from the sample rate of the fit
            to the sample rate of the line. At rates below about 5 Hz, the differences are
            inaccurate in manoeuvres: they underestimate a change at frequency f by the fraction (2
            pi f / rate)^2 / 6. Allowed: above 0. Default: `1.0`.
        hidden : int, optional
            For `ekf_online_nn`: Number of units in the hidden layer. Allowed: 1 to 64. Default:
            `8`.
        activation : {"swish", "tanh"}, optional
            For `ekf_online_nn`: Activation function. Default: `"swish"`.
        seed : int, optional
            For `ekf_online_nn`: Seed of the initial weights. Default: `0`.
            For `mpf`, `mpf_then_ekf`: Seed of all random draws. The same seed gives bit-identical
            results on any number of threads. Default: `0`.
            For `slam`: Seed of all random draws. Default: `0`.
        passes : int, optional
            For `ekf_online_nn`: Number of training passes over the samples. Allowed: 1 to 1000.
            Default: `10`.
        memory_s : float, optional
            For `ekf_online_nn`: Time in which the random walk changes each weight by at least the
            weight's standard deviation at the end of training. Unit: s. Allowed: above 0. Default:
            `3600.0`.
        save_weights : bool, optional
            For `ekf_online_nn`: Appends the weights at each sample: the input weights of each
            hidden unit, the biases of the units, the output weights, and the output bias. Default:
            `false`.
        window_s : float, optional
            For `fixed_lag`: Length of a window. Unit: s. Allowed: above 0. Default: `300.0`.
        overlap : float, optional
            For `fixed_lag`: Fraction of a window that overlaps with the next window. A window ends
            every `window_s` × (1 - `overlap`) seconds. Allowed: 0 to 0.999. Default: `0.95`.
        lag_s : float, optional
            For `fixed_lag`: Delay of the estimate, which uses measurements up to this time after
            the sample. 0 gives real-time navigation. Unit: s. Allowed: 0 or above. Default: `0.0`.
        measurement_interval_s : float, optional
            For `fixed_lag`: Interval over which measurements are averaged into one. 0 uses every
            sample. Unit: s. Allowed: 0 or above. Default: `1.0`.
        loss : {"none", "huber", "cauchy"}, optional
            For `fixed_lag`, `rts`: Loss function of a residual: quadratic (`none`), or robust to
            outliers (`huber`, `cauchy`). Default: `"none"`.
        loss_scale : float, optional
            For `fixed_lag`: Residual above which a robust `loss` departs from the quadratic loss,
            in standard deviations of the measurement. Allowed: above 0. Default: `2.5`.
            For `rts`: Residual above which a robust loss departs from the quadratic loss, in
            standard deviations of the measurement. Allowed: above 0. Unset: 1.345 with `huber`,
            2.385 with `cauchy` (95 % efficiency for normal noise).
        aircraft_sigma_nt : float, optional
            For `fixed_lag`: Standard deviation of the slowly varying aircraft field that the
            coefficients do not explain. 0 assumes no such field. Unit: nT. Allowed: 0 or above.
            Unset: 30.0; 0 if `tuning = "auto"` estimates the noise of the line, because the
            estimated noise includes this field.
        aircraft_tau_s : float, optional
            For `fixed_lag`: Time constant of the slowly varying aircraft field that the
            coefficients do not explain. Unit: s. Allowed: above 0. Default: `300.0`.
        particles : int, optional
            For `mpf`: Number of particles. Use 3000 if the INS position is known to within hundreds
            of metres. Use 10,000 if the INS position is uncertain by kilometres, or with a
            measurement as precise as `gradient`. Allowed: 1 to 1000000. Unset: 3000 to 50,000, by
            KLD-sampling (Fox 2003) over squares of side `smooth_over_m`; the column `particles` is
            then appended.
            For `mpf_then_ekf`: Number of particles. Allowed: 1 to 1000000. Unset: 3000 to 50,000,
            by KLD-sampling (Fox 2003) over squares of side `smooth_over_m`.
            For `slam`: Number of particles. They must cover the drift between revisits densely, so
            a less accurate INS requires more particles. Allowed: 2 to 1000000. Default: `1000`.
        resample_threshold : float, optional
            For `mpf`: The particles are resampled when their effective number falls below this
            fraction of their number. 0.5 is usual; a larger value (0.8 in MagNav.jl) resamples more
            often and only adds noise. Allowed: 0 to 1. Default: `0.5`.
        regularise : bool, optional
            For `mpf`: Resamples from a kernel density. The position error of a good INS has almost
            no process noise, so without the kernel density only copies of a few particles remain.
            The covariance is then far too small. Default: `true`.
        smooth_over_m : float, optional
            For `mpf`: Distance over which the map is nearly linear; typically the height of the map
            above the sources. A wider cloud of particles is divided into parts with one kernel
            each. With `gradient`, set a third of this distance, over which the slope of the map is
            nearly linear. Unit: m. Allowed: above 0. Default: `200.0`.
            For `mpf_then_ekf`: Distance over which the map is nearly linear; typically the height
            of the map above the sources. A wider cloud of particles is divided into parts with one
            kernel each. Unit: m. Allowed: above 0. Default: `200.0`.
        roughening : float, optional
            For `mpf`: Standard deviation, per axis, of position noise that is added to each
            resampled particle. The unit is the range of the particles divided by the square root of
            their number. Gordon, Salmond & Smith 1993 use 0.2. Allowed: 0 or above. Default: `0.0`.
        save_modes : bool, optional
            For `mpf`: Appends the three most probable modes of the position to each sample. The run
            time of the filter then increases by 50 %. Default: `false`.
        hand_over_weight : float, optional
            For `mpf_then_ekf`: Minimum weight of the most probable mode at the hand-over. Allowed:
            0.5 to 1. Default: `0.99`.
        update_interval_s : float, optional
            For `slam`: Minimum time between two updates of the particles. Measurements within this
            time are averaged. 0 uses every sample. Unit: s. Allowed: 0 or above. Default: `1.0`.
        expected_measurement : {"nearest_neighbour", "regression", "inverse_distance"}, optional
            For `slam`: Prediction of a measurement from earlier ones: from the nearest and the most
            recent (`"nearest_neighbour"`), by the regression of Lee 2019 (`"regression"`), or by
            inverse distance (`"inverse_distance"`). Default: `"nearest_neighbour"`.
        hyperparameters : {"fitted", "fixed"}, optional
            For `slam`: Source of the hyper-parameters `sigma_se_nt`, `length_m` and `sigma_n_nt`: a
            maximum-likelihood fit to the first part of the flight (`fitted`), or the spec
            (`fixed`). Default: `"fitted"`.
        covariance : {"matern_5_2", "matern_3_2", "squared_exponential"}, optional
            For `slam`: Covariance function of the anomaly over distance. Default: `"matern_5_2"`.
        sigma_se_nt : float, optional
            For `slam`: Standard deviation of the anomaly. Unit: nT. Allowed: above 0. Unset: 50 nT,
            the value of the Louisa flight in Lee 2019.
        length_m : float, optional
            For `slam`: Correlation length of the anomaly. Unit: m. Allowed: above 0. Unset: 150 m,
            the value of the Louisa flight in Lee 2019.
        sigma_n_nt : float, optional
            For `slam`: Standard deviation of the white part of the anomaly, in addition to the
            measurement noise. Unit: nT. Allowed: 0 or above. Unset: 1 nT, the value of the Louisa
            flight in Lee 2019.
        fit_window_s : float, optional
            For `slam`: Length of the part at the start of the flight to which the hyper-parameters
            are fitted. Unit: s. Allowed: above 0. Default: `600.0`.
        neighbours : int, optional
            For `slam`: Maximum number of earlier samples in a prediction. Allowed: 1 to 20.
            Default: `12`.
        ignore_s : float, optional
            For `slam`: Minimum time between the present sample and an earlier sample that is
            compared with it. Unit: s. Allowed: 0 or above. Default: `30.0`.
        trigger_radius_m : float, optional
            For `slam`: Radius of the test for a revisit. A sample is a revisit if more than
            `trigger_points` earlier samples lie within this radius. Unit: m. Allowed: above 0.
            Unset: the larger of 18 m and 1.6 times the distance between samples.
        trigger_points : int, optional
            For `slam`: A sample is a revisit if more than this number of earlier samples lie within
            `trigger_radius_m`. Default: `2`.
        interpolation_radius_m : float, optional
            For `slam`: Radius within which earlier samples are used for a prediction. Unit: m.
            Allowed: above 0. Unset: half the correlation length, at most 0.4 of the distance flown
            in `ignore_s`.
        max_height_difference_m : float, optional
            For `slam`: Maximum height difference between a sample and the earlier samples that
            predict it. Within this limit, the assumed variance of an earlier sample increases with
            the height difference. Unit: m. Allowed: 0 or above. Default: `100.0`.
        interpolant_sigma_nt : float, optional
            For `slam`: Standard deviation of an inverse-distance-weighted prediction. Unit: nT.
            Allowed: above 0. Default: `10.0`.
        resample_below : float, optional
            For `slam`: The particles are resampled when their effective number falls below this
            fraction of their number. Allowed: 0 to 1. Default: `0.5`.
        smooth : bool, optional
            For `slam`: Replaces the track of the particles by the most probable track of the whole
            flight. Default: `false`.
        smooth_measurements : int, optional
            For `slam`: Maximum number of measurements in the smoother. A longer flight is divided
            into this number of groups of samples. Samples near the middle of each group are
            averaged, and the other samples are omitted. Computing time is proportional to the third
            power of this number. Allowed: 2 to 5000. Default: `1000`.
        smooth_sigma_nt : float, optional
            For `slam`: Standard deviation of the white noise of a measurement in the smoother. A
            small number of particles requires a larger assumed noise; the smoother does not. Unit:
            nT. Allowed: above 0. Unset: the assumed noise of the particles.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).
        """
        return self._stage("navigate", locals())

    def map_value(
        self,
        *,
        input: TableLike,
        map: TableLike,
        position: Literal["truth", "ins"] | Axis | None = None,
        map_interpolation: Literal["linear", "quadratic", "cubic"] | Axis | None = None,
        map_levels_m: ListLike | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Appends the value of a map at every sample: the anomaly `map_anomaly` and its slopes
        `map_grad_n`, `map_grad_e`, `map_grad_u` (per metre north, east and up).

        Use `map_value` to compare a signal with the map, or to assess a map for navigation. The
        result is NaN for a sample off the map, in a cell with an unknown node, or without a
        position. A map in eastings and northings is interpolated on its native grid: the position
        is projected, and the slopes are rotated back to north and east.

        By default, the map is used at its own height, and `map_grad_u` is 0. `map_levels_m` gives
        the heights to which the map is continued. The stage interpolates between these levels, so
        that the values follow climbs and descents. The result is NaN for a sample that is outside
        the levels by more than half the distance between two levels. Downward continuation
        amplifies short wavelengths, so keep the levels at or above the height of the map.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        map : TableLike
            Input: map.
        position : {"truth", "ins"}, optional
            Position at which the map is evaluated: the true position (`lat`, `lon`, `alt`) or the
            INS position. Columns computed at the true position have the role truth; a model can use
            them as features only with `allow_truth`. Unset: the INS position if the flight has
            `ins_lat`, `ins_lon` and `ins_alt`, otherwise the true position.
        map_interpolation : {"linear", "quadratic", "cubic"}, optional
            Interpolation of the map. The field above its sources is smooth, so spline interpolation
            is more accurate than bilinear interpolation. Default: `"cubic"`.
        map_levels_m : ListLike, optional
            Heights above the WGS-84 ellipsoid, ascending, to which the map is continued. Unit: m.
            Unset: the map is used at its own height.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Gnadt 2022, section 2.3; Blakely 1996, chapter 12.
        """
        return self._stage("map_value", locals())

    def map_quality(
        self,
        *,
        input: TableLike,
        map: TableLike,
        position: Literal["truth", "ins"] | Axis | None = None,
        sigma_nt: float | Axis | None = None,
        window_s: float | Axis | None = None,
        unknown_constant: bool | Axis | None = None,
        map_interpolation: Literal["linear", "quadratic", "cubic"] | Axis | None = None,
        map_levels_m: ListLike | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Appends measures of a map's usefulness for navigation along a planned or flown track.

        `map_gradient_n` and `map_gradient_e` are the slopes of the map to the north and east, and
        `map_gradient` is the magnitude of the slope. `map_sd_sample` is the standard deviation of
        the position, along that slope, from one measurement. `map_sd_expected` is the expected root
        mean square horizontal error from the measurements within `window_s` about the sample. Use
        `map_quality` to plan flights over informative parts of a map, and to find where the map
        limits the accuracy of any filter.

        `map_sd_sample` is `sigma_nt` divided by `map_gradient`. `map_sd_expected` is the Cramér-Rao
        bound: the square root of the trace of the inverse Fisher information sum(g g')/`sigma_nt`^2
        of the slopes g in the window. The bound holds for an unbiased filter that has exact
        knowledge of its motion within the window but no earlier position. The bound assumes
        independent sample errors with standard deviation `sigma_nt`. At ten samples per second,
        however, errors of the map and of the temporal variation are correlated. In this case,
        multiply `sigma_nt` by the square root of the number of samples within the correlation time.
        `unknown_constant` subtracts the mean slope, which gives the bound for a measurement with an
        unknown constant. `map_position_bound` of `score` is the bound with an unknown constant over
        the whole line.

        All columns are NaN for a sample off the map, in a cell with an unknown node, or without a
        position. Both standard deviations are NaN where the map is flat. `map_sd_expected` is also
        NaN where all slopes in the window have one direction. The slope of the core field is not
        included.

        A line is rejected if none of its samples is on the map, or if its times do not increase.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        map : TableLike
            Input: map.
        position : {"truth", "ins"}, optional
            Position at which the map is evaluated: the true position (`lat`, `lon`, `alt`) or the
            INS position. Columns computed at the true position have the role truth; a model can use
            them as features only with `allow_truth`. Default: `"truth"`.
        sigma_nt : float, optional
            Standard deviation of the error of each sample, including errors of the sensor, the map
            and the compensation. Unit: nT. Allowed: above 0. Default: `5.0`.
        window_s : float, optional
            Length of the window about each sample. Unit: s. Allowed: above 0. Default: `60.0`.
        unknown_constant : bool, optional
            Assumes that the measurement contains an unknown constant. Default: `false`.
        map_interpolation : {"linear", "quadratic", "cubic"}, optional
            Interpolation of the map. The field above its sources is smooth, so spline interpolation
            is more accurate than bilinear interpolation. Default: `"cubic"`.
        map_levels_m : ListLike, optional
            Heights above the WGS-84 ellipsoid, ascending, to which the map is continued. Unit: m.
            Unset: the map is used at its own height.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Kay 1993, section 3.7; Gnadt 2022, section 2.3.
        """
        return self._stage("map_quality", locals())

    def map_grid(
        self,
        *,
        input: TableLike,
        value: str | Axis | None = None,
        core_field: Literal["none", "igrf", "wmm", "column"] | Axis | None = None,
        decimal_year: float | Axis | None = None,
        remove_diurnal: bool | Axis | None = None,
        level_order: int | Axis | None = None,
        crossing_height_m: float | Axis | None = None,
        method: Literal["equivalent_sources", "minimum_curvature"] | Axis | None = None,
        spacing_m: float | Axis | None = None,
        level_m: float | Axis | None = None,
        damping: float | Axis | None = None,
        tension: float | Axis | None = None,
        bounds: ListLike | Axis | None = None,
        block_m: float | Axis | None = None,
        mask_m: float | Axis | None = None,
        keep_outliers: bool | Axis | None = None,
        cross_validate: int | Axis | None = None,
        to_epsg: int | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Grids survey lines to a map.

        The stage subtracts the core field and the diurnal variation, levels the lines at their
        crossings, removes outliers, and fits a surface.

        Use `map_grid` to make a navigation map from the survey lines that `where` selects.
        `equivalent_sources` gives a potential field at one height, by default the height of the
        highest point. The potential field can be continued to other heights. `minimum_curvature`
        interpolates the values without continuing them to a common height, so it does not require
        heights. Levelling is part of this stage, because it uses the crossings in the map's
        coordinates and the values without core field and diurnal variation. Do not grid the lines
        that are navigated, because the map would then contain the field measured along these lines.

        These points are omitted: points without a position, a value or, for equivalent sources, a
        height; duplicates; outliers along a line; points far from all others; and lines of fewer
        than five points. These inputs are rejected: a level below the points, a spacing wider than
        the area, levelling of lines that do not cross, and a core field for points without a date.

        With `cross_validate`, every line is predicted from a map of other lines. The column `error`
        then holds the expected error of each node.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        value : str, optional
            Column of the values. Unit: nT. Default: `"anomaly"`.
        core_field : {"none", "igrf", "wmm", "column"}, optional
            Core field that is subtracted from the values: the magnitude from IGRF-14 or from the
            World Magnetic Model, or the column `igrf`. Default: `"none"`.
        decimal_year : float, optional
            Date of the core field, instead of the date of each point. Unit: a. Allowed: 1900 to
            2030. Unset: the date of each point, from `year`, `doy` and `tt`.
        remove_diurnal : bool, optional
            Subtracts the column `diurnal` from the values. Default: `false`.
        level_order : int, optional
            Order of the polynomial that levels each line: 0 for a constant, 1 for a linear
            correction, and so on. Allowed: 0 to 8. Unset: no levelling.
        crossing_height_m : float, optional
            Largest height difference between two lines at a crossing that is used for levelling.
            Unit: m. Allowed: 0 or above. Default: `50.0`.
        method : {"equivalent_sources", "minimum_curvature"}, optional
            Gridding method. Default: `"equivalent_sources"`.
        spacing_m : float, optional
            Distance between nodes. Unit: m. Allowed: above 0. Unset: half the distance between
            lines.
        level_m : float, optional
            Height of the map above the WGS-84 ellipsoid, for equivalent sources. Unit: m. Unset:
            the height of the highest point.
        damping : float, optional
            Damping of the equivalent sources. Allowed: above 0. Default: `1.0`.
        tension : float, optional
            Tension of the minimum-curvature surface. Allowed: 0 to 1. Default: `0.25`.
        bounds : ListLike, optional
            West, south, east and north bounds of the map: eastings and northings in metres. Unit:
            m. Unset: the extent of all points.
        block_m : float, optional
            Side of the blocks to which points are reduced. 0 keeps every point. Unit: m. Allowed: 0
            or above. Unset: a quarter of the distance between lines, at most 200 m.
        mask_m : float, optional
            Nodes farther than this distance from the nearest point are unknown. `inf` sets no
            limit. Unit: m. Unset: twice the distance between lines.
        keep_outliers : bool, optional
            Keeps outliers along a line, and points far from all others. Default: `false`.
        cross_validate : int, optional
            Number n of folds of the cross-validation: every n-th line is omitted in turn and
            predicted from the other lines. Allowed: 2 to 65535. Unset: no cross-validation.
        to_epsg : int, optional
            EPSG code of the map's coordinate system. Allowed: 1 to 65535. Unset: the coordinate
            system of the points, or their UTM zone.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Soler and Uieda 2021, "Gradient-boosted equivalent sources"; Briggs 1974, Smith and Wessel
        1990 (minimum curvature with tension); Luyendyk 1997, "Processing of airborne magnetic data"
        (levelling).
        """
        return self._stage("map_grid", locals())

    def track_map(
        self,
        *,
        input: TableLike,
        track: TableLike | None = None,
        mag: str | Axis | None = None,
        core_field: bool | Axis | None = None,
        decimal_year: float | Axis | None = None,
        remove_diurnal: bool | Axis | None = None,
        interval_s: float | Axis | None = None,
        hyperparameters: Literal["fitted", "fixed"] | Axis | None = None,
        position_sigma_m: float | Axis | None = None,
        covariance: Literal["matern_5_2", "matern_3_2", "squared_exponential"] | Axis | None = None,
        sigma_se_nt: float | Axis | None = None,
        length_m: float | Axis | None = None,
        sigma_n_nt: float | Axis | None = None,
        fogm_sigma_nt: float | Axis | None = None,
        fogm_tau_s: float | Axis | None = None,
        line_sigma_nt: float | Axis | None = None,
        spacing_m: float | Axis | None = None,
        bounds: ListLike | Axis | None = None,
        max_sd_nt: float | Axis | None = None,
        max_functions: int | Axis | None = None,
        to_epsg: int | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Makes a map from the measurements of lines at the positions of their tracks, by
        reduced-rank Gaussian-process regression.

        `sd` is the standard deviation of the map error at each node.

        Use `track_map` to plot and score an anomaly that was measured without a map, and to
        navigate on it. `track` is the table of a `navigate` stage, for example with the filter
        `slam`. The columns `lat`, `lon` and `alt` of `track` are the positions of the measurements
        in `input`. Without `track`, the positions are the flight's own `lat`, `lon` and `alt`, from
        GNSS. If the survey lines require levelling and the removal of outliers, use `map_grid`.

        The anomaly is a Gaussian process, expanded in eigenfunctions of the Laplacian on the area
        of the lines. The number of equations therefore does not depend on the length of the flight.
        Each line may have its own constant, and each flight its own temporal variation. The kernel
        (covariance function) is the same as in `slam`. Its hyper-parameters are fitted by maximum
        likelihood to segments of the lines. The map is at the mean height of the measurements;
        height differences are treated as noise.

        On a sloping map, a position error of the track causes an error of the field. This error is
        computed from the track's covariance (`sd_n`, `sd_e`, `cov_ne`), treated as measurement
        noise, and included in `sd`. A position error common to the whole track shifts the map. The
        measurements do not reveal this shift, so `sd` is only as accurate as the covariance of the
        track. Nodes with an `sd` above `max_sd_nt` are unknown.

        Rows without a position, a standard deviation of the position, a height or a measurement are
        skipped. The stage rejects a track whose samples differ from the samples of the line, a core
        field without a date, and an area that is too large for the kernel length. Divide such an
        area with `bounds`; measurements more than three kernel lengths beyond the bounds are
        skipped.

        Parameters
        ----------
        input : TableLike
            Input: flight lines.
        track : TableLike, optional
            Input: flight lines, optional.
        mag : str, optional
            Column of the measured field. Unit: nT. Default: `"mag_c"`.
        core_field : bool, optional
            Subtracts the core field (IGRF-14) at the position of the track from the measurement.
            `false` means that the measurement is an anomaly. Default: `true`.
        decimal_year : float, optional
            Date of the core field as a decimal year. It replaces the flight's date. Unit: a.
            Allowed: 1900 to 2030. Unset: the flight's own date.
        remove_diurnal : bool, optional
            Subtracts the column `diurnal` from the measurement. A sample with a NaN in `diurnal`
            has no measurement. Unset: true if the flight has a column `diurnal` that has not yet
            been subtracted from the measurement.
        interval_s : float, optional
            Interval over which measurements are averaged. 0 uses every sample. Unit: s. Allowed: 0
            or above. Default: `1.0`.
        hyperparameters : {"fitted", "fixed"}, optional
            Source of the kernel's hyper-parameters: a maximum-likelihood fit to the lines
            (`fitted`), or the spec (`fixed`). Default: `"fitted"`.
        position_sigma_m : float, optional
            Standard deviation, north and east, of a position error that the track's covariance
            omits, such as the error of `slam` before the first revisit. Unit: m. Allowed: 0 or
            above. Default: `0.0`.
        covariance : {"matern_5_2", "matern_3_2", "squared_exponential"}, optional
            Covariance function of the anomaly over distance. Default: `"matern_5_2"`.
        sigma_se_nt : float, optional
            Standard deviation of the anomaly. Unit: nT. Allowed: above 0. Unset: 50 nT.
        length_m : float, optional
            Correlation length of the anomaly; if it is fitted, the initial value of the search.
            Unit: m. Allowed: above 0. Unset: 150 m.
        sigma_n_nt : float, optional
            Standard deviation of the noise of an averaged measurement; if it is fitted, the initial
            value of the search. Unit: nT. Allowed: 0 or above. Unset: 1 nT.
        fogm_sigma_nt : float, optional
            Standard deviation of the temporal variation. 0 assumes no temporal variation. Unit: nT.
            Allowed: 0 or above. Default: `3.0`.
        fogm_tau_s : float, optional
            Time constant of the temporal variation. Unit: s. Allowed: above 0. Default: `600.0`.
        line_sigma_nt : float, optional
            Standard deviation of the constant of each line, if there are several lines. 0 assumes
            no such constants. Unit: nT. Allowed: 0 or above. Default: `3.0`.
        spacing_m : float, optional
            Distance between nodes. Unit: m. Allowed: above 0. Unset: a sixth of the kernel length.
        bounds : ListLike, optional
            West, south, east and north bounds of the map: eastings and northings in metres. Unit:
            m. Unset: the extent of all measurements.
        max_sd_nt : float, optional
            Largest standard deviation of a known node. Nodes with a larger standard deviation are
            unknown. Unit: nT. Allowed: above 0. Unset: a quarter of the standard deviation of the
            anomaly.
        max_functions : int, optional
            Maximum number of functions in the expansion of the anomaly. Computing time grows with
            the third power of this number. Allowed: 1 to 20000. Default: `3000`.
        to_epsg : int, optional
            EPSG code of the map's coordinate system. Allowed: 1 to 65535. Unset: the UTM zone of
            the measurements.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Solin and Särkkä 2020, "Hilbert space methods for reduced-rank Gaussian process regression";
        Viset, Kullberg, Wesel and Solin 2024 (normal equations); McHutchon and Rasmussen 2011
        (input noise).
        """
        return self._stage("track_map", locals())

    def map_fill(
        self,
        *,
        map: TableLike,
        with_: TableLike | Sequence[TableLike] | None = None,
        method: Literal["knn", "harmonic", "minimum_curvature", "none"] | Axis | None = None,
        neighbours: int | Axis | None = None,
        power: float | Axis | None = None,
        within_m: float | Axis | None = None,
        feather_m: float | Axis | None = None,
        bias: Literal["nothing", "constant", "plane"] | Axis | None = None,
        extend: bool | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Fills the unknown nodes of a map, first from other maps in the order of `with`, then from
        the nodes around each gap.

        The other maps are converted to the coordinate system of the map to be filled. Lower maps
        are continued upward to its height. The difference between each of these maps and the map to
        be filled is estimated in the overlap and removed (`bias`). Values filled from the nodes
        around a gap contain no information about the anomaly in the gap. `minimum_curvature` is
        suitable for gaps of a few nodes. No method is suitable for large gaps.

        A map of `with` that is higher than the map to be filled is rejected. A draped map together
        with other maps is also rejected.

        Parameters
        ----------
        map : TableLike
            Input: map.
        with_ : TableLike | Sequence[TableLike], optional
            Input: one or several maps, optional.
        method : {"knn", "harmonic", "minimum_curvature", "none"}, optional
            Method that fills gaps from the nodes around them: `knn`, the mean of the nearest known
            nodes; `harmonic`, a harmonic surface, which stays between the values around the gap;
            `minimum_curvature`, which continues the slope at the gap's edge; or `none`. Default:
            `"knn"`.
        neighbours : int, optional
            Number of nodes in the mean of `knn`. Allowed: above 0. Default: `3`.
        power : float, optional
            Power in the weights 1/distance^`power` of the nodes in the mean. Allowed: above 0.
            Unset: equal weights.
        within_m : float, optional
            Nodes farther than this distance from the nearest known node remain unknown. Unit: m.
            Allowed: above 0. Unset: all nodes are filled.
        feather_m : float, optional
            Width of the transition between two maps at their common edge. Unit: m. Allowed: 0 or
            above. Default: `1000.0`.
        bias : {"nothing", "constant", "plane"}, optional
            Form of the difference that is estimated in the overlap and removed from the other maps:
            a `constant` or a `plane`. `nothing` removes no difference. Default: `"constant"`.
        extend : bool, optional
            Extends the map to the combined extent of all maps. Default: `false`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Briggs 1974 (`minimum_curvature`); Blakely 1996, section 12.1 (upward continuation).
        """
        return self._stage("map_fill", locals())

    def map_continue(
        self,
        *,
        map: TableLike,
        drape: TableLike | None = None,
        to_m: float | Axis | None = None,
        derivative: Literal["up", "north", "east", "up2"] | Axis | None = None,
        alpha_m2: float | Literal["auto"] | Axis | None = None,
        keep_filled: bool | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Continues a map to another height, or differentiates it.

        A level map is continued to another level or to the heights of another map on the same grid
        (`drape`). A draped map is continued to a level.

        Use `map_continue` to bring a map to the flight height, or to bring several maps to one
        height before they are combined. Upward continuation is stable, because it smooths the
        field. Downward continuation amplifies short wavelengths and noise, so it is damped by
        `alpha_m2`. The damping removes part of the signal. Unknown nodes are filled by minimum
        curvature for the transform and are unknown again in the result. The result has errors near
        the map's edges, because the field beyond them is unknown. Keep the change of height below
        1/50 of the map's shorter side, or remove the edges afterwards.

        These are rejected: a map without a known height, a derivative of a draped map, and a
        `drape` that is on another grid or has one height for all nodes.

        Parameters
        ----------
        map : TableLike
            Input: map.
        drape : TableLike, optional
            Input: map, optional.
        to_m : float, optional
            Height above the WGS-84 ellipsoid to which the map is continued. Unit: m. Unset: the
            heights of `drape` if it is given, otherwise the map's own height.
        derivative : {"up", "north", "east", "up2"}, optional
            Derivative that is returned instead of the field, in nT/m (`up2`: second vertical
            derivative, in nT/m2). Unset: the field itself.
        alpha_m2 : float | {"auto"}, optional
            Damping of downward continuation. `auto` uses the corner of the L-curve. Unit: m2.
            Allowed: 0 or above. Default: `auto`.
        keep_filled : bool, optional
            Keeps the result at nodes that are unknown in the input map. Default: `false`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Blakely 1996, sections 12.1 and 12.2; Gnadt 2022, section 2.3 (downward continuation).
        """
        return self._stage("map_continue", locals())

    def map_convert(
        self,
        *,
        map: TableLike,
        to_epsg: int | Axis | None = None,
        spacing: float | Axis | None = None,
        bounds: ListLike | Axis | None = None,
        trim: bool | Axis | None = None,
        expand_nodes: int | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Resamples a map to another coordinate system or spacing, crops it, or extends it
        periodically.

        The operations run in the order of the parameters.

        Use `map_convert` to bring maps onto one grid, or to remove the edges of a continued map.
        Resampling uses polynomials of degree nine, and of lower degree near edges and unknown
        nodes. A node within two nodes of an unknown node becomes unknown. Stages that interpolate a
        map also project the positions, so a map need not be converted for these stages.

        Bounds outside the map are rejected. The periodic extension of a map that is draped or has
        gaps is also rejected.

        Parameters
        ----------
        map : TableLike
            Input: map.
        to_epsg : int, optional
            EPSG code of the coordinate system to which the map is resampled, such as 4326 or 32754.
            Allowed: 1 to 65535. Unset: the map's own coordinate system.
        spacing : float, optional
            Distance between nodes, in the unit of the coordinate system: metres, feet or degrees.
            Allowed: above 0. Unset: a spacing no larger than the spacing of the map.
        bounds : ListLike, optional
            Bounds of the part to keep: west, south, east and north, in the new coordinate system.
            Unset: the whole map.
        trim : bool, optional
            Removes rows and columns without values at the edges. Default: `false`.
        expand_nodes : int, optional
            Extends the map periodically, by at least this number of nodes on each side, to sizes
            without a prime factor above 7. Unset: no periodic extension.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).
        """
        return self._stage("map_convert", locals())

    def map_vector(
        self,
        *,
        map: TableLike,
        component: Literal["north", "east", "down"] | Axis | None = None,
        decimal_year: float | Axis | None = None,
        inclination_deg: float | Axis | None = None,
        declination_deg: float | Axis | None = None,
        keep_filled: bool | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Computes a component of the anomaly field from a map of the total-field anomaly: towards
        true north, towards true east, or down.

        A sweep over `component` gives all three.

        The anomaly is the component of the anomaly field along the core field. Above all sources
        the anomaly field is the gradient of a potential. Let A be the spectrum of the anomaly, f
        the direction of the core field and k the wavenumber. The spectra of the components (east,
        north, up) are then

        B_e = i k_e A/d, B_n = i k_n A/d, B_u = -|k| A/d, with d = i (f_e k_e + f_n k_n) - f_u |k|

        The direction f applies to the centre of the map, and follows from `decimal_year`, or from
        `inclination_deg` and `declination_deg`. On a projected map, grid north is corrected to true
        north.

        |d| is at least |k| sin |I| at the inclination I, so errors of the map are amplified by up
        to 1/sin |I|. Near the magnetic equator, waves whose k is perpendicular to the core field
        are missing from the map. At inclinations below 15 degrees, these waves are damped, the
        components are too small, and a warning is reported. The mean and the trend of a map give no
        information on direction, and are assumed to be parallel to the core field. The field beyond
        the map's edges is unknown; discard a margin of 15 nodes. In the remaining area, components
        of dipoles below the map have errors of 1 % at inclinations of 25 degrees and above, 2 % at
        16 degrees, and 8 to 18 % at 5 degrees. Unknown nodes are filled by minimum curvature for
        the transform and are unknown again in the result.

        The result has the unit nT, but it is not a total-field anomaly: do not navigate with it.
        These are rejected: a draped map, a map of a derivative, and a direction that is missing or
        given twice.

        Parameters
        ----------
        map : TableLike
            Input: map.
        component : {"north", "east", "down"}, optional
            Component of the field. Default: `"down"`.
        decimal_year : float, optional
            Date of the core field (IGRF-14) that gives the direction. Unit: a. Allowed: 1900 to
            2030. Unset: the direction follows from `inclination_deg` and `declination_deg`.
        inclination_deg : float, optional
            Inclination of the core field, downward from the horizontal. Unit: deg. Allowed: -90 to
            90. Unset: the inclination of the core field.
        declination_deg : float, optional
            Declination of the core field, from true north to east. Unit: deg. Allowed: -180 to 180.
            Unset: the declination of the core field.
        keep_filled : bool, optional
            Keeps the result at nodes that are unknown in the input map. Default: `false`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Blakely 1996, section 12.3.1. (MagNav.jl's `vector_fft` counts the declination from east,
        inverts the vertical component, and adds the mean to each component.)
        """
        return self._stage("map_vector", locals())

    def score(
        self,
        *,
        input: TableLike | Sequence[TableLike],
        truth: str | Axis | None = None,
        metrics: Sequence[Literal["std_error", "bias_error", "rms_error", "std_uncompensated",
            "improvement_ratio", "improvement_ratio_band", "snr", "anomaly_retention",
            "anomaly_retention_se", "figure_of_merit", "figure_of_merit_crossings", "drms",
            "drms_bound", "cep", "r95", "rms_north", "rms_east", "rms_down", "mrse", "rms_vn",
            "rms_ve", "rms_vd", "rms_speed", "ins_drms", "nees", "nis", "nees_consistent",
            "nis_consistent", "whiteness", "correlated_nis", "error_within_3sigma", "divergence",
            "samples_used", "samples_missing", "samples_off_map", "samples_gated", "samples_flat",
            "gnss_rejected", "map_height_error", "map_std_error", "map_bias_error",
            "map_gradient_along_track", "map_position_bound"]] | Axis | None = None,
        mag: str | Axis | None = None,
        low_hz: float | Axis | None = None,
        high_hz: float | Axis | None = None,
        order: int | Axis | None = None,
        map_sigma_nt: float | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Scores each line: a compensated signal against the truth, and a track against the true
        positions.

        `input` names one or several tables with the same samples, for example the table of the
        compensated signal and the table of the track. If `metrics` is unset, the stage scores all
        built-in metrics that can be computed from these tables. Each metric is a row with `metric`,
        `value`, `unit` and `n`, the number of samples (for crossings: number of pairs). Samples
        with a NaN are excluded from a metric and from its `n`. A metric without samples has a null
        value. A metric that cannot be computed for a line, for example because `high_hz` exceeds
        half the sample rate, has a null value and the reason in `note`. The other metrics are kept.
        The run reports a warning; if `metrics` lists the metric, the run fails.

        The published table also has `in_sample`. It is true if the line was used to fit the model,
        estimate the noise or make the map on which the score depends, or to choose a parameter in a
        search. Such a score measures the error of the fit, not of a prediction, and is never
        selected as the best of a sweep. The noise that `navigate` estimates on the navigated line
        does not put the line in sample, because the estimate uses no truth data. Models read from
        files are assumed to be fitted to other lines.

        The table `scores_pooled` of the pipeline has one row per point and metric. Its `value`
        pools the lines that are not in sample (all lines if every line is in sample), and
        `value_in_sample` pools the others. For a radius (`cep`, `r95`), `spread` holds quantiles of
        the samples' errors, from which the pooled radius is computed.

        With `truth`, errors are relative to the truth. Without `truth`, `std_uncompensated` and the
        improvement ratios are computed from the signals alone and include the anomaly. The run then
        lists the metrics that require `truth`.

        An input table computed by `map_value` adds metrics of the map: the agreement of the signal
        with the map, the slope of the map along the track, and the expected accuracy of navigation.
        `igrf` and, if available, `diurnal` are first subtracted from the signal.
        `map_position_bound` is the Cramér-Rao bound on a constant horizontal position offset when
        the measurement also contains an unknown constant. It assumes independent sample errors of
        `map_sigma_nt`. Correlated errors, such as errors of the map and the temporal variation,
        make the actual position error larger than the bound.

        A track is also tested against its own covariance: `nees_consistent` and `nis_consistent`
        are tests with a 95 % band. `whiteness` is a fraction of lags; `error_within_3sigma` and
        `divergence` are fractions of samples. The expected values of these metrics for a consistent
        filter are known. The innovations before and after a sample without a measurement do not
        count as consecutive. `correlated_nis` is the NIS of averages of many innovations, which
        shows whether correlated innovations make the covariance too small.

        Parameters
        ----------
        input : TableLike | Sequence[TableLike]
            Input: one or several tables of flight lines.
        truth : str, optional
            Column of the true signal, such as `mag_1_c`. Unit: nT. Unset: metrics that require the
            truth are not scored.
        metrics : Sequence[{"std_error", "bias_error", "rms_error", "std_uncompensated",
        "improvement_ratio", "improvement_ratio_band", "snr", "anomaly_retention",
        "anomaly_retention_se", "figure_of_merit", "figure_of_merit_crossings", "drms",
        "drms_bound", "cep", "r95", "rms_north", "rms_east", "rms_down", "mrse", "rms_vn", "rms_ve",
        "rms_vd", "rms_speed", "ins_drms", "nees", "nis", "nees_consistent", "nis_consistent",
        "whiteness", "correlated_nis", "error_within_3sigma", "divergence", "samples_used",
        "samples_missing", "samples_off_map", "samples_gated", "samples_flat", "gnss_rejected",
        "map_height_error", "map_std_error", "map_bias_error", "map_gradient_along_track",
        "map_position_bound"}], optional
            Metrics to score. Unset: all built-in metrics that can be computed from the inputs.
        mag : str, optional
            Column of the compensated signal. Unit: nT. Default: `"mag_c"`.
        low_hz : float, optional
            Lower corner frequency for `improvement_ratio_band` and `figure_of_merit`. Unit: Hz.
            Allowed: 0 or above. Default: `0.1`.
        high_hz : float, optional
            Upper corner frequency for `improvement_ratio_band` and `figure_of_merit`. Unit: Hz.
            Allowed: 0 or above. Default: `0.9`.
        order : int, optional
            Order of the band-pass filter for `improvement_ratio_band` and `figure_of_merit`.
            Allowed: 1 to 12. Default: `4`.
        map_sigma_nt : float, optional
            Standard deviation of the error of a sample, for `map_position_bound`. Unit: nT.
            Allowed: above 0. Default: `5.0`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        Gnadt 2022, (3.45), (3.46); Lee 2019, (66); van der Meer 2025, (2.39) to (2.41); Bar-Shalom,
        Li & Kirubarajan 2001, section 5.4; Mehra 1970.
        """
        return self._stage("score", locals())

    def summary(
        self,
        *,
        input: TableLike,
        metrics: Sequence[Literal["std_error", "bias_error", "rms_error", "std_uncompensated",
            "improvement_ratio", "improvement_ratio_band", "snr", "anomaly_retention",
            "anomaly_retention_se", "figure_of_merit", "figure_of_merit_crossings", "drms",
            "drms_bound", "cep", "r95", "rms_north", "rms_east", "rms_down", "mrse", "rms_vn",
            "rms_ve", "rms_vd", "rms_speed", "ins_drms", "nees", "nis", "nees_consistent",
            "nis_consistent", "whiteness", "correlated_nis", "error_within_3sigma", "divergence",
            "samples_used", "samples_missing", "samples_off_map", "samples_gated", "samples_flat",
            "gnss_rejected", "map_height_error", "map_std_error", "map_bias_error",
            "map_gradient_along_track", "map_position_bound"]] | Axis | None = None,
        train: ListLike | Axis | None = None,
        level: float | Axis | None = None,
        draws: int | Axis | None = None,
        seed: int | Axis | None = None,
        name: str | None = None,
        where: str | None = None,
        publish: bool | None = None,
        carry: Sequence[str] | None = None,
        keep: bool | None = None,
    ) -> TableHandle:
        """Pools the scores of lines, with a confidence interval for each pooled value.

        Errors are pooled as root mean squares; ratios and biases are pooled as means. Both are
        weighted by the number of samples. `cep` and `r95` are computed from the samples of all
        lines. Sample counts are added. The bounds of the interval are percentiles over `draws`
        resamples of the lines, drawn with replacement. Whole lines are resampled because the errors
        within a line are correlated. A single line has no interval (null).

        Each metric is pooled over the lines that are not in sample. If none of these lines has a
        value, the metric is pooled over the in-sample lines, and `in_sample` is true. A line is in
        sample if its scores depend on a model, a noise estimate or a map that was made from this
        line, or on a parameter that a search chose with it. The table `scores_pooled` also pools
        the in-sample lines if other lines exist.

        `train` lists the lines to which the model was fitted, and adds the metric
        `overfitting_ratio`. This ratio is the pooled `std_error` of all other lines, in sample or
        not, divided by the pooled `std_error` of the training lines. Without `std_error`, the ratio
        is computed from `map_std_error`. The ratio is 1 for a model that is as accurate on new
        lines as on its training lines, and larger for one that overfits. For its interval, training
        lines and other lines are resampled separately.

        Parameters
        ----------
        input : TableLike
            Input: a table of scores.
        metrics : Sequence[{"std_error", "bias_error", "rms_error", "std_uncompensated",
        "improvement_ratio", "improvement_ratio_band", "snr", "anomaly_retention",
        "anomaly_retention_se", "figure_of_merit", "figure_of_merit_crossings", "drms",
        "drms_bound", "cep", "r95", "rms_north", "rms_east", "rms_down", "mrse", "rms_vn", "rms_ve",
        "rms_vd", "rms_speed", "ins_drms", "nees", "nis", "nees_consistent", "nis_consistent",
        "whiteness", "correlated_nis", "error_within_3sigma", "divergence", "samples_used",
        "samples_missing", "samples_off_map", "samples_gated", "samples_flat", "gnss_rejected",
        "map_height_error", "map_std_error", "map_bias_error", "map_gradient_along_track",
        "map_position_bound"}], optional
            Metrics to pool. Unset: all scored metrics.
        train : ListLike, optional
            Lines to which the model was fitted, for `overfitting_ratio`. Default: `[]`.
        level : float, optional
            Confidence level of the interval. Allowed: 0.5 to 0.999. Default: `0.95`.
        draws : int, optional
            Number of resamples. Allowed: 10 to 100000. Default: `1000`.
        seed : int, optional
            Seed for the resamples. Default: `0`.
        name : str, optional
            The name of the table that the stage makes. Default: the kind of the stage, with a
            number if that name is taken.
        where : str, optional
            An SQL predicate that selects the input rows, such as `line = '1003.02'`. If the stage
            processes each line separately, the predicate may contain only the columns `flight` and
            `line`.
        publish : bool, optional
            `false`: the table is not published, but later stages can read it (default: `true`).
        carry : Sequence[str], optional
            Columns that pass through the stage unchanged into its published table, such as `["lat",
            "lon"]`; only for tables of flight lines (default: none).
        keep : bool, optional
            `false`: results are not stored, but recomputed when required; only for tables of flight
            lines with `publish = false` (default: `true`).

        References
        ----------
        van der Meer 2025, (4.9); Efron & Tibshirani 1993, chapter 13.
        """
        return self._stage("summary", locals())
