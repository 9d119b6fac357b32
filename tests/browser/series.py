"""Tests of the line view in Chromium: in a report, where the series are embedded, and in `magline view`."""

import csv
import hashlib
import io
import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from conftest import FOLDER, download, line_view, shown, until
from specs import LINE

WEB = Path(__file__).parents[2] / "pipeline/report/src/html/web"
SOURCES = ["report", "view"]


@pytest.fixture
def open_line(visit, view):
    """Opens the line view of a source."""

    def open_line(source, name="cabin", **more):
        page = visit(FOLDER / f"{name}.html" if source == "report" else view(name), **more)
        line_view(page)
        return page

    return open_line


def panels(page):
    return page.locator("#series .panel-figure h3").all_inner_texts()


def readings(page):
    return page.locator("#series .series-key .value").all_inner_texts()


def middle(page):
    page.locator("#series .u-over").first.scroll_into_view_if_needed()
    box = page.locator("#series .u-over").first.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_vendored_files_have_their_checksums_and_licences():
    folder = WEB / "vendor"
    listed = dict(reversed(line.split("  ")) for line in (folder / "SHA256SUMS").read_text().splitlines())
    files = {f.name for f in folder.iterdir() if f.suffix in (".js", ".LICENSE", ".bin")}
    assert files == set(listed) and len(files) == 6
    for name, digest in listed.items():
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest, name
    notice = (folder / "notice.js").read_text()
    for licence in folder.glob("*.LICENSE"):
        assert licence.read_text().strip() in notice
    for script in folder.glob("*.js"):
        assert "</script" not in script.read_text().lower()


@pytest.mark.parametrize("source", SOURCES)
def test_presets_fill_panels(open_line, source):
    page = open_line(source)
    assert "Position error, north [m]" in panels(page)
    chosen = page.locator("#series [data-preset]")
    names = [n for n in chosen.evaluate_all("all => all.map((b) => b.dataset.preset)") if n != "each"]
    assert {"navigation", "compensation"} <= set(names)
    for name in names:
        button = page.locator(f"#series [data-preset={name}]")
        while button.get_attribute("aria-pressed") == "true":
            button.click()
            until(page, f"document.querySelector('[data-preset={name}]').ariaPressed === 'false'")
        before = panels(page)
        button.click()
        until(page, f"document.querySelector('[data-preset={name}]').ariaPressed === 'true'")
        until(page, "(n) => document.querySelectorAll('#series .panel-figure').length >= n",
                               arg=max(1, len(before)))
    page.locator("#series [data-preset=each]").click()
    until(page, "(n) => document.querySelectorAll('#series .panel-figure').length > n", arg=len(before))


@pytest.mark.parametrize("source", SOURCES)
def test_zoom_by_drag_keys_buttons_and_fields(open_line, source):
    page = open_line(source)
    full = shown(page)
    x, y = middle(page)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 120, y, steps=4)
    page.mouse.up()
    low, high = shown(page)
    assert full[0] < low < high < full[1]
    # Moves by Shift and drag.
    page.keyboard.down("Shift")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 60, y, steps=4)
    page.mouse.up()
    page.keyboard.up("Shift")
    moved = shown(page)
    assert moved[0] < low and abs((moved[1] - moved[0]) - (high - low)) < 0.01
    page.mouse.dblclick(x, y)
    assert shown(page) == full
    page.locator("#series .chart").first.focus()
    for key, narrower in [("+", True), ("-", False), ("+", True), ("PageDown", None), ("PageUp", None)]:
        before = shown(page)
        page.keyboard.press(key)
        after = shown(page)
        if narrower is None:
            assert after != before
        else:
            assert (after[1] - after[0] < before[1] - before[0]) == narrower
    page.keyboard.press("0")
    assert shown(page) == full
    for label in ["Zoom in", "Later", "Earlier", "Zoom out", "Show all"]:
        page.locator("#series").get_by_role("button", name=label, exact=True).click()
    assert shown(page) == full
    third = (full[1] - full[0]) / 3
    page.locator("#series [data-key=to]").fill(f"{full[0] + 2 * third:.2f}")
    page.locator("#series [data-key=from]").fill(f"{full[0] + third:.2f}")
    page.locator("#series [data-key=from]").press("Enter")
    assert abs(shown(page)[0] - full[0] - third) < 0.02 and abs(shown(page)[1] - full[0] - 2 * third) < 0.02


