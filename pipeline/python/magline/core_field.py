"""The earth's core field: IGRF-14 and the World Magnetic Model."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magline import _magline

__all__ = ["Component", "igrf", "wmm"]

Component = Literal["magnitude", "north", "east", "down"]


def igrf(
    lat_deg: ArrayLike,
    lon_deg: ArrayLike,
    alt_m: ArrayLike,
    decimal_year: ArrayLike,
    *,
    component: Component = "magnitude",
) -> NDArray[np.float64]:
    """Core field by IGRF-14, from 1900 to 2030.

    The magnitude equals the stage ``core_field`` to the last bit.

    Parameters
    ----------
    lat_deg, lon_deg : array_like
        Geodetic latitude and longitude, degrees.
    alt_m : array_like
        Height above the WGS-84 ellipsoid, m.
    decimal_year : array_like
        Date, years. The four arguments are broadcast against each other.

    component : {"magnitude", "north", "east", "down"}, optional
        Magnitude, or a component in the local geodetic frame. Default: magnitude.

    Returns
    -------
    numpy.ndarray
        Field, nT, in the broadcast shape of the arguments. NaN at positions that are not finite.

    Raises
    ------
    ValueError
        For a date outside the model's range, a latitude beyond a pole, a longitude outside -180
        to 360 degrees, a height outside -10 to 2000 km, or an unknown
        component.

    References
    ----------
    IAGA, IGRF-14, doi:10.5281/zenodo.14012302

    Examples
    --------
    >>> from magline.core_field import igrf
    >>> igrf(45.0, -76.0, 300.0, 2020.5).round(1)
    np.float64(53710.9)
    """
    return _field(lat_deg, lon_deg, alt_m, decimal_year, component, False)


def wmm(
    lat_deg: ArrayLike,
    lon_deg: ArrayLike,
    alt_m: ArrayLike,
    decimal_year: ArrayLike,
    *,
    component: Component = "magnitude",
) -> NDArray[np.float64]:
    """Core field by the World Magnetic Models of 2020 and 2025, from 2020 to 2030.

    Parameters, result and errors as for `igrf`.

    References
    ----------
    NOAA NCEI and BGS, WMM2020 and WMM2025

    Examples
    --------
    >>> from magline.core_field import wmm
    >>> wmm([80.0, 0.0], 0.0, 0.0, 2025.0).shape
    (2,)
    """
    return _field(lat_deg, lon_deg, alt_m, decimal_year, component, True)


def _field(
    lat_deg: ArrayLike,
    lon_deg: ArrayLike,
    alt_m: ArrayLike,
    decimal_year: ArrayLike,
    component: Component,
    wmm: bool,
) -> NDArray[np.float64]:
    names = ("north", "east", "down")
    if component not in ("magnitude", *names):
        raise ValueError(f"`component` is magnitude, north, east or down, not {component!r}")
    given = (np.asarray(one, dtype=np.float64) for one in (lat_deg, lon_deg, alt_m, decimal_year))
    lat, lon, alt, year = np.broadcast_arrays(*given)
    flat = [np.ascontiguousarray(one).reshape(-1) for one in (lat, lon, alt, year)]
    field = _magline.core_field(flat[0], flat[1], flat[2], flat[3], wmm)
    if component == "magnitude":
        n, e, d = field
        found = np.sqrt(n * n + e * e + d * d)
    else:
        found = field[names.index(component)]
    result: NDArray[np.float64] = found.reshape(lat.shape)[()]
    return result
