"""Metrics of position errors and of compensated signals.

Samples with values that are not finite are excluded. The result is NaN if no samples remain. `position_nees` has one
result per sample and excludes none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magline import _magline
from magline._arrays import column, columns

__all__ = [
    "cep",
    "drms",
    "improvement_ratio",
    "position_nees",
    "r95",
    "rms",
    "signal_to_noise",
    "std",
]


def drms(north_m: ArrayLike, east_m: ArrayLike) -> float:
    """Distance root mean square (DRMS): square root of the mean of north^2 + east^2.

    Parameters
    ----------
    north_m, east_m : array_like, shape (samples,)
        Horizontal position errors: estimate minus truth, m.

    Returns
    -------
    float
        DRMS, m.

    Raises
    ------
    ValueError
        If the lengths differ.

    Examples
    --------
    >>> from magline.metrics import drms
    >>> drms([3.0, 3.0], [4.0, 4.0])
    5.0
    """
    north, east = columns(north_m=north_m, east_m=east_m)
    return _magline.drms(north, east)


def cep(north_m: ArrayLike, east_m: ArrayLike) -> float:
    """Circular error probable (CEP): radius about the truth that contains 50 % of the samples.

    Parameters
    ----------
    north_m, east_m : array_like, shape (samples,)
        Horizontal position errors: estimate minus truth, m.

    Returns
    -------
    float
        CEP, m, interpolated linearly between order statistics.

    Raises
    ------
    ValueError
        If the lengths differ.

    Examples
    --------
    >>> from magline.metrics import cep
    >>> cep([0.0, 0.0, 0.0], [1.0, 2.0, 9.0])
    2.0
    """
    north, east = columns(north_m=north_m, east_m=east_m)
    return _magline.radius(north, east, 0.5)


def r95(north_m: ArrayLike, east_m: ArrayLike) -> float:
    """Radius about the truth that contains 95 % of the samples.

    `cep` describes the parameters, the result (m) and the errors.

    Examples
    --------
    >>> from magline.metrics import r95
    >>> r95([0.0, 0.0], [1.0, 1.0])
    1.0
    """
    north, east = columns(north_m=north_m, east_m=east_m)
    return _magline.radius(north, east, 0.95)


def rms(x: ArrayLike) -> float:
    """Root mean square, including the mean.

    Parameters
    ----------
    x : array_like, shape (samples,)
        Signal, in any unit.

    Returns
    -------
    float
        Root mean square, in the unit of ``x``.

    Examples
    --------
    >>> from magline.metrics import rms
    >>> rms([3.0, -3.0])
    3.0
    """
    return _magline.rms(column(x))


def std(x: ArrayLike) -> float:
    """Sample standard deviation, with the divisor n - 1.

    Parameters
    ----------
    x : array_like, shape (samples,)
        Signal, in any unit.

    Returns
    -------
    float
        Standard deviation, in the unit of ``x``; NaN for fewer than two samples.

    Examples
    --------
    >>> from magline.metrics import std
    >>> std([1.0, 2.0, 3.0])
    1.0
    """
    return _magline.std(column(x))


def improvement_ratio(uncompensated: ArrayLike, compensated: ArrayLike) -> float:
    """Improvement ratio of compensation: std(uncompensated) / std(compensated).

    Parameters
    ----------
    uncompensated, compensated : array_like, shape (samples,)
        Signals in the same unit, usually band-passed. If a truth is known, subtract it from both.

    Returns
    -------
    float
        Improvement ratio, dimensionless; above 1 if compensation reduces the signal.

    Raises
    ------
    ValueError
        If the lengths differ.

    References
    ----------
    F. van der Meer, MS thesis, TU Delft, 2025, eq. 2.40

    Examples
    --------
    >>> from magline.metrics import improvement_ratio
    >>> improvement_ratio([0.0, 10.0], [0.0, 1.0])
    10.0
    """
    before, after = columns(uncompensated=uncompensated, compensated=compensated)
    return _magline.improvement_ratio(before, after)


def signal_to_noise(estimate: ArrayLike, truth: ArrayLike, anomaly: ArrayLike) -> float:
    """Signal-to-noise ratio: std(anomaly) / std(estimate - truth).

    Parameters
    ----------
    estimate, truth : array_like, shape (samples,)
        Compensated and true total field, nT.
    anomaly : array_like, shape (samples,)
        Truth minus the core field and minus the temporal variation, nT.

    Returns
    -------
    float
        Signal-to-noise ratio, dimensionless (not dB).

    Raises
    ------
    ValueError
        If the lengths differ.

    References
    ----------
    A. Gnadt, PhD thesis, MIT, 2022, eq. 3.46

    Examples
    --------
    >>> from magline.metrics import signal_to_noise
    >>> signal_to_noise([1.0, 0.0], [0.0, 0.0], [0.0, 5.0])
    5.0
    """
    one, other, signal = columns(estimate=estimate, truth=truth, anomaly=anomaly)
    return _magline.signal_to_noise(one, other, signal)


def position_nees(
    north_m: ArrayLike,
    east_m: ArrayLike,
    sd_n_m: ArrayLike,
    sd_e_m: ArrayLike,
    cov_ne_m2: ArrayLike,
) -> NDArray[np.float64]:
    """Normalised estimation error squared (NEES) of the horizontal position, at each sample.

    The expected value is 2 for a consistent filter.

    Parameters
    ----------
    north_m, east_m : array_like, shape (samples,)
        Horizontal position errors: estimate minus truth, m.
    sd_n_m, sd_e_m : array_like, shape (samples,)
        Standard deviations of the north and east errors, m, as estimated by the filter.
    cov_ne_m2 : array_like, shape (samples,)
        Covariance of the north and east errors, m^2, as estimated by the filter.

    Returns
    -------
    numpy.ndarray, shape (samples,)
        NEES, dimensionless. NaN where an argument is NaN.

    Raises
    ------
    ValueError
        If the lengths differ.

    References
    ----------
    Y. Bar-Shalom, X. R. Li and T. Kirubarajan, Estimation with Applications to Tracking and
    Navigation, 2001, section 5.4

    Examples
    --------
    >>> from magline.metrics import position_nees
    >>> position_nees([1.0], [1.0], [1.0], [1.0], [0.0]).tolist()
    [2.0]
    """
    n, e, sd_n, sd_e, cov = columns(
        north_m=north_m, east_m=east_m, sd_n_m=sd_n_m, sd_e_m=sd_e_m, cov_ne_m2=cov_ne_m2
    )
    return _magline.position_nees(n, e, sd_n, sd_e, cov)
