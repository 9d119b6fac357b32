"""Tests of the comparison of two pipelines in `magline view`, against the scores in the store and NumPy."""

import csv
import io
import os
import subprocess

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from conftest import FOLDER, download, until
from specs import KEPT, LINE

HOME = "#pipelines"


@pytest.fixture
def page(visit, view):
    page = visit(view("pair"))
    page.locator(f"{HOME} table.changes").wait_for()
    return page


def scores(pipeline, where="true"):
    """Values of `std_error` by lambda and line."""
    query = f"SELECT lambda, line, value FROM {pipeline}.scores WHERE metric = 'std_error' AND {where}"
    command = [os.environ["MAGLINE"], "sql", query, "--store", FOLDER / "pair", "--format", "csv"]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    found = {}
    for row in csv.DictReader(io.StringIO(text)):
        found.setdefault(float(row["lambda"]), {})[row["line"]] = float(row["value"])
    return found


def of_csv(page):
    text = download(page, page.locator(HOME).get_by_role("button", name="Download as CSV")).decode()
    return list(csv.DictReader(io.StringIO(text)))


def test_shared_points_and_metrics_are_compared_line_by_line(page):
    words = page.locator(f"{HOME} [role=status]").inner_text()
    assert words.startswith("2 shared points and 1 shared metric. Shared axes: lambda.")
    found = of_csv(page)
    assert [(float(row["lambda"]), row["metric"]) for row in found] == [(0.1, "std_error"), (10.0, "std_error")]
    one, two = scores("linear"), scores("second", f"kept = '{KEPT[0].replace(chr(39), 2 * chr(39))}'")
    rng = np.random.default_rng(1)
    for row in found:
        a, b = one[float(row["lambda"])], two[float(row["lambda"])]
        assert set(a) == set(b) and LINE in a and len(a) == 6
        by = np.array([b[line] - a[line] for line in a])
        assert int(row["paired lines"]) == 6 and row["lines"] == "equal"
        assert np.isclose(float(row["mean difference"]), by.mean(), rtol=1e-9)
        means = rng.choice(by, (100_000, len(by))).mean(axis=1)
        low, high = np.percentile(means, [2.5, 97.5])
        # The ends of 2,000 resamples scatter.
        error = 0.24 * means.std()
        assert abs(float(row["difference low"]) - low) < error and abs(float(row["difference high"]) - high) < error
    table = page.locator(f"{HOME} table.against tbody tr")
    rows = [[c.strip() for c in row.locator("td").all_inner_texts()] for row in table.all()]
    for cells, row in zip(rows, found):
        stars = [cell.startswith("\u2605") for cell in cells[1:3]]
        a, b = float(row["A"]), float(row["B"])
        assert stars == ([False, False] if row["marks A"] or row["marks B"] or a == b else [a < b, b < a])
        assert cells[5].startswith(f"{float(row['mean difference']):.4}"[:5])


def test_what_differs_is_listed(page):
    rows = {tuple(r.locator("td").all_inner_texts()[:3]): r.locator("td").all_inner_texts()[3:]
            for r in page.locator(f"{HOME} table.changes tbody tr").all()}
    assert rows["parameter", "coefficients", "trim"][1] == "30"
    assert rows["parameter", "terms", "terms"][1] == '["permanent"]'
    assert rows["table", "network", "stage"] == ["absent", rows["table", "network", "stage"][1]]
    assert rows["table", "network", "stage"][1].startswith("fit, version ")
    assert "0.1" in rows["parameter", "coefficients", "lambda"][0]
    # Equal parts are not listed.
    assert not any(key[0] == "source" or key[2] in ("truth", "vector") for key in rows)


def test_pipelines_and_axes_of_one_pipeline_are_chosen_by_keyboard(page):
    before = of_csv(page)
    kept = page.locator(f"{HOME} [data-key='b.kept']")
    assert kept.locator("option").count() == 2
    kept.focus()
    page.keyboard.press("ArrowDown")
    until(page, "location.hash.includes('pipelines')")
    assert "evil" not in page.locator(f"{HOME} [data-key='b.kept']").inner_text()
    page.locator(f"{HOME} [data-key=a]").select_option("second.scores")
    until(page, "document.querySelector('#pipelines thead').textContent.includes('A: second')")
    page.locator(f"{HOME} [data-key=b]").select_option("linear.scores")
    after = of_csv(page)
    for one, two in zip(before, after):
        assert np.isclose(float(one["difference"]), -float(two["difference"]))
    page.reload()
    page.locator(f"{HOME} table.changes").wait_for()
    assert of_csv(page) == after


def test_other_lines_are_never_marked_as_better(page):
    """The scores of one line are removed from one pipeline."""
    def fewer(route):
        block = route.fetch().json()
        lines = block["lines"]
        keep = [i for i, at in enumerate(lines["lines"]) if lines["names"][at][1] != "plain"]
        for key in ("points", "lines"):
            lines[key] = [lines[key][i] for i in keep]
        lines["values"] = [[column[i] for i in keep] for column in lines["values"]]
        route.fulfill(json=block)

    page.route("**/api/scores?table=second*", fewer)
    page.reload()
    page.locator(f"{HOME} table.changes").wait_for()
    found = of_csv(page)
    assert all(row["lines"] == "lines differ: 6 in A, 5 in B, 5 in both" for row in found)
    assert page.locator(f"{HOME} td.best").count() == 0
    assert "2 are not on the same lines" in page.locator(f"{HOME} [role=status]").inner_text()


def test_one_pipeline_has_no_comparison(visit, view):
    page = visit(view("cabin"))
    page.locator("section.explorer table.virtual").first.wait_for()
    assert page.locator(HOME).count() == 0


@pytest.mark.parametrize("width,scheme", [(390, "dark"), (1400, "light")])
def test_the_comparison_is_accessible(visit, view, width, scheme):
    page = visit(view("pair"), width, scheme)
    page.locator(f"{HOME} table.changes").wait_for()
    found = Axe().run(page, context=HOME).response["violations"]
    assert [(v["id"], [n["html"][:120] for n in v["nodes"][:3]]) for v in found] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator("#injected").count() == 0
    if os.environ.get("SCREENSHOTS"):
        page.locator(HOME).screenshot(path=f"{os.environ['SCREENSHOTS']}/pipelines-{width}-{scheme}.png")
