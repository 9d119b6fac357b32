"""Makes the reference tables of the networks with PyTorch, in double precision.

    pip install torch numpy && python3 stages/learning/reference/network/make_reference.py

The tests do not run this script; they read the tables in this folder. The initial value of parameter i (from 0) of case
k is 0.5 sin(0.9 i + k). The order of the samples in an epoch is drawn by SplitMix64, as in Rust.
"""
from pathlib import Path

import numpy as np
import torch
from torch import nn

torch.set_default_dtype(torch.float64)
torch.set_num_threads(1)
HERE = Path(__file__).resolve().parent
COMMAND = "python3 stages/learning/reference/network/make_reference.py"
ROWS, INPUTS, LINEAR, MASK = 45, 5, 3, 2**64 - 1
FORMS = ["m1", "m2a", "m2b", "m2c", "m2d"]
ACTIVATIONS = {"swish": nn.SiLU, "relu": nn.ReLU, "tanh": nn.Tanh, "sigmoid": nn.Sigmoid}
HIDDEN = [[], [6], [7, 4], [5, 9, 3]]


def write(name, columns):
    longest = max(len(column) for column in columns.values())
    with open(HERE / name, "w") as file:
        file.write(f"# PyTorch {torch.__version__.split('+')[0]}, float64; {COMMAND}\n")
        file.write(",".join(columns) + "\n")
        for row in range(longest):
            file.write(",".join(repr(float(column[row])) if row < len(column) else "nan" for column in columns.values())
                       + "\n")


class Model(nn.Module):
    def __init__(self, form, activation, hidden, case, inputs=INPUTS):
        super().__init__()
        self.form = form
        widths = [inputs, *hidden, LINEAR if form in ("m2a", "m2d") else 1]
        layers = []
        for before, after in zip(widths[:-1], widths[1:]):
            layers += [nn.Linear(before, after), ACTIVATIONS[activation]()]
        self.network = nn.Sequential(*layers[:-1])
        self.linear = nn.Parameter(torch.zeros(LINEAR), requires_grad=form == "m2c")
        given = iter(0.5 * np.sin(0.9 * np.arange(10_000) + case))
        with torch.no_grad():
            for parameter in [*self.network.parameters()] + ([self.linear] if form in ("m2b", "m2c", "m2d") else []):
                parameter.copy_(torch.tensor([next(given) for _ in range(parameter.numel())]).reshape(parameter.shape))

    def forward(self, x, a):
        out = self.network(x)
        return {
            "m1": lambda: out[:, 0],
            "m2a": lambda: (a * out).sum(1),
            "m2b": lambda: out[:, 0] + a @ self.linear,
            "m2c": lambda: out[:, 0] + a @ self.linear,
            "m2d": lambda: (a * (out + self.linear)).sum(1),
        }[self.form]()

    def flat(self):
        parameters = [*self.network.parameters()] + ([self.linear] if self.form in ("m2b", "m2c", "m2d") else [])
        return torch.cat([p.detach().flatten() for p in parameters]).numpy()


class Windowed(nn.Module):
    """Memory layers over windows of 4 samples before a dense network; parameters in the order of `WindowedNetworkShape`
    in Rust."""

    def __init__(self, memory, form, case):
        super().__init__()
        self.memory, self.units, given = memory, 3, iter(0.5 * np.sin(0.9 * np.arange(10_000) + case))

        def take(*shape):
            return torch.tensor([next(given) for _ in range(int(np.prod(shape)))]).reshape(shape)

        if memory == "tcn":
            self.body = nn.ModuleList([nn.Conv1d(INPUTS, self.units, 2, dilation=1),
                                       nn.Conv1d(self.units, self.units, 2, dilation=2)])
        else:
            self.body = {"gru": nn.GRU, "lstm": nn.LSTM}[memory](INPUTS, self.units, batch_first=True)
        with torch.no_grad():
            for parameter in self.body.parameters():
                if parameter.ndim == 3:
                    parameter.copy_(take(parameter.shape[0], 2, parameter.shape[1]).permute(0, 2, 1))
                else:
                    parameter.copy_(take(*parameter.shape))
        first = sum(p.numel() for p in self.body.parameters())
        self.head = Model(form, "tanh", [4], case + 0.9 * first, inputs=self.units)

    def forward(self, x, a):
        if self.memory == "tcn":
            features = x.transpose(1, 2)
            for layer in self.body:
                features = torch.tanh(layer(features))
            return self.head(features[:, :, 0], a)
        return self.head(self.body(x)[0][:, -1], a)

    def flat(self):
        body = [p.permute(0, 2, 1) if p.ndim == 3 else p for p in self.body.parameters()]
        return np.concatenate([*[p.detach().flatten().numpy() for p in body], self.head.flat()])


def windows(x, runs, length):
    """The window that ends at each sample; before a run, its first sample is repeated."""
    out, start = [], 0
    for run in runs:
        out += [[max(start, row - back) for back in reversed(range(length))] for row in range(start, start + run)]
        start += run
    return x[torch.tensor(out)]


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


