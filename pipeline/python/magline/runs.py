"""Runs and checks of specs."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from magline import _magline, _toml
from magline.errors import Fault
from magline.tables import Store, Table, _html_table

_Source = tuple[Path, Path, str | None, list[str]]
SpecLike = str | os.PathLike[str] | Mapping[str, Any]


@dataclass(frozen=True)
class Warning:
    """Warning about an unreliable result.

    Attributes
    ----------
    stage : str
        Table of scores, model or map.
    axes : dict
        Sweep point: value of each axis.
    flight, line : str or None
        Flight and line; None for a fit.
    kind : str
        Subject, such as ``nees_high`` or ``fit``.
    value, limit : float or None
        Flagged figure and its limit, in ``unit``.
    unit : str
        Unit of the figure.
    text : str
        Description in one sentence.
    cause : str or None
        Likely cause.
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
        return f"{self.stage}: {self.text}"


@dataclass(frozen=True)
class Failure:
    """Unit that could not be computed.

    Attributes
    ----------
    stage : str
        Table or source.
    axes : dict
        Sweep point: value of each axis.
    flight, line : str or None
        Flight and line; None for a survey stage.
    error : str
        Message.
    fault : Fault
        Fault, with its owner, place and remedy.
    """

    stage: str
    axes: dict[str, Any]
    flight: str | None
    line: str | None
    error: str
    fault: Fault

    def __str__(self) -> str:
        return f"{self.stage}: {self.error}"


@dataclass(frozen=True)
class ScoreTable:
    """Scores of a sweep, pooled over the lines as the terminal shows them.

    Attributes
    ----------
    name : str
        Table of scores.
    over : str
        Lines of the pooled values, in words.
    units : dict
        Unit of each metric.
    rows : list of dict
        One row per sweep point: ``axes``, ``metrics`` (pooled values), ``lines``, ``marked``
        (number of flagged lines), ``best``, ``in_sample`` and the keys of the event ``finished``
        that ``magline run --help`` lists.
    """

    name: str
    over: str
    units: dict[str, str]
    rows: list[dict[str, Any]]
    _text: str = field(repr=False, compare=False)

    def records(self) -> list[dict[str, Any]]:
        """Rows as flat dicts: axes, then metrics, ``lines``, ``flagged`` and ``best``."""
        return [
            {
                **{name: _axis(text) for name, text in row["axes"].items()},
                **row["metrics"],
                "lines": row["lines"],
                "flagged": row["marked"],
                "best": row["best"],
            }
            for row in self.rows
        ]

    def pandas(self) -> Any:
        """`pandas.DataFrame` of `records`."""
        import pandas

        return pandas.DataFrame(self.records())

    def polars(self) -> Any:
        """`polars.DataFrame` of `records`."""
        import polars

        return polars.DataFrame(self.records(), infer_schema_length=None)

    def __len__(self) -> int:
        return len(self.rows)

    def __str__(self) -> str:
        return f"{self.name}, {self.over}\n{self._text}"

    def _repr_html_(self) -> str:
        rows = self.records()
        names = list(rows[0]) if rows else []
        cells = [[_cell(row[name]) for name in names] for row in rows]
        return _html_table(names, cells, f"{self.name}, {self.over}")


@dataclass(frozen=True)
class Check:
    """Result of a check.

    Attributes
    ----------
    tables : list of str
        Tables of the stages, each after its inputs.
    points : int
        Number of sweep points of all tables together.
    notes : list of str
        Choices made automatically.
    """

    tables: list[str]
    points: int
    notes: list[str]


