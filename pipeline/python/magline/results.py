"""Results of a run: pooled scores, warnings and failures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from magline import _html
from magline.errors import Fault


@dataclass(frozen=True)
class Warning:
    """Warning about an untrustworthy result.

    Attributes
    ----------
    stage : str
        Name of the table of scores, the model or the map.
    axes : dict
        Value of each axis at the point.
    flight, line : str or None
        Identifiers of the flight and line; None for a fit.
    kind : str
        Kind of the warning, such as ``nees_high`` or ``fit``.
    value, limit : float or None
        Flagged value and the limit that it violates, in ``unit``.
    unit : str
        Unit of ``value`` and ``limit``.
    text : str
        Description in one sentence.
    cause : str or None
        Likely cause; None if it is unknown.

    Examples
    --------
    >>> import magline, tempfile
    >>> spec = "datasets/examples/tolles_lawson.toml"
    >>> trivial = {"axes.lambda": [0.0], "coefficients.low_hz": 0.0, "coefficients.high_hz": 0.0}
    >>> for warning in magline.run(spec, set=trivial, store=tempfile.mkdtemp()).warnings:
    ...     print(warning.stage, warning.kind, warning.axes)
    coefficients fit {'lambda': 0.0}
    """

    stage: str
    axes: dict[str, Any]
    flight: str | None
    line: str | None
    kind: str
    value: float | None
    limit: float | None
    unit: str
    text: str
    cause: str | None

    def __str__(self) -> str:
        return _html.visible(f"{self.stage}: {self.text}")


@dataclass(frozen=True)
class Failure:
    """Unit that could not be computed.

    Attributes
    ----------
    stage : str
        Name of the stage or of the table of files.
    axes : dict
        Value of each axis at the point.
    flight, line : str or None
        Identifiers of the flight and line; None for a stage that processes the whole survey.
    error : str
        Error message.
    fault : Fault
        The same error, with its owner, place and remedy as attributes.

    Examples
    --------
    >>> import magline, pathlib, tempfile
    >>> log = pathlib.Path(tempfile.mkdtemp()) / "flight.csv"
    >>> _ = log.write_text("tt,lat,lon,mag_1_uc\\n0.0,95.0,10.0,50000\\n0.1,95.0,10.0,50001\\n")
    >>> spec = magline.Spec("bad", store=log.parent / "store")
    >>> flights = spec.table("flights", log, flight="1", line="1")
    >>> even = spec.resample(name="even", input=flights, rate_hz=10.0)
    >>> failure = spec.run().failures[0]
    >>> failure.flight, failure.line, failure.fault.column, failure.fault.row
    ('1', '1', 'lat', 0)
    >>> failure.fault.what
    '95 deg is not a latitude (-90 to 90 deg); this applies to 2 of 2 values'
    """

    stage: str
    axes: dict[str, Any]
    flight: str | None
    line: str | None
    error: str
    fault: Fault

    def __str__(self) -> str:
        return _html.visible(f"{self.stage}: {self.error}")


@dataclass(frozen=True)
class ScoreTable:
    """Scores of each point of a sweep, pooled over lines as in the terminal.

    Lines in sample are excluded, unless all lines are in sample. A line is in sample if the score
    depends on a model, noise or map that was fitted to it, or a parameter that was chosen on it.

    Attributes
    ----------
    name : str
        Name of the table of scores.
    over : str
        Description of the pooled lines, such as ``pooled over 3 held-out lines``.
    units : dict of str to str
        Unit of each metric.
    rows : list of dict
        One dict per point. ``axes`` holds the axis values as text, and ``metrics`` the pooled value
        of each metric, or None. ``lines`` is the number of lines, and ``marked`` the number of
        flagged lines. ``best`` is True at the best point. ``in_sample`` is True if all lines are in
        sample.

    Examples
    --------
    >>> import magline, tempfile
    >>> run = magline.run("datasets/examples/tolles_lawson.toml", store=tempfile.mkdtemp())
    >>> scores = run.scores["scores"]
    >>> scores.over, scores.units["std_uncompensated"]
    ('one line', 'nT')
    >>> for row in scores.records():
    ...     print(row["lambda"], round(row["improvement_ratio_band"], 2))
    0 3.69
    0.001 3.23
    0.025 1.98
    0.25 1.41
    """

    name: str
    over: str
    units: dict[str, str]
    rows: list[dict[str, Any]]
    _text: str = field(repr=False, compare=False)

    def records(self) -> list[dict[str, Any]]:
        """Rows as flat dicts: axes, metrics, ``lines``, ``flagged``, ``best`` and ``in_sample``.

        Axis values are numbers where possible. ``flagged`` is the number of flagged lines.
        """
        return [
            {
                **{name: _axis(text) for name, text in row["axes"].items()},
                **row["metrics"],
                "lines": row["lines"],
                "flagged": row["marked"],
                "best": row["best"],
                "in_sample": row["in_sample"],
            }
            for row in self.rows
        ]

    def pandas(self) -> Any:
        """Table of `records` as a `pandas.DataFrame`."""
        import pandas

        return pandas.DataFrame(self.records())

    def polars(self) -> Any:
        """Table of `records` as a `polars.DataFrame`."""
        import polars

        return polars.DataFrame(self.records(), infer_schema_length=None)

    def __len__(self) -> int:
        return len(self.rows)

    def __str__(self) -> str:
        return f"{self.name}, {self.over}\n{self._text}"

    def _repr_html_(self) -> str:
        rows = self.records()
        names = list(rows[0]) if rows else []
        heads = [f"{name} [{self.units[name]}]" if self.units.get(name, "1") != "1" else name for name in names]
        cells = [[_cell(row[name]) for name in names] for row in rows[: _html.ROWS]]
        return _html.table(heads, cells, f"{self.name}, {self.over}, {_html.first_of(len(rows), 'points')}")


def score_tables(summary: dict[str, Any]) -> Iterator[tuple[str, ScoreTable]]:
    """Tables of scores in the summary of a run, each with its name."""
    for shown in summary["score_tables"]:
        name = shown["stage"]
        rows = [row for row in summary["scores"] if row["stage"] == name]
        metrics = list(rows[0]["metrics"]) if rows else []
        units = dict(zip(metrics, shown["units"], strict=True)) if rows else {}
        yield name, ScoreTable(name, shown["over"], units, rows, shown["text"])


def _axis(text: str) -> Any:
    """Axis value as an int or float if its text is a number, otherwise as text."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _cell(item: Any) -> str | None:
    return f"{item:.6g}" if isinstance(item, float) else None if item is None else str(item)
