"""Predictions of `magline explain --cost` compared with runs of the examples in empty stores and of a thousand
simulated lines. Also measures the built-in records again. See README.md in this folder."""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ["tolles_lawson", "navigation", "osborne", "map", "retention", "gnadt_2022", "van_der_meer_2025",
            "survey_to_map", "monte_carlo", "cold_start", "second_aircraft", "gnadt_2022_second_aircraft",
            "lee_2019_calibration", "uav", "search", "real_sensors", "gnadt_2022_networks"]


def specs(names):
    """Name and file of each spec."""
    found = {}
    for name in names:
        own = ROOT / "pipeline/benches/costs" / f"{name}.toml"
        found[name] = own if own.exists() else ROOT / "datasets/examples" / f"{name}.toml"
    return found


def size(store):
    """Bytes of the packs of a store."""
    return sum(f.stat().st_size for f in (Path(store) / "objects").rglob("*.parquet"))


def children():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run(magline, spec, store, sets, threads):
    """Processor time, elapsed time, bytes added and peak memory of a run, after the estimate."""
    more = [x for s in [f"store={store}", *sets] for x in ("--set", s)]
    asked = [magline, "explain", str(spec), "--cost", "--format", "json", "--threads", str(threads), *more]
    told = json.loads(subprocess.run(asked, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL).stdout)
    before, cpu, clock = size(store), children(), time.monotonic()
    child = subprocess.Popen([magline, "run", str(spec), "--quiet", "--threads", str(threads), *more],
                             stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    if status != 0:
        print(f"{spec} ended with {status}", file=sys.stderr)
    taken = {"processor_s": used.ru_utime + used.ru_stime, "clock_s": time.monotonic() - clock,
             "bytes": size(store) - before, "memory_bytes": used.ru_maxrss * 1024}
    return told, taken


def records(store):
    """The records of the tables that were measured in a store."""
    found = []
    for file in sorted((Path(store) / "costs").glob("*.json")):
        found += json.loads(file.read_text().splitlines()[1])
    return found


def digits(x):
    """Rounds to four digits, more than a measurement has."""
    if isinstance(x, dict):
        return {k: digits(v) for k, v in x.items()}
    if isinstance(x, list):
        return [digits(v) for v in x]
    return float(f"{x:.4g}") if isinstance(x, float) else x


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*", default=EXAMPLES)
    parser.add_argument("--magline", default=str(ROOT / "target/debug/magline"))
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--set", action="append", default=[], help="as for `magline run`, for all specs")
    parser.add_argument("--measure", metavar="FILE", help="write the measurements to FILE; with --add, append them")
    parser.add_argument("--add", action="store_true", help="keep the existing content of FILE")
    options = parser.parse_args()
    print("| spec | units | MB predicted | written | ratio | processor s predicted | used | ratio | clock s predicted "
          "| taken | ratio | memory MB predicted | used |")
    print("|" + "---|" * 13)
    measured = []
    for name, spec in specs(options.names).items():
        with tempfile.TemporaryDirectory() as store:
            told, taken = run(options.magline, spec, store, options.set, options.threads)
            units = sum(t["compute"] for t in told["tables"])
            row = [name, f"{units:,}"]
            for key, unit, form in [("bytes", 1e6, ".2f"), ("processor_s", 1, ".2f"), ("clock_s", 1, ".2f")]:
                predicted, real = told[key] / unit, taken[key] / unit
                row += [f"{predicted:{form}}", f"{real:{form}}", f"{predicted / real:.2f}" if real else "-"]
            row += [f"{told['memory_bytes'] / 1e6:.0f}", f"{taken['memory_bytes'] / 1e6:.0f}"]
            print("| " + " | ".join(row) + " |", flush=True)
            measured += records(store)
    if options.measure:
        file = Path(options.measure)
        if options.add:
            measured = json.loads(file.read_text()) + measured
        file.write_text("[\n" + ",\n".join(json.dumps(digits(m), separators=(",", ":")) for m in measured) + "\n]\n")


if __name__ == "__main__":
    main()
