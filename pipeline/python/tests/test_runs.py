"""Runs, checks and errors."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import magline
import pytest
from conftest import tomllib
from magline import _toml


def keys(spec: Path) -> dict[str, Any]:
    """Keys of the example, with its path made absolute."""
    found = tomllib.loads(spec.read_text())
    path = found["tables"]["flights"]["path"]
    found["tables"]["flights"]["path"] = str((spec.parent / path).resolve())
    return found


def test_scores_are_the_scores_of_the_command(run: magline.Run, spec: Path) -> None:
    command = [sys.executable, "-m", "magline", "run", str(spec), "--set", f"store={run.store.path}", "--json"]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    finished = json.loads(lines[-1])
    assert finished["run"] == run.id
    assert finished["computed"] == 0
    assert finished["scores"] == run.scores["scores"].rows
    assert len(finished["warnings"]) == len(run.warnings)


def test_scores_have_numbers_for_axes(run: magline.Run) -> None:
    scores = run.scores["scores"]
    assert [row["lambda"] for row in scores.records()] == [0.0, 0.001, 0.025, 0.25]
    assert len(scores) == len(scores.pandas()) == scores.polars().height == 4
    assert "lambda" in str(scores)
    assert "<table>" in run._repr_html_()


def test_a_dict_is_the_same_computation(run: magline.Run, spec: Path, tmp_path: Path) -> None:
    again = magline.run(keys(spec), store=tmp_path / "store", threads=1)
    assert again.id == run.id
    assert again.table("scores").to_arrow() == run.table("scores").to_arrow()


def test_overrides_and_reuse(spec: Path, tmp_path: Path) -> None:
    one = magline.run(spec, set={"axes.lambda": [0.5]}, store=tmp_path)
    assert one.counts["coefficients"]["computed"] == 1
    two = magline.run(spec, set={"axes.lambda": [0.5]}, store=tmp_path)
    assert two.counts["coefficients"]["reused"] == 1
    assert (one.id, one.failures) == (two.id, [])


def test_a_check_lists_the_tables(spec: Path) -> None:
    found = magline.check(spec)
    assert found.tables == ["terms", "coefficients", "clean", "scores"]
    assert any("without `truth`" in note for note in found.notes)


def test_a_wrong_spec_has_its_place_and_help(spec: Path) -> None:
    wrong = keys(spec)
    wrong["stages"][1]["lamda"] = wrong["stages"][1].pop("lambda")
    with pytest.raises(magline.SpecError) as caught:
        magline.check(wrong)
    fault = caught.value.faults[0]
    assert fault.owner == "spec"
    assert fault.spec_line is not None
    assert "lambda" in str(caught.value)
    assert isinstance(caught.value, magline.Error)


def test_wrong_data_are_an_error_of_the_data(spec: Path, tmp_path: Path) -> None:
    wrong = keys(spec)
    broken = tmp_path / "broken.parquet"
    broken.write_bytes(b"not a table")
    wrong["tables"]["flights"]["path"] = str(broken)
    with pytest.raises(magline.Error) as caught:
        magline.run(wrong, store=tmp_path / "store")
    assert "broken.parquet" in str(caught.value)


def test_a_missing_spec_names_the_file() -> None:
    with pytest.raises(magline.SpecError, match="no_such_spec.toml"):
        magline.run("no_such_spec.toml")
    with pytest.raises(ValueError, match="threads"):
        magline.run("no_such_spec.toml", threads=0)


def test_toml_of_python_values_is_read_back() -> None:
    values = {
        "text": 'a "quoted"\n\\ \x7f é',
        "numbers": [1, -2, 0.1, 1e300, float("inf")],
        "flag": True,
        "empty": [],
        "table": {"odd key": {"x": 1}, "none": None},
        "rows": ({"name": "one"}, {"name": "two"}),
    }
    read = tomllib.loads(_toml.document(values))
    assert read["text"] == values["text"]
    assert read["numbers"] == values["numbers"]
    assert (read["flag"], read["empty"]) == (True, [])
    assert read["table"] == {"odd key": {"x": 1}}
    assert read["rows"] == list(values["rows"])
    with pytest.raises(TypeError, match="object"):
        _toml.value(object())


LONG = """
import magline, sys
print("ready", flush=True)
try:
    magline.run(sys.argv[1], set={"axes.lambda": [i * 1e-6 for i in range(20_000)]}, store=sys.argv[2])
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


def test_an_interrupt_ends_a_run(spec: Path, tmp_path: Path) -> None:
    program = [sys.executable, "-c", LONG, str(spec), str(tmp_path / "store")]
    child = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    time.sleep(2.0)
    assert child.poll() is None, "the run is too short for this test"
    os.kill(child.pid, signal.SIGINT)
    out, error = child.communicate(timeout=60)
    assert out == "interrupted\n", error
    # Finished results are stored, and a run after the interrupt is complete.
    again = magline.run(spec, set={"axes.lambda": [0.0]}, store=tmp_path / "store")
    assert again.failures == []


def test_other_threads_continue_during_a_run(spec: Path, tmp_path: Path) -> None:
    counted = 0
    done = threading.Event()

    def count() -> None:
        nonlocal counted
        while not done.is_set():
            counted += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    magline.run(spec, store=tmp_path)
    done.set()
    thread.join()
    assert counted > 10
