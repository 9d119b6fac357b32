"""Tests of the first paint of `magline view`: the page is shown before any answer about the store."""

import json

from conftest import line_view, until

FIRST_PAINT = "performance.getEntriesByName('first-contentful-paint').length"


def test_the_page_is_painted_before_any_answer_about_the_store(visit, view):
    address = view("cabin")
    page = visit(address)
    page.goto("about:blank")
    held, released = [], []
    page.route("**/api/**", lambda route: route.continue_() if released else held.append(route))
    page.goto(address, wait_until="commit")
    until(page, FIRST_PAINT)
    assert page.locator("h1").inner_text() == "cabin"
    note = page.locator("#sections")
    assert note.is_visible() and "loading" in note.inner_text()
    assert page.locator("section.explorer, #against").count() == 0
    until(page, "document.readyState === 'complete'")
    asked = [route.request.url.split("/api/")[1] for route in held]
    # Neither scores nor lines are asked for before the list of tables is known.
    assert {"sections", "catalogue", "run"} == {name.split("?")[0] for name in asked}
    released.append(True)
    for route in held:
        route.continue_()
    page.locator("section.explorer table.virtual").first.wait_for()
    line_view(page)
    assert note.is_hidden() and page.locator("#against").count() == 1
    assert page.locator("footer [data-run=cabin]").inner_text() != ""
    titles = page.locator("main > section > h2").all_inner_texts()
    assert titles == ["Run", "Explore: cabin.scores", "Compare runs", "Lines", "Models", "Maps", "Lineage"]


def test_the_page_says_that_the_plan_is_being_made(visit, view):
    page = visit(view("cabin"))
    line_view(page)
    asked = []

    def run(route):
        found = route.fetch().json()
        asked.append(found["state"])
        if len(asked) <= 2:
            found = {**found, "state": "planning", "units": {"done": 0, "failed": 0, "total": 0}, "tables": [],
                     "failures": [], "best": []}
        route.fulfill(body=json.dumps(found), content_type="application/json")

    page.route("**/api/run", run)
    page.reload()
    status = page.locator("#live [role=status]")
    until(page, "document.querySelector('#live [role=status]').textContent.startsWith('The plan of the spec is')")
    assert "units" not in status.inner_text()
    until(page, "document.querySelector('#live [role=status]').textContent.includes('units')")


def test_a_table_that_is_published_later_gets_its_section(visit, view):
    page = visit(view("cabin"))
    line_view(page)
    asked = []

    def sections(route):
        asked.append(1)
        if len(asked) == 1:
            route.fulfill(json={"scores": [], "runs": [{"pipeline": "<b>evil", "run": "<i>0"}]})
        else:
            route.continue_()

    page.route("**/api/sections", sections)
    page.reload()
    until(page, "document.querySelector('#sections').hidden")
    assert page.locator("section.explorer").count() == 0
    assert "<i>0 of <b>evil" in page.locator("footer").inner_text()
    page.evaluate("document.dispatchEvent(new CustomEvent('magline:changed'))")
    page.locator("section.explorer table.virtual").wait_for()
    assert page.locator("footer [data-run=cabin]").count() == 1
