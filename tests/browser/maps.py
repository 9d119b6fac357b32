"""Tests of spectra, profiles and coastlines in Chromium."""

import csv
import io
import json
import math
import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from conftest import FOLDER, download, line_view, shown, until

REFERENCE = Path(__file__).parents[2] / "stages/numerics/reference/signal"


def reference(name):
    """Columns of a table that SciPy computed."""
    text = (REFERENCE / name).read_text()
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    return {key: [float(row[key]) for row in rows] for key in rows[0]}


@pytest.fixture
def page(visit, view):
    page = visit(view("cabin"))
    line_view(page)
    return page


def spectra(page):
    page.locator("#series [data-preset=spectra]").click()
    page.locator("#series .line-spectra figure path.spectrum").first.wait_for()


def densities(page, unit):
    figure = page.locator("#series .line-spectra figure").filter(has=page.get_by_text(f"density, {unit}/√Hz"))
    text = download(page, figure.first.get_by_role("button", name="Download as CSV")).decode()
    return [(row["series"], float(row["frequency [Hz]"]), float(row[f"density [{unit}/√Hz]"]))
            for row in csv.DictReader(io.StringIO(text))]


def test_the_spectrum_of_a_report_equals_that_of_scipy(visit):
    page = visit(FOLDER / "cabin.html")
    samples, wanted = reference("spectrum_samples.csv")["x"], reference("spectrum_64.csv")
    found = page.evaluate("(x) => welchDensity(x, 20, 64)", samples)
    assert found["segments"] == 2 * len(samples) // 64 - 1 and found["leftOut"] == 0
    for own, scipy in zip(found["density"], wanted["hann"], strict=True):
        assert abs(own - scipy) < 1e-13 * (1 + scipy)
    samples[10] = None
    gap = page.evaluate("(x) => welchDensity(x.map((v) => v ?? NaN), 20, 64)", samples)
    assert (gap["segments"], gap["leftOut"]) == (found["segments"] - 1, 1)


def test_spectra_follow_the_interval_in_sight(page):
    spectra(page)
    status = page.locator("#series .spectra-note")
    count = lambda: int(status.inner_text().split("Welch's method on ")[1].split(" samples")[0])
    whole = count()
    found = densities(page, "m")
    assert {name for name, *_ in found} >= {"north_error", "east_error"}
    # Parseval: the integral over frequency is a part of the variance.
    step = found[1][1] - found[0][1]
    assert all(f > 0 and d > 0 and math.isfinite(d) for _, f, d in found) and abs(found[0][1] - step) < 1e-9
    page.locator("#series .chart").first.focus()
    page.keyboard.press("+")
    until(page, "(n) => Number(document.querySelector('#series .spectra-note').textContent"
                ".split(' on ')[1].split(' samples')[0]) < n", whole)
    low, high = shown(page)
    assert abs(count() - 10 * (high - low)) < 3
    svg = page.locator("#series .line-spectra svg").first
    svg.focus()
    page.keyboard.press("ArrowRight")
    assert "/√Hz at" in page.locator("#series .line-spectra output").first.inner_text()
    picture = ElementTree.fromstring(download(page, page.locator("#series .line-spectra figure").first.get_by_role(
        "button", name="Download as SVG")))
    assert "frequency, Hz" in " ".join(picture.itertext())
    page.locator("#series [data-preset=spectra]").click()
    # The spectra are hidden after the panels are loaded.
    page.locator("#series .line-spectra").wait_for(state="hidden")


def test_a_thinned_series_of_a_report_has_no_spectrum(visit):
    page = visit(FOLDER / "cabin.html")
    line_view(page)
    page.locator("#series [data-preset=spectra]").click()
    until(page, "document.querySelector('#series .spectra-note').textContent.includes('magline view')")
    assert page.locator("#series .line-spectra figure").count() == 0


def test_a_complete_series_of_a_report_has_spectra(visit):
    page = visit(FOLDER / "hostile.html")
    line_view(page)
    spectra(page)
    assert "300 samples at 10.00 Hz" in page.locator("#series .spectra-note").inner_text()
    assert page.locator("#injected").count() == 0
    # Noise of 0.1 nT at 10 Hz has 0.1 / sqrt(5) nT/√Hz.
    found = [d for name, f, d in densities(page, "nT") if name == "mag_1_uc" and f > 2]
    mean = math.sqrt(sum(d * d for d in found) / len(found))
    assert abs(mean / (0.1 / math.sqrt(5)) - 1) < 0.25, mean


def drawn_map(page):
    page.locator("#maps .map-frame canvas").first.wait_for()
    return page.locator("#maps .map-frame").first


def profile(page):
    frame = drawn_map(page)
    frame.scroll_into_view_if_needed()
    box = frame.bounding_box()
    for x, y in [(0.25, 0.75), (0.7, 0.3)]:
        page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
    page.locator("#maps .map-profile svg path.spectrum").wait_for()
    return page.locator("#maps .map-profile").first


