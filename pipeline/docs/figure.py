#!/usr/bin/env python3
"""Writes one figure of a report as an SVG file.

python3 figure.py REPORT.html LABEL OUTPUT.svg [N]

LABEL is the start of the figure's text for screen readers, such as `Tracks on the map`. The N-th figure with this label
is written, by default the first. The colours are those of the light theme.
"""

import re
import sys
from pathlib import Path


def extract(html: str, label: str, number: int = 1) -> str:
    """Returns the N-th SVG element with this start of its `aria-label`, with the style sheet of the report."""
    starts = list(re.finditer(r'<svg [^>]*aria-label="' + re.escape(label), html))
    start = starts[number - 1] if number <= len(starts) else None
    if start is None:
        labels = sorted(set(re.findall(r'<svg [^>]*aria-label="([^":]*)', html)))
        raise SystemExit(f"error: no figure {number} `{label}` in the report; it has: {'; '.join(labels)}")
    depth = 0
    for tag in re.finditer(r"<svg\b|</svg>", html[start.start():]):
        depth += 1 if tag.group() == "<svg" else -1
        if depth == 0:
            figure = html[start.start():start.start() + tag.end()]
            break
    else:
        raise SystemExit(f"error: the figure `{label}` is incomplete")
    style = re.search(r"<style>(.*?)</style>", html, re.S)
    # Media queries set the dark theme and the print layout, which a file of one figure does not need.
    sheet = re.sub(r"@media[^{]*\{(?:[^{}]*\{[^{}]*\})*[^{}]*\}", "", style.group(1)) if style else ""
    used = set(re.findall(r'(?:href="|url\()#([\w-]+)', figure))
    definitions = [found for name in sorted(used) if (found := definition(html, name)) and found not in figure]
    opening, rest = figure.split(">", 1)
    box = re.search(r'viewBox="[\d.-]+ [\d.-]+ ([\d.]+) ([\d.]+)"', opening)
    size = f' width="{box.group(1)}" height="{box.group(2)}"' if box else ""
    paper = '<rect width="100%" height="100%" fill="#fff"/>'
    parts = [opening, f' xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"{size}>',
             "<style>", sheet, "</style>", "<defs>", *definitions, "</defs>", paper, rest]
    return "".join(parts) + "\n"


def definition(html: str, name: str) -> str | None:
    """Returns the element with the given id."""
    start = re.search(rf'<(\w+)\b[^>]*\bid="{re.escape(name)}"[^>]*?(/?)>', html)
    if start is None or start.group(2):
        return start and start.group()
    end = html.find(f"</{start.group(1)}>", start.end())
    return html[start.start():end] + f"</{start.group(1)}>"


if __name__ == "__main__":
    if len(sys.argv) not in (4, 5):
        raise SystemExit(__doc__)
    report, label, output, *number = sys.argv[1:]
    figure = extract(Path(report).read_text(encoding="utf-8"), label, *map(int, number))
    Path(output).write_text(figure, encoding="utf-8")
