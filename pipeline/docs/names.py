#!/usr/bin/env python3
"""Checks the names of magline in the dictionaries: python3 names.py MAGLINE PAGE...

MAGLINE is the program. In each table whose last column is `magline`, every code span of that column must be a name that
the program or the Python package declares:

- `magline COMMAND [COMMAND] [--FLAG]...`, with the flags of its help; `magline.MODULE.FUNCTION` of the package;
- `key = value`, a key of a stage, model, filter or section that the same cell names, or of a table of files or a map,
  with values that the reference has;
- `[section]` of a spec or a simulation;
- `NAME.toml`, an example or a preset;
- any other code span: a stage, model, filter, metric, key or column of the reference, or a key of a simulation. A key
  in "`key` of `owner`" must be a key of this owner.

A cell without a code span must begin with "not there". In a cell with `magline report` or `magline view`, a text in
italics must be a title on their pages.

A page NAME.md with a list NAME.txt must have each entry of the list once in the first column, as `name`, "Table 3.1",
"Figures 4-5 to 4-9" or "(3.2) to (3.11)". It must state the number of entries. A link "[figures](PAGE)" claims that
PAGE has own and published figures: PAGE must mention the table or figure.

The pages of equations in `explanation/` must name every filter, model and metric. `test_names.py` tests these checks.
"""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

DOCS = Path(__file__).resolve().parent
PIPELINE = DOCS.parent
PACKAGE = PIPELINE / "python" / "magline"
DATASETS = PIPELINE.parent / "datasets"
SPEC_SECTIONS = {"[tables.NAME]", "[axes]", "[search]", "[search.axes]", "[[stages]]", "[publish]"}
SPAN = re.compile(r"`([^`]+)`")
NUMBER = r"(?:[A-D]\.)?\d+(?:[.-]\d+)?"
NUMBERS = re.compile(rf"(?:Table|Figure|Algorithm)s? {NUMBER}(?:(?:, | and | to ){NUMBER})*")
FIGURES = re.compile(r"\[figures\]\(([^)#]+)[^)]*\)")


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
        self.owners["[search]"] = set(re.findall(r"(?m)^(?:\| `|  )(\w+)", search))
        _, *parts = re.split(r"(?m)^### `(\[.*\])`", synth)
        simulation = {name: keys(body) for name, body in zip(parts[::2], parts[1::2], strict=True)}
        self.owners.update(simulation)
        self.sections = SPEC_SECTIONS | set(simulation)
        folders = DATASETS / "examples", DATASETS / "simulate" / "presets"
        self.specs = {file.name for folder in folders for file in folder.rglob("*.toml")}
        sources = [file for part in ("report/src", "view/src") for file in sorted((PIPELINE / part).rglob("*"))]
        shown = [file for file in sources if file.suffix in (".rs", ".js") and file.parent.name != "vendor"]
        self.titles = "\n".join(file.read_text(encoding="utf-8") for file in shown)
        text = re.sub(r"(?ms)^```.*?^```$", "", reference)
        spans = [span for line in text.splitlines() for span in SPAN.findall(line)]
        self.known = set(re.findall(r"\w+", " ".join(spans)))
        self.values = self.known | set(re.findall(r"\w+", " ".join(SPAN.findall(synth))))

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
        if span.endswith(".toml"):
            return None if span in self.specs else "no such example or preset"
        key = re.match(r"(\w+)\s*=\s*", span)
        if key:
            owned = self.common.union(*(self.owners.get(name, set()) for name in cell))
            unknown = [value for value in re.findall(r'"(\w+)"', span) if value not in self.values]
            if key[1] in owned:
                return f"no value {', '.join(unknown)}" if unknown else None
            return f"no key `{key[1]}` of {', '.join(cell)}"
        name = re.sub(r"\(.*\)$", "", span)
        is_known = name in self.known or name in self.owners or self.is_key(name)
        return None if is_known else "not in the reference"


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
                names = [alias.name for alias in node.names]
                # The generated functions of a module are imported with a star.
                source = PACKAGE / f"{(node.module or '').removeprefix('magline.')}.py"
                if names == ["*"] and source.is_file():
                    made = ast.parse(source.read_text(encoding="utf-8")).body
                    names = [n.name for n in made if isinstance(n, ast.FunctionDef | ast.ClassDef)]
                found |= {f"{prefix}.{name}" for name in names}
    # Names that `__init__` imports keep their members.
    exported = {name.split(".")[1] for name in found if name.count(".") == 1}
    for name in list(found):
        parts = name.split(".")
        if len(parts) > 2 and parts[2] in exported:
            found.add(".".join(["magline", *parts[2:]]))
    return frozenset(found)


