"""Conversion of Python values to TOML, for specs given as dicts and for overrides."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import date, datetime, time
from pathlib import PurePath
from typing import Any


def document(spec: Mapping[str, Any]) -> str:
    """TOML document of a spec.

    Parameters
    ----------
    spec : mapping
        Keys of the spec. A value is a bool, int, float, str, path, date, time, list, tuple, NumPy
        scalar or array, or mapping. A key with the value None is omitted; None in a list is an
        error.

    Returns
    -------
    str
        The document: single keys, then a section for each mapping and for each item of a list of
        mappings, with one line per key.
    """
    given = {key: item for key, item in spec.items() if item is not None}
    sections = {key: item for key, item in given.items() if isinstance(item, Mapping) or _is_list_of_tables(item)}
    parts = [_pairs({key: item for key, item in given.items() if key not in sections})]
    for key, item in sections.items():
        parts += _section(_key(key), item)
    return "\n".join(part for part in parts if part)


def _section(key: str, item: Any) -> Iterator[str]:
    """Text of a section; a mapping that contains mappings only has one section for each."""
    if _is_list_of_tables(item):
        for one in item:
            yield f"[[{key}]]\n{_pairs(one)}"
    elif item and all(isinstance(one, Mapping) for one in item.values()):
        for name, one in item.items():
            yield f"[{key}.{_key(name)}]\n{_pairs(one)}"
    else:
        yield f"[{key}]\n{_pairs(item)}"


def _is_list_of_tables(item: Any) -> bool:
    listed = isinstance(item, Sequence) and not isinstance(item, str)
    return listed and len(item) > 0 and all(isinstance(one, Mapping) for one in item)


def _pairs(given: Mapping[str, Any]) -> str:
    """One line per key, with aligned values."""
    keys = {_key(key): item for key, item in given.items() if item is not None}
    width = max(map(len, keys), default=0)
    return "".join(f"{key:<{width}} = {value(item)}\n" for key, item in keys.items())


def value(item: Any) -> str:
    """TOML text of one value.

    Raises
    ------
    TypeError
        If the type has no TOML equivalent.
    """
    if hasattr(item, "tolist"):
        item = item.tolist()
    if isinstance(item, bool):
        return "true" if item else "false"
    if isinstance(item, int):
        return str(item)
    if isinstance(item, float):
        return _number(item)
    if isinstance(item, (str, PurePath)):
        # JSON escapes are TOML escapes, except for the delete character.
        return json.dumps(str(item), ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(item, (datetime, date, time)):
        return item.isoformat()
    if isinstance(item, Mapping):
        pairs = [f"{_key(key)} = {value(one)}" for key, one in item.items() if one is not None]
        return "{ " + ", ".join(pairs) + " }" if pairs else "{}"
    if isinstance(item, Sequence):
        return "[" + ", ".join(value(one) for one in item) + "]"
    raise TypeError(f"a spec cannot hold a value of type {type(item).__name__}: {item!r}")


def _number(item: float) -> str:
    if math.isnan(item):
        return "nan"
    if math.isinf(item):
        return "inf" if item > 0 else "-inf"
    return repr(item)


def _key(key: object) -> str:
    text = str(key)
    bare = text != "" and text.isascii() and text.replace("_", "").replace("-", "").isalnum()
    return text if bare else value(text)
