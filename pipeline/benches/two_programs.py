"""Processor time of two programs: the main job, an EKF in a sweep, SQL and ingest, run alternately. See README.md in
this folder."""

import argparse
import json
import os
import random
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "datasets/examples"
MAP = ROOT / "datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif"

TABLES = """
name  = "{name}"
seed  = 7
store = "store"
[tables.flights]
path = "{flights}"
[tables.anomaly]
path  = "{map}"
alt_m = 500.0
"""

COMPENSATION = """
[[stages]]
name    = "even"
stage   = "resample"
input   = "flights"
rate_hz = 10.0
[[stages]]
name   = "terms"
stage  = "a_matrix"
input  = "even"
vector = {vector}
[[stages]]
name   = "coefficients"
stage  = "fit"
input  = "terms"
where  = "line in ('1.01', '2.01', '3.01')"
model  = "tolles_lawson"
target = {mag}
lambda = {ridge}
[[stages]]
name  = "clean"
stage = "compensate"
input = "terms"
where = "line in ('1.02', '1.03', '2.02', '3.02')"
model = "coefficients"
mag   = {mag}
"""

NAVIGATION = """
[[stages]]
name                 = "track"
stage                = "navigate"
input                = "{clean}"
map                  = "anomaly"
filter               = "ekf"
map_interpolation    = "cubic"
measurement_sigma_nt = {sigma}
fogm_sigma_nt        = 3.0
fogm_tau_s           = 600.0
offset_window_s      = 1.0
{tuning}
[[stages]]
name    = "scores"
stage   = "score"
input   = ["{clean}", "track"]
truth   = "mag_1_c"
metrics = ["std_error", "drms", "nees", "nis"]
"""

QUERY = """SELECT mag, line, count(*) AS n, avg(mag_c) AS mean, stddev(mag_c - mag_1_c) AS sd, min(lat) AS south,
max(lon) AS east FROM main_job.clean WHERE lambda = 0.025 GROUP BY mag, line ORDER BY mag, line"""


class Program:
    """A program, its version of a spec, and its folder."""

    def __init__(self, path, name, folder):
        self.path, self.name, self.folder = str(Path(path).resolve()), name, folder / name
        self.folder.mkdir()
        # Versions before the key `tuning` have the values of MagNav.jl as defaults.
        known = subprocess.run([self.path, "stages", "navigate"], capture_output=True, text=True, check=True).stdout
        self.tuning = 'tuning = "magnav"' if "tuning" in known else ""

    def cpu_s(self, *what):
        """Processor time of a command, s."""
        with tempfile.TemporaryFile() as err, open(os.devnull, "wb") as out:
            files = [(os.POSIX_SPAWN_DUP2, out.fileno(), 1), (os.POSIX_SPAWN_DUP2, err.fileno(), 2)]
            arguments = [self.path, *map(str, what)]
            child = os.posix_spawn(self.path, arguments, os.environ, file_actions=files)
            _, status, used = os.wait4(child, 0)
            if os.waitstatus_to_exitcode(status) != 0:
                err.seek(0)
                sys.exit(f"{' '.join(arguments)} fails:\n{err.read().decode()}")
        return used.ru_utime + used.ru_stime

    def spec(self, name, text):
        path = self.folder / f"{name}.toml"
        path.write_text(text)
        return path

    def fresh(self, folder):
        """Path of a folder of the program that does not exist."""
        shutil.rmtree(self.folder / folder, ignore_errors=True)
        return self.folder / folder


def main_job(program, flights):
    """Specs of compensation and navigation for 27 combinations."""
    axes = """
[axes]
mag    = ["mag_1_uc", "mag_4_uc", "mag_5_uc"]
vector = ["flux_a", "flux_b", "flux_d"]
lambda = [0.0025, 0.025, 0.25]
"""
    text = TABLES.format(name="main_job", flights=flights, map=MAP) + axes
    text += COMPENSATION.format(vector='"$vector"', mag='"$mag"', ridge='"$lambda"')
    text += NAVIGATION.format(clean="clean", sigma=5.0, tuning=program.tuning)
    return program.spec("main_job", text)


