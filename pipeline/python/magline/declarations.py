"""Declarations of parts: their columns and parameters, from annotations and defaults."""

from __future__ import annotations

import inspect
import re
import sys
import types
import typing
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

_NAME = re.compile(r"[a-z][a-z0-9_]*\Z")


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

    Examples
    --------
    >>> import magline
    >>> column = magline.Column("nT", doc="signal minus its mean")
    >>> @magline.stage(reads={"mag_1_uc": "nT"}, makes={"centred": column}, version=1)
    ... def subtract_mean(line):
    ...     return line["mag_1_uc"] - line["mag_1_uc"].mean()
    >>> column.unit, column.doc
    ('nT', 'signal minus its mean')
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

    Examples
    --------
    >>> import magline
    >>> from typing import Annotated
    >>> window = magline.Param("s", doc="length of the window", least=0.0)
    >>> @magline.stage(reads={"mag_1_uc": "nT"}, makes={"slow": "nT"}, version=1)
    ... def slow_part(line, *, window_s: Annotated[float, window] = 1.0):
    ...     return line["mag_1_uc"]
    >>> window.unit, window.least
    ('s', 0.0)
    """

    unit: str = ""
    doc: str = ""
    least: float | None = None
    most: float | None = None


def declare(part: Any, name: str | None, version: int, parameters: list[dict[str, Any]]) -> dict[str, Any]:
    """Properties that all parts have."""
    called = name or part.__name__
    if not _NAME.match(called):
        raise ValueError(f"`{called}` is not a valid name for a part; use lower-case letters, digits and `_`")
    if isinstance(version, bool) or not isinstance(version, int) or not 1 <= version < 2**32:
        raise ValueError(f"the version of `{called}` must be a whole number of at least 1, not {version!r}")
    module = sys.modules.get(part.__module__)
    return {
        "name": called,
        "version": version,
        "doc": inspect.cleandoc(part.__doc__ or f"Written in Python: {part.__qualname__}."),
        "origin": f"{getattr(module, '__file__', part.__module__)}: {part.__qualname__}",
        "params": parameters,
    }


def parameters_of(made: Any, is_wanted: Callable[[inspect.Parameter], bool]) -> list[dict[str, Any]]:
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
