"""The table of combinations: subsets of magnetometers and of vector magnetometers by models, beside scikit-learn.

    cargo build && python3 stages/numerics/benches/combinations.py [--folder DIR] [--all] [--no-sklearn]

Simulates 12 flights of an hour at 10 Hz over Osborne with the Cessna preset, fits all subsets of up to two of four
scalar magnetometers (with their differences) by up to two of three vector magnetometers (Tolles-Lawson terms) by six
models, then adds 100 ridge parameters, then compensates with and scores every model; each run starts with what it needs
from the one before and nothing else. scikit-learn fits the same combinations one by one on columns filtered by scipy;
of the 60 sets every sixth is timed and the sum scaled, all of them with `--all`. Asserts that both models of a
combination predict the same.
"""
import argparse
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

ROOT = Path(__file__).resolve().parents[2]
MAGLINE = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "debug" / "magline"
FLIGHTS, RATE_HZ, TRIM, LAMBDA, COMPONENTS = 12, 10.0, 20, 0.025, 18
SCALARS = [f"mag_{k}_uc" for k in (2, 3, 4, 5)]
VECTORS = [f"flux_{k}" for k in "abc"]
MODELS = ["tolles_lawson", "extended_tolles_lawson", "ridge", "elastic_net", "pls", "truncated_svd"]
TARGET = "mag_1_uc"


def synth_spec():
    text = f"""preset = "cessna"
seed = 12
year = 2020
doy = 185
[map]
path = "{ROOT}/datasets/samples/osborne/osborne_anomaly_100m_at_500m.tif"
alt_m = 500.0
[diurnal]
sigma_nt = 3.0
"""
    for k in range(FLIGHTS):
        turned = 0.006 * k
        text += f"""
[[flights]]
name = "{k:02}"
start_tt_s = 40000.0
[[flights.lines]]
name = "{k:02}.01"
kind = "survey"
alt_m = 600.0
speed_mps = 62.0
duration_s = 3600.0
weave_deg = 5.0
waypoints = [[{-22.10 + turned:.4f}, 140.58], [-21.85, 140.60], [-21.85, {140.76 - turned:.4f}], [-22.10, 140.76]]
"""
    return text


def spec(more=""):
    features = [name for mag in SCALARS for name in (mag, f"{mag}_dot")] + [f"TL_A_{v}" for v in VECTORS]
    return f"""name = "combinations"
store = "store"
[tables.flights]
path = "flights/"
[axes]
scalars = {{ subsets_of = {json.dumps([[m, m + "_dot"] for m in SCALARS])}, up_to = 2 }}
vectors = {{ subsets_of = {json.dumps([f"TL_A_{v}" for v in VECTORS])}, up_to = 2 }}
model = {json.dumps(MODELS)}
single = [0.5]
lambda = [{", ".join(repr(10.0 ** (k / 10 - 6)) for k in range(100))}]
[[stages]]
name = "columns"
stage = "features"
input = "flights"
features = {json.dumps(features)}
publish = false
[[stages]]
name = "fits"
stage = "fit"
input = "columns"
model = "$model"
target = "{TARGET}"
features = ["features"]
entries = ["$scalars", "$vectors"]
lambda = {LAMBDA}
components = {COMPONENTS}
{more}"""


LAMBDAS = """
[[stages]]
name = "path"
stage = "fit"
input = "columns"
model = "tolles_lawson"
target = "mag_1_uc"
features = ["features"]
entries = ["mag_4_uc", "mag_4_uc_dot", "TL_A_flux_a"]
lambda = "$lambda"
"""
ONE_LAMBDA = LAMBDAS.replace('"path"', '"single"').replace('"$lambda"', '"$single"')
ALL_LAMBDAS = LAMBDAS.replace('"path"', '"paths"').replace('"mag_4_uc", "mag_4_uc_dot", "TL_A_flux_a"',
                                                           '"$scalars", "$vectors"')
