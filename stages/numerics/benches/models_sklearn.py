"""The work of `models.rs` in scikit-learn, to be timed beside it.

    python3 stages/numerics/benches/models_sklearn.py            # times, then the Rust bench
    python3 stages/numerics/benches/models_sklearn.py --write    # also writes the reference coefficients

Two ways to make the path: `enet_path` on the rows, as it is usually called, and `enet_path` with a Gram matrix made
once, its fastest. Cross-validation by line is `ElasticNetCV` with one fold a line; `--folds` times it (minutes).
"""
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import sklearn
from sklearn.cross_decomposition import PLSRegression
from sklearn.linear_model import ElasticNetCV, Ridge, enet_path
from sklearn.model_selection import LeaveOneGroupOut

HERE = Path(__file__).resolve().parent
REFERENCE = HERE.parent / "reference" / "models" / "bench.csv"
LINES, ROWS, TERMS, REPEATS = 24, 18_000, 60, 3


def flight():
    k = np.arange(LINES * ROWS, dtype=float)
    a = np.empty((k.size, TERMS))
    for j in range(TERMS):
        slow = np.sin(k * (0.013 + 0.0171 * (j % 6)) + 0.37 * (j % 6))
        a[:, j] = slow + 0.2 * np.sin(k * (0.05 + 0.0237 * j) + 1.3 * j)
    y = a[:, ::7] @ (np.arange(a[:, ::7].shape[1]) - 3.0)
    return a, y + 0.5 * np.sin(2.1 * k) + 0.1 * np.sin(k * k * 1e-4)


def timed(name, function, repeats=REPEATS):
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        answer = function()
        best = min(best, time.perf_counter() - start)
    print(f"{name}: {best * 1e3:.0f} ms", flush=True)
    return answer


def main():
    a, y = flight()
    deviation = a.std(0, ddof=1)
    print(f"scikit-learn {sklearn.__version__}, numpy {np.__version__}")
    options = dict(l1_ratio=0.9, alphas=100, eps=1e-3)

    def scaled():
        return np.asfortranarray((a - a.mean(0)) / deviation), y - y.mean()

    def with_gram(**more):
        x, z = scaled()
        return enet_path(x, z, precompute=x.T @ x, Xy=x.T @ z, **options, **more)

    if "--write" in sys.argv:
        alphas, coefs, _ = with_gram(tol=1e-12, max_iter=1_000_000)
        with open(REFERENCE, "w") as file:
            file.write(f"# place on the path, alpha, 60 coefficients; scikit-learn {sklearn.__version__}: ")
            file.write("python3 stages/numerics/benches/models_sklearn.py --write\n")
            for k in (5, 50, 99):
                file.write(",".join(repr(float(v)) for v in (k, alphas[k], *(coefs[:, k] / deviation))) + "\n")
        return
    timed("enet_path on the rows, 100 alphas", lambda: enet_path(*scaled(), precompute=False, **options), 1)
    timed("enet_path with a Gram matrix, 100 alphas", with_gram)
    timed("Ridge, 1 lambda", lambda: Ridge(alpha=1.0).fit(a, y))
    timed("PLSRegression, 20 components", lambda: PLSRegression(20).fit(a, y), 1)
    if "--folds" in sys.argv:
        folds = list(LeaveOneGroupOut().split(a, y, np.repeat(np.arange(LINES), ROWS)))
        timed("ElasticNetCV, every line left out",
              lambda: ElasticNetCV(cv=folds, **options).fit((a - a.mean(0)) / deviation, y), 1)
    command = ["cargo", "bench", "-q", "-p", "stages", "--bench", "models", "--profile", "dev"]
    print(subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=True).stdout, end="")


if __name__ == "__main__":
    main()
