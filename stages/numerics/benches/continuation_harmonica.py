"""Upward continuation of a map of 3195 x 7279 nodes with harmonica and xrft, beside the bench of the same name.

    python3 stages/numerics/benches/continuation_harmonica.py          # the bench before and after its own runs, ratio
    python3 stages/numerics/benches/continuation_harmonica.py --write  # the nodes that the bench is checked against

The map and its padding by zeros to 3840 x 8748 nodes are the same on both sides. The fastest of the runs counts.
"""
import re
import subprocess
import sys
import time
import warnings
from importlib.metadata import version
from pathlib import Path

import harmonica as hm
import numpy as np
import xarray as xr
import xrft

warnings.simplefilter("ignore")
HERE = Path(__file__).resolve().parent
REFERENCE = HERE.parent / "reference/maps/continuation/harmonica_bench.csv"
ROWS, COLUMNS, PADDED = 3195, 7279, (3840, 8748)
STEP_M, UP_M, REPEATS = 50.0, 300.0, 7
SOURCES = [
    (60_000.0, 40_000.0, 700.0, 300.0),
    (150_000.0, 90_000.0, 1500.0, -200.0),
    (210_000.0, 30_000.0, 4000.0, 250.0),
    (300_000.0, 120_000.0, 900.0, -350.0),
    (330_000.0, 60_000.0, 2500.0, 150.0),
    (90_000.0, 130_000.0, 600.0, 400.0),
]


def field():
    east, north = STEP_M * np.arange(COLUMNS), STEP_M * np.arange(ROWS)[:, None]
    values = np.zeros((ROWS, COLUMNS))
    for e, n, depth, strength in SOURCES:
        values += strength * depth**3 / ((east - e) ** 2 + (north - n) ** 2 + depth**2) ** 1.5
    return xr.DataArray(values, coords={"northing": north.ravel(), "easting": east}, dims=("northing", "easting"))


def padding():
    gaps = [padded - side for padded, side in zip(PADDED, (ROWS, COLUMNS))]
    return {name: (gap // 2, gap - gap // 2) for name, gap in zip(("northing", "easting"), gaps)}


def continued(grid):
    width = padding()
    return xrft.unpad(hm.upward_continuation(xrft.pad(grid, width), UP_M), width)


def most_memory():
    with open("/proc/self/status") as status:
        return 1024 * next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))


def write(answer):
    versions = ", ".join(f"{name} {version(name)}" for name in ("harmonica", "xrft", "numpy"))
    rows, columns = np.linspace(0, ROWS - 1, 8).astype(int), np.linspace(0, COLUMNS - 1, 8).astype(int)
    nodes = [(row, column) for row in rows for column in columns]
    nodes += [(round(n / STEP_M), round(e / STEP_M) + 3) for e, n, _, _ in SOURCES]
    with open(REFERENCE, "w") as file:
        file.write(f"# {versions}: python3 stages/numerics/benches/continuation_harmonica.py --write\n")
        file.write("row,column,value_nt\n")
        for row, column in nodes:
            file.write(f"{row},{column},{float(answer[row, column])!r}\n")


def rust_milliseconds():
    command = ["cargo", "bench", "-q", "-p", "stages", "--bench", "continuation", "--profile", "dev"]
    printed = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=True).stdout
    print(printed, end="")
    return {int(n): float(ms) for n, ms in re.findall(r"threads (\d+): ([\d.]+) ms", printed)}


def main():
    grid = field()
    base = most_memory()
    first = {} if "--write" in sys.argv else rust_milliseconds()
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        answer = continued(grid)
        seconds.append(time.perf_counter() - start)
    best = min(seconds)
    if "--write" in sys.argv:
        return write(answer.values)
    copy = 8 * PADDED[0] * PADDED[1]
    print(f"harmonica {version('harmonica')}, xrft {version('xrft')}, numpy {np.__version__}")
    print("runs " + ", ".join(f"{s:.2f}" for s in seconds) + " s")
    print(f"memory at most {most_memory() / copy:.1f} copies of the padded map, before {base / copy:.1f}")
    for threads, again in rust_milliseconds().items():
        milliseconds = min(first[threads], again)
        print(f"harmonica over Rust on {threads} threads: {1e3 * best / milliseconds:.1f}")


if __name__ == "__main__":
    main()