SCORES = """
[[stages]]
name = "clean"
stage = "compensate"
input = "columns"
model = "fits"
mag = "mag_1_uc"
publish = false
[[stages]]
name = "scores"
stage = "score"
input = ["clean"]
truth = "mag_1_c"
"""


def run(folder, text, label, threads=2):
    (folder / "spec.toml").write_text(text)
    start = time.perf_counter()
    out = subprocess.run([MAGLINE, "run", "spec.toml", "--json", "--threads", str(threads)], cwd=folder,
                         capture_output=True, text=True)
    seconds = time.perf_counter() - start
    if out.returncode:
        raise SystemExit(out.stderr + out.stdout[-2000:])
    tables = [json.loads(line) for line in out.stdout.splitlines() if '"seconds"' in line]
    parts = ", ".join(f"{t['table']} {t['seconds']:.1f}" for t in tables if "table" in t and t["seconds"] >= 0.05)
    print(f"magline, {label}: {seconds:.1f} s ({parts})", flush=True)
    return seconds


def columns(folder):
    """All columns and the target of every flight, as magline's `features` makes them."""
    from scipy.signal import butter, sosfiltfilt
    names, a, y = None, [], []
    for path in sorted((folder / "flights").glob("*.parquet")):
        t = pq.read_table(path).to_pandas()
        one = {}
        for mag in SCALARS:
            one[mag] = t[mag].to_numpy()
            one[f"{mag}_dot"] = np.gradient(one[mag])
        for v in VECTORS:
            b = t[[f"{v}_{c}" for c in "xyz"]].to_numpy()
            bt = np.linalg.norm(b, axis=1)[:, None]
            u, db = b / bt, np.gradient(b, axis=0)
            pairs = [(i, j) for i in range(3) for j in range(i, 3)]
            terms = [u] + [(u[:, i] * b[:, j] / 50_000.0)[:, None] for i, j in pairs]
            terms += [(u[:, i] * db[:, j] / 50_000.0)[:, None] for i in range(3) for j in range(3)]
            for k, column in enumerate(np.hstack(terms).T):
                one[f"TL_A_{v}#{k}"] = column
        names = list(one)
        a.append(np.column_stack([one[n] for n in names]))
        y.append(t[TARGET].to_numpy())
    start = time.perf_counter()
    sos = butter(4, [0.1, 0.9], "bandpass", fs=RATE_HZ, output="sos")
    # Padded as `filtfilt` of the same filter does: scipy's `sosfiltfilt` takes three samples more.
    a = np.vstack([sosfiltfilt(sos, x, axis=0, padlen=24)[TRIM:-TRIM] for x in a])
    y = np.concatenate([sosfiltfilt(sos, x, padlen=24)[TRIM:-TRIM] for x in y])
    return names, a, y, time.perf_counter() - start


def sklearn_model(name, x, y):
    from sklearn.cross_decomposition import PLSRegression
    from sklearn.decomposition import PCA
    from sklearn.linear_model import ElasticNet, LinearRegression, Ridge
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler
    models = {
        "tolles_lawson": lambda: Ridge(alpha=LAMBDA, fit_intercept=False),
        "extended_tolles_lawson": lambda: make_pipeline(StandardScaler(), Ridge(alpha=LAMBDA)),
        "ridge": lambda: make_pipeline(StandardScaler(), Ridge(alpha=LAMBDA)),
        "elastic_net": lambda: make_pipeline(StandardScaler(), ElasticNet(alpha=LAMBDA, l1_ratio=0.99)),
        "pls": lambda: PLSRegression(min(COMPONENTS, x.shape[1])),
        "truncated_svd": lambda: make_pipeline(StandardScaler(), PCA(min(COMPONENTS, x.shape[1])), LinearRegression()),
    }
    return models[name]().fit(x, y)


