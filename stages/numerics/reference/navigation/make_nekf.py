"""Writes `nekf.csv`: log scales of R and Q by a long short-term memory layer, computed with NumPy 2.4.6.

The network has nine inputs, three units and two outputs. Weights and inputs are sines of their index, so that the test
of `navigation::nekf` makes the same network without a file.
"""

import numpy as np

INPUTS, UNITS, OUTPUTS, STEPS, LIMIT = 9, 3, 2, 12, 6.0


def logistic(x):
    return 1.0 / (1.0 + np.exp(-x))


def main():
    row = INPUTS + UNITS + 1
    weights = 0.7 * np.sin(1.3 * np.arange(4 * UNITS * row + OUTPUTS * (UNITS + 1)) + 0.2)
    gates = weights[: 4 * UNITS * row].reshape(4, UNITS, row)
    w, u, b = gates[:, :, :INPUTS], gates[:, :, INPUTS:-1], gates[:, :, -1]
    outputs = weights[4 * UNITS * row :].reshape(OUTPUTS, UNITS + 1)
    mean, inverse = 0.1 * np.arange(INPUTS), 1.0 + 0.1 * np.arange(INPUTS)
    h, c = np.zeros(UNITS), np.zeros(UNITS)
    with open("nekf.csv", "w") as file:
        file.write("log_r,log_q\n")
        for step in range(STEPS):
            x = 3.0 * np.sin(0.7 * step + 1.9 * np.arange(INPUTS))
            x = np.clip((x - mean) * inverse, -5.0, 5.0)
            i, j, g, o = w @ x + u @ h + b
            c = logistic(j) * c + logistic(i) * np.tanh(g)
            h = logistic(o) * np.tanh(c)
            y = 2.0 * np.log(LIMIT) * np.tanh(outputs[:, :-1] @ h + outputs[:, -1])
            file.write(f"{y[0]:.17g},{y[1]:.17g}\n")


if __name__ == "__main__":
    main()