def test_a_drawn_line_gives_a_profile(page):
    shown_profile = profile(page)
    text = download(page, shown_profile.get_by_role("button", name="Download as CSV")).decode()
    rows = [[float(v) if v else None for v in row] for row in list(csv.reader(io.StringIO(text)))[1:]]
    assert text.splitlines()[0] == "distance [m],lat [deg],lon [deg],value [nT]" and len(rows) > 100
    (_, lat, lon, _), (far, lat2, lon2, _) = rows[0], rows[-1]
    metres = math.hypot((lat2 - lat) * 110_700, (lon2 - lon) * 111_320 * math.cos(math.radians((lat + lat2) / 2)))
    assert abs(far / metres - 1) < 0.005
    steps = [b[0] - a[0] for a, b in zip(rows, rows[1:])]
    assert rows[0][0] == 0 and max(steps) - min(steps) < 0.01 * max(steps)
    # The raster of the page has the nearest cell's value.
    read = page.evaluate("""async ([lat, lon]) => {
        const map = await SERVER.map("cabin.anomaly");
        const x = Math.floor((lon - map.west) / (map.east - map.west) * map.width);
        const y = Math.floor((map.north - lat) / (map.north - map.south) * map.height);
        return map.cells[y * map.width + x];
    }""", rows[40][1:3])
    values = [row[3] for row in rows if row[3] is not None]
    assert abs(read - rows[40][3]) < 0.2 * (max(values) - min(values))
    assert "on the ellipsoid" in shown_profile.locator("figcaption").inner_text()
    shown_profile.locator("svg").focus()
    page.keyboard.press("ArrowRight")
    assert " nT at " in shown_profile.locator("output").inner_text()
    # The third click begins a new profile.
    page.locator("#maps .map-frame").first.click()
    assert shown_profile.locator("svg").count() == 0


def test_a_profile_is_drawn_by_keyboard(page):
    frame = drawn_map(page)
    frame.focus()
    page.keyboard.press("Enter")
    for _ in range(20):
        page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    page.locator("#maps .map-profile svg path.spectrum").wait_for()
    frame.focus()
    page.keyboard.press("Escape")
    assert page.locator("#maps .map-profile svg").count() == 0
    # Escape before the profile is there.
    waiting = []
    page.route("**/api/profile?*", lambda route: waiting.append(route))
    for keys in ["Enter", "ArrowRight", "Enter"]:
        frame.press(keys)
    while not waiting:
        page.wait_for_timeout(20)
    frame.press("Escape")
    with page.expect_response("**/api/profile?*"):
        waiting[0].continue_()
    page.wait_for_timeout(200)
    assert page.locator("#maps .map-profile svg").count() == 0


def test_coastlines_are_under_tracks_and_maps(page):
    # The survey is inland; these lines cross its region.
    lines = [[140.5, -22.2, 140.7, -21.8], [140.4, -22.0, 140.9, -21.95]]
    assert page.locator("#series .track .coast-note").is_hidden() and page.locator("#maps .coast").count() == 0
    plain = page.locator("#series .track canvas").evaluate("canvas => canvas.toDataURL()")
    page.route("**/api/coast?*", lambda route: route.fulfill(json={"lines": lines}))
    page.reload()
    line_view(page)
    page.locator("#maps path.coast").first.wait_for(state="attached")
    until(page, "!document.querySelector('#series .coast-note').hidden")
    assert page.locator("#series .track canvas").evaluate("canvas => canvas.toDataURL()") != plain
    assert "Natural Earth" in page.locator("#maps .coast-note").first.inner_text()
    first = page.locator("#maps path.coast").first.get_attribute("d").split("L")
    assert len(first) == 3 and first[0].startswith("M")


def test_a_report_inland_embeds_no_coastlines(visit):
    page = visit(FOLDER / "cabin.html")
    assert page.locator("script.coast").count() == 0


@pytest.mark.parametrize("width,scheme", [(390, "dark"), (1400, "light")])
def test_spectra_and_profiles_are_accessible_and_fit(visit, view, width, scheme):
    page = visit(view("cabin"), width, scheme)
    line_view(page)
    page.route("**/api/coast?*", lambda route: route.fulfill(body=json.dumps({"lines": [[140.5, -22.2, 140.7, -21.8]]}),
                                                             content_type="application/json"))
    spectra(page)
    profile(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for part in ["#series", "#maps"]:
        found = Axe().run(page, context=part).response["violations"]
        assert [(v["id"], [n["html"][:120] for n in v["nodes"][:3]]) for v in found] == []
    if os.environ.get("SCREENSHOTS"):
        for part in ["#series", "#maps"]:
            name = f"{part[1:]}-{width}-{scheme}.png"
            page.locator(part).screenshot(path=f"{os.environ['SCREENSHOTS']}/{name}")
