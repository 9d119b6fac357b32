"""Ten questions of a researcher, answered in `magline view` with at most three clicks each."""

import os
from itertools import takewhile
from pathlib import Path

import pytest
from conftest import download, line_view, until

MOST = 3
ANSWERS = []
PAGE = Path(__file__).parents[2] / "pipeline/docs/how-to/view.md"
HEAD = "| question | clicks | controls |\n|---|---|---|\n"


class Clicks:
    """Counts the actions of a user: a click, a choice from a list."""

    def __init__(self, page):
        self.page = page
        self.count = 0
        self.steps = []

    def click(self, place, step, **more):
        self.count += 1
        self.steps.append(step)
        place.click(**more)

    def select(self, place, step, **more):
        self.count += 1
        self.steps.append(step)
        place.select_option(**more)


def explorer(page):
    return page.locator("section.explorer").first


def row(page, at):
    return explorer(page).locator("tbody tr:not(.gap)").nth(at).locator("button").first


def best(page, do):
    words = page.locator("#live .figures div").first.inner_text()
    assert "best" in words and "ins_" in words
    return words.replace("\n", "; ")


def best_lambda(page, do):
    do.click(explorer(page).locator("[data-view=curve]"), "*Curve* tab")
    explorer(page).locator(".view circle.best").wait_for()
    return explorer(page).locator("figcaption").inner_text()


def worst_line(page, do):
    mag = explorer(page).locator('[data-key="is.mag"]')
    do.select(mag, "magnetometer 4", value="mag_4_uc")
    do.click(explorer(page).locator("[data-view=lines]"), "*Lines* tab")
    words = explorer(page).locator("figcaption").inner_text()
    line = words.split("Worst: ")[1].split(", line ")[1].split(",")[0]
    svg = explorer(page).locator(".view svg")
    do.click(svg.locator("circle.dot, circle.point").first, "first line of the plot", force=True)
    until(page, "(line) => document.querySelector('#series [role=status]').textContent.includes('line ' + line)", line)
    return page.locator("#series [role=status]").inner_text()


def largest_error(page, do):
    do.click(page.locator("#series").get_by_role("button", name="Largest value of Position error, north"), "max |y|")
    until(page, "document.querySelector('#series .track .note:last-child').textContent.includes('truth')")
    return page.locator("#series .series-key").first.inner_text() + " at " + \
        page.locator("#series .track .note").last.inner_text()


def within_three_sigma(page, do):
    keys = page.locator("#series .series-key").all_inner_texts()
    assert any("sd_n" in key for key in keys) and any("north_error" in key for key in keys)
    return "the panel shows the error and the band of three standard deviations"


def attitude(page, do):
    do.click(page.locator("#series [data-preset=attitude]"), "*Attitude* button")
    until(page, "document.querySelectorAll('#series h3').length > 0 && "
          "[...document.querySelectorAll('#series h3')].some((h) => h.textContent.startsWith('Heading'))")
    return ", ".join(page.locator("#series .panel-figure h3").all_inner_texts())


def compensation(page, do):
    do.click(page.locator("#series [data-preset=compensation]"), "*Compensation* button")
    until(page, "[...document.querySelectorAll('#series .series-key')].some((k) => k.textContent.includes('mag_c'))")
    return ", ".join(page.locator("#series .series-key").all_inner_texts()[:4])


def two_points(page, do):
    do.click(row(page, 0), "click the first point")
    do.click(row(page, 3), "then Shift-click the fourth point", modifiers=["Shift"])
    caption = explorer(page).locator("figcaption").inner_text()
    assert "The axes differ in" in caption
    return caption.split("Bars show")[0]


def failures(page, do):
    do.click(page.locator("#live details summary").first, "kind of failure")
    words = page.locator("#live details").first.inner_text()
    assert "First at" in words
    return words.replace("\n", " ")


def origin(page, do):
    names = page.locator("[data-key=lineage] option").all_inner_texts()
    name = next(n for n in names if n.endswith("track"))
    do.select(page.locator("[data-key=lineage]"), "table *track*", label=name)
    until(page, "(name) => document.querySelector('#lineage h3').textContent.includes(name)", name)
    words = page.locator("#lineage ul.tree").inner_text()
    assert "navigate" in words
    return " / ".join(words.split("\n")[:3])


QUESTIONS = [
    ("How large is the position error at the best point, compared with the error of the INS alone?", best),
    ("Which value of `lambda` is best, and is this value at an end of the axis?", best_lambda),
    ("Which line has the worst score for magnetometer 4, and what happened on this line?", worst_line),
    ("At what time, and where on the map, is the position error on this line largest?", largest_error),
    ("Does the position error stay within three standard deviations?", within_three_sigma),
    ("Does the error depend on the attitude of the aircraft?", attitude),
    ("How well does compensation remove the aircraft field?", compensation),
    ("What differs between two points, and which point is better?", two_points),
    ("What failed, how often, and why?", failures),
    ("From which files and stages does the track come?", origin),
]


@pytest.mark.parametrize("question,ask", QUESTIONS, ids=[ask.__name__ for _, ask in QUESTIONS])
def test_a_question_takes_at_most_three_clicks(visit, view, question, ask):
    page = visit(view("cabin"))
    explorer(page).locator("table.virtual").wait_for()
    line_view(page)
    page.locator("#live .figures div").first.wait_for()
    page.locator("#lineage ul.tree").wait_for()
    do = Clicks(page)
    answer = ask(page, do)
    assert do.count <= MOST
    ANSWERS.append((question, do.count, ", ".join(do.steps) or "none", " ".join(answer.split())))


def test_the_documentation_lists_the_questions():
    """Prints the table with the answers. `REWRITE` writes the table of the documentation."""
    escaped = lambda text: text.replace("|", "\\|")
    for q, n, steps, answer in ANSWERS:
        print(f"| {q} | {n} | {escaped(steps)} | {escaped(answer[:160])} |")
    assert len(ANSWERS) == len(QUESTIONS)
    table = "".join(f"| {q} | {n} | {escaped(steps)} |\n" for q, n, steps, _ in ANSWERS)
    before, rest = PAGE.read_text(encoding="utf-8").split(HEAD)
    known = "".join(takewhile(lambda line: line.startswith("|"), rest.splitlines(keepends=True)))
    if os.environ.get("REWRITE"):
        PAGE.write_text(before + HEAD + table + rest[len(known):], encoding="utf-8")
    else:
        assert known == table, "run `.ci/browser PROGRAM --rewrite`"
