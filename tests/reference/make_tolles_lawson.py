"""Reference coefficients for tests/examples.rs, with scipy 1.x and scikit-learn 1.x:

    python tests/reference/make_tolles_lawson.py

writes tolles_lawson.csv and tolles_lawson_ratio.csv into its folder.

Builds the 18 Tolles-Lawson terms of the 1000 real samples, band-passes terms and target by sosfiltfilt (odd padding
of 24, as MagNav.jl), drops 20 samples at each end, and fits by Ridge without intercept."""
import pathlib
import numpy as np
import pyarrow.parquet as pq
from scipy.signal import butter, sosfiltfilt
from sklearn.linear_model import Ridge

table = pq.read_table(pathlib.Path(__file__).parents[2]
                      / "datasets/samples/magnavjl_tl/magnavjl_tl.parquet").to_pandas()
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
raw = table["mag_1_uc_nt"].to_numpy()
fa, fy = filt(a)[20:-20], filt(raw)[20:-20]
here = pathlib.Path(__file__).parent
with open(here / "tolles_lawson.csv", "w") as out, open(here / "tolles_lawson_ratio.csv", "w") as ratio:
    print("lambda,term,value", file=out)
    print("lambda,improvement_ratio_band", file=ratio)
    for lam in [0.0, 0.001, 0.025, 0.25]:
        if lam == 0.0:
            beta = np.linalg.lstsq(fa, fy, rcond=None)[0]
        else:
            beta = Ridge(alpha=lam, fit_intercept=False, solver="svd").fit(fa, fy).coef_
        for n, v in zip(names, beta):
            print(f"{lam!r},{n},{float(v)!r}", file=out)
        print(f"{lam!r},{float(filt(raw).std(ddof=1) / filt(raw - a @ beta).std(ddof=1))!r}", file=ratio)
