"""Cost of a run as a function of the numbers of lines and sweep points. See README.md in this folder."""

import argparse
import json
import math
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

LINES = [10, 100, 1000, 10000]
POINTS = [1, 10, 100, 1000]
RATE_HZ = 10.0


def line(flight, name, rows, number):
    """A line with plausible readings: a field of 50,000 nT in the frame of an aircraft that rolls, pitches and yaws."""
    random = np.random.default_rng(number)
    t = np.arange(rows) / RATE_HZ
    roll, pitch, yaw = (np.radians(a) * np.sin(2 * math.pi * f * t + p) for a, f, p in
                        zip((10.0, 5.0, 5.0), (0.21, 0.33, 0.17), random.uniform(0, 6, 3)))
    yaw = yaw + random.uniform(0, 2 * math.pi)
    north, down = 25000.0, 43301.27
    x, y, z = north * np.cos(yaw), -north * np.sin(yaw), np.full(rows, down)
    x, z = x * np.cos(pitch) - z * np.sin(pitch), x * np.sin(pitch) + z * np.cos(pitch)
    y, z = y * np.cos(roll) + z * np.sin(roll), -y * np.sin(roll) + z * np.cos(roll)
    truth = 50000.0 + 40.0 * np.sin(2 * math.pi * t / 45.0 + random.uniform(0, 6))
    scale = truth / 50000.0
    x, y, z = x * scale, y * scale, z * scale
    aircraft = (12 * x - 7 * y + 5 * z) / truth + 20 * (x * x - 0.4 * x * y + 0.2 * y * z) / truth / 50000.0
    noise = random.normal(0, 0.05, rows)
    return pa.table({
        "flight": [flight] * rows, "line": [name] * rows, "tt": 36000.0 + t, "mag_1_c": truth,
        "mag_1_uc": truth + aircraft + noise, "flux_a_x": x, "flux_a_y": y, "flux_a_z": z,
    })


def write(folder, first, last, a_file, rows, form):
    """The lines `first` to `last`, several per file."""
    for start in range(first, last, a_file):
        lines = [line(f"{start:05}", f"{n:05}", rows, n) for n in range(start, min(start + a_file, last))]
        table, path = pa.concat_tables(lines), folder / f"{start:05}.{form}"
        if form == "csv":
            pa.csv.write_csv(table, path)
        else:
            pa.parquet.write_table(table, path)


SPEC = """name  = "growth"
store = "store"

[tables.flights]
path = "flights/"

[axes]
lambda = [{values}]

[[stages]]
name   = "terms"
stage  = "a_matrix"
input  = "flights"
vector = "flux_a"

[[stages]]
name   = "coefficients"
stage  = "fit"
input  = "terms"
where  = "line = '00000'"
model  = "tolles_lawson"
target = "mag_1_uc"
lambda = "$lambda"

[[stages]]
name  = "clean"
stage = "compensate"
input = "terms"
model = "coefficients"
mag   = "mag_1_uc"

[[stages]]
name    = "scores"
stage   = "score"
input   = "clean"
truth   = "mag_1_c"
metrics = ["std_error"]
"""


def spec(folder, points):
    values = ", ".join(f"{0.001 * (i + 1):.3f}" for i in range(points))
    (folder / "growth.toml").write_text(SPEC.format(values=values))