class Run:
    """Result of a run.

    Attributes
    ----------
    id : str
        Hash of the computation and its data: equal for the same spec and inputs.
    pipeline : str
        Name of the pipeline.
    store : Store
        Store of the results.
    scores : dict of str to ScoreTable
        Pooled scores of each table of scores.
    warnings : list of Warning
        Warnings about results.
    failures : list of Failure
        Units that could not be computed.
    notes : list of str
        Choices made automatically.
    counts : dict
        For each table the number of units ``computed``, ``reused``, ``failed`` and ``skipped``,
        and its ``seconds``.
    seconds : float
        Duration of the run, s.
    folder : Path
        Folder of the tables.
    """

    def __init__(self, summary: dict[str, Any], source: _Source) -> None:
        self._source = source
        self.id: str = summary["run"]
        self.pipeline: str = summary["pipeline"]
        self.store = Store(summary["store"])
        self.scores = dict(_score_tables(summary))
        self.warnings = [Warning(**one) for one in summary["warnings"]]
        self.failures = [
            Failure(**{**one, "fault": Fault(**one["fault"])}) for one in summary["failures"]
        ]
        self.notes: list[str] = summary["notes"]
        self.counts: dict[str, dict[str, Any]] = summary["tables"]
        self.seconds: float = summary["seconds"]
        self.folder = Path(summary["folder"])

    @property
    def tables(self) -> list[str]:
        """Names of the published tables of the pipeline."""
        return self.store[self.pipeline].tables

    def table(self, name: str) -> Table:
        """Published table of this pipeline.

        Parameters
        ----------
        name : str
            Name of the stage, or ``warnings``, ``quality`` or ``scores_pooled``.

        Returns
        -------
        Table

        Raises
        ------
        KeyError
            If the pipeline has not published this table.
        """
        return self.store[self.pipeline][name]

    def sql(self, query: str) -> Table:
        """Result of a query over the store. See `Store.sql`."""
        return self.store.sql(query)

    def report(self, path: str | os.PathLike[str]) -> Path:
        """Write the report: one self-contained HTML page of tables and plots.

        Parameters
        ----------
        path : path
            Output file.

        Returns
        -------
        Path
            The output file.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        page = Path(path)
        page.write_text(_magline.report(*self._source), encoding="utf-8")
        return page

    def explain(self) -> str:
        """Plan as text: tables, axes, stored results and the cost of each stage."""
        return _magline.explain(*self._source)

    def why(self, table: str) -> str:
        """Reason, as text, why a table would run again: the changes since its last computation.

        Raises
        ------
        SpecError
            If the spec has no such table.
        """
        return _magline.why(*self._source, table)

    def __repr__(self) -> str:
        total = {
            key: sum(count[key] for count in self.counts.values())
            for key in ("computed", "reused", "failed", "skipped")
        }
        counted = ", ".join(f"{number} {key}" for key, number in total.items() if number)
        flagged = f", {len(self.warnings)} warnings" if self.warnings else ""
        return f"<magline.Run {self.pipeline}: {counted or 'no units'}{flagged}>"

    def _repr_html_(self) -> str:
        names = ["table", "computed", "reused", "failed", "skipped", "seconds"]
        cells: list[list[str | None]] = [
            [table, *(str(count[key]) for key in names[1:-1]), f"{count['seconds']:.2f}"]
            for table, count in self.counts.items()
        ]
        parts = [_html_table(names, cells, f"Run {self.id} of {self.pipeline}")]
        parts += [scores._repr_html_() for scores in self.scores.values()]
        parts += [f"<p>warning: {escape(str(one))}</p>" for one in self.warnings]
        parts += [f"<p>failure: {escape(str(one))}</p>" for one in self.failures]
        return "\n".join(parts)


def run(
    spec: SpecLike,
    *,
    set: Mapping[str, Any] | None = None,
    threads: int | None = None,
    store: str | os.PathLike[str] | None = None,
) -> Run:
    """Run a spec: compute the results that are missing from the store.

    Ctrl-C ends the run after the units in progress and raises `KeyboardInterrupt`. Finished
    results are stored, and the same call resumes. Other Python threads continue during the run.
    A process runs one spec at a time; a second call waits.

    Parameters
    ----------
    spec : path or mapping
        TOML file, or the keys of a spec as a dict. The paths of a dict are relative to the
        current folder.
    set : mapping, optional
        Overrides, as ``--set`` of the command, such as ``{"axes.lambda": [0.0, 0.025]}``.
        Default: none.
    threads : int, optional
        Number of threads. Results do not depend on it. Default: all cores.
    store : path, optional
        Folder of the store, instead of the folder in the spec.

    Returns
    -------
    Run

    Raises
    ------
    SpecError, DataError, MachineError
        If nothing could be run. Units that fail are in `Run.failures`.
    KeyboardInterrupt
        After Ctrl-C.

    Examples
    --------
    >>> import magline, tempfile
    >>> spec = "datasets/examples/tolles_lawson.toml"
    >>> run = magline.run(spec, set={"axes.lambda": [0.025]}, store=tempfile.mkdtemp())
    >>> run.failures
    []
    >>> len(run.table("clean"))
    1000
    """
    if threads is not None and threads < 1:
        raise ValueError(f"`threads` must be 1 or more, but is {threads}")
    source = _source(spec, set, store)
    return Run(json.loads(_magline.run(*source, threads)), source)


def check(spec: SpecLike, *, set: Mapping[str, Any] | None = None) -> Check:
    """Check a spec without running it.

    Parameters
    ----------
    spec : path or mapping
        TOML file, or the keys of a spec as a dict.
    set : mapping, optional
        Overrides, as for `run`.

    Returns
    -------
    Check

    Raises
    ------
    SpecError, DataError
        With all faults of the spec.

    Examples
    --------
    >>> import magline
    >>> magline.check("datasets/examples/tolles_lawson.toml").tables
    ['terms', 'coefficients', 'clean', 'scores']
    """
    return Check(**json.loads(_magline.check(*_source(spec, set, None))))


def _source(
    spec: SpecLike, set: Mapping[str, Any] | None, store: str | os.PathLike[str] | None
) -> _Source:
    """File, folder, text and overrides of a spec."""
    sets = [f"{key}={_toml.value(item)}" for key, item in (set or {}).items()]
    if store is not None:
        # An override is relative to the spec's folder, an argument to the current folder.
        sets.append(f"store={_toml.value(_absolute(os.fspath(store)))}")
    if isinstance(spec, Mapping):
        return Path("spec.toml"), Path.cwd(), _toml.document(spec), sets
    return Path(spec), Path(), None, sets


def _absolute(store: str) -> str:
    return store if "://" in store else os.path.abspath(store)


def _score_tables(summary: dict[str, Any]) -> Iterator[tuple[str, ScoreTable]]:
    for shown in summary["score_tables"]:
        name = shown["stage"]
        rows = [row for row in summary["scores"] if row["stage"] == name]
        metrics = list(rows[0]["metrics"]) if rows else []
        units = dict(zip(metrics, shown["units"], strict=True)) if rows else {}
        yield name, ScoreTable(name, shown["over"], units, rows, shown["text"])


def _axis(text: str) -> Any:
    """Number for the text of an axis value, or the text itself."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _cell(item: Any) -> str | None:
    return f"{item:.6g}" if isinstance(item, float) else None if item is None else str(item)
