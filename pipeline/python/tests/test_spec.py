"""Specs that are built in Python: the same documents, plans and keys as their files."""

from __future__ import annotations

import inspect
import keyword
import re
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path
from typing import Any

import magline
import numpy as np
import pytest
from conftest import REPOSITORY
from magline import Spec

EXAMPLES = REPOSITORY / "datasets" / "examples"
SPECS = [path for path in sorted(EXAMPLES.glob("*.toml")) if "stages" in tomllib.loads(path.read_text())]


def built(keys: dict[str, Any]) -> Spec:
    """Spec of the same keys, with one call for each part."""
    spec = Spec(keys["name"], seed=keys.get("seed"), store=keys["store"], folder=EXAMPLES)
    search = dict(keys.get("search", {}))
    axes = {name: spec.axis(name, values) for name, values in keys.get("axes", {}).items()}
    for name, axis in search.pop("axes", {}).items():
        given = axis if isinstance(axis, dict) else {"choices": axis}
        axes[name] = spec.search_axis(name, **given)
    if search:
        spec.search(**search)
    for name, table in keys["tables"].items():
        spec.table(name, **table)
    handles = {name: spec[name] for name in spec.tables}
    for stage in keys["stages"]:
        given = {}
        for key, item in stage.items():
            if isinstance(item, str):
                item = handles.get(item, axes.get(item.removeprefix("$"), item) if item.startswith("$") else item)
            if key not in {"stage", "name", "where"}:
                given[f"{key}_" if keyword.iskeyword(key) else key] = item
        handles[stage["name"]] = getattr(spec, stage["stage"])(name=stage["name"], where=stage.get("where"), **given)
    if "publish" in keys:
        spec.publish(**keys["publish"])
    return spec


@pytest.mark.parametrize("path", SPECS, ids=lambda path: path.stem)
def test_every_example_is_read_built_and_written_back(path: Path, tmp_path: Path) -> None:
    keys = tomllib.loads(path.read_text())
    assert len(SPECS) > 30
    for spec in (Spec.read(path), built(keys), Spec.from_dict(keys)):
        # The document determines the plan. Lists keep their order, and the keys of a table have none.
        assert tomllib.loads(spec.toml()) == keys
        assert list(tomllib.loads(spec.toml()).get("axes", {})) == list(keys.get("axes", {}))
    file = Spec.read(path).write(tmp_path / "moved.toml")
    moved = tomllib.loads(file.read_text())
    for name, table in keys["tables"].items():
        for key in ("path", "mapping"):
            if (path.parent / table.get(key, "")).is_file():
                assert (tmp_path / moved["tables"][name][key]).samefile(path.parent / table[key])
