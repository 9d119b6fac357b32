"""Declarations of the stages, in the text that ``magline stages --markdown`` and ``magline stages search`` print.

`read_declarations` and the functions that it calls are the only ones that know the form of this text.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass
class Parameter:
    """Declaration of one key."""

    key: str
    type: str
    unit: str
    default: str
    allowed: str
    text: str
    #: Models or filters that have the key; empty if all have it.
    owners: list[str] = field(default_factory=list)

    @property
    def required(self) -> bool:
        return self.default == "must be given"


@dataclass
class Input:
    """Declaration of one input of a stage."""

    key: str
    text: str

    @property
    def many(self) -> bool:
        return self.text.startswith("one or several")

    @property
    def required(self) -> bool:
        return not self.text.endswith(", optional")


@dataclass
class Variant:
    """Declaration of a model or filter."""

    name: str
    text: list[str]
    source: str
    parameters: list[Parameter]


@dataclass
class Stage:
    """Declaration of one stage."""

    kind: str
    text: list[str]
    source: str
    inputs: list[Input]
    #: Keys of the stage, then those of its models or filters.
    parameters: list[Parameter]
    #: Keys of the stage.
    shared: list[Parameter]
    variants: list[Variant]


@dataclass
class Declarations:
    """All declarations of a spec."""

    stages: list[Stage]
    sources: list[Parameter]
    search: list[Parameter]
    search_axis: list[Parameter]
    common: dict[str, str]


def read_declarations(reference: str, search: str) -> Declarations:
    """Declarations in the printed reference of the stages and of a search."""
    head, *chapters = re.split(r"^## ", reference, flags=re.MULTILINE)
    common = {key: text for key, text in re.findall(r"^\| `(\w+)` \| ([^|]+) \|$", head, re.MULTILINE)}
    kinds = re.split(r"^For (flights|a map|a model)\b", head, flags=re.MULTILINE)[1:]
    named = [(name.removeprefix("a "), rows(part)) for name, part in zip(kinds[::2], kinds[1::2], strict=True)]
    sources = merged([(f"tables of {name}" if name == "flights" else f"{name}s", found) for name, found in named])
    trial, axis = (rows(search.partition(mark)[2]) for mark in ("\n`[search]`", "\n`[search.axes]"))
    return Declarations([stage(one) for one in chapters], sources, trial, axis, common)


def stage(chapter: str) -> Stage:
    """Declaration of a stage in its chapter."""
    own, *parts = re.split(r"^### The (?:model|filter) ", chapter, flags=re.MULTILINE)
    kind = match(r"`(\w+)`", own)
    grain = match(r"^(Works on .*)$", own)
    inputs = [Input(key, text) for key, text in re.findall(r"`(\w+)` \(([^)]*)\)", grain)]
    text, source = prose(own.partition("\n\n")[2].partition(grain)[0])
    variants = [variant(part) for part in parts]
    shared = rows(own)
    known = {one.key for one in shared}
    special = merged([(f"`{one.name}`", one.parameters) for one in variants])
    special = [one for one in special if one.key not in known]
    return Stage(kind, text, source, inputs, shared + special, shared, variants)


def variant(part: str) -> Variant:
    """Declaration of a model or filter in its section."""
    text, source = prose(part.partition("\n\n")[2].partition("\n| parameter |")[0])
    return Variant(match(r"^`(.+?)`", part), text, source, rows(part))


def prose(text: str) -> tuple[list[str], str]:
    """Paragraphs of a text, and its source."""
    source = re.search(r"^Source: (.*)$", text, re.MULTILINE)
    if source is not None:
        text = text.replace(source.group(0), "")
    # A bar in a cell of a table has a backslash, which Python would read as an escape.
    return text.strip().replace(r"\|", "|").split("\n\n"), source.group(1) if source else ""


def rows(text: str) -> list[Parameter]:
    """Parameters in the first table of a text that has them."""
    table = re.search(r"^\| (?:parameter|key) \| type \| unit .*\n\|[-|]+\n((?:\|.*\n?)*)", text, re.MULTILINE)
    cells = [re.split(r"(?<!\\)\|", line)[1:-1] for line in table.group(1).splitlines()] if table else []
    plain = ([str(cell).strip().replace(r"\|", "|") for cell in row] for row in cells)
    return [
        Parameter(key.strip("`"), type_of, unit, default, allowed, text)
        for key, type_of, unit, default, allowed, text in plain
    ]


def merged(variants: Sequence[tuple[str, list[Parameter]]]) -> list[Parameter]:
    """Parameters of several models, each key and meaning once."""
    found: list[Parameter] = []
    for owner, parameters in variants:
        for one in parameters:
            same = [p for p in found if (p.key, p.type, p.default, p.allowed, p.text) == (one.key, *facts(one))]
            if same:
                same[0].owners.append(owner)
            else:
                found.append(Parameter(one.key, one.type, one.unit, one.default, one.allowed, one.text, [owner]))
    return found


def facts(one: Parameter) -> tuple[str, str, str, str]:
    return one.type, one.default, one.allowed, one.text


def match(pattern: str, text: str) -> str:
    """First group of a pattern, which must occur."""
    found = re.search(pattern, text, re.MULTILINE)
    if found is None:
        raise SystemExit(f"the declarations do not contain {pattern!r} in {text[:80]!r}")
    return found.group(1)
