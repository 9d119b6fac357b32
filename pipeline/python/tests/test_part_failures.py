"""Filters written in Python, and parts that fail or are interrupted."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import magline
import numpy as np
import pytest
from conftest import REPOSITORY
from test_parts import LINES, PARTS, columns, counts, line_stage, parts, spec, table, toml

# Fixtures of the other module.
__all__ = ["columns", "parts", "spec"]


def navigation(tmp_path: Path, **keys: Any) -> dict[str, Any]:
    """A sweep of the built-in INS and a filter written in Python over a sample flight."""
    folder = REPOSITORY / "datasets" / "samples" / "simple_magnav"
    track = {"map": "anomaly", "mag": "mag_1_c", "core_field": False, "tuning": "magnav", **keys}
    return {
        "name": "track",
        "store": str(tmp_path / "store"),
        "tables": {"flights": {"path": str(folder / "xyz.h5")}, "anomaly": {"path": str(folder / "map.h5")}},
        "axes": {"north": [0.0, 50.0]},
        "stages": [
            {"name": "moved", "stage": "navigate", "input": "flights", "filter": "moved", "north_m": "$north", **track},
            {"name": "flight", "stage": "derive", "input": "flights", "columns": {"copy": "ins_lat"}},
            {"name": "scores", "stage": "score", "input": ["flights", "moved"], "metrics": ["drms", "ins_drms"]},
        ],
    }


def test_a_filter_gets_the_ins_and_the_map(parts: Any, tmp_path: Path) -> None:
    run = magline.run(navigation(tmp_path))
    assert run.failures == []
    still, north = run.scores["scores"].records()
    assert still["drms"] == pytest.approx(still["ins_drms"], rel=1e-9)
    assert north["drms"] != pytest.approx(north["ins_drms"], rel=1e-3)
    track = table(run, "moved")
    track = track[track["north"] == 0.0].reset_index(drop=True)
    flights = table(run, "flight")
    np.testing.assert_array_equal(track["lat"], flights["ins_lat"])
    np.testing.assert_array_equal(track["alt"], flights["ins_alt"])
    assert set(track["sd_n"]) == {10.0} and set(track["update"]) == {"used"}
    # Bilinear interpolation of the file.
    grid = magline.maps.open(REPOSITORY / "datasets" / "samples" / "simple_magnav" / "map.h5")
    x, y = ((v - axis[0]) / (axis[1] - axis[0]) for v, axis in ((track["lon"], grid.x), (track["lat"], grid.y)))
    i, j = np.floor(y).astype(int), np.floor(x).astype(int)
    u, v, nodes = (y - i).to_numpy(), (x - j).to_numpy(), grid.anomaly_nt
    lower = (1 - v) * nodes[i, j] + v * nodes[i, j + 1]
    upper = (1 - v) * nodes[i + 1, j] + v * nodes[i + 1, j + 1]
    expected = flights["mag_1_c"].to_numpy() - ((1 - u) * lower + u * upper)
    np.testing.assert_allclose(track["residual"], expected, atol=1e-6)


def test_a_wrong_filter_fails_its_line(parts: Any, tmp_path: Path) -> None:
    run = magline.run(navigation(tmp_path, bad=True))
    assert [failure.stage for failure in run.failures] == ["moved", "moved"]
    assert "did not return `lon`" in run.failures[0].error
    with pytest.raises(magline.SpecError, match="requires a map"):
        wrong = navigation(tmp_path)
        del wrong["stages"][0]["map"]
        magline.check(wrong)


INTERRUPTED = """
import magline, signal, sys
# A shell may have started the tests with interrupts ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
magline.load_parts(sys.argv[1])
print("ready", flush=True)
try:
    magline.run(sys.argv[2])
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


def test_an_interrupt_ends_a_run_of_a_stage(parts: Any, spec: dict[str, Any], tmp_path: Path) -> None:
    keys = {**line_stage(spec, stage="slow", seconds="$seconds"), "store": str(tmp_path / "store")}
    keys["axes"] = {"seconds": [0.05 + 1e-6 * i for i in range(1000)]}
    program = [sys.executable, "-c", INTERRUPTED, str(PARTS), str(toml(tmp_path / "spec.toml", keys))]
    child = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    time.sleep(3.0)
    assert child.poll() is None, "the run is too short for this test"
    begun = time.monotonic()
    child.send_signal(signal.SIGINT)
    out, error = child.communicate(timeout=60)
    assert out == "interrupted\n", error
    # A thousand units at three lines last longer than 75 s on two threads.
    assert time.monotonic() - begun < 20.0


def test_a_model_that_raises_fails_its_point(parts: Any, spec: dict[str, Any], tmp_path: Path) -> None:
    run = magline.run(spec, set={"axes.alpha": [-1.0, 0.1]}, store=tmp_path)
    assert [(failure.stage, failure.axes["alpha"]) for failure in run.failures] == [("model", -1.0)]
    assert "InvalidParameterError" in run.failures[0].error and "Traceback" in run.failures[0].error
    assert set(table(run, "clean")["alpha"]) == {0.1}


def test_a_metric_that_raises_is_a_failure_of_its_lines(parts: Any, spec: dict[str, Any], tmp_path: Path) -> None:
    stages = [*spec["stages"][:-1], {**spec["stages"][-1], "metrics": ["own_rms", "rough_metric"]}]
    run = magline.run({**spec, "stages": stages}, set={"axes.alpha": [0.1]}, store=tmp_path)
    assert [failure.line for failure in run.failures] == LINES
    assert all("ZeroDivisionError: no metric" in failure.error for failure in run.failures)
    lines = table(run, "scores")
    assert lines[lines["metric"] == "own_rms"]["value"].notna().all()


def test_a_table_of_another_source_is_rejected(parts: Any, spec: dict[str, Any], tmp_path: Path) -> None:
    """A published model is applied only by the source that fitted it."""
    file = tmp_path / "level.py"
    source = """
import magline

@magline.model(version=1)
class Level:
    def fit(self, x, y):
        self.level = y.mean()

    def predict(self, x):
        return x[:, 0] * 0.0 + self.level
"""
    source = source.replace("magline.model(", "magline.model(name='level', ")
    file.write_text(source)
    magline.load_parts(file)
    stages = [dict(stage) for stage in spec["stages"]]
    del stages[3]["alpha"]
    stages[3]["model"] = "level"
    run = magline.run({**spec, "axes": {}, "stages": stages[:4]}, store=tmp_path / "store")
    assert run.failures == []
    model = {"path": str(run.folder / "model"), "features": ["cur_1", "cur_2", "cur_3"]}
    apply = {
        "name": "applied",
        "store": str(tmp_path / "other"),
        "tables": {"flights": {"path": spec["tables"]["flights"]["path"]}, "model": model},
        "stages": [{"name": "clean", "stage": "compensate", "input": "flights", "model": "model", "mag": "mag_1_uc"}],
    }
    applied = magline.run(apply)
    assert applied.failures == []
    assert len(set(table(applied, "clean")["mag_aircraft"])) == 1
    file.write_text(source.replace("0.0 +", "1.0 +"))
    magline.load_parts(file)
    # The table holds the hash of the source, so the stored result is still that of the source that fitted it.
    assert counts(magline.run({**apply, "name": "again"})) == {}
    with_other = magline.run({**apply, "store": str(tmp_path / "third")})
    assert len(with_other.failures) == len(LINES)
    assert "was fitted by other source code" in with_other.failures[0].error
