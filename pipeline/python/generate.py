"""Prints `magline/_stages.py` or `magline/_filters.py`, made from the declarations of the stages.

``python generate.py MAGLINE > magline/_stages.py`` and ``python generate.py MAGLINE filters > magline/_filters.py``,
with the path of the command `magline`. `declarations.py` reads the declarations.
"""

from __future__ import annotations

import keyword
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any

from declarations import Declarations, Parameter, Stage, Variant, read_declarations

WIDTH = 100
#: Name of a keyword, its type hint, whether it must be given, and its description. `!` marks a positional argument.
Key = tuple[str, str, bool, list[str]]
RESERVED = ("name", "where", "publish", "carry", "keep")


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
    name: str, call: str, result: str, text: list[str], keys: list[Key], source: str = "", more: Sequence[str] = ()
) -> list[str]:
    """Lines of a method. A key has a name, a type hint, whether it must be given, and its description. `more` are the
    sections of the docstring after the parameters."""
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
        lines += [" " * 8 + row for row in one.splitlines()] if one.startswith("| ") else paragraph(one, " " * 8)
    lines += ["", "        Parameters", "        ----------"]
    for key, kind, needed, described in keys:
        plain = re.sub(r"\bLiteral\[([^]]*)\]", r"{\1}", kind.removesuffix(" | Axis"))
        lines += paragraph(f"{key.strip('!')} : {plain}{'' if needed else ', optional'}", " " * 8)
        lines += described
    lines += more
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
    "embargo": ("str", "First day of permitted publication, `YYYY-MM-DD`. Unset: the restriction does not end."),
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


FILTERS_HEAD = '''"""Filters of the stage `navigate` as functions on arrays.

Made from the declarations by `generate.py filters`; do not edit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from numpy.typing import ArrayLike

from magline._track import ListLike, Magnetometers, Track, navigate_line
from magline.maps import Map

'''

# Filters that require no map, or the table of a trained network. `magline.filters.navigate` runs them.
OTHER_FILTERS = ("ekf_online_nn", "nekf", "slam", "ins_only")
# Filters that use terms of the aircraft field, and calibrations.
AIRCRAFT_FILTERS = ("ekf_online_tl", "fixed_lag")

LINE_INPUTS = [
    ("!tt_s", "ArrayLike", True, "Times of the samples, s, ascending, of shape (samples,)."),
    ("!ins_lat_deg", "ArrayLike", True, "Latitude of the INS, degrees, of shape (samples,)."),
    ("!ins_lon_deg", "ArrayLike", True, "Longitude of the INS, degrees, of shape (samples,)."),
    ("!ins_alt_m", "ArrayLike", True, "Height of the INS above the WGS-84 ellipsoid, m, of shape (samples,)."),
    (
        "!mag_nt",
        "Magnetometers",
        True,
        "Measured field, nT, of shape (samples,); NaN where there is no measurement. A mapping holds several "
        "magnetometers under the names of their columns, such as `mag_1_c` (compensated) or `mag_1_uc`.",
    ),
    ("!map", "Map", True, "Anomaly map, such as the result of `magline.maps.open`."),
    (
        "ins_velocity_ned_mps",
        "ArrayLike",
        False,
        "Velocity of the INS north, east and down, m/s, of shape (samples, 3). Default: derived from its positions.",
    ),
    (
        "ins_force_ned_mps2",
        "ArrayLike",
        False,
        "Specific force of the INS north, east and down, m/s^2, of shape (samples, 3). Default: derived from its "
        "velocities.",
    ),
    (
        "ins_attitude_deg",
        "ArrayLike",
        False,
        "Roll, pitch and yaw of the INS, degrees, of shape (samples, 3). Default: level, along the course.",
    ),
    (
        "columns",
        "Mapping[str, Any]",
        False,
        "Further columns of the flight table under their names, in its units: those that keys name, and those that "
        "the stage uses if they are there, such as `diurnal` (nT), `year`, `doy`, `gnss_lat` (deg), `ins_aligned` "
        "(s), and the truth `lat` and `lon` (deg) and `alt` (m). A value is an array of shape (samples,), one number "
        "or text for all samples, or a pair of a matrix with one row per sample and the names of its columns.",
    ),
]
AIRCRAFT_INPUTS = [
    (
        "models",
        "Sequence[Any]",
        False,
        "Calibrations that give the prior of the coefficients: tables of `fit` as mappings or data frames with the "
        "columns `term`, `value`, `std` (nT) and, if known, `rate_hz` (Hz). Default: a cold start.",
    ),
    (
        "rate_hz",
        "float",
        False,
        "Sample rate of the terms that are differences per sample, Hz. Default: the rate of `tt_s`.",
    ),
]
TRACK_SECTIONS = """
        Returns
        -------
        Track
            Estimate at each sample, innovations, warnings and notes.

        Raises
        ------
        SpecError
            If a key is unknown, has an invalid value, or has no effect.
        DataError
            If the line cannot be filtered, such as an INS with a NaN or a line off the map.
        ValueError
            If the shapes of the arrays differ."""
