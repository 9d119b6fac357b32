"""Runs of small specs on real samples, shared by the tests."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import magline
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

REPOSITORY = Path(__file__).resolve().parents[3]
SAMPLES = REPOSITORY / "datasets" / "samples"
SPEC = REPOSITORY / "datasets" / "examples" / "tolles_lawson.toml"


@pytest.fixture(scope="session")
def spec() -> Path:
    """Spec of the Tolles-Lawson example: a sweep of four ridge parameters on 1000 samples."""
    return SPEC


@pytest.fixture(scope="session")
def generator() -> Any:
    """The module `generate`, which makes the generated modules of the package."""
    sys.path.append(str(REPOSITORY / "pipeline" / "python"))
    return importlib.import_module("generate")


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> magline.Run:
    """Run of the Tolles-Lawson example."""
    return magline.run(SPEC, store=tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="session")
def sample() -> dict[str, np.ndarray]:
    """1000 samples of one fluxgate and one scalar magnetometer at 10 Hz."""
    table = pq.read_table(SAMPLES / "magnavjl_tl" / "magnavjl_tl.parquet")
    return {name: table[name].to_numpy() for name in table.column_names}


@pytest.fixture(scope="session")
def flight(tmp_path_factory: pytest.TempPathFactory, sample: dict[str, np.ndarray]) -> dict[str, Any]:
    """Spec of a flight with positions and a gap in time: core field and band-pass."""
    rows = len(sample["time_s"])
    tt = np.arange(rows) / 10.0
    tt[600:] += 5.0
    part = np.linspace(0.0, 1.0, rows)
    mag = sample["mag_1_uc_nt"].copy()
    mag[300] = np.nan
    columns = {
        "tt": tt,
        "lat": 45.0 + part,
        "lon": -76.0 + 2.0 * part,
        "alt": 300.0 + 50.0 * part,
        "mag_1_uc": mag,
    }
    path = tmp_path_factory.mktemp("flight") / "flight.parquet"
    pq.write_table(pa.table(columns), path)
    stages = [
        {"name": "field", "stage": "core_field", "input": "flights", "decimal_year": 2020.5},
        {"name": "band", "stage": "bandpass", "input": "flights", "columns": ["mag_1_uc"]},
    ]
    return {
        "name": "arrays",
        "store": str(path.parent / "store"),
        "tables": {"flights": {"path": str(path), "flight": "one", "line": "1"}},
        "stages": stages,
    }
