"""Makes the reference tables of elementary effects and Sobol indices with SALib.

    python3 stages/learning/reference/sensitivity/make_reference.py

The tables hold SALib's samples of the Ishigami function and of a network trained on it, the outputs, and SALib's
indices. The tests do not run this script; they read the tables in this folder.
"""
from importlib.metadata import version
from pathlib import Path

import numpy as np
from SALib.analyze import morris as analyze_morris
from SALib.analyze import sobol as analyze_sobol
from SALib.sample import morris as sample_morris
from SALib.sample import sobol as sample_sobol

HERE = Path(__file__).resolve().parent
COMMAND = "python3 stages/learning/reference/sensitivity/make_reference.py"
SOURCE = f"SALib {version('SALib')}, numpy {np.__version__}"
PROBLEM = {"num_vars": 3, "names": ["x1", "x2", "x3"], "bounds": [[-np.pi, np.pi]] * 3}


def write(name, **columns):
    with open(HERE / name, "w") as file:
        file.write(f"# {SOURCE}; {COMMAND}\n")
        file.write(",".join(columns) + "\n")
        for row in zip(*columns.values(), strict=True):
            file.write(",".join(repr(float(value)) for value in row) + "\n")


def ishigami(x):
    return np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])


def trained():
    """A network of 24 tanh units, trained on 1000 samples of the Ishigami function by full-batch Adam."""
    rng = np.random.default_rng(5)
    x = rng.uniform(-np.pi, np.pi, (1000, 3))
    y = (ishigami(x) - 3.5) / 3.7
    weights = [rng.normal(size=(3, 24)) * 0.6, np.zeros(24), rng.normal(size=24) * 0.2, np.zeros(1)]
    moments = [[np.zeros_like(w), np.zeros_like(w)] for w in weights]
    for step in range(1, 3001):
        h = np.tanh(x @ weights[0] + weights[1])
        e = 2 * (h @ weights[2] + weights[3][0] - y) / len(y)
        back = np.outer(e, weights[2]) * (1 - h**2)
        gradients = [x.T @ back, back.sum(0), h.T @ e, np.array([e.sum()])]
        for w, g, (m, v) in zip(weights, gradients, moments):
            m += 0.1 * (g - m)
            v += 0.001 * (g**2 - v)
            w -= 0.01 * (m / (1 - 0.9**step)) / (np.sqrt(v / (1 - 0.999**step)) + 1e-8)
    print("mean square error of the network, in variances:", float(np.mean((h @ weights[2] + weights[3][0] - y) ** 2)))
    return lambda x: 3.5 + 3.7 * (np.tanh(x @ weights[0] + weights[1]) @ weights[2] + weights[3][0])


for suffix, model in [("", ishigami), ("_network", trained())]:
    x = sample_morris.sample(PROBLEM, N=20, num_levels=4, seed=7)
    y = model(x)
    found = analyze_morris.analyze(PROBLEM, x, y, num_levels=4, seed=7)
    write(f"morris{suffix}.csv", x1=x[:, 0], x2=x[:, 1], x3=x[:, 2], y=y)
    write(f"morris{suffix}_indices.csv", mu=found["mu"], mu_star=found["mu_star"], sigma=found["sigma"])
    x = sample_sobol.sample(PROBLEM, 64, calc_second_order=False, seed=7)
    y = model(x)
    found = analyze_sobol.analyze(PROBLEM, y, calc_second_order=False, num_resamples=1000, seed=7)
    write(f"sobol{suffix}.csv", x1=x[:, 0], x2=x[:, 1], x3=x[:, 2], y=y)
    columns = {"first": "S1", "first_conf": "S1_conf", "total": "ST", "total_conf": "ST_conf"}
    write(f"sobol{suffix}_indices.csv", **{ours: found[theirs] for ours, theirs in columns.items()})
