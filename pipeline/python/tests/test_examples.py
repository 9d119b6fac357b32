"""Examples of the docstrings and of the README."""

from __future__ import annotations

import doctest
import importlib
import runpy
from pathlib import Path

import pytest
from conftest import REPOSITORY

MODULES = (
    "_filters core_field errors filters maps metrics parts runs signal spec stream tables tolles_lawson views".split()
)


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_the_docstrings_run(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(REPOSITORY)
    result = doctest.testmod(importlib.import_module(f"magline.{name}"))
    assert result.attempted > 0
    assert result.failed == 0


def test_the_first_ten_lines_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(REPOSITORY)
    monkeypatch.setattr("sys.argv", ["first_lines.py", str(tmp_path)])
    found = runpy.run_path(str(REPOSITORY / "pipeline" / "python" / "examples" / "first_lines.py"))
    assert found["clean"].height > 0


def test_the_builder_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(REPOSITORY)
    monkeypatch.setattr("sys.argv", ["builder.py", str(tmp_path)])
    found = runpy.run_path(str(REPOSITORY / "pipeline" / "python" / "examples" / "builder.py"))
    assert found["run"].failures == []
    assert found["run"].counts["fit"]["computed"] == 2
