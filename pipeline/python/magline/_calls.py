"""Calls of parts by a run: arguments, checks of results, states of models, and tracebacks."""

from __future__ import annotations

import base64
import inspect
import io
import json
import math
import pickle
import sys
import traceback
import types
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magline._magline import Flight, Line

_CHUNK = 3072
_HERE = __file__
_TRACK = frozenset("lat lon alt vn ve vd sd_n sd_e cov_ne residual nis update".split())


class StageCall:
    """Call of a stage by a run."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def __call__(self, line: Line, parameters: dict[str, Any], names: list[str]) -> list[Any]:
        made = self._function(line, **parameters)
        if not isinstance(made, Mapping):
            if len(names) != 1:
                raise TypeError(f"the stage must return a dict of the columns {names}, not {type(made).__name__}")
            made = {names[0]: made}
        if set(made) != set(names):
            raise ValueError(f"the stage returned the columns {sorted(made)}, but declares {names}")
        return [_values(made[name], len(line)) for name in names]


def _values(value: Any, rows: int) -> Any:
    """Numbers as a C-contiguous array of Float64, or a list of text."""
    if isinstance(value, np.ma.MaskedArray):
        value = np.ma.filled(value.astype(np.float64), np.nan)
    array = np.asarray(value)
    if array.dtype.kind in "OUT" and all(one is None or isinstance(one, str) for one in array.ravel()):
        return [None if one is None else str(one) for one in array.ravel()]
    return np.ascontiguousarray(_numbers(array) if array.ndim else np.full(rows, _numbers(array)))


def _numbers(value: Any) -> NDArray[np.float64]:
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"numbers are required, not {array.dtype}")
    return np.asarray(array, dtype=np.float64)


class FilterCall:
    """Call of a filter by a run."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def __call__(self, flight: Flight, parameters: dict[str, Any]) -> dict[str, Any]:
        made = self._function(flight, **parameters)
        if not isinstance(made, Mapping):
            raise TypeError(f"the filter must return a dict of columns, not {type(made).__name__}")
        unknown = set(made) - _TRACK
        if unknown:
            raise ValueError(f"the filter returned the unknown columns {sorted(unknown)}")
        return {key: list(one) if key == "update" else _values(one, len(flight)) for key, one in made.items()}


class MetricCall:
    """Call of a metric by a run."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def __call__(self, inputs: dict[str, NDArray[np.float64]], rows: int) -> tuple[float, int]:
        made = self._function(**inputs)
        value, count = made if isinstance(made, tuple) else (made, rows)
        return float(value), int(count)


class ModelCall:
    """Fit, state and prediction of a model in a run."""

    def __init__(self, make: Callable[..., Any]) -> None:
        self._make = make

    def fit(
        self,
        parameters: dict[str, Any],
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        groups: NDArray[np.int64],
        names: list[str],
    ) -> tuple[str, list[tuple[str, float]]]:
        """Parameters as JSON, and the terms of the state."""
        estimator = self._make(**parameters)
        accepted = inspect.signature(estimator.fit).parameters
        more = {key: value for key, value in (("groups", groups), ("names", names)) if key in accepted}
        fitted = estimator.fit(x, y, **more)
        fitted = estimator if fitted is None else fitted
        # A `.` before `epoch_` marks the course of a training.
        text = json.dumps(parameters, sort_keys=True).replace(".epoch_", "\\u002eepoch_")
        return text, self._state(fitted)

    def _state(self, fitted: Any) -> list[tuple[str, float]]:
        if hasattr(fitted, "get_numbers"):
            return _numbers_terms(fitted.get_numbers())
        own = isinstance(self._make, type) and type(fitted) is self._make and not _has_own_pickling(self._make)
        buffer = pickle.dumps(vars(fitted) if own else fitted, protocol=5)
        chunks = [buffer[i : i + _CHUNK] for i in range(0, len(buffer), _CHUNK)]
        return [(f"pickle[{i}] {base64.b64encode(c).decode()}", float(len(c))) for i, c in enumerate(chunks, 1)]

    def load(self, parameters: str, pickled: str, numbers: dict[str, NDArray[np.float64]]) -> Any:
        """Fitted estimator of a model table."""
        if not pickled:
            estimator = self._make(**json.loads(parameters))
            estimator.set_numbers(numbers)
            return estimator
        state = _Unpickler(io.BytesIO(_decoded(pickled)), self._make).load()
        if isinstance(state, dict) and isinstance(self._make, type):
            fitted: Any = object.__new__(self._make)
            vars(fitted).update(state)
            return fitted
        return state

    def predict(
        self, estimator: Any, x: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """Prediction of each row, and its standard deviation."""
        made = estimator.predict(x)
        field, sigma = made if isinstance(made, tuple) else (made, None)
        return _vector(field), None if sigma is None else _vector(sigma)


def _vector(value: Any) -> NDArray[np.float64]:
    array = _numbers(value)
    if array.ndim == 2 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim != 1:
        raise ValueError(f"predict must return one value per row, not an array of shape {array.shape}")
    return np.ascontiguousarray(array)


def _has_own_pickling(made: type) -> bool:
    return any(name in vars(base) for base in made.__mro__[:-1] for name in ("__reduce__", "__getstate__", "__slots__"))


def _decoded(pickled: str) -> bytes:
    """Bytes of chunks in base 64, each of which may end with padding."""
    size = 4 * math.ceil(_CHUNK / 3)
    return b"".join(base64.b64decode(pickled[i : i + size]) for i in range(0, len(pickled), size))


def _numbers_terms(numbers: Mapping[str, Any]) -> list[tuple[str, float]]:
    terms = []
    for i, (name, value) in enumerate(numbers.items(), 1):
        values = np.atleast_1d(_numbers(value))
        if not name.isidentifier() or name.startswith("epoch_") or values.ndim != 1:
            raise ValueError(f"`{name}` from get_numbers() must be a number or a vector, and its name must be an "
                             "identifier")
        terms.append((f"numbers[{i}] {name}", float(len(values))))
        terms += [(f"state.{name}[{k}]", float(one)) for k, one in enumerate(values, 1)]
    return terms


class _Unpickler(pickle.Unpickler):
    """Reader of a state; classes of the file of the part are found if the file has another module name."""

    def __init__(self, file: io.BytesIO, make: Callable[..., Any]) -> None:
        super().__init__(file)
        self._module = sys.modules.get(make.__module__)

    def find_class(self, module: str, name: str) -> Any:
        if module == "__main__" or module.startswith("magline_parts_"):
            found = getattr(self._module, name, None)
            if found is not None:
                return found
        return super().find_class(module, name)


def describe(error: BaseException, tb: types.TracebackType | None) -> str:
    """Text of an exception with its traceback, which starts in the code of the part."""
    while tb is not None and tb.tb_frame.f_code.co_filename == _HERE and tb.tb_next is not None:
        tb = tb.tb_next
    name = "".join(traceback.format_exception_only(error)).strip()
    return f"{name}\n{''.join(traceback.format_exception(type(error), error, tb)).rstrip()}"
