"""Makes the reference tables of the magnetic sources and of the padded transform with harmonica and xrft.

    python3 stages/numerics/reference/maps/continuation/make_reference.py

Versions are written into each table. The tests never run this; they read the tables beside it.
"""
import warnings
from importlib.metadata import version
from pathlib import Path

import harmonica as hm
import numpy as np
import xarray as xr
import xrft

warnings.simplefilter("ignore")
HERE = Path(__file__).resolve().parent
COMMAND = "python3 stages/numerics/reference/maps/continuation/make_reference.py"
MADE_BY = ", ".join(f"{name} {version(name)}" for name in ("harmonica", "choclo", "xrft", "numpy"))

DIPOLE = ((120.0, -80.0, -310.0), (4.0e6, -2.5e6, 7.0e6))
PRISM = ((-200.0, 150.0, -90.0, 260.0, -500.0, -120.0), (1.5, -0.7, 2.2))


def write(name, **columns):
    with open(HERE / name, "w") as file:
        file.write(f"# {MADE_BY}; {COMMAND}\n")
        file.write(",".join(columns) + "\n")
        for row in zip(*columns.values(), strict=True):
            file.write(",".join(repr(float(value)) for value in row) + "\n")


def sources(rng):
    """Points around both, in line with edges and in the planes of faces of the prism."""
    points = [rng.uniform((-900, -900, -50), (900, 900, 900)) for _ in range(24)]
    west, east, south, north, bottom, top = PRISM[0]
    points += [(west, south, 40.0), (east, north, top - 600.0), (0.0, south, top + 10.0), (0.0, north + 1.0, top)]
    points += [(west - 30.0, south, top), (east + 700.0, north, bottom), (10.0, 20.0, top), (10.0, 20.0, top + 1e-6)]
    e, n, u = np.array(points).T
    dipole = hm.dipole_magnetic((e, n, u), tuple(np.array([x]) for x in DIPOLE[0]),
                                tuple(np.array([x]) for x in DIPOLE[1]), field="b")
    prism = hm.prism_magnetic((e, n, u), np.array([PRISM[0]]), tuple(np.array([x]) for x in PRISM[1]), field="b")
    names = ("east", "north", "up")
    columns = {f"dipole_{name}": b for name, b in zip(names, dipole)}
    columns |= {f"prism_{name}": b for name, b in zip(names, prism)}
    write("sources.csv", east_m=e, north_m=n, up_m=u, **columns)


def transform():
    """A map of 30 x 42 nodes, 60 m x 50 m apart, padded by zeros to 50 x 70 as in harmonica's user guide."""
    rows, columns = 30, 42
    north, east = 60.0 * np.arange(rows), 50.0 * np.arange(columns)
    j, k = np.meshgrid(np.arange(1, rows + 1), np.arange(1, columns + 1), indexing="ij")
    values = 100 * np.sin(0.7 * j) + 40 * np.cos(0.5 * k) + 0.2 * j * k
    grid = xr.DataArray(values, coords={"northing": north, "easting": east}, dims=("northing", "easting"))
    width = {"northing": rows // 3, "easting": columns // 3}
    padded = xrft.pad(grid, width)
    answers = {
        "upward_130": hm.upward_continuation(padded, 130.0),
        "derivative_upward": hm.derivative_upward(padded),
        "derivative_upward_2": hm.derivative_upward(padded, order=2),
        "derivative_easting": hm.derivative_easting(padded, method="fft"),
        "derivative_northing": hm.derivative_northing(padded, method="fft"),
    }
    write("harmonica.csv", **{name: xrft.unpad(answer, width).values.ravel() for name, answer in answers.items()})


if __name__ == "__main__":
    sources(np.random.default_rng(20250214))
    transform()
