"""Conversion of arguments to arrays of the extension module."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Column = NDArray[np.float64]


def column(values: ArrayLike) -> Column:
    """Contiguous array of float64 with one dimension.

    Raises
    ------
    ValueError
        If the values do not have one dimension.
    """
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim != 1:
        raise ValueError(f"expected an array of one dimension, but its shape is {array.shape}")
    return array


def columns(**values: ArrayLike) -> list[Column]:
    """Arrays of one dimension and equal length, in the order of the arguments.

    Raises
    ------
    ValueError
        If a shape differs. The message has the names and shapes.
    """
    arrays = [column(one) for one in values.values()]
    if len({array.shape for array in arrays}) > 1:
        shapes = ", ".join(f"{name} {a.shape}" for name, a in zip(values, arrays, strict=True))
        raise ValueError(f"the arrays have different lengths: {shapes}")
    return arrays


def matrix(values: ArrayLike) -> NDArray[np.float64]:
    """Contiguous array of float64 with two dimensions, row-major.

    Raises
    ------
    ValueError
        If the values do not have two dimensions.
    """
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim != 2:
        raise ValueError(f"expected an array of two dimensions, but its shape is {array.shape}")
    return array
