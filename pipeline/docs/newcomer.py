#!/usr/bin/env python3
"""Walks the path of a new user, from the commands of the README to pictures of an own flight: newcomer.py PROGRAM

PROGRAM is the program `magline`. The commands run in a temporary folder with a copy of `datasets/`:

1. the README's first command, without the build, and the commands of its picture;
2. a simulated flight, written as a CSV file with the column names of a logger, `flight.csv`, and a map, `map.tif`;
3. the README's commands for an own log, and the figures of the report.

The simulation knows the true field and position, which are not in `flight.csv`. The result is compared with them. The
output lists the time of each command, and the number of commands and errors. The exit status is 1 after an error.
"""

import bisect
import csv
import datetime
import math
import os
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path

from check import BLOCK, DOCS, REPOSITORY, run, steps

# A calibration box and a survey line of 15 min over the Osborne map.
SYNTH = """
preset = "cessna"
seed   = 3
year   = 2024
doy    = 100

[map]
path  = "datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif"
alt_m = 500.0

[ins]
grade = "navigation"

[[flights]]
name       = "1"
start_tt_s = 36000.0

[[flights.lines]]
name  = "box"
kind  = "box"
alt_m = 3000.0
start = [-21.99, 140.63]

[[flights.lines]]
name       = "survey"
kind       = "survey"
alt_m      = 500.0
duration_s = 900.0
waypoints  = [[-22.10, 140.58], [-21.84, 140.58], [-21.84, 140.78]]
"""

SPEC = """
name  = "made"
store = "store"

[tables.flights]
path = "made"

[[stages]]
name    = "log"
stage   = "select"
input   = "flights"
columns = [
    "lat", "lon", "alt", "ins_lat", "ins_lon", "ins_alt", "ins_vn", "ins_ve", "ins_vd", "ins_roll", "ins_pitch",
    "ins_yaw", "ins_aligned", "mag_5_uc", "flux_d_x", "flux_d_y", "flux_d_z",
]

[[stages]]
name    = "truth"
stage   = "select"
input   = "flights"
columns = ["lat", "lon", "mag_1_c"]
"""
# Column of magline, and its name in the log. The log has a time stamp in place of `tt`, `year` and `doy`.
NAMES = {
    "line": "line", "lat": "GPS Lat", "lon": "GPS Lon", "alt": "GPS ellipsoid height m", "ins_lat": "INS Lat",
    "ins_lon": "INS Lon", "ins_alt": "ins_alt", "ins_vn": "INS VN m/s", "ins_ve": "INS VE m/s", "ins_vd": "INS VD m/s",
    "ins_roll": "Roll", "ins_pitch": "Pitch", "ins_yaw": "Yaw", "ins_aligned": "ins_aligned",
    "mag_5_uc": "Cabin mag", "flux_d_x": "Flux X", "flux_d_y": "Flux Y", "flux_d_z": "Flux Z",
}
MIDNIGHT = datetime.datetime(2024, 4, 9)