def batches(samples, most, seed, epoch):
    numbers, count = order(samples, seed, epoch), -(-samples // most)
    return [numbers[b * samples // count : (b + 1) * samples // count] for b in range(count)]


def main():
    rng = np.random.default_rng(4)
    x = np.round(rng.normal(size=(ROWS, INPUTS)), 4)
    a = np.round(rng.normal(size=(ROWS, LINEAR)), 4)
    y = np.round(np.sin(x[:, 0]) + 0.3 * x[:, 1] * x[:, 2] + a @ [0.5, -0.2, 0.1] + 0.1 * rng.standard_t(2, size=ROWS),
                 4)
    columns = {f"x{j}": x[:, j] for j in range(INPUTS)} | {f"a{j}": a[:, j] for j in range(LINEAR)} | {"y": y}
    write("samples.csv", columns)
    x, a, y = torch.tensor(x), torch.tensor(a), torch.tensor(y)

    predictions, case = {}, 0
    for form in FORMS:
        for activation in ACTIVATIONS:
            for hidden in HIDDEN:
                with torch.no_grad():
                    model = Model(form, activation, hidden, case)
                    predictions[f"{form} {activation} {len(hidden)}"] = model(x, a)[:8].numpy()
                case += 1
    write("predictions.csv", predictions)

    # 20 steps: 5 epochs of 45 samples in batches of at most 14, which are 12, 11, 11 and 11.
    def run(form, hidden, loss, optimiser, penalty=lambda model, out, a: 0.0, scheduler=None):
        model = Model(form, "swish", hidden, 0)
        optimiser = optimiser(model)
        scheduler = scheduler(optimiser) if scheduler else None
        losses = []
        for epoch in range(5):
            total = 0.0
            for batch in batches(ROWS, 14, 3, epoch):
                optimiser.zero_grad()
                out = model(x[batch], a[batch])
                value = loss(out, y[batch])
                (value + penalty(model, out, a[batch])).backward()
                optimiser.step()
                total += value.item() * len(batch)
            losses.append(total / ROWS)
            if scheduler:
                scheduler.step()
        return np.concatenate([model.flat(), losses])

    def adam(model):
        return torch.optim.Adam([p for p in model.parameters() if p.requires_grad], lr=0.02)

    def adamw(model):
        weights = [p for p in model.network.parameters() if p.ndim == 2]
        others = [p for p in model.parameters() if p.requires_grad and p.ndim == 1]
        groups = [{"params": weights, "weight_decay": 0.3}, {"params": others, "weight_decay": 0.0}]
        return torch.optim.AdamW(groups, lr=0.02)

    def sparse_group_lasso(model, out, a):
        first = model.network[0].weight
        return 0.05 * (0.3 * first.abs().sum() + 0.7 * first.norm(dim=0).sum())

    fixed = torch.tensor([0.4, -0.1, 0.2])
    write(
        "training.csv",
        {
            "adam": run("m2c", [6], nn.MSELoss(), adam),
            "adamw": run("m2c", [6], nn.MSELoss(), adamw),
            "huber": run("m2a", [7, 4], nn.HuberLoss(delta=0.4), adam),
            "absolute": run("m1", [5, 9, 3], nn.L1Loss(), adam),
            "lasso": run("m2d", [6], nn.MSELoss(), adam, sparse_group_lasso),
            "physics": run("m2c", [6], nn.MSELoss(), adam, lambda _, out, a: 0.8 * ((out - a @ fixed) ** 2).mean()),
            "cosine": run("m2b", [6], nn.MSELoss(), adam,
                          scheduler=lambda o: torch.optim.lr_scheduler.CosineAnnealingLR(o, 5, 0.002)),
            "steps": run("m2b", [6], nn.MSELoss(), adam,
                         scheduler=lambda o: torch.optim.lr_scheduler.StepLR(o, 2, 0.5)),
        },
    )

    columns, seen = {}, windows(x, [20, 3, 22], 4)
    for memory in ("gru", "lstm", "tcn"):
        for form in ("m1", "m2c"):
            model = Windowed(memory, form, 2)
            with torch.no_grad():
                columns[f"{memory} {form} predicted"] = model(seen, a).numpy()
            optimiser = adam(model)
            for epoch in range(5):
                for batch in batches(ROWS, 14, 3, epoch):
                    optimiser.zero_grad()
                    nn.MSELoss()(model(seen[batch], a[batch]), y[batch]).backward()
                    optimiser.step()
            columns[f"{memory} {form} trained"] = model.flat()
    write("windowed.csv", columns)

    lbfgs = {}
    for name, form, hidden in [("linear", "m2c", []), ("m1", "m1", [1]), ("m2a", "m2a", [1]), ("m2b", "m2b", [1]),
                               ("m2c", "m2c", [2])]:
        model = Model(form, "tanh", hidden, 0)
        options = dict(lr=1.0, history_size=10, line_search_fn="strong_wolfe", tolerance_grad=1e-11,
                       tolerance_change=0.0)
        optimiser = torch.optim.LBFGS([p for p in model.parameters() if p.requires_grad], max_iter=3000,
                                      max_eval=100_000, **options)

        def closure():
            optimiser.zero_grad()
            value = nn.MSELoss()(model(x, a), y)
            value.backward()
            return value

        optimiser.step(closure)
        lbfgs[name] = [closure().item()]
    write("lbfgs.csv", lbfgs)


main()
