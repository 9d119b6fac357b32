"""Time of training networks in magline and in PyTorch, by turns.

    python3 stages/learning/benches/training.py [--repeats 8] [--threads 1,2] [--models m1,m3s] [--program PROGRAM]

Both train the same architecture from the same parameters on the same rows, in the same order of the same batches, with
Adam. The times are those of all epochs; PyTorch runs a few steps before. In double precision, both must reach the same
loss in each epoch. `torch.compile`, which requires a C++ compiler, is not used. PyTorch indexes its batches from
tensors in memory, which is faster than a `DataLoader`, and uses its fused Adam, if the version has one.

The ratio is the wall-clock time of magline divided by that of PyTorch: the geometric mean over the repeats and its 95 %
interval of Student's distribution. The times in seconds are medians of the processor time of all threads.
"""
import argparse
import json
import math
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from torch import nn

ROWS, INPUTS, TERMS, UNITS, WINDOW, BATCH, EPOCHS = 50_000, 77, 18, 8, 5, 2048, 10
BT_SCALE_NT, TARGET_SCALE_NT = 50_000.0, 100.0
MASK = 2**64 - 1
# Model and units of its hidden layers.
CASES = [("m1", [8]), ("m1", [16, 8]), ("m1", [64, 32]), ("m2a", [8]), ("m2c", [8]), ("m3tl", []), ("m3s", [8])]
CASES += [("m3v", [8]), ("m3sc", [8]), ("m3vc", [8]), ("m3w", [8]), ("m3tf", [])]
# Quantiles of Student's distribution at 0.975 for 1, 2, ... degrees of freedom.
STUDENT = [12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23, 2.20, 2.18, 2.16, 2.14, 2.13]


def order(samples, seed, epoch):
    """The order of the rows in an epoch, drawn by SplitMix64 as in magline."""

    def draw(state):
        z = (state + 0x9E3779B97F4A7C15) & MASK
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
        return z ^ (z >> 31)

    state = draw(seed ^ 0x6A09E667F3BCC909)
    for number in (2, epoch):
        state = draw(state ^ ((number * 0x9E3779B97F4A7C15) & MASK))
    numbers = list(range(samples))
    for last in range(samples - 1, 0, -1):
        other = (draw(state) * (last + 1)) >> 64
        state = (state + 0x9E3779B97F4A7C15) & MASK
        numbers[last], numbers[other] = numbers[other], numbers[last]
    return np.array(numbers)


