"""Prints `magline/_stages.py`, made from the declarations of the stages.

``python generate.py MAGLINE > magline/_stages.py``, with the path of the command `magline`. The declarations are the
text of ``magline stages --markdown`` and ``magline stages search``. `read_declarations` and the functions that it calls
are the only ones that know the form of this text.
"""

from __future__ import annotations

import keyword
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

WIDTH = 100
#: Name of a keyword, its type hint, whether it must be given, and its description. `!` marks a positional argument.
Key = tuple[str, str, bool, list[str]]
RESERVED = ("name", "where", "publish", "carry", "keep")


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
class Stage:
    """Declaration of one stage."""

    kind: str
    text: list[str]
    source: str
    inputs: list[Input]
    parameters: list[Parameter]


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
    prose = own.partition("\n\n")[2].partition(grain)[0].strip()
    source = re.search(r"^Source: (.*)$", prose, re.MULTILINE)
    if source is not None:
        prose = prose.replace(source.group(0), "").strip()
    variants = [(f"`{match(r'^`(.+?)`', part)}`", rows(part)) for part in parts]
    shared = rows(own)
    known = {one.key for one in shared}
    special = [one for one in merged(variants) if one.key not in known]
    return Stage(kind, prose.split("\n\n"), source.group(1) if source else "", inputs, shared + special)


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


def hint(variants: Sequence[Parameter]) -> str:
    """Type hint of a key; the union over its variants."""
    found = dict.fromkeys(part for one in variants for part in hints(one))
    return " | ".join([*found, "Axis"])


def hints(one: Parameter) -> list[str]:
    words = re.findall(r"`([^`]+)`", one.allowed)
    literal = f"Literal[{', '.join(map(quoted, words))}]"
    base, _, word = one.type.partition(" or ")
    match base:
        case "text":
            return [literal] if words else ["str"]
        case "number":
            return ["float", f"Literal[{quoted(word.strip('`'))}]"] if word else ["float"]
        case "whole number" | "whole number below 65536":
            return ["int"]
        case "boolean":
            return ["bool"]
        case "list":
            return [f"Sequence[{literal}]"] if words else ["ListLike"]
        case "table":
            return ["Mapping[str, Any]"]
        case _:
            raise SystemExit(f"`{one.key}` has the unknown type {one.type!r}")


def quoted(word: str) -> str:
    return f'"{word}"'


def python_name(key: str) -> str:
    """Keyword of a key: a reserved word of Python gets an underscore."""
    return f"{key}_" if keyword.iskeyword(key) else key


def grouped(parameters: Sequence[Parameter]) -> Iterator[tuple[str, list[Parameter]]]:
    """Parameters by key, required ones first."""
    found: dict[str, list[Parameter]] = {}
    for one in parameters:
        found.setdefault(one.key, []).append(one)
    yield from sorted(found.items(), key=lambda item: not required(item[1]))


def required(variants: Sequence[Parameter]) -> bool:
    return all(one.required and not one.owners for one in variants)


def paragraph(text: str, indent: str, hanging: str | None = None) -> list[str]:
    """Lines of a text; `hanging` indents all but the first. A bar is escaped in Markdown only."""
    options: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
    text = text.replace(r"\|", "|")
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=hanging or indent, **options)


def about(variants: Sequence[Parameter], indent: str) -> list[str]:
    """Description of a key in a docstring."""
    lines: list[str] = []
    for one in variants:
        words = one.text if one.text.endswith(".") else f"{one.text}."
        if one.owners:
            words = f"For {', '.join(one.owners)}: {words}"
        if one.unit not in {"", "1"}:
            words += f" Unit: {one.unit}."
        if one.allowed and "`" not in one.allowed:
            words += f" Allowed: {one.allowed}."
        if one.default.startswith("unset: "):
            words += f" Unset: {one.default.removeprefix('unset: ')}."
        elif not one.required:
            words += f" Default: {one.default}."
        elif one.owners:
            words += " Must be given."
        lines += paragraph(words, indent)
    return lines


def method(
    name: str, call: str, result: str, text: list[str], keys: list[Key], source: str = ""
) -> list[str]:
    """Lines of a method. A key has a name, a type hint, whether it must be given, and its description."""
    positional = [key for key in keys if key[0].startswith("!")]
    named = [key for key in keys if not key[0].startswith("!")]
    lines = [f"    def {name}(", "        self,"]
    for group, mark in ((positional, []), (named, ["        *,"])):
        lines += mark if group else []
        for key, kind, needed, _ in group:
            whole = f"{key.strip('!')}: {kind if needed else f'{kind} | None = None'},"
            # A line may break within the brackets of a hint.
            lines += paragraph(whole, " " * 8, " " * 12)
    lines += [f"    ) -> {result}:", *paragraph('"""' + text[0], " " * 8)]
    for one in text[1:]:
        lines.append("")
        lines += [" " * 8 + row for row in one.splitlines()] if one.startswith("|") else paragraph(one, " " * 8)
    lines += ["", "        Parameters", "        ----------"]
    for key, kind, needed, described in keys:
        plain = re.sub(r"\bLiteral\[([^]]*)\]", r"{\1}", kind.removesuffix(" | Axis"))
        lines += paragraph(f"{key.strip('!')} : {plain}{'' if needed else ', optional'}", " " * 8)
        lines += described
    if source:
        lines += ["", "        References", "        ----------", *paragraph(source, " " * 8)]
    return [*lines, '        """', f"        return {call}", ""]


