"""Makes the reference tables of the linear models with scikit-learn, statsmodels and scipy.

    python3 stages/numerics/reference/models/make_reference.py

Versions are written into each table. The tests never run this; they read the tables beside it.
"""
from pathlib import Path

import numpy as np
import scipy
import sklearn
import statsmodels
import statsmodels.api as sm
from scipy.optimize import minimize
from sklearn.cross_decomposition import PLSRegression
from sklearn.decomposition import PCA
from sklearn.linear_model import ElasticNet, ElasticNetCV, HuberRegressor, Ridge, enet_path
from sklearn.model_selection import LeaveOneGroupOut, cross_val_score
from sklearn.preprocessing import MaxAbsScaler, MinMaxScaler

HERE = Path(__file__).resolve().parent
SKLEARN = f"scikit-learn {sklearn.__version__}, numpy {np.__version__}"
COMMAND = "python3 stages/numerics/reference/models/make_reference.py"
P = 8
NAMES = [f"a{j}" for j in range(P)]


def write(name, source, **columns):
    with open(HERE / name, "w") as file:
        file.write(f"# {source}; {COMMAND}\n")
        file.write(",".join(columns) + "\n")
        for row in zip(*columns.values(), strict=True):
            file.write(",".join(repr(float(value)) for value in row) + "\n")


def samples():
    """Four lines of unequal length, eight correlated terms of unequal size and two targets."""
    rng = np.random.default_rng(20)
    line = np.repeat([0, 1, 2, 3], [40, 25, 35, 20])
    n = line.size
    base = rng.normal(size=(n, 5)) + 0.5 * line[:, None] * rng.normal(size=5)
    mix = rng.normal(size=(5, P))
    a = (base @ mix + 0.3 * rng.normal(size=(n, P))) * 10.0 ** np.array([0, 1, -1, 0, 2, 0, -1, 1]) + np.arange(P)
    # Six digits, so that the table is short and everyone starts from the same numbers.
    a = np.round(a, 4)
    beta = np.array([3.0, 0, 20.0, 0, 0.05, -2.0, 0, 0.1])
    y0 = np.round(a @ beta + 2 * rng.normal(size=n) + 7, 4)
    y1 = np.round(a @ np.roll(beta, 1) * 0.5 - y0 + rng.standard_t(2, size=n), 4)
    return a, y0, y1, line


def elastic_net(a, y, groups):
    rows = []
    for l1_ratio in (0.2, 0.5, 0.99):
        for alpha in (0.05, 0.5, 5.0):
            for intercept in (0, 1):
                fit = ElasticNet(alpha=alpha, l1_ratio=l1_ratio, fit_intercept=bool(intercept), tol=1e-14,
                                 max_iter=1000000)
                fit.fit(a, y)
                rows.append([l1_ratio, alpha, intercept, fit.intercept_, *fit.coef_])
    names = ["l1_ratio", "alpha", "centred", "intercept", *NAMES]
    write("elastic_net.csv", f"{SKLEARN}, ElasticNet", **dict(zip(names, np.transpose(rows))))
    standard = (a - a.mean(0)) / a.std(0, ddof=1)
    alphas, coefs, _ = enet_path(standard, y - y.mean(), l1_ratio=0.7, alphas=12, eps=1e-3, tol=1e-14, max_iter=1000000)
    write("enet_path.csv", f"{SKLEARN}, enet_path of standardised terms (n - 1), l1_ratio 0.7",
          alpha=alphas, **dict(zip(NAMES, coefs)))
    folds = list(LeaveOneGroupOut().split(a, y, groups))
    cv = ElasticNetCV(l1_ratio=0.7, alphas=10, eps=1e-3, cv=folds, tol=1e-14, max_iter=1000000).fit(a, y)
    write("enet_cv.csv",
          f"{SKLEARN}, ElasticNetCV leaving one line out, l1_ratio 0.7; chosen alpha {float(cv.alpha_)!r}",
          alpha=cv.alphas_, **{f"line{k}": cv.mse_path_[:, k] for k in range(4)})