def cells(row: str) -> list[str]:
    return [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", row.strip().strip("|"))]


def listed(page: Path) -> list[str]:
    """Returns the entries of the list of a page, such as `ekf`, `Table 3.1` and `(3.2)`."""
    file = page.with_suffix(".txt")
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    return [entry for line in lines if not line.startswith("#") for entry in re.split(r",\s*", line) if entry]


def entries(cell: str, known: list[str]) -> list[str]:
    """Returns the entries that a text names. A range has the entries between its ends in the order of the list."""
    if "`" in cell:
        return SPAN.findall(cell)
    kind, numbers = re.fullmatch(r"(?:(Table|Figure|Algorithm)s? )?(.*)", cell).groups()
    found = []
    for part in re.split(r", | and ", numbers):
        ends = [f"{kind} {end}" if kind else end for end in part.split(" to ")]
        is_range = len(ends) == 2 and all(end in known for end in ends)
        found += known[known.index(ends[0]):known.index(ends[1]) + 1] if is_range else ends
    return found


def cell_faults(cell: str, foreign: list[str], names: Names) -> list[str]:
    """Returns the faults of a cell in the column `magline`; `foreign` has names of the other program."""
    spans, faults = SPAN.findall(cell), []
    bare = [re.sub(r"^magline (?!\w+$).*|^magline ", "", span) for span in spans]
    owners = [span for span in bare if span in names.owners or span in names.sections]
    # A model or filter that a key selects also owns keys.
    owners += [value for span in spans for value in re.findall(r'"(\w+)"', span) if value in names.owners]
    for owned, owner in re.findall(r"((?:`\w+`(?:, | and ))*`\w+`) of `([\w.[\]]+)`", cell):
        for key in SPAN.findall(owned):
            if owner in names.owners and key not in names.owners[owner] and names.is_key(key):
                faults.append(f"`{key}` is no key of `{owner}`")
    is_absent = cell.startswith("not there")
    if not spans and not is_absent:
        faults.append('neither a name of magline nor "not there"')
    for span in spans:
        # The reason of "not there" may name the other program's functions.
        fault = names.fault(span, owners)
        if fault and not (is_absent and span in foreign):
            faults.append(f"`{span}`: {fault}")
    if "magline report" in spans or "magline view" in spans:
        titles = re.findall(r"\*([^*]+)\*", cell)
        faults += [f"*{title}*: no title of a report or view" for title in titles if title not in names.titles]
    return faults


def unmentioned(page: Path, cell: str, first: list[str], known: list[str]) -> list[str]:
    """Returns the entries of a row that the pages with its figures do not mention."""
    missing = []
    for target in FIGURES.findall(cell):
        file = page.parent / target
        text = " ".join(file.read_text(encoding="utf-8").split()) if file.is_file() else ""
        mentioned = {entry for part in NUMBERS.findall(text) for entry in entries(part, known)}
        missing += [f"{entry} is not mentioned in {target}" for entry in first if entry not in mentioned]
    return missing


def rows(text: str):
    """Yields the line number and the cells of each row in the tables whose last column is `magline`."""
    lines = text.splitlines()
    for number, line in enumerate(lines):
        if not (line.startswith("|---") or line.startswith("|:--")) or cells(lines[number - 1])[-1] != "magline":
            continue
        for at, row in enumerate(lines[number + 1:], number + 2):
            if not row.startswith("|"):
                break
            yield at, cells(row)


def check(page: Path, text: str, names: Names) -> list[str]:
    """Returns the faults of a page with the given text."""
    known, first, faults = listed(page), [], []
    absent = with_figures = 0
    for at, columns in rows(text):
        own = entries(columns[0], known)
        # Options of functions need not be in the list.
        own, unknown = [e for e in own if e in known], [e for e in own if e not in known]
        found = cell_faults(columns[-1], known + unknown, names) + unmentioned(page, columns[-1], own, known)
        if known and unknown and "`" not in columns[0]:
            found.append(f"{', '.join(unknown)}: not in {page.stem}.txt")
        faults += [f"{page}:{at}: {fault}" for fault in found]
        first += own
        absent += len(own) if columns[-1].startswith("not there") else 0
        with_figures += len(own) if FIGURES.search(columns[-1]) else 0
    faults += [f"{page}: {entry} is missing" for entry in known if entry not in first]
    faults += [f"{page}: {entry} occurs twice" for entry in known if first.count(entry) > 1]
    counts = f"Of {len(known)} entries, {len(known) - absent} are in magline and {absent} are not."
    if with_figures:
        counts += f" For {with_figures} entries, the results of magline and of the thesis are given."
    if known and counts not in " ".join(text.split()):
        faults.append(f'{page}: the counts are wrong, not "{counts}"')
    return faults


def without_equation(kind: str, text: str) -> list[str]:
    """Returns the filters, models or metrics that the text of their page of equations does not name."""
    reference = output("stages", "--markdown")
    if kind == "metric":
        tables = re.findall(r"(?m)^\| metric \| unit \|.*\n\|[-|]+\n((?:\|.*\n)+)", reference)
        declared = re.findall(r"(?m)^\| `(\w+)`", "".join(tables))
    else:
        declared = re.findall(rf"(?m)^### The {kind} `(\w+)`", reference)
    return [name for name in declared if f"`{name}`" not in text]


def main() -> int:
    names = Names()
    pages = [Path(page) for page in sys.argv[2:]]
    found = [fault for page in pages for fault in check(page, page.read_text(encoding="utf-8"), names)]
    for kind in ("filter", "model", "metric"):
        page = DOCS / "explanation" / f"{kind}-equations.md"
        lacking = without_equation(kind, page.read_text(encoding="utf-8"))
        found += [f"{page}: `{name}` has no equation" for name in lacking]
    print("\n".join(found) if found else f"{len(pages)} pages: all names are those of magline")
    return 1 if found else 0


if __name__ == "__main__":
    if len(sys.argv) < 3:
        raise SystemExit(__doc__)
    raise SystemExit(main())
