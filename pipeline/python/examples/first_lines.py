"""Runs the Tolles-Lawson example, reads its tables and repeats the fit on arrays.

Run in the folder of the repository: python pipeline/python/examples/first_lines.py STORE
"""

import sys

import magline
from magline import tolles_lawson

run = magline.run("datasets/examples/tolles_lawson.toml", store=sys.argv[1])
print(run.scores["scores"])
clean = run.table("clean").polars()

line = run.sql("select tt, flux_a_x, flux_a_y, flux_a_z, mag_1_uc from tolles_lawson.clean "
               "where lambda = 0.025 order by tt")
frame = line.polars()
flux = frame.select("flux_a_x", "flux_a_y", "flux_a_z").to_numpy()
a = tolles_lawson.a_matrix(flux, 10.0, tt=frame["tt"])
fit = tolles_lawson.fit(a, frame["mag_1_uc"], 10.0, lambda_=0.025)
print(f"residual {fit.residual_std:.2f} nT, condition number {fit.condition:.0f}")
