"""Exports a table as GeoPackage and as CSV, and compares the layers that pyogrio (GDAL) reads with the CSV file. See
README.md beside this file."""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path


def export(args, path):
    command = [args.magline, "export", args.table, "-o", str(path), "--store", args.store]
    subprocess.run([*command, *(["--where", args.where] if args.where else [])], check=True)


def main():
    import numpy as np
    import pandas as pd
    import pyogrio

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store")
    parser.add_argument("table", help="as PIPELINE.TABLE; it has `lat` and `lon`")
    parser.add_argument("--where", help="condition of `magline export`")
    parser.add_argument("--magline", default="magline")
    args = parser.parse_args()
    faults = []
    with tempfile.TemporaryDirectory() as folder:
        package, text = Path(folder) / "t.gpkg", Path(folder) / "t.csv"
        export(args, package)
        export(args, text)
        name = args.table.split(".")[1]
        layers = {layer: kind for layer, kind in pyogrio.list_layers(package)}
        if layers != {name: "Point", f"{name}_lines": "LineString"}:
            faults.append(f"layers {layers}")
        points = pyogrio.read_dataframe(package, layer=name)
        lines = pyogrio.read_dataframe(package, layer=f"{name}_lines")
        table = pd.read_csv(text, dtype={"flight": str, "line": str})
        if points.crs.to_epsg() != 4326:
            faults.append(f"coordinate system {points.crs}")
        if list(points.columns.drop("geometry")) != list(table.columns) or len(points) != len(table):
            faults.append(f"{len(points)} rows of {list(points.columns)}, not {len(table)} of {list(table.columns)}")
        for column in table.select_dtypes("number"):
            if not np.array_equal(points[column].to_numpy(float), table[column].to_numpy(float), equal_nan=True):
                faults.append(f"column `{column}` differs")
        if "utc" in table:
            own, other = (pd.to_datetime(t["utc"], utc=True, format="ISO8601") for t in (points, table))
            if not ((other - own) < pd.Timedelta("1ms")).all() or (own > other).any():
                faults.append("column `utc` differs")
        place = points.geometry.get_coordinates()
        known = table[["lon", "lat"]].notna().all(axis=1).to_numpy()
        if not np.array_equal(place.to_numpy(), table.loc[known, ["lon", "lat"]].to_numpy()):
            faults.append("positions differ")
        if lines["rows"].sum() != len(table) or sum(len(g.coords) for g in lines.geometry if g) != known.sum():
            faults.append("tracks do not hold all points")
    print(*(faults or [f"{args.table}: {len(points)} points and {len(lines)} tracks agree"]), sep="\n")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
