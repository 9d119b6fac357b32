#!/usr/bin/env python3
"""Checks links, anchors and names of tests in all Markdown pages of the repository, without the network."""

import os
import re
import subprocess
import unicodedata
from functools import cache

from build import GENERATED, INCLUDE, LINK, PAGES, REPOSITORY, outside_code


def anchors(text: str) -> set[str]:
    """Returns the anchors of the headings, as GitHub and MyST form them."""
    found: dict[str, int] = {}

    def headings(part: str) -> str:
        for line in re.findall(r"(?m)^#{1,6} (.*)$", part):
            title = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", line).strip().lower()
            kept = [c for c in title if c in " -_" or unicodedata.category(c)[0] in "LN"]
            name = "".join(kept).replace(" ", "-")
            found[name] = found.get(name, -1) + 1
        return part

    outside_code(text, headings)
    return {name + (f"-{i}" if i else "") for name, most in found.items() for i in range(most + 1)}


def faults(page: str, text: str) -> list[str]:
    missing = []

    def part(content: str) -> str:
        for _, target in LINK.findall(content) + re.findall(r"!(\[[^\]]*\])\(([^)\s]+)\)", content):
            if re.match(r"[a-z]+:", target):
                continue
            path, _, anchor = target.partition("#")
            file = os.path.normpath(os.path.join(os.path.dirname(page), path)) if path else page
            if generated(file):
                continue
            if not (REPOSITORY / file).exists():
                missing.append(f"{page}: [{target}]: no such file")
            elif anchor and file.endswith(".md"):
                known = anchors((REPOSITORY / file).read_text(encoding="utf-8"))
                if anchor not in known:
                    missing.append(f"{page}: [{target}]: no such heading")
        return content

    outside_code(text, part)
    for _, target in INCLUDE.findall(text):
        if not (REPOSITORY / os.path.normpath(os.path.join(os.path.dirname(page), target))).is_file():
            missing.append(f"{page}: [{target}]: no such file")
    return missing


def tests(page: str, text: str) -> list[str]:
    """Returns the tests that a page names and that no source has."""
    named = set(re.findall(r"`((?:val|ref|law|jac)_\w+)`", text))
    return [f"{page}: `{name}`: no such test" for name in sorted(named - sources())] if named else []


@cache
def sources() -> set[str]:
    found = subprocess.run(["git", "grep", "-hoE", r"fn (val|ref|law|jac)_\w+", "--", "*.rs"], cwd=REPOSITORY,
                           capture_output=True, text=True, check=True).stdout
    return {line.removeprefix("fn ") for line in found.splitlines()}


def generated(file: str) -> bool:
    """Whether the build makes the page; Sphinx then checks the link."""
    site = file.removeprefix("pipeline/docs/")
    return site != file and (site in PAGES or site.startswith(GENERATED))


def main() -> int:
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard", "*.md"], cwd=REPOSITORY,
                            capture_output=True, text=True, check=True).stdout.splitlines()
    found = []
    for page in listed:
        # The template of SIMULATOR.md, whose links are relative to that page.
        if (REPOSITORY / page).is_file() and page != "datasets/simulate/src/reference/page.md":
            text = (REPOSITORY / page).read_text(encoding="utf-8")
            found += faults(page, text) + tests(page, text)
    print("\n".join(found) if found else f"{len(listed)} pages: all links lead to a file and a heading")
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())
