"""Makes projections.csv: positions in projected systems and their WGS-84 latitude and longitude.

python3 make_projections.py   (pyproj 3.7.2, PROJ 9.5.1, without grid-shift files)
"""
import pyproj

PLACES = {
    32754: [(448400, 7548700), (482800, 7594800), (465600, 7571700), (300000, 7000000)],
    32630: [(369750, 5676750), (470000, 5575500), (400000, 5600000)],
    27700: [(200000, 50000), (300000, 150000), (250000, 100000), (530000, 180000)],
    28354: [(448400, 7548700), (482800, 7594800)],
    7854: [(448400, 7548700)],
    2193: [(1576000, 5176000)],
    3857: [(-500000, 6500000)],
    2154: [(652000, 6862000)],
    3347: [(7470000, 1200000), (4000000, 2000000)],
    3031: [(500000, 1500000), (-2000000, 300000)],
    3413: [(100000, -1500000), (-900000, -800000)],
    5041: [(2100000, 1400000)],
    5070: [(1500000, 2200000), (-1900000, 1700000)],
    3577: [(900000, -2400000)],
    3005: [(1200000, 500000)],
    3112: [(700000, -2500000)],
    2263: [(1000000, 200000)],
    3035: [(4321000, 2900000), (3500000, 3200000)],
    3034: [(3900000, 2500000)],
    2056: [(2600000, 1200000)],
    3832: [(1000000, -2000000)],
    4283: [(140.7, -21.9)],
}

with open("projections.csv", "w") as out:
    out.write("epsg,easting_m,northing_m,lat_deg,lon_deg\n")
    for epsg, places in PLACES.items():
        back = pyproj.Transformer.from_crs(epsg, 4326, always_xy=True)
        for easting, northing in places:
            lon, lat = back.transform(easting, northing)
            out.write(f"{epsg},{easting},{northing},{lat:.11f},{lon:.11f}\n")
