"""Line of arrays as input of the stage ``navigate``, and its track."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magline import _magline
from magline._arrays import column, columns, matrix
from magline.maps import Map

Vector = NDArray[np.float64]
ListLike = Sequence[Any] | NDArray[Any]
Magnetometers = ArrayLike | Mapping[str, ArrayLike]
#: Arguments of a filter that are not keys of the stage.
INPUTS = frozenset(
    "tt_s ins_lat_deg ins_lon_deg ins_alt_m mag_nt map ins_velocity_ned_mps ins_force_ned_mps2 "
    "ins_attitude_deg columns models rate_hz".split()
)


@dataclass(frozen=True)
class TrackWarning:
    """Warning about an untrustworthy track, as in `magline.Run.warnings`.

    Attributes
    ----------
    kind : str
        Subject, such as ``nis_high`` or ``off_map``.
    value, limit : float or None
        Flagged value and the limit that it violates, in ``unit``.
    unit : str
        Unit of ``value`` and ``limit``.
    text : str
        Description in one sentence.
    cause : str or None
        Likely cause; None if it is unknown.
    """

    kind: str
    value: float | None
    limit: float | None
    unit: str
    text: str
    cause: str | None

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True, repr=False)
class Track:
    """Estimate of a filter: the state after the measurement of each sample.

    All arrays have the shape (samples,).

    Attributes
    ----------
    tt_s : numpy.ndarray
        Time, s.
    lat_deg, lon_deg, alt_m : numpy.ndarray
        Latitude, longitude (degrees) and height above the WGS-84 ellipsoid (m).
    vn_mps, ve_mps, vd_mps : numpy.ndarray
        Velocity north, east and down, m/s.
    sd_n_m, sd_e_m : numpy.ndarray
        Standard deviations of the position error north and east, m.
    cov_ne_m2 : numpy.ndarray
        Covariance of the north and east position errors, m^2.
    residual_nt : numpy.ndarray
        Innovation: measurement minus prediction, nT; NaN where no measurement was used.
    nis : numpy.ndarray
        Normalised innovation squared.
    update : numpy.ndarray of str
        Outcome of the measurement: used, missing, off_map, gated, flat or unused.
    more : dict of str to numpy.ndarray
        Further columns of the stage under their names, such as ``noise_sigma`` (nT) or, with
        ``save_state=True``, ``x`` of shape (samples, states).
    units : dict of str to str
        Unit of each column of ``more``.
    warnings : list of TrackWarning
        Warnings about an untrustworthy track: the warnings of a run that scores this track. With
        the true positions ``lat`` and ``lon`` in ``columns`` they cover the errors too.
    notes : list of str
        Choices that the arguments left to magline.
    """

    tt_s: Vector
    lat_deg: Vector
    lon_deg: Vector
    alt_m: Vector
    vn_mps: Vector
    ve_mps: Vector
    vd_mps: Vector
    sd_n_m: Vector
    sd_e_m: Vector
    cov_ne_m2: Vector
    residual_nt: Vector
    nis: Vector
    update: NDArray[np.str_]
    more: dict[str, Any]
    units: dict[str, str]
    warnings: list[TrackWarning]
    notes: list[str]

    @property
    def covariance_m2(self) -> NDArray[np.float64]:
        """Covariance of the position error north and east, m^2, of shape (samples, 2, 2)."""
        rows = [[self.sd_n_m**2, self.cov_ne_m2], [self.cov_ne_m2, self.sd_e_m**2]]
        return np.moveaxis(np.array(rows), -1, 0)

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.tt_s)

    def __repr__(self) -> str:
        flagged = "".join(f"; {warning.text}" for warning in self.warnings)
        return f"<magline.filters.Track: {len(self)} samples, {np.sum(self.update == 'used')} used{flagged}>"


#: Attribute of a track for each column of the stage.
_TRACK = {
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


def navigate_line(filter: str, given: Mapping[str, Any]) -> Track:
    """Run a filter. `given` holds the inputs and the keys; a key with the value None is unset."""
    lines, mags = _line(given)
    named = {name: item for name, item in given.items() if name not in INPUTS and item is not None}
    keys = [(name.removesuffix("_"), _plain(item)) for name, item in named.items()]
    keys += [("filter", filter), *([("mag", mags)] if mags else [])]
    models = [_model(one) for one in given.get("models") or ()]
    found, notes, warned = _magline.navigate(
        keys, list(lines.items()), given.get("rate_hz"), _map(given.get("map")), models
    )
    own: dict[str, Any] = {_TRACK[name]: np.array(values) for name, _, values in found if name in _TRACK}
    more = [(name, unit, np.array(values)) for name, unit, values in found if name not in _TRACK]
    return Track(
        tt_s=lines["tt"],
        **own,
        more={name: values for name, _, values in more},
        units={name: unit for name, unit, _ in more},
        warnings=[TrackWarning(**one) for one in json.loads(warned)],
        notes=notes,
    )


def _line(given: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Columns of the flight table, and the names of the magnetometers."""
    names = {"tt": "tt_s", "ins_lat": "ins_lat_deg", "ins_lon": "ins_lon_deg", "ins_alt": "ins_alt_m"}
    line: dict[str, Any] = {name: column(given[argument]) for name, argument in names.items()}
    rows = line["tt"].shape
    for argument, axes in (
        ("ins_velocity_ned_mps", ("ins_vn", "ins_ve", "ins_vd")),
        ("ins_force_ned_mps2", ("ins_fn", "ins_fe", "ins_fd")),
        ("ins_attitude_deg", ("ins_roll", "ins_pitch", "ins_yaw")),
    ):
        if given.get(argument) is not None:
            three = matrix(given[argument])
            if three.shape != (*rows, 3):
                raise ValueError(f"`{argument}` must have the shape {(*rows, 3)}, not {three.shape}")
            line.update((name, column(three[:, i])) for i, name in enumerate(axes))
    mag = given.get("mag_nt")
    mags = {} if mag is None else dict(mag) if isinstance(mag, Mapping) else {"mag_c": mag}
    for source in (mags, given.get("columns") or {}):
        for name, item in source.items():
            if name in line:
                raise ValueError(f"the column `{name}` is given twice")
            line[name] = _values(name, item, rows)
    lengths = {name: len(item[0] if isinstance(item, tuple) else item) for name, item in line.items()}
    if set(lengths.values()) != {rows[0]}:
        raise ValueError(f"the arrays have different lengths: {lengths}")
    return line, list(mags)


