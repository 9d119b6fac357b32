"""The work of `interpolation.rs` in scipy, to be timed beside it.

    python3 stages/numerics/benches/interpolation_scipy.py           # look-ups and filling: scipy, Rust, ratios
    python3 stages/numerics/benches/interpolation_scipy.py look-ups  # only these

Value and gradient, each as scipy's user would get them:
  RectBivariateSpline      bicubic (ends not-a-knot, not natural): `ev` of value and of both derivatives
  map_coordinates          bilinear and bicubic, coefficients made before: no gradient, so five values of central
                           differences; the time of the value alone is printed too
  RegularGridInterpolator  bilinear, the same
and for filling, cKDTree of all known nodes, queried for the three nearest of each unknown one (a tenth of them, as the
whole takes minutes). Times are those of the processor, of one thread; the fastest of three counts.
"""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import scipy
from scipy.interpolate import RectBivariateSpline, RegularGridInterpolator
from scipy.ndimage import map_coordinates, spline_filter
from scipy.spatial import cKDTree

HERE = Path(__file__).resolve().parent
LOOK_UPS, REPEATS = 200_000, 3
SOUTH, WEST, STEP = -22.0, 140.0, 0.001
MAPS = [("small", 400, 330), ("large", 3195, 7279)]
SHARE = 10


def field(row, column):
    return 100.0 * np.sin(0.23 * row) * np.cos(0.19 * column) + 0.02 * row - 0.01 * column


def places(rows, columns, along_track):
    k = np.arange(LOOK_UPS, dtype=float)
    height, width = STEP * (rows - 3), STEP * (columns - 3)
    if along_track:
        up, right = np.abs((5.3e-5 * k / height) % 2.0 - 1.0), np.abs((4.1e-5 * k / width) % 2.0 - 1.0)
    else:
        up, right = (0.618_033_988_749_895 * k) % 1.0, (0.754_877_666_246_693 * k) % 1.0
    return SOUTH + STEP + height * up, WEST + STEP + width * right


def fastest(work):
    work()
    times = []
    for _ in range(REPEATS):
        start = time.thread_time()
        answer = work()
        times.append(time.thread_time() - start)
    return min(times), answer


def five(value, lat, lon):
    """Value and gradient by central differences of a hundredth of a step."""
    d = 0.01 * STEP
    north, south, east, west = (value(lat + d, lon), value(lat - d, lon), value(lat, lon + d), value(lat, lon - d))
    return value(lat, lon), (north - south) / (2 * d), (east - west) / (2 * d)


def look_ups():
    million = {}
    for size, rows, columns in MAPS:
        values = field(np.arange(rows)[:, None], np.arange(columns)[None, :])
        lat_axis, lon_axis = SOUTH + STEP * np.arange(rows), WEST + STEP * np.arange(columns)
        spline = RectBivariateSpline(lat_axis, lon_axis, values)
        linear = RegularGridInterpolator((lat_axis, lon_axis), values)
        coefficients = spline_filter(values, order=3, mode="mirror")

        def nodes(lat, lon):
            return np.stack([(lat - SOUTH) / STEP, (lon - WEST) / STEP])

        def filtered(lat, lon):
            return map_coordinates(coefficients, nodes(lat, lon), order=3, prefilter=False, mode="mirror")

        def flat(lat, lon):
            return map_coordinates(values, nodes(lat, lon), order=1)

        def grid_linear(lat, lon):
            return linear(np.stack([lat, lon], axis=-1))

        for track in ("track", "random"):
            lat, lon = places(rows, columns, track == "track")
            ways = {
                ("Cubic", "RectBivariateSpline"): lambda: (
                    spline.ev(lat, lon),
                    spline.ev(lat, lon, dx=1),
                    spline.ev(lat, lon, dy=1),
                ),
                ("Cubic", "map_coordinates"): lambda: five(filtered, lat, lon),
                ("Cubic", "map_coordinates, value alone"): lambda: (filtered(lat, lon),),
                ("Linear", "RegularGridInterpolator"): lambda: five(grid_linear, lat, lon),
                ("Linear", "map_coordinates"): lambda: five(flat, lat, lon),
                ("Linear", "map_coordinates, value alone"): lambda: (flat(lat, lon),),
            }
            for (kind, way), work in ways.items():
                seconds, answer = fastest(work)
                off = np.abs(answer[0] - field(*nodes(lat, lon))).max()
                assert off < 1.2, off
                million.setdefault((size, kind, track), {})[way] = LOOK_UPS / seconds / 1e6
                print(f"{size} {kind} {track} scipy {way}: {LOOK_UPS / seconds / 1e6:.2f} million/s")
    return million


def filling():
    _, rows, columns = MAPS[1]
    row, column = np.mgrid[0:rows, 0:columns]
    r, c = row / rows, column / columns
    unknown = (np.hypot(r - 0.55, 1.7 * (c - 0.6)) < 0.28) | (r + 1.2 * c < 0.45) | (r - c > 0.6)
    unknown |= (row * 31 + column * 17) % 97 == 0
    values = field(row, column)
    start = time.thread_time()
    known = np.argwhere(~unknown)
    tree = cKDTree(100.0 * known)
    built = time.thread_time() - start
    asked = np.argwhere(unknown)[::SHARE]
    start = time.thread_time()
    _, found = tree.query(100.0 * asked, k=3)
    values[tuple(asked.T)] = values[tuple(known[found.T].transpose(2, 0, 1))].mean(axis=0)
    queried = (time.thread_time() - start) * SHARE
    print(f"fill nearest scipy: {built:.1f} s tree, {queried:.1f} s for all queries (from a {SHARE}th of them)")
    return built + queried


def main():
    only = [name for name in sys.argv[1:] if name in ("look-ups", "fill")]
    print(f"numpy {np.__version__}, scipy {scipy.__version__}")
    million = {} if only == ["fill"] else look_ups()
    seconds = 0.0 if only == ["look-ups"] else filling()
    command = ["cargo", "bench", "-p", "stages", "--bench", "interpolation", "--profile", "dev", "--", *only]
    rust = subprocess.run(command, check=True, capture_output=True, text=True, cwd=HERE.parent.parent).stdout
    print(rust)
    for (size, kind, track), ways in million.items():
        ours = float(re.search(rf"^{size} {kind} {track} many \(.*\): ([\d.]+) million/s", rust, re.M)[1])
        ratios = ", ".join(f"{ours / theirs:.0f} x {way}" for way, theirs in ways.items())
        print(f"{size} {kind} {track}: {ours:.1f} million/s, {ratios}")
    if seconds:
        ours = float(re.search(r"^fill nearest, threads 1: ([\d.]+) s", rust, re.M)[1])
        print(f"fill nearest: {ours:.1f} s, {seconds / ours:.1f} x faster than scipy (one thread each)")


main()
