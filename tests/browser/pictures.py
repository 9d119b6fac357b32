"""Pictures of the report and the view at three widths and in two themes, compared with stored references.

A picture is the first part of each section, reduced to a quarter of its size. A pixel differs if a channel differs by
more than `LEVEL`. Reduction averages single strokes of letters, so another renderer or another version of a font moves
few pixels by so much. A section fails if its height changes, or more than `SHARE` of its pixels differ.
`.ci/browser PROGRAM --rewrite` writes the references. Look at each of them before a commit.
"""

import io
import json
import os
from pathlib import Path

import pytest
from conftest import FOLDER, line_view, until
from PIL import Image, ImageChops
from PIL.PngImagePlugin import PngInfo

REFERENCES = Path(__file__).parent / "pictures"
WIDTHS, SCHEMES = [390, 768, 1400], ["light", "dark"]
CASES = [(name, width, scheme) for name in ["report", "view"] for width in WIDTHS for scheme in SCHEMES]

# Height of the part of a section in a picture, px.
PART = 1400
# One pixel of a picture, px.
REDUCTION = 4
# Largest change of a channel, of 255, of a pixel that counts as equal.
LEVEL = 40
# Largest share of differing pixels, and largest relative change of a height.
SHARE, HEIGHT = 0.03, 0.06
# Differences of a few rows count as equal, px.
ROWS = 12

# Texts of one run: time, duration, hash, folder.
FIXED = """() => {
    const all = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    const texts = [];
    while (all.nextNode()) texts.push(all.currentNode);
    for (const node of texts) {
        const text = node.textContent
            .replace(/\\d{4}-\\d\\d-\\d\\d[T ]\\d\\d:\\d\\d(:\\d\\d)?Z?/g, "2026-01-01T00:00:00Z")
            .replace(/, [\\d.]+ s\\./g, ", 1 s.").replace(/\\b[0-9a-f]{12,}\\b/g, "0123456789abcdef")
            .replace(/(\\/[\\w.+-]+)+\\/(?=[\\w.+-]+)/g, "folder/");
        if (text !== node.textContent) node.textContent = text;
    }
}"""
# The fonts of Debian's package fonts-dejavu-core, which the tests install, in place of those of the system.
FONTS = """body, svg { font-family: "DejaVu Sans" !important; }
code, pre { font-family: "DejaVu Sans Mono" !important; }
* { caret-color: transparent !important; }"""
SECTIONS = """() => [...document.querySelectorAll("main > header, main section, main > .trouble")]
    .filter((s) => s.getClientRects().length && !s.parentElement.closest("section"))
    .map((s, i) => [s.id || s.className || s.tagName, i])"""
BOX = """(at) => {
    const all = [...document.querySelectorAll("main > header, main section, main > .trouble")]
        .filter((s) => s.getClientRects().length && !s.parentElement.closest("section"));
    all[at].scrollIntoView({ block: "start", behavior: "instant" });
    const box = all[at].getBoundingClientRect();
    return [box.top, box.height];
}"""


