"""Neural covariance: the published weights of a training, evaluated by numpy alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import magline
import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[3]
FLIGHTS = REPOSITORY / "tests" / "cases" / "foreign"
# Innovations, slope and motion, before the columns of `features`.
FILTER_INPUTS = 8


def listed(terms: dict[str, float], key: str) -> np.ndarray:
    """Values of the terms `key[1]`, `key[2]` and so on. A name may follow the number."""
    named = {term: value for term, value in terms.items() if term.startswith(f"{key}[")}
    found = sorted((int(term.split("[")[1].split("]")[0]), value) for term, value in named.items())
    return np.array([value for _, value in found])


def factors(terms: dict[str, float], inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors on the standard deviations of R and Q at each sample, from the equations of the documentation."""
    units, limit = int(terms["hidden"]), terms["limit"]
    noise = next(term.split()[1] for term in terms if term.startswith("noise "))
    f = (inputs - listed(terms, "mean")) * listed(terms, "inverse_deviation")
    f = np.clip(np.where(np.isfinite(f), f, 0.0), -5.0, 5.0)
    weights, width = listed(terms, "weight"), f.shape[1] + units + 1
    gates = weights[: 4 * units * width].reshape(4, units, width)
    outputs = weights[4 * units * width :].reshape(-1, units + 1)
    w, u, b = gates[:, :, : f.shape[1]], gates[:, :, f.shape[1] : -1], gates[:, :, -1]
    h, c = np.zeros(units), np.zeros(units)
    logs = []
    for row in f:
        sums = w @ row + u @ h + b
        i, j, o = (1.0 / (1.0 + np.exp(-sums[gate])) for gate in (0, 1, 3))
        c = j * c + i * np.tanh(sums[2])
        h = o * np.tanh(c)
        logs.append(2.0 * np.log(limit) * np.tanh(outputs[:, :-1] @ h + outputs[:, -1]))
    scale = np.exp(0.5 * np.array(logs))
    one = np.ones(len(f))
    r = scale[:, 0] if noise in ("r", "both") else one
    q = scale[:, -1] if noise in ("q", "both") else one
    return r, q


def spec(noise: str, loss: str, features: list[str]) -> dict[str, Any]:
    """Training on two lines of another simulator, and the filter on a third."""
    keys: dict[str, Any] = {
        "input": "flights",
        "map": "anomaly",
        "mag": "mag_1_uc",
        "tuning": "magnav",
        "start": "given",
        "remove_diurnal": False,
        "init_position_sigma_m": 50.0,
        "features": features,
    }
    train = {
        "name": "learnt",
        "stage": "noise_network",
        "where": "flight in ('s0100', 's0101')",
        "epochs": 2,
        "hidden": 5,
        "network_noise": noise,
        "loss": loss,
    }
    use = {
        "name": "track",
        "stage": "navigate",
        "filter": "nekf",
        "where": "flight = 's0102'",
        "model": "learnt",
        "save_inputs": True,
    }
    tables = {
        "flights": {"path": str(FLIGHTS / "plain.parquet")},
        "anomaly": {"path": str(FLIGHTS / "map_800.parquet")},
    }
    return {"name": "neural", "tables": tables, "stages": [train | keys, use | keys]}


@pytest.mark.parametrize(
    ("noise", "loss", "features"),
    [("r", "likelihood", []), ("q", "likelihood", ["ins_lon"]), ("both", "position", ["ins_lon", "ins_vn"])],
)
def test_the_factors_of_a_trained_network_are_those_of_numpy(
    noise: str, loss: str, features: list[str], tmp_path: Path
) -> None:
    run = magline.run(spec(noise, loss, features), store=tmp_path / "store", threads=1)
    model, track = run.table("learnt").to_arrow(), run.table("track").to_arrow()
    terms = dict(zip(model["term"].to_pylist(), model["value"].to_pylist(), strict=True))
    inputs = np.array(track["noise_inputs"].to_pylist(), dtype=float)
    assert inputs.shape == (track.num_rows, FILTER_INPUTS + len(features))
    r, q = factors(terms, inputs)
    for name, expected, changes in [("noise_factor", r, noise != "q"), ("fogm_factor", q, noise != "r")]:
        found = track[name].to_numpy()
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=0.0)
        # The training has moved the outputs away from their initial value.
        assert (np.ptp(found) > 1e-3) == changes, name
