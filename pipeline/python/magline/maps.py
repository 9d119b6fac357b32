"""Maps of the magnetic anomaly."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magline import _magline
from magline._arrays import matrix

__all__ = ["Map", "open", "upward"]


@dataclass(frozen=True)
class Map:
    """Anomaly map on its native grid.

    Attributes
    ----------
    x : numpy.ndarray, shape (columns,)
        Eastings or longitudes, ascending, in ``unit``.
    y : numpy.ndarray, shape (rows,)
        Northings or latitudes, ascending, in ``unit``.
    anomaly_nt : numpy.ndarray, shape (rows, columns)
        Anomaly, nT; NaN where unknown.
    alt_m : numpy.ndarray, shape (rows, columns)
        Height of each node above the WGS-84 ellipsoid, m; NaN where unknown.
    epsg : int
        EPSG code of the coordinates.
    unit : str
        Unit of the coordinates: ``deg``, ``m`` or ``ft``; empty if it has no common name.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    anomaly_nt: NDArray[np.float64]
    alt_m: NDArray[np.float64]
    epsg: int
    unit: str

    def xarray(self) -> Any:
        """`xarray.DataArray` of the anomaly with the dimensions ``y`` and ``x``."""
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

    Parameters
    ----------
    path : path
        File.
    epsg : int, optional
        EPSG code of the coordinates. Default: as in the file.
    alt_m : float, optional
        Height above the WGS-84 ellipsoid, m. Default: as in the file.
    unit : str, optional
        Unit of the anomaly. Default: as in the file, otherwise nT.

    Returns
    -------
    Map

    Raises
    ------
    DataError
        For a file that is missing, damaged or in no known format.
    SpecError
        If neither the file nor an argument gives the height or the coordinate system.

    Examples
    --------
    >>> from magline import maps
    >>> found = maps.open("datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif")
    >>> found.anomaly_nt.shape == (found.y.size, found.x.size)
    True
    """
    return Map(*_magline.open_map(Path(path), epsg, alt_m, unit))


def upward(grid: ArrayLike, spacing_m: float | tuple[float, float], dz_m: float) -> Any:
    """Upward continuation of a map between level surfaces, in the wavenumber domain.

    The map is extended at its edges with the padding of the stage ``map_continue``.

    Parameters
    ----------
    grid : array_like or xarray.DataArray, shape (rows, columns)
        Map without unknown nodes, in any unit. Rows ascend to the north, columns to the east.
    spacing_m : float or (float, float)
        Spacing of the nodes, m; a pair gives the spacing of rows and of columns.
    dz_m : float
        Distance upward, m, at least 0.

    Returns
    -------
    numpy.ndarray or xarray.DataArray, shape (rows, columns)
        Map at the new height, in the unit and type of ``grid``.

    Raises
    ------
    ValueError
        For unknown nodes, fewer than two nodes on a side, or a negative distance.

    References
    ----------
    R. J. Blakely, Potential Theory in Gravity and Magnetic Applications, 1996, (12.8)

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
    return copy(data=raised) if copy is not None and hasattr(grid, "dims") else raised
