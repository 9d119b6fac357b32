"""Makes one small map in the formats of other programs, and maps with one unusual feature each.

The value of a node follows from its position: 100 + 3 column - 5 row (row 0 in the south) + 0.25 row column; one node
(column 2, row 1) is unknown. 7 columns, 5 rows, 500 m apart from easting 370000, northing 5676500 in EPSG:32630, or
0.01 degrees apart from longitude -5, latitude 51.

python3 make_maps.py   (numpy 2, scipy 1.17, xarray 2026.9, netCDF4 1.7.5, h5py 3.16, rasterio 1.4.4 with GDAL 3.10.3)
"""
import glob
import os
import struct
import warnings
import zlib

import h5py
import netCDF4
import numpy as np
import rasterio
import rasterio.shutil
import xarray
from rasterio.transform import from_origin
from scipy.io import netcdf_file, savemat

warnings.simplefilter("ignore")
COLUMNS, ROWS = 7, 5
column, row = np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))
SOUTH = 100.0 + 3.0 * column - 5.0 * row + 0.25 * row * column
SOUTH[1, 2] = np.nan
NORTH = SOUTH[::-1]
X = 370000.0 + 500.0 * np.arange(COLUMNS)
Y = 5676500.0 + 500.0 * np.arange(ROWS)
LON, LAT = -5.0 + 0.01 * np.arange(COLUMNS), 51.0 + 0.01 * np.arange(ROWS)
UTM = from_origin(X[0] - 250.0, Y[-1] + 250.0, 500.0, 500.0)
DEGREES = from_origin(LON[0] - 0.005, LAT[-1] + 0.005, 0.01, 0.01)


def gdal(name, driver, dtype="float64", nodata=np.nan, transform=UTM, crs="EPSG:32630", **options):
    """Writes through an in-memory GeoTIFF, because not every driver can create files."""
    data = np.where(np.isnan(NORTH), nodata, NORTH).astype(dtype)
    profile = dict(width=COLUMNS, height=ROWS, count=1, dtype=dtype, crs=crs, transform=transform, nodata=nodata)
    with rasterio.MemoryFile() as memory:
        with memory.open(driver="GTiff", **profile) as source:
            source.write(data, 1)
        with memory.open() as source:
            rasterio.shutil.copy(source, name, driver=driver, **options)


gdal("gdal.tif", "GTiff", COMPRESS="LZW")
gdal("gdal_i16.tif", "GTiff", dtype="int16", nodata=-32768)
gdal("gdal_surfer7.grd", "GS7BG", nodata=1.70141e38)
gdal("gdal_surfer6.grd", "GSBG", dtype="float32", nodata=1.701410009187828e38)
gdal("gdal_surfer6_text.grd", "GSAG", nodata=1.70141e38)
gdal("gdal.asc", "AAIGrid", nodata=-9999)
gdal("gdal.nc", "netCDF", FORMAT="NC2")
gdal("gdal_nc4.nc", "netCDF", FORMAT="NC4", COMPRESS="DEFLATE", ZLEVEL="9")
gdal("gdal_geographic.nc", "netCDF", FORMAT="NC", transform=DEGREES, crs="EPSG:4326")
gdal("gdal.ers", "ERS", dtype="float32", nodata=-99999)
gdal("gdal.xyz", "XYZ", nodata=-9999, ADD_HEADER_LINE="YES")



def refused(name, bands=1, **profile):
    with rasterio.open(name, "w", "GTiff", width=COLUMNS, height=ROWS, count=bands, dtype="float32", **profile) as f:
        for band in range(bands):
            f.write(np.nan_to_num(NORTH).astype("f4"), band + 1)


refused("gdal_rotated.tif", crs="EPSG:32630", transform=UTM @ rasterio.Affine.rotation(20))
refused("gdal_nowhere.tif")
refused("gdal_two_bands.tif", bands=2, crs="EPSG:32630", transform=UTM)
refused("gdal_uncoded.tif", crs="+proj=tmerc +lon_0=7.3 +ellps=WGS84", transform=UTM)
with rasterio.open("gdal_unknown.tif", "w", "GTiff", width=3, height=2, count=1, dtype="float32", nodata=7,
                   crs="EPSG:32630", transform=UTM) as f:
    f.write(np.full((2, 3), 7, "f4"), 1)