def samples():
    """Inputs, Tolles-Lawson terms of a field of 50,000 nT in random directions, and a target."""
    random = np.random.default_rng(1)
    x = random.standard_normal((ROWS, INPUTS))
    u = random.standard_normal((ROWS, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    d = 0.01 * random.standard_normal((ROWS, 3))
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    terms = np.hstack([u, *(u[:, [i]] * u[:, [j]] for i, j in pairs), *(u[:, [i]] * d for i in range(3))])
    y = 0.5 * x[:, 0] * x[:, 1] + np.sin(1.5 * x[:, 2]) + 0.2 * x[:, 3] + 0.7 * u[:, 0] - 0.3 * u[:, 1] ** 2
    return x, terms, y


class Encoder(nn.Module):
    """One layer of a transformer: attention, a dense layer, and two layer normalisations."""

    def __init__(self):
        super().__init__()
        linear = lambda inputs, units, bias: nn.Linear(inputs, units, bias)
        self.embed, self.positions = linear(INPUTS, UNITS, True), nn.Parameter(torch.zeros(WINDOW, UNITS))
        self.attend, self.merge = linear(UNITS, 3 * UNITS, False), linear(UNITS, UNITS, False)
        self.norm, self.dense, self.last_norm = nn.LayerNorm(UNITS), linear(UNITS, UNITS, True), nn.LayerNorm(UNITS)

    def forward(self, x):
        e = math.sqrt(UNITS) * self.embed(x) + self.positions
        # Each unit is a head.
        q, k, v = self.attend(e).view(*e.shape[:2], 3, UNITS, 1).permute(2, 0, 3, 1, 4)
        a = torch.softmax(q @ k.transpose(-1, -2), -1) @ v
        n = self.norm(e + self.merge(a.transpose(1, 2).flatten(2)))
        return self.last_norm(n + nn.functional.silu(self.dense(n))).flatten(1)


class Model(nn.Module):
    def __init__(self, model, hidden):
        super().__init__()
        self.model = model
        self.form = {"m3sc": "m3s", "m3w": "m3s", "m3tf": "m3s", "m3vc": "m3v"}.get(model, model)
        self.body = Encoder() if model == "m3tf" else None
        inputs = {"m3tl": 0, "m3w": WINDOW * INPUTS, "m3tf": WINDOW * UNITS}.get(model, INPUTS)
        widths = [inputs, *hidden, {"m2a": TERMS, "m3v": 3}.get(self.form, 1)]
        layers = []
        for before, after in zip(widths[:-1], widths[1:]):
            layers += [nn.Linear(before, after), nn.SiLU()] if before else []
        self.network = nn.Sequential(*layers[:-1])
        self.linear = nn.Parameter(torch.zeros(TERMS)) if self.form not in ("m1", "m2a") else None
        if self.form in ("m3v", "m3tl"):
            self.constant = nn.Parameter(torch.zeros(1))
        self.register_buffer("entries", torch.tensor([3, 4, 5, 4, 6, 7, 5, 7, 8]))
        self.register_buffer("halves", torch.tensor([1, 0.5, 0.5, 0.5, 1, 0.5, 0.5, 0.5, 1]))

    def load(self, start):
        """Sets the parameters from one vector in the order of magline."""
        start, at = torch.tensor(start, dtype=torch.get_default_dtype()), 0
        ordered = []
        if self.body:
            b = self.body
            ordered += [b.embed.weight, b.embed.bias, b.positions, b.attend.weight, b.merge.weight, b.norm.weight]
            ordered += [b.norm.bias, b.dense.weight, b.dense.bias, b.last_norm.weight, b.last_norm.bias]
        ordered += [self.constant] if self.form == "m3tl" else list(self.network.parameters())
        ordered += [self.linear] if self.linear is not None else []
        ordered += [self.constant] if self.form == "m3v" else []
        with torch.no_grad():
            for each in ordered:
                each.copy_(start[at : at + each.numel()].view(each.shape))
                at += each.numel()
        assert at == len(start), (self.model, at, len(start))
        return ordered

    def field(self, a, more):
        """|B| - |B - v| of model 3; `a` has rows of u, 1/|B|, B and the change of B, all scaled."""
        u, per_field, field, change = a[:, :3], a[:, 3:4], a[:, 4:7], a[:, 7:10]
        b = self.linear
        induced = (b[self.entries] * self.halves).view(3, 3)
        v = torch.addmm(torch.addmm(b[:3], field, induced), change, b[9:].view(3, 3).T)
        if more is not None:
            v = v + more
        rest = u - per_field * v
        along = 2 * (u * v).sum(1) - per_field[:, 0] * (v * v).sum(1)
        return along / (1 + rest.norm(dim=1))

    def forward(self, x, a, with_network=True):
        if self.form == "m3tl":
            return self.field(a, None) + self.constant
        if not with_network:
            return self.field(a, None) + (self.constant if self.form == "m3v" else self.network[-1].bias)
        out = self.network(x if self.body is None else self.body(x))
        if self.form == "m3s":
            return self.field(a, None) + out[:, 0]
        if self.form == "m3v":
            return self.field(a, out) + self.constant
        if self.form == "m1":
            return out[:, 0]
        return torch.addmv(out[:, 0], a, self.linear) if self.form == "m2c" else (a * out).sum(1)


def adam(parameters):
    """Adam of PyTorch, fused where this is supported on a CPU."""
    try:
        return torch.optim.Adam(parameters, lr=1e-3, fused=True)
    except (RuntimeError, TypeError):
        return torch.optim.Adam(parameters, lr=1e-3)


def phases(model):
    """For each epoch: number of trained coefficients (None for all), and whether the network is on and trained."""
    if model not in ("m3sc", "m3vc"):
        return [(None, True)] * EPOCHS
    return [(3, False), (9, False), (18, False)] + 3 * [(0, True)] + 4 * [(None, True)]


class Torch:
    """Training in PyTorch."""

    def __init__(self, model, hidden, start, rows, dtype):
        torch.set_default_dtype(dtype)
        x, a, y, self.orders = rows
        self.model, self.phases = Model(model, hidden), phases(model)
        self.ordered = self.model.load(start)
        self.x, self.a, self.y = (torch.tensor(each, dtype=dtype) for each in (x, a, y))
        self.back = torch.arange(1 - WINDOW, 1) if model in ("m3w", "m3tf") else None

    def inputs(self, batch):
        if self.model.form == "m3tl":
            return None
        if self.back is None:
            return self.x[batch]
        windows = self.x[(batch[:, None] + self.back).clamp_(min=0)]
        return windows if self.model.body else windows.flatten(1)

    def train(self, epochs=EPOCHS, steps=None):
        losses, before, optimiser = [], None, None
        last = self.model.constant if hasattr(self.model, "constant") else None
        for phase, rows in list(zip(self.phases, self.orders))[:epochs]:
            trained, with_network = phase
            if phase != before:
                self.model.requires_grad_(trained is None or with_network)
                if self.model.linear is not None:
                    self.model.linear.requires_grad_(trained != 0)
                if not with_network:
                    (self.model.network[-1].bias if last is None else last).requires_grad_(True)
                optimiser = adam([each for each in self.model.parameters() if each.requires_grad])
                before = phase
            total, count = torch.zeros(()), len(rows)
            batches = -(-count // BATCH)
            for k in range(batches)[:steps]:
                batch = rows[k * count // batches : (k + 1) * count // batches]
                optimiser.zero_grad()
                a = self.a[batch] if self.model.form != "m1" else None
                x = self.inputs(batch) if with_network else None
                loss = nn.functional.mse_loss(self.model(x, a, with_network), self.y[batch])
                loss.backward()
                if trained and trained < TERMS:
                    self.model.linear.grad[trained:] = 0
                optimiser.step()
                total += loss.detach() * len(batch)
            losses.append(float(total) / count)
        return losses


def torch_turn(model, hidden, start, rows, dtype, threads):
    torch.set_num_threads(threads)
    Torch(model, hidden, start, rows, dtype).train(1, 3)
    training = Torch(model, hidden, start, rows, dtype)
    begun = time.perf_counter(), time.process_time()
    losses = training.train()
    times = time.perf_counter() - begun[0], time.process_time() - begun[1]
    return times, losses, np.concatenate([each.detach().numpy().ravel() for each in training.ordered])


def magline_turn(program, folder, model, hidden, threads):
    units = ",".join(map(str, hidden)) or "-"
    arguments = [program, folder, model, units, str(WINDOW), str(threads)]
    done = subprocess.run(arguments, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    first, *losses = done.stdout.splitlines()
    return tuple(map(float, first.split())), list(map(float, losses)), np.fromfile(Path(folder) / "trained.f64")


def start(model, hidden):
    """Initial parameters: uniform weights, biases 0, small coefficients."""
    random, values = np.random.default_rng(7), []
    uniform = lambda *size: random.uniform(-1, 1, size).ravel() * math.sqrt(6 / (size[0] + size[-1]))
    if model == "m3tf":
        square = lambda count: [uniform(UNITS, UNITS) for _ in range(count)]
        values += [uniform(UNITS, INPUTS), np.zeros(UNITS), 0.02 * uniform(WINDOW, UNITS), *square(4)]
        values += [np.ones(UNITS), np.zeros(UNITS), *square(1), np.zeros(UNITS), np.ones(UNITS), np.zeros(UNITS)]
    form = {"m3sc": "m3s", "m3w": "m3s", "m3tf": "m3s", "m3vc": "m3v"}.get(model, model)
    inputs = {"m3tl": 0, "m3w": WINDOW * INPUTS, "m3tf": WINDOW * UNITS}.get(model, INPUTS)
    widths = [inputs, *hidden, {"m2a": TERMS, "m3v": 3}.get(form, 1)]
    for before, after in zip(widths[:-1], widths[1:]):
        values += [uniform(after, before) if before else np.zeros(0), np.zeros(after)]
    if form not in ("m1", "m2a"):
        values.append(0.1 * random.standard_normal(TERMS))
    if form == "m3v":
        values.append(np.zeros(1))
    return np.concatenate(values)


def near(model, b, vectors, y):
    """Rows of the first phases of a curriculum: within one standard deviation of the mean error."""
    with torch.no_grad():
        torch.set_default_dtype(torch.float64)
        of = Model("m3s", [])
        of.linear.copy_(torch.tensor(b))
        error = y - of.field(torch.tensor(vectors), None).numpy()
    return np.abs(error - error.mean()) <= error.std(ddof=1)


def interval(ratios):
    """Geometric mean and 95 % interval."""
    logs = np.log(ratios)
    half = STUDENT[min(len(logs) - 2, len(STUDENT) - 1)] * logs.std(ddof=1) / math.sqrt(len(logs))
    return tuple(math.exp(logs.mean() + by) for by in (0, -half, half))


def built():
    """Builds the Rust program and returns its path."""
    command = "cargo bench -p magline-learning --bench training --profile dev --no-run --message-format json"
    done = subprocess.run(command.split(), stdout=subprocess.PIPE, text=True, check=True)
    found = [json.loads(line).get("executable") for line in done.stdout.splitlines()]
    return next(each for each in reversed(found) if each)


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--repeats", type=int, default=8)
    arguments.add_argument("--threads", default="1,2")
    arguments.add_argument("--models", default="")
    arguments.add_argument("--program", default=None)
    given = arguments.parse_args()
    program = given.program or built()
    x, terms, y = samples()
    u, b_per_s, change = terms[:, :3], terms[:, :3], np.stack([terms[:, 9 + j :: 3] for j in range(3)], 2)
    change = (u[:, :, None] * change).sum(1)
    per_field = np.full((ROWS, 1), TARGET_SCALE_NT / BT_SCALE_NT)
    vectors = np.hstack([u, per_field, b_per_s, change])
    orders = [order(ROWS, 0, epoch) for epoch in range(EPOCHS)]
    version = torch.__version__.split("+")[0]
    print(f"PyTorch {version}; {ROWS} rows of {INPUTS} inputs, {EPOCHS} epochs, batches of {BATCH}", flush=True)
    print("| network | threads | magline, s | PyTorch double, s | single, s | ratio (double) | ratio (single) |")
    print("|---|--:|--:|--:|--:|--:|--:|", flush=True)
    chosen = [case for case in CASES if not given.models or case[0] in given.models.split(",")]
    with tempfile.TemporaryDirectory() as folder:
        for name, values in [("x", x), ("terms", terms), ("y", y), ("epochs", np.zeros(EPOCHS))]:
            values.tofile(Path(folder) / f"{name}.f64")
        for model, hidden in chosen:
            begin = start(model, hidden)
            begin.tofile(Path(folder) / "start.f64")
            a = vectors if model.startswith("m3") else terms
            kept = orders
            if model in ("m3sc", "m3vc"):
                b = begin[-TERMS:] if model == "m3sc" else begin[-TERMS - 1 : -1]
                first = near(model, b, vectors, y)
                kept = [rows[first[rows]] if epoch < 3 else rows for epoch, rows in enumerate(orders)]
            rows = (x, a, y, [torch.tensor(each) for each in kept])
            for threads in map(int, given.threads.split(",")):
                compare(program, folder, model, hidden, begin, rows, threads, given.repeats)


def compare(program, folder, model, hidden, begin, rows, threads, repeats):
    """Runs all three by turns, checks their losses, and prints a row of the table."""
    turns = {
        "magline": lambda: magline_turn(program, folder, model, hidden, threads),
        "double": lambda: torch_turn(model, hidden, begin, rows, torch.float64, threads),
        "single": lambda: torch_turn(model, hidden, begin, rows, torch.float32, threads),
    }
    times = {name: [] for name in turns}
    for repeat in range(repeats):
        found = {}
        for name in list(turns)[:: 1 if repeat % 2 == 0 else -1]:
            taken, *found[name] = turns[name]()
            times[name].append(taken)
        losses = {name: each[0] for name, each in found.items()}
        np.testing.assert_allclose(losses["magline"], losses["double"], rtol=1e-9)
        np.testing.assert_allclose(losses["magline"], losses["single"], rtol=1e-3)
        np.testing.assert_allclose(found["magline"][1], found["double"][1], rtol=1e-6, atol=1e-8)
        # The first epochs of a curriculum have no network.
        first = 3 if model in ("m3sc", "m3vc") else 0
        assert losses["magline"][-1] < losses["magline"][first], losses
    wall, processors = ({name: np.array(each)[:, k] for name, each in times.items()} for k in (0, 1))
    ratios = [interval(wall["magline"] / wall[name]) for name in ("double", "single")]
    cells = [f"{np.median(each):.3f}" for each in processors.values()]
    cells += ["{:.2f} ({:.2f} to {:.2f})".format(*each) for each in ratios]
    sizes = "-".join(map(str, hidden)) or "no hidden layer"
    print(f"| {model}, {sizes} | {threads} | {' | '.join(cells)} |", flush=True)


main()
