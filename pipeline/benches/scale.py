"""Cost of a store with thousands of flights, one per file: time and memory of every command, and the files of the
store. See SCALE.md in the parent folder."""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

QUERIES = {
    "sql count": "SELECT count(*) FROM growth.clean",
    "sql one line": "SELECT avg(mag_c) FROM growth.clean WHERE line = '00003'",
    "sql all lines": "SELECT line, stddev(mag_c - mag_1_c) FROM growth.clean GROUP BY line ORDER BY 2 DESC LIMIT 5",
    "sql scores": "SELECT avg(value) FROM growth.scores",
}


def flights(args, folder, first, last):
    """Flights and spec, made by another process: the peak memory of a child is at least that of its parent."""
    work = (f"import growth, pathlib; f = pathlib.Path({str(folder)!r}); growth.spec(f, 1); "
            f"growth.write(f / 'flights', {first}, {last}, {args.lines_a_file}, {args.samples}, 'parquet')")
    subprocess.run([sys.executable, "-c", work], check=True, cwd=Path(__file__).parent)


def command(args, *what):
    """Elapsed time, processor time (s) and peak memory (MB) of the best of several runs of a command."""
    best = None
    for _ in range(args.repeat):
        with tempfile.TemporaryFile() as err, open(os.devnull, "wb") as out:
            begun = time.perf_counter()
            files = [(os.POSIX_SPAWN_DUP2, out.fileno(), 1), (os.POSIX_SPAWN_DUP2, err.fileno(), 2)]
            child = os.posix_spawn(args.magline, [args.magline, *map(str, what)], os.environ, file_actions=files)
            _, status, used = os.wait4(child, 0)
            taken = time.perf_counter() - begun
            if os.waitstatus_to_exitcode(status) != 0:
                err.seek(0)
                sys.exit(f"magline {' '.join(map(str, what))} fails:\n{err.read().decode()}")
        found = {"s": taken, "cpu": used.ru_utime + used.ru_stime, "mb": used.ru_maxrss / 1024}
        best = min([found] + ([best] if best else []), key=lambda f: f["cpu"])
        if what[0] in ("run", "gc"):
            break
    return best


def store_of(store):
    """Files and bytes by folder, of distinct files, and inodes and bytes of all names."""
    seen, found = set(), {}
    for part in ["objects", "versions", "sources", "quality", "plans", "runs", "costs", "index"]:
        names, count, size = 0, 0, 0
        root = store / part
        files = [root] if root.is_file() else (Path(f) / n for f, _, ns in os.walk(root) for n in ns)
        for file in files:
            about = os.lstat(file)
            names += 1
            if about.st_ino not in seen:
                seen.add(about.st_ino)
                count, size = count + 1, size + about.st_size
        found[part] = {"names": names, "files": count, "bytes": size}
    return found


def case(args, lines):
    folder = Path(tempfile.mkdtemp(prefix="scale-", dir=args.folder))
    try:
        (folder / "flights").mkdir()
        flights(args, folder, 0, lines)
        spec, store = folder / "growth.toml", folder / "store"
        found = {"lines": lines}
        found["check"] = command(args, "check", spec)
        found["first run"] = command(args, "run", "--quiet", spec)
        found["store"] = store_of(store)
        found["explain"] = command(args, "explain", spec)
        found["run, unchanged"] = command(args, "run", "--quiet", spec)
        flights(args, folder, lines, lines + args.lines_a_file)
        found["run, a flight more"] = command(args, "run", "--quiet", spec)
        found["store, a flight more"] = store_of(store)
        for name, query in QUERIES.items():
            found[name] = command(args, "sql", query, "--store", store)
        found["ls"] = command(args, "ls", "--store", store)
        found["lineage"] = command(args, "lineage", "growth.scores", "--store", store, "--format", "json")
        found["tasks, none left"] = command(args, "tasks", "--quiet", spec)
        found["gc"] = command(args, "gc", "--yes", "--store", store)
        found["verify"] = command(args, "verify", "--store", store)
        return found
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def show(rows):
    lines = [r["lines"] for r in rows]
    print("| | " + " | ".join(f"{n:,}" for n in lines) + " |")
    print("|" + "---|" * (len(lines) + 1))
    for name, value in rows[0].items():
        if name != "lines" and not name.startswith("store"):
            cells = [f"{r[name]['cpu']:.2f} ({r[name]['s']:.2f}), {r[name]['mb']:.0f} MB" for r in rows]
            print(f"| {name} | " + " | ".join(cells) + " |")
        elif name.startswith("store"):
            for part in value:
                one = lambda r: r[name][part]
                cells = [f"{one(r)['names']:,} names, {one(r)['files']:,} files, {one(r)['bytes'] / 1e6:.2f} MB"
                         for r in rows]
                print(f"| {name}: {part} | " + " | ".join(cells) + " |")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--magline", default="target/debug/magline", help="the binary")
    parser.add_argument("--lines", type=int, nargs="+", default=[10, 100, 1000, 10000])
    parser.add_argument("--samples", type=int, default=60, help="samples of a line")
    parser.add_argument("--lines-a-file", type=int, default=1)
    parser.add_argument("--repeat", type=int, default=3, help="number of runs of read-only commands; the best counts")
    parser.add_argument("--folder", default=tempfile.gettempdir(), help="the folder for temporary flights and stores")
    parser.add_argument("--raw", type=Path, help="append the measurements to this file, one JSON object per case")
    args = parser.parse_args()
    args.folder = str(Path(args.folder).resolve())
    args.magline = str(Path(args.magline).resolve())
    rows = []
    for lines in args.lines:
        rows.append(case(args, lines))
        if args.raw:
            with args.raw.open("a") as raw:
                raw.write(json.dumps(rows[-1]) + "\n")
    show(rows)


if __name__ == "__main__":
    main()
