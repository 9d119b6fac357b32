"""Access to stores, pipelines and tables."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magline import _html, _lazy, _magline

if TYPE_CHECKING:
    import polars as pl

_HTML_ROWS = 10


class Table:
    """Table of a store, or the result of a query, in Arrow format.

    A table of a store has the same columns as in ``magline sql``: axes, flight, line, columns that
    pass through the stage, and columns of the stage. All rows are read into memory at the first
    use and kept there. Any library with Arrow's PyCapsule interface can read the table, without a
    copy of the Arrow data: ``polars.DataFrame(table)``, ``pyarrow.table(table)``.

    The rows of a table of a store have the order of the store: flight, line, axes, time. The rows
    of a query have an order only with ``order by``.

    Examples
    --------
    >>> import magline, tempfile
    >>> run = magline.run("datasets/examples/tolles_lawson.toml", store=tempfile.mkdtemp())
    >>> table = run.sql("select 1 as one")
    >>> table.columns, len(table)
    (['one'], 1)
    """

    def __init__(
        self,
        store: Path | str,
        query: str,
        memory_limit: int | None = None,
        *,
        name: str | None = None,
    ) -> None:
        self._store = store
        self._query = query
        self._memory_limit = memory_limit
        #: Name of a table of the store, as ``pipeline.table``; None for a query.
        self._name = name

    @cached_property
    def _rows(self) -> _magline.QueryResult:
        with tempfile.TemporaryDirectory(prefix="magline-") as spill:
            in_order = self._name is not None
            return _magline.sql(self._store, self._query, spill, self._memory_limit, in_order)

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        """Capsule with an Arrow C stream of the rows. ``requested_schema`` has no effect."""
        return self._rows.__arrow_c_stream__(requested_schema)

    def __arrow_c_schema__(self) -> object:
        """Capsule with the Arrow C schema."""
        return self._rows.__arrow_c_schema__()

    @property
    def columns(self) -> list[str]:
        """Names of the columns, in order."""
        return self._rows.columns

    def __len__(self) -> int:
        """Number of rows."""
        return len(self._rows)

    def to_arrow(self) -> Any:
        """All rows as a `pyarrow.Table`. Requires pyarrow."""
        import pyarrow

        return pyarrow.table(self)

    def pandas(self) -> Any:
        """All rows as a `pandas.DataFrame`. Requires pandas and pyarrow."""
        return self.to_arrow().to_pandas()

    def polars(self) -> pl.DataFrame:
        """All rows as a `polars.DataFrame`. Requires polars."""
        import polars

        return polars.DataFrame(self)

    def lazy(self) -> pl.LazyFrame:
        """Lazy table as a `polars.LazyFrame`. Requires polars.

        ``collect`` reads only the required columns and, after ``head(n)``, only n rows. For a table
        of a store, a filter on ``flight``, ``line`` and axes reads only the files and row groups
        that can contain rows of the result. Polars applies other filters after the columns are read;
        use a ``where`` in `sql` for a large table.
        """
        return _lazy.frame(self)

    def __repr__(self) -> str:
        return _html.visible(f"<magline.Table: {len(self)} rows of {', '.join(self.columns)}>")

    def _repr_html_(self) -> str:
        rows = self._rows.rows(_HTML_ROWS)
        shown = f", the first {_HTML_ROWS}" if len(self) > _HTML_ROWS else ""
        return _html.table(self.columns, rows, f"{len(self)} rows{shown}")


class Pipeline:
    """Published tables of a pipeline. Iteration yields their names.

    Attributes
    ----------
    name : str
        Name of the pipeline.

    Examples
    --------
    >>> import magline, tempfile
    >>> run = magline.run("datasets/examples/tolles_lawson.toml", store=tempfile.mkdtemp())
    >>> pipeline = run.store["tolles_lawson"]
    >>> pipeline.tables[:3]
    ['clean', 'coefficients', 'failures']
    >>> len(pipeline["coefficients"])
    72
    """

    def __init__(self, store: Store, name: str) -> None:
        self._store = store
        self.name = name

    @property
    def tables(self) -> list[str]:
        """Names of the published tables."""
        return self._store._published().get(self.name, [])

    def __getitem__(self, table: str) -> Table:
        """Published table of this name. It is read at its first use, in the version of that time.

        Raises
        ------
        KeyError
            If the pipeline has not published this table.
        """
        known = self.tables
        if table not in known:
            raise KeyError(f"`{self.name}` has no table `{table}`; its tables are {', '.join(known)}")
        query = f'select * from "{self.name}"."{table}"'
        return Table(self._store.path, query, name=f"{self.name}.{table}")

    def __iter__(self) -> Iterator[str]:
        return iter(self.tables)

    def __len__(self) -> int:
        return len(self.tables)

    def __repr__(self) -> str:
        return _html.visible(f"<magline.Pipeline {self.name}: {', '.join(self.tables)}>")

    def _repr_html_(self) -> str:
        return _html.table(["table"], [[name] for name in self.tables], f"Pipeline {self.name}")


class Store:
    """Store of results. Iteration yields the names of its pipelines.

    Parameters
    ----------
    path : path
        Folder of the store, or its address, such as ``s3://BUCKET/PREFIX``.

    Raises
    ------
    FileNotFoundError
        If the folder does not exist.

    Examples
    --------
    >>> import magline, tempfile
    >>> folder = tempfile.mkdtemp()
    >>> _ = magline.run("datasets/examples/tolles_lawson.toml", store=folder)
    >>> table = magline.Store(folder)["tolles_lawson"]["clean"]
    >>> "mag_c" in table.columns
    True
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        text = os.fspath(path)
        if "://" not in text and not os.path.isdir(text):
            raise FileNotFoundError(f"there is no store {text}; run a spec first, or give another folder")
        self.path = text

    @property
    def pipelines(self) -> list[str]:
        """Names of the pipelines that have published tables."""
        return list(self._published())

    def _published(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for name in _magline.tables(self.path):
            pipeline, _, table = name.partition(".")
            found.setdefault(pipeline, []).append(table)
        return found

    def __getitem__(self, pipeline: str) -> Pipeline:
        """Pipeline of this name.

        Raises
        ------
        KeyError
            If the store has no pipeline of this name.
        """
        known = self.pipelines
        if pipeline not in known:
            raise KeyError(f"{self.path} has no pipeline `{pipeline}`; it has {', '.join(known)}")
        return Pipeline(self, pipeline)

    def __iter__(self) -> Iterator[str]:
        return iter(self.pipelines)

    def sql(self, query: str, *, memory_limit: int | None = None) -> Table:
        """Result of a read-only query over the tables ``PIPELINE.TABLE``.

        Parameters
        ----------
        query : str
            Query in the SQL dialect of ``magline sql``, Apache DataFusion.
        memory_limit : int, optional
            Memory limit of the query, bytes. The result is not counted. Larger sorts and joins use
            temporary files. Default: a quarter of the memory of the machine or of its control
            group, from 256 MiB to 8 GiB.

        Returns
        -------
        Table
            Result. Its rows are already in memory.

        Raises
        ------
        SpecError
            If the query is wrong or not read-only.
        MachineError
            If the query exceeds its memory limit in spite of temporary files.
        """
        table = Table(self.path, query, memory_limit)
        table.columns  # reads the rows, so that a wrong query is reported here
        return table

    def __repr__(self) -> str:
        return _html.visible(f"<magline.Store {self.path}: {', '.join(self.pipelines)}>")

    def _repr_html_(self) -> str:
        rows = [[name, ", ".join(tables)] for name, tables in self._published().items()]
        return _html.table(["pipeline", "tables"], rows, f"Store {self.path}")


def sql(
    query: str, store: str | os.PathLike[str] | Store = "store", *, memory_limit: int | None = None
) -> Table:
    """Result of a read-only query over the tables of a store. See `Store.sql`.

    Parameters
    ----------
    query : str
        Query in the SQL dialect of ``magline sql``, over the tables ``PIPELINE.TABLE``.
    store : path or Store, optional
        Store, its folder or its address. Default: the folder ``store`` in the current folder.
    memory_limit : int, optional
        Memory limit of the query, bytes, without the result. Default: as in `Store.sql`.

    Returns
    -------
    Table
        Result. Its rows are already in memory.

    Raises
    ------
    FileNotFoundError
        If the store does not exist.
    SpecError
        If the query is wrong or not read-only.
    MachineError
        If the query exceeds its memory limit in spite of temporary files.

    Examples
    --------
    >>> import magline, tempfile
    >>> folder = tempfile.mkdtemp()
    >>> _ = magline.run("datasets/examples/tolles_lawson.toml", store=folder)
    >>> len(magline.sql("select * from tolles_lawson.clean where lambda = 0.25", folder))
    1000
    """
    found = store if isinstance(store, Store) else Store(store)
    return found.sql(query, memory_limit=memory_limit)
