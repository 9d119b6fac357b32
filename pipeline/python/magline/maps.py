"""Maps of the total field anomaly."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magline import _magline
from magline._arrays import matrix

__all__ = ["Map", "open", "upward", "vector"]


@dataclass(frozen=True)
class Map:
    """Anomaly map on its native grid.

    Attributes
    ----------
    x : numpy.ndarray, shape (columns,)
        Eastings or longitudes of the columns, ascending, in ``unit``.
    y : numpy.ndarray, shape (rows,)
        Northings or latitudes of the rows, ascending, in ``unit``.
    anomaly_nt : numpy.ndarray, shape (rows, columns)
        Total field anomaly, nT; NaN where unknown.
    alt_m : numpy.ndarray, shape (rows, columns)
        Height of each node above the WGS-84 ellipsoid, m; NaN where unknown.
    epsg : int
        EPSG code of the coordinate system.
    unit : str
        Unit of ``x`` and ``y``: ``deg``, ``m``, ``ft`` (international foot) or ``us-ft`` (US survey
        foot). It is empty for any other unit.
    error_nt : numpy.ndarray, shape (rows, columns), or None
        Standard deviation of the error of each node, nT; NaN where unknown. None if the file does
        not give it.

    Examples
    --------
    >>> from magline import maps
    >>> found = maps.open("datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif")
    >>> found.anomaly_nt.shape, found.unit, found.epsg
    ((462, 345), 'm', 32754)
    >>> float(found.alt_m[0, 0])
    500.0
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    anomaly_nt: NDArray[np.float64]
    alt_m: NDArray[np.float64]
    epsg: int
    unit: str
    error_nt: NDArray[np.float64] | None = None
    #: Spacings of ``x`` and ``y``, from which the reader computed the coordinates.
    _steps: tuple[float, float] | None = field(default=None, repr=False, compare=False)

    def xarray(self) -> Any:
        """Map as an `xarray.DataArray` with the dimensions ``y`` and ``x``.

        The values are ``anomaly_nt``. The heights are the coordinate ``alt_m``; the attributes are
        ``units``, ``epsg`` and ``coordinate_unit``.
        """
        import xarray

        coordinates = {"y": self.y, "x": self.x, "alt_m": (("y", "x"), self.alt_m)}
        attributes = {"units": "nT", "epsg": self.epsg, "coordinate_unit": self.unit}
        return xarray.DataArray(
            self.anomaly_nt, coordinates, ("y", "x"), name="anomaly", attrs=attributes
        )


def open(
    path: str | os.PathLike[str],
    *,
    epsg: int | None = None,
    alt_m: float | None = None,
    unit: str | None = None,
) -> Map:
    """Read a map in any format that ``magline map info`` reads.

    The formats include GeoTIFF, NetCDF, GMT, Surfer, Geosoft GXF and xyz.

    Parameters
    ----------
    path : path
        File of the map.
    epsg : int, optional
        EPSG code of the coordinate system. It overrides the file. Default: read from the file.
    alt_m : float, optional
        Height of the map above the WGS-84 ellipsoid, m. It overrides the file. Default: read from
        the file.
    unit : str, optional
        Unit of the anomaly in the file, such as ``uT``. It overrides the file; the result is always
        in nT. Default: read from the file, or nT if the file has no unit.

    Returns
    -------
    Map

    Raises
    ------
    DataError
        If the file is damaged or has no known format.
    SpecError
        If the file does not exist, or if an argument is wrong or missing. The height and the
        coordinate system must be in the file or in the arguments.

    Examples
    --------
    >>> from magline import maps
    >>> found = maps.open("datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif")
    >>> found.anomaly_nt.shape == (found.y.size, found.x.size)
    True
    """
    x, y, anomaly_nt, heights_m, code, axis_unit, error_nt, steps = _magline.open_map(
        Path(path), epsg, alt_m, unit
    )
    return Map(x, y, anomaly_nt, heights_m, code, axis_unit, error_nt, (steps[0], steps[1]))


