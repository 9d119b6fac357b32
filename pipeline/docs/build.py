#!/usr/bin/env python3
"""Builds the site: python3 build.py MAGLINE OUTPUT [SITES]

MAGLINE is the program, OUTPUT the folder of the pages. The source folder OUTPUT/source consists of the pages of this
folder, of other pages of the repository (`PAGES`), and of the reference, which is derived from the program's output.
Links between these pages become links of the site. Links to other files of the repository become downloads.

SITES is a folder with the sites of several versions, such as `0.1.0`. The new site is copied into it, `versions.js`
lists the versions for the version selector, and `index.html` leads to the newest.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import declared
import python_reference
from examples import COMMANDS, FLIGHTS, SYNTHS, Examples, parts

DOCS = Path(__file__).resolve().parent
REPOSITORY = DOCS.parent.parent

# Pages of the repository that are part of the site, by their place on the site.
PAGES = {
    "how-to/serve.md": "pipeline/SERVE.md",
    "how-to/benchmark.md": "datasets/BENCH.md",
    "how-to/extend.md": "stages/CONTRIBUTING.md",
    "explanation/navigation-results.md": "datasets/examples/NAVIGATION.md",
    "explanation/network-results.md": "datasets/examples/NETWORKS.md",
    "explanation/uav.md": "datasets/examples/UAV.md",
    "explanation/presets.md": "datasets/simulate/presets/README.md",
    "explanation/scale.md": "pipeline/SCALE.md",
    "explanation/speed-numerics.md": "stages/numerics/benches/README.md",
    "explanation/speed-pipeline.md": "pipeline/benches/README.md",
    "explanation/security.md": "SECURITY.md",
    "reference/examples.md": "datasets/examples/README.md",
    "reference/samples.md": "datasets/samples/README.md",
    "reference/simulator.md": "datasets/simulate/SIMULATOR.md",
    "reference/mappings.md": "datasets/mappings/README.md",
    "reference/python.md": "pipeline/python/README.md",
    "reference/tasks.md": "pipeline/TASKS.md",
    "reference/job-arrays.md": "datasets/examples/cluster/README.md",
    "reference/cluster.md": "pipeline/CLUSTER.md",
    "reference/schedule.md": "datasets/examples/schedule/README.md",
    "reference/object-stores.md": "pipeline/OBJECTS.md",
    "reference/readers.md": "tests/readers/README.md",
    "reference/glossary.md": "schemas/GLOSSARY.md",
    "reference/bibliography.md": "schemas/BIBLIOGRAPHY.md",
}
SITES = {page: site for site, page in PAGES.items()}
GENERATED = (
    "reference/stages", "reference/models", "reference/filters", "reference/metrics", "reference/formats",
    "reference/commands", "reference/functions", "reference/columns", "reference/units", "reference/example.md",
)

LINK = re.compile(r"(?<!\!)\[((?:[^\[\]`]|`[^`]*`)+)\]\(([^()\s]+)\)")
FENCE = re.compile(r"^ *(```+|~~~+|:::+)")
INCLUDE = re.compile(r"(?m)^(```+\{literalinclude\}) (\S+)$")


def outside_code(text: str, change) -> str:
    """Applies `change` to each stretch of lines outside fenced code."""
    parts, lines, fence = [], [], None
    for line in text.split("\n"):
        mark = FENCE.match(line)
        if fence is None and mark and mark.group(1)[0] != ":":
            parts += [change("\n".join(lines))] if lines else []
            lines, fence = [line], mark.group(1)
        elif fence is not None and mark and line.strip() == fence:
            parts.append("\n".join([*lines, line]))
            lines, fence = [], None
        else:
            lines.append(line)
    parts += [change("\n".join(lines)) if fence is None else "\n".join(lines)] if lines else []
    return "\n".join(parts)


def rewrite(text: str, page: str, site: str) -> str:
    """Returns the text of `page` (a path in the repository) with its links and includes changed for its site path."""
    here = os.path.dirname(site)

    def link(match):
        label, target = match.groups()
        if re.match(r"[a-z]+:|#", target):
            return match.group()
        path, mark, anchor = target.partition("#")
        file = os.path.normpath(os.path.join(os.path.dirname(page), path))
        if file == "stages/REFERENCE.md":
            to, mark, anchor = "reference/stages/index.md", "", ""
        elif file == "README.md":
            to, mark, anchor = "index.md", "", ""
        elif file in SITES:
            to = SITES[file]
        elif file.startswith("pipeline/docs/"):
            to = file.removeprefix("pipeline/docs/")
        elif (REPOSITORY / file).is_file():
            return f"[{label}]({os.path.relpath(REPOSITORY / file, OUTPUT / 'source' / here)})"
        else:
            # Folders are not part of the site.
            return label
        return f"[{label}]({os.path.relpath(to, here or '.')}{mark}{anchor})"

    def include(match):
        file = os.path.normpath(os.path.join(os.path.dirname(page), match.group(2)))
        return f"{match.group(1)} {os.path.relpath(REPOSITORY / file, OUTPUT / 'source' / here)}"

    return INCLUDE.sub(include, outside_code(text, lambda part: LINK.sub(link, part)))


# Stages whose names are also names of columns or of corrections.
AMBIGUOUS = {"diurnal", "lag", "magnitude", "select"}


def reference_pages() -> dict[str, str]:
    """Returns the pages of the names that mean one thing only: metrics, and stages and filters that are no keys."""
    keys = set(re.findall(r"(?m)^\| `(\w+)` \| (?:text|list|number|table|boolean|whole)", REFERENCE))
    pages = {name: f"reference/{kind}s/{name}.md" for kind, name, _ in parts(REFERENCE)}
    table = re.search(r"(?m)^\| metric \|.*\n\|-.*\n((?:\|.*\n)+)", REFERENCE)[1]
    pages |= {name: f"reference/metrics/{name}.md" for name in re.findall(r"(?m)^\| `(\w+)`", table)}
    return {name: page for name, page in pages.items() if name not in keys | AMBIGUOUS}


def explained(text: str, site: str, pages: dict[str, str]) -> str:
    """Links the first use of each name of the reference on a page, outside code, headings, tables and other links."""
    here, seen = os.path.dirname(site), set()

    def line(text: str) -> str:
        if text.startswith(("#", "|", ":")):
            return text
        pieces = re.split(r"(\[[^\]]*\](?:\([^)]*\))?)", text)
        for i in range(0, len(pieces), 2):
            pieces[i] = re.sub(r"(?<!`)`(\w+)`(?!`)", name, pieces[i])
        return "".join(pieces)

    def name(match: re.Match[str]) -> str:
        page = pages.get(match[1])
        if page is None or match[1] in seen:
            return match.group()
        seen.add(match[1])
        return f"[`{match[1]}`]({os.path.relpath(page, here)})"

    # Blocks of text, so that a link over two lines is one piece.
    def stretch(text: str) -> str:
        return "\n\n".join(line(block) for block in text.split("\n\n"))

    return outside_code(text, stretch)


def write(site: str, text: str) -> None:
    file = OUTPUT / "source" / site
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8")


def copied() -> None:
    """Copies the pages of this folder and of the repository."""
    pages = reference_pages()
    for file in sorted(DOCS.rglob("*")):
        site = file.relative_to(DOCS).as_posix()
        if file.suffix == ".md":
            text = rewrite(file.read_text(encoding="utf-8"), f"pipeline/docs/{site}", site)
            guide = site.startswith(("tutorials/", "how-to/", "gallery/"))
            write(site, explained(text, site, pages) if guide else text)
        elif file.suffix in (".css", ".html", ".js", ".svg", ".png") or site == "conf.py":
            (OUTPUT / "source" / site).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, OUTPUT / "source" / site)
    for site, page in PAGES.items():
        write(site, rewrite((REPOSITORY / page).read_text(encoding="utf-8"), page, site))


def contents(names: list[str], caption: str = "") -> str:
    options = ":maxdepth: 1\n" + (f":caption: {caption}\n" if caption else "")
    return "\n```{toctree}\n" + options + "\n" + "\n".join(names) + "\n```\n"


def sections(text: str, heading: str) -> tuple[str, list[tuple[str, str]]]:
    """Returns the text before the first heading of this kind, and the title and text of each section."""
    parts = re.split(rf"(?m)^{heading} (.*)$", text)
    return parts[0], list(zip(parts[1::2], parts[2::2], strict=True))


SAMPLE = "The stage is part of [the example of the reference](../example.md)."
KINDS = {
    "model": "The scores are those of the calibration line 1.01, to which the model is fitted, and of line 1.02.",
    "filter": "The scores are those of line 1.02. Their expected values are 2 for `nees` and 1 for `nis`.",
}
EPOCHS = "The example trains for a few epochs; a useful network needs more."


def example(kind: str, name: str, body: str, examples: Examples) -> str:
    """Returns the text of a page with the example of a stage, model or filter as its last section."""
    code = f"```toml\n{examples.stages[kind, name]}```\n"
    if kind == "stage":
        # The declaration's example, under a heading.
        body = body.replace(code, "")
        return f"{body.rstrip()}\n\n## Example\n\n{SAMPLE}\n\n{code}\n{examples.rows(name)}"
    body = re.sub(r"(?ms)^```toml\n.*?^```\n", "", body)
    note = " " + EPOCHS if "| `epochs` |" in body else ""
    text = SAMPLE.replace("stage is", "stages are") + f" {KINDS[kind]}{note}"
    return f"{body.rstrip()}\n\n## Example\n\n{text}\n\n{code}\n{examples.scores(name)}"


def reference(examples: Examples) -> None:
    """Derives one page a stage, model, filter and metric from `magline stages --markdown`."""
    intro, stages = sections(REFERENCE, "##")
    rows, names = [], []
    for title, body in stages:
        name = title.split("`")[1]
        names.append(name)
        rows.append(f"| [`{name}`]({name}.md) | {first_sentence(body)} |")
        body, kinds = sections(body, "###")
        metrics(name, body, examples)
        body = example("stage", name, body, examples)
        lists = {"model": [], "filter": []}
        for part, text in kinds:
            kind, entry = re.fullmatch(r"The (model|filter) `(\w+)`", part).groups()
            lists[kind].append((entry, first_sentence(text)))
            page = f"# `{entry}`\n\nA {kind} of [`{name}`](../stages/{name}.md).\n"
            page += example(kind, entry, text, examples)
            write(f"reference/{kind}s/{entry}.md", page)
        for kind, entries in lists.items():
            if entries:
                links = "\n".join(f"| [`{e}`](../{kind}s/{e}.md) | {text} |" for e, text in entries)
                body += f"\n## {kind.title()}s\n\n| {kind} | description |\n|---|---|\n{links}\n"
                index = f"# {kind.title()}s\n\nThe {kind}s of [`{name}`](../stages/{name}.md).\n\n"
                index += f"| {kind} | description |\n|---|---|\n" + links.replace(f"../{kind}s/", "") + "\n"
                write(f"reference/{kind}s/index.md", index + contents([e for e, _ in entries]))
        write(f"reference/stages/{name}.md", f"# {title}\n{body}")
    listed = "\n## All stages\n\n| stage | description |\n|---|---|\n" + "\n".join(rows) + "\n"
    write("reference/stages/index.md", intro.rstrip() + "\n" + listed + contents(names))


def metrics(stage: str, body: str, examples: Examples) -> None:
    """Derives one page a metric from the table of `score`."""
    table = re.search(r"(?m)^\| metric \|.*\n\|-.*\n((?:\|.*\n)+)", body)
    if stage != "score" or not table:
        return
    rows, names = [], []
    for row in table[1].splitlines():
        name, unit, pooled, better, meaning = [cell.strip() for cell in row.strip("|").split(" | ")]
        name = name.strip("`")
        names.append(f"metrics/{name}")
        rows.append(row.replace(f"`{name}`", f"[`{name}`](metrics/{name}.md)", 1))
        page = f"# `{name}`\n\nA metric of [`score`](../stages/score.md).\n\n| property | value |\n|---|---|\n"
        page += f"| meaning | {meaning} |\n"
        page += f"| unit | {unit} |\n| lines are pooled by | {pooled} |\n| better | {better or 'neither'} |\n"
        page += f"\n## Example\n\n```toml\nmetrics = [\"{name}\"]\n```\n\n"
        query = examples.metric(name)
        if query:
            page += f"The values of [the example of the reference](../example.md):\n\n{query}"
        else:
            page += "[The example of the reference](../example.md) has no value of this metric.\n"
        write(f"reference/metrics/{name}.md", page)
    head = "# Metrics\n\nThe metrics of [`score`](stages/score.md).\n\n"
    head += "| metric | unit | lines pooled by | better | meaning |\n|---|---|---|---|---|\n"
    write("reference/metrics.md", head + "\n".join(rows) + "\n" + contents(names))


def first_sentence(text: str) -> str:
    paragraph = text.strip().split("\n")[0]
    return re.split(r"(?<=[.:])\s", paragraph)[0].rstrip(":").replace("|", "\\|")


def commands(examples: Examples) -> None:
    """Derives one page a command from `--help`, with an example."""
    listing = re.search(r"(?ms)^Commands:\n(.*?)\n\n", output("--help")).group(1)
    rows, names = [], []
    for name, about in re.findall(r"(?m)^  (\w[\w-]*) +(.*)$", listing):
        if name == "help":
            continue
        names.append(name)
        rows.append(f"| [`magline {name}`]({name}.md) | {about} |")
        text = output(name, "--help")
        page = f"# `magline {name}`\n\n```text\n{text.rstrip()}\n```\n"
        sample = "The files are those of [the example of the reference](../example.md).\n\n"
        if name in COMMANDS:
            page += f"\n## Example\n\n{sample}{examples.console(COMMANDS[name])}"
        inner = re.search(r"(?ms)^Commands:\n(.*?)\n\n", text)
        for sub in re.findall(r"(?m)^  (\w[\w-]*) ", inner.group(1)) if inner else []:
            if sub != "help":
                page += f"\n## `magline {name} {sub}`\n\n```text\n{output(name, sub, '--help').rstrip()}\n```\n"
                if f"{name} {sub}" in COMMANDS:
                    page += f"\n{sample}{examples.console(COMMANDS[f'{name} {sub}'])}"
        write(f"reference/commands/{name}.md", page)
    page = "# Command line\n\n| command | description |\n|---|---|\n" + "\n".join(rows) + "\n" + contents(names)
    write("reference/commands/index.md", page)


def example_page(examples: Examples) -> None:
    """Writes the page of the spec that all examples of the reference belong to, and its files."""
    write("reference/example.toml", examples.spec)
    write("reference/flight.toml", examples.short)
    for name in SYNTHS:
        shutil.copyfile(DOCS / "reference" / name, OUTPUT / "source" / "reference" / name)
    text = (DOCS / "reference" / "example-page.txt").read_text(encoding="utf-8")
    write("reference/example.md", text + examples.console(["magline run flight.toml"]))


def formats(examples: Examples) -> None:
    """Derives one page a format."""
    text = "# File formats\n\nThe content of a file determines its format. `format` of a table overrides it.\n"
    names = []
    for kind, title in (("flight", "Flights"), ("map", "Maps")):
        text += f"\n## {title}\n\n| format | extensions | content |\n|---|---|---|\n"
        for name, about, extensions in declared.formats(kind, MAGLINE):
            listed = ", ".join(f"`.{e}`" for e in extensions) or "any"
            site = f"formats/{kind}-{name}"
            names.append(site)
            text += f"| [`{name}`]({site}.md) | {listed} | {about} |\n"
            page = f"# `{name}`: {kind}\n\nThe format `{name}` of a {kind} table: {about}. Extensions: {listed}.\n\n"
            page += f"```toml\n[tables.NAME]\npath   = \"FILE\"\nformat = \"{name}\"\n```\n\n## Example\n\n"
            if kind == "flight":
                made = examples.console(FLIGHTS[name]) if name in FLIGHTS else None
            else:
                made = examples.map_format(name)
            page += made or "The repository has no file of this format. Tests read files that they write.\n"
            write(f"reference/{site}.md", page)
    write("reference/formats.md", text + contents(names))


def publish(sites: Path, version: str) -> None:
    """Copies the site into the folder of all versions, and lists the versions there, the newest first."""
    shutil.rmtree(sites / version, ignore_errors=True)
    shutil.copytree(OUTPUT / "html", sites / version)
    found = [path.name for path in sites.iterdir() if (path / "index.html").is_file()]
    found.sort(key=lambda name: [int(part) if part.isdigit() else -1 for part in re.split(r"[.-]", name)], reverse=True)
    (sites / "versions.js").write_text(f"window.MAGLINE_VERSIONS = {json.dumps(found)};\n", encoding="utf-8")
    page = f'<!doctype html><title>magline</title><meta http-equiv="refresh" content="0; url={found[0]}/index.html">\n'
    (sites / "index.html").write_text(page, encoding="utf-8")


def output(*arguments: str) -> str:
    run = subprocess.run([MAGLINE, *arguments], capture_output=True, text=True, check=True)
    # Usage lines hold the name of the file.
    return run.stdout.replace(f"Usage: {Path(MAGLINE).name}", "Usage: magline")


def main() -> int:
    shutil.rmtree(OUTPUT / "source", ignore_errors=True)
    copied()
    with tempfile.TemporaryDirectory() as name:
        examples = Examples(MAGLINE, REFERENCE, Path(name) / "work")
        example_page(examples)
        reference(examples)
        commands(examples)
        formats(examples)
    write("reference/columns.md", declared.columns())
    write("reference/units.md", declared.units())
    for site, text in python_reference.pages(contents).items():
        write(f"reference/{site}", text)
    sphinx = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-j", "auto", "-b", "html"]
    version = output("--version").split()[-1]
    environment = {**os.environ, "MAGLINE_VERSION": version}
    status = subprocess.run([*sphinx, OUTPUT / "source", OUTPUT / "html"], env=environment).returncode
    if status == 0 and len(sys.argv) > 3:
        publish(Path(sys.argv[3]), version)
    pages = len(list((OUTPUT / "source").rglob("*.md")))
    print(f"{pages} pages in {OUTPUT / 'html'}")
    return status


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        raise SystemExit(__doc__)
    MAGLINE = os.path.abspath(sys.argv[1])
    OUTPUT = Path(sys.argv[2]).resolve()
    REFERENCE = output("stages", "--markdown")
    raise SystemExit(main())
