"""magline: a batch pipeline for airborne magnetometry and magnetic navigation.

Examples
--------
>>> import magline
>>> run = magline.run("datasets/examples/tolles_lawson.toml")  # doctest: +SKIP
>>> run.scores["scores"]  # doctest: +SKIP
>>> run.table("clean").pandas()  # doctest: +SKIP
"""

from magline import core_field, maps, metrics, signal, tolles_lawson
from magline._magline import __version__
from magline.errors import BugError, DataError, Error, Fault, MachineError, MaglineError, SpecError
from magline.runs import Check, Failure, Run, ScoreTable, Warning, check, run
from magline.spec import Axis, Spec, TableHandle
from magline.tables import Pipeline, Store, Table, sql

__all__ = [
    "Axis",
    "BugError",
    "Check",
    "DataError",
    "Error",
    "Failure",
    "Fault",
    "MachineError",
    "MaglineError",
    "Pipeline",
    "Run",
    "ScoreTable",
    "Spec",
    "SpecError",
    "Store",
    "Table",
    "TableHandle",
    "Warning",
    "__version__",
    "check",
    "core_field",
    "maps",
    "metrics",
    "run",
    "signal",
    "sql",
    "tolles_lawson",
]