def predicted(table, scalars, vectors, model, x):
    """What magline's model makes of the same columns."""
    dots = "+".join(m + d for m in scalars for d in ("", "_dot"))
    of = (table.scalars == dots) & (table.vectors == "+".join(f"TL_A_{v}" for v in vectors)) & (table.model == model)
    values = table[of].value.to_numpy()
    return x @ values[: x.shape[1]] + values[x.shape[1] :].sum()


def by_sklearn(folder, whole):
    import warnings

    import sklearn
    warnings.filterwarnings("ignore")
    names, a, y, filtering = columns(folder)
    subsets = lambda of: [s for k in (1, 2) for s in itertools.combinations(of, k)]
    sets = [(s, v) for s in subsets(SCALARS) for v in subsets(VECTORS)]
    chosen = sets if whole else sets[::6]
    seconds = dict.fromkeys(MODELS, 0.0)
    worst = dict.fromkeys(MODELS, 0.0)
    table = pq.read_table(folder / "store/tables/combinations/fits").to_pandas()
    for scalars, vectors in chosen:
        wanted = [n for n in names if n.removesuffix("_dot") in scalars
                  or n.split("#")[0].removeprefix("TL_A_") in vectors]
        x = a[:, [names.index(n) for n in wanted]]
        for model in MODELS:
            start = time.perf_counter()
            fit = sklearn_model(model, x, y)
            seconds[model] += time.perf_counter() - start
            ours = predicted(table, scalars, vectors, model, x)
            worst[model] = max(worst[model], np.std(ours - np.ravel(fit.predict(x))) / np.std(y))
    scale = len(sets) / len(chosen)
    each = ", ".join(f"{m} {s * scale:.1f}" for m, s in seconds.items())
    total = filtering + scale * sum(seconds.values())
    print(f"scikit-learn {sklearn.__version__}, one by one, {len(chosen)} of {len(sets)} sets timed: {total:.1f} s "
          f"(all columns filtered once {filtering:.1f}; {each})", flush=True)
    print("predictions differ by, in parts of the target's deviation: "
          + ", ".join(f"{m} {w:.0e}" for m, w in worst.items()))
    # scikit-learn stops coordinate descent at a part of 1e-4.
    assert all(w < (1e-2 if m == "elastic_net" else 1e-6) for m, w in worst.items()), worst
    return total


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--folder", type=Path, help="work here, and leave everything")
    options.add_argument("--all", action="store_true", help="time all combinations in scikit-learn")
    options.add_argument("--no-sklearn", action="store_true")
    options.add_argument("--no-scores", action="store_true")
    given = options.parse_args()
    folder = given.folder or Path(tempfile.mkdtemp(prefix="combinations."))
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "flights").exists():
        (folder / "synth.toml").write_text(synth_spec())
        start = time.perf_counter()
        subprocess.run([MAGLINE, "synth", "synth.toml", "--to", "flights"], cwd=folder, check=True, capture_output=True)
        print(f"simulated in {time.perf_counter() - start:.1f} s", flush=True)
    shutil.rmtree(folder / "store", ignore_errors=True)
    only = spec().split("[[stages]]\nname = \"fits\"")[0]
    run(folder, only, "flights read and feature columns made")
    fits = run(folder, spec(), "360 fits")
    single = run(folder, spec(ONE_LAMBDA), "1 lambda of one set")
    hundred = run(folder, spec(ONE_LAMBDA + LAMBDAS), "100 other lambdas of it")
    print(f"99 lambdas more cost {100 * (hundred / single - 1):.0f} % of the sweep")
    every = run(folder, spec(ONE_LAMBDA + LAMBDAS + ALL_LAMBDAS), "100 lambdas of all 60 sets")
    print(f"that is {1e3 * every / 6000:.2f} ms for each table that is written")
    if not given.no_scores:
        run(folder, spec(SCORES), "every model of the table compensated with and scored")
    if not given.no_sklearn:
        theirs = by_sklearn(folder, given.all)
        print(f"magline's fits are faster by {theirs / fits:.0f}")
    if not given.folder:
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
