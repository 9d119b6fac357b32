#!/usr/bin/env python3
"""What a cluster costs beside the work, and how much faster two workers of one core are than one.

    python pipeline/benches/cluster.py --magline target/debug/magline

The binary is one with the feature `cluster`. Processor seconds are those of scheduler, workers, their processes and the run, by
`rusage`; what an idle cluster takes is taken off. Every way must end with the same published bytes, which is checked.
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
from tasks import by_tasks, processor, published

class Cluster:
    """A scheduler and some workers of one core."""

    def __init__(self, binary, folder, workers):
        self.scheduler = subprocess.Popen(
            [binary, "scheduler", "--bind", "127.0.0.1:0"], cwd=folder, stderr=subprocess.PIPE, text=True
        )
        line = self.scheduler.stderr.readline()
        self.at = line.split("listens on ")[1].strip()
        worker = [binary, "worker", "--scheduler", self.at, "--cores", "1", "--quiet"]
        self.receipts = [open(Path(folder) / f"worker{i}.jsonl", "w+") for i in range(workers)]
        self.workers = [
            subprocess.Popen([*worker, "--store", "cluster"], cwd=folder, stdout=out, stderr=subprocess.DEVNULL)
            for out in self.receipts
        ]

    def end(self):
        """Ends all, and returns the number of receipts."""
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
    run = [binary, "run", "growth.toml", "--json", "--set", "store=cluster", "--engine", f"ballista://{cluster.at}"]
    done = subprocess.run(run, cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    clock = time.monotonic() - begun
    tasks = cluster.end()
    if done.returncode != 0:
        raise SystemExit(done.stderr)
    return spent() - before, clock, tasks


def idle(binary, folder, workers, seconds):
    """Processor seconds of a cluster that has nothing to do."""
    before = spent()
    cluster = Cluster(binary, folder, workers)
    time.sleep(seconds)
    cluster.end()
    return spent() - before


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--magline", required=True)
    parser.add_argument("--lines", type=int, nargs="+", default=[100, 1000])
    parser.add_argument("--points", type=int, default=10)
    parser.add_argument("--samples", type=int, default=600)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--folder", help="where stores are made")
    args = parser.parse_args()
    binary = str(Path(args.magline).resolve())
    print("| lines | units | way | CPU s | clock s | tasks | CPU s beside the work | ms a task | beside, % of the work |")
    print("|---" * 9 + "|")
    for lines in args.lines:
        with tempfile.TemporaryDirectory(prefix="cluster-", dir=args.folder) as name:
            folder = Path(name)
            (folder / "flights").mkdir()
            write(folder / "flights", 0, lines, 10, args.samples, "parquet")
            spec(folder, args.points)
            run = [binary, "run", "growth.toml", "--json", "--threads", "1", "--set"]
            begun = time.monotonic()
            local, out = processor([*run, "store=local"], folder)
            clock = time.monotonic() - begun
            units = json.loads(out.splitlines()[-1])["computed"]
            print(f"| {lines} | {units} | local, one thread | {local:.2f} | {clock:.2f} | | | | |", flush=True)

            def row(way, cpu, clock, tasks):
                beside = cpu - local
                each = f"{1000 * beside / tasks:.1f}" if tasks else ""
                took = f"{clock:.2f}" if clock else ""
                percent = 100 * beside / local
                print(
                    f"| {lines} | {units} | {way} | {cpu:.2f} | {took} | {tasks} | {beside:.2f} | {each} | {percent:.0f} |",
                    flush=True,
                )

            begun = time.monotonic()
            cpu, _ = processor([*run, "store=processes", "--engine", "processes"], folder)
            row("processes, one", cpu, time.monotonic() - begun, "")
            plan, work, publish, tasks = by_tasks(binary, folder, "one", None, False)
            row("verb, one process a wave", plan + work + publish, 0, tasks)
            plan, work, publish, tasks = by_tasks(binary, folder, "own", None, True)
            row("verb, a process a task", plan + work + publish, 0, tasks)
            stores = ["local", "processes", "one", "own"]
            for workers in args.workers:
                subprocess.run(["rm", "-rf", "cluster"], cwd=folder, check=True)
                cpu, clock, tasks = on_cluster(binary, folder, workers)
                rest = idle(binary, folder, workers, 3 + clock)
                row(f"cluster, {workers} x 1 core", cpu - rest, clock, tasks)
                assert published(folder, "local") == published(folder, "cluster"), "bytes differ"
            assert len({published(folder, s) for s in stores}) == 1, "bytes differ"


if __name__ == "__main__":
    main()
