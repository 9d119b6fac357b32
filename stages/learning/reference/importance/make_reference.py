"""Makes the reference tables of importance with SHAP, scikit-learn and scipy.

    python3 stages/learning/reference/importance/make_reference.py

Versions are written into each table. The tests do not run this script; they read the tables in this folder.
"""
import itertools
import math
from pathlib import Path

import numpy as np
import scipy
import scipy.stats
import shap
import sklearn
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.linear_model import LinearRegression

HERE = Path(__file__).resolve().parent
SOURCE = (f"shap {shap.__version__}, scikit-learn {sklearn.__version__}, scipy {scipy.__version__}, "
          f"numpy {np.__version__}")
COMMAND = "python3 stages/learning/reference/importance/make_reference.py"
EXPLAINED, BACKGROUND, WIDTH = 6, 20, 5


def write(name, **columns):
    with open(HERE / name, "w") as file:
        file.write(f"# {SOURCE}; {COMMAND}\n")
        file.write(",".join(columns) + "\n")
        for row in zip(*columns.values(), strict=True):
            file.write(",".join(repr(float(value)) for value in row) + "\n")


def model(x):
    """The same function as in the tests."""
    pairs = 3 * np.tanh(x[:, 0] * x[:, 1] + x[:, 2] * x[:, 3])
    return pairs + x[:, 2] ** 2 * x[:, 3] - 2 * x[:, 4] + np.sin(x[:, 0] + x[:, 3])


rng = np.random.default_rng(11)
x = np.round(rng.normal(size=(EXPLAINED + BACKGROUND, WIDTH)), 3)
rows, background = x[:EXPLAINED], x[EXPLAINED:]
masker = shap.maskers.Independent(background, max_samples=BACKGROUND)
columns = {f"x{j}": x[:, j] for j in range(WIDTH)}


def padded(values):
    return np.vstack([values, np.zeros((BACKGROUND, WIDTH))])


exact = shap.explainers.Exact(model, masker)(rows).values
kernel = shap.KernelExplainer(model, background).shap_values(rows, nsamples="auto", silent=True)
assert np.abs(exact - kernel).max() < 1e-9, np.abs(exact - kernel).max()
permuted = shap.explainers.Permutation(model, masker, seed=1)(rows, max_evals=2000).values
# Sampling error of SHAP; the tests print it for comparison with magline's.
print("permutation explainer, 2000 evaluations: largest difference from exact", np.abs(permuted - exact).max())
columns |= {f"exact{j}": padded(exact)[:, j] for j in range(WIDTH)}

y = model(x)
linear = LinearRegression().fit(x, y)
shares = shap.LinearExplainer(linear, masker).shap_values(rows)
columns |= {f"linear{j}": padded(shares)[:, j] for j in range(WIDTH)}
columns["coefficient"] = np.r_[linear.coef_, np.zeros(len(x) - WIDTH)]
write("shapley.csv", **columns)

# A forest as a list of nodes: TreeExplainer against the background ("interventional").
more = np.round(rng.normal(size=(200, WIDTH)), 2)
forest = HistGradientBoostingRegressor(max_iter=12, max_leaf_nodes=12, min_samples_leaf=5, early_stopping=False)
forest.fit(more, model(more))
shares = shap.TreeExplainer(forest, background, feature_perturbation="interventional").shap_values(rows)
assert np.abs(shares.sum(1) + forest.predict(background).mean() - forest.predict(rows)).max() < 1e-4
nodes = [(t, n) for t, stage in enumerate(forest._predictors) for n in stage[0].nodes]
field = lambda name: [n[name] for _, n in nodes]
write(
    "forest.csv", tree=[t for t, _ in nodes], leaf=field("is_leaf"), feature=field("feature_idx"),
    threshold=[0.0 if n["is_leaf"] else n["num_threshold"] for _, n in nodes], left=field("left"), right=field("right"),
    value=field("value"), base=np.full(len(nodes), forest._baseline_prediction.item()),
)
write("forest_shapley.csv", prediction=forest.predict(rows), **{f"value{j}": shares[:, j] for j in range(WIDTH)})

# Correlations with ties.
n = 40
a = rng.integers(0, 12, n) * 1.0
b = np.round(0.3 * a + rng.normal(size=n), 1)
c = np.round(np.exp(b), 3)
pairs = {"ab": (a, b), "ac": (a, c), "bc": (b, c)}
write(
    "correlation.csv", a=a, b=b, c=c,
    **{f"pearson_{k}": np.full(n, scipy.stats.pearsonr(*v).statistic) for k, v in pairs.items()},
    **{f"spearman_{k}": np.full(n, scipy.stats.spearmanr(*v).statistic) for k, v in pairs.items()},
)

# The best subset of three of eight moderately correlated columns, by exhaustive search.
n = 60
base = rng.normal(size=(n, 8))
d = np.round(base + 0.3 * base[:, ::-1], 4)
d = (d - d.mean(0)) / d.std(0, ddof=1)
t = d @ [0, 3, 0, 0, -2, 0, 1.5, 0] + 0.3 * rng.normal(size=n)
t -= t.mean()


def fitted(places):
    return np.linalg.lstsq(d[:, places], t, rcond=None)[0]


best = min(map(list, itertools.combinations(range(8), 3)), key=lambda s: np.sum((t - d[:, s] @ fitted(s)) ** 2))
coefficients = np.zeros(n)
coefficients[best] = fitted(best)
write("sparse.csv", **{f"d{j}": d[:, j] for j in range(8)}, t=t, coefficient=coefficients)
assert math.isfinite(coefficients.sum()), best
