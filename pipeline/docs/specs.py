#!/usr/bin/env python3
"""Checks the TOML blocks of pages with `magline check`: python3 specs.py PROGRAM PAGE...

PROGRAM is the program `magline`. Paths in a block are relative to the root folder of the repository. A block is checked
as it is, and needs tables and stages; `name` and `store` may be absent. A block with `[[flights]]` is a simulation and
is checked as the table of a spec. A block with a caption is a file, which `check.py` uses. A comment above a block
changes this:

- `<!-- with: datasets/examples/NAME.toml -->`: the block is added to this spec. A stage of the same name replaces the
  stage of the spec if it has the key `input`; otherwise its keys are added to the stage.
- `<!-- fragment: REASON -->`: the block is only parsed, because its files or its store do not exist here.
"""

import datetime
import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from check import BLOCK, REPOSITORY

COMMENT = re.compile(r"<!-- (with|fragment): (.+?) -->\s*\Z")


def toml(value: object) -> str:
    """Returns a value of a TOML document in inline form."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(key)} = {toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return json.dumps(value, ensure_ascii=False)


def document(spec: dict) -> str:
    return "".join(f"{key} = {toml(value)}\n" for key, value in spec.items())


def located(spec: dict, folder: Path) -> dict:
    """Returns a spec whose tables have absolute paths."""
    def path(key: str, value: object) -> object:
        names_file = key in ("path", "mapping", "lines") and isinstance(value, str) and (folder / value).exists()
        return str(folder / value) if names_file else value

    tables = {name: {k: path(k, v) for k, v in table.items()} for name, table in spec.get("tables", {}).items()}
    return {**spec, "tables": tables}


def merged(spec: dict, block: dict) -> dict:
    """Returns `spec` with the tables, axes and stages of `block`."""
    stages = {stage["name"]: stage for stage in spec["stages"]}
    for stage in block.get("stages", []):
        before = {} if "input" in stage else stages.get(stage["name"], {})
        stages[stage["name"]] = {**before, **stage}
    parts = {key: {**spec.get(key, {}), **block.get(key, {})} for key in ("tables", "axes")}
    return {**spec, **parts, "stages": list(stages.values())}


def complete(block: dict, text: str, base: str | None, folder: Path) -> dict:
    """Returns the spec to check, which writes only to `folder`."""
    if "flights" in block:
        simulation = folder / "block.synth.toml"
        simulation.write_text(text.replace('"datasets/', f'"{REPOSITORY}/datasets/'), encoding="utf-8")
        stage = {"name": "block", "stage": "select", "input": "flights", "columns": ["lat"]}
        spec = {"tables": {"flights": {"path": str(simulation)}}, "stages": [stage]}
    else:
        spec = located(block, REPOSITORY)
    if base:
        example = REPOSITORY / base
        spec = merged(located(tomllib.loads(example.read_text(encoding="utf-8")), example.parent), spec)
    return {"name": "block", **spec, "store": str(folder / "store")}


def check(page: Path, program: str) -> tuple[int, list[str]]:
    """Returns the number of TOML blocks of a page, and a message for each block that fails."""
    text, count, faults = page.read_text(encoding="utf-8"), 0, []
    for match in BLOCK.finditer(text):
        body = match["body"]
        if match["info"].split()[-1:] != ["toml"] or body.startswith(":caption:"):
            continue
        count += 1
        place = f"{page}:{text.count(chr(10), 0, match.start()) + 1}"
        comment = COMMENT.search(text, 0, match.start())
        kind, what = comment.groups() if comment else (None, None)
        try:
            block = tomllib.loads(body)
        except tomllib.TOMLDecodeError as error:
            faults.append(f"{place}: {error}")
            continue
        if kind == "fragment":
            continue
        with tempfile.TemporaryDirectory() as name:
            file = Path(name) / "block.toml"
            file.write_text(document(complete(block, body, what, Path(name))), encoding="utf-8")
            done = subprocess.run([program, "check", file], capture_output=True, text=True, timeout=120)
        if done.returncode != 0:
            faults.append(f"{place}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    return count, faults


def main() -> int:
    if len(sys.argv) < 3:
        raise SystemExit(__doc__)
    results = [check(Path(page), os.path.abspath(sys.argv[1])) for page in sys.argv[2:]]
    faults = [fault for _, page in results for fault in page]
    print("\n".join([*faults, f"{sum(count for count, _ in results)} TOML blocks, {len(faults)} fail"]))
    return 1 if faults else 0


if __name__ == "__main__":
    raise SystemExit(main())
