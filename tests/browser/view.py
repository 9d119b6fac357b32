"""Tests of `magline view` in Chromium: comparison, run, lineage, maps, downloads, many points and samples."""

import csv
import io
import json
import math
import os
import time

import pytest
from axe_playwright_python.sync_playwright import Axe
from conftest import download, line_view, shown, until


@pytest.fixture
def page(visit, view):
    page = visit(view("cabin"))
    page.locator("section.explorer table.virtual").first.wait_for()
    line_view(page)
    return page


def explorer(page):
    return page.locator("section.explorer").first


def choose(page, row, **more):
    explorer(page).locator("tbody tr:not(.gap)").nth(row).locator("button").first.click(**more)


def test_a_choice_of_a_point_reaches_the_line_view(page):
    choose(page, 2)
    chosen = explorer(page).locator("[role=status]").inner_text().split("Chosen: ")[1].split(". ")[0].rstrip(".")
    axes = dict(part.split(" = ") for part in chosen.split(", "))
    line_view(page)
    for axis, value in axes.items():
        selected = page.locator(f'#series [data-key="p.{axis}"]')
        assert selected.evaluate("s => s.selectedOptions[0].textContent") == value


def test_two_points_are_compared(page):
    choose(page, 0)
    choose(page, 3, modifiers=["Shift"])
    panel = explorer(page).locator(".view")
    rows = [r.locator("th, td").all_inner_texts() for r in panel.locator("table.compare tbody tr").all()]
    assert any(row[3] == "differs" for row in rows)
    metrics = [r for r in rows if "[m]" in r[0]]
    for _, a, b, change, _ in metrics:
        one, two, by = (float(x.split(" ")[0]) for x in (a, b, change))
        assert abs(two - one - by) <= 2e-3 * max(abs(one), abs(two))
    assert panel.locator("svg .change").count() > 1
    panel.locator("svg").focus()
    page.keyboard.press("ArrowRight")
    assert "at B" in panel.locator("output").inner_text()
    # The line view overlays both points.
    until(page, "[...document.querySelectorAll('#series .series-key')].some((k) => k.textContent.includes('(B)'))")
    page.locator("#series").get_by_role("button", name="Remove B").click()
    until(page, "![...document.querySelectorAll('#series .series-key')].some((k) => k.textContent.includes('(B)'))")


def test_the_second_point_is_chosen_by_keyboard(page):
    explorer(page).locator("tbody tr:not(.gap)").nth(1).locator("button").first.focus()
    page.keyboard.press("Enter")
    explorer(page).locator("button.second").first.focus()
    page.keyboard.press("Enter")
    assert explorer(page).locator("[data-view=compare]").get_attribute("aria-selected") == "true"


def test_a_line_of_the_explorer_opens_its_series(page):
    explorer(page).locator("[data-view=lines]").click()
    explorer(page).locator(".view svg").focus()
    page.keyboard.press("ArrowDown")
    words = explorer(page).locator(".view output").inner_text()
    page.keyboard.press("Enter")
    line = words.split("line ")[1].split(":")[0]
    until(page, "(line) => document.querySelector('#series [role=status]').textContent.includes(line)", line)


def test_position_errors_agree_with_the_scores(page):
    """The root mean square of the plotted errors of a line is its score `drms`."""
    explorer(page).locator("[data-view=lines]").click()
    explorer(page).locator(".view svg").focus()
    page.keyboard.press("ArrowDown")
    words = explorer(page).locator(".view output").inner_text()
    score, line = float(words.split("drms ")[1].split(" m")[0]), words.split("line ")[1].split(":")[0]
    page.keyboard.press("Enter")
    until(page, "(line) => document.querySelector('#series [role=status]').textContent.includes('line ' + line)", line)
    page.wait_for_timeout(1500)
    text = download(page, page.locator("#series").get_by_role("button", name="panels as CSV")).decode()
    rows = list(csv.DictReader(io.StringIO(text)))
    squares = [sum(float(row[c]) ** 2 for c in row if c.startswith(axis) and row[c]) / max(1, sum(
        c.startswith(axis) for c in row)) for row in rows for axis in ("north_error", "east_error")]
    root = math.sqrt(2 * sum(squares) / len(squares))
    assert len(rows) > 500 and abs(root - score) < 0.03 * score, (root, score)