def csv_rows(page):
    text = download(page, page.locator("#series").get_by_role("button", name="panels as CSV")).decode()
    return list(csv.DictReader(io.StringIO(text)))


@pytest.mark.parametrize("source", SOURCES)
def test_the_vertical_axis_follows_the_values_in_sight(open_line, source):
    page = open_line(source)
    for _ in range(3):
        rows = csv_rows(page)
        low, high = shown(page)
        times = [float(row["tt [s]"]) for row in rows]
        assert low <= min(times) and max(times) <= high and len(times) > 20
        columns = [c for c in rows[0] if c.startswith("north_error")]
        values = [float(row[c]) for row in rows for c in columns if row[c]]
        least, most = [float(v) for v in page.locator("#series .chart").first.get_attribute("data-y").split()]
        # The band widens the axis up to twice the largest error, and there is a margin.
        size = max(map(abs, values))
        assert least < min(values) and max(values) < most and max(abs(least), abs(most)) < 2.6 * size
        page.locator("#series .chart").first.focus()
        page.keyboard.press("+")
        page.wait_for_timeout(700)


@pytest.mark.parametrize("source", SOURCES)
def test_values_appear_in_all_panels(open_line, source):
    page = open_line(source)
    page.mouse.move(*middle(page))
    until(page, "[...document.querySelectorAll('#series .series-key .value')].every((v) => v.textContent)")
    assert all(any(c.isdigit() for c in text) or text in ("missing", "no data") for text in readings(page))
    assert "UTC" in page.locator("#series .read").first.inner_text()
    page.mouse.move(5, 5)
    page.locator("#series .chart").first.focus()
    seen = set()
    for key in ["Home", "ArrowRight", "ArrowRight", "End", "ArrowLeft"]:
        page.keyboard.press(key)
        seen.add(page.locator("#series output.unseen").text_content())
    assert len(seen) == 5 and all("Position error" in text for text in seen)


@pytest.mark.parametrize("source", SOURCES)
def test_the_largest_value_is_the_largest_of_the_csv(open_line, source):
    page = open_line(source)
    page.locator("#series").get_by_role("button", name="Largest value of Position error, north").click()
    at = float(page.locator("#series .read").first.inner_text().split("tt = ")[1].split(" ")[0])
    rows = csv_rows(page)
    columns = [c for c in rows[0] if c.startswith("north_error")]
    size = lambda row: max(abs(float(row[c])) for c in columns if row[c])
    most = max((r for r in rows if any(r[c] for c in columns)), key=size)
    assert abs(float(most["tt [s]"]) - at) < 0.02


@pytest.mark.parametrize("source", SOURCES)
def test_pictures_have_a_caption_and_parse(open_line, source):
    page = open_line(source)
    series = page.locator("#series")
    svg = ElementTree.fromstring(download(page, series.get_by_role("button", name="panels as SVG")))
    words = " ".join(svg.itertext())
    assert "flight" in words and "Position error, north [m]" in words and "time, UTC" in words
    assert sum(1 for _ in svg.iter("{http://www.w3.org/2000/svg}path")) > 20
    png = download(page, series.get_by_role("button", name="panels as PNG"))
    assert png[:8] == b"\x89PNG\r\n\x1a\n" and len(png) > 20_000


@pytest.mark.parametrize("source", SOURCES)
def test_the_address_restores_the_line_view(open_line, source):
    page = open_line(source)
    page.locator("#series").get_by_role("button", name="Next line").click()
    page.wait_for_timeout(300)
    page.locator("#series [data-preset=compensation]").click()
    until(page, "document.querySelector('[data-preset=compensation]').ariaPressed === 'true'")
    page.locator("#series .chart").first.focus()
    page.keyboard.press("+")
    page.wait_for_timeout(500)
    line = page.locator("#series [data-key=line]").input_value()
    before = (panels(page), shown(page), line)
    assert line == "1"
    page.reload()
    line_view(page)
    assert (panels(page), shown(page), page.locator("#series [data-key=line]").input_value()) == before