def pls(a, y0, y1, groups):
    rows = []
    for targets in (1, 2):
        y = np.column_stack([y0, y1])[:, :targets]
        for k in range(1, P + 1):
            fit = PLSRegression(n_components=k, scale=True, tol=1e-31, max_iter=100000).fit(a, y)
            for t in range(targets):
                # Its own intercept_ is that of centred terms.
                rows.append([targets, k, t, np.atleast_2d(fit.predict(np.zeros((1, P))))[0, t], *fit.coef_[t]])
    names = ["targets", "components", "target", "intercept", *NAMES]
    write("pls.csv", f"{SKLEARN}, PLSRegression(scale=True)", **dict(zip(names, np.transpose(rows))))
    folds = list(LeaveOneGroupOut().split(a, y0, groups))
    scores = [-cross_val_score(PLSRegression(k), a, y0, cv=folds, scoring="neg_mean_squared_error")
              for k in range(1, P + 1)]
    write("pls_cv.csv", f"{SKLEARN}, PLSRegression leaving one line out", components=range(1, P + 1),
          **{f"line{k}": np.array(scores)[:, k] for k in range(4)})


def ridge(a, y):
    rows = []
    deviation = a.std(0, ddof=1)
    scalers = [1 / deviation, MaxAbsScaler().fit(a).max_abs_ ** -1.0, MinMaxScaler().fit(a).scale_]
    for number, scale in enumerate(scalers, start=1):
        for lam in (0.0, 0.5, 50.0):
            fit = Ridge(alpha=lam, solver="svd").fit(a * scale, y)
            rows.append([number, lam, fit.intercept_, *(fit.coef_ * scale)])
    names = ["scaling", "lambda", "intercept", *NAMES]
    write("ridge_scaled.csv", f"{SKLEARN}, Ridge; scaling 1 standard deviation (n - 1), 2 MaxAbsScaler, 3 MinMaxScaler",
          **dict(zip(names, np.transpose(rows))))


def robust(a, y):
    rows = []
    center, spread = a.mean(0), a.std(0)
    z = np.column_stack([np.ones(len(y)), (a - center) / spread])
    for epsilon, penalty in ((1.35, 0.0), (1.35, 3.0), (2.0, 0.0)):
        fit = HuberRegressor(epsilon=epsilon, alpha=penalty, max_iter=100000, tol=1e-12).fit(a, y)

        def objective(theta, epsilon=epsilon, penalty=penalty):
            """HuberRegressor's objective, in scaled terms where its minimum is found to more digits."""
            r, s, w = y - z @ theta[:-1], np.exp(theta[-1]), theta[1:-1] / spread
            inside = np.abs(r) <= epsilon * s
            loss = np.where(inside, r * r / s, 2 * epsilon * np.abs(r) - s * epsilon**2)
            slope = np.where(inside, 2 * r / s, 2 * epsilon * np.sign(r))
            gradient = -z.T @ slope
            gradient[1:] += 2 * penalty * w / spread
            by_scale = len(y) - np.where(inside, r * r / s**2, epsilon**2).sum()
            return len(y) * s + loss.sum() + penalty * (w * w).sum(), np.append(gradient, s * by_scale)

        theta = np.concatenate([[fit.intercept_ + fit.coef_ @ center], fit.coef_ * spread, [np.log(fit.scale_)]])
        before = objective(theta)[0]
        for _ in range(20):
            theta = minimize(objective, theta, jac=True, method="BFGS", options={"gtol": 1e-12}).x
        coef = theta[1:-1] / spread
        print(f"HuberRegressor is above the minimum by {before / objective(theta)[0] - 1:.1e}")
        rows.append([0, epsilon, penalty, np.exp(theta[-1]), theta[0] - coef @ center, *coef])
    x = sm.add_constant(a)
    rlm = sm.RLM(y, x, M=sm.robust.norms.HuberT(1.345)).fit(scale_est="mad", maxiter=10000, tol=1e-13, conv="coefs")
    rows.append([1, 1.345, 0.0, rlm.scale, *rlm.params])
    nu = 4.0

    def loss(theta):
        r, s = y - z @ theta[:-1], np.exp(theta[-1])
        w = (nu + 1) / (nu + (r / s) ** 2)
        value = len(y) * theta[-1] + 0.5 * (nu + 1) * np.log1p((r / s) ** 2 / nu).sum()
        gradient = np.append(-z.T @ (w * r) / s**2, len(y) - (w * r * r).sum() / s**2)
        return value, gradient

    theta = np.append(np.linalg.lstsq(z, y, rcond=None)[0], 0.5)
    for _ in range(20):
        theta = minimize(loss, theta, jac=True, method="BFGS", options={"gtol": 1e-12}).x
    coef = theta[1:-1] / spread
    rows.append([2, nu, 0.0, np.exp(theta[-1]), theta[0] - coef @ center, *coef])
    names = ["kind", "tuning", "penalty", "scale", "intercept", *NAMES]
    source = (f"{SKLEARN}, statsmodels {statsmodels.__version__}, scipy {scipy.__version__}; "
              "kind 0 the minimum of HuberRegressor's objective, from its solution by BFGS, 1 RLM HuberT with MAD, 2 "
              "Student-t likelihood by BFGS")
    write("robust.csv", source, **dict(zip(names, np.transpose(rows))))


