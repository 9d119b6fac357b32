"""Parts of a pipeline that are written in Python: stages, models, filters and metrics.

A decorator registers a part for this process. Specs then use its name as they use a built-in one. Its key consists of
name, version, parameters and a hash of its source, so an edit computes its results again.

The hash covers the source text of the function or class, and the functions, classes and constants of the same module
that it names. It also covers the items of `depends`: functions, classes, files (`pathlib.Path`) and modules. A module
with `__version__` counts by its version, any other by its source. The hash does not cover imported modules that
`depends` does not list, files that the code reads, environment variables, and global objects other than numbers, text,
lists, dicts and NumPy arrays.

Examples
--------
>>> import magline
>>> @magline.stage(reads={"{column}": "nT"}, makes={"{column}_centred": "nT"}, version=1)
... def centre(line, *, column: str = "mag_1_uc"):
...     return line[column] - line[column].mean()
>>> [part for part in magline.parts.registered() if part.name == "centre"][0].kind
'stage'
"""

from __future__ import annotations

import base64
import importlib.util
import inspect
import io
import json
import linecache
import math
import pickle
import re
import sys
import traceback
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from magline._magline import Flight, Line, register_part, registered_parts
from magline._sources import source_hash

__all__ = ["Column", "Flight", "Line", "Param", "filter", "load_parts", "metric", "model", "registered", "stage"]

_F = TypeVar("_F", bound=Callable[..., Any])
_NAME = re.compile(r"[a-z][a-z0-9_]*\Z")
_CHUNK = 3072
_HERE = __file__
_TRACK = frozenset("lat lon alt vn ve vd sd_n sd_e cov_ne residual nis update".split())


@dataclass(frozen=True)
class Column:
    """A column that a stage makes.

    Parameters
    ----------
    unit
        Unit of the values; empty for none.
    doc
        Meaning.
    terms
        Names of the entries of a list column. The stage returns a matrix with one row per sample.
    text
        Whether the column holds text.
    """

    unit: str = ""
    doc: str = ""
    terms: Sequence[str] | None = None
    text: bool = False


@dataclass(frozen=True)
class Param:
    """Unit, meaning and limits of a parameter, as ``Annotated[float, magline.Param("s", least=0.0)]``.

    Parameters
    ----------
    unit
        Unit of the value; empty for none.
    doc
        Meaning.
    least, most
        Limits of a number, both included.
    """

    unit: str = ""
    doc: str = ""
    least: float | None = None
    most: float | None = None


class Registered(NamedTuple):
    """A part of this process."""

    kind: str
    name: str
    version: int
    source: str


def registered() -> list[Registered]:
    """Return the parts of this process, with the hashes of their sources."""
    _settle()
    return [Registered(*part) for part in registered_parts()]


def stage(
    *,
    reads: Mapping[str, str | None] | Sequence[str],
    makes: Mapping[str, str | Column],
    version: int,
    name: str | None = None,
    depends: Sequence[object] = (),
) -> Callable[[_F], _F]:
    """Register a function as a stage of flight lines.

    The function receives one line (`Line`) and the parameters as keyword arguments. It returns the columns of `makes`
    by name, or one array if there is one column. Every column has one value per sample. NaN is a missing value. The
    other columns of the input pass through. A column made from a truth column has the role truth.

    Keyword-only arguments are the parameters of the stage. Their types are ``float``, ``int``, ``bool``, ``str``,
    ``list[float]``, ``list[str]``, ``Literal`` of words, and one of these or ``None``. The documentation of the stage
    is the docstring.

    Parameters
    ----------
    reads
        Columns that the function reads, and their units; ``None`` permits any unit. Other columns are not available.
        ``"{column}"`` is the column that the text parameter `column` names; a list of text repeats the name.
    makes
        Columns that it makes, with their units or as `Column`.
    version
        Version, in the key of the results.
    name
        Name in a spec. Default: the name of the function.
    depends
        Functions, classes, modules and files whose change also changes the results.

    Raises
    ------
    ValueError
        If the name belongs to a built-in stage or another function, or the source is not available.
    """

    def register(function: _F) -> _F:
        parameters = _parameters(function, lambda p: p.kind is inspect.Parameter.KEYWORD_ONLY)
        read = reads.items() if isinstance(reads, Mapping) else [(column, None) for column in reads]
        columns = [(column, Column(unit) if isinstance(unit, str) else unit) for column, unit in makes.items()]
        texts = {p["name"] for p in parameters if p["type"] in ("text", "list of text")}
        for template in [*(column for column, _ in read), *makes]:
            unknown = set(re.findall(r"\{([^}]*)\}", template)) - texts
            if unknown:
                raise ValueError(f"`{template}` names {sorted(unknown)}, which are not text parameters of the stage")
        declaration = _declaration(function, name, version, parameters) | {
            "reads": [{"name": column, "unit": unit} for column, unit in read],
            "makes": [
                {
                    "name": column,
                    "unit": made.unit,
                    "doc": made.doc or f"made by {name or function.__name__}",
                    "terms": None if made.terms is None else list(made.terms),
                    "text": made.text,
                }
                for column, made in columns
            ],
        }
        _register("stage", function, depends, declaration, _Stage(function))
        return function

    return register