# xarray: NetCDF-4 with degrees, latitudes descending, the longitudes outermost, packed in 16 bits.
z = xarray.DataArray(SOUTH, dims=("lat", "lon"), coords={"lat": LAT, "lon": LON}, name="anomaly")
z.attrs["units"] = "nT"
z.lat.attrs["units"], z.lon.attrs["units"] = "degrees_north", "degrees_east"
packed = {"anomaly": {"dtype": "int16", "scale_factor": 0.25, "add_offset": 100.0, "_FillValue": -32768, "zlib": True}}
z[::-1].to_netcdf("xarray_down.nc", engine="netcdf4")
z.transpose("lon", "lat").to_netcdf("xarray_transposed.nc", engine="netcdf4", encoding=packed)
turned = z.assign_coords(lon=LON + 360.0)
turned.lon.attrs["units"] = "degrees_east"
turned.to_netcdf("xarray_0_360.nc", engine="scipy")
micro = (z / 1000.0).assign_attrs(units="uT")
micro.to_netcdf("xarray_ut.nc", engine="netcdf4", format="NETCDF3_64BIT_DATA")
strange = z.assign_attrs(units="mGal")
strange.to_netcdf("xarray_mgal.nc", engine="scipy")


def gmt(name, pixel):
    """GMT's oldest grids, as described in its manual: ends of the axes and one list of values from the north-west."""
    with netcdf_file(name, "w", version=1) as f:
        f.createDimension("side", 2)
        f.createDimension("xysize", COLUMNS * ROWS)
        half = 250.0 if pixel else 0.0
        for axis, values in (("x", X), ("y", Y)):
            v = f.createVariable(f"{axis}_range", "d", ("side",))
            v[:] = [values[0] - half, values[-1] + half]
            v.units = "m"
        v = f.createVariable("z_range", "d", ("side",))
        v[:] = [np.nanmin(SOUTH), np.nanmax(SOUTH)]
        v.units = "nT"
        f.createVariable("spacing", "d", ("side",))[:] = [500.0, 500.0]
        f.createVariable("dimension", "i", ("side",))[:] = [COLUMNS, ROWS]
        v = f.createVariable("z", "f", ("xysize",))
        v[:] = NORTH.ravel()
        v.scale_factor, v.add_offset, v.node_offset = 1.0, 0.0, np.int32(pixel)


gmt("gmt_old_node.grd", 0)
gmt("gmt_old_pixel.grd", 1)

with h5py.File("h5py_map.h5", "w") as f:
    # The layout of MagNav.jl's save_map: longitudes first, 0 where unknown.
    f["map"] = np.nan_to_num(SOUTH).T
    f["xx"], f["yy"], f["alt"], f["info"] = LON, LAT, 300.0, "map"
    f["mask"] = np.isfinite(SOUTH).T.astype("i1")


def base_90(number, digits):
    out = ""
    for _ in range(digits):
        out, number = chr(37 + number % 90) + out, number // 90
    return out


def gxf(name, packed, sense=1):
    """From the specification of GXF revision 3; GDAL reads both files (see check_maps.py)."""
    head = ["A map, in words before the first object.", "", "#TITLE", "small map", "#POINTS", str(COLUMNS), "#ROWS",
            str(ROWS)]
    head += ["#PTSEPARATION", "500.0", "#RWSEPARATION", "500.0", "#XORIGIN", "370000", "#YORIGIN", "5676500"]
    head += ["#SENSE", str(sense), "#DUMMY", "-1e32", '#UNIT_LENGTH', '"m",1']
    head += ["#MAP_PROJECTION", '"WGS 84 / UTM zone 30N"', '"WGS 84",6378137,0.081819191,0',
             '"Transverse Mercator",0,-3,0.9996,500000,0']
    if not packed:
        lines = [" ".join("-1e32" if np.isnan(v) else repr(float(v)) for v in r) for r in SOUTH]
    else:
        head += ["#GTYPE", "3", "#TRANSFORM", "0.25 , 0"]
        lines = []
        for j, r in enumerate(SOUTH):
            words = ["!!!" if np.isnan(v) else base_90(int(4 * v), 3) for v in r]
            lines.append("".join(words))
        # The last two values of the first row are runs of length one.
        lines[0] = lines[0][:15] + '"""' + base_90(1, 3) + lines[0][15:18] + '"""' + base_90(1, 3) + lines[0][18:]
    open(name, "w").write("\n".join(head + ["#GRID"] + lines) + "\n")


gxf("text.gxf", False)
gxf("packed.gxf", True)

