"""magline: a batch pipeline for airborne magnetometry and magnetic navigation.

Examples
--------
>>> import magline
>>> run = magline.run("datasets/examples/tolles_lawson.toml")  # doctest: +SKIP
>>> run.scores["scores"]  # doctest: +SKIP
>>> run.table("clean").pandas()  # doctest: +SKIP
"""

from magline import core_field, filters, maps, metrics, parts, signal, stream, tolles_lawson
from magline._magline import __version__
from magline.results import Failure, ScoreTable, Warning
from magline.errors import BugError, DataError, Error, Fault, MachineError, MaglineError, SpecError
from magline.parts import Column, Flight, Line, Param, filter, load_parts, metric, model, stage
from magline.runs import Check, Run, check, run
from magline.spec import Axis, Spec, TableHandle
from magline.tables import Pipeline, Store, Table, sql
from magline.views import View

__all__ = [
    "Axis",
    "BugError",
    "Check",
    "Column",
    "DataError",
    "Error",
    "Failure",
    "Fault",
    "Flight",
    "Line",
    "MachineError",
    "MaglineError",
    "Param",
    "Pipeline",
    "Run",
    "ScoreTable",
    "Spec",
    "SpecError",
    "Store",
    "Table",
    "TableHandle",
    "View",
    "Warning",
    "__version__",
    "check",
    "core_field",
    "filter",
    "filters",
    "load_parts",
    "maps",
    "metric",
    "metrics",
    "model",
    "parts",
    "run",
    "signal",
    "sql",
    "stage",
    "stream",
    "tolles_lawson",
]
