"""Display of the progress of a run: a bar of tqdm where it is installed, else text."""

from __future__ import annotations

import importlib
import shutil
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from magline._html import visible
from magline.views import is_notebook

#: Interval of lines of text when standard error is not a terminal, s.
INTERVAL_S = 10.0


class Show(Protocol):
    """Receiver of progress: stage, number of finished parts, and number of all parts or 0."""

    def __call__(self, what: str, done: int, all: int) -> None: ...


@contextmanager
def display(wanted: bool | None) -> Iterator[Show | None]:
    """Display of progress until the end of the context; None without one.

    With None, progress is displayed in a notebook and on a terminal.
    """
    if wanted is None:
        wanted = is_notebook() or sys.stderr is not None and sys.stderr.isatty()
    if not wanted:
        yield None
        return
    shown = _bar() or _Text()
    try:
        yield shown
    finally:
        shown.close()


class _Bar:
    """One bar of tqdm, which restarts with each stage."""

    def __init__(self, tqdm: Any) -> None:
        self._bar = tqdm(total=None, leave=False, unit=" units")
        self._what = ""

    def __call__(self, what: str, done: int, all: int) -> None:
        if what != self._what or (self._bar.total or 0) != all:
            self._what = what
            self._bar.reset(total=all or None)
            self._bar.set_description(visible(what))
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        self._bar.close()


def _bar() -> _Bar | None:
    """Bar of tqdm for a notebook or a terminal; None if tqdm is not installed."""
    try:
        with warnings.catch_warnings():
            # Without ipywidgets, tqdm warns and shows its bar as text.
            warnings.simplefilter("ignore")
            return _Bar(importlib.import_module("tqdm.auto").tqdm)
    except ImportError:
        return None


class _Text:
    """Text: one line that is replaced in a notebook or on a terminal, else a line every 10 s."""

    def __init__(self) -> None:
        self._handle: Any = None
        self._on_terminal = sys.stderr.isatty()
        self._next = time.monotonic()
        self._width = 0
        if is_notebook():
            show = importlib.import_module("IPython.display").display
            self._handle = show({"text/plain": ""}, raw=True, display_id=True)

    def __call__(self, what: str, done: int, all: int) -> None:
        text = visible(f"{what}: {done} of {all}" if all else what)
        if self._handle is not None:
            self._handle.update({"text/plain": text}, raw=True)
        elif self._on_terminal:
            self._replace(text)
        elif time.monotonic() >= self._next:
            self._next = time.monotonic() + INTERVAL_S
            print(text, file=sys.stderr, flush=True)

    def _replace(self, text: str) -> None:
        text = text[: shutil.get_terminal_size().columns - 1]
        sys.stderr.write(f"\r{text:<{self._width}}")
        sys.stderr.flush()
        self._width = len(text)

    def close(self) -> None:
        if self._handle is not None:
            self._handle.update({"text/plain": ""}, raw=True)
        elif self._on_terminal and self._width:
            self._replace("")
            sys.stderr.write("\r")
