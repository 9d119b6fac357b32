"""A stage, a model and a metric written in Python, in a sweep over a parameter of the model.

Run in the folder of the repository: python pipeline/python/examples/own_parts.py STORE
The command loads the same parts: magline --parts pipeline/python/examples/own_parts.py run SPEC
"""

import sys
from typing import Annotated

import magline
import numpy as np
from numpy.typing import NDArray

Column = NDArray[np.float64]


@magline.stage(reads={"tt": "s", "{column}": "nT"}, makes={"{column}_straight": "nT"}, version=1)
def straighten(
    line: magline.Line,
    *,
    column: str = "mag_1_uc",
    degree: Annotated[int, magline.Param(doc="Degree of the polynomial.", least=0, most=9)] = 1,
) -> Column:
    """Subtracts the least-squares polynomial over time from a column.

    Source: ordinary least squares.
    """
    tt, values = line["tt"], line[column]
    known = np.isfinite(values)
    curve = np.polynomial.Polynomial.fit(tt[known], values[known], degree)
    residual: Column = values - curve(tt)
    return residual


@magline.model(name="own_ridge", version=1)
class OwnRidge:
    """Ridge regression without a constant: |y - A b|^2 + `alpha` |b|^2.

    Source: Hoerl & Kennard 1970.
    """

    def __init__(self, alpha: float = 1.0) -> None:
        self.alpha = alpha
        self.coefficients: Column = np.zeros(0)

    def fit(self, x: Column, y: Column) -> None:
        normal = x.T @ x + self.alpha * np.eye(x.shape[1])
        self.coefficients = np.asarray(np.linalg.solve(normal, x.T @ y), dtype=np.float64)

    def predict(self, x: Column) -> Column:
        predicted: Column = x @ self.coefficients
        return predicted

    def get_numbers(self) -> dict[str, Column]:
        return {"coefficients": self.coefficients}

    def set_numbers(self, numbers: dict[str, Column]) -> None:
        self.coefficients = numbers["coefficients"]


@magline.metric(unit="nT", version=1)
def signal_spread(signal: Column) -> float:
    """interquartile range of the compensated signal"""
    low, high = np.percentile(signal, [25.0, 75.0])
    return float(high - low)


FLIGHTS = {
    "path": "datasets/samples/magnavjl_tl/magnavjl_tl.parquet",
    "flight": "sample",
    "line": "1",
    "rename": {
        "time_s": "tt",
        "flux_a_x_nt": "flux_a_x",
        "flux_a_y_nt": "flux_a_y",
        "flux_a_z_nt": "flux_a_z",
        "mag_1_uc_nt": "mag_1_uc",
    },
}
STAGES = [
    {"name": "straight", "stage": "straighten", "input": "flights", "column": "mag_1_uc"},
    {"name": "terms", "stage": "a_matrix", "input": "straight", "vector": "flux_a"},
    {
        "name": "coefficients",
        "stage": "fit",
        "input": "terms",
        "model": "own_ridge",
        "target": "mag_1_uc_straight",
        "alpha": "$alpha",
    },
    {
        "name": "clean",
        "stage": "compensate",
        "input": "terms",
        "model": "coefficients",
        "mag": "mag_1_uc_straight",
    },
    {
        "name": "scores",
        "stage": "score",
        "input": "clean",
        "metrics": ["std_uncompensated", "signal_spread"],
    },
]

if __name__ == "__main__":
    run = magline.run(
        {
            "name": "own_parts",
            "store": sys.argv[1],
            "tables": {"flights": FLIGHTS},
            "axes": {"alpha": [0.001, 1.0, 1000.0]},
            "stages": STAGES,
        }
    )
    print(run.scores["scores"])
