"""Makes sgl_expected.csv: the columns that a reader derives from Flt1003_sample.xyz, row by row.

python3 make_sgl_expected.py   (numpy, pyproj 3.7.2)

Velocity: geodesic distance (Karney) between the adjacent samples of a line divided by their time difference, resolved
by its azimuth at the middle. Specific force: the rotated vector of the accelerometers, with the x axis `wander`
counter-clockwise from north, the y axis 90 degrees further, and z up.
"""
import numpy as np
import pyproj

lines = [l for l in open("../samples/magnavjl_sample/Flt1003_sample.xyz")]
names = [l for l in lines if l.startswith("/") and len(l.split()) > 2][-1].lstrip("/").split()
rows = [l.split() for l in lines if l.strip() and not l.startswith("/")]
col = lambda n: np.array([np.nan if r[names.index(n)] == "*" else float(r[names.index(n)]) for r in rows])
line, tt, lat, lon, alt = (col(n) for n in ["LINE", "TIME", "LAT", "LONG", "UTM-Z"])
geod = pyproj.Geod(ellps="WGS84")
with open("sgl_expected.csv", "w") as out:
    out.write("vn,ve,vd,ins_ve,ins_vd,ins_fn,ins_fe,ins_fd,igrf,ins_lat_deg\n")
    for i in range(len(rows)):
        same = np.flatnonzero(line == line[i])
        a, b = max(i - 1, same[0]), min(i + 1, same[-1])
        dt = tt[b] - tt[a]
        azimuth, back, distance = geod.inv(lon[a], lat[a], lon[b], lat[b])
        distance *= 1 + alt[i] / 6.38e6
        # `back` points from the end to the beginning; the mean direction is the direction of the sum of unit vectors.
        middle = np.angle(np.exp(1j * np.radians(azimuth)) - np.exp(1j * np.radians(back)))
        x, y, z, wander = (col(n)[i] for n in ["INS_ACC_X", "INS_ACC_Y", "INS_ACC_Z", "INS_WANDER"])
        # Azimuths (clockwise from north) of the two horizontal axes.
        ax, ay = -wander, -wander - np.pi / 2
        values = [
            distance * np.cos(middle) / dt, distance * np.sin(middle) / dt, -(alt[b] - alt[a]) / dt,
            -col("INS_VEL_W")[i], -col("INS_VEL_V")[i],
            x * np.cos(ax) + y * np.cos(ay), x * np.sin(ax) + y * np.sin(ay), -z,
            col("DCMAG1")[i] - col("IGRFMAG1")[i], np.degrees(col("INS_LAT")[i]),
        ]
        out.write(",".join(f"{v:.9f}" for v in values) + "\n")