def test_the_run_shows_its_units(page):
    live = page.locator("#live")
    until(page, "document.querySelector('#live [role=status]').textContent.includes('units')")
    assert live.locator(".figures strong").count() > 0
    kinds = live.locator("details")
    assert kinds.count() > 0
    kinds.first.locator("summary").click()
    assert "First at" in kinds.first.inner_text()
    bars = live.locator("[role=progressbar]")
    for bar in bars.all():
        assert int(bar.get_attribute("aria-valuenow")) <= int(bar.get_attribute("aria-valuemax"))


def test_a_run_in_progress_is_followed(page):
    answers = [{"state": "running", "done": 3, "changed": "a"}, {"state": "running", "done": 7, "changed": "b"},
               {"state": "done", "done": 10, "changed": "c"}]
    asked = {"run": 0, "scores": 0}

    def run(route):
        now = answers[min(asked["run"], len(answers) - 1)]
        asked["run"] += 1
        units = {"done": now["done"], "failed": 0, "total": 10}
        route.fulfill(json={"pipeline": "cabin", "state": now["state"], "units": units, "changed": now["changed"],
                            "tables": [{"table": "cabin.track", "stage": "navigate", **units}], "failures": [],
                            "best": [], "runs": []})

    def scores(route):
        asked["scores"] += 1
        route.continue_()

    page.route("**/api/run", run)
    page.route("**/api/scores?*", scores)
    page.reload()
    bar = page.locator("#live [role=progressbar]")
    bar.wait_for()
    first = bar.get_attribute("aria-valuenow")
    until(page, "document.querySelector('#live [role=progressbar]')?.ariaValueNow === '7'")
    until(page, "document.querySelector('#live [role=status]').textContent.includes('10 of 10')")
    assert first == "3" and bar.count() == 0
    # The scores are read again when tables were published.
    assert asked["scores"] == 3


def test_lineage_leads_to_the_line_view(page):
    lineage = page.locator("#lineage")
    lineage.locator("ul.tree li").first.wait_for()
    assert lineage.locator("svg .box").count() >= 4
    lineage.locator("ul.tree summary").first.click()
    box = lineage.locator("svg .box[role=button]").first
    name = box.locator(".title").text_content()
    box.focus()
    page.keyboard.press("Enter")
    until(page, "(name) => document.querySelector('[data-key=column-table]').value === name", name)
    options = lineage.locator("[data-key=lineage] option").all_inner_texts()
    lineage.locator("[data-key=lineage]").select_option(label=options[0])
    until(page, "(name) => document.querySelector('#lineage h3').textContent.includes(name)", options[0])


def test_the_map_reads_its_values(page):
    page.locator("#maps .map-frame canvas").first.wait_for()
    frame = page.locator("#maps .map-frame").first
    frame.scroll_into_view_if_needed()
    frame.hover()
    words = page.locator("#maps output").first.inner_text()
    assert "\u00b0" in words and ("nT" in words or "unknown" in words)
    frame.focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowUp")
    place = lambda text: [float(part.strip(", ")) for part in text.split("\u00b0")[:2]]
    before, after = place(words), place(page.locator("#maps output").first.inner_text())
    assert after[0] > before[0] and after[1] > before[1]


def test_whole_tables_are_downloads(page):
    links = page.locator("#series .downloads a")
    addresses = links.evaluate_all("all => all.map((a) => a.href)")
    assert {a.rsplit("=", 1)[1] for a in addresses} == {"csv", "parquet"}
    assert all(a.startswith(page.url.split("#")[0]) for a in addresses)
    assert b"," in download(page, links.first)
    scores = explorer(page).locator(".downloads a").evaluate_all("all => all.map((a) => a.href)")
    assert len(scores) == 2 and all("scores" in a for a in scores)