@overload
def model(
    made: _F,
    *,
    version: int,
    name: str | None = None,
    keys: Sequence[str] | None = None,
    depends: Sequence[object] = (),
) -> _F: ...
@overload
def model(
    made: None = None,
    *,
    version: int,
    name: str | None = None,
    keys: Sequence[str] | None = None,
    depends: Sequence[object] = (),
) -> Callable[[_F], _F]: ...
def model(
    made: Any = None,
    *,
    version: int,
    name: str | None = None,
    keys: Sequence[str] | None = None,
    depends: Sequence[object] = (),
) -> Any:
    """Register a model of `fit`: a class, or a function that returns an estimator.

    The estimator has ``fit(x, y)`` and ``predict(x)``, as those of scikit-learn: ``x`` is (n, k), one column per entry
    of `features`; ``y`` (nT) is (n,). The rows are the unfiltered samples of all lines of the fit, without rows that
    have a NaN. `predict` returns (n,), nT, or a pair of prediction and standard deviation. `fit` may also accept
    ``groups`` (the number of the line of each row) and ``names`` (the names of the columns).

    The arguments of the class or function are the parameters of the model. Arguments without an annotation have the
    type of their default; those with the default ``None`` are not parameters.

    The model table holds the state of the fitted estimator. By default this is a pickle: reading such a table executes
    code, so use only tables that you trust. An estimator with ``get_numbers()`` (a dict of names to numbers or vectors)
    and ``set_numbers(numbers)`` is stored as numbers instead.

    Parameters
    ----------
    made
        Class or function. Without it, `model` is a decorator.
    version
        Version, in the key of the results.
    name
        Name in a spec. Default: the name of the class or function.
    keys
        Arguments that are parameters. Default: all with a known type.
    depends
        Functions, classes, modules and files whose change also changes the results.

    Examples
    --------
    >>> magline.model(sklearn.linear_model.Ridge, name="sk_ridge", version=1)  # doctest: +SKIP
    """

    def register(made: Any) -> Any:
        parameters = _parameters(made, lambda p: keys is None or p.name in keys)
        missing = set(keys or ()) - {p["name"] for p in parameters}
        if missing:
            raise ValueError(f"`{made.__name__}` has no arguments {sorted(missing)} with a known type")
        _register("model", made, depends, _declaration(made, name, version, parameters), _Model(made))
        return made

    return register if made is None else register(made)


def filter(
    *, version: int, needs_map: bool = True, name: str | None = None, depends: Sequence[object] = ()
) -> Callable[[_F], _F]:
    """Register a function as a filter of `navigate`.

    The function receives one line (`Flight`) and the parameters as keyword arguments. ``flight["lat"]`` is a column of
    the INS, ``flight["measured"]`` the scalar field, nT, and ``flight["sigma"]`` its standard deviation.
    ``flight.field(lat, lon, alt)`` returns the expected measurement, nT, and its slopes north, east and up, nT/m.

    It returns a dict of arrays over the samples: ``lat`` and ``lon``, degrees; optionally ``alt``, m, and ``vn``,
    ``ve``, ``vd``, m/s (default: those of the INS), ``sd_n``, ``sd_e``, m, ``cov_ne``, m2, ``residual``, nT, and
    ``nis`` (default: NaN). ``update`` is the outcome of each measurement, ``"used"``, ``"missing"``, ``"off_map"``,
    ``"gated"``, ``"flat"`` or ``"unused"``; by default, ``"used"`` where `residual` is finite.

    Keyword-only arguments are the parameters, as for `stage`.

    Parameters
    ----------
    version
        Version, in the key of the results.
    needs_map
        Whether the filter uses a map.
    name
        Name in a spec. Default: the name of the function.
    depends
        Functions, classes, modules and files whose change also changes the results.
    """

    def register(function: _F) -> _F:
        parameters = _parameters(function, lambda p: p.kind is inspect.Parameter.KEYWORD_ONLY)
        declaration = _declaration(function, name, version, parameters) | {"needs_map": needs_map}
        _register("filter", function, depends, declaration, _Filter(function))
        return function

    return register


