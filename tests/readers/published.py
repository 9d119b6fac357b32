"""Reads a published data set with pyarrow, pandas, Polars, DuckDB and, where there is Java, Spark: rows, types,
missing values, minimum and maximum of every column must agree with its `dictionary.json`. Then validates its documents
with mlcroissant, frictionless, cffconvert and a RO-Crate validator. See README.md beside this file."""

import argparse
import json
import math
import os
import shutil
import subprocess
import sys
import urllib.request
from pathlib import Path

TEXT, NUMBER, INTEGER, FLAG, LIST = "text", "number", "integer", "boolean", "list of numbers"


def of_arrow(kind):
    import pyarrow as pa
    if pa.types.is_fixed_size_list(kind) or pa.types.is_list(kind):
        return LIST
    for name, test in [(NUMBER, pa.types.is_float64), (INTEGER, pa.types.is_int64), (FLAG, pa.types.is_boolean)]:
        if test(kind):
            return name
    return TEXT if pa.types.is_string(kind) or pa.types.is_large_string(kind) else str(kind)


# Each reader returns the rows and, for each column, its type, missing values, minimum and maximum (None without
# values).

def with_pyarrow(folder):
    import pyarrow.parquet
    table = pyarrow.parquet.read_table(folder)
    return table.num_rows, {f.name: (of_arrow(f.type), *figures(table.column(f.name).to_numpy())) for f in table.schema}


def figures(values):
    import numpy as np
    if values.dtype.kind in "fiu":
        missing = int(np.isnan(values).sum()) if values.dtype.kind == "f" else 0
        finite = values[np.isfinite(values)]
        return missing, *((float(finite.min()), float(finite.max())) if len(finite) else (None, None))
    return int(sum(v is None or v != v if not hasattr(v, "__len__") else False for v in values)), None, None


def with_pandas(folder):
    import pandas
    table = pandas.read_parquet(folder)
    kinds = {"float64": NUMBER, "int64": INTEGER, "bool": FLAG, "str": TEXT, "string": TEXT}

    def kind(column):
        if str(column.dtype) == "object" and len(column):
            return TEXT if isinstance(column.iloc[0], str) else FLAG if isinstance(column.iloc[0], bool) else LIST
        return kinds.get(str(column.dtype), str(column.dtype))

    return len(table), {name: (kind(table[name]), *figures(table[name].to_numpy())) for name in table.columns}


def with_polars(folder):
    import polars as pl
    table = pl.scan_parquet(folder).collect()
    kinds = {pl.Float64: NUMBER, pl.Int64: INTEGER, pl.Boolean: FLAG, pl.String: TEXT}
    found = {}
    for name, kind in table.schema.items():
        column = table[name]
        if kind in (pl.Float64, pl.Int64):
            column = column.fill_nan(None) if kind == pl.Float64 else column
            found[name] = (kinds[kind], column.null_count(), column.min(), column.max())
        else:
            found[name] = (kinds.get(kind, LIST if isinstance(kind, (pl.List, pl.Array)) else str(kind)),
                           column.null_count(), None, None)
    return len(table), found


def with_duckdb(folder):
    import duckdb
    files = str(folder / "**" / "*.parquet").replace("'", "''")
    kinds = {"DOUBLE": NUMBER, "BIGINT": INTEGER, "BOOLEAN": FLAG, "VARCHAR": TEXT}
    found = {}
    for name, kind, *_ in duckdb.sql(f"DESCRIBE SELECT * FROM read_parquet('{files}')").fetchall():
        x = '"' + name.replace('"', '""') + '"'
        if kind == "DOUBLE":
            x = f"CASE WHEN isnan({x}) THEN NULL ELSE {x} END"
        numeric = f"min({x}), max({x})" if kind in ("DOUBLE", "BIGINT") else "NULL, NULL"
        row = duckdb.sql(f"SELECT count(*) - count({x}), {numeric} FROM read_parquet('{files}')").fetchall()[0]
        found[name] = (kinds.get(kind, LIST if kind.startswith("DOUBLE[") else kind), *row)
    return duckdb.sql(f"SELECT count(*) FROM read_parquet('{files}')").fetchall()[0][0], found