@pytest.mark.parametrize("width,scheme", [(390, "dark"), (1400, "light")])
def test_every_view_of_the_scores_is_accessible(visit, view, width, scheme):
    page = visit(view("cabin"), width, scheme)
    explorer(page).locator("table.virtual").first.wait_for()
    choose(page, 0)
    choose(page, 1, modifiers=["Shift"])
    for tab in explorer(page).locator("[role=tab]").all():
        tab.click()
        found = Axe().run(page, context="section.explorer").response["violations"]
        assert [(v["id"], [n["html"][:120] for n in v["nodes"][:3]]) for v in found] == [], tab.inner_text()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    if os.environ.get("SCREENSHOTS"):
        page.screenshot(path=f"{os.environ['SCREENSHOTS']}/compare-{width}-{scheme}.png", full_page=True)


def test_nothing_moves_where_motion_is_reduced(visit, view):
    page = visit(view("cabin"), motion="reduce")
    line_view(page)
    assert page.evaluate("document.getAnimations().length") == 0


def test_a_long_axis_has_a_field(page):
    def answer(route):
        found = route.fetch().json()
        axis = next(a for a in found["pipelines"][0]["axes"] if a["name"] == "lambda")
        axis["values"] += [str(1000 + i) for i in range(1000)]
        route.fulfill(body=json.dumps(found), content_type="application/json")

    page.route("**/api/catalogue", answer)
    page.reload()
    line_view(page)
    field = page.locator('#series input[data-key="p.lambda"]')
    field.fill("never")
    field.press("Enter")
    assert "has no value never" in page.locator("#series [role=status]").inner_text()
    field.fill("25")
    field.press("Enter")
    until(page, "location.hash.includes('p.lambda=25')")
    line_view(page)


def many_points(block, count):
    """A block of scores with `count` points, from the values of another."""
    metrics = block["metrics"]
    axis = {"name": "lambda", "numeric": True, "values": [repr(i / 1000) for i in range(count)]}
    values = [[(column[0] or 1.0) * (1 + (i * 7919 % count) / count) for i in range(count)]
              for column in block["values"]]
    return {**block, "points": count, "axes": [axis], "at": [list(range(count))], "values": values,
            "in_sample": [[] for _ in metrics], "flagged": [0] * count, "cautious": [], "bounds": [],
            "held_out": [1] * count, "seen": [0] * count, "lines": None}


def frame_steps(trace):
    """Sorted times between drawn frames, ms."""
    drawn = sorted(e["ts"] for e in trace["traceEvents"] if e["name"] == "DrawFrame")
    return sorted((b - a) / 1000 for a, b in zip(drawn, drawn[1:]))


def test_ten_thousand_points_and_a_million_samples(browser, visit, view, capsys):
    """Prints times; the machine decides how long it takes."""
    address = view("million")
    page = visit(address)
    line_view(page)

    def answer(route):
        block = route.fetch().json()
        route.fulfill(body=json.dumps(many_points(block, 10_000)), content_type="application/json")

    page.route("**/api/scores?*", answer)
    start = time.perf_counter()
    page.reload()
    explorer(page).locator("table.virtual").wait_for()
    scores = time.perf_counter() - start
    line_view(page)
    series = time.perf_counter() - start
    until(page, "/: 1000000 samples/.test(document.querySelector('#series [role=status]').textContent)")
    assert "10000 of 10000 points" in explorer(page).locator("[role=status]").inner_text()
    page.locator("#series .chart").first.focus()
    browser.start_tracing(page=page, categories=["disabled-by-default-devtools.timeline.frame",
                                                 "devtools.timeline.frame", "devtools.timeline"])
    page.evaluate("""() => new Promise((done) => {
        let count = 0;
        const step = () => {
            const key = count % 40 < 20 ? "+" : "-";
            document.activeElement.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
            if (++count < 120) requestAnimationFrame(step); else done();
        };
        requestAnimationFrame(step);
    })""")
    steps = frame_steps(json.loads(browser.stop_tracing()))
    with capsys.disabled():
        print(f"\n10,000 points: {scores:.2f} s; panels of 1,000,000 samples: {series:.2f} s; while zooming "
              f"a frame takes {steps[len(steps) // 2]:.1f} ms (median), {steps[int(0.95 * len(steps))]:.1f} ms (95 %)")
    low, high = shown(page)
    assert high > low
