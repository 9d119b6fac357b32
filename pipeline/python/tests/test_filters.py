"""Filters on arrays against runs of the stage `navigate` on the same line."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import magline
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from conftest import REPOSITORY, SAMPLES
from magline import filters, maps

MAP = SAMPLES / "osborne" / "osborne_anomaly_100m_at_500m.tif"
ROWS = 240
INS = ["ins_vn", "ins_ve", "ins_vd", "ins_fn", "ins_fe", "ins_fd", "ins_roll", "ins_pitch", "ins_yaw"]
SMALL = {"tuning": "magnav", "measurement_sigma_nt": 3.0, "fogm_sigma_nt": 2.0}
GIVEN = {"start": "given", "init_position_sigma_m": 30.0, "init_velocity_sigma_mps": 0.3}
#: Filter, keys, and whether the prior of the coefficients comes from a fit.
CASES: dict[str, tuple[str, dict[str, Any], bool]] = {
    "ekf": ("ekf", {}, False),
    "ekf_magnav": (
        "ekf",
        {**SMALL, **GIVEN, "map_interpolation": "cubic", "map_levels_m": [500.0, 550.0], "save_state": True},
        False,
    ),
    "ekf_gnss": ("ekf", {**SMALL, "gnss_lost_s": [60.0, 200.0], "gate_nis": 9.0, "flat_over_m": 500.0}, False),
    "iekf": ("iekf", {**SMALL, "vector": "flux_a", "dead_zones": "polar"}, False),
    "ukf": ("ukf", SMALL, False),
    "ekf_adaptive": ("ekf_adaptive", {"window": 30, "adapt": "r"}, False),
    "ekf_online_tl": ("ekf_online_tl", {}, False),
    "ekf_online_tl_model": ("ekf_online_tl", {"walk_per_hour": 0.2, **SMALL}, True),
    "fixed_lag": ("fixed_lag", {"window_s": 60.0, "overlap": 0.5, **SMALL}, True),
    "rts": ("rts", SMALL, False),
    "mpf": ("mpf", {**SMALL, **GIVEN, "particles": 200, "seed": 5}, False),
    "crlb": ("crlb", SMALL, False),
    "ins_only": ("ins_only", {"tuning": "magnav"}, False),
}


def flight() -> dict[str, Any]:
    """Four minutes eastward with turns at 550 m, an INS that drifts, and noise of 2 nT."""
    t = np.arange(float(ROWS))
    draw = np.random.default_rng(3)
    lat, lon = -22.0 + 0.004 * np.sin(t / 30.0), 140.55 + 6.0e-4 * t
    yaw = 90.0 - 20.0 * np.cos(t / 30.0)
    field = 50_000.0 * np.stack([0.3 + 0.1 * np.sin(t / 7.0), 0.1 * np.cos(t / 5.0), np.full(ROWS, -0.9)])
    columns = {
        "tt": t + 36_000.0,
        "lat": lat,
        "lon": lon,
        "alt": np.full(ROWS, 550.0),
        "ins_lat": lat + (15.0 + 0.2 * t) / 111_000.0,
        "ins_lon": lon - (10.0 + 0.1 * t) / 103_000.0,
        "ins_alt": 550.0 + np.sin(t / 50.0),
        "ins_vn": 15.0 * np.cos(t / 30.0) + 0.2,
        "ins_ve": 62.0 - 0.1 + 0.0 * t,
        "ins_vd": 0.0 * t,
        "ins_fn": -0.5 * np.sin(t / 30.0),
        "ins_fe": 0.01 * np.cos(t),
        "ins_fd": -9.79 + 0.0 * t,
        "ins_roll": 3.0 * np.sin(t / 30.0),
        "ins_pitch": 0.5 + 0.0 * t,
        "ins_yaw": yaw,
        "flux_a_x": field[0],
        "flux_a_y": field[1],
        "flux_a_z": field[2],
        "noise": draw.normal(0.0, 2.0, ROWS),
    }
    columns["noise"][100:105] = np.nan
    return columns


def spec(folder: Path) -> dict[str, Any]:
    """Pipeline with all cases on the flight."""
    path = folder / "flight.parquet"
    pq.write_table(pa.table(flight()), path)
    stages: list[dict[str, Any]] = [
        {"name": "below", "stage": "map_value", "input": "flights", "map": "anomaly"},
        {
            "name": "measured",
            "stage": "derive",
            "input": "below",
            "columns": {"mag_c": "map_anomaly + noise"},
            "units": {"mag_c": "nT"},
        },
        {
            "name": "terms",
            "stage": "a_matrix",
            "input": "measured",
            "vector": "flux_a",
            "terms": ["permanent", "eddy3", "bias"],
        },
        {
            "name": "calibration",
            "stage": "fit",
            "input": "terms",
            "model": "tolles_lawson",
            "target": "mag_c",
            "low_hz": 0.01,
            "high_hz": 0.2,
        },
    ]
    for name, (kind, keys, calibrated) in CASES.items():
        inputs = {"input": "terms", "map": "anomaly", **({"model": "calibration"} if calibrated else {})}
        stages += [
            {"name": name, "stage": "navigate", **inputs, "filter": kind, "core_field": False, **keys},
            {"name": f"scores_{name}", "stage": "score", "input": ["terms", name]},
        ]
    return {
        "name": "filters",
        "store": str(folder / "store"),
        "tables": {
            "flights": {"path": str(path), "flight": "one", "line": "1"},
            "anomaly": {"path": str(MAP), "alt_m": 500.0},
        },
        "stages": stages,
    }


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> magline.Run:
    return magline.run(spec(tmp_path_factory.mktemp("filters")))


@pytest.fixture(scope="module")
def arrays(done: magline.Run) -> dict[str, Any]:
    """Arguments of every filter, from the table of the terms."""
    frame = done.sql("select * from filters.terms order by tt").polars()
    names = ["lat", "lon", "alt", "flux_a_x", "flux_a_y", "flux_a_z"]
    columns: dict[str, Any] = {name: frame[name] for name in names}
    terms = magline.tolles_lawson.term_names(["permanent", "eddy3", "bias"])
    columns["tl"] = (frame["tl"].to_numpy(), terms)
    three = [frame.select(INS[i : i + 3]).to_numpy() for i in (0, 3, 6)]
    return {
        "tt_s": frame["tt"],
        "ins_lat_deg": frame["ins_lat"],
        "ins_lon_deg": frame["ins_lon"],
        "ins_alt_m": frame["ins_alt"].to_numpy(),
        "mag_nt": frame["mag_c"],
        "map": maps.open(MAP, alt_m=500.0),
        "ins_velocity_ned_mps": three[0],
        "ins_force_ned_mps2": three[1],
        "ins_attitude_deg": three[2],
        "columns": columns,
    }


def run_case(case: str, arrays: dict[str, Any], done: magline.Run, **more: Any) -> filters.Track:
    kind, keys, calibrated = CASES[case]
    models = [done.table("calibration").pandas()] if calibrated else None
    given = {**arrays, **({"models": models} if calibrated else {}), "core_field": False, **keys, **more}
    if kind == "ins_only":
        return filters.navigate(kind, **{**given, "mag_nt": None})
    return getattr(filters, kind)(**given)


@pytest.mark.parametrize("case", list(CASES))
def test_a_filter_on_arrays_equals_the_stage(case: str, done: magline.Run, arrays: dict[str, Any]) -> None:
    assert not done.failures, done.failures
    expected = done.sql(f"select * from filters.{case} order by tt").polars()
    found = run_case(case, arrays, done)
    names = {
        "tt": "tt_s",
        "lat": "lat_deg",
        "lon": "lon_deg",
        "alt": "alt_m",
        "vn": "vn_mps",
        "ve": "ve_mps",
        "vd": "vd_mps",
        "sd_n": "sd_n_m",
        "sd_e": "sd_e_m",
        "cov_ne": "cov_ne_m2",
        "residual": "residual_nt",
        "nis": "nis",
        "update": "update",
    }
    own = {name: getattr(found, attribute) for name, attribute in names.items()} | found.more
    assert len(found) == ROWS and set(own) <= set(expected.columns)
    for name, values in own.items():
        stored = expected[name].to_numpy()
        if values.dtype.kind == "U":
            assert values.tolist() == stored.tolist(), name
        else:
            assert np.asarray(values).tobytes() == np.ascontiguousarray(stored).tobytes(), name
    assert np.isfinite(found.lat_deg).all() and (found.update == "used").sum() > 0 or case == "ins_only"
    shape = found.covariance_m2.shape
    assert shape == (ROWS, 2, 2) and np.array_equal(found.covariance_m2[:, 0, 1], found.cov_ne_m2)


def test_the_warnings_are_those_of_the_run(done: magline.Run, arrays: dict[str, Any]) -> None:
    of_run = {case: [] for case in CASES}
    for one in done.warnings:
        case = one.stage.removeprefix("scores_")
        if case in of_run:
            of_run[case].append(one)
    assert any(of_run.values()), "no case has a warning"
    for case, expected in of_run.items():
        track = run_case(case, arrays, done)
        assert len(track.warnings) == len(expected), case
        for one, other in zip(track.warnings, expected, strict=True):
            for name in ["kind", "value", "limit", "unit", "text"]:
                assert getattr(one, name) == getattr(other, name), (case, name)
            # A run also tries remedies and adds the result to the cause.
            assert (other.cause or "").startswith(one.cause or ""), case


def test_a_late_clock_is_flagged(done: magline.Run, arrays: dict[str, Any]) -> None:
    wrong = {**arrays, "mag_nt": np.roll(arrays["mag_nt"].to_numpy(), 15)}
    track = run_case("ekf_magnav", wrong, done)
    assert "nis_high" in [one.kind for one in track.warnings], track.warnings
    assert "innovations" in repr(track)


def test_wrong_arguments_name_the_remedy(done: magline.Run, arrays: dict[str, Any]) -> None:
    with pytest.raises(TypeError, match="lamda"):
        filters.ekf(**arrays, lamda=1.0)
    with pytest.raises(magline.SpecError, match="did you mean `gate_nis`"):
        filters.navigate("ekf", **arrays, gate_niss=1.0)
    with pytest.raises(magline.SpecError, match="must be above 0"):
        filters.ekf(**arrays, measurement_sigma_nt=-1.0)
    with pytest.raises(magline.SpecError, match="no effect") as idle:
        filters.ekf(**arrays, core_field=False, gnss_sigma_m=2.0)
    assert idle.value.faults[0].owner == "spec"
    with pytest.raises(magline.SpecError, match="needs a date"):
        filters.ekf(**arrays)
    with pytest.raises(ValueError, match="different lengths"):
        filters.ekf(**{**arrays, "mag_nt": arrays["mag_nt"][:-1]}, core_field=False)
    with pytest.raises(ValueError, match=r"\(240, 3\)"):
        filters.ekf(**{**arrays, "ins_attitude_deg": arrays["ins_attitude_deg"][:, :2]}, core_field=False)
    with pytest.raises(ValueError, match="given twice"):
        filters.ekf(**{**arrays, "columns": {"ins_lat": arrays["ins_lat_deg"]}}, core_field=False)
    with pytest.raises(ValueError, match="names of the columns"):
        filters.ekf(**{**arrays, "columns": {"tl": np.zeros((ROWS, 2))}}, core_field=False)


def test_wrong_data_are_data_errors(arrays: dict[str, Any]) -> None:
    lat = arrays["ins_lat_deg"].to_numpy().copy()
    lat[7] = np.nan
    with pytest.raises(magline.DataError, match="ins_lat"):
        filters.ekf(**{**arrays, "ins_lat_deg": lat}, core_field=False)
    with pytest.raises(magline.DataError, match="no sample could be used"):
        filters.ekf(**{**arrays, "mag_nt": np.full(ROWS, np.nan)}, core_field=False, **SMALL)
    backwards = arrays["tt_s"].to_numpy()[::-1]
    with pytest.raises(magline.DataError, match="tt"):
        filters.ekf(**{**arrays, "tt_s": backwards}, core_field=False)
    dates = np.datetime64("2020-07-01T10:00:00") + np.arange(ROWS)
    with pytest.raises(ValueError, match="convert times to seconds"):
        filters.ekf(**{**arrays, "tt_s": dates}, core_field=False)
    with pytest.raises(magline.MaglineError):
        empty = dict.fromkeys(["tt_s", "ins_lat_deg", "ins_lon_deg", "ins_alt_m", "mag_nt"], np.zeros(0))
        filters.ekf(**empty, map=arrays["map"], core_field=False)
    uneven = maps.Map(np.array([0.0, 1.0, 3.0]), np.arange(2.0), np.zeros((2, 3)), np.zeros((2, 3)), 4326, "deg")
    with pytest.raises(ValueError, match="`x` of the map are not evenly spaced"):
        filters.ekf(**{**arrays, "map": uneven}, core_field=False)


def test_several_magnetometers_have_names(done: magline.Run, arrays: dict[str, Any]) -> None:
    mag = arrays["mag_nt"].to_numpy()
    both = {**arrays, "mag_nt": {"mag_1_c": mag, "mag_2_c": mag + 0.1}}
    track = filters.ekf_adaptive(**both, core_field=False, window=30)
    assert {"sigma_adapted_mag_1_c", "sigma_adapted_mag_2_c"} <= set(track.more)
    assert track.units["sigma_adapted_mag_1_c"] == "nT"


def test_an_own_filter_runs_on_arrays(arrays: dict[str, Any]) -> None:
    @magline.filter(version=1, needs_map=False)
    def standing_still(flight: magline.Flight, *, step_deg: float = 0.0) -> dict[str, Any]:
        return {"lat": flight["lat"] + step_deg, "lon": flight["lon"]}

    given = {**arrays, "columns": None, "map": None}
    track = filters.navigate("standing_still", **given, step_deg=0.25, core_field=False, **GIVEN, tuning="magnav")
    assert np.array_equal(track.lat_deg, arrays["ins_lat_deg"].to_numpy() + 0.25)


def test_the_functions_are_those_of_the_declarations(generator: Any) -> None:
    command = Path(sys.executable).with_name("magline")
    committed = REPOSITORY / "pipeline/python/magline/_filters.py"
    text = generator.generate(command, "filters")
    assert committed.read_text() == text, "`generate.py MAGLINE filters` prints another `_filters.py`"
