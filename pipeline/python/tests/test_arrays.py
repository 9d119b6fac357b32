"""Functions on arrays: against NumPy and ppigrf, and bit for bit against the stages."""

from __future__ import annotations

import datetime
from typing import Any

import magline
import numpy as np
import ppigrf
import pytest
from magline import core_field, metrics, signal, tolles_lawson

Sample = dict[str, np.ndarray]


def vector(sample: Sample) -> np.ndarray:
    return np.stack([sample[f"flux_a_{axis}_nt"] for axis in "xyz"], axis=1)


def rows_of(table: magline.Table, column: str) -> np.ndarray:
    values = table.polars().sort("tt")[column]
    return np.array(values.to_list(), dtype=np.float64)


def by_numpy(b: np.ndarray, scale: float) -> np.ndarray:
    """Permanent, induced and eddy terms of (3.13) to (3.20) of Gnadt 2022, in a loop."""
    rate = np.gradient(b, axis=0)
    rows = []
    for i in range(len(b)):
        (x, y, z), (dx, dy, dz) = b[i], rate[i]
        bt = np.sqrt(x * x + y * y + z * z)
        permanent = [x / bt, y / bt, z / bt]
        induced = [x * x, x * y, x * z, y * y, y * z, z * z]
        eddy = [x * dx, x * dy, x * dz, y * dx, y * dy, y * dz, z * dx, z * dy, z * dz]
        rows.append(permanent + [term / (bt * scale) for term in induced + eddy])
    return np.array(rows)


def test_a_matrix_is_the_matrix_of_the_textbook(sample: Sample) -> None:
    b = vector(sample)
    expected = by_numpy(b, 50_000.0)
    found = tolles_lawson.a_matrix(b, 10.0)
    assert found.shape == (1000, len(tolles_lawson.term_names())) == expected.shape
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)


def test_the_functions_equal_the_stages(run: magline.Run, sample: Sample) -> None:
    tt, mag = sample["time_s"], sample["mag_1_uc_nt"]
    a = tolles_lawson.a_matrix(vector(sample), 10.0, tt=tt)
    assert np.array_equal(a, rows_of(run.table("terms"), "tl"))
    for ridge in [0.0, 0.001, 0.025, 0.25]:
        fit = tolles_lawson.fit(a, mag, 10.0, lambda_=ridge)
        where = f"where lambda = {ridge}"
        table = run.sql(f"select term, value from tolles_lawson.coefficients {where}").polars()
        stage = dict(table.iter_rows())
        assert [stage[name] for name in tolles_lawson.term_names()] == fit.coefficients.tolist()
        clean = tolles_lawson.compensate(mag, a, fit.coefficients, detrend=True)
        assert np.array_equal(clean, rows_of(run.sql(f"select tt, mag_c from tolles_lawson.clean {where}"), "mag_c"))


def test_the_fit_is_the_fit_of_numpy(sample: Sample) -> None:
    a, y = tolles_lawson.a_matrix(vector(sample)), sample["mag_1_uc_nt"]
    fit = tolles_lawson.fit(a, y, lambda_=0.025)
    expected = np.linalg.solve(a.T @ a + 0.025 * np.eye(a.shape[1]), a.T @ y)
    # The normal equations lose twice the digits of the condition number.
    np.testing.assert_allclose(fit.coefficients, expected, rtol=1e-5)
    np.testing.assert_allclose(fit.condition, np.linalg.cond(a), rtol=1e-6)
    assert fit.rows == 1000


@pytest.fixture(scope="module")
def arrays(flight: dict[str, Any]) -> magline.Run:
    return magline.run(flight)


def test_igrf_and_bandpass_equal_the_stages(arrays: magline.Run) -> None:
    assert arrays.failures == []
    field, band = arrays.table("field"), arrays.table("band")
    place = [rows_of(field, name) for name in ("lat", "lon", "alt")]
    for column, component in (("igrf", "magnitude"), ("igrf_n", "north"), ("igrf_e", "east"), ("igrf_d", "down")):
        assert np.array_equal(core_field.igrf(*place, 2020.5, component=component), rows_of(field, column)), column
    filtered = signal.bandpass(rows_of(band, "mag_1_uc"), tt=rows_of(band, "tt"))
    assert np.array_equal(filtered, rows_of(band, "mag_1_uc_bp"), equal_nan=True)
    assert np.isnan(filtered[300]) and np.isfinite(filtered[299]) and np.isfinite(filtered[301])


def test_igrf_is_the_field_of_ppigrf() -> None:
    random = np.random.default_rng(1)
    lat, lon = random.uniform(-89, 89, 200), random.uniform(-180, 180, 200)
    alt = random.uniform(0, 10_000, 200)
    date = datetime.datetime(2020, 1, 1)
    east, north, up = (one.reshape(-1) for one in ppigrf.igrf(lon, lat, alt / 1000.0, date))
    # ppigrf has the same coefficients, which are given to 0.1 nT or better.
    for component, other in {"north": north, "east": east, "down": -up}.items():
        found = core_field.igrf(lat, lon, alt, 2020.0, component=component)
        np.testing.assert_allclose(found, other, atol=0.05)


