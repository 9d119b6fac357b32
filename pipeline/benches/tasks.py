#!/usr/bin/env python3
"""Overhead of a task: `magline task` with one process per task, with many tasks in one process, and the engine
`processes`.

    python pipeline/benches/tasks.py --magline target/debug/magline

Processor time is that of the children by `rusage`, on one processor, because two threads of one core use more processor
time for the same work. The published bytes of all methods are compared.
"""

import argparse
import hashlib
import json
import resource
import subprocess
import tempfile
from pathlib import Path

from growth import spec, write


# Command prefix that limits a command to one processor.
PINNED = ["taskset", "--cpu-list", "0"]


def processor(command, folder, stdin=""):
    """Processor seconds of a command and its children on one processor, and its output."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [*PINNED, *command]
    done = subprocess.run(command, cwd=folder, input=stdin, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)} fails:\n{done.stderr}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done.stdout


def published(folder, store):
    """The hash of all published files of a store."""
    files = sorted((folder / store / "tables" / "growth").rglob("*.parquet"))
    hashes = [f"{f.relative_to(folder / store)} {hashlib.sha256(f.read_bytes()).hexdigest()}" for f in files]
    return hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def by_tasks(binary, folder, store, units, one_by_one):
    """Processor time of planning, computing and publishing, s, and the number of tasks of `units` units (or the
    default)."""
    plan, work, tasks = 0.0, 0.0, 0
    while True:
        most = [] if units is None else ["--units", str(units)]
        seconds, lines = processor([binary, "tasks", "growth.toml", "--set", f"store={store}", *most], folder)
        plan += seconds
        wave = lines.splitlines()
        tasks += len(wave)
        if not wave:
            break
        for text in wave if one_by_one else [lines]:
            seconds, _ = processor([binary, "task", "--store", store, "--threads", "1"], folder, text + "\n")
            work += seconds
    publish, out = processor([binary, "run", "growth.toml", "--set", f"store={store}", "--json"], folder)
    assert json.loads(out.splitlines()[-1])["computed"] == 0
    return plan, work, publish, tasks


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--magline", required=True)
    parser.add_argument("--lines", type=int, nargs="+", default=[10, 100, 1000])
    parser.add_argument("--points", type=int, default=10)
    parser.add_argument("--units", type=int, help="number of units of a task; by default chosen by `magline tasks`")
    parser.add_argument("--folder", help="the folder for stores")
    args = parser.parse_args()
    binary = str(Path(args.magline).resolve())
    print("| lines | units | tasks | local run, CPU s | engine processes | one process: plan, work, publish | a "
          "process a task: work | ms a task, one process | ms a task, own process |")
    print("|---" * 9 + "|")
    for lines in args.lines:
        with tempfile.TemporaryDirectory(prefix="tasks-", dir=args.folder) as name:
            folder = Path(name)
            (folder / "flights").mkdir()
            write(folder / "flights", 0, lines, 10, 600, "parquet")
            spec(folder, args.points)
            run = [binary, "run", "growth.toml", "--json", "--threads", "1", "--set"]
            local, out = processor([*run, "store=local"], folder)
            units = json.loads(out.splitlines()[-1])["computed"]
            processes, _ = processor([*run, "store=processes", "--engine", "processes"], folder)
            plan, work, publish, tasks = by_tasks(binary, folder, "one", args.units, False)
            _, own, _, tasks_own = by_tasks(binary, folder, "own", args.units, True)
            assert tasks == tasks_own
            assert len({published(folder, s) for s in ["local", "processes", "one", "own"]}) == 1, "bytes differ"
            beside = 1000 * (own - work) / tasks
            first = 1000 * (plan + work + publish - local) / tasks
            print(f"| {lines} | {units} | {tasks} | {local:.2f} | {processes:.2f} | {plan:.2f}, {work:.2f}, "
                  f"{publish:.2f} | {own:.2f} | {first:.1f} | {first + beside:.1f} |")


if __name__ == "__main__":
    main()
