"""Hash of the source text of a part, which is in the keys of its results."""

from __future__ import annotations

import functools
import hashlib
import inspect
import sys
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np


def source_hash(part: object, depends: Sequence[object]) -> str:
    """Hash of the source of a function or class and of `depends`, 32 hexadecimal digits."""
    hasher = hashlib.sha256()
    seen: set[int] = set()
    for item in [part, *depends]:
        for text in _texts(item, seen):
            hasher.update(len(text).to_bytes(8, "little"))
            hasher.update(text)
    return hasher.hexdigest()[:32]


def _texts(item: object, seen: set[int]) -> Iterator[bytes]:
    """Source of an item, and of the functions, classes and constants of its module that it names."""
    item = inspect.unwrap(item) if callable(item) else item
    if id(item) in seen:
        return
    seen.add(id(item))
    if isinstance(item, ModuleType):
        yield _module(item)
    elif isinstance(item, Path):
        yield item.read_bytes()
    elif isinstance(item, FunctionType):
        _reject_captured(item)
        yield _text(item)
        yield from _named(item.__code__, item.__globals__, item.__module__, seen)
    elif isinstance(item, type):
        yield _text(item)
        for base in item.__bases__:
            if base.__module__ == item.__module__:
                yield from _texts(base, seen)
        for member in vars(item).values():
            function = getattr(member, "__func__", member)
            function = getattr(function, "fget", function)
            if isinstance(function, FunctionType) and function.__module__ == item.__module__:
                yield from _named(function.__code__, function.__globals__, item.__module__, seen)
    else:
        raise TypeError(f"a part cannot depend on {item!r}; use a function, class, module or pathlib.Path")


@functools.cache
def _text(item: Any) -> bytes:
    """Version of the package of an item, and its source when it is first read."""
    try:
        text = textwrap.dedent(inspect.getsource(item))
    except (OSError, TypeError) as error:
        name = getattr(item, "__qualname__", repr(item))
        raise ValueError(f"the source of `{name}` is not available; define it in a file or a notebook") from error
    root = sys.modules.get(item.__module__.partition(".")[0])
    return f"{_version(root)}{text}".encode()


def _module(module: ModuleType) -> bytes:
    """Name and version of a module; without a version, its source."""
    version = _version(module)
    if version:
        return f"{module.__name__} {version}".encode()
    file = getattr(module, "__file__", None)
    if file is None or not file.endswith(".py"):
        raise ValueError(f"the module `{module.__name__}` has neither a version nor a source file")
    folder = Path(file).parent
    files = sorted(folder.rglob("*.py")) if hasattr(module, "__path__") else [Path(file)]
    return b"\0".join(path.read_bytes() for path in files)


def _version(module: ModuleType | None) -> str:
    version = getattr(module, "__version__", "")
    return f"{version}\n" if isinstance(version, str) and version else ""


def _reject_captured(function: FunctionType) -> None:
    """Reject variables of an enclosing function: the source does not contain their values."""
    names = function.__code__.co_freevars
    for name, cell in zip(names, function.__closure__ or (), strict=True):
        try:
            value = cell.cell_contents
        except ValueError:
            continue
        if not isinstance(value, ModuleType):
            raise ValueError(
                f"`{function.__qualname__}` uses the variable `{name}` of an enclosing function, but its source does "
                f"not contain the value of `{name}`; make it a parameter, or define it in the module"
            )


def _named(code: CodeType, scope: dict[str, Any], module: str, seen: set[int]) -> Iterator[bytes]:
    """Sources and values of the global names that a code object uses."""
    for name in code.co_names:
        if name not in scope:
            continue
        value = scope[name]
        if hasattr(value, "__wrapped__"):
            value = inspect.unwrap(value)
        if isinstance(value, FunctionType | type):
            if value.__module__ == module:
                yield from _texts(value, seen)
        elif _is_plain(value):
            yield f"{name}={value!r}".encode()
        elif isinstance(value, np.ndarray) and value.dtype != object:
            yield f"{name}={value.dtype.str}{value.shape}".encode() + value.tobytes()
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _named(constant, scope, module, seen)


def _is_plain(value: object) -> bool:
    if isinstance(value, tuple | list):
        return all(_is_plain(one) for one in value)
    if isinstance(value, dict):
        return all(_is_plain(key) and _is_plain(one) for key, one in value.items())
    return value is None or isinstance(value, bool | int | float | complex | str | bytes)
