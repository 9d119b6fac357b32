"""Tests of the pivot of the scores, and of the table of scores on a phone, in Chromium."""

import csv
import io
import json
import os
import re
import subprocess

import pytest
from axe_playwright_python.sync_playwright import Axe
from conftest import FOLDER, download
from specs import AXIS


def explorer(page):
    return page.locator("section.explorer").first


def open_pivot(page):
    explorer(page).locator("[data-view=pivot]").click()
    return explorer(page).locator("table.pivot")


def cells(table):
    """Values, the best value, and texts of a pivot, by row."""
    return table.locator("tbody tr").evaluate_all("""rows => rows.map((r) => [r.querySelector("th").innerText,
        [...r.querySelectorAll("td")].map((c) => [Number(c.dataset.v), c.classList.contains("best"), c.innerText])])""")


def pooled(metric):
    query = f"SELECT mag, lambda, value FROM cabin.scores_pooled WHERE metric = '{metric}'"
    out = subprocess.run([os.environ["MAGLINE"], "sql", query, "--store", FOLDER / "cabin", "--format", "csv"],
                         check=True, capture_output=True, text=True).stdout
    return {(row["mag"], float(row["lambda"])): float(row["value"]) for row in csv.DictReader(io.StringIO(out))}


def test_a_pivot_has_the_scores_of_the_store(visit):
    page = visit(FOLDER / "cabin.html")
    table = open_pivot(page)
    for metric in ["drms", "std_error"]:
        explorer(page).locator('[data-key="metric"]').select_option(metric)
        wanted = pooled(metric)
        columns = [float(c) for c in table.locator("thead tr").last.locator("th").all_inner_texts()[1:]]
        found = {(mag, column): value for mag, row in cells(table) for column, (value, _, _) in zip(columns, row)}
        assert found.keys() == wanted.keys() and len(found) == 6
        assert all(abs(found[key] / value - 1) < 1e-9 for key, value in wanted.items())
        best = [value for _, row in cells(table) for value, marked, _ in row if marked]
        assert best == [min(found.values())]
        text = download(page, explorer(page).get_by_role("button", name="Download as CSV")).decode()
        rows = list(csv.DictReader(io.StringIO(text)))
        of_csv = {(row["mag"], float(re.search(r"lambda = (\S+)$", name)[1])): float(value) for row in rows
                  for name, value in row.items() if name.startswith(metric)}
        assert of_csv == found


def test_the_axes_of_a_pivot_live_in_the_address(visit):
    page = visit(FOLDER / "cabin.html")
    table = open_pivot(page)
    before = cells(table)
    explorer(page).locator('[data-key="x"]').select_option("mag")
    explorer(page).locator('[data-key="y"]').select_option("lambda")
    turned = cells(table)
    assert [[v[0] for v in row] for _, row in turned] == [list(c) for c in zip(*[[v[0] for v in r] for _, r in before])]
    page.reload()
    assert cells(table) == turned
    # One axis: one column.
    explorer(page).locator('[data-key="y"]').select_option("mag")
    assert [len(row) for _, row in cells(table)] == [1, 1]
    by_mag = {mag: min(v for (own, _), v in pooled("drms").items() if own == mag) for mag in ["mag_3_uc", "mag_4_uc"]}
    assert all(abs(row[0][0] / by_mag[mag] - 1) < 1e-9 for mag, row in cells(table))


