#!/usr/bin/env python3
"""Runs the commands of the pages and compares their output with the pages.

python3 check.py [--rewrite] [--times] PROGRAM PAGE...

PROGRAM is the program `magline`. The commands of a page run in order, in a temporary folder with a copy of `datasets/`.

- A fenced block `console` holds commands (`$ `, continued by `> `) and their output, standard output and standard error
  together. In the output, `...` stands in place of any characters of a line; a line `...`, of any lines. Both are for
  times, paths and long output.
- A block with `:caption: NAME` is written to the file NAME. With `:caption: NAME (addition)` it is appended.
- If a command writes a file with the name of a picture of the page, the file and the picture must be equal.

`--rewrite` writes output and pictures into the pages; `...` is kept where it still matches. `--times` prints the time
of each command.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

DOCS = Path(__file__).resolve().parent
REPOSITORY = DOCS.parent.parent
BLOCK = re.compile(r"(?ms)^(?P<fence>```+)(?P<info>[^\n`]*)\n(?P<body>.*?)^(?P=fence)[ ]*$")
# Progress depends on the speed of the machine.
PROGRESS = re.compile(r"^\d+:\d\d [a-z]")


def steps(body: str) -> list[tuple[str, str]]:
    """Returns the commands of a block, each with its expected output."""
    found: list[tuple[list[str], list[str]]] = []
    for line in body.splitlines():
        if line.startswith("$ "):
            found.append(([line[2:]], []))
        elif line.startswith("> ") and found and not found[-1][1]:
            found[-1][0].append(line[2:])
        elif found:
            found[-1][1].append(line)
        else:
            raise SystemExit(f"error: a console block begins with `{line}`; the first line is a command, `$ ...`")
    return [("\n".join(command), "\n".join(output)) for command, output in found]


def matches(expected: str, actual: str) -> bool:
    pattern = ""
    for line in expected.splitlines():
        # A line of three dots stands in place of any lines.
        pattern += r"(?:.*\n)*?" if line == "..." else re.escape(line).replace(r"\.\.\.", ".*?") + r" *\n"
    return re.fullmatch(pattern, actual) is not None


def run(command: str, folder: Path) -> tuple[str, int]:
    path = f"{folder / '.bin'}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "LC_ALL": "C.UTF-8", "COLUMNS": "120", "NO_COLOR": "1"}
    done = subprocess.run(["bash", "-c", command], cwd=folder, env=environment, stdin=subprocess.DEVNULL,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=300)
    lines = [line.rstrip() for line in done.stdout.decode("utf-8").splitlines() if not PROGRESS.match(line)]
    # A page does not show blank lines at the end.
    while lines and not lines[-1]:
        lines.pop()
    return "".join(line + "\n" for line in lines), done.returncode


def check(page: Path, program: str, rewrite: bool, times: bool = False) -> list[str]:
    text = page.read_text(encoding="utf-8")
    faults: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(REPOSITORY / "datasets", folder / "datasets", ignore=shutil.ignore_patterns("store", "target"))
        shutil.copytree(DOCS, folder / "pipeline" / "docs", ignore=shutil.ignore_patterns("__pycache__"))
        (folder / ".bin").mkdir()
        (folder / ".bin" / "magline").symlink_to(program)

        def block(match: re.Match[str]) -> str:
            info, body = match["info"].strip(), match["body"]
            caption = re.match(r":caption: ([\w./-]+)( \(addition\))?\n\n?", body)
            # The README has no captions, which GitHub would show as text.
            caption = caption or re.match(r"# ([\w.-]+\.(?:py|toml))()\n", body)
            if caption:
                file = folder / caption[1]
                file.parent.mkdir(parents=True, exist_ok=True)
                with file.open("a" if caption[2] else "w", encoding="utf-8") as to:
                    to.write(body[caption.end():])
            if info not in ("console", "{code-block} console"):
                return match.group()
            new = ""
            for command, expected in steps(body):
                start = time.monotonic()
                actual, status = run(command, folder)
                if times:
                    print(f"{time.monotonic() - start:7.1f} s  {command.splitlines()[0]}")
                same = matches(expected, actual)
                line = text.count("\n", 0, match.start()) + 1
                if not same:
                    faults.append(f"{page}:{line}: $ {command}\n--- page\n{expected}\n--- output\n{actual}")
                # A page may show an error, but `...` does not stand in place of one.
                if status != 0 and "error:" not in expected:
                    faults.append(f"{page}:{line}: $ {command}\nexit status {status}\n{actual}")
                shown = expected + "\n" if same and expected else actual
                new += "$ " + command.replace("\n", "\n> ") + "\n" + shown
            # Output with a fence of its own needs a longer fence around it.
            inner = max((len(fence) for fence in re.findall(r"(?m)^`{3,}", new)), default=0)
            fence = "`" * max(len(match["fence"]), inner + 1 if inner else 0)
            return f"{fence}{match['info']}\n{new}{fence}"

        new = BLOCK.sub(block, text)
        for target in re.findall(r"!\[[^\]]*\]\(([^)\s]+)\)", text):
            made, kept = folder / Path(target).name, page.parent / target
            if not made.is_file():
                faults.append(f"{page}: no command of the page writes the picture `{target}`")
            elif rewrite:
                kept.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(made, kept)
            elif not kept.is_file() or made.read_bytes() != kept.read_bytes():
                faults.append(f"{page}: the picture `{target}` differs from the file that the command writes")
        if rewrite:
            page.write_text(new, encoding="utf-8")
    return faults


def main() -> int:
    arguments = [a for a in sys.argv[1:] if a not in ("--rewrite", "--times")]
    if len(arguments) < 2:
        raise SystemExit(__doc__)
    program, failed = os.path.abspath(arguments[0]), 0
    for page in map(Path, arguments[1:]):
        faults = check(page, program, "--rewrite" in sys.argv, "--times" in sys.argv)
        failed += len(faults)
        print("\n".join(faults) if faults else f"{page}: as printed")
    if failed and "--rewrite" not in sys.argv:
        print(f"{failed} differences; `python3 pipeline/docs/check.py --rewrite PROGRAM PAGE` updates a page")
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