def test_the_core_field_is_broadcast_and_checked() -> None:
    grid = core_field.igrf(np.array([[40.0], [50.0]]), np.array([0.0, 1.0, 2.0]), 0.0, 2020.0)
    assert grid.shape == (2, 3)
    assert np.isscalar(core_field.wmm(80.0, 0.0, 0.0, 2025.0))
    with pytest.raises(ValueError, match="north"):
        core_field.igrf(0.0, 0.0, 0.0, 2020.0, component="up")
    with pytest.raises(ValueError, match="latitude"):
        core_field.igrf(91.0, 0.0, 0.0, 2020.0)
    with pytest.raises(ValueError, match="1800"):
        core_field.igrf(0.0, 0.0, 0.0, 1800.0)


def test_bandpass_keeps_the_band() -> None:
    tt = np.arange(4000) / 10.0
    inside, outside = np.sin(2 * np.pi * 0.3 * tt), np.sin(2 * np.pi * 0.01 * tt) + 3.0
    found = signal.bandpass(inside + outside, rate_hz=10.0)
    np.testing.assert_allclose(found[1000:3000], inside[1000:3000], atol=0.01)
    with pytest.raises(ValueError, match="either"):
        signal.bandpass(inside)
    with pytest.raises(ValueError, match="long enough"):
        signal.bandpass(inside[:5], rate_hz=10.0)


def test_metrics_are_the_metrics_of_numpy() -> None:
    random = np.random.default_rng(2)
    north, east = random.normal(size=1001) + 1.0, random.normal(size=1001)
    radii = np.hypot(north, east)
    found = {
        "drms": (metrics.drms(north, east), np.sqrt(np.mean(radii**2))),
        "cep": (metrics.cep(north, east), np.quantile(radii, 0.5)),
        "r95": (metrics.r95(north, east), np.quantile(radii, 0.95)),
        "rms": (metrics.rms(north), np.sqrt(np.mean(north**2))),
        "std": (metrics.std(north), np.std(north, ddof=1)),
        "improvement": (metrics.improvement_ratio(north, east), np.std(north) / np.std(east)),
    }
    for name, (one, other) in found.items():
        assert one == pytest.approx(other, rel=1e-12), name
    covariance = np.array([[2.0, 0.5], [0.5, 3.0]])
    errors = np.stack([north, east], axis=1)
    expected = np.einsum("ij,jk,ik->i", errors, np.linalg.inv(covariance), errors)
    ones = np.ones(1001)
    nees = metrics.position_nees(north, east, ones * 2**0.5, ones * 3**0.5, ones * 0.5)
    np.testing.assert_allclose(nees, expected, rtol=1e-10)


def test_missing_samples_are_excluded() -> None:
    assert metrics.rms([3.0, np.nan]) == 3.0
    assert np.isnan(metrics.rms([np.nan]))


def test_wrong_arrays_are_rejected(sample: Sample) -> None:
    flux = vector(sample)
    with pytest.raises(ValueError, match="shape"):
        tolles_lawson.a_matrix(flux[:, :2])
    with pytest.raises(ValueError, match="rate"):
        tolles_lawson.a_matrix(flux, 20.0, tt=sample["time_s"])
    with pytest.raises(ValueError, match="permanent"):
        tolles_lawson.a_matrix(flux, terms=["permanant"])
    with pytest.raises(ValueError, match="dimension"):
        metrics.rms([[1.0]])
    with pytest.raises(ValueError, match="rows"):
        tolles_lawson.fit(np.ones((3, 2)), np.ones(4))
    with pytest.raises(ValueError, match="coefficients"):
        tolles_lawson.predict(np.ones((3, 2)), np.ones(3))


def test_any_layout_and_number_type_is_accepted(sample: Sample) -> None:
    a = tolles_lawson.a_matrix(vector(sample)[::2])
    y = np.arange(len(a), dtype=np.int32)
    one = tolles_lawson.fit(np.asfortranarray(a), y)
    assert np.array_equal(one.coefficients, tolles_lawson.fit(a, y.astype(float)).coefficients)


def test_a_fit_does_not_filter_across_a_gap(sample: Sample) -> None:
    b, mag, tt = vector(sample), sample["mag_1_uc_nt"], sample["time_s"].copy()
    tt[500:] += 60.0
    a = tolles_lawson.a_matrix(b, 10.0, tt=tt)
    found = tolles_lawson.fit(a, mag, 10.0, tt=tt).coefficients
    # A row without a value ends a run as well.
    split = np.insert(a, 500, np.nan, axis=0), np.insert(mag, 500, np.nan)
    assert np.array_equal(found, tolles_lawson.fit(*split, 10.0).coefficients)
    assert not np.array_equal(found, tolles_lawson.fit(a, mag, 10.0).coefficients)
    with pytest.raises(ValueError, match="samples"):
        tolles_lawson.fit(a, mag, 10.0, tt=tt[1:])
    with pytest.raises(ValueError, match="rate"):
        tolles_lawson.fit(a, mag, 20.0, tt=tt)
