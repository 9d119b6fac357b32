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
    """Fitted coefficients.

    Attributes
    ----------
    coefficients : numpy.ndarray, shape (terms,)
        Coefficient of each column: unit of the target over unit of the column.
    residual_std : float
        Standard deviation of the residual, in the unit of the target.
    condition : float
        Ratio of the largest to the smallest singular value of the matrix.
    rows : int
        Number of rows used.
    lambda_ : float
        Ridge parameter.
    """

    coefficients: NDArray[np.float64]
    residual_std: float
    condition: float
    rows: int
    lambda_: float


def term_names(terms: Sequence[str] = _TERMS) -> list[str]:
    """Names of the columns of `a_matrix`.

    Parameters
    ----------
    terms : sequence of str, optional
        Groups of terms, as for `a_matrix`.

    Returns
    -------
    list of str

    Raises
    ------
    ValueError
        For an unknown group, or two groups of the same terms.

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
    """Matrix of the Tolles-Lawson terms.

    B is the vector, Bt its magnitude or ``scalar``, dB the central difference of B per sample and
    s ``bt_scale_nt``. The terms are: permanent B_i/Bt, induced B_i B_j/(Bt s), eddy
    B_i dB_j/(Bt s), derivative dB_i, bias 1. It equals the stage ``a_matrix`` to the last bit if
    ``tt`` is given.

    Parameters
    ----------
    flux : array_like, shape (samples, 3)
        Vector magnetometer in the body frame (nose, right wing, down), nT.
    rate_hz : float, optional
        Sample rate, Hz. With ``tt``, it must agree with the times within 1 %. The differences are
        per sample, so the matrix does not depend on it; coefficients of eddy and derivative terms
        apply only at the rate of their fit. Default: unset.
    terms : sequence of str, optional
        Groups: ``permanent``, ``induced`` (or ``induced5``, ``induced3``), ``eddy`` (or ``eddy8``,
        ``eddy3``), ``derivative``, ``bias``. Default: permanent, induced, eddy.
    scalar : array_like, shape (samples,), optional
        Scalar magnetometer whose reading replaces Bt, nT. Default: the magnitude of the vector.
    tt : array_like, shape (samples,), optional
        Times, s, evenly spaced except for gaps. Differences do not cross a gap. Default: no gaps.
    bt_scale_nt : float, optional
        Scale of induced and eddy terms, nT. Default: 50 000.

    Returns
    -------
    numpy.ndarray, shape (samples, terms)
        NaN where a term is undefined.

    Raises
    ------
    ValueError
        For different lengths, an unknown group, uneven times, times of another rate, or a scale
        that is not positive.

    References
    ----------
    W. E. Tolles and J. D. Lawson, 1950; A. Gnadt, PhD thesis, MIT, 2022, (3.13) to (3.20)

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
        raise ValueError(f"`flux` has the shape (samples, 3), not {vector.shape}")
    x, y, z = (column(vector[:, axis]) for axis in range(3))
    bt = None if scalar is None else column(scalar)
    times = None if tt is None else column(tt)
    if rate_hz is not None and times is not None and times.size > 1:
        found = 1.0 / float(np.median(np.diff(times)))
        if not abs(found / rate_hz - 1.0) < 0.01:
            raise ValueError(f"`rate_hz` is {rate_hz} Hz, but the rate of `tt` is {found:.6g} Hz")
    return _magline.a_matrix(x, y, z, list(terms), bt, times, bt_scale_nt)


def fit(
    a: ArrayLike,
    y: ArrayLike,
    rate_hz: float | None = None,
    *,
    lambda_: float = 0.025,
    low_hz: float | None = 0.1,
    high_hz: float | None = 0.9,
    order: int = 4,
    trim: int = 20,
) -> Fit:
    """Ridge fit: minimises |y - A b|^2 + lambda |b|^2, with unscaled columns and no constant.

    With ``rate_hz``, the columns of A and y are band-passed first, and the fit equals the model
    ``tolles_lawson`` of the stage ``fit`` on one line to the last bit.

    Parameters
    ----------
    a : array_like, shape (samples, terms)
        Matrix. A row with a value that is not finite is excluded and ends a run of the filter.
    y : array_like, shape (samples,)
        Target, such as a scalar magnetometer, nT.
    rate_hz : float, optional
        Sample rate, Hz. Default: no filter, and no samples are removed.
    lambda_ : float, optional
        Ridge parameter; 0 is ordinary least squares. Default: 0.025.
    low_hz, high_hz : float or None, optional
        Corners of the zero-phase filter, Hz. None removes a corner. Default: 0.1 and 0.9.
    order : int, optional
        Order of the Butterworth prototype. Default: 4.
    trim : int, optional
        Number of samples that are removed at both ends of each run after the filter. Default: 20.

    Returns
    -------
    Fit

    Raises
    ------
    ValueError
        For different lengths, no rows, a negative ``lambda_``, a corner that is not between 0 and
        half the rate, and dependent columns without a ridge.

    References
    ----------
    A. Gnadt, PhD thesis, MIT, 2022, (3.19) to (3.43)

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
    found = _magline.fit(matrix(a), column(y), lambda_, band)
    coefficients, residual_std, condition, rows = found
    return Fit(coefficients, residual_std, condition, rows, lambda_)


def predict(a: ArrayLike, coefficients: ArrayLike, *, detrend: bool = False) -> NDArray[np.float64]:
    """Aircraft field of a model.

    Parameters
    ----------
    a : array_like, shape (samples, terms)
        Matrix.
    coefficients : array_like, shape (terms,)
        Coefficients, such as ``Fit.coefficients``.
    detrend : bool, optional
        Subtracts the mean. Default: False.

    Returns
    -------
    numpy.ndarray, shape (samples,)
        Aircraft field in the unit of the target, nT.

    Raises
    ------
    ValueError
        If the numbers of columns and coefficients differ.

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
    """Scalar magnetometer minus the aircraft field of a model.

    It equals the column ``mag_c`` of the stage ``compensate`` to the last bit.

    Parameters
    ----------
    mag : array_like, shape (samples,)
        Scalar magnetometer, nT.
    a : array_like, shape (samples, terms)
        Matrix.
    coefficients : array_like, shape (terms,)
        Coefficients.
    detrend : bool, optional
        Leaves the mean of the aircraft field in the signal, for models fitted to filtered data.
        Default: False.

    Returns
    -------
    numpy.ndarray, shape (samples,)
        Compensated field, nT.

    Raises
    ------
    ValueError
        If lengths differ.

    References
    ----------
    A. Gnadt, PhD thesis, MIT, 2022, (3.22)

    Examples
    --------
    >>> from magline.tolles_lawson import compensate
    >>> compensate([50_011.0], [[1.0, 2.0]], [3.0, 4.0]).tolist()
    [50000.0]
    """
    mag, field = columns(mag=mag, a=predict(a, coefficients, detrend=detrend))
    return mag - field