def upward(grid: ArrayLike, spacing_m: float | tuple[float, float], dz_m: float) -> Any:
    """Upward continuation of a map between level surfaces, in the wavenumber domain.

    The mean along the edge is subtracted, and the map is padded on each side. The padding is at
    least ten times the distance and a tenth of the side, up to 5000 nodes. The stage
    ``map_continue`` has the same default padding.

    Parameters
    ----------
    grid : array_like or xarray.DataArray, shape (rows, columns)
        Map in any unit, with finite values only. Rows run from south to north and columns from west
        to east.
    spacing_m : float or (float, float)
        Spacing of the nodes, m. A pair holds the northward spacing of the rows and the eastward
        spacing of the columns.
    dz_m : float
        Distance of the continuation, m, 0 or more, positive upward.

    Returns
    -------
    numpy.ndarray or xarray.DataArray, shape (rows, columns)
        Map at the new height, in the unit of ``grid``. It is a DataArray if ``grid`` is a
        DataArray; a coordinate ``alt_m`` is then increased by ``dz_m``, and the other coordinates
        are copied.

    Raises
    ------
    ValueError
        If a value is not finite, a side has fewer than two nodes, a spacing is not positive, or
        the distance is negative.

    References
    ----------
    R. J. Blakely, Potential Theory in Gravity and Magnetic Applications, 1996, eq. 12.8

    Examples
    --------
    >>> import numpy as np
    >>> from magline.maps import upward
    >>> upward(np.ones((20, 30)), 100.0, 300.0).shape
    (20, 30)
    """
    pair = (spacing_m, spacing_m) if isinstance(spacing_m, (int, float)) else spacing_m
    north_m, east_m = (float(one) for one in pair)
    raised = _magline.upward(matrix(grid), (north_m, east_m), float(dz_m))
    copy = getattr(grid, "copy", None)
    if copy is None or not hasattr(grid, "dims"):
        return raised
    found = copy(data=raised)
    return found.assign_coords(alt_m=found["alt_m"] + dz_m) if "alt_m" in found.coords else found


def vector(
    grid: ArrayLike,
    spacing_m: float | tuple[float, float],
    inclination_deg: float,
    declination_deg: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Components of the anomaly field from a map of the total-field anomaly.

    The stage ``map_vector`` computes the same components on a map with a coordinate system. The
    field beyond the edges is unknown: discard a margin of 15 nodes.

    Parameters
    ----------
    grid : array_like, shape (rows, columns)
        Total-field anomaly on a level, nT, with finite values only. Rows run from south to north and
        columns from west to east.
    spacing_m : float or (float, float)
        Spacing of the nodes, m. A pair holds the northward spacing of the rows and the eastward
        spacing of the columns.
    inclination_deg : float
        Inclination of the core field, degrees, positive downward.
    declination_deg : float
        Declination of the core field, degrees, from grid north towards grid east.

    Returns
    -------
    north, east, down : numpy.ndarray, shape (rows, columns)
        Components of the anomaly field, nT.

    Warns
    -----
    UserWarning
        If the inclination is within 15 degrees of the horizontal. Waves perpendicular to the core field are then
        missing from the map, and the components are too small.

    Raises
    ------
    ValueError
        If a value is not finite, a side has fewer than two nodes, or a spacing is not positive.

    References
    ----------
    R. J. Blakely, Potential Theory in Gravity and Magnetic Applications, 1996, section 12.3.1

    Examples
    --------
    >>> import numpy as np
    >>> from magline.maps import vector
    >>> north, east, down = vector(np.ones((20, 30)), 100.0, 60.0, 0.0)
    >>> bool(np.allclose(down, np.sin(np.radians(60.0))))
    True
    """
    pair = (spacing_m, spacing_m) if isinstance(spacing_m, (int, float)) else spacing_m
    spacing = (float(pair[0]), float(pair[1]))
    angles = (float(inclination_deg), float(declination_deg))
    north, east, down, damped = _magline.vector(matrix(grid), spacing, *angles)
    if damped:
        warnings.warn(
            f"at an inclination of {inclination_deg} degrees, the map does not determine waves "
            "perpendicular to the core field, so the components are too small",
            stacklevel=2,
        )
    return north, east, down
