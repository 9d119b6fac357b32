"""Parts of a pipeline that are written in Python: stages, models, filters and metrics.

A decorator registers a part for this process. Specs then use its name like that of a built-in part. Its key consists of
name, version, parameters and a hash of its source, so its results are recomputed after an edit.

The hash covers the source text of the function or class, and the functions, classes and constants of the same module
that it names. It also covers the items of `depends`: functions, classes, files (`pathlib.Path`) and modules. A module
with `__version__` is identified by its version, any other module by its source. The hash does not cover imported
modules that `depends` does not list, files that the code reads, environment variables, and global objects other than
numbers, text, lists, dicts and NumPy arrays.

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

import importlib.util
import inspect
import json
import linecache
import re
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar, overload

from magline._calls import FilterCall, MetricCall, ModelCall, StageCall
from magline.declarations import Column, Param, declare, parameters_of
from magline._magline import Flight, Line, register_part, registered_parts
from magline._sources import source_hash

__all__ = ["Column", "Flight", "Line", "Param", "filter", "load_parts", "metric", "model", "registered", "stage"]

_F = TypeVar("_F", bound=Callable[..., Any])


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
        Version, which is part of the key of the results.
    name
        Name in a spec. Default: the name of the function.
    depends
        Other functions, classes, modules and files on which the results depend.

    Raises
    ------
    ValueError
        If the name belongs to a built-in stage or another function, or the source is not available.

    Examples
    --------
    >>> import magline, numpy, tempfile
    >>> @magline.stage(reads={"mag_1_uc": "nT"}, makes={"absolute": "nT"}, version=1)
    ... def absolute(line):
    ...     '''Magnitude of the signal.'''
    ...     return numpy.abs(line["mag_1_uc"])
    >>> spec = magline.Spec("own_stage", store=tempfile.mkdtemp())
    >>> sample = "datasets/samples/magnavjl_tl/magnavjl_tl.parquet"
    >>> names = {"time_s": "tt", "mag_1_uc_nt": "mag_1_uc"}
    >>> flights = spec.table("flights", sample, flight="1", line="1", rename=names)
    >>> table = spec.stage("absolute", name="absolute", input=flights)
    >>> rows = spec.run().table("absolute").polars()
    >>> bool((rows["absolute"] == rows["mag_1_uc"].abs()).all())
    True
    """

    def register(function: _F) -> _F:
        parameters = parameters_of(function, lambda p: p.kind is inspect.Parameter.KEYWORD_ONLY)
        read = reads.items() if isinstance(reads, Mapping) else [(column, None) for column in reads]
        columns = [(column, Column(unit) if isinstance(unit, str) else unit) for column, unit in makes.items()]
        texts = {p["name"] for p in parameters if p["type"] in ("text", "list of text")}
        for template in [*(column for column, _ in read), *makes]:
            unknown = set(re.findall(r"\{([^}]*)\}", template)) - texts
            if unknown:
                raise ValueError(f"`{template}` names {sorted(unknown)}, which are not text parameters of the stage")
        declaration = declare(function, name, version, parameters) | {
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
        _register("stage", function, depends, declaration, StageCall(function))
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

    The estimator has ``fit(x, y)`` and ``predict(x)``, like an estimator of scikit-learn: ``x`` is (n, k), one column
    per entry of `features`; ``y`` (nT) is (n,). The rows are the unfiltered samples of all lines of the fit, without
    rows that have a NaN. `predict` returns (n,), nT, or a pair of prediction and standard deviation. `fit` may also
    accept ``groups`` (the number of the line of each row) and ``names`` (the names of the columns).

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
        Version, which is part of the key of the results.
    name
        Name in a spec. Default: the name of the class or function.
    keys
        Arguments that are parameters. Default: all with a known type.
    depends
        Other functions, classes, modules and files on which the results depend.

    Examples
    --------
    >>> import magline
    >>> def shift():
    ...     '''The first feature plus a constant.'''
    ...     class Shift:
    ...         def fit(self, x, y):
    ...             self.shift_nt = (y - x[:, 0]).mean()
    ...         def predict(self, x):
    ...             return x[:, 0] + self.shift_nt
    ...     return Shift()
    >>> made = magline.model(shift, version=1)
    >>> [part.kind for part in magline.parts.registered() if part.name == "shift"]
    ['model']
    """

    def register(made: Any) -> Any:
        parameters = parameters_of(made, lambda p: keys is None or p.name in keys)
        missing = set(keys or ()) - {p["name"] for p in parameters}
        if missing:
            raise ValueError(f"`{made.__name__}` lacks the arguments {sorted(missing)}, or their types are unknown")
        _register("model", made, depends, declare(made, name, version, parameters), ModelCall(made))
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
        Version, which is part of the key of the results.
    needs_map
        Whether the filter uses a map.
    name
        Name in a spec. Default: the name of the function.
    depends
        Other functions, classes, modules and files on which the results depend.

    Examples
    --------
    >>> import magline
    >>> @magline.filter(version=1, needs_map=False)
    ... def dead_reckoning(flight):
    ...     '''Position of the INS.'''
    ...     return {"lat": flight["lat"], "lon": flight["lon"]}
    >>> [part.kind for part in magline.parts.registered() if part.name == "dead_reckoning"]
    ['filter']
    """

    def register(function: _F) -> _F:
        parameters = parameters_of(function, lambda p: p.kind is inspect.Parameter.KEYWORD_ONLY)
        declaration = declare(function, name, version, parameters) | {"needs_map": needs_map}
        _register("filter", function, depends, declaration, FilterCall(function))
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
        Version, which is part of the key of the results.
    pool
        Pooling over lines: root mean square or mean, weighted by samples, or sum.
    better
        Preferred values; a number is a target.
    name
        Name in a spec. Default: the name of the function.
    depends
        Other functions, classes, modules and files on which the results depend.

    Examples
    --------
    >>> import magline, numpy
    >>> @magline.metric(unit="nT", version=1, pool="mean")
    ... def mean_absolute_error(error):
    ...     '''Mean absolute error of the compensated field.'''
    ...     return numpy.abs(error).mean()
    >>> float(mean_absolute_error(numpy.array([1.0, -3.0])))
    2.0
    """

    def register(function: _F) -> _F:
        declaration = declare(function, name, version, []) | {
            "unit": unit,
            "pool": pool,
            "better": better if isinstance(better, str) else {"near": float(better)},
            "needs": list(inspect.signature(function).parameters),
        }
        declaration["doc"] = declaration["doc"].strip().partition("\n\n")[0].replace("\n", " ").rstrip(".")
        _register("metric", function, depends, declaration, MetricCall(function))
        return function

    return register


def load_parts(path: str | Path) -> types.ModuleType:
    """Run a Python file that registers parts, and return its module.

    The file can import modules of its folder. The command ``magline --parts FILE.py`` does the same, and so do its
    worker processes.

    Examples
    --------
    >>> import magline, pathlib, tempfile
    >>> file = pathlib.Path(tempfile.mkdtemp()) / "parts.py"
    >>> _ = file.write_text(
    ...     "import magline\\n"
    ...     "@magline.metric(unit='nT', version=1)\\n"
    ...     "def largest_error(error):\\n"
    ...     "    return abs(error).max()\\n"
    ... )
    >>> module = magline.load_parts(file)
    >>> [part.name for part in magline.parts.registered() if part.name == "largest_error"]
    ['largest_error']
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
