"""Derives one page a function and class of the Python package from its docstrings, without an import of the package.

The tests of the package run the examples of the docstrings (`pipeline/python/tests/test_examples.py`).
"""

import ast
import re
from collections.abc import Callable
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "python" / "magline"
# Modules with public functions, and the prefix of their names.
MODULES = {
    "runs": "magline", "results": "magline", "spec": "magline", "tables": "magline", "parts": "magline",
    "declarations": "magline", "errors": "magline", "views": "magline",
    "tolles_lawson": "magline.tolles_lawson", "core_field": "magline.core_field", "signal": "magline.signal",
    "maps": "magline.maps", "stream": "magline.stream", "metrics": "magline.metrics", "filters": "magline.filters",
    "_filters": "magline.filters",
}
SECTION = re.compile(r"(?m)^(\w[\w ]*)\n-{3,}\n")


def markdown(text: str) -> str:
    return re.sub(r"``([^`]+)``", r"`\1`", text)


def entries(text: str) -> str:
    """Returns the entries of a section, a name and an indented text each, as a definition list."""
    found = []
    for entry in re.split(r"(?m)^(?=\S)", text.strip("\n")):
        if entry.strip():
            head, _, body = entry.strip("\n").partition("\n")
            name, _, kind = head.partition(" : ")
            title = f"`{name}`" + (f": {markdown(kind)}" if kind else "")
            lines = [line.strip() for line in body.splitlines() if line.strip()]
            found.append(title + "\n: " + markdown("\n  ".join(lines) or "-"))
    return "\n\n".join(found) + "\n"


def documented(docstring: str, level: int) -> str:
    """Returns a docstring in the form of numpydoc as Markdown, with its sections at a level of headings."""
    first, *parts = SECTION.split(docstring)
    text = markdown(first.strip()) + "\n"
    for title, body in zip(parts[::2], parts[1::2], strict=True):
        text += f"\n{'#' * level} {title}\n\n"
        if title == "Examples":
            body = re.sub(r" +# doctest: .*", "", body.strip("\n"))
            text += f"```pycon\n{body}\n```\n"
        elif re.search(r"(?m)^\s{4}", body):
            text += entries(body)
        else:
            text += markdown(body.strip()) + "\n"
    return text


def signature(node: ast.FunctionDef, name: str) -> str:
    """Returns the call of a function, one argument a line if it is long."""
    node.args.args = [a for a in node.args.args if a.arg not in ("self", "cls")]
    for argument in [*node.args.args, *node.args.kwonlyargs, *node.args.posonlyargs]:
        argument.annotation = None
    call = f"{name}({ast.unparse(node.args)})"
    if len(call) > 88:
        call = f"{name}(\n    " + re.sub(r", (?=\w+(?:=|,|$)|\*)", ",\n    ", ast.unparse(node.args)) + ",\n)"
    return f"```python\n{call}\n```\n"


def public(module: str) -> list[ast.FunctionDef | ast.ClassDef]:
    if not (PACKAGE / f"{module}.py").is_file():
        return []
    tree = ast.parse((PACKAGE / f"{module}.py").read_text(encoding="utf-8"))
    nodes = [n for n in tree.body if isinstance(n, ast.FunctionDef | ast.ClassDef) and not n.name.startswith("_")]
    listed = exported() if MODULES[module] == "magline" else {n.name for n in nodes}
    return [n for n in nodes if n.name in listed and ast.get_docstring(n)]


def exported() -> set[str]:
    """Returns the names that `magline` itself exports."""
    text = (PACKAGE / "__init__.py").read_text(encoding="utf-8")
    return set(re.findall(r'"(\w+)"', text.split("__all__", 1)[1]))


def page(node: ast.FunctionDef | ast.ClassDef, name: str) -> str:
    text = f"# `{name}`\n\n"
    if isinstance(node, ast.FunctionDef):
        return text + signature(node, name) + "\n" + documented(ast.get_docstring(node), 2)
    text += documented(ast.get_docstring(node), 2)
    for member in node.body:
        doc = ast.get_docstring(member) if isinstance(member, ast.FunctionDef) else None
        if doc and not member.name.startswith("_"):
            decorated = any(isinstance(d, ast.Name) and d.id == "property" for d in member.decorator_list)
            call = "" if decorated else signature(member, f"{node.name}.{member.name}") + "\n"
            text += f"\n## `{member.name}`\n\n{call}{documented(doc, 3)}"
    return text


def pages(contents: Callable[[list[str]], str]) -> dict[str, str]:
    """Returns the pages by their places in the reference."""
    found, names = {}, []
    index = "# Python functions\n\n[magline from Python](python.md) is an introduction.\n"
    for module, prefix in MODULES.items():
        rows = []
        for node in public(module):
            name = f"{prefix}.{node.name}"
            found[f"functions/{name}.md"] = page(node, name)
            names.append(f"functions/{name}")
            about = markdown(ast.get_docstring(node).split("\n\n")[0].replace("\n", " ")).replace("|", "\\|")
            rows.append(f"| [`{name}`](functions/{name}.md) | {about} |")
        if rows:
            index += f"\n## `{prefix}`: {module}\n\n" if prefix == "magline" else f"\n## `{prefix}`\n\n"
            index += "| name | description |\n|---|---|\n" + "\n".join(rows) + "\n"
    found["functions.md"] = index + contents(names)
    return found
