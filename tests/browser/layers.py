"""Tests of the layers of a map in Chromium: relief, gradient, error and contours, against NumPy."""

import json
import os
import re
import warnings

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from conftest import until
from specs import LINE

READ = """async ([table, step]) => {
    const map = await SERVER.map(table), slopes = mapSlopes(map), list = (x) => Array.from(x, (v) => v);
    const levels = contourLevels(map.least, map.most, step);
    return { width: map.width, height: map.height, north: map.north, south: map.south, west: map.west, east: map.east,
      cells: list(map.cells), gradient: list(gradientCells(slopes)), light: list(mapLight(slopes)),
      lines: levels.map((level) => ({ level, lines: contourLines(map, level) })) };
}"""


def ready(page):
    page.locator("#maps figure [data-key=layer]").first.wait_for()


def read(page, table="cabin.anomaly", step=200):
    ready(page)
    found = page.evaluate(READ, [table, step])
    shape = (found["height"], found["width"])
    for name in ["cells", "gradient", "light"]:
        found[name] = np.array(found[name], dtype=float).reshape(shape)
    return found


def metres_per_degree(lat):
    """Metres of a degree of latitude and of longitude: the series of the WGS-84 ellipsoid."""
    a = np.radians(lat)
    north = 111132.954 - 559.822 * np.cos(2 * a) + 1.175 * np.cos(4 * a)
    east = 111412.84 * np.cos(a) - 93.5 * np.cos(3 * a) + 0.118 * np.cos(5 * a)
    return north, east


def differences(cells, axis):
    """Rise per cell: the mean of the steps to both neighbours, or the step to the only known neighbour."""
    steps = np.diff(cells, axis=axis)
    blank = np.full_like(np.take(cells, [0], axis), np.nan)
    steps = np.stack([np.concatenate([blank, steps], axis), np.concatenate([steps, blank], axis)])
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanmean(steps, axis=0)


def slopes(found):
    """Slopes to the east and to the north, nT/m; the rows begin in the north."""
    height, width = found["cells"].shape
    high = (found["north"] - found["south"]) / height
    lat = found["north"] - (np.arange(height) + 0.5) * high
    north, east = metres_per_degree(lat)
    down, right = (differences(found["cells"], axis) for axis in (0, 1))
    inside = np.isfinite(np.gradient(found["cells"])).all(0)
    inside[[0, -1]] = inside[:, [0, -1]] = False
    for own, central in zip((down, right), np.gradient(found["cells"]), strict=True):
        assert inside.sum() > 10_000 and np.allclose(own[inside], central[inside], rtol=1e-9, atol=1e-9)
    wide = (found["east"] - found["west"]) / width
    return right / (east * wide)[:, None], -down / (north * high)[:, None]


@pytest.fixture
def page(visit, view):
    page = visit(view("cabin"))
    ready(page)
    return page


def figure(page, table="cabin.anomaly"):
    return page.locator("#maps figure").filter(has=page.locator("h3", has_text=re.compile(f"^{re.escape(table)}$")))


def test_the_gradient_is_that_of_numpy_in_nt_per_km(page):
    found = read(page)
    east, north = slopes(found)
    wanted = 1000 * np.hypot(east, north)
    assert np.nanmax(wanted) > 10
    assert np.allclose(found["gradient"], wanted, rtol=1e-5, atol=1e-9, equal_nan=True)


def test_the_relief_is_lit_from_the_north_west(page):
    """Lambert's law, with the slopes flattened as in `magline map plot`."""
    found = read(page)
    east, north = slopes(found)
    slope = np.hypot(east, north)
    steep, known = np.sort(slope[slope > 0]), np.isfinite(slope)
    flatter = 1 / np.hypot(slope, steep[int(0.9 * steep.size)])
    normal = np.stack([-east * flatter, -north * flatter, np.ones_like(east)])
    sun = np.array([-np.sqrt(0.5), np.sqrt(0.5), 1.0]) / np.sqrt(2)
    lit = np.sqrt(2) * np.tensordot(sun, normal / np.linalg.norm(normal, axis=0), 1)
    wanted = 1 + 0.5 * (np.maximum(0, lit) - 1)
    assert np.nanmin(wanted) < 0.8 and np.nanmax(wanted) > 1.1
    assert np.allclose(found["light"][known], wanted[known], atol=2e-4)
    assert (found["light"][~known] == 1).all()