class Walk:
    """Runs commands in a folder, with their times and errors."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.count, self.seconds, self.errors = 0, 0.0, 0

    def command(self, text: str) -> None:
        start = time.monotonic()
        output, status = run(text, self.folder)
        taken = time.monotonic() - start
        self.count, self.seconds = self.count + 1, self.seconds + taken
        print(f"{taken:7.1f} s  {text}", flush=True)
        if status != 0:
            self.fail(f"exit status {status}\n{output}")

    def fail(self, what: str) -> None:
        self.errors += 1
        print(f"  error: {what}")

    def expect(self, what: str, value: float, least: float, most: float) -> None:
        print(f"           {what}: {value:.4g}")
        if not least <= value <= most:
            self.fail(f"{what} is not in the range {least:g} to {most:g}")


def readme() -> tuple[list[str], list[str]]:
    """Returns the commands of the README: of its example with the picture, and for an own log."""
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    first = re.search(r"(?m)^cargo run -- (.*)$", text)
    own = re.search(r"(?ms)^## Your own log$.*?^```sh\n(.*?)^```", text)
    picture = next(m["body"] for m in BLOCK.finditer(text) if m["info"] == "console")
    if first is None or own is None:
        raise SystemExit("error: the README has no first command, or no commands for an own log")
    return ["magline " + first[1], *(command for command, _ in steps(picture))], own[1].splitlines()


def own_data(walk: Walk) -> None:
    """Writes `flight.csv` and `map.tif`."""
    (walk.folder / "flight.synth.toml").write_text(SYNTH, encoding="utf-8")
    (walk.folder / "made.toml").write_text(SPEC, encoding="utf-8")
    walk.command("magline synth flight.synth.toml --to made")
    walk.command("magline run made.toml --quiet")
    walk.command("magline export made.log -o made.csv")
    walk.command("magline export made.truth -o truth.csv")
    rows = list(csv.DictReader((walk.folder / "made.csv").open(encoding="utf-8")))
    with (walk.folder / "flight.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["UTC", *NAMES.values()])
        for row in rows:
            instant = MIDNIGHT + datetime.timedelta(seconds=float(row["tt"]))
            writer.writerow([instant.isoformat(timespec="milliseconds"), *(row[name] for name in NAMES)])
    shutil.copyfile(REPOSITORY / "datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif", walk.folder / "map.tif")


def deviation(values: list[float]) -> float:
    mean = sum(values) / len(values)
    return math.sqrt(sum((x - mean) ** 2 for x in values) / len(values))


def rows(walk: Walk, table: str) -> list[dict[str, str]]:
    """Exports a table of the pipeline `flight`, and returns its rows on the survey line."""
    walk.command(f"magline export flight.{table} -o {table}.csv")
    with (walk.folder / f"{table}.csv").open(encoding="utf-8") as file:
        return [row for row in csv.DictReader(file) if row["line"] == "survey"]


def compared(walk: Walk) -> None:
    """Compares the compensated field and the track with the simulation."""
    with (walk.folder / "truth.csv").open(encoding="utf-8") as file:
        truth = {round(float(row["tt"]), 1): row for row in csv.DictReader(file) if row["line"] == "survey"}
    before, after, squares = [], [], []
    for row in rows(walk, "clean"):
        if true := truth.get(round(float(row["tt"]), 1)):
            before.append(float(row["mag_1_uc"]) - float(true["mag_1_c"]))
            after.append(float(row["mag_c"]) - float(true["mag_1_c"]))
    walk.expect("samples of the survey line", len(after), 9000, 9001)
    walk.expect("error before compensation, nT", deviation(before), 20.0, 200.0)
    walk.expect("error after compensation, nT", deviation(after), 0.1, 10.0)
    # The log is resampled to other times, between which the aircraft moves by metres.
    path = [tuple(float(row[name]) for name in ("tt", "lat", "lon")) for row in truth.values()]
    times = [tt for tt, *_ in path]
    for row in rows(walk, "track"):
        tt = float(row["tt"])
        after_tt = bisect.bisect_left(times, tt)
        if 0 < after_tt < len(path):
            (tt_0, *from_deg), (tt_1, *to_deg) = path[after_tt - 1], path[after_tt]
            share = (tt - tt_0) / (tt_1 - tt_0)
            lat, lon = (a + share * (b - a) for a, b in zip(from_deg, to_deg, strict=True))
            # Metres per degree at 22 degrees south.
            north = (float(row["lat"]) - lat) * 110_730.0
            east = (float(row["lon"]) - lon) * 103_284.0
            squares.append(north**2 + east**2)
    drms = math.sqrt(sum(squares) / len(squares))
    walk.expect("DRMS, m", drms, 5.0, 60.0)
    walk.command('magline sql "SELECT metric, value FROM flight.position" --format csv -o position.csv')
    with (walk.folder / "position.csv").open(encoding="utf-8") as file:
        scores = {row["metric"]: float(row["value"]) for row in csv.DictReader(file)}
    walk.expect("DRMS of the score divided by this DRMS", scores["drms"] / drms, 0.99, 1.01)
    walk.expect("DRMS of the INS alone, m", scores["ins_drms"], 500.0, 5000.0)
    walk.expect("NEES", scores["nees"], 0.2, 20.0)


def main() -> int:
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    example, own = readme()
    with tempfile.TemporaryDirectory() as name:
        walk = Walk(Path(name))
        shutil.copytree(REPOSITORY / "datasets", walk.folder / "datasets", ignore=shutil.ignore_patterns("store"))
        shutil.copytree(DOCS, walk.folder / "pipeline/docs", ignore=shutil.ignore_patterns("__pycache__"))
        (walk.folder / ".bin").mkdir()
        (walk.folder / ".bin/magline").symlink_to(os.path.abspath(sys.argv[1]))
        print("The main example and its picture")
        for command in example:
            walk.command(command)
        print("A log, which a user already has")
        own_data(walk)
        print("The own log")
        for command in own:
            walk.command(command)
        walk.command("magline report flight.toml --figures figures")
        figures = list((walk.folder / "figures").glob("*.svg"))
        walk.expect("figures", len(figures), 1, 100)
        compared(walk)
        print(f"{walk.count} commands, {walk.errors} errors, {walk.seconds:.0f} s")
        return 1 if walk.errors else 0


if __name__ == "__main__":
    raise SystemExit(main())
