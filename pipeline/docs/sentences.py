#!/usr/bin/env python3
"""Prints sentences of the repository at random, for a cold reading: sentences.py SET [SEED [COUNT]]

SET is `readme`, `reference`, `pages`, `tutorials`, `how-to`, `messages` or `comments`. `pages` are the tutorials,
how-tos, explanations, the gallery and the dictionaries. `messages` are the strings of the Rust sources that contain a
sentence, `comments` the comments of the Rust sources. A reader who has never seen the project marks each sentence that
needs a second reading. The same seed gives the same sentences.
"""

import random
import re
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent.parent
PAGES = {
    "tutorials": ["pipeline/docs/tutorials"],
    "how-to": ["pipeline/docs/how-to"],
    "readme": ["README.md", "pipeline/python/README.md"],
    "reference": ["stages/REFERENCE.md", "pipeline/docs/reference"],
    "pages": [f"pipeline/docs/{kind}" for kind in ("tutorials", "how-to", "explanation", "gallery", "coming-from")],
}
WORDS = 5


def files(paths: list[str], suffix: str) -> list[str]:
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard", "--", *paths], cwd=REPOSITORY,
                            capture_output=True, text=True, check=True).stdout.splitlines()
    return sorted(file for file in listed if file.endswith(suffix) and (REPOSITORY / file).is_file())


def sentences(paragraph: str) -> list[str]:
    parts = re.split(r"(?<=[.?!])\s+(?=[A-Z`\[*])", " ".join(paragraph.split()))
    return [part for part in parts if len(part.split()) >= WORDS]


def prose(text: str) -> list[str]:
    """Returns the sentences of a page, without code, equations, headings and pictures. A cell is a paragraph."""
    text = re.sub(r"(?ms)^\$\$ .*?\$\$$", "\n\n", text)
    text = re.sub(r"(?ms)^ *(```+|~~~+).*?^ *\1 *$", "\n\n", text)
    text = re.sub(r"(?m)^(#|:|!\[).*$|<!--.*?-->", "\n", text)
    text = re.sub(r"(?m)^ *(?:[-*]|\d+\.) ", "\n\n", text)
    text = re.sub(r"(?m)^\|(.*)$", lambda row: "\n\n" + re.sub(r"(?<!\\)\|", "\n\n", row[1]), text)
    return [s for paragraph in re.split(r"\n\s*\n", text) for s in sentences(paragraph)]


def sources() -> list[str]:
    found = files(["."], ".rs")
    return [f for f in found if "/tests/" not in f"/{f}" and "/benches/" not in f and not f.endswith("tests.rs")]


def comments(text: str) -> list[str]:
    blocks = re.findall(r"(?m)(?:^ *//[/!]? ?.*\n)+", text)
    return [s for block in blocks for s in prose(re.sub(r"(?m)^ *//[/!]? ?", "", block))]


def messages(text: str) -> list[str]:
    text = re.sub(r"(?m)^ *//.*$", "", text.split("#[cfg(test)]")[0])
    text = re.sub(r"""b?'(?:[^'\\]|\\.)'""", " ", text)
    found = [re.sub(r"\\\n\s*", "", s) for s in re.findall(r'"((?:[^"\\]|\\.)*)"', text, re.S)]
    return [s for string in found if not re.search(r"(?i)select |\\n|\n|[<>{}]{2}", string) for s in sentences(string)]


def collected(kind: str) -> list[tuple[str, str]]:
    """Returns the sentences of a set, each with its file."""
    if kind in PAGES:
        listed, reader = files(PAGES[kind], ".md"), prose
    else:
        listed, reader = sources(), {"messages": messages, "comments": comments}[kind]
    return [(file, s) for file in listed for s in reader((REPOSITORY / file).read_text(encoding="utf-8"))]


def main() -> int:
    kind, numbers = sys.argv[1], [int(value) for value in sys.argv[2:]]
    seed, count = [*numbers, *[1, 100][len(numbers):]]
    found = collected(kind)
    print(f"{len(found)} sentences, seed {seed}")
    for number, (file, sentence) in enumerate(random.Random(seed).sample(found, min(count, len(found))), 1):
        print(f"{number:3} {Path(file).name}: {sentence}")
    return 0


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3, 4) or sys.argv[1] not in (*PAGES, "messages", "comments"):
        raise SystemExit(__doc__)
    raise SystemExit(main())