def test_contours_pass_where_the_interpolation_has_the_level(page):
    found = read(page)
    cells = found["cells"]
    assert len(found["lines"]) > 20
    # Edges of at least one cell without an unknown node: to the east, to the south.
    known = np.isfinite(cells)
    full = np.pad(known[1:, 1:] & known[1:, :-1] & known[:-1, 1:] & known[:-1, :-1], 1)
    inner = full[1:, 1:-1] | full[:-1, 1:-1], full[1:-1, 1:] | full[1:-1, :-1]
    for one in found["lines"]:
        level = one["level"]
        points = np.array([p for line in one["lines"] for p in line]).reshape(-1, 2)
        column, row = np.floor(points).astype(int).T
        u, v = (points - np.floor(points)).T
        right, below = np.minimum(column + 1, cells.shape[1] - 1), np.minimum(row + 1, cells.shape[0] - 1)
        corners = [((1 - u) * (1 - v), cells[row, column]), (u * (1 - v), cells[row, right]),
                   ((1 - u) * v, cells[below, column]), (u * v, cells[below, right])]
        values = sum(np.where(weight > 0, weight * value, 0) for weight, value in corners)
        assert np.abs(values - level).max() < 1e-6 * (1 + abs(level)), level
        # Each edge between nodes on both sides of the level has one crossing; a closed line repeats its first point.
        closed = sum(line[0] == line[-1] for line in one["lines"])
        above = cells >= level
        edges = ((above[:, 1:] != above[:, :-1]) & inner[0]).sum() + ((above[1:] != above[:-1]) & inner[1]).sum()
        assert len(points) - closed == edges, level


def test_labels_have_the_level_of_their_line(page):
    own = figure(page)
    own.locator("[data-key=step]").select_option("200")
    own.locator(".contour-label").first.wait_for()
    levels = {float(v) for v in own.locator("path.contour").evaluate_all("all => all.map((p) => p.dataset.level)")}
    labels = own.locator(".contour-label").evaluate_all(
        "all => all.map((l) => [l.textContent, parseFloat(l.style.left) / 100, parseFloat(l.style.top) / 100])")
    assert len(labels) >= 5 and len(levels) > 20
    found = read(page)
    cells, steepest = found["cells"], np.nanmax(np.abs(np.gradient(found["cells"])))
    for text, u, v in labels:
        level = float(text.replace("\u2212", "-"))
        near = cells[int(v * cells.shape[0]), int(u * cells.shape[1])]
        assert level in levels and level % 200 == 0 and abs(near - level) <= steepest
    assert "every 200 nT, thicker every 1000 nT" in own.locator("figcaption").inner_text()


def test_a_layer_has_its_unit_and_lives_in_the_address(page):
    own, found = figure(page), read(page)
    plain = own.locator("canvas").evaluate("canvas => canvas.toDataURL()")
    own.locator("[data-key=layer]").select_option("gradient")
    own.locator("[data-key=step]").select_option("100")
    until(page, "document.querySelector('#maps .map-scale').textContent.includes('nT/km')")
    low, high = np.nanpercentile(found["gradient"], [1, 99], method="lower")
    ends = [float(s.split()[0]) for s in own.locator(".map-scale span").all_inner_texts() if s]
    assert np.allclose(ends, [low, high], rtol=0.02)
    own.locator(".map-frame").focus()
    for _ in range(7):
        page.keyboard.press("ArrowRight")
    text = own.locator("output").inner_text()
    row, column = int(0.5 * found["height"]), int(0.57 * found["width"])
    value, level = re.search(r"horizontal gradient (\S+) nT/km, map (\S+) nT$", text).groups()
    assert abs(float(value) / found["gradient"][row, column] - 1) < 1e-3
    assert abs(float(level) / found["cells"][row, column] - 1) < 1e-3
    page.reload()
    ready(page)
    assert own.locator("[data-key=layer]").input_value() == "gradient"
    assert own.locator("path.contour").count() > 10
    own.locator("[data-key=layer]").select_option("relief")
    until(page, "(old) => document.querySelector('#maps canvas').toDataURL() !== old", plain)
    assert "thinned" not in own.locator("figcaption").inner_text()
    own.locator("[data-key=layer]").select_option("map")
    until(page, "(old) => document.querySelector('#maps canvas').toDataURL() === old", plain)


