"""Reference values for filling gaps from the nearest known nodes, made by scipy's cKDTree.

    python3 make_reference.py

writes square.csv (steps of 100 m) and oblong.csv (70 m east, 150 m north): the map, and its filling by the mean of 3
neighbours, by 5 neighbours weighted with 1/distance², and by the mean of 3 where the nearest is at most 250 m away.
Run with numpy 2.4.6, scipy 1.17.1. The tree leaves open which of two nodes as far as each other it tells; it is asked
for many, which are then put into order by distance, row, column.
"""

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

here = Path(__file__).parent
ROWS, COLUMNS, MANY = 23, 31, 80


def node_map():
    row, column = np.mgrid[0:ROWS, 0:COLUMNS]
    values = 100 * np.sin(0.31 * row) + 60 * np.cos(0.23 * column) + 0.7 * row * column
    values[4:13, 6:19] = np.nan  # a gap with corners,
    values[8, 10] = 12.5  # an island in it,
    values[15:, 25:] = np.nan  # a corner of the map,
    values[20, :9] = np.nan  # a line
    values[(row * 7 + column * 3) % 29 == 5] = np.nan  # and single nodes
    return np.round(values, 3)


def fill(values, east_m, north_m, neighbours, power, limit_m):
    known, unknown = np.argwhere(~np.isnan(values)), np.argwhere(np.isnan(values))
    tree = cKDTree(known * [north_m, east_m])
    _, found = tree.query(unknown * [north_m, east_m], k=MANY)
    filled = values.copy()
    for place, candidates in zip(unknown, found):
        nodes = known[candidates]
        offsets = (nodes - place) * [north_m / east_m, 1.0]
        squares = (offsets**2).sum(axis=1)
        order = sorted(range(MANY), key=lambda i: (squares[i], *nodes[i]))[:neighbours]
        distances = np.sqrt(squares[order]) * east_m
        if distances[0] <= limit_m:
            weights = distances**-power
            filled[tuple(place)] = (weights * values[tuple(nodes[order].T)]).sum() / weights.sum()
    return filled


def write(name, east_m, north_m):
    values = node_map()
    columns = [
        values,
        fill(values, east_m, north_m, 3, 0.0, np.inf),
        fill(values, east_m, north_m, 5, 2.0, np.inf),
        fill(values, east_m, north_m, 3, 0.0, 250.0),
    ]
    table = np.column_stack([column.ravel() for column in columns])
    rows = "\n".join(",".join(repr(float(x)) for x in row) for row in table)
    origin = f"# scipy cKDTree, make_reference.py; {ROWS} rows x {COLUMNS} columns, {east_m} m east, {north_m} m north"
    (here / name).write_text(f"{origin}\nmap,mean3,weighted5,mean3_within_250_m\n{rows}\n")


write("square.csv", 100.0, 100.0)
write("oblong.csv", 70.0, 150.0)
