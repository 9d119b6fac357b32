"""Reference values for the navigation numerics, made by scipy.

    python3 make_reference.py

writes natural_cubic.in (a natural cubic spline) and transition.csv (matrix exponentials of the
Pinson matrix and the integral of the process noise). Run with numpy 2.4.6, scipy 1.17.1.
The matrix is written down here from Gnadt 2022, (5.16) to (5.32), apart from the program's own code.
"""

from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

here = Path(__file__).parent


def natural_cubic():
    spline = CubicSpline(range(6), [3, -1, 4, 1, -5, 9], bc_type="natural")
    rows = [(at, float(spline(at)), float(spline(at, 1))) for at in (0.25, 1.5, 2.9, 4.125)]
    text = ",\n".join(f"    ({a!r}, {v!r}, {d!r})" for a, v, d in rows)
    (here / "natural_cubic.in").write_text(f"[\n{text},\n]\n")


def dcm(roll, pitch, yaw):
    c, s = np.cos, np.sin
    rx = np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
    ry = np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
    rz = np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
    return rz @ ry @ rx


def pinson(lat, v, f, euler, taus):
    """Order: position, velocity, tilt, accelerometers, gyroscopes, h_a, a_hat, S."""
    r, omega, k1, k2, k3 = 6378137.0, 7.2921151467e-5, 3e-2, 3e-4, 1e-6
    (vn, ve, vd), (fn, fe, fd) = v, f
    s, c, t = np.sin(lat), np.cos(lat), np.tan(lat)
    m = np.zeros((18, 18))
    m[0:3, 0:3] = [[0, 0, -vn / r**2], [ve * t / (r * c), 0, -ve / (r**2 * c)], [0, 0, -k1]]
    m[0:3, 3:6] = np.diag([1 / r, 1 / (r * c), -1])
    m[3:6, 0:3] = [
        [-ve * (2 * omega * c + ve / (r * c**2)), 0, (ve**2 * t - vn * vd) / r**2],
        [2 * omega * (vn * c - vd * s) + vn * ve / (r * c**2), 0, -ve * (vn * t + vd) / r**2],
        [2 * omega * ve * s, 0, (vn**2 + ve**2) / r**2 + k2],
    ]
    m[3:6, 3:6] = [
        [vd / r, -2 * (omega * s + ve * t / r), vn / r],
        [2 * omega * s + ve * t / r, (vn * t + vd) / r, 2 * omega * c + ve / r],
        [-2 * vn / r, -2 * (omega * c + ve / r), 0],
    ]
    m[3:6, 6:9] = [[0, -fd, fe], [fd, 0, -fn], [-fe, fn, 0]]
    m[6:9, 0:3] = [
        [-omega * s, 0, -ve / r**2],
        [0, 0, vn / r**2],
        [-omega * c - ve / (r * c**2), 0, ve * t / r**2],
    ]
    m[6:9, 3:6] = [[0, 1 / r, 0], [-1 / r, 0, 0], [0, -t / r, 0]]
    m[6:9, 6:9] = [
        [0, -(omega * s + ve * t / r), vn / r],
        [omega * s + ve * t / r, 0, omega * c + ve / r],
        [-vn / r, -(omega * c + ve / r), 0],
    ]
    m[3:6, 9:12] = dcm(*euler)
    m[6:9, 12:15] = -dcm(*euler)
    baro, acc, gyro, fogm = taus
    m[9:15, 9:15] = -np.diag([1 / acc] * 3 + [1 / gyro] * 3)
    m[2, 15], m[5, 15], m[5, 16] = k1, -k2, 1
    m[15, 15], m[16, 2], m[16, 15] = -1 / baro, k3, -k3
    m[17, 17] = -1 / fogm
    return m


# Sizes that make unlike states comparable (metres, metres per 30 s, ...): the exponential of the
# balanced matrix is accurate in every element, that of the plain one only in its largest.
SCALE = np.array([6.4e6, 6.4e6, 1.0] + [30.0] * 3 + [9.8 * 30**2] * 3 + [30.0**2] * 3 + [9.8 * 30**3] * 3
                 + [1.0, 900.0, 1.0])


def exponential(f, dt):
    return expm(f * dt * SCALE[:, None] / SCALE) / SCALE[:, None] * SCALE


def van_loan(f, q, dt):
    scaled = balanced_van_loan(f * SCALE[:, None] / SCALE, q * SCALE**2, dt)
    return scaled / SCALE[:, None] / SCALE


def balanced_van_loan(f, q, dt):
    n = len(f)
    big = np.zeros((2 * n, 2 * n))
    big[:n, :n], big[:n, n:], big[n:, n:] = -f, np.diag(q), f.T
    e = expm(big * dt)
    return e[n:, n:].T @ e[:n, n:]


def transition():
    cases = {
        "level": (0.75, (60, -35, 1.5), (0.3, -0.2, -9.7), (0.1, -0.2, 2.5), (3600, 3600, 3600, 600)),
        "turn": (-1.2, (-180, 210, -8), (4.1, -5.3, -12.4), (-0.8, 0.3, -2.0), (900, 1200, 300, 60)),
    }
    q = [1e-30] * 3 + [2.38e-4**2] * 3 + [5.81e-7**2] * 3
    q += [2 * 2.45e-4**2 / 3600] * 3 + [2 * 7.27e-9**2 / 3600] * 3 + [2 / 3600, 1e-30, 2 * 9 / 600]
    lines = ["case,dt_s,what,row,column,value"]
    for name, case in cases.items():
        f = pinson(*case)
        for dt in (0.1, 1.0, 30.0):
            for what, m in (("phi", exponential(f, dt)), ("noise", van_loan(f, np.array(q), dt))):
                lines += [
                    f"{name},{dt},{what},{i},{j},{m[i, j]!r}"
                    for i in range(18)
                    for j in range(18)
                    if m[i, j] != 0
                ]
    (here / "transition.csv").write_text("\n".join(lines).replace("np.float64(", "").replace(")", "") + "\n")


natural_cubic()
transition()
