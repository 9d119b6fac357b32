"""Filters fed sample by sample, and the components of a map, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from magline import maps, stream

AT_REST = [45.0, -76.0, 300.0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.80665, 0.0, 0.0, 0.0]
# Meridian radius of curvature plus height, in metres per degree, at 45 degrees and 300 m.
M_PER_DEG = (6378137.0 * (1 - 0.00669438) / (1 - 0.00669438 / 2) ** 1.5 + 300.0) * np.pi / 180


def slope() -> stream.Map:
    """A map that rises by 0.05 nT a metre northward."""
    lat, lon = np.linspace(44.9, 45.1, 21), np.linspace(-76.1, -75.9, 21)
    return lat, lon, 0.05 * M_PER_DEG * (lat[:, None] - 45.0) + 0.0 * lon


ERRORS = {"init_position_sigma_m": 100.0, "fogm_sigma_nt": 0.0}


def test_one_measurement_over_a_slope_has_the_closed_form() -> None:
    at = stream.ekf(slope(), errors=ERRORS).push([0.0, *AT_REST], 6.0, 5.0)
    assert abs((at.lat_deg - 45.0) * M_PER_DEG - 60.0) < 0.1
    assert abs(at.sd_n_m - 100.0 / np.sqrt(2.0)) < 0.1
    assert abs(at.nis - 36.0 / 50.0) < 1e-3


def test_a_saved_filter_resumes_and_a_duplicate_is_an_error() -> None:
    term = [[0.0, 0.0], [10.0, 10.0], [0.0, 0.0]]
    makers = [
        (lambda: stream.ekf(slope(), errors=ERRORS), {}),
        (lambda: stream.adaptive(slope(), [(0.5, 50.0)], errors=ERRORS), {}),
        (lambda: stream.online(slope(), [tuple(term)], errors=ERRORS), {"terms": [1.0, 0.5]}),
    ]
    for make, more in makers:
        one, other = make(), make()
        for k in range(20):
            one.push([0.1 * k, *AT_REST], 6.0 + np.sin(k), 5.0, **more)
        other.restore(one.save())
        assert one.push([2.0, *AT_REST], 6.0, 5.0, **more) == other.push([2.0, *AT_REST], 6.0, 5.0, **more)
        with pytest.raises(ValueError, match="already used"):
            one.push([2.0, *AT_REST], 6.0, 5.0, **more)
        with pytest.raises(ValueError, match="damaged"):
            other.restore(one.save()[:-1])
        assert len(one.coefficients[0]) == len(more.get("terms", []))


def test_an_unknown_error_source_is_an_error() -> None:
    with pytest.raises(ValueError, match="no key `vrw`"):
        stream.ekf(slope(), errors={"vrw": 1.0})


def test_components_of_a_dipole() -> None:
    inclination, declination = np.radians(60.0), np.radians(10.0)
    level, down = np.cos(inclination), np.sin(inclination)
    # East, north, up.
    along = np.array([level * np.sin(declination), level * np.cos(declination), -down])
    x, y = np.meshgrid(100.0 * np.arange(96) - 4750.0, 100.0 * np.arange(96) - 4750.0)
    r = np.stack([x, y, np.full_like(x, 500.0)], axis=-1)
    size = np.linalg.norm(r, axis=-1, keepdims=True)
    moment = 5e7 * along
    field = 100.0 * (3.0 * r * (r @ moment)[..., None] / size**5 - moment / size**3)
    north, east, below = maps.vector(field @ along, 100.0, 60.0, 10.0)
    inside = np.s_[15:-15, 15:-15]
    for found, exact in [(east, field[..., 0]), (north, field[..., 1]), (below, -field[..., 2])]:
        error = (found - exact)[inside]
        assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(np.mean(exact[inside] ** 2))


def test_a_level_core_field_gives_a_warning() -> None:
    with pytest.warns(UserWarning, match="at an inclination of 3.0 degrees"):
        maps.vector(np.ones((20, 20)), 100.0, 3.0, 0.0)
