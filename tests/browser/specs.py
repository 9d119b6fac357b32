"""Writes the specs of the browser tests and their data: `python specs.py FOLDER REPOSITORY`."""

import csv
import json
import math
import random
import sys
from pathlib import Path

LINE = "</script><b id='injected'>\"&amp;\u202eevil"
AXIS = "line <> '</script><b id=injected>\"\u202e'"

HOSTILE = """
name = "hostile"
store = "store"
[tables.flights]
path = "flights.csv"
[axes]
kept = [{axis}, "line <> ''"]
lambda = [0.0, 0.1]
[[stages]]
name = "terms"
stage = "a_matrix"
input = "flights"
vector = "flux_a"
[[stages]]
name = "coefficients"
stage = "fit"
input = "terms"
model = "tolles_lawson"
target = "mag_1_uc"
lambda = "$lambda"
where = "$kept"
[[stages]]
name = "clean"
stage = "compensate"
input = "terms"
model = "coefficients"
mag = "mag_1_uc"
detrend = true
[[stages]]
name = "scores"
stage = "score"
input = "clean"
"""

# Two magnetometers, three values of lambda and two survey lines. The stage `astray` fails: its map is of another place.
CABIN = """
name = "cabin"
store = "store"
[tables.flights]
path = "cabin.synth.toml"
[tables.anomaly]
path = "{map}"
alt_m = 500.0
[tables.elsewhere]
path = "{other}"
[axes]
mag = ["mag_3_uc", "mag_4_uc"]
lambda = [0.0, 0.025, 25.0]
[[stages]]
name = "terms"
stage = "a_matrix"
input = "flights"
vector = "flux_a"
[[stages]]
name = "coefficients"
stage = "fit"
input = "terms"
where = "line = 'cal'"
model = "tolles_lawson"
target = "$mag"
lambda = "$lambda"
[[stages]]
name = "clean"
stage = "compensate"
input = "terms"
where = "line <> 'cal'"
model = "coefficients"
mag = "$mag"
[[stages]]
name = "track"
stage = "navigate"
input = "clean"
map = "anomaly"
[[stages]]
name = "astray"
stage = "navigate"
input = "clean"
map = "elsewhere"
[[stages]]
name = "scores"
stage = "score"
input = ["clean", "track"]
truth = "mag_1_c"
metrics = ["std_error", "std_uncompensated", "improvement_ratio", "drms", "ins_drms", "nees"]
"""

FLIGHTS = """
preset = "cessna"
seed = 1
[map]
path = "{map}"
alt_m = 500.0
[ins]
grade = "navigation"
[[flights]]
name = "1003"
[[flights.lines]]
name = "cal"
kind = "box"
alt_m = 3000.0
start = [-21.99, 140.63]
[[flights.lines]]
name = "1003.01"
kind = "survey"
alt_m = 500.0
duration_s = 1200.0
waypoints = [[-22.10, 140.58], [-21.84, 140.58], [-21.84, 140.78], [-22.10, 140.78]]
[[flights.lines]]
name = "1003.02"
kind = "survey"
alt_m = 700.0
duration_s = 900.0
waypoints = [[-21.84, 140.78], [-22.10, 140.78], [-22.10, 140.58]]
"""

# A map of five survey lines with the error of each node, at two spacings, and a particle filter with its modes.
CHARTED = """
name = "charted"
store = "store"
[tables.flights]
path = "charted.synth.toml"
[tables.anomaly]
path = "{map}"
alt_m = 500.0
[axes]
spacing = [250.0, 500.0]
[[stages]]
name = "grid"
stage = "map_grid"
input = "flights"
value = "mag_1_c"
core_field = "igrf"
method = "minimum_curvature"
spacing_m = "$spacing"
cross_validate = 2
[[stages]]
name = "track"
stage = "navigate"
input = "flights"
where = "line = '1'"
map = "anomaly"
mag = "mag_1_c"
filter = "mpf"
particles = 600
save_modes = true
start = "given"
init_position_sigma_m = 5000.0
[[stages]]
name = "scores"
stage = "score"
input = ["flights", "track"]
metrics = ["drms", "ins_drms"]
"""

# Two pipelines over the same lines in one store. They share the axis lambda and two of its values. The second pipeline
# has a network with the importance of its inputs.
PIPELINE = """
name = "{name}"
store = "store"
[tables.flights]
path = "pair.csv"
[axes]
{axes}
[[stages]]
name = "terms"
stage = "a_matrix"
input = "flights"
vector = "flux_a"
{terms}
[[stages]]
name = "coefficients"
stage = "fit"
input = "terms"
model = "tolles_lawson"
target = "mag_4_uc"
lambda = "$lambda"
where = "{where}"
{fit}
[[stages]]
name = "clean"
stage = "compensate"
input = "terms"
model = "coefficients"
mag = "mag_4_uc"
where = "line <> 'cal'"
[[stages]]
name = "scores"
stage = "score"
input = "clean"
truth = "mag_1_c"
metrics = ["std_error", {metrics}]
"""
NETWORK = """
[[stages]]
name = "wanted"
stage = "target"
input = "terms"
kind = "d"
mag = "mag_4_uc"
[[stages]]
name = "network"
stage = "fit"
input = "wanted"
target = "target"
model = "m1"
epochs = 12
validation = ["plain"]
[[stages]]
name = "matters"
stage = "importance"
input = "wanted"
model = "network"
target = "target"
block_s = 1.0
"""
KEPT = ["line = 'cal'", f"line = 'cal' and {AXIS}"]
PAIR = {
    "linear": PIPELINE.format(name="linear", axes="lambda = [0.0, 0.1, 10.0]", terms="", fit="", where=KEPT[0],
                              metrics='"std_uncompensated"'),
    "second": PIPELINE.format(name="second", axes=f"lambda = [0.1, 10.0, 1000.0]\nkept = {json.dumps(KEPT)}",
                              terms='terms = ["permanent"]', fit="trim = 30", where="$kept",
                              metrics='"rms_error"') + NETWORK,
}

