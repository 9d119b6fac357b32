"""Reads the CSV of the bench `csv` with polars and pandas, then with magline, on one thread each.

    python3 -m venv venv && venv/bin/pip install polars pandas
    venv/bin/python datasets/benches/csv_polars.py BENCH [MEGABYTES]

BENCH is the path that `cargo bench -p magline-datasets --bench csv --profile dev --no-run` prints.
"""

import os
import subprocess
import sys
import tempfile
import time

os.environ["POLARS_MAX_THREADS"] = "1"

import pandas
import polars

RUNS = 5


def speed(path, read):
    """Speed in megabytes per second of wall-clock time and of processor time; the best of several runs."""
    wall, process = float("inf"), float("inf")
    for _ in range(RUNS):
        start, used = time.perf_counter(), time.process_time()
        read()
        wall, process = min(wall, time.perf_counter() - start), min(process, time.process_time() - used)
    megabytes = os.path.getsize(path) / 1e6
    return f"{megabytes / wall:.0f} MB/s ({megabytes / process:.0f} by the time of the process)"


def main():
    bench, megabytes = sys.argv[1], sys.argv[2] if len(sys.argv) > 2 else "150"
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "flight.csv")
        subprocess.run([bench, megabytes, path], check=True)
        keys = {"flight": polars.String, "line": polars.String}
        print(f"polars {polars.__version__}, 1 thread, types guessed from 100 rows: "
              f"{speed(path, lambda: polars.read_csv(path, schema_overrides=keys))}")
        whole = lambda: polars.read_csv(path, schema_overrides=keys, infer_schema_length=None)
        print(f"polars {polars.__version__}, 1 thread, types of all rows: {speed(path, whole)}")
        print(f"pandas {pandas.__version__}: {speed(path, lambda: pandas.read_csv(path))}")


main()
