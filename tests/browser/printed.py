"""Tests of the printed page in Chromium: complete, opened, within the paper, without controls."""

import json
import os
import re

import pytest
from conftest import FOLDER, line_view, until

# Width of A4 between margins of 1 cm, px.
PAPER = 718
CONTROLS = """button.plain, button.second, .tabs, .controls, .downloads, .read, .hint, label.check, details.columns,
    select, input"""


def on_paper(page):
    page.emulate_media(media="print")
    until(page, "document.querySelector('.on-paper') !== null")
    page.set_viewport_size({"width": PAPER, "height": 1000})
    page.wait_for_timeout(500)


def visible(page, selector):
    """Texts of the elements that have an area on the paper."""
    return page.evaluate("""(selector) => [...document.querySelectorAll(selector)].filter((e) => {
        const box = e.getBoundingClientRect();
        return box.width > 1 && box.height > 1 && e.checkVisibility();
    }).map((e) => e.tagName + " " + e.className + " " + e.textContent.slice(0, 40))""", selector)


def beyond(page):
    """Tables, plots and texts that extend beyond the paper, or that their frame cuts."""
    return page.evaluate("""(paper) => [...document.querySelectorAll("table, td, th, svg, canvas, p, pre, figure, h2")]
        .filter((e) => {
            const box = e.getBoundingClientRect(), style = getComputedStyle(e);
            if (!e.checkVisibility() || !box.width || e.closest("svg svg, .unseen, .map-over")) return false;
            return box.left < -1 || box.right > paper + 1
                || (style.overflowX !== "visible" && e.scrollWidth > e.clientWidth + 2 && !e.matches("svg, canvas"));
        }).map((e) => [e.tagName, e.className.toString(), e.textContent.slice(0, 30),
            Math.round(e.getBoundingClientRect().right)])""", PAPER)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", ["cabin", "navigation", "hostile"])
def test_a_printed_report_is_complete(visit, name, scheme):
    page = visit(FOLDER / f"{name}.html", 1400, scheme)
    closed = page.locator("details:not([open])").count()
    panels = page.locator(".panels > .panel").count()
    assert closed > 1 and page.locator(".panels > .panel:visible").count() <= panels
    line_view(page)
    on_paper(page)
    heads = page.locator("main h2").all_inner_texts()
    assert len(heads) > 5 and page.locator("main h2:visible").count() == len(heads)
    assert page.locator(".panels > .panel:visible").count() == panels
    assert page.locator("details:not([open]):not(.columns)").count() == 0
    # Nothing below a summary is without height.
    assert page.evaluate("[...document.querySelectorAll('details:not(.columns) > :not(summary)')].every((e) => "
                         "e.getBoundingClientRect().height > 0)")
    assert visible(page, CONTROLS) == []
    assert beyond(page) == []
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    # The track of a report has no map: its ground is light in both themes.
    if page.locator("#series .track").is_visible():
        assert min(page.locator("#series .track canvas").evaluate(
            "c => [...c.getContext('2d').getImageData(3, 3, 1, 1).data].slice(0, 3)")) > 200
    if os.environ.get("SCREENSHOTS"):
        page.screenshot(path=f"{os.environ['SCREENSHOTS']}/print-{name}-{scheme}.png", full_page=True)
    page.emulate_media(media="screen")
    until(page, "!document.querySelector('.on-paper')")
    assert page.locator("details:not([open])").count() == closed
    assert visible(page, CONTROLS)


def test_a_printed_table_has_all_rows(visit, tmp_path):
    html = (FOLDER / "cabin.html").read_text(encoding="utf-8")
    found = re.search(r'(<section class="explorer".*?<script type="application/json">)(.*?)(</script>)', html, re.S)
    block, times = json.loads(found[2]), 50
    block["points"] *= times
    for name in ["at", "values"]:
        block[name] = [column * times for column in block[name]]
    for name in ["flagged", "held_out", "seen"]:
        block[name] *= times
    text = json.dumps(block).replace("<", "\\u003c")
    (tmp_path / "long.html").write_text(html[:found.start(2)] + text + html[found.end(2):], encoding="utf-8")
    page = visit(tmp_path / "long.html")
    rows = page.locator("section.explorer table.virtual tbody tr:not(.gap)")
    assert rows.count() < 100
    on_paper(page)
    assert rows.count() == block["points"] == 300 and page.locator("table.virtual tr.gap").count() == 0
    assert beyond(page) == []
    page.emulate_media(media="screen")
    until(page, "!document.querySelector('.on-paper')")
    assert rows.count() < 100


def test_a_pdf_opens_the_page_and_restores_it(visit):
    page = visit(FOLDER / "navigation.html", 390, "dark")
    closed = page.locator("details:not([open])").count()
    page.evaluate("addEventListener('beforeprint', () => { window.closed_in_print = document.querySelectorAll("
                  "'details:not([open]):not(.columns), .panels > .panel[hidden]').length; })")
    made = page.pdf(format="A4")
    assert made.startswith(b"%PDF") and made.count(b"/Type /Page\n") + made.count(b"/Type /Page ") > 3
    assert page.evaluate("window.closed_in_print") == 0
    assert page.locator("details:not([open])").count() == closed


def test_a_printed_view_fits_the_paper(visit, view):
    page = visit(view("cabin"), 1400, "dark")
    line_view(page)
    page.locator("#maps figure [data-key=layer]").first.wait_for()
    until(page, "document.querySelector('#live [role=status]').textContent.includes('units')")
    on_paper(page)
    assert visible(page, CONTROLS) == [] and beyond(page) == []
    if os.environ.get("SCREENSHOTS"):
        page.screenshot(path=f"{os.environ['SCREENSHOTS']}/print-view.png", full_page=True)
