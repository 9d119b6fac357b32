"""Makes the reference tables of the signal and regression numerics with scipy and scikit-learn.

    python3 stages/numerics/reference/signal/make_reference.py

Versions are written into each table. The tests never run this; they read the tables beside it.
"""
from pathlib import Path

import numpy as np
import scipy
import sklearn
from scipy.interpolate import Akima1DInterpolator
from scipy.signal import butter, sosfiltfilt, welch
from sklearn.linear_model import Ridge

HERE = Path(__file__).resolve().parent
SCIPY = f"scipy {scipy.__version__}, numpy {np.__version__}"
COMMAND = "python3 stages/numerics/reference/signal/make_reference.py"


def write(name, source, **columns):
    with open(HERE / name, "w") as file:
        file.write(f"# {source}; {COMMAND}\n")
        file.write(",".join(columns) + "\n")
        for row in zip(*columns.values(), strict=True):
            file.write(",".join(repr(float(value)) for value in row) + "\n")


def filters(rng):
    """Zero-phase filters of a field of 50,000 nT with a jump, noise and a slow wave at 10 Hz."""
    k = np.arange(160)
    x = 50_000 + 40 * np.sin(0.05 * k) + 5 * np.sin(0.31 * k + 1) + rng.normal(0, 2, k.size) + 20 * (k > 90)
    designs = {
        "band_4": (4, [0.1, 0.9], "bandpass"),
        "band_1": (1, [0.5, 2.0], "bandpass"),
        "band_3": (3, [0.4, 4.5], "bandpass"),
        "band_6": (6, [0.8, 3.0], "bandpass"),
        "low_4": (4, 0.2, "lowpass"),
        "low_5": (5, 1.5, "lowpass"),
        "high_4": (4, 0.5, "highpass"),
        "high_7": (7, 2.5, "highpass"),
    }
    columns = {"x": x}
    for name, (order, corners, kind) in designs.items():
        sos = butter(order, corners, kind, fs=10.0, output="sos")
        columns[name] = sosfiltfilt(sos, x, padlen=6 * len(sos))
    write("filters.csv", f"{SCIPY}: butter + sosfiltfilt(padlen=6 a section), 10 Hz", **columns)


def spectra(rng):
    k = np.arange(300)
    x = 3 + np.sin(0.9 * k) + rng.normal(0, 0.3, k.size)
    frequency, hann = welch(x, fs=20.0, window="hann", nperseg=64)
    _, hamming = welch(x, fs=20.0, window="hamming", nperseg=64)
    odd_frequency, odd = welch(x, fs=20.0, window="hann", nperseg=65)
    write("spectrum_samples.csv", f"{SCIPY}: input of welch at 20 Hz", x=x)
    write("spectrum_64.csv", f"{SCIPY}: welch(nperseg=64)", frequency=frequency, hann=hann, hamming=hamming)
    write("spectrum_65.csv", f"{SCIPY}: welch(nperseg=65)", frequency=odd_frequency, hann=odd)


def resampling(rng):
    tt = np.cumsum(rng.uniform(0.02, 0.35, 60)) + 12.03
    x = 10 * np.sin(tt) + rng.normal(0, 3, tt.size)
    grid = np.arange(np.ceil(tt[0] * 10), np.floor(tt[-1] * 10) + 1) / 10
    write("resample_samples.csv", f"{SCIPY}: unevenly spaced samples", tt=tt, x=x)
    write(
        "resample_grid.csv",
        f"{SCIPY}: numpy.interp and Akima1DInterpolator on a grid of 10 Hz",
        tt=grid,
        linear=np.interp(grid, tt, x),
        akima=Akima1DInterpolator(tt, x)(grid),
    )


def regression(rng):
    """Two targets on five badly scaled, correlated terms."""
    a = rng.normal(size=(120, 5)) @ rng.normal(size=(5, 5)) * [1.0, 10.0, 1e-3, 0.1, 1.0]
    beta = np.array([[3.0, -0.2, 400.0, 7.0, 0.5], [-1.0, 0.1, -90.0, 2.0, 6.0]])
    y = a @ beta.T + rng.normal(0, 0.3, (120, 2)) + [5.0, -2.0]
    source = f"scikit-learn {sklearn.__version__}, {SCIPY}"
    columns = {f"a{j}": a[:, j] for j in range(5)} | {f"y{j}": y[:, j] for j in range(2)}
    write("ridge_samples.csv", f"{source}: input of Ridge", **columns)
    rows = []
    for intercept in (False, True):
        for alpha in (0.0, 0.025, 2.5, 100.0):
            fit = Ridge(alpha=alpha, fit_intercept=intercept, solver="svd").fit(a, y)
            constants = np.broadcast_to(fit.intercept_, 2)
            for target in range(2):
                residual = y[:, target] - a @ fit.coef_[target] - constants[target]
                squares = residual @ residual
                rows.append([intercept, alpha, target, *fit.coef_[target], constants[target], squares])
    names = ["centred", "lambda", "target", *(f"b{j}" for j in range(5)), "intercept", "squares"]
    write("ridge.csv", f"{source}: Ridge(solver='svd')", **dict(zip(names, np.array(rows, float).T)))


def main():
    filters(np.random.default_rng(1))
    spectra(np.random.default_rng(2))
    resampling(np.random.default_rng(3))
    regression(np.random.default_rng(4))


if __name__ == "__main__":
    main()
