"""The figures of datasets/examples/uav.toml by numpy: the core-field model on the magnitude of Thor's magnetometer.

Run in the repository: python tests/reference/uav.py > tests/reference/uav.csv (numpy 2, pyarrow). The field is
constant (IGRF at the site: north 172, east 2, down 532 mgauss). Interpolation to 10 Hz is linear.
"""

import numpy as np
import pyarrow.parquet as pq

table = pq.read_table("datasets/samples/thor75/flight.parquet")
col = lambda name: table[name].to_numpy()
time = col("time_s")
core = np.array([172.0, 2.0, 532.0]) * 100
lines = {"1": (235.0, 384.0), "2": (384.0, 533.0)}


def line(start, end):
    own = (time >= start) & (time <= end) if end > 500 else (time >= start) & (time < end)
    grid = np.arange(time[own][0], time[own][-1], 0.1)
    at = lambda x: np.interp(grid, time[own], x[own])
    field = np.c_[at(col("mag_x_gauss")), -at(col("mag_y_gauss")), -at(col("mag_z_gauss"))] * 1e5
    roll, pitch, yaw = at(col("roll_rad")), at(col("pitch_rad")), at(np.unwrap(col("yaw_rad")))
    throttle = at(col("throttle_fraction"))
    (sr, cr), (sp, cp), (sy, cy) = [(np.sin(a), np.cos(a)) for a in (roll, pitch, yaw)]
    to_ned = np.stack([
        np.c_[cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        np.c_[cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        np.c_[-sp, sr * cp, cr * cp],
    ], axis=1)
    body = np.einsum("nij,i->nj", to_ned, core)
    size = np.linalg.norm(field, axis=1)
    u = field / size[:, None]
    rate = np.gradient(body, axis=0)
    plain = np.c_[u, *[u[:, [i]] * body / 5e4 for i in range(3)], *[u[:, [i]] * rate / 5e4 for i in range(3)]]
    motor = np.c_[throttle, throttle[:, None] * u, np.gradient(throttle)[:, None] * u]
    return {"attitude": plain, "motor": np.c_[plain, motor]}, size - np.linalg.norm(core)


made = {name: line(*span) for name, span in lines.items()}
print("model,calibration,line,std_uncompensated,std_error")
for model in ("attitude", "motor"):
    for calibration in lines:
        terms, target = made[calibration]
        solved = np.linalg.lstsq(terms[model], target, rcond=None)[0]
        for test in lines:
            terms, target = made[test]
            rest = target - terms[model] @ solved
            print(f"{model},{calibration},{test},{target.std():.1f},{rest.std():.1f}")