def _values(name: str, item: Any, rows: tuple[int, ...]) -> Any:
    """Column of the flight table: numbers, text, or a matrix with the names of its columns."""
    if isinstance(item, str):
        return [item] * rows[0]
    if isinstance(item, tuple) and len(item) == 2 and np.ndim(item[0]) == 2:
        values, names = matrix(item[0]), [str(one) for one in item[1]]
        if values.shape[1] != len(names):
            raise ValueError(f"`{name}` has {values.shape[1]} columns, but {len(names)} names")
        return values, names
    array = np.asarray(item)
    if array.dtype.kind in "OUT" and all(isinstance(one, str) for one in array.ravel()):
        return [str(one) for one in array.ravel()]
    if array.ndim == 2:
        raise ValueError(f"`{name}` has two dimensions; give a pair: the values, and the names of the columns")
    return column(np.full(rows, array) if array.ndim == 0 else array)


def _plain(item: Any) -> Any:
    """Bool, int, float, text, or a list of these."""
    item = item.tolist() if isinstance(item, np.ndarray | np.generic) else item
    return [_plain(one) for one in item] if isinstance(item, list | tuple) else item


def _model(one: Any) -> tuple[list[str], list[float], list[float], float | None]:
    """Terms, values, standard deviations and sample rate of a table of ``fit``."""
    has_rate = "rate_hz" in getattr(one, "column_names", getattr(one, "columns", one))
    terms = [str(term) for term in one["term"]]
    value, std = columns(value=one["value"], std=one["std"])
    if len(terms) != value.size:
        raise ValueError(f"a model has {len(terms)} terms, but {value.size} values")
    rates = column(np.atleast_1d(one["rate_hz"])) if has_rate else np.array([np.nan])
    rate = float(rates[0])
    return terms, value.tolist(), std.tolist(), rate if rate > 0.0 else None


def _map(map: Map | None) -> Any:
    """Arrays of a map."""
    if map is None:
        return None
    shape = (len(map.y), len(map.x))
    anomaly = matrix(map.anomaly_nt)
    if anomaly.shape != shape:
        raise ValueError(f"the anomaly must have the shape {shape}, not {anomaly.shape}")
    alt = matrix(np.broadcast_to(map.alt_m, shape))
    error = None if map.error_nt is None else matrix(np.broadcast_to(map.error_nt, shape))
    return column(map.x), column(map.y), anomaly, alt, map.epsg, error, map._steps
