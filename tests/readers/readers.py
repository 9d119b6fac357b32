"""Counts the rows and sums the numeric columns of every published table of a store with pyarrow, Polars, DuckDB, pandas
and `magline sql`. See README.md beside this file."""

import argparse
import json
import subprocess
import sys
from pathlib import Path


def tables(store):
    """Name and folder of every published table."""
    folders = sorted((Path(store) / "tables").glob("*/*/"))
    return {f"{f.parent.name}.{f.name}": f for f in folders if any(f.glob("part-*.parquet"))}


def kinds(folder):
    """The numeric columns of a table: "number" or "list" (of numbers)."""
    import pyarrow as pa
    import pyarrow.parquet

    def number(kind):
        return pa.types.is_integer(kind) or pa.types.is_floating(kind)

    def is_list(kind):
        return pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)

    schema = pa.parquet.read_schema(sorted(folder.glob("part-*.parquet"))[0])
    found = {f.name: "number" for f in schema if number(f.type)}
    return found | {f.name: "list" for f in schema if is_list(f.type) and number(f.type.value_type)}


# Each reader returns the number of rows and, for each column, the number of values, their sum, and the sum of their
# absolute values. Null and NaN are not values.

def with_pyarrow(folder, columns):
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.dataset

    data = pa.dataset.dataset(folder, format="parquet")
    found = {}
    for name, kind in columns.items():
        values = data.to_table(columns=[name]).column(0)
        values = (pc.list_flatten(values) if kind == "list" else values).cast(pa.float64())
        values = pc.filter(values, pc.invert(pc.is_nan(values)), null_selection_behavior="drop")
        found[name] = (len(values), pc.sum(values).as_py() or 0.0, pc.sum(pc.abs(values)).as_py() or 0.0)
    return data.count_rows(), found


def with_polars(folder, columns):
    import polars as pl

    # `*.parquet` as in the other readers; the folder alone gives the same result.
    data = pl.scan_parquet(folder / "*.parquet")
    found = {}
    for name, kind in columns.items():
        x = pl.col(name)
        x = (x.explode() if kind == "list" else x).cast(pl.Float64).fill_nan(None)
        found[name] = data.select(n=x.count(), s=x.sum(), a=x.abs().sum()).collect().row(0)
    return data.select(pl.len()).collect().item(), found


def with_duckdb(folder, columns):
    import duckdb

    files = str(folder / "*.parquet").replace("'", "''")
    found = {}
    for name, kind in columns.items():
        x = '"' + name.replace('"', '""') + '"'
        x = f"unnest({x}::double[])" if kind == "list" else f"{x}::double"
        found[name] = duckdb.sql(f"""SELECT count(x), coalesce(sum(x), 0), coalesce(sum(abs(x)), 0)
            FROM (SELECT {x} AS x FROM read_parquet('{files}')) WHERE NOT isnan(x)""").fetchall()[0]
    return duckdb.sql(f"SELECT count(*) FROM read_parquet('{files}')").fetchall()[0][0], found


def with_pandas(folder, columns):
    import numpy as np
    import pandas

    rows = len(pandas.read_parquet(folder))
    found = {}
    for name, kind in columns.items():
        x = pandas.read_parquet(folder, columns=[name])[name]
        if kind == "list":
            lists = [v for v in x if v is not None]
            x = np.concatenate(lists) if lists else np.array([])
        x = np.asarray(x, dtype=float)
        x = x[~np.isnan(x)]
        found[name] = (len(x), float(x.sum()), float(np.abs(x).sum()))
    return rows, found


def with_magline(binary, store, table, columns):
    def ask(query):
        done = subprocess.run([binary, "sql", query, "--store", str(store), "--format", "json"],
                              capture_output=True, text=True)
        if done.returncode != 0:
            sys.exit(f"magline sql fails on {table}:\n{query}\n{done.stderr}")
        return json.loads(done.stdout.splitlines()[0])

    name = ".".join('"' + part.replace('"', '""') + '"' for part in table.split("."))
    wanted = ["count(*) AS n"]
    quoted = {c: '"' + c.replace('"', '""') + '"' for c in columns}
    numbers = [c for c, kind in columns.items() if kind == "number"]
    for i, c in enumerate(numbers):
        x = f"CASE WHEN isnan(CAST({quoted[c]} AS double)) THEN NULL ELSE CAST({quoted[c]} AS double) END"
        wanted += [f"count({x}) AS n{i}", f"sum({x}) AS s{i}", f"sum(abs({x})) AS a{i}"]
    row = ask(f"SELECT {', '.join(wanted)} FROM {name}")
    found = {c: (row[f"n{i}"], row.get(f"s{i}") or 0.0, row.get(f"a{i}") or 0.0) for i, c in enumerate(numbers)}
    for c in columns:
        if columns[c] == "list":
            row_of = ask(f"SELECT count(x) AS n, sum(x) AS s, sum(abs(x)) AS a "
                         f"FROM (SELECT unnest({quoted[c]}) AS x FROM {name}) WHERE NOT isnan(x)")
            found[c] = (row_of["n"], row_of.get("s") or 0.0, row_of.get("a") or 0.0)
    return row["n"], found


def differences(one, other):
    """Differences between two readers. Sums may differ by rounding: 1e-9 of the sum of absolute values."""
    (rows, columns), (other_rows, other_columns) = one, other
    if rows != other_rows:
        yield f"{rows} rows, not {other_rows}"
    for name, (n, s, a) in columns.items():
        other_n, other_s, other_a = other_columns[name]
        if n != other_n:
            yield f"`{name}` has {n} numbers, not {other_n}"
        for what, x, y in [("sum", s, other_s), ("absolute sum", a, other_a)]:
            if x != y and not abs(x - y) <= 1e-9 * max(a, other_a):
                yield f"the {what} of `{name}` is {x!r}, not {y!r}"


def compare(store, binary, readers):
    """Compares the readers with `magline sql`; returns the number of tables that differ."""
    wrong, total_rows, total_columns = 0, 0, 0
    found = tables(store)
    if not found:
        sys.exit(f"there are no published tables in {store}")
    for table, folder in found.items():
        columns = kinds(folder)
        rows, wanted = with_magline(binary, store, table, columns)
        said = []
        for name, reader in readers.items():
            try:
                said += [f"  {name}: {what}" for what in differences(reader(folder, columns), (rows, wanted))]
            except Exception as e:
                said.append(f"  {name}: {type(e).__name__}: {e}")
        numbers = sum(n for n, _, _ in wanted.values())
        print(f"{table}: {rows} rows, {len(columns)} numeric columns, {numbers} numbers: "
              f"{'differ' if said else 'same'}")
        print("".join(f"{line}\n" for line in said), end="", flush=True)
        wrong += bool(said)
        total_rows += rows
        total_columns += len(columns)
    print(f"{len(found)} tables, {total_rows} rows, {total_columns} numeric columns; magline sql and "
          f"{', '.join(readers)}: "
          + (f"{wrong} tables differ" if wrong else "all the same"))
    return wrong


def arguments(about):
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("store", help="the store's folder")
    parser.add_argument("--magline", default="target/debug/magline", help="the binary")
    args = parser.parse_args()
    return args.store, str(Path(args.magline).resolve())


if __name__ == "__main__":
    store, binary = arguments(__doc__)
    readers = {"pyarrow": with_pyarrow, "polars": with_polars, "duckdb": with_duckdb, "pandas": with_pandas}
    sys.exit(1 if compare(store, binary, readers) else 0)
