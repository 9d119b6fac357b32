"""HTML and plain text of results for notebooks and terminals. Names and messages come from data and are escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import TypeVar

#: Maximum number of rows of a list that is shown.
ROWS = 100

T = TypeVar("T")


def visible(text: object) -> str:
    """Text without characters that control a terminal or the direction of writing."""
    return "".join(
        one if one.isprintable() or one in "\n\u00a0\u202f" else one.encode("unicode_escape").decode()
        for one in str(text)
    )


def html(text: object) -> str:
    """HTML of a text."""
    return escape(visible(text))


def table(names: Sequence[str], rows: Iterable[Sequence[str | None]], caption: str) -> str:
    """HTML table; a missing value is an empty cell."""
    head = "".join(f"<th>{html(name)}</th>" for name in names)
    body = "".join(
        "<tr>" + "".join(f"<td>{html('' if cell is None else cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return (
        f"<table><caption>{html(caption)}</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )


def first_of(total: int, what: str) -> str:
    """Caption of a list, with the number of rows that are shown."""
    return f"{total} {what}" + (f", the first {ROWS}" if total > ROWS else "")


class Listing(list[T]):
    """List of warnings or failures. A notebook shows it as a table."""

    def __init__(self, items: Iterable[T], what: str, columns: Sequence[str]) -> None:
        super().__init__(items)
        self._what = what
        self._columns = columns

    def _repr_html_(self) -> str:
        def cell(one: T, name: str) -> str | None:
            found = getattr(one, name)
            if isinstance(found, dict):
                return ", ".join(f"{key}={item}" for key, item in found.items())
            return None if found is None else f"{found:.6g}" if isinstance(found, float) else str(found)

        rows = [[cell(one, name) for name in self._columns] for one in self[:ROWS]]
        return table(self._columns, rows, first_of(len(self), self._what))
