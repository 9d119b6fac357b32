"""Makes the reference tables of the boosted trees with scikit-learn.

    python3 stages/learning/reference/trees/make_reference.py

Versions are written into each table. The tests do not run this script; they read the tables in this folder.
"""
from pathlib import Path

import numpy as np
import sklearn
from sklearn.ensemble import HistGradientBoostingRegressor

HERE = Path(__file__).resolve().parent
SOURCE = f"scikit-learn {sklearn.__version__}, numpy {np.__version__}"
COMMAND = "python3 stages/learning/reference/trees/make_reference.py"


def write(name, **columns):
    with open(HERE / name, "w") as file:
        file.write(f"# {SOURCE}; {COMMAND}\n")
        file.write(",".join(columns) + "\n")
        for row in zip(*columns.values(), strict=True):
            file.write(",".join(repr(float(value)) for value in row) + "\n")


def model(**settings):
    return HistGradientBoostingRegressor(early_stopping=False, max_bins=255, **settings)


def few_values():
    """Columns of at most 255 distinct values, so that bins and trees are the same in every implementation."""
    rng = np.random.default_rng(31)
    n = 300
    x = np.column_stack([
        np.round(rng.normal(size=n), 1),
        rng.integers(0, 12, n),
        np.round(rng.uniform(-2, 2, n), 1),
        np.round(rng.normal(size=n) * 40, 0),
        np.where(rng.uniform(size=n) < 0.7, 0.0, np.round(rng.exponential(3, n), 1)),
    ])
    y = 3 * np.sin(2 * x[:, 0]) + 0.3 * x[:, 1] * x[:, 2] + np.abs(x[:, 3]) * 0.05 - 2 * (x[:, 4] > 0)
    y = np.round(y + 0.3 * rng.normal(size=n) + 100, 3)
    first = model(learning_rate=0.1, max_iter=40, max_leaf_nodes=8, min_samples_leaf=5)
    second = model(learning_rate=0.3, max_iter=15, max_leaf_nodes=31, max_depth=3, min_samples_leaf=10,
                   l2_regularization=4.0)
    columns = {f"x{j}": x[:, j] for j in range(5)}
    write("few_values.csv", **columns, y=y, leaves=first.fit(x, y).predict(x), depth=second.fit(x, y).predict(x))


def waves(first, last):
    """The same numbers as in the tests: columns of many distinct values and a target that is not a sum of functions."""
    k = np.arange(first, last)
    x = np.column_stack([np.sin(k * (0.013 + 0.0171 * j) + 0.37 * j) + 0.2 * np.sin(k * (1.7 + 0.31 * j))
                         for j in range(8)])
    y = 10 * x[:, 0] * x[:, 1] + 5 * np.tanh(3 * x[:, 2]) + 4 * np.abs(x[:, 3]) + x[:, 4] + 0.5 * np.sin(k * k * 0.37)
    return x, y


def many_values():
    """Errors with several numbers of bins. They scatter, because the first trees affect all later trees."""
    x, y = waves(0, 6000)
    ahead, truth = waves(6000, 9000)
    rows = []
    for trees, leaves, rate in [(200, 31, 0.1), (300, 15, 0.1), (60, 63, 0.1)]:
        for bins in (255, 240, 220, 200, 180):
            fitted = HistGradientBoostingRegressor(
                early_stopping=False, max_bins=bins, learning_rate=rate, max_iter=trees, max_leaf_nodes=leaves
            ).fit(x, y)
            errors = np.mean((fitted.predict(x) - y) ** 2), np.mean((fitted.predict(ahead) - truth) ** 2)
            rows.append((trees, leaves, rate, bins, *errors))
    names = ("trees", "leaves", "rate", "bins", "train_mse", "ahead_mse")
    write("many_values.csv", **dict(zip(names, zip(*rows), strict=True)))


few_values()
many_values()