def choice(a, y0, y, groups):
    """What is chosen among lambdas, by explicit formulas: each line left out whole, and generalised
    cross-validation."""
    alphas = np.geomspace(50.0, 0.005, 9)
    lambdas = np.geomspace(1e4, 1e-4, 9)
    folds = list(LeaveOneGroupOut().split(a, y, groups))
    error, cv = [], []
    for alpha in alphas:
        net = ElasticNet(alpha=alpha, l1_ratio=0.7, tol=1e-14, max_iter=1000000)
        error.append([np.var(y[test] - net.fit(a[train], y[train]).predict(a[test])) for train, test in folds])
    net = ElasticNetCV(l1_ratio=0.7, alphas=alphas, cv=folds, tol=1e-14, max_iter=1000000).fit(a, y)
    print(f"ElasticNetCV, by squares: {net.alpha_}, by variances: {alphas[np.mean(error, 1).argmin()]}")
    z = (a - a.mean(0)) / a.std(0, ddof=1)
    for lam in lambdas:
        hat = z @ np.linalg.solve(z.T @ z + lam * np.eye(P), z.T) + 1 / len(y)
        left = y0 - hat @ y0
        cv.append(len(y0) * left @ left / np.trace(np.eye(len(y0)) - hat) ** 2)
    write("choice.csv",
          f"{SKLEARN}, ElasticNet (l1_ratio 0.7) of y1 leaving one line out, the variance of its errors and the "
          "mean squares of ElasticNetCV; generalised cross-validation of Ridge of y0 on standardised terms (n - 1) "
          "from the hat matrix",
          alpha=alphas, **{f"line{k}": np.array(error)[:, k] for k in range(4)}, mean_square=net.mse_path_.mean(1),
          **{"lambda": lambdas}, gcv=cv)


def pca(a):
    standard = (a - a.mean(0)) / a.std(0, ddof=1)
    fit = PCA(n_components=3, whiten=True).fit(standard)
    scores = fit.transform(standard)[:20]
    write("pca.csv", f"{SKLEARN}, PCA(3, whiten=True) of standardised terms (n - 1); first 20 rows",
          **{f"c{k}": scores[:, k] for k in range(3)},
          **{f"variance{k}": np.full(20, fit.explained_variance_[k]) for k in range(3)})


def main():
    a, y0, y1, line = samples()
    write("samples.csv", f"numpy {np.__version__}", line=line, **dict(zip(NAMES, a.T)), y0=y0, y1=y1)
    ridge(a, y0)
    elastic_net(a, y0, line)
    pls(a, y0, y1, line)
    robust(a, y1)
    pca(a)
    choice(a, y0, y1, line)


if __name__ == "__main__":
    main()
