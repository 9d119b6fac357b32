"""Conversion of arguments to the arrays that the extension module requires."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Column = NDArray[np.float64]
_FLOAT64 = np.dtype(np.float64)


def _floats(values: ArrayLike) -> NDArray[np.float64]:
    """Contiguous array of float64. NumPy would convert times to counts of their unit without a warning."""
    if type(values) is np.ndarray and values.dtype is _FLOAT64 and values.ndim and values.flags.c_contiguous:
        return values
    array = np.asarray(values)
    if array.dtype.kind in "mMc":
        raise ValueError(f"expected real numbers, but the type is {array.dtype}; convert times to seconds")
    return np.ascontiguousarray(array, dtype=np.float64)


def column(values: ArrayLike) -> Column:
    """Contiguous one-dimensional array of float64.

    Raises
    ------
    ValueError
        If the values are not one-dimensional, or are complex numbers or dates.
    """
    array = _floats(values)
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
        If the values are not two-dimensional, or are complex numbers or dates.
    """
    array = _floats(values)
    if array.ndim != 2:
        raise ValueError(f"expected an array of two dimensions, but its shape is {array.shape}")
    return array
