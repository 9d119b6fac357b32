"""Benchmark of `networks.rs` in PyTorch, for comparison.

    python3 stages/learning/benches/networks.py            # PyTorch, the Rust bench, PyTorch again

Batches are indexed from tensors in memory, which is the fastest method of PyTorch without a compiler. A `DataLoader`
collates them row by row and takes many times as long. PyTorch usually trains in single precision.
"""
import subprocess
import sys
import time

import torch
from torch import nn

ROWS, INPUTS, TERMS, BATCH, EPOCHS = 400_000, 77, 18, 2048, 4


class Model(nn.Module):
    def __init__(self, form, hidden):
        super().__init__()
        widths = [INPUTS, *hidden, {"m2a": TERMS, "m3v": 3}.get(form, 1)]
        layers = []
        for before, after in zip(widths[:-1], widths[1:]):
            layers += [nn.Linear(before, after), nn.SiLU()]
        self.form, self.network = form, nn.Sequential(*layers[:-1])
        self.linear = nn.Parameter(torch.zeros(TERMS))
        self.constant = nn.Parameter(torch.zeros(()))

    def vector_field(self, a, more):
        """|B| - |B - v| of model 3; `a` has rows of u, 1/|B|, B and the change of B, all scaled."""
        u, per_field, field, change = a[:, :3], a[:, 3:4], a[:, 4:7], a[:, 7:10]
        b = self.linear
        induced = torch.stack([b[3], b[4] / 2, b[5] / 2, b[4] / 2, b[6], b[7] / 2, b[5] / 2, b[7] / 2, b[8]]).view(3, 3)
        v = b[:3] + field @ induced + change @ b[9:].view(3, 3).T + more
        rest = u - per_field * v
        along = 2 * (u * v).sum(1) - per_field[:, 0] * (v * v).sum(1)
        return along / (1 + rest.norm(dim=1))

    def forward(self, x, a):
        out = self.network(x)
        if self.form == "m3s":
            return out[:, 0] + self.vector_field(a, 0.0)
        if self.form == "m3v":
            return self.vector_field(a, out) + self.constant
        if self.form == "m1":
            return out[:, 0]
        return out[:, 0] + a @ self.linear if self.form == "m2c" else (a * out).sum(1)


def bench(dtype):
    torch.manual_seed(1)
    torch.set_default_dtype(dtype)
    x, a = torch.randn(ROWS, INPUTS), torch.randn(ROWS, TERMS)
    y = 0.5 * x[:, 0] * x[:, 1] + torch.sin(1.5 * x[:, 2]) + 0.2 * x[:, 3]
    u = torch.nn.functional.normalize(a[:, :3], dim=1)
    vectors = torch.cat([u, torch.full((ROWS, 1), 100.0 / 50_000), u, 0.01 * a[:, 3:6]], 1)
    forms = [("m1", [8]), ("m2c", [8]), ("m2a", [8]), ("m3s", [8]), ("m3v", [8]), ("m1", [16, 8]), ("m1", [64, 32]),
             ("m1", [16, 16, 16])]
    for form, hidden in forms:
        terms = vectors if form in ("m3s", "m3v") else a
        for threads in (1, 2):
            torch.set_num_threads(threads)
            model = Model(form, hidden)
            optimiser, loss, times = torch.optim.Adam(model.parameters(), lr=1e-3), nn.MSELoss(), []
            for _ in range(EPOCHS):
                start = time.perf_counter(), time.process_time()
                for batch in torch.randperm(ROWS).split(BATCH):
                    optimiser.zero_grad()
                    loss(model(x[batch], terms[batch] if form != "m1" else None), y[batch]).backward()
                    optimiser.step()
                times.append((time.perf_counter() - start[0], time.process_time() - start[1]))
            clock, processors = (min(kind) * 1e3 for kind in zip(*times))
            print(f"{form} {hidden}, {threads} threads, {dtype}: {clock:.0f} ms, {processors:.0f} ms", flush=True)


print(f"PyTorch {torch.__version__.split('+')[0]}: the fastest of {EPOCHS} epochs: clock, processors")
for number in range(1 if "--once" in sys.argv else 2):
    bench(torch.float32)
    bench(torch.float64)
    if number == 0:
        command = ["cargo", "bench", "-p", "magline-learning", "--bench", "networks", "--profile", "dev"]
        subprocess.run(command, check=True)
