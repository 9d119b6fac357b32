"""Tests of training curves and importance in `magline view`, against the tables in the store."""

import csv
import io
import os
import subprocess

import pytest
from axe_playwright_python.sync_playwright import Axe
from conftest import FOLDER, download, until
from specs import LINE

HOME = "#models"


def stored(query):
    command = [os.environ["MAGLINE"], "sql", query, "--store", FOLDER / "pair", "--format", "csv"]
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return list(csv.DictReader(io.StringIO(text)))


def choose(page, table):
    page.locator(f"{HOME} [data-key=table]").select_option(table)
    page.locator(f"{HOME} figure svg").wait_for()
    text = download(page, page.locator(HOME).get_by_role("button", name="Download as CSV")).decode()
    return list(csv.DictReader(io.StringIO(text)))


@pytest.fixture
def page(visit, view):
    page = visit(view("pair"))
    page.locator(f"{HOME} [data-key=table] option").nth(1).wait_for(state="attached")
    return page


def test_the_losses_of_a_training_are_those_of_the_model(page):
    found = choose(page, "second.network")
    query = "SELECT term, value FROM second.network WHERE term LIKE 'epoch_{}[%'"
    for kind in ("training", "validation"):
        known = {int(row["term"].split("[")[1].rstrip("]")): float(row["value"]) for row in stored(query.format(kind))}
        assert {int(row["epoch"]): float(row[kind]) for row in found} == known and len(known) == 12
    least = min(found, key=lambda row: float(row["validation"]))
    assert f"in epoch {least['epoch']}." in page.locator(f"{HOME} figcaption").inner_text()
    assert page.locator(f"{HOME} path[data-curve]").count() == 2
    page.locator(f"{HOME} svg").focus()
    page.keyboard.press("ArrowRight")
    assert page.locator(f"{HOME} output").inner_text().startswith("epoch 1: ")


def test_the_importance_of_inputs_is_that_of_the_table(page):
    found = choose(page, "second.matters")
    rows = stored('SELECT "group", line, value FROM second.matters')
    known = {(row["group"], row["line"]): abs(float(row["value"])) for row in rows}
    assert {(row["group"], row["line"]): float(row["importance"]) for row in found} == known
    assert any(line == LINE for _, line in known) and page.locator("#injected").count() == 0
    # The most important group is first; a dot for each line.
    groups = {}
    for (group, _), value in known.items():
        groups.setdefault(group, []).append(value)
    best = max(groups, key=lambda group: sum(groups[group]) / len(groups[group]))
    assert page.locator(f"{HOME} svg text.name").first.text_content() == best
    assert page.locator(f"{HOME} svg circle.point").count() == sum(map(len, list(groups.values())[:20]))


def test_a_linear_model_says_that_it_has_no_epochs(page):
    page.locator(f"{HOME} [data-key=table]").select_option("linear.coefficients")
    until(page, "document.querySelector('#models').textContent.includes('no losses of epochs')")
    page.locator(f"{HOME} [data-key='p.lambda']").select_option("10")
    until(page, "document.querySelector('#models [role=status]').textContent.includes('lambda = 10')")
    assert "models" in page.evaluate("location.hash")


def test_a_store_without_models_has_no_section(visit, view):
    page = visit(view("charted"))
    page.locator("#maps figure").first.wait_for()
    until(page, "document.querySelector('#models').hidden")


@pytest.mark.parametrize("width,scheme", [(390, "dark"), (1400, "light")])
@pytest.mark.parametrize("table", ["second.network", "second.matters"])
def test_the_models_are_accessible(visit, view, width, scheme, table):
    page = visit(view("pair"), width, scheme)
    page.locator(f"{HOME} [data-key=table] option").nth(1).wait_for(state="attached")
    choose(page, table)
    found = Axe().run(page, context=HOME).response["violations"]
    assert [(v["id"], [n["html"][:120] for n in v["nodes"][:3]]) for v in found] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    if os.environ.get("SCREENSHOTS"):
        page.locator(HOME).screenshot(path=f"{os.environ['SCREENSHOTS']}/models-{table}-{width}-{scheme}.png")