def test_a_value_in_sample_is_never_the_best_of_a_pivot(visit, tmp_path):
    page = visit(FOLDER / "tolles_lawson.html")
    assert open_pivot(page).locator("tbody td").count() == 4
    assert explorer(page).locator("table.pivot td.best").count() == 0
    assert all(text.endswith("~") for _, row in cells(explorer(page).locator("table.pivot")) for _, _, text in row)
    # The best point of `cabin`, if it were in sample.
    html = (FOLDER / "cabin.html").read_text(encoding="utf-8")
    found = re.search(r'(<section class="explorer".*?<script type="application/json">)(.*?)(</script>)', html, re.S)
    block = json.loads(found[2])
    drms = [m["name"] for m in block["metrics"]].index("drms")
    order = sorted(range(block["points"]), key=lambda row: block["values"][drms][row])
    block["in_sample"][drms] = [order[0]]
    text = json.dumps(block).replace("<", "\\u003c")
    (tmp_path / "changed.html").write_text(html[:found.start(2)] + text + html[found.end(2):], encoding="utf-8")
    table = open_pivot(changed := visit(tmp_path / "changed.html"))
    shown = [cell for _, row in cells(table) for cell in row]
    assert [v for v, marked, _ in shown if marked] == [block["values"][drms][order[1]]]
    assert [v for v, _, text in shown if text.endswith("~")] == [block["values"][drms][order[0]]]
    # The best of a row and the best over several points skip it too.
    explorer(changed).locator('[data-key="y"]').select_option("lambda")
    values = {v for _, row in cells(table) for v, _, _ in row}
    assert block["values"][drms][order[0]] not in values or not any(
        block["at"][1][row] == block["at"][1][order[0]] for row in order[1:])


def test_a_point_is_chosen_in_a_pivot_by_keyboard(visit):
    page = visit(FOLDER / "cabin.html")
    button = open_pivot(page).locator("tbody button").nth(1)
    words = button.get_attribute("aria-label")
    button.focus()
    page.keyboard.press("Enter")
    chosen = explorer(page).locator("[role=status]").inner_text().split("Chosen: ")[1].split(". ")[0].rstrip(".")
    assert chosen in words
    assert explorer(page).locator('table.pivot button[aria-pressed="true"]').count() == 1


def test_hostile_names_stay_text_in_a_pivot(visit):
    page = visit(FOLDER / "hostile.html")
    table = open_pivot(page)
    titles = table.locator("th").evaluate_all("all => all.map((h) => h.title)")
    assert AXIS.replace("\u202e", "\\u202e") in titles
    words = table.locator("td button").evaluate_all("all => all.map((b) => b.title)")
    assert any("<b id=injected>" in text for text in words) and not any("\u202e" in text for text in words)
    assert page.locator("#injected").count() == 0
    text = download(page, explorer(page).get_by_role("button", name="Download as CSV")).decode()
    assert AXIS in "".join(cell for row in csv.reader(io.StringIO(text)) for cell in row)


def test_a_narrow_table_begins_with_the_chosen_metric(visit):
    page = visit(FOLDER / "cabin.html", 390)
    heads = lambda: explorer(page).locator("table.virtual thead th").all_inner_texts()
    assert heads()[0] == "point" and heads()[1].startswith("drms") and heads()[2:4] == ["mag", "lambda"]
    seen = explorer(page).locator("table.virtual thead th").nth(1).bounding_box()
    assert 0 <= seen["x"] and seen["x"] + seen["width"] <= 390
    explorer(page).locator('[data-key="metric"]').select_option("std_error")
    assert heads()[1].startswith("std_error") and len(heads()) == len(set(heads())) == 9
    row = explorer(page).locator("table.virtual tbody tr").first
    value = float(row.locator("td").nth(1).get_attribute("data-v"))
    assert value == min(pooled("std_error").values())
    page.set_viewport_size({"width": 1400, "height": 900})
    page.wait_for_function("document.querySelectorAll('table.virtual thead th')[1].textContent === 'mag'")


@pytest.mark.parametrize("width,scheme", [(390, "light"), (390, "dark"), (1400, "light"), (1400, "dark")])
def test_a_pivot_is_accessible_and_fits(visit, width, scheme):
    for name in ["cabin", "hostile", "tolles_lawson"]:
        page = visit(FOLDER / f"{name}.html", width, scheme)
        open_pivot(page).locator("tbody button").first.click()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        found = Axe().run(page, context="section.explorer").response["violations"]
        assert [(v["id"], [n["html"][:120] for n in v["nodes"][:3]]) for v in found] == [], name
        if os.environ.get("SCREENSHOTS"):
            explorer(page).screenshot(path=f"{os.environ['SCREENSHOTS']}/pivot-{name}-{width}-{scheme}.png")
