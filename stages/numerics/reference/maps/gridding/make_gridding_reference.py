"""Reference values for gridding: `python3 make_gridding_reference.py`, beside this file.

A dipole's field on ten lines, as verde's biharmonic spline (the surface of minimum curvature) and as harmonica's
equivalent sources see it. Needs numpy, verde 1.9 and harmonica 0.7.

points.csv: easting_m, northing_m, height_m, value_nt on lines 400 m apart, a point every 100 m, at about 300 m.
nodes.csv:  easting_m, northing_m and at each node: the exact field at 300 m and verde.Spline of the points (all taken
            to be at one height), the exact field at 450 m and harmonica.EquivalentSources there.
"""

import harmonica
import numpy as np
import verde

DIPOLE_M = (2050.0, 1930.0, -500.0)


def field(east, north, height):
    """A vertical dipole's vertical field, nT."""
    de, dn, dh = east - DIPOLE_M[0], north - DIPOLE_M[1], height - DIPOLE_M[2]
    r2 = de**2 + dn**2 + dh**2
    return 1e11 * (3.0 * dh**2 / r2 - 1.0) / r2**1.5


def write(name, header, columns):
    np.savetxt(name, np.column_stack(columns), fmt="%.6f", delimiter=",", header=header, comments="")


east, north = (a.ravel() for a in np.meshgrid(np.arange(0.0, 4001.0, 100.0), np.arange(0.0, 4001.0, 400.0)))
height = 300.0 + 20.0 * np.sin(east / 700.0) + 10.0 * np.cos(north / 900.0)
value = field(east, north, height)
write("points.csv", "easting_m,northing_m,height_m,value_nt", (east, north, height, value))

nodes = [a.ravel() for a in np.meshgrid(np.arange(0.0, 4001.0, 100.0), np.arange(0.0, 4001.0, 100.0))]
level = np.full(nodes[0].size, 300.0)
spline = verde.Spline().fit((east, north), field(east, north, 300.0)).predict(nodes)
sources = harmonica.EquivalentSources(depth=400.0, damping=1e-6).fit((east, north, height), value)
above = sources.predict((nodes[0], nodes[1], np.full(nodes[0].size, 450.0)))
columns = (*nodes, field(*nodes, level), spline, field(nodes[0], nodes[1], 450.0), above)
write("nodes.csv", "easting_m,northing_m,exact_300_m,verde_spline,exact_450_m,harmonica_450_m", columns)
