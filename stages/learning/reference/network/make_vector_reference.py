"""Makes the reference tables of the models 3 (Tolles-Lawson in vector form) with NumPy, in double precision.

    pip install numpy && python3 stages/learning/reference/network/make_vector_reference.py

The tests do not run this script; they read the tables in this folder. The field is computed from vectors, not from
Tolles-Lawson terms, and gradients are complex-step derivatives, not derived formulas. The initial value of parameter i
(from 0) of case k is 0.5 sin(0.9 i + k). The inputs and the target are those of samples.csv. The order of the samples
in an epoch is drawn by SplitMix64, as in Rust.
"""
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
COMMAND = "python3 stages/learning/reference/network/make_vector_reference.py"
ROWS, INPUTS, WINDOW, MASK = 45, 5, 3, 2**64 - 1
BT_SCALE_NT, TARGET_SCALE_NT = 50_000.0, 3_000.0
RUNS = [20, 3, 22]
# Hidden layers of each model. m3tl has no network.
HIDDEN = {"m3tl": [], "m3s": [6], "m3v": [7, 4], "m3w": [4], "m3tf": []}
# The transformer of m3tf: units of a sample, and heads.
UNITS, HEADS = 6, 2
ENCODER = [(UNITS, INPUTS), (UNITS,), (WINDOW, UNITS), *4 * [(UNITS, UNITS)], (UNITS,), (UNITS,), (UNITS, UNITS),
           *3 * [(UNITS,)]]


def write(name, columns):
    longest = max(len(column) for column in columns.values())
    with open(HERE / name, "w") as file:
        file.write(f"# NumPy {np.__version__}, float64; {COMMAND}\n")
        file.write(",".join(columns) + "\n")
        for row in range(longest):
            file.write(",".join(repr(float(c[row])) if row < len(c) else "nan" for c in columns.values()) + "\n")


def swish(s):
    return s / (1 + np.exp(-s))


def normalised(x, factors, offsets):
    x = x - x.mean(-1, keepdims=True)
    return factors * x / np.sqrt((x * x).mean(-1, keepdims=True) + 1e-5) + offsets


def encode(x, parameters):
    """The features of windows (row, sample, input), by a transformer encoder; also the number of its parameters."""
    matrices, start = [], 0
    for size in ENCODER:
        matrices.append(parameters[start : start + np.prod(size)].reshape(size))
        start += np.prod(size)
    we, be, p, wq, wk, wv, wo, g1, o1, wf, bf, g2, o2 = matrices
    e = np.sqrt(UNITS) * (x @ we.T + be) + p
    results, width = [], UNITS // HEADS
    for head in range(HEADS):
        own = slice(head * width, (head + 1) * width)
        q, k, v = (e @ w[own].T for w in (wq, wk, wv))
        scores = np.exp(np.einsum("rik,rjk->rij", q, k) / np.sqrt(width))
        results.append(np.einsum("rij,rjk->rik", scores / scores.sum(-1, keepdims=True), v))
    n = normalised(e + np.concatenate(results, -1) @ wo.T, g1, o1)
    z = normalised(n + swish(n @ wf.T + bf), g2, o2)
    return z.reshape(len(z), -1), start


def parts(model, w, terms, inputs):
    """The layers, the coefficients and the constant in a vector of parameters."""
    layers, start = [], 0
    outputs = 3 if model == "m3v" else 1
    for units in [*HIDDEN[model], outputs]:
        weights = w[start : start + units * inputs].reshape(units, inputs)
        start += units * inputs
        layers.append((weights, w[start : start + units]))
        start, inputs = start + units, units
    linear = w[start : start + terms]
    rest = w[start + terms :]
    assert len(rest) == (1 if model == "m3v" else 0), (model, len(rest))
    return layers, linear, rest[0] if len(rest) else 0.0


def count(model, terms, inputs):
    before = sum(np.prod(size) for size in ENCODER) if model == "m3tf" else 0
    inputs = WINDOW * UNITS if model == "m3tf" else inputs
    widths = [inputs, *HIDDEN[model], 3 if model == "m3v" else 1]
    dense = sum((before + 1) * after for before, after in zip(widths[:-1], widths[1:]))
    return before + dense + terms + (1 if model == "m3v" else 0)


def predict(model, coupling, w, x, field_nt, change_nt, terms, network=True):
    """The prediction of each row, in the scale of the target."""
    if model == "m3tf":
        x, start = encode(x.reshape(len(x), WINDOW, INPUTS), w)
        w = w[start:]
    layers, b, constant = parts(model, w, terms, x.shape[1])
    out = x
    for number, (weights, biases) in enumerate(layers):
        out = out @ weights.T + biases
        if number + 1 < len(layers):
            out = swish(out)
    if not network:
        # A network that is off has only the bias of its scalar output, which is the constant.
        out = 0 * out + (layers[-1][1] if model != "m3v" else 0)
    b = b * TARGET_SCALE_NT
    induced = np.array([[b[3], b[4] / 2, b[5] / 2], [b[4] / 2, b[6], b[7] / 2],
                        [b[5] / 2, b[7] / 2, b[8]]]) / BT_SCALE_NT
    v = b[:3] + field_nt @ induced
    if terms == 18:
        v = v + change_nt @ (b[9:].reshape(3, 3) / BT_SCALE_NT).T
    if model == "m3v":
        v = v + out * TARGET_SCALE_NT
    size = np.sqrt((field_nt * field_nt).sum(1))
    if coupling == "projection":
        f = (v * field_nt).sum(1) / size
    else:
        left = field_nt - v
        f = size - np.sqrt((left * left).sum(1))
    return f / TARGET_SCALE_NT + (constant if model == "m3v" else out[:, 0])


