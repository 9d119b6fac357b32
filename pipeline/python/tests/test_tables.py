"""Tables against the output of `magline sql`."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import magline
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest


def by_command(store: str, query: str) -> str:
    command = [sys.executable, "-m", "magline", "sql", query, "--store", store, "--format", "csv"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("name", ["coefficients", "scores_pooled"])
def test_a_table_is_the_table_of_the_command(run: magline.Run, name: str) -> None:
    text = by_command(run.store.path, f"select * from tolles_lawson.{name}")
    expected = pd.read_csv(io.StringIO(text), float_precision="round_trip")
    table = run.table(name)
    pandas = table.pandas()
    assert table.columns == list(expected.columns) == list(pandas.columns)
    assert len(table) == len(expected) > 0
    polars = table.polars()
    # A column without values has no type in CSV.
    for column in expected.dropna(axis="columns", how="all").select_dtypes("number"):
        for found in (pandas[column], polars[column].to_pandas()):
            pd.testing.assert_series_equal(found.astype(float), expected[column].astype(float), check_names=False,
                                           rtol=0)


def test_a_table_of_lines_has_keys_and_columns_that_pass_through(run: magline.Run) -> None:
    query = "select lambda, tt, mag_1_uc, mag_c from tolles_lawson.clean order by lambda, tt"
    expected = pd.read_csv(io.StringIO(by_command(run.store.path, query)), float_precision="round_trip")
    found = pl.DataFrame(run.table("clean")).sort("lambda", "tt")
    assert {"lambda", "flight", "line", "tt", "mag_1_uc", "mag_c"} <= set(found.columns)
    assert found.height == 4000
    for column in expected:
        assert (found[column].to_numpy() == expected[column].to_numpy()).all(), column


def test_capsules_are_read_by_other_libraries(run: magline.Run) -> None:
    table = run.sql("select * from tolles_lawson.scores")
    assert pa.schema(table) == pa.table(table).schema
    assert pa.table(table).num_rows == len(table) == pl.DataFrame(table).height
    # A second reader gets all rows again.
    assert pa.table(table) == pa.table(table)


def test_an_empty_result_has_columns(run: magline.Run) -> None:
    table = run.sql("select * from tolles_lawson.scores where false")
    assert len(table) == 0
    assert "metric" in table.columns
    assert pa.table(table).num_rows == 0


def test_html_is_escaped_and_short(run: magline.Run) -> None:
    html = run.sql("select '<b>' as a, null as b from tolles_lawson.clean")._repr_html_()
    assert "&lt;b&gt;" in html
    assert "<b>" not in html
    assert html.count("<tr>") == 11
    assert "4000 rows" in html


def test_a_store_lists_pipelines_and_tables(run: magline.Run) -> None:
    store = magline.Store(run.store.path)
    assert list(store) == store.pipelines == ["tolles_lawson"]
    assert {"clean", "scores", "scores_pooled"} <= set(store["tolles_lawson"])
    assert run.tables == store["tolles_lawson"].tables


def test_unknown_names_list_the_known_ones(run: magline.Run, tmp_path: Path) -> None:
    with pytest.raises(KeyError, match="tolles_lawson"):
        run.store["osborne"]
    with pytest.raises(KeyError, match="clean"):
        run.table("cleen")
    with pytest.raises(FileNotFoundError, match="no store"):
        magline.Store(tmp_path / "none")


def test_a_wrong_query_is_an_error(run: magline.Run) -> None:
    with pytest.raises(magline.SpecError, match="scors"):
        run.sql("select * from tolles_lawson.scors")
    with pytest.raises(magline.SpecError):
        run.sql("drop table tolles_lawson.scores")
