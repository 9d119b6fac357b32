"""Tests of the differences of two points and of two runs against NumPy, in a report and in `magline view`."""

import csv
import io
import os
import subprocess

import numpy as np
import pytest
from conftest import FOLDER, download, until

SOURCES = ["report", "view"]
# Metrics that are pooled over lines as root mean squares, weighted by samples.
ROOTS = ["std_error", "std_uncompensated", "drms", "ins_drms"]


@pytest.fixture
def open_page(visit, view):
    return lambda source: visit(FOLDER / "cabin.html" if source == "report" else view("cabin"))


def scores_of_lines(text):
    """Values and numbers of samples of each line, by magnetometer, lambda and metric."""
    found = {}
    for row in csv.DictReader(io.StringIO(text)):
        if row["in_sample"] != "true" and row["value"]:
            key = row["mag"], float(row["lambda"]), row["metric"]
            found.setdefault(key, {})[row["flight"], row["line"]] = float(row["value"]), int(row["n"])
    return found


def newest():
    query = "SELECT mag, lambda, flight, line, metric, value, n, in_sample FROM cabin.scores"
    command = [os.environ["MAGLINE"], "sql", query, "--store", FOLDER / "cabin", "--format", "csv"]
    return scores_of_lines(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def pooled(lines):
    value, n = np.array(list(lines.values())).T
    return np.sqrt(np.average(value**2, weights=n))


def paired(one, two):
    return np.array([two[line][0] - one[line][0] for line in one])


def close(text, number):
    return np.isclose(float(text), number, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("lines,scale", [(5, 1.0), (12, 30.0), (200, 1e-3)])
def test_the_interval_of_a_mean_difference_is_that_of_numpy(open_page, lines, scale):
    rng = np.random.default_rng(lines)
    x = scale * (0.3 + rng.standard_normal(lines) + rng.exponential(size=lines))
    found = open_page("report").evaluate("(x) => pairedDifference(x)", x.tolist())
    means = rng.choice(x, (100_000, lines)).mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    # The ends of 2,000 resamples scatter by 5 % of the standard deviation: 0.0079 / density at 1.96.
    error = 4 * 0.06 * means.std()
    assert abs(found["mean"] - x.mean()) < 1e-12 * abs(x).sum()
    assert abs(found["low"] - low) < error and abs(found["high"] - high) < error
    assert (found["lower"], found["higher"]) == ((x < 0).sum(), (x > 0).sum())


def test_an_interval_needs_five_lines(open_page):
    page = open_page("report")
    of = lambda x: page.evaluate("(x) => pairedDifference(x)", x)
    assert of([]) is None and of([1.0, 2.0, 3.0, 5.0])["low"] is None
    equal = of([0.25] * 7)
    assert equal["low"] == equal["mean"] == equal["high"] == 0.25


@pytest.mark.parametrize("source", SOURCES)
def test_the_difference_of_two_points_is_that_of_numpy(open_page, source):
    page, known = open_page(source), newest()
    explorer = page.locator("section.explorer").first
    explorer.locator("table.virtual tbody tr:not(.gap)").first.wait_for()
    cells = [row.locator("td").all_inner_texts() for row in
             explorer.locator("table.virtual tbody tr:not(.gap)").all()[:2]]
    explorer.locator("table.virtual tbody tr:not(.gap)").first.locator("button").first.click()
    explorer.get_by_role("button", name=f"Compare with point {cells[1][0].split()[-1]}").click()
    explorer.locator("[data-view=compare]").click()
    explorer.locator("table.compare").wait_for()
    found = list(csv.DictReader(io.StringIO(download(page, explorer.get_by_role(
        "button", name="Download as CSV")).decode())))
    points = [(row[1].strip(), float(row[2])) for row in cells]
    rows = {row["metric"]: row for row in found}
    for metric in ROOTS:
        one, two = (known[*point, metric] for point in points)
        assert close(rows[metric]["A"], pooled(one)) and close(rows[metric]["B"], pooled(two)), metric
        assert int(rows[metric]["paired lines"]) == len(one) == 2 and rows[metric]["low"] == ""
        assert close(rows[metric]["mean difference"], paired(one, two).mean()), metric
    # A difference of the INS alone would be a mistake; one of the filter is not.
    assert float(rows["ins_drms"]["mean difference"]) == 0 != float(rows["drms"]["mean difference"])


@pytest.mark.parametrize("source", SOURCES)
def test_the_difference_of_two_runs_is_that_of_numpy(open_page, source):
    page, after = open_page(source), newest()
    before = scores_of_lines((FOLDER / "cabin-1.csv").read_text(encoding="utf-8"))
    if source == "view":
        page.locator("#against [data-key=against]").select_option("1")
    page.locator("#against table.against tbody tr").first.wait_for()
    found = list(csv.DictReader(io.StringIO(download(page, page.locator("#against").get_by_role(
        "button", name="Download as CSV")).decode())))
    checked = 0
    for row in found:
        key = row["mag"], float(row["lambda"]), row["metric"]
        if row["metric"] in ROOTS:
            one, two = before[key], after[key]
            assert close(row["value run 1"], pooled(one)) and close(row["value run 2"], pooled(two)), key
            assert np.isclose(float(row["difference"]), pooled(two) - pooled(one), rtol=1e-6, atol=1e-9), key
            assert close(row["mean difference"], paired(one, two).mean()) and row["paired lines"] == "2", key
            checked += row["metric"] == "std_error" and float(row["difference"]) != 0
    assert checked == 4
    until(page, "document.querySelector('#against td.paired').textContent.includes('of 2 lines')")
