"""Predicates and projections of lazy tables: what is read, and that the result is the same."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import magline
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from magline import _magline

LINES = ["1", "2", "3", "it's"]
ROWS = 50


def spec(folder: Path, rows: int = ROWS) -> dict[str, Any]:
    """Two flights of four lines; `mark` is 10 times the flight plus the line."""
    path = folder / "flights.parquet"
    flights = {"flight": [], "line": [], "tt": [], "mark": []}  # type: dict[str, list[Any]]
    for flight in (1, 2):
        for at, line in enumerate(LINES):
            flights["flight"] += [str(flight)] * rows
            flights["line"] += [line] * rows
            flights["tt"] += [20_000.0 * at + k / 10.0 for k in range(rows)]
            flights["mark"] += [10.0 * flight + at] * rows
    pq.write_table(pa.table(flights), path)
    stages = [
        {"name": "even", "stage": "resample", "input": "flights", "rate_hz": 10.0},
        {"name": "made", "stage": "derive", "input": "even", "columns": {"scaled": "mark * $factor"}},
    ]
    tables = {"flights": {"path": str(path)}}
    axes = {"factor": [0.5, 2.0]}
    return {"name": "lazy", "store": str(folder / "store"), "tables": tables, "axes": axes, "stages": stages}


@pytest.fixture
def done(tmp_path: Path) -> magline.Run:
    run = magline.run(spec(tmp_path))
    assert not run.failures, run.failures
    return run


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> Callable[[], int]:
    """Number of rows that queries have returned since the last call."""
    rows: list[int] = []
    original = _magline.sql

    def counted(*arguments: Any) -> _magline.QueryResult:
        found = original(*arguments)
        rows.append(len(found))
        return found

    def since() -> int:
        total = sum(rows)
        rows.clear()
        return total

    monkeypatch.setattr(_magline, "sql", counted)
    return since


def test_rows_have_the_order_of_flight_line_axes_and_time(done: magline.Run) -> None:
    keys = ["flight", "line", "factor", "tt"]
    table = done.table("made")
    first = table.polars()
    assert first.height == 2 * 2 * 4 * ROWS
    assert first.select(keys).equals(first.select(keys).sort(keys))
    for _ in range(5):
        again = magline.Store(done.store.path)["lazy"]["made"]
        assert again.polars().equals(first)
        assert again.lazy().collect().equals(first)
        assert again.lazy().select("line", "tt").collect().equals(first.select("line", "tt"))
        assert again.lazy().filter(pl.col("line") == "2").collect().equals(first.filter(pl.col("line") == "2"))


def test_a_predicate_on_keys_reads_only_its_rows(done: magline.Run, read: Callable[[], int]) -> None:
    lazy, whole = done.table("made").lazy(), done.table("made").polars()
    assert whole.height == 2 * 2 * 4 * ROWS
    line, flight, factor, tt = (pl.col(name) for name in ("line", "flight", "factor", "tt"))
    cases = [
        (line == "2", 4 * ROWS),
        (line == "it's", 4 * ROWS),
        ((flight == "1") & (factor == 0.5), 4 * ROWS),
        (line.is_in(["1", "3"]) & (factor > 1.0) & (tt < 10.0), 4 * ROWS),
        ((line == "2") | (flight == "2"), 16 * ROWS),
        (line.str.starts_with("i") & ~(flight == "1"), 2 * ROWS),
        ((line == "2") | (tt < 3.0), 16 * ROWS),
        (line == "none", 0),
        (factor == 0.5, 8 * ROWS),
        (pl.col("scaled") > 6.0, 16 * ROWS),
        (factor.is_null(), 0),
        (factor == factor.mean(), 16 * ROWS),
        (line == line.first(), 16 * ROWS),
        (tt.count() > 10, 16 * ROWS),
    ]
    order = ["flight", "line", "factor", "tt"]
    for predicate, rows in cases:
        read()
        found = lazy.filter(predicate).collect()
        assert read() == rows, predicate
        assert found.sort(order).equals(whole.filter(predicate).sort(order)), predicate


def test_projections_and_limits_are_kept(done: magline.Run, read: Callable[[], int]) -> None:
    lazy, whole = done.table("made").lazy(), done.table("made").polars()
    read()
    found = lazy.filter(pl.col("line") == "3", pl.col("flight") == "1").select("scaled").collect()
    assert read() == 2 * ROWS and found.columns == ["scaled"]
    assert sorted(found["scaled"].unique()) == [6.0, 24.0]
    assert lazy.head(7).filter(pl.col("tt") >= 0.0).collect().height == 7
    assert lazy.filter(pl.col("line") == "3").head(5).collect()["line"].unique().to_list() == ["3"]
    assert lazy.select(pl.len()).collect().item() == whole.height


def test_a_query_filters_after_reading(done: magline.Run) -> None:
    query = done.sql("select line, tt from lazy.even").lazy()
    assert query.filter(pl.col("line") == "2").collect().height == 2 * ROWS


@pytest.mark.parametrize("table", ["even", "made"])
def test_bytes_of_other_lines_are_not_read(table: str, tmp_path: Path) -> None:
    """A damaged row group is an error only if it is read."""
    # A row group of a store has 100,000 rows of one or several lines.
    run = magline.run(spec(tmp_path, 100_000))
    column = {"even": "mark", "made": "scaled"}[table]
    kept = {"even": [12.0], "made": [6.0, 24.0]}[table]
    damaged = 0
    for path in (Path(run.folder) / table).glob("*.parquet"):
        file, data = pq.ParquetFile(path), bytearray(path.read_bytes())
        for group in range(file.num_row_groups):
            if file.read_row_group(group, [column])[column][0].as_py() in kept:
                continue
            damaged += 1
            for at in range(file.metadata.num_columns):
                chunk = file.metadata.row_group(group).column(at)
                start = chunk.data_page_offset
                data[start : start + 8] = bytes(byte ^ 0xFF for byte in data[start : start + 8])
        path.chmod(0o644)
        with path.open("r+b") as out:
            out.write(data)
    assert damaged == {"even": 7, "made": 14}[table]
    lazy = run.table(table).lazy()
    found = lazy.filter(pl.col("flight") == "1", pl.col("line") == "3").select(column).collect()
    assert sorted(found[column].unique()) == kept and found.height == len(kept) * 100_000
    with pytest.raises(magline.MachineError):
        lazy.select(column).collect()
