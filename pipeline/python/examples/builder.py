"""Builds a spec in Python, writes it as TOML, and runs it.

Run in the folder of the repository: python pipeline/python/examples/builder.py STORE
"""

import sys

import magline

spec = magline.Spec("builder", store=sys.argv[1])
flights = spec.table(
    "flights",
    "datasets/samples/magnavjl_tl/magnavjl_tl.parquet",
    flight="sample",
    line="1",
    rename={
        "time_s": "tt",
        "mag_1_uc_nt": "mag_1_uc",
        "flux_a_x_nt": "flux_a_x",
        "flux_a_y_nt": "flux_a_y",
        "flux_a_z_nt": "flux_a_z",
    },
)
terms = spec.a_matrix(input=flights, vector="flux_a")
ridge = spec.axis("lambda", [0.0, 0.025])
fit = spec.fit(input=terms, model="tolles_lawson", target="mag_1_uc", lambda_=ridge)
clean = spec.compensate(name="clean", input=terms, model=fit, mag="mag_1_uc")
spec.score(name="scores", input=clean)
print(spec.toml())
run = spec.run()
print(run.scores["scores"])
