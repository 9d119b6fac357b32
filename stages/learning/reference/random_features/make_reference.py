"""Makes the reference table of the random features with the Gaussian process of scikit-learn.

    python3 stages/learning/reference/random_features/make_reference.py

Versions are written into the table. The tests do not run this script; they read the table in this folder.
"""
from pathlib import Path

import numpy as np
import sklearn
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, DotProduct, RBF, WhiteKernel

HERE = Path(__file__).resolve().parent
SOURCE = f"scikit-learn {sklearn.__version__}, numpy {np.__version__}"
COMMAND = "python3 stages/learning/reference/random_features/make_reference.py"
LENGTH = 1.5


def write(name, **columns):
    with open(HERE / name, "w") as file:
        file.write(f"# {SOURCE}; {COMMAND}\n")
        file.write(",".join(columns) + "\n")
        for row in zip(*columns.values(), strict=True):
            file.write(",".join(repr(float(value)) for value in row) + "\n")


rng = np.random.default_rng(7)
n = 220
x = np.round(rng.normal(size=(n, 3)), 4)
y = 4 * np.sin(1.3 * x[:, 0]) + 2 * x[:, 1] * x[:, 2] + 1.5 * x[:, 1] + 60 + 0.4 * rng.normal(size=n)
y = np.round(y, 4)
train = np.arange(n) < 160

# A constant of large variance approximates the flat prior; the other variances are the most likely ones.
plain = ConstantKernel(10.0, (1e-3, 1e5)) * RBF(LENGTH, "fixed")
linear = ConstantKernel(10.0, (1e-3, 1e5)) * (RBF(LENGTH, "fixed") + DotProduct(0.0, "fixed"))
columns = {}
for name, kernel in [("plain", plain), ("linear", linear)]:
    whole = ConstantKernel(1e6, "fixed") + kernel + WhiteKernel(1.0, (1e-6, 1e3))
    model = GaussianProcessRegressor(whole, n_restarts_optimizer=3, random_state=0).fit(x[train], y[train] - 60)
    found = model.kernel_.get_params()
    noise, scale = found["k2__noise_level"], found["k1__k2__k1__constant_value"]
    mean, deviation = model.predict(x, return_std=True)
    columns |= {
        f"{name}_mean": mean + 60,
        f"{name}_deviation": np.sqrt(deviation**2 - noise),
        f"{name}_noise": np.full(n, noise),
        f"{name}_lambda": np.full(n, noise / scale),
    }
write("gaussian_process.csv", train=train, **{f"x{j}": x[:, j] for j in range(3)}, y=y, **columns)
