"""Tests of the HTML report in Chromium. `.ci/browser` makes the reports and starts the tests."""

import csv
import io
import json
import os
import re
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from conftest import FOLDER, download
from specs import AXIS, LINE

PROGRAM = os.environ["MAGLINE"]
VIEWS = ["table", "pivot", "heat", "curve", "parallel", "scatter", "lines", "compare"]


def explorer(page):
    return page.locator("section.explorer").first


def rows(page):
    return [[c.strip() for c in row.locator("td").all_inner_texts()]
            for row in explorer(page).locator("table.virtual tbody tr:not(.gap)").all()]


def choose_two(page):
    """Chooses two points in the table: one by a click, the other by its button B."""
    explorer(page).locator("[data-view=table]").click()
    explorer(page).get_by_role("button", name="1", exact=True).click()
    explorer(page).get_by_role("button", name="Compare with point 2").click()


def test_the_answer_precedes_all_other_sections(visit):
    for name in ["tolles_lawson", "navigation"]:
        page = visit(FOLDER / f"{name}.html")
        assert page.locator("section").first.get_attribute("id") == "answer"
        assert page.locator("#answer .sentence").first.inner_text().strip()


def last_run(name):
    """The hash of the last run in the store's history."""
    lines = (FOLDER / name / "runs" / f"{name}.jsonl").read_text().split("\n")
    return json.loads(lines[-1])["run"]


@pytest.mark.parametrize("source", ["report", "view"])
def test_the_foot_has_the_run_and_the_citation(visit, view, source):
    page = visit(view("cabin") if source == "view" else FOLDER / "cabin.html")
    assert page.locator("footer [data-run=cabin]").inner_text() == last_run("cabin")
    assert re.search(r"magline: .+\. Version \d+\.\d+\.\d+\.", page.locator("footer").inner_text())


@pytest.mark.parametrize("width", [390, 1400])
def test_the_chosen_line_is_readable(visit, width):
    """The text of a closed list is not cut: the longest one has the reasons of a report."""
    page = visit(FOLDER / "cabin.html", width=width)
    texts = page.locator("#series select").evaluate_all("""all => all.map((s) => {
        const pen = document.createElement("canvas").getContext("2d"), style = getComputedStyle(s);
        pen.font = style.font;
        // Room for the arrow.
        const room = s.clientWidth - parseFloat(style.paddingLeft) - parseFloat(style.paddingRight) - 16;
        return [s.selectedOptions[0].text, pen.measureText(s.selectedOptions[0].text).width, room];
    })""")
    assert any("line" in text for text, _, _ in texts)
    assert [text for text, width, room in texts if width > room] == []


@pytest.mark.parametrize("view", VIEWS)
def test_every_view_of_the_explorer_draws(visit, view):
    page = visit(FOLDER / "hostile.html")
    tab = explorer(page).locator(f"[data-view={view}]")
    tab.click()
    assert tab.get_attribute("aria-selected") == "true"
    panel = explorer(page).locator(".view")
    if view == "table":
        assert len(rows(page)) == 4
    elif view == "pivot":
        assert panel.locator("table.pivot tbody td button").count() == 4
    else:
        if view == "compare":
            choose_two(page)
        drawn = {"heat": ".cell", "parallel": "path.way", "scatter": ".dots", "compare": ".change"}.get(view, "circle")
        assert panel.locator("svg").locator(drawn).count() > 0
        panel.locator("svg").focus()
        page.keyboard.press("ArrowRight")
        assert panel.locator("output").inner_text().strip()


def test_the_table_sorts_and_filters(visit):
    page = visit(FOLDER / "tolles_lawson.html")
    # Nothing stands between the heading and the first row.
    parts = ["table.virtual thead", "table.virtual tbody tr"]
    head, first = (explorer(page).locator(part).first.bounding_box() for part in parts)
    assert abs(head["y"] + head["height"] - first["y"]) < 2
    assert explorer(page).locator("table.virtual tbody tr").first.locator("td").count() > 1
    button = explorer(page).locator('[data-sort="improvement_ratio"]')
    button.click()
    shown = lambda: [float(r[3].removesuffix(" ~")) for r in rows(page)]
    up = shown()
    button.click()
    assert up == sorted(up) and shown() == up[::-1] and len(set(up)) == 4
    explorer(page).locator('[data-key="is.lambda"]').select_option("0.025")
    assert [r[1] for r in rows(page)] == ["0.025"]


def test_the_csv_holds_the_values_of_the_store(visit):
    page = visit(FOLDER / "tolles_lawson.html")
    text = download(page, explorer(page).get_by_role("button", name="Download as CSV")).decode()
    of_page = {(float(row["lambda"]), name.split(" [")[0]): float(row[name])
               for row in csv.DictReader(io.StringIO(text)) for name in row
               if name not in ("lambda", "flagged_lines", "lines_held_out", "lines_in_sample")}
    query = "SELECT lambda, metric, value FROM tolles_lawson.scores"
    out = subprocess.run([PROGRAM, "sql", query, "--store", FOLDER / "tolles_lawson", "--format", "csv"],
                         check=True, capture_output=True, text=True).stdout
    of_store = {(float(row["lambda"]), row["metric"]): float(row["value"]) for row in csv.DictReader(io.StringIO(out))}
    assert of_page == of_store and len(of_store) == 12


