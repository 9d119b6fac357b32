"""Navigation filters fed sample by sample, for programs that run during a flight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magline import _magline
from magline._arrays import column, matrix

__all__ = ["Estimate", "FilterStream", "Fix", "adaptive", "ekf", "online"]


@dataclass(frozen=True)
class Estimate:
    """Estimate after the measurements of a sample.

    Attributes
    ----------
    tt_s : float
        Time of the sample, s.
    lat_deg, lon_deg, alt_m : float
        Latitude, longitude (degrees) and height above the WGS-84 ellipsoid (m).
    vn_mps, ve_mps, vd_mps : float
        Velocity north, east and down, m/s.
    sd_n_m, sd_e_m : float
        Standard deviations of the position north and east, m.
    cov_ne_m2 : float
        Covariance of north with east, m^2.
    residual_nt : float
        Measurement minus prediction, nT; NaN without an update.
    nis : float
        Squared residual divided by its predicted variance; NaN without an update.

    Examples
    --------
    >>> from magline import stream
    >>> map = ([44.9, 45.1], [-76.1, -75.9], [[0.0, 0.0], [900.0, 900.0]])
    >>> filter = stream.ekf(map, errors={"init_position_sigma_m": 100.0})
    >>> at_rest = [45.0, -76.0, 300.0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.80665, 0.0, 0.0, 0.0]
    >>> estimate = filter.push([0.0, *at_rest], 452.0, 1.0)
    >>> round(estimate.residual_nt, 3)
    2.0
    >>> estimate.sd_n_m < estimate.sd_e_m
    True
    """

    tt_s: float
    lat_deg: float
    lon_deg: float
    alt_m: float
    vn_mps: float
    ve_mps: float
    vd_mps: float
    sd_n_m: float
    sd_e_m: float
    cov_ne_m2: float
    residual_nt: float
    nis: float


@dataclass(frozen=True)
class Fix:
    """Aiding position of a sample. A coordinate that is NaN is missing.

    Attributes
    ----------
    lat_deg, lon_deg, alt_m : float
        Latitude, longitude (degrees) and height above the WGS-84 ellipsoid (m).
    horizontal_sigma_m, vertical_sigma_m : float
        Standard deviations of each horizontal coordinate and of the height, m.

    Examples
    --------
    >>> from magline import stream
    >>> map = ([44.9, 45.1], [-76.1, -75.9], [[0.0, 0.0], [900.0, 900.0]])
    >>> filter = stream.ekf(map, errors={"init_position_sigma_m": 100.0})
    >>> at_rest = [45.0, -76.0, 300.0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.80665, 0.0, 0.0, 0.0]
    >>> fix = stream.Fix(45.0, -76.0, 300.0, horizontal_sigma_m=3.0, vertical_sigma_m=5.0)
    >>> estimate = filter.push([0.0, *at_rest], float("nan"), 1.0, fix=fix)
    >>> round(estimate.sd_n_m), round(estimate.sd_e_m)
    (3, 3)
    """

    lat_deg: float
    lon_deg: float
    alt_m: float
    horizontal_sigma_m: float
    vertical_sigma_m: float


class FilterStream:
    """Filter that takes one sample at a time; created by `ekf`, `adaptive` and `online`.

    Examples
    --------
    >>> from magline import stream
    >>> map = ([44.9, 45.1], [-76.1, -75.9], [[0.0, 0.0], [900.0, 900.0]])
    >>> first, second = stream.ekf(map), stream.ekf(map)
    >>> at_rest = [45.0, -76.0, 300.0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.80665, 0.0, 0.0, 0.0]
    >>> estimate = first.push([0.0, *at_rest], 452.0, 1.0)
    >>> second.restore(first.save())
    >>> first.push([0.1, *at_rest], 452.0, 1.0) == second.push([0.1, *at_rest], 452.0, 1.0)
    True
    """

    def __init__(self, filter: _magline.FilterStream) -> None:
        self._filter = filter

    def push(
        self,
        ins: Sequence[float],
        measurement_nt: float | Sequence[float],
        sigma_nt: float | Sequence[float],
        *,
        terms: Sequence[float] = (),
        fix: Fix | None = None,
    ) -> Estimate:
        """Filter a sample.

        Parameters
        ----------
        ins : sequence of 13 floats
            Time (s), latitude, longitude (degrees), height (m), velocity north, east, down (m/s),
            specific force north, east, down (m/s^2), roll, pitch and yaw (degrees).
        measurement_nt : float or sequence
            Field of each magnetometer, nT; NaN if missing.
        sigma_nt : float or sequence
            Standard deviation of the white noise of each measurement, nT.
        terms : sequence, optional
            Terms of each magnetometer in turn, for `online`.
        fix : Fix, optional
            Aiding position.

        Returns
        -------
        Estimate

        Raises
        ------
        ValueError
            If the sample is late, a duplicate, or too long after the last one, if a value of the INS is not finite, or
            if the number of values is wrong. The filter is then unchanged. A filter that diverges also raises this
            error, and is then stopped.
        """
        values = [float(value) for value in ins]
        nt, sigma = np.atleast_1d(measurement_nt).tolist(), np.atleast_1d(sigma_nt).tolist()
        at = None
        if fix is not None:
            position = [fix.lat_deg, fix.lon_deg, fix.alt_m]
            at = [*position, fix.horizontal_sigma_m, fix.vertical_sigma_m]
        return Estimate(*self._filter.push(values, nt, sigma, [float(term) for term in terms], at))

    @property
    def coefficients(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Coefficients of all magnetometers and their standard deviations; empty without any."""
        values, sigma = self._filter.coefficients()
        return np.array(values), np.array(sigma)

    def save(self) -> bytes:
        """State of the filter, for `restore`."""
        return self._filter.save()

    def restore(self, state: bytes) -> None:
        """Resume from a state of a filter with the same map and parameters.

        Raises
        ------
        ValueError
            If the state is damaged, or belongs to another filter, map or core field. The filter is
            then unchanged.
        """
        self._filter.restore(state)


