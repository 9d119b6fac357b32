"""Vector networks (m3tl to m3tf) and the parts of their predictions, evaluated by numpy from the table of the fit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import magline
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

Terms = dict[str, float]
ROWS, BREAK_AT, SCALE_NT = 300, 130, 48_000.0
CURRENTS = ["cur_1", "cur_2"]
ACTIVATIONS: dict[str, Any] = {
    "swish": lambda s: s / (1.0 + np.exp(-s)),
    "tanh": np.tanh,
    "relu": lambda s: np.maximum(s, 0.0),
    "sigmoid": lambda s: 1.0 / (1.0 + np.exp(-s)),
}
# Model and its own keys.
CASES: list[tuple[str, dict[str, Any]]] = [
    ("m3tl", {}),
    ("m3s", {"hidden": [6], "members": 2}),
    ("m3v", {"hidden": [7, 4], "activation": "tanh"}),
    ("m3sc", {"hidden": [5], "activation": "sigmoid"}),
    ("m3vc", {"hidden": [5], "members": 2}),
    ("m3w", {"hidden": [4], "window": 3, "activation": "relu"}),
    ("m3tf", {"hidden": [3], "window": 4, "units": 6, "heads": 2}),
]


def line(number: int) -> dict[str, np.ndarray]:
    """A turning aircraft with a permanent, an induced and a current field; a gap in time."""
    random = np.random.default_rng(number)
    tt = 1000.0 * number + 0.1 * np.arange(ROWS)
    tt[BREAK_AT:] += 7.0
    a, b = 0.11 * tt + number, 0.4 * np.sin(0.23 * tt)
    field = 50_000.0 * np.stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b) + 0.6], axis=1)
    currents = [np.sin(0.31 * k * tt + number) + 0.3 * random.normal(size=ROWS) for k in (1, 2)]
    more = np.stack([40.0 * currents[0] * currents[1], 25.0 * np.tanh(currents[0]), 0.0 * tt], axis=1)
    v = np.array([300.0, -120.0, 80.0]) + field @ np.diag([2e-3, -1e-3, 4e-3]) + more
    size = np.linalg.norm(field, axis=1)
    off = size - np.linalg.norm(field - v, axis=1) + random.normal(0.0, 0.3, ROWS)
    axes = {f"flux_a_{axis}": values for axis, values in zip("xyz", field.T, strict=True)}
    return {"tt": tt, "mag_1_uc": size + off, "mag_1_c": size, **dict(zip(CURRENTS, currents, strict=True)), **axes}


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("vector") / "flights.parquet"
    names = [(["1"] * ROWS, [f"1.0{number}"] * ROWS) for number in (1, 2)]
    keys = [{"flight": flight, "line": name} for flight, name in names]
    pq.write_table(pa.concat_tables(pa.table(keys[n] | line(n + 1)) for n in (0, 1)), path)
    return path


def spec(flights: Path, model: str, coupling: str, keys: dict[str, Any]) -> dict[str, Any]:
    frame = {} if coupling == "projection" else {"bt_scale_nt": SCALE_NT}
    fit: dict[str, Any] = {"name": "network", "stage": "fit", "input": "terms", "model": model, "target": "off"}
    fit |= {"epochs": 20, "batch": 64, "learning_rate": 0.02, "features": ["tl", *CURRENTS], "where": "line = '1.01'"}
    inputs = {} if model == "m3tl" else {"inputs": [*CURRENTS, "x", "zz"]}
    matrix = {"name": "terms", "stage": "a_matrix", "input": "off", "vector": "flux_a", "bt_scale_nt": SCALE_NT}
    fit |= frame | inputs | keys | {"coupling": coupling}
    off = {"name": "off", "stage": "derive", "input": "flights", "columns": {"off": "mag_1_uc - mag_1_c"}}
    clean = {"name": "clean", "stage": "compensate", "input": "terms", "model": "network", "mag": "mag_1_uc"}
    return {
        "name": "vector",
        "tables": {"flights": {"path": str(flights)}},
        "stages": [off, matrix, fit, clean | {"parts": True}],
    }


def listed(terms: Terms, key: str) -> np.ndarray:
    """Values of the terms `key[1]`, `key[2]` and so on. A name may follow the number."""
    return np.array([value for term, value in terms.items() if term.startswith(f"{key}[")])


def named(terms: Terms, key: str) -> list[str]:
    """Names of the terms `key[1] name`, or the word of `key word`."""
    return [term.split(" ")[1] for term in terms if term.startswith((f"{key}[", f"{key} ")) and " " in term]


def normalised(x: np.ndarray, factors: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    centred = x - x.mean(-1, keepdims=True)
    return factors * centred / np.sqrt((centred**2).mean(-1, keepdims=True) + 1e-5) + offsets


def encoded(z: np.ndarray, terms: Terms, member: str) -> np.ndarray:
    """Features of windows (row, sample, input), by one layer of a transformer."""
    units, heads = int(terms["units"]), int(terms["heads"])
    part = {key: listed(terms, f"{member}{key}") for key in ("be", "g1", "o1", "bf", "g2", "o2")}
    square = {key: listed(terms, f"{member}{key}").reshape(units, -1) for key in ("we", "wq", "wk", "wv", "wo", "wf")}
    positions = listed(terms, f"{member}p").reshape(z.shape[1], units)
    e = np.sqrt(units) * (z @ square["we"].T + part["be"]) + positions
    results = []
    for own in np.split(np.arange(units), heads):
        q, k, v = (e @ square[key][own].T for key in ("wq", "wk", "wv"))
        scores = np.exp(q @ k.transpose(0, 2, 1) / np.sqrt(units / heads))
        results.append(scores / scores.sum(-1, keepdims=True) @ v)
    n = normalised(e + np.concatenate(results, -1) @ square["wo"].T, part["g1"], part["o1"])
    of = ACTIVATIONS[named(terms, "activation")[0]]
    return normalised(n + of(n @ square["wf"].T + part["bf"]), part["g2"], part["o2"]).reshape(len(z), -1)


def outputs(z: np.ndarray, terms: Terms, member: str) -> np.ndarray:
    """Outputs of the dense layers, of which the last has no activation."""
    of = ACTIVATIONS[named(terms, "activation")[0]]
    layers = len(listed(terms, "hidden")) + 1
    for number in range(1, layers + 1):
        bias = listed(terms, f"{member}b{number}")
        sums = z @ listed(terms, f"{member}w{number}").reshape(len(bias), -1).T + bias
        z = of(sums) if number < layers else sums
    return z


def windows(z: np.ndarray, tt: np.ndarray, length: int) -> np.ndarray:
    """Windows that end at each row. The first row after a gap replaces missing earlier ones."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(tt) > 0.15) + 1])
    first = starts[np.searchsorted(starts, np.arange(len(z)), side="right") - 1]
    rows = np.maximum(np.arange(len(z))[:, None] + np.arange(1 - length, 1), first[:, None])
    return z[rows]


