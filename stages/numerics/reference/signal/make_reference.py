"""Makes the reference tables of the signal and regression numerics with scipy and scikit-learn.

    python3 stages/numerics/reference/signal/make_reference.py

Versions are written into each table. The tests never run this; they read the tables beside it.
"""
from pathlib import Path

import numpy as np
import scipy
import sklearn
from scipy.interpolate import Akima1DInterpolator
from scipy.ndimage import generic_filter
from scipy.signal import butter, iirnotch, savgol_filter, sosfiltfilt, tf2sos, welch
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


def notches(rng):
    """Power-line sinusoids and two aliases on a field of 50,000 nT at 160 Hz."""
    k = np.arange(600)
    wave = sum(a * np.sin(2 * np.pi * f * k / 160 + f) for a, f in [(5, 50), (3, 60), (2, 10)])
    x = 50_000 + 40 * np.sin(0.01 * k) + wave + rng.normal(0, 0.5, k.size)
    columns = {"x": x}
    for name, frequencies, width in [("one", [50.0], 2.0), ("three", [50.0, 60.0, 10.0], 1.5)]:
        sos = np.concatenate([tf2sos(*iirnotch(f, f / width, fs=160.0)) for f in frequencies])
        columns[name] = sosfiltfilt(sos, x, padlen=max(int(np.ceil(160 / width)), 6 * len(sos)))
    write("notch.csv", f"{SCIPY}: iirnotch + sosfiltfilt(padlen=the longer of 6 a section and rate/width)", **columns)


def savitzky_golay(rng):
    k = np.arange(80)
    x = 50_000 + 40 * np.sin(0.2 * k) + rng.normal(0, 2, k.size)
    columns = {"x": x}
    for name, window, degree, derivative in [
        ("value_7_2", 7, 2, 0),
        ("first_5_2", 5, 2, 1),
        ("first_11_4", 11, 4, 1),
        ("second_9_3", 9, 3, 2),
    ]:
        columns[name] = savgol_filter(x, window, degree, deriv=derivative, mode="interp")
    write("savitzky_golay.csv", f"{SCIPY}: savgol_filter(mode='interp')", **columns)


def spikes(rng):
    """Flags of the Hampel identifier, its median and deviation over windows that end with the series."""
    k = np.arange(300)
    x = 50_000 + 20 * np.sin(0.03 * k) + rng.normal(0, 0.5, k.size)
    x[[0, 40, 41, 150, 151, 152, 260, 299]] += [30, 12, -9, 40, 40, 40, -6, -15]
    columns = {"x": x}
    for half, threshold in [(5, 3.0), (2, 6.0)]:
        # What lies beyond the ends is NaN and left out.
        around = dict(size=2 * half + 1, mode="constant", cval=np.nan)
        middle = generic_filter(x, np.nanmedian, **around)
        mad = generic_filter(x, lambda w: np.nanmedian(np.abs(w - np.nanmedian(w))), **around)
        steps = np.abs(np.diff(x))
        least = max(1.482602218505602 * np.median(np.abs(x - middle)), steps[steps > 0].min())
        noise = np.maximum(1.482602218505602 * mad, least)
        columns[f"spike_{half}_{threshold:.0f}"] = np.abs(x - middle) > threshold * noise
    write("hampel.csv", f"{SCIPY}: generic_filter with nanmedian", **columns)


def lags(rng):
    """Two noisy views of one signal, 7 samples apart, and Pearson's r of what overlaps at each lag."""
    common = np.convolve(rng.normal(size=240), np.hanning(9), mode="valid")
    reference = 50_000 + common[7:] + rng.normal(0, 0.3, common.size - 7)
    signal = -300 - 2 * common[:-7] + rng.normal(0, 0.3, common.size - 7)
    write("lag_samples.csv", f"{SCIPY}: a signal 7 samples behind, turned over", reference=reference, signal=signal)
    lag = np.arange(-20, 21)
    n = reference.size
    of = lambda k: np.corrcoef(reference[max(0, -k) : n - max(0, k)], signal[max(0, k) : n - max(0, -k)])[0, 1]
    write("lag.csv", f"{SCIPY}: numpy.corrcoef of reference(i) and signal(i + lag)", lag=lag, r=[of(k) for k in lag])


def main():
    filters(np.random.default_rng(1))
    spectra(np.random.default_rng(2))
    resampling(np.random.default_rng(3))
    regression(np.random.default_rng(4))
    notches(np.random.default_rng(5))
    savitzky_golay(np.random.default_rng(6))
    spikes(np.random.default_rng(7))
    lags(np.random.default_rng(8))


if __name__ == "__main__":
    main()
