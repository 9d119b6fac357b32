"""Exceptions of magline, with one class for each place of the error.

The functions on arrays raise `ValueError` for wrong arguments.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields

from magline import _html


@dataclass(frozen=True)
class Fault:
    """One fault, with its place and remedy. An unknown part of the place is None.

    Attributes
    ----------
    what : str
        Description of the fault.
    help : str or None
        Remedy.
    owner : str
        Party that corrects the fault: ``spec``, ``data``, ``machine`` or ``bug``.
    file, flight, line, column : str or None
        Place in the data.
    row : int or None
        Row within the line, from 0. If the line is unknown, row within the file.
    spec_line : int or None
        Line number in the spec, from 1. For a spec given as a dict, line number in
        ``Spec.from_dict(spec).toml()``.

    Examples
    --------
    >>> import magline
    >>> try:
    ...     magline.check("datasets/examples/tolles_lawson.toml", set={"coefficients.lamda": 0.1})
    ... except magline.SpecError as error:
    ...     fault = error.faults[0]
    >>> fault.what
    '`fit` has no parameter `lamda`'
    >>> fault.help
    'did you mean `lambda`?'
    """

    what: str
    help: str | None = None
    owner: str = "spec"
    file: str | None = None
    flight: str | None = None
    line: str | None = None
    column: str | None = None
    row: int | None = None
    spec_line: int | None = None

    def _repr_html_(self) -> str:
        known = ((one.name, getattr(self, one.name)) for one in fields(self))
        return _html.table(["fault", ""], [[name, str(item)] for name, item in known if item is not None], "")


class MaglineError(Exception):
    """Base class of all exceptions of magline.

    Attributes
    ----------
    faults : tuple of Fault
        All faults, in the order of the message.
    help : str or None
        Remedy of the first fault; None if there is no fault or no remedy.

    Examples
    --------
    >>> import magline
    >>> try:
    ...     magline.maps.open("README.md")
    ... except magline.MaglineError as error:
    ...     print(type(error).__name__, error.faults[0].file, error.faults[0].what)
    DataError README.md is not in a known map format
    """

    def __init__(self, message: str, faults: tuple[Fault, ...] = ()) -> None:
        super().__init__(message)
        self.faults = faults

    @property
    def help(self) -> str | None:
        """Remedy of the first fault."""
        return self.faults[0].help if self.faults else None

    def _repr_html_(self) -> str:
        names = ["what", "help", "file", "flight", "line", "column", "row", "spec_line"]
        cells = [[None if (item := getattr(one, name)) is None else str(item) for name in names] for one in self.faults]
        shown = [name for name, *column in zip(names, *cells, strict=True) if any(cell is not None for cell in column)]
        rows = [[cell for name, cell in zip(names, row, strict=True) if name in shown] for row in cells[: _html.ROWS]]
        caption = f"{type(self).__name__}: {_html.first_of(len(self.faults), 'faults')}"
        return _html.table(shown, rows, caption) if rows else f"<pre>{_html.html(self)}</pre>"


class SpecError(MaglineError, ValueError):
    """Error in the spec or in an argument, including a file that does not exist.

    Examples
    --------
    >>> import magline
    >>> try:
    ...     magline.check({"name": "cabin", "stages": [{"name": "even", "stage": "resampel"}]})
    ... except magline.SpecError as error:
    ...     print(error.faults[0].what, "-", error.help)
    there is no stage `resampel` - did you mean `resample`?
    """


class DataError(MaglineError, ValueError):
    """Error in the data: a file, flight, line, column or row.

    Examples
    --------
    >>> import magline
    >>> try:
    ...     magline.maps.open("README.md")
    ... except magline.DataError as error:
    ...     print(error.faults[0].what)
    is not in a known map format
    """


class MachineError(MaglineError, OSError):
    """Lack of disk space, permission, memory or another resource. A retry may succeed.

    Examples
    --------
    >>> import magline
    >>> try:
    ...     magline.run("datasets/examples/tolles_lawson.toml", store="README.md/store")
    ... except magline.MachineError as error:
    ...     print(error.faults[0].owner)
    machine
    """


class BugError(MaglineError, RuntimeError):
    """Defect in magline. Please report it together with the spec.

    Examples
    --------
    >>> import magline, tempfile
    >>> try:
    ...     run = magline.run("datasets/examples/tolles_lawson.toml", store=tempfile.mkdtemp())
    ... except magline.BugError as error:
    ...     print(f"please report this with the spec: {error}")
    >>> run.failures
    []
    """


Error = MaglineError

_OWNERS: dict[str, type[MaglineError]] = {
    "spec": SpecError,
    "data": DataError,
    "machine": MachineError,
    "bug": BugError,
}


def _from_json(message: str, records: str) -> MaglineError:
    """Exception for the faults in a JSON array. The owner of the first fault selects its class."""
    faults = tuple(Fault(**record) for record in json.loads(records))
    owner = faults[0].owner if faults else "bug"
    return _OWNERS.get(owner, MaglineError)(message.removeprefix("error: "), faults)
