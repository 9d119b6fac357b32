"""Gridding side by side: verde and harmonica, then magline, on the same points of the samples.

    python3 stages/numerics/benches/gridding_harmonica.py [osborne|britain] [--time-only] [--magline-only]

Writes the points of datasets/samples as flat little-endian f64 columns (easting, northing, height, value, number of
the line among the sorted lines) into a temporary folder, times BlockReduce and EquivalentSourcesGB with the settings of
the samples' maps, fit and grid, predicts every 7th line from the others, and runs `cargo bench -p magline-numerics
--bench gridding` on that folder. `--time-only` leaves out harmonica's predictions at left-out lines,
`--magline-only` all of harmonica. Needs numpy, pyarrow, verde 1.9 and harmonica 0.7.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import harmonica
import numpy as np
import pyarrow.parquet as parquet
import verde

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "datasets" / "samples"
# columns, then block, depth, damping, window, source block, level and node spacing of the samples' maps
SURVEYS = {
    "osborne": (
        ("osborne/osborne_survey_points.parquet", "height_orthometric_m", "flight_line"),
        (50.0, 200.0, 0.1, 5e3, 100.0, 500.0, 100.0),
    ),
    "britain": (
        ("britain/britain_sw_survey_points.parquet", "height_m", "line_and_segment"),
        (250.0, 700.0, 1e-3, 30e3, 400.0, 750.0, 500.0),
    ),
}


def points(name):
    path, height, line = SURVEYS[name][0]
    table = parquet.read_table(SAMPLES / path)
    names = ("utm_easting_m", "utm_northing_m", height, "total_field_anomaly_nt")
    columns = [np.asarray(table[c], dtype=float) for c in names]
    _, number = np.unique(np.asarray(table[line].to_pylist()), return_inverse=True)
    return columns, number


def fitted(name, columns):
    block, depth, damping, window, source_block, *_ = SURVEYS[name][1]
    east, north, height, value = columns
    reducer = verde.BlockReduce(np.median, spacing=block, drop_coords=False)
    at, blocks = reducer.filter((east, north, height), value)
    sources = harmonica.EquivalentSourcesGB(
        depth=depth, damping=damping, window_size=window, block_size=source_block, random_state=0
    )
    return sources.fit(at, blocks)


def compare(name, columns, number):
    start = time.perf_counter()
    sources = fitted(name, columns)
    level, spacing = SURVEYS[name][1][-2:]
    region = verde.get_region(columns[:2])
    nodes = verde.grid_coordinates(region, spacing=spacing, extra_coords=level)
    sources.predict(nodes)
    print(f"{name} harmonica: blocks, fit and grid of {nodes[0].size} nodes in {time.perf_counter() - start:.1f} s",
          flush=True)
    for fold in () if "--time-only" in sys.argv else (0, 3):
        out = number % 7 == fold
        predicted = fitted(name, [c[~out] for c in columns]).predict([c[out] for c in columns[:3]])
        size = np.abs(columns[3][out] - predicted)
        print(
            f"{name} harmonica, left out {fold}: n {size.size} median {np.median(size):.2f} nT, "
            f"rms {np.sqrt(np.mean(size**2)):.2f} nT, 95 % {np.percentile(size, 95):.1f} nT",
            flush=True,
        )


def main():
    only = [a for a in sys.argv[1:] if not a.startswith("-")]
    with tempfile.TemporaryDirectory() as folder:
        for name in only or SURVEYS:
            columns, number = points(name)
            np.concatenate([*columns, number.astype(float)]).astype("<f8").tofile(f"{folder}/{name}.f64")
            if "--magline-only" not in sys.argv:
                compare(name, columns, number)
        environment = os.environ | {"MAGLINE_GRIDDING_POINTS": folder, "MAGLINE_GRIDDING_ONLY": only[0] if only else ""}
        command = ["cargo", "bench", "-p", "stages", "--bench", "gridding", "--profile", "dev"]
        subprocess.run(command, cwd=ROOT, env=environment, check=True)


if __name__ == "__main__":
    main()
