"""The Tolles-Lawson model of the aircraft field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magline import _magline
from magline._arrays import column, columns, matrix

__all__ = ["Fit", "a_matrix", "compensate", "fit", "predict", "term_names"]

_TERMS = ("permanent", "induced", "eddy")


@dataclass(frozen=True)
class Fit:
    """Fitted Tolles-Lawson coefficients and diagnostics of the fit.

    Attributes
    ----------
    coefficients : numpy.ndarray, shape (terms,)
        Coefficient of each column. For a target in nT, the unit is nT; for derivative terms it is
        samples.
    residual_std : float
        Standard deviation of the residual, in the unit of the target. The divisor is the number of
        rows minus the effective number of parameters. With ``rate_hz``, the residual is
        band-passed.
    condition : float
        Condition number: ratio of the largest to the smallest singular value of A. With
        ``rate_hz``, A is band-passed.
    rows : int
        Number of rows in the fit, after exclusions and trimming.
    lambda_ : float
        Ridge parameter, as passed to `fit`.

    Examples
    --------
    >>> import numpy as np
    >>> from magline import tolles_lawson
    >>> a = np.random.default_rng(1).normal(size=(200, 3))
    >>> fit = tolles_lawson.fit(a, a @ [3.0, -2.0, 1.0])
    >>> np.round(fit.coefficients, 1).tolist()
    [3.0, -2.0, 1.0]
    >>> fit.rows, fit.lambda_
    (200, 0.025)
    """

    coefficients: NDArray[np.float64]
    residual_std: float
    condition: float
    rows: int
    lambda_: float


def term_names(terms: Sequence[str] = _TERMS) -> list[str]:
    """Names of the columns of `a_matrix`, in their order.

    Parameters
    ----------
    terms : sequence of str, optional
        Groups of terms, as for `a_matrix`. Default: permanent, induced, eddy (18 terms).

    Returns
    -------
    list of str
        One name per term, such as ``x``, ``xy`` or ``xy_dot``.

    Raises
    ------
    ValueError
        If a group is unknown, two groups are alternatives, such as ``eddy`` and ``eddy8``, or
        there is no group.

    Examples
    --------
    >>> from magline.tolles_lawson import term_names
    >>> len(term_names())
    18
    """
    return _magline.term_names(list(terms))


def a_matrix(
    flux: ArrayLike,
    rate_hz: float | None = None,
    *,
    terms: Sequence[str] = _TERMS,
    scalar: ArrayLike | None = None,
    tt: ArrayLike | None = None,
    bt_scale_nt: float = 50_000.0,
) -> NDArray[np.float64]:
    """A-matrix: the Tolles-Lawson terms, one row per sample and one column per term.

    B is the field vector, Bt its magnitude (or ``scalar``), and s is ``bt_scale_nt``, all in nT.
    dB is the central difference of B, nT per sample, and one-sided at the ends of a run. A run is
    a sequence of finite samples without a gap in ``tt``. The terms are:

    - permanent: B_i / Bt
    - induced: B_i B_j / (Bt s)
    - eddy: B_i dB_j / (Bt s)
    - derivative: dB_i, nT per sample
    - bias: 1

    The other terms are dimensionless. With ``tt``, the result is bit-identical to the result of
    the stage ``a_matrix``.

    Parameters
    ----------
    flux : array_like, shape (samples, 3)
        Vector magnetometer in the body frame (nose, right wing, down), nT.
    rate_hz : float, optional
        Sample rate, Hz. It only serves as a check: if ``tt`` is given, the rates must agree within 1 %. The matrix does
        not depend on the rate, because dB is per sample. Apply coefficients of eddy and derivative terms only to data
        with the same sample rate. Default: no check.
    terms : sequence of str, optional
        Groups of terms. ``permanent`` has 3 terms, ``induced`` 6, ``eddy`` 9, ``derivative`` 3 and
        ``bias`` 1. ``induced5`` and ``eddy8`` omit the term zz; ``induced3`` and ``eddy3`` have
        only the diagonal. The columns are always in the order permanent, induced, eddy, derivative,
        bias. Default: permanent, induced, eddy (18 terms).
    scalar : array_like, shape (samples,), optional
        Scalar magnetometer, nT, that replaces the magnitude of the vector as Bt. Default: the
        magnitude of the vector.
    tt : array_like, shape (samples,), optional
        Times, s, strictly increasing. A step of at least 1.5 median steps is a gap, and differences
        do not cross it. Any other step must equal the median step within 1 %. Default: no gaps.
    bt_scale_nt : float, optional
        Scale s of induced and eddy terms, nT. Default: 50 000.

    Returns
    -------
    numpy.ndarray, shape (samples, terms)
        A-matrix. A sample whose vector is not finite is NaN in all terms except the bias. A term is
        also NaN if its Bt is 0 or not finite, or if its difference is in a run of one sample.

    Raises
    ------
    ValueError
        If lengths differ, times are uneven, ``rate_hz`` contradicts ``tt``, or the scale is not
        positive. Groups are checked as in `term_names`.

    References
    ----------
    W. E. Tolles and J. D. Lawson, 1950; A. Gnadt, PhD thesis, MIT, 2022, eqs. 3.13 to 3.20

    Examples
    --------
    >>> import numpy as np
    >>> from magline.tolles_lawson import a_matrix
    >>> t = np.linspace(0.0, 10.0, 101)
    >>> flux = np.column_stack([30e3 * np.cos(t), 30e3 * np.sin(t), np.full(101, 40e3)])
    >>> a_matrix(flux, 10.0).shape
    (101, 18)
    """
    vector = np.asarray(flux, dtype=np.float64)
    if vector.ndim != 2 or vector.shape[1] != 3:
        raise ValueError(f"`flux` must have the shape (samples, 3), not {vector.shape}")
    x, y, z = (column(vector[:, axis]) for axis in range(3))
    bt = None if scalar is None else column(scalar)
    return _magline.a_matrix(x, y, z, list(terms), bt, _times(tt, rate_hz), bt_scale_nt)


def _times(tt: ArrayLike | None, rate_hz: float | None) -> NDArray[np.float64] | None:
    """Times as an array, if their rate agrees with ``rate_hz`` within 1 %."""
    times = None if tt is None else column(tt)
    if rate_hz is not None and times is not None and times.size > 1:
        found = 1.0 / float(np.median(np.diff(times)))
        if not abs(found / rate_hz - 1.0) < 0.01:
            raise ValueError(f"`rate_hz` is {rate_hz} Hz, but the times in `tt` have a rate of {found:.6g} Hz")
    return times


def fit(
    a: ArrayLike,
    y: ArrayLike,
    rate_hz: float | None = None,
    *,
    tt: ArrayLike | None = None,
    lambda_: float = 0.025,
    low_hz: float | None = 0.1,
    high_hz: float | None = 0.9,
    order: int = 4,
    trim: int = 20,
) -> Fit:
    """Ridge fit of the coefficients b: minimises |y - A b|^2 + lambda |b|^2.

    Columns are not scaled, and no intercept is added. With ``rate_hz``, the columns of A and y are
    first filtered as by `magline.signal.bandpass`. A constant column, such as the bias, is not
    filtered. For one line, with ``tt``, the coefficients are then bit-identical to the coefficients
    of the stage ``fit`` with the model ``tolles_lawson``.

    A run is a sequence of finite rows without a gap in ``tt``. The coefficients of the eddy terms hold for the sample
    rate of ``a``, because these terms contain changes per sample: compensate only data with the same rate.

    Parameters
    ----------
    a : array_like, shape (samples, terms)
        A-matrix. A row with a value that is not finite, here or in ``y``, is excluded and ends a
        run.
    y : array_like, shape (samples,)
        Target, such as a scalar magnetometer, nT.
    rate_hz : float, optional
        Sample rate, Hz. Default: neither filter nor trimming.
    tt : array_like, shape (samples,), optional
        Times, s, ascending, at which the filter detects gaps. Default: no gaps.
    lambda_ : float, optional
        Ridge parameter lambda, 0 or more; 0 is ordinary least squares. Default: 0.025.
    low_hz, high_hz : float or None, optional
        Lower and upper corner frequency of the filter, Hz; None omits a corner. Unused without
        ``rate_hz``. Default: 0.1 and 0.9.
    order : int, optional
        Order of the Butterworth prototype, 1 to 12. Unused without ``rate_hz``. Default: 4.
    trim : int, optional
        Number of samples removed at each end of each filtered run. Runs that are too short for the
        filter or for trimming are excluded. Unused without ``rate_hz``. Default: 20.

    Returns
    -------
    Fit
        Coefficients, residual and condition number.

    Raises
    ------
    ValueError
        If lengths differ, times are uneven, ``rate_hz`` contradicts ``tt``, no rows remain, or
        ``lambda_`` is negative. Linearly dependent columns
        are an error if ``lambda_`` is 0. The corners and the order are checked as in
        `magline.signal.bandpass`.

    References
    ----------
    A. Gnadt, PhD thesis, MIT, 2022, eqs. 3.19 to 3.43

    Examples
    --------
    >>> import numpy as np
    >>> from magline.tolles_lawson import fit
    >>> a = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    >>> fit(a, a @ [2.0, 3.0], lambda_=0.0).coefficients.round(9).tolist()
    [2.0, 3.0]
    """
    band: dict[str, float | None] | None = None
    if rate_hz is not None:
        band = {"rate_hz": rate_hz, "low_hz": low_hz, "high_hz": high_hz, "order": order, "trim": trim}
    times = _times(tt, rate_hz)
    found = _magline.fit(matrix(a), column(y), lambda_, band, times)
    coefficients, residual_std, condition, rows = found
    return Fit(coefficients, residual_std, condition, rows, lambda_)


def predict(a: ArrayLike, coefficients: ArrayLike, *, detrend: bool = False) -> NDArray[np.float64]:
    """Predicted aircraft field, A b.

    Parameters
    ----------
    a : array_like, shape (samples, terms)
        A-matrix, with the groups of terms and the scale of the fit.
    coefficients : array_like, shape (terms,)
        Coefficients b, such as ``Fit.coefficients``.
    detrend : bool, optional
        True subtracts the mean of the prediction over all samples; no slope is removed. Default:
        False.

    Returns
    -------
    numpy.ndarray, shape (samples,)
        Aircraft field in the unit of the target of the fit, usually nT. NaN where a row of ``a``
        contains NaN.

    Raises
    ------
    ValueError
        If the number of columns differs from the number of coefficients.

    Examples
    --------
    >>> from magline.tolles_lawson import predict
    >>> predict([[1.0, 2.0]], [3.0, 4.0]).tolist()
    [11.0]
    """
    return _magline.predict(matrix(a), column(coefficients), detrend)


def compensate(
    mag: ArrayLike, a: ArrayLike, coefficients: ArrayLike, *, detrend: bool = False
) -> NDArray[np.float64]:
    """Compensated field: scalar magnetometer minus the predicted aircraft field.

    For one line, the result is bit-identical to the column ``mag_c`` of the stage ``compensate``
    with the same ``detrend``.

    Parameters
    ----------
    mag : array_like, shape (samples,)
        Scalar magnetometer, uncompensated, nT.
    a : array_like, shape (samples, terms)
        A-matrix, with the groups of terms and the scale of the fit.
    coefficients : array_like, shape (terms,)
        Coefficients, such as ``Fit.coefficients``.
    detrend : bool, optional
        True keeps the mean of the predicted aircraft field in the signal. Use True for a model
        fitted with ``rate_hz``, because band-passed data do not determine this mean. Default:
        False.

    Returns
    -------
    numpy.ndarray, shape (samples,)
        Compensated field, nT. NaN where ``mag`` or a row of ``a`` contains NaN.

    Raises
    ------
    ValueError
        If lengths differ, or if the number of columns differs from the number of coefficients.

    References
    ----------
    A. Gnadt, PhD thesis, MIT, 2022, eq. 3.22

    Examples
    --------
    >>> from magline.tolles_lawson import compensate
    >>> compensate([50_011.0], [[1.0, 2.0]], [3.0, 4.0]).tolist()
    [50000.0]
    """
    mag, field = columns(mag=mag, a=predict(a, coefficients, detrend=detrend))
    return mag - field
