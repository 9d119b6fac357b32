"""Time of a call, and speed against ppigrf, harmonica and NumPy in one run.

Each comparison first checks that both programs give the same result. A time is the smallest processor time of several
repetitions, so that other programs on the machine matter little. The ratio is the time of the peer divided by the time
of magline. ppigrf and harmonica belong into an environment for this program: ``pip install ppigrf harmonica``.

Run: python pipeline/python/benches/peers.py
"""

from __future__ import annotations

import os
import sys
import time
import timeit
import warnings
from collections.abc import Callable
from datetime import datetime
from importlib.metadata import version
from typing import Any

import numpy as np
from magline import core_field, maps, metrics, tolles_lawson
from numpy.typing import NDArray

Vector = NDArray[np.float64]


def seconds(call: Callable[[], Any], repeat: int = 3) -> float:
    """Smallest processor time of a call, s."""
    return min(timeit.repeat(call, timer=time.process_time, number=1, repeat=repeat))


def row(what: str, ours_s: float, peer: str, theirs_s: float, difference: str) -> None:
    """Print one comparison."""
    print(f"| {what} | {ours_s:.3g} | {peer} | {theirs_s:.3g} | {theirs_s / ours_s:.3g} | {difference} |", flush=True)


def overhead() -> None:
    """Time of a call that computes almost nothing, against NumPy."""
    x, number = np.ones(4), 20_000
    options: dict[str, Any] = {"timer": time.process_time, "number": number, "repeat": 7}
    ours_s = min(timeit.repeat(lambda: metrics.rms(x), **options)) / number
    theirs_s = min(timeit.repeat(lambda: np.sqrt(np.mean(x**2)), **options)) / number
    row("`metrics.rms` of 4 samples", ours_s, f"NumPy {np.__version__}", theirs_s, "0")


def igrf(points: int = 1_000_000, part: int = 100_000) -> None:
    """Magnitude of the core field at many positions of one date.

    ppigrf holds all coefficients of all positions in memory, so it gets parts, and the time of one part is multiplied
    by their number.
    """
    import ppigrf

    draw = np.random.default_rng(1)
    lat, lon = draw.uniform(-80.0, 80.0, points), draw.uniform(-180.0, 180.0, points)
    alt_m, year = np.full(points, 300.0), np.full(points, 2020.0)

    def theirs() -> Vector:
        east, north, up = ppigrf.igrf(lon[:part], lat[:part], alt_m[:part] / 1000.0, datetime(2020, 1, 1))
        found: Vector = np.sqrt(east**2 + north**2 + up**2).ravel()
        return found

    worst = np.abs(core_field.igrf(lat, lon, alt_m, year)[:part] - theirs()).max()
    assert worst < 0.1, worst
    ours_s = seconds(lambda: core_field.igrf(lat, lon, alt_m, year))
    theirs_s = seconds(theirs, 1) * (points / part)
    peer = f"ppigrf {version('ppigrf')}"
    row(f"`core_field.igrf` at {points:,} positions", ours_s, peer, theirs_s, f"{worst:.2g} nT")


