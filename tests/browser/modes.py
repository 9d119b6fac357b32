"""Tests of the modes of a particle filter on the track, in a report and in `magline view`, against the store."""

import json
import os
import re
import subprocess

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from conftest import FOLDER, line_view, until

SOURCES = ["report", "view"]
PICTURE = "document.querySelector('#series .track-canvas').toDataURL()"


@pytest.fixture(scope="module")
def stored():
    """Time of each sample, s, and its modes: weight, latitude, longitude, standard deviations, covariance."""
    query = "SELECT tt, modes FROM charted.track ORDER BY tt"
    command = [os.environ["MAGLINE"], "sql", query, "--store", FOLDER / "charted", "--format", "json"]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    rows = json.loads(text) if text.startswith("[") else [json.loads(line) for line in text.splitlines()]
    modes = np.array([row["modes"] for row in rows], dtype=float).reshape(-1, 3, 6)
    return np.array([row["tt"] for row in rows]), modes


@pytest.fixture
def open_page(visit, view):
    def open_page(source, **more):
        page = visit(FOLDER / "charted.html" if source == "report" else view("charted"), **more)
        line_view(page)
        page.locator("#series .track canvas").wait_for()
        page.locator("#series [data-key=modes]").wait_for()
        return page

    return open_page


def show(page, first, last):
    """Zooms to an interval, and reads its first sample."""
    tools = page.locator("#series .line-main .downloads").first
    for key, value in (("to", last), ("from", first)):
        tools.locator(f"[data-key={key}]").fill(f"{value:.3f}")
        tools.locator(f"[data-key={key}]").press("Enter")
    until(page, "(t) => Math.abs(document.querySelector('#series .charts').dataset.shown.split(' ')[0] - t) < 1e-6",
          round(first, 3))
    page.locator("#series .chart").first.focus()
    page.keyboard.press("Home")
    until(page, "[...document.querySelectorAll('#series .track .note')].some((p) => p.textContent.includes('mode 1'))")
    return page.locator("#series .track p.note").last.inner_text()


def is_reading(words, modes):
    """Whether a reading has the weights and positions of the modes of a sample."""
    found = re.findall(r"mode (\d): ([\d.]+) %, (-?[\d.]+)\u00b0, (-?[\d.]+)\u00b0", words)
    if [int(k) - 1 for k, *_ in found] != [k for k in range(3) if np.isfinite(modes[k, 0])]:
        return False
    # The page has five digits of a degree; a report has positions to a fraction of 1e-5 of their range.
    limits = np.array([0.06, 1e-5, 1e-5])
    wanted = np.array([100.0, 1.0, 1.0]) * np.array([modes[int(k) - 1][:3] for k, *_ in found])
    return bool(np.all(np.abs(np.array(found, dtype=float)[:, 1:] - wanted) < limits))


@pytest.mark.parametrize("source", SOURCES)
def test_the_modes_of_a_sample_are_those_of_the_store(open_page, stored, source):
    tt, modes = stored
    page = open_page(source)
    several = np.flatnonzero(np.isfinite(modes[:, 1, 0]))
    assert len(several) > 10
    for at in several[[0, len(several) // 2]]:
        words = show(page, tt[at], tt[at] + 2.0)
        # The reading of the sample before it stays until the sample is drawn.
        for _ in range(200):
            if is_reading(words, modes[at]):
                break
            page.wait_for_timeout(50)
            words = page.locator("#series .track p.note").last.inner_text()
        assert is_reading(words, modes[at]), words
    assert "modes of the particle filter" in page.locator("#series .track-canvas").get_attribute("aria-label")


@pytest.mark.parametrize("source", SOURCES)
def test_the_modes_are_drawn_and_can_be_hidden_by_keyboard(open_page, source):
    page = open_page(source)
    assert "mode; size and opacity" in page.locator("#series .track .legend").inner_text()
    box = page.locator("#series [data-key=modes]")
    drawn = None
    # Until the map and the track are drawn.
    while drawn != (drawn := page.evaluate(PICTURE)):
        page.wait_for_timeout(500)
    box.focus()
    page.keyboard.press("Space")
    until(page, f"(before) => {PICTURE} !== before", drawn)
    page.keyboard.press("Space")
    until(page, f"(before) => {PICTURE} === before", drawn)


def test_the_region_of_a_mode_is_that_of_its_covariance(open_page):
    page = open_page("report")
    for sd_n, sd_e, rho in [(30.0, 10.0, 0.0), (10.0, 30.0, 0.6), (20.0, 20.0, -0.9), (5.0, 400.0, 0.99)]:
        cov = rho * sd_n * sd_e
        values, vectors = np.linalg.eigh([[sd_e**2, cov], [cov, sd_n**2]])
        found = page.evaluate("(x) => modeRegion(...x)", [sd_n, sd_e, cov])
        assert np.allclose([found["short"], found["long"]], 3 * np.sqrt(values), rtol=1e-9)
        along = [np.cos(found["angle"]), np.sin(found["angle"])]
        assert abs(abs(np.dot(along, vectors[:, 1])) - 1) < 1e-9


def test_a_track_without_modes_has_no_control_for_them(visit, view):
    page = visit(view("cabin"))
    line_view(page)
    page.locator("#series .track canvas").wait_for()
    assert page.locator("#series [data-key=modes]").is_hidden()
    assert "mode" not in page.locator("#series .track .legend").inner_text()


@pytest.mark.parametrize("width,scheme", [(390, "dark"), (1400, "light")])
def test_the_track_with_modes_is_accessible(open_page, width, scheme):
    page = open_page("view", width=width, scheme=scheme)
    found = Axe().run(page, context="#series").response["violations"]
    assert [(v["id"], [n["html"][:120] for n in v["nodes"][:3]]) for v in found] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    if os.environ.get("SCREENSHOTS"):
        page.locator("#series").screenshot(path=f"{os.environ['SCREENSHOTS']}/modes-{width}-{scheme}.png")
