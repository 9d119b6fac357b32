"""Names that the sources declare and that no command prints: file formats, columns and units."""

import re
import subprocess
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent.parent
STRING = r'"((?:[^"\\]|\\.)*)"'


def source(path: str) -> str:
    return (REPOSITORY / path).read_text(encoding="utf-8")


def formats(kind: str, program: str) -> list[tuple[str, str, list[str]]]:
    """Returns name, description and extensions of each format of flights or maps, in the order of the program."""
    command = ["ingest", "README.md", "--to", "none"] if kind == "flight" else ["map", "info", "README.md"]
    done = subprocess.run([program, *command, "--format", "none"], cwd=REPOSITORY, capture_output=True, text=True)
    names = re.search(r"known here: (.*)", done.stderr)[1].split(", ")
    found = {}
    for file in sorted((REPOSITORY / "datasets").glob("*/src/**/*.rs")) + sorted(
            (REPOSITORY / "datasets/src").glob("**/*.rs")):
        text = file.read_text(encoding="utf-8")
        about = rf"name: (?:{STRING}|points_table::(\w+)),\s*about: {STRING},\s*"
        about += r"(?://[^\n]*\n\s*)?extensions: &\[(.*?)\]"
        declared = re.search(r": (Flight|Map)Format = (?:Flight|Map)Format \{\s*" + about, text, re.S)
        if declared and declared[1].lower() == kind:
            name = declared[2] or declared[3].lower()
            found[name] = (name, declared[4], re.findall(r'"([^"]*)"', declared[5]))
    missing = [name for name in names if name not in found]
    if missing:
        raise SystemExit(f"error: no declaration of the formats {', '.join(missing)}")
    return [found[name] for name in names]


def columns() -> str:
    """Returns the page of the columns of flights and maps."""
    text = source("schemas/src/flight.rs")
    body = text.split("COLUMNS:", 1)[1].split("\n];", 1)[0]
    rows = re.findall(rf'\(\s*"(\w+)",\s*d\("([^"]*)", Role::(\w+), {STRING}\),?\s*\)', body)
    body = source("schemas/src/map.rs").split("COLUMNS:", 1)[1].split("\n];", 1)[0]
    unit = rf'unit: "([^"]*)", role: Role::(\w+), description: {STRING}'
    maps = re.findall(rf'\(\s*"(\w+)",\s*ColumnDescription \{{\s*{unit}', body)
    if len(rows) < 45 or len(maps) != 4:
        raise SystemExit(f"error: {len(rows)} columns of flights and {len(maps)} of maps")
    page = source("pipeline/docs/reference/columns-page.txt")
    for mark, found in (("FLIGHTS", rows), ("MAPS", maps)):
        lines = [f"| `{name}` | {unit or '-'} | {role.lower()} | {about} |" for name, unit, role, about in found]
        page = page.replace(mark, "\n".join(["| column | unit | role | meaning |", "|---|---|---|---|", *lines]))
    return page


def units() -> str:
    """Returns the page of the units that readers convert."""
    body = source("schemas/src/unit.rs").split("const UNITS", 1)[1].split(" = &[", 1)[1].split("\n];", 1)[0]
    rows = re.findall(r"\(\s*&\[([^\]]*)\],\s*D::(\w+),\s*(.*?),?\s*\),\n", body + "\n", re.S)
    if len(rows) < 60:
        raise SystemExit(f"error: {len(rows)} units")
    base, lines = {}, []
    for spellings, dimension, size in rows:
        names = re.findall(r'"([^"]*)"', spellings)
        kind = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", dimension).lower()
        if size == "1.0":
            base.setdefault(dimension, names[0])
        others = ", ".join(f"`{name}`" for name in names[1:]) or "-"
        lines.append(f"| `{names[0]}` | {kind} | {base.get(dimension, '-')} | {others} |")
    table = "| unit | quantity | converted to | other spellings |\n|---|---|---|---|\n" + "\n".join(lines)
    return source("pipeline/docs/reference/units-page.txt").replace("UNITS", table)