def expected(model: str, terms: Terms, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Prediction and its parts in nT, from B and dB themselves and not from the Tolles-Lawson terms."""
    mean_nt, scale_nt = terms["target_mean"], terms["target_scale"]
    field = np.stack([columns[f"flux_a_{axis}"] for axis in "xyz"], axis=1)
    change = np.empty_like(field)
    for own in (slice(0, BREAK_AT), slice(BREAK_AT, None)):
        change[own] = np.gradient(field[own], axis=0)
    x = [columns[name] for name in named(terms, "input_mean")]
    z = (np.stack(x, axis=1) - listed(terms, "input_mean")) / listed(terms, "input_scale") if x else np.empty((ROWS, 0))
    coupling = named(terms, "coupling")[0]

    def scalar(v: np.ndarray) -> np.ndarray:
        size = np.linalg.norm(field, axis=1)
        if coupling == "projection":
            return (v * field).sum(1) / size
        return size - np.linalg.norm(field - v, axis=1)

    made: list[dict[str, np.ndarray]] = []
    for member in ["", *(f"member{n}." for n in range(2, int(terms["members"]) + 1))]:
        b = scale_nt * listed(terms, f"{member}linear")
        matrix = np.array([[b[3], b[4] / 2, b[5] / 2], [b[4] / 2, b[6], b[7] / 2], [b[5] / 2, b[7] / 2, b[8]]])
        vectors = {
            "permanent": np.broadcast_to(b[:3], field.shape),
            "induced": field @ matrix / SCALE_NT,
            "eddy": change @ b[9:].reshape(3, 3).T / SCALE_NT,
            "network": np.zeros_like(field),
        }
        linear = scalar(vectors["permanent"] + vectors["induced"] + vectors["eddy"])
        if model in ("m3v", "m3vc"):
            vectors["network"] = scale_nt * outputs(z, terms, member)
            predicted = scalar(sum(vectors.values(), np.zeros(3))) + scale_nt * terms[f"{member}constant"]
        elif model == "m3tl":
            predicted = linear + scale_nt * terms[f"{member}b1[1]"]
        else:
            features = z
            if model in ("m3w", "m3tf"):
                features = windows(z, columns["tt"], int(terms["window"]))
                features = encoded(features, terms, member) if model == "m3tf" else features.reshape(ROWS, -1)
            predicted = linear + scale_nt * outputs(features, terms, member)[:, 0]
        parts = {"mag_aircraft": mean_nt + predicted, "part_linear": linear}
        for name, values in vectors.items():
            parts |= {f"part_{name}_{axis}": each for axis, each in zip("xyz", values.T, strict=True)}
        made.append(parts)
    mean = {name: np.mean([each[name] for each in made], axis=0) for name in made[0]}
    return mean | {"part_network": mean["mag_aircraft"] - mean["part_linear"]}


@pytest.mark.parametrize("coupling", ["magnitude", "projection"])
@pytest.mark.parametrize(("model", "keys"), CASES, ids=[model for model, _ in CASES])
def test_a_vector_network_and_its_parts_are_those_of_numpy(
    model: str, keys: dict[str, Any], coupling: str, flights: Path, tmp_path: Path
) -> None:
    run = magline.run(spec(flights, model, coupling, keys), store=tmp_path / "store", threads=1)
    assert run.failures == []
    table = run.table("network").to_arrow()
    terms = dict(zip(table["term"].to_pylist(), table["value"].to_pylist(), strict=True))
    clean = run.table("clean").pandas()
    for number in (1, 2):
        found = clean[clean["line"] == f"1.0{number}"]
        columns = line(number)
        size_nt = np.linalg.norm([columns[f"flux_a_{axis}"] for axis in "xyz"], axis=0)
        columns |= {"x": columns["flux_a_x"] / size_nt, "zz": columns["flux_a_z"] ** 2 / (SCALE_NT * size_nt)}
        made = expected(model, terms, columns)
        largest = np.abs(made["mag_aircraft"]).max()
        for name, values in made.items():
            np.testing.assert_allclose(found[name], values, rtol=0.0, atol=1e-9 * largest, err_msg=name)
        # The training has moved the network away from a constant, and the linear part away from 0.
        assert (np.ptp(made["part_network"]) > 1.0) == (model != "m3tl")
        assert np.ptp(made["part_linear"]) > 100.0
