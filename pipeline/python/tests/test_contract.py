"""Lazy frames, views, maps, and names that are fixed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import magline
import numpy as np
import polars as pl
import pytest
from conftest import SAMPLES


def test_a_lazy_frame_selects_and_filters(run: magline.Run) -> None:
    whole = run.table("clean").polars()
    wanted = [pl.col("tt"), (pl.col("mag_c") - pl.col("mag_1_uc")).alias("change")]
    kept = pl.col("lambda") == 0.25
    lazy = run.table("clean").lazy()
    assert lazy.collect_schema() == whole.schema
    found = lazy.filter(kept).select(wanted).sort("tt").collect()
    assert found.equals(whole.filter(kept).select(wanted).sort("tt"))
    assert lazy.head(3).collect().height == 3
    assert lazy.select(pl.len()).collect().item() == 4000


def test_views_are_the_views_of_the_command(spec: Path, run: magline.Run, tmp_path: Path) -> None:
    def command(name: str, *more: str) -> str:
        sets = ["--set", f"store={run.store.path}"]
        return subprocess.check_output([sys.executable, "-m", "magline", name, str(spec), *more, *sets], text=True)

    assert run.explain() == command("explain")
    assert run.why("scores") == command("why", "scores")
    page = run.report(tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.startswith("<!") and "tolles_lawson" in page
    with pytest.raises(magline.SpecError, match="scores"):
        run.why("scors")


def test_sql_is_a_function_of_the_package(run: magline.Run) -> None:
    query = "select count(*) as n from tolles_lawson.clean"
    for store in (run.store, run.store.path, Path(run.store.path)):
        assert magline.sql(query, store=store).polars().item() == 4000


def test_all_errors_have_one_base() -> None:
    for kind in (magline.SpecError, magline.DataError, magline.MachineError, magline.BugError):
        assert issubclass(kind, magline.MaglineError)


def test_wmm_has_the_values_of_its_report() -> None:
    # WMM2025, test values of NOAA NCEI: 80 N, 0 E, 0 km, 2025.0, rounded to 0.1 nT.
    expected = {"north": 6521.6, "east": 145.9, "down": 54791.5, "magnitude": 55178.5}
    for component, value in expected.items():
        assert magline.core_field.wmm(80.0, 0.0, 0.0, 2025.0, component=component) == pytest.approx(value, abs=0.06)


def test_upward_continuation_is_the_field_of_a_source() -> None:
    # A magnetic monopole 2 km below the map: its field is known at each height.
    step_m, depth_m = 100.0, 2000.0
    axis = np.arange(-20_000.0, 20_000.0, step_m)
    east, north = np.meshgrid(axis, axis)

    def field(height_m: float) -> np.ndarray:
        down = depth_m + height_m
        return 4e8 * down / (east**2 + north**2 + down**2) ** 1.5

    raised = magline.maps.upward(field(0.0), step_m, 300.0)
    centre = slice(150, 250)
    # The peak is 100 nT. The field beyond the edges is unknown, which causes an error below 1 nT near the centre.
    np.testing.assert_allclose(raised[centre, centre], field(300.0)[centre, centre], atol=1.0)
    assert np.array_equal(magline.maps.upward(field(0.0), (step_m, step_m), 0.0).shape, east.shape)
    with pytest.raises(ValueError, match="above|least|0"):
        magline.maps.upward(field(0.0), step_m, -1.0)


def test_a_map_is_opened_on_its_native_grid() -> None:
    found = magline.maps.open(SAMPLES / "osborne" / "osborne_anomaly_100m_at_500m.tif")
    assert found.anomaly_nt.shape == found.alt_m.shape == (found.y.size, found.x.size)
    assert (found.unit, np.all(np.diff(found.x) > 0), np.all(np.diff(found.y) > 0)) == ("m", True, True)
    with pytest.raises(magline.MaglineError, match=r"none\.tif"):
        magline.maps.open("none.tif")
    xarray = pytest.importorskip("xarray")
    array = found.xarray()
    assert isinstance(array, xarray.DataArray) and array.attrs["epsg"] == found.epsg
    raised = magline.maps.upward(array.fillna(0.0), 100.0, 100.0)
    np.testing.assert_array_equal(raised["alt_m"], array["alt_m"] + 100.0)
    assert raised.dims == array.dims and bool((raised.x == array.x).all())
