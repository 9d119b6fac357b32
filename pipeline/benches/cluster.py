#!/usr/bin/env python3
"""Overhead of a cluster, and speed of two workers of one core relative to one.

    python pipeline/benches/cluster.py --magline target/debug/magline

The binary must have the feature `cluster`. Processor time is that of scheduler, workers, their processes and the run,
by `rusage`, minus that of an idle cluster. Everything except the cluster of two workers runs on one processor, because
two threads of one core use more processor time for the same work. The methods alternate, and the minimum of each
counts, because other programs on the machine can only increase the time. The published bytes of all methods are
compared.
"""

import argparse
import json
import resource
import signal
import subprocess
import tempfile
import time
from pathlib import Path

from growth import spec, write
from tasks import PINNED, by_tasks, processor, published


class Cluster:
    """A scheduler and some workers of one core."""

    def __init__(self, binary, folder, workers):
        self.pinned = PINNED if workers == 1 else []
        self.scheduler = subprocess.Popen(
            [*self.pinned, binary, "scheduler", "--insecure-loopback", "--bind", "127.0.0.1:0"], cwd=folder,
            stderr=subprocess.PIPE, text=True
        )
        line = self.scheduler.stderr.readline()
        self.at = line.split("listens on ")[1].strip()
        worker = [*self.pinned, binary, "worker", "--insecure-loopback", "--scheduler", self.at, "--cores", "1",
                  "--quiet"]
        self.receipts = [open(Path(folder) / f"worker{i}.jsonl", "w+") for i in range(workers)]
        self.workers = [
            subprocess.Popen([*worker, "--store", "cluster"], cwd=folder, stdout=out, stderr=subprocess.DEVNULL)
            for out in self.receipts
        ]

    def end(self):
        """Ends all processes, and returns the number of receipts."""
        count = 0
        for child, out in zip(self.workers, self.receipts):
            child.send_signal(signal.SIGTERM)
            child.wait()
            out.seek(0)
            count += len(out.readlines())
            out.close()
        self.scheduler.send_signal(signal.SIGTERM)
        self.scheduler.stderr.close()
        self.scheduler.wait()
        return count


def spent():
    """Processor seconds of all children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def on_cluster(binary, folder, workers):
    """Processor and clock seconds of a run on a cluster, and its tasks."""
    before = spent()
    cluster = Cluster(binary, folder, workers)
    time.sleep(3)
    begun = time.monotonic()
    run = [*cluster.pinned, binary, "run", "growth.toml", "--json", "--set", "store=cluster", "--engine",
           f"ballista://{cluster.at}", "--insecure-loopback"]
    done = subprocess.run(run, cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    clock = time.monotonic() - begun
    tasks = cluster.end()
    if done.returncode != 0:
        raise SystemExit(done.stderr)
    return spent() - before, clock, tasks


def idle(binary, folder, workers, seconds):
    """Processor time of an idle cluster, s."""
    before = spent()
    cluster = Cluster(binary, folder, workers)
    time.sleep(seconds)
    cluster.end()
    return spent() - before


def once(binary, folder, workers):
    """Each method with its processor time, elapsed time and number of tasks, and the number of units."""
    run = [binary, "run", "growth.toml", "--json", "--threads", "1", "--set"]
    found = {}
    units = 0

    def local():
        nonlocal units
        cpu, out = processor([*run, "store=local"], folder)
        units = json.loads(out.splitlines()[-1])["computed"]
        return cpu, 0

    def timed(way, work):
        begun = time.monotonic()
        cpu, tasks = work()
        found[way] = (cpu, time.monotonic() - begun, tasks)

    def verb(store, one_by_one):
        plan, work, publish, tasks = by_tasks(binary, folder, store, None, one_by_one)
        return plan + work + publish, tasks

    timed("local, one thread", local)
    timed("processes, one", lambda: (processor([*run, "store=processes", "--engine", "processes"], folder)[0], 0))
    timed("verb, one process a wave", lambda: verb("one", False))
    timed("verb, a process a task", lambda: verb("own", True))
    assert len({published(folder, s) for s in ["local", "processes", "one", "own"]}) == 1, "bytes differ"
    for count in workers:
        cpu, clock, tasks = on_cluster(binary, folder, count)
        rest = idle(binary, folder, count, 3 + clock)
        found[f"cluster, {count} x 1 core"] = (cpu - rest, clock, tasks)
        assert published(folder, "local") == published(folder, "cluster"), "bytes differ"
        subprocess.run(["rm", "-rf", "cluster"], cwd=folder, check=True)
    subprocess.run(["rm", "-rf", "local", "processes", "one", "own"], cwd=folder, check=True)
    return units, found


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--magline", required=True)
    parser.add_argument("--lines", type=int, nargs="+", default=[100, 1000])
    parser.add_argument("--points", type=int, default=10)
    parser.add_argument("--samples", type=int, default=600)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--folder", help="the folder for stores")
    args = parser.parse_args()
    binary = str(Path(args.magline).resolve())
    print("| units | way | CPU s, of each | clock s | tasks | CPU s beside the work | ms a task | beside, % of the "
          "work |")
    print("|---" * 8 + "|")
    for lines in args.lines:
        with tempfile.TemporaryDirectory(prefix="cluster-", dir=args.folder) as name:
            folder = Path(name)
            (folder / "flights").mkdir()
            write(folder / "flights", 0, lines, 10, args.samples, "parquet")
            spec(folder, args.points)
            rounds = [once(binary, folder, args.workers) for _ in range(args.repeats)]
        units = rounds[0][0]
        local = min(found["local, one thread"][0] for _, found in rounds)
        for way in rounds[0][1]:
            all_cpu = [found[way][0] for _, found in rounds]
            clock, tasks = min(found[way][1] for _, found in rounds), rounds[0][1][way][2]
            beside = min(all_cpu) - local
            each = f"{1000 * beside / tasks:.1f}" if tasks else ""
            seconds = ", ".join(f"{cpu:.2f}" for cpu in all_cpu)
            print(f"| {units} | {way} | {seconds} | {clock:.1f} | {tasks or ''} | {beside:.2f} | {each} | "
                  f"{100 * beside / local:.0f} |")


if __name__ == "__main__":
    main()
