"""Predictions of a network of `fit`, computed from its published table only. Requires numpy and pyarrow.

    python predict_network.py MODEL.parquet ROWS.parquet model=m2c mag=mag_4_uc

MODEL is a file of the published table of the fit. The arguments after the files are the values of its axes. ROWS has
one column per input. The predicted field is printed in nT, one number per row. The layout of the terms is in
stages/REFERENCE.md, under `fit`.
"""

import re
import sys

import numpy as np
import pyarrow.parquet as pq

ACTIVATIONS = {
    "swish": lambda s: s / (1 + np.exp(-s)),
    "relu": lambda s: np.maximum(s, 0),
    "tanh": np.tanh,
    "sigmoid": lambda s: 1 / (1 + np.exp(-s)),
}


def aircraft_field(a, coefficients, more, coupling, scale, bt_scale):
    """The scalar field of the aircraft from its vector, in the scale of the target. `more` is added to the vector."""
    cosines, square = a[:, :3], (a[:, :3] ** 2).sum(1, keepdims=True)
    field = cosines * (a[:, [3]] + a[:, [6]] + a[:, [8]]) / square
    xx, xy, xz, yy, yz, zz = coefficients[3:9]
    induced = np.array([[xx, xy / 2, xz / 2], [xy / 2, yy, yz / 2], [xz / 2, yz / 2, zz]])
    v = coefficients[:3] + field @ induced + more
    if len(coefficients) == 18:
        change = np.einsum("ri,rij->rj", cosines, a[:, 9:].reshape(-1, 3, 3)) / square
        v = v + change @ coefficients[9:].reshape(3, 3).T
    if coupling == "projection":
        return (cosines * v).sum(1)
    # Relative to the scale of the target, |B| - |B - v|.
    b = field * bt_scale / scale
    return np.linalg.norm(b, axis=1) - np.linalg.norm(b - v, axis=1)


def predict(model, row):
    """The field of each sample. `model` holds the terms; `row(name)` returns a column."""
    numbers, words = {}, {}
    for term, value in model.items():
        key, _, word = term.partition(" ")
        numbers[key], words[key] = value, word
    several = lambda key: sum(re.fullmatch(re.escape(key) + r"\[\d+\]", k) is not None for k in numbers)
    listed = lambda key: np.array([numbers[f"{key}[{i + 1}]"] for i in range(several(key))])
    z = np.array([row(words[f"input_mean[{i + 1}]"]) for i in range(several("input_mean"))]).T
    z = (z - listed("input_mean")) / listed("input_scale")
    if "components" in numbers:
        count = int(numbers["components"])
        z = z @ np.array([[numbers[f"component[{k + 1},{i + 1}]"] for k in range(count)] for i in range(z.shape[1])])
    a = np.array([row(words[f"linear_term[{i + 1}]"]) for i in range(several("linear_term"))]).T
    form, activation = words["form"], ACTIVATIONS[words["activation"]]
    fields = []
    for member in range(int(numbers["members"])):
        own = "" if member == 0 else f"member{member + 1}."
        x, layers = z.reshape(len(a) or len(z), -1), several("hidden") + 1
        for layer in range(1, layers + 1):
            units = several(f"{own}b{layer}")
            w = [[numbers[f"{own}w{layer}[{u + 1},{i + 1}]"] for u in range(units)] for i in range(x.shape[1])]
            x = x @ np.array(w).reshape(-1, units) + listed(f"{own}b{layer}")
            x = activation(x) if layer < layers else x
        linear = listed(f"{own}linear")
        match form:
            case "m1":
                y = x[:, 0]
            case "m2a":
                y = (a * x).sum(1)
            case "m2b" | "m2c":
                y = x[:, 0] + a @ linear
            case "m2d":
                y = (a * (x + linear)).sum(1)
            case "m3tl" | "m3s" | "m3v":
                vector, constant = (x, numbers[f"{own}constant"]) if form == "m3v" else (0, x[:, 0])
                scales = numbers["target_scale"], numbers["bt_scale_nt"]
                y = aircraft_field(a, linear, vector, words["coupling"], *scales) + constant
        fields.append(numbers["target_mean"] + numbers["target_scale"] * y)
    return np.mean(fields, axis=0)


def columns_of(table):
    """The columns of numbers, and the entries of list columns under separate names."""
    found = {}
    for field in table.schema:
        column = table.column(field.name).combine_chunks()
        terms = (field.metadata or {}).get(b"terms")
        if terms:
            values = np.array(column.flatten()).reshape(len(column), -1)
            found.update(zip(terms.decode().split(","), values.T))
        else:
            found[field.name] = column
    return lambda name: np.array(found[name], dtype=float)


if __name__ == "__main__":
    model = pq.read_table(sys.argv[1]).to_pylist()
    axes = dict(pair.split("=", 1) for pair in sys.argv[3:])
    model = {r["term"]: r["value"] for r in model if all(str(r[axis]) == value for axis, value in axes.items())}
    print(*predict(model, columns_of(pq.read_table(sys.argv[2]))), sep="\n")