class Picture:
    """Sections of a page: names, full heights in px, and reduced images."""

    def __init__(self, sections):
        self.sections = sections

    @classmethod
    def of_page(cls, page, width):
        page.add_style_tag(content=FONTS)
        page.set_viewport_size({"width": width, "height": PART})
        page.evaluate("document.fonts.ready.then(() => new Promise((done) => requestAnimationFrame("
                      "() => requestAnimationFrame(done))))")
        # Panels are drawn again for the new font.
        page.wait_for_timeout(600)
        page.evaluate(FIXED)
        sections = []
        for name, at in page.evaluate(SECTIONS):
            top, height = page.evaluate(BOX, at)
            # At the end of the page, a section cannot reach the top of the window.
            top, seen = max(top, 0), max(1, min(height, PART - max(top, 0)))
            png = page.screenshot(clip={"x": 0, "y": top, "width": width, "height": seen}, animations="disabled")
            image = Image.open(io.BytesIO(png)).convert("RGB")
            size = (max(1, image.width // REDUCTION), max(1, image.height // REDUCTION))
            sections.append((name, height, image.resize(size, Image.Resampling.BOX)))
        return cls(sections)

    @classmethod
    def read(cls, path):
        image = Image.open(path)
        known = json.loads(image.text["sections"])
        image, at, sections = image.convert("RGB"), 0, []
        for name, height, rows in known:
            sections.append((name, height, image.crop((0, at, image.width, at + rows))))
            at += rows
        return cls(sections)

    def write(self, path):
        images = [image for *_, image in self.sections]
        whole = Image.new("RGB", (max(i.width for i in images), sum(i.height for i in images)))
        at = 0
        for image in images:
            whole.paste(image, (0, at))
            at += image.height
        about = PngInfo()
        about.add_text("sections", json.dumps([[name, round(height), image.height]
                                               for name, height, image in self.sections]))
        path.parent.mkdir(exist_ok=True)
        whole.quantize(128, dither=Image.Dither.NONE).save(path, optimize=True, pnginfo=about)

    def differences(self, known):
        """Sections that differ from those of another picture, each with the reason."""
        names = [[name for name, *_ in picture.sections] for picture in (self, known)]
        if names[0] != names[1]:
            return [f"sections {names[0]} instead of {names[1]}"]
        found = []
        for (name, height, image), (_, own, other) in zip(self.sections, known.sections):
            if abs(height - own) > max(ROWS, HEIGHT * own):
                found.append(f"{name}: height {height:.0f} px instead of {own:.0f} px")
                continue
            other = other.resize(image.size, Image.Resampling.BOX)
            most = ImageChops.difference(image, other).split()
            most = ImageChops.lighter(ImageChops.lighter(most[0], most[1]), most[2])
            share = sum(most.histogram()[LEVEL + 1:]) / (image.width * image.height)
            if share > SHARE:
                found.append(f"{name}: {100 * share:.1f} % of the pixels differ")
        return found


def opened(visit, view, name, width, scheme):
    """The page when everything is drawn."""
    if name == "report":
        page = visit(FOLDER / "cabin.html", width, scheme, motion="reduce", trusted=True)
        line_view(page)
    else:
        page = visit(view("cabin"), width, scheme, motion="reduce", trusted=True)
        page.locator("section.explorer table.virtual tbody tr").first.wait_for()
        page.locator("#live .figures div").first.wait_for()
        page.locator("#lineage ul.tree li").first.wait_for()
        page.locator("#maps .map-frame canvas").nth(1).wait_for()
        line_view(page)
    until(page, "document.querySelectorAll('#series .track canvas').length > 0")
    page.wait_for_timeout(500)
    return page


@pytest.mark.parametrize("name,width,scheme", CASES)
def test_the_page_looks_like_its_reference(visit, view, name, width, scheme):
    picture = Picture.of_page(opened(visit, view, name, width, scheme), width)
    path = REFERENCES / f"{name}-{width}-{scheme}.png"
    if os.environ.get("REWRITE"):
        picture.write(path)
    found = picture.differences(Picture.read(path))
    if found and os.environ.get("SCREENSHOTS"):
        picture.write(Path(os.environ["SCREENSHOTS"]) / path.name)
    assert found == [], f"look at {path.name}, then write it again with `.ci/browser PROGRAM --rewrite`"


# Rules of the style sheet, by their selectors. Without any of them, the page looks different.
RULES = ["body[data-api] main", ".controls", ".tabs button", "th, td", ".line-grid"]
REMOVE = """(selector) => {
    let removed = 0;
    const search = (list) => {
        for (let i = list.cssRules.length - 1; i >= 0; i--) {
            if (list.cssRules[i].selectorText === selector) { list.deleteRule(i); removed++; }
            else if (list.cssRules[i].cssRules?.length) search(list.cssRules[i]);
        }
    };
    for (const sheet of document.styleSheets) search(sheet);
    return removed;
}"""
# Changes of a renderer or a font.
HARMLESS = {
    "letters 0.5 % wider": "* { letter-spacing: 0.03px !important; }",
    "letters of another weight": "body { -webkit-text-stroke: 0.15px; }",
    "letters a quarter of a pixel lower": "main { position: relative; top: 0.25px; }",
}


@pytest.mark.parametrize("rule", RULES)
def test_a_page_without_a_rule_differs(visit, view, rule):
    page = opened(visit, view, "view", 1400, "light")
    assert page.evaluate(REMOVE, rule) > 0
    assert Picture.of_page(page, 1400).differences(Picture.read(REFERENCES / "view-1400-light.png")) != []


@pytest.mark.parametrize("change", HARMLESS)
def test_another_renderer_makes_no_difference(visit, view, change):
    page = opened(visit, view, "view", 1400, "light")
    page.add_style_tag(content=HARMLESS[change])
    assert Picture.of_page(page, 1400).differences(Picture.read(REFERENCES / "view-1400-light.png")) == []


def test_the_references_are_small():
    files = list(REFERENCES.glob("*.png"))
    assert len(files) == len(CASES) and sum(file.stat().st_size for file in files) < 1_500_000