def with_spark(folder):
    from pyspark.sql import SparkSession, functions as f
    spark = SparkSession.builder.master("local[1]").config("spark.ui.enabled", "false").getOrCreate()
    spark.sparkContext.setLogLevel("ERROR")
    table = spark.read.parquet(str(folder))
    kinds = {"double": NUMBER, "bigint": INTEGER, "boolean": FLAG, "string": TEXT, "array<double>": LIST}
    wanted = [f.count(f.lit(1)).alias("rows")]
    for i, (name, kind) in enumerate(table.dtypes):
        x = f.col(f"`{name}`")
        x = f.when(~f.isnan(x), x) if kind == "double" else x
        wanted.append(f.count(x).alias(f"n{i}"))
        if kind in ("double", "bigint"):
            wanted += [f.min(x).alias(f"a{i}"), f.max(x).alias(f"b{i}")]
    row = table.agg(*wanted).first().asDict()
    rows = row["rows"]
    return rows, {name: (kinds.get(kind, kind), rows - row[f"n{i}"], row.get(f"a{i}"), row.get(f"b{i}"))
                  for i, (name, kind) in enumerate(table.dtypes)}


def differences(found, table):
    rows, columns = found
    if rows != table["rows"]:
        yield f"{rows} rows, not {table['rows']}"
    told = {c["name"]: c for c in table["columns"]}
    if set(columns) - set(table["partitions"]) != set(told):
        yield f"the columns {sorted(set(columns) ^ set(told))} are not in both"
    for name, column in told.items():
        if name not in columns:
            continue
        kind, missing, least, greatest = columns[name]
        if kind != column["type"]:
            yield f"`{name}` is {kind}, not {column['type']}"
        if column["type"] == LIST:
            continue
        if missing != column["missing"]:
            yield f"`{name}` has {missing} missing values, not {column['missing']}"
        for what, x in [("min", least), ("max", greatest)]:
            y = column.get(what)
            close = x == y or (x is not None and y is not None and math.isclose(x, y, rel_tol=1e-15))
            if column["type"] in (NUMBER, INTEGER) and not close:
                yield f"the {what} of `{name}` is {x!r}, not {y!r}"


def read_all(folder, readers):
    dictionary = json.loads((folder / "dictionary.json").read_text())
    wrong = 0
    for table in dictionary["tables"]:
        said = []
        for name, reader in readers.items():
            try:
                said += [f"  {name}: {what}" for what in differences(reader(folder / "data" / table["name"]), table)]
            except Exception as e:
                said.append(f"  {name}: {type(e).__name__}: {str(e).splitlines()[0]}")
        print(f"{table['name']}: {table['rows']} rows, {len(table['columns'])} columns: {'differ' if said else 'same'}")
        print("".join(f"{line}\n" for line in said), end="", flush=True)
        wrong += bool(said)
    print(f"{len(dictionary['tables'])} tables; {', '.join(readers)}: "
          f"{f'{wrong} tables differ' if wrong else 'all the same'}")
    return wrong


# Each validator returns the faults that it finds.

CONTEXT = "https://w3id.org/ro/crate/1.1/context"


def croissant(folder):
    """Validates the description, and reads a record of every table through it."""
    import mlcroissant
    data = mlcroissant.Dataset(jsonld=folder / "croissant.json")
    found = list(data.metadata.issues.errors) + list(data.metadata.issues.warnings)
    tables = json.loads((folder / "dictionary.json").read_text())["tables"]
    for table in tables:
        if table["rows"] and not next(iter(data.records(table["name"])), None):
            found.append(f"no record of {table['name']}")
    return found


