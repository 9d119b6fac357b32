"""Exported files in the programs that they are for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import magline
import numpy as np
import pandas as pd
from scipy.io import loadmat


def exported(run: magline.Run, path: Path, *options: str) -> Path:
    """Writes ``tolles_lawson.clean`` with one ridge parameter."""
    start = [sys.executable, "-m", "magline", "export", "tolles_lawson.clean", "--store", run.store.path]
    subprocess.run([*start, "--where", "lambda = 0.025", "-o", str(path), *options], check=True, timeout=300)
    return path


def test_scipy_reads_a_mat_file(run: magline.Run, tmp_path: Path) -> None:
    texts = {"flight": str, "line": str}
    expected = pd.read_csv(exported(run, tmp_path / "clean.csv"), dtype=texts, float_precision="round_trip")
    found = loadmat(exported(run, tmp_path / "clean.mat"), squeeze_me=True)
    listed = {row[1]: row for row in found["columns"]}
    assert list(listed) == list(expected.columns)
    for name in expected.select_dtypes("number"):
        np.testing.assert_array_equal(found[listed[name][0]], expected[name].to_numpy(dtype=float))
    # A text is a position in the list of the column, from 1.
    lines = np.atleast_1d(found["line_names"])[found["line"].astype(int) - 1]
    assert list(lines) == list(expected["line"])
    assert listed["mag_c"][2] == "nT"
    assert listed["tt"][2] == "s"
