"""Reference coefficients for tests/examples.rs, with scipy 1.x and scikit-learn 1.x:

    python tests/reference/make_tolles_lawson.py > tests/reference/tolles_lawson.csv

Builds the 18 Tolles-Lawson terms of the 1000 real samples, band-passes terms and target by sosfiltfilt (odd padding
of 24, as MagNav.jl), drops 20 samples at each end, and fits by Ridge without intercept."""
import sys, pathlib
import numpy as np
import pyarrow.parquet as pq
from scipy.signal import butter, sosfiltfilt
from sklearn.linear_model import Ridge

table = pq.read_table(pathlib.Path(__file__).parents[2] / "datasets/samples/magnavjl_tl/magnavjl_tl.parquet").to_pandas()
b = table[["flux_a_x_nt", "flux_a_y_nt", "flux_a_z_nt"]].to_numpy()
bt = np.linalg.norm(b, axis=1)[:, None]
db = np.vstack([b[1] - b[0], (b[2:] - b[:-2]) / 2, b[-1] - b[-2]])
u, s = b / bt, 50000.0
pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
induced = np.column_stack([u[:, i] * b[:, j] / s for i, j in pairs])
eddy = np.column_stack([u[:, i] * db[:, j] / s for i in range(3) for j in range(3)])
a = np.hstack([u, induced, eddy])
names = list("xyz") + ["xyz"[i] + "xyz"[j] for i, j in pairs] + [f"{i}{j}_dot" for i in "xyz" for j in "xyz"]
sos = butter(4, [0.1, 0.9], "bandpass", fs=10.0, output="sos")
filt = lambda x: sosfiltfilt(sos, x, axis=0, padtype="odd", padlen=24)
a, y = filt(a)[20:-20], filt(table["mag_1_uc_nt"].to_numpy())[20:-20]
print("lambda,term,value")
for lam in [0.0, 0.001, 0.025, 0.25]:
    if lam == 0.0:
        beta = np.linalg.lstsq(a, y, rcond=None)[0]
    else:
        beta = Ridge(alpha=lam, fit_intercept=False, solver="svd").fit(a, y).coef_
    for n, v in zip(names, beta):
        print(f"{lam!r},{n},{v!r}".replace("np.float64(", "").replace(")", ""))
