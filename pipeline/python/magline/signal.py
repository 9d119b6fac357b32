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

    The filter runs forwards and backwards. The result therefore has no lag, and the gain at each
    corner is 1/2 (-6 dB). A run is a sequence of finite samples without a gap in ``tt``. Each run
    is filtered separately. With ``tt``, the result is bit-identical to the result of the
    stage ``bandpass``.

    Parameters
    ----------
    x : array_like, shape (samples,)
        Signal, in any unit.
    rate_hz : float, optional
        Sample rate, Hz. Exactly one of ``rate_hz`` and ``tt`` is required. With ``rate_hz``, the
        samples are assumed to have no gaps in time.
    tt : array_like, shape (samples,), optional
        Times, s, strictly increasing. A step of at least 1.5 median steps is a gap. Any other step
        must equal the median step within 1 %.
    low_hz, high_hz : float or None, optional
        Lower and upper corner frequency, Hz. With ``low_hz=None`` the filter is a low-pass, and
        with ``high_hz=None`` a high-pass. Default: 0.1 and 0.9, as in Gnadt 2022, section 3.1.2.
    order : int, optional
        Order of the Butterworth prototype, 1 to 12. Default: 4.

    Returns
    -------
    numpy.ndarray, shape (samples,)
        Filtered signal in the unit of ``x``. NaN outside the runs and in runs that are too short
        for the filter's padding. A band-pass of order 4 requires runs of at least 25 samples (6 per
        second-order section, plus 1).

    Raises
    ------
    ValueError
        If both or neither of ``rate_hz`` and ``tt`` are given, times are uneven, lengths differ or
        no run is long enough. Corners must be above 0 and below half the rate, with ``low_hz``
        below ``high_hz``, and at most one may be None. The order must be 1 to 12.

    References
    ----------
    F. Gustafsson, Determining the initial states in forward-backward filtering, IEEE Trans. Signal
    Processing 44(4), 1996

    A. Gnadt, PhD thesis, MIT, 2022, section 3.1.2

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
