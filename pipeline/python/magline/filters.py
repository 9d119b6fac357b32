"""Navigation filters on arrays of one flight line.

Each filter of the stage ``navigate`` is a function. Its results are bit-identical to the results of the stage on the
same line, map and keys. The keyword arguments are the keys of the stage and of the filter; unset keys have the defaults
of the stage, such as ``tuning="auto"``. The filters in `magline.stream` take one sample at a time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from numpy.typing import ArrayLike

from magline import _filters
from magline._filters import *  # noqa: F403
from magline._track import INPUTS, Magnetometers, Track, TrackWarning, navigate_line
from magline.maps import Map

__all__ = ["Track", "TrackWarning", "navigate"]
__all__ += _filters.__all__


def navigate(
    filter: str,
    tt_s: ArrayLike,
    ins_lat_deg: ArrayLike,
    ins_lon_deg: ArrayLike,
    ins_alt_m: ArrayLike,
    mag_nt: Magnetometers | None = None,
    map: Map | None = None,
    *,
    ins_velocity_ned_mps: ArrayLike | None = None,
    ins_force_ned_mps2: ArrayLike | None = None,
    ins_attitude_deg: ArrayLike | None = None,
    columns: Mapping[str, Any] | None = None,
    models: Sequence[Any] | None = None,
    rate_hz: float | None = None,
    **keys: Any,
) -> Track:
    """Run a filter by its name on one line, for filters without a function in this module.

    These are ``ekf_online_nn``, ``nekf`` and filters registered with `magline.filter`.

    Parameters
    ----------
    filter : str
        Name of the filter.
    tt_s, ins_lat_deg, ins_lon_deg, ins_alt_m, mag_nt, map : array_like
        As in `ekf`.
    ins_velocity_ned_mps, ins_force_ned_mps2, ins_attitude_deg, columns, models, rate_hz : optional
        As in `ekf` and `ekf_online_tl`.
    **keys
        Keys of the stage ``navigate`` and of the filter.

    Returns
    -------
    Track

    Raises
    ------
    SpecError, DataError, ValueError
        As in `ekf`.

    Examples
    --------
    >>> import numpy as np
    >>> from magline import filters
    >>> t = np.arange(100.0)
    >>> fix = {"start": "given", "init_position_sigma_m": 20.0, "core_field": False}
    >>> lat = 45.0 + 5e-4 * t
    >>> track = filters.navigate("ins_only", t, lat, 0.0 * t - 76.0, 0.0 * t + 300.0, **fix)
    >>> float(track.sd_n_m[0].round(3))
    20.0
    """
    track = {name: item for name, item in locals().items() if name in INPUTS}
    return navigate_line(filter, {**track, **keys})
