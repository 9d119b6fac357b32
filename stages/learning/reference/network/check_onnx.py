"""Runs the files of `onnx/` in onnxruntime on the samples, and writes their predictions.

    cargo test -p magline-learning --lib -- --ignored user_write_the_onnx_files    # also those of vector forms
    pip install onnxruntime numpy && python3 stages/learning/reference/network/check_onnx.py
"""
from pathlib import Path

import numpy as np
import onnxruntime

HERE = Path(__file__).resolve().parent
table = np.genfromtxt(HERE / "samples.csv", delimiter=",", names=True, comments="#", skip_header=1)
x = np.column_stack([table[f"x{j}"] for j in range(5)])
a = np.column_stack([table[f"a{j}"] for j in range(3)])
# Tolles-Lawson terms of the fields in vector.csv, with a scale of 50,000 nT.
fields = np.genfromtxt(HERE / "vector.csv", delimiter=",", names=True, comments="#", skip_header=1)
b, d = (np.column_stack([fields[f"{kind}{axis}"] for axis in "xyz"]) for kind in "bd")
size = np.linalg.norm(b, axis=1)[:, None]
pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
terms = [b / size] + [b[:, [i]] * b[:, [j]] / (size * 50_000) for i, j in pairs]
terms = np.hstack(terms + [b[:, [i]] * d / (size * 50_000) for i in range(3)])


def predictions(name, a):
    session = onnxruntime.InferenceSession(HERE / "onnx" / f"{name}.onnx", providers=["CPUExecutionProvider"])
    given = {"x": x, "a": a}
    predicted = session.run(["y"], {each.name: given[each.name] for each in session.get_inputs()})[0]
    assert predicted.shape == (len(x), 1), predicted.shape
    # The number of rows is not fixed.
    one = session.run(["y"], {each.name: given[each.name][:1] for each in session.get_inputs()})[0]
    np.testing.assert_allclose(one, predicted[:1], rtol=1e-12)
    return predicted[:, 0]


def write(name, columns):
    with open(HERE / name, "w") as file:
        file.write(f"# onnxruntime {onnxruntime.__version__}; python3 "
                   "stages/learning/reference/network/check_onnx.py\n")
        file.write(",".join(columns) + "\n")
        for row in zip(*columns.values(), strict=True):
            file.write(",".join(repr(float(value)) for value in row) + "\n")


write("onnx.csv", {name: predictions(name, a) for name in ("m1", "m2a", "m2b", "m2c", "m2d")})
widths = {"m3tl": 18, "m3s": 9, "m3v": 18}
write("onnx_vector.csv", {name: predictions(name, terms[:, :width]) for name, width in widths.items()})