def ekf_sweep(program, flights):
    """Spec of an EKF with 24 assumed noises on the signal of the stinger."""
    sigmas = ", ".join(f"{0.5 * 1.2 ** k:.3f}" for k in range(24))
    text = TABLES.format(name="ekf", flights=flights, map=MAP) + f"[axes]\nsigma = [{sigmas}]\n"
    text += """
[[stages]]
name  = "clean"
stage = "derive"
input = "flights"
where = "line in ('1.02', '1.03', '2.02', '3.02')"
units = { mag_c = "nT" }
[stages.columns]
mag_c = "mag_1_uc"
"""
    text += NAVIGATION.format(clean="clean", sigma='"$sigma"', tuning=program.tuning)
    return program.spec("ekf", text)


def csv(program, flights, path):
    """Flights as a CSV file, written by a query of the program."""
    spec = TABLES.format(name="rows", flights=flights, map=MAP)
    columns = ["flight", "line", "tt", "lat", "lon", "alt", "mag_1_uc", "mag_4_uc", "mag_5_uc", "flux_a_x", "flux_a_y",
               "flux_a_z"]
    spec += f'[[stages]]\nname = "all"\nstage = "select"\ninput = "flights"\ncolumns = {json.dumps(columns[3:])}\n'
    store = program.fresh("rows")
    program.cpu_s("run", program.spec("rows", spec), "--set", f"store={store}", "--quiet")
    query = f"SELECT {', '.join(columns)} FROM rows.all ORDER BY flight, line, tt"
    program.cpu_s("sql", query, "--store", store, "--format", "csv", "-o", path)


def interval(ratios):
    """Median and its 95 % interval, by 2000 resamplings of the rounds."""
    draws = random.Random(1)
    medians = sorted(statistics.median(draws.choices(ratios, k=len(ratios))) for _ in range(2000))
    return statistics.median(ratios), medians[49], medians[1949]


def measured(rounds, first, second, work):
    """Times of both programs in each round. The order of the programs alternates between rounds."""
    times = []
    for number in range(rounds + 1):
        order = [first, second] if number % 2 else [second, first]
        taken = {program.name: work(program) for program in order}
        # The first round fills the caches of the file system.
        if number > 0:
            times.append((taken[first.name], taken[second.name]))
    return times


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("first", help="the program to compare with, such as that of an earlier commit")
    parser.add_argument("second", help="the program to test")
    parser.add_argument("--rounds", type=int, default=10,
                        help="number of runs of each program, after one without measurement")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--limit", type=float, default=1.05, help="largest permitted ratio of second to first")
    parser.add_argument("--only", nargs="+", choices=["main", "ekf", "sql", "ingest"],
                        default=["main", "ekf", "sql", "ingest"])
    parser.add_argument("--folder", default=tempfile.gettempdir(), help="the folder for temporary files")
    parser.add_argument("--raw", type=Path, help="write the times to this file, as JSON")
    args = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="two-", dir=args.folder))
    try:
        first, second = Program(args.first, "first", folder), Program(args.second, "second", folder)
        flights = folder / "flights"
        first.cpu_s("synth", EXAMPLES / "magline-bench.synth.toml", "--to", flights)
        table = folder / "rows.csv"
        csv(first, flights, table)

        def run(spec):
            def work(program):
                store = program.fresh("store")
                return program.cpu_s("run", spec(program, flights), "--set", f"store={store}", "--threads",
                                     args.threads, "--quiet")
            return work

        for program in (first, second):
            program.cpu_s("run", main_job(program, flights), "--set", f"store={program.folder / 'queried'}", "--quiet")
        works = {
            "main": run(main_job),
            "ekf": run(ekf_sweep),
            "sql": lambda program: program.cpu_s("sql", QUERY, "--store", program.folder / "queried"),
            "ingest": lambda program: program.cpu_s("ingest", table, "--to", program.fresh("ingested")),
        }
        print("| job | first, s | second, s | second / first, median | 95 % interval |\n|:--|--:|--:|--:|:--|")
        raw, slower = {}, []
        for name in args.only:
            raw[name] = times = measured(args.rounds, first, second, works[name])
            ratio, low, high = interval([b / a for a, b in times])
            a, b = (statistics.median(t) for t in zip(*times))
            print(f"| {name} | {a:.3f} | {b:.3f} | {ratio:.3f} | {low:.3f} to {high:.3f} |", flush=True)
            if low > args.limit:
                slower.append(name)
        if args.raw:
            args.raw.write_text(json.dumps(raw))
        if slower:
            sys.exit(f"slower than {args.limit:g} times the first program: {', '.join(slower)}")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
