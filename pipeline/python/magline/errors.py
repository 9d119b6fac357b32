"""Errors of magline, by the party that corrects them."""

from __future__ import annotations

import json
from dataclasses import dataclass


@dataclass(frozen=True)
class Fault:
    """One fault, with its place and remedy. Every part of the place is optional.

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
        Row within the line, from 0; within the file if the line is unknown.
    spec_line : int or None
        Line of the spec, from 1.
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


class MaglineError(Exception):
    """Base of all errors of magline.

    Attributes
    ----------
    faults : tuple of Fault
        All faults, in the order of the message.
    help : str or None
        Remedy of the first fault.
    """

    def __init__(self, message: str, faults: tuple[Fault, ...] = ()) -> None:
        super().__init__(message)
        self.faults = faults

    @property
    def help(self) -> str | None:
        """Remedy of the first fault."""
        return self.faults[0].help if self.faults else None


class SpecError(MaglineError, ValueError):
    """The spec or an argument is wrong."""


class DataError(MaglineError, ValueError):
    """The data are wrong: a file, flight, line, column or row."""


class MachineError(MaglineError, OSError):
    """The machine lacks a resource, such as disk, permission or memory. A retry may help."""


class BugError(MaglineError, RuntimeError):
    """An error in magline. Please report it, with the spec."""


Error = MaglineError

_OWNERS: dict[str, type[MaglineError]] = {
    "spec": SpecError,
    "data": DataError,
    "machine": MachineError,
    "bug": BugError,
}


def _from_json(message: str, records: str) -> MaglineError:
    """Error for the faults of a JSON array; its class is the owner of the first fault."""
    faults = tuple(Fault(**record) for record in json.loads(records))
    owner = faults[0].owner if faults else "bug"
    return _OWNERS.get(owner, MaglineError)(message.removeprefix("error: "), faults)