@pytest.mark.parametrize("source", SOURCES)
def test_columns_are_searched_and_chosen(open_line, source):
    page = open_line(source)
    columns = page.locator("#series details.columns")
    if columns.get_attribute("open") is None:
        columns.locator("summary").click()
    all_of = columns.locator("label.column").count()
    columns.locator("[data-key=column-search]").fill("residual nT")
    found = columns.locator("label.column")
    assert 0 < found.count() < all_of and "residual" in found.first.inner_text()
    box = found.first.locator("input")
    assert box.is_checked()
    box.click()
    until(page, "![...document.querySelectorAll('#series h3')].some((h) => h.textContent.includes('Innovation'))")
    columns.locator("label.column input").first.check()
    until(page, "[...document.querySelectorAll('#series h3')].some((h) => h.textContent.includes('Innovation'))")
    key = page.locator("#series .series-key").first
    key.click()
    assert key.get_attribute("aria-pressed") == "false"


@pytest.mark.parametrize("source", SOURCES)
def test_the_page_says_whether_a_series_is_thinned(open_line, source):
    page = open_line(source)
    status = page.locator("#series [role=status]")
    assert "hinned" in status.inner_text() or "thinned" in status.inner_text()
    if source == "view":
        page.locator("#series .chart").first.focus()
        for _ in range(6):
            page.keyboard.press("+")
        until(page, "document.querySelector('#series [role=status]').textContent.includes('All samples')")
        # The panel keeps the focus when new series arrive.
        assert page.evaluate("document.activeElement.className") == "chart"


@pytest.mark.parametrize("source", SOURCES)
def test_the_track_follows_the_line_view(open_line, source):
    page = open_line(source)
    track = page.locator("#series .track canvas")
    track.wait_for()
    picture = lambda: track.evaluate("canvas => canvas.toDataURL()")
    # The map arrives after the track.
    page.wait_for_timeout(800)
    before = picture()
    page.mouse.move(*middle(page))
    page.wait_for_timeout(300)
    assert picture() != before
    assert "estimate" in page.locator("#series .track .note").last.inner_text()
    page.mouse.move(5, 5)
    page.locator("#series .chart").first.focus()
    page.keyboard.press("+")
    page.wait_for_timeout(800)
    near = picture()
    assert near != before
    page.get_by_label("fit to the interval in sight").uncheck()
    assert picture() != near


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("width,scheme", [(390, "dark"), (800, "light"), (1400, "dark")])
def test_line_views_are_accessible_and_fit(open_line, source, width, scheme):
    page = open_line(source, width=width, scheme=scheme, motion="reduce")
    page.wait_for_timeout(500)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    found = Axe().run(page).response["violations"]
    assert [(v["id"], [n["html"][:120] for n in v["nodes"][:3]]) for v in found] == []
    if os.environ.get("SCREENSHOTS"):
        page.screenshot(path=f"{os.environ['SCREENSHOTS']}/{source}-{width}-{scheme}.png", full_page=True)


@pytest.mark.parametrize("source", SOURCES)
def test_hostile_names_stay_text_in_the_line_view(open_line, source):
    page = open_line(source, "hostile")
    assert page.locator("#injected").count() == 0
    svg = ElementTree.fromstring(download(page, page.locator("#series").get_by_role("button", name="panels as SVG")))
    assert all("injected" not in (node.get("id") or "") for node in svg.iter())
    if page.locator("#series details.columns").get_attribute("open") is None:
        page.locator("#series details.columns summary").click()
    names = page.locator("#series [data-key=line] option").all_inner_texts()
    assert any(LINE.replace("\u202e", "\\u202e") in name for name in names), names
    page.locator("#series [data-key=line]").select_option(index=["injected" in n for n in names].index(True))
    page.wait_for_timeout(500)
    assert page.locator("#injected").count() == 0
