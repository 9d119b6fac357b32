"""The WMM2025 test places evaluated by the textbook sum over Schmidt semi-normalised Legendre functions.

    python3 stages/numerics/reference/core_field/make_exact.py > stages/numerics/reference/core_field/wmm2025_exact.csv

The official high-precision values agree with this sum in the east component to their last digit, but differ in the
north component by up to 0.0007 nT without a pattern (as one-sided numerical derivatives of the Legendre functions
would); down is touched through the turn from the sphere to the ellipsoid (0.000002 nT).
"""

import math
from pathlib import Path

HERE = Path(__file__).parent
COF = HERE.parent.parent / "src/numerics/core_field/WMM2025.COF"
A_KM, F, REFERENCE_KM = 6378.137, 1 / 298.257223563, 6371.2
E2 = F * (2 - F)


def coefficients():
    rows = [line.split() for line in COF.read_text().splitlines()[1:]]
    return {(int(w[0]), int(w[1])): [float(x) for x in w[2:]] for w in rows if len(w) == 6}


def legendre(lat):
    ct, st = math.sin(lat), math.cos(lat)
    p, d = {(0, 0): 1.0}, {(0, 0): 0.0}
    for n in range(1, 13):
        for m in range(n + 1):
            if n == m:
                k = 1 if n == 1 else math.sqrt(1 - 1 / (2 * n))
                p[n, m] = k * st * p[n - 1, m - 1]
                d[n, m] = k * (st * d[n - 1, m - 1] + ct * p[n - 1, m - 1])
            else:
                q, c = math.sqrt(n * n - m * m), math.sqrt((n - 1) ** 2 - m * m)
                p[n, m] = ((2 * n - 1) * ct * p[n - 1, m] - c * p.get((n - 2, m), 0)) / q
                d[n, m] = ((2 * n - 1) * (ct * d[n - 1, m] - st * p[n - 1, m]) - c * d.get((n - 2, m), 0)) / q
    return p, d


def field(gauss, year, height_km, lat_deg, lon_deg):
    phi, lam = math.radians(lat_deg), math.radians(lon_deg)
    n_km = A_KM / math.sqrt(1 - E2 * math.sin(phi) ** 2)
    rho, z = (n_km + height_km) * math.cos(phi), (n_km * (1 - E2) + height_km) * math.sin(phi)
    r = math.hypot(rho, z)
    lat = math.asin(z / r)
    p, d = legendre(lat)
    north = east = down = 0.0
    for (n, m), (g, h, g_dot, h_dot) in gauss.items():
        g, h = g + g_dot * (year - 2025), h + h_dot * (year - 2025)
        c, s = math.cos(m * lam), math.sin(m * lam)
        scale = (REFERENCE_KM / r) ** (n + 2)
        north += scale * (g * c + h * s) * d[n, m]
        east += scale * m * (g * s - h * c) * p[n, m] / math.cos(lat)
        down -= scale * (n + 1) * (g * c + h * s) * p[n, m]
    turn = lat - phi
    return north * math.cos(turn) - down * math.sin(turn), east, north * math.sin(turn) + down * math.cos(turn)


gauss = coefficients()
print("decimal_year,height_km,latitude_deg,longitude_deg,x_nt,y_nt,z_nt")
for line in (HERE / "wmm2025_test_values.csv").read_text().splitlines()[1:]:
    place = line.split(",")[:4]
    print(",".join(place + [f"{x:.6f}" for x in field(gauss, *map(float, place))]))
