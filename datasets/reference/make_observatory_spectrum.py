"""Spectrum of the temporal variation at the Boulder observatory, with which the report compares simulated records.

    python3 make_observatory_spectrum.py BOU20200101vsec.sec bou20141103vmin.min bou20141104vmin.min \
        bou20141105vmin.min > ../../pipeline/report/src/html/observatory_spectrum.csv

The change of the total field is H dH + Z dZ over F, from the vector instrument (0.01 nT). Welch's method of scipy
(Hann window, half overlap), averaged in 6 bins per decade. Made with scipy 1.17.1.
"""
import sys

import numpy as np
from scipy.signal import welch


def total(path):
    rows = []
    for line in open(path):
        if line.endswith("|\n") or not line[:1].isdigit():
            continue
        rows.append([float(x) for x in line.split()[3:7]])
    h, _, z, f = np.array(rows).T
    return (h.mean() * (h - h.mean()) + z.mean() * (z - z.mean())) / f.mean()


def binned(x, rate_hz, segment):
    frequency, density = welch(x, rate_hz, "hann", segment)
    keep = slice(2, int(0.8 * len(frequency)))
    place = np.floor(6 * np.log10(frequency[keep])).astype(int)
    for k in np.unique(place):
        here = place == k
        yield np.exp(np.log(frequency[keep][here]).mean()), density[keep][here].mean()


seconds, *days = sys.argv[1:]
minutes = np.concatenate([total(d) for d in days])
rows = list(binned(minutes, 1 / 60, 1440)) + list(binned(total(seconds), 1.0, 256))
print("record,frequency_hz,density_nt2_per_hz")
split = len(list(binned(minutes, 1 / 60, 1440)))
for i, (f, d) in enumerate(rows):
    print(f"{'minutes' if i < split else 'seconds'},{f:.6e},{d:.6e}")