Map = tuple[ArrayLike, ArrayLike, ArrayLike]


def ekf(
    map: Map,
    *,
    decimal_year: float | None = None,
    errors: Mapping[str, float] | None = None,
    max_gap_s: float = 10.0,
    gate_nis: float | None = None,
) -> FilterStream:
    """Extended Kalman filter for a compensated magnetometer, fed sample by sample.

    The results are bit-identical to those of the filter ``ekf`` on the whole line.

    Parameters
    ----------
    map : (array_like, array_like, array_like)
        Latitudes of the rows and longitudes of the columns, degrees, ascending, and the anomaly, nT,
        of shape (rows, columns). It is interpolated by cubic splines.
    decimal_year : float, optional
        Date of the core field, if the measurements contain it. Default: they do not.
    errors : mapping, optional
        Error sources of the INS and the temporal variation, such as ``init_position_sigma_m`` or
        ``fogm_sigma_nt``. Default: a navigation-grade INS, as in ``navigate``.
    max_gap_s : float, optional
        Longest step between two samples, s. Default: 10.
    gate_nis : float, optional
        Largest NIS of a measurement; a larger one is rejected. Default: none is rejected.

    Returns
    -------
    FilterStream

    Raises
    ------
    ValueError
        If the map or a parameter is invalid.

    References
    ----------
    A. R. Gnadt, Advanced Aeromagnetic Compensation Models, 2022, section 5.3

    Examples
    --------
    >>> import numpy as np
    >>> from magline import stream
    >>> lat, lon = np.linspace(44.9, 45.1, 21), np.linspace(-76.1, -75.9, 21)
    >>> anomaly = 5000.0 * (lat[:, None] - 45.0) + 0.0 * lon
    >>> filter = stream.ekf((lat, lon, anomaly), errors={"init_position_sigma_m": 100.0})
    >>> at_rest = [45.0, -76.0, 300.0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.80665, 0.0, 0.0, 0.0]
    >>> for k in range(10):
    ...     estimate = filter.push([0.1 * k, *at_rest], 2.0, 1.0)
    >>> estimate.lat_deg > 45.0
    True
    """
    setup = _setup(map, decimal_year, errors, max_gap_s)
    return FilterStream(_magline.FilterStream.ekf(setup, gate_nis))


