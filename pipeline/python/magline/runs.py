"""Runs and checks of specs.

A spec describes a pipeline: tables, stages and axes. A point is one combination of the values of
all axes; a sweep is all points. A unit is the smallest stored result: one stage at one line and
point, or one fit at one point.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from magline import _html, _magline, _toml
from magline._progress import display
from magline.results import Failure, ScoreTable, Warning, score_tables
from magline.errors import Fault
from magline.spec import Spec
from magline.tables import Store, Table
from magline.views import View, is_notebook

_Source = tuple[Path, Path, str | None, list[str]]
SpecLike = str | os.PathLike[str] | Mapping[str, Any] | Spec


@dataclass(frozen=True)
class Check:
    """Result of a check.

    Attributes
    ----------
    tables : list of str
        Names of the tables of the stages, in order of computation.
    points : int
        Maximum number of points, summed over all tables.
    notes : list of str
        Choices that the spec leaves to magline, such as the reference of a score.

    Examples
    --------
    >>> import magline
    >>> check = magline.check("datasets/examples/tolles_lawson.toml")
    >>> check.tables, check.points
    (['terms', 'coefficients', 'clean', 'scores'], 13)
    >>> print(check.notes[0])
    `scores`: not scored without `truth`: `std_error`, `bias_error`, `rms_error`, `snr`
    """

    tables: list[str]
    points: int
    notes: list[str]

    def _repr_html_(self) -> str:
        rows = [["tables", ", ".join(self.tables)], ["points", str(self.points)]]
        return _html.table(["check", ""], [*rows, *(["note", note] for note in self.notes)], "The spec is valid")


class Run:
    """Result of a run.

    `report`, `explain` and `why` read the spec file again; they reflect its current content.

    Attributes
    ----------
    id : str
        Hash of the spec and its inputs. It is the same when a run is repeated.
    pipeline : str
        Name of the pipeline.
    store : Store
        Store of the results.
    scores : dict of str to ScoreTable
        Pooled scores by the name of their table.
    warnings : list of Warning
        Warnings about untrustworthy results.
    failures : list of Failure
        Units that could not be computed.
    notes : list of str
        Choices that the spec left to magline.
    counts : dict of str to dict
        For each table: the number of units ``computed``, ``reused``, ``failed`` and ``skipped``,
        and the duration ``seconds``, s.
    seconds : float
        Duration of the run, s.
    folder : Path
        Folder of the published Parquet tables of this pipeline.

    Examples
    --------
    >>> import magline, tempfile
    >>> run = magline.run("datasets/examples/tolles_lawson.toml", store=tempfile.mkdtemp())
    >>> run
    <magline.Run tolles_lawson: 13 computed>
    >>> run.counts["clean"]["computed"]
    4
    >>> len(run.table("clean"))
    4000
    >>> run.report(tempfile.mkdtemp() + "/report.html").name
    'report.html'
    """

    def __init__(self, summary: dict[str, Any], source: _Source) -> None:
        self._source = source
        self.id: str = summary["run"]
        self.pipeline: str = summary["pipeline"]
        self.store = Store(summary["store"])
        self.scores = dict(score_tables(summary))
        flagged = [Warning(**one) for one in summary["warnings"]]
        self.warnings: list[Warning] = _html.Listing(
            flagged, "warnings", ["stage", "axes", "flight", "line", "text", "cause"]
        )
        failed = [Failure(**{**one, "fault": Fault(**one["fault"])}) for one in summary["failures"]]
        self.failures: list[Failure] = _html.Listing(failed, "failures", ["stage", "axes", "flight", "line", "error"])
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
            Name of a stage, or of a summary table: ``warnings``, ``quality`` or ``scores_pooled``.

        Returns
        -------
        Table
            All rows and columns. The table is read at its first use.

        Raises
        ------
        KeyError
            If the pipeline has not published this table.
        """
        return self.store[self.pipeline][name]

    def sql(self, query: str) -> Table:
        """Result of a read-only query over all tables of the store. See `Store.sql`."""
        return self.store.sql(query)

    def report(self, path: str | os.PathLike[str]) -> Path:
        """Write the report of the run: one self-contained HTML page with tables and plots.

        Parameters
        ----------
        path : path
            Output file. An existing file is replaced.

        Returns
        -------
        Path
            Path of the output file.

        Raises
        ------
        OSError
            If the file cannot be written.
        SpecError
            If the spec is no longer valid.
        """
        page = Path(path)
        page.write_text(_magline.report(*self._source), encoding="utf-8")
        return page

    def view(self, *, browser: bool | None = None) -> View:
        """Explore the results: all tables of the store in a browser, or in a frame of a notebook.

        Parameters
        ----------
        browser : bool, optional
            Whether to open a browser. By default, outside of a notebook only.

        Returns
        -------
        View
            The server. It ends with this process, or with ``close()``.

        Raises
        ------
        RuntimeError
            If the server does not start.
        """
        view = View(self.store.path)
        if browser or (browser is None and not is_notebook()):
            view.open()
        return view

    def explain(self) -> str:
        """Plan of the run as text: tables, axes, stored results and cost of each stage."""
        return _magline.explain(*self._source)

    def why(self, table: str) -> str:
        """Changes since a table was last computed that cause a recomputation, as text.

        Parameters
        ----------
        table : str
            Name of the table.

        Raises
        ------
        SpecError
            If the spec has no table of this name.
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
        parts = [_html.table(names, cells, f"Run {self.id} of {self.pipeline}")]
        parts += [scores._repr_html_() for scores in self.scores.values()]
        for listing in (self.warnings, self.failures):
            if listing and isinstance(listing, _html.Listing):
                parts.append(listing._repr_html_())
        return "\n".join(parts)


def run(
    spec: SpecLike,
    *,
    set: Mapping[str, Any] | None = None,
    threads: int | None = None,
    store: str | os.PathLike[str] | None = None,
    progress: bool | None = None,
) -> Run:
    """Run a spec: compute the results that are missing from the store.

    The first Ctrl-C ends the run after the units in progress and raises `KeyboardInterrupt`.
    Finished results are stored, and the same call resumes the run. Other Python threads continue
    during a run. A process runs one spec at a time; a call in a second thread waits for the first.

    Parameters
    ----------
    spec : path, mapping or Spec
        TOML file, the keys of a spec as a dict, or a `Spec`. Paths in a file are relative to the
        folder of the file, paths in a dict to the current folder.
    set : mapping, optional
        Overrides of the spec: dotted key to new value, such as ``{"axes.lambda": [0.0, 0.025]}``.
        They correspond to ``--set`` of the command. Default: no overrides.
    threads : int, optional
        Number of threads, 1 or more. Results do not depend on this number. Default: one per core.
    store : path, optional
        Folder of the store, relative to the current folder, or its address, such as
        ``s3://BUCKET/PREFIX``. It overrides the spec. Default: the store of the spec.
    progress : bool, optional
        Whether to display the progress: a bar of tqdm if tqdm is installed, otherwise text. Default:
        in a notebook and on a terminal.

    Returns
    -------
    Run
        Scores, tables, warnings and failures.

    Raises
    ------
    SpecError, DataError, MachineError
        If the run as a whole fails. A failed unit does not raise: check `Run.failures`.
    ValueError
        If ``threads`` is below 1.
    TypeError
        If a value of a dict or an override has no TOML equivalent.
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
    with display(progress) as show:
        return Run(json.loads(_magline.run(*source, threads, show)), source)