def metric(
    *,
    unit: str,
    version: int,
    pool: Literal["rms", "mean", "sum"] = "rms",
    better: Literal["lower", "higher", "neither"] | float = "lower",
    name: str | None = None,
    depends: Sequence[object] = (),
) -> Callable[[_F], _F]:
    """Register a function as a metric of `score`.

    The names of its arguments select its inputs, each an array over the samples of a line: ``signal`` (`mag` of
    `score`), ``truth``, ``error`` (signal minus truth), ``aircraft`` (the subtracted field), ``north_m`` and ``east_m``
    (errors of a track), ``tt``, or the name of a column. Samples with a NaN in an input are removed first. The function
    returns the value, or a pair of value and number of samples. A line without samples has no value.

    Parameters
    ----------
    unit
        Unit of the value; ``"1"`` for none.
    version
        Version, in the key of the results.
    pool
        Pooling over lines: root mean square or mean, weighted by samples, or sum.
    better
        Preferred values; a number is a target.
    name
        Name in a spec. Default: the name of the function.
    depends
        Functions, classes, modules and files whose change also changes the results.
    """

    def register(function: _F) -> _F:
        declaration = _declaration(function, name, version, []) | {
            "unit": unit,
            "pool": pool,
            "better": better if isinstance(better, str) else {"near": float(better)},
            "needs": list(inspect.signature(function).parameters),
        }
        declaration["doc"] = declaration["doc"].strip().partition("\n\n")[0].replace("\n", " ").rstrip(".")
        _register("metric", function, depends, declaration, _Metric(function))
        return function

    return register


def load_parts(path: str | Path) -> types.ModuleType:
    """Run a Python file that registers parts, and return its module.

    The file can import modules of its folder. The command ``magline --parts FILE.py`` does the same, and so do its
    worker processes.
    """
    file = Path(path).resolve()
    if not file.is_file():
        raise FileNotFoundError(f"there is no file {file}")
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))
    module = types.ModuleType(f"magline_parts_{re.sub(r'[^0-9A-Za-z_]', '_', file.stem)}")
    module.__file__ = str(file)
    sys.modules[module.__name__] = module
    content = file.read_bytes()
    text = importlib.util.decode_source(content)
    # The hash is of the text that is executed, even if the file changes. Compiled files are not used, because they may
    # be older than a source of the same second.
    linecache.cache[str(file)] = (len(content), None, text.splitlines(keepends=True), str(file))
    exec(compile(content, str(file), "exec"), module.__dict__)
    return module


class _Declared(NamedTuple):
    """A part, and its last declaration."""

    part: Any
    depends: Sequence[object]
    declaration: dict[str, Any]
    call: object


_DECLARED: dict[tuple[str, str], _Declared] = {}


def _register(kind: str, part: Any, depends: Sequence[object], declaration: dict[str, Any], call: object) -> None:
    full = declaration | {"source": source_hash(part, depends)}
    register_part(kind, json.dumps(full), call)
    _DECLARED[kind, full["name"]] = _Declared(part, depends, full, call)


def _settle() -> None:
    """Register the parts again whose hashes have changed since.

    A module may define functions and constants after a part that names them, and a notebook may change them.
    """
    for (kind, _), (part, depends, declaration, call) in list(_DECLARED.items()):
        if source_hash(part, depends) != declaration["source"]:
            _register(kind, part, depends, declaration, call)