MILLION = """
name = "million"
store = "store"
[tables.flights]
path = "million.csv"
[axes]
lambda = [0.0, 0.1]
[[stages]]
name = "terms"
stage = "a_matrix"
input = "flights"
vector = "flux_a"
terms = ["permanent"]
[[stages]]
name = "coefficients"
stage = "fit"
input = "terms"
model = "tolles_lawson"
target = "mag_1_uc"
lambda = "$lambda"
[[stages]]
name = "clean"
stage = "compensate"
input = "terms"
model = "coefficients"
mag = "mag_1_uc"
detrend = true
[[stages]]
name = "scores"
stage = "score"
input = "clean"
"""


def survey(number):
    """A north-south line of 8 km, 500 m east of the line before."""
    ends = [[-22.02, 140.63 + 0.005 * number], [-21.95, 140.63 + 0.005 * number]]
    return f"""[[flights.lines]]
name = "{number}"
kind = "survey"
alt_m = 500.0
duration_s = 110.0
waypoints = {ends[::-1] if number % 2 == 0 else ends}
"""


def write_flights(path, lines, samples):
    """Writes flights at 10 Hz with a slow manoeuvre and noise."""
    random.seed(1)
    with open(path, "w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(["tt", "flight", "line", "flux_a_x", "flux_a_y", "flux_a_z", "mag_1_uc"])
        for line in lines:
            for i in range(samples):
                t, roll, pitch = i / 10, 0.1 * math.sin(i / 10), 0.1 * math.cos(0.13 * i)
                field = [20000 * math.cos(roll), 20000 * math.sin(roll) + 300 * pitch, 45000 * math.cos(pitch)]
                mag = 50000 + 5 * math.sin(2 * t) + random.gauss(0, 0.1)
                out.writerow([f"{t:.1f}", "f<i>1", line, *(f"{v:.3f}" for v in field), f"{mag:.3f}"])


def write_pair(path):
    """Writes a calibration line and six other lines with an aircraft field, at 10 Hz."""
    random.seed(2)
    with open(path, "w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(["tt", "flight", "line", "flux_a_x", "flux_a_y", "flux_a_z", "mag_4_uc", "mag_1_c"])
        for k, line in enumerate(["cal", LINE, "plain", "c", "d", "e", "f"]):
            for i in range(400):
                t, roll, pitch = i / 10, 0.3 * math.sin(i / 7), 0.2 * math.cos(0.23 * i + k)
                part = [0.4 * math.cos(roll), 0.4 * math.sin(roll) + 0.1 * pitch, 0.9 * math.cos(pitch)]
                field = 50000 + 5 * math.sin(0.2 * t)
                aircraft = 30 * part[0] - 55 * part[1] + 20 * part[2] + (10 + 5 * k) * part[1] * part[2]
                out.writerow([f"{t:.1f}", "1", line, *(f"{50000 * p:.3f}" for p in part),
                              f"{field + aircraft + random.gauss(0, 0.1 * (k + 1)):.3f}", f"{field:.3f}"])


def write(folder, repository):
    """Writes all specs and their data."""
    samples = repository / "datasets/samples"
    survey_map = samples / "osborne/osborne_anomaly_100m_at_500m.tif"
    cabin = CABIN.replace("{map}", str(survey_map)).replace("{other}", str(samples / "simple_magnav/map.h5"))
    (folder / "cabin.toml").write_text(cabin, encoding="utf-8")
    (folder / "cabin.synth.toml").write_text(FLIGHTS.replace("{map}", str(survey_map)), encoding="utf-8")
    (folder / "charted.toml").write_text(CHARTED.replace("{map}", str(survey_map)), encoding="utf-8")
    lines = "".join(survey(number) for number in range(1, 6))
    start = FLIGHTS.replace("{map}", str(survey_map)).split("[[flights.lines]]")[0]
    (folder / "charted.synth.toml").write_text(start + lines, encoding="utf-8")
    write_flights(folder / "flights.csv", [LINE, "plain"], 300)
    (folder / "hostile.toml").write_text(HOSTILE.replace("{axis}", json.dumps(AXIS)), encoding="utf-8")
    write_pair(folder / "pair.csv")
    for name, text in PAIR.items():
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    write_flights(folder / "million.csv", ["long"], 1_000_000)
    (folder / "million.toml").write_text(MILLION, encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]), Path(sys.argv[2]).resolve())