def check(spec: SpecLike, *, set: Mapping[str, Any] | None = None) -> Check:
    """Check a spec without running it.

    Parameters
    ----------
    spec : path, mapping or Spec
        TOML file, the keys of a spec as a dict, or a `Spec`, as for `run`.
    set : mapping, optional
        Overrides, as for `run`. Default: no overrides.

    Returns
    -------
    Check
        Tables, number of points and notes.

    Raises
    ------
    SpecError, DataError
        If the spec or its input files are wrong. The attribute ``faults`` lists all faults.

    Examples
    --------
    >>> import magline
    >>> magline.check("datasets/examples/tolles_lawson.toml").tables
    ['terms', 'coefficients', 'clean', 'scores']
    """
    return Check(**json.loads(_magline.check(*_source(spec, set, None))))


def _explain(spec: SpecLike, set: Mapping[str, Any] | None) -> str:
    return _magline.explain(*_source(spec, set, None))


def _source(
    spec: SpecLike, set: Mapping[str, Any] | None, store: str | os.PathLike[str] | None
) -> _Source:
    """File, folder, text and overrides of a spec. The text is None for a file."""
    sets = [f"{key}={_toml.value(item)}" for key, item in (set or {}).items()]
    if store is not None:
        # An override is relative to the spec's folder, an argument to the current folder.
        sets.append(f"store={_toml.value(_absolute(os.fspath(store)))}")
    if isinstance(spec, Spec):
        return spec._file, spec.folder, spec.toml(), sets
    if isinstance(spec, Mapping):
        return Path("spec.toml"), Path.cwd(), _toml.document(spec), sets
    return Path(spec), Path(), None, sets


def _absolute(store: str) -> str:
    return store if "://" in store else os.path.abspath(store)
