"""Conversion of arguments to the arrays that the extension module requires."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Column = NDArray[np.float64]


def column(values: ArrayLike) -> Column:
    """Contiguous one-dimensional array of float64.

    Raises
    ------
    ValueError
        If the values are not one-dimensional.
    """
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim != 1:
        raise ValueError(f"expected an array of one dimension, but its shape is {array.shape}")
    return array


def columns(**values: ArrayLike) -> list[Column]:
    """One-dimensional arrays of equal length, in the order of the arguments.

    Raises
    ------
    ValueError
        If an argument is not one-dimensional, or if the lengths differ. For different lengths, the
        message contains the names and shapes.
    """
    arrays = [column(one) for one in values.values()]
    if len({array.shape for array in arrays}) > 1:
        shapes = ", ".join(f"{name} {a.shape}" for name, a in zip(values, arrays, strict=True))
        raise ValueError(f"the arrays have different lengths: {shapes}")
    return arrays


def matrix(values: ArrayLike) -> NDArray[np.float64]:
    """Contiguous two-dimensional array of float64, row-major.

    Raises
    ------
    ValueError
        If the values are not two-dimensional.
    """
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim != 2:
        raise ValueError(f"expected an array of two dimensions, but its shape is {array.shape}")
    return array