def gradient(function, w):
    """The derivatives of a real function, by complex steps."""
    out = np.empty(len(w))
    for i in range(len(w)):
        moved = w.astype(complex)
        moved[i] += 1e-30j
        out[i] = function(moved).imag / 1e-30
    return out


class SplitMix64:
    def __init__(self, seed):
        self.state = seed & MASK

    def draw(self):
        self.state = (self.state + 0x9E3779B97F4A7C15) & MASK
        z = self.state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
        return z ^ (z >> 31)


def order(samples, seed, epoch):
    state = SplitMix64(seed ^ 0x6A09E667F3BCC909).draw()
    for number in (2, epoch):
        state = SplitMix64(state ^ ((number * 0x9E3779B97F4A7C15) & MASK)).draw()
    bits = SplitMix64(state)
    numbers = list(range(samples))
    for last in range(samples - 1, 0, -1):
        other = (bits.draw() * (last + 1)) >> 64
        numbers[last], numbers[other] = numbers[other], numbers[last]
    return numbers


def train(model, w, x, field_nt, change_nt, y, curriculum=False, epochs=10, most=14, rate=0.02, seed=3):
    """Adam in batches, with or without a curriculum."""
    layers_end = len(w) - 18 - (1 if model == "m3v" else 0)
    constant = len(w) - 1 if model == "m3v" else layers_end - 1
    at = {name: np.arange(layers_end, layers_end + n) for name, n in (("p", 3), ("pi", 9), ("pie", 18))}
    everything = np.arange(len(w))
    near = np.ones(len(y), bool)
    if curriculum:
        off = w.copy()
        off[:layers_end], off[constant] = 0, 0
        error = y - predict(model, "magnitude", off, x, field_nt, change_nt, 18)
        near = np.abs(error - error.mean()) <= error.std(ddof=1)
    mean, square, steps, before = np.zeros(len(w)), np.zeros(len(w)), 0, None
    for epoch in range(epochs):
        phase = (["p", "pi", "pie"] + 3 * ["network"] + 4 * ["all"])[10 * epoch // epochs] if curriculum else "all"
        if phase != before:
            mean[:], square[:], steps, before = 0, 0, 0, phase
        trained = {"all": everything, "network": np.union1d(np.arange(layers_end), [constant])}.get(phase)
        trained = np.union1d(at[phase], [constant]) if trained is None else trained
        rows = np.array(order(len(y), seed, epoch))
        if phase in at:
            rows = rows[near[rows]]
        batches = -(-len(rows) // most)
        for k in range(batches):
            batch = rows[k * len(rows) // batches : (k + 1) * len(rows) // batches]

            def loss(w):
                made = predict(model, "magnitude", w, x[batch], field_nt[batch], change_nt[batch], 18, phase not in at)
                return ((made - y[batch]) ** 2).mean()

            g, steps = gradient(loss, w), steps + 1
            mean[trained] = 0.9 * mean[trained] + 0.1 * g[trained]
            square[trained] = 0.999 * square[trained] + 0.001 * g[trained] ** 2
            change = mean / (1 - 0.9**steps) / (np.sqrt(square / (1 - 0.999**steps)) + 1e-8)
            w[trained] -= rate * change[trained]
    return w


def main():
    table = np.genfromtxt(HERE / "samples.csv", delimiter=",", names=True, comments="#", skip_header=1)
    x = np.column_stack([table[f"x{j}"] for j in range(INPUTS)])
    y = table["y"]
    t = np.arange(ROWS)
    field_nt = np.column_stack([30_000 * np.sin(0.31 * t), 21_000 * np.cos(0.53 * t + 1),
                                44_000 + 3_000 * np.sin(0.9 * t)])
    change_nt = np.column_stack([2_000 * np.sin(0.7 * t), -900 * np.cos(0.4 * t), 500 * np.sin(1.1 * t + 2)])
    field_nt, change_nt = np.round(field_nt, 3), np.round(change_nt, 3)
    vectors = [("bx", field_nt[:, 0]), ("by", field_nt[:, 1]), ("bz", field_nt[:, 2])]
    vectors += [("dx", change_nt[:, 0]), ("dy", change_nt[:, 1]), ("dz", change_nt[:, 2])]
    starts = np.concatenate([np.full(run, sum(RUNS[:k])) for k, run in enumerate(RUNS)])
    window = np.column_stack([x[np.maximum(starts, t - back)] for back in reversed(range(WINDOW))])
    inputs = {"m3tl": x[:, :0], "m3s": x, "m3v": x, "m3w": window, "m3tf": window}

    def initial(model, terms, case):
        return 0.5 * np.sin(0.9 * np.arange(count(model, terms, inputs[model].shape[1])) + case)

    columns, gradients, case = dict(vectors), {}, 0
    for model in HIDDEN:
        for coupling in ("magnitude", "projection"):
            for terms in (9, 18):
                w, given = initial(model, terms, case), (inputs[model], field_nt, change_nt, terms)
                columns[f"{model} {coupling} {terms}"] = predict(model, coupling, w, *given)
                loss = lambda w: ((predict(model, coupling, w, *given) - y) ** 2).mean()
                if model != "m3tf":
                    gradients[f"{model} {coupling} {terms}"] = gradient(loss, w)
                case += 1
    write("vector.csv", columns)
    write("vector_gradient.csv", gradients)

    trained = {}
    for model in HIDDEN:
        for curriculum in (False, True) if model in ("m3s", "m3v") else (False,):
            name = f"{model}{'c' if curriculum else ''}"
            trained[name] = train(model, initial(model, 18, 1), inputs[model], field_nt, change_nt, y, curriculum)
    write("vector_training.csv", trained)


main()