def command(binary, folder, *args):
    """Runs the binary: seconds, CPU seconds, peak memory in MB, and the last event of a run."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        begun = time.perf_counter()
        files = [(os.POSIX_SPAWN_DUP2, out.fileno(), 1), (os.POSIX_SPAWN_DUP2, err.fileno(), 2)]
        child = os.posix_spawn(binary, [binary, *args, str(folder / "growth.toml")], os.environ, file_actions=files)
        _, status, used = os.wait4(child, 0)
        seconds = time.perf_counter() - begun
        if os.waitstatus_to_exitcode(status) != 0:
            err.seek(0)
            sys.exit(f"magline {' '.join(args)} fails:\n{err.read().decode()}")
        # Only the end is read, because a run of a million units writes a line for each.
        size = out.seek(0, os.SEEK_END)
        out.seek(max(0, size - (1 << 20)))
        lines = out.read().splitlines()
    last = json.loads(lines[-1]) if "--json" in args else {}
    return {"s": seconds, "cpu": used.ru_utime + used.ru_stime, "mb": used.ru_maxrss / 1024, "last": last}


def size(store):
    """Files and bytes of a store by folder; a file with several names is counted under the first one."""
    seen, files, sizes = set(), {}, {}
    for part in ["objects", "versions", "sources", None]:
        for folder, _, names in os.walk(store / part if part else store):
            for name in names:
                about = os.lstat(os.path.join(folder, name))
                if about.st_ino not in seen:
                    seen.add(about.st_ino)
                    files[part] = files.get(part, 0) + 1
                    sizes[part] = sizes.get(part, 0) + about.st_size
    return files, sum(sizes.values())


def case(args, lines, points):
    folder = Path(tempfile.mkdtemp(prefix="growth-", dir=args.folder))
    try:
        (folder / "flights").mkdir()
        write(folder / "flights", 0, lines, args.lines_a_file, args.samples, args.format)
        spec(folder, points)
        run = lambda *extra: command(args.magline, folder, "run", "--json", *extra)
        check = command(args.magline, folder, "check")
        first = run()
        files, stored = size(folder / "store")
        same = run()
        write(folder / "flights", lines, lines + 1, args.lines_a_file, args.samples, args.format)
        one_line = run()
        spec(folder, points + 1)
        one_point = run()
        computed = first["last"]["computed"]
        for what, wanted in [(first, lines + points + 2 * lines * points), (same, 0), (one_line, 1 + 2 * points),
                             (one_point, 1 + 2 * (lines + 1))]:
            found = what["last"]
            if found["computed"] != wanted or found["failed"] or found["skipped"]:
                sys.exit(f"{lines} lines, {points} points: {wanted} units are to be computed, {found['computed']} are")
        packs = files.get("objects", 0) - lines
        return {
            "lines": lines, "points": points, "units": computed, "s": first["s"], "cpu": first["cpu"],
            "ms": 1e3 * first["s"] / computed, "cpu_ms": 1e3 * first["cpu"] / computed, "mb": first["mb"],
            "tables_s": first["last"]["tables"], "run_s": first["last"]["seconds"],
            "objects": files.get("objects", 0), "packs": packs, "versions": files.get("versions", 0),
            "other": files.get("sources", 0) + files.get(None, 0), "bytes": stored,
            "same_s": same["s"], "same_cpu": same["cpu"], "same_mb": same["mb"],
            "line_s": one_line["s"], "line_cpu": one_line["cpu"],
            "point_s": one_point["s"], "point_cpu": one_point["cpu"],
            "check_s": check["s"], "check_cpu": check["cpu"],
        }
    finally:
        shutil.rmtree(folder, ignore_errors=True)


COLUMNS = [
    ("lines", "lines", "{:,}"), ("points", "points", "{:,}"), ("units", "units", "{:,}"),
    ("first run, s", "s", "{:.2f}"),
    ("CPU s", "cpu", "{:.2f}"), ("ms a unit", "ms", "{:.3f}"), ("CPU ms a unit", "cpu_ms", "{:.3f}"),
    ("peak MB", "mb", "{:.0f}"), ("objects", "objects", "{:,}"), ("versions", "versions", "{:,}"),
    ("other", "other", "{:,}"),
    ("MB stored", "mb_stored", "{:.1f}"), ("unchanged, s (CPU)", "same", "{}"), ("one line more", "line", "{}"),
    ("one point more", "point", "{}"), ("check", "check", "{}"),
]


def head():
    print("| " + " | ".join(name for name, _, _ in COLUMNS) + " |")
    print("|" + "---|" * len(COLUMNS), flush=True)


def row(found):
    shown = {"mb_stored": found["bytes"] / 1e6} | found
    for what in ["same", "line", "point", "check"]:
        shown[what] = f"{found[what + '_s']:.2f} ({found[what + '_cpu']:.2f})"
    print("| " + " | ".join(form.format(shown[key]) for _, key, form in COLUMNS) + " |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--magline", default="target/debug/magline", help="the binary")
    parser.add_argument("--most", type=int, default=10**6, help="maximum of lines times points")
    parser.add_argument("--least", type=int, default=0, help="minimum of lines times points")
    parser.add_argument("--samples", type=int, default=600, help="samples of a line")
    parser.add_argument("--lines-a-file", type=int, default=20)
    parser.add_argument("--format", choices=["parquet", "csv"], default="parquet")
    parser.add_argument("--folder", help="the folder for temporary flights and stores; by default the temporary folder")
    parser.add_argument("--only", action="append", metavar="LINES,POINTS", help="run only this case; may be repeated")
    parser.add_argument("--raw", type=Path, help="append the measurements to this file, one JSON object per case")
    args = parser.parse_args()
    args.magline = str(Path(args.magline).resolve())
    cases = [(n, p) for n in LINES for p in POINTS if args.least <= n * p <= args.most]
    if args.only:
        cases = [tuple(int(x) for x in one.split(",")) for one in args.only]
    head()
    for lines, points in sorted(cases, key=lambda c: (c[0] * c[1], c[0])):
        found = case(args, lines, points)
        row(found)
        if args.raw:
            with args.raw.open("a") as raw:
                raw.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