def test_only_a_map_with_errors_has_them(visit, view):
    page = visit(view("charted"))
    ready(page)
    assert figure(page, "charted.anomaly").locator("option[value=error]").count() == 0
    own = figure(page, "charted.grid")
    spread = page.evaluate("""async () => {
        const map = await SERVER.map("charted.grid", { spacing: "250.0" }, "error");
        const known = Array.from(map.cells).filter(Number.isFinite);
        return [Math.min(...known), Math.max(...known), map.unit];
    }""")
    # The 330 nodes of the stage have 0.450 to 9.808 nT; resampling to degrees is smooth.
    assert 0 < spread[0] < 2 and 7 < spread[1] < 10.5 and spread[2] == "nT", spread
    own.locator("[data-key=layer]").select_option("error")
    until(page, "[...document.querySelectorAll('#maps figcaption')].some((c) => c.textContent.startsWith('Error at'))")
    assert "Standard deviation of the error" in own.locator("figcaption").inner_text()
    own.locator(".map-frame").hover()
    assert re.search(r"error \S+( nT)?, map ", own.locator("output").inner_text())
    # The other point of the axis.
    cells = own.locator("figcaption").inner_text().split(" cells")[0]
    own.locator('[data-key="axis.spacing"]').select_option(index=1)
    until(page, "[...document.querySelectorAll('#maps figcaption')].some((c) => "
                "c.textContent.includes('spacing = 500'))")
    assert own.locator("figcaption").inner_text().split(" cells")[0] != cells


def test_hostile_names_stay_text_on_a_map(visit, view):
    page = visit(view("cabin"))
    ready(page)
    page.route("**/api/catalogue", lambda route: route.fulfill(json=catalogue(route.fetch().json())))
    page.route("**/api/map?*", lambda route: route.fulfill(json={**route.fetch(
        url=page.url.split("#")[0] + "api/map?table=cabin.anomaly").json(), "table": LINE, "unit": LINE}))
    page.reload()
    ready(page)
    own = page.locator("#maps figure").first
    own.locator("[data-key=layer]").select_option("gradient")
    own.locator("[data-key=step]").select_option(index=1)
    own.locator("path.contour").first.wait_for(state="attached")
    own.locator(".map-frame").hover()
    shown = LINE.replace("\u202e", "\\u202e")
    for part in ["h3", "output", "figcaption", ".map-scale", ".controls"]:
        assert shown in own.locator(part).inner_text(), part
        assert "\u202e" not in own.locator(part).inner_text(), part
    assert page.locator("#injected").count() == 0


def catalogue(found):
    """The catalogue with a hostile name of a map."""
    text = json.dumps(found)
    return json.loads(text.replace('"cabin.anomaly"', json.dumps("cabin." + LINE)))


@pytest.mark.parametrize("width,scheme", [(390, "light"), (390, "dark"), (1400, "light"), (1400, "dark")])
def test_layers_are_accessible_and_fit(visit, view, width, scheme):
    page = visit(view("charted"), width, scheme)
    ready(page)
    for own, layer in [(figure(page, "charted.anomaly"), "relief"), (figure(page, "charted.grid"), "error")]:
        own.locator("[data-key=layer]").select_option(layer)
        own.locator("[data-key=step]").select_option(index=1)
        own.locator("path.contour").first.wait_for(state="attached")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    found = Axe().run(page, context="#maps").response["violations"]
    assert [(v["id"], [n["html"][:120] for n in v["nodes"][:3]]) for v in found] == []
    if os.environ.get("SCREENSHOTS"):
        page.locator("#maps").screenshot(path=f"{os.environ['SCREENSHOTS']}/layers-{width}-{scheme}.png")