with open("surfer7_v2.grd", "wb") as f:
    # Version 2 with a section of fault lines, from Golden Software's description.
    f.write(b"DSRB" + struct.pack("<ii", 4, 2))
    f.write(b"GRID" + struct.pack("<iii8d", 72, ROWS, COLUMNS, X[0], Y[0], 500.0, 500.0, 0.0, 1.0, 0.0, -12345.0))
    f.write(b"FLTI" + struct.pack("<iii", 8, 0, 0))
    f.write(b"DATA" + struct.pack("<i", 8 * COLUMNS * ROWS)
            + np.nan_to_num(SOUTH, nan=-12345.0).astype("<f8").tobytes())

for left in glob.glob("*.aux.xml"):
    os.remove(left)


def vector_map():
    """Components of a vector map. North is 0 at a known node; unknown nodes are 0 in all three."""
    return {"mapX": np.nan_to_num(SOUTH - 100.0), "mapY": np.nan_to_num(SOUTH), "mapZ": np.nan_to_num(2.0 * SOUTH)}


with h5py.File("h5py_vector.h5", "w") as f:
    # MagNav.jl's save_map of a MapV, the layout of EMM720_World.h5.
    for name, component in vector_map().items():
        f[name] = component.T
    f["xx"], f["yy"], f["alt"], f["info"] = LON, LAT, 300.0, "map"

scalar_map = {"map": np.nan_to_num(SOUTH), "xx": LON, "yy": LAT, "alt": 300.0, "info": "map",
              "mask": np.isfinite(SOUTH)}
savemat("scipy_map.mat", {"map_data": scalar_map}, do_compression=True)
savemat("scipy_vector.mat", {"alt": 300.0, "xx": LON[:, None], "yy": LAT[:, None], **vector_map()})
with h5py.File("h5py_map_v73.mat", "w", userblock_size=512) as f:
    group = f.create_group("map_data")
    group.attrs["MATLAB_class"] = np.bytes_("struct")
    for name, array in (("map", np.nan_to_num(SOUTH)), ("xx", LON[None]), ("yy", LAT[None]), ("alt", [[300.0]])):
        group[name] = np.asarray(array).T
        group[name].attrs["MATLAB_class"] = np.bytes_("double")
with open("h5py_map_v73.mat", "r+b") as f:
    f.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + struct.pack("<H2s", 0x0200, b"IM"))

with open("emag2_v3.csv", "w", newline="") as f:
    # The layout of EMAG2_V3_20170530.csv: cells of 2 minutes, 99999 where unknown.
    for j in range(ROWS):
        for i in range(COLUMNS):
            place = f"{i + 10651},{j + 4231},{355 + (2 * i + 1) / 60:.6f},{51 + (2 * j + 1) / 60:.6f}"
            v = SOUTH[j, i]
            known = f"{2 * v:.2f},{v:.2f},7,20" if np.isfinite(v) else "99999.00,99999.00,999,-999"
            f.write(f"{place},{known}\r\n")


def geosoft(name, dtype, sign, dummy, base=0.0, multiplier=1.0, columns=False, blocks=0):
    """From the description of Geosoft's grid format, version 2; harmonica reads each file (see check_maps.py)."""
    data = np.where(np.isnan(SOUTH), dummy, (SOUTH - base) * multiplier).astype(dtype)
    size = data.itemsize + (1024 if blocks else 0)
    shape = (ROWS, COLUMNS, -1) if columns else (COLUMNS, ROWS, 1)
    head = struct.pack("<2i3i5d2d", size, sign, *shape, 500.0, 500.0, X[0], Y[0], 0.0, base, multiplier)
    head = head.ljust(512, b"\0")
    vectors = data.T if columns else data
    if not blocks:
        body = vectors.tobytes()
    else:
        parts = [b"\0" * 16 + zlib.compress(part.tobytes()) for part in np.array_split(vectors, blocks)]
        starts = np.cumsum([512 + 16 + 12 * blocks] + [len(part) for part in parts[:-1]])
        body = struct.pack("<4i", 1, 2, blocks, -(-len(vectors) // blocks)) + starts.astype("<i8").tobytes()
        body += np.array([len(part) for part in parts], "<i4").tobytes() + b"".join(parts)
    open(name, "wb").write(head + body)


geosoft("geosoft_float.grd", "<f4", 2, -1e32)
geosoft("geosoft_short_columns.grd", "<i2", 1, -32767, base=50.0, multiplier=4.0, columns=True)
geosoft("geosoft_double_blocks.grd", "<f8", 2, -1e32, blocks=2)
