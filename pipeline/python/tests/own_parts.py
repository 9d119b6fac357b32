"""Parts for the tests of parts: some repeat built-in ones, and some fail."""

from __future__ import annotations

import os
import time
from typing import Any, Literal

import magline
import numpy as np
import sklearn.linear_model

AXES = ["x", "y", "z"]


def root_of_squares(columns: list[np.ndarray]) -> np.ndarray:
    return np.sqrt(columns[0] ** 2 + columns[1] ** 2 + columns[2] ** 2)


@magline.stage(
    reads={"{vector}_x": "nT", "{vector}_y": "nT", "{vector}_z": "nT"}, makes={"{vector}_total": "nT"}, version=2
)
def total(line: magline.Line, *, vector: str) -> np.ndarray:
    """The magnitude of a vector magnetometer, as the stage `magnitude`."""
    return root_of_squares([line[f"{vector}_{axis}"] for axis in AXES])


@magline.stage(
    reads=["{columns}"],
    makes={
        "{columns}_abs": "nT",
        "pair": magline.Column("nT", "two columns", terms=["a", "b"]),
        "sign": magline.Column(text=True),
    },
    version=1,
)
def several(
    line: magline.Line, *, columns: list[str], scale: float = 1.0, kind: Literal["plain", "odd"] = "plain"
) -> dict[str, Any]:
    """Columns of all types."""
    made: dict[str, Any] = {f"{name}_abs": scale * np.abs(line[name]) for name in columns}
    first, last = line[columns[0]], line[columns[-1]]
    made["pair"] = np.stack([first, last], axis=1)
    made["sign"] = ["+" if one > 0 else "-" for one in first]
    return made


@magline.stage(reads=["tt"], makes={"seen": "s"}, version=1)
def rough(line: magline.Line, *, bad: str = "", how: str = "raise") -> Any:
    """Fails on one line."""
    if line.line == bad:
        return {"raise": fail, "short": lambda: line["tt"][1:], "write": lambda: line["tt"].sort(), "name": dict}[how]()
    return line["tt"]


def fail() -> None:
    raise ValueError("this line is \x1b[31mrough\x1b[0m")


@magline.stage(reads=["tt"], makes={"address": "1", "writeable": "1"}, version=1)
def address(line: magline.Line) -> dict[str, float]:
    """Address of the column `tt` in NumPy and in Arrow."""
    import pyarrow as pa

    tt = line["tt"]
    arrow = pa.record_batch(line)["tt"].buffers()[1].address
    return {"address": float(tt.__array_interface__["data"][0] - arrow), "writeable": float(tt.flags.writeable)}


@magline.stage(reads=["tt"], makes={"process": "1"}, version=1)
def process(line: magline.Line) -> float:
    """Number of the process."""
    return float(os.getpid())


magline.model(sklearn.linear_model.Ridge, name="sk_ridge", version=1, keys=["alpha", "fit_intercept"])


@magline.model(version=1)
def line_means(*, shift: float = 0.0, words: list[str] | None = None) -> LineMeans:
    """The mean of the target over lines."""
    return LineMeans(shift)


class LineMeans:
    """State is a pickle of this class."""

    def __init__(self, shift: float) -> None:
        self.shift = shift

    def fit(self, x: np.ndarray, y: np.ndarray, groups: np.ndarray, names: list[str]) -> LineMeans:
        self.names = names
        self.means = [float(y[groups == group].mean()) for group in np.unique(groups)]
        return self

    def predict(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.full(len(x), np.mean(self.means) + self.shift), np.full(len(x), 2.5)


@magline.metric(unit="nT", version=1, pool="mean")
def median_error(error: np.ndarray) -> float:
    """median absolute error of the compensated signal.

    Not part of the meaning.
    """
    return float(np.median(np.abs(error)))


@magline.metric(unit="nT", version=1, pool="rms", better="neither")
def own_rms(signal: np.ndarray, truth: np.ndarray, cur_1: np.ndarray) -> tuple[float, int]:
    """root mean square error, as `rms_error`"""
    return float(np.sqrt(np.mean((signal - truth) ** 2))), len(cur_1)


@magline.filter(version=1)
def moved(flight: magline.Flight, *, north_m: float = 0.0, bad: bool = False) -> dict[str, Any]:
    """The INS, moved north; the residual is the measurement minus the map at the INS."""
    field, *_ = flight.field(flight["lat"], flight["lon"], flight["alt"])
    made: dict[str, Any] = {
        "lat": flight["lat"] + north_m / 111_000.0,
        "lon": flight["lon"],
        "sd_n": 10.0,
        "residual": flight["measured"] - field,
    }
    if bad:
        del made["lon"]
    return made


@magline.stage(reads=["tt"], makes={"waited": "s"}, version=1)
def slow(line: magline.Line, *, seconds: float) -> float:
    """Waits."""
    time.sleep(seconds)
    return seconds


@magline.metric(unit="nT", version=1)
def rough_metric(signal: np.ndarray) -> float:
    """fails"""
    raise ZeroDivisionError("no metric")


@magline.stage(reads={"mag_1_uc": "nT"}, makes={"{to}": "nT"}, version=1)
def named(line: magline.Line, *, to: str) -> np.ndarray:
    """A copy whose first sample is masked and whose second is infinite."""
    values = np.ma.masked_array(line["mag_1_uc"].copy(), mask=False)
    values[0] = np.ma.masked
    values[1] = np.inf
    return values
