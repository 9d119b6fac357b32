"""Progress of a run: a bar of tqdm, or text."""

from __future__ import annotations

import sys
import time
import types
from pathlib import Path
from typing import Any

import magline
import nbformat
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from conftest import SPEC
from nbclient import NotebookClient


@magline.stage(reads={"tt": "s"}, makes={"slow": "s"}, version=1)
def waits_a_moment(line: magline.Line) -> np.ndarray:
    """Time of each sample, after a quarter of a second."""
    time.sleep(0.25)
    return line["tt"]


def spec(folder: Path) -> dict[str, Any]:
    """Four lines of a stage that takes a quarter of a second each."""
    path = folder / "flights.parquet"
    columns = {"flight": ["1"] * 8, "line": list("aabbccdd"), "tt": np.arange(8.0)}
    pq.write_table(pa.table(columns), path)
    return {
        "name": "slow",
        "store": str(folder / "store"),
        "tables": {"flights": {"path": str(path)}},
        "stages": [{"name": "slow", "stage": "waits_a_moment", "input": "flights"}],
    }


class Bar:
    """The methods of tqdm that a display uses, with a record of their calls."""

    made: list[Bar] = []

    def __init__(self, total: int | None = None, leave: bool = True, unit: str = "it") -> None:
        self.total, self.n, self.closed = total, 0, False
        self.seen: list[tuple[str, int, int | None]] = []
        self.what = ""
        Bar.made.append(self)

    def reset(self, total: int | None = None) -> None:
        self.total, self.n = total, 0

    def set_description(self, what: str) -> None:
        self.what = what

    def update(self, n: int) -> None:
        self.n += n
        self.seen.append((self.what, self.n, self.total))

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def bars(monkeypatch: pytest.MonkeyPatch) -> list[Bar]:
    module = types.ModuleType("tqdm.auto")
    module.tqdm = Bar  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "tqdm", types.ModuleType("tqdm"))
    monkeypatch.setitem(sys.modules, "tqdm.auto", module)
    Bar.made = []
    return Bar.made


def test_a_bar_counts_the_units_of_a_stage(bars: list[Bar], tmp_path: Path) -> None:
    magline.run(spec(tmp_path), threads=1, progress=True)
    (bar,) = bars
    assert bar.closed
    counts = [n for what, n, total in bar.seen if (what, total) == ("computing slow", 4)]
    assert counts == sorted(counts) and {1, 2, 3} <= set(counts) and max(counts) <= 4, bar.seen


def test_progress_is_off_by_default_and_on_request(bars: list[Bar], tmp_path: Path, capfd: Any) -> None:
    magline.run(spec(tmp_path), threads=1)
    magline.run(spec(tmp_path), set={"name": "off"}, threads=1, progress=False)
    assert bars == [] and capfd.readouterr().err == ""


def test_text_replaces_a_missing_tqdm(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Any) -> None:
    monkeypatch.setitem(sys.modules, "tqdm", None)
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)
    monkeypatch.setattr("magline._progress.INTERVAL_S", 0.0)
    magline.run(spec(tmp_path), threads=1, progress=True)
    lines = capsys.readouterr().err.splitlines()
    assert "computing slow: 2 of 4" in lines, lines
    assert not any("\r" in line or "\x1b" in line for line in lines)


def test_a_terminal_has_one_line_that_is_cleared(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Any) -> None:
    monkeypatch.setitem(sys.modules, "tqdm", None)
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    magline.run(spec(tmp_path), threads=1)
    text = capsys.readouterr().err
    assert "\rcomputing slow: 1 of 4" in text and "\n" not in text and text.endswith("\r")


def test_an_interrupt_of_the_display_ends_the_run(
    monkeypatch: pytest.MonkeyPatch, bars: list[Bar], tmp_path: Path
) -> None:
    def fail(self: Bar, n: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Bar, "update", fail)
    with pytest.raises(KeyboardInterrupt):
        magline.run(spec(tmp_path), threads=1, progress=True)
    assert bars[0].closed
    monkeypatch.undo()
    assert magline.run(spec(tmp_path), threads=1).failures == []


def test_a_notebook_has_one_text_that_is_cleared(tmp_path: Path) -> None:
    cells = [
        "import sys; sys.modules['tqdm'] = sys.modules['tqdm.auto'] = None; import magline",
        f"run = magline.run({str(SPEC)!r}, store={str(tmp_path / 'store')!r})",
        f"run = magline.run({str(SPEC)!r}, store={str(tmp_path / 'other')!r}, progress=False)",
    ]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    outputs = [[one.get("data", one) for one in cell.outputs] for cell in notebook.cells]
    assert outputs == [[], [{"text/plain": ""}], []]