def test_pictures_parse(visit):
    page = visit(FOLDER / "hostile.html")
    explorer(page).locator("[data-view=curve]").click()
    svg = ElementTree.fromstring(download(page, explorer(page).get_by_role("button", name="Download as SVG")))
    assert svg.tag.endswith("svg") and len(list(svg.iter())) > 10
    png = download(page, explorer(page).get_by_role("button", name="Download as PNG"))
    assert png[:8] == b"\x89PNG\r\n\x1a\n" and png[-8:-4] == b"IEND" and len(png) > 5000


def test_the_address_restores_the_state(visit):
    page = visit(FOLDER / "tolles_lawson.html")
    explorer(page).locator('[data-key="is.lambda"]').select_option("0.025")
    explorer(page).locator("[data-view=curve]").click()
    page.reload()
    assert explorer(page).locator("[data-view=curve]").get_attribute("aria-selected") == "true"
    assert explorer(page).locator('[data-key="is.lambda"]').input_value() == "0.025"
    assert "1 of 4 points" in explorer(page).locator("[role=status]").inner_text()


def test_time_plots_zoom_together(visit):
    page = visit(FOLDER / "navigation.html")
    panel = page.locator(".panel:visible").filter(has=page.locator("svg.plot")).first
    plots = panel.locator("svg.plot")
    plot = plots.first
    plot.scroll_into_view_if_needed()
    all_of = lambda: plots.evaluate_all("all => all.map((p) => p.dataset.shown)")
    full = all_of()
    twins = [i for i, shown in enumerate(full) if shown == full[0]]
    assert len(twins) > 1

    def zoomed():
        now = all_of()
        assert now[0] != full[0] and all(now[i] == now[0] for i in twins)
        return [float(x) for x in now[0].split()]

    def reset(key):
        page.keyboard.press(key)
        assert all_of() == full

    box = plot.bounding_box()
    middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    plot.focus()
    page.mouse.move(*middle)
    page.mouse.wheel(0, -100)
    page.wait_for_function("([svg, shown]) => svg.dataset.shown !== shown", arg=[plot.element_handle(), full[0]])
    low, high = zoomed()
    assert float(full[0].split()[0]) < low < high < float(full[0].split()[1])
    reset("0")
    page.mouse.down()
    page.mouse.move(middle[0] + 80, middle[1], steps=4)
    page.mouse.up()
    zoomed()
    reset("Escape")
    page.keyboard.press("+")
    zoomed()
    page.mouse.dblclick(*middle)
    assert all_of() == full


@pytest.mark.parametrize("name", ["tolles_lawson", "navigation", "hostile"])
@pytest.mark.parametrize("width,scheme", [(390, "dark"), (1400, "light")])
def test_pages_are_accessible_and_fit(visit, name, width, scheme):
    page = visit(FOLDER / f"{name}.html", width, scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    found = Axe().run(page).response["violations"]
    assert [(v["id"], [n["html"][:120] for n in v["nodes"][:3]]) for v in found] == []


@pytest.mark.parametrize("name", ["tolles_lawson", "navigation"])
def test_labels_are_readable_on_a_phone(visit, name):
    page = visit(FOLDER / f"{name}.html", 390)
    small = page.evaluate("""() => [...document.querySelectorAll("svg text")].flatMap((text) => {
        const svg = [...document.querySelectorAll("svg")].findLast((s) => s.contains(text) && s.viewBox.baseVal.width
            && !s.parentElement.closest("svg"));
        if (!svg || !text.getClientRects().length) return [];
        const size = parseFloat(getComputedStyle(text).fontSize) * svg.getBoundingClientRect().width
            / svg.viewBox.baseVal.width;
        return size < 10.9 ? [[text.textContent, size, svg.getAttribute("class")]] : [];
    })""")
    assert small == []


def test_hostile_names_stay_text(visit):
    page = visit(FOLDER / "hostile.html")
    assert page.locator("#injected").count() == 0
    options = explorer(page).locator('[data-key="is.kept"] option')
    values = options.evaluate_all("all => all.map((o) => [o.value, o.text])")
    assert AXIS in [value for value, _ in values]
    assert AXIS.replace("\u202e", "\\u202e") in [text for _, text in values]
    explorer(page).locator("[data-view=lines]").click()
    page.locator("section.explorer svg").focus()
    texts = []
    for _ in range(2):
        page.keyboard.press("ArrowRight")
        texts.append(explorer(page).locator("output").inner_text())
    assert any(LINE.replace("\u202e", "\\u202e") in text for text in texts), texts
    assert page.locator("#injected").count() == 0