def stage_method(stage: Stage, common: dict[str, str]) -> list[str]:
    clash = {one.key for one in stage.parameters} & set(RESERVED)
    if clash:
        raise SystemExit(f"`{stage.kind}` has parameters named like common keys: {clash}")
    keys: list[Key] = []
    for one in stage.inputs:
        kind = "TableLike | Sequence[TableLike]" if one.many else "TableLike"
        keys.append((python_name(one.key), kind, one.required, paragraph(f"Input: {one.text}.", " " * 12)))
    for key, variants in grouped(stage.parameters):
        keys.append((python_name(key), hint(variants), required(variants), about(variants, " " * 12)))
    keys.sort(key=lambda key: not key[2])
    kinds = {"name": "str", "where": "str", "publish": "bool", "carry": "Sequence[str]", "keep": "bool"}
    for key in RESERVED:
        words = common[key][0].upper() + common[key][1:].removesuffix("; required")
        words += ". Default: the kind of the stage, with a number if that name is taken" if key == "name" else ""
        keys.append((key, kinds[key], False, paragraph(f"{words}.", " " * 12)))
    call = f'self._stage("{stage.kind}", locals())'
    return method(stage.kind, call, "TableHandle", summary(stage.text[0]) + stage.text[1:], keys, stage.source)


def summary(text: str) -> list[str]:
    """First sentence of a text, and the rest as further paragraphs. A table is a paragraph."""
    text, _, table = text.partition("\n|")
    first, _, rest = text.partition(". ")
    return [part for part in (first.removesuffix(".") + ".", rest, f"|{table}" if table else "") if part]


def plain_keys(parameters: Sequence[Parameter], extra: dict[str, tuple[str, str]]) -> list[Key]:
    keys = [
        (python_name(key), hint(variants).removesuffix(" | Axis"), required(variants), about(variants, " " * 12))
        for key, variants in grouped(parameters)
    ]
    keys.sort(key=lambda key: not key[2])
    return keys + [(key, kind, False, paragraph(text, " " * 12)) for key, (kind, text) in extra.items()]


HEAD = '''"""Methods of `Spec` for the tables, the search and the stages of a spec.

Made from the declarations by `generate.py`; do not edit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from os import PathLike

    from magline.spec import Axis, ListLike, TableHandle, TableLike


class StageMethods:
    """Methods of `Spec` that are made from the declarations."""

    def _stage(self, kind: str, given: Mapping[str, Any]) -> TableHandle:
        raise NotImplementedError

    def _table(self, given: Mapping[str, Any]) -> TableHandle:
        raise NotImplementedError

    def _search(self, given: Mapping[str, Any]) -> None:
        raise NotImplementedError

    def _search_axis(self, given: Mapping[str, Any]) -> Axis:
        raise NotImplementedError

'''

# Keys that the reference describes in its prose or not at all.
TABLE_EXTRA = {
    "where": ("str", "For a model: SQL condition on its columns that selects one model of several."),
    "restricted": (
        "bool | Sequence[str]",
        "True for the whole table, or the names of columns. `magline publish` rejects results made from them row by "
        "row. Default: False.",
    ),
    "embargo": ("str", "First day of permitted publication, `YYYY-MM-DD`. Unset: no end of the restriction."),
    "reason": ("str", "Reason of the restriction, for messages. Unset: no reason."),
    "least_samples": (
        "int",
        "Minimum number of samples behind each published score or coefficient that is computed from restricted "
        "columns. Default: 100.",
    ),
    "least_ratio": ("float", "Minimum number of samples per published number of one aggregate. Default: 10.0."),
}
SEARCH_EXTRA = {
    "where": ("str", "SQL predicate on `flight` and `line` that selects the lines of the goal."),
    "halving": ("Mapping[str, Any]", "Successive halving: `axis`, its `values`, the cheapest first, and `eta`."),
}


def module(found: Declarations) -> str:
    """Text of the module."""
    lines = [HEAD]
    path = "File, folder, glob or address of the files; or a spec of simulated flights."
    first = [leading("name", "str", "Name of the table."), leading("path", "str | PathLike[str]", path)]
    text = ["Declares a table that is read from files: flights, a map or a model."]
    keys = first + plain_keys(found.sources, TABLE_EXTRA)
    lines += method("table", "self._table(locals())", "TableHandle", text, keys)
    text = ["Declares a search, which proposes the values of the axes of `search_axis`."]
    lines += method("search", "self._search(locals())", "None", text, plain_keys(found.search, SEARCH_EXTRA))
    first = [
        leading("name", "str", "Name of the axis."),
        leading("choices", "Sequence[Any]", "Values to choose from. Default: all values from `low` to `high`.", False),
    ]
    ends = [(key, kind, False, described) for key, kind, _, described in plain_keys(found.search_axis, {})]
    text = ["Declares an axis whose values a search proposes."]
    lines += method("search_axis", "self._search_axis(locals())", "Axis", text, first + ends)
    for one in found.stages:
        lines += stage_method(one, found.common)
    text_of = "\n".join(line.rstrip() for line in lines)
    return text_of.rstrip() + "\n"


def leading(name: str, kind: str, text: str, needed: bool = True) -> Key:
    """Positional argument."""
    return f"!{name}", kind, needed, paragraph(text, " " * 12)


def generate(program: str) -> str:
    """Text of the module for the command `program`."""

    def printed(*arguments: str) -> str:
        return subprocess.check_output([program, "stages", *arguments], text=True)

    return module(read_declarations(printed("--markdown"), printed("search")))


if __name__ == "__main__":
    sys.stdout.write(generate(sys.argv[1]))
