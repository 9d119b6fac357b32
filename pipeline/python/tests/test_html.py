"""HTML of results in notebooks: complete, well-formed, and with hostile text escaped."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import magline
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from conftest import SAMPLES
from magline import _html

HOSTILE = "<script>alert(1)</script>&\"'\x1b[31m\u202e"


class Page(HTMLParser):
    """Cells and tags of a page. An unbalanced tag fails."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.cells: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        assert attrs == []
        self.open.append(tag)
        self.tags.add(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.cells.append(data)


def page(item: Any) -> Page:
    """Page of an object, without tags of data and without control characters."""
    text = item._repr_html_()
    assert not {"\x1b", "\u202e"} & set(text)
    found = Page(text)
    assert found.tags <= {"table", "caption", "thead", "tbody", "tr", "th", "td", "pre"}
    return found


def test_a_run_and_its_parts(run: magline.Run) -> None:
    whole = page(run)
    assert f"Run {run.id} of tolles_lawson" in whole.cells
    for name in ("terms", "coefficients", "clean", "scores"):
        assert name in whole.cells
    scores = run.scores["scores"]
    assert set(page(scores).cells) <= set(whole.cells)
    assert "std_uncompensated [nT]" in whole.cells and "in_sample" in whole.cells
    value = scores.records()[0]["std_uncompensated"]
    assert f"{value:.6g}" in whole.cells
    store = page(run.store)
    assert "tolles_lawson" in store.cells
    assert any("scores_pooled" in cell for cell in store.cells)
    assert set(run.tables) <= set(page(run.store["tolles_lawson"]).cells)


def test_a_check(spec: Path) -> None:
    found = magline.check(spec)
    cells = page(found).cells
    assert ", ".join(found.tables) in cells and str(found.points) in cells and found.notes[0] in cells


def test_a_long_table_says_that_it_is_cut(run: magline.Run) -> None:
    assert "4000 rows, the first 10" in page(run.table("clean")).cells
    assert "1 rows" in page(run.sql("select 1 as one")).cells
    failure = magline.Failure("s", {}, "f", "l", "error", magline.Fault("error"))
    many = _html.Listing([failure] * 10_000, "failures", ["stage", "error"])
    found = page(many)
    assert "10000 failures, the first 100" in found.cells
    assert found.cells.count("error") == 101


@pytest.fixture(scope="module")
def failed(tmp_path_factory: pytest.TempPathFactory) -> magline.Run:
    """Run with a hostile line that fails, and a score that is flagged."""
    sample = pq.read_table(SAMPLES / "magnavjl_tl" / "magnavjl_tl.parquet").rename_columns(
        ["tt", "flux_a_x", "flux_a_y", "flux_a_z", "mag_1_uc"]
    )
    short = sample.slice(0, 3)
    rows = pa.concat_tables([
        sample.append_column("line", pa.array(["good"] * len(sample))),
        short.append_column("line", pa.array([HOSTILE] * len(short))),
    ])
    folder = tmp_path_factory.mktemp("hostile")
    pq.write_table(rows, folder / "flight.parquet")
    spec = magline.Spec("hostile", folder=folder)
    flights = spec.table("flights", "flight.parquet", flight=HOSTILE)
    terms = spec.a_matrix(name="terms", input=flights, vector="flux_a")
    spec.bandpass(name="band", input=terms, columns=["mag_1_uc"])
    return spec.run()


def test_failures_show_their_place_with_hostile_names_escaped(failed: magline.Run) -> None:
    (failure,) = failed.failures
    assert (failure.line, failure.flight) == (HOSTILE, HOSTILE)
    shown = _html.visible(HOSTILE)
    assert shown.endswith("\\x1b[31m\\u202e")
    for item in (failed, failed.failures):
        found = page(item)
        assert "1 failures" in found.cells and shown in found.cells and "band" in found.cells
    assert shown in page(failure.fault).cells
    assert not {"\x1b", "\u202e"} & set(str(failure) + repr(failed))
    assert failed.failures == [failure] and failed.warnings == []


def test_hostile_columns_and_values(run: magline.Run) -> None:
    quoted = HOSTILE.replace("'", "''")
    name = HOSTILE.replace('"', '""')
    table = run.sql(f"select '{quoted}' as \"{name}\", null as b, '' as c")
    found = page(table)
    assert found.cells.count(_html.visible(HOSTILE)) == 2
    assert not {"\x1b", "\u202e"} & set(repr(table))


def test_faults_are_a_table(spec: Path, tmp_path: Path) -> None:
    wrong = magline.Spec.read(spec).to_dict()
    wrong["stages"][0][HOSTILE] = 1
    wrong["stages"][1]["lamda"] = 1
    with pytest.raises(magline.SpecError) as caught:
        magline.Spec.from_dict(wrong, folder=spec.parent).check()
    found = page(caught.value)
    assert f"SpecError: {len(caught.value.faults)} faults" in found.cells and len(caught.value.faults) == 2
    assert any("lamda" in cell for cell in found.cells)
    assert "spec_line" in found.cells and "flight" not in found.cells
    assert page(magline.SpecError(HOSTILE)).cells == [_html.visible(HOSTILE)]