FLIGHT_EXAMPLE = """
        Examples
        --------
        >>> import numpy as np
        >>> from magline import filters, maps
        >>> lat, lon = np.linspace(45.0, 45.2, 201), np.linspace(-76.1, -75.9, 201)
        >>> hills = 60.0 * np.sin(400.0 * lat[:, None]) + 50.0 * np.cos(500.0 * (lat[:, None] + lon))
        >>> field = maps.Map(lon, lat, hills, np.full(hills.shape, 300.0), 4326, "deg")
        >>> t = np.arange(100.0)  # northward over the nodes of a column; the INS is 11 m too far north
        >>> ins = t, lat[50:150] + 1e-4, np.full(100, lon[100]), np.full(100, 300.0)
        >>> start = {"start": "given", "init_position_sigma_m": 20.0}"""
# Further columns of a filter in its example, and the lines after the call. The default compares the last position.
FILTER_EXAMPLES = {
    "crlb": (
        '{"lat": lat[50:150], "lon": ins[2], "alt": ins[3]}  # the true positions',
        [">>> bool(track.more['drms_bound'][-1] < 20.0)", "True"],
    ),
    **dict.fromkeys(
        AIRCRAFT_FILTERS, ('{"tl": (np.sin(t)[:, None], ["x"])}  # one term of the aircraft field', [])
    ),
}
LAST_POSITION = [">>> bool(abs(track.lat_deg[-1] - lat[149]) < 5e-5)", "True"]


def filter_function(one: Variant, shared: Sequence[Parameter]) -> list[str]:
    """Lines of the function of a filter."""
    inputs = LINE_INPUTS + (AIRCRAFT_INPUTS if one.name in AIRCRAFT_FILTERS else [])
    keys: list[Key] = [(key, kind, needed, paragraph(text, " " * 12)) for key, kind, needed, text in inputs]
    own = [parameter for parameter in [*shared, *one.parameters] if parameter.key not in {"filter", "mag"}]
    keys += plain_keys(own, {})
    columns, check = FILTER_EXAMPLES.get(one.name, ("", []))
    given = [f">>> columns = {columns}"] if columns else []
    more = ", columns=columns" if columns else ""
    call = f">>> track = filters.{one.name}(*ins, hills[50:150, 100], field{more}, core_field=False, **start)"
    lines_of_call = [*given, call, *(check or LAST_POSITION)]
    example = [*FLIGHT_EXAMPLE.splitlines(), *(f"        {line}" for line in lines_of_call)]
    call = f'navigate_line("{one.name}", locals())'
    text = summary(one.text[0]) + one.text[1:]
    lines = method(one.name, call, "Track", text, keys, one.source, TRACK_SECTIONS.splitlines())
    end = lines.index('        """')
    lines[end:end] = example
    plain = (line.replace(" : ArrayLike", " : array_like") for line in lines if line != "        self,")
    return [line.removeprefix("    ") for line in plain] + [""]


def filters_module(found: Declarations) -> str:
    """Text of the module of the filters."""
    navigate = next(one for one in found.stages if one.kind == "navigate")
    variants = [one for one in navigate.variants if one.name not in OTHER_FILTERS]
    names = ", ".join(quoted(name) for name in sorted(one.name for one in variants))
    lines = [FILTERS_HEAD.rstrip(), "", *paragraph(f"__all__ = [{names}]", "", "    "), "", ""]
    for one in variants:
        lines += filter_function(one, navigate.shared)
    return "\n".join(line.rstrip() for line in lines).rstrip() + "\n"


def generate(program: str, wanted: str = "stages") -> str:
    """Text of the module for the command `program`."""

    def printed(*arguments: str) -> str:
        return subprocess.check_output([program, "stages", *arguments], text=True)

    makers = {"stages": module, "filters": filters_module}
    return makers[wanted](read_declarations(printed("--markdown"), printed("search")))


if __name__ == "__main__":
    sys.stdout.write(generate(*sys.argv[1:3]))
