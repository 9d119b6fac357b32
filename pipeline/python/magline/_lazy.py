"""Polars LazyFrame of a table, with projection, limit and predicates pushed down to the store."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from magline import _magline

if TYPE_CHECKING:
    import polars as pl

    from magline.tables import Table

#: Largest number of values of a column in a condition. More values become a range.
MOST_VALUES = 200


def frame(table: Table) -> pl.LazyFrame:
    """LazyFrame of a table."""
    import polars
    from magline.tables import Table
    from polars.io.plugins import register_io_source

    def read(chosen: str, end: str) -> pl.DataFrame:
        query = f"select {chosen} from ({table._query}) as whole{end}"
        return polars.DataFrame(Table(table._store, query, table._memory_limit, name=table._name))

    def batches(
        columns: list[str] | None, predicate: pl.Expr | None, rows: int | None, size: int | None
    ) -> Iterator[pl.DataFrame]:
        chosen = "*" if columns is None else ", ".join(map(_quoted, columns)) or "null"
        if predicate is None or rows is not None:
            found = read(chosen, "" if rows is None else f" limit {rows}")
            yield found if predicate is None else found.filter(predicate)
            return
        parts = _parts(table)
        where = _where(parts, predicate)
        found = read(chosen, f" where {where}" if where else "")
        if where and not _parts(table).equals(parts):
            # The table was published again, and the condition does not consider its new rows.
            found = read(chosen, "")
        yield found.filter(predicate)

    return register_io_source(batches, schema=read("*", " limit 0").schema)


def _parts(table: Table) -> pl.DataFrame:
    """Values of flight, line and axes in each part of a table; no column for a query."""
    import polars

    if table._name is None:
        return polars.DataFrame()
    return polars.DataFrame(_magline.table_parts(table._store, table._name))


def _where(parts: pl.DataFrame, predicate: pl.Expr) -> str:
    """Condition in SQL that all rows of the result satisfy; empty for none.

    Polars evaluates the terms of the predicate that need only columns of `parts`. It passes no
    predicate to a source whose value for a row depends on other rows.
    """
    if not parts.height or not parts.columns:
        return ""
    kept = parts
    for term in _terms(predicate):
        needed = set(term.meta.root_names())
        if needed and needed <= set(parts.columns):
            kept = kept.filter(term)
    if not kept.height:
        return "false"
    conditions = (_condition(name, parts[name], kept[name]) for name in parts.columns)
    return " and ".join(condition for condition in conditions if condition)


def _terms(predicate: pl.Expr) -> Iterator[pl.Expr]:
    """Terms of a conjunction."""
    inputs = predicate.meta.pop()
    for one, other in (inputs, inputs[::-1]) if len(inputs) == 2 else ():
        if (one & other).meta.eq(predicate):
            yield from _terms(one)
            yield from _terms(other)
            return
    yield predicate


def _condition(name: str, values: pl.Series, kept: pl.Series) -> str:
    """Condition that restricts a column to the kept values; empty without a restriction."""
    kept = kept.unique()
    if kept.len() == values.n_unique():
        return ""
    texts = [_literal(value) for value in kept.drop_nulls().sort()]
    known = [text for text in texts if text is not None]
    if len(known) < len(texts):
        return ""
    column = _quoted(name)
    terms = [f"{column} is null"] if kept.null_count() else []
    if len(known) > MOST_VALUES:
        terms.append(f"{column} between {known[0]} and {known[-1]}")
    else:
        terms += [f"{column} = {text}" for text in known]
    return f"({' or '.join(terms)})"


def _literal(value: Any) -> str | None:
    """Literal of SQL; None for a value of another type."""
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int) or isinstance(value, float) and math.isfinite(value):
        return repr(value)
    return None


def _quoted(name: str) -> str:
    """Quoted name of a column for SQL."""
    return '"' + name.replace('"', '""') + '"'
