"""Filters of evenly sampled signals."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magline import _magline
from magline._arrays import column

__all__ = ["bandpass"]


def bandpass(
    x: ArrayLike,
    *,
    rate_hz: float | None = None,
    tt: ArrayLike | None = None,
    low_hz: float | None = 0.1,
    high_hz: float | None = 0.9,
    order: int = 4,
) -> NDArray[np.float64]:
    """Zero-phase Butterworth band-pass filter.

    The filter runs forwards and backwards, so each corner has half the power twice and the result
    has no lag. A value that is not finite, or a gap in ``tt``, ends a run, and the filter restarts
    after it. It equals the stage ``bandpass`` to the last bit.

    Parameters
    ----------
    x : array_like, shape (samples,)
        Signal, in any unit.
    rate_hz : float
        Sample rate, Hz. Give either ``rate_hz`` or ``tt``.
    tt : array_like, shape (samples,)
        Times, s, evenly spaced except for gaps.
    low_hz, high_hz : float or None, optional
        Corners, Hz. None removes a corner. Default: 0.1 and 0.9, as in Gnadt 2022, section 3.4.
    order : int, optional
        Order of the Butterworth prototype. Default: 4.

    Returns
    -------
    numpy.ndarray, shape (samples,)
        Filtered signal in the unit of ``x``. NaN outside the runs and in runs shorter than the
        filter's padding.

    Raises
    ------
    ValueError
        For a corner that is not between 0 and half the rate, for uneven times, and if no run is
        long enough.

    References
    ----------
    F. Gustafsson, Determining the initial states in forward-backward filtering, 1996

    Examples
    --------
    >>> import numpy as np
    >>> from magline.signal import bandpass
    >>> tt = np.arange(1000) / 10.0
    >>> y = bandpass(np.sin(2 * np.pi * 0.3 * tt) + 5.0, rate_hz=10.0)
    >>> bool(abs(y[400:600].mean()) < 0.01)
    True
    """
    if (rate_hz is None) == (tt is None):
        raise ValueError("give either `rate_hz` or `tt`")
    times = None if tt is None else column(tt)
    return _magline.bandpass(column(x), times, rate_hz or 0.0, low_hz, high_hz, order)
