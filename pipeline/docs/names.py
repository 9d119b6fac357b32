#!/usr/bin/env python3
"""Checks the names of magline in the dictionaries: python3 names.py MAGLINE PAGE...

MAGLINE is the program. In each table whose last column is `magline`, every code span of that column must be a name that
the program or the Python package declares:

- `magline COMMAND [COMMAND] [--FLAG]...`, with the flags of its help; `magline.MODULE.FUNCTION` of the package;
- `key = value`, a key of a stage, model, filter or section that the same cell names, or of a table of files or a map;
- `[section]` of a spec or a simulation;
- any other code span: a stage, model, filter, metric, key or column of the reference. A key in "`key` of `owner`" must
  be a key of this owner.

A cell without a code span must begin with "not there". `magnav-jl.md` must have each name of `magnav-exports.txt` once.
"""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

DOCS = Path(__file__).resolve().parent
PACKAGE = DOCS.parent / "python" / "magline"
SPEC_SECTIONS = {"[tables.NAME]", "[axes]", "[search]", "[search.axes]", "[[stages]]", "[publish]"}
SPAN = re.compile(r"`([^`]+)`")


@cache
def output(*arguments: str) -> str:
    run = subprocess.run([sys.argv[1], *arguments], capture_output=True, text=True)
    return run.stdout if run.returncode == 0 else ""


def keys(section: str) -> set[str]:
    """Returns the keys in the tables of parameters of a section."""
    return set(re.findall(r"(?m)^\| `(\w+)` \|", section))


class Names:
    """Names that the program declares."""

    def __init__(self) -> None:
        reference = output("stages", "--markdown")
        intro, *stages = re.split(r"(?m)^## ", reference)
        self.common = keys(intro)
        self.owners: dict[str, set[str]] = {}
        for stage in stages:
            name = stage.split("`")[1]
            own, *parts = re.split(r"(?m)^### The (?:model|filter) ", stage)
            inputs = " ".join(re.findall(r"Inputs: (.*)$", own, re.M))
            self.owners[name] = keys(own) | set(SPAN.findall(inputs))
            for part in parts:
                self.owners.setdefault(part.split("`")[1], set()).update(keys(part))
        search, synth = output("stages", "search"), output("stages", "synth")
        self.sections = SPEC_SECTIONS | set(re.findall(r"(?m)^#+ `(\[.*\])`", synth))
        self.owners["[search]"] = set(re.findall(r"(?m)^(?:\| `|  )(\w+)", search))
        text = re.sub(r"(?ms)^```.*?^```$", "", reference)
        spans = [span for line in text.splitlines() for span in SPAN.findall(line)]
        self.known = set(re.findall(r"\w+", " ".join(spans)))

    def is_key(self, name: str) -> bool:
        return any(name in owned for owned in self.owners.values())

    def fault(self, span: str, cell: list[str]) -> str | None:
        """Returns the reason why a code span is no name of magline."""
        if span.startswith("magline "):
            return command(span)
        if span.startswith("magline."):
            return None if span in functions() else "no such function of the package"
        if span.startswith("["):
            return None if span in self.sections else "no such section"
        if span.startswith("-"):
            return None
        key = re.match(r"(\w+)\s*=\s*", span)
        if key:
            owned = self.common.union(*(self.owners.get(name, set()) for name in cell))
            return None if key[1] in owned else f"no key `{key[1]}` of {', '.join(cell)}"
        name = re.sub(r"\(.*\)$", "", span)
        return None if name in self.known or name in self.owners else "not in the reference"


def command(span: str) -> str | None:
    words = span.split()[1:]
    path = [word for word in words if not word.startswith("-")]
    text = output(*path, "--help")
    if not text:
        return "no such command"
    flags = set(re.findall(r"--?[a-zA-Z][\w-]*", text))
    missing = [word for word in words if word.startswith("-") and word not in flags]
    return f"no flag {', '.join(missing)}" if missing else None


@cache
def functions() -> frozenset[str]:
    """Returns the public names of the package, such as `magline.run` and `magline.maps.upward`."""
    found = set()
    for file in PACKAGE.glob("*.py"):
        prefix = "magline" if file.stem == "__init__" else f"magline.{file.stem}"
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                found.add(f"{prefix}.{node.name}")
                if isinstance(node, ast.ClassDef):
                    members = [m for m in node.body if isinstance(m, ast.FunctionDef)]
                    found |= {f"{prefix}.{node.name}.{m.name}" for m in members}
            elif isinstance(node, ast.ImportFrom):
                found |= {f"{prefix}.{alias.name}" for alias in node.names}
    # Names that `__init__` imports keep their members.
    exported = {name.split(".")[1] for name in found if name.count(".") == 1}
    for name in list(found):
        parts = name.split(".")
        if len(parts) > 2 and parts[2] in exported:
            found.add(".".join(["magline", *parts[2:]]))
    return frozenset(found)


def cells(row: str) -> list[str]:
    return [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", row.strip().strip("|"))]


def check(page: Path, names: Names) -> list[str]:
    faults, first = [], []
    lines = page.read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines):
        if not (line.startswith("|---") or line.startswith("|:--")) or cells(lines[number - 1])[-1] != "magline":
            continue
        for at, row in enumerate(lines[number + 1:], number + 2):
            if not row.startswith("|"):
                break
            columns = cells(row)
            first += SPAN.findall(columns[0])
            spans = SPAN.findall(columns[-1])
            bare = [re.sub(r"^magline (?!\w+$).*|^magline ", "", span) for span in spans]
            owners = [span for span in bare if span in names.owners or span in names.sections]
            # A model or filter that a key selects also owns keys.
            owners += [value for span in spans for value in re.findall(r'"(\w+)"', span) if value in names.owners]
            for key, owner in re.findall(r"`(\w+)` of `(\w+)`", columns[-1]):
                if owner in names.owners and key not in names.owners[owner] and names.is_key(key):
                    faults.append(f"{page}:{at}: `{key}` is no key of `{owner}`")
            if not spans and not columns[-1].startswith("not there"):
                faults.append(f"{page}:{at}: neither a name of magline nor \"not there\"")
            for span in spans:
                # The reason of "not there" may name the other program's functions.
                fault = names.fault(span, owners)
                if fault and not (columns[-1].startswith("not there") and span in first):
                    faults.append(f"{page}:{at}: `{span}`: {fault}")
    if page.name == "magnav-jl.md":
        exports = (page.parent / "magnav-exports.txt").read_text(encoding="utf-8").split()
        faults += [f"{page}: `{name}` is missing" for name in exports if name not in first]
        faults += [f"{page}: `{name}` occurs twice" for name in set(first) if first.count(name) > 1]
    return faults


def main() -> int:
    names = Names()
    pages = [Path(page) for page in sys.argv[2:]]
    found = [fault for page in pages for fault in check(page, names)]
    print("\n".join(found) if found else f"{len(pages)} dictionaries: all names are those of magline")
    return 1 if found else 0


if __name__ == "__main__":
    if len(sys.argv) < 3:
        raise SystemExit(__doc__)
    raise SystemExit(main())