def adaptive(
    map: Map,
    bounds_nt: Sequence[tuple[float, float]],
    *,
    window: int = 50,
    decimal_year: float | None = None,
    errors: Mapping[str, float] | None = None,
    max_gap_s: float = 10.0,
    gate_nis: float | None = None,
) -> FilterStream:
    """Filter ``ekf_adaptive``, fed sample by sample. It estimates the noise of the measurements.

    ``bounds_nt`` holds the lower and upper bounds on the noise of each magnetometer, nT, and ``window`` is the number
    of innovations in the estimate. `ekf` describes the other parameters and the errors.

    Examples
    --------
    >>> from magline import stream
    >>> map = ([44.9, 45.1], [-76.1, -75.9], [[0.0, 0.0], [900.0, 900.0]])
    >>> filter = stream.adaptive(map, [(0.5, 20.0)], window=20)
    >>> at_rest = [45.0, -76.0, 300.0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.80665, 0.0, 0.0, 0.0]
    >>> estimate = filter.push([0.0, *at_rest], 452.0, 1.0)
    >>> round(estimate.residual_nt, 3)
    2.0
    """
    bounds = [(float(low), float(high)) for low, high in bounds_nt]
    setup = _setup(map, decimal_year, errors, max_gap_s)
    return FilterStream(_magline.FilterStream.adaptive(setup, gate_nis, bounds, window))


def online(
    map: Map,
    magnetometers: Sequence[tuple[ArrayLike, ArrayLike, ArrayLike]],
    *,
    decimal_year: float | None = None,
    errors: Mapping[str, float] | None = None,
    max_gap_s: float = 10.0,
    gate_nis: float | None = None,
) -> FilterStream:
    """Filter ``ekf_online_tl``, fed sample by sample. It estimates the aircraft's field in flight.

    ``magnetometers`` holds, for each uncompensated magnetometer, the mean and the standard deviation of the prior of
    its coefficients, and the spectral density of their random walk (per second). `ekf` describes the other parameters
    and the errors. Each sample requires the terms of all magnetometers.

    Examples
    --------
    >>> import numpy as np
    >>> from magline import stream
    >>> map = ([44.9, 45.1], [-76.1, -75.9], [[0.0, 0.0], [900.0, 900.0]])
    >>> prior = (np.zeros(2), np.full(2, 10.0), np.full(2, 1e-4))
    >>> filter = stream.online(map, [prior])
    >>> at_rest = [45.0, -76.0, 300.0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.80665, 0.0, 0.0, 0.0]
    >>> estimate = filter.push([0.0, *at_rest], 456.0, 1.0, terms=[1.0, 0.0])
    >>> values, sigma = filter.coefficients
    >>> bool(values[0] > 0.0), bool(sigma[0] < 10.0)
    (True, True)
    """
    priors = [
        (column(mean).tolist(), column(sigma).tolist(), column(walk).tolist())
        for mean, sigma, walk in magnetometers
    ]
    setup = _setup(map, decimal_year, errors, max_gap_s)
    return FilterStream(_magline.FilterStream.online(setup, gate_nis, priors))


def _setup(
    map: Map, decimal_year: float | None, errors: Mapping[str, float] | None, max_gap_s: float
) -> tuple[
    NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], float | None, dict[str, float], float
]:
    lat_deg, lon_deg, anomaly_nt = map
    grid, lat, lon = matrix(anomaly_nt), column(lat_deg), column(lon_deg)
    if grid.shape != (lat.size, lon.size):
        raise ValueError(f"the anomaly must have the shape {(lat.size, lon.size)}, not {grid.shape}")
    return lat, lon, grid, decimal_year, dict(errors or {}), max_gap_s
