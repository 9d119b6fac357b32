"""Reads the maps in `written/`, which magline's tests wrote, with other programs, and compares them with the values of
make_maps.py. The tests compare newly written maps with these files byte by byte.

python3 check_maps.py   (rasterio 1.4.4 with GDAL 3.10.3, xarray 2026.9, scipy 1.17, netCDF4 1.7.5, h5py 3.16,
harmonica 0.7)
"""
import warnings

import h5py
import netCDF4
import numpy as np
import rasterio
import xarray
from harmonica import load_oasis_montaj_grid
from scipy.io import netcdf_file

warnings.simplefilter("ignore")
column, row = np.meshgrid(np.arange(7), np.arange(5))
SOUTH = 100.0 + 3.0 * column - 5.0 * row + 0.25 * row * column
SOUTH[1, 2] = np.nan
X, Y = 370000.0 + 500.0 * np.arange(7), 5676500.0 + 500.0 * np.arange(5)
LON, LAT = -5.0 + 0.01 * np.arange(7), 51.0 + 0.01 * np.arange(5)


def same(what, a, b, tolerance=0.0):
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance, err_msg=what)


def gdal(name, code, tags=None, nodata=True, epsg=True):
    with rasterio.open(f"written/{name}") as d:
        x, y = (LON, LAT) if code == 4326 else (X, Y)
        value = d.read(1).astype(float)
        unknown = d.nodata
        if unknown is not None and not np.isnan(unknown):
            value[value >= unknown if unknown > 1e38 else value == unknown] = np.nan
        same(name, value, SOUTH[::-1])
        centre = [d.xy(0, i)[0] for i in range(7)], [d.xy(j, 0)[1] for j in range(5)][::-1]
        same(name, centre[0], x, 1e-7)
        same(name, centre[1], y, 1e-7)
        found = d.crs.to_epsg() if d.crs else None
        assert not epsg or found == code, (name, found, d.crs)
        for key, wanted in (tags or {}).items():
            assert d.tags().get(key) == wanted, (name, d.tags())
        print(f"{name}: {d.driver}, {d.crs}, no data {d.nodata}, units {d.units}")


gdal("small.tif", 32630, {"level_height_m": "300", "AREA_OR_POINT": "Point"})
gdal("small_geographic.tif", 4326, {"level_height_m": "300"})
gdal("small.nc", 32630)
gdal("small_geographic.nc", 4326)
gdal("surfer7.grd", 32630, epsg=False)
gdal("surfer6.grd", 32630, epsg=False)
gdal("surfer6_text.grd", 32630, epsg=False)
gdal("small.gxf", 32630, epsg=False)
gdal("small.ers", 32630)
gdal("small_geographic.ers", 4326)
gdal("small.asc", 32630)
gdal("../text.gxf", 32630, epsg=False)
gdal("../packed.gxf", 32630, epsg=False)

for name, x, y in (("small.nc", "x", "y"), ("small_geographic.nc", "lon", "lat")):
    grid = xarray.open_dataset(f"written/{name}", engine="scipy").z
    assert grid.dims == (y, x) and grid.attrs["units"] == "nT" and grid.attrs["height_m"] == 300.0
    same(name, grid.values, SOUTH)
    same(name, grid[x].values, LON if x == "lon" else X, 1e-12)
    with netCDF4.Dataset(f"written/{name}") as f:
        assert f.data_model == "NETCDF3_64BIT_OFFSET" and f.node_offset == 0
        same(name, f["z"][:].filled(np.nan), SOUTH)
    with netcdf_file(f"written/{name}", mmap=False) as f:
        same(name, f.variables["z"][:], SOUTH)

with h5py.File("written/small.h5") as f:
    assert f["map"].shape == f["mask"].shape == (7, 5) and f["alt"].shape == () and f["alt"][()] == 300.0
    assert f["mask"].dtype == np.int8 and f["info"][()] == b"magline"
    same("h5", f["map"][:].T, np.nan_to_num(SOUTH))
    same("h5", f["mask"][:].T, np.isfinite(SOUTH))
    same("h5", f["xx"][:], LON, 1e-15)
    same("h5", f["yy"][:], LAT, 1e-15)

text = np.genfromtxt("written/small.xyz", skip_header=2)
same("xyz", text[:, 2].reshape(5, 7), SOUTH)
same("xyz", text[:7, 0], X)
for name in ("geosoft_float.grd", "geosoft_short_columns.grd", "geosoft_double_blocks.grd"):
    grid = load_oasis_montaj_grid(name)
    same(name, grid.values, SOUTH)
    same(name, grid.easting.values, X)
    same(name, grid.northing.values, Y)
    print(f"{name}: harmonica")
print("all as they should be")