def _declaration(part: Any, name: str | None, version: int, parameters: list[dict[str, Any]]) -> dict[str, Any]:
    """Properties that all parts have."""
    called = name or part.__name__
    if not _NAME.match(called):
        raise ValueError(f"`{called}` is not a name of a part; use lower-case letters, digits and `_`")
    if isinstance(version, bool) or not isinstance(version, int) or not 1 <= version < 2**32:
        raise ValueError(f"the version of `{called}` must be a whole number from 1, not {version!r}")
    module = sys.modules.get(part.__module__)
    return {
        "name": called,
        "version": version,
        "doc": inspect.cleandoc(part.__doc__ or f"Written in Python: {part.__qualname__}."),
        "origin": f"{getattr(module, '__file__', part.__module__)}: {part.__qualname__}",
        "params": parameters,
    }


def _parameters(made: Any, is_wanted: Callable[[inspect.Parameter], bool]) -> list[dict[str, Any]]:
    """Parameters of a function or class, from its annotations and defaults."""
    hints = _hints(vars(made).get("__init__") if isinstance(made, type) else made)
    found = []
    for parameter in inspect.signature(made).parameters.values():
        variadic = parameter.kind in (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
        if variadic or not is_wanted(parameter):
            continue
        given = parameter.default
        default = None if given is inspect.Parameter.empty else given
        hint = hints.get(parameter.name, type(default))
        if hint is type(None):
            continue
        one = _typed(hint, default)
        if one is None:
            if parameter.name in hints:
                raise TypeError(f"the parameter `{parameter.name}` of `{made.__name__}` has an unknown type: {hint}")
            continue
        found.append({"name": parameter.name, "default": default, "unit": "", "doc": "", "choices": None} | one)
    return found


def _hints(function: Any) -> dict[str, Any]:
    """Annotations of the arguments that can be evaluated."""
    found = {}
    for name, hint in getattr(function, "__annotations__", {}).items():
        try:
            found[name] = eval(hint, function.__globals__) if isinstance(hint, str) else hint
        except (NameError, AttributeError, TypeError):
            continue
    return found


_TYPES: dict[Any, str] = {float: "number", int: "whole number", bool: "boolean", str: "text"}


def _typed(hint: Any, default: Any) -> dict[str, Any] | None:
    """Type, limits and unit of a parameter; ``None`` for an unknown type."""
    about, optional = Param(), False
    if typing.get_origin(hint) is typing.Annotated:
        hint, *extra = typing.get_args(hint)
        about = next((one for one in extra if isinstance(one, Param)), about)
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        known = [one for one in typing.get_args(hint) if one is not type(None)]
        optional = len(known) < len(typing.get_args(hint))
        if len(known) != 1:
            return None
        hint = known[0]
    choices = None
    if typing.get_origin(hint) is Literal:
        choices = list(typing.get_args(hint))
        hint = str if all(isinstance(one, str) for one in choices) else None
    elif typing.get_origin(hint) is not None and issubclass(typing.get_origin(hint), Sequence):
        element = (typing.get_args(hint) or (None,))[0]
        hint = {float: list[float], int: list[float], str: list[str]}.get(element)
    elif hint in (list, tuple) and default:
        hint = list[str] if all(isinstance(one, str) for one in default) else list[float]
    kind = {list[float]: "list of numbers", list[str]: "list of text"}.get(hint) or _TYPES.get(hint)
    if kind is None:
        return None
    limits = {"unit": about.unit, "doc": about.doc, "least": about.least, "most": about.most}
    return {"type": kind, "optional": optional, "choices": choices} | limits


class _Stage:
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


class _Filter:
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


class _Metric:
    """Call of a metric by a run."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def __call__(self, inputs: dict[str, NDArray[np.float64]], rows: int) -> tuple[float, int]:
        made = self._function(**inputs)
        value, count = made if isinstance(made, tuple) else (made, rows)
        return float(value), int(count)


class _Model:
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
            raise ValueError(f"`{name}` of get_numbers() must be a number or a vector with an identifier as its name")
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


def _describe(error: BaseException, tb: types.TracebackType | None) -> str:
    """Text of an exception with its traceback, which starts in the code of the part."""
    while tb is not None and tb.tb_frame.f_code.co_filename == _HERE and tb.tb_next is not None:
        tb = tb.tb_next
    name = "".join(traceback.format_exception_only(error)).strip()
    return f"{name}\n{''.join(traceback.format_exception(type(error), error, tb)).rstrip()}"
