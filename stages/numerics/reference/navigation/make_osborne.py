"""Cuts the latitude/longitude map osborne.i16 out of the Osborne grid, which is in UTM.

    python3 make_osborne.py osborne_anomaly_100m_at_500m.parquet

Run with numpy 2.4.6, scipy 1.17.1, pyarrow, pyproj 3.7.2. Bicubic interpolation of the UTM nodes
at the nodes of a grid of 0.001 degrees; whole fifths of a nanotesla as little-endian int16, by rows
from south to north. The map's corner and size are printed; README.md records them.
"""

import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from pyproj import Transformer
from scipy.interpolate import RectBivariateSpline

table = pq.read_table(sys.argv[1])
east, north, anomaly = (table[name].to_numpy() for name in table.column_names)
eastings, northings = np.unique(east), np.unique(north)
spline = RectBivariateSpline(northings, eastings, anomaly.reshape(len(northings), len(eastings)))

to_degrees = Transformer.from_crs("EPSG:32754", "EPSG:4326", always_xy=True)
to_utm = Transformer.from_crs("EPSG:4326", "EPSG:32754", always_xy=True)
corner_lon, corner_lat = to_degrees.transform(
    [eastings[0], eastings[-1], eastings[0], eastings[-1]],
    [northings[0], northings[0], northings[-1], northings[-1]],
)
west = np.ceil(max(corner_lon[0], corner_lon[2]) * 1000)
east_end = np.floor(min(corner_lon[1], corner_lon[3]) * 1000)
south = np.ceil(max(corner_lat[0], corner_lat[1]) * 1000)
north_end = np.floor(min(corner_lat[2], corner_lat[3]) * 1000)
lon = np.arange(west, east_end + 1) / 1000
lat = np.arange(south, north_end + 1) / 1000
grid_lon, grid_lat = np.meshgrid(lon, lat)
x, y = to_utm.transform(grid_lon, grid_lat)
values = spline.ev(y, x)
assert x.min() >= eastings[0] and x.max() <= eastings[-1]
assert y.min() >= northings[0] and y.max() <= northings[-1]
(Path(__file__).parent / "osborne.i16").write_bytes(np.round(values * 5).astype("<i2").tobytes())
print("south", lat[0], "west", lon[0], "rows", len(lat), "columns", len(lon))
