"""Tests of the comparison of two runs in Chromium: in a report, and in `magline view`."""

import csv
import io
import json
import os
import subprocess

import pytest
from axe_playwright_python.sync_playwright import Axe
from conftest import FOLDER, download, until
from specs import AXIS

SOURCES = ["report", "view"]
TABLE = "#against table.against tbody tr"


@pytest.fixture
def open_runs(visit, view):
    """Opens the comparison of the two runs of `cabin`."""

    def open_runs(source, **more):
        page = visit(FOLDER / "cabin.html" if source == "report" else view("cabin"), **more)
        if source == "view":
            page.locator("#against [data-key=against]").select_option("1")
        page.locator(TABLE).first.wait_for()
        return page

    return open_runs


def rows(page):
    return [[c.strip() for c in row.locator("td").all_inner_texts()] for row in page.locator(TABLE).all()]


def of_csv(page):
    text = download(page, page.locator("#against").get_by_role("button", name="Download as CSV")).decode()
    return list(csv.DictReader(io.StringIO(text)))


@pytest.mark.parametrize("source", SOURCES)
def test_scores_of_shared_points_are_compared(open_runs, source):
    page = open_runs(source)
    metrics = page.locator("#against [data-key=metric]")
    for metric in ["std_error", "drms"]:
        metrics.select_option(metric)
        until(page, "(m) => document.querySelector('#against .against-title').textContent.startsWith(m)", metric)
        found = rows(page)
        # Two magnetometers; two values of lambda are in both runs.
        assert len(found) == 4
        for row in found:
            a, b = [float(cell.removeprefix("★ ").split(" ")[0]) for cell in row[2:4]]
            assert abs(float(row[4].removeprefix("≠ ")) - (b - a)) <= 2e-3 * max(abs(a), abs(b))
            # The better value has the star, unless one of them is flagged or in sample.
            stars, marked = [cell.startswith("★") for cell in row[2:4]], any("[" in cell for cell in row[2:4])
            assert row[7] == "equal" and stars == ([False, False] if marked or a == b else [a < b, b < a])
    assert "4 shared points" in page.locator("#against [role=status]").inner_text()
    summaries = page.locator("#against details summary").all_inner_texts()
    assert summaries == ["2 points in run 1 only", "2 points in run 2 only"]
    page.locator("#against details summary").first.click()
    assert "lambda = 1" in page.locator("#against details li").first.inner_text()


@pytest.mark.parametrize("source", SOURCES)
def test_changes_between_the_runs_are_listed(open_runs, source):
    page = open_runs(source)
    changes = [row.locator("td").all_inner_texts() for row in page.locator("#against table.changes tbody tr").all()]
    assert ["parameter", "coefficients", "trim", "200", "20", "4"] in changes
    assert not any(kind == "input" for kind, *_ in changes)


@pytest.mark.parametrize("source", SOURCES)
def test_the_csv_holds_the_scores_of_the_store(open_runs, source):
    page = open_runs(source)
    query = "SELECT mag, lambda, metric, value, n FROM cabin.scores_pooled"
    out = subprocess.run([os.environ["MAGLINE"], "sql", query, "--store", FOLDER / "cabin", "--format", "csv"],
                         check=True, capture_output=True, text=True).stdout
    of_store = {(row["mag"], float(row["lambda"]), row["metric"]): row for row in csv.DictReader(io.StringIO(out))}
    found = of_csv(page)
    assert len(found) >= 12
    for row in found:
        stored = of_store[row["mag"], float(row["lambda"]), row["metric"]]
        assert float(row["value run 2"]) == float(stored["value"]) and row["n run 2"] == stored["n"]
        assert row["rows"] == "equal" and row["n run 1"] == row["n run 2"]


def test_unequal_rows_are_marked_and_have_no_star(visit, view):
    page = visit(view("cabin"))

    def answer(route):
        block = route.fetch().json()
        block["reasons"] += ["different n: 9 and 7 on line <b id='injected'>\u202e"]
        block["rows"] = [[len(block["reasons"]) - 1 for _ in column] for column in block["rows"]]
        block["changes"].append({"kind": "parameter", "table": "<b id=injected>", "what": AXIS, "before": None,
                                 "after": "\u001b[31m", "points": 1})
        route.fulfill(body=json.dumps(block), content_type="application/json")

    page.route("**/api/against?*", answer)
    page.locator("#against [data-key=against]").select_option("1")
    page.locator(TABLE).first.wait_for()
    for row in rows(page):
        assert "★" not in "".join(row) and row[4].startswith("≠") and row[7].startswith("different n")
        assert "\\u202e" in row[7] and row[6] == "-"
    assert page.locator("#against tr.unequal").count() == 4 and page.locator("#injected").count() == 0
    assert "4 are not on equal rows" in page.locator("#against [role=status]").inner_text()
    assert "\\x1b[31m" in page.locator("#against table.changes").inner_text()


def test_the_address_restores_the_comparison(open_runs):
    page = open_runs("view")
    page.locator("#against [data-key=metric]").select_option("nees")
    page.locator("#against [data-key=order]").select_option("change")
    until(page, "document.querySelector('#against .against-title').textContent.startsWith('nees')")
    page.wait_for_timeout(300)
    before = rows(page)
    page.reload()
    page.locator(TABLE).first.wait_for()
    assert rows(page) == before and page.locator("#against [data-key=metric]").input_value() == "nees"


def test_a_run_without_tables_gives_the_reason(visit, view):
    page = visit(view("cabin"))
    said = {"error": "the tables of run 1 of `cabin` are no longer in the store", "help": "repeat that run"}
    # The console reports a failed request; this answer comes from the page.
    page.evaluate("""(said) => { const get = window.fetch; window.fetch = (address, more) =>
        String(address).includes("api/against") ? Promise.resolve(new Response(JSON.stringify(said), { status: 404 }))
        : get(address, more); }""", said)
    page.locator("#against [data-key=against]").select_option("1")
    until(page, "document.querySelector('#against [role=status]').textContent.includes('no longer in the store')")
    assert page.locator(TABLE).count() == 0


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("width,scheme", [(390, "dark"), (1400, "light")])
def test_the_comparison_is_accessible_and_fits(open_runs, source, width, scheme):
    page = open_runs(source, width=width, scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    found = Axe().run(page, context="#against").response["violations"]
    assert [(v["id"], [n["html"][:120] for n in v["nodes"][:3]]) for v in found] == []
    if os.environ.get("SCREENSHOTS"):
        page.locator("#against").screenshot(path=f"{os.environ['SCREENSHOTS']}/runs-{source}-{width}-{scheme}.png")