def data_package(folder):
    import frictionless
    report = frictionless.Package(str(folder / "datapackage.json")).validate()
    return [f"{t.name}: {e.message}" for t in report.tasks for e in t.errors] + [e.message for e in report.errors]


class NotChecked(Exception):
    """A requirement of a validator is missing, so the result is unknown."""


def citation(folder, program):
    """`program` is cffconvert's, which cannot share an environment with frictionless: they require different versions
    of jsonschema."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"
    found = program or shutil.which("cffconvert", path=path)
    if not found:
        raise NotChecked("there is no program cffconvert; --cffconvert names it")
    done = subprocess.run([str(found), "--validate", "-i", str(folder / "CITATION.cff")], capture_output=True,
                          text=True)
    return [] if done.returncode == 0 else [done.stdout + done.stderr]


def ro_crate(folder, context):
    """`context` is the file of https://w3id.org/ro/crate/1.1/context, for a machine without a network."""
    import io
    import requests
    if not context:
        try:
            with urllib.request.urlopen(CONTEXT, timeout=30) as answer:
                answer.read()
        except OSError as e:
            raise NotChecked(f"{CONTEXT} cannot be fetched ({e}); --ro-crate-context names its file") from e
    else:
        text, request, urlopen = Path(context).read_bytes(), requests.Session.request, urllib.request.urlopen

        def answer(self, method, url, *args, **kwargs):
            if "/ro/crate/1.1/context" not in url:
                return request(self, method, url, *args, **kwargs)
            response = requests.Response()
            response.status_code, response._content, response.url = 200, text, url
            response.headers["Content-Type"] = "application/ld+json"
            return response

        def opened(what, *args, **kwargs):
            url = what if isinstance(what, str) else what.full_url
            if "/ro/crate/1.1/context" not in url:
                return urlopen(what, *args, **kwargs)
            body = io.BytesIO(text)
            body.url, body.headers, body.status = url, {"Content-Type": "application/ld+json"}, 200
            body.geturl, body.info = lambda: url, lambda: body.headers
            return body

        requests.Session.request, urllib.request.urlopen = answer, opened
        import rdflib._networking
        import rdflib.parser
        import rdflib.plugins.shared.jsonld.util
        for module in [rdflib._networking, rdflib.parser, rdflib.plugins.shared.jsonld.util]:
            if hasattr(module, "urlopen"):
                module.urlopen = opened
    from rocrate_validator import models, services
    done = services.validate(services.ValidationSettings(
        rocrate_uri=str(folder), profile_identifier="ro-crate-1.1", requirement_severity=models.Severity.REQUIRED))
    return [] if done.passed() else [issue.message for issue in done.get_issues()]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="the published data set")
    parser.add_argument("--spark", action="store_true", help="read it with Spark too")
    parser.add_argument("--ro-crate-context", help="the file of the context of RO-Crate 1.1; fetched otherwise")
    parser.add_argument("--cffconvert", help="the program cffconvert; otherwise that beside this Python, or on the "
                                             "path")
    args = parser.parse_args()
    folder = args.folder.resolve()
    readers = {"pyarrow": with_pyarrow, "pandas": with_pandas, "polars": with_polars, "duckdb": with_duckdb}
    wrong = read_all(folder, readers | ({"spark": with_spark} if args.spark else {}))
    for name, validator in [("mlcroissant", croissant), ("frictionless", data_package),
                            ("cffconvert", lambda f: citation(f, args.cffconvert)),
                            ("RO-Crate", lambda f: ro_crate(f, args.ro_crate_context))]:
        try:
            found = validator(folder)
        except NotChecked as e:
            print(f"{name}: NOT CHECKED: {e}", flush=True)
            continue
        except Exception as e:
            found = [f"{type(e).__name__}: {e}"]
        print(f"{name}: {'valid' if not found else 'not valid'}")
        print("".join(f"  {what}\n" for what in found[:10]), end="", flush=True)
        wrong += bool(found)
    sys.exit(1 if wrong else 0)
