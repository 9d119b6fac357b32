"""Runs the files of `onnx/` in onnxruntime on the samples, and writes their predictions.

    cargo test -p magline-learning --lib -- --ignored user_write_the_onnx_files
    pip install onnxruntime numpy && python3 stages/learning/reference/network/check_onnx.py
"""
from pathlib import Path

import numpy as np
import onnxruntime

HERE = Path(__file__).resolve().parent
table = np.genfromtxt(HERE / "samples.csv", delimiter=",", names=True, comments="#", skip_header=1)
x = np.column_stack([table[f"x{j}"] for j in range(5)])
a = np.column_stack([table[f"a{j}"] for j in range(3)])
columns = {}
for name in ("m1", "m2a", "m2b", "m2c", "m2d"):
    session = onnxruntime.InferenceSession(HERE / "onnx" / f"{name}.onnx", providers=["CPUExecutionProvider"])
    given = {"x": x, "a": a}
    predicted = session.run(["y"], {each.name: given[each.name] for each in session.get_inputs()})[0]
    assert predicted.shape == (len(x), 1), predicted.shape
    # The number of rows is free.
    one = session.run(["y"], {each.name: given[each.name][:1] for each in session.get_inputs()})[0]
    np.testing.assert_allclose(one, predicted[:1], rtol=1e-12)
    columns[name] = predicted[:, 0]
with open(HERE / "onnx.csv", "w") as file:
    file.write(f"# onnxruntime {onnxruntime.__version__}; python3 stages/learning/reference/network/check_onnx.py\n")
    file.write(",".join(columns) + "\n")
    for row in zip(*columns.values(), strict=True):
        file.write(",".join(repr(float(value)) for value in row) + "\n")
