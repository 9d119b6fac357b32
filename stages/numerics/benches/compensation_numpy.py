"""The work of `compensation.rs` in numpy and scipy, to be timed beside it.

    python3 stages/numerics/benches/compensation_numpy.py            # times, and the ratio to the Rust bench
    python3 stages/numerics/benches/compensation_numpy.py --write    # also writes the reference coefficients

Three ways to write the fit, all on the same band-passed columns:
  loop    normal equations solved for each magnetometer and lambda, as MagNav.jl's `linreg` does
  gram    the Gram matrix formed once, then one solve for each magnetometer and lambda
  svd     one singular value decomposition for all of them
The filter is timed column by column and as one call on the whole matrix (whichever is faster counts).
The fastest of nine runs counts, there as here; `--threads 1` keeps OpenBLAS to one thread.
"""
import os
import re
import subprocess
import sys
import time
from pathlib import Path

if "--threads" in sys.argv:
    os.environ["OPENBLAS_NUM_THREADS"] = sys.argv[sys.argv.index("--threads") + 1]

import numpy as np
import scipy
from scipy.signal import butter, sosfiltfilt

HERE = Path(__file__).resolve().parent
REFERENCE = HERE.parent / "reference" / "signal" / "compensation_numpy.csv"
SAMPLES, TRIM, SCALE, PADDING, REPEATS = 144_668, 20, 50_000.0, 24, 9
LAMBDAS = 10.0 ** (-3.0 + 0.25 * np.arange(20))


def flight():
    k = np.arange(SAMPLES)
    x = 20_000.0 + 9000.0 * np.sin(0.0021 * k) + 1500.0 * np.sin(0.17 * k)
    y = 5000.0 + 7000.0 * np.sin(0.0013 * k + 1.5) + 2500.0 * np.sin(0.23 * k + 0.7)
    z = 45_000.0 + 3000.0 * np.sin(0.0017 * k + 0.4) + 1200.0 * np.sin(0.29 * k + 2.1)
    total = np.sqrt(x * x + y * y + z * z)
    aircraft = 120.0 * x / total - 60.0 * y / total + 35.0 * z / total + 80.0 * x / total * y / SCALE
    anomaly = 150.0 * np.sin(0.0007 * k + 0.2)
    scalars = [total + mag * aircraft + anomaly + 0.3 * np.sin(1.9 * k + mag) for mag in range(1, 6)]
    return np.column_stack([x, y, z]), np.column_stack(scalars)


def matrix(b):
    """Permanent, induced and eddy terms, one vectorised column each."""
    bt = np.linalg.norm(b, axis=1)
    cosine = b / bt[:, None]
    change = np.gradient(b, axis=0)
    columns = [cosine[:, i] for i in range(3)]
    columns += [cosine[:, i] * b[:, j] / SCALE for i in range(3) for j in range(i, 3)]
    columns += [cosine[:, i] * change[:, j] / SCALE for i in range(3) for j in range(3)]
    return np.column_stack(columns)


def filter_columns(sos, values):
    return np.column_stack([sosfiltfilt(sos, column, padlen=PADDING) for column in values.T])


def filter_whole(sos, values):
    return sosfiltfilt(sos, values, axis=0, padlen=PADDING)


def fit_loop(a, y):
    eye = np.eye(a.shape[1])
    solve = lambda target, lam: np.linalg.solve(a.T @ a + lam * eye, a.T @ target)
    return np.array([[solve(target, lam) for target in y.T] for lam in LAMBDAS])


def fit_gram(a, y):
    eye, gram, right = np.eye(a.shape[1]), a.T @ a, a.T @ y
    solve = lambda j, lam: np.linalg.solve(gram + lam * eye, right[:, j])
    return np.array([[solve(j, lam) for j in range(y.shape[1])] for lam in LAMBDAS])


def fit_svd(a, y):
    u, s, vt = np.linalg.svd(a, full_matrices=False)
    right = u.T @ y
    return np.array([(vt.T @ ((s / (s * s + lam))[:, None] * right)).T for lam in LAMBDAS])


def timed(function, *arguments):
    best, answer = np.inf, None
    for _ in range(REPEATS):
        start = time.perf_counter()
        answer = function(*arguments)
        best = min(best, time.perf_counter() - start)
    return best, answer


def rust_milliseconds():
    command = ["cargo", "bench", "-q", "-p", "stages", "--bench", "compensation", "--profile", "dev"]
    printed = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=True).stdout
    print(printed, end="")
    return {int(n): float(ms) for n, ms in re.findall(r"threads (\d+): ([\d.]+) ms", printed)}


def main():
    b, y = flight()
    sos = butter(4, [0.1, 0.9], "bandpass", fs=10.0, output="sos")
    print(f"numpy {np.__version__}, scipy {scipy.__version__}")
    build, a = timed(matrix, b)
    columns, filtered = timed(lambda: (filter_columns(sos, a), filter_columns(sos, y)))
    whole, _ = timed(lambda: (filter_whole(sos, a), filter_whole(sos, y)))
    af, yf = (values[TRIM:-TRIM] for values in filtered)
    print(f"matrix {build * 1e3:.0f} ms, band-pass by columns {columns * 1e3:.0f} ms, as a whole {whole * 1e3:.0f} ms")
    totals, answers = {}, {}
    for name, fit in (("loop", fit_loop), ("gram", fit_gram), ("svd", fit_svd)):
        seconds, answers[name] = timed(fit, af, yf)
        totals[name] = 1e3 * (build + min(columns, whole) + seconds)
        print(f"fit {name} {seconds * 1e3:.0f} ms, all {totals[name]:.0f} ms")
    if "--write" in sys.argv:
        with open(REFERENCE, "w") as file:
            file.write(f"# lambda, magnetometer, 18 coefficients; numpy {np.__version__}, scipy {scipy.__version__}: ")
            file.write("python3 stages/numerics/benches/compensation_numpy.py --write\n")
            for row in (0, len(LAMBDAS) - 1):
                for mag, coefficients in enumerate(answers["svd"][row], start=1):
                    file.write(",".join(repr(float(v)) for v in (LAMBDAS[row], mag, *coefficients)) + "\n")
        return
    for threads, milliseconds in rust_milliseconds().items():
        ratios = ", ".join(f"{name} {total / milliseconds:.1f}" for name, total in totals.items())
        print(f"numpy over Rust on {threads} threads: {ratios}")


if __name__ == "__main__":
    main()
