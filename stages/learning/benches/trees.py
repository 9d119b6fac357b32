"""Boosted trees of scikit-learn on the rows of `trees.rs`: times and mean square errors.

    OMP_NUM_THREADS=2 python3 stages/learning/benches/trees.py
"""
import time

import numpy as np
import sklearn
from sklearn.ensemble import HistGradientBoostingRegressor


def rows(first, count):
    k = np.arange(first, first + count, dtype=float)
    waves = [np.sin(k * (0.00013 + 0.000171 * j) + 0.37 * j) + 0.2 * np.sin(k * (1.7 + 0.31 * j)) for j in range(77)]
    x = np.column_stack(waves)
    bent = 5 * np.tanh(3 * x[:, 2]) + 4 * np.abs(x[:, 3]) + x[:, 4] * x[:, 5] + 2 * x[:, 40] * (x[:, 60] + 0.3)
    return x, 10 * x[:, 0] + bent + 0.5 * np.sin(k * k * 0.37)


x, y = rows(0, 200_000)
ahead, truth = rows(200_000, 20_000)
model = HistGradientBoostingRegressor(early_stopping=False, max_iter=200, max_leaf_nodes=31, learning_rate=0.1)
clock = time.perf_counter()
model.fit(x, y)
trained = time.perf_counter() - clock
clock = time.perf_counter()
found = model.predict(x)
predicted = time.perf_counter() - clock
errors = np.mean((found - y) ** 2), np.mean((model.predict(ahead) - truth) ** 2)
print(f"scikit-learn {sklearn.__version__}: training {trained:.2f} s, prediction {predicted:.2f} s, errors {errors}")