def upward(side: int = 512, step_m: float = 100.0, dz_m: float = 300.0) -> None:
    """Upward continuation of the field of a monopole 2 km below the map, with padding of equal width."""
    import harmonica
    import xarray
    import xrft

    axis = step_m * (np.arange(side) - side / 2)
    east, north = np.meshgrid(axis, axis)

    def field(height_m: float) -> Vector:
        down = 2000.0 + height_m
        made: Vector = 4e8 * down / (east**2 + north**2 + down**2) ** 1.5
        return made

    grid, pad = field(0.0), int(max(10 * dz_m / step_m, side / 10))
    array = xarray.DataArray(grid, {"northing": axis, "easting": axis}, ("northing", "easting"))

    def theirs() -> Vector:
        wide = {"northing": pad, "easting": pad}
        padded = xrft.pad(array, wide)
        raised = xrft.unpad(harmonica.upward_continuation(padded, dz_m), wide)
        return np.asarray(raised)

    inner = np.s_[side // 4 : -side // 4, side // 4 : -side // 4]
    truth = field(dz_m)
    errors = [np.abs(found - truth)[inner].max() for found in (maps.upward(grid, step_m, dz_m), theirs())]
    assert max(errors) < 1.0, errors
    peer = f"harmonica {version('harmonica')}"
    ours_s = seconds(lambda: maps.upward(grid, step_m, dz_m))
    found = f"error of each {errors[0]:.2g} and {errors[1]:.2g} of 100 nT"
    row(f"`maps.upward` of {side} by {side} nodes", ours_s, peer, seconds(theirs), found)


def terms_of(b: Vector, change: Vector, scale_nt: float = 50_000.0) -> Vector:
    """The 18 terms of one sample."""
    total = np.sqrt(b @ b)
    x, y, z = b
    permanent = b / total
    induced = np.array([x * x, x * y, x * z, y * y, y * z, z * z]) / (total * scale_nt)
    eddy = np.outer(b, change).ravel() / (total * scale_nt)
    return np.concatenate([permanent, induced, eddy])


def compensation(samples: int = 100_000) -> None:
    """A-matrix and ridge fit against a loop over samples and against vectorised NumPy."""
    draw = np.random.default_rng(2)
    t = np.arange(samples) / 10.0
    angles = np.stack([np.sin(t / 3.0), np.cos(t / 5.0), 1.5 + np.sin(t / 7.0)], axis=1)
    flux = 50_000.0 * angles / np.linalg.norm(angles, axis=1)[:, None]
    y = flux @ [1e-3, 2e-3, -1e-3] + draw.normal(0.0, 1.0, samples)

    def ours() -> Vector:
        a = tolles_lawson.a_matrix(flux, 10.0)
        return tolles_lawson.fit(a, y, lambda_=0.025).coefficients

    def solved(a: Vector) -> Vector:
        return np.linalg.solve(a.T @ a + 0.025 * np.eye(a.shape[1]), a.T @ y)

    def loop() -> Vector:
        change = np.gradient(flux, axis=0)
        return solved(np.array([terms_of(b, d) for b, d in zip(flux, change, strict=True)]))

    def vectorised() -> Vector:
        change = np.gradient(flux, axis=0)
        x, y_, z = flux.T
        total = np.linalg.norm(flux, axis=1)[:, None]
        induced = np.stack([x * x, x * y_, x * z, y_ * y_, y_ * z, z * z], axis=1)
        eddy = (flux[:, :, None] * change[:, None, :]).reshape(samples, 9)
        return solved(np.concatenate([flux / total, induced / (total * 5e4), eddy / (total * 5e4)], axis=1))

    apart = np.abs(ours() / loop() - 1.0).max()
    assert apart < 1e-4, apart
    ours_s, text = seconds(ours), f"{apart:.1g} of a coefficient"
    peer = f"NumPy {np.__version__}"
    row(f"`a_matrix` and `fit`, {samples:,} samples", ours_s, f"{peer}, loop", seconds(loop, 1), text)
    row(f"`a_matrix` and `fit`, {samples:,} samples", ours_s, f"{peer}, vectorised", seconds(vectorised), text)


def main() -> None:
    """Print the table."""
    # Warnings of harmonica and xrft about their own use of xarray.
    warnings.simplefilter("ignore", FutureWarning)
    load = os.getloadavg()[0]
    print(f"Python {sys.version.split()[0]}, {os.cpu_count()} cores, load {load:.1f}\n")
    print("| measurement | magline, processor s | peer | peer, processor s | ratio | difference |")
    print("|---|---|---|---|---|---|")
    for one in (overhead, igrf, upward, compensation):
        one()


if __name__ == "__main__":
    main()
