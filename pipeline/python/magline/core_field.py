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
    """Core field of IGRF-14 (degree 13), valid from 1900.0 to 2030.0.

    The field is bit-identical to the field that the stage ``core_field`` computes. The four
    positional arguments are broadcast against each other.

    Parameters
    ----------
    lat_deg, lon_deg : array_like
        Geodetic latitude, -90 to 90, and longitude east, -180 to 360, degrees.
    alt_m : array_like
        Height above the WGS-84 ellipsoid, m, from -10 km to 2000 km.
    decimal_year : array_like
        Date as a decimal year, such as 2020.5.
    component : {"magnitude", "north", "east", "down"}, optional
        Total field, or one component in the local geodetic frame. Default: magnitude, the total
        field.

    Returns
    -------
    numpy.ndarray
        Field, nT, in the broadcast shape of the arguments; a NumPy scalar if all arguments are
        scalars. NaN where a coordinate or date is not finite.

    Raises
    ------
    ValueError
        If a date or coordinate is outside its range, or if the component is unknown.

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
    """Core field of the World Magnetic Model (degree 12), valid from 2020.0 to 2030.0.

    WMM2020 applies before 2025.0, and WMM2025 from 2025.0. At the change of model, a component
    jumps by up to 314 nT. `igrf` describes the parameters, the result and the errors.

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
        raise ValueError(f"`component` must be magnitude, north, east or down, not {component!r}")
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
